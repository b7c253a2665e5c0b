//! The lightmap: constants stay, linear fields too, charts never mix, what stands on a floor leaves no dark rim.

mod support;

use glam::{Vec2, Vec3, Vec4};
use patchlight_patches::{Error, LIGHTMAP_LIMIT, LightmapTexels};
use scene::gpu::TriangleUv;
use scene::sampling::{hash3, uniform_triangle, unit};
use scene::{ReceiverSet, Scene, Sides, SurfacePoint};
use support::{Mesh, atrium};

const BOTH: Sides = Sides { front: true, back: true };

fn lightmap(scene: &Scene, texel: f32) -> LightmapTexels {
    LightmapTexels::new(scene, &vec![BOTH; scene.geometry.triangles.len()], texel, &|_| true).unwrap()
}

/// A place on a side of any triangle.
fn random(scene: &Scene, k: u32) -> (u32, bool, f32, f32) {
    let number = |d: u32| unit(hash3(k, d, 33));
    let (u, v) = uniform_triangle((number(0), number(1)));
    (hash3(k, 5, 5) % scene.geometry.triangles.len() as u32, number(2) < 0.5, u, v)
}

#[test]
fn a_constant_stays_constant_everywhere() {
    let scene = atrium().scene(1.0);
    let map = lightmap(&scene, 0.11);
    let constant = Vec4::new(0.3, 7.0, 1e-3, 1.0);
    let mut values = vec![constant; map.points().len()];
    let is_constant = |values: &[Vec4]| {
        (0..10_000).all(|k| {
            let (triangle, front, u, v) = random(&scene, k);
            let found = map.at(values, triangle, front, u, v).unwrap();
            ((found - constant) / constant).abs().max_element() < 1e-5
        })
    };
    assert!(is_constant(&values));
    let half = values.len() / 2;
    values[half..].iter_mut().for_each(|v| *v *= 1.01);
    assert!(!is_constant(&values));
}

#[test]
fn a_linear_field_is_reproduced_and_no_chart_shows_another() {
    let scene = atrium().scene(1.0);
    let texel = 0.13;
    let map = lightmap(&scene, texel);
    let geometry = scene.tables();
    let places: Vec<Vec4> = map.points().iter().map(|p| p.position.extend(0.0)).collect();
    let normals: Vec<Vec4> = map.points().iter().map(|p| p.normal.extend(0.0)).collect();
    let mut worst = 0.0f32;
    let mut inner = 0;
    for k in 0..20_000 {
        let (triangle, front, u, v) = random(&scene, k);
        let place = geometry.position(triangle, u, v);
        let normal = geometry.normal(triangle) * if front { 1.0 } else { -1.0 };
        let error = (map.at(&places, triangle, front, u, v).unwrap().truncate() - place).length();
        // Border texels stand at the edge of their triangle: no further away than their middles.
        assert!(error < 1.5 * texel, "{error} at triangle {triangle}");
        let found = map.at(&normals, triangle, front, u, v).unwrap().truncate();
        // Inside of a chart edges bend by less than 30 degrees.
        assert!(found.dot(normal) > 0.866 * found.length() && found.length() > 0.9, "{found} {normal}");
        let t = scene.geometry.triangles[triangle as usize];
        let double = t.edge_a.cross(t.edge_b).length();
        let heights = [
            u * double / t.edge_b.length(),
            v * double / t.edge_a.length(),
            (1.0 - u - v) * double / (t.edge_b - t.edge_a).length(),
        ];
        if heights.into_iter().fold(f32::INFINITY, f32::min) > 1.5 * texel {
            worst = worst.max(error);
            inner += 1;
        }
    }
    assert!(inner > 50 && worst < 1e-4, "{worst} over {inner}");
}

#[test]
fn taps_stay_on_their_triangle_and_round_their_receiver() {
    let scene = atrium().scene(1.0);
    let texel = 0.13;
    let map = lightmap(&scene, texel);
    let mut around = 0;
    for (k, (place, point)) in map.places.iter().zip(map.points()).enumerate() {
        let taps = map.taps(&scene, k).unwrap();
        let t = scene.geometry.triangles[place.triangle as usize];
        let normal = t.edge_a.cross(t.edge_b);
        for tap in taps {
            let from = tap.position - t.corner;
            let u = from.cross(t.edge_b).dot(normal) / normal.length_squared();
            let v = t.edge_a.cross(from).dot(normal) / normal.length_squared();
            assert!(u > -1e-3 && v > -1e-3 && u + v < 1.001 && tap.normal == point.normal, "{u} {v}");
            assert!((from.dot(normal) / normal.length()).abs() < 1e-4);
        }
        let mean = taps.iter().map(|tap| tap.position).sum::<Vec3>() / 4.0;
        around += usize::from(mean.distance(point.position) < 1e-4);
        assert!(mean.distance(point.position) < texel, "receiver {k}");
    }
    assert!(around > map.points().len() / 3, "{around} of {}", map.points().len());
    assert!(map.taps(&scene, map.points().len()).is_none());
}

#[test]
fn the_two_halves_of_a_rectangle_share_a_chart() {
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::ZERO, Vec3::Z * 2.0, Vec3::X * 3.0);
    let scene = mesh.scene(1.0);
    let map = lightmap(&scene, 0.1);
    // Texels of 0.1 m on 6 m² and round their edges, two sides.
    assert!((1200..=1400).contains(&map.points().len()), "{}", map.points().len());
    let values: Vec<Vec4> = map.points().iter().map(|p| Vec4::splat(p.position.x * p.position.z)).collect();
    let geometry = scene.tables();
    for k in 0..100 {
        // Along the diagonal that both have: u + v = 1.
        let t = k as f32 / 99.0;
        let place = geometry.position(0, 1.0 - t, t);
        let other = (0..=1000).map(|j| j as f32 / 1000.0).min_by(|a, b| {
            let far = |s: f32| geometry.position(1, 1.0 - s, s).distance(place);
            far(*a).total_cmp(&far(*b))
        });
        let s = other.unwrap();
        let a = map.at(&values, 0, true, 1.0 - t, t).unwrap();
        let b = map.at(&values, 1, true, 1.0 - s, s).unwrap();
        assert!((a.x - b.x).abs() < 0.02, "{place}: {a} {b}");
    }
    // The picture holds the same values; a texture unit would read them bilinearly.
    let picture = map.picture(&values).unwrap();
    let uv = map.uv(0, true).unwrap();
    let size = Vec2::new(map.params.width as f32, map.params.height as f32);
    let middle = ((uv.corner + uv.corner_a + uv.corner_b) / 3.0 * size).floor();
    let at = (middle.x as u32 + map.params.width * middle.y as u32) as usize;
    let there = map.points()[map.texels[at] as usize];
    assert_eq!(picture[at].x, there.position.x * there.position.z);
    assert!(there.position.distance(geometry.position(0, 1.0 / 3.0, 1.0 / 3.0)) < 0.15);
}

#[test]
fn even_meshes_take_few_charts_and_folds_take_their_own() {
    // A floor of 8 × 8 squares, a step that bends by 10 degrees, and a wall.
    let mut mesh = Mesh::default();
    let at = |i: u32, j: u32| Vec3::new(0.5 * i as f32, 0.0, 0.5 * j as f32);
    for (i, j) in (0..8).flat_map(|i| (0..8).map(move |j| (i, j))) {
        mesh.quad(at(i, j), Vec3::Z * 0.5, Vec3::X * 0.5);
    }
    let rise = 0.173_65;
    let run = 0.984_81;
    mesh.quad(at(8, 0), Vec3::Z * 4.0, Vec3::new(run, rise, 0.0));
    mesh.quad(at(0, 0), Vec3::Y * 2.0, Vec3::Z * 4.0);
    let scene = mesh.scene(1.0);
    let sides = vec![Sides { front: true, back: false }; scene.geometry.triangles.len()];
    let map = LightmapTexels::new(&scene, &sides, 0.1, &|_| true).unwrap();
    // Three charts of 4 × 4, 4 × 1 and 4 × 2 m with a texel about each, but not at its corners, and no more.
    assert_eq!(map.points().len(), 42 * 42 + 42 * 12 + 42 * 22 - 3 * 4);
    // What is a metre apart on the floor is ten texels apart in the atlas.
    let size = Vec2::new(map.params.width as f32, map.params.height as f32);
    let floor = |t: &u32| scene.tables().normal(*t).y > 0.999;
    let corners = |t: u32| {
        let triangle = &scene.geometry.triangles[t as usize];
        (triangle.corner, map.uv(t, true).unwrap().corner * size)
    };
    let floor: Vec<(Vec3, Vec2)> = (0..scene.geometry.triangles.len() as u32).filter(floor).map(corners).collect();
    assert_eq!(floor.len(), 128);
    let is_even = |texel: f32| {
        let near = |a: &(Vec3, Vec2), b: &(Vec3, Vec2)| (a.0.distance(b.0) / texel - a.1.distance(b.1)).abs() < 0.01;
        floor.iter().all(|a| floor.iter().all(|b| near(a, b)))
    };
    assert!(is_even(0.1) && !is_even(0.11));
}

#[test]
fn an_atlas_that_is_there_is_taken_as_it_is() {
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::ZERO, Vec3::Z * 2.0, Vec3::X * 3.0);
    mesh.quad(Vec3::Y, Vec3::Z * 2.0, Vec3::X * 3.0);
    let scene = mesh.scene(1.0);
    let sides = vec![Sides { front: true, back: false }; 4];
    // The lower rectangle on the left of the texture, the upper one on its right, both turned and mirrored.
    let place = |p: Vec3| Vec2::new(0.05 + 0.2 * p.z + 0.5 * p.y, 0.95 - 0.3 * p.x);
    let uvs: Vec<Option<TriangleUv>> = (scene.geometry.triangles.iter())
        .map(|t| {
            let [corner, corner_a, corner_b] = [t.corner, t.corner + t.edge_a, t.corner + t.edge_b].map(place);
            Some(TriangleUv { corner, corner_a, corner_b, ..TriangleUv::default() })
        })
        .collect();
    let map = LightmapTexels::with_uvs(&scene, &sides, &uvs, 0.05, &|_| true).unwrap();
    // 12 m² take 0.72 of the texture: a texel is 0.05 m on the mean.
    assert_eq!((map.params.width, map.params.height), (82, 82));
    for t in 0..4 {
        let given = uvs[t as usize].unwrap();
        let found = map.uv(t, true).unwrap();
        for (a, b) in [(given.corner, found.corner), (given.corner_a, found.corner_a), (given.corner_b, found.corner_b)]
        {
            assert!(a.distance(b) < 1e-5, "{a} {b}");
        }
        assert!(map.uv(t, false).is_none());
    }
    let values: Vec<Vec4> = map.points().iter().map(|p| p.position.extend(0.0)).collect();
    let geometry = scene.tables();
    for k in 0..2000 {
        let (triangle, _, u, v) = random(&scene, k);
        let u = 0.1 + 0.7 * u;
        let v = 0.1 + 0.7 * v;
        let error = map.at(&values, triangle, true, u, v).unwrap().truncate() - geometry.position(triangle, u, v);
        assert!(error.length() < 1e-4, "{error} at {triangle}");
    }
    // What lies on each other is refused, by name.
    let doubled = vec![uvs[0]; 4];
    let refused = LightmapTexels::with_uvs(&scene, &sides, &doubled, 0.05, &|_| true);
    assert!(matches!(refused, Err(Error::AtlasOverlap { triangles: [0, 1] })), "{refused:?}");
    let none = LightmapTexels::with_uvs(&scene, &sides, &[None; 4], 0.05, &|_| true).unwrap();
    assert!(none.points().is_empty() && none.uv(0, true).is_none());
}

#[test]
fn receivers_under_what_stands_on_a_floor_are_left_out() {
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0);
    let scene = mesh.scene(1.0);
    let sides = vec![Sides { front: true, back: false }; 2];
    let is_open = |p: &SurfacePoint| (p.position - Vec3::new(2.0, 0.0, 2.0)).abs().max_element() > 0.5;
    let value = |p: &SurfacePoint| Vec4::splat(f32::from(u8::from(is_open(p))));
    let dark_rim = |map: &LightmapTexels| {
        let values: Vec<Vec4> = map.points().iter().map(value).collect();
        (0..5000).any(|k| {
            let (triangle, _, u, v) = random(&scene, k);
            map.at(&values, triangle, true, u, v).unwrap().x < 0.999
        })
    };
    let map = LightmapTexels::new(&scene, &sides, 0.1, &is_open).unwrap();
    assert!(!dark_rim(&map));
    assert!(dark_rim(&LightmapTexels::new(&scene, &sides, 0.1, &|_| true).unwrap()));
    assert_eq!(map.at(&vec![Vec4::ONE; map.points().len()], 0, false, 0.3, 0.3).unwrap(), Vec4::ZERO);
    assert!(map.uv(0, false).is_none() && map.uv(9, true).is_none());
    // A scene without light has no charts.
    let none = LightmapTexels::new(&scene, &sides, 0.1, &|_| false).unwrap();
    assert!(none.points().is_empty() && none.uv(0, true).is_none());
}

#[test]
fn threads_change_nothing_and_wrong_input_is_refused() {
    let scene = atrium().scene(1.0);
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let make = || lightmap(&scene, 0.2);
    assert!(pool(1).install(make) == pool(2).install(make));
    let sides = vec![BOTH; scene.geometry.triangles.len()];
    let new = |sides: &[Sides], texel| LightmapTexels::new(&scene, sides, texel, &|_| true);
    for texel in [0.0, -1.0, f32::NAN] {
        assert!(matches!(new(&sides, texel), Err(Error::Setting { name: "texel", .. })));
    }
    assert!(matches!(new(&sides[1..], 0.1), Err(Error::Length { name: "sides", .. })));
    assert!(matches!(new(&sides, 1e-4), Err(Error::TooMany { limit, .. }) if limit == u64::from(LIGHTMAP_LIMIT)));
    assert!(matches!(new(&sides, 0.0015), Err(Error::TooMany { .. })));
    let map = make();
    assert!(matches!(map.at(&[], 0, true, 0.1, 0.1), Err(Error::Length { .. })));
    assert!(matches!(map.picture(&[]), Err(Error::Length { .. })));
}
