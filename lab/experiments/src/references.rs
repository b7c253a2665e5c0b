//! Path-traced references that are made once and kept: sums that can be continued, the pictures, and their standard
//! errors.

use std::path::{Path, PathBuf};

use etcetera::BaseStrategy as _;
use patchlight::{Phase, Pictures};
use reference::path::{PathSettings, PathTracer};
use reference::{
    Accumulation, Judge, Picture, PictureFile as _, Precision, ReferenceData, ReferenceNoise, fingerprint,
};
use scene::math::luminance;
use serde::{Deserialize, Serialize};

use crate::error::Error;
use crate::output;
use crate::progress::Progress;
use assets::import::LoadedScene;

/// Paths a pixel that are traced between two savings.
const PATHS_AT_ONCE: u32 = 64;
/// Folder of the references in that of all programs' caches.
const FOLDER: [&str; 2] = ["patchlight", "references"];
/// File of the sums of a reference.
const SUMS: &str = "accumulation.bin";

/// A folder of references, each in a folder of its own named by its scene and by a hash of all that it depends on: the
/// scene, the camera, the picture's size and the settings of the path tracer.
pub struct ReferenceStore {
    folder: PathBuf,
}

/// A reference and what is known of its noise.
pub struct KeptReference {
    /// Pictures, W/m²/sr.
    pub pictures: Pictures,
    /// Standard errors of all light and of indirect light, as grey pictures, where they are known.
    pub standard_errors: Option<[Picture; 2]>,
    /// Paths a pixel, where they are known.
    pub paths: Option<u32>,
    /// Source of the pictures.
    pub source: String,
}

/// Noise of a reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptNoise {
    /// Paths a pixel.
    pub paths: u32,
    /// Noise of all light.
    pub full: ReferenceNoise,
    /// Noise of indirect light.
    pub indirect: ReferenceNoise,
}

/// reference.json of a reference: for people.
#[derive(Serialize)]
struct Card<'a> {
    scene: &'a str,
    size: (u32, u32),
    #[serde(flatten)]
    noise: Option<KeptNoise>,
}

impl KeptReference {
    /// Judge of pictures of all light.
    pub fn full(&self) -> Judge<'_> {
        self.judge(&self.pictures.full, 0)
    }

    /// Judge of pictures of indirect light.
    pub fn indirect(&self) -> Judge<'_> {
        self.judge(&self.pictures.indirect, 1)
    }

    fn judge<'a>(&'a self, reference: &'a Picture, part: usize) -> Judge<'a> {
        Judge {
            reference,
            standard_error: self.standard_errors.as_ref().map(|errors| &errors[part]),
            mean_light: f64::from(luminance(self.pictures.indirect.mean())),
        }
    }

    /// Its noise, where it is known.
    pub fn noise(&self) -> Option<KeptNoise> {
        Some(KeptNoise { paths: self.paths?, full: self.full().noise()?, indirect: self.indirect().noise()? })
    }

    /// Width and height of the pictures.
    pub fn size(&self) -> (u32, u32) {
        (self.pictures.full.width, self.pictures.full.height)
    }

    /// From `full.exr`, `direct.exr` and `indirect.exr` of the folder `SCENE` in a folder, made by whatever program;
    /// none where there is no such folder, or where it does not know indirect light.
    ///
    /// # Errors
    /// Names the file that is damaged.
    pub fn of_folder(folder: &Path, scene: &str) -> Result<Option<Self>, Error> {
        let folder = folder.join(scene);
        if !folder.join("full.exr").exists() {
            return Ok(None);
        }
        let data = ReferenceData::load(&folder)?;
        let Some(indirect) = data.indirect else { return Ok(None) };
        let direct = match data.direct {
            Some(direct) => direct,
            None => data.full.minus(&indirect)?,
        };
        let source = format!("the pictures of {}; their noise is not known", folder.display());
        let pictures = Pictures { full: data.full, direct, indirect };
        Ok(Some(Self { pictures, standard_errors: None, paths: None, source }))
    }
}

impl ReferenceStore {
    /// The given folder, or one in the user's cache folder.
    ///
    /// # Errors
    /// [`Error::NoCacheFolder`] where the system names none.
    pub fn open(folder: Option<&Path>) -> Result<Self, Error> {
        let folder = match folder {
            Some(folder) => folder.to_path_buf(),
            None => {
                let base = etcetera::choose_base_strategy().map_err(|e| Error::NoCacheFolder { why: e.to_string() })?;
                base.cache_dir().join(FOLDER[0]).join(FOLDER[1])
            }
        };
        Ok(Self { folder })
    }

    /// Folder of the references.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The reference of a scene in a picture size, of as many paths as there are.
    ///
    /// # Errors
    /// Names the file that is damaged.
    pub fn find(&self, loaded: &LoadedScene, size: (u32, u32)) -> Result<Option<KeptReference>, Error> {
        let job = Tracing::new(&self.folder, loaded, size);
        let path = job.folder.join(SUMS);
        if !path.is_file() {
            return Ok(None);
        }
        let sums = Accumulation::load(&path, &job.camera, job.settings, &job.mark)?;
        Ok(job.kept(&sums))
    }

    /// The reference of a scene with at least so many paths a pixel: traces those that are missing, and saves now and
    /// then. An end that was asked for loses nothing.
    ///
    /// # Errors
    /// [`shell::Error::Cancelled`], and what reading or writing gives.
    pub fn make(
        &self,
        loaded: &LoadedScene,
        size: (u32, u32),
        paths: u32,
        progress: &Progress,
    ) -> Result<KeptReference, Error> {
        let job = Tracing::new(&self.folder, loaded, size);
        output::make_folder(&job.folder)?;
        let path = job.folder.join(SUMS);
        let mut sums = match path.is_file() {
            true => Accumulation::load(&path, &job.camera, job.settings, &job.mark)?,
            false => Accumulation::new(&job.camera, job.settings),
        };
        let before = sums.samples();
        job.trace(&mut sums, paths, progress)?;
        let kept = job.kept(&sums).ok_or(Error::FewPaths { paths: sums.samples() })?;
        if sums.samples() > before {
            job.write(&kept)?;
        }
        Ok(kept)
    }
}

/// A reference that is made.
struct Tracing<'a> {
    folder: PathBuf,
    loaded: &'a LoadedScene,
    camera: scene::Camera,
    settings: PathSettings,
    mark: [u8; 32],
}

impl<'a> Tracing<'a> {
    fn new(store: &Path, loaded: &'a LoadedScene, size: (u32, u32)) -> Self {
        let camera = loaded.view.camera(size.0, size.1);
        let settings = PathSettings::default();
        let mark = fingerprint(&loaded.scene, &camera);
        // The mark knows scene and camera, and thereby the size; the name tells the settings, too.
        let hash: String = mark[..8].iter().map(|byte| format!("{byte:02x}")).collect();
        let name = format!("{}-{hash}-{:x}-{:x}", loaded.name, settings.seed, settings.bounces);
        Self { folder: store.join(name), loaded, camera, settings, mark }
    }

    fn trace(&self, sums: &mut Accumulation, paths: u32, progress: &Progress) -> Result<(), Error> {
        let tracer = PathTracer::new(&self.loaded.scene);
        let path = self.folder.join(SUMS);
        let finished = progress.phase(Phase::PATHS.name(), |report| -> Result<bool, Error> {
            while sums.samples() < paths {
                let next = (sums.samples() + PATHS_AT_ONCE).min(paths);
                let continues =
                    tracer.accumulate(&self.camera, sums, next, |done, _| report(done as usize, paths as usize))?;
                sums.save(&path, &self.mark)?;
                if !continues {
                    return Ok(false);
                }
            }
            Ok(true)
        })?;
        if finished { Ok(()) } else { Err(shell::Error::Cancelled.into()) }
    }

    /// The pictures of sums; none of fewer than two passes, which do not tell their noise.
    fn kept(&self, sums: &Accumulation) -> Option<KeptReference> {
        let standard_errors = [sums.full_standard_error()?, sums.indirect_standard_error()?];
        let source = format!(
            "{} paths a pixel of this project's path tracer, {} × {}",
            sums.samples(),
            self.camera.width,
            self.camera.height
        );
        Some(KeptReference {
            pictures: Pictures { full: sums.full(), direct: sums.direct(), indirect: sums.indirect() },
            standard_errors: Some(standard_errors),
            paths: Some(sums.samples()),
            source,
        })
    }

    /// Writes the pictures and what they are, for people and for `--reference`.
    fn write(&self, kept: &KeptReference) -> Result<(), Error> {
        let transform = reference::DisplayTransform::clipped(self.loaded.exposure_stops);
        output::write_pictures(&self.folder, &kept.pictures, &transform)?;
        for (name, error) in ["full-error.exr", "indirect-error.exr"].iter().zip(kept.standard_errors.iter().flatten())
        {
            error.write_exr(&self.folder.join(name), Precision::Single)?;
        }
        let card = Card { scene: &self.loaded.name, size: kept.size(), noise: kept.noise() };
        Ok(output::write_text(&self.folder.join("reference.json"), &output::json(&card))?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use assets::procedural;

    const SIZE: (u32, u32) = (16, 12);

    #[test]
    fn a_reference_is_made_once_and_goes_on_from_what_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let store = ReferenceStore::open(Some(folder.path())).unwrap();
        let quiet = Progress::new(true);
        let loaded = procedural::build("stripes").unwrap();
        assert!(store.find(&loaded, SIZE).unwrap().is_none());
        let first = store.make(&loaded, SIZE, 16, &quiet).unwrap();
        let found = store.find(&loaded, SIZE).unwrap().unwrap();
        assert_eq!((found.paths, &found.pictures.full), (Some(16), &first.pictures.full));
        // More paths go on; fewer change nothing; the bits are those of one run.
        let more = store.make(&loaded, SIZE, 32, &quiet).unwrap();
        let fewer = store.make(&loaded, SIZE, 16, &quiet).unwrap();
        assert_eq!((more.paths, fewer.paths), (Some(32), Some(32)));
        let other = tempfile::tempdir().unwrap();
        let at_once = ReferenceStore::open(Some(other.path())).unwrap().make(&loaded, SIZE, 32, &quiet).unwrap();
        assert_eq!(at_once.pictures.full, more.pictures.full);
        assert_ne!(first.pictures.full, more.pictures.full);
        // Another scene, and another size, are other references.
        let gap = procedural::build("stripes:gap=2").unwrap();
        assert!(store.find(&gap, SIZE).unwrap().is_none() && store.find(&loaded, (12, 16)).unwrap().is_none());
        let own = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
        for name in ["full.exr", "indirect.png", "full-error.exr", "indirect-error.exr", "reference.json"] {
            assert!(own.join(name).is_file(), "{name}");
        }
    }

    #[test]
    fn a_damaged_reference_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let store = ReferenceStore::open(Some(folder.path())).unwrap();
        let loaded = procedural::build("cornell").unwrap();
        store.make(&loaded, SIZE, 16, &Progress::new(true)).unwrap();
        let own = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path().join(SUMS);
        let mut bytes = std::fs::read(&own).unwrap();
        bytes[100] ^= 1;
        std::fs::write(&own, bytes).unwrap();
        let error = store.find(&loaded, SIZE).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(SUMS) && error.contains("delete it"), "{error}");
    }

    #[test]
    fn pictures_of_other_programs_are_taken_without_their_noise() {
        let folder = tempfile::tempdir().unwrap();
        assert!(KeptReference::of_folder(folder.path(), "a").unwrap().is_none());
        let place = folder.path().join("a");
        output::make_folder(&place).unwrap();
        let full = Picture::from_pixels(1, 1, vec![glam::Vec3::splat(2.0)]).unwrap();
        let direct = Picture::from_pixels(1, 1, vec![glam::Vec3::splat(0.5)]).unwrap();
        full.write_exr(&place.join("full.exr"), Precision::Single).unwrap();
        direct.write_exr(&place.join("direct.exr"), Precision::Single).unwrap();
        let found = KeptReference::of_folder(folder.path(), "a").unwrap().unwrap();
        assert!((found.full().mean_light - 1.5).abs() < 1e-6 && found.noise().is_none());
    }
}
