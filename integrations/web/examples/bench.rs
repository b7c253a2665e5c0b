//! `bench FOLDER`: bakes the scenes of `npm run bench` where they are missing, and says how long updates and all texels take here;
//! `js/bench.mjs` says it of the module. One thread each: `RAYON_NUM_THREADS=1`, once the bakes are there.

use std::error::Error;
use std::fs;
use std::path::Path;
use std::time::Instant;

use patchlight::{Bake, BakeSettings, Cpu, FileSettings, Origin, Silent};
use patchlight_web::{LIGHT_NUMBERS, LightField};

/// Updates whose mean time is told.
const UPDATES: u32 = 40;

/// Scenes, patches, texels, m, and a light as a row of numbers whose fifth, of a place or of a direction, changes.
const SCENES: [(&str, usize, f32, [f32; 10]); 3] = [
    ("cornell", 1000, 0.01, [1.0, 0.09, 0.07, 0.05, 0.25, 0.4, 0.3, 0.0, 0.0, 0.0]),
    ("office", 2000, 0.07, [1.0, 6.0, 5.0, 4.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0]),
    ("atrium", 2000, 0.16, [0.0, 30.0, 28.0, 25.0, 0.0, 0.0, 0.0, 0.3, -1.0, 0.38]),
];

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: bench FOLDER")?;
    let folder = Path::new(&folder);
    fs::create_dir_all(folder)?;
    for (name, patches, texel, light) in SCENES {
        let path = folder.join(format!("{name}.bake"));
        if !path.exists() {
            let scene = assets::load_or_build(name)?.scene;
            let bake = BakeSettings::default().with_patch_count(patches).with_receiver_rays(256);
            let origin = Origin { scene: name.to_owned(), ..Origin::default() };
            let settings = FileSettings { origin, bake, methods: Vec::new(), build: patchlight::Build::default() };
            Bake::build_into(&path, &scene, &settings, &mut Cpu::new(), &Silent)?;
        }
        let mut field = LightField::new(name, fs::read(&path)?, "classic")?;
        field.update()?;
        let (width, height) = match field.make_lightmap(texel, &[])?[..] {
            [width, height] => (width, height),
            _ => return Err("a lightmap has a width and a height".into()),
        };
        let mut times = [0.0; 2];
        for update in 0..UPDATES {
            let mut numbers = [0.0; LIGHT_NUMBERS];
            numbers[..light.len()].copy_from_slice(&light);
            let moving = if light[0] == 0.0 { 7 } else { 4 };
            numbers[moving] += 0.001 * update as f32;
            field.set_lights(&numbers)?;
            let start = Instant::now();
            field.update()?;
            times[0] += start.elapsed().as_secs_f64();
            field.lightmap("indirect")?;
            times[1] += start.elapsed().as_secs_f64();
        }
        let [update, all] = times.map(|time| time * 1e3 / f64::from(UPDATES));
        println!("native {name}: an update {update:.2} ms, with {width} x {height} texels {all:.2} ms");
    }
    Ok(())
}
