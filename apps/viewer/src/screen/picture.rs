//! Pictures on the device, from a buffer there or from the host, and what is copied back of the window.

use std::sync::Arc;

use ash::vk;
use gpu_allocator::MemoryLocation;
use runtime::vulkan::{Memory, MemoryRequest};

use super::gpu::Device;
use crate::error::Error;

/// Bytes of a pixel.
pub(super) const PIXEL: u64 = 4;
/// Bytes red, green, blue, 255 as they are displayed.
const FORMAT: vk::Format = vk::Format::R8G8B8A8_UNORM;

/// A buffer that the host sees.
pub(super) struct HostBuffer {
    pub raw: vk::Buffer,
    pub bytes: u64,
    memory: Option<Memory>,
    device: Arc<Device>,
}

impl HostBuffer {
    /// One that is written by the host.
    pub fn to_device(device: &Arc<Device>, bytes: u64) -> Result<Self, Error> {
        Self::new(device, bytes, vk::BufferUsageFlags::TRANSFER_SRC, MemoryLocation::CpuToGpu)
    }

    /// One that is read by the host.
    pub fn to_host(device: &Arc<Device>, bytes: u64) -> Result<Self, Error> {
        Self::new(device, bytes, vk::BufferUsageFlags::TRANSFER_DST, MemoryLocation::GpuToCpu)
    }

    fn new(
        device: &Arc<Device>,
        bytes: u64,
        usage: vk::BufferUsageFlags,
        location: MemoryLocation,
    ) -> Result<Self, Error> {
        let create = vk::BufferCreateInfo::default().size(bytes).usage(usage);
        // SAFETY: the device is alive.
        let raw = unsafe { device.raw.create_buffer(&create, None) }.map_err(Error::call("vkCreateBuffer"))?;
        let mut buffer = Self { raw, bytes, memory: None, device: Arc::clone(device) };
        // SAFETY: the buffer is new and the device's.
        let requirements = unsafe { device.raw.get_buffer_memory_requirements(raw) };
        let request = MemoryRequest { name: "picture buffer", bytes, requirements, location, linear: true };
        let memory = Memory::new(&device.allocator, &request)?;
        let (handle, offset) = memory.handle();
        // SAFETY: the memory suits the buffer, and is bound once.
        unsafe { device.raw.bind_buffer_memory(raw, handle, offset) }.map_err(Error::call("vkBindBufferMemory"))?;
        buffer.memory = Some(memory);
        Ok(buffer)
    }

    /// Puts bytes in, as many as fit; nothing of the buffer is in use.
    pub fn write(&mut self, bytes: &[u8]) {
        let mapped = self.memory.as_mut().map(Memory::mapped_mut).unwrap_or_default();
        let count = bytes.len().min(mapped.len());
        mapped[..count].copy_from_slice(&bytes[..count]);
    }

    /// The bytes; nothing of the buffer is in use.
    pub fn read(&self) -> Vec<u8> {
        let mapped = self.memory.as_ref().map(Memory::mapped).unwrap_or_default();
        mapped[..mapped.len().min(self.bytes as usize)].to_vec()
    }
}

impl Drop for HostBuffer {
    fn drop(&mut self) {
        // SAFETY: `Screen` waits before it lets a buffer go.
        unsafe { self.device.raw.destroy_buffer(self.raw, None) };
    }
}

/// A picture that the window shows.
pub(super) struct Picture {
    pub image: vk::Image,
    pub size: (u32, u32),
    /// True if it holds a picture yet.
    pub is_filled: bool,
    pub staging: Option<HostBuffer>,
    memory: Option<Memory>,
    device: Arc<Device>,
}

impl Picture {
    pub fn new(device: &Arc<Device>, size: (u32, u32)) -> Result<Self, Error> {
        let create = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(FORMAT)
            .extent(vk::Extent3D { width: size.0, height: size.1, depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(vk::ImageUsageFlags::TRANSFER_DST | vk::ImageUsageFlags::TRANSFER_SRC);
        // SAFETY: the device is alive; sizes of pictures are within the limits of the renderer's.
        let image = unsafe { device.raw.create_image(&create, None) }.map_err(Error::call("vkCreateImage"))?;
        let mut picture =
            Self { image, size, is_filled: false, staging: None, memory: None, device: Arc::clone(device) };
        // SAFETY: the image is new and the device's.
        let requirements = unsafe { device.raw.get_image_memory_requirements(image) };
        let bytes = picture.bytes();
        let location = MemoryLocation::GpuOnly;
        let request = MemoryRequest { name: "picture", bytes, requirements, location, linear: false };
        let memory = Memory::new(&device.allocator, &request)?;
        let (handle, offset) = memory.handle();
        // SAFETY: the memory suits the image, and is bound once.
        unsafe { device.raw.bind_image_memory(image, handle, offset) }.map_err(Error::call("vkBindImageMemory"))?;
        picture.memory = Some(memory);
        Ok(picture)
    }

    /// Bytes of all pixels.
    pub fn bytes(&self) -> u64 {
        PIXEL * u64::from(self.size.0) * u64::from(self.size.1)
    }

    /// Puts the bytes of a picture where the next copy reads them.
    pub fn stage(&mut self, bytes: &[u8]) -> Result<vk::Buffer, Error> {
        if self.staging.is_none() {
            self.staging = Some(HostBuffer::to_device(&self.device, self.bytes())?);
        }
        let Some(staging) = &mut self.staging else { return Ok(vk::Buffer::null()) };
        staging.write(bytes);
        Ok(staging.raw)
    }
}

impl Drop for Picture {
    fn drop(&mut self) {
        // SAFETY: `Screen` waits before it lets a picture go.
        unsafe { self.device.raw.destroy_image(self.image, None) };
    }
}
