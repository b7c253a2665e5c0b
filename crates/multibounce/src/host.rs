//! The host side: solvers, compression and products on all cores.

mod blocks;
mod energy;
mod feedback;
mod low_rank;
mod order;
mod outliers;
mod solve;
#[cfg(feature = "std")]
mod stored;
mod tree;

pub use blocks::{BlockBytes, BlockCodec, BlockMatrix, BlockReport, BlockSettings, Companding, Filling, picture};
pub use energy::spectral_radius;
pub use feedback::{Acceleration, spectral_range};
pub use low_rank::{
    Channels, ColumnVectors, DenseSparseTables, LowRank, LowRankWorkspace, MAX_TILE_PATCHES, MAX_TILE_RECEIVERS,
    SparseRows, TileReport, TileSide, TileSource, UTables, VtTables, dense_sparse_all, multiply_u_all, multiply_vt_all,
    permute_in_all, permute_out_all, quantise_all, requantise_all,
};
pub use order::{MatrixRows, PROJECTED_DIMENSIONS, greedy_order, projected_order};
pub use outliers::Outliers;
pub use solve::{Factors, all_bounces, all_bounces_lu, bounce_system, bounces_of_inverse, invert, some_bounces};
#[cfg(feature = "std")]
pub use stored::{StoredOperator, Workspace, all_bounces_stored, some_bounces_stored};
pub use tree::halving_order;
