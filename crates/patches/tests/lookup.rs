//! The lookup: constants stay, linear fields nearly so, walls and floors separate light.

mod support;

use glam::{Vec3, Vec4};
use patchlight_patches::{
    ClusterSettings, Error, Grid, Lookup, LookupSettings, Member, PatchSet, Sample, SampleSet, SampleSettings,
    axis_patches, cluster_patches, sample_voxels,
};
use scene::Scene;
use scene::sampling::{hash3, unit};
use support::{Mesh, atrium, two_rooms};

/// Neither planes nor walls separate.
const OPEN: LookupSettings = LookupSettings { plane_limit: f32::INFINITY, walls: false };

fn sampled(scene: &Scene, edge: f32) -> (Grid, SampleSet) {
    let grid = Grid::new(scene, Vec3::splat(edge)).unwrap();
    let settings = SampleSettings { points: 25, ..SampleSettings::default() };
    let set = sample_voxels(scene, &grid, &settings, &|_: &Sample| true).unwrap();
    (grid, set)
}

fn clusters(grid: &Grid, samples: SampleSet, group: impl Fn(&Sample) -> bool + Sync) -> PatchSet {
    let points = samples.samples.clone();
    let of = |m: &[Member]| group(&points[m[0].sample as usize]);
    let settings = ClusterSettings { max_patches: 12 };
    cluster_patches(grid, samples, &settings, &|a, b| if of(a) == of(b) { 0.0 } else { 1e6 }).unwrap()
}

/// A point of the box and a direction, at random.
fn random(k: u32, low: Vec3, high: Vec3) -> (Vec3, Vec3) {
    let number = |d: u32| unit(hash3(k, d, 9));
    let x = low + (high - low) * Vec3::new(number(0), number(1), number(2));
    let n = Vec3::new(number(3), number(4), number(5)) - 0.5;
    (x, n.normalize())
}

#[test]
fn a_constant_stays_constant_for_every_point_and_normal() {
    let scene = atrium().scene(1.0);
    let (grid, samples) = sampled(&scene, 0.8);
    let room = Vec3::splat(2.0);
    for set in [axis_patches(&grid, samples.clone()).unwrap(), clusters(&grid, samples, |_| false)] {
        for settings in [LookupSettings::default(), OPEN] {
            let table = Lookup::new(&grid, &set, settings).unwrap();
            let constant = Vec4::new(0.3, 7.0, 1e-3, 1.0);
            let mut values = vec![constant; set.len()];
            let is_constant = |values: &[Vec4], k: u32| {
                let (x, n) = random(k, scene.geometry.bounds.0 - room, scene.geometry.bounds.1 + room);
                let found = table.at(values, x, n).unwrap();
                ((found - constant) / constant).abs().max_element() < 1e-5
            };
            assert!((0..10_000).all(|k| is_constant(&values, k)));
            values[set.len() / 3] *= 1.01;
            assert!(!(0..10_000).all(|k| is_constant(&values, k)));
        }
    }
}

#[test]
fn a_linear_field_on_a_floor_is_followed() {
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::ZERO, Vec3::Z * 8.0, Vec3::X * 8.0);
    let scene = mesh.scene(1.0);
    let (grid, samples) = sampled(&scene, 0.5);
    let set = axis_patches(&grid, samples).unwrap();
    let values: Vec<Vec4> = set.patches.iter().map(|p| p.position.extend(1.0)).collect();
    let table = Lookup::new(&grid, &set, LookupSettings::default()).unwrap();
    let mut worst = 0.0f32;
    for k in 0..1000 {
        let (x, _) = random(k, Vec3::new(0.5, 0.0, 0.5), Vec3::new(7.5, 0.0, 7.5));
        worst = worst.max((table.at(&values, x, Vec3::Y).unwrap().truncate() - x).length());
    }
    assert!(worst < 0.05 * 0.5, "{worst} m");
    let points = set.surface_points();
    let many = table.at_points(&values, &points).unwrap();
    assert!(points.iter().zip(&many).all(|(p, v)| table.at(&values, p.position, p.normal).unwrap() == *v));
    assert!(matches!(table.at_points(&values[1..], &points), Err(Error::Length { .. })));
}

/// Greatest error of a field that is 1 where `lit` and 0 elsewhere, at the samples.
fn leak(grid: &Grid, set: &PatchSet, settings: LookupSettings, lit: impl Fn(&Sample) -> bool) -> f32 {
    let value = |i: usize| Vec4::splat(f32::from(u8::from(lit(&set.samples[set.members_of(i)[0].sample as usize]))));
    let values: Vec<Vec4> = (0..set.len()).map(value).collect();
    let table = Lookup::new(grid, set, settings).unwrap();
    let error = |s: &Sample| (table.at(&values, s.position, s.normal).unwrap().x - f32::from(u8::from(lit(s)))).abs();
    set.samples.iter().map(error).fold(0.0, f32::max)
}

#[test]
fn rooms_on_both_sides_of_a_thin_wall_stay_separate() {
    let scene = two_rooms().scene(1.0);
    // The insides of the first room: fronts of the box, and one side of the wall.
    let in_first = |s: &Sample| s.position.x + 0.01 * s.normal.x < 2.0;
    let inside = |s: &Sample| {
        let p = s.position + 0.01 * s.normal;
        p.cmpgt(Vec3::ZERO).all() && p.cmplt(Vec3::new(4.0, 2.0, 2.0)).all()
    };
    // With the wall in the middle of voxels, off their middle, and between them.
    for edge in [0.5, 0.41, 0.63] {
        let grid = Grid::new(&scene, Vec3::splat(edge)).unwrap();
        let settings = SampleSettings { points: 25, ..SampleSettings::default() };
        let samples = sample_voxels(&scene, &grid, &settings, &inside).unwrap();
        let set = clusters(&grid, samples, in_first);
        let kept = leak(&grid, &set, LookupSettings::default(), in_first);
        let open = leak(&grid, &set, OPEN, in_first);
        println!("edge {edge} m: greatest leak {kept:e}, where nothing separates {open:e}");
        assert!(kept < 1e-4, "{kept}");
        assert!(open > 0.1, "{open}");
    }
}

#[test]
fn a_floor_below_does_not_shine_on_the_one_above() {
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0);
    mesh.quad(Vec3::new(0.0, 0.6, 0.0), Vec3::Z * 4.0, Vec3::X * 4.0);
    mesh.quad(Vec3::new(0.0, 3.1, 0.0), Vec3::Z * 4.0, Vec3::X * 4.0);
    let scene = mesh.scene(1.0);
    let (grid, samples) = sampled(&scene, 1.0);
    let is_upper = |s: &Sample| s.position.y > 0.3;
    let set = clusters(&grid, samples, is_upper);
    let kept = leak(&grid, &set, LookupSettings::default(), is_upper);
    let open = leak(&grid, &set, OPEN, is_upper);
    assert!(kept < 1e-4 && open > 0.1, "{kept} {open}");
}

#[test]
fn sides_of_a_sheet_do_not_mix() {
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::ZERO, Vec3::new(3.0, 0.4, 0.0), Vec3::new(0.0, 0.9, 2.0));
    let scene = mesh.scene(1.0);
    let (grid, samples) = sampled(&scene, 0.6);
    let set = axis_patches(&grid, samples).unwrap();
    let is_upper = |s: &Sample| s.normal.y > 0.0;
    assert!(leak(&grid, &set, LookupSettings::default(), is_upper) < 1e-5);
    assert!(leak(&grid, &set, LookupSettings::default(), |s| s.position.x > 1.5) > 0.1);
}

#[test]
fn places_without_light_are_dark_and_make_no_others_so() {
    // A floor whose middle is dark, and the side below it.
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::ZERO, Vec3::Z * 8.0, Vec3::X * 8.0);
    let scene = mesh.scene(1.0);
    let grid = Grid::new(&scene, Vec3::splat(0.5)).unwrap();
    let is_lit = |s: &Sample| s.normal.y > 0.0 && (s.position.x < 3.0 || s.position.x > 5.0);
    let patches = |keep: &(dyn Fn(&Sample) -> bool + Sync)| {
        let samples = sample_voxels(&scene, &grid, &SampleSettings::default(), &|s: &Sample| keep(s)).unwrap();
        axis_patches(&grid, samples).unwrap()
    };
    let lit = patches(&is_lit);
    let dark = patches(&|s| !is_lit(s));
    let settings = LookupSettings::default();
    let ours = (lit.len(), |k: usize| lit.patches[k]);
    let theirs = (dark.len(), |k: usize| dark.patches[k]);
    let with = Lookup::with_dark(&grid.shape, ours, theirs, settings).unwrap();
    let without = Lookup::new(&grid, &lit, settings).unwrap();
    assert_eq!((with.values, without.values), (lit.len() + 1, lit.len()));
    let light = vec![Vec4::ONE; lit.len()];
    let all = [light.clone(), vec![Vec4::ZERO]].concat();
    for k in 0..1000 {
        let (x, _) = random(k, Vec3::ZERO, Vec3::new(8.0, 0.0, 8.0));
        let above = with.at(&all, x, Vec3::Y).unwrap().x;
        let below = with.at(&all, x, -Vec3::Y).unwrap().x;
        assert!(below < 1e-5, "{x}: {below}");
        let bound = Sample { position: x, normal: Vec3::Y, ..Sample::default() };
        if is_lit(&bound) {
            assert!((above - 1.0).abs() < 1e-5, "{x}: {above}");
        } else if (x.x - 4.0).abs() < 0.25 {
            assert!(above < 1e-5, "{x}: {above}");
        }
        // Without the dark patches the light comes through.
        assert!((without.at(&light, x, -Vec3::Y).unwrap().x - 1.0).abs() < 1e-5);
    }
    assert!(matches!(with.at(&light, Vec3::ZERO, Vec3::Y), Err(Error::Length { name: "values", .. })));
}

#[test]
fn wrong_input_is_refused() {
    let scene = two_rooms().scene(1.0);
    let (grid, samples) = sampled(&scene, 1.0);
    let mut set = axis_patches(&grid, samples).unwrap();
    for plane_limit in [0.0, -1.0, f32::NAN] {
        let settings = LookupSettings { plane_limit, walls: true };
        assert!(matches!(Lookup::new(&grid, &set, settings), Err(Error::Setting { .. })));
    }
    let table = Lookup::new(&grid, &set, LookupSettings::default()).unwrap();
    assert!(matches!(table.at(&[Vec4::ONE], Vec3::ONE, Vec3::Y), Err(Error::Length { .. })));
    assert!(matches!(Lookup::new(&grid, &PatchSet::default(), LookupSettings::default()), Err(Error::NoSamples)));
    set.patches[3].voxel = scene::NONE;
    assert!(matches!(
        Lookup::new(&grid, &set, LookupSettings::default()),
        Err(Error::Value { name: "patches.voxel", index: 3, .. })
    ));
}
