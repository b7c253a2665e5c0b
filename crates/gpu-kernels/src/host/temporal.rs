//! Host forms of the kernels that sample rows: the bodies on all cores. Columns beyond the light are taken for the last
//! one by the bodies themselves, so that a frame need not look at every entry.

use ::scene::Rgb;
use ::temporal::kernel::sample::{COLORED, NARROW, has};
use ::temporal::{
    SampleParams, SumParams, TableColumns, change_all, sample_lists_all, sample_tables_all, sum_lists_all,
    sum_tables_all,
};

use super::{Bound, HostCall, HostError};
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
    let (p, [source, albedo, irradiance, exitance, change]) = call.parts::<CountParams, 5>(kernel)?;
    let n = p.count as usize;
    let source = source.read::<Rgb>(n)?;
    let albedo = albedo.read::<Rgb>(n)?;
    change_all(source, albedo, irradiance.read::<Rgb>(n)?, exitance.read::<Rgb>(n)?, change.write(n)?);
    Ok(())
}

pub(crate) fn sample_lists(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, columns, sums, exitance, change, irradiance]) = call.parts::<SampleParams, 6>(kernel)?;
    let n = p.rows as usize;
    check(kernel, p.samples > 0, 1)?;
    let (row_start, entries) = starts(row_start, n, p.first_entry)?;
    let columns = columns.read::<u32>(column_words(entries, p.options))?;
    let sums = sums.read::<f32>(n)?;
    let exitance = exitance.read::<Rgb>(1)?;
    let change = change.read::<Rgb>(1)?;
    sample_lists_all(&p, row_start, columns, sums, exitance, change, irradiance.write(n)?);
    Ok(())
}

pub(crate) fn sample_tables(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, slots, columns, colors, sums, exitance, change, irradiance]) =
        call.parts::<SampleParams, 8>(kernel)?;
    let n = p.rows as usize;
    check(kernel, p.samples > 0, 1)?;
    let (row_start, entries) = starts(row_start, n, p.first_entry)?;
    let tables = TableColumns {
        row_start,
        slots: slots.read(entries)?,
        columns: columns.read(column_words(entries, p.options))?,
        colors: colors.read(color_words(entries, p.options))?,
        sums: sums.read(n)?,
    };
    let exitance = exitance.read::<Rgb>(1)?;
    let change = change.read::<Rgb>(1)?;
    sample_tables_all(&p, &tables, exitance, change, irradiance.write(n)?);
    Ok(())
}

pub(crate) fn sum_lists(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, columns, sums, exitance, irradiance]) = call.parts::<SumParams, 5>(kernel)?;
    check(kernel, p.count <= p.rows && p.first < p.rows, 0)?;
    let n = p.rows as usize;
    let (row_start, entries) = starts(row_start, n, p.first_entry)?;
    let columns = columns.read::<u32>(column_words(entries, p.options))?;
    let sums = sums.read::<f32>(n)?;
    sum_lists_all(&p, row_start, columns, sums, exitance.read::<Rgb>(1)?, irradiance.write(n)?);
    Ok(())
}

pub(crate) fn sum_tables(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, [row_start, slots, columns, colors, sums, exitance, irradiance]) = call.parts::<SumParams, 7>(kernel)?;
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
