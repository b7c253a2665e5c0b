//! Options of bakes, which `bake` and `render` share.

use clap::Args;

use assets::import::{Animation, LoadedScene};
use experiments::args::{VariantChoice, parse_epsilon, parse_metres};
use patchlight::method::FeedbackSettings;
use patchlight::operator::Codec;
use patchlight::{BakeSettings, Estimator, ReceiverKind};

use super::{Bounces, FormFactors, PatchOptions, ReceiverPlaces, Storage, parse_bounces, parse_bytes};

/// Relative error of compressed operators unless another one is asked for.
const EPSILON: f64 = 0.01;

/// What a bake is made with.
#[derive(Args, Clone, Copy, Debug, PartialEq)]
pub struct BakeOptions {
    #[command(flatten)]
    pub patches: PatchOptions,
    /// Bounces: a number, or all.
    #[arg(long, default_value = "all", value_parser = parse_bounces)]
    pub bounces: Bounces,
    /// Where irradiance is gathered.
    #[arg(long, value_enum, default_value_t = ReceiverPlaces::Mesh)]
    pub receivers: ReceiverPlaces,
    /// Distance between receivers where light is even, m [default: a third of the patches' mean
    /// edge]. Receivers are the points at which indirect light is gathered.
    #[arg(long, value_name = "METRES", value_parser = parse_metres)]
    pub receiver_edge: Option<f32>,
    /// Most receivers; where light bends they stand closer [default: ten thirds of as many as that
    /// distance gives].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=4_000_000))]
    pub most_receivers: Option<u32>,
    /// Which form of the equations voxel and axis patches, their form factors, first exitance and light at points have. With
    /// thesis, form factors are those of points and the patches receive.
    #[arg(long, value_enum, default_value_t)]
    pub variant: VariantChoice,
    /// Estimator of the form factors.
    #[arg(long, value_enum, default_value_t = FormFactors::Hemisphere)]
    pub form_factors: FormFactors,
    /// Rays a row of the form factors (hemisphere).
    #[arg(long, default_value_t = 4096, value_parser = clap::value_parser!(u32).range(16..=1_048_576))]
    pub rays: u32,
    /// Rays from each receiver.
    #[arg(long, default_value_t = BakeSettings::default().receiver_rays, value_parser = clap::value_parser!(u32).range(16..=1_048_576))]
    pub receiver_rays: u32,
}

impl BakeOptions {
    /// The settings of a bake of a scene with a camera that may move.
    pub fn settings(
        &self,
        loaded: &LoadedScene,
        animation: &Animation,
        memory_limit: Option<u64>,
        seed: u32,
    ) -> BakeSettings {
        BakeSettings {
            patches: self.patches.kind(self.form_factors),
            focus: self.patches.focus.unwrap_or_default().focus(loaded, animation),
            patch_count: self.patches.count(),
            voxel_size: self.patches.voxel_size,
            variant: self.variant.variant(),
            estimator: match self.form_factors {
                _ if self.variant == VariantChoice::Thesis => Estimator::Point,
                FormFactors::Hemisphere => Estimator::Hemisphere { rays: self.rays },
                FormFactors::Contour => Estimator::Contour,
                FormFactors::Area => Estimator::Area,
                FormFactors::Point => Estimator::Point,
            },
            bounces: match self.bounces {
                Bounces::All => None,
                Bounces::Count(k) => Some(k),
            },
            receivers: match self.receivers {
                _ if self.variant == VariantChoice::Thesis => ReceiverKind::Patches,
                ReceiverPlaces::Mesh => ReceiverKind::Mesh,
                ReceiverPlaces::Pixels => ReceiverKind::Pixels,
                ReceiverPlaces::Patches => ReceiverKind::Patches,
            },
            receiver_edge: self.receiver_edge,
            most_receivers: self.most_receivers.map(|most| most as usize),
            receiver_rays: self.receiver_rays,
            memory_limit,
            seed,
            ..BakeSettings::default()
        }
    }
}

/// What operators are made, and in how much memory.
#[derive(Args, Clone, Copy, Debug, PartialEq)]
pub struct OperatorSettings {
    /// Most resident memory: bytes, or with K, M or G. What would take more is refused before it is begun; tiles of a larger
    /// operator are built panel by panel in a file beside the results [default: what is free].
    #[arg(long, value_parser = parse_bytes)]
    pub memory_limit: Option<u64>,
    /// How the operator is stored (multibounce) [default: tiles; of a bake: as it is there].
    #[arg(long, value_enum)]
    pub codec: Option<Storage>,
    /// Relative error of the compressed operator (tiles, feedback), in the sense of Frobenius [default: 0.01; of a bake: as it is
    /// there].
    #[arg(long, value_parser = parse_epsilon)]
    pub epsilon: Option<f64>,
}

impl OperatorSettings {
    /// The relative error of compressed operators.
    pub fn error(&self) -> f64 {
        self.epsilon.unwrap_or(EPSILON)
    }

    /// How the operator of --method multibounce is stored.
    pub fn storage(&self) -> Codec {
        self.codec.unwrap_or_default().codec(self.error())
    }

    /// That of --method tiles.
    pub fn tiles(&self) -> Codec {
        Codec::LowRank { epsilon: self.error() }
    }

    /// Feedback with so many products a frame, accelerated or not.
    pub fn feedback(&self, products: u32, accelerated: bool) -> FeedbackSettings {
        FeedbackSettings { epsilon: self.error(), products, accelerated }
    }
}
