//! A thousand sensors in the air: their rays are traced once, then every update finds their light, and the newest is
//! read without waiting.

use std::sync::Arc;
use std::time::Instant;

use patchlight::glam::Vec3;
use patchlight::scene::{LUMENS_PER_WATT, math::luminance};
use patchlight::{Bake, BakeSettings, DeviceChoice, LightField, LightSettings, Point, PointKind, Silent, open};

/// Sensors along each axis.
const COUNT: u32 = 10;
/// Frames.
const FRAMES: u32 = 100;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let loaded = assets::load_or_build("cornell")?;
    let settings = BakeSettings::default().with_patch_count(300);
    let bake = Arc::new(Bake::build(&loaded.scene, &settings, &Silent)?);
    let (executor, _) = open(&DeviceChoice::Auto)?;
    let mut field = LightField::new(bake, executor, &LightSettings::default().with_point_rays(256), &Silent)?;

    // Upward-looking sensors on a grid.
    let (low, high) = loaded.scene.geometry.bounds;
    let at = |k: u32| {
        let share = Vec3::new((k % COUNT) as f32, (k / COUNT % COUNT) as f32, (k / COUNT / COUNT) as f32) + 0.5;
        Point { position: low + (high - low) * share / COUNT as f32, normal: Vec3::Y }
    };
    let sensors: Vec<Point> = (0..COUNT.pow(3)).map(at).collect();
    let start = Instant::now();
    let set = field.add_points(&sensors, PointKind::Irradiance, &Silent)?;
    println!("{} sensors, rays traced once: {:.1} ms", sensors.len(), start.elapsed().as_secs_f64() * 1e3);

    let mut lighting = loaded.scene.lighting.clone();
    let lamp = lighting.lights[0].position;
    let mut arrived = 0;
    let mut newest = None;
    let start = Instant::now();
    for frame in 0..FRAMES {
        lighting.lights[0].position = lamp + Vec3::X * (0.01 * (frame % 30) as f32);
        field.update(&lighting)?;
        let read = field.try_read(set)?.map(|light| light.update);
        arrived += u32::from(read != newest);
        newest = read;
    }
    println!("{FRAMES} updates: {:.2} ms each, light read {arrived} times", start.elapsed().as_secs_f64() * 10.0);
    let light = field.read(set)?;
    let mean = light.values.iter().map(|h| luminance(*h)).sum::<f32>() / light.values.len() as f32;
    println!("update {}: {:.1} lx of indirect light on average", light.update, mean * LUMENS_PER_WATT);
    Ok(())
}
