//! Printed patches: small cases by hand, the equations written down, and what is not like them.

#[path = "../../../crates/patches/tests/support/mod.rs"]
mod support;

use std::ops::Range;

use glam::{DVec3, Vec3, Vec4};
use patches::{
    ClusterSettings, Error, Grid, Lookup, LookupSettings, Member, PatchSet, Sample, SampleSet, SampleSettings,
    cluster_patches, sample_voxels,
};
use printed::{
    Form, PointRows, PrintedSettings, RowsOfPoints, light_at, printed_axis_patches, printed_cluster_patches,
    printed_samples, printed_source,
};
use scene::sampling::{hash3, unit};
use support::{Mesh, atrium, two_rooms};

/// A grid of one voxel.
fn one_voxel() -> Grid {
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::ZERO, Vec3::Z, Vec3::X);
    let grid = Grid::new(&mesh.scene(1.0), Vec3::splat(4.0)).unwrap();
    assert_eq!(grid.len(), 1);
    grid
}

fn set_of(samples: Vec<Sample>) -> SampleSet {
    let offsets = vec![0, samples.len() as u32];
    SampleSet { samples, offsets, report: <_>::default() }
}

fn sample(x: f32, area: f32, normal: Vec3, albedo: f32) -> Sample {
    Sample { position: Vec3::X * x, area, normal, albedo: Vec3::splat(albedo), ..Sample::default() }
}

/// `F_ij = s_j G_ij` with a symmetric G.
fn rows_of(
    samples: &[Sample],
    geometry: impl Fn(usize, usize) -> f32,
) -> impl Fn(Range<usize>) -> Result<PointRows, Error> {
    move |own| {
        let row = |i: usize| samples.iter().enumerate().map(|(j, s)| s.area * geometry(i, j)).collect::<Vec<f32>>();
        Ok(PointRows { factors: own.clone().flat_map(row).collect(), sky: own.map(|i| 0.1 * i as f32).collect() })
    }
}

fn assert_near(found: f32, expected: f64, what: &str) {
    assert!((f64::from(found) - expected).abs() < 1e-6, "{what}: {found}, {expected}");
}

#[test]
fn three_points_by_hand() {
    // The first two are of one colour, the first and the last in one place.
    let samples = vec![sample(0.0, 1.0, Vec3::Y, 0.5), sample(0.9, 2.0, Vec3::Y, 0.5), sample(0.01, 4.0, Vec3::Y, 0.9)];
    let table = [[0.0, 0.1, 0.02], [0.1, 0.0, 0.05], [0.02, 0.05, 0.0]];
    let rows = rows_of(&samples, |i, j| table[i][j]);
    let grid = one_voxel();
    let made = printed_cluster_patches(&grid, set_of(samples.clone()), 2, &rows).unwrap();
    // M(0,1) = 1 · 1 · (1 + √0.1208), M(0,2) and M(1,2) have 1 + 0.69 in front.
    let members = |set: &PatchSet, i: usize| set.members_of(i).iter().map(|m| m.sample).collect::<Vec<_>>();
    assert_eq!((members(&made.set, 0), members(&made.set, 1)), (vec![0, 1], vec![2]));
    for (i, j, expected) in [(0, 1, 0.16), (1, 0, 0.12), (0, 0, 0.4 / 3.0), (1, 1, 0.0)] {
        assert_near(made.factors.row(i)[j], expected, "F");
    }
    assert_near(made.sky[0], (0.0 + 2.0 * 0.1) / 3.0, "sky");
    assert_eq!((made.set.patches[0].area, made.set.patches[0].albedo), (3.0, Vec3::splat(0.5)));
    assert_eq!(made.most_entries, 9);
    // By positions others are merged.
    let ours =
        cluster_patches(&grid, set_of(samples.clone()), &ClusterSettings { max_patches: 2 }, &|_, _| 0.0).unwrap();
    assert_eq!((members(&ours, 0), members(&ours, 1)), (vec![0, 2], vec![1]));
}

#[test]
fn rows_and_columns_decide_where_colours_and_normals_are_alike() {
    let samples: Vec<Sample> = (0..4).map(|_| sample(0.0, 1.0, Vec3::Y, 0.5)).collect();
    // 0 and 3 see the same, and so do 1 and 2.
    let is_outer = |k: usize| k == 0 || k == 3;
    let rows = rows_of(&samples, |i, j| if is_outer(i) == is_outer(j) { 0.0 } else { 0.2 });
    let groups = |rows: &RowsOfPoints| {
        let made = printed_cluster_patches(&one_voxel(), set_of(samples.clone()), 2, rows).unwrap();
        made.set.members.iter().map(|m| m.sample).collect::<Vec<_>>()
    };
    assert_eq!(groups(&rows), [0, 3, 1, 2]);
    // Without the term the first pair is as good as any.
    assert_eq!(groups(&rows_of(&samples, |_, _| 0.0)), [0, 1, 2, 3]);
}

/// (5.2) and the metric, written down with a whole matrix.
struct Slow {
    factors: Vec<Vec<f64>>,
    area: Vec<f64>,
    colour: Vec<DVec3>,
    normal: Vec<DVec3>,
    members: Vec<Vec<u32>>,
}

impl Slow {
    fn new(samples: &[Sample], geometry: &dyn Fn(usize, usize) -> f32) -> Self {
        let row = |i: usize| samples.iter().enumerate().map(|(j, s)| f64::from(s.area * geometry(i, j))).collect();
        Self {
            factors: (0..samples.len()).map(row).collect(),
            area: samples.iter().map(|s| f64::from(s.area)).collect(),
            colour: samples.iter().map(|s| s.albedo.as_dvec3()).collect(),
            normal: samples.iter().map(|s| s.normal.as_dvec3()).collect(),
            members: (0..samples.len() as u32).map(|k| vec![k]).collect(),
        }
    }

    fn metric(&self, i: usize, j: usize) -> f64 {
        let f = &self.factors;
        let sum: f64 = (0..f.len()).map(|k| (f[i][k] - f[j][k]).powi(2) + (f[k][i] - f[k][j]).powi(2)).sum();
        let colours = self.colour[i].distance(self.colour[j]);
        (1.0 + colours) * (2.0 - self.normal[i].dot(self.normal[j])) * (1.0 + sum.sqrt())
    }

    fn merge(&mut self, i: usize, j: usize) {
        let a = self.area[i];
        let b = self.area[j];
        let other = self.factors.remove(j);
        for (x, y) in self.factors[i].iter_mut().zip(other) {
            *x = (a * *x + b * y) / (a + b);
        }
        for row in &mut self.factors {
            row[i] += row[j];
            row.remove(j);
        }
        self.colour[i] = (a * self.colour[i] + b * self.colour[j]) / (a + b);
        self.normal[i] = ((a * self.normal[i] + b * self.normal[j]) / (a + b)).normalize();
        self.area[i] = a + b;
        let gone = self.members.remove(j);
        self.members[i].extend(gone);
        self.members[i].sort();
        self.area.remove(j);
        self.colour.remove(j);
        self.normal.remove(j);
    }

    /// Merges the rows from `first` on, `count` of them, until `most` are left.
    fn merge_until(&mut self, first: usize, count: usize, most: usize) -> usize {
        for left in (most + 1..=count).rev() {
            let pairs = (first..first + left).flat_map(|i| (i + 1..first + left).map(move |j| (i, j)));
            let best = pairs.min_by(|&(a, b), &(c, d)| self.metric(a, b).total_cmp(&self.metric(c, d))).unwrap();
            self.merge(best.0, best.1);
        }
        count.min(most)
    }
}

/// Points in the voxels of two rooms, all a little different.
fn points() -> (Grid, SampleSet) {
    let scene = two_rooms().scene(1.0);
    let settings = PrintedSettings { form: Form::Clusters, count: 0, voxel_size: Some(1.3), seed: 3 };
    let (grid, mut set) = printed_samples(&scene, &settings).unwrap();
    for (k, s) in set.samples.iter_mut().enumerate() {
        s.albedo = Vec3::from_array([0, 1, 2].map(|d| unit(hash3(k as u32, d, 1))));
    }
    (grid, set)
}

fn geometry(i: usize, j: usize) -> f32 {
    if i == j { 0.0 } else { 0.01 * unit(hash3(i.min(j) as u32, i.max(j) as u32, 2)) }
}

#[test]
fn voxel_by_voxel_is_the_whole_matrix() {
    let (grid, set) = points();
    assert!(grid.len() > 8 && set.samples.len() > 100, "{} {}", grid.len(), set.samples.len());
    let fast = printed_cluster_patches(&grid, set.clone(), 3, &rows_of(&set.samples, geometry)).unwrap();
    let mut slow = Slow::new(&set.samples, &geometry);
    let mut first = 0;
    for slot in 0..grid.len() {
        first += slow.merge_until(first, set.range(slot).len(), 3);
    }
    let members: Vec<Vec<u32>> =
        (0..fast.set.len()).map(|i| fast.set.members_of(i).iter().map(|m| m.sample).collect()).collect();
    assert_eq!(members, slow.members);
    let worst = |factors: &transport::Dense| {
        let difference = |i: usize| {
            let pairs = factors.row(i).iter().zip(&slow.factors[i]);
            pairs.map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
        };
        (0..slow.factors.len()).map(difference).fold(0.0, f64::max)
    };
    assert!(worst(&fast.factors) < 1e-6, "{}", worst(&fast.factors));
    let mut wrong = fast.factors.clone();
    wrong.row_mut(5)[7] *= 1.01;
    assert!(worst(&wrong) > 1e-6);
    for (patch, normal) in fast.set.patches.iter().zip(&slow.normal) {
        assert!((patch.normal.as_dvec3() - *normal).length() < 1e-5);
    }
    // One voxel's rows, not all.
    let most = (0..grid.len()).map(|slot| set.range(slot).len()).max().unwrap() * set.samples.len();
    assert_eq!(fast.most_entries, most);
    assert!(most < set.samples.len().pow(2) / 4);
}

#[test]
fn two_points_on_axes_by_hand() {
    let samples = vec![sample(0.0, 2.0, Vec3::new(0.6, 0.8, 0.0), 0.5), sample(1.0, 1.0, Vec3::Y, 1.0)];
    let rows = rows_of(&samples, |i, j| if i == j { 0.0 } else { 0.1 });
    let made = printed_axis_patches(&one_voxel(), set_of(samples.clone()), &rows).unwrap();
    assert_eq!(made.set.len(), 2);
    assert_eq!((made.set.patches[0].normal, made.set.patches[1].normal), (Vec3::X, Vec3::Y));
    assert_near(made.set.patches[0].area, 1.2, "area");
    assert_near(made.set.patches[1].area, 2.6, "area");
    // The weight is in the colour twice.
    assert_near(made.set.patches[0].albedo.x, 0.3, "colour");
    assert_near(made.set.patches[1].albedo.x, (1.6 * 0.8 * 0.5 + 1.0) / 2.6, "colour");
    let expected = [[0.0, 0.06], [0.12 / 2.6, (1.6 * 0.8 * 0.1 + 0.16) / 2.6]];
    for (i, row) in expected.iter().enumerate() {
        row.iter().enumerate().for_each(|(j, &f)| assert_near(made.factors.row(i)[j], f, "F"));
    }
    assert_near(made.sky[1], 0.1 / 2.6, "sky");
}

#[test]
fn first_exitance_is_a_sum_over_the_points_of_the_voxel() {
    let (grid, set) = points();
    let made = printed_cluster_patches(&grid, set.clone(), 4, &rows_of(&set.samples, geometry)).unwrap();
    // What a point receives, found by its place.
    let light = |p: Vec3| Vec3::new(1.0 + p.x, 2.0 + p.y, 0.5);
    let sent: Vec<Vec3> = set.samples.iter().map(|s| s.albedo * light(s.position)).collect();
    let ranges: Vec<Range<usize>> =
        made.set.patches.iter().map(|patch| set.range(grid.slot_of(patch.voxel).unwrap())).collect();
    let source = printed_source(&made.set, &ranges, &sent);
    let expected = |i: usize, norm: bool| {
        let patch = made.set.patches[i];
        let slot = grid.slot_of(patch.voxel).unwrap();
        let own = set.samples[set.range(slot)].iter();
        let weighted = own.map(|s| (s.albedo * light(s.position), patch.normal.dot(s.normal).max(0.0)));
        let (sum, weights) = weighted.fold((Vec3::ZERO, 0.0), |sum, (e, w)| (sum.0 + e * w, sum.1 + w));
        if norm { sum / weights } else { sum }
    };
    let is_like = |norm: bool| {
        (0..source.len()).all(|i| (source[i] - expected(i, norm)).length() < 1e-4 * expected(i, norm).length())
    };
    assert!(is_like(false) && !is_like(true));
}

#[test]
fn light_at_a_point_is_a_sum_over_the_patches_of_the_voxel() {
    // Two voxels: in the first two patches, in the second one that looks down.
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::new(0.0, 0.5, 0.0), Vec3::Z, Vec3::X * 2.0);
    let grid = Grid::new(&mesh.scene(1.0), Vec3::splat(1.1)).unwrap();
    assert_eq!(grid.len(), 2);
    let samples = vec![
        sample(0.4, 1.0, Vec3::Y, 0.5),
        sample(0.4, 1.0, Vec3::new(0.6, 0.8, 0.0), 0.5),
        sample(1.6, 1.0, -Vec3::Y, 0.5),
    ];
    let set = SampleSet { samples, offsets: vec![0, 2, 3], report: <_>::default() };
    let rows = rows_of(&set.samples, |_, _| 0.0);
    let made = printed_cluster_patches(&grid, set.clone(), 4, &rows).unwrap();
    let values = [3.0, 5.0, 7.0].map(Vec4::splat);
    let table = Lookup::new(&grid, &made.set, LookupSettings::default()).unwrap();
    let middle = |x: f32| {
        let place = grid.voxel_box(grid.occupied[0]);
        0.5 * (place.0 + place.1) + Vec3::X * x
    };
    let at = |x: f32, n: Vec3| light_at(&table, &values, middle(x), n).x;
    // 3 · 1 + 5 · 0.8, and the voxel that has nothing for this normal does not count.
    assert_near(at(0.0, Vec3::Y), 7.0, "its own voxel");
    assert_near(at(0.5, Vec3::Y), 7.0, "between");
    assert_near(at(0.0, Vec3::X), 5.0 * f64::from(0.6f32), "sideways");
    // Both count for a normal that the patches of both see.
    let n = Vec3::new(0.8, -0.6, 0.0);
    let own = f64::from(Vec3::new(0.6, 0.8, 0.0).dot(n).max(0.0) * 5.0);
    let other = f64::from(0.6f32) * 7.0;
    let expected = if own > 0.0 { 0.75 * own + 0.25 * other } else { other };
    assert!((f64::from(at(0.275, n)) - expected).abs() < 1e-4, "{} {expected}", at(0.275, n));
    assert_eq!(at(0.0, -Vec3::X), 0.0);
    assert!((table.at(&values, middle(0.0), Vec3::Y).unwrap().x - 7.0).abs() > 1.0, "the mean");
}

#[test]
fn wrong_input_is_refused() {
    let samples = vec![sample(0.0, 1.0, Vec3::Y, 0.5)];
    let short = |_: Range<usize>| Ok(PointRows::default());
    let refused = printed_cluster_patches(&one_voxel(), set_of(samples.clone()), 2, &short).unwrap_err();
    assert!(matches!(refused, Error::Length { name: "rows of points", .. }), "{refused}");
    let none = |_: Range<usize>| Err(Error::NoSamples);
    assert!(matches!(printed_axis_patches(&one_voxel(), set_of(samples), &none), Err(Error::NoSamples)));
}

fn area(set: &SampleSet) -> f64 {
    set.samples.iter().map(|s| f64::from(s.area)).sum()
}

#[test]
fn areas_are_those_of_whole_triangles_over_all_of_their_samples() {
    let mut mesh = Mesh::default();
    mesh.quad(Vec3::new(0.1, 0.2, 0.3), Vec3::new(2.0, 0.3, 0.1), Vec3::new(-0.2, 1.4, 0.7));
    let whole = mesh.area();
    let scene = mesh.scene(1.0);
    let settings = PrintedSettings { form: Form::Axes, count: 0, voxel_size: Some(0.5), seed: 0 };
    let (grid, set) = printed_samples(&scene, &settings).unwrap();
    // Both sides are met, and have the area and the normal of the front together.
    assert!((area(&set) / whole - 1.0).abs() < 1e-4, "{} of {whole}", area(&set));
    for triangle in 0..2 {
        let own: Vec<_> = set.samples.iter().filter(|s| s.triangle == triangle).collect();
        assert!(own.len() > 4 && own.iter().all(|s| s.area == own[0].area));
        assert!(own.iter().all(|s| s.normal == scene.tables().normal(triangle)));
    }
    let all = |_: &Sample| true;
    let ours = sample_voxels(&scene, &grid, &SampleSettings { points: 4, ..<_>::default() }, &all).unwrap();
    assert!((area(&ours) / (2.0 * whole) - 1.0).abs() < 1e-4, "both sides of a sheet");
    // What no ray meets is lost.
    let (_, set) =
        printed_samples(&atrium().scene(1.0), &PrintedSettings { voxel_size: Some(0.8), ..settings }).unwrap();
    assert!(area(&set) < (1.0 - 1e-4) * atrium().area());
}

#[test]
fn light_leaks_through_a_thin_wall() {
    let scene = two_rooms().scene(1.0);
    // The insides of the first room: fronts of the box, and one side of the wall.
    let in_first = |s: &Sample| s.position.x + 0.01 * s.normal.x < 2.0;
    let inside = |s: &Sample| {
        let p = s.position + 0.01 * s.normal;
        p.cmpgt(Vec3::ZERO).all() && p.cmplt(Vec3::new(4.0, 2.0, 2.0)).all()
    };
    let grid = Grid::new(&scene, Vec3::splat(0.5)).unwrap();
    let settings = SampleSettings { points: 25, ..SampleSettings::default() };
    let samples = sample_voxels(&scene, &grid, &settings, &inside).unwrap();
    let points = samples.samples.clone();
    let of = |m: &[Member]| in_first(&points[m[0].sample as usize]);
    let settings = ClusterSettings { max_patches: 12 };
    let apart = |a: &[Member], b: &[Member]| if of(a) == of(b) { 0.0 } else { 1e6 };
    let set = cluster_patches(&grid, samples, &settings, &apart).unwrap();
    let table = Lookup::new(&grid, &set, LookupSettings::default()).unwrap();
    let value = |i: usize| Vec4::splat(f32::from(u8::from(of(set.members_of(i)))));
    let values: Vec<Vec4> = (0..set.len()).map(value).collect();
    let others = || set.samples.iter().filter(|s| !in_first(s));
    let greatest = |light: &dyn Fn(&Sample) -> f32| others().map(light).fold(0.0, f32::max);
    let printed = greatest(&|s| light_at(&table, &values, s.position, s.normal).x);
    let ours = greatest(&|s| table.at(&values, s.position, s.normal).unwrap().x);
    assert!(printed > 0.1 && ours < 1e-4, "{printed} {ours}");
}
