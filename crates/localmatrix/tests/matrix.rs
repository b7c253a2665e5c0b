//! The matrix of patches that come and go against fresh solves.

use faer::Mat;
use faer::linalg::solvers::Solve;
use glam::{Vec3, Vec4};
use patchlight_localmatrix::{Entering, Error, LocalMatrix};
use scene::sampling::{hash3, unit};
use transport::LinearOperator as _;

fn random(a: usize, b: usize, c: u32) -> f32 {
    unit(hash3(a as u32, b as u32, c))
}

/// A world of patches along a line: the nearer, the greater their form factors; no row of F exceeds 1.
struct World {
    area: Vec<f32>,
    albedo: Vec<Vec3>,
    /// Row-major F.
    factors: Vec<Vec<f32>>,
}

impl World {
    fn new(n: usize) -> Self {
        let area: Vec<f32> = (0..n).map(|i| 0.2 + 3.0 * random(i, 0, 1)).collect();
        let s = |i: usize, j: usize| {
            let x = i.abs_diff(j) as f32 / n as f32;
            let noise = 0.5 + random(i.min(j), i.max(j), 2);
            // A tenth of the patches, which are not flat, see themselves.
            if i == j {
                if i.is_multiple_of(10) { area[i] } else { 0.0 }
            } else {
                area[i] * area[j] / (0.002 + x * x) * noise
            }
        };
        let sums: Vec<f32> = (0..n).map(|i| (0..n).map(|j| s(i, j)).sum::<f32>() / area[i]).collect();
        let most = sums.iter().copied().fold(0.0, f32::max);
        let factors = (0..n).map(|i| (0..n).map(|j| s(i, j) / (area[i] * most)).collect()).collect();
        let albedo =
            |i: usize| Vec3::from_array([0, 1, 2].map(|c| if i % 9 == 4 { 0.0 } else { 0.95 * random(i, c, 3) }));
        Self { area, albedo: (0..n).map(albedo).collect(), factors }
    }

    fn row(&self, i: u32) -> Vec<(u32, f32)> {
        self.factors[i as usize].iter().zip(0..).filter(|(f, _)| **f > 0.0).map(|(f, j)| (j, *f)).collect()
    }

    fn add(&self, matrix: &mut LocalMatrix, patches: &[u32]) -> Result<(), Error> {
        let rows: Vec<Vec<(u32, f32)>> = patches.iter().map(|&i| self.row(i)).collect();
        let entering = patches.iter().zip(&rows).map(|(&patch, factors)| Entering {
            patch,
            area: self.area[patch as usize],
            albedo: self.albedo[patch as usize],
            factors,
        });
        matrix.add(&entering.collect::<Vec<_>>())
    }

    /// `T = F (I − diag(ρ) F)⁻¹` of some patches in double precision.
    fn solve(&self, patches: &[u32], channel: usize) -> Mat<f64> {
        let n = patches.len();
        let f = |i: usize, j: usize| f64::from(self.factors[patches[i] as usize][patches[j] as usize]);
        let rho = |i: usize| f64::from(self.albedo[patches[i] as usize][channel]);
        // Transposed, for a solve from the left: T (I − R) = F.
        let system = Mat::from_fn(n, n, |i, j| f64::from(u8::from(i == j)) - rho(j) * f(j, i));
        system.partial_piv_lu().solve(Mat::from_fn(n, n, |i, j| f(j, i))).transpose().to_owned()
    }

    /// Relative error of the operator between these patches, which with its ghosts are all that the matrix holds.
    fn error(&self, matrix: &LocalMatrix, all: &[u32], patches: &[u32]) -> f64 {
        let m = matrix.slots();
        let mut worst = 0.0f64;
        for channel in 0..3 {
            let exact = self.solve(all, channel);
            let mut off = 0.0;
            let mut norm = 0.0;
            for &i in patches {
                for &j in patches {
                    let a = matrix.slot(i).unwrap() as usize;
                    let b = matrix.slot(j).unwrap() as usize;
                    let found =
                        matrix.state()[channel * m * m + a * m + b] * matrix.sqrt_area()[b] / matrix.sqrt_area()[a];
                    let place = |patch| all.iter().position(|&k| k == patch).unwrap();
                    let expected = exact[(place(i), place(j))];
                    off += (f64::from(found) - expected).powi(2);
                    norm += expected * expected;
                }
            }
            worst = worst.max((off / norm).sqrt());
        }
        worst
    }
}

fn pick(step: usize, salt: u32, below: usize) -> usize {
    (random(step, 7, salt) * below as f32) as usize
}

#[test]
fn patches_that_enter_one_by_one_or_together_give_the_fresh_solve() {
    let world = World::new(60);
    let all: Vec<u32> = (0..60).map(|k| k * 7 % 60).collect();
    let mut single = LocalMatrix::new(64).unwrap();
    all.iter().for_each(|&patch| world.add(&mut single, &[patch]).unwrap());
    let mut together = LocalMatrix::new(64).unwrap();
    world.add(&mut together, &all).unwrap();
    let mut batches = LocalMatrix::new(64).unwrap();
    all.chunks(11).for_each(|some| world.add(&mut batches, some).unwrap());
    for (name, matrix) in [("single", &single), ("together", &together), ("batches", &batches)] {
        let error = world.error(matrix, &all, &all);
        println!("{name}: {error:e}");
        assert!(error < 2e-6, "{name}: {error}");
        assert!(world.error(matrix, &all[..59], &all[..59]) > 1e-3, "a patch too many is noticed");
    }
}

#[test]
fn what_is_removed_leaves_no_light() {
    let world = World::new(50);
    let all: Vec<u32> = (0..50).collect();
    let mut matrix = LocalMatrix::new(50).unwrap();
    world.add(&mut matrix, &all).unwrap();
    let (gone, left) = all.split_at(17);
    matrix.remove(gone).unwrap();
    let error = world.error(&matrix, left, left);
    assert!(error < 5e-6, "{error}");
    assert!(world.error(&matrix, &all, left) > 1e-3, "the light by way of those that left is gone");
    // Others take their slots.
    world.add(&mut matrix, gone).unwrap();
    assert!(world.error(&matrix, &all, &all) < 5e-6);
    matrix.remove(&all).unwrap();
    let most = matrix.state().iter().fold(0.0f32, |m, x| m.max(x.abs()));
    assert_eq!(most, 0.0);
}

/// Random changes: (matrix, patches that are there, patches that are ghosts).
fn wander(world: &World, changes: usize, refresh: usize) -> (LocalMatrix, Vec<u32>, Vec<u32>) {
    let n = world.area.len();
    let mut matrix = LocalMatrix::new(n / 2).unwrap();
    let (mut there, mut ghosts): (Vec<u32>, Vec<u32>) = (Vec::new(), Vec::new());
    for step in 0..changes {
        if there.len() > 4 && random(step, 1, 9) < 0.5 {
            let patch = there.swap_remove(pick(step, 10, there.len()));
            if random(step, 2, 9) < 0.5 {
                matrix.leave(&[patch]).unwrap();
                ghosts.push(patch);
            } else {
                matrix.remove(&[patch]).unwrap();
            }
        } else if there.len() < n / 2 - 3 {
            let others: Vec<u32> = (0..n as u32).filter(|i| !there.contains(i)).collect();
            let patch = others[pick(step, 11, others.len())];
            world.add(&mut matrix, &[patch]).unwrap();
            there.push(patch);
            ghosts.retain(|&g| g != patch);
        }
        // Those that left longest ago gave up their slots.
        let gone = ghosts.len() - matrix.ghosts();
        ghosts.drain(..gone);
        matrix.refresh(refresh);
    }
    (matrix, there, ghosts)
}

#[test]
fn ten_thousand_random_changes_leave_the_fresh_solve() {
    let world = World::new(96);
    let error_of = |refresh| {
        let (matrix, there, ghosts) = wander(&world, 10_000, refresh);
        assert_eq!(there.len(), matrix.patches().count());
        let all = [&there[..], &ghosts].concat();
        let with = world.error(&matrix, &all, &there);
        (with, matrix.work())
    };
    let (refreshed, work) = error_of(1);
    let (drifted, less) = error_of(0);
    println!(
        "error {refreshed:.2e} with a column refreshed a change ({:.2} of the work), {drifted:.2e} without",
        work as f64 / less as f64
    );
    assert!(refreshed <= 1e-4, "{refreshed}");
}

#[test]
fn a_camera_to_and_fro_changes_no_energy() {
    let world = World::new(120);
    let energy = |matrix: &LocalMatrix, patches: &[u32]| -> f64 {
        let slots: Vec<u32> = patches.iter().map(|&i| matrix.slot(i).unwrap()).collect();
        let mut light = vec![Vec4::ZERO; matrix.slots()];
        let mut irradiance = vec![Vec4::ZERO; matrix.slots()];
        slots.iter().for_each(|&slot| light[slot as usize] = Vec4::ONE);
        matrix.product(&slots, &slots, &light, &mut irradiance).unwrap();
        let of = |(&i, &slot): (&u32, &u32)| {
            f64::from(irradiance[slot as usize].truncate().element_sum() * world.area[i as usize])
        };
        patches.iter().zip(&slots).map(of).sum()
    };
    // A window of 40 patches over the line; ghosts have some slots, not all that they want.
    let run = |updates: usize| {
        let mut matrix = LocalMatrix::new(56).unwrap();
        let first: Vec<u32> = (0..40).collect();
        world.add(&mut matrix, &first).unwrap();
        let before = energy(&matrix, &first);
        let mut at = 0u32;
        let mut step = 1i32;
        let mut done = 40;
        while done < updates || at != 0 {
            let next = at.saturating_add_signed(step);
            let (leaves, enters) = if step > 0 { (at, next + 39) } else { (at + 39, next) };
            matrix.leave(&[leaves]).unwrap();
            world.add(&mut matrix, &[enters]).unwrap();
            matrix.refresh(1);
            at = next;
            done += 2;
            if at == 0 || at == 50 {
                step = -step;
            }
        }
        // The ghosts still pass light on: without them it is the light of the window alone.
        let with_ghosts = energy(&matrix, &first);
        let there: Vec<u32> = matrix.patches().map(|(_, patch)| patch).collect();
        assert_eq!(there.len(), 40);
        let ghosts: Vec<u32> = (0..120).filter(|i| matrix.slot(*i).is_none() && matrix.has_ghost(*i)).collect();
        matrix.remove(&ghosts).unwrap();
        (before, with_ghosts, energy(&matrix, &first))
    };
    let (before, with_ghosts, after) = run(10_000);
    println!("energy {before:.4}, with ghosts {with_ghosts:.4}, after {after:.4}");
    assert!((after / before - 1.0).abs() < 1e-3, "{before} {after}");
    assert!(with_ghosts >= before * 0.999 && with_ghosts < 1.5 * before, "{with_ghosts}");
}

#[test]
fn as_an_operator_it_is_the_product_over_all_slots() {
    let world = World::new(60);
    let mut matrix = LocalMatrix::new(12).unwrap();
    // Numbers that are no slots, one slot free, and one of a patch that has left.
    let there = [41, 7, 58, 20, 33, 50, 11, 29, 46, 3];
    world.add(&mut matrix, &there).unwrap();
    world.add(&mut matrix, &[55]).unwrap();
    matrix.remove(&[55]).unwrap();
    let mut exitance = vec![Vec4::ZERO; 12];
    for &patch in &there {
        exitance[matrix.slot(patch).unwrap() as usize] = Vec4::splat(1.0 + patch as f32);
    }
    let slots: Vec<u32> = there.iter().map(|&patch| matrix.slot(patch).unwrap()).collect();
    let mut by_slots = vec![Vec4::ZERO; 12];
    let mut found = vec![Vec4::NAN; 12];
    matrix.product(&slots, &slots, &exitance, &mut by_slots).unwrap();
    matrix.apply(&exitance, &mut found).unwrap();
    assert_eq!(found, by_slots);
    let exact = world.solve(&there, 0);
    for (row, &patch) in there.iter().enumerate() {
        let expected: f64 = (0..there.len()).map(|j| exact[(row, j)] * (1.0 + f64::from(there[j]))).sum();
        let h = f64::from(found[matrix.slot(patch).unwrap() as usize].x);
        assert!((h - expected).abs() < 1e-4 * expected.abs(), "{patch}: {h}, not {expected}");
    }
}

#[test]
fn a_ghost_that_comes_back_is_no_work() {
    let world = World::new(20);
    let mut matrix = LocalMatrix::new(20).unwrap();
    world.add(&mut matrix, &(0..12).collect::<Vec<_>>()).unwrap();
    let state = matrix.state().to_vec();
    let work = matrix.work();
    matrix.leave(&[3, 5]).unwrap();
    assert_eq!((matrix.ghosts(), matrix.slot(3)), (2, None));
    world.add(&mut matrix, &[5, 3]).unwrap();
    assert_eq!((matrix.work(), matrix.ghosts()), (work, 0));
    assert_eq!(matrix.state(), state);
    // With another reflectance it is another patch.
    matrix.leave(&[3]).unwrap();
    let row = world.row(3);
    let entering = Entering { patch: 3, area: world.area[3], albedo: Vec3::splat(0.9), factors: &row };
    matrix.add(&[entering]).unwrap();
    assert!(matrix.work() > work && matrix.state() != state);
    let mut brighter = World::new(20);
    brighter.albedo[3] = Vec3::splat(0.9);
    let all: Vec<u32> = (0..12).collect();
    assert!(brighter.error(&matrix, &all, &all) < 2e-6);
}

#[test]
fn products_take_lit_and_visible_slots_only() {
    let world = World::new(30);
    let mut matrix = LocalMatrix::new(32).unwrap();
    let all: Vec<u32> = (0..30).collect();
    world.add(&mut matrix, &all).unwrap();
    let exact = [0, 1, 2].map(|c| world.solve(&all, c));
    let (visible, lit): (Vec<u32>, Vec<u32>) = ((0..30).step_by(3).collect(), (4..11).collect());
    let exitance: Vec<Vec4> =
        (0..32).map(|i| Vec4::new(random(i, 1, 4), random(i, 2, 4), random(i, 3, 4), 9.0)).collect();
    let mut irradiance = vec![Vec4::splat(-1.0); 32];
    matrix.product(&visible, &lit, &exitance, &mut irradiance).unwrap();
    for i in 0..30u32 {
        let found = irradiance[i as usize];
        if !visible.contains(&i) {
            assert_eq!(found, Vec4::splat(-1.0));
            continue;
        }
        let h = |c: usize| {
            lit.iter().map(|&j| exact[c][(i as usize, j as usize)] * f64::from(exitance[j as usize][c])).sum::<f64>()
        };
        let expected = Vec3::new(h(0) as f32, h(1) as f32, h(2) as f32);
        assert!((found.truncate() - expected).abs().max_element() < 1e-5, "{found} {expected}");
        assert_eq!(found.w, 0.0);
    }
    assert!(matches!(matrix.product(&[32], &lit, &exitance, &mut irradiance), Err(Error::NoSlot { slot: 32, .. })));
    assert!(matches!(
        matrix.product(&visible, &lit, &exitance[1..], &mut irradiance),
        Err(Error::Shared(transport::Error::Length { .. }))
    ));
}

#[test]
fn a_closed_room_is_as_bright_as_it_must_be() {
    // White furnace: with equal emission and reflectance everywhere H = M / (1 − ρ).
    let mut world = World::new(40);
    for i in 0..40 {
        let sum: f32 = world.factors[i].iter().sum();
        // What is missing in the row sees itself: the room is closed.
        world.factors[i][i] += 1.0 - sum;
    }
    world.albedo = vec![Vec3::new(0.5, 0.8, 0.0); 40];
    let all: Vec<u32> = (0..40).collect();
    let mut matrix = LocalMatrix::new(40).unwrap();
    world.add(&mut matrix, &all).unwrap();
    let slots: Vec<u32> = (0..40).collect();
    let mut irradiance = vec![Vec4::ZERO; 40];
    matrix.product(&slots, &slots, &[Vec4::ONE; 40], &mut irradiance).unwrap();
    for h in irradiance {
        assert!((h.truncate() - Vec3::new(2.0, 5.0, 1.0)).abs().max_element() < 1e-3, "{h}");
    }
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let world = World::new(96);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| wander(&world, 200, 2).0.state().to_vec())
    };
    assert!(run(1) == run(2));
}

#[test]
fn bad_patches_are_refused_and_change_nothing() {
    let world = World::new(10);
    let mut matrix = LocalMatrix::new(6).unwrap();
    world.add(&mut matrix, &[0, 1, 2, 3]).unwrap();
    let before = matrix.state().to_vec();
    let one = Entering { patch: 7, area: 1.0, albedo: Vec3::splat(0.5), factors: &[(1, 0.1)] };
    let refused = |matrix: &mut LocalMatrix, entering: &[Entering]| matrix.add(entering).unwrap_err();
    assert!(matches!(refused(&mut matrix, &[one, one]), Error::AlreadyThere { patch: 7 }));
    assert!(matches!(refused(&mut matrix, &[Entering { patch: 2, ..one }]), Error::AlreadyThere { patch: 2 }));
    for area in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(matches!(refused(&mut matrix, &[Entering { area, ..one }]), Error::Value { name: "area", .. }));
    }
    for rho in [1.0, -0.1, f32::NAN] {
        let albedo = Vec3::new(0.1, rho, 0.1);
        assert!(matches!(refused(&mut matrix, &[Entering { albedo, ..one }]), Error::Value { name: "albedo", .. }));
    }
    for f in [-0.1, f32::NAN] {
        let factors = &[(1, f)];
        let error = refused(&mut matrix, &[Entering { factors, ..one }]);
        assert!(matches!(error, Error::Value { name: "form factor", .. }), "{error}");
    }
    let factors = &[(7, 3.0)];
    assert_eq!(refused(&mut matrix, &[Entering { factors, ..one }]), Error::Singular { patch: 7 });
    let three: Vec<Entering> = (7..10).map(|patch| Entering { patch, ..one }).collect();
    assert!(matches!(refused(&mut matrix, &three), Error::Full { needed: 3, free: 2, slots: 6 }));
    assert_eq!(matrix.leave(&[0, 9]), Err(Error::NotThere { patch: 9 }));
    assert_eq!(matrix.remove(&[9]), Err(Error::NotThere { patch: 9 }));
    assert_eq!(matrix.state(), before);
    assert_eq!(matrix.patches().count(), 4);
    for slots in [0, 40_000] {
        assert!(matches!(LocalMatrix::new(slots), Err(Error::Shared(transport::Error::Setting { name: "slots", .. }))));
    }
    // An empty matrix.
    let mut empty = LocalMatrix::new(3).unwrap();
    assert_eq!(empty.refresh(5), 0.0);
    empty.add(&[]).unwrap();
}
