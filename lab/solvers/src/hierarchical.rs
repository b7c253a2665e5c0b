//! Hierarchical radiosity: triangles are split where they exchange much light, and light goes between parts of any size
//! (Hanrahan, Salzman and Aupperle 1991).

use formfactor::{Error, polygon_point, polygon_to_polygon, recurrence};
use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use scene::math::luminance;
use scene::sampling::hash3;
use scene::{NONE, Visibility};
use transport::Polygon;

/// Pairs of triangles that are tried at first, and links, at most.
const MAX_PAIRS: u64 = 1 << 26;
/// Passes at most.
const MAX_PASSES: u32 = 10_000;
/// Places along an edge at which the light of a part is looked up, at most.
const MAX_PLACES: f32 = 32.0;

/// Surfaces that exchange light.
pub struct HierarchicalScene<'a> {
    /// Corners of the triangles, m, counter-clockwise from the side that sends and receives.
    pub triangles: &'a [[Vec3; 3]],
    /// Who sees whom.
    pub visibility: &'a dyn Visibility,
    /// Distance by which rays start above a surface, m.
    pub ray_offset: f32,
    /// First exitance E, W/m², and albedo ρ of a triangle, at shares of the edges from its first corner.
    pub light: &'a (dyn Fn(usize, Vec2) -> (Vec3, Vec3) + Sync),
}

/// Settings of the subdivision of triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HierarchicalSettings {
    /// Most power that a link carries unsplit, as a share of the emitted power.
    pub error: f32,
    /// Least area of a part, m².
    pub least_area: f32,
    /// Shadow rays of a link.
    pub shadow_rays: u32,
    /// When passes end: the greatest change of an exitance, over the greatest.
    pub tolerance: f32,
    /// Changes every shadow ray.
    pub seed: u32,
}

/// A triangle or a part of one.
#[derive(Clone, Copy)]
struct Node {
    polygon: Polygon,
    triangle: u32,
    /// Corners as shares of the edges of the triangle.
    shares: [Vec2; 3],
    /// First of the four parts, or [`NONE`].
    children: u32,
    source: Vec3,
    albedo: Vec3,
    /// From the links of the node itself, W/m².
    gathered: Vec3,
    /// From these and those of all nodes that it is part of, W/m².
    irradiance: Vec3,
    exitance: Vec3,
}

/// Light goes both ways between two nodes.
#[derive(Clone, Copy)]
struct Link {
    nodes: [u32; 2],
    /// `A_a F_ab = A_b F_ba` with nothing in the way, m².
    open: f64,
    /// Share of that which nothing blocks.
    visible: f64,
}

/// Light of all bounces.
pub struct HierarchicalSolution {
    nodes: Vec<Node>,
    /// Links between parts.
    pub links: usize,
    /// Parts that are not split further.
    pub leaves: usize,
    /// Times that light was gathered over all links.
    pub passes: u32,
}

impl HierarchicalSolution {
    /// Bytes of a link.
    pub const LINK_BYTES: usize = size_of::<Link>();

    /// Indirect irradiance H at a place of a triangle, W/m².
    pub fn irradiance(&self, triangle: usize, at: Vec2) -> Vec3 {
        let mut node = &self.nodes[triangle];
        while node.children != NONE {
            let children = &self.nodes[node.children as usize..node.children as usize + 4];
            node = children.iter().min_by(|a, b| outside(a, at).total_cmp(&outside(b, at))).unwrap_or(node);
        }
        node.irradiance
    }

    /// Mean indirect irradiance over a triangle, W/m².
    pub fn mean(&self, triangle: usize) -> Vec3 {
        let mut open = vec![(triangle, 1.0f32)];
        let mut sum = Vec3::ZERO;
        while let Some((node, share)) = open.pop() {
            match self.nodes[node].children {
                NONE => sum += self.nodes[node].irradiance * share,
                children => open.extend((0..4).map(|k| (children as usize + k, 0.25 * share))),
            }
        }
        sum
    }
}

/// Distance of a place outside of a node, in shares; not positive inside.
fn outside(node: &Node, at: Vec2) -> f32 {
    let [a, b, c] = node.shares;
    let beyond = |from: Vec2, to: Vec2| -(to - from).perp_dot(at - from);
    beyond(a, b).max(beyond(b, c)).max(beyond(c, a))
}

/// Solves `B = E + ρ H`, H the irradiance that all parts of all triangles send each other.
///
/// A link is split while it carries more than a share of the emitted power, `max(B_a, B_b) A_a F_ab > ε Σ A E` (BF
/// refinement), at its larger end as long as that may be split. Form factors are exact where nothing is in the way
/// ([`formfactor::Contour`]), shadow rays tell what is. Each pass gathers over the links of all levels, pushes
/// irradiance down to the leaves and pulls exitance up as means; then links are tried again with the new exitances,
/// until none is split and the light stays.
///
/// # Errors
/// [`transport::Error::Setting`]; [`transport::Error::TooMany`] for more pairs of triangles or links than fit into
/// memory; [`transport::Error::Value`] for a triangle without area.
pub fn hierarchical(scene: &HierarchicalScene, settings: &HierarchicalSettings) -> Result<HierarchicalSolution, Error> {
    let HierarchicalSettings { error, least_area, tolerance, .. } = *settings;
    for (name, value) in [("error", error), ("least_area", least_area), ("tolerance", tolerance)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(transport::Error::Setting { name, value: f64::from(value), rule: "positive and finite" }.into());
        }
    }
    let mut solver = Solver::new(scene, settings)?;
    let count = scene.triangles.len() as u32;
    let mut pairs: Vec<[u32; 2]> = (0..count).flat_map(|a| (a + 1..count).map(move |b| [a, b])).collect();
    let mut passes = 0;
    loop {
        solver.link(pairs)?;
        let change = solver.gather();
        passes += 1;
        pairs = solver.split_links();
        if (pairs.is_empty() && change <= tolerance) || passes == MAX_PASSES {
            break;
        }
    }
    let leaves = solver.nodes.iter().filter(|node| node.children == NONE).count();
    Ok(HierarchicalSolution { nodes: solver.nodes, links: solver.links.len(), leaves, passes })
}

struct Solver<'a> {
    scene: &'a HierarchicalScene<'a>,
    settings: &'a HierarchicalSettings,
    nodes: Vec<Node>,
    links: Vec<Link>,
    /// Most power of a link that is not split, W.
    limit: f64,
}

impl<'a> Solver<'a> {
    fn new(scene: &'a HierarchicalScene<'a>, settings: &'a HierarchicalSettings) -> Result<Self, Error> {
        let count = scene.triangles.len() as u64;
        check_count("pairs of triangles", count * count.saturating_sub(1) / 2)?;
        let mut solver = Self { scene, settings, nodes: Vec::new(), links: Vec::new(), limit: 0.0 };
        for (index, corners) in scene.triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|corner| corner.as_dvec3());
            let Some(polygon) = Polygon::triangle(a, b, c) else {
                return Err(transport::Error::Value { name: "area", index, value: 0.0, rule: "positive" }.into());
            };
            let node = solver.node(polygon, index as u32, [Vec2::ZERO, Vec2::X, Vec2::Y]);
            solver.nodes.push(node);
        }
        let emitted: f64 = solver.nodes.iter().map(|node| node.polygon.area * brightness(node.source)).sum();
        solver.limit = f64::from(settings.error) * emitted;
        Ok(solver)
    }

    /// A node with the means of source and albedo over about as many places as it may have parts.
    fn node(&self, polygon: Polygon, triangle: u32, shares: [Vec2; 3]) -> Node {
        let n = scene::math::sqrt(polygon.area as f32 / self.settings.least_area).ceil().clamp(1.0, MAX_PLACES) as u32;
        let mut source = Vec3::ZERO;
        let mut albedo = Vec3::ZERO;
        let mut add = |x: f32, y: f32| {
            let at = shares[0] + (shares[1] - shares[0]) * (x / n as f32) + (shares[2] - shares[0]) * (y / n as f32);
            let (e, rho) = (self.scene.light)(triangle as usize, at);
            source += e;
            albedo += rho;
        };
        for row in 0..n {
            for column in 0..n - row {
                let x = row as f32;
                let y = column as f32;
                add(x + 1.0 / 3.0, y + 1.0 / 3.0);
                if row + column + 1 < n {
                    add(x + 2.0 / 3.0, y + 2.0 / 3.0);
                }
            }
        }
        let scale = 1.0 / (n * n) as f32;
        let source = source * scale;
        let albedo = albedo * scale;
        Node {
            polygon,
            triangle,
            shares,
            children: NONE,
            source,
            albedo,
            gathered: Vec3::ZERO,
            irradiance: Vec3::ZERO,
            exitance: source,
        }
    }

    /// Links these pairs, or their parts.
    fn link(&mut self, mut pairs: Vec<[u32; 2]>) -> Result<(), Error> {
        while !pairs.is_empty() {
            check_count("links", (self.links.len() + pairs.len()) as u64)?;
            let found: Vec<Link> = pairs.par_iter().filter_map(|&pair| self.open_link(pair)).collect();
            pairs.clear();
            let mut kept = Vec::new();
            for link in found {
                match self.larger_end(&link) {
                    Some(end) => self.split(&link, end, &mut pairs),
                    None => kept.push(link),
                }
            }
            kept.par_iter_mut().for_each(|link| link.visible = self.visible_share(link));
            self.links.extend(kept.into_iter().filter(|link| link.visible > 0.0));
        }
        Ok(())
    }

    /// The link of two nodes that face each other, as if nothing were in the way.
    fn open_link(&self, nodes: [u32; 2]) -> Option<Link> {
        let [a, b] = nodes.map(|node| &self.nodes[node as usize].polygon);
        // The contour is exact over the sender: the smaller one receives.
        let (small, large) = if a.area < b.area { (a, b) } else { (b, a) };
        let (Some(receiver), Some(source)) = cut(small, large) else { return None };
        let open = small.area * polygon_to_polygon(&receiver, &source, small.area);
        (open > 0.0).then_some(Link { nodes, open, visible: 1.0 })
    }

    /// Share of the light between both ends that nothing blocks.
    fn visible_share(&self, link: &Link) -> f64 {
        let [a, b] = link.nodes.map(|node| &self.nodes[node as usize].polygon);
        let (Some(a), Some(b)) = cut(a, b) else { return 0.0 };
        let key = |d: u32| hash3(link.nodes[0], link.nodes[1], hash3(d, 0x6c69_6e6b, self.settings.seed));
        let shift = [0, 1, 2, 3].map(|d| f64::from(key(d)) / 4_294_967_296.0);
        let mut seen = 0.0;
        let mut all = 0.0;
        for k in 0..self.settings.shadow_rays {
            let x = recurrence(u64::from(k), shift);
            let from = polygon_point(&a, x[0], x[1]);
            let to = polygon_point(&b, x[2], x[3]);
            let here = (to - from).dot(a.normal);
            let there = (from - to).dot(b.normal);
            if here <= 0.0 || there <= 0.0 {
                continue;
            }
            let squared = (to - from).length_squared();
            let weight = here * there / (squared * (std::f64::consts::PI * squared + b.area));
            all += weight;
            if self.sees(from, a.normal, to, b.normal) {
                seen += weight;
            }
        }
        if all > 0.0 { seen / all } else { 0.0 }
    }

    fn sees(&self, from: DVec3, from_normal: DVec3, to: DVec3, to_normal: DVec3) -> bool {
        let lift = f64::from(self.scene.ray_offset);
        let start = (from + from_normal * lift).as_vec3();
        !self.scene.visibility.any_hit(start, (to + to_normal * lift).as_vec3())
    }

    /// The end of a link that is to be split, 0 or 1; nothing where the link carries little, or both ends are small.
    fn larger_end(&self, link: &Link) -> Option<usize> {
        let [a, b] = link.nodes.map(|node| &self.nodes[node as usize]);
        let power = brightness(a.exitance).max(brightness(b.exitance)) * link.open;
        let end = usize::from(a.polygon.area < b.polygon.area);
        let larger = a.polygon.area.max(b.polygon.area);
        (power > self.limit && larger >= 4.0 * f64::from(self.settings.least_area)).then_some(end)
    }

    /// Adds the pairs of the parts of one end with the other end.
    fn split(&mut self, link: &Link, end: usize, pairs: &mut Vec<[u32; 2]>) {
        let node = link.nodes[end];
        if self.nodes[node as usize].children == NONE {
            self.subdivide(node as usize);
        }
        let first = self.nodes[node as usize].children;
        for child in first..first + 4 {
            let mut nodes = link.nodes;
            nodes[end] = child;
            pairs.push(nodes);
        }
    }

    /// Splits a node into four, which are as bright as it lets expect.
    fn subdivide(&mut self, index: usize) {
        let Node { polygon: whole, triangle, shares: [a, b, c], irradiance, .. } = self.nodes[index];
        let ab = (a + b) * 0.5;
        let bc = (b + c) * 0.5;
        let ca = (c + a) * 0.5;
        let shares = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]];
        let corners = whole.corners();
        let [a, b, c] = [corners[0], corners[1], corners[2]];
        let ab = (a + b) * 0.5;
        let bc = (b + c) * 0.5;
        let ca = (c + a) * 0.5;
        let parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]];
        let first = self.nodes.len() as u32;
        for (part, shares) in parts.into_iter().zip(shares) {
            // A part of a triangle with area has area: the whole stands in only where numbers end.
            let part = Polygon::triangle(part[0], part[1], part[2]).unwrap_or(whole);
            let mut node = self.node(part, triangle, shares);
            node.exitance = node.source + node.albedo * irradiance;
            node.irradiance = irradiance;
            self.nodes.push(node);
        }
        self.nodes[index].children = first;
    }

    /// Gathers over all links, pushes down, pulls up; the greatest change of an exitance, over the greatest.
    fn gather(&mut self) -> f32 {
        self.nodes.iter_mut().for_each(|node| node.gathered = Vec3::ZERO);
        for Link { nodes: [a, b], open, visible } in &self.links {
            let exchange = open * visible;
            let a = *a as usize;
            let b = *b as usize;
            let to_a = self.nodes[b].exitance * (exchange / self.nodes[a].polygon.area) as f32;
            let to_b = self.nodes[a].exitance * (exchange / self.nodes[b].polygon.area) as f32;
            self.nodes[a].gathered += to_a;
            self.nodes[b].gathered += to_b;
        }
        let mut change = 0.0f32;
        let mut greatest = 0.0f32;
        for triangle in 0..self.scene.triangles.len() {
            self.push_and_pull(triangle, Vec3::ZERO, &mut change, &mut greatest);
        }
        if greatest > 0.0 { change / greatest } else { 0.0 }
    }

    /// Gives a node the irradiance from above, and its exitance the mean of its parts.
    fn push_and_pull(&mut self, index: usize, above: Vec3, change: &mut f32, greatest: &mut f32) {
        let irradiance = above + self.nodes[index].gathered;
        let children = self.nodes[index].children;
        let exitance = if children == NONE {
            self.nodes[index].source + self.nodes[index].albedo * irradiance
        } else {
            let mut sum = Vec3::ZERO;
            for child in children as usize..children as usize + 4 {
                self.push_and_pull(child, irradiance, change, greatest);
                sum += self.nodes[child].exitance;
            }
            sum * 0.25
        };
        let node = &mut self.nodes[index];
        if children == NONE {
            *change = change.max((exitance - node.exitance).abs().max_element());
            *greatest = greatest.max(exitance.max_element());
        }
        node.irradiance = irradiance;
        node.exitance = exitance;
    }

    /// Removes the links that carry too much by now, and gives the pairs of their parts.
    fn split_links(&mut self) -> Vec<[u32; 2]> {
        let mut pairs = Vec::new();
        let links = std::mem::take(&mut self.links);
        for link in links {
            match self.larger_end(&link) {
                Some(end) => self.split(&link, end, &mut pairs),
                None => self.links.push(link),
            }
        }
        pairs
    }
}

/// Both polygons without what lies behind the other's plane.
fn cut(receiver: &Polygon, source: &Polygon) -> (Option<Polygon>, Option<Polygon>) {
    match receiver.clip(source.centroid, source.normal) {
        None => (None, None),
        clipped => (clipped, source.clip(receiver.centroid, receiver.normal)),
    }
}

fn brightness(exitance: Vec3) -> f64 {
    f64::from(luminance(exitance))
}

fn check_count(name: &'static str, found: u64) -> Result<(), Error> {
    if found > MAX_PAIRS {
        return Err(transport::Error::TooMany { name, found, limit: MAX_PAIRS }.into());
    }
    Ok(())
}
