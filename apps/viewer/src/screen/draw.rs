//! A frame of the window: pictures are copied into place, panels drawn over them, the image is presented.

use std::sync::Arc;

use ash::vk;
use egui::epaint::textures::TexturesDelta;
use egui::{ClippedPrimitive, TextureId};
use egui_ash_renderer::allocator::GpuAllocator;
use egui_ash_renderer::{Options, RenderMode, Renderer};
use runtime::executor::DeviceChoice;
use runtime::vulkan::{BufferHandle, Vulkan};
use winit::window::Window;

use super::gpu::{Device, Gpu, Surface};
use super::picture::{HostBuffer, PIXEL, Picture};
use super::swapchain::{RenderPass, Swapchain, Target, WHOLE, find_format};
use crate::error::Error;
use crate::fit::{Area, Part, split};

/// Number of attempts to draw a frame of a window that takes another size meanwhile.
const TRIES: u32 = 3;

/// Which of the two pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// That of the method.
    Left = 0,
    /// The reference.
    Right = 1,
}

/// Source of a picture: bytes red, green, blue and 255, row by row from the top.
pub enum Source<'a> {
    /// A buffer of the executor on this device, after its last submission.
    Device(BufferHandle),
    /// The host.
    Host(&'a [u8]),
}

/// Drawing of egui's output.
pub struct Panels {
    /// Triangles.
    pub primitives: Vec<ClippedPrimitive>,
    /// Textures that are new, and that are used no more.
    pub textures: TexturesDelta,
    /// Pixels a point.
    pub pixels_per_point: f32,
}

/// The window as it was shown, bytes red, green, blue of each pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Capture {
    /// Its size, pixels.
    pub size: (u32, u32),
    /// `3 · width · height` bytes, row by row from the top.
    pub bytes: Vec<u8>,
}

/// A window on a device.
pub struct Screen {
    // Fields end from the first to the last, after `drop` has waited.
    panels: Renderer<GpuAllocator>,
    pictures: [Option<Picture>; 2],
    /// Updates that the next frame copies into them.
    pending: [Option<Pending>; 2],
    swapchain: Option<Swapchain>,
    pass: RenderPass,
    frame: FrameObjects,
    format: vk::SurfaceFormatKHR,
    surface: Surface,
    device: Arc<Device>,
    /// True if the images no longer have the size of the window.
    is_stale: bool,
    /// Textures that the last frame used last.
    freed: Vec<TextureId>,
}

/// The window in a buffer that the host reads.
struct Copied {
    buffer: HostBuffer,
    size: (u32, u32),
}

/// A buffer whose bytes become a picture.
#[derive(Clone, Copy)]
struct Pending {
    buffer: vk::Buffer,
    offset: u64,
}

/// Vulkan objects of one frame at a time.
struct FrameObjects {
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    /// Signalled when the last frame is drawn.
    fence: vk::Fence,
    /// Signalled when an image is free.
    acquired: vk::Semaphore,
    device: Arc<Device>,
}

impl FrameObjects {
    fn new(device: &Arc<Device>) -> Result<Self, Error> {
        let raw = &device.raw;
        let mut objects = Self {
            pool: vk::CommandPool::null(),
            commands: vk::CommandBuffer::null(),
            fence: vk::Fence::null(),
            acquired: vk::Semaphore::null(),
            device: Arc::clone(device),
        };
        let create = vk::CommandPoolCreateInfo::default()
            .queue_family_index(device.family)
            .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER);
        let signalled = vk::FenceCreateInfo::default().flags(vk::FenceCreateFlags::SIGNALED);
        // SAFETY: the device is alive, the family is its queue's, the pool is made before its buffer.
        unsafe {
            objects.pool = raw.create_command_pool(&create, None).map_err(Error::call("vkCreateCommandPool"))?;
            let allocate = vk::CommandBufferAllocateInfo::default().command_pool(objects.pool).command_buffer_count(1);
            let buffers = raw.allocate_command_buffers(&allocate);
            objects.commands = buffers.map_err(Error::call("vkAllocateCommandBuffers"))?[0];
            objects.fence = raw.create_fence(&signalled, None).map_err(Error::call("vkCreateFence"))?;
            let semaphore = raw.create_semaphore(&vk::SemaphoreCreateInfo::default(), None);
            objects.acquired = semaphore.map_err(Error::call("vkCreateSemaphore"))?;
        }
        Ok(objects)
    }

    /// Waits for the last frame.
    fn wait(&self) -> Result<(), Error> {
        // SAFETY: the fence is alive, and signalled or given to a submission.
        unsafe { self.device.raw.wait_for_fences(&[self.fence], true, u64::MAX) }
            .map_err(Error::call("vkWaitForFences"))
    }
}

impl Drop for FrameObjects {
    fn drop(&mut self) {
        // SAFETY: nothing is under way; null handles are allowed.
        unsafe {
            self.device.raw.destroy_semaphore(self.acquired, None);
            self.device.raw.destroy_fence(self.fence, None);
            self.device.raw.destroy_command_pool(self.pool, None);
        }
    }
}

impl Screen {
    /// The window on the device that answers to the choice, and the executor on that device, if kernels run there.
    ///
    /// # Errors
    /// [`Error::NoDevice`]; what Vulkan says.
    pub fn new(gpu: &Arc<Gpu>, window: Arc<Window>, choice: &DeviceChoice) -> Result<(Self, Option<Vulkan>), Error> {
        let surface = Surface::new(gpu, window)?;
        let device = Device::new(&surface, choice)?;
        let executor = device.executor()?;
        let format = find_format(&device, &surface)?;
        let pass = RenderPass::new(&device, format.format)?;
        let panels = Renderer::with_gpu_allocator(
            Arc::clone(&device.allocator),
            device.raw.clone(),
            RenderMode::RenderPass(pass.raw),
            Options::default(),
        )?;
        let frame = FrameObjects::new(&device)?;
        let swapchain = Swapchain::new(&device, &surface, format, &pass, None)?;
        let screen = Self {
            panels,
            pictures: [None, None],
            pending: [None, None],
            swapchain,
            pass,
            frame,
            format,
            surface,
            device,
            is_stale: false,
            freed: Vec::new(),
        };
        Ok((screen, executor))
    }

    /// Name of the device.
    pub fn device_name(&self) -> &str {
        &self.device.info.name
    }

    /// Greatest width and height of a texture.
    pub fn max_image_edge(&self) -> u32 {
        self.device.info.max_image_edge
    }

    /// Says that the window has another size.
    pub fn resize(&mut self) {
        self.is_stale = true;
    }

    /// Gives a picture, which is shown from the next frame on; waits for the frame before.
    ///
    /// # Errors
    /// What Vulkan says.
    pub fn set_picture(&mut self, side: Side, size: (u32, u32), source: &Source) -> Result<(), Error> {
        self.frame.wait()?;
        let place = &mut self.pictures[side as usize];
        if place.as_ref().is_none_or(|picture| picture.size != size) {
            *place = None;
        }
        let picture = match place {
            Some(picture) => picture,
            None => place.insert(Picture::new(&self.device, size)?),
        };
        let (buffer, offset) = match source {
            Source::Device(handle) => (handle.buffer, handle.offset),
            Source::Host(bytes) => (picture.stage(bytes)?, 0),
        };
        self.pending[side as usize] = Some(Pending { buffer, offset });
        Ok(())
    }

    /// Draws a frame, with the reference at the right of `at` of the width if there is one; gives the window as it is
    /// shown where that is asked for. Nothing is drawn into a window without pixels.
    ///
    /// # Errors
    /// What Vulkan says.
    pub fn draw(&mut self, panels: &mut Panels, at: Option<f32>, captures: bool) -> Result<Option<Capture>, Error> {
        self.frame.wait()?;
        self.update_textures(&mut panels.textures)?;
        let mut capture = None;
        for _ in 0..TRIES {
            if self.is_stale || self.swapchain.is_none() {
                let old = self.swapchain.take();
                self.swapchain = Swapchain::new(&self.device, &self.surface, self.format, &self.pass, old)?;
                self.is_stale = false;
            }
            let copied = self.draw_into_window(panels, at, captures)?;
            if captures || self.is_stale {
                self.frame.wait()?;
            }
            capture = copied.map(|copied| self.read(&copied));
            if !self.is_stale {
                break;
            }
        }
        self.device.gpu.check_messages()?;
        Ok(capture)
    }

    /// Frees the textures of the frame before, and takes over those of this one.
    fn update_textures(&mut self, textures: &mut TexturesDelta) -> Result<(), Error> {
        for id in self.freed.drain(..) {
            self.panels.free_texture(id)?;
        }
        for (id, deltas) in textures.set.drain() {
            for delta in deltas {
                self.panels.set_texture(self.device.queue, self.frame.pool, id, &delta)?;
            }
        }
        self.freed.extend(textures.free.drain());
        Ok(())
    }

    /// The bytes of a copy of the window.
    fn read(&self, copied: &Copied) -> Capture {
        let is_reversed = self.format.format == vk::Format::B8G8R8A8_UNORM;
        let rgb =
            |pixel: &[u8]| if is_reversed { [pixel[2], pixel[1], pixel[0]] } else { [pixel[0], pixel[1], pixel[2]] };
        let bytes = copied.buffer.read().chunks_exact(PIXEL as usize).flat_map(rgb).collect();
        Capture { size: copied.size, bytes }
    }

    fn draw_into_window(&mut self, panels: &Panels, at: Option<f32>, captures: bool) -> Result<Option<Copied>, Error> {
        let Some(swapchain) = &self.swapchain else { return Ok(None) };
        let chain = swapchain.raw;
        // SAFETY: the swapchain and the semaphore are alive; nothing waits for the semaphore: the last frame is drawn.
        let acquired = unsafe {
            self.device.swapchains.acquire_next_image(chain, u64::MAX, self.frame.acquired, vk::Fence::null())
        };
        let index = match acquired {
            Ok((index, is_suboptimal)) => {
                self.is_stale |= is_suboptimal;
                index
            }
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => {
                self.is_stale = true;
                return Ok(None);
            }
            Err(result) => return Err(Error::Call { call: "vkAcquireNextImageKHR", result }),
        };
        let extent = swapchain.extent;
        let capture = match captures && swapchain.can_capture {
            true => {
                let bytes = PIXEL * u64::from(extent.width) * u64::from(extent.height);
                Some(HostBuffer::to_host(&self.device, bytes)?)
            }
            false => None,
        };
        let drawn = self.record(index as usize, panels, at, capture.as_ref())?;
        self.submit(drawn)?;
        let chains = [chain];
        let indices = [index];
        let semaphores = [drawn];
        let present =
            vk::PresentInfoKHR::default().wait_semaphores(&semaphores).swapchains(&chains).image_indices(&indices);
        // SAFETY: the image was acquired, and the semaphore is signalled by the submission; one thread uses the queue.
        match unsafe { self.device.swapchains.queue_present(self.device.queue, &present) } {
            Ok(is_suboptimal) => self.is_stale |= is_suboptimal,
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => self.is_stale = true,
            Err(result) => return Err(Error::Call { call: "vkQueuePresentKHR", result }),
        }
        Ok(capture.map(|buffer| Copied { buffer, size: (extent.width, extent.height) }))
    }

    /// Records the commands of a frame; the semaphore that says that the image is drawn.
    fn record(
        &mut self,
        index: usize,
        panels: &Panels,
        at: Option<f32>,
        capture: Option<&HostBuffer>,
    ) -> Result<vk::Semaphore, Error> {
        let Some(swapchain) = &self.swapchain else { return Ok(vk::Semaphore::null()) };
        let Target { image, framebuffer, drawn, .. } = swapchain.targets[index];
        let extent = swapchain.extent;
        let commands = self.frame.commands;
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the last frame is drawn, so the command buffer is not in use; its pool allows the implicit reset.
        unsafe { self.device.raw.begin_command_buffer(commands, &begin) }
            .map_err(Error::call("vkBeginCommandBuffer"))?;
        let recorder = Recorder { raw: &self.device.raw, commands };
        for (picture, pending) in self.pictures.iter_mut().zip(&mut self.pending) {
            if let (Some(picture), Some(source)) = (picture, pending.take()) {
                recorder.fill(picture, source);
                picture.is_filled = true;
            }
        }
        recorder.change(image, vk::ImageLayout::UNDEFINED, vk::ImageLayout::TRANSFER_DST_OPTIMAL);
        recorder.clear(image);
        for (picture, part) in self.parts(extent, at) {
            recorder.copy_part(picture, image, part);
        }
        recorder.change(image, vk::ImageLayout::TRANSFER_DST_OPTIMAL, vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL);
        let begin = vk::RenderPassBeginInfo::default()
            .render_pass(self.pass.raw)
            .framebuffer(framebuffer)
            .render_area(vk::Rect2D { offset: vk::Offset2D::default(), extent });
        // SAFETY: recording, outside of a render pass; pass and framebuffer belong together.
        unsafe { self.device.raw.cmd_begin_render_pass(commands, &begin, vk::SubpassContents::INLINE) };
        let drawn_panels = self.panels.cmd_draw(commands, extent, panels.pixels_per_point, &panels.primitives);
        // SAFETY: recording, inside the render pass.
        unsafe { self.device.raw.cmd_end_render_pass(commands) };
        let recorder = Recorder { raw: &self.device.raw, commands };
        let mut layout = vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL;
        if let Some(capture) = capture {
            recorder.change(image, layout, vk::ImageLayout::TRANSFER_SRC_OPTIMAL);
            layout = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
            recorder.copy_out(image, extent, capture);
        }
        recorder.change(image, layout, vk::ImageLayout::PRESENT_SRC_KHR);
        // SAFETY: recording.
        unsafe { self.device.raw.end_command_buffer(commands) }.map_err(Error::call("vkEndCommandBuffer"))?;
        drawn_panels?;
        Ok(drawn)
    }

    /// The parts of the pictures that are there, and where they go.
    fn parts(&self, extent: vk::Extent2D, at: Option<f32>) -> Vec<(&Picture, Part)> {
        let filled = |side: Side| self.pictures[side as usize].as_ref().filter(|picture| picture.is_filled);
        let Some(left) = filled(Side::Left) else { return Vec::new() };
        let right = filled(Side::Right).filter(|right| right.size == left.size);
        let at = at.filter(|_| right.is_some()).unwrap_or(1.0);
        let parts = split(left.size, (extent.width, extent.height), at);
        let both = [Some(left), right].into_iter().zip(parts);
        let shown = both.filter_map(|(picture, part)| Some((picture?, part)));
        shown.filter(|(_, part)| !part.from.is_empty() && !part.to.is_empty()).collect()
    }

    fn submit(&self, drawn: vk::Semaphore) -> Result<(), Error> {
        let commands = [self.frame.commands];
        let waits = [self.frame.acquired];
        let signals = [drawn];
        let stages = [vk::PipelineStageFlags::ALL_COMMANDS];
        let submits = [vk::SubmitInfo::default()
            .command_buffers(&commands)
            .wait_semaphores(&waits)
            .wait_dst_stage_mask(&stages)
            .signal_semaphores(&signals)];
        // SAFETY: the fence is signalled and not in use; the command buffer is recorded; the semaphores are alive, one
        // to be signalled by the swapchain, one unused; all that the commands use outlives them, as whoever frees it
        // waits.
        unsafe {
            self.device.raw.reset_fences(&[self.frame.fence]).map_err(Error::call("vkResetFences"))?;
            let submitted = self.device.raw.queue_submit(self.device.queue, &submits, self.frame.fence);
            submitted.map_err(Error::call("vkQueueSubmit"))
        }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.device.wait();
    }
}

/// A command buffer that is being recorded, outside of a render pass.
struct Recorder<'a> {
    raw: &'a ash::Device,
    commands: vk::CommandBuffer,
}

impl Recorder<'_> {
    /// Brings an image from one layout into another, after everything before and before everything after.
    fn change(&self, image: vk::Image, from: vk::ImageLayout, to: vk::ImageLayout) {
        let all = vk::AccessFlags::MEMORY_READ | vk::AccessFlags::MEMORY_WRITE;
        let barriers = [vk::ImageMemoryBarrier::default()
            .image(image)
            .subresource_range(WHOLE)
            .old_layout(from)
            .new_layout(to)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .src_access_mask(all)
            .dst_access_mask(all)];
        let stages = vk::PipelineStageFlags::ALL_COMMANDS;
        let flags = vk::DependencyFlags::empty();
        // SAFETY: recording; the image is alive, and in the layout that is named.
        unsafe { self.raw.cmd_pipeline_barrier(self.commands, stages, stages, flags, &[], &[], &barriers) };
    }

    /// Copies a buffer into a picture, which is to be copied from.
    fn fill(&self, picture: &Picture, source: Pending) {
        let target = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
        self.change(picture.image, vk::ImageLayout::UNDEFINED, target);
        let regions = [whole_copy(source.offset, picture.size)];
        // SAFETY: recording; the buffer has the bytes of all pixels from the offset on; the barrier before made them
        // visible.
        unsafe { self.raw.cmd_copy_buffer_to_image(self.commands, source.buffer, picture.image, target, &regions) };
        self.change(picture.image, target, vk::ImageLayout::TRANSFER_SRC_OPTIMAL);
    }

    fn clear(&self, image: vk::Image) {
        let layout = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
        let black = vk::ClearColorValue { float32: [0.0, 0.0, 0.0, 1.0] };
        // SAFETY: recording; the image is in this layout.
        unsafe { self.raw.cmd_clear_color_image(self.commands, image, layout, &black, &[WHOLE]) };
        self.change(image, layout, layout);
    }

    /// Copies a part of a picture into a part of the window: as it is where they are equally large.
    fn copy_part(&self, picture: &Picture, image: vk::Image, part: Part) {
        let is_exact = part.from.width() == part.to.width() && part.from.height() == part.to.height();
        let filter = if is_exact { vk::Filter::NEAREST } else { vk::Filter::LINEAR };
        let region = [vk::ImageBlit {
            src_subresource: LAYERS,
            src_offsets: corners(part.from),
            dst_subresource: LAYERS,
            dst_offsets: corners(part.to),
        }];
        let from = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
        let to = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
        // SAFETY: recording; both images are alive and in these layouts, the areas within them.
        unsafe { self.raw.cmd_blit_image(self.commands, picture.image, from, image, to, &region, filter) };
    }

    fn copy_out(&self, image: vk::Image, extent: vk::Extent2D, buffer: &HostBuffer) {
        let regions = [whole_copy(0, (extent.width, extent.height))];
        let layout = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
        let barrier = [vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::TRANSFER_WRITE)
            .dst_access_mask(vk::AccessFlags::HOST_READ)];
        let from = vk::PipelineStageFlags::TRANSFER;
        let to = vk::PipelineStageFlags::HOST;
        // SAFETY: recording; the image is in this layout, and the buffer has the bytes of all its pixels.
        unsafe {
            self.raw.cmd_copy_image_to_buffer(self.commands, image, layout, buffer.raw, &regions);
            self.raw.cmd_pipeline_barrier(self.commands, from, to, vk::DependencyFlags::empty(), &barrier, &[], &[]);
        }
    }
}

const LAYERS: vk::ImageSubresourceLayers = vk::ImageSubresourceLayers {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    mip_level: 0,
    base_array_layer: 0,
    layer_count: 1,
};

fn corners(area: Area) -> [vk::Offset3D; 2] {
    [vk::Offset3D { x: area.min.0, y: area.min.1, z: 0 }, vk::Offset3D { x: area.max.0, y: area.max.1, z: 1 }]
}

fn whole_copy(offset: u64, (width, height): (u32, u32)) -> vk::BufferImageCopy {
    vk::BufferImageCopy {
        buffer_offset: offset,
        image_subresource: LAYERS,
        image_extent: vk::Extent3D { width, height, depth: 1 },
        ..vk::BufferImageCopy::default()
    }
}
