//! Another albedo of materials than that of the bake, for methods whose operators do not hold it.

use std::sync::Arc;

use glam::{Vec3, Vec4};
use patches::PatchMesh;
use rayon::prelude::*;
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::Slice;
use scene::{Material, NONE, Rgb, Scene, SurfacePoint};

use crate::bake::{Bake, enough_bounces};
use crate::error::{Error, Reason};
use crate::low_level::frame::FramePlan;
use crate::low_level::stage::source::Source;

/// Greatest albedo of a material.
pub const MAX_ALBEDO: f32 = 0.95;
/// Half of the way on which the surface of a sample is looked for, in ray offsets of the scene.
const OFFSETS: f32 = 4.0;
/// Numbers of bounces are multiples of this, so that an albedo that rises a little seldom asks for another plan.
const BOUNCES_STEP: u32 = 16;

/// The albedo ρ, without unit, of everything that reflects light: [`crate::LightField::set_albedo`].
#[derive(Clone, Debug, PartialEq)]
pub struct Albedo {
    /// Materials, `[materials]`, without a texture where it is not that of the bake; their emission is the bake's.
    pub materials: Vec<Material>,
    /// At each sample point, `[points]`.
    pub points: Vec<Vec4>,
    /// Mean of each element, `[elements]`.
    pub elements: Vec<Vec4>,
    /// Mean of each patch, `[patches]`.
    pub patches: Vec<Vec4>,
    /// Bounces of a frame that settle with it.
    pub bounces: u32,
}

/// The buffers of a loaded plan that hold it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AlbedoBuffers {
    pub points: Slice<Rgb>,
    pub elements: Slice<Rgb>,
    pub patches: Slice<Rgb>,
}

impl AlbedoBuffers {
    /// Those of a frame's plan.
    pub fn of(frame: &FramePlan, source: &Source) -> Self {
        Self { points: source.point_albedo, elements: frame.elements.albedo, patches: frame.patches.albedo }
    }

    /// # Errors
    /// What the device says.
    pub fn set(&self, executor: &mut (dyn Executor + 'static), albedo: &Albedo) -> Result<(), ExecutorError> {
        executor.upload(self.points, &albedo.points)?;
        executor.upload(self.elements, &albedo.elements)?;
        executor.upload(self.patches, &albedo.patches)
    }
}

/// The material that each sample point of a mesh lies on, `[points]`, found by a short ray onto the surface; [`NONE`]
/// where it meets none.
pub(crate) fn sample_materials(scene: &Scene, mesh: &PatchMesh) -> Vec<u32> {
    mesh.points.par_iter().map(|point| material_at(scene, point)).collect()
}

fn material_at(scene: &Scene, point: &SurfacePoint) -> u32 {
    let above = OFFSETS * scene.geometry.ray_offset;
    let hit = scene.closest_before(point.position + point.normal * above, -point.normal, 2.0 * above);
    match scene.geometry.triangles.get(hit.triangle as usize) {
        Some(triangle) => triangle.material,
        None => NONE,
    }
}

impl Albedo {
    /// That of a bake, but for the materials that have another one, all over, in `changed`. `materials` are those of
    /// the samples ([`sample_materials`]). Elements are means of their samples, patches of their elements; those
    /// without a changed sample keep what they have.
    ///
    /// # Errors
    /// [`Input`](crate::ErrorKind::Input).
    pub(crate) fn new(bake: &Bake, materials: &[u32], changed: &[Option<Vec3>]) -> Result<Self, Error> {
        check(changed, &bake.scene.materials)?;
        let mesh = &bake.mesh;
        let of_sample = |k: usize| changed.get(materials[k] as usize).copied().flatten();
        let mut points = mesh.point_albedo.clone();
        let mut elements = mesh.element_albedo.clone();
        for (element, range) in elements.iter_mut().zip(mesh.offsets.windows(2)) {
            let own = range[0] as usize..range[1] as usize;
            let mut is_changed = false;
            for k in own.clone() {
                if let Some(albedo) = of_sample(k) {
                    points[k] = albedo.extend(0.0);
                    is_changed = true;
                }
            }
            if is_changed {
                *element = own.map(|k| points[k] * mesh.points[k].weight).sum();
            }
        }
        let means = mesh.patch_means(&elements);
        let mut patches = mesh.albedo.clone();
        for ((patch, mean), own) in patches.iter_mut().zip(means).zip(mesh.patch_elements.windows(2)) {
            let own = own[0] as usize..own[1] as usize;
            if elements[own.clone()] != mesh.element_albedo[own] {
                *patch = mean;
            }
        }
        let bounces = bounces(bake, &patches)?;
        Ok(Self { materials: with_albedo(&bake.scene, changed), points, elements, patches, bounces })
    }

    /// Gives it to the materials of a scene, whose emission stays.
    pub(crate) fn give_to(&self, scene: &mut Scene) {
        for (own, new) in Arc::make_mut(&mut scene.materials).iter_mut().zip(&self.materials) {
            own.albedo = new.albedo;
            own.albedo_texture = new.albedo_texture;
        }
    }
}

fn check(changed: &[Option<Vec3>], materials: &[Material]) -> Result<(), Error> {
    if changed.len() != materials.len() {
        return Err(Reason::AlbedoCount { expected: materials.len(), found: changed.len() }.into());
    }
    let is_wrong = |albedo: &Vec3| !(albedo.min_element() >= 0.0 && albedo.max_element() <= MAX_ALBEDO);
    for (material, (albedo, own)) in changed.iter().zip(materials).enumerate() {
        let rest = Vec3::ONE - own.mirror - own.transmittance;
        if let Some(value) = albedo.filter(|albedo| albedo.is_nan() || is_wrong(albedo) || albedo.cmpgt(rest).any()) {
            return Err(Reason::AlbedoValue { material, value }.into());
        }
    }
    Ok(())
}

/// The materials of a scene, some with another albedo.
fn with_albedo(scene: &Scene, changed: &[Option<Vec3>]) -> Vec<Material> {
    let own = scene.materials.iter().zip(changed);
    own.map(|(material, changed)| match changed {
        Some(albedo) => Material { albedo: *albedo, albedo_texture: NONE, ..*material },
        None => *material,
    })
    .collect()
}

/// Bounces that settle with an albedo of the patches: those of the bake where it says their number, or nothing is
/// brighter.
fn bounces(bake: &Bake, patches: &[Vec4]) -> Result<u32, Error> {
    if bake.settings.bounces.is_some()
        || !patches.iter().zip(&bake.mesh.albedo).any(|(new, old)| new.truncate().cmpgt(old.truncate()).any())
    {
        return Ok(bake.bounces);
    }
    let enough = enough_bounces(&bake.form_factors.factors, patches)?;
    Ok(if enough > bake.bounces { enough.next_multiple_of(BOUNCES_STEP) } else { bake.bounces })
}
