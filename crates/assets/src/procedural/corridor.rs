//! A corridor with two corners: the lamp hangs at one end, the camera looks along the other.

use glam::Vec3;

use super::Built;
use super::builder::{Blocks, Builder, STANDING, UNCUT};
use super::spec::{Parameter, Values};
use crate::import::{View, lights};

/// Length of the first and the last part.
const LENGTH: Parameter = Parameter {
    name: "length",
    about: "length of the first and the last part without the corners, m",
    default: 3.0,
    range: 1.0..=50.0,
    is_whole: false,
};
/// Width of all parts.
const WIDTH: Parameter =
    Parameter { name: "width", about: "width, m", default: 1.8, range: 0.5..=5.0, is_whole: false };
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[LENGTH, WIDTH];

/// Height, m.
const HEIGHT: f32 = 2.5;
/// Length of the middle part without the corners, m.
const MIDDLE: f32 = 1.4;

/// Builds it.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    let [floor, wall, wood] =
        [b.plain("floor", [0.52, 0.48, 0.42]), b.plain("wall", [0.78, 0.76, 0.72]), b.plain("wood", [0.5, 0.34, 0.22])];
    let [length, width] = [values.get_f32(&LENGTH), values.get_f32(&WIDTH)];
    let x = [0.0, length, length + width, 2.0 * length + width];
    let z = [0.0, width, width + MIDDLE, 2.0 * width + MIDDLE];
    let solid = |c: [i32; 3]| {
        let first = c[2] == 0 && (0..=1).contains(&c[0]);
        let middle = c[0] == 1 && (0..=2).contains(&c[2]);
        let last = c[2] == 2 && (1..=2).contains(&c[0]);
        c[1] != 0 || !(first || middle || last)
    };
    let material = |axis: usize, positive: bool, _: [i32; 3]| if axis == 1 && positive { floor } else { wall };
    b.object("corridor");
    b.blocks(&Blocks { lines: [&x, &[0.0, HEIGHT], &z], solid: &solid, material: &material, edge: UNCUT });
    b.object("bench");
    let end = x[3];
    let bench = Vec3::new(end - 0.7 * length, 0.0, z[2] + 0.02);
    b.cuboid(wood, bench, bench + Vec3::new(0.3 * length, 0.45, 0.25 * width), STANDING);
    // Down: z × −x = −y; one centimetre below the ceiling.
    let size = Vec3::new(0.15 * length, 0.0, 0.4 * width);
    let corner = Vec3::new(0.05 * length + size.x, HEIGHT - 0.01, 0.3 * width);
    let lamp = lights::rect(corner, Vec3::Z * size.z, Vec3::NEG_X * size.x, Vec3::new(80.0, 74.0, 64.0))?;
    let view = View {
        eye: Vec3::new(end - 0.06 * length, 1.5, z[2] + 0.55 * width),
        target: Vec3::new(x[1], 1.2, z[2] + 0.45 * width),
        up: Vec3::Y,
        vertical_fov_degrees: 60.0,
    };
    Ok(Built {
        mesh: b.mesh,
        lights: vec![lamp],
        sky: Vec3::ZERO,
        view,
        exposure_stops: 2.0,
        tracks: Vec::new(),
        moving: Vec::new(),
    })
}
