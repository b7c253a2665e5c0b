//! Errors, the same as in any method.

pub use transport::Error;
pub(crate) use transport::check_length;
pub(crate) use transport::check_setting;
