//! Commands in a caller's command buffer, which the caller submits.

use ash::vk;

use super::Vulkan;
use super::commands::{Commands, Scope};
use super::error::Error;
use super::staging::Staging;
use super::work::Work;
use crate::plan::PassId;

/// Recorded frames that may be in flight at once.
pub const MAX_FRAMES: usize = 8;

/// Recordings of callers: the one under way, and the staging memory of each frame in flight.
#[derive(Default)]
pub(super) struct Recordings {
    current: Option<Current>,
    /// By the frame's slot.
    staging: Vec<Staging>,
}

#[derive(Clone, Copy)]
struct Current {
    commands: vk::CommandBuffer,
    frame: usize,
}

impl Recordings {
    /// Staging memory while a caller's command buffer is being recorded.
    pub fn staging(&mut self) -> Option<&mut Staging> {
        self.staging.get_mut(self.current?.frame)
    }

    /// Returns true while a caller's command buffer is being recorded.
    pub fn is_open(&self) -> bool {
        self.current.is_some()
    }

    /// Refuses a call that waits for the device while a caller's command buffer is being recorded.
    pub fn refuse(&self, call: &'static str) -> Result<(), Error> {
        if self.current.is_some() { Err(Error::Recording { call }) } else { Ok(()) }
    }
}

impl Vulkan {
    /// From now until [`Vulkan::end_recording`], uploads, clears and
    /// [`submit_passes`](crate::executor::Executor::submit_passes) are recorded into the caller's command buffer
    /// instead of being submitted. The caller submits it, with whatever fence and semaphores the caller likes.
    ///
    /// `frame` is the slot, 0 to [`MAX_FRAMES`]` - 1`, whose staging memory the uploads of this recording take: the
    /// number of the frame modulo the frames in flight.
    ///
    /// Barriers: a memory barrier from all commands to all commands is recorded first and last, so that the passes see
    /// what was recorded or submitted to the queue before, and what follows sees what they write. The caller needs a
    /// semaphore only between queues. Pushes of a pass are those set when `submit_passes` is called. Passes are not
    /// timed.
    ///
    /// Afterwards the bound compute pipeline, the compute descriptor set 0 and the compute push constants of the
    /// command buffer are undefined.
    ///
    /// What waits to be uploaded is submitted before, by itself. `run_passes`, `download` and `load` wait for the
    /// device and are refused until the recording ends.
    ///
    /// # Errors
    /// A recording that is not ended; a slot that there is not; what the device says.
    ///
    /// # Safety
    /// - `commands` is being recorded, outside of a render pass, and stays so until [`Vulkan::end_recording`]. It is of
    ///   this executor's device and of a queue family with `VK_QUEUE_COMPUTE_BIT`.
    /// - It is submitted to the executor's queue, or to another queue of the same family that is synchronised with it
    ///   by semaphores, before anything that depends on it is submitted through this executor. It is submitted at most
    ///   once, or never.
    /// - The previous recording of the slot `frame` is finished on the device, or was never submitted and never will
    ///   be.
    /// - All recordings are finished on the device before a plan is loaded and before the executor is dropped.
    pub unsafe fn begin_recording(&mut self, commands: vk::CommandBuffer, frame: usize) -> Result<(), Error> {
        self.recordings.refuse("begin_recording")?;
        if frame >= MAX_FRAMES {
            return Err(Error::FrameSlot { frame, count: MAX_FRAMES });
        }
        if self.queue.has_uploads() {
            self.submit_untimed(&[])?;
        }
        while self.recordings.staging.len() <= frame {
            self.recordings.staging.push(Staging::new(&self.device));
        }
        self.recordings.staging[frame].reset();
        // SAFETY: as the caller promises.
        unsafe { Commands::new(&self.device, commands) }.barrier(Scope::ALL, Scope::ALL);
        self.recordings.current = Some(Current { commands, frame });
        Ok(())
    }

    /// Records what waits to be uploaded and a last barrier. The command buffer is the caller's again.
    ///
    /// # Errors
    /// No recording.
    pub fn end_recording(&mut self) -> Result<(), Error> {
        if !self.record_passes(&[]) {
            return Err(Error::NotRecording);
        }
        self.recordings.current = None;
        self.device.check_messages()
    }

    /// Records uploads and passes into the caller's command buffer, with a barrier after them; `false` if there is
    /// none.
    pub(super) fn record_passes(&mut self, passes: &[PassId]) -> bool {
        let Some(current) = self.recordings.current else { return false };
        let work = Work { graph: &self.graph, sets: self.sets.as_ref(), resources: &self.resources, passes };
        // SAFETY: `begin_recording`'s caller promises that the command buffer is being recorded until `end_recording`,
        // and that it is finished before plan and executor, which own everything that is recorded, go.
        let commands = unsafe { Commands::new(&self.device, current.commands) };
        work.record(&commands, &mut self.recordings.staging[current.frame], None);
        commands.barrier(Scope::ALL, Scope::ALL);
        true
    }
}
