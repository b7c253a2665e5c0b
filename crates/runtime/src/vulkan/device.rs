//! Instance, choice of a device, logical device. Everything here is freed in the right order on drop.

use std::ffi::{CStr, c_char, c_void};
use std::mem::ManuallyDrop;
use std::sync::{Arc, Mutex, PoisonError};

use ash::{ext, vk};
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};

use super::error::Error;
use crate::executor::{DeviceChoice, DeviceInfo, DeviceKind};

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// What the validation layer has said since the instance was made.
#[derive(Clone, Debug, Default)]
pub struct Messages(Arc<Mutex<Vec<String>>>);

impl Messages {
    /// Takes the messages out.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Whether the validation layer watches every call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Validation {
    /// No.
    Off,
    /// If it is installed.
    IfThere,
    /// Yes, or an error.
    Required,
}

impl Validation {
    /// By `PATCHLIGHT_VALIDATION` (1: required, 0: off); without it, debug builds use the layer if it is there.
    pub fn from_environment() -> Self {
        match std::env::var("PATCHLIGHT_VALIDATION").as_deref() {
            Ok("0") => Self::Off,
            Ok(value) if !value.is_empty() => Self::Required,
            _ if cfg!(debug_assertions) => Self::IfThere,
            _ => Self::Off,
        }
    }
}

pub(super) struct Instance {
    raw: ash::Instance,
    debug: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    pub messages: Messages,
    // Last: the library is unloaded after everything that points into it.
    _entry: ash::Entry,
}

impl Instance {
    pub fn new(validation: Validation) -> Result<Self, Error> {
        // SAFETY: the loader library is the system's; loading it has no precondition of ours.
        let entry = unsafe { ash::Entry::load() }?;
        // SAFETY: no pointer is passed; the function is called before any instance exists, as the specification allows.
        let layers = unsafe { entry.enumerate_instance_layer_properties() }
            .map_err(Error::call("vkEnumerateInstanceLayerProperties"))?;
        let has_layer = layers.iter().any(|l| l.layer_name_as_c_str() == Ok(VALIDATION_LAYER));
        if validation == Validation::Required && !has_layer {
            return Err(Error::NoValidationLayer);
        }
        let watched = validation != Validation::Off && has_layer;
        let layer_names: &[*const c_char] = if watched { &[VALIDATION_LAYER.as_ptr()] } else { &[] };
        let extension_names: &[*const c_char] = if watched { &[ext::debug_utils::NAME.as_ptr()] } else { &[] };
        let application =
            vk::ApplicationInfo::default().application_name(c"patchlight").api_version(vk::API_VERSION_1_2);
        let create = vk::InstanceCreateInfo::default()
            .application_info(&application)
            .enabled_layer_names(layer_names)
            .enabled_extension_names(extension_names);
        // SAFETY: `create` and all it points to live until the call returns; the names are null-terminated constants.
        let raw = unsafe { entry.create_instance(&create, None) }.map_err(|result| match result {
            vk::Result::ERROR_INCOMPATIBLE_DRIVER => {
                Error::NoDevice { reason: format!("vkCreateInstance: {result:?}") }
            }
            result => Error::Call { call: "vkCreateInstance", result },
        })?;
        let mut instance = Self { raw, debug: None, messages: Messages::default(), _entry: entry };
        if watched {
            let debug = ext::debug_utils::Instance::new(&instance._entry, &instance.raw);
            let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
                .message_severity(
                    vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
                )
                .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
                .pfn_user_callback(Some(collect_message))
                .user_data(Arc::as_ptr(&instance.messages.0).cast_mut().cast());
            // SAFETY: the user data is the mutex inside `messages`, which lives as long as the messenger: both end in
            // `drop`, the messenger first. The callback only locks it.
            let messenger = unsafe { debug.create_debug_utils_messenger(&create, None) }
                .map_err(Error::call("vkCreateDebugUtilsMessengerEXT"))?;
            instance.debug = Some((debug, messenger));
        }
        Ok(instance)
    }

    /// All devices in the loader's order.
    pub fn devices(&self) -> Result<Vec<Candidate>, Error> {
        // SAFETY: the instance is alive.
        let physical = unsafe { self.raw.enumerate_physical_devices() };
        let physical = match physical {
            Err(vk::Result::ERROR_INITIALIZATION_FAILED) => Vec::new(),
            other => other.map_err(Error::call("vkEnumeratePhysicalDevices"))?,
        };
        Ok(physical.into_iter().enumerate().map(|(index, physical)| self.describe(index, physical)).collect())
    }

    fn describe(&self, index: usize, physical: vk::PhysicalDevice) -> Candidate {
        // SAFETY: `physical` comes from this live instance.
        let plain = unsafe { self.raw.get_physical_device_properties(physical) };
        let has_1_2 = plain.api_version >= vk::API_VERSION_1_2;
        let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
        let mut allocation = vk::PhysicalDeviceMaintenance3Properties::default();
        let mut driver = vk::PhysicalDeviceDriverProperties::default();
        let mut features_1_2 = vk::PhysicalDeviceVulkan12Features::default();
        if has_1_2 {
            let mut properties = vk::PhysicalDeviceProperties2::default()
                .push_next(&mut subgroup)
                .push_next(&mut allocation)
                .push_next(&mut driver);
            // SAFETY: the chain holds structures of Vulkan 1.2, which the device offers, and lives through the call.
            unsafe { self.raw.get_physical_device_properties2(physical, &mut properties) };
            let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut features_1_2);
            // SAFETY: as above.
            unsafe { self.raw.get_physical_device_features2(physical, &mut features) };
        }
        // SAFETY: `physical` comes from this live instance.
        let features = unsafe { self.raw.get_physical_device_features(physical) };
        // SAFETY: as above.
        let memory = unsafe { self.raw.get_physical_device_memory_properties(physical) };
        // SAFETY: as above.
        let families = unsafe { self.raw.get_physical_device_queue_family_properties(physical) };

        let memory = memory
            .memory_heaps_as_slice()
            .iter()
            .filter(|h| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL))
            .map(|h| h.size)
            .sum();
        let family = families
            .iter()
            .enumerate()
            .filter(|(_, f)| f.queue_flags.contains(vk::QueueFlags::COMPUTE))
            .max_by_key(|(k, f)| (f.timestamp_valid_bits, std::cmp::Reverse(*k)))
            .map(|(k, f)| (k as u32, f.timestamp_valid_bits));
        let missing = if !has_1_2 {
            Some("Vulkan 1.2")
        } else if features_1_2.vulkan_memory_model == 0 {
            Some("vulkanMemoryModel")
        } else if features_1_2.vulkan_memory_model_device_scope == 0 {
            Some("vulkanMemoryModelDeviceScope")
        } else if family.is_none() {
            Some("a compute queue")
        } else {
            None
        };
        let (family, timestamp_bits) = family.unwrap_or_default();
        let version =
            |v: u32| format!("{}.{}.{}", vk::api_version_major(v), vk::api_version_minor(v), vk::api_version_patch(v));
        let text = |c: Result<&CStr, _>| c.map(|c: &CStr| c.to_string_lossy().into_owned()).unwrap_or_default();
        let info = DeviceInfo {
            name: text(plain.device_name_as_c_str()),
            kind: match plain.device_type {
                vk::PhysicalDeviceType::DISCRETE_GPU => DeviceKind::Discrete,
                vk::PhysicalDeviceType::INTEGRATED_GPU => DeviceKind::Integrated,
                vk::PhysicalDeviceType::VIRTUAL_GPU => DeviceKind::Virtual,
                vk::PhysicalDeviceType::CPU => DeviceKind::EmulatedOnCpu,
                _ => DeviceKind::Other,
            },
            index: Some(index),
            driver: format!("{} {}", text(driver.driver_name_as_c_str()), text(driver.driver_info_as_c_str()))
                .trim()
                .to_owned(),
            api_version: version(plain.api_version),
            memory_bytes: memory,
            max_storage_buffer_range: u64::from(plain.limits.max_storage_buffer_range),
            max_image_edge: plain.limits.max_image_dimension2_d,
            has_block_images: features.texture_compression_bc == vk::TRUE,
            shared_memory_bytes: plain.limits.max_compute_shared_memory_size,
            subgroup_size: subgroup.subgroup_size,
            has_timestamps: timestamp_bits > 0,
            missing_feature: missing,
            has_validation: self.debug.is_some(),
        };
        Candidate {
            physical,
            info,
            family,
            timestamp_bits,
            limits: plain.limits,
            max_allocation_bytes: allocation.max_memory_allocation_size,
        }
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if let Some((debug, messenger)) = self.debug.take() {
            // SAFETY: made from this instance, destroyed once; no other call is under way, since we own the instance.
            unsafe { debug.destroy_debug_utils_messenger(messenger, None) };
        }
        // SAFETY: every child (device, messenger) is gone: `Device` owns the instance and ends before it.
        unsafe { self.raw.destroy_instance(None) };
    }
}

/// Puts a message of the layer into the list.
unsafe extern "system" fn collect_message(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    messages: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes valid data with null-terminated (or null) text, and the user data that `Instance::new` gave
    // it: the mutex inside `Messages`, alive until the messenger is destroyed.
    unsafe {
        let text = (*data).message_as_c_str().map(|t| t.to_string_lossy().into_owned()).unwrap_or_default();
        let messages = &*messages.cast::<Mutex<Vec<String>>>();
        messages.lock().unwrap_or_else(PoisonError::into_inner).push(text);
    }
    vk::FALSE
}

/// A device that the loader offers.
pub(super) struct Candidate {
    physical: vk::PhysicalDevice,
    pub info: DeviceInfo,
    family: u32,
    timestamp_bits: u32,
    limits: vk::PhysicalDeviceLimits,
    max_allocation_bytes: u64,
}

/// Picks the device that answers to the choice; among several the best kind, then the first.
pub(super) fn choose(mut candidates: Vec<Candidate>, choice: &DeviceChoice) -> Result<Candidate, Error> {
    if candidates.is_empty() {
        return Err(Error::NoDevice { reason: "no driver offers one".into() });
    }
    let names: Vec<String> =
        candidates.iter().enumerate().map(|(k, c)| format!("{k}: {} ({})", c.info.name, c.info.kind)).collect();
    candidates.retain(|c| choice.admits(&c.info));
    // A device that lacks a feature is taken only when nothing else answers, to name what it lacks.
    candidates.sort_by_key(|c| (c.info.missing_feature.is_some(), c.info.kind, c.info.index));
    match candidates.into_iter().next() {
        None => Err(Error::UnknownDevice { wanted: choice.to_string(), available: names }),
        Some(Candidate { info: DeviceInfo { name, missing_feature: Some(feature), .. }, .. }) => {
            Err(Error::MissingFeature { device: name, feature })
        }
        Some(candidate) => Ok(candidate),
    }
}

/// A logical device with its one queue and its memory.
pub(super) struct Device {
    pub raw: ash::Device,
    pub queue: vk::Queue,
    pub family: u32,
    pub info: DeviceInfo,
    pub limits: vk::PhysicalDeviceLimits,
    pub timestamp_bits: u32,
    pub max_allocation_bytes: u64,
    pub allocator: ManuallyDrop<Mutex<Allocator>>,
    // After the device.
    pub instance: Instance,
}

impl Device {
    pub fn new(instance: Instance, candidate: Candidate) -> Result<Self, Error> {
        let queues =
            [vk::DeviceQueueCreateInfo::default().queue_family_index(candidate.family).queue_priorities(&[1.0])];
        let mut features = vk::PhysicalDeviceVulkan12Features::default()
            .vulkan_memory_model(true)
            .vulkan_memory_model_device_scope(true);
        let plain = vk::PhysicalDeviceFeatures::default().texture_compression_bc(candidate.info.has_block_images);
        let create = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_features(&plain)
            .push_next(&mut features);
        // SAFETY: the physical device belongs to the instance; `choose` made sure of queue family and features; the chain
        // lives through the call.
        let raw = unsafe { instance.raw.create_device(candidate.physical, &create, None) }
            .map_err(Error::call("vkCreateDevice"))?;
        // SAFETY: the device was made with one queue of this family.
        let queue = unsafe { raw.get_device_queue(candidate.family, 0) };
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.raw.clone(),
            device: raw.clone(),
            physical_device: candidate.physical,
            debug_settings: Default::default(),
            buffer_device_address: false,
            allocation_sizes: Default::default(),
        });
        let allocator = match allocator {
            Ok(allocator) => ManuallyDrop::new(Mutex::new(allocator)),
            Err(error) => {
                // SAFETY: nothing was made from the device yet.
                unsafe { raw.destroy_device(None) };
                return Err(Error::Allocator { what: "allocator".into(), bytes: 0, reason: error.to_string() });
            }
        };
        Ok(Self {
            raw,
            queue,
            family: candidate.family,
            info: candidate.info,
            limits: candidate.limits,
            timestamp_bits: candidate.timestamp_bits,
            max_allocation_bytes: candidate.max_allocation_bytes,
            allocator,
            instance,
        })
    }

    /// An error when the validation layer has said anything.
    pub fn check_messages(&self) -> Result<(), Error> {
        let messages = self.instance.messages.take();
        if messages.is_empty() { Ok(()) } else { Err(Error::Validation { messages }) }
    }

    /// A limit that a plan exceeds.
    pub fn limit(&self, what: String, name: &'static str, limit: u64, asked: u64, remedy: &'static str) -> Error {
        Error::Limit { what, name, device: self.info.name.clone(), limit, asked, remedy }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: every child holds an `Arc` of this device, so all are gone. The allocator frees its blocks while the
        // device is alive, and is never used again.
        unsafe {
            // A lost device is idle.
            let _ = self.raw.device_wait_idle();
            ManuallyDrop::drop(&mut self.allocator);
            self.raw.destroy_device(None);
        }
    }
}
