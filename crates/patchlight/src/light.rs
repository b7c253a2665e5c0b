//! The light of a bake on a device: lights, emission and method change between updates, and nothing is waited for
//! unless results are asked for.

use std::collections::BTreeMap;
use std::sync::Arc;

use formfactor::gather_by_rays;
use glam::{Vec3, Vec4};
use patches::Columns;
use runtime::executor::{Executor, PassTime};
use runtime::plan::{BufferId, PassId};
#[cfg(feature = "vulkan")]
use runtime::vulkan::Vulkan;
#[cfg(feature = "debug-pictures")]
use scene::Camera;
use scene::gpu::DirectParams;
use scene::{Light, Lighting, Scene, SurfacePoint};
use transport::{LinearOperator as _, Observer};

use crate::albedo::{Albedo, AlbedoBuffers, sample_materials};
use crate::bake::{Bake, ReceiverKind};
#[cfg(feature = "debug-pictures")]
use crate::debug::{DebugKind, DebugPicture, DebugView};
use crate::error::{Error, Reason};
use crate::job::BakeJob;
use crate::low_level::frame::{FrameInput, FramePlan, FrameTables, LAST_BOUNCES};
use crate::low_level::operator::{Build, Decode};
use crate::low_level::stage::gather::ReceiverTables;
use crate::low_level::stage::objects::{ChangingRows, ObjectLight};
use crate::low_level::stage::{direct, gather, source};
use crate::method::firstshot::ignore_progress;
use crate::method::{Method, MethodReport, MethodSettings, Preparation};
use crate::objects::rows::{RowChange, item_changes};
use crate::objects::{ObjectTables, check_bake};
use crate::observe::warn_of_specular_materials;
use crate::points::PointTables;
use crate::settings::setters;

/// Rays of a row of [`LightField::irradiance_at`].
const POINT_RAYS: u32 = 4096;
/// Rounds in which light of the method is found with what objects change of it.
const OBJECT_ROUNDS: usize = 4;
/// Capacity for lights, at least.
const MIN_LIGHTS: usize = 16;

/// Source of the direct irradiance H_d of the samples, of which follows the first exitance `E = ρ∘H_d` of the elements.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum SampleLight<'a> {
    /// From the lighting, by shadow rays.
    #[default]
    Traced,
    /// From the caller: RGB at each of [`LightField::samples`], W/m².
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

/// Settings of a [`LightField`].
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LightSettings {
    /// Method for light between patches.
    pub method: MethodSettings,
    /// Decoder of operators in texture blocks.
    pub decode: Decode,
    /// Place where operators are built.
    pub build: Build,
    /// Initial position of the viewer, m; used by the matrix round the camera only.
    pub eye: Vec3,
    /// Rays of each hemisphere of a point of [`LightField::add_points`].
    pub point_rays: u32,
    /// Rays of each hemisphere of a point of an object that moves ([`LightField::objects`]), in each of its places.
    pub object_rays: u32,
}

impl Default for LightSettings {
    /// Classic radiosity, 1,024 rays for each point of one's own, 128 for each of an object.
    fn default() -> Self {
        Self {
            method: MethodSettings::default(),
            decode: Decode::default(),
            build: Build::default(),
            eye: Vec3::ZERO,
            point_rays: 1024,
            object_rays: 128,
        }
    }
}

setters!(LightSettings {
    /// With a method for light between patches.
    with_method(method: MethodSettings);
    /// With a decoder of operators in texture blocks.
    with_decode(decode: Decode);
    /// With a place where operators are built.
    with_build(build: Build);
    /// With an initial position of the viewer, m.
    with_eye(eye: Vec3);
    /// With so many rays for each hemisphere of a point of one's own.
    with_point_rays(point_rays: u32);
    /// With so many rays for each hemisphere of a point of an object.
    with_object_rays(object_rays: u32);
});

/// Report of a light update.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightUpdate {
    /// Counts the updates of the light field, from 0.
    pub number: u32,
    /// Times that are known: of the host's part of this update, and of passes that the device has finished since the
    /// last.
    pub times: Vec<PassTime>,
}

/// Device buffers with the irradiance of the last light update, for the caller's own shaders: each value is a `Vec4`,
/// RGB in W/m² and one unused component. `runtime::vulkan::Vulkan::buffer` gives the Vulkan buffer of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReceiverBuffers {
    /// Direct irradiance of the samples ([`LightField::samples`]); with [`SampleLight::OnDevice`] what the caller's
    /// shaders write.
    pub direct: BufferId,
    /// Irradiance of the patches, all bounces but the last two where receivers are on the mesh.
    pub patches: BufferId,
    /// Irradiance of the elements.
    pub elements: BufferId,
    /// Exitance of the elements.
    pub element_exitance: BufferId,
    /// Irradiance of the interpolation points of the mesh ([`patches::MeshReceivers::interpolation`]): what pixels take
    /// theirs from. With [`crate::ReceiverUpdate::InView`], those in view.
    pub interpolated: BufferId,
    /// First exitance of the patches.
    pub source: BufferId,
}

impl ReceiverBuffers {
    fn of(frame: &FramePlan, direct: &direct::DirectLight) -> Self {
        Self {
            direct: direct.irradiance.buffer,
            patches: frame.patches.irradiance.buffer,
            elements: frame.elements.irradiance.buffer,
            element_exitance: frame.elements.exitance.buffer,
            interpolated: frame.interpolated.buffer,
            source: frame.patches.source.buffer,
        }
    }
}

/// The light of a bake on a device: what lights, sky and emission send, by any method, up to the receivers on the
/// surfaces and to points of one's own. It has no camera and no pictures: [`crate::PictureRenderer`] makes these of it.
pub struct LightField {
    bake: Arc<Bake>,
    scene: Scene,
    executor: Box<dyn Executor>,
    method: Box<dyn Method>,
    settings: LightSettings,
    loaded: Loaded,
    sample_light: KeptLight,
    /// True if that, or the albedo, is another one than the last update's.
    has_new_source: bool,
    /// Material of each sample, once another albedo was asked for.
    sample_materials: Option<Vec<u32>>,
    /// The albedo where it is not that of the bake, and what was asked for.
    albedo: Option<Albedo>,
    asked_albedo: Vec<Option<Vec3>>,
    /// True of a method that the caller made.
    has_own_method: bool,
    eye: Vec3,
    number: u32,
    pub(crate) points: Vec<PointTables>,
    /// Number of point sets so far.
    pub(crate) point_sets: u64,
    stamps: Stamps,
    objects: ObjectTables,
}

/// Counters by which pictures on top of the light see what they must take over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Stamps {
    /// Plans that were loaded: pictures add theirs again.
    pub plan: u64,
    /// Changes of the sky or of emission.
    pub sky: u64,
    /// Changes of the albedo.
    pub albedo: u64,
    /// Moves of objects.
    pub objects: u64,
}

/// The loaded plan of the light.
struct Loaded {
    frame: FrameTables,
    direct: direct::DirectLight,
    source: source::Source,
    albedo: AlbedoBuffers,
    bounces: u32,
    buffers: ReceiverBuffers,
    /// Passes of the first exitance, those of the method, and those from its irradiance to the elements.
    source_passes: Vec<PassId>,
    method: Vec<PassId>,
    elements: Vec<PassId>,
    /// From the elements to all receivers and interpolation points.
    receivers: Vec<PassId>,
    receiver_tables: Option<ReceiverTables>,
    /// Rows of elements of which objects change some, and the objects' own light.
    element_rows: Option<ChangingRows>,
    objects: Option<ObjectLight>,
    /// True if the light of the scene's lighting is on the device, up to the elements, and up to all receivers.
    is_lit: bool,
    has_receivers: bool,
}

impl LightField {
    /// Makes what the method needs, and loads the plan of the light into the executor.
    ///
    /// # Errors
    /// An operator that does not fit into memory, a device that is too small,
    /// [`Unsupported`](crate::ErrorKind::Unsupported) for a scene with a medium, cancellation.
    pub fn new(
        bake: Arc<Bake>,
        mut executor: Box<dyn Executor>,
        settings: &LightSettings,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        let method = prepare(&bake, settings, executor.as_mut(), observer)?;
        Ok(Self { has_own_method: false, ..Self::with_method(bake, executor, settings, method)? })
    }

    /// Makes a light field with any method.
    ///
    /// # Errors
    /// A device that is too small; [`Unsupported`](crate::ErrorKind::Unsupported) for a scene with a medium.
    pub fn with_method(
        bake: Arc<Bake>,
        mut executor: Box<dyn Executor>,
        settings: &LightSettings,
        mut method: Box<dyn Method>,
    ) -> Result<Self, Error> {
        if bake.scene.has_medium() && !method.supports_media() {
            return Err(Reason::Medium { what: "this method" }.into());
        }
        let scene = bake.scene.clone();
        let content = Content { bake: &bake, scene: &scene, albedo: None, objects: None };
        let loaded = Loaded::load(&content, executor.as_mut(), method.as_mut(), &mut [])?;
        Ok(Self {
            bake,
            scene,
            executor,
            method,
            loaded,
            sample_light: KeptLight::Traced,
            has_new_source: false,
            sample_materials: None,
            albedo: None,
            asked_albedo: Vec::new(),
            has_own_method: true,
            eye: settings.eye,
            settings: settings.clone(),
            number: 0,
            points: Vec::new(),
            point_sets: 0,
            stamps: Stamps::default(),
            objects: ObjectTables::new(settings.object_rays),
        })
    }

    /// Changes the method; light starts anew.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn set_method(&mut self, method: MethodSettings, observer: &dyn Observer) -> Result<(), Error> {
        if matches!(method, MethodSettings::FirstShot(_)) && !self.objects.is_empty() {
            return Err(Reason::Objects { what: "the method firstshot" }.into());
        }
        self.settings.method = method;
        self.settings.eye = self.eye;
        self.method = prepare(&self.bake, &self.settings, self.executor.as_mut(), observer)?;
        self.has_own_method = false;
        if let Some(albedo) = &self.albedo {
            self.method.set_albedo(albedo, self.executor.as_mut())?;
        }
        self.load()
    }

    /// Takes another bake of the scene, such as a finer one: lights, albedo, settings and points of one's own stay, the
    /// light of the method starts anew. An operator that the bake does not have is built here ([`Bake::build_operators`]
    /// does so before), and the rows of points are traced. Light of the caller's own
    /// ([`Self::set_sample_light`]) has to be given again, for other samples.
    ///
    /// # Errors
    /// [`Unsupported`](crate::ErrorKind::Unsupported) with a method of the caller's, which is of its bake; as
    /// [`Self::new`]. The light field keeps the bake that it has then, unless the device is lost.
    pub fn set_bake(&mut self, bake: Arc<Bake>, observer: &dyn Observer) -> Result<(), Error> {
        if self.has_own_method {
            return Err(Reason::OwnMethod.into());
        }
        if !self.objects.is_empty() {
            check_bake(&bake)?;
        }
        let mut scene = self.objects.scene(&bake)?;
        scene.set_lighting(self.scene.lighting.clone())?;
        self.settings.eye = self.eye;
        let mut method = prepare(&bake, &self.settings, self.executor.as_mut(), observer)?;
        let mut albedo = None;
        let mut materials = None;
        if self.albedo.is_some() {
            let of_samples = materials.insert(sample_materials(&bake.scene, &bake.mesh));
            let changed = Albedo::new(&bake, of_samples, &self.asked_albedo)?;
            method.set_albedo(&changed, self.executor.as_mut())?;
            changed.give_to(&mut scene);
            albedo = Some(changed);
        }
        // What moved before stood in the other geometry.
        self.objects.forget();
        self.bake = bake;
        self.scene = scene;
        self.method = method;
        self.albedo = albedo;
        self.sample_materials = materials;
        if self.sample_light != KeptLight::Traced {
            self.sample_light = KeptLight::OnDevice { is_written: false };
        }
        self.trace_points_again(observer)?;
        self.load()
    }

    /// Takes the newest level of a bake that is refined ([`Bake::refine`]), if there is one that it does not have yet;
    /// returns true if there was. Gives the rest of the bake no time: that works on threads of its own.
    ///
    /// # Errors
    /// As [`Self::set_bake`].
    pub fn refine(&mut self, job: &BakeJob, observer: &dyn Observer) -> Result<bool, Error> {
        let Some(bake) = job.take_newest() else { return Ok(false) };
        self.set_bake(bake, observer)?;
        Ok(true)
    }

    /// Moves the viewer, m: the matrix round the camera follows in the next update; nothing else depends on it.
    pub fn set_eye(&mut self, eye: Vec3) {
        self.eye = eye;
    }

    /// Gives materials another albedo, all over in place of a texture, from the next update on: one value a material of
    /// the scene, `None` for that of the bake. Waits for nothing, but where light that bounces more often needs another
    /// plan.
    ///
    /// # Errors
    /// [`Unsupported`](crate::ErrorKind::Unsupported) of a method whose operator holds the albedo, here and from
    /// [`Self::set_method`]; [`Input`](crate::ErrorKind::Input). Nothing changes then.
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
        let needs_bounces = are_wrong(&changed.bounces, &self.loaded.bounces)
            && (self.method.depends_on_source_alone() || self.loaded.bounces <= LAST_BOUNCES);
        let changed = self.albedo.insert(changed);
        self.objects.set_moved();
        if needs_bounces {
            self.load()?;
        } else {
            let executor = self.executor.as_mut();
            self.loaded.albedo.set(executor, changed)?;
            self.loaded.upload_sky(&self.bake, Some(changed), &self.scene, executor)?;
            self.stamps.sky += 1;
        }
        self.asked_albedo = albedo.to_vec();
        if is_own {
            self.albedo = None;
        }
        self.has_new_source = true;
        self.stamps.albedo += 1;
        Ok(())
    }

    /// The points at which direct light is measured: position, m, and unit normal of the side that is lit.
    pub fn samples(&self) -> &[SurfacePoint] {
        &self.bake.mesh.points
    }

    /// Selects the source of the samples' direct irradiance from the next update on. An engine
    /// that has it already, say by looking the samples up in its shadow maps, thus saves all shadow rays of an update.
    ///
    /// A caller's irradiance is all that comes to the samples straight from lights, emissive surfaces and a sky with a
    /// map; what a constant sky sends is added to it by the updates, from the lighting. Pixels of
    /// pictures find their own direct light by the lighting, and photons start at its lights.
    ///
    /// With [`SampleLight::OnDevice`] it is called for each new content of the buffer, whose writes a memory barrier
    /// has made visible to all commands. The buffer is another one after [`Self::set_method`], after an update with
    /// more lights or another size of the sky's map than any before, and after [`Self::set_albedo`] where light then
    /// bounces more often.
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

    fn load(&mut self) -> Result<(), Error> {
        let executor = self.executor.as_mut();
        let method = self.method.as_mut();
        let objects = Some(&self.objects).filter(|objects| !objects.is_empty());
        let content = Content { bake: &self.bake, scene: &self.scene, albedo: self.albedo.as_ref(), objects };
        self.loaded = Loaded::load(&content, executor, method, &mut self.points)?;
        self.objects.set_moved();
        self.stamps.plan += 1;
        if let KeptLight::OnDevice { is_written } = &mut self.sample_light {
            *is_written = false;
        }
        Ok(())
    }

    /// Finds the light of a frame: direct light → first exitance → the method → elements → receivers, interpolation
    /// points and [points of one's own](Self::add_points). Lights may be added, removed and changed, and so may the sky
    /// and the emission of materials; only lights that have moved are traced, so one that is switched off best stays in
    /// the list with the colour zero. Submits the work and waits for nothing, but where more lights or another sky map
    /// need larger buffers, with photons that go on to an error or start where lights that are not areas have changed,
    /// and with the solvers of the host. Under the lighting of the update before, only what may still change is found.
    /// [`Self::set_sample_light`] gives direct light that is known already.
    ///
    /// # Errors
    /// Lighting that does not suit the scene; [`Input`](crate::ErrorKind::Input); what the device says.
    pub fn update(&mut self, lighting: &Lighting) -> Result<LightUpdate, Error> {
        let (update, _) = self.update_up_to(lighting, true)?;
        Ok(update)
    }

    /// A light update, to all receivers or up to the elements and the points; says whether it found another light.
    pub(crate) fn update_up_to(&mut self, lighting: &Lighting, receivers: bool) -> Result<(LightUpdate, bool), Error> {
        let is_moved = self.move_objects()?;
        let source = self.set_lighting(lighting, is_moved)?;
        let input = FrameInput { lighting: &self.scene.lighting, eye: self.eye, number: self.number };
        let executor = self.executor.as_mut();
        let is_light = !source.is_empty() || !self.method.depends_on_source_alone();
        let mut times = Vec::new();
        // Until all is submitted: what fails on the way is found again.
        self.loaded.is_lit = false;
        if is_light {
            if !source.is_empty() {
                executor.submit_passes(&source)?;
            }
            self.method.before_frame(&input, executor)?;
            self.loaded.has_receivers = false;
            times = self.submit(receivers)?;
        } else if receivers {
            self.finish_receivers()?;
        }
        self.loaded.is_lit = true;
        self.has_new_source = false;
        let number = self.number;
        self.number = self.number.wrapping_add(1);
        self.read_points(number, is_light)?;
        times.extend(self.executor.finished_times()?);
        Ok((LightUpdate { number, times }, is_light))
    }

    /// Submits the passes of a light update from the first exitance on; times of the host's part.
    fn submit(&mut self, receivers: bool) -> Result<Vec<PassTime>, Error> {
        let loaded = &mut self.loaded;
        let to_receivers: &[PassId] = if receivers { &loaded.receivers } else { &[] };
        let to_points = self.points.iter().flat_map(|points| &points.passes);
        let after = loaded.elements.iter().chain(to_receivers).chain(to_points).copied();
        let mut after: Vec<PassId> = after.collect();
        let executor = self.executor.as_mut();
        let mut times = Vec::new();
        if let Some(objects) = &loaded.objects {
            // Light that converges from frame to frame takes what is changed along.
            let is_whole = self.method.depends_on_source_alone();
            if is_whole {
                objects.clear_change(executor)?;
            }
            for _ in 0..if is_whole { OBJECT_ROUNDS } else { 1 } {
                executor.submit_passes(&objects.feed)?;
                match self.method.submit(executor) {
                    Some(of_host) => times.extend(of_host?),
                    None => executor.submit_passes(&loaded.method)?,
                }
                executor.submit_passes(&objects.change)?;
            }
            after.splice(0..0, objects.sum.iter().copied());
            executor.submit_passes(&after)?;
            loaded.has_receivers = receivers;
            return Ok(times);
        }
        match self.method.submit(executor) {
            Some(of_host) => {
                times = of_host?;
                executor.submit_passes(&after)?;
            }
            None => {
                let all: Vec<PassId> = loaded.method.iter().copied().chain(after).collect();
                executor.submit_passes(&all)?;
            }
        }
        loaded.has_receivers = receivers;
        Ok(times)
    }

    /// Finds the light of the receivers, where the last update ended at the elements.
    fn finish_receivers(&mut self) -> Result<(), Error> {
        if !self.loaded.has_receivers {
            self.executor.submit_passes(&self.loaded.receivers)?;
            self.loaded.has_receivers = true;
        }
        Ok(())
    }

    /// A light update that is waited for; milliseconds of each pass.
    ///
    /// # Errors
    /// As [`Self::update`].
    pub fn advance(&mut self, lighting: &Lighting) -> Result<Vec<(String, f64)>, Error> {
        self.executor.wait()?;
        let mut times = self.update(lighting)?.times;
        times.extend(self.executor.wait()?);
        Ok(by_name(times))
    }

    /// The scene under the lights of the last update.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Device buffers of the light. Others after [`Self::set_method`], after an update that asks for larger tables, and
    /// after [`Self::set_albedo`] where light then bounces more often.
    pub fn buffers(&self) -> &ReceiverBuffers {
        &self.loaded.buffers
    }

    /// Executor of the plan: to record into a caller's command buffer, to ask for device buffers, to wait.
    pub fn executor_mut(&mut self) -> &mut (dyn Executor + 'static) {
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

    /// The settings, with the method that was set last.
    pub fn settings(&self) -> &LightSettings {
        &self.settings
    }

    /// Bytes of all buffers of the loaded plan, those of points and of pictures on top among them.
    pub fn device_bytes(&self) -> u64 {
        self.executor.plan().bytes()
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

    /// The method, if it is an `M`, with what only the device knows of the last frame; waits for it.
    ///
    /// # Errors
    /// What the device says.
    pub fn counted_method<M: Method + 'static>(&mut self) -> Result<Option<&M>, Error> {
        self.method.count(self.executor.as_mut())?;
        Ok(self.method.as_any().downcast_ref())
    }

    /// Indirect irradiance of the last update on the surfaces, W/m²: at the interpolation points, or of the patches
    /// where they are the receivers. Waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn surface_irradiance(&mut self) -> Result<Vec<Vec3>, Error> {
        let buffer = match self.bake.settings.receivers {
            ReceiverKind::Patches => self.loaded.buffers.patches,
            ReceiverKind::Mesh => {
                if !self.loaded.has_receivers {
                    self.finish_receivers()?;
                    // Keep this work out of the times of frames.
                    self.executor.wait()?;
                }
                self.loaded.buffers.interpolated
            }
            ReceiverKind::Pixels => self.loaded.buffers.elements,
        };
        // Points of objects stand behind those of the bake.
        let resting = match self.bake.settings.receivers {
            ReceiverKind::Mesh => self.bake.receivers.interpolation.points.len(),
            _ => usize::MAX,
        };
        Ok(self.download(buffer)?.iter().take(resting).map(|h| h.truncate()).collect())
    }

    /// A buffer of RGB values of the last update, W/m²; waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn download(&mut self, buffer: BufferId) -> Result<Vec<Vec4>, Error> {
        Ok(self.executor.download_table(buffer)?)
    }

    /// Indirect irradiance of the last update at any points, W/m², on surfaces or in the air: rows of their own are
    /// traced, 4,096 rays each, and gather from the elements; with patches as receivers, points on surfaces take the
    /// mean of the patches about. Waits. For points that are asked for more than once, see [`Self::add_points`].
    ///
    /// # Errors
    /// What the device says; cancellation.
    pub fn irradiance_at(&mut self, points: &[SurfacePoint]) -> Result<Vec<Vec3>, Error> {
        let seed = self.bake.settings.seed ^ 0x706f_696e;
        self.method.count(self.executor.as_mut())?;
        if let Some(light) = self.method.irradiance_at(&self.scene, points, seed) {
            return Ok(light);
        }
        if self.bake.settings.receivers == ReceiverKind::Patches {
            return self.by_patches(points, seed);
        }
        let exitance = self.download(self.loaded.buffers.element_exitance)?;
        let exitance = &exitance[..self.bake.mesh.elements.len()];
        let scene = &self.bake.scene;
        let light = gather_at(&self.bake, scene, Columns::Elements, exitance, points, POINT_RAYS, seed)?;
        Ok(light.iter().map(|h| h.truncate()).collect())
    }

    /// Irradiance where patches are the receivers: their lookup on surfaces, rows over the patches in the air.
    fn by_patches(&mut self, points: &[SurfacePoint], seed: u32) -> Result<Vec<Vec3>, Error> {
        let bake = Arc::clone(&self.bake);
        let irradiance = self.download(self.loaded.buffers.patches)?;
        let mut light = match &bake.mesh.lookup {
            Some(lookup) => lookup.at_points(&irradiance, points)?,
            None => vec![Vec4::ZERO; points.len()],
        };
        let has_lookup = bake.mesh.lookup.is_some();
        let is_free = |k: &usize| !has_lookup || !stands_on_surface(&self.scene, &points[*k]);
        let free: Vec<usize> = (0..points.len()).filter(is_free).collect();
        if !free.is_empty() {
            let source = self.download(self.loaded.buffers.source)?;
            let albedo = self.albedo.as_ref().map_or(&bake.mesh.albedo, |albedo| &albedo.patches);
            let patches = source.iter().zip(albedo).zip(&irradiance);
            let exitance: Vec<Vec4> = patches.map(|((source, albedo), light)| *source + *albedo * *light).collect();
            let in_air: Vec<SurfacePoint> = free.iter().map(|&k| points[k]).collect();
            let found = gather_at(&bake, &self.scene, Columns::Patches, &exitance, &in_air, POINT_RAYS, seed)?;
            free.iter().zip(found).for_each(|(&k, found)| light[k] = found);
        }
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

    /// One of [`Self::debug_pictures`].
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
        let source = self.download(self.loaded.buffers.source)?;
        let irradiance = match self.bake.settings.receivers {
            ReceiverKind::Patches => self.download(self.loaded.buffers.patches)?,
            _ => {
                let elements = self.download(self.loaded.buffers.elements)?;
                self.bake.mesh.patch_means(&elements)
            }
        };
        show(&DebugView {
            scene: &self.bake.scene,
            mesh: &self.bake.mesh,
            receivers: &self.bake.receivers,
            source: &source,
            irradiance: &irradiance,
            camera,
            stops,
        })
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
            ("light shares".to_owned(), self.loaded.direct.bytes(mesh.points.len())),
            ("receivers".to_owned(), receivers.rows.bytes()),
            ("sky".to_owned(), receivers.sky_rows.bytes()),
            ("smoothing".to_owned(), receivers.smoothing.bytes()),
            ("interpolation".to_owned(), receivers.weights.bytes()),
            ("lookup".to_owned(), lookup),
        ]);
        if !self.points.is_empty() {
            bytes.insert("points".to_owned(), self.points.iter().map(PointTables::bytes).sum());
        }
        bytes.extend(own);
        bytes
    }

    /// Takes over what shines, and puts on the device what has changed of it; the passes of direct light and of the
    /// first exitance that this asks for.
    fn set_lighting(&mut self, lighting: &Lighting, is_moved: bool) -> Result<Vec<PassId>, Error> {
        if self.loaded.is_lit && self.scene.lighting == *lighting && !self.has_new_source && !is_moved {
            return Ok(Vec::new());
        }
        if !self.loaded.is_lit || is_moved {
            self.loaded.direct.forget();
        }
        let sky_changes = self.scene.lighting.sky != lighting.sky
            || self.scene.lighting.sky_map != lighting.sky_map
            || self.scene.lighting.emission != lighting.emission;
        let has_new_distributions = self.scene.lighting.distributions != lighting.distributions;
        self.scene.set_lighting(lighting.clone())?;
        let has_room = self.method.set_lighting(&self.scene, self.executor.as_mut())?;
        if !has_room || !self.loaded.frame.scene.fits(self.executor.as_ref(), &self.scene)? {
            self.load()?;
        } else if sky_changes {
            self.loaded.upload_sky(&self.bake, self.albedo.as_ref(), &self.scene, self.executor.as_mut())?;
            self.loaded.direct.forget_surroundings();
            self.stamps.sky += 1;
        }
        if has_new_distributions {
            self.loaded.frame.scene.set_distributions(self.executor.as_mut(), &self.scene.lighting.distributions)?;
            self.loaded.direct.forget();
        }
        self.loaded.frame.scene.set_lights(self.executor.as_mut(), &self.scene.lighting.lights)?;
        let mut passes = match &self.sample_light {
            KeptLight::Traced => self.set_traced_light()?,
            KeptLight::Values(values) => {
                self.executor.upload(self.loaded.direct.irradiance, values)?;
                Vec::new()
            }
            KeptLight::OnDevice { is_written: true } => Vec::new(),
            KeptLight::OnDevice { is_written: false } => return Err(Reason::SampleLightLost.into()),
        };
        passes.extend(&self.loaded.source_passes);
        if self.objects.is_moved() {
            // The plan was loaded anew on the way.
            self.move_objects()?;
        }
        if let Some(objects) = &self.loaded.objects {
            objects.set_lighting(self.executor.as_mut(), &self.scene)?;
            passes.extend(&objects.before);
        }
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
        Ok(self.loaded.direct.set(executor, lights, &params)?)
    }

    pub(crate) fn object_tables(&self) -> &ObjectTables {
        &self.objects
    }

    pub(crate) fn object_tables_mut(&mut self) -> &mut ObjectTables {
        &mut self.objects
    }

    /// Takes other objects; the ones before stay where the device has no room.
    pub(crate) fn set_object_tables(&mut self, mut objects: ObjectTables) -> Result<(), Error> {
        objects.forget();
        let mut scene = objects.scene(&self.bake)?;
        scene.set_lighting(self.scene.lighting.clone())?;
        if let Some(albedo) = &self.albedo {
            albedo.give_to(&mut scene);
        }
        let before = (std::mem::replace(&mut self.objects, objects), std::mem::replace(&mut self.scene, scene));
        if let Err(error) = self.load() {
            (self.objects, self.scene) = before;
            self.load()?;
            return Err(error);
        }
        Ok(())
    }

    /// Finds the rows of objects that have moved; returns true if some have.
    fn move_objects(&mut self) -> Result<bool, Error> {
        let Some(light) = self.loaded.objects.as_ref().filter(|_| self.objects.is_moved()) else { return Ok(false) };
        let executor = self.executor.as_mut();
        let geometry = self.objects.place(&self.scene.geometry)?;
        if self.scene.set_moved(geometry) {
            self.loaded.frame.scene.set_sky_and_emission(executor, &self.scene)?;
        }
        self.loaded.frame.scene.set_moving(executor, &self.scene.geometry)?;
        let placed = self.objects.find(&self.bake, &self.scene)?;
        if placed.factors.values.len() > self.objects.factor_room {
            self.objects.factor_room = placed.factors.values.len().next_power_of_two();
            self.load()?;
            return self.move_objects();
        }
        light.set(executor, &placed)?;
        if let Some(rows) = &mut self.loaded.element_rows {
            rows.set(executor, &item_changes(&self.objects.element_changes, RowChange::of_elements))?;
        }
        if let Some(rows) = self.loaded.receiver_tables.as_mut().and_then(|tables| tables.changing.as_mut()) {
            rows.set(executor, &item_changes(&self.objects.receiver_changes, RowChange::of_elements))?;
        }
        self.stamps.objects += 1;
        Ok(true)
    }

    /// The objects, and the executor.
    pub(crate) fn objects_and_executor(&mut self) -> (&ObjectTables, &mut (dyn Executor + 'static)) {
        (&self.objects, self.executor.as_mut())
    }

    /// Finds the light of objects again, where that of the elements is known.
    pub(crate) fn light_objects(&mut self) -> Result<(), Error> {
        let Some(objects) = self.loaded.objects.as_ref().filter(|_| self.loaded.is_lit) else { return Ok(()) };
        let passes: Vec<PassId> = objects.passes().collect();
        Ok(self.executor.submit_passes(&passes)?)
    }

    /// The objects' own light, where there are some.
    pub(crate) fn object_light(&self) -> Option<&ObjectLight> {
        self.loaded.objects.as_ref()
    }

    pub(crate) fn stamps(&self) -> Stamps {
        self.stamps
    }

    /// Returns true if receivers gather by rows of the bake, so that those in view can be found alone.
    pub(crate) fn has_receiver_rows(&self) -> bool {
        self.loaded.receiver_tables.as_ref().is_some_and(|tables| tables.rows.is_some())
    }

    /// The light of the receivers was overwritten.
    pub(crate) fn forget_receivers(&mut self) {
        self.loaded.has_receivers = false;
    }

    pub(crate) fn is_lit(&self) -> bool {
        self.loaded.is_lit && self.number > 0
    }

    /// Replaces all sections of the plan from `section` on by one, to which `add` adds its passes. What is before stays
    /// on the device, the light among it.
    pub(crate) fn load_section<T>(
        &mut self,
        section: usize,
        add: impl FnOnce(&mut FramePlan, Option<&ReceiverTables>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let device = self.executor.device().clone();
        let mut plan = self.executor.plan().clone();
        plan.truncate(section);
        plan.begin_section();
        let objects = Some(&self.objects).filter(|objects| !objects.is_empty());
        let mut frame = self.loaded.frame.plan(&self.bake, objects, self.loaded.bounces, &device, plan);
        let made = add(&mut frame, self.loaded.receiver_tables.as_ref())?;
        let FramePlan { plan, tables, .. } = frame;
        self.executor.load_after(plan, section)?;
        tables.upload(self.executor.as_mut())?;
        Ok(made)
    }

    /// Loads what stands on top of the light and of the points.
    pub(crate) fn load_on_top<T>(
        &mut self,
        add: impl FnOnce(&mut FramePlan, Option<&ReceiverTables>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        self.load_section(1 + self.points.len(), add)
    }

    /// Removes all sections of the plan from `section` on.
    pub(crate) fn unload_section(&mut self, section: usize) -> Result<(), Error> {
        let mut plan = self.executor.plan().clone();
        plan.truncate(section);
        Ok(self.executor.load_after(plan, section)?)
    }

    /// Number of the last update.
    pub(crate) fn last_update(&self) -> u32 {
        self.number.wrapping_sub(1)
    }

    /// Sections above those of the points are gone: pictures add theirs again.
    pub(crate) fn note_sections_lost(&mut self) {
        self.stamps.plan += 1;
    }
}

fn check_sample_light(values: &[Vec3], samples: usize) -> Result<(), Error> {
    if values.len() != samples {
        return Err(Reason::SampleLightCount { expected: samples, found: values.len() }.into());
    }
    let is_wrong = |value: &Vec3| !value.is_finite() || value.min_element() < 0.0;
    match values.iter().position(is_wrong) {
        Some(sample) => Err(Reason::SampleLightValue { sample, value: values[sample] }.into()),
        None => Ok(()),
    }
}

/// Makes the method of the settings.
fn prepare(
    bake: &Arc<Bake>,
    settings: &LightSettings,
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

/// Returns true if a surface lies just under a point.
fn stands_on_surface(scene: &Scene, point: &SurfacePoint) -> bool {
    let above = 2.0 * scene.geometry.ray_offset;
    let start = point.position + point.normal * above;
    !scene.closest_before(start, -point.normal, 2.0 * above).is_miss()
}

/// What a plan of the light is of.
struct Content<'a> {
    bake: &'a Arc<Bake>,
    scene: &'a Scene,
    albedo: Option<&'a Albedo>,
    objects: Option<&'a ObjectTables>,
}

impl Loaded {
    /// Makes the plan, with the passes of points, loads it and uploads everything that stays.
    fn load(
        content: &Content,
        executor: &mut (dyn Executor + 'static),
        method: &mut dyn Method,
        points: &mut [PointTables],
    ) -> Result<Self, Error> {
        let Content { bake, scene, albedo, objects } = *content;
        let device = executor.device().clone();
        let bounces = albedo.map_or(bake.bounces, |albedo| albedo.bounces);
        let capacity = scene.lighting.lights.len().next_power_of_two().max(MIN_LIGHTS);
        let mut frame = FramePlan::new(bake, scene, objects, capacity, bounces, &device);
        let tables = frame.scene;
        let direct = direct::add(&mut frame, &tables)?;
        let source = source::add(&mut frame, &direct)?;
        let source_passes = source.passes.to_vec();
        let objects = match (objects, frame.changed) {
            (Some(objects), Some(changed)) => Some(ObjectLight::new(&mut frame, objects, changed)?),
            _ => None,
        };
        let own = passes_of(&mut frame, |frame| method.add_passes(frame))?.1;
        let (element_rows, mut elements) = passes_of(&mut frame, |frame| gather::add_elements(frame, method))?;
        elements.extend(objects.iter().flat_map(|objects| &objects.after));
        let (receiver_tables, receivers) = passes_of(&mut frame, |frame| gather::add_receivers(frame, method))?;
        let buffers = ReceiverBuffers::of(&frame, &direct);
        let albedo_buffers = AlbedoBuffers::of(&frame, &source);
        let frame_tables = FrameTables::of(&frame);
        for set in points {
            frame.plan.begin_section();
            set.add(&mut frame)?;
        }
        load_plan(frame, executor)?;
        direct.clear(executor)?;
        let mut loaded = Self {
            frame: frame_tables,
            direct,
            source,
            albedo: albedo_buffers,
            bounces,
            buffers,
            source_passes,
            method: own,
            elements,
            receivers,
            receiver_tables,
            element_rows,
            objects,
            is_lit: false,
            has_receivers: false,
        };
        loaded.frame.scene.set_distributions(executor, &scene.lighting.distributions)?;
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
        self.frame.scene.set_sky_and_emission(executor, scene)?;
        let elements = albedo.map_or(&bake.mesh.element_albedo, |albedo| &albedo.elements);
        Ok(executor.upload(self.source.emission, &source::sky_exitance(bake, elements, &scene.lighting))?)
    }
}

/// The passes that `add` adds, behind what it gives.
fn passes_of<T>(
    frame: &mut FramePlan,
    add: impl FnOnce(&mut FramePlan) -> Result<T, Error>,
) -> Result<(T, Vec<PassId>), Error> {
    let before = frame.plan.passes().len();
    let made = add(frame)?;
    Ok((made, frame.plan.all_passes().split_off(before)))
}

/// Loads a plan with the tables that stay, and clears what the first frame adds to.
fn load_plan(frame: FramePlan, executor: &mut (dyn Executor + 'static)) -> Result<(), Error> {
    let cleared = frame.initial_zeros();
    let FramePlan { plan, tables, .. } = frame;
    executor.load(plan)?;
    tables.upload(executor)?;
    Ok(cleared.into_iter().try_for_each(|buffer| executor.clear(buffer))?)
}

/// Irradiance at points by rows of their own over the patches or the elements, W/m².
pub(crate) fn gather_at(
    bake: &Bake,
    scene: &Scene,
    columns: Columns,
    exitance: &[Vec4],
    points: &[SurfacePoint],
    rays: u32,
    seed: u32,
) -> Result<Vec<Vec4>, Error> {
    let offsets: Vec<u32> = (0..=points.len() as u32).collect();
    let surfaces = bake.mesh.lighting(scene, columns, points, &offsets, seed);
    Ok(gather_by_rays(&surfaces, rays, exitance, &ignore_progress)?)
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
