//! Instance, choice of a device, logical device; each ours or a caller's. What is ours is freed in the right order on
//! drop.

use std::ffi::{CStr, c_char};
use std::mem::ManuallyDrop;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex};

use ash::{ext, vk};
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};

use super::error::Error;
use super::features::{API_VERSION, COMPUTE_QUEUE, EnabledFeatures, enable_features};
use super::messages::{Messages, Messenger, VALIDATION_LAYER, Validation, has_debug_utils, has_validation_layer};
use crate::executor::{DeviceChoice, DeviceInfo, DeviceKind};

/// An instance of ours, or a caller's.
pub(super) struct Instance {
    raw: ash::Instance,
    /// Resources of an instance of ours; `None` where the caller made the instance and ends it.
    own: Option<OwnInstance>,
    pub messages: Messages,
}

struct OwnInstance {
    messenger: Option<Messenger>,
    /// True if passes can be labelled.
    has_labels: bool,
    // Last: the library is unloaded after everything that points into it.
    entry: ash::Entry,
}

impl Instance {
    /// Makes an instance.
    pub fn new(validation: Validation) -> Result<Self, Error> {
        // SAFETY: the loader library is the system's; loading it has no precondition of ours.
        let entry = unsafe { ash::Entry::load() }?;
        let watched = validation != Validation::Off && has_validation_layer(&entry)?;
        if validation == Validation::Required && !watched {
            return Err(Error::NoValidationLayer);
        }
        let layer_names: &[*const c_char] = if watched { &[VALIDATION_LAYER.as_ptr()] } else { &[] };
        let has_labels = watched || has_debug_utils(&entry)?;
        let extension_names: &[*const c_char] = if has_labels { &[ext::debug_utils::NAME.as_ptr()] } else { &[] };
        let application = vk::ApplicationInfo::default().application_name(c"patchlight").api_version(API_VERSION);
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
        let messages = Messages::default();
        let mut instance =
            Self { raw, own: Some(OwnInstance { messenger: None, has_labels, entry }), messages: messages.clone() };
        if let Some(own) = instance.own.as_mut().filter(|_| watched) {
            // SAFETY: the instance is alive, has the extension, and ends after the messenger, in `drop`.
            own.messenger = Some(unsafe { Messenger::new(&own.entry, &instance.raw, messages) }?);
        }
        Ok(instance)
    }

    /// A caller's instance, whose messages go to the caller's own messenger.
    pub fn borrow(raw: ash::Instance) -> Self {
        Self { raw, own: None, messages: Messages::default() }
    }

    fn has_labels(&self) -> bool {
        self.own.as_ref().is_some_and(|own| own.has_labels)
    }

    fn has_validation(&self) -> bool {
        self.own.as_ref().is_some_and(|own| own.messenger.is_some())
    }

    /// All devices in the loader's order.
    pub fn devices(&self) -> Result<Vec<Candidate>, Error> {
        // SAFETY: the instance is alive.
        let physical = unsafe { self.raw.enumerate_physical_devices() };
        let physical = match physical {
            Err(vk::Result::ERROR_INITIALIZATION_FAILED) => Vec::new(),
            other => other.map_err(Error::call("vkEnumeratePhysicalDevices"))?,
        };
        let mut candidates = Vec::with_capacity(physical.len());
        for (index, physical) in physical.into_iter().enumerate() {
            // SAFETY: `physical` comes from this live instance, which asked for `API_VERSION`.
            let report = unsafe { Report::new(&self.raw, physical) };
            let mut candidate = report.candidate(report.best_family());
            candidate.info.index = Some(index);
            candidate.info.has_validation = self.has_validation();
            candidates.push(candidate);
        }
        Ok(candidates)
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        let Some(own) = &mut self.own else { return };
        own.messenger = None;
        // SAFETY: every child (device, messenger) is gone: `Device` owns the instance and ends before it.
        unsafe { self.raw.destroy_instance(None) };
    }
}

/// Report of a physical device about itself.
struct Report {
    physical: vk::PhysicalDevice,
    plain: vk::PhysicalDeviceProperties,
    driver: String,
    subgroup_size: u32,
    max_allocation_bytes: u64,
    supported: EnabledFeatures,
    memory_bytes: u64,
    families: Vec<vk::QueueFamilyProperties>,
}

impl Report {
    /// Asks a physical device.
    ///
    /// # Safety
    /// `physical` is one of the instance's; the instance is alive and was made for [`API_VERSION`] or newer.
    unsafe fn new(instance: &ash::Instance, physical: vk::PhysicalDevice) -> Self {
        let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
        let mut allocation = vk::PhysicalDeviceMaintenance3Properties::default();
        let mut driver = vk::PhysicalDeviceDriverProperties::default();
        let mut features_1_2 = vk::PhysicalDeviceVulkan12Features::default();
        // SAFETY: handle and instance are as the caller promises; the chains hold structures of Vulkan 1.2, are given
        // only to devices that offer it, and live through the calls.
        let (plain, features, memory, families) = unsafe {
            let plain = instance.get_physical_device_properties(physical);
            if plain.api_version >= API_VERSION {
                let mut properties = vk::PhysicalDeviceProperties2::default()
                    .push_next(&mut subgroup)
                    .push_next(&mut allocation)
                    .push_next(&mut driver);
                instance.get_physical_device_properties2(physical, &mut properties);
                let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut features_1_2);
                instance.get_physical_device_features2(physical, &mut features);
            }
            let features = instance.get_physical_device_features(physical);
            let memory = instance.get_physical_device_memory_properties(physical);
            (plain, features, memory, instance.get_physical_device_queue_family_properties(physical))
        };
        let driver = format!("{} {}", text(driver.driver_name_as_c_str()), text(driver.driver_info_as_c_str()));
        Self {
            physical,
            plain,
            driver: driver.trim().to_owned(),
            subgroup_size: subgroup.subgroup_size,
            max_allocation_bytes: allocation.max_memory_allocation_size,
            supported: EnabledFeatures::of(&features, &features_1_2),
            memory_bytes: device_local_bytes(&memory),
            families,
        }
    }

    /// The first compute family with the most bits in its timestamps.
    fn best_family(&self) -> Option<u32> {
        let families = self.families.iter().enumerate();
        let compute = families.filter(|(_, family)| family.queue_flags.contains(vk::QueueFlags::COMPUTE));
        let best = compute.max_by_key(|(k, family)| (family.timestamp_valid_bits, std::cmp::Reverse(*k)));
        best.map(|(k, _)| k as u32)
    }

    /// Returns true if a queue family runs compute shaders.
    fn has_compute(&self, family: u32) -> bool {
        let family = self.families.get(family as usize);
        family.is_some_and(|family| family.queue_flags.contains(vk::QueueFlags::COMPUTE))
    }

    fn missing_feature(&self, family: Option<u32>) -> Option<&'static str> {
        if self.plain.api_version < API_VERSION {
            return Some("Vulkan 1.2");
        }
        let no_queue = if family.is_none() { Some(COMPUTE_QUEUE) } else { None };
        self.supported.missing().or(no_queue)
    }

    /// The device with the queue family that it is to be used with.
    fn candidate(&self, family: Option<u32>) -> Candidate {
        let properties = family.and_then(|family| self.families.get(family as usize));
        let timestamp_bits = properties.map_or(0, |family| family.timestamp_valid_bits);
        let limits = self.plain.limits;
        let info = DeviceInfo {
            name: text(self.plain.device_name_as_c_str()),
            kind: device_kind(self.plain.device_type),
            index: None,
            driver: self.driver.clone(),
            api_version: version(self.plain.api_version),
            memory_bytes: self.memory_bytes,
            max_storage_buffer_range: u64::from(limits.max_storage_buffer_range),
            max_image_edge: limits.max_image_dimension2_d,
            has_block_images: self.supported.texture_compression_bc,
            shared_memory_bytes: limits.max_compute_shared_memory_size,
            subgroup_size: self.subgroup_size,
            has_timestamps: timestamp_bits > 0,
            missing_feature: self.missing_feature(family),
            has_validation: false,
        };
        Candidate {
            physical: self.physical,
            info,
            family: family.unwrap_or_default(),
            timestamp_bits,
            limits,
            max_allocation_bytes: self.max_allocation_bytes,
        }
    }
}

fn text<E>(from_driver: Result<&CStr, E>) -> String {
    from_driver.map(|text| text.to_string_lossy().into_owned()).unwrap_or_default()
}

fn version(v: u32) -> String {
    format!("{}.{}.{}", vk::api_version_major(v), vk::api_version_minor(v), vk::api_version_patch(v))
}

fn device_kind(kind: vk::PhysicalDeviceType) -> DeviceKind {
    match kind {
        vk::PhysicalDeviceType::DISCRETE_GPU => DeviceKind::Discrete,
        vk::PhysicalDeviceType::INTEGRATED_GPU => DeviceKind::Integrated,
        vk::PhysicalDeviceType::VIRTUAL_GPU => DeviceKind::Virtual,
        vk::PhysicalDeviceType::CPU => DeviceKind::EmulatedOnCpu,
        _ => DeviceKind::Other,
    }
}

fn device_local_bytes(memory: &vk::PhysicalDeviceMemoryProperties) -> u64 {
    let heaps = memory.memory_heaps_as_slice().iter();
    heaps.filter(|heap| heap.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL)).map(|heap| heap.size).sum()
}

/// Capabilities of a physical device of a caller's instance; `missing_feature` names one that it lacks. Its `index` is
/// `None`.
///
/// # Safety
/// The instance is alive and was made for [`API_VERSION`] or newer, and the physical device is one of its.
pub unsafe fn describe_device(instance: &ash::Instance, physical_device: vk::PhysicalDevice) -> DeviceInfo {
    // SAFETY: as the caller promises.
    let report = unsafe { Report::new(instance, physical_device) };
    report.candidate(report.best_family()).info
}

/// A device that the loader offers, or a caller lends.
pub(super) struct Candidate {
    physical: vk::PhysicalDevice,
    pub info: DeviceInfo,
    family: u32,
    timestamp_bits: u32,
    limits: vk::PhysicalDeviceLimits,
    max_allocation_bytes: u64,
}

/// A caller's device, for [`Vulkan::borrow`](super::Vulkan::borrow). The handles stay the caller's.
#[derive(Clone)]
pub struct BorrowedDevice {
    /// The instance, made for [`API_VERSION`] or newer.
    pub instance: ash::Instance,
    /// The physical device that `device` was made from.
    pub physical_device: vk::PhysicalDevice,
    /// The device, made with [`FEATURES`](super::FEATURES).
    pub device: ash::Device,
    /// The family of `queue`; it has `VK_QUEUE_COMPUTE_BIT`.
    pub queue_family: u32,
    /// The queue that passes, uploads and downloads are submitted to.
    pub queue: vk::Queue,
    /// The features that `device` was made with; [`EnabledFeatures::of`] reads them from Vulkan's structures.
    pub enabled: EnabledFeatures,
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

/// A logical device with its one queue and its memory; ours, or a caller's.
pub(super) struct Device {
    pub raw: ash::Device,
    /// Labels of passes, for debuggers.
    pub labels: Option<ext::debug_utils::Device>,
    /// True if the caller made the device and ends it.
    is_borrowed: bool,
    pub queue: vk::Queue,
    pub family: u32,
    pub info: DeviceInfo,
    pub limits: vk::PhysicalDeviceLimits,
    pub timestamp_bits: u32,
    pub max_allocation_bytes: u64,
    pub allocator: ManuallyDrop<Arc<Mutex<Allocator>>>,
    /// Most bytes that all buffers and pictures may take.
    pub memory_budget: AtomicU64,
    // After the device.
    pub instance: Instance,
}

impl Device {
    /// Makes a device with one queue.
    pub fn new(instance: Instance, candidate: Candidate) -> Result<Self, Error> {
        let queues =
            [vk::DeviceQueueCreateInfo::default().queue_family_index(candidate.family).queue_priorities(&[1.0])];
        // SAFETY: the physical device belongs to the live instance.
        let supported = unsafe { instance.raw.get_physical_device_features(candidate.physical) };
        let mut features = vk::PhysicalDeviceFeatures::default();
        let mut features_1_2 = vk::PhysicalDeviceVulkan12Features::default();
        enable_features(&supported, &mut features, &mut features_1_2);
        let create = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_features(&features)
            .push_next(&mut features_1_2);
        // SAFETY: the physical device belongs to the instance; `choose` made sure of queue family and features; the
        // chain lives through the call.
        let raw = unsafe { instance.raw.create_device(candidate.physical, &create, None) }
            .map_err(Error::call("vkCreateDevice"))?;
        let allocator = match make_allocator(&instance.raw, &raw, candidate.physical) {
            Ok(allocator) => allocator,
            Err(error) => {
                // SAFETY: nothing was made from the device yet.
                unsafe { raw.destroy_device(None) };
                return Err(error);
            }
        };
        // SAFETY: the device was made with one queue of this family.
        let queue = unsafe { raw.get_device_queue(candidate.family, 0) };
        Ok(Self::with_parts(instance, candidate, raw, queue, allocator, false))
    }

    /// Takes a caller's device for the time that the executor lives.
    ///
    /// # Safety
    /// As [`Vulkan::borrow`](super::Vulkan::borrow).
    pub unsafe fn borrow(caller: BorrowedDevice) -> Result<Self, Error> {
        // SAFETY: as the caller promises.
        let report = unsafe { Report::new(&caller.instance, caller.physical_device) };
        let mut candidate = report.candidate(Some(caller.queue_family));
        let device = candidate.info.name.clone();
        if let Some(feature) = candidate.info.missing_feature {
            return Err(Error::MissingFeature { device, feature });
        }
        if !report.has_compute(caller.queue_family) {
            return Err(Error::QueueFamily { device, family: caller.queue_family });
        }
        if let Some(feature) = caller.enabled.missing() {
            return Err(Error::FeatureNotEnabled { device, feature });
        }
        candidate.info.has_block_images &= caller.enabled.texture_compression_bc;
        let allocator = make_allocator(&caller.instance, &caller.device, caller.physical_device)?;
        let instance = Instance::borrow(caller.instance);
        Ok(Self::with_parts(instance, candidate, caller.device, caller.queue, allocator, true))
    }

    fn with_parts(
        instance: Instance,
        candidate: Candidate,
        raw: ash::Device,
        queue: vk::Queue,
        allocator: Allocator,
        is_borrowed: bool,
    ) -> Self {
        let labels = instance.has_labels().then(|| ext::debug_utils::Device::new(&instance.raw, &raw));
        Self {
            raw,
            labels,
            is_borrowed,
            queue,
            family: candidate.family,
            info: candidate.info,
            limits: candidate.limits,
            timestamp_bits: candidate.timestamp_bits,
            max_allocation_bytes: candidate.max_allocation_bytes,
            allocator: ManuallyDrop::new(Arc::new(Mutex::new(allocator))),
            memory_budget: AtomicU64::new(u64::MAX),
            instance,
        }
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
        // SAFETY: every child holds an `Arc` of this device, so all are gone, and `Queue` waited for every submission
        // of ours before it went. The allocator frees its blocks while the device is alive, and is never used again. A
        // device of ours has no other user.
        unsafe {
            ManuallyDrop::drop(&mut self.allocator);
            if !self.is_borrowed {
                self.raw.destroy_device(None);
            }
        }
    }
}

fn make_allocator(
    instance: &ash::Instance,
    device: &ash::Device,
    physical_device: vk::PhysicalDevice,
) -> Result<Allocator, Error> {
    let made = Allocator::new(&AllocatorCreateDesc {
        instance: instance.clone(),
        device: device.clone(),
        physical_device,
        debug_settings: Default::default(),
        buffer_device_address: false,
        allocation_sizes: Default::default(),
    });
    made.map_err(|error| Error::Allocator { what: "allocator".into(), bytes: 0, reason: error.to_string() })
}
