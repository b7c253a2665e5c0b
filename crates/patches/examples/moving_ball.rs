//! Light for something that moves: ambient cubes in a closed room whose floor shines, and what a ball takes from them.

use glam::{Vec3, Vec4};
use patchlight_patches::{VolumeSettings, VolumeSize, VoxelVolume};
use scene::gpu::{Triangle, TriangleUv};
use scene::sampling::{cosine_hemisphere, hammersley};
use scene::{Material, ReceiverSet, Scene, SceneParts, SurfacePoint, Visibility};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut triangles = Vec::new();
    for (corner, side) in [(Vec3::ZERO, 4.0), (Vec3::splat(4.0), -4.0)] {
        for (a, b) in [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)] {
            let a = a * side;
            let b = b * side;
            triangles.push(Triangle { corner, edge_a: a, edge_b: b, ..Triangle::default() });
            triangles.push(Triangle { corner: corner + a + b, edge_a: -a, edge_b: -b, ..Triangle::default() });
        }
    }
    let uvs = vec![TriangleUv::default(); triangles.len()];
    let scene =
        Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() })?;
    let settings = VolumeSettings { size: VolumeSize::Edge(0.5), ..VolumeSettings::default() };
    let volume = VoxelVolume::new(&scene, &settings, &|_| true)?;
    // A row each; here the share of the rays that come from the floor, which sends 1 W/m².
    let rays = 256;
    let irradiance = |p: &SurfacePoint| {
        let ways = (0..rays).map(|k| cosine_hemisphere(p.normal, hammersley(k, rays, (0, 0))));
        let seen = ways.filter(|&way| p.position.y + way.y * scene.closest(p.position, way).t < 1e-3);
        Vec4::splat(seen.count() as f32 / rays as f32)
    };
    let cubes: Vec<Vec4> = volume.points().iter().map(irradiance).collect();
    println!("{} probes, {} receivers, {} bytes", volume.len(), cubes.len(), volume.bytes());
    for height in [0.3, 1.0, 2.0, 3.0] {
        let at = |normal: Vec3| volume.at(&cubes, Vec3::new(2.0, height, 2.0), normal).map(|e| e.x);
        println!(
            "at {height} m: below {:.2}, aside {:.2}, above {:.2} W/m²",
            at(-Vec3::Y)?,
            at(Vec3::X)?,
            at(Vec3::Y)?
        );
    }
    Ok(())
}
