//! From radiance to the colours of a display.

use glam::{Mat3, Vec3, Vec4};

use super::shade::encode_srgb;
use crate::gpu::{Rgb, TONE_AGX, TONE_NEUTRAL};
use crate::math::{clamp, log2, luminance, pow_unit};

/// Brightest colour that [`neutral`] leaves as it is, and how fast what is brighter turns white.
const NEUTRAL_START: f32 = 0.8 - 0.04;
const NEUTRAL_DESATURATION: f32 = 0.15;

/// Stops below and above 1 between which [`agx`] maps, log₂.
const AGX_LOW: f32 = -12.473_93;
const AGX_HIGH: f32 = 4.026_069;
/// From linear Rec.709 to the primaries of [`agx`], those of Rec.2020 drawn inwards, and back.
const REC709_TO_REC2020: Mat3 =
    Mat3::from_cols_array(&[0.6274, 0.0691, 0.0164, 0.3293, 0.9195, 0.0880, 0.0433, 0.0113, 0.8956]);
const REC2020_TO_REC709: Mat3 =
    Mat3::from_cols_array(&[1.6605, -0.1246, -0.0182, -0.5876, 1.1329, -0.1006, -0.0728, -0.0083, 1.1187]);
const AGX_INWARDS: Mat3 = Mat3::from_cols_array(&[
    0.856_627_15,
    0.137_318_97,
    0.111_898_21,
    0.095_121_24,
    0.761_242,
    0.076_799_42,
    0.048_251_606,
    0.101_439_04,
    0.811_302_37,
]);
const AGX_OUTWARDS: Mat3 = Mat3::from_cols_array(&[
    1.127_100_6,
    -0.141_329_76,
    -0.141_329_76,
    -0.110_606_64,
    1.157_823_7,
    -0.110_606_64,
    -0.016_493_94,
    -0.016_493_94,
    1.251_936_4,
]);

/// Linear display colour in [0, 1] of an exposed colour, by one of the curves [`crate::gpu::TONE_NONE`], …
#[inline]
pub fn toned(color: Vec3, tone: u32) -> Vec3 {
    let color = color.max(Vec3::ZERO);
    let toned = if tone == TONE_AGX {
        agx(color)
    } else if tone == TONE_NEUTRAL {
        neutral(color)
    } else {
        color
    };
    Vec3::new(clamp(toned.x, 0.0, 1.0), clamp(toned.y, 0.0, 1.0), clamp(toned.z, 0.0, 1.0))
}

/// Khronos PBR Neutral (Khronos 2024): colours up to 0.8 stay, but for the reflectance of 0.04 that a glossy coat would
/// add; what is brighter nears 1 and turns white.
#[inline]
pub fn neutral(color: Vec3) -> Vec3 {
    let least = color.min_element();
    let offset = if least < 0.08 { least - 6.25 * least * least } else { 0.04 };
    let color = color - offset;
    let peak = color.max_element();
    if peak < NEUTRAL_START {
        return color;
    }
    let room = 1.0 - NEUTRAL_START;
    let new_peak = 1.0 - room * room / (peak + room - NEUTRAL_START);
    let white = 1.0 - 1.0 / (NEUTRAL_DESATURATION * (peak - new_peak) + 1.0);
    let color = color * (new_peak / peak);
    color + (Vec3::splat(new_peak) - color) * white
}

/// AgX (Sobotka 2022), its contrast as a polynomial (Wrensch 2023), with the primaries of Blender's and Filament's: film
/// of 16.5 stops in which bright colours fade to white.
#[inline]
pub fn agx(color: Vec3) -> Vec3 {
    let inside = AGX_INWARDS * (REC709_TO_REC2020 * color);
    let curved = Vec3::new(agx_curve(inside.x), agx_curve(inside.y), agx_curve(inside.z));
    let outside = (AGX_OUTWARDS * curved).max(Vec3::ZERO);
    REC2020_TO_REC709 * Vec3::new(pow_unit(outside.x, 2.2), pow_unit(outside.y, 2.2), pow_unit(outside.z, 2.2))
}

#[inline]
fn agx_curve(x: f32) -> f32 {
    let stops = log2(if x > 1e-10 { x } else { 1e-10 });
    let x = clamp((stops - AGX_LOW) / (AGX_HIGH - AGX_LOW), 0.0, 1.0);
    let low = -0.002_32 + x * (0.1191 + x * (0.4298 - x * 6.868));
    let high = 31.96 + x * (-40.14 + x * 15.5);
    low + x * x * x * x * high
}

/// A displayed pixel: radiance × scale by a tone curve, in sRGB, packed as bytes r, g, b, 255 from the lowest.
#[inline]
pub fn displayed(radiance: Vec4, scale: f32, tone: u32) -> u32 {
    let color = toned(radiance.truncate() * scale, tone);
    let r = (encode_srgb(color.x) * 255.0 + 0.5) as u32;
    let g = (encode_srgb(color.y) * 255.0 + 0.5) as u32;
    let b = (encode_srgb(color.z) * 255.0 + 0.5) as u32;
    r | g << 8 | b << 16 | 0xff00_0000
}

/// Mean luminance of `sums` from number `first` up to `end`.
#[inline]
pub fn mean_luminance(sums: &[Rgb], first: u32, end: u32) -> f32 {
    let mut total = 0.0;
    let mut k = first;
    while k < end {
        total += luminance(sums[k as usize].truncate());
        k += 1;
    }
    total / (end - first) as f32
}
