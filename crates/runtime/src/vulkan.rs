//! Runs plans on a Vulkan device: any driver of Vulkan 1.2 with rust-gpu's memory model, loaded when the program runs;
//! or a device that the caller has already.
//!
//! The one place with unsafe code. `device` makes or borrows instance and device, `features` says what they must offer,
//! `buffer` owns memory, `pipeline` compiles rows of the kernel table, `sets` binds passes to buffers, `commands`
//! records, `staging` collects uploads, `queue` submits, `recording` fills a caller's command buffer.
#![allow(unsafe_code)]

mod buffer;
mod commands;
mod device;
mod error;
mod features;
mod memory;
mod messages;
mod pipeline;
mod queue;
mod reads;
mod recording;
mod resource;
mod sets;
mod staging;
mod work;

use std::any::Any;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use gpu_kernels::table::{BindingKind, ImageFormat, Kernel};

use self::buffer::{Buffer, Image};
use self::device::{Device, Instance};
use self::features::BLOCK_IMAGES;
use self::pipeline::Pipeline;
use self::queue::{Queue, Ticket};
use self::reads::Reads;
use self::recording::Recordings;
use self::resource::Resource;
use self::sets::Sets;
use self::staging::{STAGING_BYTES, Staging, record_download};
use self::work::Work;
use crate::executor::{DeviceChoice, DeviceInfo, Executor, ExecutorError, PassTime, ReadId};
use crate::graph::Graph;
use crate::plan::{BufferId, BufferKind, Pass, PassId, Plan};

/// The binding of Vulkan whose handles [`Vulkan::borrow`], [`Vulkan::begin_recording`] and [`BufferHandle`] name.
pub use ash;

pub use self::device::{BorrowedDevice, describe_device};
pub use self::error::Error;
pub use self::features::{API_VERSION, EnabledFeatures, FEATURES, Feature, enable_features};
pub use self::memory::{Memory, MemoryRequest};
pub use self::messages::{Messages, Messenger, VALIDATION_LAYER, Validation, has_validation_layer};
pub use self::recording::MAX_FRAMES;
pub use self::resource::BufferHandle;

/// All Vulkan devices in the loader's order, those that lack a feature too.
///
/// # Errors
/// No loader, no driver.
pub fn devices() -> Result<Vec<DeviceInfo>, Error> {
    let instance = Instance::new(Validation::Off)?;
    Ok(instance.devices()?.into_iter().map(|candidate| candidate.info).collect())
}

/// Runs plans on a Vulkan device, its own or a caller's.
pub struct Vulkan {
    // Fields end from the first to the last. The queue waits for everything in flight before anything that it uses
    // goes; each holds the device by an `Arc`, the last one frees it.
    queue: Queue,
    recordings: Recordings,
    sets: Option<Sets>,
    resources: Vec<Resource>,
    /// By the address of the kernel's row.
    pipelines: HashMap<usize, Arc<Pipeline>>,
    to_host: Option<Buffer>,
    reads: Reads,
    graph: Graph,
    device: Arc<Device>,
    host_clock: bool,
    /// Owner that must outlive a borrowed device.
    owner: Option<Arc<dyn Any + Send + Sync>>,
}

impl Vulkan {
    /// Opens the device that answers to the choice, the best kind first.
    ///
    /// # Errors
    /// No loader, no driver, no such device (the message lists those there are), a missing feature, a missing layer.
    pub fn open(choice: &DeviceChoice, validation: Validation) -> Result<Self, Error> {
        let instance = Instance::new(validation)?;
        let candidate = device::choose(instance.devices()?, choice)?;
        Self::with_device(Device::new(instance, candidate)?)
    }

    /// Runs plans on a caller's device and queue. Memory, pipelines and all else that the executor makes on the device
    /// goes with the executor, which waits for its own submissions only; instance, device and queue stay the caller's.
    ///
    /// The device must be made with [`FEATURES`] ([`enable_features`] fills the structures). What the validation layer
    /// says goes to the caller's own messenger; [`Vulkan::messages`] stays empty.
    ///
    /// # Errors
    /// A feature that the physical device lacks or that was not enabled, a queue family without compute: the error
    /// names it and the remedy.
    ///
    /// # Safety
    /// - All handles are alive and belong together: the device was made from the physical device of the instance, the
    ///   queue is the device's, of the family named. They outlive the executor.
    /// - The instance was made for [`API_VERSION`] or newer, the device with the features that `enabled` says.
    /// - While a method of the executor runs, and while it is dropped, no other thread uses the queue.
    pub unsafe fn borrow(caller: BorrowedDevice) -> Result<Self, Error> {
        // SAFETY: as the caller promises.
        Self::with_device(unsafe { Device::borrow(caller) }?)
    }

    /// Keeps the owner of a borrowed device, which ends it when it is dropped, until the executor has ended.
    pub fn keep_alive(&mut self, owner: Arc<dyn Any + Send + Sync>) {
        self.owner = Some(owner);
    }

    fn with_device(device: Device) -> Result<Self, Error> {
        let device = Arc::new(device);
        let vulkan = Self {
            queue: Queue::new(&device)?,
            recordings: Recordings::default(),
            sets: None,
            resources: Vec::new(),
            pipelines: HashMap::new(),
            to_host: None,
            reads: Reads::default(),
            graph: Graph::default(),
            host_clock: !device.info.has_timestamps,
            device,
            owner: None,
        };
        vulkan.device.check_messages()?;
        Ok(vulkan)
    }

    /// The validation layer's messages. They outlive the executor, so that what is said while it ends can be read. A
    /// call that finds messages takes them and fails with [`Error::Validation`].
    pub fn messages(&self) -> Messages {
        self.device.instance.messages.clone()
    }

    /// Lets all buffers and pictures together take so many bytes, what is loaded already among them: a plan that needs
    /// more is refused with [`Error::OutOfMemory`], as if the device had no more.
    pub fn limit_memory(&mut self, bytes: u64) {
        self.device.memory_budget.store(bytes, Ordering::Relaxed);
    }

    /// Times each pass of [`Executor::run_passes`] by the host's clock, with a submission of its own, as on devices
    /// without timestamps.
    pub fn use_host_clock(&mut self) {
        self.host_clock = true;
    }

    /// Waits for everything in flight; from now on `count` submissions (at least 1; 4 unless this is called) may be in
    /// flight before [`Executor::submit_passes`] or an upload waits for the oldest one. Each takes 16 MiB of memory
    /// that the host sees once it uploads.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_submissions_in_flight(&mut self, count: usize) -> Result<(), Error> {
        self.queue.resize(count)?;
        self.device.check_messages()
    }

    /// A storage buffer of the loaded plan, for the caller's own shaders on the same device; see [`BufferHandle`] for
    /// layout and lifetime. `None` for pictures, scratch buffers and unknown buffers.
    ///
    /// Contents are those of the last submission: a command of the caller on the same queue sees them after a memory
    /// barrier from `VK_PIPELINE_STAGE_ALL_COMMANDS_BIT` (recordings end with one), one on another queue after a
    /// semaphore.
    pub fn buffer(&self, id: BufferId) -> Option<BufferHandle> {
        let spec = self.graph.plan().buffer(id).ok()?;
        if spec.kind != BufferKind::Storage {
            return None;
        }
        match self.resources.get(self.graph.slot_of(id))? {
            Resource::Buffer(buffer) => Some(BufferHandle { buffer: buffer.raw, offset: 0, bytes: spec.bytes }),
            Resource::Image(_) => None,
        }
    }

    /// Resources of the slots of a graph from number `first` on.
    fn make_resources(&self, graph: &Graph, first: usize) -> Result<Vec<Resource>, Error> {
        let slots = &graph.slots()[first..];
        let mut resources = Vec::with_capacity(slots.len());
        for slot in slots {
            let spec = &graph.plan().buffers()[slot.buffer.0];
            resources.push(match spec.kind {
                BufferKind::Image { format, width, height } => {
                    self.check_picture(&spec.name, format, width, height)?;
                    Resource::Image(Image::new(&self.device, &spec.name, format, width, height, spec.bytes)?)
                }
                BufferKind::Storage | BufferKind::Scratch => {
                    // Whole words, so that filling with zeros reaches the last byte.
                    let bytes = slot.bytes.next_multiple_of(16);
                    Resource::Buffer(Buffer::storage(&self.device, &spec.name, bytes)?)
                }
            });
        }
        Ok(resources)
    }

    fn check_picture(&self, name: &str, format: ImageFormat, width: u32, height: u32) -> Result<(), Error> {
        if format.block_edge() > 1 && !self.device.info.has_block_images {
            let remedy = "use the kernel that decodes blocks from a buffer";
            return Err(self.device.limit(format!("picture `{name}`"), BLOCK_IMAGES, 0, 1, remedy));
        }
        let limit = self.device.limits.max_image_dimension2_d;
        let asked = width.max(height);
        if width == 0 || height == 0 || asked > limit {
            let remedy = "use the form of the kernel that takes a buffer";
            let what = format!("picture `{name}` of {width} x {height}");
            return Err(self.device.limit(what, "maxImageDimension2D", limit.into(), asked.into(), remedy));
        }
        Ok(())
    }

    fn check_pass(&self, plan: &Plan, pass: &Pass) -> Result<(), Error> {
        self.check_groups(pass, pass.invocations)?;
        let limit = u64::from(self.device.limits.max_storage_buffer_range);
        for (bound, binding) in pass.bound.iter().zip(pass.kernel.bindings) {
            if matches!(binding.kind, BindingKind::Storage { .. }) && bound.bytes > limit {
                let what = format!("pass `{}`, buffer `{}`", pass.name, plan.buffers()[bound.buffer.0].name);
                let remedy = "bind it in blocks of rows, one pass each";
                return Err(self.device.limit(what, "maxStorageBufferRange", limit, bound.bytes, remedy));
            }
        }
        Ok(())
    }

    fn check_groups(&self, pass: &Pass, invocations: u32) -> Result<(), Error> {
        let limit = self.device.limits.max_compute_work_group_count[1];
        let rows = pass.kernel.groups(invocations)[1];
        if rows > limit {
            let what = format!("pass `{}` with {invocations} invocations", pass.name);
            let remedy = "split it into several passes";
            return Err(self.device.limit(what, "maxComputeWorkGroupCount", limit.into(), rows.into(), remedy));
        }
        Ok(())
    }

    fn pipeline(&mut self, kernel: &'static Kernel) -> Result<Arc<Pipeline>, Error> {
        let key = std::ptr::from_ref(kernel).addr();
        if let Some(pipeline) = self.pipelines.get(&key) {
            return Ok(Arc::clone(pipeline));
        }
        let pipeline = Arc::new(Pipeline::new(&self.device, kernel)?);
        self.pipelines.insert(key, Arc::clone(&pipeline));
        Ok(pipeline)
    }

    /// Loads a graph whose first `kept` slots are those of the loaded one. Nothing is in flight.
    fn load_graph(&mut self, graph: Graph, kept: usize) -> Result<(), Error> {
        let plan = graph.plan();
        for pass in plan.passes() {
            self.check_pass(plan, pass)?;
        }
        let pipelines = self.pipelines_of(plan)?;
        let resources = self.make_resources(&graph, kept)?;
        self.resources.extend(resources);
        self.graph = graph;
        self.initialise_resources(kept)?;
        self.sets = Some(Sets::new(&self.device, &self.graph, &self.resources, pipelines)?);
        self.device.check_messages()
    }

    fn pipelines_of(&mut self, plan: &Plan) -> Result<Vec<Arc<Pipeline>>, Error> {
        plan.passes().iter().map(|pass| self.pipeline(pass.kernel)).collect()
    }

    /// Lets go of the loaded plan from a section on. Nothing is in flight.
    fn unload_after(&mut self, section: usize) -> Result<(), ExecutorError> {
        let mut plan = self.graph.plan().clone();
        plan.truncate(section);
        let graph = self.graph.replaced_after(plan, section)?;
        self.sets = None;
        self.resources.truncate(graph.slots_before(section));
        self.graph = graph;
        Ok(())
    }

    /// Fills new buffers and pictures, from slot `first` on, with zeros and brings pictures into the layout that
    /// kernels fetch from.
    fn initialise_resources(&mut self, first: usize) -> Result<(), Error> {
        let resources = &self.resources[first..];
        // SAFETY: the resources go in `unload` and `unload_after`, before which everything in flight is waited for.
        unsafe {
            self.queue.submit(Vec::new(), |commands, _, _| {
                for resource in resources {
                    resource.initialise(commands);
                }
            })?;
        }
        for slot in first..self.resources.len() {
            if self.resources[slot].is_blocks() {
                self.clear_slot(slot)?;
            }
        }
        Ok(())
    }

    /// Waits for everything in flight, then lets the plan and what belongs to it go.
    fn unload(&mut self) -> Result<(), Error> {
        let outcome = self.queue.finish();
        self.queue.forget_uploads();
        self.sets = None;
        self.resources.clear();
        self.graph = Graph::default();
        outcome
    }

    /// Staging memory of the next upload: to the command buffer that is being recorded, or to the next submission.
    fn staging(&mut self) -> Result<&mut Staging, Error> {
        match self.recordings.staging() {
            Some(staging) => Ok(staging),
            None => self.queue.staging(),
        }
    }

    fn upload_to_slot(&mut self, slot: usize, mut offset: u64, mut bytes: &[u8]) -> Result<(), Error> {
        let unit = self.resources[slot].unit();
        while !bytes.is_empty() {
            let taken = self.staging()?.upload(slot, unit, offset, bytes)?;
            if taken == 0 {
                self.make_staging_room()?;
            }
            offset += taken as u64;
            bytes = &bytes[taken..];
        }
        Ok(())
    }

    fn make_staging_room(&mut self) -> Result<(), Error> {
        if let Some(staging) = self.recordings.staging() {
            // The caller's commands cannot be submitted here, so their bytes must all stay.
            staging.add_chunk();
            return Ok(());
        }
        self.submit_untimed(&[])?;
        Ok(())
    }

    fn clear_slot(&mut self, slot: usize) -> Result<(), Error> {
        match &self.resources[slot] {
            Resource::Image(image) if image.is_blocks() => {
                let bytes = image.format.image_bytes(image.extent.width, image.extent.height);
                let part = STAGING_BYTES / image.row_bytes() * image.row_bytes();
                let zeros = vec![0; part.min(bytes) as usize];
                for offset in (0..bytes).step_by(zeros.len().max(1)) {
                    self.upload_to_slot(slot, offset, &zeros[..part.min(bytes - offset) as usize])?;
                }
                Ok(())
            }
            _ => {
                self.staging()?.clear(slot);
                Ok(())
            }
        }
    }

    /// Submits what waits to be uploaded and passes, with the time of each where the device measures it.
    fn submit_timed(&mut self, passes: &[PassId]) -> Result<Ticket, Error> {
        if !self.device.info.has_timestamps {
            return self.submit_untimed(passes);
        }
        let all = self.graph.plan().passes();
        let times = passes.iter().map(|id| PassTime::of_pass(&all[id.0], 0.0)).collect();
        self.submit(passes, times)
    }

    fn submit_untimed(&mut self, passes: &[PassId]) -> Result<Ticket, Error> {
        self.submit(passes, Vec::new())
    }

    fn submit(&mut self, passes: &[PassId], times: Vec<PassTime>) -> Result<Ticket, Error> {
        let work = Work { graph: &self.graph, sets: self.sets.as_ref(), resources: &self.resources, passes };
        let is_timed = !times.is_empty();
        // SAFETY: sets, pipelines, resources and staging memory go in `unload` and after the queue in `drop`, both of
        // which wait first.
        unsafe {
            self.queue.submit(times, |commands, staging, queries| {
                work.record(commands, staging, is_timed.then_some(queries));
            })
        }
    }

    /// Runs passes one by one, each timed by the host's clock.
    fn run_by_host_clock(&mut self, passes: &[PassId]) -> Result<Vec<PassTime>, Error> {
        let uploads = self.submit_untimed(&[])?;
        self.queue.wait_for(&uploads)?;
        let mut times = Vec::with_capacity(passes.len());
        for &id in passes {
            let start = Instant::now();
            let ticket = self.submit_untimed(&[id])?;
            self.queue.wait_for(&ticket)?;
            let milliseconds = start.elapsed().as_secs_f64() * 1e3;
            times.push(PassTime::of_pass(&self.graph.plan().passes()[id.0], milliseconds));
        }
        Ok(times)
    }

    fn download_slot(&mut self, slot: usize, bytes: u64) -> Result<Vec<u8>, Error> {
        let mut out = Vec::with_capacity(bytes as usize);
        let part = STAGING_BYTES / self.resources[slot].unit() * self.resources[slot].unit();
        while (out.len() as u64) < bytes {
            let offset = out.len() as u64;
            let size = (bytes - offset).min(part);
            if self.to_host.is_none() {
                self.to_host = Some(Buffer::to_host(&self.device, STAGING_BYTES)?);
            }
            let Some(to_host) = &self.to_host else { continue };
            let resources = &self.resources;
            // SAFETY: the resources go in `unload` and, as the host's buffer, after the queue in `drop`; both wait
            // first.
            let ticket = unsafe {
                self.queue.submit(Vec::new(), |commands, staging, _| {
                    staging.record(commands, resources);
                    record_download(commands, &resources[slot], to_host, offset, size);
                })?
            };
            self.queue.wait_for(&ticket)?;
            out.extend_from_slice(&to_host.mapped()[..size as usize]);
        }
        Ok(out)
    }
}

impl Executor for Vulkan {
    fn device(&self) -> &DeviceInfo {
        &self.device.info
    }

    fn load(&mut self, plan: Plan) -> Result<(), ExecutorError> {
        self.recordings.refuse("load")?;
        self.unload()?;
        if let Err(error) = self.load_graph(Graph::new(plan), 0) {
            // The first error says more than what follows from it.
            let _ = self.unload();
            return Err(error.into());
        }
        Ok(())
    }

    fn load_after(&mut self, plan: Plan, section: usize) -> Result<(), ExecutorError> {
        self.recordings.refuse("load_after")?;
        let graph = self.graph.replaced_after(plan, section)?;
        let kept = graph.slots_before(section);
        // Uploads so far are for buffers that may stay.
        self.submit_untimed(&[])?;
        self.queue.finish()?;
        self.unload_after(section)?;
        if let Err(error) = self.load_graph(graph, kept) {
            self.queue.finish()?;
            self.unload_after(section)?;
            let pipelines = self.pipelines_of(&self.graph.plan().clone())?;
            self.sets = Some(Sets::new(&self.device, &self.graph, &self.resources, pipelines)?);
            return Err(error.into());
        }
        Ok(())
    }

    fn plan(&self) -> &Plan {
        self.graph.plan()
    }

    fn upload_at(&mut self, buffer: BufferId, offset: u64, bytes: &[u8]) -> Result<(), ExecutorError> {
        self.graph.note_upload(buffer, offset, bytes.len() as u64)?;
        self.upload_to_slot(self.graph.slot_of(buffer), offset, bytes)?;
        Ok(self.device.check_messages()?)
    }

    fn clear(&mut self, buffer: BufferId) -> Result<(), ExecutorError> {
        self.graph.note_clear(buffer)?;
        self.clear_slot(self.graph.slot_of(buffer))?;
        Ok(self.device.check_messages()?)
    }

    fn set_push(&mut self, pass: PassId, push: &[u8]) -> Result<(), ExecutorError> {
        if let Some(pass) = self.graph.plan().passes().get(pass.0) {
            self.check_groups(pass, pass.kernel.invocations(push).unwrap_or(0))?;
        }
        Ok(self.graph.set_push(pass, push)?)
    }

    fn run_passes(&mut self, passes: &[PassId]) -> Result<Vec<PassTime>, ExecutorError> {
        self.recordings.refuse("run_passes")?;
        self.graph.note_run(passes)?;
        if passes.is_empty() {
            return Ok(Vec::new());
        }
        let times = if self.host_clock {
            self.run_by_host_clock(passes)?
        } else {
            let ticket = self.submit_timed(passes)?;
            self.queue.wait_for(&ticket)?
        };
        self.device.check_messages()?;
        Ok(times)
    }

    fn submit_passes(&mut self, passes: &[PassId]) -> Result<(), ExecutorError> {
        self.graph.note_run(passes)?;
        let is_recorded = self.record_passes(passes);
        if !is_recorded && (!passes.is_empty() || self.queue.has_uploads()) {
            self.submit_timed(passes)?;
        }
        Ok(self.device.check_messages()?)
    }

    fn wait(&mut self) -> Result<Vec<PassTime>, ExecutorError> {
        self.queue.finish()?;
        self.device.check_messages()?;
        Ok(self.queue.take_times())
    }

    fn finished_times(&mut self) -> Result<Vec<PassTime>, ExecutorError> {
        self.queue.poll()?;
        self.device.check_messages()?;
        Ok(self.queue.take_times())
    }

    fn download(&mut self, buffer: BufferId) -> Result<Vec<u8>, ExecutorError> {
        self.recordings.refuse("download")?;
        let bytes = self.graph.check_download(buffer)?;
        let bytes = self.download_slot(self.graph.slot_of(buffer), bytes)?;
        self.device.check_messages()?;
        Ok(bytes)
    }

    fn begin_read(&mut self, buffer: BufferId) -> Result<ReadId, ExecutorError> {
        self.recordings.refuse("begin_read")?;
        let bytes = self.graph.check_download(buffer)?;
        let host = self.reads.buffer(&self.device, bytes)?;
        let resource = &self.resources[self.graph.slot_of(buffer)];
        let resources = &self.resources;
        // SAFETY: the resources go in `unload` and `unload_after`, the host's buffer when its read is done; before
        // each, this submission is waited for.
        let submitted = unsafe {
            self.queue.submit(Vec::new(), |commands, staging, _| {
                staging.record(commands, resources);
                record_download(commands, resource, &host, 0, bytes);
            })
        };
        submitted?;
        let read = self.reads.add(host, bytes, self.queue.last_number());
        self.device.check_messages()?;
        Ok(read)
    }

    fn try_read(&mut self, read: ReadId) -> Result<Option<Vec<u8>>, ExecutorError> {
        self.queue.poll()?;
        self.device.check_messages()?;
        Ok(self.reads.take(read, &self.queue))
    }

    fn is_recording(&self) -> bool {
        self.recordings.is_open()
    }

    fn as_vulkan(&mut self) -> Option<&mut Vulkan> {
        Some(self)
    }
}
