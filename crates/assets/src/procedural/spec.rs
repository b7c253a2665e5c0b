//! Names of built-in scenes, and their parameters: `NAME`, `NAME:TRIANGLES`, `NAME:KEY=VALUE,KEY=VALUE`.

use std::fmt::Write as _;
use std::ops::RangeInclusive;

use super::{atrium, bay, blinds, city, clutter, cornell, corridor, islands, kitchen, office, rooms, stripes, window};

/// A number that a built-in scene is built with.
#[derive(Clone, Debug)]
pub struct Parameter {
    /// Its key.
    pub name: &'static str,
    /// Effect of the parameter, with its unit.
    pub about: &'static str,
    /// Value when none is given.
    pub default: f64,
    /// Least and greatest value.
    pub range: RangeInclusive<f64>,
    /// True for a count.
    pub is_whole: bool,
}

impl Parameter {
    /// Returns true of one that is there or not.
    fn is_flag(&self) -> bool {
        self.is_whole && self.range == (0.0..=1.0)
    }
}

/// Edge of a square ground plane below the scene, m; without it there is none.
pub const GROUND: Parameter = Parameter {
    name: "ground",
    about: "edge of a square plane round the scene, m; 0 for none",
    default: 0.0,
    range: 0.0..=100_000.0,
    is_whole: false,
};

/// Parameter that may be given by its value alone.
const TRIANGLES: &str = "triangles";

/// A built-in scene.
pub struct BuiltIn {
    /// Its name.
    pub name: &'static str,
    /// Description of the scene.
    pub about: &'static str,
    /// Accepted parameters, beside [`GROUND`].
    pub parameters: &'static [Parameter],
}

/// All built-in scenes.
pub const BUILT_IN: [BuiltIn; 16] = [
    BuiltIn {
        name: "cornell",
        about: "the Cornell Box by its published measurements",
        parameters: cornell::PARAMETERS,
    },
    BuiltIn {
        name: "atrium",
        about: "a court with two storeys of arcades, cloth and an open roof",
        parameters: atrium::PARAMETERS,
    },
    BuiltIn {
        name: "city",
        about: "streets, and houses furnished in every room, in the low sun",
        parameters: city::PARAMETERS,
    },
    BuiltIn {
        name: "office",
        about: "two offices and a corridor with lamps of several kinds",
        parameters: office::PARAMETERS,
    },
    BuiltIn { name: "sealed-box", about: "a closed box in the sun, seen from inside: dark", parameters: &[] },
    BuiltIn { name: "furnace", about: "a closed box that shines from everywhere", parameters: &[] },
    BuiltIn {
        name: "rooms",
        about: "thin-walled rooms on a floor that goes on outside, sun on one side",
        parameters: rooms::PARAMETERS,
    },
    BuiltIn {
        name: "stripes",
        about: "a lamp-lit room with painted stripes, a carpet and a poster that hardly stand off",
        parameters: stripes::PARAMETERS,
    },
    BuiltIn { name: "blinds", about: "a room that the sun enters through slats", parameters: blinds::PARAMETERS },
    BuiltIn {
        name: "clutter",
        about: "a room full of thin-legged chairs, knobs and frames, with a small patch of sun",
        parameters: clutter::PARAMETERS,
    },
    BuiltIn {
        name: "window",
        about: "a room lit by the sky alone, through the panes of a window",
        parameters: window::PARAMETERS,
    },
    BuiltIn { name: "corridor", about: "a corridor lit round two corners", parameters: corridor::PARAMETERS },
    BuiltIn {
        name: "islands",
        about: "open boxes in the air under a sun and a very dim sky",
        parameters: islands::PARAMETERS,
    },
    BuiltIn {
        name: "kitchen",
        about: "a kitchen lit by sun and sky through one window, with a bright sill",
        parameters: kitchen::PARAMETERS,
    },
    BuiltIn {
        name: "bay",
        about: "shining panes close behind arched and straight frames, blinds half down",
        parameters: bay::PARAMETERS,
    },
    BuiltIn {
        name: "gloss",
        about: "varnished boards, bricks by a normal map, balls of brushed metal and of plastic",
        parameters: &[],
    },
];

/// Scenes that each show one kind of fault of global illumination.
pub const STRESS_SCENES: [&str; 9] =
    ["rooms", "stripes", "blinds", "clutter", "window", "corridor", "islands", "kitchen", "bay"];

/// Parameter values of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Values {
    given: Vec<(&'static str, f64)>,
}

impl Values {
    /// The value of a parameter.
    pub fn get(&self, parameter: &Parameter) -> f64 {
        self.given.iter().find(|(name, _)| *name == parameter.name).map_or(parameter.default, |given| given.1)
    }

    /// Value of a parameter in single precision.
    pub fn get_f32(&self, parameter: &Parameter) -> f32 {
        self.get(parameter) as f32
    }

    /// Value of a parameter that counts something.
    pub fn count(&self, parameter: &Parameter) -> usize {
        self.get(parameter) as usize
    }
}

/// The scene that `spec` names, and its values.
///
/// # Errors
/// Why it names none.
pub fn parse(spec: &str) -> Result<(&'static BuiltIn, Values), String> {
    let (name, list) = spec.split_once(':').map_or((spec, None), |(name, list)| (name, Some(list)));
    let Some(scene) = BUILT_IN.iter().find(|scene| scene.name == name) else {
        return Err(format!("is not known; give one of {}", super::NAMES.join(", ")));
    };
    let mut values = Values::default();
    for item in list.iter().flat_map(|list| list.split(',')) {
        let (parameter, value) = parse_item(scene, item)?;
        if values.given.iter().any(|(name, _)| *name == parameter.name) {
            return Err(format!("{} is given twice", parameter.name));
        }
        values.given.push((parameter.name, value));
    }
    Ok((scene, values))
}

fn parse_item(scene: &'static BuiltIn, item: &str) -> Result<(&'static Parameter, f64), String> {
    // The name of a flag stands for itself.
    let is_flag = scene.parameters.iter().any(|p| p.name == item && p.is_flag());
    let (key, text) = item.split_once('=').unwrap_or(if is_flag { (item, "1") } else { (TRIANGLES, item) });
    let known = || scene.parameters.iter().chain([&GROUND]);
    let Some(parameter) = known().find(|p| p.name == key) else {
        let keys: Vec<&str> = known().map(|p| p.name).collect();
        let name = scene.name;
        return Err(match item.contains('=') {
            true => format!("{name} has no parameter {key}; it has {}", keys.join(", ")),
            false => format!("{name} has a fixed number of triangles; write just {name}, or KEY=VALUE"),
        });
    };
    let in_range = |x: &f64| parameter.range.contains(x) && (!parameter.is_whole || x.fract() == 0.0);
    let value = text.parse::<f64>().ok().filter(in_range).ok_or_else(|| {
        let what = match parameter.name {
            TRIANGLES => "a number of triangles".to_owned(),
            name => format!("a value of {name} ({})", parameter.about),
        };
        format!("\"{text}\" is not {what}; give {} to {}", parameter.range.start(), parameter.range.end())
    })?;
    Ok((parameter, value))
}

/// The built-in scenes and their parameters, for `--help`.
pub fn help() -> String {
    let mut text = String::from("Built-in scenes, NAME or NAME:KEY=VALUE,KEY=VALUE:\n");
    for scene in &BUILT_IN {
        // Writing into a string cannot fail.
        let flags = scene.parameters.iter().filter(|p| p.is_flag());
        let flags: String = flags.map(|p| format!("; or {}:{}", scene.name, p.name)).collect();
        let _ = writeln!(text, "  {:11} {}{flags}", scene.name, scene.about);
        for p in scene.parameters.iter().filter(|p| !p.is_flag()) {
            let _ = writeln!(text, "  {:11}   {} [{}]: {}", "", p.name, p.default, p.about);
        }
    }
    let _ = write!(text, "  any of them   {} [{}]: {}", GROUND.name, GROUND.default, GROUND.about);
    text
}
