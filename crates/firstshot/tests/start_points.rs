//! Start points have the density that is linear between the corners of their triangle.

use glam::{Vec2, Vec3};
use patchlight_firstshot::kernel::linear::{
    interpolate, invert_first, invert_first_by_cardano, invert_section, linear_point, linear_point_by_cardano,
};
use scene::sampling::{hash3, uniform_triangle, unit};

/// Share of the density in t ≤ 1 − u, in double precision.
fn below(b: f64, t: f64) -> f64 {
    t * t * (3.0 * b + (1.0 - 3.0 * b) * t)
}

#[test]
fn the_cubic_is_inverted_to_single_precision_for_every_share() {
    let mut worst = 0.0f64;
    let third = 1.0f32 / 3.0;
    let shares = (0..=1000).map(|k| k as f32 / 1000.0);
    let near: Vec<f32> = (0..40).flat_map(|k| [third - 0.5f32.powi(k), third + 0.5f32.powi(k)]).collect();
    let tiny = (1..38).map(|k| 10f32.powi(-k));
    for b in shares.chain(near).chain(tiny).filter(|b| (0.0..=1.0).contains(b)) {
        let betas = (0..=512).map(|k| k as f32 / 512.0).chain((1..24).map(|k| 0.5f32.powi(k)));
        for beta in betas {
            let t = invert_first(b, beta);
            assert!((0.0..=1.0).contains(&t), "{b} {beta}: {t}");
            let found = below(f64::from(b), f64::from(t));
            // Near the corner the root itself is right to a few roundings, not only its density.
            worst = worst.max((found - f64::from(beta)).abs() / (1e-2 + f64::from(beta)));
        }
    }
    assert!(worst < 1.2e-6, "{worst}");
}

#[test]
fn the_printed_cubic_has_the_same_root() {
    for k in 0..2000 {
        let r = |d: u32| f64::from(unit(hash3(k, d, 3)));
        let a = r(0);
        let b = r(1);
        let c = r(2);
        let s = a + b + c;
        let alpha = r(3);
        let u = 1.0 - f64::from(invert_first((b / s) as f32, (1.0 - alpha) as f32));
        let cubic = u.powi(3) * (s - 3.0 * b) - 3.0 * u * u * (s - 2.0 * b) + 3.0 * u * (s - b) - alpha * s;
        assert!(cubic.abs() < 2e-6 * s, "{a} {b} {c} {alpha}: {cubic}");
    }
}

/// Greatest differences of a formula for u to Newton's root, and of the density below it to what it should be: over
/// shares of the second corner from 0 to 1, those near a third included, where the cubic is nearly a quadratic.
fn worst_of_cardano(formula: impl Fn(f32, f32) -> f32) -> (f32, f64) {
    let third = 1.0f32 / 3.0;
    let shares = (0..=1000).map(|k| k as f32 / 1000.0);
    let near = (1..30).flat_map(|k| [third - 0.6f32.powi(k), third + 0.6f32.powi(k)]);
    let mut root = 0.0f32;
    let mut density = 0.0f64;
    for b in shares.chain(near).filter(|b| (0.0..=1.0).contains(b)) {
        for alpha in (0..=512).map(|k| k as f32 / 512.0) {
            let u = formula(b, alpha);
            assert!((0.0..=1.0).contains(&u), "{b} {alpha}: {u}");
            root = root.max((u - (1.0 - invert_first(b, 1.0 - alpha))).abs());
            density = density.max((1.0 - below(f64::from(b), 1.0 - f64::from(u)) - f64::from(alpha)).abs());
        }
    }
    (root, density)
}

#[test]
fn cardanos_formula_has_the_root_of_newtons_method() {
    let (root, density) = worst_of_cardano(invert_first_by_cardano);
    // Single precision, divided by 1 − 3b. The root is worst in the corner, where nothing lies.
    assert!(root < 0.012 && density < 2e-3, "{root} {density}");
    assert!(density > 1e-4, "Newton's method is better: {density}");
    // Corners that hold nothing or all: closed forms u = 1 − ∛(1 − α), and 3u² − 2u³ = α.
    for alpha in [0.0f32, 0.1, 0.5, 0.9, 1.0] {
        assert!((invert_first_by_cardano(0.0, alpha) - (1.0 - (1.0 - alpha).cbrt())).abs() < 1e-6, "{alpha}");
        let u = invert_first_by_cardano(1.0, alpha);
        assert!((u * u * (3.0 - 2.0 * u) - alpha).abs() < 2e-6, "{alpha} {u}");
    }
    // Another share of the second corner is noticed.
    assert!(worst_of_cardano(|b, alpha| invert_first_by_cardano(0.98 * b, alpha)).1 > 5e-3);
}

#[test]
fn sections_are_inverted() {
    for k in 0..=50 {
        for j in 0..=50 {
            for n in 0..=100 {
                let a = k as f32 / 50.0;
                let b = j as f32 / 50.0;
                let gamma = n as f32 / 100.0;
                let s = f64::from(invert_section(a, b, gamma));
                assert!((0.0..=1.0).contains(&s));
                let a = f64::from(a);
                let b = f64::from(b);
                let found = a * s + 0.5 * (b - a) * s * s;
                assert!((found - f64::from(gamma) * 0.5 * (a + b)).abs() < 1e-6, "{a} {b} {gamma}: {s}");
            }
        }
    }
}

/// Cells of the triangle cut twice into four.
fn cells() -> Vec<[Vec2; 3]> {
    let mut cells = vec![[Vec2::ZERO, Vec2::X, Vec2::Y]];
    for _ in 0..2 {
        let four = |[a, b, c]: [Vec2; 3]| {
            let p = (a + b) * 0.5;
            let q = (b + c) * 0.5;
            let r = (c + a) * 0.5;
            [[a, p, r], [p, b, q], [r, q, c], [p, q, r]]
        };
        cells = cells.into_iter().flat_map(four).collect();
    }
    cells
}

fn cell_of(cells: &[[Vec2; 3]], at: Vec2) -> usize {
    let outside = |c: &[Vec2; 3]| {
        let edge = |a: Vec2, b: Vec2| -(b - a).perp_dot(at - a);
        edge(c[0], c[1]).max(edge(c[1], c[2])).max(edge(c[2], c[0]))
    };
    (0..cells.len()).min_by(|&a, &b| outside(&cells[a]).total_cmp(&outside(&cells[b]))).unwrap()
}

/// χ² of 1,000 triangles with 15 degrees of freedom each: their sum, and the greatest.
fn chi_squared(sample: impl Fn(Vec3, f32, f32) -> Vec2) -> (f64, f64) {
    let cells = cells();
    let count = 2000u32;
    let mut sum = 0.0f64;
    let mut greatest = 0.0f64;
    for triangle in 0..1000u32 {
        let mut values = Vec3::from([0u32, 1, 2].map(|d| unit(hash3(triangle, d, 1))));
        // Zeros in one or two corners, three equal, values of very different size.
        match triangle % 8 {
            0 => values.x = 0.0,
            1 => values.y = 0.0,
            2 => values.z = 0.0,
            3 => (values.x, values.y) = (0.0, 0.0),
            4 => (values.y, values.z) = (0.0, 0.0),
            5 => values = Vec3::splat(values.x),
            6 => values *= Vec3::new(1.0, 1e-4, 1e4),
            _ => {}
        }
        let mut found = vec![0u32; cells.len()];
        for k in 0..count {
            let x = unit(hash3(k, 2 * triangle, 7));
            let y = unit(hash3(k, 2 * triangle + 1, 7));
            let at = sample(values, x, y);
            assert!(at.x >= 0.0 && at.y >= 0.0 && at.x + at.y <= 1.0 + 1e-6 && at.is_finite(), "{values} {at}");
            found[cell_of(&cells, at)] += 1;
        }
        let total: f32 = values.element_sum() / 3.0;
        let mut own = 0.0;
        for (cell, found) in cells.iter().zip(found) {
            let middle = (cell[0] + cell[1] + cell[2]) / 3.0;
            let expected = f64::from(interpolate(values, middle) / total) / cells.len() as f64 * f64::from(count);
            if expected > 0.0 {
                own += (f64::from(found) - expected).powi(2) / expected;
            } else {
                assert_eq!(found, 0);
            }
        }
        sum += own;
        greatest = greatest.max(own);
    }
    (sum, greatest)
}

#[test]
fn start_points_of_random_triangles_have_the_linear_density() {
    for point in [linear_point, linear_point_by_cardano] {
        let (sum, greatest) = chi_squared(point);
        // 15,000 degrees of freedom: ± 173 (1 σ); 60 in one triangle happens once in 10⁶.
        assert!((sum - 15_000.0).abs() < 4.0 * 173.0 && greatest < 60.0, "{sum} {greatest}");
    }
}

#[test]
fn wrong_densities_are_noticed() {
    let uniform = |_: Vec3, x: f32, y: f32| {
        let (u, v) = uniform_triangle((x, y));
        Vec2::new(u, v)
    };
    assert!(chi_squared(uniform).0 > 100_000.0);
    // Corners taken for each other.
    assert!(chi_squared(|v, x, y| linear_point(Vec3::new(v.y, v.x, v.z), x, y)).0 > 100_000.0);
    // Only 3 % off.
    let flat = |v: Vec3, x, y| linear_point(v + 0.03 * v.element_sum(), x, y);
    assert!(chi_squared(flat).0 > 15_000.0 + 10.0 * 173.0);
}

#[test]
fn no_light_at_any_corner_gives_points_inside() {
    for values in [Vec3::ZERO, Vec3::splat(1e-38), Vec3::new(0.0, 1e-30, 0.0), Vec3::new(3e38, 0.0, 0.0)] {
        for k in 0..1000 {
            let at = linear_point(values, unit(hash3(k, 0, 1)), unit(hash3(k, 1, 1)));
            assert!(at.x >= 0.0 && at.y >= 0.0 && at.x + at.y <= 1.0 + 1e-6, "{values}: {at}");
        }
    }
}
