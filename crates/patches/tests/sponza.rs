//! Sponza's 262,267 triangles: time and areas. Needs the shared scenes.

mod support;

use std::path::Path;
use std::time::Instant;

use glam::{Vec3, Vec4};
use patchlight_patches::{
    AreaRule, ClusterSettings, Grid, Lookup, LookupSettings, Sample, SampleSettings, axis_patches, cluster_patches,
    sample_voxels,
};
use support::Mesh;

fn sponza() -> Option<Mesh> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/scenes/sponza/sponza.obj"));
    if !path.exists() {
        println!("skipped: {} is not here", path.display());
        return None;
    }
    let options = tobj::LoadOptions { triangulate: true, single_index: false, ..tobj::LoadOptions::default() };
    // Materials are of no interest here, so that they need not be found.
    let (models, _) = tobj::load_obj(path, &options).unwrap();
    let mut mesh = Mesh::default();
    for m in models.iter().map(|m| &m.mesh) {
        let at = |k: u32| Vec3::from_slice(&m.positions[3 * k as usize..]) * 0.01;
        for t in m.indices.chunks_exact(3) {
            mesh.triangle(at(t[0]), at(t[1]), at(t[2]));
        }
    }
    Some(mesh)
}

#[test]
fn sponza_is_cut_sampled_and_clustered_in_seconds() {
    let Some(mesh) = sponza() else { return };
    let whole = mesh.area();
    let count = mesh.triangles.len();
    let scene = mesh.scene(1.0);
    for edge in [2.0, 1.4] {
        let start = Instant::now();
        let grid = Grid::new(&scene, Vec3::splat(edge)).unwrap();
        let cut = start.elapsed();
        assert!((grid.area() / whole - 1.0).abs() < 1e-4);
        println!(
            "{count} triangles, {edge} m: {} voxels, {} clipped triangles, {:.1} MB, {cut:.2?}",
            grid.len(),
            grid.triangles.len(),
            grid.bytes() as f64 * 1e-6,
        );
        let all = |_: &Sample| true;
        let start = Instant::now();
        let settings = SampleSettings { rule: AreaRule::Projected, ..SampleSettings::default() };
        let projected = sample_voxels(&scene, &grid, &settings, &all).unwrap().report;
        println!("  projected: {projected:?}, {:.2?}", start.elapsed());
        let start = Instant::now();
        let set = sample_voxels(&scene, &grid, &SampleSettings::default(), &all).unwrap();
        let r = set.report;
        println!("  clipped: {} samples, {r:?}, {:.2?}", set.samples.len(), start.elapsed());
        assert!((r.sample_area / r.surface_area - 1.0).abs() < 1e-4);
        // Every surface on one side at least and two at most, up to triangles in one place.
        assert!(r.surface_area > 0.99 * whole && r.surface_area < 2.001 * whole);
        // What the rays see on the average is what the clipped areas say was seen, up to surfaces nearer than a step.
        assert!((projected.sample_area / r.sample_area - 1.0).abs() < 0.03);

        let start = Instant::now();
        let axis = axis_patches(&grid, set.clone()).unwrap();
        println!("  axis: {} patches, {:.1} MB, {:.2?}", axis.len(), axis.bytes() as f64 * 1e-6, start.elapsed());
        let start = Instant::now();
        let clusters = cluster_patches(&grid, set, &ClusterSettings::default(), &|_, _| 0.0).unwrap();
        println!("  clusters: {} patches, {:.2?}", clusters.len(), start.elapsed());
        for set in [axis, clusters] {
            let area: f64 = set.patches.iter().map(|p| f64::from(p.area)).sum();
            assert!((area / r.sample_area - 1.0).abs() < 1e-4);
            let start = Instant::now();
            let table = Lookup::new(&grid, &set, LookupSettings::default()).unwrap();
            let build = start.elapsed();
            let values = vec![Vec4::ONE; set.len()];
            let start = Instant::now();
            let queries = &set.samples[..set.samples.len().min(200_000)];
            let worst = queries
                .iter()
                .map(|s| (table.at(&values, s.position, s.normal).unwrap() - Vec4::ONE).abs().max_element())
                .fold(0.0, f32::max);
            assert!(worst < 1e-5);
            let each = start.elapsed().as_secs_f64() / queries.len() as f64;
            println!(
                "  lookup: {:.1} MB, made in {build:.2?}, {:.0} ns a point",
                table.bytes() as f64 * 1e-6,
                each * 1e9
            );
        }
    }
}
