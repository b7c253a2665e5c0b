//! The printed order beside ours.

use glam::Vec3;
use multibounce::greedy_order;
use printed::printed_order;

#[test]
fn the_printed_order_by_hand() {
    let table = [[0.0, 3.0, 2.0, 2.0], [3.0, 0.0, 5.0, 8.0], [2.0, 5.0, 0.0, 8.0], [2.0, 8.0, 8.0, 0.0]];
    let rows = |i: usize, row: &mut [Vec3]| {
        row.iter_mut().zip(table[i]).for_each(|(entry, value)| *entry = Vec3::splat(value));
    };
    // Listing 3.1, written down: distances of columns of a symmetric matrix are those of rows.
    let distance = |a: usize, b: usize| (0..4).map(|i: usize| (table[i][a] - table[i][b]).powi(2)).sum::<f32>();
    let mut expected = [0usize, 1, 2, 3];
    for _ in ["columns", "rows"] {
        for next in 1..4 {
            let own = expected[next - 1];
            let mut closest = 0;
            let mut least = f32::INFINITY;
            for (k, &other) in expected.iter().enumerate() {
                if other != own && distance(own, other) < least {
                    (closest, least) = (k, distance(own, other));
                }
            }
            expected.swap(closest, next);
        }
    }
    let printed: Vec<usize> = printed_order(4, &rows).order().iter().map(|&k| k as usize).collect();
    assert_eq!((&printed[..], &expected[..]), (&[1, 3, 0, 2][..], &[1, 3, 0, 2][..]));
    // Columns that have their place are candidates there, and not here.
    let ours: Vec<usize> = greedy_order(4, &rows).order().iter().map(|&k| k as usize).collect();
    assert_eq!(ours[0], 0);
    assert_ne!(printed, ours);
}
