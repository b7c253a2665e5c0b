//! Light on a device of the caller's: its command buffers and fences, two frames in flight, no wait in between.
#![allow(unsafe_code, reason = "Vulkan's own calls")]

use patchlight::runtime::vulkan::ash::{Entry, vk};
use patchlight::runtime::vulkan::{API_VERSION, BorrowedDevice, EnabledFeatures, Vulkan, enable_features};
use patchlight::{Bake, BakeSettings, LightField, LightSettings, PictureRenderer, PictureSettings, Silent};
use std::sync::Arc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let loaded = assets::load_or_build("cornell")?;
    let bake = Bake::build(&loaded.scene, &BakeSettings::default().with_patch_count(300), &Silent)?;
    // SAFETY: handles live until the end; each command buffer is waited for by its fence before it is recorded again.
    unsafe {
        let entry = Entry::load()?;
        let app = vk::ApplicationInfo::default().api_version(API_VERSION);
        let instance = entry.create_instance(&vk::InstanceCreateInfo::default().application_info(&app), None)?;
        let physical_device = *instance.enumerate_physical_devices()?.first().ok_or("no Vulkan device")?;
        let (mut features, mut vulkan_1_2) = Default::default();
        enable_features(&instance.get_physical_device_features(physical_device), &mut features, &mut vulkan_1_2);
        let enabled = EnabledFeatures::of(&features, &vulkan_1_2);
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(0).queue_priorities(&[1.0])];
        let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_features(&features);
        let device = instance.create_device(physical_device, &create.push_next(&mut vulkan_1_2), None)?;
        let queue = device.get_device_queue(0, 0);
        let reset = vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER;
        let pool = device.create_command_pool(&vk::CommandPoolCreateInfo::default().flags(reset), None)?;
        let two = vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(2);
        let commands = device.allocate_command_buffers(&two)?;
        let signalled = vk::FenceCreateInfo::default().flags(vk::FenceCreateFlags::SIGNALED);
        let fences = [device.create_fence(&signalled, None)?, device.create_fence(&signalled, None)?];
        let ours = BorrowedDevice { instance, physical_device, device, queue_family: 0, queue, enabled };
        let vulkan = Box::new(Vulkan::borrow(ours.clone())?);
        let instance = ours.instance;
        let device = ours.device;
        let mut field = LightField::new(Arc::new(bake), vulkan, &LightSettings::default(), &Silent)?;
        let mut lighting = loaded.scene.lighting.clone();
        for slot in [0, 1, 0, 1, 0, 1] {
            device.wait_for_fences(&fences[slot..=slot], true, u64::MAX)?;
            device.reset_fences(&fences[slot..=slot])?;
            device.begin_command_buffer(commands[slot], &vk::CommandBufferBeginInfo::default())?;
            lighting.lights[0].color *= 1.1;
            field.vulkan_mut().ok_or("not a Vulkan executor")?.begin_recording(commands[slot], slot)?;
            field.update(&lighting)?;
            field.vulkan_mut().ok_or("not a Vulkan executor")?.end_recording()?;
            device.end_command_buffer(commands[slot])?;
            let buffers = [commands[slot]];
            device.queue_submit(queue, &[vk::SubmitInfo::default().command_buffers(&buffers)], fences[slot])?;
        }
        device.wait_for_fences(&fences, true, u64::MAX)?;
        let buffer = field.buffers().interpolated;
        println!("irradiance of the interpolation points: {:?}", field.vulkan_mut().and_then(|v| v.buffer(buffer)));
        println!("{} values, W/m2", field.surface_irradiance()?.len());
        println!("irradiance alone: {} kB on the device", field.device_bytes() >> 10);
        let renderer = PictureRenderer::new(field, &PictureSettings::default())?;
        println!("with pictures of 960 x 540: {} kB", renderer.light().device_bytes() >> 10);
        drop(renderer);
        fences.iter().for_each(|&fence| device.destroy_fence(fence, None));
        device.destroy_command_pool(pool, None);
        device.destroy_device(None);
        instance.destroy_instance(None);
    }
    Ok(())
}
