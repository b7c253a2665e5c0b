//! Statistics of samples, and what light must do over frames.

use glam::{Vec3, Vec4};
use patchlight_temporal::kernel::sample::{first_word, word};
use patchlight_temporal::kernel::tables::draw;
use patchlight_temporal::{AliasTables, Blend, Distribution, Packing, RayLists, SampleParams, Settings, State};
use scene::sampling::{hash3, unit};
use transport::LinearOperator;

const FRAMES: u32 = 4096;

fn random(a: u32, b: u32, c: u32) -> f32 {
    unit(hash3(a, b, c))
}

/// Sparse rows of n patches: up to 60 entries of most different size, sums up to 0.95; every 17th row has none.
fn rows(n: u32, seed: u32) -> (Vec<u32>, Vec<u32>, Vec<f32>) {
    let mut row_start = vec![0];
    let mut columns = Vec::new();
    let mut values = Vec::new();
    for i in 0..n {
        let count = if i % 17 == 5 { 0 } else { 1 + hash3(i, 1, seed) % 60 };
        let mut own: Vec<u32> = (0..count).map(|k| hash3(i, 10 + k, seed) % n).filter(|&j| j != i).collect();
        own.sort_unstable();
        own.dedup();
        let sizes: Vec<f32> = own.iter().map(|&j| 0.01 + random(i, j, seed).powi(6)).collect();
        let scale = (0.5 + 0.45 * random(i, 2, seed)) / sizes.iter().sum::<f32>().max(0.01);
        columns.extend(own);
        values.extend(sizes.iter().map(|v| v * scale));
        row_start.push(columns.len() as u32);
    }
    (row_start, columns, values)
}

fn light(n: u32, seed: u32) -> Vec<Vec4> {
    (0..n).map(|j| Vec4::new(random(j, 0, seed), random(j, 1, seed).powi(4), 3.0 * random(j, 2, seed), 0.0)).collect()
}

fn tables(n: u32, seed: u32, packing: Packing) -> AliasTables {
    let (row_start, columns, values) = rows(n, seed);
    AliasTables::from_rows(n as usize, &row_start, &columns, &values, packing).unwrap()
}

fn lists(n: u32, seed: u32) -> RayLists {
    let (row_start, columns, values) = rows(n, seed);
    RayLists::from_rows(n as usize, &row_start, &columns, &values, 256).unwrap()
}

/// Plain sums in double precision.
fn exact(n: u32, seed: u32, light: &[Vec4]) -> Vec<Vec4> {
    let (row_start, columns, values) = rows(n, seed);
    let row = |i: usize| {
        let mut sum = [0.0f64; 3];
        for k in row_start[i] as usize..row_start[i + 1] as usize {
            let b = light[columns[k] as usize];
            (0..3).for_each(|c| sum[c] += f64::from(values[k]) * f64::from(b[c]));
        }
        Vec4::new(sum[0] as f32, sum[1] as f32, sum[2] as f32, 0.0)
    };
    (0..n as usize).map(row).collect()
}

/// Scores `(mean − expected) / standard error` of every row and channel over 4,096 frames of independent samples; those
/// without noise must be right and are left out.
fn scores(rows: &dyn Distribution, light: &[Vec4], expected: &[Vec4], rotated: bool) -> Vec<f64> {
    let settings =
        Settings { samples: 16, control_variate: false, blend: Blend::Fixed(0.0), rotated, ..Settings::default() };
    let n = rows.rows();
    let mut sums = vec![[0.0f64; 3]; n];
    let mut squares = vec![[0.0f64; 3]; n];
    let mut out = vec![Vec4::ZERO; n];
    for frame in 0..FRAMES {
        rows.sample(&settings.params(n as u32, 0, frame), light, light, &mut out).unwrap();
        for (i, h) in out.iter().enumerate() {
            for c in 0..3 {
                sums[i][c] += f64::from(h[c]);
                squares[i][c] += f64::from(h[c]).powi(2);
            }
        }
    }
    let f = f64::from(FRAMES);
    let mut scores = Vec::new();
    for i in 0..n {
        for c in 0..3 {
            let mean = sums[i][c] / f;
            let expected = f64::from(expected[i][c]);
            let error = ((squares[i][c] / f - mean * mean).max(0.0) / (f - 1.0)).sqrt();
            if error < 1e-6 * mean.max(1e-9) {
                if (mean - expected).abs() > 1e-5 * expected {
                    scores.push(f64::INFINITY);
                }
                continue;
            }
            scores.push((mean - expected) / error);
        }
    }
    scores
}

/// Returns true if scores are those of a normal distribution. Their squares sum up to a chi-square: n on average, √(6
/// n) its deviation at most, the three channels of a row going together. 0.27 % of single scores exceed 3: of 550 none
/// to five do with a probability of 99.5 %, and none exceeds 5.
fn unbiased(scores: &[f64]) -> bool {
    let n = scores.len() as f64;
    let squares: f64 = scores.iter().map(|z| z * z).sum();
    let beyond = scores.iter().filter(|z| z.abs() > 3.0).count();
    println!("{n} scores, mean square {:.3}, {beyond} beyond 3", squares / n);
    n > 100.0
        && (squares - n).abs() < 4.0 * (6.0 * n).sqrt()
        && beyond as f64 <= 0.0027 * n + 4.0 * (0.0027 * n).sqrt()
        && scores.iter().all(|z| z.abs() < 5.0)
}

#[test]
fn the_mean_of_many_frames_is_the_product() {
    let n = 200;
    let seed = 1;
    let light = light(n, 5);
    // A column off by a little: one patch in five is 3 % brighter.
    let wrong: Vec<Vec4> = light.iter().enumerate().map(|(j, b)| if j % 5 == 0 { *b * 1.03 } else { *b }).collect();
    let expected = exact(n, seed, &light);
    for packing in [Packing::Stacks, Packing::Split] {
        let tables = tables(n, seed, packing);
        assert!(unbiased(&scores(&tables, &light, &expected, false)), "{packing:?}");
        assert!(!unbiased(&scores(&tables, &wrong, &expected, false)), "{packing:?}");
    }
    // Lists whose hits are the rows.
    let lists = lists(n, seed);
    let mut of_lists = vec![Vec4::ZERO; n as usize];
    lists.apply(&light, &mut of_lists).unwrap();
    assert!(unbiased(&scores(&lists, &light, &of_lists, false)));
    assert!(!unbiased(&scores(&lists, &wrong, &of_lists, false)));
    // Of a lattice frames are not independent: their mean comes much closer.
    for rows in [&lists as &dyn Distribution, &tables(n, seed, Packing::Stacks)] {
        let mut product = vec![Vec4::ZERO; n as usize];
        rows.apply(&light, &mut product).unwrap();
        let scores = scores(rows, &light, &product, true);
        let most = scores.iter().fold(0.0f64, |m, z| m.max(z.abs()));
        println!("lattice: greatest score {most:.3}");
        assert!(scores.len() > 100 && most < 0.5);
    }
}

#[test]
fn rgb_operators_have_the_products_mean() {
    let n = 60u32;
    let row = |i: usize, out: &mut [Vec3]| {
        for (j, c) in out.iter_mut().enumerate() {
            let random = |k: u32| random(i as u32, j as u32, 70 + k);
            // Sums above 1, as those of all bounces may be.
            *c = Vec3::new(random(0), random(1), random(2)).powf(4.0) * 0.3;
        }
    };
    let tables = AliasTables::from_rgb(n as usize, n as usize, Packing::Stacks, row).unwrap();
    assert!(tables.sums().iter().all(|&s| s > 1.0));
    // 8 bytes an entry beside the rows' starts and sums.
    assert_eq!(tables.bytes(), 8 * 3600 + 4 * 61 + 4 * 60);
    let light = light(n, 6);
    let mut product = vec![Vec4::ZERO; n as usize];
    tables.apply(&light, &mut product).unwrap();
    // The operator itself, to the steps of its colours.
    let mut colors = vec![Vec3::ZERO; n as usize];
    for (i, found) in product.iter().enumerate() {
        row(i, &mut colors);
        let sum: Vec3 = colors.iter().zip(&light).map(|(t, b)| *t * b.truncate()).sum();
        let error = (found.truncate() - sum).abs() / sum;
        assert!(error.max_element() < 0.01, "row {i}: {error}");
    }
    assert!(unbiased(&scores(&tables, &light, &product, false)));
    let swapped: Vec<Vec4> = product.iter().map(|h| Vec4::new(h.z, h.y, h.x, 0.0)).collect();
    assert!(!unbiased(&scores(&tables, &light, &swapped, false)));
}

/// Chi-square of draws from a row of a table against these weights, over its degrees of freedom in standard deviations.
fn chi_square(tables: &AliasTables, row: usize, weights: &[u64], rotated: bool) -> f64 {
    let range = [tables.row_start()[row], tables.row_start()[row + 1]];
    let n = range[1] - range[0];
    let settings = Settings { samples: 64, rotated, seed: 9, ..Settings::default() };
    let mut counts = vec![0u64; n as usize];
    let frames = 2048;
    for frame in 0..frames {
        let p: SampleParams = settings.params(1, 0, frame);
        let first = first_word(row as u32, &p);
        (0..p.samples).for_each(|k| counts[draw(word(first, k, &p), range[0], n, tables.slots()) as usize] += 1);
    }
    let all: u64 = weights.iter().sum();
    let drawn = f64::from(frames * settings.samples);
    let terms = counts.iter().zip(weights).map(|(&count, &weight)| {
        let expected = drawn * weight as f64 / all as f64;
        (count as f64 - expected).powi(2) / expected
    });
    let freedom = f64::from(n - 1);
    (terms.sum::<f64>() - freedom) / (2.0 * freedom).sqrt()
}

#[test]
fn draws_have_the_rows_distribution() {
    let (row_start, _, values) = rows(200, 3);
    let long: Vec<usize> = (0..200).filter(|&i| row_start[i + 1] - row_start[i] > 20).collect();
    for packing in [Packing::Stacks, Packing::Split] {
        let tables = tables(200, 3, packing);
        assert_eq!(tables.row_start(), row_start);
        let mut most = f64::MIN;
        let mut least_wrong = f64::MAX;
        for &i in &long {
            let own = &values[row_start[i] as usize..row_start[i + 1] as usize];
            let weights = tables.weights(i);
            // The table's weights are the row's, to one part.
            let n = own.len() as f64;
            let sum = own.iter().map(|&v| f64::from(v)).sum::<f64>();
            for (v, w) in own.iter().zip(&weights) {
                assert!((f64::from(*v) / sum * n * 65_536.0 - *w as f64).abs() <= 1.0 + 1e-6 * *w as f64);
            }
            most = most.max(chi_square(&tables, i, &weights, false));
            // Other rows have other weights: two neighbours exchanged.
            let mut wrong = weights.clone();
            let (a, b) =
                (0..wrong.len() - 1).map(|k| (k, k + 1)).max_by_key(|&(a, b)| wrong[a].abs_diff(wrong[b])).unwrap();
            wrong.swap(a, b);
            least_wrong = least_wrong.min(chi_square(&tables, i, &wrong, false));
            // A lattice is closer than chance.
            assert!(chi_square(&tables, i, &weights, true) < 0.0);
        }
        println!(
            "{packing:?}: {} rows, {most:.2} deviations at most, wrong ones {least_wrong:.1} at least",
            long.len()
        );
        // Chi-square has a longer tail than a normal distribution: 5 deviations are rarer than 1 in 10,000.
        assert!(most < 5.0 && least_wrong > 20.0);
    }
}

#[test]
fn entries_too_small_for_a_part_leave_whole_rows() {
    let mut values: Vec<f32> = (0..1000).map(|k| if k % 3 == 0 { 1e-9 * k as f32 } else { 1.0 }).collect();
    values[1] = 1e6;
    let columns: Vec<u32> = (0..1000).collect();
    let tables = AliasTables::from_rows(1000, &[0, 1000], &columns, &values, Packing::Stacks).unwrap();
    let weights = tables.weights(0);
    assert!(weights.len() < 700 && !weights.contains(&0));
    assert_eq!(weights.iter().sum::<u64>(), 65_536 * weights.len() as u64);
}

#[test]
fn both_packings_have_the_same_distribution() {
    for seed in 0..20 {
        let a = tables(150, seed, Packing::Stacks);
        let b = tables(150, seed, Packing::Split);
        assert_eq!((a.words(), a.sums()), (b.words(), b.sums()));
        assert!((0..150).all(|i| a.weights(i) == b.weights(i)), "{seed}");
        let parts = |i: usize| a.weights(i).iter().sum::<u64>() == 65_536 * a.weights(i).len() as u64;
        assert!((0..150).all(parts));
    }
    let a = tables(150, 1, Packing::Stacks);
    let b = tables(150, 2, Packing::Split);
    assert!((0..150).any(|i| a.weights(i) != b.weights(i)));
}

/// Light of all bounces, by iteration.
fn at_rest(rows: &dyn Distribution, source: &[Vec4], albedo: &[Vec4]) -> Vec<Vec4> {
    let mut irradiance = vec![Vec4::ZERO; source.len()];
    for _ in 0..400 {
        let exitance: Vec<Vec4> = (0..source.len()).map(|i| source[i] + albedo[i] * irradiance[i]).collect();
        rows.apply(&exitance, &mut irradiance).unwrap();
    }
    irradiance
}

/// Relative L2 distance.
fn distance(found: &[Vec4], expected: &[Vec4]) -> f32 {
    let length = |v: Vec3| v.length_squared();
    let squares: f32 = found.iter().zip(expected).map(|(a, b)| length((*a - *b).truncate())).sum();
    (squares / expected.iter().map(|b| length(b.truncate())).sum::<f32>()).sqrt()
}

fn albedo(n: u32) -> Vec<Vec4> {
    (0..n).map(|i| Vec4::new(0.2, 0.8, 0.5, 0.0) * (0.5 + 0.5 * random(i, 0, 8))).collect()
}

#[test]
fn still_light_has_no_noise_at_all_with_the_control_variate() {
    let n = 200;
    let source = light(n, 5);
    let albedo = albedo(n);
    for samples in [1, 4, 16] {
        for rows in [&lists(n, 1) as &dyn Rows, &tables(n, 1, Packing::Stacks)] {
            let settings = Settings { samples, ..Settings::default() };
            let mut state = State::new(n as usize);
            let rest = at_rest(rows.as_distribution(), &source, &albedo);
            let mut last_change = 0;
            for frame in 0..1500 {
                let before = state.irradiance.clone();
                rows.advance(&mut state, &source, &albedo, &settings);
                if state.irradiance != before {
                    last_change = frame;
                }
            }
            let error = distance(&state.irradiance, &rest);
            println!("{samples} samples: last change in frame {last_change}, error {error:.1e}");
            assert!(last_change < 1000 && error < 3e-5, "{samples}: {last_change} {error}");
            // What is not still moves again.
            let other: Vec<Vec4> = source.iter().map(|e| *e * 1.01).collect();
            let before = state.irradiance.clone();
            rows.advance(&mut state, &other, &albedo, &settings);
            assert_ne!(state.irradiance, before);
            // Without the control variate there always is noise.
            let noisy = Settings { control_variate: false, blend: Blend::Fixed(0.9), ..settings };
            rows.advance(&mut state, &source, &albedo, &noisy);
            let before = state.irradiance.clone();
            rows.advance(&mut state, &source, &albedo, &noisy);
            assert!(distance(&state.irradiance, &before) > 1e-3);
        }
    }
}

/// Both kinds of rows behind one reference.
trait Rows: Distribution {
    fn advance(&self, state: &mut State, source: &[Vec4], albedo: &[Vec4], settings: &Settings);
    fn as_distribution(&self) -> &dyn Distribution;
}

impl<D: Distribution> Rows for D {
    fn advance(&self, state: &mut State, source: &[Vec4], albedo: &[Vec4], settings: &Settings) {
        state.advance(self, source, albedo, settings).unwrap();
    }
    fn as_distribution(&self) -> &dyn Distribution {
        self
    }
}

#[test]
fn errors_of_increments_do_not_pile_up() {
    // Light that never rests, and comes back to what it was: without exact sums the errors stay.
    let n = 200;
    let source = light(n, 5);
    let albedo = albedo(n);
    let rows = lists(n, 1);
    let moved = light(n, 6);
    let after = |refresh: u32| {
        let settings = Settings { samples: 8, refresh, ..Settings::default() };
        let mut state = State::new(n as usize);
        for frame in 0..400 {
            state.advance(&rows, if frame % 4 < 2 { &source } else { &moved }, &albedo, &settings).unwrap();
        }
        (0..64).for_each(|_| state.advance(&rows, &source, &albedo, &settings).unwrap());
        distance(&state.irradiance, &at_rest(&rows, &source, &albedo))
    };
    let with = after(16);
    let without = after(0);
    println!("error {with:.1e} with exact sums, {without:.1e} without");
    assert!(with < 1e-3 && without > 0.1);
}

#[test]
fn increments_are_unbiased() {
    // The mean over seeds of light that has changed twice; no exact sums.
    let n = 120;
    let rows = lists(n, 4);
    let black = vec![Vec4::ZERO; n as usize];
    let lights =
        [light(n, 5), light(n, 6), light(n, 7)].map(|l| l.iter().map(|b| *b + Vec4::splat(4.0)).collect::<Vec<_>>());
    let mut product = vec![Vec4::ZERO; n as usize];
    rows.apply(&lights[2], &mut product).unwrap();
    let mut sum = vec![0.0f64; n as usize];
    let mut squares = vec![0.0f64; n as usize];
    let seeds = 2048;
    for seed in 0..seeds {
        let settings = Settings { samples: 16, rotated: false, refresh: 0, seed, ..Settings::default() };
        let mut state = State::new(n as usize);
        lights.iter().for_each(|l| state.advance(&rows, l, &black, &settings).unwrap());
        for (i, h) in state.irradiance.iter().enumerate() {
            sum[i] += f64::from(h.y);
            squares[i] += f64::from(h.y).powi(2);
        }
    }
    let f = f64::from(seeds);
    let score = |i: usize, expected: f64| {
        let mean = sum[i] / f;
        (mean - expected) / ((squares[i] / f - mean * mean).max(0.0) / (f - 1.0)).sqrt()
    };
    let of = |scale: f64| -> Vec<f64> {
        let noisy = (0..n as usize).filter(|&i| squares[i] / f - (sum[i] / f).powi(2) > 1e-9);
        noisy.map(|i| score(i, f64::from(product[i].y) * scale)).collect()
    };
    assert!(unbiased(&of(1.0)));
    assert!(!unbiased(&of(1.01)));
}

#[test]
fn a_step_of_the_light_arrives_within_eight_frames() {
    let n = 200;
    let source = light(n, 5);
    let albedo = albedo(n);
    let rows = lists(n, 1);
    let bright: Vec<Vec4> = source.iter().enumerate().map(|(j, e)| *e * if j % 2 == 0 { 3.0 } else { 0.1 }).collect();
    let from = at_rest(&rows, &source, &albedo);
    let to = at_rest(&rows, &bright, &albedo);
    let settings = [
        Settings { samples: 64, ..Settings::default() },
        Settings { samples: 64, control_variate: false, ..Settings::default() },
        Settings { samples: 64, control_variate: false, blend: Blend::Fixed(0.6), ..Settings::default() },
    ];
    let whole = |h: &[Vec4]| h.iter().map(|h| h.truncate().element_sum()).sum::<f32>();
    let response = |settings: &Settings| {
        let mut state = State::new(n as usize);
        (0..200).for_each(|_| state.advance(&rows, &source, &albedo, settings).unwrap());
        (0..8).for_each(|_| state.advance(&rows, &bright, &albedo, settings).unwrap());
        // Of the whole light, and row by row but for noise.
        let share = (whole(&state.irradiance) - whole(&from)) / (whole(&to) - whole(&from));
        (share, distance(&state.irradiance, &to) / distance(&from, &to))
    };
    for settings in &settings {
        let (share, left) = response(settings);
        println!("{settings:?}: {share:.3}, left {left:.3}");
        assert!((0.9..1.1).contains(&share) && left < 0.2, "{settings:?}: {share} {left}");
    }
    let slow = Settings { blend: Blend::Fixed(0.95), ..settings[2] };
    assert!(response(&slow).0 < 0.9);
}

#[test]
fn light_that_chooses_its_weight_follows_and_rests() {
    // Errors of light that moves steadily, and noise of light that rests, beside those of fixed weights.
    let n = 200;
    let source = light(n, 5);
    let black = vec![Vec4::ZERO; n as usize];
    let rows = lists(n, 1);
    let at = |t: f32| -> Vec<Vec4> {
        source
            .iter()
            .enumerate()
            .map(|(j, e)| *e * (1.2 + scene::math::sin_cos_2pi(0.008 * t + 0.159 * j as f32).0))
            .collect()
    };
    let errors = |blend: Blend| {
        let settings = Settings { samples: 8, control_variate: false, rotated: false, blend, ..Settings::default() };
        let mut state = State::new(n as usize);
        let mut exact = vec![Vec4::ZERO; n as usize];
        let mut mean = [0.0f32; 2];
        for frame in 0..400 {
            let now = at((frame as f32).min(200.0));
            state.advance(&rows, &now, &black, &settings).unwrap();
            rows.apply(&now, &mut exact).unwrap();
            let error = distance(&state.irradiance, &exact);
            match frame {
                50..200 => mean[0] += error / 150.0,
                300.. => mean[1] += error / 100.0,
                _ => {}
            }
        }
        mean
    };
    let auto = errors(Blend::Auto { frames: 100.0 });
    let short = errors(Blend::Fixed(0.5));
    let long = errors(Blend::Fixed(0.98));
    println!("moving and resting: by itself {auto:?}, w 0.5 {short:?}, w 0.98 {long:?}");
    // As good as each where that one is good, and better where it is not.
    assert!(auto[0] < 1.15 * short[0].min(long[0]) && auto[1] < 1.3 * long[1]);
    assert!(auto[1] < 0.5 * short[1]);
}

#[test]
fn white_furnace() {
    // A closed room: every row sums to 1.
    let n = 100usize;
    let hits: Vec<u32> = (0..n as u32).flat_map(|i| (0..64).map(move |k| hash3(i, k, 4) % 100)).collect();
    let rows = RayLists::from_hits(n, &hits, 64).unwrap();
    let source = vec![Vec4::new(1.0, 2.0, 0.5, 0.0); n];
    let rho = 0.7;
    for (control_variate, blend) in
        [(true, Blend::Fixed(0.5)), (false, Blend::Fixed(0.5)), (false, Blend::Auto { frames: 8.0 })]
    {
        let settings = Settings { samples: 4, control_variate, blend, ..Settings::default() };
        let mut state = State::new(n);
        (0..200).for_each(|_| state.advance(&rows, &source, &vec![Vec4::splat(rho); n], &settings).unwrap());
        for h in &state.irradiance {
            let expected = source[0].truncate() / (1.0 - rho);
            let error = ((h.truncate() - expected) / expected).abs().max_element();
            // Uniform light has no noise, however few the samples.
            assert!(error < 1e-3, "{settings:?}: {h} for {expected}");
            assert!((h.truncate() - expected / 1.01).length() > 1e-3, "a darker room passes");
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let n = 300;
    let source = light(n, 5);
    let albedo = albedo(n);
    let run = |threads: usize, seed: u32, control_variate: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let settings = Settings { samples: 8, seed, control_variate, ..Settings::default() };
            let rows = tables(n, 1, Packing::Split);
            let mut a = State::new(n as usize);
            let mut b = State::new(n as usize);
            for _ in 0..20 {
                a.advance(&rows, &source, &albedo, &settings).unwrap();
                b.advance(&lists(n, 1), &source, &albedo, &settings).unwrap();
            }
            (rows, a, b)
        })
    };
    for control_variate in [true, false] {
        assert_eq!(run(1, 3, control_variate), run(3, 3, control_variate));
        assert_ne!(run(1, 3, control_variate).1, run(1, 4, control_variate).1);
    }
}
