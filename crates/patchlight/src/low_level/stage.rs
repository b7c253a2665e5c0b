//! The stages of a frame, one file each: every one adds its passes to the plan.
//!
//! `direct` (irradiance at samples) → `source` (first exitance of elements and patches) → the method (irradiance of
//! patches) → `gather` (elements, receivers, interpolation points) → `shade` (pixels) → `display` (what a screen shows
//! of them).

pub mod bands;
pub mod direct;
pub mod display;
pub mod finish;
pub mod gather;
pub(crate) mod objects;
pub mod shade;
pub mod sky;
pub mod smooth;
pub mod source;
pub mod view;
