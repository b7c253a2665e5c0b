//! F_r: from the patches to many more receivers, `H_r = F_r B`.

use std::sync::Arc;
use std::time::Instant;

use formfactor::add_hit_rows;
use glam::{Vec3, Vec4};
use multibounce::{LowRank, LowRankWorkspace, TileSide, TileSource, halving_order};
use patches::{Columns, Density, Sample, lit_sampler};
use patchlight::low_level::operator::mean_visible_points;
use runtime::executor::Executor;
use runtime::recipe::multibounce::{LowRankTables, OperatorTables, Product};
use scene::sampling::hash3;
use scene::{Scene, SurfacePoint};
use serde::Serialize;
use shell::operator_error::relative_error;
use transport::{HitCounts, LinearOperator};

use super::{DEVICE_ROUNDS, Row, Subject, greatest, median_ms};
use crate::args::{Bench, Common};
use crate::error::Error;

/// One receiver in so many tells the noise of the rows.
const NOISE_SHARE: usize = 16;
/// Rays that tell what a receiver sees, for its place in the order.
const ORDER_RAYS: u32 = 64;
/// Times that more receivers are asked for when there are too few, and how many more than it would take.
const MORE_TIMES: usize = 4;
const MORE: f64 = 1.02;

/// Kind of the receivers' rows.
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
            "{} receivers, {} rays each: rows of {:.0} entries in {:.1} s; their noise is {:.2} % of the irradiance \
             of the scene's own light and at most {:.2} % of a compact light's",
            self.receivers,
            self.rays,
            self.entries,
            self.rows_s,
            100.0 * self.noise[0],
            100.0 * self.noise[1]
        )
    }
}

/// Measured receivers.
pub(super) struct Receivers<'a> {
    pub scene: &'a Scene,
    pub subject: &'a Subject<'a>,
    pub common: &'a Common,
    pub args: &'a Bench,
}

/// Exactly so many points that stand for equal areas to which light comes, in an order in which neighbours are near;
/// none where no light comes anywhere.
fn points(scene: &Scene, patches: usize, count: usize, seed: u32) -> Result<Vec<SurfacePoint>, Error> {
    let Some(sampler) = lit_sampler(scene, patches, Density::default(), seed)? else { return Ok(Vec::new()) };
    let mut samples = Vec::new();
    let mut wanted = count;
    for _ in 0..MORE_TIMES {
        samples = sampler.samples(wanted as u32, hash3(seed, 0, 0x7265_6365))?;
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

/// Points in an order in which neighbours are alike, by their mean visible points unless those are
/// unknown.
fn ordered(points: Vec<SurfacePoint>, mean_visible: &[Vec4]) -> Vec<SurfacePoint> {
    let (positions, normals): (Vec<Vec3>, Vec<Vec3>) = points.iter().map(|p| (p.position, p.normal)).unzip();
    let order = halving_order(&positions, &normals, mean_visible);
    (0..).zip(&order).map(|(patch, &k)| SurfacePoint { patch, ..points[k as usize] }).collect()
}

impl Receivers<'_> {
    /// The rows of some points over the patches.
    fn rows(&self, points: &[SurfacePoint], rays: u32, seed: u32) -> Result<HitCounts, Error> {
        let mesh = self.subject.mesh;
        let offsets: Vec<u32> = (0..=points.len() as u32).collect();
        let surfaces = mesh.lighting(self.scene, Columns::Patches, points, &offsets, seed);
        let mut rows = HitCounts::new(mesh.patches.len())?;
        self.subject.progress.phase("receivers", |report| add_hit_rows(&mut rows, &surfaces, rays, &report))?;
        Ok(rows)
    }

    /// Irradiance of all lights by an operator, W/m².
    fn irradiances(&self, operator: &dyn LinearOperator) -> Result<Vec<Vec<Vec4>>, Error> {
        let mut all = Vec::with_capacity(self.subject.truths.len());
        for truth in &self.subject.truths {
            let mut irradiance = vec![Vec4::ZERO; operator.rows()];
            operator.apply(&truth.source, &mut irradiance)?;
            all.push(irradiance);
        }
        Ok(all)
    }

    /// Error that the noise of the rows makes, from other rows of some of the points.
    fn noise(&self, points: &[SurfacePoint], exact: &[Vec<Vec4>]) -> Result<[f64; 2], Error> {
        let some: Vec<SurfacePoint> = points.iter().step_by(NOISE_SHARE).copied().collect();
        let seed = hash3(self.common.seed, 1, 0x6e6f_6973);
        let others = self.irradiances(&self.rows(&some, self.args.receiver_rays(), seed)?)?;
        let area = vec![1.0; some.len()];
        let mut errors = Vec::new();
        for (other, exact) in others.iter().zip(exact) {
            let exact: Vec<Vec4> = exact.iter().step_by(NOISE_SHARE).copied().collect();
            // Both are noisy.
            errors.push(relative_error(other, &exact, &area) * std::f64::consts::FRAC_1_SQRT_2);
        }
        Ok([errors[0], greatest(&errors[1..])])
    }

    /// Rows of hits, the same as sparse rows, and operators of low rank.
    ///
    /// # Errors
    /// What rows and operators say; what the device says.
    pub fn measure(
        &self,
        mut device: Option<&mut (dyn Executor + 'static)>,
        rows: &mut Vec<Row>,
    ) -> Result<Option<ReceiverRows>, Error> {
        let subject = self.subject;
        let seed = self.common.seed;
        let points = points(self.scene, subject.patches(), self.args.receivers as usize, seed)?;
        let n = points.len();
        if n == 0 {
            return Ok(None);
        }
        let rays = self.args.receiver_rays();
        let start = Instant::now();
        let few = self.rows(&points, rays.min(ORDER_RAYS), hash3(seed, 2, 0x6f72_6465))?;
        let centroids: Vec<Vec3> = subject.mesh.patches.iter().map(|p| p.centroid).collect();
        let points = ordered(points, &mean_visible_points(&few, &centroids)?);
        let hits = self.rows(&points, rays, seed)?;
        let rows_s = start.elapsed().as_secs_f64();
        let exact = self.irradiances(&hits)?;
        let noise = self.noise(&points, &exact)?;

        let mut irradiance = vec![Vec4::ZERO; n];
        let time = median_ms(|| Ok(hits.apply(subject.own(), &mut irradiance)?))?;
        rows.push(self.row(n, "counts of hits", hits.bytes(), time));
        let csr = hits.to_csr()?;
        let entries = csr.values.len();
        let time = median_ms(|| Ok(csr.apply(subject.own(), &mut irradiance)?))?;
        let bytes = (size_of_val(&csr.row_start[..]) + 8 * entries) as u64;
        rows.push(self.row(n, "sparse rows", bytes, time));
        drop(csr);
        for &epsilon in &self.args.receiver_epsilons {
            rows.push(self.low_rank(&hits, &exact, epsilon, device.as_deref_mut())?);
        }
        Ok(Some(ReceiverRows { receivers: n, rays, rows_s, entries: entries as f64 / n as f64, noise }))
    }

    /// A row of so many receivers.
    fn row(&self, receivers: usize, method: &'static str, bytes: u64, median_ms: f64) -> Row {
        Row { receivers: Some(receivers), ..self.subject.row("F_r", method, bytes, median_ms) }
    }

    /// The row of an operator of low rank.
    fn low_rank(
        &self,
        hits: &HitCounts,
        exact: &[Vec<Vec4>],
        epsilon: f64,
        device: Option<&mut (dyn Executor + 'static)>,
    ) -> Result<Row, Error> {
        let subject = self.subject;
        let n = hits.rows();
        let area = vec![1.0; n];
        let start = Instant::now();
        let tiles = Arc::new(self.encode(hits, &area, epsilon)?);
        let compress_s = start.elapsed().as_secs_f64();
        let found = self.irradiances(&*tiles)?;
        let errors: Vec<f64> =
            found.iter().zip(exact).map(|(found, exact)| relative_error(found, exact, &area)).collect();
        let mut workspace = LowRankWorkspace::default();
        let mut irradiance = vec![Vec4::ZERO; n];
        let time = median_ms(|| Ok(tiles.apply_in(&mut workspace, subject.own(), &mut irradiance)?))?;
        let device_ms = match device {
            Some(device) => Some(product_ms(device, &tiles, subject.own())?),
            None => None,
        };
        Ok(Row {
            epsilon: Some(epsilon),
            frobenius: tiles.report.error[0],
            own_light: errors[0],
            compact_lights: greatest(&errors[1..]),
            compress_s: Some(compress_s),
            device_ms,
            ..self.row(n, "low_rank", tiles.bytes(), time)
        })
    }

    /// Compresses rows of receivers that all have this area.
    fn encode(&self, hits: &HitCounts, area: &[f32], epsilon: f64) -> Result<LowRank, Error> {
        let order: Vec<u32> = (0..hits.rows() as u32).collect();
        let scales = hits.scales();
        let sparse = |i: usize, each: &mut dyn FnMut(u32, f32)| {
            hits.row(i).into_iter().for_each(|(column, count)| each(column, count as f32 * scales[i]));
        };
        let receivers = TileSide { area, order: &order };
        let patches = TileSide { area: &self.subject.factors.area, order: &self.subject.factors.order };
        let source = TileSource::Rows { rows: &sparse, receivers, patches };
        let made = self.subject.progress.phase("compress", |report| LowRank::encode(source, epsilon, &report));
        Ok(made?)
    }
}

/// Median time of products on a device, ms.
fn product_ms(device: &mut (dyn Executor + 'static), tiles: &Arc<LowRank>, light: &[Vec4]) -> Result<f64, Error> {
    let range = device.device().max_storage_buffer_range;
    let product = Product::load(device, tiles.rows(), tiles.columns(), range, &|plan, tables| {
        OperatorTables::LowRank(LowRankTables::new(plan, tables, tiles))
    })?;
    Ok(product.run(device, light, DEVICE_ROUNDS)?.1)
}
