//! Three crates as somebody outside takes them, each with a number that is known.

use glam::{DVec3, Vec3, Vec4};
use patchlight_formfactor::point_to_polygon;
use patchlight_temporal::Settings;
use patchlight_transport::{Csr, LinearOperator, Polygon};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // A point below the corner of a unit square one metre above it: Howell's catalogue, B-3.
    let square = Polygon::new(&[Vec3::Z, Vec3::new(0.0, 1.0, 1.0), Vec3::ONE, Vec3::new(1.0, 0.0, 1.0)])?;
    let factor = point_to_polygon(DVec3::ZERO, DVec3::Z, &square);
    assert!((factor - 0.138531606).abs() < 1e-9, "{factor}");

    let swap = Csr { rows: 2, columns: 2, row_start: vec![0, 1, 2], column_index: vec![1, 0], values: vec![0.5, 0.25] };
    // Light is red, green and blue; the fourth component carries nothing.
    let light = [Vec3::ONE.extend(0.0), Vec3::splat(4.0).extend(0.0)];
    let mut out = [Vec4::ZERO; 2];
    swap.apply(&light, &mut out)?;
    assert_eq!(out, [Vec3::splat(2.0).extend(0.0), Vec3::splat(0.25).extend(0.0)]);

    assert!(Settings::default().samples > 0);
    println!("form factor {factor:.9}; three crates from their packages");
    Ok(())
}
