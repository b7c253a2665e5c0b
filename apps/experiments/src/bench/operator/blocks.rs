//! The part of `bench operator` with texture blocks: bytes, errors and times, and what the order of rows and columns is worth.

use std::time::Instant;

use faer::Mat;
use glam::Vec4;
use multibounce::{BlockCodec, Channels};
use serde::Serialize;
use transport::LinearOperator;

use super::{Row, Truth, median_ms};
use crate::error::Error;
use crate::progress::Progress;
use crate::report::{Table, significant};
use patchlight::render::decode::Decode;
use patchlight::render::frame::{decoder, product_decoded};
use patchlight::render::operator::measure::{block_orders, order_errors, relative_error};
use patchlight::render::operator::{Between, Codec, PatchOperator};
use runtime::executor::Executor;

/// Products on a device, by each decoder: an emulated texture unit takes seconds.
const TURNS: usize = 3;

/// What is measured of blocks alone.
#[derive(Serialize)]
pub(super) struct Blocks {
    /// Mean squared error of the entries that blocks hold, for each order of rows and columns.
    order_mse: Vec<(&'static str, f64)>,
    /// Bytes over those of one number of single precision an entry.
    bytes_share: f64,
    /// What decodes in frames on the device, unless it is chosen.
    #[serde(skip_serializing_if = "Option::is_none")]
    decode: Option<&'static str>,
    /// On the device, by each of the two.
    #[serde(skip_serializing_if = "Option::is_none")]
    kernel_ms: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    texture_ms: Option<f64>,
}

/// What there is to measure with.
pub(super) struct Source<'a> {
    pub between: &'a Between,
    pub operators: &'a [Mat<f32>; 3],
    pub truths: &'a [Truth],
    /// A row of these bytes and milliseconds.
    pub row: &'a dyn Fn(&'static str, &'static str, u64, f64) -> Row,
    pub seed: u32,
}

/// A row for each codec.
pub(super) fn measure(
    source: &Source,
    codecs: &[BlockCodec],
    mut device: Option<&mut (dyn Executor + 'static)>,
    progress: &Progress,
) -> Result<Vec<Row>, Error> {
    if codecs.is_empty() {
        return Ok(Vec::new());
    }
    let Source { between, truths, seed, .. } = *source;
    let channels = Channels::Three(source.operators.each_ref());
    let (n, exact) = (between.area.len(), between.rows(channels));
    let orders = block_orders(&exact, between, seed, progress)?;
    let mut measured = Vec::new();
    for &codec in codecs {
        let order_mse = order_errors(codec, &exact, &orders, progress)?;
        let start = Instant::now();
        let operator = PatchOperator::encode(Codec::Blocks(codec), channels, between, seed, progress)?;
        let seconds = start.elapsed().as_secs_f64();
        let mut h = vec![Vec4::ZERO; n];
        let errors = truths.iter().map(|truth| {
            operator.apply(&truth.source, &mut h)?;
            Ok(truth.all.as_ref().map_or(0.0, |exact| relative_error(&h, exact, &between.area)))
        });
        let errors = errors.collect::<Result<Vec<f64>, Error>>()?;
        let time = median_ms(|| Ok(operator.apply(&truths[0].source, &mut h)?))?;
        let bytes = operator.bytes();
        let mut blocks = Blocks {
            order_mse,
            bytes_share: bytes as f64 / (4 * n * n).max(1) as f64,
            decode: None,
            kernel_ms: None,
            texture_ms: None,
        };
        if let Some(device) = device.as_deref_mut() {
            let mut on_device = |decode: Decode| -> Result<Option<f64>, Error> {
                let Ok(Some(by)) = decoder(decode, device, Some(&operator)) else { return Ok(None) };
                Ok(Some(product_decoded(device, &operator, &truths[0].source, TURNS, by)?.1))
            };
            blocks.kernel_ms = on_device(Decode::Kernel)?;
            blocks.texture_ms = on_device(Decode::Texture)?;
            blocks.decode = decoder(Decode::Auto, device, Some(&operator))?.map(|by| by.name());
        }
        measured.push(Row {
            frobenius: operator.frobenius(channels, between),
            own_light: errors[0],
            compact_lights: errors[1..].iter().copied().fold(0.0, f64::max),
            compress_s: Some(seconds),
            device_ms: if blocks.decode == Some("texture") { blocks.texture_ms } else { blocks.kernel_ms },
            blocks: Some(blocks),
            ..(source.row)("T", Codec::Blocks(codec).name(), bytes, time)
        });
    }
    Ok(measured)
}

/// What blocks take beside what is asked of them; none without blocks.
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
            let same = |other: &&Row| other.method == method && other.senders() == row.senders();
            rows.iter().find(same).map(|other| other.median_ms)
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
        caption: "Texture blocks. The mean squared error is that of the entries in blocks, without outliers, by the order of \
                  rows and columns; bytes are those of all channels, outliers and scales over one number of single precision \
                  an entry; times of the CPU but for the last two."
            .to_owned(),
        head: head.map(str::to_owned).to_vec(),
        rows: lines,
    })
}
