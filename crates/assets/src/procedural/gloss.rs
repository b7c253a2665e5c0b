//! A room of surfaces that are not diffuse: boards of worn varnish, a wall of bricks with joints that are only a normal
//! map, a ball of brushed metal and one of red plastic, under a lamp, a sun and a sky.

use glam::{Vec2, Vec3};
use scene::Light;

use super::Built;
use super::builder::{ALL_SIDES, Builder, sin_cos};
use super::pattern;
use super::shell::Shell;
use crate::import::draft::{FinishDraft, MaterialDraft, packed_normal};
use crate::import::{View, lights};

/// Roughness of floor and balls.
const ROUGHNESS: f32 = 0.45;
/// Room, and the window in its wall at x = 0, m.
const SHELL: Shell = Shell { size: Vec3::new(4.0, 2.7, 3.6), wall: 0.25, axis: 0, along: [1.0, 2.6], up: [0.8, 2.1] };
/// Radius of the balls, m, and quads round and from pole to pole.
const RADIUS: f32 = 0.42;
const QUADS: (u32, u32) = (48, 24);
/// The lamp: lower corner and sides of its panel, m, and its radiance, W/m²/sr.
const LAMP: [Vec3; 2] = [Vec3::new(2.6, 2.6, 1.4), Vec3::new(0.7, 0.0, 0.7)];
const RADIANCE: Vec3 = Vec3::new(16.0, 14.0, 11.0);

/// Builds it.
pub fn build() -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    SHELL.build(&mut b);
    let finish = |roughness, metallic| FinishDraft { roughness: Some(roughness), metallic, ..FinishDraft::default() };
    let boards = b.material(MaterialDraft {
        albedo_picture: Some(pattern::wood()),
        finish: finish(ROUGHNESS, 0.0),
        ..MaterialDraft::new("boards")
    });
    let bricks = b.material(MaterialDraft {
        albedo: Vec3::new(0.55, 0.3, 0.22),
        finish: FinishDraft { normal_picture: Some(pattern::brick_normals()), ..finish(0.7, 0.0) },
        ..MaterialDraft::new("bricks")
    });
    let metal = b.material(MaterialDraft {
        albedo: Vec3::new(0.78, 0.66, 0.42),
        finish: finish(ROUGHNESS, 1.0),
        ..MaterialDraft::new("metal")
    });
    let plastic = b.material(MaterialDraft {
        albedo: Vec3::new(0.5, 0.05, 0.04),
        finish: finish(ROUGHNESS, 0.0),
        ..MaterialDraft::new("plastic")
    });
    let [width, height, depth] = SHELL.size.to_array();
    b.object("boards");
    b.face(boards, 1, true, 0.004, [0.02, depth - 0.02], [0.02, width - 0.02]);
    b.object("bricks");
    b.face(bricks, 2, true, 0.004, [0.02, width - 0.02], [0.02, height - 0.02]);
    ball(&mut b, metal, Vec3::new(1.5, RADIUS + 0.01, 1.2));
    ball(&mut b, plastic, Vec3::new(2.75, RADIUS + 0.01, 1.5));
    let shade = b.plain("lamp body", [0.4, 0.4, 0.4]);
    let panel =
        b.material(MaterialDraft { radiance: RADIANCE, albedo: Vec3::splat(0.2), ..MaterialDraft::new("lamp") });
    b.object("lamp");
    let [low, size] = LAMP;
    let high = low + size + Vec3::Y * 0.06;
    b.cuboid(shade, low + Vec3::Y * 0.004, high, ALL_SIDES);
    b.cuboid_side(panel, low, high, 2);
    let sun = lights::directional(Vec3::new(0.75, -0.62, 0.1), Vec3::new(30.0, 27.0, 23.0))?;
    let bulb = lights::point(Vec3::new(0.7, 2.1, 3.1), Vec3::new(5.0, 4.6, 4.0))?;
    let view = View {
        eye: Vec3::new(3.6, 1.35, 3.45),
        target: Vec3::new(1.7, 0.7, 0.9),
        up: Vec3::Y,
        vertical_fov_degrees: 58.0,
    };
    let lights: Vec<Light> = vec![sun, bulb];
    Ok(Built {
        mesh: b.mesh,
        lights,
        sky: Vec3::new(1.4, 1.8, 2.6),
        view,
        exposure_stops: 0.5,
        tracks: Vec::new(),
        moving: Vec::new(),
    })
}

/// A ball that is shaded smoothly.
fn ball(b: &mut Builder, material: u32, centre: Vec3) {
    b.object("ball");
    let at = |s: f32, t: f32| {
        // s runs against the angle, so that the front is outside.
        let (sin, cos) = sin_cos(-s);
        let (up_sin, up_cos) = sin_cos(0.5 * t);
        Vec3::new(up_sin * cos, -up_cos, up_sin * sin)
    };
    let first = b.mesh.triangles.len();
    b.sheet(material, QUADS, |s, t| centre + RADIUS * at(s, t), Vec2::new);
    for triangle in &mut b.mesh.triangles[first..] {
        triangle.normals = triangle.corners.map(|corner| packed_normal(corner - centre));
    }
    // Those at the poles are lines.
    let has_area = |corners: &[Vec3; 3]| (corners[1] - corners[0]).cross(corners[2] - corners[0]).length() > 1e-7;
    let mut k = 0;
    b.mesh.triangles.retain(|triangle| {
        k += 1;
        k <= first || has_area(&triangle.corners)
    });
}
