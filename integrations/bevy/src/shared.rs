//! Light on Bevy's own device: what the main world tells the render world, and what that answers.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::asset::AssetId;
use bevy::ecs::prelude::*;
use bevy::image::Image;
use patchlight::glam::Vec3;
use patchlight::outputs::LightmapRow;
use patchlight::{Bake, LightSettings, Lighting, Point};

use crate::work::Move;

/// Texels of a picture: columns, rows, slabs, and the receiver of each.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layout {
    pub size: [u32; 3],
    pub shown: Vec<u32>,
}

/// Points from which a receiver takes light, and their weights: of a lightmap, or one point alone.
pub(crate) type Row = LightmapRow;

/// A bake for a light field on Bevy's device.
pub(crate) struct DeviceBake {
    pub bake: Arc<Bake>,
    /// Points of the lightmap's receivers.
    pub rows: Vec<Row>,
    /// With the first bake of a scene.
    pub setup: Option<Setup>,
}

/// A scene that is new to the device.
#[derive(Debug)]
pub(crate) struct Setup {
    pub light: LightSettings,
    pub lightmap: Layout,
    /// Probes in the air, and the irradiance volume that shows them.
    pub probes: Option<(Vec<Point>, Layout)>,
}

/// What surfaces that shine and the sky send straight: to the lightmap's receivers, and to the sides of the probes.
#[derive(Debug, Default)]
pub(crate) struct Base {
    pub lightmap: Vec<Vec3>,
    pub probes: Vec<Vec3>,
}

/// What is new for the light on the device.
pub(crate) enum Message {
    /// Another bake; the pictures to write, and the number of the scene.
    Bake(Box<DeviceBake>, Targets, u64),
    Base(Base),
    Light(Box<Lighting>, Vec<Move>),
    /// Nothing is lit any more.
    End,
}

/// The lightmap and the irradiance volume.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Targets {
    pub lightmap: AssetId<Image>,
    pub probes: Option<AssetId<Image>>,
}

/// Messages on their way to the render world.
#[derive(Resource, Default)]
pub(crate) struct ToDevice {
    pub messages: Vec<Message>,
    /// True if the last bake was not ended.
    pub is_lit: bool,
}

impl ToDevice {
    /// Ends the light of the last bake, if there is any.
    pub fn end(&mut self) {
        if std::mem::take(&mut self.is_lit) {
            self.messages.push(Message::End);
        }
    }
}

/// What the device has done; the same in both worlds.
#[derive(Resource, Clone, Default)]
pub(crate) struct Report(Arc<Mutex<Done>>);

#[derive(Debug, Default)]
pub(crate) struct Done {
    /// Number of the scene.
    pub scene: u64,
    /// Light updates of it.
    pub updates: u64,
    /// Seconds that the last took of the frame.
    pub seconds: f32,
    pub warnings: Vec<String>,
    pub error: Option<String>,
}

impl Report {
    pub fn lock(&self) -> MutexGuard<'_, Done> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
