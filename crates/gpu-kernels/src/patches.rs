//! Kernels of the virtual patches: lookups between patches and between probes in the air.

use ::patches::kernel::{lookup, volume};
use ::patches::{LookupParams, LookupPatch, VolumeParams};
use ::scene::{Rgb, SurfacePoint};

kernels! {
    /// Value of the patches round every point, W/m² for irradiance: [`lookup::lookup`]. One
    /// invocation per point.
    PATCHES_LOOKUP = "patches_lookup"(p: LookupParams) for k in 0..count {
        cells: read [u32; crate::host::patches::voxels(&p.shape)?],
        offsets: read [u32; crate::host::patches::cells_named(cells) + 1],
        entries: read [LookupPatch; offsets[crate::host::patches::cells_named(cells)] as usize],
        values: read [Rgb],
        points: read [SurfacePoint; count],
        irradiance: write [Rgb],
    } each {
        let point = points[k as usize];
        lookup::lookup(p, cells, offsets, entries, values, point.position, point.normal)
    }

    /// Irradiance of the ambient cubes round every point, W/m²: [`volume::volume_lookup`]. One
    /// invocation per point.
    PATCHES_VOLUME_LOOKUP = "patches_volume_lookup"(p: VolumeParams) for k in 0..count {
        probes: read [u32; crate::host::patches::voxels(&p.shape)?],
        planes: read [f32; crate::host::patches::of_probes(probes, volume::PLANE_WORDS)],
        cubes: read [Rgb; crate::host::patches::of_probes(probes, volume::CUBE_SIDES)],
        points: read [SurfacePoint; count],
        irradiance: write [Rgb],
    } each {
        let point = points[k as usize];
        volume::volume_lookup(p, probes, planes, cubes, point.position, point.normal)
    }

    /// The same of spherical harmonics of degree 1, four coefficients a probe:
    /// [`volume::volume_lookup_sh`].
    PATCHES_VOLUME_LOOKUP_SH = "patches_volume_lookup_sh"(p: VolumeParams) for k in 0..count {
        probes: read [u32; crate::host::patches::voxels(&p.shape)?],
        planes: read [f32; crate::host::patches::of_probes(probes, volume::PLANE_WORDS)],
        harmonics: read [Rgb; crate::host::patches::of_probes(probes, volume::SH_COEFFICIENTS)],
        points: read [SurfacePoint; count],
        irradiance: write [Rgb],
    } each {
        let point = points[k as usize];
        volume::volume_lookup_sh(p, probes, planes, harmonics, point.position, point.normal)
    }
}
