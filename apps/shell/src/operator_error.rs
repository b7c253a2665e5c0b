//! Loss by storing an operator: errors of irradiance.

use faer::Mat;
use glam::Vec4;
use multibounce::Channels;
use rayon::prelude::*;

/// Irradiance by an operator that is not compressed, W/m².
pub fn exact_product(channels: Channels, area: &[f32], source: &[Vec4]) -> Vec<Vec4> {
    let root: Vec<f32> = area.iter().map(|&a| scene::math::sqrt(a)).collect();
    let one = |symmetric: &Mat<f32>, c: usize| symmetric * faer::Col::from_fn(root.len(), |i| source[i][c] * root[i]);
    let [r, g, b] = match channels {
        Channels::One(all) => [all; 3],
        Channels::Three(each) => each,
        Channels::Stored(each) => {
            // What cannot be read is no number.
            let one = |c: usize| {
                let light = Vec::from_iter((0..root.len()).map(|i| source[i][c] * root[i]));
                let mut out = vec![0.0; root.len()];
                if each[c].product(&light, &mut out).is_err() {
                    out.fill(f32::NAN);
                }
                out
            };
            let r = one(0);
            let g = one(1);
            let b = one(2);
            return (0..root.len()).map(|i| Vec4::new(r[i], g[i], b[i], 0.0) / root[i]).collect();
        }
        Channels::Factors(factors) => {
            let row = |i| factors.row(i).map(|(j, f)| (source[j] * f).truncate().extend(0.0)).sum();
            return (0..area.len()).into_par_iter().map(row).collect();
        }
    };
    let r = one(r, 0);
    let g = one(g, 1);
    let b = one(b, 2);
    (0..root.len()).map(|i| Vec4::new(r[i], g[i], b[i], 0.0) / root[i]).collect()
}

/// Relative error of irradiance, L2 by area, the greatest of the channels.
pub fn relative_error(ours: &[Vec4], exact: &[Vec4], area: &[f32]) -> f64 {
    let error = |c: usize| {
        let mut wrong = 0.0;
        let mut whole = 0.0;
        for ((h, x), a) in ours.iter().zip(exact).zip(area) {
            wrong += f64::from(*a) * f64::from(h[c] - x[c]).powi(2);
            whole += f64::from(*a) * f64::from(x[c]).powi(2);
        }
        if whole > 0.0 { (wrong / whole).sqrt() } else { 0.0 }
    };
    error(0).max(error(1)).max(error(2))
}
