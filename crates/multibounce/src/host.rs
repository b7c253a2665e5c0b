//! The host side: solvers, compression and products on all cores.

mod blocks;
mod energy;
mod order;
mod outliers;

pub use blocks::{BlockBytes, BlockCodec, BlockMatrix, BlockReport, BlockSettings, Companding, picture};
pub use energy::{VectorProduct, spectral_radius};
pub use order::{MatrixRows, PROJECTED_DIMENSIONS, Permutation, greedy_order, projected_order};
pub use outliers::Outliers;
