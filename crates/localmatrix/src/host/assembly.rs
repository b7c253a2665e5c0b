//! Rows of F between the nodes of a cut, from rows whose columns are nodes of any level.

use std::vec::Vec;

use rayon::prelude::*;

use super::forest::Forest;
use super::world::Node;

/// A row of a world: nodes, and the share of the light that arrives there.
pub(super) type Row = Vec<(u32, f32)>;

/// What a node sends to another one, as its row says.
#[derive(Clone, Copy, Default)]
struct Said {
    factor: f32,
    /// Whether the row knows only an ancestor of the other one.
    is_guess: bool,
}

/// Adds what a row says of `nodes`, which are in order and none an ancestor of another one: `say(place, factor, is_guess)`. An entry goes to
/// the node that covers it; where several are finer than the entry, they share it by their areas.
fn spread(row: &[(u32, f32)], cut: &[u32], nodes: &[Node], forest: &Forest, mut say: impl FnMut(usize, f32, bool)) {
    for &(column, factor) in row {
        let mut at = forest.first_from(cut, column);
        if at < cut.len() && forest.covers(cut[at], column) {
            say(at, factor, false);
            continue;
        }
        while at < cut.len() && forest.covers(column, cut[at]) {
            say(at, factor * nodes[cut[at] as usize].area / nodes[column as usize].area, true);
            at += 1;
        }
    }
}

/// Rows of F from nodes that enter to all of `cut`, which they are of: `A_a F_ab` is the mean of both rows, where both know
/// both nodes; that of the one that does, where the other one knows an ancestor only. So F̂ is symmetric and depends on the cut alone,
/// not on the order in which its nodes came.
pub(super) fn assemble<'a>(
    entering: &[u32],
    cut: &[u32],
    nodes: &[Node],
    forest: &Forest,
    row: impl Fn(u32) -> &'a [(u32, f32)] + Sync,
) -> Vec<Row> {
    let mut order = entering.to_vec();
    order.sort_unstable_by_key(|&node| forest.run(node));
    // What the others say of those that enter.
    let back = |&node: &u32| {
        let mut said: Vec<(u32, Said)> = Vec::new();
        spread(row(node), &order, nodes, forest, |place, factor, is_guess| {
            // Entries are in the order of their columns more often than not.
            match said.iter_mut().rev().find(|(p, _)| *p == place as u32) {
                Some((_, one)) => one.factor += factor,
                None => said.push((place as u32, Said { factor, is_guess })),
            }
        });
        said
    };
    let back: Vec<Vec<(u32, Said)>> = cut.par_iter().with_min_len(16).map(back).collect();
    let mut told: Vec<Vec<(u32, Said)>> = vec![Vec::new(); order.len()];
    for (place, said) in back.iter().enumerate() {
        said.iter().for_each(|&(one, what)| told[one as usize].push((place as u32, what)));
    }
    let forth = |node: u32| {
        let mut said = vec![Said::default(); cut.len()];
        spread(row(node), cut, nodes, forest, |place, factor, is_guess| {
            said[place].factor += factor;
            said[place].is_guess = is_guess;
        });
        let area = nodes[node as usize].area;
        let told = &told[order.partition_point(|&one| forest.run(one) < forest.run(node))];
        let mut others = told.iter().peekable();
        let mut out = Row::new();
        for (place, (mine, &other)) in said.into_iter().zip(cut).enumerate() {
            let theirs = match others.next_if(|(p, _)| *p as usize == place) {
                Some(&(_, theirs)) => theirs,
                None => Said::default(),
            };
            let back = theirs.factor * nodes[other as usize].area / area;
            let factor = match (mine.is_guess, theirs.is_guess) {
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
    entering.par_iter().map(|&node| forth(node)).collect()
}
