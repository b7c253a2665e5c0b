//! First exitance E of the elements from their samples, and of the patches from their elements, W/m².

use glam::Vec4;
use gpu_kernels::formfactor::AssembleSourcePass;
use gpu_kernels::params::CountParams;
use gpu_kernels::transport::GatherCsrPass;
use runtime::executor::ExecutorError;
use runtime::plan::{PassId, Slice};
use scene::kernel::bvh::FAR;
use scene::{Lighting, Rgb};

use super::direct::DirectLight;
use crate::bake::Bake;
use crate::low_level::frame::FramePlan;

/// The passes, and what changes in them with the sky.
#[derive(Clone, Copy, Debug)]
pub struct Source {
    /// Elements, then patches.
    pub passes: [PassId; 2],
    /// Light of a constant sky reflected by elements, W/m².
    pub emission: Slice<Rgb>,
    /// Albedo of the samples.
    pub point_albedo: Slice<Rgb>,
}

/// Adds the passes.
///
/// # Errors
/// What the plan says.
pub fn add(frame: &mut FramePlan, direct: &DirectLight) -> Result<Source, ExecutorError> {
    let mesh = &frame.bake.mesh;
    let plan = &mut frame.plan;
    let tables = &mut frame.tables;
    let elements = mesh.elements.len();
    let point_albedo = tables.part(plan, "point albedo", mesh, |mesh| &mesh.point_albedo);
    let emission = plan.array("emission", elements);
    let assemble = AssembleSourcePass {
        points: direct.points,
        offsets: tables.part(plan, "offsets", mesh, |mesh| &mesh.offsets),
        direct: direct.irradiance,
        albedo: point_albedo,
        emission,
        source: frame.elements.source,
    };
    let of_elements = plan.add("gather", &assemble, &CountParams { count: frame.elements.count })?;

    // A patch has the mean of its elements by area.
    let numbers: Vec<u32> = (0..elements as u32).collect();
    let mean = GatherCsrPass {
        row_start: tables.part(plan, "patch elements", mesh, |mesh| &mesh.patch_elements),
        columns: tables.owned(plan, "element numbers", numbers),
        values: tables.owned(plan, "element shares", mesh.element_shares()),
        exitance: frame.elements.source,
        irradiance: frame.changed.map_or(frame.patches.source, |changed| changed.source),
    };
    let of_patches = plan.add("gather", &mean, &CountParams { count: frame.patches.count })?;
    Ok(Source { passes: [of_elements, of_patches], emission, point_albedo })
}

/// First exitance that a constant sky gives each element: `ρ π L s`, with its albedo ρ and the share s of its
/// hemisphere that sees the sky, as far as a medium leaves light from infinity. A sky with a map is sampled instead.
pub fn sky_exitance(bake: &Bake, element_albedo: &[Vec4], lighting: &Lighting) -> Vec<Vec4> {
    let sky = lighting.sky;
    let radiance = if sky.map_width == 0 { sky.radiance } else { glam::Vec3::ZERO };
    let irradiance = radiance * bake.scene.transmittance(FAR) * std::f32::consts::PI;
    let shares = &bake.form_factors.sky_factor;
    element_albedo.iter().zip(shares).map(|(albedo, share)| *albedo * (irradiance * *share).extend(0.0)).collect()
}
