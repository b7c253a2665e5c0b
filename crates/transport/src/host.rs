//! Matrices, and their products on all cores.

mod hits;
mod product;
mod storage;

pub use hits::HitCounts;
pub use product::widen_half;
pub use storage::{Csr, Dense, Half};
