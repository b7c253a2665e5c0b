//! A renderer for Bevy whose device has what light needs.
#![allow(unsafe_code, reason = "Vulkan's own calls")]

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use bevy::render::renderer::{
    RenderAdapter, RenderAdapterInfo, RenderDevice, RenderInstance, RenderQueue, WgpuWrapper,
};
use bevy::render::settings::{RenderCreation, WgpuSettings};
use bevy::tasks::block_on;
use patchlight::runtime::vulkan::ash::vk::{self, Handle as _};
use patchlight::runtime::vulkan::{BorrowedDevice, EnabledFeatures, Vulkan, describe_device};
use wgpu::hal::api::Vulkan as Api;

/// Devices of [`vulkan_renderer`].
static OURS: Mutex<Option<HashSet<u64>>> = Mutex::new(None);

/// Why there is no renderer, or none that light can share.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PatchlightRendererError {
    /// No driver, or none of this name.
    #[error("no Vulkan device for the renderer: {0}")]
    NoDevice(String),
    /// The device is too old.
    #[error("the Vulkan device {device} lacks {feature}")]
    MissingFeature {
        /// Its name.
        device: String,
        /// Name of the feature in the Vulkan specification.
        feature: &'static str,
    },
    /// What Vulkan says.
    #[error("{call}: {result}")]
    Vulkan {
        /// The function that failed.
        call: &'static str,
        /// What it said.
        result: String,
    },
    /// Bevy draws on another device.
    #[error("Bevy's device is not of `vulkan_renderer`: give its result to `RenderPlugin::render_creation`")]
    OtherDevice,
}

/// Opens a Vulkan device with these settings, as Bevy would, and with the features that the kernels of light use
/// besides: for [`RenderPlugin::render_creation`](bevy::render::RenderPlugin::render_creation), so that
/// [`PatchlightSettings::shares_device`](crate::PatchlightSettings::shares_device) finds light where Bevy draws.
///
/// # Errors
/// [`PatchlightRendererError`]: a machine without Vulkan 1.2, or without its memory model.
pub fn vulkan_renderer(settings: &WgpuSettings) -> Result<RenderCreation, PatchlightRendererError> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::VULKAN,
        flags: settings.instance_flags,
        memory_budget_thresholds: settings.instance_memory_budget_thresholds,
        backend_options: wgpu::BackendOptions::default(),
        display: None,
    });
    let adapter = adapter(&instance, settings)?;
    let (device, queue) = open(&adapter, settings)?;
    Ok(RenderCreation::manual(
        RenderDevice::from(device),
        RenderQueue(Arc::new(WgpuWrapper::new(queue))),
        RenderAdapterInfo(WgpuWrapper::new(adapter.get_info())),
        RenderAdapter(Arc::new(WgpuWrapper::new(adapter))),
        RenderInstance(Arc::new(WgpuWrapper::new(instance))),
    ))
}

/// The adapter that the settings ask for.
fn adapter(instance: &wgpu::Instance, settings: &WgpuSettings) -> Result<wgpu::Adapter, PatchlightRendererError> {
    let Some(name) = std::env::var("WGPU_ADAPTER_NAME").ok().or_else(|| settings.adapter_name.clone()) else {
        let asked = wgpu::RequestAdapterOptions {
            power_preference: settings.power_preference,
            force_fallback_adapter: settings.force_fallback_adapter,
            compatible_surface: None,
        };
        let found = block_on(instance.request_adapter(&asked));
        return found.map_err(|error| PatchlightRendererError::NoDevice(error.to_string()));
    };
    let all = block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
    let is_asked = |adapter: &wgpu::Adapter| adapter.get_info().name.to_lowercase().contains(&name.to_lowercase());
    let found = all.into_iter().find(is_asked);
    found.ok_or_else(|| PatchlightRendererError::NoDevice(format!("none has {name} in its name")))
}

fn open(
    adapter: &wgpu::Adapter,
    settings: &WgpuSettings,
) -> Result<(wgpu::Device, wgpu::Queue), PatchlightRendererError> {
    let mut features = adapter.features();
    if adapter.get_info().device_type == wgpu::DeviceType::DiscreteGpu {
        // Slow where memory is not shared; Bevy leaves it out, too.
        features.remove(wgpu::Features::MAPPABLE_PRIMARY_BUFFERS);
    }
    features.remove(settings.disabled_features.unwrap_or(wgpu::Features::empty()));
    features |= settings.features;
    let mut limits = adapter.limits();
    if let Some(constrained) = &settings.constrained_limits {
        limits = limits.or_worse_values_from(constrained);
    }
    let descriptor = wgpu::DeviceDescriptor {
        label: settings.device_label.as_deref(),
        required_features: features,
        required_limits: limits,
        // SAFETY: what Bevy does; it tests features before it uses them.
        experimental_features: unsafe { wgpu::ExperimentalFeatures::enabled() },
        memory_hints: settings.memory_hints.clone(),
        trace: wgpu::Trace::Off,
    };
    let device = open_raw(adapter, &descriptor)?;
    // SAFETY: opened from this adapter, with these features.
    let made = unsafe { adapter.create_device_from_hal::<Api>(device, &descriptor) };
    made.map_err(|error| PatchlightRendererError::NoDevice(error.to_string()))
}

/// What `wgpu` would open, with Vulkan's memory model.
fn open_raw(
    adapter: &wgpu::Adapter,
    descriptor: &wgpu::DeviceDescriptor<'_>,
) -> Result<wgpu::hal::OpenDevice<Api>, PatchlightRendererError> {
    // SAFETY: nothing of it is destroyed.
    let adapter = unsafe { adapter.as_hal::<Api>() };
    let adapter = adapter.ok_or_else(|| PatchlightRendererError::NoDevice("the adapter has another driver".into()))?;
    let instance = adapter.shared_instance().raw_instance();
    let physical = adapter.raw_physical_device();
    // SAFETY: the adapter's own, and it lives.
    let info = unsafe { describe_device(instance, physical) };
    if let Some(feature) = info.missing_feature {
        return Err(PatchlightRendererError::MissingFeature { device: info.name, feature });
    }
    let extensions = adapter.required_device_extensions(descriptor.required_features);
    let mut features = adapter.physical_device_features(&extensions, descriptor.required_features);
    let names: Vec<_> = extensions.iter().map(|name| name.as_ptr()).collect();
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(0).queue_priorities(&[1.0])];
    let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&names);
    let create = features.add_to_device_create(create);
    // SAFETY: `features` lives, and nobody else has its structures.
    if !unsafe { enable_memory_model(&create) } {
        return Err(PatchlightRendererError::MissingFeature { device: info.name, feature: "vulkanMemoryModel" });
    }
    let failed =
        |result: vk::Result| PatchlightRendererError::Vulkan { call: "vkCreateDevice", result: result.to_string() };
    // SAFETY: the physical device is of this instance; the structures live.
    let raw = unsafe { instance.create_device(physical, &create, None) }.map_err(failed)?;
    let handle = raw.handle().as_raw();
    let (limits, hints) = (&descriptor.required_limits, &descriptor.memory_hints);
    // SAFETY: made from this adapter with these extensions and features, and one queue of family 0.
    let made =
        unsafe { adapter.device_from_raw(raw, None, &extensions, descriptor.required_features, limits, hints, 0, 0) };
    let made = made.map_err(|error| PatchlightRendererError::NoDevice(error.to_string()))?;
    OURS.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_default().insert(handle);
    Ok(made)
}

/// Enables Vulkan's memory model in the structure of a chain that asks for it; `false` if there is none.
///
/// # Safety
/// The chain's structures live, may be written to, and are used by nobody else.
unsafe fn enable_memory_model(create: &vk::DeviceCreateInfo<'_>) -> bool {
    let mut next = create.p_next.cast::<vk::BaseOutStructure<'_>>().cast_mut();
    while !next.is_null() {
        // SAFETY: each structure of a chain begins with its type and the next, as the caller promises it lives.
        let own = unsafe { &mut *next };
        if own.s_type == vk::StructureType::PHYSICAL_DEVICE_VULKAN_MEMORY_MODEL_FEATURES {
            // SAFETY: the type says so.
            let features = unsafe { &mut *next.cast::<vk::PhysicalDeviceVulkanMemoryModelFeatures<'_>>() };
            features.vulkan_memory_model = vk::TRUE;
            features.vulkan_memory_model_device_scope = vk::TRUE;
            return true;
        }
        next = own.p_next;
    }
    false
}

/// An executor on the device of a renderer.
///
/// # Errors
/// [`PatchlightRendererError::OtherDevice`] unless it is of [`vulkan_renderer`]; what the device says.
///
/// # Safety
/// The device outlives the executor. While one of the executor's functions runs, nobody else submits to the queue.
pub(crate) unsafe fn executor(device: &wgpu::Device) -> Result<Vulkan, patchlight::Error> {
    let other = || patchlight::Error::new(patchlight::ErrorKind::Device, PatchlightRendererError::OtherDevice);
    // SAFETY: nothing of it is destroyed.
    let own = unsafe { device.as_hal::<Api>() }.ok_or_else(other)?;
    let handle = own.raw_device().handle().as_raw();
    if !OURS.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_default().contains(&handle) {
        return Err(other());
    }
    let borrowed = BorrowedDevice {
        instance: own.shared_instance().raw_instance().clone(),
        physical_device: own.raw_physical_device(),
        device: own.raw_device().clone(),
        queue_family: own.queue_family_index(),
        queue: own.raw_queue(),
        enabled: EnabledFeatures {
            vulkan_memory_model: true,
            vulkan_memory_model_device_scope: true,
            texture_compression_bc: device.features().contains(wgpu::Features::TEXTURE_COMPRESSION_BC),
        },
    };
    // SAFETY: as the caller promises; the device is one of ours, with its features.
    let vulkan = unsafe { Vulkan::borrow(borrowed) };
    vulkan.map_err(|error| patchlight::Error::new(patchlight::ErrorKind::Device, error))
}
