//! Adaptive direct illumination: each triangle that a light may fall on is split into light elements until the light
//! is linear on each.

use alloc::vec::Vec;
use core::cell::Cell;
use core::ops::Range;
use core::sync::atomic::{AtomicUsize, Ordering};

use glam::{Vec2, Vec3};
use scene::kernel::light::{Arrival, unoccluded};
use scene::math::luminance;
use scene::parallel::*;
use scene::{LIGHT_RECT, Occluder, Scene};

use super::Proceed;
use crate::error::{Error, check_setting};
use crate::kernel::start::{share_left, way_of};

/// Corners are moved to the middle of their triangle by this share: on the very edge a neighbour would shade them.
const INWARDS: f32 = 1e-3;
/// Triangles of one step of progress.
const BLOCK: usize = 256;
/// What the light of an element counts for on its dark parts.
const AROUND: f32 = 0.25;
/// Shadow rays that neighbours share.
const LOOKS: usize = 4;

/// How triangles are split into light elements.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Subdivision {
    /// Across the edges on which light bends. Elements that matter are split to look for shadows, and joined again where there
    /// are none.
    #[default]
    Edges,
    /// Algorithm 1 as Kopylov prints it: an element whose middle has the mean of its corners is not split. Without an obtuse angle
    /// it is split into three at its middle; else at the middle of its longest edge, into two, or into four at those of all
    /// edges where light bends more along both cuts than in the middle.
    Kopylov,
}

/// How finely light on triangles is found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightElementSettings {
    /// How triangles are split.
    pub subdivision: Subdivision,
    /// An element is split unless the light in its middle is the mean of that at its corners, within this share of
    /// the greatest.
    pub tolerance: f32,
    /// Most splits of a triangle in a row.
    pub depth: u32,
    /// Nothing with less than one over this of the power that all lights would have, were nothing in the way, is looked at more
    /// closely: at most a few times as many shadow rays.
    pub elements: u32,
    /// Longest edge that is not split, dark or not: what is smaller may be missed. A share of the scene's diagonal.
    pub longest: f32,
    /// Most triangles with less than that power that share four shadow rays with their neighbours in the hierarchy; with 1 each has
    /// four of its own.
    pub neighbours: u32,
}

impl Default for LightElementSettings {
    /// 5 %, 10 splits, 2¹⁸ elements, 1/32 of the diagonal, 8 neighbours: for start points that look for their light
    /// themselves.
    fn default() -> Self {
        Self {
            subdivision: Subdivision::Edges,
            tolerance: 0.05,
            depth: 10,
            elements: 1 << 18,
            longest: 1.0 / 32.0,
            neighbours: 8,
        }
    }
}

impl LightElementSettings {
    /// For photons that take the table's light as it is (Kopylov): 2¹⁷ elements, nothing shared.
    pub fn table_alone() -> Self {
        Self { elements: 1 << 17, longest: 1.0 / 128.0, neighbours: 1, ..Self::default() }
    }

    /// The same split as algorithm 1 of Kopylov has it: twice as many splits in a row, of which every other one halves edges.
    pub fn as_printed(self) -> Self {
        Self { subdivision: Subdivision::Kopylov, depth: 2 * self.depth, ..self }
    }
}

/// An adaptive light element: a part of a triangle, and the light of one lamp on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightElement {
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
    /// A fourth of the greatest light of the element that this one was split from, or what neighbours of its group
    /// let expect; 0 for other triangles.
    pub around: f32,
    /// Area, m².
    pub area: f32,
    /// Mean share of the light that goes on: what is reflected, mirrored and let through.
    pub onward: Vec3,
    /// Share of the shadow rays of its group that reach the light, which the values hold already; 1 for elements that
    /// have their own, and where none does.
    pub seen: f32,
}

/// Corners of a whole triangle.
const WHOLE: [Vec2; 3] = [Vec2::ZERO, Vec2::X, Vec2::Y];

/// A place a little nearer to the middle of the triangle.
#[inline]
fn inwards(at: Vec2) -> Vec2 {
    at + (Vec2::splat(1.0 / 3.0) - at) * INWARDS
}

/// An element that may be cut further.
struct Cut {
    element: LightElement,
    /// Power that it would reflect for each unit of the light's colour, were it white and nothing in the way of its middle.
    potential: f32,
}

/// Light of one lamp at places of one side of a triangle.
struct Side<'a> {
    scene: &'a Scene,
    triangle: u32,
    light: u32,
    normal: Vec3,
    edges: (Vec3, Vec3),
    area: f32,
    /// What was in the way last.
    last: Cell<Occluder>,
    /// Shadow rays so far.
    rays: Cell<u64>,
}

impl<'a> Side<'a> {
    /// The side that the light is on; nothing for triangles without area, and for lights in their plane.
    fn new(scene: &'a Scene, triangle: u32, light: u32) -> Option<Self> {
        let t = &scene.geometry.triangles[triangle as usize];
        let across = t.edge_a.cross(t.edge_b);
        let area = 0.5 * across.length();
        if area.is_nan() || area <= 0.0 || !(across / area).is_finite() {
            return None;
        }
        let front = scene.tables().normal(triangle);
        let lamp = &scene.lighting.lights[light as usize];
        // Parallel light has no position: an offset of nothing stands for it.
        let centre = scene.tables().position(triangle, 1.0 / 3.0, 1.0 / 3.0);
        let towards = unoccluded(lamp, &scene.lighting.distributions, centre, front).to_light.dot(front);
        (towards != 0.0 && towards.is_finite()).then(|| {
            let normal = if towards > 0.0 { front } else { -front };
            Self {
                scene,
                triangle,
                light,
                normal,
                edges: (t.edge_a, t.edge_b),
                area,
                last: Cell::default(),
                rays: Cell::default(),
            }
        })
    }

    /// 1 on the front, −1 on the back.
    fn sign(&self) -> f32 {
        if self.is_back() { -1.0 } else { 1.0 }
    }

    fn is_back(&self) -> bool {
        self.scene.tables().normal(self.triangle).dot(self.normal) < 0.0
    }

    /// Where a ray from shares (u, v) starts, and what light there would be, were nothing but the medium in the way: of several
    /// colours that a medium parts, the luminance.
    #[inline]
    fn arrival(&self, at: Vec2) -> (Vec3, Arrival) {
        let origin =
            self.scene.tables().position(self.triangle, at.x, at.y) + self.normal * self.scene.geometry.ray_offset;
        let lighting = &self.scene.lighting;
        let light = &lighting.lights[self.light as usize];
        let mut arrival = unoccluded(light, &lighting.distributions, origin, self.normal);
        if self.scene.has_medium() {
            arrival.share *= share_left(light.color, self.scene.transmittance(way_of(&arrival)));
        }
        (origin, arrival)
    }

    /// Irradiance over the light's colour at shares (u, v).
    fn light_at(&self, at: Vec2) -> f32 {
        let (origin, arrival) = self.arrival(at);
        if self.is_lit(origin, &arrival) { arrival.share } else { 0.0 }
    }

    fn is_lit(&self, origin: Vec3, arrival: &Arrival) -> bool {
        if arrival.share <= 0.0 {
            return false;
        }
        self.rays.set(self.rays.get() + 1);
        !self.scene.occluded_again(origin, arrival.to_light, arrival.t_max, &self.last)
    }

    /// The same at a corner of an element, which may lie on the edge of the triangle.
    fn light_at_corner(&self, at: Vec2) -> f32 {
        self.light_at(inwards(at))
    }

    fn element(&self, corners: [Vec2; 3], values: [f32; 3], around: f32, onward: Vec3) -> Cut {
        let (origin, arrival) = self.arrival((corners[0] + corners[1] + corners[2]) / 3.0);
        let middle = if self.is_lit(origin, &arrival) { arrival.share } else { 0.0 };
        let share = (corners[1] - corners[0]).perp_dot(corners[2] - corners[0]).abs();
        let area = share * self.area;
        let (triangle, light, is_back) = (self.triangle, self.light, self.is_back());
        let element =
            LightElement { triangle, light, is_back, corners, values, middle, around, area, onward, seen: 1.0 };
        Cut { element, potential: area * arrival.share }
    }

    /// The triangle as an element, with this light in its corners.
    fn whole(&self, onward: Vec3) -> Cut {
        self.element(WHOLE, WHOLE.map(|at| self.light_at_corner(at)), 0.0, onward)
    }

    /// Squared lengths of the edges opposite to the corners, m².
    fn edges_squared(&self, c: &[Vec2; 3]) -> [f32; 3] {
        let edge = |a: Vec2, b: Vec2| ((b.x - a.x) * self.edges.0 + (b.y - a.y) * self.edges.1).length_squared();
        [edge(c[1], c[2]), edge(c[2], c[0]), edge(c[0], c[1])]
    }

    fn is_longer(&self, corners: &[Vec2; 3], longest: f32) -> bool {
        self.edges_squared(corners).iter().any(|&squared| squared > longest * longest)
    }

    /// Two, three or four children: an obtuse element is cut across its longest edge, another across those of its
    /// edges on which light is not linear; across all where that is so in its middle only.
    fn split(&self, element: &LightElement, tolerance: f32, children: &mut Vec<Cut>) {
        let (c, v) = (element.corners, element.values);
        let squared = self.edges_squared(&c);
        let longest = (0..3).max_by(|&a, &b| squared[a].total_cmp(&squared[b])).unwrap_or(0);
        let top = element.top();
        let half = |k: usize| (c[(k + 1) % 3] + c[(k + 2) % 3]) * 0.5;
        let mut add = |corners, values| children.push(self.element(corners, values, AROUND * top, element.onward));
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

impl Side<'_> {
    /// The children of an element by Kopylov's algorithm 1, two, three or four.
    fn split_as_printed(&self, element: &LightElement, children: &mut Vec<Cut>) {
        let (c, v) = (element.corners, element.values);
        let mut add =
            |corners, values| children.push(self.element(corners, values, AROUND * element.top(), element.onward));
        let squared = self.edges_squared(&c);
        let obtuse = (0..3).find(|&k| squared[k] > squared[(k + 1) % 3] + squared[(k + 2) % 3]);
        // A is the corner with the obtuse angle, of the longest edge BC.
        let Some(a) = obtuse else {
            let d = (c[0] + c[1] + c[2]) / 3.0;
            (0..3).for_each(|k| add([c[k], c[(k + 1) % 3], d], [v[k], v[(k + 1) % 3], element.middle]));
            return;
        };
        let b = (a + 1) % 3;
        let end = (a + 2) % 3;
        let e = (c[b] + c[end]) * 0.5;
        let light_e = self.light_at_corner(e);
        let in_middle = (element.middle - element.mean()).abs();
        let along_edge = (light_e - 0.5 * (v[b] + v[end])).abs();
        let along_cut = (element.middle - 0.5 * (v[a] + light_e)).abs();
        if along_edge > in_middle && along_cut > in_middle {
            let (f, g) = ((c[a] + c[b]) * 0.5, (c[a] + c[end]) * 0.5);
            let (light_f, light_g) = (self.light_at_corner(f), self.light_at_corner(g));
            add([c[a], f, g], [v[a], light_f, light_g]);
            add([c[b], e, f], [v[b], light_e, light_f]);
            add([c[end], g, e], [v[end], light_g, light_e]);
            add([f, e, g], [light_f, light_e, light_g]);
        } else {
            add([c[a], c[b], e], [v[a], v[b], light_e]);
            add([c[a], e, c[end]], [v[a], light_e, v[end]]);
        }
    }
}

impl LightElement {
    /// The greatest known light, over the light's colour.
    pub fn top(&self) -> f32 {
        self.values.iter().copied().fold(self.middle, f32::max)
    }

    /// Mean of the corners: that of the element where light is linear.
    pub fn mean(&self) -> f32 {
        (self.values[0] + self.values[1] + self.values[2]) / 3.0
    }

    fn is_linear(&self, tolerance: f32) -> bool {
        (self.middle - self.mean()).abs() <= tolerance * self.top()
    }
}

/// When elements of a side are split.
struct Refining<'s, 'a> {
    side: &'s Side<'a>,
    tolerance: f32,
    /// Least potential of an element that matters.
    least: f32,
    /// Longest edge, m.
    longest: f32,
}

impl Refining<'_, '_> {
    /// Adds the leaves of an element that may be split `levels` times more; whether that is the element as a whole.
    /// An element that matters is split to look for shadows, or for light, but stays whole where there are none.
    fn refine(&self, cut: Cut, levels: u32, leaves: &mut Vec<LightElement>) -> bool {
        let Cut { element, potential } = cut;
        let (side, top) = (self.side, element.top());
        let is_even = element.is_linear(self.tolerance);
        let before = leaves.len();
        let mut is_whole = true;
        if levels > 0 && (potential > self.least || side.is_longer(&element.corners, self.longest)) {
            let mut children = Vec::with_capacity(4);
            side.split(&element, self.tolerance, &mut children);
            for child in children {
                is_whole &= self.refine(child, levels - 1, leaves);
            }
            is_whole &= is_even;
            if is_whole {
                leaves.truncate(before);
            }
        }
        if is_whole && top.max(element.around) > 0.0 {
            leaves.push(element);
        }
        is_whole && is_even
    }

    /// The same as Kopylov prints it: an element is a leaf when its middle has the mean of its corners, or when it is too small.
    fn refine_as_printed(&self, cut: Cut, levels: u32, leaves: &mut Vec<LightElement>) {
        let Cut { element, potential } = cut;
        let is_small = potential <= self.least && !self.side.is_longer(&element.corners, self.longest);
        if levels == 0 || is_small || element.is_linear(self.tolerance) {
            if element.top().max(element.around) > 0.0 {
                leaves.push(element);
            }
            return;
        }
        let mut children = Vec::with_capacity(4);
        self.side.split_as_printed(&element, &mut children);
        for child in children {
            self.refine_as_printed(child, levels - 1, leaves);
        }
    }
}

/// What is needed of a triangle for each light.
#[derive(Clone, Copy)]
struct Whole {
    area: f32,
    longest_squared: f32,
    /// Mean share of the light that goes on.
    onward: Vec3,
}

impl Whole {
    fn new(scene: &Scene, triangle: usize) -> Self {
        let t = &scene.geometry.triangles[triangle];
        let area = 0.5 * t.edge_a.cross(t.edge_b).length();
        let third = (t.edge_b - t.edge_a).length_squared();
        let longest_squared = t.edge_a.length_squared().max(t.edge_b.length_squared()).max(third);
        let middle = t.corner + (t.edge_a + t.edge_b) / 3.0;
        let onward = if area > 0.0 { mean_onward(scene, triangle as u32, middle, area) } else { Vec3::ZERO };
        Self { area, longest_squared, onward }
    }
}

/// Small triangles that follow each other in the hierarchy, of one side to one light.
#[derive(Default)]
struct Group {
    /// Triangles, and the light on them, were nothing in the way.
    members: Vec<(u32, f32)>,
    /// Sums of power up to each member.
    power: Vec<f32>,
    /// Share of the shadow rays that reach the light.
    seen: f32,
}

impl Group {
    fn add(&mut self, member: (u32, f32), power: f32) {
        self.power.push(power + self.power.last().copied().unwrap_or(0.0));
        self.members.push(member);
    }

    fn is_full(&self, least: f32, neighbours: u32) -> bool {
        self.members.len() >= neighbours as usize || self.power.last().is_some_and(|&power| power >= least)
    }

    /// Asks the members in the middles of equal shares of the power; `last` is what was in the way of a group before.
    fn look(&mut self, scene: &Scene, light: u32, last: &Cell<Occluder>, rays: &Cell<u64>) {
        let all = self.power.last().copied().unwrap_or(0.0);
        let is_seen = |member: usize| {
            Side::new(scene, self.members[member].0, light).is_some_and(|side| {
                side.last.swap(last);
                let is_seen = side.light_at(Vec2::splat(1.0 / 3.0)) > 0.0;
                side.last.swap(last);
                rays.set(rays.get() + side.rays.get());
                is_seen
            })
        };
        let asked = |k: usize| {
            let at = (k as f32 + 0.5) / LOOKS as f32 * all;
            self.power.partition_point(|&power| power < at).min(self.members.len() - 1)
        };
        self.seen = (0..LOOKS).filter(|&k| is_seen(asked(k))).count() as f32 / LOOKS as f32;
    }
}

/// Finds the elements of one light on a block of triangles.
struct Search<'a> {
    scene: &'a Scene,
    settings: LightElementSettings,
    wholes: &'a [Whole],
    /// Light in the middle of each triangle, were nothing in the way, light by light; negative where it falls on the back.
    open: &'a [f32],
    lights: &'a [u32],
    /// Least power that matters, W.
    least: f32,
}

impl Search<'_> {
    /// Elements of light `n` on a block.
    fn elements(&self, n: usize, block: Range<usize>) -> LightElements {
        let Self { scene, settings, wholes, least, .. } = *self;
        let (light, longest) = (self.lights[n], settings.longest * scene.diagonal());
        let color = scene.lighting.lights[light as usize].color;
        let mut large = Vec::new();
        let mut groups = [const { Vec::<Group>::new() }; 2];
        for t in block {
            let whole = &wholes[t];
            let (reflected, open) = (luminance(whole.onward * color), self.open[t * self.lights.len() + n]);
            let power = reflected * whole.area * open.abs();
            if reflected <= 0.0 || whole.area <= 0.0 {
                continue;
            }
            if settings.neighbours < 2 || power > least || whole.longest_squared > longest * longest {
                large.extend(Side::new(scene, t as u32, light).map(|side| (side, whole.onward, least / reflected)));
            } else if power > 0.0 {
                let groups = &mut groups[usize::from(open < 0.0)];
                if groups.last().is_none_or(|group| group.is_full(least, settings.neighbours)) {
                    groups.push(Group::default());
                }
                groups.last_mut().into_iter().for_each(|group| group.add((t as u32, open.abs()), power));
            }
        }
        let refined = |(side, onward, least): (Side, Vec3, f32)| {
            let mut leaves = Vec::new();
            let refining = Refining { side: &side, tolerance: settings.tolerance, least, longest };
            match settings.subdivision {
                Subdivision::Edges => {
                    refining.refine(side.whole(onward), settings.depth, &mut leaves);
                }
                Subdivision::Kopylov => refining.refine_as_printed(side.whole(onward), settings.depth, &mut leaves),
            }
            let of_texture = |leaf: &mut LightElement| leaf.onward = onward_of(scene, leaf);
            leaves.iter_mut().filter(|leaf| leaf.corners != WHOLE).for_each(of_texture);
            LightElements { elements: leaves, shadow_rays: side.rays.get() }
        };
        let LightElements { elements: mut found, mut shadow_rays } =
            LightElements::of(&large.into_par_iter().map(refined).collect::<Vec<_>>());
        for (is_back, mut groups) in [false, true].into_iter().zip(groups) {
            let last = Cell::default();
            let rays = Cell::default();
            groups.iter_mut().for_each(|group| group.look(scene, light, &last, &rays));
            shadow_rays += rays.get();
            let seen: Vec<f32> = groups.iter().map(|group| group.seen).collect();
            let at = |k: usize| seen.get(k).copied().unwrap_or(0.0);
            for (k, group) in groups.into_iter().enumerate() {
                let around = at(k.wrapping_sub(1)).max(at(k + 1));
                if group.seen.max(around) <= 0.0 {
                    continue;
                }
                for &(triangle, open) in &group.members {
                    let Whole { area, onward, .. } = wholes[triangle as usize];
                    let Some(side) = Side::new(scene, triangle, light) else { continue };
                    let values = WHOLE.map(|at| side.arrival(inwards(at)).1.share * group.seen);
                    let (middle, around) = (open * group.seen, open * around);
                    let seen = if group.seen > 0.0 { group.seen } else { 1.0 };
                    let corners = WHOLE;
                    found.push(LightElement {
                        triangle,
                        light,
                        is_back,
                        corners,
                        values,
                        middle,
                        around,
                        area,
                        onward,
                        seen,
                    });
                }
            }
        }
        found.sort_by_key(|element| element.triangle);
        LightElements { elements: found, shadow_rays }
    }
}

/// Mean share of the light that goes on from about `area` m² of a triangle.
fn mean_onward(scene: &Scene, triangle: u32, position: Vec3, area: f32) -> Vec3 {
    scene.filtered_albedo(triangle, position, area) + scene.tables().specular_share(triangle)
}

/// Mean share of the light that goes on from an element.
fn onward_of(scene: &Scene, element: &LightElement) -> Vec3 {
    let at = (element.corners[0] + element.corners[1] + element.corners[2]) / 3.0;
    let position = scene.tables().position(element.triangle, at.x, at.y);
    mean_onward(scene, element.triangle, position, element.area)
}

/// Light elements of a scene.
#[derive(Clone, Debug, Default)]
pub struct LightElements {
    /// The elements, light by light, in the order of the triangles.
    pub elements: Vec<LightElement>,
    /// Shadow rays that found them.
    pub shadow_rays: u64,
}

impl LightElements {
    /// Parts one after the other.
    fn of(parts: &[Self]) -> Self {
        let mut all = Self::default();
        for part in parts {
            all.elements.extend_from_slice(&part.elements);
            all.shadow_rays += part.shadow_rays;
        }
        all
    }
}

/// Direct light of point-like lights at the corners of triangles.
#[derive(Clone, Debug, Default)]
pub struct CornerLight {
    /// Irradiance of the three corners of each triangle, on the side that each light falls on, W/m².
    pub irradiance: Vec<[Vec3; 3]>,
    /// Shadow rays that found it.
    pub shadow_rays: u64,
}

/// Direct light of all point-like lights at the corners of all triangles, with nothing split: what a program without photons
/// finds, and what Kopylov compares the time of the table to.
pub fn corner_light(scene: &Scene) -> CornerLight {
    let lights = point_like_lights(scene);
    let of_triangle = |triangle: usize| {
        let mut irradiance = [Vec3::ZERO; 3];
        let mut rays = 0;
        for side in lights.iter().filter_map(|&light| Side::new(scene, triangle as u32, light)) {
            let color = scene.lighting.lights[side.light as usize].color;
            irradiance.iter_mut().zip(WHOLE).for_each(|(sum, at)| *sum += color * side.light_at_corner(at));
            rays += side.rays.get();
        }
        (irradiance, rays)
    };
    let (irradiance, rays): (Vec<[Vec3; 3]>, Vec<u64>) =
        (0..scene.geometry.triangles.len()).into_par_iter().map(of_triangle).unzip();
    CornerLight { irradiance, shadow_rays: rays.iter().sum() }
}

/// Lights that are not areas, and shine.
fn point_like_lights(scene: &Scene) -> Vec<u32> {
    let shines = |&k: &u32| {
        let light = &scene.lighting.lights[k as usize];
        light.kind != LIGHT_RECT && luminance(light.color) > 0.0
    };
    (0..scene.lighting.lights.len() as u32).filter(shines).collect()
}

/// The elements that each point-like light falls on, light by light, in the order of the triangles. Elements on which
/// all is dark are there only where light fell on the element that they were split from, or on neighbours.
///
/// As [`LightElementSettings::subdivision`] says, an element is split until the light in its middle is the mean of that at its corners; edges
/// of shadows are split down to the limits. Triangles that are small already share shadow rays with their neighbours.
///
/// # Errors
/// [`Error::Setting`], [`Error::Cancelled`].
pub fn light_elements(
    scene: &Scene,
    settings: &LightElementSettings,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<LightElements, Error> {
    let LightElementSettings { subdivision: _, tolerance, depth: _, elements, longest, neighbours } = *settings;
    check_setting("tolerance", f64::from(tolerance), "positive", tolerance > 0.0)?;
    check_setting("elements", f64::from(elements), "at least 1", elements > 0)?;
    check_setting("longest", f64::from(longest), "positive", longest > 0.0)?;
    check_setting("neighbours", f64::from(neighbours), "at least 1", neighbours > 0)?;
    let lights = point_like_lights(scene);
    let triangles = scene.geometry.triangles.len();
    let wholes: Vec<Whole> = (0..triangles).into_par_iter().map(|t| Whole::new(scene, t)).collect();

    // The power that there would be without shadows says what matters.
    let open = |t: usize| {
        let of = move |&light: &u32| {
            let share = |side: Side| side.arrival(Vec2::splat(1.0 / 3.0)).1.share * side.sign();
            Side::new(scene, t as u32, light).map_or(0.0, share)
        };
        lights.iter().map(of)
    };
    let open: Vec<f32> = (0..triangles).into_par_iter().flat_map_iter(open).collect();
    let power = |t: usize| -> f64 {
        let of = |(&light, open): (&u32, &f32)| {
            let reflected = luminance(wholes[t].onward * scene.lighting.lights[light as usize].color);
            f64::from(reflected * wholes[t].area * open.abs())
        };
        lights.iter().zip(&open[t * lights.len()..]).map(of).sum()
    };
    let powers: Vec<f64> = (0..triangles).into_par_iter().map(power).collect();
    let least = (powers.iter().sum::<f64>() / f64::from(elements)) as f32;

    let search = Search { scene, settings: *settings, wholes: &wholes, open: &open, lights: &lights, least };
    let blocks = triangles.div_ceil(BLOCK);
    let total = blocks * lights.len();
    let done = AtomicUsize::new(0);
    let task = |k: usize| {
        let first = k % blocks * BLOCK;
        let found = search.elements(k / blocks, first..(first + BLOCK).min(triangles));
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        if progress(done, total).is_break() { Err(Error::Cancelled { done, total }) } else { Ok(found) }
    };
    let found: Vec<LightElements> = (0..total).into_par_iter().map(task).collect::<Result<_, Error>>()?;
    Ok(LightElements::of(&found))
}
