//! A bake in the background.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use rayon::{ThreadPool, ThreadPoolBuilder};
use scene::Scene;
use transport::{Observer, Phase, Proceed};

use crate::bake::{Bake, BakeSettings};
use crate::error::{Error, Reason};
use crate::refine::{Refinement, edit, refine};

/// Position of a bake in its work.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BakeProgress {
    /// Phase under way; none before the first.
    pub phase: Option<Phase>,
    /// Steps of the phase that are done.
    pub done: u64,
    /// All steps of the phase.
    pub total: u64,
    /// Level under way, from 0, the coarsest.
    pub level: usize,
    /// Number of levels: 1 unless the bake is refined.
    pub levels: usize,
    /// Share of the whole work that is done, from 0 to 1, by an estimate; never less than before.
    pub share: f32,
}

/// A bake under way on a thread of its own, of [`Bake::start`] or [`Bake::refine`]. Dropping it cancels the bake and
/// does not wait.
#[must_use = "a job that is dropped is cancelled"]
pub struct BakeJob {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<Result<Arc<Bake>, Error>>>,
}

impl std::fmt::Debug for BakeJob {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BakeJob").field("progress", &self.progress()).finish_non_exhaustive()
    }
}

/// State that the bake's threads write and any thread reads.
#[derive(Default)]
pub(crate) struct Shared {
    progress: Mutex<BakeProgress>,
    /// Share of the work before the level under way, and that of the level.
    level: Mutex<(f32, f32)>,
    warnings: Mutex<Vec<String>>,
    newest: Mutex<Option<Arc<Bake>>>,
    is_cancelled: AtomicBool,
    is_paused: Mutex<bool>,
    resumed: Condvar,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What they guard is whole after every statement.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Shares of the time of a level that have passed when its phases begin: means of the built-in office with 4,000 patches
/// and of Sponza with 2,500, on two cores.
const BEGUN: [(Phase, f32); 8] = [
    (Phase::DENSITY, 0.0),
    (Phase::SAMPLE, 0.0),
    (Phase::FORM_FACTORS, 0.08),
    (Phase::BOUNCES, 0.15),
    (Phase::RECEIVERS, 0.15),
    (Phase::ENERGY, 0.73),
    (Phase::OPERATOR, 0.74),
    (Phase::COMPRESS, 0.8),
];

impl Shared {
    /// A level begins.
    pub fn begin_level(&self, level: usize, levels: usize, before: f32, own: f32) {
        *lock(&self.level) = (before, own);
        let mut progress = lock(&self.progress);
        progress.level = level;
        progress.levels = levels;
        progress.share = progress.share.max(before);
    }

    /// A level is done.
    pub fn publish(&self, bake: Arc<Bake>) {
        *lock(&self.newest) = Some(bake);
    }

    /// Blocks while the job is paused.
    fn wait_while_paused(&self) {
        let mut is_paused = lock(&self.is_paused);
        while *is_paused && !self.is_cancelled.load(Ordering::Relaxed) {
            is_paused = self.resumed.wait(is_paused).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn set_paused(&self, is_paused: bool) {
        *lock(&self.is_paused) = is_paused;
        self.resumed.notify_all();
    }

    /// Share of the whole work at a position in a phase.
    fn share(&self, phase: Phase, done: u64, total: u64) -> f32 {
        let (before, own) = *lock(&self.level);
        let Some(k) = BEGUN.iter().position(|begun| begun.0 == phase) else { return before };
        let end = BEGUN[k + 1..].iter().map(|begun| begun.1).find(|&share| share > BEGUN[k].1).unwrap_or(1.0);
        let of_phase = done as f32 / total.max(1) as f32;
        before + own * (BEGUN[k].1 + (end - BEGUN[k].1) * of_phase.min(1.0))
    }
}

impl Observer for Shared {
    fn progress(&self, phase: Phase, done: u64, total: u64) -> Proceed {
        self.wait_while_paused();
        let share = self.share(phase, done, total);
        let mut progress = lock(&self.progress);
        // Calls come from any thread, and may be a little behind an earlier one.
        let is_behind = progress.phase == Some(phase) && done < progress.done && total == progress.total;
        if !is_behind {
            *progress = BakeProgress { phase: Some(phase), done, total, share: progress.share.max(share), ..*progress };
        }
        if self.is_cancelled.load(Ordering::Relaxed) { Proceed::Break(()) } else { Proceed::Continue(()) }
    }

    fn warn(&self, text: &str) {
        lock(&self.warnings).push(text.to_owned());
    }
}

impl Bake {
    /// Begins [`Bake::build`] on a thread of its own: on all threads of a pool, or of a new one with as many as the
    /// caller's, so that frames of the host do not wait behind it. The bake has the same bytes for any number of
    /// threads.
    ///
    /// # Errors
    /// [`Device`](crate::ErrorKind::Device) where the system gives no thread.
    pub fn start(scene: &Scene, settings: &BakeSettings, pool: Option<Arc<ThreadPool>>) -> Result<BakeJob, Error> {
        let scene = scene.clone();
        let settings = *settings;
        BakeJob::spawn(pool, move |shared| {
            shared.begin_level(0, 1, 0.0, 1.0);
            Ok(Arc::new(Self::build(&scene, &settings, shared)?))
        })
    }

    /// Begins a bake that is there at once and becomes better: coarse [levels](crate::refine::levels) first, each with
    /// the operators of the [`Refinement`]'s methods, up to the settings asked for. [`BakeJob::take_newest`] gives each
    /// when it is done, [`crate::PictureRenderer::refine`] shows it. The last has the bytes of [`Bake::build`], for any
    /// number of threads and pauses.
    ///
    /// # Errors
    /// [`Device`](crate::ErrorKind::Device) where the system gives no thread.
    pub fn refine(scene: &Scene, settings: &BakeSettings, refinement: Refinement) -> Result<BakeJob, Error> {
        let scene = scene.clone();
        let settings = *settings;
        let pool = refinement.pool.clone();
        BakeJob::spawn(pool, move |shared| refine(&scene, &settings, refinement, shared))
    }

    /// Begins [`Bake::edit`] on a thread of its own. The new bake has the operators that this one has, and those of the
    /// [`Refinement`]'s methods; it has one level.
    ///
    /// # Errors
    /// [`Device`](crate::ErrorKind::Device) where the system gives no thread.
    pub fn start_edit(self: &Arc<Self>, scene: &Scene, refinement: Refinement) -> Result<BakeJob, Error> {
        let before = Arc::clone(self);
        let scene = scene.clone();
        let pool = refinement.pool.clone();
        BakeJob::spawn(pool, move |shared| {
            shared.begin_level(0, 1, 0.0, 1.0);
            edit(&before, &scene, refinement, shared)
        })
    }
}

impl BakeJob {
    fn spawn(
        pool: Option<Arc<ThreadPool>>,
        work: impl FnOnce(&Shared) -> Result<Arc<Bake>, Error> + Send + 'static,
    ) -> Result<Self, Error> {
        let pool = match pool {
            Some(pool) => pool,
            None => Arc::new(
                ThreadPoolBuilder::new()
                    .num_threads(rayon::current_num_threads())
                    .build()
                    .map_err(|error| Reason::Threads(error.to_string()))?,
            ),
        };
        let shared = Arc::new(Shared::default());
        let own = Arc::clone(&shared);
        let work = move || {
            let made = pool.install(|| work(&own))?;
            own.publish(Arc::clone(&made));
            lock(&own.progress).share = 1.0;
            Ok(made)
        };
        let thread = Builder::new().name("patchlight bake".to_owned()).spawn(work).map_err(Reason::Thread)?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Position of the bake in its work.
    pub fn progress(&self) -> BakeProgress {
        *lock(&self.shared.progress)
    }

    /// Warnings so far.
    pub fn warnings(&self) -> Vec<String> {
        lock(&self.shared.warnings).clone()
    }

    /// The newest level that is done, unless it was taken before.
    pub fn take_newest(&self) -> Option<Arc<Bake>> {
        lock(&self.shared.newest).take()
    }

    /// Lets the bake rest: its threads stop at the next step of their phase. Only with a pool that nothing else works
    /// on, such as the job's own.
    pub fn pause(&self) {
        self.shared.set_paused(true);
    }

    /// Lets a paused bake go on.
    pub fn resume(&self) {
        self.shared.set_paused(false);
    }

    /// Lets a paused bake work for a while, waits, and pauses it again: a share of each frame for programs that give
    /// their processors to nothing else meanwhile. Returns earlier when the bake has ended.
    pub fn run_for(&self, budget: Duration) {
        const LOOK: Duration = Duration::from_micros(200);
        self.resume();
        let start = std::time::Instant::now();
        while start.elapsed() < budget && !self.is_finished() {
            std::thread::sleep(LOOK.min(budget));
        }
        self.pause();
    }

    /// Asks the bake to end as soon as it can; [`Self::join`] then gives an error that
    /// [is cancelled](Error::is_cancelled).
    pub fn cancel(&self) {
        // Under the lock, so that no thread is between its look and its wait, and misses the call.
        let _paused = lock(&self.shared.is_paused);
        self.shared.is_cancelled.store(true, Ordering::Relaxed);
        self.shared.resumed.notify_all();
    }

    /// Returns true once [`Self::join`] waits for nothing.
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// The bake with the settings asked for; resumes it, and waits for it.
    ///
    /// # Errors
    /// As [`Bake::build`].
    pub fn join(mut self) -> Result<Arc<Bake>, Error> {
        self.resume();
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
