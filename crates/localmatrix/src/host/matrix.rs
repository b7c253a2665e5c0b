//! The slots and their matrix.

use alloc::vec::Vec;

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Side, get_global_parallelism};
use glam::{Vec3, Vec4};
use hashbrown::HashMap;
use scene::parallel::*;
use transport::LinearOperator;

use crate::error::Error;
use crate::kernel::gather;

/// Most slots: three times their square is counted in 32 bits.
pub const MAX_SLOTS: usize = 32_768;

/// A patch that enters.
#[derive(Clone, Copy, Debug)]
pub struct Entering<'a> {
    /// Its number.
    pub patch: u32,
    /// Its area, m², by which the form factors are reciprocal.
    pub area: f32,
    /// Its reflectance, at least 0 and below 1.
    pub albedo: Vec3,
    /// Its row of F: other patches, or itself, and the share of its light that arrives there. Those that are not in the
    /// matrix are passed over; among patches that enter together either row will do, or both.
    pub factors: &'a [(u32, f32)],
}

/// Content of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Slot {
    Free,
    Active(u32),
    /// A patch that left, and when.
    Ghost(u32, u64),
}

/// A change of the matrix, for a copy of it elsewhere: `T̂ ← T̂ + sign · Σ_k r_k r_kᵀ`, then some slots get new rows
/// and columns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Update {
    /// 1 or −1.
    pub sign: f32,
    /// Number of vectors r.
    pub rank: u32,
    /// The vectors of red, of green and of blue, `[3 · rank · M]`.
    pub vectors: Vec<f32>,
    /// Slots whose rows and columns are new.
    pub slots: Vec<u32>,
    /// Their columns, `[3 · slots · M]`.
    pub columns: Vec<f32>,
}

/// The operator of all bounces between some patches, see the [crate's documentation](crate).
#[derive(Clone, Debug)]
pub struct LocalMatrix {
    contents: Vec<Slot>,
    slots: HashMap<u32, u32>,
    /// `√a` of each slot, m; 1 where it is free.
    sqrt_area: Vec<f32>,
    /// ρ of each channel and slot; 0 where it is free.
    albedo: [Vec<f32>; 3],
    /// `F̂ = a^½ F a^-½` between the slots, `[M · M]`.
    factors: Vec<f32>,
    /// `T̂` of red, green and blue, `[3 · M · M]`.
    state: Vec<f32>,
    /// Slots up to the last that was ever used.
    used: usize,
    leavings: u64,
    /// The next column to be refreshed.
    next: usize,
    work: u64,
    record: Option<Vec<Update>>,
}

/// `H = T E` between the patches that are in the matrix, by slots; what other slots have is not looked at, and they get
/// 0.
impl LinearOperator for LocalMatrix {
    fn shape(&self) -> (usize, usize) {
        (self.slots(), self.slots())
    }

    fn bytes(&self) -> u64 {
        (size_of_val(&self.state[..]) + size_of_val(&self.factors[..])) as u64
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), transport::Error> {
        self.check_vectors(exitance, irradiance)?;
        let slots: Vec<u32> = self.patches().map(|(slot, _)| slot).collect();
        irradiance.fill(Vec4::ZERO);
        self.multiply(&slots, &slots, exitance, irradiance);
        Ok(())
    }
}

impl LocalMatrix {
    /// So many slots, all free: 16 bytes for each pair of them.
    ///
    /// # Errors
    /// [`transport::Error::Setting`] for no slots or more than [`MAX_SLOTS`].
    pub fn new(slots: usize) -> Result<Self, Error> {
        if !(1..=MAX_SLOTS).contains(&slots) {
            return Err(transport::Error::Setting { name: "slots", value: slots as f64, rule: "1 to 32768" }.into());
        }
        Ok(Self {
            contents: vec![Slot::Free; slots],
            slots: HashMap::new(),
            sqrt_area: vec![1.0; slots],
            albedo: [0, 1, 2].map(|_| vec![0.0; slots]),
            factors: vec![0.0; slots * slots],
            state: vec![0.0; 3 * slots * slots],
            used: 0,
            leavings: 0,
            next: 0,
            work: 0,
            record: None,
        })
    }

    /// Slots, used or not.
    pub fn slots(&self) -> usize {
        self.contents.len()
    }

    /// Slot of a patch that is there and no ghost.
    pub fn slot(&self, patch: u32) -> Option<u32> {
        let slot = *self.slots.get(&patch)?;
        (self.contents[slot as usize] == Slot::Active(patch)).then_some(slot)
    }

    /// Returns true if a patch left, but still passes light on.
    pub fn has_ghost(&self, patch: u32) -> bool {
        self.slots.contains_key(&patch) && self.slot(patch).is_none()
    }

    /// Each slot in use and the patch in it, ghosts not counted.
    pub fn patches(&self) -> impl Iterator<Item = (u32, u32)> {
        self.contents.iter().zip(0..).filter_map(|(content, slot)| match content {
            Slot::Active(patch) => Some((slot, *patch)),
            _ => None,
        })
    }

    /// Patches that left and whose slots are not yet needed.
    pub fn ghosts(&self) -> usize {
        self.contents.iter().filter(|content| matches!(content, Slot::Ghost(..))).count()
    }

    /// Multiplications, all channels, that changes of the matrix took so far.
    pub fn work(&self) -> u64 {
        self.work
    }

    /// `T̂` of red, green and blue, `[3 · M · M]`, symmetric; rows and columns of free slots are 0.
    pub fn state(&self) -> &[f32] {
        &self.state
    }

    /// `√a` of each slot, m; 1 where it is free.
    pub fn sqrt_area(&self) -> &[f32] {
        &self.sqrt_area
    }

    /// From now on changes are kept, for [`Self::take_updates`].
    pub fn record(&mut self) {
        self.record.get_or_insert_with(Vec::new);
    }

    /// Takes the changes since the last call; empty unless recorded.
    pub fn take_updates(&mut self) -> Vec<Update> {
        self.record.as_mut().map(core::mem::take).unwrap_or_default()
    }

    /// Keeps a change: vectors by channel and place, and slots whose columns are as the matrix has them now.
    fn keep(&mut self, sign: f32, rank: usize, vectors: &[Mat<f32>], slots: &[usize]) {
        let m = self.slots();
        let state = &self.state;
        let Some(record) = &mut self.record else { return };
        let mut update = Update { sign, rank: rank as u32, ..Update::default() };
        update.vectors = vec![0.0; 3 * rank * m];
        for (channel, rows) in update.vectors.chunks_mut((rank * m).max(1)).zip(vectors) {
            for (k, row) in channel.chunks_mut(m).enumerate() {
                row.iter_mut().take(rows.ncols()).enumerate().for_each(|(i, x)| *x = rows[(k, i)]);
            }
        }
        update.slots = slots.iter().map(|&slot| slot as u32).collect();
        let column = |c: usize, slot: usize| &state[(c * m + slot) * m..(c * m + slot + 1) * m];
        update.columns = (0..3).flat_map(|c| slots.iter().flat_map(move |&slot| column(c, slot))).copied().collect();
        record.push(update);
    }

    /// Lets patches enter, as one border. Those that are ghosts with the same area and reflectance come back without
    /// any work; ghosts that left longest ago give up their slots where none is free.
    ///
    /// # Errors
    /// [`Error::Value`], [`Error::AlreadyThere`], [`Error::Full`], [`Error::Singular`].
    pub fn add(&mut self, entering: &[Entering]) -> Result<(), Error> {
        self.check(entering)?;
        // Ghosts first: they may hold slots that are needed.
        let (mut new, mut changed, mut back) = (Vec::new(), Vec::new(), Vec::new());
        for one in entering {
            match self.slots.get(&one.patch).map(|&slot| slot as usize) {
                Some(slot) if self.is_like(slot, one) => back.push((slot, one.patch)),
                Some(slot) => {
                    changed.push(slot);
                    new.push(one);
                }
                None => new.push(one),
            }
        }
        let free = self.contents.iter().filter(|content| **content == Slot::Free).count();
        let available = free + self.ghosts() - back.len();
        if new.len() > available {
            return Err(Error::Full { needed: new.len(), free: available, slots: self.slots() });
        }
        // Nothing has changed yet: what fails from here on is tried on what it changes.
        let kept: Vec<Slot> = back.iter().map(|&(slot, _)| self.contents[slot]).collect();
        back.iter().for_each(|&(slot, patch)| self.contents[slot] = Slot::Active(patch));
        let missing = new.len().saturating_sub(free + changed.len());
        let mut ghosts: Vec<(u64, usize)> = (0..self.slots())
            .filter(|slot| !changed.contains(slot))
            .filter_map(|slot| match self.contents[slot] {
                Slot::Ghost(_, since) => Some((since, slot)),
                _ => None,
            })
            .collect();
        ghosts.sort_unstable();
        changed.extend(ghosts.iter().take(missing).map(|&(_, slot)| slot));
        self.take_away(&changed)?;
        let border = self.border(&new);
        border.inspect_err(|_| back.iter().zip(kept).for_each(|(&(slot, _), content)| self.contents[slot] = content))
    }

    /// Lets patches leave: each becomes a ghost, by way of which light still goes, until it comes back or its slot is
    /// needed.
    ///
    /// # Errors
    /// [`Error::NotThere`].
    pub fn leave(&mut self, patches: &[u32]) -> Result<(), Error> {
        if let Some(&patch) = patches.iter().find(|&&patch| self.slot(patch).is_none()) {
            return Err(Error::NotThere { patch });
        }
        for &patch in patches {
            self.contents[self.slots[&patch] as usize] = Slot::Ghost(patch, self.leavings);
            self.leavings += 1;
        }
        Ok(())
    }

    /// Takes patches out, ghosts or not: T is then that of the others.
    ///
    /// # Errors
    /// [`Error::NotThere`].
    pub fn remove(&mut self, patches: &[u32]) -> Result<(), Error> {
        let slot = |&patch: &u32| self.slots.get(&patch).map(|&slot| slot as usize).ok_or(Error::NotThere { patch });
        let mut slots = patches.iter().map(slot).collect::<Result<Vec<usize>, Error>>()?;
        slots.sort_unstable();
        slots.dedup();
        self.take_away(&slots)
    }

    /// Irradiance at some slots from the exitance of some, W/m²; other elements of `irradiance` stay as they are.
    ///
    /// Work in proportion to both numbers: leave out slots that are not seen, and those that are not lit.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless both have one element a slot, [`Error::NoSlot`].
    pub fn product(
        &self,
        visible: &[u32],
        lit: &[u32],
        exitance: &[Vec4],
        irradiance: &mut [Vec4],
    ) -> Result<(), Error> {
        self.check_vectors(exitance, irradiance)?;
        let slots = self.slots();
        if let Some(&slot) = visible.iter().chain(lit).find(|&&slot| slot as usize >= slots) {
            return Err(Error::NoSlot { slot, slots });
        }
        self.multiply(visible, lit, exitance, irradiance);
        Ok(())
    }

    /// [`Self::product`] of slots that are there.
    fn multiply(&self, visible: &[u32], lit: &[u32], exitance: &[Vec4], irradiance: &mut [Vec4]) {
        let slots = self.slots();
        let [red, green, blue] = [0, 1, 2].map(|c| &self.state[c * slots * slots..(c + 1) * slots * slots]);
        let count = lit.len() as u32;
        let one = |&slot: &u32| gather(slot, slots as u32, count, lit, red, green, blue, &self.sqrt_area, exitance);
        let gathered: Vec<Vec4> = visible.par_iter().with_min_len(16).map(one).collect();
        visible.iter().zip(gathered).for_each(|(&slot, value)| irradiance[slot as usize] = value);
    }

    /// Takes the error of rounding out of the next so many columns and their rows, by a step of Newton and Schulz,
    /// `D = F̂ + F̂ P T̂ − T̂`, `T̂ ← T̂ + D + T̂ P D`; how great it was, relative to the columns, the worst of the
    /// channels. As many columns as patches enter cost about twice as much as their border.
    pub fn refresh(&mut self, columns: usize) -> f32 {
        let n = self.used;
        let slots = self.slots();
        let count = columns.min(n);
        let which: Vec<usize> = (0..count).map(|k| (self.next + k) % n).collect();
        self.next = if n > 0 { (self.next + count) % n } else { 0 };
        let parallel = get_global_parallelism();
        let mut worst = 0.0f32;
        for c in 0..3 {
            let rho = &self.albedo[c];
            let factors = MatRef::from_column_major_slice(&self.factors, slots, slots).submatrix(0, 0, n, n);
            let plane = &mut self.state[c * slots * slots..(c + 1) * slots * slots];
            let mut state = MatMut::from_column_major_slice_mut(plane, slots, slots).submatrix_mut(0, 0, n, n);
            let now = Mat::from_fn(n, count, |i, k| state[(i, which[k])]);
            let mut rest = Mat::from_fn(n, count, |i, k| factors[(i, which[k])] - now[(i, k)]);
            let lit = Mat::from_fn(n, count, |i, k| rho[i] * now[(i, k)]);
            matmul(rest.as_mut(), Accum::Add, factors, lit.as_ref(), 1.0, parallel);
            let lit = Mat::from_fn(n, count, |i, k| rho[i] * rest[(i, k)]);
            let mut better = &now + &rest;
            matmul(better.as_mut(), Accum::Add, state.as_ref(), lit.as_ref(), 1.0, parallel);
            let length = now.norm_l2();
            worst = worst.max(if length > 0.0 { rest.norm_l2() / length } else { 0.0 });
            for (k, &j) in which.iter().enumerate() {
                for i in 0..n {
                    (state[(i, j)], state[(j, i)]) = (better[(i, k)], better[(i, k)]);
                }
            }
        }
        self.keep(1.0, 0, &[], &which);
        self.work += 6 * (n * n * count) as u64;
        worst
    }

    fn check(&self, entering: &[Entering]) -> Result<(), Error> {
        let mut seen: Vec<u32> = entering.iter().map(|one| one.patch).collect();
        seen.sort_unstable();
        if let Some(twice) = seen.windows(2).find(|two| two[0] == two[1]) {
            return Err(Error::AlreadyThere { patch: twice[0] });
        }
        for one in entering {
            let patch = one.patch;
            if self.slot(patch).is_some() {
                return Err(Error::AlreadyThere { patch });
            }
            if !(one.area.is_finite() && one.area > 0.0) {
                return Err(Error::Value { name: "area", patch, value: one.area, rule: "positive" });
            }
            if let Some(&value) = one.albedo.as_ref().iter().find(|rho| !(0.0..1.0).contains(*rho)) {
                return Err(Error::Value { name: "albedo", patch, value, rule: "at least 0 and below 1" });
            }
            if let Some(&(_, value)) = one.factors.iter().find(|(_, f)| !(f.is_finite() && *f >= 0.0)) {
                return Err(Error::Value { name: "form factor", patch, value, rule: "finite and not negative" });
            }
        }
        Ok(())
    }

    /// Returns true if a slot holds the ghost of this very patch.
    fn is_like(&self, slot: usize, one: &Entering) -> bool {
        let albedo = Vec3::from_array([0, 1, 2].map(|c| self.albedo[c][slot]));
        self.sqrt_area[slot] == scene::math::sqrt(one.area) && albedo == one.albedo
    }

    /// F̂ of new patches with the patches that are there, `[n, k]`, and among the new ones, `[k, k]`.
    fn symmetric_factors(&self, new: &[&Entering], sqrt_area: &[f32], n: usize) -> (Mat<f32>, Mat<f32>) {
        let k = new.len();
        let own: HashMap<u32, usize> = new.iter().zip(0..).map(|(one, column)| (one.patch, column)).collect();
        let mut outer = Mat::<f32>::zeros(n, k);
        let mut inner = Mat::<f32>::zeros(k, k);
        let mut estimates = Mat::<f32>::zeros(k, k);
        for (column, one) in new.iter().enumerate() {
            for &(patch, factor) in one.factors {
                if let Some(&other) = own.get(&patch) {
                    inner[(column, other)] += factor * sqrt_area[column] / sqrt_area[other];
                    estimates[(column, other)] = 1.0;
                } else if let Some(&slot) = self.slots.get(&patch) {
                    outer[(slot as usize, column)] += factor * sqrt_area[column] / self.sqrt_area[slot as usize];
                }
            }
        }
        // The mean of both row estimates where there are two.
        let inner = Mat::from_fn(k, k, |a, b| {
            (inner[(a, b)] + inner[(b, a)]) / (estimates[(a, b)] + estimates[(b, a)]).max(1.0)
        });
        (outer, inner)
    }

    /// Borders the matrix with new patches, for which there are free slots.
    fn border(&mut self, new: &[&Entering]) -> Result<(), Error> {
        let k = new.len();
        let slots = self.slots();
        if k == 0 {
            return Ok(());
        }
        let free: Vec<usize> = (0..slots).filter(|&slot| self.contents[slot] == Slot::Free).take(k).collect();
        let n = self.used.max(free[k - 1] + 1);
        let sqrt_area: Vec<f32> = new.iter().map(|one| scene::math::sqrt(one.area)).collect();
        let (outer, inner) = self.symmetric_factors(new, &sqrt_area, n);
        let parallel = get_global_parallelism();
        // All channels before any is changed.
        let mut made = Vec::new();
        for c in 0..3 {
            let rho: Vec<f32> = new.iter().map(|one| scene::math::sqrt(one.albedo[c])).collect();
            let plane = &self.state[c * slots * slots..(c + 1) * slots * slots];
            let state = MatRef::from_column_major_slice(plane, slots, slots).submatrix(0, 0, n, n);
            let lit = Mat::from_fn(n, k, |i, j| self.albedo[c][i] * outer[(i, j)]);
            let mut wide = outer.clone();
            matmul(wide.as_mut(), Accum::Add, state, lit.as_ref(), 1.0, parallel);
            let mut corner = inner.clone();
            matmul(corner.as_mut(), Accum::Add, lit.transpose(), wide.as_ref(), 1.0, parallel);
            let corner = Mat::from_fn(k, k, |a, b| 0.5 * (corner[(a, b)] + corner[(b, a)]));
            // Rows of W P½, and P½ Σ, by L⁻¹ with L Lᵀ = I − P½ Σ P½.
            let mut rows = Mat::from_fn(k, n, |j, i| rho[j] * wide[(i, j)]);
            let mut right = Mat::from_fn(k, k, |a, b| rho[a] * corner[(a, b)]);
            let identity = |a, b| if a == b { 1.0 } else { 0.0 };
            let system = Mat::from_fn(k, k, |a, b| identity(a, b) - rho[a] * corner[(a, b)] * rho[b]);
            let factor = system.llt(Side::Lower).map_err(|error| {
                let faer::linalg::cholesky::llt::factor::LltError::NonPositivePivot { index } = error;
                Error::Singular { patch: new[index].patch }
            })?;
            solve_lower_triangular_in_place(factor.L(), rows.as_mut(), parallel);
            solve_lower_triangular_in_place(factor.L(), right.as_mut(), parallel);
            made.push((rows, right, wide, corner));
        }
        let mut vectors = Vec::new();
        for (c, (rows, right, mut wide, mut corner)) in made.into_iter().enumerate() {
            let plane = &mut self.state[c * slots * slots..(c + 1) * slots * slots];
            let mut state = MatMut::from_column_major_slice_mut(plane, slots, slots).submatrix_mut(0, 0, n, n);
            matmul(state.as_mut(), Accum::Add, rows.transpose(), rows.as_ref(), 1.0, parallel);
            matmul(wide.as_mut(), Accum::Add, rows.transpose(), right.as_ref(), 1.0, parallel);
            matmul(corner.as_mut(), Accum::Add, right.transpose(), right.as_ref(), 1.0, parallel);
            write_border(state, &free, &wide, &corner);
            if self.record.is_some() {
                vectors.push(rows);
            }
        }
        self.keep(1.0, k, &vectors, &free);
        let factors = MatMut::from_column_major_slice_mut(&mut self.factors, slots, slots);
        write_border(factors, &free, &outer, &inner);
        self.occupy(new, &free, &sqrt_area);
        self.used = n;
        self.work += 6 * (n * n * k) as u64;
        Ok(())
    }

    /// Notes the new patches of slots that were free.
    fn occupy(&mut self, new: &[&Entering], free: &[usize], sqrt_area: &[f32]) {
        for ((one, &slot), &sqrt_area) in new.iter().zip(free).zip(sqrt_area) {
            self.contents[slot] = Slot::Active(one.patch);
            self.slots.insert(one.patch, slot as u32);
            self.sqrt_area[slot] = sqrt_area;
            (0..3).for_each(|c| self.albedo[c][slot] = one.albedo[c]);
        }
    }

    /// Takes what is in these slots out of the matrix; `T̂ ← T̂ − Y Yᵀ` with `Y = T̂_K P½ L⁻ᵀ` and `L Lᵀ = I + P½ T̂_KK
    /// P½`.
    fn take_away(&mut self, which: &[usize]) -> Result<(), Error> {
        let k = which.len();
        let n = self.used;
        let slots = self.slots();
        if k == 0 {
            return Ok(());
        }
        let parallel = get_global_parallelism();
        let mut vectors = Vec::new();
        for c in 0..3 {
            let rho: Vec<f32> = which.iter().map(|&slot| scene::math::sqrt(self.albedo[c][slot])).collect();
            let plane = &mut self.state[c * slots * slots..(c + 1) * slots * slots];
            let mut state = MatMut::from_column_major_slice_mut(plane, slots, slots).submatrix_mut(0, 0, n, n);
            let identity = |a, b| if a == b { 1.0 } else { 0.0 };
            let system = Mat::from_fn(k, k, |a, b| identity(a, b) + rho[a] * state[(which[a], which[b])] * rho[b]);
            let Ok(factor) = system.llt(Side::Lower) else { return Err(self.no_inverse(which[0])) };
            let mut rows = Mat::from_fn(k, n, |j, i| rho[j] * state[(i, which[j])]);
            solve_lower_triangular_in_place(factor.L(), rows.as_mut(), parallel);
            matmul(state.as_mut(), Accum::Add, rows.transpose(), rows.as_ref(), -1.0, parallel);
            if self.record.is_some() {
                vectors.push(rows);
            }
            for &slot in which {
                for i in 0..n {
                    (state[(i, slot)], state[(slot, i)]) = (0.0, 0.0);
                }
            }
        }
        self.keep(-1.0, k, &vectors, which);
        let mut factors = MatMut::from_column_major_slice_mut(&mut self.factors, slots, slots);
        for &slot in which {
            for i in 0..n {
                (factors[(i, slot)], factors[(slot, i)]) = (0.0, 0.0);
            }
            if let Slot::Active(patch) | Slot::Ghost(patch, _) = self.contents[slot] {
                self.slots.remove(&patch);
            }
            self.contents[slot] = Slot::Free;
            self.sqrt_area[slot] = 1.0;
            (0..3).for_each(|c| self.albedo[c][slot] = 0.0);
        }
        self.work += 3 * (n * n * k) as u64;
        Ok(())
    }

    fn no_inverse(&self, slot: usize) -> Error {
        match self.contents[slot] {
            Slot::Active(patch) | Slot::Ghost(patch, _) => Error::Singular { patch },
            Slot::Free => Error::NoSlot { slot: slot as u32, slots: self.slots() },
        }
    }
}

/// Writes the columns and rows of slots into a symmetric matrix: `outer` with all slots, `inner` among these.
fn write_border(mut matrix: MatMut<f32>, slots: &[usize], outer: &Mat<f32>, inner: &Mat<f32>) {
    for (j, &slot) in slots.iter().enumerate() {
        for i in 0..outer.nrows() {
            (matrix[(i, slot)], matrix[(slot, i)]) = (outer[(i, j)], outer[(i, j)]);
        }
    }
    for (a, &row) in slots.iter().enumerate() {
        for (b, &column) in slots.iter().enumerate() {
            matrix[(row, column)] = inner[(a, b)];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// n patches of 1 m² that all send each other f, of reflectance ρ: T = f / (1 − n ρ f) between any two.
    #[test]
    fn refreshing_takes_errors_out() {
        let n = 24usize;
        let f = 0.04f32;
        let rho = 0.7f32;
        let factors: Vec<(u32, f32)> = (0..n as u32).map(|j| (j, f)).collect();
        let one = |patch| Entering { patch, area: 1.0, albedo: Vec3::splat(rho), factors: &factors };
        let mut matrix = LocalMatrix::new(n).unwrap();
        matrix.add(&(0..n as u32).map(one).collect::<Vec<_>>()).unwrap();
        let expected = f / (1.0 - n as f32 * rho * f);
        let error = |matrix: &LocalMatrix| matrix.state.iter().map(|x| (x / expected - 1.0).abs()).fold(0.0, f32::max);
        assert!(error(&matrix) < 1e-5, "{}", error(&matrix));
        for i in 0..n {
            for j in 0..=i {
                let wrong = 1.0 + 0.05 * ((i * 7 + j * 3) % 11) as f32 / 11.0;
                for (a, b) in [(i, j), (j, i)].into_iter().take(if i == j { 1 } else { 2 }) {
                    (0..3).for_each(|c| matrix.state[c * n * n + a * n + b] *= wrong);
                }
            }
        }
        assert!(error(&matrix) > 0.01);
        let found: Vec<f32> = (0..6).map(|_| matrix.refresh(n)).collect();
        assert!(error(&matrix) < 1e-5 && found[0] > 1e-3 && found[5] < 1e-5, "{} {found:?}", error(&matrix));
    }
}
