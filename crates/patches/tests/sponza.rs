//! Sponza's 262,267 triangles: time and areas. Needs the shared scenes.

mod support;

use std::path::Path;
use std::time::Instant;

use glam::Vec3;
use patches::{AreaRule, Grid, SampleSettings, sample_voxels};
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
fn sponza_is_cut_and_sampled_in_seconds() {
    let Some(mesh) = sponza() else { return };
    let whole = mesh.area();
    let count = mesh.triangles.len();
    let scene = mesh.scene(1.0);
    for edge in [1.5, 1.0] {
        let start = Instant::now();
        let grid = Grid::new(&scene, Vec3::splat(edge)).unwrap();
        let cut = start.elapsed();
        assert!((grid.area() / whole - 1.0).abs() < 1e-4);
        println!(
            "{count} triangles, {edge} m: {} voxels, {} pieces, {:.1} MB, {cut:.2?}",
            grid.len(),
            grid.triangles.len(),
            grid.bytes() as f64 * 1e-6,
        );
        for rule in [AreaRule::Clipped, AreaRule::Projected] {
            let start = Instant::now();
            let settings = SampleSettings { rule, ..SampleSettings::default() };
            let set = sample_voxels(&scene, &grid, &settings, &|_: &patches::Sample| true).unwrap();
            println!("  {rule:?}: {} samples, {:?}, {:.2?}", set.samples.len(), set.report, start.elapsed());
            if rule == AreaRule::Clipped {
                let r = &set.report;
                assert!((r.sample_area / r.surface_area - 1.0).abs() < 1e-4);
                // Every surface on at least one side, none on more than two.
                assert!(r.surface_area > 0.99 * whole && r.surface_area < 2.001 * whole);
            }
        }
    }
}
