//! A bake whose rays many machines trace: it goes on from one round of rows to the next, and the rows of each round are
//! traced in parts, which files carry.
//!
//! A round follows from the one before: where receivers are needed is known when those so far have rows. So one process
//! goes on to a round and writes its task beside the bake, `PATH.rounds/2.task`; others trace a part of it each,
//! `2-1-of-8.rows`; when all are there, one goes on to the next. The bytes are those of a bake that is made whole.

use std::fs::{self, File};
use std::io::{ErrorKind, Write as _};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use formfactor::{SkyBin, add_rows_of};
use localmatrix::{BakeError, Part};
use patches::{Columns, PatchMesh};
use scene::{SKY_BINS, Scene, SurfacePoint, sky_bin};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use transport::{HitCounts, Observer, Phase};

use crate::bake::{Bake, cut_scene, density_of};
use crate::error::{Error, Reason};
use crate::file::{FileSettings, file_error};
use crate::form_factors::ElementRows;
use crate::low_level::operator::OperatorKey;
use crate::observe::{Report, run_phase};

/// Most rounds of a bake: the elements, the first receivers, two rounds where light bends, two where no receiver is
/// seen.
pub const MAX_ROUNDS: u32 = 6;
/// The round of the elements' rows; receivers have those that follow.
const ELEMENTS: u32 = 1;

/// A round whose rows are to be traced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Round {
    /// Its number, from 1.
    pub number: u32,
    /// Number of rows.
    pub rows: usize,
}

/// What a part of a round needs.
#[derive(Serialize, Deserialize)]
struct Task {
    mesh: PatchMesh,
    #[serde(with = "scene::pod::table")]
    points: Vec<SurfacePoint>,
    #[serde(with = "scene::pod::table")]
    offsets: Vec<u32>,
    rays: u32,
    seed: u32,
    has_sky: bool,
}

/// Rows of a part of a round.
#[derive(Serialize, Deserialize)]
struct Rows {
    rows: HitCounts,
    sky_rows: HitCounts,
    #[serde(with = "scene::pod::table")]
    sky_factor: Vec<f32>,
}

/// The files of a bake's rounds, as far as it may go.
pub(crate) struct Rounds {
    folder: PathBuf,
    key: [u8; 32],
    /// The round whose rows need not be there.
    last: u32,
    /// Round of the next receivers, and rows of the round that waits.
    next: AtomicU32,
    waits: AtomicU32,
}

impl Rounds {
    fn new(path: &Path, key: [u8; 32], last: u32) -> Self {
        let mut name = path.as_os_str().to_owned();
        name.push(".rounds");
        let next = AtomicU32::new(ELEMENTS + 1);
        Self { folder: name.into(), key, last, next, waits: AtomicU32::new(0) }
    }

    /// Adds rows that others have traced, or writes what they need for it; then the error that this gives ends the
    /// bake, and is none.
    ///
    /// # Errors
    /// A part that is missing or damaged; files that cannot be written.
    pub fn add(
        &self,
        counts: &mut HitCounts,
        sky: Option<&mut HitCounts>,
        own: &ElementRows,
    ) -> Result<Vec<f32>, Error> {
        if own.offsets.len() <= 1 {
            return Ok(Vec::new());
        }
        let round = if sky.is_some() { self.next.fetch_add(1, Ordering::Relaxed) } else { ELEMENTS };
        if round >= self.last {
            let task = Task {
                mesh: own.mesh.clone(),
                points: own.points.to_vec(),
                offsets: own.offsets.to_vec(),
                rays: own.rays,
                seed: own.seed,
                has_sky: sky.is_some(),
            };
            fs::create_dir_all(&self.folder).map_err(|error| file_error(&self.folder, &error))?;
            self.write(&self.task(round), &task)?;
            self.waits.store(round, Ordering::Relaxed);
            return Err(Reason::RoundWaits { round }.into());
        }
        let mut sky_factor = Vec::new();
        let mut all = sky;
        for path in self.parts(round)? {
            let part: Rows = self.read(&path)?;
            counts.append(part.rows)?;
            if let Some(sky_rows) = &mut all {
                sky_rows.append(part.sky_rows)?;
            }
            sky_factor.extend(part.sky_factor);
        }
        Ok(sky_factor)
    }

    fn task(&self, round: u32) -> PathBuf {
        self.folder.join(format!("{round}.task"))
    }

    fn part(&self, round: u32, part: Part) -> PathBuf {
        self.folder.join(format!("{round}-{}-of-{}.rows", part.number, part.of))
    }

    /// The files of all parts of a round, in order.
    fn parts(&self, round: u32) -> Result<Vec<PathBuf>, Error> {
        let of = |name: &str| {
            let (_, of) = name.strip_prefix(&format!("{round}-"))?.strip_suffix(".rows")?.split_once("-of-")?;
            of.parse::<u32>().ok().filter(|&of| of > 0)
        };
        let names = fs::read_dir(&self.folder).map_err(|error| file_error(&self.folder, &error))?;
        let names = names.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        let Some(of) = names.filter_map(|name: String| of(&name)).max() else {
            return Err(Reason::MissingRows { round, path: self.part(round, Part { number: 1, of: 1 }) }.into());
        };
        let parts = (1..=of).map(|number| self.part(round, Part { number, of }));
        parts
            .map(|path| match path.exists() {
                true => Ok(path),
                false => Err(Reason::MissingRows { round, path }.into()),
            })
            .collect()
    }

    /// Writes a file under a name of its own, which it gets when it is whole: the key, a CRC-32, and the value.
    fn write<T: Serialize>(&self, path: &Path, value: &T) -> Result<(), Error> {
        let body = postcard::to_stdvec(value)
            .map_err(|error| Reason::Write { path: path.to_path_buf(), source: std::io::Error::other(error) })?;
        let beginning = localmatrix::beginning_of(path);
        let io = |error: std::io::Error| Error::from(file_error(&beginning, &error));
        let mut file = File::create(&beginning).map_err(io)?;
        file.write_all(&self.key).map_err(io)?;
        file.write_all(&crc32fast::hash(&body).to_le_bytes()).map_err(io)?;
        file.write_all(&body).map_err(io)?;
        file.sync_all().map_err(io)?;
        drop(file);
        fs::rename(&beginning, path).map_err(|error| file_error(path, &error).into())
    }

    fn read<T: DeserializeOwned>(&self, path: &Path) -> Result<T, Error> {
        let bytes = fs::read(path).map_err(|error| file_error(path, &error))?;
        let damaged = |reason: &str| BakeError::Damaged {
            path: path.display().to_string(),
            part: "the rows of a round",
            offset: 0,
            reason: reason.to_owned(),
        };
        let (Some(key), Some(sum), Some(body)) = (bytes.get(..32), bytes.get(32..36), bytes.get(36..)) else {
            return Err(damaged("it is cut off").into());
        };
        if key != self.key {
            let reason = "another scene, or other settings".to_owned();
            return Err(BakeError::OtherBeginning { path: path.display().to_string(), reason }.into());
        }
        if sum != crc32fast::hash(body).to_le_bytes() {
            return Err(damaged("its checksum is wrong").into());
        }
        postcard::from_bytes(body).map_err(|error| damaged(&error.to_string()).into())
    }
}

impl Bake {
    /// Goes on with a bake in a file to a round, whose task it writes beside the file, or to the end: then the round is
    /// `None`, and the files of the rounds are gone. The rows of all rounds before must be there. A bake that is there
    /// already is not made again.
    ///
    /// # Errors
    /// As [`Bake::build_into`]; a part of a round that is missing, damaged or of another bake.
    pub fn go_on_to(
        path: &Path,
        scene: &Scene,
        settings: &FileSettings,
        round: u32,
        observer: &dyn Observer,
    ) -> Result<Option<Round>, Error> {
        let operators = OperatorKey::of_all(&settings.methods, &settings.bake);
        let rounds = Rounds::new(path, settings.key(&operators), round);
        if Self::is_of(path, settings) {
            return Ok(None);
        }
        match Self::build_by_rounds(path, scene, settings, &rounds, observer) {
            Ok(_) => match fs::remove_dir_all(&rounds.folder) {
                Err(error) if error.kind() != ErrorKind::NotFound => Err(file_error(&rounds.folder, &error).into()),
                _ => Ok(None),
            },
            Err(error) => match rounds.waits.load(Ordering::Relaxed) {
                0 => Err(error),
                number => {
                    let task: Task = rounds.read(&rounds.task(number))?;
                    Ok(Some(Round { number, rows: task.offsets.len() - 1 }))
                }
            },
        }
    }

    /// Traces the rows of a part of a round; returns their number, 0 where the bake has no such round.
    ///
    /// # Errors
    /// A task that is missing, damaged or of another bake; cancellation.
    pub fn trace_round(
        path: &Path,
        scene: &Scene,
        settings: &FileSettings,
        (round, part): (u32, Part),
        observer: &dyn Observer,
    ) -> Result<usize, Error> {
        let operators = OperatorKey::of_all(&settings.methods, &settings.bake);
        let rounds = Rounds::new(path, settings.key(&operators), round);
        // Where the bake was done after fewer rounds.
        if !rounds.task(round).exists() && (Self::is_of(path, settings) || round > ELEMENTS + 1) {
            return Ok(0);
        }
        let Task { mesh, points, offsets, rays, seed, has_sky } = rounds.read(&rounds.task(round))?;
        let density = density_of(scene, &settings.bake, observer)?;
        let cut = cut_scene(scene, &density, &settings.bake)?;
        let scene = cut.as_ref().unwrap_or(scene);
        mesh.check(scene.geometry.triangles.len())?;
        let own = part_of(offsets.len() - 1, part);
        let mut made = Rows {
            rows: HitCounts::new(mesh.elements.len())?,
            sky_rows: HitCounts::new(if has_sky { SKY_BINS } else { 0 })?,
            sky_factor: Vec::new(),
        };
        let surfaces = mesh.lighting(scene, Columns::Elements, &points, &offsets, seed);
        let phase = if has_sky { Phase::RECEIVERS } else { Phase::FORM_FACTORS };
        made.sky_factor = run_phase(observer, phase, |report: &Report| {
            let sky = has_sky.then_some((&mut made.sky_rows, &sky_bin as &SkyBin));
            add_rows_of(&mut made.rows, sky, &surfaces, own.clone(), rays, &report)
        })?;
        rounds.write(&rounds.part(round, part), &made)?;
        Ok(own.len())
    }
}

/// The rows of a part.
fn part_of(rows: usize, part: Part) -> Range<usize> {
    let at = |number: u32| rows * number as usize / part.of.max(1) as usize;
    at(part.number - 1)..at(part.number)
}
