//! Patchlight in the browser: the light of a bake, on the CPU, in tables that a page reads where they lie.
//!
//! `js/index.js` is what a page uses; it builds the tables of lights and makes typed arrays of what is here.

#[cfg(feature = "bake")]
mod baker;
mod field;
mod lights;

#[cfg(feature = "bake")]
pub use baker::{Baker, Listener};
pub use field::LightField;
pub use lights::LIGHT_NUMBERS;

use wasm_bindgen::prelude::wasm_bindgen;

/// A fault of ours comes to the page as an error that says what and where, not as a trap without words.
#[wasm_bindgen(start)]
pub fn start() {
    std::panic::set_hook(Box::new(|fault| wasm_bindgen::throw_str(&format!("patchlight: {fault}"))));
}
