//! Inputs of the kernels of the matrix round a camera.

use ::localmatrix::kernel::{BLOCK, KEPT, compact, count, start};
use ::localmatrix::{FadeParams, LevelParams, SlotParams, UpdateParams};
use ::patches::{EMPTY_CELL, LookupParams, LookupPatch, RULE_WALLS};
use glam::{UVec2, Vec4};
use gpu_kernels::params::CountParams;

use super::{Data, Random, Tables, buffer, call, offsets, points_in_space, room, voxels};

/// Slots of the lists: the last block is not whole.
const SLOTS: u32 = 600;
const BLOCKS: u32 = SLOTS.div_ceil(BLOCK);
/// Slots of an update, a multiple of 4.
const UPDATED: u32 = 44;
const LEAVES: usize = 1500;

/// Light of the slots, a third of them dark.
fn light(r: &mut Random) -> Vec<Vec4> {
    (0..SLOTS).map(|_| if r.below(3) == 0 { Vec4::ZERO } else { r.color() }).collect()
}

fn starts(values: &[Vec4]) -> Vec<u32> {
    let counts: Vec<u32> = (0..BLOCKS).map(|block| count(block, SLOTS, values)).collect();
    (0..=BLOCKS).map(|block| start(block, &counts)).collect()
}

fn list(values: &[Vec4]) -> Vec<u32> {
    let starts = starts(values);
    (0..SLOTS).map(|place| compact(place, SLOTS, &starts, values)).collect()
}

/// Invocations, push constants and tables of a kernel.
pub(super) fn own_tables(r: &mut Random, name: &str) -> (u32, Vec<u8>, Tables) {
    let at_slots = CountParams { count: SLOTS };
    let at_leaves = CountParams { count: LEAVES as u32 };
    match name {
        "localmatrix_mean" => {
            // Some slots hold nothing, some leaves are of none.
            let run = |r: &mut Random| {
                let first = r.below(LEAVES as u32 - 20);
                UVec2::new(first, first + r.below(20))
            };
            let runs: Vec<UVec2> = (0..SLOTS).map(|_| run(r)).collect();
            let tables = vec![
                buffer("runs", &runs),
                buffer("area", &r.floats(LEAVES)),
                buffer("exitance", &r.colors(LEAVES)),
                room::<Vec4>("light", SLOTS as usize),
            ];
            call(SLOTS, at_slots, tables)
        }
        "localmatrix_count" => {
            let tables = vec![buffer("values", &light(r)), room::<u32>("counts", BLOCKS as usize)];
            call(BLOCKS, SlotParams { count: BLOCKS, slots: SLOTS }, tables)
        }
        "localmatrix_start" => {
            let counts: Vec<u32> = (0..BLOCKS).map(|_| r.below(BLOCK + 1)).collect();
            let tables = vec![buffer("counts", &counts), room::<u32>("starts", BLOCKS as usize + 1)];
            call(BLOCKS + 1, CountParams { count: BLOCKS + 1 }, tables)
        }
        "localmatrix_compact" => {
            let values = light(r);
            let tables = vec![
                buffer("starts", &starts(&values)),
                buffer("values", &values),
                room::<u32>("list", SLOTS as usize),
            ];
            call(SLOTS, at_slots, tables)
        }
        "localmatrix_product" => {
            let lit = light(r);
            let seen = light(r);
            let planes: Vec<(&'static str, Data)> =
                ["red", "green", "blue"].map(|plane| buffer(plane, &r.floats((SLOTS * SLOTS) as usize))).into();
            let sqrt_area: Vec<f32> = r.floats(SLOTS as usize).iter().map(|x| x + 0.1).collect();
            let mut tables = vec![
                buffer("lit_starts", &starts(&lit)),
                buffer("lit", &list(&lit)),
                buffer("visible_starts", &starts(&seen)),
                buffer("visible", &list(&seen)),
                buffer("sqrt_area", &sqrt_area),
                buffer("light", &lit),
                room::<Vec4>("irradiance", SLOTS as usize),
            ];
            tables.extend(planes);
            call(SLOTS, SlotParams { count: SLOTS, slots: SLOTS }, tables)
        }
        "localmatrix_spread" => {
            let slot_of: Vec<u32> = (0..LEAVES).map(|_| if r.below(9) == 0 { KEPT } else { r.below(SLOTS) }).collect();
            let tables = vec![
                buffer("slot_of", &slot_of),
                buffer("irradiance", &r.colors(SLOTS as usize)),
                room::<Vec4>("leaves", LEAVES),
            ];
            call(LEAVES as u32, at_leaves, tables)
        }
        "localmatrix_fade" => {
            let p = FadeParams { count: LEAVES as u32, keep: 0.9, has_jump: 1, display_white: 1.5 };
            let tables = vec![
                buffer("before", &r.colors(LEAVES)),
                buffer("now", &r.colors(LEAVES)),
                buffer("offset", &r.colors(LEAVES)),
            ];
            call(LEAVES as u32, p, tables)
        }
        "localmatrix_show" => {
            let leaf_of: Vec<u32> = (0..LEAVES as u32).rev().collect();
            let tables = vec![
                buffer("leaf_of", &leaf_of),
                buffer("now", &r.colors(LEAVES)),
                buffer("offset", &r.colors(LEAVES)),
                room::<Vec4>("irradiance", LEAVES),
            ];
            call(LEAVES as u32, at_leaves, tables)
        }
        "localmatrix_show_leaves" => {
            let leaves = 300;
            let first = 320;
            let merged = 40;
            let mut lookups = Vec::new();
            let mut cells = Vec::new();
            let mut places = Vec::new();
            let mut entries = Vec::new();
            // One level without nodes indoors.
            for level in 0..2u32 {
                let (shape, own, full) = voxels(r);
                let first_cell = cells.len() as u32;
                let place = places.len() as u32;
                let entry = entries.len() as u32;
                cells.extend(own.iter().map(|cell| cell & EMPTY_CELL | ((cell & !EMPTY_CELL) + place)));
                places.extend(offsets(r, full).iter().map(|offset| offset + entry));
                for _ in entry..places[places.len() - 1] {
                    let patch = first + level * merged + r.below(merged);
                    let position = r.vector();
                    let direction = r.direction();
                    entries.push(LookupPatch { position, patch, direction, reserved: 0 });
                }
                let outdoors = LookupParams { shape, plane_limit: 0.5, rule: RULE_WALLS, count: merged, first_cell };
                lookups.extend([outdoors, if level == 0 { outdoors } else { LookupParams::default() }]);
            }
            let mut points = points_in_space(r, leaves as usize);
            points.iter_mut().for_each(|point| point.patch = r.below(2));
            let p = LevelParams {
                eye: r.vector(),
                count: leaves,
                apparent_size: 0.9,
                edge: 0.5,
                levels: 2,
                begins: 1,
                fades: 1,
                keep: 0.8,
                has_jump: 1,
                display_white: 2.0,
            };
            let tables = vec![
                buffer("leaves", &points),
                buffer("light", &r.colors((first + 2 * merged) as usize)),
                buffer("lookups", &lookups),
                buffer("cells", &cells),
                buffer("offsets", &places),
                buffer("entries", &entries),
                buffer("offset", &r.colors(leaves as usize)),
                buffer("shown", &r.colors(leaves as usize)),
            ];
            call(leaves, p, tables)
        }
        "localmatrix_update" => {
            // A rank of 7, three slots with new columns, in the second of three planes.
            let rank = 7;
            let new = 3;
            let slots = UPDATED as usize;
            let mut new_column = vec![KEPT; slots];
            [5, 20, 43].iter().zip(0..).for_each(|(&slot, column): (&usize, u32)| new_column[slot] = column);
            let count = UPDATED * UPDATED / 4;
            let p = UpdateParams {
                count,
                slots: UPDATED,
                rank,
                sign: -1.0,
                first_vector: rank * UPDATED,
                first_column: new * UPDATED,
                reserved: [0; 2],
            };
            let tables = vec![
                buffer("vectors", &r.floats(3 * rank as usize * slots)),
                buffer("columns", &r.floats(3 * new as usize * slots)),
                buffer("new_column", &new_column),
                buffer("plane", &r.floats(slots * slots)),
            ];
            call(count, p, tables)
        }
        other => panic!("the kernel {other} has no input here: add one"),
    }
}
