//! Intensities by direction, as they are measured of luminaires, and the table of them that kernels read.

use alloc::vec::Vec;

#[cfg(not(feature = "std"))]
use num_traits::Float as _;

use crate::double::sin_cos;
use crate::error::Error;
use crate::gpu::{LIGHT_LUMINAIRE, Light};
use crate::kernel::light::DISTRIBUTION_HEADER;

/// Most steps of γ in a table: a quarter of a degree each over the whole sphere.
const MAX_STEPS: usize = 720;
/// Most half-planes in a table: one a degree.
const MAX_PLANES: usize = 360;
/// Shares of a step by which an angle may miss a grid and yet be on it.
const ON_GRID: f64 = 1e-3;
/// Words that a table of distributions may have: 128 MiB, which every device can bind.
const MAX_DISTRIBUTION_WORDS: usize = 1 << 25;

/// Intensities of a luminaire by direction, bilinear in γ and C between those that are given (CIE 121, IES LM-63 type
/// C).
///
/// γ is the angle from the luminaire's axis, C the half-plane round it; see [`LIGHT_LUMINAIRE`] for where they lie.
/// Beyond the first and the last γ the intensity is 0. Any unit: [`Self::mean`] has the same, and tables hold ratios to
/// it.
///
/// ```
/// // The intensity of a Lambert surface that faces along γ = 0: cos γ, whose mean over all directions is ¼.
/// let gammas: Vec<f64> = (0..=90).map(f64::from).collect();
/// let intensities = gammas.iter().map(|gamma| gamma.to_radians().cos()).collect();
/// let lambert = patchlight_scene::Distribution::new(gammas, vec![0.0], intensities)?;
/// assert!((lambert.mean() - 0.25).abs() < 1e-5);
/// assert_eq!(lambert.intensity(120.0, 0.0), 0.0);
/// # Ok::<(), patchlight_scene::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Distribution {
    gammas: Vec<f64>,
    planes: Vec<f64>,
    intensities: Vec<f64>,
}

impl Distribution {
    /// Intensities `[planes · gammas]`, plane by plane, at angles in degrees: γ rises within [0, 180], C within [0,
    /// 360).
    ///
    /// # Errors
    /// [`Error::Distribution`] for angles that do not rise or are out of range, and for intensities that are missing,
    /// negative or no numbers.
    pub fn new(gammas: Vec<f64>, planes: Vec<f64>, intensities: Vec<f64>) -> Result<Self, Error> {
        let wrong = |name, index: usize, value: f64, rule| Err(Error::Distribution { name, index, value, rule });
        if gammas.len() < 2 || planes.is_empty() {
            return wrong(
                "number of angles",
                0,
                gammas.len().min(planes.len()) as f64,
                "two of γ and one of C, at least",
            );
        }
        for (name, angles, end) in [("γ", &gammas, 180.0), ("C", &planes, 360.0 - 1e-9)] {
            let is_wrong = |k: &usize| {
                let low = if *k == 0 { 0.0 } else { angles[k - 1] };
                !(angles[*k] >= low && angles[*k] <= end && (*k == 0 || angles[*k] > low))
            };
            if let Some(k) = (0..angles.len()).find(is_wrong) {
                return wrong(name, k, angles[k], "greater than the angle before and within the sphere");
            }
        }
        let expected = gammas.len() * planes.len();
        if intensities.len() != expected {
            return wrong("number of intensities", 0, intensities.len() as f64, "one for each γ of each C");
        }
        match intensities.iter().position(|value| !(0.0..=f64::from(f32::MAX)).contains(value)) {
            Some(k) => wrong("intensity", k, intensities[k], "a number that is not negative"),
            None => Ok(Self { gammas, planes, intensities }),
        }
    }

    /// Intensity in a direction: angles in degrees.
    pub fn intensity(&self, gamma: f64, c: f64) -> f64 {
        let last = self.gammas.len() - 1;
        if !(self.gammas[0]..=self.gammas[last]).contains(&gamma) {
            return 0.0;
        }
        let high = self.gammas.partition_point(|g| *g < gamma).clamp(1, last);
        let low = high - 1;
        let share = (gamma - self.gammas[low]) / (self.gammas[high] - self.gammas[low]);
        let c = within_turn(c);
        let count = self.planes.len();
        let after = self.planes.partition_point(|plane| *plane <= c);
        let left = (after + count - 1) % count;
        let right = after % count;
        let at = |plane: usize| {
            let row = &self.intensities[plane * (last + 1)..];
            row[low] + (row[high] - row[low]) * share
        };
        let width = within_turn(self.planes[right] - self.planes[left]);
        if width == 0.0 {
            return at(left);
        }
        let beside = within_turn(c - self.planes[left]) / width;
        at(left) + (at(right) - at(left)) * beside
    }

    /// Mean intensity over all directions: ½ ∫ Ī(γ) sin γ dγ, exact for what [`Self::intensity`] says. The flux is 4π
    /// times it.
    pub fn mean(&self) -> f64 {
        let steps = self.gammas.len();
        let count = self.planes.len();
        let weight = |plane: usize| match count {
            1 => 1.0,
            _ => {
                let before = (plane + count - 1) % count;
                let after = (plane + 1) % count;
                let width = |from: usize, to: usize| within_turn(self.planes[to] - self.planes[from]);
                (width(before, plane) + width(plane, after)) / 720.0
            }
        };
        let mut sum = 0.0;
        for plane in 0..count {
            let row = &self.intensities[plane * steps..][..steps];
            let mut of_plane = 0.0;
            for k in 1..steps {
                let a = self.gammas[k - 1].to_radians();
                let b = self.gammas[k].to_radians();
                let slope = (row[k] - row[k - 1]) / (b - a);
                let ((sin_a, cos_a), (sin_b, cos_b)) = (sin_cos(a), sin_cos(b));
                of_plane += row[k - 1] * cos_a - row[k] * cos_b + slope * (sin_b - sin_a);
            }
            sum += 0.5 * weight(plane) * of_plane;
        }
        sum
    }

    /// Greatest intensity.
    pub fn greatest(&self) -> f64 {
        self.intensities.iter().copied().fold(0.0, f64::max)
    }

    /// Distribution at equal steps of γ and C: at the given angles where these lie on a grid of quarters of a degree of
    /// γ and degrees of C, between them where they do not.
    pub fn on_grid(&self) -> Self {
        let first = self.gammas[0];
        let range = self.gammas[self.gammas.len() - 1] - first;
        let finest = (range / 180.0 * MAX_STEPS as f64).ceil().max(1.0) as usize;
        let steps = grid_steps(self.gammas.iter().map(|gamma| (gamma - first) / range), finest);
        let planes = if self.is_round() { 1 } else { grid_steps(self.planes.iter().map(|c| c / 360.0), MAX_PLANES) };
        let gammas: Vec<f64> = (0..=steps).map(|k| first + range * k as f64 / steps as f64).collect();
        let planes: Vec<f64> = (0..planes).map(|k| 360.0 * k as f64 / planes as f64).collect();
        let last = gammas.len() - 1;
        let mut intensities = Vec::with_capacity(gammas.len() * planes.len());
        for &c in &planes {
            // The last angle of a sum may lie a hair beyond the measured one.
            intensities
                .extend((0..=last).map(|k| self.intensity(gammas[k].min(self.gammas[self.gammas.len() - 1]), c)));
        }
        Self { gammas, planes, intensities }
    }

    /// Returns true if the intensity is the same in all half-planes.
    fn is_round(&self) -> bool {
        let row = self.gammas.len();
        self.intensities.chunks(row).all(|plane| plane == &self.intensities[..row])
    }

    /// Greatest difference between [`Self::on_grid`] and this at the angles that are given, over the greatest
    /// intensity: both are linear between, and differ most there.
    pub fn grid_error(&self) -> f64 {
        let grid = self.on_grid();
        let greatest = self.greatest();
        let mut error = 0.0f64;
        for (k, &intensity) in self.intensities.iter().enumerate() {
            let c = self.planes[k / self.gammas.len()];
            let gamma = self.gammas[k % self.gammas.len()];
            error = error.max((grid.intensity(gamma, c) - intensity).abs() / greatest.max(f64::MIN_POSITIVE));
        }
        error
    }

    /// Adds what kernels read ([`crate::kernel::light::luminaire_share`]) to a table of distributions, and says where
    /// it begins: the value of [`Light::distribution`].
    ///
    /// # Errors
    /// [`Error::Distributions`] where the table grows too large.
    pub fn append_to(&self, table: &mut Vec<f32>) -> Result<u32, Error> {
        let grid = self.on_grid();
        let begin = table.len();
        let words = begin + DISTRIBUTION_HEADER as usize + grid.intensities.len();
        if words > MAX_DISTRIBUTION_WORDS {
            return Err(Error::Distributions { words, limit: MAX_DISTRIBUTION_WORDS });
        }
        let last = grid.gammas.len() - 1;
        let range = (grid.gammas[last] - grid.gammas[0]).to_radians();
        let planes = if grid.planes.len() == 1 { 0 } else { grid.planes.len() };
        let header = [grid.gammas[0].to_radians(), last as f64 / range, last as f64, planes as f64];
        table.extend(header.map(|value| value as f32));
        let mean = grid.mean();
        let scale = if mean > 0.0 { 1.0 / mean } else { 0.0 };
        table.extend(grid.intensities.iter().map(|value| (value * scale) as f32));
        Ok(begin as u32)
    }

    /// The distribution that begins at a place of a table, as ratios to its mean; none where there is none.
    pub fn of_table(table: &[f32], begin: u32) -> Option<Self> {
        let stored = table.get(begin as usize..)?;
        let length = stored_length(stored)?;
        let first = f64::from(stored[0]);
        let per_radian = f64::from(stored[1]);
        let steps = stored[2] as usize;
        let planes = (stored[3] as usize).max(1);
        // Whole millionths of a degree: what single precision adds goes.
        let degrees = |radians: f64| (radians.to_degrees() * 1e4).round() / 1e4;
        let end = degrees(first + steps as f64 / per_radian);
        let begin = degrees(first);
        let gammas = (0..=steps).map(|k| begin + (end - begin) * k as f64 / steps as f64).collect();
        let planes = (0..planes).map(|k| 360.0 * k as f64 / planes as f64).collect();
        let values = stored[DISTRIBUTION_HEADER as usize..length].iter().copied().map(f64::from).collect();
        Self::new(gammas, planes, values).ok()
    }

    /// γ of the intensities, degrees.
    pub fn gammas(&self) -> &[f64] {
        &self.gammas
    }

    /// C of the intensities, degrees.
    pub fn planes(&self) -> &[f64] {
        &self.planes
    }

    /// The intensities `[planes · gammas]`, plane by plane.
    pub fn intensities(&self) -> &[f64] {
        &self.intensities
    }
}

/// Equivalent angle in [0°, 360°).
fn within_turn(angle: f64) -> f64 {
    let rest = angle % 360.0;
    if rest < 0.0 { rest + 360.0 } else { rest }
}

/// Least number of equal steps of the unit interval on which all shares lie, or the most.
fn grid_steps(shares: impl Iterator<Item = f64> + Clone, most: usize) -> usize {
    (1..most)
        .find(|steps| {
            let mut shares = shares.clone().map(|share| share * *steps as f64);
            shares.all(|place| (place - place.round()).abs() < ON_GRID)
        })
        .unwrap_or(most)
}

/// Words of the distribution that a table begins with, if it is one.
fn stored_length(table: &[f32]) -> Option<usize> {
    let header = table.get(..DISTRIBUTION_HEADER as usize)?;
    let is_count = |value: f32, least: f32| value >= least && value <= 65_536.0 && value == value.trunc();
    let is_sound = header[0].is_finite() && header[1].is_finite() && header[1] > 0.0;
    if !is_sound || !is_count(header[2], 1.0) || !is_count(header[3], 0.0) {
        return None;
    }
    let length = header.len() + (header[2] as usize + 1) * (header[3] as usize).max(1);
    (length <= table.len()).then_some(length)
}

/// Checks that every luminaire has a distribution in the table.
///
/// # Errors
/// [`Error::LightDistribution`] names the light.
pub(super) fn check_lights(lights: &[Light], table: &[f32]) -> Result<(), Error> {
    let has_none = |light: &Light| {
        light.kind == LIGHT_LUMINAIRE && table.get(light.distribution as usize..).and_then(stored_length).is_none()
    };
    match lights.iter().position(has_none) {
        Some(light) => {
            let begin = lights[light].distribution;
            Err(Error::LightDistribution { light, begin, words: table.len() })
        }
        None => Ok(()),
    }
}

/// Checks that all words of a table are numbers.
///
/// # Errors
/// [`Error::Distribution`].
pub(super) fn check_table(table: &[f32]) -> Result<(), Error> {
    let Some(index) = table.iter().position(|value| !(0.0..=f32::MAX).contains(value)) else { return Ok(()) };
    let value = f64::from(table[index]);
    Err(Error::Distribution { name: "word", index, value, rule: "a number that is not negative" })
}
