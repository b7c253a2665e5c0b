//! A probe volume as files: a description in JSON, its tables in binary, and ambient cubes as a 3D texture (KTX2).

use bytemuck::{Pod, Zeroable as _};
use glam::{Vec3, Vec4};
use half::f16;
use patches::kernel::volume::{CUBE_SIDES, PLANE_WORDS, SH_COEFFICIENTS, volume_lookup, volume_lookup_sh};
use patches::{EMPTY_CELL, GridShape, VolumeParams, VoxelVolume};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Reason};

/// Format name in the description.
const FORMAT: &str = "patchlight probes";
/// Its version.
const VERSION: u32 = 1;

/// Probes on a regular grid with their light. `cubes` are irradiance, W/m², for the normals +x, −x, +y, −y, +z, −z of
/// each.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbeVolume {
    params: VolumeParams,
    probes: Vec<u32>,
    planes: Vec<f32>,
    cubes: Vec<Vec4>,
    harmonics: Vec<Vec4>,
}

/// The description of a volume's tables.
#[derive(Debug, Deserialize, Serialize)]
struct Description {
    format: String,
    version: u32,
    /// Least corner of the grid, m.
    origin: [f32; 3],
    /// Edges of a voxel, m; a probe stands in the middle of each.
    voxel: [f32; 3],
    /// Voxels along x, y, z; that at (i, j, k) has number i + counts[0] · (j + counts[1] · k).
    counts: [u32; 3],
    /// Probes that take part.
    probe_count: u32,
    /// Distance along its normal from which a point looks at the probes, m.
    lift: f32,
    /// True if probes behind walls do not count.
    walls: bool,
    tables: Vec<TableDescription>,
}

/// Position of a table in the binary file; numbers are little-endian.
#[derive(Debug, Deserialize, PartialEq, Serialize)]
struct TableDescription {
    name: String,
    /// `u32` or `f32`.
    number: String,
    /// First byte.
    offset: u64,
    /// The greatest dimension first.
    shape: Vec<u64>,
    meaning: String,
}

/// Name, type, numbers a row, and meaning of each table.
const TABLES: [(&str, &str, u64, &str); 4] = [
    ("probes", "u32", 1, "per voxel the number of its probe, or that of the nearest one with bit 31 set"),
    (
        "planes",
        "f32",
        PLANE_WORDS as u64,
        "per probe and direction (i + 1) + 3 (j + 1) + 9 (k + 1) to the voxels round it, the gradient g with g · q = \
         1 on the plane of what a ray meets there, q in voxels from the probe on; 0 where it meets nothing",
    ),
    (
        "cubes",
        "f32",
        3 * CUBE_SIDES as u64,
        "per probe the irradiance (RGB, W/m2) for the normals +x, -x, +y, -y, +z, -z",
    ),
    (
        "harmonics",
        "f32",
        3 * SH_COEFFICIENTS as u64,
        "per probe the radiance (RGB, W/m2/sr) as real spherical harmonics L_00, L_1x, L_1y, L_1z; irradiance is \
         pi 0.282095 L_00 + (2 pi / 3) 0.488603 (L_1 . n)",
    ),
];

impl ProbeVolume {
    /// A volume and the irradiance at its receivers, W/m² ([`super::in_volume`]).
    ///
    /// # Errors
    /// [`patches::Error::Length`] unless there is one value a receiver.
    pub fn new(volume: &VoxelVolume, cubes: Vec<Vec4>) -> Result<Self, Error> {
        let harmonics = volume.harmonics(&cubes)?;
        let params = volume.params;
        let probes = volume.probes.clone();
        let planes = volume.planes.clone();
        Ok(Self { params, probes, planes, cubes, harmonics })
    }

    /// Number of probes.
    pub fn len(&self) -> usize {
        self.cubes.len() / CUBE_SIDES as usize
    }

    /// Returns true if there are none.
    pub fn is_empty(&self) -> bool {
        self.cubes.is_empty()
    }

    /// Irradiance at a point with a unit normal, W/m², from the ambient cubes.
    pub fn irradiance(&self, position: Vec3, normal: Vec3) -> Vec3 {
        volume_lookup(&self.params, &self.probes, &self.planes, &self.cubes, position, normal).truncate()
    }

    /// Irradiance from the spherical harmonics.
    pub fn irradiance_by_harmonics(&self, position: Vec3, normal: Vec3) -> Vec3 {
        volume_lookup_sh(&self.params, &self.probes, &self.planes, &self.harmonics, position, normal).truncate()
    }

    /// The description (JSON) and the tables (binary) that it describes.
    ///
    /// # Errors
    /// [`File`](crate::ErrorKind::File), which no volume gives.
    pub fn to_files(&self) -> Result<(String, Vec<u8>), Error> {
        let rgb = |values: &[Vec4]| -> Vec<f32> { values.iter().flat_map(|v| v.truncate().to_array()).collect() };
        let cubes = rgb(&self.cubes);
        let harmonics = rgb(&self.harmonics);
        let contents: [&[u8]; 4] = [
            bytemuck::cast_slice(&self.probes),
            bytemuck::cast_slice(&self.planes),
            bytemuck::cast_slice(&cubes),
            bytemuck::cast_slice(&harmonics),
        ];
        let mut binary = Vec::new();
        let mut tables = Vec::new();
        for ((name, number, columns, meaning), bytes) in TABLES.into_iter().zip(contents) {
            tables.push(TableDescription {
                name: name.into(),
                number: number.into(),
                offset: binary.len() as u64,
                shape: vec![bytes.len() as u64 / 4 / columns, columns],
                meaning: meaning.into(),
            });
            binary.extend_from_slice(bytes);
        }
        let shape = &self.params.shape;
        let description = Description {
            format: FORMAT.into(),
            version: VERSION,
            origin: shape.origin.to_array(),
            voxel: shape.edges.to_array(),
            counts: shape.counts().to_array(),
            probe_count: self.len() as u32,
            lift: self.params.lift,
            walls: self.params.walls != 0,
            tables,
        };
        Ok((serde_json::to_string_pretty(&description)?, binary))
    }

    /// Reads what [`Self::to_files`] wrote.
    ///
    /// # Errors
    /// [`File`](crate::ErrorKind::File), which says what is wrong with the files.
    pub fn from_files(description: &str, binary: &[u8]) -> Result<Self, Error> {
        let wrong = |what: String| Error::from(Reason::Probes { what });
        let d: Description = serde_json::from_str(description)?;
        if d.format != FORMAT || d.version != VERSION {
            return Err(wrong(format!(
                "it is \"{}\" of version {}, not \"{FORMAT}\" of version {VERSION}",
                d.format, d.version
            )));
        }
        let sound = |v: [f32; 3]| v.iter().all(|x| x.is_finite());
        if !(sound(d.origin) && sound(d.voxel) && d.voxel.iter().all(|x| *x > 0.0) && d.lift.is_finite()) {
            return Err(wrong("origin, voxel and lift must be finite numbers, and voxel positive".into()));
        }
        let voxels = d.counts.iter().map(|&n| u64::from(n)).product::<u64>();
        if voxels == 0 || voxels > patches::PROBE_LIMIT || d.probe_count == 0 || u64::from(d.probe_count) > voxels {
            return Err(wrong(format!("{} probes in {:?} voxels", d.probe_count, d.counts)));
        }
        let rows = [voxels, d.probe_count.into(), d.probe_count.into(), d.probe_count.into()];
        check_tables(&d, rows, binary.len() as u64)?;
        let mut rest = binary;
        let probes: Vec<u32> = take(&mut rest, rows[0]);
        let planes: Vec<f32> = take(&mut rest, rows[1] * u64::from(PLANE_WORDS));
        let mut rgb = |rows: u64| -> Vec<Vec4> {
            take::<[f32; 3]>(&mut rest, rows).into_iter().map(|v| Vec3::from(v).extend(0.0)).collect()
        };
        let cubes = rgb(rows[2] * u64::from(CUBE_SIDES));
        let harmonics = rgb(rows[3] * u64::from(SH_COEFFICIENTS));
        if let Some(probe) = probes.iter().map(|probe| probe & !EMPTY_CELL).find(|&probe| probe >= d.probe_count) {
            return Err(wrong(format!("a voxel names probe {probe} of {}", d.probe_count)));
        }
        let finite = |values: &[Vec4]| values.iter().all(|v| v.is_finite());
        if !(planes.iter().all(|x| x.is_finite()) && finite(&cubes) && finite(&harmonics)) {
            return Err(wrong("a number is not finite".into()));
        }
        let [count_x, count_y, count_z] = d.counts;
        let shape = GridShape {
            origin: d.origin.into(),
            edges: d.voxel.into(),
            count_x,
            count_y,
            count_z,
            ..GridShape::zeroed()
        };
        let params = VolumeParams { shape, lift: d.lift, walls: d.walls.into(), ..VolumeParams::zeroed() };
        Ok(Self { params, probes, planes, cubes, harmonics })
    }

    /// The ambient cubes as a 3D texture in a KTX2 file, 16-bit floats, laid out as Bevy's irradiance volumes are: of
    /// size (Rx, 2 Ry, 3 Rz) for Rx × Ry × Rz voxels; the normal +x of voxel (x, y, z) is at (x, y, z), −x at (x, y +
    /// Ry, z), ±y and ±z one and two Rz further along z. Texels are E/π, which a surface multiplies by its colour. A
    /// voxel without a probe has that of the nearest.
    pub fn to_ktx2(&self) -> Vec<u8> {
        let counts = self.params.shape.counts();
        let width = counts.x;
        let height = 2 * counts.y;
        let depth = 3 * counts.z;
        let mut texels = Vec::with_capacity((width * height * depth) as usize);
        for z in 0..depth {
            for y in 0..height {
                for x in 0..width {
                    let voxel = x + counts.x * (y % counts.y + counts.y * (z % counts.z));
                    let side = 2 * (z / counts.z) + y / counts.y;
                    let probe = self.probes[voxel as usize] & !EMPTY_CELL;
                    let value = self.cubes[(probe * CUBE_SIDES + side) as usize] / core::f32::consts::PI;
                    let half = |x: f32| f16::from_f32(x.min(f16::MAX.to_f32()));
                    texels.push([half(value.x), half(value.y), half(value.z), half(1.0)]);
                }
            }
        }
        ktx2([width, height, depth], bytemuck::cast_slice(&texels))
    }
}

/// The next numbers of a table whose length was checked.
fn take<T: Pod>(rest: &mut &[u8], count: u64) -> Vec<T> {
    let (table, after) = rest.split_at(count as usize * size_of::<T>());
    *rest = after;
    bytemuck::pod_collect_to_vec(table)
}

/// A KTX2 file (Khronos, "KTX File Format Specification", version 2.0) with one level of RGBA of 16-bit floats.
fn ktx2(size: [u32; 3], texels: &[u8]) -> Vec<u8> {
    const IDENTIFIER: [u8; 12] = [0xab, b'K', b'T', b'X', b' ', b'2', b'0', 0xbb, b'\r', b'\n', 0x1a, b'\n'];
    /// `VK_FORMAT_R16G16B16A16_SFLOAT`.
    const FORMAT: u32 = 97;
    /// Bytes before the data format descriptor: header, index, one level.
    const BEFORE: u32 = 12 + 9 * 4 + 4 * 4 + 2 * 8 + 3 * 8;
    /// Channels: red, green, blue, and alpha.
    const CHANNELS: [u32; 4] = [0, 1, 2, 15];
    let block = 24 + 16 * CHANNELS.len() as u32;
    let descriptor = 4 + block;
    // Texels of eight bytes begin at a multiple of eight.
    let first = (BEFORE + descriptor).next_multiple_of(8);
    let mut file = IDENTIFIER.to_vec();
    let words = |file: &mut Vec<u8>, words: &[u32]| words.iter().for_each(|w| file.extend_from_slice(&w.to_le_bytes()));
    // Format, bytes of a number, size, no layers, one face, one level, not compressed.
    words(&mut file, &[FORMAT, 2, size[0], size[1], size[2], 0, 1, 1, 0]);
    // Where the descriptor is; no keys, no global data.
    words(&mut file, &[BEFORE, descriptor, 0, 0, 0, 0, 0, 0]);
    words(&mut file, &[first, 0, texels.len() as u32, 0, texels.len() as u32, 0]);
    // The descriptor: Khronos' basic block of version 2, RGB colours with the primaries of BT.709, linear; texels of
    // eight bytes.
    words(&mut file, &[descriptor, 0, 2 + (block << 16), 1 + (1 << 8) + (1 << 16), 0, 8, 0]);
    for (k, channel) in (0u32..).zip(CHANNELS) {
        // Signed floats of 16 bits: the bounds are those of −1 and 1.
        words(&mut file, &[16 * k + (15 << 16) + ((channel + 0xc0) << 24), 0, (-1f32).to_bits(), 1f32.to_bits()]);
    }
    file.resize(first as usize, 0);
    file.extend_from_slice(texels);
    file
}

/// Checks the tables of a description of so many rows each, in a file of so many bytes.
fn check_tables(description: &Description, rows: [u64; 4], bytes: u64) -> Result<(), Error> {
    let tables = &description.tables;
    let mut offset = 0;
    for ((table, (name, number, columns, _)), rows) in tables.iter().zip(TABLES).zip(rows) {
        if table.name != name || table.number != number || table.offset != offset || table.shape != [rows, columns] {
            let what =
                format!("table {} is not \"{name}\" of {rows} x {columns} {number} at byte {offset}", table.name);
            return Err(Reason::Probes { what }.into());
        }
        offset += 4 * rows * columns;
    }
    if tables.len() != TABLES.len() || bytes != offset {
        let what = format!("{} tables and {bytes} bytes, not {} and {offset}", tables.len(), TABLES.len());
        return Err(Reason::Probes { what }.into());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use patches::kernel::volume::{DIRECTIONS, cube_to_harmonic};

    use super::*;

    /// A grid of 2 × 1 × 2 voxels, one of them without a probe.
    fn volume() -> ProbeVolume {
        let shape = GridShape {
            origin: Vec3::new(-1.0, 0.0, 2.0),
            edges: Vec3::new(1.0, 2.0, 0.5),
            count_x: 2,
            count_y: 1,
            count_z: 2,
            ..GridShape::zeroed()
        };
        let params = VolumeParams { shape, lift: 0.01, walls: 1, ..VolumeParams::zeroed() };
        let cubes: Vec<Vec4> = (0..18).map(|k| Vec3::new(k as f32, 0.5 * k as f32, 1.0).extend(0.0)).collect();
        let harmonics = (0..12).map(|k| cube_to_harmonic(&cubes, k / SH_COEFFICIENTS, k % SH_COEFFICIENTS)).collect();
        let planes = vec![0.0; 3 * PLANE_WORDS as usize];
        ProbeVolume { params, probes: vec![0, 1, 2, 2 | EMPTY_CELL], planes, cubes, harmonics }
    }

    #[test]
    fn a_volume_read_back_is_the_same() {
        let volume = volume();
        let (description, binary) = volume.to_files().unwrap();
        assert_eq!(ProbeVolume::from_files(&description, &binary).unwrap(), volume);
        let mut changed = binary.clone();
        changed[16 + 4 * 3 * PLANE_WORDS as usize] ^= 1;
        assert_ne!(ProbeVolume::from_files(&description, &changed).unwrap(), volume);
        assert_eq!(DIRECTIONS * 3, PLANE_WORDS);
    }

    #[test]
    fn damaged_files_are_refused_with_what_is_wrong() {
        let (description, binary) = volume().to_files().unwrap();
        let said =
            |description: &str, binary: &[u8]| ProbeVolume::from_files(description, binary).unwrap_err().to_string();
        assert!(said(&description, &binary[..binary.len() - 1]).contains("bytes"));
        assert!(said(&description.replace("patchlight probes", "probes"), &binary).contains("version"));
        assert!(said(&description.replace("\"counts\": [\n    2", "\"counts\": [\n    0"), &binary).contains("voxels"));
        assert!(said(&description.replace("cubes", "spheres"), &binary).contains("spheres"));
        assert!(said("{", &binary).contains("EOF"));
        let mut wild = binary.clone();
        wild[..4].copy_from_slice(&77u32.to_le_bytes());
        assert!(said(&description, &wild).contains("probe 77 of 3"));
        wild = binary;
        let last = wild.len() - 4;
        wild[last..].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(said(&description, &wild).contains("not finite"));
    }

    #[test]
    fn a_texture_has_the_sides_where_bevy_looks_for_them() {
        let volume = volume();
        let file = volume.to_ktx2();
        let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap());
        assert_eq!([word(12), word(20), word(24), word(28)], [97, 2, 2, 6]);
        let first = word(80) as usize;
        let length = word(88) as usize;
        assert_eq!((first % 8, first + length, length), (0, file.len(), 2 * 2 * 6 * 8));
        let red = |x: usize, y: usize, z: usize| {
            let at = first + 8 * (x + 2 * (y + 2 * z));
            f16::from_le_bytes([file[at], file[at + 1]]).to_f32() * core::f32::consts::PI
        };
        // Probe 1 is that of voxel (1, 0, 0); voxel (1, 0, 1) has none and takes that of (0, 0, 1), which is probe 2.
        for (x, y, z, probe, side) in
            [(1, 0, 0, 1, 0), (1, 1, 0, 1, 1), (0, 0, 2, 0, 2), (0, 1, 3, 2, 3), (1, 0, 5, 2, 4), (1, 1, 5, 2, 5)]
        {
            let expected = (6 * probe + side) as f32;
            assert!((red(x, y, z) - expected).abs() <= 1e-3 * expected, "{x} {y} {z}: {} {expected}", red(x, y, z));
        }
    }
}
