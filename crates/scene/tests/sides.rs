//! Reachability of light: small lamps light whole rooms, closed spaces stay dark.

use glam::{Vec3, vec3};
use patchlight_scene::gpu::{Triangle, TriangleUv};
use patchlight_scene::sampling::{hash3, unit};
use patchlight_scene::{Material, NONE, POINT_WALKS, Scene, SceneParts, SidePolicy, SurfacePoint, find_sides, is_open};

const ROOM: u32 = 0;
const LAMP: u32 = 1;
const SAFE: u32 = 2;

fn quad(parts: &mut SceneParts, corner: Vec3, a: Vec3, b: Vec3, material: u32) {
    for (edge_a, edge_b) in [(a, a + b), (a + b, b)] {
        parts.triangles.push(Triangle { corner, material, edge_a, edge_b, ..Triangle::default() });
        parts.uvs.push(TriangleUv::default());
    }
}

/// Six walls with their fronts inside.
fn cuboid(parts: &mut SceneParts, low: Vec3, high: Vec3, material: u32) {
    let d = high - low;
    let x = Vec3::X * d.x;
    let y = Vec3::Y * d.y;
    let z = Vec3::Z * d.z;
    for (corner, a, b) in [(low, z, x), (high, -x, -z), (low, y, z), (high, -z, -y), (low, x, y), (high, -y, -x)] {
        quad(parts, corner, a, b, material);
    }
}

/// A closed room of 4 m with a lamp of 0.2 m in a housing that is open below, and a closed box without light.
fn room(radiance: f32) -> Scene {
    let lamp = Material { radiance: Vec3::splat(radiance), ..Material::default() };
    let mut parts =
        SceneParts { materials: vec![Material::default(), lamp, Material::default()], ..Default::default() };
    cuboid(&mut parts, vec3(-2.0, 0.0, -2.0), vec3(2.0, 2.5, 2.0), ROOM);
    let low = vec3(-0.3, 1.8, -0.3);
    let x = 0.6 * Vec3::X;
    let y = 0.3 * Vec3::Y;
    let z = 0.6 * Vec3::Z;
    for (corner, a, b) in [(low, x, y), (low + z, x, y), (low, z, y), (low + x, z, y), (low + y, x, z)] {
        quad(&mut parts, corner, a, b, ROOM);
    }
    quad(&mut parts, vec3(-0.1, 2.0, -0.1), 0.2 * Vec3::X, 0.2 * Vec3::Z, LAMP);
    cuboid(&mut parts, vec3(1.0, 0.5, 1.0), vec3(1.5, 1.0, 1.5), SAFE);
    Scene::new(parts).unwrap()
}

/// Shares of points that are open, of random ones on the floor and inside of the closed box.
fn open_shares(scene: &Scene) -> (f32, f32) {
    let share = |low: Vec3, edge: f32| {
        let points = (0..500).map(|k| {
            let place = low + edge * vec3(unit(hash3(k, 0, 3)), 0.0, unit(hash3(k, 1, 3)));
            SurfacePoint { position: place, patch: NONE, normal: Vec3::Y, weight: 1.0 }
        });
        points.zip(0..).filter(|(p, seed)| is_open(scene, p, POINT_WALKS, *seed)).count() as f32 / 500.0
    };
    (share(vec3(-2.0, 0.0, -2.0), 4.0), share(vec3(1.0, 0.5, 1.0), 0.5))
}

#[test]
fn a_small_lamp_in_a_housing_lights_the_room() {
    let scene = room(20.0);
    let (floor, safe) = open_shares(&scene);
    assert!(floor > 0.998 && safe == 0.0, "{floor} {safe}");
    for (t, sides) in scene.geometry.triangles.iter().zip(find_sides(&scene, SidePolicy::Lit)) {
        // The fronts of the closed box are its inside, the backs of the room's walls see nothing.
        let is_wall = t.material == ROOM && [t.corner, t.corner + t.edge_a].iter().all(|c| is_outside(*c));
        let front = t.material != SAFE;
        let back = !is_wall;
        assert_eq!((sides.front, sides.back), (front, back), "{t:?}");
    }
    // Switched off there is no light.
    assert_eq!(open_shares(&room(0.0)), (0.0, 0.0));
}

#[test]
fn walks_go_through_glass_and_not_through_mirrors() {
    let of = |safe: Material| {
        let mut scene = room(20.0);
        scene.materials = vec![scene.materials[0], scene.materials[1], safe].into();
        open_shares(&scene).1
    };
    let black = Material { albedo: Vec3::ZERO, ..Material::default() };
    // The fronts look inside, where the glass is.
    assert!(of(Material { transmittance: Vec3::ONE, index_of_refraction: 1.0 / 1.5, ..black }) > 0.95);
    assert!(of(Material { transmittance: Vec3::ONE, is_pane: 1, ..black }) > 0.95);
    assert_eq!(of(Material { mirror: Vec3::ONE, ..black }), 0.0);
}

/// Returns true if a corner is one of the room's.
fn is_outside(corner: Vec3) -> bool {
    corner.x.abs() == 2.0 && corner.z.abs() == 2.0
}

#[test]
fn the_back_of_a_lamp_lights_nothing() {
    let scene = room(20.0);
    let mut parts = SceneParts { materials: scene.materials.to_vec(), ..SceneParts::default() };
    for t in &scene.geometry.triangles {
        // Front up: it shines into the housing, whose inside lights the room through the opening.
        let turned = Triangle { edge_a: t.edge_b, edge_b: t.edge_a, ..*t };
        parts.triangles.push(if t.material == LAMP { turned } else { *t });
        parts.uvs.push(TriangleUv::default());
    }
    assert!(open_shares(&Scene::new(parts.clone()).unwrap()).0 > 0.2);
    // A lid just below it closes the housing; from below the lamp it shows its back.
    quad(&mut parts, vec3(-0.3, 2.0, -0.3), 0.6 * Vec3::X, 0.6 * Vec3::Z, ROOM);
    parts.triangles.iter_mut().filter(|t| t.material == LAMP).for_each(|t| t.corner.y += 0.01);
    assert_eq!(open_shares(&Scene::new(parts).unwrap()).0, 0.0);
}
