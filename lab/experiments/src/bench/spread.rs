//! `bench spread`: ways to spread the product with the form factors over frames. The thesis names two for the matrix as
//! it is, and refuses both (chapter 6): light that is shown when a product over many frames is done jumps, light of a
//! part of the columns in each frame flickers. Beside them samples of rows, and what the weight w of the frames before
//! does to these (figure 6.2).

use std::sync::Arc;

use glam::{Vec3, Vec4};
use serde::Serialize;
use temporal::{AliasTables, Blend, Packing, RayLists, Settings, State};
use transport::{Csr, LinearOperator as _};

use super::setup::{Machine, SCENES, Setup, bake_settings, load};
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, interruptible, is_cancelled};
use crate::report::{Plot, Section, Series, Table, page};
use crate::sequence::{distance, flicker, frame_time};
use assets::import::{Animation, LoadedScene};
use patchlight::light::with_lights;
use patchlight::{Bake, LightSettings, MethodSettings, PictureSettings};
use reference::stops_to_scale;

/// Patches of a scene, unless it is said.
const COUNT: u32 = 2000;
/// Frames in which lights move, and in which they rest.
const MOVING: u32 = 48;
const REST: u32 = 32;
/// Frames before the first that is measured, in which all light arrives.
const BEFORE: u32 = 64;
/// Frames over which a product is spread.
const FRAMES: usize = 8;
/// Weights of the frames before, and samples a row and frame with which they are tried.
const WEIGHTS: [f32; 7] = [0.0, 0.25, 0.5, 0.75, 0.9, 0.95, 0.98];
const SAMPLES: u32 = 64;
/// Relative change at which the light of all bounces is found, and most products for it.
const EXACT: f64 = 1e-6;
const MAX_PRODUCTS: u32 = 500;
/// Picture of which a renderer wants to know the size; none is rendered.
const SIZE: (u32, u32) = (32, 18);
/// Entries of a list that stands for a row of real numbers.
const LIST_ENTRIES: usize = 1024;

/// A way to go on by a frame: takes the first exitance of the patches, gives the irradiance that is shown, W/m².
type Way<'a> = Box<dyn FnMut(&[Vec4]) -> Result<Vec<Vec4>, Error> + 'a>;

/// Results of a way.
#[derive(Clone, Serialize)]
struct Row {
    scene: String,
    patches: usize,
    way: String,
    /// Relative L2 distance from the light of all bounces while lights move: median, greatest.
    error: f64,
    worst: f64,
    /// Greatest change of displayed values from frame to frame while lights move (99.9th percentile), 255ths.
    jump_255: f64,
    /// Flicker after all lights rest: in the last frames, and the distance there.
    flicker_255: f64,
    rest: f64,
    #[serde(skip)]
    errors: Vec<f64>,
    #[serde(skip)]
    changes: Vec<f64>,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    seed: u32,
    frames: usize,
    rows: &'a [Row],
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "spread", &SCENES, &[COUNT])?;
    let mut rows = Vec::new();
    let results = |rows: &[Row]| {
        output::json(&Results { name: "spread", machine: &machine, seed: common.seed, frames: FRAMES, rows })
    };
    let mut sections = Vec::new();
    for scene in scenes {
        let progress = Progress::new(common.quiet);
        let loaded = output::import_flat(scene, &progress)?;
        for &count in &counts {
            let found = interruptible(|| measure(common, args, &loaded, count as usize, &progress))?;
            let section = section(&found);
            for (name, plot) in ["error", "change", "weights"].iter().zip(&section.plots) {
                let file = format!("{}-{count}-{name}.svg", loaded.name);
                output::write_text(&out.join(file), &plot.svg())?;
            }
            sections.push(section);
            rows.extend(found);
            output::write_text(&out.join("summary.json"), &results(&rows))?;
        }
    }
    let introduction = [machine.sentence()];
    output::write_text(
        &out.join("report.html"),
        &page("Patchlight: products spread over frames", &introduction, &sections),
    )?;
    if common.json {
        say!("{}", results(&rows));
    } else {
        sections.iter().flat_map(|section| &section.tables).for_each(|table| say!("{}", table.markdown()));
        say!("{} shows the same", out.join("report.html").display());
    }
    Ok(())
}

fn measure(
    common: &Common,
    args: &Bench,
    loaded: &LoadedScene,
    count: usize,
    progress: &Progress,
) -> Result<Vec<Row>, Error> {
    // Only the light between patches is measured: the fewest receivers.
    let settings = (bake_settings(common, args, loaded, count)).with_most_receivers(Some(1));
    let bake = Arc::new(Bake::build(&loaded.scene, &settings, progress)?);
    let sources = sources(common, loaded, &bake, progress)?;
    let factors = &bake.form_factors().factors;
    let albedo = &bake.mesh().albedo;
    let exact = exact_light(factors, albedo, &sources)?;
    let scale = stops_to_scale(loaded.exposure_stops);
    let row = |way: &str, shown: &[Vec<Vec3>]| judge(&loaded.name, way, shown, &exact, scale);
    let mut rows = vec![row("all bounces at once", &exact)];
    for (name, mut way) in ways(factors, albedo, common.seed)? {
        if is_cancelled() {
            return Err(shell::Error::Cancelled.into());
        }
        let mut shown = Vec::new();
        for _ in 0..BEFORE {
            way(&sources[0])?;
        }
        for source in &sources {
            shown.push(truncated(&way(source)?));
        }
        rows.push(row(&name, &shown));
    }
    Ok(rows)
}

/// First exitance of the patches in each frame, W/m².
fn sources(
    common: &Common,
    loaded: &LoadedScene,
    bake: &Arc<Bake>,
    progress: &Progress,
) -> Result<Vec<Vec<Vec4>>, Error> {
    let light = LightSettings::default().with_method(MethodSettings::Classic);
    let pictures = PictureSettings::default().with_size(SIZE).with_sub_frames(1);
    let mut renderer = load(common, bake, &light, &pictures, progress)?;
    let path = Animation::or_default_path(loaded);
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let mut found = Vec::new();
    for frame in 0..MOVING + REST {
        let time = frame_time(&path, frame.min(MOVING - 1), MOVING);
        renderer.advance(&with_lights(&loaded.scene, &path.at(time).0), &camera)?;
        let source = renderer.light().buffers().source;
        found.push(renderer.light_mut().download(source)?);
    }
    Ok(found)
}

/// Light of all bounces in each frame, W/m².
fn exact_light(factors: &Csr, albedo: &[Vec4], sources: &[Vec<Vec4>]) -> Result<Vec<Vec<Vec3>>, Error> {
    let mut light = vec![Vec4::ZERO; albedo.len()];
    let mut all = Vec::new();
    for source in sources {
        for _ in 0..MAX_PRODUCTS {
            let next = product(factors, &exitance(source, albedo, &light))?;
            let step = distance(&truncated(&next), &truncated(&light));
            light = next;
            if step < EXACT {
                break;
            }
        }
        all.push(truncated(&light));
    }
    Ok(all)
}

/// All ways, by name.
fn ways<'a>(factors: &'a Csr, albedo: &'a [Vec4], seed: u32) -> Result<Vec<(String, Way<'a>)>, Error> {
    let Csr { columns, row_start, column_index, values, .. } = factors;
    let tables = AliasTables::from_rows(*columns, row_start, column_index, values, Packing::Stacks)
        .map_err(patchlight::Error::from)?;
    let lists = RayLists::from_rows(*columns, row_start, column_index, values, LIST_ENTRIES)
        .map_err(patchlight::Error::from)?;
    let tables = Arc::new(tables);
    let share = 1.0 - 1.0 / FRAMES as f32;
    let samples = albedo.len().div_ceil(FRAMES) as u32;
    let printed = |samples, w| Settings {
        samples,
        blend: Blend::Fixed(w),
        control_variate: false,
        rotated: false,
        seed,
        ..Settings::DEFAULT
    };
    let mut ways: Vec<(String, Way)> = vec![
        ("a product a frame".into(), each_frame(factors, albedo)),
        (format!("a product over {FRAMES} frames, then shown"), when_done(factors, albedo)),
        (format!("a part of {FRAMES} of the columns a frame"), by_parts(factors, albedo)),
    ];
    let sampled = |rows: &Arc<AliasTables>, settings: Settings| -> Way<'a> {
        let rows = Arc::clone(rows);
        let mut state = State::new(albedo.len());
        Box::new(move |source| {
            state.advance(&*rows, source, albedo, &settings).map_err(patchlight::Error::from)?;
            Ok(state.irradiance.clone())
        })
    };
    ways.push((format!("{samples} samples a row, w {share}"), sampled(&tables, printed(samples, share))));
    let mut state = State::new(albedo.len());
    let changes = Settings { samples: SAMPLES, seed, ..Settings::DEFAULT };
    ways.push((
        format!("{SAMPLES} samples of the change a row, rows exact once in {}", changes.refresh),
        Box::new(move |source| {
            state.advance(&lists, source, albedo, &changes).map_err(patchlight::Error::from)?;
            Ok(state.irradiance.clone())
        }),
    ));
    for w in WEIGHTS {
        ways.push((format!("{SAMPLES} samples a row, w {w}"), sampled(&tables, printed(SAMPLES, w))));
    }
    Ok(ways)
}

/// Classic radiosity: each frame a bounce more of the light.
fn each_frame<'a>(factors: &'a Csr, albedo: &'a [Vec4]) -> Way<'a> {
    let mut light = vec![Vec4::ZERO; albedo.len()];
    Box::new(move |source| {
        light = product(factors, &exitance(source, albedo, &light))?;
        Ok(light.clone())
    })
}

/// A product of the light at the frame with which it began; what it gives is shown when it is done.
fn when_done<'a>(factors: &'a Csr, albedo: &'a [Vec4]) -> Way<'a> {
    let mut shown = vec![Vec4::ZERO; albedo.len()];
    let mut under_way = shown.clone();
    let mut frame = 0;
    Box::new(move |source| {
        if frame % FRAMES == 0 {
            shown.clone_from(&under_way);
            // All of it here; on a device a part of the rows in each frame.
            under_way = product(factors, &exitance(source, albedo, &shown))?;
        }
        frame += 1;
        Ok(shown.clone())
    })
}

/// Each frame a part of the columns, times the number of parts, blended with the frames before so that a round of all
/// parts counts.
fn by_parts<'a>(factors: &'a Csr, albedo: &'a [Vec4]) -> Way<'a> {
    let patches = albedo.len();
    let part = patches.div_ceil(FRAMES);
    let weight = 1.0 / FRAMES as f32;
    let mut light = vec![Vec4::ZERO; patches];
    let mut frame = 0;
    Box::new(move |source| {
        let first = frame % FRAMES * part;
        frame += 1;
        let all = exitance(source, albedo, &light);
        let seen: Vec<Vec4> =
            (0..patches).map(|j| if (first..first + part).contains(&j) { all[j] } else { Vec4::ZERO }).collect();
        let found = product(factors, &seen)?;
        for (h, found) in light.iter_mut().zip(&found) {
            *h = *h * (1.0 - weight) + *found * (weight * FRAMES as f32);
        }
        Ok(light.clone())
    })
}

/// Exitance of patches, W/m²: E + ρ∘H.
fn exitance(source: &[Vec4], albedo: &[Vec4], light: &[Vec4]) -> Vec<Vec4> {
    source.iter().zip(albedo).zip(light).map(|((e, rho), h)| *e + *rho * *h).collect()
}

fn product(factors: &Csr, exitance: &[Vec4]) -> Result<Vec<Vec4>, Error> {
    let mut light = vec![Vec4::ZERO; factors.row_start.len() - 1];
    factors.apply(exitance, &mut light).map_err(patchlight::Error::from)?;
    Ok(light)
}

fn truncated(light: &[Vec4]) -> Vec<Vec3> {
    light.iter().map(|h| h.truncate()).collect()
}

/// Differences of the light of all frames from that of all bounces, and from frame to frame.
fn judge(scene: &str, way: &str, shown: &[Vec<Vec3>], exact: &[Vec<Vec3>], scale: f32) -> Row {
    let errors: Vec<f64> = shown.iter().zip(exact).map(|(now, exact)| distance(now, exact)).collect();
    let changes: Vec<f64> = shown.windows(2).map(|two| flicker(&two[1], &two[0], scale)).collect();
    let moving = MOVING as usize;
    // Lights rest since half of the frames of rest: what lags has arrived.
    let late = moving + REST as usize / 2;
    let greatest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let mut ordered = errors[..moving].to_vec();
    ordered.sort_by(f64::total_cmp);
    Row {
        scene: scene.to_owned(),
        patches: exact[0].len(),
        way: way.to_owned(),
        error: ordered[moving / 2],
        worst: greatest(&errors[..moving]),
        jump_255: greatest(&changes[..moving - 1]),
        flicker_255: greatest(&changes[late..]),
        rest: greatest(&errors[late..]),
        errors,
        changes,
    }
}

/// Tables and plots of a scene.
fn section(rows: &[Row]) -> Section {
    let (of_ways, of_weights) = rows.split_at(rows.len() - WEIGHTS.len());
    let over_frames = |title: &str, unit: &str, values: &dyn Fn(&Row) -> &[f64]| Plot {
        title: title.into(),
        unit: unit.into(),
        x: "frame".into(),
        logarithmic: false,
        series: of_ways
            .iter()
            .map(|row| {
                let points = values(row).iter().enumerate().map(|(frame, value)| (frame as f64, *value));
                Series { name: row.way.clone(), points: points.collect() }
            })
            .collect(),
    };
    let over_weights = |name: &str, value: &dyn Fn(&Row) -> f64| {
        let points = of_weights.iter().zip(WEIGHTS).map(|(row, w)| (f64::from(w), 100.0 * value(row)));
        Series { name: name.into(), points: points.collect() }
    };
    let caption = "Distances are relative L2 of the irradiance of patches from that of all bounces; changes are those \
                   of displayed values from one frame to the next, the 99.9th percentile of the patches and the \
                   greatest of the frames";
    let head = [
        "way",
        "distance while lights move %: median",
        "greatest",
        "change while they move /255",
        "distance at rest %",
        "change at rest /255",
    ];
    Section {
        title: rows.first().map_or_else(String::new, |row| format!("{}, {} patches", row.scene, row.patches)),
        plots: vec![
            over_frames("Distance from the light of all bounces", "relative L2", &|row| &row.errors),
            over_frames("Change of displayed values", "1/255", &|row| &row.changes),
            Plot {
                title: format!("Weight of the frames before, {SAMPLES} samples a row"),
                unit: "distance %".into(),
                x: "w".into(),
                logarithmic: false,
                series: vec![
                    over_weights("while lights move", &|row| row.error),
                    over_weights("at rest", &|row| row.rest),
                ],
            },
        ],
        tables: vec![Table {
            caption: caption.into(),
            head: head.map(String::from).to_vec(),
            rows: rows.iter().map(Row::cells).collect(),
        }],
        ..Section::default()
    }
}

impl Row {
    fn cells(&self) -> Vec<String> {
        vec![
            self.way.clone(),
            format!("{:.2}", 100.0 * self.error),
            format!("{:.2}", 100.0 * self.worst),
            format!("{:.2}", self.jump_255),
            format!("{:.2}", 100.0 * self.rest),
            format!("{:.2}", self.flicker_255),
        ]
    }
}
