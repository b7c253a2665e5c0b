//! Kernels of photons that start where lights fall first.

use ::firstshot::kernel::{judge, map, register, segment, start};
use ::firstshot::{AliasEntry, Element, HIT_BACK, JudgeParams, MapGrid, PhotonHit, PhotonParams, ResolveParams};
use ::scene::kernel::bvh;
use ::scene::{Light, Rgb, Sky};
use glam::{Vec2, Vec3};

use crate::sums;

kernels! {
    /// Every photon from its start to its last segment, each of its hits added to the flux of a cell
    /// and to the luminance of a group: [`start::start_photon`], [`segment::photon_hit`],
    /// [`register::registration`], [`segment::reflect`]. One invocation per photon.
    FIRSTSHOT_TRACE: TracePass = "firstshot_trace"(p: PhotonParams) for k in 0..count {
        alias: read [AliasEntry; p.element_count as usize],
        elements: read [Element; p.element_count as usize],
        geometry: GeometryTables,
        lights: read [Light],
        sky: read [Sky; 1],
        sky_map: read [Rgb],
        distributions: read [f32],
        grids: read [MapGrid],
        groups: read [u32; p.cell_count as usize],
        flux: update [u32],
        tallies: update [u32],
    } invocation {
        let sources = start::Sources { lights, sky: sky[0], sky_map, distributions };
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
            bvh::any_hit(&geometry, origin, direction, t_max)
        };
        let cell = |hit: &PhotonHit| {
            let grid = grids[hit.triangle as usize];
            map::cell_at(grid, hit.u, hit.v, hit.info & HIT_BACK != 0)
        };
        let group = |cell: u32| groups[cell as usize];
        let mut photon = start::start_photon(&geometry, &sources, p, alias, elements, k, stopped);
        let mut segments = 0;
        let mut registered = 0;
        while segment::is_under_way(&photon) {
            let met = bvh::closest_hit(&geometry, photon.origin, photon.direction, bvh::FAR);
            let hit = segment::photon_hit(&geometry, p, k, &photon, met);
            let to = register::registration(p, &hit, cell, group);
            sums::add_flux(flux, to.sum, hit.flux);
            sums::add_flux(flux, to.emitted, hit.flux);
            sums::add_luminance(tallies, to.luminance, hit.flux);
            segments += 1;
            registered += to.registered;
            photon = segment::reflect(&geometry, p, k, &photon, met);
        }
        sums::add_count(tallies, register::count_word(k), segments);
        sums::add_count(tallies, register::count_word(k) + 2, registered);
    } host crate::host::firstshot::trace;

    /// Irradiance of every element from the flux of its cells, W/m²: [`judge::element_irradiance`].
    /// One invocation per element.
    FIRSTSHOT_RESOLVE: ResolvePass = "firstshot_resolve"(p: ResolveParams) for k in 0..count {
        flux: read [u32],
        cell_start: read [u32; count + 1],
        cells: read [u32; cell_start[count] as usize],
        element_areas: read [f32; count],
        irradiance: write [Rgb],
    } each {
        judge::element_irradiance(p, flux, cell_start, cells, element_areas, k)
    }

    /// Noise and signal of every block of groups: [`judge::noise_and_signal`]. One invocation per
    /// block.
    FIRSTSHOT_JUDGE: JudgePass = "firstshot_judge"(p: JudgeParams) for k in 0..count {
        tallies: read [u32; (p.group_count * p.batches) as usize],
        group_areas: read [f32; p.group_count as usize],
        judged: write [Vec2],
    } each {
        judge::noise_and_signal(p, |word| tallies[word as usize], group_areas, k)
    }
}
