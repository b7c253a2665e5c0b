//! Devices of programs, by their options and environment.

use runtime::executor::{DeviceChoice, Executor, ExecutorError, open_validated};
use runtime::vulkan::Validation;

/// Use of the validation layer, by `PATCHLIGHT_VALIDATION`: 0 is off, any other text requires it; debug builds use it
/// if it is there.
pub fn validation() -> Validation {
    Validation::parse(std::env::var("PATCHLIGHT_VALIDATION").ok().as_deref())
}

/// Opens the device that answers to the choice: [`runtime::executor::open`], with [`validation`].
///
/// # Errors
/// A device that was asked for and is not there, or lacks a feature; a layer that is required and is not there.
pub fn open(choice: &DeviceChoice) -> Result<(Box<dyn Executor>, Option<String>), ExecutorError> {
    open_validated(choice, validation())
}
