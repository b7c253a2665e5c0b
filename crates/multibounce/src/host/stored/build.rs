//! Building of operators panel by panel.

use std::vec::Vec;

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, MatMut, MatRef, Side};
use scene::parallel::*;
use transport::{Proceed, check_length};

use super::panel::{LANES, Ordered};
use super::{BlockFile, StoredOperator, Workspace};
use crate::error::Error;
use crate::host::low_rank::{SIDE, permuted_indices};
use crate::host::solve::{FLOOR, Factors, MIN_ALBEDO, check_albedo};

/// Greatest edge of the blocks of a factor: larger ones make products no faster.
const MAX_EDGE: usize = 1024;
/// Blocks that a factorisation holds beside its panel: two that it multiplies, and two while one is factorised.
const BLOCKS: usize = 4;

/// Sizes of what is held at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sizes {
    /// Edge of the factor's blocks, whole tiles; 0 where there is no factor.
    edge: usize,
    /// Rows of a panel: all patches, in whole blocks.
    rows: usize,
    /// Columns of a panel, whole tiles.
    width: usize,
    /// Bytes of all.
    bytes: u64,
}

impl Sizes {
    /// The greatest that so many bytes allow for n patches, with a factor or without.
    fn new(n: usize, has_factor: bool, workspace: &Workspace) -> Result<Self, Error> {
        let lanes = 2 * LANES * n * current_num_threads();
        let of = |edge: usize, width: usize| {
            let rows = n.next_multiple_of(edge.max(SIDE));
            let numbers = rows * width.max(edge) + BLOCKS * edge * edge + lanes;
            Self { edge, rows, width, bytes: (numbers * size_of::<f32>()) as u64 }
        };
        let most = n.next_multiple_of(SIDE).clamp(SIDE, MAX_EDGE);
        let mut edge = if has_factor { most } else { 0 };
        while edge > SIDE && of(edge, edge).bytes > workspace.bytes {
            edge = (edge / 2).next_multiple_of(SIDE);
        }
        let least = of(edge, SIDE);
        if least.bytes > workspace.bytes {
            return Err(Error::Memory { needed: least.bytes.div_ceil(1 << 20), limit: workspace.bytes >> 20 });
        }
        // As many columns as fit into the workspace, then panels of equal width.
        let all = n.next_multiple_of(SIDE).max(SIDE);
        let wide = (SIDE..=all).step_by(SIDE).take_while(|&width| of(edge, width).bytes <= workspace.bytes).last();
        let panels = all.div_ceil(wide.unwrap_or(SIDE));
        Ok(of(edge, all.div_ceil(panels).next_multiple_of(SIDE)))
    }
}

/// So many bounces of one colour channel as a file: [`crate::some_bounces`] of the symmetric form factors, some columns
/// at a time, with sparse products; `order` is that of the tiles. Memory: the sparse form factors twice, and what
/// `workspace` allows, of which more makes nothing faster. `progress(done, total)` counts panels; breaking it cancels.
///
/// # Errors
/// As [`crate::some_bounces`]; [`Error::Memory`] where the least panel does not fit, [`Error::File`].
pub fn some_bounces_stored(
    factors: &Factors,
    albedo: &[f32],
    bounces: u32,
    order: &[u32],
    workspace: &Workspace,
    progress: &dyn Fn(usize, usize) -> Proceed,
) -> Result<StoredOperator, Error> {
    if bounces == 0 {
        return Err(transport::Error::Setting { name: "bounces", value: 0.0, rule: "at least 1" }.into());
    }
    let (ordered, albedo, mut out) = begin(factors, albedo, order, workspace)?;
    let sizes = Sizes::new(order.len(), false, workspace)?;
    let mut panel = vec![0.0; sizes.rows * sizes.width];
    out.held_bytes = sizes.bytes;
    let total = order.len().div_ceil(sizes.width);
    for k in 0..total {
        ordered.bounces(&albedo, bounces, k * sizes.width, &mut panel, sizes.rows);
        out.write(k * sizes.width / SIDE, &panel, sizes.rows)?;
        if progress(k + 1, total).is_break() {
            return Err(transport::Error::Cancelled { done: k + 1, total }.into());
        }
    }
    Ok(out)
}

/// All bounces of one colour channel as a file, some columns at a time: with `P = diag(ρ^½)`, `L Lᵀ = I − P Ŝ P` is
/// factorised by blocks (from the left) into a second file of 2 n² bytes, and `P T̂ = (I − P Ŝ P)⁻¹ P Ŝ` solved for the
/// columns of a panel; where ρ is almost 0, rows are `T̂ = Ŝ + Ŝ P (P T̂)`. Operations: about 7/3 n³, and n³ of
/// [`crate::all_bounces`]. `order` is that of the tiles.
///
/// Memory: the sparse form factors twice, and what `workspace` allows: a panel of n rows, four blocks, and some columns
/// for each thread. Wide panels read the factor less often: it is read twice for each. `progress(done, total)` counts
/// products of blocks; breaking it cancels.
///
/// # Errors
/// As [`crate::all_bounces`]; [`Error::Memory`] where the least panel does not fit, [`Error::File`].
pub fn all_bounces_stored(
    factors: &Factors,
    albedo: &[f32],
    order: &[u32],
    workspace: &Workspace,
    progress: &dyn Fn(usize, usize) -> Proceed,
) -> Result<StoredOperator, Error> {
    let (ordered, albedo, mut out) = begin(factors, albedo, order, workspace)?;
    let sizes = Sizes::new(order.len(), true, workspace)?;
    let blocks = sizes.rows / sizes.edge;
    let panels = order.len().div_ceil(sizes.width);
    let total = blocks * (blocks + 1) / 2 + panels * 2 * blocks;
    let mut done = 0;
    let mut step = || {
        done += 1;
        if progress(done, total).is_break() { Err(transport::Error::Cancelled { done, total }.into()) } else { Ok(()) }
    };
    let mut sqrt_albedo: Vec<f32> = albedo.iter().map(|&a| scene::math::sqrt(a)).collect();
    sqrt_albedo.resize(sizes.rows, 0.0);
    let is_dark: Vec<bool> = albedo.iter().map(|&a| a < MIN_ALBEDO).collect();
    let mut panel = vec![0.0; sizes.rows * sizes.width.max(sizes.edge)];
    let block = || vec![0.0; sizes.edge * sizes.edge];
    let mut two = [block(), block()];
    out.held_bytes = sizes.bytes;
    let factor = Factor::new(&ordered, &sqrt_albedo, order, &sizes, workspace, (&mut panel, &mut two), &mut step)?;
    for k in 0..panels {
        let first = k * sizes.width;
        let columns = &mut panel[..sizes.rows * sizes.width];
        // Nothing is 0, for the reason of FLOOR.
        columns.par_chunks_mut(sizes.rows).enumerate().for_each(|(c, column)| {
            column.fill(FLOOR);
            if first + c < ordered.len() {
                ordered.row(first + c).iter().for_each(|&(i, s)| column[i as usize] += sqrt_albedo[i as usize] * s);
            }
        });
        factor.solve(columns, &mut two[0], &mut step)?;
        ordered.unscale(&sqrt_albedo, &is_dark, first, columns, sizes.rows);
        out.write(first / SIDE, columns, sizes.rows)?;
    }
    Ok(out)
}

/// Common beginning of both: form factors, reflectances and the file by permuted indices.
fn begin(
    factors: &Factors,
    albedo: &[f32],
    order: &[u32],
    workspace: &Workspace,
) -> Result<(Ordered, Vec<f32>, StoredOperator), Error> {
    check_length("order", factors.patches(), order.len())?;
    check_albedo(albedo, factors.patches())?;
    let permuted_index = permuted_indices(order)?;
    let ordered = Ordered::new(factors, order, &permuted_index)?;
    let albedo = order.iter().map(|&i| albedo[i as usize]).collect();
    Ok((ordered, albedo, StoredOperator::new(workspace.folder, order, permuted_index)?))
}

/// A Cholesky factor in blocks of the lower triangle, in a file.
struct Factor {
    file: BlockFile,
    edge: usize,
    rows: usize,
}

fn block_index(i: usize, j: usize) -> usize {
    i * (i + 1) / 2 + j
}

impl Factor {
    /// Column by column of blocks, each from those before it.
    fn new(
        ordered: &Ordered,
        sqrt_albedo: &[f32],
        order: &[u32],
        sizes: &Sizes,
        workspace: &Workspace,
        (panel, [left, right]): (&mut [f32], &mut [Vec<f32>; 2]),
        step: &mut dyn FnMut() -> Result<(), Error>,
    ) -> Result<Self, Error> {
        let Sizes { edge, rows, .. } = *sizes;
        let blocks = rows / edge;
        let file = BlockFile::new(workspace.folder, edge * edge, blocks * (blocks + 1) / 2)?;
        let this = Self { file, edge, rows };
        let parallel = faer::get_global_parallelism();
        for k in 0..blocks {
            let first = k * edge;
            let below = rows - k * edge;
            let panel = &mut panel[..below * edge];
            panel.par_chunks_mut(below).enumerate().for_each(|(c, column)| {
                column.fill(-FLOOR);
                column[c] += 1.0;
                if first + c < ordered.len() {
                    for &(i, s) in ordered.row(first + c) {
                        if i as usize >= first {
                            column[i as usize - first] -= sqrt_albedo[i as usize] * s * sqrt_albedo[first + c];
                        }
                    }
                }
            });
            for j in 0..k {
                this.file.read(block_index(k, j), right)?;
                for i in k..blocks {
                    this.file.read(block_index(i, j), left)?;
                    let to = rows_of(panel, below, (i - k) * edge, edge);
                    matmul(to, Accum::Add, square(left, edge), square(right, edge).transpose(), -1.0, parallel);
                }
                step()?;
            }
            let llt = rows_of(panel, below, 0, edge).as_ref().llt(Side::Lower).map_err(|error| {
                let faer::linalg::cholesky::llt::factor::LltError::NonPositivePivot { index } = error;
                Error::Singular { patch: order.get(first + index).map_or(0, |&patch| patch as usize) }
            })?;
            for (column, from) in right.chunks_mut(edge).zip(llt.L().col_iter()) {
                column.iter_mut().zip(from.iter()).for_each(|(to, from)| *to = *from);
            }
            drop(llt);
            this.file.write(block_index(k, k), right)?;
            for i in k + 1..blocks {
                let mut own = rows_of(panel, below, (i - k) * edge, edge);
                solve_lower_triangular_in_place(square(right, edge), own.as_mut().transpose_mut(), parallel);
                for (column, from) in left.chunks_mut(edge).zip(own.as_ref().col_iter()) {
                    column.iter_mut().zip(from.iter()).for_each(|(to, from)| *to = *from);
                }
                this.file.write(block_index(i, k), left)?;
            }
            step()?;
        }
        Ok(this)
    }

    /// Solves `L Lᵀ X = B` in place, some columns of all rows.
    fn solve(
        &self,
        columns: &mut [f32],
        block: &mut [f32],
        step: &mut dyn FnMut() -> Result<(), Error>,
    ) -> Result<(), Error> {
        let Self { edge, rows, .. } = *self;
        let blocks = rows / edge;
        let parallel = faer::get_global_parallelism();
        let mut whole = MatMut::from_column_major_slice_mut(columns, rows, columns.len() / rows);
        for j in 0..blocks {
            self.file.read(block_index(j, j), block)?;
            let (above, mut below) = whole.as_mut().split_at_row_mut((j + 1) * edge);
            let mut own = above.subrows_mut(j * edge, edge);
            solve_lower_triangular_in_place(square(block, edge), own.as_mut(), parallel);
            for i in j + 1..blocks {
                self.file.read(block_index(i, j), block)?;
                let to = below.as_mut().subrows_mut((i - j - 1) * edge, edge);
                matmul(to, Accum::Add, square(block, edge), own.as_ref(), -1.0, parallel);
            }
            step()?;
        }
        for j in (0..blocks).rev() {
            let (above, below) = whole.as_mut().split_at_row_mut((j + 1) * edge);
            let mut own = above.subrows_mut(j * edge, edge);
            for i in j + 1..blocks {
                self.file.read(block_index(i, j), block)?;
                let from = below.as_ref().subrows((i - j - 1) * edge, edge);
                matmul(own.as_mut(), Accum::Add, square(block, edge).transpose(), from, -1.0, parallel);
            }
            self.file.read(block_index(j, j), block)?;
            solve_upper_triangular_in_place(square(block, edge).transpose(), own.as_mut(), parallel);
            step()?;
        }
        Ok(())
    }
}

fn square(block: &[f32], edge: usize) -> MatRef<'_, f32> {
    MatRef::from_column_major_slice(block, edge, edge)
}

/// Some rows of columns of so many.
fn rows_of(columns: &mut [f32], rows: usize, first: usize, count: usize) -> MatMut<'_, f32> {
    let width = columns.len() / rows;
    MatMut::from_column_major_slice_mut(columns, rows, width).subrows_mut(first, count)
}
