//! Common parts of commands: reading the scene, writing into the folder of results, printing.

use reference::PictureFile as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use patchlight::Pictures;
use patchlight::debug::DebugPicture;
use reference::metrics::indirect_scale;
use reference::{DisplayTransform, Picture, Precision, scale_to_stops};
use serde::Serialize;

use crate::error::Error;
use crate::progress::{Progress, is_cancelled};
use assets::import::{LoadOptions, LoadedScene, load_or_build_with};

/// A scene from a file, or a built-in one; what was repaired is said.
pub fn import(spec: &str, progress: &Progress) -> Result<LoadedScene, Error> {
    import_within(spec, None, progress)
}

/// Imports a scene with every triangle flat, as references and their comparisons have it.
///
/// # Errors
/// What the file says.
pub fn import_flat(spec: &str, progress: &Progress) -> Result<LoadedScene, Error> {
    let loaded = import(spec, progress)?;
    Ok(LoadedScene { scene: loaded.scene.clone().flat(), ..loaded })
}

/// Imports a scene within so many bytes of memory.
///
/// # Errors
/// What the file says.
pub fn import_within(spec: &str, memory_limit: Option<u64>, progress: &Progress) -> Result<LoadedScene, Error> {
    let options = LoadOptions { memory_limit, ..LoadOptions::default() };
    let loaded = progress.phase("import", |_| load_or_build_with(spec, &options))?;
    if is_cancelled() {
        return Err(Error::Cancelled);
    }
    loaded.warnings.iter().for_each(|line| progress.warn(line));
    Ok(loaded)
}

/// Checks that files can be written into a folder, which may not be there yet, before hours of work. Nothing is left
/// there.
///
/// # Errors
/// [`Error::Write`] with the folder and what the system says.
pub fn check_folder(folder: &Path) -> Result<(), Error> {
    let failed = |source| Error::Write { path: folder.to_path_buf(), source };
    let there = folder.ancestors().find(|place| place.exists()).filter(|place| !place.as_os_str().is_empty());
    let mut file = tempfile::tempfile_in(there.unwrap_or(Path::new("."))).map_err(failed)?;
    file.write_all(b"?").and_then(|()| file.sync_all()).map_err(failed)
}

/// Checks that a file can be written: [`check_folder`] of its folder.
///
/// # Errors
/// [`Error::Write`] with the file and what the system says.
pub fn check_file(path: &Path) -> Result<(), Error> {
    let failed = |source| Error::Write { path: path.to_path_buf(), source };
    if path.is_dir() {
        return Err(failed(std::io::ErrorKind::IsADirectory.into()));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        return Err(failed(std::io::ErrorKind::NotFound.into()));
    }
    check_folder(folder).map_err(|error| match error {
        Error::Write { source, .. } => failed(source),
        other => other,
    })
}

/// [`check_folder`] of `--out`, or of the folder in which results lie without it.
///
/// # Errors
/// As [`check_folder`].
pub fn check_out(out: &Option<PathBuf>) -> Result<(), Error> {
    check_folder(out.as_deref().unwrap_or(Path::new("out")))
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

/// Checks that all of a picture is numbers.
///
/// # Errors
/// [`Error::NotFinite`] with the first pixel that is none.
pub fn check_finite(frame: u32, picture: &Picture) -> Result<(), Error> {
    match picture.pixels.iter().position(|pixel| !pixel.is_finite()) {
        Some(k) => Err(Error::NotFinite { frame, x: k as u32 % picture.width, y: k as u32 / picture.width }),
        None => Ok(()),
    }
}

/// Writes the parts as EXR and as displayed; indirect light has an exposure of its own.
pub fn write_pictures(out: &Path, pictures: &Pictures, transform: &DisplayTransform) -> Result<(), Error> {
    make_folder(out)?;
    let indirect = DisplayTransform { stops: scale_to_stops(indirect_scale(&pictures.indirect)), ..*transform };
    for (name, picture, transform) in [
        ("full", &pictures.full, transform),
        ("direct", &pictures.direct, transform),
        ("indirect", &pictures.indirect, &indirect),
    ] {
        picture.write_exr(&out.join(format!("{name}.exr")), Precision::Half)?;
        picture.write_shown(&out.join(format!("{name}.png")), transform)?;
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
    fn a_pixel_that_is_no_number_is_named() {
        let mut picture = Picture::from_pixels(4, 3, vec![glam::Vec3::ONE; 12]).unwrap();
        assert!(check_finite(0, &picture).is_ok());
        picture.pixels[9].y = f32::INFINITY;
        let error = check_finite(7, &picture).unwrap_err().to_string();
        assert!(error.contains("frame 7") && error.contains("(1, 2)"), "{error}");
    }

    #[test]
    fn folders_that_cannot_be_written_are_found_and_nothing_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "x").unwrap();
        assert!(check_folder(&folder.path().join("new/deep")).is_ok());
        assert!(check_folder(&file.join("below")).unwrap_err().to_string().contains("file/below"));
        assert!(check_file(&folder.path().join("a.bake")).is_ok());
        for wrong in [folder.path().join("new/a.bake"), file.join("a.bake"), folder.path().to_path_buf()] {
            assert!(check_file(&wrong).unwrap_err().to_string().contains(&wrong.display().to_string()));
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

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
