//! Operators from few patches to many receivers in tiles, against their rows.

mod support;

use bytemuck::cast_slice;
use glam::{Vec3, Vec4};
use patchlight_multibounce::kernel::low_rank as body;
use patchlight_multibounce::{
    Error, LowRank, LowRankWorkspace, TileSide, TileSource, halving_order, multiply_vt_all, permute_in_all,
    quantise_all, requantise_all,
};
use support::{go, random};
use transport::LinearOperator;
use transport::Proceed;

/// Patches on a line and receivers on another above it, a third of which sees nothing far away.
struct Case {
    area: Vec<f32>,
    order: Vec<u32>,
    patch_area: Vec<f32>,
    patch_order: Vec<u32>,
    rows: Vec<Vec<(u32, f32)>>,
}

impl Case {
    fn new(receivers: usize, patches: usize) -> Self {
        let line =
            |n: usize| halving_order(&(0..n).map(|i| Vec3::X * i as f32).collect::<Vec<_>>(), &vec![Vec3::Z; n], &[]);
        let patch_area: Vec<f32> = (0..patches).map(|j| 0.2 + random(j, 0, 1)).collect();
        let row = |i: usize| -> Vec<(u32, f32)> {
            let x = |j: usize| (i as f32 / receivers as f32 - j as f32 / patches as f32).abs();
            let sees = |j: &usize| !i.is_multiple_of(3) || x(*j) < 0.2;
            let value = |j: usize| patch_area[j] / (0.003 + x(j) * x(j)) * (1.0 + 0.3 * random(i, j, 2));
            (0..patches).filter(sees).map(|j| (j as u32, value(j) * 0.01 / patches as f32)).collect()
        };
        Self {
            area: (0..receivers).map(|i| 0.5 + random(i, 0, 3)).collect(),
            order: line(receivers),
            patch_order: line(patches),
            rows: (0..receivers).map(row).collect(),
            patch_area,
        }
    }

    fn encode(&self, epsilon: f64) -> Result<LowRank, Error> {
        let rows = |i: usize, each: &mut dyn FnMut(u32, f32)| self.rows[i].iter().for_each(|&(j, f)| each(j, f));
        LowRank::encode(
            TileSource::Rows { rows: &rows, receivers: self.receivers(), patches: self.patches() },
            epsilon,
            &go,
        )
    }

    fn receivers(&self) -> TileSide<'_> {
        TileSide { area: &self.area, order: &self.order }
    }

    fn patches(&self) -> TileSide<'_> {
        TileSide { area: &self.patch_area, order: &self.patch_order }
    }

    /// Relative Frobenius error of `a_r^½ F_r a_s^-½`, column by column of what products multiply by.
    fn error_of(&self, tiles: &LowRank) -> f64 {
        let mut wrong = 0.0;
        let mut whole = 0.0;
        let mut workspace = LowRankWorkspace::default();
        for (j, a) in self.patch_area.iter().enumerate() {
            let mut unit = vec![Vec4::ZERO; self.patch_area.len()];
            let mut column = vec![Vec4::ZERO; self.area.len()];
            unit[j] = Vec4::ONE;
            tiles.apply_in(&mut workspace, &unit, &mut column).unwrap();
            for (i, h) in column.iter().enumerate() {
                assert_eq!((h.x, h.x, 0.0), (h.y, h.z, h.w));
                let exact: f32 = self.rows[i].iter().filter(|entry| entry.0 == j as u32).map(|entry| entry.1).sum();
                let scale = f64::from(self.area[i] / a);
                wrong += scale * f64::from(h.x - exact).powi(2);
                whole += scale * f64::from(exact).powi(2);
            }
        }
        (wrong / whole).sqrt()
    }
}

fn light(n: usize) -> Vec<Vec4> {
    (0..n).map(|j| Vec4::new(random(j, 0, 9), random(j, 1, 9), random(j, 2, 9), 0.0)).collect()
}

fn product(tiles: &LowRank, light: &[Vec4]) -> Vec<Vec4> {
    let mut irradiance = vec![Vec4::ZERO; tiles.rows()];
    tiles.apply(light, &mut irradiance).unwrap();
    irradiance
}

#[test]
fn the_error_that_was_asked_for_is_kept_and_less_of_it_costs_more() {
    let case = Case::new(700, 300);
    let mut last = 0;
    for epsilon in [1e-1, 1e-2, 1e-3] {
        let tiles = case.encode(epsilon).unwrap();
        tiles.check().unwrap();
        // Exitance is rounded to 15 bits, which a column alone shows most.
        let found = case.error_of(&tiles);
        assert!(found <= epsilon * 1.01 + 1e-4 && found > 0.5 * epsilon, "{epsilon}: {found}");
        assert!((found - tiles.report.error[0]).abs() < 0.02 * epsilon + 1e-4, "{epsilon}: {found} {:?}", tiles.report);
        let bytes = tiles.bytes_by_part().iter().map(|part| part.1).sum();
        assert!(bytes > last, "{epsilon}: {bytes}");
        last = bytes;
        // Other rows than those that were encoded are further away.
        let mut other = Case::new(700, 300);
        other.rows[350].iter_mut().for_each(|entry| entry.1 *= 2.0);
        assert!(other.error_of(&tiles) > 2.0 * epsilon.min(0.02), "{epsilon}");
    }
}

#[test]
fn names_of_receivers_and_patches_change_nothing() {
    let case = Case::new(300, 200);
    let tiles = case.encode(0.02).unwrap();
    let exitance = light(200);
    let expected = product(&tiles, &exitance);
    // Receiver i is called 7 i + 3 mod 300, patch j 9 j + 1 mod 200.
    let receiver = |i: usize| (7 * i + 3) % 300;
    let patch = |j: usize| (9 * j + 1) % 200;
    let mut other = Case::new(300, 200);
    for i in 0..300 {
        other.area[receiver(i)] = case.area[i];
        other.order[i] = receiver(case.order[i] as usize) as u32;
        other.rows[receiver(i)] = case.rows[i].iter().map(|&(j, f)| (patch(j as usize) as u32, f)).collect();
    }
    let mut renamed = exitance.clone();
    for j in 0..200 {
        other.patch_area[patch(j)] = case.patch_area[j];
        other.patch_order[j] = patch(case.patch_order[j] as usize) as u32;
        renamed[patch(j)] = exitance[j];
    }
    let found = product(&other.encode(0.02).unwrap(), &renamed);
    (0..300).for_each(|i| assert_eq!(found[receiver(i)], expected[i], "receiver {i}"));
    assert_ne!(found, expected);
}

#[test]
fn products_are_those_of_the_bodies_for_any_number_of_threads() {
    // In their own order, and in another; rows that are no whole number of tiles.
    for reversed in [false, true] {
        let mut case = Case::new(421, 300);
        case.order = (0..421).collect();
        if reversed {
            case.order.reverse();
        }
        let tiles = case.encode(0.01).unwrap();
        assert!(tiles.report.terms[0] > 0 && tiles.report.entries + tiles.report.sub_blocks > 0, "{:?}", tiles.report);
        let mut exitance = light(300);
        like_the_bodies(&tiles, &exitance);
        // Blocks in the dark are passed over.
        (0..300).filter(|&j| case.patch_order[..128].contains(&(j as u32))).for_each(|j| exitance[j] = Vec4::ZERO);
        like_the_bodies(&tiles, &exitance);
    }
}

fn like_the_bodies(tiles: &LowRank, exitance: &[Vec4]) {
    let columns = tiles.column_blocks() * body::TILE as usize;
    let mut ordered = vec![Vec4::ZERO; body::PERMUTED_INDICES];
    permute_in_all(&tiles.order, tiles.column_sqrt_area(), exitance, &mut ordered[..columns]);
    let mut light = vec![0; tiles.column_blocks() * body::LIGHT_WORDS as usize];
    quantise_all(&ordered[..columns], &mut light);
    let mut sums = vec![Vec4::ZERO; tiles.scale.len()];
    multiply_vt_all(&tiles.vt_tables(), &light, &mut sums);
    let runs = &tiles.runs;
    let mut factors = vec![0; (runs.len() - 1) * body::FACTOR_WORDS as usize];
    requantise_all(runs, &tiles.paired, &sums, &mut factors);
    let padded_rows = tiles.blocks() * body::TILE as usize;
    let mut rows = vec![Vec4::ZERO; body::SPLITS as usize * padded_rows];
    let t = tiles.u_tables();
    for k in 0..rows.len() as u32 / (2 * body::PARTS) {
        let own = body::multiply_u(k, t.run_start, t.runs, t.groups, cast_slice(t.words), cast_slice(&factors));
        for part in 0..body::PARTS {
            let at = body::row_at(k, part) as usize;
            rows[at] = own[part as usize];
            rows[at + 1] = own[(part + body::PARTS) as usize];
        }
    }
    let t = tiles.dense_sparse_tables();
    let dense_sparse: Vec<Vec4> = (0..padded_rows as u32 / 8)
        .flat_map(|k| {
            let words = (t.sub_block_start, t.sub_blocks, cast_slice(t.sub_block_words));
            body::dense_sparse(
                k,
                words.0,
                words.1,
                words.2,
                cast_slice(&light),
                t.row_start,
                t.entries,
                t.steps,
                &ordered,
            )
        })
        .collect();
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let found = pool.install(|| product(tiles, exitance));
        for (i, h) in (0u32..).zip(&found) {
            assert_eq!(
                *h,
                body::permute_out(i, &tiles.permuted_index, &tiles.row_sqrt_area, &rows, &dense_sparse),
                "receiver {i}"
            );
        }
    }
}

#[test]
fn no_receivers_and_no_patches_are_no_light() {
    for (receivers, patches) in [(0, 5), (130, 0), (0, 0)] {
        let mut case = Case::new(receivers, patches);
        case.rows.iter_mut().for_each(Vec::clear);
        let tiles = case.encode(0.01).unwrap();
        tiles.check().unwrap();
        assert_eq!(product(&tiles, &light(patches)), vec![Vec4::ZERO; receivers]);
    }
    // Rows without entries among others.
    let mut case = Case::new(300, 40);
    case.rows[128..290].iter_mut().for_each(Vec::clear);
    let tiles = case.encode(0.01).unwrap();
    let found = product(&tiles, &light(40));
    case.order[..].iter().for_each(|&i| assert_eq!(found[i as usize] == Vec4::ZERO, (128..290).contains(&i)));
}

#[test]
fn what_is_wrong_is_said() {
    let good = || Case::new(140, 40);
    for epsilon in [0.0, 1.0, f64::NAN] {
        assert!(matches!(
            good().encode(epsilon),
            Err(Error::Shared(transport::Error::Setting { name: "epsilon", .. }))
        ));
    }
    let mut case = good();
    case.order.pop();
    assert!(matches!(
        case.encode(0.1),
        Err(Error::Shared(transport::Error::Length { name: "order", expected: 140, found: 139 }))
    ));
    let mut case = good();
    case.patch_order[3] = case.patch_order[2];
    assert!(matches!(case.encode(0.1), Err(Error::Shared(transport::Error::Value { name: "order", index: 3, .. }))));
    let mut case = good();
    case.patch_area[5] = 0.0;
    assert!(matches!(case.encode(0.1), Err(Error::Shared(transport::Error::Value { name: "area", index: 5, .. }))));
    let mut case = good();
    case.rows[77][0].0 = 40;
    assert!(matches!(case.encode(0.1), Err(Error::Shared(transport::Error::Value { name: "columns", index: 77, .. }))));
    let mut case = good();
    case.rows[77][0].1 = f32::NAN;
    assert!(matches!(case.encode(0.1), Err(Error::Shared(transport::Error::Value { name: "values", index: 77, .. }))));
    let case = good();
    let stop = |_: usize, _: usize| Proceed::Break(());
    let rows = |_: usize, each: &mut dyn FnMut(u32, f32)| each(0, 1.0);
    let found = LowRank::encode(
        TileSource::Rows { rows: &rows, receivers: case.receivers(), patches: case.patches() },
        0.1,
        &stop,
    );
    assert!(matches!(found, Err(Error::Shared(transport::Error::Cancelled { total: 2, .. }))));
    let many = vec![1.0; 65_536];
    let order: Vec<u32> = (0..65_536).collect();
    let patches = TileSide { area: &many, order: &order };
    let found = LowRank::encode(TileSource::Rows { rows: &rows, receivers: case.receivers(), patches }, 0.1, &go);
    assert!(matches!(found, Err(Error::Shared(transport::Error::TooMany { name: "patches", .. }))));

    let case = Case::new(300, 200);
    let tiles = case.encode(0.01).unwrap();
    assert!(tiles.apply(&light(199), &mut vec![Vec4::ZERO; 300]).is_err());
    assert!(tiles.apply(&light(200), &mut vec![Vec4::ZERO; 299]).is_err());
    // Tables that lead beyond their end.
    let broken = |change: &dyn Fn(&mut LowRank), named: &str| {
        let mut tiles = tiles.clone();
        change(&mut tiles);
        match tiles.check() {
            Err(
                Error::Shared(transport::Error::Length { name, .. })
                | Error::Shared(transport::Error::Value { name, .. }),
            ) => assert_eq!(name, named),
            other => panic!("{named}: {other:?}"),
        }
    };
    broken(&|t| t.paired[0] = t.scale.len() as u32, "paired");
    broken(&|t| _ = t.paired.pop(), "paired");
    broken(&|t| _ = t.scale.pop(), "scale");
    broken(&|t| t.scale[0] = f32::INFINITY, "scale");
    broken(&|t| _ = t.words.pop(), "words");
    broken(&|t| _ = t.columns.as_mut().unwrap().words.pop(), "words");
    broken(&|t| t.columns.as_mut().unwrap().groups[0].start = u32::MAX, "groups");
    broken(&|t| t.groups[0].tag |= 3, "groups");
    broken(&|t| t.runs.swap(0, 1), "runs");
    broken(&|t| t.run_start[1] = u32::MAX, "run_start");
    broken(&|t| t.entries.push(0), "row_start");
    broken(&|t| t.steps[3] = f32::NAN, "steps");
    broken(&|t| t.permuted_index[7] = 300, "permuted_index");
    broken(&|t| t.order[7] = 200, "order");
    broken(&|t| t.row_sqrt_area[7] = -1.0, "sqrt_area");
    broken(&|t| _ = t.columns.as_mut().unwrap().sqrt_area.pop(), "sqrt_area of columns");
    broken(&|t| _ = t.sub_block_start.pop(), "sub_block_start");
}
