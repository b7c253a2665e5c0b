//! Open boxes that float in the air under a sun and a very dim sky: faces whose indirect light comes from far and little
//! of what they see.

use glam::Vec3;

use super::Built;
use super::builder::{Blocks, Builder, UNCUT};
use super::spec::{Parameter, Values};
use crate::import::{View, lights};

/// Radiance of the sky.
const SKY: Parameter = Parameter {
    name: "sky",
    about: "radiance of the sky over the irradiance of the sun, 1/sr",
    default: 0.001,
    range: 0.0..=1.0,
    is_whole: false,
};
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[SKY];

/// Corner and size of each box, m; all are open at the top but the third and the sixth, which are open to the side.
const BOXES: [(Vec3, Vec3); 6] = [
    (Vec3::new(-6.0, 0.0, -2.0), Vec3::new(2.0, 1.5, 2.0)),
    (Vec3::new(-1.0, 1.2, -4.0), Vec3::new(2.5, 2.0, 2.0)),
    (Vec3::new(3.5, -0.5, -1.5), Vec3::new(2.0, 2.0, 2.5)),
    (Vec3::new(-3.5, 3.0, 2.0), Vec3::new(1.5, 1.5, 1.5)),
    (Vec3::new(0.5, -1.5, 1.5), Vec3::new(2.0, 1.2, 1.8)),
    (Vec3::new(5.5, 2.5, 3.0), Vec3::new(1.6, 1.6, 1.6)),
];
/// Thickness of their walls, m.
const WALL: f32 = 0.08;
/// Irradiance of the sun, W/m².
const SUN: Vec3 = Vec3::new(30.0, 28.0, 25.0);

/// Builds it.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    let colors = [[0.7, 0.68, 0.62], [0.62, 0.3, 0.22], [0.32, 0.5, 0.66]];
    let materials = ["clay", "brick", "slate"].into_iter().zip(colors).map(|(name, color)| b.plain(name, color));
    let materials: Vec<u32> = materials.collect();
    for (k, (corner, size)) in BOXES.into_iter().enumerate() {
        b.object(&format!("box {}", k + 1));
        let is_open_above = k % 3 != 2;
        let lines = [0, 1, 2].map(|axis| {
            let far = corner[axis] + size[axis];
            [corner[axis], corner[axis] + WALL, far - WALL, far]
        });
        let solid = |c: [i32; 3]| {
            let is_in_block = c.iter().all(|x| (0..3).contains(x));
            let is_hollow = match is_open_above {
                true => c[0] == 1 && c[2] == 1 && c[1] >= 1,
                false => c[0] == 1 && c[1] == 1 && c[2] >= 1,
            };
            is_in_block && !is_hollow
        };
        let material = |_: usize, _: bool, _: [i32; 3]| materials[k % 3];
        b.blocks(&Blocks { lines: [&lines[0], &lines[1], &lines[2]], solid: &solid, material: &material, edge: UNCUT });
    }
    let sun = lights::directional(Vec3::new(-0.45, -0.75, -0.5), SUN)?;
    let view = View {
        eye: Vec3::new(4.0, 4.5, 14.0),
        target: Vec3::new(0.0, 1.0, 0.0),
        up: Vec3::Y,
        vertical_fov_degrees: 50.0,
    };
    let sky = SUN * values.get_f32(&SKY);
    Ok(Built {
        mesh: b.mesh,
        lights: vec![sun],
        sky,
        view,
        exposure_stops: -2.0,
        tracks: Vec::new(),
        moving: Vec::new(),
    })
}
