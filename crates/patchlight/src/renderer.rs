//! A bake on a device: lights, camera and method change between frames, and nothing is waited for unless results are
//! asked for.

use std::collections::BTreeMap;
use std::sync::Arc;

use formfactor::gather_by_rays;
use glam::{Vec3, Vec4};
use patches::Columns;
use runtime::executor::{Executor, PassTime};
use runtime::plan::{BufferId, PassId};
use runtime::recipe::scene::SceneTables;
#[cfg(feature = "vulkan")]
use runtime::vulkan::Vulkan;
use scene::{Camera, DirectParams, Light, Lighting, Scene, SurfacePoint};
use transport::{LinearOperator as _, Observer};

use crate::albedo::{Albedo, AlbedoBuffers, sample_materials};
use crate::bake::{Bake, ReceiverKind};
#[cfg(feature = "debug-pictures")]
use crate::debug::{DebugKind, DebugPicture, DebugView};
use crate::error::Error;
use crate::frame::{FrameInput, FramePlan, LAST_BOUNCES};
use crate::method::{Method, MethodReport, MethodSettings, Preparation, firstshot::go_on};
use crate::observe::warn_of_specular_materials;
use crate::operator::{Build, Decode};
use crate::picture::{Picture, Pictures};
use crate::pixels::PixelGather;
use crate::stage::shade::PixelLight;
use crate::stage::{direct, display, gather, shade, sky, source, view};

/// Rays of a row of [`Renderer::irradiance_at`].
const POINT_RAYS: u32 = 4096;
/// Capacity for lights, at least.
const MIN_LIGHTS: usize = 16;

/// Which receivers a light update computes. What is computed is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReceiverUpdate {
    /// All: one update serves any number of views.
    #[default]
    All,
    /// Those behind what the camera shows, in each sub-frame anew: the least work for a picture of few sub-frames.
    /// Receivers on the mesh only; with others, and with a method that finds the irradiance of receivers itself, all.
    InView,
}

/// Source of the direct irradiance H_d of the samples, of which follows the first exitance `E = ρ∘H_d` of the elements.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum SampleLight<'a> {
    /// From the lighting, by shadow rays.
    #[default]
    Traced,
    /// From the caller: RGB at each of [`Renderer::samples`], W/m².
    Values(&'a [Vec3]),
    /// From the caller, who has put it into the device buffer [`ReceiverBuffers::direct`].
    OnDevice,
}

/// Owned copy of [`SampleLight`].
#[derive(Clone, Debug, PartialEq)]
enum KeptLight {
    Traced,
    Values(Vec<Vec4>),
    /// True if the caller has written the buffer of the loaded plan.
    OnDevice {
        is_written: bool,
    },
}

/// Settings of [`Renderer::new`].
#[derive(Clone, Debug, PartialEq)]
pub struct RenderSettings {
    /// Method for light between patches.
    pub method: MethodSettings,
    /// Decoder of operators in texture blocks.
    pub decode: Decode,
    /// Place where operators are built.
    pub build: Build,
    /// Initial camera position, m; used by the matrix round the camera only.
    pub eye: Vec3,
    /// Picture size, pixels.
    pub size: (u32, u32),
    /// Sub-frames a picture: positions in each pixel, and shadow rays of area lights.
    pub sub_frames: u32,
    /// Which receivers a light update computes.
    pub receivers: ReceiverUpdate,
    /// Method for direct light of large sources at pixels.
    pub direct: PixelLight,
}

impl Default for RenderSettings {
    /// Classic radiosity, 16 sub-frames of 960 × 540.
    fn default() -> Self {
        Self {
            method: MethodSettings::default(),
            decode: Decode::default(),
            build: Build::default(),
            eye: Vec3::ZERO,
            size: (960, 540),
            sub_frames: 16,
            receivers: ReceiverUpdate::All,
            direct: PixelLight::default(),
        }
    }
}

/// Report of a light update.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightUpdate {
    /// Counts the updates of the renderer, from 0.
    pub number: u32,
    /// Times that are known: of the host's part of this update, and of passes that the device has finished since the
    /// last.
    pub times: Vec<PassTime>,
}

/// A rendered frame.
pub struct FrameResult {
    /// The picture.
    pub pictures: Pictures,
    /// Milliseconds of each pass: direct, gather, method, lookup, shade.
    pub times: Vec<(String, f64)>,
}

/// A picture that the device is at work on, of [`Renderer::begin_picture`].
#[must_use = "Renderer::end_picture gives the picture"]
pub struct PendingPicture {
    camera: Camera,
    number: u32,
    update: LightUpdate,
}

/// Device buffers with the irradiance of the last light update, for the caller's own shaders: each value is a `Vec4`,
/// RGB in W/m² and one unused component. `runtime::vulkan::Vulkan::buffer` gives the Vulkan buffer of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReceiverBuffers {
    /// Direct irradiance of the samples ([`Renderer::samples`]); with [`SampleLight::OnDevice`] what the caller's
    /// shaders write.
    pub direct: BufferId,
    /// Irradiance of the patches, all bounces but the last two where receivers are on the mesh.
    pub patches: BufferId,
    /// Irradiance of the elements.
    pub elements: BufferId,
    /// Exitance of the elements.
    pub element_exitance: BufferId,
    /// Irradiance of the interpolation points of the mesh ([`patches::MeshReceivers::interpolation`]): what pixels take
    /// theirs from. With [`ReceiverUpdate::InView`], those in view.
    pub interpolated: BufferId,
    /// First exitance of the patches.
    pub source: BufferId,
}

impl ReceiverBuffers {
    fn of(frame: &FramePlan, direct: &direct::DirectLight) -> Self {
        Self {
            direct: direct.irradiance,
            patches: frame.irradiance(),
            elements: frame.elements.irradiance.buffer,
            element_exitance: frame.elements.exitance.buffer,
            interpolated: frame.interpolated,
            source: frame.patches.source.buffer,
        }
    }
}

/// A bake on a device.
pub struct Renderer {
    bake: Arc<Bake>,
    scene: Scene,
    executor: Box<dyn Executor>,
    method: Box<dyn Method>,
    settings: RenderSettings,
    frame: Frame,
    sample_light: KeptLight,
    /// True if that, or the albedo, is another one than the last update's.
    has_new_source: bool,
    /// Material of each sample, once another albedo was asked for.
    sample_materials: Option<Vec<u32>>,
    /// The albedo where it is not that of the bake.
    albedo: Option<Albedo>,
    number: u32,
}

/// Inputs that change in a light update: the light of the elements, and the camera whose view is computed.
struct Changes {
    is_light: bool,
    is_view: bool,
}

/// The loaded plan.
struct Frame {
    tables: SceneTables,
    direct: direct::DirectLight,
    source: source::Source,
    albedo: AlbedoBuffers,
    bounces: u32,
    shade: shade::Shade,
    display: display::Display,
    buffers: ReceiverBuffers,
    /// Passes of the first exitance, those of the method, and those from its irradiance to the elements.
    source_passes: Vec<PassId>,
    method: Vec<PassId>,
    elements: Vec<PassId>,
    /// From the elements to all receivers and interpolation points.
    receivers: Vec<PassId>,
    /// Update of what is in view, where that is all that is computed.
    view: Option<view::View>,
    /// The camera whose primary rays the buffers of the pixels have, where they keep them.
    seen_from: Option<Camera>,
    /// True if the light of the scene's lighting is on the device.
    is_lit: bool,
    /// Light straight from the sky at the interpolation points, where pixels show it, and whether it is there.
    sky: Option<sky::SkyLight>,
    has_sky_light: bool,
}

impl Renderer {
    /// Makes what the method needs, and loads the plan of a frame into the executor.
    ///
    /// # Errors
    /// An operator that does not fit into memory, a device that is too small, [`Error::Medium`], cancellation.
    pub fn new(
        bake: Arc<Bake>,
        mut executor: Box<dyn Executor>,
        settings: &RenderSettings,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        let method = prepare(&bake, settings, executor.as_mut(), observer)?;
        Self::with_method(bake, executor, settings, method)
    }

    /// Makes a renderer with any method.
    ///
    /// # Errors
    /// A device that is too small; [`Error::Medium`].
    pub fn with_method(
        bake: Arc<Bake>,
        mut executor: Box<dyn Executor>,
        settings: &RenderSettings,
        mut method: Box<dyn Method>,
    ) -> Result<Self, Error> {
        if bake.scene.has_medium() && !method.knows_media() {
            return Err(Error::Medium { what: "this method" });
        }
        let scene = bake.scene.clone();
        let frame = Frame::load(&bake, &scene, None, executor.as_mut(), settings, method.as_mut())?;
        let sample_light = KeptLight::Traced;
        let settings = settings.clone();
        Ok(Self {
            bake,
            scene,
            executor,
            method,
            settings,
            frame,
            sample_light,
            has_new_source: false,
            sample_materials: None,
            albedo: None,
            number: 0,
        })
    }

    /// Changes the method; light starts anew.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn set_method(&mut self, method: MethodSettings, observer: &dyn Observer) -> Result<(), Error> {
        self.settings.method = method;
        self.method = prepare(&self.bake, &self.settings, self.executor.as_mut(), observer)?;
        if let Some(albedo) = &self.albedo {
            self.method.set_albedo(albedo, self.executor.as_mut())?;
        }
        self.load()
    }

    /// Gives materials another albedo, all over in place of a texture, from the next update on: one value a material of
    /// the scene, `None` for that of the bake. Waits for nothing, but where light that bounces more often needs another
    /// plan.
    ///
    /// # Errors
    /// [`Error::AlbedoHeld`] of a method whose operator holds the albedo, here and from [`Self::set_method`];
    /// [`Error::AlbedoCount`], [`Error::AlbedoValue`]. Nothing changes then.
    pub fn set_albedo(&mut self, albedo: &[Option<Vec3>]) -> Result<(), Error> {
        let materials =
            self.sample_materials.get_or_insert_with(|| sample_materials(&self.bake.scene, &self.bake.mesh));
        let changed = Albedo::new(&self.bake, materials, albedo)?;
        let is_own = albedo.iter().all(Option::is_none);
        // The method may have another one from before.
        if !is_own || self.albedo.is_some() {
            self.method.set_albedo(&changed, self.executor.as_mut())?;
        }
        changed.give_to(&mut self.scene);
        // More do no harm, but the light of the bake is to come back as it was.
        let are_wrong = if is_own { u32::ne } else { u32::gt };
        let needs_bounces = are_wrong(&changed.bounces, &self.frame.bounces)
            && (self.method.depends_on_source_alone() || self.frame.bounces <= LAST_BOUNCES);
        let changed = self.albedo.insert(changed);
        if needs_bounces {
            self.load()?;
        } else {
            let executor = self.executor.as_mut();
            self.frame.albedo.set(executor, changed)?;
            self.frame.upload_sky(&self.bake, Some(changed), &self.scene, executor)?;
        }
        if is_own {
            self.albedo = None;
        }
        self.has_new_source = true;
        // Pixels look up their albedo again.
        self.frame.seen_from = None;
        Ok(())
    }

    /// Changes which receivers a light update computes; light starts anew.
    ///
    /// # Errors
    /// A device that is too small.
    pub fn set_receivers(&mut self, receivers: ReceiverUpdate) -> Result<(), Error> {
        self.settings.receivers = receivers;
        self.load()
    }

    /// The points at which direct light is measured: position, m, and unit normal of the side that is lit.
    pub fn samples(&self) -> &[SurfacePoint] {
        &self.bake.mesh.points
    }

    /// Changes the size of pictures, pixels, and their sub-frames; light starts anew.
    ///
    /// # Errors
    /// A device that is too small.
    pub fn set_picture(&mut self, size: (u32, u32), sub_frames: u32) -> Result<(), Error> {
        self.settings.size = size;
        self.settings.sub_frames = sub_frames;
        self.load()
    }

    /// Says where updates and pictures take the direct irradiance of the samples from, from the next one on. An engine
    /// that has it already, say by looking the samples up in its shadow maps, thus saves all shadow rays of an update.
    ///
    /// A caller's irradiance is all that comes to the samples straight from lights, emissive surfaces and a sky with a
    /// map; what a constant sky sends is added to it by the updates, from the lighting. Pixels of [`Self::picture`]
    /// find their own direct light by the lighting, and photons start at its lights.
    ///
    /// With [`SampleLight::OnDevice`] it is called for each new content of the buffer, whose writes a memory barrier
    /// has made visible to all commands. The buffer is another one after [`Self::set_method`], [`Self::set_receivers`]
    /// and [`Self::set_picture`], after an update with more lights or another size of the sky's map than any before,
    /// and after [`Self::set_albedo`] where light then bounces more often.
    ///
    /// # Errors
    /// Another number of values than there are samples; a value that is not finite or below 0.
    pub fn set_sample_light(&mut self, light: SampleLight) -> Result<(), Error> {
        self.sample_light = match light {
            SampleLight::Traced => KeptLight::Traced,
            SampleLight::Values(values) => {
                check_sample_light(values, self.samples().len())?;
                KeptLight::Values(values.iter().map(|value| value.extend(0.0)).collect())
            }
            SampleLight::OnDevice => KeptLight::OnDevice { is_written: true },
        };
        self.has_new_source = true;
        Ok(())
    }

    /// Receivers and interpolation points that the last light update was for; waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn count_updated(&mut self) -> Result<(usize, usize), Error> {
        let receivers = &self.bake.receivers;
        let all = (receivers.points.len(), receivers.interpolation.points.len());
        match &self.frame.view {
            Some(view) => Ok(view.count(self.executor.as_mut(), all.0)?),
            None => Ok(all),
        }
    }

    fn load(&mut self) -> Result<(), Error> {
        let executor = self.executor.as_mut();
        let albedo = self.albedo.as_ref();
        self.frame = Frame::load(&self.bake, &self.scene, albedo, executor, &self.settings, self.method.as_mut())?;
        if let KeptLight::OnDevice { is_written } = &mut self.sample_light {
            *is_written = false;
        }
        Ok(())
    }

    /// Finds the light of a frame: direct light → first exitance → the method → interpolation points. Lights may be
    /// added, removed and changed, and so may the sky and the emission of materials; only lights that have moved are
    /// traced, so one that is switched off best stays in the list with the colour zero. Submits the work and waits for
    /// nothing, but where more lights or another sky map need larger buffers, with photons that go on to an error or
    /// start where lights that are not areas have changed, and with the solvers of the host. Under the lighting of the
    /// update before, only what may still change is found. [`Self::set_sample_light`] gives direct light that is known
    /// already.
    ///
    /// # Errors
    /// Lighting that does not suit the scene; [`Error::SampleLightLost`]; what the device says.
    pub fn update_light(&mut self, lighting: &Lighting, camera: &Camera) -> Result<LightUpdate, Error> {
        let (update, changes) = self.update_elements(lighting, camera)?;
        let Some(view) = &self.frame.view else { return Ok(update) };
        let passes = match changes {
            Changes { is_view: true, .. } => {
                let primary = self.frame.shade.first_primary().to_vec();
                let passes = [primary, view.passes()].concat();
                // The same places in the pixels for every camera: what is in view follows from the camera alone.
                self.set_shot(camera, 0)?;
                self.frame.seen_from = None;
                passes
            }
            Changes { is_light: true, .. } => view.gathers(),
            _ => Vec::new(),
        };
        self.executor.submit_passes(&passes)?;
        Ok(update)
    }

    /// A light update up to the elements, and to all receivers if these are updated.
    fn update_elements(&mut self, lighting: &Lighting, camera: &Camera) -> Result<(LightUpdate, Changes), Error> {
        let source = self.set_lighting(lighting)?;
        let input = FrameInput { lighting: &self.scene.lighting, camera, number: self.number };
        let executor = self.executor.as_mut();
        let frame = &mut self.frame;
        let mut times = Vec::new();
        let is_light = !source.is_empty() || !self.method.depends_on_source_alone();
        // Until all is submitted: what fails on the way is found again.
        frame.is_lit = false;
        if is_light {
            if !source.is_empty() {
                executor.submit_passes(&source)?;
            }
            self.method.before_frame(&input, executor)?;
            times = submit_light(frame, self.method.as_mut(), executor)?;
        }
        if let Some(sky) = frame.sky.as_ref().filter(|sky| !frame.has_sky_light && !sky.passes.is_empty()) {
            executor.submit_passes(&sky.passes)?;
            frame.has_sky_light = true;
        }
        let is_view = match &mut frame.view {
            Some(view) => view.set(executor, camera, is_light)?,
            None => false,
        };
        frame.is_lit = true;
        self.has_new_source = false;
        times.extend(executor.finished_times()?);
        let number = self.number;
        self.number = self.number.wrapping_add(1);
        Ok((LightUpdate { number, times }, Changes { is_light, is_view }))
    }

    /// Makes the passes of the pixels ready for a camera, with the random numbers of frame `number`.
    fn set_shot(&mut self, camera: &Camera, number: u32) -> Result<(), Error> {
        let seeds = shade::sub_frame_seeds(number, self.frame.shade.sub_frames(), self.bake.settings.seed);
        let shot = shade::Shot {
            camera,
            light_count: self.scene.lighting.lights.len() as u32,
            emitter_count: self.scene.emitters.len() as u32,
            group_count: self.scene.emitter_groups.len() as u32,
            has_sky: self.scene.has_sky(),
            seeds: &seeds,
        };
        Ok(self.frame.shade.set(self.executor.as_mut(), &shot)?)
    }

    /// The scene under the lights of the last update.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Device buffers of the light.
    pub fn irradiance(&self) -> &ReceiverBuffers {
        &self.frame.buffers
    }

    /// Executor of the plan: to record into a caller's command buffer, to ask for device buffers, to wait.
    pub fn executor_mut(&mut self) -> &mut dyn Executor {
        self.executor.as_mut()
    }

    /// The Vulkan executor, if it is one: to record into a caller's command buffer and to ask for device buffers.
    #[cfg(feature = "vulkan")]
    pub fn vulkan_mut(&mut self) -> Option<&mut Vulkan> {
        self.executor.as_vulkan()
    }

    /// The bake.
    pub fn bake(&self) -> &Arc<Bake> {
        &self.bake
    }

    /// The method.
    pub fn method(&self) -> &dyn Method {
        self.method.as_ref()
    }

    /// Report of the method and of its last frame.
    pub fn report(&self) -> MethodReport {
        self.method.report()
    }

    /// Report with what only the device knows of the last frame; waits for it.
    ///
    /// # Errors
    /// What the device says.
    pub fn counted_report(&mut self) -> Result<MethodReport, Error> {
        self.method.count(self.executor.as_mut())?;
        Ok(self.method.report())
    }

    /// A light update and a picture of it; waits. Random numbers are those of frame `number`.
    ///
    /// # Errors
    /// As [`Self::update_light`].
    pub fn picture(&mut self, lighting: &Lighting, camera: &Camera, number: u32) -> Result<FrameResult, Error> {
        let pending = self.begin_picture(lighting, camera, number)?;
        self.end_picture(pending)
    }

    /// Submits what [`Self::picture`] waits for: meanwhile the caller is free, to write the picture before into a file,
    /// say. [`Self::end_picture`] gives it, before anything else is asked of the renderer.
    ///
    /// # Errors
    /// As [`Self::update_light`].
    pub fn begin_picture(
        &mut self,
        lighting: &Lighting,
        camera: &Camera,
        number: u32,
    ) -> Result<PendingPicture, Error> {
        self.executor.wait()?;
        let (update, _) = self.update_elements(lighting, camera)?;
        self.set_shot(camera, number)?;
        self.frame.seen_from = None;
        self.executor.submit_passes(self.frame.shade.passes())?;
        self.frame.keep_hits(camera);
        Ok(PendingPicture { camera: *camera, number, update })
    }

    /// The picture that was begun last; waits for it.
    ///
    /// # Errors
    /// What the device says.
    pub fn end_picture(&mut self, pending: PendingPicture) -> Result<FrameResult, Error> {
        let PendingPicture { camera, number, update } = pending;
        let mut times = update.times;
        times.extend(self.executor.wait()?);
        let times = by_name(times);
        let full = self.sum(self.frame.shade.full)?;
        let direct = self.sum(self.frame.shade.direct)?;
        let indirect = match self.bake.settings.receivers {
            ReceiverKind::Mesh | ReceiverKind::Patches => full.minus(&direct)?,
            ReceiverKind::Pixels => self.gather_pixels(&camera, number)?,
        };
        let full = direct.plus(&indirect)?;
        Ok(FrameResult { pictures: Pictures { full, direct, indirect }, times })
    }

    /// A light update, and a picture of it as a display shows it with an exposure of so many stops: colours in the
    /// buffer [`Self::displayed`]. They are those of [`Self::picture`] but for rounding, where receivers are on the
    /// mesh or patches; with receivers at pixels, which are gathered on the host, indirect light is missing. Submits
    /// the work and waits for nothing, as [`Self::update_light`] does. From the camera of the picture before, in one
    /// sub-frame of [`PixelLight::Smooth`], primary rays are not traced again.
    ///
    /// # Errors
    /// As [`Self::update_light`].
    pub fn display(
        &mut self,
        lighting: &Lighting,
        camera: &Camera,
        number: u32,
        exposure_stops: f32,
    ) -> Result<LightUpdate, Error> {
        let (update, changes) = self.update_elements(lighting, camera)?;
        self.set_shot(camera, number)?;
        let executor = self.executor.as_mut();
        self.frame.display.set(executor, exposure_stops)?;
        let is_seen = self.frame.seen_from == Some(*camera) && !changes.is_view;
        self.frame.seen_from = None;
        executor.submit_passes(&self.frame.display_passes(is_seen))?;
        self.frame.keep_hits(camera);
        Ok(update)
    }

    /// Buffer of the picture after [`Self::display`]: a word a pixel, row by row from the top, its bytes red, green,
    /// blue and 255 from the lowest. Another buffer after [`Self::set_method`], [`Self::set_receivers`],
    /// [`Self::set_picture`], and after an update that asks for larger tables.
    pub fn displayed(&self) -> BufferId {
        self.frame.display.pixels
    }

    /// Size of pictures, pixels.
    pub fn size(&self) -> (u32, u32) {
        self.settings.size
    }

    /// A light update that is waited for; milliseconds of each pass.
    ///
    /// # Errors
    /// As [`Self::update_light`].
    pub fn advance(&mut self, lighting: &Lighting, camera: &Camera) -> Result<Vec<(String, f64)>, Error> {
        self.executor.wait()?;
        let mut times = self.update_light(lighting, camera)?.times;
        times.extend(self.executor.wait()?);
        Ok(by_name(times))
    }

    /// Indirect irradiance of the last update where pixels take it from, W/m²: at the interpolation points, or of the
    /// patches where they are the receivers.
    ///
    /// # Errors
    /// What the device says.
    pub fn surface_irradiance(&mut self) -> Result<Vec<Vec3>, Error> {
        let buffer = match self.bake.settings.receivers {
            ReceiverKind::Patches => self.frame.buffers.patches,
            ReceiverKind::Mesh => {
                if self.frame.view.is_some() {
                    self.executor.submit_passes(&self.frame.receivers)?;
                    // No time of a frame.
                    self.executor.wait()?;
                }
                self.frame.buffers.interpolated
            }
            ReceiverKind::Pixels => self.frame.buffers.elements,
        };
        Ok(self.download(buffer)?.iter().map(|h| h.truncate()).collect())
    }

    /// A buffer of RGB values of the last update, W/m²; waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn download(&mut self, buffer: BufferId) -> Result<Vec<Vec4>, Error> {
        Ok(self.executor.download_table(buffer)?)
    }

    /// Indirect irradiance of the last update at any points, W/m²: their own rows, gathered exactly from the elements,
    /// or, with the patches as receivers, the mean of those about.
    ///
    /// # Errors
    /// What the device says; cancellation.
    pub fn irradiance_at(&mut self, points: &[SurfacePoint]) -> Result<Vec<Vec3>, Error> {
        let seed = self.bake.settings.seed ^ 0x706f_696e;
        self.method.count(self.executor.as_mut())?;
        let method = self.method.as_any().downcast_ref::<crate::method::firstshot::FirstShotMethod>();
        if let Some(photons) = method {
            return Ok(photons.shot().irradiance_at(&self.scene, points, seed));
        }
        let by_patches = self.bake.settings.receivers == ReceiverKind::Patches;
        let bake = Arc::clone(&self.bake);
        if let Some(lookup) = bake.mesh.lookup.as_ref().filter(|_| by_patches) {
            let light = lookup.at_points(&self.download(self.frame.buffers.patches)?, points)?;
            return Ok(light.iter().map(|h| h.truncate()).collect());
        }
        let light = self.gather(points, POINT_RAYS, seed)?;
        Ok(light.iter().map(|h| h.truncate()).collect())
    }

    /// Pictures of the bake and of the last update's light in it, as a camera sees them: patches, elements, the axes of
    /// their normals, E and H of the patches (H of all bounces but the last where receivers are not patches), and where
    /// receivers are on the mesh, they and their distances. `stops` is the exposure of the scene's pictures.
    ///
    /// # Errors
    /// What the device says.
    #[cfg(feature = "debug-pictures")]
    pub fn debug_pictures(&mut self, camera: &Camera, stops: f32) -> Result<Vec<DebugPicture>, Error> {
        self.with_debug_view(camera, stops, |view| view.pictures())
    }

    /// One of them.
    ///
    /// # Errors
    /// What the device says.
    #[cfg(feature = "debug-pictures")]
    pub fn debug_picture(&mut self, kind: DebugKind, camera: &Camera, stops: f32) -> Result<DebugPicture, Error> {
        self.with_debug_view(camera, stops, |view| view.picture(kind))
    }

    #[cfg(feature = "debug-pictures")]
    fn with_debug_view<T>(
        &mut self,
        camera: &Camera,
        stops: f32,
        show: impl FnOnce(&DebugView) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let source = self.download(self.frame.buffers.source)?;
        let irradiance = match self.bake.settings.receivers {
            ReceiverKind::Patches => self.download(self.frame.buffers.patches)?,
            _ => {
                let elements = self.download(self.frame.buffers.elements)?;
                self.bake.mesh.patch_means(&elements)
            }
        };
        show(&DebugView {
            scene: &self.scene,
            mesh: &self.bake.mesh,
            receivers: &self.bake.receivers,
            source: &source,
            irradiance: &irradiance,
            camera,
            stops,
        })
    }

    fn gather(&mut self, points: &[SurfacePoint], rays: u32, seed: u32) -> Result<Vec<Vec4>, Error> {
        let exitance = self.download(self.frame.buffers.element_exitance)?;
        gather_from_elements(&self.bake, &self.scene, &exitance, points, rays, seed)
    }

    fn gather_pixels(&mut self, camera: &Camera, frame: u32) -> Result<Picture, Error> {
        let exitance = self.download(self.frame.buffers.element_exitance)?;
        let settings = self.bake.settings;
        let gather = |points: &[SurfacePoint], seed: u32| {
            gather_from_elements(&self.bake, &self.scene, &exitance, points, settings.receiver_rays, seed)
        };
        let pixels = PixelGather {
            scene: &self.scene,
            gather: &gather,
            lights: &self.scene.lighting.lights,
            camera,
            frame,
            sub_frames: self.settings.sub_frames,
            seed: settings.seed,
        };
        pixels.indirect()
    }

    fn sum(&mut self, sum: BufferId) -> Result<Picture, Error> {
        let scale = 1.0 / self.frame.shade.sub_frames() as f32;
        let sums: Vec<Vec4> = self.executor.download_table(sum)?;
        let (width, height) = self.settings.size;
        Ok(Picture::from_pixels(width, height, sums.iter().map(|c| c.truncate() * scale).collect())?)
    }

    /// Bytes of each part that frames hold beside the scene.
    pub fn bytes(&self) -> BTreeMap<String, u64> {
        let mesh = &self.bake.mesh;
        let factors = &self.bake.form_factors;
        let receivers = &self.bake.receivers;
        let own = self.method.report().bytes;
        let by_patches = self.bake.settings.receivers == ReceiverKind::Patches;
        let has_factors = by_patches || own.contains_key("form_factors");
        let lookup = mesh.lookup.as_ref().map_or(0, |lookup| lookup.bytes() as u64);
        let mut bytes = BTreeMap::from([
            ("elements".to_owned(), factors.element_bytes(has_factors)),
            ("samples".to_owned(), size_of_val(&mesh.points[..]) as u64),
            ("light shares".to_owned(), self.frame.direct.bytes(mesh.points.len())),
            ("receivers".to_owned(), receivers.rows.bytes()),
            ("sky".to_owned(), receivers.sky_rows.bytes()),
            ("smoothing".to_owned(), receivers.smoothing.bytes()),
            ("interpolation".to_owned(), receivers.weights.bytes()),
            ("lookup".to_owned(), lookup),
        ]);
        bytes.extend(own);
        bytes
    }

    /// Takes over what shines, and puts on the device what has changed of it; the passes of direct light and of the
    /// first exitance that this asks for.
    fn set_lighting(&mut self, lighting: &Lighting) -> Result<Vec<PassId>, Error> {
        if self.frame.is_lit && self.scene.lighting == *lighting && !self.has_new_source {
            return Ok(Vec::new());
        }
        if !self.frame.is_lit {
            self.frame.direct.forget();
        }
        let sky_changes = self.scene.lighting.sky != lighting.sky
            || self.scene.lighting.sky_map != lighting.sky_map
            || self.scene.lighting.emission != lighting.emission;
        let has_new_distributions = self.scene.lighting.distributions != lighting.distributions;
        self.scene.set_lighting(lighting.clone())?;
        let has_room = self.method.set_lighting(&self.scene, self.executor.as_mut())?;
        if !has_room || !self.frame.tables.fits(self.executor.as_ref(), &self.scene)? {
            self.load()?;
        } else if sky_changes {
            self.frame.upload_sky(&self.bake, self.albedo.as_ref(), &self.scene, self.executor.as_mut())?;
            self.frame.direct.forget_surroundings();
        }
        if has_new_distributions {
            self.frame.tables.set_distributions(self.executor.as_mut(), &self.scene.lighting.distributions)?;
            self.frame.direct.forget();
        }
        self.frame.tables.set_lights(self.executor.as_mut(), &self.scene.lighting.lights)?;
        let mut passes = match &self.sample_light {
            KeptLight::Traced => self.set_traced_light()?,
            KeptLight::Values(values) => {
                self.executor.upload(self.frame.direct.irradiance, values)?;
                Vec::new()
            }
            KeptLight::OnDevice { is_written: true } => Vec::new(),
            KeptLight::OnDevice { is_written: false } => return Err(Error::SampleLightLost),
        };
        passes.extend(&self.frame.source_passes);
        Ok(passes)
    }

    fn set_traced_light(&mut self) -> Result<Vec<PassId>, Error> {
        let executor = self.executor.as_mut();
        let lights = &self.scene.lighting.lights;
        let params = DirectParams {
            light_count: lights.len() as u32,
            emitter_count: self.scene.emitters.len() as u32,
            sky_rays: if self.scene.lighting.sky.map_width == 0 { 0 } else { self.bake.settings.sample_rays },
            ..self.bake.direct
        };
        Ok(self.frame.direct.set(executor, lights, &params)?)
    }
}

fn check_sample_light(values: &[Vec3], samples: usize) -> Result<(), Error> {
    if values.len() != samples {
        return Err(Error::SampleLightCount { expected: samples, found: values.len() });
    }
    let is_wrong = |value: &Vec3| !value.is_finite() || value.min_element() < 0.0;
    match values.iter().position(is_wrong) {
        Some(sample) => Err(Error::SampleLightValue { sample, value: values[sample] }),
        None => Ok(()),
    }
}

/// Makes the method of the settings.
fn prepare(
    bake: &Arc<Bake>,
    settings: &RenderSettings,
    executor: &mut (dyn Executor + 'static),
    observer: &dyn Observer,
) -> Result<Box<dyn Method>, Error> {
    settings.method.check_medium(&bake.scene)?;
    let with = Preparation { bake, decode: settings.decode, build: &settings.build, eye: settings.eye, observer };
    if !matches!(settings.method, MethodSettings::FirstShot(_)) {
        warn_of_specular_materials(&bake.scene, observer);
    }
    settings.method.prepare(&with, executor)
}

/// Submits the passes of a light update from the first exitance on; times of the host's part.
fn submit_light(
    frame: &Frame,
    method: &mut dyn Method,
    executor: &mut (dyn Executor + 'static),
) -> Result<Vec<PassTime>, Error> {
    let receivers: &[PassId] = if frame.view.is_some() { &[] } else { &frame.receivers };
    let after = frame.elements.iter().chain(receivers).copied();
    let Some(times) = method.submit(executor) else {
        let rest: Vec<PassId> = frame.method.iter().copied().chain(after).collect();
        executor.submit_passes(&rest)?;
        return Ok(Vec::new());
    };
    let times = times?;
    executor.submit_passes(&after.collect::<Vec<_>>())?;
    Ok(times)
}

impl Frame {
    /// The passes of a picture that is shown; without the primary rays, and without finding out what is in view, where
    /// that `is_seen` already.
    fn display_passes(&self, is_seen: bool) -> Vec<PassId> {
        let mut left_out: Vec<PassId> = self.shade.direct_passes().collect();
        if is_seen {
            left_out.extend(self.shade.seeing_passes());
            left_out.extend(self.view.iter().flat_map(|view| view.marks()));
        }
        let shaded = self.shade.passes().iter().filter(|pass| !left_out.contains(pass)).copied();
        shaded.chain(self.display.passes()).collect()
    }

    /// Notes that the primary rays of a camera were traced last.
    fn keep_hits(&mut self, camera: &Camera) {
        self.seen_from = self.shade.keeps_hits().then_some(*camera);
    }

    /// Makes the plan, loads it and uploads everything that stays.
    fn load(
        bake: &Arc<Bake>,
        scene: &Scene,
        albedo: Option<&Albedo>,
        executor: &mut (dyn Executor + 'static),
        settings: &RenderSettings,
        method: &mut dyn Method,
    ) -> Result<Self, Error> {
        let device = executor.device().clone();
        let bounces = albedo.map_or(bake.bounces, |albedo| albedo.bounces);
        let capacity = scene.lighting.lights.len().next_power_of_two().max(MIN_LIGHTS);
        let mut frame = FramePlan::new(bake, scene, capacity, bounces, &device);
        let tables = frame.scene.clone();
        let direct = direct::add(&mut frame, &tables)?;
        let source = source::add(&mut frame, &direct)?;
        let before = frame.plan.all_passes();
        let source_passes = source.passes.to_vec();
        method.add_passes(&mut frame)?;
        let own = frame.plan.all_passes().split_off(before.len());
        gather::add_elements(&mut frame, method)?;
        let elements = frame.plan.all_passes().split_off(before.len() + own.len());
        let receiver_tables = gather::add_receivers(&mut frame, method)?;
        let receivers = frame.plan.all_passes().split_off(before.len() + own.len() + elements.len());
        let indirect = shade::Indirect::of_bake(&mut frame);
        let smooth = receiver_tables.as_ref().filter(|_| settings.direct == PixelLight::Smooth);
        let sky = smooth.map(|receivers| sky::add(&mut frame, receivers)).transpose()?;
        let mut shade = shade::add(&mut frame, &tables, &indirect, settings.size, settings.sub_frames, sky.as_ref())?;
        let in_view = receiver_tables.filter(|_| settings.receivers == ReceiverUpdate::InView);
        let view = view::add(&mut frame, &tables, in_view.as_ref(), &indirect, &mut shade)?;
        let display = display::add(&mut frame, &shade, settings.size)?;
        let buffers = ReceiverBuffers::of(&frame, &direct);
        let albedo_buffers = AlbedoBuffers::of(&frame, &source);
        load_plan(frame, executor)?;
        direct.clear(executor)?;
        shade.clear(executor)?;
        view.iter().try_for_each(|view| view.clear(executor))?;
        let mut loaded = Self {
            tables,
            direct,
            source,
            albedo: albedo_buffers,
            bounces,
            shade,
            display,
            buffers,
            source_passes,
            method: own,
            elements,
            receivers,
            view,
            seen_from: None,
            is_lit: false,
            sky,
            has_sky_light: false,
        };
        loaded.tables.set_distributions(executor, &scene.lighting.distributions)?;
        if let Some(albedo) = albedo {
            loaded.albedo.set(executor, albedo)?;
        }
        loaded.upload_sky(bake, albedo, scene, executor)?;
        method.start(executor)?;
        // What a caller writes on the device from now on stays.
        executor.submit_passes(&[])?;
        Ok(loaded)
    }

    /// The sky and the emission of materials, and what elements reflect of a constant sky.
    fn upload_sky(
        &mut self,
        bake: &Bake,
        albedo: Option<&Albedo>,
        scene: &Scene,
        executor: &mut (dyn Executor + 'static),
    ) -> Result<(), Error> {
        self.tables.set_sky_and_emission(executor, scene)?;
        if let Some(sky) = &self.sky {
            sky.set(executor, scene)?;
            self.has_sky_light = false;
        }
        let elements = albedo.map_or(&bake.mesh.element_albedo, |albedo| &albedo.elements);
        Ok(executor.upload(self.source.emission, &source::sky_exitance(bake, elements, &scene.lighting))?)
    }
}

/// Loads a plan with the tables that stay, and clears what the first frame adds to.
fn load_plan(frame: FramePlan, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
    let cleared = frame.initial_zeros();
    let FramePlan { plan, tables, .. } = frame;
    executor.load(plan)?;
    tables.upload(executor)?;
    Ok(cleared.into_iter().try_for_each(|buffer| executor.clear(buffer))?)
}

/// Irradiance at points by rows of their own over the elements, W/m².
fn gather_from_elements(
    bake: &Bake,
    scene: &Scene,
    exitance: &[Vec4],
    points: &[SurfacePoint],
    rays: u32,
    seed: u32,
) -> Result<Vec<Vec4>, Error> {
    let offsets: Vec<u32> = (0..=points.len() as u32).collect();
    let surfaces = bake.mesh.lighting(scene, Columns::Elements, points, &offsets, seed);
    Ok(gather_by_rays(&surfaces, rays, exitance, &go_on)?)
}

/// Times of passes of one name added up, in the order of the first of each.
pub fn by_name(passes: Vec<PassTime>) -> Vec<(String, f64)> {
    let mut times: Vec<(String, f64)> = Vec::new();
    for time in passes {
        match times.iter_mut().find(|(name, _)| *name == time.name) {
            Some((_, sum)) => *sum += time.milliseconds,
            None => times.push((time.name, time.milliseconds)),
        }
    }
    times
}

/// The lighting of a scene with other lights.
pub fn with_lights(scene: &Scene, lights: &[Light]) -> Lighting {
    Lighting { lights: lights.to_vec(), ..scene.lighting.clone() }
}
