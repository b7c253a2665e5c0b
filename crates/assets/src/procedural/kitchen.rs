//! A kitchen lit by sun and sky through one window: a bright sill that few rays of a place meet, cupboards on two walls,
//! and a papered wall.

use glam::Vec3;

use super::Built;
use super::builder::{ALL_SIDES, Builder, STANDING};
use super::pattern;
use super::shell::Shell;
use super::spec::{Parameter, Values};
use crate::import::draft::MaterialDraft;
use crate::import::{View, lights};

/// Depth of the sill.
const SILL: Parameter = Parameter {
    name: "sill",
    about: "how far the sill of the window reaches into the room, m",
    default: 0.25,
    range: 0.02..=0.5,
    is_whole: false,
};
/// Cupboards on the wall.
const CUPBOARDS: Parameter = Parameter {
    name: "cupboards",
    about: "cupboards side by side on each of two walls",
    default: 4.0,
    range: 0.0..=6.0,
    is_whole: true,
};
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[SILL, CUPBOARDS];

/// Room, and the window in its wall at x = 0, m.
const SHELL: Shell = Shell { size: Vec3::new(3.6, 2.5, 3.2), wall: 0.3, axis: 0, along: [1.1, 2.1], up: [1.15, 2.05] };
/// Thickness of the sill, and how far it goes beside the window, m.
const SILL_SIZE: [f32; 2] = [0.03, 0.06];
/// Width of a cupboard and the gap between two, m.
const WIDTH: f32 = 0.55;
const GAP: f32 = 0.012;
/// Depth and height of cupboards on the floor and on the wall, lower end of the latter, m.
const LOW: [f32; 2] = [0.58, 0.86];
const HIGH: [f32; 3] = [0.34, 0.7, 1.45];
/// Thickness of the worktop, and how far it stands over, m.
const TOP: [f32; 2] = [0.035, 0.02];
/// Cupboards stand off the wall by this, m: no two faces in one place.
const OFF: f32 = 0.004;

/// Builds it.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    SHELL.build(&mut b);
    let white = b.plain("sill", [0.75, 0.74, 0.71]);
    let front = b.plain("cupboard", [0.62, 0.66, 0.6]);
    let top = b.plain("worktop", [0.3, 0.27, 0.24]);
    let wood = b.plain("wood", [0.46, 0.32, 0.22]);
    b.object("sill");
    let [thickness, beside] = SILL_SIZE;
    let [z_low, z_high] = SHELL.along;
    let low = Vec3::new(OFF, SHELL.up[0] - thickness, z_low - beside);
    b.cuboid(white, low, Vec3::new(OFF + values.get_f32(&SILL), SHELL.up[0] + 0.002, z_high + beside), ALL_SIDES);
    let count = values.count(&CUPBOARDS);
    cupboards(&mut b, front, top, count);
    paper(&mut b);
    SHELL.table(&mut b, wood, Vec3::new(2.2, 0.0, 1.5), Vec3::new(0.9, 0.74, 0.9));
    let sun = lights::directional(Vec3::new(0.62, -0.72, 0.12), Vec3::new(34.0, 31.0, 27.0))?;
    let view = View {
        eye: Vec3::new(3.35, 1.6, 2.9),
        target: Vec3::new(0.5, 1.15, 0.5),
        up: Vec3::Y,
        vertical_fov_degrees: 66.0,
    };
    let sky = Vec3::new(0.9, 1.2, 1.8);
    Ok(Built {
        mesh: b.mesh,
        lights: vec![sun],
        sky,
        view,
        exposure_stops: 1.5,
        tracks: Vec::new(),
        moving: Vec::new(),
    })
}

/// Cupboards along the wall at z = 0, on the floor and on the wall, each with a front of its own.
fn cupboards(b: &mut Builder, front: u32, top: u32, count: usize) {
    if count == 0 {
        return;
    }
    let start = 0.3;
    b.object("cupboards");
    for k in 0..count {
        let from = start + WIDTH * k as f32;
        let to = from + WIDTH - GAP;
        b.cuboid(front, Vec3::new(from, 0.0, OFF), Vec3::new(to, LOW[1], LOW[0]), STANDING);
        let [depth, height, lower] = HIGH;
        b.cuboid(front, Vec3::new(from, lower, OFF), Vec3::new(to, lower + height, depth), ALL_SIDES);
    }
    b.object("worktop");
    let end = start + WIDTH * count as f32 - GAP;
    let [thickness, over] = TOP;
    let low = Vec3::new(start - over, LOW[1] + 0.002, OFF);
    b.cuboid(top, low, Vec3::new(end + over, LOW[1] + 0.002 + thickness, LOW[0] + over), ALL_SIDES);
}

/// Paper on the wall with the window, before and behind it, a millimetre off the plaster.
fn paper(b: &mut Builder) {
    let paper = b.material(MaterialDraft { albedo_picture: Some(pattern::paper()), ..MaterialDraft::new("paper") });
    b.object("paper");
    for z in [[LOW[0] + 0.1, SHELL.along[0] - 0.1], [SHELL.along[1] + 0.1, SHELL.size.z - OFF]] {
        b.face(paper, 0, true, 0.001, [0.08, SHELL.size.y - 0.06], z);
    }
}
