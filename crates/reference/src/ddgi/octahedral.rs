//! Unit directions as places of a square (Praun and Hoppe 2003, "Spherical Parametrization and Remeshing"; Cigolle et al. 2014).

use std::ops::{Add, Mul};

use glam::{Vec2, Vec3, vec2};

/// Place of a direction in [−1, 1]²: +z in the middle, −z in the corners.
pub fn encode(direction: Vec3) -> Vec2 {
    let p = direction.truncate() / (direction.x.abs() + direction.y.abs() + direction.z.abs());
    if direction.z >= 0.0 { p } else { (Vec2::ONE - vec2(p.y, p.x).abs()) * sign(p) }
}

/// Unit direction of a place.
pub fn decode(p: Vec2) -> Vec3 {
    let z = 1.0 - p.x.abs() - p.y.abs();
    let p = if z >= 0.0 { p } else { (Vec2::ONE - vec2(p.y, p.x).abs()) * sign(p) };
    p.extend(z).normalize()
}

fn sign(p: Vec2) -> Vec2 {
    vec2(if p.x < 0.0 { -1.0 } else { 1.0 }, if p.y < 0.0 { -1.0 } else { 1.0 })
}

/// Unit direction of the centre of texel (x, y) of `edge`².
pub fn texel_direction(x: usize, y: usize, edge: usize) -> Vec3 {
    let centre = vec2(x as f32, y as f32) + 0.5;
    decode(centre * (2.0 / edge as f32) - 1.0)
}

/// Texels of a square with its border.
pub const fn stored(edge: usize) -> usize {
    (edge + 2) * (edge + 2)
}

/// Position of texel (x, y) among the stored ones.
pub fn place(x: usize, y: usize, edge: usize) -> usize {
    (y + 1) * (edge + 2) + x + 1
}

/// Fills the border, one texel wide: beyond an edge the square goes on with the mirrored edge.
pub fn fill_border<T: Copy>(texels: &mut [T], edge: usize) {
    let (row, last) = (edge + 2, edge + 1);
    for k in 0..edge {
        let mirrored = edge - 1 - k;
        texels[k + 1] = texels[place(mirrored, 0, edge)];
        texels[last * row + k + 1] = texels[place(mirrored, edge - 1, edge)];
        texels[(k + 1) * row] = texels[place(0, mirrored, edge)];
        texels[(k + 1) * row + last] = texels[place(edge - 1, mirrored, edge)];
    }
    texels[0] = texels[place(edge - 1, edge - 1, edge)];
    texels[last] = texels[place(0, edge - 1, edge)];
    texels[last * row] = texels[place(edge - 1, 0, edge)];
    texels[last * row + last] = texels[place(0, 0, edge)];
}

/// Bilinear value in a unit direction.
pub fn sample<T: Copy + Add<Output = T> + Mul<f32, Output = T>>(texels: &[T], edge: usize, direction: Vec3) -> T {
    // Texel centres are at half numbers, and the border is one texel.
    let p = (encode(direction) + 1.0) * (0.5 * edge as f32) + 0.5;
    let (x, y) = ((p.x as usize).min(edge), (p.y as usize).min(edge));
    let (fx, fy) = (p.x - x as f32, p.y - y as f32);
    let first = y * (edge + 2) + x;
    let second = first + edge + 2;
    (texels[first] * (1.0 - fx) + texels[first + 1] * fx) * (1.0 - fy)
        + (texels[second] * (1.0 - fx) + texels[second + 1] * fx) * fy
}

#[cfg(test)]
mod tests {
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

    /// Greatest error of the x of a direction, read from a square of directions.
    fn error(with_border: bool) -> f32 {
        let mut texels = vec![0.0; stored(16)];
        for (x, y) in (0..256).map(|k| (k % 16, k / 16)) {
            texels[place(x, y, 16)] = texel_direction(x, y, 16).x;
        }
        if with_border {
            fill_border(&mut texels, 16);
        }
        directions().map(|d| (sample(&texels, 16, d) - d.x).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn bilinear_values_go_on_over_the_edges() {
        assert!(error(true) < 0.05, "{}", error(true));
        assert!(error(false) > 0.2, "a missing border goes unnoticed");
    }
}
