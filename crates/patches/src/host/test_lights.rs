//! Lights under which the bake compares receivers: what is alike under all of them may be taken together.

use formfactor::{HitRows, Operator, QUARTERS};
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use scene::math::luminance;
use scene::sampling::{frame, hammersley};
use scene::{DirectParams, LIGHT_DIRECTIONAL, Scene, SurfacePoint};

use super::exchange::Exchange;
use super::senders::Senders;
use crate::error::Error;

/// Vectors of the lights, three to a vector.
pub const VECTORS: usize = 2;
/// Values under all lights.
pub type Lights = [Vec4; VECTORS];
/// Bounces of their light.
const BOUNCES: usize = 4;
/// Variance of a row's irradiance as a share of that of independent rays: rows are stratified. Measured in Sponza: 0.27 (light
/// that is the same everywhere) to 0.48.
const STRATIFIED: f32 = 0.4;

/// Irradiance of every row, and the variance of its estimate.
pub struct Estimates {
    /// Irradiance; its mean over the patches is 1 under each light.
    pub light: Vec<Lights>,
    /// Variance.
    pub variance: Vec<Lights>,
}

impl Estimates {
    /// Of receivers that have `rays` rays each, and a row for each quarter.
    pub fn new(rows: &HitRows, exitance: &[Lights], rays: u32) -> Result<Self, Error> {
        let light = gather(rows, exitance.iter().copied())?;
        let squares = gather(rows, exitance.iter().map(|b| b.map(|v| v * v)))?;
        let variance = |(mean, square): (&Lights, Lights)| {
            [0, 1].map(|v| (square[v] - mean[v] * mean[v]).max(Vec4::ZERO) * (STRATIFIED / rays as f32))
        };
        let variance = light.iter().zip(squares).map(variance).collect();
        Ok(Self { light, variance })
    }
}

fn gather(rows: &HitRows, exitance: impl Iterator<Item = Lights> + Clone) -> Result<Vec<Lights>, Error> {
    let mut found = vec![[Vec4::ZERO; VECTORS]; rows.rows() / QUARTERS];
    for k in 0..VECTORS {
        let plane: Vec<Vec4> = exitance.clone().map(|light| light[k]).collect();
        let mut received = vec![Vec4::ZERO; rows.rows()];
        rows.apply(&plane, &mut received)?;
        found.iter_mut().zip(received.chunks(QUARTERS)).for_each(|(all, one)| all[k] = one.iter().sum());
    }
    Ok(found)
}

/// Exitance of the facets under several lights: the scene's own, four suns where there may be suns, and light that is the
/// same everywhere. Each is scaled so that the mean irradiance of the patches is 1.
pub fn test_lights(
    scene: &Scene,
    senders: &Senders,
    exchange: &Exchange,
    direct: &DirectParams,
) -> Result<Vec<Lights>, Error> {
    let points = &senders.points;
    let own = scene.direct_irradiance(direct, points);
    let mut sources: Vec<Vec4> = own.iter().map(|e| Vec4::new(luminance(*e), 0.0, 0.0, 0.0)).collect();
    let mut others = vec![Vec4::new(0.0, 0.0, 1.0, 0.0); points.len()];
    if scene.has_sky() || scene.lighting.lights.iter().any(|l| l.kind == LIGHT_DIRECTIONAL) {
        let (right, up) = frame(-Vec3::Y);
        let sun = |k: u32| {
            let (x, turn) = hammersley(k, 4, (0, 0x2545_f491));
            let height = 0.4 + 0.5 * x;
            let (s, c) = scene::math::sin_cos_turn(turn);
            (right * c + up * s) * scene::math::sqrt(1.0 - height * height) + Vec3::Y * height
        };
        let suns = [sun(0), sun(1), sun(2), sun(3)];
        let lit = |p: &SurfacePoint, sun: Vec3| {
            let cosine = p.normal.dot(sun);
            let origin = p.position + p.normal * scene.geometry.ray_offset;
            if cosine > 0.0 && !scene.occluded(origin, sun, f32::INFINITY) { cosine } else { 0.0 }
        };
        sources.par_iter_mut().zip(points).for_each(|(e, p)| (e.y, e.z) = (lit(p, suns[0]), lit(p, suns[1])));
        others.par_iter_mut().zip(points).for_each(|(e, p)| (e.x, e.y) = (lit(p, suns[2]), lit(p, suns[3])));
    }
    let grey = |albedo: &Vec4| luminance(albedo.truncate());
    let shares = senders.facet_shares();
    let area: f32 = senders.patches.iter().map(|p| p.area).sum();
    let mut result = vec![[Vec4::ZERO; VECTORS]; senders.facets.len()];
    for (vector, light) in [sources, others].iter().enumerate() {
        let of_points = |range: &[u32]| {
            let points = (range[0] as usize..range[1] as usize).map(|k| (k, points[k].weight));
            points.map(|(k, weight)| light[k] * (weight * grey(&senders.point_albedo[k]))).sum()
        };
        let source: Vec<Vec4> = senders.offsets.windows(2).map(of_points).collect();
        let of_facets = |range: &[u32]| (range[0] as usize..range[1] as usize).map(|f| source[f] * shares[f]).sum();
        let patch_source: Vec<Vec4> = senders.patch_facets.windows(2).map(of_facets).collect();
        let mut exitance = patch_source.clone();
        let mut received = vec![Vec4::ZERO; exitance.len()];
        for _ in 0..BOUNCES {
            exchange.factors.apply(&exitance, &mut received)?;
            for (i, b) in exitance.iter_mut().enumerate() {
                *b = patch_source[i] + received[i] * grey(&senders.albedo[i]);
            }
        }
        let mean: Vec4 = received.iter().zip(&senders.patches).map(|(h, p)| *h * (p.area / area)).sum();
        let scale = Vec4::select(mean.cmpgt(Vec4::ZERO), mean.recip(), Vec4::ZERO);
        // As in frames: light between facets last.
        let reflected = |f: usize, h: Vec4| source[f] + h * grey(&senders.facet_albedo[f]);
        let patch = |f: usize| senders.patch_of(f as u32) as usize;
        let first: Vec<Vec4> = (0..source.len()).map(|f| reflected(f, received[patch(f)])).collect();
        let mut received = vec![Vec4::ZERO; first.len()];
        exchange.facet_operator().apply(&first, &mut received)?;
        for (f, out) in result.iter_mut().enumerate() {
            out[vector] = reflected(f, received[f]) * scale;
        }
    }
    Ok(result)
}
