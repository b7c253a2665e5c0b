//! Errors of a picture, or of irradiance at points, against a reference.
//!
//! Linear metrics look at means over blocks of 8 × 8 pixels, because references carry noise in single pixels;
//! tone-mapped metrics (MSE, PSNR, SSIM, FLIP) look at what a display shows: value × scale, clamped, sRGB. [`faults`]
//! and [`edges`] count the pixels that a person finds wrong.

use glam::Vec3;
use nv_flip::{DEFAULT_PIXELS_PER_DEGREE, FlipImageFloat, FlipImageRgb8};
use rayon::prelude::*;
use scene::kernel::shade::decode_srgb;
use scene::math::luminance;
use serde::{Deserialize, Serialize};

use crate::error::Error;
use crate::picture::Picture;

pub mod edges;
pub mod faults;

pub use edges::Edges;
pub use faults::{Faults, Judge, ReferenceNoise, noise_picture, noise_share};

/// Edge of the blocks that linear metrics average over, pixels.
pub const BLOCK_EDGE: u32 = 8;
/// Edge of the window of [`PictureErrors::ssim`], pixels.
pub const SSIM_WINDOW: usize = 11;
/// Standard deviation of the window's Gaussian, pixels.
const SSIM_SIGMA: f64 = 1.5;
/// Blocks of the reference below this share of its mean are left out of relative errors.
const DARK_BLOCK: f64 = 1e-4;
/// Relative errors at points are taken relative to at least this share of the mean.
const DARK_POINT: f64 = 0.05;

/// Errors of a picture. Equal pictures have an infinite PSNR, which is left out of JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PictureErrors {
    /// Mean squared difference of the displayed values (0 to 1) over pixels and channels.
    pub mse: f64,
    /// `−10 log₁₀ mse`, dB.
    #[serde(skip_serializing_if = "is_infinite", default = "infinity")]
    pub psnr_db: f64,
    /// Structural similarity of the displayed luma, Gaussian window 11 × 11 with σ = 1.5 (Wang et al. 2004), mean over
    /// the windows that lie inside the picture; 1 for equal pictures.
    pub ssim: f64,
    /// Mean of the FLIP map (Andersson et al. 2020) at 67 pixels a degree; 0 for equal pictures, 1 at worst.
    pub flip: f64,
    /// Median of |ours / reference − 1| over the luminance of 8 × 8 block means. Beside a black reference, whose truth
    /// is 0: median of ours × scale, in display whites.
    pub block_median_relative_error: f64,
    /// PSNR of the displayed 8 × 8 block means, dB.
    #[serde(skip_serializing_if = "is_infinite", default = "infinity")]
    pub block_psnr_db: f64,
    /// Mean luminance of ours over that of the reference; beside a black one, 1 + ours × scale.
    pub mean_ratio: f64,
}

/// Errors of irradiance at points, on luminance: |ours − reference| / max(reference, 0.05 · mean reference).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointErrors {
    /// Median.
    pub median_relative_error: f64,
    /// 95th percentile.
    pub p95_relative_error: f64,
    /// Mean of ours over mean of the reference.
    pub mean_ratio: f64,
}

fn is_infinite(x: &f64) -> bool {
    x.is_infinite()
}

fn infinity() -> f64 {
    f64::INFINITY
}

/// The scale at which pictures of indirect light are compared: 0.18 / log-average luminance of the reference, 1 for a
/// black one.
pub fn indirect_scale(reference_indirect: &Picture) -> f32 {
    let average = reference_indirect.log_average_luminance();
    if average > 0.0 { 0.18 / average } else { 1.0 }
}

/// All errors of a picture. `scale` is the exposure of the tone-mapped ones: `stops_to_scale` of the scene's stops for
/// pictures of all light, [`indirect_scale`] for indirect light. Pixels whose `mask` is false are left out, and so are
/// the 8 × 8 blocks that hold such a pixel and the SSIM windows centred on one.
///
/// # Errors
/// The pictures differ in size, are smaller than 11 × 11 or hold numbers that are not finite; the mask has another
/// length, or leaves nothing.
pub fn compare_pictures(
    ours: &Picture,
    reference: &Picture,
    scale: f32,
    mask: Option<&[bool]>,
) -> Result<PictureErrors, Error> {
    check(ours, reference, mask)?;
    let inside = |k: usize| mask.is_none_or(|m| m[k]);

    let blocks_ours = ours.block_means(BLOCK_EDGE);
    let blocks_reference = reference.block_means(BLOCK_EDGE);
    let blocks: Vec<usize> =
        (0..blocks_ours.pixels.len()).filter(|k| mask.is_none_or(|m| is_whole_block(m, ours.width, *k))).collect();
    if blocks.is_empty() {
        return Err(Error::Nothing { reason: "the mask leaves no whole block of 8 x 8 pixels" });
    }
    let block_median_relative_error = block_median(&blocks_ours, &blocks_reference, &blocks, scale);

    let mut sum_ours = 0.0;
    let mut sum_reference = 0.0;
    let mut count = 0u64;
    for k in (0..ours.pixels.len()).filter(|k| inside(*k)) {
        sum_ours += f64::from(luminance(ours.pixels[k]));
        sum_reference += f64::from(luminance(reference.pixels[k]));
        count += 1;
    }
    let mean_ratio = match sum_reference > 0.0 {
        true => sum_ours / sum_reference,
        false => 1.0 + f64::from(scale) * sum_ours / count.max(1) as f64,
    };

    let shown_ours = ours.displayed(scale);
    let shown_reference = reference.displayed(scale);
    let mse = mean_squared(&shown_ours, &shown_reference, (0..ours.pixels.len()).filter(|k| inside(*k)));
    let block_mse =
        mean_squared(&blocks_ours.displayed(scale), &blocks_reference.displayed(scale), blocks.iter().copied());
    let flip = flip_values(ours, reference, scale).to_vec();
    let (flip_sum, flip_count) = (flip.iter().enumerate())
        .filter(|(k, _)| inside(*k))
        .fold((0.0, 0u64), |(sum, count), (_, value)| (sum + f64::from(*value), count + 1));
    Ok(PictureErrors {
        mse,
        psnr_db: psnr(mse),
        ssim: ssim(&shown_ours, &shown_reference, mask)?,
        flip: flip_sum / flip_count as f64,
        block_median_relative_error,
        block_psnr_db: psnr(block_mse),
        mean_ratio,
    })
}

/// Relative errors of the luminance of irradiance at points, |ours − reference| / max(reference, 0.05 · mean
/// reference), one a point.
///
/// # Errors
/// [`Error::Count`] when the lengths differ, [`Error::Nothing`] without light in the reference,
/// [`Error::NotFinite`].
pub fn point_errors(ours: &[Vec3], reference: &[Vec3]) -> Result<Vec<f64>, Error> {
    if ours.len() != reference.len() {
        return Err(Error::Count { of: "reference points", expected: reference.len(), found: ours.len() });
    }
    check_finite("first", ours)?;
    check_finite("reference", reference)?;
    let sum = total(reference);
    if sum <= 0.0 {
        return Err(Error::Nothing { reason: "no reference point receives any light" });
    }
    let least = DARK_POINT * sum / reference.len() as f64;
    let error = |(o, r): (&Vec3, &Vec3)| {
        let o = f64::from(luminance(*o));
        let r = f64::from(luminance(*r));
        (o - r).abs() / r.max(least)
    };
    Ok(ours.iter().zip(reference).map(error).collect())
}

fn total(values: &[Vec3]) -> f64 {
    values.iter().map(|v| f64::from(luminance(*v))).sum()
}

/// Errors of the luminance of irradiance at points: [`point_errors`] summed up.
///
/// # Errors
/// As [`point_errors`].
pub fn compare_points(ours: &[Vec3], reference: &[Vec3]) -> Result<PointErrors, Error> {
    let mut errors = point_errors(ours, reference)?;
    Ok(PointErrors {
        median_relative_error: quantile(&mut errors, 0.5),
        p95_relative_error: quantile(&mut errors, 0.95),
        mean_ratio: total(ours) / total(reference),
    })
}

/// The absolute difference of each channel, times `gain`: black where equal. Figure 6.3 of the thesis has a gain of 25.
///
/// # Errors
/// [`scene::Error::SizeMismatch`].
pub fn absolute_difference_picture(ours: &Picture, reference: &Picture, gain: f32) -> Result<Picture, Error> {
    Ok(ours.combine(reference, |o, r| (o - r).abs() * gain)?)
}

/// The difference as a picture: (ours − reference) / max(reference, 0.05 · mean reference) on luminance; white where
/// equal, red where ours is brighter, blue where it is darker, full colour at ± `range`. To be shown without exposure.
///
/// # Errors
/// [`scene::Error::SizeMismatch`].
pub fn difference_picture(ours: &Picture, reference: &Picture, range: f32) -> Result<Picture, Error> {
    let least = (DARK_POINT as f32 * luminance(reference.mean())).max(f32::MIN_POSITIVE);
    let picture = ours.combine(reference, |o, r| {
        let o = luminance(o);
        let r = luminance(r);
        let x = ((o - r) / r.max(least) / range).clamp(-1.0, 1.0);
        let rest = 1.0 - x.abs();
        if x > 0.0 { Vec3::new(1.0, rest, rest) } else { Vec3::new(rest, rest, 1.0) }
    })?;
    Ok(picture)
}

/// The FLIP map in the magma colours of its authors: black where equal, bright yellow at worst. To be shown without
/// exposure.
///
/// # Errors
/// [`scene::Error::SizeMismatch`].
pub fn flip_picture(ours: &Picture, reference: &Picture, scale: f32) -> Result<Picture, Error> {
    ours.check_size(reference)?;
    let colours = flip_values(ours, reference, scale).apply_color_lut(&nv_flip::magma_lut()).to_vec();
    let linear = |code: &u8| decode_srgb(f32::from(*code) / 255.0);
    let pixels = colours.chunks_exact(3).map(|c| Vec3::new(linear(&c[0]), linear(&c[1]), linear(&c[2]))).collect();
    Ok(Picture::from_pixels(ours.width, ours.height, pixels)?)
}

/// Value below which the share `q` of the values lies, linear between neighbours; sorts them. 0 without values.
pub fn quantile(values: &mut [f64], q: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let Some(last) = values.len().checked_sub(1) else { return 0.0 };
    let position = q * last as f64;
    let low = (position as usize).min(last);
    let high = (low + 1).min(last);
    values[low] + (values[high] - values[low]) * (position - low as f64)
}

fn check(ours: &Picture, reference: &Picture, mask: Option<&[bool]>) -> Result<(), Error> {
    ours.check_size(reference)?;
    let least = SSIM_WINDOW as u32;
    if ours.width < least || ours.height < least {
        return Err(Error::TooSmall { width: ours.width, height: ours.height, least });
    }
    if let Some(mask) = mask
        && mask.len() != ours.pixels.len()
    {
        return Err(Error::MaskLength { expected: ours.pixels.len(), found: mask.len() });
    }
    check_finite("first", &ours.pixels)?;
    check_finite("reference", &reference.pixels)
}

fn check_finite(which: &'static str, values: &[Vec3]) -> Result<(), Error> {
    match values.iter().position(|p| !p.is_finite()) {
        Some(pixel) => Err(Error::NotFinite { which, pixel }),
        None => Ok(()),
    }
}

fn is_whole_block(mask: &[bool], width: u32, block: usize) -> bool {
    let columns = (width / BLOCK_EDGE) as usize;
    let edge = BLOCK_EDGE as usize;
    let width = width as usize;
    let x = block % columns * edge;
    let y = block / columns * edge;
    (y..y + edge).all(|row| mask[row * width + x..row * width + x + edge].iter().all(|m| *m))
}

/// As [`PictureErrors::block_median_relative_error`].
fn block_median(ours: &Picture, reference: &Picture, blocks: &[usize], scale: f32) -> f64 {
    let of = |p: &Picture, k: usize| f64::from(luminance(p.pixels[k]));
    let mean = blocks.iter().map(|k| of(reference, *k)).sum::<f64>() / blocks.len() as f64;
    let bright = blocks.iter().filter(|k| of(reference, **k) > DARK_BLOCK * mean);
    let mut errors: Vec<f64> = bright.map(|k| (of(ours, *k) / of(reference, *k) - 1.0).abs()).collect();
    if errors.is_empty() {
        errors = blocks.iter().map(|k| f64::from(scale) * of(ours, *k).abs()).collect();
    }
    quantile(&mut errors, 0.5)
}

fn mean_squared(a: &Picture, b: &Picture, pixels: impl Iterator<Item = usize>) -> f64 {
    let mut sum = 0.0;
    let mut count = 0u64;
    for k in pixels {
        sum += f64::from((a.pixels[k] - b.pixels[k]).length_squared());
        count += 3;
    }
    sum / count as f64
}

/// Peak signal-to-noise ratio for a peak of 1, dB.
fn psnr(mse: f64) -> f64 {
    -10.0 * mse.log10()
}

fn flip_values(ours: &Picture, reference: &Picture, scale: f32) -> FlipImageFloat {
    let image = |p: &Picture| FlipImageRgb8::with_data(p.width, p.height, &p.displayed_bytes(scale));
    nv_flip::flip(image(reference), image(ours), DEFAULT_PIXELS_PER_DEGREE)
}

/// Mean structural similarity of two displayed pictures.
fn ssim(a: &Picture, b: &Picture, mask: Option<&[bool]>) -> Result<f64, Error> {
    let width = a.width as usize;
    let height = a.height as usize;
    let luma = |p: &Picture| p.pixels.iter().map(|v| f64::from(luminance(*v))).collect::<Vec<_>>();
    let x = luma(a);
    let y = luma(b);
    let product = |p: &[f64], q: &[f64]| p.iter().zip(q).map(|(p, q)| p * q).collect::<Vec<_>>();
    let filtered = |values: &[f64]| filter_gaussian(values, width);
    let mx = filtered(&x);
    let my = filtered(&y);
    let xx = filtered(&product(&x, &x));
    let yy = filtered(&product(&y, &y));
    let xy = filtered(&product(&x, &y));
    let c1 = 0.01f64.powi(2);
    let c2 = 0.03f64.powi(2);
    let columns = width - SSIM_WINDOW + 1;
    let half = SSIM_WINDOW / 2;
    debug_assert_eq!(mx.len(), columns * (height - SSIM_WINDOW + 1));
    let mut sum = 0.0;
    let mut count = 0u64;
    for k in 0..mx.len() {
        let centre = (k / columns + half) * width + k % columns + half;
        if mask.is_some_and(|m| !m[centre]) {
            continue;
        }
        let vx = xx[k] - mx[k] * mx[k];
        let vy = yy[k] - my[k] * my[k];
        let cov = xy[k] - mx[k] * my[k];
        sum += (2.0 * mx[k] * my[k] + c1) * (2.0 * cov + c2) / ((mx[k] * mx[k] + my[k] * my[k] + c1) * (vx + vy + c2));
        count += 1;
    }
    if count == 0 {
        return Err(Error::Nothing { reason: "the mask leaves no window of 11 x 11 pixels" });
    }
    Ok(sum / count as f64)
}

/// Separable Gaussian over the windows that lie inside the picture: smaller by 10 in width and height.
fn filter_gaussian(values: &[f64], width: usize) -> Vec<f64> {
    let mut weights = [0.0f64; SSIM_WINDOW];
    for (k, w) in weights.iter_mut().enumerate() {
        let d = k as f64 - (SSIM_WINDOW / 2) as f64;
        *w = (-d * d / (2.0 * SSIM_SIGMA * SSIM_SIGMA)).exp();
    }
    let total: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= total);

    let columns = width - SSIM_WINDOW + 1;
    let rows: Vec<f64> = values
        .par_chunks_exact(width)
        .flat_map_iter(|row| row.windows(SSIM_WINDOW).map(|w| w.iter().zip(&weights).map(|(v, g)| v * g).sum::<f64>()))
        .collect();
    let height = values.len() / width - SSIM_WINDOW + 1;
    (0..height * columns)
        .into_par_iter()
        .map(|k| weights.iter().enumerate().map(|(j, g)| rows[k + j * columns] * g).sum::<f64>())
        .collect()
}
