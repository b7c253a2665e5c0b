//! A camera goes down a long corridor and back: the matrix holds the patches about it. Prints how much work that is
//! against making it anew in every step, and how far it is from that in the end.

use glam::Vec3;
use patchlight_localmatrix::{Entering, LocalMatrix, choose, distance_to_path};

const PATCHES: u32 = 400;
const SLOTS: usize = 96;

fn main() -> Result<(), patchlight_localmatrix::Error> {
    // Each patch has form factors to those up to ten on; no row exceeds 1.
    let row = |i: u32| -> Vec<(u32, f32)> {
        let near = i.saturating_sub(10)..(i + 11).min(PATCHES);
        near.filter(|&j| j != i).map(|j| (j, 0.3 / (1.0 + i.abs_diff(j) as f32).powi(2))).collect()
    };
    let rows: Vec<Vec<(u32, f32)>> = (0..PATCHES).map(row).collect();
    let entering = |&patch: &u32| {
        let factors = &rows[patch as usize];
        Entering { patch, area: 1.0, albedo: Vec3::splat(0.7), factors }
    };
    let mut matrix = LocalMatrix::new(SLOTS)?;
    let path = (0..200).chain((0..200).rev()).map(|step| step as f32 * 2.0);
    let mut steps = 0u64;
    let mut moved = 0;
    for x in path {
        let eye = Vec3::X * x;
        let predicted = Vec3::X * (x + 5.0);
        let far = |i: u32| distance_to_path(Vec3::X * i as f32, eye, predicted);
        let distance: Vec<f32> = (0..PATCHES).map(far).collect();
        let choice = choose(&distance, |i| matrix.slot(i).is_some(), SLOTS - 16, 0.1, 16);
        matrix.leave(&choice.leave)?;
        matrix.add(&choice.enter.iter().map(entering).collect::<Vec<_>>())?;
        (steps, moved) = (steps + 1, moved + choice.enter.len());
    }
    let anew = 3 * steps * (SLOTS as u64).pow(3);
    println!("{moved} patches entered in {steps} steps; {:.1} times less work", anew as f64 / matrix.work() as f64);
    println!("residual of {} columns: {:.1e}", SLOTS, matrix.refresh(SLOTS));
    Ok(())
}
