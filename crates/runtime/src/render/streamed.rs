//! Frames of a world that is read from a bake as the camera moves: geometry in memory, rows of F on disk, and between both the
//! matrix of the nodes round the camera.

use std::cell::Cell;
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::time::{Duration, Instant};

use glam::{UVec3, Vec3, Vec4};
use localmatrix::{
    BakeFile, LitPoint, Local, LocalSettings, NO_NODE, Node, Step, Store, StoreState, View as Way, World,
};
use patches::{Grid, GridShape, Lookup, LookupSettings, PatchSet, VirtualPatch};
use rayon::prelude::*;
use reference::Picture;
use scene::kernel::camera::primary_direction;
use scene::kernel::light::direct_irradiance;
use scene::kernel::shade::{encode_srgb, pixel_radiance};
use scene::math::{ln, luminance};
use scene::{Camera, DirectParams, Light, NONE, Scene, SurfacePoint};

use super::classic::direct_params;
use crate::bake::{BakeSettings, Extra, POINTS};
use crate::error::Error;
use crate::progress::is_cancelled;

/// Albedo of the surface whose displayed value tells how much a frame differs from the one before.
const ALBEDO: f32 = 0.5;
/// Shadow rays of a point or pixel to each rectangle light, and to a sky map.
const AREA_RAYS: u32 = 4;
const SKY_RAYS: u32 = 8;
/// Nodes that are in no cut, but whose points are kept: they are about to be.
const SPARE_POINTS: usize = 4096;
/// How long the first frame waits for a disk from which nothing comes.
const PATIENCE: Duration = Duration::from_secs(120);
/// Pixels are taken from levels so much coarser than the nodes that stand there, so that none shows its edges.
const COARSER: f32 = 0.7;

/// Settings of [`Streamed`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamSettings {
    /// Of the matrix.
    pub local: LocalSettings,
    /// Frames that the camera's way is looked ahead.
    pub look_ahead: f32,
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

/// One level of the nodes as pixels see it.
struct Level {
    lookup: Lookup,
    /// First node.
    first: u32,
    /// Light of the nodes now and in the frame before, and a last one for what is dark.
    now: Vec<Vec4>,
    before: Vec<Vec4>,
}

/// The light of a bake about a camera.
pub struct Streamed {
    scene: Scene,
    rows: Rows,
    local: Local,
    levels: Vec<Level>,
    /// Place of each leaf in the matrix's order.
    place: Vec<u32>,
    emission: HashMap<u32, Vec3>,
    /// Of the leaves, in the matrix's order.
    exitance: Vec<Vec4>,
    irradiance: Vec<Vec4>,
    /// Nodes whose exitance is known, for these lights.
    known: HashSet<u32>,
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
    let settings: BakeSettings =
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
    pub fn new(scene: Scene, hash: [u8; 32], file: BakeFile, settings: StreamSettings) -> Result<Self, Error> {
        if file.head.scene != hash {
            let named = scene_of(&file)?;
            return Err(Error::OtherScene { path: file.path().to_path_buf(), scene: named });
        }
        let extra = Extra::decode(&file.extra).ok_or_else(|| not_a_bake(file.path(), "its voxels are wrong"))?;
        if extra.voxels.len() != file.head.leaves as usize {
            return Err(not_a_bake(file.path(), "it has another number of patches than voxels"));
        }
        let local = Local::new(&file.nodes, settings.local)?;
        let levels = levels(&file.nodes, &extra)?;
        let mut place = vec![0; extra.voxels.len()];
        for (at, &leaf) in (0..).zip(local.forest().leaves()) {
            place[leaf as usize] = at;
        }
        let emission = emission_of_nodes(&file.nodes, &extra.emission);
        let leaves = place.len();
        let area: f64 = local.leaf_area().iter().map(|&a| f64::from(a)).sum();
        let edge = scene::math::sqrt((area / leaves as f64) as f32);
        let store = Store::new(file, settings.cache)?;
        Ok(Self {
            scene,
            rows: Rows { store, points: HashMap::new() },
            local,
            levels,
            place,
            emission,
            exitance: vec![Vec4::ZERO; leaves],
            irradiance: vec![Vec4::ZERO; leaves],
            known: HashSet::new(),
            looks: 0.0,
            edge,
            settings,
            frames: 0,
            eye: None,
        })
    }

    /// Patches of the world.
    pub fn patch_count(&self) -> usize {
        self.place.len()
    }

    /// Bytes of the parts: of the matrix, its rows, the nodes, lookups, and the cache at most.
    pub fn bytes(&self) -> Vec<(&'static str, u64)> {
        let mut parts = self.local.bytes().to_vec();
        let lookups: usize = self.levels.iter().map(|l| l.lookup.bytes() + 32 * l.now.len()).sum();
        parts.push(("nodes", size_of_val(self.rows.nodes()) as u64));
        parts.push(("lookup", lookups as u64));
        parts.push(("light", (36 * self.place.len()) as u64));
        parts.push(("cache", self.settings.cache as u64));
        parts
    }

    /// Waits for the nodes that suit the first view: later frames take what is there.
    ///
    /// # Errors
    /// What the matrix says; cancellation.
    pub fn settle(&mut self, eye: Vec3, report: &(dyn Fn(f32) -> bool + Sync)) -> Result<Step, Error> {
        // The disk is given up when nothing has come for so long.
        let (last, slots) = (Cell::new((0, Instant::now())), self.settings.local.slots as f32);
        let go_on = |done: usize| {
            if done != last.get().0 {
                last.set((done, Instant::now()));
            }
            report(done as f32 / slots) && last.get().1.elapsed() < PATIENCE && !is_cancelled()
        };
        match self.local.settle(&mut self.rows, Way { eye, ahead: eye }, &go_on) {
            Ok(step) => Ok(step),
            // A disk that is too slow: coarser nodes do until it comes.
            Err(localmatrix::Error::Cancelled) if !is_cancelled() => Ok(Step::default()),
            Err(localmatrix::Error::Cancelled) => Err(Error::Cancelled),
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
        if self.scene.lights != lights {
            self.scene.lights = lights.to_vec();
            self.known.clear();
        }
        let eye = camera.eye;
        let ahead = eye + (eye - self.eye.unwrap_or(eye)) * self.settings.look_ahead;
        self.eye = Some(eye);

        let start = Instant::now();
        self.light_nodes();
        timed(&mut done.direct_ms, start);
        let start = Instant::now();
        let changes = self.local.choose(&mut self.rows, Way { eye, ahead });
        timed(&mut done.update_ms, start);
        let start = Instant::now();
        let mut before = Vec::new();
        if !changes.is_empty() && self.frames > 0 {
            before = vec![Vec4::ZERO; self.irradiance.len()];
            self.local.product(&self.exitance, &mut before, |_| true)?;
        }
        timed(&mut done.method_ms, start);
        let start = Instant::now();
        done.step = self.local.apply(&self.rows, changes)?;
        timed(&mut done.update_ms, start);
        let start = Instant::now();
        self.light_nodes();
        timed(&mut done.direct_ms, start);
        let start = Instant::now();
        self.local.product(&self.exitance, &mut self.irradiance, |_| true)?;
        self.local.fade(&before, &mut self.irradiance);
        timed(&mut done.method_ms, start);

        let start = Instant::now();
        self.spread();
        self.look(eye);
        timed(&mut done.lookup_ms, start);
        let start = Instant::now();
        let (picture, change) = self.shade(camera, stops)?;
        timed(&mut done.shade_ms, start);
        done.change = change.filter(|_| self.frames > 0);
        done.nodes = self.local.cut().len();
        done.reader = self.rows.store.state();
        self.frames += 1;
        Ok((picture, done))
    }

    /// First exitance of the nodes of the cut that have none yet, for all their leaves: emission, and what they reflect of
    /// the lights and of the constant sky.
    fn light_nodes(&mut self) {
        let cut = self.local.cut();
        let new: Vec<u32> = cut.iter().copied().filter(|node| !self.known.contains(node)).collect();
        let params = DirectParams {
            emitter_count: 0,
            area_rays: AREA_RAYS,
            sky_rays: if self.scene.sky.map_width == 0 { 0 } else { SKY_RAYS },
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
        for (&node, light) in new.iter().zip(lit) {
            let [first, end] = self.local.forest().run(node);
            self.exitance[first as usize..end as usize].fill(light);
        }
        let in_cut: HashSet<u32> = cut.iter().copied().collect();
        self.known = in_cut.clone();
        if self.rows.points.len() > in_cut.len() + SPARE_POINTS {
            self.rows.points.retain(|node, _| in_cut.contains(node));
        }
    }

    /// Irradiance of a hemisphere that sees nothing but a constant sky, W/m².
    fn constant_sky(&self) -> Vec3 {
        let sky = self.scene.sky;
        if sky.map_width == 0 { sky.radiance * std::f32::consts::PI } else { Vec3::ZERO }
    }

    /// Light of all nodes of all levels, from that of the leaves and the sky: means by area.
    fn spread(&mut self) {
        let (sky, factors, nodes) = (self.constant_sky().extend(0.0), self.rows.store.sky(), self.rows.nodes());
        for k in 0..self.levels.len() {
            let (below, rest) = self.levels.split_at_mut(k);
            let level = &mut rest[0];
            std::mem::swap(&mut level.now, &mut level.before);
            let (first, count) = (level.first, level.lookup.values);
            let last = level.now.len().min(count);
            match below.last() {
                None => level.now[..last].par_iter_mut().enumerate().for_each(|(leaf, value)| {
                    // The last one is that of dark places.
                    *value = self
                        .place
                        .get(leaf)
                        .map_or(Vec4::ZERO, |&place| self.irradiance[place as usize] + sky * factors[leaf]);
                }),
                Some(under) => level.now[..last].par_iter_mut().enumerate().for_each(|(k, value)| {
                    let node = &nodes[first as usize + k];
                    let own = node.first_child..node.first_child + node.children;
                    let sum: Vec4 = own.map(|c| under.now[(c - under.first) as usize] * nodes[c as usize].area).sum();
                    *value = sum / node.area;
                }),
            }
        }
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

    /// Light at a place, now and in the frame before, W/m².
    fn at(&self, position: Vec3, normal: Vec3, eye: Vec3) -> [Vec4; 2] {
        let most = self.levels.len() - 1;
        let size = self.looks * (position.distance(eye) + 2.0 * self.edge) / self.edge;
        let level = (ln(size.max(1e-6)) / std::f32::consts::LN_2 + COARSER).clamp(0.0, most as f32);
        let (low, share) = (level.floor() as usize, level.fract());
        let of = |k: usize| {
            let level = &self.levels[k.min(most)];
            // The tables have as many values as the lookup wants: made together.
            let value = |values: &[Vec4]| level.lookup.at(values, position, normal).unwrap_or(Vec4::ZERO);
            [value(&level.now), value(&level.before)]
        };
        let [now, before] = of(low);
        if share == 0.0 {
            return [now, before];
        }
        let [now_above, before_above] = of(low + 1);
        [now.lerp(now_above, share), before.lerp(before_above, share)]
    }

    fn shade(&self, camera: &Camera, stops: f32) -> Result<(Picture, Option<f64>), Error> {
        let (geometry, lights) = (self.scene.geometry(), self.scene.all_lights());
        let light_count = self.scene.lights.len() as u32;
        let params = DirectParams {
            emitter_count: 0,
            area_rays: AREA_RAYS,
            sky_rays: if self.scene.sky.map_width == 0 { 0 } else { SKY_RAYS },
            ..direct_params(&self.scene)
        };
        let scale = reference::stops_to_scale(stops);
        let shown = |h: Vec4| {
            255.0 * encode_srgb((luminance(h.truncate()) * ALBEDO / std::f32::consts::PI * scale).clamp(0.0, 1.0))
        };
        let (width, height) = self.settings.size;
        let pixel = |index: u32| {
            let (mut sum, mut change) = (Vec4::ZERO, 0.0f32);
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
                    let [now, before] = self.at(position, normal, camera.eye);
                    irradiance = direct_at(&self.scene, &own, point) + now.truncate();
                    if sub == 0 {
                        change = (shown(now) - shown(before)).abs();
                    }
                }
                let radiance = pixel_radiance(&geometry, &lights, light_count, camera, direction, hit, irradiance);
                sum += radiance.extend(1.0);
            }
            (sum / self.settings.sub_frames as f32, change)
        };
        let found: Vec<(Vec4, f32)> = (0..width * height).into_par_iter().map(pixel).collect();
        let mut changes: Vec<f32> = found.iter().map(|f| f.1).collect();
        changes.sort_by(f32::total_cmp);
        let change = changes.get(changes.len() * 999 / 1000).map(|&c| f64::from(c));
        let pixels = found.into_iter().map(|f| f.0.truncate()).collect();
        Ok((Picture::from_pixels(width, height, pixels)?, change))
    }
}

/// Direct irradiance at one point, W/m²; its random numbers are those of `p.first`.
fn direct_at(scene: &Scene, p: &DirectParams, point: SurfacePoint) -> Vec3 {
    let occluded = |origin: Vec3, direction: Vec3, t_max: f32| scene.occluded(origin, direction, t_max);
    direct_irradiance(&scene.geometry(), p, p.first, point, &scene.all_lights(), occluded)
}

/// Lookups of the leaves and of each level above them, a voxel of which holds eight of the one below.
fn levels(nodes: &[Node], extra: &Extra) -> Result<Vec<Level>, Error> {
    let virtual_patch = |node: &Node, voxel: u32| VirtualPatch {
        position: node.centre,
        area: node.area,
        normal: node.normal.normalize_or(Vec3::Y),
        voxel,
        albedo: node.albedo,
        reserved: 0,
    };
    let grid = |shape: GridShape| Grid {
        shape,
        occupied: Vec::new(),
        offsets: vec![0],
        triangles: Vec::new(),
        areas: Vec::new(),
    };
    let dark = extra.dark.iter().map(|d| VirtualPatch {
        position: d.position,
        area: 1.0,
        normal: d.normal.normalize_or(Vec3::Y),
        voxel: d.voxel,
        ..VirtualPatch::default()
    });
    let mut dark = PatchSet { patches: dark.collect(), ..PatchSet::default() };
    let (mut first, mut shape) = (0u32, extra.shape);
    let mut coordinates: Vec<UVec3> = extra.voxels.iter().map(|&voxel| shape.coordinates(voxel)).collect();
    let mut out = Vec::new();
    loop {
        let own = &nodes[first as usize..first as usize + coordinates.len()];
        let patches = own.iter().zip(&coordinates).map(|(node, c)| virtual_patch(node, shape.voxel_at(*c))).collect();
        let set = PatchSet { patches, ..PatchSet::default() };
        let lookup = Lookup::with_dark(&grid(shape), &set, &dark, LookupSettings::default())?;
        dark = PatchSet::default();
        let values = vec![Vec4::ZERO; lookup.values];
        out.push(Level { lookup, first, now: values.clone(), before: values });
        if own.iter().any(|node| node.parent == NO_NODE) {
            return Ok(out);
        }
        let next = first + coordinates.len() as u32;
        let above: Vec<UVec3> = (nodes[next as usize..].iter())
            .take_while(|node| (first..next).contains(&node.first_child))
            .map(|node| coordinates[(node.first_child - first) as usize] / 2)
            .collect();
        if above.is_empty() {
            return Ok(out);
        }
        let counts = shape.counts().map(|n| n.div_ceil(2));
        let edges = shape.edges * 2.0;
        shape = GridShape { edges, count_x: counts.x, count_y: counts.y, count_z: counts.z, ..shape };
        (first, coordinates) = (next, above);
    }
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
