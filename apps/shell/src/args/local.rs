//! Options of the matrix round the camera.

use super::definition::RESEARCH;
use clap::Args;
use patchlight::method::LocalSettings;
use patchlight::method::local::display_white;

/// Options of the local matrix.
#[derive(Args, Clone, Copy, Debug, PartialEq)]
pub struct LocalArgs {
    /// Patches in the matrix round the camera (local).
    ///
    /// Merged patches count as one; the matrix takes 16 bytes for each pair.
    #[arg(
        long,
        value_name = "N",
        default_value_t = LocalSettings::DEFAULT.slots as u32,
        value_parser = clap::value_parser!(u32).range(4..=localmatrix::MAX_SLOTS as i64),
        help_heading = "Method"
    )]
    pub slots: u32,
    /// Greatest number of patches that enter or leave in a frame (local).
    #[arg(
        long,
        default_value_t = LocalSettings::DEFAULT.budget as u32,
        value_parser = clap::value_parser!(u32).range(1..=65_535),
        help_heading = RESEARCH
    )]
    pub budget: u32,
    /// Frames for which the camera's path is predicted (local).
    #[arg(
        long,
        default_value_t = LocalSettings::DEFAULT.predicted_frames,
        value_parser = parse_frames,
        help_heading = RESEARCH
    )]
    pub look_ahead: f32,
    /// Frames over which changes of the matrix come into the light, more where displayed values
    /// would change by more than two 255ths a frame; 1 for at once (local).
    #[arg(
        long,
        default_value_t = LocalSettings::DEFAULT.fade,
        value_parser = clap::value_parser!(u32).range(1..=1000),
        help_heading = RESEARCH
    )]
    pub fade: u32,
    /// Make all changes that suit the camera in each frame, wait for the disk, and let nothing
    /// fade: pictures as of a camera at rest, to compare those of a moving one with. --budget,
    /// --look-ahead and --fade make no difference then (local).
    #[arg(long, help_heading = RESEARCH)]
    pub at_rest: bool,
}

impl LocalArgs {
    /// The settings, for pictures that are exposed so.
    pub fn options(&self, exposure_stops: f32) -> LocalSettings {
        let Self { slots, budget, at_rest, .. } = *self;
        let predicted_frames = if at_rest { 0.0 } else { self.look_ahead };
        let fade = if at_rest { 1 } else { self.fade };
        let display_white = if fade == 1 { f32::INFINITY } else { display_white(exposure_stops) };
        LocalSettings { slots: slots as usize, budget: budget as usize, predicted_frames, fade, display_white, at_rest }
    }
}

fn parse_frames(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(frames) if (0.0..=1000.0).contains(&frames) => Ok(frames),
        _ => Err(format!("`{text}` is no number from 0 to 1000")),
    }
}
