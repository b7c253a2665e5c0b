//! Contenders of experiments: each way to find indirect light as a frame needs it, from lights that moved to irradiance
//! in view.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use cpu_time::ProcessTime;
use glam::{Vec3, Vec4};
use opponents::denoise::{DenoiseSettings, Guides, denoise};
use opponents::{Ddgi, DdgiSettings, IrradianceVolume, Lpv, LpvSettings, ProxyLookup, ViewedPoint, VolumeSettings};
use reference::{Accumulation, PathSettings, PathTracer, Picture, Strategy};
use runtime::executor::{DeviceChoice, DeviceKind, Executor};
use scene::sampling::hash3;
use scene::{Lighting, NONE, Scene, SurfacePoint};
use shell::device::open;

use super::View;
use super::field::{Between, PatchMethod};
use crate::bench::setup::load;
use crate::error::Error;
use crate::probes::DeviceDdgi;
use crate::progress::{Progress, interruptible};
use crate::proxy::{ProxyRadiosity, ProxySettings};
use crate::sequence::pass_ms;
use patchlight::{Bake, LightField, LightSettings, PictureRenderer, PictureSettings, Pictures, ReceiverUpdate};
use solvers::Solved;

/// Seed that sets the paths of an opponent apart from those of the reference.
const OTHER_PATHS: u32 = 0x6f70_706f;
/// Pixels that reflect less over π are not divided by what they reflect.
const MIN_ALBEDO: f32 = 0.01;
/// Pass of a light update between patches, and the part of a renderer's memory that its products read.
const METHOD: &str = "method";
const OPERATOR: &str = "operator";

/// Time of some work, ms.
#[derive(Clone, Copy, Debug)]
pub struct Time {
    pub wall: f64,
    /// Time of all processors together: what else the machine does is hardly in it.
    pub processor: f64,
}

impl Time {
    fn of<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<(T, Self), Error> {
        let start = Instant::now();
        let processor = ProcessTime::now();
        let result = work()?;
        let wall = 1e3 * start.elapsed().as_secs_f64();
        Ok((result, Self { wall, processor: 1e3 * processor.elapsed().as_secs_f64() }))
    }
}

/// Times of a frame.
#[derive(Clone, Copy, Debug)]
pub struct FrameTime {
    /// From lights that moved to irradiance where the method keeps it.
    pub update: Time,
    /// From there to each pixel's irradiance, where that can be told apart.
    pub lookup: Option<Time>,
    /// Time of light between patches alone, ms, of the update.
    pub method_ms: Option<f64>,
}

/// A way to find indirect light.
pub trait Contender {
    /// Name of its kind, a line of the plots.
    fn family(&self) -> &'static str;
    /// Name.
    fn name(&self) -> String;
    /// A whole light update of frame `number`.
    fn frame(&mut self, lighting: &Lighting, number: u32) -> Result<FrameTime, Error>;
    /// Irradiance or radiance at what is seen, as it is now: what tells how far a jump of the lights is followed.
    fn light(&mut self) -> Result<Vec<Vec3>, Error>;
    /// Returns true if light of one frame depends on the frames before.
    fn remembers(&self) -> bool;
    /// Pictures of now under the scene's own lights; `direct` is added where there is no own direct light.
    fn pictures(&mut self, direct: Option<&Picture>) -> Result<Pictures, Error>;
    /// Indirect irradiance at points, W/m²; nothing where light is only found in pixels.
    fn at_points(&mut self, points: &[SurfacePoint]) -> Result<Option<Vec<Vec3>>, Error>;
    /// Bytes that light needs from frame to frame.
    fn bytes(&self) -> u64;
    /// Bytes of an operator that each light update reads once, if it has one.
    fn operator_bytes(&self) -> Option<u64> {
        None
    }
    /// Time of preparation before the first frame, s.
    fn build_s(&self) -> f64;
    /// Probes that are on and all, or cells.
    fn size(&self) -> String;
}

/// The project's own patches.
pub struct OwnPatches<'a> {
    view: &'a View<'a>,
    method: PatchMethod,
    /// Ending of its name, beside others of its kind.
    label: &'static str,
    renderer: PictureRenderer,
    build_s: f64,
    patches: usize,
}

impl<'a> OwnPatches<'a> {
    /// A bake that took `bake_s` on the device, what is in view.
    pub fn new(
        view: &'a View<'a>,
        bake: &Arc<Bake>,
        bake_s: f64,
        method: PatchMethod,
        label: &'static str,
    ) -> Result<Self, Error> {
        let light = LightSettings::default().with_eye(view.loaded.view.eye);
        let pictures = PictureSettings::default()
            .with_size(view.args.size())
            .with_sub_frames(view.args.sub_frames)
            .with_receivers(ReceiverUpdate::InView);
        let start = Instant::now();
        let renderer = match method.between {
            Between::Method(method) => {
                load(view.common, bake, &light.with_method(method), &pictures, &Progress::new(true))?
            }
            Between::Solver(solver) => {
                let solved = Box::new(Solved::new(solver, bake)?);
                let light = LightField::with_method(Arc::clone(bake), executor_of(view)?, &light, solved)?;
                PictureRenderer::new(light, &pictures)?
            }
        };
        let build_s = bake_s + start.elapsed().as_secs_f64();
        Ok(Self { view, method, label, renderer, build_s, patches: bake.mesh().patches.len() })
    }
}

impl Contender for OwnPatches<'_> {
    fn family(&self) -> &'static str {
        self.method.name
    }

    fn name(&self) -> String {
        format!("{}{}", self.method.name, self.label)
    }

    fn frame(&mut self, lighting: &Lighting, _: u32) -> Result<FrameTime, Error> {
        let (passes, update) = Time::of(|| Ok(interruptible(|| self.renderer.advance(lighting, &self.view.camera))?))?;
        Ok(FrameTime { update, lookup: None, method_ms: Some(pass_ms(&passes, METHOD)) })
    }

    fn light(&mut self) -> Result<Vec<Vec3>, Error> {
        Ok(self.renderer.light_mut().surface_irradiance()?)
    }

    fn remembers(&self) -> bool {
        true
    }

    fn pictures(&mut self, _: Option<&Picture>) -> Result<Pictures, Error> {
        let lighting = &self.view.loaded.scene.lighting;
        Ok(interruptible(|| self.renderer.picture(lighting, &self.view.camera, 0))?.pictures)
    }

    fn at_points(&mut self, points: &[SurfacePoint]) -> Result<Option<Vec<Vec3>>, Error> {
        Ok(Some(self.renderer.light_mut().irradiance_at(points)?))
    }

    fn bytes(&self) -> u64 {
        self.renderer.light().bytes().values().sum()
    }

    fn operator_bytes(&self) -> Option<u64> {
        self.renderer.light().bytes().get(OPERATOR).copied()
    }

    fn build_s(&self) -> f64 {
        self.build_s
    }

    fn size(&self) -> String {
        format!("{} patches", self.patches)
    }
}

/// Light that is kept in a volume and looked up at points.
pub trait Volume {
    fn update(&mut self, lighting: &Lighting, frame: u32) -> Result<(), Error>;
    fn irradiance_at(&self, points: &[ViewedPoint]) -> Result<Vec<Vec3>, patchlight::Error>;
    /// Looks up the points in view, where a frame needs it: for the time that it takes.
    fn look_up_view(&self, view: &[ViewedPoint]) -> Result<(), Error> {
        std::hint::black_box(self.irradiance_at(view)?);
        Ok(())
    }
    fn bytes(&self) -> u64;
    fn size(&self) -> String;
}

/// The device of the options.
fn executor_of(view: &View) -> Result<Box<dyn Executor>, Error> {
    Ok(open(&DeviceChoice::parse(&view.common.device))?.0)
}

/// Returns true if kernels run on a graphics processor, of whose work processor time knows nothing.
pub fn has_graphics_processor(view: &View) -> Result<bool, Error> {
    let kind = executor_of(view)?.device().kind;
    Ok(!matches!(kind, DeviceKind::Native | DeviceKind::EmulatedOnCpu))
}

/// DDGI as native code, or on the device that the project's own methods run on.
pub enum Probes {
    Native(Box<Ddgi>),
    OnDevice(Box<DeviceDdgi>),
}

impl Probes {
    fn new(view: &View, settings: DdgiSettings) -> Result<Self, Error> {
        let scene = &view.loaded.scene;
        let executor = executor_of(view)?;
        if executor.device().kind == DeviceKind::Native {
            return Ok(Self::Native(Box::new(Ddgi::new(scene, settings)?)));
        }
        Ok(Self::OnDevice(Box::new(DeviceDdgi::new(scene, settings, executor, &view.points)?)))
    }

    /// Probes and their positions.
    fn placed(&self) -> &Ddgi {
        match self {
            Self::Native(probes) => probes,
            Self::OnDevice(probes) => probes.placed(),
        }
    }
}

impl Volume for Probes {
    fn update(&mut self, lighting: &Lighting, frame: u32) -> Result<(), Error> {
        match self {
            Self::Native(probes) => Ok(probes.update(lighting, frame)?),
            Self::OnDevice(probes) => probes.update(&lighting.lights, frame),
        }
    }

    fn irradiance_at(&self, points: &[ViewedPoint]) -> Result<Vec<Vec3>, patchlight::Error> {
        match self {
            Self::Native(probes) => Ok(probes.irradiance_at(points)),
            Self::OnDevice(probes) => Ok(probes.irradiance_at(points)?),
        }
    }

    fn look_up_view(&self, view: &[ViewedPoint]) -> Result<(), Error> {
        match self {
            Self::Native(probes) => {
                std::hint::black_box(probes.irradiance_at(view));
                Ok(())
            }
            Self::OnDevice(probes) => Ok(probes.look_up_view()?),
        }
    }

    fn bytes(&self) -> u64 {
        self.placed().bytes()
    }

    fn size(&self) -> String {
        let (all, on) = self.placed().probe_counts();
        format!("{on} of {all} probes")
    }
}

impl Volume for Lpv {
    fn update(&mut self, lighting: &Lighting, _: u32) -> Result<(), Error> {
        Ok(Self::update(self, lighting)?)
    }

    fn irradiance_at(&self, points: &[ViewedPoint]) -> Result<Vec<Vec3>, patchlight::Error> {
        Ok(Self::irradiance_at(self, points))
    }

    fn bytes(&self) -> u64 {
        Self::bytes(self)
    }

    fn size(&self) -> String {
        let grid = |([x, y, z], edge): ([u32; 3], f32)| format!("{x} × {y} × {z} cells of {edge:.3} m");
        self.grids().map(grid).collect::<Vec<_>>().join(", ")
    }
}

impl Volume for IrradianceVolume {
    fn update(&mut self, lighting: &Lighting, _: u32) -> Result<(), Error> {
        Ok(self.bake(lighting)?)
    }

    fn irradiance_at(&self, points: &[ViewedPoint]) -> Result<Vec<Vec3>, patchlight::Error> {
        Ok(Self::irradiance_at(self, points))
    }

    fn bytes(&self) -> u64 {
        Self::bytes(self)
    }

    fn size(&self) -> String {
        format!("{} probes", self.probe_count())
    }
}

impl Volume for ProxyRadiosity<'_> {
    fn update(&mut self, lighting: &Lighting, _: u32) -> Result<(), Error> {
        Self::update(self, lighting)
    }

    fn irradiance_at(&self, points: &[ViewedPoint]) -> Result<Vec<Vec3>, patchlight::Error> {
        let point = |p: &ViewedPoint| SurfacePoint { position: p.position, patch: NONE, normal: p.normal, weight: 1.0 };
        let points: Vec<SurfacePoint> = points.iter().map(point).collect();
        Ok(Self::irradiance_at(self, &points, ProxyLookup::Bilinear))
    }

    fn bytes(&self) -> u64 {
        Self::bytes(self)
    }

    fn size(&self) -> String {
        format!("{} faces of {:.3} m", self.patch_count(), self.edge())
    }
}

/// A volume as a contender.
pub struct Volumetric<'a, V> {
    view: &'a View<'a>,
    family: &'static str,
    name: String,
    volume: V,
    build_s: f64,
    remembers: bool,
}

impl<'a> Volumetric<'a, Probes> {
    /// `label` says why the spacing is what it is, where it was not asked for.
    pub fn ddgi(view: &'a View<'a>, settings: DdgiSettings, label: &str) -> Result<Self, Error> {
        let start = Instant::now();
        let volume = Probes::new(view, settings)?;
        let build_s = start.elapsed().as_secs_f64();
        let spacing = volume.placed().spacing().max_element();
        let name = format!("DDGI {spacing:.2} m, {} rays{label}", settings.rays);
        Ok(Self { view, family: "DDGI", name, volume, build_s, remembers: true })
    }

    /// Probes that are on.
    pub fn probe_count(&self) -> usize {
        self.volume.placed().probe_counts().1
    }
}

impl<'a> Volumetric<'a, Lpv> {
    pub fn lpv(view: &'a View<'a>, settings: LpvSettings) -> Result<Self, Error> {
        let start = Instant::now();
        let volume = Lpv::new(&view.loaded.scene, settings)?;
        let build_s = start.elapsed().as_secs_f64();
        let name = format!("LPV {} cells", settings.cells);
        Ok(Self { view, family: "LPV", name, volume, build_s, remembers: false })
    }
}

impl<'a> Volumetric<'a, IrradianceVolume> {
    pub fn baked(view: &'a View<'a>, settings: VolumeSettings) -> Result<Self, Error> {
        let start = Instant::now();
        let volume = IrradianceVolume::new(&view.loaded.scene, settings)?;
        let build_s = start.elapsed().as_secs_f64();
        let name = format!("irradiance volume {:.2} m, L{}", volume.spacing().max_element(), settings.bands);
        Ok(Self { view, family: "irradiance volume", name, volume, build_s, remembers: false })
    }
}

impl<'a> Volumetric<'a, ProxyRadiosity<'a>> {
    pub fn voxel_proxy(view: &'a View<'a>, settings: ProxySettings, progress: &Progress) -> Result<Self, Error> {
        let start = Instant::now();
        let volume = ProxyRadiosity::bake(&view.loaded.scene, settings, progress)?;
        let build_s = start.elapsed().as_secs_f64();
        let name = "voxel proxy".to_owned();
        Ok(Self { view, family: "voxel proxy", name, volume, build_s, remembers: false })
    }
}

impl<V: Volume + Sync> Contender for Volumetric<'_, V> {
    fn family(&self) -> &'static str {
        self.family
    }

    fn name(&self) -> String {
        self.name.clone()
    }

    fn frame(&mut self, lighting: &Lighting, number: u32) -> Result<FrameTime, Error> {
        let ((), update) = Time::of(|| interruptible(|| self.volume.update(lighting, number)))?;
        let ((), lookup) = Time::of(|| self.volume.look_up_view(&self.view.points))?;
        Ok(FrameTime { update, lookup: Some(lookup), method_ms: None })
    }

    fn light(&mut self) -> Result<Vec<Vec3>, Error> {
        Ok(self.volume.irradiance_at(&self.view.points)?)
    }

    fn remembers(&self) -> bool {
        self.remembers
    }

    fn pictures(&mut self, direct: Option<&Picture>) -> Result<Pictures, Error> {
        let view = self.view;
        let gather = |points: &[SurfacePoint], _: u32| {
            let points: Vec<ViewedPoint> = points.iter().map(|p| view.viewed(p)).collect();
            Ok(self.volume.irradiance_at(&points)?.iter().map(|h| h.extend(0.0)).collect())
        };
        view.with_direct(view.gathered(&gather)?, direct)
    }

    fn at_points(&mut self, points: &[SurfacePoint]) -> Result<Option<Vec<Vec3>>, Error> {
        let points: Vec<ViewedPoint> = points.iter().map(|p| self.view.viewed(p)).collect();
        Ok(Some(self.volume.irradiance_at(&points)?))
    }

    fn bytes(&self) -> u64 {
        self.volume.bytes()
    }

    fn build_s(&self) -> f64 {
        self.build_s
    }

    fn size(&self) -> String {
        self.volume.size()
    }
}

/// So many paths a pixel in every frame, with or without the denoiser.
pub struct Paths<'a> {
    view: &'a View<'a>,
    scene: Scene,
    samples: u32,
    denoiser: Option<Denoiser>,
    build_s: f64,
    shown: Picture,
}

/// Inputs of the denoiser.
struct Denoiser {
    guides: Guides,
    /// Albedo of the pixels over π, with edges as smooth as those of the picture.
    albedo: Picture,
}

impl<'a> Paths<'a> {
    pub fn new(view: &'a View<'a>, samples: u32, is_denoised: bool) -> Result<Self, Error> {
        let start = Instant::now();
        let denoiser = if is_denoised { Some(Denoiser::new(view)?) } else { None };
        let build_s = start.elapsed().as_secs_f64();
        let shown = Picture::new(view.camera.width, view.camera.height);
        Ok(Self { view, scene: view.loaded.scene.clone(), samples, denoiser, build_s, shown })
    }

    /// Indirect radiance of the pixels.
    fn trace(&self, number: u32) -> Result<Picture, Error> {
        let seed = hash3(self.view.common.seed, number, OTHER_PATHS);
        // A few paths do not pay for learning where the sun matters.
        let settings = PathSettings { seed, strategy: Strategy::ShadowRays, ..PathSettings::default() };
        let mut sums = Accumulation::new(&self.view.camera, settings);
        PathTracer::new(&self.scene)
            .accumulate(&self.view.camera, &mut sums, self.samples, |_, _| ControlFlow::Continue(()))?;
        let indirect = sums.indirect();
        match &self.denoiser {
            Some(denoiser) => denoiser.denoise(&indirect, self.samples),
            None => Ok(indirect),
        }
    }
}

impl Denoiser {
    fn new(view: &View) -> Result<Self, Error> {
        let ones = |points: &[SurfacePoint], _: u32| Ok(vec![Vec4::ONE; points.len()]);
        Ok(Self { guides: Guides::new(&view.loaded.scene, &view.camera), albedo: view.gathered(&ones)? })
    }

    /// Irradiance is denoised, so that textures stay sharp. More paths have less noise, beside which edges of light
    /// show.
    fn denoise(&self, indirect: &Picture, samples: u32) -> Result<Picture, Error> {
        let usual = DenoiseSettings::default();
        let settings = DenoiseSettings { colour: usual.colour / (samples as f32).sqrt(), ..usual };
        let share = |albedo: Vec3| albedo.max(Vec3::splat(MIN_ALBEDO));
        let irradiance = indirect.combine(&self.albedo, |light, albedo| light / share(albedo))?;
        let clean = denoise(&irradiance, &self.guides, &settings)?;
        Ok(clean.combine(&self.albedo, |light, albedo| light * share(albedo))?)
    }
}

impl Contender for Paths<'_> {
    fn family(&self) -> &'static str {
        if self.denoiser.is_some() { "path tracing, denoised" } else { "path tracing" }
    }

    fn name(&self) -> String {
        let denoised = if self.denoiser.is_some() { ", denoised" } else { "" };
        format!("path tracing, {} a pixel{denoised}", self.samples)
    }

    fn frame(&mut self, lighting: &Lighting, number: u32) -> Result<FrameTime, Error> {
        self.scene.set_lighting(lighting.clone()).map_err(reference::Error::from)?;
        let (shown, update) = Time::of(|| interruptible(|| self.trace(number)))?;
        self.shown = shown;
        Ok(FrameTime { update, lookup: None, method_ms: None })
    }

    fn light(&mut self) -> Result<Vec<Vec3>, Error> {
        Ok(self.shown.pixels.clone())
    }

    fn remembers(&self) -> bool {
        false
    }

    fn pictures(&mut self, direct: Option<&Picture>) -> Result<Pictures, Error> {
        self.view.with_direct(self.shown.clone(), direct)
    }

    fn at_points(&mut self, _: &[SurfacePoint]) -> Result<Option<Vec<Vec3>>, Error> {
        Ok(None)
    }

    fn bytes(&self) -> u64 {
        0
    }

    fn build_s(&self) -> f64 {
        self.build_s
    }

    fn size(&self) -> String {
        format!("{} paths", self.samples as usize * self.shown.pixels.len())
    }
}
