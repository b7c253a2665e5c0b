//! From frame to frame: what is there, what is baked, what shines.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use bevy::asset::{AssetServer, Assets, Handle, RenderAssetUsages};
use bevy::camera::visibility::Visibility;
use bevy::ecs::prelude::*;
use bevy::ecs::system::SystemParam;
use bevy::image::{Image, ImageSampler};
use bevy::light::{AmbientLight, EnvironmentMapLight, GlobalAmbientLight, IrradianceVolume, LightProbe};
use bevy::log::{info, warn};
use bevy::mesh::{Mesh as BevyMesh, Mesh3d};
use bevy::pbr::{Lightmap, MeshMaterial3d, StandardMaterial};
use bevy::platform::cell::SyncCell;
use bevy::prelude::{ChildOf, GlobalTransform, Name, Quat, Transform, Vec3};
use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat};
use bevy::tasks::futures::check_ready;
use bevy::tasks::{AsyncComputeTaskPool, Task, block_on};
use patchlight::bake::{Bake, BakeSettings};
use patchlight::glam::Affine3A;
use patchlight::outputs::LiveLightmap;
use patchlight::{BakeJob, LightSettings, Refinement};

use crate::baked::{PatchlightBake, hash};
use crate::gather::{MeshParts, Snapshot, affine, parts};
use crate::layout::{self, lit_mesh};
use crate::lights::{Lamps, LampsNow, Which};
use crate::shared::{Message, Report, Targets, ToDevice};
use crate::sky::SkyMap;
use crate::upload::Tiles;
use crate::work::{Found, Move, Order, Place, Prepared, ProbeTexels, Texels, Work};
use crate::{DeviceChoice, PatchlightMoving, PatchlightSettings, PatchlightStage, PatchlightStatic, PatchlightStatus};

type Outcome = (Box<Work>, Result<Found, patchlight::Error>);

/// The work under way.
#[derive(Resource, Default)]
pub(crate) struct State {
    /// True if the meshes that rest may have changed.
    is_dirty: bool,
    revision: u32,
    preparing: Option<(Task<Result<(Prepared, LiveLightmap), String>>, Snapshot)>,
    lit: Option<Lit>,
    /// Meshes that are lit.
    entities: HashSet<Entity>,
    sky: SkyMap,
}

/// A scene that is lit.
struct Lit {
    snapshot: Snapshot,
    prepared: Arc<Prepared>,
    source: Source,
    /// At rest between updates.
    work: Option<SyncCell<Box<Work>>>,
    task: Option<Task<Outcome>>,
    /// Bake that the work does not have yet.
    new_bake: Option<(Arc<Bake>, bool)>,
    last: Option<LampsNow>,
    /// On Bevy's device: the number of the scene, and the light that was asked for there.
    device: Option<(u64, Option<LampsNow>)>,
    lightmap: Handle<Image>,
    /// Its texels.
    texels: Vec<u8>,
    /// The lightmap has light, and the meshes have the lightmap.
    has_light: bool,
    is_shown: bool,
    volume: Option<(Entity, Handle<Image>, Place)>,
    moving: HashMap<Entity, Affine3A>,
    moves: Vec<Move>,
}

/// Where bakes come from.
enum Source {
    Job(BakeJob),
    /// An asset that is being loaded.
    Asset(Handle<PatchlightBake>),
    Done,
}

/// A mesh with a lightmap, and what it was before.
#[derive(Component)]
pub(crate) struct Original {
    mesh: Handle<BevyMesh>,
    lit: Handle<BevyMesh>,
    material: Handle<StandardMaterial>,
    transform: Affine3A,
}

type MeshItem = (
    Entity,
    &'static Mesh3d,
    &'static MeshMaterial3d<StandardMaterial>,
    &'static GlobalTransform,
    Option<&'static Name>,
    Option<&'static Original>,
);

/// The meshes of a world.
#[derive(SystemParam)]
pub(crate) struct Meshes<'w, 's> {
    all: Query<'w, 's, MeshItem, Without<PatchlightMoving>>,
    marked: Query<'w, 's, (), With<PatchlightStatic>>,
    parents: Query<'w, 's, &'static ChildOf>,
    meshes: Res<'w, Assets<BevyMesh>>,
    materials: Res<'w, Assets<StandardMaterial>>,
    images: Res<'w, Assets<Image>>,
    server: Res<'w, AssetServer>,
}

impl Meshes<'_, '_> {
    fn is_static(&self, entity: Entity) -> bool {
        self.marked.contains(entity) || self.parents.iter_ancestors(entity).any(|parent| self.marked.contains(parent))
    }

    /// True while a picture is being loaded; one that cannot be is not waited for.
    fn is_on_its_way(&self, texture: &Handle<Image>) -> bool {
        self.images.get(texture).is_none() && !self.server.load_state(texture.id()).is_failed()
    }

    /// What rests; none while some of it is being loaded.
    fn snapshot(&self) -> Option<Snapshot> {
        let mut snapshot = Snapshot::default();
        let mut all: Vec<_> = self.all.iter().filter(|item| self.is_static(item.0)).collect();
        // The order of a query changes with components.
        all.sort_by_key(|item| item.0);
        for (entity, mesh, material, transform, name, original) in all {
            let handle = original.map_or(&mesh.0, |original| &original.mesh);
            let own = self.materials.get(&material.0)?;
            let textures = [&own.base_color_texture, &own.emissive_texture];
            if textures.into_iter().flatten().any(|texture| self.is_on_its_way(texture)) {
                return None;
            }
            let bevy_mesh = self.meshes.get(handle)?;
            let Some(number) = snapshot.material(&material.0, own, &self.images) else { continue };
            let name = name.map_or_else(|| entity.to_string(), |name| name.to_string());
            snapshot.meshes.extend(parts((entity, name), bevy_mesh, &transform.affine(), (number, own)));
        }
        Some(snapshot)
    }
}

type ChangedItem = (Entity, &'static Mesh3d, &'static MeshMaterial3d<StandardMaterial>, Option<&'static Original>);
type CameOrChanged = Or<(Added<PatchlightStatic>, Changed<Mesh3d>, Changed<MeshMaterial3d<StandardMaterial>>)>;

/// Sees that what rests has changed, and begins to prepare it once all of it is there.
#[expect(clippy::too_many_arguments, reason = "each is a part of the world")]
pub(crate) fn watch(
    mut state: ResMut<State>,
    mut status: ResMut<PatchlightStatus>,
    settings: Res<PatchlightSettings>,
    meshes: Meshes,
    lamps: Lamps,
    changed: Query<ChangedItem, CameOrChanged>,
    moved: Query<(&GlobalTransform, &Original), Changed<GlobalTransform>>,
    mut unmarked: RemovedComponents<PatchlightStatic>,
    mut gone: RemovedComponents<Original>,
) {
    let came = changed.iter().any(|(entity, mesh, material, original)| {
        let is_same = |original: &Original| original.lit == mesh.0 && original.material == material.0;
        meshes.is_static(entity) && !original.is_some_and(is_same)
    });
    let went = unmarked.read().count() > 0 || gone.read().any(|entity| state.entities.contains(&entity));
    let elsewhere = moved.iter().any(|(transform, original)| affine(&transform.affine()) != original.transform);
    if came || went || elsewhere || state.revision != settings.revision {
        state.revision = settings.revision;
        state.is_dirty = true;
        // More may follow in the next frame.
        if !settings.wait {
            return;
        }
    }
    if !state.is_dirty || state.preparing.is_some() {
        return;
    }
    let Some(snapshot) = meshes.snapshot() else { return };
    state.is_dirty = false;
    if snapshot.meshes.is_empty() {
        state.lit = None;
        state.entities.clear();
        status.stage = PatchlightStage::Waiting;
        return;
    }
    let possible = lamps.now(&snapshot.ids, &mut state.sky, Which::Possible).lighting;
    let own = snapshot.clone();
    let texel = settings.texel;
    let prepare = async move { prepare(&own, possible, texel) };
    status.stage = PatchlightStage::Preparing;
    state.preparing = Some((AsyncComputeTaskPool::get().spawn(prepare), snapshot));
}

fn prepare(
    snapshot: &Snapshot,
    lighting: patchlight::Lighting,
    texel: f32,
) -> Result<(Prepared, LiveLightmap), String> {
    let scene = snapshot.scene(lighting).map_err(|error| error.to_string())?;
    let lightmap = layout::lightmap(&scene, snapshot, texel).map_err(|error| {
        format!("{error}; a larger PatchlightSettings::texel than {texel} m makes a smaller lightmap")
    })?;
    let uvs = layout::corner_uvs(&lightmap, snapshot);
    let hash = hash(&scene);
    Ok((Prepared { scene, uvs, hash }, lightmap))
}

/// Begins the bake of a prepared scene and takes bakes as they come; puts the lightmap onto its meshes once there is light in
/// it.
#[expect(clippy::too_many_arguments, reason = "each is a part of the world")]
pub(crate) fn follow(
    mut commands: Commands,
    mut state: ResMut<State>,
    mut status: ResMut<PatchlightStatus>,
    settings: Res<PatchlightSettings>,
    mut meshes: ResMut<Assets<BevyMesh>>,
    mut images: ResMut<Assets<Image>>,
    bakes: Res<Assets<PatchlightBake>>,
    entities: Query<(&Mesh3d, &MeshMaterial3d<StandardMaterial>, Option<&Original>)>,
    originals: Query<(Entity, &Original)>,
) {
    if let Some((mut task, snapshot)) = state.preparing.take() {
        let done = if settings.wait { Some(block_on(&mut task)) } else { check_ready(&mut task) };
        match done {
            None => state.preparing = Some((task, snapshot)),
            Some(Err(error)) => fail(&mut status, &error),
            Some(Ok((prepared, lightmap))) => {
                let size = layout::size(&lightmap);
                let image = images.add(lightmap_image(size));
                status.lightmap_size = size;
                let volume = state.lit.take().and_then(|before| before.volume);
                match Lit::new(snapshot, prepared, (lightmap, image), &settings) {
                    Ok(lit) => state.lit = Some(Lit { volume, ..lit }),
                    Err(error) => fail(&mut status, &error.to_string()),
                }
            }
        }
    }
    let State { lit, entities: shown, .. } = &mut *state;
    if lit.is_none() && shown.is_empty() {
        remove_lightmaps(&mut commands, shown, &originals);
    }
    let Some(lit) = lit else { return };
    if lit.has_light && !lit.is_shown {
        lit.is_shown = true;
        *shown = lit.snapshot.meshes.iter().map(|mesh| mesh.entity).collect();
        remove_lightmaps(&mut commands, shown, &originals);
        for (number, own) in lit.snapshot.meshes.iter().enumerate() {
            let Ok((mesh, material, original)) = entities.get(own.entity) else { continue };
            let before = original.map_or(&mesh.0, |original| &original.mesh).clone();
            let Some(new) = meshes.get(&before).map(|mesh| lit_mesh(mesh, &lit.prepared.uvs[number])) else {
                continue;
            };
            let new = meshes.add(new);
            commands.entity(own.entity).insert((
                Mesh3d(new.clone()),
                Lightmap { image: lit.lightmap.clone(), ..Lightmap::default() },
                Original { mesh: before, lit: new, material: material.0.clone(), transform: own.transform },
            ));
        }
    }
    if let Err(error) = lit.take_bake(&bakes, &settings) {
        fail(&mut status, &error.to_string());
        state.lit = None;
        return;
    }
    if let Some((bake, _)) = &lit.new_bake {
        status.patches = bake.mesh().patches.len();
        status.bake = Some((Arc::clone(bake), lit.prepared.hash));
    }
}

fn fail(status: &mut PatchlightStatus, reason: &str) {
    warn!("Patchlight has no light: {reason}");
    status.stage = PatchlightStage::Failed(reason.into());
}

/// Gives meshes that are not among these back what they were.
fn remove_lightmaps(commands: &mut Commands, lit: &HashSet<Entity>, originals: &Query<(Entity, &Original)>) {
    for (entity, original) in originals {
        if !lit.contains(&entity) {
            let mesh = Mesh3d(original.mesh.clone());
            commands.entity(entity).remove::<(Lightmap, Original)>().insert(mesh);
        }
    }
}

fn lightmap_image((width, height): (u32, u32)) -> Image {
    let size = Extent3d { width, height, depth_or_array_layers: 1 };
    let mut image = Image::new_fill(
        size,
        TextureDimension::D2,
        &[0; 8],
        TextureFormat::Rgba16Float,
        RenderAssetUsages::RENDER_WORLD,
    );
    image.sampler = ImageSampler::linear();
    image
}

impl Lit {
    fn new(
        snapshot: Snapshot,
        prepared: Prepared,
        (lightmap, image): (LiveLightmap, Handle<Image>),
        settings: &PatchlightSettings,
    ) -> Result<Self, patchlight::Error> {
        check(settings)?;
        let prepared = Arc::new(prepared);
        let source = match &settings.bake {
            Some(handle) => Source::Asset(handle.clone()),
            None => Source::Job(begin(&prepared, settings)?),
        };
        let light = LightSettings::default().with_method(settings.method.clone());
        let work = Work::new(Arc::clone(&prepared), lightmap, light, settings);
        Ok(Self {
            snapshot,
            prepared,
            source,
            work: Some(SyncCell::new(Box::new(work))),
            task: None,
            new_bake: None,
            last: None,
            device: None,
            lightmap: image,
            texels: Vec::new(),
            has_light: false,
            is_shown: false,
            volume: None,
            moving: HashMap::new(),
            moves: Vec::new(),
        })
    }

    /// Takes a bake that has come.
    fn take_bake(
        &mut self,
        bakes: &Assets<PatchlightBake>,
        settings: &PatchlightSettings,
    ) -> Result<(), patchlight::Error> {
        if let Source::Asset(handle) = &self.source
            && let Some(own) = bakes.get(handle)
        {
            if own.scene_hash == self.prepared.hash {
                self.new_bake = Some((Arc::clone(&own.bake), true));
                self.source = Source::Done;
            } else {
                warn!("the bake is of another scene, or of this before it was changed; Patchlight bakes anew");
                self.source = Source::Job(begin(&self.prepared, settings)?);
            }
        }
        match std::mem::replace(&mut self.source, Source::Done) {
            Source::Job(job) if settings.wait || job.is_finished() => {
                self.new_bake = Some((job.join()?, true));
            }
            Source::Job(job) => {
                if let Some(bake) = job.take_newest() {
                    self.new_bake = Some((bake, false));
                }
                self.source = Source::Job(job);
            }
            other => self.source = other,
        }
        Ok(())
    }

    fn stage(&self, has_light: bool) -> PatchlightStage {
        match &self.source {
            _ if !has_light => PatchlightStage::Preparing,
            Source::Job(job) => PatchlightStage::Refining(job.progress().share),
            _ => PatchlightStage::Finished,
        }
    }
}

/// Refuses settings that cannot apply.
fn check(settings: &PatchlightSettings) -> Result<(), patchlight::Error> {
    let reason = if !settings.shares_device {
        return Ok(());
    } else if cfg!(not(feature = "vulkan")) {
        "PatchlightSettings::shares_device needs the feature `vulkan` of bevy_patchlight"
    } else if settings.device != DeviceChoice::Cpu {
        "PatchlightSettings::device names another device than Bevy's, which shares_device asks for"
    } else {
        return Ok(());
    };
    Err(patchlight::Error::new(patchlight::ErrorKind::Unsupported, reason))
}

/// Begins the bake of a scene.
fn begin(prepared: &Prepared, settings: &PatchlightSettings) -> Result<BakeJob, patchlight::Error> {
    let bake =
        BakeSettings::default().with_patch_count(settings.patch_count).with_receiver_density(settings.receiver_density);
    let refinement = Refinement::default().with_methods(vec![settings.method.clone()]);
    Bake::refine(&prepared.scene, &bake, refinement)
}

type MovingItem = (
    Entity,
    &'static Mesh3d,
    &'static MeshMaterial3d<StandardMaterial>,
    &'static GlobalTransform,
    Option<&'static Name>,
);

/// What moves, and what its light is written to.
#[derive(SystemParam)]
pub(crate) struct Moving<'w, 's> {
    all: Query<'w, 's, MovingItem, With<PatchlightMoving>>,
    meshes: Res<'w, Assets<BevyMesh>>,
    materials: Res<'w, Assets<StandardMaterial>>,
}

impl Moving<'_, '_> {
    /// Changes since the last update.
    fn changes(&self, lit: &mut Lit) {
        for (entity, mesh, material, transform, name) in &self.all {
            let place = affine(&transform.affine());
            match lit.moving.get_mut(&entity) {
                Some(before) if *before == place => {}
                Some(before) => {
                    *before = place;
                    // Between two updates the last place counts.
                    lit.moves.retain(|change| !matches!(change, Move::Place(other, _) if *other == entity));
                    lit.moves.push(Move::Place(entity, place));
                }
                None => {
                    let (Some(own), Some(mesh)) = (self.materials.get(&material.0), self.meshes.get(&mesh.0)) else {
                        continue;
                    };
                    let number = lit.snapshot.nearest(&material.0, own);
                    let name = name.map_or_else(|| entity.to_string(), |name| name.to_string());
                    let found = parts((entity, name), mesh, &transform.affine(), (number, own));
                    lit.moving.insert(entity, place);
                    lit.moves.extend(found.map(|parts: MeshParts| Move::Insert(entity, Arc::new(parts), place)));
                }
            }
        }
        let gone: Vec<Entity> = lit.moving.keys().copied().filter(|&entity| !self.all.contains(entity)).collect();
        for entity in gone {
            lit.moving.remove(&entity);
            lit.moves.push(Move::Remove(entity));
        }
    }
}

/// Finds the light of the lights as they are, beside the frames, and writes it to the textures.
#[expect(clippy::too_many_arguments, reason = "each is a part of the world")]
pub(crate) fn light(
    mut commands: Commands,
    mut state: ResMut<State>,
    mut status: ResMut<PatchlightStatus>,
    settings: Res<PatchlightSettings>,
    moving: Moving,
    mut tiles: ResMut<Tiles>,
    mut shared: (ResMut<ToDevice>, Res<Report>),
    mut lamps: ParamSet<(Lamps, ResMut<Assets<Image>>, Skies)>,
) {
    let State { lit, sky, .. } = &mut *state;
    let Some(lit) = lit else {
        shared.0.end();
        return;
    };
    let now = lamps.p0().now(&lit.snapshot.ids, sky, Which::Shining);
    moving.changes(lit);
    let mut shown = Shown { tiles: &mut tiles, to_device: &mut shared.0, status: &mut status };
    if let Some(mut task) = lit.task.take() {
        match check_ready(&mut task) {
            None => lit.task = Some(task),
            Some(outcome) => shown.finish(lit, outcome, &mut commands, &mut lamps.p1()),
        }
    }
    if lit.is_due(&now, settings.shares_device)
        && let Some(work) = lit.work.take()
    {
        let mut work = SyncCell::to_inner(work);
        let moves = if settings.shares_device { Vec::new() } else { std::mem::take(&mut lit.moves) };
        let order = Order { bake: lit.new_bake.take(), lamps: now.clone(), moves };
        lit.last = Some(now.clone());
        if settings.wait {
            let outcome = work.run(&order);
            shown.finish(lit, (work, outcome), &mut commands, &mut lamps.p1());
        } else {
            lit.task = Some(AsyncComputeTaskPool::get().spawn(async move {
                let outcome = work.run(&order);
                (work, outcome)
            }));
        }
    }
    lit.ask_device(now, &mut shared.0);
    lit.hear_device(&shared.1, &mut status);
    if status.updates > 0 {
        lamps.p2().leave_to_lightmaps();
    }
    if !matches!(status.stage, PatchlightStage::Failed(_)) {
        let stage = lit.stage(status.updates > 0);
        if status.stage != stage {
            if stage == PatchlightStage::Finished {
                info!("Patchlight has baked {} patches", status.patches);
            }
            status.stage = stage;
        }
    }
}

impl Lit {
    /// True if the work has something to do: on Bevy's device that is what surfaces that shine and the sky send.
    fn is_due(&self, now: &LampsNow, is_shared: bool) -> bool {
        if self.new_bake.is_some() {
            return true;
        }
        let Some(last) = &self.last else { return false };
        if is_shared { !last.has_same_surroundings(now) } else { !self.moves.is_empty() || last != now }
    }

    /// Asks for the light of lamps on Bevy's device, once it has a bake.
    fn ask_device(&mut self, now: LampsNow, to_device: &mut ToDevice) {
        let Some((_, last)) = &mut self.device else { return };
        if last.as_ref() == Some(&now) && self.moves.is_empty() {
            return;
        }
        let moves = std::mem::take(&mut self.moves);
        to_device.messages.push(Message::Light(Box::new(now.lighting.clone()), moves));
        *last = Some(now);
    }

    /// Takes what Bevy's device has done for this scene.
    fn hear_device(&mut self, report: &Report, status: &mut PatchlightStatus) {
        let Some((number, _)) = self.device else { return };
        let mut done = report.lock();
        if done.scene != number {
            return;
        }
        done.warnings.drain(..).for_each(|warning| warn!("Patchlight: {warning}"));
        if let Some(error) = done.error.take() {
            fail(status, &error);
            self.device = None;
            self.work = None;
            return;
        }
        if done.updates > 0 {
            self.has_light = true;
            status.updates += done.updates;
            status.update_time = Duration::from_secs_f32(done.seconds);
            status.work_time = status.update_time;
            status.texels_sent = 0;
            done.updates = 0;
        }
    }
}

/// Light from all round.
#[derive(SystemParam)]
pub(crate) struct Skies<'w, 's> {
    global: ResMut<'w, GlobalAmbientLight>,
    ambients: Query<'w, 's, &'static mut AmbientLight>,
    environments: Query<'w, 's, &'static mut EnvironmentMapLight>,
}

impl Skies<'_, '_> {
    /// It is part of the lightmaps: Bevy adds it to no mesh that has one.
    fn leave_to_lightmaps(&mut self) {
        if self.global.affects_lightmapped_meshes {
            self.global.affects_lightmapped_meshes = false;
        }
        for mut ambient in self.ambients.iter_mut().filter(|ambient| ambient.affects_lightmapped_meshes) {
            ambient.affects_lightmapped_meshes = false;
        }
        let environments = self.environments.iter_mut();
        for mut environment in environments.filter(|environment| environment.affects_lightmapped_mesh_diffuse) {
            environment.affects_lightmapped_mesh_diffuse = false;
        }
    }
}

/// Where light is shown.
struct Shown<'a> {
    tiles: &'a mut Tiles,
    to_device: &'a mut ToDevice,
    status: &'a mut PatchlightStatus,
}

impl Shown<'_> {
    /// Takes the outcome of an order.
    fn finish(&mut self, lit: &mut Lit, outcome: Outcome, commands: &mut Commands, images: &mut Assets<Image>) {
        let (work, found) = outcome;
        let place = work.place();
        lit.work = Some(SyncCell::new(work));
        match found {
            Ok(Found::Nothing) => {}
            Ok(Found::Texels(texels)) => self.show(lit, texels, commands, images),
            Ok(Found::ForDevice(bake, base)) => {
                if let Some(bake) = bake {
                    if bake.setup.is_some() {
                        show_volume(lit, place, commands, images);
                        self.status.scenes += 1;
                    }
                    let probes = lit.volume.as_ref().map(|(_, image, _)| image.id());
                    let targets = Targets { lightmap: lit.lightmap.id(), probes };
                    self.to_device.messages.push(Message::Bake(Box::new(bake), targets, self.status.scenes));
                    self.to_device.is_lit = true;
                    // Light of a new bake is found anew.
                    lit.device = Some((self.status.scenes, None));
                }
                self.to_device.messages.push(Message::Base(base));
            }
            Err(error) => {
                fail(self.status, &error.to_string());
                lit.work = None;
            }
        }
    }

    /// Shows texels of the processor.
    fn show(&mut self, lit: &mut Lit, texels: Texels, commands: &mut Commands, images: &mut Assets<Image>) {
        texels.warnings.iter().for_each(|warning| warn!("Patchlight: {warning}"));
        lit.has_light = true;
        let id = lit.lightmap.id();
        let (width, height) = self.status.lightmap_size;
        let of_tiles = self.tiles.add(id, width, &lit.texels, &texels.lightmap);
        if of_tiles.is_none()
            && let Some(mut image) = images.get_mut(&lit.lightmap)
        {
            self.tiles.forget(id);
            image.data = Some(texels.lightmap.clone());
        }
        self.status.texels_sent = of_tiles.unwrap_or(u64::from(width) * u64::from(height));
        lit.texels = texels.lightmap;
        show_volume(lit, texels.probes.as_ref().map(|probes| probes.place), commands, images);
        if let (Some(ProbeTexels { bytes, .. }), Some((_, image, _))) = (texels.probes, &lit.volume)
            && let Some(mut image) = images.get_mut(image)
        {
            image.data = Some(bytes);
        }
        self.status.updates += 1;
        self.status.update_time = Duration::from_secs_f32(texels.seconds.0);
        self.status.work_time = Duration::from_secs_f32(texels.seconds.1);
    }
}

/// Makes an irradiance volume at a place, dark, unless it is there already; takes away one that is elsewhere.
fn show_volume(lit: &mut Lit, place: Option<Place>, commands: &mut Commands, images: &mut Assets<Image>) {
    if lit.volume.as_ref().map(|(_, _, place)| *place) == place {
        return;
    }
    if let Some((entity, ..)) = lit.volume.take() {
        commands.entity(entity).despawn();
    }
    let Some(place) = place else { return };
    let [width, height, depth_or_array_layers] = place.size;
    let size = Extent3d { width, height, depth_or_array_layers };
    let (kind, format) = (TextureDimension::D3, TextureFormat::Rgba16Float);
    let mut image = Image::new_fill(size, kind, &[0; 8], format, RenderAssetUsages::RENDER_WORLD);
    image.sampler = ImageSampler::linear();
    let voxels = images.add(image);
    let vector = |v: patchlight::glam::Vec3| Vec3::from_array(v.to_array());
    let transform =
        Transform { translation: vector(place.middle), rotation: Quat::IDENTITY, scale: vector(place.extent) };
    let volume = IrradianceVolume { voxels: voxels.clone(), intensity: 1.0, affects_lightmapped_meshes: false };
    let entity = commands.spawn((LightProbe::new(), volume, transform, Visibility::Visible)).id();
    lit.volume = Some((entity, voxels, place));
}
