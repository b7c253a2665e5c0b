//! Worlds larger than memory: patches of voxels and what is merged of them for the distance, their rows of form factors
//! in a file, and frames that read what the camera comes to.

pub mod bake;
mod forest;
mod levels;
mod rows;
mod slots;
pub mod streamed;

pub use bake::{BakedWorld, WorldSettings, bake, bake_on, job_bytes, merge};
pub use forest::{DarkPatch, Extra, Forest, MAX_PATCHES, MIN_PATCHES};
pub use streamed::{StreamFrame, StreamSettings, Streamed, scene_of};
