//! `native FOLDER`: bakes the Cornell box, and writes the bake and what its light is on this machine; `npm test` compares the
//! module's with it.

use std::error::Error;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use patchlight::glam::Vec3;
use patchlight::{
    Bake, BakeSettings, Cpu, FileSettings, Intensity, Light, LightSettings, Lighting, Origin, PictureRenderer,
    PictureSettings, Silent,
};
use patchlight_web::LightField;

/// A lamp below the ceiling, as `js/test.mjs` has it.
const LAMP: [f32; 16] = [1.0, 0.09, 0.07, 0.05, 0.25, 0.4, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];

/// Pixels of the picture beside which those of a page are put.
const PICTURE: (u32, u32) = (320, 240);

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: native FOLDER")?;
    let folder = Path::new(&folder);
    fs::create_dir_all(folder)?;
    let scene = assets::load_or_build("cornell")?.scene;
    let bake = BakeSettings::default().with_patch_count(1000).with_receiver_rays(256);
    let origin = Origin { scene: "cornell".to_owned(), ..Origin::default() };
    let settings = FileSettings { origin, bake, methods: Vec::new(), build: patchlight::Build::default() };
    let path = folder.join("cornell.bake");
    Bake::build_into(&path, &scene, &settings, &mut Cpu::new(), &Silent)?;
    let mut field = LightField::new("cornell.bake", fs::read(&path)?, "classic")?;
    field.update()?;
    write(folder, "own.f32", &mut field)?;
    field.set_lights(&LAMP)?;
    field.update()?;
    write(folder, "lamp.f32", &mut field)?;
    field.make_lightmap(0.025, &[])?;
    field.lightmap("full")?;
    save(folder, "lightmap.f32", &field)?;
    write_picture(folder, &path)?;
    Ok(())
}

/// Writes what the lamp's light shows once it was reflected, and the scene for a program that draws it with lightmaps.
fn write_picture(folder: &Path, bake: &Path) -> Result<(), Box<dyn Error>> {
    let loaded = assets::load_or_build("cornell")?;
    let (width, height) = PICTURE;
    let bake = Arc::new(Bake::open(bake)?.bake);
    let settings = PictureSettings::default().with_size(PICTURE).with_sub_frames(16);
    let light = LightSettings::default();
    let mut renderer = PictureRenderer::of_bake(bake, Box::new(Cpu::new()), &light, &settings, &Silent)?;
    let [x, y, z] = [4, 5, 6].map(|k| LAMP[k]);
    let lamp = Light::point(Vec3::new(x, y, z), Intensity(Vec3::new(LAMP[1], LAMP[2], LAMP[3])));
    let emission = vec![Vec3::ZERO; loaded.scene.materials.len()];
    let lighting = Lighting { lights: vec![lamp], emission, ..Lighting::default() };
    let pictures = renderer.picture(&lighting, &loaded.view.camera(width, height), 0)?.pictures;
    let bytes: Vec<u8> =
        pictures.indirect.pixels.iter().flat_map(|p| p.to_array()).flat_map(|x| x.to_le_bytes()).collect();
    fs::write(folder.join("indirect.f32"), bytes)?;
    let geometry = &loaded.scene.geometry;
    let triangles = geometry.triangles.iter().map(|t| {
        let corners = [t.corner, t.corner + t.edge_a, t.corner + t.edge_b].map(|corner| corner.to_array());
        format!("{:?}", (corners, loaded.scene.materials[t.material as usize].albedo.to_array()))
    });
    let triangles: Vec<String> = triangles.map(|text| text.replace('(', "[").replace(')', "]")).collect();
    let view = &loaded.view;
    let [eye, target, up] = [view.eye, view.target, view.up].map(|v| v.to_array());
    let fov = view.vertical_fov_degrees;
    let text = format!(
        "{{\"materials\": {}, \"width\": {width}, \"height\": {height}, \"eye\": {eye:?}, \"target\": {target:?}, \"up\": {up:?}, \"fov\": {fov},\n\"triangles\": [\n{}\n]}}\n",
        loaded.scene.materials.len(),
        triangles.join(",\n")
    );
    Ok(fs::write(folder.join("cornell.json"), text)?)
}

fn write(folder: &Path, name: &str, field: &mut LightField) -> Result<(), Box<dyn Error>> {
    field.surface()?;
    save(folder, name, field)
}

fn save(folder: &Path, name: &str, field: &LightField) -> Result<(), Box<dyn Error>> {
    let bytes: Vec<u8> = field.numbers().iter().flat_map(|number| number.to_le_bytes()).collect();
    Ok(fs::write(folder.join(name), bytes)?)
}
