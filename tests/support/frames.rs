//! Many frames with random lights, cameras, methods, materials and sizes: `Frames`.

use std::sync::Arc;

use assets::{LoadedScene, procedural};
use glam::Vec3;
use patchlight::low_level::operator::Codec;
use patchlight::memory::resident_bytes;
use patchlight::method::{FeedbackSettings, FirstShotSettings, LocalSettings, TemporalSettings};
use patchlight::{
    Bake, Error, ErrorKind, Estimator, MethodSettings, PictureRenderer, Pictures, ReceiverUpdate, Silent,
};
use runtime::executor::Executor;
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_SPOT};
use scene::sampling::{hash3, unit};
use scene::{Camera, DisplayTransform, Light, Lighting};

use crate::setup::Setup;

/// Scenes that frames are of, in turn.
const SCENES: [&str; 3] = ["cornell", "office", "rooms"];
/// Most lights.
const MAX_LIGHTS: u32 = 24;
/// Sizes of pictures, pixels.
const SIZES: [(u32, u32); 3] = [(16, 12), (23, 9), (8, 8)];
/// Frames after which it is asked whether a fresh start gives the same, and how much memory there is.
pub const CHECK: u32 = 250;

/// Results of the frames of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Frames of each kind of change: light, camera, emission and sky, method, albedo, size, receivers.
    pub changes: [u32; 7],
    /// Times the last frame was compared with that of a fresh start.
    pub checks: u32,
    /// Greatest and least luminance of all frames, W/m²/sr: nothing is below 0, and not all is black.
    pub range: (f32, f32),
    /// Resident bytes after each [`CHECK`] frames.
    pub resident: Vec<u64>,
}

/// Frames of one scene on one executor.
struct Frames<'a> {
    loaded: &'a LoadedScene,
    bake: Arc<Bake>,
    setup: Setup,
    renderer: PictureRenderer,
    lighting: Lighting,
    camera: Camera,
    albedo: Vec<Option<Vec3>>,
    seed: u32,
    frame: u32,
}

/// Renders frames `first..first + count`, on executors that `open` makes, all scenes in turn; says what came of each.
///
/// # Errors
/// What went wrong in which frame: what the library says, the validation layer among it, a picture that is not finite,
/// or one that differs from a fresh start's.
pub fn run(
    first: u32,
    count: u32,
    open: &dyn Fn() -> Box<dyn Executor>,
    tell: &dyn Fn(u32, u64),
) -> Result<Vec<(&'static str, Outcome)>, String> {
    let share = count.div_ceil(SCENES.len() as u32);
    let mut outcomes = Vec::new();
    for (name, k) in SCENES.into_iter().zip(0..) {
        let loaded = procedural::build(name).map_err(|error| error.to_string())?;
        let mut frames = Frames::new(&loaded, open(), first + k).map_err(|error| error.to_string())?;
        outcomes.push((name, frames.run(share, open, tell).map_err(|what| format!("{name}, {what}"))?));
    }
    Ok(outcomes)
}

impl<'a> Frames<'a> {
    fn new(loaded: &'a LoadedScene, executor: Box<dyn Executor>, seed: u32) -> Result<Self, Error> {
        let setup = Setup {
            patch_count: 60,
            estimator: Estimator::Hemisphere { rays: 64 },
            most_receivers: Some(300),
            receiver_rays: 32,
            sub_frames: 1,
            seed: 5,
            size: SIZES[0],
            ..Setup::default()
        };
        let bake = setup.bake(loaded)?;
        let renderer = setup.load(loaded, &bake, executor)?;
        let lighting = loaded.scene.lighting.clone();
        let camera = loaded.view.camera(setup.size.0, setup.size.1);
        let albedo = vec![None; loaded.scene.materials.len()];
        Ok(Self { loaded, bake, setup, renderer, lighting, camera, albedo, seed, frame: 0 })
    }

    fn run(
        &mut self,
        count: u32,
        open: &dyn Fn() -> Box<dyn Executor>,
        tell: &dyn Fn(u32, u64),
    ) -> Result<Outcome, String> {
        let mut outcome = Outcome { changes: [0; 7], checks: 0, range: (f32::INFINITY, 0.0), resident: Vec::new() };
        for frame in 0..count {
            self.frame = frame;
            let failed = |error: Error| format!("frame {frame}: {error}");
            let kind = self.change().map_err(failed)?;
            outcome.changes[kind] += 1;
            let pictures = self.picture().map_err(failed)?;
            for pixel in &pictures.full.pixels {
                if !pixel.is_finite() {
                    return Err(format!("frame {frame}: a pixel of {pixel}"));
                }
                outcome.range = (outcome.range.0.min(pixel.min_element()), outcome.range.1.max(pixel.max_element()));
            }
            if frame % CHECK == CHECK - 1 || frame + 1 == count {
                self.check(open).map_err(|what| format!("frame {frame}: {what}"))?;
                outcome.checks += 1;
                let bytes = resident_bytes().unwrap_or(0);
                outcome.resident.push(bytes);
                tell(frame + 1, bytes);
            }
        }
        Ok(outcome)
    }

    /// A random number in 0..1 of this frame.
    fn random(&self, dimension: u32) -> f32 {
        unit(hash3(self.frame, dimension, self.seed))
    }

    fn color(&self, dimension: u32) -> Vec3 {
        Vec3::new(self.random(dimension), self.random(dimension + 1), self.random(dimension + 2))
    }

    /// A place in the scene's box, m.
    fn place(&self, dimension: u32) -> Vec3 {
        let (low, high) = self.bake.scene().geometry.bounds;
        low + (high - low) * self.color(dimension)
    }

    fn direction(&self, dimension: u32) -> Vec3 {
        (self.color(dimension) - 0.5).try_normalize().unwrap_or(Vec3::NEG_Y)
    }

    /// Changes one thing; which.
    fn change(&mut self) -> Result<usize, Error> {
        let kinds = [0.45, 0.7, 0.8, 0.88, 0.94, 0.97, 1.0];
        let at = self.random(0);
        let kind = kinds.iter().position(|&end| at < end).unwrap_or(0);
        match kind {
            0 => self.change_light(),
            1 => {
                let target = self.place(4);
                let (width, height) = self.setup.size;
                self.camera =
                    Camera::look_at(self.place(1), target, Vec3::Y, 30.0 + 60.0 * self.random(7), width, height);
            }
            2 => {
                let count = self.loaded.scene.materials.len();
                let emission = |k: usize| self.color(10 + 3 * k as u32) * if k.is_multiple_of(3) { 0.5 } else { 0.0 };
                self.lighting.emission =
                    if self.random(1) < 0.3 { Vec::new() } else { (0..count).map(emission).collect() };
                self.lighting.sky.radiance = self.color(4) * self.random(7);
            }
            3 => self.change_method()?,
            4 => self.change_albedo()?,
            5 => {
                self.setup.size = SIZES[(self.random(1) * SIZES.len() as f32) as usize % SIZES.len()];
                self.setup.sub_frames = 1 + u32::from(self.random(2) < 0.3);
                self.renderer.resize(self.setup.size, self.setup.sub_frames)?;
                (self.camera.width, self.camera.height) = self.setup.size;
            }
            _ => {
                self.setup.receivers_updated =
                    if self.random(1) < 0.5 { ReceiverUpdate::All } else { ReceiverUpdate::InView };
                self.renderer.set_receivers(self.setup.receivers_updated)?;
            }
        }
        Ok(kind)
    }

    fn change_light(&mut self) {
        let light = Light {
            kind: [LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_SPOT][(self.random(1) * 3.0) as usize % 3],
            position: self.place(2),
            direction: self.direction(5),
            color: self.color(8),
            cos_inner: 0.9,
            cos_outer: 0.7,
            ..Light::default()
        };
        let count = self.lighting.lights.len();
        let index = (self.random(11) * count as f32) as usize;
        match (self.random(12), count) {
            (x, _) if x < 0.3 && count < MAX_LIGHTS as usize => self.lighting.lights.push(light),
            (x, 1..) if x < 0.5 => {
                self.lighting.lights.remove(index);
            }
            (x, 1..) if x < 0.7 => self.lighting.lights[index].color = light.color,
            (_, 1..) => self.lighting.lights[index] = light,
            _ => self.lighting.lights.push(light),
        }
    }

    fn change_method(&mut self) -> Result<(), Error> {
        let slots = LocalSettings { slots: 48, ..LocalSettings::default() };
        let methods = [
            MethodSettings::Classic,
            MethodSettings::Multibounce(Codec::LowRank { epsilon: 0.1 }),
            MethodSettings::Multibounce(Codec::Half),
            MethodSettings::Feedback(FeedbackSettings::default()),
            MethodSettings::Temporal(TemporalSettings::default()),
            MethodSettings::Local(slots),
            MethodSettings::FirstShot(FirstShotSettings {
                error: 0.3,
                most_photons: 1 << 14,
                ..FirstShotSettings::default()
            }),
        ];
        let method = methods[(self.random(1) * methods.len() as f32) as usize % methods.len()];
        match self.renderer.set_method(method, &Silent) {
            Ok(()) => self.setup.method = method,
            // Which says so, and leaves the choice to us.
            Err(error) if error.kind() == ErrorKind::Unsupported => {
                self.renderer.set_method(self.setup.method, &Silent)?
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    fn change_albedo(&mut self) -> Result<(), Error> {
        let of = |k: usize| {
            let dimension = 10 + 4 * k as u32;
            (self.random(dimension) < 0.4).then(|| 0.9 * self.color(dimension + 1))
        };
        let albedo: Vec<Option<Vec3>> = (0..self.albedo.len()).map(of).collect();
        match self.renderer.light_mut().set_albedo(&albedo) {
            Ok(()) => self.albedo = albedo,
            Err(error) if error.kind() == ErrorKind::Unsupported => {}
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// The picture of a frame, found in one of the ways that there are.
    fn picture(&mut self) -> Result<Pictures, Error> {
        if self.random(20) < 0.3 {
            self.renderer.update_light(&self.lighting, &self.camera)?;
        }
        if self.random(21) < 0.2 {
            self.renderer.display(&self.lighting, &self.camera, self.frame, &DisplayTransform::default())?;
        }
        Ok(self.renderer.picture(&self.lighting, &self.camera, self.frame)?.pictures)
    }

    /// The frame by classic radiosity has the bits that it has of a renderer that knows nothing of those before.
    fn check(&mut self, open: &dyn Fn() -> Box<dyn Executor>) -> Result<(), String> {
        let said = |error: Error| error.to_string();
        self.renderer.set_method(MethodSettings::Classic, &Silent).map_err(said)?;
        let picture = |renderer: &mut PictureRenderer| {
            let found = renderer.picture(&self.lighting, &self.camera, self.frame).map_err(said)?;
            let pixels = found.pictures.full.pixels;
            Ok::<_, String>(pixels.iter().map(|pixel| pixel.to_array().map(f32::to_bits)).collect::<Vec<_>>())
        };
        let found = picture(&mut self.renderer)?;
        self.setup.method = MethodSettings::Classic;
        let mut fresh = self.setup.load(self.loaded, &self.bake, open()).map_err(said)?;
        fresh.light_mut().set_albedo(&self.albedo).map_err(said)?;
        let expected = picture(&mut fresh)?;
        if found != expected {
            let wrong = found.iter().zip(&expected).filter(|(a, b)| a != b).count();
            return Err(format!("{wrong} of {} pixels differ from those of a fresh start", found.len()));
        }
        Ok(())
    }
}
