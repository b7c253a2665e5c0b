//! Frames as data, and who runs them.
//!
//! A frame is a [`plan::Plan`] of buffers and passes over the kernels of `gpu-kernels`; what a pass reads and writes,
//! and so order, barriers and lifetimes ([`graph`]), follow from the kernel table. An [`executor::Executor`] runs it:
//! [`cpu::Cpu`] by the kernels' host forms on all cores, [`vulkan::Vulkan`] by their SPIR-V modules; the results agree.

pub mod cpu;
pub mod executor;
pub mod graph;
pub mod plan;
pub mod recipe;
#[cfg(feature = "vulkan")]
pub mod vulkan;
