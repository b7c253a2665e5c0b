#![no_std]
//! Virtual patches: any mesh as a few thousand patches that send light, with no hand-made proxy.
//!
//! A [`Grid`] of voxels cuts the triangles of a scene; empty voxels are dropped. [`sample_voxels`] casts rays from
//! Hammersley's points on the six faces of each voxel, inside the voxel only. What they meet are samples: position,
//! normal of the side that was seen, triangle, reflectance, and an area. With S_j the area of triangle j inside the
//! voxel and
//! |samples_j| its samples on one side, `s_i = S_j / |samples_j|`, so that `Σ s_i` is the area of the surface (both sides of
//! a sheet); or, by projection along the ray d over a face of h_u by h_v with k rays, `s = h_u h_v / k · |n·d|`.
//!
//! Patches share the samples out; with the part `w_i` of a sample, `A = Σ w_i s_i` and `x̄ = Σ w_i s_i x_i / A` for
//! position, normal, reflectance ρ and the first exitance E ([`kernel::gather`]):
//! [`axis_patches`] makes at most six a voxel, `w = n_axis²` on the side the normal points to;
//! [`cluster_patches`] merges the closest pair of clusters until `max_patches` a voxel are left, by
//! `M(i,j) = (1 + |x_i − x_j|/d)(2 − n_i·n_j)` with the voxel's diagonal d.
//! [`view_clusters`] needs no voxels: it splits equal-area samples of the whole scene top-down, where what they see
//! varies most, and [`Nearest`] finds the patch of any place. A [`PatchSet`] may also be put together by other means.
//! [`Lookup`] gives a value between patches: `h(x, n) = Σ w_j h_j / Σ w_j`, trilinear over 2×2×2 voxels times `max(0,
//! n·n_j)²`, without those off the plane of x or behind a wall ([`kernel::lookup`], which runs as SPIR-V and on the
//! host alike).
//!
//! Receivers beside the mesh, all [`scene::ReceiverSet`]s: a [`VoxelVolume`] of probes in the air gives irradiance to
//! what moves, from ambient cubes, `E(x, n) = Σ_a n_a² cube[a, sign n_a]`, or spherical harmonics of degree 1, `E(x, n)
//! = π Y_00 L_00 + (2π/3) Σ_a Y_1a(n) L_1a`, and takes nothing through walls ([`kernel::volume`]); [`LightmapTexels`]
//! lays the triangles out in an atlas ([`kernel::lightmap`]).
//!
//! Lengths are metres, areas m², reflectance linear Rec.709. Each step runs on all cores, voxel by voxel, and gives the
//! same bytes for any number of threads.
//!
//! Source: A. S. Shcherbakov, thesis, MSU 2025, 5.1 to 5.9, cited as \[T\]; sums that are printed there are means here.
//!
//! ```
//! # extern crate scene as patchlight_scene;
//! use glam::{Vec3, Vec4};
//! use patchlight_patches::{Grid, Lookup, LookupSettings, Sample, SampleSettings, axis_patches, sample_voxels};
//! use patchlight_scene::{Material, Scene, SceneParts};
//! use patchlight_scene::gpu::{Triangle, TriangleUv};
//!
//! let triangle = |a: Vec3, b: Vec3, c: Vec3| Triangle { corner: a, edge_a: b - a, edge_b: c - a, ..Triangle::default() };
//! let scene = Scene::new(SceneParts {
//!     triangles: vec![triangle(Vec3::ZERO, Vec3::Z, Vec3::X), triangle(Vec3::X + Vec3::Z, Vec3::X, Vec3::Z)],
//!     uvs: vec![TriangleUv::default(); 2],
//!     materials: vec![Material::default()],
//!     ..SceneParts::default()
//! })?;
//! let upper = |s: &Sample| s.normal.y > 0.0;
//! let patches = |grid: &Grid| {
//!     axis_patches(grid, sample_voxels(&scene, grid, &SampleSettings::default(), &upper)?)
//! };
//! // Voxels of the size that gives about 16 patches.
//! let grid = Grid::for_count(&scene, Vec3::ONE, 16, |grid| Ok(patches(grid)?.len()))?;
//! let set = patches(&grid)?;
//! let area: f32 = set.patches.iter().map(|p| p.area).sum();
//! assert!((area - 1.0).abs() < 1e-4);
//!
//! // Values that rise along x.
//! let values: Vec<_> = set.patches.iter().map(|p| Vec4::splat(p.position.x)).collect();
//! let table = Lookup::new(&grid, &set, LookupSettings::default())?;
//! assert!((table.at(&values, Vec3::new(0.5, 0.0, 0.5), Vec3::Y)?.x - 0.5).abs() < 0.02);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | feature | what it adds |
//! |---|---|
//! | none | bodies of kernels and types, with `core` only |
//! | `alloc` | patches, elements, receivers, lightmaps, on one core |
//! | `std`, by default | loops over all cores |
//! | `serde` | its tables in files |
//!
//! Results are the same.
// The kernel build has `core` only.
#[cfg(any(feature = "alloc", test))]
extern crate alloc;
#[cfg(any(feature = "std", test))]
extern crate std;

#[cfg(feature = "alloc")]
pub mod error;
#[cfg(feature = "alloc")]
pub mod host;
pub mod kernel;
pub mod types;

#[cfg(feature = "alloc")]
pub use error::Error;
#[cfg(feature = "alloc")]
pub use host::*;
pub use types::*;
