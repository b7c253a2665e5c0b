//! Triangles in double precision.

use glam::DVec3;

/// The four like parts of a triangle.
pub(super) fn four_parts(t: [DVec3; 3]) -> [[DVec3; 3]; 4] {
    let [a, b, c] = t;
    let ab = (a + b) * 0.5;
    let bc = (b + c) * 0.5;
    let ca = (c + a) * 0.5;
    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]]
}

/// Area of a triangle.
pub(super) fn triangle_area(t: [DVec3; 3]) -> f64 {
    0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length()
}
