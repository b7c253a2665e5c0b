//! Kernels of the form factors.

use ::formfactor::HemisphereParams;
use ::formfactor::kernel::hemisphere;
use ::formfactor::kernel::product::assemble_source;
use ::scene::kernel::bvh;
use ::scene::{Hit, Rgb, SurfacePoint};
use ::transport::TriangleGrid;

use crate::params::CountParams;

kernels! {
    /// Column of what every hemisphere ray of a block of rows meets, rows one after the other:
    /// [`hemisphere::hemisphere_ray`], [`hemisphere::classify_hit`]. One invocation per ray:
    /// `row_count · rays`.
    FORMFACTOR_HEMISPHERE_HITS: HemisphereHitsPass = "formfactor_hemisphere_hits"(p: HemisphereParams)
    for k in 0..row_count * rays {
        offsets: read [u32; p.first_row as usize + row_count + 1],
        points: read [SurfacePoint],
        grids: read [TriangleGrid],
        cell_columns: read [u32],
        geometry: GeometryTables,
        ids: write [u32],
    } each {
        let row = p.first_row + k / p.rays;
        let (origin, direction) = hemisphere::hemisphere_ray(p, offsets, points, row, k % p.rays);
        let hit = bvh::closest_hit(&geometry, origin, direction, bvh::FAR);
        hemisphere::classify_hit(p, grids, cell_columns, &geometry, direction, hit)
    }

    /// Traces every hemisphere ray of a block of rows, rows one after the other, for patches that only the host finds:
    /// [`hemisphere::hemisphere_ray`]. One invocation per ray: `row_count · rays`.
    FORMFACTOR_HEMISPHERE_SURFACES: HemisphereSurfacesPass = "formfactor_hemisphere_surfaces"(p: HemisphereParams)
    for k in 0..row_count * rays {
        offsets: read [u32; p.first_row as usize + row_count + 1],
        points: read [SurfacePoint],
        geometry: GeometryTables,
        hits: write [Hit],
    } each {
        let row = p.first_row + k / p.rays;
        let (origin, direction) = hemisphere::hemisphere_ray(p, offsets, points, row, k % p.rays);
        bvh::closest_hit(&geometry, origin, direction, bvh::FAR)
    }

    /// First exitance of every patch, W/m²: [`assemble_source`]. One invocation per patch.
    FORMFACTOR_ASSEMBLE_SOURCE: AssembleSourcePass = "formfactor_assemble_source"(p: CountParams) for k in 0..count {
        offsets: read [u32; count + 1],
        points: read [SurfacePoint],
        direct: read [Rgb],
        emission: read [Rgb; count],
        albedo: read [Rgb],
        source: write [Rgb],
    } each {
        assemble_source(k, offsets, points, direct, emission, albedo)
    }
}
