//! Settings that a test bakes and renders with, in one place.

use std::sync::Arc;

use assets::LoadedScene;
use glam::Vec3;
use patches::PatchKind;
use patchlight::low_level::operator::Decode;
use patchlight::{
    Bake, BakeSettings, Estimator, LightSettings, MethodSettings, PictureRenderer, PictureSettings, Pictures,
    PixelLight, ReceiverKind, ReceiverUpdate, Result, Silent,
};
use runtime::executor::Executor;
use scene::Materials;

/// Settings of a bake and of its pictures.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// Kind of patches.
    pub patches: PatchKind,
    /// About how many patches.
    pub patch_count: usize,
    /// Edge of voxels, m.
    pub voxel_size: Option<f32>,
    /// Estimator of the form factors.
    pub estimator: Estimator,
    /// Bounces; all without.
    pub bounces: Option<u32>,
    /// Points where irradiance is gathered.
    pub receivers: ReceiverKind,
    /// Most receivers.
    pub most_receivers: Option<usize>,
    /// Rays of a receiver's row.
    pub receiver_rays: u32,
    /// Changes every random number.
    pub seed: u32,
    /// Method for light between patches.
    pub method: MethodSettings,
    /// Decoder of texture blocks.
    pub decode: Decode,
    /// Sub-frames a picture.
    pub sub_frames: u32,
    /// Which receivers an update computes.
    pub receivers_updated: ReceiverUpdate,
    /// Method for direct light at pixels.
    pub direct: PixelLight,
    /// Reflection of surfaces.
    pub materials: Materials,
    /// Picture size, pixels.
    pub size: (u32, u32),
}

impl Default for Setup {
    fn default() -> Self {
        let bake = BakeSettings::default();
        let light = LightSettings::default();
        let pictures = PictureSettings::default();
        Self {
            patches: bake.patches,
            patch_count: bake.patch_count,
            voxel_size: bake.voxel_size,
            estimator: bake.estimator,
            bounces: bake.bounces,
            receivers: bake.receivers,
            most_receivers: bake.most_receivers,
            receiver_rays: bake.receiver_rays,
            seed: bake.seed,
            method: light.method,
            decode: light.decode,
            sub_frames: pictures.sub_frames,
            receivers_updated: pictures.receivers,
            direct: pictures.direct,
            materials: pictures.materials,
            size: pictures.size,
        }
    }
}

impl Setup {
    /// A coarse bake in which any of the built-in scenes takes a second.
    pub fn coarse() -> Self {
        Self {
            patch_count: 150,
            estimator: Estimator::Hemisphere { rays: 256 },
            most_receivers: Some(800),
            receiver_rays: 64,
            sub_frames: 2,
            seed: 3,
            size: (32, 24),
            ..Self::default()
        }
    }

    /// The settings of the bake.
    pub fn bake_settings(&self) -> BakeSettings {
        BakeSettings::default()
            .with_patches(self.patches)
            .with_patch_count(self.patch_count)
            .with_voxel_size(self.voxel_size)
            .with_estimator(self.estimator)
            .with_bounces(self.bounces)
            .with_receivers(self.receivers)
            .with_most_receivers(self.most_receivers)
            .with_receiver_rays(self.receiver_rays)
            .with_seed(self.seed)
    }

    /// The bake of a scene.
    ///
    /// # Errors
    /// As [`Bake::build`].
    pub fn bake(&self, loaded: &LoadedScene) -> Result<Arc<Bake>> {
        Ok(Arc::new(Bake::build(&loaded.scene, &self.bake_settings(), &Silent)?))
    }

    /// A bake on an executor, with the method of the setup.
    ///
    /// # Errors
    /// As [`PictureRenderer::new`].
    pub fn load(&self, loaded: &LoadedScene, bake: &Arc<Bake>, executor: Box<dyn Executor>) -> Result<PictureRenderer> {
        let light =
            LightSettings::default().with_method(self.method).with_decode(self.decode).with_eye(loaded.view.eye);
        let pictures = PictureSettings::default()
            .with_size(self.size)
            .with_sub_frames(self.sub_frames)
            .with_receivers(self.receivers_updated)
            .with_direct(self.direct)
            .with_materials(self.materials);
        PictureRenderer::of_bake(Arc::clone(bake), executor, &light, &pictures, &Silent)
    }

    /// Both in one step.
    ///
    /// # Errors
    /// As both.
    pub fn renderer(&self, loaded: &LoadedScene, executor: Box<dyn Executor>) -> Result<PictureRenderer> {
        self.load(loaded, &self.bake(loaded)?, executor)
    }
}

/// Relative error of the mean radiance of a closed box of uniform emission and albedo, L = Le / (1 − ρ).
pub fn furnace_error(loaded: &LoadedScene, pictures: &Pictures) -> f32 {
    let material = loaded.scene.materials[loaded.scene.geometry.triangles[0].material as usize];
    let mean = pictures.full.pixels.iter().sum::<Vec3>() / pictures.full.pixels.len() as f32;
    let expected = material.radiance / (Vec3::ONE - material.albedo);
    (mean / expected - Vec3::ONE).abs().max_element()
}
