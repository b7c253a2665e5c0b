//! Matrices, and their products on all cores.

mod hits;
mod order;
mod polygon;
mod product;
mod storage;
mod surfaces;

pub use hits::{EditedRow, HitCounts, add_up, quad_columns, quad_of};
pub use order::spatial_order;
pub use polygon::Polygon;
pub use product::widen_half;
pub use storage::{Csr, Dense, Half};
pub use surfaces::{Owner, Surfaces};
