//! Options of sampled light.

use super::definition::RESEARCH;
use clap::{Args, ValueEnum};
use patchlight::method::TemporalSettings;
use patchlight::method::temporal::{RowKind, Sampled};
use temporal::{Blend, MAX_SAMPLES, Settings};

/// Settings of frames of --method temporal.
#[derive(Args, Clone, Copy, Debug, PartialEq)]
pub struct TemporalOptions {
    /// Samples a row and frame (temporal).
    #[arg(
        long,
        value_name = "N",
        default_value_t = Settings::default().samples,
        value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SAMPLES)),
        help_heading = "Method"
    )]
    pub samples: u32,
    /// Weight of the frames before, from 0 to below 1, or auto: from the noise of the samples and the change of the
    /// light (temporal without control variate).
    #[arg(long, default_value = "auto", value_parser = parse_blend, help_heading = RESEARCH)]
    pub blend: Blend,
    /// Samples only changes, so that light at rest has no noise (temporal).
    #[arg(long, value_enum, default_value_t = Switch::On, help_heading = RESEARCH)]
    pub control_variate: Switch,
    /// Frames in which each row is once summed exactly (temporal with control variate); 0 for never.
    #[arg(
        long,
        default_value_t = Settings::default().refresh,
        value_parser = clap::value_parser!(u32).range(0..=1_000_000),
        help_heading = RESEARCH
    )]
    pub refresh: u32,
    /// Takes samples from a lattice, rotated by chance, or independently (temporal).
    #[arg(long, value_enum, default_value_t = Switch::On, help_heading = RESEARCH)]
    pub rotated: Switch,
    /// Storage of rows between patches (temporal).
    #[arg(long, value_enum, default_value_t = RowStorage::Lists, help_heading = RESEARCH)]
    pub rows: RowStorage,
    /// Which rows are sampled (temporal); the others are multiplied by.
    #[arg(long, value_enum, default_value_t = SampledRows::Patches, help_heading = RESEARCH)]
    pub sampled: SampledRows,
}

/// On or off.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Switch {
    /// Yes.
    On,
    /// No.
    Off,
}

/// Storage of rows for sampling.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowStorage {
    /// Lists of columns, all entries alike.
    Lists,
    /// Alias tables.
    Tables,
    /// Alias tables of all bounces in three channels: every bounce lags alike; for few patches, and albedo that stays.
    AllBounces,
}

/// Which rows are sampled.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampledRows {
    /// From patch to patch.
    Patches,
    /// Those to elements and to receivers, too.
    All,
}

impl TemporalOptions {
    /// The settings of the method.
    pub fn settings(&self, seed: u32) -> TemporalSettings {
        let settings = Settings {
            samples: self.samples,
            blend: self.blend,
            control_variate: self.control_variate == Switch::On,
            rotated: self.rotated == Switch::On,
            refresh: self.refresh,
            seed,
        };
        let rows = match self.rows {
            RowStorage::Lists => RowKind::Lists,
            RowStorage::Tables => RowKind::Tables,
            RowStorage::AllBounces => RowKind::AllBounces,
        };
        let sampled = match self.sampled {
            SampledRows::Patches => Sampled::Patches,
            SampledRows::All => Sampled::All,
        };
        TemporalSettings { settings, rows, sampled }
    }
}

fn parse_blend(text: &str) -> Result<Blend, String> {
    match text.parse() {
        _ if text == "auto" => Ok(Settings::default().blend),
        Ok(w) if (0.0..1.0).contains(&w) => Ok(Blend::Fixed(w)),
        _ => Err(format!("`{text}` is neither `auto` nor a number of at least 0 and below 1")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blends() {
        assert_eq!(parse_blend("0.9"), Ok(Blend::Fixed(0.9)));
        assert!(matches!(parse_blend("auto"), Ok(Blend::Auto { .. })));
        for wrong in ["1", "-0.1", "NaN", "often", ""] {
            assert!(parse_blend(wrong).is_err(), "{wrong}");
        }
    }
}
