//! Inputs of the kernels that sample rows.

use ::temporal::kernel::sample::{AUTO, COLORED, NARROW, ROTATED};
use ::temporal::{SampleParams, SumParams};
use glam::Vec4;
use gpu_kernels::params::CountParams;

use super::{Random, Tables, buffer, call, room};

const ROWS: u32 = 150;
const COLUMNS: u32 = 90;
/// Entries that the block leaves out.
const SKIPPED: u32 = 2;

/// Starts of the rows, some of them empty, words of columns or colours of their entries, and slots.
fn rows(r: &mut Random) -> (Vec<u32>, Vec<u32>, Vec<u32>) {
    let mut row_start = vec![SKIPPED + 1];
    let mut slots = vec![0];
    for k in 0..ROWS as usize {
        let count = r.below(30);
        slots.extend((0..count).map(|_| r.word() << 16 | r.below(count)));
        row_start.push(row_start[k] + count);
    }
    let words = (0..slots.len().div_ceil(2)).map(|_| r.below(COLUMNS) << 16 | r.below(COLUMNS)).collect();
    (row_start, words, slots)
}

/// Elements, push constants and tables of a kernel.
pub(super) fn own_tables(r: &mut Random, name: &str) -> (u32, Vec<u8>, Tables) {
    let light = |r: &mut Random| -> Tables {
        let exitance = r.colors(COLUMNS as usize);
        let change = r.colors(COLUMNS as usize);
        let change: Vec<Vec4> = change.iter().map(|c| (*c - Vec4::splat(0.4)) * 0.1).collect();
        // Averages of up to ten frames.
        let irradiance: Vec<Vec4> = (0..ROWS).map(|_| r.color().truncate().extend(10.0 * r.unit())).collect();
        vec![buffer("exitance", &exitance), buffer("change", &change), buffer("irradiance", &irradiance)]
    };
    let sample = SampleParams {
        rows: ROWS,
        first_row: 1000,
        first_entry: SKIPPED,
        samples: 37,
        frame: 5,
        seed: 3,
        options: NARROW | ROTATED | AUTO,
        blend: 0.9,
    };
    let sum = SumParams { count: 60, rows: ROWS, first: 120, first_entry: SKIPPED, options: NARROW };
    let (row_start, words, slots) = rows(r);
    let row_sums = r.floats(ROWS as usize);
    let lists = || vec![buffer("row_start", &row_start), buffer("columns", &words), buffer("row_sums", &row_sums)];
    let tables = |r: &mut Random| -> Tables {
        let mut tables = lists();
        tables.extend([buffer("slots", &slots), buffer("colors", &r.words(words.len() as u32))]);
        tables
    };
    let of_sum = |tables: Tables| -> Tables { tables.into_iter().filter(|(name, _)| *name != "change").collect() };
    match name {
        "temporal_change" => {
            let n = 200;
            let mut tables: Tables =
                ["source", "albedo", "irradiance", "exitance"].map(|b| buffer(b, &r.colors(n))).into();
            tables.push(room::<Vec4>("change", n));
            call(n as u32, CountParams { count: n as u32 }, tables)
        }
        "temporal_sample_lists" => call(ROWS, sample, [lists(), light(r)].concat()),
        "temporal_sample_tables" => {
            // Independent samples with colours; the other one has what this has not.
            let p = SampleParams { options: NARROW | COLORED, ..sample };
            call(ROWS, p, [tables(r), light(r)].concat())
        }
        "temporal_sum_lists" => call(sum.count, sum, of_sum([lists(), light(r)].concat())),
        "temporal_sum_tables" => {
            let p = SumParams { options: NARROW | COLORED, ..sum };
            call(p.count, p, of_sum([tables(r), light(r)].concat()))
        }
        other => panic!("the kernel {other} has no input here: add one"),
    }
}
