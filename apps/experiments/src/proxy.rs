//! Radiosity over the voxelisation proxy, the baseline that patches of the true surface are compared with.
//!
//! It solves the same equation with as many rays as the project's own patches. Patches of the proxy are the faces that light
//! comes to (faces towards closed spaces and those that see nothing are only in the way); direct light is measured on the
//! proxy, at points of its faces.

use std::f32::consts::PI;

use formfactor::{Hemisphere, Patch, Stop, Surfaces, balance, form_factors, jacobi};
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use reference::{Picture, ProxyLookup, VoxelProxy};
use scene::{
    Camera, DirectParams, LIGHT_RECT, Light, Material, NONE, Scene, SceneParts, SidePolicy, SurfacePoint, Triangle,
    TriangleUv, find_sides,
};

use crate::error::Error;
use crate::progress::{Progress, Steps};
use patchlight::PixelGather;
use patchlight::bake::direct_params;

/// Points along the edge of a face.
const FACE_POINTS: u32 = 4;
/// Bounces end when no face changes by more than this share of the brightest.
const TOLERANCE: f32 = 1e-5;

/// Settings of [`ProxyRadiosity::bake`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProxySettings {
    /// About how many faces that light comes to.
    pub patch_count: usize,
    /// Rays of a row of the form factors.
    pub rays: u32,
    /// Rays to area lights, and to a sky map, from each point of a face.
    pub point_rays: u32,
    /// Changes every random number.
    pub seed: u32,
}

/// The proxy of a scene, with the indirect light of its own lights.
pub struct ProxyRadiosity<'a> {
    scene: &'a Scene,
    proxy: VoxelProxy,
    /// Indirect irradiance of each face, W/m².
    light: Vec<Vec3>,
    patches: usize,
    seed: u32,
}

impl<'a> ProxyRadiosity<'a> {
    /// Makes the proxy, its form factors and all bounces of its light.
    ///
    /// # Errors
    /// A scene without area, settings out of range, cancellation.
    pub fn bake(scene: &'a Scene, settings: ProxySettings, progress: &Progress) -> Result<Self, Error> {
        let ProxySettings { patch_count, seed, .. } = settings;
        let mut proxy = progress.phase("voxel proxy", |_| -> Result<_, Error> {
            let panels = with_panels(scene)?;
            let original = panels.as_ref().unwrap_or(scene);
            Ok(VoxelProxy::for_count(original, patch_count, |proxy| patches_of(proxy).1)?)
        })?;
        let (numbers, patches) = patches_of(&proxy);
        let light = progress.phase("form_factors", |report| solve(&proxy, &numbers, &settings, report))?;
        proxy.hide_faces(|face| numbers[face as usize] == NONE);
        Ok(Self { scene, proxy, light, patches, seed })
    }

    /// Faces that take part in radiosity.
    pub fn patch_count(&self) -> usize {
        self.patches
    }

    /// All faces.
    pub fn face_count(&self) -> usize {
        self.proxy.faces.len()
    }

    /// Edge of a voxel, m.
    pub fn edge(&self) -> f32 {
        self.proxy.edge
    }

    /// Indirect irradiance at points of the true surface, W/m².
    ///
    /// # Errors
    /// A normal that is no direction.
    pub fn irradiance_at(&self, points: &[SurfacePoint], lookup: ProxyLookup) -> Result<Vec<Vec3>, Error> {
        Ok(self.values_at(points, lookup)?)
    }

    fn values_at(&self, points: &[SurfacePoint], lookup: ProxyLookup) -> Result<Vec<Vec3>, reference::Error> {
        points.par_iter().map(|p| self.proxy.value_at(&self.light, p.position, p.normal, lookup)).collect()
    }

    /// Indirect radiance that a camera sees of the true surface, W/m²/sr, in so many sub-frames.
    ///
    /// # Errors
    /// None for a sound scene.
    pub fn indirect(&self, camera: &Camera, sub_frames: u32, lookup: ProxyLookup) -> Result<Picture, Error> {
        let gather = |points: &[SurfacePoint], _: u32| match self.values_at(points, lookup) {
            Ok(values) => Ok(values.iter().map(|h| h.extend(0.0)).collect()),
            Err(error) => Err(patches::Error::Rows(Box::new(error)).into()),
        };
        let pixels = PixelGather {
            scene: self.scene,
            gather: &gather,
            lights: &self.scene.lighting.lights,
            camera,
            frame: 0,
            sub_frames,
            seed: self.seed,
        };
        Ok(pixels.indirect()?)
    }
}

/// The scene with its rectangle lights as luminous panels, where it has any: a lamp close below a ceiling would be inside of
/// the ceiling's voxels and light nothing, while the light of a surface leaves from the faces of its voxels.
fn with_panels(scene: &Scene) -> Result<Option<Scene>, Error> {
    let (panels, lights): (Vec<Light>, Vec<Light>) =
        scene.lighting.lights.iter().partition(|light| light.kind == LIGHT_RECT);
    if panels.is_empty() {
        return Ok(None);
    }
    let mut parts = SceneParts {
        triangles: scene.geometry.triangles.clone(),
        uvs: scene.geometry.uvs.clone(),
        materials: scene.materials.to_vec(),
        textures: scene.geometry.textures.clone(),
        texels: scene.geometry.texels.clone(),
        lights,
        sky: scene.lighting.sky,
        sky_map: scene.lighting.sky_map.to_vec(),
        distributions: scene.lighting.distributions.to_vec(),
        ray_offset: None,
        absorption: scene.geometry.absorption,
    };
    for Light { position, color, edge_a, edge_b, .. } in panels {
        let material = parts.materials.len() as u32;
        parts.materials.push(Material { radiance: color, ..Material::default() });
        for (edge_a, edge_b) in [(edge_a, edge_a + edge_b), (edge_a + edge_b, edge_b)] {
            parts.triangles.push(Triangle { corner: position, material, edge_a, edge_b, ..Triangle::default() });
            parts.uvs.push(TriangleUv::default());
        }
    }
    Ok(Some(Scene::new(parts).map_err(reference::Error::from)?))
}

/// The faces that take part in radiosity: the patch of each face, or [`NONE`], and how many there are.
fn patches_of(proxy: &VoxelProxy) -> (Vec<u32>, usize) {
    let sides = find_sides(&proxy.scene, SidePolicy::Lit);
    let mut takes_part = vec![false; proxy.faces.len()];
    for (t, side) in proxy.scene.geometry.triangles.iter().zip(sides) {
        takes_part[t.material as usize] |= side.front;
    }
    let mut count = 0;
    let number = |used: bool| {
        count += usize::from(used);
        if used { count as u32 - 1 } else { NONE }
    };
    (takes_part.into_iter().map(number).collect(), count)
}

/// Indirect irradiance of all faces, W/m², by the patch of each; faces that take no part have none.
fn solve(proxy: &VoxelProxy, numbers: &[u32], settings: &ProxySettings, report: &Steps) -> Result<Vec<Vec3>, Error> {
    let is_patch = |face: u32| numbers[face as usize] != NONE;
    let faces = || proxy.faces.iter().zip(0..).filter(|(_, face)| is_patch(*face));
    let patches: Vec<Patch> = faces()
        .map(|(f, _)| Patch { centroid: f.centre, area: proxy.face_area(), normal: f.normal, triangle: NONE })
        .collect();
    let points: Vec<SurfacePoint> = proxy.points(FACE_POINTS).into_iter().filter(|p| is_patch(p.patch)).collect();
    let own = (FACE_POINTS * FACE_POINTS) as usize;
    let offsets: Vec<u32> = (0..=patches.len()).map(|k| (k * own) as u32).collect();
    let surfaces = Surfaces {
        patches: &patches,
        polygons: &[],
        row_polygons: &[],
        points: &points,
        offsets: &offsets,
        visibility: &proxy.scene,
        owner: Box::new(|hit, direction| match proxy.face_of(hit, direction) {
            NONE => NONE,
            face => numbers[face as usize],
        }),
        ray_offset: proxy.scene.geometry.ray_offset,
        seed: settings.seed,
    };
    let mut rows = form_factors(&Hemisphere { rays: settings.rays }, &surfaces, &report)?;
    let areas = vec![proxy.face_area(); patches.len()];
    balance(&mut rows.factors, &mut rows.sky_factor, &areas, None)?;

    let scene = &proxy.scene;
    let has_map = scene.lighting.sky.map_width > 0;
    let params = DirectParams {
        count: points.len() as u32,
        area_rays: settings.point_rays,
        sky_rays: if has_map { settings.point_rays } else { 0 },
        seed: settings.seed,
        ..direct_params(scene)
    };
    let direct = scene.direct_irradiance(&params, &points);
    let sky = if has_map { Vec3::ZERO } else { scene.lighting.sky.radiance * PI };
    let albedo: Vec<Vec4> = faces().map(|(f, _)| f.albedo.extend(0.0)).collect();
    let source: Vec<Vec4> = (0..patches.len())
        .map(|i| {
            let mean: Vec3 = (i * own..(i + 1) * own).map(|k| direct[k] * points[k].weight).sum();
            albedo[i] * (mean + sky * rows.sky_factor[i]).extend(0.0)
        })
        .collect();
    let light = jacobi(&rows.factors, &source, &albedo, Stop::Tolerance(TOLERANCE))?;
    let of_patch = |&patch: &u32| if patch == NONE { Vec3::ZERO } else { light.irradiance[patch as usize].truncate() };
    Ok(numbers.iter().map(of_patch).collect())
}
