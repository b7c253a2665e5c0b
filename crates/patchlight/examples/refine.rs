//! A hall is lit at once: a coarse bake first, finer ones in the background, taken between two frames.

use std::time::Instant;

use patchlight::method::MethodSettings;
use patchlight::{
    Bake, BakeSettings, Codec, DeviceChoice, LightSettings, PictureRenderer, PictureSettings, Refinement, Silent, open,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let loaded = assets::load_or_build("atrium:3000")?;
    let settings = BakeSettings::default().with_patch_count(1200).with_receiver_rays(128);
    let method = MethodSettings::Multibounce(Codec::LowRank { epsilon: 0.01 });
    let start = Instant::now();
    let job = Bake::refine(&loaded.scene, &settings, Refinement::default().with_methods(vec![method]))?;
    let first = loop {
        match job.take_newest() {
            Some(bake) => break bake,
            None if job.is_finished() => return Err("the bake has failed".into()),
            None => std::thread::sleep(std::time::Duration::from_millis(5)),
        }
    };
    let (executor, _) = open(&DeviceChoice::Auto)?;
    let light = LightSettings::default().with_method(method);
    let pictures = PictureSettings::default().with_size((160, 90)).with_sub_frames(1);
    let mut renderer = PictureRenderer::of_bake(first, executor, &light, &pictures, &Silent)?;
    let camera = loaded.view.camera(160, 90);
    let mut lighting = loaded.scene.lighting.clone();
    let mut is_new = true;
    for frame in 0.. {
        // The lights move while the bake goes on.
        lighting.lights[0].color *= if frame % 20 < 10 { 0.99 } else { 1.0 / 0.99 };
        let picture = renderer.picture(&lighting, &camera, frame)?.pictures.full;
        if is_new {
            println!(
                "{:6.2} s, frame {frame:4}: {:5} patches, mean radiance {:.3} W/m²/sr",
                start.elapsed().as_secs_f64(),
                renderer.light().bake().mesh().patches.len(),
                picture.mean().y
            );
        }
        let is_last = job.is_finished();
        is_new = renderer.refine(&job, &Silent)?;
        if is_last && !is_new {
            break;
        }
    }
    job.join()?;
    Ok(())
}
