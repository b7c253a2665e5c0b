//! The host side: voxels, samples and patches, on all cores, the same bytes for any number of them.

mod axis;
mod cluster;
mod grid;
mod group;
mod lightmap;
mod lit;
mod lookup;
mod nearest;
mod patch_set;
mod receivers;
mod sample;
mod subdivide;
mod view;
mod volume;

pub use axis::{AxisWeights, axis_patches};
pub use cluster::{ClusterMetric, ClusterSettings, cluster_patches};
pub use grid::{Grid, PIECE_LIMIT, VOXEL_LIMIT};
pub use lightmap::{LIGHTMAP_LIMIT, LightmapTexels};
pub use lit::LitSampler;
pub use lookup::{Lookup, LookupSettings};
pub use nearest::Nearest;
pub use patch_set::PatchSet;
pub use receivers::Receivers;
pub use sample::{AreaRule, SampleReport, SampleSet, SampleSettings, sample_voxels};
pub use subdivide::{
    PatchSize, SubdivideSettings, Subdivision, cell_grids, divisions_for_area, divisions_for_count,
    divisions_for_gradient, subdivide,
};
pub use view::{ViewClusters, ViewSettings, view_clusters};
pub use volume::{PROBE_LIMIT, VolumeSettings, VolumeSize, VoxelVolume};
