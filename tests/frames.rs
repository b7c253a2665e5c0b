//! Frames with random lights, cameras, methods, materials and sizes: nothing fails, nothing is left behind.
//!
//! More of them: `cargo run --release -p integration-tests --bin frames -- 10000`.

use integration_tests::{frames, vulkan};
use runtime::cpu::Cpu;
use runtime::executor::Executor;

/// Frames of all scenes.
const FRAMES: u32 = 180;

fn check(open: &dyn Fn() -> Box<dyn Executor>) {
    let outcomes = frames::run(1, FRAMES, open, &|_, _| {}).unwrap();
    let mut changes = [0; 7];
    for (scene, found) in outcomes {
        assert!(found.checks > 0 && found.range.0 >= 0.0 && found.range.1 > 0.01, "{scene}: {found:?}");
        changes.iter_mut().zip(found.changes).for_each(|(sum, count)| *sum += count);
    }
    assert!(changes.iter().all(|&count| count > 0), "{changes:?}");
}

#[test]
fn random_frames_on_the_processor_leave_nothing_behind() {
    check(&|| Box::new(Cpu::new()));
}

#[test]
fn random_frames_on_the_device_leave_nothing_behind() {
    if vulkan().is_some() {
        check(&|| Box::new(vulkan().unwrap()));
    }
}
