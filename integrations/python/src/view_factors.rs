//! View factors between the facets of a mesh: by rays, or by contour sums with shadow rays.
//!
//! `F_ij` is the share of what leaves facet i that arrives at facet j. A facet has one side, the one from which its
//! corners run counter-clockwise; from behind it is dark, and hides what lies beyond it.

use formfactor::{polygon_to_polygon, recurrence};
use numpy::{PyArray1, PyReadonlyArray2};
use patchlight::glam::{DVec3, Vec3};
use patchlight::rayon::prelude::*;
use patchlight::scene::Visibility as _;
use patchlight::scene::sampling::{cosine_hemisphere, hash3};
use patchlight::transport::{Csr, Polygon};
use patchlight::{Material, Mesh};
use pyo3::prelude::*;

use crate::arrays::{CsrParts, from_csr, triples, vectors};
use crate::error::{Cancelled, input};
use crate::work::run;

/// Rows that are made together.
const ROWS: usize = 1024;
/// Rows of pairs, whose later rows are shorter.
const PAIR_ROWS: usize = 64;

/// Facets ready for rays.
struct Facets {
    polygons: Vec<Polygon>,
    scene: patchlight::Scene,
}

impl Facets {
    fn new(py: Python<'_>, positions: &[Vec3], corners: &[[u32; 3]]) -> PyResult<Self> {
        let mut polygons = Vec::with_capacity(corners.len());
        for (face, corners) in corners.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&vertex| vertex as usize >= positions.len()) {
                return Err(input(format!("face {face} has vertex {vertex} of {}", positions.len())));
            }
            let [a, b, c] = corners.map(|vertex| positions[vertex as usize].as_dvec3());
            let polygon = Polygon::triangle(a, b, c).filter(|polygon| polygon.area.is_finite());
            polygons.push(polygon.ok_or_else(|| input(format!("face {face} has no area; leave such faces out")))?);
        }
        let mut builder = patchlight::Scene::builder();
        let material = builder.add_material(Material::default());
        let indices: &[u32] = bytemuck::cast_slice(corners);
        builder.add_mesh(Mesh { name: "facets", positions, indices, material, ..Mesh::default() });
        let scene = py.detach(|| builder.build()).map_err(input)?;
        Ok(Self { polygons, scene })
    }

    fn areas(&self) -> Vec<f64> {
        self.polygons.iter().map(|polygon| polygon.area).collect()
    }

    /// The facet whose front a ray meets; none where it meets nothing, or a back. The second is true where it escapes.
    fn met(&self, origin: Vec3, direction: Vec3) -> (Option<u32>, bool) {
        let hit = self.scene.closest(origin, direction);
        if hit.is_miss() {
            return (None, true);
        }
        let triangle = &self.scene.geometry.triangles[hit.triangle as usize];
        let is_front = triangle.edge_a.cross(triangle.edge_b).dot(direction) < 0.0;
        (is_front.then_some(triangle.source), false)
    }

    /// Numbers in [0, 1) by which the sequence of a row, or of a pair, is shifted.
    fn shift(a: u32, b: u32, seed: u32) -> [f64; 4] {
        [0, 1, 2, 3].map(|d| f64::from(hash3(a, b, hash3(d, 0x7669_6577, seed))) / 4_294_967_296.0)
    }

    /// A point of a facet, even by area.
    fn place(&self, facet: usize, x: f64, y: f64) -> DVec3 {
        let [a, b, c] = [0, 1, 2].map(|k| self.polygons[facet].corners()[k]);
        let root = x.sqrt();
        a * (1.0 - root) + b * (root * (1.0 - y)) + c * (root * y)
    }

    /// Hits of the rays of a row: facet, hits of even and of odd rays; and the rays that escape.
    fn row(&self, facet: usize, rays: u32, seed: u32) -> (Vec<(u32, u32, u32)>, u32) {
        let shift = Self::shift(facet as u32, 0, seed);
        let normal = self.polygons[facet].normal.as_vec3();
        let lift = self.scene.geometry.ray_offset;
        let mut escaped = 0;
        let mut found = Vec::with_capacity(rays as usize);
        for k in 0..rays {
            let x = recurrence(u64::from(k), shift);
            let origin = self.place(facet, x[0], x[1]).as_vec3() + normal * lift;
            let direction = cosine_hemisphere(normal, (x[2] as f32, x[3] as f32));
            let (met, has_escaped) = self.met(origin, direction);
            escaped += u32::from(has_escaped);
            if let Some(other) = met.filter(|&other| other as usize != facet) {
                found.push((other, k % 2));
            }
        }
        found.sort_unstable();
        let of_facet = |same: &[(u32, u32)]| {
            let odd = same.iter().filter(|hit| hit.1 == 1).count() as u32;
            (same[0].0, same.len() as u32 - odd, odd)
        };
        (found.chunk_by(|a, b| a.0 == b.0).map(of_facet).collect(), escaped)
    }

    /// `A_i F_ij` of a pair, m², and the standard error that its shadow rays leave; none where they do not face each
    /// other.
    fn pair(&self, i: usize, j: usize, shadow_rays: u32, seed: u32) -> Option<(f64, f64)> {
        let a = &self.polygons[i];
        let b = &self.polygons[j];
        let apart = b.centroid - a.centroid;
        if apart.dot(a.normal) <= -b.radius || apart.dot(b.normal) >= a.radius {
            return None;
        }
        let a = a.clip(b.centroid, b.normal)?;
        let b = b.clip(self.polygons[i].centroid, self.polygons[i].normal)?;
        // The mean over the smaller one takes fewer points.
        let (receiver, source) = if a.area < b.area { (&a, &b) } else { (&b, &a) };
        let whole = receiver.area * polygon_to_polygon(receiver, source, receiver.area);
        if shadow_rays == 0 || whole <= 0.0 {
            return Some((whole, 0.0));
        }
        let (even, odd) = self.visible(&a, &b, (i as u32, j as u32), shadow_rays, seed);
        Some((0.5 * whole * (even + odd), 0.5 * whole * (even - odd).abs()))
    }

    /// Share of the light between two polygons that nothing stops, by the even and by the odd of the rays, which are
    /// weighted by the light that they would carry.
    fn visible(&self, a: &Polygon, b: &Polygon, pair: (u32, u32), rays: u32, seed: u32) -> (f64, f64) {
        let shift = Self::shift(pair.0, pair.1 + 1, seed);
        let lift = f64::from(self.scene.geometry.ray_offset);
        let mut seen = [0.0; 2];
        let mut all = [0.0; 2];
        for k in 0..rays {
            let x = recurrence(u64::from(k), shift);
            let from = formfactor::polygon_point(a, x[0], x[1]);
            let to = formfactor::polygon_point(b, x[2], x[3]);
            let here = (to - from).dot(a.normal);
            let there = (from - to).dot(b.normal);
            if here <= 0.0 || there <= 0.0 {
                continue;
            }
            let squared = (to - from).length_squared();
            let weight = here * there / (squared * (std::f64::consts::PI * squared + b.area));
            let half = (k % 2) as usize;
            all[half] += weight;
            let start = (from + a.normal * lift).as_vec3();
            let end = (to + b.normal * lift).as_vec3();
            if !self.scene.any_hit(start, end) {
                seen[half] += weight;
            }
        }
        let share = |half: usize| if all[half] > 0.0 { seen[half] / all[half] } else { 0.0 };
        match (all[0] > 0.0, all[1] > 0.0) {
            (true, false) => (share(0), share(0)),
            (false, true) => (share(1), share(1)),
            _ => (share(0), share(1)),
        }
    }
}

/// Pushes a row of counts as shares of the rays, and the differences between the two halves of the rays.
fn push(factors: &mut Csr, differences: &mut Vec<f32>, row: &[(u32, u32, u32)], rays: u32) -> PyResult<()> {
    let share = 1.0 / rays as f32;
    for &(column, even, odd) in row {
        factors.column_index.push(column);
        factors.values.push((even + odd) as f32 * share);
        differences.push((even as f32 - odd as f32) * share);
    }
    let end = u32::try_from(factors.values.len())
        .map_err(|_| input("more than 2³² view factors are not zero; take fewer rays a facet"))?;
    factors.row_start.push(end);
    Ok(())
}

/// View factors by rays: the matrix, the difference between the even and the odd rays of each entry, the share of each
/// facet's rays that escape, and the areas of the facets.
#[pyfunction]
#[pyo3(signature = (vertices, faces, rays, seed, progress))]
pub fn by_rays<'py>(
    py: Python<'py>,
    vertices: PyReadonlyArray2<f32>,
    faces: PyReadonlyArray2<u32>,
    rays: u32,
    seed: u32,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(CsrParts<'py>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f64>>)> {
    if !(2..=1 << 24).contains(&rays) {
        return Err(input(format!("rays is {rays}; it must be 2 to 2^24")));
    }
    let facets = Facets::new(py, vectors(&vertices, "vertices")?, triples(&faces, "faces")?)?;
    let count = facets.polygons.len();
    let made = run(py, progress.as_ref(), |watcher| {
        let mut factors = Csr { rows: count, columns: count, row_start: vec![0], ..Csr::default() };
        let mut differences = Vec::new();
        let mut sky = Vec::with_capacity(count);
        for first in (0..count).step_by(ROWS) {
            let own = first..count.min(first + ROWS);
            let end = own.end;
            let rows: Vec<_> = own.into_par_iter().map(|facet| facets.row(facet, rays, seed)).collect();
            for (row, escaped) in rows {
                push(&mut factors, &mut differences, &row, rays)?;
                sky.push(escaped as f32 / rays as f32);
            }
            if watcher.step("view factors", end, count).is_break() {
                return Err(Cancelled::new_err(format!("cancelled after {end} of {count} facets")));
            }
        }
        Ok((factors, differences, sky))
    });
    let (factors, differences, sky) = made?;
    let areas = PyArray1::from_vec(py, facets.areas());
    Ok((from_csr(py, factors), PyArray1::from_vec(py, differences), PyArray1::from_vec(py, sky), areas))
}

/// Products `A_i F_ij` of the pairs i < j by contour sums, as rows; the standard error of each that shadow rays leave;
/// and the areas of the facets. Without shadow rays nothing hides anything.
#[pyfunction]
#[pyo3(signature = (vertices, faces, shadow_rays, seed, progress))]
pub fn by_contours<'py>(
    py: Python<'py>,
    vertices: PyReadonlyArray2<f32>,
    faces: PyReadonlyArray2<u32>,
    shadow_rays: u32,
    seed: u32,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
)> {
    if shadow_rays > 1 << 24 {
        return Err(input(format!("shadow_rays is {shadow_rays}; it must be at most 2^24")));
    }
    let facets = Facets::new(py, vectors(&vertices, "vertices")?, triples(&faces, "faces")?)?;
    let count = facets.polygons.len();
    let made = run(py, progress.as_ref(), |watcher| {
        let mut starts = vec![0i64];
        let mut columns = Vec::new();
        let mut values = Vec::new();
        let mut errors = Vec::new();
        for first in (0..count).step_by(PAIR_ROWS) {
            let own = first..count.min(first + PAIR_ROWS);
            let end = own.end;
            let row = |i: usize| -> Vec<(i32, f64, f64)> {
                let of_pair = |j: usize| {
                    let (value, error) = facets.pair(i, j, shadow_rays, seed)?;
                    (value > 0.0).then_some((j as i32, value, error))
                };
                (i + 1..count).filter_map(of_pair).collect()
            };
            let rows: Vec<_> = own.into_par_iter().with_max_len(1).map(row).collect();
            for row in rows {
                for (column, value, error) in row {
                    columns.push(column);
                    values.push(value);
                    errors.push(error);
                }
                starts.push(values.len() as i64);
            }
            // Later rows have fewer pairs.
            let pairs = |rows: usize| rows as u64 * (2 * count as u64 - rows as u64) / 2;
            let watched = watcher.step("view factors", pairs(end) as usize, pairs(count) as usize);
            if watched.is_break() {
                return Err(Cancelled::new_err(format!("cancelled after {end} of {count} facets")));
            }
        }
        Ok((starts, columns, values, errors))
    });
    let (starts, columns, values, errors) = made?;
    Ok((
        PyArray1::from_vec(py, starts),
        PyArray1::from_vec(py, columns),
        PyArray1::from_vec(py, values),
        PyArray1::from_vec(py, errors),
        PyArray1::from_vec(py, facets.areas()),
    ))
}
