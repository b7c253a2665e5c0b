//! SPIR-V entry points of all methods, their compiled modules, and the table that describes them to executors.
//!
//! The arithmetic is in the bodies of `scene::kernel`, `formfactor::kernel`, `patches::kernel`, `multibounce::kernel`,
//! `localmatrix::kernel`, `temporal::kernel` and `firstshot::kernel`. Here each is declared
//! once, in the file of its method. From the declaration follow its entry point (bindings, range check, one call), its
//! module `spv/<crate>_<kernel>.spv`, its row in [`table::KERNELS`] and its host form ([`host`]), which runs the same
//! body for all invocations on all cores. Results agree in all bits on the devices that we know, because the modules
//! forbid contraction and take their maths from polynomials of our own.
//!
//! # Conventions
//!
//! - Descriptor set 0; a binding's number is its place in [`table::Kernel::bindings`]. Buffers need one element at
//!   least, and a written buffer is bound once. Push constants are plain structures: [`params`], and the `Params` of
//!   the method crates.
//! - A dispatch has as many invocations as its push constants say, one for each ray, point, pixel …;
//!   [`table::Kernel::groups`] converts it to workgroups. They have 64 invocations in x. Beyond 65,535 workgroups a
//!   dispatch goes on in y: element = x + y · (64 · groups in x).
//! - Dense products take four rows together, rows of whole vectors of four factors (zeros beyond the columns), and
//!   `4 · vectors` finite entries of B. A matrix beyond `maxStorageBufferRange` is bound in blocks of rows:
//!   `GatherParams::first_row` says where the block's rows go. `transport_gather` and `_half` share the columns of four
//!   rows among a workgroup, with coalesced loads.
//! - Kernels that sample rows take a frame's number, so that each frame draws others; what they write they also read,
//!   the irradiance of the frame before.
//! - Lists of slots are made in three passes, `localmatrix_count`, `_start` and `_compact`, the last of which finds the
//!   slot at its own place; they end with the slots that are not in them, so that each is named once.
//! - Products with a matrix in texture blocks take one row of blocks a workgroup, by the same tree of lanes.
//!   `multibounce_reorder` brings vectors into the order of the blocks and back.
//!
//! ```
//! use glam::Vec4;
//! use patchlight_gpu_kernels::host::{HostBinding, HostCall};
//! use patchlight_gpu_kernels::params::CountParams;
//! use patchlight_gpu_kernels::table::TRANSPORT_BOUNCE;
//!
//! // B = E + ρ∘H for one patch.
//! let (source, albedo, irradiance) = ([Vec4::splat(1.0)], [Vec4::splat(0.5)], [Vec4::splat(4.0)]);
//! let mut exitance = [Vec4::ZERO];
//! let mut bindings = [
//!     HostBinding::Read(bytemuck::cast_slice(&source)),
//!     HostBinding::Read(bytemuck::cast_slice(&albedo)),
//!     HostBinding::Read(bytemuck::cast_slice(&irradiance)),
//!     HostBinding::Write(bytemuck::cast_slice_mut(&mut exitance)),
//! ];
//! let push = CountParams { count: 1 };
//! let mut call = HostCall { invocations: 1, push: bytemuck::bytes_of(&push), bindings: &mut bindings };
//! TRANSPORT_BOUNCE.run_on_host(&mut call)?;
//! assert_eq!(exitance[0], Vec4::splat(3.0));
//! # Ok::<(), patchlight_gpu_kernels::host::HostError>(())
//! ```
//!
//! # Adding a kernel
//!
//! Three edits:
//!
//! 1. the body, a plain function in the `kernel` module of the method's crate;
//! 2. its declaration, in the file of the method here;
//! 3. an input for it in `tests/support/kernels`, by its name.
//!
//! ```text
//! kernels! {
//!     /// Exitance of every patch after a bounce, W/m²: [`product::bounce`]. An element is a patch.
//!     TRANSPORT_BOUNCE: BouncePass = "transport_bounce"(p: CountParams) for k in 0..count {
//!         source: read [Rgb; count],
//!         albedo: read [Rgb; count],
//!         irradiance: read [Rgb; count],
//!         exitance: write [Rgb],
//!     } each {
//!         let i = k as usize;
//!         product::bounce(source[i], albedo[i], irradiance[i])
//!     }
//! }
//! ```
//!
//! `p` are the push constants, whose field `count` holds the number of invocations. `[Rgb; count]` is
//! the type of a buffer's elements, with the least number of them that the host form accepts. The
//! value of the block goes to element `k` of the buffer that is written. `src/declare.rs` has the
//! whole grammar: buffers that are updated, images, workgroups with shared memory, the tables of the
//! scene in one word, and host forms written by hand where a loop over the invocations is not the
//! fastest.
//!
//! `just spv` then compiles the module, which the row of the table includes. The tests of layout,
//! order and parity go through [`table::KERNELS`] and need no edit: `tests/order.rs` calls the entry point itself on
//! the host ([`table::Kernel::invocation`]), and `tests/parity.rs` compares the executors. Where they may differ by
//! more than its bounds, it wants a tolerance with its reason.
//!
//! # Rebuilding the modules
//!
//! `just spv` runs `builder/`, a workspace of its own on stable Rust. It needs `spirv-opt` and `spirv-val` (Debian:
//! spirv-tools) and either the toolchain that `../shared/rust-gpu/install` installs, or the public one:
//!
//! ```text
//! rustup toolchain install nightly-2026-04-11 -c rust-src,rustc-dev,llvm-tools
//! cd crates/gpu-kernels/builder && cargo +nightly-2026-04-11 run --release --features public-toolchain
//! ```
//!
//! Modules are compiled without optimisation, every float operation is decorated `NoContraction`, then `spirv-opt
//! --strip-debug -O` runs. `spv/manifest.toml` holds the versions and the hashes of all sources and modules;
//! `tests/spv.rs` compares them, and `builder -- --check` rebuilds and compares the bytes. The warnings that an entry
//! point "has been inlined" are harmless: without `inline(never)` an entry point that calls nothing would not be
//! compiled at all.
#![no_std]
#[cfg(feature = "std")]
extern crate std;

#[macro_use]
mod declare;
pub mod firstshot;
pub mod formfactor;
mod half;
#[doc(hidden)]
pub mod invocation;
pub mod localmatrix;
pub mod multibounce;
pub mod params;
#[cfg(feature = "std")]
#[macro_use]
pub mod pass;
pub mod low_rank;
pub mod patches;
pub mod scene;
mod sums;
pub mod temporal;
pub mod transport;

/// Names of the scene crate for [`kernels!`], for crates that know it by another name.
#[doc(hidden)]
pub use ::scene as scene_types;

#[cfg(feature = "std")]
pub mod host;
#[cfg(feature = "std")]
pub mod table;
