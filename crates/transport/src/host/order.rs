//! An order of patches or receivers in which neighbours are alike, by bisection.

use alloc::vec::Vec;

use glam::{Vec3, Vec4};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use crate::bisect::bisect;

/// Products with the covariance that find a principal axis well enough to bisect by.
const POWER_STEPS: usize = 12;
/// Weight of the mean visible point, beside 1 of the position.
const VISIBLE_WEIGHT: f32 = 0.3;
/// Weight of ambient occlusion, in distances of neighbours on a square sheet as wide as the whole:
/// what 0 and 1 differ by.
const OCCLUSION_WEIGHT: f32 = 12.0;

/// Position, normal, mean visible point and ambient occlusion, at the scale of positions.
type Features = [f32; DIMENSIONS];
const DIMENSIONS: usize = 10;

/// An order of surface points in which neighbours are alike: points are bisected across the
/// principal axis of their features, down to single ones. Parts of more than `multiple` points are
/// cut at a multiple of it. `order[p]` is the point at place p.
///
/// Features are positions, m; normals, of which a right angle counts like the distance of
/// neighbours on a square sheet as wide as the whole: enough to distinguish the sides of a sheet,
/// and no more, because walls of one corner see the same; and, unless `visible` is empty, the mean
/// visible point and the ambient occlusion, `visible[i] = Σ_j F_ij (p_j, 1)`, whose w is the share
/// of the hemisphere that meets geometry.
pub fn spatial_order(positions: &[Vec3], normals: &[Vec3], visible: &[Vec4], multiple: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..positions.len().min(normals.len()) as u32).collect();
    let low = positions.iter().fold(Vec3::INFINITY, |low, p| low.min(*p));
    let high = positions.iter().fold(Vec3::NEG_INFINITY, |high, p| high.max(*p));
    let spacing = (high - low).max_element() / scene::math::sqrt(positions.len().max(1) as f32);
    let mut features: Vec<Features> = Vec::with_capacity(order.len());
    for (i, (position, normal)) in positions.iter().zip(normals).enumerate() {
        features.push(features_of(*position, *normal, visible.get(i), spacing));
    }
    bisect(&mut order, |part| ((), bisect_part(part, &features, multiple.max(1))));
    order
}

/// The features of a point; `spacing` is the distance of neighbours on a sheet, m.
fn features_of(p: Vec3, normal: Vec3, visible: Option<&Vec4>, spacing: f32) -> Features {
    let normal_scale = spacing.max(f32::MIN_POSITIVE) * core::f32::consts::FRAC_1_SQRT_2;
    let n = normal_scale * normal;
    let v = match visible {
        Some(v) if v.w > 0.0 => {
            let point = VISIBLE_WEIGHT * (v.truncate() / v.w);
            point.extend(OCCLUSION_WEIGHT * spacing * v.w)
        }
        // What sees nothing sees itself.
        Some(_) => (VISIBLE_WEIGHT * p).extend(0.0),
        None => Vec4::ZERO,
    };
    [p.x, p.y, p.z, n.x, n.y, n.z, v.x, v.y, v.z, v.w]
}

/// Mean of the features, and the axis along which they spread most, by power iteration.
fn principal_axis(part: &[u32], features: &[Features]) -> ([f64; DIMENSIONS], [f64; DIMENSIONS]) {
    let mut mean = [0.0f64; DIMENSIONS];
    for &i in part {
        for (mean, feature) in mean.iter_mut().zip(features[i as usize]) {
            *mean += f64::from(feature) / part.len() as f64;
        }
    }
    let mut covariance = [[0.0f64; DIMENSIONS]; DIMENSIONS];
    for &i in part {
        let own = &features[i as usize];
        let offset: [f64; DIMENSIONS] = core::array::from_fn(|k| f64::from(own[k]) - mean[k]);
        for (k, row) in covariance.iter_mut().enumerate() {
            for (l, entry) in row.iter_mut().enumerate() {
                *entry += offset[k] * offset[l];
            }
        }
    }
    let mut axis: [f64; DIMENSIONS] = core::array::from_fn(|k| covariance[k][k]);
    for _ in 0..POWER_STEPS {
        let next: [f64; DIMENSIONS] = core::array::from_fn(|k| dot(&covariance[k], &axis));
        let length = next.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length == 0.0 {
            break;
        }
        axis = next.map(|x| x / length);
    }
    (mean, axis)
}

fn dot(a: &[f64; DIMENSIONS], b: &[f64; DIMENSIONS]) -> f64 {
    (0..DIMENSIONS).map(|k| a[k] * b[k]).sum()
}

/// Sorts a part along its principal axis, and says where it is cut.
fn bisect_part(part: &mut [u32], features: &[Features], multiple: usize) -> usize {
    if part.len() <= 2 {
        return 0;
    }
    let (mean, axis) = principal_axis(part, features);
    let mut keyed: Vec<(f64, u32)> = Vec::with_capacity(part.len());
    for &i in part.iter() {
        let own = &features[i as usize];
        let offset: [f64; DIMENSIONS] = core::array::from_fn(|k| f64::from(own[k]) - mean[k]);
        keyed.push((dot(&offset, &axis), i));
    }
    keyed.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for (i, (_, sorted)) in part.iter_mut().zip(keyed) {
        *i = sorted;
    }
    let middle = part.len() / 2;
    if part.len() > multiple { middle.next_multiple_of(multiple) } else { middle }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::sampling::{hash3, unit};

    const MULTIPLE: usize = 128;

    #[test]
    fn every_patch_has_one_place_and_neighbours_are_near() {
        for n in [0usize, 1, 2, 3, 127, 128, 129, 1000] {
            let random = |i: usize, d: u32| unit(hash3(i as u32, d, 1));
            let positions: Vec<Vec3> = (0..n).map(|i| Vec3::new(random(i, 0), random(i, 1), 0.0)).collect();
            let order = spatial_order(&positions, &vec![Vec3::Z; n], &[], MULTIPLE);
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
        let seen: Vec<Vec4> = (0..n).map(seen).map(|(p, occlusion)| (occlusion * p).extend(occlusion)).collect();
        let side_counts = |seen: &[Vec4]| {
            let order = spatial_order(&positions, &vec![Vec3::Z; n], seen, MULTIPLE);
            let (first, second) = order.split_at(n / 2);
            [first, second].map(|half| half.iter().filter(|&&i| i.is_multiple_of(2)).count())
        };
        assert_eq!(side_counts(&[]), [n / 4; 2]);
        // Neighbours have a distance of 16 where the whole is 256 wide: occlusion counts 172.
        let parts = side_counts(&seen);
        assert!(parts.iter().all(|&even| !(n / 8..=3 * n / 8).contains(&even)), "{parts:?}");
    }
}
