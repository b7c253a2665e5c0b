//! Exceptions, one for each kind of error of the library.

use patchlight::ErrorKind;
use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;

create_exception!(
    patchlight,
    PatchlightError,
    PyException,
    "An error of Patchlight; its text names the place and the remedy."
);
create_exception!(
    patchlight,
    InputError,
    PatchlightError,
    "A scene, a light, a setting or an array that makes no sense."
);
create_exception!(
    patchlight,
    UnsupportedError,
    PatchlightError,
    "A combination of scene and method that is not served."
);
create_exception!(patchlight, OutOfMemoryError, PatchlightError, "More memory than there is, or than was allowed.");
create_exception!(patchlight, DeviceError, PatchlightError, "The system or a device.");
create_exception!(patchlight, FileError, PatchlightError, "A file that is missing, damaged or of another kind.");
create_exception!(patchlight, Cancelled, PatchlightError, "The work was cancelled.");

/// Adds the exceptions to the module.
pub fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("PatchlightError", py.get_type::<PatchlightError>())?;
    module.add("InputError", py.get_type::<InputError>())?;
    module.add("UnsupportedError", py.get_type::<UnsupportedError>())?;
    module.add("OutOfMemoryError", py.get_type::<OutOfMemoryError>())?;
    module.add("DeviceError", py.get_type::<DeviceError>())?;
    module.add("FileError", py.get_type::<FileError>())?;
    module.add("Cancelled", py.get_type::<Cancelled>())
}

/// The exception of an error.
pub fn exception(error: patchlight::Error) -> PyErr {
    let text = error.to_string();
    match error.kind() {
        ErrorKind::Input => InputError::new_err(text),
        ErrorKind::Unsupported => UnsupportedError::new_err(text),
        ErrorKind::Memory => OutOfMemoryError::new_err(text),
        ErrorKind::File => FileError::new_err(text),
        ErrorKind::Cancelled => Cancelled::new_err(text),
        _ => DeviceError::new_err(text),
    }
}

/// What an argument is that makes no sense.
pub fn input(text: impl ToString) -> PyErr {
    InputError::new_err(text.to_string())
}
