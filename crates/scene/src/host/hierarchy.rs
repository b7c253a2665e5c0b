//! The binary hierarchy of the kernels, built by obvhs.

use std::vec::Vec;

use obvhs::BvhBuildParams;
use obvhs::bvh2::leaf_collapser::collapse;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::PlocBuilder;

use crate::types::{BvhNode, Triangle};

/// Passes of PLOC that look for neighbours to merge in a small neighbourhood only: none. Scenes of regular parts have
/// many boxes at one place of the space-filling curve, and pairs that such passes make badly stay: with 3 passes, as
/// obvhs has it, rays in the procedural scenes take 2 to 4 times as long.
const SEARCH_DEPTH: usize = 0;

/// A binary hierarchy whose leaves fill packets of four.
///
/// Gives the nodes, root first, and the triangle of each place in the leaves.
pub(super) fn build(triangles: &[Triangle]) -> (Vec<BvhNode>, Vec<u32>) {
    let boxes: Vec<_> = triangles
        .iter()
        .map(|t| obvhs::triangle::Triangle {
            v0: t.corner.into(),
            v1: (t.corner + t.edge_a).into(),
            v2: (t.corner + t.edge_b).into(),
        })
        .collect();
    let settings = BvhBuildParams::medium_build();
    let mut optimizer = ReinsertionOptimizer::default();
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        settings.ploc_search_distance,
        &boxes,
        (0..boxes.len() as u32).collect(),
        settings.sort_precision,
        SEARCH_DEPTH,
    );
    optimizer.run(&mut binary, settings.reinsertion_batch_ratio, None);
    collapse(&mut binary, 4, settings.collapse_traversal_cost);
    let ratio = settings.reinsertion_batch_ratio * settings.post_collapse_reinsertion_batch_ratio_multiplier;
    optimizer.run(&mut binary, ratio, None);
    // What is no longer needed goes at once: a scene of 5 million triangles would take 1 GB more
    // while it is built.
    drop(boxes);
    let nodes = bytemuck::cast_slice(&binary.nodes).to_vec();
    (nodes, binary.primitive_indices)
}

/// Whether nodes from elsewhere are a hierarchy over so many triangles: a tree whose leaves name what is there.
#[cfg(feature = "serde")]
pub(super) fn is_sound(nodes: &[BvhNode], triangles: usize) -> bool {
    let mut stack = std::vec![0u32];
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
    let mut stack = std::vec![(0u32, 1usize)];
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

const _: () = assert!(size_of::<obvhs::bvh2::node::Bvh2Node>() == size_of::<BvhNode>());
