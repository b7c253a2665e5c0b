//! Progress of long work on the terminal, and its cancellation by Ctrl-C.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use patchlight::{Observer, Phase};

/// Exit code after Ctrl-C or SIGTERM.
pub const STOPPED: u8 = 130;
/// Time in which work that is told to stop ends by itself.
const GRACE: Duration = Duration::from_millis(500);
/// Time between looks at whether it may be ended.
const LOOK: Duration = Duration::from_millis(20);

/// Set by Ctrl-C (or SIGTERM); long work is told so and ends in order.
static CANCELLED: AtomicBool = AtomicBool::new(false);
/// Number of open scopes of [`interruptible`] work.
static INTERRUPTIBLE: Mutex<usize> = Mutex::new(0);
/// A file in which work that was stopped goes on.
static CONTINUED_IN: Mutex<Option<PathBuf>> = Mutex::new(None);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What they guard is whole after every statement.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Makes Ctrl-C and SIGTERM ask for an orderly end; a second one ends the process at once. Work that is
/// [`interruptible`] ends within a second even where it does not ask whether it should.
///
/// # Errors
/// The system's, when no handler can be set.
pub fn watch_for_cancel() -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(|| {
        if CANCELLED.swap(true, Ordering::SeqCst) {
            std::process::exit(STOPPED.into());
        }
        tell!("\nstopping; press Ctrl-C again to stop at once");
        // Without this thread the work ends when it asks.
        let _ = std::thread::Builder::new().name("stop".to_owned()).spawn(end_soon);
    })
}

/// Ends the process after the grace as soon as no file can be half-written.
fn end_soon() {
    std::thread::sleep(GRACE);
    loop {
        // Held to the end: nothing leaves its scope, and begins to write, meanwhile.
        let open = lock(&INTERRUPTIBLE);
        if *open > 0 {
            tell_stopped();
            std::process::exit(STOPPED.into());
        }
        drop(open);
        std::thread::sleep(LOOK);
    }
}

/// Returns true if the user asked to stop.
pub fn is_cancelled() -> bool {
    CANCELLED.load(Ordering::SeqCst)
}

/// Says that the work has stopped, and where it goes on.
pub fn tell_stopped() {
    match lock(&CONTINUED_IN).as_ref().filter(|path| path.exists()) {
        Some(path) => tell!("stopped; {} keeps what is done, and the same command goes on from it", path.display()),
        None => tell!("stopped; nothing was left half-written"),
    }
}

/// Names the file in which work that is stopped goes on, where there is one by then.
pub fn continue_in(path: PathBuf) {
    *lock(&CONTINUED_IN) = Some(path);
}

/// Runs work that may be cut off anywhere: it writes no file, or only one that another run goes on from.
pub fn interruptible<T>(work: impl FnOnce() -> T) -> T {
    let _scope = Interruptible::begin();
    work()
}

/// Counts as [`interruptible`] work until it is dropped.
#[derive(Debug)]
pub struct Interruptible(());

impl Interruptible {
    /// Begins such work.
    pub fn begin() -> Self {
        *lock(&INTERRUPTIBLE) += 1;
        Self(())
    }
}

impl Drop for Interruptible {
    fn drop(&mut self) {
        *lock(&INTERRUPTIBLE) -= 1;
    }
}

/// Shows phases of work on the terminal and keeps their times. Phases are [`interruptible`], but for path tracing,
/// which is so only until it has something to save.
#[derive(Debug, Default)]
pub struct Progress {
    /// No bars, no notes.
    pub quiet: bool,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    running: Vec<Running>,
    /// Seconds of each phase, in order.
    finished: Vec<(String, f64)>,
}

#[derive(Debug)]
struct Running {
    name: &'static str,
    start: Instant,
    bar: ProgressBar,
    _scope: Option<Interruptible>,
}

/// Steps of a bar.
const STEPS: u64 = 1000;

impl Progress {
    /// Progress on the terminal unless `quiet`.
    pub fn new(quiet: bool) -> Self {
        Self { quiet, ..Self::default() }
    }

    /// A line for the user.
    pub fn note(&self, text: &str) {
        if !self.quiet {
            tell!("{text}");
        }
    }

    /// Something the user should know even when quiet.
    pub fn warn(&self, text: &str) {
        tell!("warning: {text}");
    }

    /// Runs a phase of the program itself; the work tells the steps that are done, and is told whether to go on.
    pub fn phase<T>(&self, name: &'static str, work: impl FnOnce(&Steps) -> T) -> T {
        patchlight::run_phase(self, Phase(name), work)
    }

    /// Runs a short, repeated phase without a bar; it is [`interruptible`].
    pub fn timed<T>(&self, name: &str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = interruptible(work);
        self.state().finished.push((name.to_owned(), start.elapsed().as_secs_f64()));
        result
    }

    /// Seconds spent in a phase, all its runs together.
    pub fn seconds(&self, name: &str) -> f64 {
        self.state().finished.iter().filter(|(n, _)| n == name).map(|(_, s)| s).sum()
    }

    /// Seconds of each phase that has ended, in order.
    pub fn phases(&self) -> Vec<(String, f64)> {
        self.state().finished.clone()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    fn begin(&self, name: &'static str) {
        if self.state().running.iter().any(|running| running.name == name) {
            return;
        }
        let target = if self.quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let bar = ProgressBar::with_draw_target(Some(STEPS), target);
        let style = ProgressStyle::with_template("{msg:24} [{bar:40}] {percent:>3} % {elapsed_precise} (left: {eta})");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
        bar.set_message(name);
        let scope = (name != Phase::PATHS.name()).then(Interruptible::begin);
        self.state().running.push(Running { name, start: Instant::now(), bar, _scope: scope });
    }

    fn end(&self, name: &'static str) {
        let ended = {
            let mut state = self.state();
            let Some(place) = state.running.iter().position(|running| running.name == name) else { return };
            let ended = state.running.remove(place);
            let seconds = ended.start.elapsed().as_secs_f64();
            state.finished.push((name.to_owned(), seconds));
            (ended.bar, seconds)
        };
        let (bar, seconds) = ended;
        bar.finish_and_clear();
        if seconds > 0.5 {
            self.note(&format!("{name:24} {seconds:8.2} s"));
        }
    }
}

/// Progress callback of a program's work.
pub type Steps<'a> = dyn Fn(usize, usize) -> ControlFlow<()> + Sync + 'a;

impl Observer for Progress {
    fn progress(&self, phase: Phase, done: u64, total: u64) -> ControlFlow<()> {
        match (done, total) {
            (0, 1) => self.begin(phase.name()),
            (1, 1) => self.end(phase.name()),
            _ => {
                let state = self.state();
                if let Some(running) = state.running.iter().find(|running| running.name == phase.name()) {
                    running.bar.set_position((STEPS * done.min(total)) / total.max(1));
                }
            }
        }
        if is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn note(&self, text: &str) {
        Self::note(self, text);
    }

    fn warn(&self, text: &str) {
        Self::warn(self, text);
    }
}
