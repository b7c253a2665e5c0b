//! The host side: slots, borders and the choice of patches.

mod choice;
mod matrix;
mod store;
mod world;

pub use choice::{Choice, choose, distance_to_path};
pub use matrix::{Entering, Form, LocalMatrix, MOST_SLOTS};
pub use store::{
    BakeError, BakeFile, BakeWriter, LitPoint, Mapped, Part, Record, Source, Store, StoreState, WorldHead, block_range, join,
    parent_record,
};
pub use world::{NO_NODE, Node, World};
