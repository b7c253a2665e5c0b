//! The proof that nothing changes: pixels of small pictures of every method are, bit by bit, those
//! of `golden/pictures.toml`.

#[path = "golden/render.rs"]
mod render;
#[path = "golden/table.rs"]
mod table;

use std::fs;
use std::time::Instant;

use render::{BakedScene, CITY, Device, FramePixels, Method, Pixels, Subject};
use table::{Entry, Table, differences, join_devices, pixel_hash, processor};

const CPU: &str = "cpu";
const LAVAPIPE: &str = "lavapipe";
/// Methods whose tiles come of singular value decompositions that take the number of threads from
/// their surroundings, and round otherwise with one thread than with more: their pictures are equal
/// for any number but one. That is a fault of the tiles; until it is mended one thread cannot be
/// compared.
const MORE_THREADS: [&str; 2] = ["low_rank", "feedback"];
/// Flights through the streaming world, of which the most frequent pictures count: patches enter its
/// matrix as their rows come from the disk, and about one flight of forty rounds otherwise than the
/// others because they came in another order. That is a fault of the matrix; once it is mended one
/// flight is enough.
const CITY_FLIGHTS: usize = 7;

#[test]
fn every_picture_is_that_of_the_table() {
    let processor = processor();
    let writes = std::env::var("GOLDEN_WRITE").is_ok_and(|value| value == "1");
    let expected = table::read().remove(&processor);
    if expected.is_none() && !writes {
        println!("skipped: no golden pictures for a processor of {processor}");
        return;
    }
    let mut expected = expected.unwrap_or_default();
    let driver = render::lavapipe();
    let has_lavapipe = match &driver {
        Some(driver) if !writes && *driver != expected.lavapipe => {
            println!("skipped: golden pictures are of {}, not {driver}", expected.lavapipe);
            false
        }
        other => other.is_some(),
    };
    let mut found: Vec<Entry> = Vec::new();
    for subject in &Subject::ALL {
        found.extend(entries_of_scene(subject, has_lavapipe));
    }
    found.extend(entries_of_city());
    if rayon::current_num_threads() == 1 {
        assert!(!writes, "GOLDEN_WRITE needs more than one thread");
        println!("skipped with one thread: {}", MORE_THREADS.join(", "));
        found.retain(|entry| !MORE_THREADS.contains(&entry.method.as_str()));
        expected.pictures.retain(|entry| !MORE_THREADS.contains(&entry.method.as_str()));
    }
    if writes {
        let lavapipe = driver.expect("GOLDEN_WRITE needs lavapipe");
        table::write(&processor, Table { lavapipe, pictures: join_devices(found) });
        return;
    }
    let devices: &[&str] = if has_lavapipe { &[CPU, LAVAPIPE] } else { &[CPU] };
    let wrong = differences(&found, &expected.pictures, devices);
    assert!(wrong.is_empty(), "{} entries differ:\n{}", wrong.len(), wrong.join("\n"));
}

fn entries_of_scene(subject: &Subject, has_lavapipe: bool) -> Vec<Entry> {
    let start = Instant::now();
    let scene = BakedScene::new(subject);
    println!("{}: baked in {:.1} s", subject.name, start.elapsed().as_secs_f64());
    let mut entries = Vec::new();
    for &method in subject.methods {
        entries.push(entry_of_method(subject, &scene, method, Device::Cpu));
        if has_lavapipe && !method.is_of_host() {
            entries.push(entry_of_method(subject, &scene, method, Device::Lavapipe));
        }
    }
    entries
}

fn entry_of_method(subject: &Subject, scene: &BakedScene, method: Method, on: Device) -> Entry {
    let start = Instant::now();
    let frames = render::render(scene, method, on);
    let name = match on {
        Device::Cpu => CPU,
        Device::Lavapipe => LAVAPIPE,
    };
    let seconds = start.elapsed().as_secs_f64();
    println!("{}, {}, {name}: {seconds:.1} s", subject.name, method.name());
    check_frames(&frames);
    Entry::of_frames(subject.name, method.name(), name, &frames)
}

/// A bake of a streaming world, and a flight through it.
fn entries_of_city() -> Vec<Entry> {
    let start = Instant::now();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("city.bake");
    let city = render::build_city();
    render::bake_city(&city, &file);
    let bytes = fs::read(&file).unwrap();
    println!("{CITY}: {} bytes in {:.1} s", bytes.len(), start.elapsed().as_secs_f64());
    let mut flights: Vec<Entry> = Vec::new();
    for _ in 0..CITY_FLIGHTS {
        let frames = render::fly_city(&city, &file);
        check_frames(&frames);
        flights.push(Entry::of_frames(CITY, "local from the bake", CPU, &frames));
    }
    println!("{CITY}: flown by {:.1} s", start.elapsed().as_secs_f64());
    vec![Entry::of_file(CITY, "bake", CPU, &bytes), most_frequent(flights)]
}

/// The entry that most of these are equal to.
fn most_frequent(entries: Vec<Entry>) -> Entry {
    let count = |entry: &Entry| entries.iter().filter(|other| *other == entry).count();
    entries.iter().max_by_key(|entry| count(entry)).expect("an entry").clone()
}

/// Frames that are black, not finite or all alike would prove nothing.
fn check_frames(frames: &[FramePixels]) {
    for frame in frames {
        let values = frame.full.values.as_flattened();
        assert!(values.iter().all(|value| value.is_finite()));
        assert!(values.iter().any(|value| *value > 0.0));
        if let Some(indirect) = &frame.indirect {
            assert!(indirect.values.as_flattened().iter().any(|value| *value > 0.0));
        }
    }
    assert!(frames.windows(2).all(|pair| pair[0] != pair[1]));
}

fn small_frames() -> Vec<FramePixels> {
    let full = Pixels { width: 3, height: 2, values: vec![[0.5, 1.0, 2.0]; 6] };
    let indirect = Pixels { values: vec![[0.25, 0.5, 1.0]; 6], ..full.clone() };
    let frame = FramePixels { full, indirect: Some(indirect) };
    vec![frame.clone(), frame.clone(), frame]
}

#[test]
fn the_least_change_of_a_pixel_changes_the_hash() {
    let pixels = small_frames().remove(0).full;
    let hash = pixel_hash(&pixels);
    let mut nudged = pixels.clone();
    nudged.values[4][1] = f32::from_bits(nudged.values[4][1].to_bits() ^ 1);
    assert_ne!(pixel_hash(&nudged), hash);
    let turned = Pixels { width: 2, height: 3, ..pixels.clone() };
    assert_ne!(pixel_hash(&turned), hash);
    assert_eq!(pixel_hash(&pixels.clone()), hash);
}

#[test]
fn the_hash_is_sha_256_of_size_and_bits() {
    let pixels = Pixels { width: 1, height: 1, values: vec![[0.0, 1.0, -2.0]] };
    let bytes: [u8; 20] = [1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0];
    let file = Entry::of_file("", "", CPU, &bytes);
    assert_eq!(file.file, Some(pixel_hash(&pixels)));
}

#[test]
fn a_wrong_entry_is_named_with_its_first_frame() {
    let mut frames = small_frames();
    let expected = vec![
        Entry::of_frames("hall", "classic", CPU, &frames),
        Entry::of_frames("hall", "low_rank", CPU, &frames),
        Entry::of_file("hall", "bake", CPU, b"rows"),
    ];
    assert_eq!(differences(&expected, &expected, &[CPU]), Vec::<String>::new());
    frames[1].full.values[0][0] = 0.75;
    if let Some(indirect) = &mut frames[2].indirect {
        indirect.values[0][0] = 0.75;
    }
    let found = vec![
        Entry::of_frames("hall", "classic", CPU, &frames),
        Entry::of_frames("hall", "local", CPU, &frames),
        Entry::of_file("hall", "bake", CPU, b"ruws"),
    ];
    let named = [
        "hall, classic, cpu: full differs from frame 1 of 3 on; \
         indirect differs from frame 2 of 3 on",
        "hall, local, cpu: the table has no such entry",
        "hall, bake, cpu: the bytes of the file differ",
        "hall, low_rank, cpu: not rendered",
    ];
    assert_eq!(differences(&found, &expected, &[CPU]), named);
}

#[test]
fn the_most_frequent_flight_counts() {
    let mut frames = small_frames();
    let usual = Entry::of_frames("hall", "local", CPU, &frames);
    frames[1].full.values[0][0] = 0.75;
    let rare = Entry::of_frames("hall", "local", CPU, &frames);
    assert_eq!(most_frequent(vec![usual.clone(), rare.clone(), usual.clone()]), usual);
    assert_eq!(most_frequent(vec![rare.clone(), rare.clone(), usual]), rare);
}

#[test]
fn devices_of_equal_pictures_share_an_entry() {
    let mut frames = small_frames();
    let ours = Entry::of_frames("hall", "classic", CPU, &frames);
    let same = Entry::of_frames("hall", "classic", LAVAPIPE, &frames);
    frames[0].full.values[0][0] = 0.75;
    let other = Entry::of_frames("hall", "classic", LAVAPIPE, &frames);
    let joined = join_devices(vec![ours.clone(), same.clone()]);
    assert_eq!(joined.len(), 1);
    assert_eq!(joined[0].devices, [CPU, LAVAPIPE]);
    assert_eq!(join_devices(vec![ours.clone(), other.clone()]).len(), 2);
    // What lavapipe gives is compared with its own entry.
    let expected = [ours.clone(), other];
    assert_eq!(differences(&[ours, same], &expected, &[CPU, LAVAPIPE]).len(), 1);
}
