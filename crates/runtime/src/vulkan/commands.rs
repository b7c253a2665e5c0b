//! Commands as they are recorded: barriers, copies, fills, dispatches, timestamps.

use std::ffi::CString;

use ash::{ext, vk};

use super::buffer::{Buffer, Image, WHOLE_IMAGE};
use super::device::Device;
use super::pipeline::Pipeline;
use crate::plan::Pass;

/// The layout of pictures outside of transfers.
pub(super) const FETCHED: vk::ImageLayout = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;

/// One side of a memory barrier.
#[derive(Clone, Copy)]
pub(super) struct Scope {
    stages: vk::PipelineStageFlags,
    access: vk::AccessFlags,
}

impl Scope {
    /// Everything that a device does.
    pub const ALL: Self = Self {
        stages: vk::PipelineStageFlags::ALL_COMMANDS,
        access: vk::AccessFlags::from_raw(
            vk::AccessFlags::MEMORY_READ.as_raw() | vk::AccessFlags::MEMORY_WRITE.as_raw(),
        ),
    };
    /// Writes of transfers.
    pub const TRANSFER_WRITES: Self =
        Self { stages: vk::PipelineStageFlags::TRANSFER, access: vk::AccessFlags::TRANSFER_WRITE };
    /// Writes of kernels.
    pub const SHADER_WRITES: Self =
        Self { stages: vk::PipelineStageFlags::COMPUTE_SHADER, access: vk::AccessFlags::SHADER_WRITE };
    /// Reads and writes of kernels.
    pub const SHADER: Self = Self {
        stages: vk::PipelineStageFlags::COMPUTE_SHADER,
        access: vk::AccessFlags::from_raw(
            vk::AccessFlags::SHADER_READ.as_raw() | vk::AccessFlags::SHADER_WRITE.as_raw(),
        ),
    };
    /// Reads of mapped memory by the host.
    pub const HOST_READS: Self = Self { stages: vk::PipelineStageFlags::HOST, access: vk::AccessFlags::HOST_READ };
}

/// A command buffer that is being recorded.
#[derive(Clone, Copy)]
pub(super) struct Commands<'a> {
    raw: &'a ash::Device,
    labels: Option<&'a ext::debug_utils::Device>,
    buffer: vk::CommandBuffer,
}

impl<'a> Commands<'a> {
    /// Wraps a command buffer.
    ///
    /// # Safety
    /// As long as this value lives, the command buffer is being recorded, outside of a render pass. It is of the device
    /// and of a queue family with `VK_QUEUE_COMPUTE_BIT`. Whatever is recorded through this value outlives the
    /// execution of the command buffer.
    pub unsafe fn new(device: &'a Device, buffer: vk::CommandBuffer) -> Self {
        Self { raw: &device.raw, labels: device.labels.as_ref(), buffer }
    }

    /// Begins the label of a pass, its name and its kernel's, for debuggers that show them.
    pub fn begin_label(&self, pass: &Pass) {
        let Some(labels) = self.labels else { return };
        let name = CString::new(format!("{} ({})", pass.name, pass.kernel.name)).unwrap_or_default();
        let label = vk::DebugUtilsLabelEXT::default().label_name(&name);
        // SAFETY: the command buffer is being recorded; the label and its name live until the call returns.
        unsafe { labels.cmd_begin_debug_utils_label(self.buffer, &label) };
    }

    /// Ends the label that was begun last.
    pub fn end_label(&self) {
        let Some(labels) = self.labels else { return };
        // SAFETY: the command buffer is being recorded and has a label that was begun.
        unsafe { labels.cmd_end_debug_utils_label(self.buffer) };
    }

    /// Barrier: work in `from` happens before, and is visible to, work in `to`.
    pub fn barrier(&self, from: Scope, to: Scope) {
        let barriers = [vk::MemoryBarrier::default().src_access_mask(from.access).dst_access_mask(to.access)];
        let flags = vk::DependencyFlags::empty();
        // SAFETY: the command buffer is being recorded; every scope's stages are those of a compute queue.
        unsafe { self.raw.cmd_pipeline_barrier(self.buffer, from.stages, to.stages, flags, &barriers, &[], &[]) };
    }

    /// Fills a buffer with zeros.
    pub fn clear_buffer(&self, buffer: &Buffer) {
        // SAFETY: the command buffer is being recorded; every buffer of a plan allows transfers and has whole words.
        unsafe { self.raw.cmd_fill_buffer(self.buffer, buffer.raw, 0, vk::WHOLE_SIZE, 0) };
    }

    /// Fills a picture of plain texels (not of blocks) with zeros. `layout` is its layout; afterwards it is
    /// [`FETCHED`].
    pub fn clear_image(&self, image: &Image, layout: vk::ImageLayout) {
        let destination = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
        let zero = vk::ClearColorValue { float32: [0.0; 4] };
        self.change_layout(image, layout, destination);
        // SAFETY: the command buffer is being recorded; the picture allows transfers and is in the layout named.
        unsafe { self.raw.cmd_clear_color_image(self.buffer, image.raw, destination, &zero, &[WHOLE_IMAGE]) };
        self.change_layout(image, destination, FETCHED);
    }

    /// Copies a region between buffers.
    pub fn copy_buffer(&self, from: &Buffer, to: &Buffer, region: vk::BufferCopy) {
        // SAFETY: the command buffer is being recorded; the region lies in both buffers: uploads and downloads cut it
        // to the staging buffer, the graph checked it against the plan's buffer.
        unsafe { self.raw.cmd_copy_buffer(self.buffer, from.raw, to.raw, &[region]) };
    }

    /// Copies rows of texels or blocks into a picture.
    pub fn copy_to_image(&self, from: &Buffer, to: &Image, region: vk::BufferImageCopy) {
        let destination = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
        self.change_layout(to, FETCHED, destination);
        // SAFETY: the command buffer is being recorded; the region is whole rows of the picture and lies in the staging
        // buffer; the picture is in the layout named.
        unsafe { self.raw.cmd_copy_buffer_to_image(self.buffer, from.raw, to.raw, destination, &[region]) };
        self.change_layout(to, destination, FETCHED);
    }

    /// Copies rows of texels or blocks out of a picture.
    pub fn copy_from_image(&self, from: &Image, to: &Buffer, region: vk::BufferImageCopy) {
        let source = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
        self.change_layout(from, FETCHED, source);
        // SAFETY: as for `copy_to_image`.
        unsafe { self.raw.cmd_copy_image_to_buffer(self.buffer, from.raw, source, to.raw, &[region]) };
        self.change_layout(from, source, FETCHED);
    }

    /// Changes a picture's layout; waits for everything before and holds back everything after.
    pub fn change_layout(&self, image: &Image, from: vk::ImageLayout, to: vk::ImageLayout) {
        let barrier = [vk::ImageMemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::MEMORY_WRITE)
            .dst_access_mask(Scope::ALL.access)
            .old_layout(from)
            .new_layout(to)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .image(image.raw)
            .subresource_range(WHOLE_IMAGE)];
        let all = vk::PipelineStageFlags::ALL_COMMANDS;
        let flags = vk::DependencyFlags::empty();
        // SAFETY: the command buffer is being recorded; pictures are in the layout `FETCHED` between these functions,
        // and undefined when they are new.
        unsafe { self.raw.cmd_pipeline_barrier(self.buffer, all, all, flags, &[], &[], &barrier) };
    }

    /// Dispatches a pass with its push constants as they are now.
    pub fn dispatch(&self, pass: &Pass, pipeline: &Pipeline, set: vk::DescriptorSet) {
        if pass.invocations == 0 {
            return;
        }
        let compute = vk::PipelineBindPoint::COMPUTE;
        let [x, y, z] = pass.kernel.groups(pass.invocations);
        // SAFETY: the command buffer is being recorded; pipeline, set and what the set points to outlive its execution;
        // groups and push constants were checked against device and kernel when they were set.
        unsafe {
            self.raw.cmd_bind_pipeline(self.buffer, compute, pipeline.raw);
            self.raw.cmd_bind_descriptor_sets(self.buffer, compute, pipeline.layout, 0, &[set], &[]);
            if !pass.push.is_empty() {
                let stage = vk::ShaderStageFlags::COMPUTE;
                self.raw.cmd_push_constants(self.buffer, pipeline.layout, stage, 0, &pass.push);
            }
            self.raw.cmd_dispatch(self.buffer, x, y, z);
        }
    }

    /// Makes the first `count` queries ready to be written again.
    pub fn reset_queries(&self, pool: vk::QueryPool, count: u32) {
        // SAFETY: the command buffer is being recorded; the pool has at least `count` queries and is not in use.
        unsafe { self.raw.cmd_reset_query_pool(self.buffer, pool, 0, count) };
    }

    /// Writes the time at which everything recorded so far is done.
    pub fn timestamp(&self, pool: vk::QueryPool, query: u32) {
        let done = vk::PipelineStageFlags::BOTTOM_OF_PIPE;
        // SAFETY: the command buffer is being recorded; the query was reset in it and is written once.
        unsafe { self.raw.cmd_write_timestamp(self.buffer, done, pool, query) };
    }
}
