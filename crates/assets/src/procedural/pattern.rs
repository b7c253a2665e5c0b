//! Textures of the built-in scenes, drawn once: sRGB bytes, seamless.

use std::sync::Arc;

use scene::sampling::{hash3, unit};

use crate::import::pictures::Source;

/// Width and height of every pattern, texels.
const SIZE: u32 = 256;

/// A pattern from a function of the texel (column, row from the top) to sRGB in 0 … 255.
fn draw(name: &str, colour: impl Fn(u32, u32) -> [f32; 3]) -> Source {
    let mut rgba = Vec::with_capacity((4 * SIZE * SIZE) as usize);
    for y in 0..SIZE {
        for x in 0..SIZE {
            rgba.extend(colour(x, y).map(|c| c.clamp(0.0, 245.0) as u8));
            rgba.push(255);
        }
    }
    Source::Made { name: format!("{name}.png"), width: SIZE, rgba: Arc::new(rgba) }
}

/// Noise in 0 … 1 with cells of `cell` texels, smooth, seamless.
fn noise(x: u32, y: u32, cell: u32, seed: u32) -> f32 {
    let cells = SIZE / cell;
    let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
    let fx = smooth((x % cell) as f32 / cell as f32);
    let fy = smooth((y % cell) as f32 / cell as f32);
    let at = |dx: u32, dy: u32| unit(hash3((x / cell + dx) % cells, (y / cell + dy) % cells, seed));
    let top = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
    let bottom = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
    top * (1.0 - fy) + bottom * fy
}

/// Noise of several sizes, mean about ½.
fn clouds(x: u32, y: u32, seed: u32) -> f32 {
    0.5 * noise(x, y, 64, seed) + 0.3 * noise(x, y, 16, seed + 1) + 0.2 * noise(x, y, 4, seed + 2)
}

fn shade(base: [f32; 3], factor: f32) -> [f32; 3] {
    base.map(|c| c * factor)
}

/// Stone tiles, 4 × 4, every other one darker, with joints.
pub fn tiles() -> Source {
    draw("tiles", |x, y| {
        let column = x / 64;
        let row = y / 64;
        if x % 64 < 2 || y % 64 < 2 {
            return [120.0, 112.0, 100.0];
        }
        let base = if (column + row) % 2 == 0 { [205.0, 192.0, 168.0] } else { [172.0, 148.0, 120.0] };
        shade(base, 0.86 + 0.2 * clouds(x, y, 7 + 13 * (4 * row + column)))
    })
}

/// Courses of dressed stone.
pub fn masonry() -> Source {
    draw("masonry", |x, y| {
        let course = y / 32;
        let shifted = (x + 32 * (course % 2)) % SIZE;
        if y % 32 < 2 || shifted % 64 < 2 {
            return [150.0, 138.0, 120.0];
        }
        let tone = 0.85 + 0.15 * unit(hash3(course, shifted / 64, 3));
        shade([214.0, 196.0, 164.0], tone * (0.9 + 0.15 * clouds(x, y, 40)))
    })
}

/// Lime plaster.
pub fn plaster() -> Source {
    draw("plaster", |x, y| shade([226.0, 214.0, 192.0], 0.9 + 0.14 * clouds(x, y, 60)))
}

/// Woven cloth of a colour, with a border pattern.
pub fn cloth(name: &str, colour: [f32; 3]) -> Source {
    draw(name, move |x, y| {
        let weave = 0.92 + 0.08 * if (x / 2 + y / 2) % 2 == 0 { 1.0 } else { 0.0 };
        let dx = x as i32 % 128 - 64;
        let dy = y as i32 % 128 - 64;
        let diamond = dx.abs() + dy.abs();
        let gold = (26..32).contains(&diamond) || diamond < 7;
        let base = if gold { [214.0, 176.0, 92.0] } else { colour };
        shade(base, weave * (0.9 + 0.15 * clouds(x, y, 90)))
    })
}

/// Wooden boards along u.
pub fn wood() -> Source {
    draw("wood", |x, y| {
        let board = y / 32;
        if y % 32 < 1 {
            return [70.0, 48.0, 30.0];
        }
        let grain = noise((x / 8) % SIZE, (y * 4 + 31 * board) % SIZE, 4, 120 + board);
        shade([176.0, 128.0, 82.0], 0.8 + 0.1 * unit(hash3(board, 1, 9)) + 0.18 * grain)
    })
}

/// Carpet.
pub fn carpet() -> Source {
    draw("carpet", |x, y| shade([104.0, 112.0, 124.0], 0.85 + 0.3 * unit(hash3(x / 2, y / 2, 5))))
}

/// Wallpaper: stripes with a small pattern between them.
pub fn paper() -> Source {
    draw("paper", |x, y| {
        let dx = x as i32 % 64 - 44;
        let dy = (y as i32 + 32 * (x as i32 / 64 % 2)) % 64 - 32;
        let base = match (x % 64 < 14, dx.abs() + dy.abs() < 9) {
            (true, _) => [196.0, 178.0, 140.0],
            (false, true) => [150.0, 96.0, 84.0],
            _ => [214.0, 204.0, 182.0],
        };
        shade(base, 0.94 + 0.08 * clouds(x, y, 150))
    })
}

/// Normals of courses of bricks that stand out of their joints, 8 × 4 of them, up is green.
pub fn brick_normals() -> Source {
    // Distance to the nearest edge of a brick, texels, as far as it is bevelled.
    let height = |x: u32, y: u32| {
        let course = y / 32;
        let along = (x + 32 * (course % 2)) % 64;
        let to_edge = (along.min(63 - along)).min((y % 32).min(31 - y % 32));
        to_edge.min(6) as f32 + 1.5 * clouds(x, y, 211)
    };
    draw("brick-normals", |x, y| {
        let next = |x: u32, y: u32| height(x % SIZE, y % SIZE);
        let along_x = next(x + 1, y) - next(x + SIZE - 1, y);
        let along_y = next(x, y + 1) - next(x, y + SIZE - 1);
        // Rows run downwards.
        let normal = glam::Vec3::new(-0.35 * along_x, 0.35 * along_y, 1.0).normalize();
        normal.to_array().map(|c| (127.5 * c + 128.0).min(245.0))
    })
}
