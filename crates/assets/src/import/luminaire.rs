//! Luminaires as they were measured: IES LM-63 and EULUMDAT files, which hold intensities by direction in candela.
//!
//! Angles are those of the files: γ from the luminaire's axis (vertical angle), C round it (horizontal angle,
//! half-plane). A luminaire is a point: light at a distance d is I(C, γ)/d², which is right to about 1 % from five
//! times its size on.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use scene::Distribution;

use super::ImportError;

mod eulumdat;
mod ies;

/// Greatest file: a table of a quarter of a degree by a degree is a tenth of it.
const MAX_BYTES: u64 = 16 << 20;
/// Most angles of one kind: twenty a degree.
const MAX_ANGLES: usize = 7200;
/// Greatest intensity in candela and greatest flux in lumen: squares are numbers of single precision.
const MAX_QUANTITY: f64 = 1e15;

/// Photometric data of a luminaire from a file.
#[derive(Clone, Debug)]
pub struct Photometry {
    /// Intensities, cd.
    pub distribution: Distribution,
    /// Flux of the bare lamps, lm; none where the luminaire was measured absolutely.
    pub lamp_flux: Option<f64>,
    /// Size of the luminous part, m: along C = 90°, along C = 0 and upwards.
    pub size: [f64; 3],
    /// Data that may have been meant otherwise than it was read.
    pub warnings: Vec<String>,
}

impl Photometry {
    /// Flux that leaves the luminaire, lm: 4π times the mean intensity.
    pub fn flux(&self) -> f64 {
        4.0 * std::f64::consts::PI * self.distribution.mean()
    }
}

/// Reads an IES LM-63 (`.ies`) or EULUMDAT (`.ldt`) file. `lamp_set` counts the sets of lamps of an EULUMDAT file from
/// 1; an IES file has one.
///
/// # Errors
/// [`ImportError::Luminaire`] with the line; what [`ImportError`] says of files that cannot be read.
pub fn read(path: &Path, lamp_set: usize) -> Result<Photometry, ImportError> {
    let whole = |reason: String| ImportError::Luminaire { path: path.to_path_buf(), line: 1, reason };
    let ending = super::ending(path);
    match ending.as_str() {
        "ies" if lamp_set != 1 => return Err(whole(format!("has one set of lamps, lamp_set {lamp_set} is not there"))),
        "ies" | "ldt" => {}
        _ => return Err(whole(String::from("is no photometry by its ending; give an .ies or .ldt file"))),
    }
    if std::fs::metadata(path).is_ok_and(|file| file.len() > MAX_BYTES) {
        return Err(whole(format!("is larger than {} MB; give a file of a single luminaire", MAX_BYTES >> 20)));
    }
    let bytes = super::read(path)?;
    // Names and remarks are in any encoding; numbers are ASCII.
    let text = String::from_utf8_lossy(&bytes).replace("\r\n", "\n").replace('\r', "\n");
    let mut text = Text { path, lines: text.trim_end().split('\n').collect(), warnings: Vec::new() };
    let sheet = if ending == "ies" { ies::parse(&mut text)? } else { eulumdat::parse(&mut text, lamp_set)? };
    sheet.finish(text)
}

/// The lines of a file.
struct Text<'a> {
    path: &'a Path,
    lines: Vec<&'a str>,
    warnings: Vec<String>,
}

impl Text<'_> {
    /// A fault in a line, counted from 0.
    fn fault(&self, line: usize, reason: impl Into<String>) -> ImportError {
        let line = line.min(self.lines.len().saturating_sub(1)) + 1;
        ImportError::Luminaire { path: self.path.to_path_buf(), line, reason: reason.into() }
    }

    /// A number that stands in a line.
    fn number(&self, line: usize, name: &str, word: &str) -> Result<f64, ImportError> {
        match word.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(self.fault(line, format!("{name} is \"{}\"; write a number", shortened(word)))),
        }
    }

    fn warn(&mut self, line: usize, what: &str) {
        self.warnings.push(format!("{}, line {}: {what}", self.path.display(), line + 1));
    }
}

/// As much of a word as a message needs.
fn shortened(word: &str) -> String {
    word.chars().take(40).collect()
}

/// Symmetry by which the other half-planes follow from those of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Symmetry {
    /// All are there.
    None,
    /// The plane C0–C180 is a mirror.
    AboutC0,
    /// The plane C90–C270 is a mirror.
    AboutC90,
    /// Both are.
    Quadrants,
}

impl Symmetry {
    /// All half-planes that are equal to one, degrees.
    fn images(self, c: f64) -> Vec<f64> {
        match self {
            Self::None => vec![c],
            Self::AboutC0 => vec![c, -c],
            Self::AboutC90 => vec![c, 180.0 - c],
            Self::Quadrants => vec![c, 180.0 - c, 180.0 + c, -c],
        }
    }
}

/// The numbers of a file, as far as they are checked.
struct Sheet {
    /// Degrees.
    gammas: Vec<f64>,
    /// Those that are in the file, degrees.
    planes: Vec<f64>,
    symmetry: Symmetry,
    /// `[planes · gammas]`, cd.
    intensities: Vec<f64>,
    /// Line in which they begin, from 0.
    line: usize,
    lamp_flux: Option<f64>,
    size: [f64; 3],
}

impl Sheet {
    /// The whole sphere.
    fn finish(self, text: Text) -> Result<Photometry, ImportError> {
        if let Some(value) = self.intensities.iter().find(|value| !(0.0..=MAX_QUANTITY).contains(*value)) {
            let reason = format!("an intensity is {value} cd, which is none; give 0 to {MAX_QUANTITY:e}");
            return Err(text.fault(self.line, reason));
        }
        let row = self.gammas.len();
        // By millionths of a degree, so that the images of one plane are one.
        let mut planes: BTreeMap<i64, usize> = BTreeMap::new();
        for (k, &c) in self.planes.iter().enumerate() {
            for image in self.symmetry.images(c) {
                planes.entry((image.rem_euclid(360.0) * 1e6).round() as i64 % 360_000_000).or_insert(k);
            }
        }
        let rows = planes.values().flat_map(|&k| &self.intensities[k * row..(k + 1) * row]).copied().collect();
        let degrees = planes.keys().map(|&c| c as f64 * 1e-6).collect();
        let distribution = Distribution::new(self.gammas, degrees, rows)
            .map_err(|error| ImportError::Scene { path: text.path.to_path_buf(), source: error })?;
        let mut warnings = text.warnings;
        let error = distribution.grid_error();
        if error > 0.01 {
            warnings.push(format!(
                "{}: its angles lie on no even grid; between the steps that are taken instead, intensities are off by \
                 up to {:.1} % of the greatest",
                text.path.display(),
                100.0 * error
            ));
        }
        if distribution.greatest() == 0.0 {
            warnings.push(format!("{}: all intensities are 0; the luminaire is dark", text.path.display()));
        }
        Ok(Photometry { distribution, lamp_flux: self.lamp_flux, size: self.size, warnings })
    }
}

/// Places that hold distributions of a scene's luminaires in one table, each file once.
#[derive(Default)]
pub struct Luminaires {
    /// By file and set of lamps: where the distribution begins, and the flux, lm.
    known: BTreeMap<(PathBuf, usize), (u32, f64)>,
}

impl Luminaires {
    /// Reads a file if it is not known, adds its distribution to the table; where it begins, and the luminaire's flux,
    /// lm.
    ///
    /// # Errors
    /// Those of [`read`]; [`ImportError::Scene`] where the table grows too large.
    pub fn add(
        &mut self,
        path: &Path,
        lamp_set: usize,
        table: &mut Vec<f32>,
        warnings: &mut Vec<String>,
    ) -> Result<(u32, f64), ImportError> {
        let key = (path.to_path_buf(), lamp_set);
        if let Some(&known) = self.known.get(&key) {
            return Ok(known);
        }
        let mut photometry = read(path, lamp_set)?;
        warnings.append(&mut photometry.warnings);
        let begin = photometry
            .distribution
            .append_to(table)
            .map_err(|source| ImportError::Scene { path: path.to_path_buf(), source })?;
        let found = (begin, photometry.flux());
        self.known.insert(key, found);
        Ok(found)
    }
}
