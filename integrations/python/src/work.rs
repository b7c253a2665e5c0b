//! Long work: on a thread of its own, while the caller's thread shows progress and looks for Ctrl-C.

use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use patchlight::transport::Proceed;
use patchlight::{Observer, Phase};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use std::ffi::CString;

/// How often the caller's thread looks.
const PERIOD: Duration = Duration::from_millis(50);

/// Takes what work tells, for the thread that waits for it.
#[derive(Default)]
pub struct Watcher {
    step: Mutex<Option<(Phase, u64, u64)>>,
    warnings: Mutex<Vec<String>>,
    is_cancelled: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What they guard is whole after every statement.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Watcher {
    /// Tells a step of work without phases, and asks whether to go on.
    pub fn step(&self, name: &'static str, done: usize, total: usize) -> Proceed {
        self.progress(Phase(name), done as u64, total as u64)
    }
}

impl Observer for Watcher {
    fn progress(&self, phase: Phase, done: u64, total: u64) -> Proceed {
        *lock(&self.step) = Some((phase, done, total));
        if self.is_cancelled.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn warn(&self, text: &str) {
        lock(&self.warnings).push(text.to_owned());
    }
}

/// Runs `work` without the interpreter's lock. `progress(phase, done, total)` is called now and then on the caller's
/// thread; an exception there, or Ctrl-C, cancels the work and is raised when it has ended.
pub fn run<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Watcher) -> PyResult<T> + Send,
) -> PyResult<T> {
    let watcher = &Watcher::default();
    let mut interruption = None;
    let outcome = thread::scope(|scope| {
        let worker = scope.spawn(move || work(watcher));
        let mut shown = None;
        while !worker.is_finished() {
            py.detach(|| wait(&worker));
            let step = *lock(&watcher.step);
            let seen = py.check_signals().and_then(|()| match (progress, step) {
                (Some(progress), Some((phase, done, total))) if step != shown => {
                    progress.call1((phase.name(), done, total)).map(drop)
                }
                _ => Ok(()),
            });
            shown = step;
            if let Err(error) = seen {
                interruption.get_or_insert(error);
                watcher.is_cancelled.store(true, Ordering::Relaxed);
            }
        }
        worker.join().unwrap_or_else(|panic| resume_unwind(panic))
    });
    if let Some(error) = interruption {
        return Err(error);
    }
    for text in lock(&watcher.warnings).drain(..) {
        warn(py, &text)?;
    }
    outcome
}

/// Waits until the work has ended, at most for a moment.
fn wait<T>(worker: &thread::ScopedJoinHandle<'_, T>) {
    let step = Duration::from_millis(1);
    let mut waited = Duration::ZERO;
    while waited < PERIOD && !worker.is_finished() {
        thread::sleep(step);
        waited += step;
    }
}

/// A warning of Python's.
pub fn warn(py: Python<'_>, text: &str) -> PyResult<()> {
    let text = CString::new(text.replace('\0', " "))?;
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 2)
}
