//! The host side: voxels, samples and patches, on all cores, the same bytes for any number of them.

mod patch_set;

pub use patch_set::PatchSet;
