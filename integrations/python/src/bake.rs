//! Bakes, and their tables as matrices.

use std::path::Path;
use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use patches::PatchKind;
use patchlight::glam::Vec3;
use patchlight::low_level::operator::Build;
use patchlight::transport::Patch;
use patchlight::{BakeSettings, Cpu, Estimator, FormFactors, Origin, ReceiverKind};
use pyo3::prelude::*;

use crate::arrays::{CsrParts, from_csr, from_rgb, from_vectors, vectors};
use crate::error::{exception, input};
use crate::field::method_of;
use crate::scene::{Scene, point_rows, surface_points};
use crate::work::run;

/// Centroids, normals, areas, triangles.
type Surfaces<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray2<f32>>,
);

/// A bake; `patchlight.Bake` documents it.
#[pyclass(frozen, module = "patchlight._core")]
pub struct Bake {
    pub bake: Arc<patchlight::Bake>,
    origin: Origin,
}

fn surfaces<'py>(py: Python<'py>, of: &[Patch], albedo: &[patchlight::glam::Vec4]) -> PyResult<Surfaces<'py>> {
    let centroids: Vec<Vec3> = of.iter().map(|patch| patch.centroid).collect();
    let normals: Vec<Vec3> = of.iter().map(|patch| patch.normal).collect();
    Ok((
        from_vectors(py, &centroids)?,
        from_vectors(py, &normals)?,
        PyArray1::from_iter(py, of.iter().map(|patch| patch.area)),
        PyArray1::from_iter(py, of.iter().map(|patch| patch.triangle)),
        from_rgb(py, albedo)?,
    ))
}

#[pymethods]
impl Bake {
    #[staticmethod]
    #[pyo3(signature = (scene, patches, kind, estimator, rays, samples, sample_rays, bounces, receivers, receiver_rays, most_receivers, memory_limit, seed, operators, progress))]
    fn build(
        py: Python<'_>,
        scene: PyRef<'_, Scene>,
        patches: usize,
        kind: &str,
        estimator: &str,
        rays: u32,
        samples: Option<u32>,
        sample_rays: u32,
        bounces: Option<u32>,
        receivers: bool,
        receiver_rays: u32,
        most_receivers: Option<usize>,
        memory_limit: Option<u64>,
        seed: u32,
        operators: Vec<String>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let kind = match kind {
            "cluster" => PatchKind::Cluster,
            "polygon" => PatchKind::Polygon,
            "voxel" => PatchKind::Voxel,
            "axis" => PatchKind::Axis,
            _ => {
                return Err(input(format!(
                    "kind is {kind:?}; it must be \"cluster\", \"polygon\", \"voxel\" or \"axis\""
                )));
            }
        };
        let estimator = match estimator {
            "rays" => Estimator::Hemisphere { rays },
            "contour" => Estimator::Contour,
            "area" => Estimator::Area,
            "point" => Estimator::Point,
            _ => {
                return Err(input(format!(
                    "estimator is {estimator:?}; it must be \"rays\", \"contour\", \"area\" or \"point\""
                )));
            }
        };
        let methods = operators.iter().map(|name| method_of(name, 0.01)).collect::<PyResult<Vec<_>>>()?;
        let default = BakeSettings::default();
        let settings = BakeSettings::default()
            .with_patches(kind)
            .with_patch_count(patches)
            .with_estimator(estimator)
            .with_samples(samples.unwrap_or(default.samples))
            .with_sample_rays(sample_rays)
            .with_bounces(bounces)
            .with_receiver_rays(receiver_rays)
            .with_most_receivers(most_receivers)
            .with_memory_limit(memory_limit)
            .with_seed(seed);
        let settings = if receivers { settings } else { settings.with_receivers(ReceiverKind::Pixels) };
        let own = &scene.scene;
        let bake = run(py, progress.as_ref(), |watcher| {
            let mut bake = patchlight::Bake::build(own, &settings, watcher).map_err(exception)?;
            if !methods.is_empty() {
                bake.build_operators(&methods, &Build::default(), &mut Cpu::new(), watcher).map_err(exception)?;
            }
            Ok(bake)
        })?;
        let origin = Origin { scene: scene.name.clone(), scene_hash: scene.hash, application: Vec::new() };
        Ok(Self { bake: Arc::new(bake), origin })
    }

    /// Opens a file; with its scene.
    #[staticmethod]
    fn open(py: Python<'_>, path: &str) -> PyResult<(Self, Scene)> {
        let file = py.detach(|| patchlight::Bake::open(Path::new(path))).map_err(exception)?;
        let scene = Scene::of(file.bake.scene().clone(), file.origin.scene.clone(), file.origin.scene_hash);
        Ok((Self { bake: Arc::new(file.bake), origin: file.origin }, scene))
    }

    /// Writes a file.
    fn save(&self, py: Python<'_>, path: &str) -> PyResult<()> {
        py.detach(|| self.bake.save(Path::new(path), &self.origin)).map_err(exception)
    }

    /// The scene of the bake: triangles are cut where something stands on them.
    fn scene(&self) -> Scene {
        Scene::of(self.bake.scene().clone(), self.origin.scene.clone(), self.origin.scene_hash)
    }

    #[getter]
    fn bounces(&self) -> u32 {
        self.bake.bounces()
    }

    #[getter]
    fn receiver_count(&self) -> usize {
        self.bake.receivers().points.len()
    }

    /// Centroids, normals, areas, triangles and albedo of the patches.
    fn patches<'py>(&self, py: Python<'py>) -> PyResult<Surfaces<'py>> {
        let mesh = self.bake.mesh();
        surfaces(py, &mesh.patches, &mesh.albedo)
    }

    /// The same of the elements.
    fn elements<'py>(&self, py: Python<'py>) -> PyResult<Surfaces<'py>> {
        let mesh = self.bake.mesh();
        surfaces(py, &mesh.elements, &mesh.element_albedo)
    }

    /// First element of each patch, and the number of elements.
    fn patch_elements<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        PyArray1::from_slice(py, &self.bake.mesh().patch_elements)
    }

    /// Positions and normals of the samples, the first sample of each element, weights and albedo of the samples.
    fn samples<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(
        Bound<'py, PyArray2<f32>>,
        Bound<'py, PyArray2<f32>>,
        Bound<'py, PyArray1<u32>>,
        Bound<'py, PyArray1<f32>>,
        Bound<'py, PyArray2<f32>>,
    )> {
        let mesh = self.bake.mesh();
        let positions: Vec<Vec3> = mesh.points.iter().map(|point| point.position).collect();
        let normals: Vec<Vec3> = mesh.points.iter().map(|point| point.normal).collect();
        Ok((
            from_vectors(py, &positions)?,
            from_vectors(py, &normals)?,
            PyArray1::from_slice(py, &mesh.offsets),
            PyArray1::from_iter(py, mesh.points.iter().map(|point| point.weight)),
            from_rgb(py, &mesh.point_albedo)?,
        ))
    }

    /// Form factors from patch to patch.
    fn form_factors<'py>(&self, py: Python<'py>) -> CsrParts<'py> {
        from_csr(py, (*self.factors().factors).clone())
    }

    /// Form factors from element to element.
    fn element_factors<'py>(&self, py: Python<'py>) -> PyResult<CsrParts<'py>> {
        let factors = self.factors();
        let csr = match &factors.element_rows {
            Some(rows) => py.detach(|| rows.to_csr()).map_err(|error| exception(error.into()))?,
            None => (*factors.factors).clone(),
        };
        Ok(from_csr(py, csr))
    }

    /// Share of the hemisphere of each element that sees no geometry.
    fn sky_factor<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        PyArray1::from_slice(py, &self.factors().sky_factor)
    }

    /// Rows over the elements of points of one's own, and the share of each that sees the sky.
    #[pyo3(signature = (points, normals, rays, seed, progress))]
    fn point_rows<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<f32>,
        normals: PyReadonlyArray2<f32>,
        rays: u32,
        seed: u32,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<(CsrParts<'py>, Bound<'py, PyArray1<f32>>)> {
        let points = surface_points(vectors(&points, "points")?, vectors(&normals, "normals")?)?;
        let (rows, sky) = run(py, progress.as_ref(), |watcher| point_rows(&self.bake, &points, rays, seed, watcher))?;
        Ok((from_csr(py, rows), PyArray1::from_vec(py, sky)))
    }

    /// The bake's estimates of its own errors: balance, and the ratio of indirect light beside rays with its standard
    /// error near and under unseen light.
    fn energy(&self) -> Option<(f64, Option<(f64, f64)>, Option<(f64, f64)>)> {
        let check = self.bake.energy()?;
        let pair = |ratio: patchlight::MeanRatio| (ratio.ratio, ratio.standard_error);
        Some((check.balance, check.near.map(pair), check.unseen.map(pair)))
    }
}

impl Bake {
    fn factors(&self) -> &FormFactors {
        self.bake.form_factors()
    }
}
