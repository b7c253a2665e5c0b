//! A row of the table.

use glam::UVec3;

use crate::host::{HostCall, HostError};

/// Use of a binding by a kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Only read.
    Read,
    /// Every element that the dispatch covers is written, none is read.
    Write,
    /// Read and written.
    ReadWrite,
}

/// Texel format of a sampled image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// Four 32-bit floats.
    Rgba32Float,
    /// Four 16-bit floats.
    Rgba16Float,
    /// Blocks of BC1 without alpha, 0 to 1.
    Bc1Rgb,
    /// Blocks of BC3, 0 to 1.
    Bc3,
    /// Blocks of BC6H, unsigned.
    Bc6hUfloat,
    /// Blocks of BC7, 0 to 1.
    Bc7,
}

impl ImageFormat {
    /// The formats of texture blocks.
    pub const BLOCKS: &[Self] = &[Self::Bc1Rgb, Self::Bc3, Self::Bc6hUfloat, Self::Bc7];

    /// Texels along the edge of a block, 1 where texels are stored one by one.
    pub const fn block_edge(self) -> u32 {
        match self {
            Self::Rgba32Float | Self::Rgba16Float => 1,
            Self::Bc1Rgb | Self::Bc3 | Self::Bc6hUfloat | Self::Bc7 => 4,
        }
    }

    /// Bytes of a block, or of a texel where texels are stored one by one.
    pub const fn block_bytes(self) -> u32 {
        match self {
            Self::Rgba16Float | Self::Bc1Rgb => 8,
            Self::Rgba32Float | Self::Bc3 | Self::Bc6hUfloat | Self::Bc7 => 16,
        }
    }

    /// Bytes of a row of texels, or of blocks, of an image of this width.
    pub const fn row_bytes(self, width: u32) -> u64 {
        width.div_ceil(self.block_edge()) as u64 * self.block_bytes() as u64
    }

    /// Bytes of an image: its blocks row by row, those at its edges whole.
    pub const fn image_bytes(self, width: u32, height: u32) -> u64 {
        self.row_bytes(width) * height.div_ceil(self.block_edge()) as u64
    }
}

/// Kind of resource at a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BindingKind {
    /// Storage buffer: an array of elements of `stride` bytes. Needs at least one element, for Vulkan has no empty
    /// buffers.
    Storage {
        /// Bytes from element to element.
        stride: u32,
    },
    /// Two-dimensional sampled image without a sampler (texels are fetched), one level.
    SampledImage {
        /// Texel formats, any of which may be bound.
        formats: &'static [ImageFormat],
    },
}

/// One binding of descriptor set 0; its number is its position in [`Kernel::bindings`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Binding {
    /// Name of the argument, for messages.
    pub name: &'static str,
    /// Use of the binding.
    pub access: Access,
    /// Kind of the bound resource.
    pub kind: BindingKind,
}

/// A kernel: everything an executor needs to run it.
#[derive(Clone, Copy, Debug)]
pub struct Kernel {
    /// Name of the kernel, of its module (`<name>.spv`) and of the entry point in it: `<crate>_<function>`.
    pub name: &'static str,
    /// SPIR-V words as bytes, aligned to 4.
    pub spv: &'static [u8],
    /// Invocations of a workgroup (`LocalSize`, one-dimensional).
    pub workgroup: u32,
    /// Invocations that one workgroup takes; rows, where a workgroup shares them. The number of workgroups is
    /// [`Kernel::groups`].
    pub per_group: u32,
    /// Bytes of push constants, at most 128.
    pub push_bytes: u32,
    /// Position of the number of invocations in the push constants: offsets of one number, or of two whose product it
    /// is.
    pub counts: &'static [usize],
    /// Bindings 0, 1, … of descriptor set 0.
    pub bindings: &'static [Binding],
    /// Host form: the same body over all invocations, on all cores of the host: [`Kernel::run_on_host`].
    #[doc(hidden)]
    pub host: fn(&Kernel, &mut HostCall) -> Result<(), HostError>,
    /// A single invocation of the entry point, for tests; `None` where the host cannot call it,
    /// because a workgroup shares memory or texels are fetched.
    pub invocation: Option<Invocation>,
}

/// One invocation on the host: the kernel, the call, the invocation's place in the dispatch
/// (`GlobalInvocationId`) and the number of workgroups each way.
pub type Invocation = fn(&Kernel, &mut HostCall, UVec3, UVec3) -> Result<(), HostError>;

/// Widest dispatch: the least `maxComputeWorkGroupCount` that Vulkan allows a device.
pub const MAX_GROUPS_X: u32 = 65_535;

impl Kernel {
    /// Workgroups `[x, y, z]` of so many invocations. Beyond [`MAX_GROUPS_X`] the dispatch goes on in
    /// further rows; the kernels number their invocations accordingly.
    pub fn groups(&self, invocations: u32) -> [u32; 3] {
        let groups = invocations.div_ceil(self.per_group);
        let x = groups.clamp(1, MAX_GROUPS_X);
        [x, groups.div_ceil(x), u32::from(groups > 0)]
    }

    /// Number of invocations that push constants say; `None` when they are too short.
    pub fn invocations(&self, push: &[u8]) -> Option<u32> {
        self.counts.iter().try_fold(1u32, |product, &offset| {
            let word: [u8; 4] = push.get(offset..offset + 4)?.try_into().ok()?;
            Some(product.saturating_mul(u32::from_ne_bytes(word)))
        })
    }

    /// Runs the host form after checking the call against this row of the table.
    ///
    /// # Errors
    /// Names the binding that is missing, has another access, length or alignment: [`HostError`].
    pub fn run_on_host(&self, call: &mut HostCall) -> Result<(), HostError> {
        call.check(self)?;
        (self.host)(self, call)
    }
}
