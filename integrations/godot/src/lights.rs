//! Lights of a Godot scene as those of the library.
//!
//! Godot's energies are factors of what a white surface shows: a directional light of energy 1 makes a white surface
//! that it meets straight shine with radiance 1. So irradiance is π times the energy, and radiance the energy itself.

use std::f32::consts::PI;
use std::sync::Arc;

use godot::classes::environment::BgMode;
use godot::classes::light_3d::{BakeMode, Param};
use godot::classes::{DirectionalLight3D, Environment, Light3D, Node, RenderingServer, SpotLight3D, WorldEnvironment};
use godot::prelude::*;
use patchlight::glam::{Vec3, Vec4};
use patchlight::scene::gpu::LIGHT_LUMINAIRE;
use patchlight::scene::{Distribution, Sky};
use patchlight::{Intensity, Irradiance, Light, Lighting};

use crate::gather::{below, linear, vector};

/// Texels of the map that is made of a sky: light needs no more of it.
const SKY_SIZE: (u32, u32) = (64, 32);
/// Frames in which a sky that is black is asked for.
const SKY_TRIES: u32 = 60;
/// Steps of the angle in which the fall-off of a spot is told.
const SPOT_STEPS: usize = 256;

/// Which lights are asked for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Which {
    /// Those that are on.
    Shining,
    /// All there are, each as if it were on: where light may come one day.
    Possible,
}

/// The lights below a node.
#[derive(Default)]
pub struct Lamps {
    /// An environment, its map, and how often it was asked for.
    sky: Option<(Gd<Environment>, Arc<[Vec4]>, u32)>,
    /// True once it was said that falls of light with the distance are taken as those of nature.
    is_told: bool,
}

impl Lamps {
    /// The lights as they are now, and what materials shine with.
    pub fn now(&mut self, node: &Gd<Node>, emission: Vec<Vec3>, which: Which) -> Lighting {
        let mut all = Vec::new();
        below::<Light3D>(node, &mut all);
        let mut distributions = Vec::new();
        let mut lights = Vec::new();
        for lamp in all {
            let is_on = which == Which::Possible || lamp.is_visible_in_tree();
            if is_on && lamp.get_bake_mode() != BakeMode::DISABLED {
                lights.extend(self.light(&lamp, which, &mut distributions));
            }
        }
        let (sky, sky_map) = self.sky(node);
        Lighting { lights, sky, sky_map, emission, distributions: Arc::from(distributions) }
    }

    fn light(&mut self, lamp: &Gd<Light3D>, which: Which, table: &mut Vec<f32>) -> Option<Light> {
        let sign = if lamp.is_negative() { 0.0 } else { 1.0 };
        let factor = sign * lamp.get_param(Param::ENERGY) * lamp.get_param(Param::INDIRECT_ENERGY);
        let power = match which {
            Which::Shining => PI * factor * linear(lamp.get_color()),
            Which::Possible => Vec3::ONE,
        };
        if power == Vec3::ZERO {
            return None;
        }
        let place = lamp.get_global_transform();
        let direction = -vector(place.basis.col_c()).normalize_or_zero();
        if lamp.clone().try_cast::<DirectionalLight3D>().is_ok() {
            return Some(Light::sun(direction, Irradiance(power)));
        }
        if lamp.get_param(Param::ATTENUATION) != 2.0 && !self.is_told {
            self.is_told = true;
            godot_warn!(
                "the attenuation of {} is not 2: Patchlight lets light fall with the square of the distance, as nature \
                 does, and has Godot's at 1 m",
                lamp.get_name()
            );
        }
        let position = vector(place.origin);
        if lamp.clone().try_cast::<SpotLight3D>().is_err() {
            return Some(Light::point(position, Intensity(power)));
        }
        let outer = f64::from(lamp.get_param(Param::SPOT_ANGLE)).to_radians();
        let own = spot(outer, f64::from(lamp.get_param(Param::SPOT_ATTENUATION)))?;
        let distribution = own.append_to(table).ok()?;
        Some(Light {
            kind: LIGHT_LUMINAIRE,
            position,
            direction,
            edge_a: vector(place.basis.col_a()).normalize_or_zero(),
            color: power * own.mean() as f32,
            distribution,
            ..Light::default()
        })
    }

    /// The sky of the environment of a scene, which is asked for once: skies that change are told by `forget_sky`.
    fn sky(&mut self, node: &Gd<Node>) -> (Sky, Arc<[Vec4]>) {
        let mut worlds = Vec::new();
        below::<WorldEnvironment>(node, &mut worlds);
        let Some(environment) = worlds.iter().find_map(|world| world.get_environment()) else {
            return (Sky::default(), Arc::new([]));
        };
        let known = self.sky.take().filter(|(own, ..)| *own == environment);
        let (map, asked) = match known {
            // A sky that was not drawn yet is black.
            Some((_, map, asked)) if asked >= SKY_TRIES || map.iter().any(|texel| *texel != Vec4::ZERO) => (map, asked),
            other => (panorama(&environment), other.map_or(1, |(.., asked)| asked + 1)),
        };
        self.sky = Some((environment, Arc::clone(&map), asked));
        if map.is_empty() {
            return (Sky::default(), map);
        }
        let (map_width, map_height) = SKY_SIZE;
        (Sky { radiance: Vec3::ONE, map_width, map_height, ..Sky::default() }, map)
    }

    /// Asks for the sky anew.
    pub fn forget_sky(&mut self) {
        self.sky = None;
    }
}

/// Radiance round about in an environment; empty for one that is black, or a server that draws nothing.
fn panorama(environment: &Gd<Environment>) -> Arc<[Vec4]> {
    let (width, height) = SKY_SIZE;
    if matches!(environment.get_background(), BgMode::CLEAR_COLOR | BgMode::COLOR) {
        let color = linear(environment.get_bg_color()) * environment.get_bg_energy_multiplier();
        let is_color = environment.get_background() == BgMode::COLOR && color != Vec3::ZERO;
        return if is_color { vec![color.extend(0.0); (width * height) as usize].into() } else { Arc::new([]) };
    }
    let size = Vector2i::new(width as i32, height as i32);
    let server = &mut RenderingServer::singleton();
    let Some(image) = server.environment_bake_panorama(environment.get_rid(), false, size) else {
        return Arc::new([]);
    };
    if image.get_size() != size {
        return Arc::new([]);
    }
    let texel = |k: u32| {
        let color = image.get_pixel((k % width) as i32, (k / width) as i32);
        Vec4::new(color.r, color.g, color.b, 0.0).max(Vec4::ZERO)
    };
    (0..width * height).map(texel).collect()
}

/// The fall-off of a spot of this half angle, as Godot has it: 1 − ((1 − cos γ) / (1 − cos outer))ᵏ.
fn spot(outer: f64, k: f64) -> Option<Distribution> {
    let share = |gamma: f64| 1.0 - ((1.0 - gamma.cos()) / (1.0 - outer.cos())).clamp(1e-4, 1.0).powf(k);
    let gammas: Vec<f64> = (0..=SPOT_STEPS).map(|step| outer * step as f64 / SPOT_STEPS as f64).collect();
    let shares = gammas.iter().map(|&gamma| share(gamma)).collect();
    let degrees = gammas.iter().map(|gamma| gamma.to_degrees()).collect();
    Distribution::new(degrees, vec![0.0], shares).ok()
}
