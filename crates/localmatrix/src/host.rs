//! The host side: slots, borders, the choice of patches, and the camera's path through a world.

mod assembly;
mod camera;
mod choice;
mod cut;
mod forest;
mod local;
mod matrix;
mod store;
mod table;
mod world;

pub use camera::{CameraFrame, CameraMatrix, CameraSettings, HostFrame};
pub use choice::{Choice, choose, distance_to_path};
pub use cut::View;
pub use forest::Forest;
pub use local::{Changes, Local, LocalSettings, Step};
pub use matrix::{Entering, LocalMatrix, MAX_SLOTS, Update};
pub use store::BakeError;
#[cfg(feature = "std")]
pub use store::{
    BakeFile, BakeWriter, LitPoint, Mapped, Part, Record, Source, Store, StoreState, WorldHead, beginning_of,
    block_range, is_begun_as_bake, join, parent_record,
};
pub use table::{Surface, Table};
pub use world::{NO_NODE, Node, World};
