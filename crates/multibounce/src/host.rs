//! The host side: solvers, compression and products on all cores.

mod blocks;
mod energy;
mod feedback;
mod order;
mod outliers;
mod solve;
mod stored;
mod tiles;
mod tree;

pub use blocks::{BlockBytes, BlockCodec, BlockMatrix, BlockReport, BlockSettings, Companding, picture};
pub use energy::spectral_radius;
pub use feedback::{Acceleration, spectral_range};
pub use order::{MatrixRows, PROJECTED_DIMENSIONS, greedy_order, projected_order};
pub use outliers::Outliers;
pub use solve::{Factors, all_bounces, all_bounces_lu, some_bounces};
pub use stored::{Room, StoredOperator, all_bounces_stored, some_bounces_stored};
pub use tiles::{
    Channels, ColumnVectors, ExpandTables, LowRank, LowRankWorkspace, MOST_TILE_PATCHES, MOST_TILE_RECEIVERS,
    NearTables, ProjectTables, SparseRows, TileReport, TileSide, TileSource, enter_all, expand_all, leave_all,
    near_all, project_all, round_all, weigh_all,
};
pub use tree::halving_order;
// The names that these had here, until all callers take them from `transport`.
pub use transport::{Permutation, Proceed};
