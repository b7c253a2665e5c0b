//! `bench clean`: what a person sees wrong in pictures, counted in pixels against a converged reference: noise, leaks,
//! stains, blotches, teeth along edges, and patterns of direct light.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use reference::metrics::{Faults, compare_pictures, indirect_scale, noise_picture, noise_share};
use reference::{
    DisplayTransform, Edges, Judge, Picture, PictureErrors, PictureFile as _, scale_to_stops, stops_to_scale,
};
use serde::Serialize;

use super::setup::{Machine, Setup, bake_settings, load};
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, is_cancelled};
use crate::references::{KeptNoise, KeptReference, ReferenceStore};
use crate::report::{Figure, Section, Table, page, significant};
use assets::import::LoadedScene;
use assets::procedural;
use patchlight::light::with_lights;
use patchlight::{
    Bake, EnergyCheck, LightSettings, MeanRatio, MethodSettings, PictureRenderer, PictureSettings, Pictures,
};

/// Patches of a scene, unless it is said: as many as a picture of it has by default.
const COUNT: u32 = 4000;
/// Patch counts of curves.
const CURVE: [u32; 5] = [1000, 2000, 4000, 10_000, 20_000];
/// Errors over patches rise where one exceeds that of fewer patches by more than this share.
const RISE: f64 = 0.05;
/// Paths a pixel of references, unless it is said.
const PATHS: u32 = 2048;
/// Edge of the squares of blotches that are drawn, pixels, and the relative error of full colour.
const BLOTCH_EDGE: u32 = 16;
const BLOTCH_RANGE: f32 = 0.2;

/// Errors of a picture.
#[derive(Clone, Serialize)]
struct Part {
    /// Errors of one picture, as it is by default.
    #[serde(flatten)]
    errors: PictureErrors,
    /// Faults of the mean of many pictures.
    #[serde(flatten)]
    faults: Faults,
}

/// Results of a scene. Leaks, stains, blotches and teeth are those of indirect light, the pattern that of direct light.
#[derive(Clone, Serialize)]
struct Row {
    scene: String,
    noise_share: f64,
    leak_share: f64,
    stain_share: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    blotch_p95: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    blotch16_p95: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    blotch64_p95: Option<f64>,
    teeth_share: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pattern: Option<f64>,
    full: Part,
    indirect: Part,
    #[serde(skip_serializing_if = "Option::is_none")]
    reference_noise: Option<KeptNoise>,
    patches: usize,
    receivers: usize,
    interpolation_points: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    energy: Option<EnergyCheck>,
    bake_s: f64,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    seed: u32,
    size: (u32, u32),
    sub_frames: u32,
    /// Pictures that are averaged before leaks, stains and blotches are counted.
    pictures: u32,
    rows: Vec<&'a Row>,
}

/// A scene with what it should look like.
struct Subject {
    /// As it was asked for.
    spec: String,
    loaded: LoadedScene,
    truth: KeptReference,
}

/// Results of a scene, for the report.
struct Outcome {
    row: Row,
    section: Section,
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let progress = Progress::new(common.quiet);
    let (args, references) = &with_scenes(args);
    let store = ReferenceStore::open(args.cache.as_deref())?;
    if references.only_made {
        return make_references(common, args, &store, &progress);
    }
    let subjects = subjects(args, references, &store, &progress)?;
    let usual: &[u32] = if args.curves { &CURVE } else { &[COUNT] };
    let Setup { out, machine, counts, .. } = Setup::new(common, args, "clean", &procedural::STRESS_SCENES, usual)?;
    let mut outcomes: Vec<Outcome> = Vec::new();
    for subject in &subjects {
        for &count in &counts {
            outcomes.push(Measuring { common, args, subject, progress: &progress }.measure(count as usize, &out)?);
            // What is known is kept when the rest fails or is stopped.
            output::write_text(&out.join("summary.json"), &results(common, args, &machine, &outcomes))?;
            write_report(&machine, args, &outcomes, &out)?;
        }
    }
    if common.json {
        say!("{}", results(common, args, &machine, &outcomes));
    } else {
        tables(&outcomes).iter().for_each(|table| say!("{}", table.markdown()));
        say!("{} shows the same with pictures", out.join("report.html").display());
    }
    Ok(())
}

/// Source of references.
struct References {
    /// They are made, and nothing is measured.
    only_made: bool,
    /// Folder of pictures made by another program.
    folder: Option<PathBuf>,
}

/// The options with all scenes. What follows `--references` is a folder of pictures where it is one, else a scene.
fn with_scenes(args: &Bench) -> (Bench, References) {
    let mut args = args.clone();
    let given = args.references.take();
    let folder = given.clone().flatten().filter(|path| path.is_dir());
    if let Some(Some(scene)) = &given
        && folder.is_none()
    {
        args.scenes.insert(0, scene.to_string_lossy().into_owned());
    }
    if args.scenes.is_empty() {
        args.scenes = procedural::STRESS_SCENES.map(str::to_owned).to_vec();
    }
    (args, References { only_made: given.is_some() && folder.is_none(), folder })
}

fn make_references(common: &Common, args: &Bench, store: &ReferenceStore, progress: &Progress) -> Result<(), Error> {
    common.native_only("patchlight-bench clean --references")?;
    let paths = args.paths.unwrap_or(PATHS);
    for spec in &args.scenes {
        let loaded = output::import_flat(spec, progress)?;
        let kept = store.make(&loaded, args.size(), paths, progress)?;
        say!("{spec}: {}{}", kept.source, noise_text(kept.noise().as_ref()));
    }
    say!("kept in {}", store.folder().display());
    Ok(())
}

/// All scenes with their references, before anything takes long.
fn subjects(
    args: &Bench,
    references: &References,
    store: &ReferenceStore,
    progress: &Progress,
) -> Result<Vec<Subject>, Error> {
    let mut subjects = Vec::new();
    let mut missing = Vec::new();
    for spec in &args.scenes {
        let loaded = output::import_flat(spec, progress)?;
        let truth = match (&references.folder, args.paths) {
            (Some(folder), _) => KeptReference::of_folder(folder, &loaded.name)?,
            (None, Some(paths)) => Some(store.make(&loaded, args.size(), paths, progress)?),
            (None, None) => store.find(&loaded, args.size())?,
        };
        match truth {
            Some(truth) => subjects.push(Subject { spec: spec.clone(), loaded, truth }),
            None => missing.push(spec.clone()),
        }
    }
    if missing.is_empty() {
        return Ok(subjects);
    }
    let folder = references.folder.as_deref().unwrap_or(store.folder()).to_path_buf();
    Err(Error::NoReferences { scenes: missing, folder })
}

struct Measuring<'a> {
    common: &'a Common,
    args: &'a Bench,
    subject: &'a Subject,
    progress: &'a Progress,
}

impl Measuring<'_> {
    fn measure(&self, count: usize, out: &Path) -> Result<Outcome, Error> {
        let Self { common, args, subject, progress } = *self;
        let Subject { spec, loaded, truth } = subject;
        let start = Instant::now();
        let bake = Arc::new(Bake::build(&loaded.scene, &bake_settings(common, args, loaded, count), progress)?);
        let bake_s = start.elapsed().as_secs_f64();
        let light = LightSettings::default().with_method(MethodSettings::Classic).with_eye(loaded.view.eye);
        let pictures = PictureSettings::default().with_size(truth.size()).with_sub_frames(args.sub_frames);
        let mut renderer = load(common, &bake, &light, &pictures, progress)?;
        let shown = self.pictures(&mut renderer)?;
        let stops = loaded.exposure_stops;
        let scale = indirect_scale(&truth.pictures.indirect);
        let part = |judge: &Judge, one: &Picture, mean: &Picture, scale: f32| -> Result<Part, Error> {
            let errors = compare_pictures(one, judge.reference, scale, None)?;
            Ok(Part { errors, faults: judge.faults(mean, None)? })
        };
        let full = part(&truth.full(), &shown.first.full, &shown.mean.full, stops_to_scale(stops))?;
        let indirect = part(&truth.indirect(), &shown.first.indirect, &shown.mean.indirect, scale)?;
        let edges = Edges::new(&loaded.scene, &loaded.view.camera(truth.size().0, truth.size().1));
        let row = Row {
            scene: spec.clone(),
            noise_share: noise_share(&shown.first.full, &shown.second.full, stops_to_scale(stops), None)?,
            leak_share: indirect.faults.leak_share,
            stain_share: indirect.faults.stain_share,
            blotch_p95: indirect.faults.blotch_p95,
            blotch16_p95: indirect.faults.blotch_16_p95,
            blotch64_p95: indirect.faults.blotch_64_p95,
            teeth_share: edges.tooth_share(&truth.indirect(), &shown.mean.indirect)?,
            pattern: edges.pattern(&truth.pictures.direct, &shown.mean.direct)?,
            full,
            indirect,
            reference_noise: truth.noise(),
            patches: bake.mesh().patches.len(),
            receivers: bake.receivers().points.len(),
            interpolation_points: bake.receivers().interpolation.points.len(),
            energy: bake.energy(),
            bake_s,
        };
        progress.note(&summary_line(&row));
        let folder = out.join(file_name(spec));
        let figures = write_figures(&folder, subject, &edges, &shown)?;
        let text = vec![format!("Compared with {}{}.", truth.source, noise_text(row.reference_noise.as_ref()))];
        let title = format!("{spec}, {} patches", row.patches);
        let section = Section { title, text, figures, plots: Vec::new(), ..Section::default() };
        Ok(Outcome { row, section })
    }

    /// Pictures of two frames and the mean of all frames.
    fn pictures(&self, renderer: &mut PictureRenderer) -> Result<Shown, Error> {
        let Self { args, subject, progress, .. } = *self;
        let loaded = &subject.loaded;
        let size = subject.truth.size();
        let lighting = with_lights(&loaded.scene, &loaded.scene.lighting.lights);
        let camera = loaded.view.camera(size.0, size.1);
        let frames = args.frames().max(2);
        progress.phase("pictures", |report| {
            let mut render = |number: u32| -> Result<Pictures, Error> {
                let done = renderer.picture(&lighting, &camera, number)?;
                if report(number as usize + 1, frames as usize).is_break() || is_cancelled() {
                    return Err(shell::Error::Cancelled.into());
                }
                Ok(done.pictures)
            };
            let first = render(0)?;
            let second = render(1)?;
            let mut mean = sum(&first, &second)?;
            for number in 2..frames {
                mean = sum(&mean, &render(number)?)?;
            }
            for picture in [&mut mean.full, &mut mean.direct, &mut mean.indirect] {
                picture.pixels.iter_mut().for_each(|p| *p /= frames as f32);
            }
            Ok(Shown { first, second, mean })
        })
    }
}

/// Pictures of a bake.
struct Shown {
    /// Pictures of two frames.
    first: Pictures,
    second: Pictures,
    /// Mean of many frames: without the noise of single ones.
    mean: Pictures,
}

fn sum(a: &Pictures, b: &Pictures) -> Result<Pictures, Error> {
    Ok(Pictures {
        full: a.full.plus(&b.full)?,
        direct: a.direct.plus(&b.direct)?,
        indirect: a.indirect.plus(&b.indirect)?,
    })
}

/// Writes the pictures of a scene into its folder and reads them for the report.
fn write_figures(folder: &Path, subject: &Subject, edges: &Edges, shown: &Shown) -> Result<Vec<Figure>, Error> {
    let Subject { loaded, truth, .. } = subject;
    output::write_pictures(folder, &shown.first, &DisplayTransform::clipped(loaded.exposure_stops))?;
    let stops = loaded.exposure_stops;
    let scale = indirect_scale(&truth.pictures.indirect);
    let indirect_stops = scale_to_stops(scale);
    let full_scale = stops_to_scale(stops);
    let full = truth.full();
    let indirect = truth.indirect();
    let blotches = indirect.blotch_picture(&shown.mean.indirect, BLOTCH_EDGE, BLOTCH_RANGE)?;
    let noise = noise_picture(&shown.first.full, &shown.second.full, full_scale)?;
    let drawn: [(&str, &str, &Picture, f32); 12] = [
        ("full", "all light", &shown.first.full, stops),
        ("reference-full", "all light, reference", &truth.pictures.full, stops),
        ("noise", "noise: two frames differ by more than 1/255", &noise, 0.0),
        ("indirect", "indirect light", &shown.first.indirect, indirect_stops),
        ("reference-indirect", "indirect light, reference", &truth.pictures.indirect, indirect_stops),
        (
            "faults-indirect",
            "indirect light: leaks red, stains blue",
            &indirect.fault_picture(&shown.mean.indirect, scale)?,
            0.0,
        ),
        (
            "blotches",
            "indirect light: means over 16 × 16 pixels, red too bright, blue too dark, full at 20 %",
            &blotches,
            0.0,
        ),
        ("faults-full", "all light: leaks red, stains blue", &full.fault_picture(&shown.mean.full, full_scale)?, 0.0),
        ("mean-indirect", "indirect light, mean of all frames", &shown.mean.indirect, indirect_stops),
        (
            "teeth",
            "indirect light: teeth, pixels near edges that are off by more than 25 %",
            &edges.tooth_picture(&indirect, &shown.mean.indirect, scale)?,
            0.0,
        ),
        ("direct", "direct light", &shown.first.direct, stops),
        ("reference-direct", "direct light, reference", &truth.pictures.direct, stops),
    ];
    let mut figures = Vec::new();
    for (name, caption, picture, stops) in drawn {
        let file = format!("{name}.png");
        picture.write_png(&folder.join(&file), stops)?;
        figures.push(Figure::read(folder, &file, caption.to_owned())?);
    }
    Ok(figures)
}

fn results(common: &Common, args: &Bench, machine: &Machine, outcomes: &[Outcome]) -> String {
    output::json(&Results {
        name: "clean",
        machine,
        seed: common.seed,
        size: args.size(),
        sub_frames: args.sub_frames,
        pictures: args.frames().max(2),
        rows: outcomes.iter().map(|outcome| &outcome.row).collect(),
    })
}

/// A name of a file for a scene as it was asked for.
fn file_name(spec: &str) -> String {
    let stem = Path::new(spec).file_stem().map_or(spec.into(), |stem| stem.to_string_lossy());
    let name = if procedural::is_built_in(spec) { spec.into() } else { stem };
    name.chars().map(|c| if c.is_alphanumeric() || c == '.' { c } else { '-' }).collect()
}

fn percent(share: f64) -> String {
    format!("{:.3}", 100.0 * share)
}

fn percent_or_none(share: Option<f64>) -> String {
    share.map_or_else(|| "–".to_owned(), |share| format!("{:.2}", 100.0 * share))
}

fn noise_text(noise: Option<&KeptNoise>) -> String {
    let Some(KeptNoise { full, indirect, .. }) = noise else { return String::new() };
    format!(
        "; standard error of a pixel {:.2} % of all light, {:.2} % of indirect light (medians); it hides leaks at \
         {:.2} % and stains at {:.2} % of the pixels of indirect light",
        100.0 * full.median_relative_standard_error,
        100.0 * indirect.median_relative_standard_error,
        100.0 * indirect.leaks_hidden_share,
        100.0 * indirect.stains_hidden_share,
    )
}

fn summary_line(row: &Row) -> String {
    format!(
        "{}: noise {} %, leaks {} %, stains {} %, blotches {} %, teeth {} %, pattern {}",
        row.scene,
        percent(row.noise_share),
        percent(row.leak_share),
        percent(row.stain_share),
        percent_or_none(row.blotch_p95),
        percent(row.teeth_share),
        pattern_text(row.pattern),
    )
}

fn tables(outcomes: &[Outcome]) -> Vec<Table> {
    let head = [
        "scene",
        "patches",
        "noise %",
        "leaks %",
        "stains %",
        "blotches 16 / 32 / 64, %",
        "teeth %",
        "pattern",
        "bake s",
    ];
    let faults = Table {
        caption: "Shares of pixels. Noise: two frames of one bake differ by more than 1/255. Of indirect light, mean \
                  of all frames: leaks, brighter than the reference by more than 10 % of the mean indirect light; \
                  stains, darker by more than 25 %; blotches, 95th percentile of the relative errors of means over \
                  squares; teeth, within 3 pixels of an edge and off by more than 25 %. Pattern: greatest correlation \
                  of the relative error of direct light with itself 2 to 16 pixels further, away from edges."
            .to_owned(),
        head: head.map(str::to_owned).to_vec(),
        rows: outcomes.iter().map(|outcome| fault_cells(&outcome.row)).collect(),
    };
    let head = [
        "scene",
        "light",
        "leaks %",
        "stains %",
        "block median %",
        "block dB",
        "mean ratio",
        "SSIM",
        "FLIP",
        "standard error of the reference, %",
    ];
    let errors = Table {
        caption: "Errors of one frame against the reference, leaks and stains of all light, too.".to_owned(),
        head: head.map(str::to_owned).to_vec(),
        rows: outcomes.iter().flat_map(|outcome| error_cells(&outcome.row)).collect(),
    };
    vec![faults, errors, energy_table(outcomes)]
}

/// Errors of indirect light over patches, beside what bakes say of themselves.
fn energy_table(outcomes: &[Outcome]) -> Table {
    let head = [
        "scene",
        "patches",
        "block median %",
        "block dB",
        "mean ratio",
        "balance %",
        "shown / rays",
        "far off",
        "rises",
    ];
    let rows = outcomes.iter().map(|outcome| energy_cells(outcomes, &outcome.row));
    Table {
        caption: "Indirect light over patches. Balance: light that all patches send alike and that is neither \
                  absorbed nor escapes, or that comes from nowhere. Shown / rays: mean indirect light of receivers \
                  over that of 65,536 rays, in the focus and far off, with its standard error. Rises: the block \
                  median exceeds that of fewer patches by more than a twentieth."
            .to_owned(),
        head: head.map(str::to_owned).to_vec(),
        rows: rows.collect(),
    }
}

fn energy_cells(outcomes: &[Outcome], row: &Row) -> Vec<String> {
    let median = |row: &Row| row.indirect.errors.block_median_relative_error;
    let is_fewer = |other: &&Row| other.scene == row.scene && other.patches < row.patches;
    let before = outcomes.iter().map(|outcome| &outcome.row).filter(is_fewer).map(median).fold(f64::INFINITY, f64::min);
    let ratio = |found: Option<MeanRatio>| {
        found.map_or_else(|| "–".to_owned(), |r| format!("{:.3} ± {:.3}", r.ratio, r.standard_error))
    };
    let balance = row.energy.map_or_else(|| "–".to_owned(), |energy| format!("{:+.2}", 100.0 * energy.balance));
    vec![
        row.scene.clone(),
        row.patches.to_string(),
        format!("{:.2}", 100.0 * median(row)),
        format!("{:.1}", row.indirect.errors.block_psnr_db),
        format!("{:.3}", row.indirect.errors.mean_ratio),
        balance,
        ratio(row.energy.and_then(|energy| energy.near)),
        ratio(row.energy.and_then(|energy| energy.far)),
        if median(row) > before * (1.0 + RISE) { "yes" } else { "" }.to_owned(),
    ]
}

fn fault_cells(row: &Row) -> Vec<String> {
    let Faults { blotch_16_p95, blotch_p95, blotch_64_p95, .. } = row.indirect.faults;
    vec![
        row.scene.clone(),
        row.patches.to_string(),
        percent(row.noise_share),
        percent(row.leak_share),
        percent(row.stain_share),
        [blotch_16_p95, blotch_p95, blotch_64_p95].map(percent_or_none).join(" / "),
        percent(row.teeth_share),
        pattern_text(row.pattern),
        format!("{:.1}", row.bake_s),
    ]
}

fn pattern_text(pattern: Option<f64>) -> String {
    pattern.map_or_else(|| "–".to_owned(), |correlation| format!("{correlation:.3}"))
}

fn error_cells(row: &Row) -> [Vec<String>; 2] {
    let noise =
        row.reference_noise.map(|noise| [noise.full, noise.indirect].map(|part| part.median_relative_standard_error));
    [("all", &row.full, 0), ("indirect", &row.indirect, 1)].map(|(light, Part { errors, faults }, part)| {
        vec![
            row.scene.clone(),
            light.to_owned(),
            percent(faults.leak_share),
            percent(faults.stain_share),
            format!("{:.2}", 100.0 * errors.block_median_relative_error),
            format!("{:.1}", errors.block_psnr_db),
            format!("{:.3}", errors.mean_ratio),
            format!("{:.3}", errors.ssim),
            significant(errors.flip),
            percent_or_none(noise.map(|noise| noise[part])),
        ]
    })
}

fn write_report(machine: &Machine, args: &Bench, outcomes: &[Outcome], out: &Path) -> Result<(), Error> {
    let introduction = [
        machine.sentence(),
        format!(
            "Pictures of {} sub-frames a pixel; leaks, stains and blotches are counted in the mean of {} of them. A \
             difference counts only where it exceeds three standard errors of the reference.",
            args.sub_frames,
            args.frames().max(2)
        ),
    ];
    let summary = Section { title: "Faults".to_owned(), tables: tables(outcomes), ..Section::default() };
    let sections = [&summary].into_iter().chain(outcomes.iter().map(|outcome| &outcome.section));
    Ok(output::write_text(&out.join("report.html"), &page("Patchlight: clean pictures", &introduction, sections))?)
}
