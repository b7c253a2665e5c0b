//! Adaptive direct illumination: each triangle that a light may fall on is split until the light is linear on its pieces.

use std::vec::Vec;

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use scene::kernel::light::unoccluded;
use scene::math::luminance;
use scene::{LIGHT_RECT, Scene};

use super::Proceed;
use crate::error::{Error, check_setting};

/// Corners are moved to the middle of their triangle by this share: on the very edge a neighbour would shade them.
const INWARDS: f32 = 1e-3;
/// Triangles of one step of progress.
const BLOCK: usize = 4096;

/// How finely light on triangles is found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PieceSettings {
    /// A piece is split unless the light in its middle is the mean of that at its corners, within this share of the greatest.
    pub tolerance: f32,
    /// Most splits of a triangle in a row.
    pub depth: u32,
    /// No piece with less than one over this of the power of all lights is split: at most a few times as many pieces.
    pub pieces: u32,
    /// Longest edge that is not split, dark or not: what is smaller may be missed. A share of the scene's diagonal.
    pub longest: f32,
}

impl Default for PieceSettings {
    /// 5 %, 10 splits, 2¹⁷ pieces, 1/128 of the diagonal.
    fn default() -> Self {
        Self { tolerance: 0.05, depth: 10, pieces: 1 << 17, longest: 1.0 / 128.0 }
    }
}

/// A piece of a triangle and the light of one lamp on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// The triangle.
    pub triangle: u32,
    /// The light.
    pub light: u32,
    /// Whether it lies on the back.
    pub is_back: bool,
    /// Corners as shares (u, v) of the triangle's edges.
    pub corners: [Vec2; 3],
    /// Irradiance over the light's colour at the corners.
    pub values: [f32; 3],
    /// The same in the middle.
    pub middle: f32,
    /// The greatest of corners and middle of the piece that this one was split from, 0 for a whole triangle.
    pub around: f32,
    /// Area, m².
    pub area: f32,
}

/// Light of one lamp at places of one side of a triangle.
struct Side<'a> {
    scene: &'a Scene,
    triangle: u32,
    light: u32,
    normal: Vec3,
    edges: (Vec3, Vec3),
    area: f32,
}

impl<'a> Side<'a> {
    /// The side that the light is on; nothing for triangles without area, and for lights in their plane.
    fn new(scene: &'a Scene, triangle: u32, light: u32) -> Option<Self> {
        let t = &scene.triangles[triangle as usize];
        let across = t.edge_a.cross(t.edge_b);
        let area = 0.5 * across.length();
        if area.is_nan() || area <= 0.0 || !(across / area).is_finite() {
            return None;
        }
        let front = scene.geometry().normal(triangle);
        let lamp = &scene.lights[light as usize];
        // Parallel light has no position: an offset of nothing stands for it.
        let centre = scene.geometry().position(triangle, 1.0 / 3.0, 1.0 / 3.0);
        let towards = unoccluded(lamp, centre, front).to_light.dot(front);
        (towards != 0.0 && towards.is_finite()).then(|| {
            let normal = if towards > 0.0 { front } else { -front };
            Self { scene, triangle, light, normal, edges: (t.edge_a, t.edge_b), area }
        })
    }

    fn is_back(&self) -> bool {
        self.scene.geometry().normal(self.triangle).dot(self.normal) < 0.0
    }

    /// Irradiance over the light's colour at shares (u, v).
    fn light_at(&self, at: Vec2) -> f32 {
        let origin = self.scene.geometry().position(self.triangle, at.x, at.y) + self.normal * self.scene.ray_offset;
        let arrival = unoccluded(&self.scene.lights[self.light as usize], origin, self.normal);
        if arrival.share > 0.0 && !self.scene.occluded(origin, arrival.to_light, arrival.t_max) {
            arrival.share
        } else {
            0.0
        }
    }

    /// The same at a corner of a piece, which may lie on the edge of the triangle.
    fn light_at_corner(&self, at: Vec2) -> f32 {
        self.light_at(at + (Vec2::splat(1.0 / 3.0) - at) * INWARDS)
    }

    fn piece(&self, corners: [Vec2; 3], values: [f32; 3], around: f32) -> Piece {
        let middle = self.light_at((corners[0] + corners[1] + corners[2]) / 3.0);
        let share = (corners[1] - corners[0]).perp_dot(corners[2] - corners[0]).abs();
        let area = share * self.area;
        let is_back = self.is_back();
        Piece { triangle: self.triangle, light: self.light, is_back, corners, values, middle, around, area }
    }

    fn whole(&self) -> Piece {
        let corners = [Vec2::ZERO, Vec2::X, Vec2::Y];
        self.piece(corners, corners.map(|at| self.light_at_corner(at)), 0.0)
    }

    /// Squared lengths of the edges opposite to the corners, m².
    fn edges_squared(&self, c: &[Vec2; 3]) -> [f32; 3] {
        let edge = |a: Vec2, b: Vec2| ((b.x - a.x) * self.edges.0 + (b.y - a.y) * self.edges.1).length_squared();
        [edge(c[1], c[2]), edge(c[2], c[0]), edge(c[0], c[1])]
    }

    /// Two, three or four children: an obtuse piece is cut across its longest edge, another across those of its edges on
    /// which light is not linear; across all where that is so in its middle only.
    fn split(&self, piece: &Piece, tolerance: f32, children: &mut Vec<Piece>) {
        let (c, v) = (piece.corners, piece.values);
        let squared = self.edges_squared(&c);
        let longest = (0..3).max_by(|&a, &b| squared[a].total_cmp(&squared[b])).unwrap_or(0);
        let top = piece.top();
        let half = |k: usize| (c[(k + 1) % 3] + c[(k + 2) % 3]) * 0.5;
        let mut add = |corners, values| children.push(self.piece(corners, values, top));
        // The two children of a cut across the edge opposite to corner k.
        let mut in_two = |k: usize, at: Vec2, value: f32| {
            let (a, b) = ((k + 1) % 3, (k + 2) % 3);
            add([c[k], c[a], at], [v[k], v[a], value]);
            add([c[k], at, c[b]], [v[k], value, v[b]]);
        };
        if squared[longest] > 1.0001 * (squared[(longest + 1) % 3] + squared[(longest + 2) % 3]) {
            let at = half(longest);
            return in_two(longest, at, self.light_at_corner(at));
        }
        let at = [half(0), half(1), half(2)];
        let value = at.map(|at| self.light_at_corner(at));
        let bends = |k: usize| {
            let ends = 0.5 * (v[(k + 1) % 3] + v[(k + 2) % 3]);
            (value[k] - ends).abs() > tolerance * top.max(value[k])
        };
        let bent: Vec<usize> = (0..3).filter(|&k| bends(k)).collect();
        match bent[..] {
            [k] => in_two(k, at[k], value[k]),
            [j, k] => {
                // The corner between both edges, then the quadrangle along the shorter way across.
                let corner = 3 - j - k;
                let (a, b) = ((corner + 1) % 3, (corner + 2) % 3);
                // Edge opposite to b runs from the corner to a.
                let (p, q) = (b, a);
                add([c[corner], at[p], at[q]], [v[corner], value[p], value[q]]);
                let first = self.edges_squared(&[at[p], c[b], c[b]])[2];
                let second = self.edges_squared(&[c[a], at[q], at[q]])[2];
                if first < second {
                    add([at[p], c[a], c[b]], [value[p], v[a], v[b]]);
                    add([at[p], c[b], at[q]], [value[p], v[b], value[q]]);
                } else {
                    add([at[p], c[a], at[q]], [value[p], v[a], value[q]]);
                    add([c[a], c[b], at[q]], [v[a], v[b], value[q]]);
                }
            }
            _ => {
                for k in 0..3 {
                    let (a, b) = ((k + 1) % 3, (k + 2) % 3);
                    add([c[k], at[b], at[a]], [v[k], value[b], value[a]]);
                }
                add(at, value);
            }
        }
    }
}

impl Piece {
    /// The greatest known light, over the light's colour.
    pub fn top(&self) -> f32 {
        self.values.iter().copied().fold(self.middle, f32::max)
    }

    /// Mean of the corners: that of the piece where light is linear.
    pub fn mean(&self) -> f32 {
        (self.values[0] + self.values[1] + self.values[2]) / 3.0
    }

    fn is_linear(&self, tolerance: f32) -> bool {
        (self.middle - self.mean()).abs() <= tolerance * self.top()
    }
}

/// When pieces of a side are split.
struct Refining<'s, 'a> {
    side: &'s Side<'a>,
    tolerance: f32,
    /// Least greatest light times area of a piece that matters.
    least: f32,
    /// Longest edge, m.
    longest: f32,
}

impl Refining<'_, '_> {
    /// Adds the leaves of a piece that may be split `levels` times more; whether that is the piece as a whole. A long piece
    /// is split to look for shadows, or for light, but stays whole where there are none.
    fn refine(&self, piece: Piece, levels: u32, leaves: &mut Vec<Piece>) -> bool {
        let (side, top) = (self.side, piece.top());
        let is_long = || side.edges_squared(&piece.corners).iter().any(|&l| l > self.longest * self.longest);
        let is_even = piece.is_linear(self.tolerance);
        let is_split = levels > 0 && (!is_even && top * piece.area > self.least || is_long());
        let before = leaves.len();
        let mut is_whole = true;
        if is_split {
            let mut children = Vec::with_capacity(4);
            side.split(&piece, self.tolerance, &mut children);
            for child in children {
                is_whole &= self.refine(child, levels - 1, leaves);
            }
            is_whole &= is_even;
            if is_whole {
                leaves.truncate(before);
            }
        }
        if is_whole && top.max(piece.around) > 0.0 {
            leaves.push(piece);
        }
        is_whole && is_even
    }
}

/// Luminance of the light that a piece reflects for each unit of light over colour and m².
fn reflectance(scene: &Scene, piece: &Piece) -> f32 {
    luminance(mean_albedo(scene, piece) * scene.lights[piece.light as usize].color)
}

/// Mean reflectance of a piece.
pub(super) fn mean_albedo(scene: &Scene, piece: &Piece) -> Vec3 {
    let at = (piece.corners[0] + piece.corners[1] + piece.corners[2]) / 3.0;
    scene.filtered_albedo(piece.triangle, scene.geometry().position(piece.triangle, at.x, at.y), piece.area)
}

/// The pieces that each point-like light falls on, light by light, in the order of the triangles. Pieces on which all is
/// dark are there only where light fell on the piece that they were split from.
///
/// Kopylov's algorithm 1: a piece is split until the light in its middle is the mean of that at its corners; edges of
/// shadows are split down to the limits.
///
/// # Errors
/// [`Error::Setting`], [`Error::Cancelled`].
pub fn lit_pieces(
    scene: &Scene,
    settings: &PieceSettings,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<Vec<Piece>, Error> {
    let PieceSettings { tolerance, depth, pieces, longest } = *settings;
    check_setting("tolerance", f64::from(tolerance), "positive", tolerance > 0.0)?;
    check_setting("pieces", f64::from(pieces), "at least 1", pieces > 0)?;
    check_setting("longest", f64::from(longest), "positive", longest > 0.0)?;
    let shines = |&k: &usize| scene.lights[k].kind != LIGHT_RECT && luminance(scene.lights[k].color) > 0.0;
    let lights: Vec<usize> = (0..scene.lights.len()).filter(shines).collect();
    let blocks = scene.triangles.len().div_ceil(BLOCK);
    let steps = 2 * blocks * lights.len();
    let in_block = |block: usize| block * BLOCK..((block + 1) * BLOCK).min(scene.triangles.len());

    // Whole triangles first: they say how much power there is.
    let mut whole = Vec::new();
    for (n, &light) in lights.iter().enumerate() {
        for block in 0..blocks {
            let piece = |t: usize| Side::new(scene, t as u32, light as u32).map(|side| side.whole());
            whole.push(in_block(block).into_par_iter().filter_map(piece).collect::<Vec<Piece>>());
            let done = n * blocks + block;
            if progress(done, steps).is_break() {
                return Err(Error::Cancelled { done, total: steps });
            }
        }
    }
    let power = |p: &Piece| f64::from(reflectance(scene, p) * p.area) * f64::from(0.75 * p.mean() + 0.25 * p.middle);
    let total: f64 =
        whole.iter().map(|block| block.par_iter().map(power).collect::<Vec<f64>>().iter().sum::<f64>()).sum();
    let least = (total / f64::from(pieces)) as f32;
    let longest = longest * scene.diagonal();

    let mut found = Vec::new();
    for (n, block) in whole.into_iter().enumerate() {
        let refined = |piece: Piece| {
            let mut leaves = Vec::new();
            // Its reflectance is that of the triangle all the way down: it only decides where to stop.
            let reflectance = reflectance(scene, &piece);
            if let Some(side) = Side::new(scene, piece.triangle, piece.light).filter(|_| reflectance > 0.0) {
                let least = least / reflectance;
                Refining { side: &side, tolerance, least, longest }.refine(piece, depth, &mut leaves);
            }
            leaves
        };
        let leaves: Vec<Vec<Piece>> = block.into_par_iter().map(refined).collect();
        found.extend(leaves.into_iter().flatten());
        let done = steps / 2 + n;
        if progress(done, steps).is_break() {
            return Err(Error::Cancelled { done, total: steps });
        }
    }
    Ok(found)
}
