//! Copies of device buffers on their way to the host.

use std::collections::HashMap;
use std::sync::Arc;

use super::buffer::Buffer;
use super::device::Device;
use super::error::Error;
use super::queue::Queue;
use crate::executor::ReadId;

/// Host buffers without a copy that are kept for the next reads.
const MAX_FREE: usize = 8;

/// Reads that were begun, and host buffers for the next ones.
#[derive(Default)]
pub(super) struct Reads {
    begun: HashMap<ReadId, Read>,
    free: Vec<(u64, Buffer)>,
    count: u64,
}

/// A copy that was submitted.
struct Read {
    host: Buffer,
    bytes: u64,
    /// Number of its submission.
    submission: u64,
}

impl Reads {
    /// A host buffer for so many bytes.
    pub fn buffer(&mut self, device: &Arc<Device>, bytes: u64) -> Result<Buffer, Error> {
        let size = bytes.max(1);
        match self.free.iter().position(|(free, _)| *free == size) {
            Some(index) => Ok(self.free.swap_remove(index).1),
            None => Buffer::to_host(device, size),
        }
    }

    /// Notes the copy of a submission.
    pub fn add(&mut self, host: Buffer, bytes: u64, submission: u64) -> ReadId {
        let read = ReadId(self.count);
        self.count += 1;
        self.begun.insert(read, Read { host, bytes, submission });
        read
    }

    /// The bytes of a read that has arrived.
    pub fn take(&mut self, read: ReadId, queue: &Queue) -> Option<Vec<u8>> {
        if !queue.is_done(self.begun.get(&read)?.submission) {
            return None;
        }
        let Read { host, bytes, .. } = self.begun.remove(&read)?;
        let copy = host.mapped()[..bytes as usize].to_vec();
        if self.free.len() < MAX_FREE {
            self.free.push((bytes.max(1), host));
        }
        Some(copy)
    }
}
