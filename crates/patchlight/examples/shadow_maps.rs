//! Direct light that an engine knows already: it looks the samples up in its own shadow maps (here: a shadow ray to a
//! lamp that the light field knows nothing of), and the light field finds the indirect light that follows.

use std::sync::Arc;

use patchlight::glam::Vec3;
use patchlight::{Bake, BakeSettings, Cpu, LightField, LightSettings, SampleLight, Scene, Silent, SurfacePoint};

/// Irradiance of a point from a lamp of `intensity` W/sr at `lamp`, W/m²: `I cosθ / r²` where nothing is in the way.
fn from_lamp(scene: &Scene, point: &SurfacePoint, lamp: Vec3, intensity: Vec3) -> Vec3 {
    let origin = point.position + point.normal * scene.geometry.ray_offset;
    let to_lamp = lamp - origin;
    let squared = to_lamp.length_squared();
    let cosine = point.normal.dot(to_lamp) / squared.sqrt();
    if cosine > 0.0 && !scene.occluded(origin, to_lamp, 1.0) { intensity * (cosine / squared) } else { Vec3::ZERO }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let loaded = assets::load_or_build("cornell")?;
    let settings = BakeSettings::default().with_patch_count(300);
    let bake = Arc::new(Bake::build(&loaded.scene, &settings, &Silent)?);
    let mut field = LightField::new(bake, Box::new(Cpu::new()), &LightSettings::default(), &Silent)?;
    let mut lighting = loaded.scene.lighting.clone();
    lighting.lights.clear();
    let (low, high) = loaded.scene.geometry.bounds;
    let centre = 0.5 * (low + high);
    for frame in 0..3 {
        let lamp = centre + Vec3::X * (0.1 * frame as f32);
        let look_up = |point: &SurfacePoint| from_lamp(&loaded.scene, point, lamp, Vec3::splat(10.0));
        let direct: Vec<Vec3> = field.samples().iter().map(look_up).collect();
        field.set_sample_light(SampleLight::Values(&direct))?;
        field.update(&lighting)?;
        let indirect = field.surface_irradiance()?;
        let mean = indirect.iter().sum::<Vec3>() / indirect.len() as f32;
        println!("frame {frame}: mean indirect irradiance {mean:.3} W/m2");
    }
    Ok(())
}
