//! Kernels of radiosity by samples: what changes, samples of rows, exact sums of some rows.

use ::scene::Rgb;
use ::temporal::kernel::{sample, tables};
use ::temporal::{SampleParams, SumParams};

use crate::params::CountParams;

kernels! {
    /// Change of the exitance since the irradiance was sampled, W/m²: [`sample::change`]. One
    /// invocation per patch.
    TEMPORAL_CHANGE: ChangePass = "temporal_change"(p: CountParams) for k in 0..count {
        source: read [Rgb],
        albedo: read [Rgb],
        irradiance: read [Rgb],
        exitance: read [Rgb],
        change: write [Rgb],
    } each {
        let i = k as usize;
        sample::change(source[i], albedo[i], irradiance[i], exitance[i])
    } host crate::host::temporal::change;

    /// Irradiance one frame on, W/m², by samples of lists of hits (`temporal::RayLists`):
    /// [`sample::sample_list`]. One invocation per row.
    TEMPORAL_SAMPLE_LISTS: SampleListsPass = "temporal_sample_lists"(p: SampleParams) for k in 0..rows {
        row_start: read [u32],
        columns: read [u32],
        row_sums: read [f32],
        exitance: read [Rgb],
        change: read [Rgb],
        irradiance: update [Rgb] as previous,
    } each {
        sample::sample_list(k, p, row_start, columns, row_sums, exitance, change, previous)
    } host crate::host::temporal::sample_lists;

    /// Samples rows by alias tables (`temporal::AliasTables`): [`tables::sample_table`].
    TEMPORAL_SAMPLE_TABLES: SampleTablesPass = "temporal_sample_tables"(p: SampleParams) for k in 0..rows {
        row_start: read [u32],
        slots: read [u32],
        columns: read [u32],
        colors: read [u32],
        row_sums: read [f32],
        exitance: read [Rgb],
        change: read [Rgb],
        irradiance: update [Rgb] as previous,
    } each {
        tables::sample_table(
            k, p, row_start, slots, columns, colors, row_sums, exitance, change, previous,
        )
    } host crate::host::temporal::sample_tables;

    /// Exact irradiance of some rows of lists of hits, W/m²: [`sample::sum_list`]. One invocation
    /// per such row.
    TEMPORAL_SUM_LISTS: SumListsPass = "temporal_sum_lists"(p: SumParams) for k in 0..count {
        row_start: read [u32],
        columns: read [u32],
        row_sums: read [f32],
        exitance: read [Rgb],
        irradiance: update [Rgb],
    } invocation {
        let i = sample::summed_row(k, p);
        let exact = sample::sum_list(i, p, row_start, columns, row_sums, exitance);
        irradiance[i as usize] = sample::settle(irradiance[i as usize], exact);
    } host crate::host::temporal::sum_lists;

    /// Sums of alias tables: [`tables::sum_table`].
    TEMPORAL_SUM_TABLES: SumTablesPass = "temporal_sum_tables"(p: SumParams) for k in 0..count {
        row_start: read [u32],
        slots: read [u32],
        columns: read [u32],
        colors: read [u32],
        row_sums: read [f32],
        exitance: read [Rgb],
        irradiance: update [Rgb],
    } invocation {
        let i = sample::summed_row(k, p);
        let exact = tables::sum_table(i, p, row_start, slots, columns, colors, row_sums, exitance);
        irradiance[i as usize] = sample::settle(irradiance[i as usize], exact);
    } host crate::host::temporal::sum_tables;
}
