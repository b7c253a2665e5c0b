//! Calculation planes: illuminance on a grid of places in the air, as lighting design asks for it.

use glam::{Vec2, Vec3, Vec4};
use scene::{NONE, Scene, Sides, SurfacePoint, Visibility as _};

use super::{LightPart, add_direct, at_corners, illuminance, lit_sides};
use crate::error::Error;
use crate::light::LightField;

/// Directions round a cylinder.
const DIRECTIONS: u32 = 16;
/// Most indirect light of backs, as a share of that of fronts, where backs are insides of solids.
const MAX_BACKS: f64 = 0.25;
/// Most points of a plane.
const MAX_POINTS: f64 = 1e6;

/// Quantity measured at the points of a plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlaneKind {
    /// Illuminance from above.
    #[default]
    Horizontal,
    /// Mean illuminance of the curved side of a small upright cylinder (EN 12464-1, 3.2): how faces are lit.
    Cylindrical,
}

/// A horizontal grid over a scene; y points upwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalculationPlane {
    /// Measured quantity.
    pub kind: PlaneKind,
    /// Height, m.
    pub height: f32,
    /// Distance between points, m, at most.
    pub spacing: f32,
    /// Least and greatest x and z, m; `None` for the scene's bounds.
    pub area: Option<(Vec2, Vec2)>,
}

/// Light on a plane.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneLight {
    /// Points along x and z.
    pub counts: [u32; 2],
    /// First point, and the steps to the next along x and z, m.
    pub first: Vec3,
    /// Steps along x and z, m.
    pub step: Vec2,
    /// Illuminance, lx, row by row along x; `None` inside of solids.
    pub lux: Vec<Option<f32>>,
}

impl CalculationPlane {
    /// Illuminance under the light of the last update.
    ///
    /// # Errors
    /// [`Unsupported`](crate::ErrorKind::Unsupported) unless receivers are on the mesh, [`transport::Error::Setting`]
    /// for a height or an area that are not finite, [`transport::Error::TooMany`] points; what the device says;
    /// cancellation.
    pub fn light(&self, field: &mut LightField) -> Result<PlaneLight, Error> {
        let mut light = self.grid(field.scene())?;
        let outer = outer_sides(field)?;
        let scene = field.scene();
        let places: Vec<Vec3> = (0..light.lux.len() as u32).map(|k| light.place(k)).collect();
        let open: Vec<usize> = (0..places.len()).filter(|&k| is_in_the_open(scene, &outer, places[k])).collect();
        let normals = self.normals();
        let points: Vec<SurfacePoint> = (open.iter())
            .flat_map(|&k| normals.iter().map(move |&normal| (k, normal)))
            .map(|(k, normal)| SurfacePoint { position: places[k], patch: NONE, normal, weight: 1.0 })
            .collect();
        let mut values: Vec<Vec4> = field.irradiance_at(&points)?.iter().map(|e| e.extend(0.0)).collect();
        add_direct(field.scene(), &points, LightPart::Full, &mut values)?;
        for (&k, values) in open.iter().zip(values.chunks_exact(normals.len())) {
            let sum: f32 = values.iter().map(|e| illuminance(e.truncate())).sum();
            light.lux[k] = Some(sum / normals.len() as f32);
        }
        Ok(light)
    }

    fn normals(&self) -> Vec<Vec3> {
        match self.kind {
            PlaneKind::Horizontal => vec![Vec3::Y],
            PlaneKind::Cylindrical => (0..DIRECTIONS)
                .map(|k| {
                    let (s, c) = scene::math::sin_cos_2pi((k as f32 + 0.5) / DIRECTIONS as f32);
                    Vec3::new(c, 0.0, s)
                })
                .collect(),
        }
    }

    /// The points, all dark.
    fn grid(&self, scene: &Scene) -> Result<PlaneLight, Error> {
        let (low, high) = scene.geometry.bounds;
        let (low, high) = self.area.unwrap_or((Vec2::new(low.x, low.z), Vec2::new(high.x, high.z)));
        let setting = |name, value: f32, rule| transport::Error::Setting { name, value: value.into(), rule };
        if !self.height.is_finite() {
            return Err(setting("height of a plane", self.height, "finite").into());
        }
        if !(self.spacing.is_finite() && self.spacing > 0.0) {
            return Err(setting("spacing of a plane", self.spacing, "positive and finite").into());
        }
        let size = high - low;
        if !(size.is_finite() && size.min_element() > 0.0) {
            return Err(setting("area of a plane", size.min_element(), "with the greater corner last").into());
        }
        let counts = (size / self.spacing).ceil().max(Vec2::ONE);
        let found = f64::from(counts.x) * f64::from(counts.y);
        if found > MAX_POINTS {
            return Err(transport::Error::TooMany {
                name: "points of a plane",
                found: found as u64,
                limit: MAX_POINTS as u64,
            }
            .into());
        }
        let step = size / counts;
        let first = Vec3::new(low.x + 0.5 * step.x, self.height, low.y + 0.5 * step.y);
        let counts = counts.as_uvec2().to_array();
        Ok(PlaneLight { counts, first, step, lux: vec![None; (counts[0] * counts[1]) as usize] })
    }
}

impl PlaneLight {
    /// Position of point `k`, m.
    pub fn place(&self, k: u32) -> Vec3 {
        let i = k % self.counts[0];
        let j = k / self.counts[0];
        self.first + Vec3::new(i as f32 * self.step.x, 0.0, j as f32 * self.step.y)
    }

    /// Mean, least and greatest illuminance, lx; `None` where no point is in the open.
    pub fn statistics(&self) -> Option<[f32; 3]> {
        let all = || self.lux.iter().flatten().copied();
        let count = all().count();
        let mean = (all().map(f64::from).sum::<f64>() / count as f64) as f32;
        (count > 0).then(|| [mean, all().fold(f32::INFINITY, f32::min), all().fold(0.0, f32::max)])
    }
}

/// The sides that bound what is not solid: those with receivers, and of these the fronts where they have nearly all of
/// the indirect light, for light may leak into hollow walls.
fn outer_sides(field: &mut LightField) -> Result<Vec<Sides>, Error> {
    let mut light = [0.0; 2];
    for (sum, front) in light.iter_mut().zip([true, false]) {
        let corners = at_corners(field, LightPart::Indirect, front)?;
        let of = field.scene().geometry.triangles.iter().zip(&corners);
        let flux = of.map(|(t, e)| f64::from(t.edge_a.cross(t.edge_b).length() * illuminance(e[0] + e[1] + e[2])));
        *sum = flux.sum::<f64>();
    }
    let mut sides = lit_sides(field.bake());
    if light[1] < MAX_BACKS * light[0] {
        sides.iter_mut().for_each(|side| side.back = false);
    }
    Ok(sides)
}

/// Returns true if a place is in none of the solids: most of what is seen from there are sides that bound it.
fn is_in_the_open(scene: &Scene, outer: &[Sides], place: Vec3) -> bool {
    let tables = scene.tables();
    let is_outer = |direction: Vec3| {
        let hit = scene.closest(place, direction);
        hit.is_miss() || {
            let side = outer[hit.triangle as usize];
            if tables.normal(hit.triangle).dot(direction) < 0.0 { side.front } else { side.back }
        }
    };
    let signs = [-1.0, 0.0, 1.0];
    let steps = signs.iter().flat_map(|&x| signs.iter().flat_map(move |&y| signs.map(|z| Vec3::new(x, y, z))));
    let seen: Vec<bool> = steps.filter_map(Vec3::try_normalize).map(is_outer).collect();
    2 * seen.iter().filter(|&&is_outer| is_outer).count() > seen.len()
}
