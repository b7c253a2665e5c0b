//! Who runs a plan: [`Executor`], implemented by [`Cpu`] and [`Vulkan`] with the same results.

use std::convert::Infallible;
use std::fmt;
use std::ops::Range;
use std::str::FromStr;
use std::sync::Arc;

use bytemuck::Pod;
use gpu_kernels::host::HostError;

use crate::cpu::Cpu;
use crate::plan::{BufferId, Pass, PassId, Plan, PlanError, Slice};
use crate::recipe::Table;
#[cfg(feature = "vulkan")]
use crate::vulkan::{self, Validation, Vulkan};

/// Why a device could not be opened or a plan could not be run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExecutorError {
    /// A mistake in a plan or in its use.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// Vulkan, its driver or the device.
    #[cfg(feature = "vulkan")]
    #[error(transparent)]
    Vulkan(#[from] vulkan::Error),
    /// A Vulkan device, in a program that was built without.
    #[error("{wanted} is a Vulkan device, and this program was built without the feature `vulkan`; choose the CPU")]
    WithoutVulkan {
        /// Requested device.
        wanted: String,
    },
    /// Main memory does not suffice.
    #[error("`{buffer}`, {bytes} bytes, does not fit into main memory; choose fewer patches or a smaller picture")]
    OutOfMemory {
        /// The buffer.
        buffer: String,
        /// Its size.
        bytes: u64,
    },
    /// The host form of a kernel refuses its call.
    #[error("pass `{pass}`: {source}")]
    Host {
        /// The pass.
        pass: String,
        /// Why.
        source: HostError,
    },
    /// A buffer's bytes are not a whole number of the elements asked for.
    #[error("`{buffer}` has {bytes} bytes, not a multiple of {stride}")]
    ElementSize {
        /// The buffer.
        buffer: String,
        /// Its size.
        bytes: u64,
        /// Bytes of an element.
        stride: usize,
    },
}

impl ExecutorError {
    /// Returns true if memory of the device, or main memory, does not suffice.
    pub fn is_out_of_memory(&self) -> bool {
        match self {
            Self::OutOfMemory { .. } => true,
            #[cfg(feature = "vulkan")]
            Self::Vulkan(vulkan::Error::OutOfMemory { .. }) => true,
            _ => false,
        }
    }
}

/// Kind of machine that runs the kernels, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DeviceKind {
    /// A graphics card with its own memory.
    Discrete,
    /// Graphics in the processor.
    Integrated,
    /// A part of a graphics card in a virtual machine.
    Virtual,
    /// Vulkan emulated by the processor (lavapipe).
    EmulatedOnCpu,
    /// Something else that speaks Vulkan.
    Other,
    /// The processor itself, no Vulkan.
    Native,
}

impl fmt::Display for DeviceKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Discrete => "discrete",
            Self::Integrated => "integrated",
            Self::Virtual => "virtual",
            Self::EmulatedOnCpu => "Vulkan on the CPU",
            Self::Other => "other",
            Self::Native => "native code",
        })
    }
}

/// A device with the limits that shape plans.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceInfo {
    /// Name as the driver gives it.
    pub name: String,
    /// Kind of machine.
    pub kind: DeviceKind,
    /// Its number in the list of devices, for [`DeviceChoice::Index`]; `None` for native code and for a caller's
    /// device.
    pub index: Option<usize>,
    /// Name and version of the driver.
    pub driver: String,
    /// Vulkan version, empty for native code.
    pub api_version: String,
    /// Device memory, 0 if unknown.
    pub memory_bytes: u64,
    /// Greatest range of a buffer that one binding may show; larger matrices are bound in blocks of rows.
    pub max_storage_buffer_range: u64,
    /// Greatest width and height of a picture.
    pub max_image_edge: u32,
    /// True if pictures of texture blocks (BC1 to BC7) can be fetched from.
    pub has_block_images: bool,
    /// Memory that a workgroup shares.
    pub shared_memory_bytes: u32,
    /// Invocations of a subgroup, 1 for native code.
    pub subgroup_size: u32,
    /// True if the device measures each pass itself; otherwise the host's clock does.
    pub has_timestamps: bool,
    /// A missing feature that every kernel needs; such a device is listed but not opened.
    pub missing_feature: Option<&'static str>,
    /// True if the validation layer watches.
    pub has_validation: bool,
}

/// Which device is to run the kernels.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub enum DeviceChoice {
    /// The best Vulkan device that is not the processor, else native code.
    #[default]
    Auto,
    /// Native code.
    Cpu,
    /// The best Vulkan device of any kind.
    Vulkan,
    /// The best Vulkan device of a kind: `discrete`, `integrated`, `virtual`.
    Kind(DeviceKind),
    /// The Vulkan device with this number in the list.
    Index(usize),
    /// The best Vulkan device whose name contains this, in any case of letters.
    Name(String),
}

impl DeviceChoice {
    /// Reads `auto`, `cpu`, `vulkan`, `discrete`, `integrated`, `virtual`, a number, or else a part of a name.
    pub fn parse(text: &str) -> Self {
        match text.trim().to_lowercase().as_str() {
            "" | "auto" => Self::Auto,
            "cpu" => Self::Cpu,
            "vulkan" => Self::Vulkan,
            "discrete" => Self::Kind(DeviceKind::Discrete),
            "integrated" => Self::Kind(DeviceKind::Integrated),
            "virtual" => Self::Kind(DeviceKind::Virtual),
            other => other.parse().map_or_else(|_| Self::Name(text.trim().to_owned()), Self::Index),
        }
    }

    /// Returns true if a Vulkan device answers to the choice.
    pub fn admits(&self, device: &DeviceInfo) -> bool {
        match self {
            Self::Auto => device.kind < DeviceKind::EmulatedOnCpu,
            Self::Cpu => device.kind == DeviceKind::Native,
            Self::Vulkan => device.kind != DeviceKind::Native,
            Self::Kind(kind) => device.kind == *kind,
            Self::Index(index) => device.index == Some(*index),
            Self::Name(name) => {
                device.kind != DeviceKind::Native && device.name.to_lowercase().contains(&name.to_lowercase())
            }
        }
    }
}

impl FromStr for DeviceChoice {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self::parse(text))
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Vulkan => f.write_str("vulkan"),
            Self::Kind(kind) => kind.fmt(f),
            Self::Index(index) => index.fmt(f),
            Self::Name(name) => f.write_str(name),
        }
    }
}

/// Time of a pass, or of work of the host that stands for one.
#[derive(Clone, Debug, PartialEq)]
pub struct PassTime {
    /// Name of the pass.
    pub name: String,
    /// Name of its kernel; `host` for work of the host.
    pub kernel: &'static str,
    /// By the device's own clock where it has one. Passes that overlap share their time: the sum is that of the run.
    pub milliseconds: f64,
}

impl PassTime {
    /// Time of work of the host.
    pub fn of_host(name: impl Into<String>, milliseconds: f64) -> Self {
        Self { name: name.into(), kernel: "host", milliseconds }
    }

    pub(crate) fn of_pass(pass: &Pass, milliseconds: f64) -> Self {
        Self { name: pass.name.clone(), kernel: pass.kernel.name, milliseconds }
    }
}

/// A read that was begun with [`Executor::begin_read`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ReadId(pub(crate) u64);

/// Submissions whose times are kept for a caller that does not ask; older ones are dropped.
pub(crate) const KEPT_TIMES: usize = 64;

/// Runs plans. Buffers stay on the device from frame to frame: load once, then for each frame upload what changed, set
/// push constants, run, download what is wanted.
///
/// Two ways to run: [`Executor::run_passes`] waits and gives times; [`Executor::submit_passes`] does not wait, so that
/// the host prepares the next frame while the device is at work on this one. Native code does both at once.
pub trait Executor: Send {
    /// Device that runs the kernels.
    fn device(&self) -> &DeviceInfo;

    /// Makes the buffers of a plan, all zeros, and prepares its passes; the plan before it and its buffers go.
    ///
    /// # Errors
    /// Out of memory; a buffer or pass that exceeds a limit of the device. No plan is loaded then.
    fn load(&mut self, plan: Plan) -> Result<(), ExecutorError>;

    /// Replaces the loaded plan from `section` on by what `plan` has there; `plan` begins as the loaded one does. What
    /// is before the section stays as it is: buffers, contents, push constants. Waits for everything submitted.
    ///
    /// # Errors
    /// [`PlanError::OtherSections`], and nothing changes; as [`Executor::load`], and only what is before the section
    /// stays loaded.
    fn load_after(&mut self, plan: Plan, section: usize) -> Result<(), ExecutorError>;

    /// The loaded plan.
    fn plan(&self) -> &Plan;

    /// Puts bytes into a buffer from `offset` on; a picture takes all its bytes at once. Passes already submitted still
    /// see the bytes before. Nothing is waited for, unless the staging memory of all submissions in flight is full: 16
    /// MiB each.
    ///
    /// # Errors
    /// Bytes that do not fit, a scratch buffer, an unknown buffer; what the device says.
    fn upload_at(&mut self, buffer: BufferId, offset: u64, bytes: &[u8]) -> Result<(), ExecutorError>;

    /// Puts a table that never changes into a whole buffer. Executors that read main memory may keep it in place of a
    /// copy until something is written to the buffer.
    ///
    /// # Errors
    /// As [`Executor::upload_at`].
    fn share(&mut self, buffer: BufferId, table: Arc<dyn Table>) -> Result<(), ExecutorError> {
        self.upload_at(buffer, 0, table.bytes())
    }

    /// [`Self::share`] of a table of which only these bytes differ from what the buffer holds.
    ///
    /// # Errors
    /// As [`Self::share`].
    fn share_changed(
        &mut self,
        buffer: BufferId,
        table: Arc<dyn Table>,
        changed: &[Range<usize>],
    ) -> Result<(), ExecutorError> {
        let mut bytes = changed.iter().filter(|range| !range.is_empty());
        bytes.try_for_each(|range| self.upload_at(buffer, range.start as u64, &table.bytes()[range.clone()]))
    }

    /// Fills a buffer or a picture with zeros, in the order of the uploads. No bytes are transferred, but for pictures
    /// of texture blocks.
    ///
    /// # Errors
    /// A scratch buffer, an unknown buffer; what the device says.
    fn clear(&mut self, buffer: BufferId) -> Result<(), ExecutorError>;

    /// Replaces a pass's push constants, and with them its number of invocations, from the next run on; passes already
    /// submitted keep theirs.
    ///
    /// # Errors
    /// Wrong length, unknown pass; more workgroups than the device takes.
    fn set_push(&mut self, pass: PassId, push: &[u8]) -> Result<(), ExecutorError>;

    /// Runs passes in the order given and waits for them.
    ///
    /// # Errors
    /// A pass that reads what nothing was put into; what the device says.
    fn run_passes(&mut self, passes: &[PassId]) -> Result<Vec<PassTime>, ExecutorError>;

    /// Submits the uploads so far and passes in the order given, after everything submitted before. Nothing is waited
    /// for, unless as many submissions are in flight as the executor allows: then for the oldest one.
    ///
    /// # Errors
    /// As [`Executor::run_passes`].
    fn submit_passes(&mut self, passes: &[PassId]) -> Result<(), ExecutorError>;

    /// Waits for everything submitted; gives the times of the submitted passes that finished since times were last
    /// asked for, in their order. Empty on a Vulkan device without timestamps.
    ///
    /// # Errors
    /// What the device says.
    fn wait(&mut self) -> Result<Vec<PassTime>, ExecutorError>;

    /// As [`Executor::wait`], without waiting: the times of submissions that have finished.
    ///
    /// # Errors
    /// What the device says.
    fn finished_times(&mut self) -> Result<Vec<PassTime>, ExecutorError>;

    /// All bytes of a buffer, after everything submitted before. Waits.
    ///
    /// # Errors
    /// A scratch buffer, an unknown buffer; what the device says.
    fn download(&mut self, buffer: BufferId) -> Result<Vec<u8>, ExecutorError>;

    /// Begins to copy a buffer to the host, after everything submitted before; nothing is waited for.
    ///
    /// # Errors
    /// As [`Executor::download`]; a caller's command buffer is being recorded.
    fn begin_read(&mut self, buffer: BufferId) -> Result<ReadId, ExecutorError>;

    /// The bytes of a read, once and as soon as they have arrived; `None` before, and for a read that gave its bytes.
    ///
    /// # Errors
    /// What the device says.
    fn try_read(&mut self, read: ReadId) -> Result<Option<Vec<u8>>, ExecutorError>;

    /// Returns true while a caller's command buffer is being recorded: nothing can be read then.
    fn is_recording(&self) -> bool {
        false
    }

    /// The Vulkan executor, if it is one: to record into a caller's command buffer and to hand out device buffers.
    #[cfg(feature = "vulkan")]
    fn as_vulkan(&mut self) -> Option<&mut Vulkan> {
        None
    }

    /// Runs the whole plan.
    ///
    /// # Errors
    /// As [`Executor::run_passes`].
    fn run(&mut self) -> Result<Vec<PassTime>, ExecutorError> {
        let passes = self.plan().all_passes();
        self.run_passes(&passes)
    }
}

impl dyn Executor + '_ {
    /// Puts a whole table into a buffer.
    ///
    /// # Errors
    /// As [`Executor::upload_at`].
    pub fn upload<T: Pod>(&mut self, buffer: impl Into<Slice<T>>, table: &[T]) -> Result<(), ExecutorError> {
        self.upload_at(buffer.into().buffer, 0, bytemuck::cast_slice(table))
    }

    /// A buffer as a table.
    ///
    /// # Errors
    /// As [`Executor::download`], and [`ExecutorError::ElementSize`].
    pub fn download_table<T: Pod>(&mut self, buffer: impl Into<Slice<T>>) -> Result<Vec<T>, ExecutorError> {
        let buffer = buffer.into().buffer;
        let bytes = self.download(buffer)?;
        if size_of::<T>() == 0 || !bytes.len().is_multiple_of(size_of::<T>()) {
            let name = self.plan().buffer(buffer)?.name.clone();
            return Err(ExecutorError::ElementSize { buffer: name, bytes: bytes.len() as u64, stride: size_of::<T>() });
        }
        Ok(bytemuck::pod_collect_to_vec(&bytes))
    }

    /// Replaces a pass's push constants.
    ///
    /// # Errors
    /// As [`Executor::set_push`].
    pub fn push<P: Pod>(&mut self, pass: PassId, push: &P) -> Result<(), ExecutorError> {
        self.set_push(pass, bytemuck::bytes_of(push))
    }
}

/// Opens the device that answers to the choice. `Auto` falls back to native code, with a note that says why.
///
/// # Errors
/// A device that was asked for and is not there, or lacks a feature.
pub fn open(choice: &DeviceChoice) -> Result<(Box<dyn Executor>, Option<String>), ExecutorError> {
    match choice {
        DeviceChoice::Cpu => Ok((Box::new(Cpu::new()), None)),
        #[cfg(feature = "vulkan")]
        _ => open_validated(choice, Validation::Off),
        #[cfg(not(feature = "vulkan"))]
        _ => without_vulkan(choice),
    }
}

/// [`open`], with the validation layer on a Vulkan device.
///
/// # Errors
/// As [`open`]; a layer that is required and is not there.
#[cfg(feature = "vulkan")]
pub fn open_validated(
    choice: &DeviceChoice,
    validation: Validation,
) -> Result<(Box<dyn Executor>, Option<String>), ExecutorError> {
    if *choice == DeviceChoice::Cpu {
        return open(choice);
    }
    let opened = Vulkan::open(choice, validation);
    if *choice != DeviceChoice::Auto {
        return Ok((Box::new(opened?), None));
    }
    let note = match opened {
        Ok(vulkan) => return Ok((Box::new(vulkan), None)),
        Err(vulkan::Error::UnknownDevice { available, .. }) => format!(
            "no graphics processor (Vulkan offers only {}): running as native code on the CPU",
            available.join(", ")
        ),
        Err(error @ vulkan::Error::NoValidationLayer) => return Err(error.into()),
        Err(error) => format!("{error}; running as native code on the CPU"),
    };
    Ok((Box::new(Cpu::new()), Some(note)))
}

#[cfg(not(feature = "vulkan"))]
fn without_vulkan(choice: &DeviceChoice) -> Result<(Box<dyn Executor>, Option<String>), ExecutorError> {
    match choice {
        DeviceChoice::Auto => Ok((Box::new(Cpu::new()), None)),
        other => Err(ExecutorError::WithoutVulkan { wanted: other.to_string() }),
    }
}

/// Native code and all Vulkan devices, with a note where Vulkan cannot be asked.
pub fn devices() -> (Vec<DeviceInfo>, Option<String>) {
    let native = vec![Cpu::new().device().clone()];
    #[cfg(feature = "vulkan")]
    match vulkan::devices() {
        Ok(found) => (native.into_iter().chain(found).collect(), None),
        Err(error) => (native, Some(error.to_string())),
    }
    #[cfg(not(feature = "vulkan"))]
    (native, None)
}
