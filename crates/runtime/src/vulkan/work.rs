//! A run of passes as commands.

use ash::vk;

use super::commands::{Commands, Scope};
use super::resource::Resource;
use super::sets::Sets;
use super::staging::Staging;
use crate::graph::Graph;
use crate::plan::PassId;

/// Recorded work: uploads and clears, then passes.
pub(super) struct Work<'a> {
    pub graph: &'a Graph,
    pub sets: Option<&'a Sets>,
    pub resources: &'a [Resource],
    pub passes: &'a [PassId],
}

impl Work<'_> {
    /// Records the changes that wait in `staging`, then the passes. With `queries` a timestamp is written before the
    /// first pass and one after each.
    pub fn record(&self, commands: &Commands<'_>, staging: &mut Staging, queries: Option<vk::QueryPool>) {
        staging.record(commands, self.resources);
        let Some(sets) = self.sets else { return };
        if let Some(pool) = queries {
            commands.reset_queries(pool, self.passes.len() as u32 + 1);
            commands.timestamp(pool, 0);
        }
        let barriers = self.graph.barriers(self.passes);
        for (k, (id, waits)) in self.passes.iter().zip(barriers).enumerate() {
            if waits {
                commands.barrier(Scope::SHADER_WRITES, Scope::SHADER);
            }
            let (set, pipeline) = sets.of_pass(id.0);
            let pass = &self.graph.plan().passes()[id.0];
            commands.begin_label(pass);
            commands.dispatch(pass, pipeline, set);
            commands.end_label();
            if let Some(pool) = queries {
                commands.timestamp(pool, k as u32 + 1);
            }
        }
    }
}
