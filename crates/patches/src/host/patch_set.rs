//! Patches with the samples they are made of.

use alloc::vec::Vec;

use glam::{DVec3, Vec3, Vec4};
use scene::parallel::*;
use scene::{NONE, SurfacePoint};

use crate::error::Error;
use crate::kernel::gather::gather_mean;
use crate::types::{Member, Sample, VirtualPatch};

/// Samples and the patches that share them out: patch i owns `members[offsets[i]..offsets[i + 1]]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PatchSet {
    /// Samples, in the order of their voxels.
    pub samples: Vec<Sample>,
    /// Patches, `[n]`.
    pub patches: Vec<VirtualPatch>,
    /// First member of each patch, `[n + 1]`, rising.
    pub offsets: Vec<u32>,
    /// Samples of all patches with their shares of the patch's area.
    pub members: Vec<Member>,
}

/// Rounding that a sum of shares may have.
const SHARE_TOLERANCE: f64 = 1e-4;

impl PatchSet {
    /// Puts a set together from its tables and checks them.
    ///
    /// # Errors
    /// Names the table and entry that is wrong: lengths, areas that are not positive, normals that are not unit
    /// vectors, members that name no sample, shares that do not sum to 1.
    pub fn new(
        samples: Vec<Sample>,
        patches: Vec<VirtualPatch>,
        offsets: Vec<u32>,
        members: Vec<Member>,
    ) -> Result<Self, Error> {
        check_samples(&samples)?;
        check_groups(&samples, &offsets, &members)?;
        if offsets.len() != patches.len() + 1 {
            return Err(Error::Length { name: "offsets", expected: patches.len() + 1, found: offsets.len() });
        }
        for (index, patch) in patches.iter().enumerate() {
            check_area("patches.area", index, patch.area)?;
            check_normal("patches.normal", index, patch.normal)?;
            let range = offsets[index] as usize..offsets[index + 1] as usize;
            let sum: f64 = members[range].iter().map(|m| f64::from(m.weight)).sum();
            if sum.is_nan() || (sum - 1.0).abs() > SHARE_TOLERANCE {
                let rule = "1, the sum of the patch's shares";
                return Err(Error::Value { name: "members.weight", index, value: sum, rule });
            }
        }
        Ok(Self { samples, patches, offsets, members })
    }

    /// Makes the patches from groups of samples. `members[offsets[i]..offsets[i + 1]]` are the samples of patch i with
    /// the part of the sample's own area that goes to it (1 when no other patch has it); `voxels[i]` is its voxel.
    ///
    /// With `a = weight · s` of each member [T 5.2]: `A = Σ a`, position, normal and albedo `Σ a x / A` (the normal
    /// made a unit vector), and the weights become the shares `a / A`.
    ///
    /// # Errors
    /// As [`PatchSet::new`], and a weight that is not positive.
    pub fn from_groups(
        samples: Vec<Sample>,
        voxels: &[u32],
        offsets: Vec<u32>,
        mut members: Vec<Member>,
    ) -> Result<Self, Error> {
        check_samples(&samples)?;
        check_groups(&samples, &offsets, &members)?;
        if offsets.len() != voxels.len() + 1 {
            return Err(Error::Length { name: "voxels", expected: offsets.len() - 1, found: voxels.len() });
        }
        let patches = voxels
            .iter()
            .zip(offsets.windows(2))
            .map(|(&voxel, range)| mean_patch(&samples, &mut members[range[0] as usize..range[1] as usize], voxel))
            .collect();
        Self::new(samples, patches, offsets, members)
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.patches.len()
    }

    /// Returns true if there are no patches.
    pub fn is_empty(&self) -> bool {
        self.patches.is_empty()
    }

    /// Samples of patch `i` with their shares. Needs `i < len()`.
    pub fn members_of(&self, i: usize) -> &[Member] {
        &self.members[self.offsets[i] as usize..self.offsets[i + 1] as usize]
    }

    /// The samples as points at which direct light is measured, one each.
    pub fn surface_points(&self) -> Vec<SurfacePoint> {
        let point = |s: &Sample| SurfacePoint { position: s.position, patch: NONE, normal: s.normal, weight: 1.0 };
        self.samples.iter().map(point).collect()
    }

    /// Area-weighted mean of a quantity over each patch, `Σ w e`, from one value a sample: [`gather_mean`] on all
    /// cores.
    ///
    /// # Errors
    /// [`Error::Length`] for a wrong number of values.
    pub fn gather(&self, values: &[Vec4]) -> Result<Vec<Vec4>, Error> {
        if values.len() != self.samples.len() {
            return Err(Error::Length { name: "values", expected: self.samples.len(), found: values.len() });
        }
        let patches = 0..self.len() as u32;
        Ok(patches.into_par_iter().map(|i| gather_mean(i, &self.offsets, &self.members, values)).collect())
    }

    /// Bytes of all tables.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.samples[..])
            + size_of_val(&self.patches[..])
            + size_of_val(&self.offsets[..])
            + size_of_val(&self.members[..])
    }
}

/// The patch of one group; converts the members' weights to shares of its area.
fn mean_patch(samples: &[Sample], members: &mut [Member], voxel: u32) -> VirtualPatch {
    let mut area = 0.0;
    let mut position = DVec3::ZERO;
    let mut normal = DVec3::ZERO;
    let mut albedo = DVec3::ZERO;
    for member in members.iter() {
        let sample = &samples[member.sample as usize];
        let a = f64::from(member.weight) * f64::from(sample.area);
        area += a;
        position += sample.position.as_dvec3() * a;
        normal += sample.normal.as_dvec3() * a;
        albedo += sample.albedo.as_dvec3() * a;
    }
    for member in members.iter_mut() {
        let a = f64::from(member.weight) * f64::from(samples[member.sample as usize].area);
        member.weight = (a / area) as f32;
    }
    // Normals that cancel leave no mean: the greatest share decides.
    let largest = members.iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
    let fallback = largest.map_or(DVec3::Z, |m| samples[m.sample as usize].normal.as_dvec3());
    let length = normal.length();
    let normal = if length > 1e-6 * area { normal / length } else { fallback };
    VirtualPatch {
        position: (position / area).as_vec3(),
        area: area as f32,
        normal: normal.as_vec3(),
        voxel,
        albedo: (albedo / area).as_vec3(),
        reserved: 0,
    }
}

fn check_area(name: &'static str, index: usize, area: f32) -> Result<(), Error> {
    if area.is_finite() && area > 0.0 {
        return Ok(());
    }
    Err(Error::Value { name, index, value: f64::from(area), rule: "positive and finite" })
}

fn check_normal(name: &'static str, index: usize, normal: Vec3) -> Result<(), Error> {
    let length = normal.length();
    if (length - 1.0).abs() < 1e-3 {
        return Ok(());
    }
    Err(Error::Value { name, index, value: f64::from(length), rule: "1 long" })
}

/// Checks the invariants of every set of samples.
pub(super) fn check_samples(samples: &[Sample]) -> Result<(), Error> {
    if samples.len() >= u32::MAX as usize {
        return Err(Error::TooMany { name: "samples", found: samples.len() as u64, limit: u64::from(u32::MAX) - 1 });
    }
    for (index, sample) in samples.iter().enumerate() {
        check_area("samples.area", index, sample.area)?;
        check_normal("samples.normal", index, sample.normal)?;
        if !sample.position.is_finite() {
            let value = f64::from(sample.position.x + sample.position.y + sample.position.z);
            return Err(Error::Value { name: "samples.position", index, value, rule: "finite" });
        }
        if !(sample.albedo.min_element() >= 0.0 && sample.albedo.max_element() <= 1.0) {
            let value = f64::from(sample.albedo.max_element());
            return Err(Error::Value { name: "samples.albedo", index, value, rule: "in [0, 1]" });
        }
    }
    Ok(())
}

fn check_groups(samples: &[Sample], offsets: &[u32], members: &[Member]) -> Result<(), Error> {
    if offsets.is_empty() {
        return Err(Error::Length { name: "offsets", expected: 1, found: 0 });
    }
    for (index, pair) in offsets.windows(2).enumerate() {
        if pair[0] >= pair[1] {
            let rule = "above the one before: no patch is empty";
            return Err(Error::Value { name: "offsets", index: index + 1, value: f64::from(pair[1]), rule });
        }
    }
    if offsets[0] != 0 {
        return Err(Error::Value { name: "offsets", index: 0, value: f64::from(offsets[0]), rule: "0" });
    }
    let last = offsets[offsets.len() - 1] as usize;
    if last != members.len() {
        return Err(Error::Length { name: "members", expected: last, found: members.len() });
    }
    for (index, member) in members.iter().enumerate() {
        if member.sample as usize >= samples.len() {
            let rule = "below the number of samples";
            return Err(Error::Value { name: "members.sample", index, value: f64::from(member.sample), rule });
        }
        // Squared cosines of a sample sum to 1 but for rounding, and one patch may get them all.
        if !(member.weight > 0.0 && member.weight <= 1.001) {
            let value = f64::from(member.weight);
            return Err(Error::Value { name: "members.weight", index, value, rule: "in (0, 1]" });
        }
    }
    Ok(())
}
