//! Building elements of built-in scenes: quads, solids, sheets and blocks on a grid, all with their front to the air.

use glam::{Vec2, Vec3};

use crate::import::draft::{FileTriangle, MaterialDraft, Mesh};

/// Collects triangles, objects and materials.
#[derive(Default)]
pub struct Builder {
    /// Geometry built so far.
    pub mesh: Mesh,
}

/// Sides of a cuboid, for leaving some out: −x, +x, −y, +y, −z, +z.
pub const ALL_SIDES: [bool; 6] = [true; 6];
/// All sides but the bottom: something that stands on a floor.
pub const STANDING: [bool; 6] = [true, true, false, true, true, true];
/// The four upright sides.
pub const UPRIGHT: [bool; 6] = [true, true, false, false, true, true];

/// As [`Blocks::edge`], cuts nothing.
pub const UNCUT: f32 = f32::MAX;

/// A block structure: cells of a rectilinear grid are solid or air; every face between the two is a wall.
pub struct Blocks<'a> {
    /// Coordinates of the grid planes of each axis, ascending, m.
    pub lines: [&'a [f32]; 3],
    /// Returns true for a solid cell; asked for cells outside as well (indices −1 and count).
    pub solid: &'a dyn Fn([i32; 3]) -> bool,
    /// Material of a face: its normal's axis, whether the normal points along it, the air cell it belongs to.
    pub material: &'a dyn Fn(usize, bool, [i32; 3]) -> u32,
    /// Longest side of a face, m.
    pub edge: f32,
}

impl Builder {
    /// Starts an object.
    pub fn object(&mut self, name: &str) {
        self.mesh.objects.push(name.to_owned());
    }

    /// Adds a material.
    pub fn material(&mut self, material: MaterialDraft) -> u32 {
        self.mesh.materials.push(material);
        self.mesh.materials.len() as u32 - 1
    }

    /// Adds a plain material.
    pub fn plain(&mut self, name: &str, albedo: [f32; 3]) -> u32 {
        self.material(MaterialDraft { albedo: Vec3::from(albedo), ..MaterialDraft::new(name) })
    }

    /// A triangle, corners counter-clockwise from the front.
    pub fn triangle(&mut self, material: u32, corners: [Vec3; 3], uvs: [Vec2; 3]) {
        let object = self.mesh.objects.len().saturating_sub(1) as u32;
        self.mesh.triangles.push(FileTriangle { corners, uvs, normals: [0; 3], material, object });
    }

    /// A quadrilateral, corners counter-clockwise from the front, as a fan from the first.
    pub fn quad(&mut self, material: u32, [a, b, c, d]: [Vec3; 4], [ua, ub, uc, ud]: [Vec2; 4]) {
        self.triangle(material, [a, b, c], [ua, ub, uc]);
        self.triangle(material, [a, c, d], [ua, uc, ud]);
    }

    /// A quadrilateral without texture coordinates worth naming: the unit square.
    pub fn plain_quad(&mut self, material: u32, corners: [Vec3; 4]) {
        self.quad(material, corners, [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]);
    }

    /// A grid of `columns × rows` quads over points `at(s, t)`, s and t in 0 … 1; front where `∂s × ∂t` points.
    pub fn sheet(
        &mut self,
        material: u32,
        (columns, rows): (u32, u32),
        at: impl Fn(f32, f32) -> Vec3,
        uv: impl Fn(f32, f32) -> Vec2,
    ) {
        for row in 0..rows {
            for column in 0..columns {
                let s0 = column as f32 / columns as f32;
                let s1 = (column + 1) as f32 / columns as f32;
                let t0 = row as f32 / rows as f32;
                let t1 = (row + 1) as f32 / rows as f32;
                let corners = [(s0, t0), (s1, t0), (s1, t1), (s0, t1)];
                self.quad(material, corners.map(|(s, t)| at(s, t)), corners.map(|(s, t)| uv(s, t)));
            }
        }
    }

    /// A cuboid with its front outside; `sides` as in [`ALL_SIDES`].
    pub fn cuboid(&mut self, material: u32, low: Vec3, high: Vec3, sides: [bool; 6]) {
        for (side, wanted) in sides.into_iter().enumerate() {
            if wanted {
                self.cuboid_side(material, low, high, side);
            }
        }
    }

    /// One side of a cuboid, front outside.
    pub fn cuboid_side(&mut self, material: u32, low: Vec3, high: Vec3, side: usize) {
        let axis = side / 2;
        let positive = side % 2 == 1;
        let at = if positive { high[axis] } else { low[axis] };
        let a = (axis + 1) % 3;
        let b = (axis + 2) % 3;
        self.face(material, axis, positive, at, [low[a], high[a]], [low[b], high[b]]);
    }

    /// An axis-parallel rectangle: the plane `axis = at`, ranges of the next and the next but one axis; front along the
    /// axis or against it.
    pub fn face(&mut self, material: u32, axis: usize, positive: bool, at: f32, a: [f32; 2], b: [f32; 2]) {
        let corner = |x: f32, y: f32| {
            let mut p = Vec3::ZERO;
            p[axis] = at;
            p[(axis + 1) % 3] = x;
            p[(axis + 2) % 3] = y;
            p
        };
        let mut corners = [corner(a[0], b[0]), corner(a[1], b[0]), corner(a[1], b[1]), corner(a[0], b[1])];
        if !positive {
            corners.swap(1, 3);
        }
        self.quad(material, corners, corners.map(|p| metric_uv(axis, p)));
    }

    /// A parallelepiped with its front outside: a corner, and edges with (a × b) · c > 0.
    pub fn slab(&mut self, material: u32, corner: Vec3, [a, b, c]: [Vec3; 3]) {
        for (a, b, c) in [(a, b, c), (b, c, a), (c, a, b)] {
            self.plain_quad(material, [corner, corner + b, corner + a + b, corner + a]);
            let far = corner + c;
            self.plain_quad(material, [far, far + a, far + a + b, far + b]);
        }
    }

    /// A ball of 32 triangles, front outside: an octahedron whose faces are cut in four, all corners on the sphere.
    pub fn ball(&mut self, material: u32, centre: Vec3, radius: f32) {
        for octant in 0..8 {
            let sign = |bit: u32| if octant >> bit & 1 == 0 { 1.0 } else { -1.0 };
            let [x, mut y, mut z] = [Vec3::X * sign(0), Vec3::Y * sign(1), Vec3::Z * sign(2)];
            if sign(0) * sign(1) * sign(2) < 0.0 {
                std::mem::swap(&mut y, &mut z);
            }
            let [xy, yz, zx] = [(x + y).normalize(), (y + z).normalize(), (z + x).normalize()];
            for corners in [[x, xy, zx], [xy, y, yz], [zx, yz, z], [xy, yz, zx]] {
                self.triangle(material, corners.map(|p| centre + p * radius), [Vec2::ZERO, Vec2::X, Vec2::Y]);
            }
        }
    }

    /// An upright tube of `sides` quads round, `rows` high, front outside, without lids.
    pub fn tube(&mut self, material: u32, foot: Vec3, height: f32, radius: f32, (sides, rows): (u32, u32)) {
        // s runs against the angle, so that the front is outside.
        let at = |s: f32, t: f32| {
            let (sin, cos) = sin_cos(-s);
            foot + Vec3::new(radius * cos, height * t, radius * sin)
        };
        let round = std::f32::consts::PI * radius;
        let height_uv = 0.5 * height;
        self.sheet(material, (sides, rows), at, |s, t| Vec2::new(s * round, t * height_uv));
    }

    /// All faces between air and solid. Neighbouring faces share corners bit for bit.
    pub fn blocks(&mut self, blocks: &Blocks) {
        let fine: [Vec<(f32, i32)>; 3] = [0, 1, 2].map(|axis| refine(blocks.lines[axis], blocks.edge));
        for axis in 0..3 {
            let a = (axis + 1) % 3;
            let b = (axis + 2) % 3;
            for (plane, at) in blocks.lines[axis].iter().enumerate() {
                for pa in fine[a].windows(2) {
                    for pb in fine[b].windows(2) {
                        let cell = |layer: i32| {
                            let mut c = [0; 3];
                            (c[axis], c[a], c[b]) = (layer, pa[0].1, pb[0].1);
                            c
                        };
                        let below = cell(plane as i32 - 1);
                        let above = cell(plane as i32);
                        let solid_below = (blocks.solid)(below);
                        let solid_above = (blocks.solid)(above);
                        if solid_below != solid_above {
                            let air = if solid_below { above } else { below };
                            let material = (blocks.material)(axis, solid_below, air);
                            self.face(material, axis, solid_below, *at, [pa[0].0, pa[1].0], [pb[0].0, pb[1].0]);
                        }
                    }
                }
            }
        }
    }
}

/// Grid planes with extra ones so that no interval exceeds `edge`; each with the index of the interval above it.
fn refine(lines: &[f32], edge: f32) -> Vec<(f32, i32)> {
    let mut fine = Vec::new();
    for (k, pair) in lines.windows(2).enumerate() {
        let parts = steps(pair[1] - pair[0], edge);
        fine.extend((0..parts).map(|i| (pair[0] + (pair[1] - pair[0]) * (i as f32 / parts as f32), k as i32)));
    }
    fine.extend(lines.last().map(|last| (*last, lines.len() as i32 - 1)));
    fine
}

/// Number of parts of at most `edge` into which a length is cut.
pub fn steps(length: f32, edge: f32) -> u32 {
    ((length / edge).ceil() as u32).max(1)
}

/// (sin, cos) of a share of a full circle, any sign.
pub fn sin_cos(share: f32) -> (f32, f32) {
    scene::math::sin_cos_2pi(share - share.floor())
}

/// One repeat of a pattern in 2 m: along the ground, or along the wall and up.
fn metric_uv(axis: usize, p: Vec3) -> Vec2 {
    match axis {
        0 => Vec2::new(p.z, p.y) * 0.5,
        1 => Vec2::new(p.x, -p.z) * 0.5,
        _ => Vec2::new(p.x, p.y) * 0.5,
    }
}
