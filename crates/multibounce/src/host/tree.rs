//! An order in which neighbours are alike, by bisection at multiples of a tile.

use alloc::vec::Vec;

use glam::{Vec3, Vec4};

use crate::kernel::low_rank::TILE;

/// [`transport::spatial_order`] that cuts at multiples of [`TILE`]: `order[p]` is the patch at
/// permuted index p.
pub fn halving_order(positions: &[Vec3], normals: &[Vec3], seen: &[Vec4]) -> Vec<u32> {
    transport::spatial_order(positions, normals, seen, TILE as usize)
}
