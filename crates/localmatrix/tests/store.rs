//! Worlds on disk: what is written comes back, damage is named and stays where it is, interruptions and parts change no
//! byte, and a slow disk stalls nobody.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use glam::Vec3;
use patchlight_localmatrix::{
    BakeError, BakeFile, BakeWriter, Error, LitPoint, Mapped, NO_NODE, Node, Part, Record, Source, Store, World,
    WorldHead, block_range, join, parent_record,
};
use proptest::prelude::*;

const LEAVES: u32 = 60;
const CHILDREN: u32 = 4;
const PARENTS: u32 = LEAVES / CHILDREN;
const BLOCK_ROWS: u32 = 8;
const POINTS: usize = 4;

fn nodes() -> Vec<Node> {
    let node = |number: u32, area: f32| Node {
        centre: Vec3::new(number as f32, 1.0, -2.0),
        radius: 0.5,
        normal: Vec3::Y,
        area,
        albedo: Vec3::splat(0.5),
        parent: if number < LEAVES { LEAVES + number / CHILDREN } else { NO_NODE },
        first_child: if number < LEAVES { 0 } else { (number - LEAVES) * CHILDREN },
        children: if number < LEAVES { 0 } else { CHILDREN },
    };
    let mut nodes: Vec<Node> = (0..LEAVES).map(|k| node(k, 1.0 + (k % 3) as f32)).collect();
    for parent in 0..PARENTS {
        let area = nodes[(parent * CHILDREN) as usize..][..CHILDREN as usize].iter().map(|n| n.area).sum();
        nodes.push(node(LEAVES + parent, area));
    }
    nodes
}

/// The record of a leaf: its rays are those of 64, so that all sums are exact.
fn record(leaf: u32) -> Record {
    let factors = (1..4).map(|step| ((leaf + 7 * step) % LEAVES, 0.25)).collect::<Vec<_>>();
    let mut factors = factors;
    factors.sort_by_key(|f| f.0);
    let point = |k: usize| LitPoint {
        position: Vec3::new(leaf as f32 + 0.1 * k as f32, 1.0, -2.0),
        normal: Vec3::Y,
        albedo: Vec3::splat(26_214.0 / 65_535.0),
    };
    Record { sky: 0.125, lost: 0.125, factors, points: (0..POINTS).map(point).collect() }
}

fn head(part: Option<Part>) -> WorldHead {
    WorldHead { part, nodes: LEAVES + PARENTS, leaves: LEAVES, block_rows: BLOCK_ROWS, scene: [1; 32], key: [2; 32] }
}

fn begin(path: &Path, head: WorldHead) -> BakeWriter {
    match BakeWriter::resume(path, head.scene, head.key, head.part).unwrap() {
        Some(writer) => writer,
        None => BakeWriter::create(path, head, "{\"scene\":\"test\"}", nodes(), vec![1, 2, 3]).unwrap(),
    }
}

/// Writes the leaves' blocks that are missing, `most` of them at most.
fn fill(writer: &mut BakeWriter, most: usize) {
    let head = *writer.head();
    for _ in 0..most {
        let Some(block) = writer.next_block().filter(|&block| block_range(&head, block).start < LEAVES) else { break };
        let records: Vec<Record> = block_range(&head, block).map(record).collect();
        writer.push(&records).unwrap();
    }
}

fn whole(path: &Path) {
    let mut writer = begin(path, head(None));
    fill(&mut writer, usize::MAX);
    assert!(writer.add_parents(POINTS, &mut |_, _| true).unwrap());
    writer.finish().unwrap();
}

fn beginning(path: &Path) -> PathBuf {
    PathBuf::from(format!("{}.beginning", path.display()))
}

/// Waits for a row; the reader has a thread of its own.
fn wait_for(store: &mut Store, node: u32) -> Result<Vec<(u32, f32)>, Error> {
    store.want(&[node]);
    assert!(store.settle(Duration::from_secs(20)), "the reader does not come back");
    store.row(node).map(|row| row.expect("what was wanted is there"))
}

#[test]
fn what_is_written_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bake");
    whole(&path);
    assert!(!beginning(&path).exists());
    let file = BakeFile::open(&path).unwrap();
    assert_eq!((file.head, file.nodes.as_slice()), (head(None), nodes().as_slice()));
    assert_eq!((file.text.as_str(), file.extra.as_slice()), ("{\"scene\":\"test\"}", &[1, 2, 3][..]));
    assert_eq!(file.sky, vec![0.125; (LEAVES + PARENTS) as usize]);
    file.check().unwrap();
    for block in 0..file.head.blocks() {
        for (node, found) in block_range(&file.head, block).zip(file.records(block).unwrap()) {
            if node < LEAVES {
                assert_eq!(found, record(node));
                assert_ne!(found, record((node + 1) % LEAVES));
            }
            let sum: f32 = found.factors.iter().map(|f| f.1).sum::<f32>() + found.sky + found.lost;
            assert!((sum - 1.0).abs() < 1e-4, "node {node}: {sum}");
        }
    }
}

#[test]
fn the_row_of_a_parent_is_the_mean_of_its_children_and_points_are_theirs() {
    let nodes = nodes();
    let children: Vec<Record> = (0..CHILDREN).map(record).collect();
    let found = parent_record(&nodes, LEAVES, &children, POINTS);
    let area = nodes[LEAVES as usize].area;
    // By hand: what each child sends to the children of each node.
    for parent in 0..PARENTS {
        let column = LEAVES + parent;
        let expected: f32 = (0..CHILDREN)
            .map(|c| {
                let own = children[c as usize].factors.iter().filter(|f| f.0 / CHILDREN == parent);
                nodes[c as usize].area / area * own.map(|f| f.1).sum::<f32>()
            })
            .sum();
        let share = found.factors.iter().find(|f| f.0 == column).map_or(0.0, |f| f.1);
        assert!((share - expected).abs() < 1e-6, "{column}: {share} instead of {expected}");
    }
    assert_eq!(found.points.len(), POINTS);
    assert!(found.points.iter().all(|p| children.iter().any(|c| c.points.contains(p))));
    // Children of other areas have another mean.
    let mut other = nodes.clone();
    other[0].area *= 3.0;
    assert_ne!(parent_record(&other, LEAVES, &children, POINTS).factors, found.factors);
}

#[test]
fn an_interrupted_bake_goes_on_to_the_same_bytes_wherever_it_ended() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bake");
    let again = folder.path().join("b.bake");
    whole(&path);
    let expected = fs::read(&path).unwrap();
    let mut writer = begin(&again, head(None));
    fill(&mut writer, 5);
    drop(writer);
    let begun = fs::read(beginning(&again)).unwrap();
    assert!(expected.starts_with(&begun));
    // Killed at any byte: half a header, half a world, half a block, or what a disk made of the last block.
    for length in (0..begun.len()).step_by(97).chain([begun.len() - 1, begun.len()]) {
        fs::write(beginning(&again), &begun[..length]).unwrap();
        whole(&again);
        assert!(fs::read(&again).unwrap() == expected, "cut to {length} bytes");
    }
    let mut spoilt = begun.clone();
    let last = spoilt.len() - 9;
    spoilt[last] ^= 1;
    fs::write(beginning(&again), spoilt).unwrap();
    whole(&again);
    assert!(fs::read(&again).unwrap() == expected);
    // Another seed, scene or part is not gone on with.
    fs::write(beginning(&again), &begun).unwrap();
    for (scene, key, part, word) in [
        ([9; 32], [2; 32], None, "another scene"),
        ([1; 32], [9; 32], None, "other settings"),
        ([1; 32], [2; 32], Some(Part { number: 1, of: 2 }), "another part"),
    ] {
        let message = BakeWriter::resume(&again, scene, key, part).unwrap_err().to_string();
        assert!(message.contains(word) && message.contains("b.bake.beginning"), "{message}");
    }
}

fn part(folder: &Path, number: u32, of: u32) -> PathBuf {
    let path = folder.join(format!("part-{number}-{of}.bake"));
    let mut writer = begin(&path, head(Some(Part { number, of })));
    fill(&mut writer, usize::MAX);
    writer.finish().unwrap();
    path
}

fn joined(path: &Path, parts: &[PathBuf]) -> Result<(), BakeError> {
    let files: Vec<BakeFile> = parts.iter().map(|part| BakeFile::open(part).unwrap()).collect();
    let mut writer = join(path, &files, &mut |_, _| {})?;
    writer.add_parents(POINTS, &mut |_, _| true)?;
    writer.finish()
}

#[test]
fn parts_give_the_bytes_of_a_whole_and_wrong_parts_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    whole(&at("whole.bake"));
    let expected = fs::read(at("whole.bake")).unwrap();
    for of in [1, 3, 8, 20] {
        let mut parts: Vec<PathBuf> = (1..=of).map(|k| part(folder.path(), k, of)).collect();
        parts.reverse();
        joined(&at("joined.bake"), &parts).unwrap();
        assert!(fs::read(at("joined.bake")).unwrap() == expected, "{of} parts");
    }
    let parts: Vec<PathBuf> = (1..=3).map(|k| part(folder.path(), k, 3)).collect();
    let message = |parts: &[PathBuf]| joined(&at("wrong.bake"), parts).unwrap_err().to_string();
    let lost = message(&parts[1..2]);
    assert!(lost.contains("of 3 parts") && lost.contains("1, 3"), "{lost}");
    fs::copy(&parts[1], at("copy.bake")).unwrap();
    let doubled = message(&[parts[0].clone(), parts[1].clone(), at("copy.bake"), parts[2].clone()]);
    assert!(
        doubled.contains("copy.bake") && doubled.contains("part-2-3.bake") && doubled.contains("part 2"),
        "{doubled}"
    );
    let of_other = |scene, key, name: &str| {
        let path = at(name);
        let part = Some(Part { number: 2, of: 3 });
        let mut writer =
            BakeWriter::create(&path, WorldHead { scene, key, ..head(part) }, "", nodes(), Vec::new()).unwrap();
        fill(&mut writer, usize::MAX);
        writer.finish().unwrap();
        path
    };
    let other = message(&[parts[0].clone(), of_other([7; 32], [2; 32], "scene.bake"), parts[2].clone()]);
    assert!(other.contains("scene.bake") && other.contains("another scene"), "{other}");
    let other = message(&[parts[0].clone(), of_other([1; 32], [7; 32], "settings.bake"), parts[2].clone()]);
    assert!(other.contains("settings.bake") && other.contains("other settings"), "{other}");
    let mixed = message(&[parts[0].clone(), part(folder.path(), 2, 8)]);
    assert!(mixed.contains("another number of parts"), "{mixed}");
    let whole = message(&[parts[0].clone(), at("whole.bake")]);
    assert!(whole.contains("whole.bake") && whole.contains("a part is needed"), "{whole}");
    // A part is no world to fly through.
    let refused = Store::new(BakeFile::open(&parts[0]).unwrap(), 1 << 20).unwrap_err().to_string();
    assert!(refused.contains("part 1 of 3") && refused.contains("join the parts"), "{refused}");
    // A part with a block that was altered is named with it.
    let mut bytes = fs::read(&parts[1]).unwrap();
    let last = bytes.len() - 5;
    bytes[last] ^= 4;
    fs::write(&parts[1], bytes).unwrap();
    let altered = message(&parts);
    assert!(altered.contains("part-2-3.bake: block 4 at byte"), "{altered}");
}

#[test]
fn an_altered_block_is_refused_with_its_place_and_the_rest_keeps_working() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bake");
    whole(&path);
    let places: Vec<(u64, u32)> = {
        let file = BakeFile::open(&path).unwrap();
        (0..file.head.blocks()).map(|block| file.place(block).unwrap()).collect()
    };
    let good = fs::read(&path).unwrap();
    let (offset, length) = places[3];
    for at in [0, 5, 13, 17, 21, 24, 40, length as usize - 1] {
        let mut bytes = good.clone();
        bytes[offset as usize + at] ^= 0x10;
        fs::write(&path, bytes).unwrap();
        let mut store = Store::new(BakeFile::open(&path).unwrap(), 1 << 20).unwrap();
        let message = wait_for(&mut store, 3 * BLOCK_ROWS).unwrap_err().to_string();
        assert!(message.contains(&format!("a.bake: block 3 at byte {offset} ")), "{message}");
        // Once lost, it is lost at once, and the reader goes on.
        assert!(store.row(3 * BLOCK_ROWS + 1).is_err());
        for node in [0, 2 * BLOCK_ROWS, 4 * BLOCK_ROWS, LEAVES] {
            assert!(!wait_for(&mut store, node).unwrap().is_empty());
        }
    }
    // Cut: the table is lost with the end, and what is before the cut is found without it.
    let cut = (places[5].0 + 10) as usize;
    fs::write(&path, &good[..cut]).unwrap();
    let file = BakeFile::open(&path).unwrap();
    assert!(file.sky.is_empty());
    let lost: Vec<String> = file.lost().map(|error| error.to_string()).collect();
    assert!(lost[0].contains(&format!("block 5 at byte {}", places[5].0)), "{lost:?}");
    let mut store = Store::new(file, 1 << 20).unwrap();
    assert_eq!(wait_for(&mut store, 4 * BLOCK_ROWS).unwrap(), record(4 * BLOCK_ROWS).factors);
    let message = wait_for(&mut store, 5 * BLOCK_ROWS).unwrap_err().to_string();
    assert!(message.contains("block 5 at byte"), "{message}");
}

#[test]
fn what_is_no_bake_is_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bake");
    whole(&path);
    let good = fs::read(&path).unwrap();
    let refused = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = good.clone();
        change(&mut bytes);
        fs::write(&path, bytes).unwrap();
        BakeFile::open(&path).map(|_| ()).unwrap_err().to_string()
    };
    // The header's own checksum, made right again.
    let signed = |bytes: &mut Vec<u8>| {
        let sum = crc32(&bytes[..116]);
        bytes[116..120].copy_from_slice(&sum.to_le_bytes());
    };
    for (words, change) in [
        (["it is empty", "bake the scene"], &(|b: &mut Vec<u8>| b.clear()) as &dyn Fn(&mut Vec<u8>)),
        (["does not begin as one", "a.bake"], &|b: &mut Vec<u8>| b[0] = b'X'),
        (["version 2", "version 1"], &|b: &mut Vec<u8>| b[8] = 2),
        (["the header", "checksum"], &|b: &mut Vec<u8>| b[20] ^= 1),
        (["the header", "too short"], &|b: &mut Vec<u8>| b.truncate(60)),
        (["the world at byte 120", "bytes are there"], &|b: &mut Vec<u8>| b.truncate(300)),
        (["the world at byte 120", "checksum"], &|b: &mut Vec<u8>| b[200] ^= 1),
        (["the header", "number of nodes is 4294967295"], &|b: &mut Vec<u8>| {
            b[20..24].copy_from_slice(&u32::MAX.to_le_bytes());
            signed(b);
        }),
        (["the header", "rows of a block is 0"], &|b: &mut Vec<u8>| {
            b[28..32].copy_from_slice(&0u32.to_le_bytes());
            signed(b);
        }),
        (["the world at byte 120", "bytes are there"], &|b: &mut Vec<u8>| {
            b[104..112].copy_from_slice(&u64::MAX.to_le_bytes());
            signed(b);
        }),
    ] {
        let message = refused(change);
        assert!(words.iter().all(|word| message.contains(word)), "{words:?}: {message}");
    }
    let missing = BakeFile::open(&folder.path().join("none.bake")).map(|_| ()).unwrap_err().to_string();
    assert!(missing.contains("none.bake") && missing.contains("check that it exists"), "{missing}");
}

#[test]
fn wild_numbers_with_right_checksums_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bake");
    whole(&path);
    let good = fs::read(&path).unwrap();
    let (offset, length) = BakeFile::open(&path).unwrap().place(0).unwrap();
    let start = offset as usize;
    let end = offset as usize + length as usize;
    // Of the first row: share of the sky, lost share, scale of the factors, x of its first point.
    let point = start + 24 + 20 + 3 * 6;
    for (at, words) in
        [(start + 24, "of the sky"), (start + 28, "lost"), (start + 40, "shares"), (point, "a point lies")]
    {
        for wild in [f32::NAN, f32::INFINITY, -1e30, 1e30] {
            let mut bytes = good.clone();
            bytes[at..at + 4].copy_from_slice(&wild.to_le_bytes());
            let sum = crc32(&[&bytes[start..start + 20], &bytes[start + 24..end]].concat());
            bytes[start + 20..start + 24].copy_from_slice(&sum.to_le_bytes());
            fs::write(&path, bytes).unwrap();
            let file = BakeFile::open(&path).unwrap();
            let message = file.check().unwrap_err().to_string();
            assert!(message.contains("block 0 at byte") && message.contains(words), "{wild} at {at}: {message}");
            let mut store = Store::new(file, 1 << 20).unwrap();
            assert!(wait_for(&mut store, 0).is_err(), "{wild} at {at}");
        }
    }
    // The sky of the table at the end.
    let table = good.len() - 20 - 4 * nodes().len();
    let mut bytes = good.clone();
    bytes[table..table + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let tail = table - 16 * head(None).blocks() as usize;
    let sum = crc32(&bytes[tail..good.len() - 20]);
    bytes[good.len() - 12..good.len() - 8].copy_from_slice(&sum.to_le_bytes());
    fs::write(&path, &bytes).unwrap();
    let file = BakeFile::open(&path).unwrap();
    let lost: Vec<String> = file.lost().map(|error| error.to_string()).collect();
    assert!(file.sky.is_empty() && lost.len() == 1 && lost[0].contains("the table at its end"), "{lost:?}");
    // Unchanged, it is good.
    fs::write(&path, &good).unwrap();
    let file = BakeFile::open(&path).unwrap();
    assert!(file.check().is_ok() && file.lost().count() == 0);
}

/// CRC-32 (IEEE), as files have it.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| (sum >> 1) ^ (0xedb8_8320 & (sum & 1).wrapping_neg()))
    })
}

#[test]
fn a_full_disk_is_an_error_and_leaves_no_bake() {
    if !Path::new("/dev/full").exists() {
        println!("skipped: this system has no /dev/full");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bake");
    #[cfg(unix)]
    std::os::unix::fs::symlink("/dev/full", beginning(&path)).unwrap();
    let message = BakeWriter::create(&path, head(None), "", nodes(), Vec::new()).map(|_| ()).unwrap_err().to_string();
    assert!(message.contains("a.bake.beginning") && message.contains("room"), "{message}");
    assert!(!path.exists());
}

/// A disk that holds every block back until it is told to go on.
#[derive(Debug)]
struct Slow {
    file: Box<dyn Source>,
    go: Arc<AtomicBool>,
    reads: Arc<AtomicU64>,
}

impl Source for Slow {
    fn len(&self) -> std::io::Result<u64> {
        self.file.len()
    }

    fn with(&self, offset: u64, length: usize, use_bytes: &mut dyn FnMut(&[u8])) -> std::io::Result<()> {
        while !self.go.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(1));
        }
        self.reads.fetch_add(1, Ordering::SeqCst);
        self.file.with(offset, length, use_bytes)
    }

    fn again(&self) -> std::io::Result<Box<dyn Source>> {
        Ok(Box::new(Self { file: self.file.again()?, go: Arc::clone(&self.go), reads: Arc::clone(&self.reads) }))
    }
}

#[test]
fn a_disk_slower_than_the_camera_stalls_nobody() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bake");
    whole(&path);
    let go = Arc::new(AtomicBool::new(true));
    let reads = Arc::new(AtomicU64::new(0));
    let source = Slow { file: Box::new(Mapped::open(&path).unwrap()), go: Arc::clone(&go), reads: Arc::clone(&reads) };
    let file = BakeFile::of_source(&path, Box::new(source)).unwrap();
    go.store(false, Ordering::SeqCst);
    let mut store = Store::new(file, 1 << 20).unwrap();
    store.want(&[0, 20, 40]);
    // The disk never answers, and yet these come back: were one of them to wait, the test would not end.
    for _ in 0..100 {
        assert_eq!(store.row(0).unwrap(), None);
        store.want(&[0, 20, 40]);
    }
    assert!(!store.settle(Duration::from_millis(20)));
    // What is no longer wanted is not read.
    store.want(&[40]);
    let before = reads.load(Ordering::SeqCst);
    go.store(true, Ordering::SeqCst);
    assert!(store.settle(Duration::from_secs(20)));
    assert_eq!(store.row(40).unwrap(), Some(record(40).factors));
    assert_eq!(store.row(20).unwrap(), None);
    assert!(reads.load(Ordering::SeqCst) - before <= 2);
    // Dropping it ends its thread, also while the disk is slow.
    go.store(false, Ordering::SeqCst);
    store.want(&[50]);
    let release = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(30));
        go.store(true, Ordering::SeqCst);
    });
    drop(store);
    release.join().unwrap();
}

#[test]
fn the_cache_keeps_to_its_bound_and_what_is_asked_for_last() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bake");
    whole(&path);
    let file = BakeFile::open(&path).unwrap();
    let length = (0..file.head.blocks()).map(|block| file.place(block).unwrap().1).max().unwrap() as usize;
    let limit = 3 * (length + 4 * BLOCK_ROWS as usize);
    let mut store = Store::new(file, limit).unwrap();
    for round in 0..40u32 {
        let node = round * 17 % (LEAVES + PARENTS);
        assert!(!wait_for(&mut store, node).unwrap().is_empty());
        let state = store.state();
        assert!(state.bytes <= limit && state.blocks <= 3, "{state:?}");
    }
    // More than it holds is wanted: the most urgent come, and stay.
    let all: Vec<u32> = (0..LEAVES).collect();
    store.want(&all);
    assert!(store.settle(Duration::from_secs(20)));
    assert!(store.row(0).unwrap().is_some());
    assert!(store.state().blocks <= 3);
    // A bound that holds not one block still lets one through.
    let mut tight = Store::new(BakeFile::open(&path).unwrap(), 1).unwrap();
    let start = Instant::now();
    assert!(!wait_for(&mut tight, 12).unwrap().is_empty());
    assert_eq!(tight.state().blocks, 1);
    assert!(start.elapsed() < Duration::from_secs(20));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever happens to a byte, it is found, or what is read is as it was.
    #[test]
    fn no_altered_byte_goes_unnoticed(place in 0.0..1.0f64, bit in 0..8u32, cut in any::<bool>()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bake");
        whole(&path);
        let expected = BakeFile::open(&path).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        let at = (place * bytes.len() as f64) as usize;
        if cut { bytes.truncate(at) } else { bytes[at] ^= 1 << bit }
        let other = folder.path().join("b.bake");
        fs::write(&other, bytes).unwrap();
        let Ok(file) = BakeFile::open(&other) else { return Ok(()) };
        prop_assert_eq!(&file.nodes, &expected.nodes);
        for block in 0..file.head.blocks() {
            if let Ok(records) = file.records(block) {
                prop_assert_eq!(records, expected.records(block).unwrap());
            }
        }
    }
}
