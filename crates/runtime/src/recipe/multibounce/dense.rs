//! Dense operators: an entry for each pair of patches and each colour channel.

use std::sync::Arc;

use bytemuck::cast_slice;
use formfactor::{Dense, GatherParams, Half};
use glam::{UVec2, Vec4};
use gpu_kernels::transport::{GatherHalfPass, GatherPass};
use multibounce::kernel::blocks::NO_ELEMENT;
use scene::Rgb;

use super::Order;
use crate::executor::ExecutorError;
use crate::plan::{Plan, Slice};
use crate::recipe::{Table, Tables, row_blocks, row_step};

/// Columns of dense operators of n patches: three channels, whole vectors of four.
pub fn planar_columns(n: usize) -> usize {
    (3 * n).next_multiple_of(4)
}

/// The source of each element of planar RGB, if there is one, and its channel: red of all of `n` patches, green, blue,
/// and nothing up to a whole vector.
pub fn planar(n: usize) -> impl Iterator<Item = Option<(usize, usize)>> {
    (0..planar_columns(n)).map(move |k| (k < 3 * n).then(|| (k % n, k / n)))
}

/// A dense operator on the device. Its rows are `[red | green | blue | zeros]`, for planar RGB.
#[derive(Clone, Debug)]
pub struct DenseTables {
    /// Brings the channels into planes.
    order: Order,
    planes: Slice<Rgb>,
    factors: Factors,
    rows: usize,
    /// Vectors of four entries of a row.
    vectors: usize,
}

/// Entries in vectors of four.
#[derive(Clone, Copy, Debug)]
enum Factors {
    Single(Slice<Vec4>),
    Half(Slice<UVec2>),
}

/// Entries in single precision as bytes.
struct DenseBytes(Arc<Dense>);

impl Table for DenseBytes {
    fn bytes(&self) -> &[u8] {
        cast_slice(&self.0.values)
    }
}

/// Entries in half precision as bytes.
struct HalfBytes(Arc<Half>);

impl Table for HalfBytes {
    fn bytes(&self) -> &[u8] {
        cast_slice(&self.0.words)
    }
}

impl DenseTables {
    /// An operator in single precision.
    pub fn new(plan: &mut Plan, tables: &mut Tables, operator: &Arc<Dense>) -> Self {
        let entries = tables.add(plan, "operator", Arc::new(DenseBytes(Arc::clone(operator))));
        Self::with(plan, tables, operator.rows, Factors::Single(entries.of()))
    }

    /// An operator in half precision.
    pub fn half(plan: &mut Plan, tables: &mut Tables, operator: &Arc<Half>) -> Self {
        let entries = tables.add(plan, "operator", Arc::new(HalfBytes(Arc::clone(operator))));
        Self::with(plan, tables, operator.rows, Factors::Half(entries.of()))
    }

    fn with(plan: &mut Plan, tables: &mut Tables, rows: usize, factors: Factors) -> Self {
        let order: Vec<u32> = planar(rows).map(|at| at.map_or(NO_ELEMENT, |(j, _)| j as u32)).collect();
        let scale: Vec<Vec4> = planar(rows).map(|at| at.map_or(Vec4::ZERO, |(_, c)| Vec4::AXES[c])).collect();
        let columns = order.len();
        let order = tables.owned(plan, "channel order", order);
        let scale = tables.owned(plan, "channel scale", scale);
        Self {
            order: Order::new(order, scale, columns),
            planes: plan.array("channels", columns),
            factors,
            rows,
            vectors: columns / 4,
        }
    }

    /// Adds the passes of `irradiance = T exitance`; a binding shows at most `range` bytes.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn product(
        &self,
        plan: &mut Plan,
        pass: &str,
        range: u64,
        exitance: Slice<Rgb>,
        irradiance: Slice<Rgb>,
    ) -> Result<(), ExecutorError> {
        self.order.add(plan, pass, exitance, self.planes)?;
        let vector_bytes = match self.factors {
            Factors::Single(_) => size_of::<Vec4>(),
            Factors::Half(_) => size_of::<UVec2>(),
        };
        let row_bytes = (self.vectors * vector_bytes) as u64;
        let exitance = self.planes;
        for rows in row_blocks(self.rows, row_step(row_bytes), |first, end| (end - first) as u64 * row_bytes <= range) {
            let push = GatherParams {
                rows: rows.len() as u32,
                vectors: self.vectors as u32,
                first_row: rows.start as u32,
                reserved: 0,
            };
            let first = rows.start * self.vectors;
            let count = rows.len() * self.vectors;
            match self.factors {
                Factors::Single(all) => {
                    let factors = all.part(first, count);
                    plan.add(pass, &GatherPass { factors, exitance, irradiance }, &push)?;
                }
                Factors::Half(all) => {
                    let factors = all.part(first, count);
                    plan.add(pass, &GatherHalfPass { factors, exitance, irradiance }, &push)?;
                }
            }
        }
        Ok(())
    }
}
