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
//! | `rooms` | two rooms with thin walls on one floor that goes on outside, below one slab; sun on one side |
//! | `stripes` | a lamp-lit room with painted stripes, a carpet and a poster, 0.2 to 5 mm off what they lie on |
//! | `blinds` | a room that the sun enters through slats |
//! | `clutter` | a room full of thin-legged chairs, knobs and frames, with a small patch of sun |
//! | `window` | a room lit by the sky alone, through the panes of a window |
//! | `corridor` | a corridor lit round two corners |
//! | `islands` | open boxes in the air under a sun and a very dim sky |
//! | `kitchen` | a kitchen lit by sun and sky through one window, a bright sill, cupboards, a papered wall |
//! | `bay` | shining panes close behind arched and straight frames in deep reveals, blinds half down |
//! | `gloss` | varnished boards, bricks by a normal map, balls of brushed metal and plastic; for `Materials::Gltf` |
//!
//! `cornell:block`, `office:person`, `rooms:door` and `atrium:lorry` have objects that move, too.
//! `NAME:KEY=VALUE,KEY=VALUE` gives parameters ([`BUILT_IN`]); `ground` is one of all scenes.

use std::path::Path;

use glam::{Vec3, Vec4};
use scene::{Light, Sky};

use crate::import::draft::{Mesh, Setting, finish};
use crate::import::{Animation, ImportError, LoadOptions, LoadedScene, MovingObject, Track, View};

mod atrium;
mod bay;
mod blinds;
mod boxes;
mod builder;
mod city;
mod clutter;
mod cornell;
mod corridor;
mod gloss;
mod islands;
mod kitchen;
mod moving;
mod office;
mod pattern;
mod rooms;
mod shell;
mod spec;
mod stripes;
mod window;

use builder::Builder;
pub use spec::{BUILT_IN, BuiltIn, GROUND, Parameter, STRESS_SCENES, help};

/// Names of the built-in scenes.
pub const NAMES: [&str; BUILT_IN.len()] = {
    let mut names = [""; BUILT_IN.len()];
    let mut k = 0;
    while k < names.len() {
        names[k] = BUILT_IN[k].name;
        k += 1;
    }
    names
};

/// So far below the lowest point of a scene lies the ground round it, m: no two faces in one place.
const GROUND_GAP: f32 = 0.01;

/// Contents of a built-in scene.
struct Built {
    mesh: Mesh,
    lights: Vec<Light>,
    sky: Vec3,
    view: View,
    exposure_stops: f32,
    /// Animation tracks.
    tracks: Vec<Track>,
    /// Objects that move.
    moving: Vec<MovingObject>,
}

/// Returns true if `spec` (NAME, NAME:TRIANGLES or NAME:KEY=VALUE,…) names a built-in scene.
pub fn is_built_in(spec: &str) -> bool {
    NAMES.contains(&spec.split(':').next().unwrap_or_default())
}

/// Builds a scene from NAME, NAME:TRIANGLES (`atrium` and `city` only) or NAME:KEY=VALUE,KEY=VALUE ([`BUILT_IN`]).
///
/// # Errors
/// [`ImportError::Procedural`] for a name, a key or a value that is not known.
pub fn build(spec: &str) -> Result<LoadedScene, ImportError> {
    let fault = |reason: String| ImportError::Procedural { spec: spec.to_owned(), reason };
    let (scene, values) = spec::parse(spec).map_err(fault)?;
    let name = scene.name;
    let mut built = match name {
        "cornell" => cornell::build(&values),
        "atrium" => atrium::build(&values),
        "city" => city::build(values.count(&city::TRIANGLES)),
        "office" => office::build(&values),
        "sealed-box" => boxes::sealed(),
        "rooms" => rooms::build(&values),
        "stripes" => stripes::build(&values),
        "blinds" => blinds::build(&values),
        "clutter" => clutter::build(&values),
        "window" => window::build(&values),
        "corridor" => corridor::build(&values),
        "islands" => islands::build(&values),
        "kitchen" => kitchen::build(&values),
        "bay" => bay::build(&values),
        "gloss" => gloss::build(),
        _ => Ok(boxes::furnace()),
    }
    .map_err(|(key, reason)| fault(format!("{key}: {reason}")))?;
    let edge = values.get_f32(&GROUND);
    if edge > 0.0 {
        add_ground(&mut built, edge);
    }
    let setting = Setting {
        exposure_stops: Some(built.exposure_stops),
        view: Some(built.view),
        lights: built.lights,
        sky: Sky { radiance: built.sky, ..Sky::default() },
        sky_map: Vec::<Vec4>::new(),
        animation: Animation { tracks: built.tracks, ..Animation::default() },
        moving: built.moving,
        ..Setting::new(Path::new(spec), name)
    };
    finish(built.mesh, setting, &LoadOptions::default())
}

/// Lays a square plane below everything, front up, its middle below the middle of the scene.
fn add_ground(built: &mut Built, edge: f32) {
    let corners = || built.mesh.triangles.iter().flat_map(|t| t.corners);
    let low = corners().fold(Vec3::INFINITY, Vec3::min);
    let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
    let middle = (0.5 * (low + high)).with_y(low.y - GROUND_GAP);
    let half = Vec3::new(0.5 * edge, 0.0, 0.5 * edge);
    let mut b = Builder { mesh: std::mem::take(&mut built.mesh) };
    let earth = b.plain("earth", [0.32, 0.3, 0.24]);
    b.object("ground plane");
    b.cuboid_side(earth, middle - half, middle + half, 3);
    built.mesh = b.mesh;
}

/// Millimetres into metres.
fn metres(mm: [f32; 3]) -> Vec3 {
    Vec3::from(mm) * 0.001
}
