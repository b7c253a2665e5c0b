//! Options of single methods.

use clap::Args;
use patchlight::method::{FeedbackSettings, FirstShotSettings};

use super::OperatorSettings;
use experiments::args::parse_error;

/// What feedback and firstshot are made with.
#[derive(Args, Clone, Debug)]
pub struct MethodOptions {
    /// Bounces in a frame (feedback).
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub products: u32,
    /// Bounces are not accelerated by where the light was going (feedback): it settles in about
    /// twice as many.
    #[arg(long)]
    pub plain: bool,
    /// Relative error of the patches' irradiance at which photons are enough (firstshot). With 0 all
    /// of `--photons` are traced, and no frame waits to hear of the error.
    #[arg(long, default_value_t = FirstShotSettings::default().error, value_parser = parse_goal)]
    pub error: f64,
    /// Most photons (firstshot).
    #[arg(long, default_value_t = FirstShotSettings::default().most_photons, value_parser = clap::value_parser!(u64).range(1..=1 << 33))]
    pub photons: u64,
}

/// An error that is asked for, or 0.
fn parse_goal(text: &str) -> Result<f64, String> {
    if text.parse() == Ok(0.0) { Ok(0.0) } else { parse_error(text).map_err(|error| format!("{error}, nor 0")) }
}

impl MethodOptions {
    /// Feedback with form factors of the error of the operators.
    pub fn feedback(&self, operators: &OperatorSettings) -> FeedbackSettings {
        operators.feedback(self.products, !self.plain)
    }

    /// Photons.
    pub fn first_shot(&self) -> FirstShotSettings {
        FirstShotSettings { error: self.error, most_photons: self.photons }
    }
}
