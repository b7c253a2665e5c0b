//! Entry points of the form factors and of the products with them.

use ::formfactor::kernel::product::{LANES, ROWS_TOGETHER, VECTOR_IMAGE_WIDTH};
use ::formfactor::kernel::{hemisphere, hits, product};
use ::formfactor::{GatherParams, HemisphereParams, HitsParams, ReceiverCell, TriangleGrid};
use ::scene::kernel::bvh;
use ::scene::{BvhNode, GeometryTables, Hit, Material, Rgb, SurfacePoint, Texture, Triangle, TriangleUv};
use glam::{UVec2, UVec3, Vec4};
use spirv_std::arch::workgroup_memory_barrier_with_group_sync;
use spirv_std::{Image, spirv};

use crate::half::unpack_half4;
use crate::invocation::{element, group_index};
use crate::params::CountParams;

/// Column of what every hemisphere ray of a block of rows meets, rows one after the other.
#[spirv(compute(threads(64), entry_point_name = "formfactor_hemisphere_hits"))]
#[inline(never)]
pub fn hemisphere_hits(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &HemisphereParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] offsets: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] points: &[SurfacePoint],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] grids: &[TriangleGrid],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] nodes: &[BvhNode],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] triangles: &[Triangle],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] uvs: &[TriangleUv],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] materials: &[Material],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] textures: &[Texture],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 8)] texels: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 9)] ids: &mut [u32],
) {
    let k = element(id, groups);
    if k < p.row_count * p.rays {
        let geometry = GeometryTables { nodes, triangles, uvs, materials, textures, texels };
        let (origin, direction) = hemisphere::hemisphere_ray(p, offsets, points, p.first_row + k / p.rays, k % p.rays);
        let hit = bvh::closest_hit(&geometry, origin, direction, bvh::FAR);
        ids[k as usize] = hemisphere::classify_hit(p, grids, &geometry, direction, hit);
    }
}

/// Every row of a block of F from the columns its rays met: [`hemisphere::hemisphere_row`].
#[spirv(compute(threads(64), entry_point_name = "formfactor_hemisphere_row"))]
#[inline(never)]
pub fn hemisphere_row(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &HemisphereParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] offsets: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] points: &[SurfacePoint],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] ids: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] factors: &mut [f32],
) {
    let k = element(id, groups);
    if k < p.row_count {
        hemisphere::hemisphere_row(p, offsets, points, ids, k, factors);
    }
}

/// First exitance of every patch: [`product::assemble_source`].
#[spirv(compute(threads(64), entry_point_name = "formfactor_assemble_source"))]
#[inline(never)]
pub fn assemble_source(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] offsets: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] points: &[SurfacePoint],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] direct: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] emission: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] albedo: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] source: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        source[k as usize] = product::assemble_source(k, offsets, points, direct, emission, albedo);
    }
}

/// Irradiance of every row of a dense block, for devices with fast shared memory: a workgroup shares the columns of four
/// rows ([`product::gather_lane`]) and adds its lanes up in a tree.
#[spirv(compute(threads(64), entry_point_name = "formfactor_gather"))]
#[inline(never)]
pub fn gather(
    #[spirv(workgroup_id)] group: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(local_invocation_index)] lane: u32,
    #[spirv(push_constant)] p: &GatherParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] factors: &[Vec4],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] irradiance: &mut [Rgb],
    #[spirv(workgroup)] shared: &mut [Vec4; 256],
) {
    let first = group_index(group, groups) * ROWS_TOGETHER;
    let load = |row: u32, vector: u32| factors[(row * p.vectors + vector) as usize];
    let sums = product::gather_lane(first, p, lane, LANES, load, |j| exitance[j as usize]);
    add_lanes(lane, sums, shared);
    if lane < ROWS_TOGETHER && first + lane < p.rows {
        irradiance[(p.first_row + first + lane) as usize] = shared[(lane * LANES) as usize];
    }
}

/// The same from half-precision factors, four in two words.
#[spirv(compute(threads(64), entry_point_name = "formfactor_gather_half"))]
#[inline(never)]
pub fn gather_half(
    #[spirv(workgroup_id)] group: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(local_invocation_index)] lane: u32,
    #[spirv(push_constant)] p: &GatherParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] factors: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] irradiance: &mut [Rgb],
    #[spirv(workgroup)] shared: &mut [Vec4; 256],
) {
    let first = group_index(group, groups) * ROWS_TOGETHER;
    let load = |row: u32, vector: u32| unpack_half4(factors[(row * p.vectors + vector) as usize]);
    let sums = product::gather_lane(first, p, lane, LANES, load, |j| exitance[j as usize]);
    add_lanes(lane, sums, shared);
    if lane < ROWS_TOGETHER && first + lane < p.rows {
        irradiance[(p.first_row + first + lane) as usize] = shared[(lane * LANES) as usize];
    }
}

/// Leaves the sum over all lanes of row r in `shared[r * LANES]`: [`product::combine`] in a tree.
#[inline]
fn add_lanes(lane: u32, sums: product::RowSums, shared: &mut [Vec4; 256]) {
    shared[lane as usize] = sums.a.extend(0.0);
    shared[(LANES + lane) as usize] = sums.b.extend(0.0);
    shared[(2 * LANES + lane) as usize] = sums.c.extend(0.0);
    shared[(3 * LANES + lane) as usize] = sums.d.extend(0.0);
    workgroup_memory_barrier_with_group_sync();
    let mut stride = LANES / 2;
    while stride > 0 {
        if lane < stride {
            for row in 0..ROWS_TOGETHER {
                let k = (row * LANES + lane) as usize;
                shared[k] = product::combine(shared[k], shared[k + stride as usize]);
            }
        }
        workgroup_memory_barrier_with_group_sync();
        stride /= 2;
    }
}

/// Irradiance of every row of a dense block, for devices whose texel fetches are faster than buffer loads (software
/// Vulkan): factors and exitance are images, an invocation gathers four rows alone.
#[spirv(compute(threads(64), entry_point_name = "formfactor_gather_image"))]
#[inline(never)]
pub fn gather_image(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &GatherParams,
    #[spirv(descriptor_set = 0, binding = 0)] factors: &Image!(2D, type=f32, sampled),
    #[spirv(descriptor_set = 0, binding = 1)] exitance: &Image!(2D, type=f32, sampled),
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] irradiance: &mut [Rgb],
) {
    let first = element(id, groups) * ROWS_TOGETHER;
    if first < p.rows {
        let load = |row: u32, vector: u32| -> Vec4 { factors.fetch(UVec2::new(vector, row)) };
        let light = |j: u32| -> Vec4 { exitance.fetch(UVec2::new(j % VECTOR_IMAGE_WIDTH, j / VECTOR_IMAGE_WIDTH)) };
        let sums = product::gather_lane(first, p, 0, 1, load, light);
        write_rows(p, first, sums, irradiance);
    }
}

/// The same from an image of half-precision factors.
#[spirv(compute(threads(64), entry_point_name = "formfactor_gather_half_image"))]
#[inline(never)]
pub fn gather_half_image(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &GatherParams,
    #[spirv(descriptor_set = 0, binding = 0)] factors: &Image!(2D, type=f32, sampled),
    #[spirv(descriptor_set = 0, binding = 1)] exitance: &Image!(2D, type=f32, sampled),
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] irradiance: &mut [Rgb],
) {
    let first = element(id, groups) * ROWS_TOGETHER;
    if first < p.rows {
        let load = |row: u32, vector: u32| -> Vec4 { factors.fetch(UVec2::new(vector, row)) };
        let light = |j: u32| -> Vec4 { exitance.fetch(UVec2::new(j % VECTOR_IMAGE_WIDTH, j / VECTOR_IMAGE_WIDTH)) };
        let sums = product::gather_lane(first, p, 0, 1, load, light);
        write_rows(p, first, sums, irradiance);
    }
}

/// The sums of four rows into the result, as far as there are rows.
#[inline]
fn write_rows(p: &GatherParams, first: u32, sums: product::RowSums, irradiance: &mut [Rgb]) {
    let at = (p.first_row + first) as usize;
    irradiance[at] = sums.a.extend(0.0);
    if first + 1 < p.rows {
        irradiance[at + 1] = sums.b.extend(0.0);
    }
    if first + 2 < p.rows {
        irradiance[at + 2] = sums.c.extend(0.0);
    }
    if first + 3 < p.rows {
        irradiance[at + 3] = sums.d.extend(0.0);
    }
}

/// Irradiance of every compressed sparse row: [`product::gather_row_sparse`].
#[spirv(compute(threads(64), entry_point_name = "formfactor_gather_csr"))]
#[inline(never)]
pub fn gather_csr(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] columns: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] values: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        irradiance[k as usize] = product::gather_row_sparse(k, row_start, columns, values, exitance);
    }
}

/// Irradiance of every row of counts of hits: [`hits::gather_row_hits`].
#[spirv(compute(threads(64), entry_point_name = "formfactor_gather_hits"))]
#[inline(never)]
pub fn gather_hits(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &HitsParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] row_start: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] quads: &[UVec2],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] counts: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] scales: &[f32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] exitance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.rows {
        irradiance[k as usize] = hits::gather_row_hits(k, p.first_quad, row_start, quads, counts, scales, exitance);
    }
}

/// Exitance of every patch after a bounce: [`product::bounce`].
#[spirv(compute(threads(64), entry_point_name = "formfactor_bounce"))]
#[inline(never)]
pub fn bounce(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] source: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] albedo: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] irradiance: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] exitance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let i = k as usize;
        exitance[i] = product::bounce(source[i], albedo[i], irradiance[i]);
    }
}

/// Irradiance of the receivers at every pixel: [`product::interpolate_pixel`].
#[spirv(compute(threads(64), entry_point_name = "formfactor_interpolate"))]
#[inline(never)]
pub fn interpolate(
    #[spirv(global_invocation_id)] id: UVec3,
    #[spirv(num_workgroups)] groups: UVec3,
    #[spirv(push_constant)] p: &CountParams,
    #[spirv(storage_buffer, descriptor_set = 0, binding = 0)] hits: &[Hit],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 1)] points: &[SurfacePoint],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 2)] triangles: &[Triangle],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 3)] grids: &[TriangleGrid],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 4)] cells: &[ReceiverCell],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 5)] vertices: &[u32],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 6)] values: &[Rgb],
    #[spirv(storage_buffer, descriptor_set = 0, binding = 7)] irradiance: &mut [Rgb],
) {
    let k = element(id, groups);
    if k < p.count {
        let i = k as usize;
        irradiance[i] = product::interpolate_pixel(grids, cells, vertices, triangles, values, hits[i], points[i]);
    }
}
