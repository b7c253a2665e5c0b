//! A bake in the background: progress, cancellation, a pool of the caller's.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Duration;

use patchlight::rayon::ThreadPoolBuilder;
use patchlight::{Bake, BakeSettings, ErrorKind, Observer, Scene, Silent};
use transport::{Phase, Proceed};

fn scene() -> Scene {
    assets::procedural::build("cornell").unwrap().scene
}

fn coarse() -> BakeSettings {
    BakeSettings::default().with_patch_count(150).with_receiver_rays(64).with_receiver_density(0.3)
}

#[test]
fn a_bake_in_the_background_is_the_one_in_the_foreground() {
    let pool = Arc::new(ThreadPoolBuilder::new().num_threads(3).build().unwrap());
    let job = Bake::start(&scene(), &coarse(), Some(pool)).unwrap();
    let mut phases = Vec::new();
    while !job.is_finished() {
        let progress = job.progress();
        assert!(progress.done <= progress.total);
        if phases.last() != progress.phase.as_ref() {
            phases.extend(progress.phase);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(phases.contains(&Phase::RECEIVERS) && phases.len() > 1, "{phases:?}");
    assert!(job.warnings().is_empty());
    let made = job.join().unwrap();
    let expected = Bake::build(&scene(), &coarse(), &Silent).unwrap();
    assert!(
        made.form_factors().factors == expected.form_factors().factors
            && made.receivers().rows == expected.receivers().rows
    );
    let other = Bake::build(&scene(), &coarse().with_seed(1), &Silent).unwrap();
    assert!(made.receivers().rows != other.receivers().rows, "another bake is noticed");
}

#[test]
fn a_bake_is_cancelled_from_another_thread() {
    let job = Bake::start(&scene(), &coarse().with_patch_count(2000), None).unwrap();
    std::thread::scope(|threads| {
        threads.spawn(|| job.cancel());
    });
    let error = job.join().err().expect("it was cancelled");
    assert!(error.is_cancelled() && error.kind() == ErrorKind::Cancelled, "{error}");
}

#[test]
fn a_paused_bake_is_cancelled_all_the_same() {
    let job = Bake::start(&scene(), &coarse().with_patch_count(2000), None).unwrap();
    job.pause();
    job.cancel();
    while !job.is_finished() {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(job.join().is_err_and(|error| error.is_cancelled()));
}

/// Says whether work runs on the threads of a pool.
struct InPool(usize);

impl Observer for InPool {
    fn progress(&self, phase: Phase, _: u64, _: u64) -> Proceed {
        assert_eq!(rayon::current_num_threads(), self.0, "{phase}");
        ControlFlow::Continue(())
    }
}

#[test]
fn the_pool_of_the_caller_does_all_the_work() {
    let pool = ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let bake = pool.install(|| Bake::build(&scene(), &coarse(), &InPool(3)));
    assert!(bake.is_ok());
    // On another pool it is noticed.
    let elsewhere = ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let seen = elsewhere.install(rayon::current_num_threads);
    assert_ne!(seen, 3);
}

#[test]
fn errors_have_one_of_six_kinds() {
    let too_large = coarse().with_memory_limit(Some(1 << 20));
    let error = Bake::build(&scene(), &too_large, &Silent).err().unwrap();
    assert_eq!(error.kind(), ErrorKind::Memory, "{error}");
    let error = Bake::open("no such.bake".as_ref()).err().unwrap();
    assert_eq!(error.kind(), ErrorKind::File, "{error}");
    let unsuited = coarse().with_receivers(patchlight::ReceiverKind::Patches);
    let error = Bake::build(&scene(), &unsuited, &Silent).err().unwrap();
    assert_eq!(error.kind(), ErrorKind::Unsupported, "{error}");
}
