//! The host side: loops over all cores, in double precision where closed forms are evaluated.

mod area;
mod balance;
mod contour;
mod edit;
mod estimate;
#[cfg(feature = "std")]
mod file;
mod reciprocal;
mod solve;
mod sparse;
mod triangle;

pub use area::{polygon_point, recurrence};
pub use balance::{Balance, balance, closure_residual, normalise_rows, reciprocity_residual};
pub use contour::{point_to_polygon, polygon_to_polygon};
pub use edit::{KeptRow, RowChanges, RowEdit, RowKey};
pub use estimate::{
    AreaToArea, Contour, Estimator, FactorRows, Hemisphere, PointToPoint, SkyBin, form_factor_blocks, form_factors,
};
#[cfg(feature = "std")]
pub use file::{RowFile, RowFileWriter};
pub use reciprocal::{Reciprocal, reciprocal};
pub use solve::{Solution, Stop, check_inputs, gauss_seidel, jacobi, lu, shoot};
pub use sparse::{
    SparseRows, add_hit_rows, add_quadrant_rows, add_rows_of, add_traced_rows, gather_by_rays, sparse_rows,
    sparse_traced_rows,
};
pub use transport::{Csr, Dense, Half, Owner, Polygon, Proceed, Surfaces, widen_half};
