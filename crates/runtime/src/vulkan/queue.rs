//! Submissions: one command buffer, one fence, a timestamp pool. Every submission is waited for.

use std::sync::Arc;

use ash::vk;

use super::device::Device;
use super::error::Error;

/// Records and submits commands to the device's queue.
pub(super) struct Queue {
    device: Arc<Device>,
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    fence: vk::Fence,
    queries: vk::QueryPool,
    query_count: u32,
}

impl Queue {
    pub fn new(device: &Arc<Device>) -> Result<Self, Error> {
        let mut queue = Self {
            device: Arc::clone(device),
            pool: vk::CommandPool::null(),
            commands: vk::CommandBuffer::null(),
            fence: vk::Fence::null(),
            queries: vk::QueryPool::null(),
            query_count: 0,
        };
        let create = vk::CommandPoolCreateInfo::default()
            .queue_family_index(device.family)
            .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER);
        // SAFETY: the family is the one that the device was made with.
        queue.pool =
            unsafe { device.raw.create_command_pool(&create, None) }.map_err(Error::call("vkCreateCommandPool"))?;
        let allocate = vk::CommandBufferAllocateInfo::default()
            .command_pool(queue.pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(1);
        // SAFETY: the pool was just made from this device.
        let buffers = unsafe { device.raw.allocate_command_buffers(&allocate) }
            .map_err(Error::call("vkAllocateCommandBuffers"))?;
        queue.commands = buffers.into_iter().next().unwrap_or_default();
        // SAFETY: the device is alive.
        queue.fence = unsafe { device.raw.create_fence(&vk::FenceCreateInfo::default(), None) }
            .map_err(Error::call("vkCreateFence"))?;
        Ok(queue)
    }

    /// Records what `record` records, submits it and waits until the device is done. Everything that earlier submissions
    /// wrote is visible to it.
    pub fn submit(&mut self, record: impl FnOnce(&ash::Device, vk::CommandBuffer)) -> Result<(), Error> {
        let raw = &self.device.raw;
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the command buffer is not in use: every earlier submission was waited for. Its pool allows the implicit
        // reset.
        unsafe { raw.begin_command_buffer(self.commands, &begin) }.map_err(Error::call("vkBeginCommandBuffer"))?;
        let all = vk::AccessFlags::MEMORY_READ | vk::AccessFlags::MEMORY_WRITE;
        self.barrier(vk::PipelineStageFlags::ALL_COMMANDS, all, vk::PipelineStageFlags::ALL_COMMANDS, all);
        record(raw, self.commands);
        self.barrier(
            vk::PipelineStageFlags::ALL_COMMANDS,
            vk::AccessFlags::MEMORY_WRITE,
            vk::PipelineStageFlags::HOST,
            vk::AccessFlags::HOST_READ,
        );
        // SAFETY: the command buffer is being recorded.
        unsafe { raw.end_command_buffer(self.commands) }.map_err(Error::call("vkEndCommandBuffer"))?;
        let commands = [self.commands];
        let submits = [vk::SubmitInfo::default().command_buffers(&commands)];
        // SAFETY: the fence is unsignalled and not in use; `&mut self` and the device's single owner keep other threads from
        // the queue; what the commands use outlives the wait below.
        unsafe {
            raw.queue_submit(self.device.queue, &submits, self.fence).map_err(Error::call("vkQueueSubmit"))?;
            if let Err(result) = raw.wait_for_fences(&[self.fence], true, u64::MAX) {
                // Nothing may be freed under running commands; a lost device runs none.
                let _ = raw.device_wait_idle();
                return Err(Error::Call { call: "vkWaitForFences", result });
            }
            raw.reset_fences(&[self.fence]).map_err(Error::call("vkResetFences"))?;
        }
        Ok(())
    }

    fn barrier(
        &self,
        from: vk::PipelineStageFlags,
        from_access: vk::AccessFlags,
        to: vk::PipelineStageFlags,
        to_access: vk::AccessFlags,
    ) {
        let barriers = [vk::MemoryBarrier::default().src_access_mask(from_access).dst_access_mask(to_access)];
        // SAFETY: the command buffer is being recorded; the stages and accesses are those of every queue.
        unsafe {
            self.device.raw.cmd_pipeline_barrier(
                self.commands,
                from,
                to,
                vk::DependencyFlags::empty(),
                &barriers,
                &[],
                &[],
            );
        }
    }

    /// A pool of at least `count` timestamps.
    pub fn queries(&mut self, count: u32) -> Result<vk::QueryPool, Error> {
        if count > self.query_count {
            let create = vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(count);
            // SAFETY: the queue's family has timestamps (the caller asks only then).
            let pool = unsafe { self.device.raw.create_query_pool(&create, None) }
                .map_err(Error::call("vkCreateQueryPool"))?;
            // SAFETY: no submission is under way; a null pool is allowed.
            unsafe { self.device.raw.destroy_query_pool(self.queries, None) };
            (self.queries, self.query_count) = (pool, count);
        }
        Ok(self.queries)
    }

    /// Milliseconds between successive timestamps of the last submission.
    pub fn intervals(&self, count: u32) -> Result<Vec<f64>, Error> {
        let mut ticks = vec![0u64; count as usize];
        let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WAIT;
        // SAFETY: the first `count` queries were written by the last submission, which is done.
        unsafe { self.device.raw.get_query_pool_results(self.queries, 0, &mut ticks, flags) }
            .map_err(Error::call("vkGetQueryPoolResults"))?;
        let mask = u64::MAX >> (64 - self.device.timestamp_bits.clamp(1, 64));
        let period = f64::from(self.device.limits.timestamp_period);
        Ok(ticks.windows(2).map(|t| (t[1].wrapping_sub(t[0]) & mask) as f64 * period * 1e-6).collect())
    }
}

impl Drop for Queue {
    fn drop(&mut self) {
        // SAFETY: no submission is under way, or the device is lost; null handles are allowed.
        unsafe {
            self.device.raw.destroy_query_pool(self.queries, None);
            self.device.raw.destroy_fence(self.fence, None);
            self.device.raw.destroy_command_pool(self.pool, None);
        }
    }
}
