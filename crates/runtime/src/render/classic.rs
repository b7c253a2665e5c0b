//! Classic radiosity: patches of any kind, one product a bounce; receivers on the mesh, or the patches themselves.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use formfactor::{Csr, HitRows, Operator, Stop, add_quarter_rows, gather_by_rays, jacobi};
use glam::{Vec3, Vec4};
use multibounce::Acceleration;
use patches::{LitSampler, Lookup, ViewSettings};
use reference::Picture;
use scene::sampling::hash3;
use scene::{Camera, DirectParams, Light, Scene, SurfacePoint};

use super::debug::{DebugPicture, DebugView};
use super::decode::{Decode, Decoder};
use super::exchange::{Exchange, exchange};
use super::firstshot::{FirstShot, quietly, write_files};
use super::frame::{self, Frame, FrameParts};
use super::local::{LocalFrame, LocalLight};
use super::operator::{self, Build, Compressing, Feedback, LAST_BOUNCES, PatchOperator, Transport, accelerations};
use super::pixels::PixelGather;
use super::receivers::{MeshReceivers, Placing};
pub use super::senders::PatchKind;
use super::senders::{Columns, MOST_PATCHES, SenderSettings, Senders, lit_sampler};
use super::temporal::{Rows, Sampled, SampledRows};
use super::test_lights::test_lights;
use super::{Pictures, go_on, proceed};
use crate::error::Error;
use crate::executor::{DeviceChoice, Executor, open};
use crate::import::{LoadedScene, View};
use crate::progress::Progress;

/// Receivers along the edge of a patch.
const RECEIVERS_AN_EDGE: f32 = 3.0;
/// Most receivers for each that their distance gives where light is even.
const MOST_RECEIVERS: f32 = 10.0 / 3.0;
/// Rays of a row of [`Classic::irradiance_at`].
const POINT_RAYS: u32 = 4096;
/// Bounces when all are asked for end when no patch changes by more than this share of the brightest.
const TOLERANCE: f32 = 1e-4;
/// Bounces at most: an albedo of 0.95 in a closed room needs 180 for the tolerance.
const MOST_BOUNCES: u32 = 200;

/// Estimator of the form factors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Estimator {
    /// Cosine-weighted rays.
    Hemisphere {
        /// Rays a row.
        rays: u32,
    },
    /// Lambert's contour formula with shadow rays.
    Contour,
    /// Pairs of points on both patches.
    Area,
    /// One point a patch.
    Point,
}

/// Where irradiance is gathered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReceiverKind {
    /// At points of the surface, close where light bends; pixels take the mean of those about.
    #[default]
    Mesh,
    /// At every visible point of a view, with nothing in between: slow, for measuring.
    Pixels,
    /// By the patches themselves; pixels take the mean of those about. Only voxel and axis patches can.
    SelfReceivers,
}

/// Settings of [`Classic::bake`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClassicSettings {
    /// What patches are.
    pub patches: PatchKind,
    /// About how many patches.
    pub patch_count: usize,
    /// Edge of the voxels of voxel and axis patches, m, instead of their count.
    pub voxel_size: Option<f32>,
    /// Samples of a cluster, on average: where its direct light is measured.
    pub samples: u32,
    /// Rays to area lights, and to a sky map, from each sample.
    pub sample_rays: u32,
    /// Estimator of the form factors between patches.
    pub estimator: Estimator,
    /// How light goes from patch to patch.
    pub transport: Transport,
    /// What decodes operators in texture blocks.
    pub decode: Decode,
    /// Bounces; `None` for all.
    pub bounces: Option<u32>,
    /// Where irradiance is gathered.
    pub receivers: ReceiverKind,
    /// Distance between receivers where light is even, m; `None` takes a third of the patches' mean edge, over √density.
    pub receiver_edge: Option<f32>,
    /// Most receivers: beyond those of the distance, where light bends; `None` for ten thirds of those.
    pub most_receivers: Option<usize>,
    /// Receivers for each that there would be by default.
    pub receiver_density: f32,
    /// Rays of a receiver's row.
    pub receiver_rays: u32,
    /// Sub-frames a picture: positions in each pixel, and shadow rays of area lights.
    pub sub_frames: u32,
    /// Changes every random number.
    pub seed: u32,
    /// Picture size, pixels.
    pub size: (u32, u32),
}

impl Default for ClassicSettings {
    /// 4,000 patches, 4,096 rays a row, all bounces, 16 sub-frames of 960 × 540.
    fn default() -> Self {
        Self {
            patches: PatchKind::default(),
            patch_count: 4000,
            voxel_size: None,
            samples: ViewSettings::default().samples,
            sample_rays: 8,
            estimator: Estimator::Hemisphere { rays: 4096 },
            transport: Transport::default(),
            decode: Decode::default(),
            bounces: None,
            receivers: ReceiverKind::default(),
            receiver_edge: None,
            most_receivers: None,
            receiver_density: 1.0,
            receiver_rays: 1024,
            sub_frames: 16,
            seed: 0,
            size: (960, 540),
        }
    }
}

/// A rendered frame.
pub struct FrameResult {
    /// The picture.
    pub pictures: Pictures,
    /// Milliseconds of each pass: direct, gather, method, lookup, shade.
    pub times: Vec<(String, f64)>,
}

/// What the sides of the scene exchange, however light goes from patch to patch.
#[derive(Clone)]
pub struct Bake {
    scene: Scene,
    senders: Senders,
    exchange: Exchange,
    receivers: MeshReceivers,
    direct: DirectParams,
    bounces: u32,
    view: View,
    settings: ClassicSettings,
    build: Build,
}

/// A bake on a device, ready for frames.
pub struct Classic {
    scene: Scene,
    senders: Senders,
    /// Without their rows: the device has them.
    receivers: MeshReceivers,
    frame: Frame,
    first_shot: Option<FirstShot>,
    decoder: Option<Decoder>,
    settings: ClassicSettings,
    bytes: BTreeMap<String, u64>,
}

/// The patches of a scene and what they exchange: a bake that has no receivers yet.
#[derive(Clone)]
pub struct Patches<'a> {
    sampler: Option<LitSampler<'a>>,
    bake: Bake,
}

impl<'a> Patches<'a> {
    /// Cuts the scene into patches, and estimates and balances their form factors.
    ///
    /// # Errors
    /// Too many triangles or voxels, settings that the patches do not suit, cancellation.
    pub fn new(loaded: &'a LoadedScene, settings: ClassicSettings, progress: &mut Progress) -> Result<Self, Error> {
        check_receivers(&settings)?;
        let scene = &loaded.scene;
        let too_many = |needed: usize| Error::TooManyPatches {
            scene: loaded.name.clone(),
            triangles: scene.triangles.len(),
            needed,
            limit: MOST_PATCHES,
        };
        if settings.patches == PatchKind::Polygon && scene.triangles.len() > MOST_PATCHES {
            return Err(too_many(scene.triangles.len()));
        }
        let (sampler, senders) = progress.phase("sample", |_| -> Result<_, Error> {
            let sampler = lit_sampler(scene, settings.patch_count, settings.seed)?;
            let made = SenderSettings {
                kind: settings.patches,
                count: settings.patch_count,
                voxel_size: settings.voxel_size,
                samples: settings.samples,
                seed: settings.seed,
            };
            let senders = Senders::new(scene, sampler.as_ref(), &made)?;
            Ok((sampler, senders))
        })?;
        if senders.patches.len() > MOST_PATCHES {
            return Err(too_many(senders.patches.len()));
        }
        let exchange = progress.phase("form_factors", |report| exchange(scene, &senders, &settings, report))?;
        let bounces = match settings.bounces {
            Some(bounces) => bounces,
            None => progress.phase("bounces", |_| enough_bounces(&exchange.factors, &senders.albedo))?,
        };
        let direct = DirectParams {
            count: senders.points.len() as u32,
            area_rays: settings.sample_rays,
            sky_rays: if scene.sky.map_width == 0 { 0 } else { settings.sample_rays },
            seed: settings.seed,
            ..direct_params(scene)
        };
        let (receivers, view) = (MeshReceivers::none(scene)?, loaded.view);
        let build = Build::default();
        let bake = Bake { scene: scene.clone(), senders, exchange, receivers, direct, bounces, view, settings, build };
        Ok(Self { sampler, bake })
    }

    /// Whether these are the patches of such settings: they differ at most in receivers, transport and pictures.
    pub fn are_of(&self, settings: &ClassicSettings) -> bool {
        let what = |s: &ClassicSettings| {
            let sides = (s.patches, s.patch_count, s.voxel_size, s.samples, s.seed);
            (sides, s.sample_rays, s.estimator, s.bounces)
        };
        what(&self.bake.settings) == what(settings)
    }

    /// Places receivers: of these settings only what says where and with how many rays counts, with the patches as they are.
    ///
    /// # Errors
    /// Receivers that the patches do not suit, cancellation.
    pub fn with_receivers(self, settings: ClassicSettings, progress: &mut Progress) -> Result<Bake, Error> {
        let Self { sampler, bake } = self;
        let settings = ClassicSettings { patches: bake.settings.patches, ..settings };
        check_receivers(&settings)?;
        let Bake { scene, senders, exchange, direct, .. } = &bake;
        let receivers = progress.phase("receivers", |report| -> Result<_, Error> {
            let sampler = match &sampler {
                Some(sampler) if settings.receivers == ReceiverKind::Mesh => sampler,
                _ => return MeshReceivers::none(scene),
            };
            let seed = settings.seed ^ 0x7265_6365;
            let area: f32 = senders.areas().iter().sum();
            let patch_edge = (area / senders.patches.len().max(1) as f32).sqrt();
            let even = patch_edge / (RECEIVERS_AN_EDGE * scene::math::sqrt(settings.receiver_density));
            let edge = settings.receiver_edge.unwrap_or(even);
            let lights = test_lights(scene, senders, exchange, direct)?;
            let placing = Placing {
                rays: settings.receiver_rays,
                edge,
                most: settings.most_receivers.unwrap_or((MOST_RECEIVERS * area / (edge * edge)) as usize),
                seed,
            };
            // How many there will be is not known: the bar shows the rows of each round.
            let add = |rows: &mut HitRows, points: &[SurfacePoint]| {
                let offsets: Vec<u32> = (0..=points.len() as u32).collect();
                let seed = hash3(rows.rows() as u32, 0, seed);
                let surfaces = senders.lighting(scene, Columns::Facets, points, &offsets, seed);
                let progress = |done, total| proceed(report, done, total);
                add_quarter_rows(rows, &surfaces, settings.receiver_rays, &progress)?;
                Ok(())
            };
            MeshReceivers::place(scene, sampler, senders.facets.len(), &placing, &lights, &add)
        })?;
        progress.note(&format!(
            "{} patches, {} facets, {} receivers, {} nodes",
            senders.patches.len(),
            senders.facets.len(),
            receivers.points.len(),
            receivers.nodes.points.len()
        ));
        Ok(Bake { receivers, settings, ..bake })
    }
}

impl Bake {
    /// [`Patches`] with receivers, in one step.
    ///
    /// # Errors
    /// As [`Patches::new`] and [`Patches::with_receivers`].
    pub fn new(loaded: &LoadedScene, settings: ClassicSettings, progress: &mut Progress) -> Result<Self, Error> {
        Patches::new(loaded, settings, progress)?.with_receivers(settings, progress)
    }

    /// Bounces of a frame, and how they use where the light was going.
    fn feedback(
        &self,
        settings: Feedback,
        operator: &PatchOperator,
        progress: &mut Progress,
    ) -> Result<(u32, Acceleration), Error> {
        let [plain, fast] = progress.phase("feedback", |_| accelerations(&self.senders.albedo, operator))?;
        progress.note(&format!(
            "of a change of light a bounce leaves {:.1} % to come, accelerated {:.1} %",
            100.0 * plain.rate,
            100.0 * fast.rate
        ));
        Ok((settings.products, if settings.accelerated { fast } else { plain }))
    }

    /// The same with an operator that is built otherwise.
    #[must_use]
    pub fn with_build(self, build: Build) -> Self {
        Self { build, ..self }
    }

    /// The operator that frames multiply by between patches: none for classic radiosity, and for so few bounces that patches
    /// need none. `device` is the one that frames run on, which may build it.
    ///
    /// # Errors
    /// An operator that does not fit into memory, cancellation.
    pub fn operator(
        &self,
        transport: Transport,
        device: Option<&mut (dyn Executor + 'static)>,
        progress: &mut Progress,
    ) -> Result<Option<PatchOperator>, Error> {
        let ClassicSettings { bounces, receivers, seed, .. } = self.settings;
        let at_patches = receivers == ReceiverKind::SelfReceivers;
        let compressing = Compressing { transport, build: &self.build, bounces, at_patches, seed };
        operator::compress(&compressing, &self.senders, &self.exchange.factors, device, progress)
    }

    /// The rows that frames sample: none but for temporal radiosity.
    ///
    /// # Errors
    /// Settings out of their range, rows that cannot be sampled.
    fn sampled(&self, transport: Transport, progress: &mut Progress) -> Result<Option<SampledRows>, Error> {
        let Transport::Temporal(temporal) = transport else { return Ok(None) };
        temporal.settings.check().map_err(Error::Temporal)?;
        let by_patches = self.settings.receivers == ReceiverKind::SelfReceivers;
        let last = if by_patches { 0 } else { LAST_BOUNCES };
        let sampled = progress.phase("tables", |_| -> Result<_, Error> {
            let Exchange { factors, facet_rows, .. } = &self.exchange;
            let between = (self.bounces > last).then(|| Rows::new(factors, temporal.rows)).transpose()?;
            let all = temporal.sampled == Sampled::All;
            // Facets that no light comes to from others, and receivers that are not there, are left as they are.
            let facets = (all && self.bounces > 1 && !by_patches).then(|| match facet_rows {
                Some(rows) => Rows::of_hits(rows),
                None => Rows::new(factors, temporal.rows),
            });
            let has_receivers = !self.receivers.points.is_empty();
            let receivers = (all && has_receivers).then(|| Rows::of_hits(&self.receivers.rows));
            Ok(SampledRows {
                settings: temporal.settings,
                patches: between,
                facets: facets.transpose()?,
                receivers: receivers.transpose()?,
            })
        })?;
        Ok(Some(sampled))
    }

    /// Makes what the transport needs between patches, and loads the frame's plan into the executor.
    ///
    /// # Errors
    /// An operator that does not fit into memory, a device that is too small, cancellation.
    pub fn load(
        self,
        transport: Transport,
        mut executor: Box<dyn Executor>,
        progress: &mut Progress,
    ) -> Result<Classic, Error> {
        if matches!(transport, Transport::FirstShot(_)) && self.settings.receivers == ReceiverKind::SelfReceivers {
            return Err(Error::FirstShotReceivers);
        }
        let operator = self.operator(transport, Some(executor.as_mut()), progress)?;
        let decoder = frame::decoder(self.settings.decode, executor.as_ref(), operator.as_ref())?;
        let feedback = match (transport, &operator) {
            (Transport::Feedback(feedback), Some(operator)) => Some(self.feedback(feedback, operator, progress)?),
            _ => None,
        };
        let sampled = self.sampled(transport, progress)?;
        let local = match transport {
            Transport::Local(options) => {
                Some(LocalLight::new(&self.senders, &self.exchange.factors, options, self.view.eye, progress)?)
            }
            _ => None,
        };
        let local_bytes = local.as_ref().map(LocalLight::bytes).unwrap_or_default();
        let [patch_bytes, facet_bytes, receiver_bytes] = sampled.as_ref().map(SampledRows::bytes).unwrap_or_default();
        let Self { scene, senders, exchange, receivers, direct, bounces, settings, .. } = self;
        let settings = ClassicSettings { transport, ..settings };
        let by_patches = settings.receivers == ReceiverKind::SelfReceivers;
        let mut first_shot = match transport {
            Transport::FirstShot(shot) => {
                let device = device_again(executor.as_ref())?;
                Some(progress.phase("maps", |_| FirstShot::new(&scene, &senders, shot, settings.seed, device))?)
            }
            _ => None,
        };
        if let Some(shot) = &mut first_shot {
            progress.phase("photons", |report| shot.solve(&scene, report))?;
            let round = shot.round();
            progress.note(&format!(
                "{} photons, {} registered, relative error {:.2} %",
                round.photons,
                round.registered,
                100.0 * round.error
            ));
        }
        let between = match (&operator, patch_bytes) {
            (Some(operator), _) => ("operator".to_owned(), operator.bytes()),
            (None, Some(bytes)) => ("tables".to_owned(), bytes),
            (None, None) => ("form_factors".to_owned(), csr_bytes(&exchange.factors)),
        };
        let is_there = by_patches || between.0 == "form_factors";
        let mut bytes = BTreeMap::from([
            between,
            ("facets".to_owned(), facet_bytes.unwrap_or_else(|| exchange.facet_bytes(is_there))),
            ("samples".to_owned(), size_of_val(&senders.points[..]) as u64),
            ("receivers".to_owned(), receiver_bytes.unwrap_or(receivers.rows.bytes())),
            ("smoothing".to_owned(), csr_bytes(&receivers.smoothing)),
            ("nodes".to_owned(), csr_bytes(&receivers.weights)),
            ("lookup".to_owned(), senders.lookup.as_ref().map_or(0, Lookup::bytes) as u64),
        ]);
        bytes.extend(local_bytes);
        if let Some(shot) = &first_shot {
            bytes.remove("form_factors");
            bytes.extend(shot.bytes().map(|(name, count)| (name.to_owned(), count)));
        }
        let frame = Frame::load(
            executor,
            FrameParts {
                scene: &scene,
                senders: &senders,
                receivers: &receivers,
                exchange: &exchange,
                operator: operator.as_ref(),
                decoder,
                feedback,
                sampled: sampled.as_ref(),
                local,
                lookup: senders.lookup.as_ref().filter(|_| by_patches),
                // The light between facets comes from photons.
                bounces: if first_shot.is_some() { 1 } else { bounces },
                direct,
                size: settings.size,
                sub_frames: settings.sub_frames,
                seed: settings.seed,
            },
        )?;
        let receivers = receivers.without_rows()?;
        Ok(Classic { scene, senders, receivers, frame, first_shot, decoder, settings, bytes })
    }
}

impl Classic {
    /// A [`Bake`] with the transport of the settings, in one step.
    ///
    /// # Errors
    /// As [`Bake::new`] and [`Bake::load`].
    pub fn bake(
        loaded: &LoadedScene,
        settings: ClassicSettings,
        executor: Box<dyn Executor>,
        progress: &mut Progress,
    ) -> Result<Self, Error> {
        Bake::new(loaded, settings, progress)?.load(settings.transport, executor, progress)
    }

    /// Patches that send light.
    pub fn patch_count(&self) -> usize {
        self.senders.patches.len()
    }

    /// Points that receive it.
    pub fn receiver_count(&self) -> usize {
        self.receivers.points.len()
    }

    /// What decodes the operator, where it is in texture blocks.
    pub fn decoder(&self) -> Option<Decoder> {
        self.decoder
    }

    /// Bytes of each part.
    pub fn bytes(&self) -> BTreeMap<String, u64> {
        self.bytes.clone()
    }

    /// Renders a frame with these lights from this camera.
    ///
    /// # Errors
    /// What the device says.
    pub fn frame(&mut self, lights: &[Light], camera: &Camera, number: u32) -> Result<FrameResult, Error> {
        self.scene.lights = lights.to_vec();
        self.look(camera.eye);
        let photons = self.shoot()?;
        let (full, direct, mut times) = self.frame.render(lights, camera, number)?;
        times.extend(photons);
        let (width, height) = self.settings.size;
        let full = Picture::from_pixels(width, height, full)?;
        let direct = Picture::from_pixels(width, height, direct)?;
        let indirect = match self.settings.receivers {
            ReceiverKind::Mesh | ReceiverKind::SelfReceivers => full.minus(&direct)?,
            ReceiverKind::Pixels => self.gather_pixels(lights, camera, number)?,
        };
        let full = direct.plus(&indirect)?;
        Ok(FrameResult { pictures: Pictures { full, direct, indirect }, times })
    }

    /// The light of a frame without its picture, for methods that go on from the light of the frame before; milliseconds of
    /// each pass.
    ///
    /// # Errors
    /// What the device says.
    pub fn advance(&mut self, lights: &[Light]) -> Result<Vec<(String, f64)>, Error> {
        self.scene.lights = lights.to_vec();
        let photons = self.shoot()?;
        let mut times = self.frame.advance(lights)?;
        times.extend(photons);
        Ok(times)
    }

    /// Where the camera is in the next frame, m: what is near it is what matters to the matrix round it. [`Self::frame`] says so itself.
    pub fn look(&mut self, eye: Vec3) {
        if let Some(local) = self.frame.local() {
            local.look(eye);
        }
    }

    /// What the last frame did with the matrix round the camera, where there is one.
    pub fn local_frame(&mut self) -> Option<LocalFrame> {
        self.frame.local().map(|local| local.last().clone())
    }

    /// Photons for the lights there are, where photons carry the light; the milliseconds.
    fn shoot(&mut self) -> Result<Option<(String, f64)>, Error> {
        let Some(shot) = &mut self.first_shot else { return Ok(None) };
        let start = Instant::now();
        shot.solve(&self.scene, &quietly)?;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        self.frame.set_facet_irradiance(&shot.facet_irradiance(&self.senders))?;
        Ok(Some(("method".to_owned(), milliseconds)))
    }

    /// The photons, where they carry the light.
    pub fn first_shot(&self) -> Option<&FirstShot> {
        self.first_shot.as_ref()
    }

    /// Writes what photons have registered into a folder: [`write_files`]. Nothing with other transports.
    ///
    /// # Errors
    /// Names the file that cannot be written.
    pub fn write_photons(&self, folder: &Path) -> Result<(), Error> {
        self.first_shot.as_ref().map_or(Ok(()), |shot| write_files(shot, &self.scene, &self.senders, folder))
    }

    /// Indirect irradiance of the last frame where pixels take it from, W/m²: at the nodes of the receivers' mesh, or of the
    /// patches where they are the receivers.
    ///
    /// # Errors
    /// What the device says.
    pub fn surface_irradiance(&mut self) -> Result<Vec<Vec3>, Error> {
        let light = match self.settings.receivers {
            ReceiverKind::SelfReceivers => self.frame.irradiance()?,
            ReceiverKind::Mesh => self.frame.node_irradiance()?,
            ReceiverKind::Pixels => self.frame.facet_irradiance()?,
        };
        Ok(light.iter().map(|h| h.truncate()).collect())
    }

    /// Pictures of the bake and of the last frame's light in it, as this camera sees them: patches, facets, the axes of
    /// their normals, E and H of the patches (H of all bounces but the last where receivers are apart), and where receivers
    /// are on the mesh, they and their distances. `stops` is the exposure of the scene's pictures.
    ///
    /// # Errors
    /// What the device says.
    pub fn debug_pictures(&mut self, camera: &Camera, stops: f32) -> Result<Vec<DebugPicture>, Error> {
        let source = self.frame.source()?;
        let irradiance = if self.settings.receivers == ReceiverKind::SelfReceivers {
            self.frame.irradiance()?
        } else {
            let (facets, shares) = (self.frame.facet_irradiance()?, self.senders.facet_shares());
            let mean = |range: &[u32]| (range[0] as usize..range[1] as usize).map(|f| facets[f] * shares[f]).sum();
            self.senders.patch_facets.windows(2).map(mean).collect()
        };
        let view = DebugView {
            scene: &self.scene,
            senders: &self.senders,
            receivers: &self.receivers,
            source: &source,
            irradiance: &irradiance,
            camera,
            stops,
        };
        view.pictures()
    }

    fn gather_pixels(&mut self, lights: &[Light], camera: &Camera, frame: u32) -> Result<Picture, Error> {
        let exitance = self.frame.exitance()?;
        let ClassicSettings { sub_frames, receiver_rays, seed, .. } = self.settings;
        let gather = |points: &[SurfacePoint], seed: u32| {
            let offsets: Vec<u32> = (0..=points.len() as u32).collect();
            let surfaces = self.senders.lighting(&self.scene, Columns::Facets, points, &offsets, seed);
            Ok(gather_by_rays(&surfaces, receiver_rays, &exitance, &go_on)?)
        };
        PixelGather { scene: &self.scene, gather: &gather, lights, camera, frame, sub_frames, seed }.indirect()
    }

    /// Indirect irradiance of the last frame at any points, W/m²: their own rows, gathered exactly from the patches, or, with
    /// the patches as receivers, the mean of those about.
    ///
    /// # Errors
    /// What the device says; cancellation.
    pub fn irradiance_at(&mut self, points: &[SurfacePoint]) -> Result<Vec<Vec3>, Error> {
        let seed = self.settings.seed ^ 0x706f_696e;
        if let Some(shot) = &self.first_shot {
            return Ok(shot.irradiance_at(&self.scene, points, seed));
        }
        let by_patches = self.settings.receivers == ReceiverKind::SelfReceivers;
        if let Some(lookup) = self.senders.lookup.as_ref().filter(|_| by_patches) {
            let light = lookup.at_points(&self.frame.irradiance()?, points)?;
            return Ok(light.iter().map(|h| h.truncate()).collect());
        }
        let exitance = self.frame.exitance()?;
        let offsets: Vec<u32> = (0..=points.len() as u32).collect();
        let surfaces = self.senders.lighting(&self.scene, Columns::Facets, points, &offsets, seed);
        let light = gather_by_rays(&surfaces, POINT_RAYS, &exitance, &go_on)?;
        Ok(light.iter().map(|h| h.truncate()).collect())
    }
}

/// Only voxels have a lookup between patches.
fn check_receivers(settings: &ClassicSettings) -> Result<(), Error> {
    if settings.receivers == ReceiverKind::SelfReceivers && !settings.patches.has_voxels() {
        let patches = settings.patches.name();
        return Err(Error::NoVoxels { option: "--receivers self", patches, instead: "--receivers mesh" });
    }
    Ok(())
}

/// The same device once more, for tables of its own; nothing for native code.
fn device_again(executor: &dyn Executor) -> Result<Option<Box<dyn Executor>>, Error> {
    match executor.device().index {
        Some(index) => Ok(Some(open(&DeviceChoice::Index(index))?.0)),
        None => Ok(None),
    }
}

/// Direct-light settings that follow from the scene.
pub fn direct_params(scene: &Scene) -> DirectParams {
    DirectParams {
        light_count: scene.lights.len() as u32,
        emitter_count: scene.emitters.len() as u32,
        ray_offset: scene.ray_offset,
        ..DirectParams::default()
    }
}

pub(super) fn csr_bytes(rows: &Csr) -> u64 {
    (size_of_val(&rows.row_start[..]) + size_of_val(&rows.column_index[..]) + size_of_val(&rows.values[..])) as u64
}

/// Bounces until a uniform source changes no patch by more than the tolerance, and a quarter more for sources that are not
/// uniform.
fn enough_bounces(factors: &Csr, albedo: &[Vec4]) -> Result<u32, Error> {
    let source = vec![Vec4::new(1.0, 1.0, 1.0, 0.0); albedo.len()];
    let steps = jacobi(factors, &source, albedo, Stop::Tolerance(TOLERANCE))?.iterations;
    Ok((steps + steps / 4).clamp(1, MOST_BOUNCES))
}
