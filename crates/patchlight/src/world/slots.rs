//! The plan of a frame of a streamed world: direct light at the points of the nodes in the matrix →
//! their first exitance → the product → the leaves, over the levels → pixels.

use glam::Vec4;
use gpu_kernels::formfactor::AssembleSourcePass;
use gpu_kernels::params::CountParams;
use localmatrix::{LevelParams, LitPoint, Local, LocalMatrix, NO_NODE};
use runtime::executor::{DeviceKind, Executor, ExecutorError};
use runtime::plan::{PassId, Plan, Slice};
use runtime::recipe::formfactor::Surfaces;
use runtime::recipe::levels::LeafLight;
use runtime::recipe::localmatrix::SlotMatrix;
use runtime::recipe::patches::LookupTables;
use runtime::recipe::scene::SceneTables;
use runtime::recipe::{Tables, rgb_bytes};
use scene::gpu::DirectParams;
use scene::{Camera, Light, NONE, Rgb, Scene, SurfacePoint};
use web_time::Instant;

use super::bake::POINTS;
use super::levels::Levels;
use crate::bake::direct_params;
use crate::error::Error;
use crate::low_level::stage::direct::{self, PointLight};
use crate::low_level::stage::shade::{self, Indirect, PixelSettings, Shade, Shot};

/// Shadow rays of a point or pixel to each rectangle light, and to a sky map.
const AREA_RAYS: u32 = 4;
const SKY_RAYS: u32 = 8;
/// Capacity for lights, at least.
const MIN_LIGHTS: usize = 16;
/// Seed of the shadow rays of nodes.
const NODE_SEED: u32 = 0;

/// Settings that the plan is made for.
#[derive(Clone, Copy, Debug)]
pub struct SlotSettings {
    /// Slots of the matrix.
    pub slots: usize,
    /// Picture size, pixels.
    pub size: (u32, u32),
    /// Sub-frames a picture.
    pub sub_frames: u32,
}

/// A node that comes into a slot, as light sees it.
pub struct SlotNode<'a> {
    /// Emitted exitance and what it reflects of a constant sky, W/m².
    pub emission: Vec4,
    /// Points where its direct light is measured, at most [`POINTS`].
    pub points: &'a [LitPoint],
}

/// Values at the visible points of the first sub-frame, with no value where nothing is seen.
pub struct Seen {
    /// Light as it is shown, W/m²; the fourth component is the luminance of the frame before.
    pub shown: Vec4,
    /// Remaining jump, added to the target light, W/m².
    pub offset: Vec4,
}

/// Those of all pixels of the first sub-frame.
pub type SeenPixels = Vec<Option<Seen>>;

/// The loaded plan.
pub struct SlotFrame {
    scene: SceneTables,
    samples: Samples,
    /// The matrix on a device; native code multiplies by the host's own.
    matrix: Option<SlotMatrix>,
    /// Irradiance of the slots.
    irradiance: Slice<Rgb>,
    leaves: LeafLight,
    has_matrix: bool,
    /// Node of each slot whose points are on the device.
    nodes: Vec<u32>,
    pixels: Pixels,
    bytes: u64,
}

/// From the points of the nodes to their first exitance.
struct Samples {
    points: Slice<SurfacePoint>,
    albedo: Slice<Rgb>,
    emission: Slice<Rgb>,
    source: Slice<Rgb>,
    direct: PointLight,
    passes: [PassId; 3],
    /// Number of points.
    count: u32,
}

/// From the light of the leaves to pictures.
struct Pixels {
    /// Light of the leaves as it is shown, and what of it fades.
    shown: Slice<Rgb>,
    offset: Slice<Rgb>,
    offset_seen: Slice<Rgb>,
    see_offset: Vec<PassId>,
    shade: Shade,
}

/// Parameters of direct light in worlds: the emission of surfaces is in that of the nodes, and so is a constant sky.
fn world_params(scene: &Scene) -> DirectParams {
    DirectParams {
        emitter_count: 0,
        area_rays: AREA_RAYS,
        sky_rays: if samples_sky(scene) { SKY_RAYS } else { 0 },
        ..direct_params(scene)
    }
}

/// Parameters of direct light at the points of nodes.
fn node_params(scene: &Scene, count: u32) -> DirectParams {
    DirectParams { count, seed: NODE_SEED, ..world_params(scene) }
}

fn samples_sky(scene: &Scene) -> bool {
    scene.lighting.sky.map_width != 0
}

impl Samples {
    /// Adds the passes of `E = emission + Σ_k ρ_k H_d,k / n` over the n points of each slot's node,
    /// W/m².
    fn add(
        plan: &mut Plan,
        tables: &mut Tables,
        scene_tables: &SceneTables,
        scene: &Scene,
        slots: usize,
    ) -> Result<Self, ExecutorError> {
        let count = slots * POINTS;
        let points = plan.array("points", count);
        let albedo = plan.array("point albedo", count);
        let emission = plan.array("emission", slots);
        let reflected = plan.array("reflected", slots);
        let source = plan.array("source", slots);
        let direct = direct::at_points(plan, scene_tables, points, &node_params(scene, count as u32))?;
        let starts: Vec<u32> = (0..=slots).map(|slot| (slot * POINTS) as u32).collect();
        let gather = AssembleSourcePass {
            points,
            offsets: tables.owned(plan, "offsets", starts),
            direct: direct.irradiance,
            albedo,
            emission: tables.owned(plan, "no emission", vec![Vec4::ZERO; slots]),
            source: reflected,
        };
        let gather = plan.add("direct", &gather, &CountParams { count: slots as u32 })?;
        let sum = Surfaces {
            count: slots as u32,
            albedo: tables.owned(plan, "ones", vec![Vec4::ONE; slots]),
            source: emission,
            irradiance: reflected,
            exitance: source,
        };
        let add = sum.bounce(plan, "direct")?;
        let passes = [direct.pass, gather, add];
        Ok(Self { points, albedo, emission, source, direct, passes, count: count as u32 })
    }

    fn set(&self, executor: &mut (dyn Executor + 'static), slot: usize, node: &SlotNode) -> Result<(), ExecutorError> {
        let mut points = [SurfacePoint::default(); POINTS];
        let mut albedo = [Vec4::ZERO; POINTS];
        let weight = 1.0 / node.points.len().clamp(1, POINTS) as f32;
        for (k, point) in node.points.iter().take(POINTS).enumerate() {
            points[k] = SurfacePoint { position: point.position, patch: NONE, normal: point.normal, weight };
            albedo[k] = point.albedo.extend(0.0);
        }
        let slot_u64 = slot as u64;
        executor.upload_at(self.points.buffer, size_of_val(&points) as u64 * slot_u64, bytemuck::bytes_of(&points))?;
        executor.upload_at(self.albedo.buffer, size_of_val(&albedo) as u64 * slot_u64, bytemuck::bytes_of(&albedo))?;
        executor.upload_at(self.emission.buffer, rgb_bytes(slot), bytemuck::bytes_of(&node.emission))
    }
}

impl Pixels {
    /// Adds the passes of pictures, and of what is left of jumps at the visible points.
    fn add(
        plan: &mut Plan,
        scene_tables: &SceneTables,
        scene: &Scene,
        lookup: LookupTables,
        values: usize,
        settings: SlotSettings,
        binding_bytes: u64,
    ) -> Result<Self, ExecutorError> {
        let shown = plan.array("shown", values);
        let offset = plan.array("offset", values);
        let pixels = PixelSettings {
            size: settings.size,
            sub_frames: settings.sub_frames,
            binding_bytes,
            direct: world_params(scene),
            has_separate_direct: false,
            follows: scene.specular_material().is_some(),
            smooth_sky: None,
            finish: None,
        };
        let indirect = Indirect::Patches { lookup, values: shown };
        let shade = shade::add_pixels(plan, scene_tables, &indirect, &pixels)?;
        let count = settings.size.0 * settings.size.1;
        let offset_seen = plan.array("pixel offset", count as usize);
        let mut see_offset = Vec::new();
        for &band in shade.bands() {
            let points = band.of(shade.pixels.points);
            see_offset.push(lookup.at_points(plan, "shade", offset, points, band.of(offset_seen), band.count)?);
        }
        Ok(Self { shown, offset, offset_seen, see_offset, shade })
    }
}

impl SlotFrame {
    /// Makes the plan, loads it and uploads what stays.
    ///
    /// # Errors
    /// A device that is too small.
    pub fn load(
        scene: &Scene,
        levels: &Levels,
        settings: SlotSettings,
        executor: &mut (dyn Executor + 'static),
    ) -> Result<Self, Error> {
        let mut plan = Plan::new();
        let mut tables = Tables::new();
        let capacity = scene.lighting.lights.len().next_power_of_two().max(MIN_LIGHTS);
        let scene_tables = SceneTables::new(&mut plan, &mut tables, scene, capacity);
        let lookup = &levels.lookup;
        let lookup_tables = LookupTables::new(&mut plan, &mut tables, lookup);
        let bytes_of_tables = plan.bytes();
        let slots = settings.slots;
        let samples = Samples::add(&mut plan, &mut tables, &scene_tables, scene, slots)?;
        let on_device = executor.device().kind != DeviceKind::Native;
        let matrix = on_device.then(|| SlotMatrix::new(&mut plan, slots, samples.source)).transpose()?;
        let irradiance = match &matrix {
            Some(copy) => copy.irradiance(),
            None => plan.array("slot irradiance", slots),
        };
        let range = executor.device().max_storage_buffer_range;
        let pixels = Pixels::add(&mut plan, &scene_tables, scene, lookup_tables, lookup.values, settings, range)?;
        let shown = [pixels.shown, pixels.offset];
        let leaves = LeafLight::new(&mut plan, &mut tables, &levels.tables, irradiance, shown)?;
        let bytes = plan.bytes() - bytes_of_tables;

        executor.load(plan)?;
        tables.upload(executor)?;
        executor.clear(samples.points.buffer)?;
        for values in [samples.albedo, samples.emission, irradiance, pixels.shown, pixels.offset] {
            executor.clear(values.buffer)?;
        }
        scene_tables.set_sky_and_emission(executor, scene)?;
        scene_tables.set_distributions(executor, &scene.lighting.distributions)?;
        scene_tables.set_lights(executor, &scene.lighting.lights)?;
        pixels.shade.clear(executor)?;
        let nodes = vec![NO_NODE; slots];
        Ok(Self { scene: scene_tables, samples, matrix, irradiance, leaves, has_matrix: false, nodes, pixels, bytes })
    }

    /// Bytes of the buffers of frames: points, light and pixels, and a copy of the matrix if there
    /// is one.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Puts the lights on the device; says whether they fit.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_lights(&self, executor: &mut (dyn Executor + 'static), scene: &Scene) -> Result<bool, ExecutorError> {
        let lights: &[Light] = &scene.lighting.lights;
        if lights.len() > self.scene.light_capacity() {
            return Ok(false);
        }
        self.scene.set_lights(executor, lights)?;
        executor.push(self.samples.direct.pass, &node_params(scene, self.samples.count))?;
        Ok(true)
    }

    /// Puts the nodes that came into slots on the device, as `describe` tells them; says whether
    /// any came or went.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_nodes<'a>(
        &mut self,
        executor: &mut (dyn Executor + 'static),
        matrix: &LocalMatrix,
        describe: impl Fn(u32) -> SlotNode<'a>,
    ) -> Result<bool, ExecutorError> {
        let mut nodes = vec![NO_NODE; self.nodes.len()];
        matrix.patches().for_each(|(slot, node)| nodes[slot as usize] = node);
        let mut has_changes = false;
        for (slot, &node) in nodes.iter().enumerate() {
            if self.nodes[slot] == node {
                continue;
            }
            has_changes = true;
            let own = if node == NO_NODE { SlotNode { emission: Vec4::ZERO, points: &[] } } else { describe(node) };
            self.samples.set(executor, slot, &own)?;
        }
        self.nodes = nodes;
        Ok(has_changes)
    }

    /// Submits the passes of the first exitance of the slots.
    ///
    /// # Errors
    /// What the device says.
    pub fn find_source(&self, executor: &mut (dyn Executor + 'static)) -> Result<(), ExecutorError> {
        executor.submit_passes(&self.samples.passes)
    }

    /// Has the matrix on the device follow the host's; `is_new` where so much has changed that it
    /// is put there as a whole.
    ///
    /// # Errors
    /// What the device says.
    pub fn follow(
        &mut self,
        executor: &mut (dyn Executor + 'static),
        matrix: &mut LocalMatrix,
        is_new: bool,
    ) -> Result<(), ExecutorError> {
        let Some(copy) = &self.matrix else { return Ok(()) };
        if is_new || !self.has_matrix {
            self.has_matrix = true;
            return copy.upload(executor, matrix);
        }
        copy.follow(executor, matrix)?;
        copy.upload_places(executor, matrix)
    }

    /// Finds the irradiance of the slots that hold a node: the product with their first exitance, on
    /// the device or by the host, whose milliseconds come back. `slot_of` names the slot of each
    /// leaf's node.
    ///
    /// # Errors
    /// What the device and the matrix say.
    pub fn multiply(
        &self,
        executor: &mut (dyn Executor + 'static),
        local: &Local,
        slot_of: &[u32],
    ) -> Result<f64, Error> {
        self.leaves.set_slots(executor, slot_of)?;
        if let Some(copy) = &self.matrix {
            executor.submit_passes(copy.product())?;
            return Ok(0.0);
        }
        // Native code: the bytes lie in main memory.
        let source = executor.download_table(self.samples.source)?;
        let start = Instant::now();
        let (irradiance, _) = local.slot_product(&source, |_| true)?;
        let host_ms = start.elapsed().as_secs_f64() * 1e3;
        executor.upload(self.irradiance, &irradiance)?;
        Ok(host_ms)
    }

    /// Submits the light of the leaves as a camera sees it, from that of the slots.
    ///
    /// # Errors
    /// What the device says.
    pub fn show_leaves(
        &self,
        executor: &mut (dyn Executor + 'static),
        params: &LevelParams,
    ) -> Result<(), ExecutorError> {
        self.leaves.submit(executor, params)
    }

    /// Light of the leaves as it is shown, and what is left of its jumps, W/m²: what the next frame
    /// goes on from. Waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn leaf_light(&self, executor: &mut (dyn Executor + 'static)) -> Result<[Vec<Vec4>; 2], ExecutorError> {
        Ok([executor.download_table(self.pixels.shown)?, executor.download_table(self.pixels.offset)?])
    }

    /// Puts [`Self::leaf_light`] on the device.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_leaf_light(
        &self,
        executor: &mut (dyn Executor + 'static),
        [shown, offset]: &[Vec<Vec4>; 2],
    ) -> Result<(), ExecutorError> {
        executor.upload(self.pixels.shown, shown)?;
        executor.upload(self.pixels.offset, offset)
    }

    /// A picture's sums over its sub-frames, W/m²/sr; where that is measured, what its first
    /// sub-frame sees of the light of the leaves.
    ///
    /// # Errors
    /// What the device says.
    pub fn shade(
        &self,
        executor: &mut (dyn Executor + 'static),
        scene: &Scene,
        camera: &Camera,
        is_measured: bool,
    ) -> Result<(Vec<Vec4>, Option<SeenPixels>), ExecutorError> {
        let pixels = &self.pixels;
        let shade = &pixels.shade;
        // The same positions in every frame: what changes in pictures is light.
        let seeds: Vec<u32> = (0..shade.sub_frames()).collect();
        let shot = Shot {
            camera,
            light_count: scene.lighting.lights.len() as u32,
            emitter_count: 0,
            group_count: 0,
            has_sky: samples_sky(scene),
            seeds: &seeds,
        };
        shade.set(executor, &shot)?;
        if !is_measured {
            executor.submit_passes(shade.passes())?;
            return Ok((executor.download_table(shade.full)?, None));
        }
        let first = shade.first_passes();
        executor.submit_passes(first)?;
        executor.submit_passes(&pixels.see_offset)?;
        let hits = executor.download_table(shade.pixels.hits)?;
        let shown = executor.download_table(shade.pixels.indirect)?;
        let offset = executor.download_table(pixels.offset_seen)?;
        let seen =
            |((hit, shown), offset): ((&scene::Hit, Vec4), Vec4)| (!hit.is_miss()).then_some(Seen { shown, offset });
        let seen = hits.iter().zip(shown).zip(offset).map(seen).collect();
        executor.submit_passes(&shade.passes()[first.len()..])?;
        Ok((executor.download_table(shade.full)?, Some(seen)))
    }
}
