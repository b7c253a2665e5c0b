//! Patches: areas, shares, normals, slivers, and what is refused.

mod support;

use glam::{DVec3, Vec3, Vec4};
use patchlight_patches::kernel::gather::gather_mean;
use patchlight_patches::{
    ClusterSettings, Error, Grid, Member, PatchSet, Sample, SampleSet, SampleSettings, axis_patches, cluster_patches,
    sample_voxels,
};
use scene::gpu::{DirectParams, LIGHT_POINT};
use scene::sampling::{hash3, unit as unit_random};
use scene::{Light, Scene};
use support::{Mesh, atrium, two_rooms};

fn sampled(scene: &Scene, edge: f32) -> (Grid, SampleSet) {
    let grid = Grid::new(scene, Vec3::splat(edge)).unwrap();
    let settings = SampleSettings { points: 25, ..SampleSettings::default() };
    let set = sample_voxels(scene, &grid, &settings, &|_: &Sample| true).unwrap();
    (grid, set)
}

fn no_rows(_: &[Member], _: &[Member]) -> f32 {
    0.0
}

fn area(set: &PatchSet) -> f64 {
    set.patches.iter().map(|p| f64::from(p.area)).sum()
}

/// Invariants of every set: shares sum to 1, means are those of the members, voxels hold their patches.
fn check(grid: &Grid, set: &PatchSet) {
    for (i, patch) in set.patches.iter().enumerate() {
        let members = set.members_of(i);
        let sum: f64 = members.iter().map(|m| f64::from(m.weight)).sum();
        assert!((sum - 1.0).abs() < 1e-5, "patch {i}: {sum}");
        let mean = |value: &dyn Fn(&Sample) -> Vec3| -> DVec3 {
            members.iter().map(|m| value(&set.samples[m.sample as usize]).as_dvec3() * f64::from(m.weight)).sum()
        };
        assert!(
            (mean(&|s| s.position) - patch.position.as_dvec3()).length()
                < 1e-4 * (1.0 + f64::from(patch.position.length()))
        );
        assert!((mean(&|s| s.albedo) - patch.albedo.as_dvec3()).length() < 1e-5);
        let normal = mean(&|s| s.normal);
        assert!(normal.dot(patch.normal.as_dvec3()) > 0.999 * normal.length());
        let (low, high) = grid.voxel_box(patch.voxel);
        let room = 1e-4 * (high - low);
        assert!(patch.position.cmpge(low - room).all() && patch.position.cmple(high + room).all(), "patch {i}");
    }
}

#[test]
fn axis_patches_keep_the_area_and_are_six_a_voxel_at_most() {
    let scene = atrium().scene(1.0);
    let (grid, samples) = sampled(&scene, 0.9);
    let whole: f64 = samples.samples.iter().map(|s| f64::from(s.area)).sum();
    let set = axis_patches(&grid, samples).unwrap();
    check(&grid, &set);
    assert!((area(&set) / whole - 1.0).abs() < 1e-5);
    for voxel in set.patches.chunk_by(|a, b| a.voxel == b.voxel) {
        assert!(voxel.len() <= 6);
    }
}

#[test]
fn clusters_keep_the_area_and_never_hold_opposite_samples() {
    for scale in [1.0, 100.0] {
        let scene = atrium().scene(scale);
        let (grid, samples) = sampled(&scene, 1.5 * scale);
        let whole: f64 = samples.samples.iter().map(|s| f64::from(s.area)).sum();
        for max_patches in [1, 6] {
            let settings = ClusterSettings { max_patches };
            let set = cluster_patches(&grid, samples.clone(), &settings, &no_rows).unwrap();
            check(&grid, &set);
            assert!((area(&set) / whole - 1.0).abs() < 1e-5);
            // Each sample belongs to one patch, wholly.
            let mut owners = vec![0; set.samples.len()];
            for i in 0..set.len() {
                for m in set.members_of(i) {
                    owners[m.sample as usize] += 1;
                    for o in set.members_of(i) {
                        let a = &set.samples[m.sample as usize];
                        let b = &set.samples[o.sample as usize];
                        assert!(a.normal.dot(b.normal) >= 0.0, "patch {i}");
                    }
                }
            }
            assert!(owners.iter().all(|&n| n == 1));
        }
    }
}

#[test]
fn clusters_are_the_same_in_any_unit() {
    let groups = |scale: f32, max_patches: u32| {
        let scene = atrium().scene(scale);
        let (grid, samples) = sampled(&scene, 1.5 * scale);
        let settings = ClusterSettings { max_patches };
        let set = cluster_patches(&grid, samples, &settings, &no_rows).unwrap();
        (set.offsets, set.members.iter().map(|m| m.sample).collect::<Vec<_>>())
    };
    // A power of two: no value is rounded otherwise.
    assert_eq!(groups(1.0, 5), groups(1024.0, 5));
    assert_ne!(groups(1.0, 5), groups(1024.0, 6));
}

/// The greedy merging, written down as it is defined: all pairs, always.
fn merge_slowly(samples: &[Sample], unit: f64, most: usize) -> Vec<Vec<usize>> {
    let mut clusters: Vec<Vec<usize>> = (0..samples.len()).map(|k| vec![k]).collect();
    while clusters.len() > most {
        let mean = |c: &Vec<usize>, value: &dyn Fn(&Sample) -> Vec3| -> DVec3 {
            let area: f64 = c.iter().map(|&k| f64::from(samples[k].area)).sum();
            c.iter().map(|&k| value(&samples[k]).as_dvec3() * f64::from(samples[k].area)).sum::<DVec3>() / area
        };
        let mut best = (f64::INFINITY, 0, 0);
        for i in 0..clusters.len() {
            for j in i + 1..clusters.len() {
                let a = &clusters[i];
                let b = &clusters[j];
                let opposite = a.iter().any(|&k| b.iter().any(|&l| samples[k].normal.dot(samples[l].normal) < 0.0));
                let n = mean(a, &|s| s.normal).normalize();
                let m = mean(b, &|s| s.normal).normalize();
                let d = mean(a, &|s| s.position).distance(mean(b, &|s| s.position));
                let metric = (1.0 + d / unit) * (2.0 - n.dot(m));
                if !opposite && metric < best.0 {
                    best = (metric, i, j);
                }
            }
        }
        if best.0 == f64::INFINITY {
            break;
        }
        let gone = clusters.remove(best.2);
        clusters[best.1].extend(gone);
    }
    for c in &mut clusters {
        c.sort();
    }
    clusters.sort();
    clusters
}

#[test]
fn merging_takes_the_closest_pair_every_time() {
    let mut mesh = Mesh::default();
    mesh.ball(Vec3::ZERO, 1.0, 3);
    mesh.cuboid(Vec3::new(-1.3, -1.2, -1.1), Vec3::new(1.2, 1.4, 1.3), true);
    let scene = mesh.scene(1.0);
    let grid = Grid::new(&scene, Vec3::splat(1.4)).unwrap();
    let settings = SampleSettings { points: 9, ..SampleSettings::default() };
    let mut set = sample_voxels(&scene, &grid, &settings, &|_: &Sample| true).unwrap();
    // Moved a little, so that no two pairs are equally close.
    for (k, s) in set.samples.iter_mut().enumerate() {
        s.position += Vec3::from_array([0, 1, 2].map(|d| 1e-3 * unit_random(hash3(k as u32, d, 0))));
    }
    let unit = f64::from(grid.shape.edges.length());
    let mut compared = 0;
    for most in [4, 9] {
        let settings = ClusterSettings { max_patches: most };
        let fast = cluster_patches(&grid, set.clone(), &settings, &no_rows).unwrap();
        for slot in 0..grid.len() {
            let range = set.range(slot);
            let slow = merge_slowly(&set.samples[range.clone()], unit, most as usize);
            let of_voxel = (0..fast.len()).filter(|&i| fast.patches[i].voxel == grid.occupied[slot]);
            let mut found: Vec<Vec<usize>> = of_voxel
                .map(|i| fast.members_of(i).iter().map(|m| m.sample as usize - range.start).collect())
                .collect();
            found.sort();
            // Slivers are merged further.
            if found.len() == slow.len() {
                assert_eq!(found, slow, "voxel {slot}");
                compared += 1;
            }
        }
    }
    assert!(compared >= grid.len(), "{compared}");
}

#[test]
fn a_term_of_the_caller_separates_what_sees_different_things() {
    let scene = two_rooms().scene(1.0);
    let (grid, samples) = sampled(&scene, 0.9);
    // Rooms as rows: samples of different rooms see nothing in common. A sample on the wall belongs to the room it
    // faces.
    let points = samples.samples.clone();
    let room = |m: &Member| {
        let s = &points[m.sample as usize];
        s.position.x + 0.01 * s.normal.x > 2.0
    };
    let rows = |a: &[Member], b: &[Member]| if room(&a[0]) == room(&b[0]) { 0.0 } else { 1e6 };
    let settings = ClusterSettings { max_patches: 8 };
    let mixed = |set: &PatchSet| {
        (0..set.len()).filter(|&i| set.members_of(i).iter().any(|m| room(m) != room(&set.members_of(i)[0]))).count()
    };
    assert_eq!(mixed(&cluster_patches(&grid, samples.clone(), &settings, &rows).unwrap()), 0);
    assert!(mixed(&cluster_patches(&grid, samples.clone(), &settings, &no_rows).unwrap()) > 0);
    let wrong = cluster_patches(&grid, samples, &settings, &|_: &[Member], _: &[Member]| f32::NAN);
    assert!(matches!(wrong, Err(Error::Value { name: "row distance", .. })));
}

#[test]
fn slivers_go_to_a_like_neighbour() {
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::ZERO, Vec3::Z, Vec3::X);
    // Tilted by 4°: n_x² is half a per cent.
    mesh.quad(Vec3::new(1.0, 0.0, 0.0), Vec3::Z, Vec3::new(1.0, 0.07, 0.0));
    let scene = mesh.scene(1.0);
    let grid = Grid::new(&scene, Vec3::splat(4.0)).unwrap();
    let set = sample_voxels(&scene, &grid, &SampleSettings::default(), &|s: &Sample| s.normal.y > 0.0).unwrap();
    assert!(set.samples.iter().any(|s| s.normal.x < -0.05));
    let set = axis_patches(&grid, set).unwrap();
    assert_eq!(set.len(), 1);
    let members = set.members_of(0);
    assert!(members.windows(2).all(|m| m[0].sample < m[1].sample), "a sample is named once");
}

#[test]
fn any_number_of_threads_gives_the_same_patches() {
    let scene = atrium().scene(1.0);
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let (grid, samples) = sampled(&scene, 1.1);
            let clusters = cluster_patches(&grid, samples.clone(), &ClusterSettings::default(), &no_rows).unwrap();
            (axis_patches(&grid, samples).unwrap(), clusters)
        })
    };
    let one = run(1);
    let two = run(2);
    assert_eq!(one, two);
    assert_ne!(one.0, one.1);
}

#[test]
fn gathered_means_are_those_of_the_samples() {
    let scene = atrium().scene(1.0);
    let (grid, samples) = sampled(&scene, 1.1);
    let set = axis_patches(&grid, samples).unwrap();
    let values: Vec<Vec4> = set.samples.iter().map(|s| s.position.extend(1.0)).collect();
    let means = set.gather(&values).unwrap();
    for (i, patch) in set.patches.iter().enumerate() {
        assert!((means[i] - patch.position.extend(1.0)).length() < 1e-4, "{} {patch:?}", means[i]);
        assert_eq!(means[i], gather_mean(i as u32, &set.offsets, &set.members, &values));
    }
    assert!(matches!(set.gather(&values[1..]), Err(Error::Length { .. })));
}

#[test]
fn direct_light_gathered_over_the_patches_keeps_its_power() {
    // A lamp in the middle of a closed room: all of its 4π W/sr arrive.
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::ZERO, Vec3::new(3.0, 2.0, 2.5), true);
    let mut scene = mesh.scene(1.0);
    let position = Vec3::new(1.4, 0.9, 1.2);
    scene.lighting.lights = vec![Light { kind: LIGHT_POINT, position, color: Vec3::ONE, ..Light::default() }];
    let grid = Grid::new(&scene, Vec3::splat(0.4)).unwrap();
    let geometry = scene.tables();
    let front = |s: &Sample| geometry.normal(s.triangle).dot(s.normal) > 0.0;
    let set = sample_voxels(&scene, &grid, &SampleSettings::default(), &front).unwrap();
    let set = axis_patches(&grid, set).unwrap();
    let points = set.surface_points();
    let p = DirectParams {
        count: points.len() as u32,
        light_count: 1,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    };
    let direct: Vec<Vec4> = scene.direct_irradiance(&p, &points).into_iter().map(|h| h.extend(0.0)).collect();
    let power = |means: &[Vec4]| means.iter().zip(&set.patches).map(|(h, p)| f64::from(h.x * p.area)).sum::<f64>();
    let expected = 4.0 * core::f64::consts::PI;
    let found = power(&set.gather(&direct).unwrap());
    assert!((found / expected - 1.0).abs() < 0.01, "{found} of {expected}");
    let wrong: Vec<Vec4> = direct.iter().map(|&h| h * 1.02).collect();
    assert!((power(&set.gather(&wrong).unwrap()) / expected - 1.0).abs() > 0.01);
}

fn sample(area: f32) -> Sample {
    Sample { area, normal: Vec3::Y, albedo: Vec3::splat(0.5), ..Sample::default() }
}

#[test]
fn wrong_tables_are_refused() {
    let member = |sample, weight| Member { sample, weight };
    let good = || (vec![sample(1.0), sample(3.0)], vec![0, 2], vec![member(0, 1.0), member(1, 1.0)]);
    let (samples, offsets, members) = good();
    let set = PatchSet::from_groups(samples, &[7], offsets, members).unwrap();
    assert_eq!((set.patches[0].area, set.patches[0].voxel), (4.0, 7));
    assert_eq!(set.members, [member(0, 0.25), member(1, 0.75)]);
    assert!(PatchSet::new(set.samples.clone(), set.patches.clone(), set.offsets.clone(), set.members.clone()).is_ok());

    let refused = |change: &dyn Fn(&mut PatchSet)| {
        let mut wrong = set.clone();
        change(&mut wrong);
        PatchSet::new(wrong.samples, wrong.patches, wrong.offsets, wrong.members).unwrap_err()
    };
    assert!(matches!(refused(&|s| s.samples[1].area = 0.0), Error::Value { name: "samples.area", index: 1, .. }));
    assert!(matches!(refused(&|s| s.samples[1].area = f32::NAN), Error::Value { name: "samples.area", .. }));
    assert!(matches!(refused(&|s| s.samples[0].normal *= 2.0), Error::Value { name: "samples.normal", .. }));
    assert!(matches!(refused(&|s| s.samples[0].albedo.x = 1.5), Error::Value { name: "samples.albedo", .. }));
    assert!(matches!(refused(&|s| s.samples[0].position.x = f32::NAN), Error::Value { name: "samples.position", .. }));
    assert!(matches!(refused(&|s| s.patches[0].area = -1.0), Error::Value { name: "patches.area", .. }));
    assert!(matches!(refused(&|s| s.patches[0].normal = Vec3::ZERO), Error::Value { name: "patches.normal", .. }));
    assert!(matches!(refused(&|s| s.members[0].weight = 0.3), Error::Value { name: "members.weight", .. }));
    assert!(matches!(refused(&|s| s.members[0].sample = 2), Error::Value { name: "members.sample", .. }));
    assert!(matches!(refused(&|s| s.offsets.push(2)), Error::Value { name: "offsets", index: 2, .. }));
    assert!(matches!(refused(&|s| s.offsets.clear()), Error::Length { name: "offsets", .. }));
    assert!(matches!(refused(&|s| s.offsets[0] = 1), Error::Value { name: "offsets", index: 0, .. }));
    assert!(matches!(refused(&|s| s.members.truncate(1)), Error::Length { name: "members", .. }));
    assert!(matches!(refused(&|s| s.patches.push(s.patches[0])), Error::Length { name: "offsets", .. }));

    let scene = two_rooms().scene(1.0);
    let (_, samples) = sampled(&scene, 1.0);
    let (other, _) = sampled(&scene, 0.4);
    assert!(matches!(axis_patches(&other, samples.clone()), Err(Error::Length { .. })));
    let none = ClusterSettings { max_patches: 0 };
    let (grid, _) = sampled(&scene, 1.0);
    assert!(matches!(cluster_patches(&grid, samples, &none, &no_rows), Err(Error::Setting { .. })));
}
