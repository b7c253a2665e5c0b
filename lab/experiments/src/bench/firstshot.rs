//! `bench firstshot`: photons, photon hits and time to an error, first shot against photons from
//! the lights; quasi-random against random numbers; photon segments against the hierarchy's own
//! rays.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use firstshot::kernel::segment::reflect;
use firstshot::kernel::start::{Sources, start_photon};
use firstshot::{
    Emission, Estimate, IlluminationMaps, PhotonAccumulator, PhotonParams, PhotonScene, PhotonSettings, Round, Tracer,
    corner_light, trace_photons,
};
use glam::Vec3;
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::RayHit;
use obvhs::rt_triangle::RtTriangle;
use patchlight::method::FirstShotSettings;
use patchlight::method::firstshot::{Cubic, Sequences, StartLight, Subdivision, Texels};
use rayon::prelude::*;
use scene::gpu::{LIGHT_POINT, LIGHT_SPOT};
use scene::kernel::bvh::FAR;
use scene::math::{luminance, sin_cos_2pi};
use scene::sampling::{hammersley, hash3};
use scene::{Light, Scene, Sky};
use serde::Serialize;

use super::setup::{Machine, Setup};
use crate::args::{Bench, Common};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, Steps, is_cancelled};
use crate::report::{Plot, Section, Series, Table, page, significant};
use assets::import::LoadedScene;

/// Scenes that need no file: about as many triangles as Kopylov's.
const SCENES: [&str; 2] = ["atrium:65000", "atrium:225000"];
/// Patches whose irradiance has the error: so many that photons from the lights number about as many as Kopylov's, 3.4
/// million.
const COUNT: u32 = 40_000;
/// Cells of the maps along the edge of a patch.
const CELLS: f32 = 2.0;
/// Lights, as many as Kopylov's scenes have: a third of them spots.
const LIGHTS: u32 = 9;
/// Curves go on to this share of the error that is asked for.
const BEYOND: f64 = 0.7;
/// Photons whose rays are cast again by obvhs, and rounds of which the fastest counts.
const RATE_PHOTONS: u32 = 1 << 17;
const RATE_ROUNDS: usize = 3;

/// A way to shoot.
#[derive(Clone, Copy)]
struct Way {
    name: &'static str,
    /// First shot; without, photons start from the lights.
    first_shot: Option<FirstShotSettings>,
}

/// Photons from the lights.
const CLASSICAL: Way = Way { name: "from the lights", first_shot: None };

/// First shot, and what Kopylov prints one by one and all together.
fn first_shots() -> [Way; 6] {
    let ours = FirstShotSettings::default();
    let way = |name, settings| Way { name, first_shot: Some(settings) };
    let subdivision = Subdivision::Kopylov;
    [
        way("first shot", ours),
        way("first shot, table alone", FirstShotSettings { start_light: StartLight::Table, ..ours }),
        way("first shot, subdivision as printed", FirstShotSettings { subdivision, ..ours }),
        way("first shot, Cardano's formula", FirstShotSettings { cubic: Cubic::Cardano, ..ours }),
        way("first shot, brightest texel", FirstShotSettings { texels: Texels::Bound, ..ours }),
        way("first shot, all as printed", FirstShotSettings::as_printed()),
    ]
}

/// One run to the error.
#[derive(Clone, Serialize)]
struct Row {
    scene: String,
    triangles: usize,
    method: &'static str,
    sequence: &'static str,
    /// Relative error asked for.
    error: f64,
    photons: u64,
    registered: u64,
    segments: u64,
    elements: usize,
    /// Seconds of the table of light elements, and of tracing and accumulation.
    table_s: f64,
    trace_s: f64,
    /// Difference to photons from the lights at the end of their curves, and what both errors allow: √(σ₁² + σ₂²).
    #[serde(skip_serializing_if = "Option::is_none")]
    difference: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    expected_difference: Option<f64>,
    /// Photons and relative error after each round.
    curve: Vec<(f64, f64)>,
}

/// Rays a second.
#[derive(Clone, Serialize)]
struct Rate {
    scene: String,
    method: &'static str,
    segments: usize,
    /// Million photon segments a second: starts, with their shadow rays unless it is the table alone, rays,
    /// reflections.
    photon_segments_m_s: f64,
    /// Million closest hits a second of obvhs for the rays of the segments.
    obvhs_closest_m_s: f64,
    ratio: f64,
}

/// Direct light of point-like lights: at the corners of triangles, or the table of light elements.
#[derive(Clone, Serialize)]
struct DirectLight {
    scene: String,
    what: &'static str,
    /// Light elements, or triangles.
    parts: usize,
    shadow_rays: u64,
    seconds: f64,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    seed: u32,
    rows: &'a [Row],
    rates: &'a [Rate],
    direct_light: &'a [DirectLight],
}

/// Results of the scenes so far.
#[derive(Default)]
struct Measured {
    rows: Vec<Row>,
    rates: Vec<Rate>,
    direct_light: Vec<DirectLight>,
}

impl Measured {
    fn tables(&self) -> [Table; 3] {
        [table(&self.rows), direct_table(&self.direct_light), rate_table(&self.rates)]
    }

    fn markdown(&self) -> String {
        self.tables().map(|table| table.markdown()).join("\n")
    }
}

/// All that a scene gave.
struct Run {
    row: Row,
    estimate: Estimate,
    /// Shadow rays of the table of light elements.
    shadow_rays: u64,
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, .. } = Setup::new(common, args, "firstshot", &SCENES, &[])?;
    let mut measured = Measured::default();
    let results = |measured: &Measured| {
        let Measured { rows, rates, direct_light } = measured;
        output::json(&Results { name: "firstshot", machine: &machine, seed: common.seed, rows, rates, direct_light })
    };
    for scene in scenes {
        measure(common, args, scene, &mut measured)?;
        output::write_text(&out.join("summary.json"), &results(&measured))?;
        let section = section(&measured);
        for (plot, name) in section.plots.iter().zip(["error-photons.svg", "error-seconds.svg"]) {
            output::write_text(&out.join(name), &plot.svg())?;
        }
        let report = page("Patchlight: first shot", &introduction(&machine), [&section]);
        output::write_text(&out.join("report.html"), &report)?;
        output::write_text(&out.join("report.md"), &measured.markdown())?;
    }
    if common.json {
        say!("{}", results(&measured));
    } else {
        introduction(&machine).iter().for_each(|line| say!("{line}\n"));
        say!("{}", measured.markdown());
        say!("{} shows the same with curves", out.join("report.html").display());
    }
    Ok(())
}

fn introduction(machine: &Machine) -> Vec<String> {
    vec![
        format!("Measured on {}, {} threads.", machine.cpu, machine.threads),
        format!(
            "{LIGHTS} point and spot lights of equal power in the free air of each scene, textures on. The error is \
             that of the indirect irradiance of {COUNT} patches or about (cells of a voxel that face one way), √(Σ A \
             σ² / Σ A H²) by independent batches."
        ),
        "First shot starts reflected photons from light elements, the parts of triangles that lights fall on, with a \
         shadow ray each; by the table alone without. What is as printed is Kopylov's algorithm 1, Cardano's formula, \
         the brightest texel, and no shadow ray. Seconds are those of the table of light elements, and of tracing \
         with accumulation."
            .to_owned(),
    ]
}

fn measure(common: &Common, args: &Bench, name: &str, measured: &mut Measured) -> Result<(), Error> {
    let progress = Progress::new(common.quiet);
    let mut loaded = output::import_flat(name, &progress)?;
    loaded.scene.lighting.lights = lamps(&loaded);
    loaded.scene.lighting.sky = Sky::default();
    loaded.scene.emitters = Arc::default();
    let scene = &loaded.scene;
    let count = args.counts.first().copied().unwrap_or(COUNT) as usize;
    let maps = progress.phase("maps", |_| VoxelMaps::new(scene, count))?;

    measured.direct_light.push(direct_at_corners(&loaded));
    let mut reference: Option<Run> = None;
    let [ours, others @ ..] = first_shots();
    let both = [CLASSICAL, ours].into_iter().flat_map(|way| [(way, Sequences::Sobol), (way, Sequences::Random)]);
    for (way, sequences) in both.chain(others.into_iter().map(|way| (way, Sequences::Sobol))) {
        let mut run = one_run(common, args, &loaded, &maps, way, sequences, &progress)?;
        if let Some(reference) = &reference {
            let (difference, expected) = difference(&maps, &run.estimate, &reference.estimate);
            (run.row.difference, run.row.expected_difference) = (Some(difference), Some(expected));
        }
        measured.rows.push(run.row.clone());
        if way.first_shot.is_some() && sequences == Sequences::Sobol {
            let Row { scene, elements, table_s, .. } = run.row.clone();
            let what = way.name;
            let shadow_rays = run.shadow_rays;
            measured.direct_light.push(DirectLight { scene, what, parts: elements, shadow_rays, seconds: table_s });
        }
        if way.first_shot.is_none() && sequences == Sequences::Sobol {
            reference = Some(run);
        }
    }
    for way in [ours, others[0]] {
        measured.rates.push(progress.phase("rays", |_| rate(common, scene, &maps, way))?);
    }
    Ok(())
}

/// Direct light of the lights at the corners of the triangles.
fn direct_at_corners(loaded: &LoadedScene) -> DirectLight {
    let start = Instant::now();
    let light = corner_light(&loaded.scene);
    DirectLight {
        scene: loaded.name.clone(),
        what: "direct light at corners",
        parts: light.irradiance.len(),
        shadow_rays: light.shadow_rays,
        seconds: start.elapsed().as_secs_f64(),
    }
}

/// Illumination maps whose cells make patches: those of a voxel whose normals are nearest to the same direction of an
/// axis.
struct VoxelMaps {
    maps: IlluminationMaps,
    patches: Vec<u32>,
    areas: Vec<f32>,
}

impl VoxelMaps {
    /// Voxels with faces of the area that each of `count` patches would have.
    fn new(scene: &Scene, count: usize) -> Result<Self, Error> {
        let area: f32 = scene.geometry.triangles.iter().map(|t| 0.5 * t.edge_a.cross(t.edge_b).length()).sum();
        // Both sides are patches.
        let edge = scene::math::sqrt(2.0 * area / count as f32);
        let maps = IlluminationMaps::new(scene, edge / CELLS)?;
        let geometry = scene.tables();
        let mut numbers: BTreeMap<([i32; 3], usize), u32> = BTreeMap::new();
        let mut patches = Vec::with_capacity(maps.len());
        for t in 0..scene.geometry.triangles.len() as u32 {
            for is_back in [false, true] {
                let normal = geometry.normal(t) * if is_back { -1.0 } else { 1.0 };
                let sides = [normal.x, -normal.x, normal.y, -normal.y, normal.z, -normal.z];
                let side = (0..6).max_by(|&a, &b| sides[a].total_cmp(&sides[b])).unwrap_or(0);
                for (_, [a, b, c]) in maps.cells(t, is_back) {
                    let middle = (a + b + c) / 3.0;
                    let place = (geometry.position(t, middle.x, middle.y) - scene.geometry.bounds.0) / edge;
                    let next = numbers.len() as u32;
                    patches.push(*numbers.entry((place.floor().as_ivec3().to_array(), side)).or_insert(next));
                }
            }
        }
        let mut areas = vec![0.0; numbers.len()];
        patches.iter().zip(maps.areas()).for_each(|(&patch, area)| areas[patch as usize] += area);
        Ok(Self { maps, patches, areas })
    }

    /// Irradiance of the patches, W/m².
    fn means(&self, irradiance: &[Vec3]) -> Vec<Vec3> {
        let mut sums = vec![Vec3::ZERO; self.areas.len()];
        for ((&patch, light), area) in self.patches.iter().zip(irradiance).zip(self.maps.areas()) {
            sums[patch as usize] += *light * *area;
        }
        sums.iter().zip(&self.areas).map(|(sum, area)| *sum / area.max(f32::MIN_POSITIVE)).collect()
    }
}

impl PhotonAccumulator for VoxelMaps {
    fn areas(&self) -> &[f32] {
        self.maps.areas()
    }

    fn cell(&self, triangle: u32, u: f32, v: f32, is_back: bool) -> u32 {
        self.maps.cell(triangle, u, v, is_back)
    }

    fn groups(&self) -> &[u32] {
        &self.patches
    }
}

/// Lamps in the free air round the eye: on the way from it to what rays in all directions meet.
fn lamps(loaded: &LoadedScene) -> Vec<Light> {
    let scene = &loaded.scene;
    let eye = loaded.view.eye;
    let mut lamps: Vec<Light> = Vec::new();
    let mut number = 0;
    while lamps.len() < LIGHTS as usize && number < 64 * LIGHTS {
        let (x, y) = hammersley(number * 7 % (64 * LIGHTS), 64 * LIGHTS, (hash3(1, 0, 0), hash3(2, 0, 0)));
        number += 1;
        let (s, c) = sin_cos_2pi(x);
        let z = 1.0 - 2.0 * y;
        let r = (1.0 - z * z).max(0.0).sqrt();
        let direction = Vec3::new(r * s, z, r * c);
        let hit = scene.closest_before(eye, direction, FAR);
        if hit.is_miss() || hit.t < 1e-2 * scene.diagonal() {
            continue;
        }
        let position = eye + direction * (0.75 * hit.t);
        if lamps.iter().any(|l| l.position.distance(position) < 0.03 * scene.diagonal()) {
            continue;
        }
        let color = Vec3::new(1.0, 0.8 + 0.2 * y, 0.5 + 0.5 * x);
        let lamp = Light { kind: LIGHT_POINT, position, color, direction: Vec3::NEG_Y, ..Light::default() };
        let is_spot = lamps.len() % 3 == 2;
        // About a fourth of all directions: four times the intensity.
        let spot = Light { kind: LIGHT_SPOT, color: color * 4.0, cos_inner: 0.7, cos_outer: 0.4, ..lamp };
        lamps.push(if is_spot { spot } else { lamp });
    }
    lamps
}

fn one_run(
    common: &Common,
    args: &Bench,
    loaded: &LoadedScene,
    maps: &VoxelMaps,
    way: Way,
    sequences: Sequences,
    progress: &Progress,
) -> Result<Run, Error> {
    let scene = &loaded.scene;
    let start = Instant::now();
    let emission = emission(scene, way)?;
    let table_s = start.elapsed().as_secs_f64();
    let settings = PhotonSettings {
        error: args.error * BEYOND,
        most_photons: args.photons,
        sequences,
        ..way.first_shot.unwrap_or_default().photons(common.seed)
    };
    let mut tracer = Tracer::new(scene, &emission, maps, PhotonSettings { error: args.error, ..settings })?;
    let curve = Curve::default();
    // To the error that is asked for, which is timed, then on.
    let start = Instant::now();
    let finished = progress.phase(way.name, |report| tracer.run(&|round| curve.add(round, args.error, report)));
    let trace_s = start.elapsed().as_secs_f64();
    let reached = tracer.round();
    tracer.set_error(settings.error)?;
    let is_done =
        finished && progress.phase("on", |report| tracer.run(&|round| curve.add(round, settings.error, report)));
    if !is_done {
        return Err(shell::Error::Cancelled.into());
    }
    let row = Row {
        scene: loaded.name.clone(),
        triangles: scene.geometry.triangles.len(),
        method: way.name,
        sequence: if sequences == Sequences::Sobol { "Sobol" } else { "random" },
        error: reached.error,
        photons: reached.photons,
        registered: reached.registered,
        segments: reached.segments,
        elements: emission.elements.len(),
        table_s,
        trace_s,
        difference: None,
        expected_difference: None,
        curve: curve.points.into_inner(),
    };
    Ok(Run { row, estimate: tracer.estimate(), shadow_rays: emission.shadow_rays })
}

/// Photons and relative error after each round.
#[derive(Default)]
struct Curve {
    points: RefCell<Vec<(f64, f64)>>,
}

impl Curve {
    /// Adds a round, and tells how near the error is to the goal.
    fn add(&self, round: &Round, goal: f64, report: &Steps) -> ControlFlow<()> {
        self.points.borrow_mut().push((round.photons as f64, round.error));
        let share = (goal / round.error).powi(2).min(1.0);
        report((1000.0 * share) as usize, 1000)
    }
}

fn emission(scene: &Scene, way: Way) -> Result<Emission, Error> {
    let until_cancelled = |_, _| if is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    Ok(match way.first_shot {
        None => Emission::classical(scene)?,
        Some(settings) => settings.emission(scene, &until_cancelled)?,
    })
}

/// Relative difference of the patches' irradiance (L2 by area), and what the errors of both let expect.
fn difference(maps: &VoxelMaps, ours: &Estimate, theirs: &Estimate) -> (f64, f64) {
    let mut wrong = 0.0;
    let mut all = 0.0;
    for ((a, b), area) in maps.means(&ours.irradiance).iter().zip(maps.means(&theirs.irradiance)).zip(&maps.areas) {
        let area = f64::from(*area);
        let a = f64::from(luminance(*a));
        let b = f64::from(luminance(b));
        wrong += area * (a - b).powi(2);
        all += area * b * b;
    }
    ((wrong / all).sqrt(), ours.round.error.hypot(theirs.round.error))
}

/// Segments of photons against closest hits of obvhs for the same rays, on all cores.
fn rate(common: &Common, scene: &Scene, maps: &VoxelMaps, way: Way) -> Result<Rate, Error> {
    let emission = emission(scene, way)?;
    let settings = PhotonSettings { seed: common.seed, ..PhotonSettings::default() };
    let batches = settings.batches;
    let p = Tracer::new(scene, &emission, maps, settings)?.params(RATE_PHOTONS / batches);
    let rays = photon_rays(scene, &emission, &p);
    let boxes: Vec<_> = scene
        .geometry
        .triangles
        .iter()
        .map(|t| obvhs::triangle::Triangle {
            v0: t.corner.into(),
            v1: (t.corner + t.edge_a).into(),
            v2: (t.corner + t.edge_b).into(),
        })
        .collect();
    // As the scene's own hierarchy is built.
    let build = BvhBuildParams { pre_split: false, search_depth_threshold: 0, ..BvhBuildParams::medium_build() };
    let bvh: CwBvh = build_cwbvh_from_tris(&boxes, build, &mut Duration::default());
    let triangles: Vec<RtTriangle> =
        bvh.primitive_indices.iter().map(|&k| RtTriangle::from(&boxes[k as usize])).collect();
    let closest = |(origin, direction): &(Vec3, Vec3)| {
        let mut hit = RayHit::none();
        let ray = obvhs::ray::Ray::new((*origin).into(), (*direction).into(), 0.0, FAR);
        bvh.ray_traverse(ray, &mut hit, |r, k| triangles[k].intersect(r));
        hit.t < FAR
    };
    let mut ours = f64::INFINITY;
    let mut theirs = f64::INFINITY;
    let mut segments = 0usize;
    let own = PhotonScene::new(scene, &emission);
    for _ in 0..RATE_ROUNDS {
        let start = Instant::now();
        segments = trace_photons(&own, &p, || 0, |count, _| *count += 1).into_iter().sum();
        ours = ours.min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        std::hint::black_box(rays.par_iter().with_min_len(1024).filter(|ray| closest(ray)).count());
        theirs = theirs.min(start.elapsed().as_secs_f64());
    }
    let ours = segments as f64 / ours * 1e-6;
    let theirs = rays.len() as f64 / theirs * 1e-6;
    let scene = format!("{} triangles", scene.geometry.triangles.len());
    Ok(Rate {
        scene,
        method: way.name,
        segments,
        photon_segments_m_s: ours,
        obvhs_closest_m_s: theirs,
        ratio: ours / theirs,
    })
}

/// The rays of all segments, photon by photon.
fn photon_rays(scene: &Scene, emission: &Emission, p: &PhotonParams) -> Vec<(Vec3, Vec3)> {
    let geometry = scene.tables();
    let sources = Sources::of(&scene.all_lights());
    let occluded = |origin: Vec3, direction: Vec3, t_max: f32| scene.occluded(origin, direction, t_max);
    let path = |k: u32| {
        let mut rays = Vec::new();
        let mut photon = start_photon(&geometry, &sources, p, &emission.alias, &emission.elements, k, occluded);
        while photon.flux != Vec3::ZERO {
            rays.push((photon.origin, photon.direction));
            let hit = scene.closest_before(photon.origin, photon.direction, FAR);
            photon = reflect(&geometry, p, k, &photon, hit);
        }
        rays
    };
    (0..p.count).into_par_iter().flat_map_iter(path).collect()
}

fn section(measured: &Measured) -> Section {
    let rows = &measured.rows;
    let plot = |title: &str, x: &str, value: &dyn Fn(&Row, f64) -> f64| Plot {
        title: title.to_owned(),
        unit: "error, %".to_owned(),
        x: x.to_owned(),
        logarithmic: true,
        series: rows
            .iter()
            .map(|row| Series {
                name: format!("{}, {} triangles, {}", row.method, row.triangles, row.sequence),
                points: row
                    .curve
                    .iter()
                    .filter(|(_, error)| error.is_finite())
                    .map(|&(n, e)| (value(row, n), 100.0 * e))
                    .collect(),
            })
            .collect(),
    };
    Section {
        title: "Photons to an error".to_owned(),
        tables: measured.tables().to_vec(),
        plots: vec![
            plot("Error over photons", "photons", &|_, n| n),
            plot("Error over time, the table of light elements included", "seconds", &|row, n| {
                row.table_s + row.trace_s * n / row.photons.max(1) as f64
            }),
        ],
        ..Section::default()
    }
}

/// Runs, and how many times less than photons from the lights with the same numbers they take.
fn table(rows: &[Row]) -> Table {
    let head = [
        "scene",
        "photons start",
        "numbers",
        "triangles",
        "elements",
        "error %",
        "photons",
        "registered",
        "table s",
        "tracing s",
        "photons ÷",
        "tracing ÷",
        "time ÷",
        "difference / expected %",
    ];
    let line = |row: &Row| {
        let same = |r: &&Row| (&r.scene, r.sequence, r.triangles) == (&row.scene, row.sequence, row.triangles);
        let lights = rows.iter().filter(same).find(|r| r.method == CLASSICAL.name);
        let gain = |of: &dyn Fn(&Row) -> f64| {
            lights.filter(|r| r.method != row.method).map(|r| format!("{:.2}", of(r) / of(row))).unwrap_or_default()
        };
        let both = row.difference.zip(row.expected_difference);
        vec![
            row.scene.clone(),
            row.method.to_owned(),
            row.sequence.to_owned(),
            row.triangles.to_string(),
            row.elements.to_string(),
            format!("{:.2}", 100.0 * row.error),
            row.photons.to_string(),
            row.registered.to_string(),
            significant(row.table_s),
            significant(row.trace_s),
            gain(&|r| r.photons as f64),
            gain(&|r| r.trace_s),
            gain(&|r| r.table_s + r.trace_s),
            both.map(|(found, expected)| format!("{:.2} / {:.2}", 100.0 * found, 100.0 * expected)).unwrap_or_default(),
        ]
    };
    let caption = "Photons, photon hits and time to the error; how many times less than from the lights; the \
                   difference to photons from the lights with Sobol's points at the end of the curves, and what both \
                   errors let expect."
        .to_owned();
    Table { caption, head: head.map(str::to_owned).to_vec(), rows: rows.iter().map(line).collect() }
}

/// Shadow rays and time of the tables, and of direct light at corners.
fn direct_table(all: &[DirectLight]) -> Table {
    let head = ["scene", "direct light", "parts", "shadow rays", "s", "rays ×", "time ×"];
    let line = |found: &DirectLight| {
        let corners = all.iter().rfind(|d| d.scene == found.scene && d.what == "direct light at corners");
        let over = |of: &dyn Fn(&DirectLight) -> f64| {
            corners.map(|corners| format!("{:.2}", of(found) / of(corners))).unwrap_or_default()
        };
        vec![
            found.scene.clone(),
            found.what.to_owned(),
            found.parts.to_string(),
            found.shadow_rays.to_string(),
            significant(found.seconds),
            over(&|d| d.shadow_rays as f64),
            over(&|d| d.seconds),
        ]
    };
    let caption = "Direct light of the lamps at the corners of all triangles, and the tables of light elements: \
                   shadow rays, seconds, and how many times those at corners."
        .to_owned();
    Table { caption, head: head.map(str::to_owned).to_vec(), rows: all.iter().map(line).collect() }
}

fn rate_table(rates: &[Rate]) -> Table {
    let head = ["scene", "photons start", "segments", "photon segments, M/s", "obvhs closest hits, M/s", "ratio"];
    let line = |r: &Rate| {
        vec![
            r.scene.clone(),
            r.method.to_owned(),
            r.segments.to_string(),
            format!("{:.2}", r.photon_segments_m_s),
            format!("{:.2}", r.obvhs_closest_m_s),
            format!("{:.2}", r.ratio),
        ]
    };
    let caption =
        "Segments of photons, with starts, shadow rays and reflections, against obvhs (CWBVH) for the same rays"
            .to_owned();
    Table { caption, head: head.map(str::to_owned).to_vec(), rows: rates.iter().map(line).collect() }
}
