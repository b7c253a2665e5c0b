//! A court 17 m × 6 m between two storeys of arcades, with curtains, banners and a cloth over it, open to the sky.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use super::builder::{ALL_SIDES, Blocks, Builder, STANDING, sin_cos, steps};
use super::spec::Values;
use super::{Built, Parameter, moving, pattern};
use crate::import::draft::MaterialDraft;
use crate::import::pictures::Source;
use crate::import::{View, lights};

/// Most triangles it can be built of.
const MAX_TRIANGLES: usize = 300_000;
/// About how many triangles it is built of.
pub const TRIANGLES: Parameter = Parameter {
    name: "triangles",
    about: "triangles, about",
    default: 3000.0,
    range: 3000.0..=MAX_TRIANGLES as f64,
    is_whole: true,
};
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[TRIANGLES, LORRY];
/// A lorry that crosses the court, half of its edges, m, and its way.
const LORRY: Parameter = moving::flag("lorry", "with a red box that crosses it");
const HALF: Vec3 = Vec3::new(2.5, 1.0, 1.0);
const WAY: [Vec3; 2] = [Vec3::new(8.0, 1.05, 5.4), Vec3::new(17.5, 1.05, 5.4)];

/// Time of its way.
const SECONDS: f32 = 4.0;

/// Grid planes: outer walls 0.4 m thick, galleries round the court.
const X: [f32; 6] = [0.0, 0.4, 3.6, 20.4, 23.6, 24.0];
/// Ground, ceiling and floor of the storeys, top of the roof.
const Y: [f32; 5] = [0.0, 3.7, 4.0, 7.7, 8.1];
const Z: [f32; 6] = [0.0, 0.4, 3.2, 8.8, 11.6, 12.0];

/// Width of the wall between two arches.
const PIER: f32 = 0.4;
/// The arcade stands so far behind the edge of the floors, and is so thick.
const RECESS: f32 = 0.05;
const THICKNESS: f32 = 0.36;
/// Solids that meet go so far into each other, so that no ray slips between.
const OVERLAP: f32 = 0.01;

struct Materials {
    tiles: u32,
    masonry: u32,
    plaster: u32,
    stone: u32,
    roof: u32,
    cloth: [u32; 3],
}

/// Builds it with as near to `triangles` triangles as it can.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let triangles = values.count(&TRIANGLES);
    // The count falls as the edge grows: bisect on the logarithm.
    let mut low = 0.02f32;
    let mut high = 8.0f32;
    let mut best = assemble(high);
    for _ in 0..18 {
        let edge = (low * high).sqrt();
        let trial = assemble(edge);
        let count = trial.mesh.triangles.len();
        if count.abs_diff(triangles) < best.mesh.triangles.len().abs_diff(triangles) && count <= MAX_TRIANGLES {
            best = trial;
        }
        if count > triangles {
            low = edge;
        } else {
            high = edge;
        }
    }
    let sun = lights::directional(Vec3::new(0.3, -1.0, 0.38), Vec3::new(30.0, 28.0, 25.0))?;
    let view = View {
        eye: Vec3::new(4.5, 1.8, 7.3),
        target: Vec3::new(19.0, 3.5, 5.0),
        up: Vec3::Y,
        vertical_fov_degrees: 66.0,
    };
    let mut moving = Vec::new();
    if values.get(&LORRY) != 0.0 {
        let paint = best.plain("red paint", [0.72, 0.08, 0.06]);
        moving.push(moving::lorry(&mut best, paint, HALF, WAY, SECONDS));
    }
    Ok(Built {
        mesh: best.mesh,
        lights: vec![sun],
        sky: Vec3::new(1.2, 1.6, 2.4),
        view,
        exposure_stops: -1.3,
        tracks: Vec::new(),
        moving,
    })
}

fn assemble(edge: f32) -> Builder {
    let mut b = Builder::default();
    let textured =
        |name: &str, source: Source| MaterialDraft { albedo_picture: Some(source), ..MaterialDraft::new(name) };
    let m = Materials {
        tiles: b.material(textured("tiles", pattern::tiles())),
        masonry: b.material(textured("masonry", pattern::masonry())),
        plaster: b.material(textured("plaster", pattern::plaster())),
        stone: b.plain("stone", [0.62, 0.57, 0.48]),
        roof: b.plain("roof", [0.45, 0.22, 0.15]),
        cloth: [("red", [150.0, 26.0, 30.0]), ("green", [34.0, 110.0, 52.0]), ("blue", [34.0, 62.0, 140.0])].map(
            |(name, colour)| {
                let name = format!("cloth-{name}");
                b.material(textured(&name, pattern::cloth(&name, colour)))
            },
        ),
    };
    building(&mut b, &m, edge);
    for side in sides() {
        for (storey, floor) in [(0, Y[0]), (1, Y[2])] {
            arcade(&mut b, &m, &side, storey, floor, edge);
        }
        cloths(&mut b, &m, &side, edge);
    }
    b.object("corner piers");
    for (x, outer_x) in [(X[2], -1.0f32), (X[3], 1.0)] {
        for (z, outer_z) in [(Z[2], -1.0f32), (Z[3], 1.0)] {
            let a = Vec3::new(x + 0.5 * outer_x, 0.0, z + 0.5 * outer_z);
            let c = Vec3::new(x - 0.24 * outer_x, 8.3, z - 0.24 * outer_z);
            b.cuboid(m.stone, a.min(c), a.max(c), STANDING);
        }
    }
    b.object("canopy");
    let width = 3.0;
    let length = Z[3] - Z[2] - 0.4;
    let grid = (steps(width, edge).max(3), steps(length, edge).max(10));
    let sag = |t: f32| 0.7 * sin_cos(0.5 * t).0;
    let at = |s: f32, t: f32| {
        Vec3::new(13.0 + width * s, 7.3 - sag(t) + 0.04 * sin_cos(3.0 * s + t).0, Z[3] - 0.2 - length * t)
    };
    b.sheet(m.cloth[0], grid, at, |s, t| Vec2::new(s * width, t * length));
    b
}

fn building(b: &mut Builder, m: &Materials, edge: f32) {
    b.object("building");
    let court = |c: [i32; 3]| c[0] == 2 && c[2] == 2;
    let solid = |c: [i32; 3]| {
        if c[1] < 0 {
            return true;
        }
        let inside = (0..5).contains(&c[0]) && (0..4).contains(&c[1]) && (0..5).contains(&c[2]);
        let wall = c[0] == 0 || c[0] == 4 || c[2] == 0 || c[2] == 4;
        inside && (wall || (!court(c) && (c[1] == 1 || c[1] == 3)))
    };
    let material = |axis: usize, positive: bool, air: [i32; 3]| match (axis, positive) {
        (1, true) if air[1] >= 4 => m.roof,
        (1, true) => m.tiles,
        (1, false) => m.plaster,
        _ if court(air) => m.plaster,
        _ => m.masonry,
    };
    b.blocks(&Blocks { lines: [&X, &Y, &Z], solid: &solid, material: &material, edge });
}

/// One side of the court: seen from the court, `along` runs to the right, `depth` away into the gallery.
struct Side {
    origin: Vec3,
    along: Vec3,
    depth: Vec3,
    length: f32,
    bays: u32,
}

impl Side {
    fn at(&self, s: f32, y: f32, depth: f32) -> Vec3 {
        self.origin + self.along * s + self.depth * depth + Vec3::Y * y
    }

    /// Start of a bay along the side.
    fn bay(&self, k: u32) -> f32 {
        self.length * (k as f32 / self.bays as f32)
    }

    fn cuboid(&self, b: &mut Builder, material: u32, low: [f32; 3], high: [f32; 3], sides: [bool; 6]) {
        let p = self.at(low[0], low[1], low[2]);
        let q = self.at(high[0], high[1], high[2]);
        b.cuboid(material, p.min(q), p.max(q), sides);
    }
}

fn sides() -> [Side; 4] {
    let side = |x: f32, z: f32, along: Vec3, length: f32, bays: u32| {
        // Fronts face the court when along × up = −depth.
        Side { origin: Vec3::new(x, 0.0, z), along, depth: Vec3::Y.cross(along), length, bays }
    };
    let long = X[3] - X[2];
    let short = Z[3] - Z[2];
    [
        side(X[2], Z[2], Vec3::X, long, 7),
        side(X[3], Z[2], Vec3::Z, short, 2),
        side(X[3], Z[3], Vec3::NEG_X, long, 7),
        side(X[2], Z[3], Vec3::NEG_Z, short, 2),
    ]
}

fn arcade(b: &mut Builder, m: &Materials, side: &Side, storey: usize, floor: f32, edge: f32) {
    b.object(if storey == 0 { "lower arcade" } else { "upper arcade" });
    let spring = floor + 2.2;
    let top = floor + 3.7 + OVERLAP;
    let front = RECESS;
    let back = RECESS + THICKNESS;
    let middle = 0.5 * (front + back);
    for k in 0..side.bays {
        arch(b, m.masonry, side, (side.bay(k), side.bay(k + 1)), (spring, top), edge);
    }
    for k in 1..side.bays {
        let s = side.bay(k);
        let block = |b: &mut Builder, y0: f32, y1: f32, sides| {
            side.cuboid(b, m.stone, [s - 0.25, y0, middle - 0.22], [s + 0.25, y1, middle + 0.22], sides);
        };
        block(b, floor, floor + 0.25, STANDING);
        block(b, spring - 0.2, spring + 0.02, ALL_SIDES);
        let foot = floor + 0.25 - OVERLAP;
        let height = spring - 0.2 - floor - 0.25 + 2.0 * OVERLAP;
        let radius = 0.17;
        let grid = (steps(2.0 * PI * radius, edge).clamp(6, 64), steps(height, edge));
        b.tube(m.stone, side.at(s, foot, middle), height, radius, grid);
    }
    if storey == 1 {
        let grid = (steps(side.length, edge), steps(0.95, edge));
        let near = middle - 0.06;
        let far = middle + 0.06;
        let rail = floor + 0.95;
        let uv = |s: f32, t: f32| Vec2::new(s * side.length, t) * 0.5;
        b.sheet(m.stone, grid, |s, t| side.at(s * side.length, floor + 0.95 * t, near), uv);
        b.sheet(m.stone, grid, |s, t| side.at((1.0 - s) * side.length, floor + 0.95 * t, far), uv);
        b.sheet(m.stone, (grid.0, 1), |s, t| side.at(s * side.length, rail, near + (far - near) * t), uv);
    }
}

/// The wall over one opening, from the springing of its round arch to the ceiling.
fn arch(b: &mut Builder, material: u32, side: &Side, (start, end): (f32, f32), (spring, top): (f32, f32), edge: f32) {
    let front = RECESS;
    let back = RECESS + THICKNESS;
    let left = start + 0.5 * PIER;
    let right = end - 0.5 * PIER;
    let centre = 0.5 * (left + right);
    let radius = 0.5 * (right - left);
    let columns = steps(PI * radius, edge).clamp(4, 96);
    let rows = steps(top - spring, edge);
    // A point of the arch: share 0 at the left springing, 1 at the right.
    let on_arch = |share: f32| {
        if share <= 0.0 {
            return (left, spring);
        }
        if share >= 1.0 {
            return (right, spring);
        }
        let (sin, cos) = sin_cos(0.5 * share);
        (centre - radius * cos, spring + radius * sin)
    };
    let uv = |p: (f32, f32)| Vec2::new(p.0, p.1) * 0.5;
    let above = |share: f32, t: f32| {
        let (s, y) = on_arch(share);
        (s, y + (top - y) * t)
    };
    let strip =
        |from: f32, to: f32| move |share: f32, t: f32| (from + (to - from) * share, spring + (top - spring) * t);
    let place = |p: (f32, f32), depth: f32| side.at(p.0, p.1, depth);
    b.sheet(material, (columns, rows), |s, t| place(above(s, t), front), |s, t| uv(above(s, t)));
    b.sheet(material, (columns, rows), |s, t| place(above(1.0 - s, t), back), |s, t| uv(above(1.0 - s, t)));
    for pier in [strip(start, left), strip(right, end)] {
        b.sheet(material, (1, rows), |s, t| place(pier(s, t), front), |s, t| uv(pier(s, t)));
        b.sheet(material, (1, rows), |s, t| place(pier(1.0 - s, t), back), |s, t| uv(pier(1.0 - s, t)));
    }
    let depth = |t: f32| back + (front - back) * t;
    let soffit_uv = |s: f32, t: f32| Vec2::new(0.5 * PI * radius * s, 0.5 * THICKNESS * t);
    b.sheet(material, (columns, steps(THICKNESS, edge)), |s, t| place(on_arch(s), depth(t)), soffit_uv);
}

/// Curtains in every other lower opening, banners over the railing above the others.
fn cloths(b: &mut Builder, m: &Materials, side: &Side, edge: f32) {
    for k in 0..side.bays {
        let start = side.bay(k);
        let end = side.bay(k + 1);
        let material = m.cloth[(k / 2) as usize % 3];
        let (name, from, to, low, high, depth, folds, amplitude) = if k % 2 == 0 {
            ("curtain", start + 0.45, end - 0.45, 0.12, 2.6, 0.75, 4.0, 0.07)
        } else {
            let middle = 0.5 * (start + end);
            ("banner", middle - 0.5, middle + 0.5, 2.7, 4.75, -0.15, 1.0, 0.03)
        };
        b.object(name);
        let width = to - from;
        let height = high - low;
        let grid = (steps(width, edge).max(2 * folds as u32), steps(height, edge).max(2));
        let at = |s: f32, t: f32| {
            // Folds fade towards the rod.
            let wave = amplitude * (1.0 - 0.6 * t) * sin_cos(folds * s + 0.1 * t).0;
            side.at(from + width * s, low + height * t, depth + wave)
        };
        b.sheet(material, grid, at, |s, t| Vec2::new(s * width, t * height));
    }
    // Rods, between the piers of the arcade.
    b.object("rods");
    for k in (0..side.bays).step_by(2) {
        let start = side.bay(k) + 0.35;
        let end = side.bay(k + 1) - 0.35;
        side.cuboid(b, m.stone, [start, 2.62, 0.73], [end, 2.66, 0.77], ALL_SIDES);
    }
}
