//! The light between patches as one operator: all bounces in a product, or a bounce of any reflectance.

use formfactor::{Csr, reciprocal};
use glam::{Vec3, Vec4};
use multibounce::{Channels, Factors, Tiles, all_bounces, halving_order, some_bounces};

use super::senders::Senders;
use super::{go_on, proceed};
use crate::error::Error;
use crate::progress::Progress;

/// How light goes from patch to patch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Transport {
    /// A product with the sparse form factors for each bounce.
    #[default]
    Classic,
    /// One product with the compressed operator of all bounces.
    Tiles {
        /// Relative Frobenius error of the operator.
        epsilon: f64,
    },
    /// One product a frame with the compressed form factors, from the light of the frame before.
    Feedback {
        /// Relative Frobenius error of the form factors.
        epsilon: f64,
    },
}

/// Bounces that do not go from patch to patch: to the facets, and to the receivers.
pub(super) const LAST_BOUNCES: u32 = 2;

/// The operator that a frame multiplies by; none for classic radiosity, and for so few bounces that patches need none.
/// `bounces` counts the last two, which end at facets and receivers, unless the patches are the receivers.
pub(super) fn compress(
    transport: Transport,
    senders: &Senders,
    factors: &Csr,
    bounces: Option<u32>,
    at_patches: bool,
    progress: &mut Progress,
) -> Result<Option<Tiles>, Error> {
    let (epsilon, is_feedback) = match transport {
        Transport::Classic => return Ok(None),
        Transport::Tiles { epsilon } => (epsilon, false),
        Transport::Feedback { epsilon } => (epsilon, true),
    };
    let last = if at_patches { 0 } else { LAST_BOUNCES };
    if bounces.is_some_and(|bounces| bounces <= last) || senders.patches.is_empty() {
        return Ok(None);
    }
    let balanced = reciprocal(factors, &senders.areas())?;
    let rows = &balanced.factors;
    let given =
        Factors { row_start: &rows.row_start, columns: &rows.column_index, values: &rows.values, area: &balanced.area };
    let symmetric = given.symmetric()?;
    let positions: Vec<Vec3> = senders.patches.iter().map(|p| p.centroid).collect();
    let normals: Vec<Vec3> = senders.patches.iter().map(|p| p.normal).collect();
    let order = halving_order(&positions, &normals);
    let operators = match is_feedback {
        true => Vec::new(),
        false => progress.phase("operator", |report| -> Result<Vec<_>, Error> {
            let mut made = Vec::new();
            for channel in 0..3 {
                let albedo: Vec<f32> = senders.albedo.iter().map(|rho: &Vec4| rho[channel]).collect();
                made.push(match bounces {
                    None => all_bounces(&symmetric, &albedo)?,
                    Some(bounces) => some_bounces(&symmetric, &albedo, bounces - last, &go_on)?,
                });
                if !report((channel + 1) as f32 / 3.0) {
                    return Err(Error::Cancelled);
                }
            }
            Ok(made)
        })?,
    };
    let channels = match &operators[..] {
        [red, green, blue] => Channels::Three([red, green, blue]),
        _ => Channels::One(&symmetric),
    };
    let tiles = progress.phase("compress", |report| {
        Tiles::encode(channels, &balanced.area, &order, epsilon, &|done, total| proceed(report, done, total))
    })?;
    let report = &tiles.report;
    progress.note(&format!(
        "operator: {:.2} MB (stored {:.2} MB), relative error {:.2} / {:.2} / {:.2} %, {} components and {} entries in {} \
         tiles, ranks up to {}",
        tiles.bytes().iter().map(|part| part.1 as f64).sum::<f64>() * 1e-6,
        tiles.stored_bytes() as f64 * 1e-6,
        100.0 * report.error[0],
        100.0 * report.error[1],
        100.0 * report.error[2],
        report.components.iter().sum::<usize>(),
        report.entries,
        report.tiles.iter().sum::<usize>(),
        report.most_rank
    ));
    Ok(Some(tiles))
}
