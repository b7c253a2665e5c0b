//! Operators of many bounces against each other, and their compression against what it promises.

mod support;

use bytemuck::{cast_slice, cast_slice_mut};
use faer::Mat;
use glam::{UVec4, Vec3, Vec4};
use patchlight_multibounce::{
    Channels, Error, Factors, LowRank, StoredOperator, TileSide, TileSource, Workspace, all_bounces, all_bounces_lu,
    all_bounces_stored, dense_sparse_all, halving_order, kernel, multiply_u_all, multiply_vt_all, permute_in_all,
    quantise_all, requantise_all, some_bounces, some_bounces_stored,
};
use proptest::prelude::*;
use support::{go, random};
use transport::{LinearOperator, Proceed};

/// Reciprocal form factors of a closed set of patches on a line: near ones see more of each other.
struct Case {
    area: Vec<f32>,
    row_start: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f32>,
}

impl Case {
    fn new(n: usize, noise: f32) -> Self {
        let area: Vec<f32> = (0..n).map(|i| 0.2 + random(i, 0, 1)).collect();
        let s = |i: usize, j: usize| {
            let (i, j) = (i.min(j), i.max(j));
            let x = (j - i) as f32 / n as f32;
            if i == j { 0.0 } else { area[i] * area[j] / (0.01 + x * x) * (1.0 + noise * (random(i, j, 2) - 0.5)) }
        };
        // One scale for all, so that F stays reciprocal and no row exceeds 1.
        let sums: Vec<f32> = (0..n).map(|i| (0..n).map(|j| s(i, j)).sum::<f32>() / area[i]).collect();
        let most = sums.iter().copied().fold(0.0, f32::max);
        let mut row_start = vec![0];
        let mut columns = Vec::new();
        let mut values = Vec::new();
        for (i, area) in area.iter().enumerate() {
            for j in (0..n).filter(|&j| j != i) {
                columns.push(j as u32);
                values.push(s(i, j) / (area * most));
            }
            row_start.push(values.len() as u32);
        }
        Self { area, row_start, columns, values }
    }

    fn factors(&self) -> Factors<'_> {
        Factors { row_start: &self.row_start, columns: &self.columns, values: &self.values, area: &self.area }
    }

    fn dense(&self) -> Mat<f32> {
        let n = self.area.len();
        let mut dense = Mat::zeros(n, n);
        for i in 0..n {
            for k in self.row_start[i] as usize..self.row_start[i + 1] as usize {
                dense[(i, self.columns[k] as usize)] = self.values[k];
            }
        }
        dense
    }

    fn order(&self) -> Vec<u32> {
        let n = self.area.len();
        halving_order(&(0..n).map(|i| Vec3::X * i as f32).collect::<Vec<_>>(), &vec![Vec3::Z; n], &[])
    }
}

fn albedo(n: usize, channel: u32) -> Vec<f32> {
    (0..n).map(|i| if i % 7 == 0 { 0.0 } else { 0.3 + 0.6 * random(i, 0, 5 + channel) }).collect()
}

/// `a^-½ M a^½`.
fn unscaled(matrix: &Mat<f32>, area: &[f32]) -> Mat<f32> {
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)] * (area[j] / area[i]).sqrt())
}

fn difference(a: &Mat<f32>, b: &Mat<f32>) -> f32 {
    (a - b).norm_l2() / b.norm_l2()
}

#[test]
fn cholesky_lu_and_many_bounces_agree() {
    let case = Case::new(90, 0.5);
    let rho = albedo(90, 0);
    let f = case.dense();
    let symmetric = case.factors().symmetric().unwrap();
    let all = unscaled(&all_bounces(symmetric.clone(), &rho).unwrap(), &case.area);
    let lu = all_bounces_lu(&f, &rho).unwrap();
    assert!(difference(&all, &lu) < 1e-5, "{}", difference(&all, &lu));
    // 0.9^k of the light is left after k bounces.
    let many = some_bounces(&f, &rho, 200, &go).unwrap();
    assert!(difference(&many, &lu) < 1e-4, "{}", difference(&many, &lu));
    let few = some_bounces(&f, &rho, 4, &go).unwrap();
    assert!(difference(&few, &lu) > 0.01, "four bounces are not all");
    // The same in symmetric form.
    let few_symmetric = unscaled(&some_bounces(&symmetric, &rho, 4, &go).unwrap(), &case.area);
    assert!(difference(&few_symmetric, &few) < 1e-5);
    // Other reflectances give another operator.
    assert!(difference(&all_bounces_lu(&f, &albedo(90, 1)).unwrap(), &lu) > 1e-3);
}

#[test]
fn horner_is_the_sum_of_explicit_powers() {
    let case = Case::new(40, 0.5);
    let rho = albedo(40, 0);
    let f = case.dense();
    let reflected = Mat::from_fn(40, 40, |i, j| rho[i] * f[(i, j)]);
    let mut power = Mat::<f32>::identity(40, 40);
    let mut sum = Mat::<f32>::zeros(40, 40);
    for bounces in 1..6 {
        sum += &f * &power;
        power = &reflected * &power;
        let horner = some_bounces(&f, &rho, bounces, &go).unwrap();
        assert!(difference(&horner, &sum) < 1e-6, "{bounces}: {}", difference(&horner, &sum));
    }
    let stop = |_: usize, _: usize| Proceed::Break(());
    assert_eq!(some_bounces(&f, &rho, 3, &stop), Err(transport::Error::Cancelled { done: 1, total: 2 }.into()));
}

/// All of an operator in a file.
fn whole(operator: &StoredOperator) -> Mat<f32> {
    let n = operator.patches();
    let mut out = Mat::zeros(n, n);
    let mut row = vec![0.0; n];
    for i in 0..n {
        operator.row(i, &mut row).unwrap();
        (0..n).for_each(|j| out[(i, j)] = row[j]);
    }
    // Products are those of the rows.
    let light: Vec<f32> = (0..n).map(|i| random(i, 3, 8)).collect();
    operator.product(&light, &mut row).unwrap();
    for (i, y) in row.iter().enumerate() {
        let expected: f32 = (0..n).map(|j| out[(i, j)] * light[j]).sum();
        assert!((y - expected).abs() <= 1e-5 * expected, "{y} for {expected}");
    }
    out
}

/// Bytes of memory that panels may take, of which the least are some for so few patches.
const LIMITS: [u64; 3] = [1 << 20, 2 << 20, 1 << 30];

#[test]
fn operators_in_files_are_those_in_memory_and_keep_to_the_limit() {
    let folder = tempfile::tempdir().unwrap();
    for (n, dark) in [(700, true), (512, false), (90, true)] {
        let case = Case::new(n, 0.5);
        let rho: Vec<f32> = albedo(n, 0).iter().map(|&a| if dark { a } else { a.max(0.2) }).collect();
        let symmetric = case.factors().symmetric().unwrap();
        let order = case.order();
        let all = all_bounces(symmetric.clone(), &rho).unwrap();
        let some = some_bounces(&symmetric, &rho, 4, &go).unwrap();
        let mut last = u64::MAX;
        for bytes in LIMITS.into_iter().rev() {
            let workspace = Workspace { folder: folder.path(), bytes };
            let stored = all_bounces_stored(&case.factors(), &rho, &order, &workspace, &go).unwrap();
            let error = difference(&whole(&stored), &all);
            assert!(error < 1e-5, "{n} patches in {bytes} bytes: {error}");
            assert!(stored.held_bytes <= bytes.min(last), "{} of {bytes} bytes", stored.held_bytes);
            last = stored.held_bytes;
            let few = some_bounces_stored(&case.factors(), &rho, 4, &order, &workspace, &go).unwrap();
            let error = difference(&whole(&few), &some);
            assert!(error < 1e-5 && few.held_bytes <= bytes, "{n} patches in {bytes} bytes: {error}");
            assert!(difference(&whole(&few), &all) > 0.01, "four bounces are not all");
            let other = all_bounces_stored(&case.factors(), &albedo(n, 1), &order, &workspace, &go).unwrap();
            assert!(difference(&whole(&other), &all) > 1e-3, "another reflectance is not noticed");
        }
        // Far less than in memory.
        assert!(n < 700 || last < 7 * 4 * (n * n) as u64 / 8, "{last}");
    }
    // Files have no name, and are gone.
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn tiles_of_operators_in_files_are_those_of_operators_in_memory() {
    let n = 300;
    let case = Case::new(n, 0.3);
    let folder = std::env::temp_dir();
    let order = case.order();
    let workspace = Workspace { folder: &folder, bytes: 1 << 20 };
    let store = |c| some_bounces_stored(&case.factors(), &albedo(n, c), 3, &order, &workspace, &go).unwrap();
    let stored = [store(0), store(1), store(2)];
    // The upper triangles in their order, to the bit.
    let mut permuted_index = vec![0; n];
    (0..n).for_each(|p| permuted_index[order[p] as usize] = p);
    let upper = |m: &Mat<f32>| {
        Mat::from_fn(
            n,
            n,
            |i, j| if permuted_index[i] / 128 <= permuted_index[j] / 128 { m[(i, j)] } else { m[(j, i)] },
        )
    };
    let [r, g, b] = stored.each_ref().map(|stored| upper(&whole(stored)));
    let encode = |channels, order: &[u32]| tiles_of(channels, &case.area, order, 1e-2, &go);
    let ours = encode(Channels::Stored(stored.each_ref()), &order).unwrap();
    assert!(ours == encode(Channels::Three([&r, &g, &b]), &order).unwrap());
    assert!(ours != encode(Channels::Three([&b, &g, &r]), &order).unwrap());
    let mut other = order.clone();
    other.swap(5, 6);
    let refused = encode(Channels::Stored(stored.each_ref()), &other);
    assert!(
        matches!(refused, Err(Error::Shared(transport::Error::Value { name: "order", index: 5, .. }))),
        "{refused:?}"
    );
}

#[test]
fn what_is_wrong_with_a_file_or_its_workspace_is_said() {
    let n = 300;
    let case = Case::new(n, 0.3);
    let rho = albedo(n, 0);
    let order = case.order();
    let folder = std::env::temp_dir();
    let make = |rho: &[f32], order: &[u32], bytes, folder: &std::path::Path| {
        all_bounces_stored(&case.factors(), rho, order, &Workspace { folder, bytes }, &go)
            .map(|stored| stored.held_bytes)
    };
    let small = make(&rho, &order, 1 << 16, &folder);
    assert!(matches!(small, Err(Error::Memory { limit: 0, .. })), "{small:?}");
    let nowhere = make(&rho, &order, 1 << 20, &folder.join("is not there")).unwrap_err();
    let message = nowhere.to_string();
    assert!(message.contains("is not there") && message.contains("another folder"), "{message}");
    assert!(matches!(
        make(&rho[1..], &order, 1 << 20, &folder),
        Err(Error::Shared(transport::Error::Length { name: "albedo", .. }))
    ));
    assert!(matches!(
        make(&rho, &order[1..], 1 << 20, &folder),
        Err(Error::Shared(transport::Error::Length { name: "order", .. }))
    ));
    let twice: Vec<u32> = order.iter().map(|&i| if i == 7 { 8 } else { i }).collect();
    assert!(matches!(
        make(&rho, &twice, 1 << 20, &folder),
        Err(Error::Shared(transport::Error::Value { name: "order", .. }))
    ));
    assert!(matches!(
        make(&[1.0; 300], &order, 1 << 20, &folder),
        Err(Error::Shared(transport::Error::Value { name: "albedo", .. }))
    ));
    // Light that grows.
    let bright: Vec<f32> = case.values.iter().map(|f| 3.0 * f).collect();
    let bright = Factors { values: &bright, ..case.factors() };
    let workspace = Workspace { folder: &folder, bytes: 1 << 20 };
    let grows = all_bounces_stored(&bright, &[0.9; 300], &order, &workspace, &go);
    assert!(matches!(grows, Err(Error::Singular { .. })), "{grows:?}");
    let stop = |done, _| if done > 3 { Proceed::Break(()) } else { Proceed::Continue(()) };
    let stopped = all_bounces_stored(&case.factors(), &rho, &order, &workspace, &stop);
    assert!(matches!(stopped, Err(Error::Shared(transport::Error::Cancelled { done: 4, .. }))), "{stopped:?}");
}

/// Symmetric operators in tiles.
fn tiles_of(
    channels: Channels,
    area: &[f32],
    order: &[u32],
    epsilon: f64,
    progress: &(dyn Fn(usize, usize) -> Proceed + Sync),
) -> Result<LowRank, Error> {
    LowRank::encode(TileSource::Symmetric { channels, patches: TileSide { area, order } }, epsilon, progress)
}

/// The operator that tiles multiply by, column by column.
fn decoded(tiles: &LowRank, n: usize, channel: usize) -> Mat<f32> {
    let mut out = Mat::zeros(n, n);
    for j in 0..n {
        let mut unit = vec![Vec4::ZERO; n];
        let mut column = vec![Vec4::ZERO; n];
        unit[j] = Vec4::ONE;
        tiles.apply(&unit, &mut column).unwrap();
        (0..n).for_each(|i| out[(i, j)] = column[i][channel]);
    }
    out
}

/// The symmetric operator that is stored, row by row.
fn by_rows(tiles: &LowRank, area: &[f32], channel: usize) -> Mat<f32> {
    let n = area.len();
    let mut out = Mat::zeros(n, n);
    for i in 0..n {
        let mut row = vec![Vec3::ZERO; n];
        tiles.row(i, &mut row).unwrap();
        (0..n).for_each(|j| out[(i, j)] = row[j][channel] * (area[i] / area[j]).sqrt());
    }
    out
}

/// Relative Frobenius error of one channel, in symmetric form.
fn error_of(tiles: &LowRank, exact: &Mat<f32>, area: &[f32], channel: usize) -> f32 {
    let n = area.len();
    let found = decoded(tiles, n, channel);
    let symmetric = Mat::from_fn(n, n, |i, j| found[(i, j)] * (area[i] / area[j]).sqrt());
    difference(&symmetric, exact)
}

#[test]
fn three_channels_keep_the_error_that_was_asked_for_and_cost_less_than_three_operators() {
    let n = 300;
    let case = Case::new(n, 0.3);
    let symmetric = case.factors().symmetric().unwrap();
    let made: Vec<Mat<f32>> = (0..3).map(|c| all_bounces(symmetric.clone(), &albedo(n, c)).unwrap()).collect();
    let bytes = |tiles: &LowRank| tiles.bytes_by_part().iter().map(|part| part.1).sum::<u64>();
    let mut last = 0;
    for epsilon in [1e-1, 1e-2, 1e-3, 1e-4] {
        let channels = Channels::Three([&made[0], &made[1], &made[2]]);
        let tiles = tiles_of(channels, &case.area, &case.order(), epsilon, &go).unwrap();
        tiles.check().unwrap();
        for (c, exact) in made.iter().enumerate() {
            let stored = f64::from(difference(&by_rows(&tiles, &case.area, c), exact));
            assert!(stored <= 1.001 * epsilon, "{epsilon}, channel {c}: {stored}");
            // What it says of itself is what it stores.
            assert!((stored - tiles.report.error[c]).abs() <= 0.02 * epsilon, "{stored} {:?}", tiles.report);
            // A product rounds light and sums to 15 bits, too.
            let error = f64::from(error_of(&tiles, exact, &case.area, c));
            assert!(error <= 1.01 * epsilon + f64::from(2.0f32.powi(-15)), "{epsilon}, channel {c}: {error}");
        }
        assert!(bytes(&tiles) > last, "{epsilon}: a smaller error costs more");
        last = bytes(&tiles);
        if epsilon == 1e-2 {
            let alone = tiles_of(Channels::One(&made[0]), &case.area, &case.order(), epsilon, &go).unwrap();
            assert!(last < 3 * bytes(&alone) * 3 / 4, "{last} {}", bytes(&alone));
            assert!(error_of(&alone, &made[1], &case.area, 0) > 0.011, "another operator is noticed");
            // Broken words change the operator.
            let mut broken = alone.clone();
            broken.words[..64].iter_mut().for_each(|word| *word ^= 0x8080_8080);
            assert!(error_of(&broken, &made[0], &case.area, 0) > 1.5 * error_of(&alone, &made[0], &case.area, 0));
        }
    }
}

#[test]
fn one_thread_makes_the_tiles_that_several_make() {
    let case = Case::new(150, 0.5);
    let with = |threads: usize, noise: u32| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let symmetric = case.factors().symmetric().unwrap();
            let operators = [0, 1, 2].map(|c| all_bounces(symmetric.clone(), &albedo(150, c + noise)).unwrap());
            let channels = Channels::Three(operators.each_ref());
            tiles_of(channels, &case.area, &case.order(), 0.01, &go).unwrap()
        })
    };
    let one = with(1, 0);
    assert!(one == with(2, 0) && one == with(3, 0));
    assert!(one != with(1, 1), "another albedo changes nothing");
}

/// Red and blue that differ from green alike are stored once: the first chroma axis has all of it, and a rank-1 term
/// serves both.
#[test]
fn differences_of_one_hue_are_stored_once() {
    let n = 300;
    let case = Case::new(n, 0.3);
    let symmetric = case.factors().symmetric().unwrap();
    let [green, red] = [1, 0].map(|c| all_bounces(symmetric.clone(), &albedo(n, c)).unwrap());
    let hue = &red - &green;
    let blue = Mat::from_fn(n, n, |i, j| green[(i, j)] - 2.0 * hue[(i, j)]);
    let encode = |blue: &Mat<f32>| {
        tiles_of(Channels::Three([&red, &green, blue]), &case.area, &case.order(), 1e-3, &go).unwrap()
    };
    let alike = encode(&blue);
    let alone = encode(&green);
    let unit = 0.2f32.sqrt();
    let chroma_axes = alike.chroma_axes * alike.chroma_axes.x.signum();
    assert!(chroma_axes.abs_diff_eq(Vec4::new(unit, -2.0 * unit, 2.0 * unit, unit), 1e-3), "{chroma_axes}");
    assert!(alike.groups.iter().all(|group| group.color() != 1), "nothing is left for the second axis");
    for (channel, exact) in [&red, &green, &blue].into_iter().enumerate() {
        assert!(error_of(&alike, exact, &case.area, channel) < 1.1e-3, "channel {channel}");
    }
    // Where only red differs, axes are the channels.
    assert!(
        alone.report.terms[1] > 0 && alone.chroma_axes.abs_diff_eq(Vec4::new(1.0, 0.0, 0.0, 1.0), 1e-3),
        "{}",
        alone.chroma_axes
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn the_error_bound_holds_for_any_operator(seed in 0u32..1000, n in 1usize..200, power in 1u32..5) {
        let epsilon = 10f64.powi(-(power as i32));
        let value = |i: usize, j: usize| {
            let (i, j) = (i.min(j), i.max(j));
            // Noise, with a few great entries.
            let x = random(i, j, seed) - 0.3;
            if random(i, j, seed + 7) < 0.02 { 20.0 * x } else { x }
        };
        let matrix = Mat::from_fn(n, n, value);
        let area: Vec<f32> = (0..n).map(|i| 0.1 + random(i, 1, seed)).collect();
        let order: Vec<u32> = (0..n as u32).rev().collect();
        let tiles = tiles_of(Channels::One(&matrix), &area, &order, epsilon, &go).unwrap();
        tiles.check().unwrap();
        let stored = difference(&by_rows(&tiles, &area, 0), &matrix);
        prop_assert!(f64::from(stored) <= 1.01 * epsilon + 2e-6, "{epsilon}: {stored}");
        // A product rounds light and sums to 15 bits, too.
        let error = error_of(&tiles, &matrix, &area, 0);
        prop_assert!(f64::from(error) <= 1.01 * epsilon + f64::from(2.0f32.powi(-14)), "{epsilon}: {error}");
    }
}

#[test]
fn a_furnace_stays_one() {
    // A closed room of one reflectance: H = M / (1 − ρ) everywhere.
    let n = 200;
    let case = Case::new(n, 0.0);
    let mut f = case.dense();
    // What is missing in a row stays on the diagonal: reciprocal, and closed.
    for i in 0..n {
        let sum: f32 = (0..n).map(|j| f[(i, j)]).sum();
        f[(i, i)] = 1.0 - sum;
    }
    let symmetric = Mat::from_fn(n, n, |i, j| f[(i, j)] * (case.area[i] / case.area[j]).sqrt());
    let rho = vec![0.6; n];
    let all = all_bounces(symmetric.clone(), &rho).unwrap();
    let expected = 1.0 / (1.0 - 0.6);
    for (name, tiles) in [
        ("one", tiles_of(Channels::One(&all), &case.area, &case.order(), 1e-3, &go).unwrap()),
        ("three", tiles_of(Channels::Three([&all, &all, &all]), &case.area, &case.order(), 1e-3, &go).unwrap()),
    ] {
        let mut h = vec![Vec4::ZERO; n];
        tiles.apply(&vec![Vec4::ONE; n], &mut h).unwrap();
        for h in &h {
            assert!((h.truncate() - Vec3::splat(expected)).abs().max_element() < 0.01 * expected, "{name}: {h}");
        }
    }
    // Feedback with the form factors alone comes to the same.
    let tiles = tiles_of(Channels::One(&symmetric), &case.area, &case.order(), 1e-3, &go).unwrap();
    let mut b = vec![Vec4::ZERO; n];
    let mut h = vec![Vec4::ZERO; n];
    for _ in 0..40 {
        tiles.apply(&b, &mut h).unwrap();
        b.iter_mut().zip(&h).for_each(|(b, h)| *b = Vec4::ONE + *h * 0.6);
    }
    assert!(h.iter().all(|h| (h.x - expected).abs() < 0.02 * expected), "{:?}", h[0]);
}

#[test]
fn tiles_of_sparse_form_factors_are_those_of_the_dense_matrix() {
    let case = Case::new(300, 0.5);
    let symmetric = case.factors().symmetric().unwrap();
    let encode = |channels| tiles_of(channels, &case.area, &case.order(), 1e-2, &go).unwrap();
    let sparse = encode(Channels::Factors(case.factors()));
    let dense = encode(Channels::One(&symmetric));
    assert!(sparse == dense, "{:?} {:?}", sparse.report, dense.report);
    // Other factors give other tiles.
    let half: Vec<f32> = case.values.iter().map(|f| 0.5 * f).collect();
    assert!(encode(Channels::Factors(Factors { values: &half, ..case.factors() })) != dense);
    let mut unlike = case.values.clone();
    unlike[2] *= 2.0;
    let unlike = Factors { values: &unlike, ..case.factors() };
    let found = tiles_of(Channels::Factors(unlike), &case.area, &case.order(), 1e-2, &go);
    assert!(matches!(found, Err(Error::Shared(transport::Error::Value { name: "factors", .. }))), "{found:?}");
}

#[test]
fn light_that_is_even_costs_less_error_than_light_that_is_not() {
    // For the same error of the operator, light that is even over neighbours is off by less than light that is not.
    let n = 512;
    let case = Case::new(n, 0.9);
    let symmetric = case.factors().symmetric().unwrap();
    let order = case.order();
    let tiles = tiles_of(Channels::One(&symmetric), &case.area, &order, 0.05, &go).unwrap();
    let error = |light: &dyn Fn(usize) -> f32| {
        let light: Vec<Vec4> = (0..n).map(|i| Vec4::splat(light(i))).collect();
        let mut ours = vec![Vec4::ZERO; n];
        let mut exact = vec![0.0; n];
        tiles.apply(&light, &mut ours).unwrap();
        for (i, x) in exact.iter_mut().enumerate() {
            *x = (0..n).map(|j| symmetric[(i, j)] * (case.area[j] / case.area[i]).sqrt() * light[j].x).sum();
        }
        // Against what white light of the same power gives.
        let power: f32 = light.iter().zip(&case.area).map(|(b, a)| b.x * b.x * a).sum();
        let wrong: f32 = ours.iter().zip(&exact).zip(&case.area).map(|((h, x), a)| (h.x - x).powi(2) * a).sum();
        (wrong / power).sqrt()
    };
    let even = error(&|i| if i / 100 == 2 { 1.0 } else { 0.0 });
    let uneven = error(&|i| if random(i, 0, 77) < 0.5 { 1.0 } else { -1.0 });
    assert!(even < 0.7 * uneven, "{even} {uneven}");
}

#[test]
fn the_product_in_vectors_is_that_of_the_bodies() {
    let n = 300;
    let case = Case::new(n, 0.9);
    let symmetric = case.factors().symmetric().unwrap();
    let made: Vec<Mat<f32>> = (0..3).map(|c| all_bounces(symmetric.clone(), &albedo(n, c)).unwrap()).collect();
    let channels = Channels::Three([&made[0], &made[1], &made[2]]);
    let tiles = tiles_of(channels, &case.area, &case.order(), 3e-3, &go).unwrap();
    assert!(tiles.report.terms.iter().all(|&c| c > 0) && tiles.report.entries > 0, "{:?}", tiles.report);
    let light: Vec<Vec4> = (0..n).map(|i| Vec4::new(random(i, 0, 9), random(i, 1, 9), random(i, 2, 9), 0.0)).collect();
    like_the_bodies(&tiles, &light);
    // Blocks in the dark are passed over.
    let dark = |i: usize| if tiles.permuted_index[i] < 128 { Vec4::ZERO } else { light[i] };
    like_the_bodies(&tiles, &(0..n).map(dark).collect::<Vec<Vec4>>());
}

/// Asks that sums and rows are the kernels' in all bits.
fn like_the_bodies(tiles: &LowRank, exitance: &[Vec4]) {
    let mut ordered = vec![Vec4::ZERO; kernel::low_rank::PERMUTED_INDICES];
    permute_in_all(&tiles.order, &tiles.row_sqrt_area, exitance, &mut ordered[..tiles.steps.len()]);
    let mut light = vec![0; tiles.blocks() * kernel::low_rank::LIGHT_WORDS as usize];
    let mut body = light.clone();
    quantise_all(&ordered[..tiles.steps.len()], &mut light);
    (0..tiles.blocks() as u32 * kernel::low_rank::U32X4S)
        .for_each(|k| kernel::low_rank::quantise(k, &ordered, &mut body));
    assert_eq!(light, body);
    let mut sums = vec![Vec4::ZERO; tiles.scale.len()];
    multiply_vt_all(&tiles.vt_tables(), &light, &mut sums);
    let (light_u32x4, scale): (&[UVec4], &[Vec4]) = (cast_slice(&light), cast_slice(&tiles.scale));
    let runs = tiles.runs.len() - 1;
    let mut groups = 0;
    for k in 0..runs as u32 * kernel::low_rank::RUN_INVOCATIONS {
        let (first, count) = kernel::low_rank::groups_of(k, &tiles.runs);
        if count > 0 {
            let body = kernel::low_rank::multiply_vt(
                first,
                count,
                tiles.chroma_axes,
                &tiles.groups,
                cast_slice(&tiles.words),
                scale,
                light_u32x4,
            );
            let first = 4 * first as usize;
            let vectors = 4 * count as usize;
            assert_eq!(sums[first..first + vectors], body[..vectors], "vector {first}");
            groups += count as usize;
        }
    }
    assert_eq!(groups, tiles.groups.len());
    let mut factors = vec![0; runs * kernel::low_rank::FACTOR_WORDS as usize];
    let mut body = factors.clone();
    requantise_all(&tiles.runs, &tiles.paired, &sums, &mut factors);
    let paired = cast_slice(&tiles.paired);
    (0..runs as u32)
        .for_each(|k| kernel::low_rank::requantise(k, &tiles.runs, paired, &sums, cast_slice_mut(&mut body)));
    assert_eq!(factors, body);
    let mut rows = vec![Vec4::ZERO; kernel::low_rank::SPLITS as usize * tiles.steps.len()];
    let t = tiles.u_tables();
    multiply_u_all(&t, &factors, &mut rows);
    for k in 0..rows.len() as u32 / (2 * kernel::low_rank::PARTS) {
        let body =
            kernel::low_rank::multiply_u(k, t.run_start, t.runs, t.groups, cast_slice(t.words), cast_slice(&factors));
        for part in 0..kernel::low_rank::PARTS {
            let at = kernel::low_rank::row_at(k, part) as usize;
            let part = part as usize;
            let lanes = [body[part], body[part + kernel::low_rank::PARTS as usize]];
            assert_eq!(rows[at..at + 2], lanes, "lanes {k}, part {part}");
        }
    }
    let mut dense_sparse = vec![Vec4::ZERO; tiles.steps.len()];
    let t = tiles.dense_sparse_tables();
    dense_sparse_all(&t, &light, &ordered, &mut dense_sparse);
    for (k, eight) in (0u32..).zip(dense_sparse.chunks(8)) {
        let words = (t.sub_block_start, t.sub_blocks, cast_slice(t.sub_block_words));
        let body = kernel::low_rank::dense_sparse(
            k,
            words.0,
            words.1,
            words.2,
            light_u32x4,
            t.row_start,
            t.entries,
            t.steps,
            &ordered,
        );
        assert_eq!(eight, body, "rows {k}");
    }
    // A product makes the same of them, step by step.
    let mut irradiance = vec![Vec4::ZERO; tiles.rows()];
    tiles.apply(exitance, &mut irradiance).unwrap();
    for (i, h) in (0u32..).zip(&irradiance) {
        assert_eq!(
            *h,
            kernel::low_rank::permute_out(i, &tiles.permuted_index, &tiles.row_sqrt_area, &rows, &dense_sparse),
            "patch {i}"
        );
    }
}

#[test]
fn what_is_wrong_is_said() {
    let case = Case::new(20, 0.1);
    let symmetric = case.factors().symmetric().unwrap();
    let encode = |area: &[f32], order: &[u32], epsilon| tiles_of(Channels::One(&symmetric), area, order, epsilon, &go);
    let order = case.order();
    assert!(matches!(
        encode(&case.area, &order, 0.0),
        Err(Error::Shared(transport::Error::Setting { name: "epsilon", .. }))
    ));
    assert!(matches!(
        encode(&case.area, &order[1..], 0.1),
        Err(Error::Shared(transport::Error::Length { name: "order", .. }))
    ));
    let twice: Vec<u32> = (0..20).map(|p| if p == 3 { 2 } else { p }).collect();
    assert!(matches!(
        encode(&case.area, &twice, 0.1),
        Err(Error::Shared(transport::Error::Value { name: "order", index: 3, .. }))
    ));
    let mut area = case.area.clone();
    area[5] = f32::NAN;
    assert!(matches!(
        encode(&area, &order, 0.1),
        Err(Error::Shared(transport::Error::Value { name: "area", index: 5, .. }))
    ));
    let mut broken = symmetric.clone();
    broken[(3, 4)] = f32::INFINITY;
    let found = tiles_of(Channels::One(&broken), &case.area, &order, 0.1, &go);
    assert!(matches!(found, Err(Error::Shared(transport::Error::Value { name: "operator", index: 4, .. }))));
    let stop = |_: usize, _: usize| Proceed::Break(());
    let found = tiles_of(Channels::One(&symmetric), &case.area, &order, 0.1, &stop);
    assert!(matches!(found, Err(Error::Shared(transport::Error::Cancelled { .. }))));

    // Light that grows: rows above 1.
    let bright = Mat::from_fn(20, 20, |i, j| 3.0 * symmetric[(i, j)]);
    assert!(matches!(all_bounces(bright, &[0.9; 20]), Err(Error::Singular { .. })));
    assert!(matches!(
        all_bounces(symmetric.clone(), &[1.0; 20]),
        Err(Error::Shared(transport::Error::Value { name: "albedo", index: 0, .. }))
    ));

    // Not reciprocal.
    let mut values = case.values.clone();
    values[2] *= 2.0;
    let unlike = Factors { values: &values, ..case.factors() };
    assert!(matches!(unlike.symmetric(), Err(Error::Shared(transport::Error::Value { name: "factors", .. }))));
    let beyond = [vec![20], case.columns[1..].to_vec()].concat();
    assert!(matches!(
        Factors { columns: &beyond, ..case.factors() }.symmetric(),
        Err(Error::Shared(transport::Error::Value { name: "columns", index: 0, .. }))
    ));

    // Tables that lead beyond their end.
    let large = Case::new(300, 0.0);
    let all = all_bounces(large.factors().symmetric().unwrap(), &[0.5; 300]).unwrap();
    let good = tiles_of(Channels::One(&all), &large.area, &large.order(), 0.01, &go).unwrap();
    good.check().unwrap();
    let mut tiles = good.clone();
    tiles.sub_blocks[0].column = 24;
    assert!(matches!(tiles.check(), Err(Error::Shared(transport::Error::Value { name: "sub_blocks", index: 0, .. }))));
    let mut tiles = good.clone();
    tiles.sub_blocks[0].step = f32::NAN;
    assert!(matches!(tiles.check(), Err(Error::Shared(transport::Error::Value { name: "sub_blocks", index: 0, .. }))));
    let mut tiles = good.clone();
    tiles.sub_block_words.pop();
    assert!(matches!(tiles.check(), Err(Error::Shared(transport::Error::Length { name: "sub_block_words", .. }))));
    let mut tiles = good.clone();
    tiles.paired[0] = tiles.paired.len() as u32;
    assert!(matches!(tiles.check(), Err(Error::Shared(transport::Error::Value { name: "paired", index: 0, .. }))));
    let mut tiles = good.clone();
    tiles.words.pop();
    assert!(matches!(tiles.check(), Err(Error::Shared(transport::Error::Length { name: "words", .. }))));
    let mut h = vec![Vec4::ZERO; 300];
    assert!(good.apply(&[Vec4::ONE; 299], &mut h).is_err());
    // No patches at all.
    let empty = tiles_of(Channels::One(&Mat::zeros(0, 0)), &[], &[], 0.1, &go).unwrap();
    empty.apply(&[], &mut []).unwrap();
}
