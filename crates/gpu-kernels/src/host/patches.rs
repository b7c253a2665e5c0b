//! Host forms of the kernels of virtual patches.

use ::patches::kernel::volume::{CUBE_SIDES, PLANE_WORDS, SH_COEFFICIENTS};
use ::patches::kernel::{gather, lookup, volume};
use ::patches::{EMPTY_CELL, GridShape, LookupParams, LookupPatch, Member, VolumeParams};
use ::scene::{Rgb, SurfacePoint};
use glam::Vec3;

use super::{HostCall, HostError, agreed, fill};
use crate::params::CountParams;
use crate::table::Kernel;

pub(crate) fn gather_mean(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [offsets, members, values, means]) = call.parts::<CountParams, 4>(kernel)?;
    let n = agreed(elements, p.count)?;
    let offsets = offsets.read::<u32>(n + 1)?;
    let members = members.read::<Member>(offsets[n] as usize)?;
    let values = values.read::<Rgb>(0)?;
    fill(means.write(n)?, |k| gather::gather_mean(k, offsets, members, values));
    Ok(())
}

/// Voxels of a grid; a count that does not fit is more than any table has.
fn voxels(shape: &GridShape) -> Result<usize, HostError> {
    let counts = [shape.count_x, shape.count_y, shape.count_z].map(|n| n as usize);
    let found = counts.into_iter().fold(1, usize::saturating_mul);
    if found == 0 { Err(HostError::TooShort { binding: "voxels of the grid", needed: 1, found }) } else { Ok(found) }
}

/// The greatest number in a table of cells, and one more.
fn named(cells: &[u32]) -> usize {
    cells.iter().map(|cell| (cell & !EMPTY_CELL) as usize + 1).max().unwrap_or(0)
}

pub(crate) fn lookup(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [cells, offsets, entries, values, points, irradiance]) = call.parts::<LookupParams, 6>(kernel)?;
    let n = agreed(elements, p.count)?;
    let cells = cells.read::<u32>(voxels(&p.shape)?)?;
    let offsets = offsets.read::<u32>(named(cells) + 1)?;
    let entries = entries.read::<LookupPatch>(offsets[named(cells)] as usize)?;
    let (values, points) = (values.read::<Rgb>(0)?, points.read::<SurfacePoint>(n)?);
    fill(irradiance.write(n)?, |k| {
        let point = points[k as usize];
        lookup::lookup(&p, cells, offsets, entries, values, point.position, point.normal)
    });
    Ok(())
}

/// A lookup between probes that have `size` values each.
fn between_probes(
    kernel: &Kernel,
    call: &mut HostCall,
    size: u32,
    body: impl Fn(&VolumeParams, &[u32], &[f32], &[Rgb], Vec3, Vec3) -> Rgb + Sync,
) -> Result<(), HostError> {
    let elements = call.elements;
    let (p, [probes, planes, values, points, irradiance]) = call.parts::<VolumeParams, 5>(kernel)?;
    let n = agreed(elements, p.count)?;
    let probes = probes.read::<u32>(voxels(&p.shape)?)?;
    let count = named(probes);
    let planes = planes.read::<f32>(count * PLANE_WORDS as usize)?;
    let values = values.read::<Rgb>(count * size as usize)?;
    let points = points.read::<SurfacePoint>(n)?;
    fill(irradiance.write(n)?, |k| {
        let point = points[k as usize];
        body(&p, probes, planes, values, point.position, point.normal)
    });
    Ok(())
}

pub(crate) fn volume_lookup(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    between_probes(kernel, call, CUBE_SIDES, volume::volume_lookup)
}

pub(crate) fn volume_lookup_sh(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    between_probes(kernel, call, SH_COEFFICIENTS, volume::volume_lookup_sh)
}
