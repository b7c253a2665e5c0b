//! Sums in fixed point that many invocations add to: integers, so the order of additions changes nothing.

use ::firstshot::Fixed;
use ::firstshot::kernel::fixed::{carry, fixed};
use ::firstshot::kernel::register::SUM_WORDS;
use ::scene::NONE;
use ::scene::math::luminance;
use glam::Vec3;

/// Adds to a word, together with all other invocations; the word before.
#[cfg(target_arch = "spirv")]
#[allow(unsafe_code)]
#[inline]
fn fetch_add(word: &mut u32, value: u32) -> u32 {
    use spirv_std::arch::atomic_i_add;
    use spirv_std::memory::{Scope, Semantics};
    // SAFETY: the word is in a storage buffer that the kernel changes by atomic additions only; a dispatch runs on one
    // queue.
    unsafe { atomic_i_add::<u32, { Scope::QueueFamily as u32 }, { Semantics::NONE.bits() }>(word, value) }
}

/// Adds to a word; the word before. On the host one invocation has the buffer to itself: who shares it has a host form.
#[cfg(not(target_arch = "spirv"))]
#[inline]
fn fetch_add(word: &mut u32, value: u32) -> u32 {
    let before = *word;
    *word = before.wrapping_add(value);
    before
}

/// Adds to the number whose low word is word `at`.
#[inline]
fn add(words: &mut [u32], at: u32, value: Fixed) {
    let before = fetch_add(&mut words[at as usize], value.low);
    let high = value.high + carry(before, value.low);
    if high != 0 {
        fetch_add(&mut words[at as usize + 1], high);
    }
}

/// Adds flux to a sum of three channels, unless the sum is [`NONE`].
#[inline]
pub fn add_flux(words: &mut [u32], sum: u32, flux: Vec3) {
    if sum != NONE {
        add(words, SUM_WORDS * sum, fixed(flux.x));
        add(words, SUM_WORDS * sum + 2, fixed(flux.y));
        add(words, SUM_WORDS * sum + 4, fixed(flux.z));
    }
}

/// Adds the luminance of flux to the number at `at`, unless that is [`NONE`].
#[inline]
pub fn add_luminance(words: &mut [u32], at: u32, flux: Vec3) {
    if at != NONE {
        add(words, at, fixed(luminance(flux)));
    }
}

/// Adds a count to the number at `at`.
#[inline]
pub fn add_count(words: &mut [u32], at: u32, count: u32) {
    add(words, at, Fixed { low: count, high: 0 });
}
