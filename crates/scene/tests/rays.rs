//! Rays: the wide host traversal, the kernels' traversal and every triangle one by one must agree.

use std::cell::Cell;

use glam::{Vec2, Vec3};
use patchlight_scene::gpu::{Texture, Triangle, TriangleUv};
use patchlight_scene::kernel::GeometryTables;
use patchlight_scene::kernel::bvh::{FAR, any_hit, closest_hit, host_occluder, intersect_triangle, occluder};
use patchlight_scene::math::sin_cos_2pi;
use patchlight_scene::sampling::{hash3, unit};
use patchlight_scene::{Hit, Material, NONE, Occluder, Scene, SceneParts};

fn random(k: u32, slot: u32) -> Vec3 {
    Vec3::new(unit(hash3(k, slot, 1)), unit(hash3(k, slot, 2)), unit(hash3(k, slot, 3)))
}

/// Small triangles strewn over a cube.
fn soup(count: u32) -> SceneParts {
    let triangles: Vec<_> = (0..count)
        .map(|k| Triangle {
            corner: random(k, 0) * 4.0,
            edge_a: random(k, 1) - 0.5,
            edge_b: random(k, 2) - 0.5,
            source: k,
            ..Triangle::default()
        })
        .collect();
    let uvs = vec![
        TriangleUv { corner: Vec2::ZERO, corner_a: Vec2::X, corner_b: Vec2::Y, ..TriangleUv::default() };
        triangles.len()
    ];
    SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() }
}

/// Scene with a picture that has one texel opaque and one not: its left half is a hole.
fn with_holes(count: u32) -> SceneParts {
    let mut parts = soup(count);
    parts.textures = vec![Texture { offset: 0, width: 2, height: 1, levels: 1 }];
    parts.texels = vec![0xffff_ffff, 0x0000_ffff, 0xffff_ffff, 0xffff_ffff];
    parts.materials[0].mask_texture = 0;
    parts
}

fn brute_force(scene: &Scene, origin: Vec3, direction: Vec3) -> Hit {
    let mut best = Hit::MISS;
    for (k, t) in scene.geometry.triangles.iter().enumerate() {
        let hit = intersect_triangle(t, k as u32, origin, direction, FAR);
        if hit.t < best.t && !scene.tables().is_hole(hit.triangle, hit.u, hit.v) {
            best = hit;
        }
    }
    best
}

fn ray(k: u32) -> (Vec3, Vec3) {
    (random(k, 5) * 4.0, (random(k, 6) - 0.5).normalize())
}

#[test]
fn all_traversals_agree() {
    let scene = Scene::new(soup(3000)).unwrap();
    let geometry = scene.tables();
    let mut hits = 0;
    for k in 0..4000 {
        let (origin, direction) = ray(k);
        let expected = brute_force(&scene, origin, direction);
        let body = closest_hit(&geometry, origin, direction, FAR);
        let wide = scene.closest_before(origin, direction, FAR);
        assert_eq!(body, expected, "ray {k}");
        assert_eq!(wide, expected, "ray {k}");
        hits += u32::from(!expected.is_miss());
        for t_max in [0.3, 1.0] {
            let blocked = expected.t < t_max;
            assert_eq!(any_hit(&geometry, origin, direction, t_max), blocked, "ray {k}");
            assert_eq!(scene.occluded(origin, direction, t_max), blocked, "ray {k}");
        }
    }
    assert!(hits > 1000 && hits < 4000, "{hits} hits");
}

#[test]
fn a_lost_triangle_is_noticed() {
    let whole = Scene::new(soup(300)).unwrap();
    let mut parts = soup(300);
    parts.triangles.swap_remove(17);
    parts.uvs.pop();
    let broken = Scene::new(parts).unwrap();
    let differs = (0..20_000).any(|k| {
        let (origin, direction) = ray(k);
        whole.closest_before(origin, direction, FAR).t != broken.closest_before(origin, direction, FAR).t
    });
    assert!(differs);
}

#[test]
fn rays_pass_holes() {
    let masked = Scene::new(with_holes(800)).unwrap();
    let solid = Scene::new(soup(800)).unwrap();
    let mut passed = 0;
    for k in 0..4000 {
        let (origin, direction) = ray(k);
        let expected = brute_force(&masked, origin, direction);
        let body = closest_hit(&masked.tables(), origin, direction, FAR);
        let wide = masked.closest_before(origin, direction, FAR);
        assert_eq!(body, expected, "ray {k}");
        assert_eq!(wide, expected, "ray {k}");
        assert_eq!(masked.occluded(origin, direction, 1.0), expected.t < 1.0);
        passed += u32::from(solid.closest_before(origin, direction, FAR).t < expected.t);
    }
    assert!(passed > 200, "{passed}");
}

/// Rays in the plane of a face of a triangle's box touch its edge there, and pass beside the box: that it is asked
/// first changes no answer.
#[test]
fn a_last_occluder_that_is_only_touched_changes_no_answer() {
    let mut parts = soup(100);
    let axes = |k: u32| [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)][(k % 3) as usize];
    for (k, triangle) in (0u32..).zip(&mut parts.triangles) {
        let (a, b) = axes(k);
        (triangle.edge_a, triangle.edge_b) = (-a * (0.1 + unit(hash3(k, 5, 3))), b * (0.1 + unit(hash3(k, 6, 3))));
    }
    let scene = Scene::new(parts).unwrap();
    let tables = scene.tables();
    let host = GeometryTables { hierarchy: scene.geometry.hierarchy(), ..scene.tables() };
    let mut stopped = 0;
    let mut disputed = 0;
    for k in 0..20_000 {
        let number = k % scene.geometry.triangles.len() as u32;
        let triangle = &scene.geometry.triangles[number as usize];
        let on_edge = triangle.corner + triangle.edge_b * unit(hash3(k, 1, 3));
        let away = 20.0 * Vec3::new(unit(hash3(k, 2, 3)), unit(hash3(k, 3, 3)), unit(hash3(k, 4, 3))) - 10.0;
        let across = Vec3::from_array(triangle.edge_a.to_array().map(|edge| f32::from(u8::from(edge == 0.0))));
        let origin = on_edge + away * across;
        let direction = away * across * -1.5;
        let expected = any_hit(&tables, origin, direction, 1.0);
        assert_eq!(occluder(&tables, origin, direction, 1.0, number) != NONE, expected, "ray {k}");
        let packet = host_occluder(&host, origin, direction, 1.0, [k % 50, k % 7]);
        assert_eq!(packet != NONE, expected, "ray {k}");
        let met = intersect_triangle(triangle, number, origin, direction, 1.0);
        stopped += u32::from(expected);
        disputed += u32::from(met.triangle != NONE && !expected);
    }
    println!("{stopped} rays are stopped, {disputed} meet a triangle beside its box");
    assert!((2_000..18_000).contains(&stopped) && disputed > 1_000, "{stopped} {disputed}");
}

/// Rays to one lamp from places that follow each other: what was in the way of the last changes no answer, through
/// holes and with what another scene left behind neither.
#[test]
fn the_last_occluder_changes_no_answer() {
    let masked = Scene::new(with_holes(200)).unwrap();
    let solid = Scene::new(soup(100)).unwrap();
    let lamp = Vec3::new(2.0, 5.0, 1.0);
    let last = Cell::new(Occluder::default());
    for scene in [&solid, &masked, &solid] {
        let mut dark = 0;
        let mut triangle = NONE;
        let mut packet = NONE;
        for k in 0..4000 {
            // A walk in small steps, so that the same triangle is in the way again and again.
            let t = k as f32 / 4000.0;
            let (s, c) = sin_cos_2pi(5.0 * t);
            let origin = Vec3::new(4.0 * t, 1.0 + s, 2.0 + c);
            let blocked = brute_force(scene, origin, lamp - origin).t < 1.0;
            assert_eq!(scene.occluded_again(origin, lamp - origin, 1.0, &last), blocked, "ray {k}");
            // The kernels' form, asked with what stopped the last ray, and now and then with any triangle.
            let asked = if k % 7 == 0 { k % scene.geometry.triangles.len() as u32 } else { triangle };
            triangle = occluder(&scene.tables(), origin, lamp - origin, 1.0, asked);
            assert_eq!(triangle != NONE, blocked, "ray {k}");
            let tables = GeometryTables { hierarchy: scene.geometry.hierarchy(), ..scene.tables() };
            packet = host_occluder(&tables, origin, lamp - origin, 1.0, [k % 50, packet]);
            assert_eq!(packet != NONE, blocked, "ray {k}");
            dark += u32::from(blocked);
        }
        assert!((400..3980).contains(&dark), "{dark} rays in the dark");
    }
}

#[test]
fn a_scene_of_one_triangle_and_a_tilted_ray_along_an_axis() {
    let scene = Scene::new(SceneParts {
        triangles: vec![Triangle { edge_a: Vec3::X, edge_b: Vec3::Y, ..Triangle::default() }],
        uvs: vec![TriangleUv::default()],
        materials: vec![Material::default()],
        ..SceneParts::default()
    })
    .unwrap();
    // A flat box: the direction has exact zeros.
    let origin = Vec3::new(0.25, 0.25, 2.0);
    let direction = Vec3::NEG_Z;
    for hit in [scene.closest_before(origin, direction, FAR), closest_hit(&scene.tables(), origin, direction, FAR)] {
        assert_eq!(hit, Hit { triangle: 0, u: 0.25, v: 0.25, t: 2.0 });
    }
    assert_eq!(scene.closest_before(origin, direction, 1.9).triangle, NONE);
    assert!(scene.closest_before(origin, direction, 1.9).t.is_infinite());
}

#[test]
fn bad_parts_are_refused_with_their_place() {
    let fails = |change: &dyn Fn(&mut SceneParts)| {
        let mut parts = soup(10);
        change(&mut parts);
        Scene::new(parts).err().unwrap()
    };
    use patchlight_scene::Error;
    assert_eq!(Scene::new(SceneParts::default()).err(), Some(Error::NoTriangles));
    assert_eq!(fails(&|p| p.triangles[7].corner.y = f32::NAN), Error::NotFinite { triangle: 7 });
    assert_eq!(fails(&|p| p.triangles[3].material = 1), Error::MaterialIndex { triangle: 3, material: 1, count: 1 });
    assert_eq!(
        fails(&|p| p.materials[0].albedo_texture = 4),
        Error::TextureIndex { material: 0, texture: 4, count: 0 }
    );
    assert!(matches!(fails(&|p| p.uvs.clear()), Error::TableLength { name: "uvs", .. }));
    let sky = fails(&|p| (p.sky.map_width, p.sky.map_height) = (4, 2));
    assert_eq!(sky, Error::TableLength { name: "sky_map", expected: 8, found: 0 });
}
