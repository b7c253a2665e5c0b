//! Light of a scene by printed patches.

use std::f32::consts::PI;
use std::ops::{ControlFlow, Range};

use formfactor::{Patch, Stop, form_factors, jacobi};
use glam::{Vec3, Vec4};
use patches::{Lookup, LookupSettings, PatchSet, SampleSet};
use patchlight::bake::direct_params;
use patchlight::{Error, Observer, Phase, Picture, PixelGather, run_phase};
use rayon::prelude::*;
use scene::gpu::DirectParams;
use scene::sampling::hash3;
use scene::{Camera, Lighting, NONE, Scene, SurfacePoint};
use transport::{Dense, Proceed, Surfaces};

use crate::lookup::light_at;
use crate::points::PrintedPoints;
use crate::voxels::{
    Form, PRINTED_PATCHES, PointRows, PrintedSettings, printed_axis_patches, printed_cluster_patches, printed_samples,
    printed_source,
};

/// Rays from each point to the sky.
const SKY_RAYS: u32 = 64;

/// Printed patches of a scene with their form factors [T 5.1] to [T 5.9].
pub struct PrintedRadiosity<'a> {
    scene: &'a Scene,
    /// The patches.
    pub set: PatchSet,
    /// Form factors between them, patches × patches.
    pub factors: Dense,
    /// Share of each patch's hemisphere that sees no geometry.
    pub sky: Vec<f32>,
    /// Most entries of rows of single points that were in memory at once.
    pub most_entries: usize,
    /// Samples of the voxel of each patch.
    voxel_samples: Vec<Range<usize>>,
    table: Lookup,
    seed: u32,
}

impl<'a> PrintedRadiosity<'a> {
    /// Makes the patches and their form factors.
    ///
    /// # Errors
    /// Too many voxels, cancellation.
    pub fn new(scene: &'a Scene, settings: &PrintedSettings, observer: &dyn Observer) -> Result<Self, Error> {
        let (grid, set) = run_phase(observer, Phase::SAMPLE, |_| printed_samples(scene, settings))?;
        let made = run_phase(observer, Phase::FORM_FACTORS, |report| {
            let points = Points::new(scene, &set, settings.seed);
            let rows = |range: Range<usize>| points.rows(range, report);
            match settings.form {
                Form::Axes => printed_axis_patches(&grid, set.clone(), &rows),
                Form::Clusters => printed_cluster_patches(&grid, set.clone(), PRINTED_PATCHES, &rows),
            }
        });
        let made = made.map_err(of_rows)?;
        let table = Lookup::new(&grid, &made.set, LookupSettings::default())?;
        let samples = |voxel: u32| grid.slot_of(voxel).map_or(0..0, |slot| set.range(slot));
        let voxel_samples = made.set.patches.iter().map(|patch| samples(patch.voxel)).collect();
        let factors = made.factors;
        let sky = made.sky;
        let most_entries = made.most_entries;
        Ok(Self { scene, set: made.set, factors, sky, most_entries, voxel_samples, table, seed: settings.seed })
    }

    /// First exitance of the patches, W/m²: `E_j = Σ_i e_i max(0, N_j·n_i)` over the points of the patch's voxel [T
    /// 5.8], where `e_i` is what the point sends of the light that falls on it, by so many rays to area lights.
    pub fn source(&self, lighting: &Lighting, rays: u32) -> Vec<Vec4> {
        let samples = &self.set.samples;
        let point =
            |s: &patches::Sample| SurfacePoint { position: s.position, patch: NONE, normal: s.normal, weight: 1.0 };
        let points: Vec<SurfacePoint> = samples.iter().map(point).collect();
        let has_map = lighting.sky.map_width > 0;
        let params = DirectParams {
            count: points.len() as u32,
            area_rays: rays,
            sky_rays: if has_map { rays } else { 0 },
            seed: self.seed,
            ..direct_params(self.scene)
        };
        let direct = self.scene.direct_irradiance(&params, &points);
        let sky = if has_map { Vec3::ZERO } else { lighting.sky.radiance * PI };
        let sent: Vec<Vec3> = samples.iter().zip(&direct).map(|(s, light)| s.albedo * *light).collect();
        let reflected = printed_source(&self.set, &self.voxel_samples, &sent).into_iter();
        let with_sky = |((e, patch), share): ((Vec3, &patches::VirtualPatch), &f32)| e + patch.albedo * sky * *share;
        reflected.zip(&self.set.patches).zip(&self.sky).map(|all| with_sky(all).extend(0.0)).collect()
    }

    /// Irradiance of the patches, W/m², after so many bounces of the scene's own light.
    ///
    /// # Errors
    /// None for a sound scene.
    pub fn irradiance(&self, rays: u32, bounces: u32) -> Result<Vec<Vec4>, Error> {
        let albedo: Vec<Vec4> = self.set.patches.iter().map(|patch| patch.albedo.extend(0.0)).collect();
        let source = self.source(&self.scene.lighting, rays);
        Ok(jacobi(&self.factors, &source, &albedo, Stop::Bounces(bounces))?.irradiance)
    }

    /// Indirect radiance that a camera sees, W/m²/sr, in so many sub-frames, of the irradiance of the patches: (5.3).
    ///
    /// # Errors
    /// None for a sound scene.
    pub fn indirect(&self, irradiance: &[Vec4], camera: &Camera, sub_frames: u32) -> Result<Picture, Error> {
        let gather = |points: &[SurfacePoint], _: u32| {
            Ok(points.par_iter().map(|p| light_at(&self.table, irradiance, p.position, p.normal)).collect())
        };
        let pixels = PixelGather {
            scene: self.scene,
            gather: &gather,
            lights: &self.scene.lighting.lights,
            camera,
            frame: 0,
            sub_frames,
            seed: self.seed,
        };
        pixels.indirect()
    }
}

/// Errors of the rows as they were before the patches took them.
fn of_rows(error: patches::Error) -> Error {
    match error {
        patches::Error::Rows(own) => match own.downcast::<formfactor::Error>() {
            Ok(own) => (*own).into(),
            Err(other) => patches::Error::Rows(other).into(),
        },
        other => other.into(),
    }
}

/// The points of all voxels.
struct Points<'a> {
    scene: &'a Scene,
    patches: Vec<Patch>,
    points: Vec<SurfacePoint>,
    seed: u32,
}

impl<'a> Points<'a> {
    fn new(scene: &'a Scene, set: &SampleSet, seed: u32) -> Self {
        let patch =
            |s: &patches::Sample| Patch { centroid: s.position, area: s.area, normal: s.normal, triangle: s.triangle };
        let point =
            |s: &patches::Sample| SurfacePoint { position: s.position, patch: NONE, normal: s.normal, weight: 1.0 };
        Self {
            scene,
            patches: set.samples.iter().map(patch).collect(),
            points: set.samples.iter().map(point).collect(),
            seed,
        }
    }

    /// (5.1) from some points to all.
    fn rows(&self, range: Range<usize>, report: &dyn Fn(usize, usize) -> Proceed) -> Result<PointRows, patches::Error> {
        let offsets: Vec<u32> = (0..=range.len() as u32).collect();
        let surfaces = Surfaces {
            patches: &self.patches,
            polygons: &[],
            row_polygons: &[],
            points: &self.points[range.clone()],
            offsets: &offsets,
            visibility: self.scene,
            owner: Box::new(|_, _| NONE),
            ray_offset: self.scene.geometry.ray_offset,
            seed: hash3(range.start as u32, 0, self.seed),
        };
        let boxed = |error: formfactor::Error| patches::Error::Rows(Box::new(error));
        let estimator = PrintedPoints { sky_rays: SKY_RAYS };
        let found = form_factors(&estimator, &surfaces, &|_, _| ControlFlow::Continue(())).map_err(boxed)?;
        let done = range.end;
        let total = self.points.len();
        if report(done, total).is_break() {
            return Err(boxed(transport::Error::Cancelled { done, total }.into()));
        }
        Ok(PointRows { factors: found.factors.values, sky: found.sky_factor })
    }
}
