//! `bench local`: the matrix round a camera that moves, beside full radiosity: work, time, memory, pictures.

use std::sync::Arc;

use glam::Vec3;
use localmatrix::CameraFrame;
use reference::metrics::compare_pictures;
use reference::{Picture, PictureErrors, stops_to_scale};
use serde::Serialize;

use super::setup::{Machine, SCENES, Setup, bake_settings, load};
use super::truth::Truth;
use crate::args::{Bench, CameraPath, Common};
use crate::error::Error;
use crate::errors::picture_errors;
use crate::output;
use crate::progress::{Progress, interruptible, is_cancelled};
use crate::report::{Section, Table, page, significant};
use crate::sequence::{distance, flicker, pass_ms};
use crate::summary::PassTimes;
use assets::import::LoadedScene;
use patchlight::low_level::operator::Codec;
use patchlight::method::LocalSettings;
use patchlight::method::local::{Local, display_white};
use patchlight::{Bake, LightSettings, MethodSettings, PictureRenderer, PictureSettings};
use scene::Camera;

/// Patches of a scene, unless it is said.
const COUNT: u32 = 10_000;
/// Slots that are tried.
const SLOTS: [usize; 2] = [512, 1024];
/// Paths that are flown.
const PATHS: [(CameraPath, &str); 3] =
    [(CameraPath::Fly, "fly"), (CameraPath::Shuttle, "shuttle"), (CameraPath::Circle, "circle")];
/// Frames of a path, and the interval of those whose pictures are compared.
const FRAMES: u32 = 120;
const COMPARED: u32 = 15;

/// A measurement.
#[derive(Clone, Debug, Serialize)]
struct Row {
    scene: String,
    method: &'static str,
    device: String,
    path: &'static str,
    patches: usize,
    slots: usize,
    /// Patches that entered or left.
    moved: usize,
    /// Work of making the matrix anew in every frame, over that of the changes; and over the product with all patches.
    times_less_work: f64,
    times_less_product: f64,
    /// Changes of the matrix, and products with it.
    update_ms: f64,
    median_ms: f64,
    /// Longest time of both together, over the median.
    longest: f64,
    /// The matrix, and all that goes with it.
    bytes: u64,
    /// Beside full radiosity.
    classic: Distance,
    /// Beside all bounces between all patches, none merged, by the form factors that the matrix has, which are
    /// reciprocal.
    unmerged: Distance,
    /// Change of displayed values from frame to frame that at most one of a thousand exceeds, the greatest, in 255ths.
    flicker_255: f64,
}

/// Distance from light that is computed otherwise.
#[derive(Clone, Copy, Debug, Serialize)]
struct Distance {
    /// Least SSIM of pictures.
    ssim: f64,
    /// Relative L2 distance of the surface's irradiance, the greatest.
    error: f64,
}

impl Distance {
    const NONE: Self = Self { ssim: 1.0, error: 0.0 };

    /// The worse of this and what a frame shows.
    fn with(self, scale: f32, ours: (&Picture, &[Vec3]), theirs: (&Picture, &[Vec3])) -> Self {
        // Nothing to compare where the camera sees only black.
        let ssim = compare_pictures(ours.0, theirs.0, scale, None).map_or(1.0, |errors| errors.ssim);
        Self { ssim: self.ssim.min(ssim), error: self.error.max(distance(ours.1, theirs.1)) }
    }
}

/// Pictures from the scene's own view against the reference.
#[derive(Clone, Debug, Serialize)]
struct Shown {
    scene: String,
    method: String,
    full: PictureErrors,
}

#[derive(Serialize)]
struct Results<'a> {
    name: &'static str,
    machine: &'a Machine,
    seed: u32,
    rows: &'a [Row],
    views: &'a [Shown],
}

pub fn run(common: &Common, args: &Bench) -> Result<(), Error> {
    let Setup { out, machine, scenes, counts } = Setup::new(common, args, "local", &SCENES, &[COUNT])?;
    let mut rows: Vec<Row> = Vec::new();
    let mut views: Vec<Shown> = Vec::new();
    let results = |rows: &[Row], views: &[Shown]| {
        output::json(&Results { name: "local", machine: &machine, seed: common.seed, rows, views })
    };
    for scene in scenes {
        let progress = Progress::new(common.quiet);
        let loaded = output::import_flat(scene, &progress)?;
        let truth = Truth::find(args.reference_folder(), &loaded)?;
        for &count in &counts {
            let measuring = Measuring { common, args, loaded: &loaded, truth: truth.as_ref() };
            measuring.measure(count as usize, &progress, &mut |row, shown| {
                rows.extend(row);
                views.extend(shown);
                // What is known is kept when the rest fails or is stopped.
                Ok(output::write_text(&out.join("summary.json"), &results(&rows, &views))?)
            })?;
        }
        let section = Section {
            title: "The matrix round a camera".into(),
            text: vec![format!(
                "Measured on {}, {} threads. Work is counted in multiplications of all channels; a new matrix takes \
                 three times the cube of its patches.",
                machine.cpu, machine.threads
            )],

            tables: tables(&rows, &views),
            ..Section::default()
        };
        output::write_text(&out.join("report.html"), &page("Patchlight: local matrix", &[], [&section]))?;
    }
    if common.json {
        say!("{}", results(&rows, &views));
    } else {
        tables(&rows, &views).iter().for_each(|table| say!("{}", table.markdown()));
        say!("{} shows the same", out.join("report.html").display());
    }
    Ok(())
}

struct Measuring<'a> {
    common: &'a Common,
    args: &'a Bench,
    loaded: &'a LoadedScene,
    truth: Option<&'a Truth>,
}

impl Measuring<'_> {
    fn measure(
        &self,
        count: usize,
        progress: &Progress,
        keep: &mut dyn FnMut(Option<Row>, Option<Shown>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let loaded = self.loaded;
        let settings = bake_settings(self.common, self.args, loaded, count);
        let bake = Arc::new(Bake::build(&loaded.scene, &settings, progress)?);
        let mut full = Full {
            classic: self.load(&bake, MethodSettings::Classic, progress)?,
            unmerged: self.load(&bake, MethodSettings::Multibounce(Codec::Dense), progress)?,
        };
        if let Some(shown) = self.view("classic".into(), &mut full.classic)? {
            keep(None, Some(shown))?;
        }
        let patches = bake.mesh().patches.len();
        for slots in SLOTS.into_iter().filter(|slots| *slots < patches) {
            let display_white = display_white(loaded.exposure_stops);
            let method = MethodSettings::Local(LocalSettings { slots, display_white, ..LocalSettings::DEFAULT });
            for (path, name) in PATHS {
                let mut light = self.load(&bake, method, progress)?;
                if path == CameraPath::Fly
                    && let Some(shown) = self.view(format!("local, {slots} slots"), &mut light)?
                {
                    keep(None, Some(shown))?;
                    light = self.load(&bake, method, progress)?;
                }
                progress.note(&format!("{slots} slots, {name}:"));
                let flown = self.fly(&mut light, &mut full, path)?;
                let device = light.light_mut().executor_mut().device().name.clone();
                keep(Some(Row { device, path: name, slots, ..flown.row(&loaded.name, patches) }), None)?;
            }
        }
        Ok(())
    }

    /// Width and height of the pictures.
    fn size(&self) -> (u32, u32) {
        self.truth.map_or(self.args.size(), Truth::size)
    }

    fn load(&self, bake: &Arc<Bake>, method: MethodSettings, progress: &Progress) -> Result<PictureRenderer, Error> {
        let light = LightSettings::default().with_method(method).with_eye(self.loaded.view.eye);
        let pictures = PictureSettings::default().with_size(self.size()).with_sub_frames(self.args.sub_frames);
        load(self.common, bake, &light, &pictures, progress)
    }

    /// The picture of the scene's own view against the reference, where there is one.
    fn view(&self, method: String, light: &mut PictureRenderer) -> Result<Option<Shown>, Error> {
        let Some(truth) = self.truth else { return Ok(None) };
        let loaded = self.loaded;
        let (width, height) = truth.size();
        let camera = loaded.view.camera(width, height);
        let pictures = interruptible(|| light.picture(&loaded.scene.lighting, &camera, 0))?.pictures;
        let (full, _) = picture_errors(&pictures, &truth.pictures, loaded.exposure_stops)?;
        Ok(Some(Shown { scene: loaded.name.clone(), method, full }))
    }

    /// The frames of a path.
    fn fly(&self, light: &mut PictureRenderer, full: &mut Full, path: CameraPath) -> Result<Flown, Error> {
        let path = path.animation(self.loaded);
        let (width, height) = self.size();
        let scale = stops_to_scale(self.loaded.exposure_stops);
        let mut flown = Flown::default();
        let mut before = Vec::new();
        for frame in 0..FRAMES {
            let view = path.at(path.duration() * frame as f32 / (FRAMES - 1) as f32).1;
            let camera = view.camera(width, height);
            let times = match frame % COMPARED {
                0 => self.compare(light, full, &camera, frame, &mut flown)?,
                _ => interruptible(|| light.advance(&self.loaded.scene.lighting, &camera))?,
            };
            if is_cancelled() {
                return Err(shell::Error::Cancelled.into());
            }
            let now = light.light_mut().surface_irradiance()?;
            if before.len() == now.len() {
                flown.flicker = flown.flicker.max(flicker(&now, &before, scale));
            }
            before = now;
            // The first frame makes all ready.
            if let Some(local) = light.light_mut().counted_method::<Local>()?.filter(|_| frame > 0) {
                flown.add(local.last_frame(), &times);
            }
        }
        Ok(flown)
    }

    /// A frame whose picture and light are compared with those of full radiosity; milliseconds of
    /// its passes.
    fn compare(
        &self,
        light: &mut PictureRenderer,
        full: &mut Full,
        camera: &Camera,
        frame: u32,
        flown: &mut Flown,
    ) -> Result<Vec<(String, f64)>, Error> {
        let lighting = &self.loaded.scene.lighting;
        let scale = stops_to_scale(self.loaded.exposure_stops);
        let ours = interruptible(|| light.picture(lighting, camera, frame))?;
        let irradiance = light.light_mut().surface_irradiance()?;
        for (one, difference) in [(&mut full.classic, &mut flown.classic), (&mut full.unmerged, &mut flown.unmerged)] {
            let theirs = interruptible(|| one.picture(lighting, camera, frame))?.pictures.full;
            let their_irradiance = one.light_mut().surface_irradiance()?;
            *difference = difference.with(scale, (&ours.pictures.full, &irradiance), (&theirs, &their_irradiance));
        }
        Ok(ours.times)
    }
}

/// Matrix to compare with.
struct Full {
    classic: PictureRenderer,
    unmerged: PictureRenderer,
}

/// Work of the frames of a path, all but the first.
struct Flown {
    classic: Distance,
    unmerged: Distance,
    flicker: f64,
    work: u64,
    anew: u64,
    product: u64,
    moved: usize,
    bytes: u64,
    update_ms: Vec<f64>,
    product_ms: Vec<f64>,
}

impl Default for Flown {
    fn default() -> Self {
        Self {
            classic: Distance::NONE,
            unmerged: Distance::NONE,
            flicker: 0.0,
            work: 0,
            anew: 0,
            product: 0,
            moved: 0,
            bytes: 0,
            update_ms: Vec::new(),
            product_ms: Vec::new(),
        }
    }
}

impl Flown {
    fn add(&mut self, local: &CameraFrame, times: &[(String, f64)]) {
        self.work += local.step.work;
        self.anew += local.anew;
        self.product += local.product;
        self.moved += local.step.entered + local.step.left;
        self.bytes = self.bytes.max(local.bytes);
        self.update_ms.push(pass_ms(times, "update"));
        self.product_ms.push(pass_ms(times, "method"));
    }

    /// The row of a scene of so many patches.
    fn row(&self, scene: &str, patches: usize) -> Row {
        let both: Vec<f64> =
            self.update_ms.iter().zip(&self.product_ms).map(|(update, product)| update + product).collect();
        let both = summarised(&both);
        let all = 3 * u64::from(FRAMES - 1) * (patches as u64).pow(2);
        Row {
            scene: scene.to_owned(),
            method: "local",
            device: String::new(),
            path: "",
            patches,
            slots: 0,
            moved: self.moved,
            times_less_work: self.anew as f64 / self.work.max(1) as f64,
            times_less_product: all as f64 / self.product.max(1) as f64,
            update_ms: summarised(&self.update_ms).median_ms,
            median_ms: summarised(&self.product_ms).median_ms,
            longest: both.max_ms / both.median_ms.max(f64::MIN_POSITIVE),
            bytes: self.bytes,
            classic: self.classic,
            unmerged: self.unmerged,
            flicker_255: self.flicker,
        }
    }
}

fn summarised(times: &[f64]) -> PassTimes {
    PassTimes::of(times).unwrap_or(PassTimes { median_ms: 0.0, max_ms: 0.0 })
}

const HEAD: [&str; 16] = [
    "scene",
    "path",
    "patches",
    "slots",
    "came or went",
    "work: times less",
    "product: times less",
    "update ms",
    "product ms",
    "longest / median",
    "memory",
    "full radiosity: SSIM",
    "error",
    "unmerged: SSIM",
    "error",
    "flicker",
];

impl Row {
    fn cells(&self) -> Vec<String> {
        vec![
            self.scene.clone(),
            self.path.to_owned(),
            self.patches.to_string(),
            self.slots.to_string(),
            self.moved.to_string(),
            format!("{:.1}", self.times_less_work),
            format!("{:.1}", self.times_less_product),
            format!("{:.2}", self.update_ms),
            format!("{:.2}", self.median_ms),
            format!("{:.2}", self.longest),
            output::bytes(self.bytes),
            format!("{:.4}", self.classic.ssim),
            format!("{:.2} %", 100.0 * self.classic.error),
            format!("{:.4}", self.unmerged.ssim),
            format!("{:.2} %", 100.0 * self.unmerged.error),
            format!("{:.2}/255", self.flicker_255),
        ]
    }
}

impl Shown {
    fn cells(&self) -> Vec<String> {
        let PictureErrors { ssim, mse, psnr_db, .. } = self.full;
        vec![self.scene.clone(), self.method.clone(), format!("{ssim:.4}"), significant(mse), format!("{psnr_db:.2}")]
    }
}

fn tables(rows: &[Row], views: &[Shown]) -> Vec<Table> {
    let caption = "Beside a new matrix in every frame, products with all patches, full radiosity, and all patches \
                   unmerged with the form factors of the matrix";
    let mut tables = vec![Table {
        caption: caption.into(),
        head: HEAD.map(String::from).to_vec(),
        rows: rows.iter().map(Row::cells).collect(),
    }];
    if !views.is_empty() {
        tables.push(Table {
            caption: "The scene's view against the reference".into(),
            head: ["scene", "method", "SSIM", "MSE", "PSNR dB"].map(String::from).to_vec(),
            rows: views.iter().map(Shown::cells).collect(),
        });
    }
    tables
}
