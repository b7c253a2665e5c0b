//! Options of bakes, of `bake`, `render` and the viewer.

use clap::Args;

use assets::import::{Animation, LoadedScene};
use patchlight::{BakeSettings, Estimator, ReceiverKind};

use super::common::parse_metres;
use super::definition::RESEARCH;
use super::patches::{FormFactors, PatchOptions, ReceiverPlaces};

/// Settings of a bake.
#[derive(Args, Clone, Copy, Debug, PartialEq)]
pub struct BakeOptions {
    /// Its patches.
    #[command(flatten)]
    pub patches: PatchOptions,
    /// Bounces: a number, or all.
    #[arg(long, value_name = "K", default_value = "all", value_parser = parse_bounces, help_heading = "Method")]
    pub bounces: Bounces,
    /// Points where irradiance is gathered.
    #[arg(long, value_enum, default_value_t = ReceiverPlaces::Mesh, help_heading = RESEARCH)]
    pub receivers: ReceiverPlaces,
    /// Distance between receivers where light is even, m.
    ///
    /// Receivers are the points at which indirect light is gathered [default: a third of the patches' mean edge].
    #[arg(long, value_name = "METRES", value_parser = parse_metres, help_heading = RESEARCH)]
    pub receiver_edge: Option<f32>,
    /// Most receivers; where light bends they stand closer.
    ///
    /// [default: ten thirds of as many as their distance gives]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4_000_000), help_heading = "Bake")]
    pub most_receivers: Option<u32>,
    /// Estimator of the form factors.
    #[arg(long, value_enum, default_value_t = FormFactors::Hemisphere, help_heading = RESEARCH)]
    pub form_factors: FormFactors,
    /// Rays a row of the form factors (hemisphere).
    #[arg(
        long,
        value_name = "N",
        default_value_t = 4096,
        value_parser = clap::value_parser!(u32).range(16..=1_048_576),
        help_heading = "Bake"
    )]
    pub rays: u32,
    /// Rays from each receiver.
    #[arg(
        long,
        value_name = "N",
        default_value_t = BakeSettings::default().receiver_rays,
        value_parser = clap::value_parser!(u32).range(16..=1_048_576),
        help_heading = "Bake"
    )]
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
        BakeSettings::default()
            .with_patches(self.patches.kind(self.form_factors))
            .with_focus(self.patches.focus.unwrap_or_default().focus(loaded, animation))
            .with_patch_count(self.patches.count())
            .with_voxel_size(self.patches.voxel_size)
            .with_estimator(match self.form_factors {
                FormFactors::Hemisphere => Estimator::Hemisphere { rays: self.rays },
                FormFactors::Contour => Estimator::Contour,
                FormFactors::Area => Estimator::Area,
                FormFactors::Point => Estimator::Point,
            })
            .with_bounces(match self.bounces {
                Bounces::All => None,
                Bounces::Count(k) => Some(k),
            })
            .with_receivers(match self.receivers {
                ReceiverPlaces::Mesh => ReceiverKind::Mesh,
                ReceiverPlaces::Pixels => ReceiverKind::Pixels,
                ReceiverPlaces::Patches => ReceiverKind::Patches,
            })
            .with_receiver_edge(self.receiver_edge)
            .with_most_receivers(self.most_receivers.map(|most| most as usize))
            .with_receiver_rays(self.receiver_rays)
            .with_memory_limit(memory_limit)
            .with_seed(seed)
    }
}

/// A number of bounces, or all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bounces {
    /// This many.
    Count(u32),
    /// Until nothing changes.
    All,
}

/// A number of bounces, or `all`.
///
/// # Errors
/// Text that is neither.
pub fn parse_bounces(text: &str) -> Result<Bounces, String> {
    if text == "all" {
        return Ok(Bounces::All);
    }
    match text.parse() {
        Ok(count) if (1..=1000).contains(&count) => Ok(Bounces::Count(count)),
        _ => Err(format!("`{text}` is neither `all` nor a number from 1 to 1000")),
    }
}

/// A number of bytes, with K, M or G.
///
/// # Errors
/// Text that is none.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let wrong = || format!("`{text}` is no number of bytes; write for example 2G or 800M");
    let (digits, shift) = match text.char_indices().last() {
        Some((at, 'K' | 'k')) => (&text[..at], 10),
        Some((at, 'M' | 'm')) => (&text[..at], 20),
        Some((at, 'G' | 'g')) => (&text[..at], 30),
        _ => (text, 0),
    };
    let number: f64 = digits.parse().map_err(|_| wrong())?;
    let bytes = number * f64::from(1u32 << shift);
    if bytes.is_finite() && (1.0..1e15).contains(&bytes) { Ok(bytes as u64) } else { Err(wrong()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes() {
        assert_eq!(parse_bytes("2G"), Ok(2 << 30));
        assert_eq!(parse_bytes("1.5m"), Ok(3 << 19));
        assert_eq!(parse_bytes("4096"), Ok(4096));
        for wrong in ["", "G", "-1", "2T", "nan", "inf", "0", "1e99"] {
            assert!(parse_bytes(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn bounces() {
        assert_eq!(parse_bounces("all"), Ok(Bounces::All));
        assert_eq!(parse_bounces("3"), Ok(Bounces::Count(3)));
        for wrong in ["0", "-1", "many", "1001"] {
            assert!(parse_bounces(wrong).is_err(), "{wrong}");
        }
    }
}
