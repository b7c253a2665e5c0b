//! A row of the kernel table as a pipeline.

use std::ffi::CString;
use std::io::Cursor;
use std::sync::Arc;

use ash::vk;
use gpu_kernels::table::{BindingKind, Kernel};

use super::device::Device;
use super::error::Error;

/// A compute pipeline with its layouts.
pub(super) struct Pipeline {
    pub raw: vk::Pipeline,
    pub layout: vk::PipelineLayout,
    pub set_layout: vk::DescriptorSetLayout,
    device: Arc<Device>,
}

/// Descriptor type of a binding.
pub(super) fn descriptor_type(kind: BindingKind) -> vk::DescriptorType {
    match kind {
        BindingKind::Storage { .. } => vk::DescriptorType::STORAGE_BUFFER,
        BindingKind::SampledImage { .. } => vk::DescriptorType::SAMPLED_IMAGE,
    }
}

impl Pipeline {
    /// Compiles a kernel for the device.
    pub fn new(device: &Arc<Device>, kernel: &Kernel) -> Result<Self, Error> {
        check_limits(device, kernel)?;
        let module_error = |reason: String| Error::Module { kernel: kernel.name.into(), reason };
        let words = ash::util::read_spv(&mut Cursor::new(kernel.spv)).map_err(|e| module_error(e.to_string()))?;
        let entry = CString::new(kernel.name).map_err(|e| module_error(e.to_string()))?;

        let bindings: Vec<_> = kernel
            .bindings
            .iter()
            .enumerate()
            .map(|(k, binding)| {
                vk::DescriptorSetLayoutBinding::default()
                    .binding(k as u32)
                    .descriptor_type(descriptor_type(binding.kind))
                    .descriptor_count(1)
                    .stage_flags(vk::ShaderStageFlags::COMPUTE)
            })
            .collect();
        let mut pipeline = Self {
            raw: vk::Pipeline::null(),
            layout: vk::PipelineLayout::null(),
            set_layout: vk::DescriptorSetLayout::null(),
            device: Arc::clone(device),
        };
        let create = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
        // SAFETY: the device is alive; `bindings` lives through the call.
        pipeline.set_layout = unsafe { device.raw.create_descriptor_set_layout(&create, None) }
            .map_err(Error::call("vkCreateDescriptorSetLayout"))?;

        let set_layouts = [pipeline.set_layout];
        let ranges =
            [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::COMPUTE).size(kernel.push_bytes)];
        let ranges = if kernel.push_bytes == 0 { &ranges[..0] } else { &ranges[..] };
        let create = vk::PipelineLayoutCreateInfo::default().set_layouts(&set_layouts).push_constant_ranges(ranges);
        // SAFETY: the set layout was just made from this device; the arrays live through the call.
        pipeline.layout = unsafe { device.raw.create_pipeline_layout(&create, None) }
            .map_err(Error::call("vkCreatePipelineLayout"))?;

        let create = vk::ShaderModuleCreateInfo::default().code(&words);
        // SAFETY: `words` is SPIR-V as the builder wrote and validated it, and lives through the call.
        let module =
            unsafe { device.raw.create_shader_module(&create, None) }.map_err(Error::call("vkCreateShaderModule"))?;
        let stage = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .module(module)
            .name(&entry);
        let create = [vk::ComputePipelineCreateInfo::default().stage(stage).layout(pipeline.layout)];
        // SAFETY: module, entry name and layout live through the call; the layout is made from the same table row as
        // the module's bindings (a test compares them).
        let made = unsafe { device.raw.create_compute_pipelines(vk::PipelineCache::null(), &create, None) };
        // SAFETY: a module may go once its pipeline is made.
        unsafe { device.raw.destroy_shader_module(module, None) };
        pipeline.raw = match made {
            Ok(pipelines) => pipelines.into_iter().next().unwrap_or_default(),
            Err((_, result)) => return Err(Error::Call { call: "vkCreateComputePipelines", result }),
        };
        Ok(pipeline)
    }
}

impl Drop for Pipeline {
    fn drop(&mut self) {
        // SAFETY: `Vulkan` waits for every submission before its pipelines go, so no command uses them; null handles
        // are allowed.
        unsafe {
            self.device.raw.destroy_pipeline(self.raw, None);
            self.device.raw.destroy_pipeline_layout(self.layout, None);
            self.device.raw.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}

fn check_limits(device: &Device, kernel: &Kernel) -> Result<(), Error> {
    let limits = &device.limits;
    let count = |image: bool| {
        kernel.bindings.iter().filter(|b| matches!(b.kind, BindingKind::SampledImage { .. }) == image).count() as u64
    };
    let facts = [
        ("maxPushConstantsSize", limits.max_push_constants_size, u64::from(kernel.push_bytes)),
        ("maxPerStageDescriptorStorageBuffers", limits.max_per_stage_descriptor_storage_buffers, count(false)),
        ("maxPerStageDescriptorSampledImages", limits.max_per_stage_descriptor_sampled_images, count(true)),
        ("maxComputeWorkGroupInvocations", limits.max_compute_work_group_invocations, u64::from(kernel.workgroup)),
    ];
    for (name, limit, asked) in facts {
        if asked > u64::from(limit) {
            let what = format!("kernel `{}`", kernel.name);
            return Err(device.limit(
                what,
                name,
                u64::from(limit),
                asked,
                "choose another device, or the CPU executor",
            ));
        }
    }
    Ok(())
}
