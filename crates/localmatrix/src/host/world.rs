//! Source of patches and their rows of F: a table in memory, or files on a disk.

use alloc::vec::Vec;

use glam::Vec3;

use crate::error::Error;

/// No node.
pub const NO_NODE: u32 = u32::MAX;

/// A patch, or several patches merged into one that stands for them in the distance. The nodes of a world are a forest;
/// a *cut* through it, which has each leaf or one of its ancestors, once, is a set of patches that the light of the
/// world can be between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Middle of its surface, m.
    pub centre: Vec3,
    /// Radius of a sphere round [`Self::centre`] that holds it, m.
    pub radius: f32,
    /// Mean normal, of length 1 at most.
    pub normal: Vec3,
    /// Its area, m²; that of its children together.
    pub area: f32,
    /// Its reflectance, mean over its area.
    pub albedo: Vec3,
    /// The node that it is a part of, or [`NO_NODE`].
    pub parent: u32,
    /// Its first child; its children have successive numbers.
    pub first_child: u32,
    /// Number of its children, 0 for a patch.
    pub children: u32,
}

/// A world of patches.
pub trait World {
    /// All nodes; they stay in memory.
    fn nodes(&self) -> &[Node];

    /// Asks for the rows of nodes that will be wanted, the most urgent first. Returns at once; what was asked for
    /// before and is not in this list is no longer wanted.
    fn want(&mut self, nodes: &[u32]);

    /// The row of F of a node, `(node, share of its light that arrives there)`, or `None` as long as it is not there.
    /// Columns are nodes of any level, none an ancestor of another one.
    ///
    /// # Errors
    /// [`Error`] where the row was lost; the others are still good.
    fn row(&mut self, node: u32) -> Result<Option<Vec<(u32, f32)>>, Error>;
}
