//! `bench scaling`: time of a light update and memory of every kind of method over patches, receivers, triangles,
//! lights and pixels, one at a time.

use glam::Vec3;
use scene::gpu::LIGHT_POINT;
use scene::math::sin_cos_2pi;
use scene::sampling::{hash3, unit};
use scene::{Light, Lighting};
use serde::{Deserialize, Serialize};

use super::contest::field::{Contenders, Field, PatchMethod};
use super::contest::{UpdateTimes, View, Who, lightings_of, take_turns};
use super::setup::bake_settings;
use super::study::{Measured, Place, SceneRows, Study};
use crate::args::Bench;
use crate::error::Error;
use crate::output;
use crate::report::{Plot, Section, Series, Table, significant};
use assets::import::LoadedScene;
use patches::MAX_PATCHES;
use patchlight::BakeSettings;
use patchlight::light::with_lights;

/// Patches of the axis over them, unless some are asked for.
const COUNTS: [u32; 5] = [512, 2048, 8192, 65_535, 262_144];
/// Matrices of more bytes are not made here: the time of all experiments has its bound.
const MAX_BYTES: f64 = 2e9;
/// Patches beyond which there are no more receivers: as many fewer for each patch as there are more patches.
const MAX_RECEIVERS_OF: f32 = 4096.0;
/// Scenes of the axis over triangles.
const SCENES: [&str; 3] = ["atrium:10000", "atrium:50000", "atrium:250000"];
/// Scenes at the smallest setting.
const SMALL_SCENES: [&str; 2] = ["atrium:3000", "atrium:6000"];
/// Lamps of the axis over lights.
const LAMPS: [u32; 4] = [1, 4, 16, 64];
/// Lines of the pictures of the axis over pixels; twice as many pixels in a line, about.
const LINES: [u32; 4] = [68, 135, 270, 540];
/// The lamps stand in this middle part of the scene, and move by this part of it in a frame.
const INNER: f32 = 0.8;
const STEP: f32 = 0.01;

/// Quantity along one of the axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    Patches,
    Receivers,
    Triangles,
    Lights,
    Pixels,
}

impl Axis {
    const ALL: [Self; 5] = [Self::Patches, Self::Receivers, Self::Triangles, Self::Lights, Self::Pixels];

    fn name(self) -> &'static str {
        match self {
            Self::Patches => "patches",
            Self::Receivers => "receivers",
            Self::Triangles => "triangles",
            Self::Lights => "lights",
            Self::Pixels => "pixels",
        }
    }
}

/// A point of an axis.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    pub axis: Axis,
    /// So many of them.
    pub value: u64,
    #[serde(flatten)]
    pub who: Who,
    #[serde(flatten)]
    pub times: Option<UpdateTimes>,
    /// Why there are no times.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub missing: Option<String>,
}

impl Row {
    fn missing(axis: Axis, value: u64, method: &str, why: String) -> Self {
        let name = method.to_owned();
        let size = format!("{value} {}", axis.name());
        let who = Who { family: name.clone(), method: name, size, build_s: 0.0, bytes: 0, operator_bytes: None };
        Self { axis, value, who, times: None, missing: Some(why) }
    }

    /// Processor time from lights that moved to irradiance at what is seen, ms.
    fn milliseconds(&self) -> Option<f64> {
        let times = self.times?;
        Some(times.processor.median_ms + times.processor_lookup_ms.unwrap_or(0.0))
    }
}

/// The experiment.
pub struct Scaling;

impl Study for Scaling {
    type Row = Row;
    const NAME: &'static str = "scaling";
    const TITLE: &'static str = "How light updates grow";
    const ABOUT: &'static str = "Processor time of a whole light update with the lookup of all pixels where that can \
        be told apart, and memory, over one size at a time: patches and receivers (methods that have them), triangles \
        (of the atrium), lamps that all move, and pixels. Receivers are updated where they are in view; beyond 4,096 \
        patches their number stays. Turns as in the first experiment. Matrices of more than 2 GB are not made: in \
        place of a time stands what they would take. A bake has 65,535 patches at most, whose numbers take 16 bits in \
        rows of form factors; worlds of more are baked in parts, and lit round the camera.";
    const SCENES: &'static [&'static str] = &["office"];
    const PATCHES: u32 = 1000;
    const TIMED: bool = true;

    fn measure(place: &Place, loaded: &LoadedScene) -> Result<Measured<Row>, Error> {
        let Place { common, args, .. } = *place;
        let counts = match (&args.counts[..], args.quick) {
            ([], _) => COUNTS.to_vec(),
            (counts, true) => counts.iter().flat_map(|&count| [count, 2 * count]).collect(),
            (counts, false) => counts.to_vec(),
        };
        let mut rows = Vec::new();
        for count in counts {
            rows.extend(over_patches(place, loaded, count as usize)?);
        }
        let settings = bake_settings(common, args, loaded, place.patches);
        for &receiver_density in &args.densities {
            let settings = settings.with_receiver_density(receiver_density);
            rows.extend(over_receivers(place, loaded, &settings)?);
        }
        let scenes = if args.quick { &SMALL_SCENES[..] } else { &SCENES };
        for spec in scenes {
            let other = output::import_flat(spec, place.progress)?;
            rows.extend(over_triangles(place, &other)?);
        }
        rows.extend(over_lights(place, loaded)?);
        rows.extend(over_pixels(place, loaded)?);
        Ok(Measured::of(rows))
    }

    fn sections(scenes: &[SceneRows<Row>]) -> Vec<Section> {
        let of_scene = |scene: &SceneRows<Row>| {
            let plots = Axis::ALL.into_iter().filter_map(|axis| time_plot(&scene.rows, axis));
            Section {
                title: scene.scene.clone(),
                tables: Axis::ALL.into_iter().filter_map(|axis| table(&scene.rows, axis)).collect(),
                plots: plots.collect(),
                ..Section::default()
            }
        };
        scenes.iter().map(of_scene).collect()
    }
}

/// Rows of contenders under moving lights.
fn rows(
    place: &Place,
    contenders: &mut Contenders,
    (axis, value): (Axis, u64),
    lightings: &[Lighting],
) -> Result<Vec<Row>, Error> {
    let times = take_turns(contenders, lightings, place.progress)?;
    let row =
        |(contender, times): (_, _)| Row { axis, value, who: Who::of(contender), times: Some(times), missing: None };
    let rows: Vec<Row> = contenders.iter().map(|contender| contender.as_ref()).zip(times).map(row).collect();
    for row in &rows {
        place.progress.note(&format!(
            "{value} {}: {}: {} ms",
            axis.name(),
            row.who.family,
            row.milliseconds().map_or_else(String::new, significant)
        ));
    }
    Ok(rows)
}

/// Methods that have patches; what needs matrices that are not made says how large they would be.
fn over_patches(place: &Place, loaded: &LoadedScene, count: usize) -> Result<Vec<Row>, Error> {
    let methods = [&PatchMethod::usual(count, place.common.seed)[..], &PatchMethod::dense()].concat();
    let too_large = |method: &PatchMethod| {
        let bytes = method.matrix_bytes(count);
        (bytes > MAX_BYTES).then(|| format!("matrix of {} GB", significant(1e-9 * bytes)))
    };
    let why = |method: &PatchMethod| {
        too_large(method).or_else(|| (count > MAX_PATCHES).then(|| format!("{MAX_PATCHES} at most")))
    };
    let (possible, impossible): (Vec<PatchMethod>, _) = methods.into_iter().partition(|method| why(method).is_none());
    let mut found = Vec::new();
    let mut value = count as u64;
    if !possible.is_empty() {
        let receiver_density = (MAX_RECEIVERS_OF / count as f32).min(1.0);
        let settings = (bake_settings(place.common, place.args, loaded, count)).with_receiver_density(receiver_density);
        let view = View::new(place.common, place.args, loaded);
        let field = Field::new(&view, &settings, place.progress)?;
        value = field.bake().mesh().patches.len() as u64;
        let lightings = view.moving(lightings_of(place.args.frames()));
        found = rows(place, &mut field.with_patches(&possible)?, (Axis::Patches, value), &lightings)?;
    }
    found.extend(
        impossible.iter().filter_map(|method| Some(Row::missing(Axis::Patches, value, method.name, why(method)?))),
    );
    Ok(found)
}

/// Methods that have patches, with the receivers of the settings.
fn over_receivers(place: &Place, loaded: &LoadedScene, settings: &BakeSettings) -> Result<Vec<Row>, Error> {
    let view = View::new(place.common, place.args, loaded);
    let field = Field::new(&view, settings, place.progress)?;
    let value = field.bake().receivers().points.len() as u64;
    let lightings = view.moving(lightings_of(place.args.frames()));
    rows(place, &mut field.patches()?, (Axis::Receivers, value), &lightings)
}

fn over_triangles(place: &Place, loaded: &LoadedScene) -> Result<Vec<Row>, Error> {
    let view = View::new(place.common, place.args, loaded);
    let settings = bake_settings(place.common, place.args, loaded, place.patches);
    let field = Field::new(&view, &settings, place.progress)?;
    let value = loaded.scene.geometry.triangles.len() as u64;
    let lightings = view.moving(lightings_of(place.args.frames()));
    rows(place, &mut field.one_of_each()?, (Axis::Triangles, value), &lightings)
}

fn over_lights(place: &Place, loaded: &LoadedScene) -> Result<Vec<Row>, Error> {
    let view = View::new(place.common, place.args, loaded);
    let settings = bake_settings(place.common, place.args, loaded, place.patches);
    let field = Field::new(&view, &settings, place.progress)?;
    let frames = lightings_of(place.args.frames());
    let mut contenders = field.one_of_each()?;
    let mut found = Vec::new();
    for &lamps in if place.args.quick { &LAMPS[..2] } else { &LAMPS[..] } {
        let lightings: Vec<Lighting> = (0..frames).map(|number| lamps_of(loaded, lamps, number, frames)).collect();
        found.extend(rows(place, &mut contenders, (Axis::Lights, u64::from(lamps)), &lightings)?);
    }
    Ok(found)
}

fn over_pixels(place: &Place, loaded: &LoadedScene) -> Result<Vec<Row>, Error> {
    let mut found = Vec::new();
    let lines = if place.args.quick { &LINES[..2] } else { &LINES };
    let settings = bake_settings(place.common, place.args, loaded, place.patches);
    let whole = View::new(place.common, place.args, loaded);
    let baked = Field::new(&whole, &settings, place.progress)?;
    for &height in lines {
        let args = Bench { size: Some((height * 16 / 9, height)), ..place.args.clone() };
        let view = View::new(place.common, &args, loaded);
        let field = Field::of_bake(&view, baked.bake(), place.progress);
        let value = u64::from(view.camera.width) * u64::from(view.camera.height);
        let lightings = view.moving(lightings_of(args.frames()));
        found.extend(rows(place, &mut field.one_of_each()?, (Axis::Pixels, value), &lightings)?);
    }
    Ok(found)
}

/// Point lamps all over the scene that go round in circles, as bright together as one of 1 kW/sr.
fn lamps_of(loaded: &LoadedScene, count: u32, number: u32, frames: u32) -> Lighting {
    let (low, high) = loaded.scene.geometry.bounds;
    let middle = (low + high) * 0.5;
    let half = (high - low) * (0.5 * INNER);
    let lamp = |k: u32| {
        let place = Vec3::from_array([0, 1, 2].map(|axis| 2.0 * unit(hash3(k, axis, 0x6c61_6d70)) - 1.0));
        let (sin, cos) = sin_cos_2pi(number as f32 / frames as f32);
        let way = Vec3::new(cos, 0.0, sin) * STEP;
        let color = Vec3::splat(1e3 / count as f32);
        Light { position: middle + (place + way) * half, kind: LIGHT_POINT, color, ..Light::default() }
    };
    with_lights(&loaded.scene, &(0..count).map(lamp).collect::<Vec<_>>())
}

/// Kinds of methods and sizes of an axis, in their order.
fn of_axis(rows: &[Row], axis: Axis) -> (Vec<&str>, Vec<u64>) {
    let mut families: Vec<&str> = Vec::new();
    let mut values: Vec<u64> = Vec::new();
    for row in rows.iter().filter(|row| row.axis == axis) {
        if !families.contains(&row.who.family.as_str()) {
            families.push(&row.who.family);
        }
        if !values.contains(&row.value) {
            values.push(row.value);
        }
    }
    (families, values)
}

fn point<'a>(rows: &'a [Row], axis: Axis, family: &str, value: u64) -> Option<&'a Row> {
    rows.iter().find(|row| row.axis == axis && row.who.family == family && row.value == value)
}

/// Time and memory of each kind of method at each size.
fn table(rows: &[Row], axis: Axis) -> Option<Table> {
    let (families, values) = of_axis(rows, axis);
    let line = |family: &&str| {
        std::iter::once((*family).to_owned())
            .chain(values.iter().map(|value| {
                let text = |row: &Row| match row.milliseconds() {
                    Some(ms) => format!("{} / {}", significant(ms), significant(row.who.megabytes())),
                    None => row.missing.clone().unwrap_or_default(),
                };
                point(rows, axis, family, *value).map_or_else(|| "–".to_owned(), text)
            }))
            .collect()
    };
    let head = std::iter::once(format!("method, over {}", axis.name())).chain(values.iter().map(u64::to_string));
    (!families.is_empty()).then(|| Table {
        caption: format!("Over {}: ms of processor time / MB", axis.name()),
        head: head.collect(),
        rows: families.iter().map(line).collect(),
    })
}

fn time_plot(rows: &[Row], axis: Axis) -> Option<Plot> {
    let (families, values) = of_axis(rows, axis);
    let line = |family: &&str| Series {
        name: (*family).to_owned(),
        points: values
            .iter()
            .filter_map(|&value| Some((value as f64, point(rows, axis, family, value)?.milliseconds()?.max(1e-3))))
            .collect(),
    };
    (!families.is_empty()).then(|| Plot {
        title: format!("A light update over {}", axis.name()),
        unit: "ms of processor time".into(),
        x: axis.name().into(),
        logarithmic: true,
        series: families.iter().map(line).collect(),
    })
}
