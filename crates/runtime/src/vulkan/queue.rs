//! Submissions: a ring of command buffers, each with its fence, its timestamps and the staging memory of its uploads.
//!
//! Nothing is waited for but what is asked for, or the oldest submission when the ring is full.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use ash::vk;

use super::commands::{Commands, Scope};
use super::device::Device;
use super::error::Error;
use super::staging::Staging;
use crate::executor::{KEPT_TIMES, PassTime};

/// Submissions that may be in flight unless the caller says otherwise.
const SUBMISSIONS: usize = 4;

/// Records and submits commands to the device's queue.
pub(super) struct Queue {
    device: Arc<Device>,
    pool: vk::CommandPool,
    ring: Vec<Submission>,
    /// Index of the submission that is being prepared.
    next: usize,
    /// Times of the passes of finished submissions, one entry each, until they are asked for.
    finished: VecDeque<Vec<PassTime>>,
    /// Number of submissions so far, and of those that are finished: they finish in their order.
    submitted: u64,
    done: u64,
}

/// One place of the ring.
struct Submission {
    commands: vk::CommandBuffer,
    fence: vk::Fence,
    is_in_flight: bool,
    /// Its number among all submissions, from 1.
    number: u64,
    staging: Staging,
    queries: vk::QueryPool,
    query_capacity: u32,
    /// Names of the passes between the timestamps; empty without timestamps.
    times: Vec<PassTime>,
}

/// A submission that may be waited for; valid until the next one is made.
pub(super) struct Ticket(usize);

impl Queue {
    /// A queue that allows as many submissions in flight as is usual.
    pub fn new(device: &Arc<Device>) -> Result<Self, Error> {
        let mut queue = Self {
            device: Arc::clone(device),
            pool: vk::CommandPool::null(),
            ring: Vec::new(),
            next: 0,
            finished: VecDeque::new(),
            submitted: 0,
            done: 0,
        };
        let create = vk::CommandPoolCreateInfo::default()
            .queue_family_index(device.family)
            .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER);
        // SAFETY: the family is the one that the device was made with.
        queue.pool =
            unsafe { device.raw.create_command_pool(&create, None) }.map_err(Error::call("vkCreateCommandPool"))?;
        queue.resize(SUBMISSIONS)?;
        Ok(queue)
    }

    /// Waits for everything in flight and allows `count` submissions (at least 1) from now on. Uploads that wait stay.
    pub fn resize(&mut self, count: usize) -> Result<(), Error> {
        self.finish()?;
        if !self.ring.is_empty() {
            // The submission that is being prepared becomes the first.
            self.ring.rotate_left(self.next);
            self.next = 0;
        }
        while self.ring.len() > count.max(1) {
            if let Some(submission) = self.ring.pop() {
                submission.destroy(&self.device.raw, self.pool);
            }
        }
        while self.ring.len() < count.max(1) {
            let submission = self.new_submission()?;
            self.ring.push(submission);
        }
        Ok(())
    }

    fn new_submission(&self) -> Result<Submission, Error> {
        let raw = &self.device.raw;
        // SAFETY: the device is alive.
        let fence =
            unsafe { raw.create_fence(&vk::FenceCreateInfo::default(), None) }.map_err(Error::call("vkCreateFence"))?;
        let mut submission = Submission {
            commands: vk::CommandBuffer::null(),
            fence,
            is_in_flight: false,
            number: 0,
            staging: Staging::new(&self.device),
            queries: vk::QueryPool::null(),
            query_capacity: 0,
            times: Vec::new(),
        };
        let allocate = vk::CommandBufferAllocateInfo::default()
            .command_pool(self.pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(1);
        // SAFETY: the pool was made from this device.
        match unsafe { raw.allocate_command_buffers(&allocate) } {
            Ok(buffers) => {
                submission.commands = buffers.into_iter().next().unwrap_or_default();
                Ok(submission)
            }
            Err(result) => {
                submission.destroy(raw, self.pool);
                Err(Error::Call { call: "vkAllocateCommandBuffers", result })
            }
        }
    }

    /// Staging memory that collects the uploads of the next submission. Waits for the oldest submission when the ring
    /// is full.
    pub fn staging(&mut self) -> Result<&mut Staging, Error> {
        if self.ring[self.next].is_in_flight {
            self.finish_and_keep(self.next)?;
        }
        Ok(&mut self.ring[self.next].staging)
    }

    /// Returns true if uploads or clears wait for the next submission.
    pub fn has_uploads(&self) -> bool {
        !self.ring[self.next].is_in_flight && !self.ring[self.next].staging.is_empty()
    }

    /// Drops the uploads that wait for the next submission.
    pub fn forget_uploads(&mut self) {
        if !self.ring[self.next].is_in_flight {
            self.ring[self.next].staging.reset();
        }
    }

    /// Records what `record` records and submits it. Everything that earlier submissions wrote is visible to it.
    /// `times` are those of the passes that are timed, without their milliseconds: `record` then writes one timestamp
    /// more than there are passes.
    ///
    /// # Safety
    /// What `record` records outlives its execution, which [`Queue::finish`] waits for.
    pub unsafe fn submit(
        &mut self,
        times: Vec<PassTime>,
        record: impl FnOnce(&Commands<'_>, &mut Staging, vk::QueryPool),
    ) -> Result<Ticket, Error> {
        self.staging()?;
        let raw = &self.device.raw;
        let index = self.next;
        let submission = &mut self.ring[index];
        if !times.is_empty() {
            submission.reserve_queries(raw, times.len() as u32 + 1)?;
        }
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the command buffer is not in use, see `staging`. Its pool allows the implicit reset.
        unsafe { raw.begin_command_buffer(submission.commands, &begin) }
            .map_err(Error::call("vkBeginCommandBuffer"))?;
        // SAFETY: recording has begun, with the device's own compute family; the rest is the caller's promise.
        let commands = unsafe { Commands::new(&self.device, submission.commands) };
        commands.barrier(Scope::ALL, Scope::ALL);
        record(&commands, &mut submission.staging, submission.queries);
        let buffers = [submission.commands];
        let submits = [vk::SubmitInfo::default().command_buffers(&buffers)];
        // SAFETY: the command buffer is being recorded, then executable; the fence is unsignalled and not in use;
        // `&mut self` keeps our threads from the queue, and the lender of a borrowed queue keeps theirs from it; what
        // the commands use outlives them, as the caller promises.
        let submitted = unsafe {
            raw.end_command_buffer(submission.commands).map_err(Error::call("vkEndCommandBuffer")).and_then(|()| {
                raw.queue_submit(self.device.queue, &submits, submission.fence).map_err(Error::call("vkQueueSubmit"))
            })
        };
        if let Err(error) = submitted {
            submission.staging.reset();
            return Err(error);
        }
        self.submitted += 1;
        submission.is_in_flight = true;
        submission.number = self.submitted;
        submission.times = times;
        self.next = (index + 1) % self.ring.len();
        Ok(Ticket(index))
    }

    /// Number of the last submission.
    pub fn last_number(&self) -> u64 {
        self.submitted
    }

    /// Returns true if the submission of a number is known to have finished; [`Queue::poll`] asks the device.
    pub fn is_done(&self, number: u64) -> bool {
        number <= self.done
    }

    /// Waits for a submission and all before it; gives the times of its passes.
    pub fn wait_for(&mut self, ticket: &Ticket) -> Result<Vec<PassTime>, Error> {
        for index in self.oldest_first() {
            if index == ticket.0 {
                break;
            }
            self.finish_and_keep(index)?;
        }
        self.finish_one(ticket.0)
    }

    /// Waits for everything in flight.
    pub fn finish(&mut self) -> Result<(), Error> {
        let mut outcome = Ok(());
        for index in self.oldest_first() {
            // The others are waited for even when one fails.
            outcome = outcome.and(self.finish_and_keep(index));
        }
        outcome
    }

    /// Takes note of what is finished, without waiting.
    pub fn poll(&mut self) -> Result<(), Error> {
        for index in self.oldest_first() {
            let submission = &self.ring[index];
            if !submission.is_in_flight {
                continue;
            }
            // SAFETY: the fence is alive.
            let status = unsafe { self.device.raw.get_fence_status(submission.fence) };
            if !status.map_err(Error::call("vkGetFenceStatus"))? {
                break;
            }
            self.finish_and_keep(index)?;
        }
        Ok(())
    }

    /// Times of the passes that finished since the last call, in their order.
    pub fn take_times(&mut self) -> Vec<PassTime> {
        self.finished.drain(..).flatten().collect()
    }

    fn oldest_first(&self) -> impl Iterator<Item = usize> + use<> {
        let count = self.ring.len();
        let next = self.next;
        (0..count).map(move |k| (next + k) % count)
    }

    fn finish_and_keep(&mut self, index: usize) -> Result<(), Error> {
        let times = self.finish_one(index)?;
        if !times.is_empty() {
            if self.finished.len() == KEPT_TIMES {
                self.finished.pop_front();
            }
            self.finished.push_back(times);
        }
        Ok(())
    }

    /// Waits for a submission if it is in flight, makes its place free, and gives the times of its passes.
    fn finish_one(&mut self, index: usize) -> Result<Vec<PassTime>, Error> {
        self.wait_for_fence(index)?;
        let submission = &mut self.ring[index];
        let mut times = std::mem::take(&mut submission.times);
        if times.is_empty() {
            return Ok(times);
        }
        let intervals = submission.intervals(&self.device, times.len() + 1)?;
        times.iter_mut().zip(intervals).for_each(|(time, interval)| time.milliseconds = interval);
        Ok(times)
    }

    /// Waits for a submission if it is in flight and makes its place free.
    fn wait_for_fence(&mut self, index: usize) -> Result<(), Error> {
        let submission = &mut self.ring[index];
        if !submission.is_in_flight {
            return Ok(());
        }
        let raw = &self.device.raw;
        // SAFETY: the fence was given to a submission.
        let waited = unsafe { raw.wait_for_fences(&[submission.fence], true, u64::MAX) };
        if waited.is_err() {
            submission.times.clear();
            settle(raw, submission.fence);
        }
        submission.is_in_flight = false;
        submission.staging.reset();
        self.done = self.done.max(submission.number);
        waited.map_err(Error::call("vkWaitForFences"))?;
        // SAFETY: the fence is signalled and not in use.
        unsafe { raw.reset_fences(&[submission.fence]) }.map_err(Error::call("vkResetFences"))
    }
}

/// Nothing may be freed under running commands: asks until they are done. A lost device runs none.
fn settle(raw: &ash::Device, fence: vk::Fence) {
    // SAFETY: the fence is alive and was given to a submission.
    while unsafe { raw.get_fence_status(fence) } == Ok(false) {
        std::thread::sleep(Duration::from_millis(1));
    }
}

impl Submission {
    /// Makes room for `count` timestamps.
    fn reserve_queries(&mut self, raw: &ash::Device, count: u32) -> Result<(), Error> {
        if count <= self.query_capacity {
            return Ok(());
        }
        let create = vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(count);
        // SAFETY: the queue's family has timestamps (only then are passes timed).
        let pool = unsafe { raw.create_query_pool(&create, None) }.map_err(Error::call("vkCreateQueryPool"))?;
        // SAFETY: this place of the ring is not in flight; a null pool is allowed.
        unsafe { raw.destroy_query_pool(self.queries, None) };
        self.queries = pool;
        self.query_capacity = count;
        Ok(())
    }

    /// Milliseconds between successive timestamps of the last execution.
    fn intervals(&self, device: &Device, count: usize) -> Result<Vec<f64>, Error> {
        let mut ticks = vec![0u64; count];
        let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WAIT;
        // SAFETY: the first `count` queries were written by the last execution, which is done.
        unsafe { device.raw.get_query_pool_results(self.queries, 0, &mut ticks, flags) }
            .map_err(Error::call("vkGetQueryPoolResults"))?;
        let mask = u64::MAX >> (64 - device.timestamp_bits.clamp(1, 64));
        let period = f64::from(device.limits.timestamp_period);
        Ok(ticks.windows(2).map(|t| (t[1].wrapping_sub(t[0]) & mask) as f64 * period * 1e-6).collect())
    }

    fn destroy(self, raw: &ash::Device, pool: vk::CommandPool) {
        // SAFETY: this place of the ring is not in flight, or the device is lost; null handles are allowed.
        unsafe {
            raw.destroy_query_pool(self.queries, None);
            raw.destroy_fence(self.fence, None);
            if self.commands != vk::CommandBuffer::null() {
                raw.free_command_buffers(pool, &[self.commands]);
            }
        }
    }
}

impl Drop for Queue {
    fn drop(&mut self) {
        for index in self.oldest_first() {
            // What is lost with the device cannot be reported here. Times are not read: drivers may wait for the whole
            // device then (lavapipe does), and it may be a caller's.
            let _ = self.wait_for_fence(index);
        }
        for submission in self.ring.drain(..) {
            submission.destroy(&self.device.raw, self.pool);
        }
        // SAFETY: no submission is under way, or the device is lost; a null handle is allowed.
        unsafe { self.device.raw.destroy_command_pool(self.pool, None) };
    }
}
