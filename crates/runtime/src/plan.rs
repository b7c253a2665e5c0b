//! A frame as data: buffers, and passes that run kernels over them. No device is needed to make, check or print one.
//!
//! A pass says which ranges of which buffers its kernel's bindings get; what it reads and writes is what the kernel
//! table says of those bindings. Passes run in the order in which they were added, so a plan has no cycles.
//! [`crate::graph`] derives barriers and lifetimes.

use std::fmt;

use bytemuck::Pod;
use gpu_kernels::table::{Access, Binding, BindingKind, ImageFormat, Kernel};

pub use gpu_kernels::pass::{BufferId, GeometrySlices, KernelPass, LightSlices, Range, Slice};

/// Bytes by which ranges of a buffer must be aligned: the greatest `minStorageBufferOffsetAlignment` that Vulkan
/// allows.
pub const RANGE_ALIGNMENT: u64 = 256;

/// A pass of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PassId(pub(crate) usize);

/// Purpose of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BufferKind {
    /// Keeps its contents from frame to frame; may be uploaded and downloaded.
    Storage,
    /// Lives from its first to its last pass of a frame; its memory is shared with others. Neither uploaded nor
    /// downloaded.
    Scratch,
    /// A picture that kernels fetch from, rows of texels or of texture blocks from the top. Uploaded and downloaded as
    /// its bytes.
    Image {
        /// Texel format.
        format: ImageFormat,
        /// Texels of a row.
        width: u32,
        /// Rows.
        height: u32,
    },
}

/// A buffer as a plan describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BufferSpec {
    /// For messages, timings and the printed graph.
    pub name: String,
    /// Size. A storage buffer of 0 bytes is bound as one element of zeros.
    pub bytes: u64,
    /// Purpose.
    pub kind: BufferKind,
}

/// A range whose end is known and that lies in its buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Bound {
    pub buffer: BufferId,
    pub offset: u64,
    pub bytes: u64,
    pub reads: bool,
    pub writes: bool,
}

impl Bound {
    pub fn overlaps(&self, other: &Self) -> bool {
        self.offset < other.offset + other.bytes && other.offset < self.offset + self.bytes
    }
}

/// One kernel over a number of invocations.
#[derive(Clone)]
pub struct Pass {
    /// For messages and timings; several passes may share a name, their times then add up.
    pub name: String,
    /// Row of the kernel table.
    pub kernel: &'static Kernel,
    /// Push constants, `kernel.push_bytes` long.
    pub push: Vec<u8>,
    /// Number of invocations, as the push constants say.
    pub invocations: u32,
    pub(crate) bound: Vec<Bound>,
}

impl fmt::Debug for Pass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}, {} invocations)", self.name, self.kernel.name, self.invocations)
    }
}

/// A mistake in a plan or in its use.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// A pass gives its kernel too few or too many buffers.
    #[error(
        "pass `{pass}`: kernel `{kernel}` has {expected} bindings, {found} given (the first one missing: {missing})"
    )]
    BindingCount {
        /// The pass.
        pass: String,
        /// Its kernel.
        kernel: &'static str,
        /// Bindings of the kernel.
        expected: usize,
        /// Bindings of the pass.
        found: usize,
        /// Name of the first binding without a buffer.
        missing: &'static str,
    },
    /// A picture where the kernel wants a buffer, or the other way round.
    #[error("pass `{pass}`: binding `{binding}` takes {expected}, buffer `{buffer}` is not one")]
    BindingKind {
        /// The pass.
        pass: String,
        /// The binding.
        binding: &'static str,
        /// Type that the kernel expects.
        expected: &'static str,
        /// The buffer given.
        buffer: String,
    },
    /// The bound bytes are not a whole number of elements.
    #[error(
        "pass `{pass}`: {bytes} bytes of `{buffer}` are not a multiple of the {stride} bytes of binding `{binding}`"
    )]
    Length {
        /// The pass.
        pass: String,
        /// The buffer.
        buffer: String,
        /// The binding.
        binding: &'static str,
        /// Bytes bound.
        bytes: u64,
        /// Bytes of an element.
        stride: u64,
    },
    /// A range that leaves its buffer, is empty or not aligned.
    #[error(
        "pass `{pass}`: range {offset} + {bytes} of `{buffer}` must be in its {size} bytes, not empty, and start at a \
         multiple of {RANGE_ALIGNMENT}"
    )]
    Range {
        /// The pass.
        pass: String,
        /// The buffer.
        buffer: String,
        /// Start of the range.
        offset: u64,
        /// Length of the range.
        bytes: u64,
        /// Size of the buffer.
        size: u64,
    },
    /// A pass writes bytes that another of its bindings reads or writes.
    #[error("pass `{pass}` writes to `{buffer}` and binds the same bytes again")]
    Overlap {
        /// The pass.
        pass: String,
        /// The buffer.
        buffer: String,
    },
    /// Push constants of the wrong size.
    #[error("pass `{pass}`: kernel `{kernel}` takes {expected} bytes of push constants, {found} given")]
    PushLength {
        /// The pass.
        pass: String,
        /// Its kernel.
        kernel: &'static str,
        /// Bytes of the kernel's push constants.
        expected: usize,
        /// Bytes given.
        found: usize,
    },
    /// A pass reads what nobody has uploaded or written.
    #[error("pass `{pass}` reads `{buffer}`, which nothing was uploaded to and no earlier pass has written")]
    NeverWritten {
        /// The pass.
        pass: String,
        /// The buffer.
        buffer: String,
    },
    /// Bytes that do not fit a buffer.
    #[error("`{buffer}` has {size} bytes, {found} bytes at {offset} do not fit")]
    UploadLength {
        /// The buffer.
        buffer: String,
        /// Its size.
        size: u64,
        /// Offset of the write.
        offset: u64,
        /// Number of bytes given.
        found: u64,
    },
    /// A scratch buffer has no contents outside of a frame.
    #[error("`{buffer}` is a scratch buffer: it cannot be uploaded, cleared or downloaded")]
    Scratch {
        /// The buffer.
        buffer: String,
    },
    /// A pass binds a scratch buffer of an earlier section, whose contents end with that section.
    #[error("pass `{pass}`: `{buffer}` is a scratch buffer of an earlier section; make it a storage buffer")]
    EarlierScratch {
        /// The pass.
        pass: String,
        /// The buffer.
        buffer: String,
    },
    /// A plan that does not begin as the loaded one does.
    #[error("the plan differs from the loaded one before its section {section}, which alone was to be replaced")]
    OtherSections {
        /// Number of the first section that was to be replaced.
        section: usize,
    },
    /// An id of another plan.
    #[error("there is no {what} {index} in this plan of {count}")]
    Unknown {
        /// Buffer or pass.
        what: &'static str,
        /// The id.
        index: usize,
        /// Number of elements.
        count: usize,
    },
}

/// Buffers and passes of a frame, in one or more sections.
///
/// Sections separate parts of a frame that change at different times: an executor replaces the last ones and keeps the
/// buffers of those before, with their contents ([`crate::executor::Executor::load_after`]). Passes of a section bind
/// buffers of any section before; scratch buffers share memory with others of their section only.
#[derive(Clone, Debug, Default)]
pub struct Plan {
    buffers: Vec<BufferSpec>,
    passes: Vec<Pass>,
    /// Beginnings of the sections after the first.
    sections: Vec<SectionStart>,
}

/// Number of buffers and passes before a section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SectionStart {
    pub buffers: usize,
    pub passes: usize,
}

impl Plan {
    /// An empty plan.
    pub fn new() -> Self {
        Self::default()
    }

    /// Begins a section and gives its number, at least 1: what is added from now on belongs to it.
    pub fn begin_section(&mut self) -> usize {
        self.sections.push(SectionStart { buffers: self.buffers.len(), passes: self.passes.len() });
        self.sections.len()
    }

    /// Number of sections, at least 1.
    pub fn section_count(&self) -> usize {
        self.sections.len() + 1
    }

    /// Removes all sections from number `section` on.
    pub fn truncate(&mut self, section: usize) {
        let start = self.section_start(section);
        self.buffers.truncate(start.buffers);
        self.passes.truncate(start.passes);
        self.sections.truncate(section.saturating_sub(1));
    }

    /// Buffers and passes before a section; all for a section that there is not.
    pub(crate) fn section_start(&self, section: usize) -> SectionStart {
        match section.checked_sub(1) {
            None => SectionStart::default(),
            Some(index) => self.sections.get(index).copied().unwrap_or_else(|| self.end()),
        }
    }

    fn end(&self) -> SectionStart {
        SectionStart { buffers: self.buffers.len(), passes: self.passes.len() }
    }

    /// Takes over the passes of a loaded plan before a section, with their push constants and numbers of invocations.
    ///
    /// # Errors
    /// [`PlanError::OtherSections`] unless both plans have the same buffers and passes there.
    pub(crate) fn keep_passes(&mut self, loaded: &Self, section: usize) -> Result<(), PlanError> {
        let start = self.section_start(section);
        let is_same = loaded.section_start(section) == start
            && self.buffers[..start.buffers] == loaded.buffers[..start.buffers]
            && self.passes[..start.passes].iter().zip(&loaded.passes[..start.passes]).all(|(own, other)| {
                std::ptr::eq(own.kernel, other.kernel) && own.name == other.name && own.bound == other.bound
            });
        if !is_same {
            return Err(PlanError::OtherSections { section });
        }
        self.passes[..start.passes].clone_from_slice(&loaded.passes[..start.passes]);
        Ok(())
    }

    /// Adds a buffer that keeps its contents. With 0 bytes it is bound as one element of zeros and needs no upload.
    pub fn storage(&mut self, name: impl Into<String>, bytes: u64) -> BufferId {
        self.add_buffer(name.into(), bytes, BufferKind::Storage)
    }

    /// Adds a buffer of so many elements that keeps its contents.
    pub fn array<T: Pod>(&mut self, name: impl Into<String>, count: usize) -> Slice<T> {
        self.storage(name, (count * size_of::<T>()) as u64).of()
    }

    /// Adds a buffer that lives within a frame and shares memory with others like it.
    pub fn scratch(&mut self, name: impl Into<String>, bytes: u64) -> BufferId {
        self.add_buffer(name.into(), bytes, BufferKind::Scratch)
    }

    /// Adds a picture that kernels fetch from.
    pub fn image(&mut self, name: impl Into<String>, format: ImageFormat, width: u32, height: u32) -> BufferId {
        let bytes = format.image_bytes(width, height);
        self.add_buffer(name.into(), bytes, BufferKind::Image { format, width, height })
    }

    fn add_buffer(&mut self, name: String, bytes: u64, kind: BufferKind) -> BufferId {
        self.buffers.push(BufferSpec { name, bytes, kind });
        BufferId(self.buffers.len() - 1)
    }

    /// Adds a pass of as many invocations as its push constants say.
    ///
    /// # Errors
    /// Buffers that are empty, too short or bound twice; the error names pass and buffer.
    pub fn add<P: KernelPass>(
        &mut self,
        name: impl Into<String>,
        pass: &P,
        push: &P::Push,
    ) -> Result<PassId, PlanError> {
        self.pass(name, P::KERNEL, &pass.ranges(), push)
    }

    /// Adds a pass of a kernel that is known only at run time; its bindings stand in the order of the kernel table.
    ///
    /// # Errors
    /// Bindings or push constants that do not suit the kernel; the error names pass and buffer.
    pub fn pass<P: Pod>(
        &mut self,
        name: impl Into<String>,
        kernel: &'static Kernel,
        bindings: &[Range],
        push: &P,
    ) -> Result<PassId, PlanError> {
        self.pass_with_bytes(name, kernel, bindings, bytemuck::bytes_of(push))
    }

    /// As [`Plan::pass`], with push constants as bytes.
    ///
    /// # Errors
    /// As [`Plan::pass`].
    pub fn pass_with_bytes(
        &mut self,
        name: impl Into<String>,
        kernel: &'static Kernel,
        bindings: &[Range],
        push: &[u8],
    ) -> Result<PassId, PlanError> {
        let name = name.into();
        if bindings.len() != kernel.bindings.len() {
            return Err(PlanError::BindingCount {
                pass: name,
                kernel: kernel.name,
                expected: kernel.bindings.len(),
                found: bindings.len(),
                missing: kernel.bindings.get(bindings.len()).map_or("none", |b| b.name),
            });
        }
        let mut bound = Vec::with_capacity(bindings.len());
        for (range, binding) in bindings.iter().zip(kernel.bindings) {
            bound.push(self.bind(&name, range, binding)?);
        }
        let first_own = self.sections.last().map_or(0, |start| start.buffers);
        let is_earlier_scratch =
            |b: &&Bound| b.buffer.0 < first_own && self.buffers[b.buffer.0].kind == BufferKind::Scratch;
        if let Some(earlier) = bound.iter().find(is_earlier_scratch) {
            let buffer = self.buffers[earlier.buffer.0].name.clone();
            return Err(PlanError::EarlierScratch { pass: name, buffer });
        }
        for (k, a) in bound.iter().enumerate() {
            if bound[..k].iter().any(|b| a.buffer == b.buffer && (a.writes || b.writes) && a.overlaps(b)) {
                return Err(PlanError::Overlap { pass: name, buffer: self.buffers[a.buffer.0].name.clone() });
            }
        }
        check_push(&name, kernel, push)?;
        let invocations = kernel.invocations(push).unwrap_or(0);
        self.passes.push(Pass { name, kernel, push: push.to_vec(), invocations, bound });
        Ok(PassId(self.passes.len() - 1))
    }

    fn bind(&self, pass: &str, range: &Range, binding: &Binding) -> Result<Bound, PlanError> {
        let spec = self.buffer(range.buffer)?;
        let stride = match binding.kind {
            BindingKind::Storage { stride } => u64::from(stride),
            BindingKind::SampledImage { .. } => 1,
        };
        let expected = match (binding.kind, spec.kind) {
            (BindingKind::SampledImage { formats }, BufferKind::Image { format, .. }) if formats.contains(&format) => {
                None
            }
            (BindingKind::SampledImage { formats: [ImageFormat::Rgba32Float] }, _) => {
                Some("a picture of 32-bit floats")
            }
            (BindingKind::SampledImage { formats: [ImageFormat::Rgba16Float] }, _) => {
                Some("a picture of 16-bit floats")
            }
            (BindingKind::SampledImage { .. }, _) => Some("a picture of texture blocks"),
            (BindingKind::Storage { .. }, BufferKind::Image { .. }) => Some("a buffer"),
            (BindingKind::Storage { .. }, _) => None,
        };
        if let Some(expected) = expected {
            let pass = pass.into();
            let buffer = spec.name.clone();
            return Err(PlanError::BindingKind { pass, binding: binding.name, expected, buffer });
        }
        let is_image = matches!(spec.kind, BufferKind::Image { .. });
        let size = if spec.bytes == 0 { stride } else { spec.bytes };
        let bytes = range.bytes.unwrap_or(size.saturating_sub(range.offset));
        let inside = range.offset.checked_add(bytes).is_some_and(|end| end <= size);
        if !inside || bytes == 0 || !range.offset.is_multiple_of(RANGE_ALIGNMENT) || (is_image && bytes != size) {
            return Err(PlanError::Range {
                pass: pass.into(),
                buffer: spec.name.clone(),
                offset: range.offset,
                bytes,
                size,
            });
        }
        if !bytes.is_multiple_of(stride) {
            return Err(PlanError::Length {
                pass: pass.into(),
                buffer: spec.name.clone(),
                binding: binding.name,
                bytes,
                stride,
            });
        }
        let reads = binding.access != Access::Write;
        let writes = binding.access != Access::Read;
        Ok(Bound { buffer: range.buffer, offset: range.offset, bytes, reads, writes })
    }

    /// All buffers.
    pub fn buffers(&self) -> &[BufferSpec] {
        &self.buffers
    }

    /// Bytes of all buffers; scratch buffers, which share memory, count each.
    pub fn bytes(&self) -> u64 {
        self.buffers.iter().map(|buffer| buffer.bytes).sum()
    }

    /// All passes in their order.
    pub fn passes(&self) -> &[Pass] {
        &self.passes
    }

    /// The ids of all passes in their order.
    pub fn all_passes(&self) -> Vec<PassId> {
        (0..self.passes.len()).map(PassId).collect()
    }

    /// Description of a buffer.
    ///
    /// # Errors
    /// [`PlanError::Unknown`] for an id of another plan.
    pub fn buffer(&self, id: BufferId) -> Result<&BufferSpec, PlanError> {
        self.buffers.get(id.0).ok_or(PlanError::Unknown { what: "buffer", index: id.0, count: self.buffers.len() })
    }

    pub(crate) fn pass_mut(&mut self, id: PassId) -> Result<&mut Pass, PlanError> {
        let count = self.passes.len();
        self.passes.get_mut(id.0).ok_or(PlanError::Unknown { what: "pass", index: id.0, count })
    }
}

pub(crate) fn check_push(pass: &str, kernel: &Kernel, push: &[u8]) -> Result<(), PlanError> {
    let expected = kernel.push_bytes as usize;
    if push.len() == expected {
        return Ok(());
    }
    Err(PlanError::PushLength { pass: pass.into(), kernel: kernel.name, expected, found: push.len() })
}
