//! Reference for the picture: paths that a thread traces while nothing moves, or a picture from a file.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use reference::metrics::{compare_pictures, difference_picture};
use reference::{Accumulation, PathSettings, PathTracer, Picture, PictureErrors, PictureFile as _};
use scene::{Camera, DisplayTransform, Materials, Scene, stops_to_scale};

use crate::error::Error;
use crate::live::rgba;

/// Paths a pixel after which it is enough.
const MAX_SAMPLES: u32 = 4096;
/// Most samples between two pictures of them.
const STEP: u32 = 32;
/// Relative difference that has the strongest colour.
const RANGE: f32 = 0.5;

/// Request for a comparison.
pub struct Job {
    /// The scene under its lights.
    pub scene: Scene,
    /// From where.
    pub camera: Camera,
    /// The picture.
    pub ours: Picture,
    /// Exposure and tone curve.
    pub transform: DisplayTransform,
    /// Reflection of surfaces.
    pub materials: Materials,
}

/// Result of a comparison so far.
pub struct Found {
    /// Paths a pixel; 0 for a file.
    pub samples: u32,
    /// The reference as it is displayed, bytes red, green, blue, 255.
    pub shown: Vec<u8>,
    /// Difference of the picture from it.
    pub difference: Option<Vec<u8>>,
    /// By how much.
    pub errors: Option<PictureErrors>,
}

/// Compares in a thread of its own.
pub struct Comparer {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    slot: Mutex<Slot>,
    wake: Condvar,
    /// Number of the job that is wanted; work for another one ends.
    wanted: AtomicU64,
    /// The picture of a file.
    file: Option<Arc<Picture>>,
    seed: u32,
    /// Told of everything that is found.
    tell: Box<dyn Fn() + Send + Sync>,
}

#[derive(Default)]
struct Slot {
    job: Option<(u64, Job)>,
    found: Option<(u64, Found)>,
    is_ended: bool,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Slot> {
        // What it guards is whole after every statement.
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_wanted(&self, number: u64) -> bool {
        self.wanted.load(Ordering::Relaxed) == number
    }

    fn put(&self, number: u64, found: Found) {
        self.lock().found = Some((number, found));
        (self.tell)();
    }
}

impl Comparer {
    /// Starts the thread; `tell` is called, in it, when something is found.
    pub fn new(file: Option<Arc<Picture>>, seed: u32, tell: Box<dyn Fn() + Send + Sync>) -> Self {
        let wanted = AtomicU64::new(0);
        let shared = Arc::new(Shared { slot: Mutex::default(), wake: Condvar::new(), wanted, file, seed, tell });
        let own = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("reference".into()).spawn(move || work(&own)).ok();
        Self { shared, thread }
    }

    /// Begins a comparison; one under way ends.
    pub fn start(&mut self, job: Job) {
        let mut slot = self.shared.lock();
        let number = self.shared.wanted.fetch_add(1, Ordering::Relaxed) + 1;
        slot.job = Some((number, job));
        slot.found = None;
        drop(slot);
        self.shared.wake.notify_one();
    }

    /// Ends the one under way.
    pub fn stop(&mut self) {
        let mut slot = self.shared.lock();
        self.shared.wanted.fetch_add(1, Ordering::Relaxed);
        slot.job = None;
        slot.found = None;
    }

    /// Takes the news of the comparison under way.
    pub fn take(&mut self) -> Option<Found> {
        let (number, found) = self.shared.lock().found.take()?;
        self.shared.is_wanted(number).then_some(found)
    }
}

impl Drop for Comparer {
    fn drop(&mut self) {
        self.stop();
        self.shared.lock().is_ended = true;
        self.shared.wake.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic there has been told by its own message.
            let _ = thread.join();
        }
    }
}

/// The thread: job after job, until the end.
fn work(shared: &Shared) {
    loop {
        let mut slot = shared.lock();
        while slot.job.is_none() && !slot.is_ended {
            slot = shared.wake.wait(slot).unwrap_or_else(PoisonError::into_inner);
        }
        if slot.is_ended {
            return;
        }
        let Some((number, job)) = slot.job.take() else { continue };
        drop(slot);
        match &shared.file {
            Some(file) => shared.put(number, compare(&job, file, 0)),
            None => trace(shared, number, &job),
        }
    }
}

/// Traces paths until there are enough or another job is wanted.
fn trace(shared: &Shared, number: u64, job: &Job) {
    let tracer = PathTracer::new(&job.scene);
    let settings = PathSettings { seed: shared.seed, materials: job.materials, ..PathSettings::default() };
    let mut sums = Accumulation::new(&job.camera, settings);
    let continues = |_: u32, _: u32| match shared.is_wanted(number) {
        true => ControlFlow::Continue(()),
        false => ControlFlow::Break(()),
    };
    while sums.samples() < MAX_SAMPLES {
        let target = (2 * sums.samples()).clamp(1, sums.samples() + STEP);
        if !matches!(tracer.accumulate(&job.camera, &mut sums, target, continues), Ok(true))
            || !shared.is_wanted(number)
        {
            return;
        }
        shared.put(number, compare(job, &sums.full(), sums.samples()));
    }
}

fn compare(job: &Job, expected: &Picture, samples: u32) -> Found {
    let scale = stops_to_scale(job.transform.stops);
    Found {
        samples,
        shown: rgba(expected, &job.transform),
        difference: difference_picture(&job.ours, expected, RANGE)
            .ok()
            .map(|picture| rgba(&picture, &DisplayTransform::default())),
        errors: compare_pictures(&job.ours, expected, scale, None).ok(),
    }
}

/// Returns true if a file holds displayed colours: of a tone curve in them nothing is known.
pub fn is_displayed(path: &Path) -> bool {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
    !["exr", "hdr"].contains(&ending.as_str())
}

/// Reads a reference: EXR and HDR as they are; what is displayed (PNG and others) as it was shown with an exposure.
///
/// # Errors
/// What the file says.
pub fn read(path: &Path, stops: f32) -> Result<Picture, Error> {
    let mut picture = Picture::read(path)?;
    if is_displayed(path) {
        let scale = stops_to_scale(stops);
        picture.pixels.iter_mut().for_each(|pixel| *pixel /= scale);
    }
    Ok(picture)
}
