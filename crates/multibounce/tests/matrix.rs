//! Matrices in blocks: what is kept, what is lost, and what is refused.

use std::ops::ControlFlow;

use glam::{UVec4, Vec3, Vec4};
use patchlight_multibounce::kernel::blocks::{
    BLOCK, Bc1, Bc3, Bc6h, Bc7, BlockFormat, decode_gather_row, gather_outlier_rows,
};
use patchlight_multibounce::{
    BlockCodec, BlockMatrix, BlockSettings, Companding, Error, Filling, MatrixRows, greedy_order, picture,
    projected_order, spectral_radius,
};
use scene::sampling::{hash3, unit};
use transport::{FnOperator, LinearOperator, Permutation};

const COMPANDINGS: [Companding; 3] = [Companding::None, Companding::Sqrt, Companding::Log2];

fn encode(n: usize, rows: &MatrixRows, order: Permutation, settings: BlockSettings) -> BlockMatrix {
    BlockMatrix::encode(n, rows, order, settings, &|_, _| ControlFlow::Continue(())).unwrap()
}

fn every_kind() -> impl Iterator<Item = BlockSettings> {
    BlockCodec::ALL.into_iter().flat_map(|codec| {
        COMPANDINGS.map(|companding| BlockSettings { codec, companding, tile: 16, ..BlockSettings::default() })
    })
}

/// Patches at random points of a room's walls, numbered at random: the light from one to the other falls with distance,
/// is coloured by the patch that sends it, and one pair in thirty is hidden. Rows have the sum `sum` at most.
fn room(n: usize, sum: f32) -> impl Fn(usize, &mut [Vec3]) + Sync {
    let place = |k: usize| {
        let number = |axis| unit(hash3(k as u32, axis, 77));
        let mut place = Vec3::new(number(0), number(1), number(2));
        let wall = (6.0 * number(3)) as usize;
        place[wall / 2] = (wall % 2) as f32;
        place
    };
    let places: Vec<Vec3> = (0..n).map(place).collect();
    move |i, row| {
        for (j, entry) in row.iter_mut().enumerate() {
            let distance = places[i].distance_squared(places[j]);
            let low = i.min(j) as u32;
            let seen = !hash3(low, (i + j) as u32, 5).is_multiple_of(30);
            let grey = if seen { 0.05 / (0.05 + distance * distance) } else { 0.0 };
            *entry = Vec3::new(1.0, 0.6 + 0.4 * places[j].x, 0.8 - 0.3 * places[j].y) * grey;
        }
        let scale = sum / row.iter().copied().sum::<Vec3>().max_element();
        for entry in row {
            *entry *= scale;
        }
    }
}

/// The entries as they were or as they are.
fn dense(n: usize, rows: &MatrixRows) -> Vec<Vec3> {
    let mut all = vec![Vec3::ZERO; n * n];
    for (i, row) in all.chunks_mut(n.max(1)).enumerate() {
        rows(i, row);
    }
    all
}

fn decoded(matrix: &BlockMatrix) -> Vec<Vec3> {
    dense(matrix.len(), &|i, row| matrix.row(i, row).unwrap())
}

fn relative_error(a: &[Vec3], b: &[Vec3]) -> f64 {
    let square = |v: Vec3| f64::from(v.length_squared());
    let error: f64 = a.iter().zip(b).map(|(a, b)| square(*a - *b)).sum();
    (error / a.iter().map(|a| square(*a)).sum::<f64>()).sqrt()
}

fn light(n: usize) -> Vec<Vec4> {
    (0..n as u32).map(|k| Vec4::new(unit(hash3(k, 0, 3)), unit(hash3(k, 1, 3)), unit(hash3(k, 2, 3)), 0.0)).collect()
}

#[test]
fn in_a_furnace_every_row_keeps_its_sum() {
    // 37 rows fill no whole block. Sums are exact but for the rounding of 37 additions.
    for settings in every_kind() {
        let uniform = |_: usize, row: &mut [Vec3]| row.fill(Vec3::new(0.9, 0.6, 0.3) / 37.0);
        let uneven = room(37, 0.9);
        let all: [(&MatrixRows, f32); 2] = [(&uniform, 0.9), (&uneven, 0.9)];
        for (rows, red) in all {
            let mut matrix = encode(37, rows, Permutation::identity(37), settings);
            let mut irradiance = vec![Vec4::ZERO; 37];
            matrix.apply(&[Vec4::ONE; 37], &mut irradiance).unwrap();
            let sums: Vec<Vec3> = dense(37, rows).chunks(37).map(|row| row.iter().copied().sum()).collect();
            assert!((sums[0].x - red).abs() < 1e-5);
            for (h, sum) in irradiance.iter().zip(&sums) {
                assert!((h.truncate() - *sum).abs().max_element() < 4e-6, "{settings:?}: {h} for {sum}");
            }
            matrix.words_mut().iter_mut().step_by(3).for_each(|word| *word ^= 0x0100_8421);
            matrix.apply(&[Vec4::ONE; 37], &mut irradiance).unwrap();
            let worst = irradiance.iter().zip(&sums).map(|(h, s)| (h.truncate() - *s).abs().max_element());
            assert!(worst.fold(0.0, f32::max) > 1e-4, "{settings:?}: damaged blocks pass");
        }
    }
}

#[test]
fn the_error_is_the_one_that_is_reported_and_damage_raises_it() {
    let n = 101;
    let rows = room(101, 0.8);
    let original = dense(n, &rows);
    for settings in every_kind() {
        let mut matrix = encode(n, &rows, projected_order(n, &rows, 1), settings);
        let found = relative_error(&original, &decoded(&matrix));
        let reported = matrix.report().frobenius;
        assert!((found - reported).abs() < 1e-3 * reported + 1e-7, "{settings:?}: {found}, reported {reported}");
        assert!(found < 0.2, "{settings:?}: {found}");
        let middle = matrix.words().len() / 2;
        matrix.words_mut()[middle / 4 * 4] ^= 0x00f0_f0f0;
        let damaged = relative_error(&original, &decoded(&matrix));
        assert!(damaged > found * 1.000_1, "{settings:?}: {damaged} after damage, {found} before");
    }
}

#[test]
fn an_order_is_worth_what_its_matrix_reports() {
    let n = 101;
    let rows = room(101, 0.8);
    let go = |_: usize, _: usize| ControlFlow::Continue(());
    for settings in every_kind() {
        let order = projected_order(n, &rows, 1);
        let mse = |order: &Permutation, step| BlockMatrix::order_mse(n, &rows, order, settings, step, &go).unwrap();
        let whole = mse(&order, 1);
        let matrix = encode(n, &rows, order.clone(), settings);
        assert_eq!(whole, matrix.report().block_mse, "{settings:?}");
        // Outliers are all but exact, and rows are scaled by little.
        let all = matrix.report().mse;
        assert!(0.9 * whole < all / 0.95 && all < 1.1 * whole, "{settings:?}: {whole}, of all entries {all}");
        assert_ne!(whole, mse(&Permutation::identity(n), 1));
        // Every other row of tiles says about the same.
        assert!((mse(&order, 2) / whole - 1.0).abs() < 0.3, "{settings:?}: {} {whole}", mse(&order, 2));
    }
    let stop = |_: usize, _: usize| ControlFlow::Break(());
    let order = Permutation::identity(n);
    let stopped = BlockMatrix::order_mse(n, &rows, &order, BlockSettings::default(), 1, &stop);
    assert!(matches!(stopped, Err(Error::Shared(transport::Error::Cancelled { total: 2, .. }))));
}

#[test]
fn the_settings_of_a_codec_keep_to_a_third_of_single_precision() {
    let n = 1600;
    let rows = room(n, 0.8);
    for codec in BlockCodec::ALL {
        let bytes = encode(n, &rows, Permutation::identity(n), BlockSettings::of(codec)).bytes_by_part();
        assert!(3 * bytes.total() <= 4 * (n * n) as u64, "{codec:?}: {bytes:?}");
        assert!(bytes.outliers > (n * n) as u64 / 4, "{codec:?}: {bytes:?}");
    }
}

#[test]
fn more_outliers_leave_less_error_and_all_of_them_only_rounding() {
    let n = 60;
    let rows = room(60, 0.8);
    let error = |outliers| {
        let settings = BlockSettings { outliers, ..BlockSettings::default() };
        let matrix = encode(n, &rows, Permutation::identity(n), settings);
        assert_eq!(matrix.bytes_by_part().outliers, 4 * 61 + 8 * matrix.outliers().entries.len() as u64);
        matrix.report().frobenius
    };
    let none = error(0.0);
    let some = error(0.05);
    let many = error(0.3);
    let all = error(1.0);
    assert!(none > some && some > many && many > all, "{none} {some} {many} {all}");
    // Halves have 11 bits.
    assert!(all < 2f64.powi(-11), "{all}");
}

/// The product by the bodies of the kernels, one lane.
fn by_kernels<F: BlockFormat>(matrix: &BlockMatrix, exitance: &[Vec4]) -> Vec<Vec4> {
    let n = matrix.len();
    let order = matrix.permutation();
    let mut ordered = vec![Vec4::ZERO; n.next_multiple_of(4)];
    order.apply(exitance, &mut ordered[..n]).unwrap();
    let p = matrix.params(0, matrix.block_count() as u32);
    let w = matrix.settings().codec.block_words();
    let words = |k: u32| {
        let at = |word: usize| if word < w { matrix.words()[k as usize * w + word] } else { 0 };
        UVec4::new(at(0), at(1), at(2), at(3))
    };
    let mut sums = vec![Vec4::ZERO; ordered.len()];
    for (row, sums) in sums.chunks_mut(BLOCK as usize).enumerate() {
        let s = decode_gather_row::<F>(row as u32, &p, 0, 1, words, matrix.scales(), &ordered);
        let start = &matrix.outliers().start;
        let entries = &matrix.outliers().entries;
        let s = s.plus(gather_outlier_rows(row as u32, &p, 0, 1, start, entries, &ordered));
        for (sum, s) in sums.iter_mut().zip([s.a, s.b, s.c, s.d]) {
            *sum = s.extend(0.0);
        }
    }
    let mut irradiance = vec![Vec4::ZERO; n];
    order.undo(&sums[..n], &mut irradiance).unwrap();
    irradiance.iter().zip(matrix.row_scales()).map(|(h, scale)| *h * *scale).collect()
}

#[test]
fn the_product_is_that_of_the_kernels_and_of_the_decoded_matrix() {
    let n = 90;
    let rows = room(90, 0.8);
    let exitance = light(90);
    for settings in every_kind() {
        let matrix = encode(n, &rows, projected_order(n, &rows, 1), settings);
        let mut irradiance = vec![Vec4::ZERO; n];
        matrix.apply(&exitance, &mut irradiance).unwrap();
        let kernels = match settings.codec {
            BlockCodec::Bc1 => by_kernels::<Bc1>(&matrix, &exitance),
            BlockCodec::Bc3 => by_kernels::<Bc3>(&matrix, &exitance),
            BlockCodec::Bc6h => by_kernels::<Bc6h>(&matrix, &exitance),
            BlockCodec::Bc7 => by_kernels::<Bc7>(&matrix, &exitance),
        };
        for (i, row) in decoded(&matrix).chunks(n).enumerate() {
            let expected: Vec3 = row.iter().zip(&exitance).map(|(m, b)| *m * b.truncate()).sum();
            // Positive terms: a rounding each.
            let near = |h: Vec4| (h.truncate() - expected).abs().max_element() < 1e-5 * expected.max_element();
            assert!(near(irradiance[i]) && near(kernels[i]), "{settings:?} {i}: {} {}", irradiance[i], kernels[i]);
            assert!(!near(irradiance[(i + 1) % n]) || i > 80, "{settings:?}: rows are too much alike to tell");
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let n = 200;
    let rows = room(200, 0.8);
    let exitance = light(200);
    let with = |threads: usize, seed| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let matrix = encode(n, &rows, projected_order(n, &rows, seed), BlockSettings::default());
            let mut irradiance = vec![Vec4::ZERO; n];
            matrix.apply(&exitance, &mut irradiance).unwrap();
            (matrix, irradiance)
        })
    };
    let one = with(1, 1);
    assert!(one == with(3, 1));
    assert!(one != with(1, 2), "the seed changes nothing");
}

#[test]
fn orders_by_likeness_make_blocks_smooth() {
    let n = 300;
    let rows = room(n, 0.8);
    let mse = |order| encode(n, &rows, order, BlockSettings::default()).report().mse;
    let given = mse(Permutation::identity(n));
    let greedy = mse(greedy_order(n, &rows));
    let projected = mse(projected_order(n, &rows, 1));
    assert!(greedy < 0.7 * given, "{greedy} after the greedy order, {given} before");
    // Each looks at distances of its own: here the linear ones of the greedy order are better, in real scenes
    // logarithms.
    assert!(
        projected < 1.3 * greedy && projected < 0.7 * given,
        "{projected} after the projected order, {greedy} after the greedy one"
    );
}

#[test]
fn the_greedy_order_puts_equal_columns_side_by_side() {
    // Three kinds of patches, mixed.
    let kind = |k: usize| k * 7 % 3;
    let rows = |i: usize, row: &mut [Vec3]| {
        for (j, entry) in row.iter_mut().enumerate() {
            *entry = Vec3::splat([[0.1, 0.5, 0.9], [0.4, 0.2, 0.7], [0.3, 0.8, 0.6]][kind(i)][kind(j)]);
        }
    };
    for order in [greedy_order(30, &rows), projected_order(30, &rows, 4)] {
        let changes = order.order().windows(2).filter(|w| kind(w[0] as usize) != kind(w[1] as usize)).count();
        assert_eq!(changes, 2, "{order:?}");
        Permutation::new(order.order().to_vec()).unwrap();
        assert_eq!(order.order()[0], 0);
    }
}

#[test]
fn light_never_grows() {
    let n = 80;
    // Closed: rows of form factors have the sum 1 at most.
    let rows = room(n, 1.0);
    let albedo = vec![Vec4::new(0.95, 0.5, 0.9, 0.0); n];
    for settings in every_kind() {
        let matrix = encode(n, &rows, projected_order(n, &rows, 1), settings);
        let radius = |scale: f32| {
            let scaled = FnOperator::new(n, n, |b: &[Vec4], h: &mut [Vec4]| {
                matrix.apply(b, h)?;
                h.iter_mut().for_each(|h| *h *= scale);
                Ok(())
            });
            spectral_radius(&scaled, &albedo, 1e-6, 200).unwrap()
        };
        let found = radius(1.0);
        assert!(found.cmple(Vec3::new(0.95, 0.5, 0.9) * 1.000_01).all(), "{settings:?}: {found}");
        assert!((found.x - 0.95).abs() < 1e-3, "{settings:?}: {found}");
        assert!(radius(1.06).x > 1.0);
    }
}

#[test]
fn the_spectral_radius_of_two_patches_is_known() {
    // diag(ρ) M = [[0, 0.4], [0.9, 0]]: eigenvalues ±0.6, in the second channel one patch is black.
    let operator = FnOperator::new(2, 2, |b: &[Vec4], h: &mut [Vec4]| {
        (h[0], h[1]) = (b[1] * 0.5, b[0]);
        Ok(())
    });
    let albedo = [Vec4::new(0.8, 0.0, 0.2, 0.0), Vec4::new(0.9, 0.9, 0.9, 0.0)];
    let radius = spectral_radius(&operator, &albedo, 0.0, 64).unwrap();
    assert!((radius - Vec3::new(0.6, 0.0, 0.3)).abs().max_element() < 1e-5, "{radius}");
    assert!(matches!(
        spectral_radius(&operator, &albedo[1..], 0.0, 1),
        Err(Error::Shared(transport::Error::Length { .. }))
    ));
}

#[test]
fn pictures_show_the_order_and_the_error() {
    let n = 64;
    let rows = room(64, 0.8);
    let matrix = encode(n, &rows, greedy_order(n, &rows), BlockSettings::default());
    let before = picture(n, &rows, &Permutation::identity(n), n);
    assert_eq!(before, dense(n, &rows));
    let small = picture(n, &rows, matrix.permutation(), 16);
    assert_eq!(small.len(), 256);
    let mean = |pixels: &[Vec3]| pixels.iter().copied().sum::<Vec3>() / pixels.len() as f32;
    assert!((mean(&small) - mean(&before)).abs().max_element() < 1e-6 && small != before[..256]);
    let difference = |i: usize, row: &mut [Vec3]| {
        let mut exact = vec![Vec3::ZERO; n];
        rows(i, &mut exact);
        matrix.row(i, row).unwrap();
        row.iter_mut().zip(exact).for_each(|(m, e)| *m = (*m - e).abs());
    };
    let error = picture(n, &difference, matrix.permutation(), 1000);
    assert_eq!(error.len(), n * n);
    assert!(mean(&error).max_element() < 0.15 * mean(&before).max_element() && mean(&error).max_element() > 0.0);
    assert!(picture(0, &|_, _| {}, &Permutation::identity(0), 8).is_empty());
}

#[test]
fn bytes_are_counted() {
    let rows = room(100, 0.8);
    for (codec, blocks) in [(BlockCodec::Bc1, 25 * 25 * 8), (BlockCodec::Bc7, 25 * 25 * 16)] {
        let matrix =
            encode(100, &rows, Permutation::identity(100), BlockSettings { codec, ..BlockSettings::default() });
        let bytes = matrix.bytes_by_part();
        assert_eq!((bytes.blocks, bytes.scales, bytes.vectors), (blocks, 4 * 16, 100 * 20));
        assert_eq!(bytes.outliers, 101 * 4 + 500 * 8);
        assert_eq!(bytes.total(), bytes.blocks + bytes.scales + bytes.vectors + bytes.outliers);
    }
}

#[test]
fn empty_and_tiny_matrices_work() {
    for n in 0..10 {
        let rows = |_: usize, row: &mut [Vec3]| row.fill(Vec3::splat(0.1));
        let order = projected_order(n, &rows, 1);
        assert_eq!(greedy_order(n, &rows).len(), n);
        let matrix = encode(n, &rows, order, BlockSettings::default());
        let mut irradiance = vec![Vec4::ZERO; n];
        matrix.apply(&vec![Vec4::ONE; n], &mut irradiance).unwrap();
        for h in irradiance {
            assert!((h.x - 0.1 * n as f32).abs() < 1e-5);
        }
        assert_eq!(matrix.is_empty(), n == 0);
    }
    let black = encode(9, &|_, row| row.fill(Vec3::ZERO), Permutation::identity(9), BlockSettings::default());
    let mut irradiance = vec![Vec4::ONE; 9];
    black.apply(&[Vec4::ONE; 9], &mut irradiance).unwrap();
    assert!(irradiance.iter().all(|h| h.truncate() == Vec3::ZERO) && black.report().frobenius == 0.0);
}

#[test]
fn what_cannot_be_encoded_is_refused() {
    let rows = room(20, 0.8);
    let go = |_: usize, _: usize| ControlFlow::Continue(());
    let with = |order: usize, settings: BlockSettings| {
        BlockMatrix::encode(20, &rows, Permutation::identity(order), settings, &go).map(|_| ())
    };
    let default = BlockSettings::default();
    with(20, default).unwrap();
    assert!(matches!(
        with(19, default),
        Err(Error::Shared(transport::Error::Length { name: "order", expected: 20, found: 19 }))
    ));
    for outliers in [-0.1, 1.1, f64::NAN] {
        assert!(matches!(
            with(20, BlockSettings { outliers, ..default }),
            Err(Error::Shared(transport::Error::Setting { name: "outliers", .. }))
        ));
    }
    for tile in [0, 2, 12, 2048] {
        assert!(matches!(
            with(20, BlockSettings { tile, ..default }),
            Err(Error::Shared(transport::Error::Setting { name: "tile", .. }))
        ));
    }
    for bad in [f32::NAN, f32::INFINITY, -1e-9] {
        let broken = |i: usize, row: &mut [Vec3]| {
            rows(i, row);
            if i == 3 {
                row[5].z = bad;
            }
        };
        let found = BlockMatrix::encode(20, &broken, Permutation::identity(20), default, &go);
        assert!(
            matches!(found, Err(Error::Shared(transport::Error::Value { name: "matrix", index: 65, .. }))),
            "{bad}: {found:?}"
        );
    }
    let many = BlockMatrix::encode(65_537, &rows, Permutation::identity(65_537), default, &go);
    assert!(matches!(many, Err(Error::Shared(transport::Error::TooMany { found: 65_537, .. }))));
    let stopped = BlockMatrix::encode(20, &rows, Permutation::identity(20), default, &|_, _| ControlFlow::Break(()));
    assert!(matches!(stopped, Err(Error::Shared(transport::Error::Cancelled { total: 1, .. }))));
    let matrix = encode(20, &rows, Permutation::identity(20), default);
    let mut irradiance = vec![Vec4::ZERO; 20];
    assert!(matches!(
        matrix.apply(&light(19), &mut irradiance),
        Err(transport::Error::Length { name: "exitance", .. })
    ));
    assert!(matches!(
        matrix.apply(&light(20), &mut irradiance[1..]),
        Err(transport::Error::Length { name: "irradiance", .. })
    ));
    assert!(matches!(
        matrix.row(20, &mut [Vec3::ZERO; 20]),
        Err(Error::Shared(transport::Error::Value { name: "row", .. }))
    ));
    assert!(matches!(
        matrix.row(0, &mut [Vec3::ZERO; 21]),
        Err(Error::Shared(transport::Error::Length { name: "row", .. }))
    ));
}

#[test]
fn zeros_in_the_place_of_outliers_keep_them_and_bend_the_rest() {
    let n = 64;
    let rows = room(64, 0.8);
    let with = |filling| {
        let settings = BlockSettings { filling, ..BlockSettings::default() };
        encode(n, &rows, projected_order(n, &rows, 1), settings)
    };
    let zeros = with(Filling::Zeros);
    let means = with(Filling::Mean);
    assert!(zeros.report().block_mse > means.report().block_mse, "{:?} {:?}", zeros.report(), means.report());
    assert_eq!(zeros.outliers().entries.len(), means.outliers().entries.len());
    // The greatest entry is exact with either, but for halves and the scale of its row.
    let original = dense(n, &rows);
    let greatest = (0..n * n).max_by(|&a, &b| original[a].x.total_cmp(&original[b].x)).unwrap();
    for matrix in [&zeros, &means] {
        let ratio = decoded(matrix)[greatest].x / original[greatest].x;
        assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
    }
}
