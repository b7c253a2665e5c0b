//! From points to voxels.

use glam::{UVec3, Vec3};
use scene::math::floor;

use crate::types::GridShape;

impl GridShape {
    /// Voxels along the three axes.
    #[inline]
    pub fn counts(&self) -> UVec3 {
        UVec3::new(self.count_x, self.count_y, self.count_z)
    }

    /// Number of the voxel at these coordinates.
    #[inline]
    pub fn voxel_at(&self, c: UVec3) -> u32 {
        c.x + self.count_x * (c.y + self.count_y * c.z)
    }

    /// Coordinates of a voxel.
    #[inline]
    pub fn coordinates(&self, voxel: u32) -> UVec3 {
        let row = voxel / self.count_x;
        UVec3::new(voxel % self.count_x, row % self.count_y, row / self.count_y)
    }

    /// Position in units of voxels from the grid's origin on.
    #[inline]
    pub fn in_voxels(&self, x: Vec3) -> Vec3 {
        (x - self.origin) / self.edges
    }

    /// Coordinates of the voxel that holds a point, or the nearest one of the grid.
    #[inline]
    pub fn nearest_coordinates(&self, x: Vec3) -> UVec3 {
        let place = self.in_voxels(x);
        UVec3::new(
            nearest_layer(place.x, self.count_x),
            nearest_layer(place.y, self.count_y),
            nearest_layer(place.z, self.count_z),
        )
    }
}

#[inline]
fn nearest_layer(place: f32, count: u32) -> u32 {
    if place < 0.0 {
        return 0;
    }
    let last = (count - 1) as f32;
    (if place < last { floor(place) } else { last }) as u32
}
