//! What moves through built-in scenes: a person who walks, a door, a lorry, a block that turns.

use std::f32::consts::{FRAC_PI_2, TAU};

use glam::{Quat, Vec2, Vec3};
use scene::math::atan2;

use super::builder::{Builder, sin_cos};
use super::spec::Parameter;
use crate::import::{MovingObject, Pose};

/// A parameter that is there, as `NAME:KEY`, or not.
pub const fn flag(name: &'static str, about: &'static str) -> Parameter {
    Parameter { name, about, default: 0.0, range: 0.0..=1.0, is_whole: true }
}

/// Poses at even times of so many seconds.
fn poses(seconds: f32, steps: u32, at: impl Fn(f32) -> (Vec3, Quat)) -> Vec<Pose> {
    (0..=steps)
        .map(|k| {
            let time = seconds * k as f32 / steps as f32;
            let (position, rotation) = at(time);
            Pose { time, position, rotation }
        })
        .collect()
}

/// The triangles that `build` adds, taken out of the scene again, as an object.
pub fn object(
    b: &mut Builder,
    name: &str,
    material: u32,
    poses: Vec<Pose>,
    build: impl FnOnce(&mut Builder),
) -> MovingObject {
    let first = b.mesh.triangles.len();
    build(b);
    let corners = b.mesh.triangles.drain(first..).flat_map(|triangle| triangle.corners).collect();
    MovingObject { name: name.to_owned(), material: material as usize, corners, uvs: Vec::new(), poses }
}

/// A capsule from `a` to `b`, front outside.
fn capsule(b: &mut Builder, material: u32, [from, to]: [Vec3; 2], radius: f32) {
    const SIDES: u32 = 8;
    const CAP_ROWS: u32 = 2;
    let axis = (to - from).normalize();
    let across = axis.any_orthonormal_vector();
    let other = axis.cross(across);
    // From the pole of one cap to that of the other: shares of a turn, and the end about which they are.
    let share = |k: u32| 0.25 * k as f32 / CAP_ROWS as f32;
    let rows: Vec<(f32, Vec3)> =
        (0..=CAP_ROWS).map(|k| (share(k) - 0.25, from)).chain((0..=CAP_ROWS).map(|k| (share(k), to))).collect();
    let at = |row: (f32, Vec3), side: u32| {
        let round = sin_cos(side as f32 / SIDES as f32);
        let up = sin_cos(row.0);
        row.1 + radius * (axis * up.0 + (across * round.1 + other * round.0) * up.1)
    };
    let uvs = [Vec2::ZERO, Vec2::X, Vec2::Y];
    let last = rows.len() - 2;
    for (k, pair) in rows.windows(2).enumerate() {
        for side in 0..SIDES {
            let [a, b_, c, d] = [at(pair[0], side), at(pair[0], side + 1), at(pair[1], side + 1), at(pair[1], side)];
            if k > 0 {
                b.triangle(material, [a, b_, c], uvs);
            }
            if k < last {
                b.triangle(material, [a, c, d], uvs);
            }
        }
    }
}

/// Seconds and length, m, of a step of a person, and how far legs and arms swing.
const STEP: (f32, f32) = (0.5, 0.7);
const SWING: [f32; 2] = [0.45, 0.35];

/// A person of capsules who walks from one place of the floor to another.
pub fn person(b: &mut Builder, [cloth, skin]: [u32; 2], [from, to]: [Vec3; 2]) -> Vec<MovingObject> {
    let way = to - from;
    let seconds = way.length() / STEP.1 * STEP.0;
    let facing = Quat::from_rotation_y(atan2(way.x, way.z));
    let steps = (8.0 * seconds / STEP.0).ceil() as u32;
    // A part that hangs from a joint, whose swing has a sign and a size.
    let mut part = |name: &str, material: u32, joint: Vec3, swing: f32, line: [Vec3; 2], radius: f32| {
        let at = |time: f32| {
            let angle = swing * sin_cos(0.5 * time / STEP.0).0;
            (from + way * (time / seconds) + facing * joint, facing * Quat::from_rotation_x(angle))
        };
        object(b, name, material, poses(seconds, steps, at), |b| capsule(b, material, line, radius))
    };
    let down = |length: f32| [Vec3::ZERO, Vec3::NEG_Y * length];
    let [legs, arms] = SWING;
    vec![
        part("body", cloth, Vec3::Y * 1.0, 0.0, [Vec3::ZERO, Vec3::Y * 0.42], 0.17),
        part("head", skin, Vec3::Y * 1.68, 0.0, [Vec3::ZERO, Vec3::Y * 0.06], 0.1),
        part("left leg", cloth, Vec3::new(0.1, 0.9, 0.0), legs, down(0.8), 0.085),
        part("right leg", cloth, Vec3::new(-0.1, 0.9, 0.0), -legs, down(0.8), 0.085),
        part("left arm", skin, Vec3::new(0.24, 1.38, 0.0), -arms, down(0.55), 0.05),
        part("right arm", skin, Vec3::new(-0.24, 1.38, 0.0), arms, down(0.55), 0.05),
    ]
}

/// A door that stands open by a right angle, closes and opens again; `hinge` is the lower corner of its frame, the other
/// one `width` along +z. It is somewhat larger than its frame.
pub fn door(b: &mut Builder, material: u32, hinge: Vec3, [width, height]: [f32; 2]) -> MovingObject {
    const THICKNESS: f32 = 0.05;
    const OVER: f32 = 0.02;
    const GAP: f32 = 0.002;
    const SECONDS: f32 = 4.0;
    let at = |time: f32| {
        let angle = -FRAC_PI_2 * (1.0 - time / (0.5 * SECONDS)).abs();
        (hinge, Quat::from_rotation_y(angle))
    };
    object(b, "door", material, poses(SECONDS, 20, at), |b| {
        let low = Vec3::new(-0.5 * THICKNESS, GAP, -OVER);
        let high = Vec3::new(0.5 * THICKNESS, height + OVER, width + OVER);
        b.cuboid(material, low, high, super::builder::ALL_SIDES);
    })
}

/// A box of these half edges, m, that goes from one place to another in so many seconds.
pub fn lorry(b: &mut Builder, material: u32, half: Vec3, [from, to]: [Vec3; 2], seconds: f32) -> MovingObject {
    let at = |time: f32| (from.lerp(to, time / seconds), Quat::IDENTITY);
    object(b, "lorry", material, poses(seconds, 1, at), |b| {
        b.cuboid(material, -half, half, super::builder::ALL_SIDES);
    })
}

/// A block that turns about the upright axis through `middle` once in so many seconds; `build` adds it about that.
pub fn turning(
    b: &mut Builder,
    material: u32,
    middle: Vec3,
    seconds: f32,
    build: impl FnOnce(&mut Builder),
) -> MovingObject {
    let at = |time: f32| (middle, Quat::from_rotation_y(TAU * time / seconds));
    object(b, "block", material, poses(seconds, 16, at), build)
}
