//! Owned buffers and pictures with their memory, freed on drop.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_kernels::table::ImageFormat;

use super::device::Device;
use super::error::Error;
use super::memory::{Memory, MemoryRequest, bytes_in_use};

/// More than the device can ever give, or than it may take, is refused before the driver is asked: some wrap around
/// instead of refusing.
fn check_size(device: &Device, call: &'static str, name: &str, bytes: u64) -> Result<(), Error> {
    let limit = device.info.memory_bytes.min(device.max_allocation_bytes);
    let refusal = |reason| Err(Error::OutOfMemory { call, what: name.into(), bytes, reason });
    if bytes > limit {
        return refusal(format!("{} gives at most {limit} bytes at once", device.info.name));
    }
    let budget = device.memory_budget.load(Ordering::Relaxed);
    if budget != u64::MAX {
        let used = bytes_in_use(&device.allocator);
        if used + bytes > budget {
            return refusal(format!("{used} of {budget} bytes that it may take are in use"));
        }
    }
    Ok(())
}

/// Makes an error of a failed creation call: out of memory with the resource's name, or the call.
fn creation_error(call: &'static str, name: &str, bytes: u64) -> impl FnOnce(vk::Result) -> Error {
    move |result| match result {
        vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY => {
            Error::OutOfMemory { call, what: name.into(), bytes, reason: format!("{result:?}") }
        }
        result => Error::Call { call, result },
    }
}

/// A buffer and its memory.
pub(super) struct Buffer {
    pub raw: vk::Buffer,
    memory: Option<Memory>,
    device: Arc<Device>,
}

impl Buffer {
    /// A buffer that kernels use, and a caller's shaders as a storage, vertex or texel buffer.
    pub fn storage(device: &Arc<Device>, name: &str, bytes: u64) -> Result<Self, Error> {
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::VERTEX_BUFFER
            | vk::BufferUsageFlags::UNIFORM_TEXEL_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        Self::new(device, name, bytes, usage, MemoryLocation::GpuOnly)
    }

    /// A buffer that the host writes and copies read.
    pub fn to_device(device: &Arc<Device>, bytes: u64) -> Result<Self, Error> {
        Self::new(device, "upload", bytes, vk::BufferUsageFlags::TRANSFER_SRC, MemoryLocation::CpuToGpu)
    }

    /// A buffer that copies write and the host reads.
    pub fn to_host(device: &Arc<Device>, bytes: u64) -> Result<Self, Error> {
        Self::new(device, "download", bytes, vk::BufferUsageFlags::TRANSFER_DST, MemoryLocation::GpuToCpu)
    }

    fn new(
        device: &Arc<Device>,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
        location: MemoryLocation,
    ) -> Result<Self, Error> {
        check_size(device, "vkCreateBuffer", name, bytes)?;
        let create = vk::BufferCreateInfo::default().size(bytes).usage(usage).sharing_mode(vk::SharingMode::EXCLUSIVE);
        // SAFETY: the device is alive; the size is not 0.
        let raw = unsafe { device.raw.create_buffer(&create, None) }.map_err(creation_error(
            "vkCreateBuffer",
            name,
            bytes,
        ))?;
        let mut buffer = Self { raw, memory: None, device: Arc::clone(device) };
        // SAFETY: the buffer was made from this device.
        let requirements = unsafe { device.raw.get_buffer_memory_requirements(raw) };
        let memory =
            Memory::new(&device.allocator, &MemoryRequest { name, bytes, requirements, location, linear: true })?;
        let (handle, offset) = memory.handle();
        // SAFETY: the memory was allocated for this buffer's requirements and is bound once.
        unsafe { device.raw.bind_buffer_memory(raw, handle, offset) }.map_err(creation_error(
            "vkBindBufferMemory",
            name,
            bytes,
        ))?;
        buffer.memory = Some(memory);
        Ok(buffer)
    }

    /// The bytes of a buffer that the host sees; empty for others.
    pub fn mapped(&self) -> &[u8] {
        self.memory.as_ref().map(Memory::mapped).unwrap_or_default()
    }

    /// As [`Buffer::mapped`], to write.
    pub fn mapped_mut(&mut self) -> &mut [u8] {
        self.memory.as_mut().map(Memory::mapped_mut).unwrap_or_default()
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        // SAFETY: every submission that uses the buffer is waited for before its owner drops it; its memory goes after
        // it (field drop).
        unsafe { self.device.raw.destroy_buffer(self.raw, None) };
    }
}

/// A sampled picture, its view and its memory.
pub(super) struct Image {
    pub raw: vk::Image,
    pub view: vk::ImageView,
    pub extent: vk::Extent3D,
    pub format: ImageFormat,
    _memory: Option<Memory>,
    device: Arc<Device>,
}

impl Image {
    /// A picture that kernels fetch from, contents undefined.
    pub fn new(
        device: &Arc<Device>,
        name: &str,
        format: ImageFormat,
        width: u32,
        height: u32,
        bytes: u64,
    ) -> Result<Self, Error> {
        check_size(device, "vkCreateImage", name, bytes)?;
        let extent = vk::Extent3D { width, height, depth: 1 };
        let create = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(vulkan_format(format))
            .extent(extent)
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(vk::ImageUsageFlags::SAMPLED | vk::ImageUsageFlags::TRANSFER_DST | vk::ImageUsageFlags::TRANSFER_SRC)
            .sharing_mode(vk::SharingMode::EXCLUSIVE)
            .initial_layout(vk::ImageLayout::UNDEFINED);
        // SAFETY: the device is alive; the caller keeps width and height within the device's limits and above 0.
        let raw =
            unsafe { device.raw.create_image(&create, None) }.map_err(creation_error("vkCreateImage", name, bytes))?;
        let mut image =
            Self { raw, view: vk::ImageView::null(), extent, format, _memory: None, device: Arc::clone(device) };
        // SAFETY: the image was made from this device.
        let requirements = unsafe { device.raw.get_image_memory_requirements(raw) };
        let location = MemoryLocation::GpuOnly;
        let request = MemoryRequest { name, bytes, requirements, location, linear: false };
        let memory = Memory::new(&device.allocator, &request)?;
        let (handle, offset) = memory.handle();
        // SAFETY: the memory was allocated for this image's requirements and is bound once.
        unsafe { device.raw.bind_image_memory(raw, handle, offset) }.map_err(creation_error(
            "vkBindImageMemory",
            name,
            bytes,
        ))?;
        image._memory = Some(memory);
        let create = vk::ImageViewCreateInfo::default()
            .image(raw)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(vulkan_format(format))
            .subresource_range(WHOLE_IMAGE);
        // SAFETY: the image is bound to memory and has the format and the one level that the view names.
        image.view = unsafe { device.raw.create_image_view(&create, None) }.map_err(creation_error(
            "vkCreateImageView",
            name,
            bytes,
        ))?;
        Ok(image)
    }

    /// Bytes of a row of texels or of blocks.
    pub fn row_bytes(&self) -> u64 {
        self.format.row_bytes(self.extent.width)
    }

    /// Returns true if texels are stored in blocks.
    pub fn is_blocks(&self) -> bool {
        self.format.block_edge() > 1
    }
}

impl Drop for Image {
    fn drop(&mut self) {
        // SAFETY: every submission that uses the picture is waited for before its owner drops it; the view goes before
        // its image, the memory after it (field drop). A null view is allowed.
        unsafe {
            self.device.raw.destroy_image_view(self.view, None);
            self.device.raw.destroy_image(self.raw, None);
        }
    }
}

fn vulkan_format(format: ImageFormat) -> vk::Format {
    match format {
        ImageFormat::Rgba32Float => vk::Format::R32G32B32A32_SFLOAT,
        ImageFormat::Rgba16Float => vk::Format::R16G16B16A16_SFLOAT,
        ImageFormat::Bc1Rgb => vk::Format::BC1_RGB_UNORM_BLOCK,
        ImageFormat::Bc3 => vk::Format::BC3_UNORM_BLOCK,
        ImageFormat::Bc6hUfloat => vk::Format::BC6H_UFLOAT_BLOCK,
        ImageFormat::Bc7 => vk::Format::BC7_UNORM_BLOCK,
    }
}

/// The one level and layer of every picture.
pub(super) const WHOLE_IMAGE: vk::ImageSubresourceRange = vk::ImageSubresourceRange {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    base_mip_level: 0,
    level_count: 1,
    base_array_layer: 0,
    layer_count: 1,
};
