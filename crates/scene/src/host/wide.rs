//! Rays on the host: the binary hierarchy folded eight wide, boxes tested eight and triangles four at a time in SIMD
//! registers (glam's `Vec4`). The arithmetic of each lane is that of the kernels' bodies, so both give the same bits.

use alloc::vec::Vec;

use arrayvec::ArrayVec;
use glam::{Vec3, Vec4};

use crate::gpu::{BvhNode, Hit, NONE, Triangle};
use crate::kernel::bvh::{is_well_inside, safe_inverse};

/// Children of a node.
const WIDTH: usize = 8;
/// Entries of the traversal stack: one less than [`WIDTH`] a level at most.
const STACK_SIZE: usize = 320;
/// Marks a child that is a packet of triangles.
const LEAF: u32 = 1 << 31;

/// A number for each child.
type Lanes = [Vec4; 2];

/// Eight children: their boxes by axis, and where they stand.
#[derive(Clone, Debug)]
struct Node {
    /// Least and greatest x, y, z of each child; an empty child has an inverted box.
    bounds: [Lanes; 6],
    /// Index of a node, or of a packet with [`LEAF`].
    children: [u32; WIDTH],
}

/// Up to four triangles that follow each other in leaf order; missing ones have no edges, which no ray meets.
#[derive(Clone, Debug, Default)]
struct Packet {
    corner: [Vec4; 3],
    edge_a: [Vec4; 3],
    edge_b: [Vec4; 3],
    first: u32,
    /// True if the leaf goes on in the next packet.
    more: bool,
    /// A bit for each triangle that may have holes.
    masked: u8,
}

/// The hierarchy eight wide.
#[derive(Clone, Debug, Default)]
pub struct WideBvh {
    nodes: Vec<Node>,
    packets: Vec<Packet>,
}

/// A ray as the tests of several lanes want it.
struct WideRay {
    origin: [Vec4; 3],
    inverse: [Vec4; 3],
    direction: [Vec4; 3],
    /// Rows of [`Node::bounds`] that are entered and left through, by the signs of the direction.
    near: [usize; 3],
}

impl WideRay {
    #[inline]
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let splat = |v: Vec3| [Vec4::splat(v.x), Vec4::splat(v.y), Vec4::splat(v.z)];
        let inverse = direction.map(safe_inverse);
        let row = |axis: usize, d: f32| 2 * axis + usize::from(d < 0.0);
        Self {
            origin: splat(origin),
            inverse: splat(inverse),
            direction: splat(direction),
            near: [row(0, inverse.x), row(1, inverse.y), row(2, inverse.z)],
        }
    }

    /// Which children the ray enters before `t_max` (a bit each), and where.
    #[inline]
    fn enter(&self, node: &Node, t_max: f32) -> (u32, [f32; WIDTH]) {
        let half = |k: usize| {
            let at = |axis: usize, row: usize| (node.bounds[row][k] - self.origin[axis]) * self.inverse[axis];
            let [x, y, z] = self.near;
            let near = at(0, x).max(at(1, y)).max(at(2, z));
            let far = at(0, x ^ 1).min(at(1, y ^ 1)).min(at(2, z ^ 1));
            // As in the kernels: rounding must not lose a flat box that holds an axis-parallel triangle.
            let inside = (far * 1.000_001).cmpge(near) & far.cmpge(Vec4::ZERO) & near.cmplt(Vec4::splat(t_max));
            (inside.bitmask(), near)
        };
        let [first, second] = [half(0), half(1)];
        (first.0 | second.0 << 4, bytemuck::cast([first.1, second.1]))
    }

    /// Möller and Trumbore's test on four triangles: a bit for each that is met in (0, t_max), and u, v, t.
    #[inline]
    fn meet(&self, packet: &Packet, t_max: f32) -> (u32, Vec4, Vec4, Vec4) {
        let p = cross(&self.direction, &packet.edge_b);
        let inverse = Vec4::ONE / dot(&packet.edge_a, &p);
        let s =
            [self.origin[0] - packet.corner[0], self.origin[1] - packet.corner[1], self.origin[2] - packet.corner[2]];
        let u = dot(&s, &p) * inverse;
        let q = cross(&s, &packet.edge_a);
        let v = dot(&self.direction, &q) * inverse;
        let t = dot(&packet.edge_b, &q) * inverse;
        // A determinant of 0 makes these infinite or NaN; no comparison holds then.
        let inside = u.cmpge(Vec4::ZERO)
            & v.cmpge(Vec4::ZERO)
            & (u + v).cmple(Vec4::ONE)
            & t.cmpgt(Vec4::ZERO)
            & t.cmplt(Vec4::splat(t_max));
        (inside.bitmask(), u, v, t)
    }
}

#[inline]
fn dot(a: &[Vec4; 3], b: &[Vec4; 3]) -> Vec4 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
fn cross(a: &[Vec4; 3], b: &[Vec4; 3]) -> [Vec4; 3] {
    [a[1] * b[2] - b[1] * a[2], a[2] * b[0] - b[2] * a[0], a[0] * b[1] - b[0] * a[1]]
}

impl WideBvh {
    /// Folds a binary hierarchy over triangles in its leaf order: an inner child with the largest box is replaced by
    /// its two children until there are eight. Nothing when the result would be too deep for the traversal stack.
    /// Triangles that are not `masked` have no holes.
    pub(crate) fn new(nodes: &[BvhNode], triangles: &[Triangle], masked: impl Fn(&Triangle) -> bool) -> Option<Self> {
        // The packets take most of a scene's memory: no room for more of them than there are.
        let packets = nodes.iter().map(|node| node.prim_count.div_ceil(4) as usize).sum();
        let mut wide = Self { nodes: Vec::new(), packets: Vec::with_capacity(packets) };
        let root = &nodes[0];
        if root.prim_count > 0 {
            // A single leaf: one node with one child.
            let child = wide.add_leaf(root, triangles, &masked);
            wide.nodes.push(Node::of(&[(root, child)]));
            return Some(wide);
        }
        wide.nodes.push(Node::of(&[]));
        let mut waiting = alloc::vec![(0usize, 0u32, 1usize)];
        while let Some((place, binary, level)) = waiting.pop() {
            if (WIDTH - 1) * level + 1 > STACK_SIZE {
                return None;
            }
            let first = nodes[binary as usize].first_index;
            let mut children = alloc::vec![first, first + 1];
            while children.len() < WIDTH {
                let area = |k: u32| {
                    let size = nodes[k as usize].max - nodes[k as usize].min;
                    size.x * size.y + size.y * size.z + size.z * size.x
                };
                let inner = (0..children.len()).filter(|&c| nodes[children[c] as usize].prim_count == 0);
                let Some(largest) = inner.max_by(|&a, &b| area(children[a]).total_cmp(&area(children[b]))) else {
                    break;
                };
                let first = nodes[children[largest] as usize].first_index;
                children[largest] = first;
                children.push(first + 1);
            }
            let entries: Vec<_> = children
                .iter()
                .map(|&k| {
                    let node = &nodes[k as usize];
                    if node.prim_count > 0 {
                        return (node, wide.add_leaf(node, triangles, &masked));
                    }
                    wide.nodes.push(Node::of(&[]));
                    waiting.push((wide.nodes.len() - 1, k, level + 1));
                    (node, wide.nodes.len() as u32 - 1)
                })
                .collect();
            wide.nodes[place] = Node::of(&entries);
        }
        Some(wide)
    }

    /// Number of packets: their names are below it.
    pub(crate) fn packets(&self) -> usize {
        self.packets.len()
    }

    fn add_leaf(&mut self, leaf: &BvhNode, triangles: &[Triangle], masked: &impl Fn(&Triangle) -> bool) -> u32 {
        let index = self.packets.len() as u32;
        let end = leaf.first_index + leaf.prim_count;
        for first in (leaf.first_index..end).step_by(4) {
            let mut packet = Packet { first, more: first + 4 < end, ..Packet::default() };
            for lane in 0..4.min(end - first) as usize {
                let t = &triangles[first as usize + lane];
                packet.masked |= u8::from(masked(t)) << lane;
                for axis in 0..3 {
                    packet.corner[axis][lane] = t.corner[axis];
                    packet.edge_a[axis][lane] = t.edge_a[axis];
                    packet.edge_b[axis][lane] = t.edge_b[axis];
                }
            }
            self.packets.push(packet);
        }
        index | LEAF
    }

    /// A packet with a triangle in the way in (0, t_max) that `is_hole(triangle, u, v)` does not let pass, or [`NONE`].
    /// Those that are `likely`, [`NONE`] or packets, are asked first: they answer where the ray meets them well inside.
    #[inline]
    pub(crate) fn occluder(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        is_hole: impl Fn(u32, f32, f32) -> bool,
        likely: [u32; 2],
    ) -> u32 {
        let ray = WideRay::new(origin, direction);
        for number in likely {
            let Some(packet) = self.packets.get(number as usize) else { continue };
            let (mut mask, u, v, _) = ray.meet(packet, t_max);
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let is_solid =
                    || packet.masked >> lane & 1 == 0 || !is_hole(packet.first + lane as u32, u[lane], v[lane]);
                if is_well_inside(u[lane], v[lane]) && is_solid() {
                    return number;
                }
            }
        }
        self.search::<true>(&ray, t_max, is_hole).1
    }

    /// The nearest triangle in (0, t_max), or any one when `ANY`, that `is_hole(triangle, u, v)` does not let pass.
    #[inline]
    pub(crate) fn traverse<const ANY: bool>(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        is_hole: impl Fn(u32, f32, f32) -> bool,
    ) -> Hit {
        self.search::<ANY>(&WideRay::new(origin, direction), t_max, is_hole).0
    }

    /// [`WideBvh::traverse`], and the packet of the triangle.
    #[inline]
    fn search<const ANY: bool>(
        &self,
        ray: &WideRay,
        t_max: f32,
        is_hole: impl Fn(u32, f32, f32) -> bool,
    ) -> (Hit, u32) {
        let mut best = Hit { triangle: NONE, u: 0.0, v: 0.0, t: t_max };
        let mut holder = NONE;
        let mut waiting = ArrayVec::<(u32, f32), STACK_SIZE>::new();
        let mut current = 0u32;
        loop {
            if current & LEAF != 0 {
                let mut index = (current & !LEAF) as usize;
                loop {
                    let packet = &self.packets[index];
                    let (mut mask, u, v, t) = ray.meet(packet, best.t);
                    while mask != 0 {
                        let lane = mask.trailing_zeros() as usize;
                        mask &= mask - 1;
                        let triangle = packet.first + lane as u32;
                        let may_pass = packet.masked >> lane & 1 == 1;
                        if t[lane] < best.t && !(may_pass && is_hole(triangle, u[lane], v[lane])) {
                            best = Hit { triangle, u: u[lane], v: v[lane], t: t[lane] };
                            holder = index as u32;
                            if ANY {
                                return (best, holder);
                            }
                        }
                    }
                    if !packet.more {
                        break;
                    }
                    index += 1;
                }
            } else {
                let node = &self.nodes[current as usize];
                let (mut mask, near) = ray.enter(node, best.t);
                if mask != 0 {
                    // The nearest child goes on, the others wait in order, the farthest lowest.
                    let mut take = || {
                        let lane = mask.trailing_zeros() as usize;
                        mask &= mask - 1;
                        ((node.children[lane], near[lane]), mask != 0)
                    };
                    let (mut next, mut more) = take();
                    let base = waiting.len();
                    while more {
                        let mut entry;
                        (entry, more) = take();
                        if !ANY && entry.1 < next.1 {
                            core::mem::swap(&mut entry, &mut next);
                        }
                        let mut place = waiting.len();
                        waiting.push(entry);
                        while !ANY && place > base && waiting[place - 1].1 < entry.1 {
                            waiting.swap(place - 1, place);
                            place -= 1;
                        }
                    }
                    current = next.0;
                    continue;
                }
            }
            // Back to the nearest waiting child that may still hold something nearer.
            loop {
                let Some((child, near)) = waiting.pop() else {
                    if best.triangle == NONE {
                        best.t = f32::INFINITY;
                    }
                    return (best, holder);
                };
                if near < best.t {
                    current = child;
                    break;
                }
            }
        }
    }
}

impl Node {
    fn of(children: &[(&BvhNode, u32)]) -> Self {
        let low = [Vec4::INFINITY; 2];
        let high = [Vec4::NEG_INFINITY; 2];
        let mut node = Self { bounds: [low, high, low, high, low, high], children: [0; WIDTH] };
        for (lane, (child, index)) in children.iter().enumerate() {
            for axis in 0..3 {
                node.bounds[2 * axis][lane / 4][lane % 4] = child.min[axis];
                node.bounds[2 * axis + 1][lane / 4][lane % 4] = child.max[axis];
            }
            node.children[lane] = *index;
        }
        node
    }
}
