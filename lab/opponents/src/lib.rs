//! Opponents of Patchlight beside path tracing.
//!
//! - `Ddgi`, probes with irradiance and visibility, by a few rays of each in every frame (Majercik et al. 2019, 2021);
//! - `Lpv`, light that goes from cell to cell of a grid (Kaplanyan and Dachsbacher 2010);
//! - `IrradianceVolume`, probes as engines bake them;
//! - `denoise`, what makes a picture of a path a pixel fit to be seen (Dammertz et al. 2010);
//! - `VoxelProxy`, a scene of the faces of its occupied voxels, and the face that lights a point of the true surface.
//!
//! Units: metres, radiance W/m²/sr, irradiance W/m², linear Rec.709 RGB.

pub mod ddgi;
pub mod denoise;
mod harmonics;
pub mod irradiance_volume;
pub mod lpv;
pub mod voxel_proxy;

pub use ddgi::{Ddgi, DdgiSettings, ProbeFrame, Spacing, ViewedPoint};
pub use irradiance_volume::{IrradianceVolume, VolumeSettings};
pub use lpv::{Lpv, LpvSettings};
pub use voxel_proxy::{ProxyFace, ProxyLookup, VoxelProxy};
