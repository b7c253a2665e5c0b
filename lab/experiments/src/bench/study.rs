//! Experiments with contenders: scenes one after the other, what is kept of them, and their section of
//! docs/experiments.md.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::all::smallest;
use super::setup::{Machine, Setup};
use crate::args::{Bench, Common};
use crate::date::today;
use crate::error::Error;
use crate::output;
use crate::progress::Progress;
use crate::report::{Figure, Section, Table, page};
use assets::import::LoadedScene;

/// Folders of docs: of data, of plots, of pictures.
const DATA: &str = "data";
const PLOTS: &str = "experiments";
const PICTURES: &str = "pictures";
/// Picture of a scene in which all contenders are side by side.
pub const SIDE_BY_SIDE: &str = "side-by-side.png";

/// An experiment with contenders.
pub trait Study {
    /// A measurement.
    type Row: Serialize + DeserializeOwned + Clone;
    /// Name of the command and the files.
    const NAME: &'static str;
    /// Heading of the section.
    const TITLE: &'static str;
    /// The measurement, and how to read it: a paragraph.
    const ABOUT: &'static str;
    /// Built-in scenes, unless some are named.
    const SCENES: &'static [&'static str];
    /// Shared scenes that are measured after those, where they are there.
    const SHARED: &'static [&'static str] = &[];
    /// Patches, unless it is said.
    const PATCHES: u32 = 2000;
    /// Times light updates.
    const TIMED: bool = false;
    /// Scenes of which docs have the picture.
    const SHOWN: &'static [&'static str] = &[];

    /// Variants of a scene that are measured: as it is, or several of its kind.
    ///
    /// # Errors
    /// What the scenes say.
    fn variants(loaded: LoadedScene) -> Result<Vec<LoadedScene>, Error> {
        Ok(vec![loaded])
    }

    /// Measures one of them.
    ///
    /// # Errors
    /// What the contenders say.
    fn measure(place: &Place, loaded: &LoadedScene) -> Result<Measured<Self::Row>, Error>;

    /// Tables and plots.
    fn sections(scenes: &[SceneRows<Self::Row>]) -> Vec<Section>;
}

/// Measurement of a scene: settings and place.
pub struct Place<'a> {
    pub common: &'a Common,
    pub args: &'a Bench,
    pub progress: &'a Progress,
    /// Patches.
    pub patches: usize,
    /// Output folder of the experiment.
    pub out: &'a Path,
    /// Output folder of the scene.
    pub folder: PathBuf,
}

/// Results of a scene.
pub struct Measured<Row> {
    pub rows: Vec<Row>,
    /// Reference of the comparison.
    pub reference: Option<String>,
    /// Pictures for the report.
    pub figures: Vec<Figure>,
    /// Pictures of [`SIDE_BY_SIDE`], where there is one.
    pub shown: Vec<String>,
    /// Who could not take part, and why.
    pub left_out: Vec<String>,
}

impl<Row> Measured<Row> {
    /// Rows alone.
    pub fn of(rows: Vec<Row>) -> Self {
        Self { rows, reference: None, figures: Vec::new(), shown: Vec::new(), left_out: Vec::new() }
    }
}

/// When, on what and how a scene was measured.
#[derive(Clone, Serialize, Deserialize)]
pub struct Circumstances {
    pub version: String,
    pub date: String,
    pub machine: Machine,
    pub device: String,
    /// Note on the machine, as it was given.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub note: Option<String>,
    pub seed: u32,
    pub size: (u32, u32),
    pub frames: u32,
    pub patches: u32,
}

/// Results of a scene, as they are kept.
#[derive(Clone, Serialize, Deserialize)]
pub struct SceneRows<Row> {
    pub scene: String,
    #[serde(flatten)]
    pub circumstances: Circumstances,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reference: Option<String>,
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub shown: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub left_out: Vec<String>,
    pub rows: Vec<Row>,
}

/// Record of an experiment: its summary.json, and its file in docs/data, which scenes are added to one after the other.
#[derive(Serialize, Deserialize)]
pub struct Record<Row> {
    pub name: String,
    pub scenes: Vec<SceneRows<Row>>,
}

impl<Row: Clone + DeserializeOwned> Record<Row> {
    fn new(name: &str) -> Self {
        Self { name: name.to_owned(), scenes: Vec::new() }
    }

    /// Record of an experiment in a folder of documents so far.
    fn kept<S: Study<Row = Row>>(docs: &Path) -> Result<Self, Error> {
        let path = data_file::<S>(docs);
        if path.exists() { read(&path, S::NAME) } else { Ok(Self::new(S::NAME)) }
    }

    /// Takes the place of what was known of the scene, or the last one.
    fn put(&mut self, found: &SceneRows<Row>) {
        match self.scenes.iter_mut().find(|scene| scene.scene == found.scene) {
            Some(known) => known.clone_from(found),
            None => self.scenes.push(found.clone()),
        }
    }
}

/// Runs an experiment.
pub fn run<S: Study>(common: &Common, args: &Bench) -> Result<(), Error> {
    let folder = output::folder_or(&common.out, &format!("bench-{}", S::NAME));
    let smallest = if args.quick { Some(smallest(args.name, args, &folder)) } else { None };
    let args = smallest.as_ref().unwrap_or(args);
    let Setup { out, machine, counts, .. } = Setup::new(common, args, S::NAME, &[], &[S::PATCHES])?;
    let progress = Progress::new(common.quiet);
    // What cannot be added to is said before it is measured.
    let mut kept = args.docs.as_deref().map(Record::kept::<S>).transpose()?;
    let mut record = Record::new(S::NAME);
    let mut figures = Vec::new();
    let small = small(args);
    for (spec, is_shared) in scenes::<S>(&args.scenes, &args.shared, &progress) {
        let args = if is_shared { &small } else { args };
        let circumstances = Circumstances::new(common, args, &machine, counts[0]);
        let progress = Progress::new(common.quiet);
        for loaded in S::variants(output::import_flat(&spec, &progress)?)? {
            let folder = out.join(file_name(&loaded.name));
            output::make_folder(&folder)?;
            let place = Place { common, args, progress: &progress, patches: counts[0] as usize, out: &out, folder };
            let Measured { rows, reference, figures: own, shown, left_out } = S::measure(&place, &loaded)?;
            let circumstances = circumstances.clone();
            let found = SceneRows { scene: loaded.name.clone(), circumstances, reference, shown, left_out, rows };
            if !own.is_empty() {
                figures.push(Section { title: loaded.name.clone(), figures: own, ..Section::default() });
            }
            // What is known is kept when the rest fails or is stopped.
            record.put(&found);
            output::write_text(&out.join("summary.json"), &output::json(&record))?;
            write_report::<S>(&out, &record, &figures)?;
            if let (Some(docs), Some(kept)) = (&args.docs, &mut kept) {
                kept.put(&found);
                keep_in_docs::<S>(docs, &out, kept, &found)?;
            }
        }
    }
    if common.json {
        say!("{}", output::json(&record));
    } else {
        let sections = S::sections(&record.scenes);
        sections.iter().flat_map(|section| &section.tables).for_each(|table| say!("{}", table.markdown()));
        say!("{} shows the same", out.join("report.html").display());
    }
    Ok(())
}

/// Light updates and paths a pixel in shared scenes that are not asked for by name, at most.
const SMALL_FRAMES: u32 = 3;
const SMALL_PATHS: u32 = 128;

/// Settings for shared scenes, which have some hundred thousand triangles: an experiment takes ten minutes at most.
fn small(args: &Bench) -> Bench {
    let probe_rays = args.probe_rays.iter().copied().take(1).collect();
    Bench { frames: Some(args.frames().min(SMALL_FRAMES)), spp: args.spp.min(SMALL_PATHS), probe_rays, ..args.clone() }
}

/// The scenes that are asked for, or the built-in ones and those shared ones that are there; and whether they are such.
fn scenes<S: Study>(named: &[String], shared: &Path, progress: &Progress) -> Vec<(String, bool)> {
    if !named.is_empty() {
        return named.iter().map(|name| (name.clone(), false)).collect();
    }
    let mut specs: Vec<(String, bool)> = S::SCENES.iter().map(|scene| ((*scene).to_owned(), false)).collect();
    for name in S::SHARED {
        let path = shared.join(name).join(format!("{name}.toml"));
        if path.is_file() {
            specs.push((path.display().to_string(), true));
        } else {
            progress.note(&format!(
                "{} is not there, and {name} is left out; --shared names another folder",
                path.display()
            ));
        }
    }
    specs
}

fn write_report<S: Study>(out: &Path, record: &Record<S::Row>, figures: &[Section]) -> Result<(), Error> {
    let mut introduction = record.sentences::<S>();
    introduction.push(S::ABOUT.to_owned());
    let title = format!("Patchlight: {}", S::TITLE.to_lowercase());
    let sections = S::sections(&record.scenes);
    Ok(output::write_text(&out.join("report.html"), &page(&title, &introduction, sections.iter().chain(figures)))?)
}

/// Writes what `bench report` reads, and the picture of the scene that it links.
fn keep_in_docs<S: Study>(
    docs: &Path,
    out: &Path,
    record: &Record<S::Row>,
    scene: &SceneRows<S::Row>,
) -> Result<(), Error> {
    output::make_folder(&docs.join(DATA))?;
    output::make_folder(&docs.join(PICTURES))?;
    output::write_text(&data_file::<S>(docs), &output::json(record))?;
    if is_shown::<S>(scene) {
        let from = out.join(file_name(&scene.scene)).join(SIDE_BY_SIDE);
        let to = docs.join(PICTURES).join(picture_name::<S>(&scene.scene));
        std::fs::copy(&from, &to).map_err(|source| shell::Error::Write { path: to, source })?;
    }
    Ok(())
}

/// Path of an experiment's data in docs.
pub fn data_file<S: Study>(docs: &Path) -> PathBuf {
    docs.join(DATA).join(format!("{}.json", S::NAME))
}

fn is_shown<S: Study>(scene: &SceneRows<S::Row>) -> bool {
    !scene.shown.is_empty() && S::SHOWN.contains(&scene.scene.as_str())
}

fn picture_name<S: Study>(scene: &str) -> String {
    format!("{}-{}.png", S::NAME, file_name(scene))
}

/// A name of a file for a scene or a method.
pub fn file_name(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '.' { c } else { '-' }).collect()
}

/// The section of an experiment in docs/experiments.md; its plots are written beside it.
///
/// # Errors
/// Data that are not there, or not those of the experiment.
pub fn document<S: Study>(docs: &Path) -> Result<(Record<S::Row>, String), Error> {
    let record: Record<S::Row> = read(&data_file::<S>(docs), S::NAME)?;
    // Writing into a string cannot fail.
    let mut text = format!("## {}\n\n`patchlight bench {}`. {}\n\n", S::TITLE, S::NAME, S::ABOUT);
    for line in record.sentences::<S>() {
        let _ = writeln!(text, "- {line}");
    }
    for scene in &record.scenes {
        if let Some(reference) = &scene.reference {
            let _ = writeln!(text, "- {}: compared with {reference}.", scene.scene);
        }
        for line in &scene.left_out {
            let _ = writeln!(text, "- {}, left out: {line}.", scene.scene);
        }
    }
    for section in S::sections(&record.scenes) {
        let _ = write!(text, "\n### {}\n", section.title);
        for line in &section.text {
            let _ = write!(text, "\n{line}\n");
        }
        for table in &section.tables {
            let _ = write!(text, "\n{}", table.markdown());
        }
        for (number, plot) in section.plots.iter().enumerate() {
            let name = plot_name::<S>(&section.title, number);
            output::write_text(&docs.join(PLOTS).join(&name), &plot.svg())?;
            let _ = write!(text, "\n![{}]({PLOTS}/{name})\n", plot.title);
        }
    }
    for scene in record.scenes.iter().filter(|scene| is_shown::<S>(scene)) {
        let _ = write!(
            text,
            "\n![{}: {}]({PICTURES}/{})\n\n{}, from left to right, then down: {}.\n",
            S::TITLE,
            scene.scene,
            picture_name::<S>(&scene.scene),
            scene.scene,
            scene.shown.join("; ")
        );
    }
    Ok((record, text))
}

/// A file of docs/data.
///
/// # Errors
/// A file that is not there or holds something else; `experiment` is what makes it.
pub fn read<T: DeserializeOwned>(path: &Path, experiment: &'static str) -> Result<T, Error> {
    let text =
        std::fs::read_to_string(path).map_err(|source| reference::Error::Read { path: path.to_owned(), source })?;
    serde_json::from_str(&text).map_err(|e| Error::Data { path: path.to_owned(), why: e.to_string(), experiment })
}

/// A line for each method of the first scene, a column for each scene.
pub fn over_scenes<Row>(
    caption: &str,
    scenes: &[SceneRows<Row>],
    name: impl Fn(&Row) -> String,
    cell: impl Fn(&Row) -> String,
) -> Table {
    let mut head = vec!["method".to_owned()];
    head.extend(scenes.iter().map(|scene| scene.scene.clone()));
    let line = |first: &Row| {
        let name_of_line = name(first);
        let of_scene = |scene: &SceneRows<Row>| {
            let row = scene.rows.iter().find(|row| name(row) == name_of_line);
            row.map_or_else(|| "–".to_owned(), &cell)
        };
        let cells: Vec<String> = scenes.iter().map(of_scene).collect();
        [vec![name_of_line.clone()], cells].concat()
    };
    let rows = scenes.first().map_or(&[][..], |scene| &scene.rows).iter().map(line).collect();
    Table { caption: caption.to_owned(), head, rows }
}

fn plot_name<S: Study>(section: &str, number: usize) -> String {
    format!("{}-{}-{}.svg", S::NAME, file_name(&section.to_lowercase()), number + 1)
}

impl<Row> Record<Row> {
    /// When, on what and how its scenes were measured: a sentence for those that follow each other and have it in
    /// common.
    fn sentences<S: Study>(&self) -> Vec<String> {
        let mut groups: Vec<(Vec<&str>, String)> = Vec::new();
        for scene in &self.scenes {
            let sentence = scene.circumstances.sentence::<S>();
            match groups.last_mut() {
                Some((names, last)) if *last == sentence => names.push(&scene.scene),
                _ => groups.push((vec![&scene.scene], sentence)),
            }
        }
        groups.into_iter().map(|(names, sentence)| format!("{}: {sentence}", names.join("; "))).collect()
    }
}

impl Circumstances {
    fn new(common: &Common, args: &Bench, machine: &Machine, patches: u32) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            date: today(),
            machine: machine.clone(),
            device: common.device.clone(),
            note: args.note.clone(),
            seed: common.seed,
            size: args.size(),
            frames: args.frames(),
            patches,
        }
    }

    fn sentence<S: Study>(&self) -> String {
        let Self { version, date, machine, device, size: (width, height), patches, .. } = self;
        let note = self.note.as_ref().map(|note| format!(" {note}")).unwrap_or_default();
        let medians = if S::TIMED { format!(", medians of {} light updates", self.frames) } else { String::new() };
        format!(
            "version {version}, {date}. {} Device `{device}`.{note} {patches} patches, {width} × {height} \
             pixels{medians}.",
            machine.sentence()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::leaks::Leaks;

    #[test]
    fn shared_scenes_are_measured_where_they_are_there() {
        let folder = tempfile::tempdir().unwrap();
        let progress = Progress::new(true);
        let own: Vec<(String, bool)> = Leaks::SCENES.iter().map(|scene| ((*scene).to_owned(), false)).collect();
        assert_eq!(scenes::<Leaks>(&[], folder.path(), &progress), own);
        let path = folder.path().join("sponza/sponza.toml");
        output::make_folder(path.parent().unwrap()).unwrap();
        output::write_text(&path, "").unwrap();
        let found = scenes::<Leaks>(&[], folder.path(), &progress);
        assert_eq!(found, [&own[..], &[(path.display().to_string(), true)]].concat());
        let named = ["atrium".to_owned()];
        assert_eq!(scenes::<Leaks>(&named, folder.path(), &progress), [("atrium".to_owned(), false)]);
    }
}
