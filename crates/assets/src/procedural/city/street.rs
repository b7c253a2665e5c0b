//! Pavements, trees, lamp posts, cars, bicycles, benches, and the leaves that fill up the triangles.

use glam::{Vec2, Vec3};

use super::{Detail, Dice, LANES, LOT, Materials, PAVEMENT, ROAD, STREET};
use crate::procedural::builder::{ALL_SIDES, Builder, STANDING, UPRIGHT, sin_cos, steps};

/// Width of a pavement beside a lot.
const BESIDE: f32 = 0.5 * (STREET - LANES);

/// The crown of a tree.
pub struct Tree {
    centre: Vec3,
    radius: f32,
}

/// The raised ground of a lot and the pavements round it, with kerb stones.
pub fn pavement(b: &mut Builder, m: &Materials, at: Vec2) {
    b.object("pavement");
    let low = at - BESIDE;
    let high = at + LOT + BESIDE;
    let size = high.x - low.x;
    let grid = steps(size, 2.0);
    let point = |s: f32, t: f32| Vec3::new(low.x + size * t, PAVEMENT, low.y + size * s);
    b.sheet(m.paving, (grid, grid), point, |s, t| Vec2::new(s, t) * (0.5 * size));
    let stones = size as u32;
    let length = size / stones as f32;
    let gap = 0.005;
    for k in 0..stones {
        let a = length * k as f32;
        for (p, q) in [
            (Vec2::new(a, -0.15), Vec2::new(a + length - gap, 0.0)),
            (Vec2::new(a, size), Vec2::new(a + length - gap, size + 0.15)),
            (Vec2::new(-0.15, a), Vec2::new(0.0, a + length - gap)),
            (Vec2::new(size, a), Vec2::new(size + 0.15, a + length - gap)),
        ] {
            let p = low + p;
            let q = low + q;
            b.cuboid(m.kerb, Vec3::new(p.x, ROAD, p.y), Vec3::new(q.x, PAVEMENT + 0.005, q.y), STANDING);
        }
    }
}

/// Dashes in the middle of a street along z (`upright`) or x.
pub fn marks(b: &mut Builder, m: &Materials, middle: f32, length: f32, upright: bool) {
    b.object("marks");
    for k in 0..(length / 6.0) as u32 {
        let a = 6.0 * k as f32 + 2.0;
        let p = Vec2::new(middle - 0.08, a);
        let q = Vec2::new(middle + 0.08, a + 2.5);
        let (p, q) = if upright { (p, q) } else { (Vec2::new(p.y, p.x), Vec2::new(q.y, q.x)) };
        b.cuboid(m.paint, Vec3::new(p.x, ROAD, p.y), Vec3::new(q.x, ROAD + 0.004, q.y), STANDING);
    }
}

/// Builds the ground of a lot between and before its houses; returns the trees.
pub fn lot(b: &mut Builder, m: &Materials, number: u32, at: Vec2, detail: Detail) -> Vec<Tree> {
    let mut dice = Dice::new(number, 2);
    let fine = detail == Detail::High;
    let mut trees = Vec::new();
    // A garden between the houses.
    b.object("garden");
    for (low, high) in [((20.0, 1.0), (24.0, 43.0)), ((1.0, 18.0), (19.4, 26.0)), ((24.6, 18.0), (43.0, 26.0))] {
        let low = at + Vec2::from(low);
        let high = at + Vec2::from(high);
        b.cuboid(m.grass, Vec3::new(low.x, PAVEMENT, low.y), Vec3::new(high.x, PAVEMENT + 0.05, high.y), STANDING);
    }
    for k in 0..9 {
        let place = match k {
            0..3 => Vec2::new(22.0, 8.0 + 14.0 * k as f32),
            3..6 => Vec2::new(4.0 + 5.5 * (k - 3) as f32, 22.0),
            _ => Vec2::new(27.5 + 6.0 * (k - 6) as f32, 22.0),
        } + Vec2::new(dice.between(-0.6, 0.6), dice.between(-0.6, 0.6));
        trees.push(tree(b, m, &mut dice, at + place, detail));
    }
    // Along the two streets before the lot.
    for k in 0..4 {
        let along = 5.5 + 11.0 * k as f32;
        for side in [Vec2::new(along, -1.9), Vec2::new(-1.9, along)] {
            let foot = at + side;
            if k % 2 == 0 {
                lamp_post(b, m, foot, if side.y < 0.0 { Vec2::NEG_Y } else { Vec2::NEG_X }, fine);
            } else {
                trees.push(tree(b, m, &mut dice, foot, detail));
            }
        }
    }
    for k in 0..5 {
        let along = 2.5 + 8.0 * k as f32 + dice.between(-0.5, 0.5);
        let paint = m.car[dice.pick(4)];
        if dice.throw() < 0.75 {
            car(b, m, Vec3::new(at.x + along, ROAD, at.y - BESIDE - 1.25), Vec3::X, paint, fine);
        }
        if dice.throw() < 0.75 {
            car(b, m, Vec3::new(at.x - BESIDE - 1.25, ROAD, at.y + along), Vec3::Z, paint, fine);
        }
    }
    for k in 0..3 {
        let along = 9.0 + 12.0 * k as f32;
        bench(b, m, at + Vec2::new(along, -1.2), true);
        bench(b, m, at + Vec2::new(-1.2, along), false);
        if fine {
            for n in 0..3 {
                bicycle(b, m, at + Vec2::new(along + 3.0 + 0.7 * n as f32, -1.9));
            }
        }
    }
    trees
}

fn tree(b: &mut Builder, m: &Materials, dice: &mut Dice, at: Vec2, detail: Detail) -> Tree {
    b.object("tree");
    let foot = Vec3::new(at.x, PAVEMENT, at.y);
    let height = dice.between(2.6, 3.6);
    let fine = detail == Detail::High;
    b.tube(m.bark, foot, height + 0.6, 0.13, (if fine { 20 } else { 6 }, if fine { 8 } else { 2 }));
    let radius = dice.between(1.3, 1.9);
    let centre = foot + Vec3::Y * (height + radius);
    for _ in 0..if fine { 26 } else { 5 } {
        let end = centre + radius * 0.9 * on_sphere(dice);
        let start = foot + Vec3::Y * (height + 0.5 * dice.throw());
        let across = (end - start).any_orthonormal_vector();
        let thick = 0.02;
        let up = (end - start).normalize().cross(across) * thick;
        let across = across * thick;
        for (p, q) in [(across, up), (up, -across), (-across, -up), (-up, across)] {
            b.plain_quad(m.bark, [start + p, start + q, end + 0.2 * q, end + 0.2 * p]);
        }
    }
    Tree { centre, radius }
}

fn on_sphere(dice: &mut Dice) -> Vec3 {
    let y = dice.between(-1.0, 1.0);
    let (sin, cos) = sin_cos(dice.throw());
    let across = (1.0 - y * y).max(0.0).sqrt();
    Vec3::new(across * cos, y, across * sin)
}

/// So many leaves, a quadrilateral each, shared out over the trees.
pub fn leaves(b: &mut Builder, m: &Materials, trees: &[Tree], count: usize) {
    b.object("leaves");
    let each = count / trees.len().max(1);
    for (k, tree) in trees.iter().enumerate() {
        let mut dice = Dice::new(k as u32, 3);
        let more = usize::from(k < count - each * trees.len());
        for leaf in 0..each + more {
            // Denser towards the outside.
            let out = on_sphere(&mut dice);
            let place = tree.centre + out * tree.radius * dice.throw().sqrt();
            let along = on_sphere(&mut dice) * dice.between(0.03, 0.07);
            let across = along.any_orthonormal_vector() * dice.between(0.012, 0.03);
            let leaf = m.leaf[(leaf * 7 + k) % 3];
            b.plain_quad(leaf, [place, place + 0.5 * along + across, place + along, place + 0.5 * along - across]);
        }
    }
}

fn lamp_post(b: &mut Builder, m: &Materials, at: Vec2, over: Vec2, fine: bool) {
    b.object("lamp post");
    let foot = Vec3::new(at.x, PAVEMENT, at.y);
    let sides = if fine { 24 } else { 6 };
    b.tube(m.metal, foot, 4.6, 0.05, (sides, if fine { 12 } else { 2 }));
    let arm = Vec3::new(over.x, 0.0, over.y);
    let a = foot + Vec3::Y * 4.5 - arm * 0.03;
    let c = foot + Vec3::Y * 4.56 + arm * 0.8;
    let beside = arm.cross(Vec3::Y) * 0.03;
    b.cuboid(m.metal, (a - beside).min(c + beside), (a - beside).max(c + beside), ALL_SIDES);
    let side = arm.cross(Vec3::Y) * 0.16;
    let p = foot + Vec3::Y * 4.42 + arm * 0.35 - side;
    let q = foot + Vec3::Y * 4.5 + arm * 1.0 + side;
    let low = p.min(q);
    let high = p.max(q);
    b.cuboid(m.metal, low, high, STANDING);
    b.cuboid_side(m.street_lamp, low, high, 2);
}

/// A car: body, cabin, wheels with their rims and bolts.
fn car(b: &mut Builder, m: &Materials, foot: Vec3, along: Vec3, paint: u32, fine: bool) {
    b.object("car");
    let across = along.cross(Vec3::Y);
    let at = |x: f32, y: f32, z: f32| foot + along * x + Vec3::Y * y + across * z;
    let slab = |b: &mut Builder, material: u32, low: [f32; 3], high: [f32; 3]| {
        let p = at(low[0], low[1], low[2]);
        let q = at(high[0], high[1], high[2]);
        b.cuboid(material, p.min(q), p.max(q), ALL_SIDES);
    };
    // The outline from bumper to bumper, swept across.
    let outline =
        [(0.0, 0.35), (0.05, 0.72), (1.0, 0.86), (1.55, 1.36), (2.9, 1.4), (3.5, 0.95), (4.05, 0.88), (4.1, 0.4)];
    let cut = if fine { 12 } else { 1 };
    let half = 0.84;
    for pair in outline.windows(2) {
        let point = |s: f32, t: f32| {
            let bulge = 0.04 * sin_cos(0.5 * s).0;
            let x = pair[0].0 + (pair[1].0 - pair[0].0) * t;
            let y = pair[0].1 + (pair[1].1 - pair[0].1) * t;
            at(x, y + bulge, half * (2.0 * s - 1.0))
        };
        b.sheet(paint, (cut, if fine { 6 } else { 1 }), point, Vec2::new);
    }
    for side in [-half, half] {
        for pair in outline.windows(2) {
            let ends = [(pair[0], 0.35), (pair[1], 0.35)];
            let [lower, upper] = ends.map(|(p, floor)| (at(p.0, floor, side), at(p.0, p.1, side)));
            let corners = [lower.0, upper.0, upper.1, lower.1];
            let degenerate = pair[0].1 <= 0.36;
            let corners = if side > 0.0 { corners } else { [corners[3], corners[2], corners[1], corners[0]] };
            if !degenerate {
                b.plain_quad(paint, corners);
            }
        }
    }
    slab(b, m.dark, [0.1, 0.3, -0.8], [4.0, 0.35, 0.8]);
    for x in [0.75, 3.25] {
        for z in [-0.86, 0.68] {
            wheel(b, m, at(x, 0.31, z), along, across * 0.18, 0.31, if fine { 36 } else { 8 });
            if fine {
                for k in 0..5 {
                    let (sin, cos) = sin_cos(0.2 * k as f32);
                    let hub = at(x + 0.12 * cos, 0.31 + 0.12 * sin, if z < 0.0 { z - 0.004 } else { z + 0.184 });
                    let bolt = Vec3::splat(0.008);
                    b.cuboid(m.metal, hub - bolt, hub + bolt, ALL_SIDES);
                }
            }
        }
    }
}

/// A disc with a tread, its axle along `axle`.
fn wheel(b: &mut Builder, m: &Materials, hub: Vec3, along: Vec3, axle: Vec3, radius: f32, sides: u32) {
    let rim = |s: f32| {
        let (sin, cos) = sin_cos(s);
        (along * cos + Vec3::Y * sin) * radius
    };
    b.sheet(m.dark, (sides, 2), |s, t| hub + rim(s) + axle * t, Vec2::new);
    for end in [Vec3::ZERO, axle] {
        for k in 0..sides {
            let s = k as f32 / sides as f32;
            let t = (k + 1) as f32 / sides as f32;
            let p = hub + end + rim(s);
            let q = hub + end + rim(t);
            let corners = if end == Vec3::ZERO { [hub + end, q, p] } else { [hub + end, p, q] };
            b.triangle(m.metal, corners, [Vec2::ZERO; 3]);
        }
    }
}

fn bench(b: &mut Builder, m: &Materials, at: Vec2, along_x: bool) {
    b.object("bench");
    let place = |a: [f32; 3]| {
        let (u, v) = if along_x { (a[0], a[2]) } else { (a[2], a[0]) };
        Vec3::new(at.x + u, PAVEMENT + a[1], at.y + v)
    };
    let mut slab = |material: u32, low: [f32; 3], high: [f32; 3], sides: [bool; 6]| {
        let p = place(low);
        let q = place(high);
        b.cuboid(material, p.min(q), p.max(q), sides);
    };
    for k in 0..5 {
        let v = 0.09 * k as f32;
        slab(m.wood, [0.0, 0.43, v], [1.6, 0.46, v + 0.07], ALL_SIDES);
    }
    for k in 0..3 {
        let y = 0.55 + 0.11 * k as f32;
        slab(m.wood, [0.0, y, 0.44], [1.6, y + 0.08, 0.47], ALL_SIDES);
    }
    for u in [0.15, 1.4] {
        slab(m.metal, [u, 0.0, 0.05], [u + 0.05, 0.432, 0.4], STANDING);
        slab(m.metal, [u, 0.44, 0.46], [u + 0.05, 0.85, 0.48], UPRIGHT);
    }
}

/// Two wheels of 32 spokes, 4 mm thick, and a frame.
fn bicycle(b: &mut Builder, m: &Materials, at: Vec2) {
    b.object("bicycle");
    let foot = Vec3::new(at.x, PAVEMENT, at.y);
    let radius = 0.34;
    let thin = 0.004;
    let mut bar = |p: Vec3, q: Vec3, thick: f32| {
        let across = (q - p).any_orthonormal_vector() * thick;
        let up = (q - p).normalize().cross(across);
        for (s, t) in [(across, up), (up, -across), (-across, -up), (-up, across)] {
            b.plain_quad(m.metal, [p + 0.5 * s, p + 0.5 * t, q + 0.5 * t, q + 0.5 * s]);
        }
    };
    let hubs = [foot + Vec3::new(0.0, radius, 0.0), foot + Vec3::new(0.0, radius, -1.05)];
    for hub in hubs {
        let rim = |k: f32| {
            let (sin, cos) = sin_cos(k / 32.0);
            hub + Vec3::new(0.0, radius * sin, radius * cos)
        };
        for k in 0..32 {
            bar(hub, rim(k as f32), thin);
            bar(rim(k as f32), rim(k as f32 + 1.0), 0.03);
        }
    }
    let seat = Vec3::new(0.0, 0.8, -0.85);
    let pedals = Vec3::new(0.0, 0.3, -0.6);
    let head = Vec3::new(0.0, 0.85, -0.2);
    for (p, q) in [(seat, pedals), (pedals, head), (seat, head)] {
        bar(foot + p, foot + q, 0.03);
    }
    for (p, q) in [(hubs[1], foot + pedals), (hubs[1], foot + seat), (hubs[0], foot + head)] {
        bar(p, q, 0.02);
    }
    bar(foot + head + Vec3::new(-0.25, 0.1, 0.0), foot + head + Vec3::new(0.25, 0.1, 0.0), 0.025);
}
