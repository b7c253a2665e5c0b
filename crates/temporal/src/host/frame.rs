//! Settings of a frame, and the light that stays from frame to frame.

use alloc::vec::Vec;

use glam::Vec4;
use scene::parallel::*;
use transport::LinearOperator;

use crate::error::{Error, check_length};
use crate::kernel::sample::{AUTO, CONTROL, ROTATED, change};
use crate::types::{SampleParams, SumParams};

/// Most samples of a row in a frame.
pub const MAX_SAMPLES: u32 = 1 << 16;
/// Greatest weight of the frames before: 2²⁰ frames are averaged.
const MAX_BLEND: f32 = 1.0 - 1.0 / (1 << 20) as f32;

/// Weight w of the frames before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Blend {
    /// Always the same, from 0 to below 1.
    Fixed(f32),
    /// From the variance of the samples and the change of the light, as if up to so many frames were averaged.
    Auto {
        /// Most frames, at least 1.
        frames: f32,
    },
}

/// Settings of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Samples a row, Q.
    pub samples: u32,
    /// Weight of the frames before; of no account with the control variate.
    pub blend: Blend,
    /// Samples only the changes of the light.
    pub control_variate: bool,
    /// Takes samples from a shifted lattice; else they are independent.
    pub rotated: bool,
    /// With the control variate: every row is summed exactly once in so many frames; 0 for never.
    pub refresh: u32,
    /// Changes every random number.
    pub seed: u32,
}

impl Default for Settings {
    /// [`Settings::DEFAULT`].
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Settings {
    /// 64 samples of the change on a shifted lattice, every row exact once in 16 frames; without the control variate w
    /// by itself, up to 64 frames.
    pub const DEFAULT: Self = Self {
        samples: 64,
        blend: Blend::Auto { frames: 64.0 },
        control_variate: true,
        rotated: true,
        refresh: 16,
        seed: 0,
    };

    /// Checks the ranges.
    ///
    /// # Errors
    /// [`Error::Setting`] names the first that is wrong.
    pub fn check(&self) -> Result<(), Error> {
        if !(1..=MAX_SAMPLES).contains(&self.samples) {
            let value = f64::from(self.samples);
            return Err(Error::Setting { name: "samples", value, rule: "from 1 to 65,536" });
        }
        match self.blend {
            Blend::Fixed(w) if !(0.0..1.0).contains(&w) => {
                Err(Error::Setting { name: "blend", value: f64::from(w), rule: "at least 0 and below 1" })
            }
            Blend::Auto { frames } if !(frames >= 1.0 && frames.is_finite()) => {
                Err(Error::Setting { name: "frames", value: f64::from(frames), rule: "finite and at least 1" })
            }
            _ => Ok(()),
        }
    }

    /// Parameters of a frame for rows with these storage options, all in one block.
    pub fn params(&self, rows: u32, options: u32, frame: u32) -> SampleParams {
        let option = |on: bool, bit: u32| if on { bit } else { 0 };
        let (auto, blend) = match self.blend {
            Blend::Fixed(w) => (false, w),
            Blend::Auto { frames } => (true, (1.0 - 1.0 / (frames + 1.0)).min(MAX_BLEND)),
        };
        let options = options
            | option(self.rotated, ROTATED)
            | option(self.control_variate, CONTROL)
            | option(auto && !self.control_variate, AUTO);
        SampleParams { rows, samples: self.samples, frame, seed: self.seed, options, blend, ..SampleParams::default() }
    }

    /// Rows of a block that are summed exactly in a frame.
    pub fn summed(&self, rows: u32) -> u32 {
        if self.control_variate && self.refresh > 0 { rows.div_ceil(self.refresh) } else { 0 }
    }

    /// Which rows of a block are summed exactly in a frame: all of them once in `refresh` frames.
    pub fn rows_to_sum(&self, rows: u32, options: u32, frame: u32) -> SumParams {
        let count = self.summed(rows);
        let first = (u64::from(frame) * u64::from(count)).checked_rem(u64::from(rows)).unwrap_or(0) as u32;
        SumParams { count, rows, first, first_entry: 0, options }
    }
}

impl SumParams {
    /// Settings for a distribution of so many rows in one block.
    pub(crate) fn within(&self, rows: usize, options: u32) -> Result<Self, Error> {
        let wrong = |name, value: u32, rule| Err(Error::Setting { name, value: f64::from(value), rule });
        if self.count as usize > rows {
            return wrong("count", self.count, "at most the number of rows");
        }
        if self.first as usize >= rows.max(1) {
            return wrong("first", self.first, "below the number of rows");
        }
        Ok(Self { rows: rows as u32, first_entry: 0, options: self.options | options, ..*self })
    }
}

/// Rows that can be sampled. As an operator they are summed exactly, W/m².
pub trait Distribution: LinearOperator {
    /// Storage of the entries, as kernels take it.
    fn options(&self) -> u32;

    /// Takes the irradiance of all rows one frame on: [`crate::kernel::sample::sample_row`]. W/m².
    ///
    /// # Errors
    /// [`Error::Length`] of a vector.
    fn sample(
        &self,
        p: &SampleParams,
        exitance: &[Vec4],
        change: &[Vec4],
        irradiance: &mut [Vec4],
    ) -> Result<(), Error>;

    /// Exact irradiance of some rows; the others stay. W/m².
    ///
    /// # Errors
    /// [`Error::Length`] of a vector, [`Error::Setting`] for rows that are not there.
    fn sum(&self, p: &SumParams, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error>;
}

/// Exact irradiance of all rows, W/m².
pub(super) fn sum_rows_all(rows: &impl Distribution, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
    irradiance.fill(Vec4::ZERO);
    let count = rows.rows() as u32;
    rows.sum(&SumParams { count, rows: count, ..SumParams::default() }, exitance, irradiance)
}

pub(super) fn check_vectors<D: Distribution + ?Sized>(
    rows: &D,
    exitance: &[Vec4],
    change: &[Vec4],
    irradiance: &[Vec4],
) -> Result<(), Error> {
    rows.check_vectors(exitance, irradiance)?;
    check_length("change", rows.columns(), change.len())
}

/// Change of the exitance of all patches, [`change`], on all cores.
pub fn change_all(source: &[Vec4], albedo: &[Vec4], irradiance: &[Vec4], exitance: &[Vec4], out: &mut [Vec4]) {
    out.par_iter_mut()
        .with_min_len(1024)
        .enumerate()
        .for_each(|(i, d)| *d = change(source[i], albedo[i], irradiance[i], exitance[i]));
}

/// Light between patches that stays from frame to frame: [`State::advance`] is a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Number of the next frame.
    pub frame: u32,
    /// Exitance that the irradiance comes from, `E + ρ∘H` with the H of the frame before, W/m².
    pub exitance: Vec<Vec4>,
    /// Irradiance H, W/m².
    pub irradiance: Vec<Vec4>,
    /// Change of the exitance, W/m².
    pub change: Vec<Vec4>,
}

impl State {
    /// The dark, for so many patches.
    pub fn new(patches: usize) -> Self {
        let dark = vec![Vec4::ZERO; patches];
        Self { frame: 0, exitance: dark.clone(), irradiance: dark.clone(), change: dark }
    }

    /// A frame with the first exitance E: a bounce more of the light, sampled from the rows of F. With an albedo of 0,
    /// and rows of all bounces T, it is the whole light in one product.
    ///
    /// # Errors
    /// [`Error::Setting`]; [`Error::Length`] unless rows and columns are patches.
    pub fn advance(
        &mut self,
        rows: &impl Distribution,
        source: &[Vec4],
        albedo: &[Vec4],
        settings: &Settings,
    ) -> Result<(), Error> {
        settings.check()?;
        check_length("source", self.exitance.len(), source.len())?;
        check_length("albedo", self.exitance.len(), albedo.len())?;
        check_vectors(rows, &self.exitance, &self.change, &self.irradiance)?;
        change_all(source, albedo, &self.irradiance, &self.exitance, &mut self.change);
        let now = source.par_iter().zip(albedo).zip(&self.irradiance).with_min_len(1024);
        now.map(|((e, rho), h)| *e + *rho * *h).collect_into_vec(&mut self.exitance);
        let count = rows.rows() as u32;
        let p = settings.params(count, rows.options(), self.frame);
        rows.sample(&p, &self.exitance, &self.change, &mut self.irradiance)?;
        let rows_to_sum = settings.rows_to_sum(count, rows.options(), self.frame);
        rows.sum(&rows_to_sum, &self.exitance, &mut self.irradiance)?;
        self.frame = self.frame.wrapping_add(1);
        Ok(())
    }
}
