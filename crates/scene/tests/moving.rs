//! Geometry with parts that move: rays meet the same as in a scene that was built with the parts in their places.

use std::sync::Arc;

use glam::{Affine3A, Quat, Vec3};
use patchlight_scene::gpu::{Triangle, TriangleUv};
use patchlight_scene::kernel::bvh::{FAR, closest_hit, host_occluder};
use patchlight_scene::sampling::{hash3, unit};
use patchlight_scene::{
    Geometry, GeometryTables, Hierarchy, Hit, Material, MaterialId, Mesh, MovingMesh, NONE, Scene, SceneParts,
};

fn place(k: u32, d: u32, salt: u32) -> Vec3 {
    Vec3::new(unit(hash3(k, d, salt)), unit(hash3(k, d, salt + 1)), unit(hash3(k, d, salt + 2)))
}

/// Triangles anywhere in a cube of 1 m.
fn resting(count: u32) -> Vec<Triangle> {
    let edge = |k: u32, d: u32| 0.3 * (place(k, d, 0) - 0.5);
    (0..count)
        .map(|k| Triangle { corner: place(k, 0, 0), edge_a: edge(k, 1), edge_b: edge(k, 2), ..Triangle::default() })
        .collect()
}

/// A mesh of a few triangles about the origin.
fn mesh(count: u32, salt: u32) -> Vec<Vec3> {
    (0..3 * count).map(|k| 0.2 * (place(k, 7, salt) - 0.5)).collect()
}

fn transform(k: u32, salt: u32) -> Affine3A {
    let turn = Quat::from_axis_angle(place(k, 9, salt).normalize(), 6.0 * unit(hash3(k, 10, salt)));
    Affine3A::from_rotation_translation(turn, place(k, 8, salt))
}

fn scene(triangles: Vec<Triangle>) -> Scene {
    let uvs = vec![TriangleUv::default(); triangles.len()];
    Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default(); 2], ..SceneParts::default() }).unwrap()
}

/// Hits of rays from the middle of the cube, as places: corner of the triangle, shares, distance.
fn hits(count: u32, hit: impl Fn(Vec3, Vec3) -> (Hit, Option<Triangle>)) -> Vec<Option<[u32; 3]>> {
    (0..count)
        .map(|k| {
            let (hit, triangle) = hit(Vec3::splat(0.5), place(k, 0, 40) - 0.5);
            triangle.map(|_| [hit.u, hit.v, hit.t].map(f32::to_bits))
        })
        .collect()
}

fn of_geometry(geometry: &Geometry, is_binary: bool) -> Vec<Option<[u32; 3]>> {
    let hierarchy = if is_binary { Hierarchy::from(&geometry.nodes[..]) } else { geometry.hierarchy() };
    let tables = GeometryTables { hierarchy, ..geometry.tables() };
    hits(3000, |origin, direction| {
        let hit = closest_hit(&tables, origin, direction, FAR);
        (hit, geometry.triangles.get(hit.triangle as usize).copied())
    })
}

/// The same triangles in a scene at rest.
fn at_rest(geometry: &Geometry) -> Vec<Option<[u32; 3]>> {
    of_geometry(&scene(geometry.triangles.clone()).geometry, false)
}

fn meshes(count: u32) -> Vec<Arc<MovingMesh>> {
    let mesh = |k: u32| {
        let positions = mesh(2 + 7 * k, 100 + k);
        let mesh = Mesh { positions: &positions, material: MaterialId::of_scene(1), ..Mesh::default() };
        Arc::new(MovingMesh::new(&mesh, 2).unwrap())
    };
    (0..count).map(mesh).collect()
}

#[test]
fn rays_meet_what_moves_as_if_it_were_at_rest_there() {
    let base = scene(resting(200));
    for count in [1, 2, 5] {
        let meshes = meshes(count);
        let transforms: Vec<Affine3A> = (0..count).map(|k| transform(k, 3)).collect();
        let mut geometry = base.geometry.with_moving(&meshes, &transforms).unwrap();
        let expected = at_rest(&geometry);
        assert!(of_geometry(&geometry, false) == expected && of_geometry(&geometry, true) == expected, "{count}");
        assert!(expected != of_geometry(&base.geometry, false), "nothing was met");
        // Elsewhere; rays that know the places of before are told apart.
        let transforms: Vec<Affine3A> = (0..count).map(|k| transform(k, 4)).collect();
        geometry.place(&transforms).unwrap();
        let moved = at_rest(&geometry);
        assert!(moved != expected);
        assert!(of_geometry(&geometry, false) == moved && of_geometry(&geometry, true) == moved, "{count} moved");
        // The same bits as where it was put there at once.
        let at_once = base.geometry.with_moving(&meshes, &transforms).unwrap();
        assert!(at_once.nodes == geometry.nodes && at_once.triangles == geometry.triangles);
        // What rests keeps its numbers, and comes back alone.
        let alone = geometry.with_moving(&[], &[]).unwrap();
        assert!(alone.nodes == base.geometry.nodes && alone.triangles == base.geometry.triangles);
        assert_eq!(geometry.resting(), 0..200);
    }
}

#[test]
fn what_is_in_the_way_is_found_again_by_its_name() {
    let base = scene(resting(20));
    let meshes = meshes(3);
    let transforms: Vec<Affine3A> = (0..3).map(|k| transform(k, 3)).collect();
    let geometry = base.geometry.with_moving(&meshes, &transforms).unwrap();
    let tables = GeometryTables { hierarchy: geometry.hierarchy(), ..geometry.tables() };
    let mut last = NONE;
    let mut found = 0;
    for k in 0..3000 {
        let direction = place(k / 8, 0, 40) - 0.5 + 0.001 * place(k, 1, 41);
        let expected = closest_hit(&tables, Vec3::splat(0.5), direction, FAR).triangle != NONE;
        let occluder = host_occluder(&tables, Vec3::splat(0.5), direction, FAR, [last, NONE]);
        assert_eq!(occluder != NONE, expected, "ray {k}");
        if occluder != NONE {
            last = occluder;
            found += 1;
        }
    }
    assert!(found > 100 && found < 2900, "{found}");
}

#[test]
fn faults_are_named() {
    let positions = mesh(1, 0);
    let wrong = |mesh: Mesh| MovingMesh::new(&mesh, 1).unwrap_err().to_string();
    let text = wrong(Mesh { positions: &positions, material: MaterialId::of_scene(3), ..Mesh::default() });
    assert!(text.contains("material is number 3 of 1"), "{text}");
    assert!(!wrong(Mesh::default()).is_empty());
    let base = scene(resting(20));
    let mut geometry = base.geometry.with_moving(&meshes(2), &[Affine3A::IDENTITY; 2]).unwrap();
    let text = geometry.place(&[Affine3A::IDENTITY]).unwrap_err().to_string();
    assert!(text.contains("transforms holds 1 entries for 2"), "{text}");
}
