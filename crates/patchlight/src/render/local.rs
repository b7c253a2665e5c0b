//! The matrix of the patches round the camera between the patches of a bake.

use std::cell::Cell;
use std::time::Instant;

use formfactor::{Csr, Reciprocal, reciprocal};
use glam::{Vec3, Vec4};
use localmatrix::{Changes, Local, LocalSettings, Step, Surface, Table, View, World};

use super::senders::Senders;
use crate::error::Error;
use crate::progress::{Progress, is_cancelled};

/// Slots are so many at a time: rows of the matrix on a device are whole vectors.
const SLOT_STEP: usize = 4;

/// Settings of the local matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalOptions {
    /// Patches and merged patches that the matrix has room for.
    pub slots: usize,
    /// How many of them enter or leave in a frame at most.
    pub budget: usize,
    /// Frames that the camera's way is looked ahead.
    pub look_ahead: f32,
    /// Frames over which changes of the matrix come into the light.
    pub fade: u32,
    /// Irradiance that is displayed as white, W/m², see [`white`]: those changes alter no displayed value by more than two 255ths a frame.
    pub white: f32,
    /// Whether each frame waits for all changes, whatever the budget.
    pub at_rest: bool,
}

impl LocalOptions {
    /// 4,096 slots, 64 changes a frame, 8 frames ahead, 16 frames to fade, no white.
    pub const DEFAULT: Self =
        Self { slots: 4096, budget: 64, look_ahead: 8.0, fade: 16, white: f32::INFINITY, at_rest: false };
}

/// Albedo of the surface whose displayed value tells how much frames differ.
pub const SHOWN_ALBEDO: f32 = 0.5;

/// Irradiance with which that surface is displayed as white, W/m².
pub fn white(exposure_stops: f32) -> f32 {
    std::f32::consts::PI / (SHOWN_ALBEDO * reference::stops_to_scale(exposure_stops))
}

impl Default for LocalOptions {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What a frame did with the matrix.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LocalFrame {
    /// What changed.
    pub step: Step,
    /// Patches and merged patches in the matrix.
    pub patches: usize,
    /// Multiplications of the product with lit patches, all channels.
    pub product: u64,
    /// Those of making the matrix anew.
    pub anew: u64,
    /// Bytes of the matrix and of all that goes with it, but for the world.
    pub bytes: u64,
}

/// Light by the matrix round a camera: its world, and where the camera is.
pub struct LocalLight {
    local: Local,
    world: Table,
    look_ahead: f32,
    eye: Vec3,
    ahead: Vec3,
    is_first: bool,
    at_rest: bool,
    /// What [`Self::choose`] has done at rest.
    done: Step,
    last: LocalFrame,
}

impl LocalLight {
    /// Makes the world of the patches of a bake, and the matrix for a camera.
    ///
    /// # Errors
    /// Settings out of their range; cancellation.
    pub fn new(
        senders: &Senders,
        factors: &Csr,
        options: LocalOptions,
        eye: Vec3,
        progress: &mut Progress,
    ) -> Result<Self, Error> {
        progress.phase("operator", |report| {
            let Reciprocal { factors, area, .. } = reciprocal(factors, &senders.areas())?;
            let patch = |((patch, albedo), &area): ((&formfactor::Patch, &Vec4), &f32)| Surface {
                centre: patch.centroid,
                normal: patch.normal,
                area,
                albedo: albedo.truncate(),
            };
            let surfaces: Vec<Surface> = senders.patches.iter().zip(&senders.albedo).zip(&area).map(patch).collect();
            let Csr { row_start, column_index, values, .. } = factors;
            let world = Table::new(&surfaces, row_start, column_index, values)?;
            Self::of(world, options, eye, report)
        })
    }

    /// The matrix for a camera in a world.
    pub(super) fn of(
        mut world: Table,
        options: LocalOptions,
        eye: Vec3,
        report: &(dyn Fn(f32) -> bool + Sync),
    ) -> Result<Self, Error> {
        let leaves = world.order().len();
        let settings = LocalSettings {
            slots: options.slots.min(leaves).max(1).next_multiple_of(SLOT_STEP),
            changes: options.budget,
            fade: options.fade,
            white: options.white,
            ..LocalSettings::default()
        };
        let mut local = Local::new(world.nodes(), settings)?;
        let most = Cell::new(0);
        let go_on = |done: usize| {
            most.set(done.max(most.get()));
            report(most.get() as f32 / settings.slots as f32)
        };
        match local.settle(&mut world, View { eye, ahead: eye }, &go_on) {
            Err(localmatrix::Error::Cancelled) => return Err(Error::Cancelled),
            Err(error) => return Err(error.into()),
            Ok(_) => {}
        }
        let (look_ahead, last) = (options.look_ahead, LocalFrame::default());
        let (at_rest, done) = (options.at_rest, Step::default());
        Ok(Self { local, world, look_ahead, eye, ahead: eye, is_first: true, at_rest, done, last })
    }

    /// Where the camera is in the next frame, m; it is taken to go on as it came.
    pub fn look(&mut self, eye: Vec3) {
        self.ahead = if self.is_first { eye } else { eye + (eye - self.eye) * self.look_ahead };
        self.eye = eye;
    }

    /// What the last frame did.
    pub fn last(&self) -> &LocalFrame {
        &self.last
    }

    /// Bytes of each part.
    pub fn bytes(&self) -> Vec<(String, u64)> {
        let parts = self.local.bytes().map(|(name, bytes)| (format!("local {name}"), bytes));
        parts.into_iter().chain([("local world".to_owned(), self.world.bytes())]).collect()
    }

    /// The matrix.
    pub(super) fn local(&mut self) -> &mut Local {
        &mut self.local
    }

    /// Patch of each leaf.
    pub(super) fn order(&self) -> &[u32] {
        self.world.order()
    }

    /// Whether each frame begins with all changes made, none of which [`Self::choose`] tells.
    pub(super) fn is_at_rest(&self) -> bool {
        self.at_rest
    }

    /// What this frame is to change. Before the first one all is made ready, at rest before each.
    pub(super) fn choose(&mut self) -> Result<Changes, Error> {
        let view = View { eye: self.eye, ahead: self.ahead };
        if std::mem::take(&mut self.is_first) {
            self.local.settle(&mut self.world, view, &|_| true)?;
        } else if self.at_rest {
            self.done = match self.local.settle(&mut self.world, view, &|_| !is_cancelled()) {
                Err(localmatrix::Error::Cancelled) => return Err(Error::Cancelled),
                other => other?,
            };
        }
        Ok(self.local.choose(&mut self.world, view))
    }

    /// Changes the matrix.
    pub(super) fn apply(&mut self, changes: Changes) -> Result<(), Error> {
        let step = self.local.apply(&self.world, changes)?.after(std::mem::take(&mut self.done));
        let patches = self.local.cut().len();
        let bytes = self.local.bytes().iter().map(|(_, bytes)| bytes).sum();
        // Cholesky, inverse and product: n³ in all, for each channel.
        self.last = LocalFrame { step, patches, product: 0, anew: 3 * (patches as u64).pow(3), bytes };
        Ok(())
    }

    /// The product's share of [`Self::last`], for so many lit patches.
    pub(super) fn multiplied(&mut self, lit: usize) {
        self.last.product = 3 * (lit * self.last.patches) as u64;
    }

    /// Irradiance of the patches of all bounces from their first exitance, W/m², by this host; milliseconds of changes and of products.
    pub(super) fn on_host(&mut self, source: &[Vec4]) -> Result<(Vec<Vec4>, [f64; 2]), Error> {
        let start = Instant::now();
        let exitance: Vec<Vec4> = self.order().iter().map(|&patch| source[patch as usize]).collect();
        let mut at_leaves = vec![Vec4::ZERO; exitance.len()];
        let (mut before, mut updating) = (Vec::new(), 0.0);
        let changes = self.choose()?;
        if !changes.is_empty() {
            before = at_leaves.clone();
            self.local.product(&exitance, &mut before, |_| true)?;
        }
        self.apply(changes)?;
        updating += start.elapsed().as_secs_f64() * 1e3;
        let start = Instant::now();
        let lit = self.local.product(&exitance, &mut at_leaves, |_| true)?;
        self.multiplied(lit);
        self.local.fade(&before, &mut at_leaves);
        let mut irradiance = vec![Vec4::ZERO; exitance.len()];
        self.order().iter().zip(&at_leaves).for_each(|(&patch, h)| irradiance[patch as usize] = *h);
        Ok((irradiance, [updating, start.elapsed().as_secs_f64() * 1e3]))
    }
}
