//! Scenes as they must come out of their files: counts and areas of the shared scenes, textures, masks, mips, skies,
//! glTF, animation, built-in scenes, and writing a scene back.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use assets::export::write_scene;
use assets::import::{Animation, LoadOptions, LoadedScene, load, load_with};
use assets::procedural;
use glam::{Vec2, Vec3, Vec4};
use image::{DynamicImage, ImageFormat};
use integration_tests::glb::glb;
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT};
use scene::kernel::light::sky_radiance;
use scene::kernel::shade::decode_srgb;
use scene::kernel::texture::{sample, texel};
use scene::sampling::{hash3, unit};
use scene::{NONE, Visibility};
use tempfile::TempDir;

const QUAD: &str = "mtllib a.mtl\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl m\n\
                    f 1/1 2/2 3/3 4/4\n";

fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/scenes")).join(name);
    if !path.exists() {
        println!("skipped: {name} is not at hand");
        return None;
    }
    Some(path)
}

fn area(scene: &LoadedScene) -> f64 {
    let areas = scene.scene.geometry.triangles.iter().map(|t| 0.5 * f64::from(t.edge_a.cross(t.edge_b).length()));
    let scale = f64::from(scene.metres_per_unit);
    areas.sum::<f64>() / (scale * scale)
}

fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let folder = TempDir::new().expect("a temporary folder");
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes).expect("a temporary file");
    }
    folder
}

fn encoded(picture: impl Into<DynamicImage>, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.into().write_to(&mut bytes, format).expect("a picture in memory");
    bytes.into_inner()
}

fn png(width: u32, height: u32, colour: impl Fn(u32, u32) -> [u8; 3]) -> Vec<u8> {
    encoded(image::RgbImage::from_fn(width, height, |x, y| image::Rgb(colour(x, y))), ImageFormat::Png)
}

fn loaded(folder: &TempDir, name: &str) -> LoadedScene {
    load(&folder.path().join(name)).unwrap_or_else(|e| panic!("{e}"))
}

/// A difference of less than a thousandth: the READMEs give four digits.
fn assert_near(found: f64, expected: f64) {
    assert!((found / expected - 1.0).abs() < 1e-3, "{found} where {expected} is expected");
}

#[test]
fn shared_scenes_have_the_counts_and_areas_of_their_readmes() {
    for (file, triangles, zero_area, materials, textures, surface) in [
        ("sponza/sponza.toml", 262_267, 425, 25, 27, 1.266e8),
        ("bathroom/bathroom.toml", 367_480, 444, 29, 7, 108.5),
        ("stanford/bunny.obj", 69_451, 0, 1, 0, 5.713),
    ] {
        let Some(path) = shared(file) else { continue };
        let scene = load(&path).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((scene.file_triangles, scene.dropped.zero_area), (triangles, zero_area), "{file}");
        assert_eq!((scene.materials.len(), scene.textures.len()), (materials, textures), "{file}");
        assert_near(area(&scene), surface);
        let again = load(&path).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(scene.content_hash, again.content_hash);
        println!("{file}: {:?}", again.timings);
    }
}

#[test]
fn the_cornell_box_has_relative_indices_quads_and_a_lamp() {
    let Some(path) = shared("cornell/cornell.toml") else { return };
    let scene = load(&path).unwrap_or_else(|e| panic!("{e}"));
    // Two sides of its blocks are in the file twice.
    assert_eq!((scene.file_triangles, scene.scene.geometry.triangles.len(), scene.dropped.duplicates), (36, 32, 4));
    let (low, high) = scene.scene.geometry.bounds;
    assert!((low / 0.28 - Vec3::new(-1.02, 0.0, -1.04)).length() < 1e-5, "{low}");
    assert!((high / 0.28 - Vec3::new(1.0, 1.99, 0.99)).length() < 1e-5, "{high}");
    let emitting: f32 = scene.scene.emitters.iter().map(|e| e.area).sum();
    assert_near(f64::from(emitting) / 0.0784, 0.1786);
    assert!((scene.view.eye - Vec3::new(0.0, 0.28, 1.008)).length() < 1e-6);
    assert_eq!((scene.exposure_stops, scene.view.vertical_fov_degrees), (1.8, 40.0));
    // The lamp faces down.
    let lamp = scene.scene.emitters[0].triangle;
    assert!(scene.scene.tables().normal(lamp).y < -0.99);
}

#[test]
fn three_materials_of_sponza_have_masks() {
    let Some(path) = shared("sponza/sponza.toml") else { return };
    let scene = load(&path).unwrap_or_else(|e| panic!("{e}"));
    let masked: Vec<&str> = (0..scene.materials.len())
        .filter(|k| scene.scene.materials[*k].mask_texture != NONE)
        .map(|k| scene.materials[k].as_str())
        .collect();
    assert_eq!(masked.len(), 3, "{masked:?}");
}

#[test]
fn v_zero_is_the_bottom_row_and_colours_become_linear() {
    let picture = png(2, 2, |x, y| [[[200, 0, 0], [0, 200, 0]], [[0, 0, 200], [200, 200, 0]]][y as usize][x as usize]);
    let folder = folder(&[("a.obj", QUAD.as_bytes()), ("a.mtl", b"newmtl m\nmap_Kd t.png\n"), ("t.png", &picture)]);
    let scene = loaded(&folder, "a.obj");
    let bright = decode_srgb(200.0 / 255.0);
    for (point, expected) in [
        (Vec2::new(-0.5, -0.5), Vec3::new(0.0, 0.0, bright)),
        (Vec2::new(0.5, -0.5), Vec3::new(bright, bright, 0.0)),
        (Vec2::new(-0.5, 0.5), Vec3::new(bright, 0.0, 0.0)),
        (Vec2::new(0.5, 0.5), Vec3::new(0.0, bright, 0.0)),
    ] {
        let hit = scene.scene.closest(point.extend(1.0), Vec3::NEG_Z);
        let albedo = scene.scene.tables().albedo(hit.triangle, hit.u, hit.v);
        // 16 bits a channel, and bilinear weights in single precision.
        assert!((albedo - expected).length() < 1e-4, "{point}: {albedo} for {expected}");
    }
}

#[test]
fn white_of_a_mask_is_opaque_and_black_is_a_hole() {
    let mask = png(2, 1, |x, _| [[0, 255][x as usize]; 3]);
    let files: [(&str, &[u8]); 3] =
        [("a.obj", QUAD.as_bytes()), ("a.mtl", b"newmtl m\nmap_d mask.png\n"), ("mask.png", &mask)];
    let scene = loaded(&folder(&files), "a.obj");
    let meets = |x: f32| !scene.scene.closest(Vec3::new(x, 0.1, 1.0), Vec3::NEG_Z).is_miss();
    assert!(!meets(-0.5) && meets(0.5));
    assert!(!scene.scene.occluded(Vec3::new(-0.5, 0.1, 1.0), Vec3::NEG_Z, 2.0));

    // One file as colour and mask is one texture; its alpha is the mask.
    let rgba = image::RgbaImage::from_fn(2, 1, |x, _| image::Rgba([100, 100, 100, if x == 0 { 0 } else { 255 }]));
    let rgba = encoded(rgba, ImageFormat::Png);
    let files: [(&str, &[u8]); 3] =
        [("a.obj", QUAD.as_bytes()), ("a.mtl", b"newmtl m\nmap_Kd t.png\nmap_d t.png\n"), ("t.png", &rgba)];
    let scene = loaded(&folder(&files), "a.obj");
    assert_eq!(scene.textures.len(), 1);
    assert!(scene.scene.closest(Vec3::new(-0.5, 0.1, 1.0), Vec3::NEG_Z).is_miss());
    assert!(!scene.scene.closest(Vec3::new(0.5, 0.1, 1.0), Vec3::NEG_Z).is_miss());
}

#[test]
fn a_material_with_d_below_a_half_is_left_out() {
    let obj = QUAD.to_owned() + "v 0 0 -1\nusemtl g\nf 1 2 5\n";
    let scene = loaded(&folder(&[("a.obj", obj.as_bytes()), ("a.mtl", b"newmtl m\nd 1\nnewmtl g\nd 0.3\n")]), "a.obj");
    assert_eq!((scene.scene.geometry.triangles.len(), scene.dropped.holes), (2, 1));
}

#[test]
fn every_level_of_a_pyramid_has_the_mean_of_the_picture() {
    let colour = |x: u32, y: u32| [(13 * x + 40 * y) as u8, (200 - 30 * x) as u8, (x * y * 10) as u8];
    let picture = png(5, 3, colour);
    let folder = folder(&[("a.obj", QUAD.as_bytes()), ("a.mtl", b"newmtl m\nmap_Kd t.png\n"), ("t.png", &picture)]);
    let scene = loaded(&folder, "a.obj");
    let t = scene.scene.geometry.textures[0];
    assert_eq!((t.width, t.height, t.levels), (5, 3, 3));
    let linear = |x, y| Vec3::from(colour(x, y).map(|c| decode_srgb(f32::from(c) / 255.0)));
    let mean = (0..15).map(|k| linear(k % 5, k / 5)).sum::<Vec3>() / 15.0;
    let last = texel(&scene.scene.geometry.texels, t.offset + 15 + 2).truncate();
    assert!((last - mean).length() < 1e-4, "{last} for {mean}");
    assert!((sample(t, &scene.scene.geometry.texels, Vec2::new(0.3, 0.9), 99).truncate() - mean).length() < 1e-4);
    // The mean of the codes, decoded, is another colour.
    let codes = (0..15).map(|k| Vec3::from(colour(k % 5, k / 5).map(f32::from))).sum::<Vec3>() / (15.0 * 255.0);
    assert!((Vec3::from(codes.to_array().map(decode_srgb)) - mean).length() > 1e-3);
}

#[test]
fn bright_texels_are_lowered_with_one_warning_and_shared_files_are_one_texture() {
    let white = png(4, 4, |_, _| [255; 3]);
    let obj = QUAD.to_owned() + "usemtl n\nf 1/1 3/3 2/2\n";
    let mtl = b"newmtl m\nmap_Kd t.png\nnewmtl n\nmap_Kd t.png\n";
    let scene = loaded(&folder(&[("a.obj", obj.as_bytes()), ("a.mtl", mtl), ("t.png", &white)]), "a.obj");
    assert_eq!(scene.textures.len(), 1);
    assert_eq!(scene.warnings.iter().filter(|w| w.contains("above 0.95")).count(), 2, "{:?}", scene.warnings);
    assert!((scene.scene.tables().albedo(0, 0.2, 0.2).x - 0.95).abs() < 1e-4);
}

#[test]
fn textures_are_halved_until_they_fit() {
    let big = png(64, 64, |x, y| [(x * 3) as u8, (y * 3) as u8, 0]);
    let files: [(&str, &[u8]); 3] =
        [("a.obj", QUAD.as_bytes()), ("a.mtl", b"newmtl m\nmap_Kd t.png\n"), ("t.png", &big)];
    let folder = folder(&files);
    let options = LoadOptions { texel_budget: 8 * 400, ..LoadOptions::default() };
    let scene = load_with(&folder.path().join("a.obj"), &options).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((scene.scene.geometry.textures[0].width, scene.scene.geometry.textures[0].levels), (16, 5));
    assert!(scene.warnings.iter().any(|w| w.contains("halved 2 time(s)")), "{:?}", scene.warnings);
    let whole = loaded(&folder, "a.obj");
    let mean = |s: &LoadedScene| sample(s.scene.geometry.textures[0], &s.scene.geometry.texels, Vec2::splat(0.5), 99);
    assert!((mean(&scene) - mean(&whole)).length() < 1e-4);
}

#[test]
fn lights_come_in_metres_and_absolute_units() {
    let toml = "version = 1\nmesh = \"a.obj\"\nmetres_per_unit = 0.01\n\
        [[light]]\ntype = \"directional\"\ndirection = [0, -2, 0]\nirradiance = [1, 2, 3]\n\
        [[light]]\ntype = \"point\"\nposition = [100, 200, 300]\nintensity = [4, 5, 6]\n\
        [[light]]\ntype = \"spot\"\nposition = [100, 0, 0]\ndirection = [0, 0, 3]\nintensity = [1, 1, 1]\ninner_degrees = 30\nouter_degrees = 60\n\
        [[light]]\ntype = \"rect\"\ncorner = [0, 100, 0]\nedge_a = [100, 0, 0]\nedge_b = [0, 0, 200]\nradiance = [7, 8, 9]\n\
        [sky]\nradiance = [0.1, 0.2, 0.3]\n\
        [[animation]]\ntarget = \"light\"\nindex = 1\nproperty = \"position\"\nkeyframes = [{ time = 0, value = [0, 0, 0] }, { time = 2, value = [100, 0, 0] }]\n\
        [[animation]]\ntarget = \"light\"\nindex = 0\nproperty = \"direction\"\nkeyframes = [{ time = 0, value = [0, -1, 0] }, { time = 2, value = [1, 0, 0] }]\n\
        [[animation]]\ntarget = \"camera\"\nproperty = \"eye\"\nkeyframes = [{ time = 1, value = [0, 0, 500] }]\n";
    let files: [(&str, &[u8]); 3] = [("a.obj", QUAD.as_bytes()), ("a.mtl", b"newmtl m\n"), ("s.toml", toml.as_bytes())];
    let folder = folder(&files);
    let scene = loaded(&folder, "s.toml");
    let l = &scene.scene.lighting.lights;
    assert_eq!([0, 1, 2, 3].map(|k| l[k].kind), [LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_SPOT, LIGHT_RECT]);
    assert_eq!((l[0].direction, l[0].color), (Vec3::NEG_Y, Vec3::new(1.0, 2.0, 3.0)));
    assert!((l[1].position - Vec3::new(1.0, 2.0, 3.0)).length() < 1e-6 && l[1].color.x == 4.0);
    assert!((l[2].cos_inner - 0.866_025_4).abs() < 1e-6 && (l[2].cos_outer - 0.5).abs() < 1e-6);
    assert!((l[3].area - 2.0).abs() < 1e-6 && l[3].edge_a.cross(l[3].edge_b).y < 0.0);
    assert_eq!(scene.scene.lighting.sky.radiance, Vec3::new(0.1, 0.2, 0.3));

    let (lights, view) = scene.animation.at(1.0);
    assert!((lights[1].position - Vec3::new(0.5, 0.0, 0.0)).length() < 1e-6);
    assert!((lights[0].direction - Vec3::new(1.0, -1.0, 0.0).normalize()).length() < 1e-6);
    assert!((view.eye.z - 5.0).abs() < 1e-5 && lights[3] == l[3]);
    assert_eq!(scene.animation.duration(), 2.0);

    // Written and read again: the same lights, view and movement.
    let out = TempDir::new().expect("a temporary folder");
    let again =
        load(&write_scene(&scene, out.path()).unwrap_or_else(|e| panic!("{e}"))).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(again.animation.at(0.7).0[1], scene.animation.at(0.7).0[1]);
    assert!((again.scene.lighting.lights[2].cos_outer - 0.5).abs() < 1e-6);
    assert_eq!((again.scene.lighting.lights[3], again.view), (l[3], scene.view));
}

#[test]
fn a_medium_is_read_written_and_checked() {
    let with = |medium: &str, more: &str| {
        let toml = format!("version = 1\nmesh = \"a.obj\"\nmetres_per_unit = 0.01\n[medium]\n{medium}\n{more}");
        let files: [(&str, &[u8]); 3] =
            [("a.obj", QUAD.as_bytes()), ("a.mtl", b"newmtl m\n"), ("s.toml", toml.as_bytes())];
        folder(&files)
    };
    let lamp = "[[light]]\ntype = \"point\"\nposition = [0, 0, 3]\nintensity = [4, 5, 6]\n";
    let of = |folder: &TempDir| load(&folder.path().join("s.toml"));
    let scene = of(&with("absorption = [0.5, 0, 2]", lamp)).unwrap();
    // By the metre, whatever the unit of the mesh.
    assert_eq!(scene.scene.geometry.absorption, Vec3::new(0.5, 0.0, 2.0));
    assert!(scene.warnings.iter().all(|warning| !warning.contains("medium")), "{:?}", scene.warnings);
    let out = TempDir::new().expect("a temporary folder");
    let again = load(&write_scene(&scene, out.path()).unwrap()).unwrap();
    assert_eq!(again.scene.geometry.absorption, scene.scene.geometry.absorption);
    let air = of(&with("absorption = [0, 0, 0]", lamp)).unwrap();
    assert!(!air.scene.has_medium() && air.content_hash != scene.content_hash);
    let sunny = of(&with("absorption = [1, 1, 1]", "[sky]\nradiance = [1, 1, 1]\n")).unwrap();
    assert!(sunny.warnings.iter().any(|warning| warning.contains("medium")), "{:?}", sunny.warnings);
    for wrong in ["absorption = [-0.1, 0, 0]", "absorption = [0, nan, 0]", "absorption = [0, 0, 1e9]", "scattering = 1"]
    {
        let message = of(&with(wrong, lamp)).err().unwrap().to_string();
        assert!(message.contains("s.toml"), "{wrong}: {message}");
    }
}

#[test]
fn the_middle_of_a_sky_map_is_minus_z_and_its_top_is_up() {
    let width = 16u32;
    let height = 8u32;
    let mark = |column: u32, row: u32| {
        let map = image::Rgb32FImage::from_fn(width, height, |x, y| {
            image::Rgb([f32::from(x == column && y == row) * 9.0, 0.25, 0.5])
        });
        let toml = "version = 1\nmesh = \"a.obj\"\n[sky]\nradiance = [2, 2, 2]\nmap = \"sky.exr\"\n";
        let sky = encoded(map, ImageFormat::OpenExr);
        let files: [(&str, &[u8]); 4] =
            [("a.obj", QUAD.as_bytes()), ("a.mtl", b"newmtl m\n"), ("s.toml", toml.as_bytes()), ("sky.exr", &sky)];
        loaded(&folder(&files), "s.toml")
    };
    // Column c covers the azimuths (c .. c + 1)/16 − ½ from −z towards +x; row r the angles (r .. r + 1)·π/8 from +y.
    let direction = |column: f64, row: f64| {
        let azimuth = (column + 0.5) / 16.0 * std::f64::consts::TAU;
        let down = (row + 0.5) / 8.0 * std::f64::consts::PI;
        let s = down.sin();
        let c = down.cos();
        Vec3::new((-azimuth.sin() * s) as f32, c as f32, (azimuth.cos() * s) as f32)
    };
    for (column, row) in [(8u32, 4u32), (12, 3), (4, 4), (0, 6), (3, 0)] {
        let scene = mark(column, row);
        let at = direction(f64::from(column), f64::from(row));
        let seen = sky_radiance(&scene.scene.lighting.sky, &scene.scene.lighting.sky_map, at);
        assert!((seen - Vec3::new(18.0, 0.5, 1.0)).length() < 1e-2, "{column} {row} {at}: {seen}");
        let opposite = sky_radiance(&scene.scene.lighting.sky, &scene.scene.lighting.sky_map, -at);
        assert!(opposite.x < 1e-3, "{opposite}");
    }
    // In words: column 12 of 16 begins at +x.
    assert!(direction(12.0, 3.5).x > 0.9 && direction(8.0, 3.5).z < -0.9 && direction(3.0, 0.0).y > 0.9);
}

#[test]
fn mirrors_and_glass_are_read_written_and_checked() {
    let with = |material: &str, mtl: &str| {
        let toml = format!("version = 1\nmesh = \"a.obj\"\n[[material]]\n{material}\n");
        folder(&[("a.obj", QUAD.as_bytes()), ("a.mtl", mtl.as_bytes()), ("s.toml", toml.as_bytes())])
    };
    let of = |folder: &TempDir| load(&folder.path().join("s.toml"));
    let mtl = "newmtl m\nKd 0.2 0.2 0.2\nKs 0.5 0.6 0.7\nillum 5\n";
    let glass = "name = \"m\"\ntransmittance = [0.3, 0.2, 0.1]\nindex_of_refraction = 1.33\npane = true";
    let scene = of(&with(glass, mtl)).unwrap();
    let material = scene.scene.materials[0];
    assert_eq!((material.albedo, material.mirror), (Vec3::splat(0.2), Vec3::new(0.5, 0.6, 0.7)));
    assert_eq!(
        (material.transmittance, material.index_of_refraction, material.is_pane),
        (Vec3::new(0.3, 0.2, 0.1), 1.33, 1)
    );
    let out = TempDir::new().expect("a temporary folder");
    let again = load(&write_scene(&scene, out.path()).unwrap()).unwrap();
    assert_eq!(again.scene.materials[0], material);
    let worn = of(&with("name = \"m\"\nroughness = 0.5\nmetallic = 0.25", "newmtl m\nKd 0.2 0.2 0.2\n")).unwrap();
    let finish = worn.scene.geometry.finishes[0];
    assert_eq!((finish.has_lobe, finish.roughness, finish.metallic), (1, 0.5, 0.25));
    let again = load(&write_scene(&worn, out.path()).unwrap()).unwrap();
    assert_eq!(again.scene.geometry.finishes, [finish]);
    assert!(scene.scene.geometry.finishes.is_empty());
    let black = of(&with(&format!("{glass}\nalbedo = [0, 0, 0]"), mtl)).unwrap();
    assert_eq!(black.scene.materials[0].albedo, Vec3::ZERO);
    assert_ne!(black.content_hash, scene.content_hash);
    for (wrong, says) in [
        ("name = \"other\"\nmirror = [1, 1, 1]", "which has m"),
        ("name = \"m\"\nmirror = [1.1, 0, 0]", "0 to 1"),
        ("name = \"m\"\nmirror = [0, nan, 0]", "0 to 1"),
        ("name = \"m\"\nindex_of_refraction = 0", "0.1 to 10"),
        ("name = \"m\"\nroughness = 1.5", "0 to 1"),
        ("name = \"m\"\nroughness = nan", "0 to 1"),
        ("name = \"m\"\nmetallic = 1", "roughness"),
        ("name = \"m\"\nmirror = [0.9, 0.9, 0.9]", "material \"m\""),
        ("mirror = [0, 0, 0]", "name"),
    ] {
        let message = of(&with(wrong, mtl)).err().unwrap().to_string();
        assert!(message.contains("s.toml") && message.contains(says), "{wrong}: {message}");
    }
}

#[test]
fn gltf_has_mirrors_panes_and_bodies_of_glass() {
    let optics = |material: &str| {
        let json = format!(
            "{{\"asset\":{{\"version\":\"2.0\"}},\"scenes\":[{{\"nodes\":[0]}}],\"nodes\":[{{\"mesh\":0}}],\
             \"meshes\":[{{\"primitives\":[{{\"attributes\":{{\"POSITION\":0}},\"material\":0}}]}}],\
             \"materials\":[{{{material}}}],\"buffers\":[{{\"byteLength\":36}}],\
             \"bufferViews\":[{{\"buffer\":0,\"byteLength\":36}}],\
             \"accessors\":[{{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\
             \"min\":[0,0,0],\"max\":[1,1,0]}}]}}"
        );
        let corners: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let bytes: Vec<u8> = corners.iter().flat_map(|x| x.to_le_bytes()).collect();
        let folder = folder(&[("a.glb", &glb(&json, &bytes))]);
        let scene = loaded(&folder, "a.glb");
        (scene.scene.materials[0], scene.warnings)
    };
    let smooth = "\"baseColorFactor\":[0.8,0.4,0.2,1],\"roughnessFactor\":0";
    let clear = "\"KHR_materials_transmission\":{\"transmissionFactor\":0.75},\"KHR_materials_ior\":{\"ior\":1.33}";
    let color = Vec3::new(0.8, 0.4, 0.2);
    let (metal, _) = optics(&format!("\"pbrMetallicRoughness\":{{{smooth},\"metallicFactor\":1}}"));
    assert_eq!((metal.mirror, metal.albedo), (color, Vec3::ZERO));
    let body = |more: &str| {
        optics(&format!("\"pbrMetallicRoughness\":{{{smooth},\"metallicFactor\":0}},\"extensions\":{{{clear}{more}}}"))
            .0
    };
    let pane = body("");
    assert_eq!((pane.transmittance, pane.albedo, pane.is_pane), (color * 0.75, color * 0.25, 1));
    assert_eq!(pane.index_of_refraction, 1.33);
    assert_eq!(body(",\"KHR_materials_volume\":{\"thicknessFactor\":0.1}").is_pane, 0);
    let (rough, warnings) = optics(&format!("\"pbrMetallicRoughness\":{{}},\"extensions\":{{{clear}}}"));
    assert!(!rough.is_specular() && warnings.iter().any(|w| w.contains("rough")), "{warnings:?}");
}

/// A triangle whose material has these keys, with texture coordinates and a picture of 1 × 1 texel with this colour.
fn triangle_glb(material: &str, [r, g, b]: [u8; 3]) -> Vec<u8> {
    let mut png = Vec::new();
    let picture = image::RgbImage::from_pixel(1, 1, image::Rgb([r, g, b]));
    picture.write_to(&mut Cursor::new(&mut png), ImageFormat::Png).unwrap();
    let floats: [f32; 15] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0];
    let mut bytes: Vec<u8> = floats.iter().flat_map(|x| x.to_le_bytes()).collect();
    let length = png.len();
    bytes.extend(png);
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    let json = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"scenes\":[{{\"nodes\":[0]}}],\"nodes\":[{{\"mesh\":0}}],\
         \"meshes\":[{{\"primitives\":[{{\"attributes\":{{\"POSITION\":0,\"TEXCOORD_0\":1}},\"material\":0}}]}}],\
         \"materials\":[{{{material}}}],\"textures\":[{{\"source\":0}}],\
         \"images\":[{{\"bufferView\":2,\"mimeType\":\"image/png\"}}],\"buffers\":[{{\"byteLength\":{}}}],\
         \"bufferViews\":[{{\"buffer\":0,\"byteLength\":36}},{{\"buffer\":0,\"byteOffset\":36,\"byteLength\":24}},\
         {{\"buffer\":0,\"byteOffset\":60,\"byteLength\":{length}}}],\
         \"accessors\":[{{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\
         \"min\":[0,0,0],\"max\":[1,1,0]}},{{\"bufferView\":1,\"componentType\":5126,\"count\":3,\"type\":\"VEC2\"}}]}}",
        bytes.len()
    );
    glb(&json, &bytes)
}

#[test]
fn gltf_has_normal_maps_roughness_and_metalness() {
    let read = |material: &str, color: [u8; 3]| {
        let folder = folder(&[("a.glb", &triangle_glb(material, color))]);
        loaded(&folder, "a.glb")
    };
    let of = |scene: &LoadedScene| scene.scene.geometry.finishes[0];
    let maps = "\"normalTexture\":{\"index\":0,\"scale\":0.5},\"pbrMetallicRoughness\":{\"roughnessFactor\":0.6,\
                \"metallicFactor\":0.8,\"metallicRoughnessTexture\":{\"index\":0}}";
    let scene = read(maps, [128, 64, 255]);
    let finish = of(&scene);
    assert_eq!((finish.has_lobe, finish.roughness, finish.metallic, finish.normal_scale), (1, 0.6, 0.8, 0.5));
    // Numbers, not colours: a code of 64 is a quarter, where as a colour it would be 0.05.
    let geometry = &scene.scene.geometry;
    let texture = geometry.textures[finish.surface_texture as usize];
    let texel = texel(&geometry.texels, texture.offset);
    assert!((texel.y - 64.0 / 255.0).abs() < 1e-4 && (texel.z - 1.0).abs() < 1e-4, "{texel}");
    assert_eq!(finish.normal_texture, finish.surface_texture);
    // The defaults of the format: a rough metal.
    let plain = read("\"pbrMetallicRoughness\":{}", [0; 3]);
    assert_eq!((of(&plain).has_lobe, of(&plain).roughness, of(&plain).metallic), (1, 1.0, 1.0));
    assert_ne!(plain.content_hash, scene.content_hash);
    // What mirrors has none.
    let mirror = read("\"pbrMetallicRoughness\":{\"roughnessFactor\":0}", [0; 3]);
    assert!(mirror.scene.geometry.finishes.is_empty());
    let other_set = read(
        "\"normalTexture\":{\"index\":0,\"texCoord\":1},\"pbrMetallicRoughness\":\
                          {\"baseColorTexture\":{\"index\":0}}",
        [0; 3],
    );
    assert_eq!(of(&other_set).normal_texture, NONE);
    assert!(other_set.warnings.iter().any(|w| w.contains("normal texture")), "{:?}", other_set.warnings);
}

/// A GLB with one textured, masked quad under two transforms, a spot, and a camera.
fn quad_glb() -> Vec<u8> {
    let picture = encoded(
        image::RgbaImage::from_fn(2, 2, |x, y| {
            image::Rgba([if y == 0 { 188 } else { 0 }, 0, 188, if x == 0 { 255 } else { 0 }])
        }),
        ImageFormat::Png,
    );
    let mut binary: Vec<u8> = Vec::new();
    for p in [[-1.0f32, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]] {
        binary.extend(p.iter().flat_map(|x| x.to_le_bytes()));
    }
    for uv in [[0.0f32, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]] {
        binary.extend(uv.iter().flat_map(|x| x.to_le_bytes()));
    }
    binary.extend([0u16, 1, 2, 0, 2, 3].iter().flat_map(|x| x.to_le_bytes()));
    let image_at = binary.len();
    binary.extend(&picture);
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0,3]}}],
        "extensionsUsed":["KHR_lights_punctual","KHR_materials_emissive_strength"],
        "extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"spot","intensity":5,"color":[1,0.5,0.25],
            "spot":{{"innerConeAngle":0.2,"outerConeAngle":0.5}}}}]}}}},
        "nodes":[{{"name":"parent","translation":[10,0,0],"children":[1,2]}},
            {{"name":"leaf","mesh":0,"scale":[2,2,-2]}},
            {{"name":"lamp","translation":[0,3,0],"rotation":[-0.70710678,0,0,0.70710678],"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}},
            {{"name":"eye","camera":0,"translation":[10,0,9]}}],
        "cameras":[{{"type":"perspective","perspective":{{"yfov":0.8,"znear":0.1}}}}],
        "meshes":[{{"name":"quad","primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"indices":2,"material":0}}]}}],
        "materials":[{{"name":"leaf","alphaMode":"MASK","alphaCutoff":0.4,"pbrMetallicRoughness":{{"baseColorFactor":[0.5,1,1,0.8],
            "baseColorTexture":{{"index":0}}}},"emissiveFactor":[1,0.5,0],"extensions":{{"KHR_materials_emissive_strength":{{"emissiveStrength":6}}}}}}],
        "textures":[{{"source":0}}],"images":[{{"bufferView":3,"mimeType":"image/png"}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[-1,-1,0],"max":[1,1,0]}},
            {{"bufferView":1,"componentType":5126,"count":4,"type":"VEC2"}},
            {{"bufferView":2,"componentType":5123,"count":6,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":32}},
            {{"buffer":0,"byteOffset":80,"byteLength":12}},{{"buffer":0,"byteOffset":{image_at},"byteLength":{}}}],
        "buffers":[{{"byteLength":{}}}]}}"#,
        picture.len(),
        binary.len()
    );
    glb(&json, &binary)
}

#[test]
fn gltf_brings_transforms_materials_masks_lights_and_cameras() {
    let folder = folder(&[("a.glb", &quad_glb())]);
    let scene = loaded(&folder, "a.glb");
    let s = &scene.scene;
    assert_eq!((s.geometry.triangles.len(), scene.objects.as_slice()), (2, ["leaf".to_owned()].as_slice()));
    assert!(
        (s.geometry.bounds.0 - Vec3::new(8.0, -2.0, 0.0)).length() < 1e-6
            && (s.geometry.bounds.1 - Vec3::new(12.0, 2.0, 0.0)).length() < 1e-6
    );
    // The mirrored z flips the winding back: seen from +z the original front shows −z.
    assert!(s.tables().normal(0).z < -0.99);
    assert_eq!(s.materials[0].radiance, Vec3::new(6.0, 3.0, 0.0));
    assert!((s.materials[0].mask_cutoff - 0.5).abs() < 1e-6);
    // Left half opaque, right half a hole; the top row is red at half strength by the factor.
    let top = s.closest(Vec3::new(9.0, 1.0, 5.0), Vec3::NEG_Z);
    let bottom = s.closest(Vec3::new(9.0, -1.0, 5.0), Vec3::NEG_Z);
    assert!(s.closest(Vec3::new(11.0, 1.0, 5.0), Vec3::NEG_Z).is_miss());
    let red = 0.5 * decode_srgb(188.0 / 255.0);
    assert!((s.tables().albedo(top.triangle, top.u, top.v).x - red).abs() < 1e-4);
    assert!(s.tables().albedo(bottom.triangle, bottom.u, bottom.v).x < 1e-4);
    let lamp = s.lighting.lights[0];
    assert_eq!(lamp.kind, LIGHT_SPOT);
    assert!(
        (lamp.position - Vec3::new(10.0, 3.0, 0.0)).length() < 1e-5 && (lamp.direction - Vec3::NEG_Y).length() < 1e-5
    );
    assert!((lamp.color - Vec3::new(5.0, 2.5, 1.25)).length() < 1e-5 && (lamp.cos_outer - 0.877_582_6).abs() < 1e-6);
    assert!((scene.view.eye - Vec3::new(10.0, 0.0, 9.0)).length() < 1e-5);
    assert!((scene.view.vertical_fov_degrees - 45.836_624).abs() < 1e-3);
}

#[test]
fn a_bare_mesh_is_framed_and_lit() {
    let scene = loaded(&folder(&[("a.obj", QUAD.as_bytes()), ("a.mtl", b"newmtl m\n")]), "a.obj");
    assert!(scene.scene.has_sky() && scene.scene.lighting.lights.len() == 1);
    let camera = scene.view.camera(64, 64);
    for corner in [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 0.0), Vec3::new(1.0, -1.0, 0.0)] {
        let to = corner - camera.eye;
        let depth = to.dot(camera.forward);
        let x = to.dot(camera.right) / camera.right.length_squared();
        let y = to.dot(camera.up) / camera.up.length_squared();
        assert!(depth > 0.0 && (x / depth).abs() < 1.0 && (y / depth).abs() < 1.0);
    }
}

/// Directions all round from a point.
fn directions(count: u32) -> impl Iterator<Item = Vec3> {
    (0..count).filter_map(|k| {
        let v = Vec3::from([0, 1, 2].map(|axis| 2.0 * unit(hash3(k, axis, 77)) - 1.0));
        (v.length() > 0.1 && v.length() < 1.0).then(|| v.normalize())
    })
}

#[test]
fn built_in_scenes_show_their_fronts_and_have_no_cracks() {
    for (spec, closed) in
        [("cornell", false), ("office", true), ("furnace", true), ("sealed-box", true), ("atrium", false)]
    {
        let scene = procedural::build(spec).unwrap_or_else(|e| panic!("{e}"));
        assert!(scene.warnings.is_empty(), "{spec}: {:?}", scene.warnings);
        assert_eq!((scene.dropped.zero_area, scene.dropped.duplicates), (0, 0), "{spec}");
        let geometry = scene.scene.tables();
        // The published camera of the Cornell Box is outside.
        let eye = if spec == "cornell" { Vec3::new(0.278, 0.273, 0.02) } else { scene.view.eye };
        let mut escaped = 0;
        let mut backs = 0;
        for direction in directions(200_000) {
            let hit = scene.scene.closest(eye, direction);
            if hit.is_miss() {
                // Through the open front of the box, or the open roof.
                let open = if spec == "cornell" { direction.z < 0.0 } else { direction.y > 0.0 };
                escaped += usize::from(closed || !open);
            } else {
                let material = scene.scene.geometry.triangles[hit.triangle as usize].material as usize;
                let sheet = scene.materials[material].starts_with("cloth");
                backs += usize::from(!sheet && geometry.normal(hit.triangle).dot(direction) > 0.0);
            }
        }
        assert_eq!((escaped, backs), (0, 0), "{spec}: rays that escaped, backs that were seen");
    }
}

#[test]
fn the_atrium_has_the_triangles_that_were_asked_for() {
    for count in [5_000, 30_000, 300_000] {
        let scene = procedural::build(&format!("atrium:{count}")).unwrap_or_else(|e| panic!("{e}"));
        let found = scene.scene.geometry.triangles.len();
        assert!(found.abs_diff(count) * 10 < count, "{found} for {count}");
    }
    let found = procedural::build("atrium").unwrap_or_else(|e| panic!("{e}")).scene.geometry.triangles.len();
    assert!((2_500..3_500).contains(&found), "{found}");
}

/// The built-in scenes. A city of its default size would take minutes.
fn specs() -> impl Iterator<Item = &'static str> {
    procedural::NAMES.into_iter().map(|name| if name == "city" { "city:150000" } else { name })
}

#[test]
fn every_built_in_scene_can_be_animated() {
    for spec in specs() {
        let scene = procedural::build(spec).unwrap_or_else(|e| panic!("{e}"));
        // Its own may move the camera alone.
        let own = Animation::or_default_path(&scene);
        assert!(own.at(0.0) != own.at(0.5 * own.duration()), "{spec}");
        let animation = Animation::default_path(&scene);
        let first = animation.at(0.0).0;
        let last = animation.at(0.5).0;
        assert!(!first.is_empty() && first != last && animation.duration() == 1.0, "{spec}");
        let (low, high) = scene.scene.geometry.bounds;
        for light in last.iter().filter(|l| l.kind != LIGHT_DIRECTIONAL) {
            assert!(light.position.cmpge(low).all() && light.position.cmple(high).all(), "{spec}: {}", light.position);
        }
    }
}

#[test]
fn a_scene_that_was_written_reads_back_the_same() {
    for spec in specs() {
        let scene = procedural::build(spec).unwrap_or_else(|e| panic!("{e}"));
        let out = TempDir::new().expect("a temporary folder");
        let path = write_scene(&scene, &out.path().join("new/folder")).unwrap_or_else(|e| panic!("{e}"));
        let again = load(&path).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(again.scene.geometry.triangles.len(), scene.scene.geometry.triangles.len(), "{spec}");
        assert_near(area(&again), area(&scene));
        assert_eq!((&again.name, again.view, again.exposure_stops), (&scene.name, scene.view, scene.exposure_stops));
        assert_eq!(again.materials, scene.materials, "{spec}");
        assert_eq!(again.scene.lighting.sky, scene.scene.lighting.sky);
        // Directions are made unit vectors again, which may change the last bit.
        for (a, b) in again.scene.lighting.lights.iter().zip(&scene.scene.lighting.lights) {
            assert!(
                (a.direction - b.direction).length() < 1e-6
                    && (a.position, a.color, a.edge_a) == (b.position, b.color, b.edge_a)
            );
        }
        // Reflectance all over the pictures: texels survive 8 bits because they came from 8 bits.
        let by_source = |s: &LoadedScene| {
            let mut places: Vec<u32> = (0..s.scene.geometry.triangles.len() as u32).collect();
            places.sort_by_key(|&k| s.scene.geometry.triangles[k as usize].source);
            places
        };
        let places = by_source(&scene);
        let places_again = by_source(&again);
        let probe = |s: &LoadedScene, at: u32| s.scene.tables().albedo(at, 0.3, 0.3).extend(0.0);
        for k in (0..places.len()).step_by(17) {
            let (a, b): (Vec4, Vec4) = (probe(&scene, places[k]), probe(&again, places_again[k]));
            assert!((a - b).length() < 2e-3, "{spec}, triangle {k}: {a} {b}");
        }
        let left: Vec<_> =
            std::fs::read_dir(path.parent().unwrap_or(Path::new("."))).into_iter().flatten().flatten().collect();
        assert!(left.iter().all(|f| !f.file_name().to_string_lossy().starts_with(".tmp")), "temporary files stay");
    }
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let folder = folder(&[("file", b"x")]);
    let scene = procedural::build("furnace").unwrap_or_else(|e| panic!("{e}"));
    let message =
        write_scene(&scene, &folder.path().join("file/below")).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(message.contains("file/below") && message.contains("choose an output folder"), "{message}");
}
