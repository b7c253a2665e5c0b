//! `page FOLDER [--stills SAMPLES]`: writes the scenes of the page in `page/`: geometry, pictures, packed bakes for frames. With
//! `--stills`, path-traced pictures instead, beside which the page puts its own; they are kept in `page/stills`.

use std::error::Error;
use std::fs;
use std::io::Write as _;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use assets::LoadedScene;
use patchlight::glam::Vec3;
use patchlight::scene::gpu::{LIGHT_RECT, Texture};
use patchlight::scene::kernel::shade::encode_srgb;
use patchlight::scene::kernel::texture::texel;
use patchlight::scene::kernel::tone::neutral;
use patchlight::scene::{NONE, Sky};
use patchlight::{
    Bake, BakeSettings, Cpu, Estimator, Intensity, Irradiance, Light, Lighting, Material, Mesh, Origin, Radiance,
    Scene, Silent,
};
use reference::accumulation::Accumulation;
use reference::path::{PathSettings, PathTracer};
use serde_json::{Value, json};

/// Pixels of a still.
const STILL: (u32, u32) = (800, 450);
const JPEG_QUALITY: u8 = 88;

/// A scene of the page.
struct Shown {
    name: &'static str,
    /// Patches, rays of the rows of patches and of receivers, receivers for each there would be.
    bake: (usize, u32, u32, f32),
    /// Edge of a texel, m, and rays from each to what shines.
    texel: (f32, u32),
    sun: Option<(Vec3, Vec3)>,
    sky: Vec3,
    /// Positions of lamps that shine downwards.
    lamps: &'static [[f32; 3]],
    /// W/sr.
    lamp: Vec3,
}

/// Half-angles of the lamps, radians.
const CONE: [f32; 2] = [0.4, 1.35];

fn scenes() -> [Shown; 3] {
    let dark = Shown {
        name: "",
        bake: (300, 512, 128, 0.15),
        texel: (0.008, 24),
        sun: None,
        sky: Vec3::ZERO,
        lamps: &[],
        lamp: Vec3::ZERO,
    };
    [
        Shown { name: "cornell", ..dark },
        Shown {
            name: "office",
            bake: (1000, 1024, 128, 0.3),
            texel: (0.07, 32),
            lamps: &[[1.5, 2.67, 1.35], [1.5, 2.67, 2.95], [3.5, 2.67, 2.15], [2.25, 2.67, 5.16], [7.25, 2.67, 5.16]],
            lamp: Vec3::new(6.4, 5.8, 4.9),
            ..dark
        },
        Shown {
            name: "atrium",
            bake: (1500, 1024, 128, 0.27),
            texel: (0.16, 32),
            sun: Some((Vec3::new(0.3, -1.0, 0.38), Vec3::new(30.0, 28.0, 25.0))),
            sky: Vec3::new(1.2, 1.6, 2.4),
            ..dark
        },
    ]
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (folder, samples) = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [folder] => (Path::new(folder), None),
        [folder, "--stills", samples] => (Path::new(folder), Some(samples.parse()?)),
        _ => return Err("usage: page FOLDER [--stills SAMPLES]".into()),
    };
    fs::create_dir_all(folder)?;
    for shown in scenes() {
        let mut loaded = assets::load_or_build(shown.name)?;
        if shown.lamps.is_empty() && shown.sun.is_none() {
            with_surfaces(&mut loaded)?;
        }
        let scene = Scene::under(Arc::clone(&loaded.scene.geometry), lighting(&shown))?;
        match samples {
            Some(samples) => write_still(folder, &shown, (&loaded, &scene), samples)?,
            None => {
                write_bake(folder, &shown, &scene)?;
                write_scene(folder, &shown, &loaded)?;
            }
        }
    }
    Ok(())
}

/// Puts surfaces that shine in the place of a scene's rectangle lights: their direct light is linear in what they send, and
/// is found once. Its materials have no textures.
fn with_surfaces(loaded: &mut LoadedScene) -> Result<(), Box<dyn Error>> {
    let scene = &loaded.scene;
    let mut builder = Scene::builder();
    let mut names = vec!["none".to_owned()];
    for (number, material) in (0..).zip(scene.materials.iter()) {
        let triangles = scene.geometry.triangles.iter().filter(|t| t.material == number);
        let corners = triangles.flat_map(|t| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b]);
        let positions: Vec<Vec3> = corners.collect();
        let indices: Vec<u32> = (0..positions.len() as u32).collect();
        let material = builder.add_material(Material::diffuse(material.albedo));
        builder.add_mesh(Mesh { positions: &positions, indices: &indices, material, ..Mesh::default() });
    }
    names.append(&mut loaded.materials);
    for light in scene.lighting.lights.iter().filter(|light| light.kind == LIGHT_RECT) {
        let corner = light.position;
        let positions = [corner, corner + light.edge_a, corner + light.edge_a + light.edge_b, corner + light.edge_b];
        let material = Material::diffuse(Vec3::splat(0.5)).with_emission(Radiance(light.color));
        let material = builder.add_material(material);
        builder.add_mesh(Mesh { positions: &positions, indices: &[0, 1, 2, 0, 2, 3], material, ..Mesh::default() });
        names.push("lamp".to_owned());
    }
    loaded.scene = builder.build()?;
    loaded.materials = names;
    Ok(())
}

fn lighting(shown: &Shown) -> Lighting {
    let lamps = shown
        .lamps
        .iter()
        .map(|&place| Light::spot(Vec3::from(place), Vec3::NEG_Y, (CONE[0], CONE[1]), Intensity(shown.lamp)));
    let sun = shown.sun.map(|(direction, irradiance)| Light::sun(direction, Irradiance(irradiance)));
    let sky = Sky { radiance: shown.sky, ..Sky::default() };
    Lighting { lights: lamps.chain(sun).collect(), sky, ..Lighting::default() }
}

fn write_bake(folder: &Path, shown: &Shown, scene: &Scene) -> Result<(), Box<dyn Error>> {
    let (patches, rays, receiver_rays, density) = shown.bake;
    let settings = BakeSettings::default()
        .with_patch_count(patches)
        .with_estimator(Estimator::Hemisphere { rays })
        .with_receiver_rays(receiver_rays)
        .with_receiver_density(density);
    let bake = Bake::build_on(&mut Cpu::new(), scene, &settings, &Silent)?;
    let path = folder.join(format!("{}.bake", shown.name));
    bake.save_for_frames(&path, &Origin { scene: shown.name.to_owned(), ..Origin::default() })?;
    let file = fs::File::create(folder.join(format!("{}.bake.gz", shown.name)))?;
    let mut packed = flate2::write::GzEncoder::new(file, flate2::Compression::best());
    packed.write_all(&fs::read(&path)?)?;
    let bytes = packed.finish()?.metadata()?.len();
    fs::remove_file(path)?;
    println!("{}: {} patches, {} kB", shown.name, bake.mesh().patches.len(), bytes / 1000);
    Ok(())
}

/// Geometry by materials as numbers, and what the page needs to know in words.
fn write_scene(folder: &Path, shown: &Shown, loaded: &LoadedScene) -> Result<(), Box<dyn Error>> {
    let geometry = &loaded.scene.geometry;
    let (mut numbers, mut parts): (Vec<f32>, Vec<Value>) = Default::default();
    for material in 0..loaded.scene.materials.len() as u32 {
        let own = || (0..geometry.triangles.len()).filter(|&k| geometry.triangles[k].material == material);
        for t in own().map(|k| &geometry.triangles[k]) {
            numbers.extend([t.corner, t.corner + t.edge_a, t.corner + t.edge_b].iter().flat_map(|v| v.to_array()));
        }
        for uv in own().map(|k| &geometry.uvs[k]) {
            numbers.extend([uv.corner, uv.corner_a, uv.corner_b].iter().flat_map(|v| v.to_array()));
        }
        parts.push(json!(own().count()));
    }
    let bytes: Vec<u8> = numbers.into_iter().flat_map(f32::to_le_bytes).collect();
    fs::write(folder.join(format!("{}.bin", shown.name)), bytes)?;
    let mut materials = Vec::new();
    for (material, name) in loaded.scene.materials.iter().zip(&loaded.materials) {
        let mut picture = Value::Null;
        let index = material.albedo_texture;
        if let Some(texture) = geometry.textures.get(index as usize).filter(|_| index != NONE) {
            let file = format!("{}-{index}.jpg", shown.name);
            write_jpeg(&folder.join(&file), (texture.width, texture.height), &pixels(texture, &geometry.texels))?;
            picture = json!(file);
        }
        let [albedo, radiance] = [material.albedo, material.radiance].map(|v| v.to_array());
        materials.push(json!({ "name": name, "albedo": albedo, "picture": picture, "radiance": radiance }));
    }
    let view = &loaded.view;
    let text = json!({
        "triangles": parts,
        "materials": materials,
        "eye": view.eye.to_array(),
        "target": view.target.to_array(),
        "fov": view.vertical_fov_degrees,
        "texel": shown.texel.0,
        "rays": shown.texel.1,
        "exposure": loaded.exposure_stops.exp2(),
        "sun": shown.sun.map(|(direction, irradiance)| json!({
            "direction": direction.to_array(), "irradiance": irradiance.to_array()
        })),
        "sky": shown.sky.to_array(),
        "lamps": shown.lamps,
        "lamp": shown.lamp.to_array(),
        "cone": CONE,
    });
    Ok(fs::write(folder.join(format!("{}.json", shown.name)), serde_json::to_string_pretty(&text)?)?)
}

fn pixels(texture: &Texture, texels: &[u32]) -> Vec<u8> {
    let own = texture.offset..texture.offset + texture.width * texture.height;
    own.flat_map(|k| texel(texels, k).truncate().to_array().map(|x| byte(encode_srgb(x)))).collect()
}

fn byte(x: f32) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

fn write_jpeg(path: &Path, (width, height): (u32, u32), bytes: &[u8]) -> Result<(), Box<dyn Error>> {
    let file = std::io::BufWriter::new(fs::File::create(path)?);
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(file, JPEG_QUALITY);
    Ok(encoder.encode(bytes, width, height, image::ExtendedColorType::Rgb8)?)
}

/// A picture by path tracing, as three.js shows radiance.
fn write_still(
    folder: &Path,
    shown: &Shown,
    (loaded, scene): (&LoadedScene, &Scene),
    samples: u32,
) -> Result<(), Box<dyn Error>> {
    let camera = loaded.view.camera(STILL.0, STILL.1);
    let mut sums = Accumulation::new(&camera, PathSettings::default());
    PathTracer::new(scene).accumulate(&camera, &mut sums, samples, |_, _| ControlFlow::Continue(()))?;
    let picture = sums.full();
    let pixels = picture.pixels.iter();
    let bytes: Vec<u8> = pixels
        .flat_map(|p| neutral(*p * loaded.exposure_stops.exp2()).to_array().map(|x| byte(encode_srgb(x))))
        .collect();
    write_jpeg(&folder.join(format!("{}.jpg", shown.name)), STILL, &bytes)
}
