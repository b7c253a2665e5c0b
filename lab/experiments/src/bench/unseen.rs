//! `bench unseen`: errors under lights that no bake has seen, beside those under the scene's own, for every kind of
//! method.

use reference::PictureErrors;
use scene::Light;
use serde::{Deserialize, Serialize};

use super::contest::field::Field;
use super::contest::{View, Who, errors, pictures_at_rest};
use super::lights::other_lights;
use super::setup::bake_settings;
use super::study::{Measured, Place, SceneRows, Study, over_scenes};
use super::truth::Truth;
use crate::error::Error;
use crate::report::Section;
use assets::import::LoadedScene;

/// The scene's own light, which the bake has seen.
const OWN: &str = "own light";
/// Other lights of a scene at most.
const OTHERS: usize = 2;

/// Errors of a method under a light.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Light sources.
    pub light: String,
    #[serde(flatten)]
    pub who: Who,
    pub indirect: PictureErrors,
    /// Error of blocks over that of the same method under the scene's own light.
    pub over_own: f64,
}

/// The experiment.
pub struct Unseen;

impl Study for Unseen {
    type Row = Row;
    const NAME: &'static str = "unseen";
    const TITLE: &'static str = "Lights that the bake has not seen";
    const ABOUT: &'static str = "Patches are baked with the scene's own lights, which decide where they stand; then \
        other lights shine, with references of their own. Errors of indirect light at rest against path tracing, and \
        those over the errors of the same method under the scene's own light. Opponents have no bake that a light \
        could be missing from.";
    const SCENES: &'static [&'static str] = &["cornell", "office"];
    const SHARED: &'static [&'static str] = &["cornell-dragon", "bathroom", "sponza"];

    fn measure(place: &Place, loaded: &LoadedScene) -> Result<Measured<Row>, Error> {
        let Place { common, args, progress, .. } = *place;
        let own_view = View::new(common, args, loaded);
        let own_field = Field::new(&own_view, &bake_settings(common, args, loaded, place.patches), progress)?;
        let own = (OWN.to_owned(), loaded.scene.lighting.lights.clone());
        let lights: Vec<(String, Vec<Light>)> = std::iter::once(own).chain(other_lights(loaded)).collect();
        let mut rows: Vec<Row> = Vec::new();
        let mut sources = Vec::new();
        for (light, shining) in &lights[..lights.len().min(1 + OTHERS)] {
            let mut other = loaded.clone();
            other.scene.set_lights(shining);
            let truth = Truth::traced(&other, shining, args.size(), args.spp, common.seed, progress)?;
            let view = View::new(common, args, &other);
            let field = Field::of_bake(&view, own_field.bake(), progress);
            let mut direct = None;
            for mut contender in field.one_of_each()? {
                let pictures = pictures_at_rest(&view, contender.as_mut(), 0, &mut direct)?;
                let (_, indirect) = errors(&view, &pictures, &truth)?;
                let who = Who::of(contender.as_ref());
                let of_own = rows.iter().find(|row| row.light == OWN && row.who.family == who.family);
                let error = indirect.block_median_relative_error;
                let own_error = of_own.map_or(error, |row| row.indirect.block_median_relative_error);
                progress.note(&format!("{}, {light}: {}: blocks {:.2} %", loaded.name, who.method, 100.0 * error));
                rows.push(Row { light: light.clone(), who, indirect, over_own: error / own_error });
            }
            sources.push(format!("{light}: {}", truth.source));
        }
        Ok(Measured { reference: Some(sources.join("; ")), ..Measured::of(rows) })
    }

    fn sections(scenes: &[SceneRows<Row>]) -> Vec<Section> {
        let columns: Vec<SceneRows<Row>> = scenes.iter().flat_map(by_light).collect();
        let who = |row: &Row| row.who.family.clone();
        let tables = vec![
            over_scenes("Median error of 8 × 8 blocks of indirect light, %", &columns, who, |row| {
                format!("{:.2}", 100.0 * row.indirect.block_median_relative_error)
            }),
            over_scenes("The same over that under the scene's own light", &columns, who, |row| {
                format!("{:.2}", row.over_own)
            }),
            over_scenes("PSNR of indirect light, dB", &columns, who, |row| format!("{:.2}", row.indirect.psnr_db)),
            over_scenes("Mean of indirect light over that of the reference", &columns, who, |row| {
                format!("{:.3}", row.indirect.mean_ratio)
            }),
        ];
        vec![Section { title: "Errors under other lights".into(), tables, ..Section::default() }]
    }
}

/// The rows of a scene as those of as many scenes as it has lights.
fn by_light(scene: &SceneRows<Row>) -> Vec<SceneRows<Row>> {
    let mut lights: Vec<&str> = scene.rows.iter().map(|row| row.light.as_str()).collect();
    lights.dedup();
    let of_light = |light: &&str| SceneRows {
        scene: format!("{}, {light}", scene.scene),
        rows: scene.rows.iter().filter(|row| row.light == *light).cloned().collect(),
        ..scene.clone()
    };
    lights.iter().map(of_light).collect()
}
