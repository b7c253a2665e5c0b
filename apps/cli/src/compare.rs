//! `patchlight compare`.

use reference::PictureFile as _;
use reference::metrics::{
    absolute_difference_picture, compare_pictures, difference_picture, indirect_scale, noise_picture, noise_share,
};
use reference::{Faults, Judge, Picture, PictureErrors, stops_to_scale};
use scene::math::luminance;
use serde::Serialize;

use super::args::Compare;
use shell::Error;
use shell::args::Common;
use shell::{errors, output};

#[derive(Serialize)]
struct Comparison {
    ours: String,
    reference: String,
    full: PictureErrors,
    faults: PictureFaults,
}

/// Visible faults, in shares of pixels.
#[derive(Serialize)]
struct PictureFaults {
    #[serde(flatten)]
    faults: Faults,
    noise_share: f64,
}

/// Edge of the squares of the picture of blotches, pixels, and the relative error of full colour.
const BLOTCH_EDGE: u32 = 16;
const BLOTCH_RANGE: f32 = 0.2;

pub fn run(common: &Common, args: &Compare) -> Result<(), Error> {
    common.native_only("compare")?;
    args.difference.as_deref().map(output::check_file).transpose()?;
    args.marked.as_deref().map(output::check_folder).transpose()?;
    let ours = Picture::read(&args.ours)?;
    let expected = Picture::read(&args.reference)?;
    let mask = match &args.mask {
        None => None,
        Some(path) => Some(Picture::read(path)?.pixels.iter().map(|p| p.max_element() > 0.0).collect::<Vec<_>>()),
    };
    let scale = args.stops.map_or_else(|| indirect_scale(&expected), stops_to_scale);
    let compared = |source: reference::Error| Error::Compared {
        ours: args.ours.clone(),
        reference: args.reference.clone(),
        source: Box::new(source),
    };
    let full = compare_pictures(&ours, &expected, scale, mask.as_deref()).map_err(compared)?;
    if let Some(path) = &args.difference {
        match args.difference_gain {
            Some(gain) => absolute_difference_picture(&ours, &expected, gain * scale)?.write_png(path, 0.0)?,
            None => difference_picture(&ours, &expected, 0.5)?.write_png(path, 0.0)?,
        }
    }
    let standard_error = args.reference_error.as_deref().map(Picture::read).transpose()?;
    let mut judge = Judge { standard_error: standard_error.as_ref(), ..Judge::new(&expected) };
    if let Some(path) = &args.indirect {
        judge.mean_light = f64::from(luminance(Picture::read(path)?.mean()));
    }
    let faults = PictureFaults {
        faults: judge.faults(&ours, mask.as_deref()).map_err(compared)?,
        noise_share: noise_share(&ours, &expected, scale, mask.as_deref()).map_err(compared)?,
    };
    if let Some(folder) = &args.marked {
        output::make_folder(folder)?;
        judge.fault_picture(&ours, scale)?.write_png(&folder.join("faults.png"), 0.0)?;
        noise_picture(&ours, &expected, scale)?.write_png(&folder.join("noise.png"), 0.0)?;
        judge.blotch_picture(&ours, BLOTCH_EDGE, BLOTCH_RANGE)?.write_png(&folder.join("blotches.png"), 0.0)?;
    }
    let comparison = Comparison {
        ours: args.ours.display().to_string(),
        reference: args.reference.display().to_string(),
        full,
        faults,
    };
    if common.json {
        say!("{}", output::json(&comparison));
        return Ok(());
    }
    for (name, value) in errors::rows(&full) {
        say!("{name:30} {value}");
    }
    print_faults(&comparison.faults);
    Ok(())
}

fn print_faults(PictureFaults { faults, noise_share }: &PictureFaults) {
    let shares = [("leaks", faults.leak_share), ("stains", faults.stain_share), ("noise", *noise_share)];
    for (name, share) in shares {
        say!("{name:30} {:.3} % of the pixels", 100.0 * share);
    }
    let blotches = [("blotches 16", faults.blotch_16_p95), ("blotches 32", faults.blotch_p95)];
    for (name, error) in blotches.into_iter().chain([("blotches 64", faults.blotch_64_p95)]) {
        if let Some(error) = error {
            say!("{name:30} {:.2} %, 95th percentile", 100.0 * error);
        }
    }
}
