//! Normals of vertices: packing, scenes that have them, and a smooth ball under a lamp.

use glam::{Affine3A, Mat3, Vec3};
use patchlight_scene::gpu::DirectParams;
use patchlight_scene::kernel::camera::surface_point;
use patchlight_scene::kernel::normal::{pack, shading_point, unpack};
use patchlight_scene::math::sin_cos_2pi;
use patchlight_scene::sampling::{hash3, unit};
use patchlight_scene::{Hit, Irradiance, Light, Mesh, Scene, SurfacePoint};

const COLUMNS: usize = 24;
const ROWS: usize = 12;
const RADIUS: f32 = 2.0;

/// A ball of few triangles about a place, with the normals of a sphere.
fn ball(middle: Vec3, transform: Affine3A) -> Scene {
    let mut normals = Vec::new();
    for row in 0..=ROWS {
        let (radius, height) = sin_cos_2pi(0.5 * row as f32 / ROWS as f32);
        for column in 0..=COLUMNS {
            let (sin, cos) = sin_cos_2pi(column as f32 / COLUMNS as f32);
            normals.push(Vec3::new(radius * cos, height, radius * sin));
        }
    }
    let positions: Vec<Vec3> = normals.iter().map(|normal| middle + *normal * RADIUS).collect();
    let mut indices = Vec::new();
    for row in 0..ROWS {
        for column in 0..COLUMNS {
            let at = |down: usize, right: usize| ((row + down) * (COLUMNS + 1) + column + right) as u32;
            if row > 0 {
                indices.extend([at(0, 0), at(0, 1), at(1, 0)]);
            }
            if row + 1 < ROWS {
                indices.extend([at(0, 1), at(1, 1), at(1, 0)]);
            }
        }
    }
    let mut builder = Scene::builder();
    builder.add_light(Light::sun(Vec3::new(-1.0, -0.2, 0.0), Irradiance(Vec3::ONE)));
    let mesh = Mesh {
        name: "ball",
        positions: &positions,
        indices: &indices,
        normals: &normals,
        transform,
        ..Mesh::default()
    };
    builder.add_mesh(mesh);
    builder.build().unwrap()
}

/// Points of the ball that random rays from outside meet, and the direction of the sphere there.
fn seen(scene: &Scene, middle: Vec3, point: impl Fn(&Scene, Hit, Vec3) -> SurfacePoint) -> Vec<(SurfacePoint, Vec3)> {
    let mut found = Vec::new();
    for k in 0..4000 {
        let [x, y, z] = [0, 1, 2].map(|axis| unit(hash3(k, axis, 7)) - 0.5);
        let Some(away) = Vec3::new(x, y, z).try_normalize() else { continue };
        let eye = middle + away * 20.0;
        let hit = scene.closest_before(eye, -away, 100.0);
        let place = eye - away * hit.t;
        found.push((point(scene, hit, -away), (place - middle).normalize()));
    }
    found
}

/// Greatest and mean difference of the sun's irradiance from that of a sphere.
fn errors(scene: &Scene, points: &[(SurfacePoint, Vec3)]) -> (f32, f32) {
    let params = DirectParams { light_count: 1, ray_offset: scene.geometry.ray_offset, ..DirectParams::default() };
    let places: Vec<SurfacePoint> = points.iter().map(|point| point.0).collect();
    let to_sun = Vec3::new(1.0, 0.2, 0.0).normalize();
    let found = scene.direct_irradiance(&params, &places);
    let errors: Vec<f32> =
        found.iter().zip(points).map(|(light, (_, up))| (light.x - up.dot(to_sun).max(0.0)).abs()).collect();
    (errors.iter().copied().fold(0.0, f32::max), errors.iter().sum::<f32>() / errors.len() as f32)
}

#[test]
fn packed_normals_come_back() {
    for k in 0..20_000 {
        let [x, y, z] = [0, 1, 2].map(|axis| unit(hash3(k, axis, 3)) - 0.5);
        let Some(normal) = Vec3::new(x, y, z).try_normalize() else { continue };
        let code = pack(normal);
        assert!(code & 0xffff != 0 && code >> 16 != 0, "{normal}: {code:x}");
        assert!(unpack(code).distance(normal) < 1e-4, "{normal} {}", unpack(code));
    }
    for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z] {
        assert!(unpack(pack(axis)).distance(axis) < 1e-4, "{axis}");
    }
}

#[test]
fn a_ball_of_few_triangles_is_lit_as_a_sphere() {
    let middle = Vec3::new(3.0, 5.0, -4.0);
    let scene = ball(middle, Affine3A::IDENTITY);
    let smooth = seen(&scene, middle, |scene, hit, direction| shading_point(&scene.tables(), hit, direction));
    let (greatest, mean) = errors(&scene, &smooth);
    assert!(greatest < 0.03 && mean < 3e-3, "{greatest} {mean}");
    // Flat triangles are off by far more, and so is who is not lifted: neighbours throw shadows.
    let flat = seen(&scene, middle, |scene, hit, direction| surface_point(&scene.tables(), hit, direction));
    let (flat_greatest, flat_mean) = errors(&scene, &flat);
    assert!(flat_greatest > 0.1 && flat_mean > 10.0 * mean, "{flat_greatest} {flat_mean}");
    let low = seen(&scene, middle, |scene, hit, direction| SurfacePoint {
        position: surface_point(&scene.tables(), hit, direction).position,
        ..shading_point(&scene.tables(), hit, direction)
    });
    let (low_greatest, _) = errors(&scene, &low);
    assert!(low_greatest > 2.0 * greatest, "teeth of shadow: {low_greatest}");
}

#[test]
fn normals_follow_what_is_stretched_mirrored_and_turned() {
    let transform = Affine3A::from_rotation_y(0.7) * Affine3A::from_scale(Vec3::new(-1.0, 0.5, 2.0));
    let scene = ball(Vec3::ZERO, transform);
    let check = |scene: &Scene| {
        let points = seen(scene, Vec3::ZERO, |scene, hit, direction| shading_point(&scene.tables(), hit, direction));
        for (point, _) in points {
            // The ellipsoid's normal there: the gradient of |M⁻¹ x|².
            let inside = transform.inverse().transform_point3(point.position);
            let inverse = transform.inverse().matrix3;
            let expected = (Mat3::from(inverse).transpose() * inside).normalize();
            assert!(point.normal.dot(expected) > 0.98, "{} beside {expected}", point.normal);
        }
    };
    check(&scene);
    // The same ball, transformed by an edit.
    let mut edit = ball(Vec3::ZERO, Affine3A::IDENTITY).edit();
    edit.transform(0, transform);
    check(&edit.build().unwrap());
}

#[test]
fn flat_scenes_and_strange_normals_stay_flat() {
    let scene = ball(Vec3::ZERO, Affine3A::IDENTITY);
    assert!(scene.geometry.uvs.iter().all(|uv| uv.normals().is_some()));
    assert!(scene.flat().geometry.uvs.iter().all(|uv| uv.normals().is_none()));
    let corners = [Vec3::ZERO, Vec3::Z, Vec3::X];
    let tilted = Vec3::new(1.0, 1.0, 0.0);
    for (normals, is_smooth) in [
        ([Vec3::Y; 3], false),
        ([Vec3::Y, tilted, Vec3::Y], true),
        ([Vec3::Y, Vec3::new(1.0, 0.1, 0.0), Vec3::Y], false),
        ([Vec3::Y, Vec3::ZERO, tilted], false),
        ([Vec3::NAN; 3], false),
    ] {
        let mut builder = Scene::builder();
        builder.add_mesh(Mesh { name: "one", positions: &corners, normals: &normals, ..Mesh::default() });
        let scene = builder.build().unwrap();
        assert_eq!(scene.geometry.uvs[0].normals().is_some(), is_smooth, "{normals:?}");
    }
}
