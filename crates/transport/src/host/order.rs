//! An order in which neighbours are alike, by halving.

use std::vec::Vec;

use glam::{Vec3, Vec4};
use transport::bisect::bisect;

use crate::kernel::tiles::TILE;

/// Products with the covariance that find a principal axis well enough to halve by.
const POWER_STEPS: usize = 12;

/// Position, normal and what is seen, at the scale of positions.
type Place = [f32; DIMENSIONS];
const DIMENSIONS: usize = 10;
/// What the middle of what patches see counts, beside their own.
const SEEN: f32 = 0.3;
/// What sight that always meets something counts beside sight that never does, in distances of neighbours on the sheet.
const COVER: f32 = 12.0;

/// Patches in an order in which neighbours are alike: halved across the axis along which they spread
/// most, down to single ones, at multiples of [`TILE`] as long as there are more. `order[p]` is the patch at place p.
///
/// What spreads are positions, m; normals, whose turn by a right angle counts like the distance of neighbours on a square sheet as
/// wide as the whole: enough to tell the sides of sheets apart, and no more, because patches of one corner see the same
/// from its walls; and, unless `seen` is empty, what patches see: `seen[i] = Σ_j F_ij (p_j, 1)`, by whose w (the share of sight that
/// meets anything) places under the sky differ from those beside them that are not.
pub fn halving_order(positions: &[Vec3], normals: &[Vec3], seen: &[Vec4]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..positions.len().min(normals.len()) as u32).collect();
    let (low, high) = positions.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, p| (b.0.min(*p), b.1.max(*p)));
    let spacing = (high - low).max_element() / scene::math::sqrt(positions.len().max(1) as f32);
    let turn = spacing.max(f32::MIN_POSITIVE) * std::f32::consts::FRAC_1_SQRT_2;
    let place = |i: &u32| {
        let (p, n) = (positions[*i as usize], turn * normals[*i as usize]);
        let sight = match seen.get(*i as usize) {
            Some(sight) if sight.w > 0.0 => (SEEN * (sight.truncate() / sight.w)).extend(COVER * spacing * sight.w),
            // What sees nothing sees itself.
            Some(_) => (SEEN * p).extend(0.0),
            None => Vec4::ZERO,
        };
        [p.x, p.y, p.z, n.x, n.y, n.z, sight.x, sight.y, sight.z, sight.w]
    };
    let places: Vec<Place> = order.iter().map(place).collect();
    bisect(&mut order, |part| ((), halve(part, &places)));
    order
}

/// Mean, and the axis along which these spread most.
fn principal_axis(part: &[u32], places: &[Place]) -> ([f64; DIMENSIONS], [f64; DIMENSIONS]) {
    let mut mean = [0.0f64; DIMENSIONS];
    for &i in part {
        (0..DIMENSIONS).for_each(|k| mean[k] += f64::from(places[i as usize][k]) / part.len() as f64);
    }
    let mut covariance = [[0.0f64; DIMENSIONS]; DIMENSIONS];
    for &i in part {
        let offset: [f64; DIMENSIONS] = std::array::from_fn(|k| f64::from(places[i as usize][k]) - mean[k]);
        (0..DIMENSIONS).for_each(|k| (0..DIMENSIONS).for_each(|l| covariance[k][l] += offset[k] * offset[l]));
    }
    let mut axis: [f64; DIMENSIONS] = std::array::from_fn(|k| covariance[k][k]);
    for _ in 0..POWER_STEPS {
        let next: [f64; DIMENSIONS] =
            std::array::from_fn(|k| (0..DIMENSIONS).map(|l| covariance[k][l] * axis[l]).sum());
        let length = libm::sqrt(next.iter().map(|x| x * x).sum());
        if length == 0.0 {
            break;
        }
        axis = next.map(|x| x / length);
    }
    (mean, axis)
}

/// Sorts a part along its principal axis, and says where it is cut.
fn halve(part: &mut [u32], places: &[Place]) -> usize {
    if part.len() <= 2 {
        return 0;
    }
    let (mean, axis) = principal_axis(part, places);
    let along =
        |i: u32| -> f64 { (0..DIMENSIONS).map(|k| (f64::from(places[i as usize][k]) - mean[k]) * axis[k]).sum() };
    let mut keyed: Vec<(f64, u32)> = part.iter().map(|&i| (along(i), i)).collect();
    keyed.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    part.iter_mut().zip(keyed).for_each(|(i, (_, sorted))| *i = sorted);
    let tile = TILE as usize;
    if part.len() > tile { (part.len() / 2).next_multiple_of(tile) } else { part.len() / 2 }
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
            let order = halving_order(&positions, &vec![Vec3::Z; n], &[]);
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

    #[test]
    fn what_sees_the_same_is_together() {
        // A row of patches, every other one under the sky.
        let n = 256;
        let positions: Vec<Vec3> = (0..n).map(|i| Vec3::X * i as f32).collect();
        let seen = |i: usize| (positions[i], if i.is_multiple_of(2) { 1.0 } else { 0.1 });
        let seen: Vec<Vec4> = (0..n).map(seen).map(|(p, cover)| (cover * p).extend(cover)).collect();
        let halves = |seen: &[Vec4]| {
            let order = halving_order(&positions, &vec![Vec3::Z; n], seen);
            let (first, second) = order.split_at(n / 2);
            [first, second].map(|half| half.iter().filter(|&&i| i.is_multiple_of(2)).count())
        };
        assert_eq!(halves(&[]), [n / 4; 2]);
        // Neighbours are 16 apart where the whole is 256 wide: sight counts 172.
        let parts = halves(&seen);
        assert!(parts.iter().all(|&even| !(n / 8..=3 * n / 8).contains(&even)), "{parts:?}");
    }
}
