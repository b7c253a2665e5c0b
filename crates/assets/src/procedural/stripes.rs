//! A closed room with sheets that hardly stand off what they lie on: painted stripes, a carpet and a poster.

use glam::Vec3;

use super::Built;
use super::boxes::inside_out;
use super::builder::Builder;
use super::spec::{Parameter, Values};
use crate::import::{View, lights};

/// Number of stripes.
const STRIPES: Parameter = Parameter {
    name: "stripes",
    about: "number of stripes, one after the other 0.2, 1 and 5 mm above the wall",
    default: 6.0,
    range: 0.0..=6.0,
    is_whole: true,
};
/// Factor on all distances between sheets.
const GAP: Parameter = Parameter {
    name: "gap",
    about: "factor of all distances between sheets",
    default: 1.0,
    range: 0.01..=10.0,
    is_whole: false,
};
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[STRIPES, GAP];

/// Width, height and depth of the room, m.
const ROOM: Vec3 = Vec3::new(4.0, 2.6, 3.5);
/// Heights of stripes, carpet and poster above what is behind them, m.
const STRIPE_GAPS: [f32; 3] = [0.0002, 0.001, 0.005];
const CARPET_GAP: f32 = 0.002;
const POSTER_GAP: f32 = 0.001;
/// Left end of the first stripe, distance from one to the next, width, lower and upper end, m.
const FIRST: f32 = 0.45;
const PITCH: f32 = 0.57;
const WIDTH: f32 = 0.25;
const HEIGHT: [f32; 2] = [0.15, 2.35];

/// Builds it.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    let wall = b.plain("wall", [0.72, 0.7, 0.66]);
    let paints =
        [("blue paint", [0.3, 0.42, 0.6]), ("red paint", [0.62, 0.3, 0.24]), ("green paint", [0.36, 0.56, 0.34])];
    let paints = paints.map(|(name, albedo)| b.plain(name, albedo));
    let [carpet, poster] = [b.plain("carpet", [0.44, 0.36, 0.3]), b.plain("poster", [0.75, 0.66, 0.4])];
    let gap = values.get_f32(&GAP);
    b.object("room");
    inside_out(&mut b, wall, Vec3::ZERO, ROOM);
    b.object("stripes");
    for k in 0..values.count(&STRIPES) {
        let left = FIRST + PITCH * k as f32;
        b.face(paints[k % 3], 2, true, gap * STRIPE_GAPS[k % 3], [left, left + WIDTH], HEIGHT);
    }
    b.object("carpet");
    b.face(carpet, 1, true, gap * CARPET_GAP, [0.7, 2.4], [1.0, 3.0]);
    b.object("poster");
    b.face(poster, 0, true, gap * POSTER_GAP, [1.0, 2.0], [1.0, 1.7]);
    // Down: z × −x = −y; one centimetre below the ceiling.
    let corner = Vec3::new(2.5, ROOM.y - 0.01, 1.3);
    let lamp = lights::rect(corner, Vec3::Z * 0.5, Vec3::NEG_X, Vec3::new(22.0, 20.0, 17.0))?;
    let view = View {
        eye: Vec3::new(3.0, 1.5, 3.3),
        target: Vec3::new(1.7, 1.0, 0.0),
        up: Vec3::Y,
        vertical_fov_degrees: 62.0,
    };
    Ok(Built {
        mesh: b.mesh,
        lights: vec![lamp],
        sky: Vec3::ZERO,
        view,
        exposure_stops: 0.0,
        tracks: Vec::new(),
        moving: Vec::new(),
    })
}
