//! The host side: loops over all cores, in double precision where closed forms are evaluated.

mod area;
mod balance;
mod contour;
mod estimate;
mod file;
mod polygon;
mod quarters;
mod receivers;
mod reciprocal;
mod solve;
mod sparse;
mod subdivide;

pub use balance::{Balance, balance, closure_residual, normalise_rows, reciprocity_residual};
pub use contour::point_to_polygon;
pub use estimate::{
    AreaToArea, Contour, Estimator, FactorRows, Hemisphere, Owner, PointToPoint, Surfaces, form_factor_blocks,
    form_factors,
};
pub use file::{RowFile, RowFileWriter};
pub use polygon::Polygon;
pub use quarters::{QUARTERS, turns};
pub use receivers::Receivers;
pub use reciprocal::{Reciprocal, reciprocal};
pub use solve::{Solution, Stop, gauss_seidel, jacobi, lu, shoot};
pub use sparse::{SparseRows, add_hit_rows, add_quarter_rows, gather_by_rays, sparse_rows};
pub use subdivide::{
    PatchSize, SubdivideSettings, Subdivision, cell_grids, divisions_for_area, divisions_for_count,
    divisions_for_gradient, subdivide,
};
// The names that these had here, until all callers take them from `transport`.
pub use transport::{Csr, Dense, Half, HitCounts as HitRows, LinearOperator as Operator, Proceed, widen_half};
