//! F_r: from the patches to many more receivers, `H_r = F_r B`.

use std::time::Instant;

use formfactor::{HitRows, Operator, add_hit_rows};
use glam::{Vec3, Vec4};
use multibounce::{LowRank, LowRankWorkspace, TileSide, TileSource, halving_order};
use patches::Sample;
use scene::sampling::hash3;
use scene::{Scene, SurfacePoint};
use serde::Serialize;

use super::{DEVICE_TURNS, Row, median_ms};
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::progress::Progress;
use patchlight::render::frame::receivers_on_device;
use patchlight::render::operator::measure::relative_error;
use patchlight::render::operator::{Between, seen};
use patchlight::render::proceed;
use patchlight::render::senders::{Columns, Senders, lit_sampler};
use runtime::executor::Executor;

/// One receiver in so many tells the noise of the rows.
const NOISE_SHARE: usize = 16;
/// Rays that tell what a receiver sees, for its place in the order.
const ORDER_RAYS: u32 = 64;
/// Times that more receivers are asked for when there are too few, and how many more than it would take.
const MORE_TIMES: usize = 4;
const MORE: f64 = 1.02;

/// What the receivers' rows are.
#[derive(Clone, Serialize)]
pub struct ReceiverRows {
    receivers: usize,
    rays: u32,
    rows_s: f64,
    /// Entries of a row that are not zero, on average.
    entries: f64,
    /// Relative error of irradiance by the noise of the rows: of the scene's light, the greatest of the compact lights.
    noise: [f64; 2],
}

impl ReceiverRows {
    pub fn line(&self) -> String {
        format!(
            "{} receivers, {} rays each: rows of {:.0} entries in {:.1} s; their noise is {:.2} % of the irradiance of the scene's \
             own light and at most {:.2} % of a compact light's",
            self.receivers,
            self.rays,
            self.entries,
            self.rows_s,
            100.0 * self.noise[0],
            100.0 * self.noise[1]
        )
    }
}

/// What is measured.
pub struct Receivers<'a> {
    pub scene: &'a Scene,
    pub senders: &'a Senders,
    pub between: &'a Between,
    /// Exitances, the scene's own first.
    pub sources: Vec<&'a [Vec4]>,
}

/// Exactly so many points that stand for equal areas to which light comes, in an order in which neighbours are near; none where
/// no light comes anywhere.
fn points(scene: &Scene, patches: usize, count: usize, seed: u32) -> Result<Vec<SurfacePoint>, Error> {
    let Some(sampler) = lit_sampler(scene, patches, seed)? else { return Ok(Vec::new()) };
    let (mut samples, mut wanted) = (Vec::new(), count);
    for _ in 0..MORE_TIMES {
        samples = sampler.samples(wanted as u32, hash3(seed, 0, 0x7265_6365));
        if samples.len() >= count || samples.is_empty() {
            break;
        }
        wanted = (MORE * wanted as f64 * count as f64 / samples.len() as f64) as usize;
    }
    let found = samples.len();
    let kept = count.min(found);
    let samples: Vec<_> = (0..kept).map(|k| samples[k * found / kept]).collect();
    let point =
        |(patch, s): (u32, &Sample)| SurfacePoint { position: s.position, patch, normal: s.normal, weight: 1.0 };
    Ok(ordered((0..).zip(&samples).map(point).collect(), &[]))
}

/// Points in an order in which neighbours are alike, by what they see unless that is unknown.
fn ordered(points: Vec<SurfacePoint>, seen: &[Vec4]) -> Vec<SurfacePoint> {
    let (positions, normals): (Vec<Vec3>, Vec<Vec3>) = points.iter().map(|p| (p.position, p.normal)).unzip();
    let point = |(patch, &k): (u32, &u32)| SurfacePoint { patch, ..points[k as usize] };
    (0..).zip(&halving_order(&positions, &normals, seen)).map(point).collect()
}

impl Receivers<'_> {
    /// The rows of some points over the patches.
    fn rows(&self, points: &[SurfacePoint], rays: u32, seed: u32, progress: &Progress) -> Result<HitRows, Error> {
        let offsets: Vec<u32> = (0..=points.len() as u32).collect();
        let surfaces = self.senders.lighting(self.scene, Columns::Patches, points, &offsets, seed);
        let mut rows = HitRows::new(self.senders.patches.len())?;
        progress.phase("receivers", |report| {
            add_hit_rows(&mut rows, &surfaces, rays, &|done, total| proceed(report, done, total))
        })?;
        Ok(rows)
    }

    /// Error that the noise of the rows makes, from other rows of some of the points.
    fn noise(
        &self,
        points: &[SurfacePoint],
        rays: u32,
        seed: u32,
        exact: &[Vec<Vec4>],
        progress: &Progress,
    ) -> Result<[f64; 2], Error> {
        let some: Vec<SurfacePoint> = points.iter().step_by(NOISE_SHARE).copied().collect();
        let rows = self.rows(&some, rays, hash3(seed, 1, 0x6e6f_6973), progress)?;
        let (area, mut h) = (vec![1.0; some.len()], vec![Vec4::ZERO; some.len()]);
        let mut errors = Vec::new();
        for (source, exact) in self.sources.iter().zip(exact) {
            rows.apply(source, &mut h)?;
            let exact: Vec<Vec4> = exact.iter().step_by(NOISE_SHARE).copied().collect();
            // Both are noisy.
            errors.push(relative_error(&h, &exact, &area) * std::f64::consts::FRAC_1_SQRT_2);
        }
        Ok([errors[0], greatest(&errors[1..])])
    }

    /// Rows of hits, the same as sparse rows, and tiles, at `row`'s defaults.
    ///
    /// # Errors
    /// What rows and tiles say; what the device says.
    pub fn measure(
        &self,
        (common, args): (&Common, &Bench),
        row: &dyn Fn(&'static str, &'static str, u64, f64) -> Row,
        mut device: Option<&mut (dyn Executor + 'static)>,
        rows: &mut Vec<Row>,
        progress: &Progress,
    ) -> Result<Option<ReceiverRows>, Error> {
        let points = points(self.scene, self.senders.patches.len(), args.receivers as usize, common.seed)?;
        let (n, rays) = (points.len(), args.receiver_rays());
        if n == 0 {
            return Ok(None);
        }
        let start = Instant::now();
        let few = self.rows(&points, rays.min(ORDER_RAYS), hash3(common.seed, 2, 0x6f72_6465), progress)?;
        let centroids: Vec<Vec3> = self.senders.patches.iter().map(|p| p.centroid).collect();
        let points = ordered(points, &seen(&few, &centroids)?);
        let hits = self.rows(&points, rays, common.seed, progress)?;
        let rows_s = start.elapsed().as_secs_f64();
        let (area, order): (Vec<f32>, Vec<u32>) = (vec![1.0; n], (0..n as u32).collect());
        let mut exact = vec![vec![Vec4::ZERO; n]; self.sources.len()];
        for (source, exact) in self.sources.iter().zip(&mut exact) {
            hits.apply(source, exact)?;
        }
        let noise = self.noise(&points, rays, common.seed, &exact, progress)?;

        let mut h = vec![Vec4::ZERO; n];
        let own = self.sources[0];
        let of = |row: Row| Row { receivers: Some(n), ..row };
        let time = median_ms(|| Ok(hits.apply(own, &mut h)?))?;
        rows.push(of(row("F_r", "counts of hits", hits.bytes(), time)));
        let csr = hits.to_csr()?;
        let entries = csr.values.len();
        let time = median_ms(|| Ok(csr.apply(own, &mut h)?))?;
        rows.push(of(row("F_r", "sparse rows", (size_of_val(&csr.row_start[..]) + 8 * entries) as u64, time)));
        drop(csr);
        for &epsilon in &args.receiver_epsilons {
            let start = Instant::now();
            let tiles = progress.phase("compress", |report| {
                let scales = hits.scales();
                let sparse = |i: usize, each: &mut dyn FnMut(u32, f32)| {
                    hits.row(i).into_iter().for_each(|(column, count)| each(column, count as f32 * scales[i]));
                };
                let receivers = TileSide { area: &area, order: &order };
                let senders = TileSide { area: &self.between.area, order: &self.between.order };
                let proceed = |done, total| proceed(report, done, total);
                LowRank::encode(TileSource::Rows { rows: &sparse, receivers, senders }, epsilon, &proceed)
            })?;
            let compress_s = start.elapsed().as_secs_f64();
            let mut room = LowRankWorkspace::default();
            let mut errors = Vec::new();
            for (source, exact) in self.sources.iter().zip(&exact) {
                tiles.apply_in(&mut room, source, &mut h)?;
                errors.push(relative_error(&h, exact, &area));
            }
            let time = median_ms(|| Ok(tiles.apply_in(&mut room, own, &mut h)?))?;
            let device_ms = match device.as_deref_mut() {
                Some(device) => Some(receivers_on_device(device, &tiles, own, DEVICE_TURNS)?.1),
                None => None,
            };
            rows.push(Row {
                epsilon: Some(epsilon),
                frobenius: tiles.report.error[0],
                own_light: errors[0],
                compact_lights: greatest(&errors[1..]),
                compress_s: Some(compress_s),
                device_ms,
                ..of(row("F_r", "tiles", tiles.bytes(), time))
            });
        }
        Ok(Some(ReceiverRows { receivers: n, rays, rows_s, entries: entries as f64 / n as f64, noise }))
    }
}

fn greatest(errors: &[f64]) -> f64 {
    errors.iter().copied().fold(0.0, f64::max)
}
