//! `patchlight world`, `patchlight merge`, and `patchlight info` of a world's bake.

use std::path::{Path, PathBuf};

use clap::Args;
use localmatrix::{BakeFile, Part, beginning_of, is_begun_as_bake};
use serde::Serialize;

use super::plan::{Format, Plan};
use assets::import::LoadedScene;
use patchlight::file::BakeKind;
use patchlight::memory::peak_memory_bytes;
use patchlight::world::{BakedWorld, Extra, MAX_PATCHES, MIN_PATCHES, WorldSettings, bake_on, job_bytes, merge};
use runtime::executor::DeviceChoice;
use shell::Error;
use shell::args::bake::parse_bytes;
use shell::args::common::{Common, parse_metres};
use shell::args::input::kind;
use shell::device::open;
use shell::opened::open_device;
use shell::output;
use shell::progress::{Progress, continue_in, interruptible};

/// Patches without --patch-count: one for so many triangles, within these bounds.
const TRIANGLES_A_PATCH: usize = 20;
const MIN_BY_DEFAULT: usize = 4_000;
const MAX_BY_DEFAULT: usize = 250_000;

/// Bake a world of patches into a file that --method local reads as the camera moves. Goes on where an interrupted run
/// of the same ended; the bytes are the same for any number of threads.
#[derive(Args, Clone, Debug)]
#[command(after_help = "Examples:\n  \
    patchlight world city:5000000 -o city.bake\n  \
    patchlight world sponza.toml --patch-count 50000 --rays 1024 --memory-limit 4G -o sponza.bake\n  \
    patchlight world city --part 3/8 -o part-3.bake     one part\n  \
    patchlight world city:5000000 --plan 8 --format slurm -o city.bake     the jobs of a farm: sbatch city.sbatch\n\n\
    --out names the file [default: SCENE.bake].")]
pub struct World {
    /// A scene file (.toml, .obj, .gltf, .glb) or a built-in scene.
    pub scene: String,
    /// About how many patches; the voxels' edge is then a power of two of a metre [default: a twentieth of the
    /// triangles, 4,000 to 250,000].
    #[arg(long, conflicts_with = "voxel_size", value_parser = parse_patches)]
    pub patch_count: Option<usize>,
    /// Edge of the voxels, m.
    #[arg(long, value_name = "METRES", value_parser = parse_metres)]
    pub voxel_size: Option<f32>,
    /// Rays a row.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(16..=65_536))]
    pub rays: u32,
    /// Most resident memory: bytes, or with K, M or G.
    #[arg(long, default_value = "2G", value_parser = parse_bytes)]
    pub memory_limit: u64,
    /// Bake only part K of N; join them with `patchlight merge`.
    #[arg(long, value_name = "K/N", value_parser = parse_part)]
    pub part: Option<Part>,
    /// Bake nothing, but write the jobs of a farm that bakes N parts and joins them, beside the file that --out names;
    /// it and the scene must be where all workers see them.
    #[arg(
        long,
        value_name = "N",
        conflicts_with = "part",
        requires = "format",
        value_parser = clap::value_parser!(u32).range(1..=1000)
    )]
    pub plan: Option<u32>,
    /// Who runs the jobs.
    #[arg(long, value_enum, requires = "plan")]
    pub format: Option<Format>,
}

/// Join the parts of a world into one file: the same bytes as those of one that was baked whole.
#[derive(Args, Clone, Debug)]
#[command(after_help = "Example:\n  patchlight merge part-*.bake -o city.bake")]
pub struct Merge {
    /// The parts, in any order.
    #[arg(required = true)]
    pub parts: Vec<PathBuf>,
}

fn parse_patches(text: &str) -> Result<usize, String> {
    let range = MIN_PATCHES..=MAX_PATCHES;
    text.parse()
        .ok()
        .filter(|n| range.contains(n))
        .ok_or_else(|| format!("`{text}` is no number from {MIN_PATCHES} to {MAX_PATCHES}"))
}

pub fn parse_part(text: &str) -> Result<Part, String> {
    let wrong = || format!("`{text}` is no part; write K/N, for example 3/8, with K from 1 to N");
    let (number, of) = text.split_once('/').ok_or_else(wrong)?;
    let part = Part { number: number.parse().map_err(|_| wrong())?, of: of.parse().map_err(|_| wrong())? };
    if part.number == 0 || part.number > part.of { Err(wrong()) } else { Ok(part) }
}

#[derive(Serialize)]
struct Report {
    file: PathBuf,
    #[serde(flatten)]
    baked: BakedWorld,
    seconds: Vec<(String, f64)>,
    #[serde(skip_serializing_if = "Option::is_none")]
    peak_memory_bytes: Option<u64>,
}

/// Checks that a bake can be written there, and nothing but a bake be lost by it.
pub fn check_file(path: &Path) -> Result<(), Error> {
    output::check_file(path)?;
    match path.exists() && !is_begun_as_bake(path)? {
        true => Err(Error::Overwrites { path: path.to_path_buf() }),
        false => Ok(()),
    }
}

pub fn run(common: &Common, args: &World) -> Result<(), Error> {
    if args.plan.is_some() {
        common.native_only("world --plan")?;
    }
    match &common.out {
        Some(path) => check_file(path)?,
        None => output::check_folder(Path::new("."))?,
    }
    let progress = Progress::new(common.quiet);
    let loaded = output::import_within(&args.scene, Some(args.memory_limit), &progress)?;
    let by_default = (loaded.file_triangles / TRIANGLES_A_PATCH).clamp(MIN_BY_DEFAULT, MAX_BY_DEFAULT);
    let settings = WorldSettings {
        scene: args.scene.clone(),
        voxel_size: args.voxel_size,
        patch_count: args.patch_count.unwrap_or(by_default),
        rays: args.rays,
        seed: common.seed,
    };
    if let (Some(parts), Some(format)) = (args.plan, args.format) {
        return plan(common, args, &loaded, &settings, (parts, format));
    }
    let part = args.part.map_or(String::new(), |p| format!("-{}-of-{}", p.number, p.of));
    let path =
        common.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}{part}.bake", loaded.name.replace(':', "-"))));
    check_file(&path)?;
    continue_in(beginning_of(&path));
    // Parts are made on many machines: the host's are the same on all of them, in the memory that was planned.
    let mut device = match DeviceChoice::parse(&common.device) {
        DeviceChoice::Auto if args.part.is_some() => open(&DeviceChoice::Cpu)?.0,
        _ => open_device(common, &progress)?,
    };
    let baked = interruptible(|| {
        let what = (&settings, args.part);
        bake_on(device.as_mut(), &loaded.scene, loaded.content_hash, what, &path, args.memory_limit, &progress)
    })?;
    tell(common, path, baked, &progress);
    Ok(())
}

/// Summary of a plan.
#[derive(Serialize)]
struct PlanReport {
    file: PathBuf,
    parts: u32,
    memory_bytes: u64,
}

/// Writes the jobs of a farm.
fn plan(
    common: &Common,
    args: &World,
    loaded: &LoadedScene,
    settings: &WorldSettings,
    (parts, format): (u32, Format),
) -> Result<(), Error> {
    let bake = common.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.bake", loaded.name.replace(':', "-"))));
    // This process has loaded the scene, as each job will. A bake stops by itself at the limit.
    let needed = peak_memory_bytes().map(|loaded| loaded + job_bytes(settings));
    let memory_bytes = needed.filter(|_| args.voxel_size.is_none()).unwrap_or(u64::MAX).min(args.memory_limit);
    let scene = Path::new(&args.scene);
    let scene = if scene.exists() { absolute(scene)?.to_string_lossy().into_owned() } else { args.scene.clone() };
    let size = match args.voxel_size {
        Some(edge) => ["--voxel-size".to_owned(), edge.to_string()],
        None => ["--patch-count".to_owned(), settings.patch_count.to_string()],
    };
    let numbers =
        [("--rays", u64::from(args.rays)), ("--seed", u64::from(common.seed)), ("--memory-limit", args.memory_limit)];
    let numbers = numbers.iter().flat_map(|(name, value)| [(*name).to_owned(), value.to_string()]);
    let arguments = [scene].into_iter().chain(size).chain(numbers).chain(["--quiet".to_owned()]).collect();
    let file = Plan { parts, bake: absolute(&bake)?, arguments, memory: memory_bytes }.write(format)?;
    let report = PlanReport { file, parts, memory_bytes };
    if common.json {
        say!("{}", output::json(&report));
        return Ok(());
    }
    say!("{:14} {}, {parts} parts and one job that joins them", "jobs", report.file.display());
    say!("{:14} {} each", "memory", output::bytes(memory_bytes));
    Ok(())
}

pub fn absolute(path: &Path) -> Result<PathBuf, Error> {
    std::path::absolute(path).map_err(|source| Error::NoPath { path: path.to_path_buf(), source })
}

pub fn run_merge(common: &Common, args: &Merge) -> Result<(), Error> {
    common.native_only("merge")?;
    let progress = Progress::new(common.quiet);
    let path = common.out.clone().unwrap_or_else(|| PathBuf::from("merged.bake"));
    check_file(&path)?;
    if let Some(path) = args.parts.iter().find(|part| kind(part) == Some(BakeKind::Scene)) {
        return Err(Error::NoPart { path: path.clone() });
    }
    continue_in(beginning_of(&path));
    let baked = interruptible(|| merge(&args.parts, &path, &progress))?;
    tell(common, path, baked, &progress);
    Ok(())
}

fn tell(common: &Common, file: PathBuf, baked: BakedWorld, progress: &Progress) {
    let report = Report { file, baked, seconds: progress.phases(), peak_memory_bytes: peak_memory_bytes() };
    if common.json {
        say!("{}", output::json(&report));
        return;
    }
    let Report { file, baked, seconds, peak_memory_bytes } = &report;
    say!("{:14} {}, {}", "file", file.display(), output::bytes(baked.bytes));
    say!("{:14} {} of voxels of {} m, {} nodes", "patches", baked.leaves, baked.voxel_edge_m, baked.nodes);
    if baked.rows + baked.resumed_rows > 0 {
        say!(
            "{:14} {} at {:.0} a second, {} from before",
            "rows",
            baked.rows,
            baked.rows_per_second,
            baked.resumed_rows
        );
    }
    for (name, time) in seconds {
        say!("{:14} {time:.2} s", name);
    }
    if let Some(peak) = peak_memory_bytes {
        say!("{:14} {}", "peak memory", output::bytes(*peak));
    }
}

#[derive(Serialize)]
struct BakeInfo {
    file: PathBuf,
    bytes: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    part: Option<[u32; 2]>,
    scene: String,
    scene_hash: String,
    settings: Option<WorldSettings>,
    patches: u32,
    nodes: u32,
    roots: usize,
    area_m2: f64,
    voxel_edge_m: Option<f32>,
    shining_patches: Option<usize>,
    dark_places: Option<usize>,
    blocks: u32,
    rows: u64,
    entries: u64,
    entries_a_row: f64,
    mean_sky_factor: f64,
    mean_lost: f64,
    lost_blocks: Vec<String>,
}

/// Sums over the rows of a bake.
#[derive(Default)]
struct RowSums {
    rows: u64,
    entries: u64,
    sky: f64,
    lost: f64,
    /// Blocks that cannot be read, and why.
    broken: Vec<String>,
}

impl RowSums {
    fn of(file: &BakeFile) -> Self {
        let mut sums = Self::default();
        for block in file.head.own_blocks() {
            match file.records(block) {
                Ok(records) => {
                    sums.rows += records.len() as u64;
                    for record in &records {
                        sums.entries += record.factors.len() as u64;
                        sums.sky += f64::from(record.sky);
                        sums.lost += f64::from(record.lost);
                    }
                }
                Err(error) => sums.broken.push(error.to_string()),
            }
        }
        sums
    }
}

/// Says what a bake holds, and checks all of it.
pub fn info(common: &Common, path: &str) -> Result<(), Error> {
    common.native_only("info")?;
    let file = BakeFile::open(Path::new(path))?;
    let info = BakeInfo::of(&file)?;
    if common.json {
        say!("{}", output::json(&info));
    } else {
        info.print();
    }
    match info.lost_blocks.len() {
        0 => Ok(()),
        lost => Err(Error::LostBlocks { path: info.file, lost, blocks: info.blocks }),
    }
}

impl BakeInfo {
    fn of(file: &BakeFile) -> Result<Self, Error> {
        let settings: Option<WorldSettings> = serde_json::from_str(&file.text).ok();
        let extra = Extra::decode(&file.extra);
        let sums = RowSums::of(file);
        let rows = sums.rows.max(1) as f64;
        let leaves = &file.nodes[..file.head.leaves as usize];
        Ok(Self {
            file: file.path().to_path_buf(),
            bytes: file.bytes()?,
            part: file.head.part.map(|p| [p.number, p.of]),
            scene: settings.as_ref().map_or(String::new(), |s| s.scene.clone()),
            scene_hash: file.head.scene.iter().map(|byte| format!("{byte:02x}")).collect(),
            settings,
            patches: file.head.leaves,
            nodes: file.head.nodes,
            roots: file.nodes.iter().filter(|n| n.parent == localmatrix::NO_NODE).count(),
            area_m2: leaves.iter().map(|n| f64::from(n.area)).sum(),
            voxel_edge_m: extra.as_ref().map(|e| e.shape.edges.x),
            shining_patches: extra.as_ref().map(|e| e.emission.len()),
            dark_places: extra.as_ref().map(|e| e.dark.len()),
            blocks: file.head.own_blocks().len() as u32,
            rows: sums.rows,
            entries: sums.entries,
            entries_a_row: sums.entries as f64 / rows,
            mean_sky_factor: sums.sky / rows,
            mean_lost: sums.lost / rows,
            lost_blocks: sums.broken,
        })
    }

    fn print(&self) {
        let part = self.part.map_or(String::new(), |[k, n]| format!(", part {k} of {n}"));
        say!("{:14} {}, {}{part}", "bake", self.file.display(), output::bytes(self.bytes));
        say!("{:14} {} ({}…)", "scene", self.scene, &self.scene_hash[..16]);
        if let Some(s) = &self.settings {
            say!("{:14} {} rays a row, seed {}", "settings", s.rays, s.seed);
        }
        if let (Some(edge), Some(shining), Some(dark)) = (self.voxel_edge_m, self.shining_patches, self.dark_places) {
            say!("{:14} edge {edge} m, {shining} patches shine, {dark} places are dark", "voxels");
        }
        say!("{:14} {}, {:.0} m²", "patches", self.patches, self.area_m2);
        say!("{:14} {} with what is merged, {} of them roots", "nodes", self.nodes, self.roots);
        say!("{:14} {} in {} blocks, {:.1} entries each", "rows", self.rows, self.blocks, self.entries_a_row);
        say!("{:14} {:.3} of rays on average, lost {:.5}", "sky", self.mean_sky_factor, self.mean_lost);
        for line in &self.lost_blocks {
            say!("{:14} {line}", "lost");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts() {
        assert_eq!(parse_part("3/8"), Ok(Part { number: 3, of: 8 }));
        for wrong in ["", "3", "0/8", "9/8", "1/0", "a/b", "-1/2", "1/2/3"] {
            assert!(parse_part(wrong).is_err(), "{wrong}");
        }
    }
}
