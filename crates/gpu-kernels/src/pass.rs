//! Passes as types: what a pass binds, by the names and the element types of its kernel's bindings.
//!
//! For each kernel there is a structure that follows from its declaration, such as
//! [`BouncePass`](crate::transport::BouncePass). A pass without one of its bindings, or with a buffer of other
//! elements, does not compile. `runtime::plan::Plan::add` adds such a pass to a plan.
//!
//! ```
//! use glam::Vec4;
//! use patchlight_gpu_kernels::pass::{BufferId, KernelPass, Slice};
//! use patchlight_gpu_kernels::transport::BouncePass;
//!
//! let [source, albedo, irradiance, exitance] = [0, 1, 2, 3].map(|k| BufferId(k).of::<Vec4>());
//! let pass = BouncePass { source, albedo, irradiance, exitance };
//! assert_eq!(pass.ranges().len(), BouncePass::KERNEL.bindings.len());
//! ```
//!
//! Without a binding, and with elements of another type:
//!
//! ```compile_fail,E0063
//! # use patchlight_gpu_kernels::{pass::BufferId, transport::BouncePass};
//! # let [source, albedo, irradiance] = [0, 1, 2].map(|k| BufferId(k).of());
//! let pass = BouncePass { source, albedo, irradiance };
//! ```
//!
//! ```compile_fail,E0308
//! # use patchlight_gpu_kernels::{pass::BufferId, transport::BouncePass};
//! # let [source, albedo, irradiance] = [0, 1, 2].map(|k| BufferId(k).of());
//! let exitance = BufferId(3).of::<u32>();
//! let pass = BouncePass { source, albedo, irradiance, exitance };
//! ```

use std::fmt;
use std::marker::PhantomData;
use std::vec::Vec;

use ::scene::gpu::{BvhNode, Emitter, Texture, Triangle, TriangleUv};
use ::scene::{Light, Material, Rgb, Sky};
use bytemuck::Pod;

use crate::table::Kernel;

/// A buffer of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BufferId(#[doc(hidden)] pub usize);

/// A part of a buffer: `offset .. offset + bytes`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Range {
    /// The buffer.
    pub buffer: BufferId,
    /// First byte, a multiple of `runtime::plan::RANGE_ALIGNMENT`.
    pub offset: u64,
    /// Number of bytes; `None` is all that follow.
    pub bytes: Option<u64>,
}

impl From<BufferId> for Range {
    fn from(buffer: BufferId) -> Self {
        Self { buffer, offset: 0, bytes: None }
    }
}

impl BufferId {
    /// A part of this buffer, such as a block of rows of a matrix.
    pub fn range(self, offset: u64, bytes: u64) -> Range {
        Range { buffer: self, offset, bytes: Some(bytes) }
    }

    /// The whole buffer, read as elements of type `T`.
    pub fn of<T>(self) -> Slice<T> {
        Slice { buffer: self, offset: 0, bytes: None, element: PhantomData }
    }
}

/// Elements of type `T` in a buffer: all of them, or some that follow each other.
pub struct Slice<T> {
    /// The buffer.
    pub buffer: BufferId,
    offset: u64,
    /// Number of bytes; `None` is all that follow.
    bytes: Option<u64>,
    element: PhantomData<fn() -> T>,
}

impl<T> Slice<T> {
    /// `count` of these elements, from index `first` on. The first byte must be a multiple of
    /// `runtime::plan::RANGE_ALIGNMENT` in the buffer.
    #[must_use]
    pub fn part(self, first: usize, count: usize) -> Self {
        let stride = size_of::<T>() as u64;
        Self { offset: self.offset + stride * first as u64, bytes: Some(stride * count as u64), ..self }
    }

    /// Reinterprets the same bytes as elements of another type.
    #[must_use]
    pub fn cast<U>(self) -> Slice<U> {
        Slice { buffer: self.buffer, offset: self.offset, bytes: self.bytes, element: PhantomData }
    }

    /// The bytes as an untyped range.
    pub fn range(self) -> Range {
        Range { buffer: self.buffer, offset: self.offset, bytes: self.bytes }
    }
}

impl<T> Clone for Slice<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Slice<T> {}

impl<T> fmt::Debug for Slice<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?} of {}", self.range(), std::any::type_name::<T>())
    }
}

impl<T> PartialEq for Slice<T> {
    fn eq(&self, other: &Self) -> bool {
        self.range() == other.range()
    }
}

impl<T> From<BufferId> for Slice<T> {
    fn from(buffer: BufferId) -> Self {
        buffer.of()
    }
}

impl<T> From<Slice<T>> for Range {
    fn from(slice: Slice<T>) -> Self {
        slice.range()
    }
}

/// The tables of a scene's geometry.
#[derive(Clone, Copy, Debug)]
pub struct GeometrySlices {
    /// Nodes of the hierarchy.
    pub nodes: Slice<BvhNode>,
    /// Triangles in the order of the hierarchy's leaves.
    pub triangles: Slice<Triangle>,
    /// Texture coordinates of the triangles.
    pub uvs: Slice<TriangleUv>,
    /// Materials.
    pub materials: Slice<Material>,
    /// Textures.
    pub textures: Slice<Texture>,
    /// Texels of all textures.
    pub texels: Slice<u32>,
}

/// The tables of a scene's lights, emitters and sky.
#[derive(Clone, Copy, Debug)]
pub struct LightSlices {
    /// Lights.
    pub lights: Slice<Light>,
    /// Emissive triangles.
    pub emitters: Slice<Emitter>,
    /// The sky, one element.
    pub sky: Slice<Sky>,
    /// Texels of the sky's map.
    pub sky_map: Slice<Rgb>,
    /// Distributions of luminaires.
    pub distributions: Slice<f32>,
}

/// Bindings of a kernel for a pass. Kernels implement it by their declarations.
pub trait KernelPass {
    /// Push constants.
    type Push: Pod;
    /// The kernel.
    const KERNEL: &'static Kernel;

    /// The bound ranges, in the order of the kernel's bindings.
    fn ranges(&self) -> Vec<Range>;
}

/// One or more bindings of a pass.
#[doc(hidden)]
pub trait Bind {
    fn bind(&self, ranges: &mut Vec<Range>);
}

impl<T> Bind for Slice<T> {
    fn bind(&self, ranges: &mut Vec<Range>) {
        ranges.push(self.range());
    }
}

/// An image is bound as a whole.
impl Bind for BufferId {
    fn bind(&self, ranges: &mut Vec<Range>) {
        ranges.push((*self).into());
    }
}

impl Bind for GeometrySlices {
    fn bind(&self, ranges: &mut Vec<Range>) {
        self.nodes.bind(ranges);
        self.triangles.bind(ranges);
        self.uvs.bind(ranges);
        self.materials.bind(ranges);
        self.textures.bind(ranges);
        self.texels.bind(ranges);
    }
}

impl Bind for LightSlices {
    fn bind(&self, ranges: &mut Vec<Range>) {
        self.lights.bind(ranges);
        self.emitters.bind(ranges);
        self.sky.bind(ranges);
        self.sky_map.bind(ranges);
        self.distributions.bind(ranges);
    }
}

#[doc(hidden)]
pub type Ranges = Vec<Range>;

/// The structure of a kernel's passes. While bindings are read, two lists grow: fields, and their names.
#[doc(hidden)]
#[macro_export]
macro_rules! typed_pass {
    (@fields $head:tt [$geometry:ident: GeometryTables, $($rest:tt)*] [$($fields:tt)*] [$($names:tt)*]) => {
        $crate::typed_pass! {
            @fields $head [$($rest)*]
            [$($fields)* #[doc = "Geometry of the scene."] pub $geometry: $crate::pass::GeometrySlices,]
            [$($names)* $geometry]
        }
    };
    (@fields $head:tt [$lights:ident: Lights, $($rest:tt)*] [$($fields:tt)*] [$($names:tt)*]) => {
        $crate::typed_pass! {
            @fields $head [$($rest)*]
            [$($fields)* #[doc = "Lights, emitters and sky of the scene."] pub $lights: $crate::pass::LightSlices,]
            [$($names)* $lights]
        }
    };
    (@fields $head:tt [$b:ident: read [$T:ty $(; $length:expr)?], $($rest:tt)*] [$($fields:tt)*] [$($names:tt)*]) => {
        $crate::typed_pass!(@field $head [$($rest)*] [$($fields)*] [$($names)*] $b $T; "Read.");
    };
    (@fields $head:tt [$b:ident: write [$T:ty], $($rest:tt)*] [$($fields:tt)*] [$($names:tt)*]) => {
        $crate::typed_pass!(@field $head [$($rest)*] [$($fields)*] [$($names)*] $b $T; "Written.");
    };
    (@fields $head:tt [$b:ident: update [$T:ty] $(as $old:ident)?, $($rest:tt)*] [$($fields:tt)*] [$($names:tt)*]) => {
        $crate::typed_pass!(@field $head [$($rest)*] [$($fields)*] [$($names)*] $b $T; "Read and written.");
    };
    (@fields $head:tt [$b:ident: image $formats:expr, $($rest:tt)*] [$($fields:tt)*] [$($names:tt)*]) => {
        $crate::typed_pass! {
            @fields $head [$($rest)*]
            [$($fields)* #[doc = "An image, read."] pub $b: $crate::pass::BufferId,]
            [$($names)* $b]
        }
    };
    (@field $head:tt $rest:tt [$($fields:tt)*] [$($names:tt)*] $b:ident $T:ty; $doc:literal) => {
        $crate::typed_pass! {
            @fields $head $rest
            [$($fields)* #[doc = $doc] pub $b: $crate::pass::Slice<$T>,]
            [$($names)* $b]
        }
    };
    (@fields [[$($meta:tt)*] $NAME:ident $Pass:ident [$p:ident $P:ty]] [] [$($fields:tt)*] [$($names:ident)*]) => {
        $($meta)*
        #[derive(Clone, Copy, Debug)]
        pub struct $Pass {
            $($fields)*
        }

        impl $crate::pass::KernelPass for $Pass {
            type Push = $P;
            const KERNEL: &'static $crate::table::Kernel = &$NAME;

            fn ranges(&self) -> $crate::pass::Ranges {
                let mut ranges = $crate::pass::Ranges::new();
                $($crate::pass::Bind::bind(&self.$names, &mut ranges);)*
                ranges
            }
        }
    };
}
