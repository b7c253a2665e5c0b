//! A room full of thin and small things: chairs with thin legs, knobs, frames; a lamp, and a small patch of sun.

use glam::Vec3;

use super::Built;
use super::builder::{ALL_SIDES, Builder, STANDING, UPRIGHT};
use super::shell::{OVERLAP, Shell};
use super::spec::{Parameter, Values};
use crate::import::{View, lights};

/// Number of chairs.
const CHAIRS: Parameter =
    Parameter { name: "chairs", about: "number of chairs", default: 8.0, range: 0.0..=12.0, is_whole: true };
/// Thickness of their legs.
const LEG: Parameter = Parameter {
    name: "leg",
    about: "thickness of the chairs' legs, m",
    default: 0.01,
    range: 0.002..=0.05,
    is_whole: false,
};
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[CHAIRS, LEG];

/// Room, and the window in its wall at x = 0, m.
const SHELL: Shell = Shell { size: Vec3::new(5.0, 2.6, 4.0), wall: 0.2, axis: 0, along: [1.5, 2.2], up: [1.2, 1.9] };

/// Sides of what hangs on the wall z = 0: all but the one on the wall.
const ON_WALL_Z: [bool; 6] = [true, true, true, true, false, true];

/// Builds it.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    SHELL.build(&mut b);
    let [wood, metal] = [b.plain("wood", [0.5, 0.34, 0.22]), b.plain("metal", [0.55, 0.56, 0.58])];
    let [fabric, print] = [b.plain("fabric", [0.25, 0.36, 0.5]), b.plain("print", [0.7, 0.55, 0.35])];
    SHELL.table(&mut b, wood, Vec3::new(1.5, 0.0, 1.5), Vec3::new(1.6, 0.75, 0.8));
    let leg = values.get_f32(&LEG);
    for k in 0..values.count(&CHAIRS) {
        let column = k % 4;
        let row = k / 4;
        let x = 0.75 + 0.95 * column as f32;
        // Two rows on both sides of the table, and one behind.
        let (z, facing) = [(1.0, 1.0), (2.8, -1.0), (3.5, -1.0)][row];
        chair(&mut b, [metal, fabric], Vec3::new(x, 0.0, z), facing, leg);
    }
    cupboard(&mut b, wood, metal);
    for (k, left) in [0.5, 1.2, 1.9].into_iter().enumerate() {
        let low = Vec3::new(left, 1.25 + 0.1 * (k % 2) as f32, 0.0);
        picture_frame(&mut b, [wood, print], low, 0.5, 0.65);
    }
    door(&mut b, wood, metal);
    // Down: z × −x = −y; one centimetre below the ceiling.
    let corner = Vec3::new(2.9, SHELL.size.y - 0.01, 1.85);
    let lamp = lights::rect(corner, Vec3::Z * 0.3, Vec3::NEG_X * 0.8, Vec3::new(14.0, 12.6, 10.6))?;
    let sun = lights::directional(Vec3::new(0.8, -0.55, 0.05), Vec3::new(30.0, 28.0, 25.0))?;
    let view = View {
        eye: Vec3::new(4.5, 1.6, 3.75),
        target: Vec3::new(1.7, 0.8, 0.8),
        up: Vec3::Y,
        vertical_fov_degrees: 62.0,
    };
    let sky = Vec3::new(1.2, 1.6, 2.4);
    Ok(Built {
        mesh: b.mesh,
        lights: vec![lamp, sun],
        sky,
        view,
        exposure_stops: 1.0,
        tracks: Vec::new(),
        moving: Vec::new(),
    })
}

/// A chair with the middle of its seat above `at`, its back to the other side than `facing` (1 or −1 along z).
fn chair(b: &mut Builder, [metal, fabric]: [u32; 2], at: Vec3, facing: f32, leg: f32) {
    const HALF: f32 = 0.2;
    const SEAT: [f32; 2] = [0.44, 0.46];
    const BACK: f32 = 0.9;
    b.object("chair");
    let low = at + Vec3::new(-HALF, SEAT[0], -HALF);
    let high = at + Vec3::new(HALF, SEAT[1], HALF);
    b.cuboid(fabric, low, high, ALL_SIDES);
    // So far do the legs stand inside the edge of the seat.
    let inset = HALF - 0.02 - 0.5 * leg;
    let post = |x: f32, z: f32, foot: f32, top: f32| {
        let middle = at + Vec3::new(x, 0.0, z);
        let half = Vec3::new(0.5 * leg, 0.0, 0.5 * leg);
        ((middle - half).with_y(at.y + foot), (middle + half).with_y(at.y + top))
    };
    for x in [-inset, inset] {
        for z in [-inset, inset] {
            let (low, high) = post(x, z, 0.0, SEAT[0] + OVERLAP);
            b.cuboid(metal, low, high, UPRIGHT);
        }
        let (low, high) = post(x, -facing * inset, SEAT[1] - OVERLAP, BACK);
        b.cuboid(metal, low, high, STANDING);
    }
    // The rail goes through both posts, a little thicker than they.
    let rail = Vec3::new(inset + leg, 0.0, 0.7 * leg);
    let middle = at + Vec3::new(0.0, 0.0, -facing * inset);
    b.cuboid(fabric, (middle - rail).with_y(at.y + 0.72), (middle + rail).with_y(at.y + 0.86), ALL_SIDES);
}

/// A cupboard before the wall z = 0 with four doors, each with a knob.
fn cupboard(b: &mut Builder, wood: u32, metal: u32) {
    const LEFT: f32 = 2.7;
    const FRONT: f32 = 0.42;
    const LEAF: Vec3 = Vec3::new(0.37, 1.6, 0.01);
    const KNOB: f32 = 0.015;
    b.object("cupboard");
    b.cuboid(wood, Vec3::new(LEFT, 0.0, 0.02), Vec3::new(LEFT + 1.6, 1.8, FRONT), STANDING);
    for k in 0..4 {
        let low = Vec3::new(LEFT + 0.02 + 0.395 * k as f32, 0.1, FRONT - OVERLAP);
        let high = low + LEAF;
        b.cuboid(wood, low, high, ON_WALL_Z);
        let x = if k % 2 == 0 { high.x - 0.05 } else { low.x + 0.05 };
        b.ball(metal, Vec3::new(x, 0.95, high.z + 0.8 * KNOB), KNOB);
    }
}

/// A print on the wall z = 0 with bars round it.
fn picture_frame(b: &mut Builder, [wood, print]: [u32; 2], low: Vec3, width: f32, height: f32) {
    const BAR: f32 = 0.02;
    const DEPTH: f32 = 0.015;
    const GAP: f32 = 0.004;
    b.object("picture");
    let high = low + Vec3::new(width, height, DEPTH);
    b.face(print, 2, true, GAP, [low.x + BAR, high.x - BAR], [low.y + BAR, high.y - BAR]);
    for x in [low.x, high.x - BAR] {
        b.cuboid(wood, Vec3::new(x, low.y, 0.0), Vec3::new(x + BAR, high.y, DEPTH), ON_WALL_Z);
    }
    // Between the upright bars: their ends lie on those.
    let without_ends = [false, false, true, true, false, true];
    for y in [low.y, high.y - BAR] {
        let left = Vec3::new(low.x + BAR, y, 0.0);
        let right = Vec3::new(high.x - BAR, y + BAR, DEPTH);
        b.cuboid(wood, left, right, without_ends);
    }
}

/// A door in the wall x = 5 with a frame and a knob.
fn door(b: &mut Builder, wood: u32, metal: u32) {
    const Z: [f32; 2] = [1.2, 2.1];
    const TOP: f32 = 2.05;
    const BAR: f32 = 0.06;
    const DEPTH: f32 = 0.02;
    const GAP: f32 = 0.005;
    let wall = SHELL.size.x;
    b.object("door");
    b.face(wood, 0, false, wall - GAP, [0.0, TOP], Z);
    for z in [Z[0] - BAR, Z[1]] {
        let low = Vec3::new(wall - DEPTH, 0.0, z);
        let high = Vec3::new(wall, TOP + BAR, z + BAR);
        b.cuboid(wood, low, high, [true, false, false, true, true, true]);
    }
    let low = Vec3::new(wall - DEPTH, TOP, Z[0]);
    let high = Vec3::new(wall, TOP + BAR, Z[1]);
    b.cuboid(wood, low, high, [true, false, true, true, false, false]);
    b.ball(metal, Vec3::new(wall - 0.03, 1.0, Z[0] + 0.08), 0.02);
}
