//! Texture blocks: our decoding against that of another crate.

use glam::{UVec4, Vec4};
use patchlight_multibounce::kernel::blocks::{Bc1, Bc3, Bc6h, Bc7, BlockFormat};
use scene::sampling::hash3;

/// A random block; `mode`, where given, is put into its lowest bits.
fn block(k: u32, mode: Option<(u32, u32)>) -> UVec4 {
    let mut w = UVec4::new(hash3(k, 0, 1), hash3(k, 1, 1), hash3(k, 2, 1), hash3(k, 3, 1));
    if let Some((bits, count)) = mode {
        w.x = w.x >> count << count | bits;
    }
    w
}

fn bytes(w: UVec4) -> [u8; 16] {
    bytemuck::cast(w.to_array())
}

/// Texels of a block by our decoder.
fn decoded<F: BlockFormat>(w: UVec4) -> [Vec4; 16] {
    let block = F::parse(w);
    core::array::from_fn(|k| F::texel(block, k as u32))
}

/// Texels of a block of 8-bit colours by the other decoder.
fn expected(w: UVec4, decode: impl Fn(&[u8], &mut [u8], usize)) -> [Vec4; 16] {
    let mut texels = [0u8; 64];
    decode(&bytes(w), &mut texels, 16);
    core::array::from_fn(|k| {
        let t = &texels[4 * k..4 * k + 4];
        Vec4::new(t[0].into(), t[1].into(), t[2].into(), t[3].into())
    })
}

/// Greatest differences in 255ths, of colours and of alpha.
fn difference(a: &[Vec4; 16], b: &[Vec4; 16]) -> (f32, f32) {
    let worst = a.iter().zip(b).map(|(a, b)| (*a * 255.0 - *b).abs()).fold(Vec4::ZERO, Vec4::max);
    (worst.truncate().max_element(), worst.w)
}

#[test]
fn bc7_is_decoded_bit_for_bit_in_all_modes() {
    for mode in 0..=8u32 {
        for k in 0..4000 {
            let w = block(k, Some((1 << mode & 255, mode + 1)));
            let ours = decoded::<Bc7>(w);
            let theirs = expected(w, bcdec_rs::bc7);
            for (a, b) in ours.iter().zip(&theirs) {
                assert_eq!(*a, *b * (1.0 / 255.0), "mode {mode} {w:08x?}");
            }
            // A flipped bit shows, except in the mode that says nothing.
            if mode < 8 {
                let other = decoded::<Bc7>(w ^ UVec4::new(0, 1 << (k % 32), 0, 0x8000_0000));
                assert_ne!(other, ours);
            }
        }
    }
}

#[test]
fn bc6h_is_decoded_bit_for_bit_in_all_modes() {
    let modes = [0u32, 1].map(|m| (m, 2)).into_iter().chain((0..8).flat_map(|m| [(4 * m + 2, 5), (4 * m + 3, 5)]));
    for mode in modes {
        for k in 0..4000 {
            let w = block(k, Some(mode));
            let mut texels = [0f32; 48];
            bcdec_rs::bc6h_float(&bytes(w), &mut texels, 12, false);
            let ours = decoded::<Bc6h>(w);
            for (a, b) in ours.iter().zip(texels.chunks(3)) {
                assert_eq!(*a, Vec4::new(b[0], b[1], b[2], 1.0), "mode {mode:?} {w:08x?}");
            }
        }
    }
}

#[test]
fn bc1_and_bc3_are_within_rounding_of_a_decoder_to_8_bits() {
    // The other decoder rounds endpoints and palette to 8 bits at once: half a step off the exact palette. Its alpha is
    // rounded down after adding 1/7 or 1/5; in BC1 without alpha ours is 1.
    for k in 0..20_000 {
        let w = block(k, None);
        let (color, _) = difference(&decoded::<Bc1>(w), &expected(w, bcdec_rs::bc1));
        assert!(color < 0.501, "{w:08x?}: {color}");
        let (color, alpha) = difference(&decoded::<Bc3>(w), &expected(w, bcdec_rs::bc3));
        assert!(color < 0.501 && alpha < 0.715, "{w:08x?}: {color} {alpha}");
        let other = decoded::<Bc1>(w ^ UVec4::new(0x8000, 0, 0, 0));
        assert!(difference(&other, &expected(w, bcdec_rs::bc1)).0 > 0.501);
    }
}
