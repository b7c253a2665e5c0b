//! A room with shining panes close behind the frames of three windows in deep reveals, the middle one arched, blinds half
//! down before the others: thin bright edges, and light that falls off within millimetres.

use glam::Vec3;

use super::Built;
use super::builder::{ALL_SIDES, Blocks, Builder, UNCUT, sin_cos};
use super::spec::{Parameter, Values};
use crate::import::draft::MaterialDraft;
use crate::import::{View, lights};

/// Distance of the panes.
const PANE: Parameter = Parameter {
    name: "pane",
    about: "distance of the shining panes behind the frames, m",
    default: 0.02,
    range: 0.002..=0.1,
    is_whole: false,
};
/// Length of the blinds.
const BLIND: Parameter = Parameter {
    name: "blind",
    about: "share of the outer windows that blinds cover",
    default: 0.5,
    range: 0.0..=1.0,
    is_whole: false,
};
/// Parts of the arch.
const SEGMENTS: Parameter = Parameter {
    name: "segments",
    about: "straight parts of the arch",
    default: 24.0,
    range: 2.0..=96.0,
    is_whole: true,
};
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[PANE, BLIND, SEGMENTS];

/// Inside of the room, m; the windows are in its wall at z = 0.
const SIZE: Vec3 = Vec3::new(4.6, 2.8, 4.6);
/// Thickness of the walls, m.
const WALL: f32 = 0.35;
/// From where to where the windows go along the wall, and up, m.
const ALONG: [[f32; 2]; 3] = [[0.4, 1.2], [1.7, 2.9], [3.4, 4.2]];
const UP: [f32; 2] = [0.75, 2.2];
/// The frames lie between these depths; width of their bars, m.
const FRAME: [f32; 2] = [-0.2, -0.16];
const BAR: f32 = 0.045;
/// Slats: distance, depth, thickness, middle of their depth, m; the angle by which their outer edges are raised, as a
/// share of a full circle; distance from the sides of the window, m.
const PITCH: f32 = 0.04;
const SLAT: [f32; 2] = [0.042, 0.001];
const MIDDLE: f32 = -0.1;
const TILT: f32 = 0.1;
const SIDE: f32 = 0.01;
/// Radiance of the panes, W/m²/sr.
const RADIANCE: Vec3 = Vec3::new(9.0, 9.6, 10.5);

/// Builds it.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    room(&mut b);
    let [frame, slat, wood] =
        [b.plain("frame", [0.74, 0.73, 0.7]), b.plain("slat", [0.66, 0.62, 0.54]), b.plain("wood", [0.42, 0.29, 0.2])];
    let pane = b.material(MaterialDraft { radiance: RADIANCE, albedo: Vec3::splat(0.2), ..MaterialDraft::new("pane") });
    let depth = FRAME[0] - values.get_f32(&PANE);
    for (k, along) in ALONG.into_iter().enumerate() {
        b.object(&format!("frame {}", k + 1));
        match k {
            1 => arch(&mut b, frame, along, values.count(&SEGMENTS)),
            _ => straight_frame(&mut b, frame, along),
        }
        b.object(&format!("pane {}", k + 1));
        b.face(pane, 2, true, depth, along, UP);
        if k != 1 {
            b.object(&format!("blind {}", k + 1));
            blind(&mut b, slat, along, values.get_f32(&BLIND));
        }
    }
    b.object("bench");
    b.cuboid(wood, Vec3::new(1.5, 0.42, 1.2), Vec3::new(3.1, 0.46, 1.6), ALL_SIDES);
    for x in [1.6, 2.9] {
        b.cuboid(wood, Vec3::new(x, 0.004, 1.25), Vec3::new(x + 0.08, 0.416, 1.55), ALL_SIDES);
    }
    let view = View {
        eye: Vec3::new(2.6, 1.55, 4.4),
        target: Vec3::new(2.1, 1.45, 0.0),
        up: Vec3::Y,
        vertical_fov_degrees: 54.0,
    };
    Ok(Built {
        mesh: b.mesh,
        lights: Vec::new(),
        sky: Vec3::ZERO,
        view,
        exposure_stops: 0.5,
        tracks: Vec::new(),
        moving: Vec::new(),
    })
}

/// Walls, floor and ceiling; openings go through the wall.
fn room(b: &mut Builder) {
    let [wall, floor] = [b.plain("wall", [0.72, 0.7, 0.66]), b.plain("floor", [0.44, 0.36, 0.28])];
    let [[a, c], [d, e], [f, g]] = ALONG;
    let x = [-WALL, 0.0, a, c, d, e, f, g, SIZE.x, SIZE.x + WALL];
    let y = [-WALL, 0.0, UP[0], UP[1], SIZE.y, SIZE.y + WALL];
    let z = [-WALL, 0.0, SIZE.z, SIZE.z + WALL];
    let solid = |cell: [i32; 3]| {
        let is_in_block = (0..=8).contains(&cell[0]) && (0..=4).contains(&cell[1]) && (0..=2).contains(&cell[2]);
        let is_room = (1..=7).contains(&cell[0]) && (1..=3).contains(&cell[1]) && cell[2] == 1;
        let is_window = [2, 4, 6].contains(&cell[0]) && cell[1] == 2 && cell[2] == 0;
        is_in_block && !is_room && !is_window
    };
    let material = |axis: usize, positive: bool, air: [i32; 3]| {
        if axis == 1 && positive && air[2] == 1 { floor } else { wall }
    };
    b.object("room");
    b.blocks(&Blocks { lines: [&x, &y, &z], solid: &solid, material: &material, edge: UNCUT });
}

/// Bars round a window, and one across its middle.
fn straight_frame(b: &mut Builder, material: u32, [left, right]: [f32; 2]) {
    let middle = 0.5 * (UP[0] + UP[1]);
    let x = [left, left + BAR, right - BAR, right];
    let y = [UP[0], UP[0] + BAR, middle - 0.5 * BAR, middle + 0.5 * BAR, UP[1] - BAR, UP[1]];
    // Bars go on into the wall, so that no face lies in its planes.
    let solid = |c: [i32; 3]| {
        let is_bar = c[0].clamp(0, 2) != 1 || c[1].clamp(0, 4) % 2 == 0;
        c[2] == 0 && is_bar
    };
    b.blocks(&Blocks { lines: [&x, &y, &FRAME], solid: &solid, material: &|_, _, _| material, edge: UNCUT });
}

/// Fills the corners above a half circle through the whole depth of the wall, and sets a frame below it and at the
/// sides.
fn arch(b: &mut Builder, material: u32, [left, right]: [f32; 2], segments: usize) {
    let radius = 0.5 * (right - left);
    let foot = Vec3::new(left + radius, UP[1] - radius, 0.0);
    let at = |k: usize, r: f32, z: f32| {
        let (sin, cos) = sin_cos(0.5 * k as f32 / segments as f32);
        foot + Vec3::new(r * cos, r * sin, z)
    };
    for k in 0..segments {
        let corner = Vec3::new(if 2 * k < segments { right } else { left }, UP[1], 0.0);
        for (z, is_front) in [(0.0, true), (-WALL, false)] {
            let [p, q] = [at(k, radius, z), at(k + 1, radius, z)];
            let third = corner + Vec3::Z * z;
            let corners = if is_front { [p, third, q] } else { [q, third, p] };
            b.triangle(material, corners, [glam::Vec2::ZERO; 3]);
        }
        // Below the corners, to the middle of the circle.
        let soffit = |r: f32, [back, front]: [f32; 2]| {
            [at(k, r, front), at(k + 1, r, front), at(k + 1, r, back), at(k, r, back)]
        };
        b.plain_quad(material, soffit(radius, [FRAME[1], 0.0]));
        b.plain_quad(material, soffit(radius, [-WALL, FRAME[0]]));
        let inner = radius - BAR;
        b.plain_quad(material, soffit(inner, FRAME));
        let ring = |z: f32| [at(k, inner, z), at(k, radius, z), at(k + 1, radius, z), at(k + 1, inner, z)];
        b.plain_quad(material, ring(FRAME[1]));
        let [p, q, r, s] = ring(FRAME[0]);
        b.plain_quad(material, [p, s, r, q]);
    }
    let [low, high] = [UP[0], foot.y];
    for [from, to] in [[left, left + BAR], [right - BAR, right]] {
        let sides = [from > left, to < right, false, false, true, true];
        b.cuboid(material, Vec3::new(from, low, FRAME[0]), Vec3::new(to, high, FRAME[1]), sides);
    }
}

/// Slats from the upper end of a window down.
fn blind(b: &mut Builder, material: u32, [left, right]: [f32; 2], share: f32) {
    let (sin, cos) = sin_cos(TILT);
    let inwards = Vec3::new(0.0, -sin, cos);
    let up = Vec3::new(0.0, cos, sin);
    let along = Vec3::X * (right - left - 2.0 * SIDE);
    let count = ((UP[1] - UP[0]) * share / PITCH) as usize;
    for k in 0..count {
        let middle = Vec3::new(left + SIDE, UP[1] - PITCH * (k as f32 + 0.75), MIDDLE);
        let corner = middle - 0.5 * SLAT[0] * inwards - 0.5 * SLAT[1] * up;
        b.slab(material, corner, [along, SLAT[1] * up, SLAT[0] * inwards]);
    }
}
