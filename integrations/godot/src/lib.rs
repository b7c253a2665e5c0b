#![doc = include_str!("../README.md")]

mod gather;
mod lights;
mod node;
mod probes;
mod show;
mod work;

use godot::init::{ExtensionLibrary, gdextension};

struct Patchlight;

// SAFETY: the entry point is the macro's own.
#[gdextension]
unsafe impl ExtensionLibrary for Patchlight {}
