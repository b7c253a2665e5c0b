//! See README.md.

pub mod accumulation;
pub mod data;
pub mod error;
pub mod file;
pub mod metrics;
pub mod path;
pub mod picture;
mod sampler;
mod sky;

pub use accumulation::{Accumulation, BlockErrors, fingerprint};
pub use data::{ReferenceData, ReferencePoint};
pub use error::{Error, ResumeError};
pub use metrics::{PictureErrors, PointErrors};
pub use path::{PathSettings, PathTracer, PointIrradiance, Strategy};
pub use picture::{Picture, Precision, stops_to_scale};
