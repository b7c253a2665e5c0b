//! The finish of surfaces in pictures: normals of maps, and rough specular lobes ([`scene::kernel::lobe`]). Lobes reflect
//! parallel, point and spot lights by the shadow rays of these, rectangles and emissive triangles with the share of them
//! that diffuse light sees, and the sky and indirect light by a ray in each sub-frame: what it meets sends the exitance of
//! its element. Light of the receivers is turned to the normals of maps by what they know of its directions.

use gpu_kernels::params::{CountParams, MediumDirectParams, MediumLargeParams, PixelParams};
use gpu_kernels::scene::{
    AddLobesPass, AddShinePass, ChainFinishPass, FinishPass, LobeOpenPass, LobeRayPass, LobeSharpPass, MattePass,
};
use patches::Columns;
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{PassId, Plan, Slice};
use runtime::recipe::patches::{DirectedLight, WeightTables};
use runtime::recipe::scene::{PassMedium, SceneTables};
use scene::gpu::{DirectParams, LargeParams, ShareParams};
use scene::{Finish, Lobe, Rgb, SurfacePoint};
use transport::{QUADRANTS, TriangleGrid};

use super::bands::Band;
use super::gather::ReceiverTables;
use super::shade::{Indirect, PixelBuffers};
use super::sky::SkyLight;
use crate::low_level::frame::FramePlan;

/// Tables behind the finish of a bake's surfaces.
#[derive(Clone, Copy, Debug)]
pub struct FinishTables {
    finishes: Slice<Finish>,
    receivers: Slice<SurfacePoint>,
    /// Irradiance of the quadrants of the receivers, and what of the sky's light.
    received: Slice<Rgb>,
    from_sky: Option<Slice<Rgb>>,
    weights: WeightTables,
    /// Elements of what rays of lobes meet, and their exitance.
    grids: Slice<TriangleGrid>,
    cells: Slice<u32>,
    exitance: Slice<Rgb>,
}

/// The buffers of a sub-frame.
#[derive(Clone, Copy, Debug)]
pub struct FinishLight {
    tables: FinishTables,
    lobes: Slice<Lobe>,
    /// What the lobes leave of the albedo.
    pub matte: Slice<Rgb>,
    /// What the lobes send to the eye of lights without extent, W/m²/sr, until it is added to the sums.
    shine: Slice<Rgb>,
    /// Sums over the sub-frames: reflectance, and what rays found of the sky and of surfaces.
    reflectance: Slice<Rgb>,
    of_sky: Slice<Rgb>,
    of_surfaces: Slice<Rgb>,
}

/// The passes of a band of a sub-frame whose push constants change.
#[derive(Clone, Copy, Debug)]
pub struct FinishPasses {
    sharp: PassId,
    open: PassId,
    ray: PassId,
}

impl FinishTables {
    /// Those of a bake, if any of its surfaces has a finish.
    pub fn new(frame: &mut FramePlan, receivers: &ReceiverTables, sky: &SkyLight) -> Option<Self> {
        let geometry = &frame.bake.scene.geometry;
        if geometry.finishes.is_empty() {
            return None;
        }
        let mut finishes = geometry.finishes.clone();
        finishes.resize(geometry.materials.len(), Finish::default());
        let points = &frame.bake.receivers.points;
        let quadrants = QUADRANTS * points.len();
        let plan = &mut frame.plan;
        let (grids, cells) = frame.bake.mesh.cell_columns(Columns::Elements);
        Some(Self {
            finishes: frame.tables.owned(plan, "finishes", finishes),
            receivers: frame.tables.part(plan, "receivers", points, |points| points),
            received: frame.received.part(0, quadrants),
            from_sky: sky.received.map(|received| received.part(0, quadrants)),
            weights: receivers.weights,
            grids: frame.tables.owned(plan, "element grids", grids.to_vec()),
            cells: frame.tables.owned(plan, "element cells", cells),
            exitance: frame.elements.exitance,
        })
    }
}

impl FinishLight {
    /// The buffers of so many pixels.
    pub fn new(plan: &mut Plan, tables: FinishTables, count: usize) -> Self {
        let matte = plan.array("pixel matte", count);
        Self {
            tables,
            lobes: plan.array("lobes", count),
            matte,
            shine: plan.array("lobe light", count),
            reflectance: plan.array("lobe reflectance", count),
            of_sky: plan.array("lobe sky", count),
            of_surfaces: plan.array("lobe surfaces", count),
        }
    }

    /// Adds the passes of a band that find the finish of what its pixels show, the first of which takes the push
    /// constants of primary rays.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add_surface(
        &self,
        plan: &mut Plan,
        scene: &SceneTables,
        buffers: &PixelBuffers,
        band: Band,
    ) -> Result<[PassId; 2], ExecutorError> {
        let SceneTables { geometry, lights, .. } = *scene;
        let finishes = self.tables.finishes;
        let hits = band.of(buffers.hits);
        let albedo = band.of(buffers.albedo);
        let points = band.of(buffers.points);
        let lobes = band.of(self.lobes);
        let camera = PixelParams { count: band.count, first: band.first, ..PixelParams::default() };
        let first = match buffers.chains {
            None => {
                let pass = FinishPass { hits, albedo, geometry, finishes, lights: lights.lights, points, lobes };
                plan.add("shade", &pass, &camera)?
            }
            Some(chains) => {
                let chains = band.of(chains);
                let pass = ChainFinishPass { hits, chains, albedo, geometry, finishes, points, lobes };
                plan.add("shade", &pass, &camera)?
            }
        };
        let matte = MattePass { lobes, albedo, matte: band.of(self.matte) };
        Ok([first, plan.add("shade", &matte, &CountParams { count: band.count })?])
    }

    /// Adds the passes of the lobes of a band: to `open` what they send to the eye of large sources, were nothing in the
    /// way. Turns the irradiance from the sky to the normals.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add_direct(
        &self,
        plan: &mut Plan,
        scene: &SceneTables,
        (buffers, indirect): (&PixelBuffers, &Indirect),
        (from_sky, open): (Slice<Rgb>, Slice<Rgb>),
        band: Band,
    ) -> Result<FinishPasses, ExecutorError> {
        let SceneTables { geometry, lights, groups, .. } = *scene;
        let points = band.of(buffers.points);
        let lobes = band.of(self.lobes);
        let shine = band.of(self.shine);
        let sharp = MediumDirectParams { count: band.count, ..MediumDirectParams::default() };
        let reflectance = band.of(self.reflectance);
        let pass = LobeSharpPass { points, lobes, geometry, lights, shine, reflectance };
        let sharp = plan.add("shade", &pass, &sharp)?;
        let large = LargeParams { count: band.count, first: band.first, ..LargeParams::default() };
        let open = LobeOpenPass { points, lobes, geometry, lights, groups, open: band.of(open) };
        let open = plan.add("shade", &open, &large)?;
        let FinishTables { grids, cells, exitance, .. } = self.tables;
        let (sky, sky_map) = (lights.sky, lights.sky_map);
        let (of_sky, of_surfaces) = (band.of(self.of_sky), band.of(self.of_surfaces));
        let ray = LobeRayPass { points, lobes, geometry, sky, sky_map, grids, cells, exitance, of_sky, of_surfaces };
        let ray = plan.add("shade", &ray, &MediumLargeParams { count: band.count, ..MediumLargeParams::default() })?;
        if let Some(received) = self.tables.from_sky {
            self.add_turn(plan, scene, (buffers, indirect), received, from_sky, band)?;
        }
        Ok(FinishPasses { sharp, open, ray })
    }

    /// Adds the pass that turns an irradiance of the pixels of a band, light of the receivers, to their normals.
    fn add_turn(
        &self,
        plan: &mut Plan,
        scene: &SceneTables,
        (buffers, indirect): (&PixelBuffers, &Indirect),
        received: Slice<Rgb>,
        irradiance: Slice<Rgb>,
        band: Band,
    ) -> Result<(), ExecutorError> {
        let Indirect::Interpolation { grids, receiver_cells, vertices, .. } = *indirect else { return Ok(()) };
        let pixels = DirectedLight {
            hits: band.of(buffers.hits),
            points: band.of(buffers.points),
            lobes: band.of(self.lobes),
            triangles: scene.geometry.triangles,
            grids,
            receiver_cells,
            vertices,
            receivers: self.tables.receivers,
            received,
            irradiance: band.of(irradiance),
        };
        self.tables.weights.turn(plan, "shade", &pixels, band.count)?;
        Ok(())
    }

    /// Adds the passes of a band behind that of its indirect irradiance, which is turned to the normals: what the lobes
    /// sent to the eye of direct light comes to both sums.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add_indirect(
        &self,
        plan: &mut Plan,
        scene: &SceneTables,
        of_pixels: (&PixelBuffers, &Indirect),
        (full, direct): (Slice<Rgb>, Slice<Rgb>),
        band: Band,
    ) -> Result<(), ExecutorError> {
        self.add_turn(plan, scene, of_pixels, self.tables.received, of_pixels.0.indirect, band)?;
        let pass = AddShinePass { shine: band.of(self.shine), full: band.of(full), direct: band.of(direct) };
        plan.add("shade", &pass, &CountParams { count: band.count })?;
        Ok(())
    }
}

impl FinishLight {
    /// Adds the pass behind all sub-frames that adds what rays found to the sums of the pixels of a band.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add_rays(
        &self,
        plan: &mut Plan,
        buffers: &PixelBuffers,
        (full, direct): (Slice<Rgb>, Slice<Rgb>),
        (band, size): (Band, (u32, u32)),
    ) -> Result<PassId, ExecutorError> {
        let about = band.with_pixels_about(size);
        let pass = AddLobesPass {
            points: about.of(buffers.points),
            reflectance: about.of(self.reflectance),
            of_sky: about.of(self.of_sky),
            of_surfaces: about.of(self.of_surfaces),
            full: band.of(full),
            direct: band.of(direct),
        };
        let push = ShareParams {
            count: band.count,
            first: band.first,
            width: size.0,
            height: size.1,
            first_about: about.first,
            count_about: about.count,
            // All of one surface are averaged.
            tolerance: f32::MAX,
            bend: 0.0,
        };
        Ok(plan.add("shade", &pass, &push)?)
    }

    /// Fills what the first sub-frame finds.
    ///
    /// # Errors
    /// What the device says.
    pub fn clear(&self, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
        [self.reflectance, self.of_sky, self.of_surfaces].into_iter().try_for_each(|sum| executor.clear(sum.buffer))
    }
}

impl FinishPasses {
    /// Makes the passes ready for a picture.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(
        &self,
        executor: &mut (dyn Executor + 'static),
        PassMedium { absorption }: PassMedium,
        direct: &DirectParams,
        large: &LargeParams,
    ) -> Result<(), ExecutorError> {
        executor.push(self.sharp, &MediumDirectParams { direct: *direct, absorption, count: direct.count })?;
        executor.push(self.open, large)?;
        executor.push(self.ray, &MediumLargeParams { large: *large, absorption, count: large.count })
    }
}
