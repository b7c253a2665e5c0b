//! Host forms of the kernels of tiles: on all cores, in vectors where the bodies allow it, bit for bit.

use ::multibounce::kernel::tiles::{
    FACTOR_WORDS, LANES, LIGHT_WORDS, NO_SLOT, PAIRS, PARTS, PLACES, QUAD, QUARTERS, RUN_PARTS, RUN_QUADS, SPLITS,
    SQUARE_WORDS, TILE,
};
use ::multibounce::{
    ExpandTables, NearTables, ProjectTables, TileQuad, TileSquare, enter_all, expand_all, leave_all, near_all,
    project_all, round_all, weigh_all,
};
use ::scene::Rgb;

use super::{HostCall, HostError, named};
use crate::params::{CountParams, EnterParams, ProjectParams};
use crate::table::Kernel;

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
    let (p, [order, root, exitance, ordered]) = call.parts::<EnterParams, 4>(kernel)?;
    let n = p.count as usize;
    let order = &order.read::<u32>(p.patches as usize)?[..p.patches as usize];
    let patches = named(order);
    enter_all(order, root.read(patches)?, exitance.read::<Rgb>(patches)?, ordered.write(n)?);
    Ok(())
}

pub(crate) fn round(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [ordered, light]) = call.parts::<CountParams, 2>(kernel)?;
    let blocks = p.count as usize / QUARTERS as usize;
    let places = blocks * TILE as usize;
    round_all(&ordered.read::<Rgb>(places)?[..places], light.write(blocks * LIGHT_WORDS as usize)?);
    Ok(())
}

pub(crate) fn project(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [runs, quads, words, scale, light, sums]) = call.parts::<ProjectParams, 6>(kernel)?;
    let runs_count = p.count as usize / RUN_PARTS as usize;
    let n = runs_of(&runs.read::<u32>(runs_count + 1)?[..runs_count + 1]);
    let quads = &quads.read::<TileQuad>(n)?[..n];
    let words = words.read::<u32>(words_of(quads))?;
    let blocks = quads.iter().map(|quad| quad.block() as usize + 1).max().unwrap_or(0);
    let (slots, light) = (QUAD as usize * n, light.read::<u32>(blocks * LIGHT_WORDS as usize)?);
    let tables = ProjectTables { axes: p.axes, quads, words, scale: scale.read(slots)? };
    project_all(&tables, light, sums.write(slots)?);
    Ok(())
}

/// The first quads of so many runs, each of at most [`RUN_QUADS`], and how many quads they have in all; more than any table
/// has when they are not that.
fn runs_of(runs: &[u32]) -> usize {
    let few = |run: &[u32]| run[1].checked_sub(run[0]).is_some_and(|quads| quads <= RUN_QUADS);
    if runs.windows(2).all(few) { runs.last().map_or(0, |&k| k as usize) } else { usize::MAX / QUAD as usize }
}

pub(crate) fn weigh(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [runs, partner, sums, factors]) = call.parts::<CountParams, 4>(kernel)?;
    let n = p.count as usize;
    let runs = &runs.read::<u32>(n + 1)?[..n + 1];
    let slots = QUAD as usize * runs_of(runs);
    let partner = &partner.read::<u32>(slots)?[..slots];
    let others = partner.iter().filter(|&&slot| slot != NO_SLOT).map(|&slot| slot as usize + 1);
    let sums = sums.read::<Rgb>(others.max().unwrap_or(0))?;
    weigh_all(runs, partner, sums, factors.write(n * FACTOR_WORDS as usize)?);
    Ok(())
}

pub(crate) fn expand(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [run_start, runs, quads, words, factors, rows]) = call.parts::<CountParams, 6>(kernel)?;
    let n = p.count as usize;
    let blocks = n / (PAIRS * SPLITS) as usize;
    let run_start = &run_start.read::<u32>(blocks + 1)?[..blocks + 1];
    let count = end(run_start);
    let runs = &runs.read::<u32>(count.saturating_add(1))?[..count + 1];
    let factors = factors.read::<u32>(count * FACTOR_WORDS as usize)?;
    let quads = &quads.read::<TileQuad>(runs_of(runs))?[..runs_of(runs)];
    let words = words.read::<u32>(words_of(quads))?;
    expand_all(&ExpandTables { run_start, runs, quads, words }, factors, rows.write(2 * PARTS as usize * n)?);
    Ok(())
}

pub(crate) fn near(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [square_start, squares, square_words, light, row_start, entries, steps, ordered, near]) =
        call.parts::<CountParams, 9>(kernel)?;
    let n = 8 * p.count as usize;
    let edges = n / LANES as usize;
    let square_start = &square_start.read::<u32>(edges + 1)?[..edges + 1];
    let count = end(square_start);
    let squares = &squares.read::<TileSquare>(count)?[..count];
    let square_words = square_words.read::<u32>(count * SQUARE_WORDS as usize)?;
    let blocks = squares.iter().map(|square| (square.column / PARTS) as usize + 1).max().unwrap_or(0);
    let light = light.read::<u32>(blocks * LIGHT_WORDS as usize)?;
    let row_start = &row_start.read::<u32>(n + 1)?[..n + 1];
    let entries = entries.read::<u32>(end(row_start))?;
    let tables = NearTables { square_start, squares, square_words, row_start, entries, steps: steps.read(n)? };
    near_all(&tables, light, &ordered.read::<Rgb>(PLACES)?[..PLACES], near.write(n)?);
    Ok(())
}

pub(crate) fn leave(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [place, root, rows, near, irradiance]) = call.parts::<CountParams, 5>(kernel)?;
    let n = p.count as usize;
    let (place, root) = (&place.read::<u32>(n)?[..n], root.read(n)?);
    let blocks = named(place).div_ceil(TILE as usize);
    let rows = rows.read::<Rgb>(blocks * (SPLITS * TILE) as usize)?;
    leave_all(place, root, rows, near.read::<Rgb>(blocks * TILE as usize)?, irradiance.write(n)?);
    Ok(())
}
