//! Bakes a built-in scene once and lights it in several frames while its lamp moves; writes nothing, prints what it
//! finds.

use std::error::Error;
use std::sync::Arc;

use patchlight::glam::Vec3;
use patchlight::{Bake, BakeSettings, DeviceChoice, LightSettings, PictureRenderer, PictureSettings, Silent, open};

fn main() -> Result<(), Box<dyn Error>> {
    let loaded = assets::load_or_build("cornell")?;
    let settings = BakeSettings::default().with_patch_count(500);
    let bake = Arc::new(Bake::build(&loaded.scene, &settings, &Silent)?);
    println!("{} patches, {} receivers", bake.mesh().patches.len(), bake.receivers().points.len());

    let (executor, _) = open(&DeviceChoice::Auto)?;
    let light = LightSettings::default();
    let pictures = PictureSettings::default().with_size((160, 120)).with_sub_frames(4);
    let mut renderer = PictureRenderer::of_bake(bake, executor, &light, &pictures, &Silent)?;
    let camera = loaded.view.camera(160, 120);
    let mut lighting = loaded.scene.lighting.clone();
    for frame in 0..4 {
        lighting.lights[0].position += Vec3::X * 0.1;
        renderer.update_light(&lighting, &camera)?;
        let indirect = renderer.light_mut().surface_irradiance()?;
        let mean = indirect.iter().sum::<Vec3>() / indirect.len() as f32;
        println!("frame {frame}: mean indirect irradiance {mean:.3} W/m2");
    }
    // A second lamp, which the bake has not seen.
    let mut second = lighting.lights[0];
    second.color *= 0.5;
    lighting.lights.push(second);
    let picture = renderer.picture(&lighting, &camera, 4)?;
    println!("with a second lamp: mean radiance {:.3} W/m2/sr", picture.pictures.full.mean());
    for (pass, milliseconds) in picture.times {
        println!("{pass:8} {milliseconds:8.3} ms");
    }
    Ok(())
}
