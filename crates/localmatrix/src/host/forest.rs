//! The order of a world's nodes: each covers a run of leaves.

use alloc::vec::Vec;

use super::world::{NO_NODE, Node};
use crate::error::Error;

/// The leaves of a forest in the order of its trees, and the run of them that each node covers: a node is an ancestor
/// of another one, or itself, where its run holds the other's.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Forest {
    /// First leaf of each node, and the one after its last.
    runs: Vec<[u32; 2]>,
    leaves: Vec<u32>,
    roots: Vec<u32>,
}

impl Forest {
    /// Orders nodes.
    ///
    /// # Errors
    /// [`Error::Node`] where parents and children do not agree or a value is none.
    pub fn new(nodes: &[Node]) -> Result<Self, Error> {
        let count = nodes.len();
        let wrong = |node: usize, reason| Err(Error::Node { node: node as u32, reason });
        for (i, node) in nodes.iter().enumerate() {
            let first = node.first_child as usize;
            let end = node.first_child as usize + node.children as usize;
            if node.children > 0 && end > count {
                return wrong(i, "its children are beyond the last node");
            }
            if node.children > 0 && (first..end).any(|child| nodes[child].parent != i as u32) {
                return wrong(i, "a child of it has another parent");
            }
            if node.parent != NO_NODE {
                let is_child = |parent: &Node| (i as u32).wrapping_sub(parent.first_child) < parent.children;
                if !nodes.get(node.parent as usize).is_some_and(is_child) {
                    return wrong(i, "it is no child of its parent");
                }
            }
            if !(node.area > 0.0 && node.area.is_finite() && node.centre.is_finite() && node.radius.is_finite()) {
                return wrong(i, "its area, centre or radius is no number, or the area not positive");
            }
            if !node.albedo.to_array().iter().all(|rho| (0.0..1.0).contains(rho)) {
                return wrong(i, "its reflectance is not at least 0 and below 1");
            }
        }
        let roots: Vec<u32> = (0..count as u32).filter(|&i| nodes[i as usize].parent == NO_NODE).collect();
        let mut runs = vec![[0; 2]; count];
        let mut leaves = Vec::new();
        let mut met = 0;
        // Down to the children, and once more when they are done.
        let mut stack: Vec<(u32, bool)> = roots.iter().rev().map(|&root| (root, false)).collect();
        while let Some((i, is_done)) = stack.pop() {
            let node = &nodes[i as usize];
            if is_done {
                runs[i as usize][1] = leaves.len() as u32;
                continue;
            }
            met += 1;
            runs[i as usize][0] = leaves.len() as u32;
            if node.children == 0 {
                leaves.push(i);
            }
            stack.push((i, true));
            stack.extend((node.first_child..node.first_child + node.children).rev().map(|child| (child, false)));
        }
        match met == count {
            true => Ok(Self { runs, leaves, roots }),
            // What no root leads to goes round in a circle.
            false => wrong((0..count).find(|&i| runs[i] == [0; 2]).unwrap_or(0), "it is its own ancestor"),
        }
    }

    /// Bytes of its tables.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.runs[..]) + size_of_val(&self.leaves[..]) + size_of_val(&self.roots[..])
    }

    /// The node of each leaf.
    pub fn leaves(&self) -> &[u32] {
        &self.leaves
    }

    /// Nodes without a parent.
    pub fn roots(&self) -> &[u32] {
        &self.roots
    }

    /// First leaf of a node, and the one after its last.
    pub fn run(&self, node: u32) -> [u32; 2] {
        self.runs[node as usize]
    }

    /// Returns true if a node is another one, or an ancestor of it.
    pub fn covers(&self, node: u32, other: u32) -> bool {
        let a = self.run(node);
        let b = self.run(other);
        a[0] <= b[0] && b[1] <= a[1]
    }

    /// The first of some nodes, which are in order and none an ancestor of another one, that does not end before a node
    /// begins.
    pub(super) fn first_from(&self, cut: &[u32], node: u32) -> usize {
        cut.partition_point(|&one| self.run(one)[1] <= self.run(node)[0])
    }
}
