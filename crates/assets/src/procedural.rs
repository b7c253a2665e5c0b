//! Built-in scenes that need no file, in metres: no two faces in one place, no cracks, fronts to the air.
//!
//! | name | what |
//! |---|---|
//! | `cornell` | the Cornell Box by its published measurements, 0.55 m, lamp as a rectangle light |
//! | `atrium` | a court with two storeys of arcades, cloth and an open roof; `atrium:N` has about N triangles |
//! | `city` | streets, and houses furnished in every room, in the low sun; `city:N` has N triangles |
//! | `office` | two offices and a corridor with rectangle lights and luminous panels |
//! | `sealed-box` | a closed box in the sun, seen from inside: dark |
//! | `furnace` | a closed box that shines from everywhere: H = M/(1 − ρ) |

use std::path::Path;

use glam::{Vec3, Vec4};
use scene::{Light, Sky};

use crate::import::draft::{Mesh, Setting, finish};
use crate::import::{Animation, ImportError, LoadOptions, LoadedScene, Track, View};

mod atrium;
mod boxes;
mod builder;
mod city;
mod cornell;
mod office;
mod pattern;

pub use atrium::{LEAST_TRIANGLES, MOST_TRIANGLES};

/// Names of the built-in scenes.
pub const NAMES: [&str; 6] = ["cornell", "atrium", "city", "office", "sealed-box", "furnace"];

/// Triangles of `atrium` when no count is given.
const ATRIUM_TRIANGLES: usize = 3000;
/// The same of `city`.
const CITY_TRIANGLES: usize = 1_000_000;

/// What a built-in scene consists of.
struct Built {
    mesh: Mesh,
    lights: Vec<Light>,
    sky: Vec3,
    view: View,
    exposure_stops: f32,
    /// What moves.
    tracks: Vec<Track>,
}

/// Whether `spec` (NAME or NAME:TRIANGLES) names a built-in scene.
pub fn is_built_in(spec: &str) -> bool {
    NAMES.contains(&spec.split(':').next().unwrap_or_default())
}

/// Builds a scene from NAME or NAME:TRIANGLES (`atrium` and `city` only).
///
/// # Errors
/// [`ImportError::Procedural`] for a name or a count that is not known.
pub fn build(spec: &str) -> Result<LoadedScene, ImportError> {
    let fault = |reason: String| ImportError::Procedural { spec: spec.to_owned(), reason };
    let (name, count) = match spec.split_once(':') {
        Some((name, count)) => (name, Some(count)),
        None => (spec, None),
    };
    if !NAMES.contains(&name) {
        return Err(fault(format!("is not known; give one of {}", NAMES.join(", "))));
    }
    let range = match name {
        "city" => city::LEAST_TRIANGLES..=city::MOST_TRIANGLES,
        _ => LEAST_TRIANGLES..=MOST_TRIANGLES,
    };
    let triangles = match count {
        None if name == "city" => CITY_TRIANGLES,
        None => ATRIUM_TRIANGLES,
        Some(_) if name != "atrium" && name != "city" => {
            return Err(fault(format!("{name} has a fixed number of triangles; write just {name}")));
        }
        Some(count) => count.parse::<usize>().ok().filter(|n| range.contains(n)).ok_or_else(|| {
            let (least, most) = (range.start(), range.end());
            fault(format!("\"{count}\" is not a number of triangles; give {least} to {most}"))
        })?,
    };
    let built = match name {
        "cornell" => cornell::build(),
        "atrium" => atrium::build(triangles),
        "city" => city::build(triangles),
        "office" => office::build(),
        "sealed-box" => boxes::sealed(),
        _ => Ok(boxes::furnace()),
    }
    .map_err(|(key, reason)| fault(format!("{key}: {reason}")))?;
    let setting = Setting {
        exposure_stops: built.exposure_stops,
        view: Some(built.view),
        lights: built.lights,
        sky: Sky { radiance: built.sky, ..Sky::default() },
        sky_map: Vec::<Vec4>::new(),
        animation: Animation { tracks: built.tracks, ..Animation::default() },
        ..Setting::new(Path::new(spec), name)
    };
    finish(built.mesh, setting, &LoadOptions::default())
}

/// Millimetres into metres.
fn metres(mm: [f32; 3]) -> Vec3 {
    Vec3::from(mm) * 0.001
}
