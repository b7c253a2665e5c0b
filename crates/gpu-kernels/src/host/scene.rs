//! Host forms of the kernels over the scene.

use ::scene::kernel::bvh;
use ::scene::{Geometry, Ray};

use super::{Bound, HostCall, HostError, agreed, fill};
use crate::params::CountParams;
use crate::table::Kernel;

/// Tables of the scene from their bindings, in the order in which all kernels have them.
fn geometry<'s>(
    [nodes, triangles, uvs, materials, textures, texels]: [Bound<'s, '_>; 6],
) -> Result<Geometry<'s>, HostError> {
    Ok(Geometry {
        nodes: nodes.read(1)?,
        triangles: triangles.read(1)?,
        uvs: uvs.read(1)?,
        materials: materials.read(1)?,
        textures: textures.read(0)?,
        texels: texels.read(0)?,
    })
}

pub(crate) fn closest_hit(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [rays, a, b, c, d, e, f, hits]) = call.parts::<CountParams, 8>(kernel)?;
    let n = agreed(elements, p.count)?;
    let (rays, geometry) = (rays.read::<Ray>(n)?, geometry([a, b, c, d, e, f])?);
    fill(hits.write(n)?, |k| {
        let ray = rays[k as usize];
        bvh::closest_hit(&geometry, ray.origin, ray.direction, ray.t_max)
    });
    Ok(())
}
