//! Pictures of linear radiance in EXR, HDR and PNG files.

use std::io::{Cursor, Write};
use std::path::Path;

use exr::prelude::{Encoding, IntoSample, LineOrder, SpecificChannels, Vec2 as Position, WritableImage, f16};
use glam::Vec3;
use image::codecs::png::PngEncoder;
use image::{ColorType, ExtendedColorType, ImageEncoder as _};
use rayon::prelude::*;
use scene::kernel::shade::decode_srgb;

use crate::error::Error;
use crate::file::write_whole;

pub use scene::{DisplayTransform, Picture, Tone, scale_to_stops, stops_to_scale};

/// Precision of numbers in an EXR file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 16 bits: 11 bits of mantissa, at most 65504 (greater values are clamped).
    Half,
    /// 32 bits.
    Single,
}

/// Pictures as files.
pub trait PictureFile: Sized {
    /// Reads EXR or HDR as they are, and PNG (and what else `image` knows of 8 and 16 bits) decoded from sRGB. An alpha
    /// channel is ignored.
    ///
    /// # Errors
    /// [`Error::Read`] or [`Error::Decode`] with the path.
    fn read(path: &Path) -> Result<Self, Error>;

    /// Writes the linear values as an EXR file with the channels R, G, B: equal pictures give equal bytes.
    ///
    /// # Errors
    /// [`Error::Write`] or [`Error::Encode`] with the path.
    fn write_exr(&self, path: &Path, precision: Precision) -> Result<(), Error>;

    /// Writes values × 2^`stops`, clamped to [0, 1], sRGB, 8 bits.
    ///
    /// # Errors
    /// [`Error::Write`] or [`Error::Encode`] with the path.
    fn write_png(&self, path: &Path, stops: f32) -> Result<(), Error> {
        self.write_shown(path, &DisplayTransform::clipped(stops))
    }

    /// Writes what a display shows: exposure, tone curve, sRGB, 8 bits.
    ///
    /// # Errors
    /// [`Error::Write`] or [`Error::Encode`] with the path.
    fn write_shown(&self, path: &Path, transform: &DisplayTransform) -> Result<(), Error>;
}

impl PictureFile for Picture {
    fn read(path: &Path) -> Result<Self, Error> {
        let bytes =
            scene::host::read_regular(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
        let failed = |reason: String| Error::Decode { path: path.to_path_buf(), reason };
        // Compiled in `image` once, where a reader of our own would be compiled here again with every decoder.
        let decoded = image::load_from_memory(&bytes).map_err(|e| failed(e.to_string()))?;
        let linear = matches!(decoded.color(), ColorType::Rgb32F | ColorType::Rgba32F);
        let width = decoded.width();
        let height = decoded.height();
        let mut pixels: Vec<Vec3> = decoded.to_rgb32f().pixels().map(|p| Vec3::from_array(p.0)).collect();
        if !linear {
            pixels.par_iter_mut().for_each(|p| *p = p.map(decode_srgb));
        }
        Self::from_pixels(width, height, pixels).map_err(|e| failed(e.to_string()))
    }

    fn write_exr(&self, path: &Path, precision: Precision) -> Result<(), Error> {
        match precision {
            Precision::Single => write_exr_as(self, path, |x| x),
            Precision::Half => write_exr_as(self, path, |x| f16::from_f32(x.clamp(-65_504.0, 65_504.0))),
        }
    }

    fn write_shown(&self, path: &Path, transform: &DisplayTransform) -> Result<(), Error> {
        let bytes = self.shown_bytes(transform);
        let mut png = Vec::new();
        PngEncoder::new(&mut png)
            .write_image(&bytes, self.width, self.height, ExtendedColorType::Rgb8)
            .map_err(|e| Error::Encode { path: path.to_path_buf(), reason: e.to_string() })?;
        write_bytes(path, &png)
    }
}

fn write_exr_as<S: IntoSample>(picture: &Picture, path: &Path, convert: impl Fn(f32) -> S + Sync) -> Result<(), Error> {
    let width = picture.width as usize;
    let channels = SpecificChannels::rgb(|Position(x, y): Position<usize>| {
        let p = picture.pixels[y * width + x];
        (convert(p.x), convert(p.y), convert(p.z))
    });
    // In any other order tiles are written as threads finish them.
    let encoding = Encoding { line_order: LineOrder::Increasing, ..Encoding::FAST_LOSSLESS };
    let size = (width, picture.height as usize);
    let mut bytes = Cursor::new(Vec::new());
    exr::prelude::Image::from_encoded_channels(size, encoding, channels)
        .write()
        .to_buffered(&mut bytes)
        .map_err(|e| Error::Encode { path: path.to_path_buf(), reason: e.to_string() })?;
    write_bytes(path, bytes.get_ref())
}

fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    write_whole(path, |file| file.write_all(bytes).map_err(|source| Error::Write { path: path.to_path_buf(), source }))
}
