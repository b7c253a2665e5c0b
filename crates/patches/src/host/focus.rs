//! Viewing area, and the density of samples, patches and receivers by it: they stand close where light that is sent
//! matters, and far apart on distant ground.

use alloc::vec;
use alloc::vec::Vec;

use glam::{DVec3, Vec3};
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::gpu::Triangle;
use scene::kernel::walk::LIT;
use scene::parallel::*;
use scene::sampling::{cosine_hemisphere, hash3, uniform_triangle, unit};
use scene::{Scene, SurfacePoint, Visibility, reachability};

use crate::error::Error;

/// Random walks that look for enclosed space, and their steps.
const WALKERS: usize = 4096;
const STEPS: u32 = 6;
/// Random walks by which it is decided whether light comes to where one starts.
const LIT_WALKS: u32 = 3;
/// Rays from an eye.
const EYE_RAYS: u32 = 4096;
/// Share of the places that may lie outside of the focus at either end of each axis.
const OUTSIDE: f32 = 0.02;
/// Least extent of a focus along an axis, as a share of its greatest.
const FLATTEST: f32 = 1.0 / 16.0;
/// Levels at most: edges are 2¹² times as long at the last.
const MAX_LEVELS: u32 = 12;
/// Upper bound of the share that distant surfaces get beyond what the light that they send would give them.
const FAR_SHARE: f64 = 1.0 / 64.0;
/// Enclosed space gets more than the rest only where all surface counts less than this share of its area.
const MAX_COUNTED: f64 = 0.5;
/// Most halvings of a triangle, one within the other.
const MAX_HALVINGS: u32 = 48;
/// Changes random numbers.
const WALK_SALT: u32 = 0x666f_6375;

/// Vectors as three numbers.
#[cfg(feature = "serde")]
mod as_array {
    use glam::Vec3;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(v: &Vec3, serializer: S) -> Result<S::Ok, S::Error> {
        v.to_array().serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec3, D::Error> {
        <[f32; 3]>::deserialize(deserializer).map(Vec3::from)
    }
}

/// Viewing area.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Focus {
    /// Enclosed space, into which and in which most of the light goes that surfaces there send. The same density
    /// everywhere unless that would take more than half of what is shared out to far ground.
    #[default]
    Auto,
    /// In a box; see [`Focus::seen_from`] for that of eyes.
    Box {
        /// Least coordinates, m.
        #[cfg_attr(feature = "serde", serde(with = "as_array"))]
        low: Vec3,
        /// Greatest coordinates, m.
        #[cfg_attr(feature = "serde", serde(with = "as_array"))]
        high: Vec3,
    },
}

impl Focus {
    /// The box that holds what is seen from these places in all directions, without the outermost 2 % at either end of
    /// each axis; [`Focus::Auto`] where nothing is seen.
    pub fn seen_from(scene: &Scene, eyes: &[Vec3]) -> Self {
        let ray = |k: u32| {
            let eye = k / EYE_RAYS;
            let ray = k % EYE_RAYS;
            // Fibonacci's lattice on the sphere.
            let height = 1.0 - (2.0 * ray as f32 + 1.0) / EYE_RAYS as f32;
            let (sin, cos) = scene::math::sin_cos_2pi((ray as f32 * 0.618_034).fract());
            let across = scene::math::sqrt(1.0 - height * height);
            let direction = Vec3::new(across * cos, height, across * sin);
            let origin = eyes[eye as usize];
            let hit = scene.closest(origin, direction);
            (!hit.is_miss()).then(|| origin + direction * hit.t)
        };
        let seen: Vec<Vec3> = (0..eyes.len() as u32 * EYE_RAYS).into_par_iter().filter_map(ray).collect();
        match middle_box(&seen) {
            Some((low, high)) => Self::Box { low, high },
            None => Self::Auto,
        }
    }
}

/// Density of samples, patches and receivers in a scene. Around a box, the focus, distances between samples, patches
/// and receivers are as asked for; they double from level to level as less of the light that a place sends can get to
/// the box.
///
/// A box with the extents h ≤ w ≤ l covers at a distance d about `s = (h / (h + d))² w / (w + d)` of the hemisphere of
/// level ground (of a wall that is h high and without end, (h / 2d)² far off; w wide, w / d of that). Edges are `1/√s`
/// as long: each patch then sends about the same share of its light into the box. Level l, where `s` is about `4⁻ˡ`,
/// has edges of 2ˡ. The last level is that at which all surface together gets a 64th of what is shared out: far ground
/// has patches, but few.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Density {
    #[cfg_attr(feature = "serde", serde(with = "as_array"))]
    low: Vec3,
    #[cfg_attr(feature = "serde", serde(with = "as_array"))]
    high: Vec3,
    /// Two lesser extents of the box, the least first, m.
    extents: (f32, f32),
    last_level: u32,
}

impl Density {
    /// That of a focus. The default is the same everywhere; so is [`Focus::Auto`] where little surface is far off.
    ///
    /// # Errors
    /// [`Error::Setting`] for a box that is not one.
    pub fn new(scene: &Scene, focus: Focus, seed: u32) -> Result<Self, Error> {
        let (low, high) = match focus {
            Focus::Box { low, high } => {
                let size = (high - low).min_element();
                if !(size >= 0.0 && low.is_finite() && high.is_finite()) {
                    let rule = "at least 0 along each axis, from finite coordinates to greater ones";
                    return Err(Error::Setting { name: "the focus' extent", value: f64::from(size), rule });
                }
                (low, high)
            }
            Focus::Auto => match enclosed_box(scene, seed) {
                Some(found) => found,
                None => return Ok(Self::default()),
            },
        };
        let mut extents = (high - low).to_array();
        extents.sort_by(f32::total_cmp);
        let least = (FLATTEST * extents[2]).max(scene.geometry.ray_offset);
        let extents = (extents[0].max(least), extents[1].max(least));
        let density = Self { low, high, extents, last_level: MAX_LEVELS };
        let areas = density.areas(scene);
        let density = density.with_last_level(&areas);
        let is_worth_it = focus != Focus::Auto || areas.counted(density.last_level) < MAX_COUNTED * areas.whole();
        Ok(if is_worth_it { density } else { Self::default() })
    }

    /// The level of a place: distances there are 2ˡ times as great as in the focus.
    pub fn level(&self, position: Vec3) -> u32 {
        self.level_at((self.low - position).max(position - self.high).max(Vec3::ZERO).length())
    }

    /// Factor of the distances at a place over those in the focus.
    pub fn edge(&self, position: Vec3) -> f32 {
        (1u32 << self.level(position)) as f32
    }

    /// Sampling density relative to the focus.
    pub fn share(&self, position: Vec3) -> f32 {
        let edge = self.edge(position);
        1.0 / (edge * edge)
    }

    /// Returns true if a side of a surface is far from the focus and faces some of it. Few rays from there meet
    /// anything, and yet all such surface together may send much light.
    pub fn is_far_and_faces(&self, position: Vec3, normal: Vec3) -> bool {
        // The corner of the box that is furthest along the normal.
        let corner = Vec3::select(normal.cmpgt(Vec3::ZERO), self.high, self.low);
        self.level(position) > 0 && (corner - position).dot(normal) > 0.0
    }

    /// [`Density::edge`] on a triangle: that of its middle.
    pub fn triangle_edge(&self, triangle: &Triangle) -> f32 {
        self.edge(triangle.corner + (triangle.edge_a + triangle.edge_b) / 3.0)
    }

    /// [`Density::share`] on a triangle.
    pub fn triangle_share(&self, triangle: &Triangle) -> f32 {
        let edge = self.triangle_edge(triangle);
        1.0 / (edge * edge)
    }

    /// Area of a triangle, each part of it times its [`Density::share`], m².
    pub fn counted_area(&self, triangle: &Triangle) -> f64 {
        self.parts(corners(triangle))
            .into_iter()
            .map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length() * f64::from(self.share(((a + b + c) / 3.0).as_vec3())))
            .sum()
    }

    /// Parts of a triangle, halved until none of them reaches over more than two levels.
    pub fn parts(&self, triangle: [DVec3; 3]) -> Vec<[DVec3; 3]> {
        let mut parts = Vec::new();
        let mut open = vec![(triangle, 0)];
        while let Some((part, halvings)) = open.pop() {
            match halvings < MAX_HALVINGS && self.reaches_far(&part) {
                true => open.extend(halves(part).map(|half| (half, halvings + 1))),
                false => parts.push(part),
            }
        }
        parts
    }

    fn level_at(&self, distance: f32) -> u32 {
        let (least, middle) = self.extents;
        let height = least / (least + distance);
        let share = height * height * middle / (middle + distance);
        let mut level = 0;
        let mut border = 0.5;
        while level < self.last_level && share < border {
            level += 1;
            border *= 0.25;
        }
        level
    }

    /// Returns true if a triangle reaches over more than two levels, and is large enough for that to matter.
    fn reaches_far(&self, corners: &[DVec3; 3]) -> bool {
        let low = corners[0].min(corners[1]).min(corners[2]).as_vec3();
        let high = corners[0].max(corners[1]).max(corners[2]).as_vec3();
        let nearest = (self.low - high).max(low - self.high).max(Vec3::ZERO).length();
        let least = self.level_at(nearest);
        let greatest = corners.iter().map(|corner| self.level(corner.as_vec3())).max().unwrap_or(least);
        greatest > least + 1 && (high - low).max_element() > 0.25 * self.extents.0
    }

    /// Limits the last level, at which all surface gets no more than its share; `areas` has all.
    fn with_last_level(self, areas: &LevelAreas) -> Self {
        let counted = areas.counted(MAX_LEVELS);
        let fits = |level: &u32| areas.whole() * 0.25f64.powi(*level as i32) <= FAR_SHARE * counted;
        Self { last_level: (0..MAX_LEVELS).find(fits).unwrap_or(MAX_LEVELS), ..self }
    }

    /// Area of the surface on each level.
    fn areas(&self, scene: &Scene) -> LevelAreas {
        let triangles = scene.geometry.triangles.par_iter();
        let found: Vec<LevelAreas> = triangles
            .map(|triangle| {
                let mut areas = LevelAreas::default();
                for [a, b, c] in self.parts(corners(triangle)) {
                    let level = self.level(((a + b + c) / 3.0).as_vec3());
                    areas.0[level as usize] += 0.5 * (b - a).cross(c - a).length();
                }
                areas
            })
            .collect();
        let mut sum = LevelAreas::default();
        for areas in found {
            sum.0.iter_mut().zip(areas.0).for_each(|(sum, area)| *sum += area);
        }
        sum
    }
}

/// Area of the surface on each level, m².
#[derive(Clone, Copy, Debug, Default)]
struct LevelAreas([f64; 1 + MAX_LEVELS as usize]);

impl LevelAreas {
    fn whole(&self) -> f64 {
        self.0.iter().sum()
    }

    /// The area as it is counted where no level is above the last.
    fn counted(&self, last: u32) -> f64 {
        (0u32..).zip(self.0).map(|(level, area)| area * 0.25f64.powi(level.min(last) as i32)).sum()
    }
}

/// Corners of a triangle.
pub(super) fn corners(t: &Triangle) -> [DVec3; 3] {
    let corner = t.corner.as_dvec3();
    [corner, corner + t.edge_a.as_dvec3(), corner + t.edge_b.as_dvec3()]
}

/// Both halves of a triangle, cut through the middle of its longest edge.
fn halves([a, b, c]: [DVec3; 3]) -> [[DVec3; 3]; 2] {
    let lengths = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
    let [a, b, c] = if lengths[0] >= lengths[1] && lengths[0] >= lengths[2] {
        [a, b, c]
    } else if lengths[1] >= lengths[2] {
        [b, c, a]
    } else {
        [c, a, b]
    };
    let middle = 0.5 * (a + b);
    [[a, middle, c], [middle, b, c]]
}

/// The box of places without the outermost at either end of each axis.
fn middle_box(places: &[Vec3]) -> Option<(Vec3, Vec3)> {
    let outside = (places.len() as f32 * OUTSIDE) as usize;
    let mut low = Vec3::ZERO;
    let mut high = Vec3::ZERO;
    for axis in 0..3 {
        let mut along: Vec<f32> = places.iter().map(|place| place[axis]).collect();
        along.sort_unstable_by(f32::total_cmp);
        low[axis] = *along.get(outside)?;
        high[axis] = *along.get(along.len() - 1 - outside)?;
    }
    Some((low, high))
}

/// Position of a random walk, and the surface that it speaks for.
#[derive(Clone, Copy)]
struct Walker {
    position: Vec3,
    normal: Vec3,
    weight: f32,
}

/// The box of enclosed space: random walks start on surfaces that light comes to and go on by cosine-weighted rays;
/// those that escape are replaced by copies of others. After some steps a place holds as many of them as its area times
/// the share of the light sent there that is still in the scene after so many bounces between white surfaces (`A_i F_ij
/// = A_j F_ji`), which is greatest in enclosed space, however much open ground there is. None where all escape.
fn enclosed_box(scene: &Scene, seed: u32) -> Option<(Vec3, Vec3)> {
    let seed = seed ^ WALK_SALT;
    let mut walkers = first_walkers(scene, seed);
    for step in 0..STEPS {
        let chosen = resample(&walkers, unit(hash3(step, 1, seed)));
        let numbered = chosen.par_iter().enumerate();
        walkers = numbered.filter_map(|(k, walker)| walk(scene, walker, hash3(k as u32, step, seed))).collect();
    }
    let places: Vec<Vec3> = walkers.iter().map(|walker| walker.position).collect();
    middle_box(&places)
}

/// Places that light comes to: half of them by area, half of them as many on each triangle, so that neither far ground
/// nor fine meshes take all.
fn first_walkers(scene: &Scene, seed: u32) -> Vec<Walker> {
    let areas: Vec<f64> =
        scene.geometry.triangles.iter().map(|t| 0.5 * f64::from(t.edge_a.cross(t.edge_b).length())).collect();
    let mut sums = Vec::with_capacity(areas.len());
    let mut sum = 0.0;
    for area in &areas {
        sum += area;
        sums.push(sum);
    }
    let start = |k: usize| {
        let random = |dimension: u32| unit(hash3(k as u32, dimension, seed));
        let place = (f64::from(random(0)) + (k / 2) as f64) / (WALKERS / 2) as f64;
        let triangle = match k % 2 {
            0 => sums.partition_point(|&s| s <= place * sum),
            _ => (place * areas.len() as f64) as usize,
        };
        let triangle = triangle.min(areas.len() - 1);
        let density = 0.5 / sum + 0.5 / (areas.len() as f64 * areas[triangle].max(f64::MIN_POSITIVE));
        let (u, v) = uniform_triangle((random(1), random(2)));
        let geometry = scene.tables();
        let front = geometry.normal(triangle as u32);
        let normal = if random(3) < 0.5 { front } else { -front };
        let position = geometry.position(triangle as u32, u, v);
        let place = SurfacePoint { position, patch: k as u32, normal, weight: 0.0 };
        let takes_part = normal.is_finite()
            && !geometry.is_hole(triangle as u32, u, v)
            && reachability(scene, &place, LIT_WALKS, seed) == LIT;
        takes_part.then_some(Walker { position, normal, weight: (1.0 / density) as f32 })
    };
    (0..WALKERS).into_par_iter().filter_map(start).collect()
}

/// As many walkers as there were at first, of equal weight, in proportion to their weights.
fn resample(walkers: &[Walker], shift: f32) -> Vec<Walker> {
    let total: f64 = walkers.iter().map(|walker| f64::from(walker.weight)).sum();
    let mut chosen = Vec::with_capacity(WALKERS);
    let mut sum = 0.0;
    for walker in walkers {
        sum += f64::from(walker.weight);
        while chosen.len() < WALKERS && (chosen.len() as f64 + f64::from(shift)) * total < sum * WALKERS as f64 {
            chosen.push(Walker { weight: 1.0, ..*walker });
        }
    }
    chosen
}

/// Next position of a walker; none where it escapes.
fn walk(scene: &Scene, walker: &Walker, seed: u32) -> Option<Walker> {
    let xi = (unit(hash3(seed, 0, 0)), unit(hash3(seed, 1, 0)));
    let direction = cosine_hemisphere(walker.normal, xi);
    let hit = scene.closest(walker.position + walker.normal * scene.geometry.ray_offset, direction);
    if hit.is_miss() {
        return None;
    }
    let geometry = scene.tables();
    let front = geometry.normal(hit.triangle);
    let normal = if front.dot(direction) < 0.0 { front } else { -front };
    Some(Walker { position: geometry.position(hit.triangle, hit.u, hit.v), normal, ..*walker })
}
