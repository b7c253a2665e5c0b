//! A bake that is read.

use std::boxed::Box;
use std::io::{Error as IoError, ErrorKind};
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

use super::error::BakeError;
use super::format::*;
use super::map::{Mapped, Source};
use crate::host::world::Node;

/// A bake, opened: its head, its nodes, and where its blocks are.
#[derive(Debug)]
pub struct BakeFile {
    pub(super) path: PathBuf,
    pub(super) source: Box<dyn Source>,
    /// World of the bake.
    pub head: WorldHead,
    /// Text of the settings.
    pub text: String,
    /// All nodes, leaves first.
    pub nodes: Vec<Node>,
    /// Further data of the program.
    pub extra: Vec<u8>,
    /// Sky factor of each node; empty where the tail is lost, and in parts.
    pub sky: Vec<f32>,
    /// Offset and length of each of its blocks, and what is wrong with those that are lost.
    pub(super) blocks: Vec<Result<(u64, u32), BakeError>>,
    /// Bytes and checksum of the world.
    pub(super) world: (u64, u32),
}

pub(super) fn file_error(path: &Path, error: &IoError) -> BakeError {
    BakeError::File { path: path.display().to_string(), reason: error.to_string() }
}

/// `length` bytes from `offset` on.
pub(super) fn bytes_at(source: &dyn Source, offset: u64, length: usize) -> std::io::Result<Vec<u8>> {
    let mut out = Vec::new();
    source.with(offset, length, &mut |bytes| out = bytes.to_vec())?;
    Ok(out)
}

/// Offset and length of the block that begins at `offset`, by its own header; nothing where none does.
pub(super) fn block_at(source: &dyn Source, offset: u64, number: u32) -> Option<(u64, u32)> {
    let header = bytes_at(source, offset, BLOCK_HEADER).ok()?;
    let mut reader = Reader::new(&header);
    let magic = reader.take(4).ok()? == BLOCK_MAGIC;
    let own = reader.word().ok()?;
    let _ = (reader.word().ok()?, reader.word().ok()?);
    let length = reader.word().ok()?;
    (magic && own == number && length <= MAX_BLOCK).then_some((offset, BLOCK_HEADER as u32 + length))
}

/// Returns true if a file begins as a bake does, whatever follows.
///
/// # Errors
/// [`BakeError::File`] for one that cannot be read.
pub fn is_begun_as_bake(path: &Path) -> Result<bool, BakeError> {
    let source = Mapped::open(path).map_err(|e| file_error(path, &e))?;
    Ok(bytes_at(&source, 0, MAGIC.len()).is_ok_and(|bytes| bytes == MAGIC))
}

impl BakeFile {
    /// Opens a bake, or a part of one: header and nodes must be whole, blocks may be lost.
    ///
    /// # Errors
    /// [`BakeError`]: another kind of file, another version, a header or nodes that were altered.
    pub fn open(path: &Path) -> Result<Self, BakeError> {
        let source = Mapped::open(path).map_err(|e| file_error(path, &e))?;
        Self::of_source(path, Box::new(source))
    }

    /// As [`Self::open`], from any source; `path` is for messages.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn of_source(path: &Path, source: Box<dyn Source>) -> Result<Self, BakeError> {
        let name = path.display().to_string();
        let io = |e: IoError| file_error(path, &e);
        let size = source.len().map_err(io)?;
        let header = bytes_at(&*source, 0, (HEADER as u64).min(size) as usize).map_err(io)?;
        let (head, world) = decode_header(&name, &header)?;
        let damaged = |part, offset, reason: String| BakeError::Damaged { path: name.clone(), part, offset, reason };
        let at = HEADER as u64;
        if world.0 > size - at {
            let reason = std::format!("{} bytes are there, and it has {}", size - at, world.0);
            return Err(damaged("the world", at, reason));
        }
        // Read where it is: a copy would be as large as all nodes.
        let mut read = Err("it is not there".to_string());
        let decode = &mut |bytes: &[u8]| {
            let is_whole = crc32fast::hash(bytes) == world.1;
            read = if is_whole { decode_world(&head, bytes) } else { Err("its checksum is wrong".to_string()) };
        };
        source.with(at, world.0 as usize, decode).map_err(io)?;
        let (text, nodes, extra) = read.map_err(|reason| damaged("the world", at, reason))?;
        let mut file = Self {
            path: path.to_path_buf(),
            source,
            head,
            text,
            nodes,
            extra,
            sky: Vec::new(),
            blocks: Vec::new(),
            world,
        };
        if head.part.is_some() || !file.read_tail(size) {
            file.find_blocks();
        }
        Ok(file)
    }

    /// Reads the table of blocks at the tail; false when it is lost.
    fn read_tail(&mut self, size: u64) -> bool {
        let blocks = self.head.blocks() as usize;
        let length = (blocks * TABLE_ENTRY + 4 * self.head.nodes as usize) as u64;
        let Some(start) = size.checked_sub(END as u64 + length).filter(|&s| s >= HEADER as u64 + self.world.0) else {
            return false;
        };
        let Ok(tail) = bytes_at(&*self.source, start, length as usize) else { return false };
        let Ok(end) = bytes_at(&*self.source, start + length, END) else { return false };
        let mut reader = Reader::new(&end);
        let named = (reader.long().unwrap_or(0), reader.word().unwrap_or(0));
        if named != (length, crc32fast::hash(&tail)) || reader.take(8) != Ok(&END_MAGIC[..]) {
            return false;
        }
        let mut reader = Reader::new(&tail);
        for _ in 0..blocks {
            let (Ok(offset), Ok(length), Ok(_)) = (reader.long(), reader.word(), reader.word()) else { return false };
            self.blocks.push(Ok((offset, length)));
        }
        self.sky = (0..self.head.nodes).filter_map(|_| reader.float().ok()).collect();
        self.sky.iter().all(|&sky| is_share(sky))
    }

    /// Finds blocks one after the other; those behind a gap are lost.
    fn find_blocks(&mut self) {
        self.blocks.clear();
        self.sky.clear();
        let mut offset = HEADER as u64 + self.world.0;
        for number in self.head.own_blocks() {
            let found = block_at(&*self.source, offset, number).ok_or_else(|| {
                let reason = "it is not there, and neither is the table of blocks".to_string();
                BakeError::Block { path: self.path.display().to_string(), block: number, offset, reason }
            });
            if let Ok((_, length)) = found {
                offset += u64::from(length);
            }
            self.blocks.push(found);
        }
    }

    /// Offset and length of a block.
    ///
    /// # Errors
    /// [`BakeError::Block`] for one that is lost.
    pub fn place(&self, block: u32) -> Result<(u64, u32), BakeError> {
        let own = self.head.own_blocks();
        match block.checked_sub(own.start).and_then(|k| self.blocks.get(k as usize)) {
            Some(place) => place.clone(),
            None => Err(BakeError::Setting { name: "block", found: u64::from(block), rule: "one of the file's" }),
        }
    }

    /// Bytes of a block, checked, and where its rows begin.
    ///
    /// # Errors
    /// [`BakeError::Block`] with the block's number and offset.
    pub fn read_block(&self, block: u32) -> Result<(Vec<u8>, Vec<u32>), BakeError> {
        let place = self.place(block)?;
        read_block(&*self.source, &self.path, &self.head, block, place)
    }

    /// All records of a block.
    ///
    /// # Errors
    /// [`BakeError::Block`] with the block's number and offset.
    pub fn records(&self, block: u32) -> Result<Vec<Record>, BakeError> {
        let (bytes, starts) = self.read_block(block)?;
        let record = |start: &u32| decode_row(&bytes[*start as usize..], self.head.nodes);
        starts.iter().map(record).collect::<Result<_, String>>().map_err(|reason| self.block_error(block, reason))
    }

    pub(super) fn block_error(&self, block: u32, reason: String) -> BakeError {
        let offset = self.place(block).map_or(0, |place| place.0);
        BakeError::Block { path: self.path.display().to_string(), block, offset, reason }
    }

    /// Known losses: blocks, and the table at the end of a whole bake, without which no light of the sky comes to
    /// merged patches.
    pub fn lost(&self) -> impl Iterator<Item = BakeError> {
        let has_tail = self.head.part.is_some() || self.sky.len() == self.nodes.len();
        let tail = (!has_tail).then(|| BakeError::Damaged {
            path: self.path.display().to_string(),
            part: "the table at its end",
            offset: self.source.len().unwrap_or(0),
            reason: "its checksum or its numbers are wrong".to_string(),
        });
        self.blocks.iter().filter_map(|block| block.as_ref().err().cloned()).chain(tail)
    }

    /// Reads and checks every block of the file.
    ///
    /// # Errors
    /// The first block that is wrong.
    pub fn check(&self) -> Result<(), BakeError> {
        self.head.own_blocks().try_for_each(|block| self.records(block).map(drop))
    }

    /// Bytes of the file.
    ///
    /// # Errors
    /// The system's.
    pub fn bytes(&self) -> Result<u64, BakeError> {
        self.source.len().map_err(|e| file_error(&self.path, &e))
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// As [`BakeFile::read_block`].
pub(super) fn read_block(
    source: &dyn Source,
    path: &Path,
    head: &WorldHead,
    block: u32,
    (offset, length): (u64, u32),
) -> Result<(Vec<u8>, Vec<u32>), BakeError> {
    let fault = |reason| BakeError::Block { path: path.display().to_string(), block, offset, reason };
    let bytes = bytes_at(source, offset, length as usize).map_err(|e| match e.kind() {
        ErrorKind::UnexpectedEof => fault(e.to_string()),
        _ => file_error(path, &e),
    })?;
    let starts = check_block(block, block_range(head, block), &bytes).map_err(fault)?;
    Ok((bytes, starts))
}
