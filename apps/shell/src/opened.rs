//! Bakes where programs take a scene: opened, or made.

use std::path::Path;
use std::time::SystemTime;

use crate::device::open;
use assets::import::{LoadedScene, load_or_build};
use localmatrix::BakeError;
use patchlight::file::Section;
use patchlight::low_level::operator::{BuildOn, Codec, OperatorKey};
use patchlight::method::FeedbackSettings;
use patchlight::{Bake, BakeFile, BakeSettings, MethodSettings, Origin};
use runtime::executor::{DeviceChoice, Executor};
use scene::Scene;

use crate::args::{Common, Method, OperatorSettings};
use crate::error::Error;
use crate::progress::{Progress, interruptible};

/// A bake that was opened.
pub struct Opened {
    /// The scene as the application knows it.
    pub loaded: LoadedScene,
    /// The bake.
    pub bake: Bake,
    /// Its source.
    pub origin: Origin,
    /// Its sections.
    pub sections: Vec<Section>,
    /// True if the scene has changed since.
    pub has_changed: bool,
}

impl Opened {
    /// Opens and checks a bake.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn new(path: &Path, progress: &Progress) -> Result<Self, Error> {
        let BakeFile { bake, origin, sections } = progress.phase("open", |_| Bake::open(path))?;
        let loaded = std::str::from_utf8(&origin.application)
            .map_err(|error| error.to_string())
            .and_then(|text| LoadedScene::of_description(bake.scene().clone(), text))
            .map_err(|reason| BakeError::Damaged {
                path: path.display().to_string(),
                part: "origin",
                offset: sections.first().map_or(0, |section| section.offset),
                reason,
            })?;
        let has_changed = has_changed(path, &loaded, &origin);
        Ok(Self { loaded, bake, origin, sections, has_changed })
    }

    /// Opens a bake, and says so where its scene has changed since.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn read(path: &Path, progress: &Progress) -> Result<Self, Error> {
        let opened = Self::new(path, progress)?;
        if opened.has_changed {
            progress.warn(&format!(
                "{} has changed since it was baked into {}; the light is that of the scene as it was: bake it again",
                opened.origin.scene,
                path.display()
            ));
        }
        Ok(opened)
    }

    /// A method with the operator that the bake has, where the options leave open which.
    ///
    /// # Errors
    /// [`Error::NotHeld`] where the bake has none that suits.
    pub fn method(
        &self,
        path: &Path,
        method: Method,
        asked: MethodSettings,
        options: &OperatorSettings,
    ) -> Result<MethodSettings, Error> {
        let Some(key) = OperatorKey::of(&asked, self.bake.settings()) else { return Ok(asked) };
        let held: Vec<OperatorKey> = self.bake.operators().iter().map(|baked| baked.key).collect();
        if self.bake.mesh().patches.is_empty() || held.contains(&key) {
            return Ok(asked);
        }
        let is_open = method == Method::Multibounce && options.codec.is_none() && options.epsilon.is_none();
        let suits = |held: &&OperatorKey| match (key, **held) {
            (OperatorKey::Bounces { codec, .. }, OperatorKey::Bounces { codec: other, .. }) => {
                let are_tiles = matches!((codec, other), (Codec::LowRank { .. }, Codec::LowRank { .. }));
                is_open || are_tiles && options.epsilon.is_none()
            }
            (OperatorKey::FormFactors { .. }, OperatorKey::FormFactors { .. }) => options.epsilon.is_none(),
            _ => false,
        };
        match (held.iter().find(suits), asked) {
            (Some(OperatorKey::Bounces { codec, .. }), _) => Ok(MethodSettings::Multibounce(*codec)),
            (Some(OperatorKey::FormFactors { epsilon }), MethodSettings::Feedback(settings)) => {
                Ok(MethodSettings::Feedback(FeedbackSettings { epsilon: *epsilon, ..settings }))
            }
            _ => {
                let asked = options_of(&key);
                let (name, more) = asked.split_once(' ').unwrap_or((&asked, ""));
                Err(Error::NotHeld {
                    path: path.to_path_buf(),
                    held: held.iter().map(options_of).collect(),
                    again: format!("--for {name} {more}"),
                    asked: asked.clone(),
                })
            }
        }
    }
}

/// The method of an operator, or one without.
pub fn operator_of(options: &OperatorSettings, method: Method) -> MethodSettings {
    match method {
        Method::LowRank => MethodSettings::Multibounce(options.low_rank()),
        Method::Multibounce => MethodSettings::Multibounce(options.storage()),
        Method::Feedback => {
            let FeedbackSettings { products, accelerated, .. } = FeedbackSettings::default();
            MethodSettings::Feedback(options.feedback(products, accelerated))
        }
        _ => MethodSettings::Classic,
    }
}

/// The method and options of `render` that take an operator.
pub fn options_of(key: &OperatorKey) -> String {
    match *key {
        OperatorKey::Bounces { codec: Codec::LowRank { epsilon }, .. } => format!("low_rank --epsilon {epsilon}"),
        OperatorKey::Bounces { codec, .. } => format!("multibounce --codec {}", codec.name()),
        OperatorKey::FormFactors { epsilon } => format!("feedback --epsilon {epsilon}"),
    }
}

/// The device that is asked for; a note where it is another one than a user may expect.
///
/// # Errors
/// A device that is not there, or lacks a feature.
pub fn open_device(common: &Common, progress: &Progress) -> Result<Box<dyn Executor>, Error> {
    let (executor, note) = open(&DeviceChoice::parse(&common.device))?;
    if let Some(note) = note {
        progress.note(&note);
    }
    Ok(executor)
}

/// Bakes a scene on the host, or on a device that is to.
///
/// # Errors
/// As [`Bake::build_on`]; cancellation.
pub fn build(
    device: &mut (dyn Executor + 'static),
    on: BuildOn,
    scene: &Scene,
    settings: &BakeSettings,
    progress: &Progress,
) -> Result<Bake, patchlight::Error> {
    interruptible(|| match on.is_device(device.device().kind) {
        true => Bake::build_on(device, scene, settings, progress),
        false => Bake::build(scene, settings, progress),
    })
}

/// Returns true if the scene of a bake, where it still lies where it lay, is another one by now. It is only read again
/// where one of its files is younger than the bake, or gone.
fn has_changed(bake: &Path, loaded: &LoadedScene, origin: &Origin) -> bool {
    let written = std::fs::metadata(bake).and_then(|meta| meta.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    Path::new(&origin.scene).is_file()
        && loaded.files.iter().any(|file| is_younger(file, written))
        && load_or_build(&origin.scene).map_or(true, |now| now.content_hash != origin.scene_hash)
}

/// Returns true if a file was changed after a time, or is gone.
pub fn is_younger(file: &Path, than: SystemTime) -> bool {
    !std::fs::metadata(file).and_then(|meta| meta.modified()).is_ok_and(|changed| changed <= than)
}

/// The method that a bake has the best operator for; photons where there is a medium.
pub fn best_method(bake: &Bake) -> Method {
    if bake.scene().has_medium() {
        return Method::Firstshot;
    }
    let has = |suits: fn(&OperatorKey) -> bool| bake.operators().iter().any(|baked| suits(&baked.key));
    if has(|key| matches!(key, OperatorKey::Bounces { codec: Codec::LowRank { .. }, .. })) {
        Method::LowRank
    } else if has(|key| matches!(key, OperatorKey::Bounces { .. })) {
        Method::Multibounce
    } else if has(|key| matches!(key, OperatorKey::FormFactors { .. })) {
        Method::Feedback
    } else {
        Method::Classic
    }
}
