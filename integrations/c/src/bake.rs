//! Bakes, at once or in the background.

use std::ffi::{CString, c_char, c_int, c_void};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use patchlight::transport::Proceed;
use patchlight::{Bake, BakeJob, BakeSettings, Observer, Origin, Phase};

use crate::border::{Outcome, PlStatus, Sized32, free, give, guard, input, room, shared, structure, text};
use crate::scene::PlScene;

/// Called now and then while work goes on, from any thread, by one at a time: `done` of `total` steps of a phase. Another
/// result than 0 cancels the work.
pub type PlProgress =
    Option<unsafe extern "C" fn(user: *mut c_void, phase: *const c_char, done: u64, total: u64) -> c_int>;

/// Settings of a bake.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct PlBakeSettings {
    /// sizeof(PlBakeSettings).
    pub struct_size: usize,
    /// About how many patches.
    pub patch_count: usize,
    /// Rays of a receiver's row.
    pub receiver_rays: u32,
    /// Rays to area lights, and to a map of the sky, from each sample.
    pub sample_rays: u32,
    /// Bounces; 0 for all.
    pub bounces: u32,
    /// Changes every random number; the same seed, the same bytes.
    pub seed: u32,
    /// Most receivers; 0 for what suits the patches.
    pub most_receivers: usize,
    /// Most resident memory, bytes; 0 for what is free. More is refused before work begins.
    pub memory_limit: u64,
}

// SAFETY: plain numbers.
unsafe impl Sized32 for PlBakeSettings {
    const NAME: &'static str = "PlBakeSettings";
}

/// Sizes of a bake.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct PlBakeCounts {
    /// Patches.
    pub patches: usize,
    /// Elements.
    pub elements: usize,
    /// Places where direct light is measured.
    pub samples: usize,
    /// Receivers.
    pub receivers: usize,
    /// Points between the receivers, of which pl_field_surface gives the light.
    pub points: usize,
}

/// How far a background bake is.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct PlJobProgress {
    /// Share of the whole work, 0 to 1, by an estimate.
    pub share: f32,
    /// 1 when it has ended, for whatever reason.
    pub is_finished: c_int,
}

/// A scene with everything about it that does not shine. May be used by several threads at once.
pub struct PlBake(pub(crate) Arc<Bake>);

/// A bake in the background.
pub struct PlJob(BakeJob);

impl Default for PlBakeSettings {
    fn default() -> Self {
        let own = BakeSettings::default();
        Self {
            struct_size: size_of::<Self>(),
            patch_count: own.patch_count,
            receiver_rays: own.receiver_rays,
            sample_rays: own.sample_rays,
            bounces: 0,
            seed: 0,
            most_receivers: 0,
            memory_limit: 0,
        }
    }
}

impl PlBakeSettings {
    fn settings(&self) -> BakeSettings {
        BakeSettings::default()
            .with_patch_count(self.patch_count)
            .with_receiver_rays(self.receiver_rays)
            .with_sample_rays(self.sample_rays)
            .with_bounces((self.bounces > 0).then_some(self.bounces))
            .with_seed(self.seed)
            .with_most_receivers((self.most_receivers > 0).then_some(self.most_receivers))
            .with_memory_limit((self.memory_limit > 0).then_some(self.memory_limit))
    }
}

/// The caller's callback.
pub struct Caller {
    progress: PlProgress,
    user: Mutex<usize>,
}

impl Caller {
    /// A callback with its data.
    pub fn new(progress: PlProgress, user: *mut c_void) -> Self {
        Self { progress, user: Mutex::new(user as usize) }
    }
}

impl Observer for Caller {
    fn progress(&self, phase: Phase, done: u64, total: u64) -> Proceed {
        let Some(progress) = self.progress else { return ControlFlow::Continue(()) };
        let name = CString::new(phase.name()).unwrap_or_default();
        // One at a time.
        let user = self.user.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the caller's function, with the caller's data.
        let stops = unsafe { progress(*user as *mut c_void, name.as_ptr(), done, total) };
        if stops == 0 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    }
}

/// Fills a structure with its size and defaults.
///
/// # Safety
/// `settings` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_bake_settings_default(settings: *mut PlBakeSettings) {
    if !settings.is_null() {
        // SAFETY: as the caller promises.
        unsafe { settings.write(PlBakeSettings::default()) };
    }
}

/// Bakes a scene, on all cores; NULL settings are the defaults, a NULL callback is none.
///
/// # Safety
/// Pointers are what they say; the callback may be called from other threads.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_bake_build(
    scene: *const PlScene,
    settings: *const PlBakeSettings,
    progress: PlProgress,
    user: *mut c_void,
    out: *mut *mut PlBake,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let scene = unsafe { shared(scene, "scene") }?;
        // SAFETY: as the caller promises.
        let settings = unsafe { structure(settings, PlBakeSettings::default()) }?;
        let bake = Bake::build(&scene.0, &settings.settings(), &Caller::new(progress, user))?;
        // SAFETY: as the caller promises.
        unsafe { give(out, PlBake(Arc::new(bake))) }
    })
}

/// Begins a bake in the background; the scene may be freed.
///
/// # Safety
/// Pointers are what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_bake_start(
    scene: *const PlScene,
    settings: *const PlBakeSettings,
    out: *mut *mut PlJob,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let scene = unsafe { shared(scene, "scene") }?;
        // SAFETY: as the caller promises.
        let settings = unsafe { structure(settings, PlBakeSettings::default()) }?;
        let job = Bake::start(&scene.0, &settings.settings(), None)?;
        // SAFETY: as the caller promises.
        unsafe { give(out, PlJob(job)) }
    })
}

/// How far a bake is.
///
/// # Safety
/// Pointers are what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_job_progress(job: *const PlJob, out: *mut PlJobProgress) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let job = unsafe { shared(job, "job") }?;
        let progress = PlJobProgress { share: job.0.progress().share, is_finished: c_int::from(job.0.is_finished()) };
        // SAFETY: as the caller promises.
        unsafe { room(out, 1, "the place for the progress") }?[0] = progress;
        Ok(())
    })
}

/// Asks a bake to end as soon as it can; does not wait. May be called from any thread.
///
/// # Safety
/// The handle is live.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_job_cancel(job: *const PlJob) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        unsafe { shared(job, "job") }?.0.cancel();
        Ok(())
    })
}

/// Waits for a bake and gives it; the job ends in any case.
///
/// # Safety
/// The job is not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_job_wait(job: *mut PlJob, out: *mut *mut PlBake) -> PlStatus {
    guard(|| {
        if job.is_null() {
            return Err(input("job is NULL"));
        }
        // SAFETY: as the caller promises; it came from `give`.
        let own = unsafe { Box::from_raw(job) };
        let bake = own.0.join()?;
        // SAFETY: as the caller promises.
        unsafe { give(out, PlBake(bake)) }
    })
}

/// Cancels a bake and does not wait.
///
/// # Safety
/// It is NULL or not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_job_free(job: *mut PlJob) {
    // SAFETY: as the caller promises.
    unsafe { free(job) }
}

/// Opens a file of pl_bake_save, or of the program's `patchlight bake`.
///
/// # Safety
/// `path` ends with a zero; `out` may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_bake_open(path: *const c_char, out: *mut *mut PlBake) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let path = unsafe { text(path, "path") }?;
        let file = Bake::open(Path::new(path))?;
        // SAFETY: as the caller promises.
        unsafe { give(out, PlBake(Arc::new(file.bake))) }
    })
}

/// Writes a bake with its scene; a name for the scene, or NULL.
///
/// # Safety
/// Texts end with a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_bake_save(bake: *const PlBake, path: *const c_char, scene_name: *const c_char) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let bake = unsafe { shared(bake, "bake") }?;
        // SAFETY: as the caller promises.
        let path = unsafe { text(path, "path") }?;
        // SAFETY: as the caller promises.
        let name = if scene_name.is_null() { "scene" } else { unsafe { text(scene_name, "scene_name") }? };
        Ok(bake.0.save(Path::new(path), &Origin { scene: name.to_owned(), ..Origin::default() })?)
    })
}

/// Sizes of a bake.
///
/// # Safety
/// Pointers are what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_bake_counts(bake: *const PlBake, out: *mut PlBakeCounts) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let bake = unsafe { shared(bake, "bake") }?;
        let mesh = bake.0.mesh();
        let counts = PlBakeCounts {
            patches: mesh.patches.len(),
            elements: mesh.elements.len(),
            samples: mesh.points.len(),
            receivers: bake.0.receivers().points.len(),
            points: bake.0.receivers().interpolation.points.len(),
        };
        // SAFETY: as the caller promises.
        unsafe { room(out, 1, "the place for the counts") }?[0] = counts;
        Ok(())
    })
}

/// Ends a bake; light fields of it stay.
///
/// # Safety
/// It is NULL or not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_bake_free(bake: *mut PlBake) {
    // SAFETY: as the caller promises.
    unsafe { free(bake) }
}

/// What a bake is made of.
pub(crate) fn bake_of(bake: *const PlBake) -> Outcome<Arc<Bake>> {
    // SAFETY: as the callers of the functions above promise.
    Ok(Arc::clone(&unsafe { shared(bake, "bake") }?.0))
}
