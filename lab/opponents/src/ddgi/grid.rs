//! Probe grid: a regular grid over the scene's bounds.

use glam::{UVec3, Vec3};
use scene::Scene;

use reference::Error;

/// Probes at most.
pub const PROBE_LIMIT: u64 = 1 << 18;
/// Probes along each axis at least: there are eight to interpolate between.
const MIN: f32 = 2.0;
/// Spacing along an axis over the one asked for, at least: for scenes that are flat.
const MIN_SHARE: f32 = 0.25;
/// Steps of the search for a number of probes.
const STEPS: u32 = 40;

/// Spacing of probes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spacing {
    /// Most distance along each axis, m.
    Metres(f32),
    /// The distance at which there are about so many.
    Probes(u32),
}

/// Probes at the centres of equal boxes that fill the scene's bounds: none is in or behind the outermost walls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Probes along the axes.
    pub counts: UVec3,
    /// Distance along the axes, m.
    pub spacing: Vec3,
    /// The first probe, m.
    pub first: Vec3,
}

impl Grid {
    /// The grid of a scene.
    ///
    /// # Errors
    /// [`Error::Setting`] for a spacing that is not positive and finite, and for none or too many probes.
    pub fn new(scene: &Scene, spacing: Spacing) -> Result<Self, Error> {
        let (low, high) = scene.geometry.bounds;
        match spacing {
            Spacing::Metres(edge) => Self::over(low, high, edge),
            Spacing::Probes(count) => {
                let wrong = count == 0 || u64::from(count) > PROBE_LIMIT;
                if wrong {
                    return Err(Error::Setting { name: "probes", value: f64::from(count), rule: "from 1 to 2^18" });
                }
                let longest = (high - low).max_element();
                let mut small = longest * 1e-3;
                let mut large = longest;
                for _ in 0..STEPS {
                    let middle = (small * large).sqrt();
                    let found = counts(high - low, middle).as_dvec3().element_product();
                    *(if found > f64::from(count) { &mut small } else { &mut large }) = middle;
                }
                Self::over(low, high, large)
            }
        }
    }

    fn over(low: Vec3, high: Vec3, edge: f32) -> Result<Self, Error> {
        let setting = |rule| Error::Setting { name: "probe spacing", value: f64::from(edge), rule };
        if !(edge.is_finite() && edge > 0.0) {
            return Err(setting("positive and finite"));
        }
        let counts = counts(high - low, edge);
        if counts.as_dvec3().element_product() > PROBE_LIMIT as f64 {
            return Err(setting("large enough for at most 2^18 probes"));
        }
        let spacing = ((high - low) / counts).max(Vec3::splat(edge * MIN_SHARE));
        let first = 0.5 * (low + high) - 0.5 * (counts - 1.0) * spacing;
        Ok(Self { counts: counts.as_uvec3(), spacing, first })
    }

    /// Number of probes.
    pub fn count(&self) -> usize {
        self.counts.as_u64vec3().element_product() as usize
    }

    /// Place of a probe before it is moved, m.
    pub fn position(&self, probe: usize) -> Vec3 {
        self.first + self.cell(probe).as_vec3() * self.spacing
    }

    /// Which one a probe is along each axis.
    pub fn cell(&self, probe: usize) -> UVec3 {
        let x = self.counts.x as usize;
        let y = self.counts.y as usize;
        UVec3::new((probe % x) as u32, (probe / x % y) as u32, (probe / (x * y)) as u32)
    }

    /// Number of the probe there.
    pub fn number(&self, cell: UVec3) -> usize {
        (cell.x + self.counts.x * (cell.y + self.counts.y * cell.z)) as usize
    }

    /// The eight probes round a point with their trilinear weights.
    pub fn around(&self, point: Vec3) -> [(usize, f32); 8] {
        let place = (point - self.first) / self.spacing;
        let last = self.counts - 1;
        let base = place.floor().max(Vec3::ZERO).as_uvec3().min(last);
        let share = (place - base.as_vec3()).clamp(Vec3::ZERO, Vec3::ONE);
        std::array::from_fn(|k| {
            let step = UVec3::new(k as u32 & 1, k as u32 >> 1 & 1, k as u32 >> 2);
            let cell = (base + step).min(last);
            let weight = Vec3::select(step.cmpeq(UVec3::ONE), share, 1.0 - share).max(Vec3::splat(1e-3));
            (self.number(cell), weight.element_product())
        })
    }
}

fn counts(extent: Vec3, edge: f32) -> Vec3 {
    // A little less, so that rounding adds no layer.
    (extent / edge - 1e-3).ceil().max(Vec3::splat(MIN))
}
