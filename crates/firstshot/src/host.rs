//! The host side: what photons start from, tracing and accumulation on all cores.

mod alias;
mod emission;
mod light_elements;
mod maps;
mod sums;
mod trace;
mod tracer;

pub use alias::alias_table;
pub use emission::{Emission, Texels};
pub use light_elements::{
    CornerLight, LightElement, LightElementSettings, LightElements, Subdivision, TraceRays, corner_light,
    light_elements, light_elements_by,
};
pub use maps::IlluminationMaps;
pub use sums::{Sums, flux_words, group_areas, register_photons, relative_error, tally_words};
pub use trace::{PhotonScene, trace_photons};
pub use tracer::{Cubic, Estimate, MAX_ROUND, PhotonAccumulator, PhotonSettings, Round, Sequences, Tracer};
pub use transport::Proceed;
