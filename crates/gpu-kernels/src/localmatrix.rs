//! Kernels of the matrix round a camera: light of merged patches, lists of slots, the product
//! between them, what the patches get of it, and updates of the matrix.

use ::localmatrix::kernel;
use ::localmatrix::kernel::BLOCK;
use ::localmatrix::{FadeParams, LevelParams, SlotParams, UpdateParams};
use ::patches::kernel::lookup::lookup;
use ::patches::{LookupParams, LookupPatch};
use ::scene::{Rgb, SurfacePoint};
use glam::{UVec2, Vec4};

use crate::params::CountParams;

kernels! {
    /// Mean exitance of the leaves of each slot, W/m²: [`kernel::mean`]. One invocation per slot.
    LOCALMATRIX_MEAN: MeanPass = "localmatrix_mean"(p: CountParams) for slot in 0..count {
        runs: read [UVec2; count],
        area: read [f32; crate::host::localmatrix::end_of_runs(&runs[..count])],
        exitance: read [Rgb; crate::host::localmatrix::end_of_runs(&runs[..count])],
        light: write [Rgb],
    } each {
        let run = runs[slot as usize];
        kernel::mean(run.x, run.y, area, exitance)
    }

    /// Slots of each block of 64 whose light is not 0: [`kernel::count`]. One invocation per block.
    LOCALMATRIX_COUNT: CountPass = "localmatrix_count"(p: SlotParams) for block in 0..count {
        values: read [Rgb; p.slots as usize],
        counts: write [u32],
    } each {
        kernel::count(block, p.slots, values)
    }

    /// Start of each block in the list; at the end its length: [`kernel::start`]. One invocation per block, and one for
    /// the end.
    LOCALMATRIX_START: StartPass = "localmatrix_start"(p: CountParams) for block in 0..count {
        counts: read [u32; count.saturating_sub(1)],
        starts: write [u32],
    } each {
        kernel::start(block, counts)
    }

    /// Slots whose light is not 0, then the others: [`kernel::compact`]. One invocation per place
    /// of the list.
    LOCALMATRIX_COMPACT: CompactPass = "localmatrix_compact"(p: CountParams) for place in 0..count {
        starts: read [u32],
        values: read [Rgb],
        list: write [u32],
    } each {
        kernel::compact(place, p.count, starts, values)
    } host crate::host::localmatrix::compact;

    /// Irradiance of visible slots from lit ones, W/m²: [`kernel::gather`]. One invocation per
    /// place of the list of visible slots, whatever comes after them gets nothing.
    LOCALMATRIX_PRODUCT: ProductPass = "localmatrix_product"(p: SlotParams) for k in 0..count {
        lit_starts: read [u32],
        lit: read [u32],
        visible_starts: read [u32],
        visible: read [u32],
        red: read [f32],
        green: read [f32],
        blue: read [f32],
        sqrt_area: read [f32],
        light: read [Rgb],
        irradiance: write [Rgb],
    } invocation {
        let slot = visible[k as usize];
        let end = p.slots.div_ceil(BLOCK) as usize;
        // Invocations beyond the visible slots have nothing to sum; each slot is named once.
        let lit_count = if k < visible_starts[end] { lit_starts[end] } else { 0 };
        irradiance[slot as usize] =
            kernel::gather(slot, p.slots, lit_count, lit, red, green, blue, sqrt_area, light);
    } host crate::host::localmatrix::product;

    /// Irradiance of each leaf from that of the slots, W/m²: [`kernel::spread`]. One invocation
    /// per leaf.
    LOCALMATRIX_SPREAD: SpreadPass = "localmatrix_spread"(p: CountParams) for leaf in 0..count {
        slot_of: read [u32; count],
        irradiance: read [Rgb; crate::host::localmatrix::slots_named(&slot_of[..count]).max(1)],
        leaves: write [Rgb],
    } each {
        kernel::spread(slot_of[leaf as usize], irradiance)
    }

    /// Remaining jump of each leaf's light, W/m²: [`kernel::fade`]. One invocation per leaf.
    LOCALMATRIX_FADE: FadePass = "localmatrix_fade"(p: FadeParams) for k in 0..count {
        before: read [Rgb; count],
        now: read [Rgb; count],
        offset: update [Rgb] as old,
    } each {
        let i = k as usize;
        kernel::fade(old, before[i], now[i], p)
    }

    /// Irradiance of each patch from that of its leaf and what is left of jumps, W/m²:
    /// [`kernel::show`]. One invocation per patch.
    LOCALMATRIX_SHOW: ShowPass = "localmatrix_show"(p: CountParams) for k in 0..count {
        leaf_of: read [u32; count],
        now: read [Rgb; crate::host::named(&leaf_of[..count])],
        offset: read [Rgb; crate::host::named(&leaf_of[..count])],
        irradiance: write [Rgb],
    } each {
        kernel::show(leaf_of[k as usize], now, offset)
    }

    /// Light of each leaf of a streamed world as a camera is to see it, and what is left of its
    /// jumps, W/m²: [`kernel::level`], [`kernel::show_leaf`]. One invocation per leaf. A level has
    /// two lookups, of its nodes outdoors and indoors; `leaves` name theirs as their patch.
    LOCALMATRIX_SHOW_LEAVES: ShowLeavesPass = "localmatrix_show_leaves"(p: LevelParams) for k in 0..count {
        leaves: read [SurfacePoint; count],
        light: read [Rgb; count],
        lookups: read [LookupParams; 2 * p.levels as usize],
        cells: read [u32],
        offsets: read [u32],
        entries: read [LookupPatch],
        offset: update [Rgb] as left,
        shown: update [Rgb] as before,
    } each {
        let leaf = leaves[k as usize];
        let own = light[k as usize];
        let (low, share) = kernel::level(p, leaf.position);
        let mut seen = own;
        if low > 0 {
            let of_level = lookups[(2 * (low - 1) + leaf.patch) as usize];
            seen = merged_light(&of_level, cells, offsets, entries, light, leaf);
        }
        if share > 0.0 {
            let of_next = lookups[(2 * low + leaf.patch) as usize];
            let next = merged_light(&of_next, cells, offsets, entries, light, leaf);
            seen += (next - seen) * share;
        }
        kernel::show_leaf(left, before, seen, p)
    }

    /// A plane of the matrix after patches came or went: [`kernel::update`]. One invocation per
    /// four columns of a row.
    LOCALMATRIX_UPDATE: UpdatePass = "localmatrix_update"(p: UpdateParams) for k in 0..count {
        vectors: read [f32],
        columns: read [f32],
        new_column: read [u32],
        plane: update [f32],
    } invocation {
        let at = 4 * k as usize;
        let old = Vec4::new(plane[at], plane[at + 1], plane[at + 2], plane[at + 3]);
        let new = kernel::update(k, p, vectors, columns, new_column, old);
        plane[at] = new.x;
        plane[at + 1] = new.y;
        plane[at + 2] = new.z;
        plane[at + 3] = new.w;
    } host crate::host::localmatrix::update;
}

/// Light of the merged nodes about a leaf, W/m²; 0 in a lookup without nodes.
#[inline]
fn merged_light(
    of_level: &LookupParams,
    cells: &[u32],
    offsets: &[u32],
    entries: &[LookupPatch],
    light: &[Vec4],
    leaf: SurfacePoint,
) -> Vec4 {
    if of_level.count == 0 {
        return Vec4::ZERO;
    }
    lookup(of_level, cells, offsets, entries, light, leaf.position, leaf.normal)
}
