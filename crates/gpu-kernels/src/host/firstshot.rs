//! Host forms of the kernels of photons.

use std::sync::atomic::AtomicU32;

use ::firstshot::kernel::map;
use ::firstshot::kernel::start::Sources;
use ::firstshot::{
    AliasEntry, Element, HIT_BACK, MapGrid, PhotonHit, PhotonParams, PhotonScene, flux_words, register_photons,
    tally_words,
};
use ::scene::{Light, Rgb, Sky};
use zerocopy::FromBytes;

use super::{Bound, HostCall, HostError, geometry, long_enough};
use crate::table::Kernel;

/// A written buffer as words that all cores may add to.
fn shared_words<'s>(bound: Bound<'s, '_>, needed: usize) -> Result<&'s [AtomicU32], HostError> {
    let name = bound.name;
    let bytes = bound.whole::<u8>()?;
    let layout = HostError::Layout { binding: name, stride: size_of::<AtomicU32>(), bytes: bytes.len() };
    let words = <[AtomicU32]>::mut_from_bytes(bytes).map_err(|_| layout)?;
    long_enough(name, words.len(), needed)?;
    Ok(words)
}

pub(crate) fn trace(kernel: &Kernel, call: &mut HostCall) -> Result<(), HostError> {
    let (p, bound) = call.parts::<PhotonParams, 16>(kernel)?;
    let [alias, elements, nodes, triangles, uvs, materials, textures, texels, rest @ ..] = bound;
    let [lights, sky, sky_map, distributions, grids, groups, flux, tallies] = rest;
    let scene = PhotonScene {
        geometry: geometry([nodes, triangles, uvs, materials, textures, texels])?,
        sources: Sources {
            lights: lights.read::<Light>(0)?,
            sky: sky.read::<Sky>(1)?[0],
            sky_map: sky_map.read::<Rgb>(0)?,
            distributions: distributions.read::<f32>(0)?,
        },
        alias: alias.read::<AliasEntry>(p.element_count as usize)?,
        elements: elements.read::<Element>(p.element_count as usize)?,
    };
    let grids = grids.read::<MapGrid>(scene.geometry.triangles.len())?;
    let groups = groups.read::<u32>(p.cell_count as usize)?;
    let flux = shared_words(flux, flux_words(p.cell_count as usize))?;
    let batches = p.count / p.per_batch.max(1);
    let tallies = shared_words(tallies, tally_words(p.group_count as usize, batches))?;
    let cell = |hit: &PhotonHit| map::cell_at(grids[hit.triangle as usize], hit.u, hit.v, hit.info & HIT_BACK != 0);
    register_photons(&scene, &p, cell, |cell| groups[cell as usize], flux, tallies);
    Ok(())
}
