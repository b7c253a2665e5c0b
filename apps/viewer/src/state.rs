//! State that panels, keys and scripts change, and facts that panels show.

use std::path::PathBuf;

use assets::LoadedScene;
use assets::import::{MovingObject, Target};
use glam::{Affine3A, Vec3};
use patchlight::debug::DebugKind;
use patchlight::{Bake, BakeProgress, MethodSettings, ReceiverKind};
use reference::PictureErrors;
use scene::{DisplayTransform, Material, Materials, NONE, Tone};

use crate::eye::Eye;
use crate::lights::EditedLighting;
use crate::methods::{MethodDefaults, Methods};
use crate::object::Object;
use crate::sun::{Compass, SunTime, direction_to_sun};
use crate::times::Times;

/// Sub-frames that can be chosen.
pub const SUB_FRAMES: [u32; 4] = [1, 2, 4, 16];
/// Shares of the window's pixels, as divisors, that can be chosen.
pub const DIVISORS: [u32; 3] = [1, 2, 4];

/// Most cameras of an animation in the list: with that of the scene, one a digit.
const MAX_KEYFRAMES: usize = 8;

/// Radius of the object at first, as a share of the scene's diagonal.
const OBJECT_RADIUS: f32 = 0.04;

/// Content of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// Light.
    Light,
    /// A debug picture of the bake, or its light by patches.
    Debug(DebugKind),
    /// Difference of the light from the reference.
    Error,
}

impl Shown {
    /// Everything, whether the bake has it or not.
    pub fn all() -> impl Iterator<Item = Self> {
        [Self::Light].into_iter().chain(DebugKind::ALL.map(Self::Debug)).chain([Self::Error])
    }

    /// Its name in panels and scripts.
    pub fn name(self) -> &'static str {
        match self {
            Self::Light => "light",
            Self::Debug(kind) => kind.name(),
            Self::Error => "error",
        }
    }
}

/// A picture beside that of the method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Split {
    /// True if there is one.
    pub is_on: bool,
    /// Share of the width that the method has.
    pub at: f32,
}

/// Where something that moves was put: beside its pose, m, and turned about the upright axis through its origin,
/// degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Put {
    /// Displacement.
    pub way: Vec3,
    /// Turn.
    pub turn: f32,
}

/// An object of the scene that is to be moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Picked {
    /// [`scene::gpu::Triangle::object`].
    pub object: u32,
    /// Its middle, m, with what it was moved so far.
    pub middle: Vec3,
    /// By how much it is moved when the pointer lets it go, m.
    pub way: Vec3,
}

/// Action that is done once, after the panels.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Picks the object at a place of the picture, shares of its width and height from the top left.
    Pick(f32, f32),
    /// Moves an object of the scene, m; its light follows.
    Move {
        /// [`scene::gpu::Triangle::object`].
        object: u32,
        /// m.
        way: Vec3,
    },
    /// The window as it is shown, into a file; without one, into the next numbered file of the folder.
    Screenshot(Option<PathBuf>),
    /// Another size of the window, pixels.
    Resize(u32, u32),
    /// The end.
    Quit,
}

/// Result of a comparison with the reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Comparison {
    /// Paths a pixel so far; 0 for a file.
    pub samples: u32,
    /// Errors of the picture; none of one that is too small to compare.
    pub errors: Option<PictureErrors>,
}

/// Read-only content of panels.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// Device that runs the kernels.
    pub device: String,
    /// Device that shows the window.
    pub screen: String,
    /// Size of pictures, pixels.
    pub size: (u32, u32),
    /// Bytes of each part of the light.
    pub bytes: Vec<(String, u64)>,
    /// Bytes of this process, where the system says.
    pub resident: Option<u64>,
    /// Times of the frames.
    pub times: Times,
    /// The comparison, where there is one of what is shown.
    pub comparison: Option<Comparison>,
    /// Name of the file that is the reference; paths without.
    pub reference: Option<String>,
    /// Position of the bake in its work; none of one that is done.
    pub bake: Option<BakeProgress>,
    /// What the bake that is shown says of itself.
    pub quality: String,
    /// The last thing worth telling.
    pub message: String,
}

/// Everything that can be changed while the window is open.
#[derive(Clone, Debug)]
pub struct State {
    /// Light sources.
    pub lighting: EditedLighting,
    /// Who looks.
    pub eye: Eye,
    /// Cameras to return to, with their names.
    pub cameras: Vec<(String, Eye)>,
    /// Exposure of the picture, and its tone curve.
    pub display: DisplayTransform,
    /// True if the exposure follows what is seen.
    pub is_auto_exposed: bool,
    /// The methods.
    pub methods: Methods,
    /// Content of the picture.
    pub shown: Shown,
    /// Content that this bake can show.
    pub showable: Vec<Shown>,
    /// The sun's time.
    pub sun: SunTime,
    /// Direction of the sun.
    pub compass: Compass,
    /// The split screen.
    pub split: Split,
    /// True if panels are there.
    pub has_panels: bool,
    /// True if the help is there.
    pub has_help: bool,
    /// Sub-frames of a picture.
    pub sub_frames: u32,
    /// Pixels of the window for one of the picture, along an edge.
    pub divisor: u32,
    /// True if edges become smooth while nothing moves.
    pub is_smooth: bool,
    /// Reflection of surfaces.
    pub reflection: Materials,
    /// Names of the materials.
    pub materials: Vec<String>,
    /// Names of the objects of the scene.
    pub objects: Vec<String>,
    /// The object of the scene that is to be moved.
    pub picked: Option<Picked>,
    /// Albedo of each material in place of the bake's.
    pub albedo: Vec<Option<Vec3>>,
    /// Albedo of each in the bake; none of a texture.
    pub own_albedo: Vec<Option<Vec3>>,
    /// Ball that moves through the scene, lit by probes.
    pub object: Object,
    /// Objects of the scene that move.
    pub moving: Vec<MovingObject>,
    /// Where they were put beside their poses.
    pub put: Vec<Put>,
    /// The one whose handle was dragged last.
    pub held: usize,
    /// Their time, s.
    pub time: f32,
    /// Time of their last pose, s.
    pub duration: f32,
    /// True if the time goes on.
    pub is_playing: bool,
    /// True if the bake has receivers that tell where its probes have light.
    pub has_probes: bool,
    /// The light whose numbers are shown.
    pub selected: Option<usize>,
    /// Distance of things, m.
    pub distance: f32,
    /// Actions to be done after the panels.
    pub requests: Vec<Request>,
    /// Content of the panels.
    pub facts: Facts,
}

impl State {
    /// The state in which the window opens.
    pub fn new(loaded: &LoadedScene, bake: &Bake, defaults: &MethodDefaults) -> Self {
        let (low, high) = bake.scene().geometry.bounds;
        let metres = (high - low).length();
        let cameras = cameras(loaded, metres);
        Self {
            lighting: EditedLighting::of(bake),
            eye: cameras[0].1,
            cameras,
            display: DisplayTransform { stops: loaded.exposure_stops, tone: Tone::None },
            is_auto_exposed: false,
            methods: Methods::of(bake, defaults),
            shown: Shown::Light,
            showable: Shown::all()
                .filter(|shown| match shown {
                    Shown::Debug(kind) => kind.suits(bake.mesh(), bake.receivers()),
                    Shown::Light | Shown::Error => true,
                })
                .collect(),
            sun: SunTime::default(),
            compass: Compass::of_up(loaded.view.up),
            split: Split { is_on: false, at: 0.5 },
            has_panels: true,
            has_help: false,
            sub_frames: 1,
            reflection: Materials::default(),
            divisor: 1,
            is_smooth: true,
            materials: material_names(loaded, bake),
            objects: loaded.objects.clone(),
            picked: None,
            albedo: vec![None; bake.scene().materials.len()],
            own_albedo: bake.scene().materials.iter().map(own_albedo).collect(),
            object: Object::new(OBJECT_RADIUS * metres),
            moving: loaded.moving.clone(),
            put: vec![Put::default(); loaded.moving.len()],
            held: 0,
            time: 0.0,
            duration: loaded.moving_duration(),
            is_playing: false,
            has_probes: bake.settings().receivers == ReceiverKind::Mesh,
            selected: None,
            distance: 0.25 * metres,
            requests: Vec::new(),
            facts: Facts::default(),
        }
    }

    /// Puts the sun where its time says, below the horizon switched off; false where there is no sun.
    pub fn place_sun(&mut self) -> bool {
        let to_sun = direction_to_sun(self.sun, self.compass);
        let up = self.compass.up;
        let Some(sun) = self.lighting.sun() else { return false };
        sun.light.direction = -to_sun;
        sun.is_up = to_sun.dot(up) > 0.0;
        true
    }

    /// Lets the time of what moves go on, from the end to the beginning.
    pub fn play(&mut self, seconds: f32) {
        if self.is_playing && self.duration > 0.0 {
            self.time = (self.time + seconds) % self.duration;
        }
    }

    /// Places of what moves.
    pub fn places(&self) -> Vec<Affine3A> {
        let place = |(object, put): (&MovingObject, &Put)| {
            let own = object.transform(self.time);
            let origin = Vec3::from(own.translation);
            let turn = Affine3A::from_axis_angle(self.compass.up, put.turn.to_radians());
            Affine3A::from_translation(origin + put.way) * turn * Affine3A::from_translation(-origin) * own
        };
        self.moving.iter().zip(&self.put).map(place).collect()
    }

    /// A place before the eye, m.
    pub fn place_ahead(&self) -> Vec3 {
        self.eye.position + self.eye.forward() * (0.3 * self.distance)
    }

    /// Returns true if the picture is compared with a reference.
    pub fn compares(&self) -> bool {
        self.split.is_on || self.shown == Shown::Error
    }

    /// The number of a material.
    ///
    /// # Errors
    /// The names that there are.
    pub fn material(&self, name: &str) -> Result<usize, String> {
        let found = self.materials.iter().position(|own| own == name);
        found.ok_or_else(|| format!("there is no material `{name}`; there are: {}", self.materials.join(", ")))
    }

    /// The number of what moves by its name, if something has it.
    pub fn moving_object(&self, name: &str) -> Option<usize> {
        self.moving.iter().position(|object| object.name == name)
    }

    /// The number of an object of the scene: the first with this name, or one by its number, from 1.
    ///
    /// # Errors
    /// The names that there are.
    pub fn scene_object(&self, name: &str) -> Result<u32, String> {
        let numbered = name.parse::<usize>().ok().and_then(|k| k.checked_sub(1)).filter(|&k| k < self.objects.len());
        let found = self.objects.iter().position(|own| own == name).or(numbered);
        found
            .map(|k| k as u32)
            .ok_or_else(|| format!("there is no object `{name}`; there are: {}", self.objects.join(", ")))
    }

    /// Why the albedo of materials cannot be changed under the chosen method; none where it can.
    pub fn why_no_albedo(&self) -> Option<String> {
        let name = &self.methods.chosen().name;
        let holds_it =
            matches!(self.methods.chosen().settings, MethodSettings::Multibounce(_) | MethodSettings::Local(_));
        holds_it.then(|| {
            format!(
                "all bounces of {name} are in its matrix, and the albedo with them: choose classic, feedback, \
                 temporal or firstshot"
            )
        })
    }
}

/// The camera of a scene, and those at the keyframes of its animation.
fn cameras(loaded: &LoadedScene, metres: f32) -> Vec<(String, Eye)> {
    let mut cameras = vec![("scene".to_owned(), Eye::of_view(&loaded.view, metres))];
    let animation = &loaded.animation;
    let is_camera = |target: &Target| matches!(target, Target::CameraEye | Target::CameraTarget);
    let mut times: Vec<f32> = animation
        .tracks
        .iter()
        .filter(|track| is_camera(&track.target))
        .flat_map(|track| track.keyframes.iter().map(|keyframe| keyframe.time))
        .collect();
    times.sort_by(f32::total_cmp);
    times.dedup();
    cameras.extend(times.iter().take(MAX_KEYFRAMES).map(|&time| {
        let view = animation.at(time).1;
        (format!("{time:.1} s"), Eye::of_view(&view, metres))
    }));
    cameras
}

/// The albedo of a material without a texture of it.
fn own_albedo(material: &Material) -> Option<Vec3> {
    (material.albedo_texture == NONE).then_some(material.albedo)
}

/// Names of the materials; numbers where the scene has none.
fn material_names(loaded: &LoadedScene, bake: &Bake) -> Vec<String> {
    let name = |k: usize| loaded.materials.get(k).filter(|name| !name.is_empty()).cloned();
    (0..bake.scene().materials.len()).map(|k| name(k).unwrap_or_else(|| format!("material {k}"))).collect()
}
