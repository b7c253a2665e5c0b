//! Unit directions as places of a square (Praun and Hoppe 2003, "Spherical Parametrization and Remeshing"; Cigolle et
//! al. 2014).

use core::ops::{Add, Mul};

use glam::{Vec2, Vec3, vec2};
use scene::math::abs;

/// Place of a direction in [−1, 1]²: +z in the middle, −z in the corners.
#[inline]
pub fn encode(direction: Vec3) -> Vec2 {
    let length = abs(direction.x) + abs(direction.y) + abs(direction.z);
    let p = vec2(direction.x / length, direction.y / length);
    if direction.z >= 0.0 { p } else { folded(p) }
}

/// Unit direction of a place.
#[inline]
pub fn decode(p: Vec2) -> Vec3 {
    let z = 1.0 - abs(p.x) - abs(p.y);
    let p = if z >= 0.0 { p } else { folded(p) };
    p.extend(z).normalize()
}

/// The lower half of the octahedron, over the edges of the upper one.
#[inline]
fn folded(p: Vec2) -> Vec2 {
    vec2((1.0 - abs(p.y)) * sign(p.x), (1.0 - abs(p.x)) * sign(p.y))
}

#[inline]
fn sign(x: f32) -> f32 {
    if x < 0.0 { -1.0 } else { 1.0 }
}

/// Unit direction of the centre of texel (x, y) of `edge`².
#[inline]
pub fn texel_direction(x: u32, y: u32, edge: u32) -> Vec3 {
    let place = |k: u32| (k as f32 + 0.5) * (2.0 / edge as f32) - 1.0;
    decode(vec2(place(x), place(y)))
}

/// The texel without border, (x, y) of `edge`², whose value stored texel `k` of `(edge + 2)²` has: beyond an edge the
/// square goes on with the mirrored edge.
#[inline]
pub fn inner_texel(k: u32, edge: u32) -> (u32, u32) {
    let x = k % (edge + 2);
    let y = k / (edge + 2);
    let is_side = x == 0 || x > edge;
    let is_end = y == 0 || y > edge;
    let opposite_side = if x == 0 { edge - 1 } else { 0 };
    let opposite_end = if y == 0 { edge - 1 } else { 0 };
    if is_side && is_end {
        (opposite_side, opposite_end)
    } else if is_end {
        (edge - x, edge - 1 - opposite_end)
    } else if is_side {
        (edge - 1 - opposite_side, edge - y)
    } else {
        (x - 1, y - 1)
    }
}

/// Bilinear value in a unit direction; `texel` gives stored ones.
#[inline]
pub fn sample<T: Copy + Add<Output = T> + Mul<f32, Output = T>>(
    edge: u32,
    direction: Vec3,
    texel: impl Fn(usize) -> T,
) -> T {
    // Texel centres are at half numbers, and the border is one texel.
    let p = encode(direction);
    let scale = 0.5 * edge as f32;
    let px = (p.x + 1.0) * scale + 0.5;
    let py = (p.y + 1.0) * scale + 0.5;
    let x = lesser(px as u32, edge);
    let y = lesser(py as u32, edge);
    let fx = px - x as f32;
    let fy = py - y as f32;
    let first = (y * (edge + 2) + x) as usize;
    let second = first + edge as usize + 2;
    (texel(first) * (1.0 - fx) + texel(first + 1) * fx) * (1.0 - fy)
        + (texel(second) * (1.0 - fx) + texel(second + 1) * fx) * fy
}

#[inline]
fn lesser(a: u32, b: u32) -> u32 {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::*;
    use scene::sampling::{hash, unit};

    fn directions() -> impl Iterator<Item = Vec3> {
        let number = |k: u32| 2.0 * unit(hash(k)) - 1.0;
        (0..300).map(move |k| Vec3::new(number(3 * k), number(3 * k + 1), number(3 * k + 2)).normalize())
    }

    #[test]
    fn places_give_their_directions_back() {
        for d in directions() {
            assert!((decode(encode(d)) - d).length() < 1e-5, "{d}");
            assert!((decode(encode(-d)) - d).length() > 1.9);
        }
    }

    /// Greatest error of the x of a direction, read from a square of directions; `texel` gives the texel that a stored
    /// one has.
    fn error(texel: impl Fn(u32) -> (u32, u32)) -> f32 {
        let texels: Vec<f32> = (0..18 * 18).map(texel).map(|(x, y)| texel_direction(x, y, 16).x).collect();
        directions().map(|d| (sample(16, d, |k| texels[k]) - d.x).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn bilinear_values_go_on_over_the_edges() {
        assert!(error(|k| inner_texel(k, 16)) < 0.05);
        let not_mirrored = |k: u32| ((k % 18).clamp(1, 16) - 1, (k / 18).clamp(1, 16) - 1);
        assert!(error(not_mirrored) > 0.07, "a border that is not mirrored goes unnoticed");
    }

    #[test]
    fn every_texel_is_its_own_within_the_border() {
        for (x, y) in (0..64).map(|k| (k % 8, k / 8)) {
            assert_eq!(inner_texel((y + 1) * 10 + x + 1, 8), (x, y));
        }
    }
}
