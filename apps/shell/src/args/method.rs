//! Methods and the options of single ones.

use clap::{Args, ValueEnum};
use patchlight::method::firstshot::{Cubic, Sequences, StartLight, Subdivision, Texels};
use patchlight::method::{FeedbackSettings, FirstShotSettings};

use super::common::parse_error;
use super::definition::RESEARCH;
use super::operator::OperatorSettings;

/// Method for indirect light.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Classic radiosity: patches of any kind, one product a bounce.
    Classic,
    /// All bounces in one product with an operator that is stored as --codec says.
    Multibounce,
    /// Short for --method multibounce --codec low_rank.
    #[value(name = "low_rank", alias = "tiles")]
    LowRank,
    /// One product a frame with compressed form factors, from the light of the frame before.
    Feedback,
    /// A few samples a row and frame, from the light of the frame before: --samples, --blend, --control-variate.
    Temporal,
    /// All bounces in one product, with the matrix of the patches round the camera: --slots, --budget, --look-ahead,
    /// --fade.
    Local,
    /// Photons that start where lights fall first, until the error is what --error says.
    Firstshot,
    /// Path tracing on the CPU, the reference.
    Path,
}

impl Method {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Classic => "classic",
            Self::Multibounce => "multibounce",
            Self::LowRank => "low_rank",
            Self::Feedback => "feedback",
            Self::Temporal => "temporal",
            Self::Local => "local",
            Self::Firstshot => "firstshot",
            Self::Path => "path",
        }
    }
}

/// A method that a bake can serve.
///
/// # Errors
/// Text that names none; path tracing.
pub fn parse_purpose(text: &str) -> Result<Method, String> {
    match Method::from_str(text, true) {
        Ok(Method::Path) => Err("path tracing needs no bake".to_owned()),
        Ok(method) => Ok(method),
        Err(_) => {
            let names = Method::value_variants().iter().map(|method| method.name()).filter(|name| *name != "path");
            let names: Vec<&str> = names.collect();
            Err(format!("`{text}` is no method; choose from {}", names.join(", ")))
        }
    }
}

/// Settings of feedback and firstshot.
#[derive(Args, Clone, Debug)]
pub struct MethodOptions {
    /// Bounces in a frame (feedback).
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = RESEARCH)]
    pub products: u32,
    /// Bounces are not accelerated by where the light was going (feedback): it settles in about
    /// twice as many.
    #[arg(long, help_heading = RESEARCH)]
    pub plain: bool,
    /// Relative error at which photons are enough (firstshot).
    ///
    /// It is that of the irradiance of the patches; among mirrors and glass and in a medium that of the elements, which
    /// are smaller. With 0 all of `--photons` are traced, and no frame waits to hear of the error.
    #[arg(
        long,
        value_name = "E",
        default_value_t = FirstShotSettings::default().error,
        value_parser = parse_goal,
        help_heading = "Method"
    )]
    pub error: f64,
    /// Most photons (firstshot).
    #[arg(
        long,
        value_name = "N",
        default_value_t = FirstShotSettings::default().most_photons,
        value_parser = clap::value_parser!(u64).range(1..=1 << 33),
        help_heading = "Method"
    )]
    pub photons: u64,
    /// Subdivision of triangles by the light on them (firstshot): across the edges on which it bends, or as Kopylov's
    /// algorithm 1.
    #[arg(long, value_enum, default_value_t, help_heading = RESEARCH)]
    pub subdivision: SubdivisionChoice,
    /// Reflectance of textured triangles in the choice of a start (firstshot): the mean texel, or the brightest, where
    /// photons of darker ones are rejected.
    #[arg(long, value_enum, default_value_t, help_heading = RESEARCH)]
    pub texels: TexelChoice,
    /// Source of the light at a start (firstshot): a shadow ray, or the table of the lit triangles alone, as Kopylov
    /// has it.
    #[arg(long, value_enum, default_value_t, help_heading = RESEARCH)]
    pub start_light: StartLightChoice,
    /// Solver of a start's cubic equation (firstshot): Newton's method, or Cardano's formula.
    #[arg(long, value_enum, default_value_t, help_heading = RESEARCH)]
    pub cubic: CubicChoice,
    /// Numbers that photons are made of (firstshot): Sobol's points, or random ones.
    #[arg(long, value_enum, default_value_t, help_heading = RESEARCH)]
    pub sequence: SequenceChoice,
}

/// Subdivision of triangles by the light on them.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SubdivisionChoice {
    /// Across the edges on which light bends.
    #[default]
    Edges,
    /// As Kopylov's algorithm 1.
    Kopylov,
}

/// Reflectance of textured triangles.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TexelChoice {
    /// The mean texel.
    #[default]
    Mean,
    /// The brightest texel.
    Brightest,
}

/// Source of the light at a start.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StartLightChoice {
    /// A shadow ray.
    #[default]
    Traced,
    /// The table of the lit triangles.
    Table,
}

/// Solver of a start's cubic equation.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CubicChoice {
    /// Newton's method.
    #[default]
    Newton,
    /// Cardano's formula.
    Cardano,
}

/// Numbers that photons are made of.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SequenceChoice {
    /// Sobol's points, scrambled: quasi-random.
    #[default]
    Sobol,
    /// Independent pseudo-random numbers.
    Random,
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
        FirstShotSettings {
            error: self.error,
            most_photons: self.photons,
            subdivision: match self.subdivision {
                SubdivisionChoice::Edges => Subdivision::Edges,
                SubdivisionChoice::Kopylov => Subdivision::Kopylov,
            },
            texels: match self.texels {
                TexelChoice::Mean => Texels::Mean,
                TexelChoice::Brightest => Texels::Bound,
            },
            start_light: match self.start_light {
                StartLightChoice::Traced => StartLight::Traced,
                StartLightChoice::Table => StartLight::Table,
            },
            cubic: match self.cubic {
                CubicChoice::Newton => Cubic::Newton,
                CubicChoice::Cardano => Cubic::Cardano,
            },
            sequences: match self.sequence {
                SequenceChoice::Sobol => Sequences::Sobol,
                SequenceChoice::Random => Sequences::Random,
            },
        }
    }
}
