//! `patchlight info --operator`: what operators of the light between patches take and lose.

use std::time::Instant;

use glam::Vec4;
use multibounce::{Channels, spectral_radius};
use serde::Serialize;
use transport::LinearOperator as _;

use crate::args::{OperatorOptions, Storage};
use assets::import::LoadedScene;
use experiments::Error;
use experiments::args::Common;
use experiments::output;
use experiments::progress::Progress;
use patchlight::render::classic::ClassicSettings;
use patchlight::render::decode::Decoder;
use patchlight::render::exchange::exchange;
use patchlight::render::frame::decoder;
use patchlight::render::operator::measure::{
    block_orders, compact_lights, exact_product, matrix_pictures, order_errors, own_light, relative_error,
};
use patchlight::render::operator::{Between, Codec, MATRICES, PatchOperator, check_memory, growth};
use patchlight::render::senders::Senders;
use runtime::executor::{DeviceChoice, open};

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
    /// What decodes texture blocks in frames on the device.
    #[serde(skip_serializing_if = "Option::is_none")]
    decode: Option<&'static str>,
    /// Mean squared error of the entries that texture blocks hold, for some orders of rows and columns.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    order_mse: Vec<(&'static str, f64)>,
    seconds: f64,
}

/// What tiles are made of.
#[derive(Serialize)]
struct Ranks {
    /// Tiles without components or entries, with entries only, with components.
    empty: usize,
    sparse: usize,
    low_rank: usize,
    /// Components for all channels, and of the differences to green.
    components: usize,
    differences: usize,
    most_rank: usize,
    squares: usize,
    entries: usize,
    /// Bytes of a file of it.
    stored_bytes: u64,
}

impl Operator {
    pub fn of(
        common: &Common,
        loaded: &LoadedScene,
        senders: &Senders,
        settings: &ClassicSettings,
        options: &OperatorOptions,
    ) -> Result<Self, Error> {
        let progress = Progress::new(common.quiet || common.json);
        let n = senders.patches.len();
        check_memory(n, MATRICES, "feedback")?;
        let found = progress.phase("form_factors", |report| exchange(&loaded.scene, senders, settings, report))?;
        let between = Between::new(senders, &found.factors)?;
        let operators = between.bounces(&senders.albedo, None, &progress)?;
        let mut lights = vec![own_light(&loaded.scene, senders, settings)];
        lights.extend(compact_lights(senders, settings.seed));
        let factors = &between.factors;
        let radius = spectral_radius(factors, &senders.albedo, TOLERANCE, STEPS)?.max_element();

        let codec = options.codec.codec(options.epsilon);
        let device = match codec {
            Codec::Blocks(_) => Some(open(&DeviceChoice::parse(&common.device))?.0),
            _ => None,
        };
        let mut made = vec![("T", Channels::Three(operators.each_ref()))];
        if options.codec == Storage::Tiles {
            made.push(("F", between.channels()));
        }
        let mut stored = Vec::new();
        for (operator, channels) in made {
            let start = Instant::now();
            let kept = PatchOperator::encode(codec, channels, &between, settings.seed, &progress)?;
            let seconds = start.elapsed().as_secs_f64();
            let mut one = Stored::of(operator, codec, &kept, channels, &between, &lights, &senders.albedo, seconds)?;
            if let Some(device) = &device {
                let decoder = decoder(options.decode.decode(), device.as_ref(), Some(&kept))?;
                one.decode = decoder.map(Decoder::name);
            }
            if let Codec::Blocks(codec) = codec {
                let exact = between.rows(channels);
                let orders = block_orders(&exact, &between, settings.seed, &progress)?;
                one.order_mse = order_errors(codec, &exact, &orders, &progress)?;
            }
            stored.push(one);
            if let (Some(out), "T") = (&common.out, operator) {
                output::make_folder(out)?;
                let pictures = progress.phase("pictures", |_| matrix_pictures(&kept, channels, &between))?;
                output::write_debug(out, &pictures)?;
                progress.note(&format!("pictures of the matrix are in {}", out.display()));
            }
        }
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
        println!(
            "{:24} {} of {} patches: sparse rows {}, dense {} a channel",
            "form factors",
            self.entries,
            self.patches,
            output::bytes(self.sparse_bytes),
            output::bytes(self.dense_bytes)
        );
        println!("{:24} {:.4}", "spectral radius of ρF", self.spectral_radius);
        for stored in &self.stored {
            stored.print();
        }
    }
}

impl Stored {
    #[allow(clippy::too_many_arguments)]
    fn of(
        operator: &'static str,
        codec: Codec,
        kept: &PatchOperator,
        channels: Channels,
        between: &Between,
        lights: &[Vec<Vec4>],
        albedo: &[Vec4],
        seconds: f64,
    ) -> Result<Self, Error> {
        let mut irradiance = vec![Vec4::ZERO; albedo.len()];
        let mut errors = Vec::new();
        for light in lights {
            kept.apply(light, &mut irradiance)?;
            errors.push(relative_error(&irradiance, &exact_product(channels, &between.area, light), &between.area));
        }
        let radius = growth(albedo, kept)?;
        let bytes = kept.bytes_by_part();
        let tiles = match kept {
            PatchOperator::Tiles(tiles) => {
                let report = &tiles.report;
                let [empty, sparse, low_rank] = report.tiles;
                let [components, differences] = report.components;
                let (most_rank, stored_bytes) = (report.most_rank, tiles.stored_bytes());
                let (squares, entries) = (report.squares, report.entries);
                Some(Ranks {
                    empty,
                    sparse,
                    low_rank,
                    components,
                    differences,
                    most_rank,
                    squares,
                    entries,
                    stored_bytes,
                })
            }
            _ => None,
        };
        Ok(Self {
            operator,
            codec: codec.name(),
            total_bytes: bytes.iter().map(|part| part.1).sum(),
            bytes,
            frobenius: kept.frobenius(channels, between),
            own_light: errors.first().copied().unwrap_or(0.0),
            compact_lights: errors.iter().skip(1).copied().fold(0.0, f64::max),
            // ρT = ρF (I − ρF)⁻¹ has λ / (1 − λ) where ρF has λ.
            spectral_radius: if operator == "T" { radius / (1.0 + radius) } else { radius },
            tiles,
            decode: None,
            order_mse: Vec::new(),
            seconds,
        })
    }

    fn print(&self) {
        let parts: Vec<String> =
            self.bytes.iter().map(|(name, count)| format!("{name} {}", output::bytes(*count))).collect();
        println!(
            "{:24} {} ({})",
            format!("{} in {}", self.operator, self.codec),
            output::bytes(self.total_bytes),
            parts.join(", ")
        );
        println!("{:24} {:.3} % (Frobenius)", "  error of the entries", 100.0 * self.frobenius);
        println!(
            "{:24} {:.3} % under the scene's light, at most {:.3} % under compact lights",
            "  error of irradiance",
            100.0 * self.own_light,
            100.0 * self.compact_lights
        );
        println!("{:24} {:.4} of ρF as stored", "  spectral radius", self.spectral_radius);
        for (order, mse) in &self.order_mse {
            println!("{:24} {mse:.3e} (mean square, entries in blocks)", format!("  {order} order"));
        }
        if let Some(decode) = self.decode {
            println!("{:24} {decode}", "  decoded in frames by");
        }
        if let Some(tiles) = &self.tiles {
            println!(
                "{:24} {} empty, {} sparse, {} of low rank; ranks up to {}",
                "  tiles", tiles.empty, tiles.sparse, tiles.low_rank, tiles.most_rank
            );
            println!(
                "{:24} {}, {} of them differences of channels; {} squares; {} entries; in a file {}",
                "  components",
                tiles.components + tiles.differences,
                tiles.differences,
                tiles.squares,
                tiles.entries,
                output::bytes(tiles.stored_bytes)
            );
        }
        println!("{:24} {:.2} s", "  time", self.seconds);
    }
}
