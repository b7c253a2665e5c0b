//! The classic solvers as a method of frames. Each light update waits for them.

use std::sync::Arc;
use std::time::Instant;

use formfactor::{Dense, Reciprocal, Solution, Stop, gauss_seidel, lu, reciprocal, shoot};
use glam::{Vec2, Vec2Swizzles, Vec3, Vec4};
use patchlight::{Albedo, Bake, Error, FramePlan, Method, MethodReport};
use runtime::executor::{Executor, PassTime};
use runtime::plan::{PassId, Slice};
use scene::{Hit, Rgb};

use crate::hierarchical::{HierarchicalScene, HierarchicalSettings, HierarchicalSolution, hierarchical};
use crate::monte_carlo::{Samples, random_walks, stochastic_jacobi};

/// Remainder at which an iteration ends: of the greatest exitance, or of the emitted power.
const TOLERANCE: f32 = 1e-4;

/// Solver of `B = E + ρ∘(F B)`.
#[derive(Clone, Copy, Debug, PartialEq)]
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
    /// Links between parts of any size, [`hierarchical`]; of patches with outlines.
    Hierarchical(Links),
}

/// Links of hierarchical radiosity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Links {
    /// Most power that a link carries unsplit, as a share of the emitted power.
    pub error: f64,
    /// Changes every shadow ray.
    pub seed: u32,
}

impl Default for Links {
    /// A hundred thousandth of the power.
    fn default() -> Self {
        Self { error: 1e-5, seed: 0 }
    }
}

impl Solver {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::GaussSeidel => "Gauss-Seidel",
            Self::Shooting => "shooting",
            Self::Lu => "LU",
            Self::StochasticJacobi(_) => "stochastic Jacobi",
            Self::RandomWalks(_) => "random walks",
            Self::Hierarchical(_) => "hierarchical",
        }
    }

    /// Bytes of the matrices for so many patches.
    pub fn matrix_bytes(self, patches: usize) -> f64 {
        let pairs = (patches as f64).powi(2);
        match self {
            Self::GaussSeidel | Self::Shooting => 4.0 * pairs,
            // With the system and its factors, double precision.
            Self::Lu => 20.0 * pairs,
            Self::StochasticJacobi(_) | Self::RandomWalks(_) | Self::Hierarchical(_) => 0.0,
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
    /// None: links find their own.
    Sides(Sides, Links),
}

/// Triangle sides with patches, between whose parts links are.
struct Sides {
    bake: Arc<Bake>,
    /// Corners of the sides, m.
    corners: Vec<[Vec3; 3]>,
    /// Triangle of each side, and whether it is the front.
    triangles: Vec<(u32, bool)>,
    /// Side of each patch.
    of_patch: Vec<u32>,
}

/// Shadow rays of a link.
const SHADOW_RAYS: u32 = 16;

impl Sides {
    fn new(bake: &Arc<Bake>) -> Result<Self, Error> {
        let mesh = &bake.mesh();
        if mesh.polygons.len() != mesh.patches.len() {
            return Err(formfactor::Error::NoOutlines { estimator: "hierarchical radiosity" }.into());
        }
        let geometry = bake.scene().tables();
        let mut sides =
            Self { bake: Arc::clone(bake), corners: Vec::new(), triangles: Vec::new(), of_patch: Vec::new() };
        for patch in &mesh.patches {
            let is_front = geometry.normal(patch.triangle).dot(patch.normal) > 0.0;
            // Patches are in the order of triangles and sides.
            if sides.triangles.last() != Some(&(patch.triangle, is_front)) {
                let a = geometry.position(patch.triangle, 0.0, 0.0);
                let b = geometry.position(patch.triangle, 1.0, 0.0);
                let c = geometry.position(patch.triangle, 0.0, 1.0);
                let is_turned = ((b - a).cross(c - a).dot(patch.normal)) < 0.0;
                sides.corners.push(if is_turned { [a, c, b] } else { [a, b, c] });
                sides.triangles.push((patch.triangle, is_front));
            }
            sides.of_patch.push(sides.triangles.len() as u32 - 1);
        }
        Ok(sides)
    }

    /// Shares of the edges of a triangle, from shares of the edges of a side, and back.
    fn turned(&self, side: usize, at: Vec2) -> Vec2 {
        let [_, b, _] = self.corners[side];
        let triangle = self.triangles[side].0;
        let is_turned = b != self.bake.scene().tables().position(triangle, 1.0, 0.0);
        if is_turned { at.yx() } else { at }
    }

    /// Exitance and irradiance of the patches, and how many passes that took.
    fn solve(&self, source: &[Vec4], albedo: &[Vec4], links: Links) -> Result<(Solution, LinkCount), Error> {
        let scene = self.bake.scene();
        let mesh = self.bake.mesh();
        let light = |side: usize, at: Vec2| {
            let (triangle, is_front) = self.triangles[side];
            let at = self.turned(side, at);
            let patch = mesh.element_on_side(&Hit { triangle, u: at.x, v: at.y, t: 0.0 }, is_front) as usize;
            let value = |table: &[Vec4]| table.get(patch).map_or(Vec3::ZERO, |value| value.truncate());
            (value(source), value(albedo))
        };
        let area: f32 = mesh.patches.iter().map(|patch| patch.area).sum();
        let settings = HierarchicalSettings {
            error: links.error as f32,
            least_area: area / mesh.patches.len().max(1) as f32,
            shadow_rays: SHADOW_RAYS,
            tolerance: TOLERANCE,
            seed: links.seed,
        };
        let input = HierarchicalScene {
            triangles: &self.corners,
            visibility: scene,
            ray_offset: scene.geometry.ray_offset,
            light: &light,
        };
        let found = hierarchical(&input, &settings)?;
        let mut solution = Solution { iterations: found.passes, ..Solution::default() };
        for (k, side) in self.of_patch.iter().enumerate() {
            let own = &mesh.points[mesh.offsets[k] as usize..mesh.offsets[k + 1] as usize];
            let triangle = self.triangles[*side as usize].0;
            let mut irradiance = Vec4::ZERO;
            for point in own {
                let (u, v) = scene.shares(triangle, point.position);
                let at = self.turned(*side as usize, Vec2::new(u, v));
                irradiance += (found.irradiance(*side as usize, at) * point.weight).extend(0.0);
            }
            solution.irradiance.push(irradiance);
            solution.exitance.push(source[k] + albedo[k] * irradiance);
        }
        Ok((solution, LinkCount { links: found.links, leaves: found.leaves }))
    }
}

/// Links of hierarchical radiosity after a solution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCount {
    /// Links between parts.
    pub links: usize,
    /// Parts that are not split further.
    pub leaves: usize,
}

impl LinkCount {
    /// Bytes of the links.
    pub fn bytes(self) -> u64 {
        (self.links * HierarchicalSolution::LINK_BYTES) as u64
    }
}

/// A solver between the stages of a frame.
pub struct Solved {
    albedo: Vec<Vec4>,
    solver: Solver,
    factors: Factors,
    buffers: Option<[Slice<Rgb>; 2]>,
    bounce: Option<PassId>,
    link_count: LinkCount,
}

impl Solved {
    /// Makes the form factors of a bake ready for a solver.
    ///
    /// # Errors
    /// Form factors that cannot be made reciprocal.
    pub fn new(solver: Solver, bake: &Arc<Bake>) -> Result<Self, Error> {
        let own = &bake.form_factors().factors;
        let both_ways = || reciprocal(own, &bake.mesh().areas());
        let factors = match solver {
            Solver::GaussSeidel | Solver::Lu => Factors::Dense(own.to_dense()),
            Solver::Shooting => {
                let Reciprocal { factors, area, .. } = both_ways()?;
                Factors::DenseReciprocal(factors.to_dense(), area)
            }
            Solver::StochasticJacobi(_) | Solver::RandomWalks(_) => Factors::Sparse(both_ways()?),
            Solver::Hierarchical(links) => Factors::Sides(Sides::new(bake)?, links),
        };
        let albedo = bake.mesh().albedo.clone();
        let link_count = LinkCount::default();
        Ok(Self { albedo, solver, factors, buffers: None, bounce: None, link_count })
    }

    /// Exitance and irradiance of the patches, W/m², from their first exitance, and the links of it; none but for
    /// [`Solver::Hierarchical`].
    ///
    /// # Errors
    /// A source that is negative or not finite; links that do not fit into memory.
    pub fn solution(&self, source: &[Vec4]) -> Result<(Solution, LinkCount), Error> {
        let albedo = &self.albedo;
        let stop = Stop::Tolerance(TOLERANCE);
        let solution = match (&self.factors, self.solver) {
            (Factors::Sides(sides, links), _) => return sides.solve(source, albedo, *links),
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
        };
        Ok((solution, LinkCount::default()))
    }

    fn submit(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<Vec<PassTime>, Error> {
        let Some([source, irradiance]) = self.buffers else { return Ok(Vec::new()) };
        let source = executor.download_table(source)?;
        let start = Instant::now();
        let (solution, link_count) = self.solution(&source)?;
        self.link_count = link_count;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        executor.upload(irradiance, &solution.irradiance)?;
        executor.submit_passes(self.bounce.as_slice())?;
        Ok(vec![PassTime::of_host("method", milliseconds)])
    }
}

impl Method for Solved {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        frame.start_from_source()?;
        self.buffers = Some([frame.patches.source, frame.patches.irradiance]);
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
            Factors::Sides(..) => self.link_count.bytes(),
        };
        MethodReport { bytes: [("form_factors".to_owned(), matrix)].into(), ..MethodReport::default() }
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}
