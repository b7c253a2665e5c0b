//! Light between patches in one frame: first exitance E in, irradiance H out. One file a method.

pub mod classic;
pub mod feedback;
pub mod firstshot;
pub mod local;
pub mod multibounce;
pub mod temporal;

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use runtime::executor::{Executor, PassTime};
use runtime::plan::{PassId, Slice};
use scene::{Rgb, Scene, SurfacePoint};
use transport::Observer;

use crate::albedo::Albedo;
use crate::bake::Bake;
use crate::error::{Error, Reason};
use crate::low_level::frame::{FrameInput, FramePlan, LAST_BOUNCES};
use crate::low_level::operator::build::MATRICES;
use crate::low_level::operator::{Build, Codec, Decode};
use crate::memory::check_free;

pub use feedback::FeedbackSettings;
pub use firstshot::FirstShotSettings;
pub use localmatrix::CameraSettings as LocalSettings;
pub use temporal::TemporalSettings;

/// Light between patches in one frame.
///
/// A method adds its passes between those that find the first exitance E of the patches
/// ([`FramePlan::patches`]) and those that take their irradiance H, W/m², to receivers and pixels. It is made for a
/// [`Bake`] and keeps what it needs from frame to frame.
pub trait Method: Send {
    /// Adds the passes from E to H. Called once for each plan that is loaded.
    ///
    /// # Errors
    /// What the plan says.
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<(), Error>;

    /// Adds the method's own passes from an exitance to the irradiance of the elements, in place of the product with
    /// their rows, and says whether it did.
    ///
    /// # Errors
    /// What the plan says.
    fn add_element_passes(&mut self, frame: &mut FramePlan, exitance: Slice<Rgb>) -> Result<bool, Error> {
        let _ = (frame, exitance);
        Ok(false)
    }

    /// Adds the passes from the exitance of the elements to the irradiance of the receivers, [`FramePlan::received`].
    ///
    /// # Errors
    /// What the plan says.
    fn add_receiver_passes(&mut self, frame: &mut FramePlan) -> Result<bool, Error> {
        let _ = frame;
        Ok(false)
    }

    /// Returns true if the method's own passes put the irradiance of the elements into [`FramePlan::elements`].
    fn finds_element_irradiance(&self) -> bool {
        false
    }

    /// Returns true if light loses what a medium between surfaces absorbs of it, up to the irradiance of the receivers.
    fn supports_media(&self) -> bool {
        false
    }

    /// Returns true if H follows from E alone: nothing of it from the frames before, nothing from the camera. Then a
    /// light update under the lighting of the one before has nothing to do.
    fn depends_on_source_alone(&self) -> bool {
        false
    }

    /// Called once after the plan is loaded and its buffers are zeros.
    ///
    /// # Errors
    /// What the device says.
    fn start(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        let _ = executor;
        Ok(())
    }

    /// Takes what shines from now on, in the scene with its present albedo, before anything of a frame is submitted;
    /// says whether the loaded plan has room for it. Where it has not, the plan is made anew.
    ///
    /// # Errors
    /// Light that the method does not serve; what the device says.
    fn set_lighting(&mut self, scene: &Scene, executor: &mut (dyn Executor + 'static)) -> Result<bool, Error> {
        let _ = (scene, executor);
        Ok(true)
    }

    /// Called in each frame, when lights are set and the passes of the first exitance submitted; waits for nothing.
    ///
    /// # Errors
    /// What the device says.
    fn before_frame(&mut self, input: &FrameInput, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        let _ = (input, executor);
        Ok(())
    }

    /// Submits the method's passes, in place of the renderer, where the host has a part in them; gives the times of the
    /// host. `None` leaves it to the renderer, which submits them with all others.
    ///
    /// # Errors
    /// What the device says.
    fn submit(&mut self, executor: &mut (dyn Executor + 'static)) -> Option<Result<Vec<PassTime>, Error>> {
        let _ = executor;
        None
    }

    /// Takes another albedo, which the buffers of the loaded plan hold from the next frame on; called for a new method,
    /// too, where the albedo is not that of the bake, before its plan is loaded.
    ///
    /// # Errors
    /// [`Unsupported`](crate::ErrorKind::Unsupported), which methods give that say nothing else.
    fn set_albedo(&mut self, albedo: &Albedo, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        let _ = (albedo, executor);
        Err(Reason::AlbedoHeld { method: "this method" }.into())
    }

    /// Counts what only the device knows of the last frame, for [`Self::report`]; waits.
    ///
    /// # Errors
    /// What the device says.
    fn count(&mut self, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
        let _ = executor;
        Ok(())
    }

    /// Indirect irradiance at any points, W/m², where the method finds it otherwise than by rows over the elements; of
    /// the last frame that [`Self::count`] was called for.
    fn irradiance_at(&self, scene: &Scene, points: &[SurfacePoint], seed: u32) -> Option<Vec<Vec3>> {
        let _ = (scene, points, seed);
        None
    }

    /// Report of the method and of its last frame.
    fn report(&self) -> MethodReport;

    /// The method as what it is, for what only it can tell.
    fn as_any(&self) -> &dyn std::any::Any;
}

/// Report of a method and of its last frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MethodReport {
    /// Bytes of each part.
    pub bytes: BTreeMap<String, u64>,
    /// Milliseconds of the host before the frame.
    pub host_ms: f64,
}

/// A method and its settings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum MethodSettings {
    /// A product with the sparse form factors for each bounce.
    #[default]
    Classic,
    /// One product with the operator of all bounces.
    Multibounce(Codec),
    /// Products with the compressed form factors, from the light of the frame before.
    Feedback(FeedbackSettings),
    /// A few samples a row and frame, from the light of the frame before.
    Temporal(TemporalSettings),
    /// All bounces in one product, with the operator of the patches round the camera.
    Local(LocalSettings),
    /// No product: photons emitted from first-lit surfaces.
    FirstShot(FirstShotSettings),
}

/// Inputs of methods, beside their own settings.
pub struct Preparation<'a> {
    /// The bake that is lit.
    pub bake: &'a Arc<Bake>,
    /// Decoder of operators in texture blocks.
    pub decode: Decode,
    /// Place where operators are built.
    pub build: &'a Build,
    /// Initial camera position, m.
    pub eye: Vec3,
    /// Receives how far the work is.
    pub observer: &'a dyn Observer,
}

/// Bytes of a pair of patches in the matrix round the camera.
const PAIR_BYTES: f64 = 16.0;

impl MethodSettings {
    /// The method in a word.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Classic => "classic",
            Self::Multibounce(Codec::LowRank { .. }) => "low_rank",
            Self::Multibounce(_) => "multibounce",
            Self::Feedback(_) => "feedback",
            Self::Temporal(_) => "temporal",
            Self::Local(_) => "local",
            Self::FirstShot(_) => "firstshot",
        }
    }

    /// Refuses a scene with a medium, for methods that know of none; asked before anything is baked.
    ///
    /// # Errors
    /// [`Unsupported`](crate::ErrorKind::Unsupported) for a scene with a medium.
    pub fn check_medium(&self, scene: &Scene) -> Result<(), Error> {
        match self {
            Self::FirstShot(_) => Ok(()),
            _ if scene.has_medium() => Err(Reason::Medium { what: self.name() }.into()),
            _ => Ok(()),
        }
    }

    /// Checks that the matrices of so many patches fit into memory, before anything is baked. Operators in tiles always
    /// do: they are built panel by panel in a file.
    ///
    /// # Errors
    /// [`Memory`](crate::ErrorKind::Memory) with what would be smaller.
    pub fn check_memory(&self, patches: usize, bounces: Option<u32>, build: &Build) -> Result<(), Error> {
        let pairs = |count: usize| (count as f64).powi(2);
        let has_operator = bounces.is_none_or(|bounces| bounces > LAST_BOUNCES);
        let check_operator = |remedy| {
            check_free(
                format!("the operator of {patches} patches, while it is made,"),
                (MATRICES * size_of::<f32>()) as f64 * pairs(patches),
                build.memory_limit,
                remedy,
            )
        };
        match *self {
            Self::Multibounce(Codec::LowRank { .. }) => Ok(()),
            Self::Multibounce(codec @ Codec::Blocks(_)) if has_operator && !cfg!(feature = "texture-blocks") => {
                Err(Reason::NoBlockEncoder { codec: codec.name() }.into())
            }
            Self::Multibounce(_) if has_operator => check_operator("choose fewer patches, or the low-rank operator"),
            Self::Temporal(TemporalSettings { rows: temporal::RowKind::AllBounces, .. }) if has_operator => {
                check_operator("choose fewer patches, or rows of one bounce")
            }
            Self::Local(settings) => check_free(
                format!("the matrix of {} slots", settings.slots),
                PAIR_BYTES * pairs(settings.slots.min(patches)),
                build.memory_limit,
                "choose fewer slots",
            ),
            _ => Ok(()),
        }
    }

    /// Makes the method; `device` is what frames will run on, which may build operators.
    ///
    /// # Errors
    /// Settings that do not suit the bake, an operator that does not fit into memory, cancellation.
    pub fn prepare(&self, with: &Preparation, device: &mut (dyn Executor + 'static)) -> Result<Box<dyn Method>, Error> {
        Ok(match *self {
            Self::Classic => Box::new(classic::Classic::new(with.bake)),
            Self::Multibounce(codec) => multibounce::prepare(codec, with, device)?,
            Self::Feedback(settings) => feedback::prepare(&settings, with, device)?,
            Self::Temporal(settings) => Box::new(temporal::TemporalMethod::new(&settings, with, device)?),
            Self::Local(settings) => Box::new(local::Local::new(&settings, with)?),
            Self::FirstShot(settings) => Box::new(firstshot::FirstShotMethod::new(&settings, with, device)?),
        })
    }
}

/// The ids of the passes that a plan has so far.
pub(crate) fn passes_so_far(frame: &FramePlan) -> Vec<PassId> {
    frame.plan.all_passes()
}

/// Bytes of parts by name.
pub(crate) fn bytes<const N: usize>(parts: [(&str, u64); N]) -> BTreeMap<String, u64> {
    parts.into_iter().map(|(name, count)| (name.to_owned(), count)).collect()
}
