//! `bench step`: how fast light follows a jump of the lights, and how still it is at rest, for every kind of method.

use reference::metrics::noise_share;
use reference::stops_to_scale;
use serde::{Deserialize, Serialize};

use super::contest::contender::Contender;
use super::contest::field::Field;
use super::contest::{REST, View, Who, cancelled, followed_after, left_of_jump, rest_of};
use super::setup::bake_settings;
use super::study::{Measured, Place, SceneRows, Study};
use crate::error::Error;
use crate::report::{Plot, Section, Series, Table};
use crate::sequence::distance;
use assets::import::LoadedScene;

/// Frames with other lights before they jump to the scene's own, as a share of those after it.
const AWAY: u32 = 3;
/// Light of frames without memory after the jump: two tell its noise.
const FORGETFUL: u32 = 2;

/// Response of a method to changes.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    #[serde(flatten)]
    pub who: Who,
    /// Frames until at most a tenth and a hundredth of the jump is left; none where that is never.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub followed_90: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub followed_99: Option<usize>,
    /// Relative L2 distance of the light of the last frame from that of the frame before.
    pub change: f64,
    /// Share of the pixels of all light of which the displayed values change by more than 1/255 from that frame to the
    /// last.
    pub noise_share: f64,
    /// Share of the jump that remains after each frame; rounded, for a plot.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub left: Vec<f64>,
}

/// The experiment.
pub struct Step;

impl Study for Step {
    type Row = Row;
    const NAME: &'static str = "step";
    const TITLE: &'static str = "A light jumps, and then rests";
    const ABOUT: &'static str = "Lights rest elsewhere for a third of the frames, then jump to where the scene has \
        them. What is left of the jump is the relative L2 distance of the light from that of the last frame, over \
        that before the jump. Methods that remember nothing follow in the next frame, but for their noise. Noise is \
        what changes in the end, between two frames under the same lights: relative L2 of the light, and pixels of \
        all light that change by more than 1/255 as displayed.";
    const SCENES: &'static [&'static str] = &["cornell", "office"];

    fn measure(place: &Place, loaded: &LoadedScene) -> Result<Measured<Row>, Error> {
        let Place { common, args, progress, .. } = *place;
        let view = View::new(common, args, loaded);
        let field = Field::new(&view, &bake_settings(common, args, loaded, place.patches), progress)?;
        let mut contenders = field.one_of_each()?;
        let mut direct = None;
        let mut rows = Vec::new();
        for contender in &mut contenders {
            let row = jump(&view, contender.as_mut(), &mut direct)?;
            progress.note(&format!("{}: {}: {} frames to 90 %", loaded.name, row.who.method, frames(row.followed_90)));
            rows.push(row);
        }
        Ok(Measured::of(rows))
    }

    fn sections(scenes: &[SceneRows<Row>]) -> Vec<Section> {
        let section = |scene: &SceneRows<Row>| Section {
            title: scene.scene.clone(),
            tables: vec![table(&scene.rows)],
            plots: vec![jump_plot(&scene.rows)],
            ..Section::default()
        };
        scenes.iter().map(section).collect()
    }
}

/// Light of the last frame with other lights, and of all after it.
fn jump(view: &View, contender: &mut dyn Contender, direct: &mut Option<reference::Picture>) -> Result<Row, Error> {
    let own = &view.loaded.scene.lighting;
    let others = view.others();
    let rest = rest_of(contender, view.args).max(FORGETFUL);
    let away = (rest / AWAY).max(1);
    let mut shown = Vec::new();
    for frame in 0..away + rest {
        contender.frame(if frame < away { &others } else { own }, frame)?;
        if frame + 1 >= away {
            shown.push(contender.light()?);
        }
        cancelled()?;
    }
    let before = contender.pictures(direct.as_ref())?;
    direct.get_or_insert_with(|| before.direct.clone());
    contender.frame(own, away + rest)?;
    let after = contender.pictures(direct.as_ref())?;
    let scale = stops_to_scale(view.loaded.exposure_stops);
    let left = left_of_jump(&shown);
    let followed = |share: f64| match contender.remembers() {
        true => followed_after(&left, share),
        false => Some(1),
    };
    Ok(Row {
        who: Who::of(contender),
        followed_90: followed(0.1),
        followed_99: followed(0.01),
        change: distance(&shown[shown.len() - 1], &shown[shown.len() - 2]),
        noise_share: noise_share(&before.full, &after.full, scale, None)?,
        left: if contender.remembers() { left.iter().map(|&left| rounded(left)).collect() } else { Vec::new() },
    })
}

/// Four digits after the point.
fn rounded(x: f64) -> f64 {
    (x * 1e4).round() * 1e-4
}

fn frames(followed: Option<usize>) -> String {
    followed.map_or_else(|| format!("more than {REST}"), |frame| frame.to_string())
}

fn table(rows: &[Row]) -> Table {
    let head =
        ["method", "frames to 90 %", "to 99 %", "left after 1 frame %", "change at rest %", "pixels that change %"];
    let row = |row: &Row| {
        vec![
            row.who.method.clone(),
            frames(row.followed_90),
            frames(row.followed_99),
            // What remembers nothing has nothing left but noise.
            row.left.get(1).map_or_else(|| "0.0".to_owned(), |left| format!("{:.1}", 100.0 * left)),
            format!("{:.3}", 100.0 * row.change),
            format!("{:.2}", 100.0 * row.noise_share),
        ]
    };
    Table {
        caption: "After a jump of the lights, and at rest".into(),
        head: head.map(str::to_owned).to_vec(),
        rows: rows.iter().map(row).collect(),
    }
}

/// Remaining share of a jump of the lights over the frames after it.
fn jump_plot(rows: &[Row]) -> Plot {
    // The last frame is its own measure.
    let frames = |left: &[f64]| left.len().saturating_sub(2);
    let points = |left: &[f64]| {
        left.iter().enumerate().skip(1).take(frames(left)).map(|(k, left)| (k as f64, left.max(1e-4))).collect()
    };
    let line = |row: &Row| Series { name: row.who.method.clone(), points: points(&row.left) };
    Plot {
        title: "Distance from the light at rest after the lights jump".into(),
        unit: "share of the jump".into(),
        x: "frame".into(),
        logarithmic: true,
        series: rows.iter().filter(|row| !row.left.is_empty()).map(line).collect(),
    }
}
