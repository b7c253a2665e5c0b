//! Files of sections, each with its length and checksum: written beside their place and renamed when they are whole,
//! and gone on with after an interruption. The format stands in [`crate::file`].

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufWriter, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use localmatrix::{BakeError, Mapped, Source, beginning_of};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// First bytes of every bake.
const MAGIC: [u8; 8] = *b"PLBAKE\r\n";
/// Rises with every change of what the tables of a file mean, or of how they are made. Bakes of worlds have version 1.
pub const VERSION: u32 = 11;
/// Reads as another number where bytes have the other order.
const BYTE_ORDER: u32 = 0x0102_0304;
const HEADER: usize = 56;
const SECTION_MAGIC: [u8; 4] = *b"PART";
const SECTION_HEADER: usize = 24;

/// Content of a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Kind {
    /// Source of the bake, and its settings.
    Origin = 1,
    /// Geometry, materials and lighting.
    Scene,
    /// Patches and elements.
    Patches,
    /// Their form factors.
    FormFactors,
    /// Receivers and interpolation points.
    Receivers,
    /// An operator of a method.
    Operator,
    /// Nothing: the file is whole.
    End,
    /// Form factors of elements alone, of which those of patches are made again.
    ElementRows,
}

impl Kind {
    const ALL: [Self; 8] = [
        Self::Origin,
        Self::Scene,
        Self::Patches,
        Self::FormFactors,
        Self::Receivers,
        Self::Operator,
        Self::End,
        Self::ElementRows,
    ];

    /// Its name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Origin => "origin",
            Self::Scene => "scene",
            Self::Patches => "patches",
            Self::FormFactors => "form factors",
            Self::Receivers => "receivers",
            Self::Operator => "operator",
            Self::End => "end",
            Self::ElementRows => "form factors of elements",
        }
    }
}

/// Position of a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Section {
    /// Its content.
    pub kind: Kind,
    /// First byte of its body.
    pub offset: u64,
    /// Bytes of its body.
    pub length: u64,
    sum: u32,
}

pub(crate) fn file_error(path: &Path, error: &io::Error) -> BakeError {
    BakeError::File { path: path.display().to_string(), reason: error.to_string() }
}

fn encode_header(key: &[u8; 32]) -> Vec<u8> {
    let mut out = Vec::with_capacity(HEADER);
    out.extend(MAGIC);
    out.extend(VERSION.to_le_bytes());
    out.extend(BYTE_ORDER.to_ne_bytes());
    out.extend(key);
    out.extend([0; 4]);
    out.extend(crc32fast::hash(&out).to_le_bytes());
    out
}

fn word(bytes: &[u8], at: usize) -> u32 {
    let mut four = [0; 4];
    four.copy_from_slice(&bytes[at..at + 4]);
    u32::from_le_bytes(four)
}

/// Bytes that tell a bake, and its version.
pub const HEAD_BYTES: u64 = 12;

/// The version of a bake by its first bytes; nothing for another kind of file.
pub fn version(head: &[u8]) -> Option<u32> {
    (head.len() as u64 >= HEAD_BYTES && head[..8] == MAGIC).then(|| word(head, 8))
}

/// The key of a header.
fn decode_header(path: &Path, bytes: &[u8]) -> Result<[u8; 32], BakeError> {
    let name = path.display().to_string();
    let Some(found) = version(bytes) else {
        let reason = if bytes.is_empty() { "it is empty" } else { "it does not begin as one" };
        return Err(BakeError::NotABake { path: name, reason: reason.to_owned() });
    };
    if found != VERSION {
        return Err(BakeError::Version { path: name, found, expected: VERSION });
    }
    let damaged = |reason: &str| BakeError::Damaged {
        path: name.clone(),
        part: "the header",
        offset: 0,
        reason: reason.to_owned(),
    };
    if bytes.len() < HEADER {
        return Err(damaged("it is too short"));
    }
    if word(bytes, HEADER - 4) != crc32fast::hash(&bytes[..HEADER - 4]) {
        return Err(damaged("its checksum is wrong"));
    }
    if bytes[12..16] != BYTE_ORDER.to_ne_bytes() {
        return Err(damaged("it was written on a machine with another order of bytes"));
    }
    let mut key = [0; 32];
    key.copy_from_slice(&bytes[16..48]);
    Ok(key)
}

fn encode_section(section: &Section) -> [u8; SECTION_HEADER] {
    let mut out = [0; SECTION_HEADER];
    out[..4].copy_from_slice(&SECTION_MAGIC);
    out[4..8].copy_from_slice(&(section.kind as u32).to_le_bytes());
    out[8..16].copy_from_slice(&section.length.to_le_bytes());
    out[16..20].copy_from_slice(&section.sum.to_le_bytes());
    let sum = crc32fast::hash(&out[..20]);
    out[20..].copy_from_slice(&sum.to_le_bytes());
    out
}

/// The section whose header begins at `at`, by the header alone.
fn decode_section(bytes: &[u8], at: u64) -> Option<Section> {
    if bytes.len() < SECTION_HEADER || bytes[..4] != SECTION_MAGIC || word(bytes, 20) != crc32fast::hash(&bytes[..20]) {
        return None;
    }
    let kind = Kind::ALL.into_iter().find(|kind| *kind as u32 == word(bytes, 4))?;
    let length = u64::from(word(bytes, 8)) | u64::from(word(bytes, 12)) << 32;
    Some(Section { kind, offset: at + SECTION_HEADER as u64, length, sum: word(bytes, 16) })
}

/// The header of the section at `at`; nothing where none begins there or its body ends behind the file.
fn section_at(source: &dyn Source, at: u64) -> io::Result<Option<Section>> {
    let all = source.len()?;
    if at + SECTION_HEADER as u64 > all {
        return Ok(None);
    }
    let mut section = None;
    source.with(at, SECTION_HEADER, &mut |bytes| section = decode_section(bytes, at))?;
    Ok(section.filter(|s: &Section| s.length <= all - s.offset))
}

/// Place of the bytes of sections.
#[derive(Debug)]
enum Held {
    /// In the file with the name of the sections.
    File,
    /// In memory, as a page gets them.
    Memory(Memory),
}

/// Bytes in memory.
#[derive(Clone, Debug)]
struct Memory(Arc<Vec<u8>>);

impl Held {
    /// A reader of its own for whoever asks.
    fn source(&self, path: &Path) -> Result<Box<dyn Source>, BakeError> {
        match self {
            Self::File => Ok(Box::new(Mapped::open(path).map_err(|error| file_error(path, &error))?)),
            Self::Memory(memory) => Ok(Box::new(memory.clone())),
        }
    }
}

impl Source for Memory {
    fn len(&self) -> io::Result<u64> {
        Ok(self.0.len() as u64)
    }

    fn with(&self, offset: u64, length: usize, use_bytes: &mut dyn FnMut(&[u8])) -> io::Result<()> {
        let own = usize::try_from(offset).ok().and_then(|begin| self.0.get(begin..begin.checked_add(length)?));
        use_bytes(own.ok_or_else(|| io::Error::new(ErrorKind::UnexpectedEof, "the bytes end before"))?);
        Ok(())
    }

    fn again(&self) -> io::Result<Box<dyn Source>> {
        Ok(Box::new(self.clone()))
    }
}

/// A file of sections that is read.
#[derive(Debug)]
pub struct Sections {
    path: PathBuf,
    held: Held,
    /// Hash of all that decides the bytes.
    pub key: [u8; 32],
    /// Its sections, without the end.
    pub all: Vec<Section>,
}

impl Sections {
    /// Opens a file and finds its sections; their bodies are not looked at.
    ///
    /// # Errors
    /// [`BakeError`]: another kind of file, another version, a header that was altered, an end that is missing.
    pub fn open(path: &Path) -> Result<Self, BakeError> {
        Self::of_source(path, Held::File)
    }

    /// Finds the sections of a file that is in memory; `name` is what errors call it.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn in_memory(name: &Path, bytes: Vec<u8>) -> Result<Self, BakeError> {
        Self::of_source(name, Held::Memory(Memory(Arc::new(bytes))))
    }

    fn of_source(path: &Path, held: Held) -> Result<Self, BakeError> {
        let io = |error: io::Error| file_error(path, &error);
        let source = held.source(path)?;
        let size = source.len().map_err(io)?;
        let mut key = Err(BakeError::NotABake { path: path.display().to_string(), reason: "it is empty".to_owned() });
        source.with(0, size.min(HEADER as u64) as usize, &mut |bytes| key = decode_header(path, bytes)).map_err(io)?;
        let mut sections = Self { path: path.to_path_buf(), held, key: key?, all: Vec::new() };
        let mut at = HEADER as u64;
        loop {
            let Some(section) = section_at(&*source, at).map_err(io)? else {
                return Err(sections.damaged("the table of contents", at, "no section begins there".to_owned()));
            };
            if section.kind == Kind::End {
                return Ok(sections);
            }
            at = section.offset + section.length;
            sections.all.push(section);
        }
    }

    fn damaged(&self, part: &'static str, offset: u64, reason: String) -> BakeError {
        BakeError::Damaged { path: self.path.display().to_string(), part, offset, reason }
    }

    /// A section of this kind; the first of several.
    ///
    /// # Errors
    /// [`BakeError::Damaged`] where there is none.
    pub fn of(&self, kind: Kind) -> Result<Section, BakeError> {
        let found = self.all.iter().find(|section| section.kind == kind).copied();
        found.ok_or_else(|| self.damaged(kind.name(), 0, "it is not there".to_owned()))
    }

    /// Checks a section and takes its body as a `T`; any thread may.
    ///
    /// # Errors
    /// [`BakeError::Damaged`], [`BakeError::File`].
    pub fn read<T: DeserializeOwned + Send>(&self, section: Section) -> Result<T, BakeError> {
        read(&self.path, &*self.held.source(&self.path)?, section)
    }
}

fn read<T: DeserializeOwned + Send>(path: &Path, source: &dyn Source, section: Section) -> Result<T, BakeError> {
    let damaged = |reason: String| BakeError::Damaged {
        path: path.display().to_string(),
        part: section.kind.name(),
        offset: section.offset,
        reason,
    };
    let mut value = Err(damaged("it is not there".to_owned()));
    let length = usize::try_from(section.length).map_err(|_| damaged("it is too long".to_owned()))?;
    let decode = &mut |bytes: &[u8]| {
        let (sum, decoded) = rayon::join(|| crc32fast::hash(bytes), || postcard::from_bytes(bytes));
        value = match sum == section.sum {
            true => decoded.map_err(|error| damaged(error.to_string())),
            false => Err(damaged("its checksum is wrong".to_owned())),
        };
    };
    source.with(section.offset, length, decode).map_err(|error| match error.kind() {
        ErrorKind::UnexpectedEof => damaged(error.to_string()),
        _ => file_error(path, &error),
    })?;
    value
}

/// Writes `PATH.beginning`, which takes its name when all sections are there.
#[derive(Debug)]
pub struct SectionWriter {
    path: PathBuf,
    beginning: PathBuf,
    file: File,
    /// Sections from before an interruption that nobody has taken yet, in their order.
    found: std::vec::IntoIter<Section>,
    end: u64,
}

impl SectionWriter {
    /// Begins a file, or goes on with one that was begun with the same key.
    ///
    /// # Errors
    /// [`BakeError::File`]; [`BakeError::NotABake`] where another kind of file has the name;
    /// [`BakeError::OtherBeginning`] where something else was begun under it, or another run is at it.
    pub fn begin(path: &Path, key: [u8; 32]) -> Result<Self, BakeError> {
        refuse_other_files(path)?;
        let beginning = beginning_of(path);
        let io = |error: io::Error| file_error(&beginning, &error);
        let other = |reason: &str| BakeError::OtherBeginning {
            path: beginning.display().to_string(),
            reason: reason.to_owned(),
        };
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&beginning).map_err(io)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(other("another run is writing it")),
            Err(TryLockError::Error(error)) => return Err(io(error)),
        }
        let mut header = Vec::new();
        Read::by_ref(&mut file).take(HEADER as u64).read_to_end(&mut header).map_err(io)?;
        let mut writer = Self {
            path: path.to_path_buf(),
            beginning: beginning.clone(),
            file,
            found: Vec::new().into_iter(),
            end: 0,
        };
        match decode_header(&beginning, &header) {
            Ok(own) if own == key => writer.find_sections().map_err(io)?,
            Ok(_) => return Err(other("another scene, or other settings")),
            Err(BakeError::Version { .. }) => return Err(other("another version, or a world")),
            Err(_) => {
                writer.file.set_len(0).map_err(io)?;
                writer.file.seek(SeekFrom::Start(0)).map_err(io)?;
                writer.file.write_all(&encode_header(&key)).map_err(io)?;
                writer.end = HEADER as u64;
            }
        }
        Ok(writer)
    }

    /// Finds the whole sections from before.
    fn find_sections(&mut self) -> io::Result<()> {
        let source = Mapped::of(self.file.try_clone()?);
        let mut found = Vec::new();
        self.end = HEADER as u64;
        while let Some(section) = section_at(&source, self.end)? {
            let mut is_whole = false;
            source.with(section.offset, section.length as usize, &mut |bytes| {
                is_whole = crc32fast::hash(bytes) == section.sum;
            })?;
            if !is_whole || section.kind == Kind::End {
                break;
            }
            self.end = section.offset + section.length;
            found.push(section);
        }
        self.found = found.into_iter();
        // What follows the last whole section is half of one.
        self.file.set_len(self.end)?;
        self.file.seek(SeekFrom::Start(self.end))?;
        Ok(())
    }

    /// Forgets what is there from before an interruption.
    ///
    /// # Errors
    /// [`BakeError::File`].
    pub fn start_over(&mut self) -> Result<(), BakeError> {
        self.found = Vec::new().into_iter();
        self.end = HEADER as u64;
        self.file.set_len(self.end).map_err(|error| file_error(&self.beginning, &error))
    }

    /// The next section, where it is there from before an interruption; else makes and writes it.
    ///
    /// # Errors
    /// [`BakeError`], and what `make` says.
    pub fn section<T, E>(&mut self, kind: Kind, make: impl FnOnce() -> Result<T, E>) -> Result<T, E>
    where
        T: Serialize + DeserializeOwned + Send,
        E: From<BakeError>,
    {
        if let Some(value) = self.take(kind)? {
            return Ok(value);
        }
        let value = make()?;
        self.put(kind, &value)?;
        Ok(value)
    }

    /// The next section from before an interruption.
    ///
    /// # Errors
    /// [`BakeError`]: it is of another kind, or no `T`.
    pub fn take<T: DeserializeOwned + Send>(&mut self, kind: Kind) -> Result<Option<T>, BakeError> {
        let Some(section) = self.found.next() else { return Ok(None) };
        if section.kind != kind {
            let reason = format!("{} where {} is next", section.kind.name(), kind.name());
            return Err(BakeError::OtherBeginning { path: self.beginning.display().to_string(), reason });
        }
        let source = Mapped::of(self.file.try_clone().map_err(|error| file_error(&self.beginning, &error))?);
        read(&self.beginning, &source, section).map(Some)
    }

    /// Adds a section.
    ///
    /// # Errors
    /// [`BakeError::File`].
    pub fn put<T: Serialize>(&mut self, kind: Kind, value: &T) -> Result<(), BakeError> {
        self.write(kind, value).map_err(|error| file_error(&self.beginning, &error))
    }

    fn write<T: Serialize>(&mut self, kind: Kind, value: &T) -> io::Result<()> {
        let offset = self.end + SECTION_HEADER as u64;
        // Its header comes last: a section with a header is whole.
        self.file.seek(SeekFrom::Start(self.end))?;
        self.file.write_all(&[0; SECTION_HEADER])?;
        let body = Body { out: &self.file, sum: crc32fast::Hasher::new(), length: 0, failed: None };
        let mut out = BufWriter::with_capacity(1 << 20, body);
        let coded = postcard::to_io(value, &mut out).map(drop);
        let flushed = out.flush();
        let (body, _) = out.into_parts();
        // What the system said is more than what the coder makes of it.
        if let Some(error) = body.failed {
            return Err(error);
        }
        flushed?;
        coded.map_err(io::Error::other)?;
        let section = Section { kind, offset, length: body.length, sum: body.sum.finalize() };
        self.file.seek(SeekFrom::Start(self.end))?;
        self.file.write_all(&encode_section(&section))?;
        self.end = offset + section.length;
        Ok(())
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// [`BakeError::File`].
    pub fn finish(mut self) -> Result<(), BakeError> {
        self.put(Kind::End, &())?;
        self.file.sync_all().map_err(|error| file_error(&self.beginning, &error))?;
        fs::rename(&self.beginning, &self.path).map_err(|error| file_error(&self.path, &error))
    }
}

/// A file that is no bake is not written over.
fn refuse_other_files(path: &Path) -> Result<(), BakeError> {
    let mut head = Vec::new();
    match scene::host::open_regular(path) {
        Ok(file) => file.take(HEAD_BYTES).read_to_end(&mut head).map_err(|error| file_error(path, &error))?,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(file_error(path, &error)),
    };
    if version(&head).is_none() {
        let reason = "and is not written over; choose another name".to_owned();
        return Err(BakeError::OtherBeginning { path: path.display().to_string(), reason });
    }
    Ok(())
}

/// The body of a section on its way into a file.
struct Body<'a> {
    out: &'a File,
    sum: crc32fast::Hasher,
    length: u64,
    failed: Option<io::Error>,
}

impl Write for Body<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.out.write(bytes) {
            Ok(count) => {
                self.sum.update(&bytes[..count]);
                self.length += count as u64;
                Ok(count)
            }
            Err(error) => {
                let kind = error.kind();
                self.failed.get_or_insert(error);
                Err(kind.into())
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
