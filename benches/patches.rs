//! Virtual patches and the voxel volume over growing numbers of patches: Sponza, or the built-in atrium without the
//! shared scenes. A table of seconds with the exponent p of t ∝ Nᵖ, fitted to all sizes; the volume's lookup by
//! criterion. All cores; under four minutes on two.

#![allow(missing_docs)]

use std::error::Error;
use std::hint::black_box;
use std::time::{Duration, Instant};

use benches::SEED;
use criterion::{BenchmarkId, Criterion, Throughput};
use formfactor::{Hemisphere, Patch, Proceed, Surfaces, form_factor_blocks};
use glam::{Vec3, Vec4};
use patches::{
    ClusterSettings, Density, Grid, LitSampler, Lookup, LookupSettings, Member, Nearest, PatchSet, Sample,
    SampleSettings, ViewSettings, VolumeSettings, VolumeSize, VoxelVolume, axis_patches, cluster_patches,
    sample_voxels, view_clusters,
};
use scene::sampling::{hash3, unit};
use scene::{Hit, NONE, ReceiverSet, Scene, SurfacePoint};

const SPONZA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/scenes/sponza/sponza.toml");
const SIZES: [u32; 6] = [1_000, 2_000, 5_000, 10_000, 20_000, 40_000];
/// Points of a lookup.
const POINTS: u32 = 1 << 17;
/// Rays from each face of a voxel.
const FACE_RAYS: u32 = 16;
/// Samples that are asked where light comes.
const PROBES: u32 = 1 << 16;
/// Samples of a view cluster.
const SAMPLES: u32 = 8;
/// Rays of a row of form factors.
const RAYS: u32 = 64;
/// Most clusters of a voxel.
const CLUSTERS: u32 = 4;

/// Patches and seconds of each step at each size.
#[derive(Default)]
struct Table {
    rows: Vec<(&'static str, Vec<(usize, f64)>)>,
}

impl Table {
    /// The result of a step and its time: the best of as many rounds as fit into 0.25 s.
    fn time<T>(&mut self, step: &'static str, size: impl Fn(&T) -> usize, run: impl Fn() -> T) -> T {
        let all = Instant::now();
        let mut best = f64::INFINITY;
        loop {
            let start = Instant::now();
            let result = black_box(run());
            best = best.min(start.elapsed().as_secs_f64());
            if all.elapsed() > Duration::from_millis(250) {
                let entry = (size(&result), best);
                match self.rows.iter_mut().find(|row| row.0 == step) {
                    Some(row) => row.1.push(entry),
                    None => self.rows.push((step, vec![entry])),
                }
                return result;
            }
        }
    }

    fn print(&self) {
        println!("| step | N: seconds | exponent |\n| --- | --- | --- |");
        for (step, entries) in &self.rows {
            let cells: Vec<String> = entries.iter().map(|(n, t)| format!("{n}: {t:.2e}")).collect();
            println!("| {step} | {} | {:.2} |", cells.join(", "), exponent(entries));
        }
    }
}

/// Slope of the line through (ln N, ln t) with the least squares.
fn exponent(entries: &[(usize, f64)]) -> f64 {
    let logs: Vec<(f64, f64)> = entries.iter().map(|&(n, t)| ((n as f64).ln(), t.ln())).collect();
    let count = logs.len() as f64;
    let (x, y) = logs.iter().fold((0.0, 0.0), |s, l| (s.0 + l.0 / count, s.1 + l.1 / count));
    let (a, b) = logs.iter().fold((0.0, 0.0), |s, l| (s.0 + (l.0 - x) * (l.1 - y), s.1 + (l.0 - x).powi(2)));
    a / b
}

/// Points in the air of a scene with normals in all directions.
fn points(scene: &Scene) -> Vec<SurfacePoint> {
    let (low, high) = scene.geometry.bounds;
    (0..POINTS)
        .map(|k| {
            let number = |d: u32| unit(hash3(k, d, SEED));
            let position = low + (high - low) * Vec3::new(number(0), number(1), number(2));
            let normal = (Vec3::new(number(3), number(4), number(5)) - 0.5).normalize();
            SurfacePoint { position, patch: NONE, normal, weight: 1.0 }
        })
        .collect()
}

fn colors(count: usize) -> Vec<Vec4> {
    (0..count as u32).map(|k| Vec4::new(unit(hash3(k, 7, SEED)), unit(hash3(k, 8, SEED)), 0.5, 0.0)).collect()
}

fn voxel_steps(table: &mut Table, scene: &Scene, size: u32) -> Result<(), Box<dyn Error>> {
    // About two axis patches an occupied voxel.
    let grid = Grid::for_count(scene, Vec3::ONE, size as usize / 2, |grid| Ok(grid.len()))?;
    let settings = SampleSettings { points: FACE_RAYS, ..SampleSettings::default() };
    let sampled = sample_voxels(scene, &grid, &settings, &|_: &Sample| true)?;
    let set = axis_patches(&grid, sampled.clone())?;
    let patches = set.len();
    table.time("sample_voxels", |_| patches, || sample_voxels(scene, &grid, &settings, &|_: &Sample| true))?;
    let settings = ClusterSettings { max_patches: CLUSTERS };
    let no_rows = |_: &[Member], _: &[Member]| 0.0;
    table.time(
        "cluster_patches",
        |set: &Result<PatchSet, _>| set.as_ref().map_or(0, PatchSet::len),
        || cluster_patches(&grid, sampled.clone(), &settings, &no_rows),
    )?;
    let values = colors(set.samples.len());
    let means = table.time("gather", |_| patches, || set.gather(&values))?;
    let lookup = Lookup::new(&grid, &set, LookupSettings::default())?;
    let points = points(scene);
    table.time("lookup of 131,072 points", |_| patches, || lookup.at_points(&means, &points))?;
    Ok(())
}

fn view_steps(table: &mut Table, scene: &Scene, size: u32) -> Result<(), Box<dyn Error>> {
    let settings = ViewSettings { patches: size, samples: SAMPLES, seed: SEED, ..ViewSettings::default() };
    let count = |set: &Result<PatchSet, _>| set.as_ref().map_or(0, PatchSet::len);
    let set = table.time("view_clusters", count, || {
        view_clusters(&LitSampler::new(scene, PROBES, Density::default(), SEED)?, &settings).map(|found| found.set)
    })?;
    let nearest = Nearest::new(&set.samples, &Density::default());
    let mut owners = vec![NONE; set.samples.len()];
    for (patch, range) in set.offsets.windows(2).enumerate() {
        owners[range[0] as usize..range[1] as usize].fill(patch as u32);
    }
    let patches: Vec<Patch> = (set.patches.iter())
        .map(|p| Patch { centroid: p.position, area: p.area, normal: p.normal, triangle: NONE })
        .collect();
    let mut points = Vec::new();
    for patch in 0..set.len() {
        points.extend(set.members_of(patch).iter().map(|m| {
            let s = &set.samples[m.sample as usize];
            SurfacePoint { position: s.position, patch: patch as u32, normal: s.normal, weight: m.weight }
        }));
    }
    let geometry = scene.tables();
    let owner = |hit: &Hit, way: Vec3| {
        let normal = geometry.normal(hit.triangle);
        let facing = if normal.dot(way) < 0.0 { normal } else { -normal };
        let place = geometry.position(hit.triangle, hit.u, hit.v);
        nearest.sample(place, facing, 4.0).map_or(NONE, |(sample, _)| owners[sample as usize])
    };
    let surfaces = Surfaces {
        patches: &patches,
        polygons: &[],
        row_polygons: &[],
        points: &points,
        offsets: &set.offsets,
        visibility: scene,
        owner: Box::new(owner),
        ray_offset: scene.geometry.ray_offset,
        seed: SEED,
    };
    table.time(
        "form factors, 64 rays a row",
        |_| set.len(),
        || {
            form_factor_blocks(&Hemisphere { rays: RAYS }, &surfaces, 256, &|_, _| Proceed::Continue(()), |_, block| {
                black_box(block);
                Ok(())
            })
        },
    )?;
    Ok(())
}

fn volume_steps(criterion: &mut Criterion, table: &mut Table, scene: &Scene, size: u32) -> Result<(), Box<dyn Error>> {
    let settings = VolumeSettings { size: VolumeSize::Count(size), ..VolumeSettings::default() };
    let probes = |volume: &Result<VoxelVolume, _>| volume.as_ref().map_or(0, VoxelVolume::len);
    let volume = table.time("VoxelVolume::new", probes, || VoxelVolume::new(scene, &settings, &|_| true))?;
    let cubes = colors(volume.points().len());
    let points = points(scene);
    let harmonics = volume.harmonics(&cubes)?;
    let count = volume.len();
    table.time("volume lookup of 131,072 points", |_| count, || volume.at_points(&cubes, &points))?;
    table.time("the same, harmonics", |_| count, || volume.at_points_sh(&harmonics, &points))?;
    let mut group = criterion.benchmark_group("patches/volume_lookup");
    group.sample_size(10).warm_up_time(Duration::from_millis(200)).measurement_time(Duration::from_secs(1));
    group.throughput(Throughput::Elements(u64::from(POINTS)));
    group.bench_function(BenchmarkId::from_parameter(count), |b| b.iter(|| volume.at_points(&cubes, &points)));
    group.finish();
    Ok(())
}

fn measure(criterion: &mut Criterion) -> Result<(), Box<dyn Error>> {
    let spec = if std::path::Path::new(SPONZA).exists() { SPONZA } else { "atrium" };
    let loaded = assets::import::load_or_build(spec)?;
    let scene = &loaded.scene;
    let mut table = Table::default();
    for size in SIZES {
        voxel_steps(&mut table, scene, size)?;
        view_steps(&mut table, scene, size)?;
        volume_steps(criterion, &mut table, scene, size)?;
    }
    println!("{}: {} triangles, {} threads", loaded.name, scene.geometry.triangles.len(), rayon::current_num_threads());
    table.print();
    Ok(())
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    if let Err(error) = measure(&mut criterion) {
        eprintln!("{error}");
        std::process::exit(1);
    }
    criterion.final_summary();
}
