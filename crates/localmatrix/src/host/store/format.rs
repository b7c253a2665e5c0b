//! Byte format of a bake.

use std::string::{String, ToString};
use std::vec::Vec;

use glam::Vec3;

use super::error::BakeError;
use crate::host::world::{NO_NODE, Node};

pub(super) const MAGIC: [u8; 8] = *b"PLBAKE\r\n";
pub(super) const END_MAGIC: [u8; 8] = *b"PLBAKEND";
pub(super) const BLOCK_MAGIC: [u8; 4] = *b"ROWS";
pub(super) const VERSION: u32 = 1;
pub(super) const HEADER: usize = 120;
pub(super) const BLOCK_HEADER: usize = 24;
pub(super) const TABLE_ENTRY: usize = 16;
pub(super) const END: usize = 20;
const NODE: usize = 56;
const ROW: usize = 20;
const ENTRY: usize = 6;
const POINT: usize = 24;
/// Most bytes of a block: what is longer was altered.
pub(super) const MAX_BLOCK: u32 = 1 << 28;
/// Most nodes: their numbers, and one for none.
const MAX_NODES: u32 = 1 << 28;

/// A part of a bake: number from 1, and how many there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// Its number, from 1.
    pub number: u32,
    /// Number of all.
    pub of: u32,
}

/// Identity of a baked world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WorldHead {
    /// The part, or nothing for a whole bake.
    pub part: Option<Part>,
    /// Nodes, leaves first.
    pub nodes: u32,
    /// Leaves.
    pub leaves: u32,
    /// Rows of a block.
    pub block_rows: u32,
    /// Hash of the scene.
    pub scene: [u8; 32],
    /// Hash of all settings that change a byte.
    pub key: [u8; 32],
}

/// A point of a node at which its direct light is measured; each stands for the same area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LitPoint {
    /// Position, m.
    pub position: Vec3,
    /// Unit normal of the side that is lit.
    pub normal: Vec3,
    /// Reflectance there.
    pub albedo: Vec3,
}

/// A node's row and what belongs to it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Record {
    /// Share of the hemisphere that sees no geometry.
    pub sky: f32,
    /// Share of the rays that met what no patch owns.
    pub lost: f32,
    /// Other nodes, rising, and the share of the node's light that arrives there.
    pub factors: Vec<(u32, f32)>,
    /// Points where direct light is measured.
    pub points: Vec<LitPoint>,
}

impl WorldHead {
    pub(super) fn leaf_blocks(&self) -> u32 {
        self.leaves.div_ceil(self.block_rows)
    }

    /// Blocks of a whole bake.
    pub fn blocks(&self) -> u32 {
        self.leaf_blocks() + (self.nodes - self.leaves).div_ceil(self.block_rows)
    }

    /// Blocks that this file holds.
    pub fn own_blocks(&self) -> std::ops::Range<u32> {
        let all = u64::from(self.leaf_blocks());
        match self.part {
            None => 0..self.blocks(),
            Some(Part { number, of }) => {
                let start = |k: u32| (all * u64::from(k) / u64::from(of)) as u32;
                start(number - 1)..start(number)
            }
        }
    }

    /// The block that holds a node's row.
    pub fn block_of(&self, node: u32) -> u32 {
        match node.checked_sub(self.leaves) {
            None => node / self.block_rows,
            Some(above) => self.leaf_blocks() + above / self.block_rows,
        }
    }

    pub(super) fn check(&self) -> Result<(), BakeError> {
        let fault = |name, found: u32, rule| Err(BakeError::Setting { name, found: u64::from(found), rule });
        if self.nodes == 0 || self.nodes > MAX_NODES {
            return fault("number of nodes", self.nodes, "1 to 2^28");
        }
        if self.leaves == 0 || self.leaves > self.nodes {
            return fault("number of leaves", self.leaves, "1 to the number of nodes");
        }
        if self.block_rows == 0 || self.block_rows > 1 << 16 {
            return fault("rows of a block", self.block_rows, "1 to 65536");
        }
        match self.part {
            Some(Part { number, of }) if number == 0 || number > of => {
                fault("part", number, "1 to the number of parts")
            }
            _ => Ok(()),
        }
    }
}

/// Nodes whose rows a block holds.
pub fn block_range(head: &WorldHead, block: u32) -> std::ops::Range<u32> {
    match block.checked_sub(head.leaf_blocks()) {
        None => {
            let first = block * head.block_rows;
            first..(first + head.block_rows).min(head.leaves)
        }
        Some(above) => {
            let first = head.leaves + above * head.block_rows;
            first..(first + head.block_rows).min(head.nodes)
        }
    }
}

/// Numbers out of bytes; what is not there is an error.
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (head, rest) = self.bytes.split_at_checked(count).ok_or("it is too short")?;
        self.bytes = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N)?);
        Ok(out)
    }

    pub(super) fn word(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    pub(super) fn long(&mut self) -> Result<u64, String> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    pub(super) fn short(&mut self) -> Result<u16, String> {
        Ok(u16::from_le_bytes(self.array()?))
    }

    pub(super) fn float(&mut self) -> Result<f32, String> {
        Ok(f32::from_le_bytes(self.array()?))
    }

    pub(super) fn vector(&mut self) -> Result<Vec3, String> {
        Ok(Vec3::new(self.float()?, self.float()?, self.float()?))
    }

    pub(super) fn rest(&self) -> usize {
        self.bytes.len()
    }
}

fn put_vector(out: &mut Vec<u8>, v: Vec3) {
    v.to_array().iter().for_each(|x| out.extend(x.to_le_bytes()));
}

/// Text, nodes and what else there is as the bytes of the world.
pub(super) fn encode_world(text: &str, nodes: &[Node], extra: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(12 + text.len() + NODE * nodes.len() + extra.len());
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
    for n in nodes {
        put_vector(&mut out, n.centre);
        out.extend(n.radius.to_le_bytes());
        put_vector(&mut out, n.normal);
        out.extend(n.area.to_le_bytes());
        put_vector(&mut out, n.albedo);
        [n.parent, n.first_child, n.children].iter().for_each(|x| out.extend(x.to_le_bytes()));
    }
    out.extend((extra.len() as u64).to_le_bytes());
    out.extend(extra);
    out
}

/// The other way round; the reason where it cannot be.
pub(super) fn decode_world(head: &WorldHead, bytes: &[u8]) -> Result<(String, Vec<Node>, Vec<u8>), String> {
    let mut reader = Reader::new(bytes);
    let length = reader.word()? as usize;
    let text = std::str::from_utf8(reader.take(length)?).map_err(|e| e.to_string())?.to_string();
    if reader.rest() / NODE < head.nodes as usize {
        return Err("it is too short for its nodes".to_string());
    }
    let mut nodes = Vec::with_capacity(head.nodes as usize);
    for number in 0..head.nodes {
        let node = Node {
            centre: reader.vector()?,
            radius: reader.float()?,
            normal: reader.vector()?,
            area: reader.float()?,
            albedo: reader.vector()?,
            parent: reader.word()?,
            first_child: reader.word()?,
            children: reader.word()?,
        };
        check_node(head, number, &node).map_err(|what| std::format!("node {number}: {what}"))?;
        nodes.push(node);
    }
    let length = reader.long()?;
    if length != reader.rest() as u64 {
        return Err("its length is wrong".to_string());
    }
    let extra = reader.take(reader.rest())?.to_vec();
    Ok((text, nodes, extra))
}

fn check_node(head: &WorldHead, number: u32, n: &Node) -> Result<(), &'static str> {
    let has_place = is_place(n.centre) && is_place(n.normal) && (0.0..=MAX_COORDINATE).contains(&n.radius);
    if !(has_place && n.area > 0.0 && n.area <= MAX_AREA) {
        return Err("it has no place or no area");
    }
    if !(n.albedo.min_element() >= 0.0 && n.albedo.max_element() < 1.0) {
        return Err("its reflectance is not in [0, 1)");
    }
    if n.parent != NO_NODE && (n.parent >= head.nodes || n.parent <= number || n.parent < head.leaves) {
        return Err("its parent is no node above it");
    }
    // Children come before those made of them.
    let end = n.first_child.checked_add(n.children);
    match number < head.leaves {
        true if n.children == 0 => Ok(()),
        false if n.children > 0 && end.is_some_and(|end| end <= number) => Ok(()),
        _ => Err("its children are no nodes below it"),
    }
}

/// The header of a file whose world has this length and checksum.
pub(super) fn encode_header(head: &WorldHead, world: (u64, u32)) -> [u8; HEADER] {
    let mut out = Vec::with_capacity(HEADER);
    out.extend(MAGIC);
    let part = head.part.unwrap_or(Part { number: 0, of: 0 });
    for word in [VERSION, part.number, part.of, head.nodes, head.leaves, head.block_rows, head.blocks(), 0] {
        out.extend(word.to_le_bytes());
    }
    out.extend(head.scene);
    out.extend(head.key);
    out.extend(world.0.to_le_bytes());
    out.extend(world.1.to_le_bytes());
    out.extend(crc32fast::hash(&out).to_le_bytes());
    let mut header = [0; HEADER];
    header.copy_from_slice(&out);
    header
}

/// Decodes a header: the world's head, length and checksum.
pub(super) fn decode_header(path: &str, bytes: &[u8]) -> Result<(WorldHead, (u64, u32)), BakeError> {
    let damaged = |reason: &str| BakeError::Damaged {
        path: path.to_string(),
        part: "the header",
        offset: 0,
        reason: reason.to_string(),
    };
    if bytes.len() < MAGIC.len() || bytes[..8] != MAGIC {
        let reason = if bytes.is_empty() { "it is empty" } else { "it does not begin as one" };
        return Err(BakeError::NotABake { path: path.to_string(), reason: reason.to_string() });
    }
    let mut reader = Reader::new(&bytes[8..]);
    let version = reader.word().map_err(|e| damaged(&e))?;
    if version != VERSION {
        return Err(BakeError::Version { path: path.to_string(), found: version, expected: VERSION });
    }
    if bytes.len() < HEADER {
        return Err(damaged("it is too short"));
    }
    let mut read = || -> Result<_, String> {
        let number = reader.word()?;
        let of = reader.word()?;
        let nodes = reader.word()?;
        let leaves = reader.word()?;
        let block_rows = reader.word()?;
        let blocks = reader.word()?;
        let _ = reader.word()?;
        let scene = reader.array()?;
        let key = reader.array()?;
        let part = (of > 0).then_some(Part { number, of });
        let head = WorldHead { part, nodes, leaves, block_rows, scene, key };
        Ok((head, blocks, (reader.long()?, reader.word()?), reader.word()?))
    };
    let (head, blocks, world, sum) = read().map_err(|e| damaged(&e))?;
    if sum != crc32fast::hash(&bytes[..HEADER - 4]) {
        return Err(damaged("its checksum is wrong"));
    }
    head.check().map_err(|e| damaged(&e.to_string()))?;
    if blocks != head.blocks() {
        return Err(damaged("its number of blocks is wrong"));
    }
    Ok((head, world))
}

/// The rows of a block as bytes, header and all.
pub(super) fn encode_block(number: u32, first: u32, records: &[Record]) -> Vec<u8> {
    let size: usize = records.iter().map(|r| ROW + ENTRY * r.factors.len() + POINT * r.points.len()).sum();
    let mut out = Vec::with_capacity(BLOCK_HEADER + size);
    out.extend(BLOCK_MAGIC);
    for word in [number, first, records.len() as u32, 0, 0] {
        out.extend(word.to_le_bytes());
    }
    for record in records {
        encode_row(record, &mut out);
    }
    let length = (out.len() - BLOCK_HEADER) as u32;
    out[16..20].copy_from_slice(&length.to_le_bytes());
    let sum = block_sum(&out);
    out[20..24].copy_from_slice(&sum.to_le_bytes());
    out
}

/// Checksum of a block: of its header without the sum itself, and its rows.
fn block_sum(bytes: &[u8]) -> u32 {
    let mut sum = crc32fast::Hasher::new();
    sum.update(&bytes[..BLOCK_HEADER - 4]);
    sum.update(&bytes[BLOCK_HEADER..]);
    sum.finalize()
}

fn encode_row(record: &Record, out: &mut Vec<u8>) {
    let scale = record.factors.iter().map(|f| f.1).fold(0.0, f32::max);
    let step = f32::from(u16::MAX) / scale.max(f32::MIN_POSITIVE);
    let kept: Vec<(u32, u16)> = (record.factors.iter())
        .map(|&(column, share)| (column, (share * step + 0.5).clamp(0.0, f32::from(u16::MAX)) as u16))
        .filter(|&(_, share)| share > 0)
        .collect();
    for x in [record.sky, record.lost] {
        out.extend(x.to_le_bytes());
    }
    for count in [kept.len(), record.points.len()] {
        out.extend((count as u32).to_le_bytes());
    }
    out.extend(scale.to_le_bytes());
    kept.iter().for_each(|(column, _)| out.extend(column.to_le_bytes()));
    kept.iter().for_each(|(_, share)| out.extend(share.to_le_bytes()));
    for p in &record.points {
        put_vector(out, p.position);
        p.normal.to_array().iter().for_each(|x| out.extend(((x * 32767.0).round() as i16).to_le_bytes()));
        p.albedo.to_array().iter().for_each(|x| out.extend(((x * 65535.0).round() as u16).to_le_bytes()));
    }
}

/// Checks the bytes of a block, header and all, and says where its rows begin.
pub(super) fn check_block(number: u32, range: std::ops::Range<u32>, bytes: &[u8]) -> Result<Vec<u32>, String> {
    let mut reader = Reader::new(bytes);
    if reader.take(4)? != BLOCK_MAGIC {
        return Err("no block begins there".to_string());
    }
    let own = reader.word()?;
    let first = reader.word()?;
    let rows = reader.word()?;
    let length = reader.word()? as usize;
    let sum = reader.word()?;
    if reader.rest() != length {
        return Err("its length is wrong".to_string());
    }
    if block_sum(bytes) != sum {
        return Err("its checksum is wrong".to_string());
    }
    if own != number || first != range.start || rows != range.end - range.start {
        return Err(std::format!("it is block {own} with {rows} rows from {first} on"));
    }
    let mut starts = Vec::with_capacity(rows as usize);
    for _ in 0..rows {
        starts.push((bytes.len() - reader.rest()) as u32);
        reader.take(8)?;
        let entries = reader.word()? as usize;
        let points = reader.word()? as usize;
        let size = entries.checked_mul(ENTRY).zip(points.checked_mul(POINT)).and_then(|(a, b)| a.checked_add(b));
        reader.take(size.and_then(|n| n.checked_add(4)).ok_or("it is too short")?)?;
    }
    if reader.rest() != 0 {
        return Err("something follows its rows".to_string());
    }
    Ok(starts)
}

/// Greatest coordinate of a point, m, and area of a node, m².
const MAX_COORDINATE: f32 = 1e9;
const MAX_AREA: f32 = 1e18;
/// Greatest share of a row's hemisphere: one, and what rounding adds.
const MAX_SHARE: f32 = 1.01;

/// Returns true if a number is a share of a hemisphere.
pub(super) fn is_share(x: f32) -> bool {
    (0.0..=MAX_SHARE).contains(&x)
}

fn is_place(p: Vec3) -> bool {
    p.abs().max_element() <= MAX_COORDINATE && p.is_finite()
}

/// A row of a checked block; the reason where its numbers cannot be.
pub(super) fn decode_row(bytes: &[u8], nodes: u32) -> Result<Record, String> {
    let mut reader = Reader::new(bytes);
    let sky = reader.float()?;
    let lost = reader.float()?;
    let entries = reader.word()? as usize;
    let points = reader.word()? as usize;
    let scale = reader.float()? / f32::from(u16::MAX);
    let mut columns = Reader::new(reader.take(4 * entries)?);
    let mut shares = Reader::new(reader.take(2 * entries)?);
    let mut factors = Vec::with_capacity(entries);
    for _ in 0..entries {
        let column = columns.word()?;
        let share = f32::from(shares.short()?) * scale;
        if column >= nodes {
            return Err(std::format!("it names node {column}, and there are {nodes}"));
        }
        factors.push((column, share));
    }
    let sum: f32 = factors.iter().map(|factor| factor.1).sum();
    if !(is_share(sky) && is_share(lost) && is_share(sum) && factors.iter().all(|factor| is_share(factor.1))) {
        return Err(std::format!("its shares of a hemisphere are {sum}, of the sky {sky}, lost {lost}"));
    }
    let points = (0..points)
        .map(|_| {
            let position = reader.vector()?;
            if !is_place(position) {
                return Err(std::format!("a point lies at {position}"));
            }
            let mut three = || Ok::<_, String>([reader.short()?, reader.short()?, reader.short()?]);
            let normal = three()?;
            let albedo = three()?;
            Ok(LitPoint {
                position,
                normal: Vec3::from_array(normal.map(|x| f32::from(x as i16))).normalize_or(Vec3::Y),
                albedo: Vec3::from_array(albedo.map(|x| f32::from(x) / 65535.0)),
            })
        })
        .collect::<Result<_, String>>()?;
    Ok(Record { sky, lost, factors, points })
}
