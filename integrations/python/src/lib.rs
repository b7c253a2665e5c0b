//! The extension module `patchlight._core`: the library behind the Python package, in arrays. What users meet stands in
//! `python/patchlight`; names, units and shapes are documented there.

// A function has the arguments of the Python function above it, and gives a tuple of arrays.
#![allow(clippy::too_many_arguments, clippy::type_complexity)]

use pyo3::prelude::*;

mod arrays;
mod bake;
mod error;
mod field;
mod lights;
mod scene;
mod view_factors;
mod work;

/// Module `patchlight._core`.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    error::add_to(module)?;
    module.add_class::<scene::Scene>()?;
    module.add_class::<lights::Light>()?;
    module.add_class::<lights::Sky>()?;
    module.add_class::<bake::Bake>()?;
    module.add_class::<field::LightField>()?;
    module.add_function(wrap_pyfunction!(field::displayed, module)?)?;
    module.add_function(wrap_pyfunction!(view_factors::by_rays, module)?)?;
    module.add_function(wrap_pyfunction!(view_factors::by_contours, module)?)?;
    module.add_function(wrap_pyfunction!(scene::built_in_scenes, module)?)?;
    module.add_function(wrap_pyfunction!(scene::sky_directions, module)?)?;
    module.add("LUMENS_PER_WATT", patchlight::scene::LUMENS_PER_WATT)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
