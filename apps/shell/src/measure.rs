//! Loss by storing an operator: errors of irradiance under some lights, and pictures of the matrix.

use std::f32::consts::LN_10;

use glam::{Vec3, Vec4};
use multibounce::kernel::feedback::change;
use multibounce::{
    Acceleration, BlockCodec, BlockMatrix, BlockSettings, Channels, MatrixRows, greedy_order, picture, projected_order,
};
use patches::PatchMesh;
use patchlight::bake::direct_params;
use patchlight::debug::DebugPicture;
use patchlight::low_level::operator::{PatchOperator, SymmetricFactors};
use reference::Picture;
use scene::Scene;
use scene::gpu::DirectParams;
use scene::kernel::shade::decode_srgb;
use scene::math::ln;
use scene::sampling::{hash3, unit};
use transport::{LinearOperator, Permutation};

use crate::error::Error;
use crate::progress::Progress;

/// Compact lights, and the share of the patches that each lights.
const LIGHTS: u32 = 8;
const LIT_SHARE: usize = 50;
/// Weight of a difference of normals beside a distance when patches of a light are chosen, m.
const NORMAL_WEIGHT: f32 = 2.0;
/// Greatest edge of a picture of a matrix, pixels.
const MAX_PIXELS: usize = 1024;
/// Black is so many powers of ten below white.
const DECADES: f32 = 5.0;
/// Most bounces that are tried.
const MAX_BOUNCES: usize = 1000;
/// Bounces in a row that count as for good.
const STAYS: usize = 4;
/// Rows of tiles from which the errors of orders are estimated.
const TILE_ROWS: usize = 16;
/// Most patches for which the exact greedy order is found, in O(n³).
const MAX_GREEDY: usize = 1600;

/// First exitance of the patches under the lights of the scene, W/m², by so many rays a sample.
pub fn own_light(scene: &Scene, mesh: &PatchMesh, sample_rays: u32, seed: u32) -> Vec<Vec4> {
    let direct = DirectParams {
        count: mesh.points.len() as u32,
        area_rays: sample_rays,
        sky_rays: if scene.lighting.sky.map_width == 0 { 0 } else { sample_rays },
        seed,
        ..direct_params(scene)
    };
    mesh.source(&scene.direct_irradiance(&direct, &mesh.points))
}

/// Bounces after which exitance that began with none is within a share of where it settles, by its
/// length, for good.
pub struct Settling<'a> {
    /// The share.
    pub share: f32,
    /// Reflectance of the patches.
    pub albedo: &'a [Vec4],
    /// First exitance, W/m².
    pub source: &'a [Vec4],
    /// Form factors.
    pub factors: &'a dyn LinearOperator,
}

impl Settling<'_> {
    /// The bounces of two accelerations; where light settles is found with the second.
    ///
    /// # Errors
    /// Form factors that are not those of so many patches.
    pub fn bounces(&self, accelerations: [Acceleration; 2]) -> Result<[usize; 2], Error> {
        let settled = self.settle(&accelerations[1])?;
        let near = f64::from(self.share) * length(&settled);
        let mut bounces = [0; 2];
        for (bounces, acceleration) in bounces.iter_mut().zip(&accelerations) {
            *bounces = self.bounces_until(acceleration, &settled, near)?;
        }
        Ok(bounces)
    }

    /// Limit of the light, W/m².
    fn settle(&self, acceleration: &Acceleration) -> Result<Vec<Vec4>, Error> {
        let mut settled = vec![Vec4::ZERO; self.source.len()];
        self.bounce(acceleration, &mut |light| {
            let moved = distance(light, &settled);
            settled.copy_from_slice(light);
            moved <= 1e-6 * length(light)
        })?;
        Ok(settled)
    }

    fn bounces_until(&self, acceleration: &Acceleration, settled: &[Vec4], near: f64) -> Result<usize, Error> {
        let mut done = 0;
        let mut stayed = 0;
        self.bounce(acceleration, &mut |light| {
            done += 1;
            stayed = if distance(light, settled) <= near { stayed + 1 } else { 0 };
            stayed == STAYS
        })?;
        Ok(done - stayed + 1)
    }

    /// Bounces until `is_last` says so of their exitance.
    fn bounce(&self, acceleration: &Acceleration, is_last: &mut dyn FnMut(&[Vec4]) -> bool) -> Result<(), Error> {
        let n = self.source.len();
        let params = acceleration.params(n as u32);
        let mut light = vec![Vec4::ZERO; n];
        let mut last = vec![Vec4::ZERO; n];
        let mut irradiance = vec![Vec4::ZERO; n];
        for _ in 0..MAX_BOUNCES {
            self.factors.apply(&light, &mut irradiance)?;
            for i in 0..n {
                last[i] = change(&params, self.source[i], self.albedo[i], irradiance[i], light[i], last[i]);
                light[i] += last[i];
            }
            if is_last(&light) {
                break;
            }
        }
        Ok(())
    }
}

/// L2 distance of RGB values.
fn distance(a: &[Vec4], b: &[Vec4]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from((*a - *b).truncate().length_squared())).sum::<f64>().sqrt()
}

/// L2 length of RGB values.
fn length(a: &[Vec4]) -> f64 {
    a.iter().map(|a| f64::from(a.truncate().length_squared())).sum::<f64>().sqrt()
}

/// Exitances of 1 W/m² of the patches about some random ones, a fiftieth of all patches each.
pub fn compact_lights(mesh: &PatchMesh, seed: u32) -> Vec<Vec<Vec4>> {
    let count = if mesh.patches.is_empty() { 0 } else { LIGHTS };
    (0..count).map(|light| compact_light(mesh, light, seed)).collect()
}

fn compact_light(mesh: &PatchMesh, light: u32, seed: u32) -> Vec<Vec4> {
    let n = mesh.patches.len();
    let centre = (unit(hash3(light, 0, seed ^ 0x6c69)) * n as f32) as usize;
    let at = &mesh.patches[centre.min(n - 1)];
    let far: Vec<f32> = mesh
        .patches
        .iter()
        .map(|p| p.centroid.distance(at.centroid) + NORMAL_WEIGHT * p.normal.distance(at.normal))
        .collect();
    let mut order: Vec<u32> = (0..n as u32).collect();
    order.sort_by(|&a, &b| far[a as usize].total_cmp(&far[b as usize]).then(a.cmp(&b)));
    let mut source = vec![Vec4::ZERO; n];
    for &i in order.iter().take(n.div_ceil(LIT_SHARE)) {
        source[i as usize] = Vec4::ONE.with_w(0.0);
    }
    source
}

/// Orders of rows and columns that blocks can have: the patches' own, one by chance, that of tiles,
/// that of blocks, and for few patches the one of the thesis.
///
/// # Errors
/// An order that is none.
pub fn block_orders(
    rows: &MatrixRows,
    factors: &SymmetricFactors,
    seed: u32,
    progress: &Progress,
) -> Result<Vec<(&'static str, Permutation)>, Error> {
    progress.phase("orders", |_| {
        let n = factors.area.len();
        let mut random: Vec<u32> = (0..n as u32).collect();
        random.sort_by_key(|&i| (hash3(i, 0, seed ^ 0x6f72), i));
        let mut orders = vec![
            ("given", Permutation::identity(n)),
            ("random", Permutation::new(random)?),
            ("halving", Permutation::new(factors.order.clone())?),
            ("projected", projected_order(n, rows, seed)),
        ];
        if n <= MAX_GREEDY {
            orders.push(("greedy", greedy_order(n, rows)));
        }
        Ok(orders)
    })
}

/// Mean squared error of the entries in blocks for each order, from some of the rows.
///
/// # Errors
/// Cancellation.
pub fn order_errors(
    codec: BlockCodec,
    rows: &MatrixRows,
    orders: &[(&'static str, Permutation)],
    progress: &Progress,
) -> Result<Vec<(&'static str, f64)>, Error> {
    let settings = BlockSettings::of(codec);
    progress.phase("orders", |report| {
        let mut errors = Vec::with_capacity(orders.len());
        for (name, order) in orders {
            let step = (order.len() / settings.tile / TILE_ROWS).max(1);
            errors.push((*name, BlockMatrix::order_mse(order.len(), rows, order, settings, step, &report)?));
        }
        Ok(errors)
    })
}

/// Pictures of an operator without compression: in the order of the patches and, where the operator
/// has one, in its own, and of what is lost. Grey tells the power of ten, from five powers of ten below
/// the greatest pixel; each pixel is a mean.
///
/// # Errors
/// An order that is none.
pub fn matrix_pictures(
    operator: &PatchOperator,
    channels: Channels,
    factors: &SymmetricFactors,
) -> Result<Vec<DebugPicture>, Error> {
    let n = operator.patches();
    let exact = factors.rows(channels);
    let difference = |i: usize, row: &mut [Vec3]| {
        let mut right = vec![Vec3::ZERO; n];
        exact(i, &mut right);
        operator.row(i, row);
        row.iter_mut().zip(right).for_each(|(entry, right)| *entry = (*entry - right).abs());
    };
    let before = pixels(n, &exact, &Permutation::identity(n));
    let order = operator.order()?;
    let after = order.as_ref().map(|order| pixels(n, &exact, order));
    let error = pixels(n, &difference, order.as_ref().unwrap_or(&Permutation::identity(n)));
    // One scale for all of them.
    let greatest = before.iter().chain(after.iter().flatten()).fold(f32::MIN_POSITIVE, |a, &b| a.max(b));
    let mut pictures = Vec::new();
    for (name, pixels) in [("matrix", Some(before)), ("matrix-reordered", after), ("matrix-error", Some(error))] {
        if let Some(pixels) = pixels {
            let edge = n.min(MAX_PIXELS) as u32;
            let picture = Picture::from_pixels(edge, edge, pixels.iter().map(|&mean| grey(mean, greatest)).collect())?;
            pictures.push(DebugPicture { name, picture, stops: 0.0 });
        }
    }
    Ok(pictures)
}

/// Mean of the channels of each pixel.
fn pixels(n: usize, rows: &MatrixRows, order: &Permutation) -> Vec<f32> {
    picture(n, rows, order, MAX_PIXELS).iter().map(|color| color.element_sum() / 3.0).collect()
}

/// The colour of a mean beside the greatest one.
fn grey(mean: f32, greatest: f32) -> Vec3 {
    let share = 1.0 + ln((mean / greatest).max(f32::MIN_POSITIVE)) / (DECADES * LN_10);
    Vec3::splat(decode_srgb(share.clamp(0.0, 1.0)))
}
