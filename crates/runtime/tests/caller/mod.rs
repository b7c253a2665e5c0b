//! An application with a Vulkan device of its own, as an engine has one: the lender in the tests of borrowed devices.

use std::error::Error;

use patchlight_runtime::vulkan::ash::{self, ext, vk};
use patchlight_runtime::vulkan::{
    API_VERSION, BorrowedDevice, EnabledFeatures, Messages, Messenger, VALIDATION_LAYER, Validation, describe_device,
    enable_features, has_validation_layer,
};

pub struct Caller {
    pub instance: ash::Instance,
    pub physical_device: vk::PhysicalDevice,
    pub device: ash::Device,
    pub queue_family: u32,
    pub queue: vk::Queue,
    pub pool: vk::CommandPool,
    pub enabled: EnabledFeatures,
    /// Messenger, where the layer is installed; ends before the instance.
    messenger: Option<Messenger>,
    messages: Messages,
    _entry: ash::Entry,
}

/// A caller, or `None` after saying why; with `REQUIRE_VULKAN=1` a missing device is a failure.
pub fn caller() -> Option<Caller> {
    match Caller::new() {
        Ok(caller) => Some(caller),
        Err(error) => {
            let required = std::env::var("REQUIRE_VULKAN").is_ok_and(|value| value == "1");
            assert!(!required, "REQUIRE_VULKAN is set: {error}");
            println!("skipped: {error}");
            None
        }
    }
}

impl Caller {
    fn new() -> Result<Self, Box<dyn Error>> {
        // SAFETY: the loader library is the system's.
        let entry = unsafe { ash::Entry::load() }?;
        let has_layer = has_validation_layer(&entry)?;
        if validation() == Validation::Required && !has_layer {
            return Err("no validation layer".into());
        }
        let mut layer_names = Vec::new();
        let mut extensions = Vec::new();
        if has_layer {
            layer_names.push(VALIDATION_LAYER.as_ptr());
            extensions.push(ext::debug_utils::NAME.as_ptr());
        }
        let application = vk::ApplicationInfo::default().api_version(API_VERSION);
        let create = vk::InstanceCreateInfo::default()
            .application_info(&application)
            .enabled_layer_names(&layer_names)
            .enabled_extension_names(&extensions);
        // SAFETY: everything that `create` points to lives through the call.
        let instance = unsafe { entry.create_instance(&create, None) }?;
        let messages = Messages::default();
        // SAFETY: the instance is the entry's, has the extension, and is destroyed after the messenger.
        let messenger = || unsafe { Messenger::new(&entry, &instance, messages.clone()) };
        let messenger = has_layer.then(messenger).transpose()?;
        // SAFETY: the instance is alive and made for `API_VERSION`.
        let physical_devices = unsafe { instance.enumerate_physical_devices() }?;
        // SAFETY: as above; the physical devices are the instance's.
        let usable = |&physical: &_| unsafe { describe_device(&instance, physical) }.missing_feature.is_none();
        let physical_device = physical_devices.into_iter().find(usable).ok_or("no device")?;
        // SAFETY: the physical device is the instance's.
        let families = unsafe { instance.get_physical_device_queue_family_properties(physical_device) };
        let has_compute = |family: &vk::QueueFamilyProperties| family.queue_flags.contains(vk::QueueFlags::COMPUTE);
        let queue_family = families.iter().position(has_compute).ok_or("no compute queue")? as u32;
        let (device, enabled) = make_device(&instance, physical_device, queue_family)?;
        // SAFETY: the device was made with one queue of this family.
        let queue = unsafe { device.get_device_queue(queue_family, 0) };
        let create = vk::CommandPoolCreateInfo::default().queue_family_index(queue_family);
        // SAFETY: the family is the device's.
        let pool = unsafe { device.create_command_pool(&create, None) }?;
        let _entry = entry;
        Ok(Self { instance, physical_device, device, queue_family, queue, pool, enabled, messenger, messages, _entry })
    }

    pub fn lend(&self) -> BorrowedDevice {
        BorrowedDevice {
            instance: self.instance.clone(),
            physical_device: self.physical_device,
            device: self.device.clone(),
            queue_family: self.queue_family,
            queue: self.queue,
            enabled: self.enabled,
        }
    }

    pub fn has_layer(&self) -> bool {
        self.messenger.is_some()
    }

    /// A new command buffer that is being recorded.
    pub fn begin(&self) -> vk::CommandBuffer {
        let allocate = vk::CommandBufferAllocateInfo::default().command_pool(self.pool).command_buffer_count(1);
        // SAFETY: the pool is the device's; the buffer is new.
        unsafe {
            let commands = self.device.allocate_command_buffers(&allocate).expect("a command buffer")[0];
            let begin = vk::CommandBufferBeginInfo::default();
            self.device.begin_command_buffer(commands, &begin).expect("a new command buffer");
            commands
        }
    }

    /// Ends and submits a command buffer; gives a fence of its own.
    pub fn submit(&self, commands: vk::CommandBuffer) -> vk::Fence {
        let buffers = [commands];
        let submits = [vk::SubmitInfo::default().command_buffers(&buffers)];
        // SAFETY: the command buffer was begun by `begin` and is submitted once.
        unsafe {
            self.device.end_command_buffer(commands).expect("recorded without a mistake");
            let fence = self.device.create_fence(&vk::FenceCreateInfo::default(), None).expect("a fence");
            self.device.queue_submit(self.queue, &submits, fence).expect("submitted");
            fence
        }
    }

    /// Waits for a fence of `submit` and ends it.
    pub fn wait(&self, fence: vk::Fence) {
        // SAFETY: the fence was given to a submission and is used no more.
        unsafe {
            self.device.wait_for_fences(&[fence], true, u64::MAX).expect("the device is well");
            self.device.destroy_fence(fence, None);
        }
    }

    /// Submits a wait that keeps the queue busy until the gate is opened.
    pub fn close_gate(&self) -> Gate {
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let create = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device was made with `timelineSemaphore`; what `submits` points to lives through the call,
        // semaphore and fence until `end_gate`.
        unsafe {
            let semaphore = self.device.create_semaphore(&create, None).expect("a semaphore");
            let fence = self.device.create_fence(&vk::FenceCreateInfo::default(), None).expect("a fence");
            let semaphores = [semaphore];
            let mut values = vk::TimelineSemaphoreSubmitInfo::default().wait_semaphore_values(&[1]);
            let submits = [vk::SubmitInfo::default()
                .wait_semaphores(&semaphores)
                .wait_dst_stage_mask(&[vk::PipelineStageFlags::ALL_COMMANDS])
                .push_next(&mut values)];
            self.device.queue_submit(self.queue, &submits, fence).expect("submitted");
            Gate { semaphore, fence }
        }
    }

    /// Lets the queue go on.
    pub fn open(&self, gate: &Gate) {
        let signal = vk::SemaphoreSignalInfo::default().semaphore(gate.semaphore).value(1);
        // SAFETY: the semaphore is alive, of the timeline kind and at 0.
        unsafe { self.device.signal_semaphore(&signal) }.expect("the device is well");
    }

    /// Waits for an opened gate and ends it.
    pub fn end_gate(&self, gate: Gate) {
        self.wait(gate.fence);
        // SAFETY: nothing waits for the semaphore any more.
        unsafe { self.device.destroy_semaphore(gate.semaphore, None) };
    }

    /// A buffer of the caller's that copies write and the host reads.
    pub fn host_buffer(&self, bytes: u64) -> HostBuffer {
        let create = vk::BufferCreateInfo::default().size(bytes).usage(vk::BufferUsageFlags::TRANSFER_DST);
        // SAFETY: device and physical device are alive; the memory suits the buffer, is bound once and mapped once.
        unsafe {
            let buffer = self.device.create_buffer(&create, None).expect("a buffer");
            let needs = self.device.get_buffer_memory_requirements(buffer);
            let kinds = self.instance.get_physical_device_memory_properties(self.physical_device);
            let wanted = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
            let suits = |&k: &u32| {
                needs.memory_type_bits & (1 << k) != 0 && kinds.memory_types[k as usize].property_flags.contains(wanted)
            };
            let kind = (0..kinds.memory_type_count).find(suits).expect("memory that the host sees");
            let allocate = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(kind);
            let memory = self.device.allocate_memory(&allocate, None).expect("memory");
            self.device.bind_buffer_memory(buffer, memory, 0).expect("bound once");
            HostBuffer { buffer, memory, bytes }
        }
    }

    /// The contents of a buffer of `host_buffer`, which is ended.
    pub fn read(&self, from: HostBuffer) -> Vec<f32> {
        // SAFETY: every submission that writes the buffer is done; the memory has at least `bytes` bytes.
        unsafe {
            let flags = vk::MemoryMapFlags::empty();
            let mapped = self.device.map_memory(from.memory, 0, from.bytes, flags).expect("mapped once");
            let values = std::slice::from_raw_parts(mapped.cast::<f32>(), from.bytes as usize / 4).to_vec();
            self.device.destroy_buffer(from.buffer, None);
            self.device.free_memory(from.memory, None);
            values
        }
    }

    /// Does some work on the device, ends it, and gives all that the validation layer has said. The layer names what
    /// was made on the device and not freed before it ends.
    pub fn end(mut self) -> Vec<String> {
        let target = self.host_buffer(64);
        let commands = self.begin();
        // SAFETY: the command buffer is being recorded; the buffer is the caller's own and long enough.
        unsafe { self.device.cmd_fill_buffer(commands, target.buffer, 0, 64, 0x3f80_0000) };
        self.wait(self.submit(commands));
        assert_eq!(self.read(target), [1.0; 16], "the device is usable");
        // SAFETY: everything submitted is done; each object is destroyed once, children first.
        unsafe {
            self.device.destroy_command_pool(self.pool, None);
            self.device.destroy_device(None);
            drop(self.messenger.take());
            self.instance.destroy_instance(None);
        }
        self.messages.take()
    }
}

pub struct Gate {
    semaphore: vk::Semaphore,
    fence: vk::Fence,
}

pub struct HostBuffer {
    pub buffer: vk::Buffer,
    memory: vk::DeviceMemory,
    bytes: u64,
}

fn make_device(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    family: u32,
) -> Result<(ash::Device, EnabledFeatures), vk::Result> {
    // SAFETY: the physical device is the instance's.
    let supported = unsafe { instance.get_physical_device_features(physical) };
    let mut features = vk::PhysicalDeviceFeatures::default();
    // A feature of the caller's own, which every device of Vulkan 1.2 has.
    let mut vulkan_1_2 = vk::PhysicalDeviceVulkan12Features::default().timeline_semaphore(true);
    enable_features(&supported, &mut features, &mut vulkan_1_2);
    let enabled = EnabledFeatures::of(&features, &vulkan_1_2);
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
    let create = vk::DeviceCreateInfo::default()
        .queue_create_infos(&queues)
        .enabled_features(&features)
        .push_next(&mut vulkan_1_2);
    // SAFETY: everything that `create` points to lives through the call; `describe_device` found the features.
    Ok((unsafe { instance.create_device(physical, &create, None) }?, enabled))
}

/// Use of the validation layer, by `PATCHLIGHT_VALIDATION`.
pub fn validation() -> Validation {
    Validation::parse(std::env::var("PATCHLIGHT_VALIDATION").ok().as_deref())
}
