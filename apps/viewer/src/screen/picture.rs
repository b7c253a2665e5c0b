//! Pictures on the device, from a buffer there or from the host, and what is copied back of the window.

use std::sync::{Arc, PoisonError};

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};

use super::gpu::Device;
use crate::error::Error;

/// Bytes of a pixel.
pub(super) const PIXEL: u64 = 4;
/// Bytes red, green, blue, 255 as they are displayed.
const FORMAT: vk::Format = vk::Format::R8G8B8A8_UNORM;

/// Memory of a buffer or an image.
struct Memory {
    device: Arc<Device>,
    allocation: Option<Allocation>,
}

impl Memory {
    fn new(
        device: &Arc<Device>,
        name: &str,
        requirements: vk::MemoryRequirements,
        location: MemoryLocation,
        linear: bool,
    ) -> Result<Self, Error> {
        let allocation_scheme = AllocationScheme::GpuAllocatorManaged;
        let desc = AllocationCreateDesc { name, requirements, location, linear, allocation_scheme };
        let made = device.allocator.lock().unwrap_or_else(PoisonError::into_inner).allocate(&desc);
        let allocation = made.map_err(|error| Error::Panels { reason: format!("memory for a {name}: {error}") })?;
        Ok(Self { device: Arc::clone(device), allocation: Some(allocation) })
    }

    fn handle(&self) -> (vk::DeviceMemory, u64) {
        match &self.allocation {
            // SAFETY: the handle is only used to bind it to what owns this allocation.
            Some(allocation) => (unsafe { allocation.memory() }, allocation.offset()),
            None => (vk::DeviceMemory::null(), 0),
        }
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        if let Some(allocation) = self.allocation.take() {
            // Fails only for an allocation of another allocator.
            let _ = self.device.allocator.lock().unwrap_or_else(PoisonError::into_inner).free(allocation);
        }
    }
}

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
        let memory = Memory::new(device, "picture buffer", requirements, location, true)?;
        let (handle, offset) = memory.handle();
        // SAFETY: the memory suits the buffer, and is bound once.
        unsafe { device.raw.bind_buffer_memory(raw, handle, offset) }.map_err(Error::call("vkBindBufferMemory"))?;
        buffer.memory = Some(memory);
        Ok(buffer)
    }

    fn allocation(&mut self) -> Option<&mut Allocation> {
        self.memory.as_mut()?.allocation.as_mut()
    }

    /// Puts bytes in, as many as fit; nothing of the buffer is in use.
    pub fn write(&mut self, bytes: &[u8]) {
        if let Some(mapped) = self.allocation().and_then(Allocation::mapped_slice_mut) {
            let count = bytes.len().min(mapped.len());
            mapped[..count].copy_from_slice(&bytes[..count]);
        }
    }

    /// The bytes; nothing of the buffer is in use.
    pub fn read(&self) -> Vec<u8> {
        let allocation = self.memory.as_ref().and_then(|memory| memory.allocation.as_ref());
        let mapped = allocation.and_then(Allocation::mapped_slice).unwrap_or_default();
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
    /// Whether it holds a picture yet.
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
        let memory = Memory::new(device, "picture", requirements, MemoryLocation::GpuOnly, false)?;
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
