//! The light between patches as one operator: all bounces in a product, or a bounce of any reflectance.

use faer::Mat;
use formfactor::{Csr, Reciprocal, reciprocal};
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

/// Dense matrices of single precision at the peak: F, three operators, three of the solver; F alone.
pub(crate) const MATRICES: usize = 7;
const FEEDBACK_MATRICES: usize = 1;

/// Whether so many matrices fit into the memory that is free, where the system says how much that is.
pub(crate) fn check_memory(patches: usize, matrices: usize, instead: &'static str) -> Result<(), Error> {
    let needed = (matrices * size_of::<f32>()) as f64 * (patches as f64).powi(2) * 1e-9;
    match available_memory() {
        Some(bytes) if needed > bytes as f64 * 1e-9 => {
            Err(Error::OperatorMemory { patches, needed, available: bytes as f64 * 1e-9, instead })
        }
        _ => Ok(()),
    }
}

/// Bytes of memory that are free for new work, on Linux.
fn available_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

/// The exchange between patches in symmetric form.
pub(crate) struct Between {
    /// Reciprocal form factors.
    pub factors: Csr,
    /// Areas by which they are, m².
    pub area: Vec<f32>,
    /// `a^½ F a^-½`.
    pub symmetric: Mat<f32>,
    /// Order in which neighbours are alike.
    pub order: Vec<u32>,
}

impl Between {
    pub fn new(senders: &Senders, factors: &Csr) -> Result<Self, Error> {
        let Reciprocal { factors, area, .. } = reciprocal(factors, &senders.areas())?;
        let Csr { row_start, column_index, values, .. } = &factors;
        let symmetric = Factors { row_start, columns: column_index, values, area: &area }.symmetric()?;
        let positions: Vec<Vec3> = senders.patches.iter().map(|p| p.centroid).collect();
        let normals: Vec<Vec3> = senders.patches.iter().map(|p| p.normal).collect();
        let order = halving_order(&positions, &normals);
        Ok(Self { factors, area, symmetric, order })
    }

    /// The symmetric operators of so many bounces, or of all, for red, green and blue.
    pub fn bounces(
        &self,
        albedo: &[Vec4],
        bounces: Option<u32>,
        progress: &mut Progress,
    ) -> Result<Vec<Mat<f32>>, Error> {
        progress.phase("operator", |report| {
            let mut made = Vec::new();
            for channel in 0..3 {
                let albedo: Vec<f32> = albedo.iter().map(|rho| rho[channel]).collect();
                made.push(match bounces {
                    None => all_bounces(&self.symmetric, &albedo)?,
                    Some(bounces) => some_bounces(&self.symmetric, &albedo, bounces, &go_on)?,
                });
                if !report((channel + 1) as f32 / 3.0) {
                    return Err(Error::Cancelled);
                }
            }
            Ok(made)
        })
    }
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
    let instead = if is_feedback { "classic" } else { "feedback" };
    check_memory(senders.patches.len(), if is_feedback { FEEDBACK_MATRICES } else { MATRICES }, instead)?;
    let between = Between::new(senders, factors)?;
    let operators = match is_feedback {
        true => Vec::new(),
        false => between.bounces(&senders.albedo, bounces.map(|bounces| bounces - last), progress)?,
    };
    let channels = match &operators[..] {
        [red, green, blue] => Channels::Three([red, green, blue]),
        _ => Channels::One(&between.symmetric),
    };
    let tiles = progress.phase("compress", |report| {
        Tiles::encode(channels, &between.area, &between.order, epsilon, &|done, total| proceed(report, done, total))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_into_memory_is_refused_with_a_remedy() {
        assert!(check_memory(100, MATRICES, "feedback").is_ok());
        if available_memory().is_none() {
            println!("the system does not say how much memory is free: skipped");
            return;
        }
        let message = check_memory(30_000_000, MATRICES, "feedback").unwrap_err().to_string();
        assert!(message.contains("--patch-count") && message.contains("feedback"), "{message}");
    }
}
