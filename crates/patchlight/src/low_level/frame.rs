//! A frame as a plan: the buffers that its stages share, and what changes from frame to frame.

use glam::{Vec3, Vec4};
use runtime::executor::{DeviceInfo, ExecutorError};
use runtime::plan::{BufferId, PassId, Plan, Slice};
use runtime::recipe::Tables;
use runtime::recipe::formfactor::Surfaces;
use runtime::recipe::scene::SceneTables;
use scene::{Lighting, Rgb, Scene};

use crate::bake::{Bake, ReceiverKind};
use crate::objects::ObjectTables;

/// Bounces that do not go from patch to patch: to the elements, and to the receivers.
pub const LAST_BOUNCES: u32 = 2;

/// A frame's plan while its stages add their passes, in their order: direct, source, method, gather; then, in sections
/// of their own, points and pictures.
pub struct FramePlan<'a> {
    /// The bake that is lit.
    pub bake: &'a Bake,
    /// Bounces of a frame.
    pub bounces: u32,
    /// The device that runs the plan.
    pub device: &'a DeviceInfo,
    /// Passes so far.
    pub plan: Plan,
    /// Tables so far.
    pub tables: Tables,
    /// The scene on the device.
    pub scene: SceneTables,
    /// Light of the patches: albedo ρ, first exitance E, irradiance H (what the method is to find) and exitance B. The
    /// irradiance has as many values as a lookup between patches needs.
    pub patches: Surfaces,
    /// Surfaces of the elements, into which patches are cut.
    pub elements: Surfaces,
    /// Exitance of the elements, and behind it that of elements that move.
    pub exitance: Slice<Rgb>,
    /// Objects that move, if there are any.
    pub(crate) objects: Option<&'a ObjectTables>,
    /// Irradiance of receivers, W/m²: of each quadrant of their hemispheres, and then smoothed.
    pub received: Slice<Rgb>,
    /// Irradiance of the interpolation points, W/m²: what pixels take theirs from.
    pub interpolated: Slice<Rgb>,
    /// Zeros, for as many patches or elements as there are.
    pub zeros: Slice<Rgb>,
    /// First exitance and irradiance of the patches as objects change them.
    pub(crate) changed: Option<ChangedPatches>,
}

/// Light of the patches where objects are in its way, W/m². What they change of the irradiance, ΔH, is light that the
/// method does not know of; it takes ρ ΔH for first exitance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChangedPatches {
    /// First exitance without ρ ΔH.
    pub source: Slice<Rgb>,
    /// ΔH.
    pub change: Slice<Rgb>,
    /// H + ΔH.
    pub irradiance: Slice<Rgb>,
}

/// Content of a frame.
#[derive(Clone, Copy, Debug)]
pub struct FrameInput<'a> {
    /// Lights, sky and emission.
    pub lighting: &'a Lighting,
    /// Position of the viewer, m.
    pub eye: Vec3,
    /// Counts the updates of the light field, from 0.
    pub number: u32,
}

/// The buffers of a loaded plan, for sections on top of it.
#[derive(Clone, Debug)]
pub(crate) struct FrameTables {
    pub scene: SceneTables,
    patches: Surfaces,
    elements: Surfaces,
    exitance: Slice<Rgb>,
    received: Slice<Rgb>,
    interpolated: Slice<Rgb>,
    zeros: Slice<Rgb>,
}

impl FrameTables {
    /// Those of a plan.
    pub fn of(frame: &FramePlan) -> Self {
        Self {
            scene: frame.scene,
            patches: frame.patches,
            elements: frame.elements,
            exitance: frame.exitance,
            received: frame.received,
            interpolated: frame.interpolated,
            zeros: frame.zeros,
        }
    }

    /// A frame's plan that goes on where `plan` ends, without its tables, which are on the device.
    pub fn plan<'a>(
        &self,
        bake: &'a Bake,
        objects: Option<&'a ObjectTables>,
        bounces: u32,
        device: &'a DeviceInfo,
        plan: Plan,
    ) -> FramePlan<'a> {
        FramePlan {
            bake,
            objects,
            bounces,
            device,
            plan,
            tables: Tables::new(),
            scene: self.scene,
            patches: self.patches,
            elements: self.elements,
            exitance: self.exitance,
            received: self.received,
            interpolated: self.interpolated,
            zeros: self.zeros,
            changed: None,
        }
    }
}

impl<'a> FramePlan<'a> {
    /// The buffers of the frames of a bake, whose scene may have another albedo, with a capacity of so many lights.
    pub(crate) fn new(
        bake: &'a Bake,
        scene: &Scene,
        objects: Option<&'a ObjectTables>,
        lights: usize,
        bounces: u32,
        device: &'a DeviceInfo,
    ) -> Self {
        let mut plan = Plan::new();
        let mut tables = Tables::new();
        let mesh = &bake.mesh;
        let patch_count = mesh.patches.len();
        let element_count = mesh.elements.len();
        let patches = Surfaces {
            count: patch_count as u32,
            albedo: tables.part(&mut plan, "albedo", mesh, |mesh| &mesh.albedo),
            source: plan.array("source", patch_count),
            irradiance: plan.array("irradiance", bake.irradiance_values()),
            exitance: plan.array("exitance", patch_count),
        };
        let all_exitance = plan.array("element exitance", columns(bake, objects));
        let elements = Surfaces {
            count: element_count as u32,
            albedo: tables.part(&mut plan, "element albedo", mesh, |mesh| &mesh.element_albedo),
            source: plan.array("element source", element_count),
            irradiance: plan.array("element irradiance", element_count),
            exitance: all_exitance.part(0, element_count),
        };
        let receivers = &bake.receivers;
        let received = plan.array("received", receivers.first_smooth() + receivers.points.len());
        let interpolated = plan.array("interpolated", interpolation_points(bake, objects));
        let zeros = plan.array("zeros", patch_count.max(element_count));
        let scene = SceneTables::new(&mut plan, &mut tables, scene, lights);
        let exitance = all_exitance;
        let mut changed = || ChangedPatches {
            source: plan.array("own source", patch_count),
            change: plan.array("change of irradiance", patch_count),
            irradiance: plan.array("changed irradiance", patch_count),
        };
        let changed = objects.map(|_| changed());
        Self {
            bake,
            bounces,
            device,
            plan,
            tables,
            scene,
            patches,
            elements,
            exitance,
            objects,
            received,
            interpolated,
            zeros,
            changed,
        }
    }

    /// Bounces from patch to patch: all but the last two, which end at elements and receivers; all where the patches
    /// are the receivers.
    pub fn patch_bounces(&self) -> u32 {
        match self.bake.settings.receivers {
            ReceiverKind::Patches => self.bounces.max(1),
            _ => self.bounces.saturating_sub(LAST_BOUNCES),
        }
    }

    /// Returns true if light goes to the elements before it goes to the receivers.
    pub fn has_element_bounce(&self) -> bool {
        self.bounces > 1 && self.bake.settings.receivers != ReceiverKind::Patches
    }

    /// Columns of rows over the elements: those at rest, then those that move.
    pub(crate) fn columns(&self) -> usize {
        columns(self.bake, self.objects)
    }

    /// Interpolation points of the bake, and behind them the points of objects.
    pub(crate) fn interpolation_points(&self) -> usize {
        interpolation_points(self.bake, self.objects)
    }

    /// Bytes of a buffer that one binding may show.
    pub fn binding_bytes(&self) -> u64 {
        self.device.max_storage_buffer_range
    }

    /// Adds the pass of `B = E`: what light there is before the first bounce.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn start_from_source(&mut self) -> Result<(), ExecutorError> {
        self.patches.bounce_of(&mut self.plan, "gather", self.zeros)?;
        Ok(())
    }

    /// Adds the pass of a bounce at the patches, `B = E + ρ∘H`.
    ///
    /// # Errors
    /// Buffers that are too short.
    pub fn bounce(&mut self) -> Result<PassId, ExecutorError> {
        self.patches.bounce(&mut self.plan, "method")
    }

    /// Buffers that are all zeros when the first frame begins, with the number of their values.
    pub(crate) fn initial_zeros(&self) -> Vec<BufferId> {
        let slices = [self.patches.exitance, self.patches.irradiance, self.elements.irradiance, self.zeros];
        let changed = self.changed.map(|changed| changed.change);
        slices.into_iter().chain(changed).map(|slice| slice.buffer).collect()
    }
}

fn columns(bake: &Bake, objects: Option<&ObjectTables>) -> usize {
    objects.map_or(bake.mesh.elements.len(), |objects| ObjectTables::first_column(bake) + objects.elements())
}

fn interpolation_points(bake: &Bake, objects: Option<&ObjectTables>) -> usize {
    let resting = bake.receivers.interpolation.points.len();
    objects.map_or(resting, |objects| ObjectTables::first_point(bake) + objects.points())
}

/// Zeros for so many RGB values.
pub(crate) fn zeros(count: usize) -> Vec<Vec4> {
    vec![Vec4::ZERO; count]
}
