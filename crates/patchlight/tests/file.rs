//! Bakes in files: the same light as without, the same bytes whatever interrupts them, and errors that say what is
//! wrong.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use patchlight::file::beginning_of;
use patchlight::low_level::operator::{Build, Codec};
use patchlight::method::TemporalSettings;
use patchlight::{
    Bake, BakeFile, BakeSettings, Error, FileSettings, LightSettings, MethodSettings, Observer, Origin, Phase,
    PictureRenderer, PictureSettings, Silent,
};
use runtime::cpu::Cpu;
use transport::Proceed;

const TILES: MethodSettings = MethodSettings::Multibounce(Codec::LowRank { epsilon: 0.02 });
const DENSE: MethodSettings = MethodSettings::Multibounce(Codec::Dense);

fn temporal() -> MethodSettings {
    MethodSettings::Temporal(TemporalSettings::default())
}

fn settings(seed: u32) -> FileSettings {
    let bake =
        BakeSettings::default().with_patch_count(150).with_receiver_density(0.1).with_receiver_rays(64).with_seed(seed);
    let origin = Origin { scene: "cornell".to_owned(), scene_hash: [7; 32], application: b"{}".to_vec() };
    FileSettings { origin, bake, methods: vec![TILES, DENSE, temporal()], build: Build::default() }
}

fn bake_into(path: &Path, settings: &FileSettings, observer: &dyn Observer) -> Result<Bake, Error> {
    let loaded = assets::load_or_build("cornell").unwrap();
    Bake::build_into(path, &loaded.scene, settings, &mut Cpu::new(), observer)
}

/// Indirect irradiance at the interpolation points.
fn light(bake: &Arc<Bake>, method: MethodSettings, observer: &dyn Observer) -> Vec<Vec3> {
    let loaded = assets::load_or_build("cornell").unwrap();
    let light = LightSettings::default().with_method(method);
    let pictures = PictureSettings::default().with_size((32, 24)).with_sub_frames(1);
    let mut renderer =
        PictureRenderer::of_bake(Arc::clone(bake), Box::new(Cpu::new()), &light, &pictures, observer).unwrap();
    renderer.update_light(&loaded.scene.lighting, &loaded.view.camera(32, 24)).unwrap();
    renderer.light_mut().surface_irradiance().unwrap()
}

/// Stops at the first step of a phase.
struct StopIn(Phase);

impl Observer for StopIn {
    fn progress(&self, phase: Phase, _: u64, _: u64) -> Proceed {
        if phase == self.0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

/// Fails where any operator is made.
struct NoOperator;

impl Observer for NoOperator {
    fn progress(&self, phase: Phase, _: u64, _: u64) -> Proceed {
        assert!(![Phase::OPERATOR, Phase::COMPRESS].contains(&phase), "an operator that the file has is made again");
        ControlFlow::Continue(())
    }
}

#[test]
fn a_bake_from_a_file_gives_the_same_light() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cornell.bake");
    let settings = settings(1);
    bake_into(&path, &settings, &Silent).unwrap();
    assert!(!beginning_of(&path).exists());
    let file = Bake::open(&path).unwrap();
    assert_eq!((&file.origin, file.bake.settings()), (&settings.origin, &settings.bake));
    let scene = assets::load_or_build("cornell").unwrap().scene;
    let built = Arc::new(Bake::build(&scene, &settings.bake, &Silent).unwrap());
    let opened = Arc::new(file.bake);
    let held = Bake::from_bytes("cornell", std::fs::read(&path).unwrap()).unwrap();
    assert_eq!(held.origin, settings.origin);
    assert!(light(&Arc::new(held.bake), TILES, &NoOperator) == light(&built, TILES, &Silent));
    for method in [TILES, DENSE, temporal(), MethodSettings::Classic] {
        assert!(light(&opened, method, &NoOperator) == light(&built, method, &Silent), "{method:?}");
    }
    let other = FileSettings { bake: settings.bake.with_seed(2), ..settings };
    let other = Arc::new(bake_into(&folder.path().join("other.bake"), &other, &Silent).unwrap());
    assert!(light(&other, TILES, &Silent) != light(&built, TILES, &Silent));
}

#[test]
fn a_bake_from_memory_has_the_bytes_of_one_that_was_written_while_it_was_made() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole.bake");
    let settings = settings(1);
    let made = bake_into(&whole, &settings, &Silent).unwrap();
    let saved = folder.path().join("saved.bake");
    // What an interrupted run left there is not taken for a part of this one.
    bake_into(&saved, &settings, &StopIn(Phase::RECEIVERS)).err().unwrap();
    made.save(&saved, &settings.origin).unwrap();
    assert!(!beginning_of(&saved).exists());
    assert!(std::fs::read(&saved).unwrap() == std::fs::read(&whole).unwrap());
    // Another scene's beginning, and what is no bake, stay as they are.
    let other = FileSettings { bake: settings.bake.with_seed(2), ..settings.clone() };
    let begun = folder.path().join("begun.bake");
    bake_into(&begun, &other, &StopIn(Phase::RECEIVERS)).err().unwrap();
    let error = made.save(&begun, &settings.origin).unwrap_err();
    assert!(error.to_string().contains("begun.bake") && beginning_of(&begun).exists(), "{error}");
    let text = folder.path().join("text.bake");
    std::fs::write(&text, "a diary").unwrap();
    assert!(made.save(&text, &settings.origin).is_err());
    assert_eq!(std::fs::read_to_string(&text).unwrap(), "a diary");
}

#[test]
fn a_file_for_frames_is_smaller_and_has_the_same_light() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, frames] = ["whole.bake", "frames.bake"].map(|name| folder.path().join(name));
    let settings = settings(1);
    let scene = assets::load_or_build("cornell").unwrap().scene;
    let bake = Bake::build(&scene, &settings.bake, &Silent).unwrap();
    bake.save(&whole, &settings.origin).unwrap();
    bake.save_for_frames(&frames, &settings.origin).unwrap();
    let bytes = |path: &Path| std::fs::metadata(path).unwrap().len();
    assert!(10 * bytes(&frames) < 9 * bytes(&whole), "{} {}", bytes(&frames), bytes(&whole));
    let file = Bake::open(&frames).unwrap();
    assert_eq!((&file.origin, file.bake.settings()), (&settings.origin, &settings.bake));
    let kept = Arc::new(file.bake);
    // Form factors are made of the same rows.
    let factors = |bake: &Bake| (bake.form_factors().factors.clone(), bake.form_factors().element_rows.clone());
    assert_eq!(factors(&kept), factors(&bake));
    let bake = Arc::new(bake);
    let [exact, near] = [&bake, &kept].map(|bake| light(bake, MethodSettings::Classic, &Silent));
    let sum: f32 = exact.iter().map(|value| value.element_sum()).sum();
    let error: f32 = exact.iter().zip(&near).map(|(a, b)| (*a - *b).abs().element_sum()).sum();
    assert!(sum > 0.0 && error > 0.0 && error < 1e-3 * sum, "{error} of {sum}");
    // Edits make it anew.
    let edited = kept.edit(&scene, &Silent).unwrap();
    assert_eq!(edited.bake.mesh().patches.len(), bake.mesh().patches.len());
    let mut cut = std::fs::read(&frames).unwrap();
    let middle = cut.len() / 2;
    cut[middle] ^= 1;
    let error = Bake::from_bytes("cut", cut).err().unwrap().to_string();
    assert!(error.contains("checksum"), "{error}");
}

#[test]
fn interruptions_change_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole.bake");
    bake_into(&whole, &settings(1), &Silent).unwrap();
    let whole = std::fs::read(whole).unwrap();
    let path = folder.path().join("cornell.bake");
    for phase in [Phase::FORM_FACTORS, Phase::RECEIVERS, Phase::COMPRESS] {
        let stopped = bake_into(&path, &settings(1), &StopIn(phase)).err().unwrap();
        assert!(stopped.is_cancelled(), "{phase}: {stopped}");
        assert!(!path.exists() && beginning_of(&path).exists());
    }
    // As a process that is killed leaves it: somewhere in a section.
    let begun = std::fs::read(beginning_of(&path)).unwrap();
    for share in [0.0, 0.001, 0.3, 0.6, 0.99] {
        std::fs::write(beginning_of(&path), &begun[..(share * begun.len() as f64) as usize]).unwrap();
        bake_into(&path, &settings(1), &Silent).unwrap();
        assert!(std::fs::read(&path).unwrap() == whole, "cut at {share}");
    }
}

#[test]
fn what_is_no_whole_bake_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cornell.bake");
    bake_into(&path, &settings(1), &Silent).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let refused = |bytes: &[u8]| {
        let path = folder.path().join("damaged.bake");
        std::fs::write(&path, bytes).unwrap();
        let error = |found: Result<BakeFile, Error>| found.err().map(|error| error.to_string()).unwrap_or_default();
        let text = error(Bake::open(&path));
        // What came over a network is looked at as closely; only the end is told in other words.
        let in_memory = error(Bake::from_bytes(&path.display().to_string(), bytes.to_vec()));
        assert_eq!(text.replace("the file ends", "the bytes end"), in_memory);
        text
    };
    for at in (0..bytes.len()).step_by(bytes.len() / 50) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        let text = refused(&damaged);
        assert!(text.contains("damaged.bake"), "byte {at}: {text}");
    }
    for share in [0.0, 0.1, 0.5, 0.999] {
        let text = refused(&bytes[..(share * bytes.len() as f64) as usize]);
        assert!(text.contains("damaged.bake"), "cut at {share}: {text}");
    }
    assert!(refused(b"solid triangles").contains("is no bake"));
    assert_eq!(refused(&bytes), "");
}

#[test]
fn other_files_are_not_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notes.txt");
    std::fs::write(&path, "mine").unwrap();
    assert!(bake_into(&path, &settings(1), &Silent).is_err());
    assert_eq!(std::fs::read(&path).unwrap(), b"mine");
    // The beginning of another bake stays, too.
    let path = folder.path().join("cornell.bake");
    assert!(bake_into(&path, &settings(1), &StopIn(Phase::RECEIVERS)).is_err());
    let begun = std::fs::read(beginning_of(&path)).unwrap();
    let text = bake_into(&path, &settings(2), &Silent).err().unwrap().to_string();
    assert!(text.contains("cornell.bake.beginning") && text.contains("other settings"), "{text}");
    assert_eq!(std::fs::read(beginning_of(&path)).unwrap(), begun);
}
