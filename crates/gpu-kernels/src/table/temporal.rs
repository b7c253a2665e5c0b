//! Radiosity by samples.

use ::scene::Rgb;
use ::temporal::{SampleParams, SplitParams, SumParams};
use glam::UVec2;

use super::{Access, Aligned, Kernel, buffer, read, write};
use crate::host;
use crate::invocation::WORKGROUP;
use crate::params::CountParams;

/// Change of the exitance since the irradiance was sampled, W/m². An element is a patch.
pub static TEMPORAL_CHANGE: Kernel = Kernel {
    name: "temporal_change",
    spv: spv!("temporal_change"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[
        read::<Rgb>("source"),
        read::<Rgb>("albedo"),
        read::<Rgb>("irradiance"),
        read::<Rgb>("exitance"),
        write::<Rgb>("change"),
    ],
    host: host::temporal::change,
};

/// Irradiance one frame on, W/m², by samples of lists of hits (`temporal::RayLists`). An element is a row.
pub static TEMPORAL_SAMPLE_LISTS: Kernel = Kernel {
    name: "temporal_sample_lists",
    spv: spv!("temporal_sample_lists"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<SampleParams>() as u32,
    bindings: &[
        read::<u32>("row_start"),
        read::<u32>("columns"),
        read::<f32>("row_sums"),
        read::<Rgb>("exitance"),
        read::<Rgb>("change"),
        buffer::<Rgb>("irradiance", Access::ReadWrite),
    ],
    host: host::temporal::sample_lists,
};

/// The same by samples of alias tables (`temporal::AliasTables`).
pub static TEMPORAL_SAMPLE_TABLES: Kernel = Kernel {
    name: "temporal_sample_tables",
    spv: spv!("temporal_sample_tables"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<SampleParams>() as u32,
    bindings: &[
        read::<u32>("row_start"),
        read::<u32>("slots"),
        read::<u32>("columns"),
        read::<u32>("colors"),
        read::<f32>("row_sums"),
        read::<Rgb>("exitance"),
        read::<Rgb>("change"),
        buffer::<Rgb>("irradiance", Access::ReadWrite),
    ],
    host: host::temporal::sample_tables,
};

/// Exact irradiance of some rows of lists of hits, W/m². An element is one of these rows.
pub static TEMPORAL_SUM_LISTS: Kernel = Kernel {
    name: "temporal_sum_lists",
    spv: spv!("temporal_sum_lists"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<SumParams>() as u32,
    bindings: &[
        read::<u32>("row_start"),
        read::<u32>("columns"),
        read::<f32>("row_sums"),
        read::<Rgb>("exitance"),
        buffer::<Rgb>("irradiance", Access::ReadWrite),
    ],
    host: host::temporal::sum_lists,
};

/// The same of alias tables.
pub static TEMPORAL_SUM_TABLES: Kernel = Kernel {
    name: "temporal_sum_tables",
    spv: spv!("temporal_sum_tables"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<SumParams>() as u32,
    bindings: &[
        read::<u32>("row_start"),
        read::<u32>("slots"),
        read::<u32>("columns"),
        read::<u32>("colors"),
        read::<f32>("row_sums"),
        read::<Rgb>("exitance"),
        buffer::<Rgb>("irradiance", Access::ReadWrite),
    ],
    host: host::temporal::sum_tables,
};

/// Partition and prefix sums of the weights of each row, for alias tables. An element is a row.
pub static TEMPORAL_SPLIT_SCAN: Kernel = Kernel {
    name: "temporal_split_scan",
    spv: spv!("temporal_split_scan"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<SplitParams>() as u32,
    bindings: &[read::<u32>("row_start"), read::<u32>("weights"), write::<UVec2>("scan")],
    host: host::temporal::split_scan,
};

/// Slots of alias tables. An element is an entry.
pub static TEMPORAL_SPLIT_PACK: Kernel = Kernel {
    name: "temporal_split_pack",
    spv: spv!("temporal_split_pack"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<SplitParams>() as u32,
    bindings: &[read::<u32>("row_start"), read::<u32>("weights"), read::<UVec2>("scan"), write::<u32>("slots")],
    host: host::temporal::split_pack,
};
