//! Furniture of rooms and corridors.

use glam::{Vec2, Vec3};

use super::house::{CORRIDOR, HALF, STOREY};
use super::{Detail, Dice, Materials};
use crate::procedural::builder::{ALL_SIDES, Builder, STANDING, UPRIGHT, sin_cos};

/// Parts go so far into each other.
const OVERLAP: f32 = 0.004;

/// A room as its window sees it: u along the wall, y up from the floor, v into the room.
pub struct Room {
    /// The corner of the floor with the least u and v.
    pub corner: Vec3,
    /// Direction of v along z: 1 or −1.
    pub inwards: f32,
    /// Extent along u and v, m.
    pub size: (f32, f32),
}

impl Room {
    pub fn at(&self, [u, y, v]: [f32; 3]) -> Vec3 {
        self.corner + Vec3::new(u, y, self.inwards * v)
    }

    pub fn cuboid(&self, b: &mut Builder, material: u32, low: [f32; 3], high: [f32; 3], sides: [bool; 6]) {
        let p = self.at(low);
        let q = self.at(high);
        b.cuboid(material, p.min(q), p.max(q), sides);
    }

    /// A box that stands from `low` to `high` above (u, v), with its extent along both.
    fn block(&self, b: &mut Builder, material: u32, (u, v): (f32, f32), (du, dv): (f32, f32), y: (f32, f32)) {
        let sides = if y.0 <= 0.0 { STANDING } else { ALL_SIDES };
        self.cuboid(b, material, [u, y.0, v], [u + du, y.1, v + dv], sides);
    }

    /// Four legs below a board of this extent.
    fn legs(&self, b: &mut Builder, material: u32, (u, v): (f32, f32), (du, dv): (f32, f32), top: f32, thick: f32) {
        for (a, c) in
            [(0.02, 0.02), (du - thick - 0.02, 0.02), (0.02, dv - thick - 0.02), (du - thick - 0.02, dv - thick - 0.02)]
        {
            self.cuboid(b, material, [u + a, 0.0, v + c], [u + a + thick, top + OVERLAP, v + c + thick], UPRIGHT);
        }
    }
}

/// A surface of revolution with its front outside: radius and height of its outline, from the foot up.
pub fn turned(b: &mut Builder, material: u32, foot: Vec3, outline: &[(f32, f32)], sides: u32) {
    for pair in outline.windows(2) {
        let at = |s: f32, t: f32| {
            let (sin, cos) = sin_cos(-s);
            let radius = pair[0].0 + (pair[1].0 - pair[0].0) * t;
            let y = pair[0].1 + (pair[1].1 - pair[0].1) * t;
            foot + Vec3::new(radius * cos, y, radius * sin)
        };
        // Where the outline meets the axis, quadrilaterals would be triangles and a point.
        let from = pair[0].0 == 0.0;
        let to = pair[1].0 == 0.0;
        if !from && !to {
            b.sheet(material, (sides, 1), at, Vec2::new);
            continue;
        }
        for k in 0..sides {
            let s = k as f32 / sides as f32;
            let t = (k + 1) as f32 / sides as f32;
            let corners =
                if from { [at(s, 0.0), at(t, 1.0), at(s, 1.0)] } else { [at(s, 0.0), at(t, 0.0), at(s, 1.0)] };
            b.triangle(material, corners, [Vec2::ZERO, Vec2::X, Vec2::Y]);
        }
    }
}

/// Furnishes a room, and hangs its lamp.
pub fn furnish(b: &mut Builder, m: &Materials, dice: &mut Dice, r: &Room, detail: Detail) {
    lamp(b, m, r.at([0.5 * r.size.0, 0.0, 0.5 * r.size.1]));
    if detail == Detail::High {
        for u in [1.05, 3.55] {
            radiator(b, m, r, u);
        }
        curtains(b, m, dice, r);
    }
    let kind = dice.pick(4);
    b.object(["living room", "bedroom", "kitchen", "office"][kind]);
    let cloth = m.fabric[dice.pick(m.fabric.len())];
    match kind {
        0 => living_room(b, m, dice, r, cloth, detail),
        1 => bedroom(b, m, dice, r, cloth, detail),
        2 => kitchen(b, m, dice, r, detail),
        _ => office(b, m, dice, r, cloth, detail),
    }
}

/// The corridor of a storey: lamps, and a rail along the walls.
pub fn corridor(b: &mut Builder, m: &Materials, corner: Vec3, length: f32) {
    b.object("corridor");
    for k in 0..3 {
        lamp(b, m, corner + Vec3::new(length / 6.0 * (2 * k + 1) as f32, HALF, CORRIDOR));
    }
}

/// A panel below the ceiling, 0.6 m × 0.6 m, whose underside shines.
fn lamp(b: &mut Builder, m: &Materials, floor: Vec3) {
    b.object("ceiling lamp");
    let ceiling = floor.y + STOREY - 2.0 * HALF;
    let low = Vec3::new(floor.x - 0.3, ceiling - 0.06, floor.z - 0.3);
    let high = Vec3::new(floor.x + 0.3, ceiling, floor.z + 0.3);
    b.cuboid(m.metal, low, high, UPRIGHT);
    b.cuboid_side(m.lamp, low, high, 2);
}

fn radiator(b: &mut Builder, m: &Materials, r: &Room, u: f32) {
    b.object("radiator");
    for k in 0..22 {
        let u = u + 0.055 * k as f32;
        r.cuboid(b, m.white, [u, 0.12, 0.04], [u + 0.035, 0.7, 0.12], ALL_SIDES);
    }
    for y in [0.18, 0.62] {
        r.cuboid(b, m.white, [u - 0.02, y, 0.06], [u + 1.22, y + 0.03, 0.1], ALL_SIDES);
    }
}

/// Wavy cloth beside the windows.
fn curtains(b: &mut Builder, m: &Materials, dice: &mut Dice, r: &Room) {
    b.object("curtain");
    let cloth = m.fabric[dice.pick(m.fabric.len())];
    for (u, width) in [(0.62, 0.4), (2.38, 0.4), (3.12, 0.4), (4.88, 0.4)] {
        let folds = dice.between(4.0, 7.0);
        let at = |s: f32, t: f32| {
            let wave = 0.025 * sin_cos(folds * s).0 * (1.3 - 0.3 * t);
            r.at([u + width * s, 0.15 + 2.3 * t, 0.17 + wave])
        };
        b.sheet(cloth, (40, 6), at, Vec2::new);
    }
    r.cuboid(b, m.metal, [0.5, 2.46, 0.16], [5.3, 2.48, 0.18], ALL_SIDES);
}

/// A case of books against the far wall, as high as `rows` shelves.
fn books(b: &mut Builder, m: &Materials, dice: &mut Dice, r: &Room, (u, width): (f32, f32), rows: u32, detail: Detail) {
    b.object("book case");
    let depth = 0.3;
    let height = 0.34 * rows as f32 + 0.06;
    let v = r.size.1 - depth - 0.01;
    for side in [u, u + width - 0.02] {
        r.cuboid(b, m.dark_wood, [side, 0.0, v], [side + 0.02, height, v + depth], STANDING);
    }
    r.cuboid(b, m.dark_wood, [u + 0.02, 0.02, v + depth - 0.01], [u + width - 0.02, height, v + depth], ALL_SIDES);
    for row in 0..=rows {
        let y = 0.02 + 0.34 * row as f32;
        r.cuboid(b, m.dark_wood, [u + 0.02, y, v], [u + width - 0.02, y + 0.02, v + depth - 0.01], ALL_SIDES);
        if row == rows || detail == Detail::Low {
            continue;
        }
        let mut at = u + 0.03;
        while at < u + width - 0.09 {
            let thick = dice.between(0.012, 0.045);
            let high = dice.between(0.2, 0.3);
            let deep = dice.between(0.15, 0.24);
            let cover = match dice.pick(7) {
                k @ 0..=4 => m.fabric[k],
                5 => m.dark,
                _ => m.white,
            };
            r.cuboid(b, cover, [at, y + 0.021, v + 0.27 - deep], [at + thick, y + 0.02 + high, v + 0.27], STANDING);
            at += thick + 0.001 + if dice.throw() < 0.06 { 0.08 } else { 0.0 };
        }
    }
}

fn chair(b: &mut Builder, m: &Materials, r: &Room, (u, v): (f32, f32), back: f32) {
    r.legs(b, m.wood, (u, v), (0.44, 0.44), 0.44, 0.04);
    r.block(b, m.wood, (u, v), (0.44, 0.44), (0.44, 0.47));
    // The back stands on the side that `back` says: 0 near the window, 1 away from it.
    let at = v + back * 0.4;
    for k in 0..5 {
        let u = u + 0.02 + 0.095 * k as f32;
        r.cuboid(b, m.wood, [u, 0.47 - OVERLAP, at], [u + 0.025, 0.92, at + 0.03], UPRIGHT);
    }
    r.cuboid(b, m.wood, [u, 0.9, at - 0.005], [u + 0.44, 0.98, at + 0.035], ALL_SIDES);
}

fn cup(b: &mut Builder, m: &Materials, foot: Vec3, radius: f32, sides: u32) {
    let outline = [
        (0.0, 0.001),
        (0.8 * radius, 0.001),
        (radius, 0.9 * radius),
        (radius, 2.2 * radius),
        (0.92 * radius, 2.2 * radius),
        (0.9 * radius, 0.2 * radius),
        (0.0, 0.2 * radius),
    ];
    turned(b, m.ceramic, foot, &outline, sides);
}

fn plant(b: &mut Builder, m: &Materials, dice: &mut Dice, foot: Vec3, leaves: u32) {
    let pot = [(0.0, 0.005), (0.13, 0.005), (0.18, 0.3), (0.16, 0.3), (0.15, 0.27), (0.0, 0.27)];
    turned(b, m.ceramic, foot, &pot, 24);
    for k in 0..leaves {
        let around = dice.throw();
        let high = dice.between(0.3, 1.3);
        let (sin, cos) = sin_cos(around);
        let out = Vec3::new(cos, 0.0, sin);
        let stem = foot + Vec3::Y * (0.27 + 0.5 * high) + out * dice.between(0.02, 0.12);
        let tip = stem + out * dice.between(0.12, 0.3) + Vec3::Y * dice.between(-0.05, 0.25);
        let side = out.cross(Vec3::Y) * 0.03;
        let middle = 0.5 * (stem + tip) + Vec3::Y * 0.03;
        b.plain_quad(m.leaf[k as usize % 2], [stem, middle + side, tip, middle - side]);
    }
}

fn picture(b: &mut Builder, m: &Materials, dice: &mut Dice, r: &Room, cloth: u32) {
    let v = dice.between(1.0, 4.0);
    let high = dice.between(0.4, 0.8);
    r.cuboid(b, m.dark_wood, [0.0, 1.3, v], [0.03, 1.3 + high, v + 0.9], ALL_SIDES);
    r.cuboid(b, cloth, [0.029, 1.33, v + 0.03], [0.033, 1.27 + high, v + 0.87], ALL_SIDES);
}

fn living_room(b: &mut Builder, m: &Materials, dice: &mut Dice, r: &Room, cloth: u32, detail: Detail) {
    let fine = detail == Detail::High;
    // A rug, a sofa along the wall at u = 0, a low table, book cases on the far wall.
    r.cuboid(b, m.fabric[dice.pick(5)], [1.2, 0.0, 1.6], [3.9, 0.012, 4.6], STANDING);
    r.block(b, cloth, (0.08, 1.9), (0.9, 2.3), (0.12, 0.42));
    r.block(b, cloth, (0.08, 1.9), (0.22, 2.3), (0.42 - OVERLAP, 0.85));
    for v in [1.72, 4.18] {
        r.block(b, cloth, (0.08, v), (0.9, 0.2), (0.1, 0.62));
    }
    r.legs(b, m.wood, (1.9, 2.4), (0.7, 1.2), 0.38, 0.05);
    r.block(b, m.wood, (1.9, 2.4), (0.7, 1.2), (0.38, 0.42));
    books(b, m, dice, r, (3.7, 1.9), 6, detail);
    r.block(b, m.dark_wood, (5.2, 2.0), (0.45, 1.8), (0.0, 0.5));
    r.block(b, m.dark, (5.45, 2.25), (0.05, 1.3), (0.56, 1.32));
    picture(b, m, dice, r, cloth);
    if fine {
        for (u, v) in [(2.1, 2.7), (2.35, 3.2)] {
            cup(b, m, r.at([u, 0.42, v]), 0.04, 32);
        }
        turned(b, m.ceramic, r.at([2.25, 0.42, 2.95]), &vase(), 48);
        plant(b, m, dice, r.at([5.2, 0.0, 0.6]), 140);
        // Fringes of the rug.
        for k in 0..90 {
            let u = 1.21 + 0.03 * k as f32;
            for v in [1.52, 4.6] {
                r.cuboid(b, m.fabric[2], [u, 0.0, v], [u + 0.008, 0.006, v + 0.08], STANDING);
            }
        }
    }
}

/// Outline of a vase.
fn vase() -> Vec<(f32, f32)> {
    (0..=14)
        .map(|k| {
            let t = k as f32 / 14.0;
            (0.035 + 0.05 * sin_cos(0.46 * t).0 * (1.0 - 0.4 * t), 0.002 + 0.28 * t)
        })
        .collect()
}

fn bedroom(b: &mut Builder, m: &Materials, dice: &mut Dice, r: &Room, cloth: u32, detail: Detail) {
    r.block(b, m.wood, (0.1, 2.0), (2.1, 1.7), (0.0, 0.3));
    r.block(b, m.white, (0.15, 2.05), (2.0, 1.6), (0.3 - OVERLAP, 0.48));
    r.block(b, m.wood, (0.04, 1.95), (0.06, 1.8), (0.0, 1.0));
    r.block(b, cloth, (0.8, 2.03), (1.38, 1.64), (0.2, 0.5));
    for v in [2.15, 2.9] {
        r.block(b, m.white, (0.2, v), (0.42, 0.62), (0.48 - OVERLAP, 0.6));
    }
    r.block(b, m.dark_wood, (3.6, 5.9), (1.9, 0.6), (0.0, 2.2));
    for k in 0..4 {
        let u = 3.62 + 0.47 * k as f32;
        r.cuboid(b, m.wood, [u, 0.05, 5.87], [u + 0.45, 2.15, 5.9], ALL_SIDES);
        r.cuboid(b, m.metal, [u + 0.4, 1.0, 5.84], [u + 0.415, 1.2, 5.855], ALL_SIDES);
    }
    r.block(b, m.wood, (0.1, 1.4), (0.45, 0.45), (0.0, 0.5));
    picture(b, m, dice, r, cloth);
    if detail == Detail::High {
        cup(b, m, r.at([0.3, 0.5, 1.6]), 0.035, 32);
        books(b, m, dice, r, (0.2, 1.2), 3, detail);
        plant(b, m, dice, r.at([5.2, 0.0, 0.6]), 100);
        // A quilt of squares.
        for i in 0..9 {
            for j in 0..10 {
                let u = 0.83 + 0.15 * i as f32;
                let v = 2.07 + 0.157 * j as f32;
                r.cuboid(b, m.fabric[dice.pick(5)], [u, 0.5 - OVERLAP, v], [u + 0.14, 0.51, v + 0.147], STANDING);
            }
        }
    }
}

fn kitchen(b: &mut Builder, m: &Materials, dice: &mut Dice, r: &Room, detail: Detail) {
    for k in 0..6 {
        let v = 0.8 + 0.6 * k as f32;
        r.block(b, m.white, (0.02, v), (0.58, 0.59), (0.0, 0.86));
        r.cuboid(b, m.wood, [0.6, 0.1, v + 0.01], [0.615, 0.84, v + 0.57], ALL_SIDES);
        r.cuboid(b, m.metal, [0.615, 0.74, v + 0.15], [0.635, 0.755, v + 0.42], ALL_SIDES);
        r.block(b, m.wood, (0.02, v), (0.34, 0.59), (1.45, 2.1));
    }
    r.block(b, m.dark, (0.01, 0.78), (0.63, 3.64), (0.86, 0.9));
    r.legs(b, m.wood, (2.6, 2.2), (1.0, 1.8), 0.72, 0.06);
    r.block(b, m.wood, (2.6, 2.2), (1.0, 1.8), (0.72, 0.76));
    for (u, back) in [(2.65, 0.0), (3.12, 0.0), (2.65, 1.0), (3.12, 1.0)] {
        chair(b, m, r, (u, if back == 0.0 { 1.55 } else { 4.2 }), back);
    }
    if detail == Detail::High {
        // A tiled wall behind the counter, plates and cups on the table and the shelf.
        for i in 0..24 {
            for j in 0..3 {
                let v = 0.81 + 0.15 * i as f32;
                let y = 0.92 + 0.16 * j as f32;
                r.cuboid(b, m.ceramic, [0.0, y, v], [0.012, y + 0.145, v + 0.14], ALL_SIDES);
            }
        }
        for k in 0..4 {
            let u = 2.85 + 0.5 * (k % 2) as f32;
            let v = 2.5 + 0.6 * (k / 2) as f32;
            let plate = [(0.0, 0.002), (0.06, 0.002), (0.12, 0.02), (0.118, 0.022), (0.06, 0.006), (0.0, 0.006)];
            turned(b, m.ceramic, r.at([u, 0.76, v]), &plate, 40);
            cup(b, m, r.at([u + 0.15, 0.76, v + 0.1]), 0.035, 28);
        }
        for k in 0..9 {
            cup(b, m, r.at([0.2 + 0.03 * (k % 3) as f32, 0.9, 1.0 + 0.36 * k as f32]), dice.between(0.03, 0.06), 24);
        }
        books(b, m, dice, r, (4.3, 1.2), 2, detail);
    }
}

fn office(b: &mut Builder, m: &Materials, dice: &mut Dice, r: &Room, cloth: u32, detail: Detail) {
    for u in [0.3, 3.4] {
        r.legs(b, m.metal, (u, 1.6), (1.7, 0.8), 0.71, 0.04);
        r.block(b, m.wood, (u, 1.6), (1.7, 0.8), (0.71, 0.74));
        r.block(b, m.dark, (u + 0.55, 1.75), (0.6, 0.03), (0.88, 1.24));
        r.block(b, m.metal, (u + 0.82, 1.77), (0.06, 0.03), (0.74 - OVERLAP, 0.9));
        chair(b, m, r, (u + 0.6, 2.55), 1.0);
        r.block(b, m.white, (u + 1.2, 1.65), (0.4, 0.6), (0.0, 0.55));
        if detail == Detail::High {
            // Keys, paper, pencils.
            for i in 0..15 {
                for j in 0..5 {
                    let a = u + 0.5 + 0.03 * i as f32;
                    let c = 2.05 + 0.03 * j as f32;
                    r.cuboid(b, m.dark, [a, 0.745, c], [a + 0.025, 0.757, c + 0.025], STANDING);
                }
            }
            for k in 0..12 {
                let slip = 0.004 * dice.throw();
                let y = 0.741 + 0.004 * k as f32;
                r.cuboid(b, m.white, [u + 1.2 + slip, y, 1.9], [u + 1.41 + slip, y + 0.003, 2.19], ALL_SIDES);
            }
            cup(b, m, r.at([u + 0.3, 0.74, 1.8]), 0.04, 32);
            for k in 0..6 {
                let a = u + 0.28 + 0.01 * k as f32;
                r.cuboid(b, m.wood, [a, 0.76, 1.79], [a + 0.006, 0.9 + 0.01 * k as f32, 1.796], ALL_SIDES);
            }
        }
    }
    books(b, m, dice, r, (3.7, 1.9), 6, detail);
    books(b, m, dice, r, (0.1, 1.7), 6, detail);
    picture(b, m, dice, r, cloth);
    if detail == Detail::High {
        plant(b, m, dice, r.at([5.2, 0.0, 4.0]), 120);
    }
}
