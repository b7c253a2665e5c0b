//! Frames of a world that is read from a bake as the camera moves: geometry in memory, rows of F on disk, and between both the
//! matrix of the nodes round the camera.

use std::cell::Cell;
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::time::{Duration, Instant};

use glam::{UVec3, Vec3, Vec4};
use localmatrix::kernel::{fade, spread as at_slot};
use localmatrix::{
    BakeFile, FadeParams, LitPoint, Local, LocalSettings, NO_NODE, Node, Step, Store, StoreState, View as Way, World,
};
use patches::{GridShape, Lookup, LookupSettings, VirtualPatch};
use rayon::prelude::*;
use scene::kernel::camera::primary_direction;
use scene::kernel::light::direct_irradiance;
use scene::kernel::shade::{encode_srgb, pixel_radiance};
use scene::math::{ln, luminance};
use scene::{Camera, DirectParams, Light, NONE, Scene, SurfacePoint};

use super::bake::{POINTS, WorldSettings};
use super::forest::{DarkPatch, Extra};
use crate::bake::direct_params;
use crate::error::Error;
use crate::method::local::SHOWN_ALBEDO;
use crate::picture::Picture;

/// Shadow rays of a point or pixel to each rectangle light, and to a sky map.
const AREA_RAYS: u32 = 4;
const SKY_RAYS: u32 = 8;
/// Nodes that are in no cut, but whose points are kept: they are about to be.
const SPARE_POINTS: usize = 1024;
/// How long the first frame waits for a disk from which nothing comes.
const PATIENCE: Duration = Duration::from_secs(120);
/// Light is taken from levels so much coarser than the nodes that stand there, so that none shows its edges.
const COARSER: f32 = 0.7;

/// Settings of [`Streamed`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamSettings {
    /// Of the matrix.
    pub local: LocalSettings,
    /// Frames that the camera's way is looked ahead.
    pub look_ahead: f32,
    /// Whether each frame waits for all changes, whatever their number and the disk.
    pub at_rest: bool,
    /// Bytes of blocks of rows that stay in memory.
    pub cache: usize,
    /// Sub-frames a picture.
    pub sub_frames: u32,
    /// Picture size, pixels.
    pub size: (u32, u32),
}

/// What a frame took and did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StreamFrame {
    /// Milliseconds of direct light, of changes of the matrix, of the product, of what pixels take from it, and of the rest of them.
    pub direct_ms: f64,
    /// Changes of the matrix.
    pub update_ms: f64,
    /// The product.
    pub method_ms: f64,
    /// From the patches to levels.
    pub lookup_ms: f64,
    /// Pixels.
    pub shade_ms: f64,
    /// What the matrix did.
    pub step: Step,
    /// Nodes that stand for the world.
    pub nodes: usize,
    /// The reader.
    pub reader: StoreState,
    /// Change of displayed values at the same places since the frame before that one pixel of a thousand exceeds, in 255ths.
    pub change: Option<f64>,
    /// What displayed values still lack of the light that they are to have, as jumps fade; one pixel of a hundred lacks more, in 255ths.
    pub behind: f64,
}

/// A bake as the matrix reads it; keeps the points of the nodes that it hands out.
struct Rows {
    store: Store,
    points: HashMap<u32, Vec<LitPoint>>,
}

impl World for Rows {
    fn nodes(&self) -> &[Node] {
        self.store.nodes()
    }

    fn want(&mut self, nodes: &[u32]) {
        self.store.want(nodes);
    }

    fn row(&mut self, node: u32) -> Result<Option<Vec<(u32, f32)>>, localmatrix::Error> {
        let Some(record) = self.store.record(node)? else { return Ok(None) };
        self.points.insert(node, record.points);
        Ok(Some(record.factors))
    }
}

/// One level of merged nodes as leaves see it.
struct Level {
    /// Of those outdoors and of those indoors, where there are any.
    lookups: [Option<Lookup>; 2],
    /// First node.
    first: u32,
    /// Light of the nodes.
    light: Vec<Vec4>,
}

/// The light of a bake about a camera.
pub struct Streamed {
    scene: Scene,
    rows: Rows,
    local: Local,
    /// What pixels see: the leaves, and a last value for what is dark.
    lookup: Lookup,
    indoors: Vec<bool>,
    /// Levels above the leaves.
    levels: Vec<Level>,
    emission: HashMap<u32, Vec3>,
    /// First exitance of the nodes of the cut, for these lights, W/m².
    exitance: HashMap<u32, Vec4>,
    /// Slot of each leaf's node in the matrix, and the irradiance of the slots, W/m².
    slot_of: Vec<u32>,
    irradiance: Vec<Vec4>,
    /// Light as the leaves are shown; the fourth component is the luminance with which they were in the frame before.
    shown: Vec<Vec4>,
    /// What `shown` has beyond the light that the leaves are to have: what is left of its jumps.
    offset: Vec<Vec4>,
    /// How large nodes look at most.
    looks: f32,
    edge: f32,
    settings: StreamSettings,
    frames: u32,
    eye: Option<Vec3>,
}

/// The scene that a bake is of, by its own account.
///
/// # Errors
/// What is wrong with the file.
pub fn scene_of(file: &BakeFile) -> Result<String, Error> {
    let settings: WorldSettings =
        serde_json::from_str(&file.text).map_err(|e| not_a_bake(file.path(), &e.to_string()))?;
    Ok(settings.scene)
}

fn not_a_bake(path: &Path, reason: &str) -> Error {
    let (path, reason) = (path.display().to_string(), format!("its settings cannot be read: {reason}"));
    localmatrix::BakeError::NotABake { path, reason }.into()
}

impl Streamed {
    /// Begins to read a bake of this scene.
    ///
    /// # Errors
    /// [`Error::OtherScene`] for a bake of another one; what the file and the matrix say.
    pub fn new(scene: Scene, hash: [u8; 32], mut file: BakeFile, settings: StreamSettings) -> Result<Self, Error> {
        if file.head.scene != hash {
            let named = scene_of(&file)?;
            return Err(Error::OtherScene { path: file.path().to_path_buf(), scene: named });
        }
        let extra = Extra::decode(&file.extra).ok_or_else(|| not_a_bake(file.path(), "its voxels are wrong"))?;
        // Each table goes as soon as the next is made of it: they are as large as what stays.
        file.extra = Vec::new();
        if extra.voxels.len() != file.head.leaves as usize {
            return Err(not_a_bake(file.path(), "it has another number of patches than voxels"));
        }
        let local = Local::new(&file.nodes, settings.local)?;
        let (lookup, levels) = lookups(&file.nodes, &extra)?;
        let emission = emission_of_nodes(&file.nodes, &extra.emission);
        let leaves = extra.voxels.len();
        let area: f64 = local.leaf_area().iter().map(|&a| f64::from(a)).sum();
        let edge = scene::math::sqrt((area / leaves as f64) as f32);
        let indoors = extra.indoors;
        drop((extra.voxels, extra.dark));
        let store = Store::new(file, settings.cache)?;
        Ok(Self {
            scene,
            rows: Rows { store, points: HashMap::new() },
            local,
            indoors,
            levels,
            emission,
            exitance: HashMap::new(),
            slot_of: vec![NO_NODE; leaves],
            irradiance: Vec::new(),
            shown: vec![Vec4::ZERO; lookup.values],
            offset: vec![Vec4::ZERO; lookup.values],
            lookup,
            looks: 0.0,
            edge,
            settings,
            frames: 0,
            eye: None,
        })
    }

    /// Patches of the world.
    pub fn patch_count(&self) -> usize {
        self.slot_of.len()
    }

    /// Bytes of the parts: of the matrix, its rows, the nodes, lookups, and the cache at most.
    pub fn bytes(&self) -> Vec<(&'static str, u64)> {
        let mut parts = self.local.bytes().to_vec();
        let merged =
            |l: &Level| l.lookups.iter().flatten().map(Lookup::bytes).sum::<usize>() + size_of_val(&l.light[..]);
        let lookups = self.lookup.bytes() + self.levels.iter().map(merged).sum::<usize>();
        let light = [&self.irradiance, &self.shown, &self.offset];
        let light: usize = light.iter().map(|values| size_of_val(&values[..])).sum();
        parts.push(("nodes", size_of_val(self.rows.nodes()) as u64));
        parts.push(("lookup", lookups as u64));
        parts.push(("light", (light + 5 * self.slot_of.len()) as u64));
        parts.push(("cache", self.settings.cache as u64));
        parts
    }

    /// Waits for the nodes that suit the first view: later frames take what is there.
    ///
    /// # Errors
    /// What the matrix says; cancellation.
    pub fn settle(&mut self, eye: Vec3, report: &(dyn Fn(f32) -> bool + Sync)) -> Result<Step, Error> {
        let stopped = Cell::new(false);
        // The disk is given up when nothing has come for so long.
        let (last, slots) = (Cell::new((0, Instant::now())), self.settings.local.slots as f32);
        let go_on = |done: usize| {
            if done != last.get().0 {
                last.set((done, Instant::now()));
            }
            stopped.set(stopped.get() || !report(done as f32 / slots));
            !stopped.get() && last.get().1.elapsed() < PATIENCE
        };
        match self.local.settle(&mut self.rows, Way { eye, ahead: eye }, &go_on) {
            Ok(step) => Ok(step),
            // A disk that is too slow: coarser nodes do until it comes.
            Err(error) if Error::from(error.clone()).is_cancelled() => {
                if stopped.get() {
                    Err(Error::Cancelled)
                } else {
                    Ok(Step::default())
                }
            }
            Err(error) => Err(error.into()),
        }
    }

    /// A picture, and what it took.
    ///
    /// # Errors
    /// What the matrix says.
    pub fn frame(&mut self, lights: &[Light], camera: &Camera, stops: f32) -> Result<(Picture, StreamFrame), Error> {
        let mut done = StreamFrame::default();
        let timed = |ms: &mut f64, start: Instant| *ms += start.elapsed().as_secs_f64() * 1e3;
        let is_relit = self.scene.lighting.lights != lights;
        if is_relit {
            self.scene.lighting.lights = lights.to_vec();
            self.exitance.clear();
        }
        let eye = camera.eye;
        let last = self.eye.unwrap_or(eye);
        let ahead = eye + (eye - last) * self.settings.look_ahead;
        self.eye = Some(eye);
        let is_first = self.frames == 0;
        self.shown.par_iter_mut().for_each(|shown| shown.w = luminance(shown.truncate()));

        let start = Instant::now();
        self.light_nodes();
        timed(&mut done.direct_ms, start);
        if is_relit && !is_first {
            // Jumps are those of the matrix: what the lights do is there at once.
            let start = Instant::now();
            self.product()?;
            timed(&mut done.method_ms, start);
            let start = Instant::now();
            self.spread(last, None);
            timed(&mut done.lookup_ms, start);
        }
        let start = Instant::now();
        let all = if self.settings.at_rest { self.settle(eye, &|_| true)? } else { Step::default() };
        let changes = self.local.choose(&mut self.rows, Way { eye, ahead });
        let has_changes = !changes.is_empty() || all.entered + all.left > 0;
        done.step = self.local.apply(&self.rows, changes)?.after(all);
        timed(&mut done.update_ms, start);
        let start = Instant::now();
        self.light_nodes();
        timed(&mut done.direct_ms, start);
        if has_changes || is_first {
            let start = Instant::now();
            self.product()?;
            timed(&mut done.method_ms, start);
        }

        let start = Instant::now();
        self.look(eye);
        self.spread(eye, Some(self.local.fade_params(!is_first)));
        timed(&mut done.lookup_ms, start);
        let start = Instant::now();
        let (picture, change, behind) = self.shade(camera, stops)?;
        timed(&mut done.shade_ms, start);
        done.change = change.filter(|_| !is_first);
        done.behind = behind;
        done.nodes = self.local.cut().len();
        done.reader = self.rows.store.state();
        self.frames += 1;
        Ok((picture, done))
    }

    /// First exitance of the nodes of the cut that have none yet, for all their leaves: emission, and what they reflect of
    /// the lights and of the constant sky.
    fn light_nodes(&mut self) {
        let cut = self.local.cut();
        let new: Vec<u32> = cut.iter().copied().filter(|node| !self.exitance.contains_key(node)).collect();
        let params = DirectParams {
            emitter_count: 0,
            area_rays: AREA_RAYS,
            sky_rays: if self.scene.lighting.sky.map_width == 0 { 0 } else { SKY_RAYS },
            ..direct_params(&self.scene)
        };
        let sky = self.constant_sky();
        let light = |&node: &u32| {
            let of = &self.rows.nodes()[node as usize];
            let shone = sky * self.rows.store.sky()[node as usize] * of.albedo;
            let emitted = self.emission.get(&node).copied().unwrap_or(Vec3::ZERO);
            let Some(points) = self.rows.points.get(&node).filter(|points| !points.is_empty()) else {
                return (shone + emitted).extend(0.0);
            };
            let mut reflected = Vec3::ZERO;
            for (k, p) in points.iter().enumerate() {
                let point = SurfacePoint { position: p.position, patch: NONE, normal: p.normal, weight: 1.0 };
                // A node's random numbers are its own, whatever comes with it.
                let own = DirectParams { first: node.wrapping_mul(POINTS as u32) + k as u32, ..params };
                reflected += p.albedo * direct_at(&self.scene, &own, point);
            }
            (shone + emitted + reflected / points.len() as f32).extend(0.0)
        };
        let lit: Vec<Vec4> = new.par_iter().map(light).collect();
        let in_cut: HashSet<u32> = cut.iter().copied().collect();
        self.exitance.retain(|node, _| in_cut.contains(node));
        self.exitance.extend(new.into_iter().zip(lit));
        if self.rows.points.len() > in_cut.len() + SPARE_POINTS {
            self.rows.points.retain(|node, _| in_cut.contains(node));
        }
    }

    /// Irradiance of the slots, and where the leaves find theirs.
    fn product(&mut self) -> Result<(), Error> {
        let mut exitance = vec![Vec4::ZERO; self.settings.local.slots];
        let forest = self.local.forest();
        self.slot_of.fill(NO_NODE);
        for (slot, node) in self.local.matrix().patches() {
            exitance[slot as usize] = self.exitance.get(&node).copied().unwrap_or(Vec4::ZERO);
            let [first, end] = forest.run(node);
            forest.leaves()[first as usize..end as usize].iter().for_each(|&leaf| self.slot_of[leaf as usize] = slot);
        }
        self.irradiance = self.local.slot_product(&exitance, |_| true)?.0;
        Ok(())
    }

    /// Irradiance of a hemisphere that sees nothing but a constant sky, W/m².
    fn constant_sky(&self) -> Vec3 {
        let sky = self.scene.lighting.sky;
        if sky.map_width == 0 { sky.radiance * std::f32::consts::PI } else { Vec3::ZERO }
    }

    /// Light of the leaves as a camera is to see them, from that of the matrix and the sky: its own for what is near, further off
    /// that of merged nodes, between their places and between two levels, so that none of them shows its edges. In `shown` then is what is
    /// shown of it: its jumps fade; without `jumps` it is there at once, and what is left of earlier jumps stays.
    fn spread(&mut self, eye: Vec3, jumps: Option<FadeParams>) {
        let (sky, factors, nodes) = (self.constant_sky().extend(0.0), self.rows.store.sky(), self.rows.nodes());
        let (slot_of, irradiance, indoors) = (&self.slot_of, &self.irradiance, &self.indoors);
        let own = |leaf: usize| at_slot(slot_of[leaf], irradiance) + sky * factors[leaf];
        for k in 0..self.levels.len() {
            let (below, rest) = self.levels.split_at_mut(k);
            let Level { first, light, .. } = &mut rest[0];
            let of = |child: u32| match below.last() {
                None => own(child as usize),
                Some(under) => under.light[(child - under.first) as usize],
            };
            light.par_iter_mut().enumerate().for_each(|(k, value)| {
                let node = *first as usize + k;
                let children = nodes[node].first_child..nodes[node].first_child + nodes[node].children;
                *value = children.map(|c| of(c) * nodes[c as usize].area).sum::<Vec4>() / nodes[node].area;
            });
        }
        let (levels, looks, edge) = (&self.levels, self.looks, self.edge);
        let value = |leaf: usize| {
            let node = &nodes[leaf];
            let size = looks * (node.centre.distance(eye) + 2.0 * edge) / edge;
            let level = (ln(size.max(1e-6)) / std::f32::consts::LN_2 + COARSER).clamp(0.0, levels.len() as f32);
            let (low, share) = (level.floor() as usize, level.fract());
            let at = |k: usize| match k.checked_sub(1) {
                None => own(leaf),
                Some(k) => {
                    let Level { lookups, light, .. } = &levels[k];
                    let lookup = lookups[usize::from(indoors[leaf])].as_ref();
                    // The tables have as many values as the lookup wants: made together.
                    let normal = node.normal.normalize_or(Vec3::Y);
                    lookup.and_then(|l| l.at(light, node.centre, normal).ok()).unwrap_or(Vec4::ZERO)
                }
            };
            if share == 0.0 { at(low) } else { at(low).lerp(at(low + 1), share) }
        };
        let leaves = self.shown.par_iter_mut().zip(&mut self.offset).take(slot_of.len()).enumerate();
        leaves.for_each(|(leaf, (shown, offset))| {
            let light = value(leaf);
            if let Some(params) = &jumps {
                *offset = fade(Vec4::ZERO, *shown, light, params);
            }
            *shown = (light + *offset).truncate().extend(shown.w);
        });
    }

    /// Finds how large nodes look, once: pixels then take their light from levels that change with distance only.
    fn look(&mut self, eye: Vec3) {
        if self.looks > 0.0 {
            return;
        }
        let nodes = self.rows.nodes();
        let mut sizes: Vec<f32> = (self.local.cut().iter())
            .map(|&node| &nodes[node as usize])
            .filter(|node| node.children > 0)
            .map(|node| {
                scene::math::sqrt(node.area) / ((node.centre.distance(eye) - node.radius).max(0.0) + 2.0 * self.edge)
            })
            .collect();
        sizes.sort_by(f32::total_cmp);
        self.looks = sizes.get(sizes.len() * 9 / 10).copied().unwrap_or(1e-6);
    }

    fn shade(&self, camera: &Camera, stops: f32) -> Result<(Picture, Option<f64>, f64), Error> {
        let (geometry, lights) = (self.scene.tables(), self.scene.all_lights());
        let light_count = self.scene.lighting.lights.len() as u32;
        let params = DirectParams {
            emitter_count: 0,
            area_rays: AREA_RAYS,
            sky_rays: if self.scene.lighting.sky.map_width == 0 { 0 } else { SKY_RAYS },
            ..direct_params(&self.scene)
        };
        let scale = scene::stops_to_scale(stops);
        let shown = |h: f32| 255.0 * encode_srgb((h * SHOWN_ALBEDO / std::f32::consts::PI * scale).clamp(0.0, 1.0));
        let (width, height) = self.settings.size;
        let pixel = |index: u32| {
            let (mut sum, mut change, mut behind) = (Vec4::ZERO, 0.0f32, 0.0f32);
            for sub in 0..self.settings.sub_frames {
                let direction = primary_direction(camera, index, sub);
                let hit = self.scene.closest_before(camera.eye, direction, f32::INFINITY);
                let mut irradiance = Vec3::ZERO;
                if !hit.is_miss() {
                    let normal = geometry.normal(hit.triangle);
                    let normal = if normal.dot(direction) < 0.0 { normal } else { -normal };
                    let position = geometry.position(hit.triangle, hit.u, hit.v);
                    let point = SurfacePoint { position, patch: NONE, normal, weight: 1.0 };
                    let own = DirectParams { first: index.wrapping_mul(self.settings.sub_frames) + sub, ..params };
                    let at = |values: &[Vec4]| self.lookup.at(values, position, normal).unwrap_or(Vec4::ZERO);
                    let now = at(&self.shown);
                    irradiance = direct_at(&self.scene, &own, point) + now.truncate();
                    if sub == 0 {
                        let (seen, rest) = (luminance(now.truncate()), luminance(at(&self.offset).truncate()));
                        change = (shown(seen) - shown(now.w)).abs();
                        behind = (shown(seen) - shown(seen - rest)).abs();
                    }
                }
                let radiance = pixel_radiance(&geometry, &lights, light_count, camera, direction, hit, irradiance);
                sum += radiance.extend(1.0);
            }
            ((sum / self.settings.sub_frames as f32).truncate(), [change, behind])
        };
        let (mut pixels, mut moves): (Vec<Vec3>, Vec<[f32; 2]>) = (Vec::new(), Vec::new());
        (0..width * height).into_par_iter().map(pixel).unzip_into_vecs(&mut pixels, &mut moves);
        let mut all_but = |which: usize, one_of: usize| {
            let place = moves.len().checked_sub(moves.len() / one_of + 1)?;
            let found = moves.select_nth_unstable_by(place, |a, b| a[which].total_cmp(&b[which])).1;
            Some(f64::from(found[which]))
        };
        let (change, behind) = (all_but(0, 1000), all_but(1, 100).unwrap_or(0.0));
        Ok((Picture::from_pixels(width, height, pixels)?, change, behind))
    }
}

/// Direct irradiance at one point, W/m²; its random numbers are those of `p.first`.
fn direct_at(scene: &Scene, p: &DirectParams, point: SurfacePoint) -> Vec3 {
    let occluded = |origin: Vec3, direction: Vec3, t_max: f32| scene.occluded(origin, direction, t_max);
    direct_irradiance(&scene.tables(), p, p.first, point, &scene.all_lights(), occluded)
}

/// The lookup of the leaves, and those of each level above them, a voxel of which holds eight of the one below.
fn lookups(nodes: &[Node], extra: &Extra) -> Result<(Lookup, Vec<Level>), Error> {
    let virtual_patch = |node: &Node, voxel: u32| VirtualPatch {
        position: node.centre,
        area: node.area,
        normal: node.normal.normalize_or(Vec3::Y),
        voxel,
        albedo: node.albedo,
        reserved: 0,
    };
    let settings = LookupSettings::default();
    let dark = |d: DarkPatch| VirtualPatch {
        position: d.position,
        area: 1.0,
        normal: d.normal.normalize_or(Vec3::Y),
        voxel: d.voxel,
        ..VirtualPatch::default()
    };
    let (mut shape, mut own) = (extra.shape, 0..extra.voxels.len());
    let mut coordinates: Vec<UVec3> = extra.voxels.iter().map(|&voxel| shape.coordinates(voxel)).collect();
    let mut indoors = extra.indoors.clone();
    let leaf = |k: usize| virtual_patch(&nodes[k], extra.voxels[k]);
    let dark = |k: usize| dark(extra.dark[k]);
    let lookup = Lookup::with_dark(&shape, (own.len(), leaf), (extra.dark.len(), dark), settings)?;
    let mut levels = Vec::new();
    while nodes[own.clone()].iter().all(|node| node.parent != NO_NODE) {
        let merged = nodes[own.end..].iter().take_while(|node| own.contains(&(node.first_child as usize))).count();
        let above = own.end..own.end + merged;
        if merged == 0 {
            break;
        }
        let first_child = |node: usize| nodes[node].first_child as usize - own.start;
        coordinates = above.clone().map(|node| coordinates[first_child(node)] / 2).collect();
        indoors = above.clone().map(|node| indoors[first_child(node)]).collect();
        let counts = shape.counts().map(|n| n.div_ceil(2));
        let edges = shape.edges * 2.0;
        shape = GridShape { edges, count_x: counts.x, count_y: counts.y, count_z: counts.z, ..shape };
        let lookup = |class: bool| {
            let chosen: Vec<u32> = (0..above.len() as u32).filter(|&k| indoors[k as usize] == class).collect();
            if chosen.is_empty() {
                return Ok::<_, Error>(None);
            }
            let merged = |k: usize| {
                let k = chosen[k] as usize;
                virtual_patch(&nodes[above.start + k], shape.voxel_at(coordinates[k]))
            };
            let mut lookup =
                Lookup::with_dark(&shape, (chosen.len(), merged), (0, |_| VirtualPatch::default()), settings)?;
            // Values are those of the whole level.
            lookup.entries.iter_mut().for_each(|entry| entry.patch = chosen[entry.patch as usize]);
            lookup.values = above.len();
            Ok(Some(lookup))
        };
        let light = vec![Vec4::ZERO; above.len()];
        levels.push(Level { lookups: [lookup(false)?, lookup(true)?], first: above.start as u32, light });
        own = above;
    }
    Ok((lookup, levels))
}

/// Emission of the nodes that shine, W/m², from that of leaves: means by area.
fn emission_of_nodes(nodes: &[Node], leaves: &[(u32, Vec3)]) -> HashMap<u32, Vec3> {
    let mut power: HashMap<u32, Vec3> = HashMap::new();
    for &(leaf, exitance) in leaves {
        let shone = exitance * nodes[leaf as usize].area;
        let mut node = leaf;
        loop {
            *power.entry(node).or_default() += shone;
            node = nodes[node as usize].parent;
            if node == NO_NODE {
                break;
            }
        }
    }
    power.into_iter().map(|(node, power)| (node, power / nodes[node as usize].area)).collect()
}
