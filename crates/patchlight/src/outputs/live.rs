//! Probes in the air whose light follows a light field from update to update.

use glam::{Vec3, Vec4};
use patches::kernel::volume::CUBE_SIDES;
use patches::{VolumeSettings, VolumeSize, VoxelVolume};
use scene::ReceiverSet as _;
use transport::Observer;

use super::is_lit;
use crate::bake::ReceiverKind;
use crate::error::{Error, Reason};
use crate::light::LightField;
use crate::points::{Point, PointKind, PointLight, PointSet};

/// A volume of ambient cubes ([`VoxelVolume`]) whose probes are [points](LightField::add_points) of a light field. It
/// lights what moves through the scene; what moves neither reflects nor hides light.
#[derive(Clone, Debug)]
pub struct LiveProbes {
    volume: VoxelVolume,
    set: PointSet,
    cubes: Vec<Vec4>,
}

impl LiveProbes {
    /// Adds about `count` probes over the bounds of a bake to its light field, with so many rays from each of their six
    /// sides; no light yet.
    ///
    /// # Errors
    /// [`Unsupported`](crate::ErrorKind::Unsupported) unless receivers are on the mesh, which say where light comes,
    /// and for a scene with a medium; a scene without room for probes; cancellation.
    pub fn new(field: &mut LightField, count: u32, rays: u32, observer: &dyn Observer) -> Result<Self, Error> {
        let bake = field.bake().clone();
        if bake.settings.receivers != ReceiverKind::Mesh {
            return Err(Reason::OutputReceivers.into());
        }
        let settings = VolumeSettings { size: VolumeSize::Count(count), ..VolumeSettings::default() };
        let volume = VoxelVolume::new(&bake.scene, &settings, &|point| is_lit(&bake, point))?;
        let first_of_each = volume.points().iter().step_by(CUBE_SIDES as usize);
        let probes: Vec<Point> =
            first_of_each.map(|side| Point { position: side.position, normal: side.normal }).collect();
        let set = field.add_points_by_rays(&probes, PointKind::Cube, rays, observer)?;
        let cubes = vec![Vec4::ZERO; volume.points().len()];
        Ok(Self { volume, set, cubes })
    }

    /// Takes the light of the last update; waits for it.
    ///
    /// # Errors
    /// What the device says; a light field that has not been updated yet, or is not that of the probes.
    pub fn update(&mut self, field: &mut LightField) -> Result<(), Error> {
        let light = field.read(self.set)?;
        self.take(&light);
        Ok(())
    }

    /// Takes the newest light that has arrived, without waiting: [`LightField::try_read`]. Says which update it is of;
    /// `None` before the first.
    ///
    /// # Errors
    /// What the device says.
    pub fn try_update(&mut self, field: &mut LightField) -> Result<Option<u32>, Error> {
        let Some(light) = field.try_read(self.set)? else { return Ok(None) };
        self.take(light);
        Ok(Some(light.update))
    }

    fn take(&mut self, light: &PointLight) {
        for (cube, value) in self.cubes.iter_mut().zip(&light.values) {
            *cube = value.extend(0.0);
        }
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
