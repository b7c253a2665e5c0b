//! Instance and device for a window.

use std::ffi::c_char;
use std::mem::ManuallyDrop;
use std::sync::{Arc, Mutex};

use ash::{ext, khr, vk};
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};
use runtime::executor::{DeviceChoice, DeviceInfo, DeviceKind};
use runtime::vulkan::{
    API_VERSION, BorrowedDevice, EnabledFeatures, Messages, Messenger, VALIDATION_LAYER, Validation, Vulkan,
    describe_device, enable_features, has_validation_layer,
};
use winit::raw_window_handle::{HasDisplayHandle, HasWindowHandle};
use winit::window::Window;

use crate::error::Error;

/// An instance that can make surfaces of the window system.
pub struct Gpu {
    pub(super) raw: ash::Instance,
    pub(super) surfaces: khr::surface::Instance,
    messenger: Option<Messenger>,
    messages: Messages,
    // Last: the library is unloaded after everything that points into it.
    entry: ash::Entry,
}

impl Gpu {
    /// Makes an instance for windows of a display, and sees that there is any device.
    ///
    /// # Errors
    /// [`Error::NoDevice`]; what Vulkan says.
    pub fn new(display: &dyn HasDisplayHandle, validation: Validation) -> Result<Arc<Self>, Error> {
        let handle = display.display_handle().map_err(|error| Error::NoWindow { reason: error.to_string() })?;
        // SAFETY: the loader library is the system's; loading it has no precondition of ours.
        let entry = unsafe { ash::Entry::load() }
            .map_err(|error| Error::NoDevice { reason: format!("there is no Vulkan loader ({error})") })?;
        let watched = validation != Validation::Off && has_validation_layer(&entry)?;
        if validation == Validation::Required && !watched {
            return Err(runtime::vulkan::Error::NoValidationLayer.into());
        }
        let mut extensions = ash_window::enumerate_required_extensions(handle.as_raw())
            .map_err(|result| Error::NoDevice { reason: format!("no surfaces of this window system ({result:?})") })?
            .to_vec();
        let layers: &[*const c_char] = if watched { &[VALIDATION_LAYER.as_ptr()] } else { &[] };
        if watched {
            extensions.push(ext::debug_utils::NAME.as_ptr());
        }
        let application = vk::ApplicationInfo::default().application_name(c"patchlight").api_version(API_VERSION);
        let create = vk::InstanceCreateInfo::default()
            .application_info(&application)
            .enabled_layer_names(layers)
            .enabled_extension_names(&extensions);
        // SAFETY: `create` and all it points to live until the call returns; the names are null-terminated constants.
        let raw = unsafe { entry.create_instance(&create, None) }
            .map_err(|result| Error::NoDevice { reason: format!("vkCreateInstance: {result:?}") })?;
        let surfaces = khr::surface::Instance::new(&entry, &raw);
        let messages = Messages::default();
        let mut gpu = Self { raw, surfaces, messenger: None, messages: messages.clone(), entry };
        if watched {
            // SAFETY: the instance is alive, has the extension, and ends after the messenger, in `drop`.
            gpu.messenger = Some(unsafe { Messenger::new(&gpu.entry, &gpu.raw, messages) }?);
        }
        if gpu.physical_devices()?.is_empty() {
            return Err(Error::NoDevice { reason: "no driver offers one".into() });
        }
        Ok(Arc::new(gpu))
    }

    /// Fails when the validation layer has said anything since the last call.
    ///
    /// # Errors
    /// [`Error::Validation`].
    pub fn check_messages(&self) -> Result<(), Error> {
        let messages = self.messages.take();
        if messages.is_empty() { Ok(()) } else { Err(Error::Validation { messages }) }
    }

    fn physical_devices(&self) -> Result<Vec<vk::PhysicalDevice>, Error> {
        // SAFETY: the instance is alive.
        match unsafe { self.raw.enumerate_physical_devices() } {
            Err(vk::Result::ERROR_INITIALIZATION_FAILED) => Ok(Vec::new()),
            found => found.map_err(Error::call("vkEnumeratePhysicalDevices")),
        }
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        self.messenger = None;
        // SAFETY: surfaces and devices hold an `Arc` of this instance, so all are gone.
        unsafe { self.raw.destroy_instance(None) };
    }
}

/// The surface of a window.
pub(super) struct Surface {
    pub raw: vk::SurfaceKHR,
    gpu: Arc<Gpu>,
    // After the surface.
    window: Arc<Window>,
}

impl Surface {
    pub fn new(gpu: &Arc<Gpu>, window: Arc<Window>) -> Result<Self, Error> {
        let no_handle = |reason: String| Error::NoWindow { reason };
        let display = window.display_handle().map_err(|error| no_handle(error.to_string()))?.as_raw();
        let handle = window.window_handle().map_err(|error| no_handle(error.to_string()))?.as_raw();
        // SAFETY: both handles are alive, and the window outlives the surface; the instance has the extensions.
        let raw = unsafe { ash_window::create_surface(&gpu.entry, &gpu.raw, display, handle, None) }
            .map_err(Error::call("vkCreateSurface"))?;
        Ok(Self { raw, gpu: Arc::clone(gpu), window })
    }

    /// Size of the window, pixels.
    pub fn size(&self) -> (u32, u32) {
        self.window.inner_size().into()
    }
}

impl Drop for Surface {
    fn drop(&mut self) {
        // SAFETY: the swapchain is gone: `Screen` drops it first.
        unsafe { self.gpu.surfaces.destroy_surface(self.raw, None) };
    }
}

/// A physical device that can show the window.
struct Candidate {
    physical: vk::PhysicalDevice,
    family: u32,
    info: DeviceInfo,
}

/// A device with a queue that draws, computes and presents.
pub(super) struct Device {
    pub raw: ash::Device,
    pub physical: vk::PhysicalDevice,
    pub family: u32,
    pub queue: vk::Queue,
    pub info: DeviceInfo,
    pub swapchains: khr::swapchain::Device,
    pub allocator: ManuallyDrop<Arc<Mutex<Allocator>>>,
    enabled: EnabledFeatures,
    /// True if kernels run on it, too.
    runs_kernels: bool,
    // After the device.
    pub gpu: Arc<Gpu>,
}

impl Device {
    /// Makes the device that answers to the choice; the best that can show the window where kernels run on the
    /// processor.
    pub fn new(surface: &Surface, choice: &DeviceChoice) -> Result<Arc<Self>, Error> {
        let gpu = Arc::clone(&surface.gpu);
        let (candidate, runs_kernels) = choose(candidates(&gpu, surface)?, choice)?;
        let Candidate { physical, family, info } = candidate;
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
        let extensions = [khr::swapchain::NAME.as_ptr()];
        let mut features = vk::PhysicalDeviceFeatures::default();
        let mut features_1_2 = vk::PhysicalDeviceVulkan12Features::default();
        if runs_kernels {
            // SAFETY: the physical device is the instance's.
            let supported = unsafe { gpu.raw.get_physical_device_features(physical) };
            enable_features(&supported, &mut features, &mut features_1_2);
        }
        let enabled = EnabledFeatures::of(&features, &features_1_2);
        let create = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_extension_names(&extensions)
            .enabled_features(&features)
            .push_next(&mut features_1_2);
        // SAFETY: `candidates` found queue family and extension, `describe_device` the features; the chain lives
        // through the call.
        let raw = unsafe { gpu.raw.create_device(physical, &create, None) }.map_err(Error::call("vkCreateDevice"))?;
        let made = Allocator::new(&AllocatorCreateDesc {
            instance: gpu.raw.clone(),
            device: raw.clone(),
            physical_device: physical,
            debug_settings: Default::default(),
            buffer_device_address: false,
            allocation_sizes: Default::default(),
        });
        let allocator = match made {
            Ok(allocator) => ManuallyDrop::new(Arc::new(Mutex::new(allocator))),
            Err(error) => {
                // SAFETY: nothing was made from the device yet.
                unsafe { raw.destroy_device(None) };
                return Err(Error::Panels { reason: error.to_string() });
            }
        };
        // SAFETY: the device was made with one queue of this family.
        let queue = unsafe { raw.get_device_queue(family, 0) };
        let swapchains = khr::swapchain::Device::new(&gpu.raw, &raw);
        let device = Self { raw, physical, family, queue, info, swapchains, allocator, enabled, runs_kernels, gpu };
        Ok(Arc::new(device))
    }

    /// An executor on this device and its queue; none where kernels run on the processor. It is to stay on the thread
    /// that draws.
    pub fn executor(self: &Arc<Self>) -> Result<Option<Vulkan>, Error> {
        if !self.runs_kernels {
            return Ok(None);
        }
        let lent = BorrowedDevice {
            instance: self.gpu.raw.clone(),
            physical_device: self.physical,
            device: self.raw.clone(),
            queue_family: self.family,
            queue: self.queue,
            enabled: self.enabled,
        };
        // SAFETY: all handles are of this device, which the executor keeps alive; the viewer uses the queue from one
        // thread.
        let mut vulkan = unsafe { Vulkan::borrow(lent) }?;
        let owner: Arc<Self> = Arc::clone(self);
        vulkan.keep_alive(owner);
        Ok(Some(vulkan))
    }

    /// Waits until nothing is under way; what is lost with the device runs no more.
    pub fn wait(&self) {
        // SAFETY: the device is alive, and its queue is used by one thread.
        let _ = unsafe { self.raw.device_wait_idle() };
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.wait();
        // SAFETY: every child holds an `Arc` of this device, so all are gone, the users of the allocator too. It frees
        // its blocks while the device is alive, and is never used again.
        unsafe {
            ManuallyDrop::drop(&mut self.allocator);
            self.raw.destroy_device(None);
        }
    }
}

/// Devices that can show the window, in the loader's order.
fn candidates(gpu: &Gpu, surface: &Surface) -> Result<Vec<Candidate>, Error> {
    let mut found = Vec::new();
    for (index, physical) in gpu.physical_devices()?.into_iter().enumerate() {
        // SAFETY: the instance is alive and made for `API_VERSION`, the physical device is one of its.
        let described = unsafe { describe_device(&gpu.raw, physical) };
        let info = DeviceInfo { index: Some(index), ..described };
        // SAFETY: as above.
        let extensions = unsafe { gpu.raw.enumerate_device_extension_properties(physical) };
        let extensions = extensions.map_err(Error::call("vkEnumerateDeviceExtensionProperties"))?;
        if !extensions.iter().any(|extension| extension.extension_name_as_c_str() == Ok(khr::swapchain::NAME)) {
            continue;
        }
        // SAFETY: as above.
        let families = unsafe { gpu.raw.get_physical_device_queue_family_properties(physical) };
        let wanted = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
        for (family, properties) in (0u32..).zip(&families) {
            // SAFETY: the surface is of this instance, the family one of the device's.
            let shows = unsafe { gpu.surfaces.get_physical_device_surface_support(physical, family, surface.raw) };
            if properties.queue_flags.contains(wanted) && shows == Ok(true) {
                found.push(Candidate { physical, family, info });
                break;
            }
        }
    }
    Ok(found)
}

/// The candidate that answers to the choice, and whether kernels run on it.
fn choose(mut candidates: Vec<Candidate>, choice: &DeviceChoice) -> Result<(Candidate, bool), Error> {
    let names: Vec<String> =
        candidates.iter().map(|c| format!("{}: {}", c.info.index.unwrap_or_default(), c.info.name)).collect();
    candidates.sort_by_key(|candidate| (candidate.info.kind, candidate.info.index));
    let runs = |candidate: &Candidate| choice.admits(&candidate.info) && candidate.info.missing_feature.is_none();
    if let Some(place) = candidates.iter().position(runs) {
        return Ok((candidates.swap_remove(place), true));
    }
    match choice {
        DeviceChoice::Auto | DeviceChoice::Cpu => {}
        _ => return Err(runtime::vulkan::Error::UnknownDevice { wanted: choice.to_string(), available: names }.into()),
    }
    let first = candidates.into_iter().find(|candidate| candidate.info.kind != DeviceKind::Native);
    let reason = "none has a queue for this window".to_owned();
    first.map(|candidate| (candidate, false)).ok_or(Error::NoDevice { reason })
}
