//! Uploads and clears that wait to be recorded, with the bytes in memory that the host sees.

use std::sync::Arc;

use ash::vk;

use super::buffer::{Buffer, Image, WHOLE_IMAGE};
use super::commands::{Commands, FETCHED, Scope};
use super::device::Device;
use super::error::Error;
use super::resource::Resource;

/// Size of a staging buffer; longer transfers go in parts.
pub(super) const STAGING_BYTES: u64 = 16 << 20;

/// A change of a slot's contents from the host.
enum Change {
    /// Bytes from a staging buffer.
    Copy { slot: usize, chunk: usize, staging_offset: u64, offset: u64, bytes: u64 },
    /// Zeros.
    Clear { slot: usize },
}

/// Changes that wait to be recorded, and the staging buffers ("chunks") with their bytes. The bytes must stay until the
/// commands that copy them are done; [`Staging::reset`] says that they are.
pub(super) struct Staging {
    device: Arc<Device>,
    chunks: Vec<Buffer>,
    /// The chunk that is being filled.
    chunk: usize,
    /// Its bytes that are taken.
    used: u64,
    changes: Vec<Change>,
}

impl Staging {
    /// Without memory until it is needed.
    pub fn new(device: &Arc<Device>) -> Self {
        Self { device: Arc::clone(device), chunks: Vec::new(), chunk: 0, used: 0, changes: Vec::new() }
    }

    /// Returns true if nothing waits to be recorded.
    pub fn is_empty(&self) -> bool {
        self.changes.is_empty()
    }

    /// Makes the memory free again; changes that were not recorded are dropped.
    pub fn reset(&mut self) {
        self.changes.clear();
        self.chunks.truncate(1);
        self.chunk = 0;
        self.used = 0;
    }

    /// Goes on with another staging buffer.
    pub fn add_chunk(&mut self) {
        self.chunk += 1;
        self.used = 0;
    }

    /// Takes as many bytes for `offset` of a slot as fit, cut at a multiple of `unit`; says how many. 0 means that the
    /// staging buffer is full.
    pub fn upload(&mut self, slot: usize, unit: u64, offset: u64, bytes: &[u8]) -> Result<usize, Error> {
        let capacity = (STAGING_BYTES - self.used) / unit * unit;
        let part = &bytes[..bytes.len().min(capacity as usize)];
        if part.is_empty() {
            return Ok(0);
        }
        if self.chunks.len() == self.chunk {
            self.chunks.push(Buffer::to_device(&self.device, STAGING_BYTES)?);
        }
        let start = self.used as usize;
        self.chunks[self.chunk].mapped_mut()[start..start + part.len()].copy_from_slice(part);
        let bytes = part.len() as u64;
        self.changes.push(Change::Copy { slot, chunk: self.chunk, staging_offset: self.used, offset, bytes });
        // Texels start at multiples of their size.
        self.used = (self.used + bytes).next_multiple_of(16);
        Ok(part.len())
    }

    /// Notes that a slot (not one of blocks) becomes zeros.
    pub fn clear(&mut self, slot: usize) {
        self.changes.push(Change::Clear { slot });
    }

    /// Records all changes in their order, then a barrier that makes them visible.
    pub fn record(&mut self, commands: &Commands<'_>, resources: &[Resource]) {
        if self.changes.is_empty() {
            return;
        }
        for change in std::mem::take(&mut self.changes) {
            self.record_change(commands, resources, &change);
        }
        commands.barrier(Scope::TRANSFER_WRITES, Scope::ALL);
    }

    fn record_change(&self, commands: &Commands<'_>, resources: &[Resource], change: &Change) {
        match *change {
            Change::Copy { slot, chunk, staging_offset, offset, bytes } => match &resources[slot] {
                Resource::Buffer(target) => {
                    let region = vk::BufferCopy { src_offset: staging_offset, dst_offset: offset, size: bytes };
                    commands.copy_buffer(&self.chunks[chunk], target, region);
                }
                Resource::Image(target) => {
                    let region = rows(target, staging_offset, offset, bytes);
                    commands.copy_to_image(&self.chunks[chunk], target, region);
                }
            },
            Change::Clear { slot } => match &resources[slot] {
                Resource::Buffer(target) => commands.clear_buffer(target),
                Resource::Image(target) => commands.clear_image(target, FETCHED),
            },
        }
        // A later change may write the same bytes.
        commands.barrier(Scope::TRANSFER_WRITES, Scope::TRANSFER_WRITES);
    }
}

/// Records a copy of a slot's bytes from `offset` on to the start of a staging buffer.
pub(super) fn record_download(commands: &Commands<'_>, resource: &Resource, staging: &Buffer, offset: u64, bytes: u64) {
    match resource {
        Resource::Buffer(source) => {
            let region = vk::BufferCopy { src_offset: offset, dst_offset: 0, size: bytes };
            commands.copy_buffer(source, staging, region);
        }
        Resource::Image(source) => {
            commands.copy_from_image(source, staging, rows(source, 0, offset, bytes));
        }
    }
    commands.barrier(Scope::ALL, Scope::HOST_READS);
}

/// The rows of a picture that `bytes` bytes from byte `offset` on are.
fn rows(image: &Image, staging_offset: u64, offset: u64, bytes: u64) -> vk::BufferImageCopy {
    let row_bytes = image.row_bytes();
    let edge = image.format.block_edge();
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
