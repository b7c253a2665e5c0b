//! Common interface of all sets of receivers.

use alloc::vec::Vec;

use crate::SurfacePoint;

/// Points at which irradiance is wanted: what rows of form factors need, and nothing of how values are used.
///
/// A set has one row a point, in the order of the points: with the patches' exitance B, receiver r has
/// `H_r = Σ_j F_rj B_j`, W/m². A table of values holds one entry a point in the same order, and is turned into
/// irradiance at other places by the set itself: between grid vertices of a triangle, between texels, between probes in
/// the air. Every set gives back a constant for a table of that constant.
pub trait ReceiverSet: Sync {
    /// The receivers. Rays start [`Geometry::ray_offset`](crate::Geometry::ray_offset) along the normal.
    fn points(&self) -> &[SurfacePoint];

    /// Row i owns `points[offsets[i]..offsets[i + 1]]`: one point each, `0..=n`.
    fn offsets(&self) -> Vec<u32> {
        (0..=self.points().len() as u32).collect()
    }
}

/// Points as they are: the visible points of a picture, say.
impl ReceiverSet for Vec<SurfacePoint> {
    fn points(&self) -> &[SurfacePoint] {
        self
    }
}
