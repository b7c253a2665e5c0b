//! A caller's Vulkan device.

use std::mem::transmute;

use patchlight::runtime::vulkan::ash::{self, vk, vk::Handle as _};
use patchlight::runtime::vulkan::{BorrowedDevice, BufferHandle, EnabledFeatures, Vulkan, enable_features};

use crate::bake::PlBake;
use crate::border::{Failure, Outcome, PlStatus, Sized32, give, guard, handle, input, room, structure};
use crate::field::{PlField, PlFieldSettings};

/// VkInstance.
#[allow(non_camel_case_types)]
pub type VkInstance = *mut std::ffi::c_void;
/// VkPhysicalDevice.
#[allow(non_camel_case_types)]
pub type VkPhysicalDevice = *mut std::ffi::c_void;
/// VkDevice.
#[allow(non_camel_case_types)]
pub type VkDevice = *mut std::ffi::c_void;
/// VkQueue.
#[allow(non_camel_case_types)]
pub type VkQueue = *mut std::ffi::c_void;
/// VkCommandBuffer.
#[allow(non_camel_case_types)]
pub type VkCommandBuffer = *mut std::ffi::c_void;
/// VkBuffer.
#[allow(non_camel_case_types)]
pub type VkBuffer = u64;
/// VkPhysicalDeviceFeatures.
#[allow(non_camel_case_types)]
pub type VkPhysicalDeviceFeatures = vk::PhysicalDeviceFeatures;
/// VkPhysicalDeviceVulkan12Features.
#[allow(non_camel_case_types)]
pub type VkPhysicalDeviceVulkan12Features = vk::PhysicalDeviceVulkan12Features<'static>;
/// PFN_vkGetInstanceProcAddr.
#[allow(non_camel_case_types)]
pub type PFN_vkGetInstanceProcAddr = Option<unsafe extern "system" fn()>;

/// A device of the caller's; handles stay the caller's.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct PlBorrowedDevice {
    /// sizeof(PlBorrowedDevice).
    pub struct_size: usize,
    /// vkGetInstanceProcAddr.
    pub get_instance_proc_addr: PFN_vkGetInstanceProcAddr,
    /// An instance of Vulkan 1.2 or newer.
    pub instance: VkInstance,
    /// The physical device that `device` was made from.
    pub physical_device: VkPhysicalDevice,
    /// The device.
    pub device: VkDevice,
    /// The queue that passes, uploads and downloads are submitted to.
    pub queue: VkQueue,
    /// Its family, which has VK_QUEUE_COMPUTE_BIT.
    pub queue_family: u32,
    /// The features that the device was made with; pl_vulkan_enable_features fills them.
    pub features: *const VkPhysicalDeviceFeatures,
    /// See features.
    pub vulkan_1_2: *const VkPhysicalDeviceVulkan12Features,
}

// SAFETY: plain numbers and pointers, of which null is one.
unsafe impl Sized32 for PlBorrowedDevice {
    const NAME: &'static str = "PlBorrowedDevice";
}

/// A part of a buffer on the device.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct PlBuffer {
    /// The buffer.
    pub buffer: VkBuffer,
    /// First byte.
    pub offset: u64,
    /// Bytes.
    pub bytes: u64,
}

/// Tables of a light field on the device, four floats a value: RGB and an unused one.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types)]
pub enum PlTable {
    /// Indirect irradiance between the receivers: what pl_field_surface reads.
    PL_SURFACE = 0,
    /// Irradiance of the patches.
    PL_PATCHES = 1,
    /// Irradiance of the elements.
    PL_ELEMENTS = 2,
    /// First exitance of the patches.
    PL_SOURCE = 3,
}

const EMPTY: PlBorrowedDevice = PlBorrowedDevice {
    struct_size: size_of::<PlBorrowedDevice>(),
    get_instance_proc_addr: None,
    instance: std::ptr::null_mut(),
    physical_device: std::ptr::null_mut(),
    device: std::ptr::null_mut(),
    queue: std::ptr::null_mut(),
    queue_family: 0,
    features: std::ptr::null(),
    vulkan_1_2: std::ptr::null(),
};

/// Fills a structure with its size and nothing else.
///
/// # Safety
/// `device` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_borrowed_device_default(device: *mut PlBorrowedDevice) {
    if !device.is_null() {
        // SAFETY: as the caller promises.
        unsafe { device.write(EMPTY) };
    }
}

/// Enables in the structures that a device is going to be made with what the kernels need; everything else in them stays.
/// `supported` is what vkGetPhysicalDeviceFeatures says.
///
/// # Safety
/// Pointers are what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_vulkan_enable_features(
    supported: *const VkPhysicalDeviceFeatures,
    features: *mut VkPhysicalDeviceFeatures,
    vulkan_1_2: *mut VkPhysicalDeviceVulkan12Features,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let supported = unsafe { crate::border::shared(supported, "supported") }?;
        // SAFETY: as the caller promises.
        let features = unsafe { handle(features, "features") }?;
        // SAFETY: as the caller promises.
        enable_features(supported, features, unsafe { handle(vulkan_1_2, "vulkan_1_2") }?);
        Ok(())
    })
}

fn of_vulkan(error: impl Into<patchlight::Error>) -> Failure {
    error.into().into()
}

/// Puts a bake on a device of the caller's, which outlives the field. While a function of the field runs, no other thread uses
/// the queue.
///
/// # Safety
/// Handles are live, belong together, and stay so until the field is freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_new_on(
    bake: *const PlBake,
    settings: *const PlFieldSettings,
    device: *const PlBorrowedDevice,
    out: *mut *mut PlField,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let settings = unsafe { structure(settings, PlFieldSettings::default()) }?;
        // SAFETY: as the caller promises.
        let own = unsafe { structure(device, EMPTY) }?;
        // SAFETY: as the caller promises.
        let executor = unsafe { borrow(&own) }?;
        // SAFETY: as the caller promises.
        unsafe { give(out, PlField::new(bake, &settings, Box::new(executor))?) }
    })
}

/// # Safety
/// As [`pl_field_new_on`].
unsafe fn borrow(own: &PlBorrowedDevice) -> Outcome<Vulkan> {
    let handles = [own.instance, own.physical_device, own.device, own.queue];
    if handles.iter().any(|handle| handle.is_null()) {
        return Err(input(
            "a handle of the borrowed device is NULL: instance, physical_device, device and queue are needed",
        ));
    }
    let Some(loader) = own.get_instance_proc_addr else {
        return Err(input("get_instance_proc_addr of the borrowed device is NULL"));
    };
    // SAFETY: the caller's vkGetInstanceProcAddr, as the header says.
    let get_instance_proc_addr =
        unsafe { transmute::<unsafe extern "system" fn(), vk::PFN_vkGetInstanceProcAddr>(loader) };
    let entry = ash::StaticFn { get_instance_proc_addr };
    // SAFETY: the caller's structures.
    let features = unsafe { crate::border::shared(own.features, "features of the borrowed device") }?;
    // SAFETY: the caller's structures.
    let vulkan_1_2 = unsafe { crate::border::shared(own.vulkan_1_2, "vulkan_1_2 of the borrowed device") }?;
    // SAFETY: live handles.
    let instance = unsafe {
        ash::Instance::load_with(
            |name| {
                (entry.get_instance_proc_addr)(vk::Instance::from_raw(own.instance as u64), name.as_ptr())
                    .map_or(std::ptr::null(), |function| function as *const std::ffi::c_void)
            },
            vk::Instance::from_raw(own.instance as u64),
        )
    };
    // SAFETY: live handles.
    let device = unsafe { ash::Device::load(instance.fp_v1_0(), vk::Device::from_raw(own.device as u64)) };
    let borrowed = BorrowedDevice {
        physical_device: vk::PhysicalDevice::from_raw(own.physical_device as u64),
        instance,
        device,
        queue_family: own.queue_family,
        queue: vk::Queue::from_raw(own.queue as u64),
        enabled: EnabledFeatures::of(features, vulkan_1_2),
    };
    // SAFETY: as the caller promises.
    unsafe { Vulkan::borrow(borrowed) }
        .map_err(|error| of_vulkan(patchlight::runtime::executor::ExecutorError::from(error)))
}

fn vulkan(field: &mut PlField) -> Outcome<&mut Vulkan> {
    let own = field.renderer.light_mut().vulkan_mut();
    own.ok_or_else(|| Failure(PlStatus::PL_UNSUPPORTED, "the field is not on a Vulkan device".into()))
}

/// As pl_field_update, recorded into a command buffer of the caller's that is in the recording state; the caller submits it.
/// `slot` is 0 or 1: of each slot at most one recording is under way on the device.
///
/// # Safety
/// The command buffer is of the field's device and family; the last recording of the slot is finished on the device.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_record(field: *mut PlField, commands: VkCommandBuffer, slot: u32) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        if commands.is_null() {
            return Err(input("the command buffer is NULL"));
        }
        let commands = vk::CommandBuffer::from_raw(commands as u64);
        let failed = |error| of_vulkan(patchlight::runtime::executor::ExecutorError::from(error));
        // SAFETY: as the caller promises.
        unsafe { vulkan(field)?.begin_recording(commands, slot as usize) }.map_err(failed)?;
        let updated = field.renderer.light_mut().update(&field.lighting);
        let ended = vulkan(field)?.end_recording().map_err(failed);
        updated?;
        ended.map(drop)
    })
}

fn give_buffer(found: Option<BufferHandle>, out: *mut PlBuffer) -> Outcome {
    let found = found.ok_or_else(|| input("the field has no such buffer"))?;
    let own = PlBuffer { buffer: found.buffer.as_raw(), offset: found.offset, bytes: found.bytes };
    // SAFETY: as the callers promise.
    unsafe { room(out, 1, "the place for the buffer") }?[0] = own;
    Ok(())
}

/// A PlTable on the device, for shaders of the caller's on the same device: they see the last update after a memory barrier
/// from all commands. Another buffer after pl_field_add_points, pl_field_remove_points, and updates with more lights.
///
/// # Safety
/// Pointers are what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_buffer(field: *mut PlField, which: u32, out: *mut PlBuffer) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        let buffers = *field.renderer.light().buffers();
        let id = match which {
            0 => buffers.interpolated,
            1 => buffers.patches,
            2 => buffers.elements,
            3 => buffers.source,
            which => return Err(input(format!("table {which}; it is one of PlTable"))),
        };
        give_buffer(vulkan(field)?.buffer(id), out)
    })
}
