//! Way from light to the colours that are shown.

use assets::LoadedScene;
use clap::{Args, ValueEnum};
use reference::{DisplayTransform, Picture, Tone};
use scene::{Materials, Scene};

/// Most stops of an exposure, up or down.
const MAX_STOPS: f32 = 100.0;

/// Tone curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Curve {
    /// Film in which bright colours fade to white.
    #[default]
    Agx,
    /// Khronos PBR Neutral: colours stay up to 0.8, and near white above.
    Neutral,
    /// What is brighter than white is cut off.
    None,
}

impl Curve {
    /// Its curve.
    pub fn tone(self) -> Tone {
        match self {
            Self::Agx => Tone::Agx,
            Self::Neutral => Tone::Neutral,
            Self::None => Tone::None,
        }
    }
}

/// Normals of surfaces in pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Normals {
    /// Interpolated between vertices, where the file has normals.
    Smooth,
    /// Those of the triangles.
    Flat,
}

/// Reflection of surfaces in pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Reflection {
    /// Diffuse, but for mirrors and glass.
    #[default]
    Diffuse,
    /// With normal maps and rough highlights.
    Gltf,
}

impl Reflection {
    /// Its materials.
    pub fn materials(self) -> Materials {
        match self {
            Self::Diffuse => Materials::Diffuse,
            Self::Gltf => Materials::Gltf,
        }
    }
}

/// Exposure of pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Exposure {
    /// That which makes a picture neither dark nor bright.
    #[default]
    Automatic,
    /// So many stops.
    Stops(f32),
}

/// Options of pictures that are shown; numbers and EXR files stay as they are.
#[derive(Args, Clone, Copy, Debug)]
pub struct DisplayOptions {
    /// Tone curve.
    ///
    /// Of what is shown, in windows and PNG files; EXR files stay linear, and comparisons are of light.
    #[arg(long, value_enum, default_value_t, help_heading = "Picture")]
    pub tone: Curve,
    /// Exposure: STOPS, or auto [default: the scene's, else auto].
    #[arg(
        long,
        value_name = "STOPS",
        allow_hyphen_values = true,
        value_parser = parse_exposure,
        help_heading = "Picture"
    )]
    pub exposure: Option<Exposure>,
    /// Normals: smooth or flat [default: smooth; with --reference flat].
    ///
    /// Smooth ones are interpolated between the vertices of a file that has normals.
    #[arg(long, value_enum, hide_possible_values = true, help_heading = "Picture")]
    pub normals: Option<Normals>,
    /// Surfaces: diffuse, or gltf with highlights [default: diffuse].
    ///
    /// gltf shows normal maps and rough specular lobes. Light between surfaces is the same. Highlights have a roughness
    /// of 0.4 at least; roughness, metalness and normal maps are those of a glTF file, or of the materials in a scene
    /// file.
    #[arg(
        long,
        value_enum,
        value_name = "HOW",
        default_value_t,
        hide_default_value = true,
        hide_possible_values = true,
        help_heading = "Picture"
    )]
    pub materials: Reflection,
}

impl DisplayOptions {
    /// The scene with the normals that pictures of it are to have; those beside a reference are flat, as most
    /// references are, unless the options say otherwise.
    pub fn with_normals(&self, scene: Scene, is_compared: bool) -> Scene {
        let default = if is_compared { Normals::Flat } else { Normals::Smooth };
        match self.normals.unwrap_or(default) {
            Normals::Smooth => scene,
            Normals::Flat => scene.flat(),
        }
    }

    /// As these options and a scene say.
    pub fn shown(&self, loaded: &LoadedScene) -> DisplaySettings {
        let shown = DisplaySettings::of(loaded);
        DisplaySettings {
            tone: self.tone.tone(),
            exposure: self.exposure.unwrap_or(shown.exposure),
            materials: self.materials.materials(),
        }
    }
}

/// Reads an exposure.
///
/// # Errors
/// What is neither a number of stops nor `auto`.
pub fn parse_exposure(text: &str) -> Result<Exposure, String> {
    if text == "auto" {
        return Ok(Exposure::Automatic);
    }
    let stops = text.parse().ok().filter(|stops: &f32| stops.abs() <= MAX_STOPS);
    stops.map(Exposure::Stops).ok_or_else(|| format!("`{text}` is neither auto nor a number of stops, as -1.5"))
}

/// Way from light to the colours that are shown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DisplaySettings {
    /// Tone curve.
    pub tone: Tone,
    /// Exposure.
    pub exposure: Exposure,
    /// Reflection of surfaces.
    pub materials: Materials,
}

impl DisplaySettings {
    /// The scene's exposure where it says one, else an automatic one.
    pub fn of(loaded: &LoadedScene) -> Self {
        let exposure = if loaded.is_exposed { Exposure::Stops(loaded.exposure_stops) } else { Exposure::Automatic };
        Self { tone: Curve::default().tone(), exposure, materials: Materials::default() }
    }

    /// That of a picture.
    pub fn transform(&self, picture: &Picture) -> DisplayTransform {
        let stops = match self.exposure {
            Exposure::Automatic => picture.automatic_stops(),
            Exposure::Stops(stops) => stops,
        };
        DisplayTransform { stops, tone: self.tone }
    }
}
