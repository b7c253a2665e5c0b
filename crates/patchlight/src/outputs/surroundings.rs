//! Direct light of what does not move: surfaces that shine, and the sky.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{Vec3, Vec4};
use scene::gpu::DirectParams;
use scene::{Lighting, Scene, Sky, SurfacePoint};

use crate::bake::direct_params;
use crate::error::Error;

/// Points whose light is found at once.
const BLOCK: usize = 1 << 16;

/// Direct irradiance at fixed points from surfaces that shine and from the sky. It is linear in what they send, so that
/// rays are traced once for each material that shines and once for the sky's map; later calls multiply and add. What
/// moves does not stand in its way.
#[derive(Clone, Debug, Default)]
pub struct Surroundings {
    /// Irradiance where a material shines with 1 W/m²/sr, by its number.
    emission: BTreeMap<usize, Vec<Vec3>>,
    /// Irradiance under a sky whose radiance is multiplied by 1, and the map that it has.
    sky: Option<(Arc<[Vec4]>, Vec<Vec3>)>,
    rays: u32,
}

impl Surroundings {
    /// With so many rays from each point to each material that shines, and to the sky.
    pub fn with_rays(rays: u32) -> Self {
        Self { rays, ..Self::default() }
    }

    /// Adds the light at points, W/m². They and the scene's geometry are those of the first call.
    ///
    /// # Errors
    /// A lighting that does not fit the scene's materials.
    pub fn add(
        &mut self,
        scene: &Scene,
        points: &[SurfacePoint],
        lighting: &Lighting,
        values: &mut [Vec3],
    ) -> Result<(), Error> {
        let materials = &scene.geometry.materials;
        let of_scene: Vec<Vec3> = materials.iter().map(|material| material.radiance).collect();
        let emission = if lighting.emission.is_empty() { &of_scene } else { &lighting.emission };
        for (material, radiance) in emission.iter().enumerate().filter(|(_, radiance)| **radiance != Vec3::ZERO) {
            if !self.emission.contains_key(&material) {
                let mut emission = vec![Vec3::ZERO; materials.len()];
                if let Some(own) = emission.get_mut(material) {
                    *own = Vec3::ONE;
                }
                let unit = Lighting { emission, ..Lighting::default() };
                self.emission.insert(material, direct(scene, unit, points, (self.rays, 0))?);
            }
            values.iter_mut().zip(&self.emission[&material]).for_each(|(sum, share)| *sum += *radiance * *share);
        }
        if !lighting.has_sky() {
            return Ok(());
        }
        if self.sky.as_ref().is_none_or(|(map, _)| map != &lighting.sky_map) {
            let sky = Sky { radiance: Vec3::ONE, ..lighting.sky };
            let sky_map = Arc::clone(&lighting.sky_map);
            let unit = Lighting { sky, sky_map: Arc::clone(&sky_map), ..Lighting::default() };
            self.sky = Some((sky_map, direct(scene, unit, points, (0, self.rays))?));
        }
        if let Some((_, own)) = &self.sky {
            values.iter_mut().zip(own).for_each(|(sum, share)| *sum += lighting.sky.radiance * *share);
        }
        Ok(())
    }
}

/// Direct irradiance at points under a light, by so many rays to areas and to the sky.
fn direct(scene: &Scene, lighting: Lighting, points: &[SurfacePoint], rays: (u32, u32)) -> Result<Vec<Vec3>, Error> {
    let lit = Scene::under(Arc::clone(&scene.geometry), lighting)?;
    let params = DirectParams { area_rays: rays.0, sky_rays: rays.1, ..direct_params(&lit) };
    let blocks = points.chunks(BLOCK);
    let values = blocks.flat_map(|block| {
        let params = DirectParams { count: block.len() as u32, ..params };
        lit.direct_irradiance(&params, block)
    });
    Ok(values.collect())
}
