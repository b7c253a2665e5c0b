//! A scene between reading and building: what every file format and every built-in scene fills in.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;
use scene::gpu::{LIGHT_DIRECTIONAL, Triangle, TriangleUv};
use scene::kernel::normal;
use scene::{Finish, Light, Material, NONE, Scene, SceneParts, Sky};
use sha2::{Digest, Sha256};

use super::lights::QUANTITY_LIMIT;
use super::optics::Optics;
use super::pictures::{ALBEDO_LIMIT, MaskChannel, Packed, Source, pack};
use super::{
    Animation, AtlasTriangle, Dropped, ImportError, LightmapUvs, LoadOptions, LoadedScene, MovingObject, View,
};

/// Most triangles of a scene: 2²⁸.
const TRIANGLE_LIMIT: usize = 1 << 28;

/// Bytes that a triangle takes at most while it is read: of the file's and the scene's tables, the hierarchy and what
/// builds it.
const TRIANGLE_BYTES: u64 = 400;

/// Triangles that are judged before any is kept.
const JUDGED_AT_ONCE: usize = 1 << 16;

/// Greatest coordinate, m: areas of larger triangles leave the range of single precision.
const COORDINATE_LIMIT: f32 = 1e9;

/// Least diagonal of a scene, m: products of smaller edges leave the range in which rays are told apart.
const SIZE_LIMIT: f32 = 1e-3;
/// Steps of coordinates, as shares of the diagonal, from which a scene is refused, and from which its user is warned.
const COARSE: f32 = 1e-3;
const UNEVEN: f32 = 1e-5;

/// A material as files have it.
#[derive(Clone, Debug)]
pub struct MaterialDraft {
    /// Name.
    pub name: String,
    /// Diffuse reflectance where there is no picture.
    pub albedo: Vec3,
    /// Picture that replaces `albedo`.
    pub albedo_picture: Option<Source>,
    /// Multiplies the picture's colours.
    pub albedo_factor: Vec3,
    /// Radiance from the front, W/m²/sr.
    pub radiance: Vec3,
    /// Picture that `radiance` is multiplied by.
    pub radiance_picture: Option<Source>,
    /// Specular reflection and transmission.
    pub optics: Optics,
    /// Picture that has the mask, and where in it.
    pub mask: Option<(Source, MaskChannel)>,
    /// Values below are holes.
    pub mask_cutoff: f32,
    /// The whole material is a hole: its triangles are left out.
    pub hole: bool,
    /// What pictures show of it beside diffuse light.
    pub finish: FinishDraft,
}

/// The finish of a material as files have it.
#[derive(Clone, Debug)]
pub struct FinishDraft {
    /// Normals, and the factor of their slope.
    pub normal_picture: Option<Source>,
    /// Multiplies the slope of the normals.
    pub normal_scale: f32,
    /// Roughness in green, metalness in blue.
    pub surface_picture: Option<Source>,
    /// Roughness of the lobe; without one there is none.
    pub roughness: Option<f32>,
    /// Share that is metal.
    pub metallic: f32,
}

impl Default for FinishDraft {
    /// Diffuse and even.
    fn default() -> Self {
        Self { normal_picture: None, normal_scale: 1.0, surface_picture: None, roughness: None, metallic: 0.0 }
    }
}

impl FinishDraft {
    fn build(&self, slots: &super::pictures::Slots) -> Finish {
        Finish {
            normal_texture: slots.normal,
            normal_scale: if self.normal_scale.is_finite() { self.normal_scale } else { 1.0 },
            surface_texture: slots.surface,
            roughness: self.roughness.unwrap_or(1.0).clamp(0.0, 1.0),
            metallic: self.metallic.clamp(0.0, 1.0),
            has_lobe: u32::from(self.roughness.is_some()),
            ..Finish::default()
        }
    }
}

impl MaterialDraft {
    /// Mid-grey, without light or holes.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            albedo: Vec3::splat(0.5),
            albedo_picture: None,
            albedo_factor: Vec3::ONE,
            radiance: Vec3::ZERO,
            radiance_picture: None,
            optics: Optics::default(),
            mask: None,
            mask_cutoff: 0.5,
            hole: false,
            finish: FinishDraft::default(),
        }
    }

    /// Takes what the material mirrors and lets through, and leaves what is left of the light to diffuse reflection.
    /// Returns what was repaired.
    pub fn set_optics(&mut self, mut optics: Optics) -> Vec<String> {
        let mut repairs: Vec<String> = optics.repair().into_iter().collect();
        let rest = optics.rest();
        if optics.is_specular() && self.albedo.cmpgt(rest).any() {
            repairs.push(format!(
                "diffuse reflectance {} {} {} was lessened to what mirror and transmittance leave",
                self.albedo.x, self.albedo.y, self.albedo.z
            ));
            self.albedo = self.albedo.min(rest);
        }
        if optics.is_specular() {
            self.albedo_factor = self.albedo_factor.min(rest);
        }
        self.optics = optics;
        repairs
    }

    /// Brings reflectance and radiance into their range, with at most one warning each.
    fn repair(&mut self, warnings: &mut Vec<String>) {
        let before = self.albedo;
        self.albedo = clamp_albedo(before);
        if before != self.albedo && self.albedo_picture.is_none() {
            warnings.push(format!(
                "material {}: reflectance {} {} {} was brought into 0 … {ALBEDO_LIMIT}",
                self.name, before.x, before.y, before.z
            ));
        }
        let radiance = self.radiance.map(|x| if x.is_finite() { x.clamp(0.0, QUANTITY_LIMIT) } else { 0.0 });
        if radiance != self.radiance {
            warnings.push(format!(
                "material {}: emission below 0 or not finite counts as 0, above {QUANTITY_LIMIT:e} as that",
                self.name
            ));
            self.radiance = radiance;
        }
    }
}

fn clamp_albedo(c: Vec3) -> Vec3 {
    Vec3::from_array(c.to_array().map(|x| if x.is_nan() { 0.5 } else { x.clamp(0.0, ALBEDO_LIMIT) }))
}

/// A triangle as files have it, in file units, already placed in the scene.
#[derive(Clone, Copy, Debug)]
pub struct FileTriangle {
    /// Corners, counter-clockwise from the front.
    pub corners: [Vec3; 3],
    /// Texture coordinates.
    pub uvs: [Vec2; 3],
    /// Normals, packed; 0 where the file has none.
    pub normals: [u32; 3],
    /// Index of the material.
    pub material: u32,
    /// Index of the object.
    pub object: u32,
}

/// Normals of a file's vertex, as [`FileTriangle::normals`] has them.
pub fn packed_normal(normal: Vec3) -> u32 {
    normal.try_normalize().map_or(0, normal::pack)
}

/// Geometry and materials of a file, in its own units.
#[derive(Default)]
pub struct Mesh {
    /// Triangles in the order of the file.
    pub triangles: Vec<FileTriangle>,
    /// Coordinates for a lightmap, one entry a triangle, or none.
    pub lightmap_uvs: Vec<[Vec2; 3]>,
    /// Objects' names.
    pub objects: Vec<String>,
    /// Objects that move, in units of the file.
    pub moving: Vec<MovingObject>,
    /// Materials.
    pub materials: Vec<MaterialDraft>,
    /// Lights of the file, in its units of length.
    pub lights: Vec<Light>,
    /// Camera of the file, in file units.
    pub view: Option<View>,
    /// Repairs made during import.
    pub warnings: Vec<String>,
    /// Files that it was read from, but for pictures.
    pub files: Vec<PathBuf>,
    /// Texels, when they were packed while the mesh was read.
    pub packed: Option<Packed>,
    /// Seconds of each phase.
    pub timings: Vec<(&'static str, f64)>,
}

/// Scene content other than the mesh.
pub struct Setting {
    /// For messages.
    pub path: PathBuf,
    /// Name of the scene.
    pub name: String,
    /// Length of the file's unit, m.
    pub metres_per_unit: f32,
    /// Exposure of pictures, where the scene says it.
    pub exposure_stops: Option<f32>,
    /// Camera, in metres; without one the bounds are framed.
    pub view: Option<View>,
    /// Lights, in metres.
    pub lights: Vec<Light>,
    /// The sky.
    pub sky: Sky,
    /// Its map.
    pub sky_map: Vec<Vec4>,
    /// Distributions of luminaires.
    pub distributions: Vec<f32>,
    /// Absorption of the medium between surfaces, 1/m.
    pub absorption: Vec3,
    /// Tracks only; lights and view are filled in.
    pub animation: Animation,
    /// Objects that move.
    pub moving: Vec<MovingObject>,
    /// Light a mesh that has no light at all with a sun and a sky.
    pub default_light: bool,
    /// Files that it was read from.
    pub files: Vec<PathBuf>,
}

impl Setting {
    /// One metre a unit, no light, no camera.
    pub fn new(path: &Path, name: &str) -> Self {
        Self {
            path: path.to_path_buf(),
            name: name.to_owned(),
            metres_per_unit: 1.0,
            exposure_stops: None,
            view: None,
            lights: Vec::new(),
            sky: Sky::default(),
            sky_map: Vec::new(),
            distributions: Vec::new(),
            absorption: Vec3::ZERO,
            animation: Animation::default(),
            moving: Vec::new(),
            default_light: false,
            files: Vec::new(),
        }
    }
}

/// Refuses meshes that indices cannot count, or memory not hold.
pub fn check_count(path: &Path, count: usize, options: &LoadOptions) -> Result<(), ImportError> {
    if count > TRIANGLE_LIMIT {
        return Err(ImportError::TooManyTriangles { path: path.to_path_buf(), count, limit: TRIANGLE_LIMIT });
    }
    let needed = count as u64 * TRIANGLE_BYTES;
    match options.memory_limit.or_else(scene::host::memory::available_bytes) {
        Some(allowed) if needed > allowed => {
            Err(ImportError::Memory { path: path.to_path_buf(), count, needed, allowed })
        }
        _ => Ok(()),
    }
}

/// Seconds since, rounded to nothing.
pub fn seconds(start: Instant) -> f64 {
    start.elapsed().as_secs_f64()
}

/// Repairs, packs the pictures, builds the hierarchy.
pub fn finish(mut mesh: Mesh, setting: Setting, options: &LoadOptions) -> Result<LoadedScene, ImportError> {
    let path = &setting.path;
    let mut warnings = std::mem::take(&mut mesh.warnings);
    let mut timings = std::mem::take(&mut mesh.timings);
    check_count(path, mesh.triangles.len(), options)?;

    let start = Instant::now();
    let file_triangles = mesh.triangles.len();
    let (triangles, uvs, dropped) = clean(&mesh, &setting, &mut warnings)?;
    let lightmap_uvs = lightmap_uvs(&mesh, &setting, &mut warnings);
    // The greatest table of the file; nothing asks for it any more.
    mesh.triangles = Vec::new();
    timings.push(("clean", seconds(start)));

    let files = files_of(&mesh, &setting);
    let start = Instant::now();
    for material in &mut mesh.materials {
        material.repair(&mut warnings);
    }
    let mut packed = mesh.packed.take().unwrap_or_else(|| pack(&mesh.materials, options.texel_budget));
    warnings.append(&mut packed.warnings);
    let materials: Vec<Material> =
        mesh.materials.iter().zip(&packed.slots).map(|(m, s)| build_material(m, s)).collect();
    let mut finishes: Vec<Finish> = mesh.materials.iter().zip(&packed.slots).map(|(m, s)| m.finish.build(s)).collect();
    finishes.truncate(finishes.iter().rposition(|finish| *finish != Finish::default()).map_or(0, |last| last + 1));
    timings.push(("textures", seconds(start)));

    let mut lights = setting.lights;
    lights.extend(mesh.lights.iter().map(|l| Light { position: l.position * setting.metres_per_unit, ..*l }));
    let mut sky = setting.sky;
    let shines = |m: &Material| m.radiance.max_element() > 0.0;
    if !triangles.iter().any(|t| shines(&materials[t.material as usize])) {
        light_the_dark(path, setting.default_light, &mut lights, &mut sky, &mut warnings);
    }

    if setting.absorption != Vec3::ZERO {
        warn_of_endless_light(&lights, &sky, &mut warnings);
    }
    let parts = SceneParts {
        triangles,
        uvs,
        materials,
        finishes,
        textures: packed.textures,
        texels: packed.texels,
        lights,
        sky,
        sky_map: setting.sky_map,
        distributions: setting.distributions,
        ray_offset: None,
        absorption: setting.absorption,
    };
    let start = Instant::now();
    let mut content_hash = hash(&parts, &packed.hashes);
    timings.push(("hash", seconds(start)));
    let start = Instant::now();
    let scene = Scene::new(parts).map_err(|source| match source {
        scene::Error::Reflectance { material, found } => {
            ImportError::Reflectance { path: path.clone(), material: mesh.materials[material].name.clone(), found }
        }
        source => ImportError::Scene { path: path.clone(), source },
    })?;
    timings.push(("hierarchy", seconds(start)));
    check_size(path, scene.geometry.bounds, &mut warnings)?;

    let view = setting.view.or_else(|| mesh.view.map(|v| scaled(v, setting.metres_per_unit)));
    let view = view.unwrap_or_else(|| frame_bounds(scene.geometry.bounds));
    let exposure_stops = setting.exposure_stops.unwrap_or(0.0);
    content_hash = hash_view(content_hash, &view, exposure_stops);
    let scale = setting.metres_per_unit;
    let mut moving: Vec<MovingObject> = mesh.moving.into_iter().map(|object| object.scaled(scale)).collect();
    moving.extend(setting.moving);
    if !moving.is_empty() {
        content_hash = hash_moving(content_hash, &moving);
    }
    let animation = Animation { lights: scene.lighting.lights.clone(), view, tracks: setting.animation.tracks };
    Ok(LoadedScene {
        name: setting.name,
        scene,
        view,
        exposure_stops,
        is_exposed: setting.exposure_stops.is_some(),
        metres_per_unit: setting.metres_per_unit,
        objects: mesh.objects,
        materials: mesh.materials.into_iter().map(|m| m.name).collect(),
        textures: packed.names,
        warnings,
        animation,
        moving,
        content_hash,
        files,
        file_triangles,
        dropped,
        lightmap_uvs,
        timings,
    })
}

/// Refuses what is too small for rays, or too far from the origin for its size; warns of what nearly is.
fn check_size(path: &Path, (low, high): (Vec3, Vec3), warnings: &mut Vec<String>) -> Result<(), ImportError> {
    let size = (high - low).length();
    if size < SIZE_LIMIT {
        return Err(ImportError::TooSmall { path: path.to_path_buf(), size, limit: SIZE_LIMIT });
    }
    let coordinate = low.abs().max(high.abs()).max_element();
    let step = coordinate * f32::EPSILON;
    if step > COARSE * size {
        return Err(ImportError::FarFromOrigin { path: path.to_path_buf(), coordinate, step, size });
    }
    if step > UNEVEN * size {
        warnings.push(format!(
            "{}: coordinates of {coordinate:e} m come in steps of {step:e} m; surfaces may have specks: move the scene \
             nearer to the origin",
            path.display()
        ));
    }
    Ok(())
}

/// Warns of light that a medium without end takes as a whole, in every channel in which it takes any.
fn warn_of_endless_light(lights: &[Light], sky: &Sky, warnings: &mut Vec<String>) {
    if sky.radiance.max_element() > 0.0 || lights.iter().any(|light| light.kind == LIGHT_DIRECTIONAL) {
        warnings.push(
            "the medium has no end: it absorbs all light of directional lights and of the sky; use point, spot or \
             rect lights, or emission, or leave the medium out"
                .to_owned(),
        );
    }
}

/// Adds a sun and a sky to a scene in which nothing shines, or warns of it. No triangle shines.
fn light_the_dark(path: &Path, by_default: bool, lights: &mut Vec<Light>, sky: &mut Sky, warnings: &mut Vec<String>) {
    if !lights.is_empty() || sky.radiance.max_element() > 0.0 {
        return;
    }
    if !by_default {
        warnings
            .push(format!("{}: nothing shines: no light, no sky, no emission; pictures will be black", path.display()));
        return;
    }
    lights.push(super::lights::default_sun());
    sky.radiance = super::lights::DEFAULT_SKY;
    warnings
        .push(format!("{}: has no light; a sun and a sky were added (write a scene .toml to choose)", path.display()));
}

/// The atlas that a file brings, if it has places for all triangles.
fn lightmap_uvs(mesh: &Mesh, setting: &Setting, warnings: &mut Vec<String>) -> LightmapUvs {
    if mesh.lightmap_uvs.len() != mesh.triangles.len() {
        return LightmapUvs::default();
    }
    let place = |(t, &uvs): (&FileTriangle, &[Vec2; 3])| AtlasTriangle {
        corners: t.corners.map(|p| p * setting.metres_per_unit),
        uvs,
    };
    let atlas = LightmapUvs(mesh.triangles.iter().zip(&mesh.lightmap_uvs).map(place).collect());
    if let Some(fault) = atlas.fault() {
        warnings.push(format!("{}: TEXCOORD_1 is not taken for a lightmap: {fault}", setting.path.display()));
        return LightmapUvs::default();
    }
    atlas
}

/// All files of a scene, each once.
fn files_of(mesh: &Mesh, setting: &Setting) -> Vec<PathBuf> {
    let pictures = mesh.materials.iter().flat_map(|m| {
        let mask = m.mask.as_ref().map(|(source, _)| source);
        let finish = [m.finish.normal_picture.as_ref(), m.finish.surface_picture.as_ref()];
        [m.albedo_picture.as_ref(), m.radiance_picture.as_ref(), mask].into_iter().chain(finish).flatten()
    });
    let pictures = pictures.filter_map(|source| match source {
        Source::File(path) => Some(path),
        _ => None,
    });
    let all: BTreeSet<&PathBuf> = setting.files.iter().chain(&mesh.files).chain(pictures).collect();
    all.into_iter().cloned().collect()
}

fn build_material(m: &MaterialDraft, slots: &super::pictures::Slots) -> Material {
    let albedo =
        if m.albedo_picture.is_some() && slots.albedo == NONE { clamp_albedo(m.albedo_factor * 0.5) } else { m.albedo };
    Material {
        albedo,
        albedo_texture: slots.albedo,
        radiance: m.radiance * slots.radiance_scale,
        radiance_texture: slots.radiance,
        mirror: m.optics.mirror,
        mask_texture: slots.mask,
        transmittance: m.optics.transmittance,
        mask_cutoff: m.mask_cutoff,
        index_of_refraction: m.optics.index_of_refraction,
        is_pane: u32::from(m.optics.is_pane),
        ..Material::default()
    }
}

/// A triangle in metres, or why it is left out.
enum Verdict {
    Keep(Triangle, TriangleUv),
    ZeroArea,
    Hole,
    TooFar,
}

fn clean(
    mesh: &Mesh,
    setting: &Setting,
    warnings: &mut Vec<String>,
) -> Result<(Vec<Triangle>, Vec<TriangleUv>, Dropped), ImportError> {
    let path = &setting.path;
    let scale = setting.metres_per_unit;
    let mut dropped = Dropped::default();
    let mut triangles = Vec::with_capacity(mesh.triangles.len());
    let mut uvs = Vec::with_capacity(mesh.triangles.len());
    // In batches, so that verdicts take no memory to speak of.
    for (batch, own) in mesh.triangles.chunks(JUDGED_AT_ONCE).enumerate() {
        let verdict = |(k, t): (usize, &FileTriangle)| {
            judge(t, (batch * JUDGED_AT_ONCE + k) as u32, scale, mesh.materials[t.material as usize].hole)
        };
        let verdicts: Vec<Verdict> = own.par_iter().enumerate().map(verdict).collect();
        for (verdict, t) in verdicts.into_iter().zip(own) {
            match verdict {
                Verdict::Keep(triangle, uv) => {
                    triangles.push(triangle);
                    uvs.push(uv);
                }
                Verdict::ZeroArea => dropped.zero_area += 1,
                Verdict::Hole => dropped.holes += 1,
                Verdict::TooFar => {
                    return Err(far_corner(mesh, t, path));
                }
            }
        }
    }
    dropped.duplicates = drop_duplicates(&mesh.triangles, &mut triangles, &mut uvs);
    if dropped.zero_area > 0 {
        warnings.push(format!("{}: {} triangle(s) without area were left out", path.display(), dropped.zero_area));
    }
    if dropped.duplicates > 0 {
        warnings.push(format!(
            "{}: {} triangle(s) equal to another one were left out",
            path.display(),
            dropped.duplicates
        ));
    }
    if triangles.is_empty() {
        return Err(ImportError::NoTriangles { path: path.clone() });
    }
    Ok((triangles, uvs, dropped))
}

fn judge(t: &FileTriangle, source: u32, scale: f32, hole: bool) -> Verdict {
    let [a, b, c] = t.corners;
    let [ma, mb, mc] = t.corners.map(|p| p * scale);
    let far = |p: Vec3| p.abs().max_element() > COORDINATE_LIMIT || !p.is_finite();
    if far(ma) || far(mb) || far(mc) {
        return Verdict::TooFar;
    }
    let exact = (b.as_dvec3() - a.as_dvec3()).cross(c.as_dvec3() - a.as_dvec3());
    let edge_a = mb - ma;
    let edge_b = mc - ma;
    // The second test is for areas that single precision cannot hold: their normal would be lost.
    if exact.length_squared() == 0.0 || edge_a.cross(edge_b).length() < f32::MIN_POSITIVE {
        return Verdict::ZeroArea;
    }
    if hole {
        return Verdict::Hole;
    }
    let triangle = Triangle { corner: ma, material: t.material, edge_a, source, edge_b, object: t.object };
    let [corner, corner_a, corner_b] = t.uvs.map(|uv| if uv.is_finite() { uv } else { Vec2::ZERO });
    let uv = TriangleUv { corner, corner_a, corner_b, ..TriangleUv::default() };
    let normals = t.normals.map(|code| if code == 0 { Vec3::ZERO } else { normal::unpack(code) });
    Verdict::Keep(triangle, uv.with_normals(&triangle, normals))
}

fn far_corner(mesh: &Mesh, t: &FileTriangle, path: &Path) -> ImportError {
    let is_this = |o: &FileTriangle| std::ptr::eq(o, t);
    let face = mesh.triangles.iter().take_while(|o| !is_this(o)).filter(|o| o.object == t.object).count() + 1;
    let corner = t.corners.into_iter().max_by(|a, b| a.abs().max_element().total_cmp(&b.abs().max_element()));
    ImportError::Coordinate {
        path: path.to_path_buf(),
        object: mesh.objects[t.object as usize].clone(),
        face,
        corner: corner.unwrap_or_default().to_array(),
        limit: COORDINATE_LIMIT,
    }
}

/// Corners, the least first, in the order of the winding: equal for equal triangles.
fn corner_key(t: &FileTriangle) -> [[u32; 3]; 3] {
    let mut key = t.corners.map(|p| (p + 0.0).to_array().map(f32::to_bits));
    let first = (0..3).min_by_key(|k| key[*k]).unwrap_or(0);
    key.rotate_left(first);
    key
}

/// Removes all but the first of equal triangles; returns how many.
fn drop_duplicates(file: &[FileTriangle], triangles: &mut Vec<Triangle>, uvs: &mut Vec<TriangleUv>) -> usize {
    let key = |t: &Triangle| corner_key(&file[t.source as usize]);
    let mut order: Vec<(u64, u32)> = triangles
        .par_iter()
        .enumerate()
        .map(|(k, t)| {
            let mix = |h: u64, w: u32| (h ^ u64::from(w)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
            (key(t).iter().flatten().fold(0, |h, w| mix(h, *w)), k as u32)
        })
        .collect();
    order.par_sort_unstable();
    let mut doubled = vec![false; triangles.len()];
    let mut count = 0;
    for group in order.chunk_by(|a, b| a.0 == b.0).filter(|g| g.len() > 1) {
        // More than one key only when hashes collide.
        let mut kept = Vec::with_capacity(1);
        for (_, k) in group {
            let key = key(&triangles[*k as usize]);
            if kept.contains(&key) {
                doubled[*k as usize] = true;
                count += 1;
            } else {
                kept.push(key);
            }
        }
    }
    if count > 0 {
        let mut keep = doubled.iter().map(|d| !d);
        triangles.retain(|_| keep.next().unwrap_or(true));
        let mut keep = doubled.iter().map(|d| !d);
        uvs.retain(|_| keep.next().unwrap_or(true));
    }
    count
}

fn scaled(view: View, scale: f32) -> View {
    View { eye: view.eye * scale, target: view.target * scale, ..view }
}

/// A view from the front, a little above, that shows the whole of the bounds.
pub fn frame_bounds((low, high): (Vec3, Vec3)) -> View {
    let centre = 0.5 * (low + high);
    let radius = (0.5 * (high - low).length()).max(1e-3);
    let vertical_fov_degrees = 40.0f32;
    // The sphere round the bounds fits into the field of view: distance = r / sin(fov/2).
    let distance = radius / f64::from(0.5 * vertical_fov_degrees).to_radians().sin() as f32;
    let eye = centre + Vec3::new(0.45, 0.35, 1.0).normalize() * distance;
    View { eye, target: centre, up: Vec3::Y, vertical_fov_degrees }
}

fn hash(parts: &SceneParts, textures: &[[u8; 32]]) -> [u8; 32] {
    let mut digest = Sha256::new();
    digest.update(b"patchlight scene 1");
    for count in [parts.triangles.len(), parts.materials.len(), parts.textures.len(), parts.lights.len()] {
        digest.update((count as u64).to_le_bytes());
    }
    digest.update(bytemuck::cast_slice::<_, u8>(&parts.triangles));
    // Scenes without normals hash as they did before there were any, so that bakes stay valid.
    for uv in &parts.uvs {
        digest.update(bytemuck::bytes_of(&[uv.corner, uv.corner_a, uv.corner_b]));
        if uv.normal != 0 {
            digest.update(bytemuck::bytes_of(&[uv.normal, uv.normal_a, uv.normal_b]));
        }
    }
    parts.materials.iter().for_each(|m| hash_material(&mut digest, m));
    digest.update(bytemuck::cast_slice::<_, u8>(&parts.finishes));
    digest.update(bytemuck::cast_slice::<_, u8>(&parts.textures));
    textures.iter().for_each(|h| digest.update(h));
    digest.update(bytemuck::cast_slice::<_, u8>(&parts.lights));
    digest.update(bytemuck::bytes_of(&parts.sky));
    digest.update(bytemuck::cast_slice::<_, u8>(&parts.sky_map));
    digest.update(bytemuck::cast_slice::<_, u8>(&parts.distributions));
    if parts.absorption != Vec3::ZERO {
        digest.update(bytemuck::bytes_of(&parts.absorption));
    }
    digest.finalize().into()
}

/// Materials without specular parts hash as they did before there were any, so that bakes stay valid.
fn hash_material(digest: &mut Sha256, m: &Material) {
    for (color, texture) in [(m.albedo, m.albedo_texture), (m.radiance, m.radiance_texture)] {
        digest.update(bytemuck::bytes_of(&color));
        digest.update(texture.to_le_bytes());
    }
    digest.update(m.mask_texture.to_le_bytes());
    digest.update(m.mask_cutoff.to_le_bytes());
    digest.update([0; 8]);
    if m.is_specular() {
        digest.update(bytemuck::cast_slice::<_, u8>(&[m.mirror, m.transmittance]));
        digest.update(m.index_of_refraction.to_le_bytes());
        digest.update(m.is_pane.to_le_bytes());
    }
}

fn hash_view(before: [u8; 32], view: &View, stops: f32) -> [u8; 32] {
    let mut digest = Sha256::new();
    digest.update(before);
    for v in [view.eye, view.target, view.up, Vec3::new(view.vertical_fov_degrees, stops, 0.0)] {
        digest.update(bytemuck::bytes_of(&v));
    }
    digest.finalize().into()
}

fn hash_moving(before: [u8; 32], moving: &[MovingObject]) -> [u8; 32] {
    let mut digest = Sha256::new();
    digest.update(before);
    for object in moving {
        digest.update(object.material.to_le_bytes());
        digest.update(bytemuck::cast_slice(&object.corners));
        digest.update(bytemuck::cast_slice(&object.uvs));
        for pose in &object.poses {
            digest.update(bytemuck::bytes_of(&[pose.time]));
            digest.update(bytemuck::bytes_of(&pose.position));
            digest.update(bytemuck::bytes_of(&pose.rotation.to_array()));
        }
    }
    digest.finalize().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_that_indices_cannot_count_is_refused_before_it_is_built() {
        let path = Path::new("huge.obj");
        let options = LoadOptions { memory_limit: Some(u64::MAX), ..LoadOptions::default() };
        assert!(check_count(path, TRIANGLE_LIMIT, &options).is_ok());
        let message = check_count(path, TRIANGLE_LIMIT + 1, &options).map_err(|e| e.to_string()).unwrap_err();
        assert!(
            message.contains("huge.obj") && message.contains("268435457") && message.contains("simplify"),
            "{message}"
        );
    }

    #[test]
    fn equal_triangles_share_a_key_whatever_their_first_corner_but_not_across_windings() {
        let triangle =
            |corners| FileTriangle { corners, uvs: [Vec2::ZERO; 3], normals: [0; 3], material: 0, object: 0 };
        let a = Vec3::ZERO;
        let b = Vec3::X;
        let c = Vec3::Y;
        let key = corner_key(&triangle([a, b, c]));
        assert_eq!(key, corner_key(&triangle([c, a, b])));
        assert_eq!(key, corner_key(&triangle([-a, b, c])));
        assert_ne!(key, corner_key(&triangle([b, a, c])));
    }
}
