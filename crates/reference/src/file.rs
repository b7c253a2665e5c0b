//! Files that are either complete or not there.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::error::Error;

/// Writes a file through a temporary one beside it (`NAME.part`) that is renamed at the end, so that a reader never
/// sees half a file. `write` fills the file; its own errors and those of the system remove the temporary file.
///
/// # Errors
/// [`Error::Write`] when the system refuses, else what `write` returns.
pub fn write_whole(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> Result<(), Error>) -> Result<(), Error> {
    let failed = |source| Error::Write { path: path.to_path_buf(), source };
    let mut name = path.as_os_str().to_os_string();
    name.push(".part");
    let part = PathBuf::from(name);
    let mut file = BufWriter::new(File::create(&part).map_err(failed)?);
    let result = write(&mut file)
        .and_then(|()| file.flush().map_err(failed))
        .and_then(|()| file.get_ref().sync_all().map_err(failed));
    drop(file);
    let result = result.and_then(|()| fs::rename(&part, path).map_err(failed));
    if result.is_err() {
        // The first error is the one to report.
        let _ = fs::remove_file(&part);
    }
    result
}
