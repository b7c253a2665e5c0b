//! Rows of rays after surfaces moved: equal to fresh ones, ray by ray.

extern crate scene as patchlight_scene;

use glam::{Vec2, Vec3};
use patchlight_formfactor::{KeptRow, RowEdit, RowKey, Surfaces, add_hit_rows, add_quadrant_rows};
use patchlight_scene::gpu::{Triangle, TriangleUv};
use patchlight_scene::{Hit, Material, NONE, SKY_BINS, Scene, SceneParts, SurfacePoint, sky_bin};
use transport::{HitCounts, LinearOperator as _, Patch, Proceed};

const RAYS: u32 = 256;
const SEED: u32 = 7;

fn quad(corner: Vec3, a: Vec3, b: Vec3) -> [Triangle; 2] {
    let first = Triangle { corner, edge_a: a, edge_b: b, ..Triangle::default() };
    [first, Triangle { corner: corner + a + b, edge_a: -a, edge_b: -b, ..first }]
}

/// A trough that is open above, and a board in it; the source of a triangle is its column.
fn scene(board: Vec3) -> Scene {
    let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| axis * 4.0);
    let quads = [quad(Vec3::ZERO, z, x), quad(Vec3::ZERO, y, z), quad(x, z, y), quad(Vec3::ZERO, x, y)];
    let mut triangles = quads.concat();
    triangles.extend(quad(board, 0.6 * Vec3::Z, 0.9 * Vec3::X));
    (0..).zip(&mut triangles).for_each(|(k, triangle)| triangle.source = k);
    let uvs = vec![TriangleUv { corner: Vec2::ZERO, ..TriangleUv::default() }; triangles.len()];
    Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() }).unwrap()
}

/// Points of rows: two a row.
fn points() -> (Vec<SurfacePoint>, Vec<u32>) {
    let place = |k: u32| {
        let position = Vec3::new(0.3 + 0.35 * (k % 10) as f32, 0.0, 0.2 + 0.7 * (k / 10) as f32);
        SurfacePoint { position, patch: k / 2, normal: Vec3::Y, weight: 0.5 }
    };
    ((0..50).map(place).collect(), (0..=25).map(|row| 2 * row).collect())
}

fn surfaces<'a>(
    scene: &'a Scene,
    patches: &'a [Patch],
    (points, offsets): (&'a [SurfacePoint], &'a [u32]),
) -> Surfaces<'a> {
    let owner = Box::new(|hit: &Hit, _| scene.geometry.triangles[hit.triangle as usize].source);
    let ray_offset = scene.geometry.ray_offset;
    Surfaces {
        patches,
        polygons: &[],
        row_polygons: &[],
        points,
        offsets,
        visibility: scene,
        owner,
        ray_offset,
        seed: SEED,
    }
}

fn go_on(_: usize, _: usize) -> Proceed {
    Proceed::Continue(())
}

/// Rows of hits, and of the sky where each has four quadrants.
fn rows(surfaces: &Surfaces, has_sky: bool) -> (HitCounts, HitCounts, Vec<f32>) {
    let mut rows = HitCounts::new(surfaces.patches.len()).unwrap();
    let mut sky = HitCounts::new(SKY_BINS).unwrap();
    let factors = match has_sky {
        true => add_quadrant_rows(&mut rows, (&mut sky, &sky_bin), surfaces, RAYS, &go_on),
        false => add_hit_rows(&mut rows, surfaces, RAYS, &go_on),
    };
    (rows, sky, factors.unwrap())
}

fn are_equal(a: &HitCounts, b: &HitCounts) -> bool {
    a.rows() == b.rows() && (0..a.rows()).all(|i| a.row(i) == b.row(i))
}

/// Edits all rows; with `balls` that hold the boards, or none.
fn edited(has_sky: bool, has_balls: bool) -> bool {
    let boards = [Vec3::new(1.0, 1.0, 1.0), Vec3::new(2.2, 1.7, 0.4)];
    let [old, new] = boards.map(scene);
    let patches = [Patch { centroid: Vec3::ZERO, area: 1.0, normal: Vec3::Y, triangle: NONE }; 10];
    let (points, offsets) = points();
    let before = surfaces(&old, &patches, (&points, &offsets));
    let after = surfaces(&new, &patches, (&points, &offsets));
    let is_board = |scene: &Scene, origin: Vec3, direction: Vec3| {
        let parts = |t: &&Triangle| t.source >= 8;
        let board: Vec<Triangle> = scene.geometry.triangles.iter().filter(parts).copied().collect();
        board.iter().any(|t| {
            let p = direction.cross(t.edge_b);
            let inverse = 1.0 / t.edge_a.dot(p);
            let way = origin - t.corner;
            let q = way.cross(t.edge_a);
            let [u, v, length] = [way.dot(p), direction.dot(q), t.edge_b.dot(q)].map(|x| x * inverse);
            u >= -1e-4 && v >= -1e-4 && u + v <= 1.0 + 2e-4 && length > 0.0
        })
    };
    let may_meet = |origin: Vec3, direction: Vec3| [&old, &new].iter().any(|s| is_board(s, origin, direction));
    let balls = boards.map(|corner| (corner + Vec3::new(0.45, 0.0, 0.3), 0.6));
    // The columns come in another order, to see that they are followed.
    let columns: Vec<u32> = (0..10).collect();
    let balls = if has_balls { &balls[..] } else { &[] };
    let edit = RowEdit { before: &before, after: &after, may_meet: &may_meet, balls, columns: &columns, rays: RAYS };
    let kept: Vec<KeptRow> = (0..25)
        .map(|row| KeptRow {
            row,
            key: RowKey { seed: SEED, number: row as u32 },
            points: &points[2 * row..2 * row + 2],
        })
        .collect();
    let (old_rows, old_sky, old_factors) = rows(&before, has_sky);
    let (expected, expected_sky, factors) = rows(&after, has_sky);
    let mut found = HitCounts::new(10).unwrap();
    let mut sky = HitCounts::new(SKY_BINS).unwrap();
    let with_sky = has_sky.then_some((&old_sky, &mut sky, &sky_bin as &patchlight_formfactor::SkyBin));
    let changes = edit.add(&old_rows, &kept, &mut found, with_sky, &go_on).unwrap();
    let are_factors_equal =
        has_sky || (0..25).all(|row| (old_factors[row] + changes.sky_factor[row] - factors[row]).abs() < 1e-6);
    assert!(!has_balls || changes.traced > 0 && changes.traced < u64::from(RAYS) * 25 / 2, "{}", changes.traced);
    are_equal(&found, &expected) && are_equal(&sky, &expected_sky) && are_factors_equal
}

#[test]
fn rows_follow_what_moves_as_if_they_were_made_anew() {
    assert!(edited(false, true));
    assert!(edited(true, true));
    // Rays that are not asked keep what they met.
    assert!(!edited(false, false));
}
