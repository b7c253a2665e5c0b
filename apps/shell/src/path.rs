//! Path tracing: the CPU reference.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use reference::path::{PathSettings, PathTracer};
use reference::{Accumulation, BlockErrors, fingerprint};
use scene::{Camera, Scene};

use crate::error::Error;
use crate::progress::{Interruptible, Progress};
use patchlight::{Phase, Pictures};

/// A path-traced picture and its own standard errors.
pub struct PathPicture {
    /// The picture.
    pub pictures: Pictures,
    /// Relative standard errors of 8 × 8 block means of the full picture, from two passes on.
    pub full_errors: Option<BlockErrors>,
    /// Block errors of the indirect part.
    pub indirect_errors: Option<BlockErrors>,
}

/// Traces `samples` paths a pixel. With `saved`, an accumulation in that file is continued when `resume`, and one is
/// left there when the user stops the work.
///
/// # Errors
/// [`Error::Cancelled`], and what reading or writing the accumulation gives.
pub fn render(
    scene: &Scene,
    camera: &Camera,
    settings: PathSettings,
    samples: u32,
    saved: Option<&Path>,
    resume: bool,
    progress: &Progress,
) -> Result<PathPicture, Error> {
    // Until there is something to save.
    let nothing_new = Mutex::new(Some(Interruptible::begin()));
    let mut sums = Accumulation::new(camera, settings);
    let mark = fingerprint(scene, camera);
    if let (true, Some(path)) = (resume, saved) {
        if path.is_file() {
            sums = Accumulation::load(path, camera, settings, &mark)?;
            progress.note(&format!("resumed at {} samples a pixel", sums.samples()));
        } else {
            progress.warn(&format!("nothing to resume in {}; starting afresh", path.display()));
        }
    }
    let before = sums.samples();
    let tracer = PathTracer::new(scene);
    let finished = progress.phase(Phase::PATHS.name(), |report| {
        tracer.accumulate(camera, &mut sums, samples, |done, target| {
            if saved.is_some() && done > before {
                nothing_new.lock().unwrap_or_else(PoisonError::into_inner).take();
            }
            report(done as usize, target as usize)
        })
    })?;
    drop(nothing_new);
    // Sums of large pictures take seconds to save: not where there is nothing new in them.
    if let Some(path) = saved.filter(|_| finished || sums.samples() > before) {
        sums.save(path, &mark)?;
        if !finished {
            progress.warn(&format!(
                "{} of {samples} samples a pixel are saved in {}; continue with --resume",
                sums.samples(),
                path.display()
            ));
        }
    }
    if !finished {
        return Err(Error::Cancelled);
    }
    Ok(PathPicture {
        pictures: Pictures { full: sums.full(), direct: sums.direct(), indirect: sums.indirect() },
        full_errors: sums.full_errors(),
        indirect_errors: sums.indirect_errors(),
    })
}
