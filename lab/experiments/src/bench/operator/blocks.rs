//! The part of `bench operator` with texture blocks: bytes, errors and times, and what the order of rows and columns is
//! worth.

use std::time::Instant;

use glam::Vec4;
use multibounce::BlockCodec;
use patchlight::low_level::operator::{Codec, Decode, PatchOperator, decoder_name};
use runtime::executor::Executor;
use serde::Serialize;
use shell::operator_error::relative_error;
use transport::{LinearOperator, Permutation};

use super::{Row, Subject, greatest, median_ms, product_ms};
use crate::error::Error;
use crate::measure::{block_orders, order_errors};
use crate::report::{Table, significant};

/// Products on a device, by each decoder: an emulated texture unit takes seconds.
const ROUNDS: usize = 3;

/// Measurements of blocks alone.
#[derive(Serialize)]
pub(super) struct Blocks {
    /// Mean squared error of the entries that blocks hold, for each order of rows and columns.
    order_mse: Vec<(&'static str, f64)>,
    /// Bytes over those of one number of single precision an entry.
    bytes_share: f64,
    /// Decoder in frames on the device, unless it is chosen.
    #[serde(skip_serializing_if = "Option::is_none")]
    decode: Option<&'static str>,
    /// On the device, by each of the two.
    #[serde(skip_serializing_if = "Option::is_none")]
    kernel_ms: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    texture_ms: Option<f64>,
}

/// A row for each codec; none where the operator of all bounces does not fit into memory.
pub(super) fn measure(
    subject: &Subject,
    codecs: &[BlockCodec],
    mut device: Option<&mut (dyn Executor + 'static)>,
) -> Result<Vec<Row>, Error> {
    let Some(channels) = subject.all_channels().filter(|_| !codecs.is_empty()) else { return Ok(Vec::new()) };
    let exact = subject.factors.rows(channels);
    let orders = block_orders(&exact, subject.factors, subject.seed, subject.progress)?;
    let mut rows = Vec::new();
    for &codec in codecs {
        rows.push(measure_codec(subject, codec, &orders, device.as_deref_mut())?);
    }
    Ok(rows)
}

fn measure_codec(
    subject: &Subject,
    codec: BlockCodec,
    orders: &[(&'static str, Permutation)],
    device: Option<&mut (dyn Executor + 'static)>,
) -> Result<Row, Error> {
    let Subject { factors, progress, seed, .. } = *subject;
    let channels = subject.all_channels().unwrap_or_else(|| factors.channels());
    let order_mse = order_errors(codec, &factors.rows(channels), orders, progress)?;
    let start = Instant::now();
    let operator = PatchOperator::encode(Codec::Blocks(codec), channels, factors, seed, progress)?;
    let seconds = start.elapsed().as_secs_f64();
    let n = subject.patches();
    let mut irradiance = vec![Vec4::ZERO; n];
    let mut errors = Vec::with_capacity(subject.truths.len());
    for truth in &subject.truths {
        operator.apply(&truth.source, &mut irradiance)?;
        errors.push(truth.all.as_ref().map_or(0.0, |exact| relative_error(&irradiance, exact, &factors.area)));
    }
    let time = median_ms(|| Ok(operator.apply(subject.own(), &mut irradiance)?))?;
    let bytes = operator.bytes();
    let mut blocks = Blocks {
        order_mse,
        bytes_share: bytes as f64 / (4 * n * n).max(1) as f64,
        decode: None,
        kernel_ms: None,
        texture_ms: None,
    };
    if let Some(device) = device {
        blocks.kernel_ms = decoded_ms(device, &operator, subject.own(), Decode::Kernel)?;
        blocks.texture_ms = decoded_ms(device, &operator, subject.own(), Decode::Texture)?;
        blocks.decode = operator.decoder(Decode::Auto, device.device())?.map(decoder_name);
    }
    Ok(Row {
        frobenius: operator.frobenius(channels, factors),
        own_light: errors[0],
        compact_lights: greatest(&errors[1..]),
        compress_s: Some(seconds),
        device_ms: if blocks.decode == Some("texture") { blocks.texture_ms } else { blocks.kernel_ms },
        blocks: Some(blocks),
        ..subject.row("T", Codec::Blocks(codec).name(), bytes, time)
    })
}

/// Median time of a product with a decoder of texture blocks, ms; none where the device lacks it.
fn decoded_ms(
    device: &mut (dyn Executor + 'static),
    operator: &PatchOperator,
    light: &[Vec4],
    decode: Decode,
) -> Result<Option<f64>, Error> {
    match operator.decoder(decode, device.device()) {
        Ok(Some(decoder)) => Ok(Some(product_ms(device, operator, light, ROUNDS, decoder)?)),
        _ => Ok(None),
    }
}

/// Memory of blocks beside the requested amount; none without blocks.
pub(super) fn table(rows: &[Row]) -> Option<Table> {
    let head = [
        "scene",
        "patches",
        "stored as",
        "bytes of f32 %",
        "MSE given",
        "random",
        "halving",
        "projected",
        "greedy",
        "given / projected",
        "random / projected",
        "three bounces ms",
        "dense products ms",
        "product ms",
        "in the kernel ms",
        "texture unit ms",
    ];
    let line = |row: &Row| {
        let blocks = row.blocks.as_ref()?;
        let mse = |name: &str| blocks.order_mse.iter().find(|(order, _)| *order == name).map(|(_, mse)| *mse);
        let number = |x: Option<f64>| x.map(significant).unwrap_or_default();
        let power = |x: Option<f64>| x.map(|x| format!("{x:.2e}")).unwrap_or_default();
        let ratio = |order: &str| Some(mse(order)? / mse("projected")?);
        let time = |method: &str| {
            rows.iter()
                .find(|other| other.method == method && other.patch_set() == row.patch_set())
                .map(|other| other.median_ms)
        };
        let mut cells = vec![row.scene.clone(), format!("{} {}", row.patches, row.kind), row.method.to_owned()];
        cells.push(format!("{:.1}", 100.0 * blocks.bytes_share));
        cells.extend(["given", "random", "halving", "projected", "greedy"].map(|order| power(mse(order))));
        cells.extend(["given", "random"].map(|order| number(ratio(order))));
        cells.extend([
            number(time("three bounces")),
            number(time("dense f32, three products")),
            number(Some(row.median_ms)),
            number(blocks.kernel_ms),
            number(blocks.texture_ms),
        ]);
        Some(cells)
    };
    let lines: Vec<_> = rows.iter().filter_map(line).collect();
    (!lines.is_empty()).then(|| Table {
        caption: "Texture blocks. The mean squared error is that of the entries in blocks, without outliers, by the \
                  order of rows and columns; bytes are those of all channels, outliers and scales over one number of \
                  single precision an entry; times of the CPU but for the last two."
            .to_owned(),
        head: head.map(str::to_owned).to_vec(),
        rows: lines,
    })
}
