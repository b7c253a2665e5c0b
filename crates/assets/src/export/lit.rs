//! A scene with its light in files that any viewer shows: glTF whose colours are light, and PLY.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{Vec2, Vec3};
use image::{DynamicImage, ImageFormat};
use scene::kernel::shade::encode_srgb;
use scene::{NONE, Texture, TriangleUv};
use serde_json::{Value, json};

use super::{SceneFiles, byte, corners, encode, level_0, material_names, one_line, picture};
use crate::import::{ImportError, LoadedScene};

/// A side of a triangle with light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LitSide {
    /// Number of the triangle.
    pub triangle: u32,
    /// Whether it is the side from which the corners run counter-clockwise.
    pub front: bool,
    /// Irradiance at the corner, the end of `edge_a` and the end of `edge_b`, W/m².
    pub irradiance: [Vec3; 3],
}

/// Where the light of a glTF file stands.
#[derive(Clone, Copy, Debug)]
pub enum LitBy<'a> {
    /// At the corners: `COLOR_0` is what a white surface shows, at the scene's exposure; `_IRRADIANCE` the irradiance, W/m².
    Corners,
    /// In a lightmap, whose texture coordinates are `TEXCOORD_1`.
    Lightmap {
        /// Coordinates of the corners of each side, in [0, 1]² from the upper left.
        uvs: &'a [TriangleUv],
        /// Width of the atlas.
        width: u32,
        /// Irradiance, row by row from the top, W/m².
        texels: &'a [Vec3],
        /// The file that has the irradiance itself.
        exr: &'a str,
    },
}

/// The bytes of one attribute of all sides.
struct Attribute {
    name: &'static str,
    kind: &'static str,
    width: usize,
    numbers: Vec<f32>,
}

/// A scene as `NAME.gltf`, `NAME.bin` and textures, with the light of its sides: materials are unlit
/// (`KHR_materials_unlit`), so that a viewer shows the light as it is, without lights of its own. A material that shines has
/// the colour of its radiance. Where light is in a lightmap, a textured material has its mean colour, for unlit materials have
/// one texture only, and holes are filled; at the corners they are where colour and mask have the same size.
///
/// # Errors
/// [`ImportError::Write`] for a picture that cannot be encoded.
pub fn lit_gltf(
    scene: &LoadedScene,
    folder: &Path,
    name: &str,
    sides: &[LitSide],
    by: LitBy,
) -> Result<SceneFiles, ImportError> {
    let name = one_line(name).replace(['/', '\\'], "_");
    let exposure = scene::stops_to_scale(scene.exposure_stops);
    let shown = |irradiance: Vec3| irradiance * (exposure / std::f32::consts::PI);
    let mut pictures: BTreeMap<String, Vec<u8>> = BTreeMap::new();
    let mut add_picture = |file: &str, picture: Option<DynamicImage>| -> Result<(), ImportError> {
        let bytes = encode(picture, ImageFormat::Png, &folder.join(file))?;
        pictures.insert(file.to_owned(), bytes);
        Ok(())
    };
    let geometry = &scene.scene.geometry;
    let mut images: Vec<String> = Vec::new();
    if let LitBy::Lightmap { width, texels, .. } = by {
        let file = format!("{name}-shown.png");
        let bytes = texels.iter().flat_map(|&e| shown(e).to_array().map(|x| byte(encode_srgb(x)))).collect();
        let height = texels.len() as u32 / width.max(1);
        add_picture(&file, image::RgbImage::from_raw(width, height, bytes).map(DynamicImage::ImageRgb8))?;
        images.push(file);
    }

    // One primitive a material, in their order.
    let mut by_material: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (k, side) in sides.iter().enumerate() {
        by_material.entry(geometry.triangles[side.triangle as usize].material).or_default().push(k);
    }
    let (mut binary, mut views, mut accessors) = (Vec::new(), Vec::new(), Vec::new());
    let (mut primitives, mut materials) = (Vec::new(), Vec::new());
    let labels = material_names(scene);
    for (&number, sides_of) in &by_material {
        let material = &scene.scene.materials[number as usize];
        let shines = material.radiance.max_element() > 0.0;
        let texture =
            geometry.textures.get(material.albedo_texture as usize).filter(|_| material.albedo_texture != NONE);
        let (mut base, mut holes) = (json!({}), None);
        let mut color = material.albedo;
        match (by, texture) {
            _ if shines => color = (material.radiance * exposure).min(Vec3::ONE),
            (LitBy::Corners, None) => {}
            (LitBy::Corners, Some(texture)) => {
                let mask = geometry.textures.get(material.mask_texture as usize);
                let mask = mask.filter(|mask| (mask.width, mask.height) == (texture.width, texture.height));
                let (file, picture) = match mask.filter(|_| material.mask_texture != NONE) {
                    Some(mask) => {
                        holes = Some(material.mask_cutoff);
                        let file = format!("{name}-texture-{}-{}.png", material.albedo_texture, material.mask_texture);
                        (file, picture_with_holes(texture, mask, &geometry.texels))
                    }
                    None => {
                        (format!("{name}-texture-{}.png", material.albedo_texture), picture(texture, &geometry.texels))
                    }
                };
                add_picture(&file, picture)?;
                base["baseColorTexture"] = json!({ "index": place_of(&mut images, file) });
                color = Vec3::ONE;
            }
            (LitBy::Lightmap { .. }, texture) => {
                base["baseColorTexture"] = json!({ "index": 0, "texCoord": 1 });
                if let Some(texture) = texture {
                    let sum: Vec3 = level_0(texture, &geometry.texels).map(|t| t.truncate()).sum();
                    color = sum / (texture.width * texture.height) as f32;
                }
            }
        }
        base["baseColorFactor"] = json!([color.x, color.y, color.z, 1.0]);
        let mut entry = json!({
            "name": labels[number as usize],
            "pbrMetallicRoughness": base,
            "extensions": { "KHR_materials_unlit": {} },
        });
        if let Some(cutoff) = holes {
            entry["alphaMode"] = json!("MASK");
            entry["alphaCutoff"] = json!(cutoff);
        }
        materials.push(entry);
        let of: Vec<&LitSide> = sides_of.iter().map(|&k| &sides[k]).collect();
        let mut attributes = serde_json::Map::new();
        let uvs =
            if let LitBy::Lightmap { uvs, .. } = by { Some(sides_of.iter().map(|&k| uvs[k]).collect()) } else { None };
        let shown = |e: Vec3| if shines { Vec3::ONE } else { shown(e) };
        for attribute in attributes_of(scene, &of, uvs, &shown) {
            let count = attribute.numbers.len() / attribute.width;
            let mut accessor = json!({
                "bufferView": views.len(), "componentType": 5126, "count": count, "type": attribute.kind,
            });
            if attribute.name == "POSITION" {
                let rows = attribute.numbers.chunks_exact(3).map(Vec3::from_slice);
                let (low, high) = rows.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
                accessor["min"] = json!(low.to_array());
                accessor["max"] = json!(high.to_array());
            }
            views.push(json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": 4 * attribute.numbers.len() }));
            binary.extend_from_slice(bytemuck::cast_slice(&attribute.numbers));
            attributes.insert(attribute.name.into(), json!(accessors.len()));
            accessors.push(accessor);
        }
        primitives.push(json!({ "attributes": attributes, "material": materials.len() - 1 }));
    }

    let mut extras = json!({ "exposure_stops": scene.exposure_stops, "shown": "E 2^stops / pi" });
    if let LitBy::Lightmap { exr, .. } = by {
        extras["lightmap"] = json!({ "uri": exr, "texCoord": 1, "unit": "W/m2" });
    }
    let mut file = json!({
        "asset": { "version": "2.0", "generator": "patchlight" },
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "name": name, "primitives": primitives, "extras": extras }],
        "materials": materials, "accessors": accessors, "bufferViews": views,
        "buffers": [{ "uri": uri(&format!("{name}.bin")), "byteLength": binary.len() }],
    });
    if !images.is_empty() {
        file["images"] = images.iter().map(|image| json!({ "uri": uri(image) })).collect();
        file["textures"] = (0..images.len()).map(|k| json!({ "source": k, "sampler": 0 })).collect();
        // A lightmap's charts end at its edges; textures go on.
        let wrap = if matches!(by, LitBy::Lightmap { .. }) { 33071 } else { 10497 };
        file["samplers"] = json!([{ "magFilter": 9729, "minFilter": 9729, "wrapS": wrap, "wrapT": wrap }]);
    }
    let path = folder.join(format!("{name}.gltf"));
    let mut files: Vec<_> = pictures.into_iter().map(|(file, bytes)| (folder.join(file), bytes)).collect();
    files.push((folder.join(format!("{name}.bin")), binary));
    files.push((path.clone(), format!("{file:#}\n").into_bytes()));
    Ok(SceneFiles { folder: folder.to_path_buf(), files, path })
}

/// A texture with the alpha of another of the same size.
fn picture_with_holes(texture: &Texture, mask: &Texture, texels: &[u32]) -> Option<DynamicImage> {
    let pixels = level_0(texture, texels).zip(level_0(mask, texels));
    let bytes =
        pixels.flat_map(|(t, m)| [encode_srgb(t.x), encode_srgb(t.y), encode_srgb(t.z), m.w].map(byte)).collect();
    image::RgbaImage::from_raw(texture.width, texture.height, bytes).map(DynamicImage::ImageRgba8)
}

/// The place of a name in a list; it is added where it is not there.
fn place_of(names: &mut Vec<String>, name: String) -> usize {
    names.iter().position(|known| *known == name).unwrap_or_else(|| {
        names.push(name);
        names.len() - 1
    })
}

/// A file name as a URI has it.
fn uri(name: &str) -> Value {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._~".contains(&b);
    let parts = name.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") });
    Value::String(parts.collect())
}

/// The attributes of the corners of some sides, three a side; those of a back run the other way round.
fn attributes_of(
    scene: &LoadedScene,
    sides: &[&LitSide],
    lightmap: Option<Vec<TriangleUv>>,
    shown: &dyn Fn(Vec3) -> Vec3,
) -> Vec<Attribute> {
    let geometry = &scene.scene.geometry;
    let tables = scene.scene.tables();
    let order = |side: &LitSide| if side.front { [0, 1, 2] } else { [0, 2, 1] };
    let of_uv = |uv: &TriangleUv| [uv.corner, uv.corner_a, uv.corner_b];
    let each = |numbers: &dyn Fn(usize, &LitSide, usize) -> Vec<f32>| -> Vec<f32> {
        let corners = |(k, side): (usize, &&LitSide)| {
            let side = **side;
            order(&side).map(|c| numbers(k, &side, c)).concat()
        };
        sides.iter().enumerate().flat_map(corners).collect()
    };
    let vec3 = |name, numbers: &dyn Fn(usize, &LitSide, usize) -> Vec3| Attribute {
        name,
        kind: "VEC3",
        width: 3,
        numbers: each(&|k, side, c| numbers(k, side, c).to_array().to_vec()),
    };
    let vec2 = |name, numbers: &dyn Fn(usize, &LitSide, usize) -> Vec2| Attribute {
        name,
        kind: "VEC2",
        width: 2,
        numbers: each(&|k, side, c| numbers(k, side, c).to_array().to_vec()),
    };
    let mut all = vec![
        vec3("POSITION", &|_, side, c| corners(&geometry.triangles[side.triangle as usize])[c]),
        vec3("NORMAL", &|_, side, _| {
            let normal = tables.normal(side.triangle).normalize_or(Vec3::Y);
            if side.front { normal } else { -normal }
        }),
        // Rows of textures run upwards here, and downwards in glTF.
        vec2("TEXCOORD_0", &|_, side, c| {
            let uv = of_uv(&geometry.uvs[side.triangle as usize])[c];
            Vec2::new(uv.x, 1.0 - uv.y)
        }),
    ];
    match &lightmap {
        Some(uvs) => all.push(vec2("TEXCOORD_1", &|k, _, c| of_uv(&uvs[k])[c])),
        None => {
            all.push(vec3("COLOR_0", &|_, side, c| shown(side.irradiance[c])));
            all.push(vec3("_IRRADIANCE", &|_, side, c| side.irradiance[c]));
        }
    }
    all
}

/// Sides as a binary PLY mesh: position (m), normal, irradiance (W/m²) of each corner.
pub fn lit_ply(scene: &LoadedScene, sides: &[LitSide]) -> Vec<u8> {
    let all: Vec<&LitSide> = sides.iter().collect();
    let attributes = attributes_of(scene, &all, None, &|e| e);
    let of = |name| attributes.iter().find(|a| a.name == name).map(|a| a.numbers.chunks_exact(3));
    let mut file = format!(
        "ply\nformat binary_little_endian 1.0\ncomment patchlight: irradiance in W/m2\nelement vertex {}\n",
        3 * sides.len()
    );
    for property in ["x", "y", "z", "nx", "ny", "nz", "irradiance_red", "irradiance_green", "irradiance_blue"] {
        file.push_str(&format!("property float {property}\n"));
    }
    file.push_str(&format!("element face {}\nproperty list uchar uint vertex_indices\nend_header\n", sides.len()));
    let mut file = file.into_bytes();
    if let (Some(positions), Some(normals), Some(light)) = (of("POSITION"), of("NORMAL"), of("_IRRADIANCE")) {
        for ((p, n), e) in positions.zip(normals).zip(light) {
            [p, n, e].into_iter().flatten().for_each(|x| file.extend_from_slice(&x.to_le_bytes()));
        }
    }
    for first in (0..3 * sides.len() as u32).step_by(3) {
        file.push(3);
        (first..first + 3).for_each(|k| file.extend_from_slice(&k.to_le_bytes()));
    }
    file
}
