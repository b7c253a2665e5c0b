//! The patches that send light, whatever they are made of: pieces of triangles, clusters of samples, or voxels.

use glam::{Vec2, Vec3, Vec4};
use patches::{
    AxisWeights, ClusterSettings, Grid, LitSampler, Lookup, LookupSettings, Member, Nearest, PatchSet, PatchSize,
    Sample, SampleSet, SampleSettings, SubdivideSettings, Subdivision, ViewSettings, VirtualPatch, axis_patches,
    cell_grids, cluster_patches, sample_voxels, subdivide, view_clusters,
};
use rayon::prelude::*;
use scene::sampling::hash3;
use scene::{Hit, NONE, Scene, SidePolicy, Sides, SurfacePoint, Triangle, is_open};
use transport::kernel::grid::owner;
use transport::{Owner, Patch, Polygon, Surfaces, TriangleGrid};

use super::sight::sees;
use crate::error::Error;

/// Largest number of patches: counts of hits name columns by 16 bits, and polygons' F is dense while it is balanced.
pub const MOST_PATCHES: usize = 65_535;
/// Sample points of a polygon patch: origins of its form-factor rays, and where its direct light is measured.
const POLYGON_POINTS: u32 = 16;
/// Cells a facet's edge: how finely triangles are looked up.
const CELLS: f32 = 1.5;
/// Most pieces along an edge of a triangle.
const MOST_DIVISIONS: f32 = 1024.0;
/// Patches that are not cut into facets are looked up as finely as if each had so many, up to [`MOST_PIECES`] in all.
const PIECES: usize = 6;
const MOST_PIECES: usize = 1 << 16;
/// Samples that are asked where light comes: for each patch, and at least and at most.
const PILOTS: usize = 6;
const LEAST_PILOTS: usize = 1 << 15;
const MOST_PILOTS: usize = 1 << 16;

/// A place has no patch when the nearest sample of like normal is further, in sample edges.
const FAR: f32 = 4.0;
/// Samples that are tried, the nearest first.
const TRIED: usize = 6;
/// The same where all of those differ by more than [`ALIKE`] in albedo.
const TRIED_UNLIKE: usize = 64;
const ALIKE: f32 = 0.25;
/// What a difference of 1 in albedo counts in the choice, in sample edges: what is thin and dark has few samples, and must not
/// shine like the bright wall beside it.
const UNLIKE: f32 = 10.0;
/// A sample nearer than this, in sample edges, need not be seen.
const TOUCHING: f32 = 0.2;
/// Walks by which a place that sees no sample looks for light.
const WALKS: u32 = 2;

/// What patches are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PatchKind {
    /// Triangles cut into like pieces.
    Polygon,
    /// Samples of the surface gathered by what they see: any mesh, in as many patches as wanted.
    #[default]
    Cluster,
    /// Samples of each voxel gathered where position and normal are alike.
    Voxel,
    /// Samples of each voxel shared out over the six directions of the axes.
    Axis,
}

impl PatchKind {
    /// Polygons where triangles are few and large beside the patches, else clusters.
    pub fn suited(triangles: usize, patches: usize) -> Self {
        if 4 * triangles < patches { Self::Polygon } else { Self::Cluster }
    }

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Polygon => "polygon",
            Self::Cluster => "cluster",
            Self::Voxel => "voxel",
            Self::Axis => "axis",
        }
    }

    /// Whether patches are bound to voxels, so that they have an edge and a lookup between them.
    pub fn has_voxels(self) -> bool {
        matches!(self, Self::Voxel | Self::Axis)
    }
}

/// What patches are made of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SenderSettings {
    /// What they are.
    pub kind: PatchKind,
    /// About how many.
    pub count: usize,
    /// Edge of the voxels, m, instead of the count.
    pub voxel_size: Option<f32>,
    /// Samples of a cluster, on average.
    pub samples: u32,
    /// Changes every random number.
    pub seed: u32,
}

/// The senders of a scene: patches, cut into facets, over which light is gathered more finely than patches send it.
#[derive(Clone)]
pub struct Senders {
    /// Centroid, area, normal.
    pub patches: Vec<Patch>,
    /// Mean albedo.
    pub albedo: Vec<Vec4>,
    /// Patch i owns the facets `patch_facets[i]..patch_facets[i + 1]`.
    pub patch_facets: Vec<u32>,
    /// The facets; those of polygon patches are the patches.
    pub facets: Vec<Patch>,
    /// Mean albedo of each facet.
    pub facet_albedo: Vec<Vec4>,
    /// Sample points, facet by facet; their weights are shares of the facet.
    pub points: Vec<SurfacePoint>,
    /// Albedo at each sample point.
    pub point_albedo: Vec<Vec4>,
    /// Facet f owns `points[offsets[f]..offsets[f + 1]]`.
    pub offsets: Vec<u32>,
    /// Samples that the points are taken from: each is one point or more.
    pub samples: usize,
    /// Outlines; only polygon patches have them.
    pub polygons: Vec<Polygon>,
    /// Values between patches; only voxel and axis patches have it.
    pub lookup: Option<Lookup>,
    /// Per triangle, the numbers of its cells.
    grids: Vec<TriangleGrid>,
    /// Facet of each cell; empty when cells are facets.
    cells: Vec<u32>,
}

/// What rays look for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Columns {
    /// Patches.
    Patches,
    /// Facets.
    Facets,
}

/// What knows where light comes, as finely as `count` patches need; nothing when it comes nowhere.
///
/// # Errors
/// What the sampler says.
pub fn lit_sampler(scene: &Scene, count: usize, seed: u32) -> Result<Option<LitSampler<'_>>, Error> {
    let pilots = count.saturating_mul(PILOTS).clamp(LEAST_PILOTS, MOST_PILOTS);
    match LitSampler::new(scene, pilots as u32, seed) {
        Ok(sampler) => Ok(Some(sampler)),
        Err(patches::Error::NoSamples) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

impl Senders {
    /// Patches of a scene. Without a sampler, where no light comes anywhere, clusters are polygons instead, and all sides have
    /// patches: both give a black picture.
    ///
    /// # Errors
    /// More patches than can be numbered; a voxel size for patches without voxels, or one that is not positive.
    pub fn new(scene: &Scene, sampler: Option<&LitSampler>, settings: &SenderSettings) -> Result<Self, Error> {
        let SenderSettings { kind, count, voxel_size, samples, seed } = *settings;
        if voxel_size.is_some() && !kind.has_voxels() {
            return Err(Error::NoVoxels { option: "--voxel-size", patches: kind.name(), instead: "--patch-count" });
        }
        match kind {
            PatchKind::Polygon => Self::polygons(scene, count, seed),
            PatchKind::Cluster => match sampler {
                Some(sampler) => Self::clusters(sampler, count, samples, seed),
                None => Self::polygons(scene, count, seed),
            },
            PatchKind::Voxel => Self::voxels(scene, sampler, count, voxel_size, seed, |grid, samples| {
                cluster_patches(grid, samples, &ClusterSettings::default(), &|_, _| 0.0)
            }),
            PatchKind::Axis => Self::voxels(scene, sampler, count, voxel_size, seed, |grid, samples| {
                axis_patches(grid, samples, AxisWeights::Squared)
            }),
        }
    }

    fn polygons(scene: &Scene, count: usize, seed: u32) -> Result<Self, Error> {
        let mut cut = SubdivideSettings {
            size: PatchSize::Count(count as u32),
            points: POLYGON_POINTS,
            seed,
            ..Default::default()
        };
        let mut subdivision = subdivide(scene, &cut)?;
        if subdivision.patches.is_empty() {
            cut.sides = SidePolicy::Front;
            subdivision = subdivide(scene, &cut)?;
        }
        let polygons = subdivision.polygons()?;
        let Subdivision { patches, grids, points, offsets, .. } = subdivision;
        let mut point_albedo = Vec::with_capacity(points.len());
        for (patch, range) in patches.iter().zip(offsets.windows(2)) {
            let own = &points[range[0] as usize..range[1] as usize];
            let area = patch.area / own.len().max(1) as f32;
            let albedo = |p: &SurfacePoint| scene.filtered_albedo(patch.triangle, p.position, area).extend(0.0);
            point_albedo.extend(own.iter().map(albedo));
        }
        let albedo = mean_albedo(&offsets, &points, &point_albedo);
        Ok(Self {
            patch_facets: (0..=patches.len() as u32).collect(),
            facets: patches.clone(),
            facet_albedo: albedo.clone(),
            patches,
            albedo,
            samples: points.len(),
            points,
            point_albedo,
            offsets,
            polygons,
            lookup: None,
            grids,
            cells: Vec::new(),
        })
    }

    fn clusters(sampler: &LitSampler, count: usize, samples: u32, seed: u32) -> Result<Self, Error> {
        let settings = ViewSettings { patches: count as u32, samples, seed, ..ViewSettings::default() };
        let found = view_clusters(sampler, &settings)?;
        // A facet is a range of samples.
        let members = (0..found.set.samples.len() as u32).map(|sample| Member { sample, weight: 1.0 }).collect();
        let no_voxels = vec![NONE; found.facets.len() - 1];
        let facets = PatchSet::from_groups(found.set.samples, &no_voxels, found.facets, members)?;
        Self::of_samples(sampler.scene(), facets, &found.set.patches, found.patch_facets)
    }

    /// Patches of voxels with the edge `voxel_size`, or with that which gives about `count` patches.
    fn voxels(
        scene: &Scene,
        sampler: Option<&LitSampler>,
        count: usize,
        voxel_size: Option<f32>,
        seed: u32,
        gather: impl Fn(&Grid, SampleSet) -> Result<PatchSet, patches::Error>,
    ) -> Result<Self, Error> {
        let keep = |sample: &Sample| sampler.is_none_or(|sampler| sampler.is_lit(sample, seed));
        let settings = SampleSettings { seed, ..SampleSettings::default() };
        let gathered = |grid: &Grid| -> Result<PatchSet, patches::Error> {
            check_count("occupied voxels", grid.len())?;
            let set = gather(grid, sample_voxels(scene, grid, &settings, &keep)?)?;
            check_count("patches", set.len())?;
            Ok(set)
        };
        let made = || -> Result<(PatchSet, Lookup), patches::Error> {
            let grid = match voxel_size {
                Some(edge) => Grid::new(scene, Vec3::splat(edge))?,
                None => Grid::for_count(scene, Vec3::ONE, count, |grid| Ok(gathered(grid)?.len()))?,
            };
            let set = gathered(&grid)?;
            // What is dark sends nothing, but must not show the light of the other side of its wall.
            let dark = match sample_voxels(scene, &grid, &settings, &|sample: &Sample| !keep(sample)) {
                Ok(samples) => gather(&grid, samples)?,
                Err(patches::Error::NoSamples) => PatchSet::default(),
                Err(error) => return Err(error),
            };
            let (ours, theirs) = ((set.len(), |k: usize| set.patches[k]), (dark.len(), |k: usize| dark.patches[k]));
            let lookup = Lookup::with_dark(&grid.shape, ours, theirs, LookupSettings::default())?;
            Ok((set, lookup))
        };
        let (set, lookup) = made().map_err(|error| match error {
            patches::Error::TooMany { name, found, limit } => Error::TooManyVoxels { name, found, limit },
            error => error.into(),
        })?;
        let patches = set.patches.clone();
        let patch_facets = (0..=patches.len() as u32).collect();
        Ok(Self { lookup: Some(lookup), ..Self::of_samples(scene, set, &patches, patch_facets)? })
    }

    /// Patches with facets that are made of samples: patch i owns the facets `patch_facets[i]..patch_facets[i + 1]`. A
    /// sample may have parts in several facets; what is near it belongs to the one that has the greatest part.
    fn of_samples(
        scene: &Scene,
        set: PatchSet,
        patches: &[VirtualPatch],
        patch_facets: Vec<u32>,
    ) -> Result<Self, Error> {
        let patch = |p: &VirtualPatch| Patch { centroid: p.position, area: p.area, normal: p.normal, triangle: NONE };
        let albedo = |p: &VirtualPatch| p.albedo.extend(0.0);
        let (mut points, mut point_albedo) =
            (Vec::with_capacity(set.members.len()), Vec::with_capacity(set.members.len()));
        let mut greatest = vec![(NONE, 0.0); set.samples.len()];
        for (facet, p) in set.patches.iter().enumerate() {
            for member in set.members_of(facet) {
                let Sample { position, normal, albedo, .. } = set.samples[member.sample as usize];
                points.push(SurfacePoint { position, patch: facet as u32, normal, weight: member.weight });
                point_albedo.push(albedo.extend(0.0));
                let (part, most) = (member.weight * p.area, &mut greatest[member.sample as usize]);
                if part > most.1 {
                    *most = (facet as u32, part);
                }
            }
        }

        let area: f64 = set.patches.iter().map(|f| f64::from(f.area)).sum();
        let pieces = set.len().max((PIECES * patches.len()).min(MOST_PIECES));
        let edge = scene::math::sqrt((area / pieces as f64) as f32);
        let divisions: Vec<u32> = (0..scene.geometry.triangles.len() as u32)
            .map(|t| (scene.longest_edge(t) * CELLS / edge).ceil().clamp(1.0, MOST_DIVISIONS) as u32)
            .collect();
        let grids = cell_grids(&vec![Sides { front: true, back: true }; divisions.len()], &divisions)?;
        let owner: Vec<u32> = greatest.into_iter().map(|(facet, _)| facet).collect();
        let sample_edge = scene::math::sqrt((area / set.samples.len() as f64) as f32);
        let cells = cell_facets(scene, &grids, &set.samples, &owner, sample_edge);
        Ok(Self {
            patches: patches.iter().map(patch).collect(),
            albedo: patches.iter().map(albedo).collect(),
            patch_facets,
            facets: set.patches.iter().map(patch).collect(),
            facet_albedo: set.patches.iter().map(albedo).collect(),
            points,
            point_albedo,
            offsets: set.offsets,
            samples: set.samples.len(),
            polygons: Vec::new(),
            lookup: None,
            grids,
            cells,
        })
    }

    /// Bytes of each part.
    pub fn bytes(&self) -> [(&'static str, u64); 4] {
        let patches = size_of_val(&self.patches[..])
            + size_of_val(&self.albedo[..])
            + size_of_val(&self.patch_facets[..])
            + size_of_val(&self.facets[..])
            + size_of_val(&self.facet_albedo[..])
            + self.polygons.len() * size_of::<Polygon>();
        let points =
            size_of_val(&self.points[..]) + size_of_val(&self.point_albedo[..]) + size_of_val(&self.offsets[..]);
        let cells = size_of_val(&self.grids[..]) + size_of_val(&self.cells[..]);
        let lookup = self.lookup.as_ref().map_or(0, Lookup::bytes);
        [("patches", patches), ("sample points", points), ("cells", cells), ("lookup", lookup)]
            .map(|(name, bytes)| (name, bytes as u64))
    }

    /// First exitance of the patches from the direct light at the sample points, W/m².
    pub fn source(&self, direct: &[Vec3]) -> Vec<Vec4> {
        let light = |k: usize| self.point_albedo[k] * direct[k].extend(0.0) * self.points[k].weight;
        let facet = |range: &[u32]| (range[0] as usize..range[1] as usize).map(light).sum::<Vec4>();
        let facets: Vec<Vec4> = self.offsets.windows(2).map(facet).collect();
        let shares = self.facet_shares();
        let patch = |range: &[u32]| (range[0] as usize..range[1] as usize).map(|f| facets[f] * shares[f]).sum();
        self.patch_facets.windows(2).map(patch).collect()
    }

    /// Areas, m².
    pub fn areas(&self) -> Vec<f32> {
        self.patches.iter().map(|p| p.area).collect()
    }

    /// The facet that owns a hit, or [`NONE`].
    pub fn facet(&self, scene: &Scene, hit: &Hit, direction: Vec3) -> u32 {
        if hit.is_miss() {
            return NONE;
        }
        self.facet_on_side(hit, scene.tables().normal(hit.triangle).dot(direction) < 0.0)
    }

    /// The facet that owns a place on a side of a triangle, or [`NONE`].
    pub fn facet_on_side(&self, hit: &Hit, front: bool) -> u32 {
        let cell = owner(self.grids[hit.triangle as usize], *hit, front);
        if self.cells.is_empty() || cell == NONE { cell } else { self.cells[cell as usize] }
    }

    /// Pieces along the edges of each triangle in which facets are looked up.
    pub fn divisions(&self) -> Vec<u32> {
        self.grids.iter().map(|grid| grid.divisions).collect()
    }

    /// The patch of a facet; [`NONE`] of none.
    pub fn patch_of(&self, facet: u32) -> u32 {
        if facet == NONE { NONE } else { self.patch_facets.partition_point(|&first| first <= facet) as u32 - 1 }
    }

    /// The patch that owns a hit, or [`NONE`].
    pub fn patch(&self, scene: &Scene, hit: &Hit, direction: Vec3) -> u32 {
        self.patch_of(self.facet(scene, hit, direction))
    }

    /// Share of its patch's area that each facet has.
    pub fn facet_shares(&self) -> Vec<f32> {
        let mut shares: Vec<f32> = self.facets.iter().map(|f| f.area).collect();
        for range in self.patch_facets.windows(2) {
            let own = &mut shares[range[0] as usize..range[1] as usize];
            let scale = 1.0 / own.iter().sum::<f32>();
            own.iter_mut().for_each(|share| *share *= scale);
        }
        shares
    }

    /// Patches or facets as senders, any points as receivers.
    pub fn lighting<'a>(
        &'a self,
        scene: &'a Scene,
        columns: Columns,
        points: &'a [SurfacePoint],
        offsets: &'a [u32],
        seed: u32,
    ) -> Surfaces<'a> {
        let (patches, owner): (&[Patch], Owner) = match columns {
            Columns::Patches => (&self.patches, Box::new(|hit, direction| self.patch(scene, hit, direction))),
            Columns::Facets => (&self.facets, Box::new(|hit, direction| self.facet(scene, hit, direction))),
        };
        Surfaces {
            patches,
            polygons: &self.polygons,
            row_polygons: &[],
            points,
            offsets,
            visibility: scene,
            owner,
            ray_offset: scene.geometry.ray_offset,
            seed,
        }
    }

    /// Patches as senders, facets as receivers.
    pub fn exchange<'a>(&'a self, scene: &'a Scene, seed: u32) -> Surfaces<'a> {
        let surfaces = self.lighting(scene, Columns::Patches, &self.points, &self.offsets, seed);
        Surfaces { row_polygons: &self.polygons, ..surfaces }
    }
}

/// More than can be dealt with is an error.
fn check_count(name: &'static str, found: usize) -> Result<(), patches::Error> {
    if found <= MOST_PATCHES {
        return Ok(());
    }
    Err(patches::Error::TooMany { name, found: found as u64, limit: MOST_PATCHES as u64 })
}

/// The facet of each cell: the `owner` of the nearest sample that it sees, samples being `edge` m apart.
fn cell_facets(scene: &Scene, grids: &[TriangleGrid], samples: &[Sample], owner: &[u32], edge: f32) -> Vec<u32> {
    let geometry = scene.tables();
    let nearest = Nearest::new(samples);
    let side = |triangle: usize, normal: Vec3, cells: &[(Vec2, u32)]| -> Vec<u32> {
        let n = grids[triangle].divisions;
        let facet = |cell: u32, middle: Vec2| {
            let place = geometry.position(triangle as u32, middle.x, middle.y);
            // Nothing may stand between: a dark place has no facet, however bright it is beyond a wall.
            let seen = |&(sample, distance): &(u32, f32)| {
                let there = &samples[sample as usize];
                distance < TOUCHING || sees(scene, (place, normal), (there.position, there.normal), edge)
            };
            let albedo = scene.filtered_albedo(triangle as u32, place, edge * edge);
            let found = likest(&nearest, samples, (place, normal), albedo);
            // What is small may hide from all samples of like normal, and be lit nevertheless.
            let lit = || {
                let point = SurfacePoint { position: place, patch: NONE, normal, weight: 1.0 };
                n == 1 && is_open(scene, &point, WALKS, hash3(triangle as u32, cell, 0x6869_6465))
            };
            let chosen = found.iter().find(|f| seen(f)).or_else(|| found.first().filter(|_| lit()));
            chosen.map_or(NONE, |f| owner[f.0 as usize])
        };
        let mut facets = Vec::with_capacity(n as usize * n as usize);
        for (cell, &(middle, first)) in (0..).zip(cells) {
            facets.push(if first == cell { facet(cell, middle) } else { facets[first as usize] });
        }
        facets
    };
    (0..grids.len())
        .into_par_iter()
        .flat_map_iter(|t| {
            let normal = geometry.normal(t as u32);
            let cells = cells_in_places(&scene.geometry.triangles[t], grids[t].divisions);
            side(t, normal, &cells).into_iter().chain(side(t, -normal, &cells))
        })
        .collect()
}

/// The middle (u, v) of each cell of a triangle, and the first cell in the same place. Places are squares of half a cell's
/// edge along the longest edge of the triangle: cells of a triangle about as wide as long mostly have one each, those of one
/// that is long and thin, whose cells are that, too, share them.
fn cells_in_places(triangle: &Triangle, divisions: u32) -> Vec<(Vec2, u32)> {
    let n = divisions as f32;
    let (a, b) = (triangle.edge_a, triangle.edge_b);
    let longest = [a, b, b - a].into_iter().max_by(|x, y| x.length_squared().total_cmp(&y.length_squared()));
    let along = longest.unwrap_or(a).normalize();
    let across = a.cross(b).normalize().cross(along);
    let scale = 2.0 * n / longest.unwrap_or(a).length();
    let (x, y) = (Vec2::new(a.dot(along), b.dot(along)) * scale, Vec2::new(a.dot(across), b.dot(across)) * scale);
    // The triangle's corners are 0, (x.x, y.x) and (x.y, y.y).
    let low = Vec2::new(x.min_element(), y.min_element()).min(Vec2::ZERO);
    let size = (Vec2::new(x.max_element(), y.max_element()).max(Vec2::ZERO) - low).as_uvec2() + 1;
    let mut first = vec![NONE; size.x as usize * size.y as usize];
    let row = |j: u32| (0..2 * (divisions - j) - 1).map(move |k| (k / 2, j, k % 2));
    (0..)
        .zip((0..divisions).flat_map(row))
        .map(|(cell, (i, j, half)): (u32, (u32, u32, u32))| {
            let third = (1 + half) as f32 / 3.0;
            let middle = Vec2::new(i as f32 + third, j as f32 + third) / n;
            let place = (Vec2::new(middle.dot(x), middle.dot(y)) - low).as_uvec2();
            let first = &mut first[place.y as usize * size.x as usize + place.x as usize];
            *first = cell.min(*first);
            (middle, *first)
        })
        .collect()
}

/// The samples nearest to a place with this normal and albedo, the nearest first, with their distances in sample edges.
fn likest(nearest: &Nearest, samples: &[Sample], (place, normal): (Vec3, Vec3), albedo: Vec3) -> Vec<(u32, f32)> {
    let unlike = |sample: u32| albedo.distance(samples[sample as usize].albedo);
    let few = nearest.samples::<TRIED>(place, normal, FAR);
    let mut found = few.0[..few.1].to_vec();
    if few.1 == TRIED && found.iter().all(|f| unlike(f.0) > ALIKE) {
        let more = nearest.samples::<TRIED_UNLIKE>(place, normal, FAR);
        found = more.0[..more.1].to_vec();
    }
    for (sample, distance) in &mut found {
        let unlike = UNLIKE * unlike(*sample);
        *distance = scene::math::sqrt(*distance * *distance + unlike * unlike);
    }
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    found
}

/// Mean albedo of groups of sample points.
fn mean_albedo(offsets: &[u32], points: &[SurfacePoint], albedo: &[Vec4]) -> Vec<Vec4> {
    let mean = |range: &[u32]| (range[0] as usize..range[1] as usize).map(|k| albedo[k] * points[k].weight).sum();
    offsets.windows(2).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use glam::vec3;
    use transport::kernel::grid::{cell_corners, cell_count};

    use super::*;

    #[test]
    fn the_likest_sample_is_of_like_albedo_where_there_is_one() {
        // A white wall in the plane z = 0 with samples 1 m apart, and one dark sample on it, between them.
        let sample = |x: f32, y: f32, albedo: f32| Sample {
            position: Vec3::new(x, y, 0.0),
            normal: Vec3::Z,
            area: 1.0,
            albedo: Vec3::splat(albedo),
            ..Sample::default()
        };
        let mut samples: Vec<Sample> = (0..100).map(|k| sample((k % 10) as f32, (k / 10) as f32, 0.8)).collect();
        samples.push(sample(6.5, 5.5, 0.02));
        let nearest = Nearest::new(&samples);
        let place = (Vec3::new(4.1, 5.0, 0.0), Vec3::Z);
        let first = |albedo: f32| likest(&nearest, &samples, place, Vec3::splat(albedo))[0].0;
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
            for (cell, &(middle, first)) in (0..).zip(&cells) {
                let (p, q, r) = cell_corners(n, cell);
                assert!(middle.distance((p + q + r) / 3.0) < 1e-5, "cell {cell} of {n}: {middle}");
                let apart = middle - cells[first as usize].0;
                let apart = (a * apart.x + b * apart.y).length() / longest;
                assert!(first <= cell && apart * n as f32 <= 0.5f32.sqrt() + 1e-3, "cell {cell} of {n}: {apart}");
            }
            cells.iter().zip(0..).filter(|(c, k)| c.1 == *k).count()
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
