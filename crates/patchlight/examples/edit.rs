//! A chair is moved: its light follows without another bake. `edit [PATCHES]`.

use std::time::Instant;

use patchlight::glam::{Affine3A, Vec3};
use patchlight::{Bake, BakeSettings, Silent};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let patches = std::env::args().nth(1).map_or(Ok(500), |count| count.parse())?;
    let loaded = assets::load_or_build("office")?;
    let chair = loaded.objects.iter().position(|name| name.contains("chair")).ok_or("the office has no chair")?;
    let settings = BakeSettings::default().with_patch_count(patches);
    let start = Instant::now();
    let bake = Bake::build(&loaded.scene, &settings, &Silent)?;
    let fresh = start.elapsed().as_secs_f64();

    let mut edit = loaded.scene.edit();
    edit.transform(chair as u32, Affine3A::from_translation(Vec3::new(0.4, 0.0, 0.3)));
    let moved = edit.build()?;
    let start = Instant::now();
    let edited = bake.edit(&moved, &Silent)?;
    let share = edited.traced_rays as f64 / edited.all_rays as f64;
    println!(
        "baked in {fresh:.2} s; edited in {:.2} s, {:.1} % of the rays",
        start.elapsed().as_secs_f64(),
        100.0 * share
    );
    Ok(())
}
