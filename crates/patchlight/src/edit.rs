//! Edits of a bake: objects that are added, taken away or moved, and meshes that change. Only what the change touches is
//! made anew.

mod difference;

use std::sync::{Arc, Mutex};

use formfactor::{KeptRow, RowEdit, RowKey};
use glam::Vec3;
use patches::{Columns, KeptReceivers, MeshChange, MeshReceivers, PatchKind, PatchMesh, Placing, Zone, test_lights};
use scene::gpu::{BvhNode, Triangle, TriangleUv};
use scene::sampling::hash3;
use scene::{Material, NONE, SKY_BINS, Scene, SceneParts, SurfacePoint, sky_bin};
use transport::{HitCounts, LinearOperator as _, Observer, Phase};

use self::difference::Difference;
use crate::bake::{
    Bake, BakeSettings, RECEIVERS, ReceiverKind, RowKeys, cut_scene, enough_bounces, own_error, receiver_rows,
    sample_params, sampler, taken,
};
use crate::energy::EnergyCheck;
use crate::error::Error;
use crate::form_factors::{ElementRows, FormFactors, HOST};
use crate::observe::{Report, run_phase};

/// Changes the random numbers of what is new.
const EDIT: u32 = 0x6564_6974;
/// Parts of the surface that changed are asked for as if they were larger by this share.
const GROWN: f32 = 1e-3;
/// Balls about what changed, for a quick look whether a ray comes near it.
const MAX_BALLS: usize = 32;
/// Room for receivers where interpolation points see none: one for so many, and at least as many as this.
const ROOM: usize = 8;
const MIN_ROOM: usize = 64;

/// A bake after an edit.
#[derive(Clone)]
pub struct EditedBake {
    /// The bake. It has no operators yet: [`Bake::build_operators`], or the method of a frame, makes them.
    pub bake: Bake,
    /// Number of rays of rows that were traced for it.
    pub traced_rays: u64,
    /// Number of rays that the rows of all elements and receivers have.
    pub all_rays: u64,
}

impl Bake {
    /// The bake of a scene after it was edited: objects were added, taken away, moved, given another mesh or another
    /// reflectance. `scene` is the whole scene as it is now; triangles are known again by their content, whatever their
    /// order. Patches and receivers near the change are made anew, rays that met it, or meet it now, are traced again,
    /// and the rest stays. The result differs from a fresh bake no more than that does from one with another seed.
    ///
    /// Focus and density stay those of the bake. Kinds of patches other than clusters, and receivers other than on the
    /// mesh, are baked anew, as is a scene of which nothing is left.
    ///
    /// # Errors
    /// As [`Bake::build`].
    pub fn edit(&self, scene: &Scene, observer: &dyn Observer) -> Result<EditedBake, Error> {
        if !self.is_editable() {
            return EditedBake::whole(scene, &self.settings, observer);
        }
        let cut = cut_scene(scene, &self.density, &self.settings)?;
        let scene = cut.as_ref().unwrap_or(scene);
        let difference = Difference::new(&self.scene, scene);
        if difference.is_none() {
            return Ok(EditedBake::of(Bake { scene: scene.clone(), ..self.clone() }, 0));
        }
        if difference.same.iter().all(|&t| t == NONE) {
            return EditedBake::whole(scene, &self.settings, observer);
        }
        Edit { before: self, scene, difference }.run(observer)
    }

    /// Returns true if its rows can be made again ray by ray.
    fn is_editable(&self) -> bool {
        let settings = &self.settings;
        settings.patches == PatchKind::Cluster
            && settings.receivers == ReceiverKind::Mesh
            && self.form_factors.element_rows.is_some()
            && self.keys.elements.len() == self.mesh.elements.len()
            && self.keys.receivers.len() == self.receivers.points.len()
    }
}

impl EditedBake {
    fn of(bake: Bake, traced_rays: u64) -> Self {
        let rays = |rows: &HitCounts, parts: usize| (rows.rows() / parts) as u64 * u64::from(rays_of(rows));
        let elements = bake.form_factors.element_rows.as_ref().map_or(0, |rows| rays(rows, 1));
        let all_rays = elements + rays(&bake.receivers.rows, transport::QUADRANTS);
        Self { bake, traced_rays, all_rays }
    }

    /// A fresh bake.
    fn whole(scene: &Scene, settings: &BakeSettings, observer: &dyn Observer) -> Result<Self, Error> {
        let made = Self::of(Bake::build(scene, settings, observer)?, 0);
        Ok(Self { traced_rays: made.all_rays, ..made })
    }
}

/// Number of rays of each row.
fn rays_of(rows: &HitCounts) -> u32 {
    rows.scales().first().map_or(0, |scale| (1.0 / scale).round() as u32)
}

/// An edit under way.
struct Edit<'a> {
    before: &'a Bake,
    scene: &'a Scene,
    difference: Difference,
}

/// Rows of elements after the edit.
struct NewRows {
    form_factors: FormFactors,
    keys: Vec<RowKey>,
    traced: u64,
}

/// What changed, as rays see it.
struct Changed {
    /// All of it; none where nothing did.
    surface: Option<Scene>,
    /// Balls that hold it.
    balls: Vec<(Vec3, f32)>,
    /// Element now of each before.
    columns: Vec<u32>,
}

impl Changed {
    fn new(parts: &[[Vec3; 3]], before: &[u32], elements_before: usize) -> Result<Self, Error> {
        let mut columns = vec![NONE; elements_before];
        for (now, &was) in (0u32..).zip(before).filter(|(_, was)| **was != NONE) {
            columns[was as usize] = now;
        }
        let grown = |&[a, b, c]: &[Vec3; 3]| {
            let middle = (a + b + c) / 3.0;
            let [a, b, c] = [a, b, c].map(|corner| corner + (corner - middle) * GROWN);
            Triangle { corner: a, edge_a: b - a, edge_b: c - a, ..Triangle::default() }
        };
        let has_area = |t: &Triangle| t.edge_a.cross(t.edge_b).length() > 0.0;
        let triangles: Vec<Triangle> = parts.iter().map(grown).filter(has_area).collect();
        let surface = match triangles.is_empty() {
            true => None,
            false => Some(Scene::new(SceneParts {
                uvs: vec![TriangleUv::default(); triangles.len()],
                triangles,
                materials: vec![Material::default()],
                ..SceneParts::default()
            })?),
        };
        let balls = surface.as_ref().map_or_else(Vec::new, |surface| balls(&surface.geometry.nodes));
        Ok(Self { surface, balls, columns })
    }

    fn may_meet(&self, origin: Vec3, direction: Vec3) -> bool {
        self.surface.as_ref().is_some_and(|surface| surface.occluded(origin, direction, f32::INFINITY))
    }
}

/// Balls about the boxes of a hierarchy: the greatest are taken apart, as far as there are few.
fn balls(nodes: &[BvhNode]) -> Vec<(Vec3, f32)> {
    let ball = |node: &BvhNode| (0.5 * (node.min + node.max), 0.5 * (node.max - node.min).length());
    let mut open: Vec<&BvhNode> = nodes.first().into_iter().collect();
    while open.len() < MAX_BALLS {
        let inner = (0..open.len()).filter(|&k| open[k].prim_count == 0);
        let Some(greatest) = inner.max_by(|&a, &b| ball(open[a]).1.total_cmp(&ball(open[b]).1)) else { break };
        let node = open.swap_remove(greatest);
        open.extend(&nodes[node.first_index as usize..node.first_index as usize + 2]);
    }
    open.into_iter().map(ball).collect()
}

impl Edit<'_> {
    fn run(self, observer: &dyn Observer) -> Result<EditedBake, Error> {
        let Self { before, scene, .. } = self;
        let settings = &before.settings;
        let made = run_phase(observer, Phase::SAMPLE, |_| {
            let Some(sampler) = sampler(scene, before.density, settings, &HOST)? else { return Ok(None) };
            let mut zone = self.zone();
            let Difference { same, gone, come } = &self.difference;
            let change = MeshChange { before: &before.scene, same, gone, come };
            let edited = before.mesh.edited(&sampler, &change, &mut zone, settings.seed ^ EDIT)?;
            Ok::<_, Error>(Some((sampler, zone, edited)))
        })?;
        let Some((sampler, zone, edited)) = made else { return EditedBake::whole(scene, settings, observer) };
        let changed = Changed::new(&edited.changed, &edited.before, before.mesh.elements.len())?;
        let rows = run_phase(observer, Phase::FORM_FACTORS, |report| {
            self.element_rows(&edited.mesh, &edited.before, &changed, report)
        })?;
        let bounces = match settings.bounces {
            Some(bounces) => bounces,
            None => run_phase(observer, Phase::BOUNCES, |_| {
                enough_bounces(&rows.form_factors.factors, &edited.mesh.albedo)
            })?,
        };
        let bake = Bake {
            scene: scene.clone(),
            direct: sample_params(scene, &edited.mesh, settings),
            mesh: Arc::new(edited.mesh),
            form_factors: rows.form_factors,
            receivers: MeshReceivers::none(scene)?,
            density: before.density,
            energy: None,
            bounces,
            settings: *settings,
            operators: Vec::new(),
            keys: RowKeys { elements: Arc::new(rows.keys), receivers: Arc::default() },
        };
        let (receivers, keys, traced) =
            run_phase(observer, Phase::RECEIVERS, |report| self.receivers(&bake, &sampler, &zone, &changed, report))?;
        let keys = RowKeys { receivers: Arc::new(keys), ..bake.keys };
        let mut bake = Bake { receivers, keys, ..bake };
        bake.energy = run_phase(observer, Phase::ENERGY, |_| EnergyCheck::of(&bake))?;
        Ok(EditedBake::of(bake, rows.traced + traced))
    }

    /// Places within about an element of surfaces that are gone or have come.
    fn zone(&self) -> Zone {
        let mesh = &self.before.mesh;
        let area = mesh.counted_area(&self.before.density);
        let mut zone = Zone::new((area / mesh.elements.len().max(1) as f64).sqrt() as f32);
        for (scene, marks) in [(&self.before.scene, &self.difference.gone), (self.scene, &self.difference.come)] {
            let triangles = scene.geometry.triangles.iter().zip(marks);
            triangles.filter(|(_, marked)| **marked).for_each(|(triangle, _)| zone.add_triangle(triangle));
        }
        zone
    }

    /// Rows of the elements that stay, with the rays that met a change traced again, and of new ones.
    fn element_rows(
        &self,
        mesh: &PatchMesh,
        numbers: &[u32],
        changed: &Changed,
        report: &Report,
    ) -> Result<NewRows, Error> {
        let Self { before, scene, .. } = self;
        let old = &before.form_factors;
        let old_rows =
            old.element_rows.as_ref().map_or_else(|| HitCounts::new(0).map(Arc::new), |r| Ok(Arc::clone(r)))?;
        let kept: Vec<KeptRow> = (0..mesh.elements.len())
            .filter(|&e| numbers[e] != NONE)
            .map(|e| KeptRow {
                row: numbers[e] as usize,
                key: before.keys.elements[numbers[e] as usize],
                points: &mesh.points[mesh.offsets[e] as usize..mesh.offsets[e + 1] as usize],
            })
            .collect();
        let rays = rays_of(&old_rows);
        let mut rows = HitCounts::new(mesh.elements.len())?;
        let made = self.with_edit(mesh, changed, rays, |edit| edit.add(&old_rows, &kept, &mut rows, None, &report))?;
        let mut keys: Vec<RowKey> = kept.iter().map(|row| row.key).collect();
        let mut sky_factor: Vec<f32> =
            kept.iter().zip(&made.sky_factor).map(|(row, more)| old.sky_factor[row.row] + more).collect();
        // New elements are the last ones.
        let first = mesh.offsets[kept.len()];
        let offsets: Vec<u32> = mesh.offsets[kept.len()..].iter().map(|offset| offset - first).collect();
        let seed = hash3(kept.len() as u32, old_rows.rows() as u32, before.settings.seed ^ EDIT);
        let new = mesh.elements.len() - kept.len();
        if new > 0 {
            let points = &mesh.points[first as usize..];
            let own = ElementRows { scene, mesh, points, offsets: &offsets, rays, seed };
            sky_factor.extend(HOST.add(&mut rows, None, &own, report)?);
        }
        keys.extend((0..new as u32).map(|number| RowKey { seed, number }));
        let patch: Vec<u32> = (0..mesh.elements.len() as u32).map(|element| mesh.patch_of(element)).collect();
        let factors = rows.means(&mesh.patch_elements, &mesh.element_shares(), &patch, mesh.patches.len())?;
        let traced = made.traced + u64::from(rays) * new as u64;
        let form_factors = FormFactors { factors: Arc::new(factors), element_rows: Some(Arc::new(rows)), sky_factor };
        Ok(NewRows { form_factors, keys, traced })
    }

    /// Receivers outside of the zone, with the rays that met a change traced again, and new ones within.
    fn receivers(
        &self,
        bake: &Bake,
        sampler: &patches::LitSampler,
        zone: &Zone,
        changed: &Changed,
        report: &Report,
    ) -> Result<(MeshReceivers, Vec<RowKey>, u64), Error> {
        let before = self.before;
        let old = &before.receivers;
        let rays = rays_of(&old.rows);
        let stays: Vec<usize> = (0..old.points.len()).filter(|&k| !zone.contains(old.points[k].position)).collect();
        let kept: Vec<KeptRow> = stays
            .iter()
            .map(|&k| KeptRow { row: k, key: before.keys.receivers[k], points: std::slice::from_ref(&old.points[k]) })
            .collect();
        let mut rows = HitCounts::new(bake.mesh.elements.len())?;
        let mut sky_rows = HitCounts::new(SKY_BINS)?;
        let sky = Some((&*old.sky_rows, &mut sky_rows, &sky_bin as &formfactor::SkyBin));
        let made =
            self.with_edit(&bake.mesh, changed, rays, |edit| edit.add(&old.rows, &kept, &mut rows, sky, &report))?;
        let keys = Mutex::new(kept.iter().map(|row| row.key).collect());
        let points: Vec<SurfacePoint> = stays.iter().map(|&k| old.points[k]).collect();
        let factors = &bake.form_factors;
        let lights = test_lights(
            &bake.scene,
            &bake.mesh,
            sampler.density(),
            &*factors.factors,
            factors.element_operator(),
            &bake.direct,
        )?;
        let seed = before.settings.seed ^ RECEIVERS;
        let count = old.points.len();
        let placing = Placing { rays, edge: 0.0, most: count + (count / ROOM).max(MIN_ROOM), seed };
        let add = receiver_rows(bake, rays, seed, &HOST, &keys, report);
        let kept = KeptReceivers { points, rows, sky_rows, before: count };
        let receivers = MeshReceivers::place_again(sampler, kept, zone, &placing, &lights, &add).map_err(own_error)?;
        drop(add);
        let keys = taken(keys);
        let traced = made.traced + u64::from(rays) * (receivers.points.len() - stays.len()) as u64;
        Ok((receivers, keys, traced))
    }

    /// Calls `work` with the edit of rows over the elements of a mesh.
    fn with_edit<T>(
        &self,
        mesh: &PatchMesh,
        changed: &Changed,
        rays: u32,
        work: impl FnOnce(&RowEdit) -> Result<T, formfactor::Error>,
    ) -> Result<T, Error> {
        let old = self.before;
        let before = old.mesh.lighting(&old.scene, Columns::Elements, &[], &[0], 0);
        let after = mesh.lighting(self.scene, Columns::Elements, &[], &[0], 0);
        let may_meet = |origin: Vec3, direction: Vec3| changed.may_meet(origin, direction);
        let Changed { balls, columns, .. } = changed;
        let edit = RowEdit { before: &before, after: &after, may_meet: &may_meet, balls, columns, rays };
        Ok(work(&edit)?)
    }
}
