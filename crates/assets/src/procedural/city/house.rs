//! Houses: six rooms and a corridor a storey, with windows, doors, blinds, shutters, and what stands in the rooms.

use glam::Vec3;

use super::furniture::{Room, corridor, furnish};
use super::{Detail, Dice, Materials, ROAD};
use crate::procedural::builder::{ALL_SIDES, Blocks, Builder, UPRIGHT};

/// Walls between rooms, along x; the corridor lies between two walls along z.
pub const ROOM: f32 = 6.0;
pub const LENGTH: f32 = 18.0;
pub const DEPTH: f32 = 16.0;
/// Middle of the corridor, z.
pub const CORRIDOR: f32 = 8.0;
const CORRIDOR_WALLS: [f32; 2] = [7.0, 9.0];
pub const STOREY: f32 = 3.0;
/// Half of the thickness of walls and floors.
pub const HALF: f32 = 0.15;
/// Sill and lintel above the storey's plane.
pub const SILL: f32 = 0.95;
pub const LINTEL: f32 = 2.25;
/// Windows and the door of a room, from its wall on.
const WINDOWS: [(f32, f32); 2] = [(1.2, 2.5), (3.7, 5.0)];
pub const DOOR: (f32, f32) = (2.65, 3.55);
/// Doors at the ends of the corridor.
const ENTRANCE: (f32, f32) = (7.3, 8.7);

/// A house.
pub struct House {
    /// Middle of the walls' corner with the least x and z.
    pub corner: Vec3,
    /// Its storeys.
    pub storeys: u32,
    /// Its outer walls' material.
    pub facade: u32,
    /// Its number.
    pub number: u32,
    /// Level of detail.
    pub detail: Detail,
}

/// Use of a stretch between two grid planes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stretch {
    Outer,
    Inner,
    Free,
    Room,
    Window,
    Door,
    Slab,
    Low,
    Middle,
    High,
    Parapet,
}

/// Grid planes and what lies between them.
fn stretches(parts: &[(f32, Stretch)], end: f32, origin: f32) -> (Vec<f32>, Vec<Stretch>) {
    let lines = parts.iter().map(|p| p.0).chain([end]).map(|x| origin + x).collect();
    (lines, parts.iter().map(|p| p.1).collect())
}

impl House {
    pub fn build(&self, b: &mut Builder, m: &Materials) {
        b.object("house");
        let (x_lines, xs) = self.along_x();
        let (z_lines, zs) = self.along_z();
        let (y_lines, ys) = self.along_y();
        let rooms = |x: i32| {
            let at = 0.5 * (x_lines[x as usize] + x_lines[x as usize + 1]) - self.corner.x;
            (at / ROOM) as u32
        };
        let inside = |c: [i32; 3]| {
            (0..xs.len() as i32).contains(&c[0])
                && (0..ys.len() as i32).contains(&c[1])
                && (0..zs.len() as i32).contains(&c[2])
        };
        let solid = |c: [i32; 3]| {
            if c[1] < 0 {
                return true;
            }
            if !inside(c) {
                return false;
            }
            let x = xs[c[0] as usize];
            let y = ys[c[1] as usize];
            let z = zs[c[2] as usize];
            let first_storey = c[1] < 4;
            let corridor = z == Stretch::Free || z == Stretch::Door;
            match y {
                Stretch::Slab => true,
                Stretch::Parapet => x == Stretch::Outer || z == Stretch::Outer,
                _ if x == Stretch::Outer => {
                    let open = y == Stretch::Middle || (first_storey && y == Stretch::Low);
                    !(z == Stretch::Door && open)
                }
                _ if z == Stretch::Outer => !(x == Stretch::Window && y == Stretch::Middle),
                _ if z == Stretch::Inner => !(x == Stretch::Door && y != Stretch::High),
                _ => x == Stretch::Inner && !corridor,
            }
        };
        let roof = ys.len() as i32 - 1;
        let material = |axis: usize, positive: bool, air: [i32; 3]| {
            if !inside(air) || xs[air[0] as usize] == Stretch::Outer || zs[air[2] as usize] == Stretch::Outer {
                return if axis == 1 && positive && air[1] > roof { m.roof } else { self.facade };
            }
            if air[1] == roof {
                return if axis == 1 { m.roof } else { self.facade };
            }
            let z = zs[air[2] as usize];
            let in_corridor = z == Stretch::Free || z == Stretch::Door;
            let far = air[2] as usize > zs.len() / 2;
            let dice = &mut self.room_dice(air[1] as u32 / 4, rooms(air[0]), far);
            let wall = m.wall[dice.pick(m.wall.len())];
            let floor = m.floor[dice.pick(2)];
            match (axis, positive) {
                (1, true) if in_corridor => m.floor[2],
                (1, true) => floor,
                (1, false) => m.white,
                _ if in_corridor => m.wall[4],
                _ => wall,
            }
        };
        b.blocks(&Blocks { lines: [&x_lines, &y_lines, &z_lines], solid: &solid, material: &material, edge: 3.0 });
        for storey in 0..self.storeys {
            let y = storey as f32 * STOREY;
            for room in 0..3 {
                for far in [false, true] {
                    self.room(b, m, storey, y, room, far);
                }
            }
            corridor(b, m, self.corner + Vec3::Y * y, LENGTH);
        }
    }

    fn along_x(&self) -> (Vec<f32>, Vec<Stretch>) {
        let mut parts = Vec::new();
        for room in 0..3u8 {
            let x = ROOM * f32::from(room);
            parts.extend([
                (x - HALF, if room == 0 { Stretch::Outer } else { Stretch::Inner }),
                (x + HALF, Stretch::Free),
                (x + WINDOWS[0].0, Stretch::Window),
                (x + WINDOWS[0].1, Stretch::Free),
                (x + DOOR.0, Stretch::Door),
                (x + DOOR.1, Stretch::Free),
                (x + WINDOWS[1].0, Stretch::Window),
                (x + WINDOWS[1].1, Stretch::Free),
            ]);
        }
        parts.push((LENGTH - HALF, Stretch::Outer));
        stretches(&parts, LENGTH + HALF, self.corner.x)
    }

    fn along_z(&self) -> (Vec<f32>, Vec<Stretch>) {
        let [a, c] = CORRIDOR_WALLS;
        let parts = [
            (-HALF, Stretch::Outer),
            (HALF, Stretch::Room),
            (a - HALF, Stretch::Inner),
            (a + HALF, Stretch::Free),
            (ENTRANCE.0, Stretch::Door),
            (ENTRANCE.1, Stretch::Free),
            (c - HALF, Stretch::Inner),
            (c + HALF, Stretch::Room),
            (DEPTH - HALF, Stretch::Outer),
        ];
        stretches(&parts, DEPTH + HALF, self.corner.z)
    }

    fn along_y(&self) -> (Vec<f32>, Vec<Stretch>) {
        let mut parts = Vec::new();
        for storey in 0..self.storeys {
            let y = storey as f32 * STOREY;
            parts.extend([
                (if storey == 0 { ROAD } else { y - HALF }, Stretch::Slab),
                (y + HALF, Stretch::Low),
                (y + SILL, Stretch::Middle),
                (y + LINTEL, Stretch::High),
            ]);
        }
        let top = self.storeys as f32 * STOREY;
        parts.extend([(top - HALF, Stretch::Slab), (top + HALF, Stretch::Parapet)]);
        stretches(&parts, top + 0.95, 0.0)
    }

    fn room_dice(&self, storey: u32, room: u32, far: bool) -> Dice {
        Dice::new(self.number, 100 + 6 * storey + 2 * room + u32::from(far))
    }

    fn room(&self, b: &mut Builder, m: &Materials, storey: u32, y: f32, room: u32, far: bool) {
        let mut dice = self.room_dice(storey, room, far);
        // The walls' and the floor's materials are the first throws.
        let _ = (dice.pick(m.wall.len()), dice.pick(2));
        // Seen from the window: u along the wall, v into the room.
        let depth = CORRIDOR_WALLS[0] - 2.0 * HALF;
        let corner =
            self.corner + Vec3::new(ROOM * room as f32 + HALF, y + HALF, if far { DEPTH - HALF } else { HALF });
        let r = Room { corner, inwards: if far { -1.0 } else { 1.0 }, size: (ROOM - 2.0 * HALF, depth) };
        for window in WINDOWS {
            self.window(b, m, &mut dice, &r, (window.0 - HALF, window.1 - HALF), storey);
        }
        self.door(b, m, &mut dice, &r);
        furnish(b, m, &mut dice, &r, self.detail);
    }

    /// Frame, sill, blind and shutters of a window from u0 to u1.
    fn window(&self, b: &mut Builder, m: &Materials, dice: &mut Dice, r: &Room, (u0, u1): (f32, f32), storey: u32) {
        b.object("window");
        let low = SILL - HALF;
        let high = LINTEL - HALF;
        // The wall goes from v = −0.3 to 0; the frame stands in its middle.
        let bar = 0.05;
        let frame = |b: &mut Builder, a: [f32; 2], c: [f32; 2]| {
            r.cuboid(b, m.white, [a[0], a[1], -0.17], [c[0], c[1], -0.13], ALL_SIDES);
        };
        frame(b, [u0, low], [u1, low + bar]);
        frame(b, [u0, high - bar], [u1, high]);
        for u in [u0, 0.5 * (u0 + u1 - bar), u1 - bar] {
            frame(b, [u, low + bar], [u + bar, high - bar]);
        }
        r.cuboid(b, m.kerb, [u0 - 0.06, low - 0.05, -0.42], [u1 + 0.06, low, -0.3], ALL_SIDES);
        r.cuboid(b, m.white, [u0 - 0.05, low - 0.03, 0.0], [u1 + 0.05, low, 0.1], ALL_SIDES);
        if self.detail == Detail::Low {
            return;
        }
        // A blind, more or less far down, inside of the frame.
        if dice.throw() < 0.6 {
            let slats = (dice.between(0.15, 0.8) * (high - low) / 0.035) as u32;
            let turned = dice.between(0.002, 0.014);
            for k in 0..slats {
                let y = high - 0.02 - 0.035 * k as f32;
                r.cuboid(b, m.white, [u0 + 0.01, y - turned, -0.09], [u1 - 0.01, y, -0.06], ALL_SIDES);
            }
            for u in [u0 + 0.2, u1 - 0.2] {
                let y = high - 0.035 * slats as f32;
                let thin = 0.002;
                r.cuboid(b, m.white, [u, y, -0.059], [u + thin, high, -0.059 + thin], UPRIGHT);
            }
        }
        // Shutters with louvres, folded back against the wall outside.
        if storey > 0 {
            let width = 0.5 * (u1 - u0);
            for (a, c) in [(u0 - width, u0 - 0.02), (u1 + 0.02, u1 + width)] {
                for u in [a, c - 0.05] {
                    r.cuboid(b, m.dark_wood, [u, low, -0.34], [u + 0.05, high, -0.305], ALL_SIDES);
                }
                let louvres = ((high - low) / 0.05) as u32;
                for k in 0..louvres {
                    let y = low + 0.05 * k as f32;
                    r.cuboid(b, m.dark_wood, [a + 0.05, y, -0.335], [c - 0.05, y + 0.03, -0.31], ALL_SIDES);
                }
            }
        }
    }

    /// An open door with its handles, on the corridor's side of the room.
    fn door(&self, b: &mut Builder, m: &Materials, dice: &mut Dice, r: &Room) {
        b.object("door");
        let u = DOOR.0 - HALF;
        let v = r.size.1;
        let width = DOOR.1 - DOOR.0 - 0.04;
        if dice.throw() < 0.75 {
            // Opened into the room, at right angles to its wall.
            r.cuboid(b, m.wood, [u + 0.01, 0.01, v - width], [u + 0.05, 2.08, v - 0.01], ALL_SIDES);
            for side in [u - 0.03, u + 0.06] {
                let at = [side, 1.0, v - width + 0.05];
                r.cuboid(b, m.metal, at, [side + 0.02, 1.02, v - width + 0.17], ALL_SIDES);
            }
        } else {
            r.cuboid(b, m.wood, [u + 0.01, 0.01, v + 0.1], [u + width, 2.08, v + 0.14], ALL_SIDES);
        }
    }
}
