//! IES LM-63, editions 1986 to 2019, photometry of type C.

use super::{MAX_ANGLES, MAX_QUANTITY, Sheet, Symmetry, Text};
use crate::import::ImportError;

/// Metres of a foot.
const FOOT: f64 = 0.3048;

/// The numbers after the line `TILT=`, word by word, with the line of the last one.
struct Numbers<'a, 'b> {
    text: &'a Text<'b>,
    words: Vec<(usize, &'b str)>,
    next: usize,
    line: usize,
}

impl Numbers<'_, '_> {
    fn number(&mut self, name: &str) -> Result<f64, ImportError> {
        let Some(&(line, word)) = self.words.get(self.next) else {
            return Err(self.text.fault(self.line, format!("the file ends where {name} should be; give a whole file")));
        };
        self.next += 1;
        self.line = line;
        self.text.number(line, name, word)
    }

    fn within(&mut self, name: &str, least: f64, most: f64) -> Result<f64, ImportError> {
        let value = self.number(name)?;
        if (least..=most).contains(&value) {
            return Ok(value);
        }
        Err(self.text.fault(self.line, format!("{name} is {value}; give {least} to {most:e}")))
    }

    fn count(&mut self, name: &str, least: usize, most: usize) -> Result<usize, ImportError> {
        let value = self.number(name)?;
        if value == value.trunc() && (least as f64..=most as f64).contains(&value) {
            return Ok(value as usize);
        }
        Err(self.text.fault(self.line, format!("{name} is {value}; give a whole number from {least} to {most}")))
    }

    /// Angles that rise, in degrees.
    fn angles(&mut self, name: &str, count: usize, most: f64) -> Result<Vec<f64>, ImportError> {
        let mut angles: Vec<f64> = Vec::new();
        for _ in 0..count {
            let angle = self.within(name, 0.0, most)?;
            if angles.last().is_some_and(|before| angle <= *before) {
                let reason = format!("{name} {angle} does not follow on the one before; give rising angles");
                return Err(self.text.fault(self.line, reason));
            }
            angles.push(angle);
        }
        Ok(angles)
    }
}

/// Returns true if the last of the two factors before the watts is one: the ballast-lamp photometric factor of 1986 and
/// 1991, which later editions keep for other uses.
fn has_lamp_factor(first_line: &str) -> bool {
    let edition = first_line.trim().to_ascii_uppercase();
    !edition.starts_with("IES") || edition.starts_with("IESNA91")
}

/// Reads a file.
pub fn parse(text: &mut Text) -> Result<Sheet, ImportError> {
    let tilt = |line: &str| {
        let line: String = line.chars().filter(|c| !c.is_whitespace()).collect();
        line.get(..5).filter(|start| start.eq_ignore_ascii_case("TILT=")).map(|_| line[5..].to_owned())
    };
    let Some((line, tilt)) = text.lines.iter().enumerate().find_map(|(k, line)| Some((k, tilt(line)?))) else {
        return Err(text.fault(0, "has no line that begins with TILT=; give an IES LM-63 file"));
    };
    let words = text.lines.iter().enumerate().skip(line + 1);
    let words = words.flat_map(|(k, line)| {
        let words = line.split([' ', '\t', ',', '\u{c}', '\u{1a}', '\0']).filter(|word| !word.is_empty());
        words.map(move |word| (k, word))
    });
    let mut numbers = Numbers { text, words: words.collect(), next: 0, line };
    let tilt = match tilt.to_ascii_uppercase().as_str() {
        "NONE" => Tilt { factor: 1.0, has_others: false },
        "INCLUDE" => read_tilt(&mut numbers)?,
        _ => {
            let reason = format!(
                "TILT={} names a file of tilt factors, which is not read; write TILT=NONE where the luminaire hangs \
                 as it was measured, or the factors into this file (TILT=INCLUDE)",
                super::shortened(&tilt)
            );
            return Err(text.fault(line, reason));
        }
    };
    let sheet = read_table(&mut numbers, tilt.factor)?;
    if tilt.has_others {
        text.warn(line, "its lamps shine differently when tilted; it is taken as it hangs when measured");
    }
    Ok(sheet)
}

/// Tilt factors: light lost or gained when a lamp hangs askew.
struct Tilt {
    /// Factor of the intensities of a luminaire that hangs as it was measured.
    factor: f64,
    /// True if the values of other angles differ from it.
    has_others: bool,
}

fn read_tilt(numbers: &mut Numbers) -> Result<Tilt, ImportError> {
    numbers.count("the position of the lamp (TILT=INCLUDE)", 1, 3)?;
    let count = numbers.count("the number of tilt angles", 1, MAX_ANGLES)?;
    let mut angles = Vec::new();
    for _ in 0..count {
        angles.push(numbers.within("a tilt angle", -180.0, 180.0)?);
    }
    let mut factors = Vec::new();
    for _ in 0..count {
        factors.push(numbers.within("a tilt factor", 0.0, 1e3)?);
    }
    let level = angles.iter().position(|angle| *angle == 0.0).unwrap_or(0);
    let factor = factors[level];
    Ok(Tilt { factor, has_others: factors.iter().any(|other| *other != factor) })
}

/// All behind the tilt.
fn read_table(numbers: &mut Numbers, tilt: f64) -> Result<Sheet, ImportError> {
    let has_lamp_factor = has_lamp_factor(numbers.text.lines[0]);
    let lamps = numbers.within("the number of lamps", 0.0, 1e6)?;
    let lumens = numbers.number("the flux of a lamp")?;
    if lumens != -1.0 && !(0.0..=MAX_QUANTITY).contains(&lumens) {
        let reason = format!("the flux of a lamp is {lumens} lm; give a flux, or -1 for absolute photometry");
        return Err(numbers.text.fault(numbers.line, reason));
    }
    let multiplier = numbers.within("the multiplier of the intensities", 1e-9, 1e9)?;
    let gamma_count = numbers.count("the number of vertical angles", 2, MAX_ANGLES)?;
    let plane_count = numbers.count("the number of horizontal angles", 1, MAX_ANGLES)?;
    match numbers.count("the type of photometry", 1, 3)? {
        1 => {}
        other => {
            let name = if other == 2 { "B" } else { "A" };
            let reason = format!("is photometry of type {name}, which is not read; export it as type C");
            return Err(numbers.text.fault(numbers.line, reason));
        }
    }
    let unit = if numbers.count("the unit of lengths", 1, 2)? == 1 { FOOT } else { 1.0 };
    let mut size = [0.0; 3];
    for (length, name) in size.iter_mut().zip(["the width", "the length", "the height"]) {
        // Negative ones say that an outline is round.
        *length = numbers.within(name, -1e6, 1e6)?.abs() * unit;
    }
    let ballast = numbers.within("the ballast factor", 1e-6, 1e6)?;
    let lamp_factor = numbers.number("the factor after the ballast factor")?;
    if has_lamp_factor && !(1e-6..=1e6).contains(&lamp_factor) {
        let reason = format!("the ballast-lamp photometric factor is {lamp_factor}; give a factor above 0");
        return Err(numbers.text.fault(numbers.line, reason));
    }
    numbers.number("the electric power")?;
    let gammas = numbers.angles("the vertical angle", gamma_count, 180.0)?;
    let mut planes = numbers.angles("the horizontal angle", plane_count, 360.0)?;
    let symmetry = symmetry(numbers, &planes)?;
    let line = numbers.line;
    let scale = multiplier * ballast * tilt * if has_lamp_factor { lamp_factor } else { 1.0 };
    let mut intensities = Vec::new();
    for _ in 0..plane_count * gamma_count {
        intensities.push(numbers.within("an intensity", 0.0, MAX_QUANTITY)? * scale);
    }
    if symmetry == Symmetry::None && planes.len() > 1 && planes[planes.len() - 1] == 360.0 {
        // The first half-plane again.
        planes.pop();
        intensities.truncate(planes.len() * gamma_count);
    }
    let lamp_flux = (lumens != -1.0).then_some(lamps * lumens);
    Ok(Sheet { gammas, planes, symmetry, intensities, line, lamp_flux, size })
}

/// Symmetry implied by the first and the last horizontal angle.
fn symmetry(numbers: &Numbers, planes: &[f64]) -> Result<Symmetry, ImportError> {
    match (planes[0], planes[planes.len() - 1]) {
        (0.0, 0.0) => Ok(Symmetry::None),
        (0.0, 90.0) => Ok(Symmetry::Quadrants),
        (0.0, 180.0) => Ok(Symmetry::AboutC0),
        (90.0, 270.0) => Ok(Symmetry::AboutC90),
        (0.0, last) if last > 180.0 => Ok(Symmetry::None),
        (first, last) => {
            let reason = format!(
                "horizontal angles go from {first} to {last}; give them from 0 to 0, 90, 180 or 360, or from 90 to 270"
            );
            Err(numbers.text.fault(numbers.line, reason))
        }
    }
}
