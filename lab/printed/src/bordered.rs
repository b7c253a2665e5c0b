//! The matrix round a camera [T 4].

use std::collections::HashMap;

use glam::{Vec3, Vec4};
use localmatrix::{Entering, Error, MAX_SLOTS};
use rayon::prelude::*;

/// The matrix of several bounces between some patches, as printed [T 4]: to a few orders of what enters, and without
/// taking out what leaves. Rows receive, columns send; irradiance `H = T E` between the patches that are there.
///
/// With `f_r` the row of F of a patch that enters, `f_c` its column, c its colour and C those of the others, for each
/// channel:
///
/// ```text
/// double_reflection = f_r · (C∘f_c)
/// f_r' = f_r + f_r c double_reflection     f_c' = f_c + f_c c double_reflection
/// g_r = f_r' + (C∘f_r')ᵀ T                 g_c = f_c' + T (C∘f_c')
/// T ← T + (C∘g_c) g_rᵀ,                    new row g_r and column g_c
/// ```
///
/// The last line has the colours of the patches that receive where light passes the new one, whose colour it should be.
/// No corner is printed: it is 0.
#[derive(Clone, Debug)]
pub struct PrintedMatrix {
    /// The patch of each slot.
    contents: Vec<Option<u32>>,
    slots: HashMap<u32, u32>,
    /// Area of each slot, m².
    area: Vec<f32>,
    /// Colours of each channel and slot; 0 where it is free.
    albedo: [Vec<f32>; 3],
    /// T of red, green and blue, `[M · M]` each.
    planes: [Vec<f32>; 3],
    work: u64,
}

impl PrintedMatrix {
    /// So many slots, all free: 12 bytes for each pair of them.
    ///
    /// # Errors
    /// [`transport::Error::Setting`] for no slots or more than [`MAX_SLOTS`].
    pub fn new(slots: usize) -> Result<Self, Error> {
        if !(1..=MAX_SLOTS).contains(&slots) {
            return Err(transport::Error::Setting { name: "slots", value: slots as f64, rule: "1 to 32768" }.into());
        }
        Ok(Self {
            contents: vec![None; slots],
            slots: HashMap::new(),
            area: vec![1.0; slots],
            albedo: [0, 1, 2].map(|_| vec![0.0; slots]),
            planes: [0, 1, 2].map(|_| vec![0.0; slots * slots]),
            work: 0,
        })
    }

    /// Slot of a patch that is there.
    pub fn slot(&self, patch: u32) -> Option<u32> {
        self.slots.get(&patch).copied()
    }

    /// The entry of a channel between two slots.
    pub fn entry(&self, channel: usize, receiver: u32, sender: u32) -> f32 {
        self.planes[channel][receiver as usize * self.contents.len() + sender as usize]
    }

    /// Multiplications, all channels, that patches which entered took so far: for M slots that are in use, 9 M² each.
    pub fn work(&self) -> u64 {
        self.work
    }

    /// A patch enters; its column follows from its row, `A_i F_in = A_n F_ni`.
    ///
    /// # Errors
    /// [`Error::AlreadyThere`], [`Error::Full`].
    pub fn add(&mut self, entering: &Entering) -> Result<(), Error> {
        let Entering { patch, area, albedo, factors } = *entering;
        if self.slots.contains_key(&patch) {
            return Err(Error::AlreadyThere { patch });
        }
        let m = self.contents.len();
        let Some(new) = self.contents.iter().position(Option::is_none) else {
            return Err(Error::Full { needed: 1, free: 0, slots: m });
        };
        let mut row = vec![0.0f32; m];
        let mut column = vec![0.0f32; m];
        for &(other, factor) in factors {
            if let Some(&slot) = self.slots.get(&other) {
                row[slot as usize] += factor;
                column[slot as usize] += factor * area / self.area[slot as usize];
            }
        }
        let planes = self.planes.par_iter_mut().zip(&self.albedo).enumerate();
        planes.for_each(|(c, (plane, colours))| border(plane, colours, (&row, &column), albedo[c], new));
        self.contents[new] = Some(patch);
        self.slots.insert(patch, new as u32);
        self.area[new] = area;
        (0..3).for_each(|c| self.albedo[c][new] = albedo[c]);
        self.work += 9 * (self.slots.len() as u64).pow(2);
        Ok(())
    }

    /// A patch leaves: its row and column are forgotten and its slot is free; light that passed it stays.
    ///
    /// # Errors
    /// [`Error::NotThere`].
    pub fn remove(&mut self, patch: u32) -> Result<(), Error> {
        let slot = self.slots.remove(&patch).ok_or(Error::NotThere { patch })? as usize;
        let m = self.contents.len();
        self.contents[slot] = None;
        for (plane, colours) in self.planes.iter_mut().zip(&mut self.albedo) {
            colours[slot] = 0.0;
            for k in 0..m {
                (plane[slot * m + k], plane[k * m + slot]) = (0.0, 0.0);
            }
        }
        Ok(())
    }

    /// Irradiance at visible slots from the exitance of lit ones, W/m²: the part of the matrix with the rows P_Vis and
    /// the columns P_Lit. Other elements of `irradiance` stay as they are. Work: 3 |P_Vis| |P_Lit| multiplications.
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
        let slots = self.contents.len();
        for (name, found) in [("exitance", exitance.len()), ("irradiance", irradiance.len())] {
            if found != slots {
                return Err(transport::Error::Length { name, expected: slots, found }.into());
            }
        }
        if let Some(&slot) = visible.iter().chain(lit).find(|&&slot| slot as usize >= slots) {
            return Err(Error::NoSlot { slot, slots });
        }
        let one = |&receiver: &u32| {
            let entry = |c: usize, sender: u32| self.entry(c, receiver, sender) * exitance[sender as usize][c];
            let sum = |c: usize| lit.iter().map(|&sender| entry(c, sender)).sum::<f32>();
            Vec3::new(sum(0), sum(1), sum(2)).extend(0.0)
        };
        let found: Vec<Vec4> = visible.par_iter().with_min_len(16).map(one).collect();
        visible.iter().zip(found).for_each(|(&slot, h)| irradiance[slot as usize] = h);
        Ok(())
    }
}

/// Borders the plane of a channel with the row and column of a patch of colour c, in the slot `new`.
fn border(plane: &mut [f32], colours: &[f32], (row, column): (&[f32], &[f32]), c: f32, new: usize) {
    let m = colours.len();
    let double_reflection: f32 = (0..m).map(|i| row[i] * column[i] * colours[i]).sum();
    let with_reflection = |f: &[f32]| f.iter().map(|f| f + f * c * double_reflection).collect::<Vec<f32>>();
    let row = with_reflection(row);
    let column = with_reflection(column);
    let mut g_row = row.clone();
    let mut g_column = column.clone();
    for (i, line) in plane.chunks(m).enumerate() {
        let part = colours[i] * row[i];
        g_row.iter_mut().zip(line).for_each(|(g, f)| *g += part * f);
        g_column[i] += (0..m).map(|j| line[j] * (colours[j] * column[j])).sum::<f32>();
    }
    for (i, line) in plane.chunks_mut(m).enumerate() {
        let part = colours[i] * g_column[i];
        line.iter_mut().zip(&g_row).for_each(|(f, g)| *f += part * g);
        line[new] = g_column[i];
    }
    plane[new * m..(new + 1) * m].copy_from_slice(&g_row);
}
