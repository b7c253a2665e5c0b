//! Two offices and a corridor, lit by rectangle lights in the ceiling and by luminous panels that hang over the desks.

use glam::Vec3;

use super::builder::{ALL_SIDES, Blocks, Builder, STANDING, UPRIGHT};
use super::spec::{Parameter, Values};
use super::{Built, moving, pattern};
use crate::import::draft::MaterialDraft;
use crate::import::{View, lights};

/// Grid planes: partition 4.80 … 4.92, doors 3.4 … 4.3 and 5.4 … 6.3, corridor wall 4.20 … 4.32, lintels from 2.1.
const X: [f32; 8] = [0.0, 3.4, 4.3, 4.8, 4.92, 5.4, 6.3, 9.7];
const Y: [f32; 3] = [0.0, 2.1, 2.8];
const Z: [f32; 4] = [0.0, 4.2, 4.32, 6.0];

/// Parts of furniture go so far into each other.
const OVERLAP: f32 = 0.005;

/// A person walks past the desks.
const PERSON: Parameter = moving::flag("person", "with somebody who walks");
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[PERSON];
/// From where, and where to, m.
const WALK: [Vec3; 2] = [Vec3::new(0.9, 0.0, 2.5), Vec3::new(3.7, 0.0, 2.3)];

struct Materials {
    white: u32,
    carpet: u32,
    wood: u32,
    metal: u32,
    dark: u32,
    fabric: u32,
    accent: u32,
    panel: u32,
}

/// Builds it.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    let m = Materials {
        white: b.plain("paint", [0.78, 0.77, 0.74]),
        carpet: b.material(MaterialDraft { albedo_picture: Some(pattern::carpet()), ..MaterialDraft::new("carpet") }),
        wood: b.material(MaterialDraft { albedo_picture: Some(pattern::wood()), ..MaterialDraft::new("wood") }),
        metal: b.plain("metal", [0.55, 0.56, 0.58]),
        dark: b.plain("screen", [0.05, 0.05, 0.06]),
        fabric: b.plain("fabric", [0.12, 0.22, 0.38]),
        accent: b.plain("accent wall", [0.62, 0.28, 0.16]),
        panel: b.material(MaterialDraft {
            albedo: Vec3::splat(0.8),
            radiance: Vec3::new(22.0, 20.0, 17.0),
            ..MaterialDraft::new("luminous panel")
        }),
    };
    rooms(&mut b, &m);
    for (x, z) in [(0.5, 0.6), (2.5, 0.6), (5.6, 0.6), (7.6, 0.6)] {
        desk(&mut b, &m, x, z);
        chair(&mut b, &m, x + 0.8, z + 1.15);
    }
    for (name, low, high) in [
        ("cupboard", Vec3::new(0.02, 0.0, 2.6), Vec3::new(0.47, 1.9, 4.0)),
        ("sideboard", Vec3::new(9.2, 0.0, 1.9), Vec3::new(9.68, 0.85, 3.9)),
        ("corridor bench", Vec3::new(7.2, 0.0, 5.5), Vec3::new(9.0, 0.45, 5.95)),
    ] {
        b.object(name);
        b.cuboid(m.wood, low, high, STANDING);
    }
    for x in [5.75, 7.75] {
        pendant(&mut b, &m, Vec3::new(x, 2.25, 0.95));
    }
    // Down: z × −x = −y; one centimetre below the ceiling.
    let ceiling = |x: f32, z: f32, width: f32, depth: f32, radiance: Vec3| {
        let corner = Vec3::new(x + width, Y[2] - 0.01, z);
        lights::rect(corner, Vec3::Z * depth, Vec3::NEG_X * width, radiance)
    };
    let warm = Vec3::new(16.0, 14.6, 12.4);
    let lamps = vec![
        ceiling(0.9, 1.2, 1.2, 0.3, warm)?,
        ceiling(0.9, 2.8, 1.2, 0.3, warm)?,
        ceiling(2.9, 2.0, 1.2, 0.3, warm)?,
        ceiling(1.5, 5.06, 1.5, 0.2, warm)?,
        ceiling(6.5, 5.06, 1.5, 0.2, warm)?,
    ];
    let mut moving = Vec::new();
    if values.get(&PERSON) != 0.0 {
        let clothes = [b.plain("jacket", [0.6, 0.12, 0.1]), b.plain("skin", [0.66, 0.46, 0.36])];
        moving = moving::person(&mut b, clothes, WALK);
    }
    let view = View {
        eye: Vec3::new(4.35, 1.55, 3.9),
        target: Vec3::new(1.2, 0.95, 0.3),
        up: Vec3::Y,
        vertical_fov_degrees: 62.0,
    };
    Ok(Built { mesh: b.mesh, lights: lamps, sky: Vec3::ZERO, view, exposure_stops: 0.3, tracks: Vec::new(), moving })
}

fn rooms(b: &mut Builder, m: &Materials) {
    b.object("rooms");
    let solid = |c: [i32; 3]| {
        let inside = (0..7).contains(&c[0]) && (0..2).contains(&c[1]) && (0..3).contains(&c[2]);
        let partition = c[0] == 3 && c[2] == 0;
        let corridor_wall = c[2] == 1 && !((c[0] == 1 || c[0] == 5) && c[1] == 0);
        !inside || partition || corridor_wall
    };
    let material = |axis: usize, positive: bool, air: [i32; 3]| match (axis, positive) {
        (1, true) if air[2] == 0 => m.carpet,
        (1, true) => m.wood,
        // The wall at x = 0 of the first office.
        (0, true) if air[0] == 0 && air[2] == 0 => m.accent,
        _ => m.white,
    };
    b.blocks(&Blocks { lines: [&X, &Y, &Z], solid: &solid, material: &material, edge: 1.3 });
}

/// A desk with its near left foot at (x, z), 1.6 m wide, and a screen on it.
fn desk(b: &mut Builder, m: &Materials, x: f32, z: f32) {
    b.object("desk");
    b.cuboid(m.wood, Vec3::new(x, 0.72, z), Vec3::new(x + 1.6, 0.75, z + 0.8), ALL_SIDES);
    for foot in [x + 0.05, x + 1.52] {
        let low = Vec3::new(foot, 0.0, z + 0.05);
        let high = Vec3::new(foot + 0.03, 0.72 + OVERLAP, z + 0.75);
        b.cuboid(m.metal, low, high, UPRIGHT);
    }
    b.object("screen");
    let low = Vec3::new(x + 0.5, 0.85, z + 0.2);
    let high = Vec3::new(x + 1.1, 1.2, z + 0.23);
    b.cuboid(m.dark, low, high, ALL_SIDES);
    let low = Vec3::new(x + 0.77, 0.75 - OVERLAP, z + 0.205);
    let high = Vec3::new(x + 0.83, 0.85 + OVERLAP, z + 0.225);
    b.cuboid(m.metal, low, high, UPRIGHT);
}

/// A chair with the middle of its seat at (x, z), facing −z.
fn chair(b: &mut Builder, m: &Materials, x: f32, z: f32) {
    b.object("chair");
    b.cuboid(m.fabric, Vec3::new(x - 0.24, 0.42, z - 0.24), Vec3::new(x + 0.24, 0.48, z + 0.24), ALL_SIDES);
    b.cuboid(m.fabric, Vec3::new(x - 0.22, 0.55, z + 0.2), Vec3::new(x + 0.22, 0.98, z + 0.235), ALL_SIDES);
    let low = Vec3::new(x - 0.03, 0.48 - OVERLAP, z + 0.205);
    let high = Vec3::new(x + 0.03, 0.55 + OVERLAP, z + 0.23);
    b.cuboid(m.metal, low, high, UPRIGHT);
    b.cuboid(m.metal, Vec3::new(x - 0.03, 0.04, z - 0.03), Vec3::new(x + 0.03, 0.42 + OVERLAP, z + 0.03), UPRIGHT);
    b.cuboid(m.metal, Vec3::new(x - 0.25, 0.0, z - 0.25), Vec3::new(x + 0.25, 0.04, z + 0.25), STANDING);
}

/// A lamp that hangs on two rods; its underside shines.
fn pendant(b: &mut Builder, m: &Materials, low: Vec3) {
    b.object("pendant");
    let high = low + Vec3::new(1.3, 0.06, 0.2);
    b.cuboid(m.metal, low, high, STANDING);
    b.cuboid_side(m.panel, low, high, 2);
    for x in [low.x + 0.2, low.x + 1.1] {
        let foot = Vec3::new(x, high.y - OVERLAP, low.z + 0.09);
        let head = Vec3::new(x + 0.02, Y[2], low.z + 0.11);
        b.cuboid(m.metal, foot, head, UPRIGHT);
    }
}
