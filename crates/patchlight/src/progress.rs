//! Progress of long work, and its cancellation.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Set by Ctrl-C (or SIGTERM); long work looks at it and ends in order.
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

/// Reports phases of work on the terminal and keeps their times.
#[derive(Debug, Default)]
pub struct Progress {
    /// No bars, no notes.
    pub quiet: bool,
    /// Seconds of each phase, in order.
    pub phases: Vec<(String, f64)>,
}

impl Progress {
    /// Progress on the terminal unless `quiet`.
    pub fn new(quiet: bool) -> Self {
        Self { quiet, phases: Vec::new() }
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

    /// Runs a phase with a bar. The work reports its share done in [0, 1]; it is answered `false` when it should stop.
    pub fn phase<T>(&mut self, name: &str, work: impl FnOnce(&(dyn Fn(f32) -> bool + Sync)) -> T) -> T {
        let bar = ProgressBar::with_draw_target(Some(1000), self.target());
        let style = ProgressStyle::with_template("{msg:24} [{bar:40}] {percent:>3} % {elapsed_precise} (left: {eta})");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
        bar.set_message(name.to_owned());
        let start = Instant::now();
        let result = work(&|share| {
            bar.set_position((share.clamp(0.0, 1.0) * 1000.0) as u64);
            !is_cancelled()
        });
        bar.finish_and_clear();
        let seconds = start.elapsed().as_secs_f64();
        self.phases.push((name.to_owned(), seconds));
        if seconds > 0.5 {
            self.note(&format!("{name:24} {seconds:8.2} s"));
        }
        result
    }

    /// Runs a short, repeated phase without a bar.
    pub fn timed<T>(&mut self, name: &str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        self.phases.push((name.to_owned(), start.elapsed().as_secs_f64()));
        result
    }

    /// Seconds spent in a phase, all its runs together.
    pub fn seconds(&self, name: &str) -> f64 {
        self.phases.iter().filter(|(n, _)| n == name).map(|(_, s)| s).sum()
    }

    fn target(&self) -> ProgressDrawTarget {
        if self.quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() }
    }
}
