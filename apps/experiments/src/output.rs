//! What commands share: reading the scene, writing into the folder of results, printing.

use reference::PictureFile as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use patchlight::Pictures;
use patchlight::debug::DebugPicture;
use reference::metrics::indirect_scale;
use reference::{Precision, scale_to_stops};
use serde::Serialize;

use crate::error::Error;
use crate::progress::Progress;
use assets::import::{LoadedScene, load_or_build};

/// A scene from a file, or a built-in one; what was repaired is said.
pub fn import(spec: &str, progress: &Progress) -> Result<LoadedScene, Error> {
    let loaded = progress.phase("import", |_| load_or_build(spec))?;
    loaded.warnings.iter().for_each(|line| progress.warn(line));
    Ok(loaded)
}

/// Makes a folder and those above it.
pub fn make_folder(path: &Path) -> Result<(), Error> {
    std::fs::create_dir_all(path).map_err(|source| Error::Write { path: path.to_path_buf(), source })
}

/// Writes a text file through a temporary one that is renamed.
pub fn write_text(path: &Path, text: &str) -> Result<(), Error> {
    reference::file::write_whole(path, |file| {
        file.write_all(text.as_bytes()).map_err(|source| reference::Error::Write { path: path.to_path_buf(), source })
    })?;
    Ok(())
}

/// Writes the parts as EXR and as displayed.
pub fn write_pictures(out: &Path, pictures: &Pictures, stops: f32) -> Result<(), Error> {
    make_folder(out)?;
    let indirect_stops = scale_to_stops(indirect_scale(&pictures.indirect));
    for (name, picture, stops) in [
        ("full", &pictures.full, stops),
        ("direct", &pictures.direct, stops),
        ("indirect", &pictures.indirect, indirect_stops),
    ] {
        picture.write_exr(&out.join(format!("{name}.exr")), Precision::Half)?;
        picture.write_png(&out.join(format!("{name}.png")), stops)?;
    }
    Ok(())
}

/// Writes pictures for looking into a bake.
pub fn write_debug(folder: &Path, pictures: &[DebugPicture]) -> Result<(), Error> {
    make_folder(folder)?;
    for DebugPicture { name, picture, stops } in pictures {
        picture.write_png(&folder.join(format!("{name}.png")), *stops)?;
    }
    Ok(())
}

/// A value as indented JSON.
pub fn json(value: &impl Serialize) -> String {
    // Only maps with keys that are not strings cannot be written, and no type of ours has them.
    serde_json::to_string_pretty(value).unwrap_or_else(|e| format!("{{\"error\": \"{e}\"}}"))
}

/// `--out`, or a folder of that name under out/.
pub fn folder_or(out: &Option<PathBuf>, default: &str) -> PathBuf {
    out.clone().unwrap_or_else(|| Path::new("out").join(default))
}

/// Bytes in words: 1.5 MiB.
pub fn bytes(count: u64) -> String {
    const UNITS: [&str; 5] = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut value = count as f64;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < UNITS.len() {
        value /= 1024.0;
        unit += 1;
    }
    if unit == 0 { format!("{count} B") } else { format!("{value:.1} {}", UNITS[unit]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_in_words() {
        assert_eq!(bytes(0), "0 B");
        assert_eq!(bytes(1536), "1.5 KiB");
        assert_eq!(bytes(128 << 20), "128.0 MiB");
    }

    #[test]
    fn a_text_is_written_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write_text(&path, "one").unwrap();
        write_text(&path, "two").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "two");
        let error = write_text(&folder.path().join("missing/a.txt"), "x").unwrap_err().to_string();
        assert!(error.contains("missing/a.txt") && error.contains("check that its folder exists"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
