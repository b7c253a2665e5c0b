//! Scene .toml version 1.

use std::ops::Range;
use std::path::{Path, PathBuf};

use glam::{Quat, Vec3};
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_POINT};
use scene::{Light, NONE, Sky};
use serde::Deserialize;
use toml::Spanned;

use super::draft::{FileTriangle, Mesh, Setting, finish};
use super::lights::{self, Fault, Mounting};
use super::luminaire::Luminaires;
use super::optics::INDICES;
use super::{ImportError, Keyframe, LoadOptions, LoadedScene, MovingObject, Pose, Target, Track, View};

/// Most absorption of a medium, 1/m: nothing is seen through a tenth of a millimetre.
const MAX_ABSORPTION: f32 = 1e6;

#[derive(Deserialize)]
struct VersionOnly {
    version: Option<Spanned<toml::Value>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneTable {
    #[serde(rename = "version")]
    _version: i64,
    mesh: Spanned<String>,
    metres_per_unit: Option<Spanned<f32>>,
    exposure_stops: Option<Spanned<f32>>,
    camera: Option<Spanned<CameraTable>>,
    sky: Option<Spanned<SkyTable>>,
    medium: Option<Spanned<MediumTable>>,
    #[serde(default)]
    material: Vec<Spanned<MaterialTable>>,
    #[serde(default)]
    light: Vec<Spanned<LightTable>>,
    #[serde(default)]
    animation: Vec<Spanned<AnimationTable>>,
    #[serde(default)]
    object: Vec<Spanned<ObjectTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraTable {
    eye: [f32; 3],
    target: [f32; 3],
    up: Option<[f32; 3]>,
    vertical_fov_degrees: Option<f32>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SkyTable {
    radiance: Option<[f32; 3]>,
    map: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MediumTable {
    absorption: [f32; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MaterialTable {
    name: String,
    albedo: Option<[f32; 3]>,
    mirror: Option<[f32; 3]>,
    transmittance: Option<[f32; 3]>,
    index_of_refraction: Option<f32>,
    pane: Option<bool>,
    roughness: Option<f32>,
    metallic: Option<f32>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LightTable {
    #[serde(rename = "type")]
    kind: String,
    direction: Option<[f32; 3]>,
    irradiance: Option<[f32; 3]>,
    position: Option<[f32; 3]>,
    intensity: Option<[f32; 3]>,
    inner_degrees: Option<f32>,
    outer_degrees: Option<f32>,
    corner: Option<[f32; 3]>,
    edge_a: Option<[f32; 3]>,
    edge_b: Option<[f32; 3]>,
    radiance: Option<[f32; 3]>,
    file: Option<String>,
    c0: Option<[f32; 3]>,
    color: Option<[f32; 3]>,
    temperature: Option<f32>,
    flux: Option<f32>,
    dimming: Option<f32>,
    lamp_set: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AnimationTable {
    target: String,
    index: Option<usize>,
    property: String,
    keyframes: Vec<KeyframeTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KeyframeTable {
    time: f32,
    value: [f32; 3],
}

/// An object that moves.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ObjectTable {
    name: Option<String>,
    mesh: String,
    material: String,
    keyframes: Vec<PoseTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseTable {
    time: f32,
    position: [f32; 3],
    axis: Option<[f32; 3]>,
    degrees: Option<f32>,
}

/// The file's text, for places in messages.
struct Text<'a> {
    path: &'a Path,
    text: &'a str,
}

impl Text<'_> {
    fn line(&self, span: Option<Range<usize>>) -> usize {
        let end = span.map_or(0, |s| s.start).min(self.text.len());
        1 + self.text.as_bytes()[..end].iter().filter(|b| **b == b'\n').count()
    }

    fn syntax(&self, e: &toml::de::Error) -> ImportError {
        let reason = e.message().trim().replace('\n', ", ");
        ImportError::Toml { path: self.path.to_path_buf(), line: self.line(e.span()), reason }
    }

    fn value(&self, span: Range<usize>, key: &str, reason: impl Into<String>) -> ImportError {
        ImportError::Value {
            path: self.path.to_path_buf(),
            line: self.line(Some(span)),
            key: key.to_owned(),
            reason: reason.into(),
        }
    }
}

/// Reads a scene .toml and the mesh it names.
pub fn load(path: &Path, options: &LoadOptions) -> Result<LoadedScene, ImportError> {
    let bytes = super::read(path)?;
    let text = String::from_utf8(bytes).map_err(|e| {
        let good = &e.as_bytes()[..e.utf8_error().valid_up_to()];
        ImportError::Toml {
            path: path.to_path_buf(),
            line: 1 + good.iter().filter(|b| **b == b'\n').count(),
            reason: String::from("is not UTF-8 text; save the file as UTF-8"),
        }
    })?;
    let text = Text { path, text: &text };
    check_version(&text)?;
    let table: SceneTable = toml::from_str(text.text).map_err(|e| text.syntax(&e))?;

    let name = path.file_stem().map_or_else(|| String::from("scene"), |s| s.to_string_lossy().into_owned());
    let mut setting = Setting::new(path, &name);
    setting.files.push(path.to_path_buf());
    read_units(&text, &table, &mut setting)?;
    if let Some(camera) = &table.camera {
        setting.view = Some(view(&text, camera, setting.metres_per_unit)?);
    }
    let mut warnings = Vec::new();
    read_lights(&text, &table.light, &mut setting, &mut warnings)?;
    if let Some(sky) = &table.sky {
        read_sky(&text, sky, &mut setting, options, &mut warnings)?;
    }
    if let Some(medium) = &table.medium {
        setting.absorption = absorption(&text, medium)?;
    }
    for track in &table.animation {
        let built = build_track(track.as_ref(), &setting.lights, setting.metres_per_unit);
        setting.animation.tracks.push(built.map_err(|(key, reason)| text.value(track.span(), key, reason))?);
    }
    let mesh_path = beside(path, table.mesh.as_ref());
    if !mesh_path.exists() {
        return Err(ImportError::MissingMesh { path: path.to_path_buf(), mesh: mesh_path });
    }
    let mut mesh = super::read_mesh(&mesh_path, options)?;
    warnings.append(&mut mesh.warnings);
    mesh.warnings = warnings;
    for material in &table.material {
        change_material(material.as_ref(), &mut mesh)
            .map_err(|(key, reason)| text.value(material.span(), &format!("material, {key}"), reason))?;
    }
    for object in &table.object {
        let moving = read_object(&text, object, &mesh, &mut setting, options)?;
        setting.moving.push(moving);
    }
    finish(mesh, setting, options)
}

/// An object that moves, with the mesh that it names.
fn read_object(
    text: &Text,
    object: &Spanned<ObjectTable>,
    mesh: &Mesh,
    setting: &mut Setting,
    options: &LoadOptions,
) -> Result<MovingObject, ImportError> {
    let table = object.as_ref();
    let fault = |(key, reason): Fault| text.value(object.span(), &format!("object, {key}"), reason);
    let poses = build_poses(table, setting.metres_per_unit).map_err(fault)?;
    let Some(material) = mesh.materials.iter().position(|material| material.name == table.material) else {
        let known: Vec<&str> = mesh.materials.iter().map(|m| m.name.as_str()).collect();
        let reason = format!("\"{}\" is no material of the mesh, which has {}", table.material, known.join(", "));
        return Err(fault(("material", reason)));
    };
    let path = beside(text.path, &table.mesh);
    if !path.exists() {
        return Err(ImportError::MissingMesh { path: text.path.to_path_buf(), mesh: path });
    }
    let own = super::read_mesh(&path, options)?;
    setting.files.extend(own.files);
    let scale = setting.metres_per_unit;
    let has_area = |t: &&FileTriangle| {
        let [a, b, c] = t.corners.map(|corner| corner * scale);
        let area = (b - a).cross(c - a).length();
        area > 0.0 && area.is_finite()
    };
    let stem = || path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let name = table.name.clone().unwrap_or_else(stem);
    let found = MovingObject::of_triangles(name, material, own.triangles.iter().filter(has_area), Vec::new());
    if found.corners.is_empty() {
        return Err(fault(("mesh", format!("{} has no triangle with an area", path.display()))));
    }
    Ok(MovingObject { poses, ..found.scaled(scale) })
}

fn build_poses(table: &ObjectTable, scale: f32) -> Result<Vec<Pose>, Fault> {
    if table.keyframes.is_empty() {
        return Err(("keyframes", String::from("is empty; give at least one { time, position }")));
    }
    let mut poses: Vec<Pose> = Vec::with_capacity(table.keyframes.len());
    for k in &table.keyframes {
        if !k.time.is_finite() || poses.last().is_some_and(|last| k.time <= last.time) {
            return Err(("keyframes", format!("time {} is not after the one before; give ascending times", k.time)));
        }
        let position = lights::check_position("keyframes", Vec3::from(k.position))? * scale;
        let degrees = k.degrees.unwrap_or(0.0);
        let axis = Vec3::from(k.axis.unwrap_or([0.0, 1.0, 0.0]));
        let Some(axis) = axis.try_normalize().filter(|_| degrees.is_finite()) else {
            return Err(("keyframes", String::from("axis must have a length, and degrees be a finite number")));
        };
        poses.push(Pose { time: k.time, position, rotation: Quat::from_axis_angle(axis, degrees.to_radians()) });
    }
    Ok(poses)
}

/// Length of a unit and exposure.
fn read_units(text: &Text, table: &SceneTable, setting: &mut Setting) -> Result<(), ImportError> {
    if let Some(scale) = &table.metres_per_unit {
        setting.metres_per_unit = *scale.as_ref();
        if !(scale.as_ref().is_finite() && *scale.as_ref() > 0.0) {
            return Err(text.value(
                scale.span(),
                "metres_per_unit",
                "must be a finite number above 0, for example 0.01",
            ));
        }
    }
    if let Some(stops) = &table.exposure_stops {
        setting.exposure_stops = Some(*stops.as_ref());
        if !(-100.0..=100.0).contains(stops.as_ref()) {
            return Err(text.value(stops.span(), "exposure_stops", "must be a number from -100 to 100"));
        }
    }
    Ok(())
}

/// Lights, those of luminaires with the files that they name.
fn read_lights(
    text: &Text,
    lights: &[Spanned<LightTable>],
    setting: &mut Setting,
    warnings: &mut Vec<String>,
) -> Result<(), ImportError> {
    let mut luminaires = Luminaires::default();
    for (k, light) in lights.iter().enumerate() {
        let light_fault = |(key, reason): Fault| text.value(light.span(), &format!("light {}, {key}", k + 1), reason);
        let t = light.as_ref();
        check_keys(t).map_err(light_fault)?;
        let built = match (t.kind.as_str(), &t.file) {
            (LUMINAIRE, Some(file)) => {
                let path = beside(text.path, file);
                let lamp_set = t.lamp_set.unwrap_or(1);
                let found = luminaires.add(&path, lamp_set, &mut setting.distributions, warnings)?;
                setting.files.push(path);
                build_luminaire(t, setting.metres_per_unit, found)
            }
            _ => build_light(t, setting.metres_per_unit),
        };
        setting.lights.push(built.map_err(light_fault)?);
    }
    Ok(())
}

/// Absorption of the medium, 1/m.
fn absorption(text: &Text, medium: &Spanned<MediumTable>) -> Result<Vec3, ImportError> {
    let values = medium.as_ref().absorption;
    if values.into_iter().all(|a: f32| (0.0..=MAX_ABSORPTION).contains(&a)) {
        return Ok(Vec3::from(values));
    }
    let reason = format!("must be three numbers from 0 to {MAX_ABSORPTION} 1/m");
    Err(text.value(medium.span(), "absorption", reason))
}

/// Gives the materials of a name what a scene file says of them.
fn change_material(t: &MaterialTable, mesh: &mut Mesh) -> Result<(), Fault> {
    let share = |key: &'static str, value: Option<[f32; 3]>| match value.map(Vec3::from) {
        Some(v) if v.to_array().into_iter().all(|x| (0.0..=1.0).contains(&x)) => Ok(Some(v)),
        Some(v) => Err((key, format!("{v} is no share of light; give three numbers from 0 to 1"))),
        None => Ok(None),
    };
    let albedo = share("albedo", t.albedo)?;
    let mirror = share("mirror", t.mirror)?;
    let transmittance = share("transmittance", t.transmittance)?;
    if let Some(index) = t.index_of_refraction.filter(|index| !(INDICES.0..=INDICES.1).contains(index)) {
        let reason = format!("{index} is no index of refraction; give a number from {} to {}", INDICES.0, INDICES.1);
        return Err(("index_of_refraction", reason));
    }
    for (key, value) in [("roughness", t.roughness), ("metallic", t.metallic)] {
        if let Some(value) = value.filter(|value| !(0.0..=1.0).contains(value)) {
            return Err((key, format!("{value} is no share; give a number from 0 to 1")));
        }
    }
    if t.metallic.is_some() && t.roughness.is_none() {
        return Err(("metallic", "is that of a specular lobe; give the roughness of one".to_owned()));
    }
    let named: Vec<usize> = (0..mesh.materials.len()).filter(|&k| mesh.materials[k].name == t.name).collect();
    if named.is_empty() {
        let known: Vec<&str> = mesh.materials.iter().map(|m| m.name.as_str()).collect();
        return Err(("name", format!("\"{}\" is no material of the mesh, which has {}", t.name, known.join(", "))));
    }
    for k in named {
        let m = &mut mesh.materials[k];
        if let Some(albedo) = albedo {
            m.albedo = albedo;
            m.albedo_picture = None;
            if let Some(packed) = &mut mesh.packed {
                packed.slots[k].albedo = NONE;
            }
        }
        m.optics.mirror = mirror.unwrap_or(m.optics.mirror);
        m.optics.transmittance = transmittance.unwrap_or(m.optics.transmittance);
        m.optics.index_of_refraction = t.index_of_refraction.unwrap_or(m.optics.index_of_refraction);
        m.optics.is_pane = t.pane.unwrap_or(m.optics.is_pane);
        m.finish.roughness = t.roughness.or(m.finish.roughness);
        m.finish.metallic = t.metallic.unwrap_or(m.finish.metallic);
    }
    Ok(())
}

/// A path relative to the folder of a file.
pub fn beside(file: &Path, name: &str) -> PathBuf {
    file.parent().unwrap_or(Path::new("")).join(name.replace('\\', "/"))
}

fn check_version(text: &Text) -> Result<(), ImportError> {
    let found: VersionOnly = toml::from_str(text.text).map_err(|e| text.syntax(&e))?;
    match found.version {
        Some(v) if v.as_ref().as_integer() == Some(1) => Ok(()),
        Some(v) => Err(ImportError::Version {
            path: text.path.to_path_buf(),
            line: text.line(Some(v.span())),
            found: v.as_ref().to_string(),
        }),
        None => Err(ImportError::Version { path: text.path.to_path_buf(), line: 1, found: String::from("(none)") }),
    }
}

fn view(text: &Text, camera: &Spanned<CameraTable>, scale: f32) -> Result<View, ImportError> {
    let table = camera.as_ref();
    let view = View {
        eye: Vec3::from(table.eye) * scale,
        target: Vec3::from(table.target) * scale,
        up: table.up.map_or(Vec3::Y, Vec3::from),
        vertical_fov_degrees: table.vertical_fov_degrees.unwrap_or(45.0),
    };
    let fault = |key: &str, reason: &str| Err(text.value(camera.span(), key, reason));
    if !(view.eye.is_finite() && view.target.is_finite() && view.up.is_finite()) {
        return fault("camera", "eye, target and up must be finite numbers");
    }
    let Some(forward) = (view.target - view.eye).try_normalize() else {
        return fault("camera", "eye and target are the same point; move one of them");
    };
    if view.up.try_normalize().is_none_or(|up| up.cross(forward).length() < 1e-4) {
        return fault("camera", "up lies along the view direction; give another up");
    }
    if !(0.01..=179.0).contains(&view.vertical_fov_degrees) {
        return fault("vertical_fov_degrees", "must be a number from 0.01 to 179");
    }
    Ok(view)
}

/// [`LightTable::kind`] of what an IES or EULUMDAT file describes.
const LUMINAIRE: &str = "luminaire";

/// Checks that a light has the keys of its type and no others.
fn check_keys(t: &LightTable) -> Result<(), Fault> {
    let keys: [(&'static str, bool); 17] = [
        ("direction", t.direction.is_some()),
        ("irradiance", t.irradiance.is_some()),
        ("position", t.position.is_some()),
        ("intensity", t.intensity.is_some()),
        ("inner_degrees", t.inner_degrees.is_some()),
        ("outer_degrees", t.outer_degrees.is_some()),
        ("corner", t.corner.is_some()),
        ("edge_a", t.edge_a.is_some()),
        ("edge_b", t.edge_b.is_some()),
        ("radiance", t.radiance.is_some()),
        ("file", t.file.is_some()),
        ("c0", t.c0.is_some()),
        ("color", t.color.is_some()),
        ("temperature", t.temperature.is_some()),
        ("flux", t.flux.is_some()),
        ("dimming", t.dimming.is_some()),
        ("lamp_set", t.lamp_set.is_some()),
    ];
    let (wanted, optional): (&[&str], &[&str]) = match t.kind.as_str() {
        "directional" => (&["direction", "irradiance"], &[]),
        "point" => (&["position", "intensity"], &[]),
        "spot" => (&["position", "direction", "intensity", "inner_degrees", "outer_degrees"], &[]),
        "rect" => (&["corner", "edge_a", "edge_b", "radiance"], &[]),
        LUMINAIRE => {
            (&["file", "position"], &["direction", "c0", "color", "temperature", "flux", "dimming", "lamp_set"])
        }
        other => {
            let reason = format!("\"{other}\" is not known; give directional, point, spot, rect or luminaire");
            return Err(("type", reason));
        }
    };
    for (key, given) in keys {
        if given && !wanted.contains(&key) && !optional.contains(&key) {
            let all = [wanted, optional].concat().join(", ");
            return Err((key, format!("does not belong to a {} light; it has {all}", t.kind)));
        }
        if !given && wanted.contains(&key) {
            return Err((key, format!("is missing; a {} light has {}", t.kind, wanted.join(", "))));
        }
    }
    for (a, b) in [("color", "temperature"), ("flux", "dimming")] {
        if keys.iter().filter(|(key, given)| *given && (*key == a || *key == b)).count() == 2 {
            return Err((b, format!("says what {a} says, too; give one of them")));
        }
    }
    Ok(())
}

/// A luminaire whose distribution begins at a place of the scene's table, with the flux of its file, lm.
fn build_luminaire(t: &LightTable, scale: f32, (distribution, flux): (u32, f64)) -> Result<Light, Fault> {
    let v = |x: Option<[f32; 3]>, without: Vec3| x.map_or(without, Vec3::from);
    let direction = v(t.direction, Vec3::NEG_Y);
    // Along x, but where the luminaire shines along x: then along z.
    let is_along_x = direction.cross(Vec3::X).length() < 1e-3 * direction.length();
    let c0 = v(t.c0, if is_along_x { Vec3::Z } else { Vec3::X });
    let position = v(t.position, Vec3::ZERO) * scale;
    let within = |key: &'static str, value: f32| match (0.0..=lights::QUANTITY_LIMIT).contains(&value) {
        true => Ok(f64::from(value)),
        false => Err((key, format!("{value} is no quantity of light; give a number that is not negative"))),
    };
    let flux = match (t.flux, t.dimming) {
        (Some(flux), _) => within("flux", flux)?,
        (_, dimming) => within("dimming", dimming.unwrap_or(1.0))? * flux,
    };
    let white = match (t.color, t.temperature) {
        (Some(color), _) => lights::white("color", Vec3::from(color))?,
        (_, Some(kelvin)) => lights::black_body(kelvin)?,
        _ => Vec3::ONE,
    };
    lights::luminaire(Mounting { position, direction, c0 }, flux, white, distribution)
}

fn build_light(t: &LightTable, scale: f32) -> Result<Light, Fault> {
    let v = |x: Option<[f32; 3]>| x.map_or(Vec3::ZERO, Vec3::from);
    match t.kind.as_str() {
        "directional" => lights::directional(v(t.direction), v(t.irradiance)),
        "point" => lights::point(v(t.position) * scale, v(t.intensity)),
        "spot" => {
            let inner = t.inner_degrees.unwrap_or(0.0);
            let outer = t.outer_degrees.unwrap_or(0.0);
            lights::spot(v(t.position) * scale, v(t.direction), v(t.intensity), inner, outer)
        }
        _ => lights::rect(v(t.corner) * scale, v(t.edge_a) * scale, v(t.edge_b) * scale, v(t.radiance)),
    }
}

fn read_sky(
    text: &Text,
    sky: &Spanned<SkyTable>,
    setting: &mut Setting,
    options: &LoadOptions,
    warnings: &mut Vec<String>,
) -> Result<(), ImportError> {
    let table = sky.as_ref();
    if table.radiance.is_none() && table.map.is_none() {
        return Err(text.value(
            sky.span(),
            "sky",
            "needs `radiance` (three numbers), `map` (an .hdr or .exr file), or both",
        ));
    }
    let radiance = table.radiance.map_or(Vec3::ONE, Vec3::from);
    let radiance = lights::check_color("radiance", radiance)
        .map_err(|(key, reason)| text.value(sky.span(), &format!("sky, {key}"), reason))?;
    setting.sky = Sky { radiance, ..Sky::default() };
    if let Some(map) = &table.map {
        let path = beside(text.path, map);
        let (texels, width, height) = super::pictures::read_sky(&path, options.texel_budget, warnings)
            .map_err(|reason| ImportError::SkyMap { path: path.clone(), reason })?;
        setting.files.push(path);
        setting.sky.map_width = width;
        setting.sky.map_height = height;
        setting.sky_map = texels;
    }
    Ok(())
}

fn build_track(t: &AnimationTable, lights: &[Light], scale: f32) -> Result<Track, Fault> {
    let index = t.index.unwrap_or(0);
    let target = match (t.target.as_str(), t.property.as_str()) {
        ("camera", "eye") => Target::CameraEye,
        ("camera", "target") => Target::CameraTarget,
        ("camera", _) => return Err(("property", format!("\"{}\" is not known; give eye or target", t.property))),
        ("light", property) => {
            let Some(light) = lights.get(index) else {
                return Err((
                    "index",
                    format!("light {index} does not exist; there are {}, counted from 0", lights.len()),
                ));
            };
            match property {
                "position" if light.kind != LIGHT_DIRECTIONAL => Target::LightPosition(index),
                "direction" if light.kind <= scene::gpu::LIGHT_SPOT && light.kind != LIGHT_POINT => {
                    Target::LightDirection(index)
                }
                "color" => Target::LightColor(index),
                "position" | "direction" => {
                    return Err(("property", format!("light {index} has no {property}; animate another property")));
                }
                _ => {
                    return Err((
                        "property",
                        format!("\"{property}\" is not known; give position, direction or color"),
                    ));
                }
            }
        }
        (other, _) => return Err(("target", format!("\"{other}\" is not known; give light or camera"))),
    };
    if t.keyframes.is_empty() {
        return Err(("keyframes", String::from("is empty; give at least one { time, value }")));
    }
    let mut keyframes: Vec<Keyframe> = Vec::with_capacity(t.keyframes.len());
    for k in &t.keyframes {
        let later = keyframes.last().is_none_or(|last| k.time > last.time);
        if !k.time.is_finite() || !later {
            return Err(("keyframes", format!("time {} is not after the one before; give ascending times", k.time)));
        }
        let value = Vec3::from(k.value);
        let value = match target {
            Target::LightDirection(_) => lights::check_direction("keyframes", value)?,
            Target::LightColor(_) => lights::check_color("keyframes", value)?,
            _ => lights::check_position("keyframes", value)? * scale,
        };
        keyframes.push(Keyframe { time: k.time, value });
    }
    Ok(Track { target, keyframes })
}
