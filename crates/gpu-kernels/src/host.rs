//! The host form of the kernels: the same bodies, run for all invocations on all cores. Each is computed by itself, so
//! the result does not depend on the number of threads. Most host forms follow from the kernel's declaration; here are
//! those that are faster than a loop over the invocations.

pub(crate) mod firstshot;
pub(crate) mod localmatrix;
pub(crate) mod low_rank;
pub(crate) mod multibounce;
pub(crate) mod patches;
pub(crate) mod scene;
pub(crate) mod temporal;
pub(crate) mod transport;
pub(crate) mod view;

use std::any::Any;
use std::vec::Vec;

use ::scene::gpu::BvhNode;
use ::scene::{Geometry, GeometryTables, Hierarchy};
use bytemuck::{AnyBitPattern, Pod};
use rayon::prelude::*;

use crate::table::{Access, BindingKind, ImageFormat, Kernel};

/// Resource bound at one place, borrowed from the executor. Buffers are aligned to 16 bytes.
#[derive(Debug)]
pub enum HostBinding<'a> {
    /// A buffer that is read.
    Read(&'a [u8]),
    /// A buffer that is read, and what its bytes are a part of: with a [`Geometry`], rays take its own hierarchy.
    Part(&'a [u8], &'a (dyn Any + Send + Sync)),
    /// A buffer that is written, or read and written.
    Write(&'a mut [u8]),
    /// A sampled image: rows of texels, or of blocks, from the top, without gaps.
    Image {
        /// Texel format.
        format: ImageFormat,
        /// Texels of a row.
        width: u32,
        /// Rows.
        height: u32,
        /// The texels' bytes.
        texels: &'a [u8],
    },
}

/// One dispatch on the host.
#[derive(Debug)]
pub struct HostCall<'c, 'a> {
    /// Invocations of the dispatch; the same number stands in the push constants.
    pub invocations: u32,
    /// Push constants.
    pub push: &'c [u8],
    /// Bindings 0, 1, …; a written buffer is bound once.
    pub bindings: &'c mut [HostBinding<'a>],
}

/// Why a kernel cannot run on what was bound.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HostError {
    /// Too few or too many bindings.
    #[error("{kernel} has {expected} bindings, {found} were given")]
    BindingCount {
        /// The kernel.
        kernel: &'static str,
        /// Bindings of the table.
        expected: usize,
        /// Bindings of the call.
        found: usize,
    },
    /// Push constants of another size.
    #[error("{kernel} takes {expected} bytes of push constants, {found} were given")]
    PushLength {
        /// The kernel.
        kernel: &'static str,
        /// Bytes of the table.
        expected: u32,
        /// Bytes of the call.
        found: usize,
    },
    /// A read-only buffer where one is written, a buffer where an image belongs, or the like.
    #[error("{kernel}: {binding} needs {expected}")]
    BindingKind {
        /// The kernel.
        kernel: &'static str,
        /// The binding.
        binding: &'static str,
        /// Expected type.
        expected: &'static str,
    },
    /// Bytes that are no whole number of elements, or start off their alignment.
    #[error("{binding}: {bytes} bytes do not hold aligned elements of {stride} bytes")]
    Layout {
        /// The binding.
        binding: &'static str,
        /// Bytes of an element.
        stride: usize,
        /// Bytes that were bound.
        bytes: usize,
    },
    /// Fewer elements than the dispatch covers.
    #[error("{binding} holds {found} elements, the dispatch needs {needed}")]
    TooShort {
        /// The binding.
        binding: &'static str,
        /// Elements needed.
        needed: usize,
        /// Elements there are.
        found: usize,
    },
    /// An image with fewer texels than the dispatch covers.
    #[error("{binding} has {found:?} texels, the dispatch needs {needed:?}")]
    ImageSize {
        /// The binding.
        binding: &'static str,
        /// Columns and rows needed.
        needed: (u32, u32),
        /// Columns and rows there are.
        found: (u32, u32),
    },
    /// The push constants count other invocations than the dispatch.
    #[error("the dispatch has {invocations} invocations, its push constants say {count}")]
    Invocations {
        /// Invocations of the dispatch.
        invocations: u32,
        /// Invocations of the push constants.
        count: u32,
    },
}

impl<'a> HostCall<'_, 'a> {
    /// Compares the call with the table.
    pub(crate) fn check(&self, kernel: &Kernel) -> Result<(), HostError> {
        let name = kernel.name;
        if self.bindings.len() != kernel.bindings.len() {
            return Err(HostError::BindingCount {
                kernel: name,
                expected: kernel.bindings.len(),
                found: self.bindings.len(),
            });
        }
        if self.push.len() != kernel.push_bytes as usize {
            return Err(HostError::PushLength { kernel: name, expected: kernel.push_bytes, found: self.push.len() });
        }
        let count = kernel.invocations(self.push).unwrap_or(0);
        if count != self.invocations {
            return Err(HostError::Invocations { invocations: self.invocations, count });
        }
        for (given, row) in self.bindings.iter().zip(kernel.bindings) {
            let expected = match (row.kind, row.access) {
                (BindingKind::SampledImage { .. }, _) => "an image",
                (BindingKind::Storage { .. }, Access::Read) => "a buffer to read",
                (BindingKind::Storage { .. }, _) => "a buffer to write",
            };
            let found = match given {
                HostBinding::Read(_) | HostBinding::Part(..) => "a buffer to read",
                HostBinding::Write(_) => "a buffer to write",
                HostBinding::Image { .. } => "an image",
            };
            if expected != found {
                return Err(HostError::BindingKind { kernel: name, binding: row.name, expected });
            }
            if let (BindingKind::SampledImage { formats }, HostBinding::Image { format, .. }) = (row.kind, given)
                && !formats.contains(format)
            {
                let expected = "an image of another format";
                return Err(HostError::BindingKind { kernel: name, binding: row.name, expected });
            }
        }
        Ok(())
    }

    /// Push constants and bindings of a call that was checked against the table.
    #[doc(hidden)]
    pub fn parts<P: AnyBitPattern, const N: usize>(
        &mut self,
        kernel: &Kernel,
    ) -> Result<(P, [Bound<'_, 'a>; N]), HostError> {
        let push = bytemuck::try_pod_read_unaligned(self.push).map_err(|_| HostError::PushLength {
            kernel: kernel.name,
            expected: size_of::<P>() as u32,
            found: self.push.len(),
        })?;
        let found = self.bindings.len();
        let bound: Vec<_> =
            self.bindings.iter_mut().zip(kernel.bindings).map(|(data, row)| Bound { name: row.name, data }).collect();
        let bound =
            bound.try_into().map_err(|_| HostError::BindingCount { kernel: kernel.name, expected: N, found })?;
        Ok((push, bound))
    }
}

/// A binding with its name.
#[doc(hidden)]
pub struct Bound<'s, 'a> {
    name: &'static str,
    data: &'s mut HostBinding<'a>,
}

impl<'s> Bound<'s, '_> {
    /// The elements, at least `needed` of them.
    #[doc(hidden)]
    pub fn read<T: AnyBitPattern>(self, needed: usize) -> Result<&'s [T], HostError> {
        let bytes: &'s [u8] = match self.data {
            HostBinding::Read(bytes) | HostBinding::Part(bytes, _) => bytes,
            HostBinding::Write(bytes) => bytes,
            HostBinding::Image { texels, .. } => texels,
        };
        let layout = HostError::Layout { binding: self.name, stride: size_of::<T>(), bytes: bytes.len() };
        let elements: &[T] = bytemuck::try_cast_slice(bytes).map_err(|_| layout)?;
        long_enough(self.name, elements.len(), needed)?;
        Ok(elements)
    }

    /// The hierarchy, that of the host where the nodes are a part of a [`Geometry`].
    #[doc(hidden)]
    pub fn hierarchy(self) -> Result<Hierarchy<'s>, HostError> {
        if let HostBinding::Part(_, owner) = *self.data
            && let Some(geometry) = owner.downcast_ref::<Geometry>()
        {
            return Ok(geometry.hierarchy());
        }
        Ok(self.read::<BvhNode>(1)?.into())
    }

    /// Returns true if the image has at least so many texels each way.
    fn covers(&self, width: u32, height: u32) -> Result<(), HostError> {
        let found = match &*self.data {
            HostBinding::Image { width, height, .. } => (*width, *height),
            _ => (0, 0),
        };
        if found.0 < width || found.1 < height {
            return Err(HostError::ImageSize { binding: self.name, needed: (width, height), found });
        }
        Ok(())
    }

    /// The blocks of an image as words, their format, and the number of blocks in a row.
    fn blocks(self) -> Result<(&'s [u32], ImageFormat, usize), HostError> {
        let HostBinding::Image { format, width, height, .. } = *self.data else {
            return Err(HostError::TooShort { binding: self.name, needed: 1, found: 0 });
        };
        let columns = width.div_ceil(format.block_edge()) as usize;
        Ok((self.read(format.image_bytes(width, height) as usize / 4)?, format, columns))
    }

    /// All elements, to be read and written.
    #[doc(hidden)]
    pub fn whole<T: Pod>(self) -> Result<&'s mut [T], HostError> {
        let HostBinding::Write(bytes) = self.data else {
            return Err(HostError::TooShort { binding: self.name, needed: 1, found: 0 });
        };
        let layout = HostError::Layout { binding: self.name, stride: size_of::<T>(), bytes: bytes.len() };
        bytemuck::try_cast_slice_mut(bytes).map_err(|_| layout)
    }

    /// The elements that are written: the first `needed`.
    #[doc(hidden)]
    pub fn write<T: Pod>(self, needed: usize) -> Result<&'s mut [T], HostError> {
        let name = self.name;
        let elements = self.whole::<T>()?;
        long_enough(name, elements.len(), needed)?;
        Ok(&mut elements[..needed])
    }
}

/// The six tables of the scene's geometry.
pub(crate) fn geometry<'s>(
    [nodes, triangles, uvs, materials, textures, texels]: [Bound<'s, '_>; 6],
) -> Result<GeometryTables<'s>, HostError> {
    Ok(GeometryTables {
        hierarchy: nodes.hierarchy()?,
        triangles: triangles.read(1)?,
        uvs: uvs.read(1)?,
        materials: materials.read(1)?,
        textures: textures.read(0)?,
        texels: texels.read(0)?,
    })
}

fn long_enough(binding: &'static str, found: usize, needed: usize) -> Result<(), HostError> {
    if found < needed { Err(HostError::TooShort { binding, needed, found }) } else { Ok(()) }
}

/// Number of elements that these numbers name: the greatest number, and one more.
pub(crate) fn named(numbers: &[u32]) -> usize {
    numbers.iter().map(|&k| k as usize + 1).max().unwrap_or(0)
}

/// Elements that a core takes at once, at least.
const BATCH: usize = 32;

/// `f` of every element and its number, on all cores.
#[doc(hidden)]
pub fn each<T: Send>(elements: &mut [T], f: impl Fn(u32, &mut T) + Sync) {
    elements.par_iter_mut().with_min_len(BATCH).enumerate().for_each(|(k, element)| f(k as u32, element));
}

/// Runs over the elements of two tables together, in parallel.
#[doc(hidden)]
pub fn each_pair<A: Send, B: Send>(a: &mut [A], b: &mut [B], f: impl Fn(u32, &mut A, &mut B) + Sync) {
    let pairs = a.par_iter_mut().zip(b).with_min_len(BATCH).enumerate();
    pairs.for_each(|(k, (a, b))| f(k as u32, a, b));
}

/// Element k becomes `f(k)`, on all cores.
fn fill<T: Send>(out: &mut [T], f: impl Fn(u32) -> T + Sync) {
    each(out, |k, element| *element = f(k));
}
