//! Pictures of linear radiance in memory.

use alloc::vec;
use alloc::vec::Vec;

use crate::parallel::*;
use glam::Vec3;

use crate::double;
use crate::error::Error;
use crate::kernel::shade::encode_srgb;
use crate::math::{clamp, ln, luminance};

/// Linear Rec.709 RGB, row by row from the top: radiance in W/m²/sr unless stated otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width · height` values.
    pub pixels: Vec<Vec3>,
}

impl Picture {
    /// A black picture.
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, pixels: vec![Vec3::ZERO; width as usize * height as usize] }
    }

    /// A picture of given pixels.
    ///
    /// # Errors
    /// [`Error::PixelCount`] unless there are `width · height` of them.
    pub fn from_pixels(width: u32, height: u32, pixels: Vec<Vec3>) -> Result<Self, Error> {
        if pixels.len() != width as usize * height as usize {
            return Err(Error::PixelCount { width, height, found: pixels.len() });
        }
        Ok(Self { width, height, pixels })
    }

    /// sRGB code values in [0, 1] of the values × `scale`, clamped.
    pub fn displayed(&self, scale: f32) -> Self {
        let pixels = self.pixels.par_iter().map(|p| (*p * scale).map(|x| encode_srgb(clamp(x, 0.0, 1.0)))).collect();
        Self { pixels, ..*self }
    }

    /// [`Picture::displayed`] in 8 bits a channel, r g b r g b …
    pub fn displayed_bytes(&self, scale: f32) -> Vec<u8> {
        let code = |x: f32| (encode_srgb(clamp(x, 0.0, 1.0)) * 255.0 + 0.5) as u8;
        self.pixels.par_iter().flat_map_iter(|p| (*p * scale).to_array().map(code)).collect()
    }

    /// Means over whole squares of `edge` × `edge` pixels from the upper left corner; what is left at the right and at
    /// the bottom does not count.
    pub fn block_means(&self, edge: u32) -> Self {
        let width = self.width / edge;
        let height = self.height / edge;
        let mut blocks = Self::new(width, height);
        for by in 0..height {
            for bx in 0..width {
                let mut sum = Vec3::ZERO;
                for y in by * edge..(by + 1) * edge {
                    let first = (y * self.width + bx * edge) as usize;
                    sum += self.pixels[first..first + edge as usize].iter().sum::<Vec3>();
                }
                blocks.pixels[(by * width + bx) as usize] = sum / (edge * edge) as f32;
            }
        }
        blocks
    }

    /// Mean over all pixels.
    pub fn mean(&self) -> Vec3 {
        let sum = self
            .pixels
            .iter()
            .fold([0.0f64; 3], |s, p| [s[0] + f64::from(p.x), s[1] + f64::from(p.y), s[2] + f64::from(p.z)]);
        let count = self.pixels.len().max(1) as f64;
        Vec3::new((sum[0] / count) as f32, (sum[1] / count) as f32, (sum[2] / count) as f32)
    }

    /// Geometric mean of the luminance of the pixels that are brighter than 10⁻⁴ of the mean luminance; 0 for a black
    /// picture.
    pub fn log_average_luminance(&self) -> f32 {
        let least = 1e-4 * luminance(self.mean());
        let mut sum = 0.0f64;
        let mut count = 0u64;
        for p in &self.pixels {
            let y = luminance(*p);
            if y > least {
                sum += f64::from(ln(y));
                count += 1;
            }
        }
        if count == 0 { 0.0 } else { double::exp(sum / count as f64) as f32 }
    }

    /// Sum of two pictures of one size.
    ///
    /// # Errors
    /// [`Error::SizeMismatch`].
    pub fn plus(&self, other: &Self) -> Result<Self, Error> {
        self.combine(other, |a, b| a + b)
    }

    /// Difference of two pictures of one size.
    ///
    /// # Errors
    /// [`Error::SizeMismatch`].
    pub fn minus(&self, other: &Self) -> Result<Self, Error> {
        self.combine(other, |a, b| a - b)
    }

    /// A picture of `f` of the pixels of two pictures of one size.
    ///
    /// # Errors
    /// [`Error::SizeMismatch`].
    pub fn combine(&self, other: &Self, f: impl Fn(Vec3, Vec3) -> Vec3) -> Result<Self, Error> {
        self.check_size(other)?;
        let pixels = self.pixels.iter().zip(&other.pixels).map(|(a, b)| f(*a, *b)).collect();
        Ok(Self { pixels, ..*self })
    }

    /// Checks that another picture has the same size.
    ///
    /// # Errors
    /// [`Error::SizeMismatch`].
    pub fn check_size(&self, other: &Self) -> Result<(), Error> {
        if (self.width, self.height) != (other.width, other.height) {
            return Err(Error::SizeMismatch {
                ours: (self.width, self.height),
                reference: (other.width, other.height),
            });
        }
        Ok(())
    }
}

/// The factor 2^`stops`.
pub fn stops_to_scale(stops: f32) -> f32 {
    crate::math::pow(2.0, stops)
}

/// The stops whose factor is `scale`: log₂.
pub fn scale_to_stops(scale: f32) -> f32 {
    double::log2(f64::from(scale)) as f32
}
