//! A segment of a photon: where it lands, and how it goes on.

use glam::Vec3;
use scene::kernel::bvh::FAR;
use scene::kernel::medium::transmittance;
use scene::kernel::specular::specular_parts;
use scene::math::luminance;
use scene::sampling::{cosine_hemisphere, unit};
use scene::{GeometryTables, Hit, NONE};

use super::sequence::Sequence;
use crate::types::*;

/// Segments after which a photon is given up; at the greatest reflectance one in 10¹¹ has more.
const MAX_SEGMENTS: u32 = 512;

/// Returns true if a photon has another segment.
#[inline]
pub fn is_under_way(photon: &Photon) -> bool {
    photon.flux != Vec3::ZERO && photon.segments < MAX_SEGMENTS
}

/// Flux of a photon at what it met: what the medium has left of it.
#[inline]
fn arriving(p: &PhotonParams, photon: &Photon, hit: Hit) -> Vec3 {
    photon.flux * transmittance(p.absorption, if hit.triangle == NONE { FAR } else { hit.t })
}

/// The hit of photon `k` of a dispatch at what its segment met.
#[inline]
pub fn photon_hit(g: &GeometryTables, p: &PhotonParams, k: u32, photon: &Photon, hit: Hit) -> PhotonHit {
    let mut info = if photon.reflections > 0 { HIT_INDIRECT } else { 0 };
    if photon.segments == 0 {
        info |= HIT_FIRST;
    }
    if hit.triangle != NONE && g.normal(hit.triangle).dot(photon.direction) > 0.0 {
        info |= HIT_BACK;
    }
    PhotonHit { flux: arriving(p, photon, hit), triangle: hit.triangle, u: hit.u, v: hit.v, photon: k, info }
}

/// The photon after what it met. With T what the medium has left, ρ the albedo, m and t the shares that the surface
/// mirrors and lets through at this angle ([`specular_parts`]), it survives with the chance `lum((ρ + m +
/// t)∘T∘Φ)/lum(Φ)`, so its luminance stays. The same number picks one of the three, by luminance: it leaves the side
/// that it met with a cosine-weighted direction, is mirrored, or refracted. Its flux is zero where it does not survive.
#[inline]
pub fn reflect(g: &GeometryTables, p: &PhotonParams, k: u32, photon: &Photon, hit: Hit) -> Photon {
    let mut next = *photon;
    next.flux = Vec3::ZERO;
    if hit.triangle == NONE {
        return next;
    }
    let arrived = arriving(p, photon, hit);
    let flux = arrived * g.albedo(hit.triangle, hit.u, hit.v);
    let left = luminance(flux);
    let before = luminance(photon.flux);
    let (survival, way) = Sequence::of(p, k).reflection(photon.segments);
    let chosen = unit(survival) * before;
    let position = g.position(hit.triangle, hit.u, hit.v);
    if left > 0.0 && chosen < left {
        let front = g.normal(hit.triangle);
        let normal = if front.dot(photon.direction) > 0.0 { -front } else { front };
        next.origin = position + normal * p.ray_offset;
        next.direction = cosine_hemisphere(normal, (unit(way.0), unit(way.1)));
        next.flux = flux * (before / left);
    } else if g.is_specular(hit.triangle) {
        let parts = specular_parts(g, hit.triangle, photon.direction);
        let mirrored = arrived * parts.mirrored;
        let refracted = arrived * parts.refracted;
        let by_mirror = luminance(mirrored);
        let by_refraction = luminance(refracted);
        if by_mirror > 0.0 && chosen < left + by_mirror {
            next.origin = position + parts.normal * p.ray_offset;
            next.direction = parts.mirror_direction;
            next.flux = mirrored * (before / by_mirror);
        } else if by_refraction > 0.0 && chosen < left + by_mirror + by_refraction {
            next.origin = position - parts.normal * p.ray_offset;
            next.direction = parts.refracted_direction;
            next.flux = refracted * (before / by_refraction);
        }
    }
    next.reflections = photon.reflections + 1;
    next.segments = photon.segments + 1;
    next
}
