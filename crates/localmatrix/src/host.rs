//! The host side: slots, borders, the choice of patches, and the camera's way through a world.

mod assembly;
mod choice;
mod cut;
mod forest;
mod local;
mod matrix;
mod table;
mod world;

pub use choice::{Choice, choose, distance_to_path};
pub use cut::View;
pub use forest::Forest;
pub use local::{Changes, Local, LocalSettings, Step};
pub use matrix::{Entering, Form, LocalMatrix, MOST_SLOTS, Update};
pub use table::{Surface, Table};
pub use world::{NO_NODE, Node, World};
