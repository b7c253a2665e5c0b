//! Subdivision of one side of a triangle into light elements, step by step: what it has to know of shadows in a step is
//! asked together, by whoever traces.

use alloc::vec;
use alloc::vec::Vec;
use core::cell::Cell;
use core::mem;
use core::ops::Range;

use glam::Vec3;
use scene::{Ray, Scene};

use super::side::{Part, Places, Side, inwards, left, stopped_on_host};
use super::{LightElement, LightElementSettings, Subdivision, WHOLE};

/// Weight of an element's light on its dark parts.
const AROUND: f32 = 0.25;

/// When elements of a side are split.
#[derive(Clone, Copy)]
pub(super) struct Rule {
    pub settings: LightElementSettings,
    /// Least power of an element that matters, over what a white one reflects of the light's colour.
    pub least: f32,
    /// Longest edge, m.
    pub longest: f32,
}

/// Steps after which nothing is open: the whole triangle takes two, its corners and its middle, and so does each split
/// in a row; one as printed may ask for two edges more.
pub(super) fn most_steps(settings: &LightElementSettings) -> usize {
    let of_split = if settings.subdivision == Subdivision::Kopylov { 3 } else { 2 };
    2 + of_split * settings.depth as usize
}

/// An element, and those that it was cut into.
struct Node {
    element: LightElement,
    /// Number of splits in a row.
    levels: u32,
    children: Range<u32>,
}

/// Purpose of pending shadow rays.
enum Pending {
    /// The middle of an element.
    Middle(u32),
    /// A cut.
    Cut(Cut),
}

/// A cut of an element, or of nothing into the whole triangle, and the light that it has to know.
#[derive(Clone, Copy)]
struct Cut {
    node: Option<u32>,
    known: [f32; 3],
    count: usize,
    places: Places,
}

/// One side of a triangle, and the elements that it is split into.
pub(super) struct Refinement<'a> {
    side: Side<'a>,
    rule: Rule,
    onward: Vec3,
    nodes: Vec<Node>,
    pending: Vec<Pending>,
    /// Light at all places that are asked about, were nothing in the way.
    asked: Vec<f32>,
}

impl<'a> Refinement<'a> {
    /// Begins with the whole triangle; `onward` is the mean share of its light that goes on.
    pub fn new(side: Side<'a>, onward: Vec3, rule: Rule) -> Self {
        let whole = Cut { node: None, known: [0.0; 3], count: 0, places: Places::of(WHOLE) };
        Self { side, rule, onward, nodes: Vec::new(), pending: vec![Pending::Cut(whole)], asked: Vec::new() }
    }

    /// Returns true if nothing is open.
    pub fn is_done(&self) -> bool {
        self.pending.is_empty()
    }

    /// Asks the host's own hierarchy until nothing is open; gives the number of shadow rays.
    pub fn trace_on_host(&mut self, scene: &Scene) -> u64 {
        let last = Cell::default();
        let mut count = 0;
        while !self.is_done() {
            let rays = self.ask();
            self.answer(&mut stopped_on_host(scene, &rays, &last));
            count += rays.len() as u64;
        }
        count
    }

    /// The shadow rays of a step.
    pub fn ask(&mut self) -> Vec<Ray> {
        let Self { side, nodes, pending, asked, .. } = self;
        let mut rays = Vec::new();
        asked.clear();
        for pending in pending {
            match pending {
                Pending::Middle(node) => {
                    let corners = nodes[*node as usize].element.corners;
                    asked.push(side.look((corners[0] + corners[1] + corners[2]) / 3.0, &mut rays));
                }
                Pending::Cut(cut) => {
                    asked.extend(cut.places.as_slice().iter().map(|&at| side.look(inwards(at), &mut rays)));
                }
            }
        }
        rays
    }

    /// Takes what became of them, in their order.
    pub fn answer(&mut self, stopped: &mut impl Iterator<Item = bool>) {
        let asked = mem::take(&mut self.asked);
        let mut light = asked.iter().map(|&open| (open, left(open, stopped)));
        for pending in mem::take(&mut self.pending) {
            match pending {
                Pending::Middle(node) => {
                    let Some((open, light)) = light.next() else { return };
                    self.nodes[node as usize].element.middle = light;
                    if self.is_cut(node, open) {
                        let places = Places::default();
                        self.continue_with(Cut { node: Some(node), known: [0.0; 3], count: 0, places });
                    }
                }
                Pending::Cut(mut cut) => {
                    for _ in cut.places.as_slice() {
                        cut.known[cut.count] = light.next().map_or(0.0, |light| light.1);
                        cut.count += 1;
                    }
                    self.continue_with(cut);
                }
            }
        }
    }

    /// Returns true if an element is split whose middle has this light if unoccluded: where it matters, or is long; as
    /// printed only where its light is not linear, too.
    fn is_cut(&self, node: u32, open: f32) -> bool {
        let Node { element, levels, .. } = &self.nodes[node as usize];
        let Rule { settings, least, longest } = self.rule;
        // Power that it would reflect for each unit of the light's colour, were it white and nothing in the way of its
        // middle.
        let potential = element.area * open;
        let is_printed = settings.subdivision == Subdivision::Kopylov;
        *levels > 0
            && (potential > least || self.side.is_longer(&element.corners, longest))
            && !(is_printed && element.is_linear(settings.tolerance))
    }

    /// Asks for what a cut still has to know, or makes it.
    fn continue_with(&mut self, cut: Cut) {
        let Self { side, rule, onward, nodes, .. } = self;
        let known = &cut.known[..cut.count];
        let is_printed = rule.settings.subdivision == Subdivision::Kopylov;
        let first = nodes.len() as u32;
        let Some(node) = cut.node else {
            nodes.push(part(side, (WHOLE, cut.known), (rule.settings.depth, 0.0, *onward)));
            return self.pending.push(Pending::Middle(first));
        };
        let Node { element, levels, .. } = nodes[node as usize];
        let places = if is_printed { side.places_as_printed(&element, known) } else { side.places(&element, known) };
        if !places.as_slice().is_empty() {
            return self.pending.push(Pending::Cut(Cut { places, ..cut }));
        }
        let inherited = (levels - 1, AROUND * element.top(), element.onward);
        let mut add = |own: Part| nodes.push(part(side, own, inherited));
        if is_printed {
            side.split_as_printed(&element, known, &mut add);
        } else {
            side.split(&element, known, rule.settings.tolerance, &mut add);
        }
        let children = first..nodes.len() as u32;
        self.pending.extend(children.clone().map(Pending::Middle));
        nodes[node as usize].children = children;
    }

    /// The elements that are not split, with the mean share of the light that goes on from each part of the triangle.
    pub fn leaves(&self, onward: impl Fn(&LightElement) -> Vec3) -> Vec<LightElement> {
        let mut leaves = Vec::new();
        if !self.nodes.is_empty() {
            self.add_leaves(0, &mut leaves);
        }
        leaves.iter_mut().filter(|leaf| leaf.corners != WHOLE).for_each(|leaf| leaf.onward = onward(leaf));
        leaves
    }

    /// Adds the leaves of an element; whether that is the element as a whole, and its light is linear. One that matters
    /// was split to look for shadows, or for light, but stays whole where there are none; as printed nothing is joined
    /// again.
    fn add_leaves(&self, node: u32, leaves: &mut Vec<LightElement>) -> bool {
        let Node { element, children, .. } = &self.nodes[node as usize];
        let is_even = element.is_linear(self.rule.settings.tolerance);
        let before = leaves.len();
        let mut is_whole = true;
        for child in children.clone() {
            is_whole &= self.add_leaves(child, leaves);
        }
        if !children.is_empty() {
            is_whole &= is_even && self.rule.settings.subdivision == Subdivision::Edges;
        }
        if is_whole {
            leaves.truncate(before);
            if element.top().max(element.around) > 0.0 {
                leaves.push(*element);
            }
        }
        is_whole && is_even
    }
}

/// A part of a side, whose middle is to be looked at, with what it has of the one that it is cut from: how often it may
/// be split, light around, and the share that goes on.
fn part(side: &Side, (corners, values): Part, (levels, around, onward): (u32, f32, Vec3)) -> Node {
    let share = (corners[1] - corners[0]).perp_dot(corners[2] - corners[0]).abs();
    let triangle = side.triangle;
    let light = side.light;
    let is_back = side.is_back();
    let area = share * side.area;
    let middle = 0.0;
    let seen = 1.0;
    let element = LightElement { triangle, light, is_back, corners, values, middle, around, area, onward, seen };
    Node { element, levels, children: 0..0 }
}
