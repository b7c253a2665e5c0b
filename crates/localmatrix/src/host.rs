//! The host side: slots, borders and the choice of patches.

mod choice;
mod matrix;
mod world;

pub use choice::{Choice, choose, distance_to_path};
pub use matrix::{Entering, Form, LocalMatrix, MOST_SLOTS};
pub use world::{NO_NODE, Node, World};
