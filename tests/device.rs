//! Devices: choice, messages, limits, transfers, clocks. Skipped without Vulkan, but for what must work without.

use std::sync::{Arc, Mutex};

use assets::import::load_or_build;
use glam::{Vec3, Vec4};
use gpu_kernels::params::CountParams;
use gpu_kernels::table::{ImageFormat, Kernel, TRANSPORT_BOUNCE, TRANSPORT_GATHER};
use integration_tests::vulkan;
use multibounce::{LowRank, TileSide, TileSource, halving_order};
use patches::PatchKind;
use patchlight::{Bake, BakeSettings, Estimator, FormFactors, ReceiverKind};
use runtime::cpu::Cpu;
use runtime::executor::{DeviceChoice, DeviceKind, Executor, ExecutorError, devices, open};
use runtime::plan::{BufferId, PassId, Plan};
use runtime::recipe::Tables;
use runtime::recipe::multibounce::{LowRankTables, OperatorTables, Product};
use runtime::recipe::walks::Walks;
use runtime::vulkan::ash::vk;
use runtime::vulkan::{Error, Validation, Vulkan};
use scene::kernel::walk;
use scene::sampling::{hash3, unit};
use scene::{SurfacePoint, reachability};
use transport::{LinearOperator, Observer, Phase, Proceed, Silent};

#[test]
fn a_bake_on_a_device_is_that_of_the_host() {
    let Some(mut vulkan) = vulkan() else { return };
    // Textured triangles, elements of clusters, receivers that see the sky.
    let loaded = load_or_build("atrium:3000").unwrap();
    let settings = BakeSettings::default()
        .with_patch_count(60)
        .with_estimator(Estimator::Hemisphere { rays: 256 })
        .with_receiver_rays(64);
    let rows = |bake: Bake| {
        let elements = bake.form_factors().element_rows.clone().unwrap();
        assert!(elements.rows() > bake.mesh().patches.len(), "elements are finer than patches");
        let receivers = bake.receivers();
        let mesh = &receivers.interpolation;
        let between = (mesh.points.clone(), mesh.vertices.clone(), receivers.weights.clone());
        let points = receivers.points.len();
        let sky = receivers.sky_rows.clone();
        let FormFactors { sky_factor, factors, .. } = bake.form_factors().clone();
        (points, elements, sky_factor, factors, receivers.rows.clone(), sky, between)
    };
    let own = rows(Bake::build(&loaded.scene, &settings, &Silent).unwrap());
    let notes = Notes::default();
    let build = |vulkan: &mut Vulkan, seed: u32| {
        rows(Bake::build_on(vulkan, &loaded.scene, &settings.with_seed(seed), &notes).unwrap())
    };
    assert!(own == build(&mut vulkan, 0));
    let told = notes.0.lock().unwrap().clone();
    for (phase, what) in [
        ("sample", "random walks from"),
        ("form_factors", "rays of rows"),
        ("receivers", "random walks from"),
        ("receivers", "rays of rows"),
        ("receivers", "rays from place to place"),
    ] {
        let is_it = |note: &&String| note.starts_with(phase) && note.contains(what);
        let note = told.iter().find(is_it).unwrap_or_else(|| panic!("{phase}: {told:?}"));
        assert!(note.contains(&vulkan.device().name), "{note}");
    }
    assert!(own != build(&mut vulkan, 1), "another seed is another bake");
}

/// Voxels whose samples are asked together whether light comes there: in the office some are inside of furniture.
#[test]
fn voxels_on_a_device_have_the_samples_of_the_host() {
    let Some(mut vulkan) = vulkan() else { return };
    let scene = load_or_build("office").unwrap().scene;
    let settings = BakeSettings::default()
        .with_patches(PatchKind::Voxel)
        .with_patch_count(60)
        .with_estimator(Estimator::Hemisphere { rays: 64 })
        .with_receivers(ReceiverKind::Patches);
    let own = Bake::build(&scene, &settings, &Silent).unwrap();
    let notes = Notes::default();
    let mut build = |seed: u32| Bake::build_on(&mut vulkan, &scene, &settings.with_seed(seed), &notes).unwrap();
    let theirs = build(0);
    assert!(theirs.mesh().points == own.mesh().points && theirs.mesh().patches == own.mesh().patches);
    assert!(theirs.form_factors().factors == own.form_factors().factors);
    assert!(build(1).mesh().points != own.mesh().points, "another seed is another bake");
    let told = notes.0.lock().unwrap().clone();
    let places = told.iter().filter(|note| note.starts_with("sample: random walks from")).count();
    assert_eq!(places, 2, "{told:?}");
}

/// Keeps what it is told.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Observer for Notes {
    fn progress(&self, _: Phase, _: u64, _: u64) -> Proceed {
        Proceed::Continue(())
    }

    fn note(&self, text: &str) {
        self.0.lock().unwrap().push(text.to_owned());
    }
}

/// In the office lamps hang in housings, and shelves and drawers are dark inside: walks of all lengths.
#[test]
fn walks_on_a_device_come_to_the_same_light() {
    let Some(vulkan) = vulkan() else { return };
    let scene = load_or_build("office").unwrap().scene;
    let place = |k: u32| {
        let triangle = k % scene.geometry.triangles.len() as u32;
        let u = 0.5 * unit(hash3(k, 0, 1));
        let v = 0.5 * unit(hash3(k, 1, 1));
        let normal = scene.tables().normal(triangle) * if (k / 7).is_multiple_of(2) { 1.0 } else { -1.0 };
        SurfacePoint { position: scene.tables().position(triangle, u, v), patch: k, normal, weight: 0.0 }
    };
    let mut places: Vec<SurfacePoint> = (0..3000).map(place).collect();
    let own: Vec<u32> = places.iter().map(|place| reachability(&scene, place, 8, 7)).collect();
    for part in [walk::APART, walk::DARK, walk::LIT] {
        let count = own.iter().filter(|p| **p == part).count();
        assert!(count > 20, "{count} of {part}");
    }
    let executors: [Box<dyn Executor>; 2] = [Box::new(Cpu::new()), Box::new(vulkan)];
    for mut executor in executors {
        let executor = executor.as_mut();
        let walks = Walks::load(executor, &scene).unwrap();
        assert!(walks.find(executor, &places, 8, 7).unwrap() == own);
        // From the other side it is another light.
        places.iter_mut().for_each(|place| place.normal = -place.normal);
        assert!(walks.find(executor, &places, 8, 7).unwrap() != own);
        places.iter_mut().for_each(|place| place.normal = -place.normal);
    }
}

/// `exitance = 1 + 0.5 * 2` for `count` elements, as a plan with its output and its pass.
fn small_plan(count: u32) -> (Plan, [BufferId; 4], PassId) {
    let mut plan = Plan::new();
    let ids = ["source", "albedo", "irradiance", "exitance"].map(|name| plan.storage(name, u64::from(count) * 16));
    let ranges = ids.map(Into::into);
    let pass = plan.pass("bounce", &TRANSPORT_BOUNCE, &ranges, &CountParams { count }).expect("a valid pass");
    (plan, ids, pass)
}

fn run_small_plan(executor: &mut dyn Executor) {
    let count = 200_000;
    let (plan, [source, albedo, irradiance, exitance], _) = small_plan(count);
    executor.load(plan).expect("the plan loads");
    for (id, value) in [(source, 1.0f32), (albedo, 0.5), (irradiance, 2.0)] {
        executor.upload(id, &vec![value; 4 * count as usize]).expect("the upload fits");
    }
    let times = executor.run().expect("the plan runs");
    assert!(times.len() == 1 && times[0].name == "bounce" && times[0].milliseconds > 0.0, "{times:?}");
    let found: Vec<f32> = executor.download_table(exitance).expect("the download works");
    assert!(found.iter().all(|&value| value == 2.0));
}

#[test]
fn choices_are_read_from_text() {
    let cases = [
        ("auto", DeviceChoice::Auto),
        ("CPU", DeviceChoice::Cpu),
        ("vulkan", DeviceChoice::Vulkan),
        ("integrated", DeviceChoice::Kind(DeviceKind::Integrated)),
        ("1", DeviceChoice::Index(1)),
        ("GeForce RTX", DeviceChoice::Name("GeForce RTX".into())),
    ];
    for (text, choice) in cases {
        assert_eq!(DeviceChoice::parse(text), choice);
    }
}

#[test]
fn auto_always_finds_something_and_says_when_it_falls_back() {
    let (mut executor, note) = open(&DeviceChoice::Auto).expect("auto never fails");
    assert_ne!(executor.device().kind, DeviceKind::EmulatedOnCpu, "native code is faster");
    assert_eq!(note.is_some(), executor.device().kind == DeviceKind::Native);
    run_small_plan(executor.as_mut());
}

#[test]
fn native_code_is_always_listed() {
    let (list, note) = devices();
    assert_eq!(list[0].kind, DeviceKind::Native);
    assert!(!list[0].name.is_empty());
    assert!(list.len() > 1 || note.is_some() || vulkan().is_none());
}

#[test]
fn a_missing_device_is_answered_with_the_devices_there_are() {
    let Some(vulkan) = vulkan() else { return };
    for wanted in ["no such card", "99"] {
        let error = match Vulkan::open(&DeviceChoice::parse(wanted), Validation::Off) {
            Err(error) => error,
            Ok(found) => panic!("{wanted} opened {}", found.device().name),
        };
        let text = error.to_string();
        assert!(text.contains(wanted) && text.contains(&vulkan.device().name), "{text}");
    }
}

#[test]
fn a_device_is_found_by_a_part_of_its_name_and_by_its_number() {
    let Some(vulkan) = vulkan() else { return };
    let info = vulkan.device().clone();
    let part: String = info.name.to_uppercase().chars().take(5).collect();
    for choice in [DeviceChoice::Name(part), DeviceChoice::Index(info.index.expect("Vulkan devices have numbers"))] {
        let (mut executor, note) = open(&choice).expect("the device is there");
        assert_eq!((&executor.device().name, note), (&info.name, None));
        run_small_plan(executor.as_mut());
    }
}

#[test]
fn nothing_is_said_by_the_validation_layer() {
    let Some(mut vulkan) = vulkan() else { return };
    if !vulkan.device().has_validation {
        println!("skipped: no validation layer");
        return;
    }
    let messages = vulkan.messages();
    run_small_plan(&mut vulkan);
    run_small_plan(&mut vulkan);
    drop(vulkan);
    // What was not freed is named while the device ends.
    assert_eq!(messages.take(), Vec::<String>::new());
}

#[test]
fn what_the_validation_layer_says_is_an_error() {
    let Some(mut vulkan) = vulkan() else { return };
    if !vulkan.device().has_validation {
        println!("skipped: no validation layer");
        return;
    }
    // A table row that forgets the last binding of its module.
    let mut kernel: Kernel = TRANSPORT_BOUNCE;
    kernel.bindings = &TRANSPORT_BOUNCE.bindings[..3];
    let kernel: &'static Kernel = Box::leak(Box::new(kernel));
    let mut plan = Plan::new();
    let ranges = ["a", "b", "c"].map(|name| plan.storage(name, 16).into());
    plan.pass("bounce", kernel, &ranges, &CountParams { count: 1 }).expect("valid as far as a plan can see");
    let error = vulkan.load(plan).expect_err("the layer sees it");
    assert!(matches!(error, ExecutorError::Vulkan(Error::Validation { .. })), "{error}");
}

#[test]
fn a_buffer_that_does_not_fit_is_named_and_the_device_goes_on() {
    let (mut native, _) = open(&DeviceChoice::Cpu).expect("native code is always there");
    let mut plan = Plan::new();
    plan.storage("operator", 1 << 60);
    let error = native.load(plan).expect_err("an exabyte does not fit");
    assert!(matches!(&error, ExecutorError::OutOfMemory { buffer, .. } if buffer == "operator"), "{error}");
    run_small_plan(native.as_mut());

    let Some(mut vulkan) = vulkan() else { return };
    let mut plan = Plan::new();
    plan.storage("operator", 1 << 46);
    let error = vulkan.load(plan).expect_err("64 TiB do not fit");
    assert!(matches!(&error, ExecutorError::Vulkan(Error::OutOfMemory { what, .. }) if what == "operator"), "{error}");
    assert!(error.to_string().contains("choose"), "a remedy: {error}");
    run_small_plan(&mut vulkan);
}

#[test]
fn a_range_beyond_the_limit_is_refused_with_pass_and_buffer() {
    let Some(mut vulkan) = vulkan() else { return };
    let limit = vulkan.device().max_storage_buffer_range;
    let mut plan = Plan::new();
    let factors = plan.storage("factors", (limit + 256).next_multiple_of(256));
    let ranges = [factors.into(), plan.storage("exitance", 16).into(), plan.storage("irradiance", 16).into()];
    let push = formfactor::GatherParams::default();
    plan.pass("product", &TRANSPORT_GATHER, &ranges, &push).expect("valid on a larger device");
    let text = vulkan.load(plan).expect_err("beyond maxStorageBufferRange").to_string();
    for word in ["product", "factors", "maxStorageBufferRange", "blocks"] {
        assert!(text.contains(word), "{text}");
    }
}

#[test]
fn bytes_come_back_as_they_went() {
    let Some(vulkan) = vulkan() else { return };
    let (native, _) = open(&DeviceChoice::Cpu).expect("native code is always there");
    // More than one staging buffer, and an odd end.
    let length = (17 << 20) + 3;
    let bytes: Vec<u8> = (0..length).map(|k: u32| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let executors: [Box<dyn Executor>; 2] = [native, Box::new(vulkan)];
    for mut executor in executors {
        let mut plan = Plan::new();
        let buffer = plan.storage("bytes", u64::from(length));
        let fresh = plan.storage("zeros", 1001);
        let wide = plan.image("wide", ImageFormat::Rgba32Float, 1031, 1001);
        let half = plan.image("half", ImageFormat::Rgba16Float, 3, 5);
        // 2303 x 2402 blocks of 8 bytes: more than one staging buffer, and blocks over both edges.
        let has_blocks = executor.device().has_block_images;
        let blocks = has_blocks.then(|| plan.image("blocks", ImageFormat::Bc1Rgb, 9209, 9605));
        let empty = plan.storage("empty", 0);
        executor.load(plan).expect("the plan loads");
        assert_eq!(executor.download(fresh).expect("readable"), vec![0; 1001], "new buffers are zeros");
        assert!(executor.download(wide).expect("readable").iter().all(|&b| b == 0), "new pictures are zeros");
        executor.upload(buffer, &bytes).expect("fits");
        let picture = &bytes[..1031 * 1001 * 16];
        executor.upload(wide, picture).expect("fits");
        executor.upload(half, &bytes[..120]).expect("fits");
        executor.upload(empty, &bytes[..0]).expect("fits");
        // The same bytes twice, the later ones stay.
        executor.upload_at(buffer, 5, &[1, 2, 3]).expect("fits");
        executor.upload_at(buffer, 6, &[9]).expect("fits");
        let found = executor.download(buffer).expect("readable");
        assert_eq!((&found[..5], &found[5..8]), (&bytes[..5], &[1u8, 9, 3][..]));
        assert!(found[8..] == bytes[8..], "the rest is unchanged");
        assert!(executor.download(wide).expect("readable") == picture);
        assert_eq!(executor.download(half).expect("readable"), &bytes[..120]);
        if let Some(blocks) = blocks {
            let size = 2303 * 2402 * 8;
            let content: Vec<u8> = bytes.iter().cycle().take(size).copied().collect();
            assert!(executor.download(blocks).expect("readable").iter().all(|&b| b == 0), "new pictures are zeros");
            executor.upload(blocks, &content).expect("fits");
            assert!(executor.download(blocks).expect("readable") == content);
            assert!(executor.upload(blocks, &content[1..]).is_err());
        }
        assert!(executor.download(empty).expect("readable").is_empty());
    }
}

#[test]
fn the_hosts_clock_serves_where_the_device_has_none() {
    let Some(mut vulkan) = vulkan() else { return };
    vulkan.use_host_clock();
    run_small_plan(&mut vulkan);
}

#[test]
fn buffers_stay_from_run_to_run_and_push_constants_change() {
    let Some(vulkan) = vulkan() else { return };
    let (native, _) = open(&DeviceChoice::Cpu).expect("native code is always there");
    let executors: [Box<dyn Executor>; 2] = [native, Box::new(vulkan)];
    for mut executor in executors {
        let (plan, [source, albedo, irradiance, exitance], pass) = small_plan(100);
        executor.load(plan).expect("the plan loads");
        for (id, value) in [(source, 1.0f32), (albedo, 0.5), (irradiance, 2.0)] {
            executor.upload(id, &[value; 400]).expect("the upload fits");
        }
        executor.run().expect("the plan runs");
        executor.upload(source, &[3.0f32; 400]).expect("the upload fits");
        executor.push(pass, &CountParams { count: 10 }).expect("the length is right");
        executor.run().expect("the plan runs");
        let found: Vec<f32> = executor.download_table(exitance).expect("the download works");
        assert!(found[..40].iter().all(|&v| v == 4.0) && found[40..].iter().all(|&v| v == 2.0), "{found:?}");
        executor.push(pass, &CountParams { count: 0 }).expect("the length is right");
        assert_eq!(executor.run_passes(&[pass, pass]).expect("nothing to do is no error").len(), 2);
    }
}

/// Values that the frames of [`frames_in_flight`] upload, and the number of elements that each of them works on.
const FRAME_SOURCES: [f32; 5] = [1.0, 2.0, 3.0, 4.0, 5.0];
const FRAME_COUNTS: [u32; 5] = [90, 50, 70, 20, 30];

/// Submits five frames without waiting. Each uploads a source of its own to one buffer; a pass adds it up into an
/// output of the frame, another one, with the frame's number of elements as push constant, into an output of all
/// frames. Gives the outputs of the frames, then the common one.
fn frames_in_flight(executor: &mut dyn Executor, counts: [u32; 5]) -> Vec<Vec<f32>> {
    let count = 100;
    let bytes = u64::from(count) * 16;
    let mut plan = Plan::new();
    let inputs = ["source", "albedo", "irradiance"].map(|name| plan.storage(name, bytes));
    let outputs: Vec<_> = (0..6).map(|k| plan.storage(format!("output {k}"), bytes)).collect();
    let mut passes = Vec::new();
    for &output in &outputs {
        let ranges = [inputs[0], inputs[1], inputs[2], output].map(Into::into);
        let push = CountParams { count };
        passes.push(plan.pass("bounce", &TRANSPORT_BOUNCE, &ranges, &push).expect("a valid pass"));
    }
    executor.load(plan).expect("the plan loads");
    executor.upload(inputs[1], &[0.5f32; 400]).expect("the upload fits");
    executor.clear(inputs[2]).expect("a storage buffer");
    for frame in 0..5 {
        executor.upload(inputs[0], &[FRAME_SOURCES[frame]; 400]).expect("the upload fits");
        executor.push(passes[5], &CountParams { count: counts[frame] }).expect("the length is right");
        executor.submit_passes(&[passes[frame], passes[5]]).expect("the passes are submitted");
    }
    // Nothing of this reaches the frames above.
    executor.upload(inputs[0], &[9.0f32; 400]).expect("the upload fits");
    executor.push(passes[5], &CountParams { count }).expect("the length is right");
    let times = executor.wait().expect("the device is well");
    assert!(times.len() == 10 && times.iter().all(|time| time.name == "bounce"), "{times:?}");
    assert!(times.iter().all(|time| time.kernel == "transport_bounce"), "{times:?}");
    assert!(executor.wait().expect("the device is well").is_empty(), "times are given once");
    let read = |&output: &BufferId| executor.download_table(output).expect("readable");
    outputs.iter().map(read).collect()
}

#[test]
fn frames_in_flight_keep_their_own_uploads_and_push_constants() {
    let Some(vulkan) = vulkan() else { return };
    let (native, _) = open(&DeviceChoice::Cpu).expect("native code is always there");
    // Fewer submissions than frames: the ring wraps around.
    let mut short = integration_tests::vulkan().expect("there was one");
    short.set_submissions_in_flight(2).expect("the device is well");
    let executors: [Box<dyn Executor>; 3] = [native, Box::new(vulkan), Box::new(short)];
    for mut executor in executors {
        let found = frames_in_flight(executor.as_mut(), FRAME_COUNTS);
        for (frame, source) in FRAME_SOURCES.iter().enumerate() {
            assert!(found[frame].iter().all(|value| value == source), "frame {frame}: {:?}", found[frame]);
        }
        // Element i is of the last frame that reached it.
        let last = |i: usize| (0..5).rev().find(|&frame| i < FRAME_COUNTS[frame] as usize);
        let expected: Vec<f32> =
            (0..100).flat_map(|i| [last(i).map_or(0.0, |frame| FRAME_SOURCES[frame]); 4]).collect();
        assert_eq!(found[5], expected);

        let mut shifted = FRAME_COUNTS;
        shifted.rotate_left(1);
        let other = frames_in_flight(executor.as_mut(), shifted);
        assert_ne!(other[5], expected, "push constants of another frame");
        assert_eq!(other[..5], found[..5]);
    }
}

#[test]
fn times_of_submitted_passes_come_without_waiting() {
    let Some(vulkan) = vulkan() else { return };
    let (native, _) = open(&DeviceChoice::Cpu).expect("native code is always there");
    let executors: [Box<dyn Executor>; 2] = [native, Box::new(vulkan)];
    for mut executor in executors {
        let (plan, [source, albedo, irradiance, _], pass) = small_plan(1000);
        executor.load(plan).expect("the plan loads");
        for id in [source, albedo, irradiance] {
            executor.clear(id).expect("a storage buffer");
        }
        assert!(executor.finished_times().expect("the device is well").is_empty());
        executor.submit_passes(&[pass]).expect("the pass is submitted");
        executor.submit_passes(&[]).expect("nothing to do is no error");
        let mut times = Vec::new();
        while times.is_empty() {
            times = executor.finished_times().expect("the device is well");
        }
        assert_eq!((times.len(), times[0].name.as_str()), (1, "bounce"));
        assert!(executor.finished_times().expect("the device is well").is_empty());
        // A run gives its own times only; those submitted before it are kept.
        executor.submit_passes(&[pass, pass]).expect("the passes are submitted");
        assert_eq!(executor.run_passes(&[pass]).expect("the pass runs").len(), 1);
        assert_eq!(executor.wait().expect("the device is well").len(), 2);
    }
}

#[test]
fn cleared_buffers_and_pictures_are_zeros_and_later_uploads_stay() {
    let Some(vulkan) = vulkan() else { return };
    let (native, _) = open(&DeviceChoice::Cpu).expect("native code is always there");
    let bytes: Vec<u8> = (0..5000u32).map(|k| (k % 255 + 1) as u8).collect();
    let executors: [Box<dyn Executor>; 2] = [native, Box::new(vulkan)];
    for mut executor in executors {
        let mut plan = Plan::new();
        let odd = plan.storage("odd", 1001);
        let plain = plan.image("plain", ImageFormat::Rgba32Float, 7, 5);
        let has_blocks = executor.device().has_block_images;
        let blocks = has_blocks.then(|| plan.image("blocks", ImageFormat::Bc7, 9, 5));
        let scratch = plan.scratch("scratch", 64);
        executor.load(plan).expect("the plan loads");
        let images = [Some((plain, 7 * 5 * 16)), blocks.map(|id| (id, 3 * 2 * 16))];
        for (id, size) in [(odd, 1001)].into_iter().chain(images.into_iter().flatten()) {
            executor.upload(id, &bytes[..size]).expect("fits");
            assert!(executor.download(id).expect("readable") == bytes[..size]);
            executor.clear(id).expect("not scratch");
            assert!(executor.download(id).expect("readable").iter().all(|&byte| byte == 0));
            executor.upload(id, &bytes[1..=size]).expect("fits");
            executor.clear(id).expect("not scratch");
            executor.upload(id, &bytes[2..size + 2]).expect("fits");
            assert!(executor.download(id).expect("readable") == bytes[2..size + 2], "the later upload stays");
        }
        assert!(executor.clear(scratch).is_err(), "a scratch buffer has no contents between frames");
    }
}

/// Operators from 300 patches to 421 receivers, in tiles of everything: rank-1 terms of 4 and 8 bits, dense sub-blocks,
/// sparse residual.
#[test]
fn tiles_of_receivers_have_the_same_bits_on_every_device() {
    let random = |a: usize, b: usize, c: u32| unit(hash3(a as u32, b as u32, c));
    let rows = |i: usize, each: &mut dyn FnMut(u32, f32)| {
        for j in (0..300).filter(|j| !(i + j).is_multiple_of(5)) {
            let x = i as f32 / 421.0 - j as f32 / 300.0;
            each(j as u32, (1.0 + random(i, j, 2)) / (0.003 + x * x));
        }
    };
    let line =
        |n: usize| halving_order(&(0..n).map(|i| Vec3::X * i as f32).collect::<Vec<_>>(), &vec![Vec3::Z; n], &[]);
    let area: Vec<f32> = (0..300).map(|j| 0.2 + random(j, 0, 1)).collect();
    let order = line(421);
    let patch_order = line(300);
    let receivers = TileSide { area: &[1.0; 421], order: &order };
    let patches = TileSide { area: &area, order: &patch_order };
    let tiles =
        LowRank::encode(TileSource::Rows { rows: &rows, receivers, patches }, 0.02, &|_, _| Proceed::Continue(()))
            .unwrap();
    let light: Vec<Vec4> =
        (0..300).map(|j| Vec4::new(random(j, 0, 9), random(j, 1, 9), random(j, 2, 9), 0.0)).collect();
    let mut expected = vec![Vec4::ZERO; 421];
    tiles.apply(&light, &mut expected).unwrap();
    let mut other = light.clone();
    other[299].y *= 2.0;
    let tiles = Arc::new(tiles);
    let check = |executor: &mut dyn Executor| {
        let make =
            |plan: &mut Plan, tables: &mut Tables| OperatorTables::LowRank(LowRankTables::new(plan, tables, &tiles));
        let product = Product::load(executor, 421, 300, u64::MAX, &make).unwrap();
        assert_eq!(product.run(executor, &light, 1).unwrap().0, expected);
        assert_ne!(product.run(executor, &other, 1).unwrap().0, expected);
    };
    check(&mut Cpu::new());
    if let Some(mut executor) = vulkan() {
        check(&mut executor);
    }
}

/// The message names what was asked for and what there is, and the device goes on.
#[test]
fn a_plan_beyond_the_memory_budget_is_refused_with_what_there_is() {
    let Some(mut vulkan) = vulkan() else { return };
    let plan = |bytes: u64| {
        let mut plan = Plan::new();
        plan.storage("first", 1 << 20);
        plan.storage("second", bytes);
        plan
    };
    vulkan.limit_memory(3 << 20);
    let error = vulkan.load(plan(4 << 20)).expect_err("beyond the budget");
    let is_it = |error: &ExecutorError| matches!(error, ExecutorError::Vulkan(Error::OutOfMemory { what, .. }) if what == "second");
    assert!(is_it(&error) && error.is_out_of_memory(), "{error}");
    let text = error.to_string();
    for part in ["`second`", "4194304 bytes", "of 3145728 bytes", "choose fewer patches"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    // What was loaded before counts, and is given back.
    for _ in 0..3 {
        vulkan.load(plan(1 << 20)).expect("within the budget");
    }
    vulkan.limit_memory(u64::MAX);
    vulkan.load(plan(4 << 20)).expect("without a budget");
    run_small_plan(&mut vulkan);
}

#[test]
fn a_lost_device_is_named_with_its_remedy() {
    let error = Error::Call { call: "vkQueueSubmit", result: vk::Result::ERROR_DEVICE_LOST };
    let text = ExecutorError::from(error).to_string();
    for part in ["vkQueueSubmit", "DEVICE_LOST", "reset", "fewer patches", "CPU executor"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let other = Error::Call { call: "vkQueueSubmit", result: vk::Result::ERROR_UNKNOWN }.to_string();
    assert!(!other.contains("reset"), "{other}");
}
