//! The executor on a caller's device: the same bits, nothing waited for, nothing of the caller's destroyed.
#![allow(unsafe_code)]

mod caller;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Duration;

use caller::{Caller, caller};
use gpu_kernels::params::CountParams;
use gpu_kernels::table::TRANSPORT_BOUNCE;
use patchlight_runtime::cpu::Cpu;
use patchlight_runtime::executor::{DeviceChoice, Executor, ExecutorError};
use patchlight_runtime::plan::{BufferId, PassId, Plan};
use patchlight_runtime::vulkan::ash::vk;
use patchlight_runtime::vulkan::{EnabledFeatures, Error, FEATURES, MAX_FRAMES, Vulkan};

const COUNT: u32 = 100;
const BYTES: u64 = COUNT as u64 * 16;

/// `exitance = source + albedo * irradiance` with irradiance 2 and albedo 0.5.
struct Scene {
    source: BufferId,
    exitance: BufferId,
    pass: PassId,
}

fn load(executor: &mut dyn Executor) -> Scene {
    let mut plan = Plan::new();
    let ids = ["source", "albedo", "irradiance", "exitance"].map(|name| plan.storage(name, BYTES));
    let push = CountParams { count: COUNT };
    let pass = plan.pass("bounce", &TRANSPORT_BOUNCE, &ids.map(Into::into), &push).expect("a valid pass");
    executor.load(plan).expect("the plan loads");
    executor.upload(ids[1], &[0.5f32; 4 * COUNT as usize]).expect("the upload fits");
    executor.upload(ids[2], &[2.0f32; 4 * COUNT as usize]).expect("the upload fits");
    Scene { source: ids[0], exitance: ids[3], pass }
}

/// Changes of a frame: the source of all elements, and the number of elements worked on.
#[derive(Clone, Copy)]
struct Frame {
    source: f32,
    count: u32,
}

const FRAMES: [Frame; 4] = [
    Frame { source: 0.1, count: 100 },
    Frame { source: 0.2, count: 60 },
    Frame { source: 0.3, count: 80 },
    Frame { source: 0.4, count: 10 },
];

fn set_frame(executor: &mut dyn Executor, scene: &Scene, frame: Frame) {
    executor.upload(scene.source, &[frame.source; 4 * COUNT as usize]).expect("the upload fits");
    executor.push(scene.pass, &CountParams { count: frame.count }).expect("the length is right");
}

/// The exitance after each frame, run one by one.
fn run_frames(executor: &mut dyn Executor, frames: &[Frame]) -> Vec<Vec<f32>> {
    let scene = load(executor);
    let mut found = Vec::new();
    for &frame in frames {
        set_frame(executor, &scene, frame);
        executor.run().expect("the plan runs");
        found.push(executor.download_table(scene.exitance).expect("readable"));
    }
    found
}

fn borrow(caller: &Caller) -> Vulkan {
    // SAFETY: the handles belong together and outlive the executor; the tests use the queue from one thread.
    unsafe { Vulkan::borrow(caller.lend()) }.expect("the device has all features")
}

/// Records each frame into a command buffer of the caller's, followed by a copy of the caller's own, and submits it
/// with a fence of its own; two frames are in flight. Gives what the copies found.
fn record_frames(caller: &Caller, vulkan: &mut Vulkan, frames: &[Frame]) -> Vec<Vec<f32>> {
    let scene = load(vulkan);
    let handle = vulkan.buffer(scene.exitance).expect("a storage buffer");
    assert_eq!((handle.offset, handle.bytes), (0, BYTES));
    let mut fences = Vec::new();
    let mut copies = Vec::new();
    for (number, &frame) in frames.iter().enumerate() {
        if number >= 2 {
            caller.wait(fences[number - 2]);
        }
        let commands = caller.begin();
        let copy = caller.host_buffer(BYTES);
        // SAFETY: the command buffer is the caller's, being recorded and submitted below to the same queue; the frame
        // two before, of the same slot, is finished. The copy lies in both buffers.
        unsafe { vulkan.begin_recording(commands, number % 2) }.expect("no other recording");
        set_frame(vulkan, &scene, frame);
        vulkan.submit_passes(&[scene.pass]).expect("the pass is recorded");
        vulkan.end_recording().expect("a recording");
        let region = [vk::BufferCopy { src_offset: handle.offset, dst_offset: 0, size: handle.bytes }];
        // SAFETY: the command buffer is being recorded; the region lies in both buffers.
        unsafe { caller.device.cmd_copy_buffer(commands, handle.buffer, copy.buffer, &region) };
        fences.push(caller.submit(commands));
        copies.push(copy);
    }
    for &fence in &fences[frames.len() - 2..] {
        caller.wait(fence);
    }
    copies.into_iter().map(|copy| caller.read(copy)).collect()
}

fn shifted() -> [Frame; 4] {
    let mut frames = FRAMES;
    for (k, frame) in frames.iter_mut().enumerate() {
        frame.count = FRAMES[(k + 1) % FRAMES.len()].count;
    }
    frames
}

#[test]
fn a_borrowed_device_gives_the_bits_of_our_own_and_stays_usable() {
    let Some(caller) = caller() else { return };
    let expected = run_frames(&mut Cpu::new(), &FRAMES);
    let mut own = Vulkan::open(&DeviceChoice::Vulkan, caller::validation()).expect("there is a device");
    assert_eq!(run_frames(&mut own, &FRAMES), expected);
    let mut first = borrow(&caller);
    let mut second = borrow(&caller);
    assert_eq!(first.device().name, second.device().name);
    assert_eq!(run_frames(&mut first, &FRAMES), expected);
    drop(first);
    assert_eq!(run_frames(&mut second, &FRAMES), expected);
    assert_ne!(run_frames(&mut second, &shifted()), expected);
    drop(second);
    assert_eq!(caller.end(), Vec::<String>::new(), "nothing is left on the device");
}

#[test]
fn recording_into_a_callers_command_buffer_gives_the_same_bits() {
    let Some(caller) = caller() else { return };
    let expected = run_frames(&mut Cpu::new(), &FRAMES);
    let mut vulkan = borrow(&caller);
    assert_eq!(record_frames(&caller, &mut vulkan, &FRAMES), expected);
    assert_ne!(record_frames(&caller, &mut vulkan, &shifted()), expected);
    assert_eq!(run_frames(&mut vulkan, &FRAMES), expected, "and submissions of our own after it");
    drop(vulkan);
    assert_eq!(caller.end(), Vec::<String>::new());
}

#[test]
fn a_recording_takes_more_bytes_than_one_staging_buffer_and_clears() {
    let Some(caller) = caller() else { return };
    let mut vulkan = borrow(&caller);
    let mut plan = Plan::new();
    let large = plan.storage("large", 40 << 20);
    let cleared = plan.storage("cleared", 1000);
    vulkan.load(plan).expect("the plan loads");
    let bytes: Vec<u8> = (0..40u32 << 20).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    vulkan.upload_at(cleared, 0, &[7; 1000]).expect("fits");
    for round in 0..2 {
        let commands = caller.begin();
        // SAFETY: the command buffer is being recorded and submitted below; the round before is finished.
        unsafe { vulkan.begin_recording(commands, 3) }.expect("no other recording");
        vulkan.upload_at(large, round, &bytes[..bytes.len() - 1]).expect("fits");
        vulkan.clear(cleared).expect("a storage buffer");
        vulkan.end_recording().expect("a recording");
        caller.wait(caller.submit(commands));
        let found = vulkan.download(large).expect("readable");
        assert!(found[round as usize..][..bytes.len() - 1] == bytes[..bytes.len() - 1]);
        assert_eq!(vulkan.download(cleared).expect("readable"), [0; 1000]);
    }
    drop(vulkan);
    assert_eq!(caller.end(), Vec::<String>::new());
}

#[test]
fn what_cannot_be_recorded_is_refused() {
    let Some(caller) = caller() else { return };
    let mut vulkan = borrow(&caller);
    let scene = load(&mut vulkan);
    set_frame(&mut vulkan, &scene, FRAMES[0]);
    let commands = caller.begin();
    // SAFETY: the command buffer is being recorded.
    let error = unsafe { vulkan.begin_recording(commands, MAX_FRAMES) }.expect_err("no such slot");
    assert!(matches!(error, Error::FrameSlot { frame: 8, count: 8 }), "{error}");
    assert!(matches!(vulkan.end_recording(), Err(Error::NotRecording)));
    // SAFETY: the command buffer is being recorded and submitted below.
    unsafe { vulkan.begin_recording(commands, 0) }.expect("no other recording");
    // SAFETY: as above.
    let again = unsafe { vulkan.begin_recording(commands, 1) };
    assert!(matches!(again, Err(Error::Recording { call: "begin_recording" })));
    let refusals = [vulkan.download(scene.exitance).err(), vulkan.run().err(), vulkan.load(Plan::new()).err()];
    for error in refusals {
        let error = error.expect("it would wait for the device");
        assert!(matches!(error, ExecutorError::Vulkan(Error::Recording { .. })), "{error}");
        assert!(error.to_string().contains("end_recording"), "a remedy: {error}");
    }
    vulkan.submit_passes(&[scene.pass]).expect("the pass is recorded");
    vulkan.end_recording().expect("a recording");
    caller.wait(caller.submit(commands));
    let found: Vec<f32> = (&mut vulkan as &mut dyn Executor).download_table(scene.exitance).expect("readable");
    assert_eq!(found, [1.1; 400]);
    let mut boxed: Box<dyn Executor> = Box::new(vulkan);
    assert!(boxed.as_vulkan().is_some_and(|vulkan| vulkan.buffer(scene.exitance).is_some()));
    assert!(Cpu::new().as_vulkan().is_none());
    drop(boxed);
    assert_eq!(caller.end(), Vec::<String>::new());
}

#[test]
fn frames_are_submitted_while_the_queue_is_busy() {
    let Some(caller) = caller() else { return };
    let mut vulkan = borrow(&caller);
    let scene = load(&mut vulkan);
    vulkan.wait().expect("the device is well");
    let gate = caller.close_gate();
    // Each of these would never return if it waited.
    for frame in &FRAMES[..3] {
        set_frame(&mut vulkan, &scene, *frame);
        vulkan.submit_passes(&[scene.pass]).expect("the pass is submitted");
    }
    set_frame(&mut vulkan, &scene, FRAMES[3]);
    assert!(vulkan.finished_times().expect("the device is well").is_empty(), "the queue is busy");
    caller.open(&gate);
    assert_eq!(vulkan.wait().expect("the device is well").len(), 3);
    let expected = run_frames(&mut Cpu::new(), &FRAMES[..3]).pop();
    let found: Vec<f32> = (&mut vulkan as &mut dyn Executor).download_table(scene.exitance).expect("readable");
    assert_eq!(Some(found), expected);
    caller.end_gate(gate);
    drop(vulkan);
    assert_eq!(caller.end(), Vec::<String>::new());
}

#[test]
fn an_executor_that_ends_waits_for_its_own_submissions_only() {
    let Some(caller) = caller() else { return };
    let mut vulkan = borrow(&caller);
    let scene = load(&mut vulkan);
    set_frame(&mut vulkan, &scene, FRAMES[0]);
    vulkan.submit_passes(&[scene.pass]).expect("the pass is submitted");
    let gate = caller.close_gate();
    let is_rescued = AtomicBool::new(false);
    let (dropped, rescue) = mpsc::channel();
    let rescuer = &caller;
    let closed = &gate;
    let rescued = &is_rescued;
    std::thread::scope(|scope| {
        // So that a mistake fails instead of hanging.
        scope.spawn(move || {
            if rescue.recv_timeout(Duration::from_secs(60)).is_err() {
                rescued.store(true, Ordering::Relaxed);
                rescuer.open(closed);
            }
        });
        drop(vulkan);
        // Fails when the other thread has given up waiting, which is noted.
        let _ = dropped.send(());
    });
    assert!(!is_rescued.load(Ordering::Relaxed), "it waited for the caller's submission");
    caller.open(&gate);
    caller.end_gate(gate);
    assert_eq!(caller.end(), Vec::<String>::new());
}

#[test]
fn a_missing_feature_is_named_with_its_remedy() {
    let Some(caller) = caller() else { return };
    for feature in FEATURES.iter().filter(|feature| feature.is_required) {
        let mut lent = caller.lend();
        lent.enabled = EnabledFeatures {
            vulkan_memory_model: feature.name != "vulkanMemoryModel",
            vulkan_memory_model_device_scope: feature.name != "vulkanMemoryModelDeviceScope",
            texture_compression_bc: false,
        };
        // SAFETY: the handles belong together; what is said of the features is refused before it is relied on.
        let error = unsafe { Vulkan::borrow(lent) }.err().expect("a feature is missing");
        assert!(matches!(error, Error::FeatureNotEnabled { .. }), "{error}");
        let text = error.to_string();
        for word in [feature.name, "enable_features"] {
            assert!(text.contains(word), "{text}");
        }
    }
    let mut lent = caller.lend();
    lent.queue_family = 99;
    // SAFETY: as above.
    let error = unsafe { Vulkan::borrow(lent) }.err().expect("no such family");
    assert!(matches!(error, Error::QueueFamily { family: 99, .. }), "{error}");

    let mut lent = caller.lend();
    lent.enabled.texture_compression_bc = false;
    // SAFETY: the handles belong together; the device offers more than it is said to.
    let vulkan = unsafe { Vulkan::borrow(lent) }.expect("an optional feature");
    assert!(!vulkan.device().has_block_images);
    drop(vulkan);
    assert_eq!(caller.end(), Vec::<String>::new());
}

/// The assertions above would not see a leak without this.
#[test]
fn the_layer_names_what_is_left_on_a_device() {
    let Some(caller) = caller() else { return };
    if !caller.has_layer() {
        println!("skipped: no validation layer");
        return;
    }
    let _left = caller.host_buffer(64);
    assert_ne!(caller.end(), Vec::<String>::new());
}
