//! The part of a scene that an application keeps beside the geometry and lights stored in a bake.

use std::path::PathBuf;

use scene::Scene;
use serde::{Deserialize, Serialize};

use super::animation::{Animation, Track};
use super::{Dropped, LightmapUvs, LoadedScene, MovingObject, View};

/// The parts of a [`LoadedScene`] that are not its scene.
#[derive(Serialize, Deserialize)]
struct Description {
    name: String,
    view: View,
    exposure_stops: f32,
    #[serde(default)]
    is_exposed: bool,
    metres_per_unit: f32,
    objects: Vec<String>,
    materials: Vec<String>,
    textures: Vec<String>,
    tracks: Vec<Track>,
    #[serde(default)]
    moving: Vec<MovingObject>,
    content_hash: [u8; 32],
    files: Vec<PathBuf>,
    file_triangles: usize,
    dropped: Dropped,
    lightmap_uvs: String,
}

impl LoadedScene {
    /// All but the scene, as JSON.
    pub fn description(&self) -> String {
        let description = Description {
            name: self.name.clone(),
            view: self.view,
            exposure_stops: self.exposure_stops,
            is_exposed: self.is_exposed,
            metres_per_unit: self.metres_per_unit,
            objects: self.objects.clone(),
            materials: self.materials.clone(),
            textures: self.textures.clone(),
            tracks: self.animation.tracks.clone(),
            moving: self.moving.clone(),
            content_hash: self.content_hash,
            files: self.files.clone(),
            file_triangles: self.file_triangles,
            dropped: self.dropped,
            lightmap_uvs: self.lightmap_uvs.to_text(),
        };
        // Plain data: nothing of it cannot be written.
        serde_json::to_string(&description).unwrap_or_default()
    }

    /// The scene of a description.
    ///
    /// # Errors
    /// What of the text is no description.
    pub fn of_description(scene: Scene, text: &str) -> Result<Self, String> {
        let d: Description = serde_json::from_str(text).map_err(|error| error.to_string())?;
        let animation = Animation { lights: scene.lighting.lights.clone(), view: d.view, tracks: d.tracks };
        Ok(Self {
            name: d.name,
            scene,
            view: d.view,
            exposure_stops: d.exposure_stops,
            is_exposed: d.is_exposed,
            metres_per_unit: d.metres_per_unit,
            objects: d.objects,
            materials: d.materials,
            textures: d.textures,
            warnings: Vec::new(),
            animation,
            moving: d.moving,
            content_hash: d.content_hash,
            files: d.files,
            file_triangles: d.file_triangles,
            dropped: d.dropped,
            lightmap_uvs: LightmapUvs::of_text(&d.lightmap_uvs)?,
            timings: Vec::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::import::LoadedScene;

    #[test]
    fn a_described_scene_is_the_same() {
        for name in ["cornell", "atrium"] {
            let loaded = crate::load_or_build(name).unwrap();
            let again = LoadedScene::of_description(loaded.scene.clone(), &loaded.description()).unwrap();
            assert_eq!((again.name, again.view), (loaded.name, loaded.view));
            assert_eq!((again.materials, again.objects), (loaded.materials, loaded.objects));
            assert_eq!((again.animation, again.content_hash), (loaded.animation, loaded.content_hash));
        }
        let scene = crate::load_or_build("cornell").unwrap().scene;
        assert!(LoadedScene::of_description(scene, "{}").is_err());
    }
}
