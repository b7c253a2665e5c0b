//! `patchlight info --operator`: what operators of the light between patches take and lose.

use std::path::Path;
use std::time::Instant;

use faer::Mat;
use glam::Vec4;
use multibounce::{Channels, LowRank, spectral_radius};
use serde::Serialize;
use transport::LinearOperator as _;

use assets::import::LoadedScene;
use shell::Error;
use shell::args::{Common, OperatorOptions, Storage};
use shell::measure::{block_orders, compact_lights, matrix_pictures, order_errors, own_light};
use shell::output;
use shell::progress::Progress;

use patches::PatchMesh;
use patchlight::low_level::operator::build::{MATRICES, check_memory};
use patchlight::low_level::operator::{Codec, PatchOperator, SymmetricFactors, decoder_name, growth};
use patchlight::{BakeSettings, FormFactors};
use runtime::executor::{DeviceChoice, Executor};
use shell::device::open;
use shell::operator_error::{exact_product, relative_error};

/// Steps and tolerance of spectral radii.
const STEPS: usize = 200;
const TOLERANCE: f32 = 1e-4;

/// The light between the patches, and operators of it.
#[derive(Serialize)]
pub(super) struct Operator {
    patches: usize,
    /// Form factors that are not 0, and the bytes of their sparse rows.
    entries: usize,
    sparse_bytes: u64,
    /// A number of single precision for each pair of patches.
    dense_bytes: u64,
    /// Spectral radius of `diag(ρ) F`: what is left of light after a bounce at most.
    spectral_radius: f32,
    stored: Vec<Stored>,
}

/// An operator as it is stored.
#[derive(Serialize)]
struct Stored {
    /// `T` of all bounces, or `F`.
    operator: &'static str,
    codec: &'static str,
    bytes: Vec<(&'static str, u64)>,
    total_bytes: u64,
    /// Relative Frobenius error as the codec states it, the greatest of the channels.
    frobenius: f64,
    /// Relative error of irradiance (L2 by area): of the scene's light, the greatest of the compact lights.
    own_light: f64,
    compact_lights: f64,
    /// Spectral radius of `diag(ρ) F` that follows from what is stored.
    spectral_radius: f32,
    #[serde(skip_serializing_if = "Option::is_none")]
    tiles: Option<Ranks>,
    /// Decoder of texture blocks in frames on the device.
    #[serde(skip_serializing_if = "Option::is_none")]
    decode: Option<&'static str>,
    /// Mean squared error of the entries that texture blocks hold, for some orders of rows and columns.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    order_mse: Vec<(&'static str, f64)>,
    seconds: f64,
}

/// Ranks of the tiles.
#[derive(Serialize)]
struct Ranks {
    /// Tiles without rank-1 terms or entries, with entries only, with rank-1 terms.
    empty: usize,
    sparse: usize,
    low_rank: usize,
    /// Rank-1 terms of all channels, and of the differences to green.
    terms: usize,
    difference_terms: usize,
    most_rank: usize,
    /// Dense sub-blocks, and entries of the sparse residual.
    dense_blocks: usize,
    entries: usize,
    /// Bytes of a file of it.
    stored_bytes: u64,
}

impl Ranks {
    fn of(tiles: &LowRank) -> Self {
        let report = &tiles.report;
        let [empty, sparse, low_rank] = report.tiles;
        let [terms, difference_terms] = report.terms;
        Self {
            empty,
            sparse,
            low_rank,
            terms,
            difference_terms,
            most_rank: report.most_rank,
            dense_blocks: report.sub_blocks,
            entries: report.entries,
            stored_bytes: tiles.stored_bytes(),
        }
    }
}

/// Inputs of operators.
pub(super) struct Source<'a> {
    pub loaded: &'a LoadedScene,
    pub mesh: &'a PatchMesh,
    pub settings: &'a BakeSettings,
}

/// The operator to store, and lights to measure it with.
struct Subject<'a> {
    mesh: &'a PatchMesh,
    factors: SymmetricFactors,
    /// Operators of all bounces, for red, green and blue.
    operators: [Mat<f32>; 3],
    /// The scene's own light first.
    lights: Vec<Vec<Vec4>>,
    seed: u32,
    progress: &'a Progress,
}

impl<'a> Subject<'a> {
    fn new(source: &Source<'a>, progress: &'a Progress) -> Result<Self, Error> {
        let Source { loaded, mesh, settings } = *source;
        check_memory(mesh.patches.len(), MATRICES, "feedback")?;
        let found = progress.phase("form_factors", |report| {
            FormFactors::estimate(&loaded.scene, mesh, settings.estimator, settings.seed, report)
        })?;
        let factors = SymmetricFactors::new(mesh, &found.factors)?;
        let operators = factors.bounces(&mesh.albedo, None, progress)?;
        let mut lights = vec![own_light(&loaded.scene, mesh, settings.sample_rays, settings.seed)];
        lights.extend(compact_lights(mesh, settings.seed));
        Ok(Self { mesh, factors, operators, lights, seed: settings.seed, progress })
    }

    /// An operator by its name: `T` of all bounces, or `F`.
    fn channels(&self, operator: &str) -> Channels<'_> {
        match operator {
            "T" => Channels::Three(self.operators.each_ref()),
            _ => self.factors.channels(),
        }
    }

    /// Relative errors of irradiance of all lights.
    fn errors(&self, kept: &PatchOperator, channels: Channels) -> Result<Vec<f64>, Error> {
        let area = &self.factors.area;
        let mut irradiance = vec![Vec4::ZERO; area.len()];
        let mut errors = Vec::with_capacity(self.lights.len());
        for light in &self.lights {
            kept.apply(light, &mut irradiance)?;
            errors.push(relative_error(&irradiance, &exact_product(channels, area, light), area));
        }
        Ok(errors)
    }
}

impl Operator {
    /// Makes the operators that the options ask for, and measures them.
    pub fn of(common: &Common, source: &Source, options: &OperatorOptions) -> Result<Self, Error> {
        let progress = Progress::new(common.quiet || common.json);
        let subject = Subject::new(source, &progress)?;
        let factors = &subject.factors.factors;
        let radius = spectral_radius(factors, &subject.mesh.albedo, TOLERANCE, STEPS)?.max_element();
        let device = match options.needs_device() {
            true => Some(open(&DeviceChoice::parse(&common.device))?.0),
            false => None,
        };
        let mut stored = vec![Stored::of("T", &subject, options, device.as_deref(), common.out.as_deref())?];
        if options.codec == Storage::LowRank {
            stored.push(Stored::of("F", &subject, options, None, None)?);
        }
        let n = subject.mesh.patches.len();
        Ok(Self {
            patches: n,
            entries: factors.values.len(),
            sparse_bytes: (size_of_val(&factors.row_start[..]) + 8 * factors.values.len()) as u64,
            dense_bytes: (size_of::<f32>() * n * n) as u64,
            spectral_radius: radius,
            stored,
        })
    }

    pub fn print(&self) {
        say!(
            "{:24} {} of {} patches: sparse rows {}, dense {} a channel",
            "form factors",
            self.entries,
            self.patches,
            output::bytes(self.sparse_bytes),
            output::bytes(self.dense_bytes)
        );
        say!("{:24} {:.4}", "spectral radius of ρF", self.spectral_radius);
        for stored in &self.stored {
            stored.print();
        }
    }
}

impl Stored {
    /// An operator as the options say; `device` is what frames would run on, and `pictures` a
    /// folder for pictures of the matrix.
    fn of(
        operator: &'static str,
        subject: &Subject,
        options: &OperatorOptions,
        device: Option<&dyn Executor>,
        pictures: Option<&Path>,
    ) -> Result<Self, Error> {
        let Subject { mesh, factors, seed, progress, .. } = subject;
        let codec = options.codec.codec(options.epsilon);
        let channels = subject.channels(operator);
        let start = Instant::now();
        let kept = PatchOperator::encode(codec, channels, factors, *seed, *progress)?;
        let seconds = start.elapsed().as_secs_f64();
        let errors = subject.errors(&kept, channels)?;
        let radius = growth(&mesh.albedo, &kept)?;
        let decoder = match device {
            Some(device) => kept.decoder(options.decode.decode(), device.device())?,
            None => None,
        };
        let order_mse = match codec {
            Codec::Blocks(codec) => {
                let exact = factors.rows(channels);
                let orders = block_orders(&exact, factors, *seed, progress)?;
                order_errors(codec, &exact, &orders, progress)?
            }
            _ => Vec::new(),
        };
        if let Some(folder) = pictures {
            output::make_folder(folder)?;
            let made = progress.phase("pictures", |_| matrix_pictures(&kept, channels, factors))?;
            output::write_debug(folder, &made)?;
            progress.note(&format!("pictures of the matrix are in {}", folder.display()));
        }
        let bytes = kept.bytes_by_part();
        Ok(Self {
            operator,
            codec: codec.name(),
            total_bytes: bytes.iter().map(|part| part.1).sum(),
            bytes,
            frobenius: kept.frobenius(channels, factors),
            own_light: errors.first().copied().unwrap_or(0.0),
            compact_lights: errors.iter().skip(1).copied().fold(0.0, f64::max),
            // ρT = ρF (I − ρF)⁻¹ has λ / (1 − λ) where ρF has λ.
            spectral_radius: if operator == "T" { radius / (1.0 + radius) } else { radius },
            tiles: match &kept {
                PatchOperator::LowRank(tiles) => Some(Ranks::of(tiles)),
                _ => None,
            },
            decode: decoder.map(decoder_name),
            order_mse,
            seconds,
        })
    }

    fn print(&self) {
        let parts: Vec<String> =
            self.bytes.iter().map(|(name, count)| format!("{name} {}", output::bytes(*count))).collect();
        say!(
            "{:24} {} ({})",
            format!("{} in {}", self.operator, self.codec),
            output::bytes(self.total_bytes),
            parts.join(", ")
        );
        say!("{:24} {:.3} % (Frobenius)", "  error of the entries", 100.0 * self.frobenius);
        say!(
            "{:24} {:.3} % under the scene's light, at most {:.3} % under compact lights",
            "  error of irradiance",
            100.0 * self.own_light,
            100.0 * self.compact_lights
        );
        say!("{:24} {:.4} of ρF as stored", "  spectral radius", self.spectral_radius);
        for (order, mse) in &self.order_mse {
            say!("{:24} {mse:.3e} (mean square, entries in blocks)", format!("  {order} order"));
        }
        if let Some(decode) = self.decode {
            say!("{:24} {decode}", "  decoded in frames by");
        }
        if let Some(tiles) = &self.tiles {
            say!(
                "{:24} {} empty, {} sparse, {} of low rank; ranks up to {}",
                "  tiles",
                tiles.empty,
                tiles.sparse,
                tiles.low_rank,
                tiles.most_rank
            );
            say!(
                "{:24} {}, {} of them of differences of channels; {} dense sub-blocks; {} sparse entries; in a file {}",
                "  rank-1 terms",
                tiles.terms + tiles.difference_terms,
                tiles.difference_terms,
                tiles.dense_blocks,
                tiles.entries,
                output::bytes(tiles.stored_bytes)
            );
        }
        say!("{:24} {:.2} s", "  time", self.seconds);
    }
}
