//! Probes in the air whose light follows a renderer from frame to frame.

use glam::{Vec3, Vec4};
use patches::{Columns, VolumeSettings, VolumeSize, VoxelVolume};
use scene::ReceiverSet as _;
use transport::{HitCounts, LinearOperator as _};

use super::is_lit;
use crate::bake::{Bake, ReceiverKind};
use crate::error::Error;
use crate::observe::Report;
use crate::renderer::Renderer;

/// A volume of ambient cubes ([`VoxelVolume`]) with the form factors from its receivers to the elements: geometry is at
/// rest, so the indirect light of the probes, `H = F B` with the exitance B of the elements, is one product a frame. It
/// lights what moves through the scene; what moves neither reflects nor hides light.
#[derive(Clone, Debug)]
pub struct LiveProbes {
    volume: VoxelVolume,
    rows: HitCounts,
    cubes: Vec<Vec4>,
}

impl LiveProbes {
    /// About `count` probes over the bounds of a bake, with so many rays from each of their six sides; no light yet.
    ///
    /// # Errors
    /// [`Error::OutputReceivers`] unless receivers are on the mesh, which say where light comes; [`Error::Medium`]; a
    /// scene without room for probes; cancellation.
    pub fn new(bake: &Bake, count: u32, rays: u32, report: &Report) -> Result<Self, Error> {
        if bake.settings.receivers != ReceiverKind::Mesh {
            return Err(Error::OutputReceivers);
        }
        if bake.scene.has_medium() {
            return Err(Error::Medium { what: "the light of live probes" });
        }
        let settings = VolumeSettings { size: VolumeSize::Count(count), ..VolumeSettings::default() };
        let volume = VoxelVolume::new(&bake.scene, &settings, &|point| is_lit(bake, point))?;
        let mut rows = HitCounts::new(bake.mesh.elements.len())?;
        let points = volume.points();
        let offsets: Vec<u32> = (0..=points.len() as u32).collect();
        let surfaces = bake.mesh.lighting(&bake.scene, Columns::Elements, points, &offsets, bake.settings.seed);
        formfactor::add_hit_rows(&mut rows, &surfaces, rays, &report)?;
        let cubes = vec![Vec4::ZERO; points.len()];
        drop(surfaces);
        Ok(Self { volume, rows, cubes })
    }

    /// Takes the light of the last update of a renderer of the same bake; waits.
    ///
    /// # Errors
    /// What the device says; a renderer of a bake with another number of elements.
    pub fn update(&mut self, renderer: &mut Renderer) -> Result<(), Error> {
        let exitance = renderer.download(renderer.irradiance().element_exitance)?;
        Ok(self.rows.apply(&exitance, &mut self.cubes)?)
    }

    /// The probes.
    pub fn volume(&self) -> &VoxelVolume {
        &self.volume
    }

    /// Indirect irradiance at a point with a unit normal, W/m².
    pub fn irradiance(&self, position: Vec3, normal: Vec3) -> Vec3 {
        let light = self.volume.at(&self.cubes, position, normal);
        light.map_or(Vec3::ZERO, Vec4::truncate)
    }
}
