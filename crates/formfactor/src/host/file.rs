//! Rows of form factors on disk: a header, then blocks of rows, each followed by its checksum. All numbers
//! little-endian.

use std::fs::{self, File};
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::string::ToString;
use std::vec::Vec;

use crate::error::Error;
use transport::{Dense, check_length};

const MAGIC: [u8; 8] = *b"PLROWS\r\n";
const VERSION: u32 = 1;
const HEADER: usize = 40;
/// Bytes of a block, about: large enough for full disk speed, small enough to hold a few.
const BLOCK_BYTES: usize = 4 << 20;

/// Writes rows one after the other to a temporary file beside `path` that takes its name when all rows are there.
#[derive(Debug)]
pub struct RowFileWriter {
    path: PathBuf,
    temporary: PathBuf,
    out: Option<BufWriter<File>>,
    rows: usize,
    columns: usize,
    written: usize,
    checksum: crc32fast::Hasher,
}

/// A finished file of rows.
#[derive(Debug)]
pub struct RowFile {
    path: PathBuf,
    file: File,
    rows: usize,
    columns: usize,
    block_rows: usize,
}

fn file_error(path: &Path, error: &std::io::Error) -> Error {
    Error::File { path: path.display().to_string(), reason: error.to_string() }
}

fn block_rows(columns: usize) -> usize {
    (BLOCK_BYTES / (4 * columns.max(1))).max(1)
}

impl RowFileWriter {
    /// Begins a file of `rows` rows with `columns` numbers each.
    ///
    /// # Errors
    /// [`Error::File`] when the temporary file cannot be made.
    pub fn create(path: &Path, rows: usize, columns: usize) -> Result<Self, Error> {
        let mut name = path.file_name().unwrap_or_default().to_os_string();
        name.push(".part");
        let temporary = path.with_file_name(name);
        let file = File::create(&temporary).map_err(|e| file_error(&temporary, &e))?;
        let mut header = Vec::with_capacity(HEADER);
        header.extend(MAGIC);
        header.extend(VERSION.to_le_bytes());
        header.extend((rows as u64).to_le_bytes());
        header.extend((columns as u64).to_le_bytes());
        header.extend((block_rows(columns) as u64).to_le_bytes());
        header.extend(crc32fast::hash(&header).to_le_bytes());
        let mut writer = Self {
            path: path.to_path_buf(),
            temporary,
            out: Some(BufWriter::new(file)),
            rows,
            columns,
            written: 0,
            checksum: crc32fast::Hasher::new(),
        };
        writer.write(&header)?;
        Ok(writer)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), Error> {
        match &mut self.out {
            Some(out) => out.write_all(bytes).map_err(|e| file_error(&self.temporary, &e)),
            None => Ok(()),
        }
    }

    /// Appends whole rows.
    ///
    /// # Errors
    /// [`transport::Error::Length`] when `values` is not a whole number of rows or more than are still missing;
    /// [`Error::File`].
    pub fn push(&mut self, values: &[f32]) -> Result<(), Error> {
        let count = values.len().checked_div(self.columns).unwrap_or(0);
        check_length("rows", count.min(self.rows - self.written) * self.columns, values.len())?;
        let mut bytes = Vec::with_capacity(4 * self.columns);
        for row in values.chunks(self.columns.max(1)) {
            bytes.clear();
            bytes.extend(row.iter().flat_map(|x| x.to_le_bytes()));
            self.checksum.update(&bytes);
            self.write(&bytes)?;
            self.written += 1;
            if self.written.is_multiple_of(block_rows(self.columns)) || self.written == self.rows {
                let sum = std::mem::take(&mut self.checksum).finalize();
                self.write(&sum.to_le_bytes())?;
            }
        }
        Ok(())
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// [`transport::Error::Length`] when rows are missing, [`Error::File`].
    pub fn finish(mut self) -> Result<(), Error> {
        check_length("rows", self.rows, self.written)?;
        if let Some(out) = self.out.take() {
            let file = out.into_inner().map_err(|e| file_error(&self.temporary, e.error()))?;
            file.sync_all().map_err(|e| file_error(&self.temporary, &e))?;
        }
        fs::rename(&self.temporary, &self.path).map_err(|e| file_error(&self.path, &e))
    }
}

impl Drop for RowFileWriter {
    fn drop(&mut self) {
        // Only an unfinished file still has its writer; nobody can use it.
        if self.out.take().is_some() {
            let _ = fs::remove_file(&self.temporary);
        }
    }
}

impl RowFile {
    /// Opens a file and checks its header and size.
    ///
    /// # Errors
    /// [`Error::File`], or [`Error::FileContent`] for another kind of file, another version or a wrong size.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let io = |e: std::io::Error| file_error(path, &e);
        let content = |reason, expected: u64, found: u64| Error::FileContent {
            path: path.display().to_string(),
            reason,
            expected,
            found,
        };
        let mut file = File::open(path).map_err(io)?;
        let size = file.metadata().map_err(io)?.len();
        if size < HEADER as u64 {
            return Err(content("the file is too short for a header", HEADER as u64, size));
        }
        let mut header = [0u8; HEADER];
        file.read_exact(&mut header).map_err(io)?;
        let word = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
        let long = |at: usize| u64::from(word(at)) | u64::from(word(at + 4)) << 32;
        if header[..8] != MAGIC {
            return Err(content("the file does not hold rows of form factors", u64::from_le_bytes(MAGIC), long(0)));
        }
        if word(8) != VERSION {
            return Err(content("the file has another version", u64::from(VERSION), u64::from(word(8))));
        }
        let sum = crc32fast::hash(&header[..HEADER - 4]);
        if word(HEADER - 4) != sum {
            return Err(content("the header was altered", u64::from(sum), u64::from(word(HEADER - 4))));
        }
        let rows = long(12);
        let columns = long(20);
        let block = long(28);
        let expected = rows
            .checked_mul(columns)
            .and_then(|n| n.checked_mul(4))
            .and_then(|n| n.checked_add(4 * rows.div_ceil(block.max(1)) + HEADER as u64))
            .unwrap_or(u64::MAX);
        if size != expected || block == 0 {
            return Err(content("the file was cut or has something appended", expected, size));
        }
        let rows = rows as usize;
        let columns = columns as usize;
        let block_rows = block as usize;
        Ok(Self { path: path.to_path_buf(), file, rows, columns, block_rows })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Numbers a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.rows.div_ceil(self.block_rows)
    }

    /// Reads a block: its first row and its rows.
    ///
    /// # Errors
    /// [`transport::Error::Length`] for a block that does not exist, [`Error::FileContent`] when its checksum is wrong,
    /// [`Error::File`].
    pub fn read_block(&mut self, block: usize) -> Result<(usize, Dense), Error> {
        if block >= self.blocks() {
            return Err(transport::Error::Length { name: "blocks", expected: block + 1, found: self.blocks() }.into());
        }
        let first = block * self.block_rows;
        let rows = self.block_rows.min(self.rows - first);
        let start = HEADER + first * self.columns * 4 + block * 4;
        let mut bytes = vec![0u8; rows * self.columns * 4 + 4];
        self.file.seek(SeekFrom::Start(start as u64)).map_err(|e| file_error(&self.path, &e))?;
        self.file.read_exact(&mut bytes).map_err(|e| file_error(&self.path, &e))?;
        let (data, tail) = bytes.split_at(rows * self.columns * 4);
        let expected = crc32fast::hash(data);
        let found = u32::from_le_bytes([tail[0], tail[1], tail[2], tail[3]]);
        if expected != found {
            let path = self.path.display().to_string();
            let expected = u64::from(expected);
            let found = u64::from(found);
            return Err(Error::FileContent { path, reason: "a block of rows was altered", expected, found });
        }
        let values = data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        Ok((first, Dense { rows, columns: self.columns, values }))
    }

    /// Reads all rows.
    ///
    /// # Errors
    /// As [`RowFile::read_block`].
    pub fn read_all(&mut self) -> Result<Dense, Error> {
        let mut values = Vec::with_capacity(self.rows * self.columns);
        for block in 0..self.blocks() {
            values.extend(self.read_block(block)?.1.values);
        }
        Ok(Dense::new(self.rows, self.columns, values)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back_and_damage_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows");
        let rows = 5;
        let columns = 700_000;
        let dense = Dense::new(rows, columns, (0..rows * columns).map(|k| k as f32).collect()).unwrap();
        let mut writer = RowFileWriter::create(&path, rows, columns).unwrap();
        writer.push(&dense.values[..2 * columns]).unwrap();
        assert!(!path.exists());
        writer.push(&dense.values[2 * columns..]).unwrap();
        assert!(writer.push(dense.row(0)).is_err());
        writer.finish().unwrap();
        let mut file = RowFile::open(&path).unwrap();
        assert!(file.blocks() > 1);
        assert_eq!(file.read_all().unwrap(), dense);

        let bytes = fs::read(&path).unwrap();
        let damaged = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut copy = bytes.clone();
            change(&mut copy);
            let path = folder.path().join("damaged");
            fs::write(&path, copy).unwrap();
            RowFile::open(&path).and_then(|mut f| f.read_all()).unwrap_err()
        };
        let reason = |e: Error| match e {
            Error::FileContent { reason, .. } => reason,
            _ => "",
        };
        assert_eq!(reason(damaged(&|b| b.truncate(9_999_999))), "the file was cut or has something appended");
        assert_eq!(reason(damaged(&|b| b.truncate(7))), "the file is too short for a header");
        assert_eq!(reason(damaged(&|b| b[1_000_000] ^= 1)), "a block of rows was altered");
        assert_eq!(reason(damaged(&|b| b[13] ^= 1)), "the header was altered");
        assert_eq!(reason(damaged(&|b| b[8] = 2)), "the file has another version");
        assert_eq!(reason(damaged(&|b| b[0] = 0)), "the file does not hold rows of form factors");

        // An abandoned file leaves nothing behind.
        drop(RowFileWriter::create(&folder.path().join("abandoned"), 2, 2).unwrap());
        assert!(!folder.path().join("abandoned.part").exists());
    }
}
