//! A scene back into files: scene .toml, OBJ, MTL, PNG textures, EXR sky, IES luminaires; with its light ([`lit`]) as
//! glTF and PLY.

pub mod lit;
mod luminaire;

use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;
use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};

use glam::{Vec2, Vec3};
use image::codecs::openexr::OpenExrEncoder;
use image::codecs::png::PngEncoder;
use image::{DynamicImage, ImageFormat};
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_LUMINAIRE, LIGHT_POINT, LIGHT_SPOT, Texture, Triangle};
use scene::kernel::shade::encode_srgb;
use scene::kernel::texture::texel;
use scene::math::luminance;
use scene::{Finish, LUMENS_PER_WATT, Light, NONE};

use crate::import::{Animation, ImportError, LoadedScene, Target};

/// Bytes that are written between two questions whether to go on.
const WRITTEN_AT_ONCE: usize = 1 << 20;

/// Writes the files of a scene ([`SceneFiles`]) into a folder that is made when needed. Returns the path of the scene
/// file.
///
/// # Errors
/// [`ImportError::Write`] names the file.
pub fn write_scene(scene: &LoadedScene, folder: &Path) -> Result<PathBuf, ImportError> {
    let files = SceneFiles::of(scene, folder)?;
    files.write(&|| true)?;
    Ok(files.path)
}

/// A scene as the files `NAME.toml`, `NAME.obj`, `NAME.mtl`, the textures `NAME-K.png` and masks `NAME-K-mask.png`,
/// `NAME-sky.exr`, and `NAME-luminaire-K.ies`. Lengths are in metres.
pub struct SceneFiles {
    folder: PathBuf,
    /// Their paths and bytes, the scene file last.
    files: Vec<(PathBuf, Vec<u8>)>,
    /// The scene file.
    path: PathBuf,
}

impl SceneFiles {
    /// Makes the bytes of the files that a folder is to hold; writes nothing.
    ///
    /// # Errors
    /// [`ImportError::Write`] for a picture that cannot be encoded.
    pub fn of(scene: &LoadedScene, folder: &Path) -> Result<Self, ImportError> {
        let name = one_line(&scene.name).replace(['/', '\\'], "_");
        let s = &scene.scene;
        let mut pictures: BTreeMap<String, Vec<u8>> = BTreeMap::new();
        let mtl = materials(scene, &name, &mut pictures, folder)?;
        if s.lighting.sky.map_width > 0 {
            let values: Vec<f32> = s.lighting.sky_map.iter().flat_map(|t| [t.x, t.y, t.z]).collect();
            let map = image::Rgb32FImage::from_raw(s.lighting.sky.map_width, s.lighting.sky.map_height, values)
                .map(DynamicImage::ImageRgb32F);
            let file = format!("{name}-sky.exr");
            pictures.insert(file.clone(), encode(map, ImageFormat::OpenExr, &folder.join(file))?);
        }
        pictures.extend(luminaire::files(&s.lighting, &name));
        let path = folder.join(format!("{name}.toml"));
        let mut files: Vec<(PathBuf, Vec<u8>)> =
            pictures.into_iter().map(|(file, bytes)| (folder.join(file), bytes)).collect();
        files.push((folder.join(format!("{name}.mtl")), mtl.into_bytes()));
        files.push((folder.join(format!("{name}.obj")), mesh(scene, &name).into_bytes()));
        files.push((path.clone(), settings(scene, &name).into_bytes()));
        Ok(Self { folder: folder.to_path_buf(), files, path })
    }

    /// Adds a file, written before the scene file.
    pub fn add(&mut self, name: &str, bytes: Vec<u8>) {
        self.files.insert(0, (self.folder.join(name), bytes));
    }

    /// Writes them into the folder, which is made when needed. Each file goes through a temporary one that is renamed.
    /// Returns the path of the scene file, or nothing where `continues` said no: then the file under way is not there.
    ///
    /// # Errors
    /// [`ImportError::Write`] names the file.
    pub fn write(&self, continues: &dyn Fn() -> bool) -> Result<Option<&Path>, ImportError> {
        std::fs::create_dir_all(&self.folder)
            .map_err(|source| ImportError::Write { path: self.folder.clone(), source })?;
        for (path, bytes) in &self.files {
            if !write_file(path, bytes, continues)? {
                return Ok(None);
            }
        }
        Ok(Some(&self.path))
    }
}

/// Writes a file beside its place and renames it, so that nobody sees half of it; whether it was written.
fn write_file(path: &Path, bytes: &[u8], continues: &dyn Fn() -> bool) -> Result<bool, ImportError> {
    let failed = |source| ImportError::Write { path: path.to_path_buf(), source };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.suffix(".part");
    // Temporary files are their owner's alone; this one is to become a result.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut part = builder.tempfile_in(folder).map_err(failed)?;
    for piece in bytes.chunks(WRITTEN_AT_ONCE) {
        if !continues() {
            return Ok(false);
        }
        part.write_all(piece).map_err(failed)?;
    }
    part.as_file().sync_all().map_err(failed)?;
    part.persist(path).map_err(|error| failed(error.error))?;
    Ok(true)
}

/// A name as it may stand in an OBJ or MTL line.
fn one_line(name: &str) -> String {
    let line: String = name.chars().map(|c| if c.is_control() { '_' } else { c }).collect();
    let line = line.trim().trim_end_matches('\\');
    if line.is_empty() { String::from("unnamed") } else { line.to_owned() }
}

/// Names of the materials, each once.
fn material_names(scene: &LoadedScene) -> Vec<String> {
    let mut seen = BTreeMap::new();
    let name = |(k, name): (usize, &String)| {
        let name = one_line(name);
        if seen.insert(name.clone(), k).is_some() { format!("{name} {k}") } else { name }
    };
    scene.materials.iter().enumerate().map(name).collect()
}

fn encode(picture: Option<DynamicImage>, format: ImageFormat, path: &Path) -> Result<Vec<u8>, ImportError> {
    let mut bytes = Cursor::new(Vec::new());
    let result = match picture {
        Some(picture) => match format {
            ImageFormat::OpenExr => picture.write_with_encoder(OpenExrEncoder::new(&mut bytes)),
            _ => picture.write_with_encoder(PngEncoder::new(&mut bytes)),
        }
        .map_err(std::io::Error::other),
        None => Err(std::io::Error::other("its size and its texels disagree")),
    };
    result.map_err(|source| ImportError::Write { path: path.to_path_buf(), source })?;
    Ok(bytes.into_inner())
}

fn materials(
    scene: &LoadedScene,
    name: &str,
    pictures: &mut BTreeMap<String, Vec<u8>>,
    folder: &Path,
) -> Result<String, ImportError> {
    let s = &scene.scene;
    let mut text = format!("# {name}, written by patchlight\n");
    for (material, label) in s.materials.iter().zip(material_names(scene)) {
        let kd = material.albedo;
        let ke = material.radiance;
        let _ = write!(text, "\nnewmtl {label}\nKd {} {} {}\nKe {} {} {}\n", kd.x, kd.y, kd.z, ke.x, ke.y, ke.z);
        for (key, index) in [("map_Kd", material.albedo_texture), ("map_Ke", material.radiance_texture)] {
            if let Some(texture) = s.geometry.textures.get(index as usize).filter(|_| index != NONE) {
                let file = format!("{name}-{index}.png");
                let picture = picture(texture, &s.geometry.texels);
                pictures.insert(file.clone(), encode(picture, ImageFormat::Png, &folder.join(&file))?);
                let _ = writeln!(text, "{key} {file}");
            }
        }
        if let Some(texture) =
            s.geometry.textures.get(material.mask_texture as usize).filter(|_| material.mask_texture != NONE)
        {
            let file = format!("{name}-{}-mask.png", material.mask_texture);
            // MTL knows only the threshold ½.
            let picture = mask(texture, &s.geometry.texels, 0.5 / material.mask_cutoff.max(1e-6));
            pictures.insert(file.clone(), encode(picture, ImageFormat::Png, &folder.join(&file))?);
            let _ = writeln!(text, "map_d {file}");
        }
    }
    Ok(text)
}

fn level_0<'a>(texture: &Texture, texels: &'a [u32]) -> impl Iterator<Item = glam::Vec4> + 'a {
    let first = texture.offset;
    let count = texture.width * texture.height;
    (first..first + count).map(|k| texel(texels, k))
}

fn byte(x: f32) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

fn picture(texture: &Texture, texels: &[u32]) -> Option<DynamicImage> {
    let bytes = level_0(texture, texels).flat_map(|t| [t.x, t.y, t.z].map(|c| byte(encode_srgb(c)))).collect();
    image::RgbImage::from_raw(texture.width, texture.height, bytes).map(DynamicImage::ImageRgb8)
}

fn mask(texture: &Texture, texels: &[u32], factor: f32) -> Option<DynamicImage> {
    let bytes = level_0(texture, texels).map(|t| byte(t.w * factor)).collect();
    image::GrayImage::from_raw(texture.width, texture.height, bytes).map(DynamicImage::ImageLuma8)
}

fn mesh(scene: &LoadedScene, name: &str) -> String {
    let s = &scene.scene;
    let names = material_names(scene);
    // The order of the file they came from, not that of the hierarchy.
    let mut order: Vec<usize> = (0..s.geometry.triangles.len()).collect();
    order.sort_by_key(|k| s.geometry.triangles[*k].source);
    let mut text = format!("# {name}, written by patchlight, metres\nmtllib {name}.mtl\n");
    let mut positions: HashMap<[u32; 3], usize> = HashMap::new();
    let mut uvs: HashMap<[u32; 2], usize> = HashMap::new();
    let mut object = NONE;
    let mut material = NONE;
    for k in order {
        let t = &s.geometry.triangles[k];
        let uv = &s.geometry.uvs[k];
        let mut face = String::from("f");
        for (p, uv) in corners(t).into_iter().zip([uv.corner, uv.corner_a, uv.corner_b]) {
            let v = number(&mut positions, p.to_array().map(f32::to_bits), || {
                let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
            });
            let vt = number(&mut uvs, Vec2::to_array(&uv).map(f32::to_bits), || {
                let _ = writeln!(text, "vt {} {}", uv.x, uv.y);
            });
            let _ = write!(face, " {v}/{vt}");
        }
        if t.object != object {
            object = t.object;
            let label = scene.objects.get(object as usize).map_or("object", String::as_str);
            let _ = writeln!(text, "o {}", one_line(label));
        }
        if t.material != material {
            material = t.material;
            let _ = writeln!(text, "usemtl {}", names[material as usize]);
        }
        text.push_str(&face);
        text.push('\n');
    }
    text
}

fn corners(t: &Triangle) -> [Vec3; 3] {
    [t.corner, t.corner + t.edge_a, t.corner + t.edge_b]
}

/// The number of a vertex, from 1; new ones are written first.
fn number<K: std::hash::Hash + Eq>(known: &mut HashMap<K, usize>, key: K, mut write: impl FnMut()) -> usize {
    let next = known.len() + 1;
    *known.entry(key).or_insert_with(|| {
        write();
        next
    })
}

fn settings(scene: &LoadedScene, name: &str) -> String {
    let v = |v: Vec3| format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z);
    let view = &scene.view;
    let exposure =
        if scene.is_exposed { format!("exposure_stops = {:?}\n", scene.exposure_stops) } else { String::new() };
    let mut text = format!(
        "# {name}, written by patchlight.\nversion = 1\nmesh = {:?}\nmetres_per_unit = 1.0\n{}\n\
         [camera]\neye = {}\ntarget = {}\nup = {}\nvertical_fov_degrees = {:?}\n",
        format!("{name}.obj"),
        exposure,
        v(view.eye),
        v(view.target),
        v(view.up),
        view.vertical_fov_degrees
    );
    for light in &scene.scene.lighting.lights {
        text.push_str(&light_table(light, name, v));
    }
    for (material, label) in scene.scene.materials.iter().zip(material_names(scene)).filter(|(m, _)| m.is_specular()) {
        let _ = write!(
            text,
            "\n[[material]]\nname = {label:?}\nmirror = {}\ntransmittance = {}\nindex_of_refraction = {:?}\npane = \
             {}\n",
            v(material.mirror),
            v(material.transmittance),
            material.index_of_refraction,
            material.is_pane == 1
        );
    }
    let finishes = &scene.scene.geometry.finishes;
    for (finish, label) in finishes.iter().zip(material_names(scene)).filter(|(finish, _)| finish.has_lobe == 1) {
        let Finish { roughness, metallic, .. } = finish;
        let _ = write!(text, "\n[[material]]\nname = {label:?}\nroughness = {roughness:?}\nmetallic = {metallic:?}\n");
    }
    if scene.scene.has_medium() {
        let _ = write!(text, "\n[medium]\nabsorption = {}\n", v(scene.scene.geometry.absorption));
    }
    let sky = &scene.scene.lighting.sky;
    if sky.radiance.max_element() > 0.0 {
        let _ = write!(text, "\n[sky]\nradiance = {}\n", v(sky.radiance));
        if sky.map_width > 0 {
            let _ = writeln!(text, "map = {:?}", format!("{name}-sky.exr"));
        }
    }
    text.push_str(&animation_tables(&scene.animation, v));
    text
}

fn light_table(light: &Light, name: &str, v: impl Fn(Vec3) -> String) -> String {
    let (kind, keys) = match light.kind {
        LIGHT_DIRECTIONAL => {
            ("directional", format!("direction = {}\nirradiance = {}\n", v(light.direction), v(light.color)))
        }
        LIGHT_POINT => ("point", format!("position = {}\nintensity = {}\n", v(light.position), v(light.color))),
        LIGHT_SPOT => {
            let degrees = |cosine: f32| f64::from(cosine).acos().to_degrees() as f32;
            let keys = format!(
                "position = {}\ndirection = {}\nintensity = {}\ninner_degrees = {:?}\nouter_degrees = {:?}\n",
                v(light.position),
                v(light.direction),
                v(light.color),
                degrees(light.cos_inner),
                degrees(light.cos_outer)
            );
            ("spot", keys)
        }
        LIGHT_LUMINAIRE => {
            let bright = luminance(light.color);
            let color = if bright > 0.0 { light.color / bright } else { Vec3::ONE };
            let keys = format!(
                "file = {:?}\nposition = {}\ndirection = {}\nc0 = {}\ncolor = {}\nflux = {:?}\n",
                luminaire::file_name(name, light.distribution),
                v(light.position),
                v(light.direction),
                v(light.edge_a),
                v(color),
                4.0 * std::f32::consts::PI * LUMENS_PER_WATT * bright
            );
            ("luminaire", keys)
        }
        _ => {
            let keys = format!(
                "corner = {}\nedge_a = {}\nedge_b = {}\nradiance = {}\n",
                v(light.position),
                v(light.edge_a),
                v(light.edge_b),
                v(light.color)
            );
            ("rect", keys)
        }
    };
    format!("\n[[light]]\ntype = \"{kind}\"\n{keys}")
}

fn animation_tables(animation: &Animation, v: impl Fn(Vec3) -> String) -> String {
    let mut text = String::new();
    for track in &animation.tracks {
        let (target, index, property) = match track.target {
            Target::LightPosition(k) => ("light", Some(k), "position"),
            Target::LightDirection(k) => ("light", Some(k), "direction"),
            Target::LightColor(k) => ("light", Some(k), "color"),
            Target::CameraEye => ("camera", None, "eye"),
            Target::CameraTarget => ("camera", None, "target"),
        };
        let _ = write!(text, "\n[[animation]]\ntarget = \"{target}\"\n");
        if let Some(index) = index {
            let _ = writeln!(text, "index = {index}");
        }
        let _ = write!(text, "property = \"{property}\"\nkeyframes = [\n");
        for k in &track.keyframes {
            let _ = writeln!(text, "    {{ time = {:?}, value = {} }},", k.time, v(k.value));
        }
        text.push_str("]\n");
    }
    text
}
