//! Bakes in files: written stage by stage, gone on with after an interruption, and opened without the scene's files.
//!
//! # Format, version 9
//!
//! | part | bytes |
//! |---|---|
//! | header | `PLBAKE\r\n`, version, `0x01020304` in the machine's order, key (32), 4 zeros, CRC-32 of these: 56 |
//! | section | `PART`, kind, length (8) and CRC-32 of its body, CRC-32 of these: 24; then the body |
//! | end | a section of kind 7 without a body |
//!
//! Numbers of headers are little-endian, tables in bodies have the order of the machine, which the header tells. The
//! key is the SHA-256 of all that decides the other bytes: version, the scene's hash, settings, operators. A body is a
//! structure in the encoding of the crate `postcard`, its tables the bytes that lie in memory ([`scene::pod`]):
//!
//! | kind | name | what |
//! |---|---|---|
//! | 1 | origin | [`Origin`] and [`BakeSettings`] |
//! | 2 | scene | geometry with its hierarchy and textures, materials, lighting |
//! | 3 | patches | [`PatchMesh`] |
//! | 4 | form factors | [`FormFactors`], density, how direct light is measured, bounces |
//! | 5 | receivers | [`MeshReceivers`], what the bake says of its errors ([`EnergyCheck`]), keys of the rows' random numbers |
//! | 6 | operator | a [`BakedOperator`]; one each |
//! | 8 | form factors of elements | in place of 4, for frames ([`Bake::save_for_frames`]) |
//!
//! Version 1 are worlds, whose format is that of `localmatrix`.

mod rounded;
mod sections;

use std::path::Path;
use std::sync::Arc;

use formfactor::RowKey;
use localmatrix::BakeError;
use patches::{Density, MeshReceivers, PatchMesh};
use runtime::cpu::Cpu;
use runtime::executor::Executor;
use scene::gpu::DirectParams;
use scene::{Geometry, Lighting, Material, Scene};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use transport::{HitCounts, LinearOperator as _, Observer, check_length};

use crate::bake::{Bake, BakeSettings, PatchBake, RowKeys, cut_scene, density_of};
use crate::energy::EnergyCheck;
use crate::error::{Error, Reason};
use crate::form_factors::{FormFactors, RowRays};
use crate::low_level::operator::{BakedOperator, Build, Decode, OperatorKey};
use crate::method::{MethodSettings, Preparation};
use crate::rounds::Rounds;

pub use localmatrix::beginning_of;
pub use sections::{HEAD_BYTES, Kind, Section};

pub(crate) use sections::file_error;
use sections::{SectionWriter, Sections, VERSION, version};

/// Source of a bake.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// The scene as the user named it.
    pub scene: String,
    /// SHA-256 over everything that decides a picture of it.
    pub scene_hash: [u8; 32],
    /// Data of the application: its cameras, names, exposure.
    #[serde(with = "scene::pod::table")]
    pub application: Vec<u8>,
}

/// Contents of a file.
#[derive(Clone, Debug)]
pub struct FileSettings {
    /// Source of the scene.
    pub origin: Origin,
    /// Settings of the bake.
    pub bake: BakeSettings,
    /// Methods whose operators are made and kept; methods without one need nothing of the file but the bake.
    pub methods: Vec<MethodSettings>,
    /// Place where operators are built.
    pub build: Build,
}

impl FileSettings {
    /// Settings of the bake without what changes no byte.
    fn kept(&self) -> BakeSettings {
        BakeSettings { memory_limit: None, ..self.bake }
    }

    /// Hash of all that decides the bytes, except the user's words.
    pub(crate) fn key(&self, operators: &[OperatorKey]) -> [u8; 32] {
        let text = serde_json::to_string(&(self.kept(), operators)).unwrap_or_default();
        let mut sum = Sha256::new();
        sum.update(VERSION.to_le_bytes());
        sum.update(self.origin.scene_hash);
        sum.update(text);
        sum.finalize().into()
    }
}

/// Head of a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Head {
    origin: Origin,
    settings: BakeSettings,
}

/// A scene with the materials that it had.
#[derive(Serialize, Deserialize)]
struct StoredScene {
    geometry: Arc<Geometry>,
    #[serde(with = "scene::pod::table")]
    materials: Arc<[Material]>,
    lighting: Lighting,
}

impl From<&Scene> for StoredScene {
    fn from(scene: &Scene) -> Self {
        Self {
            geometry: Arc::clone(&scene.geometry),
            materials: Arc::clone(&scene.materials),
            lighting: scene.lighting.clone(),
        }
    }
}

impl StoredScene {
    fn open(self) -> Result<Scene, Error> {
        let own = &self.geometry.materials;
        check_length("materials", own.len(), self.materials.len())?;
        let textures = |m: &Material| [m.albedo_texture, m.radiance_texture, m.mask_texture];
        if let Some(index) = (0..own.len()).find(|&k| textures(&own[k]) != textures(&self.materials[k])) {
            let rule = "one of the geometry, but for its emission";
            return Err(transport::Error::Value { name: "materials", index, value: index as f64, rule }.into());
        }
        let mut scene = Scene::under(self.geometry, self.lighting)?;
        scene.materials = self.materials;
        Ok(scene)
    }
}

/// Form factors with what follows from them.
#[derive(Serialize, Deserialize)]
struct StoredFactors {
    form_factors: FormFactors,
    density: Density,
    #[serde(with = "scene::pod::value")]
    direct: DirectParams,
    bounces: u32,
}

impl From<&Bake> for StoredFactors {
    fn from(bake: &Bake) -> Self {
        Self {
            form_factors: bake.form_factors.clone(),
            density: bake.density,
            direct: bake.direct,
            bounces: bake.bounces,
        }
    }
}

/// Form factors of elements, of which those of patches are made again, with what follows from them.
#[derive(Serialize, Deserialize)]
struct StoredRows {
    rows: HitCounts,
    #[serde(with = "scene::pod::table")]
    sky_factor: Vec<f32>,
    density: Density,
    #[serde(with = "scene::pod::value")]
    direct: DirectParams,
    bounces: u32,
}

impl StoredRows {
    fn open(self, mesh: &PatchMesh) -> Result<StoredFactors, Error> {
        let Self { rows, sky_factor, density, direct, bounces } = self;
        rows.check()?;
        check_length("rows of elements", mesh.elements.len(), rows.rows())?;
        check_length("columns of elements", mesh.elements.len(), rows.columns())?;
        let form_factors = FormFactors::of_rows(mesh, rows, sky_factor)?;
        Ok(StoredFactors { form_factors, density, direct, bounces })
    }
}

/// Receivers with the errors that the bake found when it had them.
#[derive(Serialize, Deserialize)]
struct StoredReceivers {
    receivers: MeshReceivers,
    energy: Option<EnergyCheck>,
    #[serde(with = "scene::pod::table")]
    keys: Vec<RowKey>,
}

/// A bake that was opened.
pub struct BakeFile {
    /// The bake, with the operators that the file has.
    pub bake: Bake,
    /// Source of the scene.
    pub origin: Origin,
    /// Its sections, in order.
    pub sections: Vec<Section>,
}

/// Kind of a bake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BakeKind {
    /// A scene: [`Bake::open`].
    Scene,
    /// A world that is streamed: [`crate::world`].
    World,
}

/// Kind of bake in a file, by its first [`HEAD_BYTES`]; none for another kind of file.
pub fn kind_of(head: &[u8]) -> Option<BakeKind> {
    match version(head)? {
        0 | 1 => Some(BakeKind::World),
        _ => Some(BakeKind::Scene),
    }
}

impl Bake {
    /// Bakes a scene into a file, and gives the bake; goes on where an interrupted run of the same ended. The bytes are
    /// the same for any number of threads and interruptions. `device` traces rays, as in [`Bake::build_on`], and may
    /// build operators.
    ///
    /// # Errors
    /// As [`Bake::build`]; [`Unsupported`](crate::ErrorKind::Unsupported) for operators of a scene with a medium; what
    /// the file says. What was made until then stays in `PATH.beginning` for the next run.
    pub fn build_into(
        path: &Path,
        scene: &Scene,
        settings: &FileSettings,
        device: &mut (dyn Executor + 'static),
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        Self::build_into_by(path, scene, settings, (device, None), observer)
    }

    /// [`Bake::build_into`] with rows that others trace, on the host otherwise.
    pub(crate) fn build_by_rounds(
        path: &Path,
        scene: &Scene,
        settings: &FileSettings,
        rounds: &Rounds,
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        Self::build_into_by(path, scene, settings, (&mut Cpu::new(), Some(rounds)), observer)
    }

    /// Returns true if a file is a whole bake with these settings.
    pub(crate) fn is_of(path: &Path, settings: &FileSettings) -> bool {
        let operators = OperatorKey::of_all(&settings.methods, &settings.bake);
        Sections::open(path).is_ok_and(|sections| sections.key == settings.key(&operators))
    }

    fn build_into_by(
        path: &Path,
        scene: &Scene,
        settings: &FileSettings,
        (device, rounds): (&mut (dyn Executor + 'static), Option<&Rounds>),
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        let operators = OperatorKey::of_all(&settings.methods, &settings.bake);
        if !operators.is_empty() && scene.has_medium() {
            return Err(Reason::Medium { what: "an operator of a method" }.into());
        }
        let mut writer = SectionWriter::begin(path, settings.key(&operators))?;
        let head = || Ok::<_, Error>(Head { origin: settings.origin.clone(), settings: settings.kept() });
        writer.section(Kind::Origin, head)?;
        let density = density_of(scene, &settings.bake, observer)?;
        let cut = cut_scene(scene, &density, &settings.bake)?;
        let scene = cut.as_ref().unwrap_or(scene);
        if writer.take::<StoredScene>(Kind::Scene)?.is_none() {
            writer.put(Kind::Scene, &StoredScene::from(scene))?;
        }
        let rays = &match rounds {
            Some(rounds) => RowRays::in_rounds(rounds),
            None => RowRays::on(device),
        };
        let patches = write_patches(&mut writer, scene, density, &settings.bake, rays, observer)?;
        let mut bake = match writer.take(Kind::Receivers)? {
            Some(StoredReceivers { receivers, energy, keys }) => {
                let bake = patches.bake().clone();
                let keys = RowKeys::new(settings.bake.seed, bake.mesh.elements.len(), keys);
                Bake { receivers, energy, keys, ..bake }
            }
            None => {
                let bake = patches.with_receivers_by(&settings.bake, rays, observer)?;
                let receivers = bake.receivers.clone();
                let energy = bake.energy;
                let keys = bake.keys.receivers.to_vec();
                writer.put(Kind::Receivers, &StoredReceivers { receivers, energy, keys })?;
                bake
            }
        };
        let shared = Arc::new(bake.clone());
        for key in operators.into_iter().filter(|_| !bake.mesh.patches.is_empty()) {
            let made = || {
                let eye = glam::Vec3::ZERO;
                let with = Preparation { bake: &shared, decode: Decode::Auto, build: &settings.build, eye, observer };
                Ok::<_, Error>(BakedOperator { key, operator: key.find_or_build(&with, device)? })
            };
            bake.operators.push(writer.section(Kind::Operator, made)?);
        }
        writer.finish()?;
        Ok(bake)
    }

    /// Keeps a bake that was made in memory, with its operators, in a file. The bytes are those of [`Bake::build_into`]
    /// with the same scene, settings and operators. What an interrupted run of the same left in `PATH.beginning` goes.
    ///
    /// # Errors
    /// What the file says: another kind of file has the name, or something else was begun under it.
    pub fn save(&self, path: &Path, origin: &Origin) -> Result<(), Error> {
        let settings =
            FileSettings { origin: origin.clone(), bake: self.settings, methods: Vec::new(), build: Build::default() };
        let operators: Vec<OperatorKey> = self.operators.iter().map(|own| own.key).collect();
        let mut writer = SectionWriter::begin(path, settings.key(&operators))?;
        writer.start_over()?;
        writer.put(Kind::Origin, &Head { origin: settings.origin.clone(), settings: settings.kept() })?;
        writer.put(Kind::Scene, &StoredScene::from(&self.scene))?;
        writer.put(Kind::Patches, &*self.mesh)?;
        writer.put(Kind::FormFactors, &StoredFactors::from(self))?;
        let keys = self.keys.receivers.to_vec();
        writer
            .put(Kind::Receivers, &StoredReceivers { receivers: self.receivers.clone(), energy: self.energy, keys })?;
        for operator in &self.operators {
            writer.put(Kind::Operator, operator)?;
        }
        Ok(writer.finish()?)
    }

    /// Keeps what frames need, for downloads: form factors of patches are left out, since they follow from those of
    /// elements, and operators and the keys of edits, which are made again; positions of samples and receivers are
    /// rounded to a fraction of a ray's offset, and their albedo and weights to 10 bits of fraction, for whoever packs the
    /// file. Light differs by less than 0.1 % from that of the whole bake.
    ///
    /// # Errors
    /// As [`Self::save`].
    pub fn save_for_frames(&self, path: &Path, origin: &Origin) -> Result<(), Error> {
        let mut own = Self { operators: Vec::new(), ..self.clone() };
        rounded::round(&mut own);
        let settings =
            FileSettings { origin: origin.clone(), bake: self.settings, methods: Vec::new(), build: Build::default() };
        let mut writer = SectionWriter::begin(path, settings.key(&[]))?;
        writer.start_over()?;
        writer.put(Kind::Origin, &Head { origin: settings.origin.clone(), settings: settings.kept() })?;
        writer.put(Kind::Scene, &StoredScene::from(&own.scene))?;
        writer.put(Kind::Patches, &*own.mesh)?;
        let FormFactors { element_rows, sky_factor, .. } = &own.form_factors;
        match element_rows {
            Some(rows) => {
                let (rows, sky_factor) = (HitCounts::clone(rows), sky_factor.clone());
                let Self { density, direct, bounces, .. } = own;
                writer.put(Kind::ElementRows, &StoredRows { rows, sky_factor, density, direct, bounces })?;
            }
            None => writer.put(Kind::FormFactors, &StoredFactors::from(&own))?,
        }
        let Self { receivers, energy, .. } = own;
        writer.put(Kind::Receivers, &StoredReceivers { receivers, energy, keys: Vec::new() })?;
        Ok(writer.finish()?)
    }

    /// Opens a bake of a scene; every section is checked.
    ///
    /// # Errors
    /// Another kind of file, another version, a section that was altered or cut; tables that do not fit together.
    pub fn open(path: &Path) -> Result<BakeFile, Error> {
        Self::of_sections(path, Sections::open(path)?)
    }

    /// Opens a bake whose bytes are in memory, such as one that came over a network; every section is checked. `name` is
    /// what errors call it.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn from_bytes(name: &str, bytes: Vec<u8>) -> Result<BakeFile, Error> {
        let name = Path::new(name);
        Self::of_sections(name, Sections::in_memory(name, bytes)?)
    }

    fn of_sections(path: &Path, sections: Sections) -> Result<BakeFile, Error> {
        let damaged = |error: Error| {
            let reason = error.to_string();
            Error::from(BakeError::Damaged { path: path.display().to_string(), part: "the tables", offset: 0, reason })
        };
        let head: Head = sections.read(sections.of(Kind::Origin)?)?;
        let places = [Kind::Scene, Kind::Patches, Kind::Receivers].map(|kind| sections.of(kind));
        let [scene, mesh, receivers] = places;
        let scene = scene?;
        let mesh = mesh?;
        let receivers = receivers?;
        let rows = sections.all.iter().find(|section| section.kind == Kind::ElementRows).copied();
        let factors = rows.map_or_else(|| sections.of(Kind::FormFactors), Ok)?;
        let ((scene, operators), (mesh, (factors, receivers))) = rayon::join(
            || {
                let scene = sections.read::<StoredScene>(scene).map_err(Error::from);
                let scene = scene.and_then(|stored| stored.open().map_err(damaged));
                let operators = sections.all.iter().filter(|section| section.kind == Kind::Operator);
                (scene, operators.map(|&section| sections.read(section)).collect::<Result<Vec<_>, _>>())
            },
            || {
                let mesh = sections.read::<PatchMesh>(mesh);
                (mesh, rayon::join(|| read_factors(&sections, factors), || sections.read(receivers)))
            },
        );
        let StoredReceivers { receivers, energy, keys } = receivers?;
        let mesh = mesh?;
        mesh.check(scene.as_ref().map_or(0, |scene| scene.geometry.triangles.len())).map_err(|e| damaged(e.into()))?;
        let StoredFactors { form_factors, density, direct, bounces } = match factors? {
            Ok(factors) => factors,
            Err(rows) => rows.open(&mesh).map_err(damaged)?,
        };
        let bake = Bake {
            scene: scene?,
            keys: RowKeys::new(head.settings.seed, mesh.elements.len(), keys),
            mesh: Arc::new(mesh),
            form_factors,
            receivers,
            density,
            energy,
            direct,
            bounces,
            settings: head.settings,
            operators: operators?,
        };
        check(&bake).map_err(damaged)?;
        Ok(BakeFile { bake, origin: head.origin, sections: sections.all })
    }
}

/// Form factors, or the rows of elements that they follow from.
fn read_factors(sections: &Sections, section: Section) -> Result<Result<StoredFactors, StoredRows>, Error> {
    Ok(match section.kind {
        Kind::ElementRows => Err(sections.read(section)?),
        _ => Ok(sections.read(section)?),
    })
}

/// Patches and form factors: those that the file has, or new ones into it.
fn write_patches<'a>(
    writer: &mut SectionWriter,
    scene: &'a Scene,
    density: Density,
    settings: &BakeSettings,
    rays: &'a RowRays<'_>,
    observer: &dyn Observer,
) -> Result<PatchBake<'a>, Error> {
    let mesh = writer.take::<PatchMesh>(Kind::Patches)?;
    let factors = writer.take::<StoredFactors>(Kind::FormFactors)?;
    let has_mesh = mesh.is_some();
    if let (Some(mesh), Some(StoredFactors { form_factors, density, direct, bounces })) = (mesh, factors) {
        let bake = Bake {
            scene: scene.clone(),
            keys: RowKeys::new(settings.seed, mesh.elements.len(), Vec::new()),
            mesh: Arc::new(mesh),
            form_factors,
            receivers: MeshReceivers::none(scene)?,
            density,
            energy: None,
            direct,
            bounces,
            settings: *settings,
            operators: Vec::new(),
        };
        return PatchBake::of(bake, scene, rays);
    }
    let patches = PatchBake::with_density(scene, density, settings, rays, observer)?;
    let bake = patches.bake();
    if !has_mesh {
        writer.put(Kind::Patches, &*bake.mesh)?;
    }
    writer.put(Kind::FormFactors, &StoredFactors::from(bake))?;
    Ok(patches)
}

/// Checks that the tables of a bake fit together, so that no frame reads beside them.
fn check(bake: &Bake) -> Result<(), Error> {
    let Bake { scene, mesh, form_factors, receivers, operators, .. } = bake;
    mesh.check(scene.geometry.triangles.len())?;
    let patches = mesh.patches.len();
    let elements = mesh.elements.len();
    form_factors.factors.check()?;
    check_length("form factors", patches, form_factors.factors.rows)?;
    check_length("columns of form factors", patches, form_factors.factors.columns)?;
    if let Some(rows) = &form_factors.element_rows {
        rows.check()?;
        check_length("rows of elements", elements, rows.rows())?;
        check_length("columns of elements", elements, rows.columns())?;
    }
    check_length("sky factors", elements, form_factors.sky_factor.len())?;
    check_length("samples", mesh.points.len(), bake.direct.count as usize)?;
    receivers.check(scene.geometry.triangles.len(), elements)?;
    // Files for frames have none.
    if !bake.keys.receivers.is_empty() {
        check_length("keys of receivers", receivers.points.len(), bake.keys.receivers.len())?;
    }
    for operator in operators {
        operator.operator.check(patches)?;
    }
    Ok(())
}
