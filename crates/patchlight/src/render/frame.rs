//! A frame as a plan: direct light at the patches, bounces, receivers, and sub-frames of the picture.

mod hits;
mod local;
mod operator;
mod sampled;

use std::borrow::Cow;
use std::f32::consts::PI;

use bytemuck::{Pod, cast_slice};
use formfactor::{Csr, HitRows, QUARTERS};
use glam::{Vec3, Vec4};
use gpu_kernels::params::{CountParams, PixelParams};
use gpu_kernels::table::{self, Kernel};
use multibounce::Acceleration;
use patches::{Lookup, LookupParams};
use scene::sampling::hash3;
use scene::{Camera, DirectParams, Hit, Light, Scene, SurfacePoint};

use super::decode::Decoder;
use super::exchange::Exchange;
use super::local::LocalLight;
use super::operator::{LAST_BOUNCES, PatchOperator};
use super::receivers::MeshReceivers;
use super::senders::Senders;
use super::temporal::SampledRows;
use crate::error::Error;
use hits::HitTables;
use local::LocalStage;
use operator::OperatorTables;
pub use operator::receivers_on_device;
pub use operator::{decoder, product_decoded, product_on_device};
use runtime::executor::{Executor, ExecutorError, PassTime};
use runtime::plan::{BufferId, PassId, Plan, RANGE_ALIGNMENT, Range};
use sampled::{Level, LevelPasses};

/// Shadow rays to area lights, and rays to the sky, in each sub-frame of a pixel.
const PIXEL_RAYS: u32 = 2;

/// What a frame is made of.
pub struct FrameParts<'a> {
    pub scene: &'a Scene,
    pub senders: &'a Senders,
    /// From facets to receivers, and from them to the mesh.
    pub receivers: &'a MeshReceivers,
    /// From patches to patches, and from facets to facets.
    pub exchange: &'a Exchange,
    /// From patches to patches in one product, of all bounces, or with feedback of one.
    pub operator: Option<&'a PatchOperator>,
    /// What decodes its texture blocks; the kernel unless it is said.
    pub decoder: Option<Decoder>,
    /// Bounces of a frame that begin with the light of the frame before, and how they use where that was going.
    pub feedback: Option<(u32, Acceleration)>,
    /// Rows that are sampled instead of multiplied by.
    pub sampled: Option<&'a SampledRows>,
    /// The matrix round the camera, instead of products with all patches.
    pub local: Option<LocalLight>,
    /// Takes the patches' own irradiance to the pixels, instead of the receivers.
    pub lookup: Option<&'a Lookup>,
    pub bounces: u32,
    /// Direct light at the patches' sample points.
    pub direct: DirectParams,
    pub size: (u32, u32),
    pub sub_frames: u32,
    pub seed: u32,
}

/// The loaded plan and what changes in it from frame to frame.
pub struct Frame {
    executor: Box<dyn Executor>,
    lights: BufferId,
    light_room: usize,
    source: BufferId,
    irradiance: BufferId,
    facet_irradiance: BufferId,
    exitance: BufferId,
    node_irradiance: BufferId,
    full: BufferId,
    direct: BufferId,
    pixels: usize,
    patch_light: (PassId, DirectParams),
    /// What is to be done before the first frame.
    feedback: Option<Feedback>,
    sampling: Sampling,
    local: Option<LocalStage>,
    /// All passes but those of the picture.
    light_passes: Vec<PassId>,
    sub_frames: Vec<SubFrame>,
    seed: u32,
}

/// Bounces whose light stays from frame to frame.
struct Feedback {
    /// Passes that find E.
    light: Vec<PassId>,
    /// Passes of a frame's bounces.
    bounce: Vec<PassId>,
    /// Times after which nothing changes, when the lights do not.
    times: u32,
}

/// Light that is sampled from frame to frame.
#[derive(Default)]
struct Sampling {
    /// Number of the next frame.
    frame: u32,
    /// Between patches, to facets, to receivers: what comes before, and how often light is to be summed before the first
    /// frame.
    levels: Vec<(std::ops::Range<usize>, LevelPasses, u32)>,
    /// Passes so far.
    passes: usize,
    is_settled: bool,
}

impl Sampling {
    fn add<'a>(
        &mut self,
        plan: &mut Plan,
        uploads: &mut Uploads<'a>,
        level: &Level<'a>,
        range: u64,
        bounces: u32,
    ) -> Result<(), ExecutorError> {
        let before = self.passes..plan.passes().len();
        self.levels.push((before, LevelPasses::new(plan, uploads, level, range)?, bounces));
        self.passes = plan.passes().len();
        Ok(())
    }

    /// Takes the samples of the next frame; before the first one all rows are summed.
    fn next_frame(&mut self, executor: &mut dyn Executor, passes: &[PassId]) -> Result<(), ExecutorError> {
        if !self.is_settled {
            for (before, level, bounces) in &self.levels {
                executor.run_passes(&passes[before.clone()])?;
                for _ in 0..*bounces {
                    level.settle(executor)?;
                }
            }
            self.is_settled = true;
        }
        for (_, level, _) in &self.levels {
            level.set_frame(executor, self.frame)?;
        }
        self.frame = self.frame.wrapping_add(1);
        Ok(())
    }
}

/// The passes of a sub-frame whose push constants change.
struct SubFrame {
    light: (PassId, DirectParams),
    primary: PassId,
    shade_full: PassId,
    shade_direct: PassId,
}

/// A rendered picture: radiance of all light, of direct light only, and the milliseconds of each pass.
pub type Rendered = (Vec<Vec3>, Vec<Vec3>, Vec<(String, f64)>);

/// Buffers by the names that the kernels' bindings have.
type Named<'a> = &'a [(&'static str, Range)];

/// Adds a pass whose bindings are found by name: in `own` first, then in `shared`.
fn pass<P: Pod>(
    plan: &mut Plan,
    name: &str,
    kernel: &'static Kernel,
    own: Named,
    shared: Named,
    push: &P,
    elements: u32,
) -> Result<PassId, ExecutorError> {
    let find = |binding: &'static str| own.iter().chain(shared).find(|(n, _)| *n == binding).map(|(_, range)| *range);
    // A binding without a buffer ends the list; the plan then names it.
    let bindings: Vec<Range> = kernel.bindings.iter().map_while(|b| find(b.name)).collect();
    Ok(plan.pass(name, kernel, &bindings, push, elements)?)
}

/// Tables that stay, and where they go.
#[derive(Default)]
struct Uploads<'a>(Vec<(BufferId, Cow<'a, [u8]>)>);

impl<'a> Uploads<'a> {
    fn table(&mut self, plan: &mut Plan, name: &'static str, bytes: impl Into<Cow<'a, [u8]>>) -> Range {
        let bytes = bytes.into();
        let id = plan.storage(name, bytes.len() as u64);
        if !bytes.is_empty() {
            self.0.push((id, bytes));
        }
        Range::from(id)
    }

    /// A table that bindings find by its name.
    fn named(&mut self, plan: &mut Plan, name: &'static str, bytes: impl Into<Cow<'a, [u8]>>) -> (&'static str, Range) {
        (name, self.table(plan, name, bytes))
    }

    fn csr(&mut self, plan: &mut Plan, names: [&'static str; 3], rows: &'a Csr) -> [(&'static str, Range); 3] {
        [
            ("row_start", self.table(plan, names[0], cast_slice(&rows.row_start))),
            ("columns", self.table(plan, names[1], cast_slice(&rows.column_index))),
            ("values", self.table(plan, names[2], cast_slice(&rows.values))),
        ]
    }
}

impl Frame {
    /// Makes the plan, loads it and uploads everything that stays.
    pub fn load(mut executor: Box<dyn Executor>, mut parts: FrameParts) -> Result<Self, Error> {
        let local = parts.local.take();
        let parts = &parts;
        let s = parts.scene;
        let (patches, points) = (parts.senders.patches.len(), parts.senders.points.len());
        let facets = parts.senders.facets.len();
        let receivers = parts.receivers.points.len();
        let pixels = parts.size.0 as usize * parts.size.1 as usize;
        // The default path of a scene without lights adds one.
        let light_room = s.lighting.lights.len().max(1);
        let rgb = |n: usize| (n * size_of::<Vec4>()) as u64;

        let mut plan = Plan::new();
        // What a frame needs and no part holds.
        let sky = [s.lighting.sky];
        // A constant sky's share of the direct light is known once and for all.
        let constant_sky = if s.lighting.sky.map_width == 0 { s.lighting.sky.radiance * PI } else { Vec3::ZERO };
        let sky_light = parts.senders.facet_albedo.iter().zip(&parts.exchange.sky_factor);
        let sky_light: Vec<Vec4> =
            sky_light.map(|(albedo, share)| *albedo * (constant_sky * *share).extend(0.0)).collect();
        let every: Vec<u32> = (0..facets as u32).collect();
        let facet_shares = parts.senders.facet_shares();

        let mut uploads = Uploads::default();
        let scene_tables = [
            uploads.named(&mut plan, "nodes", cast_slice(&s.geometry.nodes)),
            uploads.named(&mut plan, "triangles", cast_slice(&s.geometry.triangles)),
            uploads.named(&mut plan, "uvs", cast_slice(&s.geometry.uvs)),
            uploads.named(&mut plan, "materials", cast_slice(&s.materials)),
            uploads.named(&mut plan, "textures", cast_slice(&s.geometry.textures)),
            uploads.named(&mut plan, "texels", cast_slice(&s.geometry.texels)),
            uploads.named(&mut plan, "emitters", cast_slice(&s.emitters)),
            uploads.named(&mut plan, "sky", cast_slice(&sky)),
            uploads.named(&mut plan, "sky_map", cast_slice(&s.lighting.sky_map)),
        ];
        let patch_points = uploads.table(&mut plan, "points", cast_slice(&parts.senders.points));
        let offsets = uploads.table(&mut plan, "offsets", cast_slice(&parts.senders.offsets));
        let point_albedo = uploads.table(&mut plan, "point albedo", cast_slice(&parts.senders.point_albedo));
        let albedo = uploads.table(&mut plan, "albedo", cast_slice(&parts.senders.albedo));
        let facet_albedo = uploads.table(&mut plan, "facet albedo", cast_slice(&parts.senders.facet_albedo));
        let emission = uploads.table(&mut plan, "emission", cast_slice(&sky_light));
        let patch_facets = uploads.table(&mut plan, "patch facets", cast_slice(&parts.senders.patch_facets));
        let facet_numbers = uploads.table(&mut plan, "facet numbers", cast_slice(&every));
        let facet_shares = uploads.table(&mut plan, "facet shares", cast_slice(&facet_shares));
        let (no_rows, no_hits) = (Csr::default(), HitRows::default());
        let mut sampling = Sampling::default();
        let settings = parts.sampled.map(|sampled| sampled.settings).unwrap_or_default();
        let [patch_samples, facet_samples, receiver_samples] = match parts.sampled {
            Some(sampled) => [&sampled.patches, &sampled.facets, &sampled.receivers].map(Option::as_ref),
            None => [None; 3],
        };
        // Patches have facets, and facets rows of their own, unless they are the patches.
        let facet_hits = parts.exchange.facet_rows.as_ref().filter(|_| facet_samples.is_none());
        let facet_hits = facet_hits.map(|hits| (hits, HitTables::new(&mut plan, &mut uploads, hits)));
        let at_facets = parts.bounces > 1 && parts.lookup.is_none();
        let is_sparse = parts.operator.is_none() && patch_samples.is_none() && local.is_none();
        let for_facets = at_facets && facet_samples.is_none() && facet_hits.is_none();
        let patch_factors = if is_sparse || for_facets { &parts.exchange.factors } else { &no_rows };
        let patch_rows = uploads.csr(&mut plan, ["patch starts", "patch columns", "patch values"], patch_factors);
        let range = executor.device().max_storage_buffer_range;
        let decoder = parts.decoder.unwrap_or(Decoder::Kernel);
        let operator =
            parts.operator.map(|operator| OperatorTables::new(&mut plan, &mut uploads, operator, range, decoder));
        let names = ["smoothing starts", "smoothing columns", "smoothing weights"];
        let smoothing_rows = uploads.csr(&mut plan, names, &parts.receivers.smoothing);
        let node_rows =
            uploads.csr(&mut plan, ["node starts", "node columns", "node weights"], &parts.receivers.weights);
        let hits = if receiver_samples.is_some() { &no_hits } else { &parts.receivers.rows };
        let hit_tables = HitTables::new(&mut plan, &mut uploads, hits);
        let grids = uploads.table(&mut plan, "grids", cast_slice(&parts.receivers.nodes.grids));
        let cells = uploads.table(&mut plan, "receiver_cells", cast_slice(&parts.receivers.nodes.cells));
        let vertices = uploads.table(&mut plan, "vertices", cast_slice(&parts.receivers.nodes.vertices));

        let lookup_tables = parts.lookup.map(|lookup| {
            [
                uploads.named(&mut plan, "cells", cast_slice(&lookup.cells)),
                uploads.named(&mut plan, "offsets", cast_slice(&lookup.offsets)),
                uploads.named(&mut plan, "entries", cast_slice(&lookup.entries)),
            ]
        });

        let lights = plan.storage("lights", (light_room * size_of::<Light>()) as u64);
        let mut shared = scene_tables.to_vec();
        shared.push(("lights", Range::from(lights)));
        let patch_direct = plan.storage("patch direct", rgb(points));
        let facet_source = plan.storage("facet source", rgb(facets));
        let facet_irradiance = plan.storage("facet irradiance", rgb(facets));
        let facet_exitance = plan.storage("facet exitance", rgb(facets));
        let source = plan.storage("source", rgb(patches));
        let values = parts.lookup.map_or(patches, |lookup| lookup.values);
        let irradiance = plan.storage("irradiance", rgb(values));
        let exitance = plan.storage("exitance", rgb(patches));
        // From each quarter of the receivers, then smoothed from all of them.
        let first_smooth = parts.receivers.first_smooth();
        let received = plan.storage("received", rgb(first_smooth + receivers));
        let nodes = parts.receivers.nodes.points.len();
        let node_light = plan.storage("node irradiance", rgb(nodes));

        let patch_own = [("points", patch_points), ("irradiance", Range::from(patch_direct))];
        let patch_light =
            pass(&mut plan, "direct", &table::SCENE_DIRECT_LIGHT, &patch_own, &shared, &parts.direct, points as u32)?;
        let (patch_count, facet_count) = (CountParams { count: patches as u32 }, CountParams { count: facets as u32 });
        // First exitance of the facets from their samples, of the patches from their facets.
        let own = [
            ("points", patch_points),
            ("offsets", offsets),
            ("direct", Range::from(patch_direct)),
            ("albedo", point_albedo),
            ("emission", emission),
            ("source", Range::from(facet_source)),
        ];
        let kernel = &table::FORMFACTOR_ASSEMBLE_SOURCE;
        pass(&mut plan, "gather", kernel, &own, &[], &facet_count, facets as u32)?;
        let own = [
            ("row_start", patch_facets),
            ("columns", facet_numbers),
            ("values", facet_shares),
            ("exitance", Range::from(facet_source)),
            ("irradiance", Range::from(source)),
        ];
        pass(&mut plan, "gather", &table::FORMFACTOR_GATHER_CSR, &own, &[], &patch_count, patches as u32)?;
        let patch_tables = [
            ("albedo", albedo),
            ("source", Range::from(source)),
            ("irradiance", Range::from(irradiance)),
            ("exitance", Range::from(exitance)),
        ];
        let facet_tables = [
            ("albedo", facet_albedo),
            ("source", Range::from(facet_source)),
            ("irradiance", Range::from(facet_irradiance)),
            ("exitance", Range::from(facet_exitance)),
        ];
        let dark = plan.storage("dark", rgb(patches.max(facets)));
        if parts.feedback.is_none() && patch_samples.is_none() {
            // B = E to begin with: a bounce of no irradiance.
            let first = [("irradiance", Range::from(dark))];
            pass(&mut plan, "gather", &table::FORMFACTOR_BOUNCE, &first, &patch_tables, &patch_count, patches as u32)?;
        }
        let kernel = &table::FORMFACTOR_GATHER_CSR;
        // The last bounce arrives at the receivers, the one before at the facets; all of them where patches are receivers.
        let on_patches =
            if parts.lookup.is_some() { parts.bounces.max(1) } else { parts.bounces.saturating_sub(LAST_BOUNCES) };
        let products = match parts.feedback {
            Some((products, _)) => products,
            None if patch_samples.is_some() || local.is_some() => 0,
            None if operator.is_some() => 1,
            None => on_patches,
        };
        let change = plan.storage("change", rgb(if parts.feedback.is_some() { patches } else { 0 }));
        let before = plan.passes().len();
        if let Some(rows) = patch_samples {
            let (source, reflected) = (Range::from(source), Range::from(irradiance));
            let level = Level { name: "method", rows, settings, source, albedo, reflected, irradiance };
            sampling.add(&mut plan, &mut uploads, &level, range, on_patches)?;
            pass(&mut plan, "method", &table::FORMFACTOR_BOUNCE, &[], &patch_tables, &patch_count, patches as u32)?;
        }
        // Native code multiplies by the host's own matrix.
        let on_device = executor.device().index.is_some();
        let local = local
            .map(|light| LocalStage::new(&mut plan, &mut uploads, light, (source, irradiance), on_device))
            .transpose()?;
        if local.is_some() {
            pass(&mut plan, "method", &table::FORMFACTOR_BOUNCE, &[], &patch_tables, &patch_count, patches as u32)?;
        }
        for _ in 0..products {
            if let Some(operator) = &operator {
                operator.product(&mut plan, range, exitance, irradiance)?;
                if let Some((_, acceleration)) = parts.feedback {
                    let (own, push) = ([("change", Range::from(change))], acceleration.params(patches as u32));
                    pass(&mut plan, "method", &table::MULTIBOUNCE_FEEDBACK, &own, &patch_tables, &push, push.count)?;
                    continue;
                }
                pass(&mut plan, "method", &table::FORMFACTOR_BOUNCE, &[], &patch_tables, &patch_count, patches as u32)?;
                continue;
            }
            let own = [("exitance", Range::from(exitance)), ("irradiance", Range::from(irradiance))];
            pass(&mut plan, "method", kernel, &own, &patch_rows, &patch_count, patches as u32)?;
            pass(&mut plan, "method", &table::FORMFACTOR_BOUNCE, &[], &patch_tables, &patch_count, patches as u32)?;
        }
        let method: Vec<PassId> = plan.all_passes().split_off(before);
        // The first of the two last bounces: between facets, each with its own first exitance and its share of what the patch
        // reflects.
        let mut shining = exitance;
        if at_facets && parts.exchange.facet_rows.is_some() {
            shining = facet_exitance;
            let patch_light = plan.storage("patch light at facets", rgb(facets));
            let patch: Vec<u32> = every.iter().map(|&facet| parts.senders.patch_of(facet)).collect();
            let starts: Vec<u32> = (0..=facets as u32).collect();
            let own = [
                ("row_start", uploads.table(&mut plan, "facet starts", cast_slice(&starts).to_vec())),
                ("columns", uploads.table(&mut plan, "facet patches", cast_slice(&patch).to_vec())),
                ("values", uploads.table(&mut plan, "facet ones", cast_slice(&vec![1.0f32; facets]).to_vec())),
                ("exitance", Range::from(irradiance)),
                ("irradiance", Range::from(patch_light)),
            ];
            pass(&mut plan, "lookup", kernel, &own, &[], &facet_count, facets as u32)?;
            let own = [("irradiance", Range::from(patch_light))];
            pass(&mut plan, "lookup", &table::FORMFACTOR_BOUNCE, &own, &facet_tables, &facet_count, facets as u32)?;
        }
        // What is only passed on is reflected from nothing.
        if let Some(rows) = facet_samples {
            let (source, albedo, reflected) = (Range::from(shining), facet_albedo, Range::from(dark));
            let level =
                Level { name: "lookup", rows, settings, source, albedo, reflected, irradiance: facet_irradiance };
            sampling.add(&mut plan, &mut uploads, &level, range, 1)?;
        } else if let Some((hits, tables)) = facet_hits.filter(|_| at_facets) {
            tables.gather(&mut plan, hits, range, shining, facet_irradiance)?;
        } else if at_facets {
            let own = [("exitance", Range::from(shining)), ("irradiance", Range::from(facet_irradiance))];
            pass(&mut plan, "lookup", kernel, &own, &patch_rows, &facet_count, facets as u32)?;
        }
        pass(&mut plan, "lookup", &table::FORMFACTOR_BOUNCE, &[], &facet_tables, &facet_count, facets as u32)?;
        if let Some(rows) = receiver_samples {
            let (source, albedo, reflected) = (Range::from(facet_exitance), facet_albedo, Range::from(dark));
            let level = Level { name: "lookup", rows, settings, source, albedo, reflected, irradiance: received };
            sampling.add(&mut plan, &mut uploads, &level, range, 1)?;
        }
        hit_tables.gather(&mut plan, hits, range, facet_exitance, received)?;
        if receivers > 0 {
            let quarters = received.range(0, rgb(QUARTERS * receivers));
            let own = [("exitance", quarters), ("irradiance", received.range(rgb(first_smooth), rgb(receivers)))];
            let push = CountParams { count: receivers as u32 };
            pass(&mut plan, "lookup", kernel, &own, &smoothing_rows, &push, receivers as u32)?;
        }
        let own = [("exitance", Range::from(received)), ("irradiance", Range::from(node_light))];
        let push = CountParams { count: nodes as u32 };
        pass(&mut plan, "lookup", kernel, &own, &node_rows, &push, nodes as u32)?;

        let light_passes = plan.all_passes();
        // Sub-frames share the pixel buffers: what one leaves the next overwrites.
        let hits = plan.storage("hits", (pixels * size_of::<Hit>()) as u64);
        let pixel_points = plan.storage("pixel points", (pixels * size_of::<SurfacePoint>()) as u64);
        let pixel_direct = plan.storage("pixel direct", rgb(pixels));
        let pixel_indirect = plan.storage("pixel indirect", rgb(pixels));
        let no_light = plan.storage("no light", rgb(pixels));
        let full = plan.storage("full", rgb(pixels));
        let direct = plan.storage("direct sum", rgb(pixels));
        let mut pixel_tables = shared.clone();
        pixel_tables.extend([
            ("hits", Range::from(hits)),
            ("points", Range::from(pixel_points)),
            ("direct", Range::from(pixel_direct)),
            ("indirect", Range::from(pixel_indirect)),
            ("grids", grids),
            ("receiver_cells", cells),
            ("vertices", vertices),
            ("values", Range::from(node_light)),
        ]);
        let pixel_count = pixels as u32;
        let count = CountParams { count: pixel_count };
        let camera = PixelParams { count: pixel_count, ..PixelParams::default() };
        let light = DirectParams {
            count: pixel_count,
            area_rays: PIXEL_RAYS,
            sky_rays: if s.has_sky() { PIXEL_RAYS } else { 0 },
            ..parts.direct
        };
        let mut sub_frames = Vec::new();
        for _ in 0..parts.sub_frames.max(1) {
            let kernel = &table::SCENE_PRIMARY;
            let primary = pass(&mut plan, "shade", kernel, &[], &pixel_tables, &camera, pixel_count)?;
            let own = [("irradiance", Range::from(pixel_direct))];
            let kernel = &table::SCENE_DIRECT_LIGHT;
            let light_pass = pass(&mut plan, "shade", kernel, &own, &pixel_tables, &light, pixel_count)?;
            let own = [("irradiance", Range::from(pixel_indirect))];
            match (parts.lookup, &lookup_tables) {
                (Some(lookup), Some(tables)) => {
                    let own = [own[0], tables[0], tables[1], tables[2], ("values", Range::from(irradiance))];
                    let push = LookupParams { count: pixel_count, ..lookup.params };
                    pass(&mut plan, "shade", &table::PATCHES_LOOKUP, &own, &pixel_tables, &push, pixel_count)?;
                }
                _ => {
                    let kernel = &table::FORMFACTOR_INTERPOLATE;
                    pass(&mut plan, "shade", kernel, &own, &pixel_tables, &count, pixel_count)?;
                }
            }
            let mut add = |own: Named| {
                let kernel = &table::SCENE_SHADE;
                pass(&mut plan, "shade", kernel, own, &pixel_tables, &camera, pixel_count)
            };
            let shade_full = add(&[("sum", Range::from(full))])?;
            let shade_direct = add(&[("sum", Range::from(direct)), ("indirect", Range::from(no_light))])?;
            sub_frames.push(SubFrame { light: (light_pass, light), primary, shade_full, shade_direct });
        }

        let all = plan.all_passes();
        executor.load(plan)?;
        for (buffer, bytes) in uploads.0 {
            executor.upload_at(buffer, 0, &bytes)?;
        }
        executor.upload(dark, &vec![Vec4::ZERO; patches.max(facets)])?;
        executor.upload(exitance, &vec![Vec4::ZERO; patches])?;
        if parts.feedback.is_some() {
            executor.upload(change, &vec![Vec4::ZERO; patches])?;
        }
        executor.upload(irradiance, &vec![Vec4::ZERO; values])?;
        executor.upload(facet_irradiance, &vec![Vec4::ZERO; facets])?;
        executor.upload(no_light, &vec![Vec4::ZERO; pixels])?;
        for (_, level, _) in &sampling.levels {
            level.clear(&mut *executor)?;
        }
        let feedback = parts.feedback.map(|(products, _)| Feedback {
            // What comes before is the light of the patches.
            light: (0..before).map(|k| all[k]).collect(),
            bounce: method,
            times: on_patches.div_ceil(products.max(1)),
        });
        let patch_light = (patch_light, parts.direct);
        let seed = parts.seed;
        Ok(Self {
            executor,
            lights,
            light_room,
            source,
            irradiance,
            facet_irradiance,
            exitance: facet_exitance,
            node_irradiance: node_light,
            full,
            direct,
            pixels,
            patch_light,
            feedback,
            sampling,
            local,
            light_passes,
            sub_frames,
            seed,
        })
    }

    /// Renders frame `number` with these lights from this camera.
    pub fn render(&mut self, lights: &[Light], camera: &Camera, number: u32) -> Result<Rendered, Error> {
        let light_count = self.set_lights(lights)?;
        let zeros = vec![Vec4::ZERO; self.pixels];
        self.executor.upload(self.full, &zeros)?;
        self.executor.upload(self.direct, &zeros)?;
        let count = self.sub_frames.len() as u32;
        for (k, sub) in self.sub_frames.iter().enumerate() {
            let seed = sub_frame_seed(number, count, k as u32, self.seed);
            let (pass, params) = sub.light;
            self.executor.push(pass, &DirectParams { light_count, seed, ..params })?;
            let push = PixelParams { camera: *camera, count: self.pixels as u32, seed, light_count, reserved: 0 };
            for pass in [sub.primary, sub.shade_full, sub.shade_direct] {
                self.executor.push(pass, &push)?;
            }
        }
        let all = self.executor.plan().all_passes();
        let times = self.run(&all)?;
        let full = self.picture(self.full, count)?;
        let direct = self.picture(self.direct, count)?;
        Ok((full, direct, times))
    }

    /// The light of a frame without its picture; the milliseconds of each pass.
    pub fn advance(&mut self, lights: &[Light]) -> Result<Vec<(String, f64)>, Error> {
        self.set_lights(lights)?;
        let passes = self.light_passes.clone();
        self.run(&passes)
    }

    /// Runs passes, with the matrix round the camera in its place among them; the milliseconds of each.
    fn run(&mut self, passes: &[PassId]) -> Result<Vec<(String, f64)>, Error> {
        let Some(local) = &mut self.local else { return Ok(by_name(self.executor.run_passes(passes)?)) };
        let (before, after) = passes.split_at(local.first_pass());
        let mut times = self.executor.run_passes(before)?;
        times.extend(local.light(&mut *self.executor)?);
        times.extend(self.executor.run_passes(&after[local.passes()..])?);
        Ok(by_name(times))
    }

    /// The matrix round the camera.
    pub fn local(&mut self) -> Option<&mut LocalLight> {
        self.local.as_mut().map(LocalStage::light_mut)
    }

    /// Sets the lights of the frame, and lets their light settle before the first one; their number.
    fn set_lights(&mut self, lights: &[Light]) -> Result<u32, Error> {
        let mut room = lights.to_vec();
        room.truncate(self.light_room);
        let light_count = room.len() as u32;
        room.resize(self.light_room, Light::default());
        self.executor.upload(self.lights, &room)?;
        let (pass, params) = self.patch_light;
        self.executor.push(pass, &DirectParams { light_count, ..params })?;
        if let Some(Feedback { light, bounce, times }) = self.feedback.take() {
            self.executor.run_passes(&light)?;
            for _ in 0..times {
                self.executor.run_passes(&bounce)?;
            }
        }
        self.sampling.next_frame(&mut *self.executor, &self.light_passes)?;
        Ok(light_count)
    }

    /// Sets the irradiance of the facets, W/m², where no pass of the plan finds it: with one bounce only.
    pub fn set_facet_irradiance(&mut self, irradiance: &[Vec4]) -> Result<(), Error> {
        Ok(self.executor.upload(self.facet_irradiance, irradiance)?)
    }

    /// First exitance of the patches in the last frame, W/m².
    pub fn source(&mut self) -> Result<Vec<Vec4>, Error> {
        Ok(self.executor.download_table(self.source)?)
    }

    /// Irradiance of the facets after the last frame, W/m²: of all bounces but the last.
    pub fn facet_irradiance(&mut self) -> Result<Vec<Vec4>, Error> {
        Ok(self.executor.download_table(self.facet_irradiance)?)
    }

    /// Irradiance of the patches after the last frame, W/m²: the values of a lookup, of all bounces; without one of all but
    /// the last two.
    pub fn irradiance(&mut self) -> Result<Vec<Vec4>, Error> {
        Ok(self.executor.download_table(self.irradiance)?)
    }

    /// Exitance of the facets after the last frame, W/m².
    pub fn exitance(&mut self) -> Result<Vec<Vec4>, Error> {
        Ok(self.executor.download_table(self.exitance)?)
    }

    /// Irradiance of the nodes of the receivers' mesh after the last frame, W/m².
    pub fn node_irradiance(&mut self) -> Result<Vec<Vec4>, Error> {
        Ok(self.executor.download_table(self.node_irradiance)?)
    }

    fn picture(&mut self, sum: BufferId, sub_frames: u32) -> Result<Vec<Vec3>, Error> {
        let scale = 1.0 / sub_frames as f32;
        let sums: Vec<Vec4> = self.executor.download_table(sum)?;
        Ok(sums.iter().map(|c| c.truncate() * scale).collect())
    }
}

/// Times of passes of one name added up, in the order of the first of each.
fn by_name(passes: Vec<PassTime>) -> Vec<(String, f64)> {
    let mut times: Vec<(String, f64)> = Vec::new();
    for time in passes {
        match times.iter_mut().find(|(name, _)| *name == time.name) {
            Some((_, sum)) => *sum += time.milliseconds,
            None => times.push((time.name, time.milliseconds)),
        }
    }
    times
}

/// Seed of sub-frame k of a frame.
pub fn sub_frame_seed(frame: u32, sub_frames: u32, k: u32, seed: u32) -> u32 {
    hash3(frame * sub_frames + k, 0x6672_616d, seed)
}

/// Rows from the first on in blocks that begin at multiples of `step` and are as long as `fits(first, end)` allows, one
/// step at least: the plan says so when even that is too much for a binding.
fn row_blocks(rows: usize, step: usize, fits: impl Fn(usize, usize) -> bool) -> Vec<std::ops::Range<usize>> {
    let (mut blocks, mut first) = (Vec::new(), 0);
    while first < rows {
        let end = |steps: usize| (first + steps * step).min(rows);
        let steps = (1..=(rows - first).div_ceil(step)).take_while(|&k| fits(first, end(k))).last().unwrap_or(1);
        blocks.push(first..end(steps));
        first = end(steps);
    }
    blocks
}
