//! `bench materials`: the error of every kind of method over the albedo of the surfaces, in colours and with textures.

use glam::{Vec2, Vec3};
use reference::metrics::compare_points;
use reference::{PictureErrors, PointErrors};
use scene::gpu::{Texture, Triangle, TriangleUv};
use scene::{Material, Scene, SceneParts};
use serde::{Deserialize, Serialize};

use super::contest::field::Field;
use super::contest::{View, Who, errors, pictures_at_rest};
use super::setup::bake_settings;
use super::study::{Measured, Place, SceneRows, Study, over_scenes};
use super::truth::Truth;
use crate::error::Error;
use crate::report::{Plot, Section, Series};
use assets::import::LoadedScene;

/// Reflectances of all surfaces.
const ALBEDOS: [f32; 4] = [0.2, 0.5, 0.8, 0.95];
/// Reflectances of the squares of the texture, red and blue.
const SQUARES: [Vec3; 2] = [Vec3::new(0.8, 0.3, 0.2), Vec3::new(0.1, 0.25, 0.6)];
/// Squares along the longest side of the scene, and texels along the edge of a picture of two of them each way.
const SQUARES_ALONG: f32 = 12.0;
const TEXELS: u32 = 32;
/// Greatest value of a texel's channel.
const WHITE: f32 = 65_535.0;

/// Errors of a method.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    #[serde(flatten)]
    pub who: Who,
    /// Reflectance of all surfaces, where it is the same of all.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub albedo: Option<f32>,
    pub full: PictureErrors,
    pub indirect: PictureErrors,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub points: Option<PointErrors>,
}

/// The experiment.
pub struct Materials;

impl Study for Materials {
    type Row = Row;
    const NAME: &'static str = "materials";
    const TITLE: &'static str = "Dark, bright, coloured and textured surfaces";
    const ABOUT: &'static str = "The same scene with all surfaces grey of one albedo, with its own colours, and with \
        squares of two colours on all surfaces. The more surfaces reflect, the more bounces there are, and the more \
        an error of one bounce grows. Errors of indirect light at rest against path tracing; mean ratios tell energy \
        that is lost or made.";
    const SCENES: &'static [&'static str] = &["cornell"];

    fn variants(loaded: LoadedScene) -> Result<Vec<LoadedScene>, Error> {
        let name = loaded.name.clone();
        let variant =
            |what: String, scene: Scene| LoadedScene { name: format!("{name}, {what}"), scene, ..loaded.clone() };
        let mut list = Vec::new();
        for albedo in ALBEDOS {
            list.push(variant(format!("albedo {albedo}"), grey(&loaded.scene, albedo)?));
        }
        list.push(variant("coloured".to_owned(), loaded.scene.clone()));
        list.push(variant("textured".to_owned(), textured(&loaded.scene)?));
        Ok(list)
    }

    fn measure(place: &Place, loaded: &LoadedScene) -> Result<Measured<Row>, Error> {
        let Place { common, args, progress, .. } = *place;
        let truth = Truth::traced_with_points(loaded, args.size(), args.spp, common.seed, progress)?;
        let view = View::new(common, args, loaded);
        let field = Field::new(&view, &bake_settings(common, args, loaded, place.patches), progress)?;
        let albedo = same_albedo(&loaded.scene);
        let mut direct = None;
        let mut rows = Vec::new();
        for mut contender in field.one_of_each()? {
            let pictures = pictures_at_rest(&view, contender.as_mut(), 0, &mut direct)?;
            let (full, indirect) = errors(&view, &pictures, &truth)?;
            let found = contender.at_points(&truth.points)?;
            let points = found.map(|found| compare_points(&found, &truth.point_indirect)).transpose()?;
            let row = Row { who: Who::of(contender.as_ref()), albedo, full, indirect, points };
            let percent = 100.0 * row.indirect.block_median_relative_error;
            progress.note(&format!("{}: {}: blocks {percent:.2} %", loaded.name, row.who.method));
            rows.push(row);
        }
        Ok(Measured { reference: Some(truth.source), ..Measured::of(rows) })
    }

    fn sections(scenes: &[SceneRows<Row>]) -> Vec<Section> {
        let who = |row: &Row| row.who.method.clone();
        let tables = vec![
            over_scenes("Median error of 8 × 8 blocks of indirect light, %", scenes, who, |row| {
                format!("{:.2}", 100.0 * row.indirect.block_median_relative_error)
            }),
            over_scenes("Mean of indirect light over that of the reference", scenes, who, |row| {
                format!("{:.3}", row.indirect.mean_ratio)
            }),
            over_scenes("PSNR of indirect light, dB", scenes, who, |row| format!("{:.2}", row.indirect.psnr_db)),
            over_scenes("Median error at points, %", scenes, who, |row| {
                row.points
                    .map_or_else(|| "in pixels only".to_owned(), |p| format!("{:.2}", 100.0 * p.median_relative_error))
            }),
        ];
        vec![Section {
            title: "Errors over materials".into(),
            tables,
            plots: vec![albedo_plot(scenes)],
            ..Section::default()
        }]
    }
}

/// Errors over the albedo of all surfaces.
fn albedo_plot(scenes: &[SceneRows<Row>]) -> Plot {
    let mut series: Vec<Series> = Vec::new();
    for row in scenes.iter().flat_map(|scene| &scene.rows) {
        let Some(albedo) = row.albedo else { continue };
        // Three digits: as it was written, not as a number of single precision.
        let albedo = (f64::from(albedo) * 1e3).round() * 1e-3;
        let point = (albedo, 100.0 * row.indirect.block_median_relative_error);
        match series.iter_mut().find(|line| line.name == row.who.method) {
            Some(line) => line.points.push(point),
            None => series.push(Series { name: row.who.method.clone(), points: vec![point] }),
        }
    }
    Plot {
        title: "Median error of 8 × 8 blocks of indirect light".into(),
        unit: "%".into(),
        x: "albedo".into(),
        logarithmic: true,
        series,
    }
}

/// The reflectance of all surfaces, where it is the same of all, and grey.
fn same_albedo(scene: &Scene) -> Option<f32> {
    let used = scene.geometry.triangles.iter().map(|t| &scene.materials[t.material as usize]);
    let mut albedos = used.map(|material| (material.albedo, material.albedo_texture));
    let (first, texture) = albedos.next()?;
    let is_grey = first == Vec3::splat(first.x) && texture == scene::NONE;
    (is_grey && albedos.all(|albedo| albedo == (first, texture))).then_some(first.x)
}

/// The scene with other materials, for which textures and coordinates may be given.
fn with_materials(
    scene: &Scene,
    material: impl Fn(&Material) -> Material,
    change: impl FnOnce(&mut SceneParts),
) -> Result<Scene, Error> {
    let mut parts = SceneParts {
        triangles: scene.geometry.triangles.clone(),
        uvs: scene.geometry.uvs.clone(),
        materials: scene.geometry.materials.iter().map(material).collect(),
        textures: scene.geometry.textures.clone(),
        texels: scene.geometry.texels.to_vec(),
        lights: scene.lighting.lights.clone(),
        sky: scene.lighting.sky,
        sky_map: scene.lighting.sky_map.to_vec(),
        distributions: scene.lighting.distributions.to_vec(),
        ray_offset: Some(scene.geometry.ray_offset),
        absorption: scene.geometry.absorption,
        ..SceneParts::default()
    };
    change(&mut parts);
    Ok(Scene::new(parts).map_err(reference::Error::from)?)
}

/// All surfaces reflect this share.
fn grey(scene: &Scene, albedo: f32) -> Result<Scene, Error> {
    with_materials(scene, |m| Material { albedo: Vec3::splat(albedo), albedo_texture: scene::NONE, ..*m }, |_| {})
}

/// Squares of two colours on all surfaces, by their positions along the two axes that their normal is farther from.
fn textured(scene: &Scene) -> Result<Scene, Error> {
    let number = scene.geometry.textures.len() as u32;
    let material = |m: &Material| Material { albedo_texture: number, ..*m };
    let (low, high) = scene.geometry.bounds;
    // A picture holds two squares each way.
    let repeats = 0.5 * SQUARES_ALONG / (high - low).max_element();
    with_materials(scene, material, |parts| {
        let offset = parts.texels.len() as u32 / 2;
        let levels = TEXELS.ilog2() + 1;
        parts.textures.push(Texture { offset, width: TEXELS, height: TEXELS, levels });
        parts.texels.extend(squares());
        let coordinates = |t: &Triangle| {
            let normal = t.edge_a.cross(t.edge_b).abs();
            let flat = |p: Vec3| match normal.max_position() {
                0 => Vec2::new(p.y, p.z),
                1 => Vec2::new(p.z, p.x),
                _ => Vec2::new(p.x, p.y),
            };
            let at = |p: Vec3| flat(p - low) * repeats;
            let Triangle { corner, edge_a, edge_b, .. } = *t;
            TriangleUv {
                corner: at(corner),
                corner_a: at(corner + edge_a),
                corner_b: at(corner + edge_b),
                ..TriangleUv::default()
            }
        };
        parts.uvs = parts.triangles.iter().map(coordinates).collect();
    })
}

/// All levels of a picture of two by two squares, two words a texel; the last one has their mean.
fn squares() -> Vec<u32> {
    let mut words = Vec::new();
    for level in 0..=TEXELS.ilog2() {
        let edge = TEXELS >> level;
        for k in 0..edge * edge {
            let is_second = |at: u32| 2 * at >= edge;
            let colour = match edge {
                1 => 0.5 * (SQUARES[0] + SQUARES[1]),
                _ => SQUARES[usize::from(is_second(k % edge) != is_second(k / edge))],
            };
            let [r, g, b] = (colour * WHITE + 0.5).to_array().map(|c| c as u32);
            words.extend([r | g << 16, b | (WHITE as u32) << 16]);
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use assets::procedural;

    #[test]
    fn variants_reflect_what_they_say() {
        let variants = Materials::variants(procedural::build("cornell").unwrap()).unwrap();
        let albedos: Vec<Option<f32>> = variants.iter().map(|v| same_albedo(&v.scene)).collect();
        assert_eq!(albedos, [Some(0.2), Some(0.5), Some(0.8), Some(0.95), None, None]);
        let textured = &variants[5].scene;
        // Both colours are seen, and over large areas their mean.
        let floor = (0..textured.geometry.triangles.len() as u32)
            .max_by(|a, b| {
                let area = |t: &u32| {
                    let t = &textured.geometry.triangles[*t as usize];
                    t.edge_a.cross(t.edge_b).length()
                };
                area(a).total_cmp(&area(b))
            })
            .unwrap();
        let triangle = textured.geometry.triangles[floor as usize];
        let mut seen = [0, 0];
        for k in 0..100u16 {
            let (u, v) = scene::sampling::uniform_triangle(scene::sampling::hammersley(u32::from(k), 100, (0, 0)));
            let albedo =
                textured.filtered_albedo(floor, triangle.corner + triangle.edge_a * u + triangle.edge_b * v, 0.0);
            for (seen, colour) in seen.iter_mut().zip(SQUARES) {
                *seen += usize::from(albedo.distance(colour) < 0.01);
            }
        }
        assert!(seen[0] > 25 && seen[1] > 25, "{seen:?}");
        let middle = triangle.corner + (triangle.edge_a + triangle.edge_b) / 3.0;
        let mean = textured.filtered_albedo(floor, middle, 100.0);
        assert!(mean.distance(0.5 * (SQUARES[0] + SQUARES[1])) < 0.01, "{mean}");
    }
}
