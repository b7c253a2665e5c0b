//! `patchlight compare`.

use reference::PictureFile as _;
use reference::metrics::{compare_pictures, difference_picture, indirect_scale};
use reference::{Picture, PictureErrors, stops_to_scale};
use serde::Serialize;

use super::args::Compare;
use experiments::Error;
use experiments::args::Common;
use experiments::{errors, output};

#[derive(Serialize)]
struct Comparison {
    ours: String,
    reference: String,
    full: PictureErrors,
}

pub fn run(common: &Common, args: &Compare) -> Result<(), Error> {
    common.native_only("compare")?;
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
    for (name, value) in errors::rows(&full) {
        println!("{name:30} {value}");
    }
    Ok(())
}
