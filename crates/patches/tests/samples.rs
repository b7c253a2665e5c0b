//! Samples: areas, sides, sheets, the same bytes for any thread count.

mod support;

use glam::{Vec2, Vec3};
use patchlight_patches::{AreaRule, Error, Grid, Sample, SampleSet, SampleSettings, sample_voxels};
use scene::gpu::{Texture, TriangleUv};
use scene::{Material, Scene, SceneParts};
use support::{Mesh, atrium, two_rooms};

fn all(_: &Sample) -> bool {
    true
}

/// Keeps the fronts of the mesh.
fn fronts(scene: &Scene) -> impl Fn(&Sample) -> bool + Sync {
    |s| scene.tables().normal(s.triangle).dot(s.normal) > 0.0
}

fn area(set: &SampleSet) -> f64 {
    set.samples.iter().map(|s| f64::from(s.area)).sum()
}

/// Returns true if the areas sum to the expected one within the promised 10⁻⁴.
fn sums_to(set: &SampleSet, expected: f64) -> bool {
    (area(set) / expected - 1.0).abs() < 1e-4
}

#[test]
fn clipped_areas_sum_to_the_mesh_area() {
    let expected = atrium().area();
    for scale in [0.01, 1.0, 1000.0] {
        let scene = atrium().scene(scale);
        let whole = expected * f64::from(scale).powi(2);
        for edge in [0.37, 1.0, 3.0] {
            let grid = Grid::new(&scene, Vec3::new(edge, 0.8 * edge, 1.1 * edge) * scale).unwrap();
            assert!((grid.area() / whole - 1.0).abs() < 1e-5, "grid {} of {whole}", grid.area());
            for points in [9, 64] {
                let settings = SampleSettings { points, ..SampleSettings::default() };
                let mut set = sample_voxels(&scene, &grid, &settings, &fronts(&scene)).unwrap();
                assert!(sums_to(&set, whole), "{scale} {edge} {points}: {} of {whole}", area(&set));
                assert!((set.report.surface_area / whole - 1.0).abs() < 1e-4);
                // One sample in a thousand lost must show.
                let kept = set.samples.len() * 999 / 1000 - 1;
                set.samples.truncate(kept);
                assert!(!sums_to(&set, whole));
            }
        }
    }
}

#[test]
fn projected_areas_tend_to_what_is_seen() {
    let scene = atrium().scene(1.0);
    let grid = Grid::new(&scene, Vec3::splat(0.8)).unwrap();
    let mut errors = Vec::new();
    for points in [16, 256, 1024] {
        let settings = SampleSettings { points, rule: AreaRule::Projected, ..SampleSettings::default() };
        let set = sample_voxels(&scene, &grid, &settings, &fronts(&scene)).unwrap();
        errors.push((area(&set) / atrium().area() - 1.0).abs());
    }
    println!("projected rule, error of the area with 16, 256, 1024 rays a face: {errors:?}");
    assert!(errors[2] < 2e-3, "{errors:?}");
    // The first surfaces only: the rest is hidden from the faces.
    let settings = SampleSettings { points: 256, layers: 1, rule: AreaRule::Projected, seed: 0 };
    let first = sample_voxels(&scene, &grid, &settings, &fronts(&scene)).unwrap();
    assert!(area(&first) < 0.999 * atrium().area());
}

#[test]
fn both_sides_of_a_free_sheet_are_counted() {
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::new(0.1, 0.2, 0.3), Vec3::new(2.0, 0.3, 0.1), Vec3::new(-0.2, 1.4, 0.7));
    mesh.quad(Vec3::new(0.1, 0.2, 2.0), Vec3::new(2.0, 0.0, 0.0), Vec3::new(0.0, 0.0, 1.0));
    let whole = mesh.area();
    let scene = mesh.scene(1.0);
    for edge in [0.25, 0.5, 4.0] {
        let grid = Grid::new(&scene, Vec3::splat(edge)).unwrap();
        let set = sample_voxels(&scene, &grid, &SampleSettings::default(), &all).unwrap();
        assert!(sums_to(&set, 2.0 * whole), "{} of {}", area(&set), 2.0 * whole);
        assert!(!sums_to(&set, whole));
    }
}

/// Samples of each of the four sides of two sheets at z = 1 and z = 1.01: (which sheet, which side).
fn sheet_sides(set: &SampleSet) -> [[usize; 2]; 2] {
    let mut sides = [[0; 2]; 2];
    for s in &set.samples {
        sides[usize::from(s.position.z > 1.005)][usize::from(s.normal.z > 0.0)] += 1;
    }
    sides
}

#[test]
fn sheets_with_a_centimetre_between_them_have_samples_on_all_four_sides() {
    let mut mesh = Mesh::default();
    for z in [1.0, 1.01] {
        mesh.quad(Vec3::new(0.0, 0.0, z), Vec3::X, Vec3::Y);
    }
    // Two small sheets far off, so that both lie in the middle of one voxel.
    for z in [-4.0, 6.01] {
        mesh.quad(Vec3::new(0.4, 0.4, z), Vec3::X * 0.2, Vec3::Y * 0.2);
    }
    let scene = mesh.scene(1.0);
    let grid = Grid::new(&scene, Vec3::new(1.2, 1.2, 2.1)).unwrap();
    let between = |s: &Sample| s.position.z > 0.5 && s.position.z < 2.0;
    let sides_of = |layers: u32| {
        let settings = SampleSettings { layers, ..SampleSettings::default() };
        let mut set = sample_voxels(&scene, &grid, &settings, &all).unwrap();
        set.samples.retain(between);
        set
    };
    let set = sides_of(8);
    let counts = sheet_sides(&set);
    assert!(counts.iter().flatten().all(|&n| n > 40), "{counts:?}");
    for sheet in [false, true] {
        for side in [-1.0, 1.0] {
            let of = |s: &&Sample| (s.position.z > 1.005) == sheet && s.normal.z * side > 0.0;
            let area: f32 = set.samples.iter().filter(of).map(|s| s.area).sum();
            assert!((area - 1.0).abs() < 1e-3, "{sheet} {side}: {area}");
        }
    }
    // The thesis's rays stop at the first sheet: the sides that face each other are lost.
    let counts = sheet_sides(&sides_of(1));
    assert!(counts[0][0] > 40 && counts[1][1] > 40 && counts[0][1] == 0 && counts[1][0] == 0, "{counts:?}");
}

#[test]
fn the_inside_of_a_housing_in_one_voxel_has_its_own_samples() {
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::new(0.41, 0.42, 0.43), Vec3::new(0.61, 0.62, 0.63), false);
    for corner in [Vec3::ZERO, Vec3::new(0.98, 0.0, 0.99)] {
        mesh.quad(corner, Vec3::X * 0.01, Vec3::Y);
    }
    let scene = mesh.scene(1.0);
    let grid = Grid::new(&scene, Vec3::splat(1.1)).unwrap();
    assert_eq!(grid.len(), 1);
    let middle = Vec3::new(0.51, 0.52, 0.53);
    let of_housing = |s: &Sample| (s.position - middle).abs().max_element() < 0.11;
    let settings = SampleSettings { points: 256, ..SampleSettings::default() };
    let set = sample_voxels(&scene, &grid, &settings, &of_housing).unwrap();
    for inside in [false, true] {
        let of = |s: &&Sample| ((s.position - middle).dot(s.normal) < 0.0) == inside;
        let area: f32 = set.samples.iter().filter(of).map(|s| s.area).sum();
        assert!((area - 0.24).abs() < 1e-4, "{inside}: {area}");
    }
    // Refused, the inside leaves nothing behind, and its area goes to nobody.
    let outside = |s: &Sample| of_housing(s) && (s.position - middle).dot(s.normal) > 0.0;
    let set = sample_voxels(&scene, &grid, &settings, &outside).unwrap();
    assert!(sums_to(&set, 0.24) && set.report.refused > 0, "{:?}", set.report);
}

#[test]
fn a_wall_without_thickness_has_samples_for_both_rooms() {
    let scene = two_rooms().scene(1.0);
    // A voxel boundary in the wall, and voxels across it.
    for edge in [0.5, 0.37] {
        let grid = Grid::new(&scene, Vec3::splat(edge)).unwrap();
        let set = sample_voxels(&scene, &grid, &SampleSettings::default(), &all).unwrap();
        for side in [-1.0, 1.0] {
            let wall = |s: &&Sample| (s.position.x - 2.0).abs() < 1e-4 && s.normal.x * side > 0.99;
            let area: f32 = set.samples.iter().filter(wall).map(|s| s.area).sum();
            assert!((area - 4.0).abs() < 1e-3, "{edge} {side}: {area}");
        }
    }
}

/// A picture with its pyramid: the left half white and opaque, the right half black and a hole.
fn halves(size: u32) -> (Texture, Vec<u32>) {
    let mut texels = Vec::new();
    let mut width = size;
    let mut levels = 0;
    while width > 0 {
        for k in 0..width * width {
            let value = if width == 1 {
                0x8000
            } else if k % width < width / 2 {
                0xffff
            } else {
                0
            };
            texels.extend([value | value << 16, value | value << 16]);
        }
        width /= 2;
        levels += 1;
    }
    (Texture { offset: 0, width: size, height: size, levels }, texels)
}

fn textured(material: Material) -> Scene {
    let mut mesh = Mesh::default();
    mesh.triangle(Vec3::ZERO, Vec3::X * 8.0, Vec3::Y * 8.0);
    mesh.triangle(Vec3::new(8.0, 8.0, 0.0), Vec3::Y * 8.0, Vec3::X * 8.0);
    let uv = |a: Vec2, b: Vec2, c: Vec2| TriangleUv { corner: a, corner_a: b, corner_b: c, ..TriangleUv::default() };
    // The picture twice in each direction.
    let uvs = vec![uv(Vec2::ZERO, Vec2::X * 2.0, Vec2::Y * 2.0), uv(Vec2::ONE * 2.0, Vec2::Y * 2.0, Vec2::X * 2.0)];
    let (texture, texels) = halves(16);
    let textures = vec![texture];
    let materials = vec![material];
    Scene::new(SceneParts { triangles: mesh.triangles, uvs, materials, textures, texels, ..SceneParts::default() })
        .unwrap()
}

#[test]
fn holes_have_no_area() {
    let scene = textured(Material { mask_texture: 0, ..Material::default() });
    for edge in [0.9, 3.0, 9.0] {
        let grid = Grid::new(&scene, Vec3::splat(edge)).unwrap();
        let settings = SampleSettings { points: 256, ..SampleSettings::default() };
        let front = |s: &Sample| s.normal.z > 0.0;
        let set = sample_voxels(&scene, &grid, &settings, &front).unwrap();
        assert!((area(&set) / 32.0 - 1.0).abs() < 0.02, "{edge}: {}", area(&set));
        assert!(
            set.samples
                .iter()
                .all(|s| (s.position.x / 4.0).fract() < 0.5 + 1e-3 || (s.position.x / 4.0).fract() > 0.97)
        );
    }
    let solid = textured(Material::default());
    let grid = Grid::new(&solid, Vec3::splat(3.0)).unwrap();
    let set = sample_voxels(&solid, &grid, &SampleSettings::default(), &|s: &Sample| s.normal.z > 0.0).unwrap();
    assert!(sums_to(&set, 64.0));
}

#[test]
fn reflectance_is_filtered_over_the_area_of_a_sample() {
    let scene = textured(Material { albedo_texture: 0, ..Material::default() });
    let grid = Grid::new(&scene, Vec3::splat(9.0)).unwrap();
    let values = |points: u32| {
        let settings = SampleSettings { points, ..SampleSettings::default() };
        let set = sample_voxels(&scene, &grid, &settings, &|s: &Sample| s.normal.z > 0.0).unwrap();
        set.samples.iter().map(|s| s.albedo.x).collect::<Vec<_>>()
    };
    // Samples of a texel each see black and white, those of a picture each its mean.
    let fine = values(2048);
    let extreme = fine.iter().filter(|&&v| !(0.01..=0.99).contains(&v)).count();
    assert!(extreme * 2 > fine.len(), "{extreme} of {}", fine.len());
    assert!(values(4).iter().all(|v| (v - 0.5).abs() < 0.01));
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let scene = atrium().scene(1.0);
    let run = |threads: usize, seed: u32| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let grid = Grid::new(&scene, Vec3::splat(0.7)).unwrap();
            let settings = SampleSettings { points: 25, seed, ..SampleSettings::default() };
            let set = sample_voxels(&scene, &grid, &settings, &all).unwrap();
            (grid, set)
        })
    };
    let one = run(1, 5);
    assert_eq!(one, run(2, 5));
    assert_ne!(one.1, run(2, 6).1);
}

#[test]
fn bisection_finds_the_edge_for_a_count() {
    let scene = atrium().scene(1.0);
    for target in [50, 500, 3000] {
        let grid = Grid::for_count(&scene, Vec3::new(1.0, 2.0, 1.0), target, |grid| Ok(grid.len())).unwrap();
        let found = grid.len() as f64;
        assert!((found / target as f64 - 1.0).abs() < 0.05, "{found} for {target}");
        assert_eq!(grid.shape.edges.y, 2.0 * grid.shape.edges.x);
    }
}

#[test]
fn wrong_settings_are_refused() {
    let scene = two_rooms().scene(1.0);
    for edges in [Vec3::ZERO, Vec3::new(1.0, -1.0, 1.0), Vec3::new(1.0, 1.0, f32::NAN), Vec3::INFINITY] {
        assert!(matches!(Grid::new(&scene, edges), Err(Error::Setting { .. })));
    }
    assert!(matches!(Grid::new(&scene, Vec3::splat(1e-4)), Err(Error::TooMany { .. })));
    assert!(matches!(Grid::for_count(&scene, Vec3::ONE, 0, |g| Ok(g.len())), Err(Error::Setting { .. })));
    let grid = Grid::new(&scene, Vec3::ONE).unwrap();
    for (points, layers) in [(0, 1), (1, 0)] {
        let settings = SampleSettings { points, layers, ..SampleSettings::default() };
        assert!(matches!(sample_voxels(&scene, &grid, &settings, &all), Err(Error::Setting { .. })));
    }
    let none = sample_voxels(&scene, &grid, &SampleSettings::default(), &|_: &Sample| false);
    assert!(matches!(none, Err(Error::NoSamples)));
}
