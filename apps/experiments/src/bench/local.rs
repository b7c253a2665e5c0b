//! `bench local`: the matrix round a camera that moves, beside full radiosity: work, time, memory, pictures.

use glam::Vec3;
use reference::metrics::compare_pictures;
use reference::{Picture, PictureErrors, stops_to_scale};
use serde::Serialize;

use super::truth::Truth;
use super::{Machine, SCENES, Setup};
use crate::args::{Bench, CameraPath, Common};
use crate::error::Error;
use crate::errors::picture_errors;
use crate::output;
use crate::progress::{Progress, is_cancelled};
use crate::report::{Section, Table, page, significant};
use crate::sequence::{distance, flicker};
use crate::summary::PassTimes;
use assets::import::LoadedScene;
use patchlight::render::classic::{Bake, Classic, ClassicSettings, Estimator, PatchKind};
use patchlight::render::local::{LocalOptions, white};
use patchlight::render::operator::{Codec, Transport};
use runtime::executor::{DeviceChoice, open};

/// Patches of a scene, unless it is said.
const COUNT: u32 = 10_000;
/// Slots that are tried.
const SLOTS: [usize; 2] = [512, 1024];
/// Frames of a path, and how many apart those are whose pictures are compared.
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
    /// Of both together, the longest over the median.
    longest: f64,
    /// The matrix, and all that goes with it.
    bytes: u64,
    /// Beside full radiosity.
    classic: Distance,
    /// Beside all bounces between all patches, none merged, by the form factors that the matrix has, which are reciprocal.
    unmerged: Distance,
    /// Change of displayed values from frame to frame that at most one of a thousand exceeds, the greatest, in 255ths.
    flicker_255: f64,
}

/// How far from light that is computed otherwise.
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
    let (mut rows, mut views): (Vec<Row>, Vec<Shown>) = (Vec::new(), Vec::new());
    let results = |rows: &[Row], views: &[Shown]| {
        output::json(&Results { name: "local", machine: &machine, seed: common.seed, rows, views })
    };
    for scene in scenes {
        let progress = Progress::new(common.quiet);
        let loaded = output::import(scene, &progress)?;
        let truth = Truth::find(args.references.as_deref(), &loaded)?;
        for &count in &counts {
            let measuring = Measuring { common, args, loaded: &loaded, truth: truth.as_ref() };
            measuring.measure(count as usize, &progress, &mut |row, shown| {
                rows.extend(row);
                views.extend(shown);
                // What is known is kept when the rest fails or is stopped.
                output::write_text(&out.join("summary.json"), &results(&rows, &views))
            })?;
        }
        let section = Section {
            title: "The matrix round a camera".into(),
            text: vec![format!(
                "Measured on {}, {} threads. Work is counted in multiplications of all channels; a new matrix takes three times \
                 the cube of its patches.",
                machine.cpu, machine.threads
            )],
            figures: Vec::new(),
            strip: Vec::new(),
            tables: tables(&rows, &views),
            plots: Vec::new(),
        };
        output::write_text(&out.join("report.html"), &page("Patchlight: local matrix", &[], [&section]))?;
    }
    if common.json {
        println!("{}", results(&rows, &views));
    } else {
        tables(&rows, &views).iter().for_each(|table| println!("{}", table.markdown()));
        println!("{} shows the same", out.join("report.html").display());
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
        let Self { common, args, loaded, truth } = self;
        let settings = ClassicSettings {
            patches: PatchKind::suited(loaded.scene.geometry.triangles.len(), count),
            patch_count: count,
            estimator: Estimator::Hemisphere { rays: args.rays },
            receiver_rays: args.receiver_rays(),
            sub_frames: args.sub_frames,
            seed: common.seed,
            size: truth.map_or(args.size, Truth::size),
            ..ClassicSettings::default()
        };
        let bake = Bake::new(&loaded.scene, loaded.view.eye, settings, progress)?;
        let load = |transport: Transport, progress: &Progress| {
            let (executor, _) = open(&DeviceChoice::parse(&common.device))?;
            let device = executor.device().name.clone();
            Ok::<_, Error>((bake.clone().load(transport, executor, progress)?, device))
        };
        let mut classic = load(Transport::Classic, progress)?.0;
        if let Some(shown) = self.view("classic".into(), &mut classic)? {
            keep(None, Some(shown))?;
        }
        let mut all = load(Transport::Operator(Codec::Dense), progress)?.0;
        let patches = classic.patch_count();
        for slots in SLOTS.into_iter().filter(|slots| *slots < patches) {
            let transport =
                Transport::Local(LocalOptions { slots, white: white(loaded.exposure_stops), ..LocalOptions::DEFAULT });
            for (path, name) in
                [(CameraPath::Fly, "fly"), (CameraPath::Shuttle, "shuttle"), (CameraPath::Circle, "circle")]
            {
                let (mut light, device) = load(transport, progress)?;
                if path == CameraPath::Fly
                    && let Some(shown) = self.view(format!("local, {slots} slots"), &mut light)?
                {
                    keep(None, Some(shown))?;
                    (light, _) = load(transport, progress)?;
                }
                progress.note(&format!("{slots} slots, {name}:"));
                let row = self.path(&mut light, [&mut classic, &mut all], settings.size, path)?;
                keep(Some(Row { scene: loaded.name.clone(), device, path: name, slots, ..row }), None)?;
            }
        }
        Ok(())
    }

    /// The picture of the scene's own view against the reference, where there is one.
    fn view(&self, method: String, light: &mut Classic) -> Result<Option<Shown>, Error> {
        let Some(truth) = self.truth else { return Ok(None) };
        let loaded = self.loaded;
        let (width, height) = truth.size();
        let pictures = light.frame(&loaded.scene.lighting.lights, &loaded.view.camera(width, height), 0)?.pictures;
        let (full, _) = picture_errors(&pictures, &truth.pictures, loaded.exposure_stops)?;
        Ok(Some(Shown { scene: loaded.name.clone(), method, full }))
    }

    /// The frames of a path.
    fn path(
        &self,
        light: &mut Classic,
        mut full: [&mut Classic; 2],
        size: (u32, u32),
        path: CameraPath,
    ) -> Result<Row, Error> {
        let loaded = self.loaded;
        let (camera, lights) = (path.animation(loaded), &loaded.scene.lighting.lights);
        let scale = stops_to_scale(loaded.exposure_stops);
        let (mut before, mut apart, mut flickers) = (Vec::new(), [Distance::NONE; 2], 0.0f64);
        let (mut work, mut anew, mut product, mut moved, mut bytes) = (0u64, 0u64, 0u64, 0, 0);
        let (mut updates, mut products, mut both) = (Vec::new(), Vec::new(), Vec::new());
        for frame in 0..FRAMES {
            let view = camera.at(camera.duration() * frame as f32 / (FRAMES - 1) as f32).1;
            let of = |times: &[(String, f64)], name: &str| -> f64 {
                times.iter().filter(|(n, _)| n == name).map(|(_, ms)| ms).sum()
            };
            let times = if frame % COMPARED == 0 {
                let camera = view.camera(size.0, size.1);
                let ours = light.frame(lights, &camera, frame)?;
                let light = light.surface_irradiance()?;
                for (one, apart) in full.iter_mut().zip(&mut apart) {
                    let theirs = one.frame(lights, &camera, frame)?.pictures.full;
                    *apart = apart.with(scale, (&ours.pictures.full, &light), (&theirs, &one.surface_irradiance()?));
                }
                ours.times
            } else {
                light.look(view.eye);
                light.advance(lights)?
            };
            if is_cancelled() {
                return Err(Error::Cancelled);
            }
            let now = light.surface_irradiance()?;
            if before.len() == now.len() {
                flickers = flickers.max(flicker(&now, &before, scale));
            }
            before = now;
            // The first frame makes all ready.
            let Some(local) = light.local_frame().filter(|_| frame > 0) else { continue };
            (work, anew, product) = (work + local.step.work, anew + local.anew, product + local.product);
            (moved, bytes) = (moved + local.step.entered + local.step.left, bytes.max(local.bytes));
            let (update, method) = (of(&times, "update"), of(&times, "method"));
            updates.push(update);
            products.push(method);
            both.push(update + method);
        }
        let median = |times: &[f64]| PassTimes::of(times).unwrap_or(PassTimes { median_ms: 0.0, max_ms: 0.0 });
        let all = 3 * u64::from(FRAMES - 1) * (light.patch_count() as u64).pow(2);
        Ok(Row {
            scene: String::new(),
            method: "local",
            device: String::new(),
            path: "",
            patches: light.patch_count(),
            slots: 0,
            moved,
            times_less_work: anew as f64 / work.max(1) as f64,
            times_less_product: all as f64 / product.max(1) as f64,
            update_ms: median(&updates).median_ms,
            median_ms: median(&products).median_ms,
            longest: median(&both).max_ms / median(&both).median_ms.max(f64::MIN_POSITIVE),
            bytes,
            classic: apart[0],
            unmerged: apart[1],
            flicker_255: flickers,
        })
    }
}

fn tables(rows: &[Row], views: &[Shown]) -> Vec<Table> {
    let head = [
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
    let cells = |row: &Row| {
        vec![
            row.scene.clone(),
            row.path.to_owned(),
            row.patches.to_string(),
            row.slots.to_string(),
            row.moved.to_string(),
            format!("{:.1}", row.times_less_work),
            format!("{:.1}", row.times_less_product),
            format!("{:.2}", row.update_ms),
            format!("{:.2}", row.median_ms),
            format!("{:.2}", row.longest),
            output::bytes(row.bytes),
            format!("{:.4}", row.classic.ssim),
            format!("{:.2} %", 100.0 * row.classic.error),
            format!("{:.4}", row.unmerged.ssim),
            format!("{:.2} %", 100.0 * row.unmerged.error),
            format!("{:.2}/255", row.flicker_255),
        ]
    };
    let mut tables = vec![Table {
        caption: "Beside a new matrix in every frame, products with all patches, full radiosity, and all patches unmerged with the form factors of the matrix".into(),
        head: head.map(String::from).to_vec(),
        rows: rows.iter().map(cells).collect(),
    }];
    if !views.is_empty() {
        let cells = |shown: &Shown| {
            let PictureErrors { ssim, mse, psnr_db, .. } = shown.full;
            vec![
                shown.scene.clone(),
                shown.method.clone(),
                format!("{ssim:.4}"),
                significant(mse),
                format!("{psnr_db:.2}"),
            ]
        };
        tables.push(Table {
            caption: "The scene's view against the reference".into(),
            head: ["scene", "method", "SSIM", "MSE", "PSNR dB"].map(String::from).to_vec(),
            rows: views.iter().map(cells).collect(),
        });
    }
    tables
}
