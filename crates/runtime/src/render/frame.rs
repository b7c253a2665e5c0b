//! A frame as a plan: direct light at the patches, bounces, receivers, and sub-frames of the picture.

use std::f32::consts::PI;

use bytemuck::Pod;
use formfactor::{Csr, Dense, GatherParams, SparseRows};
use glam::{Vec3, Vec4};
use gpu_kernels::params::{CountParams, PixelParams};
use gpu_kernels::table::{self, Kernel};
use scene::sampling::hash3;
use scene::{Camera, DirectParams, Hit, Light, Scene, SurfacePoint};

use super::receivers::MeshReceivers;
use super::senders::Senders;
use crate::error::Error;
use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, PassId, Plan, Range};

/// Shadow rays to area lights, and rays to the sky, in each sub-frame of a pixel.
const PIXEL_RAYS: u32 = 2;

/// What a frame is made of.
pub struct FrameParts<'a> {
    pub scene: &'a Scene,
    pub senders: &'a Senders,
    /// From facets to receivers, and from them to the mesh.
    pub receivers: &'a MeshReceivers,
    pub factors: &'a Dense,
    /// From patches to facets.
    pub facet_rows: &'a SparseRows,
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
    exitance: BufferId,
    full: BufferId,
    direct: BufferId,
    pixels: usize,
    patch_light: (PassId, DirectParams),
    sub_frames: Vec<SubFrame>,
    seed: u32,
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

impl Frame {
    /// Makes the plan, loads it and uploads everything that stays.
    pub fn load(mut executor: Box<dyn Executor>, parts: &FrameParts) -> Result<Self, Error> {
        let s = parts.scene;
        let (patches, points) = (parts.senders.patches.len(), parts.senders.points.len());
        let facets = parts.senders.facets.len();
        let receivers = parts.receivers.points.len();
        let pixels = parts.size.0 as usize * parts.size.1 as usize;
        // The default path of a scene without lights adds one.
        let light_room = s.lights.len().max(1);
        let rgb = |n: usize| (n * size_of::<Vec4>()) as u64;

        let mut plan = Plan::new();
        let mut uploads: Vec<(BufferId, Vec<u8>)> = Vec::new();
        let mut table = |plan: &mut Plan, name: &'static str, bytes: &[u8]| {
            let id = plan.storage(name, bytes.len() as u64);
            if !bytes.is_empty() {
                uploads.push((id, bytes.to_vec()));
            }
            (name, Range::from(id))
        };
        let sky = [s.sky];
        let scene_tables = [
            table(&mut plan, "nodes", bytemuck::cast_slice(&s.nodes)),
            table(&mut plan, "triangles", bytemuck::cast_slice(&s.triangles)),
            table(&mut plan, "uvs", bytemuck::cast_slice(&s.uvs)),
            table(&mut plan, "materials", bytemuck::cast_slice(&s.materials)),
            table(&mut plan, "textures", bytemuck::cast_slice(&s.textures)),
            table(&mut plan, "texels", bytemuck::cast_slice(&s.texels)),
            table(&mut plan, "emitters", bytemuck::cast_slice(&s.emitters)),
            table(&mut plan, "sky", bytemuck::cast_slice(&sky)),
            table(&mut plan, "sky_map", bytemuck::cast_slice(&s.sky_map)),
        ];
        let patch_points = table(&mut plan, "points", bytemuck::cast_slice(&parts.senders.points)).1;
        let offsets = table(&mut plan, "offsets", bytemuck::cast_slice(&parts.senders.offsets)).1;
        let point_albedo = table(&mut plan, "point albedo", bytemuck::cast_slice(&parts.senders.point_albedo)).1;
        let albedo = table(&mut plan, "albedo", bytemuck::cast_slice(&parts.senders.albedo)).1;
        let facet_albedo = table(&mut plan, "facet albedo", bytemuck::cast_slice(&parts.senders.facet_albedo)).1;
        // A constant sky's share of the direct light is known once and for all.
        let constant_sky = if s.sky.map_width == 0 { s.sky.radiance * PI } else { Vec3::ZERO };
        let sky_light = parts.senders.facet_albedo.iter().zip(&parts.facet_rows.sky_factor);
        let sky_light: Vec<Vec4> =
            sky_light.map(|(albedo, share)| *albedo * (constant_sky * *share).extend(0.0)).collect();
        let emission = table(&mut plan, "emission", bytemuck::cast_slice(&sky_light)).1;
        let patch_facets = table(&mut plan, "patch facets", bytemuck::cast_slice(&parts.senders.patch_facets)).1;
        let every: Vec<u32> = (0..facets as u32).collect();
        let facet_numbers = table(&mut plan, "facet numbers", bytemuck::cast_slice(&every)).1;
        let facet_shares = table(&mut plan, "facet shares", bytemuck::cast_slice(&parts.senders.facet_shares())).1;
        let mut csr = |plan: &mut Plan, names: [&'static str; 3], rows: &Csr| {
            [
                ("row_start", table(plan, names[0], bytemuck::cast_slice(&rows.row_start)).1),
                ("columns", table(plan, names[1], bytemuck::cast_slice(&rows.column_index)).1),
                ("values", table(plan, names[2], bytemuck::cast_slice(&rows.values)).1),
            ]
        };
        let facet_rows = csr(&mut plan, ["facet starts", "facet columns", "facet values"], &parts.facet_rows.factors);
        let receiver_rows = csr(&mut plan, ["row starts", "columns", "values"], &parts.receivers.rows);
        let node_rows = csr(&mut plan, ["node starts", "node columns", "node weights"], &parts.receivers.weights);
        let vectors = patches.div_ceil(4);
        let padded = padded_rows(parts.factors, vectors);
        let factors = table(&mut plan, "factors", bytemuck::cast_slice(&padded)).1;
        drop(padded);
        let grids = table(&mut plan, "grids", bytemuck::cast_slice(&parts.receivers.nodes.grids)).1;
        let cells = table(&mut plan, "receiver_cells", bytemuck::cast_slice(&parts.receivers.nodes.cells)).1;
        let vertices = table(&mut plan, "vertices", bytemuck::cast_slice(&parts.receivers.nodes.vertices)).1;

        let lights = plan.storage("lights", (light_room * size_of::<Light>()) as u64);
        let mut shared = scene_tables.to_vec();
        shared.push(("lights", Range::from(lights)));
        let patch_direct = plan.storage("patch direct", rgb(points));
        let facet_source = plan.storage("facet source", rgb(facets));
        let facet_irradiance = plan.storage("facet irradiance", rgb(facets));
        let facet_exitance = plan.storage("facet exitance", rgb(facets));
        let source = plan.storage("source", rgb(patches));
        let irradiance = plan.storage("irradiance", rgb(patches));
        // Whole vectors of four; what is beyond the patches stays zero.
        let exitance = plan.storage("exitance", rgb(4 * vectors));
        let received = plan.storage("received", rgb(receivers));
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
        // B = E to begin with: a bounce of no irradiance.
        let dark = plan.storage("dark", rgb(patches));
        let first = [("irradiance", Range::from(dark))];
        pass(&mut plan, "gather", &table::FORMFACTOR_BOUNCE, &first, &patch_tables, &patch_count, patches as u32)?;
        let row_bytes = (vectors * size_of::<Vec4>()) as u64;
        let block = block_rows(row_bytes, executor.device().max_storage_buffer_range, patches);
        // The last bounce arrives at the receivers, the one before at the facets.
        for _ in 2..parts.bounces {
            for first_row in (0..patches).step_by(block) {
                let rows = block.min(patches - first_row);
                let range = factors.buffer.range(first_row as u64 * row_bytes, rows as u64 * row_bytes);
                let push = GatherParams {
                    rows: rows as u32,
                    vectors: vectors as u32,
                    first_row: first_row as u32,
                    ..GatherParams::default()
                };
                let own = [("factors", range)];
                pass(&mut plan, "method", &table::FORMFACTOR_GATHER, &own, &patch_tables, &push, rows as u32)?;
            }
            pass(&mut plan, "method", &table::FORMFACTOR_BOUNCE, &[], &patch_tables, &patch_count, patches as u32)?;
        }
        let kernel = &table::FORMFACTOR_GATHER_CSR;
        if parts.bounces > 1 {
            let own = [("exitance", Range::from(exitance)), ("irradiance", Range::from(facet_irradiance))];
            pass(&mut plan, "lookup", kernel, &own, &facet_rows, &facet_count, facets as u32)?;
        }
        let own = [
            ("albedo", facet_albedo),
            ("source", Range::from(facet_source)),
            ("irradiance", Range::from(facet_irradiance)),
            ("exitance", Range::from(facet_exitance)),
        ];
        pass(&mut plan, "lookup", &table::FORMFACTOR_BOUNCE, &own, &[], &facet_count, facets as u32)?;
        let own = [("exitance", Range::from(facet_exitance)), ("irradiance", Range::from(received))];
        let push = CountParams { count: receivers as u32 };
        pass(&mut plan, "lookup", kernel, &own, &receiver_rows, &push, receivers as u32)?;
        let own = [("exitance", Range::from(received)), ("irradiance", Range::from(node_light))];
        let push = CountParams { count: nodes as u32 };
        pass(&mut plan, "lookup", kernel, &own, &node_rows, &push, nodes as u32)?;

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
            let kernel = &table::FORMFACTOR_INTERPOLATE;
            pass(&mut plan, "shade", kernel, &own, &pixel_tables, &count, pixel_count)?;
            let mut add = |own: Named| {
                let kernel = &table::SCENE_SHADE;
                pass(&mut plan, "shade", kernel, own, &pixel_tables, &camera, pixel_count)
            };
            let shade_full = add(&[("sum", Range::from(full))])?;
            let shade_direct = add(&[("sum", Range::from(direct)), ("indirect", Range::from(no_light))])?;
            sub_frames.push(SubFrame { light: (light_pass, light), primary, shade_full, shade_direct });
        }

        executor.load(plan)?;
        for (buffer, bytes) in uploads {
            executor.upload_at(buffer, 0, &bytes)?;
        }
        executor.upload(dark, &vec![Vec4::ZERO; patches])?;
        executor.upload(facet_irradiance, &vec![Vec4::ZERO; facets])?;
        executor.upload(no_light, &vec![Vec4::ZERO; pixels])?;
        let patch_light = (patch_light, parts.direct);
        let seed = parts.seed;
        Ok(Self {
            executor,
            lights,
            light_room,
            exitance: facet_exitance,
            full,
            direct,
            pixels,
            patch_light,
            sub_frames,
            seed,
        })
    }

    /// Renders frame `number` with these lights from this camera.
    pub fn render(&mut self, lights: &[Light], camera: &Camera, number: u32) -> Result<Rendered, Error> {
        let mut room = lights.to_vec();
        room.truncate(self.light_room);
        let light_count = room.len() as u32;
        room.resize(self.light_room, Light::default());
        self.executor.upload(self.lights, &room)?;
        let zeros = vec![Vec4::ZERO; self.pixels];
        self.executor.upload(self.full, &zeros)?;
        self.executor.upload(self.direct, &zeros)?;

        let (pass, params) = self.patch_light;
        self.executor.push(pass, &DirectParams { light_count, ..params })?;
        let count = self.sub_frames.len() as u32;
        for (k, sub) in self.sub_frames.iter().enumerate() {
            let seed = hash3(number * count + k as u32, 0x6672_616d, self.seed);
            let (pass, params) = sub.light;
            self.executor.push(pass, &DirectParams { light_count, seed, ..params })?;
            let push = PixelParams { camera: *camera, count: self.pixels as u32, seed, light_count, reserved: 0 };
            for pass in [sub.primary, sub.shade_full, sub.shade_direct] {
                self.executor.push(pass, &push)?;
            }
        }
        let mut times: Vec<(String, f64)> = Vec::new();
        for time in self.executor.run()? {
            match times.iter_mut().find(|(name, _)| *name == time.name) {
                Some((_, sum)) => *sum += time.milliseconds,
                None => times.push((time.name, time.milliseconds)),
            }
        }
        let full = self.picture(self.full, count)?;
        let direct = self.picture(self.direct, count)?;
        Ok((full, direct, times))
    }

    /// Exitance of the facets after the last frame, W/m².
    pub fn exitance(&mut self) -> Result<Vec<Vec4>, Error> {
        Ok(self.executor.download_table(self.exitance)?)
    }

    fn picture(&mut self, sum: BufferId, sub_frames: u32) -> Result<Vec<Vec3>, Error> {
        let scale = 1.0 / sub_frames as f32;
        let sums: Vec<Vec4> = self.executor.download_table(sum)?;
        Ok(sums.iter().map(|c| c.truncate() * scale).collect())
    }
}

/// The matrix with rows of whole vectors of four.
fn padded_rows(factors: &Dense, vectors: usize) -> Vec<f32> {
    let mut padded = vec![0.0; factors.rows * vectors * 4];
    for i in 0..factors.rows {
        padded[i * vectors * 4..][..factors.columns].copy_from_slice(factors.row(i));
    }
    padded
}

/// Rows of a block that fits into one binding; blocks begin at multiples of 256 bytes.
fn block_rows(row_bytes: u64, range: u64, rows: usize) -> usize {
    let most = (range / row_bytes.max(1)) as usize / 16 * 16;
    most.clamp(16, rows.max(16))
}
