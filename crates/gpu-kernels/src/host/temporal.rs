//! Host forms of the kernels that sample rows: the bodies on all cores. Columns beyond the light are taken for the last one by
//! the bodies themselves, so that a frame need not look at every entry.

use ::scene::Rgb;
use ::temporal::kernel::sample::{COLORED, NARROW, has};
use ::temporal::{
    SampleParams, SplitParams, SumParams, TableColumns, change_all, pack_all, sample_lists_all, sample_tables_all,
    scan_all, sum_lists_all, sum_tables_all,
};
use glam::UVec2;

use super::{Bound, HostCall, HostError, agreed};
use crate::params::CountParams;
use crate::table::Kernel;

/// Starts of a block of rows and the number of its entries from `first_entry` on.
fn starts<'s>(bound: Bound<'s, '_>, rows: usize, first_entry: u32) -> Result<(&'s [u32], usize), HostError> {
    let name = bound.name;
    let starts = &bound.read::<u32>(rows + 1)?[..rows + 1];
    let wrong = |needed| HostError::TooShort { binding: name, needed, found: 0 };
    if !starts.is_sorted() {
        return Err(wrong(usize::MAX));
    }
    let skipped = starts[0].checked_sub(first_entry).ok_or(wrong(first_entry as usize))?;
    Ok((starts, (skipped + (starts[rows] - starts[0])) as usize))
}

/// Words that hold so many columns.
fn column_words(entries: usize, options: u32) -> usize {
    if has(options, NARROW) { entries.div_ceil(2) } else { entries }
}

/// Words that hold so many colours.
fn color_words(entries: usize, options: u32) -> usize {
    if has(options, COLORED) { entries.div_ceil(2) } else { 0 }
}

/// Samples, and the rows to sum, must be there.
fn check(kernel: &Kernel, is_right: bool, binding: usize) -> Result<(), HostError> {
    let binding = kernel.bindings[binding].name;
    if is_right { Ok(()) } else { Err(HostError::TooShort { binding, needed: 1, found: 0 }) }
}

pub(crate) fn change(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [source, albedo, irradiance, exitance, change]) = call.parts::<CountParams, 5>(kernel)?;
    let n = agreed(elements, p.count)?;
    let (source, albedo) = (source.read::<Rgb>(n)?, albedo.read::<Rgb>(n)?);
    change_all(source, albedo, irradiance.read::<Rgb>(n)?, exitance.read::<Rgb>(n)?, change.write(n)?);
    Ok(())
}

pub(crate) fn sample_lists(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [row_start, columns, sums, exitance, change, irradiance]) = call.parts::<SampleParams, 6>(kernel)?;
    let n = agreed(elements, p.rows)?;
    check(kernel, p.samples > 0, 1)?;
    let (row_start, entries) = starts(row_start, n, p.first_entry)?;
    let (columns, sums) = (columns.read::<u32>(column_words(entries, p.options))?, sums.read::<f32>(n)?);
    let (exitance, change) = (exitance.read::<Rgb>(1)?, change.read::<Rgb>(1)?);
    sample_lists_all(&p, row_start, columns, sums, exitance, change, irradiance.write(n)?);
    Ok(())
}

pub(crate) fn sample_tables(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [row_start, slots, columns, colors, sums, exitance, change, irradiance]) =
        call.parts::<SampleParams, 8>(kernel)?;
    let n = agreed(elements, p.rows)?;
    check(kernel, p.samples > 0, 1)?;
    let (row_start, entries) = starts(row_start, n, p.first_entry)?;
    let tables = TableColumns {
        row_start,
        slots: slots.read(entries)?,
        columns: columns.read(column_words(entries, p.options))?,
        colors: colors.read(color_words(entries, p.options))?,
        sums: sums.read(n)?,
    };
    let (exitance, change) = (exitance.read::<Rgb>(1)?, change.read::<Rgb>(1)?);
    sample_tables_all(&p, &tables, exitance, change, irradiance.write(n)?);
    Ok(())
}

pub(crate) fn sum_lists(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [row_start, columns, sums, exitance, irradiance]) = call.parts::<SumParams, 5>(kernel)?;
    agreed(elements, p.count)?;
    check(kernel, p.count <= p.rows && p.first < p.rows, 0)?;
    let n = p.rows as usize;
    let (row_start, entries) = starts(row_start, n, p.first_entry)?;
    let (columns, sums) = (columns.read::<u32>(column_words(entries, p.options))?, sums.read::<f32>(n)?);
    sum_lists_all(&p, row_start, columns, sums, exitance.read::<Rgb>(1)?, irradiance.write(n)?);
    Ok(())
}

pub(crate) fn sum_tables(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [row_start, slots, columns, colors, sums, exitance, irradiance]) = call.parts::<SumParams, 7>(kernel)?;
    agreed(elements, p.count)?;
    check(kernel, p.count <= p.rows && p.first < p.rows, 0)?;
    let n = p.rows as usize;
    let (row_start, entries) = starts(row_start, n, p.first_entry)?;
    let tables = TableColumns {
        row_start,
        slots: slots.read(entries)?,
        columns: columns.read(column_words(entries, p.options))?,
        colors: colors.read(color_words(entries, p.options))?,
        sums: sums.read(n)?,
    };
    sum_tables_all(&p, &tables, exitance.read::<Rgb>(1)?, irradiance.write(n)?);
    Ok(())
}

pub(crate) fn split_scan(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [row_start, weights, scan]) = call.parts::<SplitParams, 3>(kernel)?;
    let n = agreed(elements, p.count)?;
    check(kernel, p.rows == p.count, 0)?;
    let (row_start, entries) = starts(row_start, n, 0)?;
    // Rows begin with the first entry.
    check(kernel, row_start[0] == 0, 0)?;
    scan_all(row_start, weights.read::<u32>(entries)?, scan.write::<UVec2>(entries)?);
    Ok(())
}

pub(crate) fn split_pack(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [row_start, weights, scan, slots]) = call.parts::<SplitParams, 4>(kernel)?;
    let n = agreed(elements, p.count)?;
    let (row_start, entries) = starts(row_start, p.rows as usize, 0)?;
    check(kernel, row_start[0] == 0 && n <= entries, 0)?;
    let (weights, scan) = (weights.read::<u32>(entries)?, scan.read::<UVec2>(entries)?);
    let mut rows = row_start.windows(2).map(|row| (row[1] - row[0], &scan[row[0] as usize..row[1] as usize]));
    check(kernel, rows.all(|(length, row)| row.iter().all(|s| s.x < length)), 2)?;
    pack_all(p.rows, row_start, weights, scan, slots.write(n)?);
    Ok(())
}
