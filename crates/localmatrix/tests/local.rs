//! The matrix that goes with a camera through a world, against solves of what it should hold.

use glam::{Vec3, Vec4};
use patchlight_localmatrix::kernel::fade;
use patchlight_localmatrix::{Error, FadeParams, Local, LocalSettings, NO_NODE, Node, Surface, Table, View, World};
use scene::kernel::shade::encode_srgb;
use scene::sampling::{hash3, unit};
use transport::Csr;

/// Square sparse rows.
fn csr(row_start: Vec<u32>, column_index: Vec<u32>, values: Vec<f32>) -> Csr {
    let rows = row_start.len() - 1;
    Csr { rows, columns: rows, row_start, column_index, values }
}

fn random(a: usize, b: usize, c: u32) -> f32 {
    unit(hash3(a as u32, b as u32, c))
}

/// Patches along a line of 100 m; the nearer, the greater their form factors. Each sees itself where the others cover
/// only a part of its hemisphere.
struct Line {
    surfaces: Vec<Surface>,
    /// Row-major F, reciprocal by the areas.
    factors: Vec<Vec<f32>>,
}

impl Line {
    fn new(n: usize, closed: bool, albedo: impl Fn(usize) -> Vec3) -> Self {
        let surface = |i: usize| Surface {
            centre: Vec3::new(100.0 * i as f32 / n as f32, random(i, 1, 5), 0.0),
            normal: Vec3::Z,
            area: 0.2 + 3.0 * random(i, 0, 1),
            albedo: albedo(i),
        };
        let surfaces: Vec<Surface> = (0..n).map(surface).collect();
        let s = |i: usize, j: usize| {
            let x = i.abs_diff(j) as f32 / n as f32;
            let noise = 0.5 + random(i.min(j), i.max(j), 2);
            if i == j { 0.0 } else { surfaces[i].area * surfaces[j].area / (0.002 + x * x) * noise }
        };
        let sums: Vec<f32> = (0..n).map(|i| (0..n).map(|j| s(i, j)).sum::<f32>() / surfaces[i].area).collect();
        let most = sums.iter().copied().fold(0.0, f32::max);
        let mut factors: Vec<Vec<f32>> =
            (0..n).map(|i| (0..n).map(|j| s(i, j) / (surfaces[i].area * most)).collect()).collect();
        if closed {
            (0..n).for_each(|i| factors[i][i] = 1.0 - sums[i] / most);
        }
        Self { surfaces, factors }
    }

    fn table(&self) -> Table {
        let n = self.surfaces.len();
        let row_start = (0..=n).map(|i| (i * n) as u32).collect();
        let columns = (0..n * n).map(|k| (k % n) as u32).collect();
        Table::new(&self.surfaces, csr(row_start, columns, self.factors.concat())).unwrap()
    }

    /// Relative error of the matrix against `T = F (I − diag(ρ) F)⁻¹` between the nodes of a cut, made anew in double
    /// precision, the worst of the channels.
    fn error(&self, local: &Local, table: &Table, cut: &[u32]) -> f64 {
        let n = cut.len();
        let members: Vec<Vec<usize>> = cut
            .iter()
            .map(|&node| {
                let run = local.forest().run(node);
                (run[0]..run[1]).map(|leaf| table.order()[leaf as usize] as usize).collect()
            })
            .collect();
        let area = |a: usize| -> f64 { members[a].iter().map(|&i| f64::from(self.surfaces[i].area)).sum() };
        let area_factor = |a: usize, b: usize| -> f64 {
            let from = |&i: &usize| -> f64 {
                let to: f64 = members[b].iter().map(|&j| f64::from(self.factors[i][j])).sum();
                f64::from(self.surfaces[i].area) * to
            };
            members[a].iter().map(from).sum()
        };
        let f: Vec<Vec<f64>> = (0..n).map(|a| (0..n).map(|b| area_factor(a, b) / area(a)).collect()).collect();
        let m = local.matrix().slots();
        let mut worst = 0.0f64;
        for c in 0..3 {
            let rho = |a: usize| f64::from(table.nodes()[cut[a] as usize].albedo[c]);
            // (I − F diag(ρ)) T = F: the same operator.
            let system = (0..n).map(|a| (0..n).map(|b| f64::from(u8::from(a == b)) - f[a][b] * rho(b)).collect());
            let exact = solve(system.collect(), f.clone());
            let mut off = 0.0;
            let mut norm = 0.0;
            for (a, row) in exact.iter().enumerate() {
                for (b, exact) in row.iter().enumerate() {
                    let slot = |k: usize| local.matrix().slot(cut[k]).map(|slot| slot as usize);
                    let found = match (slot(a), slot(b)) {
                        (Some(a), Some(b)) => {
                            let sqrt_area = local.matrix().sqrt_area();
                            f64::from(local.matrix().state()[c * m * m + a * m + b] * sqrt_area[b] / sqrt_area[a])
                        }
                        _ => 0.0,
                    };
                    off += (found - exact).powi(2);
                    norm += exact.powi(2);
                }
            }
            worst = worst.max((off / norm).sqrt());
        }
        worst
    }
}

/// `A X = B` by elimination.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let n = a.len();
    for k in 0..n {
        let pivot = (k..n).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs())).unwrap();
        a.swap(k, pivot);
        b.swap(k, pivot);
        for i in 0..n {
            if i != k && a[i][k] != 0.0 {
                let factor = a[i][k] / a[k][k];
                let row_a = a[k].clone();
                let row_b = b[k].clone();
                a[i].iter_mut().zip(row_a).for_each(|(x, y)| *x -= factor * y);
                b[i].iter_mut().zip(row_b).for_each(|(x, y)| *x -= factor * y);
            }
        }
    }
    (0..n).for_each(|k| b[k].iter_mut().for_each(|x| *x /= a[k][k]));
    b
}

fn colored(i: usize) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|c| if i % 9 == 4 { 0.0 } else { 0.9 * random(i, c, 3) }))
}

fn settings(slots: usize) -> LocalSettings {
    LocalSettings { slots, changes: 12, ..LocalSettings::default() }
}

fn view(x: f32) -> View {
    View { eye: Vec3::X * x, predicted: Vec3::X * (x + 2.0) }
}

fn settled(table: &mut Table, settings: LocalSettings, x: f32) -> Local {
    let mut local = Local::new(table.nodes(), settings).unwrap();
    local.settle(table, view(x), &|_| true).unwrap();
    local
}

fn light(n: usize) -> Vec<Vec4> {
    (0..n).map(|i| Vec4::new(random(i, 1, 4), random(i, 2, 4), random(i, 3, 4), 0.0)).collect()
}

/// Leaves of a cut, each once and all of them.
fn covered(local: &Local) -> bool {
    let runs: Vec<[u32; 2]> = local.cut().iter().map(|&node| local.forest().run(node)).collect();
    let ends = runs.first().is_some_and(|run| run[0] == 0)
        && runs.last().is_some_and(|run| run[1] as usize == local.forest().leaves().len());
    ends && runs.windows(2).all(|two| two[0][1] == two[1][0])
}

#[test]
fn ten_thousand_changes_on_a_random_walk_leave_the_fresh_solve() {
    let line = Line::new(256, false, colored);
    let mut table = line.table();
    let mut walk = || {
        let mut local = settled(&mut table, settings(64), 50.0);
        let mut x = 50.0f32;
        let mut goal = 10.0f32;
        let mut changes = 0;
        let mut step = 0;
        let mut worst = 0.0f32;
        while changes < 10_000 {
            if (x - goal).abs() < 1.0 {
                goal = 100.0 * random(step, 0, 8);
            }
            x += (goal - x).clamp(-1.0, 1.0);
            let done = local.step(&mut table, view(x)).unwrap();
            assert!(done.entered + done.left <= 12 && done.lost.is_empty(), "{done:?}");
            assert!(local.cut().len() <= 64 && covered(&local));
            worst = worst.max(done.residual.unwrap_or(0.0));
            changes += done.entered + done.left;
            step += 1;
        }
        let error = line.error(&local, &table, local.cut());
        println!("{changes} changes in {step} steps, error {error:.1e}, greatest residual {worst:.1e}");
        (local, error)
    };
    let (local, error) = walk();
    assert!(error <= 1e-4, "{error}");
    // Another cut is another matrix.
    let mut other = local.cut().to_vec();
    let at = other.iter().position(|&node| table.nodes()[node as usize].children > 0).unwrap();
    let Node { first_child, .. } = table.nodes()[other[at] as usize];
    other.splice(at..=at, [first_child, first_child + 1]);
    assert!(line.error(&local, &table, &other) > 1e-3);
}

/// A world from a disk whose speed is anyone's guess: a row that is asked for is there only now and then.
struct Late<'a> {
    table: &'a mut Table,
    seed: u32,
    asked: usize,
}

impl World for Late<'_> {
    fn nodes(&self) -> &[Node] {
        self.table.nodes()
    }

    fn want(&mut self, nodes: &[u32]) {
        self.table.want(nodes);
    }

    fn row(&mut self, node: u32) -> Result<Option<Vec<(u32, f32)>>, Error> {
        self.asked += 1;
        if random(self.asked, node as usize, self.seed) < 0.7 { Ok(None) } else { self.table.row(node) }
    }
}

#[test]
fn rows_that_come_late_and_in_any_order_settle_to_the_same_bits() {
    let line = Line::new(256, false, colored);
    let mut table = line.table();
    let mut at_once = settled(&mut table, settings(64), 50.0);
    for seed in 0..4 {
        let mut late = Late { table: &mut table, seed, asked: 0 };
        let mut local = Local::new(late.nodes(), settings(64)).unwrap();
        local.settle(&mut late, view(50.0), &|_| true).unwrap();
        assert!(local.cut() == at_once.cut() && local.matrix().state() == at_once.matrix().state(), "seed {seed}");
    }
    // A step that does not wait depends on what has come.
    let mut late = Late { table: &mut table, seed: 0, asked: 0 };
    let mut local = Local::new(late.nodes(), settings(64)).unwrap();
    (0..40).for_each(|_| drop(local.step(&mut late, view(50.0)).unwrap()));
    at_once.step(&mut table, view(50.0)).unwrap();
    assert!(local.matrix().state() != at_once.matrix().state());
}

#[test]
fn to_and_fro_changes_no_energy() {
    let line = Line::new(200, false, colored);
    let mut table = line.table();
    // Without hysteresis the nodes depend on the place alone.
    let mut local = settled(&mut table, LocalSettings { hysteresis: 0.0, ..settings(48) }, 5.0);
    let e = light(200);
    let energy = |local: &Local| -> f64 {
        let mut h = vec![Vec4::ZERO; 200];
        local.product(&e, &mut h, |_| true).unwrap();
        h.iter().zip(local.leaf_area()).map(|(h, a)| f64::from(h.truncate().element_sum() * a)).sum()
    };
    let before = energy(&local);
    let cut = local.cut().to_vec();
    let mut changes = 0;
    let mut times = 0;
    let mut differ = 0.0f64;
    while changes < 10_000 {
        for x in (5..95).chain((5..=95).rev()) {
            let done = local.step(&mut table, view(x as f32)).unwrap();
            changes += done.entered + done.left;
            differ = differ.max((energy(&local) / before - 1.0).abs());
        }
        times += 1;
    }
    local.settle(&mut table, view(5.0), &|_| true).unwrap();
    let after = energy(&local);
    println!("{changes} changes, {times} times: {before:.5} {after:.5}; on the path off by {differ:.2e}");
    assert_eq!(local.cut(), cut);
    assert!((after / before - 1.0).abs() < 1e-3);
    assert!(differ > 1e-5, "the cut did change the light on the path");
}

#[test]
fn a_furnace_is_even_under_every_cut() {
    let line = Line::new(150, true, |_| Vec3::new(0.5, 0.8, 0.0));
    let mut table = line.table();
    let mut local = settled(&mut table, settings(40), 0.0);
    for x in 0..100 {
        local.step(&mut table, view(x as f32)).unwrap();
        let mut h = vec![Vec4::ZERO; 150];
        local.product(&[Vec4::ONE; 150], &mut h, |_| true).unwrap();
        for h in h {
            assert!((h.truncate() - Vec3::new(2.0, 5.0, 1.0)).abs().max_element() < 2e-3, "{x}: {h}");
        }
    }
}

#[test]
fn more_slots_are_less_error() {
    let line = Line::new(256, false, colored);
    let mut table = line.table();
    let e = light(256);
    let mut solve_with = |slots: usize| {
        let local = settled(&mut table, settings(slots), 30.0);
        let mut h = vec![Vec4::ZERO; 256];
        local.product(&e, &mut h, |_| true).unwrap();
        h
    };
    let full = solve_with(256);
    let near: Vec<usize> = {
        let order = line.table().order().to_vec();
        (0..256).filter(|&k| (line.surfaces[order[k] as usize].centre.x - 31.0).abs() < 8.0).collect()
    };
    let errors: Vec<f32> = [4, 16, 64, 128, 255]
        .map(|slots| {
            let h = solve_with(slots);
            let mut off = 0.0;
            let mut norm = 0.0;
            for &i in &near {
                off += (h[i] - full[i]).length_squared();
                norm += full[i].length_squared();
            }
            (off / norm).sqrt()
        })
        .to_vec();
    println!("{errors:?}");
    assert!(errors.windows(2).all(|two| two[1] < two[0]), "{errors:?}");
    assert!(errors[0] > 0.02 && errors[3] < 0.3 * errors[1], "{errors:?}");
    // All patches: full radiosity itself.
    let local = settled(&mut table, settings(256), 30.0);
    assert!(line.error(&local, &table, local.cut()) < 5e-6);
}

/// In a sphere all see each other alike, `F_ij = A_j / A`, and rows that only know nodes of a depth say all there is to
/// say.
struct Sphere {
    table: Table,
    coarse: bool,
    whole: f32,
}

impl World for Sphere {
    fn nodes(&self) -> &[Node] {
        self.table.nodes()
    }

    fn want(&mut self, _: &[u32]) {}

    fn row(&mut self, node: u32) -> Result<Option<Vec<(u32, f32)>>, Error> {
        let depth = |node: u32| {
            std::iter::successors(Some(node), |&n| Some(self.nodes()[n as usize].parent).filter(|&p| p != NO_NODE))
                .count()
        };
        let is_column = |&n: &u32| match self.coarse {
            true => depth(n) == 4 + node as usize % 2,
            false => self.nodes()[n as usize].children == 0,
        };
        let columns = (0..self.nodes().len() as u32).filter(is_column);
        Ok(Some(columns.map(|n| (n, self.nodes()[n as usize].area / self.whole)).collect()))
    }
}

#[test]
fn rows_of_any_level_are_shared_out_by_area() {
    let n = 128;
    let line = Line::new(n, false, colored);
    let whole: f32 = line.surfaces.iter().map(|s| s.area).sum();
    let e = light(n);
    for coarse in [false, true] {
        let mut world = Sphere { table: line.table(), coarse, whole };
        let mut local = Local::new(world.nodes(), settings(40)).unwrap();
        local.settle(&mut world, view(20.0), &|_| true).unwrap();
        for x in 20..60 {
            local.step(&mut world, view(x as f32)).unwrap();
        }
        let order = world.table.order();
        let mean =
            |of: &dyn Fn(usize) -> Vec3| -> Vec3 { (0..n).map(|k| of(k) * local.leaf_area()[k]).sum::<Vec3>() / whole };
        // H = mean of B, B = E + ρ H: nothing is lost by merging.
        let sent = mean(&|k| e[k].truncate());
        let expected = sent / (Vec3::ONE - mean(&|k| line.surfaces[order[k] as usize].albedo));
        let mut h = vec![Vec4::ZERO; n];
        local.product(&e, &mut h, |_| true).unwrap();
        let worst = h.iter().map(|h| ((h.truncate() - expected) / expected).abs().max_element()).fold(0.0, f32::max);
        println!("coarse {coarse}: {worst:e}");
        assert!(worst < 1e-4, "{coarse}: {worst}");
        assert!(((sent - expected) / expected).abs().max_element() > 0.1, "bounces count");
    }
}

/// A world whose rows come some steps after they are asked for, and some never.
struct Slow {
    table: Table,
    delay: usize,
    asked: std::collections::HashMap<u32, usize>,
    lost: Vec<u32>,
}

impl World for Slow {
    fn nodes(&self) -> &[Node] {
        self.table.nodes()
    }

    fn want(&mut self, nodes: &[u32]) {
        self.asked.retain(|node, left| *left == 0 || nodes.contains(node));
        for &node in nodes {
            let left = self.asked.entry(node).or_insert(self.delay + 1);
            *left = left.saturating_sub(1);
        }
    }

    fn row(&mut self, node: u32) -> Result<Option<Vec<(u32, f32)>>, Error> {
        if self.lost.contains(&node) {
            return Err(Error::Node { node, reason: "its block is damaged" });
        }
        if self.asked.get(&node) == Some(&0) { self.table.row(node) } else { Ok(None) }
    }
}

#[test]
fn what_is_not_there_yet_stays_coarser_and_nothing_waits() {
    let line = Line::new(200, false, colored);
    let table = line.table();
    let lost = vec![table.node_of()[40], table.node_of()[41]];
    let mut world = Slow { table, delay: 5, asked: Default::default(), lost: lost.clone() };
    let mut local = Local::new(world.nodes(), settings(48)).unwrap();
    let mut waited = 0;
    let mut named = Vec::new();
    let mut sizes = Vec::new();
    for step in 0..400 {
        let x = (step / 3).min(42) as f32;
        let done = local.step(&mut world, view(x * 0.5)).unwrap();
        waited += usize::from(done.waiting > 0 && done.entered == 0);
        named.extend(done.lost);
        sizes.push(local.cut().len());
        assert!(local.cut().is_empty() || covered(&local), "{step}");
    }
    println!("{waited} steps had nothing but rows to wait for; {:?}; {named:?}", &sizes[..20]);
    assert!(sizes[0] == 0 && waited > 5 && *sizes.last().unwrap() > 40);
    assert!(
        !named.is_empty() && named.iter().all(|error| matches!(error, Error::Node { node, .. } if lost.contains(node)))
    );
    assert!(lost.iter().all(|&node| local.matrix().slot(node).is_none()));
    // What is there is exact nevertheless.
    assert!(line.error(&local, &world.table, local.cut()) < 1e-5);
}

#[test]
fn jumps_of_the_light_fade_and_end_where_they_should() {
    let line = Line::new(200, false, colored);
    let e = light(200);
    let run = |fade: u32| {
        let mut table = line.table();
        let mut local = settled(&mut table, LocalSettings { fade, ..settings(32) }, 5.0);
        let mut before = Vec::new();
        let mut most = 0.0f32;
        for step in 0..300 {
            let x = (5.0 + 0.5 * step as f32).min(90.0);
            let mut h = vec![Vec4::ZERO; 200];
            local.frame(&mut table, view(x), &e, &mut h, |_| true).unwrap();
            if step > 0 {
                let change = |(a, b): (&Vec4, &Vec4)| (*a - *b).abs().max_element();
                most = h.iter().zip(&before).map(change).fold(most, f32::max);
            }
            before = h;
        }
        let mut still = vec![Vec4::ZERO; 200];
        local.product(&e, &mut still, |_| true).unwrap();
        let rest = still.iter().zip(&before).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max);
        (most, rest)
    };
    let ((abrupt, none), (smooth, rest)) = (run(1), run(16));
    println!("greatest change from frame to frame {abrupt} at once, {smooth} over 16 frames; {rest:e} is left");
    assert!(none < 1e-6 && rest < 1e-3, "{none} {rest}");
    assert!(smooth < 0.3 * abrupt, "{smooth} {abrupt}");
}

/// Greatest change of a displayed value, in 255ths, while light goes from one value to another one, shares of display
/// white; frames that it takes, and where it ends.
fn fading(from: f32, to: f32, display_white: f32) -> (f32, usize, f32) {
    let shown = |h: f32| 255.0 * encode_srgb(h.clamp(0.0, 1.0));
    let jump = FadeParams { count: 1, keep: 1.0 - 1.0 / 16.0, has_jump: 1, display_white };
    let mut offset = Vec4::ZERO;
    let mut last = from;
    let mut most = 0.0f32;
    for frame in 0..1000 {
        let p = FadeParams { has_jump: u32::from(frame == 0), ..jump };
        offset = fade(offset, Vec4::splat(from), Vec4::splat(to), &p);
        let now = to + offset.x;
        most = most.max((shown(now) - shown(last)).abs());
        last = now;
        if (shown(now) - shown(to)).abs() < 0.1 {
            return (most, frame, now);
        }
    }
    (most, usize::MAX, last)
}

#[test]
fn no_displayed_value_changes_by_more_than_two_255ths_a_frame() {
    let levels = [0.0, 0.001, 0.003, 0.01, 0.1, 0.5, 0.97, 1.0, 3.0, 40.0];
    let mut worst = 0.0f32;
    let mut slowest = 0;
    let mut unlimited = 0.0f32;
    for &from in &levels {
        for &to in &levels {
            let (most, frames, end) = fading(from, to, 1.0);
            assert!(frames < 400, "{from} to {to}: {end} after {frames} frames");
            worst = worst.max(most);
            slowest = slowest.max(frames);
            unlimited = unlimited.max(fading(from, to, f32::INFINITY).0);
        }
    }
    println!("{worst} of 255 a frame at most, {slowest} frames; {unlimited} without a display white");
    assert!(worst <= 2.0 && worst > 1.0, "{worst}");
    assert!(unlimited > 20.0, "{unlimited}");
}

/// Pairs of floor patches merged first that differ in what they see, of how many: every other patch of a floor sees a
/// ceiling by `factor`, the ones between by `others`.
fn unlike_pairs(factor: f32, others: f32) -> (usize, usize) {
    let n = 32;
    let surface = |i: usize| {
        let x = 0.1 * (i % n) as f32;
        let z = (i / n) as f32;
        Surface {
            centre: Vec3::new(x, 0.0, z),
            normal: Vec3::Z * (1.0 - 2.0 * z),
            area: 0.01,
            albedo: Vec3::splat(0.5),
        }
    };
    let surfaces: Vec<Surface> = (0..2 * n).map(surface).collect();
    let by = |i: usize| if i.is_multiple_of(2) { factor } else { others } / n as f32;
    let mut starts = vec![0];
    let mut columns = Vec::new();
    let mut values = Vec::new();
    for i in 0..2 * n {
        for j in if i < n { n..2 * n } else { 0..n } {
            columns.push(j as u32);
            values.push(by(if i < n { i } else { j }));
        }
        starts.push(columns.len() as u32);
    }
    let table = Table::new(&surfaces, csr(starts, columns, values)).unwrap();
    let parent = |i: usize| table.nodes()[table.node_of()[i] as usize].parent;
    let pairs: Vec<(usize, usize)> =
        (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).filter(|&(i, j)| parent(i) == parent(j)).collect();
    (pairs.iter().filter(|(i, j)| (i + j) % 2 == 1).count(), pairs.len())
}

#[test]
fn what_sees_unlike_things_is_merged_separately() {
    let ((unlike, pairs), (mixed, _)) = (unlike_pairs(0.9, 0.1), unlike_pairs(0.5, 0.5));
    println!("{unlike} and {mixed} of {pairs} pairs are unlike");
    assert!(pairs > 8 && unlike == 0, "{unlike} of {pairs}");
    assert!(mixed > 8, "{mixed}");
}

#[test]
fn roots_without_room_leave_as_ghosts_and_come_back() {
    // Forty roots, sixteen slots.
    let line = Line::new(40, false, colored);
    let flat = |table: &Table| -> (Vec<Node>, Vec<u32>) {
        let leaf = |&node: &u32| Node { parent: NO_NODE, ..table.nodes()[node as usize] };
        (table.node_of().iter().map(leaf).collect(), table.node_of().to_vec())
    };
    struct Flat(Vec<Node>, Vec<Vec<f32>>);
    impl World for Flat {
        fn nodes(&self) -> &[Node] {
            &self.0
        }
        fn want(&mut self, _: &[u32]) {}
        fn row(&mut self, node: u32) -> Result<Option<Vec<(u32, f32)>>, Error> {
            Ok(Some((0..).zip(self.1[node as usize].iter().copied()).collect()))
        }
    }
    let mut world = Flat(flat(&line.table()).0, line.factors.clone());
    let mut local =
        Local::new(world.nodes(), LocalSettings { slots: 16, changes: 4, hysteresis: 0.0, ..Default::default() })
            .unwrap();
    local.settle(&mut world, view(0.0), &|_| true).unwrap();
    assert_eq!(local.cut().len(), 16);
    let first = local.cut().to_vec();
    for x in 0..60 {
        local.step(&mut world, view(x as f32)).unwrap();
        assert!(local.cut().len() <= 16);
    }
    assert_ne!(local.cut(), first);
    local.settle(&mut world, view(0.0), &|_| true).unwrap();
    assert_eq!(local.cut(), first);
}

#[test]
fn the_same_walk_has_the_same_bytes() {
    let line = Line::new(120, false, colored);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut table = line.table();
            let mut local = settled(&mut table, settings(40), 0.0);
            (0..60).for_each(|x| drop(local.step(&mut table, view(x as f32)).unwrap()));
            (local.cut().to_vec(), local.matrix().state().to_vec())
        })
    };
    assert!(run(1) == run(2));
}

#[test]
fn a_record_of_updates_makes_the_same_matrix() {
    let line = Line::new(100, false, colored);
    let mut table = line.table();
    let mut local = Local::new(table.nodes(), settings(32)).unwrap();
    local.matrix_mut().record();
    let m = 32;
    let mut copy = vec![0.0f32; 3 * m * m];
    for x in 0..40 {
        local.step(&mut table, view(x as f32)).unwrap();
        for update in local.matrix_mut().take_updates() {
            let rank = update.rank as usize;
            for c in 0..3 {
                let vectors = &update.vectors[c * rank * m..(c + 1) * rank * m];
                for i in 0..m {
                    for j in 0..m {
                        let sum: f32 = (0..rank).map(|k| vectors[k * m + i] * vectors[k * m + j]).sum();
                        copy[(c * m + i) * m + j] += update.sign * sum;
                    }
                }
                for (k, &slot) in update.slots.iter().enumerate() {
                    for i in 0..m {
                        let value = update.columns[(c * update.slots.len() + k) * m + i];
                        copy[(c * m + slot as usize) * m + i] = value;
                        copy[(c * m + i) * m + slot as usize] = value;
                    }
                }
            }
        }
        let off = copy.iter().zip(local.matrix().state()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(off < 1e-4, "{x}: {off}");
    }
    assert!(local.matrix().state().iter().any(|x| x.abs() > 0.01));
    assert!(local.matrix_mut().take_updates().is_empty());
}

#[test]
fn nodes_that_are_no_forest_and_settings_out_of_range_are_refused() {
    let table = Line::new(8, false, colored).table();
    let refused = |change: &dyn Fn(&mut Vec<Node>)| {
        let mut nodes = table.nodes().to_vec();
        change(&mut nodes);
        Local::new(&nodes, settings(8)).unwrap_err()
    };
    assert!(matches!(refused(&|n| n[0].first_child = 40), Error::Node { node: 0, .. }));
    assert!(matches!(refused(&|n| n[1].parent = 2), Error::Node { .. }));
    assert!(matches!(refused(&|n| n[3].area = 0.0), Error::Node { node: 3, .. }));
    assert!(matches!(refused(&|n| n[3].albedo.y = 1.0), Error::Node { node: 3, .. }));
    assert!(matches!(refused(&|n| n[5].centre.x = f32::NAN), Error::Node { node: 5, .. }));
    for wrong in [
        LocalSettings { slots: 0, ..settings(8) },
        LocalSettings { changes: 0, ..settings(8) },
        LocalSettings { hysteresis: -1.0, ..settings(8) },
        LocalSettings { fade: 0, ..settings(8) },
        LocalSettings { tolerance: 0.0, ..settings(8) },
    ] {
        assert!(matches!(Local::new(table.nodes(), wrong), Err(Error::Shared(transport::Error::Setting { .. }))));
    }
    assert!(matches!(
        Table::new(&[], csr(vec![0, 0], vec![], vec![])),
        Err(Error::Shared(transport::Error::Length { .. }))
    ));
    // An empty world.
    let mut empty = Table::new(&[], csr(vec![0], vec![], vec![])).unwrap();
    let mut local = Local::new(empty.nodes(), settings(8)).unwrap();
    assert!(local.step(&mut empty, view(0.0)).unwrap().entered == 0);
}
