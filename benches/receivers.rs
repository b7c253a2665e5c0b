//! The product H_r = F_r B of many receivers with few patches: rows of counts of hits beside
//! compressed sparse rows, and beside the bandwidth with which the same cores read as many bytes.
//! Receivers and hits are those of Sponza (of the built-in atrium without the shared scenes). The
//! table is measured alternately, so that a busy machine slows all alike.

#![allow(missing_docs)]

use std::collections::HashMap;
use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};

use assets::import::{LoadedScene, load, load_or_build};
use benches::{SEED, Stream, exitance};
use criterion::{BenchmarkId, Criterion, Throughput};
use formfactor::HemisphereParams;
use formfactor::kernel::hemisphere::hemisphere_ray;
use glam::{IVec4, UVec3, Vec3, Vec4};
use patches::{Density, InterpolationMesh};
use rayon::prelude::*;
use scene::{Hit, NONE, Scene, SidePolicy, SurfacePoint, Visibility, find_sides};
use transport::{Csr, HitCounts, LinearOperator};

const SPONZA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/scenes/sponza/sponza.toml");
/// Receivers.
const ROWS: usize = 160_000;
/// Patches at most.
const COLUMNS: usize = 1 << 16;
/// Rays of a receiver.
const RAYS: u32 = 512;
/// Rows whose hits are in memory at a time.
const BLOCK: usize = 4096;
/// Rays of a receiver from which the size of the patches is found.
const TRIAL_RAYS: u32 = 4;
/// Rounds of the table: product, stream, product, …
const ROUNDS: usize = 41;

/// Patches: the sides of the surface in the cells of a grid, numbered along a space-filling curve.
struct Patches {
    cell: f32,
    numbers: HashMap<IVec4, u32>,
}

impl Patches {
    /// The smallest cells with at most [`COLUMNS`] patches among the places that are hit.
    fn new(places: &[(Vec3, Vec3)]) -> Self {
        let keys = |cell: f32| {
            let mut keys: Vec<IVec4> = places.par_iter().map(|place| patch_key(*place, cell)).collect();
            keys.par_sort_unstable_by_key(|key| (morton(*key), key.w));
            keys.dedup();
            keys
        };
        let mut small = 0.01;
        let mut large = 10.0;
        while large > 1.01 * small {
            let middle = f32::sqrt(small * large);
            *(if keys(middle).len() > COLUMNS { &mut small } else { &mut large }) = middle;
        }
        Self { cell: large, numbers: keys(large).into_iter().zip(0..).collect() }
    }

    fn number(&self, place: (Vec3, Vec3)) -> u32 {
        self.numbers.get(&patch_key(place, self.cell)).copied().unwrap_or(NONE)
    }
}

/// The cell of a place, and the axis and side that its normal is nearest to.
fn patch_key((place, normal): (Vec3, Vec3), cell: f32) -> IVec4 {
    let axis = normal.abs().max_position();
    (place / cell).floor().as_ivec3().extend(2 * axis as i32 + i32::from(normal[axis] > 0.0))
}

/// Position of a cell on the curve: the bits of its coordinates, interleaved.
fn morton(key: IVec4) -> u64 {
    let UVec3 { x, y, z } = (key.truncate() + (1 << 15)).as_uvec3();
    let spread = |value: u32| (0..16).map(|bit| u64::from(value >> bit & 1) << (3 * bit)).sum::<u64>();
    spread(x) | spread(y) << 1 | spread(z) << 2
}

/// [`ROWS`] receivers on the fronts of a scene, taken evenly from a mesh that has a few more.
fn receivers(scene: &Scene) -> Vec<SurfacePoint> {
    let sides = find_sides(scene, SidePolicy::Front);
    let area: f32 = scene.geometry.triangles.iter().map(|t| 0.5 * t.edge_a.cross(t.edge_b).length()).sum();
    let nowhere = |points: &[SurfacePoint], _: u32| Ok(vec![None; points.len()]);
    let mut edge = f32::sqrt(area / ROWS as f32);
    loop {
        let points =
            InterpolationMesh::new(scene, &Density::default(), &sides, edge, 0.4 * edge, |_, _| Some(edge), nowhere)
                .expect("the edge is positive")
                .points;
        println!("receivers: {} at edges of {edge:.3} m", points.len());
        if points.len() >= ROWS {
            return (0..ROWS).map(|k| points[k * points.len() / ROWS]).collect();
        }
        edge *= 0.8;
    }
}

/// The rows of the receivers over patches of about the size that [`COLUMNS`] of them have.
fn rows_of(scene: &Scene, receivers: &[SurfacePoint]) -> HitCounts {
    let count = receivers.len();
    let offsets: Vec<u32> = (0..=count as u32).collect();
    let p = HemisphereParams {
        rays: RAYS,
        seed: SEED,
        ray_offset: scene.geometry.ray_offset,
        ..HemisphereParams::default()
    };
    let place = |row: usize, ray: u32| {
        let (origin, direction) = hemisphere_ray(&p, &offsets, receivers, row as u32, ray);
        let hit: Hit = scene.closest(origin, direction);
        let normal = || scene.tables().normal(hit.triangle);
        let facing = || if normal().dot(direction) < 0.0 { normal() } else { -normal() };
        (!hit.is_miss()).then(|| (scene.tables().position(hit.triangle, hit.u, hit.v), facing()))
    };
    let trial = |row: usize| (0..TRIAL_RAYS).filter_map(move |ray| place(row, ray * (RAYS / TRIAL_RAYS)));
    let patches = Patches::new(&(0..count).into_par_iter().flat_map_iter(trial).collect::<Vec<_>>());
    println!("patches: {} in cells of {:.3} m", patches.numbers.len(), patches.cell);
    let mut rows = HitCounts::new(patches.numbers.len()).expect("16 bits suffice");
    for first in (0..count).step_by(BLOCK) {
        let block = BLOCK.min(count - first);
        let hit =
            |k: usize| place(first + k / RAYS as usize, k as u32 % RAYS).map_or(NONE, |place| patches.number(place));
        let hits: Vec<u32> = (0..block * RAYS as usize).into_par_iter().map(hit).collect();
        rows.push(&hits, &vec![1.0 / RAYS as f32; block]).expect("the shapes agree");
    }
    rows
}

fn csr_bytes(csr: &Csr) -> usize {
    4 * (csr.row_start.len() + csr.column_index.len() + csr.values.len())
}

/// Criterion's figures, then the table's row.
fn measure(criterion: &mut Criterion, name: &str, operator: &impl LinearOperator, tables: usize) {
    let rows = operator.rows();
    let columns = operator.columns();
    let light = exitance(columns, columns);
    let mut out = vec![Vec4::ZERO; rows];
    let bytes = tables + size_of_val(&light[..]) + size_of_val(&out[..]);
    let mut run = || {
        let start = Instant::now();
        operator.apply(black_box(&light), &mut out).expect("the shapes agree");
        start.elapsed()
    };
    let mut group = criterion.benchmark_group("receivers/native");
    group.sample_size(10).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    group.throughput(Throughput::Bytes(bytes as u64));
    group.bench_function(BenchmarkId::new(name, rows), |b| b.iter_custom(|rounds| (0..rounds).map(|_| run()).sum()));
    group.finish();

    let mut stream = Stream::new(bytes);
    let mut rounds: Vec<(f64, f64)> =
        (0..ROUNDS).map(|_| (1e3 * run().as_secs_f64(), bytes as f64 * 1e-6 / stream.round())).collect();
    let mut ratio: Vec<f64> = rounds.iter().map(|t| t.1 / t.0).collect();
    ratio.sort_by(f64::total_cmp);
    rounds.sort_by(|a, b| a.0.total_cmp(&b.0));
    let floor = rounds.iter().map(|t| t.1).fold(f64::INFINITY, f64::min);
    let best = rounds[0].0;
    let median = rounds[ROUNDS / 2].0;
    println!(
        "receivers/native/{name}/{rows}: {:.1} MB moved, median {median:.2} ms, best {best:.2} ms ({:.1} GB/s), \
         reading them takes {floor:.2} ms ({:.1} GB/s), median of the ratio {:.0} %",
        bytes as f64 * 1e-6,
        bytes as f64 * 1e-6 / best,
        bytes as f64 * 1e-6 / floor,
        100.0 * ratio[ROUNDS / 2]
    );
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let loaded: LoadedScene =
        if Path::new(SPONZA).exists() { load(Path::new(SPONZA)) } else { load_or_build("atrium") }
            .expect("the scene loads");
    println!("{}, on {} threads", loaded.name, rayon::current_num_threads());
    let start = Instant::now();
    let receivers = receivers(&loaded.scene);
    let rows = rows_of(&loaded.scene, &receivers);
    let csr = rows.to_csr().expect("few enough entries");
    println!(
        "rows: {} of {:.1} entries in {:.1} quads; {:.2} bytes an entry, sparse rows {:.2}; prepared in {:.1} s",
        rows.rows(),
        csr.values.len() as f64 / rows.rows() as f64,
        rows.quads().len() as f64 / rows.rows() as f64,
        rows.bytes() as f64 / csr.values.len() as f64,
        csr_bytes(&csr) as f64 / csr.values.len() as f64,
        start.elapsed().as_secs_f64()
    );
    measure(&mut criterion, "hits", &rows, rows.bytes() as usize);
    measure(&mut criterion, "csr", &csr, csr_bytes(&csr));
    criterion.final_summary();
}
