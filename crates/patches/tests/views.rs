//! Clusters by what samples see: how many, how large, of what, and which patch a place belongs to.

mod support;

use glam::Vec3;
use patchlight_patches::{
    Density, Error, Focus, LitSampler, MeshSettings, Nearest, PatchKind, PatchMesh, PatchSet, PatchSize, Sample,
    SubdivideSettings, ViewClusters, ViewSettings, cut_at_feet, subdivide, view_clusters,
};
use scene::{Hit, NONE, Scene, Sky};
use support::{Mesh, atrium};

/// A hall without its roof, under a sky.
fn open_hall() -> Scene {
    let mut mesh = atrium();
    mesh.triangles.retain(|t| !(t.corner.y > 4.9 && (t.corner + t.edge_a).y > 4.9 && (t.corner + t.edge_b).y > 4.9));
    let mut scene = mesh.scene(1.0);
    scene.lighting.sky = Sky { radiance: Vec3::ONE, ..scene.lighting.sky };
    scene
}

fn cut(scene: &Scene, patches: u32, seed: u32) -> ViewClusters {
    let sampler = LitSampler::new(scene, 1 << 14, Density::default(), seed).unwrap();
    view_clusters(&sampler, &ViewSettings { patches, seed, ..ViewSettings::default() }).unwrap()
}

fn clusters(scene: &Scene, patches: u32, seed: u32) -> PatchSet {
    cut(scene, patches, seed).set
}

/// Area-weighted mean of 1 − n·n̄ over all samples: 0 for flat patches.
fn bend(set: &PatchSet) -> f32 {
    let mut sum = 0.0;
    let mut area = 0.0;
    for (i, patch) in set.patches.iter().enumerate() {
        for member in set.members_of(i) {
            let sample = &set.samples[member.sample as usize];
            sum += sample.area * (1.0 - sample.normal.dot(patch.normal));
            area += sample.area;
        }
    }
    sum / area
}

#[test]
fn as_many_patches_as_wanted_share_all_samples_once() {
    let scene = open_hall();
    for count in [1, 40, 700] {
        let set = clusters(&scene, count, 0);
        assert_eq!(set.len(), count as usize);
        let mut times = vec![0; set.samples.len()];
        set.members.iter().for_each(|m| times[m.sample as usize] += 1);
        assert!(times.iter().all(|&n| n == 1));
    }
    let coarse = bend(&clusters(&scene, 40, 0));
    let fine = bend(&clusters(&scene, 700, 0));
    assert!(fine < 0.5 * coarse && fine < 0.15, "{coarse} {fine}");
}

#[test]
fn areas_are_those_of_the_surfaces_that_light_reaches() {
    // A closed box on the floor of an open one: its inside, and what is below it, are not there.
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::ZERO, Vec3::new(4.0, 2.0, 4.0), true);
    mesh.triangles.retain(|t| (t.corner + t.edge_a).y < 1.9 || (t.corner + t.edge_b).y < 1.9 || t.corner.y < 1.9);
    mesh.cuboid(Vec3::new(1.0, 0.0, 1.0), Vec3::new(3.0, 1.0, 3.0), false);
    let mut scene = mesh.scene(1.0);
    scene.lighting.sky = Sky { radiance: Vec3::ONE, ..scene.lighting.sky };
    let set = clusters(&scene, 300, 1);
    let area: f32 = set.patches.iter().map(|p| p.area).sum();
    // Floor without the foot, four walls, top and sides of the box.
    let expected = (16.0 - 4.0) + 4.0 * 8.0 + 4.0 + 4.0 * 2.0;
    assert!((area / expected - 1.0).abs() < 0.02, "{area} for {expected}");
    let buried = |p: Vec3| p.y < 0.5 && p.x > 1.01 && p.x < 2.99 && p.z > 1.01 && p.z < 2.99;
    assert!(set.samples.iter().all(|s| !buried(s.position)));
    assert!(set.samples.iter().any(|s| s.position.y < 0.01));
}

#[test]
fn elements_cut_patches_and_samples_into_runs() {
    let scene = open_hall();
    let found = cut(&scene, 200, 0);
    let samples = found.set.samples.len() as u32;
    let elements = found.elements.len() - 1;
    assert!(elements > 4 * 200 && elements <= 6 * 200, "{elements}");
    assert_eq!((found.elements[0], found.elements[elements]), (0, samples));
    assert!(found.elements.windows(2).all(|f| f[0] < f[1]));
    // A patch begins where its first element begins.
    let starts: Vec<u32> = found.patch_elements.iter().map(|&f| found.elements[f as usize]).collect();
    assert_eq!(starts, found.set.offsets);
    // Elements bend less than patches.
    let mean = |k: std::ops::Range<usize>| found.set.samples[k].iter().map(|s| s.normal).sum::<Vec3>().length();
    let length = |starts: &[u32]| starts.windows(2).map(|r| mean(r[0] as usize..r[1] as usize)).sum::<f32>();
    assert!(length(&found.elements) > length(&found.set.offsets));
    // No more elements than samples, nor than wanted.
    let few = ViewSettings { patches: 10, elements: 1000, most_elements: 50, ..ViewSettings::default() };
    let sampler = LitSampler::new(&scene, 1, Density::default(), 0).unwrap();
    assert_eq!(view_clusters(&sampler, &few).unwrap().elements.len(), 51);
}

#[test]
fn every_sample_is_nearest_to_itself_and_sides_are_separate() {
    let scene = open_hall();
    let set = clusters(&scene, 300, 2);
    let nearest = Nearest::new(&set.samples, &Density::default());
    let mut wrong = 0;
    let mut same_behind = 0;
    for (k, s) in set.samples.iter().enumerate() {
        let (found, distance) = nearest.sample(s.position, s.normal, 1.0).unwrap();
        assert!(distance < 1e-3);
        wrong += usize::from(found as usize != k);
        same_behind += usize::from(nearest.sample(s.position, -s.normal, 7.9).is_some_and(|f| f.0 as usize == k));
    }
    assert!(wrong <= set.samples.len() / 1000, "{wrong}");
    assert_eq!(same_behind, 0);
}

#[test]
fn the_grid_finds_what_looking_at_all_samples_finds() {
    let set = clusters(&open_hall(), 300, 2);
    let nearest = Nearest::new(&set.samples, &Density::default());
    let area: f32 = set.samples.iter().map(|s| s.area).sum();
    let edge = (area / set.samples.len() as f32).sqrt();
    let distance = |k: usize, p: Vec3, n: Vec3| {
        let s = &set.samples[k];
        let way = (s.position - p) / edge;
        let off = n.dot((s.position - p) / edge);
        (way.length_squared() + 15.0 * off * off + 16.0 * n.distance_squared(s.normal)).sqrt()
    };
    let mut differ = 0;
    let mut none = 0;
    for k in 0..300u32 {
        let unit = |d: u32| scene::sampling::unit(scene::sampling::hash3(k, d, 9));
        let place = Vec3::new(unit(0), unit(1), unit(2)) * 8.0 - 1.0;
        let normal =
            scene::sampling::cosine_hemisphere([Vec3::Y, Vec3::X, -Vec3::Z][k as usize % 3], (unit(3), unit(4)));
        let mut all: Vec<f32> = (0..set.samples.len()).map(|s| distance(s, place, normal)).collect();
        all.sort_by(f32::total_cmp);
        let (found, count) = nearest.samples::<3>(place, normal, 6.0);
        let expected = all.iter().filter(|d| **d < 6.0).count().min(3);
        none += usize::from(expected == 0);
        let same = count == expected && (0..count).all(|i| (found[i].1 - all[i]).abs() < 1e-3 * all[i].max(1.0));
        differ += usize::from(!same);
    }
    assert!(none < 290, "the places see nothing");
    assert_eq!(differ, 0);
}

#[test]
fn there_is_nothing_near_far_places_and_nothing_among_no_samples() {
    let set = clusters(&open_hall(), 100, 2);
    for far in [1e4, 1e30, f32::INFINITY] {
        assert_eq!(Nearest::new(&set.samples, &Density::default()).sample(Vec3::splat(-far), Vec3::Y, 8.0), None);
    }
    let (_, found) = Nearest::new(&[], &Density::default()).samples::<4>(Vec3::ZERO, Vec3::Y, 8.0);
    assert_eq!(found, 0);
}

#[test]
fn threads_change_no_byte_and_the_seed_does() {
    let scene = open_hall();
    let with = |threads: usize, seed: u32| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| clusters(&scene, 100, seed))
    };
    assert_eq!(with(1, 3), with(2, 3));
    assert_ne!(with(2, 3), with(2, 4));
}

#[test]
fn probe_samples_inside_of_a_floor_do_not_speak_for_the_room_above_it() {
    // A yard whose floor is of layers, all together twenty times thinner than the distance of probe samples.
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::new(-40.0, -0.09, -40.0), Vec3::new(40.0, 0.0, 40.0), false);
    for layer in 1..9 {
        mesh.quad(Vec3::new(-40.0, -0.01 * layer as f32, -40.0), 80.0 * Vec3::Z, 80.0 * Vec3::X);
    }
    for (corner, way) in [
        (Vec3::new(-40.0, 0.0, -40.0), Vec3::X),
        (Vec3::new(-40.0, 0.0, 40.0), Vec3::X),
        (Vec3::new(-40.0, 0.0, -40.0), Vec3::Z),
        (Vec3::new(40.0, 0.0, -40.0), Vec3::Z),
    ] {
        mesh.quad(corner, 80.0 * way, 60.0 * Vec3::Y);
    }
    let scene = mesh.scene(1.0);
    let sampler = LitSampler::new(&scene, 1, Density::default(), 0).unwrap();
    let above = |s: &Sample| s.normal.y > 0.9 && s.position.y > -0.01;
    let samples: Vec<Sample> = sampler.candidates(20_000, 7).into_iter().filter(above).collect();
    let dark = sampler.are_lit(&samples, 7).unwrap().into_iter().filter(|is_lit| !is_lit).count();
    let share = dark as f64 / samples.len() as f64;
    println!("dark places of a floor under the sky: {share}");
    assert!(share < 1e-3, "{share}");
}

/// A room of 4 × 2 × 4 m without a roof, with whatever else is put into it.
fn roofless(mut mesh: Mesh) -> Scene {
    let x = 4.0 * Vec3::X;
    let y = 2.0 * Vec3::Y;
    let z = 4.0 * Vec3::Z;
    mesh.quad(Vec3::ZERO, z, x);
    mesh.quad(Vec3::ZERO, y, z);
    mesh.quad(Vec3::ZERO, x, y);
    mesh.quad(x + z, -z, y);
    mesh.quad(x + z, y, -x);
    let mut scene = mesh.scene(1.0);
    scene.lighting.sky = Sky { radiance: Vec3::ONE, ..scene.lighting.sky };
    scene
}

#[test]
fn no_sample_lies_between_a_carpet_and_its_floor() {
    // Fronts upwards, 2 mm above the floor.
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::new(1.0, 0.002, 1.0), 2.0 * Vec3::Z, 2.0 * Vec3::X);
    let scene = roofless(mesh);
    let set = clusters(&scene, 300, 1);
    let below = |s: &&Sample| {
        let over = s.position.x > 1.0 && s.position.x < 3.0 && s.position.z > 1.0 && s.position.z < 3.0;
        over && (s.position.y < 0.001 || s.normal.y < 0.0)
    };
    assert_eq!(set.samples.iter().filter(below).count(), 0);
    // The carpet itself has samples all over.
    let on: f32 = set.samples.iter().filter(|s| (s.position.y - 0.002).abs() < 1e-4).map(|s| s.area).sum();
    assert!((on / 4.0 - 1.0).abs() < 0.05, "{on}");
}

#[test]
fn what_lies_in_a_gap_has_no_light_of_the_other_side_of_its_wall() {
    // A cupboard 1 mm before a wall that another one outside sees.
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::new(0.001, 0.5, 1.0), Vec3::new(0.5, 1.5, 3.0), false);
    mesh.quad(Vec3::new(-2.0, 0.0, 0.0), 2.0 * Vec3::Y, 4.0 * Vec3::Z);
    let scene = roofless(mesh);
    let sampler = LitSampler::new(&scene, 1 << 14, Density::default(), 1).unwrap();
    let settings = MeshSettings { kind: PatchKind::Cluster, count: 300, voxel_size: None, samples: 24, seed: 1 };
    let mesh = PatchMesh::new(&scene, Some(&sampler), &settings).unwrap();
    // Elements of the sides that look outwards, of all triangles in a plane of constant x.
    let outwards = |x: f32| {
        let in_plane = |t: &u32| {
            let triangle = &scene.geometry.triangles[*t as usize];
            let middle = triangle.corner + (triangle.edge_a + triangle.edge_b) / 3.0;
            (middle.x - x).abs() < 1e-5 && scene.tables().normal(*t).x.abs() > 0.9
        };
        let triangles = (0..scene.geometry.triangles.len() as u32).filter(in_plane);
        let element = |t: u32| {
            let hit = Hit { triangle: t, u: 0.3, v: 0.3, t: 0.0 };
            mesh.element_on_side(&hit, scene.tables().normal(t).x < 0.0)
        };
        triangles.map(element).collect::<Vec<u32>>()
    };
    let back = outwards(0.001);
    let wall = outwards(0.0);
    assert_eq!((back.len(), wall.len()), (2, 2));
    assert!(wall.iter().all(|&element| element != NONE), "light comes to the outside of the wall");
    assert_eq!(back, [NONE; 2], "the cupboard's back is dark");
}

#[test]
fn no_patch_lies_on_both_sides_of_a_wall_on_a_common_floor() {
    // A low sheet across the whole room: both halves are alike in all but place.
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::new(2.0, 0.0, 0.0), 0.6 * Vec3::Y, 4.0 * Vec3::Z);
    let scene = roofless(mesh);
    let found = cut(&scene, 150, 1);
    assert_eq!((straddling(&found, &found.set.offsets), straddling(&found, &found.elements)), (0, 0));
    let open = cut(&roofless(Mesh::default()), 150, 1);
    assert!(straddling(&open, &open.set.offsets) > 0, "without the wall some lie on both sides");
}

/// Ranges of samples that lie on the floor on both sides of x = 2.
fn straddling(found: &ViewClusters, starts: &[u32]) -> usize {
    let both = |range: &&[u32]| {
        let own = &found.set.samples[range[0] as usize..range[1] as usize];
        let on_floor = |left: bool| own.iter().any(|s| s.normal.y > 0.9 && (s.position.x < 2.0) == left);
        on_floor(true) && on_floor(false)
    };
    starts.windows(2).filter(both).count()
}

/// A closed room of 4 × 4 × 4 m with a slit of 0.3 m through which sky comes: few walks from its walls come to light.
fn dim_room() -> Scene {
    let mut mesh = Mesh::default();
    let x = 4.0 * Vec3::X;
    let y = 4.0 * Vec3::Y;
    let z = 4.0 * Vec3::Z;
    mesh.quad(Vec3::ZERO, z, x);
    mesh.quad(Vec3::ZERO, y, z);
    mesh.quad(Vec3::ZERO, x, y);
    mesh.quad(x + z, -z, y);
    mesh.quad(x + z, y, -x);
    mesh.quad(y, 1.7 / 4.0 * x, z);
    mesh.quad(y + 0.5 * x, 0.5 * x, z);
    let mut scene = mesh.scene(1.0);
    scene.lighting.sky = Sky { radiance: Vec3::ONE, ..scene.lighting.sky };
    scene
}

#[test]
fn patches_of_a_dark_room_have_the_area_of_its_surfaces() {
    let scene = dim_room();
    let expected = 6.0 * 16.0 - 4.0 * 0.3;
    let settings = SubdivideSettings { size: PatchSize::Count(600), points: 16, ..SubdivideSettings::default() };
    let polygons: f32 = subdivide(&scene, &settings).unwrap().areas().iter().sum();
    // The outside sees no geometry.
    let sampler = LitSampler::new(&scene, 1, Density::default(), 0).unwrap();
    println!("{expected} m²: polygons {polygons}, samples {}", sampler.lit_area());
    assert!((polygons / expected - 1.0).abs() < 0.005, "{polygons} for {expected}");
    assert!((sampler.lit_area() as f32 / expected - 1.0).abs() < 0.02, "{} for {expected}", sampler.lit_area());
}

/// A house of 4 × 3 × 4 m on 800 m of ground, under a sky: from far off few rays meet the house.
#[test]
fn open_ground_none_of_whose_rays_meets_anything_takes_part() {
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::new(-2.0, 0.1, -2.0), Vec3::new(2.0, 3.1, 2.0), false);
    mesh.quad(Vec3::new(-400.0, 0.0, -400.0), 800.0 * Vec3::Z, 800.0 * Vec3::X);
    let mut scene = mesh.scene(1.0);
    scene.lighting.sky = Sky { radiance: Vec3::ONE, ..scene.lighting.sky };
    let focus = Focus::Box { low: Vec3::new(-2.0, 0.1, -2.0), high: Vec3::new(2.0, 3.1, 2.0) };
    let density = Density::new(&scene, focus, 0).unwrap();
    let cut = cut_at_feet(&scene, &density, 1.0).unwrap().unwrap();
    let is_far = |position: Vec3| position.length() > 100.0;
    let ground = 800.0 * 800.0 - std::f32::consts::PI * 100.0 * 100.0;
    let share = |areas: f32| areas / ground;

    let sampler = LitSampler::new(&cut, 1 << 14, density, 0).unwrap();
    let samples = sampler.samples(5000, 1).unwrap();
    let sampled = share(samples.iter().filter(|s| is_far(s.position)).map(|s| s.area).sum());
    let settings =
        |density| SubdivideSettings { size: PatchSize::Count(1000), density, points: 4, ..Default::default() };
    let polygons = |density: Density| -> f32 {
        let found = subdivide(&cut, &settings(density)).unwrap();
        share(found.patches.iter().filter(|p| is_far(p.centroid)).map(|p| p.area).sum())
    };
    let near = polygons(density);
    let without = polygons(Density::default());
    println!("far ground: samples {sampled}, polygons {near}, without a focus {without}");
    assert!((sampled - 1.0).abs() < 0.1 && (near - 1.0).abs() < 0.1, "{sampled} {near}");
    assert!(without < 0.5, "without a focus it is left out: {without}");
    // It is shared out by what it sends: few patches, however much of it there is.
    let far = samples.iter().filter(|s| is_far(s.position)).count();
    assert!(far < samples.len() / 8, "{far} of {}", samples.len());
}

#[test]
fn settings_and_scenes_that_give_nothing_are_errors() {
    let scene = open_hall();
    let sampler = LitSampler::new(&scene, 1, Density::default(), 0).unwrap();
    for settings in
        [ViewSettings { patches: 0, ..ViewSettings::default() }, ViewSettings { samples: 0, ..ViewSettings::default() }]
    {
        assert!(matches!(view_clusters(&sampler, &settings), Err(Error::Setting { .. })));
    }
    let huge = ViewSettings { patches: u32::MAX, ..ViewSettings::default() };
    assert!(matches!(view_clusters(&sampler, &huge), Err(Error::TooMany { .. })));
    // Closed and without a light.
    let dark = atrium().scene(1.0);
    assert!(matches!(LitSampler::new(&dark, 1, Density::default(), 0), Err(Error::NoSamples)));
}
