//! Pictures of linear radiance, in memory and in EXR, HDR and PNG files.

use std::fs;
use std::io::{Cursor, Write};
use std::path::Path;

use exr::prelude::{Encoding, IntoSample, LineOrder, SpecificChannels, Vec2 as Position, WritableImage, f16};
use glam::Vec3;
use image::{ColorType, ImageFormat};
use rayon::prelude::*;
use scene::kernel::shade::{decode_srgb, encode_srgb};
use scene::math::{clamp, ln, luminance};

use crate::error::Error;
use crate::file::write_whole;

/// Linear Rec.709 RGB, row by row from the top: radiance in W/m²/sr unless said otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width · height` values.
    pub pixels: Vec<Vec3>,
}

/// How numbers are stored in an EXR file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 16 bits: 11 bits of mantissa, at most 65504 (greater values are clamped).
    Half,
    /// 32 bits.
    Single,
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

    /// Reads EXR or HDR as they are, and PNG (and what else `image` knows of 8 and 16 bits) decoded from sRGB. An alpha
    /// channel is ignored.
    ///
    /// # Errors
    /// [`Error::Read`] or [`Error::Decode`] with the path.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let bytes = fs::read(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
        let failed = |reason: String| Error::Decode { path: path.to_path_buf(), reason };
        let reader = image::ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
        let decoded = reader.decode().map_err(|e| failed(e.to_string()))?;
        let linear = matches!(decoded.color(), ColorType::Rgb32F | ColorType::Rgba32F);
        let (width, height) = (decoded.width(), decoded.height());
        let mut pixels: Vec<Vec3> = decoded.to_rgb32f().pixels().map(|p| Vec3::from_array(p.0)).collect();
        if !linear {
            pixels.par_iter_mut().for_each(|p| *p = p.map(decode_srgb));
        }
        Self::from_pixels(width, height, pixels).map_err(|e| failed(e.to_string()))
    }

    /// Writes the linear values as an EXR file with the channels R, G, B: equal pictures give equal bytes.
    ///
    /// # Errors
    /// [`Error::Write`] or [`Error::Encode`] with the path.
    pub fn write_exr(&self, path: &Path, precision: Precision) -> Result<(), Error> {
        let half = |x: f32| f16::from_f32(x.clamp(-65_504.0, 65_504.0));
        match precision {
            Precision::Single => self.write_exr_as(path, |x| x),
            Precision::Half => self.write_exr_as(path, half),
        }
    }

    fn write_exr_as<S: IntoSample>(&self, path: &Path, convert: impl Fn(f32) -> S + Sync) -> Result<(), Error> {
        let width = self.width as usize;
        let channels = SpecificChannels::rgb(|Position(x, y): Position<usize>| {
            let p = self.pixels[y * width + x];
            (convert(p.x), convert(p.y), convert(p.z))
        });
        // In any other order tiles are written as threads finish them.
        let encoding = Encoding { line_order: LineOrder::Increasing, ..Encoding::FAST_LOSSLESS };
        let size = (width, self.height as usize);
        let mut bytes = Cursor::new(Vec::new());
        exr::prelude::Image::from_encoded_channels(size, encoding, channels)
            .write()
            .to_buffered(&mut bytes)
            .map_err(|e| Error::Encode { path: path.to_path_buf(), reason: e.to_string() })?;
        write_bytes(path, bytes.get_ref())
    }

    /// Writes what a display shows: values × 2^`stops`, clamped to [0, 1], sRGB, 8 bits.
    ///
    /// # Errors
    /// [`Error::Write`] or [`Error::Encode`] with the path.
    pub fn write_png(&self, path: &Path, stops: f32) -> Result<(), Error> {
        let bytes = self.displayed_bytes(stops_to_scale(stops));
        let mut png = Cursor::new(Vec::new());
        image::write_buffer_with_format(
            &mut png,
            &bytes,
            self.width,
            self.height,
            image::ExtendedColorType::Rgb8,
            ImageFormat::Png,
        )
        .map_err(|e| Error::Encode { path: path.to_path_buf(), reason: e.to_string() })?;
        write_bytes(path, png.get_ref())
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

    /// Means over whole squares of `edge` × `edge` pixels from the upper left corner; what is left at the right and at the
    /// bottom does not count.
    pub fn block_means(&self, edge: u32) -> Self {
        let (width, height) = (self.width / edge, self.height / edge);
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
        let (mut sum, mut count) = (0.0f64, 0u64);
        for p in &self.pixels {
            let y = luminance(*p);
            if y > least {
                sum += f64::from(ln(y));
                count += 1;
            }
        }
        if count == 0 { 0.0 } else { (sum / count as f64).exp() as f32 }
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

    pub(crate) fn combine(&self, other: &Self, f: impl Fn(Vec3, Vec3) -> Vec3) -> Result<Self, Error> {
        self.check_size(other)?;
        let pixels = self.pixels.iter().zip(&other.pixels).map(|(a, b)| f(*a, *b)).collect();
        Ok(Self { pixels, ..*self })
    }

    pub(crate) fn check_size(&self, other: &Self) -> Result<(), Error> {
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
    scene::math::pow(2.0, stops)
}

/// The stops whose factor is `scale`: log₂.
pub fn scale_to_stops(scale: f32) -> f32 {
    f64::from(scale).log2() as f32
}

fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    write_whole(path, |file| file.write_all(bytes).map_err(|source| Error::Write { path: path.to_path_buf(), source }))
}
