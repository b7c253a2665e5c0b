//! Form factors between patches in symmetric form, `F̂ = a^½ F a^-½`, and their operators of several bounces.

use faer::Mat;
use formfactor::{Reciprocal, reciprocal};
use glam::{Vec3, Vec4};
use multibounce::{
    Channels, Factors, StoredOperator, Workspace, all_bounces, all_bounces_stored, halving_order, some_bounces,
    some_bounces_stored,
};
use patches::PatchMesh;
use transport::{Csr, LinearOperator, Observer, Phase};

use super::build::Build;
use crate::error::{Error, Reason};
use crate::observe::run_phase;

/// Form factors between patches in symmetric form.
pub struct SymmetricFactors {
    /// Reciprocal form factors, `a_i F_ij = a_j F_ji`.
    pub factors: Csr,
    /// Areas for which they are reciprocal, m².
    pub area: Vec<f32>,
    /// Order in which neighbours are similar.
    pub order: Vec<u32>,
}

/// The mean visible point of each patch, m, weighted by the share of light that comes from there: `Σ_j F_ij (p_j, 1)`.
///
/// # Errors
/// Another number of positions than columns.
pub fn mean_visible_points(factors: &impl LinearOperator, positions: &[Vec3]) -> Result<Vec<Vec4>, Error> {
    let mut sums = vec![Vec4::ZERO; factors.rows()];
    let mut shares = sums.clone();
    factors.apply(&positions.iter().map(|p| p.extend(0.0)).collect::<Vec<_>>(), &mut sums)?;
    factors.apply(&vec![Vec4::ONE; positions.len()], &mut shares)?;
    Ok(sums.iter().zip(&shares).map(|(sum, share)| sum.truncate().extend(share.x)).collect())
}

impl SymmetricFactors {
    /// Makes form factors reciprocal, and finds the order.
    ///
    /// # Errors
    /// Form factors that are not those of the mesh.
    pub fn new(mesh: &PatchMesh, factors: &Csr) -> Result<Self, Error> {
        let Reciprocal { factors, area, .. } = reciprocal(factors, &mesh.areas())?;
        let positions: Vec<Vec3> = mesh.patches.iter().map(|p| p.centroid).collect();
        let normals: Vec<Vec3> = mesh.patches.iter().map(|p| p.normal).collect();
        let order = halving_order(&positions, &normals, &mean_visible_points(&factors, &positions)?);
        Ok(Self { factors, area, order })
    }

    /// The form factors, which compressing them alone needs no dense matrix for.
    pub fn channels(&self) -> Channels<'_> {
        Channels::Factors(self.view())
    }

    /// The form factors as `multibounce` takes them.
    pub(crate) fn view(&self) -> Factors<'_> {
        let Csr { row_start, column_index, values, .. } = &self.factors;
        Factors { row_start, columns: column_index, values, area: &self.area }
    }

    /// `a^½ F a^-½`.
    ///
    /// # Errors
    /// Form factors that are not reciprocal.
    pub fn symmetric(&self) -> Result<Mat<f32>, Error> {
        Ok(self.view().symmetric()?)
    }

    /// Rows of `a^-½ T̂ a^½`, as codecs read them. Rounding leaves no entry below 0.
    pub fn rows<'a>(&'a self, channels: Channels<'a>) -> impl Fn(usize, &mut [Vec3]) + Sync + 'a {
        let sqrt_area: Vec<f32> = self.area.iter().map(|&a| scene::math::sqrt(a)).collect();
        move |i, row| match channels {
            Channels::One(all) => fill_row([all; 3], &sqrt_area, i, row),
            Channels::Three(each) => fill_row(each, &sqrt_area, i, row),
            Channels::Stored(each) => fill_stored_row(each, &sqrt_area, i, row),
            Channels::Factors(factors) => {
                row.fill(Vec3::ZERO);
                factors.row(i).for_each(|(j, f)| row[j] += Vec3::splat(f));
            }
        }
    }

    /// The symmetric operators of so many bounces, or of all, for red, green and blue, on the host: 4 N² numbers at the
    /// peak for all, [`super::build::MATRICES`] N² for some.
    ///
    /// # Errors
    /// Light that would grow for ever; cancellation.
    pub fn bounces(
        &self,
        albedo: &[Vec4],
        bounces: Option<u32>,
        observer: &dyn Observer,
    ) -> Result<[Mat<f32>; 3], Error> {
        run_phase(observer, Phase::OPERATOR, |report| {
            let one = |channel: usize| {
                let albedo: Vec<f32> = albedo.iter().map(|rho| rho[channel]).collect();
                let made = match bounces {
                    None => all_bounces(self.symmetric()?, &albedo)?,
                    Some(bounces) => some_bounces(&self.symmetric()?, &albedo, bounces, &|_, _| report(channel, 3))?,
                };
                if report(channel + 1, 3).is_continue() { Ok(made) } else { Err(Error::cancelled()) }
            };
            Ok([one(0)?, one(1)?, one(2)?])
        })
    }

    /// Builds in files, of which panels of so many bytes are held at a time.
    ///
    /// # Errors
    /// Too few bytes for one panel, a folder that cannot be written to, cancellation.
    pub fn stored(
        &self,
        albedo: &[Vec4],
        bounces: Option<u32>,
        build: &Build,
        bytes: u64,
        observer: &dyn Observer,
    ) -> Result<[StoredOperator; 3], Error> {
        let workspace = Workspace { folder: &build.folder, bytes };
        let made = run_phase(observer, Phase::OPERATOR, |report| {
            let one = |channel: usize| {
                let albedo: Vec<f32> = albedo.iter().map(|rho| rho[channel]).collect();
                let proceed = |done, total| report(channel * total + done, 3 * total);
                match bounces {
                    None => all_bounces_stored(&self.view(), &albedo, &self.order, &workspace, &proceed),
                    Some(bounces) => {
                        some_bounces_stored(&self.view(), &albedo, bounces, &self.order, &workspace, &proceed)
                    }
                }
            };
            Ok([one(0)?, one(1)?, one(2)?])
        });
        made.map_err(|error| match error {
            multibounce::Error::Memory { needed, limit } => {
                Reason::OperatorPanels { patches: albedo.len(), needed, left: limit }.into()
            }
            other => other.into(),
        })
    }
}

/// A row of dense symmetric operators.
fn fill_row([r, g, b]: [&Mat<f32>; 3], sqrt_area: &[f32], i: usize, row: &mut [Vec3]) {
    // Symmetric: a column, which lies together in memory, is the row.
    for (j, color) in row.iter_mut().enumerate() {
        let entry = Vec3::new(r[(j, i)], g[(j, i)], b[(j, i)]);
        *color = (entry * (sqrt_area[j] / sqrt_area[i])).max(Vec3::ZERO);
    }
}

/// A row of operators in files; zeros where one cannot be read.
fn fill_stored_row(each: [&StoredOperator; 3], sqrt_area: &[f32], i: usize, row: &mut [Vec3]) {
    let mut channels = [0, 1, 2].map(|_| vec![0.0; row.len()]);
    let is_read = each.iter().zip(&mut channels).all(|(stored, row)| stored.row(i, row).is_ok());
    for (j, color) in row.iter_mut().enumerate() {
        let entry = Vec3::from_array([0, 1, 2].map(|c| channels[c][j])) * (sqrt_area[j] / sqrt_area[i]);
        *color = if is_read { entry.max(Vec3::ZERO) } else { Vec3::ZERO };
    }
}
