//! Conditions of experiments: the machine, the output folder, scenes and settings of their bakes.

use std::path::PathBuf;
use std::sync::Arc;

use assets::LoadedScene;
use patchlight::{Bake, BakeSettings, Estimator, LightSettings, PictureRenderer, PictureSettings};
use runtime::executor::{DeviceChoice, DeviceKind};
use serde::{Deserialize, Serialize};
use shell::device::open;

use crate::args::{Bench, Common};
use crate::bandwidth::stream_gb_s;
use crate::error::Error;
use crate::output;
use crate::progress::Progress;

/// Scenes of an experiment that names none.
pub const SCENES: [&str; 2] = ["cornell", "atrium"];
/// Bytes that are read to measure the bandwidth, more than caches hold, and how often.
const STREAM_BYTES: usize = 256 << 20;
const STREAM_ROUNDS: usize = 3;

/// Machine that the numbers were measured on.
#[derive(Clone, Serialize, Deserialize)]
pub struct Machine {
    pub cpu: String,
    /// The Vulkan device, where one runs the kernels.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub gpu: Option<String>,
    pub threads: usize,
    pub stream_gb_s: f64,
}

/// Output folder, device and scenes of an experiment.
pub struct Setup<'a> {
    pub out: PathBuf,
    pub machine: Machine,
    pub scenes: Vec<&'a str>,
    /// Patches.
    pub counts: Vec<u32>,
}

impl<'a> Setup<'a> {
    /// Makes the folder, and takes these scenes and counts where none are given.
    pub fn new(
        common: &Common,
        args: &'a Bench,
        name: &str,
        scenes: &[&'static str],
        counts: &[u32],
    ) -> Result<Self, Error> {
        let out = output::folder_or(&common.out, &format!("bench-{name}"));
        output::make_folder(&out)?;
        let given = args.scenes.iter().map(String::as_str);
        Ok(Self {
            out,
            machine: Machine::find(common)?,
            scenes: if args.scenes.is_empty() { scenes.to_vec() } else { given.collect() },
            counts: if args.counts.is_empty() { counts.to_vec() } else { args.counts.clone() },
        })
    }
}

/// The scene of an experiment that measures one.
///
/// # Errors
/// [`Error::OneScene`].
pub fn one_scene<'a>(args: &'a Bench, usual: &'a str, experiment: &'static str) -> Result<&'a str, Error> {
    match &args.scenes[..] {
        [] => Ok(usual),
        [scene] => Ok(scene),
        more => Err(Error::OneScene { experiment, found: more.len() }),
    }
}

/// Settings of a bake of so many patches of a scene.
pub fn bake_settings(common: &Common, args: &Bench, loaded: &LoadedScene, count: usize) -> BakeSettings {
    BakeSettings::default()
        .with_patch_count(count)
        .with_focus(args.focus.focus(loaded, &loaded.animation))
        .with_estimator(Estimator::Hemisphere { rays: args.rays })
        .with_receiver_rays(args.receiver_rays())
        .with_seed(common.seed)
}

/// Puts a bake on the device of the options. What there is to say of the device was said when the
/// machine was described.
pub fn load(
    common: &Common,
    bake: &Arc<Bake>,
    light: &LightSettings,
    pictures: &PictureSettings,
    progress: &Progress,
) -> Result<PictureRenderer, Error> {
    let (executor, _) = open(&DeviceChoice::parse(&common.device))?;
    Ok(PictureRenderer::of_bake(Arc::clone(bake), executor, light, pictures, progress)?)
}

impl Machine {
    /// This one, with the device of the options.
    pub fn find(common: &Common) -> Result<Self, Error> {
        let (executor, note) = open(&DeviceChoice::parse(&common.device))?;
        if let (Some(note), false) = (note, common.quiet) {
            tell!("{note}");
        }
        let device = executor.device();
        let gpu = (device.kind != DeviceKind::Native).then(|| device.name.clone());
        let stream_gb_s = stream_gb_s(STREAM_BYTES, STREAM_ROUNDS);
        Ok(Self { cpu: runtime::cpu::processor_name(), gpu, threads: rayon::current_num_threads(), stream_gb_s })
    }

    /// Sentence for a report.
    pub fn sentence(&self) -> String {
        format!(
            "Measured on {}{}, {} threads, reading {:.1} GB/s.",
            self.cpu,
            self.gpu.as_ref().map(|gpu| format!(", kernels on {gpu}")).unwrap_or_default(),
            self.threads,
            self.stream_gb_s
        )
    }
}
