//! The specular parts of a surface: mirrors, and boundaries of clear dielectrics (Snell, Fresnel). Light that comes
//! along one direction goes on along one or two.

use core::f32::consts::FRAC_1_PI;

use glam::{Vec3, Vec4};

use super::bvh::{FAR, GeometryTables, closest_hit};
use super::camera::primary_direction;
use super::light::{Lights, meet_rect, sky_radiance};
use super::medium::transmittance;
use super::shade::pixel_albedo;
use crate::gpu::{Camera, Hit, NONE, SpecularChain};
use crate::math::{abs, luminance, sqrt};
use crate::sampling::{hash3, owen_scramble, unit};

/// Surfaces that a ray of a pixel meets at most; what lies beyond is dark.
const MAX_SURFACES: u32 = 32;

/// Specular parts of light that meets a surface along a direction, beside diffuse reflection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpecularParts {
    /// Share that is mirrored: `m + τ R`, R Fresnel's reflectance.
    pub mirrored: Vec3,
    /// Share that goes through: `τ (1 − R)`.
    pub refracted: Vec3,
    /// Unit normal on the side that the light comes from.
    pub normal: Vec3,
    /// Unit direction of what is mirrored.
    pub mirror_direction: Vec3,
    /// Unit direction of what goes through.
    pub refracted_direction: Vec3,
    /// Radiance before the surface over that behind it, where the light goes through: n²/n′² with the indices before
    /// and behind.
    pub radiance_ratio: f32,
}

/// Fresnel's reflectance of a boundary for light that is not polarised. `cosine` is that of the angle of incidence,
/// `index` the index of refraction behind the boundary over that before it. 1 beyond the critical angle.
#[inline]
pub fn fresnel(cosine: f32, index: f32) -> f32 {
    let there = refracted_cosine(cosine, index);
    if there <= 0.0 {
        return 1.0;
    }
    let across = (cosine - index * there) / (cosine + index * there);
    let along = (index * cosine - there) / (index * cosine + there);
    0.5 * (across * across + along * along)
}

/// Cosine of the angle of refraction by Snell's law, 0 where nothing goes through.
#[inline]
pub fn refracted_cosine(cosine: f32, index: f32) -> f32 {
    let squared = 1.0 - (1.0 - cosine * cosine) / (index * index);
    if squared > 0.0 { sqrt(squared) } else { 0.0 }
}

/// The specular parts of a triangle for light that travels along the unit vector `direction`.
#[inline]
pub fn specular_parts(g: &GeometryTables, triangle: u32, direction: Vec3) -> SpecularParts {
    let material = g.materials[g.triangles[triangle as usize].material as usize];
    let front = g.normal(triangle);
    let is_back = front.dot(direction) > 0.0;
    let normal = if is_back { -front } else { front };
    let cosine = abs(front.dot(direction));
    let mirror_direction = direction + normal * (2.0 * cosine);
    let index = if is_back { 1.0 / material.index_of_refraction } else { material.index_of_refraction };
    if material.is_pane == 1 {
        // Both faces and all that goes to and fro between them: R + R(1 − R)²/(1 − R²).
        let face = fresnel(cosine, material.index_of_refraction);
        let reflectance = 2.0 * face / (1.0 + face);
        return SpecularParts {
            mirrored: material.mirror + material.transmittance * reflectance,
            refracted: material.transmittance * (1.0 - reflectance),
            normal,
            mirror_direction,
            refracted_direction: direction,
            radiance_ratio: 1.0,
        };
    }
    let reflectance = fresnel(cosine, index);
    let there = refracted_cosine(cosine, index);
    SpecularParts {
        mirrored: material.mirror + material.transmittance * reflectance,
        refracted: material.transmittance * (1.0 - reflectance),
        normal,
        mirror_direction,
        refracted_direction: direction * (1.0 / index) + normal * (cosine / index - there),
        radiance_ratio: 1.0 / (index * index),
    }
}

/// A number in [0, 1) for the surface of a chain with this number, in sub-frame `seed` of a pixel: those of sub-frames
/// that follow each other are spread evenly.
#[inline]
fn chance(index: u32, seed: u32, surface: u32) -> f32 {
    let key = hash3(index, surface, 0x7370_6563);
    unit(owen_scramble(owen_scramble(seed, key).reverse_bits(), key ^ 0x9e37_79b9))
}

/// Surface shown by the primary ray of pixel `index` in sub-frame `seed`, by way of mirrors and through clear glass,
/// where chance picks among the parts of each surface by luminance: the surface whose diffuse part it comes to, or
/// [`Hit::MISS`], with the emission seen on the way (sky and rectangle lights among it), attenuated by a medium with
/// this `absorption`. The distance t is that of the first surface.
#[inline]
#[allow(clippy::too_many_arguments)]
pub fn follow_primary(
    g: &GeometryTables,
    lights: &Lights,
    light_count: u32,
    camera: &Camera,
    index: u32,
    seed: u32,
    ray_offset: f32,
    absorption: Vec3,
) -> (Hit, SpecularChain) {
    let mut origin = camera.eye;
    let mut chain = SpecularChain { through: Vec3::ONE, ..SpecularChain::default() };
    chain.direction = primary_direction(camera, index, seed);
    let mut first = 0.0;
    while chain.surfaces < MAX_SURFACES {
        let mut hit = closest_hit(g, origin, chain.direction, FAR);
        let mut nearest = if hit.triangle == NONE { FAR } else { hit.t };
        let mut rect = NONE;
        for k in 0..light_count {
            let t = meet_rect(&lights.lights[k as usize], origin, chain.direction, nearest);
            if t < nearest {
                nearest = t;
                rect = k;
            }
        }
        chain.through *= transmittance(absorption, nearest);
        if rect != NONE {
            chain.shone += chain.through * lights.lights[rect as usize].color;
            break;
        }
        if hit.triangle == NONE {
            chain.shone += chain.through * sky_radiance(&lights.sky, lights.sky_map, chain.direction);
            break;
        }
        if g.normal(hit.triangle).dot(chain.direction) < 0.0 {
            chain.shone += chain.through * g.radiance(hit.triangle, hit.u, hit.v);
        }
        if chain.surfaces == 0 {
            first = hit.t;
        }
        hit.t = first;
        if !g.is_specular(hit.triangle) {
            return (hit, chain);
        }
        let parts = specular_parts(g, hit.triangle, chain.direction);
        let diffuse = luminance(chain.through * g.albedo(hit.triangle, hit.u, hit.v));
        let mirrored = luminance(chain.through * parts.mirrored);
        let refracted = luminance(chain.through * parts.refracted);
        let all = diffuse + mirrored + refracted;
        let chosen = chance(index, seed, chain.surfaces) * all;
        chain.surfaces += 1;
        if chosen < diffuse {
            chain.through *= all / diffuse;
            return (hit, chain);
        }
        let position = g.position(hit.triangle, hit.u, hit.v);
        if chosen < diffuse + mirrored {
            chain.through *= parts.mirrored * (all / mirrored);
            chain.direction = parts.mirror_direction;
            origin = position + parts.normal * ray_offset;
        } else if refracted > 0.0 {
            chain.through *= parts.refracted * (all / refracted * parts.radiance_ratio);
            chain.direction = parts.refracted_direction;
            origin = position - parts.normal * ray_offset;
        } else {
            break;
        }
    }
    chain.through = Vec3::ZERO;
    (Hit::MISS, chain)
}

/// Albedo of the surface that a chain shows, averaged as [`pixel_albedo`] does, times what its light is multiplied by on
/// its way to the pixel. Behind mirrors it is averaged over less than a pixel shows, for only the last way counts.
#[inline]
pub fn chain_albedo(g: &GeometryTables, camera: &Camera, hit: Hit, chain: SpecularChain) -> Vec4 {
    pixel_albedo(g, camera, chain.direction, hit) * chain.through.extend(1.0)
}

/// Sum of a pixel's radiance after one more sub-frame, W/m²/sr, as [`super::shade::add_sub_frame`] has it, of what a
/// chain shows with its [`chain_albedo`]: `L = L_shone + ρ/π (H_d + H)`.
#[inline]
pub fn add_chain_sub_frame(chain: SpecularChain, albedo: Vec4, direct: Vec4, indirect: Vec4, sum: Vec4) -> Vec4 {
    let reflected = albedo.truncate() * (direct + indirect).truncate() * FRAC_1_PI;
    sum + (chain.shone + reflected).extend(1.0)
}
