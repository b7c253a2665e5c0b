//! Pictures that show what a bake made: who owns a place, what it sends, and where light is gathered. The ray through
//! the middle of each pixel decides; it is cast on the host.

use colorous::VIRIDIS;
use glam::{Vec3, Vec4};
use patches::{Density, Nearest, Sample};
use rayon::prelude::*;
use scene::kernel::camera::{camera_direction, surface_point};
use scene::kernel::shade::decode_srgb;
use scene::math::ln;
use scene::sampling::{hash3, unit};
use scene::{Camera, Hit, NONE, Scene, SurfacePoint, Visibility, scale_to_stops};
use transport::kernel::grid::{interpolate, place_in_cell};

use patches::{MeshReceivers, PatchMesh};

use crate::error::Error;
use crate::picture::Picture;

/// Surfaces seen edge-on keep this share of their colour.
const EDGE_ON: f32 = 0.35;
/// Brightness of a colour where the cells of the receivers' mesh meet.
const LINE: f32 = 0.45;
/// Receivers whose distances give that about a pixel.
const ABOUT: usize = 3;
/// Furthest of them, in mean distances.
const FAR: f32 = 4.0;
/// Distances from 2^−[`OCTAVES`] to 2^[`OCTAVES`] times the mean have colours of their own.
const OCTAVES: f32 = 2.0;
/// Colours of the directions +x, −x, +y, −y, +z, −z.
const AXES: [Vec3; 6] = [
    Vec3::new(0.85, 0.05, 0.03),
    Vec3::new(0.02, 0.6, 0.65),
    Vec3::new(0.1, 0.6, 0.04),
    Vec3::new(0.6, 0.06, 0.6),
    Vec3::new(0.04, 0.12, 0.85),
    Vec3::new(0.85, 0.65, 0.03),
];

/// A picture to be shown with an exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct DebugPicture {
    /// Subject of the picture, a file name without ending.
    pub name: &'static str,
    /// Linear colours.
    pub picture: Picture,
    /// Exposure, stops.
    pub stops: f32,
}

/// Debug view of a bake and its last frame.
pub struct DebugView<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its patches and elements.
    pub mesh: &'a PatchMesh,
    /// Its receivers.
    pub receivers: &'a MeshReceivers,
    /// First exitance E of the patches, W/m².
    pub source: &'a [Vec4],
    /// Irradiance H of the patches, W/m².
    pub irradiance: &'a [Vec4],
    /// Who looks.
    pub camera: &'a Camera,
    /// Exposure of the scene's pictures, stops.
    pub stops: f32,
}

/// First hit of the ray through the middle of a pixel.
#[derive(Clone, Copy)]
struct Seen {
    hit: Hit,
    point: SurfacePoint,
    element: u32,
    patch: u32,
    /// Brightness by which shape can be read.
    facing: f32,
}

/// Subject of a [`DebugPicture`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DebugKind {
    /// A colour for each patch.
    Patches,
    /// A colour for each element.
    Elements,
    /// The axis of the normal of each patch.
    Axis,
    /// First exitance E of the patches, as the radiance that it is seen as.
    Source,
    /// Irradiance H of the patches.
    Irradiance,
    /// Distance between receivers.
    Refined,
    /// A colour for each receiver, and the cells of their mesh.
    Receivers,
}

impl DebugKind {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Patches, Self::Elements, Self::Axis, Self::Source, Self::Irradiance, Self::Refined, Self::Receivers];

    /// A file name without ending.
    pub fn name(self) -> &'static str {
        match self {
            Self::Patches => "patches",
            Self::Elements => "elements",
            Self::Axis => "axis",
            Self::Source => "source",
            Self::Irradiance => "irradiance",
            Self::Refined => "refined",
            Self::Receivers => "receivers",
        }
    }

    /// Returns true if there is something to show of patches and receivers.
    pub fn suits(self, mesh: &PatchMesh, receivers: &MeshReceivers) -> bool {
        match self {
            Self::Elements => mesh.elements.len() > mesh.patches.len(),
            Self::Refined | Self::Receivers => !receivers.points.is_empty(),
            _ => true,
        }
    }
}

impl DebugView<'_> {
    /// The pictures that make sense for these patches and receivers.
    pub fn pictures(&self) -> Result<Vec<DebugPicture>, Error> {
        let seen = self.seen();
        let kinds = DebugKind::ALL.into_iter().filter(|kind| kind.suits(self.mesh, self.receivers));
        kinds.map(|kind| self.picture_of(kind, &seen)).collect()
    }

    /// One of them.
    pub fn picture(&self, kind: DebugKind) -> Result<DebugPicture, Error> {
        self.picture_of(kind, &self.seen())
    }

    fn picture_of(&self, kind: DebugKind, seen: &[Option<Seen>]) -> Result<DebugPicture, Error> {
        let of_patch = |s: &Seen| (s.patch != NONE).then_some(s.patch as usize);
        let axis = |s: &Seen| of_patch(s).map_or(Vec3::ZERO, |patch| axis_colour(self.mesh.patches[patch].normal));
        let light = |light: &[Vec4], s: &Seen| of_patch(s).map_or(Vec3::ZERO, |patch| light[patch].truncate());
        match kind {
            DebugKind::Patches => self.coloured(kind, seen, Some(0.0), &|s| colour_of(s.patch) * s.facing),
            DebugKind::Elements => self.coloured(kind, seen, Some(0.0), &|s| colour_of(s.element) * s.facing),
            DebugKind::Axis => self.coloured(kind, seen, Some(0.0), &|s| axis(s) * s.facing),
            // Exitance as the radiance that it is seen as.
            DebugKind::Source => {
                let radiance = |s: &Seen| light(self.source, s) * std::f32::consts::FRAC_1_PI;
                self.coloured(kind, seen, Some(self.stops), &radiance)
            }
            DebugKind::Irradiance => self.coloured(kind, seen, None, &|s| light(self.irradiance, s)),
            DebugKind::Refined => {
                let spacing = Spacing::new(self.receivers, self.mesh.areas().iter().sum());
                self.coloured(kind, seen, Some(0.0), &|s| spacing.colour(&s.point))
            }
            DebugKind::Receivers => self.receiver_cells(seen),
        }
    }

    /// A picture of a colour for each pixel; without stops, exposed by its brightness.
    fn coloured(
        &self,
        kind: DebugKind,
        seen: &[Option<Seen>],
        stops: Option<f32>,
        colour: &(dyn Fn(&Seen) -> Vec3 + Sync),
    ) -> Result<DebugPicture, Error> {
        let pixels = seen.par_iter().map(|seen| seen.as_ref().map_or(Vec3::ZERO, colour)).collect();
        let picture = Picture::from_pixels(self.camera.width, self.camera.height, pixels)?;
        let stops = stops.unwrap_or_else(|| scale_to_stops(exposure(&picture)));
        Ok(DebugPicture { name: kind.name(), picture, stops })
    }

    fn receiver_cells(&self, seen: &[Option<Seen>]) -> Result<DebugPicture, Error> {
        let shown: Vec<Option<Shown>> =
            seen.par_iter().map(|s| s.as_ref().and_then(|s| shown(self.receivers, self.scene, s))).collect();
        let width = self.camera.width as usize;
        let pixel = |k: usize| {
            let (Some(seen), Some(own)) = (seen[k], shown[k]) else { return Vec3::ZERO };
            let is_border = |other: usize| shown.get(other).is_some_and(|o| o.map(|o| o.cell) != Some(own.cell));
            let line = !(k + 1).is_multiple_of(width) && is_border(k + 1) || is_border(k + width);
            colour_of(own.receiver) * seen.facing * if line { LINE } else { 1.0 }
        };
        let pixels = (0..shown.len()).into_par_iter().map(pixel).collect();
        let picture = Picture::from_pixels(self.camera.width, self.camera.height, pixels)?;
        Ok(DebugPicture { name: DebugKind::Receivers.name(), picture, stops: 0.0 })
    }

    fn seen(&self) -> Vec<Option<Seen>> {
        let geometry = self.scene.tables();
        let camera = self.camera;
        let pixel = |k: u32| {
            let x = k % camera.width;
            let y = k / camera.width;
            let direction = camera_direction(camera, x as f32 + 0.5, y as f32 + 0.5).normalize();
            let hit = self.scene.closest(camera.eye, direction);
            let point = surface_point(&geometry, hit, direction);
            let facing = EDGE_ON + (1.0 - EDGE_ON) * -direction.dot(point.normal);
            (!hit.is_miss()).then(|| Seen {
                hit,
                point,
                element: self.mesh.element(self.scene, &hit, direction),
                patch: self.mesh.patch(self.scene, &hit, direction),
                facing,
            })
        };
        (0..camera.width * camera.height).into_par_iter().map(pixel).collect()
    }
}

/// Exposure by 0.18 over the log-average luminance; 1 for a black picture.
fn exposure(picture: &Picture) -> f32 {
    let average = picture.log_average_luminance();
    if average > 0.0 { 0.18 / average } else { 1.0 }
}

/// A colour for a number; black for [`NONE`].
fn colour_of(number: u32) -> Vec3 {
    if number == NONE {
        return Vec3::ZERO;
    }
    let channel = |c| 0.03 + 0.97 * unit(hash3(number, c, 0x636f_6c6f)).powi(2);
    Vec3::new(channel(0), channel(1), channel(2))
}

/// The colour of the axis to which a direction is nearest.
fn axis_colour(normal: Vec3) -> Vec3 {
    let axis = normal.abs().max_position();
    AXES[2 * axis + usize::from(normal[axis] < 0.0)]
}

/// Contribution of the receivers' mesh to a pixel.
#[derive(Clone, Copy)]
struct Shown {
    /// The receiver with the greatest weight, or [`NONE`].
    receiver: u32,
    /// Vertices round it: the same everywhere in a part of a cell.
    cell: [u32; 3],
}

fn shown(receivers: &MeshReceivers, scene: &Scene, seen: &Seen) -> Option<Shown> {
    let nodes = &receivers.interpolation;
    let grid = nodes.grids[seen.hit.triangle as usize];
    let front = scene.tables().normal(seen.hit.triangle).dot(seen.point.normal) > 0.0;
    let first = if front { grid.front } else { grid.back };
    if first == NONE {
        return None;
    }
    let (index, s, t) = place_in_cell(grid.divisions, seen.hit.u, seen.hit.v);
    let cell = nodes.cells[(first + index) as usize];
    if cell.first == NONE {
        return None;
    }
    let (ids, weights) = interpolate(cell.divisions, s, t);
    let cell = ids.to_array().map(|id| cell.first + id);
    let mut parts: Vec<(u32, f32)> = Vec::new();
    for (vertex, share) in cell.into_iter().zip(weights.to_array()) {
        let node = nodes.vertices[vertex as usize] as usize;
        for entry in receivers.weights.row(node) {
            let receiver = entry.receiver;
            let weight = share * entry.weight;
            match parts.iter_mut().find(|(other, _)| *other == receiver) {
                Some((_, sum)) => *sum += weight,
                None => parts.push((receiver, weight)),
            }
        }
    }
    let greatest = parts.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
    Some(Shown { receiver: greatest.map_or(NONE, |(receiver, _)| receiver), cell })
}

/// Distance between receivers.
struct Spacing {
    nearest: Nearest,
    /// Distance of each receiver to its neighbours, m.
    spacing: Vec<f32>,
    mean: f32,
}

impl Spacing {
    /// Spacing of receivers that share this area, m².
    fn new(receivers: &MeshReceivers, area: f32) -> Self {
        let points = &receivers.points;
        let area = area / points.len() as f32;
        let sample = |p: &SurfacePoint| Sample { position: p.position, normal: p.normal, area, ..Sample::default() };
        let nearest = Nearest::new(&points.iter().map(sample).collect::<Vec<_>>(), &Density::default());
        let distance = |p: &SurfacePoint| {
            // The first is the receiver itself.
            let (found, count) = nearest.samples::<{ ABOUT + 1 }>(p.position, p.normal, FAR);
            let sum: f32 = found[..count].iter().map(|f| points[f.0 as usize].position.distance(p.position)).sum();
            if count > 1 { sum / (count - 1) as f32 } else { scene::math::sqrt(area) }
        };
        let spacing: Vec<f32> = points.par_iter().map(distance).collect();
        let mean = spacing.iter().sum::<f32>() / spacing.len() as f32;
        Self { nearest, spacing, mean }
    }

    /// Yellow where receivers stand closest; black where none is near.
    fn colour(&self, point: &SurfacePoint) -> Vec3 {
        let (found, count) = self.nearest.samples::<ABOUT>(point.position, point.normal, FAR);
        if count == 0 {
            return Vec3::ZERO;
        }
        let here = found[..count].iter().map(|f| self.spacing[f.0 as usize]).sum::<f32>() / count as f32;
        let share = 0.5 - 0.5 * ln(here / self.mean) / (OCTAVES * std::f32::consts::LN_2);
        let colour = VIRIDIS.eval_continuous(f64::from(share.clamp(0.0, 1.0)));
        Vec3::new(f32::from(colour.r), f32::from(colour.g), f32::from(colour.b)).map(|code| decode_srgb(code / 255.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_and_numbers_have_colours_of_their_own() {
        assert_eq!(axis_colour(Vec3::new(0.1, -0.9, 0.2)), AXES[3]);
        assert_eq!(axis_colour(Vec3::new(0.8, 0.3, 0.2)), AXES[0]);
        assert_eq!(colour_of(NONE), Vec3::ZERO);
        assert!((0..100).all(|k| colour_of(k) != colour_of(k + 1) && colour_of(k).min_element() > 0.0));
    }
}
