//! Descriptor sets: what each pass of a plan is bound to.

use std::sync::Arc;

use ash::vk;

use super::commands::FETCHED;
use super::device::Device;
use super::error::Error;
use super::pipeline::{Pipeline, descriptor_type};
use super::resource::Resource;
use crate::graph::Graph;
use crate::plan::{Bound, Pass};

/// One descriptor set for each pass, with its pipeline. Nothing is updated after they are made, so that any number of
/// submissions may use them at once.
pub(super) struct Sets {
    pool: vk::DescriptorPool,
    sets: Vec<vk::DescriptorSet>,
    pipelines: Vec<Arc<Pipeline>>,
    device: Arc<Device>,
}

impl Sets {
    /// Binds the passes of a graph to their resources.
    pub fn new(
        device: &Arc<Device>,
        graph: &Graph,
        resources: &[Resource],
        pipelines: Vec<Arc<Pipeline>>,
    ) -> Result<Self, Error> {
        let mut made =
            Self { pool: vk::DescriptorPool::null(), sets: Vec::new(), pipelines, device: Arc::clone(device) };
        let passes = graph.plan().passes();
        if passes.is_empty() {
            return Ok(made);
        }
        let sizes = pool_sizes(passes);
        let create = vk::DescriptorPoolCreateInfo::default().max_sets(passes.len() as u32).pool_sizes(&sizes);
        // SAFETY: the device is alive; `sizes` lives through the call.
        made.pool = unsafe { device.raw.create_descriptor_pool(&create, None) }
            .map_err(Error::call("vkCreateDescriptorPool"))?;
        let layouts: Vec<_> = made.pipelines.iter().map(|pipeline| pipeline.set_layout).collect();
        let allocate = vk::DescriptorSetAllocateInfo::default().descriptor_pool(made.pool).set_layouts(&layouts);
        // SAFETY: the pool has room for exactly these sets; the layouts live in `made.pipelines`.
        made.sets = unsafe { device.raw.allocate_descriptor_sets(&allocate) }
            .map_err(Error::call("vkAllocateDescriptorSets"))?;
        for (pass, set) in passes.iter().zip(&made.sets) {
            for (binding, bound) in pass.bound.iter().enumerate() {
                write_binding(device, *set, binding as u32, bound, &resources[graph.slot_of(bound.buffer)]);
            }
        }
        Ok(made)
    }

    /// Set and pipeline of the pass with this index.
    pub fn of_pass(&self, index: usize) -> (vk::DescriptorSet, &Pipeline) {
        (self.sets[index], &self.pipelines[index])
    }
}

/// Descriptors of each type that the passes bind; types that none binds are left out.
fn pool_sizes(passes: &[Pass]) -> Vec<vk::DescriptorPoolSize> {
    let mut sizes = Vec::new();
    for ty in [vk::DescriptorType::STORAGE_BUFFER, vk::DescriptorType::SAMPLED_IMAGE] {
        let bindings = passes.iter().flat_map(|pass| pass.kernel.bindings);
        let descriptor_count = bindings.filter(|binding| descriptor_type(binding.kind) == ty).count() as u32;
        if descriptor_count > 0 {
            sizes.push(vk::DescriptorPoolSize { ty, descriptor_count });
        }
    }
    sizes
}

fn write_binding(device: &Device, set: vk::DescriptorSet, binding: u32, bound: &Bound, resource: &Resource) {
    let mut buffers = [vk::DescriptorBufferInfo::default()];
    let mut images = [vk::DescriptorImageInfo::default()];
    let write = vk::WriteDescriptorSet::default().dst_set(set).dst_binding(binding);
    let write = match resource {
        Resource::Buffer(buffer) => {
            buffers[0] = vk::DescriptorBufferInfo { buffer: buffer.raw, offset: bound.offset, range: bound.bytes };
            write.descriptor_type(vk::DescriptorType::STORAGE_BUFFER).buffer_info(&buffers)
        }
        Resource::Image(image) => {
            images[0] = vk::DescriptorImageInfo::default().image_view(image.view).image_layout(FETCHED);
            write.descriptor_type(vk::DescriptorType::SAMPLED_IMAGE).image_info(&images)
        }
    };
    // SAFETY: the set is new and not in use; the range lies in the buffer (checked by the plan) and buffer, picture and
    // view outlive the set.
    unsafe { device.raw.update_descriptor_sets(&[write], &[]) };
}

impl Drop for Sets {
    fn drop(&mut self) {
        // SAFETY: every submission that uses the sets is waited for before their owner drops them; a null pool is
        // allowed; the sets go with their pool.
        unsafe { self.device.raw.destroy_descriptor_pool(self.pool, None) };
    }
}
