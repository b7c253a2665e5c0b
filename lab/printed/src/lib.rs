//! The variants that A. S. Shcherbakov's thesis (MSU 2025, cited as \[T\]) prints and Patchlight computes otherwise, to
//! measure the difference. S. Shcherbakov's thesis (MSU 2025, cited as \[T\]) prints and Patchlight computes otherwise,
//! to measure the difference.
//!
//! [`PrintedRadiosity`] finds light by virtual patches as printed: points by rays ([`printed_samples`]), form factors
//! between points (5.1) ([`PrintedPoints`]), patches merged voxel by voxel (5.2) ([`printed_cluster_patches`],
//! [`printed_axis_patches`]), first exitance [T 5.8] and light between patches (5.3) ([`light_at`]) as sums, not means,
//! so that the result has no scale. [`PrintedMatrix`] is the matrix round a camera [T 4], [`printed_order`] and
//! [`PRINTED_BLOCKS`] are the compression of the matrix of several bounces [T 3].
//!
//! Lengths are metres, exitance and irradiance W/m².

mod bordered;
mod compression;
mod lookup;
mod points;
mod radiosity;
mod voxels;

pub use bordered::PrintedMatrix;
pub use compression::{PRINTED_BLOCKS, printed_order};
pub use lookup::light_at;
pub use points::PrintedPoints;
pub use radiosity::PrintedRadiosity;
pub use voxels::{
    Form, PRINTED_PATCHES, PointRows, PrintedPatches, PrintedSettings, RowsOfPoints, printed_axis_patches,
    printed_cluster_patches, printed_samples, printed_source,
};
