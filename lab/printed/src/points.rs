//! Form factors between points, (5.1).

use formfactor::{Error, Estimator, Hemisphere};
use transport::Surfaces;

/// One ray from the first point of a row to each centre: `F_ij = s_j cosθ_i cosθ_j V / (π r²)` (5.1), which passes 1
/// where patches touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PrintedPoints {
    /// Rays a row to the sky.
    pub sky_rays: u32,
}

impl Estimator for PrintedPoints {
    fn check(&self, surfaces: &Surfaces) -> Result<(), Error> {
        Hemisphere { rays: self.sky_rays }.check(surfaces)
    }

    fn row(&self, s: &Surfaces, row: usize, factors: &mut [f32]) -> (f32, f32) {
        // What the rays meet is nobody's: they tell of the sky alone.
        let (sky, _) = Hemisphere { rays: self.sky_rays }.row(s, row, factors);
        let point = &s.points[s.offsets[row] as usize];
        let here = point.position.as_dvec3();
        let normal = point.normal.as_dvec3();
        let lift = f64::from(s.ray_offset);
        for (patch, out) in s.patches.iter().zip(factors) {
            let there = patch.centroid.as_dvec3();
            let back = patch.normal.as_dvec3();
            let to = there - here;
            let cos_here = to.dot(normal);
            let cos_there = -to.dot(back);
            let start = (here + normal * lift).as_vec3();
            let faces = cos_here > 0.0 && cos_there > 0.0;
            *out = match faces && !s.visibility.any_hit(start, (there + back * lift).as_vec3()) {
                true => {
                    let squared = to.length_squared();
                    (f64::from(patch.area) * cos_here * cos_there / (std::f64::consts::PI * squared * squared)) as f32
                }
                false => 0.0,
            };
        }
        (sky, 0.0)
    }
}
