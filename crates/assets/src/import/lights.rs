//! Lights from numbers of a file, checked.

use glam::Vec3;
use scene::{LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT, Light};

/// Sky of a mesh that has no light of its own, W/m²/sr.
pub const DEFAULT_SKY: Vec3 = Vec3::new(0.6, 0.8, 1.2);

/// Sun of a mesh that has no light of its own.
pub fn default_sun() -> Light {
    Light {
        kind: LIGHT_DIRECTIONAL,
        direction: Vec3::new(-0.35, -1.0, -0.45).normalize(),
        color: Vec3::new(12.0, 11.0, 9.5),
        ..Light::default()
    }
}

/// What is wrong with a light: the key, and what to write.
pub type Fault = (&'static str, String);

/// Greatest radiance, irradiance (W/m²) or intensity (W/sr): what follows from it, also its square, is still a number of single
/// precision.
pub const QUANTITY_LIMIT: f32 = 1e15;

/// Three numbers, none below 0 and none above the limit.
pub fn check_color(key: &'static str, color: Vec3) -> Result<Vec3, Fault> {
    if color.min_element() >= 0.0 && color.max_element() <= QUANTITY_LIMIT && !color.is_nan() {
        Ok(color)
    } else {
        Err((
            key,
            format!(
                "{color} is not a quantity of light; give three numbers that are not negative, at most {QUANTITY_LIMIT:e}"
            ),
        ))
    }
}

/// Finite numbers.
pub fn check_position(key: &'static str, position: Vec3) -> Result<Vec3, Fault> {
    if position.is_finite() {
        Ok(position)
    } else {
        Err((key, format!("{position} is not a position; give three finite numbers")))
    }
}

/// A unit vector.
pub fn check_direction(key: &'static str, direction: Vec3) -> Result<Vec3, Fault> {
    direction
        .try_normalize()
        .ok_or_else(|| (key, format!("{direction} has no direction; give three finite numbers that are not all 0")))
}

/// Parallel light that travels along `direction`, `irradiance` in W/m² on a surface that faces it.
pub fn directional(direction: Vec3, irradiance: Vec3) -> Result<Light, Fault> {
    let direction = check_direction("direction", direction)?;
    let color = check_color("irradiance", irradiance)?;
    Ok(Light { kind: LIGHT_DIRECTIONAL, direction, color, ..Light::default() })
}

/// A point at `position` (m) of `intensity` W/sr.
pub fn point(position: Vec3, intensity: Vec3) -> Result<Light, Fault> {
    let position = check_position("position", position)?;
    let color = check_color("intensity", intensity)?;
    Ok(Light { kind: LIGHT_POINT, position, color, ..Light::default() })
}

/// A spot: half-angles in degrees, full intensity within `inner`, none beyond `outer`.
pub fn spot(position: Vec3, direction: Vec3, intensity: Vec3, inner: f32, outer: f32) -> Result<Light, Fault> {
    let position = check_position("position", position)?;
    let direction = check_direction("direction", direction)?;
    let color = check_color("intensity", intensity)?;
    if !(0.0..180.0).contains(&inner) {
        return Err(("inner_degrees", format!("{inner} is not a half-angle; give 0 to 179 degrees")));
    }
    if !(inner..=180.0).contains(&outer) {
        return Err((
            "outer_degrees",
            format!("{outer} is not between inner_degrees ({inner}) and 180; give the wider angle"),
        ));
    }
    let cosine = |degrees: f32| f64::from(degrees).to_radians().cos() as f32;
    let (cos_inner, cos_outer) = (cosine(inner), cosine(outer));
    Ok(Light { kind: LIGHT_SPOT, position, direction, color, cos_inner, cos_outer, ..Light::default() })
}

/// A parallelogram in metres that sends `radiance` W/m²/sr to the side of `edge_a × edge_b`.
pub fn rect(corner: Vec3, edge_a: Vec3, edge_b: Vec3, radiance: Vec3) -> Result<Light, Fault> {
    let position = check_position("corner", corner)?;
    let edge_a = check_position("edge_a", edge_a)?;
    let edge_b = check_position("edge_b", edge_b)?;
    let color = check_color("radiance", radiance)?;
    let area = edge_a.cross(edge_b).length();
    // Below a sine of 1e-4 the edges are parallel for single precision.
    if area.is_nan() || area <= 1e-4 * edge_a.length() * edge_b.length() {
        return Err(("edge_b", format!("{edge_b} is parallel to edge_a {edge_a}; give two sides of a parallelogram")));
    }
    Ok(Light { kind: LIGHT_RECT, position, edge_a, edge_b, area, color, ..Light::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_that_make_no_sense_are_refused_with_the_key() {
        let (x, one) = (Vec3::X, Vec3::ONE);
        assert_eq!(directional(Vec3::ZERO, one).map_err(|e| e.0), Err("direction"));
        assert_eq!(directional(x, -one).map_err(|e| e.0), Err("irradiance"));
        assert_eq!(directional(x, 1e38 * one).map_err(|e| e.0), Err("irradiance"));
        assert_eq!(directional(x, Vec3::NAN).map_err(|e| e.0), Err("irradiance"));
        assert_eq!(point(Vec3::NAN, one).map_err(|e| e.0), Err("position"));
        assert_eq!(spot(x, x, one, 30.0, 20.0).map_err(|e| e.0), Err("outer_degrees"));
        assert_eq!(spot(x, x, one, f32::NAN, 20.0).map_err(|e| e.0), Err("inner_degrees"));
        assert_eq!(rect(x, x, 2.0 * x, one).map_err(|e| e.0), Err("edge_b"));
        let light = rect(x, 2.0 * x, 3.0 * Vec3::Z, one).expect("a proper rectangle");
        assert_eq!(light.area, 6.0);
    }
}
