//! Bevy's lights as those of a light field.
//!
//! Bevy's quantities are photometric and ours radiometric, but light is linear: lux stand for W/m², candela for W/sr,
//! cd/m² for W/m²/sr, here and in all that comes back.

use std::f32::consts::PI;
use std::sync::Arc;

use bevy::asset::{AssetId, Assets};
use bevy::camera::Exposure;
use bevy::ecs::prelude::*;
use bevy::ecs::system::SystemParam;
use bevy::image::Image;
use bevy::light::{
    AmbientLight, DirectionalLight, EnvironmentMapLight, GlobalAmbientLight, PointLight, RectLight, SpotLight,
};
use bevy::pbr::StandardMaterial;
use bevy::prelude::{Camera, Camera3d, Color, ColorToComponents, GlobalTransform, InheritedVisibility};
use patchlight::glam::{Quat, Vec3, Vec4};
use patchlight::scene::gpu::LIGHT_LUMINAIRE;
use patchlight::scene::{Distribution, Sky, SurfaceLight};
use patchlight::{Intensity, Irradiance, Light, Lighting, Radiance};

use crate::sky::{self, SkyMap};

/// Steps of the angle in which the fall-off of a spot is told.
const SPOT_STEPS: usize = 256;
/// Narrowest fringe of a spot, radians.
const SPOT_FRINGE: f32 = 1e-3;

type Seen = Option<&'static InheritedVisibility>;
type View =
    (&'static Camera, Option<&'static Exposure>, Option<&'static AmbientLight>, Option<&'static EnvironmentMapLight>);

/// What shines in a world.
#[derive(SystemParam)]
pub(crate) struct Lamps<'w, 's> {
    suns: Query<'w, 's, (&'static DirectionalLight, &'static GlobalTransform, Seen)>,
    points: Query<'w, 's, (&'static PointLight, &'static GlobalTransform, Seen)>,
    spots: Query<'w, 's, (&'static SpotLight, &'static GlobalTransform, Seen)>,
    rectangles: Query<'w, 's, (&'static RectLight, &'static GlobalTransform, Seen)>,
    ambient: Res<'w, GlobalAmbientLight>,
    views: Query<'w, 's, View, With<Camera3d>>,
    materials: Res<'w, Assets<StandardMaterial>>,
    images: Res<'w, Assets<Image>>,
}

/// The light of a moment.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LampsNow {
    pub lighting: Lighting,
    /// True if the sky is Bevy's ambient light, which Bevy adds itself to what has no lightmap.
    pub has_ambient: bool,
}

impl LampsNow {
    /// True if surfaces that shine and the sky send what others do.
    pub fn has_same_surroundings(&self, other: &Self) -> bool {
        let of = |own: &Self| (own.has_ambient, own.lighting.sky);
        of(self) == of(other)
            && self.lighting.emission == other.lighting.emission
            && self.lighting.sky_map == other.lighting.sky_map
    }
}

/// Which lights are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    /// Those that are on.
    Shining,
    /// All there are, each as if it were on: where light may come one day.
    Possible,
}

impl Lamps<'_, '_> {
    /// The lights as they are now; emission of these materials, the first of which is number 1.
    pub fn now(&self, materials: &[AssetId<StandardMaterial>], map: &mut SkyMap, which: Which) -> LampsNow {
        let all = which == Which::Possible;
        let is_on = |seen: Option<&InheritedVisibility>| all || seen.is_none_or(|seen| seen.get());
        let power = |color: Color, size: f32| {
            let color = Vec3::from(color.to_linear().to_f32_array_no_alpha()) * size;
            if all { Vec3::ONE } else { color }
        };
        let mut lights = Vec::new();
        let mut distributions = Vec::new();
        for (sun, place, seen) in &self.suns {
            if is_on(seen) {
                let light = Irradiance(power(sun.color, sun.illuminance));
                lights.push(Light::sun(vector(place.forward().as_vec3()), light));
            }
        }
        for (lamp, place, seen) in &self.points {
            if is_on(seen) {
                let candela = power(lamp.color, lamp.intensity / (4.0 * PI));
                lights.push(Light::point(vector(place.translation()), Intensity(candela)));
            }
        }
        for (lamp, place, seen) in &self.spots {
            if is_on(seen) {
                let candela = power(lamp.color, lamp.intensity / (4.0 * PI));
                let angles = (lamp.inner_angle, lamp.outer_angle);
                lights.extend(spot(place, angles, candela, &mut distributions));
            }
        }
        for (lamp, place, seen) in &self.rectangles {
            if is_on(seen) {
                lights.extend(rectangle(lamp, place, power(lamp.color, lamp.intensity)));
            }
        }
        let lit = |light: &Light| light.color != Vec3::ZERO;
        lights.retain(lit);
        let (sky, sky_map, has_ambient) = self.sky(map);
        let emission = self.emission(materials);
        let distributions = Arc::from(distributions);
        LampsNow { lighting: Lighting { lights, sky, sky_map, emission, distributions }, has_ambient }
    }

    /// Radiance of the surfaces of each material, as the camera shows it.
    fn emission(&self, materials: &[AssetId<StandardMaterial>]) -> Vec<Vec3> {
        let exposure = self.view().and_then(|view| view.1).cloned().unwrap_or_default().exposure();
        let of = |material: &StandardMaterial| {
            let weight = material.emissive_exposure_weight;
            let factor = weight + (1.0 - weight) / exposure;
            Vec3::from(material.emissive.to_f32_array_no_alpha()) * factor * self.mean_of_emissive(material)
        };
        let own = materials.iter().map(|&id| self.materials.get(id).map_or(Vec3::ZERO, of));
        std::iter::once(Vec3::ZERO).chain(own).collect()
    }

    /// Mean of the texture by which an emission is multiplied.
    fn mean_of_emissive(&self, material: &StandardMaterial) -> Vec3 {
        let texture =
            material.emissive_texture.as_ref().filter(|_| material.emissive != bevy::color::LinearRgba::BLACK);
        let Some(image) = texture.and_then(|handle| self.images.get(handle)) else { return Vec3::ONE };
        sky::mean_color(image).unwrap_or(Vec3::ONE)
    }

    /// The active camera of the highest order.
    fn view(&self) -> Option<ViewItem<'_>> {
        self.views.iter().filter(|view| view.0.is_active).max_by_key(|view| view.0.order)
    }

    fn sky(&self, map: &mut SkyMap) -> (Sky, Arc<[Vec4]>, bool) {
        let view = self.view();
        if let Some(environment) = view.and_then(|view| view.3)
            && let Some(texels) = map.of(environment, &self.images)
        {
            let (map_width, map_height) = sky::MAP_SIZE;
            let radiance = Vec3::splat(environment.intensity);
            return (Sky { radiance, map_width, map_height, ..Sky::default() }, texels, false);
        }
        let global = (self.ambient.color, self.ambient.brightness);
        let (color, brightness) = view.and_then(|view| view.2).map_or(global, |own| (own.color, own.brightness));
        let radiance = Vec3::from(color.to_linear().to_f32_array_no_alpha()) * brightness;
        (Sky { radiance, ..Sky::default() }, Arc::new([]), radiance != Vec3::ZERO)
    }
}

type ViewItem<'a> = (&'a Camera, Option<&'a Exposure>, Option<&'a AmbientLight>, Option<&'a EnvironmentMapLight>);

/// A vector of Bevy's as one of ours: the two have different versions of glam.
pub(crate) fn vector(v: bevy::math::Vec3) -> Vec3 {
    Vec3::from(v.to_array())
}

/// A rotation of Bevy's as one of ours.
pub(crate) fn rotation(q: bevy::math::Quat) -> Quat {
    Quat::from_array(q.to_array())
}

/// A spot as Bevy has it: its intensity falls with the square of the cosine's way from the outer to the inner angle.
fn spot(place: &GlobalTransform, (inner, outer): (f32, f32), candela: Vec3, table: &mut Vec<f32>) -> Option<Light> {
    let inner = inner.min(outer - SPOT_FRINGE).max(0.0);
    let (cos_inner, cos_outer) = (f64::from(inner).cos(), f64::from(outer).cos());
    let share = |gamma: f64| ((gamma.cos() - cos_outer) / (cos_inner - cos_outer)).clamp(0.0, 1.0).powi(2);
    let gammas: Vec<f64> = (0..=SPOT_STEPS).map(|k| f64::from(outer) * k as f64 / SPOT_STEPS as f64).collect();
    let shares = gammas.iter().map(|&gamma| share(gamma)).collect();
    let degrees = gammas.iter().map(|gamma| gamma.to_degrees()).collect();
    let own = Distribution::new(degrees, vec![0.0], shares).ok()?;
    let distribution = own.append_to(table).ok()?;
    Some(Light {
        kind: LIGHT_LUMINAIRE,
        position: vector(place.translation()),
        direction: vector(place.forward().as_vec3()),
        edge_a: vector(place.right().as_vec3()),
        color: candela * own.mean() as f32,
        distribution,
        ..Light::default()
    })
}

/// A rectangle that shines along its −z, by its flux.
fn rectangle(lamp: &RectLight, place: &GlobalTransform, lumens: Vec3) -> Option<Light> {
    let affine = place.affine();
    let right = vector(affine.matrix3.x_axis.into()) * lamp.width;
    let up = vector(affine.matrix3.y_axis.into()) * lamp.height;
    let area = right.length() * up.length();
    let corner = vector(place.translation()) - 0.5 * (right + up);
    (area > 0.0 && area.is_finite()).then(|| {
        let radiance = Radiance(lumens / (PI * area));
        Light::rectangle(corner, (up, right), SurfaceLight::Radiance(radiance))
    })
}

/// The lights of a world as Patchlight takes them, after transforms were propagated: for light fields of one's own. Lux
/// stand for W/m², candela for W/sr, cd/m² for W/m²/sr.
pub fn lights_of(world: &mut World) -> Lighting {
    let mut state = bevy::ecs::system::SystemState::<Lamps>::new(world);
    // Without Bevy's assets and light there are no lights.
    let Ok(lamps) = state.get(world) else { return Lighting::default() };
    let now = lamps.now(&[], &mut SkyMap::default(), Which::Shining);
    Lighting { emission: Vec::new(), ..now.lighting }
}
