//! Device resource of a slot of the graph, and the handles that a caller's own shaders read.

use ash::vk;

use super::buffer::{Buffer, Image};
use super::commands::{Commands, FETCHED};

/// Device resource of a slot of the graph.
pub(super) enum Resource {
    Buffer(Buffer),
    Image(Image),
}

impl Resource {
    /// Unit into which a transfer may be cut: bytes, or rows of a picture's texels or blocks.
    pub fn unit(&self) -> u64 {
        match self {
            Self::Buffer(_) => 1,
            Self::Image(image) => image.row_bytes(),
        }
    }

    /// Returns true if zeros must be copied into it, because blocks cannot be cleared.
    pub fn is_blocks(&self) -> bool {
        matches!(self, Self::Image(image) if image.is_blocks())
    }

    /// Prepares a new buffer or picture: zeros, but for pictures of blocks, which get the layout only.
    pub fn initialise(&self, commands: &Commands<'_>) {
        match self {
            Self::Buffer(buffer) => commands.clear_buffer(buffer),
            Self::Image(image) if image.is_blocks() => {
                commands.change_layout(image, vk::ImageLayout::UNDEFINED, FETCHED);
            }
            Self::Image(image) => commands.clear_image(image, vk::ImageLayout::UNDEFINED),
        }
    }
}

/// A storage buffer of the loaded plan, for a caller's own shaders on the same device.
///
/// Layout: the elements of the kernel table's binding, without a gap, in the order of their indices. An RGB value is a
/// `Vec4` of 16 bytes (`vec4` in GLSL, `float4` in HLSL) whose `w` is unused; scalars are 4 bytes; structures are those
/// of the method's `types.rs`, in the layout of `std430`.
///
/// Usage: `VK_BUFFER_USAGE_STORAGE_BUFFER_BIT`, `_VERTEX_BUFFER_BIT`, `_UNIFORM_TEXEL_BUFFER_BIT`, `_TRANSFER_SRC_BIT`
/// and `_TRANSFER_DST_BIT`. Sharing mode: `VK_SHARING_MODE_EXCLUSIVE`, owned by the executor's queue family; another
/// family needs an ownership transfer. The handle is valid until the next [`load`](crate::executor::Executor::load), or
/// until the executor is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferHandle {
    /// The buffer.
    pub buffer: vk::Buffer,
    /// Offset of the contents, in bytes.
    pub offset: u64,
    /// Number of bytes of the contents.
    pub bytes: u64,
}
