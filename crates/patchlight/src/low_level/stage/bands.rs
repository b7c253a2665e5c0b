//! Pictures of any size on devices whose bindings show only so many bytes: each pass runs over one band of pixels after
//! the other. Bands are parts of the same tables; a pixel is what it is without them, in every bit.

use runtime::plan::{RANGE_ALIGNMENT, Slice};
use scene::kernel::large::TILE;
use scene::{Rgb, SurfacePoint};

/// Bands begin at multiples of this, so that ranges of tables of 16 and more bytes a pixel may begin there.
const STEP: u32 = (RANGE_ALIGNMENT / size_of::<Rgb>() as u64) as u32;

/// Pixels that follow each other, row by row from the upper left corner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Band {
    /// First pixel.
    pub first: u32,
    /// Number of pixels.
    pub count: u32,
}

impl Band {
    /// The part of a table with an element a pixel.
    pub fn of<T>(self, table: Slice<T>) -> Slice<T> {
        if self.count == 0 {
            // A picture without pixels: its empty tables are bound whole.
            return table;
        }
        table.part(self.first as usize, self.count as usize)
    }

    /// With the pixels about that direct light is compared and averaged with: up to [`TILE`] columns and rows away.
    pub fn with_pixels_about(self, (width, height): (u32, u32)) -> Self {
        let margin = reach(width);
        let first = self.first.saturating_sub(margin) / STEP * STEP;
        let end = (self.first + self.count).saturating_add(margin).min(width * height);
        Self { first, count: end - first }
    }
}

/// Distance of the furthest pixels that a pixel is compared or averaged with.
fn reach(width: u32) -> u32 {
    (width + 1).saturating_mul(TILE)
}

/// A picture in bands, so that a binding of `range` bytes shows the points of each and of the pixels about; bands of
/// `STEP` pixels where it cannot: the device then says so.
pub fn bands((width, height): (u32, u32), range: u64) -> Vec<Band> {
    let pixels = width * height;
    let shown = u32::try_from(range / size_of::<SurfacePoint>() as u64).unwrap_or(u32::MAX);
    if pixels <= shown {
        return vec![Band { first: 0, count: pixels }];
    }
    let margins = reach(width).saturating_mul(2).saturating_add(STEP);
    let most = (shown.saturating_sub(margins) / STEP * STEP).max(STEP);
    (0..pixels).step_by(most as usize).map(|first| Band { first, count: most.min(pixels - first) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_cover_a_picture_once_and_fit_into_a_binding_with_the_pixels_about() {
        let size = (3840, 2160);
        let limit = 1 << 27;
        for (size, range, expected) in
            [((960, 540), limit, 1), (size, u64::MAX, 1), (size, limit, 2), (size, limit / 2, 5)]
        {
            let bands = bands(size, range);
            assert_eq!(bands.len(), expected, "{size:?} in {range}");
            let mut next = 0;
            for band in bands {
                assert_eq!(band.first, next);
                assert!(band.first % STEP == 0 && band.count > 0);
                next += band.count;
                let about = band.with_pixels_about(size);
                assert!(u64::from(about.count) * size_of::<SurfacePoint>() as u64 <= range, "{band:?} in {range}");
                let last = band.first + band.count - 1;
                assert!(about.first <= band.first.saturating_sub(4 * size.0 + 4) && about.first % STEP == 0);
                assert!(about.first + about.count > (last + 4 * size.0 + 4).min(size.0 * size.1 - 1));
                assert!(about.first + about.count <= size.0 * size.1);
            }
            assert_eq!(next, size.0 * size.1);
        }
    }

    #[test]
    fn a_limit_below_the_margins_gives_the_least_bands() {
        let bands = bands((64, 3), 1024);
        assert_eq!(bands.len(), 12);
        assert_eq!(bands[11], Band { first: 176, count: 16 });
    }
}
