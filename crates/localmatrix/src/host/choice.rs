//! Which patches are to be in the matrix.

use alloc::vec::Vec;
use glam::Vec3;

/// Patches that come and go.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Choice {
    /// Nearest first.
    pub enter: Vec<u32>,
    /// Farthest first.
    pub leave: Vec<u32>,
}

/// Distance of a point from the predicted camera path, from `eye` to `predicted`, m: patches that it will come to
/// are near before it is there.
pub fn distance_to_path(point: Vec3, eye: Vec3, predicted: Vec3) -> f32 {
    let path = predicted - eye;
    let length = path.length_squared();
    let along = if length > 0.0 { ((point - eye).dot(path) / length).clamp(0.0, 1.0) } else { 0.0 };
    point.distance(eye + path * along)
}

/// The nearest `capacity` patches; those that are in count as `hysteresis` of their distance nearer, so that a camera
/// that trembles moves nothing. `distance` has one entry a patch; those that are not finite stay out. At most `budget`
/// enter, the nearest of them, and no more leave than must.
pub fn choose(
    distance: &[f32],
    is_in: impl Fn(u32) -> bool,
    capacity: usize,
    hysteresis: f32,
    budget: usize,
) -> Choice {
    let rank = |&i: &u32| distance[i as usize] * if is_in(i) { 1.0 - hysteresis } else { 1.0 };
    let by_rank = |a: &u32, b: &u32| rank(a).total_cmp(&rank(b)).then(a.cmp(b));
    let mut order: Vec<u32> = (0..distance.len() as u32).filter(|&i| rank(&i).is_finite()).collect();
    if order.len() > capacity {
        order.select_nth_unstable_by(capacity, by_rank);
    }
    let mut near: Vec<u32> = order.iter().take(capacity).copied().collect();
    near.sort_unstable_by(by_rank);
    let enter: Vec<u32> = near.iter().copied().filter(|&i| !is_in(i)).take(budget).collect();
    let stays = near.iter().filter(|&&i| is_in(i)).count();
    let mut leave: Vec<u32> = (0..distance.len() as u32).filter(|&i| is_in(i)).collect();
    leave.sort_unstable_by(|a, b| by_rank(b, a));
    let too_many = (leave.len() + enter.len()).saturating_sub(capacity);
    leave.truncate(too_many.min(leave.len() - stays));
    Choice { enter, leave }
}
