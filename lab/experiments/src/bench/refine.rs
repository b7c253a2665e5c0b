//! `bench refine`: error of a bake that goes on, over the time since the scene was there, beside the path tracer and
//! DDGI on the same clock.

use std::sync::Arc;
use std::time::{Duration, Instant};

use patchlight::low_level::operator::Codec;
use patchlight::{Bake, LightSettings, MethodSettings, PictureRenderer, PictureSettings, Refinement};
use reference::metrics::{compare_pictures, indirect_scale};
use reference::{Accumulation, PathSettings, PathTracer, Picture, Strategy};
use scene::math::luminance;
use serde::Serialize;

use super::contest::contender::Contender;
use super::contest::field::Field;
use super::contest::{View, cancelled};
use super::setup::{Machine, Setup, bake_settings, load, one_scene};
use super::truth::Truth;
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, interruptible, is_cancelled};
use crate::report::{Plot, Section, Series, Table, page, significant};

/// Scene, and its patches, unless it is said.
const SCENE: &str = "office";
const COUNT: u32 = 10_000;
/// Relative error of the compressed operator.
const EPSILON: f64 = 0.01;
/// Time between looks at the bake.
const LOOK: Duration = Duration::from_millis(1);
/// Seed that sets the paths of the opponent apart from those of the reference.
const OTHER_PATHS: u32 = 0x7265_6669;
/// Opponents are looked at after so many passes or frames, and then after as many more as there were each time.
const FIRST_LOOK: u32 = 1;
/// A contender has come to rest when its error changed by no more than this share between two looks, the second after
/// twice as many frames; then at least so many were made.
const RESTS: f64 = 0.02;
const MIN_FRAMES: u32 = 8;

/// Error at a time.
#[derive(Clone, Copy, Debug, Serialize)]
struct Row {
    /// Since the scene was there, until the picture is.
    seconds: f64,
    /// Median relative error of blocks of indirect light.
    block_median_relative_error: f64,
}

impl Row {
    /// Returns true if the error is that of another row, but for a small share.
    fn is_near(&self, other: &Self) -> bool {
        let change = (self.block_median_relative_error - other.block_median_relative_error).abs();
        change <= RESTS * other.block_median_relative_error
    }
}

/// A level of the bake.
#[derive(Clone, Debug, Serialize)]
struct Level {
    #[serde(flatten)]
    row: Row,
    patches: usize,
    receivers: usize,
    /// Mean of its indirect light over that of the reference.
    energy: f64,
    /// Of that time, the part after the bake: its tables on the device, a light update, a picture.
    shown_after_s: f64,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    scene: &'a str,
    machine: &'a Machine,
    size: (u32, u32),
    reference: &'a str,
    first_light_s: f64,
    whole_s: f64,
    rows: &'a [Level],
    path_tracing: &'a [Row],
    ddgi: &'a [Row],
}

/// Runs the experiment.
pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let scene = one_scene(args, SCENE, "refine")?;
    let Setup { out, machine, counts, .. } = Setup::new(common, args, "refine", &[], &[COUNT])?;
    let progress = Progress::new(common.quiet);
    let loaded = output::import_flat(scene, &progress)?;
    let truth = match Truth::find(args.reference_folder(), &loaded)? {
        Some(truth) => truth,
        None => {
            let lights = &loaded.scene.lighting.lights;
            Truth::traced(&loaded, lights, args.size(), args.spp, common.seed, &progress)?
        }
    };
    let args = &Bench { size: Some(truth.size()), ..args.clone() };
    let judge = Judge::new(&truth.pictures.indirect);
    let view = View::new(common, args, &loaded);
    let (levels, last) = levels(&view, counts[0] as usize, &judge, &progress)?;
    let whole_s = levels.last().map_or(0.0, |level| level.row.seconds);
    let path_tracing = progress.phase("path tracer", |_| paths(&view, whole_s, &judge))?;
    let mut probes = Field::of_bake(&view, &last, &progress).finest_probes()?;
    let ddgi = progress.phase("DDGI", |_| frames(&view, probes.as_mut(), whole_s, &judge))?;
    let results = Results {
        name: "refine",
        scene: &loaded.name,
        machine: &machine,
        size: args.size(),
        reference: &truth.source,
        first_light_s: levels.first().map_or(0.0, |level| level.row.seconds),
        whole_s,
        rows: &levels,
        path_tracing: &path_tracing,
        ddgi: &ddgi,
    };
    output::write_text(&out.join("summary.json"), &output::json(&results))?;
    let section = results.section();
    let introduction = [
        machine.sentence(),
        format!(
            "Time since the scene was imported, until there is a picture. Blocks are means of 8 × 8 pixels of indirect \
             light: the median of the relative errors of their luminance beside {}. The bake is measured from the \
             first light to the settings asked for; its pictures are made after it, and their time is added.",
            truth.source
        ),
    ];
    output::write_text(&out.join("report.html"), &page("Patchlight: a bake that goes on", &introduction, [&section]))?;
    if common.json {
        say!("{}", output::json(&results));
    } else {
        section.tables.iter().for_each(|table| say!("{}", table.markdown()));
        say!("{} shows the same with curves", out.join("report.html").display());
    }
    Ok(())
}

/// Compares indirect light with the reference.
struct Judge<'a> {
    expected: &'a Picture,
    scale: f32,
}

impl<'a> Judge<'a> {
    fn new(expected: &'a Picture) -> Self {
        Self { expected, scale: indirect_scale(expected) }
    }

    fn row(&self, seconds: f64, indirect: &Picture) -> Result<Row, Error> {
        let errors = compare_pictures(indirect, self.expected, self.scale, None)?;
        Ok(Row { seconds, block_median_relative_error: errors.block_median_relative_error })
    }
}

/// The levels of a bake, and the last one.
fn levels(view: &View, patches: usize, judge: &Judge, progress: &Progress) -> Result<(Vec<Level>, Arc<Bake>), Error> {
    let View { common, args, loaded, .. } = *view;
    let settings = bake_settings(common, args, loaded, patches);
    let method = MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON });
    let start = Instant::now();
    let job = Bake::refine(&loaded.scene, &settings, Refinement::default().with_methods(vec![method]))?;
    let made = progress.phase("bake", |steps| {
        let mut made: Vec<(f64, Arc<Bake>)> = Vec::new();
        loop {
            // Before the look: what comes in between is seen by the next.
            let is_last = job.is_finished();
            made.extend(job.take_newest().map(|bake| (start.elapsed().as_secs_f64(), bake)));
            if is_last || steps((1000.0 * job.progress().share) as usize, 1001).is_break() {
                break made;
            }
            std::thread::sleep(LOOK);
        }
    });
    if is_cancelled() {
        job.cancel();
    }
    let last = job.join()?;
    let levels = made.iter().map(|(seconds, bake)| shown(view, *seconds, bake, method, judge, progress));
    Ok((levels.collect::<Result<_, _>>()?, last))
}

/// A level as a user sees it.
fn shown(
    view: &View,
    seconds: f64,
    bake: &Arc<Bake>,
    method: MethodSettings,
    judge: &Judge,
    progress: &Progress,
) -> Result<Level, Error> {
    let lighting = &view.loaded.scene.lighting;
    let light = LightSettings::default().with_method(method).with_eye(view.loaded.view.eye);
    let pictures = PictureSettings::default().with_size(view.args.size());
    let start = Instant::now();
    let mut renderer: PictureRenderer =
        load(view.common, bake, &light, &pictures.with_sub_frames(1), &Progress::new(true))?;
    interruptible(|| renderer.picture(lighting, &view.camera, 0))?;
    let shown_after_s = start.elapsed().as_secs_f64();
    renderer.resize(view.args.size(), view.args.sub_frames)?;
    let indirect = interruptible(|| renderer.picture(lighting, &view.camera, 0))?.pictures.indirect;
    let row = judge.row(seconds + shown_after_s, &indirect)?;
    progress.note(&format!(
        "{:.1} s: {} patches, {} receivers: error {:.1} %",
        row.seconds,
        bake.mesh().patches.len(),
        bake.receivers().points.len(),
        100.0 * row.block_median_relative_error
    ));
    Ok(Level {
        row,
        patches: bake.mesh().patches.len(),
        receivers: bake.receivers().points.len(),
        energy: f64::from(luminance(indirect.mean()) / luminance(judge.expected.mean())),
        shown_after_s,
    })
}

/// Errors of the path tracer, which goes on as long as the bake did.
fn paths(view: &View, until: f64, judge: &Judge) -> Result<Vec<Row>, Error> {
    let seed = view.common.seed ^ OTHER_PATHS;
    let settings = PathSettings { seed, strategy: Strategy::ShadowRays, ..PathSettings::default() };
    let mut sums = Accumulation::new(&view.camera, settings);
    let tracer = PathTracer::new(&view.loaded.scene);
    let mut rows: Vec<Row> = Vec::new();
    let mut seconds = 0.0;
    let mut passes = FIRST_LOOK;
    while seconds < until {
        let start = Instant::now();
        let target = sums.samples() + passes;
        tracer.accumulate(&view.camera, &mut sums, target, |_, _| match is_cancelled() {
            true => std::ops::ControlFlow::Break(()),
            false => std::ops::ControlFlow::Continue(()),
        })?;
        cancelled()?;
        seconds += start.elapsed().as_secs_f64();
        rows.push(judge.row(seconds, &sums.indirect())?);
        if rows.len() > 1 {
            // As many as there were, and no more than fit into the rest of the time.
            let fit = (until - seconds) * f64::from(sums.samples()) / seconds.max(f64::MIN_POSITIVE);
            passes = (2 * passes).min(fit.ceil().max(1.0) as u32);
        }
    }
    Ok(rows)
}

/// Errors of a contender whose light follows frame by frame, as long as the bake took or until it rests; what it
/// prepares counts.
fn frames(view: &View, contender: &mut dyn Contender, until: f64, judge: &Judge) -> Result<Vec<Row>, Error> {
    let lighting: &scene::Lighting = &view.loaded.scene.lighting;
    let mut rows: Vec<Row> = Vec::new();
    let mut seconds = contender.build_s();
    let mut next = FIRST_LOOK;
    for number in 0u32.. {
        seconds += 1e-3 * contender.frame(lighting, number)?.update.wall;
        cancelled()?;
        let is_late = seconds >= until;
        if number + 1 == next || is_late {
            next *= 2;
            let row = judge.row(seconds, &contender.pictures(None)?.indirect)?;
            let rests = number + 1 >= MIN_FRAMES && rows.last().is_some_and(|before| row.is_near(before));
            rows.push(row);
            if rests || is_late {
                break;
            }
        }
    }
    Ok(rows)
}

impl Results<'_> {
    fn section(&self) -> Section {
        let percent = |x: f64| format!("{:.1}", 100.0 * x);
        let level = |level: &Level| {
            vec![
                format!("{:.1}", level.row.seconds),
                percent(level.row.seconds / self.whole_s.max(f64::MIN_POSITIVE)),
                level.patches.to_string(),
                level.receivers.to_string(),
                percent(level.row.block_median_relative_error),
                format!("{:.3}", level.energy),
            ]
        };
        let head = ["seconds", "of the whole %", "patches", "receivers", "block error %", "mean / reference"];
        let own = Table {
            caption: format!("{}: levels of the bake", self.scene),
            head: head.map(str::to_owned).to_vec(),
            rows: self.rows.iter().map(level).collect(),
        };
        let others = [("path tracer", self.path_tracing), ("DDGI", self.ddgi)];
        let row = |(name, rows): &(&str, &[Row])| {
            let at = |share: f64| {
                let before = rows.iter().take_while(|row| row.seconds <= share * self.whole_s).last();
                before.map_or_else(|| "–".to_owned(), |row| percent(row.block_median_relative_error))
            };
            let last = rows.last().map_or_else(String::new, |row| significant(row.seconds));
            vec![(*name).to_owned(), at(0.05), at(0.25), at(1.01), last]
        };
        let head = ["block error %", "5 % of the time", "a quarter", "the whole", "seconds measured"];
        let beside = Table {
            caption: "Others, in the time of the bake or until they rest".into(),
            head: head.map(str::to_owned).to_vec(),
            rows: others.iter().map(row).collect(),
        };
        let points = |rows: &[Row]| {
            rows.iter().map(|row| (row.seconds, 100.0 * row.block_median_relative_error)).collect::<Vec<_>>()
        };
        let own_rows: Vec<Row> = self.rows.iter().map(|level| level.row).collect();
        let lines = [("bake", &own_rows[..]), ("path tracer", self.path_tracing), ("DDGI", self.ddgi)];
        let series = lines.iter().map(|(name, rows)| Series { name: (*name).into(), points: points(rows) });
        let plot = Plot {
            title: format!("{}: error of indirect light over time", self.scene),
            unit: "% (median of blocks)".into(),
            x: "seconds".into(),
            logarithmic: true,
            series: series.collect(),
        };
        Section { title: self.scene.to_owned(), tables: vec![own, beside], plots: vec![plot], ..Section::default() }
    }
}
