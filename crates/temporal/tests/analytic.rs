//! Small cases worked out by hand, and what is refused.

use glam::{Vec3, Vec4};
use patchlight_temporal::kernel::split::{pack_entry, scan_row};
use patchlight_temporal::kernel::tables::{color_at, draw};
use patchlight_temporal::{
    AliasTables, Blend, Distribution, Error, Packing, RayLists, SampleParams, Settings, State, SumParams,
};
use scene::math::luminance;
use transport::LinearOperator;

const PACKINGS: [Packing; 2] = [Packing::Stacks, Packing::Split];

#[test]
fn lists_hold_what_rays_hit() {
    // Four rays a row; 3 is the sky, 4 a hit without owner.
    let lists = RayLists::from_hits(3, &[2, 0, 2, 3, 4, 3, 3, 3, 1, 1, 1, 1], 4).unwrap();
    assert_eq!(lists.row(0), [0, 2, 2]);
    assert_eq!(lists.row(1), [0; 0]);
    assert_eq!(lists.row(2), [1; 4]);
    assert_eq!(lists.row(3), [0; 0]);
    assert_eq!(lists.sums(), [0.75, 0.0, 1.0]);
    // Two numbers a word, the first in the lower half.
    assert_eq!(lists.words(), [2 << 16, 1 << 16 | 2, 1 << 16 | 1, 1]);
    let light = [Vec4::splat(4.0), Vec4::splat(8.0), Vec4::splat(16.0)];
    let mut out = [Vec4::ONE; 3];
    lists.apply(&light, &mut out).unwrap();
    assert_eq!(out.map(|h| h.x), [4.0 / 4.0 + 2.0 * 16.0 / 4.0, 0.0, 8.0]);
    // A sky that shines is a column.
    let with_sky = RayLists::from_hits(4, &[2, 0, 2, 3], 4).unwrap();
    let light = [light[0], light[1], light[2], Vec4::splat(2.0)];
    with_sky.apply(&light, &mut out[..1]).unwrap();
    assert_eq!(out[0].x, 1.0 + 8.0 + 0.5);
}

#[test]
fn many_columns_take_longer_words() {
    let lists = RayLists::from_hits(70_000, &[69_999, 65_536, 3, 70_000], 4).unwrap();
    assert_eq!(lists.words(), [3, 65_536, 69_999]);
    assert_eq!(lists.row(0), [3, 65_536, 69_999]);
    let counts = RayLists::from_counts(70_000, &[0.25], |_| vec![(3, 1), (65_536, 1), (69_999, 1)]).unwrap();
    assert_eq!(counts, lists);
}

#[test]
fn lists_share_out_their_entries() {
    // 0.5 : 0.25 : 0.25 of 8 entries; a row of zeros; one entry that stands for all.
    let lists = RayLists::from_rows(5, &[0, 3, 4, 5], &[0, 3, 4, 2, 1], &[0.5, 0.25, 0.25, 0.0, 3.0], 8).unwrap();
    assert_eq!(lists.row(0), [0, 0, 0, 0, 3, 3, 4, 4]);
    assert_eq!(lists.row(1), [0; 0]);
    assert_eq!(lists.row(2), [1; 8]);
    assert_eq!(lists.sums(), [1.0, 0.0, 3.0]);
}

#[test]
fn tables_by_hand() {
    // Shares 1/2, 1/8, 3/8 of 3 parts of 65,536: weights 98,304, 24,576 and 73,728.
    for packing in PACKINGS {
        let tables = AliasTables::from_rows(9, &[0, 3], &[2, 5, 7], &[1.0, 0.25, 0.75], packing).unwrap();
        assert_eq!(tables.sums(), [2.0]);
        assert_eq!(tables.weights(0), [98_304, 24_576, 73_728]);
        // The light one keeps 24,576 parts and takes the rest from the first heavy one, which is then left with 57,344
        // and takes from the other.
        assert_eq!(tables.slots(), [57_344 << 16 | 2, 24_576 << 16, 0xffff_0002], "{packing:?}");
        assert_eq!(tables.words(), [5 << 16 | 2, 7]);
        let first = |x: u32| draw(x, 0, 3, tables.slots());
        // The first third of the words is the first slot; 7/8 of it are its own.
        assert_eq!([0, 0x4000_0000, 0x5000_0000, 0x5555_5555].map(first), [0, 0, 2, 2]);
        assert_eq!([0x5555_5556, 0x7555_5556, 0x8000_0000, 0xaaaa_aaab, u32::MAX].map(first), [1, 0, 0, 2, 2]);
    }
}

#[test]
fn splitting_finds_second_entries_by_bisection() {
    // Light 0, 2, 3 lack 65,536 − 10,000, − 60,000 and − 6,144 − 40,000; heavy 1 and 4.
    let weights = [10_000, 120_000, 60_000, 25_536, 112_144];
    let row_start = [0, 5];
    let mut scan = [glam::UVec2::ZERO; 5];
    assert_eq!(weights.iter().sum::<u32>(), 5 << 16);
    scan_row(0, &row_start, &weights, 0, &mut scan);
    assert_eq!(scan.map(|s| s.x), [0, 2, 3, 1, 4]);
    assert_eq!(scan.map(|s| s.y), [0, 55_536, 61_072, 54_464, 101_072]);
    let slots: Vec<u32> = (0..5).map(|e| pack_entry(e, 1, &row_start, &weights, &scan)).collect();
    // Entry 1 fills 0, and is left with 120,000 − 55,536 = 64,464 parts; entry 4 fills it, 2 and 3.
    assert_eq!(slots, [10_000 << 16 | 1, 64_464 << 16 | 4, 60_000 << 16 | 4, 25_536 << 16 | 4, 0xffff_0004]);
}

#[test]
fn rows_of_nothing_of_one_entry_and_of_more_than_one() {
    let row_start = [0, 0, 1, 2, 4];
    let columns = [1, 0, 0, 1];
    let values = [0.25, 0.0, 1.5, 0.5];
    let light = [Vec4::new(2.0, 1.0, 0.5, 0.0), Vec4::new(4.0, 2.0, 1.0, 0.0)];
    for packing in PACKINGS {
        let tables = AliasTables::from_rows(2, &row_start, &columns, &values, packing).unwrap();
        let lists = RayLists::from_rows(2, &row_start, &columns, &values, 64).unwrap();
        assert_eq!(tables.sums(), [0.0, 0.25, 0.0, 2.0]);
        let rows: [&dyn Distribution; 2] = [&tables, &lists];
        for rows in rows {
            let mut exact = [Vec4::ONE; 4];
            rows.apply(&light, &mut exact).unwrap();
            assert_eq!(exact.map(|h| h.x), [0.0, 1.0, 0.0, 5.0]);
            let settings =
                Settings { control_variate: false, blend: Blend::Fixed(0.0), samples: 64, ..Settings::default() };
            let mut sampled = [Vec4::ONE; 4];
            rows.sample(&settings.params(4, 0, 0), &light, &light, &mut sampled).unwrap();
            // A row of one entry has no noise; the lattice of 64 points is one off at most in the last.
            assert_eq!([sampled[0].y, sampled[1].y, sampled[2].y], [0.0, 0.5, 0.0]);
            assert!((sampled[3].y - 2.5).abs() <= 2.0 / 64.0, "{}", sampled[3].y);
        }
    }
}

#[test]
fn fixed_weights_follow_the_geometric_series() {
    // One column: samples have no noise, so H = B (1 − wᵏ).
    let lists = RayLists::from_hits(1, &[0, 0], 2).unwrap();
    let settings = Settings { control_variate: false, blend: Blend::Fixed(0.5), ..Settings::default() };
    let mut state = State::new(1);
    for k in 1..10 {
        state.advance(&lists, &[Vec4::ONE], &[Vec4::ZERO], &settings).unwrap();
        assert_eq!(state.irradiance[0].x, 1.0 - 0.5f32.powi(k));
    }
    // By itself w is that of a mean: light that rests is right from the first frame on, and counts its frames.
    let auto = Settings { blend: Blend::Auto { frames: 4.0 }, ..settings };
    let mut state = State::new(1);
    for k in 1..20 {
        state.advance(&lists, &[Vec4::splat(3.0)], &[Vec4::ZERO], &auto).unwrap();
        assert!((state.irradiance[0].x - 3.0).abs() < 1e-5);
        // By a fourth in the beginning, by half where it averages four, the most here.
        let frames = [0.25, 0.516, 0.798, 1.098, 1.416][k.min(5) as usize - 1];
        let frames = if k < 6 {
            frames
        } else if k == 19 {
            4.5
        } else {
            state.irradiance[0].w
        };
        assert!((state.irradiance[0].w - frames).abs() < 1e-3, "frame {k}: {}", state.irradiance[0].w);
    }
    // It jumps: no frame before counts.
    state.advance(&lists, &[Vec4::splat(9.0)], &[Vec4::ZERO], &auto).unwrap();
    assert!((state.irradiance[0].x - 9.0).abs() < 0.02, "{}", state.irradiance[0].x);
    state.advance(&lists, &[Vec4::ZERO], &[Vec4::ZERO], &auto).unwrap();
    assert!(state.irradiance[0].x < 0.02, "{}", state.irradiance[0].x);
}

#[test]
fn colours_keep_luminance_and_the_rows_channels() {
    let rows = [
        [Vec3::new(0.3, 0.2, 0.1), Vec3::ZERO, Vec3::new(0.0, 0.0, 0.5), Vec3::new(0.7, 0.0, 0.0)],
        [Vec3::new(0.01, 0.02, 0.03), Vec3::splat(1.0), Vec3::new(0.0, 0.4, 0.0), Vec3::new(1e-6, 2e-6, 1e-6)],
    ];
    for packing in PACKINGS {
        let tables = AliasTables::from_rgb(4, 2, packing, |i, row| row.copy_from_slice(&rows[i])).unwrap();
        // The last entry is less than a part of its row.
        assert_eq!(tables.row_start(), [0, 3, 6]);
        for entry in 0..6 {
            let color = color_at(entry, tables.colors());
            assert!((luminance(color) - 1.0).abs() < 1e-5, "{color}");
        }
        // Light of one column at a time gives the operator's columns.
        for (i, row) in rows.iter().enumerate() {
            for (j, expected) in row.iter().enumerate() {
                let mut light = [Vec4::ZERO; 4];
                light[j] = Vec4::ONE;
                let mut found = [Vec4::ZERO; 2];
                tables.apply(&light, &mut found).unwrap();
                let error = (found[i].truncate() - *expected).abs().max_element();
                // The greatest step, at a blue of 13.85 for a luminance of 1, is 0.11; as much may come from the entry
                // before.
                assert!(error <= 0.22 * luminance(*expected) + 2e-4, "{i} {j}: {} for {expected}", found[i]);
            }
        }
        // Light of all columns: the rows' sums, channel by channel.
        let mut found = [Vec4::ZERO; 2];
        tables.apply(&[Vec4::ONE; 4], &mut found).unwrap();
        for (row, found) in rows.iter().zip(found) {
            let sum: Vec3 = row.iter().sum();
            assert!((found.truncate() - sum).abs().max_element() < 0.01 * sum.max_element(), "{found} for {sum}");
        }
    }
}

#[test]
fn exact_sums_take_every_row_once() {
    for (rows, refresh) in [(10, 4), (7, 7), (5, 9), (1000, 16), (1, 1)] {
        let settings = Settings { refresh, ..Settings::default() };
        let mut seen = vec![0; rows as usize];
        for frame in 100 * refresh..101 * refresh {
            let rows_to_sum = settings.rows_to_sum(rows, 0, frame);
            (0..rows_to_sum.count)
                .for_each(|k| seen[patchlight_temporal::kernel::sample::summed_row(k, &rows_to_sum) as usize] += 1);
        }
        assert!(seen.iter().all(|&count| count >= 1), "{rows} {refresh}: {seen:?}");
        assert!(seen.iter().sum::<u32>() < rows + refresh);
    }
    assert_eq!(Settings { refresh: 0, ..Settings::default() }.rows_to_sum(10, 0, 3).count, 0);
    assert_eq!(Settings { control_variate: false, ..Settings::default() }.rows_to_sum(10, 0, 3).count, 0);
    assert_eq!(Settings::default().rows_to_sum(0, 0, 3).first, 0);
}

#[test]
fn a_sum_beyond_the_last_row_goes_on_with_the_first() {
    let lists = RayLists::from_hits(3, &[0, 1, 2], 1).unwrap();
    let light = [Vec4::splat(1.0), Vec4::splat(2.0), Vec4::splat(3.0)];
    let mut out = [Vec4::splat(9.0); 3];
    lists.sum(&SumParams { count: 2, first: 2, ..SumParams::default() }, &light, &mut out).unwrap();
    assert_eq!(out.map(|h| h.x), [1.0, 9.0, 3.0]);
}

#[test]
fn what_cannot_be_is_refused() {
    use Error::{Length, Setting, TooMany, Value};
    assert!(matches!(RayLists::from_hits(3, &[], 0), Err(Setting { name: "rays", .. })));
    assert!(matches!(RayLists::from_hits(3, &[1, 2, 0], 2), Err(Length { expected: 2, found: 3, .. })));
    let counts = |columns, scale| RayLists::from_counts(columns, &[scale], |_| vec![(0, 1), (4, 2)]);
    assert!(matches!(counts(4, 0.5), Err(Value { name: "columns", index: 1, .. })));
    assert!(matches!(counts(5, f32::NAN), Err(Value { name: "scales", index: 0, .. })));
    assert!(counts(5, 0.5).is_ok());
    let rows = |row_start: &[u32], columns: &[u32], values: &[f32]| {
        let lists = RayLists::from_rows(4, row_start, columns, values, 16).map(|_| ());
        let tables = AliasTables::from_rows(4, row_start, columns, values, Packing::Stacks).map(|_| ());
        assert_eq!(lists, tables);
        tables
    };
    assert!(matches!(rows(&[], &[], &[]), Err(Length { name: "row_start", .. })));
    assert!(matches!(rows(&[0, 2, 1], &[0], &[1.0]), Err(Value { name: "row_start", index: 2, .. })));
    assert!(matches!(rows(&[0, 2], &[0], &[1.0]), Err(Length { name: "column_index", .. })));
    assert!(matches!(rows(&[0, 1], &[0], &[]), Err(Length { name: "values", .. })));
    assert!(matches!(rows(&[0, 1], &[4], &[1.0]), Err(Value { name: "column_index", .. })));
    assert!(matches!(rows(&[0, 1], &[3], &[-1.0]), Err(Value { name: "values", .. })));
    assert!(matches!(rows(&[0, 1], &[3], &[f32::INFINITY]), Err(Value { name: "values", .. })));
    assert!(rows(&[0, 1], &[3], &[1.0]).is_ok() && rows(&[0], &[], &[]).is_ok());
    let no_entries = RayLists::from_rows(4, &[0, 1], &[3], &[1.0], 0);
    assert!(matches!(no_entries, Err(Setting { name: "entries", .. })));
    let long: Vec<u32> = (0..65_536).collect();
    let table = AliasTables::from_rows(65_536, &[0, 65_536], &long, &vec![1.0; 65_536], Packing::Stacks);
    assert!(matches!(table, Err(TooMany { found: 65_536, .. })));
    let negative = AliasTables::from_rgb(2, 1, Packing::Stacks, |_, row| row[1] = Vec3::new(0.0, -1.0, 1.0));
    assert!(matches!(negative, Err(Value { name: "rows", index: 0, .. })));

    let lists = RayLists::from_hits(2, &[0, 1], 1).unwrap();
    let two = [Vec4::ONE; 2];
    let mut one = [Vec4::ONE; 1];
    assert!(matches!(lists.apply(&two, &mut one), Err(Length { name: "irradiance", .. })));
    assert!(matches!(lists.apply(&one.clone(), &mut two.clone()), Err(Length { name: "exitance", .. })));
    let mut out = two;
    let sum = |count, first| SumParams { count, first, ..SumParams::default() };
    assert!(matches!(lists.sum(&sum(3, 0), &two, &mut out), Err(Setting { name: "count", .. })));
    assert!(matches!(lists.sum(&sum(1, 2), &two, &mut out), Err(Setting { name: "first", .. })));
    assert!(matches!(lists.sample(&SampleParams::default(), &two, &one, &mut out), Err(Length { name: "change", .. })));
    for (settings, name) in [
        (Settings { samples: 0, ..Settings::default() }, "samples"),
        (Settings { samples: 65_537, ..Settings::default() }, "samples"),
        (Settings { blend: Blend::Fixed(1.0), ..Settings::default() }, "blend"),
        (Settings { blend: Blend::Fixed(-0.1), ..Settings::default() }, "blend"),
        (Settings { blend: Blend::Fixed(f32::NAN), ..Settings::default() }, "blend"),
        (Settings { blend: Blend::Auto { frames: 0.5 }, ..Settings::default() }, "frames"),
        (Settings { blend: Blend::Auto { frames: f32::INFINITY }, ..Settings::default() }, "frames"),
    ] {
        let refused = State::new(2).advance(&lists, &two, &two, &settings);
        assert!(matches!(refused, Err(Setting { name: n, .. }) if n == name), "{settings:?}");
    }
    let mut three = State::new(3);
    assert!(three.advance(&lists, &[Vec4::ONE; 3], &[Vec4::ONE; 3], &Settings::default()).is_err());
}
