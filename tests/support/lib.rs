//! Shared by the integration tests: seeded inputs, tolerances, the skip rules.

pub mod frames;
pub mod glb;
pub mod kernels;
pub mod limited;
pub mod mutate;
pub mod setup;
pub mod spirv;

use std::sync::LazyLock;

use gpu_kernels::table::Kernel;
use runtime::executor::DeviceChoice;
use runtime::vulkan::{Validation, Vulkan};
use scene::Picture;
use scene::math::luminance;

/// Every kernel: those of the library, then those of the laboratory.
pub static KERNELS: LazyLock<Vec<&'static Kernel>> = LazyLock::new(|| {
    let all = gpu_kernels::table::KERNELS.iter().chain(lab_kernels::KERNELS);
    all.copied().collect()
});

/// The best Vulkan device with the validation layer watching, or `None` after saying why; with `REQUIRE_VULKAN=1` a
/// missing device is a failure. `PATCHLIGHT_VALIDATION=1` makes a missing layer one, too.
pub fn vulkan() -> Option<Vulkan> {
    let validation = match Validation::parse(std::env::var("PATCHLIGHT_VALIDATION").ok().as_deref()) {
        Validation::Off => Validation::IfThere,
        other => other,
    };
    match Vulkan::open(&DeviceChoice::Vulkan, validation) {
        Ok(vulkan) => Some(vulkan),
        Err(error) => {
            let required = std::env::var("REQUIRE_VULKAN").is_ok_and(|value| value == "1");
            assert!(!required, "REQUIRE_VULKAN is set: {error}");
            println!("skipped: {error}");
            None
        }
    }
}

/// Mean difference of the luminance of blocks of so many pixels, over the mean of what is expected.
pub fn block_difference(edge: u32, found: &Picture, expected: &Picture) -> f32 {
    let (found, expected) = (found.block_means(edge), expected.block_means(edge));
    let pairs = found.pixels.iter().zip(&expected.pixels);
    let apart: f32 = pairs.map(|(a, b)| (luminance(*a) - luminance(*b)).abs()).sum();
    apart / expected.pixels.iter().map(|c| luminance(*c)).sum::<f32>()
}
