//! The self-contained report: pictures inside, tables, small plots; no other file.

use std::fmt::Write as _;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::error::Error;

/// Quality of JPEG files, of 100.
const JPEG_QUALITY: u8 = 88;

/// A picture of the report.
pub struct Figure {
    /// Text under it.
    pub caption: String,
    /// The bytes of its file.
    pub bytes: Vec<u8>,
    /// Media type of the file.
    pub media: &'static str,
}

impl Figure {
    /// A PNG file of a folder.
    pub fn read(folder: &Path, name: &str, caption: String) -> Result<Self, Error> {
        let path = folder.join(name);
        let bytes = std::fs::read(&path).map_err(|source| reference::Error::Read { path, source })?;
        Ok(Self { caption, bytes, media: "image/png" })
    }

    /// Picture as JPEG, a tenth of the bytes: where a single pixel does not matter.
    pub fn photograph(folder: &Path, name: &str, caption: String) -> Result<Self, Error> {
        let png = Self::read(folder, name, caption)?;
        let mut bytes = Vec::new();
        let encoded = image::load_from_memory(&png.bytes).and_then(|picture| {
            picture.to_rgb8().write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY))
        });
        encoded.map_err(|e| reference::Error::Decode { path: folder.join(name), reason: e.to_string() })?;
        Ok(Self { bytes, media: "image/jpeg", ..png })
    }
}

/// Pictures over one of the same size, of which a slider shows the left part.
pub struct Comparison {
    /// The figure beneath.
    pub beneath: Figure,
    /// Figures above it, one at a time.
    pub above: Vec<Figure>,
}

/// The stages of a frame and their times.
pub struct FrameGraph {
    /// Text above it.
    pub title: String,
    /// Name, milliseconds where they are known, and numbers of the stages that it reads from.
    pub stages: Vec<(String, Option<f64>, Vec<usize>)>,
}

/// A table of the report: a head and rows of cells.
#[derive(Clone)]
pub struct Table {
    /// Text above it.
    pub caption: String,
    /// Column heads.
    pub head: Vec<String>,
    /// Rows, first cell a row head.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// As Markdown, the caption above.
    pub fn markdown(&self) -> String {
        let mut text = format!("{}\n\n", self.caption);
        let rule: Vec<String> =
            (0..self.head.len()).map(|k| String::from(if k == 0 { "---" } else { "---:" })).collect();
        for row in [&self.head, &rule].into_iter().chain(&self.rows) {
            // Writing into a string cannot fail.
            let _ = writeln!(text, "| {} |", row.join(" | "));
        }
        text
    }
}

/// A line of a plot.
pub struct Series {
    /// Its name.
    pub name: String,
    /// Points (x, y), x rising.
    pub points: Vec<(f64, f64)>,
}

/// Lines with marked values below each other.
pub struct Plot {
    /// Text above it.
    pub title: String,
    /// Unit of y.
    pub unit: String,
    /// Quantity along x.
    pub x: String,
    /// Scale of equal ratios at equal distances, x > 0 and y > 0; else y begins at zero.
    pub logarithmic: bool,
    /// The lines.
    pub series: Vec<Series>,
}

impl Plot {
    /// As a file of its own.
    pub fn svg(&self) -> String {
        plot(self, Some("http://www.w3.org/2000/svg")).into_string()
    }
}

/// One section of the report.
#[derive(Default)]
pub struct Section {
    /// Heading.
    pub title: String,
    /// Paragraphs under the heading.
    pub text: Vec<String>,
    /// Pictures to compare by a slider.
    pub comparisons: Vec<Comparison>,
    /// Pictures side by side.
    pub figures: Vec<Figure>,
    /// Frames of an animation as a strip.
    pub strip: Vec<Figure>,
    /// Tables.
    pub tables: Vec<Table>,
    /// Plots.
    pub plots: Vec<Plot>,
    /// Frame graphs.
    pub graphs: Vec<FrameGraph>,
}

const STYLE: &str = "
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1180px; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-bottom: 0; } h2 { border-bottom: 1px solid #8886; margin-top: 2.5rem; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(330px, 1fr)); gap: 1rem; }
.strip { display: grid; grid-template-columns: repeat(6, 1fr); gap: .3rem; margin-top: 1rem; }
figure { margin: 0; } img { width: 100%; display: block; border-radius: 3px; }
figcaption { font-size: 13px; opacity: .8; }
table { border-collapse: collapse; margin: 1rem 0; } caption { text-align: left; font-weight: 600; padding: .3rem 0; }
td, th { border-bottom: 1px solid #8884; padding: .2rem .8rem .2rem 0; text-align: right; font-variant-numeric: tabular-nums; }
td:first-child, th:first-child { text-align: left; }
svg { max-width: 100%; height: auto; }
.tables { overflow-x: auto; }
.comparison { margin: 1rem 0; }
.stack { position: relative; }
.stack .above { position: absolute; inset: 0; clip-path: inset(0 calc(100% - var(--share, 50%)) 0 0); visibility: hidden; }
.stack .shown { visibility: visible; }
.stack::after { content: ''; position: absolute; top: 0; bottom: 0; left: var(--share, 50%); border-left: 2px solid #fff; }
.comparison input { width: 100%; margin: .3rem 0; } .comparison button { margin: .2rem .3rem .2rem 0; font: inherit; }
.comparison button.shown { font-weight: 600; outline: 2px solid #48a; }
";

/// The slider and the buttons of a comparison.
const SCRIPT: &str = "
for (const box of document.querySelectorAll('.comparison')) {
  const stack = box.querySelector('.stack');
  box.querySelector('input').oninput = e => stack.style.setProperty('--share', e.target.value + '%');
  const buttons = [...box.querySelectorAll('button')], pictures = [...box.querySelectorAll('.above')];
  buttons.forEach((button, k) => button.onclick = () => {
    [...buttons, ...pictures].forEach(x => x.classList.remove('shown'));
    [button, pictures[k]].forEach(x => x.classList.add('shown'));
  });
}
";

/// The whole page.
pub fn page<'a>(title: &str, introduction: &[String], sections: impl IntoIterator<Item = &'a Section>) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (title) }
                @for line in introduction { p { (line) } }
                @for section in sections { (section_markup(section)) }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    }
    .into_string()
}

fn section_markup(section: &Section) -> Markup {
    html! {
        h2 { (section.title) }
        @for line in &section.text { p { (line) } }
        @if !section.comparisons.is_empty() {
            div class="figures" { @for c in &section.comparisons { (comparison(c)) } }
        }
        @if !section.figures.is_empty() {
            div class="figures" { @for f in &section.figures { (figure(f)) } }
        }
        @if !section.strip.is_empty() {
            div class="strip" { @for f in &section.strip { (figure(f)) } }
        }
        @for table in &section.tables {
            div class="tables" {
                table {
                    caption { (table.caption) }
                    thead { tr { @for cell in &table.head { th { (cell) } } } }
                    tbody { @for row in &table.rows { tr { @for cell in row { td { (cell) } } } } }
                }
            }
        }
        @for p in &section.plots { div { (plot(p, None)) } }
        @for g in &section.graphs { div { (frame_graph(g)) } }
    }
}

fn source(f: &Figure) -> String {
    format!("data:{};base64,{}", f.media, STANDARD.encode(&f.bytes))
}

fn figure(f: &Figure) -> Markup {
    html! {
        figure {
            img alt=(f.caption) src=(source(f));
            figcaption { (f.caption) }
        }
    }
}

fn comparison(c: &Comparison) -> Markup {
    let shown = |k: usize| if k == 0 { "shown" } else { "" };
    html! {
        div class="comparison" {
            div {
                @for (k, f) in c.above.iter().enumerate() { button class=(shown(k)) { (f.caption) } }
            }
            div class="stack" {
                img alt=(c.beneath.caption) src=(source(&c.beneath));
                @for (k, f) in c.above.iter().enumerate() {
                    img class=(format!("above {}", shown(k))) alt=(f.caption) src=(source(f));
                }
            }
            input type="range" min="0" max="100" value="50" aria-label="how much of the picture on the left is shown";
            figcaption { "left: the method of the button; right: " (c.beneath.caption) }
        }
    }
}

/// Width and height of a stage's box, and room between and above boxes.
const BOX: (f64, f64) = (104.0, 40.0);
const GAP: f64 = 34.0;
const ARCS: f64 = 52.0;

/// Stages from left to right, an arrow from each that one reads from.
fn frame_graph(g: &FrameGraph) -> Markup {
    let left = |k: usize| 4.0 + k as f64 * (BOX.0 + GAP);
    let top = TOP + ARCS;
    let width = left(g.stages.len()) - GAP + 4.0;
    let height = top + BOX.1 + ARCS;
    // Those that skip a stage go round it, above forwards and below backwards.
    let arrow = |from: usize, to: usize| {
        if from + 1 == to {
            let y = top + 0.5 * BOX.1;
            return format!("M {:.0} {y:.0} H {:.0}", left(from) + BOX.0, left(to) - 7.0);
        }
        let forwards = from < to;
        let reach = 18.0 + 9.0 * from.abs_diff(to) as f64;
        let y = if forwards { top } else { top + BOX.1 };
        let bend = if forwards { y - reach } else { y + reach };
        let end = if forwards { y - 7.0 } else { y + 7.0 };
        let a = left(from) + 0.7 * BOX.0;
        let b = left(to) + 0.3 * BOX.0;
        format!("M {a:.0} {y:.0} C {a:.0} {bend:.0} {b:.0} {bend:.0} {b:.0} {end:.0}")
    };
    html! {
        svg viewBox=(format!("0 0 {width} {height}")) width=(width) height=(height) role="img" aria-label=(g.title)
            font-family="sans-serif" {
            defs {
                marker id="tip" viewBox="0 0 8 8" refX="1" refY="4" markerWidth="7" markerHeight="7" orient="auto" {
                    path d="M 0 0 L 8 4 L 0 8 z" fill="#888" {}
                }
            }
            text x="4" y="14" font-size="13" fill="currentColor" font-weight="600" { (g.title) }
            @for (to, (_, _, reads)) in g.stages.iter().enumerate() {
                @for &from in reads {
                    path d=(arrow(from, to)) fill="none" stroke="#888" stroke-width="1.5" marker-end="url(#tip)" {}
                }
            }
            @for (k, (name, ms, _)) in g.stages.iter().enumerate() {
                rect x=(left(k)) y=(top) width=(BOX.0) height=(BOX.1) rx="5" fill=(COLORS[k % COLORS.len()])
                    fill-opacity="0.25" stroke=(COLORS[k % COLORS.len()]) {}
                text x=(left(k) + 0.5 * BOX.0) y=(top + 17.0) font-size="13" text-anchor="middle" fill="currentColor" {
                    (name)
                }
                @if let Some(ms) = ms {
                    text x=(left(k) + 0.5 * BOX.0) y=(top + 33.0) font-size="11" text-anchor="middle" fill="currentColor" {
                        (significant(*ms)) " ms"
                    }
                }
            }
        }
    }
}

/// Most places of x that are named.
const MAX_MARKS: usize = 6;

/// Colours of lines, over again when they are used up.
const COLORS: [&str; 14] = [
    "#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#888888", "#cc6633", "#7755cc", "#77aa99",
    "#996622", "#dd99bb", "#335500", "#0000aa",
];
/// Least height of a plot, and room at its left, its bottom and its top.
const HEIGHT: f64 = 240.0;
/// From the end of the lines to their names, wider than half a mark, and from name to name.
const NAMES: f64 = 14.0;
const NAME_HEIGHT: f64 = 16.0;
const LEFT: f64 = 60.0;
const BOTTOM: f64 = 28.0;
const TOP: f64 = 26.0;

/// Range of an axis.
struct Axis {
    first: f64,
    last: f64,
    is_logarithmic: bool,
}

impl Axis {
    fn scale(&self, v: f64) -> f64 {
        if self.is_logarithmic { v.max(f64::MIN_POSITIVE).ln() } else { v }
    }

    /// Position of a value between both ends, from 0 to 1.
    fn share(&self, v: f64) -> f64 {
        let first = self.scale(self.first);
        (self.scale(v.max(self.first)) - first) / (self.scale(self.last) - first).max(1e-12)
    }
}

/// The x axis, and the places on it that are named.
fn x_axis(p: &Plot) -> (Axis, Vec<f64>) {
    let mut marks: Vec<f64> = p.series.iter().flat_map(|s| &s.points).map(|point| point.0).collect();
    marks.sort_by(f64::total_cmp);
    marks.dedup();
    let first = marks.first().copied().unwrap_or(0.0);
    let last = marks.last().copied().unwrap_or(0.0);
    // What is none would be infinitely far.
    let first = if p.logarithmic { first.max(1e-6 * last) } else { first };
    if marks.len() > MAX_MARKS {
        marks = match p.logarithmic {
            true => round_levels(first, last),
            false => vec![first, last],
        };
    }
    (Axis { first, last, is_logarithmic: p.logarithmic }, marks)
}

/// The y axis, and the levels that are named.
fn y_axis(p: &Plot) -> (Axis, Vec<f64>) {
    let values = || p.series.iter().flat_map(|s| &s.points).map(|point| point.1);
    let greatest = values().fold(0.0f64, f64::max).max(1e-12) * 1.08;
    if !p.logarithmic {
        let levels = (0..=4).map(|step| greatest * f64::from(step) / 4.0).collect();
        return (Axis { first: 0.0, last: greatest, is_logarithmic: false }, levels);
    }
    let least = values().fold(greatest, f64::min).max(1e-3 * greatest) / 1.08;
    (Axis { first: least, last: greatest, is_logarithmic: true }, round_levels(least, greatest))
}

fn plot(p: &Plot, namespace: Option<&str>) -> Markup {
    // Room for the names, some seven pixels a letter.
    let names = p.series.iter().map(|s| &s.name).chain([&p.x]);
    let longest = names.map(|name| name.chars().count()).max().unwrap_or(0);
    let right = (NAMES + 6.0 + 7.0 * longest as f64).max(178.0);
    let width = 590.0 + right;
    let height = HEIGHT.max(TOP + BOTTOM + NAME_HEIGHT * p.series.len() as f64);
    let (x_axis, marks) = x_axis(p);
    let (y_axis, levels) = y_axis(p);
    let x = |v: f64| LEFT + (width - LEFT - right) * x_axis.share(v);
    let y = |v: f64| height - BOTTOM - (height - BOTTOM - TOP) * y_axis.share(v);
    html! {
        svg xmlns=[namespace] viewBox=(format!("0 0 {width} {height}")) width=(width) height=(height) role="img"
            aria-label=(p.title) font-family="sans-serif" {
            text x=(LEFT) y="14" font-size="13" fill="currentColor" font-weight="600" { (p.title) ", " (p.unit) }
            @for &v in &levels {
                line x1=(LEFT) x2=(width - right) y1=(y(v)) y2=(y(v)) stroke="#8884" {}
                text x=(LEFT - 6.0) y=(y(v) + 4.0) font-size="11" text-anchor="end" fill="currentColor" {
                    (significant(v))
                }
            }
            @for mark in &marks {
                // The last one must not run into what x is.
                @let anchor = if *mark == x_axis.last { "end" } else { "middle" };
                text x=(x(*mark)) y=(height - 8.0) font-size="11" text-anchor=(anchor) fill="currentColor" {
                    (if mark.fract() == 0.0 { mark.to_string() } else { significant(*mark) })
                }
            }
            text x=(width - right + NAMES) y=(height - 8.0) font-size="11" fill="currentColor" { (p.x) }
            @for (k, s) in p.series.iter().enumerate() {
                @let line = s.points.iter().map(|(u, v)| format!("{:.1},{:.1}", x(*u), y(*v)));
                polyline points=(line.collect::<Vec<_>>().join(" ")) fill="none" stroke-width="2"
                    stroke=(COLORS[k % COLORS.len()]) {}
                @if p.logarithmic {
                    @for (u, v) in &s.points { circle cx=(x(*u)) cy=(y(*v)) r="3" fill=(COLORS[k % COLORS.len()]) {} }
                }
                text x=(width - right + NAMES) y=(TOP + 14.0 + NAME_HEIGHT * k as f64) font-size="12"
                    fill=(COLORS[k % COLORS.len()]) { (s.name) }
            }
        }
    }
}

/// Round numbers in a range: 1, 2 and 5 times powers of ten, and more of them in less than a decade.
fn round_levels(least: f64, greatest: f64) -> Vec<f64> {
    let digits: &[f64] = if greatest < 10.0 * least { &[1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0] } else { &[1.0, 2.0, 5.0] };
    let power = |x: f64| x.max(f64::MIN_POSITIVE).log10().floor() as i32;
    let powers = power(least)..=power(greatest);
    let levels = powers.flat_map(|power| digits.iter().map(move |digit| digit * 10f64.powi(power)));
    levels.filter(|level| (least..=greatest).contains(level)).collect()
}

/// A number with three significant digits.
pub fn significant(v: f64) -> String {
    if v == 0.0 || !v.is_finite() {
        return format!("{v}");
    }
    let digits = 2 - v.abs().log10().floor() as i32;
    format!("{v:.*}", digits.clamp(0, 12) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line() -> Plot {
        let series = vec![Series { name: "s".into(), points: vec![(100.0, 1.0), (1000.0, 2.0), (10_000.0, 1.5)] }];
        Plot { title: "p".into(), unit: "ms".into(), x: "patches".into(), logarithmic: true, series }
    }

    #[test]
    fn a_logarithmic_plot_has_equal_distances_for_equal_ratios() {
        let svg = line().svg();
        assert!(svg.contains("xmlns=") && svg.contains(">1000<"), "{svg}");
        let line = svg.split("polyline points=\"").nth(1).unwrap().split('"').next().unwrap();
        let places: Vec<f64> = line.split(' ').map(|p| p.split(',').next().unwrap().parse().unwrap()).collect();
        assert!((places[0] + places[2] - 2.0 * places[1]).abs() < 0.2 && places[2] > places[0], "{places:?}");
    }

    #[test]
    fn many_places_are_named_by_round_numbers_and_names_fit() {
        let points: Vec<(f64, f64)> = (0..20).map(|k| (0.3 * 1.3f64.powi(k), 1.0 + f64::from(k))).collect();
        // An error may be none.
        let none = points.iter().copied().chain([(0.0, 1.0)]).collect();
        let with_none = Plot { series: vec![Series { name: "s".into(), points: none }], ..line() }.svg();
        assert!(with_none.contains(">10<") && with_none.contains("cx=\"60\""), "{with_none}");
        let plot = Plot { x: "a".repeat(60), series: vec![Series { name: "s".into(), points }], ..line() };
        let svg = plot.svg();
        assert!([">0.500<", ">1<", ">10<"].iter().all(|mark| svg.contains(mark)) && !svg.contains(">0.300<"), "{svg}");
        let width: f64 = svg.split("width=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap();
        assert!(width > 590.0 + 60.0 * 6.5, "{width}");
    }

    #[test]
    fn levels_are_round() {
        let levels = round_levels(0.3, 12.0);
        assert_eq!(levels.len(), 5);
        assert!(levels.iter().zip([0.5, 1.0, 2.0, 5.0, 10.0]).all(|(a, b)| (a / b - 1.0).abs() < 1e-12), "{levels:?}");
        assert_eq!(round_levels(1.9, 4.5), [2.0, 3.0, 4.0]);
    }

    #[test]
    fn a_table_as_markdown() {
        let rows = vec![vec!["a".into(), "1".into()]];
        let table = Table { caption: "t".into(), head: vec!["x".into(), "y".into()], rows };
        assert_eq!(table.markdown(), "t\n\n| x | y |\n| --- | ---: |\n| a | 1 |\n");
    }

    #[test]
    fn the_page_holds_everything_itself() {
        let figure = |caption: &str| Figure { caption: caption.into(), bytes: vec![1, 2, 3], media: "image/png" };
        let section = Section {
            title: "One".into(),
            text: vec!["text".into()],
            comparisons: vec![Comparison { beneath: figure("traced"), above: vec![figure("ours")] }],
            figures: vec![figure("a < b")],
            graphs: vec![FrameGraph {
                title: "graph".into(),
                stages: vec![("direct".into(), Some(1.5), vec![2]), ("method".into(), None, vec![0, 2])],
            }],
            tables: vec![Table { caption: "t".into(), head: vec!["h".into()], rows: vec![vec!["cell".into()]] }],
            plots: vec![line()],
            ..Section::default()
        };
        let page = page("Title", &[], &[section]);
        assert!(page.contains("data:image/png;base64,AQID") && page.contains("a &lt; b") && page.contains("polyline"));
        assert!(page.contains("1.50 ms") && page.contains(">ours</button>"));
        // Nothing from elsewhere.
        assert!(!page.contains("http") && !page.contains("src=\"/"));
    }

    #[test]
    fn three_digits() {
        assert_eq!(significant(1234.5), "1234");
        assert_eq!(significant(0.012_345), "0.0123");
        assert_eq!(significant(2.0), "2.00");
        assert_eq!(significant(0.0), "0");
    }
}
