//! Pictures of a light field: primary rays, direct light at pixels, shading, display.

use std::sync::Arc;

use patches::Columns;
use runtime::executor::Executor;
use runtime::plan::{BufferId, PassId, Slice};
use scene::{Camera, DisplayTransform, Lighting, Materials, Rgb, SurfacePoint};
use transport::Observer;

use crate::bake::{Bake, ReceiverKind};
use crate::error::{Error, Reason};
use crate::job::BakeJob;
use crate::light::{LightField, LightSettings, LightUpdate, Stamps, by_name, gather_at};
use crate::low_level::frame::FramePlan;
use crate::low_level::stage::finish::FinishTables;
use crate::low_level::stage::gather::ReceiverTables;
use crate::low_level::stage::objects::ObjectLight;
use crate::low_level::stage::shade::PixelLight;
use crate::low_level::stage::{display, shade, sky, view};
use crate::method::MethodSettings;
use crate::objects::rows::{RowChange, item_changes};
use crate::picture::{Picture, Pictures};
use crate::pixels::PixelGather;
use crate::settings::setters;

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

/// Settings of a [`PictureRenderer`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PictureSettings {
    /// Picture size, pixels.
    pub size: (u32, u32),
    /// Sub-frames a picture: positions in each pixel, and shadow rays of area lights.
    pub sub_frames: u32,
    /// Which receivers a light update computes.
    pub receivers: ReceiverUpdate,
    /// Method for direct light of large sources at pixels.
    pub direct: PixelLight,
    /// Reflection of surfaces; other than diffuse with receivers on the mesh and [`PixelLight::Smooth`].
    pub materials: Materials,
}

impl Default for PictureSettings {
    /// 16 sub-frames of 960 × 540.
    fn default() -> Self {
        Self {
            size: (960, 540),
            sub_frames: 16,
            receivers: ReceiverUpdate::All,
            direct: PixelLight::default(),
            materials: Materials::default(),
        }
    }
}

setters!(PictureSettings {
    /// With a picture size, pixels.
    with_size(size: (u32, u32));
    /// With so many sub-frames a picture.
    with_sub_frames(sub_frames: u32);
    /// With the receivers that a light update computes.
    with_receivers(receivers: ReceiverUpdate);
    /// With a method for direct light of large sources at pixels.
    with_direct(direct: PixelLight);
    /// With a reflection of surfaces.
    with_materials(materials: Materials);
});

/// A rendered frame.
pub struct FrameResult {
    /// The picture.
    pub pictures: Pictures,
    /// Milliseconds of each pass: direct, gather, method, lookup, shade.
    pub times: Vec<(String, f64)>,
}

/// A picture that the device is at work on, of [`PictureRenderer::begin_picture`].
#[must_use = "PictureRenderer::end_picture gives the picture"]
pub struct PendingPicture {
    camera: Camera,
    number: u32,
    update: LightUpdate,
}

/// Pictures of a light field. Its plan stands on top of the light's: another size, or other settings, load it alone and
/// leave the light as it is.
pub struct PictureRenderer {
    light: LightField,
    settings: PictureSettings,
    plan: PicturePlan,
    /// False after a plan that did not fit: the next call tries again.
    is_loaded: bool,
    seen: Stamps,
}

/// The loaded plan of the pictures.
struct PicturePlan {
    shade: shade::Shade,
    display: display::Display,
    /// Update of what is in view, where that is all that is computed.
    view: Option<view::View>,
    /// The camera whose primary rays the buffers of the pixels have, where they keep them.
    seen_from: Option<Camera>,
    /// Light straight from the sky at the interpolation points, where pixels show it, and whether it is there.
    sky: Option<sky::SkyLight>,
    has_sky_light: bool,
}

/// Inputs that change in a light update: the light of the elements, and the camera whose view is computed.
struct Changes {
    is_light: bool,
    is_view: bool,
}

impl PictureRenderer {
    /// Loads the plan of pictures on top of a light field's.
    ///
    /// # Errors
    /// A device that is too small.
    pub fn new(mut light: LightField, settings: &PictureSettings) -> Result<Self, Error> {
        let plan = PicturePlan::load(&mut light, settings)?;
        let seen = light.stamps();
        Ok(Self { light, settings: *settings, plan, is_loaded: true, seen })
    }

    /// Puts a bake on an executor, with pictures of its light: [`LightField::new`] and [`Self::new`] in one.
    ///
    /// # Errors
    /// As both.
    pub fn of_bake(
        bake: Arc<Bake>,
        executor: Box<dyn Executor>,
        light: &LightSettings,
        pictures: &PictureSettings,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        Self::new(LightField::new(bake, executor, light, observer)?, pictures)
    }

    /// The light.
    pub fn light(&self) -> &LightField {
        &self.light
    }

    /// The light, to change its method, albedo or points.
    pub fn light_mut(&mut self) -> &mut LightField {
        &mut self.light
    }

    /// The light alone.
    pub fn into_light(self) -> LightField {
        self.light
    }

    /// The settings.
    pub fn settings(&self) -> &PictureSettings {
        &self.settings
    }

    /// Size of pictures, pixels.
    pub fn size(&self) -> (u32, u32) {
        self.settings.size
    }

    /// Changes the method of the light, which starts anew.
    ///
    /// # Errors
    /// As [`LightField::set_method`]; a device that is too small.
    pub fn set_method(&mut self, method: MethodSettings, observer: &dyn Observer) -> Result<(), Error> {
        self.light.set_method(method, observer)?;
        self.follow()
    }

    /// Takes the newest level of a bake that is refined, if there is one; returns true if there was. See
    /// [`LightField::refine`].
    ///
    /// # Errors
    /// As [`LightField::set_bake`]; a device that is too small.
    pub fn refine(&mut self, job: &BakeJob, observer: &dyn Observer) -> Result<bool, Error> {
        let is_new = self.light.refine(job, observer)?;
        if is_new {
            self.follow()?;
        }
        Ok(is_new)
    }

    /// Changes the size of pictures, pixels, and their sub-frames; the light stays.
    ///
    /// # Errors
    /// A device that is too small.
    pub fn resize(&mut self, size: (u32, u32), sub_frames: u32) -> Result<(), Error> {
        self.settings.size = size;
        self.settings.sub_frames = sub_frames;
        self.load()
    }

    /// Changes which receivers a light update computes; the light of the elements stays.
    ///
    /// # Errors
    /// A device that is too small.
    pub fn set_receivers(&mut self, receivers: ReceiverUpdate) -> Result<(), Error> {
        self.settings.receivers = receivers;
        self.load()
    }

    fn load(&mut self) -> Result<(), Error> {
        self.is_loaded = false;
        self.plan = PicturePlan::load(&mut self.light, &self.settings)?;
        self.seen = self.light.stamps();
        self.is_loaded = true;
        Ok(())
    }

    /// Takes over what has changed of the light: its plan, the sky, the albedo.
    fn follow(&mut self) -> Result<(), Error> {
        let stamps = self.light.stamps();
        if !self.is_loaded || stamps.plan != self.seen.plan {
            return self.load();
        }
        if stamps.sky != self.seen.sky {
            self.plan.set_sky(&mut self.light)?;
        }
        if stamps.objects != self.seen.objects {
            self.plan.set_objects(&mut self.light)?;
        }
        if stamps.albedo != self.seen.albedo {
            // Pixels look up their albedo again.
            self.plan.seen_from = None;
        }
        self.seen = stamps;
        Ok(())
    }

    /// Returns true if light updates end at the elements, and find the receivers in view alone.
    fn is_in_view(&self) -> bool {
        self.settings.receivers == ReceiverUpdate::InView && self.light.has_receiver_rows()
    }

    /// A light update, [`LightField::update`], seen by a camera: with [`ReceiverUpdate::InView`] it finds the receivers
    /// that the camera shows; the viewer of the light is the camera. Waits for nothing, as that does.
    ///
    /// # Errors
    /// As [`LightField::update`].
    pub fn update_light(&mut self, lighting: &Lighting, camera: &Camera) -> Result<LightUpdate, Error> {
        let (update, changes) = self.update_elements(lighting, camera)?;
        let Some(view) = &self.plan.view else { return Ok(update) };
        let passes = match changes {
            Changes { is_view: true, .. } => {
                let passes = [self.plan.shade.first_primary().to_vec(), view.passes()].concat();
                // The same places in the pixels for every camera: what is in view follows from the camera alone.
                self.set_shot(camera, 0)?;
                self.plan.seen_from = None;
                passes
            }
            Changes { is_light: true, .. } => view.gathers(),
            _ => Vec::new(),
        };
        self.light.executor_mut().submit_passes(&passes)?;
        Ok(update)
    }

    /// A light update seen by a camera that is waited for; milliseconds of each pass.
    ///
    /// # Errors
    /// As [`LightField::update`].
    pub fn advance(&mut self, lighting: &Lighting, camera: &Camera) -> Result<Vec<(String, f64)>, Error> {
        self.light.executor_mut().wait()?;
        let mut times = self.update_light(lighting, camera)?.times;
        times.extend(self.light.executor_mut().wait()?);
        Ok(by_name(times))
    }

    /// A light update up to the elements, and to all receivers if these are updated.
    fn update_elements(&mut self, lighting: &Lighting, camera: &Camera) -> Result<(LightUpdate, Changes), Error> {
        self.light.set_eye(camera.eye);
        let in_view = self.is_in_view();
        let (update, is_light) = self.light.update_up_to(lighting, !in_view)?;
        self.follow()?;
        let plan = &mut self.plan;
        let executor = self.light.executor_mut();
        if let Some(sky) = plan.sky.as_ref().filter(|sky| !plan.has_sky_light && !sky.passes.is_empty()) {
            executor.submit_passes(&sky.passes)?;
            plan.has_sky_light = true;
        }
        let is_view = match &mut plan.view {
            Some(view) => view.set(executor, camera, is_light)?,
            None => false,
        };
        Ok((update, Changes { is_light, is_view }))
    }

    /// Makes the passes of the pixels ready for a camera, with the random numbers of frame `number`.
    fn set_shot(&mut self, camera: &Camera, number: u32) -> Result<(), Error> {
        let plan = &self.plan;
        let seeds = shade::sub_frame_seeds(number, plan.shade.sub_frames(), self.light.bake().settings.seed);
        let scene = self.light.scene();
        let shot = shade::Shot {
            camera,
            light_count: scene.lighting.lights.len() as u32,
            emitter_count: scene.emitters.len() as u32,
            group_count: scene.emitter_groups.len() as u32,
            has_sky: scene.has_sky(),
            seeds: &seeds,
        };
        Ok(plan.shade.set(self.light.executor_mut(), &shot)?)
    }

    /// Receivers and interpolation points that the last light update was for; waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn count_updated(&mut self) -> Result<(usize, usize), Error> {
        let receivers = &self.light.bake().receivers;
        let all = (receivers.points.len(), receivers.interpolation.points.len());
        match &self.plan.view {
            Some(view) => Ok(view.count(self.light.executor_mut(), all.0)?),
            None => Ok(all),
        }
    }

    /// A light update and a picture of it; waits. Random numbers are those of frame `number`.
    ///
    /// # Errors
    /// As [`Self::update_light`].
    pub fn picture(&mut self, lighting: &Lighting, camera: &Camera, number: u32) -> Result<FrameResult, Error> {
        let pending = self.begin_picture(lighting, camera, number)?;
        self.end_picture(pending)
    }

    /// Submits what [`Self::picture`] waits for: meanwhile the caller may write the previous picture into a file.
    /// [`Self::end_picture`] gives it, before anything else is asked of the renderer.
    ///
    /// # Errors
    /// As [`Self::update_light`].
    pub fn begin_picture(
        &mut self,
        lighting: &Lighting,
        camera: &Camera,
        number: u32,
    ) -> Result<PendingPicture, Error> {
        self.light.executor_mut().wait()?;
        let (update, _) = self.update_elements(lighting, camera)?;
        self.set_shot(camera, number)?;
        self.plan.seen_from = None;
        self.light.executor_mut().submit_passes(self.plan.shade.passes())?;
        self.plan.keep_hits(camera);
        Ok(PendingPicture { camera: *camera, number, update })
    }

    /// The picture that was begun last; waits for it.
    ///
    /// # Errors
    /// What the device says.
    pub fn end_picture(&mut self, pending: PendingPicture) -> Result<FrameResult, Error> {
        let PendingPicture { camera, number, update } = pending;
        let mut times = update.times;
        times.extend(self.light.executor_mut().wait()?);
        let times = by_name(times);
        let full = self.sum(self.plan.shade.full)?;
        let direct = self.sum(self.plan.shade.direct)?;
        let indirect = match self.light.bake().settings.receivers {
            ReceiverKind::Mesh | ReceiverKind::Patches => full.minus(&direct)?,
            ReceiverKind::Pixels => self.gather_pixels(&camera, number)?,
        };
        let full = direct.plus(&indirect)?;
        Ok(FrameResult { pictures: Pictures { full, direct, indirect }, times })
    }

    /// Updates and tone-maps to [`Self::displayed`]. Colours are those of
    /// [`Self::picture`] but for rounding, where receivers are on the mesh or patches; with receivers at pixels, which
    /// are gathered on the host, indirect light is missing. Submits the work and waits for nothing, as
    /// [`Self::update_light`] does. From the camera of the picture before, in one sub-frame of [`PixelLight::Smooth`],
    /// primary rays are not traced again.
    ///
    /// # Errors
    /// As [`Self::update_light`].
    pub fn display(
        &mut self,
        lighting: &Lighting,
        camera: &Camera,
        number: u32,
        transform: &DisplayTransform,
    ) -> Result<LightUpdate, Error> {
        let (update, changes) = self.update_elements(lighting, camera)?;
        self.set_shot(camera, number)?;
        let plan = &mut self.plan;
        let executor = self.light.executor_mut();
        plan.display.set(executor, transform)?;
        let is_seen = plan.seen_from == Some(*camera) && !changes.is_view;
        plan.seen_from = None;
        executor.submit_passes(&plan.display_passes(is_seen))?;
        plan.keep_hits(camera);
        Ok(update)
    }

    /// Buffer of the picture after [`Self::display`]: a word a pixel, row by row from the top, its bytes red, green,
    /// blue and 255 from the lowest. Another buffer after a call that changes the plan of the light or of the pictures.
    pub fn displayed(&self) -> BufferId {
        self.plan.display.pixels.buffer
    }

    /// Exposure, stops, that would make the picture of the last [`Self::display`] neither dark nor bright, whatever its
    /// own was; waits. The same as [`Picture::automatic_stops`] of the picture.
    ///
    /// # Errors
    /// What the device says.
    pub fn automatic_stops(&mut self) -> Result<f32, Error> {
        Ok(self.plan.display.automatic_stops(self.light.executor_mut())?)
    }

    fn gather_pixels(&mut self, camera: &Camera, frame: u32) -> Result<Picture, Error> {
        let exitance = self.light.download(self.light.buffers().element_exitance)?;
        let bake = self.light.bake();
        let scene = self.light.scene();
        let settings = bake.settings;
        let gather = |points: &[SurfacePoint], seed: u32| {
            gather_at(bake, scene, Columns::Elements, &exitance, points, settings.receiver_rays, seed)
        };
        let pixels = PixelGather {
            scene,
            gather: &gather,
            lights: &scene.lighting.lights,
            camera,
            frame,
            sub_frames: self.settings.sub_frames,
            seed: settings.seed,
        };
        pixels.indirect()
    }

    fn sum(&mut self, sum: Slice<Rgb>) -> Result<Picture, Error> {
        let scale = 1.0 / self.plan.shade.sub_frames() as f32;
        let sums = self.light.executor_mut().download_table(sum)?;
        let (width, height) = self.settings.size;
        Ok(Picture::from_pixels(width, height, sums.iter().map(|c| c.truncate() * scale).collect())?)
    }
}

impl PicturePlan {
    /// Loads the passes on top of a light field's and fills what the first picture finds.
    fn load(light: &mut LightField, settings: &PictureSettings) -> Result<Self, Error> {
        let objects = light.object_light().cloned();
        let mut plan = light.load_on_top(|frame, receivers| Self::add(frame, receivers, objects.as_ref(), settings))?;
        let executor = light.executor_mut();
        plan.shade.clear(executor)?;
        if let Some(view) = &plan.view {
            view.clear(executor)?;
            light.forget_receivers();
            light.light_objects()?;
        }
        plan.set_sky(light)?;
        plan.set_objects(light)?;
        Ok(plan)
    }

    /// Adds the passes of pictures to a plan.
    fn add(
        frame: &mut FramePlan,
        receivers: Option<&ReceiverTables>,
        objects: Option<&ObjectLight>,
        settings: &PictureSettings,
    ) -> Result<Self, Error> {
        let tables = frame.scene;
        let indirect = shade::Indirect::of_bake(frame);
        let smooth = receivers.filter(|_| settings.direct == PixelLight::Smooth);
        let sky = smooth.map(|receivers| sky::add(frame, receivers, objects)).transpose()?;
        let has_finish = settings.materials == Materials::Gltf && !frame.bake.scene.geometry.finishes.is_empty();
        if has_finish && objects.is_some() {
            return Err(Reason::Objects { what: "the finish of surfaces" }.into());
        }
        let finish = match (smooth, &sky) {
            (Some(receivers), Some(sky)) if has_finish => FinishTables::new(frame, receivers, sky),
            _ if has_finish => return Err(Reason::FinishReceivers.into()),
            _ => None,
        };
        let PictureSettings { size, sub_frames, .. } = *settings;
        let mut shade = shade::add(frame, &tables, &indirect, size, sub_frames, sky.as_ref(), finish)?;
        let in_view = receivers.filter(|_| settings.receivers == ReceiverUpdate::InView);
        let view = view::add(frame, &tables, in_view, &indirect, &mut shade)?;
        let display = display::add(frame, &shade, settings.size)?;
        Ok(Self { shade, display, view, seen_from: None, sky, has_sky_light: false })
    }

    /// Takes over the sky of the light's scene.
    fn set_sky(&mut self, light: &mut LightField) -> Result<(), Error> {
        if let Some(sky) = &self.sky {
            let bins = sky.bins_of(light.scene());
            sky.set(light.executor_mut(), &bins)?;
            self.has_sky_light = false;
        }
        Ok(())
    }

    /// Takes over what objects cover of the sky, and where they are.
    fn set_objects(&mut self, light: &mut LightField) -> Result<(), Error> {
        if let Some(rows) = self.sky.as_mut().and_then(|sky| sky.changing.as_mut()) {
            let (tables, executor) = light.objects_and_executor();
            rows.set(executor, &item_changes(&tables.receiver_changes, RowChange::of_sky))?;
            self.has_sky_light = false;
        }
        // Primary rays meet them elsewhere.
        self.seen_from = None;
        if let Some(view) = &mut self.view {
            view.forget_camera();
        }
        Ok(())
    }

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
}
