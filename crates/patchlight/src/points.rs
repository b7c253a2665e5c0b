//! Points of one's own: places whose rows are traced once, and whose light every update finds.

use std::collections::VecDeque;
use std::sync::Arc;

use formfactor::add_hit_rows;
use glam::{Vec3, Vec4};
use patches::Columns;
use patches::kernel::volume::{CUBE_SIDES, SH_COEFFICIENTS, cube_to_harmonic};
use runtime::executor::{ExecutorError, ReadId};
use runtime::plan::{BufferId, PassId, Slice};
use runtime::recipe::formfactor::{HitTables, SparseTables, Surfaces};
use runtime::recipe::rgb_bytes;
use scene::{NONE, Rgb, SurfacePoint};
use transport::{Csr, HitCounts, LinearOperator as _, Observer, Phase};

use crate::bake::ReceiverKind;
use crate::error::{Error, Reason};
use crate::light::LightField;
use crate::low_level::frame::FramePlan;
use crate::observe::run_phase;

/// Name of the passes.
pub const PASS: &str = "points";

/// Reads of a set that may be under way.
const MAX_READS: usize = 3;
/// Sides of an ambient cube.
const SIDES: usize = CUBE_SIDES as usize;
/// Normals of the sides, in the order of their values.
const NORMALS: [Vec3; SIDES] = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];

/// A place whose light is asked for, on a surface or in the air.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Position, m.
    pub position: Vec3,
    /// Unit normal, of which [`PointKind::Irradiance`] is; not used by the other kinds.
    pub normal: Vec3,
}

/// Light that is kept of each point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum PointKind {
    /// Irradiance, W/m², for the point's normal: a value a point.
    #[default]
    Irradiance,
    /// An ambient cube: irradiance, W/m², for the normals +x, −x, +y, −y, +z, −z; six values a point.
    Cube,
    /// Radiance, W/m²/sr, as real spherical harmonics of degree 1: L_00, L_1x, L_1y, L_1z; four values a point. The
    /// irradiance for a normal n is `π 0.282095 L_00 + (2π/3) 0.488603 (L_1 · n)` (Ramamoorthi and Hanrahan 2001).
    HarmonicsL1,
}

impl PointKind {
    /// Number of values a point.
    pub fn values(self) -> usize {
        match self {
            Self::Irradiance => 1,
            Self::Cube => SIDES,
            Self::HarmonicsL1 => SH_COEFFICIENTS as usize,
        }
    }
}

/// Points of a light field, of [`LightField::add_points`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[must_use = "the points' light is asked for with it"]
pub struct PointSet(u64);

/// Light of the points of a set.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointLight {
    /// Number of the light update that it is of.
    pub update: u32,
    /// Values of each point, one point after the other, as its kind says.
    pub values: Vec<Vec3>,
}

/// The rows of a set and its part of the plan.
pub(crate) struct PointTables {
    set: PointSet,
    kind: PointKind,
    /// Where they are, and the rays of each hemisphere: another bake asks for their rows anew.
    places: Vec<Point>,
    rays: u32,
    rows: Arc<HitCounts>,
    buffer: Option<BufferId>,
    /// The passes that find its light.
    pub passes: Vec<PassId>,
    /// Set by the first call that reads: from then on each update begins to.
    is_read: bool,
    reads: VecDeque<(u32, ReadId)>,
    latest: Option<PointLight>,
}

impl PointTables {
    /// Bytes of the rows and of the values.
    pub fn bytes(&self) -> u64 {
        self.rows.bytes() + rgb_bytes(self.places.len() * self.kind.values())
    }

    /// Adds the set's passes to a section of their own.
    ///
    /// # Errors
    /// What the plan says.
    pub fn add(&mut self, frame: &mut FramePlan) -> Result<(), Error> {
        let first = frame.plan.passes().len();
        let exitance = exitance_of(frame)?;
        let range = frame.binding_bytes();
        let count = self.places.len();
        let values = frame.plan.array("points", count * self.kind.values());
        let rows = HitTables::new(&mut frame.plan, &mut frame.tables, &self.rows);
        if self.kind == PointKind::HarmonicsL1 {
            let cubes = frame.plan.array("point cubes", count * SIDES);
            rows.gather(&mut frame.plan, PASS, range, exitance, cubes)?;
            let harmonics = Arc::new(harmonics_of_cubes(count));
            let harmonics = SparseTables::new(&mut frame.plan, &mut frame.tables, "harmonic", &harmonics);
            harmonics.gather(&mut frame.plan, PASS, cubes, values)?;
        } else {
            rows.gather(&mut frame.plan, PASS, range, exitance, values)?;
        }
        self.buffer = Some(values.buffer);
        self.passes = frame.plan.all_passes().split_off(first);
        Ok(())
    }
}

/// The exitance that points gather: of the elements, or of the patches where they are the receivers.
fn exitance_of(frame: &mut FramePlan) -> Result<Slice<Rgb>, ExecutorError> {
    if frame.bake.settings.receivers != ReceiverKind::Patches {
        return Ok(frame.elements.exitance);
    }
    // The method leaves the exitance of the bounce before.
    let exitance = frame.plan.array("point exitance", frame.patches.count as usize);
    Surfaces { exitance, ..frame.patches }.bounce(&mut frame.plan, PASS)?;
    Ok(exitance)
}

/// Coefficients of [`cube_to_harmonic`] as a matrix from the values of so many cubes.
fn harmonics_of_cubes(count: usize) -> Csr {
    let coefficients = SH_COEFFICIENTS as usize;
    let columns = count * SIDES;
    let mut csr = Csr { rows: 0, columns, row_start: vec![0], column_index: Vec::new(), values: Vec::new() };
    // The matrix of one cube, side by side, from cubes with one side alight.
    let mut of_one = [[0.0; SIDES]; SH_COEFFICIENTS as usize];
    for side in 0..SIDES {
        let mut cube = [Vec4::ZERO; SIDES];
        cube[side] = Vec4::ONE;
        for (k, row) in (0u32..).zip(&mut of_one) {
            row[side] = cube_to_harmonic(&cube, 0, k).x;
        }
    }
    for point in 0..count {
        for row in &of_one {
            for (side, &value) in row.iter().enumerate().filter(|(_, value)| **value != 0.0) {
                csr.column_index.push((point * SIDES + side) as u32);
                csr.values.push(value);
            }
            csr.row_start.push(csr.values.len() as u32);
        }
    }
    csr.rows = count * coefficients;
    csr
}

impl LightField {
    /// Adds points whose indirect light each update finds from now on, on the device: light that was reflected at least
    /// once. Their rows over the elements are traced here, once, with [`crate::LightSettings::point_rays`] rays a
    /// hemisphere; an update is one product with them. Points may lie on surfaces or in the air; inside of solids they
    /// are dark. Under a light that is found already, theirs is found at once.
    ///
    /// # Errors
    /// [`Unsupported`](crate::ErrorKind::Unsupported) for a scene with a medium: rays of form factors know nothing of a
    /// medium; a position or a normal that is not finite; a device that is too small; cancellation. Nothing is added
    /// then.
    pub fn add_points(
        &mut self,
        points: &[Point],
        kind: PointKind,
        observer: &dyn Observer,
    ) -> Result<PointSet, Error> {
        let rays = self.settings().point_rays;
        self.add_points_by_rays(points, kind, rays, observer)
    }

    /// As [`Self::add_points`], with so many rays.
    pub(crate) fn add_points_by_rays(
        &mut self,
        points: &[Point],
        kind: PointKind,
        rays: u32,
        observer: &dyn Observer,
    ) -> Result<PointSet, Error> {
        if self.bake().scene.has_medium() {
            return Err(Reason::Medium { what: "the light of points" }.into());
        }
        check(points, kind)?;
        let rows = self.trace(points, kind, rays, observer)?;
        let set = PointSet(self.point_sets);
        self.point_sets += 1;
        let tables = PointTables {
            set,
            kind,
            places: points.to_vec(),
            rays,
            rows: Arc::new(rows),
            buffer: None,
            passes: Vec::new(),
            is_read: false,
            reads: VecDeque::new(),
            latest: None,
        };
        self.points.push(tables);
        let last = self.points.len() - 1;
        if let Err(error) = self.load_points(last) {
            self.points.pop();
            return Err(error);
        }
        Ok(set)
    }

    /// Removes points; other sets stay as they are. Points that are gone already are no error.
    ///
    /// # Errors
    /// What the device says.
    pub fn remove_points(&mut self, set: PointSet) -> Result<(), Error> {
        let Some(index) = self.points.iter().position(|points| points.set == set) else { return Ok(()) };
        self.points.remove(index);
        self.load_points(index)
    }

    /// Device buffer with the light of points: a `Vec4` a value, RGB and an unused component. Another buffer after the
    /// calls that change those of [`Self::buffers`], and after [`Self::remove_points`]. `None` for points that were
    /// removed.
    pub fn point_buffer(&self, set: PointSet) -> Option<BufferId> {
        self.points.iter().find(|points| points.set == set)?.buffer
    }

    /// The newest light of points that has arrived on the host; waits for nothing. From the first call on, each update
    /// begins a copy; on a device, light arrives one or two updates later. `None` before the first, and for points that
    /// were removed.
    ///
    /// # Errors
    /// What the device says.
    pub fn try_read(&mut self, set: PointSet) -> Result<Option<&PointLight>, Error> {
        let is_lit = self.is_lit();
        let number = self.last_update();
        let Some(index) = self.points.iter().position(|points| points.set == set) else { return Ok(None) };
        if !self.points[index].is_read {
            self.points[index].is_read = true;
            if is_lit {
                self.begin_read(index, number)?;
            }
        }
        self.take_reads(index)?;
        Ok(self.points[index].latest.as_ref())
    }

    /// The light of points of the last update; waits for it.
    ///
    /// # Errors
    /// What the device says; [`transport::Error::Setting`] before the first update, and for points that were removed.
    pub fn read(&mut self, set: PointSet) -> Result<PointLight, Error> {
        let buffer = self.point_buffer(set).filter(|_| self.is_lit());
        let Some(buffer) = buffer else {
            let rule = "of this light field, after its first update";
            return Err(transport::Error::Setting { name: "point set", value: set.0 as f64, rule }.into());
        };
        let values = self.download(buffer)?.iter().map(|value| value.truncate()).collect();
        Ok(PointLight { update: self.last_update(), values })
    }

    /// Begins to read the light of an update, where somebody reads and the light `is_new`; called by each update.
    pub(crate) fn read_points(&mut self, number: u32, is_new: bool) -> Result<(), Error> {
        for index in 0..self.points.len() {
            if self.points[index].is_read && is_new {
                self.take_reads(index)?;
                self.begin_read(index, number)?;
            }
        }
        Ok(())
    }

    fn begin_read(&mut self, index: usize, number: u32) -> Result<(), Error> {
        let points = &self.points[index];
        let Some(buffer) = points.buffer.filter(|_| points.reads.len() < MAX_READS) else { return Ok(()) };
        let executor = self.executor_mut();
        if executor.is_recording() {
            // The caller submits the update; a read would come before it.
            return Ok(());
        }
        let read = executor.begin_read(buffer)?;
        self.points[index].reads.push_back((number, read));
        Ok(())
    }

    /// Takes what has arrived of a set.
    fn take_reads(&mut self, index: usize) -> Result<(), Error> {
        while let Some(&(update, read)) = self.points[index].reads.front() {
            let Some(bytes) = self.executor_mut().try_read(read)? else { return Ok(()) };
            let values: Vec<Vec4> = bytemuck::pod_collect_to_vec(&bytes);
            let points = &mut self.points[index];
            points.reads.pop_front();
            points.latest = Some(PointLight { update, values: values.iter().map(|value| value.truncate()).collect() });
        }
        Ok(())
    }

    /// Traces the rows of all points in the bake that the light field has now; what was read of them goes.
    pub(crate) fn trace_points_again(&mut self, observer: &dyn Observer) -> Result<(), Error> {
        for index in 0..self.points.len() {
            let PointTables { places, kind, rays, .. } = &self.points[index];
            let rows = self.trace(places, *kind, *rays, observer)?;
            let points = &mut self.points[index];
            points.rows = Arc::new(rows);
            points.reads.clear();
        }
        Ok(())
    }

    /// Loads the sections of the sets from number `first` on, and finds their light where there is one.
    fn load_points(&mut self, first: usize) -> Result<(), Error> {
        self.note_sections_lost();
        let mut sets = self.points.split_off(first);
        let mut outcome = Ok(());
        for mut set in sets.drain(..) {
            let section = 1 + self.points.len();
            if outcome.is_ok() {
                outcome = self.load_section(section, |frame, _| set.add(frame));
            }
            self.points.push(set);
        }
        if first == self.points.len() {
            outcome = self.unload_section(1 + first);
        }
        outcome?;
        if self.is_lit() {
            let passes: Vec<PassId> = self.points[first..].iter().flat_map(|set| set.passes.clone()).collect();
            self.executor_mut().submit_passes(&passes)?;
        }
        Ok(())
    }

    /// Traces the rows of points over the elements, or over the patches where they are the receivers.
    fn trace(&self, points: &[Point], kind: PointKind, rays: u32, observer: &dyn Observer) -> Result<HitCounts, Error> {
        let bake = self.bake();
        let columns = match bake.settings.receivers {
            ReceiverKind::Patches => Columns::Patches,
            ReceiverKind::Mesh | ReceiverKind::Pixels => Columns::Elements,
        };
        let count = match columns {
            Columns::Patches => bake.mesh.patches.len(),
            Columns::Elements => bake.mesh.elements.len(),
        };
        let at = |position: Vec3, normal: Vec3| SurfacePoint { position, patch: NONE, normal, weight: 1.0 };
        let places: Vec<SurfacePoint> = match kind {
            PointKind::Irradiance => points.iter().map(|point| at(point.position, point.normal)).collect(),
            PointKind::Cube | PointKind::HarmonicsL1 => {
                points.iter().flat_map(|point| NORMALS.map(|normal| at(point.position, normal))).collect()
            }
        };
        let offsets: Vec<u32> = (0..=places.len() as u32).collect();
        let seed = bake.settings.seed ^ 0x706f_696e;
        let surfaces = bake.mesh.lighting(&bake.scene, columns, &places, &offsets, seed);
        let mut rows = HitCounts::new(count)?;
        run_phase(observer, Phase("points"), |report| add_hit_rows(&mut rows, &surfaces, rays, &report))?;
        Ok(rows)
    }
}

fn check(points: &[Point], kind: PointKind) -> Result<(), Error> {
    let is_wrong = |point: &Point| match kind {
        PointKind::Irradiance => !point.position.is_finite() || !point.normal.is_normalized(),
        PointKind::Cube | PointKind::HarmonicsL1 => !point.position.is_finite(),
    };
    match points.iter().position(is_wrong) {
        Some(index) => {
            Err(Reason::PointValue { index, position: points[index].position, normal: points[index].normal }.into())
        }
        None => Ok(()),
    }
}
