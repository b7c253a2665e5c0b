//! Pictures of linear radiance in memory.

use alloc::vec;
use alloc::vec::Vec;

use crate::parallel::*;
use glam::Vec3;

use crate::double;
use crate::error::Error;
use crate::gpu::{TONE_AGX, TONE_NEUTRAL, TONE_NONE};
use crate::kernel::shade::encode_srgb;
use crate::kernel::tone::{displayed, toned};
use crate::math::{clamp, ln, luminance};

/// Luminance that automatic exposure gives to the geometric mean of a picture: middle grey.
const MIDDLE_GREY: f32 = 0.18;
/// Consecutive pixels whose mean luminance counts as one in automatic exposure: noise and small lights do not pull it.
pub const METERED_PIXELS: u32 = 256;

/// Curve from exposed radiance to what a display shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Tone {
    /// What is brighter than white is cut off.
    #[default]
    None,
    /// AgX: film of 16.5 stops in which bright colours fade to white.
    Agx,
    /// Khronos PBR Neutral: colours stay up to 0.8, and near white above.
    Neutral,
}

impl Tone {
    /// All curves.
    pub const ALL: [Self; 3] = [Self::None, Self::Agx, Self::Neutral];

    /// Its name in options and scripts.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Agx => "agx",
            Self::Neutral => "neutral",
        }
    }

    /// Its number in kernels.
    pub fn code(self) -> u32 {
        match self {
            Self::None => TONE_NONE,
            Self::Agx => TONE_AGX,
            Self::Neutral => TONE_NEUTRAL,
        }
    }
}

/// Reflection of surfaces in pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Materials {
    /// Diffuse, but for mirrors and glass: what light between surfaces is computed with, and what pictures are compared
    /// with.
    #[default]
    Diffuse = 0,
    /// As glTF 2.0 has it: what is seen straight, and by way of mirrors, has normal maps and rough specular lobes
    /// ([`crate::gpu::Finish`]). Light between surfaces stays as it is.
    Gltf = 1,
}

/// Way from radiance to the colours of a display.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DisplayTransform {
    /// Exposure: radiance is multiplied by 2 to this power.
    pub stops: f32,
    /// Curve from there to what a display shows.
    pub tone: Tone,
}

impl DisplayTransform {
    /// Exposure alone: what is brighter than white is cut off.
    pub fn clipped(stops: f32) -> Self {
        Self { stops, tone: Tone::None }
    }

    /// Linear colour in [0, 1] that a display shows for a radiance.
    pub fn color(&self, radiance: Vec3) -> Vec3 {
        toned(radiance * stops_to_scale(self.stops), self.tone.code())
    }
}

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

    /// What a display shows in 8 bits a channel, r g b r g b …
    pub fn shown_bytes(&self, transform: &DisplayTransform) -> Vec<u8> {
        let scale = stops_to_scale(transform.stops);
        let tone = transform.tone.code();
        let shown = |p: &Vec3| displayed(p.extend(0.0), scale, tone).to_le_bytes();
        self.pixels.par_iter().flat_map_iter(|p| shown(p).into_iter().take(3)).collect()
    }

    /// Exposure, stops, that makes the picture neither dark nor bright; 0 for a black picture.
    pub fn automatic_stops(&self) -> f32 {
        let means = self.pixels.chunks(METERED_PIXELS as usize);
        let means = means.map(|own| own.iter().map(|p| luminance(*p)).sum::<f32>() / own.len() as f32);
        automatic_stops(&means.collect::<Vec<_>>())
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
        log_average(self.pixels.iter().map(|p| luminance(*p)), luminance(self.mean()))
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

/// Geometric mean of the values that are above 10⁻⁴ of the mean; 0 if none is.
fn log_average(values: impl Iterator<Item = f32>, mean: f32) -> f32 {
    let mut sum = 0.0f64;
    let mut count = 0u64;
    for y in values.filter(|y| *y > 1e-4 * mean) {
        sum += f64::from(ln(y));
        count += 1;
    }
    if count == 0 { 0.0 } else { double::exp(sum / count as f64) as f32 }
}

/// Exposure, stops, that makes the geometric mean of luminances middle grey; 0 where all are 0 or one is no number.
pub fn automatic_stops(luminances: &[f32]) -> f32 {
    let mean = luminances.iter().sum::<f32>() / luminances.len().max(1) as f32;
    let average = log_average(luminances.iter().copied(), mean);
    if average > 0.0 && average.is_finite() { scale_to_stops(MIDDLE_GREY / average) } else { 0.0 }
}

/// The factor 2^`stops`.
pub fn stops_to_scale(stops: f32) -> f32 {
    crate::math::pow(2.0, stops)
}

/// The stops whose factor is `scale`: log₂.
pub fn scale_to_stops(scale: f32) -> f32 {
    double::log2(f64::from(scale)) as f32
}
