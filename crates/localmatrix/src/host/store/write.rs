//! A bake that is written, block after block; what was written before an interruption is kept.

use std::fs::{self, File, OpenOptions};
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

use super::error::BakeError;
use super::file::{block_at, bytes_at, file_error, read_block};
use super::format::*;
use super::map::Mapped;
use crate::host::world::Node;

/// Writes `PATH.beginning`, which takes its name when all blocks are there.
#[derive(Debug)]
pub struct BakeWriter {
    path: PathBuf,
    beginning: PathBuf,
    out: BufWriter<File>,
    mapped: Mapped,
    head: WorldHead,
    nodes: Vec<Node>,
    /// Further data of the program.
    extra: Vec<u8>,
    /// Offset, length and checksum of the blocks that are there.
    blocks: Vec<(u64, u32, u32)>,
    end: u64,
    sky: Vec<f32>,
}

/// Path of a bake until it is whole: `PATH.beginning`.
pub fn beginning_of(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".beginning");
    path.with_file_name(name)
}

impl BakeWriter {
    /// Begins a file.
    ///
    /// # Errors
    /// [`BakeError::Setting`] for a head that cannot be, [`BakeError::File`].
    pub fn create(
        path: &Path,
        head: WorldHead,
        text: &str,
        nodes: Vec<Node>,
        extra: Vec<u8>,
    ) -> Result<Self, BakeError> {
        head.check()?;
        if nodes.len() != head.nodes as usize {
            let rule = "the number of nodes of the head";
            return Err(BakeError::Setting { name: "nodes", found: nodes.len() as u64, rule });
        }
        let beginning = beginning_of(path);
        let io = |e: std::io::Error| file_error(&beginning, &e);
        let world = encode_world(text, &nodes, &extra);
        let header = encode_header(&head, (world.len() as u64, crc32fast::hash(&world)));
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(true).open(&beginning).map_err(io)?;
        // Header last: a file with a header has its world.
        file.seek(SeekFrom::Start(HEADER as u64)).map_err(io)?;
        file.write_all(&world).map_err(io)?;
        file.seek(SeekFrom::Start(0)).map_err(io)?;
        file.write_all(&header).map_err(io)?;
        let end = file.seek(SeekFrom::End(0)).map_err(io)?;
        Self::of(path, file, head, nodes, extra, end)
    }

    fn of(
        path: &Path,
        file: File,
        head: WorldHead,
        nodes: Vec<Node>,
        extra: Vec<u8>,
        end: u64,
    ) -> Result<Self, BakeError> {
        let beginning = beginning_of(path);
        let mapped = Mapped::of(file.try_clone().map_err(|e| file_error(&beginning, &e))?);
        Ok(Self {
            path: path.to_path_buf(),
            beginning,
            out: BufWriter::new(file),
            mapped,
            head,
            nodes,
            extra,
            blocks: Vec::new(),
            end,
            sky: Vec::new(),
        })
    }

    /// Goes on with what was begun, after the last whole block; nothing when nothing was begun, or nothing usable.
    ///
    /// # Errors
    /// [`BakeError::OtherBeginning`] when the beginning is of another scene, other settings or another part;
    /// [`BakeError::File`].
    pub fn resume(path: &Path, scene: [u8; 32], key: [u8; 32], part: Option<Part>) -> Result<Option<Self>, BakeError> {
        let beginning = beginning_of(path);
        let name = beginning.display().to_string();
        let io = |e: std::io::Error| file_error(&beginning, &e);
        let mut file = match OpenOptions::new().read(true).write(true).open(&beginning) {
            Ok(file) => file,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(io(e)),
        };
        let mut header = Vec::new();
        Read::by_ref(&mut file).take(HEADER as u64).read_to_end(&mut header).map_err(io)?;
        let Ok((head, (length, sum))) = decode_header(&name, &header) else { return Ok(None) };
        let other = |reason: &str| BakeError::OtherBeginning { path: name.clone(), reason: reason.to_string() };
        if head.scene != scene {
            return Err(other("another scene"));
        }
        if head.key != key {
            return Err(other("other settings"));
        }
        if head.part != part {
            return Err(other("another part"));
        }
        let mapped = Mapped::of(file.try_clone().map_err(io)?);
        let Ok(world) = bytes_at(&mapped, HEADER as u64, length as usize) else { return Ok(None) };
        if crc32fast::hash(&world) != sum {
            return Ok(None);
        }
        let Ok((_, nodes, extra)) = decode_world(&head, &world) else { return Ok(None) };
        drop(world);
        let mut writer = Self::of(path, file, head, nodes, extra, HEADER as u64 + length)?;
        for number in head.own_blocks() {
            let Some(place) = block_at(&writer.mapped, writer.end, number) else { break };
            let Ok((bytes, starts)) = read_block(&writer.mapped, path, &head, number, place) else { break };
            writer.keep(&bytes, &starts);
        }
        // What follows the last whole block is half of one.
        let file = writer.out.get_mut();
        file.set_len(writer.end).map_err(io)?;
        file.seek(SeekFrom::End(0)).map_err(io)?;
        Ok(Some(writer))
    }

    /// Notes a block that is in the file.
    fn keep(&mut self, bytes: &[u8], starts: &[u32]) {
        let sum = u32::from_le_bytes([bytes[20], bytes[21], bytes[22], bytes[23]]);
        self.blocks.push((self.end, bytes.len() as u32, sum));
        self.end += bytes.len() as u64;
        self.sky.extend(starts.iter().map(|&s| {
            let s = s as usize;
            f32::from_le_bytes([bytes[s], bytes[s + 1], bytes[s + 2], bytes[s + 3]])
        }));
    }

    /// Identity of the baked world.
    pub fn head(&self) -> &WorldHead {
        &self.head
    }

    /// All nodes.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Further data of the program.
    pub fn extra(&self) -> &[u8] {
        &self.extra
    }

    /// The next block that is wanted; nothing when all are there.
    pub fn next_block(&self) -> Option<u32> {
        let own = self.head.own_blocks();
        let next = own.start + self.blocks.len() as u32;
        own.contains(&next).then_some(next)
    }

    /// Adds the next block: the records of all its nodes.
    ///
    /// # Errors
    /// [`BakeError::Setting`] for a wrong number of records, or none wanted; [`BakeError::File`].
    pub fn push(&mut self, records: &[Record]) -> Result<(), BakeError> {
        let rule = "those of the next block";
        let wrong = BakeError::Setting { name: "records", found: records.len() as u64, rule };
        let Some(block) = self.next_block() else { return Err(wrong) };
        let range = block_range(&self.head, block);
        if records.len() != range.len() {
            return Err(wrong);
        }
        let bytes = encode_block(block, range.start, records);
        self.push_bytes(block, &bytes)
    }

    /// Adds the bytes of the next block as another file has them.
    pub(super) fn push_bytes(&mut self, block: u32, bytes: &[u8]) -> Result<(), BakeError> {
        let range = block_range(&self.head, block);
        let starts = check_block(block, range, bytes).map_err(|reason| BakeError::Block {
            path: self.beginning.display().to_string(),
            block,
            offset: self.end,
            reason,
        })?;
        self.out.write_all(bytes).and_then(|()| self.out.flush()).map_err(|e| file_error(&self.beginning, &e))?;
        self.keep(bytes, &starts);
        Ok(())
    }

    /// Records of a block that was written.
    ///
    /// # Errors
    /// [`BakeError::Block`], [`BakeError::File`].
    pub fn records(&self, block: u32) -> Result<Vec<Record>, BakeError> {
        let place = block.checked_sub(self.head.own_blocks().start).and_then(|k| self.blocks.get(k as usize));
        let Some(&(offset, length, _)) = place else {
            return Err(BakeError::Setting { name: "block", found: u64::from(block), rule: "one that was written" });
        };
        let (bytes, starts) = read_block(&self.mapped, &self.beginning, &self.head, block, (offset, length))?;
        starts
            .iter()
            .map(|start| decode_row(&bytes[*start as usize..], self.head.nodes))
            .collect::<Result<_, String>>()
            .map_err(|reason| BakeError::Block { path: self.beginning.display().to_string(), block, offset, reason })
    }

    /// Adds the tail to a whole bake, and gives the file its name.
    ///
    /// # Errors
    /// [`BakeError::Setting`] when blocks are missing, [`BakeError::File`].
    pub fn finish(mut self) -> Result<(), BakeError> {
        if let Some(block) = self.next_block() {
            return Err(BakeError::Setting { name: "next block", found: u64::from(block), rule: "written before" });
        }
        if self.head.part.is_none() {
            let mut tail = Vec::with_capacity(TABLE_ENTRY * self.blocks.len() + 4 * self.sky.len() + END);
            for (offset, length, sum) in &self.blocks {
                tail.extend(offset.to_le_bytes());
                tail.extend(length.to_le_bytes());
                tail.extend(sum.to_le_bytes());
            }
            self.sky.iter().for_each(|sky| tail.extend(sky.to_le_bytes()));
            let length = tail.len() as u64;
            let sum = crc32fast::hash(&tail);
            tail.extend(length.to_le_bytes());
            tail.extend(sum.to_le_bytes());
            tail.extend(END_MAGIC);
            self.out.write_all(&tail).map_err(|e| file_error(&self.beginning, &e))?;
        }
        self.out.flush().and_then(|()| self.out.get_ref().sync_all()).map_err(|e| file_error(&self.beginning, &e))?;
        fs::rename(&self.beginning, &self.path).map_err(|e| file_error(&self.path, &e))
    }
}
