//! The host side: voxels, samples and patches, on all cores, the same bytes for any number of them.

mod axis;
#[cfg(feature = "serde")]
mod check;
mod cluster;
mod cut;
mod focus;
mod grid;
mod group;
mod interpolation_mesh;
mod lightmap;
mod lit;
mod lookup;
mod mesh;
mod nearest;
mod patch_set;
mod placement;
mod sample;
mod subdivide;
mod test_lights;
mod view;
mod visibility;
mod volume;
mod weights;

pub use axis::axis_patches;
pub use cluster::{ClusterSettings, cluster_patches};
pub use cut::cut_at_feet;
pub use focus::{Density, Focus};
pub use grid::{CLIPPED_TRIANGLE_LIMIT, Grid, VOXEL_LIMIT};
pub use interpolation_mesh::InterpolationMesh;
pub use lightmap::{LIGHTMAP_LIMIT, LightmapTexels};
pub use lit::{LitSampler, Walker};
pub use lookup::{Lookup, LookupSettings};
pub use mesh::{
    Columns, EditedMesh, MAX_PATCHES, MeshChange, MeshSettings, PatchKind, PatchMesh, Zone, lit_sampler,
    lit_sampler_with,
};
pub use nearest::Nearest;
pub use patch_set::PatchSet;
pub use placement::{AddRows, KeptReceivers, MeshReceivers, Placing};
pub use sample::{AreaRule, Keep, SampleReport, SampleSet, SampleSettings, sample_voxels, sample_voxels_by};
pub use subdivide::{
    PatchSize, SubdivideSettings, Subdivision, cell_grids, divisions_for_area, divisions_for_count,
    divisions_for_gradient, subdivide,
};
pub use test_lights::{LIGHT_VECTORS, Lights, TestLights, test_lights};
pub use view::{ViewClusters, ViewSettings, view_clusters};
pub use visibility::{SurfacePlace, is_covered, is_visible};
pub use volume::{PROBE_LIMIT, VolumeSettings, VolumeSize, VoxelVolume};
pub use weights::{PackedWeights, Weight};
