//! Recipes of `scene`: its tables on a device, and direct light with or without a medium.

use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;
use gpu_kernels::params::{MediumDirectParams, MediumLargeParams};
use gpu_kernels::scene::{
    DirectLightMediumPass, DirectLightPass, OpenLightPass, SeenLightMediumPass, SeenLightPass, SharpLightMediumPass,
    SharpLightPass,
};
use scene::gpu::{BvhNode, DirectParams, EmitterGroup, LargeParams, Triangle, TriangleUv};
use scene::{Geometry, Hit, Light, MAX_EMITTER_GROUPS, Rgb, Scene, SurfacePoint};

use super::{Tables, part_of};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{GeometrySlices, LightSlices, PassId, Plan, Slice};

/// A scene on the device: geometry once and for all, what shines anew where it changes.
#[derive(Clone, Copy, Debug)]
pub struct SceneTables {
    /// Geometry and materials.
    pub geometry: GeometrySlices,
    /// What shines.
    pub lights: LightSlices,
    /// Groups of emissive triangles.
    pub groups: Slice<EmitterGroup>,
    light_capacity: usize,
    medium: PassMedium,
}

/// Medium between the surfaces of a scene, which decides the kernels and push constants of direct light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PassMedium {
    /// Absorption, 1/m; 0 for air.
    pub absorption: Vec3,
}

impl PassMedium {
    /// That of a scene.
    pub fn of(scene: &Scene) -> Self {
        Self { absorption: scene.geometry.absorption }
    }

    fn is_air(self) -> bool {
        self.absorption == Vec3::ZERO
    }

    fn direct(self, direct: &DirectParams) -> MediumDirectParams {
        MediumDirectParams { direct: *direct, absorption: self.absorption, count: direct.count }
    }

    fn large(self, large: &LargeParams) -> MediumLargeParams {
        MediumLargeParams { large: *large, absorption: self.absorption, count: large.count }
    }

    /// Changes the settings of a pass of [`SceneTables::direct_light`] or [`SceneTables::sharp_light`].
    ///
    /// # Errors
    /// What the device says.
    pub fn push_direct(
        self,
        executor: &mut (dyn Executor + 'static),
        pass: PassId,
        params: &DirectParams,
    ) -> Result<(), ExecutorError> {
        match self.is_air() {
            true => executor.push(pass, params),
            false => executor.push(pass, &self.direct(params)),
        }
    }

    /// Changes the settings of the passes of [`SceneTables::large_light`].
    ///
    /// # Errors
    /// What the device says.
    pub fn push_large(
        self,
        executor: &mut (dyn Executor + 'static),
        [open, seen]: [PassId; 2],
        params: &LargeParams,
    ) -> Result<(), ExecutorError> {
        executor.push(open, params)?;
        match self.is_air() {
            true => executor.push(seen, params),
            false => executor.push(seen, &self.large(params)),
        }
    }
}

/// Bindings of [`SceneTables::large_light`]: an element a pixel.
#[derive(Clone, Copy, Debug)]
pub struct LargeLight {
    /// Primary hits.
    pub hits: Slice<Hit>,
    /// Albedo there, by which samples are weighed.
    pub albedo: Slice<Rgb>,
    /// The part of it that reflects diffusely.
    pub matte: Slice<Rgb>,
    /// The hits as points to be lit.
    pub points: Slice<SurfacePoint>,
    /// Sum of the radiance were nothing in the way, W/m²/sr.
    pub open: Slice<Rgb>,
    /// Sum of the samples that are seen, as far as the medium leaves them.
    pub seen: Slice<Rgb>,
    /// Sum of all samples.
    pub sampled: Slice<Rgb>,
}

impl SceneTables {
    /// Puts the geometry on the device, with a capacity of `light_capacity` lights; [`Self::set_lights`],
    /// [`Self::set_distributions`] and [`Self::set_sky_and_emission`] fill the rest.
    pub fn new(plan: &mut Plan, tables: &mut Tables, scene: &Scene, light_capacity: usize) -> Self {
        let geometry = &scene.geometry;
        Self {
            geometry: GeometrySlices {
                nodes: tables.part(plan, "nodes", geometry, |g| &g.nodes),
                triangles: tables.part(plan, "triangles", geometry, |g| &g.triangles),
                uvs: tables.part(plan, "uvs", geometry, |g| &g.uvs),
                textures: tables.part(plan, "textures", geometry, |g| &g.textures),
                texels: tables.part(plan, "texels", geometry, |g| &g.texels),
                materials: plan.array("materials", scene.materials.len()),
            },
            lights: LightSlices {
                emitters: plan.array("emitters", scene.emitters.len()),
                sky: plan.array("sky", 1),
                sky_map: plan.array("sky_map", scene.lighting.sky_map.len()),
                distributions: plan.array("distributions", scene.lighting.distributions.len()),
                lights: plan.array("lights", light_capacity),
            },
            groups: plan.array("groups", MAX_EMITTER_GROUPS),
            light_capacity,
            medium: PassMedium::of(scene),
        }
    }

    /// Medium between the surfaces.
    pub fn medium(&self) -> PassMedium {
        self.medium
    }

    /// Lights that fit.
    pub fn light_capacity(&self) -> usize {
        self.light_capacity
    }

    /// Returns true if the tables of a scene's light sources have the sizes of those on the device.
    ///
    /// # Errors
    /// Buffers of another plan.
    pub fn fits(&self, executor: &dyn Executor, scene: &Scene) -> Result<bool, ExecutorError> {
        let lighting = &scene.lighting;
        let sizes = [
            (self.geometry.materials.buffer, size_of_val(&scene.materials[..])),
            (self.lights.emitters.buffer, size_of_val(&scene.emitters[..])),
            (self.lights.sky_map.buffer, size_of_val(&lighting.sky_map[..])),
            (self.lights.distributions.buffer, size_of_val(&lighting.distributions[..])),
        ];
        for (buffer, bytes) in sizes {
            if executor.plan().buffer(buffer)?.bytes != bytes as u64 {
                return Ok(false);
            }
        }
        Ok(lighting.lights.len() <= self.light_capacity)
    }

    /// Puts the lights on the device: the first `light_capacity` ones.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_lights(&self, executor: &mut dyn Executor, lights: &[Light]) -> Result<(), ExecutorError> {
        let mut table = lights.to_vec();
        table.resize(self.light_capacity, Light::default());
        executor.upload(self.lights.lights, &table)
    }

    /// Puts the distributions of luminaires on the device.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_distributions(&self, executor: &mut dyn Executor, table: &[f32]) -> Result<(), ExecutorError> {
        executor.upload(self.lights.distributions, table)
    }

    /// Puts the sky, its map, and the emission of materials on the device.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_sky_and_emission(&self, executor: &mut dyn Executor, scene: &Scene) -> Result<(), ExecutorError> {
        executor.upload(self.lights.sky, &[scene.lighting.sky])?;
        executor.upload(self.lights.sky_map, &scene.lighting.sky_map)?;
        executor.upload(self.geometry.materials, &scene.materials)?;
        let mut groups = scene.emitter_groups.to_vec();
        groups.resize(MAX_EMITTER_GROUPS, EmitterGroup::default());
        executor.upload(self.groups, &groups)?;
        executor.upload(self.lights.emitters, &scene.emitters)
    }

    /// Takes over where the meshes of a geometry are that move: one with as many triangles and nodes as that of the plan.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_moving(&self, executor: &mut dyn Executor, geometry: &Arc<Geometry>) -> Result<(), ExecutorError> {
        let bytes = |range: Range<usize>, size: usize| range.start * size..range.end * size;
        let triangles = geometry.moving();
        let nodes = [bytes(0..1, size_of::<BvhNode>()), bytes(geometry.moving_nodes(), size_of::<BvhNode>())];
        let changed = [bytes(triangles.clone(), size_of::<Triangle>())];
        let changed_uvs = [bytes(triangles, size_of::<TriangleUv>())];
        let Self { geometry: of, .. } = self;
        executor.share_changed(of.nodes.buffer, part_of(geometry, |g| &g.nodes), &nodes)?;
        executor.share_changed(of.triangles.buffer, part_of(geometry, |g| &g.triangles), &changed)?;
        executor.share_changed(of.uvs.buffer, part_of(geometry, |g| &g.uvs), &changed_uvs)
    }

    /// Adds the pass of direct irradiance at points, W/m².
    ///
    /// # Errors
    /// Buffers that are empty or too short.
    pub fn direct_light(
        &self,
        plan: &mut Plan,
        pass: &str,
        points: Slice<SurfacePoint>,
        irradiance: Slice<Rgb>,
        params: &DirectParams,
    ) -> Result<PassId, ExecutorError> {
        let Self { geometry, lights, medium, .. } = *self;
        Ok(if medium.is_air() {
            plan.add(pass, &DirectLightPass { points, geometry, lights, irradiance }, params)?
        } else {
            let bound = DirectLightMediumPass { points, geometry, lights, irradiance };
            plan.add(pass, &bound, &medium.direct(params))?
        })
    }

    /// Adds the pass of irradiance at points from the sky and from parallel, point and spot lights, W/m².
    ///
    /// # Errors
    /// Buffers that are empty or too short.
    pub fn sharp_light(
        &self,
        plan: &mut Plan,
        pass: &str,
        points: Slice<SurfacePoint>,
        from_sky: Slice<Rgb>,
        irradiance: Slice<Rgb>,
        params: &DirectParams,
    ) -> Result<PassId, ExecutorError> {
        let Self { geometry, lights, medium, .. } = *self;
        Ok(if medium.is_air() {
            plan.add(pass, &SharpLightPass { points, from_sky, geometry, lights, irradiance }, params)?
        } else {
            let bound = SharpLightMediumPass { points, from_sky, geometry, lights, irradiance };
            plan.add(pass, &bound, &medium.direct(params))?
        })
    }

    /// Adds the passes of a sub-frame's radiance from rectangles and emitters: were nothing in the way, and of samples
    /// of it.
    ///
    /// # Errors
    /// Buffers that are empty or too short.
    pub fn large_light(
        &self,
        plan: &mut Plan,
        pass: &str,
        pixels: &LargeLight,
        params: &LargeParams,
    ) -> Result<[PassId; 2], ExecutorError> {
        let Self { geometry, lights, groups, medium, .. } = *self;
        let LargeLight { hits, albedo, matte, points, open, seen, sampled } = *pixels;
        let open = OpenLightPass { hits, albedo: matte, points, geometry, lights, groups, open };
        let open = plan.add(pass, &open, params)?;
        let seen = if medium.is_air() {
            plan.add(pass, &SeenLightPass { hits, albedo, points, geometry, lights, seen, sampled }, params)?
        } else {
            let bound = SeenLightMediumPass { hits, albedo, points, geometry, lights, seen, sampled };
            plan.add(pass, &bound, &medium.large(params))?
        };
        Ok([open, seen])
    }
}

/// Loads a plan that has a scene, with its lights, and what `add` adds. The plan that the device had goes.
///
/// # Errors
/// What `add` says; what the device says: a scene too large for it, say.
pub fn load_scene<T>(
    executor: &mut (dyn Executor + 'static),
    scene: &Scene,
    add: impl FnOnce(&mut Plan, &SceneTables) -> Result<T, ExecutorError>,
) -> Result<T, ExecutorError> {
    let mut plan = Plan::new();
    let mut tables = Tables::new();
    let lights = &scene.lighting.lights;
    let scene_tables = SceneTables::new(&mut plan, &mut tables, scene, lights.len().max(1));
    let added = add(&mut plan, &scene_tables)?;
    executor.load(plan)?;
    tables.upload(executor)?;
    scene_tables.set_lights(executor, lights)?;
    scene_tables.set_sky_and_emission(executor, scene)?;
    Ok(added)
}
