//! `patchlight render`.

use reference::PictureFile as _;
use std::collections::BTreeMap;
use std::path::Path;

use glam::Vec3;
use reference::metrics::{compare_pictures, compare_points, difference_picture, indirect_scale, point_errors};
use reference::path::{PathSettings, PathTracer};
use reference::{BlockErrors, ReferenceData, stops_to_scale};

use super::args::{Bounces, BuildPlace, Decoding, FormFactors, Method, ReceiverPlaces, Render};
use assets::import::LoadedScene;
use experiments::Error;
use experiments::args::Common;
use experiments::output;
use experiments::path;
use experiments::progress::Progress;
use experiments::report::significant;
use experiments::sequence::{Movement, Sequence};
use experiments::summary::{PassTimes, PhotonCounts, Summary};
use patchlight::memory::peak_memory_bytes;
use patchlight::render::Pictures;
use patchlight::render::classic::{Bake, ClassicSettings, Estimator, ReceiverKind};
use patchlight::render::debug::{DebugPicture, worst_blocks};
use patchlight::render::decode::{Decode, Decoder};
use patchlight::render::firstshot::FirstShotSettings;
use patchlight::render::operator::{Build, Codec, Feedback, Transport};
use runtime::executor::{DeviceChoice, open};

/// Paths a point when a reference asks for irradiance at points.
const POINT_PATHS: u32 = 4096;

pub fn run(common: &Common, args: &Render) -> Result<(), Error> {
    let progress = Progress::new(common.quiet);
    let loaded = output::import(&args.scene, &progress)?;
    let data = args.reference.as_deref().map(ReferenceData::load).transpose()?;
    let size = args.size.or(data.as_ref().map(|d| (d.full.width, d.full.height))).unwrap_or((960, 540));
    if args.frames > 1 && data.is_some() {
        progress.warn("the reference is for lights at rest; no errors are computed for moving ones");
    }
    let data = data.filter(|_| args.frames == 1);
    let codec = args.codec.map(|codec| codec.codec(args.epsilon).name());
    if codec.is_some() && args.method != Method::Multibounce {
        progress.warn(&format!("--codec is for --method multibounce; --method {} ignores it", args.method.name()));
    }
    if matches!(args.method, Method::Firstshot | Method::Local) && args.bounces != Bounces::All {
        progress.warn(&format!("--method {} takes all bounces and ignores --bounces", args.method.name()));
    }
    let is_built = matches!(args.method, Method::Multibounce | Method::Tiles);
    if args.memory_limit.is_some() && !is_built {
        progress.warn(&format!("--memory-limit is for operators; --method {} ignores it", args.method.name()));
    }
    if args.build_on == BuildPlace::Device && !(is_built && args.bounces != Bounces::All) {
        progress.warn("--build-on device is for operators of --bounces K; others are built on the host");
    }
    let codec = codec.filter(|_| args.method == Method::Multibounce);
    let name: Vec<&str> = [loaded.name.as_str(), args.method.name()].into_iter().chain(codec).collect();
    let out = output::folder_or(&common.out, &name.join("-"));
    output::make_folder(&out)?;

    let mut summary = Summary {
        scene: loaded.name.clone(),
        method: args.method.name().into(),
        codec: codec.map(str::to_owned),
        frames: args.frames,
        seed: common.seed,
        ..Summary::default()
    };
    let (pictures, points) = match args.method {
        Method::Path => path_frames(common, args, &loaded, size, &out, data.as_ref(), &mut summary, &progress)?,
        Method::Classic
        | Method::Multibounce
        | Method::Tiles
        | Method::Feedback
        | Method::Temporal
        | Method::Local
        | Method::Firstshot => {
            classic_frames(common, args, &loaded, size, &out, data.as_ref(), &mut summary, &progress)?
        }
    };
    if args.frames == 1 {
        output::write_pictures(&out, &pictures, loaded.exposure_stops)?;
    }
    if let (true, Some(indirect)) = (args.debug, data.as_ref().and_then(|data| data.indirect.as_ref())) {
        let worst = worst_blocks(&pictures.indirect, indirect, indirect_scale(indirect))?;
        output::write_debug(&out.join("debug"), &[DebugPicture { name: "worst", picture: worst, stops: 0.0 }])?;
    }
    if let Some(data) = &data {
        compare_with(data, &pictures, points.as_deref(), loaded.exposure_stops, &out, &mut summary)?;
    }
    summary.peak_memory_bytes = peak_memory_bytes();
    let text = output::json(&summary);
    output::write_text(&out.join("summary.json"), &text)?;
    if common.json {
        println!("{text}");
    } else {
        print(&summary);
        progress.note(&format!("written to {}", out.display()));
    }
    Ok(())
}

type Frames = (Pictures, Option<Vec<Vec3>>);

#[allow(clippy::too_many_arguments)]
fn path_frames(
    common: &Common,
    args: &Render,
    loaded: &LoadedScene,
    size: (u32, u32),
    out: &Path,
    data: Option<&ReferenceData>,
    summary: &mut Summary,
    progress: &Progress,
) -> Result<Frames, Error> {
    summary.device = format!("CPU, {} threads", rayon::current_num_threads());
    let bounces = match args.bounces {
        Bounces::All => u32::MAX,
        Bounces::Count(k) => k,
    };
    let settings = PathSettings { seed: common.seed, bounces, ..PathSettings::default() };
    let saved = (args.frames == 1).then(|| out.join("accumulation.bin"));
    let mut scene = loaded.scene.clone();
    let movement = Movement::new(loaded, (args.animate, args.path), args.frames, progress);
    let mut last = None;
    for frame in 0..args.frames {
        let view;
        (scene.lighting.lights, view) = movement.at(frame);
        let camera = view.camera(size.0, size.1);
        let spp = args.spp.unwrap_or(64);
        let traced = path::render(&scene, &camera, settings, spp, saved.as_deref(), args.resume, progress)?;
        if args.frames > 1 {
            traced.pictures.full.write_png(&out.join(format!("frame-{frame:04}.png")), loaded.exposure_stops)?;
        }
        print_noise(progress, "full", traced.full_errors);
        print_noise(progress, "indirect", traced.indirect_errors);
        last = Some(traced.pictures);
    }
    summary.passes.extend(PassTimes::of(&phase_ms(progress, "path tracing")).map(|t| ("method".to_owned(), t)));
    let points = data.filter(|d| !d.points.is_empty()).map(|d| {
        let points = d.surface_points(loaded.metres_per_unit);
        let found = progress.phase("points", |_| PathTracer::new(&scene).irradiance(&points, POINT_PATHS, &settings));
        found.iter().map(|p| p.indirect).collect()
    });
    summary.bake.insert("import".into(), progress.seconds("import"));
    last.map(|pictures| (pictures, points)).ok_or(Error::Cancelled)
}

#[allow(clippy::too_many_arguments)]
fn classic_frames(
    common: &Common,
    args: &Render,
    loaded: &LoadedScene,
    size: (u32, u32),
    out: &Path,
    data: Option<&ReferenceData>,
    summary: &mut Summary,
    progress: &Progress,
) -> Result<Frames, Error> {
    let (executor, note) = open(&DeviceChoice::parse(&common.device))?;
    if let Some(note) = note {
        progress.note(&note);
    }
    summary.device = executor.device().name.clone();
    let has_blocks = args.codec.is_some_and(|codec| matches!(codec.codec(args.epsilon), Codec::Blocks(_)));
    let decode = if has_blocks && args.method == Method::Multibounce {
        args.decode.decode()
    } else {
        if args.decode != Decoding::Auto {
            progress.warn("--decode is for --method multibounce with --codec bc1, bc3, bc6h or bc7, and is ignored");
        }
        Decode::Auto
    };
    // Before minutes of baking.
    decode.check(executor.device())?;
    let settings = ClassicSettings {
        decode,
        patches: args.patches.kind(loaded.scene.geometry.triangles.len()),
        patch_count: args.patches.count(),
        voxel_size: args.patches.voxel_size,
        estimator: match args.form_factors {
            FormFactors::Hemisphere => Estimator::Hemisphere { rays: args.rays },
            FormFactors::Contour => Estimator::Contour,
            FormFactors::Area => Estimator::Area,
            FormFactors::Point => Estimator::Point,
        },
        transport: match args.method {
            Method::Multibounce => Transport::Operator(args.codec.unwrap_or_default().codec(args.epsilon)),
            Method::Tiles => Transport::Operator(Codec::Tiles { epsilon: args.epsilon }),
            Method::Feedback => Transport::Feedback(Feedback {
                epsilon: args.epsilon,
                products: args.products,
                accelerated: !args.plain,
            }),
            Method::Temporal => Transport::Temporal(args.temporal.settings(common.seed)),
            Method::Local => Transport::Local(args.local.options(loaded.exposure_stops)),
            Method::Firstshot => {
                Transport::FirstShot(FirstShotSettings { error: args.error, most_photons: args.photons })
            }
            Method::Classic | Method::Path => Transport::Classic,
        },
        bounces: match args.bounces {
            Bounces::All => None,
            Bounces::Count(k) => Some(k),
        },
        receivers: match args.receivers {
            ReceiverPlaces::Mesh => ReceiverKind::Mesh,
            ReceiverPlaces::Pixels => ReceiverKind::Pixels,
            ReceiverPlaces::SelfReceivers => ReceiverKind::SelfReceivers,
        },
        receiver_edge: args.receiver_edge,
        most_receivers: args.most_receivers.map(|most| most as usize),
        receiver_rays: args.receiver_rays,
        sub_frames: args.spp.unwrap_or(16),
        seed: common.seed,
        size,
        ..ClassicSettings::default()
    };
    let build = Build { on: args.build_on.place(), memory_limit: args.memory_limit, folder: out.to_path_buf() };
    let bake = Bake::new(&loaded.scene, loaded.view.eye, settings, progress)?.with_build(build);
    let mut exact = match args.errors {
        true => Some(bake.clone().load(Transport::Classic, open(&DeviceChoice::parse(&common.device))?.0, progress)?),
        false => None,
    };
    let mut classic = bake.load(settings.transport, executor, progress)?;
    summary.patches = Some(classic.patch_count());
    summary.receivers = Some(classic.receiver_count());
    summary.bytes = classic.bytes();
    summary.decode = classic.decoder().map(Decoder::name);
    if let Some(decoder) = classic.decoder() {
        progress.note(&format!("texture blocks are decoded {decoder}"));
    }
    let phases = ["import", "sample", "form_factors", "receivers", "operator", "compress", "tables", "maps", "photons"];
    for phase in phases {
        if !progress.phases.iter().any(|(name, _)| name == phase) {
            continue;
        }
        summary.bake.insert(phase.into(), progress.seconds(phase));
    }
    let movement = Movement::new(loaded, (args.animate, args.path), args.frames, progress);
    let mut sequence = Sequence::new(loaded.exposure_stops);
    let mut times: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let mut last = None;
    for frame in 0..args.frames {
        let (lights, view) = movement.at(frame);
        let camera = view.camera(size.0, size.1);
        let done = progress.timed("frame", || classic.frame(&lights, &camera, frame))?;
        if experiments::progress::is_cancelled() {
            return Err(Error::Cancelled);
        }
        if args.frames > 1 || args.errors {
            sequence.add(&mut classic, exact.as_mut(), (&lights, &camera, frame), &done)?;
        }
        for (name, ms) in done.times {
            times.entry(name).or_default().push(ms);
        }
        if args.frames > 1 {
            done.pictures.full.write_png(&out.join(format!("frame-{frame:04}.png")), loaded.exposure_stops)?;
        }
        if args.debug && frame + 1 == args.frames {
            output::write_debug(&out.join("debug"), &classic.debug_pictures(&camera, loaded.exposure_stops)?)?;
        }
        last = Some(done.pictures);
    }
    if args.frames > 1 || args.errors {
        sequence.write(out, &format!("Patchlight: {}, {}", loaded.name, args.method.name()))?;
    }
    if let Some(line) = sequence.work() {
        progress.note(&line);
    }
    if let Some(shot) = classic.first_shot() {
        summary.photons = Some(PhotonCounts::of(&shot.round()));
        if args.frames == 1 {
            classic.write_photons(out)?;
        }
    }
    summary.passes = times.iter().filter_map(|(name, t)| Some((name.clone(), PassTimes::of(t)?))).collect();
    let points = match data.filter(|d| !d.points.is_empty()) {
        None => None,
        Some(data) => {
            let points = data.surface_points(loaded.metres_per_unit);
            Some(progress.phase("points", |_| classic.irradiance_at(&points))?)
        }
    };
    last.map(|pictures| (pictures, points)).ok_or(Error::Cancelled)
}

/// Times of a phase, one a frame, ms.
fn phase_ms(progress: &Progress, name: &str) -> Vec<f64> {
    progress.phases.iter().filter(|(n, _)| n == name).map(|(_, s)| s * 1e3).collect()
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
    println!("{:14} {} by {} on {}", "scene", s.scene, s.method, s.device);
    if let Some(n) = s.patches {
        println!("{:14} {n}, receivers {}", "patches", s.receivers.unwrap_or(0));
    }
    if let Some(p) = &s.photons {
        println!(
            "{:14} {}, {} registered, relative error {:.2} %",
            "photons",
            p.photons,
            p.registered,
            100.0 * p.relative_error
        );
    }
    if let Some(decode) = s.decode {
        println!("{:14} {decode}", "decode");
    }
    for (name, seconds) in &s.bake {
        println!("{:14} {seconds:.2} s", format!("bake {name}"));
    }
    for (name, t) in &s.passes {
        println!("{:14} median {:.2} ms, max {:.2} ms", format!("pass {name}"), t.median_ms, t.max_ms);
    }
    for (name, count) in &s.bytes {
        println!("{:14} {}", format!("bytes {name}"), output::bytes(*count));
    }
    for (name, errors) in [("full", &s.full), ("indirect", &s.indirect)] {
        if let Some(e) = errors {
            println!(
                "{name:14} block median {:.2} %, block PSNR {:.1} dB, mean ratio {:.4}, MSE {}, PSNR {:.2} dB, SSIM {:.4}, FLIP {}",
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
        println!(
            "{:14} median {:.2} %, 95th percentile {:.2} %, mean ratio {:.4}",
            "points",
            100.0 * p.median_relative_error,
            100.0 * p.p95_relative_error,
            p.mean_ratio
        );
    }
}
