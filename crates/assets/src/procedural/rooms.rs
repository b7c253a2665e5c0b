//! Two rooms with thin walls between one floor and one slab that both go on outside: light of either side of a wall
//! lies on the same triangles. The sun lights two outer walls, the slab and the ground, and enters the second room by
//! its doorway; the camera is in the first room.

use glam::Vec3;

use super::builder::{Blocks, Builder};
use super::spec::{Parameter, Values};
use super::{Built, builder, moving};
use crate::import::{View, lights};

/// Thickness of the walls.
const WALL: Parameter = Parameter {
    name: "wall",
    about: "thickness of the walls, m; 0 for sheets",
    default: 0.02,
    range: 0.0..=0.3,
    is_whole: false,
};
/// Width of both doorways.
const DOORWAY: Parameter = Parameter {
    name: "doorway",
    about: "width of the doorways, m; 0 seals the rooms",
    default: 1.4,
    range: 0.0..=2.0,
    is_whole: false,
};
/// A door in the doorway between the rooms.
const SWINGING: Parameter = moving::flag("door", "with a door that closes and opens");
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[WALL, DOORWAY, SWINGING];

/// Middle planes of the walls, m: the first room ends where the second begins.
const X: [f32; 3] = [0.0, 4.0, 8.0];
const Z: [f32; 2] = [0.0, 4.0];
/// Top of the doorways, and the slab, m.
const Y: [f32; 3] = [0.0, 2.1, 2.6];
/// Middle of the doorways in the wall between the rooms and in the one at the end, m.
const DOOR: f32 = 2.0;
/// Corners of the floor and of the slab, (x, z), m.
const FLOOR: [[f32; 2]; 2] = [[-2.5, -2.5], [11.0, 7.0]];
const SLAB: [[f32; 2]; 2] = [[-0.6, -0.6], [8.6, 4.6]];

/// Builds it.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    let [floor, slab] = [b.plain("floor", [0.48, 0.44, 0.4]), b.plain("slab", [0.76, 0.76, 0.74])];
    let wall = b.plain("wall", [0.7, 0.68, 0.62]);
    b.object("floor");
    b.face(floor, 1, true, Y[0], [FLOOR[0][1], FLOOR[1][1]], [FLOOR[0][0], FLOOR[1][0]]);
    b.object("slab");
    b.face(slab, 1, false, Y[2], [SLAB[0][1], SLAB[1][1]], [SLAB[0][0], SLAB[1][0]]);
    b.object("walls");
    let half = 0.5 * values.get_f32(&DOORWAY);
    let door = [DOOR - half, DOOR + half];
    match values.get_f32(&WALL) {
        0.0 => sheets(&mut b, wall, door),
        thickness => thick_walls(&mut b, wall, door, 0.5 * thickness),
    }
    let mut moving = Vec::new();
    if values.get(&SWINGING) != 0.0 {
        let wood = b.plain("door", [0.55, 0.38, 0.24]);
        moving.push(moving::door(&mut b, wood, Vec3::new(X[1], Y[0], door[0]), [2.0 * half, Y[1]]));
    }
    let sun = lights::directional(Vec3::new(-0.75, -0.6, -0.25), Vec3::new(30.0, 28.0, 25.0))?;
    let view = View {
        eye: Vec3::new(0.5, 1.5, 0.5),
        target: Vec3::new(3.0, 1.15, 4.0),
        up: Vec3::Y,
        vertical_fov_degrees: 65.0,
    };
    Ok(Built {
        mesh: b.mesh,
        lights: vec![sun],
        sky: Vec3::new(1.2, 1.6, 2.4),
        view,
        exposure_stops: 2.0,
        tracks: Vec::new(),
        moving,
    })
}

/// Walls without thickness in their middle planes, front to the first room, or inside.
fn sheets(b: &mut Builder, material: u32, door: [f32; 2]) {
    for (z, front) in [(Z[0], true), (Z[1], false)] {
        for rooms in X.windows(2) {
            b.face(material, 2, front, z, [rooms[0], rooms[1]], [Y[0], Y[2]]);
        }
    }
    b.face(material, 0, true, X[0], [Y[0], Y[2]], Z);
    let [first, last] = door;
    for x in [X[1], X[2]] {
        if first == last {
            b.face(material, 0, false, x, [Y[0], Y[2]], Z);
            continue;
        }
        for side in [[Z[0], first], [last, Z[1]]] {
            b.face(material, 0, false, x, [Y[0], Y[2]], side);
        }
        b.face(material, 0, false, x, [Y[1], Y[2]], door);
    }
}

/// Walls that reach `half` to both sides of their middle planes. They have no faces on the floor and under the slab.
fn thick_walls(b: &mut Builder, material: u32, door: [f32; 2], half: f32) {
    let x_lines: Vec<f32> = X.iter().flat_map(|x| [x - half, x + half]).collect();
    let mut z_lines: Vec<f32> = Z.iter().flat_map(|z| [z - half, z + half]).chain(door).collect();
    z_lines.sort_by(f32::total_cmp);
    z_lines.dedup();
    let middle = |lines: &[f32], k: i32| Some(0.5 * (lines.get(k as usize)? + lines.get(k as usize + 1)?));
    let solid = |c: [i32; 3]| {
        let (Some(x), Some(z)) = (middle(&x_lines, c[0]), middle(&z_lines, c[2])) else { return false };
        let near = |line: f32, at: f32| (line - at).abs() < half;
        // Columns go on below the floor and above the slab, so that no face lies in their planes.
        let is_below_lintel = c[1] <= 0;
        let in_door = is_below_lintel && (door[0]..door[1]).contains(&z) && !near(X[0], x);
        let in_wall = X.iter().any(|line| near(*line, x)) || Z.iter().any(|line| near(*line, z));
        in_wall && !in_door
    };
    let lines: [&[f32]; 3] = [&x_lines, &Y, &z_lines];
    b.blocks(&Blocks { lines, solid: &solid, material: &|_, _, _| material, edge: builder::UNCUT });
}
