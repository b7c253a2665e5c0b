//! Light on a thread of its own: bakes, and what each update makes of them.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use half::f16;
use patches::kernel::volume::CUBE_SIDES;
use patches::types::EMPTY_CELL;
use patches::{VolumeSettings, VolumeSize, VoxelVolume};
use patchlight::glam::{Affine3A, Vec3};
use patchlight::outputs::{LightPart, LiveLightmap, Surroundings, is_lit};
use patchlight::scene::ReceiverSet as _;
use patchlight::{
    Bake, BakeJob, BakeSettings, DeviceChoice, Error, LightField, LightSettings, Lighting, MethodSettings, ObjectId,
    Point, PointKind, PointSet, Refinement, Scene, Silent, open,
};

use crate::gather::Surface;

/// Rays to what shines from each texel, while a bake goes on and after it.
const FEW_RAYS: u32 = 32;
const MANY_RAYS: u32 = 256;
/// Rays of each probe.
const PROBE_RAYS: u32 = 256;
/// Sides of a probe.
pub const SIDES: usize = CUBE_SIDES as usize;
/// The thread looks so often for a finer bake.
const PAUSE: Duration = Duration::from_millis(30);

/// What is asked for.
pub struct Order {
    pub scene: Scene,
    pub lightmap: LiveLightmap,
    /// About how many probes; 0 for none.
    pub probe_count: u32,
    pub moving: Vec<(Surface, Affine3A)>,
    pub settings: BakeSettings,
    pub method: MethodSettings,
    pub device: DeviceChoice,
}

/// The state of a scene at a moment.
#[derive(Clone, PartialEq)]
pub struct Moment {
    pub lighting: Lighting,
    /// Places of what moves, in the order of [`Order::moving`].
    pub places: Vec<Affine3A>,
}

/// What the thread tells.
pub enum Told {
    Light(Light),
    Warning(String),
    Failed(String),
}

/// Light of a moment.
pub struct Light {
    /// Radiance of white surfaces in the texels, RGB of half floats.
    pub texels: Vec<u8>,
    pub probes: Option<ProbeLight>,
    /// Share of the bake that is done: 1 for the finest.
    pub share: f32,
    /// Patches of the bake.
    pub patches: usize,
    /// Seconds of the update, with texels.
    pub seconds: f32,
}

/// Light of probes on a grid.
pub struct ProbeLight {
    pub grid: Grid,
    /// Irradiance of each for the normals +x, −x, +y, −y, +z, −z, W/m², row by row along x, then y, then z.
    pub cubes: Vec<[Vec3; SIDES]>,
}

/// Places of probes.
#[derive(Clone, Copy, PartialEq)]
pub struct Grid {
    /// The first, m.
    pub first: Vec3,
    /// From one to the next, m.
    pub step: Vec3,
    pub counts: [u32; 3],
}

/// The thread.
pub struct Work {
    moments: Sender<Moment>,
    told: Receiver<Told>,
    thread: Option<JoinHandle<()>>,
}

impl Work {
    /// Begins.
    pub fn new(order: Order) -> Self {
        let (moments, asked) = channel();
        let (tell, told) = channel();
        let run = move || {
            if let Err(error) = run(order, &asked, &tell) {
                _ = tell.send(Told::Failed(error.to_string()));
            }
        };
        let thread = std::thread::Builder::new().name("patchlight".into()).spawn(run);
        Self { moments, told, thread: thread.ok() }
    }

    /// Asks for the light of a moment; of several the newest is found.
    pub fn ask(&self, moment: Moment) {
        // A thread that has failed has said so.
        _ = self.moments.send(moment);
    }

    /// What was told since.
    pub fn hear(&self) -> Option<Told> {
        self.told.try_recv().ok()
    }

    /// Waits for what is told next; none once the thread has ended.
    pub fn wait(&self) -> Option<Told> {
        self.told.recv().ok()
    }
}

impl Drop for Work {
    fn drop(&mut self) {
        // Without a sender the thread ends after its update.
        let (none, _) = channel();
        self.moments = none;
        if let Some(thread) = self.thread.take() {
            _ = thread.join();
        }
    }
}

/// A light field with what is made of it.
struct State {
    field: LightField,
    lightmap: LiveLightmap,
    probes: Option<Probes>,
    objects: Vec<ObjectId>,
    placed: Vec<Affine3A>,
}

struct Probes {
    volume: VoxelVolume,
    set: PointSet,
    surroundings: Surroundings,
}

fn run(order: Order, asked: &Receiver<Moment>, tell: &Sender<Told>) -> Result<(), Error> {
    let refinement = Refinement::default().with_methods(vec![order.method]);
    let mut job = Some(Bake::refine(&order.scene, &order.settings, refinement)?);
    let mut state: Option<State> = None;
    let mut start = Some(order);
    let mut moment: Option<Moment> = None;
    let mut share = 0.0;
    loop {
        let mut is_new = match asked.recv_timeout(PAUSE) {
            Ok(newer) => {
                moment = Some(newer);
                true
            }
            Err(RecvTimeoutError::Timeout) => false,
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        };
        while let Ok(newer) = asked.try_recv() {
            moment = Some(newer);
        }
        if let Some((bake, now)) = newer_bake(&mut job)? {
            share = now;
            is_new = true;
            match (&mut state, start.take()) {
                (Some(own), _) => own.field.set_bake(bake, &Silent)?,
                (empty, Some(order)) => *empty = Some(State::new(bake, order, tell)?),
                (None, None) => {}
            }
            if let Some(own) = &mut state {
                own.lightmap.set_rays(if share == 1.0 { MANY_RAYS } else { FEW_RAYS });
            }
        }
        if let (true, Some(state), Some(moment)) = (is_new, &mut state, &moment) {
            let light = state.light(moment, share)?;
            if tell.send(Told::Light(light)).is_err() {
                return Ok(());
            }
        }
    }
}

/// A bake that has come, and the share of the work that it is.
fn newer_bake(job: &mut Option<BakeJob>) -> Result<Option<(Arc<Bake>, f32)>, Error> {
    let Some(own) = job.take() else { return Ok(None) };
    if own.is_finished() {
        return Ok(Some((own.join()?, 1.0)));
    }
    let share = own.progress().share;
    let newest = own.take_newest();
    *job = Some(own);
    Ok(newest.map(|bake| (bake, share.min(0.99))))
}

impl State {
    fn new(bake: Arc<Bake>, order: Order, tell: &Sender<Told>) -> Result<Self, Error> {
        let (executor, note) = open(&order.device)?;
        if let Some(note) = note {
            _ = tell.send(Told::Warning(note));
        }
        let settings = LightSettings::default().with_method(order.method).with_point_rays(PROBE_RAYS);
        let mut field = LightField::new(bake, executor, &settings, &Silent)?;
        let probes = Probes::new(&mut field, order.probe_count)?;
        let mut objects = Vec::new();
        for (surface, transform) in &order.moving {
            let made = surface.with_mesh(Affine3A::IDENTITY, |mesh| field.objects().insert(mesh, *transform));
            match made {
                Ok(id) => objects.push(id),
                Err(error) => _ = tell.send(Told::Warning(error.to_string())),
            }
        }
        let placed = if objects.len() == order.moving.len() {
            order.moving.iter().map(|(_, transform)| *transform).collect()
        } else {
            // One that was refused leaves the others where they are.
            Vec::new()
        };
        Ok(Self { field, lightmap: order.lightmap, probes, objects, placed })
    }

    fn light(&mut self, moment: &Moment, share: f32) -> Result<Light, Error> {
        let start = Instant::now();
        if moment.places.len() == self.placed.len() {
            for ((id, before), now) in self.objects.iter().zip(&mut self.placed).zip(&moment.places) {
                if before != now {
                    self.field.objects().set_transform(*id, *now)?;
                    *before = *now;
                }
            }
        }
        self.field.update(&moment.lighting)?;
        let values = self.lightmap.irradiance(&mut self.field, LightPart::WithoutLights)?;
        let probes = match &mut self.probes {
            Some(probes) => Some(probes.light(&mut self.field, &moment.lighting)?),
            None => None,
        };
        let half = |x: f32| f16::from_f32((x * std::f32::consts::FRAC_1_PI).min(f16::MAX.to_f32())).to_le_bytes();
        let picture = self.lightmap.picture(&values);
        let texels = picture.iter().flat_map(|value| value.to_array().map(half)).flatten().collect();
        let patches = self.field.bake().mesh().patches.len();
        Ok(Light { texels, probes, share, patches, seconds: start.elapsed().as_secs_f32() })
    }
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
        let first_of_each = volume.points().iter().step_by(SIDES);
        let places: Vec<Point> =
            first_of_each.map(|side| Point { position: side.position, normal: side.normal }).collect();
        let set = field.add_points(&places, PointKind::Cube, &Silent)?;
        Ok(Some(Self { volume, set, surroundings: Surroundings::with_rays(FEW_RAYS) }))
    }

    fn light(&mut self, field: &mut LightField, lighting: &Lighting) -> Result<ProbeLight, Error> {
        let mut cubes = field.read(self.set)?.values;
        self.surroundings.add(field.bake().scene(), self.volume.points(), lighting, &mut cubes)?;
        let shape = self.volume.params.shape;
        let counts = [shape.count_x, shape.count_y, shape.count_z];
        let grid = Grid { first: shape.origin + 0.5 * shape.edges, step: shape.edges, counts };
        let of_voxel = |probe: &u32| {
            let first = SIDES * (probe & !EMPTY_CELL) as usize;
            std::array::from_fn(|side| cubes[first + side])
        };
        Ok(ProbeLight { grid, cubes: self.volume.probes.iter().map(of_voxel).collect() })
    }
}
