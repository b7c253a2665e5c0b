//! The binary hierarchy of the kernels, built by obvhs, or by cuts where there is no `std`.

#[cfg(any(test, not(feature = "std")))]
mod split;

#[cfg(feature = "std")]
use alloc::vec::Vec;

use crate::gpu::BvhNode;
#[cfg(feature = "std")]
use crate::gpu::Triangle;

#[cfg(not(feature = "std"))]
pub(super) use split::build;

/// Passes of PLOC that look for neighbours to merge in a small neighbourhood only: none. Scenes of regular parts have
/// many boxes at one place of the space-filling curve, and pairs that such passes make badly stay: with 3 passes, as
/// obvhs has it, rays in the procedural scenes take 2 to 4 times as long.
#[cfg(feature = "std")]
const SEARCH_DEPTH: usize = 0;

/// Share by which boxes are larger at most, each by its own, while partners are looked for.
///
/// A pass of PLOC merges pairs whose boxes are each other's best partners. In a row of equal boxes at equal distances
/// each has its best partner on one and the same side, so that a pass merges one pair and as many passes are needed as
/// there are boxes: the work is quadratic. Sizes that differ a little leave about a third of the boxes with a partner.
#[cfg(feature = "std")]
const UNEVENNESS: f32 = 0.01;

/// A binary hierarchy whose leaves fill packets of four.
///
/// Gives the nodes, root first, and the triangle of each place in the leaves.
#[cfg(feature = "std")]
pub(super) fn build(triangles: &[Triangle]) -> (Vec<BvhNode>, Vec<u32>) {
    use obvhs::BvhBuildParams;
    use obvhs::bvh2::leaf_collapser::collapse;
    use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
    use obvhs::ploc::PlocBuilder;

    let boxes = uneven_boxes(triangles);
    let settings = BvhBuildParams::medium_build();
    let mut optimizer = ReinsertionOptimizer::default();
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        settings.ploc_search_distance,
        &boxes,
        (0..boxes.len() as u32).collect(),
        settings.sort_precision,
        SEARCH_DEPTH,
    );
    // What is no longer needed goes at once: a scene of 5 million triangles would take 1 GB more while it is built.
    drop(boxes);
    for leaf in binary.nodes.iter_mut().filter(|node| node.is_leaf()) {
        leaf.set_aabb(exact_box(&triangles[binary.primitive_indices[leaf.first_index as usize] as usize]));
    }
    binary.refit_all();
    optimizer.run(&mut binary, settings.reinsertion_batch_ratio, None);
    collapse(&mut binary, 4, settings.collapse_traversal_cost);
    let ratio = settings.reinsertion_batch_ratio * settings.post_collapse_reinsertion_batch_ratio_multiplier;
    optimizer.run(&mut binary, ratio, None);
    let nodes = bytemuck::cast_slice(&binary.nodes).to_vec();
    (nodes, binary.primitive_indices)
}

#[cfg(feature = "std")]
fn exact_box(t: &Triangle) -> obvhs::aabb::Aabb {
    // By way of arrays: obvhs may have another version of glam.
    let corners = [t.corner, t.corner + t.edge_a, t.corner + t.edge_b].map(|corner| corner.to_array().into());
    obvhs::triangle::Triangle { v0: corners[0], v1: corners[1], v2: corners[2] }.aabb()
}

/// Boxes of triangles, each larger by a share of its own.
#[cfg(feature = "std")]
fn uneven_boxes(triangles: &[Triangle]) -> Vec<obvhs::aabb::Aabb> {
    use crate::sampling::{hash3, unit};
    let grown = |(k, t): (usize, &Triangle)| {
        let mut bounds = exact_box(t);
        bounds.max += (bounds.max - bounds.min) * UNEVENNESS * unit(hash3(k as u32, 0, 0));
        bounds
    };
    triangles.iter().enumerate().map(grown).collect()
}

/// Returns true if nodes from elsewhere are a hierarchy over so many triangles: a tree whose leaves name what is there.
pub(super) fn is_sound(nodes: &[BvhNode], triangles: usize) -> bool {
    let mut stack = alloc::vec![0u32];
    // In a tree no node is met twice.
    for _ in 0..nodes.len() {
        let Some(node) = stack.pop().map(|k| nodes.get(k as usize)) else { return true };
        let Some(node) = node else { return false };
        match node.prim_count {
            0 => stack.extend([node.first_index, node.first_index.wrapping_add(1)]),
            count => {
                if node.first_index as usize + count as usize > triangles {
                    return false;
                }
            }
        }
    }
    stack.is_empty() && !nodes.is_empty()
}

/// Levels of the hierarchy.
pub(super) fn depth(nodes: &[BvhNode]) -> usize {
    let mut stack = alloc::vec![(0u32, 1usize)];
    let mut deepest = 0;
    while let Some((k, level)) = stack.pop() {
        deepest = deepest.max(level);
        let node = &nodes[k as usize];
        if node.prim_count == 0 {
            stack.push((node.first_index, level + 1));
            stack.push((node.first_index + 1, level + 1));
        }
    }
    deepest
}

#[cfg(feature = "std")]
const _: () = assert!(size_of::<obvhs::bvh2::node::Bvh2Node>() == size_of::<BvhNode>());

#[cfg(test)]
mod tests {
    use alloc::vec::Vec;

    use glam::Vec3;

    use super::{depth, split};
    use crate::gpu::{Material, Triangle, TriangleUv};
    use crate::host::geometry::Geometry;
    use crate::kernel::bvh::{FAR, STACK_SIZE};
    use crate::sampling::{hash3, unit};
    use crate::{Hit, NONE, SceneParts};

    /// Triangles anywhere in a cube of 1 m, each with its number in `source`.
    fn triangles(count: u32) -> Vec<Triangle> {
        let place = |k: u32, d: u32| Vec3::new(unit(hash3(k, d, 0)), unit(hash3(k, d, 1)), unit(hash3(k, d, 2)));
        (0..count)
            .map(|k| {
                let edge = |d: u32| 0.3 * (place(k, d) - 0.5);
                Triangle { corner: place(k, 0), edge_a: edge(1), edge_b: edge(2), source: k, ..Triangle::default() }
            })
            .collect()
    }

    fn geometry(triangles: &[Triangle], order: &[u32], nodes: Vec<crate::gpu::BvhNode>) -> Geometry {
        let triangles: Vec<Triangle> = order.iter().map(|&k| triangles[k as usize]).collect();
        let uvs = alloc::vec![TriangleUv::default(); triangles.len()];
        let materials = alloc::vec![Material::default()];
        Geometry::of_leaves(SceneParts { triangles, uvs, materials, ..SceneParts::default() }, nodes).unwrap()
    }

    /// Hits of rays from the middle of the cube: number of the triangle, shares of its edges, distance.
    fn hits(geometry: &Geometry) -> Vec<(u32, [u32; 3])> {
        (0..2000)
            .map(|k| {
                let direction = Vec3::new(unit(hash3(k, 0, 7)), unit(hash3(k, 1, 7)), unit(hash3(k, 2, 7))) - 0.5;
                let Hit { triangle, u, v, t } = geometry.closest_before(Vec3::splat(0.5), direction, FAR);
                let source = if triangle == NONE { NONE } else { geometry.triangles[triangle as usize].source };
                (source, [u, v, t].map(f32::to_bits))
            })
            .collect()
    }

    #[test]
    fn rays_meet_the_same_through_either_hierarchy() {
        let all = triangles(300);
        let (nodes, order) = super::build(&all);
        let expected = hits(&geometry(&all, &order, nodes));
        let (nodes, order) = split::build(&all);
        assert!(hits(&geometry(&all, &order, nodes.clone())) == expected);
        // One whose leaves all name the same triangles is noticed.
        let mut wrong = nodes;
        wrong.iter_mut().filter(|node| node.prim_count > 0).for_each(|leaf| leaf.first_index = 0);
        let found = hits(&geometry(&all, &order, wrong));
        assert!(found != expected, "a broken hierarchy gives the same hits");
    }

    /// Triangles in a row, one a metre.
    fn row(count: u32) -> Vec<Triangle> {
        (0..count)
            .map(|k| Triangle {
                corner: Vec3::X * k as f32,
                edge_a: 0.5 * Vec3::X,
                edge_b: 0.5 * Vec3::Y,
                source: k,
                ..Triangle::default()
            })
            .collect()
    }

    /// Boxes that a pass of PLOC would merge: whose best partners among the next `reach` have them as theirs.
    fn merged(boxes: &[obvhs::aabb::Aabb], reach: usize) -> usize {
        let best = |k: usize| {
            let near = k.saturating_sub(reach)..(k + reach + 1).min(boxes.len());
            let area = |&j: &usize| boxes[k].union(&boxes[j]).half_area();
            near.filter(|&j| j != k).min_by(|a, b| area(a).total_cmp(&area(b))).unwrap()
        };
        let best: Vec<usize> = (0..boxes.len()).map(best).collect();
        (0..boxes.len()).filter(|&k| best[best[k]] == k).count()
    }

    #[test]
    fn boxes_in_a_row_find_partners_in_few_passes() {
        let all = row(2000);
        let exact: Vec<_> = all.iter().map(super::exact_box).collect();
        assert!(merged(&exact, 14) <= 4, "equal boxes part by themselves");
        // With a quarter merged in a pass, n boxes are done in O(n) steps.
        let found = merged(&super::uneven_boxes(&all), 14);
        assert!(found >= all.len() / 4, "{found} of {} boxes have a partner", all.len());
        let (nodes, _) = super::build(&all);
        assert!(depth(&nodes) < 40, "{}", depth(&nodes));
    }

    #[test]
    fn boxes_of_nodes_are_exact() {
        let all = triangles(300);
        let (nodes, _) = super::build(&all);
        let corners = |t: &Triangle| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b];
        let highest = all.iter().flat_map(corners).fold(Vec3::NEG_INFINITY, Vec3::max);
        let root = nodes[0].max;
        assert!((root - highest).abs().max_element() < 1e-6, "{root} {highest}");
    }

    #[test]
    fn triangles_that_lie_on_each_other_are_halved() {
        let all = alloc::vec![triangles(1)[0]; 5000];
        let (nodes, order) = split::build(&all);
        assert!(depth(&nodes) <= 13 && order.len() == all.len(), "{}", depth(&nodes));
    }

    #[test]
    fn triangles_in_ever_smaller_steps_fit_on_the_stack() {
        let mut all = triangles(1 << 12);
        // Each at half the distance of the one before, as far as single precision goes: bins part one at a time.
        all.iter_mut().enumerate().for_each(|(k, t)| {
            t.corner = Vec3::X * 2f32.powi(-(k as i32 % 120));
            t.edge_a *= 1e-30;
            t.edge_b *= 1e-30;
        });
        let (nodes, _) = split::build(&all);
        assert!(depth(&nodes) > 32 && depth(&nodes) <= STACK_SIZE, "{}", depth(&nodes));
    }
}
