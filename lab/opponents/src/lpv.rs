//! Light propagation volumes, an opponent: light of virtual points goes from cell to cell of a grid, as intensity in
//! two bands of spherical harmonics.
//!
//! Source: Kaplanyan and Dachsbacher 2010, "Cascaded Light Propagation Volumes for Real-Time Indirect Illumination"
//! (I3D). An update casts light upon the surfaces that it meets first, puts what they reflect into cells half a cell in
//! front of them, and moves it on: the flux that a cell sends through each of five faces of a neighbour becomes a
//! cosine lobe there. Surfaces between cells stop it, all but in the first step, and send on what they reflect (further
//! bounces, section 5.3). A point takes what came by, trilinear, by the cosine lobe of its normal.
//!
//! Where the source leaves a choice: surfaces that block are taken from the scene itself, not from what lights and
//! camera see of them. Intensity becomes radiance by what a cell's faces let through: isotropic light is 3/2 times as
//! long in a cell as the light of a beam along an axis, for all goes along axes. Nested grids, each with cells half as
//! large about the eye, are for scenes larger than a grid resolves; a point takes the finest that holds it, blended at
//! its border. One grid is a cascade of one. H is indirect only, as for all methods here.
//!
//! Known biases: two bands blur directions, blockers leak, and nothing is resolved below a cell.

mod grid;
mod shadow_map;

use glam::Vec3;
use rayon::prelude::*;
use scene::{Lighting, Scene};

use crate::ddgi::ViewedPoint;
use grid::{Grid, Shape};
use reference::Error;
use shadow_map::virtual_lights;

/// Cells along an axis, grids, texels of a light and steps at most.
const MAX_CELLS: u32 = 128;
const MAX_CASCADES: u32 = 8;
const MAX_TEXELS: u32 = 1 << 22;
const MAX_STEPS: u32 = 1024;
/// Cells over whose width one grid blends into the next.
const BLEND: f32 = 2.0;

/// Settings of [`Lpv`], besides the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LpvSettings {
    /// Cells along the longest axis.
    pub cells: u32,
    /// Nested grids; the last one holds the scene.
    pub cascades: u32,
    /// Middle of the finer ones, m.
    pub eye: Vec3,
    /// Rays of each light, of all emitters together and of the sky: texels of a reflective shadow map.
    pub texels: u32,
    /// Steps of the light from cell to cell.
    pub steps: u32,
    /// Surfaces stop light.
    pub occlusion: bool,
    /// Surfaces send on what they stop: bounces after the first.
    pub bounces: bool,
    /// Backs of surfaces count as fronts.
    pub two_sided: bool,
}

impl Default for LpvSettings {
    /// 32 cells, three grids, maps of 256 × 256 and as many steps as light needs to cross a grid.
    fn default() -> Self {
        Self {
            cells: 32,
            cascades: 3,
            eye: Vec3::ZERO,
            texels: 256 * 256,
            steps: 32,
            occlusion: true,
            bounces: true,
            two_sided: false,
        }
    }
}

/// Grids of light of a scene.
pub struct Lpv {
    scene: Scene,
    settings: LpvSettings,
    /// The finest first.
    grids: Vec<Grid>,
}

impl Lpv {
    /// Finds what blocks light; all is dark.
    ///
    /// # Errors
    /// [`Error::Setting`] for what is out of range.
    pub fn new(scene: &Scene, settings: LpvSettings) -> Result<Self, Error> {
        check(&settings)?;
        let shapes = shapes(scene, &settings);
        let blocking = settings.occlusion.then_some(settings.two_sided);
        let grids = shapes.into_iter().map(|shape| Grid::new(scene, shape, blocking)).collect();
        Ok(Self { scene: scene.clone(), settings, grids })
    }

    /// A whole light update: virtual points, injection and propagation. On all cores; the result does not depend on
    /// their number.
    ///
    /// # Errors
    /// [`Error::Scene`] for lighting that does not suit the scene.
    pub fn update(&mut self, lighting: &Lighting) -> Result<(), Error> {
        self.scene.set_lighting(lighting.clone())?;
        let lights = virtual_lights(&self.scene, self.settings.texels);
        for grid in &mut self.grids {
            grid.inject(&lights);
            for step in 0..self.settings.steps {
                grid.step(step == 0, self.settings.bounces);
            }
        }
        Ok(())
    }

    /// Indirect irradiance at points, W/m², on all cores.
    pub fn irradiance_at(&self, points: &[ViewedPoint]) -> Vec<Vec3> {
        points.par_iter().map(|p| self.lookup(p.position, p.normal)).collect()
    }

    /// Cells of each grid along the axes, and their edge, m; the finest first.
    pub fn grids(&self) -> impl Iterator<Item = ([u32; 3], f32)> {
        self.grids.iter().map(|grid| (grid.shape.counts.as_uvec3().to_array(), grid.shape.edge))
    }

    /// Bytes of all grids in the paper's formats, without the virtual points of an update.
    pub fn bytes(&self) -> u64 {
        self.grids.iter().map(Grid::bytes).sum()
    }

    fn lookup(&self, position: Vec3, normal: Vec3) -> Vec3 {
        let mut sum = Vec3::ZERO;
        let mut left = 1.0;
        for (grid, number) in self.grids.iter().zip(1..) {
            let is_last = number == self.grids.len();
            let share = if is_last { 1.0 } else { (grid.shape.depth(position) / BLEND).clamp(0.0, 1.0) };
            if share > 0.0 {
                sum += grid.irradiance(position, normal) * (left * share);
                left *= 1.0 - share;
            }
        }
        sum
    }
}

fn check(settings: &LpvSettings) -> Result<(), Error> {
    let LpvSettings { cells, cascades, texels, steps, eye, .. } = *settings;
    for (name, value, most) in [
        ("cells of a grid", cells, MAX_CELLS),
        ("nested grids", cascades, MAX_CASCADES),
        ("texels of a light", texels, MAX_TEXELS),
        ("steps of light", steps, MAX_STEPS),
    ] {
        if value == 0 || value > most {
            let rule = "at least 1; at most 128 cells, 8 grids, 2^22 texels, 1024 steps";
            return Err(Error::Setting { name, value: f64::from(value), rule });
        }
    }
    if !eye.is_finite() {
        return Err(Error::Setting { name: "middle of the grids", value: f64::NAN, rule: "finite" });
    }
    Ok(())
}

/// The finest first; the last holds the scene's bounds.
fn shapes(scene: &Scene, settings: &LpvSettings) -> Vec<Shape> {
    let (low, high) = scene.geometry.bounds;
    let widest = (high - low).max_element().max(f32::MIN_POSITIVE) / settings.cells as f32;
    // A little less, so that rounding adds no layer.
    let counts = |edge: f32| ((high - low) / edge - 1e-3).ceil().max(Vec3::ONE).as_ivec3();
    (0..settings.cascades)
        .rev()
        .map(|halvings| {
            let edge = widest / (1 << halvings) as f32;
            let counts = counts(edge).min(glam::IVec3::splat(settings.cells as i32));
            let size = counts.as_vec3() * edge;
            // At whole cells about the eye, within the scene.
            let about = ((settings.eye - 0.5 * size - low) / edge).round() * edge + low;
            let last = (high - size).max(low);
            // What is left over lies on both sides.
            let middle = 0.5 * (low + high - size);
            let fits = size.cmpge(high - low);
            Shape { counts, edge, low: Vec3::select(fits, middle, about.clamp(low, last)) }
        })
        .collect()
}
