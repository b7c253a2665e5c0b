//! What has changed of a lightmap, on its way to the graphics card.

use bevy::app::{App, Plugin};
use bevy::asset::AssetId;
use bevy::ecs::prelude::*;
use bevy::image::Image;
use bevy::render::render_asset::RenderAssets;
use bevy::render::render_resource::{Extent3d, Origin3d, TexelCopyBufferLayout, TexelCopyTextureInfo, TextureAspect};
use bevy::render::renderer::RenderQueue;
use bevy::render::texture::GpuImage;
use bevy::render::{ExtractSchedule, MainWorld, Render, RenderApp, RenderSystems};

/// Edge of a tile, texels.
const TILE: u32 = 16;
/// Bytes of a texel.
const TEXEL: usize = 8;

/// Tiles that wait to be sent.
#[derive(Resource, Default)]
pub(crate) struct Tiles(Vec<Tile>);

/// A part of a picture.
#[derive(Clone, Debug, PartialEq)]
struct Tile {
    image: AssetId<Image>,
    /// First column and row, and their numbers.
    place: [u32; 4],
    bytes: Vec<u8>,
}

/// Sends tiles in the render world.
pub(crate) struct UploadPlugin;

impl Plugin for UploadPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Tiles>();
        if let Some(render) = app.get_sub_app_mut(RenderApp) {
            render
                .init_resource::<Tiles>()
                .add_systems(ExtractSchedule, take)
                .add_systems(Render, send.in_set(RenderSystems::PrepareResources));
        }
    }
}

impl Tiles {
    /// Adds the tiles in which a picture differs from what it was, neighbours of a row together, and gives their texels;
    /// none where the whole is as well sent at once.
    pub fn add(&mut self, image: AssetId<Image>, width: u32, before: &[u8], now: &[u8]) -> Option<u64> {
        let height = (now.len() / TEXEL) as u32 / width;
        let mut changed: Vec<[u32; 4]> = Vec::new();
        for y in (0..height).step_by(TILE as usize) {
            for x in (0..width).step_by(TILE as usize) {
                let place = [x, y, TILE.min(width - x), TILE.min(height - y)];
                if rows(place, width).all(|row| before.get(row.clone()) == now.get(row)) {
                    continue;
                }
                match changed.last_mut() {
                    Some(last) if last[1] == y && last[0] + last[2] == x => last[2] += place[2],
                    _ => changed.push(place),
                }
            }
        }
        let texels: u64 = changed.iter().map(|place| u64::from(place[2]) * u64::from(place[3])).sum();
        if 4 * texels > 3 * u64::from(width) * u64::from(height) {
            return None;
        }
        self.0.extend(changed.into_iter().map(|place| {
            let bytes = rows(place, width).flat_map(|row| &now[row]).copied().collect();
            Tile { image, place, bytes }
        }));
        Some(texels)
    }

    /// Forgets what waits for a picture that is sent whole.
    pub fn forget(&mut self, image: AssetId<Image>) {
        self.0.retain(|tile| tile.image != image);
    }
}

/// Bytes of the rows of a tile in a picture of this width.
fn rows([x, y, columns, rows]: [u32; 4], width: u32) -> impl Iterator<Item = std::ops::Range<usize>> {
    (y..y + rows).map(move |row| {
        let first = TEXEL * (row as usize * width as usize + x as usize);
        first..first + TEXEL * columns as usize
    })
}

fn take(mut world: ResMut<MainWorld>, mut waiting: ResMut<Tiles>) {
    waiting.0.append(&mut world.resource_mut::<Tiles>().0);
}

/// Sends what waits for pictures that are there; the others are on their way, whole.
fn send(mut waiting: ResMut<Tiles>, images: Res<RenderAssets<GpuImage>>, queue: Res<RenderQueue>) {
    for Tile { image, place: [x, y, width, height], bytes } in waiting.0.drain(..) {
        let Some(own) = images.get(image) else { continue };
        let target = TexelCopyTextureInfo {
            texture: &own.texture,
            mip_level: 0,
            origin: Origin3d { x, y, z: 0 },
            aspect: TextureAspect::All,
        };
        let layout =
            TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(TEXEL as u32 * width), rows_per_image: None };
        queue.write_texture(target, &bytes, layout, Extent3d { width, height, depth_or_array_layers: 1 });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_differs_is_sent_and_no_more() {
        let image = AssetId::default();
        let (width, height) = (200, 130);
        let before = vec![0; TEXEL * width as usize * height as usize];
        let mut tiles = Tiles::default();
        assert_eq!(tiles.add(image, width, &before, &before), Some(0));
        assert!(tiles.0.is_empty());
        // A texel of the last column and one of the last row.
        let mut now = before.clone();
        let at = |x: usize, y: usize| TEXEL * (y * width as usize + x);
        now[at(199, 3)] = 1;
        now[at(5, 129) + 7] = 2;
        assert_eq!(tiles.add(image, width, &before, &now), Some(8 * 16 + 16 * 2));
        let places: Vec<[u32; 4]> = tiles.0.iter().map(|tile| tile.place).collect();
        assert_eq!(places, [[192, 0, 8, 16], [0, 128, 16, 2]]);
        assert_eq!((tiles.0[0].bytes[TEXEL * (3 * 8 + 7)], tiles.0[1].bytes[TEXEL * (16 + 5) + 7]), (1, 2));
        // Neighbours go together, after what waits already.
        let mut newer = now.clone();
        newer[at(199, 3)] = 9;
        newer[at(180, 15)] = 9;
        assert_eq!(tiles.add(image, width, &now, &newer), Some(24 * 16));
        assert_eq!(tiles.0[2].place, [176, 0, 24, 16]);
        assert_eq!(tiles.0[2].bytes[TEXEL * (3 * 24 + 23)], 9);
        // A picture that is another one is better sent whole.
        assert_eq!(tiles.add(image, width, &before, &vec![1; before.len()]), None);
        tiles.forget(image);
        assert!(tiles.0.is_empty());
    }
}
