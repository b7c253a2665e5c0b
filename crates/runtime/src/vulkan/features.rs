//! Required features of a device, and how a caller enables them on a device of their own.

use ash::vk;

/// The Vulkan version that instance and device must have at least.
pub const API_VERSION: u32 = vk::API_VERSION_1_2;

/// A feature that the kernels use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Feature {
    /// Its name in the Vulkan specification.
    pub name: &'static str,
    /// True if no kernel runs without it.
    pub is_required: bool,
    /// Its purpose.
    pub purpose: &'static str,
}

const MEMORY_MODEL: &str = "vulkanMemoryModel";
const DEVICE_SCOPE: &str = "vulkanMemoryModelDeviceScope";
pub(super) const BLOCK_IMAGES: &str = "textureCompressionBC";
pub(super) const COMPUTE_QUEUE: &str = "a queue family with VK_QUEUE_COMPUTE_BIT";

/// All features that the kernels use, besides [`API_VERSION`] and a queue family with `VK_QUEUE_COMPUTE_BIT`.
/// [`enable_features`] enables them.
pub const FEATURES: [Feature; 3] = [
    Feature { name: MEMORY_MODEL, is_required: true, purpose: "every kernel is compiled for this memory model" },
    Feature { name: DEVICE_SCOPE, is_required: true, purpose: "atomic operations reach the whole device" },
    Feature { name: BLOCK_IMAGES, is_required: false, purpose: "form factors in texture blocks decode in hardware" },
];

/// Which of [`FEATURES`] a device was made with, or a physical device supports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EnabledFeatures {
    /// `VkPhysicalDeviceVulkan12Features::vulkanMemoryModel`.
    pub vulkan_memory_model: bool,
    /// `VkPhysicalDeviceVulkan12Features::vulkanMemoryModelDeviceScope`.
    pub vulkan_memory_model_device_scope: bool,
    /// `VkPhysicalDeviceFeatures::textureCompressionBC`; without it pictures of texture blocks are refused.
    pub texture_compression_bc: bool,
}

impl EnabledFeatures {
    /// Reads the structures that a device was made with.
    pub fn of(features: &vk::PhysicalDeviceFeatures, vulkan_1_2: &vk::PhysicalDeviceVulkan12Features<'_>) -> Self {
        Self {
            vulkan_memory_model: vulkan_1_2.vulkan_memory_model == vk::TRUE,
            vulkan_memory_model_device_scope: vulkan_1_2.vulkan_memory_model_device_scope == vk::TRUE,
            texture_compression_bc: features.texture_compression_bc == vk::TRUE,
        }
    }

    /// Name of the first required feature that is not there.
    pub fn missing(&self) -> Option<&'static str> {
        if !self.vulkan_memory_model {
            return Some(MEMORY_MODEL);
        }
        if !self.vulkan_memory_model_device_scope {
            return Some(DEVICE_SCOPE);
        }
        None
    }
}

/// Enables [`FEATURES`] in the structures that a device is going to be made with: the required ones, and the others
/// where `supported` has them. Everything else in the structures stays as it is.
pub fn enable_features(
    supported: &vk::PhysicalDeviceFeatures,
    features: &mut vk::PhysicalDeviceFeatures,
    vulkan_1_2: &mut vk::PhysicalDeviceVulkan12Features<'_>,
) {
    vulkan_1_2.vulkan_memory_model = vk::TRUE;
    vulkan_1_2.vulkan_memory_model_device_scope = vk::TRUE;
    if supported.texture_compression_bc == vk::TRUE {
        features.texture_compression_bc = vk::TRUE;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_enabled_is_complete_and_each_omission_is_named() {
        let mut features = vk::PhysicalDeviceFeatures::default();
        let mut vulkan_1_2 = vk::PhysicalDeviceVulkan12Features::default().scalar_block_layout(true);
        assert_eq!(EnabledFeatures::of(&features, &vulkan_1_2).missing(), Some("vulkanMemoryModel"));
        enable_features(&vk::PhysicalDeviceFeatures::default(), &mut features, &mut vulkan_1_2);
        let enabled = EnabledFeatures::of(&features, &vulkan_1_2);
        assert_eq!(enabled.missing(), None);
        assert!(!enabled.texture_compression_bc, "not supported");
        assert_eq!(vulkan_1_2.scalar_block_layout, vk::TRUE, "the caller's own feature stays");

        let supported = vk::PhysicalDeviceFeatures::default().texture_compression_bc(true);
        enable_features(&supported, &mut features, &mut vulkan_1_2);
        assert!(EnabledFeatures::of(&features, &vulkan_1_2).texture_compression_bc);
        vulkan_1_2.vulkan_memory_model_device_scope = vk::FALSE;
        let missing = EnabledFeatures::of(&features, &vulkan_1_2).missing();
        assert_eq!(missing, Some("vulkanMemoryModelDeviceScope"));
    }
}
