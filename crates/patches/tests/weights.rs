//! Packed weights: what goes in comes out rounded, sums stay, and the product is that of the weights.

use glam::{Vec2, Vec3, Vec4};
use patchlight_patches::kernel::weights::weighted_row;
use patchlight_patches::{Error, PackedWeights, Weight, WeightParams};
use scene::sampling::{hash3, unit};
use transport::rotational_gradients;

const RECEIVERS: u32 = 5000;

fn random(k: u32, d: u32) -> f32 {
    unit(hash3(k, d, 11))
}

/// Row `k`: up to `most` receivers near number 7 k, with weights that sum to 1, some of them with a rotation.
fn row(k: usize, most: u32) -> Vec<Weight> {
    let k = k as u32;
    let count = hash3(k, 0, 5) % (most + 1);
    let mut row: Vec<Weight> = (0..count)
        .map(|j| Weight {
            receiver: (7 * k + 13 * j) % RECEIVERS,
            weight: random(k, 10 + j) - 0.2,
            rotation: (hash3(k, j, 6).is_multiple_of(3))
                .then(|| 0.5 * Vec2::new(2.0 * random(k, 50 + j) - 1.0, 2.0 * random(k, 90 + j) - 1.0)),
        })
        .collect();
    let total: f32 = row.iter().map(|weight| weight.weight).sum();
    // A sum near 0 would make weights out of the range.
    let scale = if total > 0.3 { 1.0 / total } else { 1.0 };
    row.iter_mut().for_each(|weight| weight.weight *= scale);
    row
}

fn sum(row: &[Weight]) -> f32 {
    row.iter().map(|weight| weight.weight).sum()
}

#[test]
fn rows_come_out_as_they_went_in_to_half_a_step() {
    for most in [1, 8, 27, 31] {
        let packed = PackedWeights::new(1003, |k| row(k, most)).unwrap();
        assert_eq!(packed.rows(), 1003);
        assert_eq!(packed.weights(), (0..1003).map(|k| packed.row(k).len()).sum::<usize>());
        for k in 0..1003 {
            let given = row(k, most);
            let found = packed.row(k);
            // A row of ones is exactly 1.
            let total = (128.0 * sum(&given) + 0.5).floor() / 128.0;
            assert_eq!(sum(&found), total, "row {k} of at most {most}");
            for weight in &given {
                let same = found.iter().find(|other| other.receiver == weight.receiver);
                let other = same.copied().unwrap_or(Weight { weight: 0.0, ..*weight });
                assert!((other.weight - weight.weight).abs() <= 1.0 / 128.0 + 1e-6, "{weight:?} {other:?}");
                assert_eq!(other.rotation.is_some(), weight.rotation.is_some());
                let a = other.rotation.unwrap_or_default();
                let b = weight.rotation.unwrap_or_default();
                assert!((a - b).abs().max_element() <= 0.5 / 254.0 + 1e-6, "{a} {b}");
            }
        }
        assert!(packed.row(1003).is_empty());
    }
}

#[test]
fn products_are_those_of_the_weights() {
    let packed = PackedWeights::new(400, |k| row(k, 8)).unwrap();
    let normal = Vec3::Y;
    let (right, up) = scene::sampling::frame(normal);
    let gradients = rotational_gradients(normal);
    let quadrants = 4 * RECEIVERS;
    let values: Vec<Vec4> =
        (0..quadrants + RECEIVERS).map(|k| Vec4::new(random(k, 1), random(k, 2), random(k, 3), 0.0)).collect();
    for (first_value, parts) in [(0, 4), (quadrants, 1)] {
        let p = WeightParams { count: 400, block_rows: packed.block_rows(), first_value, parts, ..<_>::default() };
        let mut product = vec![Vec4::ZERO; 400];
        packed.apply(first_value as usize, parts as usize, &values, &mut product).unwrap();
        let last = *packed.lists().iter().max().unwrap();
        let few = &values[..(first_value + parts * (last + 1)) as usize - 1];
        assert!(packed.apply(first_value as usize, parts as usize, few, &mut vec![Vec4::ZERO; 400]).is_err());
        assert!(packed.apply(0, 4, &values, &mut [Vec4::ZERO; 399]).is_err());
        for k in 0..400u32 {
            let expected = |rows: &[Weight]| {
                let mut expected = Vec4::ZERO;
                for Weight { receiver, weight, rotation } in rows {
                    let own: Vec4 =
                        (0..parts).map(|part| values[(first_value + parts * receiver + part) as usize]).sum();
                    let rotation = rotation.unwrap_or_default();
                    let difference = right * rotation.x + up * rotation.y;
                    let change: Vec4 =
                        (0..4).map(|q| values[(4 * receiver) as usize + q] * gradients[q].dot(difference)).sum();
                    expected += (own + change) * *weight;
                }
                expected
            };
            let found =
                weighted_row(k, &p, packed.row_start(), packed.list_start(), packed.lists(), packed.entries(), &values);
            assert_eq!(product[k as usize], found, "row {k}");
            let rows = packed.row(k as usize);
            // Additions in another order.
            assert!((found - expected(&rows)).abs().max_element() < 1e-5, "row {k}");
            let mut wrong = rows.clone();
            if let Some(weight) = wrong.first_mut() {
                weight.receiver = (weight.receiver + 1) % RECEIVERS;
                assert!((found - expected(&wrong)).abs().max_element() > 1e-5, "row {k}");
            }
        }
    }
}

#[test]
fn light_that_is_even_stays_so() {
    let packed = PackedWeights::new(500, |k| row(k, 8)).unwrap();
    for k in 0..500 {
        let given = row(k, 8);
        if (sum(&given) - 1.0).abs() < 1e-5 {
            assert_eq!(sum(&packed.row(k)), 1.0);
        }
    }
}

#[test]
fn rows_that_do_not_fit_are_refused() {
    let of = |weight: f32, count: u32, rotation: Option<Vec2>| {
        PackedWeights::new(3, move |k| match k {
            1 => (0..count).map(|receiver| Weight { receiver, weight, rotation }).collect(),
            _ => Vec::new(),
        })
    };
    assert!(of(0.5, 31, Some(Vec2::ZERO)).is_ok() && of(-1.9, 1, None).is_ok() && of(0.01, 128, None).is_ok());
    assert!(matches!(of(2.0, 1, None), Err(Error::Value { name: "weights", index: 1, .. })));
    assert!(matches!(of(f32::NAN, 1, None), Err(Error::Value { name: "weights", index: 1, .. })));
    for (count, rotation) in [(129, None), (32, Some(Vec2::ZERO))] {
        let found = of(0.5, count, rotation);
        assert!(matches!(found, Err(Error::Shared(transport::Error::TooMany { .. }))), "{found:?}");
    }
}
