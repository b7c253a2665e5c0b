//! The host side: loops over all cores, in double precision where closed forms are evaluated.

mod area;
mod balance;
mod contour;
mod estimate;
mod file;
mod reciprocal;
mod solve;
mod sparse;
mod triangle;

pub use balance::{Balance, balance, closure_residual, normalise_rows, reciprocity_residual};
pub use contour::point_to_polygon;
pub use estimate::{
    AreaToArea, Contour, Estimator, FactorRows, Hemisphere, PointToPoint, form_factor_blocks, form_factors,
};
pub use file::{RowFile, RowFileWriter};
pub use reciprocal::{Reciprocal, reciprocal};
pub use solve::{Solution, Stop, gauss_seidel, jacobi, lu, shoot};
pub use sparse::{SparseRows, add_hit_rows, add_quarter_rows, gather_by_rays, sparse_rows};
// The names that these had here, until all callers take them from `transport`.
pub use transport::{
    Csr, Dense, Half, HitCounts as HitRows, LinearOperator as Operator, Owner, Polygon, Proceed, QUADRANTS as QUARTERS,
    Surfaces, rotational_gradients as turns, widen_half,
};
