//! Bytes to the device and back, through staging buffers that the host sees.

use std::sync::Arc;

use ash::vk;

use super::Resource;
use super::buffer::{Buffer, Image, WHOLE_IMAGE};
use super::device::Device;
use super::error::Error;
use super::queue::Queue;

/// Size of a staging buffer; longer transfers go in parts.
const STAGING_BYTES: u64 = 16 << 20;

/// The layout of pictures outside of transfers.
pub(super) const FETCHED: vk::ImageLayout = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;

/// Where uploaded bytes go, copied at the next flush.
struct Copy {
    slot: usize,
    staging_offset: u64,
    offset: u64,
    bytes: u64,
}

/// Staging buffers and the uploads that wait for the next submission.
pub(super) struct Transfer {
    device: Arc<Device>,
    to_device: Option<Buffer>,
    to_host: Option<Buffer>,
    copies: Vec<Copy>,
    used: u64,
}

impl Transfer {
    pub fn new(device: &Arc<Device>) -> Self {
        Self { device: Arc::clone(device), to_device: None, to_host: None, copies: Vec::new(), used: 0 }
    }

    /// Drops uploads whose buffers go.
    pub fn forget(&mut self) {
        self.copies.clear();
        self.used = 0;
    }

    /// Takes bytes for `resources[slot]`; they reach it before the next run or download.
    pub fn upload(
        &mut self,
        queue: &mut Queue,
        resources: &[Resource],
        slot: usize,
        mut offset: u64,
        mut bytes: &[u8],
    ) -> Result<(), Error> {
        if bytes.is_empty() {
            return Ok(());
        }
        let unit = unit(&resources[slot]);
        while !bytes.is_empty() {
            let room = (STAGING_BYTES - self.used) / unit * unit;
            if room == 0 {
                self.flush(queue, resources)?;
                continue;
            }
            let (part, rest) = bytes.split_at(bytes.len().min(room as usize));
            let staging = match &mut self.to_device {
                Some(staging) => staging,
                none => none.insert(Buffer::to_device(&self.device, STAGING_BYTES)?),
            };
            let start = self.used as usize;
            staging.mapped_mut()[start..start + part.len()].copy_from_slice(part);
            self.copies.push(Copy { slot, staging_offset: self.used, offset, bytes: part.len() as u64 });
            // Texels start at multiples of their size.
            self.used = (self.used + part.len() as u64).next_multiple_of(16);
            offset += part.len() as u64;
            bytes = rest;
        }
        Ok(())
    }

    /// Fills a picture with zeros.
    pub fn upload_zeros(
        &mut self,
        queue: &mut Queue,
        resources: &[Resource],
        slot: usize,
        bytes: u64,
    ) -> Result<(), Error> {
        let part = STAGING_BYTES / unit(&resources[slot]) * unit(&resources[slot]);
        let zeros = vec![0; part.min(bytes) as usize];
        for offset in (0..bytes).step_by(zeros.len().max(1)) {
            self.upload(queue, resources, slot, offset, &zeros[..part.min(bytes - offset) as usize])?;
        }
        Ok(())
    }

    /// Copies what waits.
    pub fn flush(&mut self, queue: &mut Queue, resources: &[Resource]) -> Result<(), Error> {
        let Some(staging) = &self.to_device else { return Ok(()) };
        if self.copies.is_empty() {
            return Ok(());
        }
        let copies = std::mem::take(&mut self.copies);
        self.used = 0;
        queue.submit(|raw, commands| {
            for copy in &copies {
                // SAFETY: the command buffer is being recorded; staging buffer and target outlive the wait, and the ranges
                // lie in them: `upload` cut them to the staging buffer, the graph checked them against the target.
                unsafe {
                    match &resources[copy.slot] {
                        Resource::Buffer(target) => {
                            let region = vk::BufferCopy {
                                src_offset: copy.staging_offset,
                                dst_offset: copy.offset,
                                size: copy.bytes,
                            };
                            raw.cmd_copy_buffer(commands, staging.raw, target.raw, &[region]);
                            // A later copy may go to the same bytes.
                            let barrier = [vk::MemoryBarrier::default()
                                .src_access_mask(vk::AccessFlags::TRANSFER_WRITE)
                                .dst_access_mask(vk::AccessFlags::TRANSFER_WRITE)];
                            let stage = vk::PipelineStageFlags::TRANSFER;
                            let flags = vk::DependencyFlags::empty();
                            raw.cmd_pipeline_barrier(commands, stage, stage, flags, &barrier, &[], &[]);
                        }
                        Resource::Image(target) => {
                            let destination = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
                            change_layout(raw, commands, target, FETCHED, destination);
                            let region = rows(target, copy.staging_offset, copy.offset, copy.bytes);
                            raw.cmd_copy_buffer_to_image(commands, staging.raw, target.raw, destination, &[region]);
                            change_layout(raw, commands, target, destination, FETCHED);
                        }
                    }
                }
            }
        })
    }

    /// The first `bytes` bytes of `resources[slot]`, after all uploads.
    pub fn download(
        &mut self,
        queue: &mut Queue,
        resources: &[Resource],
        slot: usize,
        bytes: u64,
    ) -> Result<Vec<u8>, Error> {
        self.flush(queue, resources)?;
        let staging = match &self.to_host {
            Some(staging) => staging,
            None => self.to_host.insert(Buffer::to_host(&self.device, STAGING_BYTES)?),
        };
        let mut out = Vec::with_capacity(bytes as usize);
        if bytes == 0 {
            return Ok(out);
        }
        let unit = unit(&resources[slot]);
        while (out.len() as u64) < bytes {
            let offset = out.len() as u64;
            let size = (bytes - offset).min(STAGING_BYTES / unit * unit);
            queue.submit(|raw, commands| {
                // SAFETY: the command buffer is being recorded; staging buffer and source outlive the wait, and the range
                // lies in both.
                unsafe {
                    match &resources[slot] {
                        Resource::Buffer(source) => {
                            let region = vk::BufferCopy { src_offset: offset, dst_offset: 0, size };
                            raw.cmd_copy_buffer(commands, source.raw, staging.raw, &[region]);
                        }
                        Resource::Image(source) => {
                            let from = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
                            change_layout(raw, commands, source, FETCHED, from);
                            let region = rows(source, 0, offset, size);
                            raw.cmd_copy_image_to_buffer(commands, source.raw, from, staging.raw, &[region]);
                            change_layout(raw, commands, source, from, FETCHED);
                        }
                    }
                }
            })?;
            out.extend_from_slice(&staging.mapped()[..size as usize]);
        }
        Ok(out)
    }
}

/// What a transfer may be cut into: bytes, or rows of a picture's texels or blocks.
fn unit(resource: &Resource) -> u64 {
    match resource {
        Resource::Buffer(_) => 1,
        Resource::Image(image) => image.row_bytes(),
    }
}

/// The rows of a picture that `bytes` bytes from byte `offset` on are.
fn rows(image: &Image, staging_offset: u64, offset: u64, bytes: u64) -> vk::BufferImageCopy {
    let (row_bytes, edge) = (image.row_bytes(), image.format.block_edge());
    let first = (offset / row_bytes) as u32 * edge;
    // The last row of blocks may reach beyond the picture.
    let height = ((bytes / row_bytes) as u32 * edge).min(image.extent.height - first);
    vk::BufferImageCopy {
        buffer_offset: staging_offset,
        image_subresource: vk::ImageSubresourceLayers {
            aspect_mask: WHOLE_IMAGE.aspect_mask,
            mip_level: 0,
            base_array_layer: 0,
            layer_count: 1,
        },
        image_offset: vk::Offset3D { x: 0, y: first as i32, z: 0 },
        image_extent: vk::Extent3D { height, ..image.extent },
        ..vk::BufferImageCopy::default()
    }
}

/// Records a change of a picture's layout that waits for everything before it and holds back everything after it.
///
/// # Safety
/// `commands` is being recorded, `image` outlives the submission and is in the layout `from`.
pub(super) unsafe fn change_layout(
    raw: &ash::Device,
    commands: vk::CommandBuffer,
    image: &Image,
    from: vk::ImageLayout,
    to: vk::ImageLayout,
) {
    let barrier = [vk::ImageMemoryBarrier::default()
        .src_access_mask(vk::AccessFlags::MEMORY_WRITE)
        .dst_access_mask(vk::AccessFlags::MEMORY_READ | vk::AccessFlags::MEMORY_WRITE)
        .old_layout(from)
        .new_layout(to)
        .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
        .image(image.raw)
        .subresource_range(WHOLE_IMAGE)];
    let all = vk::PipelineStageFlags::ALL_COMMANDS;
    // SAFETY: as the caller promises.
    unsafe { raw.cmd_pipeline_barrier(commands, all, all, vk::DependencyFlags::empty(), &[], &[], &barrier) };
}
