//! The images of the window.

use std::sync::Arc;

use ash::vk;

use super::gpu::{Device, Surface};
use crate::error::Error;

/// Uses of the images: pictures are copied into them, panels drawn over these.
const USAGE: vk::ImageUsageFlags = vk::ImageUsageFlags::from_raw(
    vk::ImageUsageFlags::COLOR_ATTACHMENT.as_raw() | vk::ImageUsageFlags::TRANSFER_DST.as_raw(),
);
/// All of an image.
pub(super) const WHOLE: vk::ImageSubresourceRange = vk::ImageSubresourceRange {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    base_mip_level: 0,
    level_count: 1,
    base_array_layer: 0,
    layer_count: 1,
};

/// The pass that draws panels over what is there.
pub(super) struct RenderPass {
    pub raw: vk::RenderPass,
    device: Arc<Device>,
}

impl RenderPass {
    pub fn new(device: &Arc<Device>, format: vk::Format) -> Result<Self, Error> {
        let layout = vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL;
        let attachments = [vk::AttachmentDescription::default()
            .format(format)
            .samples(vk::SampleCountFlags::TYPE_1)
            .load_op(vk::AttachmentLoadOp::LOAD)
            .store_op(vk::AttachmentStoreOp::STORE)
            .initial_layout(layout)
            .final_layout(layout)];
        let references = [vk::AttachmentReference { attachment: 0, layout }];
        let subpasses = [vk::SubpassDescription::default()
            .pipeline_bind_point(vk::PipelineBindPoint::GRAPHICS)
            .color_attachments(&references)];
        let create = vk::RenderPassCreateInfo::default().attachments(&attachments).subpasses(&subpasses);
        // SAFETY: the device is alive, and all that `create` points to lives through the call.
        let raw = unsafe { device.raw.create_render_pass(&create, None) }.map_err(Error::call("vkCreateRenderPass"))?;
        Ok(Self { raw, device: Arc::clone(device) })
    }
}

impl Drop for RenderPass {
    fn drop(&mut self) {
        // SAFETY: `Screen` waits before it ends.
        unsafe { self.device.raw.destroy_render_pass(self.raw, None) };
    }
}

/// An image of the window.
pub(super) struct Target {
    pub image: vk::Image,
    view: vk::ImageView,
    pub framebuffer: vk::Framebuffer,
    /// Signalled when it is drawn.
    pub drawn: vk::Semaphore,
}

/// The images of the window at one size.
pub(super) struct Swapchain {
    pub raw: vk::SwapchainKHR,
    pub extent: vk::Extent2D,
    pub targets: Vec<Target>,
    /// True if the images can be copied from.
    pub can_capture: bool,
    device: Arc<Device>,
}

/// The format of the images: bytes as they are displayed, so that pictures are copied as they are.
pub(super) fn find_format(device: &Device, surface: &Surface) -> Result<vk::SurfaceFormatKHR, Error> {
    // SAFETY: the surface is of the device's instance.
    let formats = unsafe { device.gpu.surfaces.get_physical_device_surface_formats(device.physical, surface.raw) }
        .map_err(Error::call("vkGetPhysicalDeviceSurfaceFormatsKHR"))?;
    let suits = |format: &&vk::SurfaceFormatKHR| {
        matches!(format.format, vk::Format::B8G8R8A8_UNORM | vk::Format::R8G8B8A8_UNORM)
            && format.color_space == vk::ColorSpaceKHR::SRGB_NONLINEAR
    };
    let reason = || format!("{} offers no window of 8 bits a channel in sRGB", device.info.name);
    formats.iter().find(suits).copied().ok_or_else(|| Error::NoDevice { reason: reason() })
}

impl Swapchain {
    /// The images of a window of its size now, in place of older ones; none of a window without pixels.
    pub fn new(
        device: &Arc<Device>,
        surface: &Surface,
        format: vk::SurfaceFormatKHR,
        pass: &RenderPass,
        old: Option<Self>,
    ) -> Result<Option<Self>, Error> {
        // SAFETY: the surface is of the device's instance.
        let limits =
            unsafe { device.gpu.surfaces.get_physical_device_surface_capabilities(device.physical, surface.raw) }
                .map_err(Error::call("vkGetPhysicalDeviceSurfaceCapabilitiesKHR"))?;
        let extent = extent(&limits, surface.size());
        device.wait();
        if extent.width == 0 || extent.height == 0 {
            return Ok(None);
        }
        if !limits.supported_usage_flags.contains(USAGE) {
            let reason = format!("{} cannot copy pictures into a window", device.info.name);
            return Err(Error::NoDevice { reason });
        }
        let can_capture = limits.supported_usage_flags.contains(vk::ImageUsageFlags::TRANSFER_SRC);
        let usage = if can_capture { USAGE | vk::ImageUsageFlags::TRANSFER_SRC } else { USAGE };
        let most = if limits.max_image_count == 0 { u32::MAX } else { limits.max_image_count };
        let alpha = [vk::CompositeAlphaFlagsKHR::OPAQUE, vk::CompositeAlphaFlagsKHR::INHERIT]
            .into_iter()
            .find(|alpha| limits.supported_composite_alpha.contains(*alpha));
        let create = vk::SwapchainCreateInfoKHR::default()
            .surface(surface.raw)
            .min_image_count((limits.min_image_count + 1).min(most))
            .image_format(format.format)
            .image_color_space(format.color_space)
            .image_extent(extent)
            .image_array_layers(1)
            .image_usage(usage)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(limits.current_transform)
            .composite_alpha(alpha.unwrap_or(vk::CompositeAlphaFlagsKHR::OPAQUE))
            .present_mode(vk::PresentModeKHR::FIFO)
            .clipped(true)
            .old_swapchain(old.as_ref().map_or(vk::SwapchainKHR::null(), |old| old.raw));
        // SAFETY: the surface is alive and shown by this device; the older swapchain is its, and nothing of it is in
        // use.
        let raw = unsafe { device.swapchains.create_swapchain(&create, None) }
            .map_err(Error::call("vkCreateSwapchainKHR"))?;
        let device = Arc::clone(device);
        let mut swapchain = Self { raw, extent, targets: Vec::new(), can_capture, device };
        drop(old);
        swapchain.add_targets(format.format, pass)?;
        Ok(Some(swapchain))
    }

    fn add_targets(&mut self, format: vk::Format, pass: &RenderPass) -> Result<(), Error> {
        let raw = &self.device.raw;
        // SAFETY: the swapchain is alive.
        let images = unsafe { self.device.swapchains.get_swapchain_images(self.raw) }
            .map_err(Error::call("vkGetSwapchainImagesKHR"))?;
        for image in images {
            let mut target = Target {
                image,
                view: vk::ImageView::null(),
                framebuffer: vk::Framebuffer::null(),
                drawn: vk::Semaphore::null(),
            };
            let create = vk::ImageViewCreateInfo::default()
                .image(image)
                .view_type(vk::ImageViewType::TYPE_2D)
                .format(format)
                .subresource_range(WHOLE);
            // SAFETY: the image is the swapchain's, of this format.
            let view = unsafe { raw.create_image_view(&create, None) };
            target.view = view.map_err(Error::call("vkCreateImageView"))?;
            self.targets.push(target);
            let Some(target) = self.targets.last_mut() else { continue };
            let views = [target.view];
            let create = vk::FramebufferCreateInfo::default()
                .render_pass(pass.raw)
                .attachments(&views)
                .width(self.extent.width)
                .height(self.extent.height)
                .layers(1);
            // SAFETY: the view is of the pass's format, and outlives the framebuffer; the device is alive.
            unsafe {
                let framebuffer = raw.create_framebuffer(&create, None);
                target.framebuffer = framebuffer.map_err(Error::call("vkCreateFramebuffer"))?;
                let semaphore = raw.create_semaphore(&vk::SemaphoreCreateInfo::default(), None);
                target.drawn = semaphore.map_err(Error::call("vkCreateSemaphore"))?;
            }
        }
        Ok(())
    }
}

impl Drop for Swapchain {
    fn drop(&mut self) {
        self.device.wait();
        // SAFETY: nothing is under way; null handles are allowed; the images are the swapchain's.
        unsafe {
            for target in &self.targets {
                self.device.raw.destroy_semaphore(target.drawn, None);
                self.device.raw.destroy_framebuffer(target.framebuffer, None);
                self.device.raw.destroy_image_view(target.view, None);
            }
            self.device.swapchains.destroy_swapchain(self.raw, None);
        }
    }
}

/// The size that the window system wants, or that of the window where it leaves the choice.
fn extent(limits: &vk::SurfaceCapabilitiesKHR, window: (u32, u32)) -> vk::Extent2D {
    if limits.current_extent.width != u32::MAX {
        return limits.current_extent;
    }
    let least = limits.min_image_extent;
    let most = limits.max_image_extent;
    vk::Extent2D {
        width: window.0.clamp(least.width, most.width.max(least.width)),
        height: window.1.clamp(least.height, most.height.max(least.height)),
    }
}
