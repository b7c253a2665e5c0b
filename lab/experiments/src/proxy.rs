//! Radiosity over the voxelisation proxy, the baseline that patches of the true surface are compared with.
//!
//! It solves the same equation with as many rays as the project's own patches. Patches of the proxy are the faces that
//! light comes to (faces towards closed spaces and those that see nothing are only in the way); direct light is
//! measured on the proxy, at points of its faces.

use std::f32::consts::PI;
use std::sync::Arc;

use formfactor::{FactorRows, Hemisphere, Patch, Stop, Surfaces, balance, form_factors, jacobi};
use glam::{Vec3, Vec4};
use opponents::{ProxyFace, ProxyLookup, VoxelProxy};
use rayon::prelude::*;
use reference::Picture;
use scene::gpu::{DirectParams, LIGHT_RECT, Triangle, TriangleUv};
use scene::{Camera, Light, Lighting, Material, NONE, Scene, SceneParts, SidePolicy, SurfacePoint, find_sides};

use crate::error::Error;
use crate::progress::{Progress, Steps};
use patchlight::PixelGather;
use patchlight::bake::direct_params;

/// Points along the edge of a face.
const FACE_POINTS: u32 = 4;
/// Points along each edge of a rectangle light that share out its light to faces.
const PANEL_POINTS: u32 = 32;
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

/// The proxy of a scene, with the indirect light of the lights that shine on it.
pub struct ProxyRadiosity<'a> {
    scene: &'a Scene,
    proxy: VoxelProxy,
    /// The patch of each face, or [`NONE`].
    numbers: Vec<u32>,
    /// Points of the faces that are patches.
    points: Vec<SurfacePoint>,
    rows: FactorRows,
    albedo: Vec<Vec4>,
    settings: ProxySettings,
    /// Indirect irradiance of each face, W/m².
    light: Vec<Vec3>,
}

impl<'a> ProxyRadiosity<'a> {
    /// Makes the proxy, its form factors and all bounces of the light of the scene's own lights.
    ///
    /// # Errors
    /// A scene without area, settings out of range, cancellation.
    pub fn bake(scene: &'a Scene, settings: ProxySettings, progress: &Progress) -> Result<Self, Error> {
        let (proxy, numbers) = progress.phase("voxel proxy", |_| -> Result<_, Error> {
            let panels = with_panels(scene)?;
            let original = panels.as_ref().unwrap_or(scene);
            let proxy = VoxelProxy::for_count(original, settings.patch_count, |proxy| {
                lit_faces(proxy, &scene.lighting).map_or(0, |numbers| count(&numbers))
            })?;
            let numbers = lit_faces(&proxy, &scene.lighting)?;
            Ok((proxy, numbers))
        })?;
        let points = proxy.points(FACE_POINTS).into_iter().filter(|p| numbers[p.patch as usize] != NONE).collect();
        let own = |number: &(&ProxyFace, &u32)| *number.1 != NONE;
        let albedo = proxy.faces.iter().zip(&numbers).filter(own).map(|(face, _)| face.albedo.extend(0.0)).collect();
        let rows = FactorRows::default();
        let mut found = Self { scene, proxy, numbers, points, rows, albedo, settings, light: Vec::new() };
        found.rows = progress.phase("form_factors", |report| found.form_factors(report))?;
        found.update(&scene.lighting)?;
        let numbers = &found.numbers;
        found.proxy.hide_faces(|face| numbers[face as usize] == NONE);
        Ok(found)
    }

    /// Faces that take part in radiosity.
    pub fn patch_count(&self) -> usize {
        self.albedo.len()
    }

    /// All faces.
    pub fn face_count(&self) -> usize {
        self.proxy.faces.len()
    }

    /// Edge of a voxel, m.
    pub fn edge(&self) -> f32 {
        self.proxy.edge
    }

    /// Bytes of what a light update reads: faces, their points, form factors, albedo and light.
    pub fn bytes(&self) -> u64 {
        let tables = size_of_val(&self.proxy.faces[..])
            + size_of_val(&self.numbers[..])
            + size_of_val(&self.points[..])
            + size_of_val(&self.rows.sky_factor[..])
            + size_of_val(&self.albedo[..])
            + size_of_val(&self.light[..]);
        (tables + size_of_val(&self.rows.factors.values[..])) as u64
    }

    /// All bounces of other lights. Where their rectangles were when the proxy was made, voxels stay occupied.
    ///
    /// # Errors
    /// Lighting that does not suit the scene.
    pub fn update(&mut self, lighting: &Lighting) -> Result<(), Error> {
        let source = self.source(&lit(&self.proxy, lighting)?);
        let found = jacobi(&self.rows.factors, &source, &self.albedo, Stop::Tolerance(TOLERANCE))?;
        let of_patch = |&patch: &u32| match patch {
            NONE => Vec3::ZERO,
            patch => found.irradiance[patch as usize].truncate(),
        };
        self.light = self.numbers.iter().map(of_patch).collect();
        Ok(())
    }

    /// Indirect irradiance at points of the true surface, W/m². None where no face that light comes to faces as the
    /// point does: the proxy may lack a whole side of a thing that is thinner than its voxels.
    pub fn irradiance_at(&self, points: &[SurfacePoint], lookup: ProxyLookup) -> Vec<Vec3> {
        let of_point = |p: &SurfacePoint| {
            self.proxy.weights_at(p.position, p.normal, lookup).map_or(Vec3::ZERO, |weights| -> Vec3 {
                weights.iter().map(|&(face, weight)| self.light[face as usize] * weight).sum()
            })
        };
        points.par_iter().map(of_point).collect()
    }

    /// Indirect radiance that a camera sees of the true surface, W/m²/sr, in so many sub-frames.
    ///
    /// # Errors
    /// None for a sound scene.
    pub fn indirect(&self, camera: &Camera, sub_frames: u32, lookup: ProxyLookup) -> Result<Picture, Error> {
        let gather = |points: &[SurfacePoint], _: u32| {
            Ok(self.irradiance_at(points, lookup).iter().map(|h| h.extend(0.0)).collect())
        };
        let pixels = PixelGather {
            scene: self.scene,
            gather: &gather,
            lights: &self.scene.lighting.lights,
            camera,
            frame: 0,
            sub_frames,
            seed: self.settings.seed,
        };
        Ok(pixels.indirect()?)
    }

    /// Form factors between the faces that are patches.
    fn form_factors(&self, report: &Steps) -> Result<FactorRows, Error> {
        let proxy = &self.proxy;
        let patches: Vec<Patch> = proxy
            .faces
            .iter()
            .zip(&self.numbers)
            .filter(|number| *number.1 != NONE)
            .map(|(f, _)| Patch { centroid: f.centre, area: proxy.face_area(), normal: f.normal, triangle: NONE })
            .collect();
        let offsets: Vec<u32> = (0..=patches.len() as u32).map(|k| k * FACE_POINTS * FACE_POINTS).collect();
        let surfaces = Surfaces {
            patches: &patches,
            polygons: &[],
            row_polygons: &[],
            points: &self.points,
            offsets: &offsets,
            visibility: &proxy.scene,
            owner: Box::new(|hit, direction| match proxy.face_of(hit, direction) {
                NONE => NONE,
                face => self.numbers[face as usize],
            }),
            ray_offset: proxy.scene.geometry.ray_offset,
            seed: self.settings.seed,
        };
        let mut rows = form_factors(&Hemisphere { rays: self.settings.rays }, &surfaces, &report)?;
        let areas = vec![proxy.face_area(); patches.len()];
        balance(&mut rows.factors, &mut rows.sky_factor, &areas, None)?;
        Ok(rows)
    }

    /// First exitance of the patches, W/m², of the proxy under some lights.
    fn source(&self, scene: &Scene) -> Vec<Vec4> {
        let has_map = scene.lighting.sky.map_width > 0;
        let ProxySettings { point_rays, seed, .. } = self.settings;
        let params = DirectParams {
            count: self.points.len() as u32,
            area_rays: point_rays,
            sky_rays: if has_map { point_rays } else { 0 },
            seed,
            ..direct_params(scene)
        };
        let direct = scene.direct_irradiance(&params, &self.points);
        let sky = if has_map { Vec3::ZERO } else { scene.lighting.sky.radiance * PI };
        let own = (FACE_POINTS * FACE_POINTS) as usize;
        let exitance = |(i, albedo): (usize, &Vec4)| {
            let mean: Vec3 = (i * own..(i + 1) * own).map(|k| direct[k] * self.points[k].weight).sum();
            *albedo * (mean + sky * self.rows.sky_factor[i]).extend(0.0)
        };
        self.albedo.iter().enumerate().map(exitance).collect()
    }
}

/// Rectangle lights, and the others.
fn panels_of(lights: &[Light]) -> (Vec<Light>, Vec<Light>) {
    lights.iter().partition(|light| light.kind == LIGHT_RECT)
}

/// The scene with black panels in place of its rectangle lights, where it has any: their voxels are occupied, as those
/// of other things are.
fn with_panels(scene: &Scene) -> Result<Option<Scene>, Error> {
    let (panels, lights) = panels_of(&scene.lighting.lights);
    if panels.is_empty() {
        return Ok(None);
    }
    let mut parts = SceneParts {
        triangles: scene.geometry.triangles.clone(),
        uvs: scene.geometry.uvs.clone(),
        materials: scene.materials.to_vec(),
        textures: scene.geometry.textures.clone(),
        texels: scene.geometry.texels.to_vec(),
        lights,
        sky: scene.lighting.sky,
        sky_map: scene.lighting.sky_map.to_vec(),
        distributions: scene.lighting.distributions.to_vec(),
        ray_offset: None,
        absorption: scene.geometry.absorption,
        ..SceneParts::default()
    };
    let material = parts.materials.len() as u32;
    parts.materials.push(Material::default());
    for Light { position, edge_a, edge_b, .. } in panels {
        for (edge_a, edge_b) in [(edge_a, edge_a + edge_b), (edge_a + edge_b, edge_b)] {
            parts.triangles.push(Triangle { corner: position, material, edge_a, edge_b, ..Triangle::default() });
            parts.uvs.push(TriangleUv::default());
        }
    }
    Ok(Some(Scene::new(parts).map_err(reference::Error::from)?))
}

/// The proxy under some lights. A rectangle light shines from the faces of its voxels, with the same power: close below
/// a ceiling it would be inside of the ceiling's voxels and light nothing.
fn lit(proxy: &VoxelProxy, lighting: &Lighting) -> Result<Scene, Error> {
    let (panels, lights) = panels_of(&lighting.lights);
    let mut emission: Vec<Vec3> = proxy.faces.iter().map(|face| face.radiance).collect();
    for Light { position, color, edge_a, edge_b, .. } in panels {
        let across = edge_a.cross(edge_b);
        let share = across.length() / (proxy.face_area() * (PANEL_POINTS * PANEL_POINTS) as f32);
        let place = |k: u32| (k as f32 + 0.5) / PANEL_POINTS as f32;
        for k in 0..PANEL_POINTS * PANEL_POINTS {
            let point = position + edge_a * place(k % PANEL_POINTS) + edge_b * place(k / PANEL_POINTS);
            if let Some(face) = proxy.face_at(point, across) {
                emission[face as usize] += color * share;
            }
        }
    }
    let Lighting { sky, sky_map, distributions, .. } = lighting.clone();
    let lighting = Lighting { lights, sky, sky_map, emission, distributions };
    Ok(Scene::under(Arc::clone(&proxy.scene.geometry), lighting).map_err(reference::Error::from)?)
}

/// The faces that take part in radiosity under some lights: the patch of each face, or [`NONE`].
fn lit_faces(proxy: &VoxelProxy, lighting: &Lighting) -> Result<Vec<u32>, Error> {
    let scene = lit(proxy, lighting)?;
    let sides = find_sides(&scene, SidePolicy::Lit);
    let mut takes_part = vec![false; proxy.faces.len()];
    for (t, side) in scene.geometry.triangles.iter().zip(sides) {
        takes_part[t.material as usize] |= side.front;
    }
    let mut patches = 0;
    let number = |used: bool| {
        patches += u32::from(used);
        if used { patches - 1 } else { NONE }
    };
    Ok(takes_part.into_iter().map(number).collect())
}

/// Faces that are patches.
fn count(numbers: &[u32]) -> usize {
    numbers.iter().filter(|number| **number != NONE).count()
}
