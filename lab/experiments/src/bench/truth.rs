//! References of pictures and points.

use std::path::Path;

use glam::Vec3;
use patches::{Density, LitSampler};
use reference::metrics::{compare_pictures, indirect_scale, quantile};
use reference::path::{PathSettings, PathTracer};
use reference::{Picture, ReferenceData};
use scene::math::luminance;
use scene::{Light, NONE, SurfacePoint};
use serde::{Deserialize, Serialize};

use crate::error::Error;
use crate::path;
use crate::progress::Progress;
use assets::import::LoadedScene;
use patchlight::Pictures;

/// Points of a path-traced reference, and paths of each for every path of a pixel.
const POINTS: u32 = 512;
const POINT_PATHS: u32 = 8;
/// Probe samples whose reachability is tested before points are placed.
const POINT_PROBE_SAMPLES: u32 = 8192;
/// Difference of the seeds of two independent halves.
const OTHER_HALF: u32 = 0x6861_6c66;

/// Pictures and points to compare with.
pub struct Truth {
    /// The pictures.
    pub pictures: Pictures,
    /// Points, and the indirect irradiance at them, W/m².
    pub points: Vec<SurfacePoint>,
    pub point_indirect: Vec<Vec3>,
    /// Noise of the pictures, where known.
    pub noise: Option<Noise>,
    /// Source.
    pub source: String,
}

/// Errors of a path-traced picture of indirect light: those of one of two independent halves against the mean of both,
/// which differs from the truth as much.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    pub block_median_relative_error: f64,
    pub block_psnr_db: f64,
}

impl Truth {
    /// The folder of a scene among the references, when there is one that knows indirect light.
    pub fn find(references: Option<&Path>, loaded: &LoadedScene) -> Result<Option<Self>, Error> {
        let Some(folder) = references.map(|folder| folder.join(&loaded.name)).filter(|f| f.join("full.exr").exists())
        else {
            return Ok(None);
        };
        let data = ReferenceData::load(&folder)?;
        let points = data.surface_points(loaded.metres_per_unit);
        let point_indirect = data.point_indirect();
        let Some(indirect) = data.indirect else { return Ok(None) };
        let direct = match data.direct {
            Some(direct) => direct,
            None => data.full.minus(&indirect)?,
        };
        let pictures = Pictures { full: data.full, direct, indirect };
        let source = format!("the pictures and {} points of {}", points.len(), folder.display());
        Ok(Some(Self { pictures, points, point_indirect, noise: None, source }))
    }

    /// Path traces a picture of the scene with these lights, half of the `paths` in each of two independent pictures.
    pub fn traced(
        loaded: &LoadedScene,
        lights: &[Light],
        size: (u32, u32),
        paths: u32,
        seed: u32,
        progress: &Progress,
    ) -> Result<Self, Error> {
        let mut scene = loaded.scene.clone();
        scene.set_lights(lights);
        let camera = loaded.view.camera(size.0, size.1);
        let half = paths.div_ceil(2);
        let settings = PathSettings { seed, ..PathSettings::default() };
        let others = PathSettings { seed: seed ^ OTHER_HALF, ..settings };
        let first = path::render(&scene, &camera, settings, half, None, false, progress)?.pictures;
        let second = path::render(&scene, &camera, others, half, None, false, progress)?.pictures;
        let pictures = Pictures {
            full: mean(&first.full, &second.full)?,
            direct: mean(&first.direct, &second.direct)?,
            indirect: mean(&first.indirect, &second.indirect)?,
        };
        let scale = indirect_scale(&pictures.indirect);
        let errors = compare_pictures(&first.indirect, &pictures.indirect, scale, None)?;
        let noise = Noise {
            block_median_relative_error: errors.block_median_relative_error,
            block_psnr_db: errors.block_psnr_db,
        };
        let source = format!(
            "{paths} paths a pixel of this project's path tracer, {} × {}, noise of block means {:.2} % (median), \
             {:.1} dB",
            size.0,
            size.1,
            100.0 * noise.block_median_relative_error,
            noise.block_psnr_db
        );
        Ok(Self { pictures, points: Vec::new(), point_indirect: Vec::new(), noise: Some(noise), source })
    }

    /// [`Truth::traced`] with the scene's own lights, and with points: equal-area ones of all lit surface.
    pub fn traced_with_points(
        loaded: &LoadedScene,
        size: (u32, u32),
        paths: u32,
        seed: u32,
        progress: &Progress,
    ) -> Result<Self, Error> {
        let mut truth = Self::traced(loaded, &loaded.scene.lighting.lights, size, paths, seed, progress)?;
        let sampler = LitSampler::new(&loaded.scene, POINT_PROBE_SAMPLES, Density::default(), seed)?;
        let samples = sampler.samples(POINTS, seed)?;
        let point =
            |s: &patches::Sample| SurfacePoint { position: s.position, patch: NONE, normal: s.normal, weight: 1.0 };
        truth.points = samples.iter().map(point).collect();
        let settings = PathSettings { seed, ..PathSettings::default() };
        let tracer = PathTracer::new(&loaded.scene);
        let paths = paths.saturating_mul(POINT_PATHS);
        let found = progress.phase("points", |_| tracer.irradiance(&truth.points, paths, &settings));
        truth.point_indirect = found.iter().map(|p| p.indirect).collect();
        let mut errors: Vec<f64> = found
            .iter()
            .map(|p| f64::from(luminance(p.indirect_error)) / f64::from(luminance(p.indirect).max(f32::MIN_POSITIVE)))
            .collect();
        let noise = 100.0 * quantile(&mut errors, 0.5);
        truth.source += &format!("; {} points of {paths} paths, standard error {noise:.2} % (median)", found.len());
        Ok(truth)
    }

    /// Width and height of the pictures.
    pub fn size(&self) -> (u32, u32) {
        (self.pictures.full.width, self.pictures.full.height)
    }
}

fn mean(first: &Picture, second: &Picture) -> Result<Picture, Error> {
    let mut sum = first.plus(second)?;
    sum.pixels.iter_mut().for_each(|p| *p *= 0.5);
    Ok(sum)
}
