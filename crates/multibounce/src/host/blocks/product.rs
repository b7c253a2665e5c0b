//! The product with a matrix in blocks, on all cores.

use alloc::vec;

use glam::{Vec3, Vec4};
use pulp::{Arch, Simd, WithSimd};
use scene::parallel::*;
use transport::LinearOperator;

use super::planes::PlaneFormat;
use super::{BlockCodec, BlockMatrix, Companding};
use crate::kernel::blocks::{BLOCK, Bc1, Bc3, Bc6h, Bc7, exp2, gather_outliers};

/// Entries along the edge of a block.
const EDGE: usize = BLOCK as usize;

/// Texels of a block.
const TEXELS: usize = EDGE * EDGE;

/// Irradiance `H = M B`, W/m². The fourth component is 0.
impl LinearOperator for BlockMatrix {
    fn shape(&self) -> (usize, usize) {
        (self.len(), self.len())
    }

    fn bytes(&self) -> u64 {
        self.bytes_by_part().total()
    }

    fn apply(&self, exitance: &[Vec4], irradiance: &mut [Vec4]) -> Result<(), transport::Error> {
        self.check_vectors(exitance, irradiance)?;
        let mut light = vec![Vec4::ZERO; self.block_count() * EDGE];
        for (light, &j) in light.iter_mut().zip(self.permutation.order()) {
            *light = exitance[j as usize];
        }
        let mut ordered = vec![Vec4::ZERO; light.len()];
        match self.settings.codec {
            BlockCodec::Bc1 => self.gather::<Bc1>(&light, &mut ordered),
            BlockCodec::Bc3 => self.gather::<Bc3>(&light, &mut ordered),
            BlockCodec::Bc6h => self.gather::<Bc6h>(&light, &mut ordered),
            BlockCodec::Bc7 => self.gather::<Bc7>(&light, &mut ordered),
        }
        for ((result, &permuted_index), scale) in
            irradiance.iter_mut().zip(self.permutation.place()).zip(&self.row_scales)
        {
            *result = ordered[permuted_index as usize] * *scale;
        }
        Ok(())
    }
}

impl BlockMatrix {
    fn gather<F: PlaneFormat>(&self, light: &[Vec4], ordered: &mut [Vec4]) {
        let arch = Arch::new();
        let p = self.params(0, self.block_count() as u32);
        // Each channel of the light of a block's columns, once for each of its rows.
        let mut lanes = vec![[[0.0f32; TEXELS]; 3]; self.block_count()];
        for (lanes, light) in lanes.iter_mut().zip(light.chunks(EDGE)) {
            for (c, lanes) in lanes.iter_mut().enumerate() {
                for (k, lane) in lanes.iter_mut().enumerate() {
                    *lane = light[k % EDGE][c];
                }
            }
        }
        ordered.par_chunks_mut(EDGE).enumerate().for_each(|(row, out)| {
            let sums = match self.settings.companding {
                Companding::None => {
                    arch.dispatch(Strip::<F, 0> { matrix: self, row, lanes: &lanes, format: Default::default() })
                }
                Companding::Sqrt => {
                    arch.dispatch(Strip::<F, 1> { matrix: self, row, lanes: &lanes, format: Default::default() })
                }
                Companding::Log2 => {
                    arch.dispatch(Strip::<F, 2> { matrix: self, row, lanes: &lanes, format: Default::default() })
                }
            };
            for (k, out) in out.iter_mut().enumerate() {
                let i = row * EDGE + k;
                if i < self.len() {
                    let start = &self.outliers.start;
                    let entries = &self.outliers.entries;
                    *out = (sums[k] + gather_outliers(i as u32, &p, 0, 1, start, entries, light)).extend(0.0);
                }
            }
        });
    }
}

/// Four rows from a row of blocks; `COMPANDING` is that of the kernels.
struct Strip<'a, F, const COMPANDING: u32> {
    matrix: &'a BlockMatrix,
    row: usize,
    lanes: &'a [[[f32; TEXELS]; 3]],
    format: core::marker::PhantomData<F>,
}

impl<F: PlaneFormat, const COMPANDING: u32> WithSimd for Strip<'_, F, COMPANDING> {
    type Output = [Vec3; EDGE];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let columns = self.lanes.len();
        let tile = self.matrix.settings.tile / EDGE;
        let tile_columns = columns.div_ceil(tile);
        let scales = &self.matrix.scales[self.row / tile * tile_columns..][..tile_columns];
        let mut sums = [[0.0f32; TEXELS]; 3];
        for (t, scale) in scales.iter().enumerate() {
            let mut part = [[0.0f32; TEXELS]; 3];
            for column in t * tile..((t + 1) * tile).min(columns) {
                let mut planes = F::planes(self.matrix.block(self.row * columns + column));
                for (c, plane) in planes.iter_mut().enumerate() {
                    for x in plane.iter_mut() {
                        *x = match COMPANDING {
                            0 => *x,
                            1 => *x * *x,
                            _ => (exp2(8.0 * *x) - 1.0) * (1.0 / 255.0),
                        };
                    }
                    add_product(simd, &mut part[c], plane, &self.lanes[column][c]);
                }
            }
            for c in 0..3 {
                for k in 0..TEXELS {
                    sums[c][k] += part[c][k] * scale[c];
                }
            }
        }
        core::array::from_fn(|row| {
            let channel = |c: usize| sums[c][row * EDGE..(row + 1) * EDGE].iter().sum::<f32>();
            Vec3::new(channel(0), channel(1), channel(2))
        })
    }
}

/// `sums[k] += a[k] b[k]`. A multiple of every vector's length, so that there is no tail.
#[inline(always)]
fn add_product<S: Simd>(simd: S, sums: &mut [f32; TEXELS], a: &[f32; TEXELS], b: &[f32; TEXELS]) {
    let (sums, (a, _), (b, _)) = (S::as_mut_simd_f32s(sums).0, S::as_simd_f32s(a), S::as_simd_f32s(b));
    for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
        *sum = simd.mul_add_f32s(*a, *b, *sum);
    }
}
