//! The light and its picture, frame by frame, as the state wants them.

use std::sync::Arc;

use glam::{Affine3A, Vec3};
use patchlight::debug::DebugKind;
use patchlight::low_level::operator::{Build, Decode};
use patchlight::outputs::LiveProbes;
use patchlight::{
    Bake, BakeJob, LightSettings, MethodSettings, Observer, Picture, PictureRenderer, PictureSettings, PixelLight,
    ReceiverKind, ReceiverUpdate,
};
use rayon::prelude::*;
use runtime::executor::{Executor, PassTime};
use scene::kernel::shade::{decode_srgb, encode_srgb};
use scene::sampling::hammersley;
use scene::{Camera, DisplayTransform, Scene};
use shell::sequence::Moving;

use crate::error::Error;
use crate::eye::Eye;
use crate::lights::Edits;
use crate::methods::goes_on;
use crate::object::{self, Object};
use crate::screen::{Screen, Side, Source};
use crate::state::{Shown, State};

/// Frames under lights at rest in which a method that goes on is followed.
pub const SETTLING: u32 = 32;
/// Pictures that are averaged when nothing moves.
pub const SMOOTHED: u32 = 16;
/// Difference of an exposure that nobody notices, stops.
const UNNOTICED_STOPS: f32 = 0.02;
/// Share of what is missing that automatic exposure makes up for in a frame.
const ADAPTED: f32 = 0.3;

/// All that a picture depends on.
#[derive(Clone, Debug, PartialEq)]
struct Wanted {
    edits: Edits,
    albedo: Vec<Option<Vec3>>,
    object: Option<Object>,
    /// Time of what moves, s.
    places: Vec<Affine3A>,
    eye: Eye,
    size: (u32, u32),
    display: DisplayTransform,
    shown: Shown,
    method: MethodSettings,
    sub_frames: u32,
    is_smooth: bool,
}

/// The light of a bake, and what was last shown of it.
pub struct Live {
    renderer: PictureRenderer,
    method: (String, MethodSettings),
    albedo: Vec<Option<Vec3>>,
    /// Objects of the scene that move, and their places.
    moving: Option<Moving>,
    places: Vec<Affine3A>,
    /// Probes of the object, once it was there.
    probes: Option<LiveProbes>,
    sub_frames: u32,
    last: Option<Wanted>,
    rest: u32,
    /// True if the last frame differed from the one before in more than its size.
    is_moving: bool,
    /// True once an automatic exposure was found.
    is_exposed: bool,
    smooth: Smooth,
}

/// Sums of pictures of what rests, each seen through other points of the pixels: edges become smooth.
#[derive(Default)]
struct Smooth {
    /// Linear codes of red, green and blue.
    sums: Vec<f32>,
    count: u32,
}

impl Smooth {
    /// Adds a displayed picture; returns their mean as one.
    fn add(&mut self, bytes: &[u8]) -> Vec<u8> {
        if self.count == 0 {
            self.sums.clear();
            self.sums.resize(bytes.len() / 4 * 3, 0.0);
        }
        self.count += 1;
        let scale = 1.0 / self.count as f32;
        let mut mean = bytes.to_vec();
        let pixels = mean.par_chunks_exact_mut(4).zip(self.sums.par_chunks_exact_mut(3));
        pixels.for_each(|(pixel, sums)| {
            for (code, sum) in pixel.iter_mut().zip(sums) {
                *sum += decode_srgb(f32::from(*code) / 255.0);
                *code = (encode_srgb(*sum * scale) * 255.0 + 0.5) as u8;
            }
        });
        mean
    }
}

/// A camera that looks through other points of the pixels: point `k` of [`SMOOTHED`] in each; the first is the middle.
fn shifted(camera: &Camera, k: u32) -> Camera {
    let (x, y) = if k == 0 { (0.5, 0.5) } else { hammersley(k, SMOOTHED, (0, 0)) };
    let across = camera.right * (2.0 * (x - 0.5) / camera.width as f32);
    let up = camera.up * (2.0 * (y - 0.5) / camera.height as f32);
    Camera { forward: camera.forward + across + up, ..*camera }
}

impl Live {
    /// Puts a bake on an executor.
    ///
    /// # Errors
    /// [`Error::PixelReceivers`]; what the library says.
    pub fn new(
        bake: Arc<Bake>,
        executor: Box<dyn Executor>,
        state: &State,
        size: (u32, u32),
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        check(&bake)?;
        let chosen = state.methods.chosen();
        let light = LightSettings::default()
            .with_method(chosen.settings)
            .with_decode(Decode::Auto)
            .with_build(Build::default())
            .with_eye(state.eye.position);
        let pictures = PictureSettings::default()
            .with_size(size)
            .with_sub_frames(state.sub_frames)
            .with_receivers(ReceiverUpdate::InView)
            .with_direct(PixelLight::Smooth)
            .with_materials(state.reflection);
        let mut renderer = PictureRenderer::of_bake(bake, executor, &light, &pictures, observer)?;
        let moving = match Moving::add(renderer.light_mut(), &state.moving) {
            Ok(moving) => Some(moving),
            Err(error) if error.kind() == patchlight::ErrorKind::Unsupported => {
                observer.warn(&format!("nothing moves: {error}"));
                None
            }
            Err(error) => return Err(error.into()),
        };
        let method = (chosen.name.clone(), chosen.settings);
        let albedo = vec![None; state.albedo.len()];
        Ok(Self {
            renderer,
            method,
            albedo,
            moving,
            places: Vec::new(),
            probes: None,
            sub_frames: state.sub_frames,
            last: None,
            rest: 0,
            is_moving: false,
            is_exposed: false,
            smooth: Smooth::default(),
        })
    }

    /// Size of pictures, pixels.
    pub fn size(&self) -> (u32, u32) {
        self.renderer.size()
    }

    /// Bytes of each part.
    pub fn bytes(&self) -> Vec<(String, u64)> {
        self.renderer.light().bytes().into_iter().collect()
    }

    /// The bake that is shown.
    pub fn bake(&self) -> &Arc<Bake> {
        self.renderer.light().bake()
    }

    /// The scene under the lights that are shown.
    pub fn scene(&self) -> &Scene {
        self.renderer.light().scene()
    }

    /// Returns true if the light and its picture change no more by themselves.
    pub fn is_settled(&self) -> bool {
        self.is_at_rest() && !self.is_moving && (!self.is_smoothed() || self.smooth.count >= SMOOTHED)
    }

    /// Returns true if something moved in the last frame.
    pub fn is_moving(&self) -> bool {
        self.is_moving
    }

    /// Returns true if the light changes no more by itself.
    fn is_at_rest(&self) -> bool {
        self.last.is_some() && (!goes_on(&self.method.1) || self.rest >= SETTLING)
    }

    /// Returns true if what is shown becomes smoother at rest.
    fn is_smoothed(&self) -> bool {
        self.sub_frames == 1 && self.last.as_ref().is_some_and(|last| last.is_smooth && last.shown == Shown::Light)
    }

    /// Finds light and picture where they have changed, and gives them to the screen; times of the passes, none where
    /// nothing has changed.
    ///
    /// # Errors
    /// What the library says. A method that cannot be had is told in the state, and the one before stays.
    pub fn frame(
        &mut self,
        state: &mut State,
        size: (u32, u32),
        screen: &mut Screen,
        observer: &dyn Observer,
    ) -> Result<Option<Vec<PassTime>>, Error> {
        self.set_method(state, observer)?;
        self.set_albedo(state)?;
        self.place_probes(state, observer)?;
        self.move_objects(state)?;
        let shown = self.last.clone();
        if size != self.size() || state.sub_frames != self.sub_frames {
            self.renderer.resize(size, state.sub_frames)?;
            self.sub_frames = state.sub_frames;
            self.last = None;
        }
        let wanted = Wanted {
            edits: state.lighting.edits(),
            albedo: self.albedo.clone(),
            object: Some(state.object).filter(|object| object.is_on),
            places: self.places.clone(),
            eye: state.eye,
            size,
            display: state.display,
            shown: state.shown,
            method: self.method.1,
            sub_frames: self.sub_frames,
            is_smooth: state.is_smooth,
        };
        let is_new = self.last.as_ref() != Some(&wanted);
        let same = |last| Wanted { size, display: wanted.display, ..last };
        self.is_moving = is_new && shown.map(same).as_ref() != Some(&wanted);
        if !is_new && self.is_settled() {
            return Ok(None);
        }
        if is_new {
            self.rest = 0;
            self.smooth.count = 0;
        } else if self.is_at_rest() && self.is_smoothed() {
            let camera = shifted(&wanted.eye.camera(size), self.smooth.count);
            let times = self.show_light(state, &wanted, &camera, true, screen)?;
            return Ok(Some(times));
        } else {
            self.rest += 1;
        }
        let camera = wanted.eye.camera(size);
        let times = match wanted.shown {
            Shown::Debug(kind) => self.show_debug(kind, state, (&wanted, &camera), screen)?,
            // Where the error is not known yet, light.
            Shown::Light | Shown::Error => self.show_light(state, &wanted, &camera, false, screen)?,
        };
        self.last = Some(wanted);
        self.expose(state)?;
        Ok(Some(times))
    }

    /// Lets the exposure follow what was shown, not all at once.
    fn expose(&mut self, state: &mut State) -> Result<(), Error> {
        if !state.is_auto_exposed || matches!(state.shown, Shown::Debug(_)) {
            return Ok(());
        }
        let missing = self.renderer.automatic_stops()? - state.display.stops;
        if missing.abs() > UNNOTICED_STOPS {
            let is_first = !std::mem::replace(&mut self.is_exposed, true);
            state.display.stops += if is_first { missing } else { missing * ADAPTED };
        }
        Ok(())
    }

    /// The picture that is shown, linear; waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn picture(&mut self, state: &State) -> Result<(Camera, Picture), Error> {
        let camera = state.eye.camera(self.size());
        let done = self.renderer.picture(&state.lighting.lighting(), &camera, 0)?;
        Ok((camera, done.pictures.full))
    }

    /// Takes the newest level of a bake that is refined; true if there was one.
    ///
    /// # Errors
    /// What the library says.
    pub fn refine(&mut self, job: &BakeJob, state: &mut State, observer: &dyn Observer) -> Result<bool, Error> {
        let is_new = self.renderer.refine(job, observer)?;
        if is_new {
            self.last = None;
            state.facts.quality = quality(self.renderer.light().bake());
        }
        Ok(is_new)
    }

    fn set_method(&mut self, state: &mut State, observer: &dyn Observer) -> Result<(), Error> {
        let chosen = state.methods.chosen().clone();
        if chosen.settings == self.method.1 {
            return Ok(());
        }
        self.last = None;
        match self.renderer.set_method(chosen.settings, observer) {
            Ok(()) => self.method = (chosen.name, chosen.settings),
            Err(error) => {
                state.facts.message = format!("{}: {error}", chosen.name);
                *state.methods.settings_mut() = chosen.settings;
                if state.methods.choose(&self.method.0).is_ok() {
                    *state.methods.settings_mut() = self.method.1;
                }
                self.renderer.set_method(self.method.1, observer)?;
            }
        }
        Ok(())
    }

    /// Moves what moves to where it is at its time.
    fn move_objects(&mut self, state: &State) -> Result<(), Error> {
        let places = state.places();
        if let Some(moving) = self.moving.as_ref().filter(|_| places != self.places) {
            moving.place(self.renderer.light_mut(), &places)?;
        }
        self.places = places;
        Ok(())
    }

    /// Gives materials the albedo that they are to have; under a method that holds that of the bake they keep what they
    /// have.
    fn set_albedo(&mut self, state: &mut State) -> Result<(), Error> {
        if state.albedo == self.albedo {
            return Ok(());
        }
        match self.renderer.light_mut().set_albedo(&state.albedo) {
            Ok(()) => self.albedo.clone_from(&state.albedo),
            Err(error) if error.kind() == patchlight::ErrorKind::Unsupported => {
                state.facts.message = error.to_string();
                state.albedo.clone_from(&self.albedo);
            }
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    /// Places the probes that light the object, when it is there for the first time.
    fn place_probes(&mut self, state: &mut State, observer: &dyn Observer) -> Result<(), Error> {
        if !state.object.is_on || self.probes.is_some() {
            return Ok(());
        }
        match LiveProbes::new(self.renderer.light_mut(), object::PROBES, object::PROBE_RAYS, observer) {
            Ok(probes) => self.probes = Some(probes),
            Err(error) if error.is_cancelled() => return Err(error.into()),
            Err(error) => {
                state.facts.message = format!("no object: {error}");
                state.object.is_on = false;
            }
        }
        Ok(())
    }

    fn show_light(
        &mut self,
        state: &State,
        wanted: &Wanted,
        camera: &Camera,
        is_smoothed: bool,
        screen: &mut Screen,
    ) -> Result<Vec<PassTime>, Error> {
        let lighting = state.lighting.lighting();
        let update = self.renderer.display(&lighting, camera, 0, &wanted.display)?;
        let displayed = self.renderer.displayed();
        let handle = self.renderer.light_mut().vulkan_mut().and_then(|vulkan| vulkan.buffer(displayed));
        let size = self.size();
        match handle.filter(|_| wanted.object.is_none() && !is_smoothed) {
            Some(handle) => screen.set_picture(Side::Left, size, &Source::Device(handle))?,
            None => {
                let mut bytes = self.renderer.light_mut().executor_mut().download(displayed)?;
                if let Some((object, probes)) = wanted.object.zip(self.probes.as_mut()) {
                    probes.update(self.renderer.light_mut())?;
                    let scene = self.renderer.light().scene();
                    object::draw(&mut bytes, camera, &wanted.display, &object, probes, scene);
                }
                if is_smoothed {
                    bytes = self.smooth.add(&bytes);
                }
                screen.set_picture(Side::Left, size, &Source::Host(&bytes))?;
            }
        }
        self.times(update.times)
    }

    fn show_debug(
        &mut self,
        kind: DebugKind,
        state: &State,
        (wanted, camera): (&Wanted, &Camera),
        screen: &mut Screen,
    ) -> Result<Vec<PassTime>, Error> {
        let update = self.renderer.update_light(&state.lighting.lighting(), camera)?;
        let shown = self.renderer.light_mut().debug_picture(kind, camera, wanted.display.stops)?;
        let bytes = rgba(&shown.picture, &DisplayTransform::clipped(shown.stops));
        screen.set_picture(Side::Left, self.size(), &Source::Host(&bytes))?;
        self.times(update.times)
    }

    /// The times of an update and of what has finished since.
    fn times(&mut self, mut times: Vec<PassTime>) -> Result<Vec<PassTime>, Error> {
        times.extend(self.renderer.light_mut().executor_mut().finished_times()?);
        Ok(times)
    }
}

/// What a bake says of itself: its size, and the estimate of its error.
pub fn quality(bake: &Bake) -> String {
    let sizes = format!("{} patches, {} receivers", bake.mesh().patches.len(), bake.receivers().points.len());
    match bake.energy().and_then(|energy| energy.near) {
        Some(near) => format!("{sizes}; {}", near.summary("mean indirect light")),
        None => sizes,
    }
}

/// Refuses a bake whose light is not on the device.
///
/// # Errors
/// [`Error::PixelReceivers`].
pub fn check(bake: &Bake) -> Result<(), Error> {
    match bake.settings().receivers {
        ReceiverKind::Pixels => Err(Error::PixelReceivers),
        ReceiverKind::Mesh | ReceiverKind::Patches => Ok(()),
    }
}

/// A picture as it is displayed, bytes red, green, blue and 255.
pub fn rgba(picture: &Picture, transform: &DisplayTransform) -> Vec<u8> {
    let bytes = picture.shown_bytes(transform);
    bytes.chunks_exact(3).flat_map(|rgb| [rgb[0], rgb[1], rgb[2], 255]).collect()
}
