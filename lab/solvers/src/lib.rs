//! Classic solvers of `B = E + ρ∘(F B)` as methods of frames, to compare the project's own with: [`Solved`] puts any
//! [`Solver`] between the stages of a frame by [`patchlight::LightField::with_method`].
//!
//! Gauss-Seidel, LU and shooting are those of `formfactor`. Beside them stand Monte Carlo radiosity,
//! [`stochastic_jacobi`] and [`random_walks`], and [`hierarchical`] radiosity, whose links go between parts of any
//! size. Exitance and irradiance are W/m².

mod hierarchical;
mod monte_carlo;
mod solved;

pub use hierarchical::{HierarchicalScene, HierarchicalSettings, HierarchicalSolution, hierarchical};
pub use monte_carlo::{Samples, random_walks, stochastic_jacobi};
pub use solved::{LinkCount, Links, Solved, Solver};
