//! Recipes of `multibounce`: products with an operator, however it is stored, and bounces that use where light was
//! going.

mod blocks;
mod dense;
mod low_rank;

use glam::Vec4;
use gpu_kernels::multibounce::{FeedbackPass, ReorderPass};
use gpu_kernels::params::CountParams;
use multibounce::Acceleration;
use scene::Rgb;

use super::{Tables, formfactor::Surfaces};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{PassId, Plan, Slice};

pub use blocks::{BlockTables, Decoder};
pub use dense::{DenseTables, planar, planar_columns};
pub use low_rank::LowRankTables;

/// An operator's tables on the device, and what a product keeps between its passes.
// A plan has one or two of them.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Debug)]
pub enum OperatorTables {
    /// Entries one by one, in single or half precision.
    Dense(DenseTables),
    /// Texture blocks and outliers.
    Blocks(BlockTables),
    /// Sums of rank-1 terms, dense sub-blocks and sparse residuals.
    LowRank(LowRankTables),
}

impl OperatorTables {
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
        match self {
            Self::Dense(dense) => dense.product(plan, pass, range, exitance, irradiance),
            Self::Blocks(blocks) => blocks.product(plan, pass, exitance, irradiance),
            Self::LowRank(low_rank) => low_rank.product(plan, pass, exitance, irradiance),
        }
    }
}

/// Adds the pass of a bounce that goes on from the frame before, accelerated as `acceleration` says:
/// `B = E + ρ∘H` and more of its change. `change` keeps that change, one RGB value a patch, W/m².
///
/// # Errors
/// Buffers that are too short.
pub fn accelerated_bounce(
    plan: &mut Plan,
    pass: &str,
    surfaces: &Surfaces,
    change: Slice<Rgb>,
    acceleration: &Acceleration,
) -> Result<PassId, ExecutorError> {
    let Surfaces { count, albedo, source, irradiance, exitance } = *surfaces;
    let bound = FeedbackPass { source, albedo, irradiance, change, exitance };
    Ok(plan.add(pass, &bound, &acceleration.params(count))?)
}

/// The product with an operator alone, loaded into an executor.
pub struct Product {
    exitance: Slice<Rgb>,
    irradiance: Slice<Rgb>,
}

impl Product {
    /// Loads the product of an operator of so many rows and columns, whose tables `make` adds to the plan.
    ///
    /// # Errors
    /// What the device says.
    pub fn load(
        executor: &mut dyn Executor,
        rows: usize,
        columns: usize,
        range: u64,
        make: &dyn Fn(&mut Plan, &mut Tables) -> OperatorTables,
    ) -> Result<Self, ExecutorError> {
        let mut plan = Plan::new();
        let mut tables = Tables::new();
        let operator = make(&mut plan, &mut tables);
        let exitance = plan.array("exitance", columns);
        let irradiance = plan.array("irradiance", rows);
        operator.product(&mut plan, "product", range, exitance, irradiance)?;
        executor.load(plan)?;
        tables.upload(executor)?;
        Ok(Self { exitance, irradiance })
    }

    /// Irradiance from exitance, W/m², and the median of the times of so many products, ms.
    ///
    /// # Errors
    /// What the device says.
    pub fn run(
        &self,
        executor: &mut dyn Executor,
        exitance: &[Vec4],
        rounds: usize,
    ) -> Result<(Vec<Vec4>, f64), ExecutorError> {
        executor.upload(self.exitance, exitance)?;
        let mut times = Vec::with_capacity(rounds);
        for _ in 0..rounds.max(1) {
            let passes = executor.run()?;
            times.push(passes.iter().map(|pass| pass.milliseconds).sum::<f64>());
        }
        times.sort_by(f64::total_cmp);
        Ok((executor.download_table(self.irradiance)?, times[times.len() / 2]))
    }
}

/// An order of RGB values: patches at permuted indices, with a factor for each.
#[derive(Clone, Copy, Debug)]
pub(super) struct Order {
    order: Slice<u32>,
    scale: Slice<Vec4>,
    count: u32,
}

impl Order {
    /// Adds the pass of `output[k] = scale[k] ∘ input[order[k]]`, zero where the order names none.
    pub fn add(
        &self,
        plan: &mut Plan,
        pass: &str,
        input: Slice<Rgb>,
        output: Slice<Rgb>,
    ) -> Result<PassId, ExecutorError> {
        let Self { order, scale, count } = *self;
        Ok(plan.add(pass, &ReorderPass { order, scale, input, output }, &CountParams { count })?)
    }

    /// The order of so many values.
    pub fn new(order: Slice<u32>, scale: Slice<Vec4>, count: usize) -> Self {
        Self { order, scale, count: count as u32 }
    }
}
