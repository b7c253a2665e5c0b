//! The rows of a bake, read ahead by a thread of its own into a cache of bounded size.

use std::collections::{HashMap, VecDeque};
use std::path::PathBuf;
use std::string::ToString;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use std::vec::Vec;

use super::error::BakeError;
use super::file::{BakeFile, file_error, read_block};
use super::format::{Record, WorldHead, block_range, decode_row};
use crate::error::Error;
use crate::host::world::{Node, World};

/// A block in the cache.
#[derive(Debug)]
struct Block {
    bytes: Vec<u8>,
    starts: Vec<u32>,
    /// When it was last asked for.
    used: u64,
}

#[derive(Debug, Default)]
struct Cache {
    blocks: HashMap<u32, Block>,
    bytes: usize,
    /// Blocks to be read, the most urgent first.
    queue: VecDeque<u32>,
    lost: HashMap<u32, BakeError>,
    /// The block that is being read.
    reading: Option<u32>,
    clock: u64,
    reads: u64,
    stop: bool,
}

#[derive(Debug)]
struct Shared {
    cache: Mutex<Cache>,
    /// Something is to be read, or the thread is to end.
    work: Condvar,
    /// A block came.
    came: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Cache> {
        // The cache holds no half-made state: a thread that panicked left it as it was.
        self.cache.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Contents and pending requests of a [`Store`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StoreState {
    /// Blocks in the cache.
    pub blocks: usize,
    /// Their bytes.
    pub bytes: usize,
    /// Blocks still to be read.
    pub waiting: usize,
    /// Blocks read so far.
    pub reads: u64,
    /// Blocks that were lost.
    pub lost: usize,
}

/// A bake as a [`World`]: nodes in memory, rows as they are wanted. A row that is not there is `None`, at once.
#[derive(Debug)]
pub struct Store {
    nodes: Vec<Node>,
    sky: Vec<f32>,
    head: WorldHead,
    path: PathBuf,
    places: Arc<[Result<(u64, u32), BakeError>]>,
    limit: usize,
    shared: Arc<Shared>,
    reader: Option<JoinHandle<()>>,
}

impl Store {
    /// Starts the reader of a whole bake; its cache holds at most `limit` bytes of blocks, and at least one.
    ///
    /// # Errors
    /// [`BakeError::Kind`] for a part, [`BakeError::File`] when no thread can be started.
    pub fn new(file: BakeFile, limit: usize) -> Result<Self, BakeError> {
        if let Some(part) = file.head.part {
            let found = std::format!("part {} of {}", part.number, part.of);
            return Err(BakeError::Kind { path: file.path.display().to_string(), found, expected: "a whole bake" });
        }
        let shared =
            Arc::new(Shared { cache: Mutex::new(Cache::default()), work: Condvar::new(), came: Condvar::new() });
        let source = file.source.again().map_err(|e| file_error(&file.path, &e))?;
        let places: Arc<[_]> = file.blocks.into();
        let theirs = Arc::clone(&shared);
        let path = file.path.clone();
        let head = file.head;
        let known = Arc::clone(&places);
        let read = move |block: u32| {
            let place = known.get(block as usize).cloned().unwrap_or_else(|| {
                Err(BakeError::Setting { name: "block", found: u64::from(block), rule: "one of the file's" })
            })?;
            read_block(&*source, &path, &head, block, place)
        };
        let reader = std::thread::Builder::new().name("bake reader".to_string());
        let reader = reader.spawn(move || read_ahead(&theirs, limit, read)).map_err(|e| file_error(&file.path, &e))?;
        let BakeFile { nodes, sky, head, path, .. } = file;
        let sky = if sky.is_empty() { vec![0.0; nodes.len()] } else { sky };
        Ok(Self { nodes, sky, head, path, places, limit, shared, reader: Some(reader) })
    }

    /// Sky factor of each node; 0 where the file's tail was lost.
    pub fn sky(&self) -> &[f32] {
        &self.sky
    }

    /// The record of a node, or `None` as long as it is not there.
    ///
    /// # Errors
    /// [`BakeError::Block`] where it was lost, each time it is asked for.
    pub fn record(&self, node: u32) -> Result<Option<Record>, BakeError> {
        if node >= self.head.nodes {
            return Err(BakeError::Setting { name: "node", found: u64::from(node), rule: "one of the file's" });
        }
        let number = self.head.block_of(node);
        let first = block_range(&self.head, number).start;
        let mut cache = self.shared.lock();
        cache.clock += 1;
        let now = cache.clock;
        if let Some(error) = cache.lost.get(&number) {
            return Err(error.clone());
        }
        let Some(block) = cache.blocks.get_mut(&number) else { return Ok(None) };
        block.used = now;
        let start = block.starts[(node - first) as usize] as usize;
        let record = decode_row(&block.bytes[start..], self.head.nodes).map_err(|reason| {
            let offset = self.places.get(number as usize).and_then(|p| p.as_ref().ok()).map_or(0, |p| p.0);
            BakeError::Block { path: self.path.display().to_string(), block: number, offset, reason }
        })?;
        Ok(Some(record))
    }

    /// Contents and pending requests.
    pub fn state(&self) -> StoreState {
        let cache = self.shared.lock();
        StoreState {
            blocks: cache.blocks.len(),
            bytes: cache.bytes,
            waiting: cache.queue.len() + usize::from(cache.reading.is_some()),
            reads: cache.reads,
            lost: cache.lost.len(),
        }
    }

    /// Waits until all that is wanted was read, at most so long; whether it was.
    pub fn settle(&self, longest: Duration) -> bool {
        let end = Instant::now() + longest;
        let mut cache = self.shared.lock();
        while !cache.queue.is_empty() || cache.reading.is_some() {
            let Some(left) = end.checked_duration_since(Instant::now()) else { return false };
            cache = self.shared.came.wait_timeout(cache, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }
}

/// The thread: reads what is wanted until it is told to stop.
fn read_ahead(shared: &Shared, limit: usize, read: impl Fn(u32) -> Result<(Vec<u8>, Vec<u32>), BakeError>) {
    let mut cache = shared.lock();
    loop {
        if cache.stop {
            return;
        }
        let Some(block) = cache.queue.pop_front() else {
            cache = shared.work.wait(cache).unwrap_or_else(PoisonError::into_inner);
            continue;
        };
        if cache.blocks.contains_key(&block) || cache.lost.contains_key(&block) {
            shared.came.notify_all();
            continue;
        }
        cache.reading = Some(block);
        drop(cache);
        let found = read(block);
        cache = shared.lock();
        cache.reading = None;
        cache.reads += 1;
        match found {
            Ok((bytes, starts)) => {
                let size = bytes.len() + 4 * starts.len();
                // Those that nobody asked for longest go, before the limit is exceeded.
                while cache.bytes + size > limit {
                    let Some(oldest) = cache.blocks.iter().min_by_key(|(k, b)| (b.used, **k)).map(|(k, _)| *k) else {
                        break;
                    };
                    if let Some(gone) = cache.blocks.remove(&oldest) {
                        cache.bytes -= gone.bytes.len() + 4 * gone.starts.len();
                    }
                }
                cache.clock += 1;
                let used = cache.clock;
                cache.bytes += size;
                cache.blocks.insert(block, Block { bytes, starts, used });
            }
            Err(error) => {
                cache.lost.insert(block, error);
            }
        }
        shared.came.notify_all();
    }
}

impl World for Store {
    fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    fn want(&mut self, nodes: &[u32]) {
        let mut cache = self.shared.lock();
        cache.queue.clear();
        cache.clock += 1;
        let now = cache.clock;
        let mut bytes = 0usize;
        let mut seen = std::collections::HashSet::new();
        for &node in nodes.iter().filter(|&&node| node < self.head.nodes) {
            let number = self.head.block_of(node);
            if !seen.insert(number) {
                continue;
            }
            let Some(Ok((_, length))) = self.places.get(number as usize) else {
                // Its error is found by the reader.
                cache.queue.push_back(number);
                continue;
            };
            // No more than the cache can hold, or the least urgent would drive out the most urgent.
            bytes += *length as usize + 4 * self.head.block_rows as usize;
            if bytes > self.limit && seen.len() > 1 {
                break;
            }
            match cache.blocks.get_mut(&number) {
                Some(block) => block.used = now,
                None => cache.queue.push_back(number),
            }
        }
        self.shared.work.notify_one();
    }

    fn row(&mut self, node: u32) -> Result<Option<Vec<(u32, f32)>>, Error> {
        Ok(self.record(node)?.map(|record| record.factors))
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.work.notify_one();
        if let Some(reader) = self.reader.take() {
            // A reader that panicked has nothing left to do.
            let _ = reader.join();
        }
    }
}
