//! An order in which neighbours are alike, by halving.

use std::vec::Vec;

use glam::Vec3;

use crate::kernel::tiles::TILE;

/// What a turn of the normal counts beside a distance, in extents of the whole.
const TURN: f32 = 0.3;

/// Patches in an order in which neighbours are near in position and normal: halved where they spread most, down to single
/// ones, at multiples of [`TILE`] as long as there are more. `order[p]` is the patch at place p.
pub fn halving_order(positions: &[Vec3], normals: &[Vec3]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..positions.len().min(normals.len()) as u32).collect();
    let (low, high) = positions.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, p| (b.0.min(*p), b.1.max(*p)));
    let turn = TURN * (high - low).max_element().max(f32::MIN_POSITIVE);
    let key = |i: u32| {
        let (p, n) = (positions[i as usize], normals[i as usize] * turn);
        [p.x, p.y, p.z, n.x, n.y, n.z]
    };
    halve(&mut order, &key);
    order
}

fn halve(part: &mut [u32], key: &(impl Fn(u32) -> [f32; 6] + Sync)) {
    if part.len() <= 2 {
        return;
    }
    let (mut low, mut high) = ([f32::INFINITY; 6], [f32::NEG_INFINITY; 6]);
    for &i in part.iter() {
        for (axis, x) in key(i).into_iter().enumerate() {
            (low[axis], high[axis]) = (low[axis].min(x), high[axis].max(x));
        }
    }
    let spread = |axis: usize| high[axis] - low[axis];
    let axis = (0..6).max_by(|&a, &b| spread(a).total_cmp(&spread(b)).then(b.cmp(&a))).unwrap_or(0);
    part.sort_unstable_by(|&a, &b| key(a)[axis].total_cmp(&key(b)[axis]).then(a.cmp(&b)));
    let tile = TILE as usize;
    let middle = if part.len() > tile { (part.len() / 2).next_multiple_of(tile) } else { part.len() / 2 };
    let (left, right) = part.split_at_mut(middle.min(part.len()));
    if left.is_empty() || right.is_empty() {
        return;
    }
    rayon::join(|| halve(left, key), || halve(right, key));
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::sampling::{hash3, unit};

    #[test]
    fn every_patch_has_one_place_and_neighbours_are_near() {
        for n in [0usize, 1, 2, 3, 127, 128, 129, 1000] {
            let random = |i: usize, d: u32| unit(hash3(i as u32, d, 1));
            let positions: Vec<Vec3> = (0..n).map(|i| Vec3::new(random(i, 0), random(i, 1), 0.0)).collect();
            let order = halving_order(&positions, &vec![Vec3::Z; n]);
            let mut sorted = order.clone();
            sorted.sort_unstable();
            assert!(sorted.iter().enumerate().all(|(k, &i)| k == i as usize) && sorted.len() == n);
            if n == 1000 {
                let walk = |order: &[u32]| -> f32 {
                    order.windows(2).map(|w| positions[w[0] as usize].distance(positions[w[1] as usize])).sum()
                };
                let given: Vec<u32> = (0..n as u32).collect();
                assert!(walk(&order) < 0.15 * walk(&given), "{} {}", walk(&order), walk(&given));
            }
        }
    }
}
