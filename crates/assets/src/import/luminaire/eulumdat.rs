//! EULUMDAT: one value a line, intensities in cd per 1000 lm of the lamps' flux.

use super::{MAX_ANGLES, MAX_QUANTITY, Sheet, Symmetry, Text};
use crate::import::ImportError;

/// Lines before those of the sets of lamps.
const HEADER: usize = 26;
/// Lines of a set of lamps.
const SET: usize = 6;
/// Lines of direct ratios behind them.
const RATIOS: usize = 10;
/// Most sets of lamps.
const MAX_SETS: usize = 20;

/// A line of a file that holds one number, counted from 0.
fn number(text: &Text, line: usize, name: &str) -> Result<f64, ImportError> {
    let Some(word) = text.lines.get(line) else {
        return Err(text.fault(line, format!("the file ends where {name} should be; give a whole file")));
    };
    // Some programs write decimal commas.
    text.number(line, name, &word.trim().trim_end_matches(['\u{1a}', '\0']).replace(',', "."))
}

fn within(text: &Text, line: usize, name: &str, least: f64, most: f64) -> Result<f64, ImportError> {
    let value = number(text, line, name)?;
    if (least..=most).contains(&value) {
        return Ok(value);
    }
    Err(text.fault(line, format!("{name} is {value}; give {least} to {most:e}")))
}

fn count(text: &Text, line: usize, name: &str, least: usize, most: usize) -> Result<usize, ImportError> {
    let value = number(text, line, name)?;
    if value == value.trunc() && (least as f64..=most as f64).contains(&value) {
        return Ok(value as usize);
    }
    Err(text.fault(line, format!("{name} is {value}; give a whole number from {least} to {most}")))
}

/// Rising angles in lines from `first` on, degrees.
fn angles(text: &Text, first: usize, count: usize, name: &str, most: f64) -> Result<Vec<f64>, ImportError> {
    let mut angles: Vec<f64> = Vec::new();
    for line in first..first + count {
        let angle = within(text, line, name, 0.0, most)?;
        if angles.last().is_some_and(|before| angle <= *before) {
            return Err(
                text.fault(line, format!("{name} {angle} does not follow on the one before; give rising angles"))
            );
        }
        angles.push(angle);
    }
    Ok(angles)
}

/// The half-planes whose intensities are in the file, of all `planes`, and how the others follow.
fn stored_planes(text: &Text, kind: usize, planes: &[f64], first: usize) -> Result<(Vec<f64>, Symmetry), ImportError> {
    let count = planes.len();
    let (symmetry, begin, rows, ends) = match kind {
        0 => (Symmetry::None, 0, count, None),
        1 => (Symmetry::None, 0, 1, None),
        2 => (Symmetry::AboutC0, 0, count / 2 + 1, Some((0.0, 180.0))),
        3 => (Symmetry::AboutC90, count / 4 * 3, count / 2 + 1, Some((270.0, 90.0))),
        _ => (Symmetry::Quadrants, 0, count / 4 + 1, Some((0.0, 90.0))),
    };
    let stored: Vec<f64> = (0..rows).map(|k| planes[(begin + k) % count]).collect();
    let is_near = |a: f64, b: f64| (a - b).abs() < 1e-3;
    let found = (stored[0], stored[rows - 1]);
    match ends {
        Some((from, to)) if !(is_near(found.0, from) && is_near(found.1, to)) => {
            let reason = format!(
                "symmetry {kind} holds half-planes from C{from} to C{to}, these are C{} to C{}; correct the angles or \
                 the symmetry",
                found.0, found.1
            );
            Err(text.fault(first, reason))
        }
        _ => Ok((stored, symmetry)),
    }
}

/// Reads a file with one of its sets of lamps, counted from 1.
pub fn parse(text: &mut Text, lamp_set: usize) -> Result<Sheet, ImportError> {
    let kind = count(text, 2, "the symmetry (Isym)", 0, 4)?;
    let plane_count = count(text, 3, "the number of C planes", 1, MAX_ANGLES)?;
    let least = [1, 1, 2, 4, 4][kind];
    if plane_count % least != 0 {
        let reason = format!("symmetry {kind} needs a number of C planes that {least} divides, not {plane_count}");
        return Err(text.fault(3, reason));
    }
    let gamma_count = count(text, 5, "the number of intensities in a C plane", 2, MAX_ANGLES)?;
    let mut size = [0.0; 3];
    for (length, (line, name)) in size.iter_mut().zip([(15, "length"), (16, "width"), (17, "height")]) {
        *length = within(text, line, &format!("the {name} of the luminous area"), 0.0, 1e9)? / 1000.0;
    }
    if size[1] == 0.0 {
        // Round: the length is the diameter.
        size[1] = size[0];
    }
    let conversion = within(text, 23, "the conversion factor of the intensities", 1e-9, 1e9)?;
    let sets = count(text, 25, "the number of sets of lamps", 1, MAX_SETS)?;
    if !(1..=sets).contains(&lamp_set) {
        return Err(text.fault(25, format!("has {sets} sets of lamps, lamp_set {lamp_set} is not there")));
    }
    let flux_of = |set: usize| {
        let line = HEADER + SET * (set - 1) + 2;
        within(text, line, &format!("the flux of lamp set {set}"), 1e-6, MAX_QUANTITY)
    };
    let lamp_flux = flux_of(lamp_set)?;
    let lamps = number(text, HEADER + SET * (lamp_set - 1), "the number of lamps")?;
    let mut others = Vec::new();
    for set in 1..=sets {
        others.push(format!("{} lm", flux_of(set)?));
    }
    let first_plane = HEADER + SET * sets + RATIOS;
    let first_gamma = first_plane + plane_count;
    let first_value = first_gamma + gamma_count;
    let planes = angles(text, first_plane, plane_count, "the C angle", 360.0 - 1e-6)?;
    let gammas = angles(text, first_gamma, gamma_count, "the γ angle", 180.0)?;
    let (planes, symmetry) = stored_planes(text, kind, &planes, first_plane)?;
    let scale = lamp_flux / 1000.0 * conversion;
    let mut intensities = Vec::new();
    for line in first_value..first_value + planes.len() * gamma_count {
        intensities.push(within(text, line, "an intensity", 0.0, MAX_QUANTITY)? * scale);
    }
    if sets > 1 {
        let what = format!("has lamps of {}; set {lamp_set} is taken (lamp_set chooses)", others.join(", "));
        text.warn(25, &what);
    }
    // A negative number of lamps says that the luminaire as a whole was measured.
    let lamp_flux = (lamps >= 0.0).then_some(lamp_flux);
    Ok(Sheet { gammas, planes, symmetry, intensities, line: first_value, lamp_flux, size })
}
