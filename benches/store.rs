//! Rows of a bake: blocks read and checked from the page cache, rows taken from the cache of the store, and the row of
//! a parent.

#![allow(missing_docs)]

use std::hint::black_box;
use std::time::Duration;

use benches::SEED;
use criterion::{BenchmarkId, Criterion, Throughput};
use glam::Vec3;
use localmatrix::{
    BakeError, BakeFile, BakeWriter, LitPoint, NO_NODE, Node, Record, Store, World, WorldHead, block_range,
    parent_record,
};
use scene::sampling::hash3;

const LEAVES: u32 = 16_384;
const CHILDREN: u32 = 4;
/// Entries of a row, about as many as rows of the city have.
const ENTRIES: u32 = 100;
const POINTS: usize = 16;

fn nodes() -> Vec<Node> {
    let node = |k: u32| Node {
        centre: Vec3::splat(k as f32),
        radius: 1.0,
        normal: Vec3::Y,
        area: 1.0,
        albedo: Vec3::splat(0.5),
        parent: if k < LEAVES { LEAVES + k / CHILDREN } else { NO_NODE },
        first_child: if k < LEAVES { 0 } else { (k - LEAVES) * CHILDREN },
        children: if k < LEAVES { 0 } else { CHILDREN },
    };
    (0..LEAVES + LEAVES / CHILDREN).map(node).collect()
}

fn record(leaf: u32) -> Record {
    let mut columns: Vec<u32> = (0..ENTRIES).map(|k| hash3(leaf, k, SEED) % LEAVES).collect();
    columns.sort_unstable();
    columns.dedup();
    let point = LitPoint { position: Vec3::ZERO, normal: Vec3::Y, albedo: Vec3::splat(0.5) };
    let factors = columns.into_iter().map(|column| (column, 0.9 / ENTRIES as f32)).collect();
    Record { sky: 0.1, lost: 0.0, factors, points: vec![point; POINTS] }
}

fn benches(c: &mut Criterion) -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::temp_dir().join(format!("patchlight-bench-{}.bake", std::process::id()));
    let all = nodes();
    let head =
        WorldHead { part: None, nodes: all.len() as u32, leaves: LEAVES, block_rows: 64, scene: [0; 32], key: [0; 32] };
    let mut writer = BakeWriter::create(&path, head, "", all.clone(), Vec::new())?;
    while let Some(block) = writer.next_block().filter(|&block| block_range(&head, block).start < LEAVES) {
        writer.push(&block_range(&head, block).map(record).collect::<Vec<_>>())?;
    }
    writer.add_parents(POINTS, &mut |_, _| true)?;
    writer.finish()?;
    let file = BakeFile::open(&path)?;
    let mut group = c.benchmark_group("store");
    let block = file.place(0)?.1;
    group.throughput(Throughput::Bytes(u64::from(block)));
    let mut next = 0;
    group.bench_function(BenchmarkId::new("block", block), |b| {
        b.iter(|| {
            next = (next + 1) % (LEAVES / 64);
            file.read_block(black_box(next)).map(|found| found.0.len())
        });
    });
    let mut store = Store::new(BakeFile::open(&path)?, 8 << 20)?;
    store.want(&[0]);
    store.settle(Duration::from_secs(60));
    group.throughput(Throughput::Elements(1));
    group.bench_function(BenchmarkId::new("row", ENTRIES), |b| b.iter(|| store.row(black_box(17))));
    let children: Vec<Record> = (0..CHILDREN).map(record).collect();
    group.bench_function(BenchmarkId::new("parent", CHILDREN), |b| {
        b.iter(|| parent_record(&all, black_box(LEAVES), &children, POINTS));
    });
    group.finish();
    std::fs::remove_file(&path)
        .map_err(|e| BakeError::File { path: path.display().to_string(), reason: e.to_string() })?;
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut c = Criterion::default().configure_from_args();
    benches(&mut c)?;
    c.final_summary();
    Ok(())
}
