//! The light of a world, on a thread of its own: a bake, and what each update makes of it.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use bevy::ecs::entity::Entity;
use half::f16;
use patches::kernel::volume::CUBE_SIDES;
use patches::types::EMPTY_CELL;
use patches::{VolumeSettings, VolumeSize, VoxelVolume};
use patchlight::glam::{Affine3A, Vec3};
use patchlight::outputs::{LightPart, LiveLightmap, Surroundings, is_lit};
use patchlight::scene::ReceiverSet as _;
use patchlight::{
    Bake, DeviceChoice, Error, LightField, LightSettings, Lighting, ObjectId, Point, PointKind, PointSet, Scene,
    Silent, open,
};

use crate::PatchlightSettings;
use crate::gather::MeshParts;
use crate::layout::{half_texel, picture, shown};
use crate::lights::LampsNow;
use crate::shared::{Base, DeviceBake, Layout, Setup};

/// Rays to what shines from each texel and probe, while a bake goes on and after it.
const FEW_RAYS: u32 = 32;
const MANY_RAYS: u32 = 256;
/// Rays of each side of a probe.
const PROBE_RAYS: u32 = 256;

/// A scene with the places of its meshes in the lightmap.
pub(crate) struct Prepared {
    pub scene: Scene,
    /// Second texture coordinates of each mesh.
    pub uvs: Vec<Vec<[f32; 2]>>,
    /// Tells this scene from others.
    pub hash: [u8; 32],
}

/// What moves.
#[derive(Debug)]
pub(crate) enum Move {
    Insert(Entity, Arc<MeshParts>, Affine3A),
    Place(Entity, Affine3A),
    Remove(Entity),
}

/// Work of an update.
pub(crate) struct Order {
    /// A new bake, and whether it is the last.
    pub bake: Option<(Arc<Bake>, bool)>,
    pub lamps: LampsNow,
    pub moves: Vec<Move>,
}

/// What an order leads to.
pub(crate) enum Found {
    /// Nothing, before the first bake.
    Nothing,
    Texels(Texels),
    /// What a light field on Bevy's device needs.
    ForDevice(Option<DeviceBake>, Base),
}

/// Texels of an update.
#[derive(Debug)]
pub(crate) struct Texels {
    pub lightmap: Vec<u8>,
    pub probes: Option<ProbeTexels>,
    /// Seconds of the update, and of all of the work.
    pub seconds: (f32, f32),
    /// Things that went wrong without harm.
    pub warnings: Vec<String>,
}

/// Texels of an irradiance volume.
#[derive(Debug)]
pub(crate) struct ProbeTexels {
    pub place: Place,
    pub bytes: Vec<u8>,
}

/// Where an irradiance volume is, m, and its columns, rows and slabs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    pub size: [u32; 3],
    pub middle: Vec3,
    pub extent: Vec3,
}

/// A light field with what is made of it; on Bevy's device the light field itself is in the render world.
pub(crate) struct Work {
    prepared: Arc<Prepared>,
    settings: LightSettings,
    device: DeviceChoice,
    is_shared: bool,
    probe_count: u32,
    /// The newest bake.
    bake: Option<Arc<Bake>>,
    /// With the points of the probes.
    field: Option<(LightField, Option<PointSet>)>,
    lightmap: LiveLightmap,
    probes: Option<Probes>,
    objects: HashMap<Entity, ObjectId>,
}

struct Probes {
    volume: VoxelVolume,
    surroundings: Surroundings,
}

impl Work {
    pub fn new(
        prepared: Arc<Prepared>,
        mut lightmap: LiveLightmap,
        light: LightSettings,
        settings: &PatchlightSettings,
    ) -> Self {
        lightmap.set_rays(FEW_RAYS);
        Self {
            prepared,
            settings: light.with_point_rays(PROBE_RAYS),
            device: settings.device.clone(),
            is_shared: settings.shares_device,
            probe_count: settings.probe_count,
            bake: None,
            field: None,
            lightmap,
            probes: None,
            objects: HashMap::new(),
        }
    }

    /// Finds the light of an order; the first has a bake.
    ///
    /// # Errors
    /// What the library says.
    pub fn run(&mut self, order: &Order) -> Result<Found, Error> {
        let start = Instant::now();
        let before = self.bake.clone();
        if let Some((bake, is_last)) = &order.bake {
            self.take(bake, *is_last);
        }
        let Some(bake) = self.bake.clone() else { return Ok(Found::Nothing) };
        if self.is_shared {
            let is_new = order.bake.is_some();
            return self.for_device(&bake, (is_new, before.is_none()), &order.lamps);
        }
        let mut warnings = Vec::new();
        let (mut field, set) = self.field(&bake, &mut warnings)?;
        for change in &order.moves {
            if let Err(error) = apply(&mut field, &mut self.objects, change) {
                warnings.push(error.to_string());
            }
        }
        let update = Instant::now();
        field.update(&order.lamps.lighting)?;
        let surface = field.surface_irradiance()?;
        let seconds = update.elapsed().as_secs_f32();
        let values = self.lightmap.irradiance_of(&field, &surface, LightPart::WithoutLights)?;
        let lightmap = picture(&self.lightmap, &values);
        let mut probes = None;
        if let (Some(own), Some(set)) = (&mut self.probes, set) {
            let mut cubes = field.read(set)?.values;
            own.add_surroundings(&self.prepared.scene, &order.lamps, &mut cubes)?;
            probes = Some(own.texels(&cubes));
        }
        self.field = Some((field, set));
        Ok(Found::Texels(Texels { lightmap, probes, seconds: (seconds, start.elapsed().as_secs_f32()), warnings }))
    }

    /// Takes another bake.
    fn take(&mut self, bake: &Arc<Bake>, is_last: bool) {
        if self.bake.is_none() {
            self.probes = Probes::new(bake, self.probe_count);
        }
        self.bake = Some(Arc::clone(bake));
        if is_last {
            self.lightmap.set_rays(MANY_RAYS);
            if let Some(probes) = &mut self.probes {
                probes.surroundings = Surroundings::with_rays(MANY_RAYS);
            }
        }
    }

    /// The light field, of the newest bake.
    fn field(&mut self, bake: &Arc<Bake>, warnings: &mut Vec<String>) -> Result<(LightField, Option<PointSet>), Error> {
        if let Some((mut field, set)) = self.field.take() {
            if !Arc::ptr_eq(field.bake(), bake) {
                field.set_bake(Arc::clone(bake), &Silent)?;
            }
            return Ok((field, set));
        }
        let (executor, note) = open(&self.device)?;
        warnings.extend(note);
        let mut field = LightField::new(Arc::clone(bake), executor, &self.settings, &Silent)?;
        let set = match &self.probes {
            Some(probes) => Some(field.add_points(&probes.points(), PointKind::Cube, &Silent)?),
            None => None,
        };
        Ok((field, set))
    }

    /// What a light field on Bevy's device needs of the processor: a bake that `is_new`, for a scene that `is_first` has it
    /// of, and what surfaces that shine and the sky send.
    fn for_device(
        &mut self,
        bake: &Arc<Bake>,
        (is_new, is_first): (bool, bool),
        lamps: &LampsNow,
    ) -> Result<Found, Error> {
        let mut base = Base { lightmap: self.lightmap.surroundings(bake, &lamps.lighting)?, probes: Vec::new() };
        if let Some(probes) = &mut self.probes {
            base.probes = vec![Vec3::ZERO; probes.volume.points().len()];
            probes.add_surroundings(&self.prepared.scene, lamps, &mut base.probes)?;
        }
        let bake = if is_new {
            let setup = || Setup {
                light: self.settings.clone(),
                lightmap: shown(&self.lightmap),
                probes: self.probes.as_ref().map(|probes| (probes.points(), probes.layout())),
            };
            let setup = is_first.then(setup);
            Some(DeviceBake { bake: Arc::clone(bake), rows: self.lightmap.rows(bake)?.to_vec(), setup })
        } else {
            None
        };
        Ok(Found::ForDevice(bake, base))
    }

    /// The irradiance volume, if there is one.
    pub fn place(&self) -> Option<Place> {
        self.probes.as_ref().map(Probes::place)
    }
}

pub(crate) fn apply(
    field: &mut LightField,
    objects: &mut HashMap<Entity, ObjectId>,
    change: &Move,
) -> Result<(), Error> {
    match change {
        Move::Insert(entity, parts, transform) => {
            let id = field.objects().insert(&parts.mesh(Affine3A::IDENTITY), *transform)?;
            if let Some(before) = objects.insert(*entity, id) {
                field.objects().remove(before)?;
            }
        }
        Move::Place(entity, transform) => {
            if let Some(&id) = objects.get(entity) {
                field.objects().set_transform(id, *transform)?;
            }
        }
        Move::Remove(entity) => {
            if let Some(id) = objects.remove(entity) {
                field.objects().remove(id)?;
            }
        }
    }
    Ok(())
}

impl Probes {
    /// About so many probes over the bounds of a bake; none where none are asked for, or none has room.
    fn new(bake: &Bake, count: u32) -> Option<Self> {
        if count == 0 {
            return None;
        }
        let settings = VolumeSettings { size: VolumeSize::Count(count), ..VolumeSettings::default() };
        let volume = VoxelVolume::new(bake.scene(), &settings, &|point| is_lit(bake, point)).ok()?;
        Some(Self { volume, surroundings: Surroundings::with_rays(FEW_RAYS) })
    }

    /// Where the probes are.
    fn points(&self) -> Vec<Point> {
        let first_of_each = self.volume.points().iter().step_by(CUBE_SIDES as usize);
        first_of_each.map(|side| Point { position: side.position, normal: side.normal }).collect()
    }

    /// Adds to the sides of the probes what surfaces that shine and the sky send.
    fn add_surroundings(&mut self, scene: &Scene, lamps: &LampsNow, cubes: &mut [Vec3]) -> Result<(), Error> {
        let mut lighting = Lighting { lights: Vec::new(), ..lamps.lighting.clone() };
        if lamps.has_ambient {
            // Bevy adds it.
            lighting.sky = Default::default();
        }
        self.surroundings.add(scene, self.volume.points(), &lighting, cubes)
    }

    /// Texels as Bevy has them: +x, +y, +z in three slabs along z, and their opposites in the upper halves along y.
    fn layout(&self) -> Layout {
        let shape = self.volume.params.shape;
        let counts = [shape.count_x, shape.count_y, shape.count_z];
        let size = [counts[0], 2 * counts[1], 3 * counts[2]];
        let mut shown = Vec::with_capacity(size.iter().product::<u32>() as usize);
        for z in 0..size[2] {
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let voxel = x + counts[0] * (y % counts[1] + counts[1] * (z % counts[2]));
                    let side = 2 * (z / counts[2]) + y / counts[1];
                    let probe = self.volume.probes[voxel as usize] & !EMPTY_CELL;
                    shown.push(probe * CUBE_SIDES + side);
                }
            }
        }
        Layout { size, shown }
    }

    fn place(&self) -> Place {
        let shape = self.volume.params.shape;
        let extent = shape.edges * Vec3::new(shape.count_x as f32, shape.count_y as f32, shape.count_z as f32);
        Place {
            size: [shape.count_x, 2 * shape.count_y, 3 * shape.count_z],
            middle: shape.origin + 0.5 * extent,
            extent,
        }
    }

    fn texels(&self, cubes: &[Vec3]) -> ProbeTexels {
        let texels = self.layout().shown.into_iter().map(|side| half_texel(cubes[side as usize]));
        ProbeTexels { place: self.place(), bytes: texels.flatten().flat_map(f16::to_le_bytes).collect() }
    }
}
