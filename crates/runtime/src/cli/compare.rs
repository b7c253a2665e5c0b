//! `patchlight compare`.

use reference::metrics::{compare_pictures, difference_picture, indirect_scale};
use reference::{Picture, PictureErrors, stops_to_scale};
use serde::Serialize;

use super::args::{Common, Compare};
use super::output;
use super::report::significant;
use crate::error::Error;
use crate::render::Pictures;

#[derive(Serialize)]
struct Comparison {
    ours: String,
    reference: String,
    full: PictureErrors,
}

pub fn run(common: &Common, args: &Compare) -> Result<(), Error> {
    let ours = Picture::read(&args.ours)?;
    let expected = Picture::read(&args.reference)?;
    let mask = match &args.mask {
        None => None,
        Some(path) => Some(Picture::read(path)?.pixels.iter().map(|p| p.max_element() > 0.0).collect::<Vec<_>>()),
    };
    let scale = args.stops.map_or_else(|| indirect_scale(&expected), stops_to_scale);
    let full = compare_pictures(&ours, &expected, scale, mask.as_deref())?;
    if let Some(path) = &args.difference {
        difference_picture(&ours, &expected, 0.5)?.write_png(path, 0.0)?;
    }
    let comparison =
        Comparison { ours: args.ours.display().to_string(), reference: args.reference.display().to_string(), full };
    if common.json {
        println!("{}", output::json(&comparison));
        return Ok(());
    }
    for (name, value) in rows(&full) {
        println!("{name:30} {value}");
    }
    Ok(())
}

/// Errors of all light, exposed as the scene says, and of indirect light.
pub fn picture_errors(
    ours: &Pictures,
    expected: &Pictures,
    stops: f32,
) -> Result<(PictureErrors, PictureErrors), Error> {
    let indirect_scale = indirect_scale(&expected.indirect);
    Ok((
        compare_pictures(&ours.full, &expected.full, stops_to_scale(stops), None)?,
        compare_pictures(&ours.indirect, &expected.indirect, indirect_scale, None)?,
    ))
}

/// The errors as lines of a table.
pub fn rows(e: &PictureErrors) -> Vec<(&'static str, String)> {
    vec![
        ("mse", significant(e.mse)),
        ("psnr_db", significant(e.psnr_db)),
        ("ssim", format!("{:.4}", e.ssim)),
        ("flip", significant(e.flip)),
        ("block_median_relative_error", significant(e.block_median_relative_error)),
        ("block_psnr_db", significant(e.block_psnr_db)),
        ("mean_ratio", format!("{:.4}", e.mean_ratio)),
    ]
}
