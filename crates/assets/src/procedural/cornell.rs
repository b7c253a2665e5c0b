//! The Cornell Box: the measurements that Cornell University published (millimetres), right-handed as published.

use glam::Vec3;

use super::builder::Builder;
use super::spec::{Parameter, Values};
use super::{Built, metres, moving};
use crate::import::{View, lights};

/// Corners of a quadrilateral, mm, counter-clockwise from the air.
type Quad = [[f32; 3]; 4];

const FLOOR: Quad = [[552.8, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 559.2], [549.6, 0.0, 559.2]];
const CEILING: Quad = [[556.0, 548.8, 0.0], [556.0, 548.8, 559.2], [0.0, 548.8, 559.2], [0.0, 548.8, 0.0]];
const BACK: Quad = [[549.6, 0.0, 559.2], [0.0, 0.0, 559.2], [0.0, 548.8, 559.2], [556.0, 548.8, 559.2]];
const RIGHT: Quad = [[0.0, 0.0, 559.2], [0.0, 0.0, 0.0], [0.0, 548.8, 0.0], [0.0, 548.8, 559.2]];
const LEFT: Quad = [[552.8, 0.0, 0.0], [549.6, 0.0, 559.2], [556.0, 548.8, 559.2], [556.0, 548.8, 0.0]];
/// Feet of the blocks in the order of their published tops, x and z, and heights.
const SHORT: ([[f32; 2]; 4], f32) = ([[130.0, 65.0], [82.0, 225.0], [240.0, 272.0], [290.0, 114.0]], 165.0);
const TALL: ([[f32; 2]; 4], f32) = ([[423.0, 247.0], [265.0, 296.0], [314.0, 456.0], [472.0, 406.0]], 330.0);

const WHITE: [f32; 3] = [0.725, 0.71, 0.68];
const RED: [f32; 3] = [0.63, 0.065, 0.05];
const GREEN: [f32; 3] = [0.14, 0.45, 0.091];

/// Radiance of the lamp, W/m²/sr.
const LAMP: Vec3 = Vec3::new(17.0, 12.0, 4.0);
/// The lamp lies in the ceiling; so much below it, m, it is not in the ceiling's own plane.
const LAMP_GAP: f32 = 0.001;

/// The tall block turns once in [`SECONDS`].
const BLOCK: Parameter = moving::flag("block", "turns the tall block");
const SECONDS: f32 = 4.0;
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[BLOCK];

/// A block on these feet about a place, with a lower face where it is `closed`.
fn block(b: &mut Builder, material: u32, (feet, height): ([[f32; 2]; 4], f32), about: Vec3, closed: bool) {
    let at = |k: usize, y: f32| metres([feet[k % 4][0], y, feet[k % 4][1]]) - about.with_y(0.0);
    b.plain_quad(material, [0, 1, 2, 3].map(|k| at(k, height)));
    for k in 0..4 {
        b.plain_quad(material, [at(k + 1, 0.0), at(k + 1, height), at(k, height), at(k, 0.0)]);
    }
    if closed {
        b.plain_quad(material, [3, 2, 1, 0].map(|k| at(k, 0.0)));
    }
}

/// Builds it. The lamp is a rectangle light, so that it can move.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    let materials = [b.plain("white", WHITE), b.plain("red", RED), b.plain("green", GREEN)];
    let walls =
        [("floor", FLOOR, 0), ("ceiling", CEILING, 0), ("back", BACK, 0), ("right", RIGHT, 2), ("left", LEFT, 1)];
    for (name, quad, material) in walls {
        b.object(name);
        b.plain_quad(materials[material], quad.map(metres));
    }
    b.object("short block");
    block(&mut b, materials[0], SHORT, Vec3::ZERO, false);
    let mut moving = Vec::new();
    if values.get(&BLOCK) == 0.0 {
        b.object("tall block");
        block(&mut b, materials[0], TALL, Vec3::ZERO, false);
    } else {
        let middle: Vec3 = TALL.0.iter().map(|foot| metres([foot[0], 0.0, foot[1]])).sum::<Vec3>() / 4.0;
        let middle = middle + Vec3::Y * LAMP_GAP;
        let turning = moving::turning(&mut b, materials[0], middle, SECONDS, |b| {
            block(b, materials[0], TALL, middle, true);
        });
        moving.push(turning);
    }
    let corner = metres([343.0, 548.8, 227.0]) - Vec3::Y * LAMP_GAP;
    let lamp = lights::rect(corner, metres([0.0, 0.0, 105.0]), metres([-130.0, 0.0, 0.0]), LAMP)?;
    // Down: z × −x = −y.
    let view = View {
        eye: metres([278.0, 273.0, -800.0]),
        target: metres([278.0, 273.0, 0.0]),
        up: Vec3::Y,
        // Focal length 35 mm, film 25 mm: 2·atan(12.5/35).
        vertical_fov_degrees: 39.307_65,
    };
    Ok(Built {
        mesh: b.mesh,
        lights: vec![lamp],
        sky: Vec3::ZERO,
        view,
        exposure_stops: 1.8,
        tracks: Vec::new(),
        moving,
    })
}
