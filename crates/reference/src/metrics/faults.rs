//! Faults that a person sees and that means over blocks forgive: noise, leaks, stains and blotches, as shares of
//! pixels, and pictures that mark them.
//!
//! | fault | pixels that count |
//! |---|---|
//! | leak | brighter than the reference by more than 10 % of the picture's mean indirect light |
//! | stain | darker than the reference by more than 25 % of the reference's value |
//! | noise | displayed values of two pictures differ by more than 1/255 in some channel |
//!
//! A blotch is a relative error that stays after means over squares; its 95th percentile over all squares counts. Light
//! is luminance. Where the standard error of the reference is known, a difference of at most three of them counts as
//! none.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;
use scene::math::luminance;
use serde::{Deserialize, Serialize};

use super::{DARK_BLOCK, check_finite, quantile};
use crate::error::Error;
use crate::picture::Picture;

/// Excess over the reference that makes a leak, as a share of the mean indirect light.
pub const LEAK: f64 = 0.1;
/// Lack that makes a stain, as a share of the reference.
pub const STAIN: f64 = 0.25;
/// Standard errors of the reference up to which a difference counts as none.
pub const SURE: f64 = 3.0;
/// Difference of displayed values (0 to 1) up to which two pictures count as equal.
pub const NOISE_STEP: f32 = 1.0 / 255.0;
/// Pixels on either side that say how noisy the reference is.
const ABOUT: u32 = 3;
/// Edges of the squares over which blotches are looked for, pixels.
pub const BLOTCH_EDGES: [u32; 3] = [16, 32, 64];

/// Reference for the judgement of a picture.
#[derive(Clone, Copy, Debug)]
pub struct Judge<'a> {
    /// The reference, W/m²/sr.
    pub reference: &'a Picture,
    /// Its standard error, the same in all channels, W/m²/sr, where it is known.
    pub standard_error: Option<&'a Picture>,
    /// Mean luminance of the reference's indirect light, by which leaks are measured, W/m²/sr.
    pub mean_light: f64,
}

/// Leaks, stains and blotches of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Faults {
    /// Share of pixels that are leaks.
    pub leak_share: f64,
    /// Share of pixels that are stains.
    pub stain_share: f64,
    /// 95th percentile of the relative errors of means over 32 × 32 pixels; none of smaller pictures.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub blotch_p95: Option<f64>,
    /// 95th percentile over 16 × 16 pixels.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub blotch_16_p95: Option<f64>,
    /// 95th percentile over 64 × 64 pixels.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub blotch_64_p95: Option<f64>,
}

/// Fault of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Too bright.
    Leak,
    /// Too dark.
    Stain,
}

/// Noise of a reference, where it hides faults.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceNoise {
    /// Median over the pixels of the relative standard error.
    pub median_relative_standard_error: f64,
    /// Share of pixels where an excess that just makes a leak would not be sure.
    pub leaks_hidden_share: f64,
    /// Share of pixels where a lack that just makes a stain would not be sure.
    pub stains_hidden_share: f64,
}

impl<'a> Judge<'a> {
    /// Judge by a picture alone: nothing is known of its noise, and all its light is what leaks are measured by.
    pub fn new(reference: &'a Picture) -> Self {
        Self { reference, standard_error: None, mean_light: f64::from(luminance(reference.mean())) }
    }

    /// Excess of a pixel of so much light that makes a leak, and lack that makes a stain, without noise.
    fn bounds(&self, reference: f64) -> (f64, f64) {
        (LEAK * self.mean_light, STAIN * reference)
    }

    /// Greatest difference of each pixel that counts as none: [`SURE`] times its standard error, or the median of those
    /// of the 7 × 7 pixels about, if that is more. A pixel that a rare bright path missed has both too little light and
    /// too small a spread; its neighbours know better.
    fn doubts(&self) -> Vec<f64> {
        let Some(error) = self.standard_error else { return vec![0.0; self.reference.pixels.len()] };
        let own = |x: u32, y: u32| f64::from(luminance(error.pixels[(y * error.width + x) as usize]));
        let doubt = |k: u32| {
            let x = k % error.width;
            let y = k / error.width;
            let columns = about(x, ABOUT, error.width);
            let rows = about(y, ABOUT, error.height);
            let mut near: Vec<f64> =
                rows.flat_map(|y| columns.clone().map(move |x| (x, y))).map(|(x, y)| own(x, y)).collect();
            SURE * own(x, y).max(quantile(&mut near, 0.5))
        };
        (0..error.width * error.height).into_par_iter().map(doubt).collect()
    }

    /// [`Self::doubts`], for a picture that can be judged.
    pub(super) fn checked_doubts(&self, ours: &Picture) -> Result<Vec<f64>, Error> {
        self.check(ours, None)?;
        Ok(self.doubts())
    }

    fn check(&self, ours: &Picture, mask: Option<&[bool]>) -> Result<(), Error> {
        ours.check_size(self.reference)?;
        check_finite("first", &ours.pixels)?;
        check_finite("reference", &self.reference.pixels)?;
        if let Some(error) = self.standard_error {
            ours.check_size(error)?;
            check_finite("standard error's", &error.pixels)?;
        }
        check_mask(ours, mask)
    }

    /// Fault of each pixel of a picture, row by row.
    ///
    /// # Errors
    /// The pictures differ in size or hold numbers that are not finite.
    pub fn fault_map(&self, ours: &Picture) -> Result<Vec<Option<Fault>>, Error> {
        self.check(ours, None)?;
        let light = |picture: &Picture, k: usize| f64::from(luminance(picture.pixels[k]));
        let doubts = self.doubts();
        let fault = |k: usize| {
            let reference = light(self.reference, k);
            let excess = light(ours, k) - reference;
            let (leak, stain) = self.bounds(reference);
            let doubt = doubts[k];
            if excess > leak.max(doubt) {
                Some(Fault::Leak)
            } else if reference > 0.0 && -excess > stain.max(doubt) {
                Some(Fault::Stain)
            } else {
                None
            }
        };
        Ok((0..ours.pixels.len()).map(fault).collect())
    }

    /// Leaks, stains and blotches of a picture. Pixels whose `mask` is false are left out, and so are squares that hold
    /// one.
    ///
    /// # Errors
    /// The pictures differ in size or hold numbers that are not finite; the mask has another length or leaves nothing.
    pub fn faults(&self, ours: &Picture, mask: Option<&[bool]>) -> Result<Faults, Error> {
        self.check(ours, mask)?;
        let map = self.fault_map(ours)?;
        let counted = (0..map.len()).filter(|k| mask.is_none_or(|m| m[*k]));
        let mut leaks = 0u64;
        let mut stains = 0u64;
        let mut count = 0u64;
        for k in counted {
            leaks += u64::from(map[k] == Some(Fault::Leak));
            stains += u64::from(map[k] == Some(Fault::Stain));
            count += 1;
        }
        if count == 0 {
            return Err(Error::Nothing { reason: "the mask leaves no pixel" });
        }
        let [blotch_16_p95, blotch_p95, blotch_64_p95] = BLOTCH_EDGES.map(|edge| {
            let mut errors: Vec<f64> =
                self.square_errors(ours, edge, mask).into_iter().flatten().map(f64::abs).collect();
            (!errors.is_empty()).then(|| quantile(&mut errors, 0.95))
        });
        Ok(Faults {
            leak_share: leaks as f64 / count as f64,
            stain_share: stains as f64 / count as f64,
            blotch_p95,
            blotch_16_p95,
            blotch_64_p95,
        })
    }

    /// Noise of the reference that hides faults; none where it is not known.
    pub fn noise(&self) -> Option<ReferenceNoise> {
        self.standard_error?;
        let count = self.reference.pixels.len();
        let mut leaks = 0usize;
        let mut stains = 0usize;
        let mut relative = Vec::with_capacity(count);
        for (k, doubt) in self.doubts().into_iter().enumerate() {
            let reference = f64::from(luminance(self.reference.pixels[k]));
            let (leak, stain) = self.bounds(reference);
            leaks += usize::from(doubt > leak);
            stains += usize::from(doubt > stain);
            if reference > 0.0 {
                relative.push(doubt / SURE / reference);
            }
        }
        Some(ReferenceNoise {
            median_relative_standard_error: quantile(&mut relative, 0.5),
            leaks_hidden_share: leaks as f64 / count.max(1) as f64,
            stains_hidden_share: stains as f64 / count.max(1) as f64,
        })
    }

    /// Relative errors of the means over all squares of `edge` × `edge` pixels, by upper left corners row by row:
    /// positive where ours is brighter, 0 where the noise of the reference explains it, none where the square is dark
    /// or masked.
    fn square_errors(&self, ours: &Picture, edge: u32, mask: Option<&[bool]>) -> Vec<Option<f64>> {
        let light = |picture: &Picture| -> Vec<f64> {
            let pixels = picture.pixels.iter();
            pixels.map(|p| f64::from(luminance(*p))).collect()
        };
        let size = (ours.width, ours.height);
        let sums = |values: &[f64]| square_sums(values, size, edge);
        let own = sums(&light(ours));
        let other = sums(&light(self.reference));
        let variance = self.standard_error.map(|error| {
            let squares: Vec<f64> = light(error).iter().map(|sigma| sigma * sigma).collect();
            sums(&squares)
        });
        let left_out = mask.map(|mask| {
            let values: Vec<f64> = mask.iter().map(|inside| if *inside { 0.0 } else { 1.0 }).collect();
            sums(&values)
        });
        let area = f64::from(edge * edge);
        let least = DARK_BLOCK * f64::from(luminance(self.reference.mean())) * area;
        (0..own.len())
            .map(|k| {
                let is_left_out = left_out.as_ref().is_some_and(|sums| sums[k] > 0.5);
                if is_left_out || other[k] <= least {
                    return None;
                }
                let difference = own[k] - other[k];
                let doubt = variance.as_ref().map_or(0.0, |sums| SURE * sums[k].max(0.0).sqrt());
                Some(if difference.abs() > doubt { difference / other[k] } else { 0.0 })
            })
            .collect()
    }

    /// Our picture in grey with leaks in red and stains in blue; to be shown without exposure. `scale` is the exposure
    /// of the grey.
    ///
    /// # Errors
    /// As [`Judge::fault_map`].
    pub fn fault_picture(&self, ours: &Picture, scale: f32) -> Result<Picture, Error> {
        let colour = |fault: &Option<Fault>| {
            fault.map(|fault| match fault {
                Fault::Leak => RED,
                Fault::Stain => BLUE,
            })
        };
        Ok(marked(ours, scale, self.fault_map(ours)?.iter().map(colour)))
    }

    /// Relative errors of the means over the squares about each pixel: white where equal, red where ours is brighter,
    /// blue where it is darker, full colour at ± `range`; grey where there is no such square. To be shown without
    /// exposure.
    ///
    /// # Errors
    /// As [`Judge::faults`].
    pub fn blotch_picture(&self, ours: &Picture, edge: u32, range: f32) -> Result<Picture, Error> {
        self.check(ours, None)?;
        let errors = self.square_errors(ours, edge, None);
        let columns = squares(ours.width, edge);
        let rows = squares(ours.height, edge);
        // The square whose middle is nearest.
        let place = |at: u32, count: u32| at.saturating_sub(edge / 2).min(count.saturating_sub(1));
        let pixels = (0..ours.width * ours.height)
            .map(|k| {
                let x = place(k % ours.width, columns);
                let y = place(k / ours.width, rows);
                let Some(Some(error)) = errors.get((y * columns + x) as usize) else { return Vec3::splat(0.2) };
                let x = (*error as f32 / range).clamp(-1.0, 1.0);
                let rest = 1.0 - x.abs();
                if x > 0.0 { Vec3::new(1.0, rest, rest) } else { Vec3::new(rest, rest, 1.0) }
            })
            .collect();
        Ok(Picture::from_pixels(ours.width, ours.height, pixels)?)
    }
}

/// Colours of marks.
const RED: Vec3 = Vec3::new(1.0, 0.05, 0.0);
const BLUE: Vec3 = Vec3::new(0.0, 0.15, 1.0);
pub(super) const MAGENTA: Vec3 = Vec3::new(1.0, 0.0, 0.7);
/// Greatest value of what is not marked.
const DIMMED: f32 = 0.6;

/// Share of the pixels whose displayed values, exposed by `scale`, differ by more than 1/255 in some channel. Pixels
/// whose `mask` is false are left out.
///
/// # Errors
/// The pictures differ in size or hold numbers that are not finite; the mask has another length or leaves nothing.
pub fn noise_share(first: &Picture, second: &Picture, scale: f32, mask: Option<&[bool]>) -> Result<f64, Error> {
    let map = noise_map(first, second, scale)?;
    check_mask(first, mask)?;
    let counted = || (0..map.len()).filter(|k| mask.is_none_or(|m| m[*k]));
    match counted().count() {
        0 => Err(Error::Nothing { reason: "the mask leaves no pixel" }),
        count => Ok(counted().filter(|k| map[*k]).count() as f64 / count as f64),
    }
}

/// The first picture in grey, with the pixels that [`noise_share`] counts in magenta; to be shown without exposure.
///
/// # Errors
/// As [`noise_share`].
pub fn noise_picture(first: &Picture, second: &Picture, scale: f32) -> Result<Picture, Error> {
    let map = noise_map(first, second, scale)?;
    Ok(marked(first, scale, map.iter().map(|differs| differs.then_some(MAGENTA))))
}

fn noise_map(first: &Picture, second: &Picture, scale: f32) -> Result<Vec<bool>, Error> {
    first.check_size(second)?;
    check_finite("first", &first.pixels)?;
    check_finite("second", &second.pixels)?;
    let a = first.displayed(scale);
    let b = second.displayed(scale);
    Ok(a.pixels.iter().zip(&b.pixels).map(|(a, b)| (*a - *b).abs().max_element() > NOISE_STEP).collect())
}

/// A picture in dim grey with some pixels in colour.
pub(super) fn marked(picture: &Picture, scale: f32, colours: impl Iterator<Item = Option<Vec3>>) -> Picture {
    let grey = |p: &Vec3| Vec3::splat(DIMMED * (luminance(*p) * scale).clamp(0.0, 1.0));
    let pixels = picture.pixels.iter().zip(colours).map(|(p, colour)| colour.unwrap_or_else(|| grey(p))).collect();
    Picture { pixels, ..*picture }
}

fn check_mask(picture: &Picture, mask: Option<&[bool]>) -> Result<(), Error> {
    match mask {
        Some(mask) if mask.len() != picture.pixels.len() => {
            Err(Error::MaskLength { expected: picture.pixels.len(), found: mask.len() })
        }
        _ => Ok(()),
    }
}

/// A coordinate and those up to `reach` further on both sides.
pub(super) fn about(at: u32, reach: u32, length: u32) -> Range<u32> {
    at.saturating_sub(reach)..(at + reach + 1).min(length)
}

/// Number of squares of an edge that fit beside each other, each one pixel further.
fn squares(length: u32, edge: u32) -> u32 {
    (length + 1).saturating_sub(edge)
}

/// Sums over all squares of `edge` × `edge` values that lie inside the picture, by upper left corners row by row.
fn square_sums(values: &[f64], (width, height): (u32, u32), edge: u32) -> Vec<f64> {
    let columns = squares(width, edge) as usize;
    let rows = squares(height, edge) as usize;
    let width = width as usize;
    let edge = edge as usize;
    if columns == 0 || rows == 0 {
        return Vec::new();
    }
    // Sums along rows, then down: no differences of large sums, so that equal values give equal sums.
    let along: Vec<f64> =
        values.chunks_exact(width).flat_map(|row| row.windows(edge).map(|w| w.iter().sum::<f64>())).collect();
    (0..rows * columns).map(|k| (0..edge).map(|j| along[k + j * columns]).sum::<f64>()).collect()
}
