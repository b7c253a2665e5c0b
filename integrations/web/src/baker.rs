//! A scene of arrays, baked where the module runs, level by level.

use std::cell::RefCell;

use patchlight::glam::{Vec2, Vec3};
use patchlight::refine::levels;
use patchlight::transport::{Observer, Phase, Proceed};
use patchlight::{Bake, BakeSettings, Material, MaterialId, Mesh, Radiance, Scene, SceneBuilder};
use wasm_bindgen::prelude::*;

use crate::field::{LightField, radiance, text};
use crate::lights::lights;

#[wasm_bindgen]
extern "C" {
    /// What a page hears of a bake.
    pub type Listener;

    /// A phase is so far, 0 to 1.
    #[wasm_bindgen(method)]
    fn heard(this: &Listener, phase: &str, share: f64);
}

thread_local! {
    /// Who listens to the bake under way: an observer can hold nothing of a page.
    static LISTENER: RefCell<Option<Listener>> = const { RefCell::new(None) };
}

/// Tells the listener.
struct Telling;

impl Observer for Telling {
    fn progress(&self, Phase(name): Phase, done: u64, total: u64) -> Proceed {
        LISTENER.with_borrow(|listener| {
            if let Some(listener) = listener {
                listener.heard(name, done as f64 / total.max(1) as f64);
            }
        });
        Proceed::Continue(())
    }
}

/// A scene that is being put together, and then baked: a coarse level first, each finer one from the scene anew.
#[wasm_bindgen]
pub struct Baker {
    builder: Option<SceneBuilder>,
    materials: Vec<MaterialId>,
    scene: Option<Scene>,
    levels: Vec<BakeSettings>,
}

impl Default for Baker {
    fn default() -> Self {
        Self::new()
    }
}

#[wasm_bindgen]
impl Baker {
    /// Begins a scene. Material 0 is grey of 0.5.
    #[wasm_bindgen(constructor)]
    pub fn new() -> Self {
        let materials = vec![MaterialId::default()];
        Self { builder: Some(Scene::builder()), materials, scene: None, levels: Vec::new() }
    }

    /// Adds a material by its reflectance, 0 to 0.95, and what its front shines with, W/m²/sr; its number.
    ///
    /// # Errors
    /// Numbers that are no colours; a scene that is being baked.
    pub fn add_material(&mut self, reflectance: &[f32], emission: &[f32]) -> Result<usize, String> {
        let color = |numbers: &[f32]| match *numbers {
            [red, green, blue] => radiance(red, green, blue),
            _ => Err(format!("a color has 3 numbers, not {}", numbers.len())),
        };
        let material = Material::diffuse(color(reflectance)?).with_emission(Radiance(color(emission)?));
        let id = self.building()?.add_material(material);
        self.materials.push(id);
        Ok(self.materials.len() - 1)
    }

    /// Adds a mesh in its place, m: three numbers a vertex, three vertices a triangle, counter-clockwise from the front; smooth
    /// normals or none.
    ///
    /// # Errors
    /// Tables that do not fit; a material that is not there. What else is wrong is told by `begin`.
    pub fn add_mesh(
        &mut self,
        name: &str,
        positions: &[f32],
        indices: &[u32],
        normals: &[f32],
        material: usize,
    ) -> Result<(), String> {
        if !positions.len().is_multiple_of(3) || !normals.len().is_multiple_of(3) {
            return Err(format!("mesh `{name}`: {} and {} numbers are no points", positions.len(), normals.len()));
        }
        let count = self.materials.len();
        let material =
            *self.materials.get(material).ok_or_else(|| format!("mesh `{name}`: material {material} of {count}"))?;
        let vectors = |numbers: &[f32]| numbers.chunks_exact(3).map(Vec3::from_slice).collect::<Vec<_>>();
        let (positions, normals) = (vectors(positions), vectors(normals));
        let uvs: &[Vec2] = &[];
        let mesh = Mesh { name, positions: &positions, indices, normals: &normals, uvs, material, ..Mesh::default() };
        self.building()?.add_mesh(mesh);
        Ok(())
    }

    /// Ends the scene, under lights by rows of [`crate::LIGHT_NUMBERS`] numbers and an even sky, W/m²/sr: the number of levels
    /// of a bake of about so many patches.
    ///
    /// # Errors
    /// What is wrong with which mesh, material or light.
    pub fn begin(&mut self, numbers: &[f32], sky: &[f32], patches: usize) -> Result<usize, String> {
        let own = lights(numbers)?;
        let mut builder = self.builder.take().ok_or("the scene is being baked")?;
        own.into_iter().for_each(|light| {
            builder.add_light(light);
        });
        if let [red, green, blue] = *sky {
            builder.set_sky(Radiance(radiance(red, green, blue)?));
        }
        self.scene = Some(builder.build().map_err(|error| error.to_string())?);
        self.levels = levels(&BakeSettings::default().with_patch_count(patches));
        Ok(self.levels.len())
    }

    /// Bakes a level, 0 the coarsest, and gives its light by a method.
    ///
    /// # Errors
    /// A level that is not there; a scene without light; more than there is room for.
    pub fn level(&self, level: usize, method: &str, listener: Option<Listener>) -> Result<LightField, String> {
        let scene = self.scene.as_ref().ok_or("the scene is not whole; begin ends it")?;
        let count = self.levels.len();
        let settings = self.levels.get(level).ok_or_else(|| format!("level {level} of {count}"))?;
        LISTENER.set(listener);
        let bake = Bake::build(scene, settings, &Telling);
        LISTENER.set(None);
        LightField::of_bake(bake.map_err(text)?, method)
    }
}

impl Baker {
    fn building(&mut self) -> Result<&mut SceneBuilder, String> {
        self.builder.as_mut().ok_or_else(|| "the scene is being baked; begin another".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_of_arrays_is_baked() {
        let mut baker = Baker::new();
        let red = baker.add_material(&[0.7, 0.1, 0.1], &[0.0; 3]).unwrap();
        assert!(baker.add_material(&[0.7], &[0.0; 3]).unwrap_err().contains("3 numbers, not 1"));
        let floor = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0];
        let ceiling = [0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0];
        let indices = [0, 1, 2, 0, 2, 3];
        baker.add_mesh("floor", &floor, &indices, &[], red).unwrap();
        baker.add_mesh("ceiling", &ceiling, &indices, &[], 0).unwrap();
        assert!(baker.add_mesh("wall", &floor, &indices, &[], 9).unwrap_err().contains("`wall`: material 9 of 2"));
        assert!(baker.level(0, "classic", None).err().unwrap().contains("begin"));
        let mut lamp = [0.0; crate::LIGHT_NUMBERS];
        lamp[..7].copy_from_slice(&[1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5]);
        let count = baker.begin(&lamp, &[0.0; 3], 300).unwrap();
        assert!(count > 1 && baker.add_mesh("late", &floor, &indices, &[], red).unwrap_err().contains("being baked"));
        let mut coarse = baker.level(0, "classic", None).unwrap();
        let mut fine = baker.level(count - 1, "classic", None).unwrap();
        assert!(coarse.counts()[2] < fine.counts()[2]);
        coarse.update().unwrap();
        fine.update().unwrap();
        fine.surface().unwrap();
        // The ceiling takes red light from the floor.
        assert!(fine.numbers().chunks_exact(3).any(|light| light[0] > 2.0 * light[1] && light[1] > 0.0));
        assert!(baker.level(count, "classic", None).err().unwrap().contains("level"));
    }
}
