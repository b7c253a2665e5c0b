//! Light between patches, (5.3) and [T 5.8].

use glam::{IVec3, Vec3, Vec4};
use patches::{EMPTY_CELL, Lookup};

/// The value at a surface point x with the unit normal n: over the 2×2×2 voxels about x, `Σ w_v l_v / Σ w_v` with the
/// weights w of trilinear filtering, where `l_v = Σ_j h_j max(0, n_j·n)` is the sum, no mean, over the patches of voxel
/// v (5.3). Voxels in which no patch looks the point's way do not count; 0 where none does.
///
/// `values` has one entry for each patch of the table.
pub fn light_at(table: &Lookup, values: &[Vec4], x: Vec3, n: Vec3) -> Vec4 {
    let place = table.params.shape.in_voxels(x) - 0.5;
    let mut sum = Vec4::ZERO;
    let mut total = 0.0;
    for corner in 0..8 {
        let step = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
        let share = Vec3::ONE - (place - place.floor() - step.as_vec3()).abs();
        let Some(cell) = patches_of(table, place.floor().as_ivec3() + step) else { continue };
        let mut lighting = Vec4::ZERO;
        let mut facing = 0.0;
        for entry in &table.entries[table.offsets[cell] as usize..table.offsets[cell + 1] as usize] {
            let cosine = n.dot(entry.direction).max(0.0);
            lighting += values[entry.patch as usize] * cosine;
            facing += cosine;
        }
        if facing > 0.0 {
            sum += lighting * share.element_product();
            total += share.element_product();
        }
    }
    if total > 0.0 { sum / total } else { Vec4::ZERO }
}

/// Position of the patches of the voxel with these coordinates; none outside of the grid and where there are none.
fn patches_of(table: &Lookup, at: IVec3) -> Option<usize> {
    let shape = &table.params.shape;
    if at.min_element() < 0 || at.as_uvec3().cmpge(shape.counts()).any() {
        return None;
    }
    let cell = table.cells[shape.voxel_at(at.as_uvec3()) as usize];
    (cell & EMPTY_CELL == 0).then_some(cell as usize)
}
