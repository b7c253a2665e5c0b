//! See README.md.

pub mod export;
pub mod import;
pub mod procedural;
