#![doc = include_str!("../README.md")]

mod baked;
mod gather;
mod layout;
mod lights;
#[cfg(feature = "vulkan")]
mod on_device;
#[cfg(feature = "vulkan")]
mod renderer;
mod shared;
mod sky;
mod systems;
mod upload;
mod work;

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use bevy::app::{App, Plugin, PostUpdate};
use bevy::asset::{AssetApp as _, Handle};
use bevy::camera::visibility::VisibilitySystems;
use bevy::ecs::prelude::*;
use bevy::light::SimulationLightSystems;
use bevy::transform::TransformSystems;
pub use patchlight::DeviceChoice;
use patchlight::bake::Bake;
pub use patchlight::method::MethodSettings;

pub use baked::{PatchlightBake, PatchlightBakeError};
pub use lights::lights_of;
#[cfg(feature = "vulkan")]
pub use renderer::{PatchlightRendererError, vulkan_renderer};

/// Lights what is marked with [`PatchlightStatic`], and what moves among it.
#[derive(Clone, Copy, Debug, Default)]
pub struct PatchlightPlugin;

/// Settings, read when a bake begins; change them, and [`PatchlightSettings::rebuild`] begins another.
#[derive(Resource, Clone, Debug)]
pub struct PatchlightSettings {
    /// About how many patches light is found between.
    pub patch_count: usize,
    /// Edge of a lightmap's texel, m.
    pub texel: f32,
    /// Points where light is found, over what suits the patches.
    pub receiver_density: f32,
    /// About how many probes the irradiance volume has, for what has no lightmap; 0 for no volume.
    pub probe_count: u32,
    /// Method for light between patches.
    pub method: MethodSettings,
    /// Where light is found: on the processor, or with the feature `vulkan` on a Vulkan device that is opened beside Bevy's.
    pub device: DeviceChoice,
    /// Finds light on the device that Bevy draws with, and writes it to textures there, with no copy to the processor; then
    /// `device` is not asked. Needs the feature `vulkan` and a renderer of [`vulkan_renderer`].
    pub shares_device: bool,
    /// A bake of this scene, which takes the place of a bake at start. One of another scene is left, with a warning.
    pub bake: Option<Handle<PatchlightBake>>,
    /// Waits for the finished bake, and in each frame for its light, instead of working beside the frames: for pictures
    /// and tests.
    pub wait: bool,
    /// Counts the bakes asked for.
    pub revision: u32,
}

impl Default for PatchlightSettings {
    /// 2,000 patches, texels of 10 cm, 1,024 probes, on the processor, beside the frames.
    fn default() -> Self {
        Self {
            patch_count: 2000,
            texel: 0.1,
            receiver_density: 1.0,
            probe_count: 1024,
            method: MethodSettings::default(),
            device: DeviceChoice::Cpu,
            shares_device: false,
            bake: None,
            wait: false,
            revision: 0,
        }
    }
}

impl PatchlightSettings {
    /// Bakes anew in the next frame, though no mesh has changed.
    pub fn rebuild(&mut self) {
        self.revision += 1;
    }
}

/// A mesh that rests, or the root of a scene whose meshes all do: light is reflected by it, and it gets a lightmap. It
/// has a [`StandardMaterial`](bevy::pbr::StandardMaterial); translucent ones are left out, as if they were clear.
/// Meshes that come, go or are put elsewhere make a new bake.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct PatchlightStatic;

/// A mesh that moves: it hides light and reflects it. Closed, of a few hundred triangles. Its own light is that of the
/// irradiance volume.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct PatchlightMoving;

/// What the light is doing.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum PatchlightStage {
    /// For meshes, materials and textures to be loaded; nothing is marked, or not all of it is there.
    #[default]
    Waiting,
    /// The first light is on its way.
    Preparing,
    /// There is light, which becomes finer: the share of the work that is done.
    Refining(f32),
    /// The bake is as fine as the settings ask for.
    Finished,
    /// There is no light, for this reason.
    Failed(String),
}

/// How far the light is. [`PatchlightStatus::stage`] is for loading screens, the rest for read-outs.
#[derive(Resource, Clone, Default)]
pub struct PatchlightStatus {
    /// What it is doing.
    pub stage: PatchlightStage,
    /// Light updates so far.
    pub updates: u64,
    /// Time of the last light update; on Bevy's device that of its frame, without what the device does afterwards.
    pub update_time: Duration,
    /// Time of all work for it: the update, texels, probes.
    pub work_time: Duration,
    /// Texels that the last update sent to the graphics card; none where light is found there.
    pub texels_sent: u64,
    /// Texels of the lightmap: a row, and rows.
    pub lightmap_size: (u32, u32),
    /// Patches of the bake.
    pub patches: usize,
    bake: Option<(Arc<Bake>, [u8; 32])>,
    /// Scenes that Bevy's device was told of.
    scenes: u64,
}

impl std::fmt::Debug for PatchlightStatus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { stage, updates, update_time, .. } = self;
        let mut own = f.debug_struct("PatchlightStatus");
        own.field("stage", stage).field("updates", updates).field("update_time", update_time).finish_non_exhaustive()
    }
}

impl PatchlightStatus {
    /// Writes the finished bake to a file for [`PatchlightSettings::bake`].
    ///
    /// # Errors
    /// [`PatchlightBakeError::Unfinished`] before [`PatchlightStage::Finished`]; what the file system says.
    pub fn save_bake(&self, path: &Path) -> Result<(), PatchlightBakeError> {
        match (&self.stage, &self.bake) {
            (PatchlightStage::Finished, Some((bake, hash))) => baked::save(bake, *hash, path),
            _ => Err(PatchlightBakeError::Unfinished),
        }
    }
}

/// Systems of the plugin, in [`PostUpdate`], after transforms and visibility.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PatchlightSystems;

impl Plugin for PatchlightPlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins(upload::UploadPlugin)
            .init_asset::<PatchlightBake>()
            .init_asset_loader::<baked::BakeLoader>()
            .init_resource::<PatchlightSettings>()
            .init_resource::<PatchlightStatus>()
            .init_resource::<systems::State>()
            .init_resource::<shared::ToDevice>()
            .init_resource::<shared::Report>()
            .add_systems(
                PostUpdate,
                (systems::watch, systems::follow, systems::light)
                    .chain()
                    .in_set(PatchlightSystems)
                    .after(TransformSystems::Propagate)
                    .after(VisibilitySystems::VisibilityPropagate)
                    .before(SimulationLightSystems::UpdateDirectionalLightCascades),
            );
        #[cfg(feature = "vulkan")]
        app.add_plugins(on_device::OnDevicePlugin);
    }
}
