//! `patchlight render`.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use reference::metrics::{compare_pictures, compare_points, difference_picture, indirect_scale, point_errors};
use reference::path::{PathSettings, PathTracer};
use reference::{BlockErrors, DisplayTransform, PictureFile as _, ReferenceData, stops_to_scale};

use super::args::{DirectLight, Render};
use crate::photons;
use crate::worst_blocks::worst_blocks;
use assets::import::LoadedScene;
use patchlight::debug::DebugPicture;
use patchlight::light::with_lights;
use patchlight::low_level::operator::{Build, Codec, Decode, OperatorKey, decoder_name};
use patchlight::memory::{check_free, peak_memory_bytes};
use patchlight::method::firstshot::FirstShotMethod;
use patchlight::method::multibounce::Multibounce;
use patchlight::{
    Bake, BakeSettings, FrameResult, LightSettings, MethodSettings, PictureRenderer, PictureSettings, Pictures,
    PixelLight, ReceiverUpdate,
};
use runtime::executor::{DeviceChoice, Executor};
use runtime::graph::Graph;
use runtime::recipe::multibounce::Decoder;
use scene::{Camera, Lighting, Materials};
use shell::Error;
use shell::args::{Bounces, Common, DisplaySettings, Method};
use shell::device::open;
use shell::opened::{Opened, best_method, build, open_device};
use shell::output;
use shell::path;
use shell::progress::{Progress, interruptible, is_cancelled};
use shell::report::significant;
use shell::sequence::{Movement, Moving, Sequence, Shot, light_update_ms};
use shell::summary::{LightUpdate, PassTimes, PhotonCounts, Summary};

/// Most sub-frames with which frames update only the receivers in view.
const MAX_SUB_FRAMES_IN_VIEW: u32 = 2;
/// Paths a point when a reference asks for irradiance at points.
const POINT_PATHS: u32 = 4096;
/// Bytes of a pixel: sums of its light, a sample of it, and the parts of the picture as they are written.
const PIXEL_BYTES: f64 = 100.0;
/// Shadow rays of a frame of which the user is told: those of minutes.
const MANY_RAYS: f64 = 1e9;
/// Phases before the first frame that the summary tells.
const BAKE_PHASES: [&str; 12] = [
    "open",
    "import",
    "density",
    "sample",
    "form_factors",
    "receivers",
    "energy",
    "operator",
    "compress",
    "tables",
    "maps",
    "photons",
];

/// `render` of a scene.
pub fn run(common: &Common, args: &mut Render) -> Result<(), Error> {
    let progress = begin(common, args)?;
    let mut loaded = output::import_within(&args.scene, args.operators.memory_limit, &progress)?;
    loaded.scene = args.display.with_normals(loaded.scene, args.reference.is_some());
    if !args.is_method_given && loaded.scene.has_medium() {
        args.method = Method::Firstshot;
    }
    let seed = common.seed;
    let method = method_settings(args, loaded.exposure_stops, seed);
    render(common, args, &Subject { loaded, bake: None, method, seed }, &progress)
}

/// `render` of a bake.
pub fn run_bake(common: &Common, args: &mut Render) -> Result<(), Error> {
    let progress = begin(common, args)?;
    let path = Path::new(&args.scene);
    let opened = Opened::read(path, &progress)?;
    if !args.is_method_given {
        args.method = best_method(&opened.bake);
    }
    let seed = if args.method == Method::Path { common.seed } else { opened.bake.settings().seed };
    let asked = method_settings(args, opened.loaded.exposure_stops, seed);
    if args.method != Method::Path {
        asked.check_medium(opened.bake.scene())?;
    }
    let method = opened.method(path, args.method, asked, &args.operators)?;
    let Opened { mut loaded, bake, .. } = opened;
    let scene = args.display.with_normals(bake.scene().clone(), args.reference.is_some());
    loaded.scene = scene.clone();
    let bake = bake.with_scene(scene);
    render(common, args, &Subject { loaded, bake: Some(Arc::new(bake)), method, seed }, &progress)
}

/// Refuses what can be refused before anything is read.
fn begin(common: &Common, args: &Render) -> Result<Progress, Error> {
    if args.method == Method::Path {
        common.native_only("render --method path")?;
    }
    output::check_out(&common.out)?;
    Ok(Progress::new(common.quiet))
}

/// Subject and settings of a rendering.
struct Subject {
    loaded: LoadedScene,
    /// The bake, where there is one already.
    bake: Option<Arc<Bake>>,
    method: MethodSettings,
    /// Seed of all random numbers.
    seed: u32,
}

fn render(common: &Common, args: &Render, subject: &Subject, progress: &Progress) -> Result<(), Error> {
    let loaded = &subject.loaded;
    args.graph.as_deref().map(output::check_file).transpose()?;
    let data = args.reference.as_deref().map(ReferenceData::load).transpose()?;
    let size = args.size.or(data.as_ref().map(|d| (d.full.width, d.full.height))).unwrap_or((960, 540));
    let pixels = f64::from(size.0) * f64::from(size.1);
    let picture = format!("a picture of {} x {} pixels", size.0, size.1);
    check_free(picture, PIXEL_BYTES * pixels, args.operators.memory_limit, "choose a smaller size")?;
    if args.frames > 1 && data.is_some() {
        progress.warn("the reference is for lights at rest; no errors are computed for moving ones");
    }
    let data = data.filter(|_| args.frames == 1);
    let is_named = args.operators.codec.is_some() || subject.bake.is_some();
    let codec = match subject.method {
        MethodSettings::Multibounce(codec) if is_named && args.method == Method::Multibounce => Some(codec.name()),
        _ => None,
    };
    let name: Vec<&str> = [loaded.name.as_str(), args.method.name()].into_iter().chain(codec).collect();
    let out = output::folder_or(&common.out, &name.join("-"));
    output::make_folder(&out)?;

    let mut summary = Summary {
        scene: loaded.name.clone(),
        method: args.method.name().into(),
        codec: codec.map(str::to_owned),
        frames: args.frames,
        seed: subject.seed,
        ..Summary::default()
    };
    let shown = args.display.shown(loaded);
    if shown.materials == Materials::Gltf && loaded.scene.geometry.finishes.is_empty() {
        progress.warn(
            "no material of the scene has a normal map or a roughness: --materials gltf shows the same as diffuse",
        );
    }
    let job = Job { common, args, subject, loaded, size, out: &out, data: data.as_ref(), shown, progress };
    let done = match args.method {
        Method::Path => job.path_frames(&mut summary)?,
        _ => job.radiosity_frames(&mut summary)?,
    };
    job.write_pictures(&done, &mut summary)?;
    summary.peak_memory_bytes = peak_memory_bytes();
    let text = output::json(&summary);
    output::write_text(&out.join("summary.json"), &text)?;
    if common.json {
        say!("{text}");
    } else {
        print(&summary);
        progress.note(&format!("written to {}", out.display()));
    }
    Ok(())
}

/// Subject of a rendering.
struct Job<'a> {
    common: &'a Common,
    args: &'a Render,
    subject: &'a Subject,
    loaded: &'a LoadedScene,
    /// Size of pictures, pixels.
    size: (u32, u32),
    /// Folder of the results.
    out: &'a Path,
    /// Pictures to compare with.
    data: Option<&'a ReferenceData>,
    /// Way of pictures to PNG files.
    shown: DisplaySettings,
    progress: &'a Progress,
}

/// The last frame.
struct Rendered {
    pictures: Pictures,
    /// Indirect irradiance at the points of the reference, W/m².
    points: Option<Vec<Vec3>>,
}

impl Job<'_> {
    fn path_frames(&self, summary: &mut Summary) -> Result<Rendered, Error> {
        let Self { args, loaded, out, progress, .. } = *self;
        summary.device = format!("CPU, {} threads", rayon::current_num_threads());
        let bounces = match args.bake.bounces {
            Bounces::All => u32::MAX,
            Bounces::Count(k) => k,
        };
        let materials = self.shown.materials;
        let settings = PathSettings { seed: self.subject.seed, bounces, materials, ..PathSettings::default() };
        let saved = (args.frames == 1).then(|| out.join("accumulation.bin"));
        let mut scene = loaded.scene.clone();
        if scene.specular_material().is_some()
            && scene.lighting.lights.iter().any(|light| light.kind != scene::gpu::LIGHT_RECT)
        {
            progress.warn(
                "what points, spots, luminaires and suns send by way of mirrors or through glass is not found by \
                 paths; give these lights a surface (emission, rect) to see it",
            );
        }
        let movement = self.movement();
        let mut last = None;
        let mut shown = None;
        for frame in 0..args.frames {
            let (lights, view) = movement.at(frame);
            if !loaded.moving.is_empty() {
                scene = loaded.scene_at(movement.time(frame))?;
            }
            scene.set_lights(&lights);
            let camera = view.camera(self.size.0, self.size.1);
            let spp = args.spp.unwrap_or(64);
            let traced = path::render(&scene, &camera, settings, spp, saved.as_deref(), args.resume, progress)?;
            let transform = shown.get_or_insert_with(|| self.shown.transform(&traced.pictures.full));
            self.write_frame(frame, &traced.pictures, transform)?;
            print_noise(progress, "full", traced.full_errors);
            print_noise(progress, "indirect", traced.indirect_errors);
            last = Some(traced.pictures);
        }
        let times = PassTimes::of(&phase_ms(progress, "path tracing"));
        summary.passes.extend(times.map(|t| ("method".to_owned(), t)));
        let points = self.data.filter(|d| !d.points.is_empty()).map(|d| {
            let points = d.surface_points(loaded.metres_per_unit);
            let tracer = PathTracer::new(&scene);
            let found = progress.phase("points", |_| tracer.irradiance(&points, POINT_PATHS, &settings));
            found.iter().map(|p| p.indirect).collect()
        });
        summary.bake.insert("import".into(), progress.seconds("import"));
        last.map(|pictures| Rendered { pictures, points }).ok_or(Error::Cancelled)
    }

    fn radiosity_frames(&self, summary: &mut Summary) -> Result<Rendered, Error> {
        let Self { args, loaded, progress, .. } = *self;
        let mut executor = open_device(self.common, progress)?;
        summary.device = executor.device().name.clone();
        let decode = self.decode();
        // Before minutes of baking.
        decode.check(executor.device())?;
        let light = self.light_settings(decode);
        let shown = self.picture_settings();
        self.warn_of_many_lights(shown.sub_frames);
        let bake = self.bake(executor.as_mut(), &light)?;
        let exact = match args.errors {
            true => {
                let light = light.clone().with_method(MethodSettings::Classic);
                let executor = open(&DeviceChoice::parse(&self.common.device))?.0;
                Some(interruptible(|| PictureRenderer::of_bake(Arc::clone(&bake), executor, &light, &shown, progress))?)
            }
            false => None,
        };
        let mut renderer = interruptible(|| PictureRenderer::of_bake(bake, executor, &light, &shown, progress))?;
        self.describe(&renderer, summary);
        let pictures = self.frames(&mut renderer, exact, summary)?;
        renderer.light_mut().counted_report()?;
        if let Some(photons) = renderer.light().method().as_any().downcast_ref::<FirstShotMethod>() {
            summary.photons = Some(PhotonCounts::of(&photons.shot().round()));
            if args.frames == 1 {
                photons::write_files(
                    photons.shot(),
                    renderer.light().bake().scene(),
                    renderer.light().bake().mesh(),
                    self.out,
                )?;
            }
        }
        let points = match self.data.filter(|d| !d.points.is_empty()) {
            None => None,
            Some(data) => {
                let points = data.surface_points(loaded.metres_per_unit);
                Some(progress.phase("points", |_| renderer.light_mut().irradiance_at(&points))?)
            }
        };
        Ok(Rendered { pictures, points })
    }

    /// The bake that there is, or a new one.
    fn bake(&self, device: &mut (dyn Executor + 'static), settings: &LightSettings) -> Result<Arc<Bake>, Error> {
        let Self { args, subject, loaded, progress, .. } = *self;
        let of_scene = |error: patchlight::Error| Error::of_scene(error, &args.scene);
        settings.method.check_medium(&loaded.scene).map_err(of_scene)?;
        let check =
            |patches, bounces| settings.method.check_memory(patches, bounces, &settings.build).map_err(of_scene);
        if let Some(bake) = &subject.bake {
            // Operators are there.
            if OperatorKey::of(&settings.method, bake.settings()).is_none() {
                check(bake.mesh().patches.len(), bake.settings().bounces)?;
            }
            return Ok(Arc::clone(bake));
        }
        let own = &loaded.animation;
        let animation = args.path.map_or_else(|| own.clone(), |path| path.animation(loaded));
        let baked = args.bake.settings(loaded, &animation, args.operators.memory_limit, subject.seed);
        if args.bake.patches.voxel_size.is_none() {
            check(baked.patch_count, baked.bounces)?;
        }
        let built = build(device, args.build_on.place(), &loaded.scene, &baked, progress);
        Ok(Arc::new(built.map_err(of_scene)?))
    }

    /// Light of each is traced from all samples of patches and from all pixels.
    fn warn_of_many_lights(&self, sub_frames: u32) {
        let lights = self.loaded.scene.lighting.lights.len();
        let (width, height) = self.size;
        let pixels = f64::from(width) * f64::from(height) * f64::from(sub_frames);
        let samples = match &self.subject.bake {
            Some(bake) => bake.mesh().points.len() as f64,
            None => self.args.bake.patches.count() as f64 * f64::from(BakeSettings::default().samples),
        };
        let rays = lights as f64 * (pixels + samples);
        if rays > MANY_RAYS {
            self.progress.warn(&format!(
                "{lights} lights take {:.0} million shadow rays a frame; fewer lights, or a smaller --size, --spp or \
                 --patch-count take less",
                rays * 1e-6
            ));
        }
    }

    fn movement(&self) -> Movement {
        let args = self.args;
        Movement::new(self.loaded, (args.animate, args.path), args.frames, self.progress)
    }

    /// Decoder of texture blocks, where there are any.
    fn decode(&self) -> Decode {
        match self.subject.method {
            MethodSettings::Multibounce(Codec::Blocks(_)) => self.args.decode.decode(),
            _ => Decode::Auto,
        }
    }

    fn light_settings(&self, decode: Decode) -> LightSettings {
        let build = Build {
            on: self.args.build_on.place(),
            memory_limit: self.args.operators.memory_limit,
            folder: self.out.to_path_buf(),
        };
        let light = LightSettings::default().with_method(self.subject.method).with_decode(decode).with_build(build);
        light.with_eye(self.loaded.view.eye)
    }

    fn picture_settings(&self) -> PictureSettings {
        let sub_frames = self.args.spp.unwrap_or(16);
        // To see what is in view takes time in every sub-frame; many of them see all that a picture needs many times.
        let receivers = match self.args.frames > 1 && sub_frames <= MAX_SUB_FRAMES_IN_VIEW {
            true => ReceiverUpdate::InView,
            false => ReceiverUpdate::All,
        };
        let direct = match self.args.direct {
            DirectLight::Smooth => PixelLight::Smooth,
            DirectLight::Sampled => PixelLight::Sampled,
        };
        let pictures = PictureSettings::default().with_size(self.size).with_sub_frames(sub_frames);
        pictures.with_receivers(receivers).with_direct(direct).with_materials(self.shown.materials)
    }

    /// Takes over what is known before the first frame.
    fn describe(&self, renderer: &PictureRenderer, summary: &mut Summary) {
        let progress = self.progress;
        let bake = renderer.light().bake();
        summary.patches = Some(bake.mesh().patches.len());
        summary.receivers = Some(bake.receivers().points.len());
        summary.energy = bake.energy();
        summary.bytes = renderer.light().bytes();
        let multibounce = renderer.light().method().as_any().downcast_ref::<Multibounce>();
        if let Some(decoder) = multibounce.and_then(Multibounce::decoder) {
            summary.decode = Some(decoder_name(decoder));
            progress.note(match decoder {
                Decoder::Texture { .. } => "texture blocks are decoded by the texture unit",
                Decoder::Kernel => "texture blocks are decoded in the kernel",
            });
        }
        let phases = progress.phases();
        for phase in BAKE_PHASES.into_iter().filter(|phase| phases.iter().any(|(name, _)| name == phase)) {
            summary.bake.insert(phase.into(), progress.seconds(phase));
        }
    }

    /// Renders the frames and what each measured; the pictures of the last.
    fn frames(
        &self,
        renderer: &mut PictureRenderer,
        mut exact: Option<PictureRenderer>,
        summary: &mut Summary,
    ) -> Result<Pictures, Error> {
        let Self { args, loaded, out, progress, .. } = *self;
        let movement = self.movement();
        let moving = Moving::add(renderer.light_mut(), &loaded.moving)?;
        let exact_moving = exact.as_mut().map(|exact| Moving::add(exact.light_mut(), &loaded.moving)).transpose()?;
        let mut sequence = Sequence::new(loaded.exposure_stops);
        let mut times: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        let mut updates = Vec::new();
        let mut last = None;
        let mut begun = None;
        // All frames have the exposure of the first: it would flicker.
        let mut shown = None;
        for number in 0..args.frames {
            let (lighting, camera) = self.shot(&movement, number);
            let done = progress.timed("frame", || {
                let pending = begun.take().map_or_else(|| renderer.begin_picture(&lighting, &camera, number), Ok);
                renderer.end_picture(pending?)
            })?;
            if is_cancelled() {
                return Err(Error::Cancelled);
            }
            if args.frames > 1 || args.errors {
                let shot = Shot { lighting: &lighting, camera: &camera, number };
                if let (Some(exact), Some(moving)) = (&mut exact, &exact_moving) {
                    moving.place(exact.light_mut(), &movement.objects_at(number))?;
                }
                sequence.add(renderer, exact.as_mut(), &shot, &done)?;
            }
            if number + 1 < args.frames {
                // The device is at work on the next picture while this one is written.
                let (lighting, camera) = self.shot(&movement, number + 1);
                moving.place(renderer.light_mut(), &movement.objects_at(number + 1))?;
                let next = progress.timed("frame", || renderer.begin_picture(&lighting, &camera, number + 1))?;
                begun = Some(next);
            }
            let transform = shown.get_or_insert_with(|| self.shown.transform(&done.pictures.full));
            self.write_frame(number, &done.pictures, transform)?;
            if args.debug && number + 1 == args.frames {
                let pictures = renderer.light_mut().debug_pictures(&camera, loaded.exposure_stops)?;
                output::write_debug(&out.join("debug"), &pictures)?;
            }
            let FrameResult { pictures, times: passes } = done;
            updates.push(light_update_ms(&passes));
            for (name, ms) in passes {
                times.entry(name).or_default().push(ms);
            }
            last = Some(pictures);
        }
        self.write_sequence(&sequence)?;
        summary.passes = times.iter().filter_map(|(name, t)| Some((name.clone(), PassTimes::of(t)?))).collect();
        if let Some(path) = &args.graph {
            let graph = Graph::new(renderer.light_mut().executor_mut().plan().clone())
                .graphviz(|name| summary.passes.get(name).map(|times| times.median_ms));
            output::write_text(path, &graph)?;
        }
        summary.light_update = light_update(renderer, updates)?;
        last.ok_or(Error::Cancelled)
    }

    /// Writes what the frames measured.
    fn write_sequence(&self, sequence: &Sequence) -> Result<(), Error> {
        let Self { args, loaded, out, progress, .. } = *self;
        if args.frames > 1 || args.errors {
            sequence.write(out, &format!("Patchlight: {}, {}", loaded.name, args.method.name()))?;
        }
        sequence.work().into_iter().for_each(|line| progress.note(&line));
        Ok(())
    }

    /// Lighting and camera of a frame.
    fn shot(&self, movement: &Movement, number: u32) -> (Lighting, Camera) {
        let (lights, view) = movement.at(number);
        (with_lights(&self.loaded.scene, &lights), view.camera(self.size.0, self.size.1))
    }

    /// Checks a frame, and writes one of several as a picture.
    fn write_frame(&self, number: u32, pictures: &Pictures, transform: &DisplayTransform) -> Result<(), Error> {
        output::check_finite(number, &pictures.full)?;
        if self.args.frames > 1 {
            let path = self.out.join(format!("frame-{number:04}.png"));
            pictures.full.write_shown(&path, transform)?;
        }
        Ok(())
    }

    /// Writes the pictures of a single frame, and compares them with the reference.
    fn write_pictures(&self, done: &Rendered, summary: &mut Summary) -> Result<(), Error> {
        let stops = self.loaded.exposure_stops;
        if self.args.frames == 1 {
            output::write_pictures(self.out, &done.pictures, &self.shown.transform(&done.pictures.full))?;
        }
        let Some(data) = self.data else { return Ok(()) };
        if let (true, Some(indirect)) = (self.args.debug, &data.indirect) {
            let picture = worst_blocks(&done.pictures.indirect, indirect, indirect_scale(indirect))?;
            let worst = DebugPicture { name: "worst", picture, stops: 0.0 };
            output::write_debug(&self.out.join("debug"), &[worst])?;
        }
        compare_with(data, &done.pictures, done.points.as_deref(), stops, self.out, summary)
    }
}

/// The method that the options ask for, for pictures that are exposed so.
fn method_settings(args: &Render, exposure_stops: f32, seed: u32) -> MethodSettings {
    match args.method {
        Method::Multibounce => MethodSettings::Multibounce(args.operators.storage()),
        Method::LowRank => MethodSettings::Multibounce(args.operators.low_rank()),
        Method::Feedback => MethodSettings::Feedback(args.methods.feedback(&args.operators)),
        Method::Temporal => MethodSettings::Temporal(args.temporal.settings(seed)),
        Method::Local => MethodSettings::Local(args.local.options(exposure_stops)),
        Method::Firstshot => MethodSettings::FirstShot(args.methods.first_shot()),
        Method::Classic | Method::Path => MethodSettings::Classic,
    }
}

/// Times of a phase, one a frame, ms.
fn phase_ms(progress: &Progress, name: &str) -> Vec<f64> {
    progress.phases().iter().filter(|(n, _)| n == name).map(|(_, s)| s * 1e3).collect()
}

fn print_noise(progress: &Progress, name: &str, errors: Option<BlockErrors>) {
    if let Some(e) = errors {
        progress.note(&format!(
            "standard error of {name} block means: median {:.2} %, 90th percentile {:.2} %",
            100.0 * e.median,
            100.0 * e.p90
        ));
    }
}

fn compare_with(
    data: &ReferenceData,
    pictures: &Pictures,
    points: Option<&[Vec3]>,
    stops: f32,
    out: &Path,
    summary: &mut Summary,
) -> Result<(), Error> {
    summary.full = Some(compare_pictures(&pictures.full, &data.full, stops_to_scale(stops), None)?);
    if let Some(expected) = &data.indirect {
        summary.indirect = Some(compare_pictures(&pictures.indirect, expected, indirect_scale(expected), None)?);
        let blocks = (pictures.indirect.block_means(8), expected.block_means(8));
        difference_picture(&blocks.0, &blocks.1, 0.5)?.write_png(&out.join("difference-indirect.png"), 0.0)?;
    }
    difference_picture(&pictures.full, &data.full, 0.5)?.write_png(&out.join("difference-full.png"), 0.0)?;
    if let Some(points) = points {
        let expected = data.point_indirect();
        summary.points = Some(compare_points(points, &expected)?);
        output::write_text(&out.join("points.csv"), &points_csv(data, points, &point_errors(points, &expected)?))?;
    }
    Ok(())
}

/// A line for each point of the reference, worst first: where it is (scene units), indirect irradiance by us and by the
/// reference with its standard error (W/m²), and the relative error of the luminance.
fn points_csv(data: &ReferenceData, points: &[Vec3], errors: &[f64]) -> String {
    let mut order: Vec<usize> = (0..errors.len()).collect();
    order.sort_by(|&a, &b| errors[b].total_cmp(&errors[a]));
    let mut text = String::from(
        "px,py,pz,nx,ny,nz,indirect_r,indirect_g,indirect_b,reference_r,reference_g,reference_b,\
         se_reference_r,se_reference_g,se_reference_b,relative_error\n",
    );
    for k in order {
        let p = &data.points[k];
        for vector in [p.position, p.normal, points[k], p.indirect, p.indirect_error] {
            text += &format!("{},{},{},", vector.x, vector.y, vector.z);
        }
        text += &format!("{:.5}\n", errors[k]);
    }
    text
}

fn print(s: &Summary) {
    say!("{:14} {} by {} on {}", "scene", s.scene, s.method, s.device);
    if let Some(n) = s.patches {
        say!("{:14} {n}, receivers {}", "patches", s.receivers.unwrap_or(0));
    }
    if let Some(p) = &s.photons {
        say!(
            "{:14} {}, {} registered, relative error {:.2} %",
            "photons",
            p.photons,
            p.registered,
            100.0 * p.relative_error
        );
    }
    if let Some(decode) = s.decode {
        say!("{:14} {decode}", "decode");
    }
    for (name, seconds) in &s.bake {
        say!("{:14} {seconds:.2} s", format!("bake {name}"));
    }
    for (name, t) in &s.passes {
        say!("{:14} median {:.2} ms, max {:.2} ms", format!("pass {name}"), t.median_ms, t.max_ms);
    }
    if let Some(update) = &s.light_update {
        say!("{:14} median {:.2} ms, max {:.2} ms", "light update", update.median_ms, update.max_ms);
    }
    for (name, count) in &s.bytes {
        say!("{:14} {}", format!("bytes {name}"), output::bytes(*count));
    }
    for (name, errors) in [("full", &s.full), ("indirect", &s.indirect)] {
        if let Some(e) = errors {
            say!(
                "{name:14} block median {:.2} %, block PSNR {:.1} dB, mean ratio {:.4}, MSE {}, PSNR {:.2} dB, SSIM \
                 {:.4}, FLIP {}",
                100.0 * e.block_median_relative_error,
                e.block_psnr_db,
                e.mean_ratio,
                significant(e.mse),
                e.psnr_db,
                e.ssim,
                significant(e.flip)
            );
        }
    }
    if let Some(p) = &s.points {
        say!(
            "{:14} median {:.2} %, 95th percentile {:.2} %, mean ratio {:.4}",
            "points",
            100.0 * p.median_relative_error,
            100.0 * p.p95_relative_error,
            p.mean_ratio
        );
    }
}

/// Times of the light updates of all frames, with what the last one was for.
fn light_update(renderer: &mut PictureRenderer, frames_ms: Vec<f64>) -> Result<Option<LightUpdate>, Error> {
    let (visible_receivers, visible_points) = renderer.count_updated()?;
    let bytes = renderer.light().bytes().values().sum();
    let Some(PassTimes { median_ms, max_ms }) = PassTimes::of(&frames_ms) else { return Ok(None) };
    Ok(Some(LightUpdate { median_ms, max_ms, frames_ms, visible_receivers, visible_points, bytes }))
}
