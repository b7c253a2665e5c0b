//! Host forms of the kernels of tiles: on all cores, in vectors where the bodies allow it, bit for bit.

use ::multibounce::kernel::tiles::{LANES, TILE};
use ::multibounce::{ExpandTables, TileComponent, enter_all, expand_all, leave_all, project_all};
use ::scene::Rgb;

use super::{HostCall, HostError, agreed, long_enough};
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

/// Words that these components read.
fn words_of<'a>(components: impl Iterator<Item = &'a TileComponent>) -> usize {
    let end = |component: &TileComponent| (component.group as usize + component.groups() as usize) * LANES as usize;
    components.map(end).max().unwrap_or(0)
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
    let (p, [components, words, ordered, sums]) = call.parts::<CountParams, 4>(kernel)?;
    let n = agreed(elements, p.count)?;
    let components = &components.read::<TileComponent>(n.div_ceil(2))?[..n.div_ceil(2)];
    let words = words.read::<u32>(words_of(components.iter()))?;
    let vectors = components.iter().flat_map(|component| [0, 1].map(|side| component.vector(side).block as usize + 1));
    let blocks = vectors.max().unwrap_or(0);
    let ordered = ordered.read::<Rgb>(blocks.saturating_mul(TILE as usize))?;
    project_all(components, words, ordered, sums.write(n)?);
    Ok(())
}

pub(crate) fn expand(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [use_start, uses, components, words, sums, row_start, entries, steps, ordered, rows]) =
        call.parts::<CountParams, 10>(kernel)?;
    let n = agreed(elements, p.count)?;
    let blocks = n.div_ceil(TILE as usize);
    let use_start = &use_start.read::<u32>(blocks + 1)?[..blocks + 1];
    let row_start = &row_start.read::<u32>(n + 1)?[..n + 1];
    let (uses, entries) = (uses.read::<u32>(end(use_start))?, entries.read::<u32>(end(row_start))?);
    let uses = &uses[..end(use_start)];
    let count = named(uses).div_ceil(2);
    let (components, sums) = (components.read::<TileComponent>(count)?, sums.read::<Rgb>(2 * count)?);
    let words = words.read::<u32>(words_of(uses.iter().map(|&slot| &components[slot as usize / 2])))?;
    let (steps, ordered) = (steps.read::<f32>(n)?, ordered.read::<Rgb>(0)?);
    let columns = entries[..end(row_start)].iter().map(|entry| (entry & 0xffff) as usize + 1).max().unwrap_or(0);
    long_enough("ordered", ordered.len(), columns)?;
    let tables = ExpandTables { use_start, uses, components, words, row_start, entries, steps };
    expand_all(&tables, sums, ordered, rows.write(n)?);
    Ok(())
}

pub(crate) fn leave(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [place, root, rows, irradiance]) = call.parts::<CountParams, 4>(kernel)?;
    let n = agreed(elements, p.count)?;
    let (place, root) = (&place.read::<u32>(n)?[..n], root.read(n)?);
    leave_all(place, root, rows.read::<Rgb>(named(place))?, irradiance.write(n)?);
    Ok(())
}
