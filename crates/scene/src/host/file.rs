//! Files that are read whole: regular ones only, for a pipe or a device may never end.

use std::fs::File;
use std::io::{Error, ErrorKind, Read as _};
use std::path::Path;
use std::vec::Vec;

/// Opens a regular file. Anything else is not even opened: to open a pipe waits for who writes into it.
///
/// # Errors
/// The system's, and `InvalidInput` for what is no regular file.
pub fn open_regular(path: &Path) -> Result<File, Error> {
    match std::fs::metadata(path)?.is_file() {
        true => File::open(path),
        false => Err(Error::new(ErrorKind::InvalidInput, "it is no regular file")),
    }
}

/// All bytes of a regular file.
///
/// # Errors
/// As [`open_regular`].
pub fn read_regular(path: &Path) -> Result<Vec<u8>, Error> {
    let mut file = open_regular(path)?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(file.metadata()?.len()).unwrap_or(usize::MAX))?;
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::string::ToString as _;

    use super::*;

    #[test]
    fn what_is_no_regular_file_is_refused_before_it_is_opened() {
        for path in ["/dev/zero", "/dev/null", "."] {
            if Path::new(path).exists() {
                let error = read_regular(Path::new(path)).unwrap_err();
                assert!(error.to_string().contains("no regular file"), "{path}: {error}");
            }
        }
        assert_eq!(read_regular(Path::new("no such file")).unwrap_err().kind(), ErrorKind::NotFound);
        assert!(!read_regular(Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml").as_path()).unwrap().is_empty());
    }
}
