//! Diffuse global illumination by radiosity as a library.

pub mod bake;
pub mod error;
pub mod memory;
pub mod progress;
pub mod render;

pub use error::Error;
