//! Pictures into texels: decoded once a file, linear, with a mip pyramid, packed into one buffer under a budget.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{Vec3, Vec4};
use image::{DynamicImage, ImageReader};
use rayon::prelude::*;
use scene::kernel::shade::decode_srgb;
use scene::{NONE, Texture};
use sha2::{Digest, Sha256};

use super::draft::MaterialDraft;

/// Greatest reflectance a channel.
pub const ALBEDO_LIMIT: f32 = 0.95;

/// Greatest width or height of a picture that is read.
const SIDE_LIMIT: u32 = 16_384;

/// Where a picture comes from.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Source {
    /// A file.
    File(PathBuf),
    /// An encoded picture inside another file.
    Embedded {
        /// For messages; unique in the scene.
        name: String,
        /// PNG, JPEG, …
        bytes: Arc<Vec<u8>>,
    },
    /// Made by a built-in scene: sRGB bytes r, g, b, a from the upper left corner.
    Made {
        /// For messages; unique in the scene.
        name: String,
        /// Width in texels; the height follows.
        width: u32,
        /// Four bytes a texel.
        rgba: Arc<Vec<u8>>,
    },
}

impl Source {
    /// The path, or the name.
    pub fn name(&self) -> String {
        match self {
            Self::File(path) => path.display().to_string(),
            Self::Embedded { name, .. } | Self::Made { name, .. } => name.clone(),
        }
    }

    fn size(&self) -> Result<(u32, u32), String> {
        let (width, height) = match self {
            Self::File(path) => {
                let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
                guard(|| reader.map_err(|e| e.to_string())?.into_dimensions().map_err(|e| e.to_string()))?
            }
            Self::Embedded { bytes, .. } => guard(|| reader(bytes)?.into_dimensions().map_err(|e| e.to_string()))?,
            Self::Made { width, rgba, .. } => (*width, (rgba.len() / 4) as u32 / (*width).max(1)),
        };
        if width == 0 || height == 0 || width > SIDE_LIMIT || height > SIDE_LIMIT {
            return Err(format!("its size is {width} x {height}, 1 to {SIDE_LIMIT} can be read"));
        }
        Ok((width, height))
    }

    fn decode(&self) -> Result<DynamicImage, String> {
        match self {
            Self::File(path) => decode(&std::fs::read(path).map_err(|e| e.to_string())?),
            Self::Embedded { bytes, .. } => decode(bytes),
            Self::Made { rgba, .. } => {
                let (width, height) = self.size()?;
                image::RgbaImage::from_raw(width, height, rgba.to_vec())
                    .map(DynamicImage::ImageRgba8)
                    .ok_or_else(|| String::from("its size and its bytes disagree"))
            }
        }
    }
}

/// Runs a decoder; a panic inside it counts as a broken file.
pub fn guard<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| Err(String::from("its decoder gave up")))
}

fn reader(bytes: &[u8]) -> Result<ImageReader<Cursor<&[u8]>>, String> {
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(SIDE_LIMIT);
    limits.max_image_height = Some(SIDE_LIMIT);
    limits.max_alloc = Some(2 << 30);
    reader.limits(limits);
    Ok(reader)
}

/// An encoded picture decoded, whatever its format.
pub fn decode(bytes: &[u8]) -> Result<DynamicImage, String> {
    guard(|| reader(bytes)?.decode().map_err(|e| e.to_string()))
}

/// What of a picture is a mask; white is opaque.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MaskChannel {
    /// The alpha channel when it says anything, else the grey of the picture as it is stored (MTL).
    AlphaOrGrey,
    /// The alpha channel; a picture without one is opaque (glTF).
    Alpha,
}

/// What a picture is used for; each use is a texture of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Use {
    /// Reflectance times a factor (bits of r, g, b); with the mask in alpha when the same file is both.
    Albedo { factor: [u32; 3], mask: Option<MaskChannel> },
    /// Alpha only.
    Mask(MaskChannel),
    /// Radiance: divided by the greatest value when that is above 1.
    Radiance,
}

/// The texel buffer of a scene and which texture each material uses.
#[derive(Default)]
pub struct Packed {
    /// Pictures.
    pub textures: Vec<Texture>,
    /// Two words a texel.
    pub texels: Vec<u32>,
    /// Where each picture came from.
    pub names: Vec<String>,
    /// SHA-256 of each picture's texels.
    pub hashes: Vec<[u8; 32]>,
    /// Textures of each material.
    pub slots: Vec<Slots>,
    /// What was replaced.
    pub warnings: Vec<String>,
}

/// Textures of a material, [`NONE`] where there is none or it could not be read.
#[derive(Clone, Copy, Debug)]
pub struct Slots {
    /// Reflectance.
    pub albedo: u32,
    /// Radiance.
    pub radiance: u32,
    /// What the material's radiance is multiplied by because the texture was divided by it.
    pub radiance_scale: f32,
    /// Mask.
    pub mask: u32,
}

/// A pyramid: levels from the largest on, linear RGBA.
struct Pyramid {
    width: u32,
    height: u32,
    levels: u32,
    words: Vec<u32>,
    hash: [u8; 32],
    clamped: bool,
    scale: f32,
}

/// Reads every picture the materials use, in parallel, and packs the pyramids; the largest are halved until all fit into
/// `budget` bytes.
pub fn pack(materials: &[MaterialDraft], budget: usize) -> Packed {
    let mut uses: BTreeMap<(&Source, Use), usize> = BTreeMap::new();
    for (source, used, _) in materials.iter().flat_map(wanted) {
        let next = uses.len();
        uses.entry((source, used)).or_insert(next);
    }
    // By source, so that a file is decoded once.
    let mut sources: BTreeMap<&Source, Vec<Use>> = BTreeMap::new();
    for (source, used) in uses.keys() {
        sources.entry(source).or_default().push(*used);
    }
    let sources: Vec<(&Source, Vec<Use>)> = sources.into_iter().collect();
    let sizes: Vec<Result<(u32, u32), String>> = sources.par_iter().map(|(source, _)| source.size()).collect();

    let mut packed = Packed::default();
    let skips = plan(&sources, &sizes, budget, &mut packed.warnings);
    let made: Vec<Result<Vec<Pyramid>, String>> = sources
        .par_iter()
        .zip(&sizes)
        .zip(&skips)
        .map(|(((source, uses), size), skip)| {
            size.clone()?;
            let picture = source.decode()?;
            Ok(uses.iter().map(|used| build_pyramid(&picture, *used, *skip)).collect())
        })
        .collect();

    let mut found: BTreeMap<(&Source, Use), (u32, bool, f32)> = BTreeMap::new();
    for ((source, uses), pyramids) in sources.iter().zip(made) {
        let pyramids = match pyramids {
            Ok(pyramids) => pyramids,
            Err(reason) => {
                packed.warnings.push(format!(
                    "texture {}: cannot be used ({reason}); mid-grey is used where it is a colour, no holes where it is a mask",
                    source.name()
                ));
                continue;
            }
        };
        for (used, pyramid) in uses.iter().zip(pyramids) {
            found.insert((source, *used), (packed.textures.len() as u32, pyramid.clamped, pyramid.scale));
            packed.textures.push(Texture {
                offset: (packed.texels.len() / 2) as u32,
                width: pyramid.width,
                height: pyramid.height,
                levels: pyramid.levels,
            });
            packed.texels.extend_from_slice(&pyramid.words);
            packed.names.push(source.name());
            packed.hashes.push(pyramid.hash);
        }
    }
    for material in materials {
        let mut slots = Slots { albedo: NONE, radiance: NONE, radiance_scale: 1.0, mask: NONE };
        for (source, used, slot) in wanted(material) {
            let Some(&(texture, clamped, scale)) = found.get(&(source, used)) else { continue };
            match slot {
                Slot::Albedo => slots.albedo = texture,
                Slot::Mask => slots.mask = texture,
                Slot::Radiance => (slots.radiance, slots.radiance_scale) = (texture, scale),
            }
            if clamped && slot == Slot::Albedo {
                packed.warnings.push(format!(
                    "material {}: texels of {} above {ALBEDO_LIMIT} were lowered to it",
                    material.name,
                    source.name()
                ));
            }
        }
        packed.slots.push(slots);
    }
    packed
}

#[derive(Clone, Copy, PartialEq)]
enum Slot {
    Albedo,
    Mask,
    Radiance,
}

fn wanted(material: &MaterialDraft) -> Vec<(&Source, Use, Slot)> {
    let mut wanted = Vec::new();
    let factor = material.albedo_factor.to_array().map(f32::to_bits);
    let mask = material.mask.as_ref().map(|(_, channel)| *channel);
    let shared = material.mask.as_ref().map(|(source, _)| source) == material.albedo_picture.as_ref();
    if let Some(source) = &material.albedo_picture {
        wanted.push((source, Use::Albedo { factor, mask: mask.filter(|_| shared) }, Slot::Albedo));
    }
    if let Some((source, channel)) = &material.mask {
        let used = if shared { Use::Albedo { factor, mask } } else { Use::Mask(*channel) };
        wanted.push((source, used, Slot::Mask));
    }
    if let Some(source) = &material.radiance_picture {
        wanted.push((source, Use::Radiance, Slot::Radiance));
    }
    wanted
}

/// Texels of a pyramid whose level 0 has this size.
fn pyramid_texels(mut width: u32, mut height: u32) -> usize {
    let mut count = 0;
    loop {
        count += width as usize * height as usize;
        if width == 1 && height == 1 {
            return count;
        }
        (width, height) = ((width / 2).max(1), (height / 2).max(1));
    }
}

/// How many levels of each source to leave out so that all pyramids fit.
fn plan(
    sources: &[(&Source, Vec<Use>)],
    sizes: &[Result<(u32, u32), String>],
    budget: usize,
    warnings: &mut Vec<String>,
) -> Vec<u32> {
    let mut skips = vec![0u32; sources.len()];
    let bytes = |k: usize, skip: u32| match &sizes[k] {
        Ok((w, h)) => 8 * sources[k].1.len() * pyramid_texels((w >> skip).max(1), (h >> skip).max(1)),
        Err(_) => 0,
    };
    let mut total: usize = (0..sources.len()).map(|k| bytes(k, 0)).sum();
    let mut heap: std::collections::BinaryHeap<(usize, usize)> = (0..sources.len()).map(|k| (bytes(k, 0), k)).collect();
    while total > budget {
        let Some((size, k)) = heap.pop() else { break };
        let smaller = bytes(k, skips[k] + 1);
        if smaller == size {
            break;
        }
        skips[k] += 1;
        total -= size - smaller;
        heap.push((smaller, k));
    }
    for (k, skip) in skips.iter().enumerate().filter(|(_, skip)| **skip > 0) {
        warnings.push(format!(
            "texture {}: halved {skip} time(s) so that all textures fit into {} MiB",
            sources[k].0.name(),
            budget >> 20
        ));
    }
    skips
}

fn build_pyramid(picture: &DynamicImage, used: Use, skip: u32) -> Pyramid {
    let (mut width, mut height) = (picture.width(), picture.height());
    let (mut texels, clamped, scale) = linear_texels(picture, used);
    for _ in 0..skip {
        (texels, width, height) = halve(&texels, width, height);
    }
    let (width_0, height_0) = (width, height);
    let mut words = Vec::with_capacity(2 * pyramid_texels(width, height));
    let mut levels = 0;
    loop {
        levels += 1;
        words.extend(texels.iter().flat_map(|t| quantise(*t)));
        if width == 1 && height == 1 {
            break;
        }
        (texels, width, height) = halve(&texels, width, height);
    }
    let hash = Sha256::digest(bytemuck::cast_slice::<u32, u8>(&words)).into();
    Pyramid { width: width_0, height: height_0, levels, words, hash, clamped, scale }
}

fn quantise(t: Vec4) -> [u32; 2] {
    let q = (t.clamp(Vec4::ZERO, Vec4::ONE) * 65_535.0 + 0.5).as_uvec4();
    [q.x | q.y << 16, q.z | q.w << 16]
}

/// Linear texels for a use, whether any was clamped, and what radiance was divided by.
fn linear_texels(picture: &DynamicImage, used: Use) -> (Vec<Vec4>, bool, f32) {
    let mut texels = match used {
        Use::Mask(_) => vec![Vec4::splat(0.5); picture.width() as usize * picture.height() as usize],
        _ => colours(picture),
    };
    let mut clamped = false;
    let mut scale = 1.0f32;
    match used {
        Use::Albedo { factor, .. } => {
            let factor = Vec3::from_array(factor.map(f32::from_bits)).extend(1.0);
            for t in &mut texels {
                let c = *t * factor;
                let low = c.min(Vec4::new(ALBEDO_LIMIT, ALBEDO_LIMIT, ALBEDO_LIMIT, 1.0)).max(Vec4::ZERO);
                clamped |= low.truncate() != c.truncate();
                *t = low;
            }
        }
        Use::Radiance => {
            let greatest = texels.iter().map(|t| t.truncate().max_element()).fold(0.0, f32::max);
            if greatest > 1.0 && greatest.is_finite() {
                scale = greatest;
                texels.iter_mut().for_each(|t| *t /= scale);
            }
        }
        Use::Mask(_) => {}
    }
    if let Use::Mask(channel) | Use::Albedo { mask: Some(channel), .. } = used {
        for (t, a) in texels.iter_mut().zip(mask_values(picture, channel)) {
            t.w = a;
        }
    } else {
        texels.iter_mut().for_each(|t| t.w = 1.0);
    }
    (texels, clamped, scale)
}

/// Linear colours: 8 and 16 bits a channel are sRGB, floats are linear already (not finite: 0).
fn colours(picture: &DynamicImage) -> Vec<Vec4> {
    use DynamicImage as D;
    match picture {
        D::ImageLuma8(_) | D::ImageLumaA8(_) | D::ImageRgb8(_) | D::ImageRgba8(_) => {
            let table: Vec<f32> = (0..256).map(|k| decode_srgb(k as f32 / 255.0)).collect();
            let decode = |c: &[u8]| Vec4::new(table[c[0] as usize], table[c[1] as usize], table[c[2] as usize], 1.0);
            if let D::ImageRgb8(rgb) = picture {
                return rgb.as_raw().chunks_exact(3).map(decode).collect();
            }
            picture.to_rgba8().as_raw().chunks_exact(4).map(decode).collect()
        }
        D::ImageRgb32F(_) | D::ImageRgba32F(_) => picture
            .to_rgb32f()
            .as_raw()
            .chunks_exact(3)
            .map(|c| {
                let finite = |x: f32| if x.is_finite() { x.max(0.0) } else { 0.0 };
                Vec4::new(finite(c[0]), finite(c[1]), finite(c[2]), 1.0)
            })
            .collect(),
        _ => picture
            .to_rgba16()
            .as_raw()
            .chunks_exact(4)
            .map(|c| {
                let decode = |x: u16| decode_srgb(f32::from(x) / 65_535.0);
                Vec4::new(decode(c[0]), decode(c[1]), decode(c[2]), 1.0)
            })
            .collect(),
    }
}

fn mask_values(picture: &DynamicImage, channel: MaskChannel) -> Vec<f32> {
    if picture.color().has_alpha() {
        let alpha: Vec<f32> = picture.to_rgba8().as_raw().chunks_exact(4).map(|c| f32::from(c[3]) / 255.0).collect();
        if channel == MaskChannel::Alpha || alpha.iter().any(|a| *a < 1.0) {
            return alpha;
        }
    } else if channel == MaskChannel::Alpha {
        return vec![1.0; picture.width() as usize * picture.height() as usize];
    }
    picture.to_luma8().as_raw().iter().map(|c| f32::from(*c) / 255.0).collect()
}

/// The next level: every new texel is the mean over its part of the old picture, so that the mean stays, also for odd sizes.
pub fn halve(texels: &[Vec4], width: u32, height: u32) -> (Vec<Vec4>, u32, u32) {
    let (new_width, new_height) = ((width / 2).max(1), (height / 2).max(1));
    let columns = shares(width, new_width);
    let rows = shares(height, new_height);
    let mut next = Vec::with_capacity(new_width as usize * new_height as usize);
    for (row, row_weights) in &rows {
        for (column, column_weights) in &columns {
            let mut sum = Vec4::ZERO;
            for (dy, wy) in row_weights.iter().enumerate() {
                let line = (row + dy) * width as usize + column;
                for (dx, wx) in column_weights.iter().enumerate() {
                    sum += texels[line + dx] * (wx * wy);
                }
            }
            next.push(sum);
        }
    }
    (next, new_width, new_height)
}

/// For each of `new` cells: the first of the `old` cells it covers, and the share of each in it (they sum to 1).
fn shares(old: u32, new: u32) -> Vec<(usize, Vec<f32>)> {
    let size = f64::from(old) / f64::from(new);
    (0..new)
        .map(|k| {
            let (start, end) = (f64::from(k) * size, f64::from(k + 1) * size);
            let first = start.floor() as usize;
            let last = ((end - 1e-9).floor() as usize).min(old as usize - 1);
            let weights =
                (first..=last).map(|c| (((c as f64 + 1.0).min(end) - (c as f64).max(start)) / size) as f32).collect();
            (first, weights)
        })
        .collect()
}

/// A sky: linear texels row by row from the top, width, height; larger ones are halved until they fit into `budget` bytes.
pub fn read_sky(path: &Path, budget: usize, warnings: &mut Vec<String>) -> Result<(Vec<Vec4>, u32, u32), String> {
    let bytes = std::fs::read(path).map_err(|e| e.to_string())?;
    let picture = decode(&bytes)?;
    let (mut width, mut height) = (picture.width(), picture.height());
    if !matches!(picture, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) {
        warnings
            .push(format!("sky {}: has no high dynamic range; its sRGB values are used as radiance", path.display()));
    }
    if picture.to_rgb32f().as_raw().iter().any(|x| !x.is_finite() || *x < 0.0) {
        warnings.push(format!("sky {}: values that are negative or not finite count as 0", path.display()));
    }
    let mut texels = colours(&picture);
    if width == 0 || height == 0 {
        return Err(String::from("it has no pixels"));
    }
    let mut halvings = 0;
    while 16 * texels.len() > budget && texels.len() > 1 {
        (texels, width, height) = halve(&texels, width, height);
        halvings += 1;
    }
    if halvings > 0 {
        warnings.push(format!(
            "sky {}: halved {halvings} time(s) to {width} x {height} so that it fits into {} MiB",
            path.display(),
            budget >> 20
        ));
    }
    Ok((texels, width, height))
}
