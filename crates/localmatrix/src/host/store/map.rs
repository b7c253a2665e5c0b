//! Bytes of a file, mapped into memory where they are needed and no longer: the only unsafe code of this crate.
#![allow(unsafe_code)]

use std::boxed::Box;
use std::fmt::Debug;
use std::fs::File;
use std::io::{Error, ErrorKind};
use std::path::Path;

use memmap2::MmapOptions;

/// Source of a bake's bytes.
pub trait Source: Send + Debug {
    /// Bytes that there are now.
    ///
    /// # Errors
    /// The system's.
    fn len(&self) -> std::io::Result<u64>;

    /// Returns true if there are none.
    ///
    /// # Errors
    /// The system's.
    fn is_empty(&self) -> std::io::Result<bool> {
        Ok(self.len()? == 0)
    }

    /// Hands `length` bytes from `offset` on to `use_bytes`.
    ///
    /// # Errors
    /// `UnexpectedEof` when there are fewer; the system's.
    fn with(&self, offset: u64, length: usize, use_bytes: &mut dyn FnMut(&[u8])) -> std::io::Result<()>;

    /// Another reader of the bytes, for another thread.
    ///
    /// # Errors
    /// The system's.
    fn again(&self) -> std::io::Result<Box<dyn Source>>;
}

/// A file, of which a block at a time is mapped: what is not asked for is not resident.
#[derive(Debug)]
pub struct Mapped {
    file: File,
}

impl Mapped {
    /// Opens a file.
    ///
    /// # Errors
    /// The system's.
    pub fn open(path: &Path) -> std::io::Result<Self> {
        Ok(Self { file: scene::host::open_regular(path)? })
    }

    /// Reads the readable part of an open file.
    pub fn of(file: File) -> Self {
        Self { file }
    }
}

impl Source for Mapped {
    fn len(&self) -> std::io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    fn with(&self, offset: u64, length: usize, use_bytes: &mut dyn FnMut(&[u8])) -> std::io::Result<()> {
        let end = offset.checked_add(length as u64);
        // Asked each time: touching a page behind the end would end the process.
        if end.is_none_or(|end| self.len().is_ok_and(|len| end > len)) {
            return Err(Error::new(ErrorKind::UnexpectedEof, "the file ends before"));
        }
        if length == 0 {
            use_bytes(&[]);
            return Ok(());
        }
        // SAFETY: The map is read only, lies within the file as it is now, and lives for this call, in which its bytes
        // are copied, summed or decoded. Who shortens the file in that instant ends this process by a signal; who
        // writes into it spoils a block, which its checksum tells.
        let map = unsafe { MmapOptions::new().offset(offset).len(length).map(&self.file)? };
        use_bytes(&map);
        Ok(())
    }

    fn again(&self) -> std::io::Result<Box<dyn Source>> {
        Ok(Box::new(Self { file: self.file.try_clone()? }))
    }
}
