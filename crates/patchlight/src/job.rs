//! A bake in the background.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};

use rayon::ThreadPool;
use scene::Scene;
use transport::{Observer, Phase, Proceed};

use crate::bake::{Bake, BakeSettings};
use crate::error::{Error, Reason};

/// Position of a bake in its work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BakeProgress {
    /// Phase under way; none before the first.
    pub phase: Option<Phase>,
    /// Steps of the phase that are done.
    pub done: u64,
    /// All steps of the phase.
    pub total: u64,
}

/// A bake under way on a thread of its own, of [`Bake::start`]. Dropping it cancels the bake and does not wait.
#[must_use = "a job that is dropped is cancelled"]
#[derive(Debug)]
pub struct BakeJob {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<Result<Bake, Error>>>,
}

/// State that the bake's thread writes and any thread reads.
#[derive(Debug, Default)]
struct Shared {
    progress: Mutex<BakeProgress>,
    warnings: Mutex<Vec<String>>,
    is_cancelled: AtomicBool,
}

impl Observer for Shared {
    fn progress(&self, phase: Phase, done: u64, total: u64) -> Proceed {
        let mut progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        // Calls come from any thread, and may be a little behind an earlier one.
        let is_behind = progress.phase == Some(phase) && done < progress.done && total == progress.total;
        if !is_behind {
            *progress = BakeProgress { phase: Some(phase), done, total };
        }
        if self.is_cancelled.load(Ordering::Relaxed) { Proceed::Break(()) } else { Proceed::Continue(()) }
    }

    fn warn(&self, text: &str) {
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner).push(text.to_owned());
    }
}

impl Bake {
    /// Begins [`Bake::build`] on a thread of its own: on all threads of a pool, or of rayon's global one. The bake has
    /// the same bytes for any number of threads.
    ///
    /// # Errors
    /// [`Device`](crate::ErrorKind::Device) where the system gives no thread.
    pub fn start(scene: &Scene, settings: &BakeSettings, pool: Option<Arc<ThreadPool>>) -> Result<BakeJob, Error> {
        let shared = Arc::new(Shared::default());
        let observer = Arc::clone(&shared);
        let scene = scene.clone();
        let settings = *settings;
        let work = move || match pool {
            Some(pool) => pool.install(|| Self::build(&scene, &settings, observer.as_ref())),
            None => Self::build(&scene, &settings, observer.as_ref()),
        };
        let thread = Builder::new().name("patchlight bake".to_owned()).spawn(work).map_err(Reason::Thread)?;
        Ok(BakeJob { shared, thread: Some(thread) })
    }
}

impl BakeJob {
    /// Position of the bake in its work.
    pub fn progress(&self) -> BakeProgress {
        *self.shared.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Warnings so far.
    pub fn warnings(&self) -> Vec<String> {
        self.shared.warnings.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Asks the bake to end as soon as it can; [`Self::join`] then gives an error that
    /// [is cancelled](Error::is_cancelled).
    pub fn cancel(&self) {
        self.shared.is_cancelled.store(true, Ordering::Relaxed);
    }

    /// Returns true once [`Self::join`] waits for nothing.
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// The bake; waits for it.
    ///
    /// # Errors
    /// As [`Bake::build`].
    pub fn join(mut self) -> Result<Bake, Error> {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(outcome)) => outcome,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => Err(Error::cancelled()),
        }
    }
}

impl Drop for BakeJob {
    fn drop(&mut self) {
        self.cancel();
    }
}
