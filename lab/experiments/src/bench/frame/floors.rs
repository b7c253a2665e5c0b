//! Least work of passes, and the distance of their times from it.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::time::Instant;

use glam::{UVec2, Vec4};
use patches::PackedWeights;
use rayon::prelude::*;
use scene::{Hit, SurfacePoint};
use transport::{Csr, HitCounts, LinearOperator as _};

use super::{Machine, PASSES, ReceiverUpdate, Row, Work};
use crate::report::Table;
use patchlight::Bake;

/// Additions of a thread in a round of [`operations_g`], in independent sums that fill the registers.
const ADDITIONS: usize = 1 << 22;
const SUMS: usize = 8;
const ROUNDS: usize = 5;
/// Numbers of an RGB value as it is stored, and its bytes.
const VALUE: u64 = 4;
const RGB: u64 = size_of::<Vec4>() as u64;

/// Reading a table and adding up what its entries name.
fn of_entries(entries: usize, bytes: u64, rows: usize) -> Work {
    Work { bytes: bytes + rows as u64 * RGB, operations: entries as u64 * VALUE * 2 }
}

fn of_hits(rows: &HitCounts) -> Work {
    // Three additions and one multiplication and addition for the four columns of a quad.
    let quads = rows.quads().len();
    let bytes = quads * (size_of::<UVec2>() + 1) + size_of_val(rows.row_start()) + size_of_val(rows.scales());
    Work { bytes: bytes as u64 + rows.scales().len() as u64 * RGB, operations: quads as u64 * VALUE * 5 }
}

fn of_weights(weights: &PackedWeights) -> Work {
    of_entries(weights.weights(), weights.bytes(), weights.rows())
}

fn of_csr(rows: &Csr) -> Work {
    of_entries(rows.values.len(), rows.bytes(), rows.row_start.len())
}

impl Work {
    /// A share of it.
    fn times(self, share: f64) -> Self {
        Self { bytes: (self.bytes as f64 * share) as u64, operations: (self.operations as f64 * share) as u64 }
    }

    fn and(self, other: Self) -> Self {
        Self { bytes: self.bytes + other.bytes, operations: self.operations + other.operations }
    }
}

/// Least work of the passes of an update with so many lights, receivers and interpolation points.
pub fn work(
    bake: &Bake,
    lights: usize,
    receivers: ReceiverUpdate,
    (found, points): (usize, usize),
) -> BTreeMap<&'static str, Work> {
    let samples = bake.mesh().points.len() as u64;
    let shares = samples * lights as u64;
    let direct = Work {
        bytes: samples * (size_of::<SurfacePoint>() as u64 + 2 * RGB) + 2 * shares * size_of::<f32>() as u64,
        operations: shares * VALUE * 2,
    };
    let mut work = BTreeMap::from([("direct", direct)]);
    let elements = match &bake.form_factors().element_rows {
        Some(rows) => of_hits(rows),
        None => of_csr(&bake.form_factors().factors),
    };
    let all = &bake.receivers();
    let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
    let receivers_share = share(found, all.points.len());
    let rows = of_hits(&all.rows).and(of_weights(&all.smoothing)).times(receivers_share);
    let last = rows.and(of_weights(&all.weights).times(share(points, all.interpolation.points.len())));
    match receivers {
        ReceiverUpdate::All => {
            work.insert("lookup", elements.and(last));
        }
        ReceiverUpdate::InView => {
            work.insert("lookup", elements);
            work.insert("view", last);
        }
    }
    work
}

/// Bytes of the pixels that marking reads.
pub fn of_pixels((width, height): (u32, u32)) -> Work {
    let pixel = (size_of::<Hit>() + size_of::<SurfacePoint>()) as u64;
    Work { bytes: u64::from(width) * u64::from(height) * pixel, operations: 0 }
}

/// Multiplications and additions of single numbers that all cores make in a second, 10⁹: vectors of four as in the
/// products.
pub fn operations_g() -> f64 {
    let round = || {
        let start = Instant::now();
        let threads = rayon::current_num_threads();
        let sums: Vec<Vec4> = (0..threads)
            .into_par_iter()
            .map(|thread| {
                let a = black_box(Vec4::splat(0.5));
                let b = black_box(Vec4::splat(thread as f32));
                let mut sums = [a; SUMS];
                for _ in 0..ADDITIONS / SUMS {
                    for sum in &mut sums {
                        *sum = *sum * a + b;
                    }
                }
                sums.into_iter().sum()
            })
            .collect();
        black_box(sums);
        (threads * ADDITIONS) as f64 * 2.0 * VALUE as f64 * 1e-9 / start.elapsed().as_secs_f64()
    };
    (0..ROUNDS).map(|_| round()).fold(0.0, f64::max)
}

/// The floor of each pass, the time in which its bytes are read and its operations made, and the time that it took.
pub fn table(machine: &Machine, operations_g: f64, rows: &[Row]) -> Table {
    let mut lines = Vec::new();
    for row in rows {
        for pass in PASSES {
            let (Some(work), Some(&ms)) = (row.work.get(pass), row.passes.get(pass)) else { continue };
            if ms <= 0.0 {
                continue;
            }
            let reading = work.bytes as f64 * 1e-6 / machine.stream_gb_s;
            let adding = work.operations as f64 * 1e-6 / operations_g;
            let texts = [&row.scene, &row.method, row.event, row.receivers_updated, pass].map(str::to_owned);
            let numbers = [
                format!("{:.1}", work.bytes as f64 * 1e-6),
                format!("{:.1}", work.operations as f64 * 1e-6),
                format!("{reading:.2}"),
                format!("{adding:.2}"),
                format!("{ms:.2}"),
                format!("{:.1}", ms / reading.max(adding)),
            ];
            lines.push(texts.into_iter().chain(numbers).collect());
        }
    }
    let head = ["scene", "method", "what happens", "receivers", "pass"];
    let numbers = ["MB", "million operations", "ms to read", "ms to calculate", "ms", "times the floor"];
    Table {
        caption: format!(
            "Floors of the passes: tables read once at {:.1} GB/s and numbers multiplied and added at \
             {operations_g:.0}·10⁹ a second on all cores; rays are not counted.",
            machine.stream_gb_s
        ),
        head: head.into_iter().chain(numbers).map(str::to_owned).collect(),
        rows: lines,
    }
}
