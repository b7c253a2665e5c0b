//! `native FOLDER`: bakes the Cornell box, and writes the bake and what its light is on this machine; `npm test` compares the
//! module's with it. Says how long updates take; `npm run bench` sets one thread, and the module's beside.

use std::error::Error;
use std::fs;
use std::path::Path;
use std::time::Instant;

use patchlight::{BakeSettings, FileSettings, Origin, Silent};
use patchlight_web::LightField;

/// A lamp below the ceiling, as `js/test.mjs` has it.
const LAMP: [f32; 16] = [1.0, 0.09, 0.07, 0.05, 0.25, 0.4, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];

/// Updates whose mean time is told.
const UPDATES: u32 = 60;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: native FOLDER")?;
    let folder = Path::new(&folder);
    fs::create_dir_all(folder)?;
    let scene = assets::load_or_build("cornell")?.scene;
    let bake = BakeSettings::default().with_patch_count(1000).with_receiver_rays(256);
    let origin = Origin { scene: "cornell".to_owned(), ..Origin::default() };
    let settings = FileSettings { origin, bake, methods: Vec::new(), build: patchlight::Build::default() };
    let path = folder.join("cornell.bake");
    patchlight::Bake::build_into(&path, &scene, &settings, &mut patchlight::Cpu::new(), &Silent)?;
    let mut field = LightField::new("cornell.bake", fs::read(&path)?, "classic")?;
    field.update()?;
    write(folder, "own.f32", &mut field)?;
    field.set_lights(&LAMP)?;
    field.update()?;
    write(folder, "lamp.f32", &mut field)?;
    field.make_lightmap(0.025, &[])?;
    field.lightmap(true)?;
    save(folder, "lightmap.f32", &field)?;
    let start = Instant::now();
    for frame in 0..UPDATES {
        let mut lamp = LAMP;
        lamp[4] += frame as f32 / 1000.0;
        field.set_lights(&lamp)?;
        field.update()?;
    }
    println!("native: an update {:.2} ms", start.elapsed().as_secs_f64() * 1e3 / f64::from(UPDATES));
    Ok(())
}

fn write(folder: &Path, name: &str, field: &mut LightField) -> Result<(), Box<dyn Error>> {
    field.surface()?;
    save(folder, name, field)
}

fn save(folder: &Path, name: &str, field: &LightField) -> Result<(), Box<dyn Error>> {
    let bytes: Vec<u8> = field.numbers().iter().flat_map(|number| number.to_le_bytes()).collect();
    Ok(fs::write(folder.join(name), bytes)?)
}
