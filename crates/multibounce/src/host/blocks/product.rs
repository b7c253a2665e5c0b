//! The product with a matrix in blocks, on all cores.

use std::vec;

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::{BlockCodec, BlockMatrix};
use crate::error::{Error, check_length};
use crate::kernel::blocks::{
    BLOCK, Bc1, Bc3, Bc6h, Bc7, BlockFormat, BlockSums, add_outliers, decode_gather_row,
};

impl BlockMatrix {
    /// `irradiance[i] = Σ_j m_ij exitance[j]`, W/m²; the same bits for any number of threads. The fourth component is 0.
    ///
    /// # Errors
    /// [`Error::Length`] unless both have one entry a row.
    pub fn product(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), Error> {
        check_length("exitance", self.len(), exitance.len())?;
        check_length("irradiance", self.len(), irradiance.len())?;
        let mut light = vec![Vec4::ZERO; self.block_count() * BLOCK as usize];
        for ((light, &j), scale) in light.iter_mut().zip(self.permutation.order()).zip(&self.column_scales) {
            *light = exitance[j as usize] * *scale;
        }
        let mut ordered = vec![Vec4::ZERO; light.len()];
        match self.settings.codec {
            BlockCodec::Bc1 => self.gather::<Bc1>(&light, &mut ordered),
            BlockCodec::Bc3 => self.gather::<Bc3>(&light, &mut ordered),
            BlockCodec::Bc6h => self.gather::<Bc6h>(&light, &mut ordered),
            BlockCodec::Bc7 => self.gather::<Bc7>(&light, &mut ordered),
        }
        for ((result, &place), scale) in irradiance.iter_mut().zip(self.permutation.place()).zip(&self.row_scales) {
            *result = ordered[place as usize] * *scale;
        }
        Ok(())
    }

    fn gather<F: BlockFormat>(&self, light: &[Vec4], ordered: &mut [Vec4]) {
        let p = self.params(0, self.block_count() as u32);
        ordered.par_chunks_mut(BLOCK as usize).enumerate().for_each(|(row, out)| {
            let words = |k: u32| self.block(k as usize);
            let sums = decode_gather_row::<F>(row as u32, &p, 0, 1, words, &self.scales, light);
            let (start, entries) = (&self.outliers.start, &self.outliers.entries);
            let sums: BlockSums = add_outliers(sums, row as u32, &p, 0, 1, start, entries, light);
            for (out, sum) in out.iter_mut().zip::<[Vec3; 4]>([sums.a, sums.b, sums.c, sums.d]) {
                *out = sum.extend(0.0);
            }
        });
    }
}
