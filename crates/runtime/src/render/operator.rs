//! The light between patches as one operator: all bounces in a product, or a bounce of any reflectance.

mod build;
pub(crate) mod measure;

use faer::Mat;
use formfactor::kernel::product::packed_row_words;
use formfactor::{Csr, Dense, Half, Reciprocal, reciprocal, widen_half};
use glam::{Vec3, Vec4};
use multibounce::{
    Acceleration, BlockCodec, BlockMatrix, BlockSettings, Channels, Factors, LowRank, MatrixRows, Permutation, Room,
    StoredOperator, TileSide, TileSource, all_bounces, all_bounces_stored, halving_order, projected_order,
    some_bounces, some_bounces_stored, spectral_radius, spectral_range,
};
use rayon::prelude::*;

pub use self::build::{Build, BuildOn};

use self::build::some_bounces_on_device;
use super::firstshot::FirstShotSettings;
pub use super::frame::receivers_on_device;
use super::local::LocalOptions;
use super::senders::Senders;
use super::temporal::Temporal;
use super::{go_on, proceed};
use crate::error::Error;
use crate::executor::Executor;
use crate::progress::Progress;
use transport::LinearOperator;

/// How light goes from patch to patch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Transport {
    /// A product with the sparse form factors for each bounce.
    #[default]
    Classic,
    /// One product with the operator of all bounces.
    Operator(Codec),
    /// No product: photons that start where lights fall first.
    FirstShot(FirstShotSettings),
    /// Products with the compressed form factors, from the light of the frame before.
    Feedback(Feedback),
    /// A few samples a row and frame, from the light of the frame before.
    Temporal(Temporal),
    /// All bounces in one product, with the operator of the patches round the camera.
    Local(LocalOptions),
}

/// How light goes on from frame to frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feedback {
    /// Relative Frobenius error of the form factors.
    pub epsilon: f64,
    /// Bounces in a frame.
    pub products: u32,
    /// Whether a bounce uses where the light was going ([`Acceleration`]).
    pub accelerated: bool,
}

impl Default for Feedback {
    fn default() -> Self {
        Self { epsilon: 0.01, products: 1, accelerated: true }
    }
}

/// How an operator is stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Codec {
    /// A number of single precision for each entry and channel.
    Dense,
    /// The same in half precision.
    Half,
    /// Texture blocks, with the greatest entries beside them.
    Blocks(BlockCodec),
    /// Tiles of low rank and single entries.
    Tiles {
        /// Relative Frobenius error.
        epsilon: f64,
    },
}

impl Codec {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dense => "dense",
            Self::Half => "f16",
            Self::Blocks(BlockCodec::Bc1) => "bc1",
            Self::Blocks(BlockCodec::Bc3) => "bc3",
            Self::Blocks(BlockCodec::Bc6h) => "bc6h",
            Self::Blocks(BlockCodec::Bc7) => "bc7",
            Self::Tiles { .. } => "tiles",
        }
    }
}

/// An operator between patches as it is multiplied by.
///
/// The dense ones have a row `[red | green | blue | zeros]` for each patch, `columns / 3` entries of each channel, for light
/// whose channels lie apart: so the products with one number an entry serve three channels.
#[derive(Clone, Debug, PartialEq)]
pub enum PatchOperator {
    /// Single precision.
    Dense(Dense),
    /// Half precision.
    Half(Half),
    /// Texture blocks and outliers.
    Blocks(BlockMatrix),
    /// Tiles; of one channel they hold form factors.
    Tiles(Box<LowRank>),
}

/// Columns of the dense operators of n patches: whole vectors of four.
pub(crate) fn apart_columns(n: usize) -> usize {
    (3 * n).next_multiple_of(4)
}

/// The source of each element of light whose channels lie apart, if there is one, and its channel: red of all of `n`
/// patches, green, blue, and nothing up to a whole vector.
pub(crate) fn apart(n: usize) -> impl Iterator<Item = Option<(usize, usize)>> {
    (0..apart_columns(n)).map(move |k| (k < 3 * n).then(|| (k % n, k / n)))
}

/// `H = T E` on the host, W/m².
impl LinearOperator for PatchOperator {
    fn shape(&self) -> (usize, usize) {
        (self.patches(), self.patches())
    }

    fn bytes(&self) -> u64 {
        self.bytes_by_part().iter().map(|part| part.1).sum()
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), transport::Error> {
        let light = || -> Vec<Vec4> {
            let one = |at: Option<(usize, usize)>| at.map_or(Vec4::ZERO, |(j, c)| Vec4::AXES[c] * exitance[j][c]);
            apart(exitance.len()).map(one).collect()
        };
        match self {
            Self::Dense(dense) => dense.apply(&light(), irradiance),
            Self::Half(half) => half.apply(&light(), irradiance),
            Self::Blocks(matrix) => matrix.apply(exitance, irradiance),
            Self::Tiles(tiles) => tiles.apply(exitance, irradiance),
        }
    }
}

impl PatchOperator {
    /// Stores the operator `a^-½ T̂ a^½` of symmetric channels.
    ///
    /// # Errors
    /// What the codec says; cancellation.
    pub(crate) fn encode(
        codec: Codec,
        channels: Channels,
        between: &Between,
        seed: u32,
        progress: &mut Progress,
    ) -> Result<Self, Error> {
        let n = between.area.len();
        let rows = between.rows(channels);
        progress.phase("compress", |report| {
            let proceed = |done, total| proceed(report, done, total);
            Ok(match codec {
                Codec::Dense => {
                    let mut dense = Dense::zeros(n, apart_columns(n));
                    dense
                        .values
                        .par_chunks_mut(apart_columns(n).max(1))
                        .enumerate()
                        .for_each_init(|| vec![Vec3::ZERO; n], |colors, (i, row)| fill_apart(&rows, i, colors, row));
                    Self::Dense(dense)
                }
                Codec::Half => {
                    let columns = apart_columns(n);
                    let width = packed_row_words(columns as u32) as usize;
                    let mut words = vec![0; n * width];
                    words.par_chunks_mut(width.max(1)).enumerate().for_each_init(
                        || (vec![Vec3::ZERO; n], Dense::zeros(1, columns)),
                        |(colors, one), (i, row)| {
                            fill_apart(&rows, i, colors, &mut one.values);
                            row.copy_from_slice(&one.to_half().words);
                        },
                    );
                    Self::Half(Half { rows: n, columns, words })
                }
                Codec::Blocks(codec) => {
                    let settings = BlockSettings::of(codec);
                    let order = projected_order(n, &rows, seed);
                    Self::Blocks(BlockMatrix::encode(n, &rows, order, settings, &proceed)?)
                }
                Codec::Tiles { epsilon } => {
                    let patches = TileSide { area: &between.area, order: &between.order };
                    let source = TileSource::Symmetric { channels, patches };
                    Self::Tiles(Box::new(LowRank::encode(source, epsilon, &proceed)?))
                }
            })
        })
    }

    /// Number of patches.
    pub fn patches(&self) -> usize {
        match self {
            Self::Dense(dense) => dense.rows,
            Self::Half(half) => half.rows,
            Self::Blocks(matrix) => matrix.len(),
            Self::Tiles(tiles) => tiles.rows(),
        }
    }

    /// Bytes of each part that a product reads.
    pub fn bytes_by_part(&self) -> Vec<(&'static str, u64)> {
        match self {
            Self::Dense(dense) => vec![("entries", size_of_val(&dense.values[..]) as u64)],
            Self::Half(half) => vec![("entries", size_of_val(&half.words[..]) as u64)],
            Self::Blocks(matrix) => {
                let bytes = matrix.bytes_by_part();
                vec![
                    ("blocks", bytes.blocks),
                    ("scales", bytes.scales),
                    ("outliers", bytes.outliers),
                    ("vectors", bytes.vectors),
                ]
            }
            Self::Tiles(tiles) => tiles.bytes_by_part().to_vec(),
        }
    }

    /// Rows as they are stored.
    pub(crate) fn rows(&self) -> impl Fn(usize, &mut [Vec3]) + Sync + '_ {
        move |i, row| {
            let n = row.len();
            match self {
                Self::Dense(dense) => {
                    let entries = dense.row(i);
                    (0..n).for_each(|j| row[j] = Vec3::from_array([0, 1, 2].map(|c| entries[c * n + j])));
                }
                Self::Half(half) => {
                    let words = &half.words[i * packed_row_words(half.columns as u32) as usize..];
                    let entry = |k: usize| widen_half(words[k / 2] >> (16 * (k % 2)));
                    (0..n).for_each(|j| row[j] = Vec3::from_array([0, 1, 2].map(|c| entry(c * n + j))));
                }
                Self::Blocks(matrix) => {
                    if matrix.row(i, row).is_err() {
                        row.fill(Vec3::ZERO);
                    }
                }
                Self::Tiles(tiles) => {
                    if tiles.row(i, row).is_err() {
                        row.fill(Vec3::ZERO);
                    }
                }
            }
        }
    }

    /// The order in which neighbours are alike, where the codec has one.
    ///
    /// # Errors
    /// An order that is none.
    pub(crate) fn order(&self) -> Result<Option<Permutation>, Error> {
        Ok(match self {
            Self::Dense(_) | Self::Half(_) => None,
            Self::Blocks(matrix) => Some(matrix.permutation().clone()),
            Self::Tiles(tiles) => Some(Permutation::new(tiles.order.clone())?),
        })
    }

    /// Relative error of the entries as the codec states it (Frobenius), the greatest of the channels.
    pub(crate) fn frobenius(&self, channels: Channels, between: &Between) -> f64 {
        match self {
            Self::Blocks(matrix) => matrix.report().frobenius,
            Self::Tiles(tiles) => tiles.report.error.iter().copied().fold(0.0, f64::max),
            Self::Dense(_) | Self::Half(_) => {
                let n = self.patches();
                let (exact, stored) = (between.rows(channels), self.rows());
                let squares = (0..n).into_par_iter().map(|i| {
                    let (mut right, mut row) = (vec![Vec3::ZERO; n], vec![Vec3::ZERO; n]);
                    exact(i, &mut right);
                    stored(i, &mut row);
                    let one = |c: usize| {
                        let square = |x: f32| f64::from(x) * f64::from(x);
                        let both = |sum: [f64; 2], j: usize| {
                            [sum[0] + square(row[j][c] - right[j][c]), sum[1] + square(right[j][c])]
                        };
                        (0..n).fold([0.0; 2], both)
                    };
                    [one(0), one(1), one(2)]
                });
                // In the order of the rows, so that the number of threads changes nothing.
                let sums = squares.collect::<Vec<_>>().into_iter().fold([[0.0; 2]; 3], |sums, row| {
                    core::array::from_fn(|c| [sums[c][0] + row[c][0], sums[c][1] + row[c][1]])
                });
                sums.iter().map(|[wrong, all]| if *all > 0.0 { (wrong / all).sqrt() } else { 0.0 }).fold(0.0, f64::max)
            }
        }
    }

    /// What there is to say about it.
    fn describe(&self) -> String {
        let size = self.bytes_by_part().iter().map(|part| part.1 as f64).sum::<f64>() * 1e-6;
        match self {
            Self::Dense(_) | Self::Half(_) => format!("operator: {size:.2} MB"),
            Self::Blocks(matrix) => {
                format!("operator: {size:.2} MB, relative error {:.2} %", 100.0 * matrix.report().frobenius)
            }
            Self::Tiles(tiles) => {
                let report = &tiles.report;
                format!(
                    "operator: {size:.2} MB (stored {:.2} MB), relative error {:.2} / {:.2} / {:.2} %, {} components, \
                     {} squares and {} entries in {} tiles, ranks up to {}",
                    tiles.stored_bytes() as f64 * 1e-6,
                    100.0 * report.error[0],
                    100.0 * report.error[1],
                    100.0 * report.error[2],
                    report.components.iter().sum::<usize>(),
                    report.squares,
                    report.entries,
                    report.tiles.iter().sum::<usize>(),
                    report.most_rank
                )
            }
        }
    }
}

/// A row with its channels apart; `colors` is room for it.
fn fill_apart(rows: &MatrixRows, i: usize, colors: &mut [Vec3], row: &mut [f32]) {
    rows(i, colors);
    for (value, at) in row.iter_mut().zip(apart(colors.len())) {
        *value = at.map_or(0.0, |(j, c)| colors[j][c]);
    }
}

/// Dense matrices of single precision at the peak: F, three operators, three of the solver.
pub(crate) const MATRICES: usize = 7;

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

/// `Σ_j F_ij (p_j, 1)` of each row: what [`halving_order`] takes.
pub(crate) fn seen(factors: &impl LinearOperator, positions: &[Vec3]) -> Result<Vec<Vec4>, Error> {
    let of = |light: Vec<Vec4>| -> Result<Vec<Vec4>, Error> {
        let mut sums = vec![Vec4::ZERO; factors.rows()];
        factors.apply(&light, &mut sums)?;
        Ok(sums)
    };
    let sums = of(positions.iter().map(|p| p.extend(0.0)).collect())?;
    let shares = of(vec![Vec4::ONE; positions.len()])?;
    Ok(sums.iter().zip(&shares).map(|(sum, share)| sum.truncate().extend(share.x)).collect())
}

/// The exchange between patches in symmetric form.
pub(crate) struct Between {
    /// Reciprocal form factors.
    pub factors: Csr,
    /// Areas by which they are, m².
    pub area: Vec<f32>,
    /// Order in which neighbours are alike.
    pub order: Vec<u32>,
}

impl Between {
    pub fn new(senders: &Senders, factors: &Csr) -> Result<Self, Error> {
        let Reciprocal { factors, area, .. } = reciprocal(factors, &senders.areas())?;
        let positions: Vec<Vec3> = senders.patches.iter().map(|p| p.centroid).collect();
        let normals: Vec<Vec3> = senders.patches.iter().map(|p| p.normal).collect();
        let order = halving_order(&positions, &normals, &seen(&factors, &positions)?);
        Ok(Self { factors, area, order })
    }

    /// The form factors, which compressing them alone needs no dense matrix for.
    pub fn channels(&self) -> Channels<'_> {
        Channels::Factors(self.view())
    }

    fn view(&self) -> Factors<'_> {
        let Csr { row_start, column_index, values, .. } = &self.factors;
        Factors { row_start, columns: column_index, values, area: &self.area }
    }

    /// `a^½ F a^-½`.
    pub fn symmetric(&self) -> Result<Mat<f32>, Error> {
        Ok(self.view().symmetric()?)
    }

    /// Rows of `a^-½ T̂ a^½`, as codecs read them. Rounding leaves no entry below 0.
    pub fn rows<'a>(&'a self, channels: Channels<'a>) -> impl Fn(usize, &mut [Vec3]) + Sync + 'a {
        let root: Vec<f32> = self.area.iter().map(|&a| scene::math::sqrt(a)).collect();
        move |i, row| {
            let [r, g, b] = match channels {
                Channels::One(all) => [all; 3],
                Channels::Three(each) => each,
                Channels::Stored(each) => {
                    let mut channels = [0, 1, 2].map(|_| vec![0.0; row.len()]);
                    let is_read = each.iter().zip(&mut channels).all(|(stored, row)| stored.row(i, row).is_ok());
                    for (j, color) in row.iter_mut().enumerate() {
                        let entry = Vec3::from_array([0, 1, 2].map(|c| channels[c][j])) * (root[j] / root[i]);
                        *color = if is_read { entry.max(Vec3::ZERO) } else { Vec3::ZERO };
                    }
                    return;
                }
                Channels::Factors(factors) => {
                    row.fill(Vec3::ZERO);
                    factors.row(i).for_each(|(j, f)| row[j] += Vec3::splat(f));
                    return;
                }
            };
            // Symmetric: a column, which lies together in memory, is the row.
            for (j, color) in row.iter_mut().enumerate() {
                *color = (Vec3::new(r[(j, i)], g[(j, i)], b[(j, i)]) * (root[j] / root[i])).max(Vec3::ZERO);
            }
        }
    }

    /// The symmetric operators of so many bounces for red, green and blue, on a device where the build says so; on the host, with a
    /// note, when nobody asked for a device that turns out too small.
    fn bounces_on(
        &self,
        albedo: &[Vec4],
        bounces: Option<u32>,
        build: &Build,
        device: Option<&mut (dyn Executor + 'static)>,
        progress: &mut Progress,
    ) -> Result<[Mat<f32>; 3], Error> {
        let device = device.filter(|device| build.on.is_device(device.device().kind));
        let (Some(device), Some(bounces)) = (device, bounces) else {
            return self.bounces(albedo, bounces, progress);
        };
        let range = device.device().max_storage_buffer_range;
        let made =
            progress.phase("operator", |report| some_bounces_on_device(device, self, albedo, bounces, range, report));
        match made {
            Err(error @ Error::DeviceMemory { .. }) if build.on == BuildOn::Auto => {
                progress.note(&format!("{error}; it is built on the host"));
                self.bounces(albedo, Some(bounces), progress)
            }
            other => other,
        }
    }

    /// The same in files, of which panels of so many bytes are held at a time.
    fn stored(
        &self,
        albedo: &[Vec4],
        bounces: Option<u32>,
        build: &Build,
        bytes: u64,
        progress: &mut Progress,
    ) -> Result<[StoredOperator; 3], Error> {
        let room = Room { folder: &build.folder, bytes };
        let made = progress.phase("operator", |report| {
            let one = |channel: usize| {
                let albedo: Vec<f32> = albedo.iter().map(|rho| rho[channel]).collect();
                let proceed = |done, total| proceed(report, channel * total + done, 3 * total);
                let (factors, order) = (self.view(), &self.order);
                match bounces {
                    None => all_bounces_stored(&factors, &albedo, order, &room, &proceed),
                    Some(bounces) => some_bounces_stored(&factors, &albedo, bounces, order, &room, &proceed),
                }
            };
            Ok([one(0)?, one(1)?, one(2)?])
        });
        made.map_err(|error| match error {
            multibounce::Error::Memory { needed, limit } => {
                Error::OperatorPanels { patches: albedo.len(), needed, left: limit }
            }
            multibounce::Error::Shared(transport::Error::Cancelled { .. }) => Error::Cancelled,
            other => other.into(),
        })
    }

    /// The symmetric operators of so many bounces, or of all, for red, green and blue, on the host: [`MATRICES`] N² numbers at the
    /// peak.
    pub fn bounces(
        &self,
        albedo: &[Vec4],
        bounces: Option<u32>,
        progress: &mut Progress,
    ) -> Result<[Mat<f32>; 3], Error> {
        progress.phase("operator", |report| {
            let symmetric = self.symmetric()?;
            let one = |channel: usize| {
                let albedo: Vec<f32> = albedo.iter().map(|rho| rho[channel]).collect();
                let made = match bounces {
                    None => all_bounces(&symmetric, &albedo)?,
                    Some(bounces) => some_bounces(&symmetric, &albedo, bounces, &go_on)?,
                };
                if report((channel + 1) as f32 / 3.0) { Ok(made) } else { Err(Error::Cancelled) }
            };
            Ok([one(0)?, one(1)?, one(2)?])
        })
    }
}

/// Bounces that do not go from patch to patch: to the facets, and to the receivers.
pub(super) const LAST_BOUNCES: u32 = 2;

/// Steps and tolerance of the power iteration that finds how far light can grow.
const RADIUS_STEPS: usize = 200;
const RADIUS_TOLERANCE: f32 = 1e-4;

/// What [`compress`] makes.
pub(super) struct Compressing<'a> {
    pub transport: Transport,
    pub build: &'a Build,
    /// Counts the last two, which end at facets and receivers, unless the patches are the receivers; `None` for all.
    pub bounces: Option<u32>,
    /// Whether the patches are the receivers.
    pub at_patches: bool,
    pub seed: u32,
}

/// The operator that a frame multiplies by; none for classic radiosity, and for so few bounces that patches need none.
pub(super) fn compress(
    settings: &Compressing,
    senders: &Senders,
    factors: &Csr,
    device: Option<&mut (dyn Executor + 'static)>,
    progress: &mut Progress,
) -> Result<Option<PatchOperator>, Error> {
    let last = if settings.at_patches { 0 } else { LAST_BOUNCES };
    if settings.bounces.is_some_and(|bounces| bounces <= last) || senders.patches.is_empty() {
        return Ok(None);
    }
    let operator = match settings.transport {
        Transport::Classic | Transport::Temporal(_) | Transport::FirstShot(_) | Transport::Local(_) => return Ok(None),
        Transport::Operator(codec) => {
            let between = Between::new(senders, factors)?;
            let bounces = settings.bounces.map(|bounces| bounces - last);
            let (albedo, build) = (&senders.albedo, settings.build);
            if let Some(bytes) = build.panel_bytes(albedo.len(), between.factors.values.len()) {
                let made = build_in_panels(codec, &between, albedo, (bounces, settings.seed), build, bytes, progress)?;
                progress.note(&made.describe());
                return Ok(Some(made));
            }
            let operators = between.bounces_on(albedo, bounces, build, device, progress)?;
            let channels = Channels::Three(operators.each_ref());
            PatchOperator::encode(codec, channels, &between, settings.seed, progress)?
        }
        Transport::Feedback(Feedback { epsilon, .. }) => {
            feedback(Between::new(senders, factors)?, epsilon, settings.seed, progress)?
        }
    };
    progress.note(&operator.describe());
    Ok(Some(operator))
}

/// An operator whose matrices do not fit into memory, in tiles: other codecs read it patch by patch, or are as large themselves.
fn build_in_panels(
    codec: Codec,
    between: &Between,
    albedo: &[Vec4],
    (bounces, seed): (Option<u32>, u32),
    build: &Build,
    bytes: u64,
    progress: &mut Progress,
) -> Result<PatchOperator, Error> {
    if !matches!(codec, Codec::Tiles { .. }) {
        let needed = (MATRICES * size_of::<f32>()) as f64 * (albedo.len() as f64).powi(2) * 1e-9;
        let (patches, available) = (albedo.len(), bytes as f64 * 1e-9);
        return Err(Error::OperatorMemory { patches, needed, available, instead: "tiles" });
    }
    let stored = between.stored(albedo, bounces, build, bytes, progress)?;
    let held = stored.iter().map(|stored| stored.held_bytes).max().unwrap_or(0);
    progress.note(&format!("operator built in panels of {} MB, kept in {}", held >> 20, build.folder.display()));
    PatchOperator::encode(codec, Channels::Stored(stored.each_ref()), between, seed, progress)
}

/// The compressed form factors, scaled where light would grow in them from bounce to bounce: their spectral radius is at
/// most 1, and so is below 1 with every albedo below 1.
fn feedback(mut between: Between, epsilon: f64, seed: u32, progress: &mut Progress) -> Result<PatchOperator, Error> {
    let codec = Codec::Tiles { epsilon };
    let operator = PatchOperator::encode(codec, between.channels(), &between, seed, progress)?;
    let radius = growth(&vec![Vec4::ONE; operator.patches()], &operator)?;
    if radius <= 1.0 + 2.0 * RADIUS_TOLERANCE {
        return Ok(operator);
    }
    progress.note(&format!("compressed form factors are scaled by {:.4}, for light would grow", 1.0 / radius));
    let scale = (1.0 - RADIUS_TOLERANCE) / radius;
    between.factors.values.iter_mut().for_each(|f| *f *= scale);
    PatchOperator::encode(codec, between.channels(), &between, seed, progress)
}

/// Tolerance of the eigenvalues that accelerated feedback goes by.
const RANGE_TOLERANCE: f32 = 1e-3;

/// How feedback settles by these form factors, plain and accelerated.
pub(crate) fn accelerations(albedo: &[Vec4], factors: &dyn LinearOperator) -> Result<[Acceleration; 2], Error> {
    let range = spectral_range(factors, albedo, RANGE_TOLERANCE, RADIUS_STEPS)?;
    Ok([Acceleration::none(range.clone()), Acceleration::new(range)?])
}

/// Spectral radius of `diag(ρ) T`, the greatest of the channels: of `irradiance = T exitance` as a product.
pub(crate) fn growth(albedo: &[Vec4], operator: &dyn LinearOperator) -> Result<f32, Error> {
    Ok(spectral_radius(operator, albedo, RADIUS_TOLERANCE, RADIUS_STEPS)?.max_element())
}

#[cfg(test)]
pub(super) mod tests;
