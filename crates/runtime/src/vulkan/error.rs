//! The call that failed, its result, and what to do about it.

use ash::vk;

/// Why Vulkan cannot be used, or stopped working.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// There is no Vulkan loader on this machine.
    #[error("no Vulkan loader: {0}; install a graphics driver, or use the CPU executor")]
    NoLoader(#[from] ash::LoadingError),
    /// The loader works but no driver offers a device.
    #[error("no Vulkan device: {reason}; install a graphics driver, or use the CPU executor")]
    NoDevice {
        /// Message of the loader.
        reason: String,
    },
    /// No device answers to the name, the number or the kind.
    #[error("no Vulkan device `{wanted}`; there are: {}", list(available))]
    UnknownDevice {
        /// Requested device.
        wanted: String,
        /// The devices with their numbers.
        available: Vec<String>,
    },
    /// A device lacks what every kernel needs.
    #[error("{device} lacks {feature}; update its driver, choose another device, or the CPU executor")]
    MissingFeature {
        /// Name of the device.
        device: String,
        /// The feature as the Vulkan specification names it.
        feature: &'static str,
    },
    /// A caller's device was made without a feature that every kernel needs.
    #[error("{device} was made without {feature}: enable it when the device is made, `vulkan::enable_features` does")]
    FeatureNotEnabled {
        /// Name of the device.
        device: String,
        /// The feature as the Vulkan specification names it.
        feature: &'static str,
    },
    /// A caller's queue family does not run compute shaders.
    #[error("queue family {family} of {device} lacks VK_QUEUE_COMPUTE_BIT: give a queue of a family that has it")]
    QueueFamily {
        /// Name of the device.
        device: String,
        /// The family given.
        family: u32,
    },
    /// A call that waits for the device, while commands are recorded into a caller's command buffer.
    #[error(
        "{call} cannot be recorded into a command buffer: call end_recording, submit the buffer, then call it again"
    )]
    Recording {
        /// The call.
        call: &'static str,
    },
    /// `end_recording` without `begin_recording`.
    #[error("no command buffer is being recorded: call begin_recording first")]
    NotRecording,
    /// A slot for the uploads of a recorded frame that there is not.
    #[error("frame slot {frame} of {count}: give the number of the frame modulo the frames in flight")]
    FrameSlot {
        /// The slot asked for.
        frame: usize,
        /// Number of devices.
        count: usize,
    },
    /// The validation layer was asked for by `PATCHLIGHT_VALIDATION=1` and is not installed.
    #[error(
        "PATCHLIGHT_VALIDATION is set but there is no VK_LAYER_KHRONOS_validation; install the Vulkan validation \
         layers or unset the variable"
    )]
    NoValidationLayer,
    /// The validation layer found a mistake of ours.
    #[error("the Vulkan validation layer reports {}: {}", messages.len(), messages.join("; "))]
    Validation {
        /// Its messages.
        messages: Vec<String>,
    },
    /// A buffer or picture does not fit on the device.
    #[error(
        "{call} for `{what}`, {bytes} bytes: out of device memory ({reason}); choose fewer patches, a smaller \
         picture, or the CPU executor"
    )]
    OutOfMemory {
        /// The call.
        call: &'static str,
        /// Name of the buffer.
        what: String,
        /// Its size.
        bytes: u64,
        /// Message of the driver or the allocator.
        reason: String,
    },
    /// The allocator failed for another reason than lack of memory.
    #[error("memory for `{what}`, {bytes} bytes: {reason}")]
    Allocator {
        /// Name of the buffer.
        what: String,
        /// Its size.
        bytes: u64,
        /// Message of the allocator.
        reason: String,
    },
    /// A plan asks for more than the device can do.
    #[error("{what}: {name} of {device} is {limit}, {asked} asked for; {remedy}")]
    Limit {
        /// Pass, buffer or kernel.
        what: String,
        /// The limit as the Vulkan specification names it.
        name: &'static str,
        /// Name of the device.
        device: String,
        /// Limit of the device.
        limit: u64,
        /// Size that the plan asks for.
        asked: u64,
        /// Remedy.
        remedy: &'static str,
    },
    /// A committed module is not SPIR-V.
    #[error("kernel `{kernel}`: its module is not SPIR-V ({reason}); build the kernels again")]
    Module {
        /// Name of the kernel.
        kernel: String,
        /// Description of the fault.
        reason: String,
    },
    /// Any other call.
    #[error("{call}: {result:?}; {}", remedy(*result))]
    Call {
        /// The call.
        call: &'static str,
        /// Its result.
        result: vk::Result,
    },
}

impl Error {
    /// Makes the error of a call: `.map_err(Error::call("vkQueueSubmit"))`.
    pub(super) fn call(call: &'static str) -> impl FnOnce(vk::Result) -> Self {
        move |result| Self::Call { call, result }
    }
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

fn remedy(result: vk::Result) -> &'static str {
    match result {
        vk::Result::ERROR_DEVICE_LOST => {
            "the device was reset, often because one pass ran too long: try again with fewer patches or rays a pass, \
             or the CPU executor"
        }
        vk::Result::ERROR_OUT_OF_HOST_MEMORY => "main memory is full: close programs or choose fewer patches",
        vk::Result::ERROR_OUT_OF_DEVICE_MEMORY => "device memory is full: choose fewer patches, or the CPU executor",
        vk::Result::ERROR_INITIALIZATION_FAILED | vk::Result::ERROR_INCOMPATIBLE_DRIVER => {
            "the driver does not work: update it, choose another device, or the CPU executor"
        }
        _ => "update the driver, choose another device, or the CPU executor",
    }
}
