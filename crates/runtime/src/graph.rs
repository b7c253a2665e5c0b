//! Consequences of a plan: buffers that share memory, barriers, and a check that every read has a value.

use std::fmt::Write as _;

use crate::plan::{Bound, BufferId, BufferKind, PassId, Plan, PlanError, check_push};

/// Memory that one storage buffer or picture, or several scratch buffers of separate lifetimes, lie in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// The buffer, the largest one where several share.
    pub buffer: BufferId,
    /// Size; never 0.
    pub bytes: u64,
}

/// Passes of one name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stage {
    /// Their name.
    pub name: String,
    /// Number of passes.
    pub passes: usize,
    /// Numbers of the stages whose results it reads.
    pub reads: Vec<usize>,
}

/// A plan with what is derived from it, and what is known of its buffers' contents.
#[derive(Debug, Default)]
pub struct Graph {
    plan: Plan,
    slots: Vec<Slot>,
    slot_of: Vec<usize>,
    written: Vec<bool>,
}

/// Bytes that an empty storage buffer really has: room for one element of any table.
const EMPTY_BYTES: u64 = 256;

impl Graph {
    /// Derives the slots of a plan, section by section: those of a section follow from it alone.
    pub fn new(plan: Plan) -> Self {
        let mut graph = Self { slot_of: vec![0; plan.buffers().len()], ..Self::default() };
        for section in 0..plan.section_count() {
            let start = plan.section_start(section);
            let end = plan.section_start(section + 1);
            // Passes of later sections change nothing of the slots here.
            let lifetimes = lifetimes_within(&plan, start.passes..end.passes);
            graph.add_slots(&plan, &lifetimes, start.buffers..end.buffers);
        }
        graph.written = plan.buffers().iter().map(|b| b.bytes == 0).collect();
        graph.plan = plan;
        graph
    }

    /// The graph of a plan that begins as this one's does: what is before `section` keeps its slots, its push constants
    /// and what is known of its contents.
    ///
    /// # Errors
    /// [`PlanError::OtherSections`].
    pub fn replaced_after(&self, mut plan: Plan, section: usize) -> Result<Self, PlanError> {
        plan.keep_passes(&self.plan, section)?;
        let kept = plan.section_start(section).buffers;
        let mut graph = Self::new(plan);
        graph.written[..kept].copy_from_slice(&self.written[..kept]);
        Ok(graph)
    }

    /// Number of slots of the buffers before a section.
    pub fn slots_before(&self, section: usize) -> usize {
        let buffers = self.plan.section_start(section).buffers;
        self.slot_of[..buffers].iter().max().map_or(0, |last| last + 1)
    }

    /// Gives slots to the buffers of a section. Scratch buffers, in order of their first use, take the first slot of
    /// the section that is free again.
    fn add_slots(&mut self, plan: &Plan, lifetimes: &[Option<(usize, usize)>], buffers: std::ops::Range<usize>) {
        let first_slot = self.slots.len();
        let mut order: Vec<usize> = buffers.collect();
        order.sort_by_key(|&k| lifetimes[k].map_or(0, |(first, _)| first));
        let mut busy_until: Vec<Option<usize>> = Vec::new();
        for k in order {
            let spec = &plan.buffers()[k];
            let bytes = if spec.bytes == 0 { EMPTY_BYTES } else { spec.bytes };
            let scratch = spec.kind == BufferKind::Scratch;
            let (first, last) = lifetimes[k].unwrap_or((0, 0));
            let free = busy_until.iter().position(|end| scratch && end.is_some_and(|end| end < first));
            let of_section = free.unwrap_or_else(|| {
                self.slots.push(Slot { buffer: BufferId(k), bytes: 0 });
                busy_until.push(None);
                busy_until.len() - 1
            });
            let slot = first_slot + of_section;
            if bytes > self.slots[slot].bytes {
                self.slots[slot] = Slot { buffer: BufferId(k), bytes };
            }
            busy_until[of_section] = scratch.then_some(last);
            self.slot_of[k] = slot;
        }
    }

    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Memory to allocate.
    pub fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// Slot of a buffer.
    pub fn slot_of(&self, buffer: BufferId) -> usize {
        self.slot_of[buffer.0]
    }

    /// Replaces a pass's push constants.
    ///
    /// # Errors
    /// Wrong length, unknown pass.
    pub fn set_push(&mut self, pass: PassId, push: &[u8]) -> Result<(), PlanError> {
        let pass = self.plan.pass_mut(pass)?;
        check_push(&pass.name, pass.kernel, push)?;
        pass.push.copy_from_slice(push);
        pass.invocations = pass.kernel.invocations(push).unwrap_or(0);
        Ok(())
    }

    /// Checks an upload of `length` bytes at `offset` and notes that the buffer has contents.
    ///
    /// # Errors
    /// Unknown or scratch buffer, bytes that do not fit; a picture takes all its bytes at once.
    pub fn note_upload(&mut self, id: BufferId, offset: u64, length: u64) -> Result<(), PlanError> {
        let spec = self.plan.buffer(id)?;
        let whole = offset == 0 && length == spec.bytes;
        let fits = match spec.kind {
            BufferKind::Scratch => return Err(PlanError::Scratch { buffer: spec.name.clone() }),
            BufferKind::Image { .. } => whole,
            BufferKind::Storage => offset.checked_add(length).is_some_and(|end| end <= spec.bytes),
        };
        if !fits {
            let buffer = spec.name.clone();
            let size = spec.bytes;
            return Err(PlanError::UploadLength { buffer, size, offset, found: length });
        }
        self.written[id.0] = true;
        Ok(())
    }

    /// Checks that a buffer may be filled with zeros and notes that it has contents.
    ///
    /// # Errors
    /// Unknown or scratch buffer.
    pub fn note_clear(&mut self, id: BufferId) -> Result<(), PlanError> {
        self.check_download(id)?;
        self.written[id.0] = true;
        Ok(())
    }

    /// Checks that a buffer may be downloaded; gives its size.
    ///
    /// # Errors
    /// Unknown or scratch buffer.
    pub fn check_download(&self, id: BufferId) -> Result<u64, PlanError> {
        let spec = self.plan.buffer(id)?;
        match spec.kind {
            BufferKind::Scratch => Err(PlanError::Scratch { buffer: spec.name.clone() }),
            _ => Ok(spec.bytes),
        }
    }

    /// Checks that each pass of a run finds contents in what it reads, and notes what the run writes.
    ///
    /// # Errors
    /// Unknown pass; a buffer that nothing was uploaded to and no earlier pass has written. Contents stay as they were
    /// noted.
    pub fn note_run(&mut self, passes: &[PassId]) -> Result<(), PlanError> {
        let mut written = self.written.clone();
        for id in passes {
            let count = self.plan.passes().len();
            let pass = self.plan.passes().get(id.0).ok_or(PlanError::Unknown { what: "pass", index: id.0, count })?;
            for bound in pass.bound.iter().filter(|b| b.reads) {
                if !written[bound.buffer.0] {
                    let buffer = self.plan.buffers()[bound.buffer.0].name.clone();
                    return Err(PlanError::NeverWritten { pass: pass.name.clone(), buffer });
                }
            }
            for bound in pass.bound.iter().filter(|b| b.writes) {
                for (other, slot) in self.slot_of.iter().enumerate() {
                    if *slot == self.slot_of[bound.buffer.0] {
                        written[other] = other == bound.buffer.0;
                    }
                }
            }
        }
        // Scratch ends with the frame.
        for (k, spec) in self.plan.buffers().iter().enumerate() {
            self.written[k] = written[k] && spec.kind != BufferKind::Scratch;
        }
        Ok(())
    }

    /// For each pass of a run whether it must wait for those before it: because it reads what they write, or writes
    /// what they read or write. Passes without a barrier between them may overlap.
    pub fn barriers(&self, passes: &[PassId]) -> Vec<bool> {
        let mut open: Vec<(usize, Bound)> = Vec::new();
        passes
            .iter()
            .map(|id| {
                let bound = &self.plan.passes()[id.0].bound;
                let waits = bound.iter().any(|b| {
                    open.iter().any(|(slot, a)| {
                        *slot == self.slot_of[b.buffer.0]
                            && (a.writes || b.writes)
                            && (a.buffer != b.buffer || a.overlaps(b))
                    })
                });
                if waits {
                    open.clear();
                }
                open.extend(bound.iter().map(|b| (self.slot_of[b.buffer.0], *b)));
                waits
            })
            .collect()
    }

    /// Passes of the same name as stages, in the order of their first passes, and between which light goes on.
    pub fn stages(&self) -> Vec<Stage> {
        let mut stages: Vec<Stage> = Vec::new();
        // The stage that wrote each buffer last.
        let mut writers: Vec<Option<usize>> = vec![None; self.plan.buffers().len()];
        for pass in self.plan.passes() {
            let number = stages.iter().position(|stage| stage.name == pass.name).unwrap_or_else(|| {
                stages.push(Stage { name: pass.name.clone(), passes: 0, reads: Vec::new() });
                stages.len() - 1
            });
            stages[number].passes += 1;
            for bound in pass.bound.iter().filter(|bound| bound.reads) {
                let from = writers[bound.buffer.0].filter(|&from| from != number);
                if let Some(from) = from.filter(|from| !stages[number].reads.contains(from)) {
                    stages[number].reads.push(from);
                }
            }
            for bound in pass.bound.iter().filter(|bound| bound.writes) {
                writers[bound.buffer.0] = Some(number);
            }
        }
        stages
    }

    /// The frame graph in Graphviz' language: passes as boxes in their order, with the milliseconds that are known of
    /// all passes of that name together, buffers as ellipses with size and lifetime, reads and writes as arrows, a
    /// dashed arrow where a pass waits at a barrier.
    pub fn graphviz(&self, milliseconds: impl Fn(&str) -> Option<f64>) -> String {
        let mut text = String::from("digraph frame {\n  rankdir = LR;\n  node [fontname = \"sans-serif\"];\n");
        let lifetimes = lifetimes(&self.plan);
        let quote = |name: &str| name.replace('\\', "\\\\").replace('"', "\\\"");
        // Writing to a String cannot fail.
        for (k, spec) in self.plan.buffers().iter().enumerate() {
            let life = match lifetimes[k] {
                Some((first, last)) => format!("passes {first} to {last}"),
                None => "unused".into(),
            };
            let style = if spec.kind == BufferKind::Scratch { "dotted" } else { "solid" };
            let _ = writeln!(
                text,
                "  b{k} [label = \"{}\\n{} bytes, {life}\", style = {style}];",
                quote(&spec.name),
                spec.bytes
            );
        }
        let barriers = self.barriers(&self.plan.all_passes());
        for (k, pass) in self.plan.passes().iter().enumerate() {
            let _ = writeln!(
                text,
                "  p{k} [shape = box, label = \"{k}: {}{}\\n{}, {} invocations\"];",
                quote(&pass.name),
                milliseconds(&pass.name).map(|ms| format!(", {ms:.3} ms in all")).unwrap_or_default(),
                pass.kernel.name,
                pass.invocations
            );
            for bound in &pass.bound {
                let b = bound.buffer.0;
                if bound.reads {
                    let _ = writeln!(text, "  b{b} -> p{k};");
                }
                if bound.writes {
                    let _ = writeln!(text, "  p{k} -> b{b};");
                }
            }
            if k > 0 && barriers[k] {
                let _ = writeln!(text, "  p{} -> p{k} [style = dashed, label = \"barrier\"];", k - 1);
            }
        }
        text.push_str("}\n");
        text
    }
}

/// First and last pass that binds each buffer.
pub fn lifetimes(plan: &Plan) -> Vec<Option<(usize, usize)>> {
    lifetimes_within(plan, 0..plan.passes().len())
}

/// As [`lifetimes`], of some passes.
fn lifetimes_within(plan: &Plan, passes: std::ops::Range<usize>) -> Vec<Option<(usize, usize)>> {
    let mut lifetimes = vec![None; plan.buffers().len()];
    for (k, pass) in plan.passes().iter().enumerate().take(passes.end).skip(passes.start) {
        for bound in &pass.bound {
            let life: &mut Option<(usize, usize)> = &mut lifetimes[bound.buffer.0];
            *life = Some((life.map_or(k, |(first, _)| first), k));
        }
    }
    lifetimes
}
