//! Errors of pictures, as tables print them.

use patchlight::Pictures;
use reference::metrics::{compare_pictures, indirect_scale};
use reference::{PictureErrors, stops_to_scale};

use crate::error::Error;
use crate::report::significant;

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
