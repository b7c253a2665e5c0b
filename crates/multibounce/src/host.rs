//! The host side: solvers, compression and products on all cores.

mod solve;
mod tiles;
mod tree;

pub use solve::{Factors, Proceed, all_bounces, all_bounces_lu, some_bounces};
pub use tiles::{
    Channels, ExpandTables, MOST_TILE_PATCHES, TileReport, Tiles, enter_all, expand_all, leave_all, project_all,
};
pub use tree::halving_order;
