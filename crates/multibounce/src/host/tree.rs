//! An order in which neighbours are alike, by halving.

use std::vec::Vec;

use glam::Vec3;

use crate::kernel::tiles::TILE;

/// Products with the covariance that find a principal axis well enough to halve by.
const POWER_STEPS: usize = 12;

/// Position, and the normal at the scale of a patch.
type Place = [f32; 6];

/// Patches in an order in which neighbours are near in position and normal: halved across the axis along which they spread
/// most, down to single ones, at multiples of [`TILE`] as long as there are more. `order[p]` is the patch at place p. A turn
/// of the normal by a right angle counts like the distance of neighbours on a square sheet as wide as the whole: enough to
/// tell the sides of sheets apart, and no more, because patches of one corner see the same from its walls.
pub fn halving_order(positions: &[Vec3], normals: &[Vec3]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..positions.len().min(normals.len()) as u32).collect();
    let (low, high) = positions.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, p| (b.0.min(*p), b.1.max(*p)));
    let spacing = (high - low).max_element() / scene::math::sqrt(positions.len().max(1) as f32);
    let turn = spacing.max(f32::MIN_POSITIVE) * std::f32::consts::FRAC_1_SQRT_2;
    let place = |(p, n): (&Vec3, &Vec3)| [p.x, p.y, p.z, turn * n.x, turn * n.y, turn * n.z];
    let places: Vec<Place> = positions.iter().zip(normals).map(place).collect();
    halve(&mut order, &places);
    order
}

/// Mean, and the axis along which these spread most.
fn principal_axis(part: &[u32], places: &[Place]) -> ([f64; 6], [f64; 6]) {
    let mut mean = [0.0f64; 6];
    for &i in part {
        (0..6).for_each(|k| mean[k] += f64::from(places[i as usize][k]) / part.len() as f64);
    }
    let mut covariance = [[0.0f64; 6]; 6];
    for &i in part {
        let offset: [f64; 6] = std::array::from_fn(|k| f64::from(places[i as usize][k]) - mean[k]);
        (0..6).for_each(|k| (0..6).for_each(|l| covariance[k][l] += offset[k] * offset[l]));
    }
    let mut axis: [f64; 6] = std::array::from_fn(|k| covariance[k][k]);
    for _ in 0..POWER_STEPS {
        let next: [f64; 6] = std::array::from_fn(|k| (0..6).map(|l| covariance[k][l] * axis[l]).sum());
        let length = libm::sqrt(next.iter().map(|x| x * x).sum());
        if length == 0.0 {
            break;
        }
        axis = next.map(|x| x / length);
    }
    (mean, axis)
}

fn halve(part: &mut [u32], places: &[Place]) {
    if part.len() <= 2 {
        return;
    }
    let (mean, axis) = principal_axis(part, places);
    let along = |i: u32| -> f64 { (0..6).map(|k| (f64::from(places[i as usize][k]) - mean[k]) * axis[k]).sum() };
    let mut keyed: Vec<(f64, u32)> = part.iter().map(|&i| (along(i), i)).collect();
    keyed.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    part.iter_mut().zip(keyed).for_each(|(i, (_, sorted))| *i = sorted);
    let tile = TILE as usize;
    let middle = if part.len() > tile { (part.len() / 2).next_multiple_of(tile) } else { part.len() / 2 };
    let (left, right) = part.split_at_mut(middle.min(part.len()));
    if left.is_empty() || right.is_empty() {
        return;
    }
    rayon::join(|| halve(left, places), || halve(right, places));
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
