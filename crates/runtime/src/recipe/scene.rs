//! Recipes of `scene`: tables that rays need, rays themselves, direct light, primary rays, shading and tone mapping.

use glam::Vec3;
use gpu_kernels::params::{
    CountParams, FollowParams, MediumDirectParams, MediumLargeParams, PixelParams, ToneMapParams,
};
use gpu_kernels::table::{self, Kernel};
use scene::{DirectParams, EmitterGroup, LargeParams, Light, MAX_EMITTER_GROUPS, Scene, ShareParams};

use super::{Bindings, Named, Tables, add_pass};
use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, PassId, Plan, Range};

/// A scene on the device: geometry once and for all, what shines anew where it changes.
#[derive(Clone, Debug)]
pub struct SceneTables {
    named: Vec<Named>,
    lights: BufferId,
    light_capacity: usize,
    materials: BufferId,
    emitters: BufferId,
    groups: BufferId,
    sky: BufferId,
    sky_map: BufferId,
    distributions: BufferId,
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

impl SceneTables {
    /// Puts the geometry on the device, with a capacity of `light_capacity` lights; [`Self::set_lights`],
    /// [`Self::set_distributions`] and [`Self::set_sky_and_emission`] fill the rest.
    pub fn new(plan: &mut Plan, tables: &mut Tables, scene: &Scene, light_capacity: usize) -> Self {
        let geometry = &scene.geometry;
        let mut named = vec![
            tables.named_part(plan, "nodes", geometry, |g| &g.nodes),
            tables.named_part(plan, "triangles", geometry, |g| &g.triangles),
            tables.named_part(plan, "uvs", geometry, |g| &g.uvs),
            tables.named_part(plan, "textures", geometry, |g| &g.textures),
            tables.named_part(plan, "texels", geometry, |g| &g.texels),
        ];
        let materials = plan.storage_for("materials", &scene.materials);
        let emitters = plan.storage_for("emitters", &scene.emitters);
        let groups = plan.storage("groups", (MAX_EMITTER_GROUPS * size_of::<EmitterGroup>()) as u64);
        let sky = plan.storage_for("sky", &[scene.lighting.sky]);
        let sky_map = plan.storage_for("sky_map", &scene.lighting.sky_map);
        let distributions = plan.storage_for("distributions", &scene.lighting.distributions);
        let lights = plan.storage("lights", (light_capacity * size_of::<Light>()) as u64);
        let changing = [
            ("materials", materials),
            ("emitters", emitters),
            ("groups", groups),
            ("sky", sky),
            ("sky_map", sky_map),
            ("distributions", distributions),
            ("lights", lights),
        ];
        named.extend(changing.map(|(name, buffer)| (name, Range::from(buffer))));
        let medium = PassMedium::of(scene);
        Self { named, lights, light_capacity, materials, emitters, groups, sky, sky_map, distributions, medium }
    }

    /// The buffers by the names of the kernels' bindings.
    pub fn bindings(&self) -> &[Named] {
        &self.named
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
        let sizes = [
            (self.materials, size_of_val(&scene.materials[..])),
            (self.emitters, size_of_val(&scene.emitters[..])),
            (self.sky_map, size_of_val(&scene.lighting.sky_map[..])),
            (self.distributions, size_of_val(&scene.lighting.distributions[..])),
        ];
        for (buffer, bytes) in sizes {
            if executor.plan().buffer(buffer)?.bytes != bytes as u64 {
                return Ok(false);
            }
        }
        Ok(scene.lighting.lights.len() <= self.light_capacity)
    }

    /// Puts the lights on the device: the first `light_capacity` ones.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_lights(&self, executor: &mut dyn Executor, lights: &[Light]) -> Result<(), ExecutorError> {
        let mut table = lights.to_vec();
        table.resize(self.light_capacity, Light::default());
        executor.upload(self.lights, &table)
    }

    /// Puts the distributions of luminaires on the device.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_distributions(&self, executor: &mut dyn Executor, table: &[f32]) -> Result<(), ExecutorError> {
        executor.upload(self.distributions, table)
    }

    /// Puts the sky, its map, and the emission of materials on the device.
    ///
    /// # Errors
    /// What the device says.
    pub fn set_sky_and_emission(&self, executor: &mut dyn Executor, scene: &Scene) -> Result<(), ExecutorError> {
        executor.upload(self.sky, &[scene.lighting.sky])?;
        executor.upload(self.sky_map, &scene.lighting.sky_map[..])?;
        executor.upload(self.materials, &scene.materials[..])?;
        let mut groups = scene.emitter_groups.to_vec();
        groups.resize(MAX_EMITTER_GROUPS, EmitterGroup::default());
        executor.upload(self.groups, &groups)?;
        executor.upload(self.emitters, &scene.emitters[..])
    }

    /// Adds the pass of direct irradiance at points, W/m². Bindings: `points`, `irradiance`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn direct_light(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        params: &DirectParams,
    ) -> Result<PassId, ExecutorError> {
        self.add_direct(plan, pass, [&table::SCENE_DIRECT_LIGHT, &table::SCENE_DIRECT_LIGHT_MEDIUM], bindings, params)
    }

    /// Adds the first of two kernels in air, the second in a medium.
    fn add_direct(
        &self,
        plan: &mut Plan,
        pass: &str,
        [in_air, in_medium]: [&'static Kernel; 2],
        bindings: Bindings,
        params: &DirectParams,
    ) -> Result<PassId, ExecutorError> {
        match self.medium.is_air() {
            true => add_pass(plan, pass, in_air, bindings, &self.named, params, params.count),
            false => {
                let push = self.medium.direct(params);
                add_pass(plan, pass, in_medium, bindings, &self.named, &push, params.count)
            }
        }
    }

    /// Adds the pass of the share of each changed light's colour that arrives at points. `params.light_count` is the
    /// number of changed lights. Bindings: `points`, `changed` (their numbers), `shares` and `occluders`
    /// (`light_capacity · count`).
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn direct_shares(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        params: &DirectParams,
    ) -> Result<PassId, ExecutorError> {
        add_pass(plan, pass, &table::SCENE_DIRECT_SHARES, bindings, &self.named, params, params.count)
    }

    /// Adds the pass of direct irradiance at points, W/m², from the shares of the lights. Bindings: `shares`,
    /// `surroundings` (what emitters and sky send there, W/m²), `irradiance`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn add_lights(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        params: &DirectParams,
    ) -> Result<PassId, ExecutorError> {
        add_pass(plan, pass, &table::SCENE_ADD_LIGHTS, bindings, &self.named, params, params.count)
    }

    /// Adds the pass of irradiance at points from the sky and from parallel, point and spot lights, W/m². Bindings:
    /// `points`, `from_sky`, `irradiance`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn sharp_light(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        params: &DirectParams,
    ) -> Result<PassId, ExecutorError> {
        self.add_direct(plan, pass, [&table::SCENE_SHARP_LIGHT, &table::SCENE_SHARP_LIGHT_MEDIUM], bindings, params)
    }

    /// Adds the passes of a sub-frame's radiance from rectangles and emitters, W/m²/sr: were nothing in the way, and of
    /// samples of it, those that are seen, as far as the medium leaves them, and all. Bindings: `hits`, `albedo`,
    /// `points`, `open`, `seen`, `sampled`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn large_light(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        params: &LargeParams,
    ) -> Result<[PassId; 2], ExecutorError> {
        let count = params.count;
        let open = add_pass(plan, pass, &table::SCENE_OPEN_LIGHT, bindings, &self.named, params, count)?;
        let seen = match self.medium.is_air() {
            true => add_pass(plan, pass, &table::SCENE_SEEN_LIGHT, bindings, &self.named, params, count)?,
            false => {
                let push = self.medium.large(params);
                add_pass(plan, pass, &table::SCENE_SEEN_LIGHT_MEDIUM, bindings, &self.named, &push, count)?
            }
        };
        Ok([open, seen])
    }

    /// Adds the pass that says of each ray whether something is in its way. Bindings: `rays`, `stopped`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn any_hits(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        rays: u32,
    ) -> Result<PassId, ExecutorError> {
        let count = CountParams { count: rays };
        add_pass(plan, pass, &table::SCENE_ANY_HIT, bindings, &self.named, &count, rays)
    }

    /// Adds the pass of the primary rays of a camera. Bindings: `hits`, `points`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn primary(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        params: &PixelParams,
    ) -> Result<PassId, ExecutorError> {
        add_pass(plan, pass, &table::SCENE_PRIMARY, bindings, &self.named, params, params.count)
    }

    /// Adds the pass of the primary rays of a camera by way of mirrors and through glass. Bindings: `hits`, `chains`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn follow(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        params: &FollowParams,
    ) -> Result<PassId, ExecutorError> {
        add_pass(plan, pass, &table::SCENE_FOLLOW, bindings, &self.named, params, params.count)
    }

    /// Adds the pass of the points that these rays show, and of the albedo there. Bindings: `hits`, `chains`, `points`,
    /// `albedo`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn chain_surface(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        pixels: u32,
    ) -> Result<PassId, ExecutorError> {
        let count = CountParams { count: pixels };
        add_pass(plan, pass, &table::SCENE_CHAIN_SURFACE, bindings, &self.named, &count, pixels)
    }

    /// [`Self::shade`] of what these rays show. Bindings: `chains`, `albedo`, `direct`, `indirect`, `sum`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn chain_shade(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        pixels: u32,
    ) -> Result<PassId, ExecutorError> {
        let count = CountParams { count: pixels };
        add_pass(plan, pass, &table::SCENE_CHAIN_SHADE, bindings, &self.named, &count, pixels)
    }

    /// Adds the pass of the albedo of what primary rays met. Bindings: `hits`, `albedo`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn albedo(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        pixels: u32,
    ) -> Result<PassId, ExecutorError> {
        let count = CountParams { count: pixels };
        add_pass(plan, pass, &table::SCENE_ALBEDO, bindings, &self.named, &count, pixels)
    }

    /// Adds the pass that adds the radiance of a sub-frame to the sum of each pixel, W/m²/sr. Bindings: `hits`,
    /// `albedo`, `direct`, `indirect`, `sum`.
    ///
    /// # Errors
    /// Buffers that are missing or too short.
    pub fn shade(
        &self,
        plan: &mut Plan,
        pass: &str,
        bindings: Bindings,
        params: &PixelParams,
    ) -> Result<PassId, ExecutorError> {
        add_pass(plan, pass, &table::SCENE_SHADE, bindings, &self.named, params, params.count)
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

/// Adds the pass that adds the radiance from rectangles and emitters to the sums of pixels, W/m²/sr: with nothing in
/// the way, times the share of the samples that is seen. Bindings: `points`, `open`, `seen`, `sampled`, `full`,
/// `direct`.
///
/// # Errors
/// Buffers that are missing or too short.
pub fn add_large_light(
    plan: &mut Plan,
    pass: &str,
    bindings: Bindings,
    params: &ShareParams,
) -> Result<PassId, ExecutorError> {
    add_pass(plan, pass, &table::SCENE_ADD_LARGE_LIGHT, bindings, &[], params, params.count)
}

/// Adds the pass of displayed colours: bytes red, green, blue, 255. Bindings: `sum`, `pixels`.
///
/// # Errors
/// Buffers that are missing or too short.
pub fn tone_map(
    plan: &mut Plan,
    pass: &str,
    bindings: Bindings,
    params: &ToneMapParams,
) -> Result<PassId, ExecutorError> {
    add_pass(plan, pass, &table::SCENE_TONE_MAP, bindings, &[], params, params.count)
}
