//! Which form of an equation is computed.

/// Which form of the equations is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Variant {
    /// Ours: without what loses light, makes light or depends on the unit of length.
    #[default]
    Corrected,
    /// As A. S. Shcherbakov's thesis prints them, for comparison.
    Thesis,
}

impl Variant {
    /// Its name in settings and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Corrected => "corrected",
            Self::Thesis => "thesis",
        }
    }
}
