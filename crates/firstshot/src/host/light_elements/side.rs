//! The light of one lamp on one side of a triangle, and what elements of it are cut into.

use alloc::vec::Vec;
use core::cell::Cell;

use glam::{Vec2, Vec3};
use scene::kernel::light::{Arrival, unoccluded};
use scene::{Occluder, Ray, Scene};

use super::LightElement;
use crate::kernel::start::share_left;

/// Corners are moved to the middle of their triangle by this share: on the very edge a neighbour would shade them.
const INWARDS: f32 = 1e-3;

/// A place a little nearer to the middle of the triangle.
#[inline]
pub(super) fn inwards(at: Vec2) -> Vec2 {
    at + (Vec2::splat(1.0 / 3.0) - at) * INWARDS
}

/// Light at a place, which is `open` if unoccluded, after the ray that [`Side::look`] may have made for it.
#[inline]
pub(super) fn left(open: f32, stopped: &mut impl Iterator<Item = bool>) -> f32 {
    if open > 0.0 && stopped.next() == Some(false) { open } else { 0.0 }
}

/// Occlusion of each ray, by the host's own hierarchy, when it is asked for; `last` is the occluder of the one before,
/// which is asked first.
pub(super) fn stopped_on_host(scene: &Scene, rays: &[Ray], last: &Cell<Occluder>) -> impl Iterator<Item = bool> {
    rays.iter().map(|ray| scene.occluded_again(ray.origin, ray.direction, ray.t_max, last))
}

/// Corners of an element, and the light at them over the light's colour.
pub(super) type Part = ([Vec2; 3], [f32; 3]);

/// Places whose light a cut has to know.
#[derive(Clone, Copy, Default)]
pub(super) struct Places {
    at: [Vec2; 3],
    count: usize,
}

impl Places {
    pub fn of<const N: usize>(places: [Vec2; N]) -> Self {
        let mut at = [Vec2::ZERO; 3];
        at[..N].copy_from_slice(&places);
        Self { at, count: N }
    }

    pub fn as_slice(&self) -> &[Vec2] {
        &self.at[..self.count]
    }
}

/// Light of one lamp at places of one side of a triangle.
pub(super) struct Side<'a> {
    scene: &'a Scene,
    pub triangle: u32,
    pub light: u32,
    normal: Vec3,
    edges: (Vec3, Vec3),
    pub area: f32,
}

impl<'a> Side<'a> {
    /// The side that the light is on; nothing for triangles without area, and for lights in their plane.
    pub fn new(scene: &'a Scene, triangle: u32, light: u32) -> Option<Self> {
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
            Self { scene, triangle, light, normal, edges: (t.edge_a, t.edge_b), area }
        })
    }

    /// 1 on the front, −1 on the back.
    pub fn sign(&self) -> f32 {
        if self.is_back() { -1.0 } else { 1.0 }
    }

    pub fn is_back(&self) -> bool {
        self.scene.tables().normal(self.triangle).dot(self.normal) < 0.0
    }

    /// Start of a ray from shares (u, v), and the light there if unoccluded, attenuated by the medium alone: luminance,
    /// where a medium parts colours.
    #[inline]
    pub fn arrival(&self, at: Vec2) -> (Vec3, Arrival) {
        let origin =
            self.scene.tables().position(self.triangle, at.x, at.y) + self.normal * self.scene.geometry.ray_offset;
        let lighting = &self.scene.lighting;
        let light = &lighting.lights[self.light as usize];
        let mut arrival = unoccluded(light, &lighting.distributions, origin, self.normal);
        if self.scene.has_medium() {
            arrival.share *= share_left(light.color, self.scene.transmittance(arrival.distance()));
        }
        (origin, arrival)
    }

    /// Irradiance over the light's colour at shares (u, v), were nothing but the medium in the way; where there is any,
    /// a shadow ray is added.
    #[inline]
    pub fn look(&self, at: Vec2, rays: &mut Vec<Ray>) -> f32 {
        let (origin, arrival) = self.arrival(at);
        if arrival.share > 0.0 {
            rays.push(Ray { origin, t_max: arrival.t_max, direction: arrival.to_light, reserved: 0 });
        }
        arrival.share
    }

    /// Squared lengths of the edges opposite to the corners, m².
    fn edges_squared(&self, c: &[Vec2; 3]) -> [f32; 3] {
        let edge = |a: Vec2, b: Vec2| ((b.x - a.x) * self.edges.0 + (b.y - a.y) * self.edges.1).length_squared();
        [edge(c[1], c[2]), edge(c[2], c[0]), edge(c[0], c[1])]
    }

    pub fn is_longer(&self, corners: &[Vec2; 3], longest: f32) -> bool {
        self.edges_squared(corners).iter().any(|&squared| squared > longest * longest)
    }

    /// The corner opposite to the longest edge of an element, and whether the element is obtuse.
    fn widest_corner(&self, c: &[Vec2; 3]) -> (usize, bool) {
        let squared = self.edges_squared(c);
        let longest = (0..3).max_by(|&a, &b| squared[a].total_cmp(&squared[b])).unwrap_or(0);
        (longest, squared[longest] > 1.0001 * (squared[(longest + 1) % 3] + squared[(longest + 2) % 3]))
    }

    /// Places where [`Side::split`] needs the light: the middle of the longest edge of an obtuse element, else the
    /// middles of all edges; nothing once it knows.
    pub fn places(&self, element: &LightElement, known: &[f32]) -> Places {
        let c = element.corners;
        match (known, self.widest_corner(&c)) {
            ([], (longest, true)) => Places::of([half(&c, longest)]),
            ([], _) => Places::of([half(&c, 0), half(&c, 1), half(&c, 2)]),
            _ => Places::default(),
        }
    }

    /// Two, three or four parts: an obtuse element is cut across its longest edge, another across those of its
    /// edges on which light is not linear; across all where that is so in its middle only. `known` is the light at
    /// [`Side::places`].
    pub fn split(&self, element: &LightElement, known: &[f32], tolerance: f32, add: &mut impl FnMut(Part)) {
        let c = element.corners;
        let v = element.values;
        // The two parts of a cut across the edge opposite to corner k.
        let mut in_two = |k: usize, at: Vec2, value: f32| {
            let a = (k + 1) % 3;
            let b = (k + 2) % 3;
            add(([c[k], c[a], at], [v[k], v[a], value]));
            add(([c[k], at, c[b]], [v[k], value, v[b]]));
        };
        let &[first, second, third] = known else {
            let longest = self.widest_corner(&c).0;
            return in_two(longest, half(&c, longest), known[0]);
        };
        let at = [half(&c, 0), half(&c, 1), half(&c, 2)];
        let value = [first, second, third];
        let top = element.top();
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
                let a = (corner + 1) % 3;
                let b = (corner + 2) % 3;
                // Edge opposite to b runs from the corner to a.
                let p = b;
                let q = a;
                add(([c[corner], at[p], at[q]], [v[corner], value[p], value[q]]));
                let first = self.edges_squared(&[at[p], c[b], c[b]])[2];
                let second = self.edges_squared(&[c[a], at[q], at[q]])[2];
                if first < second {
                    add(([at[p], c[a], c[b]], [value[p], v[a], v[b]]));
                    add(([at[p], c[b], at[q]], [value[p], v[b], value[q]]));
                } else {
                    add(([at[p], c[a], at[q]], [value[p], v[a], value[q]]));
                    add(([c[a], c[b], at[q]], [v[a], v[b], value[q]]));
                }
            }
            _ => {
                for k in 0..3 {
                    let a = (k + 1) % 3;
                    let b = (k + 2) % 3;
                    add(([c[k], at[b], at[a]], [v[k], value[b], value[a]]));
                }
                add((at, value));
            }
        }
    }

    /// The corner of an element with an obtuse angle, by Kopylov.
    fn obtuse_corner(&self, c: &[Vec2; 3]) -> Option<usize> {
        let squared = self.edges_squared(c);
        (0..3).find(|&k| squared[k] > squared[(k + 1) % 3] + squared[(k + 2) % 3])
    }

    /// Places where [`Side::split_as_printed`] needs the light beyond what is `known`: of an obtuse element first the
    /// middle of its longest edge, then, where light bends more along both cuts than in the middle, those of the other
    /// two.
    pub fn places_as_printed(&self, element: &LightElement, known: &[f32]) -> Places {
        let c = element.corners;
        let v = element.values;
        let Some(a) = self.obtuse_corner(&c) else { return Places::default() };
        let b = (a + 1) % 3;
        let end = (a + 2) % 3;
        match *known {
            [] => Places::of([half(&c, a)]),
            [light_e] => {
                let in_middle = (element.middle - element.mean()).abs();
                let along_edge = (light_e - 0.5 * (v[b] + v[end])).abs();
                let along_cut = (element.middle - 0.5 * (v[a] + light_e)).abs();
                let bends = along_edge > in_middle && along_cut > in_middle;
                if bends { Places::of([half(&c, end), half(&c, b)]) } else { Places::default() }
            }
            _ => Places::default(),
        }
    }

    /// The parts of an element by Kopylov's algorithm 1, two, three or four. `known` is the light at
    /// [`Side::places_as_printed`].
    pub fn split_as_printed(&self, element: &LightElement, known: &[f32], add: &mut impl FnMut(Part)) {
        let c = element.corners;
        let v = element.values;
        // A is the corner with the obtuse angle, of the longest edge BC.
        let Some(a) = self.obtuse_corner(&c) else {
            let d = (c[0] + c[1] + c[2]) / 3.0;
            (0..3).for_each(|k| add(([c[k], c[(k + 1) % 3], d], [v[k], v[(k + 1) % 3], element.middle])));
            return;
        };
        let b = (a + 1) % 3;
        let end = (a + 2) % 3;
        let e = half(&c, a);
        let light_e = known[0];
        if let [_, light_f, light_g] = *known {
            let f = half(&c, end);
            let g = half(&c, b);
            add(([c[a], f, g], [v[a], light_f, light_g]));
            add(([c[b], e, f], [v[b], light_e, light_f]));
            add(([c[end], g, e], [v[end], light_g, light_e]));
            add(([f, e, g], [light_f, light_e, light_g]));
        } else {
            add(([c[a], c[b], e], [v[a], v[b], light_e]));
            add(([c[a], e, c[end]], [v[a], light_e, v[end]]));
        }
    }
}

/// The middle of the edge opposite to a corner.
#[inline]
fn half(c: &[Vec2; 3], corner: usize) -> Vec2 {
    (c[(corner + 1) % 3] + c[(corner + 2) % 3]) * 0.5
}
