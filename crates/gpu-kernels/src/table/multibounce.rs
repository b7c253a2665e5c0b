//! Kernels of the multi-bounce matrix: texture blocks, tiles, feedback.

use ::multibounce::{BlockParams, FeedbackParams, MultiplyParams, TileQuad, TileSquare};
use ::scene::Rgb;
use glam::{UVec2, UVec4, Vec4};

use super::{Access, Aligned, ImageFormat, Kernel, buffer, image, read, write};
use crate::host;
use crate::invocation::WORKGROUP;
use crate::params::{CountParams, EnterParams, ProjectParams};

/// Product with a matrix in blocks of BC1 (`multibounce::BlockMatrix`), decoded in the kernel. An element is a row of blocks;
/// `exitance` and `irradiance` are in the order of the blocks, `exitance` holds 4 elements for each column of blocks.
pub static MULTIBOUNCE_BLOCKS_GATHER_BC1: Kernel = Kernel {
    name: "multibounce_blocks_gather_bc1",
    spv: spv!("multibounce_blocks_gather_bc1"),
    workgroup: WORKGROUP,
    elements_per_group: 1,
    push_bytes: size_of::<BlockParams>() as u32,
    bindings: &[
        read::<UVec2>("blocks"),
        read::<Vec4>("tile_scales"),
        read::<u32>("row_start"),
        read::<UVec2>("outliers"),
        read::<Rgb>("exitance"),
        write::<Rgb>("irradiance"),
    ],
    host: host::multibounce::blocks_gather_bc1,
};

/// The same with blocks of BC3.
pub static MULTIBOUNCE_BLOCKS_GATHER_BC3: Kernel = Kernel {
    name: "multibounce_blocks_gather_bc3",
    spv: spv!("multibounce_blocks_gather_bc3"),
    workgroup: WORKGROUP,
    elements_per_group: 1,
    push_bytes: size_of::<BlockParams>() as u32,
    bindings: &[
        read::<UVec4>("blocks"),
        read::<Vec4>("tile_scales"),
        read::<u32>("row_start"),
        read::<UVec2>("outliers"),
        read::<Rgb>("exitance"),
        write::<Rgb>("irradiance"),
    ],
    host: host::multibounce::blocks_gather_bc3,
};

/// The same with blocks of BC6H.
pub static MULTIBOUNCE_BLOCKS_GATHER_BC6H: Kernel = Kernel {
    name: "multibounce_blocks_gather_bc6h",
    spv: spv!("multibounce_blocks_gather_bc6h"),
    workgroup: WORKGROUP,
    elements_per_group: 1,
    push_bytes: size_of::<BlockParams>() as u32,
    bindings: &[
        read::<UVec4>("blocks"),
        read::<Vec4>("tile_scales"),
        read::<u32>("row_start"),
        read::<UVec2>("outliers"),
        read::<Rgb>("exitance"),
        write::<Rgb>("irradiance"),
    ],
    host: host::multibounce::blocks_gather_bc6h,
};

/// The same with blocks of BC7.
pub static MULTIBOUNCE_BLOCKS_GATHER_BC7: Kernel = Kernel {
    name: "multibounce_blocks_gather_bc7",
    spv: spv!("multibounce_blocks_gather_bc7"),
    workgroup: WORKGROUP,
    elements_per_group: 1,
    push_bytes: size_of::<BlockParams>() as u32,
    bindings: &[
        read::<UVec4>("blocks"),
        read::<Vec4>("tile_scales"),
        read::<u32>("row_start"),
        read::<UVec2>("outliers"),
        read::<Rgb>("exitance"),
        write::<Rgb>("irradiance"),
    ],
    host: host::multibounce::blocks_gather_bc7,
};

/// The same with blocks of any format as an image, 4 texels for each block each way, decoded by the texture unit.
pub static MULTIBOUNCE_BLOCKS_GATHER_IMAGE: Kernel = Kernel {
    name: "multibounce_blocks_gather_image",
    spv: spv!("multibounce_blocks_gather_image"),
    workgroup: WORKGROUP,
    elements_per_group: 1,
    push_bytes: size_of::<BlockParams>() as u32,
    bindings: &[
        image("blocks", ImageFormat::BLOCKS),
        read::<Vec4>("tile_scales"),
        read::<u32>("row_start"),
        read::<UVec2>("outliers"),
        read::<Rgb>("exitance"),
        write::<Rgb>("irradiance"),
    ],
    host: host::multibounce::blocks_gather_image,
};

/// A vector in another order, each element scaled. An element is one of the result.
pub static MULTIBOUNCE_REORDER: Kernel = Kernel {
    name: "multibounce_reorder",
    spv: spv!("multibounce_reorder"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[read::<u32>("order"), read::<Vec4>("scale"), read::<Rgb>("input"), write::<Rgb>("output")],
    host: host::multibounce::reorder,
};

/// Exitance in the order of tiles, times √a. An element is a place, of whole blocks.
pub static MULTIBOUNCE_TILES_ENTER: Kernel = Kernel {
    name: "multibounce_tiles_enter",
    spv: spv!("multibounce_tiles_enter"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<EnterParams>() as u32,
    bindings: &[read::<u32>("order"), read::<f32>("root"), read::<Rgb>("exitance"), write::<Rgb>("ordered")],
    host: host::tiles::enter,
};

/// Exitance of the blocks of tiles in whole numbers. An element is four lanes of a block.
pub static MULTIBOUNCE_TILES_ROUND: Kernel = Kernel {
    name: "multibounce_tiles_round",
    spv: spv!("multibounce_tiles_round"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[read::<Rgb>("ordered"), write::<u32>("light")],
    host: host::tiles::round,
};

/// Sums of the vectors of tiles (`multibounce::Tiles`). An element is a part of a run, four
/// quads of slots at most.
pub static MULTIBOUNCE_TILES_PROJECT: Kernel = Kernel {
    name: "multibounce_tiles_project",
    spv: spv!("multibounce_tiles_project"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<ProjectParams>() as u32,
    bindings: &[
        read::<u32>("runs"),
        read::<TileQuad>("quads"),
        read::<UVec4>("words"),
        read::<Vec4>("scales"),
        read::<UVec4>("light"),
        write::<Rgb>("sums"),
    ],
    host: host::tiles::project,
};

/// What the vectors of tiles are multiplied by, in whole numbers. An element is a run of quads.
pub static MULTIBOUNCE_TILES_WEIGH: Kernel = Kernel {
    name: "multibounce_tiles_weigh",
    spv: spv!("multibounce_tiles_weigh"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[read::<u32>("runs"), read::<UVec4>("partner"), read::<Rgb>("sums"), write::<UVec4>("factors")],
    host: host::tiles::weigh,
};

/// Rows of the tiles, those of a block's splits one after another. An element is two lanes of a split of a
/// block: a row of each of their parts.
pub static MULTIBOUNCE_TILES_EXPAND: Kernel = Kernel {
    name: "multibounce_tiles_expand",
    spv: spv!("multibounce_tiles_expand"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[
        read::<u32>("run_start"),
        read::<u32>("runs"),
        read::<TileQuad>("quads"),
        read::<UVec2>("words"),
        read::<UVec4>("factors"),
        write::<Rgb>("rows"),
    ],
    host: host::tiles::expand,
};

/// Rows of the squares and of the single entries of tiles. An element is eight places of the order. `ordered` has room for every
/// place that entries can name.
pub static MULTIBOUNCE_TILES_NEAR: Kernel = Kernel {
    name: "multibounce_tiles_near",
    spv: spv!("multibounce_tiles_near"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[
        read::<u32>("square_start"),
        read::<TileSquare>("squares"),
        read::<UVec4>("square_words"),
        read::<UVec4>("light"),
        read::<u32>("row_start"),
        read::<u32>("entries"),
        read::<f32>("steps"),
        read::<Rgb>("ordered"),
        write::<Rgb>("near"),
    ],
    host: host::tiles::near,
};

/// Irradiance of the patches from the rows of tiles, W/m². An element is a patch.
pub static MULTIBOUNCE_TILES_LEAVE: Kernel = Kernel {
    name: "multibounce_tiles_leave",
    spv: spv!("multibounce_tiles_leave"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[
        read::<u32>("place"),
        read::<f32>("root"),
        read::<Rgb>("rows"),
        read::<Rgb>("near"),
        write::<Rgb>("irradiance"),
    ],
    host: host::tiles::leave,
};

/// A bounce that begins with the light of the frame before: the change of exitance and the exitance, W/m². An element is a
/// patch.
pub static MULTIBOUNCE_FEEDBACK: Kernel = Kernel {
    name: "multibounce_feedback",
    spv: spv!("multibounce_feedback"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<FeedbackParams>() as u32,
    bindings: &[
        read::<Rgb>("source"),
        read::<Rgb>("albedo"),
        read::<Rgb>("irradiance"),
        buffer::<Rgb>("change", Access::ReadWrite),
        buffer::<Rgb>("exitance", Access::ReadWrite),
    ],
    host: host::multibounce::feedback,
};

/// A step of Horner's rule, `F + F diag(ρ) T`: some rows of it, with some rows of T. An element is a tile of
/// `multibounce::kernel::multiply::TILE_ROWS` rows and `TILE_VECTORS` vectors of four columns. `factors` and `next` hold the same
/// rows; with another than the first rows of T, sums go on from what `next` has.
pub static MULTIBOUNCE_MULTIPLY: Kernel = Kernel {
    name: "multibounce_multiply",
    spv: spv!("multibounce_multiply"),
    workgroup: WORKGROUP,
    elements_per_group: 1,
    push_bytes: size_of::<MultiplyParams>() as u32,
    bindings: &[
        read::<Vec4>("factors"),
        read::<Vec4>("albedo"),
        read::<Vec4>("operator"),
        buffer::<Vec4>("next", Access::ReadWrite),
    ],
    host: host::multibounce::multiply,
};
