//! The cells of triangles in which elements are looked up.

use alloc::vec;
use alloc::vec::Vec;

use glam::{Vec2, Vec3};
use scene::gpu::Triangle;
use scene::parallel::*;
use scene::sampling::hash3;
use scene::{NONE, Scene, SurfacePoint};
use transport::TriangleGrid;

use crate::error::Error;
use crate::host::focus::Density;
use crate::host::lit::{Walker, are_open};
use crate::host::nearest::Nearest;
use crate::host::visibility::{SurfacePlace, is_in_gap, is_visible};
use crate::types::Sample;

/// A place has no element when the nearest sample of similar normal is further, in sample edges.
const MAX_DISTANCE: f32 = 4.0;
/// Samples that are tried, the nearest first.
const TRIED: usize = 6;
/// Samples that are tried where all of those differ by more than [`SIMILAR_ALBEDO`] in albedo.
const TRIED_DISSIMILAR: usize = 64;
const SIMILAR_ALBEDO: f32 = 0.25;
/// Weight of a difference of 1 in albedo in the choice, in sample edges: thin dark things have few samples, and must
/// not shine like the bright wall beside them.
const ALBEDO_WEIGHT: f32 = 10.0;
/// Triangles whose cells are chosen together: a choice takes ten times the memory of an element.
const BLOCK_TRIANGLES: usize = 1 << 13;
/// Random walks of the reachability test of a place that sees no sample.
const WALKS: u32 = 2;
/// Changes their random numbers.
const WALKS_SEED: u32 = 0x6869_6465;

/// A sample and its distance in position, normal and albedo, in sample edges.
type Near = (u32, f32);

/// The element of each cell, or [`NONE`]: the `owner` of the most similar sample that the middle of
/// the cell sees, with samples every `edge` m in the focus of the density. Cells in one place have one element.
///
/// # Errors
/// What the walker says.
pub(super) fn cell_elements(
    (scene, walker): (&Scene, Option<&dyn Walker>),
    density: &Density,
    grids: &[TriangleGrid],
    samples: &[Sample],
    owner: &[u32],
    edge: f32,
) -> Result<Vec<u32>, Error> {
    let search = ElementSearch::new(scene, density, samples, owner, edge);
    settled(walker, scene, grids.len(), |t| search.triangle(t as u32, grids[t].divisions))
}

/// The elements that `choose` names for the cells of each triangle, where light comes to those that see no sample.
///
/// # Errors
/// What the walker says.
pub(super) fn settled(
    walker: Option<&dyn Walker>,
    scene: &Scene,
    triangles: usize,
    choose: impl Fn(usize) -> Vec<Choice> + Sync,
) -> Result<Vec<u32>, Error> {
    let mut elements = Vec::new();
    let mut hiding = Vec::new();
    let mut hidden = Vec::new();
    for first in (0..triangles).step_by(BLOCK_TRIANGLES) {
        let block = first..triangles.min(first + BLOCK_TRIANGLES);
        for choice in block.into_par_iter().flat_map_iter(&choose).collect::<Vec<Choice>>() {
            if let Some(place) = choice.place {
                hiding.push(elements.len());
                hidden.push(place);
            }
            elements.push(choice.element);
        }
    }
    let open = are_open(walker, scene, &hidden, WALKS)?;
    for (cell, _) in hiding.into_iter().zip(open).filter(|(_, is_open)| !is_open) {
        elements[cell] = NONE;
    }
    Ok(elements)
}

/// The element of a cell, or [`NONE`].
#[derive(Clone, Copy)]
pub(super) struct Choice {
    pub element: u32,
    /// Middle of a cell that sees no sample. It has the element only if random walks from there come to light, which is
    /// the reachability test; the place's patch is their seed.
    pub place: Option<SurfacePoint>,
}

/// Finds the elements of cells.
pub(super) struct ElementSearch<'a> {
    scene: &'a Scene,
    density: &'a Density,
    samples: &'a [Sample],
    /// Element of each sample.
    owner: &'a [u32],
    nearest: Nearest,
    /// Distance between samples in the focus, m.
    edge: f32,
}

impl<'a> ElementSearch<'a> {
    /// Among samples every `edge` m in the focus, each with its element.
    pub fn new(scene: &'a Scene, density: &'a Density, samples: &'a [Sample], owner: &'a [u32], edge: f32) -> Self {
        Self { scene, density, samples, owner, nearest: Nearest::new(samples, density), edge }
    }

    /// The elements of the cells of a triangle's front, then of its back.
    pub fn triangle(&self, triangle: u32, divisions: u32) -> Vec<Choice> {
        let normal = self.scene.tables().normal(triangle);
        let cells = cells_in_places(&self.scene.geometry.triangles[triangle as usize], divisions);
        let mut elements = Vec::with_capacity(2 * cells.len());
        self.add_side(triangle, normal, &cells, &mut elements);
        self.add_side(triangle, -normal, &cells, &mut elements);
        elements
    }

    fn add_side(&self, triangle: u32, normal: Vec3, cells: &[CellPlace], elements: &mut Vec<Choice>) {
        let first_of_side = elements.len();
        for (k, cell) in (0u32..).zip(cells) {
            let element = if cell.first != k {
                elements[first_of_side + cell.first as usize]
            } else {
                let position = self.scene.tables().position(triangle, cell.middle.x, cell.middle.y);
                let place = SurfacePlace { position, normal };
                let edge = self.edge * self.density.edge(position);
                let albedo = self.scene.filtered_albedo(triangle, position, edge * edge);
                let similar = most_similar_samples(&self.nearest, self.samples, place, albedo);
                // Nothing may stand between: a dark place has no element, however bright it is
                // beyond a wall.
                let mut chosen = None;
                if !is_in_gap(self.scene, place, edge) {
                    chosen = similar.iter().find(|near| self.is_seen(place, edge, near));
                }
                // What is small may hide from all samples of similar normal, and be lit nevertheless.
                let hides = chosen.is_none() && cells.len() == 1 && !similar.is_empty();
                if hides {
                    chosen = similar.first();
                }
                let element = chosen.map_or(NONE, |near| self.owner[near.0 as usize]);
                let patch = hash3(triangle, k, WALKS_SEED);
                Choice { element, place: hides.then_some(SurfacePoint { position, patch, normal, weight: 1.0 }) }
            };
            elements.push(element);
        }
    }

    fn is_seen(&self, place: SurfacePlace, edge: f32, near: &Near) -> bool {
        is_visible(self.scene, place, (&self.samples[near.0 as usize]).into(), edge)
    }
}

/// Position of a cell.
#[derive(Clone, Copy, Debug)]
struct CellPlace {
    /// Its middle (u, v).
    middle: Vec2,
    /// The first cell of the triangle in the same place.
    first: u32,
}

/// The places of the cells of a triangle: squares of half a cell's edge along the longest edge of
/// the triangle. Cells of a triangle about as wide as long mostly have a place each, those of one
/// that is long and thin, whose cells are that, too, share them.
fn cells_in_places(triangle: &Triangle, divisions: u32) -> Vec<CellPlace> {
    let a = triangle.edge_a;
    let b = triangle.edge_b;
    let edges = [a, b, b - a].into_iter();
    let longest = edges.max_by(|x, y| x.length_squared().total_cmp(&y.length_squared())).unwrap_or(a);
    let along = longest.normalize();
    let across = a.cross(b).normalize().cross(along);
    let scale = 2.0 * divisions as f32 / longest.length();
    let x = Vec2::new(a.dot(along), b.dot(along)) * scale;
    let y = Vec2::new(a.dot(across), b.dot(across)) * scale;
    // The triangle's corners are 0, (x.x, y.x) and (x.y, y.y).
    let low = Vec2::new(x.min_element(), y.min_element()).min(Vec2::ZERO);
    let high = Vec2::new(x.max_element(), y.max_element()).max(Vec2::ZERO);
    let size = (high - low).as_uvec2() + 1;
    let mut first_cells = vec![NONE; size.x as usize * size.y as usize];
    let mut cells = Vec::with_capacity(divisions as usize * divisions as usize);
    for j in 0..divisions {
        for k in 0..2 * (divisions - j) - 1 {
            // Upright cells and cells on their tip alternate.
            let third = (1 + k % 2) as f32 / 3.0;
            let middle = Vec2::new((k / 2) as f32 + third, j as f32 + third) / divisions as f32;
            let place = (Vec2::new(middle.dot(x), middle.dot(y)) - low).as_uvec2();
            let first = &mut first_cells[place.y as usize * size.x as usize + place.x as usize];
            *first = (*first).min(cells.len() as u32);
            cells.push(CellPlace { middle, first: *first });
        }
    }
    cells
}

/// The samples nearest to a place in position, normal and albedo, the nearest first.
fn most_similar_samples(nearest: &Nearest, samples: &[Sample], place: SurfacePlace, albedo: Vec3) -> Vec<Near> {
    let SurfacePlace { position, normal } = place;
    let (few, count) = nearest.samples::<TRIED>(position, normal, MAX_DISTANCE);
    let mut found = few[..count].to_vec();
    if count == TRIED && found.iter().all(|near| albedo.distance(samples[near.0 as usize].albedo) > SIMILAR_ALBEDO) {
        let (more, count) = nearest.samples::<TRIED_DISSIMILAR>(position, normal, MAX_DISTANCE);
        found = more[..count].to_vec();
    }
    for (sample, distance) in &mut found {
        let difference = ALBEDO_WEIGHT * albedo.distance(samples[*sample as usize].albedo);
        *distance = scene::math::sqrt(*distance * *distance + difference * difference);
    }
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    found
}

#[cfg(test)]
mod tests {
    use glam::vec3;
    use transport::kernel::grid::{cell_corners, cell_count};

    use super::*;

    #[test]
    fn the_most_similar_sample_is_of_like_albedo_where_there_is_one() {
        // A white wall in the plane z = 0 with samples every metre, and one dark sample on it, between them.
        let sample = |x: f32, y: f32, albedo: f32| Sample {
            position: Vec3::new(x, y, 0.0),
            normal: Vec3::Z,
            area: 1.0,
            albedo: Vec3::splat(albedo),
            ..Sample::default()
        };
        let mut samples: Vec<Sample> = (0..100).map(|k| sample((k % 10) as f32, (k / 10) as f32, 0.8)).collect();
        samples.push(sample(6.5, 5.5, 0.02));
        let nearest = Nearest::new(&samples, &Density::default());
        let place = SurfacePlace { position: Vec3::new(4.1, 5.0, 0.0), normal: Vec3::Z };
        let first = |albedo: f32| most_similar_samples(&nearest, &samples, place, Vec3::splat(albedo))[0].0;
        assert_eq!(first(0.02), 100, "a dark place takes the dark sample, though a dozen white ones are nearer");
        assert_eq!(first(0.8), 54, "a white place takes the nearest");
        assert_eq!(first(0.7), 54, "texture does not matter");
    }

    #[test]
    fn cells_share_places_where_they_are_narrow() {
        let places = |a: Vec3, b: Vec3, n: u32| {
            let triangle = Triangle { edge_a: a, edge_b: b, ..Triangle::default() };
            let cells = cells_in_places(&triangle, n);
            assert_eq!(cells.len(), cell_count(n) as usize);
            let longest = a.length().max(b.length()).max(a.distance(b));
            for (cell, &CellPlace { middle, first }) in (0..).zip(&cells) {
                let (p, q, r) = cell_corners(n, cell);
                assert!(middle.distance((p + q + r) / 3.0) < 1e-5, "cell {cell} of {n}: {middle}");
                let offset = middle - cells[first as usize].middle;
                let distance = (a * offset.x + b * offset.y).length() / longest;
                assert!(first <= cell && distance * n as f32 <= 0.5f32.sqrt() + 1e-3, "cell {cell} of {n}: {distance}");
            }
            cells.iter().zip(0..).filter(|(c, k)| c.first == *k).count()
        };
        // As wide as long: every cell has its own place; half as wide: most have.
        assert_eq!(places(vec3(3.0, 0.0, 0.0), vec3(1.5, 2.6, 0.0), 9), 81);
        assert!(places(Vec3::X, Vec3::Z, 16) >= 192);
        assert_eq!(places(Vec3::X, Vec3::Z, 1), 1);
        // 100 times as long as wide: about as many places as squares of half a cell's edge would cover it.
        for (a, b) in [(Vec3::X, 0.01 * Vec3::Z), (0.01 * Vec3::Y, Vec3::X), (Vec3::X, vec3(1.0, 0.01, 0.0))] {
            let count = places(a, b, 50);
            assert!((80..=200).contains(&count), "{count} of 2,500 cells");
        }
    }
}
