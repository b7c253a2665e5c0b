//! The demo: the built-in Cornell box and atrium, classic radiosity against path tracing, a light that moves.

use std::path::Path;

use reference::PictureErrors;
use reference::metrics::difference_picture;
use reference::path::PathSettings;
use scene::Light;

use super::args::Common;
use super::compare::picture_errors;
use super::output;
use super::render::{frame_time, write_pictures};
use super::report::{Figure, Plot, Section, Series, Table, page, significant};
use crate::error::Error;
use crate::executor::{DeviceChoice, open};
use crate::import::{Animation, LoadedScene, View};
use crate::procedural;
use crate::progress::{Progress, is_cancelled};
use crate::render::classic::{Classic, ClassicSettings, Estimator, PatchKind};
use crate::render::{Pictures, path};
use crate::summary::{PassTimes, Summary, peak_memory_bytes};

/// How much the demo does.
struct Effort {
    size: (u32, u32),
    frames: u32,
    /// Frames that are path traced as well.
    checked: u32,
    paths: u32,
    patches: usize,
    rays: u32,
}

const FULL: Effort = Effort { size: (480, 360), frames: 24, checked: 4, paths: 48, patches: 5000, rays: 1024 };
const FAST: Effort = Effort { size: (160, 120), frames: 3, checked: 1, paths: 8, patches: 400, rays: 256 };

/// What one scene gave.
struct Outcome {
    summary: Summary,
    section: Section,
}

pub fn run(common: &Common, fast: bool) -> Result<(), Error> {
    let effort = if fast { FAST } else { FULL };
    let out = common.out.clone().unwrap_or_else(|| "out".into());
    output::make_folder(&out)?;
    let mut outcomes = Vec::new();
    let mut device = String::new();
    for name in ["cornell", "atrium"] {
        let mut progress = Progress::new(common.quiet);
        progress.note(&format!("{name}:"));
        let loaded = progress.phase("import", |_| procedural::build(name))?;
        let outcome = one_scene(common, &effort, &loaded, &out.join(name), &mut progress)?;
        device.clone_from(&outcome.summary.device);
        outcomes.push(outcome);
    }
    let introduction = [
        format!(
            "Diffuse global illumination by classic radiosity on {device}, beside path tracing of the same frames. \
             Lights move over {} frames; form factors are computed once.",
            effort.frames
        ),
        "Errors are those of 8 × 8 block means of luminance against the path tracer, whose own noise they include; \
         pictures of indirect light are exposed by 0.18 over the log-average of the reference."
            .to_owned(),
    ];
    let summaries: Vec<_> = outcomes.iter().map(|o| o.summary.clone()).collect();
    let sections: Vec<_> = outcomes.into_iter().map(|o| o.section).collect();
    let report = out.join("report.html");
    output::write_text(&report, &page("Patchlight: demo", &introduction, &sections))?;
    let text = output::json(&summaries);
    output::write_text(&out.join("summary.json"), &text)?;
    if common.json {
        println!("{text}");
    } else {
        println!("{} and the pictures beside it show what was rendered on {device}", report.display());
    }
    Ok(())
}

fn one_scene(
    common: &Common,
    effort: &Effort,
    loaded: &LoadedScene,
    out: &Path,
    progress: &mut Progress,
) -> Result<Outcome, Error> {
    output::make_folder(out)?;
    let (executor, note) = open(&DeviceChoice::parse(&common.device))?;
    if let Some(note) = note {
        progress.note(&note);
    }
    let device = executor.device().name.clone();
    let settings = ClassicSettings {
        patches: PatchKind::suited(loaded.scene.triangles.len(), effort.patches),
        patch_count: effort.patches,
        estimator: Estimator::Hemisphere { rays: effort.rays },
        receiver_rays: effort.rays / 2,
        sub_frames: 6,
        seed: common.seed,
        size: effort.size,
        ..ClassicSettings::default()
    };
    let mut classic = Classic::bake(loaded, settings, executor, progress)?;
    let animation = Animation::or_default_path(loaded);
    let mut times: Vec<(String, Vec<f64>)> = Vec::new();
    let mut strip = Vec::new();
    let mut checked = Vec::new();
    let mut best = None;
    for frame in 0..effort.frames {
        let (lights, view) = animation.at(frame_time(&animation, frame, effort.frames));
        let camera = view.camera(effort.size.0, effort.size.1);
        let done = progress.timed("frame", || classic.frame(&lights, &camera, frame))?;
        if is_cancelled() {
            return Err(Error::Cancelled);
        }
        if (frame + 1) % 8 == 0 {
            progress.note(&format!("frame {} of {}", frame + 1, effort.frames));
        }
        for (name, ms) in done.times {
            match times.iter_mut().find(|(n, _)| *n == name) {
                Some((_, list)) => list.push(ms),
                None => times.push((name, vec![ms])),
            }
        }
        let name = format!("frame-{frame:04}.png");
        done.pictures.full.write_png(&out.join(&name), loaded.exposure_stops)?;
        if frame % effort.frames.div_ceil(12) == 0 {
            strip.push(Figure::read(out, &name, format!("frame {frame}"))?);
        }
        // Frames at even distances, the first among them.
        if frame * effort.checked / effort.frames != (frame + 1) * effort.checked / effort.frames {
            let traced = trace(common, effort, loaded, (&lights, &view), progress)?;
            let errors = picture_errors(&done.pictures, &traced, loaded.exposure_stops)?;
            checked.push((frame, errors));
            best = Some((done.pictures, traced));
        }
    }
    let mut section = Section {
        title: format!("{} ({} triangles)", loaded.name, loaded.scene.triangles.len()),
        text: vec![format!(
            "{} patches, {} receivers; picture {} × {}.",
            classic.patch_count(),
            classic.receiver_count(),
            effort.size.0,
            effort.size.1
        )],
        figures: Vec::new(),
        strip,
        tables: Vec::new(),
        plots: Vec::new(),
    };
    if let Some((ours, traced)) = &best {
        section.figures = compared_figures(out, ours, traced, loaded.exposure_stops)?;
    }
    section.tables.push(times_table(&times, &device));
    section.tables.push(bake_table(progress));
    section.tables.push(error_table(&checked));
    let line = |(name, values): &(String, Vec<f64>)| Series {
        name: name.clone(),
        points: values.iter().enumerate().map(|(frame, ms)| (frame as f64, *ms)).collect(),
    };
    section.plots.push(Plot {
        title: "Time of each pass".into(),
        unit: "ms".into(),
        x: "frame".into(),
        logarithmic: false,
        series: times.iter().map(line).collect(),
    });

    let (full, indirect) = checked.last().map(|(_, e)| *e).unzip();
    let summary = Summary {
        scene: loaded.name.clone(),
        method: "classic".into(),
        codec: None,
        device,
        patches: Some(classic.patch_count()),
        receivers: Some(classic.receiver_count()),
        frames: effort.frames,
        seed: common.seed,
        passes: times.iter().filter_map(|(name, t)| Some((name.clone(), PassTimes::of(t)?))).collect(),
        bake: progress.phases.iter().filter(|(n, _)| n != "frame").cloned().collect(),
        peak_memory_bytes: peak_memory_bytes(),
        bytes: classic.bytes(),
        full,
        indirect,
        points: None,
    };
    Ok(Outcome { summary, section })
}

fn trace(
    common: &Common,
    effort: &Effort,
    loaded: &LoadedScene,
    at: (&[Light], &View),
    progress: &mut Progress,
) -> Result<Pictures, Error> {
    let mut scene = loaded.scene.clone();
    scene.lights = at.0.to_vec();
    let camera = at.1.camera(effort.size.0, effort.size.1);
    let settings = PathSettings { seed: common.seed, ..PathSettings::default() };
    Ok(path::render(&scene, &camera, settings, effort.paths, None, false, progress)?.pictures)
}

fn compared_figures(out: &Path, ours: &Pictures, traced: &Pictures, stops: f32) -> Result<Vec<Figure>, Error> {
    write_pictures(&out.join("classic"), ours, stops)?;
    write_pictures(&out.join("path"), traced, stops)?;
    let blocks = (ours.full.block_means(8), traced.full.block_means(8));
    difference_picture(&blocks.0, &blocks.1, 0.25)?.write_png(&out.join("difference.png"), 0.0)?;
    [
        ("classic/full.png", "Classic radiosity, all light"),
        ("path/full.png", "Path traced, all light"),
        ("classic/indirect.png", "Classic radiosity, indirect light"),
        ("path/indirect.png", "Path traced, indirect light"),
        ("difference.png", "Difference of 8 × 8 block means: red brighter, blue darker, full colour at 25 %"),
    ]
    .into_iter()
    .map(|(name, caption)| Figure::read(out, name, caption.to_owned()))
    .collect()
}

fn times_table(times: &[(String, Vec<f64>)], device: &str) -> Table {
    let row = |(name, values): &(String, Vec<f64>)| {
        let t = PassTimes::of(values)?;
        Some(vec![name.clone(), significant(t.median_ms), significant(t.max_ms)])
    };
    Table {
        caption: format!("Time of each pass, {device}"),
        head: ["pass", "median ms", "max ms"].map(String::from).to_vec(),
        rows: times.iter().filter_map(row).collect(),
    }
}

fn bake_table(progress: &Progress) -> Table {
    let phases = progress.phases.iter().filter(|(n, _)| n != "frame" && n != "path tracing");
    Table {
        caption: "Once, before the first frame".into(),
        head: ["phase", "seconds"].map(String::from).to_vec(),
        rows: phases.map(|(name, seconds)| vec![name.clone(), significant(*seconds)]).collect(),
    }
}

fn error_table(checked: &[(u32, (PictureErrors, PictureErrors))]) -> Table {
    let row = |frame: u32, part: &str, e: &PictureErrors| {
        vec![
            format!("{frame}, {part}"),
            format!("{:.2} %", 100.0 * e.block_median_relative_error),
            format!("{:.1} dB", e.block_psnr_db),
            format!("{:.3}", e.mean_ratio),
            format!("{:.4}", e.ssim),
            significant(e.flip),
        ]
    };
    Table {
        caption: "Against the path tracer".into(),
        head: ["frame", "block median", "block PSNR", "mean ratio", "SSIM", "FLIP"].map(String::from).to_vec(),
        rows: checked
            .iter()
            .flat_map(|(frame, (full, indirect))| [row(*frame, "all", full), row(*frame, "indirect", indirect)])
            .collect(),
    }
}
