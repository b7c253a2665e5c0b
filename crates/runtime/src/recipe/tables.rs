//! Tables that stay on the device from frame to frame.

use std::any::Any;
use std::sync::Arc;

use bytemuck::{Pod, cast_slice};

use crate::executor::{Executor, ExecutorError};
use crate::plan::{BufferId, Plan, Slice};

/// Bytes that an executor may keep instead of a copy of its own.
pub trait Table: Send + Sync {
    /// The bytes, always the same ones.
    fn bytes(&self) -> &[u8];

    /// Owner of the bytes, for native code that can use it.
    fn owner(&self) -> Option<&(dyn Any + Send + Sync)> {
        None
    }
}

impl<T: Pod + Send + Sync> Table for Vec<T> {
    fn bytes(&self) -> &[u8] {
        cast_slice(self)
    }
}

/// A table that is a part of something shared.
struct Part<O, T> {
    owner: Arc<O>,
    part: fn(&O) -> &[T],
}

impl<O: Send + Sync + 'static, T: Pod> Table for Part<O, T> {
    fn bytes(&self) -> &[u8] {
        cast_slice((self.part)(&self.owner))
    }

    fn owner(&self) -> Option<&(dyn Any + Send + Sync)> {
        Some(&*self.owner)
    }
}

/// A table that is a part of something shared, for [`Executor::share`].
pub fn part_of<O: Send + Sync + 'static, T: Pod>(owner: &Arc<O>, part: fn(&O) -> &[T]) -> Arc<dyn Table> {
    Arc::new(Part { owner: Arc::clone(owner), part })
}

/// The tables of a plan, and the buffers that they go into.
#[derive(Default)]
pub struct Tables {
    contents: Vec<(BufferId, Arc<dyn Table>)>,
}

impl Tables {
    /// No tables yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// A table that is a part of something shared, which the executor may read in place.
    pub fn part<O: Send + Sync + 'static, T: Pod>(
        &mut self,
        plan: &mut Plan,
        name: &str,
        owner: &Arc<O>,
        part: fn(&O) -> &[T],
    ) -> Slice<T> {
        self.add(plan, name, part_of(owner, part)).of()
    }

    /// A table that belongs to the plan alone.
    pub fn owned<T: Pod + Send + Sync>(&mut self, plan: &mut Plan, name: &str, table: Vec<T>) -> Slice<T> {
        self.add(plan, name, Arc::new(table)).of()
    }

    /// Any table.
    pub fn add(&mut self, plan: &mut Plan, name: &str, table: Arc<dyn Table>) -> BufferId {
        let buffer = plan.storage(name, table.bytes().len() as u64);
        self.fill(buffer, table);
        buffer
    }

    /// The contents of a buffer that is in the plan already, such as an image.
    pub fn fill(&mut self, buffer: BufferId, table: Arc<dyn Table>) {
        if !table.bytes().is_empty() {
            self.contents.push((buffer, table));
        }
    }

    /// Puts all tables into their buffers, once the plan is loaded.
    ///
    /// # Errors
    /// What the device says.
    pub fn upload(self, executor: &mut dyn Executor) -> Result<(), ExecutorError> {
        for (buffer, table) in self.contents {
            executor.share(buffer, table)?;
        }
        Ok(())
    }
}
