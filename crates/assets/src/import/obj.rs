//! OBJ: a pass over the bytes that checks every index and keeps only what is used, then `tobj`.
//!
//! `tobj` neither says where a fault is nor bears all indices (its sums overflow), so the checking pass comes first. It
//! also joins continued lines, replaces bytes that are not UTF-8, and leaves out lines, points, vertex colours and
//! normals that are none.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::{Vec2, Vec3};

use super::draft::{FileTriangle, MaterialDraft, Mesh, check_count, packed_normal, seconds};
use super::{ImportError, LoadOptions, mtl, pictures};

/// First line of the text that `tobj` reads, which makes it ask for the materials: those of all libraries of the file,
/// once, wherever the file names them.
const MATERIALS: &[u8] = b"mtllib all\n";

/// Result of the checking pass.
#[derive(Default)]
struct Checked {
    text: Vec<u8>,
    libraries: Vec<String>,
    used_materials: BTreeSet<String>,
    triangles: usize,
}

/// Position of the checking pass.
struct Place<'a> {
    path: &'a Path,
    line: usize,
    object: String,
    face: usize,
}

impl Place<'_> {
    fn error(&self, reason: impl Into<String>) -> ImportError {
        ImportError::Obj {
            path: self.path.to_path_buf(),
            line: self.line,
            object: self.object.clone(),
            face: self.face + 1,
            reason: reason.into(),
        }
    }
}

/// Reads an OBJ file with its MTL files; textures are decoded while the text is parsed.
pub fn load(path: &Path, bytes: &[u8], options: &LoadOptions) -> Result<Mesh, ImportError> {
    let start = Instant::now();
    let checked = check(path, bytes, false)?;
    check_count(path, checked.triangles, options)?;
    let mut warnings = Vec::new();
    let mut materials: Vec<MaterialDraft> = Vec::new();
    let files = library_files(path, &checked.libraries);
    files.iter().for_each(|file| mtl::load(file, &mut materials, &mut warnings));
    // The last of several materials of one name counts.
    let by_name: BTreeMap<String, usize> = materials.iter().enumerate().map(|(k, m)| (m.name.clone(), k)).collect();
    for name in checked.used_materials.iter().filter(|name| !by_name.contains_key(*name)) {
        warnings.push(format!("{}: material {name} is not in any MTL file; mid-grey is used", path.display()));
    }
    let check_seconds = seconds(start);

    let start = Instant::now();
    let parse = || {
        let load_options =
            tobj::LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..Default::default() };
        let known: Vec<tobj::Material> =
            materials.iter().map(|m| tobj::Material { name: m.name.clone(), ..Default::default() }).collect();
        let names = by_name.iter().map(|(name, k)| (name.clone(), *k)).collect::<std::collections::HashMap<_, _>>();
        let result = pictures::guard(|| {
            let library = |_: &Path| Ok((known.clone(), names.clone().into_iter().collect()));
            tobj::load_obj_buf(&mut &checked.text[..], &load_options, library).map_err(|e| e.to_string())
        });
        result.map(|(models, _)| models).map(|models| gather(models, materials.len() as u32))
    };
    let (parsed, packed) = rayon::join(parse, || pictures::pack(&materials, options.texel_budget));
    let (triangles, objects, has_unnamed) = match parsed {
        Ok(parsed) => parsed,
        // tobj does not say where: the slow form of the check does.
        Err(reason) => {
            check(path, bytes, true)?;
            let place = Place { path, line: 1, object: String::from("(unknown)"), face: 0 };
            return Err(place.error(reason));
        }
    };
    if triangles.iter().any(|t| t.corners.iter().any(|c| !c.is_finite())) {
        check(path, bytes, true)?;
    }
    let mut packed = packed;
    if has_unnamed {
        // Its triangles come before any usemtl, or their material is missing.
        let grey = MaterialDraft::new("(none)");
        packed.slots.push(pictures::Slots::NONE);
        materials.push(grey);
    }
    let timings = vec![("check", check_seconds), ("parse and textures", seconds(start))];
    Ok(Mesh { triangles, objects, materials, warnings, files, packed: Some(packed), timings, ..Mesh::default() })
}

/// Material libraries that a file names.
fn library_files(path: &Path, libraries: &[String]) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for library in libraries {
        let whole = super::scene_file::beside(path, library);
        // One name with spaces, or several names.
        if whole.exists() || !library.contains(char::is_whitespace) {
            files.push(whole);
        } else {
            files.extend(library.split_whitespace().map(|name| super::scene_file::beside(path, name)));
        }
    }
    files
}

/// Triangles of all models, names of their objects, and whether any is without material (it gets the index `none`).
fn gather(models: Vec<tobj::Model>, none: u32) -> (Vec<FileTriangle>, Vec<String>, bool) {
    let mut triangles = Vec::with_capacity(models.iter().map(|m| m.mesh.indices.len() / 3).sum());
    let mut objects: Vec<String> = Vec::new();
    let mut has_unnamed = false;
    for model in &models {
        let m = &model.mesh;
        if m.indices.is_empty() {
            continue;
        }
        // A change of material splits an object into models of one name.
        if objects.last() != Some(&model.name) {
            objects.push(model.name.clone());
        }
        let object = objects.len() as u32 - 1;
        has_unnamed |= m.material_id.is_none();
        let material = m.material_id.map_or(none, |k| k as u32);
        let position = |k: u32| Vec3::from_slice(&m.positions[3 * k as usize..]);
        let has_uvs = m.texcoord_indices.len() == m.indices.len();
        let has_normals = m.normal_indices.len() == m.indices.len();
        for (corner, face) in m.indices.chunks_exact(3).enumerate() {
            let uv = |k: usize| {
                if has_uvs {
                    Vec2::from_slice(&m.texcoords[2 * m.texcoord_indices[3 * corner + k] as usize..])
                } else {
                    Vec2::ZERO
                }
            };
            let normal = |k: usize| match m.normal_indices.get(3 * corner + k) {
                Some(&index) if has_normals => packed_normal(Vec3::from_slice(&m.normals[3 * index as usize..])),
                _ => 0,
            };
            triangles.push(FileTriangle {
                corners: [position(face[0]), position(face[1]), position(face[2])],
                uvs: [uv(0), uv(1), uv(2)],
                normals: [normal(0), normal(1), normal(2)],
                material,
                object,
            });
        }
    }
    (triangles, objects, has_unnamed)
}

/// Checks all indices (and all numbers, when `numbers`), and keeps what tobj is to read.
fn check(path: &Path, bytes: &[u8], numbers: bool) -> Result<Checked, ImportError> {
    let mut checker = Checker::new(path, bytes.len(), numbers);
    let mut joined: Vec<u8> = Vec::new();
    let end = line_end(bytes);
    for raw in bytes.split(|b| *b == end) {
        checker.place.line += 1;
        let raw = raw.strip_suffix(b"\r").unwrap_or(raw);
        if let Some(part) = raw.strip_suffix(b"\\") {
            joined.extend_from_slice(part);
            joined.push(b' ');
        } else if joined.is_empty() {
            checker.line(raw)?;
        } else {
            joined.extend_from_slice(raw);
            checker.line(&std::mem::take(&mut joined))?;
        }
    }
    let Checker { mut place, positions, out, .. } = checker;
    if out.triangles == 0 {
        if let Some(reason) = looks_wrong(bytes, positions) {
            place.line = 1;
            return Err(place.error(reason));
        }
        return Err(ImportError::NoTriangles { path: path.to_path_buf() });
    }
    Ok(out)
}

/// The checking pass.
struct Checker<'a> {
    place: Place<'a>,
    /// Checks numbers, too.
    numbers: bool,
    /// Vertices, texture coordinates and normals so far.
    positions: i64,
    uvs: i64,
    normals: i64,
    /// Lines of vertices with a coordinate that is not finite.
    not_finite: BTreeMap<i64, usize>,
    /// Libraries so far: each is read once.
    named: BTreeSet<String>,
    out: Checked,
}

impl<'a> Checker<'a> {
    fn new(path: &'a Path, bytes: usize, numbers: bool) -> Self {
        let mut out = Checked { text: Vec::with_capacity(bytes + MATERIALS.len()), ..Checked::default() };
        out.text.extend_from_slice(MATERIALS);
        let place = Place { path, line: 0, object: String::from("unnamed_object"), face: 0 };
        Self {
            place,
            numbers,
            positions: 0,
            uvs: 0,
            normals: 0,
            not_finite: BTreeMap::new(),
            named: BTreeSet::new(),
            out,
        }
    }

    /// Checks a whole line.
    fn line(&mut self, line: &[u8]) -> Result<(), ImportError> {
        let line = line.trim_ascii();
        let (keyword, rest) = line.split_at(line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len()));
        match keyword {
            b"v" => self.vertex(rest)?,
            b"vt" => self.texture_coordinate(rest)?,
            b"vn" => self.normal(rest),
            b"f" => {
                let counts = (self.positions, self.uvs, self.normals);
                self.out.triangles += check_face(&self.place, rest, counts, &self.not_finite, &mut self.out.text)?;
                self.place.face += 1;
            }
            b"mtllib" => {
                let name = String::from_utf8_lossy(rest.trim_ascii()).into_owned();
                if self.named.insert(name.clone()) {
                    self.out.libraries.push(name);
                }
            }
            b"o" | b"g" | b"usemtl" => self.name(keyword, rest),
            _ => {}
        }
        Ok(())
    }

    fn vertex(&mut self, rest: &[u8]) -> Result<(), ImportError> {
        self.positions += 1;
        if self.numbers {
            check_numbers(&self.place, rest, 3)?;
            if !is_finite(rest) {
                self.not_finite.insert(self.positions, self.place.line);
            }
        }
        // Three coordinates and w; six numbers are a coordinate and a colour.
        let words = rest.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).count();
        keep(&mut self.out.text, b"v", rest, if words == 4 { 4 } else { 3 });
        Ok(())
    }

    fn texture_coordinate(&mut self, rest: &[u8]) -> Result<(), ImportError> {
        self.uvs += 1;
        if self.numbers {
            check_numbers(&self.place, rest, 1)?;
        }
        let text = &mut self.out.text;
        keep(text, b"vt", rest, 2);
        // A texture coordinate of one number has v = 0.
        if rest.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).count() == 1 {
            text.pop();
            text.extend_from_slice(b" 0\n");
        }
        Ok(())
    }

    /// A normal; one that is none becomes zero, which is no normal.
    fn normal(&mut self, rest: &[u8]) {
        self.normals += 1;
        let words: Vec<&[u8]> = rest.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).take(3).collect();
        let is_sound = words.len() == 3 && words.iter().all(|w| number(w).is_some_and(f32::is_finite));
        keep(&mut self.out.text, b"vn", if is_sound { rest } else { b"0 0 0" }, 3);
    }

    /// The name of what follows: an object, or the material of its faces.
    fn name(&mut self, keyword: &[u8], rest: &[u8]) {
        let name = String::from_utf8_lossy(rest.trim_ascii());
        if keyword == b"usemtl" {
            if name.is_empty() {
                return;
            }
            self.out.used_materials.insert(name.to_string());
        } else {
            self.place.object = if name.is_empty() { String::from("unnamed_object") } else { name.to_string() };
            self.place.face = 0;
        }
        for part in [keyword, b" ", name.as_bytes(), b"\n"] {
            self.out.text.extend_from_slice(part);
        }
    }
}

/// Line terminator of a text: a line feed, or a carriage return in files of old systems, which have no line feed.
pub fn line_end(text: &[u8]) -> u8 {
    if text.contains(&b'\n') { b'\n' } else { b'\r' }
}

fn looks_wrong(bytes: &[u8], positions: i64) -> Option<&'static str> {
    let binary = bytes.iter().take(4096).any(|b| *b == 0);
    if binary {
        Some("this is not an OBJ text")
    } else if positions == 0 {
        Some("there is neither a vertex nor a face (truncated, or not an OBJ text)")
    } else {
        None
    }
}

/// Copies a keyword and its first words.
fn keep(text: &mut Vec<u8>, keyword: &[u8], rest: &[u8], words: usize) {
    text.extend_from_slice(keyword);
    for word in rest.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).take(words) {
        text.push(b' ');
        // Bytes that are not ASCII are no number: the parser shall see one bad character, not broken UTF-8.
        text.extend(word.iter().map(|b| if b.is_ascii() { *b } else { b'?' }));
    }
    text.push(b'\n');
}

fn number(word: &[u8]) -> Option<f32> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

fn check_numbers(place: &Place, rest: &[u8], least: usize) -> Result<(), ImportError> {
    let words: Vec<&[u8]> = rest.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).collect();
    if words.len() < least {
        return Err(place.error(format!("{} number(s) where {least} are needed", words.len())));
    }
    for word in words.iter().take(4) {
        match number(word) {
            None => return Err(place.error(format!("\"{}\" is not a number", String::from_utf8_lossy(word)))),
            Some(0.0) if words.len() == 4 && least == 3 && std::ptr::eq(*word, words[3]) => {
                return Err(place.error("the fourth coordinate is 0"));
            }
            Some(_) => {}
        }
    }
    Ok(())
}

fn is_finite(rest: &[u8]) -> bool {
    let mut words = rest.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
    words.all(|w| number(w).is_some_and(f32::is_finite))
}

/// Checks a face's indices against what was read so far, copies it, returns its number of triangles.
fn check_face(
    place: &Place,
    rest: &[u8],
    (positions, uvs, normals): (i64, i64, i64),
    not_finite: &BTreeMap<i64, usize>,
    text: &mut Vec<u8>,
) -> Result<usize, ImportError> {
    text.push(b'f');
    let mut corners = 0;
    for word in rest.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()) {
        corners += 1;
        let mut parts = word.split(|b| *b == b'/');
        let bad = || place.error(format!("\"{}\" is not a corner of a face", String::from_utf8_lossy(word)));
        let v = index(parts.next().unwrap_or_default()).ok_or_else(bad)?;
        let v = resolve(v, positions).ok_or_else(|| {
            place.error(format!("vertex index {v} is out of range, {positions} vertices come before this line"))
        })?;
        if let Some(line) = not_finite.get(&v) {
            return Err(place.error(format!("vertex {v} (line {line}) has a coordinate that is not finite")));
        }
        text.push(b' ');
        write_index(text, v);
        let has_uv = match parts.next() {
            None | Some(b"") => false,
            Some(part) => {
                let vt = index(part).ok_or_else(bad)?;
                let vt = resolve(vt, uvs).ok_or_else(|| {
                    place.error(format!(
                        "texture index {vt} is out of range, {uvs} texture coordinates come before this line"
                    ))
                })?;
                text.push(b'/');
                write_index(text, vt);
                true
            }
        };
        // A normal that is not there is nothing to stop at.
        if let Some(vn) = parts.next().and_then(index).and_then(|vn| resolve(vn, normals)) {
            text.extend_from_slice(if has_uv { b"/" } else { b"//" });
            write_index(text, vn);
        }
    }
    text.push(b'\n');
    if corners < 3 {
        return Err(place.error(format!("{corners} corner(s) where 3 or more are needed")));
    }
    Ok(corners - 2)
}

/// A signed whole number of at most 18 digits.
fn index(word: &[u8]) -> Option<i64> {
    let (negative, digits) = match word {
        [b'-', digits @ ..] => (true, digits),
        digits => (false, digits),
    };
    if digits.is_empty() || digits.len() > 18 || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let value = digits.iter().fold(0i64, |x, d| 10 * x + i64::from(d - b'0'));
    Some(if negative { -value } else { value })
}

/// The index from 1 that a positive or relative one stands for.
fn resolve(index: i64, count: i64) -> Option<i64> {
    let index = if index < 0 { count + 1 + index } else { index };
    (1..=count).contains(&index).then_some(index)
}

fn write_index(text: &mut Vec<u8>, index: i64) {
    let mut digits = [0u8; 20];
    let mut at = 20;
    let mut rest = index;
    while rest > 0 {
        at -= 1;
        digits[at] = b'0' + (rest % 10) as u8;
        rest /= 10;
    }
    text.extend_from_slice(&digits[at..]);
}
