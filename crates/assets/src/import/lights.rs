//! Lights from numbers of a file, checked.

use glam::Vec3;
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_LUMINAIRE, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT};
use scene::math::luminance;
use scene::{LUMENS_PER_WATT, Light};

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

/// A fault of a light: the key, and what to write.
pub type Fault = (&'static str, String);

/// Greatest radiance, irradiance (W/m²) or intensity (W/sr): what follows from it, also its square, is still a number
/// of single precision.
pub const QUANTITY_LIMIT: f32 = 1e15;

/// Three numbers, none below 0 and none above the limit.
pub fn check_color(key: &'static str, color: Vec3) -> Result<Vec3, Fault> {
    if color.min_element() >= 0.0 && color.max_element() <= QUANTITY_LIMIT && !color.is_nan() {
        Ok(color)
    } else {
        Err((
            key,
            format!(
                "{color} is not a quantity of light; give three numbers that are not negative, at most \
                 {QUANTITY_LIMIT:e}"
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
    let cos_inner = cosine(inner);
    let cos_outer = cosine(outer);
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

/// Position and orientation of a luminaire: in metres, the direction of γ = 0, and one near that of C = 0.
#[derive(Clone, Copy, Debug)]
pub struct Mounting {
    pub position: Vec3,
    pub direction: Vec3,
    /// Any direction that is not along the other: the part of it across that counts.
    pub c0: Vec3,
}

/// A luminaire of `flux` lm, as white as `white`, with the distribution that begins at `distribution` in the scene's
/// table.
pub fn luminaire(mounting: Mounting, flux: f64, white: Vec3, distribution: u32) -> Result<Light, Fault> {
    let position = check_position("position", mounting.position)?;
    let direction = check_direction("direction", mounting.direction)?;
    let c0 = check_direction("c0", mounting.c0)?;
    let across = c0 - direction * c0.dot(direction);
    if across.length() < 1e-3 {
        return Err(("c0", format!("{c0} lies along the direction {direction}; give one across it")));
    }
    let mean = flux / (4.0 * std::f64::consts::PI * f64::from(LUMENS_PER_WATT));
    let color = check_color("flux", white * mean as f32)?;
    Ok(Light {
        kind: LIGHT_LUMINAIRE,
        position,
        direction,
        edge_a: across.normalize(),
        color,
        distribution,
        ..Light::default()
    })
}

/// A colour with the luminance 1.
pub fn white(key: &'static str, color: Vec3) -> Result<Vec3, Fault> {
    let color = check_color(key, color)?;
    let bright = luminance(color);
    if bright > 1e-6 {
        return Ok(color / bright);
    }
    Err((key, format!("{color} is black; give three numbers, one above 0")))
}

/// Colour of a black body of a temperature in kelvin, with the luminance 1: chromaticities by Kim et al. 2002, which
/// hold from 1,667 to 25,000 K, linear Rec.709; what that cannot show is cut off.
pub fn black_body(kelvin: f32) -> Result<Vec3, Fault> {
    if !(1667.0..=25_000.0).contains(&kelvin) {
        return Err(("temperature", format!("{kelvin} K is no colour of a lamp; give 1667 to 25000, or a color")));
    }
    let t = 1e3 / f64::from(kelvin);
    let cubic = |c: [f64; 4], x: f64| ((c[0] * x + c[1]) * x + c[2]) * x + c[3];
    let x = match kelvin <= 4000.0 {
        true => cubic([-0.266_123_9, -0.234_358_9, 0.877_695_6, 0.179_910], t),
        false => cubic([-3.025_846_9, 2.107_037_9, 0.222_634_7, 0.240_390], t),
    };
    let y = match kelvin {
        k if k <= 2222.0 => cubic([-1.106_381_4, -1.348_110_20, 2.185_558_32, -0.202_196_83], x),
        k if k <= 4000.0 => cubic([-0.954_947_6, -1.374_185_93, 2.091_370_15, -0.167_488_67], x),
        _ => cubic([3.081_758_0, -5.873_386_70, 3.751_129_97, -0.370_014_83], x),
    };
    // XYZ of luminance 1, then Rec.709 primaries (IEC 61966-2-1).
    let big_x = x / y;
    let big_z = (1.0 - x - y) / y;
    let row = |a: f64, b: f64, c: f64| (a * big_x + b + c * big_z).max(0.0) as f32;
    let red = row(3.240_454_2, -1.537_138_5, -0.498_531_4);
    let green = row(-0.969_266_0, 1.876_010_8, 0.041_556_0);
    let blue = row(0.055_643_4, -0.204_025_9, 1.057_225_2);
    white("temperature", Vec3::new(red, green, blue))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_that_make_no_sense_are_refused_with_the_key() {
        let x = Vec3::X;
        let one = Vec3::ONE;
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
        let hung = |c0: Vec3| luminaire(Mounting { position: x, direction: -Vec3::Y, c0 }, 1e3, one, 0);
        assert_eq!(hung(Vec3::Y).map_err(|e| e.0), Err("c0"));
        assert_eq!(hung(Vec3::new(2.0, -1.0, 0.0)).map(|light| light.edge_a), Ok(x));
    }

    #[test]
    fn black_bodies_go_from_red_over_white_to_blue() {
        let d65 = black_body(6504.0).expect("daylight");
        // Daylight lies a little beside the black bodies.
        assert!((d65 - 1.0).abs().max_element() < 0.06, "{d65}");
        let a = black_body(2856.0).expect("an incandescent lamp");
        // Illuminant A, x = 0.44757, y = 0.40745, in Rec.709 over its luminance.
        assert!((a - Vec3::new(1.8450, 0.8261, 0.2333)).abs().max_element() < 0.01, "{a}");
        let cold = black_body(20_000.0).expect("a clear sky");
        assert!(cold.z > 1.5 && cold.x < 0.8, "{cold}");
        assert_eq!(black_body(1000.0).map_err(|e| e.0), Err("temperature"));
        assert_eq!(white("color", Vec3::ZERO).map_err(|e| e.0), Err("color"));
    }
}
