//! Native code: each pass by the host form of its kernel, on all cores. Needs no driver.

use std::collections::{HashMap, VecDeque};
use std::fmt;
use std::ops;
use std::sync::Arc;

use gpu_kernels::host::{HostBinding, HostCall};
use web_time::Instant;

use crate::executor::{DeviceInfo, DeviceKind, Executor, ExecutorError, KEPT_TIMES, PassTime, ReadId};
use crate::graph::{Graph, Slot};
use crate::plan::{Bound, BufferId, BufferKind, Pass, PassId, Plan};
use crate::recipe::Table;

/// Runs plans as native code.
pub struct Cpu {
    info: DeviceInfo,
    graph: Graph,
    memory: Vec<Block>,
    /// Times of submitted passes until they are asked for.
    finished: VecDeque<Vec<PassTime>>,
    /// Bytes of reads until they are asked for, and the number of reads so far.
    reads: HashMap<ReadId, Vec<u8>>,
    read_count: u64,
}

/// Bytes on a 16-byte boundary, as every table needs: zeros until something is written, or a table that is shared.
#[derive(Default)]
struct Block {
    /// Empty, though reserved, until something is written.
    words: Vec<u128>,
    count: usize,
    shared: Option<Arc<dyn Table>>,
}

impl Block {
    fn new(bytes: u64) -> Option<Self> {
        let count = usize::try_from(bytes.div_ceil(16)).ok()?;
        let mut words = Vec::new();
        words.try_reserve_exact(count).ok()?;
        Some(Self { words, count, shared: None })
    }

    /// Keeps a table in place of a copy; says whether it can.
    fn share(&mut self, table: &Arc<dyn Table>) -> bool {
        let is_aligned = table.bytes().as_ptr().align_offset(16) == 0;
        if is_aligned {
            self.words = Vec::new();
            self.shared = Some(Arc::clone(table));
        }
        is_aligned
    }

    /// Makes zeros where nothing was written yet.
    fn make_ready(&mut self) {
        if self.shared.is_none() {
            self.words.resize(self.count, 0);
        }
    }

    /// The bytes; of a block that is ready.
    fn bytes(&self) -> &[u8] {
        match &self.shared {
            Some(table) => table.bytes(),
            None => bytemuck::cast_slice(&self.words),
        }
    }

    /// The bytes to write to: a copy of its own where they were shared.
    fn bytes_mut(&mut self) -> &mut [u8] {
        self.words.resize(self.count, 0);
        if let Some(table) = self.shared.take() {
            let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut self.words);
            bytes[..table.bytes().len()].copy_from_slice(table.bytes());
        }
        bytemuck::cast_slice_mut(&mut self.words)
    }
}

impl Cpu {
    /// An executor without a plan.
    pub fn new() -> Self {
        let info = DeviceInfo {
            name: processor_name(),
            kind: DeviceKind::Native,
            index: None,
            driver: format!("{} threads", rayon::current_num_threads()),
            api_version: String::new(),
            memory_bytes: 0,
            max_storage_buffer_range: u64::MAX,
            max_image_edge: u32::MAX,
            has_block_images: true,
            shared_memory_bytes: 0,
            subgroup_size: 1,
            has_timestamps: false,
            missing_feature: None,
            has_validation: false,
        };
        Self {
            info,
            graph: Graph::default(),
            memory: Vec::new(),
            finished: VecDeque::new(),
            reads: HashMap::new(),
            read_count: 0,
        }
    }

    fn run_pass(&mut self, id: PassId) -> Result<(), ExecutorError> {
        let pass = &self.graph.plan().passes()[id.0];
        if pass.invocations == 0 {
            return Ok(());
        }
        let mut bindings = borrow(&self.graph, pass, &mut self.memory);
        let mut call = HostCall { invocations: pass.invocations, push: &pass.push, bindings: &mut bindings };
        pass.kernel.run_on_host(&mut call).map_err(|source| ExecutorError::Host { pass: pass.name.clone(), source })
    }
}

impl fmt::Debug for Cpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Cpu").field("info", &self.info).finish_non_exhaustive()
    }
}

impl Default for Cpu {
    fn default() -> Self {
        Self::new()
    }
}

/// Lends a pass its ranges: shared where it only reads a buffer, else cut out of it (a plan has no overlap there).
fn borrow<'a>(graph: &Graph, pass: &Pass, memory: &'a mut [Block]) -> Vec<HostBinding<'a>> {
    let mut lent: Vec<Option<HostBinding<'a>>> = pass.bound.iter().map(|_| None).collect();
    for (slot, block) in memory.iter_mut().enumerate() {
        let mut here: Vec<(usize, &Bound)> =
            pass.bound.iter().enumerate().filter(|(_, b)| graph.slot_of(b.buffer) == slot).collect();
        if here.is_empty() {
            continue;
        }
        if here.iter().all(|(_, b)| !b.writes) {
            block.make_ready();
            let bytes = block.bytes();
            let owner = block.shared.as_ref().and_then(|table| table.owner());
            for (k, bound) in here {
                let part = &bytes[bound.offset as usize..(bound.offset + bound.bytes) as usize];
                lent[k] = Some(match graph.plan().buffers()[bound.buffer.0].kind {
                    BufferKind::Image { format, width, height } => {
                        HostBinding::Image { format, width, height, texels: part }
                    }
                    _ => match owner {
                        Some(owner) if part.len() == bytes.len() => HostBinding::Part(part, owner),
                        _ => HostBinding::Read(part),
                    },
                });
            }
            continue;
        }
        here.sort_by_key(|(_, b)| b.offset);
        let mut rest = block.bytes_mut();
        let mut start = 0;
        for (k, bound) in here {
            let (_, after) = rest.split_at_mut((bound.offset - start) as usize);
            let (part, after) = after.split_at_mut(bound.bytes as usize);
            (rest, start) = (after, bound.offset + bound.bytes);
            lent[k] = Some(if bound.writes { HostBinding::Write(part) } else { HostBinding::Read(part) });
        }
    }
    lent.into_iter().flatten().collect()
}

impl Executor for Cpu {
    fn device(&self) -> &DeviceInfo {
        &self.info
    }

    fn load(&mut self, plan: Plan) -> Result<(), ExecutorError> {
        self.memory.clear();
        self.graph = Graph::default();
        let graph = Graph::new(plan);
        self.memory = blocks(&graph, 0)?;
        self.graph = graph;
        Ok(())
    }

    fn load_after(&mut self, plan: Plan, section: usize) -> Result<(), ExecutorError> {
        let mut kept = self.graph.plan().clone();
        kept.truncate(section);
        let kept = self.graph.replaced_after(kept, section)?;
        let graph = self.graph.replaced_after(plan, section)?;
        let first = kept.slots_before(section);
        // The memory of what is replaced goes first.
        self.memory.truncate(first);
        self.graph = kept;
        self.memory.extend(blocks(&graph, first)?);
        self.graph = graph;
        Ok(())
    }

    fn plan(&self) -> &Plan {
        self.graph.plan()
    }

    fn upload_at(&mut self, buffer: BufferId, offset: u64, bytes: &[u8]) -> Result<(), ExecutorError> {
        self.graph.note_upload(buffer, offset, bytes.len() as u64)?;
        let offset = offset as usize;
        self.memory[self.graph.slot_of(buffer)].bytes_mut()[offset..offset + bytes.len()].copy_from_slice(bytes);
        Ok(())
    }

    fn clear(&mut self, buffer: BufferId) -> Result<(), ExecutorError> {
        self.graph.note_clear(buffer)?;
        self.memory[self.graph.slot_of(buffer)].bytes_mut().fill(0);
        Ok(())
    }

    fn share(&mut self, buffer: BufferId, table: Arc<dyn Table>) -> Result<(), ExecutorError> {
        let bytes = table.bytes().len() as u64;
        self.graph.note_upload(buffer, 0, bytes)?;
        let is_whole = self.graph.plan().buffer(buffer)?.bytes == bytes;
        if is_whole && self.memory[self.graph.slot_of(buffer)].share(&table) {
            return Ok(());
        }
        self.upload_at(buffer, 0, table.bytes())
    }

    fn share_changed(
        &mut self,
        buffer: BufferId,
        table: Arc<dyn Table>,
        _changed: &[ops::Range<usize>],
    ) -> Result<(), ExecutorError> {
        self.share(buffer, table)
    }

    fn set_push(&mut self, pass: PassId, push: &[u8]) -> Result<(), ExecutorError> {
        Ok(self.graph.set_push(pass, push)?)
    }

    fn run_passes(&mut self, passes: &[PassId]) -> Result<Vec<PassTime>, ExecutorError> {
        self.graph.note_run(passes)?;
        let mut times = Vec::with_capacity(passes.len());
        for &id in passes {
            let start = Instant::now();
            self.run_pass(id)?;
            let milliseconds = start.elapsed().as_secs_f64() * 1e3;
            times.push(PassTime::of_pass(&self.graph.plan().passes()[id.0], milliseconds));
        }
        Ok(times)
    }

    fn submit_passes(&mut self, passes: &[PassId]) -> Result<(), ExecutorError> {
        let times = self.run_passes(passes)?;
        if self.finished.len() == KEPT_TIMES {
            self.finished.pop_front();
        }
        self.finished.push_back(times);
        Ok(())
    }

    fn wait(&mut self) -> Result<Vec<PassTime>, ExecutorError> {
        Ok(self.finished.drain(..).flatten().collect())
    }

    fn finished_times(&mut self) -> Result<Vec<PassTime>, ExecutorError> {
        self.wait()
    }

    fn download(&mut self, buffer: BufferId) -> Result<Vec<u8>, ExecutorError> {
        let bytes = self.graph.check_download(buffer)? as usize;
        let block = &mut self.memory[self.graph.slot_of(buffer)];
        block.make_ready();
        Ok(block.bytes()[..bytes].to_vec())
    }

    fn begin_read(&mut self, buffer: BufferId) -> Result<ReadId, ExecutorError> {
        let bytes = self.download(buffer)?;
        let read = ReadId(self.read_count);
        self.read_count += 1;
        self.reads.insert(read, bytes);
        Ok(read)
    }

    fn try_read(&mut self, read: ReadId) -> Result<Option<Vec<u8>>, ExecutorError> {
        Ok(self.reads.remove(&read))
    }
}

/// Memory of the slots of a graph from number `first` on.
fn blocks(graph: &Graph, first: usize) -> Result<Vec<Block>, ExecutorError> {
    let block = |slot: &Slot| {
        Block::new(slot.bytes).ok_or_else(|| ExecutorError::OutOfMemory {
            buffer: graph.plan().buffers()[slot.buffer.0].name.clone(),
            bytes: slot.bytes,
        })
    };
    graph.slots()[first..].iter().map(block).collect()
}

/// The processor as Linux names it; elsewhere its architecture.
pub fn processor_name() -> String {
    let table = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = table.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    let name = name.map_or(std::env::consts::ARCH, |(_, name)| name.trim());
    if name.contains("CPU") { name.to_owned() } else { format!("{name} CPU") }
}
