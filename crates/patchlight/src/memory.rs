//! Memory of this process and of the machine, where the system tells (Linux).

use crate::error::{Error, Reason};

pub use scene::host::memory::{available_bytes, peak_memory_bytes, resident_bytes};

/// Bytes of memory that are free for new work: what a limit of resident memory leaves, or what the system says.
pub fn free_bytes(limit: Option<u64>) -> Option<u64> {
    match limit {
        Some(limit) => Some(limit.saturating_sub(resident_bytes().unwrap_or(0))),
        None => available_bytes(),
    }
}

/// Refuses what would take more memory than is free.
///
/// # Errors
/// [`Memory`](crate::ErrorKind::Memory) with what it is, and how to make it smaller.
pub fn check_free(what: impl Into<String>, needed: f64, limit: Option<u64>, remedy: &'static str) -> Result<(), Error> {
    match free_bytes(limit) {
        Some(free) if needed > free as f64 => Err(Reason::TooLarge { what: what.into(), needed, free, remedy }.into()),
        _ => Ok(()),
    }
}
