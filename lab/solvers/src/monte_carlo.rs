//! Monte Carlo solvers of `B = E + ρ∘(F B)`: power goes from patch to patch by chance, with the form factors as
//! probabilities (Shirley 1991; Neumann 1995; Bekaert 1999; A. S. Shcherbakov, thesis, 2.2.5).

use formfactor::{Error, Solution, Stop, check_inputs};
use glam::{Vec3, Vec4};
use scene::math::luminance;
use scene::sampling::{hash3, unit};
use transport::{Csr, check_length};

/// Albedo from which a walk goes on with this probability, however bright the surface.
const MAX_SURVIVAL: f32 = 0.98;
/// Steps of a walk, and iterations, at most.
const MAX_STEPS: u32 = 10_000;

/// Sampling of Monte Carlo solvers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Samples {
    /// Samples that the emitted power is cut into.
    pub count: u32,
    /// Changes every random number.
    pub seed: u32,
}

/// Rows of F as distributions, and where samples arrive.
struct Rows<'a> {
    factors: &'a Csr,
    /// Sums of each row's factors up to each entry.
    sums: Vec<f32>,
    area: &'a [f32],
}

impl<'a> Rows<'a> {
    fn new(factors: &'a Csr, area: &'a [f32], source: &[Vec4], albedo: &[Vec4]) -> Result<Self, Error> {
        factors.check()?;
        check_inputs(factors.rows, factors.columns, source, albedo)?;
        check_length("area", factors.rows, area.len())?;
        if let Some(index) = area.iter().position(|&a| !(a > 0.0 && a.is_finite())) {
            let value = f64::from(area[index]);
            return Err(transport::Error::Value { name: "area", index, value, rule: "positive" }.into());
        }
        let mut sums = Vec::with_capacity(factors.values.len());
        for row in factors.row_start.windows(2) {
            let mut sum = 0.0;
            for &factor in &factors.values[row[0] as usize..row[1] as usize] {
                sum += factor;
                sums.push(sum);
            }
        }
        Ok(Self { factors, sums, area })
    }

    /// Patch where a sample of patch i arrives, for a random number in [0, 1); nowhere if it escapes.
    fn target(&self, i: usize, random: f32) -> Option<usize> {
        let own = self.factors.row_start[i] as usize..self.factors.row_start[i + 1] as usize;
        let at = self.sums[own.clone()].partition_point(|&sum| sum <= random);
        (at < own.len()).then(|| self.factors.column_index[own.start + at] as usize)
    }

    /// Power of each patch, W.
    fn power(&self, exitance: &[Vec4]) -> Vec<Vec3> {
        exitance.iter().zip(self.area).map(|(b, &a)| b.truncate() * a).collect()
    }

    /// Irradiance from received power, W/m².
    fn irradiance(&self, received: &[Vec3]) -> Vec<Vec4> {
        received.iter().zip(self.area).map(|(&power, &a)| (power / a).extend(0.0)).collect()
    }
}

/// Random number k of a sample, in [0, 1).
fn random(sample: u32, k: u32, seed: u32) -> f32 {
    unit(hash3(sample, k, seed))
}

/// Stochastic Jacobi iteration (incremental shooting; Neumann 1995): in each iteration the power that is not yet sent
/// is cut into samples, as many as its share of the emitted power asks for, each from a patch chosen by power and to
/// one chosen by form factor; what arrives is reflected in the next. F must be reciprocal for the areas a, `a_i F_ij =
/// a_j F_ji` ([`formfactor::reciprocal`]): then the mean over seeds is the exact solution.
///
/// Shapes: `factors` n × n, `area` m², `source` (E, W/m²) and `albedo` `[n]`. Ends as [`Stop`] says, the tolerance a
/// share of the emitted power.
///
/// # Errors
/// As [`formfactor::jacobi`]; [`transport::Error::Value`] for an area that is not positive.
pub fn stochastic_jacobi(
    factors: &Csr,
    area: &[f32],
    source: &[Vec4],
    albedo: &[Vec4],
    samples: Samples,
    stop: Stop,
) -> Result<Solution, Error> {
    let rows = Rows::new(factors, area, source, albedo)?;
    let (most, tolerance) = match stop {
        Stop::Bounces(bounces) => (bounces, 0.0),
        Stop::Tolerance(tolerance) => (MAX_STEPS, tolerance),
    };
    let mut unsent = rows.power(source);
    let emitted: f32 = unsent.iter().map(|&power| luminance(power)).sum();
    let mut received = vec![Vec3::ZERO; source.len()];
    let mut iterations = 0;
    while iterations < most {
        let left: f32 = unsent.iter().map(|&power| luminance(power)).sum();
        if left <= tolerance * emitted {
            break;
        }
        let count = (samples.count as f32 * left / emitted).ceil().max(1.0);
        let seed = hash3(iterations, 0x6a61_636f, samples.seed);
        let mut arrived = vec![Vec3::ZERO; source.len()];
        // One random number for all patches: sample k begins where the sum of the power passes (k + random) / count of
        // all.
        let mut sum = 0.0f64;
        let mut next = 0u32;
        let first = f64::from(random(0, 1, seed));
        for (i, &power) in unsent.iter().enumerate() {
            let share = f64::from(luminance(power)) / f64::from(left) * f64::from(count);
            if share <= 0.0 {
                continue;
            }
            sum += share;
            let carried = power / share as f32;
            while f64::from(next) + first < sum {
                if let Some(j) = rows.target(i, random(next, 2, seed)) {
                    arrived[j] += carried;
                }
                next += 1;
            }
        }
        for ((unsent, received), (&arrived, albedo)) in
            unsent.iter_mut().zip(&mut received).zip(arrived.iter().zip(albedo))
        {
            *received += arrived;
            *unsent = albedo.truncate() * arrived;
        }
        iterations += 1;
    }
    Solution::of(factors, source, albedo, rows.irradiance(&received), iterations)
}

/// Random walks that shoot (Shirley 1991): each sample leaves a patch chosen by emitted power, goes on to patches
/// chosen by form factor, counts where it arrives, and is reflected with the probability of the brightest channel of
/// the albedo there. F as for [`stochastic_jacobi`]. `iterations` of the result are all steps.
///
/// # Errors
/// As [`stochastic_jacobi`].
pub fn random_walks(
    factors: &Csr,
    area: &[f32],
    source: &[Vec4],
    albedo: &[Vec4],
    samples: Samples,
) -> Result<Solution, Error> {
    let rows = Rows::new(factors, area, source, albedo)?;
    let power = rows.power(source);
    let emitted: f64 = power.iter().map(|&power| f64::from(luminance(power))).sum();
    let mut received = vec![Vec3::ZERO; source.len()];
    let mut sum = 0.0f64;
    let mut next = 0u32;
    let mut steps = 0u32;
    let count = f64::from(samples.count.max(1));
    let first = f64::from(random(0, 1, samples.seed));
    for (start, &power) in power.iter().enumerate() {
        let share = f64::from(luminance(power)) / emitted * count;
        // Of no emitted power, the share is no number.
        if share.is_nan() || share <= 0.0 {
            continue;
        }
        sum += share;
        while f64::from(next) + first < sum {
            let mut i = start;
            let mut carried = power / share as f32;
            for step in 0..MAX_STEPS {
                let Some(j) = rows.target(i, random(next, 2 * step + 2, samples.seed)) else { break };
                steps = steps.saturating_add(1);
                received[j] += carried;
                let survival = albedo[j].truncate().max_element().min(MAX_SURVIVAL);
                if random(next, 2 * step + 3, samples.seed) >= survival {
                    break;
                }
                carried *= albedo[j].truncate() / survival;
                i = j;
            }
            next += 1;
        }
    }
    Solution::of(factors, source, albedo, rows.irradiance(&received), steps)
}
