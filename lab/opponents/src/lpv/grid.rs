//! Cells that hold light as intensity in two bands of spherical harmonics, blockers between them, and how light goes on
//! from cell to cell (Kaplanyan and Dachsbacher 2010, sections 4 and 5).

use std::f32::consts::{FRAC_1_PI, PI};

use glam::{IVec3, Mat4, Vec3, Vec4, Vec4Swizzles};
use rayon::prelude::*;
use scene::sampling::{hammersley, uniform_triangle};
use scene::{NONE, Scene};

use super::shadow_map::VirtualLight;
use crate::harmonics::{cosine_lobe, two_bands};

/// Solid angles in which a cell sees the farther face of a neighbour, and each of its four sides, sr: a sixth of the
/// sphere in all.
const FAR_FACE: f32 = 0.400_669_7;
const SIDE_FACE: f32 = (4.0 * PI / 6.0 - FAR_FACE) / 4.0;
/// Samples of surface for each area of a cell's face.
const SAMPLES_A_FACE: f32 = 16.0;
/// Samples of a triangle at most.
const MAX_SAMPLES: f32 = 65_536.0;
/// Light goes along the axes only: isotropic light is in a cell 3/2 times as long as light along an axis.
const DETOUR: f32 = 2.0 / 3.0;

/// Intensity, W/sr, of red, green and blue in two bands.
pub type Intensity = [Vec4; 3];
const DARK: Intensity = [Vec4::ZERO; 3];
/// The six ways out of a cell.
const WAYS: [IVec3; 6] = [IVec3::X, IVec3::NEG_X, IVec3::Y, IVec3::NEG_Y, IVec3::Z, IVec3::NEG_Z];

/// A face of a neighbour as its cell sees it.
#[derive(Clone, Copy)]
struct Face {
    direction: Vec3,
    solid_angle: f32,
    /// Outward normal of the face.
    normal: Vec3,
}

/// Surface between two cells.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Blocker {
    /// Share of light that is stopped, in two bands over the direction it comes from.
    lobe: Vec4,
    albedo: Vec3,
    /// Two bands of what it sends on for each watt it reflects, 1/sr.
    reflected: Vec4,
}

/// Blockers between cells: an index for each face, axis by axis.
struct Blockers {
    index: [Vec<u32>; 3],
    list: Vec<Blocker>,
}

/// Cells of equal size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    pub counts: IVec3,
    /// Edge of a cell, m.
    pub edge: f32,
    /// Least corner, m.
    pub low: Vec3,
}

impl Shape {
    pub fn count(&self) -> usize {
        self.counts.as_i64vec3().element_product() as usize
    }

    fn contains(&self, cell: IVec3) -> bool {
        cell.cmpge(IVec3::ZERO).all() && cell.cmplt(self.counts).all()
    }

    fn number(&self, cell: IVec3) -> usize {
        number_in(self.counts, cell)
    }

    fn cell(&self, number: usize) -> IVec3 {
        cell_in(self.counts, number)
    }

    /// Place in cells.
    fn place(&self, p: Vec3) -> Vec3 {
        (p - self.low) / self.edge
    }

    /// Distance of a point from the border, in cells; negative outside.
    pub fn depth(&self, p: Vec3) -> f32 {
        let place = self.place(p);
        place.min(self.counts.as_vec3() - place).min_element()
    }
}

fn number_in(counts: IVec3, cell: IVec3) -> usize {
    (cell.x + counts.x * (cell.y + counts.y * cell.z)) as usize
}

fn cell_in(counts: IVec3, number: usize) -> IVec3 {
    let x = counts.x as usize;
    let y = counts.y as usize;
    IVec3::new((number % x) as i32, (number / x % y) as i32, (number / (x * y)) as i32)
}

/// A grid of light with what blocks it.
pub struct Grid {
    pub shape: Shape,
    blockers: Blockers,
    /// Light that goes on in the next step, and light that came by in all steps, `[cells]`.
    moving: Vec<Intensity>,
    next: Vec<Intensity>,
    passed: Vec<Intensity>,
    /// Faces of the neighbour on each way, and what they make of intensity together where nothing blocks.
    faces: [[Face; 5]; 6],
    free: [Mat4; 6],
}

impl Grid {
    /// Grid of a scene, dark. `blocking` tells whether surfaces stop light, and if so, whether their backs count as
    /// fronts.
    pub fn new(scene: &Scene, shape: Shape, blocking: Option<bool>) -> Self {
        let faces = WAYS.map(faces_of);
        let free = faces.map(|faces| faces.iter().fold(Mat4::ZERO, |sum, face| sum + reprojection(face)));
        Self {
            shape,
            blockers: Blockers::new(scene, &shape, blocking),
            moving: vec![DARK; shape.count()],
            next: vec![DARK; shape.count()],
            passed: vec![DARK; shape.count()],
            faces,
            free,
        }
    }

    /// Bytes in the paper's formats: three volumes of halves for each of the three states, and blockers in bytes.
    pub fn bytes(&self) -> u64 {
        let corners = (self.shape.counts + 1).as_i64vec3().element_product() as u64;
        self.shape.count() as u64 * 3 * 24 + corners * 8
    }

    /// Forgets all light and takes in that of points, half a cell off their surfaces.
    pub fn inject(&mut self, lights: &[VirtualLight]) {
        self.moving.fill(DARK);
        self.passed.fill(DARK);
        for light in lights {
            let cell = self.shape.place(light.position + 0.5 * self.shape.edge * light.normal).floor().as_ivec3();
            if self.shape.contains(cell) {
                add_lobe(&mut self.moving[self.shape.number(cell)], light.flux, cosine_lobe(light.normal) * FRAC_1_PI);
            }
        }
    }

    /// Lets light go on by one cell. `is_first` lets it off the surfaces that it comes from; `reflects` sends on what
    /// surfaces reflect.
    pub fn step(&mut self, is_first: bool, reflects: bool) {
        let mut next = std::mem::take(&mut self.next);
        let mut passed = std::mem::take(&mut self.passed);
        let this = &*self;
        next.par_iter_mut().zip(&mut passed).enumerate().for_each(|(number, (next, passed))| {
            *next = this.arriving(number, is_first, reflects);
            (0..3).for_each(|channel| passed[channel] += next[channel]);
        });
        self.next = std::mem::replace(&mut self.moving, next);
        self.passed = passed;
    }

    /// Flux that is on its way, W.
    #[cfg(test)]
    fn moving_flux(&self) -> Vec3 {
        // The mean over the sphere is that of band 0: ∫ Y₀ = √(4π).
        let flux = |cell: &Intensity| Vec3::from_array([0, 1, 2].map(|channel| cell[channel].x));
        self.moving.iter().map(flux).sum::<Vec3>() * (4.0 * PI).sqrt()
    }

    /// Irradiance at a point, W/m²: what comes by a cell in front of it, trilinear. In the cell of the surface itself
    /// its own blockers have stopped a part.
    pub fn irradiance(&self, position: Vec3, normal: Vec3) -> Vec3 {
        let lobe = cosine_lobe(-normal) * (DETOUR / (self.shape.edge * self.shape.edge));
        let place = self.shape.place(position) + normal - 0.5;
        let base = place.floor();
        let share = place - base;
        let mut sum = Vec3::ZERO;
        for k in 0..8 {
            let step = IVec3::new(k & 1, k >> 1 & 1, k >> 2);
            let cell = (base.as_ivec3() + step).clamp(IVec3::ZERO, self.shape.counts - 1);
            let weight = Vec3::select(step.cmpeq(IVec3::ONE), share, 1.0 - share).element_product();
            let light = &self.passed[self.shape.number(cell)];
            sum += weight * Vec3::from_array([0, 1, 2].map(|channel| light[channel].dot(lobe)));
        }
        sum.max(Vec3::ZERO)
    }

    /// Light that reaches a cell from its neighbours, and from surfaces round it.
    fn arriving(&self, number: usize, is_first: bool, reflects: bool) -> Intensity {
        let cell = self.shape.cell(number);
        let mut sum = DARK;
        for (way, &step) in WAYS.iter().enumerate() {
            let from = cell - step;
            if self.shape.contains(from) {
                let light = &self.moving[self.shape.number(from)];
                if *light != DARK {
                    let blocker = if is_first { None } else { self.blockers.between(&self.shape, from, way) };
                    self.pass(light, way, blocker, &mut sum);
                }
            }
            if reflects
                && !is_first
                && self.moving[number] != DARK
                && let Some(blocker) = self.blockers.between(&self.shape, cell, way)
            {
                self.reflect(&self.moving[number], way, blocker, &mut sum);
            }
        }
        sum
    }

    fn pass(&self, light: &Intensity, way: usize, blocker: Option<&Blocker>, sum: &mut Intensity) {
        let Some(blocker) = blocker else {
            (0..3).for_each(|channel| sum[channel] += self.free[way] * light[channel]);
            return;
        };
        for face in &self.faces[way] {
            let flux = flux_through(light, face) * (1.0 - blocker.stops(face.direction));
            add_lobe(sum, flux, cosine_lobe(face.normal) * FRAC_1_PI);
        }
    }

    fn reflect(&self, light: &Intensity, way: usize, blocker: &Blocker, sum: &mut Intensity) {
        let mut stopped = Vec3::ZERO;
        for face in &self.faces[way] {
            stopped += flux_through(light, face) * blocker.stops(face.direction);
        }
        add_lobe(sum, stopped * blocker.albedo, blocker.reflected);
    }
}

/// Faces of the neighbour on a way, all but the one that is shared.
fn faces_of(way: IVec3) -> [Face; 5] {
    let mut faces = [Face { direction: way.as_vec3(), solid_angle: FAR_FACE, normal: way.as_vec3() }; 5];
    let sides = WAYS.into_iter().filter(|side| side.dot(way) == 0);
    for (face, side) in faces[1..].iter_mut().zip(sides) {
        let direction = (way.as_vec3() + 0.5 * side.as_vec3()).normalize();
        *face = Face { direction, solid_angle: SIDE_FACE, normal: side.as_vec3() };
    }
    faces
}

/// Flux through a face becomes a cosine lobe in its direction.
fn reprojection(face: &Face) -> Mat4 {
    let to = cosine_lobe(face.normal) * FRAC_1_PI;
    let from = two_bands(face.direction) * face.solid_angle;
    Mat4::from_cols(to * from.x, to * from.y, to * from.z, to * from.w)
}

#[inline]
fn flux_through(light: &Intensity, face: &Face) -> Vec3 {
    let bands = two_bands(face.direction) * face.solid_angle;
    Vec3::from_array([0, 1, 2].map(|channel| light[channel].dot(bands)))
}

#[inline]
fn add_lobe(sum: &mut Intensity, flux: Vec3, lobe: Vec4) {
    sum[0] += lobe * flux.x;
    sum[1] += lobe * flux.y;
    sum[2] += lobe * flux.z;
}

impl Blocker {
    /// Share of the light in this direction that is stopped.
    #[inline]
    fn stops(&self, direction: Vec3) -> f32 {
        self.lobe.dot(two_bands(-direction)).clamp(0.0, 1.0)
    }
}

impl Blockers {
    /// Surfaces are gathered at corners of cells, half a cell off the cells' centres; a face takes the mean of its four
    /// corners.
    fn new(scene: &Scene, shape: &Shape, blocking: Option<bool>) -> Self {
        let corners = shape.counts + 1;
        let at_corners = match blocking {
            Some(two_sided) => surfaces(scene, shape, two_sided),
            None => vec![(Vec4::ZERO, Vec4::ZERO); corners.as_i64vec3().element_product() as usize],
        };
        let mut list = Vec::new();
        let index = [0, 1, 2].map(|axis| {
            let counts = shape.counts + IVec3::AXES[axis];
            let a = IVec3::AXES[(axis + 1) % 3];
            let b = IVec3::AXES[(axis + 2) % 3];
            let mut of_face = |number: usize| {
                let first = cell_in(counts, number);
                let around = [first, first + a, first + b, first + a + b];
                let sum = around.into_iter().fold((Vec4::ZERO, Vec4::ZERO), |sum, corner| {
                    let surface = at_corners[number_in(corners, corner)];
                    (sum.0 + surface.0, sum.1 + surface.1)
                });
                if sum.1.w <= 0.0 {
                    return NONE;
                }
                let toward = sum.0.yzw().normalize_or_zero();
                // Surfaces that face all ways alike keep the constant band, which has all of the flux.
                let reflected = cosine_lobe(toward) * FRAC_1_PI;
                list.push(Blocker { lobe: 0.25 * sum.0, albedo: sum.1.xyz() / sum.1.w, reflected });
                list.len() as u32 - 1
            };
            (0..counts.as_i64vec3().element_product() as usize).map(&mut of_face).collect()
        });
        Self { index, list }
    }

    /// Blocker between a cell and the next one on a way.
    #[inline]
    fn between(&self, shape: &Shape, cell: IVec3, way: usize) -> Option<&Blocker> {
        let axis = way / 2;
        let face = if way.is_multiple_of(2) { cell + IVec3::AXES[axis] } else { cell };
        let index = self.index[axis][number_in(shape.counts + IVec3::AXES[axis], face)];
        (index != NONE).then(|| &self.list[index as usize])
    }
}

/// At each corner the lobes of the surface nearest to it, by area over that of a cell's face, and the sum of its albedo
/// with that of its areas.
fn surfaces(scene: &Scene, shape: &Shape, two_sided: bool) -> Vec<(Vec4, Vec4)> {
    let corners = shape.counts + 1;
    let tables = scene.tables();
    let mut sums = vec![(Vec4::ZERO, Vec4::ZERO); corners.as_i64vec3().element_product() as usize];
    for (triangle, t) in (0..).zip(&scene.geometry.triangles) {
        let area = 0.5 * t.edge_a.cross(t.edge_b).length() / (shape.edge * shape.edge);
        let count = (area * SAMPLES_A_FACE).ceil().clamp(1.0, MAX_SAMPLES) as u32;
        let part = area / count as f32;
        let normal = tables.normal(triangle);
        let mut lobe = cosine_lobe(normal) * part;
        if two_sided {
            lobe += cosine_lobe(-normal) * part;
        }
        for k in 0..count {
            let (u, v) = uniform_triangle(hammersley(k, count, (0, 0)));
            let corner = shape.place(tables.position(triangle, u, v)).round().as_ivec3();
            let is_inside = corner.cmpge(IVec3::ZERO).all() && corner.cmplt(corners).all();
            if is_inside && !tables.is_hole(triangle, u, v) {
                let sum = &mut sums[number_in(corners, corner)];
                sum.0 += lobe;
                sum.1 += tables.albedo(triangle, u, v).extend(1.0) * part;
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::gpu::{Triangle, TriangleUv};
    use scene::{Material, SceneParts};

    /// A black floor of 8 × 8 m.
    fn floor() -> Scene {
        let triangle = |edge_a: Vec3, edge_b: Vec3| Triangle { edge_a, edge_b, ..Triangle::default() };
        let corner = 8.0 * (Vec3::X + Vec3::Z);
        let parts = SceneParts {
            triangles: vec![triangle(corner, 8.0 * Vec3::X), triangle(8.0 * Vec3::Z, corner)],
            uvs: vec![TriangleUv::default(); 2],
            materials: vec![Material { albedo: Vec3::ZERO, ..Material::default() }],
            ..SceneParts::default()
        };
        Scene::new(parts).unwrap()
    }

    /// Flux after some steps from a light of 2 W in the middle of 9³ cells, 4.5 m above the floor.
    fn flux_after(steps: u32, blocking: Option<bool>) -> f32 {
        let shape = Shape { counts: IVec3::splat(9), edge: 1.0, low: Vec3::ZERO };
        let mut grid = Grid::new(&floor(), shape, blocking);
        let normal = Vec3::new(0.48, -0.64, 0.6);
        grid.inject(&[VirtualLight { position: Vec3::splat(4.5) - 0.5 * normal, normal, flux: Vec3::splat(2.0) }]);
        (0..steps).for_each(|step| grid.step(step == 0, true));
        grid.moving_flux().x
    }

    #[test]
    fn light_is_kept_until_it_leaves() {
        let is_kept = |flux: f32| (flux - 2.0).abs() < 1e-4;
        for steps in 0..=4 {
            assert!(is_kept(flux_after(steps, None)), "{steps}: {}", flux_after(steps, None));
        }
        // The border is four cells off.
        assert!(!is_kept(flux_after(5, None)), "light that leaves goes unnoticed");
        assert!(flux_after(200, None).abs() < 0.02, "{}", flux_after(200, None));
    }

    #[test]
    fn a_black_floor_takes_light() {
        // Nothing arrives in four steps. The floor is the border of the grid: light that arrives is stopped a step
        // before it would leave, so that a little less is under way.
        assert_eq!(flux_after(4, None).to_bits(), flux_after(4, Some(false)).to_bits());
        let free = flux_after(20, None);
        let stopped = flux_after(20, Some(false));
        assert!(stopped < 0.98 * free && stopped > 0.9 * free, "{stopped} of {free}");
    }
}
