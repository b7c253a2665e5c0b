//! Receivers: few, in the open, and enough for what lies between them.

use glam::{Vec3, Vec4};
use patchlight_patches::{Density, Error, InterpolationMesh};
use scene::gpu::{Triangle, TriangleUv};
use scene::{Hit, Material, NONE, Scene, SceneParts, SidePolicy, Sides, find_sides};
use transport::kernel::grid::{cell_corners, cell_count, interpolate_receivers, vertex_count};

fn triangle(a: Vec3, b: Vec3, c: Vec3) -> Triangle {
    Triangle { corner: a, edge_a: b - a, edge_b: c - a, ..Triangle::default() }
}

fn scene(triangles: Vec<Triangle>) -> Scene {
    let uvs = vec![TriangleUv::default(); triangles.len()];
    Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() }).unwrap()
}

/// A rectangle of n × n pairs of triangles, fronts on the side of a × b.
fn sheet(corner: Vec3, a: Vec3, b: Vec3, n: u32) -> Vec<Triangle> {
    let at = |i: u32, j: u32| corner + a * (i as f32 / n as f32) + b * (j as f32 / n as f32);
    let pair = |i: u32, j: u32| {
        [triangle(at(i, j), at(i + 1, j), at(i, j + 1)), triangle(at(i + 1, j + 1), at(i, j + 1), at(i + 1, j))]
    };
    (0..n * n).flat_map(|k| pair(k % n, k / n)).collect()
}

/// No length for any cell.
fn nowhere(points: &[scene::SurfacePoint], _: u32) -> Result<Vec<Option<f32>>, Error> {
    Ok(vec![None; points.len()])
}

/// Vertices every `edge`, in cells of three times as much.
fn receivers(scene: &Scene, edge: f32) -> InterpolationMesh {
    InterpolationMesh::new(
        scene,
        &Density::default(),
        &find_sides(scene, SidePolicy::Both),
        3.0 * edge,
        0.4 * edge,
        |_, _| Some(edge),
        nowhere,
    )
    .unwrap()
}

/// The receivers of each cell of one side of a triangle, and the middle of the cell.
fn cells(scene: &Scene, set: &InterpolationMesh, triangle: u32, front: bool) -> Vec<(Vec3, Vec<u32>)> {
    let grid = set.grids[triangle as usize];
    let first = if front { grid.front } else { grid.back };
    if first == NONE {
        return Vec::new();
    }
    let cell = |k: u32| {
        let cell = set.cells[(first + k) as usize];
        let (a, b, c) = cell_corners(grid.divisions, k);
        let middle = (a + b + c) / 3.0;
        let own = match cell.first {
            NONE => Vec::new(),
            start => set.vertices[start as usize..(start + vertex_count(cell.divisions)) as usize].to_vec(),
        };
        (scene.tables().position(triangle, middle.x, middle.y), own)
    };
    (0..cell_count(grid.divisions)).map(cell).collect()
}

/// The interpolated values at points of both sides of all triangles, beside the points themselves.
fn between(scene: &Scene, set: &InterpolationMesh, value: impl Fn(Vec3) -> f32) -> Vec<(Vec3, f32)> {
    let values: Vec<Vec4> = set.points.iter().map(|p| Vec4::splat(value(p.position))).collect();
    let mut found = Vec::new();
    for t in 0..scene.geometry.triangles.len() as u32 {
        for (u, v) in [(0.33, 0.33), (0.1, 0.7), (0.6, 0.05), (0.02, 0.02)] {
            let hit = Hit { triangle: t, u, v, t: 1.0 };
            let place = scene.tables().position(t, u, v);
            for front in [true, false] {
                found
                    .push((place, interpolate_receivers(&set.grids, &set.cells, &set.vertices, &values, hit, front).x));
            }
        }
    }
    found
}

#[test]
fn a_fine_mesh_needs_no_more_receivers_than_a_coarse_one() {
    let of = |n: u32| receivers(&scene(sheet(Vec3::ZERO, Vec3::X, Vec3::Z, n)), 0.2).points.len();
    let coarse = of(1);
    let fine = of(64);
    assert!(fine <= 3 * coarse && fine < 2 * 65 * 65 / 10, "{coarse} {fine}");
    // The two sides share nothing.
    let flat = scene(sheet(Vec3::ZERO, Vec3::X, Vec3::Z, 1));
    let set = receivers(&flat, 0.2);
    assert_eq!(set.points.iter().filter(|p| p.normal.y > 0.0).count() * 2, set.points.len());
}

#[test]
fn values_between_receivers_follow_a_linear_field() {
    let ramp = |p: Vec3| 1.0 + 2.0 * p.x - 0.5 * p.z;
    for n in [1, 7, 40] {
        let scene = scene(sheet(Vec3::ZERO, Vec3::X, Vec3::Z, n));
        let edge = 0.1;
        let set = receivers(&scene, edge);
        // A vertex may take the value of a receiver 0.4 edges away, a small triangle that of its middle.
        let bound = 0.8 * edge * Vec3::new(2.0, 0.0, 0.5).length();
        let worst = |set: &InterpolationMesh| {
            between(&scene, set, ramp).into_iter().map(|(p, found)| (found - ramp(p)).abs()).fold(0.0, f32::max)
        };
        assert!(worst(&set) < bound, "{n}: {} above {bound}", worst(&set));
        let constant = between(&scene, &set, |_| 3.0);
        assert!(constant.iter().all(|(_, found)| (found - 3.0).abs() < 1e-5));
        let mut shuffled = set.clone();
        shuffled.vertices.rotate_left(set.vertices.len() / 3);
        assert!(worst(&shuffled) > bound);
    }
}

#[test]
fn receivers_do_not_look_through_a_wall() {
    // The floor runs on below a wall without thickness at x = 0.93; its cells straddle the wall.
    let mut triangles = sheet(Vec3::ZERO, Vec3::Z, Vec3::X * 2.0, 4);
    triangles.extend(sheet(Vec3::new(0.93, -0.5, -1.0), Vec3::Y * 2.0, Vec3::Z * 3.0, 1));
    let scene = scene(triangles);
    let set = receivers(&scene, 0.2);
    let geometry = scene.tables();
    // The middle of every cell of the floor sees the receivers of its vertices.
    let blind = |set: &InterpolationMesh| {
        let mut count = 0;
        for t in (0..scene.geometry.triangles.len() as u32).filter(|&t| geometry.normal(t).y.abs() > 0.9) {
            for (front, sign) in [(true, 1.0), (false, -1.0)] {
                let up = geometry.normal(t) * (0.02 * sign);
                for (middle, own) in cells(&scene, set, t, front) {
                    for receiver in own {
                        let way = set.points[receiver as usize].position - middle;
                        count += usize::from(scene.occluded(middle + up, way.normalize(), way.length()));
                    }
                }
            }
        }
        count
    };
    assert_eq!(blind(&set), 0);
    // Without care the vertices of a cell lie beyond it.
    let mut naive = set.clone();
    for point in naive.points.iter_mut().filter(|p| p.normal.y.abs() > 0.9 && p.position.x < 0.93) {
        point.position.x += 0.2;
    }
    assert!(blind(&naive) > 0);
}

#[test]
fn vertices_of_bad_receivers_take_good_ones_beside_them() {
    let scene = scene(sheet(Vec3::ZERO, Vec3::Z, Vec3::X, 1));
    let full = receivers(&scene, 0.1);
    let mut set = full.clone();
    let wanted: Vec<bool> = full.points.iter().map(|p| p.position.x > 0.45).collect();
    assert!(set.retain(&scene, &wanted[1..]).is_err());
    let kept = set.retain(&scene, &wanted).unwrap();
    let flags: Vec<bool> = kept.iter().map(|&k| wanted[k as usize]).collect();
    assert!(kept.iter().zip(&set.points).all(|(&k, p)| p.position == full.points[k as usize].position));
    assert!(set.points.len() <= full.points.len());
    assert!(set.points.iter().enumerate().all(|(k, p)| p.patch as usize == k));
    assert_eq!(flags.len(), set.points.len());
    let mut good = 0;
    let mut mixed_before = 0;
    let mut grown = 0;
    for t in 0..2 {
        for (own, before) in cells(&scene, &set, t, true).iter().zip(cells(&scene, &full, t, true)) {
            let all = own.1.iter().filter(|&&r| flags[r as usize]).count();
            // A good vertex stays so, and those beside it become so.
            let good_before = before.1.iter().filter(|&&r| full.points[r as usize].position.x > 0.45).count();
            assert!(all >= good_before && (all > 0) == (good_before > 0));
            grown += usize::from(all > good_before);
            mixed_before += usize::from(good_before > 0 && good_before < before.1.len());
            good += usize::from(all > 0);
        }
    }
    assert!(mixed_before > 0 && good > 0 && grown > 0);
}

#[test]
fn cells_without_a_length_have_no_receivers_and_short_lengths_many() {
    let scene = scene(sheet(Vec3::ZERO, Vec3::Z, Vec3::X, 1));
    let sides = find_sides(&scene, SidePolicy::Both);
    let with = |length: fn(&scene::SurfacePoint, f32) -> Option<f32>| {
        InterpolationMesh::new(&scene, &Density::default(), &sides, 0.25, 0.01, length, nowhere).unwrap()
    };
    let even = with(|_, _| Some(0.25));
    let half = with(|p, _| (p.position.x > 0.5).then_some(0.25));
    let fine = with(|p, _| Some(if p.position.x > 0.5 { 0.05 } else { 0.25 }));
    assert!(half.points.len() < even.points.len() && fine.points.len() > 5 * even.points.len());
    assert!(half.points.iter().all(|p| p.position.x > 0.2));
    let left = fine.points.iter().filter(|p| p.position.x < 0.4).count();
    assert!(left < fine.points.len() / 5);
    // What has no length may have another.
    let lengths = |p: &scene::SurfacePoint, _: f32| (p.position.x > 0.5).then_some(0.25);
    let otherwise = |points: &[scene::SurfacePoint], _: u32| {
        Ok(points.iter().map(|p| (p.position.z > 0.5).then_some(0.05)).collect())
    };
    let filled = InterpolationMesh::new(&scene, &Density::default(), &sides, 0.25, 0.01, lengths, otherwise).unwrap();
    // One answer is needed for each cell that asks.
    let none = |_: &[scene::SurfacePoint], _: u32| Ok(Vec::new());
    let refused = InterpolationMesh::new(&scene, &Density::default(), &sides, 0.25, 0.01, lengths, none);
    assert!(matches!(refused, Err(Error::Shared(transport::Error::Length { name: "lengths", .. }))));
    let few = |set: &InterpolationMesh, z: f32| {
        set.points.iter().filter(|p| p.position.x < 0.1 && (p.position.z > z)).count()
    };
    assert!(few(&half, 0.0) == 0 && few(&filled, 0.6) > 20 && few(&filled, 0.0) == few(&filled, 0.2));
    let found = between(&scene, &half, |_| 1.0);
    assert!(found.iter().any(|(p, value)| p.x < 0.2 && *value == 0.0));
    assert!(found.iter().filter(|(p, _)| p.x > 0.5).all(|(_, value)| (*value - 1.0).abs() < 1e-5));
}

#[test]
fn the_one_receiver_of_a_cell_is_not_inside_of_what_stands_on_it() {
    // A post about the middle of each triangle of a floor, open below.
    let posts = |turned: bool| {
        let mut triangles = sheet(Vec3::ZERO, Vec3::Z, Vec3::X, 1);
        for middle in [1.0 / 3.0, 2.0 / 3.0] {
            let low = Vec3::new(middle - 0.1, -0.05, middle - 0.1);
            let [x, y, z] = [Vec3::X * 0.2, Vec3::Y * 0.5, Vec3::Z * 0.2];
            let walls = [(low, z, y), (low + x, y, z), (low, y, x), (low + z, x, y), (low + y, z, x)];
            for (corner, a, b) in walls {
                let (a, b) = if turned { (b, a) } else { (a, b) };
                triangles.extend(sheet(corner, a, b, 1));
            }
        }
        scene(triangles)
    };
    let receivers = |scene: &Scene| {
        let sides = vec![Sides { front: true, back: false }; scene.geometry.triangles.len()];
        let within = |_: &scene::SurfacePoint, _: f32| Some(10.0);
        InterpolationMesh::new(scene, &Density::default(), &sides, 10.0, 1e-3, within, nowhere).unwrap()
    };
    let of_floor = |set: &InterpolationMesh| -> Vec<Vec3> {
        let floor = set.points.iter().filter(|p| p.normal.y > 0.9 && p.position.y.abs() < 1e-3);
        floor.map(|p| p.position).collect()
    };
    let is_in_post = |p: &Vec3| [1.0 / 3.0, 2.0 / 3.0].iter().any(|m| (p.x - m).abs() < 0.1 && (p.z - m).abs() < 0.1);
    let outside = of_floor(&receivers(&posts(false)));
    assert!(outside.len() == 2 && !outside.iter().any(is_in_post), "{outside:?}");
    // What shows its fronts to the inside has light of its own there.
    let inside = of_floor(&receivers(&posts(true)));
    assert!(inside.len() == 2 && inside.iter().all(is_in_post), "{inside:?}");
}

#[test]
fn wrong_edges_are_refused() {
    let scene = scene(sheet(Vec3::ZERO, Vec3::Z, Vec3::X, 1));
    for edge in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let sides = find_sides(&scene, SidePolicy::Both);
        let found = InterpolationMesh::new(&scene, &Density::default(), &sides, edge, 0.1, |_, _| Some(0.1), nowhere);
        assert!(matches!(found, Err(Error::Shared(transport::Error::Setting { name: "edge", .. }))), "{edge}");
        let found = InterpolationMesh::new(&scene, &Density::default(), &sides, 0.1, edge, |_, _| Some(0.1), nowhere);
        assert!(matches!(found, Err(Error::Shared(transport::Error::Setting { name: "weld", .. }))), "{edge}");
    }
    assert!(matches!(
        InterpolationMesh::new(&scene, &Density::default(), &[], 1.0, 0.1, |_, _| None, nowhere),
        Err(Error::Shared(transport::Error::Length { .. }))
    ));
}

#[test]
fn needles_are_refused_with_the_longest_triangle_and_a_remedy() {
    // 200 of 1,000 m × 0.1 mm, one of them longer.
    let needle = |k: u32| {
        let start = Vec3::new(0.0, 5.0 * k as f32, 0.0);
        let end = start + (if k == 17 { 1200.0 } else { 1000.0 }) * Vec3::X;
        Triangle { source: k, ..triangle(start, end, end + 1e-4 * Vec3::Y) }
    };
    let scene = scene((0..200).map(needle).collect());
    let sides = vec![Sides { front: true, back: true }; 200];
    let fine = InterpolationMesh::new(&scene, &Density::default(), &sides, 0.3, 0.1, |_, _| Some(0.3), nowhere);
    let error = fine.expect_err("they are refused");
    assert!(matches!(error, Error::LongTriangle { triangle: 17, limit: 268_435_456, .. }), "{error}");
    let message = error.to_string();
    assert!(message.contains("1200 m") && message.contains("268435456"), "{message}");
    assert!(message.contains("cut long thin triangles") && message.contains("distance between receivers"), "{message}");
    // With receivers far from each other there are few cells.
    assert!(
        InterpolationMesh::new(&scene, &Density::default(), &sides, 100.0, 1.0, |_, _| Some(100.0), nowhere).is_ok()
    );
}

#[test]
fn corners_of_the_mesh_have_the_values_of_their_receivers() {
    let scene = scene(sheet(Vec3::ZERO, Vec3::X, Vec3::Z, 5));
    let set = receivers(&scene, 0.07);
    let ramp = |p: Vec3| 1.0 + 2.0 * p.x - 0.5 * p.z;
    let values: Vec<Vec4> = set.points.iter().map(|p| Vec4::splat(ramp(p.position))).collect();
    let worst = |values: &[Vec4]| {
        let mut worst = 0.0f32;
        for front in [true, false] {
            for (t, found) in scene.geometry.triangles.iter().zip(set.corner_irradiance(values, front).unwrap()) {
                for (corner, found) in [t.corner, t.corner + t.edge_a, t.corner + t.edge_b].into_iter().zip(found) {
                    worst = worst.max((found.x - ramp(corner)).abs());
                }
            }
        }
        worst
    };
    // A vertex may take the value of a receiver 0.4 edges away.
    let bound = 0.5 * 0.07 * Vec3::new(2.0, 0.0, 0.5).length();
    assert!(worst(&values) < bound, "{}", worst(&values));
    let mut reversed = values.clone();
    reversed.reverse();
    assert!(worst(&reversed) > bound);
    // The same as the interpolation says.
    let front = set.corner_irradiance(&values, true).unwrap();
    for (triangle, (u, v), k) in [(3, (0.0, 0.0), 0), (7, (1.0, 0.0), 1), (9, (0.0, 1.0), 2)] {
        let hit = Hit { triangle, u, v, t: 1.0 };
        let found = interpolate_receivers(&set.grids, &set.cells, &set.vertices, &values, hit, true);
        assert!((found - front[triangle as usize][k]).abs().max_element() < 1e-5);
    }
    assert!(matches!(set.corner_irradiance(&values[1..], true), Err(Error::Shared(transport::Error::Length { .. }))));
    // A side without receivers is dark.
    let front_only = vec![Sides { front: true, back: false }; scene.geometry.triangles.len()];
    let half =
        InterpolationMesh::new(&scene, &Density::default(), &front_only, 0.21, 0.028, |_, _| Some(0.07), nowhere)
            .unwrap();
    let kept = vec![Vec4::ONE; half.points.len()];
    assert!(half.corner_irradiance(&kept, false).unwrap().iter().flatten().all(|v| *v == Vec4::ZERO));
    assert!(half.corner_irradiance(&kept, true).unwrap().iter().flatten().all(|v| (*v - Vec4::ONE).length() < 1e-5));
}
