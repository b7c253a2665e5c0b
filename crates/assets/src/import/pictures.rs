//! Pictures into texels: decoded once a file, linear, with a mip pyramid, packed into one buffer under a budget.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{Vec3, Vec4};
use image::{DynamicImage, ImageDecoder as _, ImageReader};
use rayon::prelude::*;
use scene::NONE;
use scene::gpu::Texture;
use scene::host::{Halver, Pyramid, half};
use scene::kernel::shade::decode_srgb;
use sha2::{Digest, Sha256};

use super::draft::MaterialDraft;
use super::lights::QUANTITY_LIMIT;

/// Greatest reflectance a channel.
pub const ALBEDO_LIMIT: f32 = 0.95;

/// Greatest width or height of a picture that is read.
const SIDE_LIMIT: u32 = 16_384;

/// Bytes that any picture may take when it is decoded, and how many more it may for each byte of its file: what is
/// packed closer than that, at this size, is a few bytes that stand for gigabytes.
const DECODED_BYTES: u64 = 64 << 20;
const DECODED_A_BYTE: u64 = 16;

/// Pictures are decoded side by side as long as together they take no more than this, decoded.
const DECODED_AT_ONCE: u64 = 2 * DECODED_BYTES;

/// Source of a picture.
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

    fn size(&self) -> Result<Size, String> {
        match self {
            Self::File(path) => {
                let file = scene::host::open_regular(path).map_err(|e| e.to_string())?;
                let bytes = file.metadata().map_err(|e| e.to_string())?.len();
                guard(|| Size::of(Box::new(BufReader::new(file)), bytes))
            }
            Self::Embedded { bytes, .. } => guard(|| Size::of(Box::new(Cursor::new(&bytes[..])), bytes.len() as u64)),
            Self::Made { width, rgba, .. } => {
                let height = (rgba.len() / 4) as u32 / (*width).max(1);
                Ok(Size { width: *width, height, decoded: rgba.len() as u64 })
            }
        }
    }

    fn decode(&self) -> Result<DynamicImage, String> {
        match self {
            Self::File(path) => decode(&scene::host::read_regular(path).map_err(|e| e.to_string())?),
            Self::Embedded { bytes, .. } => decode(bytes),
            Self::Made { rgba, .. } => {
                let Size { width, height, .. } = self.size()?;
                image::RgbaImage::from_raw(width, height, rgba.to_vec())
                    .map(DynamicImage::ImageRgba8)
                    .ok_or_else(|| String::from("its size and its bytes disagree"))
            }
        }
    }
}

thread_local! {
    /// Depth of decoders that this thread runs, one within the other.
    static GUARDED: Cell<usize> = const { Cell::new(0) };
}

/// Returns true if a panic of this thread would be one of a decoder, which counts as a broken file and is reported as
/// an error: for panic hooks, which have nothing to tell then.
pub fn is_guarded() -> bool {
    GUARDED.get() > 0
}

/// Runs a decoder; a panic inside it counts as a broken file.
pub fn guard<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    GUARDED.set(GUARDED.get() + 1);
    let result = catch_unwind(AssertUnwindSafe(work));
    GUARDED.set(GUARDED.get() - 1);
    result.unwrap_or_else(|_| Err(String::from("its decoder gave up")))
}

/// Size of a picture.
#[derive(Clone, Copy)]
struct Size {
    /// Texels.
    width: u32,
    /// Texels.
    height: u32,
    /// Bytes when it is decoded.
    decoded: u64,
}

impl Size {
    /// Reads the header of an encoded picture of so many bytes, and refuses what is too large.
    fn of(encoded: Box<dyn Encoded + '_>, bytes: u64) -> Result<Self, String> {
        let decoder = reader(encoded, bytes)?.into_decoder().map_err(|e| e.to_string())?;
        let (width, height) = decoder.dimensions();
        if width == 0 || height == 0 || width > SIDE_LIMIT || height > SIDE_LIMIT {
            return Err(format!("its size is {width} x {height}, 1 to {SIDE_LIMIT} can be read"));
        }
        let decoded = decoder.total_bytes();
        let most = most_decoded(bytes);
        if decoded > most {
            return Err(format!(
                "its {width} x {height} texels take {} MB, and {bytes} bytes of a file may stand for {} MB; give a \
                 smaller picture",
                decoded.div_ceil(1 << 20),
                most >> 20
            ));
        }
        Ok(Self { width, height, decoded })
    }
}

/// Bytes that so many encoded ones may become.
fn most_decoded(bytes: u64) -> u64 {
    DECODED_BYTES.saturating_add(bytes.saturating_mul(DECODED_A_BYTE))
}

/// Reader of an encoded picture: one type of all, for each has every decoder compiled for it anew.
trait Encoded: BufRead + Seek {}

impl<T: BufRead + Seek> Encoded for T {}

fn reader(encoded: Box<dyn Encoded + '_>, bytes: u64) -> Result<ImageReader<Box<dyn Encoded + '_>>, String> {
    let mut reader = ImageReader::new(encoded).with_guessed_format().map_err(|e| e.to_string())?;
    if let Some(format) = reader.format().filter(|format| !format.reading_enabled()) {
        let ending = format.extensions_str().first().copied().unwrap_or("this format");
        return Err(format!("pictures in {ending} are not read by this build; save it as PNG"));
    }
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(SIDE_LIMIT);
    limits.max_image_height = Some(SIDE_LIMIT);
    // The picture, and what the decoder needs beside it.
    limits.max_alloc = Some(most_decoded(bytes).saturating_mul(2));
    reader.limits(limits);
    Ok(reader)
}

/// An encoded picture decoded, whatever its format.
pub fn decode(bytes: &[u8]) -> Result<DynamicImage, String> {
    let length = bytes.len() as u64;
    guard(|| {
        Size::of(Box::new(Cursor::new(bytes)), length)?;
        reader(Box::new(Cursor::new(bytes)), length)?.decode().map_err(|e| e.to_string())
    })
}

/// Channel of a picture that serves as a mask; white is opaque.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MaskChannel {
    /// The alpha channel when it says anything, else the grey of the picture as it is stored (MTL).
    AlphaOrGrey,
    /// The alpha channel; a picture without one is opaque (glTF).
    Alpha,
}

/// Use of a picture; each use is a texture of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Use {
    /// Reflectance times a factor (bits of r, g, b); with the mask in alpha when the same file is both.
    Albedo { factor: [u32; 3], mask: Option<MaskChannel> },
    /// Alpha only.
    Mask(MaskChannel),
    /// Radiance: divided by the greatest value when that is above 1.
    Radiance,
    /// Numbers as they are stored.
    Numbers,
}

/// The texel buffer of a scene and which texture each material uses.
#[derive(Default)]
pub struct Packed {
    /// Pictures.
    pub textures: Vec<Texture>,
    /// Two words a texel.
    pub texels: Vec<u32>,
    /// Source of each picture.
    pub names: Vec<String>,
    /// SHA-256 of each picture's texels.
    pub hashes: Vec<[u8; 32]>,
    /// Textures of each material.
    pub slots: Vec<Slots>,
    /// Replacements made.
    pub warnings: Vec<String>,
}

/// Textures of a material, [`NONE`] where there is none or it could not be read.
#[derive(Clone, Copy, Debug)]
pub struct Slots {
    /// Reflectance.
    pub albedo: u32,
    /// Radiance.
    pub radiance: u32,
    /// Multiplies the material's radiance, for the texture was divided by it.
    pub radiance_scale: f32,
    /// Mask.
    pub mask: u32,
    /// Normals.
    pub normal: u32,
    /// Roughness and metalness.
    pub surface: u32,
}

impl Slots {
    /// No textures.
    pub const NONE: Self =
        Self { albedo: NONE, radiance: NONE, radiance_scale: 1.0, mask: NONE, normal: NONE, surface: NONE };
}

/// A texture for one use.
struct Made {
    texture: Texture,
    words: Vec<u32>,
    hash: [u8; 32],
    clamped: bool,
    scale: f32,
}

/// Reads every picture the materials use, in parallel, and packs the pyramids; the largest are halved until all fit
/// into `budget` bytes.
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
    let sizes: Vec<Result<Size, String>> = sources.par_iter().map(|(source, _)| source.size()).collect();

    let mut packed = Packed::default();
    let skips = plan(&sources, &sizes, budget, &mut packed.warnings);
    let make = |k: usize| -> Result<Vec<Made>, String> {
        let (source, uses) = &sources[k];
        sizes[k].clone()?;
        let picture = source.decode()?;
        Ok(uses.iter().map(|used| build_pyramid(&picture, *used, skips[k])).collect())
    };
    let made = batches(&sizes).into_iter().flat_map(|batch| batch.into_par_iter().map(make).collect::<Vec<_>>());

    let mut found: BTreeMap<(&Source, Use), (u32, bool, f32)> = BTreeMap::new();
    for ((source, uses), pyramids) in sources.iter().zip(made) {
        let pyramids = match pyramids {
            Ok(pyramids) => pyramids,
            Err(reason) => {
                packed.warnings.push(format!(
                    "texture {}: cannot be used ({reason}); mid-grey is used where it is a colour, no holes where it \
                     is a mask, an even surface where it is a finish",
                    source.name()
                ));
                continue;
            }
        };
        for (used, pyramid) in uses.iter().zip(pyramids) {
            found.insert((source, *used), (packed.textures.len() as u32, pyramid.clamped, pyramid.scale));
            packed.textures.push(Texture { offset: (packed.texels.len() / 2) as u32, ..pyramid.texture });
            packed.names.push(source.name());
            packed.hashes.push(pyramid.hash);
            match packed.texels.is_empty() {
                true => packed.texels = pyramid.words,
                false => packed.texels.extend_from_slice(&pyramid.words),
            }
        }
    }
    packed.slots = materials.iter().map(|material| slots_of(material, &found, &mut packed.warnings)).collect();
    packed
}

/// Textures of a material by source and use: number, whether texels were lowered, scale.
fn slots_of(
    material: &MaterialDraft,
    found: &BTreeMap<(&Source, Use), (u32, bool, f32)>,
    warnings: &mut Vec<String>,
) -> Slots {
    let mut slots = Slots::NONE;
    for (source, used, slot) in wanted(material) {
        let Some(&(texture, clamped, scale)) = found.get(&(source, used)) else { continue };
        match slot {
            Slot::Albedo => slots.albedo = texture,
            Slot::Mask => slots.mask = texture,
            Slot::Radiance => (slots.radiance, slots.radiance_scale) = (texture, scale),
            Slot::Normal => slots.normal = texture,
            Slot::Surface => slots.surface = texture,
        }
        if clamped && slot == Slot::Albedo {
            warnings.push(format!(
                "material {}: texels of {} above {ALBEDO_LIMIT} were lowered to it",
                material.name,
                source.name()
            ));
        }
    }
    slots
}

#[derive(Clone, Copy, PartialEq)]
enum Slot {
    Albedo,
    Mask,
    Radiance,
    Normal,
    Surface,
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
    if let Some(source) = &material.finish.normal_picture {
        wanted.push((source, Use::Numbers, Slot::Normal));
    }
    if let Some(source) = &material.finish.surface_picture {
        wanted.push((source, Use::Numbers, Slot::Surface));
    }
    wanted
}

/// Pictures that are decoded side by side: as many as together stay below a limit, one at least.
fn batches(sizes: &[Result<Size, String>]) -> Vec<Range<usize>> {
    let decoded = |size: &Result<Size, String>| size.as_ref().map_or(0, |size| size.decoded);
    let mut batches: Vec<Range<usize>> = Vec::new();
    let mut held = 0;
    for (k, size) in sizes.iter().enumerate() {
        held += decoded(size);
        match batches.last_mut() {
            Some(batch) if held <= DECODED_AT_ONCE => batch.end = k + 1,
            _ => {
                held = decoded(size);
                batches.push(k..k + 1);
            }
        }
    }
    batches
}

/// Number of levels of each source to leave out so that all pyramids fit.
fn plan(
    sources: &[(&Source, Vec<Use>)],
    sizes: &[Result<Size, String>],
    budget: usize,
    warnings: &mut Vec<String>,
) -> Vec<u32> {
    let mut skips = vec![0u32; sources.len()];
    let bytes = |k: usize, skip: u32| match &sizes[k] {
        Ok(Size { width, height, .. }) => {
            8 * sources[k].1.len() * Pyramid::texels(((width >> skip).max(1), (height >> skip).max(1)))
        }
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

/// The levels of a picture but for the first `skip`.
fn build_pyramid(picture: &DynamicImage, used: Use, skip: u32) -> Made {
    let mut rows = Rows::new(picture, used);
    let mut pyramid = Pyramid::new((picture.width(), picture.height()), skip);
    for y in 0..picture.height() {
        pyramid.push(rows.row(y));
    }
    let (texture, words) = pyramid.finish();
    let hash = Sha256::digest(bytemuck::cast_slice::<u32, u8>(&words)).into();
    Made { texture, words, hash, clamped: rows.clamped, scale: rows.scale }
}

/// The linear texels of a picture for a use, row by row.
struct Rows<'a> {
    picture: &'a DynamicImage,
    used: Use,
    /// Linear values of the 256 of 8 bits.
    linear: Vec<f32>,
    /// Source of the mask.
    mask: Mask,
    /// Divisor of the radiance.
    scale: f32,
    /// True if any reflectance was lowered so far.
    clamped: bool,
}

/// Source of a picture's mask.
#[derive(Clone, Copy, PartialEq)]
enum Mask {
    Opaque,
    Alpha,
    Grey,
}

impl<'a> Rows<'a> {
    fn new(picture: &'a DynamicImage, used: Use) -> Self {
        let value = |k: i32| k as f32 / 255.0;
        let linear = (0..256).map(|k| if used == Use::Numbers { value(k) } else { decode_srgb(value(k)) }).collect();
        let mut rows = Self { picture, used, linear, mask: Mask::Opaque, scale: 1.0, clamped: false };
        if let Use::Mask(channel) | Use::Albedo { mask: Some(channel), .. } = used {
            rows.mask = rows.find_mask(channel);
        }
        if used == Use::Radiance {
            let row_maximum =
                |y| colours(&rows.at(y), &rows.linear).iter().map(|t| t.truncate().max_element()).fold(0.0, f32::max);
            let greatest = (0..picture.height()).map(row_maximum).fold(0.0, f32::max);
            if greatest > 1.0 && greatest.is_finite() {
                rows.scale = greatest;
            }
        }
        rows
    }

    fn find_mask(&self, channel: MaskChannel) -> Mask {
        let has_alpha = self.picture.color().has_alpha();
        let is_used = |y| self.at(y).to_rgba8().as_raw().chunks_exact(4).any(|c| c[3] < 255);
        match channel {
            MaskChannel::Alpha if has_alpha => Mask::Alpha,
            MaskChannel::Alpha => Mask::Opaque,
            MaskChannel::AlphaOrGrey if has_alpha && (0..self.picture.height()).any(is_used) => Mask::Alpha,
            MaskChannel::AlphaOrGrey => Mask::Grey,
        }
    }

    /// A row as a picture.
    fn at(&self, y: u32) -> DynamicImage {
        self.picture.crop_imm(0, y, self.picture.width(), 1)
    }

    /// Linear texels of a row.
    fn row(&mut self, y: u32) -> Vec<Vec4> {
        let row = self.at(y);
        let mut texels = match self.used {
            Use::Mask(_) => vec![Vec4::splat(0.5); row.width() as usize],
            // No more than 8 bits of what is no colour.
            Use::Numbers => colours(&DynamicImage::ImageRgba8(row.to_rgba8()), &self.linear),
            _ => colours(&row, &self.linear),
        };
        match self.used {
            Use::Albedo { factor, .. } => {
                let factor = Vec3::from_array(factor.map(f32::from_bits)).extend(1.0);
                for t in &mut texels {
                    let c = *t * factor;
                    let low = c.min(Vec4::new(ALBEDO_LIMIT, ALBEDO_LIMIT, ALBEDO_LIMIT, 1.0)).max(Vec4::ZERO);
                    self.clamped |= low.truncate() != c.truncate();
                    *t = low;
                }
            }
            Use::Radiance => texels.iter_mut().for_each(|t| *t /= self.scale),
            Use::Mask(_) | Use::Numbers => {}
        }
        match self.mask {
            Mask::Opaque => texels.iter_mut().for_each(|t| t.w = 1.0),
            Mask::Alpha => {
                let rgba = row.to_rgba8();
                let alpha = rgba.as_raw().chunks_exact(4);
                texels.iter_mut().zip(alpha).for_each(|(t, c)| t.w = f32::from(c[3]) / 255.0);
            }
            Mask::Grey => {
                let grey = row.to_luma8();
                texels.iter_mut().zip(grey.as_raw()).for_each(|(t, c)| t.w = f32::from(*c) / 255.0);
            }
        }
        texels
    }
}

/// Linear colours: 8 and 16 bits a channel are sRGB, floats are linear already (not finite: 0).
fn colours(picture: &DynamicImage, linear: &[f32]) -> Vec<Vec4> {
    use DynamicImage as D;
    match picture {
        D::ImageLuma8(_) | D::ImageLumaA8(_) | D::ImageRgb8(_) | D::ImageRgba8(_) => {
            let decode = |c: &[u8]| Vec4::new(linear[c[0] as usize], linear[c[1] as usize], linear[c[2] as usize], 1.0);
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

/// A sky: linear texels row by row from the top, width, height; larger ones are halved until they fit into `budget`
/// bytes.
pub fn read_sky(path: &Path, budget: usize, warnings: &mut Vec<String>) -> Result<(Vec<Vec4>, u32, u32), String> {
    let picture = decode(&scene::host::read_regular(path).map_err(|e| e.to_string())?)?;
    if !matches!(picture, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) {
        warnings
            .push(format!("sky {}: has no high dynamic range; its sRGB values are used as radiance", path.display()));
    }
    let rows = Rows::new(&picture, Use::Mask(MaskChannel::Alpha));
    let is_radiance = |c: &[f32]| c.iter().all(|x| x.is_finite() && *x >= 0.0);
    if !(0..picture.height()).all(|y| is_radiance(rows.at(y).to_rgb32f().as_raw())) {
        warnings.push(format!("sky {}: values that are negative or not finite count as 0", path.display()));
    }
    let mut size = (picture.width(), picture.height());
    let mut halvers = Vec::new();
    while 16 * size.0 as usize * size.1 as usize > budget && size != (1, 1) {
        halvers.push(Halver::new(size));
        size = half(size);
    }
    let mut texels = Vec::with_capacity(size.0 as usize * size.1 as usize);
    for y in 0..picture.height() {
        let row = Some(colours(&rows.at(y), &rows.linear));
        texels.extend(halvers.iter_mut().fold(row, |row, halver| halver.push(row?)).into_iter().flatten());
    }
    let brightest = texels.iter().map(|t: &Vec4| t.max_element()).fold(0.0, f32::max);
    if brightest > QUANTITY_LIMIT {
        texels.iter_mut().for_each(|t| *t = t.min(Vec4::splat(QUANTITY_LIMIT)));
        warnings.push(format!("sky {}: radiance above {QUANTITY_LIMIT:e} was lowered to it", path.display()));
    }
    if !halvers.is_empty() {
        warnings.push(format!(
            "sky {}: halved {} time(s) to {} x {} so that it fits into {} MiB",
            path.display(),
            halvers.len(),
            size.0,
            size.1,
            budget >> 20
        ));
    }
    Ok((texels, size.0, size.1))
}
