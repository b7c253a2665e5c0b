//! Frames of a world that is read from a bake as the camera moves: geometry in memory, rows of F on
//! disk, and between both the matrix of the nodes round the camera.

use std::cell::Cell;
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::time::Duration;

use glam::Vec3;
use localmatrix::{
    BakeFile, LitPoint, Local, LocalSettings, NO_NODE, Node, Step, Store, StoreState, View as CameraPath, World,
};
use runtime::executor::{Executor, PassTime};
use scene::kernel::shade::encode_srgb;
use scene::math::luminance;
use scene::{Camera, Light, Scene};
use web_time::Instant;

use super::bake::WorldSettings;
use super::forest::Extra;
use super::levels::Levels;
use super::slots::{Seen, SlotFrame, SlotNode, SlotSettings};
use crate::error::{Error, Reason};
use crate::method::local::SHOWN_ALBEDO;
use crate::picture::Picture;

/// Nodes that are in no cut, but whose points are kept: they are about to be.
const SPARE_POINTS: usize = 1024;
/// Time that the first frame waits for a disk from which nothing comes.
const PATIENCE: Duration = Duration::from_secs(120);
/// Slots are so many at a time: rows of the matrix on a device are whole vectors.
const SLOT_STEP: usize = 4;

/// Settings of [`Streamed`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamSettings {
    /// Settings of the matrix.
    pub local: LocalSettings,
    /// Frames for which the camera's path is predicted.
    pub predicted_frames: f32,
    /// Waits for all changes in each frame, whatever their number and the disk.
    pub at_rest: bool,
    /// Bytes of blocks of rows that stay in memory.
    pub cache: usize,
    /// Sub-frames a picture.
    pub sub_frames: u32,
    /// Picture size, pixels.
    pub size: (u32, u32),
    /// Measures [`StreamFrame::change`] and [`StreamFrame::behind`], for which a frame waits for its first sub-frame.
    pub is_measured: bool,
}

/// Report of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StreamFrame {
    /// Milliseconds of direct light, of changes of the matrix, of the product, of what pixels take
    /// from it, and of the rest of them.
    pub direct_ms: f64,
    /// Changes of the matrix.
    pub update_ms: f64,
    /// The product.
    pub method_ms: f64,
    /// From the patches to levels.
    pub lookup_ms: f64,
    /// Pixels.
    pub shade_ms: f64,
    /// Changes of the matrix.
    pub step: Step,
    /// Nodes that stand for the world.
    pub nodes: usize,
    /// The reader.
    pub reader: StoreState,
    /// Change of displayed values at the same places since the frame before that one pixel of a
    /// thousand exceeds, in 255ths.
    pub change: Option<f64>,
    /// Difference of displayed values from their target, as jumps fade; one pixel of a hundred lacks more, in 255ths.
    pub behind: Option<f64>,
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

/// The light of a bake about a camera, on a device or by native code.
pub struct Streamed {
    scene: Scene,
    executor: Box<dyn Executor>,
    frame: SlotFrame,
    rows: Rows,
    local: Local,
    levels: Levels,
    emission: HashMap<u32, Vec3>,
    /// Slot of each leaf's node in the matrix.
    slot_of: Vec<u32>,
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
    let path = path.display().to_string();
    let reason = format!("its settings cannot be read: {reason}");
    localmatrix::BakeError::NotABake { path, reason }.into()
}

impl Streamed {
    /// Begins to read a bake of this scene, and loads the plan of its frames into the executor.
    ///
    /// # Errors
    /// [`File`](crate::ErrorKind::File) for a bake of another one; what the file and the matrix say; a device
    /// that is too small.
    pub fn new(
        scene: Scene,
        hash: [u8; 32],
        mut file: BakeFile,
        mut executor: Box<dyn Executor>,
        settings: StreamSettings,
    ) -> Result<Self, Error> {
        if file.head.scene != hash {
            let named = scene_of(&file)?;
            return Err(Reason::OtherScene { path: file.path().to_path_buf(), scene: named }.into());
        }
        let extra = Extra::decode(&file.extra).ok_or_else(|| not_a_bake(file.path(), "its voxels are wrong"))?;
        // Each table goes as soon as the next is made of it: they are as large as what stays.
        file.extra = Vec::new();
        if extra.voxels.len() != file.head.leaves as usize {
            return Err(not_a_bake(file.path(), "it has another number of patches than voxels"));
        }
        // Rows of the matrix on a device are whole vectors.
        let slots = settings.local.slots.next_multiple_of(SLOT_STEP);
        let settings = StreamSettings { local: LocalSettings { slots, ..settings.local }, ..settings };
        let local = Local::new(&file.nodes, settings.local)?;
        let leaves = extra.voxels.len();
        let area: f64 = local.leaf_area().iter().map(|&a| f64::from(a)).sum();
        let edge = scene::math::sqrt((area / leaves as f64) as f32);
        let emission = emission_of_nodes(&file.nodes, &extra.emission);
        let store = Store::new(file, settings.cache)?;
        let sky = constant_sky(&scene).extend(0.0);
        let levels = Levels::new(store.nodes(), extra, sky, store.sky(), edge)?;
        let frame = SlotFrame::load(&scene, &levels, settings.slots(), executor.as_mut())?;
        Ok(Self {
            scene,
            executor,
            frame,
            rows: Rows { store, points: HashMap::new() },
            local,
            levels,
            emission,
            slot_of: vec![NO_NODE; leaves],
            settings,
            frames: 0,
            eye: None,
        })
    }

    /// Patches of the world.
    pub fn patch_count(&self) -> usize {
        self.slot_of.len()
    }

    /// Bytes of the parts: of the matrix, its rows, the nodes, lookups, the buffers of frames, and
    /// the cache at most.
    pub fn bytes(&self) -> Vec<(&'static str, u64)> {
        let mut parts = self.local.bytes().to_vec();
        parts.push(("nodes", size_of_val(self.rows.nodes()) as u64));
        parts.push(("lookup", self.levels.bytes()));
        parts.push(("light", size_of_val(&self.slot_of[..]) as u64));
        parts.push(("frame", self.frame.bytes()));
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
        let last = Cell::new((0, Instant::now()));
        let slots = self.settings.local.slots as f32;
        let report_rows = |done: usize| {
            if done != last.get().0 {
                last.set((done, Instant::now()));
            }
            stopped.set(stopped.get() || !report(done as f32 / slots));
            !stopped.get() && last.get().1.elapsed() < PATIENCE
        };
        match self.local.settle(&mut self.rows, CameraPath { eye, predicted: eye }, &report_rows) {
            Ok(step) => Ok(step),
            // A disk that is too slow: coarser nodes do until it comes.
            Err(error) if Error::from(error.clone()).is_cancelled() => {
                if stopped.get() {
                    Err(Error::cancelled())
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
    /// What the matrix and the device say.
    pub fn frame(&mut self, lights: &[Light], camera: &Camera, stops: f32) -> Result<(Picture, StreamFrame), Error> {
        let mut done = StreamFrame::default();
        self.executor.wait()?;
        let eye = camera.eye;
        let last = self.eye.unwrap_or(eye);
        let predicted = eye + (eye - last) * self.settings.predicted_frames;
        self.eye = Some(eye);
        let is_first = self.frames == 0;
        let is_relit = self.set_lights(lights)?;
        if is_relit && !is_first {
            // Jumps are those of the matrix: what the lights do is there at once.
            self.find_source(true, false)?;
            self.product(&mut done)?;
            self.show_leaves(last, true, false)?;
        }

        let start = Instant::now();
        let all = if self.settings.at_rest { self.settle(eye, &|_| true)? } else { Step::default() };
        let changes = self.local.choose(&mut self.rows, CameraPath { eye, predicted });
        let has_settled = all.entered + all.left > 0;
        let has_changes = !changes.is_empty() || has_settled;
        done.step = self.local.apply(&self.rows, changes)?.after(all);
        timed(&mut done.update_ms, start);
        self.find_source(is_first, has_settled)?;
        if has_changes || is_first {
            self.product(&mut done)?;
        }
        let start = Instant::now();
        self.levels.find_apparent_size(self.rows.nodes(), self.local.cut(), eye);
        timed(&mut done.lookup_ms, start);
        self.show_leaves(eye, is_first || !is_relit, true)?;
        let picture = self.shade(camera, stops, &mut done)?;
        done.change = done.change.filter(|_| !is_first);
        done.nodes = self.local.cut().len();
        done.reader = self.rows.store.state();
        for time in self.executor.wait()? {
            done.add(&time);
        }
        self.frames += 1;
        Ok((picture, done))
    }

    /// Takes over the lights; says whether they have changed.
    fn set_lights(&mut self, lights: &[Light]) -> Result<bool, Error> {
        if self.scene.lighting.lights == lights {
            return Ok(false);
        }
        self.scene.lighting.check_lights(lights)?;
        self.scene.lighting.lights = lights.to_vec();
        if !self.frame.set_lights(self.executor.as_mut(), &self.scene)? {
            let settings = self.settings.slots();
            let light = self.frame.leaf_light(self.executor.as_mut())?;
            self.frame = SlotFrame::load(&self.scene, &self.levels, settings, self.executor.as_mut())?;
            self.frame.set_leaf_light(self.executor.as_mut(), &light)?;
        }
        Ok(true)
    }

    /// Puts what has changed of the nodes and of the matrix on the device, and finds the first
    /// exitance of the nodes where it is not that of the frame before: emission, and what they
    /// reflect of the lights and of the constant sky.
    fn find_source(&mut self, is_relit: bool, has_settled: bool) -> Result<(), Error> {
        let in_cut: HashSet<u32> = self.local.cut().iter().copied().collect();
        let sky = constant_sky(&self.scene);
        let Self { rows, emission, frame, local, executor, .. } = self;
        let executor = executor.as_mut();
        let has_nodes = frame.set_nodes(executor, local.matrix(), |node| {
            let reflected = sky * rows.store.sky()[node as usize] * rows.nodes()[node as usize].albedo;
            let emitted = emission.get(&node).copied().unwrap_or(Vec3::ZERO);
            let points = rows.points.get(&node).map_or(&[][..], Vec::as_slice);
            SlotNode { emission: (reflected + emitted).extend(0.0), points }
        })?;
        frame.follow(executor, local.matrix_mut(), has_settled)?;
        if has_nodes || is_relit {
            frame.find_source(executor)?;
        }
        if rows.points.len() > in_cut.len() + SPARE_POINTS {
            rows.points.retain(|node, _| in_cut.contains(node));
        }
        Ok(())
    }

    /// Irradiance of the slots, and where the leaves find theirs.
    fn product(&mut self, done: &mut StreamFrame) -> Result<(), Error> {
        let forest = self.local.forest();
        self.slot_of.fill(NO_NODE);
        for (slot, node) in self.local.matrix().patches() {
            let [first, end] = forest.run(node);
            forest.leaves()[first as usize..end as usize].iter().for_each(|&leaf| self.slot_of[leaf as usize] = slot);
        }
        done.method_ms += self.frame.multiply(self.executor.as_mut(), &self.local, &self.slot_of)?;
        Ok(())
    }

    /// Light of the leaves as they are shown, for the first time in a frame where that `begins`;
    /// with `fades` its jumps since the last time fade from now on.
    fn show_leaves(&mut self, eye: Vec3, begins: bool, fades: bool) -> Result<(), Error> {
        let jumps = fades.then(|| self.local.fade_params(self.frames > 0));
        let params = self.levels.params(eye, begins, jumps);
        Ok(self.frame.show_leaves(self.executor.as_mut(), &params)?)
    }

    fn shade(&mut self, camera: &Camera, stops: f32, done: &mut StreamFrame) -> Result<Picture, Error> {
        let is_measured = self.settings.is_measured;
        let (sums, seen) = self.frame.shade(self.executor.as_mut(), &self.scene, camera, is_measured)?;
        if let Some(seen) = seen {
            let scale = scene::stops_to_scale(stops);
            let moves = seen.iter().map(|pixel| pixel.as_ref().map_or([0.0; 2], |seen| moves(seen, scale)));
            let (mut changes, mut behind): (Vec<f32>, Vec<f32>) =
                moves.map(|[change, behind]| (change, behind)).unzip();
            done.change = all_but(&mut changes, 1000);
            done.behind = all_but(&mut behind, 100);
        }
        let count = self.settings.sub_frames.max(1) as f32;
        let pixels = sums.iter().map(|sum| (*sum / count).truncate()).collect();
        let (width, height) = self.settings.size;
        Ok(Picture::from_pixels(width, height, pixels)?)
    }
}

impl StreamSettings {
    fn slots(&self) -> SlotSettings {
        SlotSettings { slots: self.local.slots, size: self.size, sub_frames: self.sub_frames }
    }
}

impl StreamFrame {
    fn add(&mut self, time: &PassTime) {
        let part = match time.name.as_str() {
            "direct" => &mut self.direct_ms,
            "update" => &mut self.update_ms,
            "method" => &mut self.method_ms,
            "lookup" => &mut self.lookup_ms,
            _ => &mut self.shade_ms,
        };
        *part += time.milliseconds;
    }
}

/// Irradiance of a hemisphere that sees nothing but a constant sky, W/m².
fn constant_sky(scene: &Scene) -> Vec3 {
    let sky = scene.lighting.sky;
    if sky.map_width == 0 { sky.radiance * std::f32::consts::PI } else { Vec3::ZERO }
}

fn timed(milliseconds: &mut f64, start: Instant) {
    *milliseconds += start.elapsed().as_secs_f64() * 1e3;
}

/// Change of a surface's displayed value since the frame before, and its distance from the target, in 255ths.
fn moves(seen: &Seen, scale: f32) -> [f32; 2] {
    let now = luminance(seen.shown.truncate());
    let rest = luminance(seen.offset.truncate());
    let shown = displayed(now, scale);
    [(shown - displayed(seen.shown.w, scale)).abs(), (shown - displayed(now - rest, scale)).abs()]
}

fn displayed(irradiance: f32, scale: f32) -> f32 {
    let radiance = irradiance * SHOWN_ALBEDO / std::f32::consts::PI;
    255.0 * encode_srgb((radiance * scale).clamp(0.0, 1.0))
}

/// Value that one of so many values exceeds.
fn all_but(values: &mut [f32], one_of: usize) -> Option<f64> {
    let place = values.len().checked_sub(values.len() / one_of + 1)?;
    Some(f64::from(*values.select_nth_unstable_by(place, f32::total_cmp).1))
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
