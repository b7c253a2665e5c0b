//! The matrix round a camera that moves: where the camera is and its predicted path, and what each frame changes.

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;
use core::cell::Cell;

use glam::{Vec3, Vec4};

use super::{Changes, Local, LocalSettings, Step, View, World};
use crate::error::Error;

/// Slots are so many at a time: rows of the matrix on a device are whole vectors.
const SLOT_STEP: usize = 4;

/// Settings of [`CameraMatrix`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraSettings {
    /// Patches and merged patches that the matrix holds at most.
    pub slots: usize,
    /// Greatest number of them that enter or leave in a frame.
    pub budget: usize,
    /// Frames for which the camera's path is predicted.
    pub predicted_frames: f32,
    /// Frames over which changes of the matrix come into the light.
    pub fade: u32,
    /// Display white: irradiance that is displayed as white, W/m². Changes alter no displayed value by more than two
    /// 255ths a frame.
    pub display_white: f32,
    /// Waits for all changes in each frame, whatever the budget.
    pub at_rest: bool,
}

impl CameraSettings {
    /// 4,096 slots, 64 changes a frame, 8 predicted frames, 16 frames to fade, no display white.
    pub const DEFAULT: Self =
        Self { slots: 4096, budget: 64, predicted_frames: 8.0, fade: 16, display_white: f32::INFINITY, at_rest: false };
}

impl Default for CameraSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Work that a frame did on the matrix.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraFrame {
    /// Changes made.
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

/// Irradiance of a frame by this host.
pub struct HostFrame {
    /// Irradiance of the patches, all bounces, W/m².
    pub irradiance: Vec<Vec4>,
    /// Milliseconds of changes of the matrix.
    pub update_ms: f64,
    /// Milliseconds of the product.
    pub product_ms: f64,
}

/// All bounces by the matrix of the patches round a camera: the matrix, its world, and where the camera is.
pub struct CameraMatrix {
    local: Local,
    world: Box<dyn World + Send>,
    /// Patch of each leaf.
    order: Vec<u32>,
    predicted_frames: f32,
    eye: Vec3,
    /// Predicted camera position.
    predicted: Vec3,
    is_first: bool,
    at_rest: bool,
    /// Work that [`Self::choose`] has done at rest.
    done: Step,
    last: CameraFrame,
}

impl CameraMatrix {
    /// The matrix for a camera at `eye` in a world; leaf k of the world is the patch `order[k]`. `continues` is told
    /// the share that is done, and answers whether to go on.
    ///
    /// # Errors
    /// Settings out of their range; [`Error::Cancelled`].
    pub fn new(
        mut world: Box<dyn World + Send>,
        order: Vec<u32>,
        settings: &CameraSettings,
        eye: Vec3,
        continues: &dyn Fn(f32) -> bool,
    ) -> Result<Self, Error> {
        let local_settings = LocalSettings {
            slots: settings.slots.min(order.len()).max(1).next_multiple_of(SLOT_STEP),
            changes: settings.budget,
            fade: settings.fade,
            display_white: settings.display_white,
            ..LocalSettings::default()
        };
        let mut local = Local::new(world.nodes(), local_settings)?;
        let most = Cell::new(0);
        let share = |done: usize| {
            most.set(done.max(most.get()));
            continues(most.get() as f32 / local_settings.slots as f32)
        };
        local.settle(&mut *world, View { eye, predicted: eye }, &share)?;
        Ok(Self {
            local,
            world,
            order,
            predicted_frames: settings.predicted_frames,
            eye,
            predicted: eye,
            is_first: true,
            at_rest: settings.at_rest,
            done: Step::default(),
            last: CameraFrame::default(),
        })
    }

    /// Moves the camera to where it is in the next frame, m; its predicted path goes on as it came.
    pub fn move_camera(&mut self, eye: Vec3) {
        self.predicted = if self.is_first { eye } else { eye + (eye - self.eye) * self.predicted_frames };
        self.eye = eye;
    }

    /// Report of the last frame.
    pub fn last(&self) -> &CameraFrame {
        &self.last
    }

    /// Bytes of each part but the world.
    pub fn bytes(&self) -> Vec<(String, u64)> {
        self.local.bytes().map(|(name, bytes)| (format!("local {name}"), bytes)).into()
    }

    /// The cut and its matrix.
    pub fn local(&self) -> &Local {
        &self.local
    }

    /// The local matrix, to change it.
    pub fn local_mut(&mut self) -> &mut Local {
        &mut self.local
    }

    /// Patch of each leaf.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// Returns true if each frame begins with all changes made, none of which [`Self::choose`] tells.
    pub fn is_at_rest(&self) -> bool {
        self.at_rest
    }

    /// Chooses the changes of this frame. Before the first one all is made ready, at rest before each.
    ///
    /// # Errors
    /// What the world and the matrix say.
    pub fn choose(&mut self) -> Result<Changes, Error> {
        let view = View { eye: self.eye, predicted: self.predicted };
        if core::mem::take(&mut self.is_first) {
            self.local.settle(&mut *self.world, view, &|_| true)?;
        } else if self.at_rest {
            self.done = self.local.settle(&mut *self.world, view, &|_| true)?;
        }
        Ok(self.local.choose(&mut *self.world, view))
    }

    /// Changes the matrix.
    ///
    /// # Errors
    /// What the matrix says.
    pub fn apply(&mut self, changes: Changes) -> Result<(), Error> {
        let step = self.local.apply(&*self.world, changes)?.after(core::mem::take(&mut self.done));
        let patches = self.local.cut().len();
        let bytes = self.local.bytes().iter().map(|(_, bytes)| bytes).sum();
        // Cholesky, inverse and product: n³ in all, for each channel.
        self.last = CameraFrame { step, patches, product: 0, anew: 3 * (patches as u64).pow(3), bytes };
        Ok(())
    }

    /// The product's share of [`Self::last`], for so many lit patches.
    pub fn set_lit(&mut self, lit: usize) {
        self.last.product = 3 * (lit * self.last.patches) as u64;
    }

    /// Irradiance of the patches of all bounces from their first exitance, W/m², by this host. `clock` tells the time
    /// in milliseconds from any moment on.
    ///
    /// # Errors
    /// What the matrix says.
    pub fn irradiance(&mut self, source: &[Vec4], clock: &dyn Fn() -> f64) -> Result<HostFrame, Error> {
        let start = clock();
        let exitance: Vec<Vec4> = self.order.iter().map(|&patch| source[patch as usize]).collect();
        let mut at_leaves = vec![Vec4::ZERO; exitance.len()];
        let mut before = Vec::new();
        let changes = self.choose()?;
        if !changes.is_empty() {
            before = at_leaves.clone();
            self.local.product(&exitance, &mut before, |_| true)?;
        }
        self.apply(changes)?;
        let changed = clock();
        let lit = self.local.product(&exitance, &mut at_leaves, |_| true)?;
        self.set_lit(lit);
        self.local.fade(&before, &mut at_leaves);
        let mut irradiance = vec![Vec4::ZERO; exitance.len()];
        self.order.iter().zip(&at_leaves).for_each(|(&patch, h)| irradiance[patch as usize] = *h);
        Ok(HostFrame { irradiance, update_ms: changed - start, product_ms: clock() - changed })
    }
}
