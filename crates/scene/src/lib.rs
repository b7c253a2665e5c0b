//! A scene as plain data shared by CPU and GPU, and light at points of it.
//!
//! The types of [`gpu`] are `#[repr(C)]` and `Pod`: the same bytes lie in host memory and in storage buffers. The
//! bodies in [`kernel`] are plain functions that run as SPIR-V and on the host alike: rays against the hierarchy with
//! alpha masks ([`kernel::bvh`]), textures ([`kernel::texture`]), direct irradiance from parallel, point, spot,
//! rectangle and mesh lights, measured luminaires and the sky ([`kernel::light`]), primary rays ([`kernel::camera`]),
//! shading and tone mapping ([`kernel::shade`]). With the feature `alloc`, [`Geometry`] owns the tables that never
//! change, builds the hierarchy and casts rays; [`Scene`] is geometry under a [`Lighting`], which may change in every
//! frame. [`Scene::builder`] puts one together from meshes, materials, pictures and lights in radiometric or
//! photometric units.
//!
//! Units: metres; irradiance and exitance W/m², radiance W/m²/sr, linear Rec.709 RGB.
//! Equations: `H_d = ∫ L_i cosθ dω`, `L_o = L_e + ρ/π (H_d + H)`.
//!
//! ```
//! use glam::Vec3;
//! use patchlight_scene::{Irradiance, Light, Material, Mesh, Scene, Visibility};
//!
//! let mut builder = Scene::builder();
//! let material = builder.add_material(Material::diffuse(Vec3::splat(0.8)));
//! let positions = &[Vec3::ZERO, Vec3::Z, Vec3::X];
//! builder.add_mesh(Mesh { name: "floor", positions, indices: &[0, 1, 2], material, ..Mesh::default() });
//! builder.add_light(Light::sun(Vec3::new(0.2, -1.0, 0.1), Irradiance::lux(80_000.0)));
//! let scene = builder.build()?;
//! let hit = scene.closest(Vec3::new(0.25, 1.0, 0.25), Vec3::NEG_Y);
//! assert_eq!((hit.t, hit.triangle), (1.0, 0));
//! # Ok::<(), patchlight_scene::BuildError>(())
//! ```
//!
//! | feature | what it adds |
//! |---|---|
//! | none | bodies of kernels and types, with `core` only |
//! | `alloc` | geometry with its hierarchy, lighting, rays, pictures, on one core |
//! | `std`, by default | loops over all cores, hierarchies by obvhs, files |
//! | `serde` | scenes, and plain data in general, in files |
//!
//! Triangles are numbered in the order of the hierarchy. Where those of both have to be the same,
//! [`Scene::with_hierarchy`] takes one that is there.
#![no_std]
// The kernel build has `core` only.
#[cfg(any(feature = "alloc", test))]
extern crate alloc;
#[cfg(any(feature = "std", test))]
extern crate std;

#[cfg(feature = "alloc")]
pub mod double;
pub mod error;
pub mod gpu;
pub mod kernel;
pub mod math;
#[cfg(feature = "alloc")]
pub mod parallel;
#[cfg(feature = "serde")]
pub mod pod;
pub mod sampling;
pub mod units;

#[cfg(feature = "alloc")]
pub mod host;

#[doc(inline)]
pub use error::{Error, ReflectanceFault};
#[doc(inline)]
pub use gpu::{Camera, Finish, Hit, LUMENS_PER_WATT, Light, Lobe, Material, NONE, Ray, Rgb, Sky, SurfacePoint};
#[doc(inline)]
pub use kernel::light::Lights;
#[doc(inline)]
pub use kernel::{GeometryTables, Hierarchy};
#[doc(inline)]
pub use units::{Flux, Intensity, Irradiance, Radiance, SurfaceLight};

#[cfg(feature = "alloc")]
#[doc(inline)]
pub use host::{
    BuildError, DisplayTransform, Distribution, Geometry, LightId, Lighting, MAX_EMITTER_GROUPS, MaterialId, Materials,
    Mesh, MeshFault, MeshId, MovingMesh, Occluder, POINT_WALKS, Picture, ReceiverSet, SKY_BINS, Scene, SceneBuilder,
    SceneEdit, SceneParts, SidePolicy, Sides, TextureId, Tone, find_lit_sides, find_sides, is_inside, is_open,
    reachability, scale_to_stops, sky_bin, sky_direction, sky_exitance, stops_to_scale, texel_count,
};

use glam::Vec3;

/// Who sees whom. Methods take it instead of a scene, so that they run over any geometry.
pub trait Visibility: Sync {
    /// Returns true if something lies between two points, ends excluded.
    fn any_hit(&self, origin: Vec3, target: Vec3) -> bool;
    /// The closest hit of a ray.
    fn closest(&self, origin: Vec3, direction: Vec3) -> Hit;
}
