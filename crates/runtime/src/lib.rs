//! See README.md.

pub mod export;
pub mod import;
pub mod procedural;
pub mod cpu;
pub mod executor;
pub mod graph;
pub mod plan;
pub mod vulkan;
