//! Scenes from arrays and from files, and rays in them.

use assets::import::View;
use assets::procedural;
use formfactor::sparse_rows;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use patchlight::glam::Vec3;
use patchlight::rayon::prelude::*;
use patchlight::scene::gpu::DirectParams;
use patchlight::scene::kernel::bvh::FAR;
use patchlight::scene::sampling::{cosine_hemisphere, hammersley, hash3};
use patchlight::scene::{Camera, NONE, SurfacePoint, Visibility as _};
use patchlight::transport::Csr;
use patchlight::{Material, Mesh, Radiance};
use pyo3::prelude::*;

use crate::arrays::{CsrParts, from_csr, from_vectors, numbers, triples, vectors};
use crate::error::{FileError, input};
use crate::lights::{Light, Sky, lighting, of_lighting};
use crate::work::{Watcher, run, warn};

/// Azimuths of the rows of Tregenza's sky.
const TREGENZA: [u32; 8] = [30, 30, 24, 24, 18, 12, 6, 1];
/// Rows of points that are traced together.
const ROWS: usize = 64;

/// A scene; `patchlight.Scene` documents it.
#[pyclass(frozen, module = "patchlight._core")]
pub struct Scene {
    pub scene: patchlight::Scene,
    pub name: String,
    view: Option<View>,
    /// Face of each triangle, in the order in which the triangles were given to the builder; empty of a scene from a file.
    faces: Vec<u32>,
    materials: Vec<String>,
    exposure: Option<f32>,
    pub hash: [u8; 32],
}

impl Scene {
    /// A scene without a view of its own, as a bake has it.
    pub fn of(scene: patchlight::Scene, name: String, hash: [u8; 32]) -> Self {
        Self { scene, name, view: None, faces: Vec::new(), materials: Vec::new(), exposure: None, hash }
    }

    /// The scene under other lights.
    pub fn under(
        &self,
        lights: &[PyRef<'_, Light>],
        sky: Option<&Sky>,
        emission: Option<&[Vec3]>,
    ) -> PyResult<patchlight::Scene> {
        let emission = emission.unwrap_or(&self.scene.lighting.emission);
        let mut scene = self.scene.clone();
        scene.set_lighting(lighting(lights, sky, emission)).map_err(input)?;
        Ok(scene)
    }
}

#[pymethods]
impl Scene {
    /// A scene from arrays: vertices `(n, 3)`, faces `(m, 3)`, the material of each face, and reflectance and emitted
    /// radiance of each material `(k, 3)`.
    #[staticmethod]
    #[pyo3(signature = (vertices, faces, face_material, reflectance, emission, normals, name))]
    fn from_arrays(
        py: Python<'_>,
        vertices: PyReadonlyArray2<f32>,
        faces: PyReadonlyArray2<u32>,
        face_material: PyReadonlyArray1<u32>,
        reflectance: PyReadonlyArray2<f32>,
        emission: PyReadonlyArray2<f32>,
        normals: Option<PyReadonlyArray2<f32>>,
        name: &str,
    ) -> PyResult<Self> {
        let positions = vectors(&vertices, "vertices")?;
        let corners = triples(&faces, "faces")?;
        let face_material = numbers(&face_material, "materials")?;
        let reflectance = vectors(&reflectance, "reflectance")?;
        let emission = vectors(&emission, "emission")?;
        let normals = normals.as_ref().map(|normals| vectors(normals, "normals")).transpose()?.unwrap_or(&[]);
        let mut by_material: Vec<Vec<u32>> = vec![Vec::new(); reflectance.len()];
        let mut flat = Vec::new();
        for (face, (corners, &material)) in (0u32..).zip(corners.iter().zip(face_material)) {
            if let Some(&vertex) = corners.iter().find(|&&vertex| vertex as usize >= positions.len()) {
                return Err(input(format!("face {face} has vertex {vertex} of {}", positions.len())));
            }
            let [a, b, c] = corners.map(|vertex| positions[vertex as usize]);
            match by_material.get_mut(material as usize) {
                _ if (b - a).cross(c - a) == Vec3::ZERO => flat.push(face),
                Some(own) => own.push(face),
                None => return Err(input(format!("face {face} has material {material} of {}", reflectance.len()))),
            }
        }
        if let Some(first) = flat.first() {
            warn(py, &format!("{} face(s) without area were left out; the first is face {first}", flat.len()))?;
        }
        let mut builder = patchlight::Scene::builder();
        let mut order = Vec::new();
        for (own, (&albedo, &radiance)) in by_material.iter().zip(reflectance.iter().zip(emission)) {
            let material = builder.add_material(Material::diffuse(albedo).with_emission(Radiance(radiance)));
            let indices: Vec<u32> = own.iter().flat_map(|&face| corners[face as usize]).collect();
            order.extend_from_slice(own);
            if !indices.is_empty() {
                builder.add_mesh(Mesh { name, positions, indices: &indices, normals, material, ..Mesh::default() });
            }
        }
        let scene = py.detach(|| builder.build()).map_err(input)?;
        Ok(Self {
            scene,
            name: name.to_owned(),
            view: None,
            faces: order,
            materials: Vec::new(),
            exposure: None,
            hash: [0; 32],
        })
    }

    /// A scene from a file, or a built-in one.
    #[staticmethod]
    fn load(py: Python<'_>, path: &str) -> PyResult<Self> {
        let loaded =
            py.detach(|| assets::load_or_build(path)).map_err(|error| FileError::new_err(error.to_string()))?;
        for text in &loaded.warnings {
            warn(py, text)?;
        }
        let exposure = loaded.is_exposed.then_some(loaded.exposure_stops);
        Ok(Self {
            faces: Vec::new(),
            scene: loaded.scene,
            name: loaded.name,
            view: Some(loaded.view),
            materials: loaded.materials,
            exposure,
            hash: loaded.content_hash,
        })
    }

    /// The scene under other lights, with its own emission.
    #[pyo3(name = "under", signature = (lights, sky))]
    fn with_lights(&self, lights: Vec<PyRef<'_, Light>>, sky: Option<PyRef<'_, Sky>>) -> PyResult<Self> {
        let scene = self.under(&lights, sky.as_deref(), None)?;
        Ok(Self {
            scene,
            name: self.name.clone(),
            view: None,
            faces: self.faces.clone(),
            materials: self.materials.clone(),
            exposure: self.exposure,
            hash: self.hash,
        })
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    #[getter]
    fn exposure(&self) -> Option<f32> {
        self.exposure
    }

    #[getter]
    fn material_names(&self) -> Vec<String> {
        self.materials.clone()
    }

    #[getter]
    fn triangle_count(&self) -> usize {
        self.scene.geometry.triangles.len()
    }

    /// Corners of the triangles, `(triangles, 9)`.
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let corners: Vec<Vec3> = self
            .scene
            .geometry
            .triangles
            .iter()
            .flat_map(|t| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b])
            .collect();
        use numpy::PyArrayMethods as _;
        from_vectors(py, &corners)?.reshape([corners.len() / 3, 9])
    }

    /// Number of each triangle among those that were given to the builder, or that the file has; parts of one that was cut
    /// have its number.
    fn triangle_sources<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        PyArray1::from_iter(py, self.scene.geometry.triangles.iter().map(|t| t.source))
    }

    /// Face of each triangle that was given to the builder, in its order; empty of a scene from a file.
    fn face_order<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        PyArray1::from_slice(py, &self.faces)
    }

    /// Material of each triangle.
    fn triangle_materials<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        PyArray1::from_iter(py, self.scene.geometry.triangles.iter().map(|t| t.material))
    }

    /// Reflectance and emitted radiance of each material.
    fn materials<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<f32>>)> {
        let albedo: Vec<Vec3> = self.scene.materials.iter().map(|material| material.albedo).collect();
        let radiance: Vec<Vec3> = self.scene.materials.iter().map(|material| material.radiance).collect();
        Ok((from_vectors(py, &albedo)?, from_vectors(py, &radiance)?))
    }

    /// Eye, target, up, m, and vertical field of view, degrees; none of a scene from arrays.
    fn view(&self) -> Option<(Rgb, Rgb, Rgb, f32)> {
        let view = self.view.as_ref()?;
        Some((view.eye.into(), view.target.into(), view.up.into(), view.vertical_fov_degrees))
    }

    /// Least and greatest coordinates, m.
    fn bounds(&self) -> (Rgb, Rgb) {
        let (low, high) = self.scene.geometry.bounds;
        (low.into(), high.into())
    }

    /// Lights and sky.
    fn lighting(&self) -> (Vec<Light>, Sky) {
        of_lighting(&self.scene.lighting)
    }

    /// Direct irradiance at points, W/m².
    #[pyo3(signature = (points, normals, lights, sky, emission, area_rays, sky_rays, seed, progress))]
    fn direct<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<f32>,
        normals: PyReadonlyArray2<f32>,
        lights: Vec<PyRef<'_, Light>>,
        sky: Option<PyRef<'_, Sky>>,
        emission: Option<PyReadonlyArray2<f32>>,
        area_rays: u32,
        sky_rays: u32,
        seed: u32,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let points = surface_points(vectors(&points, "points")?, vectors(&normals, "normals")?)?;
        let emission = emission.as_ref().map(|emission| vectors(emission, "emission")).transpose()?;
        let scene = self.under(&lights, sky.as_deref(), emission)?;
        let params = DirectParams {
            count: points.len() as u32,
            area_rays,
            sky_rays: if scene.has_sky() { sky_rays } else { 0 },
            seed,
            ..patchlight::bake::direct_params(&scene)
        };
        let light = run(py, progress.as_ref(), |watcher| {
            blocks(&points, watcher, |first, block| scene.direct_irradiance(&DirectParams { first, ..params }, block))
        })?;
        from_vectors(py, &light)
    }

    /// Rows over the parts of a sky: irradiance, W/m², that row i has of a part of radiance 1 W/m²/sr. Row i has the
    /// points `offsets[i]..offsets[i + 1]`, which share its rays. Column 0 is what lies below the horizon.
    #[pyo3(signature = (points, normals, offsets, rays, division, seed, progress))]
    fn sky_rows<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<f32>,
        normals: PyReadonlyArray2<f32>,
        offsets: PyReadonlyArray1<u32>,
        rays: u32,
        division: u32,
        seed: u32,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<CsrParts<'py>> {
        let points = surface_points(vectors(&points, "points")?, vectors(&normals, "normals")?)?;
        let offsets = numbers(&offsets, "offsets")?;
        check_rows(offsets, points.len())?;
        let bins = SkyBins::new(division)?;
        let scene = &self.scene;
        let lift = scene.geometry.ray_offset;
        let row = |row: usize| {
            let own = &points[offsets[row] as usize..offsets[row + 1] as usize];
            let shift = (hash3(row as u32, 0, seed), hash3(row as u32, 1, seed));
            let mut found: Vec<u32> = (0..rays)
                .filter_map(|k| {
                    // Neighbours in the sequence go to different points.
                    let point = &own[k as usize % own.len()];
                    let direction = cosine_hemisphere(point.normal, hammersley(k, rays, shift));
                    let hit = scene.closest(point.position + point.normal * lift, direction);
                    hit.is_miss().then(|| bins.of(direction))
                })
                .collect();
            found.sort_unstable();
            found
        };
        let total = offsets.len() - 1;
        let csr = run(py, progress.as_ref(), |watcher| {
            let mut csr = Csr { rows: total, columns: bins.count() as usize, row_start: vec![0], ..Csr::default() };
            for first in (0..total).step_by(ROWS * 16) {
                let own: Vec<Vec<u32>> = (first..total.min(first + ROWS * 16)).into_par_iter().map(row).collect();
                let share = std::f32::consts::PI / rays as f32;
                for row in own {
                    for same in row.chunk_by(|a, b| a == b) {
                        csr.column_index.push(same[0]);
                        csr.values.push(same.len() as f32 * share);
                    }
                    csr.row_start.push(csr.values.len() as u32);
                }
                if watcher.step("sky", csr.row_start.len() - 1, total).is_break() {
                    return Err(crate::error::Cancelled::new_err("cancelled"));
                }
            }
            Ok(csr)
        })?;
        Ok(from_csr(py, csr))
    }

    /// Cosine of the incidence of suns in these directions (towards them), where nothing hides them; `(rows, suns)`,
    /// means over the points of a row.
    #[pyo3(signature = (points, normals, offsets, suns, progress))]
    fn sun_rows<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<f32>,
        normals: PyReadonlyArray2<f32>,
        offsets: PyReadonlyArray1<u32>,
        suns: PyReadonlyArray2<f32>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let points = surface_points(vectors(&points, "points")?, vectors(&normals, "normals")?)?;
        let offsets = numbers(&offsets, "offsets")?;
        check_rows(offsets, points.len())?;
        let suns = vectors(&suns, "suns")?;
        let scene = &self.scene;
        let lift = scene.geometry.ray_offset;
        let row = |row: usize| -> Vec<f32> {
            let own = &points[offsets[row] as usize..offsets[row + 1] as usize];
            let of_sun = |sun: &Vec3| {
                let seen = own.iter().map(|point| {
                    let cosine = point.normal.dot(*sun);
                    let start = point.position + point.normal * lift;
                    if cosine > 0.0 && !scene.occluded(start, *sun, FAR) { cosine } else { 0.0 }
                });
                seen.sum::<f32>() / own.len() as f32
            };
            suns.iter().map(of_sun).collect()
        };
        let total = offsets.len() - 1;
        let values = run(py, progress.as_ref(), |watcher| {
            let mut values = Vec::with_capacity(total * suns.len());
            for first in (0..total).step_by(ROWS) {
                let own: Vec<Vec<f32>> = (first..total.min(first + ROWS)).into_par_iter().map(row).collect();
                values.extend(own.into_iter().flatten());
                if watcher.step("suns", total.min(first + ROWS), total).is_break() {
                    return Err(crate::error::Cancelled::new_err("cancelled"));
                }
            }
            Ok(values)
        })?;
        use numpy::PyArrayMethods as _;
        PyArray1::from_vec(py, values).reshape([total, suns.len()])
    }

    /// Triangle on whose surface each point lies, below its normal; 2³² - 1 where there is none.
    fn locate<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<f32>,
        normals: PyReadonlyArray2<f32>,
    ) -> PyResult<Bound<'py, PyArray1<u32>>> {
        let points = surface_points(vectors(&points, "points")?, vectors(&normals, "normals")?)?;
        let scene = &self.scene;
        let lift = scene.geometry.ray_offset;
        let triangles: Vec<u32> = py.detach(|| {
            let below =
                |point: &SurfacePoint| scene.closest(point.position + point.normal * lift, -point.normal).triangle;
            points.par_iter().map(below).collect()
        });
        Ok(PyArray1::from_vec(py, triangles))
    }

    /// Distance along each ray to the first surface, m; infinite where there is none.
    fn cast<'py>(
        &self,
        py: Python<'py>,
        origins: PyReadonlyArray2<f32>,
        directions: PyReadonlyArray2<f32>,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let origins = vectors(&origins, "origins")?;
        let directions = vectors(&directions, "directions")?;
        if origins.len() != directions.len() {
            return Err(input(format!("{} origins and {} directions", origins.len(), directions.len())));
        }
        let scene = &self.scene;
        let distances: Vec<f32> = py.detach(|| {
            let rays = origins.par_iter().zip(directions);
            rays.map(|(&origin, &direction)| {
                let hit = scene.closest_before(origin, direction, FAR);
                if hit.is_miss() { f32::INFINITY } else { hit.t }
            })
            .collect()
        });
        Ok(PyArray1::from_vec(py, distances))
    }
}

type Rgb = (f32, f32, f32);

/// Points of surfaces.
pub fn surface_points(positions: &[Vec3], normals: &[Vec3]) -> PyResult<Vec<SurfacePoint>> {
    if positions.len() != normals.len() {
        return Err(input(format!("{} points and {} normals; give one for each", positions.len(), normals.len())));
    }
    let mut points = Vec::with_capacity(positions.len());
    for (k, (&position, &normal)) in positions.iter().zip(normals).enumerate() {
        let length = normal.length();
        if !(position.is_finite() && length > 0.0 && length.is_finite()) {
            return Err(input(format!("point {k} has no place, or no normal")));
        }
        points.push(SurfacePoint { position, patch: NONE, normal: normal / length, weight: 1.0 });
    }
    Ok(points)
}

fn check_rows(offsets: &[u32], points: usize) -> PyResult<()> {
    let is_whole = offsets.first() == Some(&0) && offsets.last().is_some_and(|&end| end as usize == points);
    if !is_whole || offsets.windows(2).any(|pair| pair[0] >= pair[1]) {
        return Err(input("offsets must begin with 0, rise, and end with the number of points"));
    }
    Ok(())
}

/// Applies `work` to blocks of points, in order.
fn blocks(
    points: &[SurfacePoint],
    watcher: &Watcher,
    work: impl Fn(u32, &[SurfacePoint]) -> Vec<Vec3>,
) -> PyResult<Vec<Vec3>> {
    let mut out = Vec::with_capacity(points.len());
    for block in points.chunks(1 << 14) {
        out.extend(work(out.len() as u32, block));
        if watcher.step("direct light", out.len(), points.len()).is_break() {
            return Err(crate::error::Cancelled::new_err("cancelled"));
        }
    }
    Ok(out)
}

/// Rows over the elements of a mesh, for points of one's own.
pub fn point_rows(
    bake: &patchlight::Bake,
    points: &[SurfacePoint],
    rays: u32,
    seed: u32,
    watcher: &Watcher,
) -> PyResult<(Csr, Vec<f32>)> {
    let offsets: Vec<u32> = (0..=points.len() as u32).collect();
    let mesh = bake.mesh();
    let surfaces = mesh.lighting(bake.scene(), patches::Columns::Elements, points, &offsets, seed);
    let rows = sparse_rows(&surfaces, rays, &|done, total| watcher.step("points", done, total));
    let rows = rows.map_err(|error| crate::error::exception(error.into()))?;
    Ok((rows.factors, rows.sky_factor))
}

/// Parts of the sky as Tregenza cut it, each row and azimuth divided further as Reinhart does: part 0 is what lies below
/// the horizon; the first part above is due north, −z, and they go on towards the east, +x.
struct SkyBins {
    division: u32,
    /// First part of each row, and the one past the last.
    first: Vec<u32>,
}

impl SkyBins {
    fn new(division: u32) -> PyResult<Self> {
        if !(1..=16).contains(&division) {
            return Err(input(format!("division is {division}; it must be 1 (Tregenza) to 16")));
        }
        let mut first = vec![1];
        for row in 0..7 * division + 1 {
            let parts = Self::parts(division, row);
            first.push(first[row as usize] + parts);
        }
        Ok(Self { division, first })
    }

    fn parts(division: u32, row: u32) -> u32 {
        if row == 7 * division { 1 } else { TREGENZA[(row / division) as usize] * division }
    }

    fn count(&self) -> u32 {
        self.first[self.first.len() - 1]
    }

    /// Height of a row, radians.
    fn height(&self) -> f64 {
        std::f64::consts::FRAC_PI_2 / (7.0 * f64::from(self.division) + 0.5)
    }

    fn of(&self, direction: Vec3) -> u32 {
        let [x, y, z] = direction.to_array().map(f64::from);
        if y < 0.0 {
            return 0;
        }
        let altitude = y.atan2(x.hypot(z));
        let row = ((altitude / self.height()) as u32).min(7 * self.division);
        let parts = Self::parts(self.division, row);
        let turn = x.atan2(-z) / std::f64::consts::TAU;
        // Parts are centred on the north.
        let part = (turn * f64::from(parts) + 0.5).floor().rem_euclid(f64::from(parts)) as u32;
        self.first[row as usize] + part.min(parts - 1)
    }

    /// Middle and solid angle, sr, of a part above the horizon.
    fn middle(&self, row: u32, part: u32) -> (Vec3, f32) {
        let parts = Self::parts(self.division, row);
        let low = f64::from(row) * self.height();
        let is_top = row == 7 * self.division;
        let high = if is_top { std::f64::consts::FRAC_PI_2 } else { low + self.height() };
        let altitude = if is_top { high } else { 0.5 * (low + high) };
        let azimuth = f64::from(part) / f64::from(parts) * std::f64::consts::TAU;
        let flat = altitude.cos();
        let middle = Vec3::new((flat * azimuth.sin()) as f32, altitude.sin() as f32, -(flat * azimuth.cos()) as f32);
        (middle, (std::f64::consts::TAU / f64::from(parts) * (high.sin() - low.sin())) as f32)
    }
}

/// Middles `(parts, 3)` and solid angles, sr, of the parts of a sky; the first is what lies below the horizon.
#[pyfunction]
pub fn sky_directions<'py>(
    py: Python<'py>,
    division: u32,
) -> PyResult<(Bound<'py, PyArray2<f32>>, Bound<'py, PyArray1<f32>>)> {
    let bins = SkyBins::new(division)?;
    let mut middles = vec![Vec3::NEG_Y];
    let mut angles = vec![std::f32::consts::TAU];
    for row in 0..7 * division + 1 {
        for part in 0..SkyBins::parts(division, row) {
            let (middle, angle) = bins.middle(row, part);
            middles.push(middle);
            angles.push(angle);
        }
    }
    Ok((from_vectors(py, &middles)?, PyArray1::from_vec(py, angles)))
}

/// Names of the built-in scenes.
#[pyfunction]
pub fn built_in_scenes() -> Vec<String> {
    procedural::NAMES.iter().map(|&name| name.to_owned()).collect()
}

/// A pinhole.
pub fn camera(eye: Rgb, target: Rgb, up: Rgb, fov_degrees: f32, width: u32, height: u32) -> Camera {
    Camera::look_at(eye.into(), target.into(), up.into(), fov_degrees, width, height)
}
