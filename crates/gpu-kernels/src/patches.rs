//! Kernels of patches and receivers: lookups between patches and between probes in the air, weighted means of
//! receivers.

use ::patches::kernel::{lookup, volume, weights};
use ::patches::{DifferenceParams, LookupParams, LookupPatch, VolumeParams, WeightParams};
use ::scene::gpu::Triangle;
use ::scene::kernel::lobe::Slope;
use ::scene::{Hit, Lobe, NONE, Rgb, SurfacePoint};
use ::transport::kernel::view;
use ::transport::{ReceiverCell, TriangleGrid};
use glam::Vec3;

kernels! {
    /// Value of the patches round every point, W/m² for irradiance: [`lookup::lookup`]. One
    /// invocation per point.
    PATCHES_LOOKUP: LookupPass = "patches_lookup"(p: LookupParams) for k in 0..count {
        cells: read [u32; crate::host::patches::voxels(&p.shape)?],
        offsets: read [u32; crate::host::patches::cells_named(cells) + 1],
        entries: read [LookupPatch; offsets[crate::host::patches::cells_named(cells)] as usize],
        values: read [Rgb],
        points: read [SurfacePoint; count],
        irradiance: write [Rgb],
    } each {
        let point = points[k as usize];
        lookup::lookup(p, cells, offsets, entries, values, point.position, point.normal)
    }

    /// Irradiance of the ambient cubes round every point, W/m²: [`volume::volume_lookup`]. One
    /// invocation per point.
    PATCHES_VOLUME_LOOKUP: VolumeLookupPass = "patches_volume_lookup"(p: VolumeParams) for k in 0..count {
        probes: read [u32; crate::host::patches::voxels(&p.shape)?],
        planes: read [f32; crate::host::patches::of_probes(probes, volume::PLANE_WORDS)],
        cubes: read [Rgb; crate::host::patches::of_probes(probes, volume::CUBE_SIDES)],
        points: read [SurfacePoint; count],
        irradiance: write [Rgb],
    } each {
        let point = points[k as usize];
        volume::volume_lookup(p, probes, planes, cubes, point.position, point.normal)
    }

    /// Looks up spherical harmonics of degree 1, four coefficients a probe: [`volume::volume_lookup_sh`].
    PATCHES_VOLUME_LOOKUP_SH: VolumeLookupShPass = "patches_volume_lookup_sh"(p: VolumeParams) for k in 0..count {
        probes: read [u32; crate::host::patches::voxels(&p.shape)?],
        planes: read [f32; crate::host::patches::of_probes(probes, volume::PLANE_WORDS)],
        harmonics: read [Rgb; crate::host::patches::of_probes(probes, volume::SH_COEFFICIENTS)],
        points: read [SurfacePoint; count],
        irradiance: write [Rgb],
    } each {
        let point = points[k as usize];
        volume::volume_lookup_sh(p, probes, planes, harmonics, point.position, point.normal)
    }

    /// Weighted means of the irradiance of receivers, W/m²: [`weights::weighted_row`]. One
    /// invocation per row.
    PATCHES_WEIGH: WeighPass = "patches_weigh"(p: WeightParams) for k in 0..count {
        row_start: read [u32; count + 1],
        list_start: read [u32; crate::host::patches::blocks(p)?],
        lists: read [u32],
        entries: read [u32],
        received: read [Rgb],
        irradiance: write [Rgb],
    } each {
        weights::weighted_row(k, p, row_start, list_start, lists, entries, received)
    } host crate::host::patches::weigh;

    /// Weighs the rows that a view needs and that are not computed for the light yet.
    PATCHES_WEIGH_VIEW: WeighViewPass = "patches_weigh_view"(p: WeightParams) for k in 0..count {
        row_start: read [u32; count + 1],
        list_start: read [u32; crate::host::patches::blocks(p)?],
        lists: read [u32],
        entries: read [u32],
        received: read [Rgb],
        marks: read [u32; count],
        computed: update [u32] as light,
        irradiance: update [Rgb] as before,
    } each {
        if view::is_needed(marks[k as usize], p.view) && light != p.light {
            let row = weights::weighted_row(k, p, row_start, list_start, lists, entries, received);
            (p.light, row)
        } else {
            (light, before)
        }
    } host crate::host::patches::weigh_view;

    /// Turns the irradiance of pixels, W/m², to the normals of maps, by the quadrants of the receivers:
    /// [`weights::add_difference`]. One invocation per pixel.
    PATCHES_TURN: TurnPass = "patches_turn"(p: DifferenceParams) for k in 0..count {
        hits: read [Hit; count],
        points: read [SurfacePoint; count],
        lobes: read [Lobe; count],
        triangles: read [Triangle; 1],
        grids: read [TriangleGrid; triangles.len()],
        receiver_cells: read [ReceiverCell],
        vertices: read [u32],
        row_start: read [u32; p.rows as usize + 1],
        list_start: read [u32; crate::host::patches::difference_blocks(p)?],
        lists: read [u32],
        entries: read [u32],
        receivers: read [SurfacePoint],
        received: read [Rgb],
        irradiance: update [Rgb] as before,
    } each {
        let bend = lobes[k as usize].bend;
        let point = points[k as usize];
        let (ids, w) = view::pixel_vertices(grids, receiver_cells, vertices, triangles, hits[k as usize], point);
        let mut after = before;
        if ids.x != NONE && bend.dot(bend) > 0.0 {
            let mut sum = Slope::default();
            for corner in 0..3 {
                let row = if corner == 0 { ids.x } else if corner == 1 { ids.y } else { ids.z };
                let share = if corner == 0 { w.x } else if corner == 1 { w.y } else { w.z };
                sum = weights::add_difference(
                    row, p.block_rows, row_start, list_start, lists, entries, receivers, received, share, sum,
                );
            }
            // Even light comes from above the triangle only: of that a surface at an angle θ to it gets (1 + cosθ)/2.
            let even = before.truncate() * (1.0 - 0.25 * bend.dot(bend));
            after = (even + sum.along(bend)).max(Vec3::ZERO).extend(before.w);
        }
        after
    }

    /// Marks what the rows that a view needs take from, once for each view:
    /// [`weights::mark_row`]. One invocation per row.
    PATCHES_MARK_RECEIVERS: MarkReceiversPass = "patches_mark_receivers"(p: WeightParams) for k in 0..count {
        row_start: read [u32; count + 1],
        list_start: read [u32; crate::host::patches::blocks(p)?],
        lists: read [u32],
        entries: read [u32],
        row_marks: update [u32],
        marks: update [u32],
    } invocation {
        if row_marks[k as usize] == view::needed(p.view) {
            row_marks[k as usize] = view::needed(p.view) + 1;
            weights::mark_row(k, p, row_start, list_start, lists, entries, marks);
        }
    } host crate::host::patches::mark_receivers;
}
