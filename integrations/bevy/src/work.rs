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
use crate::layout::{half_texel, picture};
use crate::lights::LampsNow;

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
    pub size: [u32; 3],
    pub bytes: Vec<u8>,
    pub middle: Vec3,
    pub extent: Vec3,
}

/// A light field with what is made of it.
pub(crate) struct Work {
    prepared: Arc<Prepared>,
    settings: LightSettings,
    device: DeviceChoice,
    probe_count: u32,
    field: Option<LightField>,
    lightmap: LiveLightmap,
    probes: Option<Probes>,
    objects: HashMap<Entity, ObjectId>,
}

struct Probes {
    volume: VoxelVolume,
    set: PointSet,
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
            probe_count: settings.probe_count,
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
    pub fn run(&mut self, order: &Order) -> Result<Option<Texels>, Error> {
        let start = Instant::now();
        let mut warnings = Vec::new();
        if let Some((bake, is_last)) = &order.bake {
            self.take(bake, *is_last, &mut warnings)?;
        }
        let Some(field) = &mut self.field else { return Ok(None) };
        for change in &order.moves {
            if let Err(error) = apply(field, &mut self.objects, change) {
                warnings.push(error.to_string());
            }
        }
        let lighting = &order.lamps.lighting;
        let update = Instant::now();
        field.update(lighting)?;
        let surface = field.surface_irradiance()?;
        let seconds = update.elapsed().as_secs_f32();
        let values = self.lightmap.irradiance_of(field, &surface, LightPart::WithoutLights)?;
        let lightmap = picture(&self.lightmap, &values);
        let scene = &self.prepared.scene;
        let probes = match &mut self.probes {
            Some(probes) => Some(probes.texels(field, scene, &order.lamps)?),
            None => None,
        };
        Ok(Some(Texels { lightmap, probes, seconds: (seconds, start.elapsed().as_secs_f32()), warnings }))
    }

    /// Takes another bake.
    fn take(&mut self, bake: &Arc<Bake>, is_last: bool, warnings: &mut Vec<String>) -> Result<(), Error> {
        match &mut self.field {
            Some(field) => field.set_bake(Arc::clone(bake), &Silent)?,
            empty => {
                let (executor, note) = open(&self.device)?;
                warnings.extend(note);
                let field = LightField::new(Arc::clone(bake), executor, &self.settings, &Silent)?;
                self.probes = Probes::new(empty.insert(field), self.probe_count)?;
            }
        }
        if is_last {
            self.lightmap.set_rays(MANY_RAYS);
            if let Some(probes) = &mut self.probes {
                probes.surroundings = Surroundings::with_rays(MANY_RAYS);
            }
        }
        Ok(())
    }
}

fn apply(field: &mut LightField, objects: &mut HashMap<Entity, ObjectId>, change: &Move) -> Result<(), Error> {
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
    fn new(field: &mut LightField, count: u32) -> Result<Option<Self>, Error> {
        if count == 0 {
            return Ok(None);
        }
        let bake = Arc::clone(field.bake());
        let settings = VolumeSettings { size: VolumeSize::Count(count), ..VolumeSettings::default() };
        let Ok(volume) = VoxelVolume::new(bake.scene(), &settings, &|point| is_lit(&bake, point)) else {
            return Ok(None);
        };
        let first_of_each = volume.points().iter().step_by(CUBE_SIDES as usize);
        let places: Vec<Point> =
            first_of_each.map(|side| Point { position: side.position, normal: side.normal }).collect();
        let set = field.add_points(&places, PointKind::Cube, &Silent)?;
        Ok(Some(Self { volume, set, surroundings: Surroundings::with_rays(FEW_RAYS) }))
    }

    /// Texels as Bevy has them: +x, +y, +z in three slabs along z, and their opposites in the upper halves along y.
    fn texels(&mut self, field: &mut LightField, scene: &Scene, lamps: &LampsNow) -> Result<ProbeTexels, Error> {
        let mut cubes = field.read(self.set)?.values;
        let mut lighting = Lighting { lights: Vec::new(), ..lamps.lighting.clone() };
        if lamps.has_ambient {
            // Bevy adds it.
            lighting.sky = Default::default();
        }
        self.surroundings.add(scene, self.volume.points(), &lighting, &mut cubes)?;
        let shape = self.volume.params.shape;
        let counts = [shape.count_x, shape.count_y, shape.count_z];
        let size = [counts[0], 2 * counts[1], 3 * counts[2]];
        let mut bytes = Vec::with_capacity(8 * size.iter().product::<u32>() as usize);
        for z in 0..size[2] {
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let voxel = x + counts[0] * (y % counts[1] + counts[1] * (z % counts[2]));
                    let side = 2 * (z / counts[2]) + y / counts[1];
                    let probe = self.volume.probes[voxel as usize] & !EMPTY_CELL;
                    let value = cubes[(probe * CUBE_SIDES + side) as usize];
                    bytes.extend(half_texel(value).into_iter().flat_map(f16::to_le_bytes));
                }
            }
        }
        let extent = shape.edges * Vec3::new(counts[0] as f32, counts[1] as f32, counts[2] as f32);
        Ok(ProbeTexels { size, bytes, middle: shape.origin + 0.5 * extent, extent })
    }
}
