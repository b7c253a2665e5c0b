//! What the host knows of each kernel: name, module, bindings, how many elements a workgroup takes, and its host form.

use crate::host::{self, HostCall, HostError};
use crate::invocation::WORKGROUP;
use crate::params::CountParams;
use ::scene::{BvhNode, Hit, Material, Ray, Texture, Triangle, TriangleUv};

/// How a kernel uses a binding.
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
}

/// What is bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BindingKind {
    /// Storage buffer: an array of elements of `stride` bytes. Needs at least one element, for Vulkan has no empty buffers.
    Storage {
        /// Bytes from element to element.
        stride: u32,
    },
    /// Two-dimensional sampled image without a sampler (texels are fetched), one level.
    SampledImage {
        /// Texel format.
        format: ImageFormat,
    },
}

/// One binding of descriptor set 0; its number is its position in [`Kernel::bindings`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Binding {
    /// Name of the argument, for messages.
    pub name: &'static str,
    /// How it is used.
    pub access: Access,
    /// What is bound.
    pub kind: BindingKind,
}

/// A kernel: everything an executor needs to run it.
#[derive(Debug)]
pub struct Kernel {
    /// Name of the kernel, of its module (`<name>.spv`) and of the entry point in it: `<crate>_<function>`.
    pub name: &'static str,
    /// SPIR-V words as bytes, aligned to 4.
    pub spv: &'static [u8],
    /// Invocations of a workgroup (`LocalSize`, one-dimensional).
    pub workgroup: u32,
    /// Elements that one workgroup takes; the number of workgroups is [`Kernel::groups`].
    pub elements_per_group: u32,
    /// Bytes of push constants, at most 128.
    pub push_bytes: u32,
    /// Bindings 0, 1, … of descriptor set 0.
    pub bindings: &'static [Binding],
    /// The same bodies over all elements, on all cores of the host: [`Kernel::run_on_host`].
    pub(crate) host: fn(&Kernel, &mut HostCall) -> Result<(), HostError>,
}

/// Widest dispatch: the least `maxComputeWorkGroupCount` that Vulkan allows a device.
pub const MAX_GROUPS_X: u32 = 65_535;

impl Kernel {
    /// Workgroups `[x, y, z]` of a dispatch over `elements` elements. Beyond [`MAX_GROUPS_X`] the dispatch goes on in
    /// further rows; the kernels number their invocations accordingly.
    pub fn groups(&self, elements: u32) -> [u32; 3] {
        let groups = elements.div_ceil(self.elements_per_group);
        let x = groups.clamp(1, MAX_GROUPS_X);
        [x, groups.div_ceil(x), u32::from(groups > 0)]
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

/// Module bytes on a word boundary.
#[repr(C, align(4))]
struct Aligned<T: ?Sized>(T);

macro_rules! spv {
    ($name:literal) => {{
        static MODULE: &Aligned<[u8]> = &Aligned(*include_bytes!(concat!("../spv/", $name, ".spv")));
        &MODULE.0
    }};
}

const fn buffer<T>(name: &'static str, access: Access) -> Binding {
    Binding { name, access, kind: BindingKind::Storage { stride: size_of::<T>() as u32 } }
}

const fn read<T>(name: &'static str) -> Binding {
    buffer::<T>(name, Access::Read)
}

const fn write<T>(name: &'static str) -> Binding {
    buffer::<T>(name, Access::Write)
}

/// Every kernel, in the order of the modules.
pub static KERNELS: &[&Kernel] = &[&SCENE_CLOSEST_HIT];

/// Nearest hit of every ray. An element is a ray.
pub static SCENE_CLOSEST_HIT: Kernel = Kernel {
    name: "scene_closest_hit",
    spv: spv!("scene_closest_hit"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[
        read::<Ray>("rays"),
        read::<BvhNode>("nodes"),
        read::<Triangle>("triangles"),
        read::<TriangleUv>("uvs"),
        read::<Material>("materials"),
        read::<Texture>("textures"),
        read::<u32>("texels"),
        write::<Hit>("hits"),
    ],
    host: host::scene::closest_hit,
};
