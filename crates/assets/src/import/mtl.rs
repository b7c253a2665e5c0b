//! MTL: lines brought into the form that `tobj` bears, then `tobj`.

use std::path::Path;

use glam::Vec3;

use super::draft::MaterialDraft;
use super::obj::line_end;
use super::optics::{GLASS, Optics};
use super::pictures::{MaskChannel, Source, guard};
use super::scene_file::beside;

/// Words of a texture option, by its name: how many arguments it has.
const MAP_OPTIONS: [(&str, usize); 10] = [
    ("-blendu", 1),
    ("-blendv", 1),
    ("-cc", 1),
    ("-clamp", 1),
    ("-imfchan", 1),
    ("-texres", 1),
    ("-bm", 1),
    ("-boost", 1),
    ("-mm", 2),
    ("-type", 1),
];

/// Reads a material file and appends its materials; a file that is missing or broken is a warning.
pub fn load(path: &Path, materials: &mut Vec<MaterialDraft>, warnings: &mut Vec<String>) {
    let bytes = match scene::host::read_regular(path) {
        Ok(bytes) => bytes,
        Err(e) => {
            warnings.push(format!("material file {}: cannot be read ({e}); mid-grey is used", path.display()));
            return;
        }
    };
    let text = canonical(path, &String::from_utf8_lossy(&bytes), warnings);
    let loaded = guard(|| tobj::load_mtl_buf(&mut text.as_bytes()).map_err(|e| e.to_string()));
    match loaded {
        Ok((loaded, _)) => materials.extend(loaded.iter().map(|m| draft(m, path, warnings))),
        Err(e) => warnings.push(format!("material file {}: {e}; mid-grey is used", path.display())),
    }
}

/// `illum` of a mirror, whose colour is Ks.
const MIRROR: u8 = 5;
/// `illum` of what refracts, without and with Fresnel's mirror.
const REFRACTING: [u8; 2] = [6, 7];

/// Specular reflection and transmission of a material; `illum` alone decides whether there is any.
fn optics(m: &tobj::Material) -> Optics {
    let none = Optics::default();
    match m.illumination_model {
        Some(MIRROR) => Optics { mirror: m.specular.map_or(Vec3::ZERO, Vec3::from), ..none },
        Some(model) if REFRACTING.contains(&model) => {
            let filter = m.unknown_param.get("Tf").and_then(|words| colour(words)).map_or(Vec3::ONE, Vec3::from);
            // Files with this `illum` have d = 1 as often as none.
            let clear = m.dissolve.filter(|d| *d < 1.0).map_or(1.0, |d| 1.0 - d);
            let index_of_refraction = m.optical_density.unwrap_or(GLASS);
            Optics { transmittance: filter * clear, index_of_refraction, ..none }
        }
        _ => none,
    }
}

fn draft(m: &tobj::Material, path: &Path, warnings: &mut Vec<String>) -> MaterialDraft {
    let picture = |name: &String| Source::File(beside(path, name));
    let radiance_picture = m.unknown_param.get("map_Ke").map(picture);
    let mut radiance = m.emissive.map_or(Vec3::ZERO, Vec3::from);
    if radiance_picture.is_some() && radiance == Vec3::ZERO {
        radiance = Vec3::ONE;
    }
    let mut draft = MaterialDraft {
        albedo: m.diffuse.map_or(Vec3::splat(0.5), Vec3::from),
        albedo_picture: m.diffuse_texture.as_ref().map(picture),
        radiance,
        radiance_picture,
        mask: m.dissolve_texture.as_ref().map(|name| (picture(name), MaskChannel::AlphaOrGrey)),
        ..MaterialDraft::new(&m.name)
    };
    for what in draft.set_optics(optics(m)) {
        warnings.push(format!("material {}: {what}", m.name));
    }
    draft.hole = draft.optics.transmittance == Vec3::ZERO && m.dissolve.is_some_and(|d| d < 0.5);
    draft
}

/// The lines that matter, each complete: colours have three numbers, texture options are gone, `Tr` is `d`. What is
/// left out for a fault is a warning with its line.
fn canonical(path: &Path, text: &str, warnings: &mut Vec<String>) -> String {
    let mut out = String::with_capacity(text.len());
    let mut in_material = false;
    for (number, line) in text.split(char::from(line_end(text.as_bytes()))).enumerate() {
        let mut warn = |what: &str| warnings.push(format!("{}, line {}: {what}", path.display(), number + 1));
        let line = line.trim();
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        if keyword == "newmtl" {
            in_material = !rest.is_empty();
            if !in_material {
                warn("a material without a name was left out");
            }
        }
        if !in_material {
            continue;
        }
        match keyword {
            "newmtl" => out.push_str(&format!("newmtl {rest}\n")),
            "Kd" | "Ke" | "Ks" | "Tf" => match colour(rest) {
                Some([r, g, b]) => out.push_str(&format!("{keyword} {r} {g} {b}\n")),
                None => warn(&format!("\"{line}\" is not a colour of three finite numbers and was left out")),
            },
            "d" | "Tr" => match last_number(rest) {
                Some(x) => out.push_str(&format!("d {}\n", if keyword == "d" { x } else { 1.0 - x })),
                None => warn(&format!("\"{line}\" is not a finite number and was left out")),
            },
            "Ni" | "illum" => match last_number(rest) {
                Some(x) if keyword == "Ni" => out.push_str(&format!("Ni {x}\n")),
                Some(x) if x.fract() == 0.0 && (0.0..=255.0).contains(&x) => out.push_str(&format!("illum {x}\n")),
                _ => warn(&format!("\"{line}\" is not a number that {keyword} can have and was left out")),
            },
            "map_Kd" | "map_d" | "map_Ke" => {
                let (name, had_options) = strip_options(rest);
                if had_options {
                    warn("options of a texture are ignored");
                }
                if name.is_empty() {
                    warn("a texture without a file name was left out");
                } else {
                    out.push_str(&format!("{keyword} {name}\n"));
                }
            }
            _ => {}
        }
    }
    out
}

/// The last word as a finite number.
fn last_number(rest: &str) -> Option<f32> {
    rest.split_whitespace().last().and_then(|w| w.parse::<f32>().ok()).filter(|x| x.is_finite())
}

/// Three finite numbers; one stands for all three.
fn colour(rest: &str) -> Option<[f32; 3]> {
    let values: Vec<f32> = rest.split_whitespace().take(3).map(str::parse).collect::<Result<_, _>>().ok()?;
    let values = match values[..] {
        [x] => [x; 3],
        [r, g, b] => [r, g, b],
        _ => return None,
    };
    values.iter().all(|x| x.is_finite()).then_some(values)
}

/// The file name behind the options, and whether there were any.
fn strip_options(rest: &str) -> (&str, bool) {
    let mut name = rest;
    let mut had_options = false;
    while name.starts_with('-') {
        let (option, mut tail) = name.split_once(char::is_whitespace).unwrap_or((name, ""));
        let known = MAP_OPTIONS.iter().find(|(known, _)| *known == option).map(|(_, count)| *count);
        // -o, -s and -t have one to three numbers.
        let count = match (known, option) {
            (Some(count), _) => count,
            (None, "-o" | "-s" | "-t") => {
                tail.split_whitespace().take(3).take_while(|w| w.parse::<f32>().is_ok()).count()
            }
            (None, _) => return (name, had_options),
        };
        for _ in 0..count {
            tail = tail.trim_start().split_once(char::is_whitespace).map_or("", |(_, tail)| tail);
        }
        name = tail.trim_start();
        had_options = true;
    }
    (name, had_options)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_become_complete_or_a_warning_with_their_number() {
        let mut warnings = Vec::new();
        let text =
            "Kd 1 1 1\nnewmtl a b\nKd 0.5\nKd 1 2\nKe 1 nan 2\nTr 0.75\nmap_Kd -s 1 2 3 -clamp on my pic.png\nbump x\n";
        let out = canonical(Path::new("x.mtl"), text, &mut warnings);
        assert_eq!(out, "newmtl a b\nKd 0.5 0.5 0.5\nd 0.25\nmap_Kd my pic.png\n");
        assert_eq!(warnings.len(), 3, "{warnings:?}");
        assert!(warnings[0].contains("x.mtl, line 4"), "{warnings:?}");
    }

    /// Materials of lines.
    fn read(text: &str) -> (Vec<MaterialDraft>, Vec<String>) {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("a.mtl");
        std::fs::write(&path, text).unwrap();
        let mut materials = Vec::new();
        let mut warnings = Vec::new();
        load(&path, &mut materials, &mut warnings);
        (materials, warnings)
    }

    #[test]
    fn only_illum_makes_mirrors_and_glass() {
        let (plain, warnings) = read("newmtl a\nKd 0.5 0.5 0.5\nKs 0.9 0.9 0.9\nNi 1.4\nTf 1 1 1\nillum 2\n");
        assert_eq!((plain[0].optics, &warnings[..]), (Optics::default(), &[][..]));
        let (mirror, _) = read("newmtl a\nKd 0.1 0.1 0.1\nKs 0.9 0.8 0.7\nillum 5\n");
        assert_eq!(mirror[0].optics, Optics { mirror: Vec3::new(0.9, 0.8, 0.7), ..Optics::default() });
        assert_eq!(mirror[0].albedo, Vec3::splat(0.1));
        let (glass, _) = read("newmtl a\nKd 0 0 0\nTf 1 0.5 1\nNi 1.33\nd 0.2\nillum 7\n");
        let found = glass[0].optics;
        let clear = Vec3::new(0.8, 0.4, 0.8);
        assert!((found.transmittance - clear).abs().max_element() < 1e-6 && found.mirror == Vec3::ZERO, "{found:?}");
        assert_eq!((found.index_of_refraction, glass[0].hole), (1.33, false));
        let (bright, warnings) = read("newmtl a\nKd 0.8 0.8 0.8\nKs 0.6 0.6 0.6\nillum 5\n");
        assert!((bright[0].albedo.x - 0.4).abs() < 1e-6);
        assert!(
            warnings.len() == 1 && warnings[0].contains("material a") && warnings[0].contains("0.8"),
            "{warnings:?}"
        );
        let (_, warnings) = read("newmtl a\nillum many\nNi\n");
        assert_eq!(warnings.len(), 2, "{warnings:?}");
    }
}
