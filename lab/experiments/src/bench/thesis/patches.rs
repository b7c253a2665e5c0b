//! Figures 5.3 and 5.4: light by printed patches beside ours, a voxelised proxy and the reference.

use std::sync::Arc;

use opponents::ProxyLookup;
use reference::metrics::{compare_pictures, indirect_scale};
use reference::{Picture, PictureFile as _, scale_to_stops};
use serde::Serialize;

use super::super::truth::Truth;
use super::{Outcome, Study, beside};
use crate::bench::setup::load;
use crate::error::Error;
use crate::output;
use crate::progress::interruptible;
use crate::proxy::{ProxyRadiosity, ProxySettings};
use crate::report::{Table, significant};
use ::patches::PatchKind;
use patchlight::{Bake, BakeSettings, Estimator, LightSettings, PictureSettings, ReceiverKind};
use printed::{Form, PrintedRadiosity, PrintedSettings};

/// Bounces: those of printed form factors need not end.
const BOUNCES: u32 = 3;

/// A way to find the light.
#[derive(Serialize)]
struct Row {
    what: &'static str,
    patches: usize,
    /// Bytes of the form factors between them.
    factor_bytes: Option<u64>,
    /// Least and greatest sum of a row of F with what sees no geometry; 1 would be right.
    row_sums: Option<(f32, f32)>,
    /// Mean of the picture over that of the reference.
    brightness: f64,
    /// Median error of blocks, and SSIM, as it is.
    block_median: f64,
    ssim: f64,
    /// Median block error of the picture scaled to the mean of the reference.
    scaled_block_median: f64,
    scaled_ssim: f64,
}

pub fn virtual_patches(study: &Study) -> Result<Outcome, Error> {
    measure(study, PatchKind::Voxel)
}

pub fn axis_patches(study: &Study) -> Result<Outcome, Error> {
    measure(study, PatchKind::Axis)
}

fn measure(study: &Study, kind: PatchKind) -> Result<Outcome, Error> {
    let Study { args, common, loaded, progress, .. } = *study;
    let truth = match Truth::find(args.reference_folder(), loaded)? {
        Some(truth) => truth,
        None => Truth::traced(loaded, &loaded.scene.lighting.lights, args.size(), args.spp, common.seed, progress)?,
    };
    let mut rows = Vec::new();
    let mut pictures = Vec::new();
    let camera = loaded.view.camera(truth.size().0, truth.size().1);
    let (printed, picture) = as_printed(study, kind, &truth)?;
    rows.push(printed);
    pictures.push(picture);
    for (what, receivers) in
        [("ours, patches receive", ReceiverKind::Patches), ("ours, receivers on the mesh", ReceiverKind::Mesh)]
    {
        progress.note(what);
        let settings = BakeSettings::default()
            .with_patches(kind)
            .with_patch_count(study.counts[0] as usize)
            .with_estimator(Estimator::Hemisphere { rays: args.rays })
            .with_bounces(Some(BOUNCES))
            .with_receivers(receivers)
            .with_receiver_rays(args.receiver_rays())
            .with_seed(common.seed);
        let bake = Arc::new(interruptible(|| Bake::build(&loaded.scene, &settings, progress))?);
        let light = LightSettings::default();
        let shown = PictureSettings::default().with_size(truth.size()).with_sub_frames(args.sub_frames);
        let mut renderer = load(common, &bake, &light, &shown, progress)?;
        let frame = interruptible(|| renderer.picture(&loaded.scene.lighting, &camera, 0))?;
        let row_sums = row_sums(&bake);
        let mut row = row(what, &frame.pictures.indirect, &truth)?;
        (row.patches, row.factor_bytes, row.row_sums) =
            (bake.mesh().patches.len(), Some(bake.form_factors().factor_bytes()), row_sums);
        rows.push(row);
        pictures.push(frame.pictures.indirect);
    }
    progress.note("voxelised proxy");
    let settings = ProxySettings {
        patch_count: study.counts[0] as usize,
        rays: args.rays,
        point_rays: BakeSettings::default().sample_rays,
        seed: common.seed,
    };
    let proxy = ProxyRadiosity::bake(&loaded.scene, settings, progress)?;
    let picture = proxy.indirect(&camera, args.sub_frames, ProxyLookup::Face)?;
    rows.push(Row { patches: proxy.patch_count(), ..row("voxelised proxy", &picture, &truth)? });
    pictures.push(picture);
    write(study, &truth, &pictures)?;
    Ok(Outcome {
        rows: serde_json::to_value(&rows).unwrap_or_default(),
        tables: vec![table(&rows, &truth)],
        plots: Vec::new(),
    })
}

/// Extremes of the sums of the patches' form factors, the sky's included.
fn row_sums(bake: &Bake) -> Option<(f32, f32)> {
    let patchlight::FormFactors { factors, sky_factor, element_rows, .. } = bake.form_factors();
    let sum = |i: usize| factors.row(i).map(|(_, f)| f).sum::<f32>() + sky_factor.get(i).unwrap_or(&0.0);
    // Rows of elements are not patches'.
    element_rows.is_none().then(|| extremes((0..bake.mesh().patches.len()).map(sum)))
}

/// Light by the patches, form factors and sums of the thesis.
fn as_printed(study: &Study, kind: PatchKind, truth: &Truth) -> Result<(Row, Picture), Error> {
    const NAME: &str = "as printed";
    let Study { args, common, loaded, progress, .. } = *study;
    progress.note(NAME);
    let form = if kind == PatchKind::Axis { Form::Axes } else { Form::Clusters };
    let settings = PrintedSettings { form, count: study.counts[0] as usize, voxel_size: None, seed: common.seed };
    let printed = interruptible(|| PrintedRadiosity::new(&loaded.scene, &settings, progress))?;
    progress.note(&format!(
        "{} points, {} of their form factors in memory at once, of {}",
        printed.set.samples.len(),
        printed.most_entries,
        printed.set.samples.len().pow(2)
    ));
    let irradiance = printed.irradiance(BakeSettings::default().sample_rays, BOUNCES)?;
    let camera = loaded.view.camera(truth.size().0, truth.size().1);
    let picture = printed.indirect(&irradiance, &camera, args.sub_frames)?;
    let found = Row {
        patches: printed.set.len(),
        factor_bytes: Some(size_of_val(&printed.factors.values[..]) as u64),
        row_sums: Some(extremes(
            (0..printed.set.len()).map(|i| printed.factors.row(i).iter().sum::<f32>() + printed.sky[i]),
        )),
        ..row(NAME, &picture, truth)?
    };
    Ok((found, picture))
}

/// The least and the greatest.
fn extremes(sums: impl Iterator<Item = f32>) -> (f32, f32) {
    sums.fold((f32::INFINITY, 0.0), |(least, most), sum| (least.min(sum), most.max(sum)))
}

/// Errors of a picture, as it is and with the mean of the reference.
fn row(what: &'static str, picture: &Picture, truth: &Truth) -> Result<Row, Error> {
    output::check_finite(0, picture)?;
    let expected = &truth.pictures.indirect;
    let scale = indirect_scale(expected);
    let errors = compare_pictures(picture, expected, scale, None)?;
    let scaled = compare_pictures(&with_mean(picture, errors.mean_ratio)?, expected, scale, None)?;
    Ok(Row {
        what,
        patches: 0,
        factor_bytes: None,
        row_sums: None,
        brightness: errors.mean_ratio,
        block_median: errors.block_median_relative_error,
        ssim: errors.ssim,
        scaled_block_median: scaled.block_median_relative_error,
        scaled_ssim: scaled.ssim,
    })
}

/// A picture divided by what it is too bright.
fn with_mean(picture: &Picture, ratio: f64) -> Result<Picture, Error> {
    let scale = if ratio > 0.0 { (1.0 / ratio) as f32 } else { 1.0 };
    let pixels = picture.pixels.iter().map(|pixel| *pixel * scale).collect();
    Ok(Picture::from_pixels(picture.width, picture.height, pixels)?)
}

/// As in the thesis: the method, the reference, the proxy; between the first two ours. All have the reference's mean.
fn write(study: &Study, truth: &Truth, pictures: &[Picture]) -> Result<(), Error> {
    let expected = &truth.pictures.indirect;
    let scale = indirect_scale(expected);
    let mut shown = Vec::new();
    for picture in pictures {
        let ratio = compare_pictures(picture, expected, scale, None)?.mean_ratio;
        shown.push(with_mean(picture, ratio)?);
    }
    let [printed, ours, _, proxy] = &shown[..] else { return Ok(()) };
    let all = beside(&[printed, ours, expected, proxy])?;
    all.write_png(&study.file("pictures.png"), scale_to_stops(scale))?;
    Ok(())
}

fn table(rows: &[Row], truth: &Truth) -> Table {
    let percent = |share: f64| format!("{} %", significant(100.0 * share));
    let cells = |row: &Row| {
        vec![
            row.what.to_owned(),
            row.patches.to_string(),
            row.factor_bytes.map_or_else(|| "–".to_owned(), output::bytes),
            row.row_sums.map_or_else(|| "–".to_owned(), |(least, most)| format!("{least:.2} to {most:.2}")),
            significant(row.brightness),
            percent(row.block_median),
            format!("{:.4}", row.ssim),
            percent(row.scaled_block_median),
            format!("{:.4}", row.scaled_ssim),
        ]
    };
    let heads =
        ["form", "patches", "F", "sums of rows", "brightness", "error", "SSIM", "error, same mean", "SSIM, same mean"];
    Table {
        caption: format!(
            "Indirect light of {BOUNCES} bounces beside {}. Pictures, from the left: as printed, ours (patches \
             receive), reference, proxy; all with the mean of the reference.",
            truth.source
        ),
        head: heads.map(str::to_owned).to_vec(),
        rows: rows.iter().map(cells).collect(),
    }
}
