//! Objects that move through a baked scene: they receive light, throw shadows, take indirect light away behind them and
//! send what they reflect.
//!
//! A bake knows nothing of them. Each has points that rays are traced from where it stands, and elements that send;
//! rows of the elements and receivers about it are changed where it is in the way. All of it follows from where the
//! objects stand, and from nothing before. Their light takes part in all bounces: with ΔF, what an object changes of the
//! form factors, `B = E + ρ (F + ΔF) B` is solved by the method for the first exitance `E + ρ ΔF B`, in a few rounds.

pub(crate) mod rows;
pub(crate) mod shape;

use std::sync::Arc;

use glam::{Affine3A, Vec3, Vec4};
use patches::InterpolationMesh;
use rayon::prelude::*;
use runtime::plan::RANGE_ALIGNMENT;
use scene::{Geometry, Mesh, MovingMesh, Scene, SurfacePoint};
use transport::kernel::hits::COUNT_STEP;
use transport::{Csr, Patch, add_up, quad_columns};

use self::rows::{Ball, Movers, RowChange};
use self::shape::Shape;
use crate::bake::{Bake, ReceiverKind};
use crate::error::{Error, Reason};
use crate::light::LightField;
use crate::method::MethodSettings;

/// RGB values between places where a range of a buffer may begin.
const RANGE_STEP: usize = RANGE_ALIGNMENT as usize / size_of::<Vec4>();
/// Room for changed form factors, at least.
const MIN_FACTORS: usize = 1 << 16;
/// Changes the random numbers of the rays of objects.
const SALT: u32 = 0x6f62_6a73;

/// An object of a light field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ObjectId(u64);

/// An object.
#[derive(Clone)]
struct Object {
    id: ObjectId,
    mesh: Arc<MovingMesh>,
    shape: Arc<Shape>,
    transform: Affine3A,
}

/// The objects of a light field, with what follows from where they stand.
#[derive(Clone, Default)]
pub(crate) struct ObjectTables {
    objects: Vec<Object>,
    count: u64,
    /// Rays of the hemisphere of a point.
    pub rays: u32,
    /// True if an object is not where the tables say.
    is_moved: bool,
    /// The geometry of the frame before the last: its tables are written again.
    spare: Option<Arc<Geometry>>,
    /// Places above the middles of the elements of the bake; none until they are asked for.
    middles: Arc<[Vec3]>,
    /// Entries of changed form factors that there is room for.
    pub factor_room: usize,
    /// Rows that change.
    pub element_changes: Vec<RowChange>,
    pub receiver_changes: Vec<RowChange>,
}

/// What points of objects receive, where they stand now.
pub(crate) struct Placed {
    pub points: Vec<SurfacePoint>,
    /// Rows over elements, and over the bins of the sky.
    pub rows: [Csr; 2],
    /// The rows over elements with those of each patch taken together.
    pub patch_rows: Csr,
    pub albedo: Vec<Vec4>,
    /// What the objects change of the form factors between patches, and from their elements.
    pub factors: Csr,
}

impl ObjectTables {
    /// No objects, with so many rays of each hemisphere of a point.
    pub fn new(rays: u32) -> Self {
        Self { rays, factor_room: MIN_FACTORS, ..Self::default() }
    }

    /// Number of points of all objects.
    pub fn points(&self) -> usize {
        self.objects.iter().map(|object| object.shape.points()).sum()
    }

    /// Number of elements of all objects.
    pub fn elements(&self) -> usize {
        self.objects.iter().map(|object| object.shape.elements()).sum()
    }

    /// Column of the first element of an object, behind the elements of a bake: where a range of a buffer may begin.
    pub fn first_column(bake: &Bake) -> usize {
        bake.mesh.elements.len().next_multiple_of(RANGE_STEP)
    }

    /// Number of the first point of an object, behind the interpolation points of a bake.
    pub fn first_point(bake: &Bake) -> usize {
        bake.receivers.interpolation.points.len().next_multiple_of(RANGE_STEP)
    }

    /// Column of the first element of an object, behind the patches of a bake.
    pub fn first_patch_column(&self, bake: &Bake) -> usize {
        bake.mesh.patches.len().next_multiple_of(RANGE_STEP)
    }

    pub fn is_empty(&self) -> bool {
        self.objects.is_empty()
    }

    pub fn is_moved(&self) -> bool {
        self.is_moved
    }

    /// The tables ask to be made again.
    pub fn set_moved(&mut self) {
        self.is_moved = true;
    }

    fn transforms(&self) -> Vec<Affine3A> {
        self.objects.iter().map(|object| object.transform).collect()
    }

    /// Mean of the points of each element.
    pub fn means(&self) -> Result<Csr, Error> {
        let mut rows = Vec::with_capacity(self.elements());
        let mut first = 0;
        for object in &self.objects {
            for points in object.shape.element_points() {
                let share = 1.0 / points.len() as f32;
                rows.push(points.iter().map(|&point| (first + point, share)).collect());
            }
            first += object.shape.points() as u32;
        }
        Ok(Csr::from_rows(first as usize, &rows)?)
    }

    /// Interpolation mesh with the triangles of the objects, whose points follow those of the bake.
    pub fn interpolation(&self, bake: &Bake) -> InterpolationMesh {
        let mut mesh = (*bake.receivers.interpolation).clone();
        let mut first = Self::first_point(bake) as u32;
        mesh.points = Vec::new();
        for object in &self.objects {
            object.shape.add_to(&mut mesh.grids, &mut mesh.cells, &mut mesh.vertices, first);
            first += object.shape.points() as u32;
        }
        mesh
    }

    /// Scene of a bake with the objects in their places.
    pub fn scene(&self, bake: &Bake) -> Result<Scene, Error> {
        let mut scene = bake.scene.clone();
        if !self.is_empty() {
            let meshes: Vec<_> = self.objects.iter().map(|object| Arc::clone(&object.mesh)).collect();
            scene.set_moved(Arc::new(scene.geometry.with_moving(&meshes, &self.transforms())?));
        }
        Ok(scene)
    }

    /// Moves the objects of the geometry of [`Self::scene`].
    pub fn place(&mut self, geometry: &Arc<Geometry>) -> Result<Arc<Geometry>, Error> {
        let mut moved = self.spare.take().unwrap_or_else(|| Arc::clone(geometry));
        Arc::make_mut(&mut moved).place(&self.transforms())?;
        self.spare = Some(Arc::clone(geometry));
        Ok(moved)
    }

    /// The geometry is another one.
    pub fn forget(&mut self) {
        self.spare = None;
        // They are of the rows of another bake, or of other objects.
        self.element_changes.clear();
        self.receiver_changes.clear();
        self.middles = Arc::default();
    }

    /// Finds the rows of where the objects are in a scene.
    pub fn find(&mut self, bake: &Bake, scene: &Scene) -> Result<Placed, Error> {
        let geometry = &*scene.geometry;
        let mut first = geometry.moving().start;
        let mut balls = Vec::with_capacity(self.objects.len());
        for object in &self.objects {
            let own = first..first + object.shape.elements();
            first = own.end;
            balls.push(Ball::of(geometry, own, &object.transform));
        }
        let mesh = &bake.mesh;
        if self.middles.len() != mesh.elements.len() {
            let above = |element: &Patch| element.centroid + element.normal * geometry.ray_offset;
            self.middles = mesh.elements.iter().map(above).collect();
        }
        let movers = Movers {
            geometry,
            balls: &balls,
            elements: &mesh.elements,
            middles: &self.middles,
            first_column: Self::first_column(bake) as u32,
        };
        if let Some(rows) = &bake.form_factors.element_rows {
            self.element_changes = movers.element_changes(rows);
        }
        let receivers = &bake.receivers;
        self.receiver_changes = movers.receiver_changes(&receivers.points, &receivers.rows, &receivers.sky_rows);
        let points: Vec<SurfacePoint> =
            self.objects.iter().flat_map(|object| object.shape.placed(&object.transform)).collect();
        let rows = movers.traced(bake, &points, self.rays, bake.settings.seed ^ SALT)?;
        self.is_moved = false;
        let factors = self.changed_factors(bake)?;
        let patch_rows = self.patch_rows(bake, &rows[0])?;
        Ok(Placed { points, rows, patch_rows, albedo: albedo_of(scene), factors })
    }

    /// Rows over patches and elements of objects of rows over elements.
    fn patch_rows(&self, bake: &Bake, rows: &Csr) -> Result<Csr, Error> {
        let mesh = &bake.mesh;
        let first = self.first_patch_column(bake) as u32;
        let first_column = Self::first_column(bake) as u32;
        let owner = |column: u32| match column.checked_sub(first_column) {
            Some(moving) => first + moving,
            None => mesh.patch_of(column),
        };
        let row = |own: &[u32]| {
            let own = own[0] as usize..own[1] as usize;
            let columns = rows.column_index[own.clone()].iter().map(|&column| owner(column));
            let mut entries: Vec<(u32, f32)> = columns.zip(rows.values[own].iter().copied()).collect();
            add_up(&mut entries);
            entries
        };
        let own: Vec<Vec<(u32, f32)>> = rows.row_start.par_windows(2).map(row).collect();
        Ok(Csr::from_rows(first as usize + self.elements(), &own)?)
    }

    /// Change of the form factors of patches, row by row: the changes of their elements' rows, taken together.
    fn changed_factors(&self, bake: &Bake) -> Result<Csr, Error> {
        let mesh = &bake.mesh;
        let count = mesh.patches.len();
        let first = self.first_patch_column(bake);
        let columns = first + self.elements();
        let Some(rows) = &bake.form_factors.element_rows else {
            return Ok(Csr::from_rows(columns, &vec![Vec::new(); count])?);
        };
        let shares = mesh.element_shares();
        let first_column = Self::first_column(bake) as u32;
        let change_of = |change: &RowChange| {
            let element = change.item as usize;
            let share = shares[element] * rows.scales()[element] * COUNT_STEP;
            let mut entries = Vec::new();
            for &(number, quad) in &change.quads {
                let before = quad_columns(rows.quads()[number as usize]);
                let factor = share * f32::from(rows.counts()[number as usize]);
                for (column, now) in before.into_iter().zip(quad_columns(quad)).filter(|(column, now)| column != now) {
                    entries.push((mesh.patch_of(column), -factor));
                    entries.push((now - first_column + first as u32, factor));
                }
            }
            (mesh.patch_of(change.item), entries)
        };
        let changes: Vec<(u32, Vec<(u32, f32)>)> = self.element_changes.par_iter().map(change_of).collect();
        let mut own: Vec<Vec<(u32, f32)>> = vec![Vec::new(); count];
        // In the order of the elements.
        changes.into_iter().for_each(|(patch, entries)| own[patch as usize].extend(entries));
        own.par_iter_mut().for_each(add_up);
        Ok(Csr::from_rows(columns, &own)?)
    }
}

/// Mean albedo of each moving triangle.
fn albedo_of(scene: &Scene) -> Vec<Vec4> {
    let geometry = &scene.geometry;
    let albedo = |triangle: usize| {
        let t = &geometry.triangles[triangle];
        let area = 0.5 * t.edge_a.cross(t.edge_b).length();
        let middle = t.corner + (t.edge_a + t.edge_b) / 3.0;
        scene.filtered_albedo(triangle as u32, middle, area).extend(0.0)
    };
    geometry.moving().map(albedo).collect()
}

/// The objects of a light field: [`LightField::objects`].
pub struct Objects<'a> {
    light: &'a mut LightField,
}

impl LightField {
    /// Objects that move through the baked scene, to add, move and remove. They throw shadows of direct light, receive
    /// light, take indirect light away from what is behind them and send what they reflect, with all bounces; where
    /// they cover less than 1 / 500 of a hemisphere they are left out. An update after a move finds all of it anew: with
    /// methods that begin anew with each light it depends on where the objects stand alone. Receivers must be on the
    /// mesh. Photons know nothing of objects; methods that find the irradiance of elements or receivers themselves (the
    /// local matrix) leave it as it is without them.
    ///
    /// ```
    /// # extern crate assets as patchlight_assets;
    /// use patchlight::glam::{Affine3A, Vec3};
    /// use patchlight::{Bake, BakeSettings, Cpu, LightField, LightSettings, Mesh, Silent};
    ///
    /// let loaded = patchlight_assets::load_or_build("cornell")?;
    /// let settings = BakeSettings::default().with_patch_count(100).with_receiver_density(0.2);
    /// let bake = Bake::build(&loaded.scene, &settings, &Silent)?;
    /// let mut light = LightField::new(bake.into(), Box::new(Cpu::new()), &LightSettings::default(), &Silent)?;
    /// // A pyramid of 6 cm that climbs.
    /// let positions = [Vec3::ZERO, Vec3::X * 0.06, Vec3::Z * 0.06, Vec3::Y * 0.06];
    /// let indices = [0, 1, 2, 0, 3, 1, 0, 2, 3, 1, 3, 2];
    /// let mesh = Mesh { positions: &positions, indices: &indices, ..Mesh::default() };
    /// let place = |height: f32| Affine3A::from_translation(Vec3::new(0.3, height, 0.1));
    /// let id = light.objects().insert(&mesh, place(0.01))?;
    /// light.update(&loaded.scene.lighting)?;
    /// let before = light.surface_irradiance()?;
    /// light.objects().set_transform(id, place(0.2))?;
    /// light.update(&loaded.scene.lighting)?;
    /// assert!(light.surface_irradiance()? != before);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn objects(&mut self) -> Objects<'_> {
        Objects { light: self }
    }
}

impl Objects<'_> {
    /// Adds a mesh of one of the scene's materials ([`scene::MaterialId::of_scene`]); its own transform comes before
    /// `transform`. Triangles reflect and receive on their front sides: meshes are closed. Each
    /// is an element, so a few hundred are best. The plan of the light is made anew.
    ///
    /// # Errors
    /// A faulty mesh or transform; [`Unsupported`](crate::ErrorKind::Unsupported) where the bake, the method or the
    /// medium of the scene serves no objects; a device that is too small. Nothing is added then.
    pub fn insert(&mut self, mesh: &Mesh, transform: Affine3A) -> Result<ObjectId, Error> {
        let light = &mut *self.light;
        check_bake(light.bake())?;
        if matches!(light.settings().method, MethodSettings::FirstShot(_)) {
            return Err(Reason::Objects { what: "the method firstshot" }.into());
        }
        check_transform(&transform)?;
        let own = MovingMesh::new(mesh, light.scene().materials.len()).map_err(Reason::ObjectMesh)?;
        let shape = Shape::new(&own);
        let mut objects = light.object_tables().clone();
        let id = ObjectId(objects.count);
        objects.count += 1;
        objects.objects.push(Object { id, mesh: Arc::new(own), shape: Arc::new(shape), transform });
        light.set_object_tables(objects)?;
        Ok(id)
    }

    /// Moves an object, from the next update on. Returns false for one that was removed.
    ///
    /// # Errors
    /// A transform that is not finite or flattens.
    pub fn set_transform(&mut self, id: ObjectId, transform: Affine3A) -> Result<bool, Error> {
        check_transform(&transform)?;
        let tables = self.light.object_tables_mut();
        let Some(object) = tables.objects.iter_mut().find(|object| object.id == id) else { return Ok(false) };
        if object.transform != transform {
            object.transform = transform;
            tables.is_moved = true;
        }
        Ok(true)
    }

    /// Place of an object; `None` for one that was removed.
    pub fn transform(&self, id: ObjectId) -> Option<Affine3A> {
        self.light.object_tables().objects.iter().find(|object| object.id == id).map(|object| object.transform)
    }

    /// Removes an object; the plan of the light is made anew. One that is gone already is no error.
    ///
    /// # Errors
    /// What the device says.
    pub fn remove(&mut self, id: ObjectId) -> Result<(), Error> {
        let mut objects = self.light.object_tables().clone();
        let before = objects.objects.len();
        objects.objects.retain(|object| object.id != id);
        match objects.objects.len() == before {
            true => Ok(()),
            false => self.light.set_object_tables(objects),
        }
    }

    /// The objects, in the order in which they were added.
    pub fn ids(&self) -> Vec<ObjectId> {
        self.light.object_tables().objects.iter().map(|object| object.id).collect()
    }
}

/// Refuses bakes that serve no objects.
pub(crate) fn check_bake(bake: &Bake) -> Result<(), Error> {
    if bake.scene.has_medium() {
        return Err(Reason::Medium { what: "the light of objects" }.into());
    }
    if bake.settings.receivers != ReceiverKind::Mesh || bake.receivers.points.is_empty() {
        return Err(Reason::ObjectReceivers.into());
    }
    Ok(())
}

fn check_transform(transform: &Affine3A) -> Result<(), Error> {
    let determinant = transform.matrix3.determinant();
    match transform.is_finite() && determinant.is_normal() && determinant > 0.0 {
        true => Ok(()),
        false => Err(Reason::ObjectTransform { translation: transform.translation.into(), determinant }.into()),
    }
}
