//! Damaged files of every format that is read: seeded, so that each can be made again from its number.
//!
//! A mutant is one of the sound files of [`Corpus`] with up to four changes: bits flipped, bytes cut, doubled, spliced
//! from another file, numbers made huge, negative or no numbers, counts and indices changed, brackets nested, headers
//! made to promise gigabytes. Where a format has checksums, every other mutant has them made right again, so that what
//! is behind them is reached.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use assets::import::{LoadOptions, LoadedScene, load_with};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::{DynamicImage, ImageFormat};
use localmatrix::{BakeFile, Part, beginning_of, join};
use multibounce::BlockCodec;
use patches::PatchKind;
use patchlight::file::{BakeKind, kind_of};
use patchlight::low_level::operator::{Build, Codec};
use patchlight::world::{Extra, WorldSettings, bake, scene_of};
use patchlight::{Bake, BakeSettings, Estimator, FileSettings, MethodSettings, Origin, Silent};
use runtime::cpu::Cpu;
use scene::host::memory::{peak_memory_bytes, resident_bytes};
use scene::sampling::hash3;

use crate::glb::glb;

/// Longest time that a file may take.
pub const MAX_TIME: Duration = Duration::from_secs(5);
/// Bytes of memory that a file may take, for each of its own.
pub const MEMORY_A_BYTE: u64 = 4;
/// And beside that.
pub const MEMORY: u64 = 256 << 20;
/// Options of loaders, for triangles and for texels.
const OPTIONS: LoadOptions = LoadOptions { texel_budget: 32 << 20, memory_limit: Some(160 << 20) };
/// Greatest size to which a mutant grows.
const MAX_BYTES: usize = 1 << 20;

const OBJ: &str = "mtllib a.mtl\nmtllib b.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 1 1\nvt 0 0\nvt 1 0\nvt 1 1\n\
                   vn 0 0 1\no wall\nusemtl m\nf 1/1 2/2 3/3\nf 1/1/1 3/3/1 4\ng roof\nusemtl n\nf -1 -2 -3 -4\nl 1 2\np 3\n";
const MTL: &str = "newmtl m\nKd 0.5 0.25 0.125\nKe 1 1 1\nmap_Kd t.png\nmap_d -s 1 1 1 t.png\nNs 10\nillum 2\n\n\
                   newmtl n\nKd 0.9\nTr 0.25\nmap_Ke t.jpg\n\nnewmtl g\nKs 0.5 0.6 0.7\nTf 1 1 0.9\nNi 1.4\nillum 7\n";
const TOML: &str = "version = 1\nmesh = \"a.obj\"\nmetres_per_unit = 0.5\nexposure_stops = 1.5\n\n\
                    [camera]\neye = [0, 0, 3]\ntarget = [0.0, 0.0, 0.0]\nup = [0, 1, 0]\nvertical_fov_degrees = 40\n\n\
                    [sky]\nradiance = [1, 1, 1]\nmap = \"sky.hdr\"\n\n\
                    [[material]]\nname = \"n\"\nmirror = [0.04, 0.03, 0.02]\nindex_of_refraction = 1.4\npane = true\n\n\
                    [[light]]\ntype = \"directional\"\ndirection = [0.0, -1.0, 0.0]\nirradiance = [1.0, 1.0, 1.0]\n\n\
                    [[light]]\ntype = \"spot\"\nposition = [0, 2, 0]\ndirection = [0, -1, 0]\nintensity = [5, 5, 5]\n\
                    inner_degrees = 20\nouter_degrees = 30\n\n\
                    [[light]]\ntype = \"rect\"\ncorner = [0, 2, 0]\nedge_a = [1, 0, 0]\nedge_b = [0, 0, 1]\n\
                    radiance = [2, 2, 2]\n\n\
                    [[animation]]\ntarget = \"light\"\nindex = 1\nproperty = \"position\"\n\
                    keyframes = [{ time = 0, value = [0, 2, 0] }, { time = 1.5, value = [1, 2, 0] }]\n";

const IES: &[u8] = include_bytes!("../../examples/luminaires/downlight.ies");
const LDT: &[u8] = include_bytes!("../../examples/luminaires/batwing.ldt");
const LAMP: &str = "version = 1\nmesh = \"a.obj\"\n\n[[light]]\ntype = \"luminaire\"\nfile = \"lamp.ies\"\nposition = [0, 2, 0]\n\
                    direction = [0, -1, 0.5]\nc0 = [1, 0, 0]\ntemperature = 3000\nflux = 800\nlamp_set = 1\n";

/// Bytes that mean something in texts.
const SIGNS: &[u8] = b"0-9/ \n.e\"[]{}n\xff\0,:\r\\";

/// The JSON of a glTF file: two nodes that show one mesh, a camera, a light, a material with a picture in a buffer
/// view.
const GLTF: &str = r#"{"asset":{"version":"2.0"},"extensionsUsed":["KHR_lights_punctual"],"scene":0,
"scenes":[{"nodes":[0,2,3]}],
"nodes":[{"mesh":0,"name":"leaf","children":[1]},{"mesh":0,"translation":[0,1,0],"scale":[1,2,1]},
{"camera":0,"rotation":[0,0,0,1]},{"extensions":{"KHR_lights_punctual":{"light":0}}}],
"extensions":{"KHR_lights_punctual":{"lights":[{"type":"spot","intensity":3,"spot":{"outerConeAngle":0.5}}]}},
"cameras":[{"type":"perspective","perspective":{"yfov":0.8,"znear":0.1}}],
"materials":[{"pbrMetallicRoughness":{"baseColorFactor":[1,0.5,0.5,0.5],"baseColorTexture":{"index":0}},
"emissiveFactor":[0.1,0,0],"alphaMode":"MASK","alphaCutoff":0.3}],
"textures":[{"source":0}],"images":[{"bufferView":2,"mimeType":"image/png"}],
"meshes":[{"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":2},"indices":1,"material":0},
{"attributes":{"POSITION":0},"mode":5}]}],
"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]},
{"bufferView":1,"componentType":5125,"count":3,"type":"SCALAR"},
{"bufferView":0,"componentType":5126,"count":3,"type":"VEC2"}],
"bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":12},
{"buffer":0,"byteOffset":48,"byteLength":PICTURE}],
"buffers":[{"byteLength":TOTALURI}]}"#;

/// A file of a format, and the file that is opened to read it.
struct Sound {
    name: &'static str,
    opened: &'static str,
    bytes: Vec<u8>,
}

/// Sound files of every format, in a folder of their own.
pub struct Corpus {
    folder: tempfile::TempDir,
    files: Vec<Sound>,
}

/// Result of reading a damaged file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It was read.
    Read,
    /// It was refused with this message.
    Refused(String),
    /// It made the reader panic, hang or take too much memory.
    Fault(String),
}

/// Numbers out of one seed.
struct Random {
    seed: u32,
    next: u32,
}

impl Random {
    fn word(&mut self) -> u32 {
        self.next += 1;
        hash3(self.seed, self.next, 0x6d75_7461)
    }

    fn below(&mut self, count: usize) -> usize {
        self.word() as usize % count.max(1)
    }

    fn one<'a, T: ?Sized>(&mut self, of: &[&'a T]) -> &'a T {
        of[self.below(of.len())]
    }
}

fn picture(format: ImageFormat) -> Vec<u8> {
    let rgba =
        image::RgbaImage::from_fn(12, 9, |x, y| image::Rgba([(x * 20) as u8, (y * 25) as u8, 90, (x * y) as u8]));
    let rgba = DynamicImage::ImageRgba8(rgba);
    let picture = match format {
        ImageFormat::Png | ImageFormat::WebP | ImageFormat::Tga => rgba,
        ImageFormat::Hdr | ImageFormat::OpenExr => DynamicImage::ImageRgb32F(rgba.to_rgb32f()),
        _ => DynamicImage::ImageRgb8(rgba.to_rgb8()),
    };
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).expect("a picture in memory");
    bytes.into_inner()
}

fn gltf(is_binary: bool) -> Vec<u8> {
    let png = picture(ImageFormat::Png);
    let numbers = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut binary: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
    binary.extend([0u32, 1, 2].iter().flat_map(|x| x.to_le_bytes()));
    binary.extend(&png);
    binary.resize(binary.len().next_multiple_of(4), 0);
    let uri = match is_binary {
        true => String::new(),
        false => format!(r#","uri":"data:application/octet-stream;base64,{}""#, STANDARD.encode(&binary)),
    };
    let json = GLTF.replace("PICTURE", &png.len().to_string()).replace("TOTAL", &binary.len().to_string());
    let json = json.replace("URI", &uri);
    if !is_binary {
        return json.into_bytes();
    }
    glb(&json, &binary)
}

impl Corpus {
    /// Makes the sound files.
    ///
    /// # Panics
    /// Where no file can be written: nothing can be tested then.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let cornell = assets::load_or_build("cornell").expect("a built-in scene");
        let settings =
            WorldSettings { scene: String::from("cornell"), voxel_size: Some(0.5), patch_count: 0, rays: 16, seed: 0 };
        let baked = |part: Option<Part>| {
            let path = folder.path().join("made.bake");
            bake(&cornell.scene, cornell.content_hash, &settings, part, &path, 8 << 30, &Silent).expect("a bake");
            std::fs::read(path).expect("a bake")
        };
        let whole = baked(None);
        let part = baked(Some(Part { number: 1, of: 1 }));
        let scene = bake_scene(&cornell, &folder.path().join("scene.bake"));
        let text = |text: &str| text.as_bytes().to_vec();
        let file = |name, opened, bytes| Sound { name, opened, bytes };
        let files = vec![
            file("a.obj", "a.obj", text(OBJ)),
            file("a.mtl", "a.obj", text(MTL)),
            file("s.toml", "s.toml", text(TOML)),
            file("a.glb", "a.glb", gltf(true)),
            file("a.gltf", "a.gltf", gltf(false)),
            file("t.png", "a.obj", picture(ImageFormat::Png)),
            file("t.jpg", "a.obj", picture(ImageFormat::Jpeg)),
            file("sky.hdr", "s.toml", picture(ImageFormat::Hdr)),
            file("sky.exr", "exr.toml", picture(ImageFormat::OpenExr)),
            file("t.bmp", "bmp.obj", picture(ImageFormat::Bmp)),
            file("t.tga", "tga.obj", picture(ImageFormat::Tga)),
            file("t.tiff", "tiff.obj", picture(ImageFormat::Tiff)),
            file("t.webp", "webp.obj", picture(ImageFormat::WebP)),
            file("lamp.toml", "lamp.toml", text(LAMP)),
            file("lamp.ies", "lamp.toml", IES.to_vec()),
            file("lamp.ldt", "ldt.toml", LDT.to_vec()),
            file("whole.bake", "whole.bake", whole),
            file("part.bake", "part.bake", part),
            file("scene.bake", "scene.bake", scene),
        ];
        let corpus = Self { folder, files };
        corpus.files.iter().for_each(|file| corpus.write(file.name, &file.bytes));
        corpus.write("b.mtl", b"newmtl o\nKd 1 1 1\n");
        for ending in ["bmp", "tga", "tiff", "webp"] {
            let mtl = format!("newmtl m\nmap_Kd t.{ending}\nnewmtl n\nmap_d t.{ending}\n");
            corpus.write(&format!("{ending}.mtl"), mtl.as_bytes());
            corpus.write(&format!("{ending}.obj"), OBJ.replace("a.mtl", &format!("{ending}.mtl")).as_bytes());
        }
        corpus.write("ldt.toml", LAMP.replace("lamp.ies", "lamp.ldt").as_bytes());
        corpus.write("exr.toml", TOML.replace("sky.hdr", "sky.exr").as_bytes());
        corpus
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.folder.path().join(name), bytes).expect("a temporary file");
    }

    /// Names of the formats' files.
    pub fn names(&self) -> Vec<&'static str> {
        self.files.iter().map(|file| file.name).collect()
    }

    /// Name and bytes of a mutant.
    pub fn mutant(&self, number: u32) -> (&'static str, Vec<u8>) {
        let mut random = Random { seed: number, next: 0 };
        let sound = &self.files[number as usize % self.files.len()];
        let mut bytes = sound.bytes.clone();
        for _ in 0..1 + random.below(4) {
            self.change(&mut bytes, &mut random);
        }
        if random.below(2) == 0 {
            match sound.name.rsplit('.').next() {
                Some("png") => sign_png(&mut bytes),
                Some("bake") if kind_of(&bytes) == Some(BakeKind::Scene) => sign_sections(&mut bytes),
                Some("bake") => sign_bake(&mut bytes),
                _ => {}
            }
        }
        (sound.name, bytes)
    }

    /// Reads a sound file, damaged or not.
    ///
    /// # Panics
    /// As [`Corpus::new`].
    pub fn read(&self, name: &str, bytes: &[u8]) -> Outcome {
        let Some(sound) = self.files.iter().find(|file| file.name == name) else {
            return Outcome::Refused(format!("{name} is none of the corpus"));
        };
        self.write(name, bytes);
        let path = self.folder.path().join(sound.opened);
        let before = reset_peak();
        let start = Instant::now();
        let result = catch_unwind(AssertUnwindSafe(|| open(&path)));
        let time = start.elapsed();
        let taken = before.and_then(|before| peak_memory_bytes()?.checked_sub(before)).unwrap_or(0);
        self.write(name, &sound.bytes);
        let most = MEMORY + MEMORY_A_BYTE * bytes.len() as u64;
        match result {
            Err(_) => Outcome::Fault(String::from("it panics")),
            Ok(_) if time > MAX_TIME => Outcome::Fault(format!("it takes {:.1} s", time.as_secs_f64())),
            Ok(_) if taken > most => Outcome::Fault(format!("it takes {} MB of memory", taken >> 20)),
            Ok(Ok(())) => Outcome::Read,
            Ok(Err(message)) => Outcome::Refused(message),
        }
    }

    /// Reads a sound file as it is.
    ///
    /// # Panics
    /// As [`Corpus::new`].
    pub fn read_sound(&self, name: &str) -> Outcome {
        match self.files.iter().find(|file| file.name == name) {
            Some(file) => self.read(name, &file.bytes),
            None => self.read(name, &[]),
        }
    }

    fn change(&self, bytes: &mut Vec<u8>, random: &mut Random) {
        if bytes.is_empty() {
            return;
        }
        let at = random.below(bytes.len());
        match random.below(14) {
            0 => bytes[at] = random.word() as u8,
            1 => bytes[at] ^= 1 << random.below(8),
            2 => bytes[at] = SIGNS[random.below(SIGNS.len())],
            3 => {
                bytes.remove(at);
            }
            4 => bytes.truncate(at),
            5 => {
                let end = (at + 1 + random.below(64)).min(bytes.len());
                bytes.drain(at..end);
            }
            // Doubled, a few times or many.
            6 => {
                let end = (at + 1 + random.below(64)).min(bytes.len());
                let part = bytes[at..end].to_vec();
                let most = MAX_BYTES.saturating_sub(bytes.len()) / part.len();
                let times = if random.below(8) == 0 { 1 << random.below(14) } else { 1 };
                bytes.splice(at..at, part.repeat(times.min(most)));
            }
            // A piece of another file.
            7 => {
                let other = &self.files[random.below(self.files.len())].bytes;
                let from = random.below(other.len());
                let end = (from + 1 + random.below(256)).min(other.len());
                bytes.splice(at..at, other[from..end].iter().copied());
            }
            // Nested.
            8 => {
                let open = random.one(&["[", "{\"a\":", "(", "[[", "{\"children\":["]);
                bytes.splice(at..at, open.repeat(1 << random.below(14)).into_bytes());
            }
            9 | 10 => change_word(bytes, at, random),
            _ => change_number(bytes, at, random),
        }
    }
}

impl Default for Corpus {
    fn default() -> Self {
        Self::new()
    }
}

/// Writes a number of four bytes that is likely to be wrong where it lands.
fn change_word(bytes: &mut [u8], at: usize, random: &mut Random) {
    let at = if random.below(2) == 0 { at & !3 } else { at };
    let Some(place) = bytes.get_mut(at..at + 4) else { return };
    let words = [
        0,
        1,
        2,
        u32::MAX,
        u32::MAX - 1,
        1 << 31,
        (1 << 31) - 1,
        16_384,
        65_535,
        65_536,
        1 << 20,
        1 << 28,
        f32::NAN.to_bits(),
        f32::INFINITY.to_bits(),
        1e38f32.to_bits(),
        (-1e38f32).to_bits(),
        1e-40f32.to_bits(),
        random.word(),
    ];
    let word = words[random.below(words.len())];
    place.copy_from_slice(&if random.below(2) == 0 { word.to_le_bytes() } else { word.to_be_bytes() });
}

/// Replaces the next number of a text by one that is likely to be wrong.
fn change_number(bytes: &mut Vec<u8>, at: usize, random: &mut Random) {
    let is_digit = |b: &u8| b.is_ascii_digit() || b"+-.eE".contains(b);
    let Some(start) = bytes[at..].iter().position(u8::is_ascii_digit).map(|k| at + k) else { return };
    let end = bytes[start..].iter().position(|b| !is_digit(b)).map_or(bytes.len(), |k| start + k);
    let numbers = [
        "0",
        "-0",
        "1",
        "-1",
        "2",
        "3",
        "7",
        "nan",
        "inf",
        "-inf",
        "1e38",
        "-1e38",
        "1e39",
        "1e-45",
        "1e999",
        "0.5",
        "1e9",
        "1e15",
        "255",
        "256",
        "65535",
        "65536",
        "1000000",
        "16777217",
        "2147483647",
        "2147483648",
        "4294967295",
        "4294967296",
        "-2147483648",
        "9223372036854775807",
        "9223372036854775808",
        "-9223372036854775808",
        "18446744073709551616",
        "99999999999999999999999999",
        "0x10",
        "1_000",
        "",
    ];
    bytes.splice(start..end, random.one(&numbers).bytes());
}

/// Makes the checksums of a PNG's chunks right.
fn sign_png(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(head) = bytes.get(at..at + 4) {
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
        let Some(end) = at.checked_add(8).and_then(|start| start.checked_add(length)) else { return };
        let Some(sum) = bytes.get(at + 4..end).map(crc32fast::hash) else { return };
        let Some(place) = bytes.get_mut(end..end + 4) else { return };
        place.copy_from_slice(&sum.to_be_bytes());
        at = end + 4;
    }
}

/// The bake of a scene with operators of every kind of tables.
fn bake_scene(loaded: &LoadedScene, path: &Path) -> Vec<u8> {
    let bake = BakeSettings::default()
        .with_patches(PatchKind::Voxel)
        .with_patch_count(40)
        .with_receiver_edge(Some(0.4))
        .with_receiver_rays(16)
        .with_estimator(Estimator::Hemisphere { rays: 16 });
    let codecs = [Codec::Dense, Codec::Half, Codec::Blocks(BlockCodec::Bc1), Codec::LowRank { epsilon: 0.1 }];
    let settings = FileSettings {
        origin: Origin {
            scene: String::from("cornell"),
            scene_hash: loaded.content_hash,
            application: loaded.description().into_bytes(),
        },
        bake,
        methods: codecs.map(MethodSettings::Multibounce).to_vec(),
        build: Build::default(),
    };
    Bake::build_into(path, &loaded.scene, &settings, &mut Cpu::new(), &Silent).expect("a bake");
    std::fs::read(path).expect("a bake")
}

/// Makes the checksums of the header and the sections of a scene's bake right, as far as they are where the headers
/// say.
fn sign_sections(bytes: &mut [u8]) {
    const HEADER: usize = 56;
    const SECTION: usize = 24;
    let put = |bytes: &mut [u8], at: usize, sum: u32| {
        if let Some(place) = bytes.get_mut(at..at + 4) {
            place.copy_from_slice(&sum.to_le_bytes());
        }
    };
    let Some(sum) = bytes.get(..HEADER - 4).map(crc32fast::hash) else { return };
    put(bytes, HEADER - 4, sum);
    let mut at = HEADER;
    while let Some(head) = bytes.get(at..at + SECTION).filter(|head| head.starts_with(b"PART")) {
        let length = u64::from_le_bytes(head[8..16].try_into().unwrap_or([0; 8]));
        let Some(end) = (at + SECTION).checked_add(length as usize) else { return };
        let Some(sum) = bytes.get(at + SECTION..end).map(crc32fast::hash) else { return };
        put(bytes, at + 16, sum);
        let Some(sum) = bytes.get(at..at + 20).map(crc32fast::hash) else { return };
        put(bytes, at + 20, sum);
        at = end;
    }
}

/// Makes the checksums of a bake's header, world, blocks and table right, as far as they are where the header says.
fn sign_bake(bytes: &mut [u8]) {
    const HEADER: usize = 120;
    let long =
        |bytes: &[u8], at: usize| bytes.get(at..at + 8).map(|b| u64::from_le_bytes(b.try_into().unwrap_or([0; 8])));
    let word =
        |bytes: &[u8], at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes(b.try_into().unwrap_or([0; 4])));
    let put = |bytes: &mut [u8], at: usize, sum: u32| {
        if let Some(place) = bytes.get_mut(at..at + 4) {
            place.copy_from_slice(&sum.to_le_bytes());
        }
    };
    let Some(world) = long(bytes, 104) else { return };
    let end = HEADER.saturating_add(world as usize);
    if let Some(sum) = bytes.get(HEADER..end).map(crc32fast::hash) {
        put(bytes, 112, sum);
    }
    if let Some(sum) = bytes.get(..HEADER - 4).map(crc32fast::hash) {
        put(bytes, HEADER - 4, sum);
    }
    let mut at = end;
    while bytes.get(at..at.saturating_add(4)) == Some(b"ROWS") {
        let Some(length) = word(bytes, at + 16) else { return };
        let next = at + 24 + length as usize;
        let (Some(head), Some(rows)) = (bytes.get(at..at + 20), bytes.get(at + 24..next)) else { return };
        let sum = crc32fast::hash(&[head, rows].concat());
        put(bytes, at + 20, sum);
        at = next;
    }
    let Some(last) = bytes.len().checked_sub(20) else { return };
    if let Some(sum) = bytes.get(at..last).map(crc32fast::hash) {
        put(bytes, last + 8, sum);
    }
}

/// Reads a file as the program does.
fn open(path: &Path) -> Result<(), String> {
    if path.extension().is_none_or(|ending| ending != "bake") {
        return load_with(path, &OPTIONS).map(drop).map_err(|error| error.to_string());
    }
    let head = std::fs::read(path).unwrap_or_default();
    if kind_of(&head) == Some(BakeKind::Scene) {
        let bake = Bake::open(path).map_err(|error| error.to_string())?;
        let text = String::from_utf8(bake.origin.application).map_err(|error| error.to_string())?;
        return LoadedScene::of_description(bake.bake.scene().clone(), &text).map(drop);
    }
    let file = BakeFile::open(path).map_err(|error| error.to_string())?;
    let whole: PathBuf = path.with_file_name("joined.bake");
    if file.head.part.is_some() {
        // That of a part before would be gone on with.
        let _ = std::fs::remove_file(beginning_of(&whole));
        let mut writer = join(&whole, &[file], &mut |_, _| {}).map_err(|error| error.to_string())?;
        writer.add_parents(4, &mut |_, _| true).map_err(|error| error.to_string())?;
        return writer.finish().map_err(|error| error.to_string());
    }
    scene_of(&file).map_err(|error| error.to_string())?;
    Extra::decode(&file.extra).ok_or("the voxels of the bake are wrong")?;
    file.check().map_err(|error| error.to_string())
}

/// Begins to measure the greatest resident memory anew; what is resident now. Nothing where the system cannot.
fn reset_peak() -> Option<u64> {
    std::fs::write("/proc/self/clear_refs", "5").ok()?;
    resident_bytes()
}
