//! Operators, bisection, alias tables and observers.

use std::ops::ControlFlow;
use std::sync::Mutex;

use glam::Vec4;
use patchlight_transport::alias::pair_entries;
use patchlight_transport::bisect::{Part, bisect};
use patchlight_transport::{
    Csr, Dense, Error, FnOperator, LinearOperator, Observer, Permutation, Phase, Proceed, Silent, Steps,
    TransposedOperator,
};
use scene::sampling::{hash3, unit};

fn vector(n: usize, seed: u32) -> Vec<Vec4> {
    (0..n as u32).map(|k| Vec4::splat(unit(hash3(k, seed, 1)))).collect()
}

fn matrix(rows: usize, columns: usize) -> Dense {
    let value = |k: usize| if k.is_multiple_of(3) { 0.0 } else { unit(hash3(k as u32, 9, 9)) };
    Dense::new(rows, columns, (0..rows * columns).map(value).collect()).unwrap()
}

fn dot(a: &[Vec4], b: &[Vec4]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a.x * b.x).sum()
}

#[test]
fn the_transposed_product_is_the_adjoint() {
    let dense = matrix(13, 29);
    let sparse = dense.to_csr(0.0).unwrap();
    let operators: [&dyn TransposedOperator; 2] = [&dense, &sparse];
    for operator in operators {
        let x = vector(29, 1);
        let y = vector(13, 2);
        let mut forward = vec![Vec4::ZERO; 13];
        let mut backward = vec![Vec4::ZERO; 29];
        operator.apply(&x, &mut forward).unwrap();
        operator.apply_transposed(&y, &mut backward).unwrap();
        let sides = [dot(&forward, &y), dot(&x, &backward)];
        // Single precision sums of 377 terms.
        assert!((sides[0] - sides[1]).abs() < 1e-5 * sides[0], "{sides:?}");
        assert!((sides[0] - 1.01 * sides[1]).abs() > 1e-5 * sides[0]);
        assert!(operator.apply_transposed(&x, &mut backward).is_err());
    }
}

#[test]
fn a_function_is_an_operator_of_its_shape() {
    let twice = FnOperator::new(2, 2, |x: &[Vec4], y: &mut [Vec4]| {
        y.iter_mut().zip(x).for_each(|(y, x)| *y = 2.0 * *x);
        Ok(())
    });
    let mut out = [Vec4::ZERO; 2];
    twice.apply(&[Vec4::ONE; 2], &mut out).unwrap();
    assert_eq!((out, twice.rows(), twice.bytes()), ([Vec4::splat(2.0); 2], 2, 0));
    let short = twice.apply(&[Vec4::ONE], &mut out);
    assert_eq!(short, Err(Error::Length { name: "exitance", expected: 2, found: 1 }));
}

#[test]
fn rows_of_sparse_rows_are_those_that_went_in() {
    let csr = Csr::from_rows(4, &[vec![(1, 0.5), (3, 0.25)], vec![], vec![(0, 1.0)]]).unwrap();
    let rows: Vec<Vec<(usize, f32)>> = (0..3).map(|i| csr.row(i).collect()).collect();
    assert_eq!(rows, [vec![(1, 0.5), (3, 0.25)], vec![], vec![(0, 1.0)]]);
    assert_eq!(csr.bytes(), 4 * 4 + 3 * 4 + 3 * 4);
}

#[test]
fn swaps_keep_a_permutation() {
    let mut order = Permutation::identity(5);
    order.swap(0, 3);
    order.swap(3, 3);
    order.swap(1, 3);
    assert_eq!(order, Permutation::new(vec![3, 0, 2, 1, 4]).unwrap());
    assert_ne!(order, Permutation::identity(5));
}

/// Cuts where the numbers are halved; parts of one stay whole.
fn sort_and_halve(part: &mut [u32]) -> (u32, usize) {
    part.sort_unstable();
    let sum = part.iter().sum();
    (sum, if part.len() > 1 { part.len() / 2 } else { 0 })
}

#[test]
fn parts_are_numbered_level_by_level_and_cover_the_list() {
    let mut items: Vec<u32> = (0..37).map(|k| hash3(k, 0, 0) % 1000).collect();
    let mut sorted = items.clone();
    sorted.sort_unstable();
    let parts = bisect(&mut items, sort_and_halve);
    assert_eq!(items, sorted);
    assert_eq!(parts.len(), 2 * 37 - 1);
    assert_eq!(parts[0].range, 0..37);
    assert_eq!(parts[0].first_child, Some(1));
    for (i, part) in parts.iter().enumerate() {
        assert_eq!(part.value, items[part.range.clone()].iter().sum::<u32>(), "{i}");
        if let Some(child) = part.first_child {
            let left = &parts[child];
            let right = &parts[child + 1];
            assert!(child > i && left.range.end == right.range.start);
            assert_eq!(left.range.start..right.range.end, part.range);
        } else {
            assert_eq!(part.range.len(), 1);
        }
    }
    let none: Vec<Part<u32>> = bisect(&mut [], sort_and_halve);
    assert!(none.is_empty());
}

#[test]
fn a_cut_at_an_end_makes_a_leaf() {
    for cut in [0, 4, 9] {
        let parts = bisect(&mut [4, 3, 2, 1], |_| ((), cut));
        assert_eq!(parts, [Part { range: 0..4, first_child: None, value: () }]);
    }
}

#[test]
fn paired_entries_have_their_weights() {
    let weights = [5u64, 0, 17, 2, 2, 10];
    let full = weights.iter().sum::<u64>();
    let count = weights.len() as u64;
    // A slot holds `full`, so that all weights are whole numbers.
    let mut shares = weights.map(|weight| weight * count);
    let mut given = [0u64; 6];
    let mut whole = [true; 6];
    let left = pair_entries(&mut shares, full, 0..6, |light, kept, heavy| {
        given[light as usize] += kept;
        given[heavy as usize] += full - kept;
        whole[light as usize] = false;
    });
    assert!(left.is_empty());
    for k in 0..6 {
        given[k] += if whole[k] { full } else { 0 };
        assert_eq!(given[k], weights[k] * count, "{k}");
    }
}

/// Writes down what is reported, and stops at so many steps.
struct Recorder {
    reported: Mutex<Vec<(&'static str, u64, u64)>>,
    stop_at: u64,
}

impl Observer for Recorder {
    fn progress(&self, phase: Phase, done: u64, total: u64) -> Proceed {
        self.reported.lock().unwrap().push((phase.name(), done, total));
        if done >= self.stop_at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

#[test]
fn a_phase_has_a_begin_and_an_end() {
    let observer = Recorder { reported: Mutex::default(), stop_at: 3 };
    let last = Steps::new(&observer, Phase::TABLES).run(|progress| (0..5).find(|&step| progress(step, 5).is_break()));
    assert_eq!(last, Some(3));
    let reported = observer.reported.into_inner().unwrap();
    let steps = [(0, 1), (0, 5), (1, 5), (2, 5), (3, 5), (1, 1)];
    assert_eq!(reported, steps.map(|(done, total)| ("tables", done, total)));
    assert!(Silent.progress(Phase::TABLES, 9, 9).is_continue());
    assert_eq!(format!("[{:8}]", Phase::MAPS), "[maps    ]");
}
