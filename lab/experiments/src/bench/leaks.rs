//! `bench leaks`: light behind walls. What every kind of method shows in scenes with thin walls, slats and legs, in
//! pixels that are too bright or too dark against path tracing whose noise is known.

use reference::metrics::indirect_scale;
use reference::{Judge, Picture, PictureFile as _, scale_to_stops};
use scene::math::luminance;
use serde::{Deserialize, Serialize};

use super::contest::field::Field;
use super::contest::{View, Who, pictures_at_rest, side_by_side};
use super::setup::bake_settings;
use super::study::{Measured, Place, SIDE_BY_SIDE, SceneRows, Study, file_name, over_scenes};
use crate::error::Error;
use crate::references::ReferenceStore;
use crate::report::{Figure, Section};
use assets::import::LoadedScene;

/// Pixels with less than this share of the mean indirect light are in the dark.
const DARK: f64 = 0.2;
/// Folder of references where none is given.
const REFERENCES: &str = "references";

/// Faults of a method in a scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    #[serde(flatten)]
    pub who: Who,
    /// Shares of the pixels of indirect light that are leaks and stains.
    pub leak_share: f64,
    pub stain_share: f64,
    /// Light of pixels in the dark over that of the reference there; none where the scene has no dark.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub dark_ratio: Option<f64>,
}

/// The experiment.
pub struct Leaks;

impl Study for Leaks {
    type Row = Row;
    const NAME: &'static str = "leaks";
    const TITLE: &'static str = "Light behind walls";
    const ABOUT: &'static str = "Pixels of indirect light at rest against path tracing. A leak is brighter than the \
        reference by more than a tenth of the mean indirect light, a stain is darker by more than a quarter; what is \
        within three standard errors of the reference counts as neither. The dark is where the reference has less \
        than a fifth of the mean: there the light of a method is given over that of the reference, 1 where it is \
        right.";
    const SCENES: &'static [&'static str] = &["rooms", "corridor", "blinds", "clutter"];
    const SHARED: &'static [&'static str] = &["bathroom", "sponza"];
    const SHOWN: &'static [&'static str] = &["rooms", "corridor"];

    fn measure(place: &Place, loaded: &LoadedScene) -> Result<Measured<Row>, Error> {
        let Place { common, args, progress, .. } = *place;
        let kept = args.cache.clone().unwrap_or_else(|| place.out.join(REFERENCES));
        let truth = ReferenceStore::open(Some(&kept))?.make(loaded, args.size(), args.spp, progress)?;
        let view = View::new(common, args, loaded);
        let field = Field::new(&view, &bake_settings(common, args, loaded, place.patches), progress)?;
        let judge = truth.indirect();
        let scale = indirect_scale(&truth.pictures.indirect);
        let stops = scale_to_stops(scale);
        let mut shown = vec![truth.pictures.indirect.clone()];
        let mut names = vec!["reference".to_owned()];
        let mut rows = Vec::new();
        let mut figures = Vec::new();
        let mut direct = None;
        for mut contender in field.one_of_each()? {
            let pictures = pictures_at_rest(&view, contender.as_mut(), 0, &mut direct)?;
            let faults = judge.faults(&pictures.indirect, None)?;
            let row = Row {
                who: Who::of(contender.as_ref()),
                leak_share: faults.leak_share,
                stain_share: faults.stain_share,
                dark_ratio: dark_ratio(&judge, &pictures.indirect),
            };
            progress.note(&format!("{}: {}", loaded.name, caption(&row)));
            let file = format!("{}.png", file_name(&row.who.method));
            judge.fault_picture(&pictures.indirect, scale)?.write_png(&place.folder.join(&file), 0.0)?;
            figures.push(Figure::read(&place.folder, &file, format!("{}; leaks red, stains blue", caption(&row)))?);
            names.push(row.who.method.clone());
            shown.push(pictures.indirect);
            rows.push(row);
        }
        side_by_side(&shown, &place.folder.join(SIDE_BY_SIDE), stops)?;
        let noise = truth.noise().map_or_else(String::new, |noise| {
            format!(
                ", standard error of a pixel {:.2} % (median), which hides leaks at {:.2} % of the pixels",
                100.0 * noise.indirect.median_relative_standard_error,
                100.0 * noise.indirect.leaks_hidden_share
            )
        });
        Ok(Measured {
            rows,
            reference: Some(format!("{}{noise}", truth.source)),
            figures,
            shown: names,
            left_out: Vec::new(),
        })
    }

    fn sections(scenes: &[SceneRows<Row>]) -> Vec<Section> {
        let percent = |share: f64| format!("{:.2}", 100.0 * share);
        let who = |row: &Row| row.who.family.clone();
        let tables = vec![
            over_scenes("Leaks, % of the pixels", scenes, who, |row| percent(row.leak_share)),
            over_scenes("Stains, % of the pixels", scenes, who, |row| percent(row.stain_share)),
            over_scenes("Light in the dark, over that of the reference", scenes, who, |row| {
                row.dark_ratio.map_or_else(|| "no dark".to_owned(), |ratio| format!("{ratio:.2}"))
            }),
        ];
        vec![Section { title: "Leaks and stains".into(), tables, ..Section::default() }]
    }
}

fn caption(row: &Row) -> String {
    format!("{}: leaks {:.2} %, stains {:.2} %", row.who.method, 100.0 * row.leak_share, 100.0 * row.stain_share)
}

/// Light of a picture where the reference is dark, over that of the reference there.
fn dark_ratio(judge: &Judge, ours: &Picture) -> Option<f64> {
    let bound = DARK * judge.mean_light;
    let mut found = 0.0;
    let mut expected = 0.0;
    for (ours, reference) in ours.pixels.iter().zip(&judge.reference.pixels) {
        let reference = f64::from(luminance(*reference));
        if reference < bound {
            found += f64::from(luminance(*ours));
            expected += reference;
        }
    }
    (expected > 0.0).then(|| found / expected)
}
