//! Two sheets with a centimetre between them, in voxels of half a metre: samples and patches of all four sides.

use glam::Vec3;
use patchlight_patches::{Grid, Sample, SampleSettings, axis_patches, sample_voxels};
use scene::gpu::{Triangle, TriangleUv};
use scene::{Material, Scene, SceneParts};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut triangles = Vec::new();
    for z in [0.0, 0.01] {
        for (corner, side) in [(Vec3::new(0.0, 0.0, z), 1.0), (Vec3::new(1.0, 1.0, z), -1.0)] {
            triangles.push(Triangle { corner, edge_a: Vec3::X * side, edge_b: Vec3::Y * side, ..Triangle::default() });
        }
    }
    let uvs = vec![TriangleUv::default(); triangles.len()];
    let scene =
        Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() })?;
    let grid = Grid::new(&scene, Vec3::splat(0.5))?;
    for layers in [1, 8] {
        let settings = SampleSettings { layers, ..SampleSettings::default() };
        let samples = sample_voxels(&scene, &grid, &settings, &|_: &Sample| true)?;
        let area = samples.report.sample_area;
        let set = axis_patches(&grid, samples)?;
        println!(
            "{layers} surface(s) a ray: {} voxels, {} samples, {} patches, {area:.4} m² of 4 m²",
            grid.len(),
            set.samples.len(),
            set.len(),
        );
    }
    Ok(())
}
