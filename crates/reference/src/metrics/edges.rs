//! Faults along edges, and patterns: what depends on where surfaces begin and end in the picture.
//!
//! | fault | pixels that count |
//! |---|---|
//! | tooth | within 3 pixels of an edge, its indirect light differs from the reference by more than 25 % |
//! | pattern | away from edges: correlation of the relative error with itself, 2 to 16 pixels further |

use rayon::prelude::*;
use scene::gpu::NONE;
use scene::kernel::camera::{primary_direction, primary_hit, surface_point};
use scene::math::luminance;
use scene::{Camera, Scene, SurfacePoint};

use super::faults::{MAGENTA, STAIN, about, marked};
use super::{DARK_BLOCK, Judge};
use crate::error::Error;
use crate::picture::Picture;

/// Pixels on either side of an edge in which teeth are counted.
pub const NEAR_EDGE: u32 = 3;
/// Distances over which patterns are looked for, pixels.
pub const LAGS: std::ops::RangeInclusive<u32> = 2..=16;
/// Cosine between the normals of neighbouring pixels below which an edge lies between them.
const LIKE_NORMALS: f32 = 0.9;
/// Share of the way between neighbouring pixels by which one may stand off the other's plane.
const MAX_SLOPE: f32 = 0.1;
/// Pixels on either side of one over which the mean error is taken off before patterns are looked for.
const ABOUT: u32 = 8;
/// Greatest standard deviation over them, relative to their mean, of light that counts as even.
const EVEN: f64 = 0.1;
/// Mean squared relative error below which pictures differ by rounding alone.
const MIN_POWER: f64 = 1e-10;
/// Least number of pairs of pixels from which a correlation is told.
const MIN_PAIRS: usize = 1000;

/// Edges of what a camera sees: silhouettes and creases.
#[derive(Clone, Debug)]
pub struct Edges {
    width: u32,
    height: u32,
    /// True where an edge is near, and where nothing is seen.
    near: Vec<bool>,
    /// True where the camera sees a surface.
    seen: Vec<bool>,
}

impl Edges {
    /// The edges between the surfaces that rays through the middles of the pixels meet.
    pub fn new(scene: &Scene, camera: &Camera) -> Self {
        let camera = Camera { fixed_sub_frames: 1, ..*camera };
        let tables = scene.geometry.tables();
        let (width, height) = (camera.width, camera.height);
        let point = |index: u32| {
            let hit = primary_hit(&tables, &camera, index, 0);
            surface_point(&tables, hit, primary_direction(&camera, index, 0))
        };
        let points: Vec<SurfacePoint> = (0..width * height).into_par_iter().map(point).collect();
        let seen: Vec<bool> = points.iter().map(|p| p.patch != NONE).collect();
        let differs = |a: usize, b: usize| {
            let (p, q) = (&points[a], &points[b]);
            let way = q.position - p.position;
            let off = way.dot(p.normal).abs().max(way.dot(q.normal).abs());
            seen[a] != seen[b] || seen[a] && (p.normal.dot(q.normal) < LIKE_NORMALS || off > MAX_SLOPE * way.length())
        };
        let is_edge: Vec<bool> = (0..points.len())
            .map(|k| {
                let x = k as u32 % width;
                let y = k as u32 / width;
                x + 1 < width && differs(k, k + 1) || y + 1 < height && differs(k, k + width as usize)
            })
            .collect();
        let is_near = |k: u32| {
            let columns = about(k % width, NEAR_EDGE, width);
            let mut rows = about(k / width, NEAR_EDGE, height);
            rows.any(|y| columns.clone().any(|x| is_edge[(y * width + x) as usize]))
        };
        let near = (0..width * height).into_par_iter().map(is_near).collect();
        Self { width, height, near, seen }
    }

    /// Returns true for a pixel that is near an edge.
    pub fn is_near(&self, pixel: usize) -> bool {
        self.near[pixel]
    }

    /// Pixels of a picture of indirect light that are teeth, row by row. A difference that the noise of the reference
    /// explains is none.
    ///
    /// # Errors
    /// The pictures differ in size or hold numbers that are not finite.
    pub fn tooth_map(&self, judge: &Judge, ours: &Picture) -> Result<Vec<bool>, Error> {
        let doubts = judge.checked_doubts(ours)?;
        self.check(ours)?;
        let least = DARK_BLOCK * f64::from(luminance(judge.reference.mean()));
        let is_tooth = |k: usize| {
            let reference = f64::from(luminance(judge.reference.pixels[k]));
            let difference = (f64::from(luminance(ours.pixels[k])) - reference).abs();
            self.near[k] && self.seen[k] && difference > (STAIN * reference.max(least)).max(doubts[k])
        };
        Ok((0..ours.pixels.len()).map(is_tooth).collect())
    }

    /// Teeth as a share of all pixels.
    ///
    /// # Errors
    /// As [`Edges::tooth_map`].
    pub fn tooth_share(&self, judge: &Judge, ours: &Picture) -> Result<f64, Error> {
        let map = self.tooth_map(judge, ours)?;
        Ok(map.iter().filter(|is_tooth| **is_tooth).count() as f64 / map.len().max(1) as f64)
    }

    /// The picture in grey with teeth in magenta; to be shown without exposure. `scale` is the exposure of the grey.
    ///
    /// # Errors
    /// As [`Edges::tooth_map`].
    pub fn tooth_picture(&self, judge: &Judge, ours: &Picture, scale: f32) -> Result<Picture, Error> {
        let map = self.tooth_map(judge, ours)?;
        Ok(marked(ours, scale, map.iter().map(|is_tooth| is_tooth.then_some(MAGENTA))))
    }

    /// Greatest correlation of the relative error with itself 2 to 16 pixels to the right or below, over pixels in
    /// even light away from edges; the mean error about a pixel is taken off. 0 where errors are as random
    /// as the grain of the reference, towards 1 where they repeat. None where fewer than a thousand pairs of pixels
    /// can be compared.
    ///
    /// # Errors
    /// The pictures differ in size or hold numbers that are not finite.
    pub fn pattern(&self, reference: &Picture, ours: &Picture) -> Result<Option<f64>, Error> {
        Judge::new(reference).checked_doubts(ours)?;
        self.check(ours)?;
        let errors = self.even_errors(reference, ours);
        let correlation = |dx: u32, dy: u32| {
            let (mut product, mut power, mut count) = (0.0, 0.0, 0);
            for k in 0..errors.len() {
                let x = k as u32 % self.width + dx;
                let y = k as u32 / self.width + dy;
                if x >= self.width || y >= self.height {
                    continue;
                }
                if let (Some(a), Some(b)) = (errors[k], errors[(y * self.width + x) as usize]) {
                    product += a * b;
                    power += 0.5 * (a * a + b * b);
                    count += 1;
                }
            }
            (count >= MIN_PAIRS).then(|| if power > MIN_POWER * count as f64 { product / power } else { 0.0 })
        };
        let lags: Vec<(u32, u32)> = LAGS.flat_map(|lag| [(lag, 0), (0, lag)]).collect();
        Ok(lags.into_par_iter().filter_map(|(dx, dy)| correlation(dx, dy)).reduce_with(f64::max))
    }

    /// Relative error of each pixel, less the mean of those about it; none near edges, where it is dark, and where our
    /// light is not even about it: errors follow textures and the rims of shadows, which repeat nowhere else.
    fn even_errors(&self, reference: &Picture, ours: &Picture) -> Vec<Option<f64>> {
        let least = DARK_BLOCK.sqrt() * f64::from(luminance(reference.mean()));
        let light = |picture: &Picture, k: usize| f64::from(luminance(picture.pixels[k]));
        let is_counted = |k: usize| !self.near[k] && self.seen[k] && light(reference, k) > least;
        let counted: Vec<bool> = (0..ours.pixels.len()).map(is_counted).collect();
        let error = |k: usize| light(ours, k) / light(reference, k) - 1.0;
        let less_mean = |k: usize| {
            if !counted[k] {
                return None;
            }
            let columns = about(k as u32 % self.width, ABOUT, self.width);
            let rows = about(k as u32 / self.width, ABOUT, self.height);
            let near = rows.flat_map(|y| columns.clone().map(move |x| (y * self.width + x) as usize));
            let (mut count, mut errors, mut sum, mut squares) = (0.0, 0.0, 0.0, 0.0);
            for j in near.filter(|j| counted[*j]) {
                let value = light(ours, j);
                count += 1.0;
                errors += error(j);
                sum += value;
                squares += value * value;
            }
            let mean = sum / count;
            let variance = (squares / count - mean * mean).max(0.0);
            (variance <= EVEN * EVEN * mean * mean).then(|| error(k) - errors / count)
        };
        (0..counted.len()).into_par_iter().map(less_mean).collect()
    }

    fn check(&self, ours: &Picture) -> Result<(), Error> {
        // Edges of another camera would be those of another picture.
        let size = Picture { width: self.width, height: self.height, pixels: Vec::new() };
        Ok(ours.check_size(&size)?)
    }
}
