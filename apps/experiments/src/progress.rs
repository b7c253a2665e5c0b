//! Progress of long work on the terminal, and its cancellation by Ctrl-C.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use patchlight::{Observer, Phase};

/// Set by Ctrl-C (or SIGTERM); long work is told so and ends in order.
static CANCELLED: AtomicBool = AtomicBool::new(false);

/// Makes Ctrl-C and SIGTERM ask for an orderly end; a second one ends the process at once.
///
/// # Errors
/// The system's, when no handler can be set.
pub fn watch_for_cancel() -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(|| {
        if CANCELLED.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        eprintln!("\nstopping; press Ctrl-C again to stop at once");
    })
}

/// Whether the user asked to stop.
pub fn is_cancelled() -> bool {
    CANCELLED.load(Ordering::SeqCst)
}

/// Shows phases of work on the terminal and keeps their times.
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
            eprintln!("{text}");
        }
    }

    /// Something the user should know even when quiet.
    pub fn warn(&self, text: &str) {
        eprintln!("warning: {text}");
    }

    /// Runs a phase of the program itself; the work tells the steps that are done, and is told whether to go on.
    pub fn phase<T>(&self, name: &'static str, work: impl FnOnce(&Steps) -> T) -> T {
        patchlight::run_phase(self, Phase(name), work)
    }

    /// Runs a short, repeated phase without a bar.
    pub fn timed<T>(&self, name: &str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
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
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn begin(&self, name: &'static str) {
        let target = if self.quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let bar = ProgressBar::with_draw_target(Some(STEPS), target);
        let style = ProgressStyle::with_template("{msg:24} [{bar:40}] {percent:>3} % {elapsed_precise} (left: {eta})");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
        bar.set_message(name);
        self.state().running.push(Running { name, start: Instant::now(), bar });
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

/// How work of the program tells its steps.
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
