//! What is lost by storing an operator: errors of irradiance under some lights, and pictures of the matrix.

use std::f32::consts::LN_10;

use faer::Mat;
use glam::{Vec3, Vec4};
use multibounce::kernel::feedback::change;
use multibounce::{
    Acceleration, BlockCodec, BlockMatrix, BlockSettings, Channels, MatrixRows, Permutation, greedy_order, picture,
    projected_order,
};
use rayon::prelude::*;
use reference::Picture;
use scene::Scene;
use scene::kernel::shade::decode_srgb;
use scene::math::ln;
use scene::sampling::{hash3, unit};

use super::{Between, PatchOperator};
use crate::error::Error;
use crate::progress::Progress;
use crate::render::classic::{ClassicSettings, direct_params};
use crate::render::debug::DebugPicture;
use crate::render::proceed;
use crate::render::senders::Senders;

/// Compact lights, and the share of the patches that each lights.
const LIGHTS: u32 = 8;
const LIT_SHARE: usize = 50;
/// What a turn of the normal counts beside a distance when patches of a light are chosen, m.
const TURN: f32 = 2.0;
/// Greatest edge of a picture of a matrix, pixels.
const MOST_PIXELS: usize = 1024;
/// Black is so many powers of ten below white.
const DECADES: f32 = 5.0;

/// First exitance under the lights of the scene, W/m².
pub fn own_light(scene: &Scene, senders: &Senders, settings: &ClassicSettings) -> Vec<Vec4> {
    let direct = scene::DirectParams {
        count: senders.points.len() as u32,
        area_rays: settings.sample_rays,
        sky_rays: if scene.lighting.sky.map_width == 0 { 0 } else { settings.sample_rays },
        seed: settings.seed,
        ..direct_params(scene)
    };
    senders.source(&scene.direct_irradiance(&direct, &senders.points))
}

/// Most bounces that are tried.
const MOST_BOUNCES: usize = 1000;

/// Bounces after which exitance that began with none is within `share` of where it settles, by its length, for good; and where
/// that is. `product` multiplies by form factors.
pub fn bounces_until(
    share: f32,
    albedo: &[Vec4],
    source: &[Vec4],
    accelerations: [Acceleration; 2],
    product: &impl Fn(&[Vec4], &mut [Vec4]) -> Result<(), Error>,
) -> Result<[usize; 2], Error> {
    let n = source.len();
    let run = |acceleration: Acceleration, each: &mut dyn FnMut(&[Vec4]) -> bool| -> Result<(), Error> {
        let p = acceleration.params(n as u32);
        let (mut light, mut last, mut irradiance) = (vec![Vec4::ZERO; n], vec![Vec4::ZERO; n], vec![Vec4::ZERO; n]);
        for _ in 0..MOST_BOUNCES {
            product(&light, &mut irradiance)?;
            for i in 0..n {
                last[i] = change(&p, source[i], albedo[i], irradiance[i], light[i], last[i]);
                light[i] += last[i];
            }
            if each(&light) {
                break;
            }
        }
        Ok(())
    };
    let distance = |a: &[Vec4], b: &[Vec4]| -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from((*a - *b).truncate().length_squared())).sum::<f64>().sqrt()
    };
    let mut settled = vec![Vec4::ZERO; n];
    run(accelerations[1], &mut |light| {
        let moved = distance(light, &settled);
        settled.copy_from_slice(light);
        moved <= 1e-6 * distance(light, &vec![Vec4::ZERO; n])
    })?;
    let near = f64::from(share) * distance(&settled, &vec![Vec4::ZERO; n]);
    let mut bounces = [0; 2];
    for (bounces, acceleration) in bounces.iter_mut().zip(accelerations) {
        let (mut done, mut stayed) = (0, 0);
        run(acceleration, &mut |light| {
            done += 1;
            stayed = if distance(light, &settled) <= near { stayed + 1 } else { 0 };
            stayed == STAYS
        })?;
        *bounces = done - stayed + 1;
    }
    Ok(bounces)
}

/// Bounces in a row that count as for good.
const STAYS: usize = 4;

/// Exitances of 1 W/m² of the patches about some random ones, a fiftieth of all patches each.
pub fn compact_lights(senders: &Senders, seed: u32) -> Vec<Vec<Vec4>> {
    let n = senders.patches.len();
    let light = |light: u32| {
        let centre = (unit(hash3(light, 0, seed ^ 0x6c69)) * n as f32) as usize;
        let at = &senders.patches[centre.min(n - 1)];
        let far = |i: &u32| {
            let p = &senders.patches[*i as usize];
            p.centroid.distance(at.centroid) + TURN * p.normal.distance(at.normal)
        };
        let mut order: Vec<u32> = (0..n as u32).collect();
        order.sort_by(|a, b| far(a).total_cmp(&far(b)).then(a.cmp(b)));
        let mut source = vec![Vec4::ZERO; n];
        order.iter().take(n.div_ceil(LIT_SHARE)).for_each(|&i| source[i as usize] = Vec4::ONE.with_w(0.0));
        source
    };
    (0..if n > 0 { LIGHTS } else { 0 }).map(light).collect()
}

/// Rows of tiles from which the errors of orders are estimated.
const TILE_ROWS: usize = 16;
/// Most patches for which the exact greedy order is found, in O(n³).
const MOST_GREEDY: usize = 1600;

/// Orders of rows and columns that blocks can have: the patches' own, one by chance, that of tiles, that of blocks, and for few
/// patches the one of the thesis.
pub fn block_orders(
    rows: &MatrixRows,
    between: &Between,
    seed: u32,
    progress: &mut Progress,
) -> Result<Vec<(&'static str, Permutation)>, Error> {
    progress.phase("orders", |_| {
        let n = between.area.len();
        let mut random: Vec<u32> = (0..n as u32).collect();
        random.sort_by_key(|&i| (hash3(i, 0, seed ^ 0x6f72), i));
        let mut orders = vec![
            ("given", Permutation::identity(n)),
            ("random", Permutation::new(random)?),
            ("halving", Permutation::new(between.order.clone())?),
            ("projected", projected_order(n, rows, seed)),
        ];
        if n <= MOST_GREEDY {
            orders.push(("greedy", greedy_order(n, rows)));
        }
        Ok(orders)
    })
}

/// Mean squared error of the entries in blocks for each order, from some of the rows.
pub fn order_errors(
    codec: BlockCodec,
    rows: &MatrixRows,
    orders: &[(&'static str, Permutation)],
    progress: &mut Progress,
) -> Result<Vec<(&'static str, f64)>, Error> {
    let settings = BlockSettings::of(codec);
    progress.phase("orders", |report| {
        let proceed = |done, total| proceed(report, done, total);
        let mse = |order: &Permutation| {
            let step = (order.len() / settings.tile / TILE_ROWS).max(1);
            BlockMatrix::order_mse(order.len(), rows, order, settings, step, &proceed)
        };
        orders.iter().map(|(name, order)| Ok((*name, mse(order)?))).collect()
    })
}

/// Irradiance by an operator that is not compressed, W/m².
pub fn exact_product(channels: Channels, area: &[f32], source: &[Vec4]) -> Vec<Vec4> {
    let root: Vec<f32> = area.iter().map(|&a| scene::math::sqrt(a)).collect();
    let one = |symmetric: &Mat<f32>, c: usize| symmetric * faer::Col::from_fn(root.len(), |i| source[i][c] * root[i]);
    let [r, g, b] = match channels {
        Channels::One(all) => [all; 3],
        Channels::Three(each) => each,
        Channels::Stored(each) => {
            // What cannot be read is no number.
            let one = |c: usize| {
                let (light, mut out) =
                    (Vec::from_iter((0..root.len()).map(|i| source[i][c] * root[i])), vec![0.0; root.len()]);
                if each[c].product(&light, &mut out).is_err() {
                    out.fill(f32::NAN);
                }
                out
            };
            let (r, g, b) = (one(0), one(1), one(2));
            return (0..root.len()).map(|i| Vec4::new(r[i], g[i], b[i], 0.0) / root[i]).collect();
        }
        Channels::Factors(factors) => {
            let row = |i| factors.row(i).map(|(j, f)| (source[j] * f).truncate().extend(0.0)).sum();
            return (0..area.len()).into_par_iter().map(row).collect();
        }
    };
    let (r, g, b) = (one(r, 0), one(g, 1), one(b, 2));
    (0..root.len()).map(|i| Vec4::new(r[i], g[i], b[i], 0.0) / root[i]).collect()
}

/// Relative error of irradiance, L2 by area, the greatest of the channels.
pub fn relative_error(ours: &[Vec4], exact: &[Vec4], area: &[f32]) -> f64 {
    let error = |c: usize| {
        let (mut wrong, mut whole) = (0.0, 0.0);
        for ((h, x), a) in ours.iter().zip(exact).zip(area) {
            wrong += f64::from(*a) * f64::from(h[c] - x[c]).powi(2);
            whole += f64::from(*a) * f64::from(x[c]).powi(2);
        }
        if whole > 0.0 { (wrong / whole).sqrt() } else { 0.0 }
    };
    error(0).max(error(1)).max(error(2))
}

/// Pictures of an operator without compression: in the order of the patches and, where the operator has one, in its own,
/// and of what is lost. Grey tells the power of ten, from [`DECADES`] below the greatest pixel; each pixel is a mean.
pub fn matrix_pictures(
    operator: &PatchOperator,
    channels: Channels,
    between: &Between,
) -> Result<Vec<DebugPicture>, Error> {
    let (n, exact, stored) = (operator.patches(), between.rows(channels), operator.rows());
    let difference = |i: usize, row: &mut [Vec3]| {
        let mut right = vec![Vec3::ZERO; n];
        exact(i, &mut right);
        stored(i, row);
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
            let edge = n.min(MOST_PIXELS) as u32;
            let grey = |mean: &f32| {
                let share = 1.0 + ln((*mean / greatest).max(f32::MIN_POSITIVE)) / (DECADES * LN_10);
                Vec3::splat(decode_srgb(share.clamp(0.0, 1.0)))
            };
            let picture = Picture::from_pixels(edge, edge, pixels.iter().map(grey).collect())?;
            pictures.push(DebugPicture { name, picture, stops: 0.0 });
        }
    }
    Ok(pictures)
}

/// Mean of the channels of each pixel.
fn pixels(n: usize, rows: &MatrixRows, order: &Permutation) -> Vec<f32> {
    picture(n, rows, order, MOST_PIXELS).iter().map(|color| color.element_sum() / 3.0).collect()
}
