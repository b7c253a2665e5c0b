//! Patches of any kind, receivers on the mesh: errors over their numbers, where the errors come
//! from, and lights that the bake has not seen.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use opponents::ProxyLookup;
use reference::metrics::{compare_pictures, compare_points, difference_picture, indirect_scale};
use reference::{Picture, PictureFile as _, scale_to_stops};
use scene::Light;

use super::lights::other_lights;
use super::rows::{Errors, Key, Row, break_down_table, lights_table, patches_table};
use super::setup::load;
use super::truth::Truth;
use crate::args::{Bench, Common, Part};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, interruptible, is_cancelled};
use crate::proxy::{ProxyRadiosity, ProxySettings};
use crate::report::{Figure, Plot, Section, Series};
use crate::sequence::pass_ms;
use crate::summary::PassTimes;
use ::patches::{MAX_PATCHES, PatchKind};
use assets::import::LoadedScene;
use patchlight::light::with_lights;
use patchlight::{
    BakeSettings, Estimator, LightSettings, MethodSettings, PatchBake, PictureRenderer, PictureSettings, Pictures,
    ReceiverKind,
};

/// The break-down, the lights and the pictures are of the most clusters asked for up to this number.
const MAIN_COUNT: u32 = 10_000;
/// Form factors of the proxy are dense: beyond this number they take gigabytes.
const MAX_PROXY_FACES: u32 = 10_000;
/// Factors of the break-down: more patches, samples a patch and their rays, rays of patches and elements, rays of
/// receivers.
const MORE_PATCHES: usize = 4;
const MORE_SAMPLES: u32 = 4;
const MORE_RAYS: u32 = 8;
const MORE_RECEIVER_RAYS: u32 = 4;
/// Sub-frames of receivers at pixels, each of which has rays of its own.
const PIXEL_SUB_FRAMES: u32 = 2;
/// Lookups of the proxy, and their names.
const LOOKUPS: [(ProxyLookup, &str); 2] =
    [(ProxyLookup::Face, "voxel proxy"), (ProxyLookup::Bilinear, "voxel proxy, bilinear")];
/// Relative difference of full colour in pictures of differences.
const RANGE: f32 = 0.25;

/// Names of the pictures of a scene.
const REFERENCE: &str = "reference";
const CLUSTERS: &str = "clusters";
const PROXY: &str = "proxy";

/// Results of an experiment in a scene.
pub struct SceneResult {
    name: String,
    /// All measurements.
    pub rows: Vec<Row>,
    /// Section of the report.
    pub section: Section,
}

impl SceneResult {
    /// The tables and what they were compared with.
    pub fn markdown(&self) -> String {
        let mut text = format!("## {}\n\n{}\n", self.section.title, self.section.text.join("\n\n"));
        for table in &self.section.tables {
            text += "\n";
            text += &table.markdown();
        }
        text
    }

    /// Files of the plots, in their order.
    pub fn plot_names(&self) -> impl Iterator<Item = String> + '_ {
        ["patches", "receivers"].into_iter().map(|what| format!("{}-{what}.svg", self.name))
    }
}

/// Measured case.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Case {
    bake: BakeSettings,
    /// Size of pictures.
    size: (u32, u32),
    sub_frames: u32,
}

/// Keeps the rows so far.
pub type Keep<'a> = dyn Fn(&[Row]) -> Result<(), Error> + 'a;

/// The patches of the break-down, the lights and the pictures.
pub fn main_count(counts: &[u32]) -> u32 {
    let most = counts.iter().copied().filter(|&n| n <= MAIN_COUNT).max();
    most.or(counts.iter().copied().min()).unwrap_or(MAIN_COUNT)
}

/// Runs the experiment in one scene; pictures go into a folder of its name. Rows are given to `keep` as they come;
/// those that are `known` are taken as they are.
pub fn one_scene(
    common: &Common,
    args: &Bench,
    scene: &str,
    out: &Path,
    known: &[Row],
    keep: &Keep,
) -> Result<SceneResult, Error> {
    let progress = Progress::new(common.quiet);
    let loaded = output::import_flat(scene, &progress)?;
    MethodSettings::Classic.check_medium(&loaded.scene)?;
    progress.note(&format!("{}: reference", loaded.name));
    let truth = match Truth::find(args.reference_folder(), &loaded)? {
        Some(truth) => truth,
        None => Truth::traced_with_points(&loaded, args.size(), args.spp, common.seed, &progress)?,
    };
    let out = out.join(&loaded.name);
    let main_count = main_count(&args.counts) as usize;
    let mut experiment = Experiment {
        common,
        args,
        loaded: &loaded,
        out,
        progress,
        main_count,
        known: known.iter().filter(|row| row.scene == loaded.name).cloned().collect(),
        rows: Vec::new(),
        written: Vec::new(),
        patches: None,
        keep,
    };
    experiment.reference_picture(&truth)?;
    if args.parts.contains(&Part::Patches) {
        experiment.patches(&truth)?;
        experiment.proxies(&truth)?;
    }
    if args.parts.contains(&Part::BreakDown) {
        experiment.break_down(&truth)?;
    }
    if args.parts.contains(&Part::Lights) {
        experiment.lights(&truth)?;
    }
    let figures = experiment.figures()?;
    Ok(experiment.result(&truth, figures))
}

/// The measurements of a scene so far.
struct Experiment<'a> {
    common: &'a Common,
    args: &'a Bench,
    loaded: &'a LoadedScene,
    out: PathBuf,
    progress: Progress,
    main_count: usize,
    /// Rows of a run before that was not finished.
    known: Vec<Row>,
    rows: Vec<Row>,
    /// Pictures that this run has written.
    written: Vec<&'static str>,
    /// The last patches, for what is like them but for receivers, and the seconds that they took.
    patches: Option<(PatchBake<'a>, f64)>,
    keep: &'a Keep<'a>,
}

impl Experiment<'_> {
    /// The settings that all runs share.
    fn case(&self, patches: PatchKind, patch_count: usize, size: (u32, u32)) -> Case {
        let bake = BakeSettings::default()
            .with_patches(patches)
            .with_patch_count(patch_count)
            .with_estimator(Estimator::Hemisphere { rays: self.args.rays })
            .with_receiver_rays(self.args.receiver_rays())
            .with_seed(self.common.seed);
        Case { bake, size, sub_frames: self.args.sub_frames }
    }

    /// The clusters of the break-down and of the pictures.
    fn main_case(&self, truth: &Truth) -> Case {
        self.case(PatchKind::Cluster, self.main_count, truth.size())
    }

    fn add(&mut self, row: Row) -> Result<(), Error> {
        self.rows.push(row);
        (self.keep)(&self.rows)
    }

    /// Adds the row of a run before with this key, and says whether there is one.
    fn take_known(&mut self, key: Key) -> Result<bool, Error> {
        let Some(row) = self.known.iter().find(|row| row.key() == key).cloned() else { return Ok(false) };
        self.add(row)?;
        Ok(true)
    }

    /// Bakes, renders frames under the scene's own lights and adds a row.
    fn measure(&mut self, part: Part, what: &str, case: Case, truth: &Truth) -> Result<(), Error> {
        let settings = case.bake;
        let (receivers_at, density) = match settings.receivers {
            ReceiverKind::Mesh => ("mesh", Some(settings.receiver_density)),
            ReceiverKind::Pixels => ("pixels", None),
            ReceiverKind::Patches => ("self", None),
        };
        let count = settings.patch_count;
        let is_main = case == self.main_case(truth);
        let scene = &self.loaded.name;
        let key = (scene.as_str(), part, what, Some(receivers_at), density, count);
        if (!is_main || self.has_picture(CLUSTERS)) && self.take_known(key)? {
            return Ok(());
        }
        let times = density.map(|d| format!(" × {d}")).unwrap_or_default();
        self.progress.note(&format!("{scene}: {what}, {count} patches, receivers: {receivers_at}{times}"));
        let (mut renderer, bake_s) = self.bake(&case)?;
        // Exact receivers are not what a frame would do: their time says nothing.
        let is_timed = settings.receivers != ReceiverKind::Pixels;
        let frames = if is_timed { self.args.frames() } else { 1 };
        let shown = self.frames(&mut renderer, &self.loaded.scene.lighting.lights, case.size, frames)?;
        let points =
            if truth.points.is_empty() { None } else { Some(renderer.light_mut().irradiance_at(&truth.points)?) };
        if is_main {
            self.write_pictures(CLUSTERS, &shown.pictures.indirect, truth)?;
        }
        let bake = renderer.light().bake();
        self.add(Row {
            scene: self.loaded.name.clone(),
            part,
            method: "classic".to_owned(),
            what: what.to_owned(),
            receivers_at: Some(receivers_at.to_owned()),
            receiver_density: density,
            patch_count: settings.patch_count,
            patches: bake.mesh().patches.len(),
            receivers: (settings.receivers == ReceiverKind::Mesh).then(|| bake.receivers().points.len()),
            bake_s: Some(bake_s),
            median_ms: shown.light_ms.filter(|_| is_timed),
            shade_ms: shown.shade_ms.filter(|_| is_timed),
            bytes: Some(renderer.light().bytes().values().sum()),
            errors: Errors::of(&shown.pictures, points.as_deref(), truth, self.loaded.exposure_stops)?,
            reference_noise: truth.noise,
        })
    }

    /// A bake on a device, of the last patches if only receivers differ, and the seconds that it
    /// takes from the beginning.
    fn bake(&mut self, case: &Case) -> Result<(PictureRenderer, f64), Error> {
        let start = self.progress.phases().len();
        let known = self.patches.take().filter(|(patches, _)| patches.are_of(&case.bake));
        let (patches, before) = match known {
            Some(known) => known,
            None => {
                let patches = PatchBake::build(&self.loaded.scene, &case.bake, &self.progress)?;
                (patches, seconds_since(&self.progress, start))
            }
        };
        let first = self.progress.phases().len();
        let bake = Arc::new(patches.clone().with_receivers(&case.bake, &self.progress)?);
        let light = LightSettings::default().with_eye(self.loaded.view.eye);
        let pictures = PictureSettings::default().with_size(case.size).with_sub_frames(case.sub_frames);
        let renderer = load(self.common, &bake, &light, &pictures, &self.progress)?;
        let own = seconds_since(&self.progress, first);
        self.patches = Some((patches, before));
        if is_cancelled() { Err(shell::Error::Cancelled.into()) } else { Ok((renderer, before + own)) }
    }

    /// The first frame under these lights, and the median times of all.
    fn frames(
        &self,
        renderer: &mut PictureRenderer,
        lights: &[Light],
        size: (u32, u32),
        frames: u32,
    ) -> Result<Frames, Error> {
        let camera = self.loaded.view.camera(size.0, size.1);
        let lighting = with_lights(&self.loaded.scene, lights);
        let first = interruptible(|| renderer.picture(&lighting, &camera, 0))?;
        let mut times = vec![first.times];
        for number in 1..frames {
            times.push(interruptible(|| renderer.picture(&lighting, &camera, number))?.times);
            if is_cancelled() {
                return Err(shell::Error::Cancelled.into());
            }
        }
        let light: Vec<f64> = times.iter().map(|frame| all_ms(frame) - pass_ms(frame, "shade")).collect();
        let shade: Vec<f64> = times.iter().map(|frame| pass_ms(frame, "shade")).collect();
        Ok(Frames {
            pictures: first.pictures,
            light_ms: PassTimes::of(&light).map(|t| t.median_ms),
            shade_ms: PassTimes::of(&shade).map(|t| t.median_ms),
        })
    }

    /// Kinds × numbers of patches × densities of receivers.
    fn patches(&mut self, truth: &Truth) -> Result<(), Error> {
        for kind in self.args.kinds.iter().map(|kind| kind.kind()) {
            for &count in &self.args.counts {
                let case = self.case(kind, count as usize, truth.size());
                for &receiver_density in &self.args.densities {
                    let bake = case.bake.with_receiver_density(receiver_density);
                    self.measure(Part::Patches, kind.name(), Case { bake, ..case }, truth)?;
                }
                if kind.has_voxels() {
                    let bake = case.bake.with_receivers(ReceiverKind::Patches);
                    self.measure(Part::Patches, kind.name(), Case { bake, ..case }, truth)?;
                }
            }
        }
        Ok(())
    }

    /// The voxelisation proxy with about as many faces.
    fn proxies(&mut self, truth: &Truth) -> Result<(), Error> {
        let counts: Vec<u32> = self.args.counts.iter().copied().filter(|&count| count <= MAX_PROXY_FACES).collect();
        for count in counts {
            let count = count as usize;
            let is_main = count == self.main_count;
            let keys = LOOKUPS.map(|(_, what)| (self.loaded.name.as_str(), Part::Patches, what, None, None, count));
            let are_known = keys.iter().all(|key| self.known.iter().any(|row| row.key() == *key));
            if are_known && (!is_main || self.has_picture(PROXY)) {
                for key in keys {
                    self.take_known(key)?;
                }
                continue;
            }
            self.proxy(count, truth)?;
            if is_cancelled() {
                return Err(shell::Error::Cancelled.into());
            }
        }
        Ok(())
    }

    /// The proxy with so many faces, with each lookup.
    fn proxy(&mut self, count: usize, truth: &Truth) -> Result<(), Error> {
        self.progress.note(&format!("{}: voxel proxy, {count} faces", self.loaded.name));
        let settings = ProxySettings {
            patch_count: count,
            rays: self.args.rays,
            point_rays: BakeSettings::default().sample_rays,
            seed: self.common.seed,
        };
        let first = self.progress.phases().len();
        let proxy = ProxyRadiosity::bake(&self.loaded.scene, settings, &self.progress)?;
        let bake_s = seconds_since(&self.progress, first);
        let camera = self.loaded.view.camera(truth.size().0, truth.size().1);
        let scale = indirect_scale(&truth.pictures.indirect);
        for (lookup, what) in LOOKUPS {
            let picture = proxy.indirect(&camera, self.args.sub_frames, lookup)?;
            let errors = compare_pictures(&picture, &truth.pictures.indirect, scale, None)?;
            let points = match truth.points.is_empty() {
                true => None,
                false => Some(compare_points(&proxy.irradiance_at(&truth.points, lookup), &truth.point_indirect)?),
            };
            self.add(Row {
                scene: self.loaded.name.clone(),
                part: Part::Patches,
                method: "voxel proxy".to_owned(),
                what: what.to_owned(),
                receivers_at: None,
                receiver_density: None,
                patch_count: count,
                patches: proxy.patch_count(),
                receivers: None,
                bake_s: Some(bake_s),
                median_ms: None,
                shade_ms: None,
                bytes: None,
                errors: Errors::of_indirect(&errors, points),
                reference_noise: truth.noise,
            })?;
            if count == self.main_count && lookup == ProxyLookup::Bilinear {
                self.write_pictures(PROXY, &picture, truth)?;
            }
        }
        Ok(())
    }

    /// Clusters with one thing at a time more exact.
    fn break_down(&mut self, truth: &Truth) -> Result<(), Error> {
        let case = self.main_case(truth);
        let base = case.bake;
        let what = "as they are";
        let scene = self.loaded.name.as_str();
        let density = Some(base.receiver_density);
        let main = (scene, Part::Patches, base.patches.name(), Some("mesh"), density, base.patch_count);
        match self.rows.iter().find(|row| row.key() == main).cloned() {
            Some(row) => self.add(Row { part: Part::BreakDown, what: what.into(), ..row })?,
            None => self.measure(Part::BreakDown, what, case, truth)?,
        }
        for (what, bake) in self.more_exact(&base) {
            let sub_frames = match bake.receivers {
                ReceiverKind::Pixels => PIXEL_SUB_FRAMES,
                _ => case.sub_frames,
            };
            self.measure(Part::BreakDown, &what, Case { bake, sub_frames, ..case }, truth)?;
        }
        Ok(())
    }

    /// Settings with one thing at a time more exact, and what that is.
    fn more_exact(&self, base: &BakeSettings) -> [(String, BakeSettings); 5] {
        let more = (MORE_PATCHES * base.patch_count).min(MAX_PATCHES);
        let rays = MORE_RAYS * self.args.rays;
        [
            (
                format!("receivers at all pixels ({PIXEL_SUB_FRAMES} sub-frames)"),
                (*base).with_receivers(ReceiverKind::Pixels),
            ),
            (
                format!("rays of receivers × {MORE_RECEIVER_RAYS}"),
                (*base).with_receiver_rays(MORE_RECEIVER_RAYS * base.receiver_rays),
            ),
            (
                format!("patches × {MORE_PATCHES}, as many receivers"),
                (*base).with_patch_count(more).with_receiver_density(base.patch_count as f32 / more as f32),
            ),
            (format!("rays of F × {MORE_RAYS}"), (*base).with_estimator(Estimator::Hemisphere { rays })),
            (
                format!("E by samples and rays × {MORE_SAMPLES}"),
                (*base).with_samples(MORE_SAMPLES * base.samples).with_sample_rays(MORE_SAMPLES * base.sample_rays),
            ),
        ]
    }

    /// One bake with the scene's own lights, frames with others.
    fn lights(&mut self, truth: &Truth) -> Result<(), Error> {
        let case = self.case(PatchKind::Cluster, self.main_count, self.args.size());
        self.progress.note(&format!("{}: lights that the bake has not seen", self.loaded.name));
        let mut baked = None;
        let own = ("the scene's own".to_owned(), self.loaded.scene.lighting.lights.clone());
        for (what, lights) in std::iter::once(own).chain(other_lights(self.loaded)) {
            let density = Some(case.bake.receiver_density);
            let count = case.bake.patch_count;
            let key = (self.loaded.name.as_str(), Part::Lights, what.as_str(), Some("mesh"), density, count);
            if self.take_known(key)? {
                continue;
            }
            let renderer = match &mut baked {
                Some(renderer) => renderer,
                None => baked.insert(self.bake(&case)?.0),
            };
            self.progress.note(&format!("{}: {what}", self.loaded.name));
            self.light(what, &lights, &case, renderer, truth)?;
        }
        Ok(())
    }

    /// A row of other lights.
    fn light(
        &mut self,
        what: String,
        lights: &[Light],
        case: &Case,
        renderer: &mut PictureRenderer,
        truth: &Truth,
    ) -> Result<(), Error> {
        let shown = self.frames(renderer, lights, case.size, 1)?;
        let is_known = *lights == self.loaded.scene.lighting.lights[..] && truth.noise.is_some();
        let traced = match is_known {
            true => None,
            false => {
                let paths = self.args.spp;
                Some(Truth::traced(self.loaded, lights, case.size, paths, self.common.seed, &self.progress)?)
            }
        };
        let expected = traced.as_ref().unwrap_or(truth);
        let bake = renderer.light().bake();
        self.add(Row {
            scene: self.loaded.name.clone(),
            part: Part::Lights,
            method: "classic".to_owned(),
            what,
            receivers_at: Some("mesh".to_owned()),
            receiver_density: Some(case.bake.receiver_density),
            patch_count: case.bake.patch_count,
            patches: bake.mesh().patches.len(),
            receivers: Some(bake.receivers().points.len()),
            bake_s: None,
            median_ms: shown.light_ms,
            shade_ms: shown.shade_ms,
            bytes: Some(renderer.light().bytes().values().sum()),
            errors: Errors::of(&shown.pictures, None, expected, self.loaded.exposure_stops)?,
            reference_noise: expected.noise,
        })
    }

    /// Returns true if a picture is there, from this run or the one that it goes on from.
    fn has_picture(&self, name: &str) -> bool {
        self.written.contains(&name) || (self.args.resume && self.out.join(format!("{name}.png")).exists())
    }

    /// Writes the reference's indirect light as a picture.
    fn reference_picture(&mut self, truth: &Truth) -> Result<(), Error> {
        output::make_folder(&self.out)?;
        let expected = &truth.pictures.indirect;
        let stops = scale_to_stops(indirect_scale(expected));
        expected.write_png(&self.out.join(format!("{REFERENCE}.png")), stops)?;
        self.written.push(REFERENCE);
        Ok(())
    }

    /// Writes a picture of indirect light, and its difference from the reference.
    fn write_pictures(&mut self, name: &'static str, picture: &Picture, truth: &Truth) -> Result<(), Error> {
        let expected = &truth.pictures.indirect;
        let stops = scale_to_stops(indirect_scale(expected));
        let difference = difference_picture(&picture.block_means(8), &expected.block_means(8), RANGE)?;
        picture.write_png(&self.out.join(format!("{name}.png")), stops)?;
        difference.write_png(&self.out.join(format!("{name}-difference.png")), 0.0)?;
        self.written.push(name);
        Ok(())
    }

    /// Reads the pictures that there are.
    fn figures(&self) -> Result<Vec<Figure>, Error> {
        let count = self.main_count;
        let colours = format!("red brighter, blue darker, full colour at {:.0} %", 100.0 * RANGE);
        let mut figures = Vec::new();
        for (name, caption, difference) in [
            (REFERENCE, "Indirect light, reference".to_owned(), None),
            (CLUSTERS, format!("Indirect light, {count} clusters, receivers on the mesh"), Some("Clusters")),
            (PROXY, format!("Indirect light, voxelisation proxy of about {count} faces, bilinear"), Some("Proxy")),
        ] {
            if self.has_picture(name) {
                figures.push(Figure::read(&self.out, &format!("{name}.png"), caption)?);
                if let Some(whose) = difference {
                    let file = format!("{name}-difference.png");
                    figures.push(Figure::read(&self.out, &file, format!("{whose}: {colours}"))?);
                }
            }
        }
        Ok(figures)
    }

    fn result(self, truth: &Truth, figures: Vec<Figure>) -> SceneResult {
        let rows = self.rows;
        let size = truth.size();
        let text = vec![
            format!("Compared with {}.", truth.source),
            format!(
                "Pictures of {} × {}, {} sub-frames; {} rays a row of F, {} rays a receiver. Light ms: all passes but \
                 shading, frames for the median: {}. Tables of break-down and lights, and the pictures: {} clusters. \
                 The proxy's form factors are dense: no more than {MAX_PROXY_FACES} faces.",
                size.0,
                size.1,
                self.args.sub_frames,
                self.args.rays,
                self.args.receiver_rays(),
                self.args.frames(),
                self.main_count
            ),
        ];
        let mut tables = Vec::new();
        let mut plots = Vec::new();
        for (part, table) in [
            (Part::Patches, patches_table(&rows)),
            (Part::BreakDown, break_down_table(&rows)),
            (Part::Lights, lights_table(&rows)),
        ] {
            if self.args.parts.contains(&part) {
                tables.push(table);
            }
        }
        if self.args.parts.contains(&Part::Patches) {
            plots = vec![over_patches(&rows, &self.args.densities), over_receivers(&rows, &self.args.counts)];
        }
        let section = Section {
            title: format!("{} ({} triangles)", self.loaded.name, self.loaded.scene.geometry.triangles.len()),
            text,
            figures,

            tables,
            plots,
            ..Section::default()
        };
        SceneResult { name: self.loaded.name.clone(), rows, section }
    }
}

/// The first frame, and median times.
struct Frames {
    pictures: Pictures,
    /// Passes but shading, and shading.
    light_ms: Option<f64>,
    shade_ms: Option<f64>,
}

/// Seconds of the phases from this one on.
fn seconds_since(progress: &Progress, first: usize) -> f64 {
    progress.phases()[first..].iter().map(|(_, seconds)| seconds).sum()
}

fn all_ms(times: &[(String, f64)]) -> f64 {
    times.iter().map(|(_, ms)| ms).sum()
}

fn point(x: usize, row: &Row) -> (f64, f64) {
    (x as f64, 100.0 * row.errors.indirect_block_median)
}

/// Errors over the number of patches: a line for each kind, with the density nearest to the default.
fn over_patches(rows: &[Row], densities: &[f32]) -> Plot {
    let off = |density: &f32| scene::math::abs(scene::math::ln(*density));
    let density = densities.iter().copied().min_by(|a, b| off(a).total_cmp(&off(b)));
    let mut series: Vec<Series> = Vec::new();
    for row in rows
        .iter()
        .filter(|r| r.part == Part::Patches && (r.receiver_density.is_none() || r.receiver_density == density))
    {
        let name = match row.receivers_at.as_deref() {
            Some("self") => format!("{}, self", row.what),
            _ => row.what.clone(),
        };
        let point = point(row.patch_count, row);
        match series.iter_mut().find(|s| s.name == name) {
            Some(line) => line.points.push(point),
            None => series.push(Series { name, points: vec![point] }),
        }
    }
    plot("Median error of blocks", "patches", series)
}

/// Errors of clusters over the number of receivers: a line for each number of patches.
fn over_receivers(rows: &[Row], counts: &[u32]) -> Plot {
    let cluster = PatchKind::Cluster.name();
    let line = |&count: &u32| {
        let of_count = |r: &&Row| r.part == Part::Patches && r.what == cluster && r.patch_count == count as usize;
        let points = rows.iter().filter(of_count).filter_map(|r| Some(point(r.receivers?, r))).collect();
        Series { name: format!("{count} clusters"), points }
    };
    plot("Median error of blocks", "receivers", counts.iter().map(line).collect())
}

fn plot(title: &str, x: &str, mut series: Vec<Series>) -> Plot {
    series.iter_mut().for_each(|line| line.points.sort_by(|a, b| a.0.total_cmp(&b.0)));
    series.retain(|line| !line.points.is_empty());
    Plot { title: title.into(), unit: "%".into(), x: x.into(), logarithmic: true, series }
}
