//! The voxelisation proxy on scenes whose voxels can be counted by hand.

mod support;

use std::f32::consts::PI;

use glam::{Vec3, vec3};
use opponents::{ProxyLookup, VoxelProxy};
use reference::{Error, PathSettings, PathTracer, Strategy};
use scene::gpu::{LIGHT_DIRECTIONAL, Triangle};
use scene::kernel::bvh::FAR;
use scene::sampling::{hash3, unit};
use scene::{Light, NONE, Scene, SceneParts};
use support::{Builder, furnace};

/// Five voxels of 1/4 cover the unit cube with 1/8 to spare on each side.
const EDGE: f32 = 0.25;
/// Faces of the hollow cube of 5³ voxels: outside and inside.
const OUTER: usize = 6 * 25;
const INNER: usize = 6 * 9;

fn unit_box(albedo: f32) -> Builder {
    let mut b = Builder::default();
    let m = b.material(Vec3::splat(albedo), Vec3::ZERO);
    b.box_inwards(Vec3::ZERO, Vec3::ONE, m);
    b
}

fn proxy_of(scene: &Scene) -> VoxelProxy {
    VoxelProxy::new(scene, EDGE).unwrap()
}

/// Returns true if the faces are those of a hollow cube: their number and area, closed (Σ A n = 0), and by the
/// divergence theorem ⅓ Σ A c·n the volume of its voxels, which holds for outward normals only.
fn is_hollow_cube(proxy: &VoxelProxy, normal: impl Fn(Vec3) -> Vec3) -> bool {
    let mut area = 0.0;
    let mut closure = Vec3::ZERO;
    let mut volume = 0.0;
    for face in &proxy.faces {
        let n = normal(face.normal);
        area += proxy.face_area();
        closure += n * proxy.face_area();
        volume += face.centre.dot(n) * proxy.face_area() / 3.0;
    }
    let voxels = (5 * 5 * 5 - 3 * 3 * 3) as f32;
    proxy.faces.len() == OUTER + INNER
        && (area - 204.0 / 16.0).abs() < 1e-4
        && closure.length() < 1e-4
        && (volume - voxels / 64.0).abs() < 1e-4
}

#[test]
fn a_box_becomes_a_hollow_cube() {
    let proxy = proxy_of(&unit_box(0.5).build());
    assert!(is_hollow_cube(&proxy, |n| n));
    assert!(!is_hollow_cube(&proxy, |n| -n), "inward normals go unnoticed");
    let mut open = unit_box(0.5);
    open.parts.triangles.drain(..2);
    open.parts.uvs.drain(..2);
    assert!(!is_hollow_cube(&proxy_of(&open.build()), |n| n), "a missing wall goes unnoticed");
}

#[test]
fn rays_meet_the_front_of_every_face() {
    let proxy = proxy_of(&unit_box(0.5).build());
    for (face, number) in proxy.faces.iter().zip(0..) {
        let hit = proxy.scene.closest_before(face.centre + 0.1 * face.normal, -face.normal, FAR);
        assert!((hit.t - 0.1).abs() < 1e-5);
        assert_eq!(proxy.face_of(&hit, -face.normal), number);
        let inside = proxy.scene.closest_before(face.centre - 0.1 * face.normal, face.normal, FAR);
        assert_eq!(proxy.face_of(&inside, face.normal), NONE);
    }
}

#[test]
fn points_share_a_face() {
    let proxy = proxy_of(&unit_box(0.5).build());
    let points = proxy.points(3);
    assert_eq!(points.len(), 9 * proxy.faces.len());
    for (own, (face, number)) in points.chunks(9).zip(proxy.faces.iter().zip(0..)) {
        let mean = own.iter().map(|p| p.position * p.weight).sum::<Vec3>();
        assert!((mean - face.centre).length() < 1e-6);
        for p in own {
            let offset = p.position - face.centre;
            assert!(offset.dot(face.normal).abs() < 1e-6 && offset.abs().max_element() < 0.5 * EDGE);
            assert_eq!((p.patch, p.normal), (number, face.normal));
        }
    }
}

/// Returns true if the proxy's power is that of the scene's emitters.
fn keeps_power(proxy: &VoxelProxy, area: f32) -> bool {
    let power: Vec3 = proxy.faces.iter().map(|f| f.radiance * proxy.face_area()).sum();
    (power / area - Vec3::ONE).abs().max_element() < 1e-4
}

#[test]
fn emission_keeps_its_power_and_its_side() {
    // Fronts look inwards: no face outside shines.
    let proxy = proxy_of(&furnace(0.5));
    assert!(keeps_power(&proxy, 6.0));
    assert!(!keeps_power(&proxy, 5.9));
    let is_outside = |f: &opponents::ProxyFace| (f.centre - Vec3::splat(0.5)).dot(f.normal) > 0.0;
    for face in &proxy.faces {
        assert_eq!(face.radiance == Vec3::ZERO, is_outside(face));
    }
    // A slanted lamp.
    let mut b = unit_box(0.5);
    let lamp = b.material(Vec3::ZERO, Vec3::ONE);
    b.quad(vec3(0.3, 0.5, 0.3), vec3(0.3, 0.1, 0.0), vec3(0.0, 0.1, 0.3), lamp);
    let area = vec3(0.3, 0.1, 0.0).cross(vec3(0.0, 0.1, 0.3)).length();
    assert!(keeps_power(&proxy_of(&b.build()), area));
}

#[test]
fn reflectance_is_the_mean_of_the_voxel() {
    // Three voxels of 0.4 from −0.1 on; red up to 0.4, a fourth of the middle one, green from there.
    let mut b = Builder::default();
    let red = Vec3::new(0.8, 0.0, 0.0);
    let green = Vec3::new(0.0, 0.6, 0.0);
    let materials = [red, green].map(|albedo| b.material(albedo, Vec3::ZERO));
    b.quad(Vec3::ZERO, Vec3::Z, 0.4 * Vec3::X, materials[0]);
    b.quad(0.4 * Vec3::X, Vec3::Z, 0.6 * Vec3::X, materials[1]);
    let proxy = VoxelProxy::new(&b.build(), 0.4).unwrap();
    let mut seen = 0;
    for face in proxy.faces.iter().filter(|f| f.normal == Vec3::Y) {
        let expected = [red, 0.25 * red + 0.75 * green, green][(face.centre.x / 0.4) as usize];
        assert!((face.albedo - expected).abs().max_element() < 1e-6, "{} at {}", face.albedo, face.centre);
        seen += 1;
    }
    assert_eq!(seen, 9);

    // A voxel that holds a red floor and the green ceiling of the room below: each side takes what faces it.
    let mut b = Builder::default();
    let materials = [red, green].map(|albedo| b.material(albedo, Vec3::ZERO));
    b.quad(Vec3::ZERO, Vec3::Z, Vec3::X, materials[0]);
    b.quad(-0.01 * Vec3::Y, Vec3::X, Vec3::Z, materials[1]);
    for face in VoxelProxy::new(&b.build(), 0.4).unwrap().faces {
        let expected = match face.normal.y {
            y if y > 0.5 => red,
            y if y < -0.5 => green,
            _ => 0.5 * (red + green),
        };
        assert!((face.albedo - expected).abs().max_element() < 1e-3, "{} on {}", face.albedo, face.normal);
    }
}

/// Returns true if the inside of a closed proxy with these faces left out is a furnace: every face shines with radiance
/// 1 and reflects ρ = ½, so the irradiance is π/(1 − ρ) everywhere.
fn is_furnace(proxy: &VoxelProxy, missing: impl Fn(usize) -> bool) -> bool {
    let mut parts = SceneParts { materials: proxy.scene.materials.to_vec(), ..SceneParts::default() };
    parts.materials.iter_mut().for_each(|m| m.radiance = Vec3::ONE);
    for (t, uv) in proxy.scene.geometry.triangles.iter().zip(&proxy.scene.geometry.uvs) {
        if !missing(t.material as usize) {
            parts.triangles.push(*t);
            parts.uvs.push(*uv);
        }
    }
    let inner: Vec<_> = proxy.points(1).into_iter().filter(|p| is_inner(p.position)).collect();
    assert_eq!(inner.len(), INNER);
    let settings = PathSettings { strategy: Strategy::Bounces, ..PathSettings::default() };
    let light = PathTracer::new(&Scene::new(parts).unwrap()).irradiance(&inner, 512, &settings);
    let mean = light.iter().map(|l| (l.direct + l.indirect) / inner.len() as f32).sum::<Vec3>();
    println!("irradiance {mean}, {} expected", 2.0 * PI);
    (mean / (2.0 * PI) - 1.0).abs().max_element() < 0.01
}

/// Returns true if a face lies round the hollow of the cube.
fn is_inner(centre: Vec3) -> bool {
    (centre - Vec3::splat(0.5)).abs().max_element() < 0.4
}

#[test]
fn the_proxy_of_a_closed_box_is_a_furnace() {
    let proxy = proxy_of(&unit_box(0.5).build());
    assert!(is_furnace(&proxy, |_| false));
    let hole = proxy.faces.iter().position(|f| is_inner(f.centre)).unwrap();
    // The face behind it would close the hole again: two voxels' sides are taken out.
    let behind = proxy.faces.iter().position(|f| {
        let step = f.centre - proxy.faces[hole].centre;
        f.normal == -proxy.faces[hole].normal && (step.length() - EDGE).abs() < 1e-4
    });
    assert!(!is_furnace(&proxy, |face| face == hole || Some(face) == behind));
}

/// Random places on the inside of the unit box with their normals.
fn places() -> impl Iterator<Item = (Vec3, Vec3)> {
    (0..2000).map(|k| {
        let random = |d| unit(hash3(k, d, 7));
        let axis = k as usize % 3;
        let high = k / 3 % 2 == 1;
        let mut position = vec3(random(0), random(1), random(2));
        position[axis] = f32::from(u8::from(high));
        let normal = if high { -Vec3::AXES[axis] } else { Vec3::AXES[axis] };
        (position, normal)
    })
}

/// Returns true if a lookup finds the face above every place: the hollow's side of the same normal, over the place or,
/// in the corners, next to it.
fn finds_faces(proxy: &VoxelProxy, lookup: impl Fn(Vec3, Vec3) -> Option<u32>) -> bool {
    places().all(|(position, normal)| {
        let Some(found) = lookup(position, normal) else { return false };
        let face = &proxy.faces[found as usize];
        // The hollow is [1/8, 7/8]³.
        let within = position.clamp(Vec3::splat(0.125), Vec3::splat(0.875));
        let off = (face.centre - within).abs();
        face.normal == normal && off.dot(normal.abs()) < 1e-5 && off.max_element() <= 0.5 * EDGE + 1e-5
    })
}

#[test]
fn the_lookup_finds_the_face_above_a_point() {
    let proxy = proxy_of(&unit_box(0.5).build());
    assert!(finds_faces(&proxy, |x, n| proxy.face_at(x, n)));
    assert!(!finds_faces(&proxy, |x, n| proxy.face_at(x, -n)), "the other side goes unnoticed");
    assert!(!finds_faces(&proxy, |x, n| proxy.face_at(x + EDGE * Vec3::X, n)), "another voxel goes unnoticed");
    assert!(!finds_faces(&proxy, |x, _| proxy.face_at(x, vec3(0.6, 0.5, 0.4))), "a fixed normal goes unnoticed");
}

#[test]
fn hidden_faces_are_not_found() {
    let mut proxy = proxy_of(&unit_box(0.5).build());
    let place = vec3(0.4, 0.0, 0.6);
    let normal = Vec3::Y;
    let before = proxy.face_at(place, normal).unwrap();
    proxy.hide_faces(|face| face == before);
    let after = proxy.face_at(place, normal).unwrap();
    let step = proxy.faces[after as usize].centre - proxy.faces[before as usize].centre;
    assert!((step.length() - EDGE).abs() < 1e-5 && step.y == 0.0, "{step}");
    let count = proxy.faces.len() as u32;
    proxy.hide_faces(|face| face < count);
    assert_eq!(proxy.face_at(place, normal), None);
}

#[test]
fn both_sides_of_a_sheet_have_faces_of_their_own() {
    let mut b = Builder::default();
    let m = b.material(Vec3::splat(0.5), Vec3::ZERO);
    b.quad(Vec3::ZERO, Vec3::Z, Vec3::X, m);
    let proxy = proxy_of(&b.build());
    for normal in [Vec3::Y, Vec3::NEG_Y] {
        let face = proxy.face_at(vec3(0.4, 0.0, 0.6), normal).unwrap();
        assert_eq!(proxy.faces[face as usize].normal, normal);
    }
    assert_eq!(proxy.faces.len(), 25 + 25 + 4 * 5);
}

/// Greatest error of a function that rises along x, over places on the floor between the centres of faces.
fn ramp_error(proxy: &VoxelProxy, lookup: ProxyLookup) -> f32 {
    let values: Vec<Vec3> = proxy.faces.iter().map(|f| Vec3::splat(f.centre.x)).collect();
    let inside = |p: &Vec3| (*p - Vec3::splat(0.5)).abs().with_y(0.0).max_element() < EDGE;
    (places().filter(|(p, n)| *n == Vec3::Y && inside(p)))
        .map(|(p, n)| (proxy.value_at(&values, p, n, lookup).unwrap().x - p.x).abs())
        .fold(0.0, f32::max)
}

#[test]
fn bilinear_lookup_keeps_constants_and_ramps() {
    let proxy = proxy_of(&unit_box(0.5).build());
    assert!(ramp_error(&proxy, ProxyLookup::Bilinear) < 1e-5);
    let steps = ramp_error(&proxy, ProxyLookup::Face);
    assert!((0.1 * EDGE..=0.501 * EDGE).contains(&steps), "{steps}");
    let ones = vec![Vec3::ONE; proxy.faces.len()];
    for lookup in [ProxyLookup::Face, ProxyLookup::Bilinear] {
        for k in 0..10_000 {
            let random = |d| unit(hash3(k, d, 8));
            let position = 1.4 * vec3(random(0), random(1), random(2)) - 0.2;
            let normal = vec3(random(3) - 0.5, random(4) - 0.5, random(5) - 0.5).normalize();
            let value = proxy.value_at(&ones, position, normal, lookup).unwrap();
            assert!((value - Vec3::ONE).abs().max_element() < 1e-5);
        }
    }
}

#[test]
fn the_edge_follows_from_the_number_of_faces() {
    let scene = support::room(0.5);
    let faces = |target| VoxelProxy::for_count(&scene, target, |p| p.faces.len()).unwrap();
    // The walls of a room that lies along the grid move from layer to layer together: the number goes in steps.
    let some = faces(500);
    let many = faces(5000);
    for (proxy, target, step) in [(&some, 500.0, 0.2), (&many, 5000.0, 0.1)] {
        let ratio = proxy.faces.len() as f32 / target;
        assert!((ratio - 1.0).abs() < step, "{} faces", proxy.faces.len());
    }
    assert!(many.edge < 0.5 * some.edge);
    // Another way of counting gives another edge.
    let half = VoxelProxy::for_count(&scene, 500, |p| p.faces.len() / 2).unwrap();
    assert!((half.faces.len() as f32 / 1000.0 - 1.0).abs() < 0.2);
}

#[test]
fn lights_and_sky_stay() {
    let mut b = unit_box(0.5);
    let sun = Light { kind: LIGHT_DIRECTIONAL, direction: Vec3::NEG_Y, color: Vec3::ONE, ..Light::default() };
    b.light(sun).sky(vec3(1.0, 2.0, 3.0));
    let proxy = proxy_of(&b.build());
    assert_eq!(proxy.scene.lighting.lights, [sun]);
    assert_eq!(proxy.scene.lighting.sky.radiance, vec3(1.0, 2.0, 3.0));
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let scene = support::room(0.5);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| VoxelProxy::new(&scene, 0.07).unwrap().faces)
    };
    assert_eq!(with(1), with(5));
}

#[test]
fn wrong_settings_are_named() {
    let scene = unit_box(0.5).build();
    for edge in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-9] {
        let error = VoxelProxy::new(&scene, edge).err().unwrap();
        assert!(matches!(error, Error::Setting { name: "voxel edge", .. }), "{error}");
    }
    assert!(matches!(VoxelProxy::for_count(&scene, 0, |p| p.faces.len()), Err(Error::Setting { .. })));
    let proxy = proxy_of(&scene);
    let found = proxy.value_at(&[Vec3::ONE], Vec3::ZERO, Vec3::Y, ProxyLookup::Face);
    assert!(matches!(found, Err(Error::Count { expected: 204, found: 1, .. })));
    let ones = vec![Vec3::ONE; 204];
    for normal in [Vec3::ZERO, Vec3::NAN] {
        let found = proxy.value_at(&ones, Vec3::ZERO, normal, ProxyLookup::Face);
        assert!(matches!(found, Err(Error::NoDirection { .. })));
    }
    assert_eq!(proxy.face_of(&scene::Hit::MISS, Vec3::X), NONE);
}

#[test]
fn a_scene_without_area_is_refused() {
    let line = Triangle { corner: Vec3::ZERO, edge_a: Vec3::X, edge_b: 0.5 * Vec3::X, ..Triangle::default() };
    let mut b = Builder::default();
    b.material(Vec3::ONE, Vec3::ZERO);
    b.parts.triangles.push(line);
    b.parts.uvs.push(Default::default());
    let error = VoxelProxy::new(&b.build(), 0.1).err().unwrap();
    assert!(matches!(error, Error::Scene(scene::Error::NoTriangles)), "{error}");
}
