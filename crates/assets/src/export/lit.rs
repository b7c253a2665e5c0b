//! A scene with its light in files that any viewer shows: glTF whose colours are light, and PLY.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{Vec2, Vec3};
use image::{DynamicImage, ImageFormat};
use scene::gpu::{Texture, TriangleUv};
use scene::kernel::shade::encode_srgb;
use scene::{NONE, stops_to_scale};
use serde_json::{Value, json};

use super::{SceneFiles, byte, corners, encode, level_0, material_names, one_line, picture};
use crate::import::{ImportError, LoadedScene};

/// A side of a triangle with light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LitSide {
    /// Number of the triangle.
    pub triangle: u32,
    /// True for the side from which the corners run counter-clockwise.
    pub front: bool,
    /// Irradiance at the corner, the end of `edge_a` and the end of `edge_b`, W/m².
    pub irradiance: [Vec3; 3],
}

/// Source of light for a glTF file.
#[derive(Clone, Copy, Debug)]
pub enum LitBy<'a> {
    /// At the corners: `COLOR_0` is what a white surface shows, at the scene's exposure; `_IRRADIANCE` the irradiance,
    /// W/m².
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
/// (`KHR_materials_unlit`), so that a viewer shows the light as it is, without lights of its own. A material that
/// shines has the colour of its radiance. Where light is in a lightmap, a textured material has its mean colour, for
/// unlit materials have one texture only, and holes are filled; at the corners they are where colour and mask have the
/// same size.
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
    let exposure = stops_to_scale(scene.exposure_stops);
    let pictures = Pictures { folder, files: BTreeMap::new(), images: Vec::new() };
    let mut writer =
        Writer { scene, name, exposure, pictures, binary: Vec::new(), views: Vec::new(), accessors: Vec::new() };
    if let LitBy::Lightmap { width, texels, .. } = by {
        let bytes = texels.iter().flat_map(|&e| writer.shown(e).to_array().map(|x| byte(encode_srgb(x)))).collect();
        let height = texels.len() as u32 / width.max(1);
        let picture = image::RgbImage::from_raw(width, height, bytes).map(DynamicImage::ImageRgb8);
        writer.pictures.place(format!("{}-shown.png", writer.name), picture)?;
    }
    // One primitive a material, in their order.
    let mut by_material: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (k, side) in sides.iter().enumerate() {
        let material = scene.scene.geometry.triangles[side.triangle as usize].material;
        by_material.entry(material).or_default().push(k);
    }
    let mut primitives = Vec::new();
    let mut materials = Vec::new();
    for (&material, of) in &by_material {
        materials.push(writer.material(material, by)?);
        let attributes = writer.attributes(material, of, sides, by);
        primitives.push(json!({ "attributes": attributes, "material": materials.len() - 1 }));
    }
    Ok(writer.finish(primitives, materials, by))
}

/// Pictures of a file, each once.
struct Pictures<'a> {
    folder: &'a Path,
    files: BTreeMap<String, Vec<u8>>,
    /// Their names in the order of the file's images.
    images: Vec<String>,
}

impl Pictures<'_> {
    /// The number of a picture among the images; it is encoded where it is new.
    fn place(&mut self, file: String, picture: Option<DynamicImage>) -> Result<usize, ImportError> {
        if let Some(known) = self.images.iter().position(|image| *image == file) {
            return Ok(known);
        }
        let bytes = encode(picture, ImageFormat::Png, &self.folder.join(&file))?;
        self.files.insert(file.clone(), bytes);
        self.images.push(file);
        Ok(self.images.len() - 1)
    }
}

/// A glTF file under way.
struct Writer<'a> {
    scene: &'a LoadedScene,
    name: String,
    exposure: f32,
    pictures: Pictures<'a>,
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Writer<'_> {
    /// Displayed irradiance of a white surface.
    fn shown(&self, irradiance: Vec3) -> Vec3 {
        irradiance * (self.exposure / std::f32::consts::PI)
    }

    fn shines(&self, material: u32) -> bool {
        self.scene.scene.materials[material as usize].radiance.max_element() > 0.0
    }

    /// The entry of a material, and its texture where it has one.
    fn material(&mut self, number: u32, by: LitBy) -> Result<Value, ImportError> {
        let scene = self.scene;
        let geometry = &scene.scene.geometry;
        let material = &scene.scene.materials[number as usize];
        let of = |index: u32| geometry.textures.get(index as usize).filter(|_| index != NONE);
        let texture = of(material.albedo_texture);
        let mut base = json!({});
        let mut cutoff = None;
        let mut color = material.albedo;
        match (by, texture) {
            _ if self.shines(number) => color = (material.radiance * self.exposure).min(Vec3::ONE),
            (LitBy::Corners, None) => {}
            (LitBy::Corners, Some(texture)) => {
                let mask = of(material.mask_texture);
                let mask = mask.filter(|mask| (mask.width, mask.height) == (texture.width, texture.height));
                cutoff = mask.map(|_| material.mask_cutoff);
                let holes = mask.map(|_| format!("-{}", material.mask_texture)).unwrap_or_default();
                let file = format!("{}-texture-{}{holes}.png", self.name, material.albedo_texture);
                let picture = match mask {
                    Some(mask) => picture_with_holes(texture, mask, &geometry.texels),
                    None => picture(texture, &geometry.texels),
                };
                base["baseColorTexture"] = json!({ "index": self.pictures.place(file, picture)? });
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
            "name": material_names(scene)[number as usize],
            "pbrMetallicRoughness": base,
            "extensions": { "KHR_materials_unlit": {} },
        });
        if let Some(cutoff) = cutoff {
            entry["alphaMode"] = json!("MASK");
            entry["alphaCutoff"] = json!(cutoff);
        }
        Ok(entry)
    }

    /// Writes the corners of the sides of a material; the numbers of their accessors.
    fn attributes(&mut self, material: u32, of: &[usize], sides: &[LitSide], by: LitBy) -> Value {
        let shines = self.shines(material);
        let uvs = match by {
            LitBy::Lightmap { uvs, .. } => Some(of.iter().map(|&k| uvs[k]).collect()),
            LitBy::Corners => None,
        };
        let of: Vec<&LitSide> = of.iter().map(|&k| &sides[k]).collect();
        let shown = |e: Vec3| if shines { Vec3::ONE } else { self.shown(e) };
        let mut numbers = serde_json::Map::new();
        for attribute in attributes_of(self.scene, &of, uvs, &shown) {
            let count = attribute.numbers.len() / attribute.width;
            let mut accessor = json!({
                "bufferView": self.views.len(), "componentType": 5126, "count": count, "type": attribute.kind,
            });
            if attribute.name == "POSITION" {
                let rows = attribute.numbers.chunks_exact(3).map(Vec3::from_slice);
                let (low, high) = rows.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
                accessor["min"] = json!(low.to_array());
                accessor["max"] = json!(high.to_array());
            }
            let offset = self.binary.len();
            let bytes = 4 * attribute.numbers.len();
            self.views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes }));
            self.binary.extend_from_slice(bytemuck::cast_slice(&attribute.numbers));
            numbers.insert(attribute.name.into(), json!(self.accessors.len()));
            self.accessors.push(accessor);
        }
        Value::Object(numbers)
    }

    /// The files.
    fn finish(self, primitives: Vec<Value>, materials: Vec<Value>, by: LitBy) -> SceneFiles {
        let Self { scene, name, pictures, binary, views, accessors, .. } = self;
        let Pictures { folder, files, images } = pictures;
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
        let mut files: Vec<_> = files.into_iter().map(|(file, bytes)| (folder.join(file), bytes)).collect();
        files.push((folder.join(format!("{name}.bin")), binary));
        files.push((path.clone(), format!("{file:#}\n").into_bytes()));
        SceneFiles { folder: folder.to_path_buf(), files, path }
    }
}

/// A texture with the alpha of another of the same size.
fn picture_with_holes(texture: &Texture, mask: &Texture, texels: &[u32]) -> Option<DynamicImage> {
    let pixels = level_0(texture, texels).zip(level_0(mask, texels));
    let bytes =
        pixels.flat_map(|(t, m)| [encode_srgb(t.x), encode_srgb(t.y), encode_srgb(t.z), m.w].map(byte)).collect();
    image::RgbaImage::from_raw(texture.width, texture.height, bytes).map(DynamicImage::ImageRgba8)
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
