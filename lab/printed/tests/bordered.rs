//! The printed matrix: small cases by hand, beside what is exact.

use glam::{Vec3, Vec4};
use localmatrix::{Entering, Error, LocalMatrix};
use printed::PrintedMatrix;

/// Patches 4, 5, 6: areas 1, 2, 1, colours 0.5, 0.8, 0.6; F_45 = 0.4, F_64 = 0.3, F_65 = 0.1.
const AREA: [f32; 3] = [1.0, 2.0, 1.0];
const COLOUR: [f32; 3] = [0.5, 0.8, 0.6];

fn entering<'a>(k: usize, factors: &'a [(u32, f32)]) -> Entering<'a> {
    Entering { patch: 4 + k as u32, area: AREA[k], albedo: Vec3::splat(COLOUR[k]), factors }
}

fn rows() -> [Vec<(u32, f32)>; 3] {
    [vec![], vec![(4, 0.2)], vec![(4, 0.3), (5, 0.1)]]
}

fn printed(count: usize) -> PrintedMatrix {
    let mut matrix = PrintedMatrix::new(4).unwrap();
    let rows = rows();
    (0..count).for_each(|k| matrix.add(&entering(k, &rows[k])).unwrap());
    matrix
}

fn near(matrix: &PrintedMatrix, expected: &[[f32; 3]], count: usize) -> bool {
    let is_near = |i: usize, j: usize| {
        (0..3).all(|channel| (matrix.entry(channel, i as u32, j as u32) - expected[i][j]).abs() < 1e-5)
    };
    (0..count).all(|i| (0..count).all(|j| is_near(i, j)))
}

#[test]
fn two_and_three_patches_by_hand() {
    // double_reflection = 0.2 · 0.4 · 0.5 = 0.04, f' = 1.032 f; C of the first, not c of the second, in its corner.
    let two = [[0.5 * 0.4128 * 0.2064, 0.4128, 0.0], [0.2064, 0.0, 0.0], [0.0; 3]];
    assert!(near(&printed(2), &two, 2));
    // double_reflection = 0.3 · 0.3 · 0.5 + 0.1 · 0.05 · 0.8 = 0.049, f' = 1.0294 f.
    let g_row = [0.332395, 0.166680];
    let g_column = [0.332395, 0.083340];
    let mut three = [[0.0; 3]; 3];
    for i in 0..2 {
        for j in 0..2 {
            three[i][j] = two[i][j] + COLOUR[i] * g_column[i] * g_row[j];
        }
        (three[i][2], three[2][i]) = (g_column[i], g_row[i]);
    }
    assert!(near(&printed(3), &three, 3));
    // With the colour of the new patch in the place of those that receive it is another matrix.
    let mut wrong = three;
    wrong[0][0] = two[0][0] + COLOUR[2] * g_column[0] * g_row[0];
    assert!(!near(&printed(3), &wrong, 3));
    wrong[0][0] = three[0][0];
    // Without double reflection too.
    wrong[2][0] = g_row[0] / 1.0294;
    assert!(!near(&printed(3), &wrong, 3));
}

#[test]
fn it_is_near_what_is_exact_and_drifts() {
    let mut exact = LocalMatrix::new(4).unwrap();
    let rows = rows();
    (0..3).for_each(|k| exact.add(&[entering(k, &rows[k])]).unwrap());
    let entry = |i: usize, j: usize| {
        let m = exact.slots();
        let area = exact.sqrt_area();
        exact.state()[i * m + j] * area[j] / area[i]
    };
    let error = |matrix: &PrintedMatrix| {
        let pairs = (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).filter(|(i, j)| i != j);
        pairs.map(|(i, j)| (matrix.entry(0, i as u32, j as u32) / entry(i, j) - 1.0).abs()).fold(0.0, f32::max)
    };
    let mut matrix = printed(3);
    let fresh = error(&matrix);
    assert!(fresh > 0.01 && fresh < 0.2, "{fresh}");
    // What passed a patch stays when it leaves, and comes again with it.
    for _ in 0..20 {
        matrix.remove(6).unwrap();
        matrix.add(&entering(2, &rows[2])).unwrap();
    }
    assert!(error(&matrix) > 2.0 * fresh, "{} {fresh}", error(&matrix));
}

#[test]
fn products_take_visible_rows_and_lit_columns() {
    let matrix = printed(3);
    let exitance = [1.0, 2.0, 4.0, 0.0].map(Vec4::splat);
    let mut irradiance = [Vec4::splat(-1.0); 4];
    matrix.product(&[0, 2], &[1, 2], &exitance, &mut irradiance).unwrap();
    let expected = |i: u32| 2.0 * matrix.entry(0, i, 1) + 4.0 * matrix.entry(0, i, 2);
    assert_eq!(irradiance[1], Vec4::splat(-1.0));
    for i in [0, 2] {
        assert!((irradiance[i].x - expected(i as u32)).abs() < 1e-6);
        assert!((irradiance[i].x - expected(i as u32) - matrix.entry(0, i as u32, 0)).abs() > 1e-3);
    }
    assert_eq!(matrix.work(), 9 * (1 + 4 + 9));
    assert!(matches!(matrix.product(&[4], &[], &exitance, &mut irradiance), Err(Error::NoSlot { slot: 4, .. })));
    assert!(matrix.product(&[], &[], &exitance[1..], &mut irradiance).is_err());
}

#[test]
fn bad_patches_are_refused() {
    let mut matrix = printed(3);
    assert_eq!(matrix.add(&entering(1, &[])), Err(Error::AlreadyThere { patch: 5 }));
    assert_eq!(matrix.remove(9), Err(Error::NotThere { patch: 9 }));
    matrix.add(&Entering { patch: 9, ..entering(0, &[]) }).unwrap();
    let refused = matrix.add(&Entering { patch: 10, ..entering(0, &[]) });
    assert!(matches!(refused, Err(Error::Full { needed: 1, free: 0, slots: 4 })));
    assert!(PrintedMatrix::new(0).is_err());
}
