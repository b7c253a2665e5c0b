//! Bakes as assets.

use std::path::Path;
use std::sync::Arc;

use bevy::asset::io::Reader;
use bevy::asset::{Asset, AssetLoader, LoadContext};
use bevy::reflect::TypePath;
use patchlight::bake::Bake;
use patchlight::file::Origin;
use patchlight::scene::Scene;
use sha2::{Digest as _, Sha256};

/// A bake that [`crate::PatchlightStatus::save_bake`] has written, as an asset: `asset_server.load("room.bake")`.
#[derive(Asset, TypePath, Clone)]
pub struct PatchlightBake {
    pub(crate) bake: Arc<Bake>,
    pub(crate) scene_hash: [u8; 32],
}

/// Why a bake could not be loaded or saved.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PatchlightBakeError {
    /// The bytes could not be read.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// They are no bake of this version, or were altered.
    #[error(transparent)]
    Bake(#[from] patchlight::Error),
    /// There is no bake yet.
    #[error("the bake is not finished; PatchlightStatus::stage says when it is")]
    Unfinished,
}

/// Loads files that end in `.bake`.
#[derive(Default, TypePath)]
pub(crate) struct BakeLoader;

impl AssetLoader for BakeLoader {
    type Asset = PatchlightBake;
    type Settings = ();
    type Error = PatchlightBakeError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        (): &(),
        context: &mut LoadContext<'_>,
    ) -> Result<PatchlightBake, PatchlightBakeError> {
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes).await?;
        let file = Bake::from_bytes(&context.path().to_string(), bytes)?;
        Ok(PatchlightBake { bake: Arc::new(file.bake), scene_hash: file.origin.scene_hash })
    }

    fn extensions(&self) -> &[&str] {
        &["bake"]
    }
}

/// Writes a bake of the scene with this hash.
pub(crate) fn save(bake: &Bake, scene_hash: [u8; 32], path: &Path) -> Result<(), PatchlightBakeError> {
    let origin = Origin { scene: "Bevy".into(), scene_hash, application: Vec::new() };
    Ok(bake.save(path, &origin)?)
}

/// Hash of all of a scene that a bake depends on: triangles, and what they reflect.
pub(crate) fn hash(scene: &Scene) -> [u8; 32] {
    let geometry = &scene.geometry;
    let mut sum = Sha256::new();
    let mut numbers = |numbers: &[f32]| numbers.iter().for_each(|x| sum.update(x.to_le_bytes()));
    for (triangle, uv) in geometry.triangles.iter().zip(&geometry.uvs) {
        numbers(&triangle.corner.to_array());
        numbers(&triangle.edge_a.to_array());
        numbers(&triangle.edge_b.to_array());
        numbers(&[uv.corner, uv.corner_a, uv.corner_b].map(|uv| uv.to_array()).concat());
        numbers(&[triangle.material as f32]);
    }
    for material in scene.materials.iter() {
        numbers(&material.albedo.to_array());
        numbers(&[material.albedo_texture as f32, material.mask_texture as f32, material.mask_cutoff]);
    }
    geometry.texels.iter().for_each(|word| sum.update(word.to_le_bytes()));
    sum.finalize().into()
}
