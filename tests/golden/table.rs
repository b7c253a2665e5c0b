//! The table of golden pictures: hashes by processor, scene, method and device.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::render::{FramePixels, Pixels};

/// Head of the file.
const HEAD: &str = "\
# Golden pictures: SHA-256 of the pixels of small pictures of every method. golden.rs renders and
# compares them.
#
# What is hashed: width and height as u32, then the bits of red, green and blue of each pixel as
# f32, all little endian; one hash a frame for the full picture and one for its indirect light.
# `file` is the hash of the bytes of a bake.
#
# The key is what the processor offers, because dense products sum in another order with wider
# vectors (AVX2 or AVX-512): a processor without a table is told so and skipped. Entries name the
# devices that give these very pixels; `lavapipe` says with which driver, another one is skipped.
#
# Written by `GOLDEN_WRITE=1 cargo test -p integration-tests --test golden`, which replaces the table
# of this processor alone. Only a commit that says why pictures change may do so.

";

/// Hashes of the frames of a method; of a bake, of its file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    pub scene: String,
    pub method: String,
    pub devices: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub full: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub indirect: Vec<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
}

/// The table of a processor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// Device and driver of the entries of lavapipe.
    pub lavapipe: String,
    #[serde(default)]
    pub pictures: Vec<Entry>,
}

impl Entry {
    /// The hashes of some frames.
    pub fn of_frames(scene: &str, method: &str, device: &str, frames: &[FramePixels]) -> Self {
        let indirect = frames.iter().filter_map(|frame| frame.indirect.as_ref());
        Self {
            scene: scene.to_owned(),
            method: method.to_owned(),
            devices: vec![device.to_owned()],
            full: frames.iter().map(|frame| pixel_hash(&frame.full)).collect(),
            indirect: indirect.map(pixel_hash).collect(),
            file: None,
        }
    }

    /// The hash of a bake.
    pub fn of_file(scene: &str, method: &str, device: &str, bytes: &[u8]) -> Self {
        Self {
            scene: scene.to_owned(),
            method: method.to_owned(),
            devices: vec![device.to_owned()],
            file: Some(hex(&Sha256::digest(bytes))),
            ..Self::default()
        }
    }

    fn is_of(&self, other: &Self) -> bool {
        (&self.scene, &self.method) == (&other.scene, &other.method)
    }

    fn has_hashes_of(&self, other: &Self) -> bool {
        (&self.full, &self.indirect, &self.file) == (&other.full, &other.indirect, &other.file)
    }
}

/// SHA-256 of size and bits.
pub fn pixel_hash(pixels: &Pixels) -> String {
    let mut hash = Sha256::new();
    hash.update(pixels.width.to_le_bytes());
    hash.update(pixels.height.to_le_bytes());
    for value in pixels.values.as_flattened() {
        hash.update(value.to_bits().to_le_bytes());
    }
    hex(&hash.finalize())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Puts entries of equal hashes together: one entry with all of their devices.
pub fn join_devices(entries: Vec<Entry>) -> Vec<Entry> {
    let mut joined: Vec<Entry> = Vec::new();
    for entry in entries {
        let is_same = |other: &&mut Entry| other.is_of(&entry) && other.has_hashes_of(&entry);
        let same = joined.iter_mut().find(is_same);
        match same {
            Some(same) => same.devices.extend(entry.devices),
            None => joined.push(entry),
        }
    }
    joined
}

/// A line for each entry of these devices that differs, is missing or is not expected.
pub fn differences(found: &[Entry], expected: &[Entry], devices: &[&str]) -> Vec<String> {
    let mut lines = Vec::new();
    for &device in devices {
        let found = of_device(found, device);
        let expected = of_device(expected, device);
        for entry in &found {
            let name = format!("{}, {}, {device}", entry.scene, entry.method);
            match expected.iter().find(|other| other.is_of(entry)) {
                None => lines.push(format!("{name}: the table has no such entry")),
                Some(other) if other.has_hashes_of(entry) => {}
                Some(other) => lines.push(format!("{name}: {}", first_difference(entry, other))),
            }
        }
        for entry in &expected {
            if !found.iter().any(|other| other.is_of(entry)) {
                lines.push(format!("{}, {}, {device}: not rendered", entry.scene, entry.method));
            }
        }
    }
    lines
}

fn of_device<'a>(entries: &'a [Entry], device: &str) -> Vec<&'a Entry> {
    entries.iter().filter(|entry| entry.devices.iter().any(|name| name == device)).collect()
}

/// First difference of the frames of an entry.
fn first_difference(found: &Entry, expected: &Entry) -> String {
    let mut parts = Vec::new();
    for (name, ours, theirs) in
        [("full", &found.full, &expected.full), ("indirect", &found.indirect, &expected.indirect)]
    {
        let frames = ours.len().max(theirs.len());
        if let Some(frame) = (0..frames).find(|&frame| ours.get(frame) != theirs.get(frame)) {
            parts.push(format!("{name} differs from frame {frame} of {frames} on"));
        }
    }
    if found.file != expected.file {
        parts.push("the bytes of the file differ".to_owned());
    }
    parts.join("; ")
}

/// The processor's features that decide the order of sums: the widest vectors that dense products use.
pub fn processor() -> String {
    #[cfg(target_arch = "x86_64")]
    {
        let has_v3 = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt");
        let has_v4 = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512cd")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl");
        let level = match (has_v3, has_v4) {
            (true, true) => "x86-64-v4",
            (true, false) => "x86-64-v3",
            (false, _) => "x86-64",
        };
        level.to_owned()
    }
    #[cfg(not(target_arch = "x86_64"))]
    std::env::consts::ARCH.to_owned()
}

fn file() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("golden").join("pictures.toml")
}

/// The tables of all processors.
pub fn read() -> BTreeMap<String, Table> {
    let text = match fs::read_to_string(file()) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return BTreeMap::new(),
        Err(error) => panic!("{}: {error}", file().display()),
    };
    toml::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", file().display()))
}

/// Replaces the table of a processor.
pub fn write(processor: &str, table: Table) {
    let mut tables = read();
    tables.insert(processor.to_owned(), table);
    let text = toml::to_string_pretty(&tables).unwrap();
    fs::write(file(), format!("{HEAD}{text}")).unwrap();
}
