//! The matrix that goes with a camera through a world.

use alloc::vec::Vec;

use glam::Vec4;
use hashbrown::{HashMap, HashSet};
use scene::parallel::*;
use transport::LinearOperator;

use super::assembly::{Row, assemble};
use super::cut::{Chooser, Replacement, View};
use super::forest::Forest;
use super::matrix::{Entering, LocalMatrix};
use super::world::{NO_NODE, Node, World};
use crate::error::Error;
use crate::kernel::{fade, is_some, mean, spread};
use crate::types::FadeParams;

/// Nodes that enter as one border: more take more memory, fewer more time.
const BATCH: usize = 32;
/// Distances below so many edges of a patch are all alike.
const NEAR: f32 = 2.0;
/// Rounds of [`Local::settle`] in which no row is missing: each makes all changes but those that do not fit at once.
const MAX_ROUNDS: usize = 256;

/// Pause of [`Local::settle`] while rows are under way: it sleeps.
#[cfg(feature = "std")]
fn pause() {
    std::thread::sleep(core::time::Duration::from_millis(1));
}

/// Pause of [`Local::settle`] while rows are under way: there is no thread to leave the core to.
#[cfg(not(feature = "std"))]
fn pause() {
    core::hint::spin_loop();
}

/// Settings of [`Local`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalSettings {
    /// Nodes that the matrix holds at most, M.
    pub slots: usize,
    /// Nodes that enter or leave in a step at most; a family that has more changes alone.
    pub changes: usize,
    /// The apparent size of what is fine counts as larger by this share, so that a camera that trembles moves nothing.
    pub hysteresis: f32,
    /// Frames over which light goes over to that of other nodes; its jump shrinks by `1 / fade` a frame. 1 for at once.
    pub fade: u32,
    /// Display white, the irradiance that is displayed as white, W/m²: jumps shrink so slowly that no displayed value
    /// changes by more than two 255ths in a frame. Infinite where values are not displayed.
    pub display_white: f32,
    /// Relative residual above which all columns are refreshed.
    pub tolerance: f32,
    /// Rows that are asked for ahead, at most.
    pub wanted: usize,
}

impl Default for LocalSettings {
    /// 4,096 slots, 64 changes a step, a fifth of hysteresis, 16 frames, no display white, 10⁻⁵, 1,024 rows.
    fn default() -> Self {
        Self {
            slots: 4096,
            changes: 64,
            hysteresis: 0.2,
            fade: 16,
            display_white: f32::INFINITY,
            tolerance: 1e-5,
            wanted: 1024,
        }
    }
}

impl LocalSettings {
    /// # Errors
    /// [`transport::Error::Setting`] for values out of their range.
    pub fn check(&self) -> Result<(), Error> {
        let refuse = |name, value, rule| Err(transport::Error::Setting { name, value, rule }.into());
        if self.changes == 0 {
            return refuse("changes", 0.0, "at least 1");
        }
        if !(self.hysteresis >= 0.0 && self.hysteresis.is_finite()) {
            return refuse("hysteresis", f64::from(self.hysteresis), "at least 0");
        }
        if self.fade == 0 {
            return refuse("fade", 0.0, "at least 1");
        }
        if self.display_white.is_nan() || self.display_white <= 0.0 {
            return refuse("display white", f64::from(self.display_white), "positive");
        }
        if self.tolerance.is_nan() || self.tolerance <= 0.0 {
            return refuse("tolerance", f64::from(self.tolerance), "positive");
        }
        Ok(())
    }
}

/// Changes that a step is about to make, see [`Local::choose`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Changes {
    /// Nodes that enter, with their rows.
    enter: Vec<u32>,
    /// Nodes in whose place they do.
    leave: Vec<u32>,
    /// Nodes that leave with nothing in their place, and become ghosts.
    out: Vec<u32>,
    waiting: usize,
    later: usize,
    lost: Vec<Error>,
}

impl Changes {
    /// Returns true if nothing changes.
    pub fn is_empty(&self) -> bool {
        self.enter.is_empty() && self.leave.is_empty() && self.out.is_empty()
    }
}

/// Changes made by a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Step {
    /// Nodes that entered.
    pub entered: usize,
    /// Nodes that left, or became ghosts.
    pub left: usize,
    /// Nodes that would enter, but whose rows are not there yet: coarser ones stay in their place.
    pub waiting: usize,
    /// Nodes that would enter, but that exceeded the budget.
    pub later: usize,
    /// Multiplications, all channels, that the matrix took.
    pub work: u64,
    /// Residual of the columns that were looked at, relative; none where nothing changed.
    pub residual: Option<f32>,
    /// Rows that are lost, and nodes that the matrix refused: they stay coarser, and are not tried again.
    pub lost: Vec<Error>,
}

impl Step {
    /// Both together, where `before` came first: counts of what is left to do are those of the later.
    pub fn after(self, before: Step) -> Step {
        Step {
            entered: before.entered + self.entered,
            left: before.left + self.left,
            work: before.work + self.work,
            residual: self.residual.or(before.residual),
            lost: before.lost.into_iter().chain(self.lost).collect(),
            ..self
        }
    }
}

/// All bounces of light in a world of any size, between the nodes that stand for it about a camera.
///
/// The nodes in the matrix are a *cut* of the world's forest, at most M nodes, fine where their apparent size from the
/// predicted camera path is large and coarse elsewhere. A node gives way to its descendants, and they to it, exactly
/// and as a whole, so that each part of the world is in the matrix once; where there are more roots than slots, those
/// of the least apparent size leave as ghosts. Light shines from the mean exitance of a node and arrives at all of its
/// patches alike.
///
/// Each frame either [`Self::frame`], or its parts: [`Self::choose`], [`Self::apply`], [`Self::product`].
#[derive(Clone, Debug)]
pub struct Local {
    settings: LocalSettings,
    forest: Forest,
    leaf_area: Vec<f32>,
    near: f32,
    matrix: LocalMatrix,
    /// Nodes that stand for the world, in order.
    cut: Vec<u32>,
    ghosts: Vec<u32>,
    /// Rows of the cut, of ghosts and of nodes that are to enter.
    rows: HashMap<u32, Row>,
    /// Nodes that cannot enter.
    excluded: HashSet<u32>,
    /// Columns that are yet to be refreshed.
    repair: usize,
    /// Remaining jumps of the light, for each leaf, from the first one on.
    offset: Vec<Vec4>,
}

impl Local {
    /// An empty matrix for a world.
    ///
    /// # Errors
    /// [`transport::Error::Setting`], [`Error::Node`] where the nodes are no forest.
    pub fn new(nodes: &[Node], settings: LocalSettings) -> Result<Self, Error> {
        settings.check()?;
        let forest = Forest::new(nodes)?;
        let leaf_area: Vec<f32> = forest.leaves().iter().map(|&leaf| nodes[leaf as usize].area).collect();
        let area = leaf_area.iter().map(|&a| f64::from(a)).sum::<f64>() / leaf_area.len().max(1) as f64;
        Ok(Self {
            settings,
            matrix: LocalMatrix::new(settings.slots)?,
            near: NEAR * scene::math::sqrt(area as f32).max(f32::MIN_POSITIVE),
            forest,
            leaf_area,
            cut: Vec::new(),
            ghosts: Vec::new(),
            rows: HashMap::new(),
            excluded: HashSet::new(),
            repair: 0,
            offset: Vec::new(),
        })
    }

    /// Settings that it was made with.
    pub fn settings(&self) -> &LocalSettings {
        &self.settings
    }

    /// The matrix: its patches are nodes.
    pub fn matrix(&self) -> &LocalMatrix {
        &self.matrix
    }

    /// The matrix, for its record of updates.
    pub fn matrix_mut(&mut self) -> &mut LocalMatrix {
        &mut self.matrix
    }

    /// The leaves' order, in which exitance is given and irradiance returned, and what each node covers of it.
    pub fn forest(&self) -> &Forest {
        &self.forest
    }

    /// Area of each leaf, m².
    pub fn leaf_area(&self) -> &[f32] {
        &self.leaf_area
    }

    /// The nodes that stand for the world, in the order of their leaves.
    pub fn cut(&self) -> &[u32] {
        &self.cut
    }

    /// Slot of each leaf's node, or [`NO_NODE`], and of each slot the run of leaves, empty where it holds none.
    pub fn places(&self) -> (Vec<u32>, Vec<[u32; 2]>) {
        let mut slot_of = vec![NO_NODE; self.leaf_area.len()];
        let mut runs = vec![[0; 2]; self.settings.slots];
        for (slot, node) in self.matrix.patches() {
            let run = self.forest.run(node);
            slot_of[run[0] as usize..run[1] as usize].fill(slot);
            runs[slot as usize] = run;
        }
        (slot_of, runs)
    }

    /// Bytes of rows, of the matrix, and of the rest.
    pub fn bytes(&self) -> [(&'static str, u64); 3] {
        let rows: usize = self.rows.values().map(|row| size_of_val(&row[..])).sum();
        let leaves = size_of_val(&self.leaf_area[..]) + size_of_val(&self.offset[..]) + self.forest.bytes();
        [("rows", rows as u64), ("matrix", self.matrix.bytes()), ("leaves", leaves as u64)]
    }

    /// Chooses what a step is to change, and asks the world for the rows that it and the next ones need. Never waits.
    pub fn choose(&mut self, world: &mut dyn World, view: View) -> Changes {
        self.choose_some(world, view, self.settings.changes)
    }

    fn choose_some(&mut self, world: &mut dyn World, view: View, most: usize) -> Changes {
        let slots = self.settings.slots;
        let (mut finer, mut coarser, out) = {
            let nodes = world.nodes();
            let chooser = Chooser {
                nodes,
                forest: &self.forest,
                view,
                near: self.near,
                hysteresis: self.settings.hysteresis,
                cut: &self.cut,
            };
            let target = chooser.choose(slots, |node| self.excluded.contains(&node));
            let (finer, coarser, out) = chooser.replacements(&target);
            let mut finer: Vec<Replacement> = finer.into_iter().map(|one| self.at_most(one, nodes, most)).collect();
            // Roots come before what is in them, which would be named for each.
            finer.dedup();
            let coarser: Vec<Replacement> = coarser.into_iter().map(|one| self.at_most(one, nodes, most)).collect();
            let by_size = |list: Vec<Replacement>, of: fn(&Replacement) -> u32| {
                let mut ranked: Vec<(f32, Replacement)> =
                    list.into_iter().map(|one| (chooser.apparent_size(of(&one)), one)).collect();
                ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
                ranked
            };
            // The greatest apparent size first, and the least.
            let mut finer = by_size(finer, |one| one.leave.first().copied().unwrap_or(one.enter[0]));
            finer.reverse();
            let coarser = by_size(coarser, |one| one.enter[0]);
            let plain = |list: Vec<(f32, Replacement)>| list.into_iter().map(|(_, one)| one).peekable();
            (plain(finer), plain(coarser), out)
        };
        let mut changes = Changes { out, ..Changes::default() };
        let mut count = self.cut.len() - changes.out.len();
        let mut total = 0;
        let mut wanted = Vec::new();
        loop {
            while let Some(one) = finer.next_if(|one| !self.fetch(world, one, &mut changes, &mut wanted)) {
                changes.waiting += one.enter.len();
            }
            let next = match finer.next_if(|one| count + one.enter.len() <= slots + one.leave.len()) {
                Some(one) => one,
                None => {
                    while let Some(one) = coarser.next_if(|one| !self.fetch(world, one, &mut changes, &mut wanted)) {
                        changes.waiting += one.enter.len();
                    }
                    match (coarser.next(), finer.next()) {
                        (Some(one), _) => one,
                        (None, Some(one)) => {
                            changes.later += one.enter.len();
                            continue;
                        }
                        (None, None) => break,
                    }
                }
            };
            let size = next.enter.len() + next.leave.len();
            if total > 0 && total + size > most {
                changes.later += next.enter.len();
                break;
            }
            total += size;
            count = count + next.enter.len() - next.leave.len();
            changes.enter.extend(&next.enter);
            changes.leave.extend(&next.leave);
        }
        // Those that were not looked at: their rows are being read by the time they come next.
        for one in finer.chain(coarser) {
            changes.later += one.enter.len();
            wanted.extend(one.enter.iter().filter(|&node| !self.rows.contains_key(node)));
        }
        wanted.truncate(self.settings.wanted);
        world.want(&wanted);
        changes
    }

    /// Returns true if the rows of what enters are there; those that are not are wanted.
    fn fetch(
        &mut self,
        world: &mut dyn World,
        one: &Replacement,
        changes: &mut Changes,
        wanted: &mut Vec<u32>,
    ) -> bool {
        let mut is_there = true;
        for &node in &one.enter {
            if self.rows.contains_key(&node) {
                continue;
            }
            match world.row(node) {
                Ok(Some(row)) => {
                    self.rows.insert(node, row);
                }
                Ok(None) => {
                    wanted.push(node);
                    is_there = false;
                }
                Err(error) => {
                    self.excluded.insert(node);
                    changes.lost.push(error);
                    is_there = false;
                }
            }
        }
        is_there
    }

    /// The replacement, or a part of it that has about as many changes as there may be: a family.
    fn at_most(&self, one: Replacement, nodes: &[Node], most: usize) -> Replacement {
        let parent = |node: u32| nodes[node as usize].parent;
        let Some(&first) = one.leave.first() else {
            // What is not there yet begins with its root.
            let mut root = one.enter[0];
            while parent(root) != NO_NODE {
                root = parent(root);
            }
            return Replacement { enter: vec![root], leave: Vec::new() };
        };
        if one.enter.len() + one.leave.len() <= most {
            return one;
        }
        if let [node] = one.leave[..] {
            let Node { first_child, children, .. } = nodes[node as usize];
            return Replacement { enter: (first_child..first_child + children).collect(), leave: vec![node] };
        }
        // The deepest has all of its siblings beside it.
        let depth =
            |&node: &u32| core::iter::successors(Some(node), |&n| Some(parent(n)).filter(|&p| p != NO_NODE)).count();
        let deepest = one.leave.iter().copied().max_by_key(|node| (depth(node), u32::MAX - node)).unwrap_or(first);
        let whole = parent(deepest);
        let family = one.leave.iter().copied().filter(|&node| self.forest.covers(whole, node)).collect();
        Replacement { enter: vec![whole], leave: family }
    }

    /// Makes the changes in the matrix, and refreshes what rounding has left in it.
    ///
    /// # Errors
    /// What the matrix refuses, other than nodes with which light would grow: those stay out, and what left comes back.
    pub fn apply(&mut self, world: &dyn World, changes: Changes) -> Result<Step, Error> {
        let before = self.matrix.work();
        let mut step = Step { waiting: changes.waiting, later: changes.later, lost: changes.lost, ..Step::default() };
        let enter = &changes.enter;
        let leave = &changes.leave;
        let out = &changes.out;
        let has_changes = !enter.is_empty() || !leave.is_empty();
        self.matrix.leave(out)?;
        self.ghosts.extend(out);
        self.cut.retain(|node| !out.contains(node));
        self.matrix.remove(leave)?;
        let gone: HashSet<u32> = leave.iter().copied().collect();
        self.cut.retain(|node| !gone.contains(node));
        match self.add(world.nodes(), enter) {
            Ok(()) => (step.entered, step.left) = (enter.len(), leave.len() + out.len()),
            Err(error @ Error::Singular { patch }) => {
                let back: Vec<u32> = enter.iter().copied().filter(|&one| self.matrix.slot(one).is_some()).collect();
                self.matrix.remove(&back)?;
                self.cut.retain(|node| !back.contains(node));
                self.add(world.nodes(), leave)?;
                self.excluded.insert(patch);
                step.lost.push(error);
                step.left = out.len();
            }
            Err(error) => return Err(error),
        }
        let matrix = &self.matrix;
        self.ghosts.retain(|&ghost| matrix.has_ghost(ghost));
        let kept: HashSet<u32> = self.cut.iter().chain(&self.ghosts).copied().collect();
        // Rows that are there for the next steps stay, as long as they are few.
        let spare = self.rows.len() > kept.len() + self.settings.wanted;
        self.rows.retain(|node, _| kept.contains(node) || !(spare || gone.contains(node)));
        if has_changes || self.repair > 0 {
            let columns = self.repair.clamp(1, self.settings.changes);
            let residual = self.matrix.refresh(columns);
            self.repair = self.repair.saturating_sub(columns);
            if residual > self.settings.tolerance && self.repair == 0 {
                self.repair = self.settings.slots;
            }
            step.residual = Some(residual);
        }
        step.work = self.matrix.work() - before;
        Ok(step)
    }

    /// Borders the matrix with nodes whose rows are there.
    fn add(&mut self, nodes: &[Node], enter: &[u32]) -> Result<(), Error> {
        for some in enter.chunks(BATCH) {
            let mut all: Vec<u32> = self.cut.iter().chain(&self.ghosts).chain(some).copied().collect();
            all.sort_unstable_by_key(|&node| self.forest.run(node));
            // A ghost that comes back is there twice.
            all.dedup();
            let no_row = Row::new();
            let rows = assemble(some, &all, nodes, &self.forest, |node| &self.rows.get(&node).unwrap_or(&no_row)[..]);
            let mut entering: Vec<Entering> = Vec::with_capacity(some.len());
            for (&patch, factors) in some.iter().zip(&rows) {
                let Node { area, albedo, .. } = nodes[patch as usize];
                entering.push(Entering { patch, area, albedo, factors });
            }
            self.matrix.add(&entering)?;
            self.ghosts.retain(|ghost| !some.contains(ghost));
            self.cut.extend(some);
            let forest = &self.forest;
            self.cut.sort_unstable_by_key(|&node| forest.run(node));
        }
        Ok(())
    }

    /// [`Self::choose`] and [`Self::apply`].
    ///
    /// # Errors
    /// As [`Self::apply`].
    pub fn step(&mut self, world: &mut dyn World, view: View) -> Result<Step, Error> {
        let changes = self.choose(world, view);
        self.apply(world, changes)
    }

    /// Steps without a budget until the nodes are those that suit the camera: before the first frame. Each step waits
    /// until all rows of its choice are there, so that the result is the same however fast they come. `continues(done)`
    /// is told how many rows are there and says whether to go on. Returns the work.
    ///
    /// # Errors
    /// As [`Self::apply`]; [`Error::Cancelled`].
    pub fn settle(
        &mut self,
        world: &mut dyn World,
        view: View,
        continues: &dyn Fn(usize) -> bool,
    ) -> Result<Step, Error> {
        let mut whole = Step::default();
        let mut rounds = 0;
        loop {
            if !continues(self.rows.len().min(self.settings.slots)) {
                return Err(Error::Cancelled);
            }
            // In parts, so that one can see it go on.
            let mut changes = self.choose_some(world, view, self.settings.slots);
            let is_losing = !changes.lost.is_empty();
            whole.lost.append(&mut changes.lost);
            if changes.waiting > 0 {
                // Lost ones are left out of the next choice.
                if !is_losing {
                    pause();
                }
                continue;
            }
            let is_done = changes.is_empty();
            let step = self.apply(world, changes)?;
            let has_lost = !step.lost.is_empty();
            whole = step.after(whole);
            // Hysteresis has a cut stay as it is; should two alternate nevertheless, either will do.
            rounds += 1;
            if (is_done && !has_lost) || rounds > MAX_ROUNDS {
                return Ok(whole);
            }
        }
    }

    /// Irradiance of the leaves from their exitance, W/m², both in the leaves' order; `is_seen` of the nodes says which
    /// are of any use, the others get nothing. No light comes to leaves that nothing stands for. Returns how many nodes
    /// are lit.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless both have one element a leaf.
    pub fn product(
        &self,
        exitance: &[Vec4],
        irradiance: &mut [Vec4],
        is_seen: impl Fn(u32) -> bool,
    ) -> Result<usize, Error> {
        for (name, found) in [("exitance", exitance.len()), ("irradiance", irradiance.len())] {
            if found != self.leaf_area.len() {
                return Err(transport::Error::Length { name, expected: self.leaf_area.len(), found }.into());
            }
        }
        let (slot_of, runs) = self.places();
        let light: Vec<Vec4> = runs.par_iter().map(|run| mean(run[0], run[1], &self.leaf_area, exitance)).collect();
        let (at_slots, lit) = self.slot_product(&light, is_seen)?;
        irradiance.par_iter_mut().zip(&slot_of).for_each(|(h, &slot)| *h = spread(slot, &at_slots));
        Ok(lit)
    }

    /// As [`Self::product`], from the exitance of each slot to its irradiance, W/m², `[M]`, where the light of leaves
    /// is that of their node.
    ///
    /// # Errors
    /// [`transport::Error::Length`] unless there is one element a slot.
    pub fn slot_product(&self, exitance: &[Vec4], is_seen: impl Fn(u32) -> bool) -> Result<(Vec<Vec4>, usize), Error> {
        let visible: Vec<u32> =
            self.matrix.patches().filter(|&(_, node)| is_seen(node)).map(|(slot, _)| slot).collect();
        let lit: Vec<u32> = (0..).zip(exitance).filter(|&(_, light)| is_some(*light)).map(|(slot, _)| slot).collect();
        let mut irradiance = vec![Vec4::ZERO; exitance.len()];
        self.matrix.product(&visible, &lit, exitance, &mut irradiance)?;
        Ok((irradiance, lit.len()))
    }

    /// A frame: a step, and the irradiance of the leaves from their exitance, W/m², both in the leaves' order. What the
    /// step changes of the light is not there at once: it comes over the next frames, whatever the lights do in the
    /// meantime.
    ///
    /// # Errors
    /// As [`Self::apply`] and [`Self::product`].
    pub fn frame(
        &mut self,
        world: &mut dyn World,
        view: View,
        exitance: &[Vec4],
        irradiance: &mut [Vec4],
        is_seen: impl Fn(u32) -> bool + Copy,
    ) -> Result<Step, Error> {
        let changes = self.choose(world, view);
        let mut before = Vec::new();
        if !changes.is_empty() && !self.cut.is_empty() {
            before = vec![Vec4::ZERO; irradiance.len()];
            self.product(exitance, &mut before, is_seen)?;
        }
        let step = self.apply(world, changes)?;
        self.product(exitance, irradiance, is_seen)?;
        self.fade(&before, irradiance);
        Ok(step)
    }

    /// Adds to the irradiance of the leaves what is left of the jumps that changes of the matrix made: `before` is the
    /// irradiance of the same exitance before the changes of this frame, or empty where there were none.
    pub fn fade(&mut self, before: &[Vec4], irradiance: &mut [Vec4]) {
        let params = self.fade_params(!before.is_empty());
        self.offset.resize(self.leaf_area.len(), Vec4::ZERO);
        self.offset.par_iter_mut().zip(irradiance.par_iter_mut()).enumerate().for_each(|(i, (offset, h))| {
            *offset = fade(*offset, before.get(i).copied().unwrap_or(*h), *h, &params);
            *h += *offset;
        });
    }

    /// Parameters of fading jumps of the light; `has_jump` where the matrix has changed.
    pub fn fade_params(&self, has_jump: bool) -> FadeParams {
        let keep = 1.0 - 1.0 / self.settings.fade as f32;
        let display_white = self.settings.display_white;
        FadeParams { count: self.leaf_area.len() as u32, keep, has_jump: u32::from(has_jump), display_white }
    }
}
