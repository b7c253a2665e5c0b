//! Phases of long work, as an observer sees them.

use transport::{Observer, Phase, Proceed, Steps};

/// What functions of the method crates report their progress to.
pub type Report<'a> = dyn Fn(usize, usize) -> Proceed + Sync + 'a;

/// Runs a phase; the observer receives its beginning, its steps and its end.
pub fn run_phase<T>(observer: &dyn Observer, phase: Phase, work: impl FnOnce(&Report) -> T) -> T {
    Steps::new(observer, phase).run(work)
}
