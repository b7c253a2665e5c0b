//! Closed boxes with a known answer.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use super::Built;
use super::builder::{ALL_SIDES, Builder};
use crate::import::draft::MaterialDraft;
use crate::import::{View, lights};

/// A closed box of 2 m, front inside, reflectance ½, exitance 1 W/m² everywhere: H = M/(1 − ρ) = 2 W/m² at every point.
pub fn furnace() -> Built {
    let mut b = Builder::default();
    let wall = MaterialDraft { radiance: Vec3::splat(FRAC_1_PI), ..MaterialDraft::new("wall") };
    let wall = b.material(wall);
    b.object("box");
    inside_out(&mut b, wall, Vec3::splat(-1.0), Vec3::ONE);
    let view = View { eye: Vec3::new(0.0, 0.0, 0.9), target: Vec3::ZERO, up: Vec3::Y, vertical_fov_degrees: 70.0 };
    Built {
        mesh: b.mesh,
        lights: Vec::new(),
        sky: Vec3::ZERO,
        view,
        exposure_stops: 0.0,
        tracks: Vec::new(),
        moving: Vec::new(),
    }
}

/// A closed box of 2 m with walls without thickness over a sunny ground; the camera is inside, where no light may be.
pub fn sealed() -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    let wall = b.plain("wall", [0.7, 0.7, 0.7]);
    let earth = b.plain("ground", [0.4, 0.38, 0.35]);
    b.object("box");
    inside_out(&mut b, wall, Vec3::new(-1.0, 0.5, -1.0), Vec3::new(1.0, 2.5, 1.0));
    b.object("ground");
    b.cuboid_side(earth, Vec3::new(-5.0, -1.0, -5.0), Vec3::new(5.0, 0.0, 5.0), 3);
    let sun = lights::directional(Vec3::new(0.4, -1.0, -0.3), Vec3::new(30.0, 28.0, 25.0))?;
    let view = View {
        eye: Vec3::new(0.0, 1.5, 0.9),
        target: Vec3::new(0.0, 1.5, 0.0),
        up: Vec3::Y,
        vertical_fov_degrees: 70.0,
    };
    Ok(Built {
        mesh: b.mesh,
        lights: vec![sun],
        sky: Vec3::new(1.2, 1.6, 2.4),
        view,
        exposure_stops: 0.0,
        tracks: Vec::new(),
        moving: Vec::new(),
    })
}

/// A closed box whose fronts are inside.
pub fn inside_out(b: &mut Builder, material: u32, low: Vec3, high: Vec3) {
    let first = b.mesh.triangles.len();
    b.cuboid(material, low, high, ALL_SIDES);
    for t in &mut b.mesh.triangles[first..] {
        t.corners.swap(1, 2);
        t.uvs.swap(1, 2);
    }
}
