//! Options of patches, receivers and form factors.

use clap::{Args, ValueEnum};
use patches::PatchKind;

use super::common::{FocusChoice, Patches, parse_focus, parse_metres};
use super::definition::RESEARCH;

/// Kind and number of patches.
#[derive(Args, Clone, Copy, Debug, PartialEq)]
pub struct PatchOptions {
    /// Kind: polygon, cluster, voxel or axis [default: cluster].
    ///
    /// Where form factors are not by rays the default is polygon.
    #[arg(long, value_enum, hide_possible_values = true, help_heading = "Bake")]
    pub patches: Option<Patches>,
    /// Patches, about [default: 4000].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65_535), help_heading = "Bake")]
    pub patch_count: Option<u32>,
    /// Edge of the voxels of voxel and axis patches, m; replaces --patch-count.
    #[arg(long, value_name = "METRES", value_parser = parse_metres, help_heading = RESEARCH)]
    pub voxel_size: Option<f32>,
    /// Viewing area with small patches: auto, camera, or X,Y,Z,X,Y,Z (m).
    ///
    /// Enclosed space, what the camera sees round it, or a box. What is far from there gets few, large patches and few
    /// receivers [default: auto].
    #[arg(long, value_name = "WHERE", allow_hyphen_values = true, value_parser = parse_focus, help_heading = "Bake")]
    pub focus: Option<FocusChoice>,
}

impl PatchOptions {
    /// Number of patches.
    pub fn count(&self) -> usize {
        self.patch_count.unwrap_or(4000) as usize
    }

    /// Kind of patches for an estimator of form factors: all but rays need outlines.
    pub fn kind(&self, form_factors: FormFactors) -> PatchKind {
        match (self.patches, form_factors) {
            (Some(patches), _) => patches.kind(),
            (None, FormFactors::Hemisphere) => PatchKind::Cluster,
            (None, FormFactors::Contour | FormFactors::Area | FormFactors::Point) => PatchKind::Polygon,
        }
    }

    /// Returns true if any of them was given.
    pub fn is_given(&self) -> bool {
        self.patches.is_some() || self.patch_count.is_some() || self.voxel_size.is_some() || self.focus.is_some()
    }
}

/// Points where irradiance is gathered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ReceiverPlaces {
    /// Points of the surface, close where light bends; pixels take the mean of those about.
    Mesh,
    /// Every visible point, with nothing in between: slow, for measuring (try --receiver-rays 64 --spp 1).
    Pixels,
    /// The voxel or axis patches themselves; pixels take the mean of those about.
    #[value(name = "self")]
    Patches,
}

/// Estimator of the form factors.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum FormFactors {
    /// Cosine-weighted rays.
    Hemisphere,
    /// Lambert's contour formula with shadow rays: exact where nothing hides.
    Contour,
    /// Pairs of points on both patches.
    Area,
    /// One point a patch.
    Point,
}
