//! The classic solvers of all bounces, by the host: baselines for comparison. Each light update waits for them.

use std::sync::Arc;
use std::time::Instant;

pub use formfactor::Samples;
use formfactor::{
    Dense, Reciprocal, Solution, Stop, gauss_seidel, lu, random_walks, reciprocal, shoot, stochastic_jacobi,
};
use glam::Vec4;
use runtime::executor::{Executor, PassTime};
use runtime::plan::{BufferId, PassId};

use super::{Method, MethodReport, bytes};
use crate::albedo::Albedo;
use crate::bake::Bake;
use crate::error::Error;
use crate::frame::FramePlan;

/// How much is left when an iteration ends: of the greatest exitance, or of the emitted power.
const TOLERANCE: f32 = 1e-4;

/// How `B = E + ρ∘(F B)` is solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Solver {
    /// Gathering in place, [`gauss_seidel`].
    GaussSeidel,
    /// Progressive shooting, [`shoot`].
    Shooting,
    /// Elimination, [`lu`].
    Lu,
    /// Incremental shooting by chance, [`stochastic_jacobi`].
    StochasticJacobi(Samples),
    /// Walks by chance, [`random_walks`].
    RandomWalks(Samples),
}

impl Solver {
    /// Bytes of the matrices for so many patches.
    pub(crate) fn matrix_bytes(self, patches: usize) -> f64 {
        let pairs = (patches as f64).powi(2);
        match self {
            Self::GaussSeidel | Self::Shooting => 4.0 * pairs,
            // With the system and its factors, double precision.
            Self::Lu => 20.0 * pairs,
            Self::StochasticJacobi(_) | Self::RandomWalks(_) => 0.0,
        }
    }
}

/// Form factors as the solver takes them.
enum Factors {
    /// As they are.
    Dense(Dense),
    /// Reciprocal, with the areas for which they are, m².
    DenseReciprocal(Dense, Vec<f32>),
    Sparse(Reciprocal),
}

/// A solver between the stages of a frame.
pub struct Solved {
    albedo: Vec<Vec4>,
    solver: Solver,
    factors: Factors,
    buffers: Option<[BufferId; 2]>,
    bounce: Option<PassId>,
    iterations: u32,
}

impl Solved {
    /// Makes the form factors of a bake ready for a solver.
    ///
    /// # Errors
    /// Form factors that cannot be made reciprocal.
    pub fn new(solver: Solver, bake: &Arc<Bake>) -> Result<Self, Error> {
        let own = &bake.form_factors.factors;
        let both_ways = || reciprocal(own, &bake.mesh.areas());
        let factors = match solver {
            Solver::GaussSeidel | Solver::Lu => Factors::Dense(own.to_dense()),
            Solver::Shooting => {
                let Reciprocal { factors, area, .. } = both_ways()?;
                Factors::DenseReciprocal(factors.to_dense(), area)
            }
            Solver::StochasticJacobi(_) | Solver::RandomWalks(_) => Factors::Sparse(both_ways()?),
        };
        Ok(Self { albedo: bake.mesh.albedo.clone(), solver, factors, buffers: None, bounce: None, iterations: 0 })
    }

    fn solve(&self, source: &[Vec4]) -> Result<Solution, Error> {
        let albedo = &self.albedo;
        let stop = Stop::Tolerance(TOLERANCE);
        Ok(match (&self.factors, self.solver) {
            (Factors::Dense(factors), Solver::Lu) => lu(factors, source, albedo)?,
            (Factors::Dense(factors), _) => gauss_seidel(factors, source, albedo, stop)?,
            (Factors::DenseReciprocal(factors, area), _) => {
                // Of each patch: all of them together may keep as many times it.
                let stop = Stop::Tolerance(TOLERANCE / source.len().max(1) as f32);
                shoot(factors, area, source, albedo, stop)?
            }
            (Factors::Sparse(Reciprocal { factors, area, .. }), Solver::StochasticJacobi(samples)) => {
                stochastic_jacobi(factors, area, source, albedo, samples, stop)?
            }
            (Factors::Sparse(Reciprocal { factors, area, .. }), solver) => {
                let samples = if let Solver::RandomWalks(samples) = solver { samples } else { Samples::default() };
                random_walks(factors, area, source, albedo, samples)?
            }
        })
    }

    /// Sweeps, shots, iterations or steps of the last frame.
    pub fn iterations(&self) -> u32 {
        self.iterations
    }

    fn submit(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<Vec<PassTime>, Error> {
        let Some([source, irradiance]) = self.buffers else { return Ok(Vec::new()) };
        let source: Vec<Vec4> = executor.download_table(source)?;
        let start = Instant::now();
        let solution = self.solve(&source)?;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        self.iterations = solution.iterations;
        executor.upload(irradiance, &solution.irradiance)?;
        executor.submit_passes(self.bounce.as_slice())?;
        Ok(vec![PassTime { name: "method".into(), milliseconds }])
    }
}

impl Method for Solved {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        frame.start_from_source()?;
        self.buffers = Some([frame.patches.source.buffer, frame.irradiance()]);
        self.bounce = Some(frame.bounce()?);
        Ok(())
    }

    fn depends_on_source_alone(&self) -> bool {
        true
    }

    fn set_albedo(&mut self, albedo: &Albedo, _: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        self.albedo = albedo.patches.clone();
        Ok(())
    }

    fn submit(&mut self, executor: &mut (dyn Executor + 'static)) -> Option<Result<Vec<PassTime>, Error>> {
        Some(self.submit(executor))
    }

    fn report(&self) -> MethodReport {
        let matrix = match &self.factors {
            Factors::Dense(factors) | Factors::DenseReciprocal(factors, _) => size_of_val(&factors.values[..]) as u64,
            Factors::Sparse(reciprocal) => transport::LinearOperator::bytes(&reciprocal.factors),
        };
        MethodReport { bytes: bytes([("form_factors", matrix)]), ..MethodReport::default() }
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}
