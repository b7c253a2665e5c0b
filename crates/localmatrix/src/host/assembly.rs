//! Rows of F between the nodes of a cut, from rows whose columns are nodes of any level.

use alloc::vec::Vec;

use scene::parallel::*;

use super::forest::Forest;
use super::world::Node;

/// A row of a world: nodes, and the share of the light that arrives there.
pub(super) type Row = Vec<(u32, f32)>;

/// A row estimate: the form factor from one node to another one as the row of the first gives it.
#[derive(Clone, Copy, Default)]
struct RowEstimate {
    factor: f32,
    /// True if the row has only an ancestor of the other node, whose form factor is shared out by area.
    is_coarse: bool,
}

/// Spreads a row over the nodes of `cut`, which are in order and none an ancestor of another one, by `add(position in
/// the cut, factor, is_coarse)`. An entry goes to the node that covers it; where several are finer than the entry, they
/// share it by their areas.
fn spread(row: &[(u32, f32)], cut: &[u32], nodes: &[Node], forest: &Forest, mut add: impl FnMut(usize, f32, bool)) {
    for &(column, factor) in row {
        let mut at = forest.first_from(cut, column);
        if at < cut.len() && forest.covers(cut[at], column) {
            add(at, factor, false);
            continue;
        }
        while at < cut.len() && forest.covers(column, cut[at]) {
            add(at, factor * nodes[cut[at] as usize].area / nodes[column as usize].area, true);
            at += 1;
        }
    }
}

/// Rows of F from nodes that enter to all of `cut`, which they are part of: `A_a F_ab` is the mean of both row
/// estimates, or the finer one where the other is coarse. So F̂ is symmetric and depends on the cut alone, not on the
/// order in which its nodes came.
pub(super) fn assemble<'a>(
    entering: &[u32],
    cut: &[u32],
    nodes: &[Node],
    forest: &Forest,
    row: impl Fn(u32) -> &'a [(u32, f32)] + Sync,
) -> Vec<Row> {
    let mut order = entering.to_vec();
    order.sort_unstable_by_key(|&node| forest.run(node));
    // Row estimates of each node of the cut, to the nodes that enter.
    let to_entering = |&node: &u32| {
        let mut estimates: Vec<(u32, RowEstimate)> = Vec::new();
        spread(row(node), &order, nodes, forest, |place, factor, is_coarse| {
            // Entries are in the order of their columns more often than not.
            match estimates.iter_mut().rev().find(|(p, _)| *p == place as u32) {
                Some((_, one)) => one.factor += factor,
                None => estimates.push((place as u32, RowEstimate { factor, is_coarse })),
            }
        });
        estimates
    };
    let rows: Vec<Vec<(u32, RowEstimate)>> = cut.par_iter().with_min_len(16).map(to_entering).collect();
    let mut columns: Vec<Vec<(u32, RowEstimate)>> = vec![Vec::new(); order.len()];
    for (place, estimates) in rows.iter().enumerate() {
        estimates.iter().for_each(|&(one, estimate)| columns[one as usize].push((place as u32, estimate)));
    }
    let from_entering = |node: u32| {
        let mut estimates = vec![RowEstimate::default(); cut.len()];
        spread(row(node), cut, nodes, forest, |place, factor, is_coarse| {
            estimates[place].factor += factor;
            estimates[place].is_coarse = is_coarse;
        });
        let area = nodes[node as usize].area;
        let column = &columns[order.partition_point(|&one| forest.run(one) < forest.run(node))];
        let mut others = column.iter().peekable();
        let mut out = Row::new();
        for (place, (mine, &other)) in estimates.into_iter().zip(cut).enumerate() {
            let theirs = match others.next_if(|(p, _)| *p as usize == place) {
                Some(&(_, theirs)) => theirs,
                None => RowEstimate::default(),
            };
            let back = theirs.factor * nodes[other as usize].area / area;
            let factor = match (mine.is_coarse, theirs.is_coarse) {
                (false, true) => mine.factor,
                (true, false) => back,
                _ => 0.5 * (mine.factor + back),
            };
            if factor > 0.0 {
                out.push((other, factor));
            }
        }
        out
    };
    entering.par_iter().map(|&node| from_entering(node)).collect()
}
