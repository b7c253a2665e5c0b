//! Sums of radiance that can be saved, continued and judged.

use std::io::Write;
use std::path::Path;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use scene::math::luminance;
use scene::{Camera, Scene};
use sha2::{Digest, Sha256};

use crate::error::{Error, ResumeError};
use crate::file::write_whole;
use crate::metrics::{BLOCK_EDGE, quantile};
use crate::path::PathSettings;
use crate::picture::Picture;

/// Samples whose mean is one observation of the variance estimate.
pub const PASS_SAMPLES: u32 = 8;

const MAGIC: &[u8; 8] = b"PLPATHS\n";
const VERSION: u32 = 1;
const HEADER: usize = 8 + 7 * 4 + 32;
const CHECKSUM: usize = 32;

/// Kept sums of a pixel.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct PixelSums {
    direct: Vec3,
    indirect: Vec3,
    /// Luminance sums (full, indirect) of the pass under way.
    pending: [f32; 2],
    /// Sums of squares of the passes' mean luminance (full, indirect).
    squares: [f32; 2],
}
const _: () = assert!(size_of::<PixelSums>() == 40);

impl PixelSums {
    /// Adds sample `index`. Samples are added one by one and in order, so that any split of the work gives the same
    /// bits.
    #[inline]
    pub(crate) fn add(&mut self, index: u32, direct: Vec3, indirect: Vec3) {
        self.direct += direct;
        self.indirect += indirect;
        self.pending[0] += luminance(direct) + luminance(indirect);
        self.pending[1] += luminance(indirect);
        if (index + 1).is_multiple_of(PASS_SAMPLES) {
            for (square, pending) in self.squares.iter_mut().zip(&mut self.pending) {
                let mean = *pending * (1.0 / PASS_SAMPLES as f32);
                *square += mean * mean;
                *pending = 0.0;
            }
        }
    }

    /// Variance of the mean luminance (of full or indirect light) after `passes` whole passes.
    fn variance(&self, part: usize, passes: u32) -> f64 {
        let sum = luminance(self.indirect) + if part == 0 { luminance(self.direct) } else { 0.0 };
        let n = f64::from(passes);
        let mean = f64::from(sum - self.pending[part]) / (n * f64::from(PASS_SAMPLES));
        ((f64::from(self.squares[part]) / n - mean * mean) / (n - 1.0)).max(0.0)
    }
}

/// Relative standard errors of the luminance of 8 × 8 block means, estimated from the spread of passes of
/// [`PASS_SAMPLES`] samples; blocks below 10⁻³ of the picture's mean are left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockErrors {
    /// Median.
    pub median: f64,
    /// 90th percentile.
    pub p90: f64,
    /// Greatest.
    pub max: f64,
}

/// A picture under way: sums of direct and indirect radiance of all samples so far.
#[derive(Clone, Debug, PartialEq)]
pub struct Accumulation {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) samples: u32,
    pub(crate) settings: PathSettings,
    pub(crate) pixels: Vec<PixelSums>,
}

impl Accumulation {
    /// Nothing yet, for the picture of `camera`.
    pub fn new(camera: &Camera, settings: PathSettings) -> Self {
        let width = camera.width;
        let height = camera.height;
        let pixels = vec![PixelSums::default(); width as usize * height as usize];
        Self { width, height, samples: 0, settings, pixels }
    }

    /// Samples a pixel so far.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// The settings that all samples share.
    pub fn settings(&self) -> PathSettings {
        self.settings
    }

    /// Radiance to the eye, W/m²/sr: direct + indirect. Black before the first sample.
    pub fn full(&self) -> Picture {
        self.picture(|p| p.direct + p.indirect)
    }

    /// Lights and sky seen directly, and light that reached the visible surface straight from a light, W/m²/sr.
    pub fn direct(&self) -> Picture {
        self.picture(|p| p.direct)
    }

    /// The rest, W/m²/sr.
    pub fn indirect(&self) -> Picture {
        self.picture(|p| p.indirect)
    }

    fn picture(&self, sum: impl Fn(&PixelSums) -> Vec3) -> Picture {
        let scale = 1.0 / self.samples.max(1) as f32;
        let pixels = self.pixels.iter().map(|p| sum(p) * scale).collect();
        Picture { width: self.width, height: self.height, pixels }
    }

    /// Standard error of the luminance of each pixel of [`Accumulation::full`], from the spread of passes of
    /// [`PASS_SAMPLES`] samples, as a grey picture, W/m²/sr; `None` before two whole passes.
    pub fn full_standard_error(&self) -> Option<Picture> {
        self.standard_error(0)
    }

    /// Standard error of [`Accumulation::indirect`].
    pub fn indirect_standard_error(&self) -> Option<Picture> {
        self.standard_error(1)
    }

    fn standard_error(&self, part: usize) -> Option<Picture> {
        let passes = self.samples / PASS_SAMPLES;
        if passes < 2 {
            return None;
        }
        let error = |p: &PixelSums| Vec3::splat(p.variance(part, passes).sqrt() as f32);
        Some(Picture { width: self.width, height: self.height, pixels: self.pixels.iter().map(error).collect() })
    }

    /// Standard errors of [`Accumulation::full`]; `None` before two whole passes or without a bright block.
    pub fn full_errors(&self) -> Option<BlockErrors> {
        self.block_errors(0, &self.full())
    }

    /// Standard errors of [`Accumulation::indirect`]; `None` before two whole passes or without a bright block.
    pub fn indirect_errors(&self) -> Option<BlockErrors> {
        self.block_errors(1, &self.indirect())
    }

    fn block_errors(&self, part: usize, picture: &Picture) -> Option<BlockErrors> {
        let passes = self.samples / PASS_SAMPLES;
        if passes < 2 {
            return None;
        }
        let means = picture.block_means(BLOCK_EDGE);
        let least = 1e-3 * luminance(means.mean());
        let mut errors = Vec::new();
        for (k, mean) in means.pixels.iter().enumerate() {
            let mean = luminance(*mean);
            if mean <= least {
                continue;
            }
            let x = k as u32 % means.width * BLOCK_EDGE;
            let y = k as u32 / means.width * BLOCK_EDGE;
            let mut variance = 0.0;
            for row in y..y + BLOCK_EDGE {
                let first = (row * self.width + x) as usize;
                let pixels = &self.pixels[first..first + BLOCK_EDGE as usize];
                variance += pixels.iter().map(|p| p.variance(part, passes)).sum::<f64>();
            }
            errors.push(variance.sqrt() / f64::from(BLOCK_EDGE * BLOCK_EDGE) / f64::from(mean));
        }
        if errors.is_empty() {
            return None;
        }
        let median = quantile(&mut errors, 0.5);
        let p90 = quantile(&mut errors, 0.9);
        Some(BlockErrors { median, p90, max: quantile(&mut errors, 1.0) })
    }

    /// Saves everything needed to continue, with a checksum, whole or not at all. `fingerprint` is that of the scene
    /// and camera: [`fingerprint`].
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn save(&self, path: &Path, fingerprint: &[u8; 32]) -> Result<(), Error> {
        let mut bytes = Vec::with_capacity(HEADER + self.pixels.len() * size_of::<PixelSums>() + CHECKSUM);
        bytes.extend(MAGIC);
        let s = self.settings;
        for word in [VERSION, self.width, self.height, self.samples, s.seed, s.bounces, s.code()] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(fingerprint);
        for value in bytemuck::cast_slice::<PixelSums, f32>(&self.pixels) {
            bytes.extend(value.to_le_bytes());
        }
        let checksum = Sha256::digest(&bytes);
        bytes.extend(checksum);
        write_whole(path, |file| {
            file.write_all(&bytes).map_err(|source| Error::Write { path: path.to_path_buf(), source })
        })
    }

    /// Reads a saved accumulation for the same scene, camera and settings; adding samples then gives the same bits as
    /// if it had never stopped.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Resume`] with the reason.
    pub fn load(path: &Path, camera: &Camera, settings: PathSettings, fingerprint: &[u8; 32]) -> Result<Self, Error> {
        let bytes =
            scene::host::read_regular(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
        Self::decode(&bytes, camera, settings, fingerprint)
            .map_err(|reason| Error::Resume { path: path.to_path_buf(), reason })
    }

    fn decode(
        bytes: &[u8],
        camera: &Camera,
        settings: PathSettings,
        fingerprint: &[u8; 32],
    ) -> Result<Self, ResumeError> {
        if !bytes.starts_with(MAGIC) {
            return Err(ResumeError::Magic);
        }
        let truncated = ResumeError::Length { expected: (HEADER + CHECKSUM) as u64, found: bytes.len() as u64 };
        let word = |k: usize| -> Result<u32, ResumeError> {
            let start = MAGIC.len() + 4 * k;
            let word = bytes.get(start..start + 4).and_then(|b| b.try_into().ok()).ok_or(truncated.clone())?;
            Ok(u32::from_le_bytes(word))
        };
        let version = word(0)?;
        if version != VERSION {
            return Err(ResumeError::Version { found: version, supported: VERSION });
        }
        let width = word(1)?;
        let height = word(2)?;
        let samples = word(3)?;
        let content = u64::from(width) * u64::from(height) * size_of::<PixelSums>() as u64;
        let expected = (HEADER + CHECKSUM) as u64 + content;
        if bytes.len() as u64 != expected {
            return Err(ResumeError::Length { expected, found: bytes.len() as u64 });
        }
        let (body, checksum) = bytes.split_at(bytes.len() - CHECKSUM);
        if Sha256::digest(body).as_slice() != checksum {
            return Err(ResumeError::Checksum);
        }
        if body[HEADER - 32..HEADER] != *fingerprint || (width, height) != (camera.width, camera.height) {
            return Err(ResumeError::Scene);
        }
        if [word(4)?, word(5)?, word(6)?] != [settings.seed, settings.bounces, settings.code()] {
            return Err(ResumeError::Settings);
        }
        let mut pixels = vec![PixelSums::default(); width as usize * height as usize];
        let values = bytemuck::cast_slice_mut::<PixelSums, f32>(&mut pixels);
        for (value, b) in values.iter_mut().zip(body[HEADER..].chunks_exact(4)) {
            *value = f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        }
        Ok(Self { width, height, samples, settings, pixels })
    }
}

/// SHA-256 of everything that a picture depends on: geometry, materials, textures, lights, sky and camera.
pub fn fingerprint(scene: &Scene, camera: &Camera) -> [u8; 32] {
    let mut hash = Sha256::new();
    let tables: [&[u8]; 10] = [
        bytemuck::cast_slice(&scene.geometry.triangles),
        bytemuck::cast_slice(&scene.geometry.uvs),
        bytemuck::cast_slice(&scene.materials),
        bytemuck::cast_slice(&scene.geometry.textures),
        bytemuck::cast_slice(&scene.geometry.texels),
        bytemuck::cast_slice(&scene.lighting.lights),
        bytemuck::bytes_of(&scene.lighting.sky),
        bytemuck::cast_slice(&scene.lighting.sky_map),
        bytemuck::bytes_of(camera),
        bytemuck::bytes_of(&scene.geometry.ray_offset),
    ];
    // Scenes without luminaires keep the fingerprint that they had before there were any.
    let distributions = Some(bytemuck::cast_slice(&scene.lighting.distributions)).filter(|table| !table.is_empty());
    for table in tables.into_iter().chain(distributions) {
        hash.update((table.len() as u64).to_le_bytes());
        hash.update(table);
    }
    hash.finalize().into()
}
