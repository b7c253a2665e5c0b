//! The plain voxelisation proxy, a baseline: the scene is replaced by the sides of the voxels that its surface crosses.
//!
//! A voxel is occupied where triangles have area inside it (each triangle is cut at the half-open voxels exactly, so a
//! surface in the plane between two voxels occupies one of them). The side of an occupied voxel is a face where the
//! voxel beyond is empty. A face is one flat patch: a square of two triangles with the mean reflectance of the surface
//! in its voxel, and with emission of the same power. A point of the true surface takes its light from the face of its
//! voxel that agrees best with its normal.
//!
//! What it cannot do is its lesson: rooms shrink by about a voxel, slanted walls become stairs with 3/2 of the area,
//! gaps below a voxel close, and both sides of a thing thinner than a voxel move away from each other.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use scene::gpu::{Triangle, TriangleUv};
use scene::host::clip::{Layers, Polygon, cut_triangle};
use scene::sampling::hammersley;
use scene::{Hit, Material, NONE, Scene, SceneParts, SurfacePoint};

use reference::Error;

/// Voxels of a grid at most, empty ones included.
pub const VOXEL_LIMIT: u64 = 1 << 31;
/// Surfaces that fill less than this share of a voxel's side do not occupy it.
const MIN_SHARE: f64 = 1e-9;
/// Margin between the scene and the grid's outside, in voxel edges.
const MARGIN: f64 = 1e-3;
/// Points by which a clipped triangle with holes or with a picture of its emission is measured.
const CLIPPED_POINTS: u32 = 16;
/// Parts that face a side count alone if they hold this share of the voxel's surface.
const FACING_SHARE: f64 = 1e-6;
/// Directions of the faces of a voxel: axis and sign.
const SIDES: [(usize, f32); 6] = [(0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0), (2, -1.0), (2, 1.0)];
/// Most grids that [`VoxelProxy::for_count`] tries.
const TRIES: u32 = 16;
/// Most that it changes the edge by at once: voxels so large that they close a room say little of how many smaller ones
/// make.
const MAX_STEP: f64 = 2.0;

/// A face of the proxy: a square with [`VoxelProxy::edge`] as its side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProxyFace {
    /// Its centre, m.
    pub centre: Vec3,
    /// Unit normal, out of the voxel.
    pub normal: Vec3,
    /// Mean reflectance ρ of the surface in the voxel, weighted by area and by the square of its normal along this one,
    /// fronts only; of all surface in the voxel where no front faces this way.
    pub albedo: Vec3,
    /// Emitted radiance, W/m²/sr: that of the surface that finds its face here, times its area over the face's.
    pub radiance: Vec3,
    /// Voxel (i, j, k).
    voxel: [u32; 3],
    /// Position in [`SIDES`].
    side: usize,
}

/// Interpolation of light between faces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProxyLookup {
    /// Constant on a face.
    #[default]
    Face,
    /// Bilinear between the four like faces of the same layer round the point; those that are there.
    Bilinear,
}

/// A scene made of voxel faces.
#[derive(Clone)]
pub struct VoxelProxy {
    /// The faces as geometry, two triangles each (`source` is twice the face, or one more; material = face), with the
    /// lights and the sky of the scene.
    pub scene: Scene,
    /// The faces.
    pub faces: Vec<ProxyFace>,
    /// Edge of a voxel, m.
    pub edge: f32,
    layers: [Layers; 3],
    /// Occupied voxels, rising.
    occupied: Vec<u64>,
    /// Faces of each by side, or [`NONE`].
    sides: Vec<[u32; 6]>,
}

/// The part of a triangle in a voxel.
struct ClippedTriangle {
    voxel: u64,
    centroid: Vec3,
    normal: Vec3,
    /// Without holes, m².
    area: f64,
    albedo: Vec3,
    radiance: Vec3,
}

impl VoxelProxy {
    /// The faces of cubic voxels with this edge, m, in a grid that is centred on the scene. On all cores; time and
    /// memory grow with triangles + clipped triangles.
    ///
    /// # Errors
    /// [`Error::Setting`] for an edge that is not positive and finite, or so small that there are more voxels than
    /// [`VOXEL_LIMIT`]; [`Error::Scene`] for a scene without area.
    pub fn new(scene: &Scene, edge: f32) -> Result<Self, Error> {
        let layers = layers(scene, edge)?;
        let mut clipped = clipped_triangles(scene, &layers);
        // Stable: within a voxel in the order of the triangles.
        clipped.sort_by_key(|p| p.voxel);
        let mut proxy = Self {
            scene: scene.clone(),
            faces: Vec::new(),
            edge,
            layers,
            occupied: clipped.iter().map(|p| p.voxel).collect(),
            sides: Vec::new(),
        };
        proxy.occupied.dedup();
        for group in clipped.chunk_by(|a, b| a.voxel == b.voxel) {
            proxy.add_voxel(group);
        }
        let area = f64::from(edge) * f64::from(edge);
        for triangle in clipped.iter().filter(|p| p.radiance != Vec3::ZERO) {
            if let Some(face) = proxy.face_at(triangle.centroid, triangle.normal) {
                proxy.faces[face as usize].radiance += triangle.radiance * (triangle.area / area) as f32;
            }
        }
        proxy.scene = proxy.geometry(scene)?;
        Ok(proxy)
    }

    /// The proxy for which `count` (faces, say) comes nearest to `target`: bisection of the edge, down to 2 % or 16
    /// grids.
    ///
    /// # Errors
    /// As [`VoxelProxy::new`]; [`Error::Setting`] for a target of 0.
    pub fn for_count(scene: &Scene, target: usize, count: impl Fn(&Self) -> usize) -> Result<Self, Error> {
        if target == 0 {
            return Err(Error::Setting { name: "number of faces", value: 0.0, rule: "at least 1" });
        }
        let area: f64 = scene.geometry.triangles.iter().map(|t| Polygon::of_triangle(t).area()).sum();
        let longest = f64::from((scene.geometry.bounds.1 - scene.geometry.bounds.0).max_element());
        // Faces are about as many as edge⁻² times the area.
        let mut small = longest * 1e-3;
        let mut large = longest * 2.0;
        let mut edge = (2.0 * area / target as f64).sqrt().clamp(small, large);
        let mut best: Option<(f64, Self)> = None;
        for _ in 0..TRIES {
            let proxy = Self::new(scene, edge as f32)?;
            let ratio = count(&proxy).max(1) as f64 / target as f64;
            let distance = ratio.ln().abs();
            if best.as_ref().is_none_or(|(least, _)| distance < *least) {
                best = Some((distance, proxy));
            }
            if (ratio - 1.0).abs() < 0.02 {
                break;
            }
            *(if ratio > 1.0 { &mut small } else { &mut large }) = edge;
            let estimate = edge * ratio.sqrt().clamp(1.0 / MAX_STEP, MAX_STEP);
            let inside = estimate > small * 1.000_1 && estimate < large * 0.999_9;
            edge = if inside { estimate } else { (small * large).sqrt() };
        }
        // At least one grid was made.
        best.map(|(_, proxy)| proxy).ok_or(Error::Scene(scene::Error::NoTriangles))
    }

    /// Area of a face, m².
    pub fn face_area(&self) -> f32 {
        self.edge * self.edge
    }

    /// `per_edge²` points on each face, face by face: centres of as many squares. `patch` is the face, weights sum to 1
    /// on a face.
    pub fn points(&self, per_edge: u32) -> Vec<SurfacePoint> {
        let step = self.edge / per_edge.max(1) as f32;
        let place = |k: u32| (k as f32 + 0.5) * step - 0.5 * self.edge;
        let mut points = Vec::with_capacity(self.faces.len() * (per_edge * per_edge) as usize);
        for (face, patch) in self.faces.iter().zip(0..) {
            let (a, b) = across(face.side);
            for k in 0..per_edge * per_edge {
                let position = face.centre + a * place(k % per_edge) + b * place(k / per_edge);
                let weight = 1.0 / (per_edge * per_edge) as f32;
                points.push(SurfacePoint { position, patch, normal: face.normal, weight });
            }
        }
        points
    }

    /// Leaves faces out of the lookup: those to which no light comes, say. They stay in the way of light.
    pub fn hide_faces(&mut self, is_hidden: impl Fn(u32) -> bool) {
        for face in self.sides.iter_mut().flatten().filter(|f| **f != NONE) {
            if is_hidden(*face) {
                *face = NONE;
            }
        }
    }

    /// The face that a ray in this direction met from outside; [`NONE`] for a miss, and inside of a voxel.
    pub fn face_of(&self, hit: &Hit, direction: Vec3) -> u32 {
        if hit.is_miss() {
            return NONE;
        }
        let face = self.scene.geometry.triangles[hit.triangle as usize].source / 2;
        if self.faces[face as usize].normal.dot(direction) < 0.0 { face } else { NONE }
    }

    /// The face that lights a point x of the true surface on the side of its normal n: of the faces of its voxel with
    /// n·e > 0 (e the face's normal) that with the greatest n·e. Where there is none, the same among the voxels round
    /// it, in shells of growing distance; the nearest centre decides between equals. `None` for a normal that is no
    /// direction.
    pub fn face_at(&self, position: Vec3, normal: Vec3) -> Option<u32> {
        if !(position.is_finite() && normal.is_finite()) || normal == Vec3::ZERO {
            return None;
        }
        let home = [0, 1, 2].map(|a| i64::from(self.layers[a].layer_of(f64::from(position[a]))));
        let widest = self.layers.iter().map(|l| i64::from(l.count)).max().unwrap_or(0);
        (0..widest).find_map(|radius| {
            let mut best: Option<(f32, f32, u32)> = None;
            self.for_shell(home, radius, |faces| {
                for &face in faces.iter().filter(|&&f| f != NONE) {
                    let f = &self.faces[face as usize];
                    let agreement = f.normal.dot(normal);
                    let distance = f.centre.distance_squared(position);
                    if agreement > 0.0 && best.is_none_or(|b| (agreement, -distance) > (b.0, -b.1)) {
                        best = Some((agreement, distance, face));
                    }
                }
            });
            best.map(|(_, _, face)| face)
        })
    }

    /// Faces and weights, sum 1, of which a point takes its light; unused places have weight 0. `None` as
    /// [`VoxelProxy::face_at`].
    pub fn weights_at(&self, position: Vec3, normal: Vec3, lookup: ProxyLookup) -> Option<[(u32, f32); 4]> {
        let nearest = self.face_at(position, normal)?;
        let mut weights = [(nearest, 0.0); 4];
        if lookup == ProxyLookup::Face {
            weights[0].1 = 1.0;
            return Some(weights);
        }
        let face = &self.faces[nearest as usize];
        let (a, b) = across(face.side);
        // A point beyond the face's edge, whose own voxel has no such face, counts as on the edge.
        let place = |axis: Vec3| ((position - face.centre).dot(axis) / self.edge).clamp(-0.5, 0.5);
        let x = place(a);
        let y = place(b);
        let mut sum = 0.0;
        for (k, entry) in weights.iter_mut().enumerate() {
            let dx = k & 1;
            let dy = k >> 1;
            let step = a * (dx as f32 * x.signum()) + b * (dy as f32 * y.signum());
            let voxel = [0, 1, 2].map(|axis| i64::from(face.voxel[axis]) + step[axis] as i64);
            let Some(faces) = self.faces_of(voxel) else { continue };
            if faces[face.side] != NONE {
                let share = |d: usize, x: f32| if d == 1 { x.abs() } else { 1.0 - x.abs() };
                *entry = (faces[face.side], share(dx, x) * share(dy, y));
                sum += entry.1;
            }
        }
        weights.iter_mut().for_each(|w| w.1 /= sum);
        Some(weights)
    }

    /// A value of each face (`[faces]`) at a point of the true surface on the side of its normal.
    ///
    /// # Errors
    /// [`Error::Count`]; [`Error::NoDirection`] for a normal that is no direction.
    pub fn value_at(&self, values: &[Vec3], position: Vec3, normal: Vec3, lookup: ProxyLookup) -> Result<Vec3, Error> {
        if values.len() != self.faces.len() {
            return Err(Error::Count { of: "proxy faces", expected: self.faces.len(), found: values.len() });
        }
        let weights = self.weights_at(position, normal, lookup).ok_or(Error::NoDirection { position, normal })?;
        Ok(weights.iter().map(|&(face, weight)| values[face as usize] * weight).sum())
    }

    /// Adds the faces of the voxel that these clipped triangles are in.
    fn add_voxel(&mut self, clipped: &[ClippedTriangle]) {
        let voxel = coordinates(&self.layers, clipped[0].voxel);
        let mut faces = [NONE; 6];
        let area: f64 = clipped.iter().map(|p| p.area).sum();
        for (side, &(axis, sign)) in SIDES.iter().enumerate() {
            let mut beyond = voxel.map(i64::from);
            beyond[axis] += sign as i64;
            if self.slot_of(beyond).is_some() {
                continue;
            }
            let mut normal = Vec3::ZERO;
            normal[axis] = sign;
            let mean = |weight: &dyn Fn(&ClippedTriangle) -> f64| {
                let total: f64 = clipped.iter().map(weight).sum();
                let sum: DVec3 = clipped.iter().map(|p| p.albedo.as_dvec3() * weight(p)).sum();
                (total, (sum / total).as_vec3())
            };
            let (facing, albedo) = mean(&|p| p.area * f64::from(p.normal.dot(normal).max(0.0)).powi(2));
            let albedo = if facing > FACING_SHARE * area { albedo } else { mean(&|p| p.area).1 };
            let low = [0, 1, 2].map(|a| self.layers[a].origin + f64::from(voxel[a]) * self.layers[a].edge);
            let mut centre = DVec3::from_array(low) + 0.5 * f64::from(self.edge);
            centre[axis] += 0.5 * f64::from(sign) * f64::from(self.edge);
            faces[side] = self.faces.len() as u32;
            self.faces.push(ProxyFace { centre: centre.as_vec3(), normal, albedo, radiance: Vec3::ZERO, voxel, side });
        }
        self.sides.push(faces);
    }

    /// The faces as a scene with the lights of another.
    fn geometry(&self, original: &Scene) -> Result<Scene, scene::Error> {
        let mut parts = SceneParts {
            lights: original.lighting.lights.clone(),
            sky: original.lighting.sky,
            sky_map: original.lighting.sky_map.to_vec(),
            distributions: original.lighting.distributions.to_vec(),
            ..SceneParts::default()
        };
        for (face, number) in self.faces.iter().zip(0..) {
            let (a, b) = across(face.side);
            let a = a * self.edge;
            let b = b * self.edge;
            let corner = face.centre - 0.5 * (a + b);
            for (half, (edge_a, edge_b)) in [(a, a + b), (a + b, b)].into_iter().enumerate() {
                let source = 2 * number + half as u32;
                parts.triangles.push(Triangle { corner, material: number, edge_a, source, edge_b, object: 0 });
                parts.uvs.push(TriangleUv::default());
            }
            parts.materials.push(Material { albedo: face.albedo, radiance: face.radiance, ..Material::default() });
        }
        Scene::new(parts)
    }

    /// Place of a voxel among the occupied ones.
    fn slot_of(&self, voxel: [i64; 3]) -> Option<usize> {
        let inside = |a: usize| (0..i64::from(self.layers[a].count)).contains(&voxel[a]);
        if !(inside(0) && inside(1) && inside(2)) {
            return None;
        }
        self.occupied.binary_search(&number(&self.layers, voxel.map(|c| c as u32))).ok()
    }

    fn faces_of(&self, voxel: [i64; 3]) -> Option<&[u32; 6]> {
        self.slot_of(voxel).map(|slot| &self.sides[slot])
    }

    /// Gives the faces of every occupied voxel at this distance (greatest of the three axes') to `take`.
    fn for_shell(&self, home: [i64; 3], radius: i64, mut take: impl FnMut(&[u32; 6])) {
        let range = -radius..=radius;
        for x in range.clone() {
            for y in range.clone() {
                // Only the two ends, unless x or y is one already.
                let on_shell = x.abs() == radius || y.abs() == radius;
                let step = if on_shell { 1 } else { 2 * radius.max(1) };
                for z in range.clone().step_by(step as usize) {
                    if let Some(faces) = self.faces_of([home[0] + x, home[1] + y, home[2] + z]) {
                        take(faces);
                    }
                }
            }
        }
    }
}

/// Unit vectors along a face of this side, so that the first × the second is its normal.
fn across(side: usize) -> (Vec3, Vec3) {
    let (axis, sign) = SIDES[side];
    let a = Vec3::AXES[(axis + 1) % 3];
    let b = Vec3::AXES[(axis + 2) % 3];
    if sign > 0.0 { (a, b) } else { (b, a) }
}

fn number(layers: &[Layers; 3], voxel: [u32; 3]) -> u64 {
    let [i, j, k] = voxel.map(u64::from);
    i + u64::from(layers[0].count) * (j + u64::from(layers[1].count) * k)
}

fn coordinates(layers: &[Layers; 3], voxel: u64) -> [u32; 3] {
    let x = u64::from(layers[0].count);
    let y = u64::from(layers[1].count);
    [(voxel % x) as u32, (voxel / x % y) as u32, (voxel / (x * y)) as u32]
}

/// The grid: as many voxels as cover the scene with a little margin, centred on it.
fn layers(scene: &Scene, edge: f32) -> Result<[Layers; 3], Error> {
    let setting = |rule| Error::Setting { name: "voxel edge", value: f64::from(edge), rule };
    if !(edge.is_finite() && edge > 0.0) {
        return Err(setting("positive and finite"));
    }
    let edge = f64::from(edge);
    let low = scene.geometry.bounds.0.as_dvec3();
    let high = scene.geometry.bounds.1.as_dvec3();
    let counts = ((high - low) / edge + 2.0 * MARGIN).ceil().max(DVec3::ONE);
    if counts.element_product() > VOXEL_LIMIT as f64 {
        return Err(setting("large enough for at most 2^31 voxels"));
    }
    let origin = 0.5 * (low + high - counts * edge);
    Ok([0, 1, 2].map(|a| Layers { origin: origin[a], edge, count: counts[a] as u32 }))
}

/// Geometry in each voxel, triangle by triangle.
fn clipped_triangles(scene: &Scene, layers: &[Layers; 3]) -> Vec<ClippedTriangle> {
    let geometry = scene.tables();
    let least = MIN_SHARE * layers[0].edge * layers[0].edge;
    (0..scene.geometry.triangles.len() as u32)
        .into_par_iter()
        .flat_map_iter(|triangle| {
            let mut own = Vec::new();
            cut_triangle(&scene.geometry.triangles[triangle as usize], layers, |cell, part| {
                let whole = part.area();
                if whole <= least {
                    return;
                }
                let (share, radiance) = measure(scene, triangle, part);
                let area = whole * f64::from(share);
                let centroid = part.centroid().as_vec3();
                if area > least {
                    own.push(ClippedTriangle {
                        voxel: number(layers, cell),
                        centroid,
                        normal: geometry.normal(triangle),
                        area,
                        albedo: scene.filtered_albedo(triangle, centroid, whole as f32),
                        radiance,
                    });
                }
            });
            own
        })
        .collect()
}

/// Share of a clipped triangle that is no hole, and the mean radiance of that share.
fn measure(scene: &Scene, triangle: u32, part: &Polygon) -> (f32, Vec3) {
    let material = &scene.materials[scene.geometry.triangles[triangle as usize].material as usize];
    if material.mask_texture == NONE && material.radiance_texture == NONE {
        return (1.0, material.radiance);
    }
    let geometry = scene.tables();
    let mut count = 0.0;
    let mut radiance = Vec3::ZERO;
    for k in 0..CLIPPED_POINTS {
        let (u, v) = scene.shares(triangle, part.point(hammersley(k, CLIPPED_POINTS, (0, 0))).as_vec3());
        if !geometry.is_hole(triangle, u, v) {
            count += 1.0;
            radiance += geometry.radiance(triangle, u, v);
        }
    }
    (count / CLIPPED_POINTS as f32, radiance / count.max(1.0))
}
