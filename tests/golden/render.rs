//! Every call of the renderer that the golden pictures need, so that a change of its interface is
//! followed here alone.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use assets::{Animation, LoadedScene, View, procedural};
use integration_tests::vulkan;
use localmatrix::{BakeFile, LocalSettings};
use multibounce::BlockCodec;
use patches::PatchKind;
use patchlight::light::with_lights;
use patchlight::low_level::operator::Codec;
use patchlight::method::{FeedbackSettings, FirstShotSettings, LocalSettings as CameraSettings, TemporalSettings};
use patchlight::world::{StreamSettings, Streamed, WorldSettings, bake};
use patchlight::{
    Bake, BakeSettings, Estimator, LightSettings, MethodSettings, Picture, PictureRenderer, PictureSettings,
    ReceiverKind, Silent,
};
use reference::Accumulation;
use reference::path::{PathSettings, PathTracer};
use runtime::executor::{DeviceChoice, DeviceKind, Executor, open};
use scene::Light;

/// Picture size, pixels.
const SIZE: (u32, u32) = (48, 32);
/// Sub-frames a picture.
const SUB_FRAMES: u32 = 2;
/// Frames of a sequence.
const FRAMES: u32 = 3;
/// Frames of the whole flight of which a sequence shows the first: so close that the local matrix
/// keeps most patches.
const FLIGHT_FRAMES: f32 = 24.0;
/// Paths a pixel.
const PATHS: u32 = 4;
const SEED: u32 = 3;
/// The streaming world: as small as `city` can be.
pub const CITY: &str = "city:125000";
/// Resident memory of its bake at most, bytes.
const CITY_MEMORY: u64 = 4 << 30;
/// Bytes of its rows that stay in memory.
const CITY_CACHE: usize = 1 << 20;

/// Linear RGB row by row from the top, W/m²/sr.
#[derive(Clone, Debug, PartialEq)]
pub struct Pixels {
    pub width: u32,
    pub height: u32,
    pub values: Vec<[f32; 3]>,
}

/// Content of a frame; streaming worlds do not separate indirect light.
#[derive(Clone, Debug, PartialEq)]
pub struct FramePixels {
    pub full: Pixels,
    pub indirect: Option<Pixels>,
}

/// Device that runs the kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Device {
    Cpu,
    Lavapipe,
}

/// Method for light from patch to patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    Classic,
    MultibounceDense,
    MultibounceBc7,
    LowRank,
    Feedback,
    Temporal,
    Local,
    FirstShot,
    PathTracing,
}

/// A scene, what patches are and where irradiance is gathered.
#[derive(Clone, Copy, Debug)]
pub struct Subject {
    /// Name in the table.
    pub name: &'static str,
    /// The built-in scene.
    scene: &'static str,
    patches: PatchKind,
    receivers: ReceiverKind,
    pub methods: &'static [Method],
}

impl Subject {
    /// Three scenes with every method; other kinds of patches and receivers with one or two.
    pub const ALL: [Self; 6] = [
        Self::of("cornell", &Method::ALL),
        Self::of("atrium:3000", &Method::ALL),
        Self::of("office", &Method::ALL),
        Self {
            name: "cornell, polygon patches",
            patches: PatchKind::Polygon,
            ..Self::of("cornell", &[Method::Classic])
        },
        Self {
            name: "cornell, axis patches as receivers",
            patches: PatchKind::Axis,
            receivers: ReceiverKind::Patches,
            ..Self::of("cornell", &[Method::Classic, Method::Temporal])
        },
        Self {
            name: "cornell, voxel patches, pixels as receivers",
            patches: PatchKind::Voxel,
            receivers: ReceiverKind::Pixels,
            ..Self::of("cornell", &[Method::Classic])
        },
    ];

    const fn of(scene: &'static str, methods: &'static [Method]) -> Self {
        let patches = PatchKind::Cluster;
        let receivers = ReceiverKind::Mesh;
        Self { name: scene, scene, patches, receivers, methods }
    }
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 9] = [
        Self::Classic,
        Self::MultibounceDense,
        Self::MultibounceBc7,
        Self::LowRank,
        Self::Feedback,
        Self::Temporal,
        Self::Local,
        Self::FirstShot,
        Self::PathTracing,
    ];

    /// Name in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Classic => "classic",
            Self::MultibounceDense => "multibounce dense",
            Self::MultibounceBc7 => "multibounce bc7",
            Self::LowRank => "low_rank",
            Self::Feedback => "feedback",
            Self::Temporal => "temporal",
            Self::Local => "local",
            Self::FirstShot => "firstshot",
            Self::PathTracing => "path",
        }
    }

    /// Returns true if it has no kernels, so that its pictures are the processor's on every device.
    pub fn is_of_host(self) -> bool {
        self == Self::PathTracing
    }

    /// None for path tracing.
    fn settings(self) -> Option<MethodSettings> {
        let local = CameraSettings { slots: 96, budget: 16, ..CameraSettings::DEFAULT };
        let photons = FirstShotSettings { error: 0.2, most_photons: 1 << 16, ..FirstShotSettings::default() };
        Some(match self {
            Self::Classic => MethodSettings::Classic,
            Self::MultibounceDense => MethodSettings::Multibounce(Codec::Dense),
            Self::MultibounceBc7 => MethodSettings::Multibounce(Codec::Blocks(BlockCodec::Bc7)),
            Self::LowRank => MethodSettings::Multibounce(Codec::LowRank { epsilon: 0.01 }),
            Self::Feedback => MethodSettings::Feedback(FeedbackSettings::default()),
            Self::Temporal => MethodSettings::Temporal(TemporalSettings::default()),
            Self::Local => MethodSettings::Local(local),
            Self::FirstShot => MethodSettings::FirstShot(photons),
            Self::PathTracing => return None,
        })
    }
}

/// A scene and its bake, for every method.
pub struct BakedScene {
    loaded: LoadedScene,
    bake: Arc<Bake>,
}

impl BakedScene {
    /// Builds and bakes a scene.
    pub fn new(subject: &Subject) -> Self {
        let loaded = procedural::build(subject.scene).unwrap();
        let settings = BakeSettings::default()
            .with_patches(subject.patches)
            .with_patch_count(250)
            .with_samples(8)
            .with_sample_rays(4)
            .with_estimator(Estimator::Hemisphere { rays: 256 })
            .with_receivers(subject.receivers)
            .with_most_receivers(Some(1000))
            .with_receiver_rays(64)
            .with_seed(SEED);
        let bake = Arc::new(Bake::build(&loaded.scene, &settings, &Silent).unwrap());
        Self { loaded, bake }
    }
}

/// Frames of a method with the lights moving along the scene's default animation; in those of the
/// local method the camera flies, too. Path tracing gives one frame with the lights at rest.
pub fn render(scene: &BakedScene, method: Method, device: Device) -> Vec<FramePixels> {
    let loaded = &scene.loaded;
    let Some(method_settings) = method.settings() else { return vec![trace(loaded)] };
    let light = LightSettings::default().with_method(method_settings).with_eye(loaded.view.eye);
    let pictures = PictureSettings::default().with_size(SIZE).with_sub_frames(SUB_FRAMES);
    let mut renderer =
        PictureRenderer::of_bake(Arc::clone(&scene.bake), executor(device), &light, &pictures, &Silent).unwrap();
    let mut frames = Vec::new();
    for number in 0..FRAMES {
        let lighting = with_lights(&loaded.scene, &lights_at(loaded, number));
        let view = if method == Method::Local { flown(loaded, number) } else { loaded.view };
        let camera = view.camera(SIZE.0, SIZE.1);
        let pictures = renderer.picture(&lighting, &camera, number).unwrap().pictures;
        let indirect = Some(pixels(&pictures.indirect));
        frames.push(FramePixels { full: pixels(&pictures.full), indirect });
    }
    frames
}

fn trace(loaded: &LoadedScene) -> FramePixels {
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let settings = PathSettings { seed: SEED, ..PathSettings::default() };
    let mut sums = Accumulation::new(&camera, settings);
    let ignore_progress = |_: u32, _: u32| ControlFlow::Continue(());
    PathTracer::new(&loaded.scene).accumulate(&camera, &mut sums, PATHS, ignore_progress).unwrap();
    FramePixels { full: pixels(&sums.full()), indirect: Some(pixels(&sums.indirect())) }
}

/// Bakes the streaming world into a file.
pub fn bake_city(loaded: &LoadedScene, file: &Path) {
    let scene = CITY.to_owned();
    let settings = WorldSettings { scene, voxel_size: None, patch_count: 400, rays: 64, seed: SEED };
    bake(&loaded.scene, loaded.content_hash, &settings, None, file, CITY_MEMORY, &Silent).unwrap();
}

/// The streaming world itself.
pub fn build_city() -> LoadedScene {
    procedural::build(CITY).unwrap()
}

/// Frames of a flight through a bake, every one of which waits for its rows: which patches stand for
/// the world does not hang on the disk.
pub fn fly_city(loaded: &LoadedScene, file: &Path) -> Vec<FramePixels> {
    let flight: Vec<View> = (0..FRAMES).map(|number| flown(loaded, number)).collect();
    let lights: Vec<Vec<Light>> = (0..FRAMES).map(|number| lights_at(loaded, number)).collect();
    let settings = StreamSettings {
        local: LocalSettings { slots: 64, changes: 16, ..LocalSettings::default() },
        // Rows ahead of the camera come when the disk has them.
        predicted_frames: 0.0,
        at_rest: true,
        cache: CITY_CACHE,
        sub_frames: SUB_FRAMES,
        size: SIZE,
        is_measured: false,
    };
    let stops = loaded.exposure_stops;
    let scene = loaded.scene.clone();
    let bake = BakeFile::open(file).unwrap();
    let mut streamed = Streamed::new(scene, loaded.content_hash, bake, executor(Device::Cpu), settings).unwrap();
    streamed.settle(flight[0].eye, &|_| true).unwrap();
    let mut frames = Vec::new();
    for (view, lights) in flight.iter().zip(&lights) {
        let camera = view.camera(SIZE.0, SIZE.1);
        let (picture, _) = streamed.frame(lights, &camera, stops).unwrap();
        frames.push(FramePixels { full: pixels(&picture), indirect: None });
    }
    frames
}

/// The driver of lavapipe; nothing, with the reason printed, where the best Vulkan device is
/// another or none.
pub fn lavapipe() -> Option<String> {
    let vulkan = vulkan()?;
    let device = vulkan.device();
    if device.kind != DeviceKind::EmulatedOnCpu {
        println!("skipped: the Vulkan device is {}, not lavapipe", device.name);
        return None;
    }
    Some(format!("{}, {}", device.name, device.driver))
}

fn executor(device: Device) -> Box<dyn Executor> {
    match device {
        Device::Cpu => open(&DeviceChoice::Cpu).unwrap().0,
        Device::Lavapipe => Box::new(vulkan().expect("lavapipe was there")),
    }
}

fn lights_at(loaded: &LoadedScene, frame: u32) -> Vec<Light> {
    let path = Animation::or_default_path(loaded);
    path.at(path.duration() * frame as f32 / FRAMES as f32).0
}

fn flown(loaded: &LoadedScene, frame: u32) -> View {
    let path = Animation::fly(loaded);
    path.at(path.duration() * frame as f32 / FLIGHT_FRAMES).1
}

fn pixels(picture: &Picture) -> Pixels {
    let values = picture.pixels.iter().map(|pixel| pixel.to_array()).collect();
    Pixels { width: picture.width, height: picture.height, values }
}
