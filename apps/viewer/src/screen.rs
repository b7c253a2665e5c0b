//! The window as Vulkan sees it: a device with a swapchain, pictures that are copied into it, panels over them.
//!
//! The one place of the viewer with unsafe code. `gpu` makes instance and device, `swapchain` the images of the window,
//! `picture` the images that are shown, `draw` records and submits a frame.
#![allow(unsafe_code)]

mod draw;
mod gpu;
mod picture;
mod swapchain;

pub use draw::{Capture, Panels, Screen, Side, Source};
pub use gpu::Gpu;
