//! Clusters by what samples see: how many, how large, of what, and which patch a place belongs to.

mod support;

use glam::Vec3;
use patches::{Error, Nearest, PatchSet, ViewSettings, view_clusters};
use scene::{Scene, Sky};
use support::{Mesh, atrium};

/// A hall without its roof, under a sky.
fn open_hall() -> Scene {
    let mut mesh = atrium();
    mesh.triangles.retain(|t| !(t.corner.y > 4.9 && (t.corner + t.edge_a).y > 4.9 && (t.corner + t.edge_b).y > 4.9));
    let mut scene = mesh.scene(1.0);
    scene.sky = Sky { radiance: Vec3::ONE, ..scene.sky };
    scene
}

fn clusters(scene: &Scene, patches: u32, seed: u32) -> PatchSet {
    view_clusters(scene, &ViewSettings { patches, seed, ..ViewSettings::default() }).unwrap()
}

/// Area-weighted mean of 1 − n·n̄ over all samples: 0 for flat patches.
fn bend(set: &PatchSet) -> f32 {
    let (mut sum, mut area) = (0.0, 0.0);
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
    let (coarse, fine) = (bend(&clusters(&scene, 40, 0)), bend(&clusters(&scene, 700, 0)));
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
    scene.sky = Sky { radiance: Vec3::ONE, ..scene.sky };
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
fn every_sample_is_nearest_to_itself_and_sides_are_apart() {
    let scene = open_hall();
    let set = clusters(&scene, 300, 2);
    let nearest = Nearest::new(&set);
    let (mut wrong, mut same_behind) = (0, 0);
    for (i, range) in set.offsets.windows(2).enumerate() {
        for m in &set.members[range[0] as usize..range[1] as usize] {
            let s = &set.samples[m.sample as usize];
            let (patch, distance) = nearest.patch(s.position, s.normal);
            assert!(distance < 1e-3);
            wrong += usize::from(patch != i as u32);
            same_behind += usize::from(nearest.patch(s.position, -s.normal).0 == i as u32);
        }
    }
    assert!(wrong <= set.samples.len() / 1000, "{wrong}");
    assert!(same_behind <= set.samples.len() / 10, "{same_behind} of {}", set.samples.len());
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
fn settings_and_scenes_that_give_nothing_are_errors() {
    let scene = open_hall();
    for settings in
        [ViewSettings { patches: 0, ..ViewSettings::default() }, ViewSettings { samples: 0, ..ViewSettings::default() }]
    {
        assert!(matches!(view_clusters(&scene, &settings), Err(Error::Setting { .. })));
    }
    let huge = ViewSettings { patches: u32::MAX, ..ViewSettings::default() };
    assert!(matches!(view_clusters(&scene, &huge), Err(Error::TooMany { .. })));
    // Closed and without a light.
    let dark = atrium().scene(1.0);
    assert_eq!(view_clusters(&dark, &ViewSettings { patches: 10, ..ViewSettings::default() }), Err(Error::NoSamples));
}
