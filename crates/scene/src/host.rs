//! The scene on the host: geometry with its hierarchy, lighting, fast rays.

mod builder;
mod camera;
pub mod clip;
mod distribution;
mod edit;
#[cfg(feature = "std")]
mod file;
mod geometry;
mod groups;
mod hierarchy;
mod lighting;
#[cfg(feature = "std")]
pub mod memory;
mod moving;
mod picture;
mod pyramid;
mod receivers;
mod scene;
mod sides;
mod sky;
#[cfg(feature = "serde")]
mod stored;
mod wide;

pub(crate) use moving::{occluder, traverse};
pub(crate) use wide::WideBvh;

pub use builder::{BuildError, LightId, MaterialId, Mesh, MeshFault, MeshId, SceneBuilder, TextureId};
pub use distribution::Distribution;
pub use edit::SceneEdit;
#[cfg(feature = "std")]
pub use file::{open_regular, read_regular};
pub use geometry::{Geometry, Occluder, texel_count};
pub use groups::MAX_EMITTER_GROUPS;
pub use lighting::Lighting;
pub use moving::MovingMesh;
pub use picture::{
    DisplayTransform, METERED_PIXELS, Materials, Picture, Tone, automatic_stops, scale_to_stops, stops_to_scale,
};
pub use pyramid::{Halver, Pyramid, half};
pub use receivers::ReceiverSet;
pub use scene::{Scene, SceneParts};
pub use sides::{POINT_WALKS, SidePolicy, Sides, find_lit_sides, find_sides, is_inside, is_open, reachability};
pub use sky::{SKY_BINS, sky_bin, sky_direction, sky_exitance};
