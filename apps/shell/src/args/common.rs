//! Options of every command, and values that options of several commands share.

use std::path::PathBuf;

use assets::{Animation, LoadedScene};
use clap::{Args, ValueEnum};
use glam::Vec3;
use patches::{Focus, PatchKind};
use runtime::executor::DeviceChoice;

use crate::error::Error;

/// Options of every command.
#[derive(Args, Debug, Clone)]
pub struct Common {
    /// auto, cpu, vulkan, a device's index or part of its name.
    #[arg(long, global = true, default_value = "auto", help_heading = "Device")]
    pub device: String,
    /// Threads of the CPU; 0 takes one a core.
    #[arg(long, global = true, default_value_t = 0, value_parser = parse_threads, help_heading = "Device")]
    pub threads: usize,
    /// Changes every random number; the same seed, the same bytes.
    #[arg(long, global = true, default_value_t = 0)]
    pub seed: u32,
    /// Folder for results (demo: out; render: out/SCENE-METHOD).
    #[arg(long, short, global = true)]
    pub out: Option<PathBuf>,
    /// No progress bars, no notes; warnings and errors remain.
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Print the summary as JSON on standard output.
    #[arg(long, global = true)]
    pub json: bool,
}

impl Common {
    /// Refuses a device where only native code works, in place of ignoring it.
    ///
    /// # Errors
    /// [`Error::NoDevice`] unless the device is left to the program, or native code.
    pub fn native_only(&self, command: &'static str) -> Result<(), Error> {
        match DeviceChoice::parse(&self.device) {
            DeviceChoice::Auto | DeviceChoice::Cpu => Ok(()),
            _ => Err(Error::NoDevice { command, device: self.device.clone() }),
        }
    }
}

/// Light motion.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Animate {
    /// Along the scene's own path, or a made-up one; the camera too.
    #[default]
    Path,
    /// Only suns move, the camera rests.
    Sun,
    /// They jump at a third of the frames, and back at two thirds; the camera rests.
    Jump,
    /// Nothing moves.
    Still,
}

/// Kinds of patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Patches {
    /// Triangles cut into like parts.
    Polygon,
    /// Samples of the surface gathered by what they see: any mesh in as many patches as wanted.
    Cluster,
    /// Samples of each voxel gathered where position and normal are alike.
    Voxel,
    /// Samples of each voxel shared out over the six directions of the axes.
    Axis,
}

impl Patches {
    /// Their kind.
    pub fn kind(self) -> PatchKind {
        match self {
            Self::Polygon => PatchKind::Polygon,
            Self::Cluster => PatchKind::Cluster,
            Self::Voxel => PatchKind::Voxel,
            Self::Axis => PatchKind::Axis,
        }
    }
}

/// Times at which a camera that moves is asked where it is.
const EYES: u16 = 9;

/// Viewing area.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum FocusChoice {
    /// In enclosed space.
    #[default]
    Auto,
    /// The room about the camera.
    Camera,
    /// In a box.
    Box {
        /// Least coordinates, m.
        low: Vec3,
        /// Greatest coordinates, m.
        high: Vec3,
    },
}

impl FocusChoice {
    /// The focus in a scene with a camera that may move.
    pub fn focus(self, loaded: &LoadedScene, animation: &Animation) -> Focus {
        match self {
            Self::Auto => Focus::Auto,
            Self::Box { low, high } => Focus::Box { low, high },
            Self::Camera => {
                let time = |k: u16| animation.duration() * f32::from(k) / f32::from(EYES - 1);
                let mut eyes: Vec<Vec3> = (0..EYES).map(|k| animation.at(time(k)).1.eye).collect();
                eyes.dedup();
                Focus::seen_from(&loaded.scene, &eyes)
            }
        }
    }
}

/// A focus: auto, camera, or the least and the greatest coordinates of a box.
///
/// # Errors
/// Text that is none.
pub fn parse_focus(text: &str) -> Result<FocusChoice, String> {
    match text {
        "auto" => return Ok(FocusChoice::Auto),
        "camera" => return Ok(FocusChoice::Camera),
        _ => {}
    }
    let wrong = || {
        format!("`{text}` is no focus; write auto, camera, or a box as X,Y,Z,X,Y,Z: its least and greatest corner, m")
    };
    let numbers: Result<Vec<f32>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    let [a, b, c, d, e, f] = numbers.map_err(|_| wrong())?[..] else { return Err(wrong()) };
    let low = Vec3::new(a, b, c);
    let high = Vec3::new(d, e, f);
    let is_box = low.is_finite() && high.is_finite() && low.cmple(high).all();
    if is_box { Ok(FocusChoice::Box { low, high }) } else { Err(wrong()) }
}

/// Threads that may be asked for on any machine, and for each of its cores: more only wait for each other.
const MAX_THREADS: usize = 64;
const THREADS_A_CORE: usize = 4;

fn parse_threads(text: &str) -> Result<usize, String> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let most = MAX_THREADS.max(THREADS_A_CORE * cores);
    match text.parse() {
        Ok(threads) if threads <= most => Ok(threads),
        _ => Err(format!("`{text}` is no number from 0 to {most} (this machine has {cores} cores)")),
    }
}

/// A length in metres.
///
/// # Errors
/// Text that is none.
pub fn parse_metres(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(metres) if metres > 0.0 && f32::is_finite(metres) => Ok(metres),
        _ => Err(format!("`{text}` is no length in metres: a number above 0")),
    }
}

/// A relative error of a compressed operator.
///
/// # Errors
/// Text that is none.
pub fn parse_epsilon(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(epsilon) if (1e-6..1.0).contains(&epsilon) => Ok(epsilon),
        _ => Err(format!("`{text}` is no number of at least 0.000001 and below 1")),
    }
}

/// A relative error of photons.
///
/// # Errors
/// Text that is none.
pub fn parse_error(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(error) if (1e-4..=1.0).contains(&error) => Ok(error),
        _ => Err(format!("`{text}` is no number from 0.0001 to 1")),
    }
}

/// A density of receivers, or a distance between probes.
///
/// # Errors
/// Text that is none.
pub fn parse_density(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(density) if (0.01..=100.0).contains(&density) => Ok(density),
        _ => Err(format!("`{text}` is no number from 0.01 to 100")),
    }
}

/// A picture size, `960x540`.
///
/// # Errors
/// Text that is none.
pub fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let wrong = || format!("`{text}` is no size; write WIDTHxHEIGHT, for example 960x540");
    let (width, height) = text.split_once('x').ok_or_else(wrong)?;
    let width = width.parse().map_err(|_| wrong())?;
    let height = height.parse().map_err(|_| wrong())?;
    if !(1..=16_384).contains(&width) || !(1..=16_384).contains(&height) {
        return Err(format!("`{text}`: each side must be from 1 to 16384 pixels"));
    }
    Ok((width, height))
}

/// Motion of the camera.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraPath {
    /// Along the scene, from one end to the other.
    Fly,
    /// To and fro along the scene's middle, twice.
    Shuttle,
    /// Round the scene's middle.
    Circle,
}

impl CameraPath {
    /// The camera over one second.
    pub fn animation(self, loaded: &LoadedScene) -> Animation {
        match self {
            Self::Fly => Animation::fly(loaded),
            Self::Shuttle => Animation::shuttle(loaded),
            Self::Circle => Animation::circle(loaded),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!(parse_size("960x540"), Ok((960, 540)));
        for wrong in ["", "960", "960x", "x540", "0x10", "-5x10", "20000x10", "1e9x2"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_focus_is_auto_camera_or_a_box() {
        assert_eq!(parse_focus("auto"), Ok(FocusChoice::Auto));
        assert_eq!(parse_focus("camera"), Ok(FocusChoice::Camera));
        let low = Vec3::new(-1.0, 0.0, 2.5);
        let high = Vec3::new(3.0, 0.0, 4.0);
        assert_eq!(parse_focus("-1, 0,2.5,3,0,4"), Ok(FocusChoice::Box { low, high }));
        for wrong in ["", "here", "1,2,3", "0,0,0,1,1,1,1", "0,0,0,1,-1,1", "0,0,0,1,inf,1", "0,0,NaN,1,1,1"] {
            let message = parse_focus(wrong).unwrap_err();
            assert!(message.contains("X,Y,Z,X,Y,Z") && message.contains(wrong), "{wrong}: {message}");
        }
    }
}
