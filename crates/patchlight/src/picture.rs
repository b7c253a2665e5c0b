//! Pictures and their parts.

pub use scene::Picture;

/// A picture and its parts, radiance in W/m²/sr: `full = direct + indirect`, split at the visible surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Pictures {
    /// Everything.
    pub full: Picture,
    /// Lights and sky seen directly, and light that came straight from a light.
    pub direct: Picture,
    /// Light that was reflected before it reached the visible surface.
    pub indirect: Picture,
}
