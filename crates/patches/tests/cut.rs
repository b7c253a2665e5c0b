//! Triangles cut where something stands on them.

use glam::{Vec2, Vec3, vec2, vec3};
use patchlight_patches::{Density, cut_at_feet};
use scene::gpu::{Triangle, TriangleUv};
use scene::{Material, Scene, SceneParts, Visibility as _};

/// A parallelogram as two triangles.
fn quad(corner: Vec3, a: Vec3, b: Vec3) -> [Triangle; 2] {
    let whole = Triangle { corner, edge_a: a, edge_b: b, ..Triangle::default() };
    [whole, Triangle { corner: corner + a + b, edge_a: -a, edge_b: -b, ..whole }]
}

/// A floor of 4 m × 4 m with something on it. The texture coordinates are x/4 and z/4.
fn floor_with(things: &[[Triangle; 2]]) -> Scene {
    let mut triangles = quad(Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0).to_vec();
    triangles.extend(things.iter().flatten());
    let flat = |p: Vec3| vec2(p.x, p.z) * 0.25;
    let uv = |t: &Triangle| TriangleUv {
        corner: flat(t.corner),
        corner_a: flat(t.corner + t.edge_a),
        corner_b: flat(t.corner + t.edge_b),
        ..TriangleUv::default()
    };
    let uvs = triangles.iter().map(uv).collect();
    Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() }).unwrap()
}

fn corners(t: &Triangle) -> [Vec3; 3] {
    [t.corner, t.corner + t.edge_a, t.corner + t.edge_b]
}

fn area(scene: &Scene) -> f32 {
    scene.geometry.triangles.iter().map(|t| 0.5 * t.edge_a.cross(t.edge_b).length()).sum()
}

/// Triangles of the floor that lie on both sides of the plane x = `line` between two z.
fn across(scene: &Scene, line: f32, from: f32, to: f32) -> usize {
    let is_across = |t: &&Triangle| {
        let c = corners(t);
        let low = c[0].min(c[1]).min(c[2]);
        let high = c[0].max(c[1]).max(c[2]);
        high.y < 1e-3 && low.x < line - 1e-3 && high.x > line + 1e-3 && low.z < to - 1e-3 && high.z > from + 1e-3
    };
    scene.geometry.triangles.iter().filter(is_across).count()
}

#[test]
fn a_floor_is_cut_along_the_foot_of_a_wall() {
    // Standing on it, ending a hair above it, passing through it, and slanted.
    for (foot, up) in [(0.0, Vec3::Y), (1e-5, Vec3::Y), (-1.0, Vec3::Y * 3.0), (0.0, vec3(0.5, 1.0, 0.0))] {
        let wall = quad(vec3(1.5, foot, 0.5), Vec3::Z * 3.0, up);
        let scene = floor_with(&[wall]);
        assert!(across(&scene, 1.5, 0.5, 3.5) > 0);
        let cut = cut_at_feet(&scene, &Density::default(), 0.2).unwrap().expect("it is cut");
        assert_eq!(across(&cut, 1.5, 0.5, 3.5), 0, "{foot} {up}");
        assert!((area(&cut) / area(&scene) - 1.0).abs() < 1e-5, "{} {}", area(&cut), area(&scene));
        // The same surface with the same texture.
        for k in 0..200 {
            let from = vec3(0.02 * k as f32 + 0.013, 0.5, 3.9 - 0.019 * k as f32);
            let [before, after] = [&scene, &cut].map(|s| (s.closest(from, Vec3::NEG_Y), s));
            assert!((before.0.t - after.0.t).abs() < 1e-5, "{from}");
            let uv = |(hit, s): (scene::Hit, &Scene)| -> Vec2 {
                let uv = s.geometry.uvs[hit.triangle as usize];
                uv.corner + (uv.corner_a - uv.corner) * hit.u + (uv.corner_b - uv.corner) * hit.v
            };
            if before.0.t > 0.4999 {
                assert!(
                    (uv(before) - uv(after)).length() < 1e-4
                        && (uv(after) - vec2(from.x, from.z) * 0.25).length() < 1e-4
                );
            }
        }
        let normals = cut.geometry.triangles.iter().filter(|t| corners(t).iter().all(|p| p.y.abs() < 1e-6));
        assert!(normals.into_iter().all(|t| t.edge_a.cross(t.edge_b).y > 0.0), "fronts stay fronts");
        // What is cut is not cut again.
        assert!(cut_at_feet(&cut, &Density::default(), 0.2).unwrap().is_none());
    }
}

#[test]
fn what_does_not_stand_on_a_floor_cuts_nothing() {
    let things = [
        ("high above", quad(vec3(1.5, 0.3, 0.5), Vec3::Z * 3.0, Vec3::Y)),
        ("a sheet on it", quad(vec3(1.0, 0.002, 1.0), Vec3::Z, Vec3::X)),
        ("a leg", quad(vec3(1.5, 0.0, 1.5), Vec3::Z * 0.05, Vec3::Y)),
        ("beside it", quad(vec3(4.5, 0.0, 0.5), Vec3::Z * 3.0, Vec3::Y)),
        ("along its border", quad(vec3(4.0, 0.0, 0.0), Vec3::Z * 4.0, Vec3::Y)),
        ("on a point", quad(vec3(1.5, 0.0, 1.5), vec3(0.0, 1.0, 1.0), vec3(0.0, 1.0, -1.0))),
    ];
    for (what, thing) in things {
        assert!(cut_at_feet(&floor_with(&[thing]), &Density::default(), 0.2).unwrap().is_none(), "{what}");
    }
}

#[test]
fn both_faces_of_a_thin_wall_cut() {
    let faces = [1.5, 1.52].map(|x| quad(vec3(x, 0.0, 0.0), Vec3::Z * 4.0, Vec3::Y));
    let cut = cut_at_feet(&floor_with(&faces), &Density::default(), 0.2).unwrap().expect("it is cut");
    assert_eq!((across(&cut, 1.5, 0.0, 4.0), across(&cut, 1.52, 0.0, 4.0)), (0, 0));
    // The strip below the wall is there, too.
    let strip = cut.closest(vec3(1.51, 0.5, 2.1), Vec3::NEG_Y);
    assert!((strip.t - 0.5).abs() < 1e-5);
}
