//! The host side: what photons start from, tracing and registration on all cores.

mod alias;
mod emission;
mod maps;
mod pieces;
mod trace;
mod tracer;

pub use alias::alias_table;
pub use emission::{Emission, Texels};
pub use maps::IlluminationMaps;
pub use pieces::{Piece, PieceSettings, lit_pieces};
pub use trace::trace_photons;
pub use tracer::{Estimate, PhotonSettings, Registry, Round, Sequences, Tracer};
pub use transport::Proceed;
