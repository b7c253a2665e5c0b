//! Distributions of luminaires as IES LM-63-2002 files, in intensities over their mean.

use std::fmt::Write as _;

use scene::gpu::LIGHT_LUMINAIRE;
use scene::{Distribution, Lighting};

/// Name of the file that holds the distribution which begins at a place of the scene's table.
pub fn file_name(name: &str, distribution: u32) -> String {
    format!("{name}-luminaire-{distribution}.ies")
}

/// Names and bytes of the files of all luminaires, each distribution once.
pub fn files(lighting: &Lighting, name: &str) -> Vec<(String, Vec<u8>)> {
    let luminaires = lighting.lights.iter().filter(|light| light.kind == LIGHT_LUMINAIRE);
    let mut begins: Vec<u32> = luminaires.map(|light| light.distribution).collect();
    begins.sort_unstable();
    begins.dedup();
    let file = |begin: u32| {
        let distribution = Distribution::of_table(&lighting.distributions, begin)?;
        Some((file_name(name, begin), ies(&distribution).into_bytes()))
    };
    begins.into_iter().filter_map(file).collect()
}

/// Type C, absolute photometry, a luminaire without extent.
fn ies(distribution: &Distribution) -> String {
    let gammas = distribution.gammas();
    let planes = distribution.planes();
    let rows: Vec<&[f64]> = distribution.intensities().chunks(gammas.len()).collect();
    let is_round = planes.len() == 1;
    // The first half-plane closes the circle.
    let closed = if is_round { 1 } else { planes.len() + 1 };
    let mut text = String::from("IESNA:LM-63-2002\n[MANUFAC] written by patchlight\nTILT=NONE\n");
    let _ = writeln!(text, "1 -1 1 {} {closed} 1 2 0 0 0\n1 1 0", gammas.len());
    write_line(&mut text, gammas.iter().copied());
    write_line(&mut text, planes.iter().copied().chain((!is_round).then_some(360.0)));
    for k in 0..closed {
        // Single precision is what the table has.
        write_line(&mut text, rows[k % rows.len()].iter().copied());
    }
    text
}

fn write_line(text: &mut String, values: impl Iterator<Item = f64>) {
    let words: Vec<String> = values.map(|value| (value as f32).to_string()).collect();
    text.push_str(&words.join(" "));
    text.push('\n');
}
