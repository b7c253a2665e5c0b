//! Half-precision numbers: the unpacking that the device has and its equal on the host.

use glam::{UVec2, Vec4};

/// Four half-precision numbers in two words, lower half first. Exact for finite numbers, subnormals too.
#[cfg(target_arch = "spirv")]
#[inline]
pub fn unpack_half4(words: UVec2) -> Vec4 {
    let low = spirv_std::float::f16x2_to_vec2(words.x);
    let high = spirv_std::float::f16x2_to_vec2(words.y);
    Vec4::new(low.x, low.y, high.x, high.y)
}

/// Four half-precision numbers in two words, lower half first. Exact for finite numbers, subnormals too.
#[cfg(all(not(target_arch = "spirv"), feature = "std"))]
#[inline]
pub fn unpack_half4(words: UVec2) -> Vec4 {
    use ::formfactor::widen_half;
    Vec4::new(widen_half(words.x), widen_half(words.x >> 16), widen_half(words.y), widen_half(words.y >> 16))
}
