//! Progress of long work, and its cancellation.

use core::fmt;
use core::ops::ControlFlow;

/// Continuation of long work: `Break(())` ends it as soon as it can.
pub type Proceed = ControlFlow<()>;

/// Long work tells how far it is and asks whether to go on.
///
/// A phase begins with `progress(phase, 0, total)` and ends with `progress(phase, total, total)`,
/// so that an implementation can measure its time. In between calls come from any thread, and
/// `done` may be a little behind an earlier one.
pub trait Observer: Sync {
    /// `done` of `total` steps of a phase are done; `Break` ends the work as soon as it can.
    fn progress(&self, phase: Phase, done: u64, total: u64) -> Proceed;

    /// A line worth telling the user.
    fn note(&self, text: &str) {
        let _ = text;
    }

    /// Something that was repaired or left out.
    fn warn(&self, text: &str) {
        let _ = text;
    }
}

/// A part of long work, by a name that stays the same from run to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Phase(pub &'static str);

impl Phase {
    /// It is found how densely surfaces are shared out.
    pub const DENSITY: Self = Self("density");
    /// Points are drawn on surfaces and made patches.
    pub const SAMPLE: Self = Self("sample");
    /// Rows of form factors are estimated.
    pub const FORM_FACTORS: Self = Self("form_factors");
    /// The number of bounces that light takes to settle is found.
    pub const BOUNCES: Self = Self("bounces");
    /// Receivers are placed, and their rows are estimated.
    pub const RECEIVERS: Self = Self("receivers");
    /// A bake is checked by rays of its own.
    pub const ENERGY: Self = Self("energy");
    /// The operator of all bounces is made.
    pub const OPERATOR: Self = Self("operator");
    /// An operator is compressed.
    pub const COMPRESS: Self = Self("compress");
    /// The eigenvalues by which progressive bounces are accelerated are found.
    pub const FEEDBACK: Self = Self("feedback");
    /// Sampling tables of rows are made.
    pub const TABLES: Self = Self("tables");
    /// Illumination maps are laid out.
    pub const MAPS: Self = Self("maps");
    /// Photons are traced.
    pub const PHOTONS: Self = Self("photons");
    /// Paths are traced.
    pub const PATHS: Self = Self("path tracing");
    /// The voxel grid of a world is found.
    pub const GRID: Self = Self("grid");
    /// The patches of a world are made.
    pub const PATCHES: Self = Self("patches");
    /// Rows of merged patches are made from those of their children.
    pub const MERGED: Self = Self("merged");
    /// Parts of a bake are joined.
    pub const JOIN: Self = Self("join");

    /// The phase's name.
    pub const fn name(self) -> &'static str {
        self.0
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.0)
    }
}

/// Tells nobody, and never stops.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {
    fn progress(&self, _: Phase, _: u64, _: u64) -> Proceed {
        ControlFlow::Continue(())
    }
}

/// The steps of one phase, reported to an observer.
#[derive(Clone, Copy)]
pub struct Steps<'a> {
    observer: &'a dyn Observer,
    phase: Phase,
}

impl<'a> Steps<'a> {
    /// The steps of a phase.
    pub fn new(observer: &'a dyn Observer, phase: Phase) -> Self {
        Self { observer, phase }
    }

    /// The phase.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Receives the steps.
    pub fn observer(&self) -> &'a dyn Observer {
        self.observer
    }

    /// `done` of `total` steps are done.
    pub fn report(&self, done: usize, total: usize) -> Proceed {
        self.observer.progress(self.phase, done as u64, total as u64)
    }

    /// Runs the whole phase: tells its begin, hands `work` the callback `(done, total)` that
    /// functions of this library take, and tells its end, whatever came of it.
    ///
    /// The answer to the begin is left to the next callback; the end is reported as one step of one,
    /// because only `work` knows how many there were.
    pub fn run<T>(&self, work: impl FnOnce(&(dyn Fn(usize, usize) -> Proceed + Sync)) -> T) -> T {
        let _ = self.report(0, 1);
        let result = work(&|done, total| self.report(done, total));
        let _ = self.report(1, 1);
        result
    }
}

impl fmt::Debug for Steps<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Steps").field("phase", &self.phase).finish_non_exhaustive()
    }
}
