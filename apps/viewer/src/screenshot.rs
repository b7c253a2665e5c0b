//! The window in a file.

use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};

use image::{ExtendedColorType, ImageFormat};

use crate::error::Error;
use crate::screen::Capture;

/// Path of a screenshot: a name in the folder, or the next number there.
pub fn path(folder: &Path, name: Option<PathBuf>) -> PathBuf {
    if let Some(name) = name {
        return folder.join(name);
    }
    let mut numbered = (1u32..).map(|number| folder.join(format!("shot-{number:04}.png")));
    numbered.find(|path| !path.exists()).unwrap_or_else(|| folder.join("shot.png"))
}

/// Writes the window as PNG, beside its place and then renamed.
///
/// # Errors
/// A device that cannot copy its window; what the file says.
pub fn write(path: &Path, capture: Option<&Capture>) -> Result<(), Error> {
    let failed = |reason: String| Error::Screenshot { path: path.to_path_buf(), reason };
    let none = "this device cannot copy its window, or the window is hidden: show it, or use `patchlight render`";
    let capture = capture.ok_or_else(|| failed(none.into()))?;
    let mut png = Cursor::new(Vec::new());
    let (width, height) = capture.size;
    image::write_buffer_with_format(&mut png, &capture.bytes, width, height, ExtendedColorType::Rgb8, ImageFormat::Png)
        .map_err(|error| failed(error.to_string()))?;
    let written = |source| reference::Error::Write { path: path.to_path_buf(), source };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(written)?;
    }
    Ok(reference::file::write_whole(path, |file| file.write_all(png.get_ref()).map_err(written))?)
}
