//! Patches of voxels, by axis, and the forest of what is merged of them.

use std::collections::HashMap;

use glam::{UVec3, Vec3};
use localmatrix::{LitPoint, NO_NODE, Node};
use patches::{
    Density, Grid, GridShape, LookupPatch, PatchSet, SampleSet, SampleSettings, axis_patches, lit_sampler,
    sample_voxels,
};
use rayon::prelude::*;
use scene::sampling::{cosine_hemisphere, hammersley, hash3, uniform_triangle, unit};
use scene::{NONE, Scene};

use super::bake::{POINTS, WorldSettings, check_memory};
use crate::error::{Error, Reason};
use crate::observe::{Report, run_phase};
use transport::{Observer, Phase};

/// Patches of a bake.
pub const MIN_PATCHES: usize = 100;
/// Upper bound of the number of patches.
pub const MAX_PATCHES: usize = 4_000_000;

/// Rays from each face of a voxel: 16 meet enough of what is in it, and there are many voxels.
const FACE_RAYS: u32 = 16;
/// Voxels that are sampled before their samples are dropped.
const VOXELS_AT_ONCE: usize = 2048;
/// Probe samples of the reachability test, as for so many patches.
const PROBE_SAMPLES_FOR: usize = 10_000;
/// Trees of the forest, about: what cannot be coarser.
const ROOTS: usize = 256;
const MAX_LEVELS: u32 = 10;
/// Points at which an emitter is shared out over the patches, at least and for each voxel's face of its area.
const EMITTER_POINTS: u32 = 16;
const MAX_EMITTER_POINTS: f32 = 4096.0;
/// A patch serves an axis with a greater cosine than this.
const SERVES: f32 = 0.2;
/// Rays of a patch that look for the sky, and the share of them that finds it outdoors.
const SKY_RAYS: u32 = 64;
const MIN_SKY: f32 = 0.08;
/// The bit of a voxel's word in a file that says indoors.
const INDOORS: u32 = 1 << 31;
/// Reflectance at most: T has no end at 1.
const MAX_ALBEDO: f32 = 0.98;

/// A place that no light comes to, for lookups only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DarkPatch {
    /// Its voxel.
    pub voxel: u32,
    /// Mean position, m.
    pub position: Vec3,
    /// Mean normal.
    pub normal: Vec3,
}

/// Data of a bake beside nodes and rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Extra {
    /// The voxels.
    pub shape: GridShape,
    /// Voxel of each leaf.
    pub voxels: Vec<u32>,
    /// Marks leaves that see next to nothing of the sky: what is indoors and what is not are merged separately.
    pub indoors: Vec<bool>,
    /// Emitted exitance of leaves that shine, W/m².
    pub emission: Vec<(u32, Vec3)>,
    /// Patches without light.
    pub dark: Vec<DarkPatch>,
}

/// The patches of a scene, and what is merged of them.
pub struct Forest {
    /// Leaves first.
    pub nodes: Vec<Node>,
    /// Further data of the bake.
    pub extra: Extra,
    /// Points of leaf i: `points[offsets[i]..offsets[i + 1]]`.
    pub points: Vec<LitPoint>,
    /// Start of each.
    pub offsets: Vec<u32>,
    owner: HashMap<u32, [u32; 6]>,
}

/// A patch on its way to become a leaf.
struct Draft {
    key: u64,
    voxel: u32,
    indoors: bool,
    node: Node,
    points: Vec<LitPoint>,
}

/// Which of ±x, ±y, ±z a normal is nearest to.
fn axis_of(normal: Vec3) -> usize {
    let axis = (0..3).max_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs())).unwrap_or(0);
    2 * axis + usize::from(normal[axis] < 0.0)
}

fn axis_cosine(normal: Vec3, axis: usize) -> f32 {
    if axis.is_multiple_of(2) { normal[axis / 2] } else { -normal[axis / 2] }
}

impl Forest {
    /// Makes the patches of a scene.
    ///
    /// # Errors
    /// Voxels that are too many, a scene that no light comes to, more memory than allowed, cancellation.
    pub fn new(
        scene: &Scene,
        settings: &WorldSettings,
        memory_limit: u64,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        check_memory("the scene", memory_limit)?;
        let grid = run_phase(observer, Phase::GRID, |_| find_grid(scene, settings))?;
        check_memory("voxels", memory_limit)?;
        let (drafts, dark) =
            run_phase(observer, Phase::PATCHES, |report| drafts(scene, &grid, settings, memory_limit, report))?;
        let shape = grid.shape;
        drop(grid);
        if drafts.len() > MAX_PATCHES {
            let name = "patches";
            let found = drafts.len() as u64;
            let limit = MAX_PATCHES as u64;
            return Err(Reason::TooManyVoxels { name, found, limit }.into());
        }
        let mut world = Self::assemble(shape, drafts, dark);
        world.extra.emission = world.share_out_emitters(scene);
        check_memory("patches", memory_limit)?;
        Ok(world)
    }

    /// Number of patches.
    pub fn leaves(&self) -> usize {
        self.extra.voxels.len()
    }

    /// Points of a leaf.
    pub fn points_of(&self, leaf: u32) -> &[LitPoint] {
        &self.points[self.offsets[leaf as usize] as usize..self.offsets[leaf as usize + 1] as usize]
    }

    /// Leaves in the order of their trees: first the block of voxels of a tree, then the axis, then those outdoors
    /// before those indoors, then Morton's order; so the children of a node follow each other on every level.
    fn assemble(shape: GridShape, mut drafts: Vec<Draft>, dark: Vec<DarkPatch>) -> Self {
        let levels = levels(&shape, &drafts);
        drafts.par_iter_mut().for_each(|d| d.key = key(&shape, d.voxel, axis_of(d.node.normal), d.indoors, levels));
        drafts.sort_by(|a, b| {
            a.key.cmp(&b.key).then(
                a.node.centre.to_array().partial_cmp(&b.node.centre.to_array()).unwrap_or(std::cmp::Ordering::Equal),
            )
        });
        let mut keys: Vec<u64> = drafts.iter().map(|d| d.key).collect();
        let voxels: Vec<u32> = drafts.iter().map(|d| d.voxel).collect();
        let indoors = drafts.iter().map(|d| d.indoors).collect();
        let mut nodes = Vec::with_capacity(2 * drafts.len());
        let mut points = Vec::new();
        let mut offsets = vec![0];
        for draft in drafts {
            nodes.push(draft.node);
            points.extend(draft.points);
            offsets.push(points.len() as u32);
        }
        let mut level = 0..nodes.len();
        for _ in 0..levels {
            let mut above = Vec::new();
            let mut first = level.start;
            while first < level.end {
                let parent = keys[first - level.start] >> 3;
                let count = keys[first - level.start..].iter().take_while(|&&key| key >> 3 == parent).count();
                let number = (level.end + above.len()) as u32;
                nodes[first..first + count].iter_mut().for_each(|child| child.parent = number);
                above.push(parent);
                let node = merged(&nodes[first..first + count], first as u32);
                nodes.push(node);
                first += count;
            }
            level = level.end..nodes.len();
            keys = above;
        }
        nodes.shrink_to_fit();
        let mut owner: HashMap<u32, [u32; 6]> = HashMap::new();
        for (leaf, voxel) in voxels.iter().enumerate() {
            let six = owner.entry(*voxel).or_insert([NONE; 6]);
            for (axis, place) in six.iter_mut().enumerate() {
                let cosine = axis_cosine(nodes[leaf].normal, axis);
                let before = if *place == NONE { SERVES } else { axis_cosine(nodes[*place as usize].normal, axis) };
                if cosine > before {
                    *place = leaf as u32;
                }
            }
        }
        Self { nodes, extra: Extra { shape, voxels, indoors, emission: Vec::new(), dark }, points, offsets, owner }
    }

    /// The leaf that owns a place on the side of a surface with this normal, or [`NONE`]: that of the voxel along an
    /// axis that is drawn with probability n², as samples are shared out, else along the others, the nearest first.
    pub fn owner(&self, position: Vec3, normal: Vec3) -> u32 {
        let shape = &self.extra.shape;
        let six = |p: Vec3| self.owner.get(&shape.voxel_at(shape.nearest_coordinates(p)));
        let lift = normal * (1e-3 * shape.edges.min_element());
        let Some(six) = six(position).or_else(|| six(position + lift)).or_else(|| six(position - lift)) else {
            return NONE;
        };
        let side = |axis: usize| 2 * axis + usize::from(normal[axis] < 0.0);
        let [x, y, z] = position.to_array().map(f32::to_bits);
        let drawn = unit(hash3(x, y, z));
        let squares = normal * normal;
        let first = if drawn < squares.x {
            0
        } else if drawn < squares.x + squares.y {
            1
        } else {
            2
        };
        if six[side(first)] != NONE {
            return six[side(first)];
        }
        let mut axes = [0, 1, 2];
        axes.sort_by(|&a, &b| squares[b].total_cmp(&squares[a]));
        // An axis that the surface hardly faces does not stand for it.
        axes.into_iter().filter(|&a| squares[a] > 0.05).map(|a| six[side(a)]).find(|&leaf| leaf != NONE).unwrap_or(NONE)
    }

    /// The power of each emissive triangle, shared out over the patches of its places, as their exitance.
    fn share_out_emitters(&self, scene: &Scene) -> Vec<(u32, Vec3)> {
        let geometry = scene.tables();
        let face = self.extra.shape.edges.x * self.extra.shape.edges.y;
        let mut power: HashMap<u32, Vec3> = HashMap::new();
        for e in scene.emitters.iter() {
            let wanted = (EMITTER_POINTS as f32 * e.area / face).min(MAX_EMITTER_POINTS);
            let count = (wanted as u32).max(EMITTER_POINTS);
            let normal = geometry.normal(e.triangle);
            for k in 0..count {
                let (u, v) = uniform_triangle(hammersley(k, count, (0, 0)));
                let leaf = self.owner(geometry.position(e.triangle, u, v), normal);
                if leaf != NONE && !geometry.is_hole(e.triangle, u, v) {
                    let exitance = geometry.radiance(e.triangle, u, v) * std::f32::consts::PI;
                    *power.entry(leaf).or_default() += exitance * (e.area / count as f32);
                }
            }
        }
        let mut emission: Vec<(u32, Vec3)> =
            power.into_iter().map(|(leaf, power)| (leaf, power / self.nodes[leaf as usize].area)).collect();
        emission.sort_unstable_by_key(|e| e.0);
        emission
    }
}

/// The grid that was asked for, or that of a power of two of a metre which gives nearest to the number of patches.
fn find_grid(scene: &Scene, settings: &WorldSettings) -> Result<Grid, Error> {
    let grid = |edge: f32| {
        Grid::new(scene, Vec3::splat(edge)).map_err(|error| match error {
            patches::Error::TooMany { name, found, limit } => Reason::TooManyVoxels { name, found, limit }.into(),
            error => error.into(),
        })
    };
    if let Some(edge) = settings.voxel_size {
        return grid(edge);
    }
    let area: f64 = scene.geometry.triangles.iter().map(|t| 0.5 * f64::from(t.edge_a.cross(t.edge_b).length())).sum();
    let target = settings.patch_count as f64;
    let mut exponent = (0.5 * (area / target).log2()).round() as i32;
    let (mut best, mut tried): (Option<(f64, Grid)>, Vec<i32>) = (None, Vec::new());
    for _ in 0..4 {
        if tried.contains(&exponent) {
            break;
        }
        tried.push(exponent);
        let found = match grid(2f32.powi(exponent)) {
            Ok(grid) => {
                let found = sides(scene, &grid) as f64;
                let distance = (found / target).ln().abs();
                if best.as_ref().is_none_or(|(least, _)| distance < *least) {
                    best = Some((distance, grid));
                }
                found
            }
            Err(error) if matches!(error.reason(), Reason::TooManyVoxels { .. }) => f64::INFINITY,
            Err(error) => return Err(error),
        };
        exponent += if found > target { 1 } else { -1 };
    }
    best.map(|found| found.1).ok_or(patches::Error::NoSamples.into())
}

/// Fronts of triangles by voxel and axis: about as many as there will be patches.
fn sides(scene: &Scene, grid: &Grid) -> usize {
    let geometry = scene.tables();
    let count = |slot: usize| {
        let bits = grid.clipped_triangles(slot).0.iter().fold(0u32, |bits, &t| bits | 1 << axis_of(geometry.normal(t)));
        bits.count_ones() as usize
    };
    (0..grid.len()).into_par_iter().map(count).sum()
}

/// Some voxels of a grid.
fn some_voxels(grid: &Grid, slots: std::ops::Range<usize>) -> Grid {
    let from = grid.offsets[slots.start];
    let to = grid.offsets[slots.end];
    let own = from as usize..to as usize;
    Grid {
        shape: grid.shape,
        occupied: grid.occupied[slots.clone()].to_vec(),
        offsets: grid.offsets[slots.start..=slots.end].iter().map(|k| k - from).collect(),
        triangles: grid.triangles[own.clone()].to_vec(),
        areas: grid.areas[own].to_vec(),
    }
}

/// The samples that light comes to, or those that none comes to.
fn only(set: &SampleSet, lit: &[bool], wanted: bool) -> SampleSet {
    let mut out = SampleSet { samples: Vec::new(), offsets: vec![0], report: set.report };
    for slot in 0..set.offsets.len() - 1 {
        out.samples.extend(set.range(slot).filter(|&k| lit[k] == wanted).map(|k| set.samples[k]));
        out.offsets.push(out.samples.len() as u32);
    }
    out
}

type Found = (Vec<Draft>, Vec<DarkPatch>);

fn drafts(
    scene: &Scene,
    grid: &Grid,
    settings: &WorldSettings,
    memory_limit: u64,
    report: &Report,
) -> Result<Found, Error> {
    let sampler =
        lit_sampler(scene, PROBE_SAMPLES_FOR, Density::default(), settings.seed)?.ok_or(patches::Error::NoSamples)?;
    let sampling = SampleSettings { points: FACE_RAYS, seed: settings.seed, ..SampleSettings::default() };
    let mut drafts = Vec::new();
    let mut dark = Vec::new();
    for first in (0..grid.len()).step_by(VOXELS_AT_ONCE) {
        let slots = first..(first + VOXELS_AT_ONCE).min(grid.len());
        let part = some_voxels(grid, slots.clone());
        let set = match sample_voxels(scene, &part, &sampling, &|_| true) {
            Ok(set) => set,
            Err(patches::Error::NoSamples) => continue,
            Err(error) => return Err(error.into()),
        };
        let lit = sampler.are_lit(&set.samples, settings.seed)?;
        let made = axis_patches(&part, only(&set, &lit, true))?;
        drafts.par_extend((0..made.len()).into_par_iter().map(|k| draft(scene, &made, k, settings.seed)));
        let unlit = axis_patches(&part, only(&set, &lit, false))?;
        dark.extend(unlit.patches.iter().map(|p| DarkPatch { voxel: p.voxel, position: p.position, normal: p.normal }));
        check_memory("patches", memory_limit)?;
        if report(slots.end, grid.len()).is_break() {
            return Err(Error::cancelled());
        }
    }
    if drafts.is_empty() {
        return Err(patches::Error::NoSamples.into());
    }
    Ok((drafts, dark))
}

/// A patch with points that stand for equal parts of its area.
fn draft(scene: &Scene, set: &PatchSet, k: usize, seed: u32) -> Draft {
    let patch = &set.patches[k];
    let members = set.members_of(k);
    let count = POINTS.min(members.len());
    let mut points = Vec::with_capacity(count);
    let mut passed = 0.0f64;
    let mut radius = 0.0f32;
    for member in members {
        let sample = &set.samples[member.sample as usize];
        passed += f64::from(member.weight);
        radius = radius.max(sample.position.distance(patch.position));
        while points.len() < count && (points.len() as f64 + 0.5) / count as f64 <= passed {
            points.push(LitPoint { position: sample.position, normal: sample.normal, albedo: sample.albedo });
        }
    }
    // Rounding may leave the last ones out.
    while points.len() < count {
        points.extend(points.last().copied());
    }
    let node = Node {
        centre: patch.position,
        radius,
        normal: patch.normal,
        area: patch.area,
        albedo: patch.albedo.clamp(Vec3::ZERO, Vec3::splat(MAX_ALBEDO)),
        parent: NO_NODE,
        first_child: 0,
        children: 0,
    };
    let indoors = sky_seen(scene, &points, hash3(patch.voxel, axis_of(patch.normal) as u32, seed)) < MIN_SKY;
    Draft { key: 0, voxel: patch.voxel, indoors, node, points }
}

/// Share of the hemisphere, by cosine, that meets nothing, from some points.
fn sky_seen(scene: &Scene, points: &[LitPoint], seed: u32) -> f32 {
    let free = |k: u32| {
        let point = &points[k as usize % points.len()];
        let direction = cosine_hemisphere(point.normal, hammersley(k, SKY_RAYS, (seed, hash3(seed, 0, 1))));
        !scene.occluded(point.position + point.normal * scene.geometry.ray_offset, direction, f32::INFINITY)
    };
    (0..SKY_RAYS).filter(|&k| free(k)).count() as f32 / SKY_RAYS as f32
}

/// The node made of some that follow each other: means by area [T 5.2].
fn merged(children: &[Node], first: u32) -> Node {
    let mut area = 0.0f64;
    let mut centre = glam::DVec3::ZERO;
    let mut normal = glam::DVec3::ZERO;
    let mut albedo = glam::DVec3::ZERO;
    for c in children {
        let a = f64::from(c.area);
        area += a;
        centre += c.centre.as_dvec3() * a;
        normal += c.normal.as_dvec3() * a;
        albedo += c.albedo.as_dvec3() * a;
    }
    let centre = (centre / area).as_vec3();
    let radius = children.iter().map(|c| c.centre.distance(centre) + c.radius).fold(0.0, f32::max);
    Node {
        centre,
        radius,
        normal: (normal / area).as_vec3(),
        area: area as f32,
        albedo: (albedo / area).as_vec3(),
        parent: NO_NODE,
        first_child: first,
        children: children.len() as u32,
    }
}

/// Levels above the leaves, so that there are about [`ROOTS`] trees.
fn levels(shape: &GridShape, drafts: &[Draft]) -> u32 {
    let longest = shape.counts().max_element();
    let most = (32 - longest.leading_zeros()).min(MAX_LEVELS);
    let roots = |level: u32| {
        let mut found: Vec<u64> =
            drafts.iter().map(|d| key(shape, d.voxel, axis_of(d.node.normal), false, level) >> (3 * level)).collect();
        found.sort_unstable();
        found.dedup();
        found.len()
    };
    (0..most).find(|&level| roots(level) <= ROOTS).unwrap_or(most)
}

/// Place of a leaf in the order: block of its tree, axis, whether it is indoors, Morton's code in the block.
fn key(shape: &GridShape, voxel: u32, axis: usize, indoors: bool, levels: u32) -> u64 {
    let c = shape.coordinates(voxel);
    let top = UVec3::new(c.x >> levels, c.y >> levels, c.z >> levels);
    let counts = shape.counts();
    let tops = UVec3::new((counts.x >> levels) + 1, (counts.y >> levels) + 1, (counts.z >> levels) + 1);
    let block = u64::from(top.x) + u64::from(tops.x) * (u64::from(top.y) + u64::from(tops.y) * u64::from(top.z));
    let morton = (0..levels).fold(0u64, |code, bit| {
        let digit = |x: u32| u64::from(x >> bit & 1);
        code | (digit(c.x) | digit(c.y) << 1 | digit(c.z) << 2) << (3 * bit)
    });
    (2 * (block * 6 + axis as u64) + u64::from(indoors)) << (3 * levels) | morton
}

/// Greatest exitance of a patch, W/m²: of the brightest material that can be read, and more.
const MAX_EXITANCE: f32 = 1e16;

fn is_exitance(e: Vec3) -> bool {
    e.min_element() >= 0.0 && e.max_element() <= MAX_EXITANCE && !e.is_nan()
}

impl Extra {
    /// As bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = bytemuck::bytes_of(&self.shape).to_vec();
        for count in [self.voxels.len(), self.emission.len(), self.dark.len()] {
            out.extend((count as u32).to_le_bytes());
        }
        let put = |out: &mut Vec<u8>, v: Vec3| v.to_array().iter().for_each(|x| out.extend(x.to_le_bytes()));
        for (voxel, &indoors) in self.voxels.iter().zip(&self.indoors) {
            out.extend((voxel | if indoors { INDOORS } else { 0 }).to_le_bytes());
        }
        for (leaf, exitance) in &self.emission {
            out.extend(leaf.to_le_bytes());
            put(&mut out, *exitance);
        }
        for patch in &self.dark {
            out.extend(patch.voxel.to_le_bytes());
            put(&mut out, patch.position);
            put(&mut out, patch.normal);
        }
        out
    }

    /// From bytes; nothing when they are no such thing.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (head, mut rest) = bytes.split_at_checked(size_of::<GridShape>())?;
        let shape: GridShape = bytemuck::pod_read_unaligned(head);
        let mut word = || {
            let (head, tail) = rest.split_at_checked(4)?;
            rest = tail;
            Some(u32::from_le_bytes([head[0], head[1], head[2], head[3]]))
        };
        let counts = [word()?, word()?, word()?].map(|count| count as usize);
        let wanted = counts[0]
            .checked_mul(4)?
            .checked_add(counts[1].checked_mul(16)?)?
            .checked_add(counts[2].checked_mul(28)?)?;
        if wanted.checked_add(size_of::<GridShape>() + 12)? != bytes.len() {
            return None;
        }
        let voxel_count = u64::from(shape.count_x) * u64::from(shape.count_y) * u64::from(shape.count_z);
        let is_grid = shape.origin.is_finite() && shape.edges.is_finite() && shape.edges.min_element() > 0.0;
        if voxel_count > patches::VOXEL_LIMIT || !is_grid {
            return None;
        }
        let words: Vec<u32> = (0..counts[0]).map(|_| word()).collect::<Option<_>>()?;
        let voxels: Vec<u32> = words.iter().map(|word| word & !INDOORS).collect();
        let indoors = words.iter().map(|word| word & INDOORS != 0).collect();
        let vector = |word: &mut dyn FnMut() -> Option<u32>| {
            Some(Vec3::new(f32::from_bits(word()?), f32::from_bits(word()?), f32::from_bits(word()?)))
        };
        let emission: Vec<(u32, Vec3)> =
            (0..counts[1]).map(|_| Some((word()?, vector(&mut word)?))).collect::<Option<_>>()?;
        let dark: Vec<DarkPatch> = (0..counts[2])
            .map(|_| Some(DarkPatch { voxel: word()?, position: vector(&mut word)?, normal: vector(&mut word)? }))
            .collect::<Option<_>>()?;
        let is_good = voxels.iter().chain(dark.iter().map(|d| &d.voxel)).all(|&v| u64::from(v) < voxel_count)
            && emission.iter().all(|e| (e.0 as usize) < voxels.len() && is_exitance(e.1))
            && dark.iter().all(|d| d.position.is_finite() && d.normal.is_finite());
        is_good.then_some(Self { shape, voxels, indoors, emission, dark })
    }

    /// A leaf as the lookup sees it.
    pub fn entry(node: &Node, patch: u32) -> LookupPatch {
        let direction = node.normal.normalize_or(Vec3::Y);
        LookupPatch { position: node.centre, patch, direction, reserved: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use assets::procedural;

    #[test]
    fn what_is_indoors_and_what_is_not_are_merged_separately() {
        let loaded = procedural::build("atrium:3000").unwrap();
        let settings =
            WorldSettings { scene: String::new(), voxel_size: Some(0.5), patch_count: 2000, rays: 64, seed: 1 };
        let world = Forest::new(&loaded.scene, &settings, u64::MAX, &transport::Silent).unwrap();
        let Extra { shape, voxels, indoors, .. } = &world.extra;
        let within = indoors.iter().filter(|&&one| one).count();
        println!("{within} of {} patches are indoors", indoors.len());
        assert!(within > 50 && indoors.len() - within > 50);
        let family = |node: &Node| node.first_child as usize..(node.first_child + node.children) as usize;
        let parents = world.nodes[indoors.len()..].iter().filter(|node| (node.first_child as usize) < indoors.len());
        let mut blocks: HashMap<(UVec3, usize), [bool; 2]> = HashMap::new();
        for parent in parents {
            let own = &indoors[family(parent)];
            assert!(own.iter().all(|&one| one == own[0]));
            let block = shape.coordinates(voxels[parent.first_child as usize]) / 2;
            let axis = axis_of(world.nodes[parent.first_child as usize].normal);
            blocks.entry((block, axis)).or_default()[usize::from(own[0])] = true;
        }
        // By their places alone they would have been merged.
        assert!(blocks.values().filter(|both| **both == [true; 2]).count() > 5);
        // What a file says is what was written.
        assert_eq!(Extra::decode(&world.extra.encode()).as_ref(), Some(&world.extra));
    }
}
