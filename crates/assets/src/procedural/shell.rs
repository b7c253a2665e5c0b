//! A room with walls of some thickness and one window, and a terrace outside: what several scenes begin with.

use glam::Vec3;

use super::builder::{ALL_SIDES, Blocks, Builder, UNCUT, UPRIGHT};

/// The room: inside from the origin to `size`.
pub struct Shell {
    /// Size of the inside, m.
    pub size: Vec3,
    /// Thickness of walls, floor and ceiling, m.
    pub wall: f32,
    /// Axis, 0 or 2, at whose zero the wall with the window stands.
    pub axis: usize,
    /// From where to where the window goes along that wall, m.
    pub along: [f32; 2],
    /// Its lower and upper end, m.
    pub up: [f32; 2],
}

/// Extent of the terrace from the wall with the window and beside it, m.
const TERRACE: [f32; 2] = [6.0, 2.0];

/// Parts of furniture go so far into each other, m.
pub const OVERLAP: f32 = 0.005;

impl Shell {
    /// Adds walls, floor, ceiling and terrace.
    pub fn build(&self, b: &mut Builder) {
        let floor = b.plain("floor", [0.5, 0.42, 0.33]);
        let wall = b.plain("wall", [0.72, 0.7, 0.66]);
        let paving = b.plain("terrace", [0.42, 0.4, 0.38]);
        let other = 2 - self.axis;
        let ends = |axis: usize| [-self.wall, 0.0, self.size[axis], self.size[axis] + self.wall];
        let with_window = |axis: usize, window: [f32; 2]| {
            let [outside, low, high, end] = ends(axis);
            [outside, low, window[0], window[1], high, end]
        };
        let deep = ends(self.axis);
        let wide = with_window(other, self.along);
        let high = with_window(1, self.up);
        let lines: [&[f32]; 3] = if self.axis == 0 { [&deep, &high, &wide] } else { [&wide, &high, &deep] };
        let solid = |c: [i32; 3]| {
            let inside = |axis: usize, from: i32, to: i32| (from..=to).contains(&c[axis]);
            let in_block = inside(self.axis, 0, 2) && inside(other, 0, 4) && inside(1, 0, 4);
            let in_room = inside(self.axis, 1, 1) && inside(other, 1, 3) && inside(1, 1, 3);
            let in_window = c[self.axis] == 0 && c[other] == 2 && c[1] == 2;
            in_block && !in_room && !in_window
        };
        let is_room = |c: [i32; 3]| c[self.axis] == 1 && (1..=3).contains(&c[other]) && (1..=3).contains(&c[1]);
        let material = |axis: usize, positive: bool, air: [i32; 3]| {
            if axis == 1 && positive && is_room(air) { floor } else { wall }
        };
        b.object("room");
        b.blocks(&Blocks { lines, solid: &solid, material: &material, edge: UNCUT });
        b.object("terrace");
        let [depth, side] = TERRACE;
        let mut low = Vec3::splat(-self.wall);
        let mut far = Vec3::splat(-self.wall);
        low[self.axis] -= depth;
        low[other] -= side;
        far[other] = self.size[other] + self.wall + side;
        b.cuboid_side(paving, low, far, 3);
    }

    /// A table with its near corner at `at`.
    pub fn table(&self, b: &mut Builder, material: u32, at: Vec3, size: Vec3) {
        const TOP: f32 = 0.03;
        const LEG: f32 = 0.05;
        const INSET: f32 = 0.03;
        b.object("table");
        let high = at + size;
        b.cuboid(material, at.with_y(high.y - TOP), high, ALL_SIDES);
        for x in [at.x + INSET, high.x - INSET - LEG] {
            for z in [at.z + INSET, high.z - INSET - LEG] {
                let top = high.y - TOP + OVERLAP;
                b.cuboid(material, Vec3::new(x, at.y, z), Vec3::new(x + LEG, top, z + LEG), UPRIGHT);
            }
        }
    }
}
