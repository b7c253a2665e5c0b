//! Runs plans on a Vulkan device: any driver of Vulkan 1.2 with rust-gpu's memory model, loaded when the program runs.
//!
//! The one place with unsafe code. `device` makes and ends instance and device, `buffer` owns memory, `pipeline`
//! compiles rows of the kernel table, `queue` submits and waits, `transfer` moves bytes to and fro.
#![allow(unsafe_code)]

mod buffer;
mod device;
mod error;
mod pipeline;
mod queue;
mod transfer;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use ash::vk;
use gpu_kernels::table::{BindingKind, ImageFormat, Kernel};

use self::buffer::{Buffer, Image};
use self::device::{Device, Instance};
use self::pipeline::{Pipeline, descriptor_type};
use self::queue::Queue;
use self::transfer::Transfer;
use crate::executor::{DeviceChoice, DeviceInfo, Executor, ExecutorError, PassTime};
use crate::graph::Graph;
use crate::plan::{BufferId, BufferKind, Pass, PassId, Plan};

pub use self::device::{Messages, Validation};
pub use self::error::Error;

/// All Vulkan devices in the loader's order, those that lack a feature too.
///
/// # Errors
/// No loader, no driver.
pub fn devices() -> Result<Vec<DeviceInfo>, Error> {
    let instance = Instance::new(Validation::Off)?;
    Ok(instance.devices()?.into_iter().map(|candidate| candidate.info).collect())
}

/// What a slot of the graph is on the device.
enum Resource {
    Buffer(Buffer),
    Image(Image),
}

/// Runs plans on a Vulkan device.
pub struct Vulkan {
    // Fields end from the first to the last; each holds the device by an `Arc`, the last one frees it.
    sets: Option<Sets>,
    resources: Vec<Resource>,
    /// By the address of the kernel's row.
    pipelines: HashMap<usize, Arc<Pipeline>>,
    transfer: Transfer,
    queue: Queue,
    graph: Graph,
    device: Arc<Device>,
    host_clock: bool,
}

impl Vulkan {
    /// Opens the device that answers to the choice, the best kind first.
    ///
    /// # Errors
    /// No loader, no driver, no such device (the message lists those there are), a missing feature, a missing layer.
    pub fn open(choice: &DeviceChoice, validation: Validation) -> Result<Self, Error> {
        let instance = Instance::new(validation)?;
        let candidate = device::choose(instance.devices()?, choice)?;
        let device = Arc::new(Device::new(instance, candidate)?);
        let vulkan = Self {
            sets: None,
            resources: Vec::new(),
            pipelines: HashMap::new(),
            transfer: Transfer::new(&device),
            queue: Queue::new(&device)?,
            graph: Graph::default(),
            host_clock: !device.info.has_timestamps,
            device,
        };
        vulkan.device.check_messages()?;
        Ok(vulkan)
    }

    /// The validation layer's messages. They outlive the executor, so that what is said while it ends can be read. A call
    /// that finds messages takes them and fails with [`Error::Validation`].
    pub fn messages(&self) -> Messages {
        self.device.instance.messages.clone()
    }

    /// Times each pass by the host's clock, with a submission of its own, as on devices without timestamps.
    pub fn use_host_clock(&mut self) {
        self.host_clock = true;
    }

    fn make_resources(&self, graph: &Graph) -> Result<Vec<Resource>, Error> {
        let mut resources = Vec::with_capacity(graph.slots().len());
        for slot in graph.slots() {
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
            return Err(self.device.limit(format!("picture `{name}`"), "textureCompressionBC", 0, 1, remedy));
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
        self.check_groups(pass, pass.elements)?;
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

    fn check_groups(&self, pass: &Pass, elements: u32) -> Result<(), Error> {
        let limit = self.device.limits.max_compute_work_group_count[1];
        let rows = pass.kernel.groups(elements)[1];
        if rows > limit {
            let what = format!("pass `{}` over {elements} elements", pass.name);
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

    fn load_graph(&mut self, graph: Graph) -> Result<(), Error> {
        let plan = graph.plan();
        for pass in plan.passes() {
            self.check_pass(plan, pass)?;
        }
        let mut pipelines = Vec::with_capacity(plan.passes().len());
        for pass in plan.passes() {
            pipelines.push(self.pipeline(pass.kernel)?);
        }
        let resources = self.make_resources(&graph)?;
        self.queue.submit(|raw, commands| clear(raw, commands, &resources))?;
        for (slot, resource) in resources.iter().enumerate() {
            if let Resource::Image(image) = resource
                && image.is_blocks()
            {
                let bytes = image.format.image_bytes(image.extent.width, image.extent.height);
                self.transfer.upload_zeros(&mut self.queue, &resources, slot, bytes)?;
            }
        }
        self.transfer.flush(&mut self.queue, &resources)?;
        let sets = Sets::new(&self.device, &graph, &resources, pipelines)?;
        self.device.check_messages()?;
        (self.sets, self.resources, self.graph) = (Some(sets), resources, graph);
        Ok(())
    }

    /// Submits passes together; with timestamps the time of each.
    fn submit(&mut self, passes: &[PassId], barriers: &[bool], timestamps: bool) -> Result<Vec<f64>, Error> {
        let Some(sets) = &self.sets else { return Ok(Vec::new()) };
        let count = passes.len() as u32 + 1;
        let queries = if timestamps { self.queue.queries(count)? } else { vk::QueryPool::null() };
        let plan = self.graph.plan();
        self.queue.submit(|raw, commands| {
            // SAFETY: the command buffer is being recorded; pool, pipelines, sets and what they point to live in `self`
            // until after the wait; groups and push constants were checked against device and kernel when they were set.
            unsafe {
                let stamp = |query: u32| {
                    if timestamps {
                        raw.cmd_write_timestamp(commands, vk::PipelineStageFlags::BOTTOM_OF_PIPE, queries, query);
                    }
                };
                if timestamps {
                    raw.cmd_reset_query_pool(commands, queries, 0, count);
                }
                stamp(0);
                for (k, (id, waits)) in passes.iter().zip(barriers).enumerate() {
                    if *waits {
                        let shader = vk::PipelineStageFlags::COMPUTE_SHADER;
                        let barrier = [vk::MemoryBarrier::default()
                            .src_access_mask(vk::AccessFlags::SHADER_WRITE)
                            .dst_access_mask(vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE)];
                        let flags = vk::DependencyFlags::empty();
                        raw.cmd_pipeline_barrier(commands, shader, shader, flags, &barrier, &[], &[]);
                    }
                    let pass = &plan.passes()[id.0];
                    let pipeline = &sets.pipelines[id.0];
                    let compute = vk::PipelineBindPoint::COMPUTE;
                    raw.cmd_bind_pipeline(commands, compute, pipeline.raw);
                    raw.cmd_bind_descriptor_sets(commands, compute, pipeline.layout, 0, &[sets.sets[id.0]], &[]);
                    if !pass.push.is_empty() {
                        let stage = vk::ShaderStageFlags::COMPUTE;
                        raw.cmd_push_constants(commands, pipeline.layout, stage, 0, &pass.push);
                    }
                    if pass.elements > 0 {
                        let [x, y, z] = pass.kernel.groups(pass.elements);
                        raw.cmd_dispatch(commands, x, y, z);
                    }
                    stamp(k as u32 + 1);
                }
            }
        })?;
        if timestamps { self.queue.intervals(count) } else { Ok(Vec::new()) }
    }

    fn run_checked(&mut self, passes: &[PassId]) -> Result<Vec<f64>, Error> {
        self.transfer.flush(&mut self.queue, &self.resources)?;
        let barriers = self.graph.barriers(passes);
        let times = if self.host_clock {
            let mut times = Vec::with_capacity(passes.len());
            for &id in passes {
                // The submission itself is a barrier.
                let start = Instant::now();
                self.submit(&[id], &[false], false)?;
                times.push(start.elapsed().as_secs_f64() * 1e3);
            }
            times
        } else {
            self.submit(passes, &barriers, true)?
        };
        self.device.check_messages()?;
        Ok(times)
    }
}

impl Executor for Vulkan {
    fn device(&self) -> &DeviceInfo {
        &self.device.info
    }

    fn load(&mut self, plan: Plan) -> Result<(), ExecutorError> {
        self.sets = None;
        self.transfer.forget();
        self.resources.clear();
        self.graph = Graph::default();
        Ok(self.load_graph(Graph::new(plan))?)
    }

    fn plan(&self) -> &Plan {
        self.graph.plan()
    }

    fn upload_at(&mut self, buffer: BufferId, offset: u64, bytes: &[u8]) -> Result<(), ExecutorError> {
        self.graph.note_upload(buffer, offset, bytes.len() as u64)?;
        let slot = self.graph.slot_of(buffer);
        self.transfer.upload(&mut self.queue, &self.resources, slot, offset, bytes)?;
        Ok(self.device.check_messages()?)
    }

    fn set_push(&mut self, pass: PassId, push: &[u8]) -> Result<(), ExecutorError> {
        Ok(self.graph.set_push(pass, push)?)
    }

    fn set_elements(&mut self, pass: PassId, elements: u32) -> Result<(), ExecutorError> {
        if let Some(pass) = self.graph.plan().passes().get(pass.0) {
            self.check_groups(pass, elements)?;
        }
        Ok(self.graph.set_elements(pass, elements)?)
    }

    fn run_passes(&mut self, passes: &[PassId]) -> Result<Vec<PassTime>, ExecutorError> {
        self.graph.note_run(passes)?;
        if passes.is_empty() {
            return Ok(Vec::new());
        }
        let times = self.run_checked(passes)?;
        let plan = self.graph.plan();
        let name = |id: &PassId| plan.passes()[id.0].name.clone();
        Ok(passes.iter().zip(times).map(|(id, milliseconds)| PassTime { name: name(id), milliseconds }).collect())
    }

    fn download(&mut self, buffer: BufferId) -> Result<Vec<u8>, ExecutorError> {
        let bytes = self.graph.check_download(buffer)?;
        let slot = self.graph.slot_of(buffer);
        let bytes = self.transfer.download(&mut self.queue, &self.resources, slot, bytes)?;
        self.device.check_messages()?;
        Ok(bytes)
    }
}

/// Fills new buffers and pictures with zeros and brings pictures into the layout that kernels fetch from.
fn clear(raw: &ash::Device, commands: vk::CommandBuffer, resources: &[Resource]) {
    for resource in resources {
        // SAFETY: the command buffer is being recorded; buffers and pictures are new, allow transfers and outlive the wait.
        unsafe {
            match resource {
                Resource::Buffer(buffer) => raw.cmd_fill_buffer(commands, buffer.raw, 0, vk::WHOLE_SIZE, 0),
                // Blocks cannot be cleared; they are copied.
                Resource::Image(image) if image.is_blocks() => {
                    transfer::change_layout(raw, commands, image, vk::ImageLayout::UNDEFINED, transfer::FETCHED);
                }
                Resource::Image(image) => {
                    let destination = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
                    transfer::change_layout(raw, commands, image, vk::ImageLayout::UNDEFINED, destination);
                    let zero = vk::ClearColorValue { float32: [0.0; 4] };
                    raw.cmd_clear_color_image(commands, image.raw, destination, &zero, &[buffer::WHOLE_IMAGE]);
                    transfer::change_layout(raw, commands, image, destination, transfer::FETCHED);
                }
            }
        }
    }
}

/// One descriptor set for each pass, with its pipeline.
struct Sets {
    pool: vk::DescriptorPool,
    sets: Vec<vk::DescriptorSet>,
    pipelines: Vec<Arc<Pipeline>>,
    device: Arc<Device>,
}

impl Sets {
    fn new(
        device: &Arc<Device>,
        graph: &Graph,
        resources: &[Resource],
        pipelines: Vec<Arc<Pipeline>>,
    ) -> Result<Self, Error> {
        let mut made =
            Self { pool: vk::DescriptorPool::null(), sets: Vec::new(), pipelines, device: Arc::clone(device) };
        let passes = graph.plan().passes();
        if passes.is_empty() {
            return Ok(made);
        }
        let count = |kind: vk::DescriptorType| {
            let of_kind =
                |pass: &&Pass| pass.kernel.bindings.iter().filter(|b| descriptor_type(b.kind) == kind).count();
            let descriptor_count = passes.iter().map(|pass| of_kind(&pass)).sum::<usize>() as u32;
            vk::DescriptorPoolSize { ty: kind, descriptor_count }
        };
        let sizes: Vec<_> = [vk::DescriptorType::STORAGE_BUFFER, vk::DescriptorType::SAMPLED_IMAGE]
            .into_iter()
            .map(count)
            .filter(|size| size.descriptor_count > 0)
            .collect();
        let create = vk::DescriptorPoolCreateInfo::default().max_sets(passes.len() as u32).pool_sizes(&sizes);
        // SAFETY: the device is alive; `sizes` lives through the call.
        made.pool = unsafe { device.raw.create_descriptor_pool(&create, None) }
            .map_err(Error::call("vkCreateDescriptorPool"))?;
        let layouts: Vec<_> = made.pipelines.iter().map(|p| p.set_layout).collect();
        let allocate = vk::DescriptorSetAllocateInfo::default().descriptor_pool(made.pool).set_layouts(&layouts);
        // SAFETY: the pool has room for exactly these sets; the layouts live in `made.pipelines`.
        made.sets = unsafe { device.raw.allocate_descriptor_sets(&allocate) }
            .map_err(Error::call("vkAllocateDescriptorSets"))?;
        for (pass, set) in passes.iter().zip(&made.sets) {
            for (binding, bound) in pass.bound.iter().enumerate() {
                let write = vk::WriteDescriptorSet::default().dst_set(*set).dst_binding(binding as u32);
                let resource = &resources[graph.slot_of(bound.buffer)];
                let (buffers, images) = match resource {
                    Resource::Buffer(buffer) => {
                        let info =
                            vk::DescriptorBufferInfo { buffer: buffer.raw, offset: bound.offset, range: bound.bytes };
                        (Some([info]), None)
                    }
                    Resource::Image(image) => {
                        let info = vk::DescriptorImageInfo {
                            sampler: vk::Sampler::null(),
                            image_view: image.view,
                            image_layout: transfer::FETCHED,
                        };
                        (None, Some([info]))
                    }
                };
                let write = match (&buffers, &images) {
                    (Some(buffers), _) => {
                        write.descriptor_type(vk::DescriptorType::STORAGE_BUFFER).buffer_info(buffers)
                    }
                    (_, Some(images)) => write.descriptor_type(vk::DescriptorType::SAMPLED_IMAGE).image_info(images),
                    _ => continue,
                };
                // SAFETY: the set is new and not in use; the range lies in the buffer (checked by the plan) and buffer,
                // picture and view outlive the set.
                unsafe { device.raw.update_descriptor_sets(&[write], &[]) };
            }
        }
        Ok(made)
    }
}

impl Drop for Sets {
    fn drop(&mut self) {
        // SAFETY: every submission is waited for; a null pool is allowed; the sets go with their pool.
        unsafe { self.device.raw.destroy_descriptor_pool(self.pool, None) };
    }
}
