//! Position of the sun, by hour, day and latitude.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

/// Greatest declination of the sun: the tilt of the earth's axis, degrees.
const TILT_DEGREES: f64 = 23.45;
/// Days of a year.
const DAYS: f64 = 365.0;

/// An hour of true solar time at a latitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunTime {
    /// Hours since midnight; at 12 the sun stands highest.
    pub hour: f32,
    /// Day of the year, from 1.
    pub day: f32,
    /// Degrees, north of the equator positive.
    pub latitude: f32,
}

impl Default for SunTime {
    /// Noon of the longest day at 45° north.
    fn default() -> Self {
        Self { hour: 12.0, day: 172.0, latitude: 45.0 }
    }
}

/// Which way is up in a scene, and which way is north.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compass {
    /// Unit vector away from the ground.
    pub up: Vec3,
    /// Unit vector to the north, level.
    pub north: Vec3,
}

impl Compass {
    /// The compass of a scene whose camera has this vector upwards: north is −z where y is up, y where z is up, z where
    /// x is up.
    pub fn of_up(up: Vec3) -> Self {
        let axis = up.abs().max_position();
        let sign = if up[axis] < 0.0 { -1.0 } else { 1.0 };
        let (up, north) = [(Vec3::X, Vec3::Z), (Vec3::Y, Vec3::NEG_Z), (Vec3::Z, Vec3::Y)][axis];
        Self { up: up * sign, north }
    }
}

/// Unit vector to the sun, below the horizon too: altitude and azimuth by the hour angle `h = 15° (hour − 12)` and the
/// declination `δ = 23.45° sin(360° (284 + day)/365)`.
///
/// Source: Cooper, The absorption of radiation in solar stills, 1969, for δ; Duffie and Beckman, Solar Engineering of
/// Thermal Processes, section 1.6, for the rest.
pub fn direction_to_sun(time: SunTime, compass: Compass) -> Vec3 {
    let day_angle = TAU * (284.0 + f64::from(time.day)) / DAYS;
    let (above, level) = (TILT_DEGREES * day_angle.sin()).to_radians().sin_cos();
    let hour_angle = TAU * (f64::from(time.hour) - 12.0) / 24.0;
    let (sin_latitude, cos_latitude) = f64::from(time.latitude).to_radians().sin_cos();
    let east = -level * hour_angle.sin();
    let north = cos_latitude * above - sin_latitude * level * hour_angle.cos();
    let up = sin_latitude * above + cos_latitude * level * hour_angle.cos();
    let to_east = compass.north.cross(compass.up);
    let direction = DVec3::from(to_east) * east + DVec3::from(compass.north) * north + DVec3::from(compass.up) * up;
    direction.as_vec3().normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACE: Compass = Compass { up: Vec3::Y, north: Vec3::NEG_Z };
    /// Day 81, on which `284 + 81 = 365`: declination 0.
    const EQUINOX: f32 = 81.0;

    fn sun(hour: f32, day: f32, latitude: f32) -> Vec3 {
        direction_to_sun(SunTime { hour, day, latitude }, PLACE)
    }

    fn altitude(direction: Vec3) -> f64 {
        f64::from(direction.y).asin().to_degrees()
    }

    #[test]
    fn the_sun_of_an_equinox_rises_in_the_east_and_culminates_at_90_degrees_less_the_latitude() {
        assert!(sun(12.0, EQUINOX, 0.0).distance(Vec3::Y) < 1e-5);
        for latitude in [-50.0, 0.0, 35.0, 60.0] {
            assert!(sun(6.0, EQUINOX, latitude).distance(Vec3::X) < 1e-5, "east at {latitude}");
            assert!(sun(18.0, EQUINOX, latitude).distance(Vec3::NEG_X) < 1e-5, "west at {latitude}");
            assert!((altitude(sun(12.0, EQUINOX, latitude)) - (90.0 - f64::from(latitude).abs())).abs() < 0.01);
        }
        assert!(sun(12.0, EQUINOX, 45.0).z > 0.5, "in the south of the northern half");
    }

    #[test]
    fn solstices_differ_by_twice_the_tilt() {
        let summer = altitude(sun(12.0, 172.0, 48.0));
        let winter = altitude(sun(12.0, 355.0, 48.0));
        assert!((summer - (90.0 - 48.0 + TILT_DEGREES)).abs() < 0.05, "{summer}");
        assert!((summer - winter - 2.0 * TILT_DEGREES).abs() < 0.05, "{winter}");
        assert!(sun(0.0, 172.0, 48.0).y < 0.0 && sun(0.0, 172.0, 80.0).y > 0.0, "midnight sun in the north only");
    }

    #[test]
    fn a_scene_with_z_up_has_the_same_sun() {
        let place = Compass::of_up(Vec3::new(0.1, 0.0, 0.9));
        let time = SunTime { hour: 9.5, day: 30.0, latitude: 52.0 };
        let there = direction_to_sun(time, place);
        let here = direction_to_sun(time, Compass::of_up(Vec3::Y));
        assert!(Vec3::new(there.x, there.z, -there.y).distance(here) < 1e-6);
        assert_eq!(Compass::of_up(Vec3::Y), PLACE);
    }
}
