//! Section 6.4: sampled light lags behind its lamps. For those that move and reach not far the thesis names small
//! matrices of their own; here beside it, for a lamp that is carried through the scene.

use std::sync::Arc;

use cpu_time::ProcessTime;
use glam::{Vec3, Vec4};
use multibounce::Channels;
use scene::gpu::LIGHT_POINT;
use scene::{Light, Lighting, Scene, Sky};
use serde::Serialize;
use temporal::{Distribution, Settings, State};

use super::local::{Flight, Places};
use super::matrix::Subject;
use super::tables::{SAMPLES, WEIGHT, changes, printed, sampled_rows};
use super::{Outcome, Study};
use crate::args::CameraPath;
use crate::error::Error;
use crate::measure::own_light;
use crate::progress::is_cancelled;
use crate::report::{Plot, Series, Table, significant};
use crate::sequence::distance;
use shell::operator_error::exact_product;

/// Patches in small matrices, and how many may enter in a frame.
const SLOTS: [usize; 3] = [64, 256, 512];
const BUDGET: usize = 32;
/// Frames, and the part of the camera's path along which the lamp is carried in them.
const FRAMES: u32 = 48;
const SHARE: f32 = 0.25;
/// Frames before the first that counts, in which all sampled light arrives.
const BEFORE: u32 = 64;
/// Intensity of the lamp, W/sr. All errors are relative.
const INTENSITY: f32 = 1.0;
/// Reach of a lamp, in diagonals of the scene: its light is 0 from there on.
const REACH: f32 = 0.2;

/// A way to find the lamp's light.
#[derive(Serialize)]
struct Row {
    patches: usize,
    way: String,
    /// Work of a frame, on average: multiplications of all channels, processor milliseconds.
    multiplications: f64,
    ms: f64,
    /// Relative L2 distance from the light of all bounces between all patches: median of the frames, greatest.
    error: f64,
    worst: f64,
    #[serde(skip)]
    errors: Vec<f64>,
}

impl Row {
    fn new(patches: usize, way: String, work: (u64, f64), errors: Vec<f64>) -> Self {
        let mut ordered = errors.clone();
        ordered.sort_by(f64::total_cmp);
        Self {
            patches,
            way,
            multiplications: work.0 as f64 / f64::from(FRAMES),
            ms: 1e3 * work.1 / f64::from(FRAMES),
            error: ordered[ordered.len() / 2],
            worst: ordered[ordered.len() - 1],
            errors,
        }
    }
}

/// Frames of the lamp: where it is, its first exitance, and the light of all bounces.
struct Carried {
    place: Vec<Vec3>,
    source: Vec<Vec<Vec4>>,
    exact: Vec<Vec<Vec3>>,
}

/// Errors and work of each way.
pub(super) fn moving(study: &Study) -> Result<Outcome, Error> {
    let mut rows: Vec<Row> = Vec::new();
    for &count in &study.counts {
        let subject = Subject::new(study, count)?;
        let carried = carry(study, &subject)?;
        rows.extend(sampled(study, &subject, &carried)?);
        for slots in SLOTS.into_iter().filter(|&slots| slots < subject.factors.area.len()) {
            rows.extend(small(&subject, &carried, slots)?);
        }
    }
    let last = rows.last().map_or(0, |row| row.patches);
    let series = |row: &Row| {
        let points = row.errors.iter().enumerate().map(|(frame, error)| (frame as f64, 100.0 * error));
        Series { name: row.way.clone(), points: points.collect() }
    };
    let plot = Plot {
        title: "Distance from the light of all bounces".into(),
        unit: "%".into(),
        x: "frame".into(),
        logarithmic: true,
        series: rows.iter().filter(|row| row.patches == last).map(series).collect(),
    };
    Ok(Outcome {
        rows: serde_json::to_value(&rows).unwrap_or_default(),
        tables: vec![table(&rows)],
        plots: vec![("distance", plot)],
    })
}

/// The lamp's light in each frame, without any other.
fn carry(study: &Study, subject: &Subject) -> Result<Carried, Error> {
    let scene = &study.loaded.scene;
    let operators = subject.operators(None, study)?;
    let path = CameraPath::Fly.animation(study.loaded);
    let mut carried = Carried { place: Vec::new(), source: Vec::new(), exact: Vec::new() };
    for frame in 0..FRAMES {
        let share = SHARE * frame as f32 / (FRAMES - 1) as f32;
        let position = path.at(path.duration() * share).1.eye;
        let lamp = Light { kind: LIGHT_POINT, position, color: Vec3::splat(INTENSITY), ..Light::default() };
        let lighting = Lighting {
            lights: vec![lamp],
            sky: Sky::default(),
            sky_map: Arc::default(),
            emission: vec![Vec3::ZERO; scene.materials.len()],
            ..scene.lighting.clone()
        };
        let lit = Scene::under(Arc::clone(&scene.geometry), lighting).map_err(patchlight::Error::from)?;
        let mut source = own_light(&lit, subject.bake.mesh(), 1, study.common.seed);
        for (patch, e) in subject.bake.mesh().patches.iter().zip(&mut source) {
            *e *= within(patch.centroid.distance(position) / (REACH * scene.diagonal()));
        }
        let exact = exact_product(Channels::Three(operators.each_ref()), &subject.factors.area, &source);
        carried.place.push(position);
        carried.source.push(source);
        carried.exact.push(truncated(&exact));
        if is_cancelled() {
            return Err(shell::Error::Cancelled.into());
        }
    }
    Ok(carried)
}

/// Share of a lamp's light at a distance in shares of its reach: it ends there smoothly, as in games (Karis 2013).
fn within(distance: f32) -> f32 {
    (1.0 - distance.powi(4)).max(0.0).powi(2)
}

/// By samples of all rows: with a fixed weight of the frames before, and of the change of the light.
fn sampled(study: &Study, subject: &Subject, carried: &Carried) -> Result<Vec<Row>, Error> {
    let (tables, lists) = sampled_rows(&subject.bake.form_factors().factors)?;
    let seed = study.common.seed;
    Ok(vec![
        sample(subject, carried, format!("{SAMPLES} samples a row, w {WEIGHT}, as printed"), &tables, &printed(seed))?,
        sample(subject, carried, format!("{SAMPLES} samples of the change a row, ours"), &lists, &changes(seed))?,
    ])
}

fn sample(
    subject: &Subject,
    carried: &Carried,
    way: String,
    rows: &impl Distribution,
    settings: &Settings,
) -> Result<Row, Error> {
    let albedo = &subject.bake.mesh().albedo;
    let mut state = State::new(albedo.len());
    let mut errors = Vec::new();
    let advance = |state: &mut State, source: &[Vec4]| {
        state.advance(rows, source, albedo, settings).map_err(patchlight::Error::from)
    };
    for _ in 0..BEFORE {
        advance(&mut state, &carried.source[0])?;
    }
    let mut seconds = 0.0;
    for (source, exact) in carried.source.iter().zip(&carried.exact) {
        let start = ProcessTime::now();
        advance(&mut state, source)?;
        seconds += start.elapsed().as_secs_f64();
        errors.push(distance(&truncated(&state.irradiance), exact));
    }
    let work = 3 * u64::from(FRAMES * SAMPLES) * albedo.len() as u64;
    Ok(Row::new(albedo.len(), way, (work, seconds), errors))
}

/// By the matrix of the patches nearest to the lamp, as printed and ours.
fn small(subject: &Subject, carried: &Carried, slots: usize) -> Result<[Row; 2], Error> {
    let patches = subject.factors.area.len();
    let mut flight = Flight::new(subject, slots)?;
    let mut printed = (0, 0.0, Vec::new());
    let mut exact = (0, 0.0, Vec::new());
    for (frame, &place) in carried.place.iter().enumerate() {
        let change = flight.change(place, if frame == 0 { flight.slots } else { BUDGET })?;
        let seen: Vec<u32> = flight.there.iter().copied().collect();
        let lit = flight.lit(&carried.source[frame]);
        let products = flight.products(&Places { seen: &seen, lit: &lit, light: &carried.source[frame] })?;
        let product = 3 * (seen.len() * lit.len()) as u64;
        for (total, changed, found) in
            [(&mut printed, change.printed, products.0), (&mut exact, change.exact, products.1)]
        {
            // The first frame makes all ready.
            let (changes, change_s) = if frame == 0 { (0, 0.0) } else { changed };
            total.0 += changes + product;
            total.1 += change_s + found.seconds;
            // Patches that are not in the matrix have none of this light.
            let mut light = vec![Vec3::ZERO; patches];
            seen.iter().zip(&found.light).for_each(|(&patch, h)| light[patch as usize] = h.truncate());
            total.2.push(distance(&light, &carried.exact[frame]));
        }
        if is_cancelled() {
            return Err(shell::Error::Cancelled.into());
        }
    }
    let name = |whose: &str| format!("the nearest {slots} patches, {whose}");
    Ok([
        Row::new(patches, name("as printed"), (printed.0, printed.1), printed.2),
        Row::new(patches, name("ours"), (exact.0, exact.1), exact.2),
    ])
}

fn truncated(light: &[Vec4]) -> Vec<Vec3> {
    light.iter().map(|h| h.truncate()).collect()
}

fn table(rows: &[Row]) -> Table {
    let cells = |row: &Row| {
        vec![
            row.patches.to_string(),
            row.way.clone(),
            significant(row.multiplications * 1e-6),
            significant(row.ms),
            format!("{} %", significant(100.0 * row.error)),
            format!("{} %", significant(100.0 * row.worst)),
        ]
    };
    let heads = ["patches", "way", "millions of multiplications", "processor ms", "distance", "greatest"];
    Table {
        caption: format!(
            "A frame of {FRAMES} in which a lamp that reaches {REACH} diagonals far is carried through the scene. \
             Distances are relative L2 of the irradiance of all patches from that of all bounces between all of them; \
             small matrices leave the others without light."
        ),
        head: heads.map(str::to_owned).to_vec(),
        rows: rows.iter().map(cells).collect(),
    }
}
