//! Dense operators: an entry for each pair of patches and each colour channel.

use std::sync::Arc;

use bytemuck::cast_slice;
use formfactor::{Dense, GatherParams, Half};
use glam::Vec4;
use gpu_kernels::table::Kernel;
use multibounce::kernel::blocks::NO_ELEMENT;

use super::{DENSE, HALF, reorder};
use crate::executor::ExecutorError;
use crate::plan::{BufferId, Plan, Range};
use crate::recipe::{Table, Tables, add_pass, rgb_bytes, row_blocks, row_step};

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
    kernel: &'static Kernel,
    /// Brings the channels into planes.
    order: Range,
    scale: Range,
    planes: BufferId,
    factors: BufferId,
    rows: usize,
    columns: usize,
    row_bytes: u64,
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
        Self::with(plan, tables, operator.rows, Arc::new(DenseBytes(Arc::clone(operator))), DENSE)
    }

    /// An operator in half precision.
    pub fn half(plan: &mut Plan, tables: &mut Tables, operator: &Arc<Half>) -> Self {
        Self::with(plan, tables, operator.rows, Arc::new(HalfBytes(Arc::clone(operator))), HALF)
    }

    fn with(
        plan: &mut Plan,
        tables: &mut Tables,
        rows: usize,
        entries: Arc<dyn Table>,
        kernel: &'static Kernel,
    ) -> Self {
        let order: Vec<u32> = planar(rows).map(|at| at.map_or(NO_ELEMENT, |(j, _)| j as u32)).collect();
        let scale: Vec<Vec4> = planar(rows).map(|at| at.map_or(Vec4::ZERO, |(_, c)| Vec4::AXES[c])).collect();
        let columns = order.len();
        let row_bytes = (entries.bytes().len() / rows.max(1)) as u64;
        Self {
            kernel,
            order: tables.owned(plan, "channel order", order),
            scale: tables.owned(plan, "channel scale", scale),
            planes: plan.storage("channels", rgb_bytes(columns)),
            factors: tables.add(plan, "operator", entries).buffer,
            rows,
            columns,
            row_bytes,
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
        exitance: BufferId,
        irradiance: BufferId,
    ) -> Result<(), ExecutorError> {
        reorder(plan, pass, self.order, self.scale, exitance, self.planes, self.columns as u32)?;
        let fits = |first: usize, end: usize| (end - first) as u64 * self.row_bytes <= range;
        for rows in row_blocks(self.rows, row_step(self.row_bytes), fits) {
            let part = self.factors.range(rows.start as u64 * self.row_bytes, rows.len() as u64 * self.row_bytes);
            let own = [("factors", part), ("exitance", self.planes.into()), ("irradiance", irradiance.into())];
            let push = GatherParams {
                rows: rows.len() as u32,
                vectors: self.columns as u32 / 4,
                first_row: rows.start as u32,
                reserved: 0,
            };
            add_pass(plan, pass, self.kernel, &own, &[], &push, push.rows)?;
        }
        Ok(())
    }
}
