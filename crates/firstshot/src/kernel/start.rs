//! Start of a photon: element, place, direction, flux.

use core::f32::consts::TAU;

use glam::{Vec3, Vec4};
use scene::gpu::{LIGHT_LUMINAIRE, LIGHT_SPOT};
use scene::kernel::bvh::FAR;
use scene::kernel::light::{luminaire_share, sky_radiance, spot_falloff, unoccluded};
use scene::kernel::medium::transmittance;
use scene::kernel::specular::specular_parts;
use scene::math::{abs, luminance, sin_cos_2pi, sqrt};
use scene::sampling::{cosine_hemisphere, frame, uniform_triangle, unit, wide_product};
use scene::{GeometryTables, Light, Sky};

use super::linear::{interpolate, linear_point, linear_point_by_cardano};
use super::sequence::{Sequence, StartWords};
use crate::types::*;

/// Lights and sky, the tables that starts need.
#[derive(Clone, Copy, Debug)]
pub struct Sources<'a> {
    /// Lights that are not geometry.
    pub lights: &'a [Light],
    /// The sky.
    pub sky: Sky,
    /// Its map.
    pub sky_map: &'a [Vec4],
    /// Distributions of luminaires.
    pub distributions: &'a [f32],
}

impl<'a> Sources<'a> {
    /// Those of everything that shines.
    pub fn of(lights: &scene::Lights<'a>) -> Self {
        let scene::Lights { lights, sky, sky_map, distributions, .. } = *lights;
        Self { lights, sky, sky_map, distributions }
    }
}

/// The entry that a random word picks from an alias table of `count` entries: its slot is the high word of
/// `word · count`, the low word decides within the slot.
#[inline]
pub fn pick(alias: &[AliasEntry], count: u32, word: u32) -> u32 {
    let (slot, rest) = wide_product(word, count);
    let entry = alias[slot as usize];
    if rest < entry.threshold { slot } else { entry.other }
}

/// Area of the box of the scene across a direction, m²: the faces' areas times their cosines.
#[inline]
pub fn area_across(low: Vec3, high: Vec3, direction: Vec3) -> f32 {
    let s = high - low;
    abs(direction.x) * s.y * s.z + abs(direction.y) * s.x * s.z + abs(direction.z) * s.x * s.y
}

/// Point where parallel light that travels along `direction` enters the box of the scene, uniform across the direction.
#[inline]
fn enter_box(p: &PhotonParams, direction: Vec3, x: f32, y: f32) -> Vec3 {
    let s = p.high - p.low;
    let by_x = abs(direction.x) * s.y * s.z;
    let by_y = abs(direction.y) * s.x * s.z;
    let by_z = abs(direction.z) * s.x * s.y;
    let chosen = x * (by_x + by_y + by_z);
    let near = |d: f32, low: f32, high: f32| if d > 0.0 { low } else { high };
    if chosen < by_x {
        let rest = chosen / by_x;
        Vec3::new(near(direction.x, p.low.x, p.high.x), p.low.y + rest * s.y, p.low.z + y * s.z)
    } else if chosen < by_x + by_y {
        let rest = (chosen - by_x) / by_y;
        Vec3::new(p.low.x + rest * s.x, near(direction.y, p.low.y, p.high.y), p.low.z + y * s.z)
    } else {
        let rest = if by_z > 0.0 { (chosen - by_x - by_y) / by_z } else { 0.0 };
        Vec3::new(p.low.x + rest * s.x, p.low.y + y * s.y, near(direction.z, p.low.z, p.high.z))
    }
}

/// Unit direction at the height `z` along `axis` and an azimuth round it, in [0, 1].
#[inline]
fn on_sphere(axis: Vec3, z: f32, azimuth: f32) -> Vec3 {
    let (s, c) = sin_cos_2pi(azimuth);
    let inside = 1.0 - z * z;
    let r = sqrt(if inside > 0.0 { inside } else { 0.0 });
    let (a, b) = frame(axis);
    a * (r * c) + b * (r * s) + axis * z
}

/// Share of a light's luminance that is left where `left` of each channel is.
#[inline]
pub fn share_left(color: Vec3, left: Vec3) -> f32 {
    let whole = luminance(color);
    if whole > 0.0 { luminance(color * left) / whole } else { 0.0 }
}

/// Departure of a photon from a light element.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Departure {
    /// 1 where it goes through the surface.
    goes_through: u32,
    /// Unit direction.
    direction: Vec3,
    /// Share of the light that goes on.
    share: Vec3,
}

/// Picks how light of a colour that travels along `direction` leaves a surface, by the luminance of what is reflected
/// diffusely, mirrored and let through. What is mirrored or let through keeps the direction of the light; the share
/// that is picked gets the luminance of all.
#[inline]
fn depart(
    g: &GeometryTables,
    triangle: u32,
    albedo: Vec3,
    color: Vec3,
    normal: Vec3,
    direction: Vec3,
    w: &StartWords,
) -> Departure {
    let diffuse = cosine_hemisphere(normal, (unit(w.way.0), unit(w.way.1)));
    if !g.is_specular(triangle) {
        return Departure { goes_through: 0, direction: diffuse, share: albedo };
    }
    let parts = specular_parts(g, triangle, direction);
    let reflected = luminance(albedo * color);
    let mirrored = luminance(parts.mirrored * color);
    let all = reflected + mirrored + luminance(parts.refracted * color);
    let chosen = unit(w.part) * all;
    if chosen < reflected {
        return Departure { goes_through: 0, direction: diffuse, share: albedo * (all / reflected) };
    }
    if chosen < reflected + mirrored {
        let share = parts.mirrored * (all / mirrored);
        return Departure { goes_through: 0, direction: parts.mirror_direction, share };
    }
    let refracted = luminance(parts.refracted * color);
    let share = if refracted > 0.0 { parts.refracted * (all / refracted) } else { Vec3::ZERO };
    Departure { goes_through: 1, direction: parts.refracted_direction, share }
}

/// A photon of light that falls on a light element, as it leaves it:
/// `flux = ρ(x)∘color∘T · h(x)/h_linear(x) · scale`, h the irradiance over the light's colour, T what the medium has
/// left of it, ρ the share that goes on ([`depart`]).
#[inline]
fn start_on_light_element(
    g: &GeometryTables,
    sources: &Sources,
    p: &PhotonParams,
    e: &Element,
    w: &StartWords,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool,
) -> Photon {
    let at = if p.flags & FLAG_CARDANO != 0 {
        linear_point_by_cardano(e.values, unit(w.place.0), unit(w.place.1))
    } else {
        linear_point(e.values, unit(w.place.0), unit(w.place.1))
    };
    let place = e.corner + e.edge_a * at.x + e.edge_b * at.y;
    let front = g.normal(e.triangle);
    let normal = if e.is_back == 1 { -front } else { front };
    let origin = g.position(e.triangle, place.x, place.y) + normal * p.ray_offset;
    let light = sources.lights[e.light as usize];
    let arrival = unoccluded(&light, sources.distributions, origin, normal);
    let travel = arrival.to_light * (-1.0 / arrival.to_light.length());
    let departure = depart(g, e.triangle, g.albedo(e.triangle, place.x, place.y), light.color, normal, travel, w);
    let mut flux = departure.share * light.color * e.scale;
    if g.is_hole(e.triangle, place.x, place.y) {
        flux = Vec3::ZERO;
    }
    if p.flags & FLAG_BOUND != 0 {
        // What remains has luminance 1; texels brighter than the bound, which filtering cannot make, would keep theirs.
        let chance = luminance(flux);
        if unit(w.rejection) >= chance {
            flux = Vec3::ZERO;
        } else if chance < 1.0 {
            flux *= 1.0 / chance;
        }
    }
    let left = transmittance(p.absorption, arrival.distance());
    if p.flags & FLAG_EXACT != 0 {
        let density = interpolate(e.values, at);
        let lit = arrival.share > 0.0 && density > 0.0 && flux != Vec3::ZERO;
        if lit && !occluded(origin, arrival.to_light, arrival.t_max) {
            flux *= left * (arrival.share / density);
        } else {
            flux = Vec3::ZERO;
        }
    } else {
        // The table holds the luminance of what is left; its colour is that at the start.
        let mean = share_left(light.color, left);
        flux = if mean > 0.0 { flux * left * (1.0 / mean) } else { Vec3::ZERO };
    }
    let start = if departure.goes_through == 1 { origin - normal * (2.0 * p.ray_offset) } else { origin };
    Photon { origin: start, reflections: 1, direction: departure.direction, segments: 0, flux, reserved: 0 }
}

/// A photon of a shining surface: `flux = L · scale`, uniform over the area, cosine-weighted.
#[inline]
fn start_on_emitter(g: &GeometryTables, sources: &Sources, p: &PhotonParams, e: &Element, w: &StartWords) -> Photon {
    let x = unit(w.place.0);
    let y = unit(w.place.1);
    let (origin, normal, radiance);
    if e.kind == ELEMENT_RECT {
        let light = sources.lights[e.light as usize];
        normal = light.edge_a.cross(light.edge_b) * (1.0 / light.area);
        origin = light.position + light.edge_a * x + light.edge_b * y;
        radiance = light.color;
    } else {
        let (u, v) = uniform_triangle((x, y));
        normal = g.normal(e.triangle);
        origin = g.position(e.triangle, u, v) + normal * p.ray_offset;
        radiance = if g.is_hole(e.triangle, u, v) { Vec3::ZERO } else { g.radiance(e.triangle, u, v) };
    }
    let direction = cosine_hemisphere(normal, (unit(w.way.0), unit(w.way.1)));
    Photon { origin, reflections: 0, direction, segments: 0, flux: radiance * e.scale, reserved: 0 }
}

/// Direction of travel and flux of a photon of a point or spot light or a luminaire.
#[inline]
fn leave_bulb(light: &Light, distributions: &[f32], e: &Element, w: &StartWords) -> (Vec3, Vec3) {
    let is_spot = light.kind == LIGHT_SPOT;
    let axis = if is_spot { light.direction } else { Vec3::Y };
    let least = if is_spot { light.cos_outer } else { -1.0 };
    let z = 1.0 - (1.0 - least) * unit(w.way.0);
    let direction = on_sphere(axis, z, unit(w.way.1));
    let mut falloff = if is_spot { spot_falloff(light, z) } else { 1.0 };
    if light.kind == LIGHT_LUMINAIRE {
        falloff = luminaire_share(light, distributions, direction);
    }
    (direction, light.color * (falloff * (1.0 - least) * TAU * e.scale))
}

/// Photon `k` of a dispatch as it leaves its element. Its flux is zero where no light leaves there.
#[inline]
pub fn start_photon(
    g: &GeometryTables,
    sources: &Sources,
    p: &PhotonParams,
    alias: &[AliasEntry],
    elements: &[Element],
    k: u32,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool,
) -> Photon {
    let chosen = pick(alias, p.element_count, Sequence::of(p, k).element());
    start_from(g, sources, p, elements[chosen as usize], k, occluded)
}

/// Photon `k` of a dispatch, where the element is known that it picks.
#[inline]
pub fn start_from(
    g: &GeometryTables,
    sources: &Sources,
    p: &PhotonParams,
    e: Element,
    k: u32,
    occluded: impl Fn(Vec3, Vec3, f32) -> bool,
) -> Photon {
    let w = Sequence::of(p, k).start();
    if e.kind == ELEMENT_LIT {
        return start_on_light_element(g, sources, p, &e, &w, occluded);
    }
    if e.kind == ELEMENT_EMITTER || e.kind == ELEMENT_RECT {
        return start_on_emitter(g, sources, p, &e, &w);
    }
    let (origin, direction, flux);
    if e.kind == ELEMENT_BULB {
        let light = sources.lights[e.light as usize];
        (direction, flux) = leave_bulb(&light, sources.distributions, &e, &w);
        origin = light.position;
    } else {
        let light;
        if e.kind == ELEMENT_SKY {
            // Heights and azimuths have equal solid angles in equal areas.
            let z = e.corner.x + e.edge_a.x * unit(w.way.0);
            let azimuth = e.corner.y + e.edge_a.y * unit(w.way.1);
            let (s, c) = sin_cos_2pi(azimuth);
            let inside = 1.0 - z * z;
            let r = sqrt(if inside > 0.0 { inside } else { 0.0 });
            let towards = Vec3::new(r * s, z, -r * c);
            direction = -towards;
            light = sky_radiance(&sources.sky, sources.sky_map, towards);
        } else {
            let beam = sources.lights[e.light as usize];
            direction = beam.direction;
            light = beam.color;
        }
        let left = transmittance(p.absorption, FAR);
        flux = light * left * (area_across(p.low, p.high, direction) * e.scale);
        origin = enter_box(p, direction, unit(w.place.0), unit(w.place.1));
    }
    Photon { origin, reflections: 0, direction, segments: 0, flux, reserved: 0 }
}
