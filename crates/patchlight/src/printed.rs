//! Patches and their form factors as the thesis prints them.

use std::ops::{ControlFlow, Range};
use std::sync::Arc;

use formfactor::{Patch, PointToPoint, Surfaces, form_factors};
use patches::{
    MeshSettings, PRINTED_PATCHES, PatchKind, PatchMesh, PointRows, SampleSet, printed_axis_patches,
    printed_cluster_patches, printed_samples,
};
use scene::sampling::hash3;
use scene::{NONE, Scene, SurfacePoint};
use transport::{Observer, Phase, Variant};

use crate::error::Error;
use crate::form_factors::FormFactors;
use crate::observe::{Report, run_phase};

/// Rays from each point to the sky.
const SKY_RAYS: u32 = 64;

/// Printed patches of a scene [T 5.1] to [T 5.9]: points by rays, form factors between points by (5.1), patches merged voxel by
/// voxel.
///
/// # Errors
/// Patches without voxels, too many of them, cancellation.
pub fn patches(
    scene: &Scene,
    settings: &MeshSettings,
    observer: &dyn Observer,
) -> Result<(PatchMesh, FormFactors), Error> {
    let (grid, set) = run_phase(observer, Phase::SAMPLE, |_| printed_samples(scene, settings))?;
    let made = run_phase(observer, Phase::FORM_FACTORS, |report| {
        let points = Points::new(scene, &set, settings.seed);
        let rows = |range: Range<usize>| points.rows(range, report);
        match settings.kind {
            PatchKind::Axis => printed_axis_patches(&grid, set.clone(), &rows),
            _ => printed_cluster_patches(&grid, set.clone(), PRINTED_PATCHES, &rows),
        }
    });
    let made = made.map_err(of_rows)?;
    observer.note(&format!(
        "{} points, {} of their form factors in memory at once, of {}",
        set.samples.len(),
        made.most_entries,
        set.samples.len() * set.samples.len()
    ));
    let mesh = PatchMesh::printed(scene, &grid, &made)?;
    let factors = Arc::new(made.factors.to_csr(0.0)?);
    Ok((mesh, FormFactors { factors, element_rows: None, sky_factor: made.sky }))
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
    fn rows(&self, range: Range<usize>, report: &Report) -> Result<PointRows, patches::Error> {
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
        let estimator = PointToPoint { variant: Variant::Thesis, sky_rays: SKY_RAYS };
        let boxed = |error: formfactor::Error| patches::Error::Rows(Box::new(error));
        let found = form_factors(&estimator, &surfaces, &|_, _| ControlFlow::Continue(())).map_err(boxed)?;
        let (done, total) = (range.end, self.points.len());
        if report(done, total).is_break() {
            return Err(boxed(transport::Error::Cancelled { done, total }.into()));
        }
        Ok(PointRows { factors: found.factors.values, sky: found.sky_factor })
    }
}
