//! The four estimators behind one trait, and the loop over rows.

use alloc::vec::Vec;
use core::ops::Range;
use core::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use glam::{DVec3, Vec3};
use scene::parallel::*;
use scene::sampling::{frame, hash3, sobol2};
use scene::{Hit, NONE, SurfacePoint};
use transport::{Dense, Polygon, Proceed, QUADRANTS, Surfaces, check_length, quadrant_of};

use super::area;
use super::contour;
use super::edit::RowKey;
use crate::error::Error;
use crate::kernel::hemisphere::{EXTRA_COLUMNS, hemisphere_ray, hemisphere_row, ray_share};
use crate::types::HemisphereParams;

/// Checks that the tables of surfaces belong together.
pub(super) fn check_surfaces(surfaces: &Surfaces) -> Result<(), Error> {
    let Surfaces { patches, polygons, row_polygons, points, offsets, .. } = surfaces;
    let rows = surfaces.rows();
    if offsets.is_empty() {
        return Err(transport::Error::Length { name: "offsets", expected: 1, found: 0 }.into());
    }
    for (row, pair) in offsets.windows(2).enumerate() {
        if pair[0] >= pair[1] {
            return Err(Error::EmptyRow { row });
        }
    }
    check_length("points", offsets[rows] as usize, points.len())?;
    if !polygons.is_empty() {
        check_length("polygons", patches.len(), polygons.len())?;
    }
    if !row_polygons.is_empty() {
        check_length("row_polygons", rows, row_polygons.len())?;
    }
    Ok(())
}

/// Returns true if nothing stands between two points on surfaces with these normals.
fn sees(surfaces: &Surfaces, from: DVec3, from_normal: DVec3, to: DVec3, to_normal: DVec3) -> bool {
    let lift = f64::from(surfaces.ray_offset);
    let start = (from + from_normal * lift).as_vec3();
    let end = (to + to_normal * lift).as_vec3();
    !surfaces.visibility.any_hit(start, end)
}

/// Random numbers of a pair of patches, in [0, 1).
fn shift(surfaces: &Surfaces, row: usize, column: usize) -> [f64; 4] {
    let key = |d: u32| hash3(row as u32, column as u32, hash3(d, 0x7061_6972, surfaces.seed));
    [0, 1, 2, 3].map(|d| f64::from(key(d)) / 4_294_967_296.0)
}

/// Rows of form factors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FactorRows {
    /// `F_ij`, rows × patches.
    pub factors: Dense,
    /// `F_i0`: share of each row's hemisphere that sees no geometry, by rays that escape.
    pub sky_factor: Vec<f32>,
    /// Share of each row's rays that met something no patch owns.
    pub lost: Vec<f32>,
}

/// A way to estimate form factors.
pub trait Estimator: Sync {
    /// Checks that the settings suit the surfaces.
    ///
    /// # Errors
    /// [`transport::Error::Setting`] or [`Error::NoOutlines`].
    fn check(&self, surfaces: &Surfaces) -> Result<(), Error>;

    /// Writes `F_ij` of row i for every patch j into `factors[patches]` and returns (sky factor, lost share).
    fn row(&self, surfaces: &Surfaces, row: usize, factors: &mut [f32]) -> (f32, f32);
}

/// Cosine-weighted rays from the points of the row: each hit adds its share to the patch that owns it, each miss to the
/// sky. Row sums are exact; the cost is rows × rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hemisphere {
    /// Rays a row.
    pub rays: u32,
}

/// Pairs of points on both patches, `F_ij = 1/A_i ∫∫ V cosθ_i cosθ_j / (π r²)`: low-discrepancy pairs, drawn by solid
/// angle where the patches are near, up to `samples` a pair there and fewer where they are far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AreaToArea {
    /// Most pairs of points for a pair of patches.
    pub samples: u32,
    /// Rays a row to the sky.
    pub sky_rays: u32,
}

/// One ray from each point of the row to each centre: `F_ij = s_j cosθ_i cosθ_j V / (π r² + s_j)`, the disc form that
/// stays below 1 when the patches touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PointToPoint {
    /// Rays a row to the sky.
    pub sky_rays: u32,
}

/// Lambert's exact contour sum, averaged over the receiver by adaptive cubature, times the visible share of shadow
/// rays, weighted by the light they would carry: the reference for accuracy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contour {
    /// Shadow rays for a pair of patches.
    pub shadow_rays: u32,
    /// Rays a row to the sky.
    pub sky_rays: u32,
}

impl Default for Hemisphere {
    fn default() -> Self {
        Self { rays: 4096 }
    }
}

impl Default for AreaToArea {
    fn default() -> Self {
        Self { samples: 1 << 14, sky_rays: 256 }
    }
}

impl Default for PointToPoint {
    fn default() -> Self {
        Self { sky_rays: 256 }
    }
}

impl Default for Contour {
    fn default() -> Self {
        Self { shadow_rays: 16, sky_rays: 256 }
    }
}

fn check_rays(name: &'static str, value: u32) -> Result<(), Error> {
    if (1..=1 << 24).contains(&value) {
        Ok(())
    } else {
        Err(transport::Error::Setting { name, value: f64::from(value), rule: "in 1..=2^24" }.into())
    }
}

fn check_outlines(estimator: &'static str, surfaces: &Surfaces) -> Result<(), Error> {
    if surfaces.polygons.len() == surfaces.patches.len() { Ok(()) } else { Err(Error::NoOutlines { estimator }) }
}

fn hemisphere_params(surfaces: &Surfaces, row: usize, rays: u32) -> HemisphereParams {
    HemisphereParams {
        first_row: row as u32,
        row_count: 1,
        rays,
        patch_count: surfaces.patches.len() as u32,
        seed: surfaces.seed,
        ray_offset: surfaces.ray_offset,
        reserved: [0; 2],
    }
}

/// Parameters of the rays of a row with this key.
pub(super) fn numbered_params(surfaces: &Surfaces, key: RowKey, rays: u32) -> HemisphereParams {
    HemisphereParams { seed: key.seed, ..hemisphere_params(surfaces, 0, rays) }
}

/// Column of what ray `k` of a row meets: a patch, `patch_count` for the sky, `patch_count + 1` for what no patch owns.
fn hemisphere_column(s: &Surfaces, p: &HemisphereParams, row: usize, k: u32) -> u32 {
    let (origin, direction) = hemisphere_ray(p, s.offsets, s.points, row as u32, k);
    ray_column(s, p, origin, direction)
}

pub(super) fn ray_column(s: &Surfaces, p: &HemisphereParams, origin: Vec3, direction: Vec3) -> u32 {
    hit_column(s, p, &s.visibility.closest(origin, direction), direction)
}

/// Column of what a ray in this direction has met.
fn hit_column(s: &Surfaces, p: &HemisphereParams, hit: &Hit, direction: Vec3) -> u32 {
    if hit.is_miss() {
        return p.patch_count;
    }
    let id = (s.owner)(hit, direction);
    if id < p.patch_count { id } else { p.patch_count + 1 }
}

/// The rays of a row in an order in which neighbours have like directions (Morton's order of their Sobol points), so
/// that they walk through the same parts of the scene: a tenth faster in Sponza.
pub(super) fn like_rays(rays: u32) -> Vec<u32> {
    let spread = |x: u32| (0..16).fold(0, |spread, bit| spread | (x >> 16 >> bit & 1) << (2 * bit));
    let mut order: Vec<u32> = (0..rays).collect();
    order.sort_by_cached_key(|&k| {
        let (x, y) = sobol2(k);
        spread(x) << 1 | spread(y)
    });
    order
}

/// Columns of what these rays of a row meet, with the share of the row's energy that each carries.
pub(super) fn hemisphere_hits(s: &Surfaces, row: usize, order: &[u32]) -> Vec<(u32, f32)> {
    let p = hemisphere_params(s, row, order.len() as u32);
    let share = |k: u32| ray_share(&p, s.offsets, s.points, row as u32, k);
    order.iter().map(|&k| (hemisphere_column(s, &p, row, k), share(k))).collect()
}

/// [`hemisphere_hits`] of rays that somebody else has traced: what each of the row's rays meets.
pub(super) fn traced_hits(s: &Surfaces, row: usize, order: &[u32], hits: &[Hit]) -> Vec<(u32, f32)> {
    let p = hemisphere_params(s, row, order.len() as u32);
    let column = |k: u32| {
        let direction = hemisphere_ray(&p, s.offsets, s.points, row as u32, k).1;
        hit_column(s, &p, &hits[k as usize], direction)
    };
    order.iter().map(|&k| (column(k), ray_share(&p, s.offsets, s.points, row as u32, k))).collect()
}

/// Columns of what the rays of some rows meet, row by row.
pub(super) fn rows_hits(s: &Surfaces, rows: Range<usize>, rays: u32) -> Vec<u32> {
    let mut hits = vec![NONE; rows.len() * rays as usize];
    trace_rows(s, rows, rays, &mut |place, column, _| hits[place] = column);
    hits
}

/// Hits of rays in [`QUADRANTS`] rows for each point, one for each quadrant of the hemisphere, as in
/// [`transport::rotational_gradients`]. Rays that escape have the column [`first_sky_column`] plus the bin of their
/// direction.
pub(super) fn quadrant_hits(s: &Surfaces, rows: Range<usize>, rays: u32, sky_bin: &SkyBin) -> Vec<u32> {
    let mut quadrants = Quadrants::new(s, rows.clone(), rays, sky_bin);
    trace_rows(s, rows, rays, &mut |place, column, direction| quadrants.put(place, column, direction));
    quadrants.hits
}

/// [`quadrant_hits`] of rays that somebody else has traced: their columns, row by row.
pub(super) fn in_quadrants(s: &Surfaces, rows: Range<usize>, columns: &[u32], sky_bin: &SkyBin) -> Vec<u32> {
    let rays = (columns.len() / rows.len().max(1)) as u32;
    let p = hemisphere_params(s, rows.start, rays);
    let mut quadrants = Quadrants::new(s, rows.clone(), rays, sky_bin);
    for (place, &column) in columns.iter().enumerate() {
        let row = rows.start + place / rays as usize;
        let k = place as u32 % rays;
        quadrants.put(place, column, hemisphere_ray(&p, s.offsets, s.points, row as u32, k).1);
    }
    quadrants.hits
}

/// Hits of some rows, shared out over the quadrants of each.
struct Quadrants<'a> {
    hits: Vec<u32>,
    frames: Vec<(Vec3, Vec3)>,
    rays: usize,
    sky: u32,
    first_bin: u32,
    sky_bin: &'a SkyBin<'a>,
}

impl<'a> Quadrants<'a> {
    fn new(s: &Surfaces, rows: Range<usize>, rays: u32, sky_bin: &'a SkyBin) -> Self {
        Self {
            hits: vec![NONE; QUADRANTS * rows.len() * rays as usize],
            frames: rows.map(|row| frame(s.row_points(row)[0].normal)).collect(),
            rays: rays as usize,
            sky: s.patches.len() as u32,
            first_bin: first_sky_column(s),
            sky_bin,
        }
    }

    /// The ray at a place among those of all rows.
    fn put(&mut self, place: usize, column: u32, direction: Vec3) {
        let column = if column == self.sky { self.first_bin + (self.sky_bin)(direction) } else { column };
        let row = place / self.rays;
        let k = place % self.rays;
        let (right, up) = self.frames[row];
        self.hits[(QUADRANTS * row + quadrant_of(direction, right, up)) * self.rays + k] = column;
    }
}

/// A ray of a row, and its place among the rays of all rows.
struct RowRay {
    origin: Vec3,
    direction: Vec3,
    place: u32,
}

/// Calls `found(place, column, direction)` for each ray of some rows with what it meets; its place is `row · rays + k`.
/// Rays of like directions follow each other, those of all rows together: rows that are neighbours see the same parts
/// of the scene there.
fn trace_rows(s: &Surfaces, rows: Range<usize>, rays: u32, found: &mut dyn FnMut(usize, u32, Vec3)) {
    let p = hemisphere_params(s, rows.start, rays);
    let mut sorted: Vec<Vec<RowRay>> = (0..DIRECTION_CELLS).map(|_| Vec::new()).collect();
    for (number, row) in rows.enumerate() {
        for k in 0..rays {
            let (origin, direction) = hemisphere_ray(&p, s.offsets, s.points, row as u32, k);
            sorted[direction_cell(direction)].push(RowRay { origin, direction, place: number as u32 * rays + k });
        }
    }
    for ray in sorted.iter().flatten() {
        found(ray.place as usize, ray_column(s, &p, ray.origin, ray.direction), ray.direction);
    }
}

/// Cells along each axis in which directions are sorted, and all of them.
const DIRECTION_STEPS: usize = 8;
const DIRECTION_CELLS: usize = DIRECTION_STEPS * DIRECTION_STEPS * DIRECTION_STEPS;

/// The cell of a unit direction.
fn direction_cell(direction: Vec3) -> usize {
    let step = (direction * 0.5 + 0.5) * DIRECTION_STEPS as f32;
    let [x, y, z] = step.to_array().map(|x| (x as usize).min(DIRECTION_STEPS - 1));
    (x * DIRECTION_STEPS + y) * DIRECTION_STEPS + z
}

/// The bin of a unit direction in which a ray escapes.
pub type SkyBin<'a> = dyn Fn(Vec3) -> u32 + Sync + 'a;

/// Column of the sky's first bin: behind the patches and what no patch owns.
pub(super) fn first_sky_column(s: &Surfaces) -> u32 {
    s.patches.len() as u32 + EXTRA_COLUMNS
}

/// Share of the row's hemisphere that sees no geometry, by `rays` rays.
fn sky_factor(surfaces: &Surfaces, row: usize, rays: u32) -> f32 {
    let p = hemisphere_params(surfaces, row, rays);
    let escaped = (0..rays)
        .filter(|&k| {
            let (origin, direction) = hemisphere_ray(&p, surfaces.offsets, surfaces.points, row as u32, k);
            surfaces.visibility.closest(origin, direction).is_miss()
        })
        .count();
    escaped as f32 / rays as f32
}

impl Estimator for Hemisphere {
    fn check(&self, _: &Surfaces) -> Result<(), Error> {
        check_rays("rays", self.rays)
    }

    fn row(&self, s: &Surfaces, row: usize, factors: &mut [f32]) -> (f32, f32) {
        let p = hemisphere_params(s, row, self.rays);
        let ids: Vec<u32> = (0..self.rays).map(|k| hemisphere_column(s, &p, row, k)).collect();
        let n = factors.len();
        let mut whole = vec![0.0; n + EXTRA_COLUMNS as usize];
        hemisphere_row(&p, s.offsets, s.points, &ids, 0, &mut whole);
        factors.copy_from_slice(&whole[..n]);
        (whole[n], whole[n + 1])
    }
}

impl Estimator for AreaToArea {
    fn check(&self, surfaces: &Surfaces) -> Result<(), Error> {
        check_rays("samples", self.samples)?;
        check_rays("sky_rays", self.sky_rays)?;
        check_outlines("AreaToArea", surfaces)
    }

    fn row(&self, s: &Surfaces, row: usize, factors: &mut [f32]) -> (f32, f32) {
        let points = s.row_points(row);
        for (j, out) in factors.iter_mut().enumerate() {
            let source = &s.polygons[j];
            let shift = shift(s, row, j);
            *out = match s.row_polygons.get(row) {
                Some(receiver) => {
                    let (Some(r), Some(t)) = cut(receiver, source) else { continue };
                    let visible = |a: DVec3, b: DVec3| sees(s, a, receiver.normal, b, source.normal);
                    area::patch_to_patch(&r, &t, receiver.area, self.samples, shift, &visible) as f32
                }
                None => {
                    let each = (self.samples / points.len() as u32).max(1);
                    weighted(points, |position, normal| {
                        let Some(part) = source.clip(position, normal) else { return 0.0 };
                        let visible = |a: DVec3, b: DVec3| sees(s, a, normal, b, source.normal);
                        area::point_to_patch(position, normal, &part, each, shift, &visible)
                    })
                }
            };
        }
        (sky_factor(s, row, self.sky_rays), 0.0)
    }
}

impl Estimator for PointToPoint {
    fn check(&self, _: &Surfaces) -> Result<(), Error> {
        check_rays("sky_rays", self.sky_rays)
    }

    fn row(&self, s: &Surfaces, row: usize, factors: &mut [f32]) -> (f32, f32) {
        let points = s.row_points(row);
        for (patch, out) in s.patches.iter().zip(factors.iter_mut()) {
            let centre = patch.centroid.as_dvec3();
            let there = patch.normal.as_dvec3();
            *out = weighted(points, |position, normal| {
                let to = centre - position;
                let squared = to.length_squared();
                let cos_here = to.dot(normal);
                let cos_there = -to.dot(there);
                if cos_here <= 0.0 || cos_there <= 0.0 || !sees(s, position, normal, centre, there) {
                    return 0.0;
                }
                let area = f64::from(patch.area);
                area * cos_here * cos_there / (squared * (core::f64::consts::PI * squared + area))
            });
        }
        (sky_factor(s, row, self.sky_rays), 0.0)
    }
}

impl Contour {
    /// Share of the light between two surfaces that is not blocked, from weighted shadow rays.
    fn visible_share(&self, s: &Surfaces, row: usize, j: usize, point: impl Fn(f64, f64) -> (DVec3, DVec3)) -> f64 {
        let source = &s.polygons[j];
        let shift = shift(s, row, j);
        let mut seen = 0.0;
        let mut all = 0.0;
        for k in 0..self.shadow_rays {
            let x = area::recurrence(u64::from(k), shift);
            let (from, normal) = point(x[0], x[1]);
            let to = area::polygon_point(source, x[2], x[3]);
            let here = (to - from).dot(normal);
            let there = (from - to).dot(source.normal);
            if here <= 0.0 || there <= 0.0 {
                continue;
            }
            let squared = (to - from).length_squared();
            let weight = here * there / (squared * (core::f64::consts::PI * squared + source.area));
            all += weight;
            if sees(s, from, normal, to, source.normal) {
                seen += weight;
            }
        }
        if all > 0.0 { seen / all } else { 0.0 }
    }
}

impl Estimator for Contour {
    fn check(&self, surfaces: &Surfaces) -> Result<(), Error> {
        check_rays("shadow_rays", self.shadow_rays)?;
        check_rays("sky_rays", self.sky_rays)?;
        check_outlines("Contour", surfaces)
    }

    fn row(&self, s: &Surfaces, row: usize, factors: &mut [f32]) -> (f32, f32) {
        let points = s.row_points(row);
        for (j, out) in factors.iter_mut().enumerate() {
            let source = &s.polygons[j];
            *out = match s.row_polygons.get(row) {
                Some(receiver) => {
                    let (Some(r), Some(t)) = cut(receiver, source) else { continue };
                    let whole = contour::polygon_to_polygon(&r, &t, receiver.area);
                    (whole * self.visible_share(s, row, j, |x, y| (area::polygon_point(&r, x, y), r.normal))) as f32
                }
                None => {
                    let share = self.visible_share(s, row, j, |x, _| {
                        let p = points[((x * points.len() as f64) as usize).min(points.len() - 1)];
                        (p.position.as_dvec3(), p.normal.as_dvec3())
                    });
                    let whole = weighted(points, |p, n| contour::point_to_polygon(p, n, source));
                    (f64::from(whole) * share) as f32
                }
            };
        }
        (sky_factor(s, row, self.sky_rays), 0.0)
    }
}

/// Both polygons without what lies behind the other's plane.
fn cut(receiver: &Polygon, source: &Polygon) -> (Option<Polygon>, Option<Polygon>) {
    let r = receiver.clip(source.centroid, source.normal);
    if r.is_none() {
        return (None, None);
    }
    (r, source.clip(receiver.centroid, receiver.normal))
}

/// Mean over the points of a row by their weights.
fn weighted(points: &[SurfacePoint], value: impl Fn(DVec3, DVec3) -> f64) -> f32 {
    let mut sum = 0.0;
    let mut weights = 0.0;
    for p in points {
        sum += f64::from(p.weight) * value(p.position.as_dvec3(), p.normal.as_dvec3());
        weights += f64::from(p.weight);
    }
    (sum / weights) as f32
}

/// All rows of form factors, on all cores, the same bytes for any number of threads. `progress(done, total)` is called
/// after every row, from any thread; breaking it cancels.
///
/// # Errors
/// What is wrong with the surfaces or the settings, [`transport::Error::Cancelled`].
pub fn form_factors(
    estimator: &dyn Estimator,
    surfaces: &Surfaces,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<FactorRows, Error> {
    let mut out = FactorRows::default();
    form_factor_blocks(estimator, surfaces, surfaces.rows().max(1), progress, |_, block| {
        out = block;
        Ok(())
    })?;
    Ok(out)
}

/// As [`form_factors`], in blocks of `block_rows` rows that are handed to `sink(first_row, block)` in order, so that no
/// more than one block is in memory.
///
/// # Errors
/// As [`form_factors`], [`transport::Error::Setting`] for blocks of no rows, and what `sink` returns.
pub fn form_factor_blocks(
    estimator: &dyn Estimator,
    surfaces: &Surfaces,
    block_rows: usize,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
    mut sink: impl FnMut(usize, FactorRows) -> Result<(), Error>,
) -> Result<(), Error> {
    check_surfaces(surfaces)?;
    estimator.check(surfaces)?;
    if block_rows == 0 {
        return Err(transport::Error::Setting { name: "block_rows", value: 0.0, rule: "at least 1" }.into());
    }
    let total = surfaces.rows();
    let columns = surfaces.patches.len();
    let done = AtomicUsize::new(0);
    let cancelled = AtomicBool::new(false);
    for first in (0..total).step_by(block_rows) {
        let rows = block_rows.min(total - first);
        let mut block =
            FactorRows { factors: Dense::zeros(rows, columns), sky_factor: vec![0.0; rows], lost: vec![0.0; rows] };
        let mut lines: Vec<&mut [f32]> = match columns {
            0 => (0..rows).map(|_| Default::default()).collect(),
            _ => block.factors.values.chunks_mut(columns).collect(),
        };
        let shares = block.sky_factor.par_iter_mut().zip(block.lost.par_iter_mut());
        lines.par_iter_mut().zip(shares).enumerate().for_each(|(k, (line, (sky, lost)))| {
            if cancelled.load(Ordering::Relaxed) {
                return;
            }
            (*sky, *lost) = estimator.row(surfaces, first + k, line);
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            if progress(count, total).is_break() {
                cancelled.store(true, Ordering::Relaxed);
            }
        });
        if cancelled.load(Ordering::Relaxed) {
            return Err(transport::Error::Cancelled { done: done.load(Ordering::Relaxed), total }.into());
        }
        sink(first, block)?;
    }
    Ok(())
}
