//! Waiting on an atomic where there is one thread. Matrix products of faer would wait so for their other threads; with one
//! thread they have none. Each wait ends at once, as the crate whose name this has allows: its callers look again.

use std::sync::atomic::AtomicU32;

/// Ends at once.
pub fn wait(_: &AtomicU32, _: u32) {
    std::hint::spin_loop();
}

/// Wakes nobody.
pub fn wake_one(_: *const AtomicU32) {}

/// Wakes nobody.
pub fn wake_all(_: *const AtomicU32) {}
