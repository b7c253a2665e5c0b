//! Finish of surfaces: lobes by quadrature, normals of maps, what is refused.

use glam::{Vec2, Vec3, Vec4};
use patchlight_scene as scene;
use scene::gpu::{Finish, Hit, Lobe, SurfacePoint, Texture, Triangle, TriangleUv};
use scene::kernel::lobe;
use scene::sampling::{hash3, unit};
use scene::{Error, Material, Scene, SceneParts};

fn lobe_of(roughness: f32, facing: f32, grazing: f32, eye_cosine: f32) -> Lobe {
    let sine = (1.0 - eye_cosine * eye_cosine).sqrt();
    Lobe {
        facing: Vec3::splat(facing),
        grazing: Vec3::splat(grazing),
        alpha: roughness * roughness,
        matte: 0.0,
        to_eye: Vec3::new(sine * 0.6, eye_cosine, sine * 0.8),
        ..Lobe::default()
    }
}

/// Mean of `value` over directions of the hemisphere round y, times its solid angle.
fn over_hemisphere(value: impl Fn(Vec3) -> f32) -> f64 {
    let (rows, columns) = (400, 800);
    let mut sum = 0.0;
    for row in 0..rows {
        let height = (row as f64 + 0.5) / rows as f64;
        let across = (1.0 - height * height).sqrt();
        for column in 0..columns {
            let angle = (column as f64 + 0.5) / columns as f64 * std::f64::consts::TAU;
            let direction = Vec3::new((across * angle.cos()) as f32, height as f32, (across * angle.sin()) as f32);
            sum += f64::from(value(direction));
        }
    }
    sum * std::f64::consts::TAU / (rows * columns) as f64
}

#[test]
fn samples_have_the_reflectance_that_the_lobe_has_by_quadrature() {
    for (roughness, eye) in [(0.4, 0.9), (0.4, 0.3), (0.7, 0.6), (1.0, 0.15), (1.0, 1.0)] {
        for (facing, grazing) in [(0.04, 1.0), (0.9, 1.0)] {
            let lobe = lobe_of(roughness, facing, grazing, eye);
            let expected = over_hemisphere(|direction| lobe::reflected(&lobe, Vec3::Y, direction).x);
            let n = 1 << 16;
            let at = |k: u32| (unit(hash3(k, 1, 0)), unit(hash3(k, 2, 0)));
            let found = (0..n).map(|k| f64::from(lobe::sample(&lobe, Vec3::Y, at(k)).1.x)).sum::<f64>() / f64::from(n);
            assert!((found / expected - 1.0).abs() < 0.01, "{roughness} {eye} {facing}: {found} {expected}");
            assert!(expected < 1.0, "{expected}");
        }
    }
    // The same samples with another roughness have another reflectance.
    let rough = over_hemisphere(|direction| lobe::reflected(&lobe_of(1.0, 0.9, 1.0, 0.3), Vec3::Y, direction).x);
    let smooth = over_hemisphere(|direction| lobe::reflected(&lobe_of(0.4, 0.9, 1.0, 0.3), Vec3::Y, direction).x);
    assert!((rough / smooth - 1.0).abs() > 0.05, "{rough} {smooth}");
}

#[test]
fn light_and_eye_may_change_places() {
    let there = Vec3::new(-0.3, 0.5, 0.81).normalize();
    let ours = lobe_of(0.5, 0.3, 1.0, 0.7);
    let swapped = Lobe { to_eye: there, ..ours };
    let forth = lobe::reflected(&ours, Vec3::Y, there) / there.y;
    let back = lobe::reflected(&swapped, Vec3::Y, ours.to_eye) / ours.to_eye.y;
    assert!((forth - back).abs().max_element() < 1e-5 * forth.max_element(), "{forth} {back}");
}

/// A square of two triangles in the plane of z with coordinates that may be mirrored, and a map of one normal.
fn square(mirrored: bool, normal: Vec3) -> Scene {
    let corners = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
    let uv = |p: Vec3| Vec2::new(if mirrored { -p.x } else { p.x }, p.y);
    let triangle = |[a, b, c]: [usize; 3]| {
        let [a, b, c] = [a, b, c].map(|k| corners[k]);
        let triangle = Triangle { corner: a, edge_a: b - a, edge_b: c - a, ..Triangle::default() };
        (triangle, TriangleUv { corner: uv(a), corner_a: uv(b), corner_b: uv(c), ..TriangleUv::default() })
    };
    let (triangles, uvs) = [[0, 1, 2], [0, 2, 3]].map(triangle).into_iter().unzip();
    let code = (0.5 * normal + 0.5).to_array().map(|c| (c * 65_535.0).round() as u32);
    let finish = Finish { normal_texture: 0, roughness: 0.6, metallic: 0.25, has_lobe: 1, ..Finish::default() };
    Scene::new(SceneParts {
        triangles,
        uvs,
        materials: vec![Material::default()],
        finishes: vec![finish],
        textures: vec![Texture { offset: 0, width: 1, height: 1, levels: 1 }],
        texels: vec![code[0] | code[1] << 16, code[2] | 65_535 << 16],
        ..SceneParts::default()
    })
    .unwrap()
}

fn finished(scene: &Scene, from: Vec3) -> (SurfacePoint, Lobe) {
    let hit = scene.closest_before(from, -from.normalize() + Vec3::new(0.3, 0.2, 0.0), f32::INFINITY);
    assert!(!hit.is_miss());
    let point = SurfacePoint { normal: Vec3::Z * from.z.signum(), ..SurfacePoint::default() };
    let tables = scene.tables();
    let albedo = Vec4::new(0.5, 0.4, 0.3, 1.0);
    let finishes = &scene.geometry.finishes;
    lobe::finished(&tables, finishes, hit, -from.normalize(), 0.0, point, albedo, Vec3::ONE)
}

#[test]
fn normals_of_a_map_lie_in_the_frame_of_its_coordinates() {
    let tilted = Vec3::new(0.48, 0.36, 0.8);
    for mirrored in [false, true] {
        let scene = square(mirrored, tilted);
        let expected = Vec3::new(if mirrored { -0.48 } else { 0.48 }, 0.36, 0.8);
        let (front, lobe) = finished(&scene, Vec3::Z);
        assert!((front.normal - expected).length() < 1e-3, "{} {expected}", front.normal);
        assert!((lobe.bend - (expected - Vec3::Z)).length() < 1e-3);
        // From behind, the same slopes.
        let (back, _) = finished(&scene, Vec3::NEG_Z);
        assert!((back.normal + expected).length() < 1e-3, "{}", back.normal);
    }
    let (even, lobe) = finished(&square(false, Vec3::Z), Vec3::Z);
    assert!((even.normal - Vec3::Z).length() < 1e-4 && lobe.bend.length() < 1e-4);
    // What a map turns below the surface stays a little above it.
    let (low, _) = finished(&square(false, Vec3::new(1.0, 0.0, 0.0)), Vec3::Z);
    assert!(low.normal.z > 0.05, "{}", low.normal);
}

#[test]
fn a_lobe_takes_its_part_from_the_albedo() {
    let (_, lobe) = finished(&square(false, Vec3::Z), Vec3::Z);
    assert!((lobe.alpha - 0.36).abs() < 1e-6);
    assert!((lobe.facing - (Vec3::splat(0.03) + 0.25 * Vec3::new(0.5, 0.4, 0.3))).length() < 1e-6);
    assert!((lobe.matte - 0.75 * 0.96).abs() < 1e-3, "{}", lobe.matte);
    let miss = Hit::MISS;
    let scene = square(false, Vec3::Z);
    let none = lobe::finished(
        &scene.tables(),
        &scene.geometry.finishes,
        miss,
        Vec3::Z,
        0.0,
        SurfacePoint::default(),
        Vec4::ZERO,
        Vec3::ONE,
    );
    assert_eq!((none.1.alpha, none.1.matte), (0.0, 1.0));
}

#[test]
fn finishes_that_make_no_sense_are_refused() {
    let parts = |finishes: Vec<Finish>| SceneParts {
        triangles: vec![Triangle { edge_a: Vec3::X, edge_b: Vec3::Y, ..Triangle::default() }],
        uvs: vec![TriangleUv::default()],
        materials: vec![Material::default()],
        finishes,
        ..SceneParts::default()
    };
    let fault = |finish: Finish| Scene::new(parts(vec![finish])).err();
    assert!(Scene::new(parts(vec![Finish::default()])).is_ok());
    assert_eq!(
        Scene::new(parts(vec![Finish::default(); 2])).err(),
        Some(Error::FinishLength { expected: 1, found: 2 })
    );
    assert_eq!(
        fault(Finish { normal_texture: 3, ..Finish::default() }),
        Some(Error::TextureIndex { material: 0, texture: 3, count: 0 })
    );
    let rough = fault(Finish { roughness: 1.5, ..Finish::default() });
    assert_eq!(rough, Some(Error::Finish { material: 0, name: "roughness", value: 1.5 }));
    assert!(fault(Finish { metallic: f32::NAN, ..Finish::default() }).is_some());
    assert!(fault(Finish { normal_scale: f32::INFINITY, ..Finish::default() }).is_some());
}
