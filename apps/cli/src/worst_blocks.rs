//! Two pictures side by side, with frames round the blocks that differ most.

use glam::Vec3;
use reference::metrics::BLOCK_EDGE;
use reference::{Error as PictureError, Picture};

/// Blocks that [`worst_blocks`] frames, the frame's width in pixels, and its colour.
const WORST: usize = 16;
const FRAME: u32 = 2;
const FRAME_COLOUR: Vec3 = Vec3::new(1.0, 0.02, 0.02);
/// Two pictures × `scale` side by side, ours at the left, with frames round the 16 blocks of 8 × 8 pixels whose
/// displayed means differ most (squared, all channels). To be shown without exposure.
///
/// # Errors
/// Pictures of different sizes.
pub fn worst_blocks(ours: &Picture, reference: &Picture, scale: f32) -> Result<Picture, PictureError> {
    // Also says when sizes differ.
    let difference = {
        let a = ours.block_means(BLOCK_EDGE).displayed(scale);
        let b = reference.block_means(BLOCK_EDGE).displayed(scale);
        a.minus(&b)?
    };
    let mut blocks: Vec<(f32, u32)> =
        difference.pixels.iter().zip(0..).map(|(d, block)| (d.length_squared(), block)).collect();
    blocks.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    blocks.truncate(WORST);

    let Picture { width, height, .. } = *ours;
    let mut both = Picture::new(2 * width, height);
    for y in 0..height {
        for (side, picture) in [ours, reference].into_iter().enumerate() {
            let row = &picture.pixels[(y * width) as usize..((y + 1) * width) as usize];
            let first = (y * 2 * width) as usize + side * width as usize;
            both.pixels[first..first + width as usize].copy_from_slice(row);
        }
    }
    both.pixels.iter_mut().for_each(|p| *p *= scale);
    for (_, block) in blocks {
        let x = block % difference.width * BLOCK_EDGE;
        let y = block / difference.width * BLOCK_EDGE;
        let left = x.saturating_sub(FRAME);
        let right = (x + BLOCK_EDGE + FRAME).min(width);
        let top = y.saturating_sub(FRAME);
        let bottom = (y + BLOCK_EDGE + FRAME).min(height);
        let inside =
            |row: u32, column: u32| (y..y + BLOCK_EDGE).contains(&row) && (x..x + BLOCK_EDGE).contains(&column);
        for (row, column) in (top..bottom).flat_map(|row| (left..right).map(move |column| (row, column))) {
            if !inside(row, column) {
                for side in 0..2 {
                    both.pixels[(row * 2 * width + side * width + column) as usize] = FRAME_COLOUR;
                }
            }
        }
    }
    Ok(both)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_blocks_are_framed_on_both_sides() {
        let grey = Picture::from_pixels(64, 48, vec![Vec3::splat(0.2); 64 * 48]).unwrap();
        let mut wrong = grey.clone();
        // Block (3, 2) is the only one that differs.
        for (x, y) in (24..32).flat_map(|x| (16..24).map(move |y| (x, y))) {
            wrong.pixels[y * 64 + x] = Vec3::splat(0.9);
        }
        let shown = worst_blocks(&wrong, &grey, 1.0).unwrap();
        assert_eq!((shown.width, shown.height), (128, 48));
        let at = |x: usize, y: usize| shown.pixels[y * 128 + x];
        assert_eq!((at(27, 20), at(64 + 27, 20)), (Vec3::splat(0.9), Vec3::splat(0.2)));
        for x in [23, 32, 64 + 23, 64 + 32] {
            assert_eq!(at(x, 20), FRAME_COLOUR, "{x}");
        }
        assert!(worst_blocks(&wrong, &Picture::new(16, 16), 1.0).is_err());
    }
}
