//! Kernels of products with rows, of bounces, and of values between interpolation points.

use ::scene::gpu::Triangle;
use ::scene::{Hit, NONE, Rgb, SurfacePoint};
use ::transport::kernel::grid::interpolate_pixel;
use ::transport::kernel::product::{self, LANES, ROWS_PER_BATCH};
use ::transport::kernel::{hits, view};
use ::transport::{GatherParams, HitsParams, ReceiverCell, TriangleGrid, ViewParams};
use glam::{UVec2, Vec4};
use spirv_std::arch::workgroup_memory_barrier_with_group_sync;

use crate::half::unpack_half4;
use crate::params::CountParams;

kernels! {
    /// Dense product of a block of rows: a workgroup shares the columns of four rows
    /// ([`product::gather_lane`]) and adds its lanes up in a tree. The dispatch counts rows.
    /// `exitance` holds `4 · vectors` elements, finite beyond the columns.
    TRANSPORT_GATHER: GatherPass = "transport_gather"(p: GatherParams)
    for group of ROWS_PER_BATCH in 0..rows, lane, shared: [Vec4; 256] {
        factors: read [Vec4],
        exitance: read [Rgb],
        irradiance: write [Rgb],
    } workgroup {
        let first = group * ROWS_PER_BATCH;
        let load = |row: u32, vector: u32| factors[(row * p.vectors + vector) as usize];
        let sums = product::gather_lane(first, p, lane, LANES, load, |j| exitance[j as usize]);
        add_lanes(lane, sums, shared);
        if lane < ROWS_PER_BATCH && first + lane < p.rows {
            irradiance[(p.first_row + first + lane) as usize] = shared[(lane * LANES) as usize];
        }
    } host crate::host::transport::gather;

    /// Gathers with factors as half-precision numbers, four in two words.
    TRANSPORT_GATHER_HALF: GatherHalfPass = "transport_gather_half"(p: GatherParams)
    for group of ROWS_PER_BATCH in 0..rows, lane, shared: [Vec4; 256] {
        factors: read [UVec2],
        exitance: read [Rgb],
        irradiance: write [Rgb],
    } workgroup {
        let first = group * ROWS_PER_BATCH;
        let load = |row: u32, vector: u32| {
            unpack_half4(factors[(row * p.vectors + vector) as usize])
        };
        let sums = product::gather_lane(first, p, lane, LANES, load, |j| exitance[j as usize]);
        add_lanes(lane, sums, shared);
        if lane < ROWS_PER_BATCH && first + lane < p.rows {
            irradiance[(p.first_row + first + lane) as usize] = shared[(lane * LANES) as usize];
        }
    } host crate::host::transport::gather_half;

    /// Product with compressed sparse rows: [`product::gather_row_sparse`]. One invocation per row.
    TRANSPORT_GATHER_CSR: GatherCsrPass = "transport_gather_csr"(p: CountParams) for k in 0..count {
        row_start: read [u32],
        columns: read [u32],
        values: read [f32],
        exitance: read [Rgb],
        irradiance: write [Rgb],
    } each {
        product::gather_row_sparse(k, row_start, columns, values, exitance)
    } host crate::host::transport::gather_csr;

    /// Product with rows of counts of hits (`transport::HitCounts`): [`hits::gather_row_hits`]. One
    /// invocation per row.
    TRANSPORT_GATHER_HITS: GatherHitsPass = "transport_gather_hits"(p: HitsParams) for k in 0..rows {
        row_start: read [u32],
        quads: read [UVec2],
        counts: read [u32],
        scales: read [f32],
        exitance: read [Rgb],
        irradiance: write [Rgb],
    } each {
        hits::gather_row_hits(k, p.first_quad, row_start, quads, counts, scales, exitance)
    } host crate::host::transport::gather_hits;

    /// Exitance of every patch after a bounce, W/m²: [`product::bounce`]. One invocation per patch.
    TRANSPORT_BOUNCE: BouncePass = "transport_bounce"(p: CountParams) for k in 0..count {
        source: read [Rgb; count],
        albedo: read [Rgb; count],
        irradiance: read [Rgb; count],
        exitance: write [Rgb],
    } each {
        let i = k as usize;
        product::bounce(source[i], albedo[i], irradiance[i])
    }

    /// Irradiance of the receivers at every pixel, W/m²: [`interpolate_pixel`]. One
    /// invocation per pixel.
    TRANSPORT_INTERPOLATE: InterpolatePass = "transport_interpolate"(p: CountParams) for k in 0..count {
        hits: read [Hit; count],
        points: read [SurfacePoint; count],
        triangles: read [Triangle; 1],
        grids: read [TriangleGrid; triangles.len()],
        receiver_cells: read [ReceiverCell],
        vertices: read [u32],
        values: read [Rgb],
        irradiance: write [Rgb],
    } each {
        let hit = hits[k as usize];
        let point = points[k as usize];
        interpolate_pixel(grids, receiver_cells, vertices, triangles, values, hit, point)
    }

    /// Marks the interpolation points that the pixels of a view take light from:
    /// [`view::pixel_vertices`]. One invocation per pixel.
    TRANSPORT_MARK_PIXELS: MarkPixelsPass = "transport_mark_pixels"(p: ViewParams) for k in 0..count {
        hits: read [Hit; count],
        points: read [SurfacePoint; count],
        triangles: read [Triangle; 1],
        grids: read [TriangleGrid; triangles.len()],
        receiver_cells: read [ReceiverCell],
        vertices: read [u32],
        marks: update [u32],
    } invocation {
        let hit = hits[k as usize];
        let point = points[k as usize];
        let (ids, _) =
            view::pixel_vertices(grids, receiver_cells, vertices, triangles, hit, point);
        if ids.x != NONE {
            view::mark(marks, ids.x, p.view);
            view::mark(marks, ids.y, p.view);
            view::mark(marks, ids.z, p.view);
        }
    } host crate::host::view::mark_pixels;

    /// [`TRANSPORT_GATHER_HITS`] of the rows that a view needs and that are not computed for the
    /// light yet. One invocation per row.
    TRANSPORT_GATHER_HITS_VIEW: GatherHitsViewPass = "transport_gather_hits_view"(p: ViewParams) for k in 0..count {
        row_start: read [u32],
        quads: read [UVec2],
        counts: read [u32],
        scales: read [f32],
        exitance: read [Rgb],
        marks: read [u32; count],
        computed: update [u32] as light,
        irradiance: update [Rgb] as before,
    } each {
        if view::is_needed(marks[k as usize], p.view) && light != p.light {
            let first = p.first_quad;
            let row = hits::gather_row_hits(k, first, row_start, quads, counts, scales, exitance);
            (p.light, row)
        } else {
            (light, before)
        }
    } host crate::host::view::gather_hits;
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
            for row in 0..ROWS_PER_BATCH {
                let k = (row * LANES + lane) as usize;
                shared[k] = product::combine(shared[k], shared[k + stride as usize]);
            }
        }
        workgroup_memory_barrier_with_group_sync();
        stride /= 2;
    }
}
