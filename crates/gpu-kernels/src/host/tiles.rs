//! Host forms of the kernels of tiles: on all cores, in vectors where the bodies allow it, bit for bit.

use ::multibounce::kernel::tiles::{LANES, NO_SLOT, PARTS, PLACES, QUAD, SPLITS, TILE};
use ::multibounce::{ExpandTables, TileQuad, enter_all, expand_all, leave_all, project_all};
use ::scene::Rgb;

use super::{HostCall, HostError, agreed};
use crate::params::{CountParams, EnterParams};
use crate::table::Kernel;

/// The greatest number in a table, and one more.
fn named(table: &[u32]) -> usize {
    table.iter().map(|&k| k as usize + 1).max().unwrap_or(0)
}

/// The greatest of starts that must ascend, or more than any table has.
fn end(starts: &[u32]) -> usize {
    if starts.is_sorted() { starts.last().map_or(0, |&k| k as usize) } else { usize::MAX }
}

/// Words that these quads read.
fn words_of(quads: &[TileQuad]) -> usize {
    let end = |quad: &TileQuad| (quad.group as usize + (QUAD * quad.groups()) as usize) * LANES as usize;
    quads.iter().map(end).max().unwrap_or(0)
}

pub(crate) fn enter(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [order, root, exitance, ordered]) = call.parts::<EnterParams, 4>(kernel)?;
    let n = agreed(elements, p.count)?;
    let order = &order.read::<u32>(p.patches as usize)?[..p.patches as usize];
    let patches = named(order);
    enter_all(order, root.read(patches)?, exitance.read::<Rgb>(patches)?, ordered.write(n)?);
    Ok(())
}

pub(crate) fn project(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [quads, words, scale, ordered, sums]) = call.parts::<CountParams, 5>(kernel)?;
    let n = agreed(elements, p.count)?;
    let quads = &quads.read::<TileQuad>(n)?[..n];
    let words = words.read::<u32>(words_of(quads))?;
    let blocks = quads.iter().map(|quad| quad.block() as usize + 1).max().unwrap_or(0);
    let (slots, ordered) = (QUAD as usize * n, ordered.read::<Rgb>(blocks * TILE as usize)?);
    project_all(quads, words, scale.read(slots)?, ordered, sums.write(slots)?);
    Ok(())
}

pub(crate) fn expand(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [quad_start, quads, words, partner, sums, row_start, entries, steps, ordered, rows]) =
        call.parts::<CountParams, 10>(kernel)?;
    let n = agreed(elements, p.count)?;
    let blocks = n / (LANES * SPLITS) as usize;
    let places = blocks * TILE as usize;
    let quad_start = &quad_start.read::<u32>(blocks + 1)?[..blocks + 1];
    let row_start = &row_start.read::<u32>(places + 1)?[..places + 1];
    let (quads, entries) = (quads.read::<TileQuad>(end(quad_start))?, entries.read::<u32>(end(row_start))?);
    let quads = &quads[..end(quad_start)];
    let partner = &partner.read::<u32>(QUAD as usize * quads.len())?[..QUAD as usize * quads.len()];
    let others = partner.iter().filter(|&&slot| slot != NO_SLOT).map(|&slot| slot as usize + 1);
    let sums = sums.read::<Rgb>(others.max().unwrap_or(0))?;
    let words = words.read::<u32>(words_of(quads))?;
    let tables = ExpandTables { quad_start, quads, words, partner, row_start, entries, steps: steps.read(places)? };
    expand_all(&tables, sums, &ordered.read::<Rgb>(PLACES)?[..PLACES], rows.write(PARTS as usize * n)?);
    Ok(())
}

pub(crate) fn leave(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [place, root, rows, irradiance]) = call.parts::<CountParams, 4>(kernel)?;
    let n = agreed(elements, p.count)?;
    let (place, root) = (&place.read::<u32>(n)?[..n], root.read(n)?);
    let blocks = named(place).div_ceil(TILE as usize);
    leave_all(place, root, rows.read::<Rgb>(blocks * (SPLITS * TILE) as usize)?, irradiance.write(n)?);
    Ok(())
}
