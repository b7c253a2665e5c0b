//! Memory of buffers and pictures.

use std::sync::{Arc, Mutex, PoisonError};

use ash::vk;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme, Allocator};
use gpu_allocator::{AllocationError, MemoryLocation};

use super::error::Error;

/// Memory behind a buffer or a picture, given back when it is dropped. What owns it lets it go before the device.
pub struct Memory {
    allocator: Arc<Mutex<Allocator>>,
    allocation: Option<Allocation>,
}

/// Purpose of memory.
#[derive(Clone, Copy, Debug)]
pub struct MemoryRequest<'a> {
    /// Name of the buffer or picture.
    pub name: &'a str,
    /// Bytes that were asked for.
    pub bytes: u64,
    /// Vulkan's requirements.
    pub requirements: vk::MemoryRequirements,
    /// Who sees it.
    pub location: MemoryLocation,
    /// True if it is a buffer.
    pub linear: bool,
}

impl Memory {
    /// Takes memory of a device.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`] with what was asked for and what there is, [`Error::Allocator`].
    pub fn new(allocator: &Arc<Mutex<Allocator>>, request: &MemoryRequest) -> Result<Self, Error> {
        let MemoryRequest { name, bytes, requirements, location, linear } = *request;
        let allocation_scheme = AllocationScheme::GpuAllocatorManaged;
        let desc = AllocationCreateDesc { name, requirements, location, linear, allocation_scheme };
        let made = allocator.lock().unwrap_or_else(PoisonError::into_inner).allocate(&desc);
        let allocation = made.map_err(|error| match error {
            AllocationError::OutOfMemory => {
                let reason = format!("{error}; {} bytes of it are in use here", bytes_in_use(allocator));
                Error::OutOfMemory { call: "vkAllocateMemory", what: name.into(), bytes, reason }
            }
            other => Error::Allocator { what: name.into(), bytes, reason: other.to_string() },
        })?;
        Ok(Self { allocator: Arc::clone(allocator), allocation: Some(allocation) })
    }

    /// The memory and the place in it, to be bound to what owns it and to nothing else.
    pub fn handle(&self) -> (vk::DeviceMemory, u64) {
        match &self.allocation {
            // SAFETY: the handle is only used to bind it to the resource that owns this allocation.
            Some(allocation) => (unsafe { allocation.memory() }, allocation.offset()),
            None => (vk::DeviceMemory::null(), 0),
        }
    }

    /// Its bytes where the host sees them, else none.
    pub fn mapped(&self) -> &[u8] {
        self.allocation.as_ref().and_then(Allocation::mapped_slice).unwrap_or_default()
    }

    /// Mapped memory, to write.
    pub fn mapped_mut(&mut self) -> &mut [u8] {
        self.allocation.as_mut().and_then(Allocation::mapped_slice_mut).unwrap_or_default()
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        if let Some(allocation) = self.allocation.take() {
            // Fails only for an allocation of another allocator.
            let _ = self.allocator.lock().unwrap_or_else(PoisonError::into_inner).free(allocation);
        }
    }
}

/// Bytes of all buffers and pictures.
pub(super) fn bytes_in_use(allocator: &Mutex<Allocator>) -> u64 {
    allocator.lock().unwrap_or_else(PoisonError::into_inner).generate_report().total_allocated_bytes
}
