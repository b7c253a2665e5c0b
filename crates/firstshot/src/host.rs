//! The host side: what photons start from, tracing and accumulation on all cores.

mod alias;
mod emission;
mod light_elements;
mod maps;
mod trace;
mod tracer;

pub use alias::alias_table;
pub use emission::{Emission, Texels};
pub use light_elements::{LightElement, LightElementSettings, light_elements};
pub use maps::IlluminationMaps;
pub use trace::trace_photons;
pub use tracer::{Estimate, PhotonAccumulator, PhotonSettings, Round, Sequences, Tracer};
pub use transport::Proceed;
