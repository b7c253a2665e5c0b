//! Adaptive direct illumination: each triangle that a light may fall on is split into light elements until the light
//! is linear on each.

mod refinement;
mod side;

use alloc::vec::Vec;
use core::cell::Cell;
use core::sync::atomic::{AtomicUsize, Ordering};

use glam::{Vec2, Vec3};
use scene::gpu::LIGHT_RECT;
use scene::math::luminance;
use scene::parallel::*;
use scene::{Ray, Scene};

use self::refinement::{Refinement, Rule};
use self::side::{Side, inwards, left, stopped_on_host};
use super::Proceed;
use crate::error::{Error, check_length, check_setting};

/// Triangles of one step of progress.
const BLOCK: usize = 256;
/// Shadow rays that neighbours share.
const LOOKS: usize = 4;

/// Subdivision of triangles into light elements.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Subdivision {
    /// Across the edges on which light bends. Elements that matter are split to look for shadows, and joined again
    /// where there are none.
    #[default]
    Edges,
    /// Algorithm 1 as Kopylov prints it: an element whose middle has the mean of its corners is not split. Without an
    /// obtuse angle it is split into three at its middle; else at the middle of its longest edge, into two, or into
    /// four at those of all edges where light bends more along both cuts than in the middle.
    Kopylov,
}

/// Settings of light elements on triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightElementSettings {
    /// Subdivision of triangles.
    pub subdivision: Subdivision,
    /// An element is split unless the light in its middle is the mean of that at its corners, within this share of
    /// the greatest.
    pub tolerance: f32,
    /// Most splits of a triangle in a row.
    pub depth: u32,
    /// Nothing with less than one over this of the power that all lights would have, were nothing in the way, is looked
    /// at more closely: at most a few times as many shadow rays.
    pub elements: u32,
    /// Longest edge that is not split, dark or not: what is smaller may be missed. A share of the scene's diagonal.
    pub longest: f32,
    /// Most triangles with less than that power that share four shadow rays with their neighbours in the hierarchy;
    /// with 1 each has four of its own.
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

    /// Settings of the split of Kopylov's algorithm 1: twice as many splits in a row, of which every other one halves
    /// edges.
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
    /// True if it lies on the back.
    pub is_back: bool,
    /// Corners as shares (u, v) of the triangle's edges.
    pub corners: [Vec2; 3],
    /// Irradiance over the light's colour at the corners.
    pub values: [f32; 3],
    /// Value in the middle.
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

/// Per-light data of a triangle.
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
    /// Light where it is asked about, were nothing in the way.
    asked: [f32; LOOKS],
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

    /// Asks about the members in the middles of equal shares of the power.
    fn ask(&mut self, scene: &Scene, light: u32, rays: &mut Vec<Ray>) {
        let all = self.power.last().copied().unwrap_or(0.0);
        for (k, open) in self.asked.iter_mut().enumerate() {
            let at = (k as f32 + 0.5) / LOOKS as f32 * all;
            let member = self.power.partition_point(|&power| power < at).min(self.members.len() - 1);
            let side = Side::new(scene, self.members[member].0, light);
            *open = side.map_or(0.0, |side| side.look(Vec2::splat(1.0 / 3.0), rays));
        }
    }

    /// Takes what became of these rays.
    fn answer(&mut self, stopped: &mut impl Iterator<Item = bool>) {
        let lit = self.asked.iter().filter(|&&open| left(open, stopped) > 0.0).count();
        self.seen = lit as f32 / LOOKS as f32;
    }
}

/// State before the first shadow ray.
struct Search<'a> {
    scene: &'a Scene,
    settings: LightElementSettings,
    wholes: Vec<Whole>,
    /// Light in the middle of each triangle, were nothing in the way, light by light; negative where it falls on the
    /// back.
    open: Vec<f32>,
    lights: Vec<u32>,
    /// Least power that matters, W.
    least: f32,
}

impl<'a> Search<'a> {
    fn new(scene: &'a Scene, settings: &LightElementSettings) -> Result<Self, Error> {
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
                Side::new(scene, t as u32, light)
                    .map_or(0.0, |side| side.arrival(Vec2::splat(1.0 / 3.0)).1.share * side.sign())
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
        Ok(Self { scene, settings: *settings, wholes, open, lights, least })
    }

    /// Blocks of triangles, once for each light.
    fn blocks(&self) -> usize {
        self.wholes.len().div_ceil(BLOCK) * self.lights.len()
    }

    /// The triangles of block `k` that its light may fall on.
    fn block(&self, k: usize) -> Block<'_> {
        let Self { scene, settings, wholes, least, .. } = self;
        let n = k / wholes.len().div_ceil(BLOCK);
        let first = k % wholes.len().div_ceil(BLOCK) * BLOCK;
        let light = self.lights[n];
        let longest = settings.longest * scene.diagonal();
        let color = scene.lighting.lights[light as usize].color;
        let mut large = Vec::new();
        let mut groups = [const { Vec::<Group>::new() }; 2];
        for (t, whole) in (first..).zip(&wholes[first..wholes.len().min(first + BLOCK)]) {
            let reflected = luminance(whole.onward * color);
            let open = self.open[t * self.lights.len() + n];
            let power = reflected * whole.area * open.abs();
            if reflected <= 0.0 || whole.area <= 0.0 {
                continue;
            }
            if settings.neighbours < 2 || power > *least || whole.longest_squared > longest * longest {
                let rule = Rule { settings: *settings, least: least / reflected, longest };
                large.extend(Side::new(scene, t as u32, light).map(|side| Refinement::new(side, whole.onward, rule)));
            } else if power > 0.0 {
                let groups = &mut groups[usize::from(open < 0.0)];
                if groups.last().is_none_or(|group| group.is_full(*least, settings.neighbours)) {
                    groups.push(Group::default());
                }
                groups.last_mut().into_iter().for_each(|group| group.add((t as u32, open.abs()), power));
            }
        }
        Block { scene, wholes, light, large, groups, shadow_rays: 0 }
    }
}

/// Triangles that follow each other in the hierarchy, under one light.
struct Block<'a> {
    scene: &'a Scene,
    wholes: &'a [Whole],
    light: u32,
    /// Those that are refined.
    large: Vec<Refinement<'a>>,
    /// Those that share shadow rays, on the front and on the back.
    groups: [Vec<Group>; 2],
    /// Shadow rays so far.
    shadow_rays: u64,
}

impl Block<'_> {
    /// Asks the host's own hierarchy until nothing is open.
    fn trace_on_host(&mut self) {
        let Self { scene, light, .. } = *self;
        self.shadow_rays += self.large.par_iter_mut().map(|large| large.trace_on_host(scene)).sum::<u64>();
        let mut rays = Vec::new();
        for groups in &mut self.groups {
            // What was in the way of a group before is asked first.
            let last = Cell::default();
            for group in groups {
                rays.clear();
                group.ask(scene, light, &mut rays);
                group.answer(&mut stopped_on_host(scene, &rays, &last));
                self.shadow_rays += rays.len() as u64;
            }
        }
    }

    /// The shadow rays of step `step`: groups ask in the first one only.
    fn ask(&mut self, step: usize) -> Vec<Ray> {
        let mut rays: Vec<Ray> = self.large.par_iter_mut().map(Refinement::ask).collect::<Vec<_>>().concat();
        if step == 0 {
            for group in self.groups.iter_mut().flatten() {
                group.ask(self.scene, self.light, &mut rays);
            }
        }
        self.shadow_rays += rays.len() as u64;
        rays
    }

    /// Takes what became of them, in their order.
    fn answer(&mut self, step: usize, stopped: &[u32]) {
        let mut stopped = stopped.iter().map(|&stopped| stopped != 0);
        self.large.iter_mut().for_each(|large| large.answer(&mut stopped));
        if step == 0 {
            self.groups.iter_mut().flatten().for_each(|group| group.answer(&mut stopped));
        }
    }

    fn is_done(&self) -> bool {
        self.large.iter().all(Refinement::is_done)
    }

    /// The elements, in the order of the triangles.
    fn elements(self) -> LightElements {
        let Self { scene, wholes, light, large, groups, shadow_rays } = self;
        let leaves = large.into_par_iter().map(|large| large.leaves(|leaf| onward_of(scene, leaf)));
        let mut found = leaves.collect::<Vec<Vec<LightElement>>>().concat();
        for (is_back, groups) in [false, true].into_iter().zip(groups) {
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
                    let middle = open * group.seen;
                    let around = open * around;
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

/// Direct light of all point-like lights at the corners of all triangles, with nothing split: what a program without
/// photons finds, and what Kopylov compares the time of the table to.
pub fn corner_light(scene: &Scene) -> CornerLight {
    let lights = point_like_lights(scene);
    let of_triangle = |triangle: usize| {
        let mut irradiance = [Vec3::ZERO; 3];
        let mut count = 0;
        for side in lights.iter().filter_map(|&light| Side::new(scene, triangle as u32, light)) {
            let color = scene.lighting.lights[side.light as usize].color;
            let mut rays = Vec::with_capacity(3);
            let open = WHOLE.map(|at| side.look(inwards(at), &mut rays));
            let last = Cell::default();
            let mut stopped = stopped_on_host(scene, &rays, &last);
            irradiance.iter_mut().zip(open).for_each(|(sum, open)| *sum += color * left(open, &mut stopped));
            count += rays.len() as u64;
        }
        (irradiance, count)
    };
    let (irradiance, rays): (Vec<[Vec3; 3]>, Vec<u64>) =
        (0..scene.geometry.triangles.len()).into_par_iter().map(of_triangle).unzip();
    CornerLight { irradiance, shadow_rays: rays.iter().sum() }
}

/// Lights that are not areas, and shine.
fn point_like_lights(scene: &Scene) -> Vec<u32> {
    (0..scene.lighting.lights.len() as u32)
        .filter(|&k| {
            let light = &scene.lighting.lights[k as usize];
            light.kind != LIGHT_RECT && luminance(light.color) > 0.0
        })
        .collect()
}

/// The elements that each point-like light falls on, light by light, in the order of the triangles. Elements on which
/// all is dark are there only where light fell on the element that they were split from, or on neighbours.
///
/// As [`LightElementSettings::subdivision`] says, an element is split until the light in its middle is the mean of that
/// at its corners; edges of shadows are split down to the limits. Triangles that are small already share shadow rays
/// with their neighbours.
///
/// # Errors
/// [`Error::Setting`], [`Error::Cancelled`].
pub fn light_elements(
    scene: &Scene,
    settings: &LightElementSettings,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<LightElements, Error> {
    let search = Search::new(scene, settings)?;
    let total = search.blocks();
    let done = AtomicUsize::new(0);
    let task = |k: usize| {
        let mut block = search.block(k);
        block.trace_on_host();
        let found = block.elements();
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        if progress(done, total).is_break() { Err(Error::Cancelled { done, total }) } else { Ok(found) }
    };
    let found: Vec<LightElements> = (0..total).into_par_iter().map(task).collect::<Result<_, Error>>()?;
    Ok(LightElements::of(&found))
}

/// Says of each ray whether something stops it, 1, or not, 0.
pub type TraceRays<'a, E> = dyn FnMut(&[Ray]) -> Result<Vec<u32>, E> + 'a;

/// [`light_elements`] with shadow rays that are traced by somebody else, on a GPU perhaps. All triangles and lights ask
/// together, in two steps for every split in a row, at most three as printed, and two before them; the same answers
/// make the same elements.
///
/// # Errors
/// As [`light_elements`]; what `trace` gives; [`Error::Length`] where it gives another number of answers.
pub fn light_elements_by<E: From<Error>>(
    trace: &mut TraceRays<E>,
    scene: &Scene,
    settings: &LightElementSettings,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<LightElements, E> {
    let search = Search::new(scene, settings)?;
    let mut blocks: Vec<Block> = (0..search.blocks()).into_par_iter().map(|k| search.block(k)).collect();
    let total = refinement::most_steps(settings);
    for step in 0.. {
        let asked: Vec<Vec<Ray>> = blocks.par_iter_mut().map(|block| block.ask(step)).collect();
        let rays = asked.concat();
        let stopped = if rays.is_empty() { Vec::new() } else { trace(&rays)? };
        check_length("stopped", rays.len(), stopped.len())?;
        let mut first = 0;
        let mut answers: Vec<&[u32]> = Vec::with_capacity(blocks.len());
        for asked in &asked {
            answers.push(&stopped[first..first + asked.len()]);
            first += asked.len();
        }
        blocks.par_iter_mut().zip(answers).for_each(|(block, stopped)| block.answer(step, stopped));
        let done = (step + 1).min(total);
        if progress(done, total).is_break() {
            return Err(Error::Cancelled { done, total }.into());
        }
        if blocks.par_iter().all(Block::is_done) {
            break;
        }
    }
    let found: Vec<LightElements> = blocks.into_par_iter().map(Block::elements).collect();
    Ok(LightElements::of(&found))
}
