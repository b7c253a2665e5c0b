//! Light jumps, then rests: how far it is from its end, and how much it still changes, with and without the control
//! variate.

use glam::Vec4;
use patchlight_temporal::{Blend, Error, RayLists, Settings, State};
use scene::sampling::{hash3, unit};
use transport::LinearOperator;

fn main() -> Result<(), Error> {
    // A closed room of 500 patches that see each other at random, 256 rays each; every 20th shines.
    let n = 500usize;
    let hits: Vec<u32> = (0..n as u32).flat_map(|i| (0..256).map(move |k| hash3(i, k, 1) % 500)).collect();
    let lists = RayLists::from_hits(n, &hits, 256)?;
    let source: Vec<Vec4> = (0..n).map(|i| if i % 20 == 0 { Vec4::ONE } else { Vec4::ZERO }).collect();
    let albedo: Vec<Vec4> = (0..n as u32).map(|i| Vec4::splat(0.3 + 0.4 * unit(hash3(i, 0, 2)))).collect();

    let mut exitance = source.clone();
    let mut exact = vec![Vec4::ZERO; n];
    for _ in 0..100 {
        lists.apply(&exitance, &mut exact)?;
        exitance = (0..n).map(|i| source[i] + albedo[i] * exact[i]).collect();
    }
    let distance = |a: &[Vec4], b: &[Vec4]| {
        let squares: f32 = a.iter().zip(b).map(|(a, b)| (*a - *b).truncate().length_squared()).sum();
        (squares / exact.iter().map(|h| h.truncate().length_squared()).sum::<f32>()).sqrt()
    };
    println!("{} bytes; frame, error and change with the control variate, without", lists.bytes());
    let on = Settings { samples: 16, ..Settings::default() };
    let off = Settings { control_variate: false, blend: Blend::Fixed(0.9), ..on };
    let mut a = State::new(n);
    let mut b = State::new(n);
    for frame in 1..=256 {
        let before = (a.irradiance.clone(), b.irradiance.clone());
        a.advance(&lists, &source, &albedo, &on)?;
        b.advance(&lists, &source, &albedo, &off)?;
        if u32::is_power_of_two(frame) {
            let of = |state: &State, before: &[Vec4]| {
                (distance(&state.irradiance, &exact), distance(&state.irradiance, before))
            };
            println!("{frame:4} {:.1e} {:.1e}", of(&a, &before.0).0, of(&a, &before.0).1);
            println!("     {:.1e} {:.1e}", of(&b, &before.1).0, of(&b, &before.1).1);
        }
    }
    Ok(())
}
