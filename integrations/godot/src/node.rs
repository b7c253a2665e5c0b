//! The node.

use godot::classes::{INode3D, MeshInstance3D, Node, Node3D};
use godot::prelude::*;
use patchlight::method::{FeedbackSettings, TemporalSettings};
use patchlight::outputs::LiveLightmap;
use patchlight::{BakeSettings, Codec, DeviceChoice, MethodSettings};

use crate::gather::{Gathered, affine};
use crate::lights::{Lamps, Which};
use crate::show::Show;
use crate::work::{Moment, Order, Told, Work};

/// Relative error of operators of low rank.
const EPSILON: f64 = 0.01;

/// Light between surfaces that follows the lights: lightmaps on the meshes that rest, probes for what moves. It lights
/// what stands below its parent, as `LightmapGI` does: meshes whose GI mode is static get lightmaps, those of the mode
/// dynamic are lit by probes, and hide light where they are in the group `patchlight_moving`.
#[derive(GodotClass)]
#[class(init, base=Node3D, rename=PatchlightGI)]
pub struct PatchlightGi {
    /// About how many patches light is found between.
    #[export(range = (100.0, 20000.0, 100.0, or_greater))]
    #[init(val = 2000)]
    patch_count: i32,
    /// Edge of a texel of the lightmap, m.
    #[export(range = (0.01, 1.0, 0.01, or_greater))]
    #[init(val = 0.1)]
    texel: f32,
    /// About how many probes; 0 for none.
    #[export(range = (0.0, 8192.0, 1.0, or_greater))]
    #[init(val = 512)]
    probe_count: i32,
    /// How light goes between patches.
    #[export(enum = (Classic, LowRank, Dense, Feedback, Temporal))]
    #[init(val = 0)]
    method: i32,
    /// The device that finds the light: "cpu", "vulkan", a number or a part of a name.
    #[export]
    #[init(val = "cpu".into())]
    device: GString,
    /// Bakes when the scene is ready; else `bake` does.
    #[export]
    #[init(val = true)]
    bake_on_ready: bool,
    /// Waits in each frame for the finest bake and its light: for pictures, and for films that are recorded.
    #[export]
    #[init(val = false)]
    wait: bool,
    /// How far the bake is, 0 to 1.
    #[var(no_set)]
    progress: f32,
    /// Light updates so far.
    #[var(no_set)]
    updates: i32,
    /// Time of the last of them, with texels, ms.
    #[var(no_set)]
    update_time: f32,
    /// Patches of the bake.
    #[var(no_set)]
    patches: i32,
    lit: Option<Lit>,
    lamps: Lamps,
    base: Base<Node3D>,
}

/// A scene that is lit.
struct Lit {
    gathered: Gathered,
    work: Work,
    show: Show,
    last: Option<Moment>,
    /// An update is on its way.
    is_asked: bool,
}

#[godot_api]
impl INode3D for PatchlightGi {
    fn ready(&mut self) {
        self.base_mut().set_process(true);
        if self.bake_on_ready {
            // Once all of the scene is there.
            self.base_mut().call_deferred("bake", &[]);
        }
    }

    fn process(&mut self, _delta: f64) {
        self.ask();
        self.hear();
    }

    fn exit_tree(&mut self) {
        self.lit = None;
    }
}

#[godot_api]
impl PatchlightGi {
    /// There is light; again with each finer bake, whose `progress` is 1 when it is the finest.
    #[signal]
    fn lit(progress: f32);

    /// There is no light, for this reason.
    #[signal]
    fn failed(reason: GString);

    /// Gathers the meshes below the parent and bakes them; after meshes have come, gone, or been put elsewhere.
    #[func]
    pub fn bake(&mut self) {
        if let Err(reason) = self.begin() {
            self.fail(&reason);
        }
    }

    /// Takes the sky of the environment anew, after it has changed.
    #[func]
    pub fn update_sky(&mut self) {
        self.lamps.forget_sky();
    }

    fn begin(&mut self) -> Result<(), String> {
        self.lit = None;
        self.progress = 0.0;
        let device = DeviceChoice::parse(&self.device.to_string());
        let root = self.root()?;
        let gathered = Gathered::new(&root);
        let lighting = self.lamps.now(&root, gathered.emission(), Which::Possible);
        let scene = gathered.scene(lighting).map_err(|error| error.to_string())?;
        if !(self.texel.is_finite() && self.texel > 0.0) {
            return Err(format!("texel is {} m; it is positive", self.texel));
        }
        let lightmap = LiveLightmap::of_sides(&scene, &gathered.sides(&scene), self.texel)
            .map_err(|error| format!("{error}; a larger texel than {} m makes a smaller lightmap", self.texel))?;
        let world = self.base().get_world_3d().ok_or("the node is in no world")?;
        let show = Show::new(&gathered, &lightmap, world.get_scenario());
        let moving = gathered.moving.iter().flat_map(|instance| {
            let place = affine(instance.get_global_transform());
            gathered.moving_surfaces(instance).into_iter().map(move |surface| (surface, place))
        });
        let order = Order {
            scene,
            lightmap,
            probe_count: self.probe_count.max(0) as u32,
            moving: moving.collect(),
            settings: BakeSettings::default().with_patch_count(self.patch_count.max(1) as usize),
            method: self.method_settings(),
            device,
        };
        let work = Work::new(order);
        self.lit = Some(Lit { gathered, work, show, last: None, is_asked: false });
        Ok(())
    }

    fn method_settings(&self) -> MethodSettings {
        match self.method {
            1 => MethodSettings::Multibounce(Codec::LowRank { epsilon: EPSILON }),
            2 => MethodSettings::Multibounce(Codec::Dense),
            3 => MethodSettings::Feedback(FeedbackSettings::default()),
            4 => MethodSettings::Temporal(TemporalSettings::default()),
            _ => MethodSettings::Classic,
        }
    }

    /// The node whose scene is lit.
    fn root(&self) -> Result<Gd<Node>, String> {
        self.base().get_parent().ok_or_else(|| "the node has no parent, whose scene it could light".into())
    }

    /// Asks for the light of now, where it is another one than before.
    fn ask(&mut self) {
        let Ok(root) = self.root() else { return };
        let Some(lit) = &mut self.lit else { return };
        let lighting = self.lamps.now(&root, lit.gathered.emission(), Which::Shining);
        let places = lit.gathered.moving.iter().flat_map(|instance| {
            let place = affine(if instance.is_instance_valid() {
                instance.get_global_transform()
            } else {
                Transform3D::IDENTITY
            });
            let surfaces = surfaces_of(instance);
            std::iter::repeat_n(place, surfaces)
        });
        let now = Moment { lighting, places: places.collect() };
        if !lit.is_asked && lit.last.as_ref() != Some(&now) {
            lit.work.ask(now.clone());
            lit.last = Some(now);
            lit.is_asked = true;
        }
    }

    /// Takes what the thread has told.
    fn hear(&mut self) {
        let Ok(root) = self.root() else { return };
        while let Some(lit) = &mut self.lit {
            // The finest light of now.
            let waits = self.wait && (lit.is_asked || self.progress < 1.0);
            let told = if waits { lit.work.wait() } else { lit.work.hear() };
            match told {
                None => break,
                Some(Told::Warning(text)) => godot_warn!("Patchlight: {text}"),
                Some(Told::Failed(reason)) => self.fail(&reason),
                Some(Told::Light(light)) => {
                    lit.is_asked = false;
                    lit.show.show(&light, &root);
                    self.updates += 1;
                    self.update_time = 1000.0 * light.seconds;
                    self.patches = light.patches as i32;
                    let is_finer = light.share > self.progress;
                    self.progress = light.share;
                    if is_finer {
                        let share = light.share;
                        self.signals().lit().emit(share);
                    }
                }
            }
        }
    }

    fn fail(&mut self, reason: &str) {
        godot_error!("Patchlight has no light: {reason}");
        self.lit = None;
        self.signals().failed().emit(&GString::from(reason));
    }
}

/// Surfaces of what moves.
fn surfaces_of(instance: &Gd<MeshInstance3D>) -> usize {
    if !instance.is_instance_valid() {
        return 0;
    }
    instance.get_mesh().map_or(0, |mesh| mesh.get_surface_count() as usize)
}
