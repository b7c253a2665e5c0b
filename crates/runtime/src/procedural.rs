//! Built-in scenes that need no file, in metres: no two faces in one place, no cracks, fronts to the air.
//!
//! | name | what |
//! |---|---|
//! | `cornell` | the Cornell Box by its published measurements, 0.55 m, lamp as a rectangle light |
//! | `atrium` | a court with two storeys of arcades, cloth and an open roof; `atrium:N` has about N triangles |
//! | `office` | two offices and a corridor with rectangle lights and luminous panels |
//! | `sealed-box` | a closed box in the sun, seen from inside: dark |
//! | `furnace` | a closed box that shines from everywhere: H = M/(1 − ρ) |

use std::path::Path;

use glam::{Vec3, Vec4};
use scene::{Light, Sky};

use crate::import::draft::{Mesh, Setting, finish};
use crate::import::{ImportError, LoadOptions, LoadedScene, View};

mod atrium;
mod boxes;
mod builder;
mod cornell;
mod office;
mod pattern;

pub use atrium::{LEAST_TRIANGLES, MOST_TRIANGLES};

/// Names of the built-in scenes.
pub const NAMES: [&str; 5] = ["cornell", "atrium", "office", "sealed-box", "furnace"];

/// Triangles of `atrium` when no count is given.
const ATRIUM_TRIANGLES: usize = 3000;

/// What a built-in scene consists of.
struct Built {
    mesh: Mesh,
    lights: Vec<Light>,
    sky: Vec3,
    view: View,
    exposure_stops: f32,
}

/// Whether `spec` (NAME or NAME:TRIANGLES) names a built-in scene.
pub fn is_built_in(spec: &str) -> bool {
    NAMES.contains(&spec.split(':').next().unwrap_or_default())
}

/// Builds a scene from NAME or NAME:TRIANGLES (`atrium` only).
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
    let range = LEAST_TRIANGLES..=MOST_TRIANGLES;
    let triangles = match count {
        None => ATRIUM_TRIANGLES,
        Some(_) if name != "atrium" => {
            return Err(fault(format!("{name} has a fixed number of triangles; write just {name}")));
        }
        Some(count) => count.parse::<usize>().ok().filter(|n| range.contains(n)).ok_or_else(|| {
            fault(format!("\"{count}\" is not a number of triangles; give {LEAST_TRIANGLES} to {MOST_TRIANGLES}"))
        })?,
    };
    let built = match name {
        "cornell" => cornell::build(),
        "atrium" => atrium::build(triangles),
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
        ..Setting::new(Path::new(spec), name)
    };
    finish(built.mesh, setting, &LoadOptions::default())
}

/// Millimetres into metres.
fn metres(mm: [f32; 3]) -> Vec3 {
    Vec3::from(mm) * 0.001
}
