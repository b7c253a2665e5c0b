//! Phases of long work, as an observer sees them.

use scene::Scene;
use transport::{Observer, Phase, Proceed, Steps};

/// Progress callback of the method crates.
pub type Report<'a> = dyn Fn(usize, usize) -> Proceed + Sync + 'a;

/// Runs a phase; the observer receives its beginning, its steps and its end.
pub fn run_phase<T>(observer: &dyn Observer, phase: Phase, work: impl FnOnce(&Report) -> T) -> T {
    Steps::new(observer, phase).run(work)
}

/// Warns of surfaces that mirror light or let it through, for methods with form factors.
pub fn warn_of_specular_materials(scene: &Scene, observer: &dyn Observer) {
    if let Some(material) = scene.specular_material() {
        observer.warn(&format!(
            "material {material} of the scene mirrors light or lets it through: pictures show what is seen in mirrors \
             and through glass, but form factors know the diffuse part alone, so light that comes to other surfaces \
             that way is missing; photons and path tracing find it"
        ));
    }
}
