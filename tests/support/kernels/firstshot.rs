//! Inputs of the kernels of photons: every kind of element, with and without shadow rays.

use std::ops::ControlFlow;

use firstshot::kernel::judge::JUDGED;
use firstshot::{
    Emission, FLAG_CARDANO, FLAG_DIRECT, JudgeParams, LightElementSettings, MapGrid, PhotonParams, ResolveParams,
    SEQUENCE_SOBOL, Texels, flux_words, tally_words,
};
use glam::{Vec2, Vec3, Vec4};
use scene::Scene;

use super::{Random, Tables, buffer, call, room};

/// Photons of a dispatch.
const PHOTONS: u32 = 700;
/// Groups of cells.
const GROUPS: u32 = 90;

pub(super) fn own_tables(r: &mut Random, name: &str, scene: &Scene) -> (u32, Vec<u8>, Tables) {
    match name {
        "firstshot_resolve" => resolve(r),
        "firstshot_judge" => judge(r),
        _ => trace(r, scene),
    }
}

/// Photons from all kinds of elements onto a few cells of each triangle.
fn trace(r: &mut Random, scene: &Scene) -> (u32, Vec<u8>, Tables) {
    let settings = LightElementSettings { elements: 2000, longest: 0.2, ..LightElementSettings::default() };
    let ignore_progress = |_, _| ControlFlow::Continue(());
    // Both ways to shoot together have all kinds of elements.
    let mut emission =
        Emission::first_shot(scene, &settings, Texels::Bound, true, &ignore_progress).expect("lights shine");
    let lamps = Emission::classical(scene).expect("lights shine");
    emission.elements.truncate(600);
    emission.elements.extend(&lamps.elements[..lamps.elements.len().min(600)]);
    emission.alias = firstshot::alias_table(&vec![1.0; emission.elements.len()]);
    let p = PhotonParams {
        low: emission.bounds.0,
        count: PHOTONS,
        high: emission.bounds.1,
        per_batch: 100,
        first: 40,
        first_batch: 3,
        element_count: emission.elements.len() as u32,
        sequence: SEQUENCE_SOBOL,
        seed: 9,
        flags: emission.flags | FLAG_CARDANO,
        absorption: Vec3::new(0.1, 0.2, 0.3),
        ray_offset: scene.geometry.ray_offset,
        ..PhotonParams::default()
    };
    // Cells of all sides, some that belong to no group; the last are not counted, so what lands there is unowned.
    let mut cells = 0;
    let grid = |_| {
        let divisions = 1 + r.below(3);
        cells += 2 * divisions * divisions;
        MapGrid { first: cells - 2 * divisions * divisions, divisions }
    };
    let grids: Vec<MapGrid> = (0..scene.geometry.triangles.len()).map(grid).collect();
    let p = PhotonParams { cell_count: cells - cells / 8, group_count: GROUPS, flags: p.flags | FLAG_DIRECT, ..p };
    let groups: Vec<u32> = (0..p.cell_count).map(|_| r.below(GROUPS + 5)).collect();
    // Low words that are full, so that additions carry.
    let full = |words: usize| (0..words).map(|k| if k % 2 == 0 { u32::MAX - 9 } else { 3 }).collect::<Vec<u32>>();
    let tables = vec![
        buffer("alias", &emission.alias),
        buffer("elements", &emission.elements),
        buffer("grids", &grids),
        buffer("groups", &groups),
        buffer("flux", &full(flux_words(p.cell_count as usize))),
        buffer("tallies", &full(tally_words(GROUPS as usize, PHOTONS / p.per_batch))),
    ];
    call(PHOTONS, p, tables)
}

/// Irradiance of 150 elements from sums of 400 cells.
fn resolve(r: &mut Random) -> (u32, Vec<u8>, Tables) {
    let count = 150;
    let cells = 400;
    let mut start = vec![0u32];
    for k in 0..count {
        start.push(start[k] + r.below(6));
    }
    let owned: Vec<u32> = (0..start[count]).map(|_| r.below(cells)).collect();
    let flux: Vec<u32> =
        (0..flux_words(cells as usize)).map(|k| if k % 2 == 0 { r.word() } else { r.below(900) }).collect();
    let areas: Vec<f32> = (0..count).map(|k| if k % 7 == 0 { 0.0 } else { r.unit() }).collect();
    let tables = vec![
        buffer("flux", &flux),
        buffer("cell_start", &start),
        buffer("cells", &owned),
        buffer("element_areas", &areas),
        room::<Vec4>("irradiance", count),
    ];
    call(count as u32, ResolveParams { count: count as u32, mean_flux: 3e-4 }, tables)
}

/// Blocks of groups in 7 batches; the last block is not full.
fn judge(r: &mut Random) -> (u32, Vec<u8>, Tables) {
    let groups = 9 * JUDGED - 5;
    let batches = 7;
    let words = tally_words(groups as usize, batches);
    let tallies: Vec<u32> = (0..words).map(|k| if k % 2 == 0 { r.word() } else { r.below(90) }).collect();
    let areas: Vec<f32> = (0..groups).map(|k| if k % 9 == 0 { 0.0 } else { r.unit() }).collect();
    let tables = vec![buffer("tallies", &tallies), buffer("group_areas", &areas), room::<Vec2>("judged", 9)];
    call(9, JudgeParams { count: 9, group_count: groups, batches }, tables)
}
