//! A room that the sun enters through the slats of a blind: thin stripes of sun on the floor and a wall.

use glam::Vec3;

use super::Built;
use super::builder::{Builder, sin_cos};
use super::shell::Shell;
use super::spec::{Parameter, Values};
use crate::import::{View, lights};

/// Number of slats.
const SLATS: Parameter =
    Parameter { name: "slats", about: "number of slats", default: 16.0, range: 0.0..=64.0, is_whole: true };
/// Angle of the slats.
const TILT: Parameter = Parameter {
    name: "tilt",
    about: "angle by which the outer edges of the slats are raised, degrees",
    default: 10.0,
    range: -80.0..=80.0,
    is_whole: false,
};
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[SLATS, TILT];

/// Room, and the window in its wall at x = 0, m.
const SHELL: Shell = Shell { size: Vec3::new(5.0, 2.7, 4.0), wall: 0.2, axis: 0, along: [1.0, 3.0], up: [0.9, 2.1] };
/// Depth of a slat where there are 16 of them, its thickness, and its distance from the sides of the window, m.
const DEPTH: f32 = 0.08;
const THICKNESS: f32 = 0.002;
const SIDE: f32 = 0.01;

/// Builds it.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    SHELL.build(&mut b);
    let slat = b.plain("slat", [0.7, 0.68, 0.64]);
    b.object("blind");
    let count = values.count(&SLATS);
    let pitch = (SHELL.up[1] - SHELL.up[0]) / count.max(1) as f32;
    let depth = DEPTH.min(1.1 * pitch);
    let (sin, cos) = sin_cos(values.get_f32(&TILT) / 360.0);
    // From the outer edge to the inner one, and up from the slat.
    let inwards = Vec3::new(cos, -sin, 0.0);
    let across = Vec3::new(sin, cos, 0.0);
    let along = Vec3::Z * (SHELL.along[1] - SHELL.along[0] - 2.0 * SIDE);
    for k in 0..count {
        let middle = Vec3::new(-0.5 * SHELL.wall, SHELL.up[0] + pitch * (k as f32 + 0.5), SHELL.along[0] + SIDE);
        let corner = middle - 0.5 * depth * inwards - 0.5 * THICKNESS * across;
        b.slab(slat, corner, [depth * inwards, THICKNESS * across, along]);
    }
    let wood = b.plain("wood", [0.46, 0.32, 0.22]);
    SHELL.table(&mut b, wood, Vec3::new(2.2, 0.0, 1.6), Vec3::new(1.2, 0.74, 0.7));
    let sun = lights::directional(Vec3::new(0.8, -0.58, 0.15), Vec3::new(30.0, 28.0, 25.0))?;
    let view = View {
        eye: Vec3::new(4.7, 1.55, 3.7),
        target: Vec3::new(0.8, 1.0, 1.0),
        up: Vec3::Y,
        vertical_fov_degrees: 62.0,
    };
    let sky = Vec3::new(1.2, 1.6, 2.4);
    Ok(Built {
        mesh: b.mesh,
        lights: vec![sun],
        sky,
        view,
        exposure_stops: 1.0,
        tracks: Vec::new(),
        moving: Vec::new(),
    })
}
