//! Lights as rows of numbers.

use patchlight::glam::Vec3;
use patchlight::scene::SurfaceLight;
use patchlight::{Intensity, Irradiance, Light, Radiance};

/// Numbers of a light: kind, color (3), position (3), direction (3), two edges (3 each) or two half-angles first.
pub const LIGHT_NUMBERS: usize = 16;

/// The lights of rows of [`LIGHT_NUMBERS`] numbers.
///
/// # Errors
/// What is wrong with which light.
pub fn lights(numbers: &[f32]) -> Result<Vec<Light>, String> {
    if !numbers.len().is_multiple_of(LIGHT_NUMBERS) {
        return Err(format!("lights have {} numbers; each has {LIGHT_NUMBERS}", numbers.len()));
    }
    let rows = numbers.chunks_exact(LIGHT_NUMBERS).enumerate();
    rows.map(|(k, row)| light(row).map_err(|reason| format!("light {k}: {reason}"))).collect()
}

fn light(row: &[f32]) -> Result<Light, String> {
    if let Some(number) = row.iter().find(|number| !number.is_finite()) {
        return Err(format!("{number} is no number to light with"));
    }
    let vector = |at: usize| Vec3::new(row[at], row[at + 1], row[at + 2]);
    let [color, position, direction, edge_a, edge_b] = [1, 4, 7, 10, 13].map(vector);
    if color.min_element() < 0.0 {
        return Err(format!("its color is {color}; light is not negative"));
    }
    Ok(match row[0] as u32 {
        0 => Light::sun(direction, Irradiance(color)),
        1 => Light::point(position, Intensity(color)),
        2 => Light::spot(position, direction, (edge_a.x, edge_a.y), Intensity(color)),
        3 => Light::rectangle(position, (edge_a, edge_b), SurfaceLight::Radiance(Radiance(color))),
        kind => return Err(format!("its kind is {kind}; it is 0 (sun), 1 (point), 2 (spot) or 3 (rectangle)")),
    })
}

#[cfg(test)]
mod tests {
    use patchlight::scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_RECT};

    use super::*;

    #[test]
    fn rows_of_numbers_are_lights() {
        let mut rows = vec![0.0; 2 * LIGHT_NUMBERS];
        rows[..10].copy_from_slice(&[0.0, 3.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0, -2.0, 0.0]);
        rows[LIGHT_NUMBERS..]
            .copy_from_slice(&[3.0, 1.0, 1.0, 1.0, 5.0, 6.0, 7.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 2.0]);
        let found = lights(&rows).unwrap();
        assert_eq!((found[0].kind, found[0].direction), (LIGHT_DIRECTIONAL, Vec3::NEG_Y));
        assert_eq!(found[0].color, Vec3::new(3.0, 2.0, 1.0));
        assert_eq!((found[1].kind, found[1].position, found[1].edge_b.z), (LIGHT_RECT, Vec3::new(5.0, 6.0, 7.0), 2.0));
        rows[LIGHT_NUMBERS] = 9.0;
        assert!(lights(&rows).unwrap_err().contains("light 1: its kind is 9"));
        rows[LIGHT_NUMBERS + 1] = f32::NAN;
        assert!(lights(&rows).unwrap_err().contains("NaN"));
        assert!(lights(&rows[1..]).unwrap_err().contains("31 numbers"));
    }
}
