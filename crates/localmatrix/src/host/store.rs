//! Worlds on disk: a file of patches and their sparse rows of F, in spatial blocks with checksums; read ahead by a
//! thread of its own, written block by block.
//!
//! # Format, version 1, all numbers little-endian
//!
//! | part | bytes |
//! |---|---|
//! | header | `PLBAKE\r\n`, version, part and parts (0 and 0 for a whole bake), nodes, leaves, rows of a block, blocks, hash of the scene (32), key of the settings (32), length (8) and CRC-32 of the world, CRC-32 of the header: 120 |
//! | world | length (4) and text of the settings; nodes of 56 bytes each; length (8) and bytes of what else the program keeps |
//! | blocks | `ROWS`, number, first node, rows, length, CRC-32 of all of it: 24; then the rows |
//! | tail | offset (8), length and CRC-32 of each block; sky factor of each node |
//! | end | length (8) and CRC-32 of the tail, `PLBAKEND`: 20 |
//!
//! Leaves are the first nodes, those made of them the others, level by level. A row is its sky factor, the share of its
//! rays that was lost, numbers of its entries and points, a scale (4 each); columns (4 each, rising), shares in
//! 65,535ths of the scale (2 each); points of the node where its direct light is measured: position (12), normal (6)
//! and reflectance (6). Parts hold some of the leaves' blocks and no tail.

mod error;
#[cfg(feature = "std")]
mod file;
#[cfg(feature = "std")]
mod format;
#[cfg(feature = "std")]
mod map;
#[cfg(feature = "std")]
mod merge;
#[cfg(feature = "std")]
mod prefetch;
#[cfg(feature = "std")]
mod write;

pub use error::BakeError;
#[cfg(feature = "std")]
pub use file::{BakeFile, is_begun_as_bake};
#[cfg(feature = "std")]
pub use format::{LitPoint, Part, Record, WorldHead, block_range};
#[cfg(feature = "std")]
pub use map::{Mapped, Source};
#[cfg(feature = "std")]
pub use merge::{join, parent_record};
#[cfg(feature = "std")]
pub use prefetch::{Store, StoreState};
#[cfg(feature = "std")]
pub use write::{BakeWriter, beginning_of};
