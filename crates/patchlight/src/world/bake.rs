//! Bakes of worlds larger than memory: patches of voxels and what is merged of them for the distance, and their rows of
//! form factors, made block by block.

use std::path::{Path, PathBuf};

use localmatrix::{BakeError, BakeFile, BakeWriter, LitPoint, Node, Part, Record, WorldHead, join};
use rayon::prelude::*;
use runtime::cpu::Cpu;
use runtime::executor::{DeviceKind, Executor};
use runtime::recipe::formfactor::SurfaceTracer;
use scene::Scene;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use web_time::Instant;

use crate::error::{Error, Reason};
use crate::memory::resident_bytes;
use crate::observe::{Report, run_phase, warn_of_specular_materials};
use transport::{Observer, Phase};

use super::forest::{Extra, Forest};
use super::rows::Rows;

/// Points of a node at which its direct light is measured.
pub const POINTS: usize = 16;
/// Rows of a block.
const BLOCK_ROWS: u32 = 64;
/// Blocks that are made at once, for each thread.
const BLOCKS_A_THREAD: usize = 4;

/// Bytes of a patch beside its nodes and points: its voxel, its columns.
const PATCH_TABLES: usize = 128;
/// Patches that voxels of a power of two give, at most about, for one that was asked for.
const MORE_PATCHES: usize = 2;
/// Bytes of an entry of a row under way: the hit and the entry.
const ENTRY_BYTES: usize = 24;
/// Bytes that any bake takes: voxels under way.
const MIN_BYTES: usize = 64 << 20;

/// Settings that change the bytes of a bake, beside the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorldSettings {
    /// The scene as the command line named it.
    pub scene: String,
    /// Edge of the voxels, m; without one, a power of two of a metre for about `patch_count` patches.
    pub voxel_size: Option<f32>,
    /// About how many patches.
    pub patch_count: usize,
    /// Rays a row.
    pub rays: u32,
    /// Changes every random number.
    pub seed: u32,
}

impl WorldSettings {
    fn key(&self) -> [u8; 32] {
        // Where the scene lies is not what it is.
        let own = Self { scene: String::new(), ..self.clone() };
        let text = serde_json::to_string(&own).unwrap_or_default();
        Sha256::digest(format!("patchlight bake 2 {POINTS} {BLOCK_ROWS} {text}")).into()
    }
}

/// Result of a bake.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BakedWorld {
    /// Patches.
    pub leaves: u32,
    /// Patches and what was merged of them.
    pub nodes: u32,
    /// Edge of the voxels, m.
    pub voxel_edge_m: f32,
    /// Rows that this run made, those of patches only.
    pub rows: u64,
    /// Rows a second of making them.
    pub rows_per_second: f64,
    /// Rows that were there from before an interruption.
    pub resumed_rows: u64,
    /// Bytes of the file.
    pub bytes: u64,
}

/// Memory that a bake takes beside the scene, bytes, if it becomes as many patches as asked for: the patches, which
/// each part has all of, twice while they are put together, and the rows under way. Jobs of three worlds took a quarter
/// to half of this and their scene together.
pub fn job_bytes(settings: &WorldSettings) -> u64 {
    let patch = 2 * size_of::<Node>() + POINTS * size_of::<LitPoint>() + PATCH_TABLES;
    let rows = BLOCKS_A_THREAD * rayon::current_num_threads() * BLOCK_ROWS as usize;
    let entries = rows * settings.rays as usize * ENTRY_BYTES;
    (MIN_BYTES + 2 * MORE_PATCHES * settings.patch_count * patch + entries) as u64
}

/// Bakes a scene, or a part of it, into a file; goes on where an interrupted run of the same ended.
///
/// # Errors
/// What the scene, the file or the memory limit says; [`Cancelled`](crate::ErrorKind::Cancelled), after which the next
/// run goes on.
pub fn bake(
    scene: &Scene,
    content_hash: [u8; 32],
    settings: &WorldSettings,
    part: Option<Part>,
    path: &Path,
    memory_limit: u64,
    observer: &dyn Observer,
) -> Result<BakedWorld, Error> {
    bake_on(&mut Cpu::new(), scene, content_hash, (settings, part), path, memory_limit, observer)
}

/// [`bake`] with a device that traces the rays of rows; the plan that it had goes. Native code as the device leaves
/// them to the host. Where both find the same hits, so are the bytes.
///
/// # Errors
/// As [`bake`]; what the device says.
pub fn bake_on(
    device: &mut (dyn Executor + 'static),
    scene: &Scene,
    content_hash: [u8; 32],
    (settings, part): (&WorldSettings, Option<Part>),
    path: &Path,
    memory_limit: u64,
    observer: &dyn Observer,
) -> Result<BakedWorld, Error> {
    if scene.has_medium() {
        return Err(Reason::Medium { what: "a world" }.into());
    }
    warn_of_specular_materials(scene, observer);
    let key = settings.key();
    // What was begun is asked for first: a name that is taken should not cost minutes.
    let begun = BakeWriter::resume(path, content_hash, key, part)?;
    let world = Forest::new(scene, settings, memory_limit, observer)?;
    let mut writer = match begun {
        Some(writer) => writer,
        None => {
            let head = WorldHead {
                part,
                nodes: world.nodes.len() as u32,
                leaves: world.leaves() as u32,
                block_rows: BLOCK_ROWS,
                scene: content_hash,
                key,
            };
            let text = serde_json::to_string(settings).unwrap_or_default();
            BakeWriter::create(path, head, &text, world.nodes.clone(), world.extra.encode())?
        }
    };
    let mut baked = BakedWorld {
        leaves: world.leaves() as u32,
        nodes: world.nodes.len() as u32,
        voxel_edge_m: world.extra.shape.edges.x,
        ..BakedWorld::default()
    };
    let start = Instant::now();
    let done = run_phase(observer, Phase::FORM_FACTORS, |report| {
        add_rows(device, scene, &world, settings, &mut writer, memory_limit, report)
    })?;
    if is_tracing(device) && done.made > 0 {
        let rays = done.made * u64::from(settings.rays);
        observer.note(&format!("{}: {rays} rays of rows on {}", Phase::FORM_FACTORS, device.device().name));
    }
    baked.rows = done.made;
    baked.resumed_rows = done.resumed;
    baked.rows_per_second = done.made as f64 / start.elapsed().as_secs_f64().max(1e-9);
    if part.is_none() {
        add_parents(&mut writer, observer)?;
    }
    drop(world);
    finish(writer, path, &mut baked)?;
    Ok(baked)
}

/// Joins parts into a whole bake, and makes the rows of what is merged.
///
/// # Errors
/// Parts that are missing, doubled, of another scene or other settings; what the files say.
pub fn merge(parts: &[PathBuf], path: &Path, observer: &dyn Observer) -> Result<BakedWorld, Error> {
    let files = parts.iter().map(|part| BakeFile::open(part)).collect::<Result<Vec<_>, BakeError>>()?;
    let mut writer = run_phase(observer, Phase::JOIN, |report| {
        join(path, &files, &mut |done, all| {
            // A join is short: it ends what it began.
            let _ = report(done as usize, all as usize);
        })
    })?;
    let head = *writer.head();
    drop(files);
    add_parents(&mut writer, observer)?;
    let mut baked = BakedWorld { leaves: head.leaves, nodes: head.nodes, ..BakedWorld::default() };
    if let Some(extra) = Extra::decode(writer.extra()) {
        baked.voxel_edge_m = extra.shape.edges.x;
    }
    finish(writer, path, &mut baked)?;
    Ok(baked)
}

fn finish(writer: BakeWriter, path: &Path, baked: &mut BakedWorld) -> Result<(), Error> {
    writer.finish()?;
    baked.bytes = std::fs::metadata(path).map_err(|source| Reason::Write { path: path.to_path_buf(), source })?.len();
    Ok(())
}

fn add_parents(writer: &mut BakeWriter, observer: &dyn Observer) -> Result<(), Error> {
    let all = run_phase(observer, Phase::MERGED, |report| {
        writer.add_parents(POINTS, &mut |done, all| report(done as usize, all as usize).is_continue())
    })?;
    if all { Ok(()) } else { Err(Error::cancelled()) }
}

/// Rows that were made, and that were there.
struct Made {
    made: u64,
    resumed: u64,
}

/// Returns true if a device traces: the host's own hierarchy is faster than the kernels as native code.
fn is_tracing(device: &dyn Executor) -> bool {
    device.device().kind != DeviceKind::Native
}

fn add_rows(
    device: &mut (dyn Executor + 'static),
    scene: &Scene,
    world: &Forest,
    settings: &WorldSettings,
    writer: &mut BakeWriter,
    memory_limit: u64,
    report: &Report,
) -> Result<Made, Error> {
    let head = *writer.head();
    let leaf_blocks = head.leaves.div_ceil(head.block_rows);
    let own = head.own_blocks();
    let own = own.start..own.end.min(leaf_blocks);
    let rows = Rows::new(scene, world, settings);
    let first = writer.next_block().map_or(own.end, |next| next.clamp(own.start, own.end));
    let room = (BLOCK_ROWS as usize, BLOCK_ROWS as usize * POINTS);
    let mut tracer = match is_tracing(device) && first < own.end {
        true => Some(SurfaceTracer::new(device, scene, room, settings.rays)?),
        false => None,
    };
    let at_once = (BLOCKS_A_THREAD * rayon::current_num_threads()) as u32;
    let mut next = first;
    while next < own.end {
        let end = (next + at_once).min(own.end);
        let blocks: Vec<Vec<Record>> = match &mut tracer {
            None => {
                (next..end).into_par_iter().map(|block| rows.block(&head, block, None)).collect::<Result<_, _>>()?
            }
            Some(tracer) => {
                let hits = (next..end).map(|block| rows.hits(&head, block, tracer)).collect::<Result<Vec<_>, _>>()?;
                let traced = (next..end).into_par_iter().zip(&hits);
                traced.map(|(block, hits)| rows.block(&head, block, Some(hits))).collect::<Result<_, _>>()?
            }
        };
        for records in blocks {
            writer.push(&records)?;
        }
        next = end;
        check_memory("form factors", memory_limit)?;
        if report((next - own.start) as usize, own.len()).is_break() {
            return Err(Error::cancelled());
        }
    }
    let count = |blocks: std::ops::Range<u32>| {
        blocks.map(|block| localmatrix::block_range(&head, block).len() as u64).sum::<u64>()
    };
    Ok(Made { made: count(first..own.end), resumed: count(own.start..first) })
}

/// More resident memory than is allowed is an error that says what to do.
pub(super) fn check_memory(phase: &'static str, limit: u64) -> Result<(), Error> {
    match resident_bytes() {
        Some(used) if used > limit => Err(Reason::MemoryLimit { phase, used, limit }.into()),
        _ => Ok(()),
    }
}
