//! The self-contained report: pictures inside, tables, a small plot; no script, no other file.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// A picture of the report.
pub struct Figure {
    /// Text under it.
    pub caption: String,
    /// PNG bytes.
    pub png: Vec<u8>,
}

/// A table of the report: a head and rows of cells.
pub struct Table {
    /// Text above it.
    pub caption: String,
    /// Column heads.
    pub head: Vec<String>,
    /// Rows, first cell a row head.
    pub rows: Vec<Vec<String>>,
}

/// A line of a plot.
pub struct Series {
    /// Its name.
    pub name: String,
    /// One value a frame.
    pub values: Vec<f64>,
}

/// One section of the report.
pub struct Section {
    /// Heading.
    pub title: String,
    /// Paragraphs under the heading.
    pub text: Vec<String>,
    /// Pictures side by side.
    pub figures: Vec<Figure>,
    /// Frames of an animation as a strip.
    pub strip: Vec<Figure>,
    /// Tables.
    pub tables: Vec<Table>,
    /// Plot over frames: title, unit and lines.
    pub plot: Option<(String, String, Vec<Series>)>,
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
";

/// The whole page.
pub fn page(title: &str, introduction: &[String], sections: &[Section]) -> String {
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
            }
        }
    }
    .into_string()
}

fn section_markup(section: &Section) -> Markup {
    html! {
        h2 { (section.title) }
        @for line in &section.text { p { (line) } }
        @if !section.figures.is_empty() {
            div class="figures" { @for f in &section.figures { (figure(f)) } }
        }
        @if !section.strip.is_empty() {
            div class="strip" { @for f in &section.strip { (figure(f)) } }
        }
        @for table in &section.tables {
            table {
                caption { (table.caption) }
                thead { tr { @for cell in &table.head { th { (cell) } } } }
                tbody { @for row in &table.rows { tr { @for cell in row { td { (cell) } } } } }
            }
        }
        @if let Some((title, unit, series)) = &section.plot { (plot(title, unit, series)) }
    }
}

fn figure(f: &Figure) -> Markup {
    html! {
        figure {
            img alt=(f.caption) src=(format!("data:image/png;base64,{}", STANDARD.encode(&f.png)));
            figcaption { (f.caption) }
        }
    }
}

/// Lines over frames as SVG, from zero to the greatest value.
fn plot(title: &str, unit: &str, series: &[Series]) -> Markup {
    const COLORS: [&str; 6] = ["#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377"];
    let (width, height, left, bottom, top) = (720.0, 240.0, 60.0, 28.0, 26.0);
    let count = series.iter().map(|s| s.values.len()).max().unwrap_or(0).max(2);
    let greatest = series.iter().flat_map(|s| &s.values).fold(0.0f64, |a, &b| a.max(b)).max(1e-12) * 1.08;
    let x = |k: usize| left + (width - left - 130.0) * k as f64 / (count - 1) as f64;
    let y = |v: f64| height - bottom - (height - bottom - top) * v / greatest;
    html! {
        svg viewBox=(format!("0 0 {width} {height}")) width=(width) height=(height) role="img" aria-label=(title) {
            text x=(left) y="14" font-size="13" fill="currentColor" font-weight="600" { (title) ", " (unit) }
            @for step in 0..=4 {
                @let v = greatest * f64::from(step) / 4.0;
                line x1=(left) x2=(width - 130.0) y1=(y(v)) y2=(y(v)) stroke="#8884" {}
                text x=(left - 6.0) y=(y(v) + 4.0) font-size="11" text-anchor="end" fill="currentColor" {
                    (significant(v))
                }
            }
            text x=(x(0)) y=(height - 8.0) font-size="11" fill="currentColor" { "frame 0" }
            text x=(x(count - 1)) y=(height - 8.0) font-size="11" text-anchor="end" fill="currentColor" { (count - 1) }
            @for (k, s) in series.iter().enumerate() {
                @let points = s.values.iter().enumerate().map(|(i, v)| format!("{:.1},{:.1}", x(i), y(*v)));
                polyline points=(points.collect::<Vec<_>>().join(" ")) fill="none" stroke-width="2"
                    stroke=(COLORS[k % COLORS.len()]) {}
                text x=(width - 124.0) y=(top + 14.0 + 16.0 * k as f64) font-size="12" fill=(COLORS[k % COLORS.len()]) {
                    (s.name)
                }
            }
        }
    }
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

    #[test]
    fn the_page_holds_everything_itself() {
        let figure = Figure { caption: "a < b".into(), png: vec![1, 2, 3] };
        let section = Section {
            title: "One".into(),
            text: vec!["text".into()],
            figures: vec![figure],
            strip: vec![],
            tables: vec![Table { caption: "t".into(), head: vec!["h".into()], rows: vec![vec!["cell".into()]] }],
            plot: Some(("p".into(), "ms".into(), vec![Series { name: "s".into(), values: vec![1.0, 2.0] }])),
        };
        let page = page("Title", &[], &[section]);
        assert!(page.contains("data:image/png;base64,AQID") && page.contains("a &lt; b") && page.contains("polyline"));
        assert!(!page.contains("http") && !page.contains("<script"));
    }

    #[test]
    fn three_digits() {
        assert_eq!(significant(1234.5), "1234");
        assert_eq!(significant(0.012_345), "0.0123");
        assert_eq!(significant(2.0), "2.00");
        assert_eq!(significant(0.0), "0");
    }
}
