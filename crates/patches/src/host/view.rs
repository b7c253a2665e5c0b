//! Patches by what samples see: all samples of the scene in one set, split top-down where position, normal, openness,
//! albedo and light vary most. No voxel limits a patch, and a bright hidden surface never shares one with a dim visible
//! one.

use alloc::collections::BinaryHeap;
use alloc::vec;
use alloc::vec::Vec;

use glam::Vec3;
#[cfg(not(feature = "std"))]
use num_traits::Float as _;
use scene::double::ln;
use scene::gpu::{DirectParams, LIGHT_DIRECTIONAL, LIGHT_RECT, Sky};
use scene::math::luminance;
use scene::parallel::*;
use scene::sampling::{cosine_hemisphere, frame, hammersley, hash3};
use scene::{NONE, Scene, SurfacePoint};

use super::focus::Density;
use super::lit::LitSampler;
use super::patch_set::PatchSet;
use super::visibility::is_visible;
use crate::error::Error;
use crate::types::{Member, Sample};

/// Rays by which the openness of a sample is measured.
const RAYS: u32 = 16;
/// Weight of the openness among the features.
const OPENNESS: f32 = 8.0;
/// Weight of the albedo: a thin dark bar must not shine like the wall that it stands before.
const ALBEDO: f32 = 3.0;
/// Weight of the logarithm of the irradiance.
const LIGHT: f32 = 4.0;
/// Threshold for each of the other suns.
const OTHER_LIGHT: f32 = 1.5;
/// Irradiance below this share of the mean counts as none.
const DARK: f32 = 0.02;
/// Other suns than the scene's own, when it has one or a sky: lights that may come later.
const OTHER_SUNS: u32 = 6;
/// Position, normal, openness at two distances, sky, albedo, the scene's own light.
const OWN_FEATURES: usize = 11;
const FEATURES: usize = OWN_FEATURES + OTHER_SUNS as usize;
/// Rays by which the light of near sources is found at a sample.
const FLUX_RAYS: u32 = 16;
/// An element is cut further where that takes off more than this share of the mean flux of elements from how much its
/// own varies.
const FLUX_TOLERANCE: f64 = 0.5;
/// Most elements that are added so, as a share of those that there are.
const FLUX_ROOM: f64 = 0.5;
/// Weight of whether a sample is cut off from the middle of its cluster, as by a wall on their floor: light of either
/// side is another.
const HIDDEN: f64 = 8.0;
/// Clusters of at most so many samples for each of a patch are asked.
const ASKED: usize = 2;

type Features = [f32; FEATURES];

/// Settings of [`view_clusters`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewSettings {
    /// Patches to make; fewer when there are fewer samples.
    pub patches: u32,
    /// Samples a patch, on average.
    pub samples: u32,
    /// Elements a patch, on average.
    pub elements: u32,
    /// Most elements in all.
    pub most_elements: u32,
    /// Changes every random number.
    pub seed: u32,
}

impl Default for ViewSettings {
    fn default() -> Self {
        Self { patches: 10_000, samples: 24, elements: 6, most_elements: 1 << 16, seed: 0 }
    }
}

/// Patches, and each of them cut into elements.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewClusters {
    /// Samples and patches. Each sample belongs to one patch, and the samples of a patch follow each other.
    pub set: PatchSet,
    /// Element e owns `set.samples[elements[e]..elements[e + 1]]`, `[elements + 1]`.
    pub elements: Vec<u32>,
    /// Patch i owns the elements `patch_elements[i]..patch_elements[i + 1]`, `[patches + 1]`.
    pub patch_elements: Vec<u32>,
}

/// Makes patches of like samples: samples as dense as the sampler's are, of both sides of all triangles, without those
/// inside of solids or that see no geometry; then the cluster with the greatest product of samples and variance is
/// split at the mean of the feature that varies most, until there are enough. Going on in the same way cuts each patch
/// into elements, over which light may be gathered more finely than patches send it. O(S log S) for S samples.
///
/// Features: position in typical patch edges (weight 1), normal (1), the shares of 16 cosine-weighted rays that are
/// free for a half and for two patch edges and that reach the sky (8), the luminance of the albedo (3), the logarithm
/// of the irradiance from the scene's lights (4) and, where a sun may stand elsewhere later, from six other suns (1.5).
///
/// # Errors
/// [`Error::Setting`] for no patches or samples, [`Error::NoSamples`], [`Error::TooMany`].
pub fn view_clusters(sampler: &LitSampler, settings: &ViewSettings) -> Result<ViewClusters, Error> {
    let counts = [
        ("patches", settings.patches),
        ("samples", settings.samples),
        ("elements", settings.elements),
        ("most_elements", settings.most_elements),
    ];
    for (name, value) in counts {
        if value == 0 {
            return Err(Error::Setting { name, value: 0.0, rule: "at least 1" });
        }
    }
    let wanted = u64::from(settings.patches) * u64::from(settings.samples);
    if wanted > u64::from(u32::MAX / 64) {
        return Err(Error::TooMany { name: "samples", found: wanted, limit: u64::from(u32::MAX / 64) });
    }
    let samples = sampler.samples(wanted as u32, settings.seed)?;
    if samples.is_empty() {
        return Err(Error::NoSamples);
    }
    let edge = scene::math::sqrt((sampler.lit_area() / f64::from(settings.patches)) as f32);
    let elements = settings.patches.saturating_mul(settings.elements).min(settings.most_elements).max(settings.patches);
    let wanted = Wanted {
        patches: settings.patches as usize,
        elements: elements as usize,
        most_elements: settings.most_elements as usize,
        samples: settings.samples as usize,
        edge,
        seed: settings.seed,
    };
    clusters_of(sampler, &samples, &wanted)
}

/// Clusters that are wanted.
pub(super) struct Wanted {
    pub patches: usize,
    pub elements: usize,
    /// Most elements, with those that light from near asks for.
    pub most_elements: usize,
    /// Samples of a patch, on average.
    pub samples: usize,
    /// Typical edge of a patch in the focus, m.
    pub edge: f32,
    /// Changes every random number.
    pub seed: u32,
}

/// [`view_clusters`] of samples that are there.
///
/// # Errors
/// [`Error::TooMany`].
pub(super) fn clusters_of(sampler: &LitSampler, samples: &[Sample], wanted: &Wanted) -> Result<ViewClusters, Error> {
    let scene = sampler.scene();
    let mut features = see(scene, samples, sampler.density(), wanted.edge, wanted.seed);
    add_light(scene, samples, &mut features, wanted.seed);
    let flux = flux_of_near_lights(scene, samples, wanted.seed);
    let set = Set {
        scene,
        samples,
        features: &features,
        flux: &flux,
        counted_area: samples.iter().map(|sample| sample.area).fold(f32::INFINITY, f32::min),
        asked: ASKED * wanted.samples,
    };
    let mut cut = set.split(wanted.patches, wanted.elements);
    set.split_by_flux(&mut cut, wanted.most_elements);
    let samples: Vec<Sample> = cut.order.iter().map(|&k| samples[k as usize]).collect();
    let members = (0..samples.len() as u32).map(|sample| Member { sample, weight: 1.0 }).collect();
    let voxels = alloc::vec![NONE; cut.patches.len() - 1];
    let patch_elements = cut.patches.iter().map(|sample| cut.elements.partition_point(|f| f < sample) as u32).collect();
    let set = PatchSet::from_groups(samples, &voxels, cut.patches, members)?;
    Ok(ViewClusters { set, elements: cut.elements, patch_elements })
}

fn surface_point(sample: &Sample) -> SurfacePoint {
    SurfacePoint { position: sample.position, patch: 0, normal: sample.normal, weight: 1.0 }
}

/// Position, normal, openness and albedo of samples; `edge` is the typical edge of a patch in the focus, m.
fn see(scene: &Scene, samples: &[Sample], density: &Density, edge: f32, seed: u32) -> Vec<Features> {
    (samples.par_iter().enumerate())
        .map(|(index, sample)| {
            let key = |dimension: u32| hash3(index as u32, dimension, seed ^ 0x7365_6573);
            let origin = sample.position + sample.normal * scene.geometry.ray_offset;
            let edge = edge * density.edge(sample.position);
            let mut near = 0u32;
            let mut far = 0u32;
            let mut sky = 0u32;
            for k in 0..RAYS {
                let direction = cosine_hemisphere(sample.normal, hammersley(k, RAYS, (key(0), key(1))));
                let hit = scene.closest_before(origin, direction, f32::INFINITY);
                near += u32::from(hit.is_miss() || hit.t > 0.5 * edge);
                far += u32::from(hit.is_miss() || hit.t > 2.0 * edge);
                sky += u32::from(hit.is_miss());
            }
            let mut features = [0.0; FEATURES];
            features[..3].copy_from_slice(&(sample.position / edge).to_array());
            features[3..6].copy_from_slice(&sample.normal.to_array());
            for (feature, count) in features[6..9].iter_mut().zip([near, far, sky]) {
                *feature = OPENNESS * count as f32 / RAYS as f32;
            }
            features[9] = ALBEDO * luminance(sample.albedo);
            features
        })
        .collect()
}

/// Adds the logarithm of the irradiance: from the scene's own lights, and from other suns.
fn add_light(scene: &Scene, samples: &[Sample], features: &mut [Features], seed: u32) {
    let points: Vec<SurfacePoint> = samples.iter().map(surface_point).collect();
    let params = DirectParams {
        count: points.len() as u32,
        light_count: scene.lighting.lights.len() as u32,
        emitter_count: scene.emitters.len() as u32,
        area_rays: 4,
        sky_rays: if scene.lighting.sky.map_width == 0 { 0 } else { 8 },
        seed,
        ray_offset: scene.geometry.ray_offset,
        first: 0,
    };
    let own = scene.direct_irradiance(&params, &points);
    put_logarithm(features, OWN_FEATURES - 1, own.par_iter().map(|e| luminance(*e)).collect());
    if !scene.has_sky() && !scene.lighting.lights.iter().any(|l| l.kind == LIGHT_DIRECTIONAL) {
        return;
    }
    let (right, up) = frame(-Vec3::Y);
    for k in 0..OTHER_SUNS {
        // Spread over the sky, none very low.
        let (x, azimuth) = hammersley(k, OTHER_SUNS, (0, hash3(seed, 0, 0)));
        let height = 0.35 + 0.6 * x;
        let (s, c) = scene::math::sin_cos_2pi(azimuth);
        let across = scene::math::sqrt(1.0 - height * height);
        let to_sun = (right * c + up * s) * across + Vec3::Y * height;
        let light = (points.par_iter())
            .map(|p| {
                let cosine = p.normal.dot(to_sun);
                let origin = p.position + p.normal * scene.geometry.ray_offset;
                if cosine > 0.0 && !scene.occluded(origin, to_sun, f32::INFINITY) { cosine } else { 0.0 }
            })
            .collect();
        put_logarithm(features, OWN_FEATURES + k as usize, light);
    }
}

/// What samples reflect of the light of shining surfaces, W/m², the brightest channel: near to one it changes within less
/// than the edge of an element. Empty where nothing shines.
fn flux_of_near_lights(scene: &Scene, samples: &[Sample], seed: u32) -> Vec<f32> {
    let mut near = scene.clone();
    near.lighting.sky = Sky::default();
    near.lighting.sky_map = [].into();
    near.lighting.lights.retain(|light| light.kind == LIGHT_RECT);
    if near.lighting.lights.is_empty() && near.emitters.is_empty() {
        return Vec::new();
    }
    let points: Vec<SurfacePoint> = samples.iter().map(surface_point).collect();
    let params = DirectParams {
        count: points.len() as u32,
        light_count: near.lighting.lights.len() as u32,
        emitter_count: near.emitters.len() as u32,
        area_rays: FLUX_RAYS,
        seed: seed ^ 0x666c_7578,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    };
    let light = near.direct_irradiance(&params, &points);
    light.par_iter().zip(samples).map(|(light, sample)| (*light * sample.albedo).max_element()).collect()
}

/// Sets one feature to the weighted logarithm of an irradiance, as a share of its mean and not below [`DARK`].
fn put_logarithm(features: &mut [Features], feature: usize, irradiance: Vec<f32>) {
    let mean = irradiance.iter().map(|&e| f64::from(e)).sum::<f64>() / irradiance.len().max(1) as f64;
    let weight = if feature < OWN_FEATURES { LIGHT } else { OTHER_LIGHT };
    if mean > 0.0 {
        features.par_iter_mut().zip(irradiance).for_each(|(f, e)| {
            f[feature] = weight * ln(f64::from(e / mean as f32 + DARK)) as f32;
        });
    }
}

/// Set that is to be split.
struct Set<'a> {
    scene: &'a Scene,
    samples: &'a [Sample],
    features: &'a [Features],
    /// Light of near sources that each sample reflects, W/m²; empty where there are none.
    flux: &'a [f32],
    /// Area that every sample stands for, as the density counts it, m².
    counted_area: f32,
    /// Most samples of a cluster that are asked whether they are cut off.
    asked: usize,
}

/// A cluster: a range of the order of samples, and how much splitting it would bring.
struct Node {
    priority: f64,
    start: usize,
    end: usize,
    /// At which feature it is split best; none where those samples that are cut off are split from the rest.
    feature: Option<usize>,
    mean: f32,
    /// Mark of each sample that is cut off from the middle; empty where they were not asked.
    hidden: Vec<bool>,
}

impl Set<'_> {
    fn node(&self, start: usize, end: usize, order: &[u32]) -> Node {
        let mut area = 0.0f64;
        let mut sum = [0.0f64; FEATURES];
        let mut squares = [0.0f64; FEATURES];
        for &k in &order[start..end] {
            let a = f64::from(self.counted_area);
            area += a;
            for (d, &x) in self.features[k as usize].iter().enumerate() {
                let x = f64::from(x);
                sum[d] += a * x;
                squares[d] += a * x * x;
            }
        }
        let variance = |d: usize| (squares[d] / area - (sum[d] / area) * (sum[d] / area)).max(0.0);
        let best = (0..FEATURES).max_by(|&a, &b| variance(a).total_cmp(&variance(b))).unwrap_or(0);
        let total: f64 = (0..FEATURES).map(variance).sum();
        let hidden = if end - start <= self.asked { self.hidden(&order[start..end]) } else { Vec::new() };
        let share = hidden.iter().filter(|hidden| **hidden).count() as f64 / (end - start) as f64;
        let apart = HIDDEN * HIDDEN * share * (1.0 - share);
        Node {
            priority: area * (total + apart),
            start,
            end,
            feature: (apart <= variance(best)).then_some(best),
            mean: (sum[best] / area) as f32,
            hidden,
        }
    }

    /// Marks samples that are cut off from the one in their middle: they see neither that nor any that is not cut off.
    fn hidden(&self, own: &[u32]) -> Vec<bool> {
        let sample = |k: u32| &self.samples[k as usize];
        let mean = own.iter().map(|&k| sample(k).position).sum::<Vec3>() / own.len() as f32;
        let away = |k: u32| sample(k).position.distance_squared(mean);
        let Some(&middle) = own.iter().min_by(|&&a, &&b| away(a).total_cmp(&away(b))) else { return Vec::new() };
        let mut hidden = vec![true; own.len()];
        let mut asking = vec![middle];
        while let Some(from) = asking.pop().filter(|_| hidden.contains(&true)) {
            let edge = scene::math::sqrt(sample(from).area);
            for (hidden, &k) in hidden.iter_mut().zip(own).filter(|(hidden, _)| **hidden) {
                if k == from || is_visible(self.scene, sample(from).into(), sample(k).into(), edge) {
                    *hidden = false;
                    asking.push(k);
                }
            }
        }
        hidden
    }

    fn split(&self, patches: usize, elements: usize) -> Cut {
        let count = self.samples.len();
        let mut order: Vec<u32> = (0..count as u32).collect();
        let mut open = BinaryHeap::from([self.node(0, count, &order)]);
        let mut closed = Vec::new();
        let starts = |open: &BinaryHeap<Node>, closed: &[usize]| {
            let mut starts: Vec<u32> = open.iter().map(|n| n.start as u32).collect();
            starts.extend(closed.iter().map(|&start| start as u32));
            starts.push(count as u32);
            starts.sort_unstable();
            starts
        };
        let mut patch_starts = None;
        while open.len() + closed.len() < elements {
            if open.len() + closed.len() == patches {
                patch_starts = Some(starts(&open, &closed));
            }
            let Some(node) = open.pop() else { break };
            let own = &mut order[node.start..node.end];
            let below = |(place, &k): (usize, &u32)| match node.feature {
                Some(feature) => self.features[k as usize][feature] < node.mean,
                None => node.hidden[place],
            };
            // In the order of the samples on both sides.
            let (low, high): (Vec<_>, Vec<_>) = own.iter().enumerate().partition(|&entry| below(entry));
            let [low, high] = [low, high].map(|part| part.into_iter().map(|(_, &k)| k).collect::<Vec<u32>>());
            if low.is_empty() || high.is_empty() {
                closed.push(node.start);
                continue;
            }
            own[..low.len()].copy_from_slice(&low);
            own[low.len()..].copy_from_slice(&high);
            let middle = node.start + low.len();
            open.push(self.node(node.start, middle, &order));
            open.push(self.node(middle, node.end, &order));
        }
        let elements = starts(&open, &closed);
        Cut { order, patches: patch_starts.unwrap_or_else(|| elements.clone()), elements }
    }
}

/// An element: a range of the order of samples, and the cut that explains most of how its flux varies.
struct FluxNode {
    /// Flux that the cut sets right, W.
    gain: f64,
    start: usize,
    end: usize,
    /// Position or normal that is cut at its mean.
    feature: usize,
    mean: f32,
}

/// Features along which elements are cut by flux: position and normal.
const PLACES: usize = 6;

impl Set<'_> {
    /// Cuts elements further where light from near changes within them: those that see the bright part alone, or the dim
    /// one, would else be lit by the mean. The cut is made in space, so that noise of single samples decides nothing.
    fn split_by_flux(&self, cut: &mut Cut, most: usize) {
        let elements = cut.elements.len() - 1;
        let room = ((elements as f64 * FLUX_ROOM) as usize).min(most.saturating_sub(elements));
        if self.flux.is_empty() || room == 0 {
            return;
        }
        let total: f64 = self.flux.iter().map(|&flux| f64::from(flux)).sum::<f64>() * f64::from(self.counted_area);
        let least = FLUX_TOLERANCE * total / elements as f64;
        let ranges = cut.elements.windows(2);
        let nodes = ranges.map(|range| self.flux_node(range[0] as usize, range[1] as usize, &cut.order));
        let mut open: BinaryHeap<FluxNode> = nodes.filter(|node| node.gain > least).collect();
        for _ in 0..room {
            let Some(node) = open.pop() else { break };
            let own = &mut cut.order[node.start..node.end];
            let below = |k: &&u32| self.features[**k as usize][node.feature] < node.mean;
            let (low, high): (Vec<&u32>, Vec<&u32>) = own.iter().partition(below);
            let [low, high] = [low, high].map(|part| part.into_iter().copied().collect::<Vec<u32>>());
            if low.is_empty() || high.is_empty() {
                continue;
            }
            own[..low.len()].copy_from_slice(&low);
            own[low.len()..].copy_from_slice(&high);
            let middle = node.start + low.len();
            cut.elements.push(middle as u32);
            let parts = [(node.start, middle), (middle, node.end)];
            open.extend(
                parts.map(|(start, end)| self.flux_node(start, end, &cut.order)).into_iter().filter(|n| n.gain > least),
            );
        }
        cut.elements.sort_unstable();
    }

    fn flux_node(&self, start: usize, end: usize, order: &[u32]) -> FluxNode {
        let own = &order[start..end];
        let count = own.len() as f64;
        let mean_of = |value: &dyn Fn(u32) -> f32| own.iter().map(|&k| f64::from(value(k))).sum::<f64>() / count;
        let flux = mean_of(&|k| self.flux[k as usize]);
        let mut best = FluxNode { gain: 0.0, start, end, feature: 0, mean: 0.0 };
        for feature in 0..PLACES {
            let mean = mean_of(&|k| self.features[k as usize][feature]);
            let mut squares = 0.0;
            let mut products = 0.0;
            for &k in own {
                let away = f64::from(self.features[k as usize][feature]) - mean;
                squares += away * away;
                products += away * (f64::from(self.flux[k as usize]) - flux);
            }
            // The standard deviation of the part of the flux that is linear in the feature.
            let explained = if squares > 0.0 { products.abs() / (squares * count).sqrt() } else { 0.0 };
            let gain = explained * count * f64::from(self.counted_area);
            if gain > best.gain {
                best = FluxNode { gain, feature, mean: mean as f32, ..best };
            }
        }
        best
    }
}

impl PartialEq for FluxNode {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for FluxNode {}

impl PartialOrd for FluxNode {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for FluxNode {
    fn cmp(&self, other: &Self) -> core::cmp::Ordering {
        self.gain.total_cmp(&other.gain).then(self.start.cmp(&other.start))
    }
}

impl PartialEq for Node {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Node {}

impl PartialOrd for Node {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Node {
    fn cmp(&self, other: &Self) -> core::cmp::Ordering {
        self.priority.total_cmp(&other.priority).then(self.start.cmp(&other.start))
    }
}

/// Samples in the order of their clusters, and where each patch and each element starts.
struct Cut {
    order: Vec<u32>,
    patches: Vec<u32>,
    elements: Vec<u32>,
}
