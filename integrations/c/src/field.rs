//! The light of a bake: updates, points, lightmaps, pictures.

use std::ffi::{c_char, c_int};
use std::sync::Arc;

use patchlight::glam::{Vec2, Vec3};
use patchlight::low_level::operator::Codec;
use patchlight::method::{FeedbackSettings, TemporalSettings};
use patchlight::outputs::{LightPart, LiveLightmap};
use patchlight::{
    Camera, DeviceChoice, Executor, LightSettings, Lighting, MethodSettings, ObjectId, PictureRenderer,
    PictureSettings, Point, PointKind, PointSet, Silent, open,
};

use crate::bake::{PlBake, bake_of};
use crate::border::{
    Failure, Outcome, PlStatus, Sized32, free, give, guard, handle, input, room, structure, table, text, vector,
};
use crate::scene::PlLight;

/// How light goes between patches.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types)]
pub enum PlMethod {
    /// A product with the form factors for each bounce.
    PL_CLASSIC = 0,
    /// All bounces in one product with a compressed operator, of relative error `epsilon`; made when the field is, unless the
    /// bake has it.
    PL_LOW_RANK = 1,
    /// All bounces in one product with a dense operator.
    PL_DENSE = 2,
    /// One bounce an update, from the light of the update before.
    PL_FEEDBACK = 3,
    /// A few samples a row and update, from the light of the update before.
    PL_TEMPORAL = 4,
}

/// What is kept of each point.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types)]
pub enum PlPointKind {
    /// Irradiance for the point's normal: three numbers.
    PL_IRRADIANCE = 0,
    /// An ambient cube: irradiance for +x, -x, +y, -y, +z, -z: eighteen numbers.
    PL_CUBE = 1,
    /// Radiance as spherical harmonics of degree 1, L_00, L_1x, L_1y, L_1z: twelve numbers.
    PL_HARMONICS = 2,
}

/// Light in a lightmap.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types)]
pub enum PlLightPart {
    /// Reflected at least once: for engines that light directly themselves.
    PL_INDIRECT = 0,
    /// Direct and indirect.
    PL_FULL = 1,
    /// All but the direct light of lights: for engines that know nothing of surfaces that shine and of skies.
    PL_WITHOUT_LIGHTS = 2,
}

/// Settings of a light field.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct PlFieldSettings {
    /// sizeof(PlFieldSettings).
    pub struct_size: usize,
    /// A PlMethod.
    pub method: u32,
    /// Rays of each hemisphere of a point of pl_field_add_points.
    pub point_rays: u32,
    /// Relative error of PL_LOW_RANK and PL_FEEDBACK.
    pub epsilon: f64,
}

/// A place whose light is asked for, on a surface or in the air.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct PlPoint {
    /// Place, m.
    pub position: [f32; 3],
    /// Normal, any length.
    pub normal: [f32; 3],
}

/// A pinhole.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct PlCamera {
    /// sizeof(PlCamera).
    pub struct_size: usize,
    /// Place, m.
    pub eye: [f32; 3],
    /// A point in the middle of the picture, m.
    pub target: [f32; 3],
    /// Upwards, any length.
    pub up: [f32; 3],
    /// Vertical field of view, degrees.
    pub fov_degrees: f32,
}

// SAFETY: plain numbers.
unsafe impl Sized32 for PlFieldSettings {
    const NAME: &'static str = "PlFieldSettings";
}
// SAFETY: plain numbers.
unsafe impl Sized32 for PlCamera {
    const NAME: &'static str = "PlCamera";
}

/// The light of a bake on a device.
pub struct PlField {
    pub(crate) renderer: PictureRenderer,
    pub(crate) lighting: Lighting,
    sets: Vec<Option<(PointSet, usize)>>,
    /// The triangles on which it lies.
    lightmap: Option<(LiveLightmap, Vec<[Vec3; 3]>)>,
    pub(crate) objects: Vec<Option<ObjectId>>,
}

impl Default for PlFieldSettings {
    fn default() -> Self {
        let point_rays = LightSettings::default().point_rays;
        Self { struct_size: size_of::<Self>(), method: PlMethod::PL_CLASSIC as u32, point_rays, epsilon: 0.01 }
    }
}

impl Default for PlCamera {
    fn default() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            eye: [0.0, 0.0, 1.0],
            target: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            fov_degrees: 45.0,
        }
    }
}

impl PlFieldSettings {
    fn settings(&self) -> Outcome<LightSettings> {
        let method = match self.method {
            0 => MethodSettings::Classic,
            1 => MethodSettings::Multibounce(Codec::LowRank { epsilon: self.epsilon }),
            2 => MethodSettings::Multibounce(Codec::Dense),
            3 => MethodSettings::Feedback(FeedbackSettings::default()),
            4 => MethodSettings::Temporal(TemporalSettings::default()),
            method => return Err(input(format!("method is {method}; it is one of PlMethod"))),
        };
        Ok(LightSettings::default().with_method(method).with_point_rays(self.point_rays))
    }
}

impl PlField {
    /// A light field on an executor.
    pub(crate) fn new(bake: *const PlBake, settings: &PlFieldSettings, executor: Box<dyn Executor>) -> Outcome<Self> {
        let bake = bake_of(bake)?;
        let lighting = bake.scene().lighting.clone();
        let pictures = PictureSettings::default().with_size((8, 8)).with_sub_frames(1);
        let renderer = PictureRenderer::of_bake(bake, executor, &settings.settings()?, &pictures, &Silent)?;
        Ok(Self { renderer, lighting, sets: Vec::new(), lightmap: None, objects: Vec::new() })
    }

    fn set(&self, set: u32) -> Outcome<(PointSet, usize)> {
        let found = self.sets.get(set as usize).copied().flatten();
        found.ok_or_else(|| input(format!("point set {set} is not of this field")))
    }
}

/// Copies RGB into the caller's table, three numbers each.
fn copy(values: impl ExactSizeIterator<Item = Vec3>, out: &mut [f32], name: &str) -> Outcome {
    if out.len() != 3 * values.len() {
        return Err(input(format!("{name} has room for {} numbers; there are {}", out.len(), 3 * values.len())));
    }
    for (place, value) in out.chunks_exact_mut(3).zip(values) {
        place.copy_from_slice(&value.to_array());
    }
    Ok(())
}

/// Fills a structure with its size and defaults.
///
/// # Safety
/// `settings` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_settings_default(settings: *mut PlFieldSettings) {
    if !settings.is_null() {
        // SAFETY: as the caller promises.
        unsafe { settings.write(PlFieldSettings::default()) };
    }
}

/// Fills a structure with its size and defaults.
///
/// # Safety
/// `camera` is NULL or may be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_camera_default(camera: *mut PlCamera) {
    if !camera.is_null() {
        // SAFETY: as the caller promises.
        unsafe { camera.write(PlCamera::default()) };
    }
}

/// Puts a bake on a device: "cpu", "vulkan", "auto", a number or a part of a name; NULL for "cpu". The field keeps the bake.
///
/// # Safety
/// Pointers are what they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_new(
    bake: *const PlBake,
    settings: *const PlFieldSettings,
    device: *const c_char,
    out: *mut *mut PlField,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let settings = unsafe { structure(settings, PlFieldSettings::default()) }?;
        // SAFETY: as the caller promises.
        let device = if device.is_null() { "cpu" } else { unsafe { text(device, "device") }? };
        let (executor, _) = open(&DeviceChoice::parse(device)).map_err(patchlight::Error::from)?;
        // SAFETY: as the caller promises.
        unsafe { give(out, PlField::new(bake, &settings, executor)?) }
    })
}

/// Sets the lights of the next update, instead of those that there were; at first they are the scene's. A light that is
/// switched off best stays in the list with the color zero.
///
/// # Safety
/// `lights` begins `count` structures.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_set_lights(field: *mut PlField, lights: *const PlLight, count: usize) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        // SAFETY: as the caller promises.
        let lights = unsafe { table(lights, count, "lights") }?;
        if let Some(light) = lights.iter().find(|light| light.struct_size != size_of::<PlLight>()) {
            let size = size_of::<PlLight>();
            return Err(input(format!("struct_size of a light is {}; in a list each has {size}", light.struct_size)));
        }
        field.lighting.lights = lights.iter().map(PlLight::light).collect::<Outcome<_>>()?;
        Ok(())
    })
}

/// Sets a constant sky, three numbers, W/m²/sr, of the next update.
///
/// # Safety
/// `radiance` has three numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_set_sky(field: *mut PlField, radiance: *const f32) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        // SAFETY: as the caller promises.
        let own = unsafe { table(radiance, 3, "radiance") }?;
        let radiance = vector([own[0], own[1], own[2]], "radiance of the sky")?;
        field.lighting.sky = patchlight::scene::Sky { radiance, ..patchlight::scene::Sky::default() };
        field.lighting.sky_map = Arc::new([]);
        Ok(())
    })
}

/// Sets what a material shines with from the next update on, three numbers, W/m²/sr.
///
/// # Safety
/// `radiance` has three numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_set_emission(field: *mut PlField, material: u32, radiance: *const f32) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        // SAFETY: as the caller promises.
        let own = unsafe { table(radiance, 3, "radiance") }?;
        let radiance = vector([own[0], own[1], own[2]], "emission")?;
        let materials = field.renderer.light().bake().scene().geometry.materials.iter();
        if field.lighting.emission.is_empty() {
            field.lighting.emission = materials.map(|material| material.radiance).collect();
        }
        let count = field.lighting.emission.len();
        let place = field.lighting.emission.get_mut(material as usize);
        *place.ok_or_else(|| input(format!("material {material} of {count}")))? = radiance;
        Ok(())
    })
}

/// Finds the light. On a device the work is submitted and not waited for; what reads results waits.
///
/// # Safety
/// The handle is live.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_update(field: *mut PlField) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        field.renderer.light_mut().update(&field.lighting)?;
        Ok(())
    })
}

/// Indirect irradiance on the surfaces, W/m²: RGB at the `points` of pl_bake_counts. Waits.
///
/// # Safety
/// `rgb` has room for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_surface(field: *mut PlField, rgb: *mut f32, count: usize) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        // SAFETY: as the caller promises.
        let out = unsafe { room(rgb, count, "rgb") }?;
        copy(field.renderer.light_mut().surface_irradiance()?.into_iter(), out, "rgb")
    })
}

/// Adds points whose indirect light every update finds from now on, by a PlPointKind; their number goes to `out_set`. Their
/// rays are traced here, once.
///
/// # Safety
/// `points` begins `count` structures.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_add_points(
    field: *mut PlField,
    points: *const PlPoint,
    count: usize,
    kind: u32,
    out_set: *mut u32,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        // SAFETY: as the caller promises.
        let places = unsafe { table(points, count, "points") }?;
        let kind = match kind {
            0 => PointKind::Irradiance,
            1 => PointKind::Cube,
            2 => PointKind::HarmonicsL1,
            kind => return Err(input(format!("kind is {kind}; it is one of PlPointKind"))),
        };
        let place = |point: &PlPoint| {
            let normal = vector(point.normal, "normal of a point")?.normalize_or(Vec3::Y);
            Ok(Point { position: vector(point.position, "position of a point")?, normal })
        };
        let places = places.iter().map(place).collect::<Outcome<Vec<_>>>()?;
        let set = field.renderer.light_mut().add_points(&places, kind, &Silent)?;
        field.sets.push(Some((set, kind.values() * count)));
        // SAFETY: as the caller promises.
        unsafe { room(out_set, 1, "out_set") }?[0] = field.sets.len() as u32 - 1;
        Ok(())
    })
}

/// Removes points; others keep their numbers.
///
/// # Safety
/// The handle is live.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_remove_points(field: *mut PlField, set: u32) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        let (points, _) = field.set(set)?;
        field.renderer.light_mut().remove_points(points)?;
        field.sets[set as usize] = None;
        Ok(())
    })
}

/// The light of points after the last update: RGB of each value of each point. Waits.
///
/// # Safety
/// `values` has room for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_points(field: *mut PlField, set: u32, values: *mut f32, count: usize) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        let (points, _) = field.set(set)?;
        // SAFETY: as the caller promises.
        let out = unsafe { room(values, count, "values") }?;
        copy(field.renderer.light_mut().read(points)?.values.into_iter(), out, "values")
    })
}

/// The newest light of points that has arrived; waits for nothing. `out_is_new` becomes 0 where none has arrived yet, and then
/// the values stay as they are. From the first call on each update begins a copy.
///
/// # Safety
/// `values` has room for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_try_points(
    field: *mut PlField,
    set: u32,
    values: *mut f32,
    count: usize,
    out_is_new: *mut c_int,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        let (points, _) = field.set(set)?;
        // SAFETY: as the caller promises.
        let out = unsafe { room(values, count, "values") }?;
        // SAFETY: as the caller promises.
        let is_new = &mut unsafe { room(out_is_new, 1, "out_is_new") }?[0];
        *is_new = 0;
        if let Some(light) = field.renderer.light_mut().try_read(points)? {
            copy(light.values.iter().copied(), out, "values")?;
            *is_new = 1;
        }
        Ok(())
    })
}

/// Lays out a lightmap with texels of this size, m, and gives its size in texels. It lies on the caller's triangles: nine
/// numbers each, its corners, m, counter-clockwise from the front; NULL for those of the bake, which are cut where something
/// stands on them. A triangle has its front's light, or its back's where only that has any.
///
/// # Safety
/// `corners` is NULL or begins nine numbers for each of `triangle_count` triangles.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_make_lightmap(
    field: *mut PlField,
    corners: *const f32,
    triangle_count: usize,
    texel: f32,
    out_width: *mut u32,
    out_height: *mut u32,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        let bake = Arc::clone(field.renderer.light().bake());
        let triangles: Vec<[Vec3; 3]> = if corners.is_null() {
            let own = bake.scene().geometry.triangles.iter();
            own.map(|t| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b]).collect()
        } else {
            let count = triangle_count.checked_mul(9).ok_or_else(|| input("triangle_count is too large"))?;
            // SAFETY: as the caller promises.
            let numbers = unsafe { table(corners, count, "corners") }?;
            numbers.chunks_exact(9).map(|own| [0, 3, 6].map(|first| Vec3::from_slice(&own[first..]))).collect()
        };
        let lightmap = LiveLightmap::over(&bake, &triangles, texel)?;
        let (width, height) = lightmap.size();
        // SAFETY: as the caller promises.
        unsafe { room(out_width, 1, "out_width") }?[0] = width;
        // SAFETY: as the caller promises.
        unsafe { room(out_height, 1, "out_height") }?[0] = height;
        field.lightmap = Some((lightmap, triangles));
        Ok(())
    })
}

/// Texture coordinates in the lightmap of the corners of its triangles: six numbers each, NaN for those without light.
///
/// # Safety
/// `uvs` has room for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_lightmap_uvs(field: *mut PlField, uvs: *mut f32, count: usize) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        let (lightmap, triangles) = field.lightmap.as_ref().ok_or_else(no_lightmap)?;
        // SAFETY: as the caller promises.
        let out = unsafe { room(uvs, count, "uvs") }?;
        if out.len() != 6 * triangles.len() {
            let numbers = 6 * triangles.len();
            return Err(input(format!("uvs has room for {} numbers; there are {numbers}", out.len())));
        }
        for (place, uvs) in out.chunks_exact_mut(6).zip(lightmap.corner_uvs(triangles)) {
            let corners = uvs.unwrap_or([Vec2::NAN; 3]).map(|corner| corner.to_array());
            place.copy_from_slice(corners.as_flattened());
        }
        Ok(())
    })
}

fn no_lightmap() -> Failure {
    input("the field has no lightmap; call pl_field_make_lightmap first")
}

/// Number of triangles of the bake's scene, which are cut where something stands on them.
///
/// # Safety
/// The handle is live or NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_triangle_count(field: *const PlField) -> usize {
    // SAFETY: as the caller promises.
    unsafe { field.as_ref() }.map_or(0, |field| field.renderer.light().bake().scene().geometry.triangles.len())
}

/// Irradiance in the lightmap after the last update, W/m²: RGB of each texel, row by row, of a PlLightPart. Waits.
///
/// # Safety
/// `rgb` has room for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_lightmap(field: *mut PlField, part: u32, rgb: *mut f32, count: usize) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        // SAFETY: as the caller promises.
        let out = unsafe { room(rgb, count, "rgb") }?;
        let part = match part {
            0 => LightPart::Indirect,
            1 => LightPart::Full,
            2 => LightPart::WithoutLights,
            part => return Err(input(format!("part is {part}; it is one of PlLightPart"))),
        };
        let PlField { lightmap, renderer, .. } = field;
        let (lightmap, _) = lightmap.as_mut().ok_or_else(no_lightmap)?;
        let values = lightmap.irradiance(renderer.light_mut(), part)?;
        copy(lightmap.picture(&values).into_iter(), out, "rgb")
    })
}

/// A picture under the lights that are set: radiance, W/m²/sr, RGB of each pixel, row by row from the top. Waits.
///
/// # Safety
/// `rgb` has room for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_picture(
    field: *mut PlField,
    camera: *const PlCamera,
    width: u32,
    height: u32,
    sub_frames: u32,
    rgb: *mut f32,
    count: usize,
) -> PlStatus {
    guard(|| {
        // SAFETY: as the caller promises.
        let field = unsafe { handle(field, "field") }?;
        // SAFETY: as the caller promises.
        let view = unsafe { structure(camera, PlCamera::default()) }?;
        // SAFETY: as the caller promises.
        let out = unsafe { room(rgb, count, "rgb") }?;
        let pixels = 3 * width as usize * height as usize;
        if out.len() != pixels || pixels == 0 {
            return Err(input(format!(
                "rgb has room for {} numbers; {width} x {height} pixels have {pixels}",
                out.len()
            )));
        }
        let [eye, target, up] =
            [(view.eye, "eye"), (view.target, "target"), (view.up, "up")].map(|(values, name)| vector(values, name));
        let camera = Camera::look_at(eye?, target?, up?, view.fov_degrees, width, height);
        field.renderer.resize((width, height), sub_frames)?;
        let frame = field.renderer.picture(&field.lighting, &camera, 0)?;
        copy(frame.pictures.full.pixels.iter().copied(), out, "rgb")
    })
}

/// Ends a light field.
///
/// # Safety
/// It is NULL or not used again; recordings of it are finished on the device.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pl_field_free(field: *mut PlField) {
    // SAFETY: as the caller promises.
    unsafe { free(field) }
}
