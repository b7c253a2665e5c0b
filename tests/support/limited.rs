//! An executor whose device says that a binding shows few bytes, and that counts the bytes that are read back.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use runtime::executor::{DeviceInfo, Executor, ExecutorError, PassTime, ReadId};
use runtime::plan::{BufferId, PassId, Plan};
use runtime::recipe::Table;

/// Runs plans as another executor does, and names a smaller limit.
pub struct Limited {
    inner: Box<dyn Executor>,
    info: DeviceInfo,
    downloaded: Arc<AtomicUsize>,
}

impl Limited {
    /// An executor with bindings of so many bytes.
    pub fn new(inner: Box<dyn Executor>, max_storage_buffer_range: u64) -> Self {
        let info = DeviceInfo { max_storage_buffer_range, ..inner.device().clone() };
        Self { inner, info, downloaded: Arc::default() }
    }

    /// Bytes that were read back so far.
    pub fn downloaded(&self) -> Arc<AtomicUsize> {
        Arc::clone(&self.downloaded)
    }
}

impl Executor for Limited {
    fn device(&self) -> &DeviceInfo {
        &self.info
    }

    fn load(&mut self, plan: Plan) -> Result<(), ExecutorError> {
        self.inner.load(plan)
    }

    fn load_after(&mut self, plan: Plan, section: usize) -> Result<(), ExecutorError> {
        self.inner.load_after(plan, section)
    }

    fn plan(&self) -> &Plan {
        self.inner.plan()
    }

    fn upload_at(&mut self, buffer: BufferId, offset: u64, bytes: &[u8]) -> Result<(), ExecutorError> {
        self.inner.upload_at(buffer, offset, bytes)
    }

    fn share(&mut self, buffer: BufferId, table: Arc<dyn Table>) -> Result<(), ExecutorError> {
        self.inner.share(buffer, table)
    }

    fn clear(&mut self, buffer: BufferId) -> Result<(), ExecutorError> {
        self.inner.clear(buffer)
    }

    fn set_push(&mut self, pass: PassId, push: &[u8]) -> Result<(), ExecutorError> {
        self.inner.set_push(pass, push)
    }

    fn run_passes(&mut self, passes: &[PassId]) -> Result<Vec<PassTime>, ExecutorError> {
        self.inner.run_passes(passes)
    }

    fn submit_passes(&mut self, passes: &[PassId]) -> Result<(), ExecutorError> {
        self.inner.submit_passes(passes)
    }

    fn wait(&mut self) -> Result<Vec<PassTime>, ExecutorError> {
        self.inner.wait()
    }

    fn finished_times(&mut self) -> Result<Vec<PassTime>, ExecutorError> {
        self.inner.finished_times()
    }

    fn download(&mut self, buffer: BufferId) -> Result<Vec<u8>, ExecutorError> {
        let bytes = self.inner.download(buffer)?;
        self.downloaded.fetch_add(bytes.len(), Ordering::Relaxed);
        Ok(bytes)
    }

    fn begin_read(&mut self, buffer: BufferId) -> Result<ReadId, ExecutorError> {
        self.inner.begin_read(buffer)
    }

    fn try_read(&mut self, read: ReadId) -> Result<Option<Vec<u8>>, ExecutorError> {
        let bytes = self.inner.try_read(read)?;
        self.downloaded.fetch_add(bytes.as_ref().map_or(0, Vec::len), Ordering::Relaxed);
        Ok(bytes)
    }

    fn is_recording(&self) -> bool {
        self.inner.is_recording()
    }
}
