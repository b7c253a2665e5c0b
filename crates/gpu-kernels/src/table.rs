//! What the host knows of each kernel: name, module, bindings, how many elements a workgroup takes, and its host form.

mod row;

pub use row::{Access, Binding, BindingKind, ImageFormat, Kernel, MAX_GROUPS_X};

use ::firstshot::{AliasEntry, Element, Landing, Photon, PhotonParams};
use ::formfactor::kernel::product::ROWS_TOGETHER;
use ::formfactor::{GatherParams, HemisphereParams, HitsParams, ReceiverCell, TriangleGrid};
use ::patches::{LookupParams, LookupPatch, Member, VolumeParams};
use ::scene::{
    BvhNode, DirectParams, Emitter, Hit, Light, Material, Ray, Rgb, Sky, SurfacePoint, Texture, Triangle, TriangleUv,
};
use glam::{UVec2, Vec4};

use crate::host;
use crate::invocation::WORKGROUP;
use crate::params::{CountParams, PixelParams, ToneMapParams};

/// Module bytes on a word boundary.
#[repr(C, align(4))]
struct Aligned<T: ?Sized>(T);

macro_rules! spv {
    ($name:literal) => {{
        static MODULE: &Aligned<[u8]> =
            &Aligned(*include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/spv/", $name, ".spv")));
        &MODULE.0
    }};
}

mod localmatrix;
mod multibounce;
mod temporal;

pub use localmatrix::*;
pub use multibounce::*;
pub use temporal::*;

const fn buffer<T>(name: &'static str, access: Access) -> Binding {
    Binding { name, access, kind: BindingKind::Storage { stride: size_of::<T>() as u32 } }
}

const fn image(name: &'static str, formats: &'static [ImageFormat]) -> Binding {
    Binding { name, access: Access::Read, kind: BindingKind::SampledImage { formats } }
}

const fn read<T>(name: &'static str) -> Binding {
    buffer::<T>(name, Access::Read)
}

const fn write<T>(name: &'static str) -> Binding {
    buffer::<T>(name, Access::Write)
}

/// Every kernel, in the order of the methods.
pub static KERNELS: &[&Kernel] = &[
    &SCENE_CLOSEST_HIT,
    &SCENE_ANY_HIT,
    &SCENE_DIRECT_LIGHT,
    &SCENE_PRIMARY,
    &SCENE_SHADE,
    &SCENE_TONE_MAP,
    &FORMFACTOR_HEMISPHERE_HITS,
    &FORMFACTOR_HEMISPHERE_ROW,
    &FORMFACTOR_ASSEMBLE_SOURCE,
    &FORMFACTOR_GATHER,
    &FORMFACTOR_GATHER_HALF,
    &FORMFACTOR_GATHER_IMAGE,
    &FORMFACTOR_GATHER_HALF_IMAGE,
    &FORMFACTOR_GATHER_CSR,
    &FORMFACTOR_GATHER_HITS,
    &FORMFACTOR_BOUNCE,
    &FORMFACTOR_INTERPOLATE,
    &MULTIBOUNCE_BLOCKS_GATHER_BC1,
    &MULTIBOUNCE_BLOCKS_GATHER_BC3,
    &MULTIBOUNCE_BLOCKS_GATHER_BC6H,
    &MULTIBOUNCE_BLOCKS_GATHER_BC7,
    &MULTIBOUNCE_BLOCKS_GATHER_IMAGE,
    &MULTIBOUNCE_REORDER,
    &PATCHES_GATHER_MEAN,
    &PATCHES_LOOKUP,
    &PATCHES_VOLUME_LOOKUP,
    &PATCHES_VOLUME_LOOKUP_SH,
    &MULTIBOUNCE_TILES_ENTER,
    &MULTIBOUNCE_TILES_ROUND,
    &MULTIBOUNCE_TILES_PROJECT,
    &MULTIBOUNCE_TILES_WEIGH,
    &MULTIBOUNCE_TILES_EXPAND,
    &MULTIBOUNCE_TILES_NEAR,
    &MULTIBOUNCE_TILES_LEAVE,
    &MULTIBOUNCE_FEEDBACK,
    &MULTIBOUNCE_MULTIPLY,
    &TEMPORAL_CHANGE,
    &TEMPORAL_SAMPLE_LISTS,
    &TEMPORAL_SAMPLE_TABLES,
    &TEMPORAL_SUM_LISTS,
    &TEMPORAL_SUM_TABLES,
    &TEMPORAL_SPLIT_SCAN,
    &TEMPORAL_SPLIT_PACK,
    &LOCALMATRIX_MEAN,
    &LOCALMATRIX_COUNT,
    &LOCALMATRIX_START,
    &LOCALMATRIX_COMPACT,
    &LOCALMATRIX_PRODUCT,
    &LOCALMATRIX_SPREAD,
    &LOCALMATRIX_FADE,
    &LOCALMATRIX_SHOW,
    &LOCALMATRIX_UPDATE,
    &FIRSTSHOT_START,
    &FIRSTSHOT_SEGMENT,
];

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

/// 1 for every ray that is stopped, else 0. An element is a ray.
pub static SCENE_ANY_HIT: Kernel = Kernel {
    name: "scene_any_hit",
    spv: spv!("scene_any_hit"),
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
        write::<u32>("stopped"),
    ],
    host: host::scene::any_hit,
};

/// Direct irradiance at every point, W/m². An element is a point.
pub static SCENE_DIRECT_LIGHT: Kernel = Kernel {
    name: "scene_direct_light",
    spv: spv!("scene_direct_light"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<DirectParams>() as u32,
    bindings: &[
        read::<SurfacePoint>("points"),
        read::<BvhNode>("nodes"),
        read::<Triangle>("triangles"),
        read::<TriangleUv>("uvs"),
        read::<Material>("materials"),
        read::<Texture>("textures"),
        read::<u32>("texels"),
        read::<Light>("lights"),
        read::<Emitter>("emitters"),
        read::<Sky>("sky"),
        read::<Rgb>("sky_map"),
        write::<Rgb>("irradiance"),
    ],
    host: host::scene::direct_light,
};

/// What every pixel's primary ray meets. An element is a pixel.
pub static SCENE_PRIMARY: Kernel = Kernel {
    name: "scene_primary",
    spv: spv!("scene_primary"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<PixelParams>() as u32,
    bindings: &[
        read::<BvhNode>("nodes"),
        read::<Triangle>("triangles"),
        read::<TriangleUv>("uvs"),
        read::<Material>("materials"),
        read::<Texture>("textures"),
        read::<u32>("texels"),
        write::<Hit>("hits"),
        write::<SurfacePoint>("points"),
    ],
    host: host::scene::primary,
};

/// Adds the radiance of one sub-frame to every pixel's sum, W/m²/sr. An element is a pixel.
pub static SCENE_SHADE: Kernel = Kernel {
    name: "scene_shade",
    spv: spv!("scene_shade"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<PixelParams>() as u32,
    bindings: &[
        read::<Hit>("hits"),
        read::<Rgb>("direct"),
        read::<Rgb>("indirect"),
        read::<BvhNode>("nodes"),
        read::<Triangle>("triangles"),
        read::<TriangleUv>("uvs"),
        read::<Material>("materials"),
        read::<Texture>("textures"),
        read::<u32>("texels"),
        read::<Light>("lights"),
        read::<Emitter>("emitters"),
        read::<Sky>("sky"),
        read::<Rgb>("sky_map"),
        buffer::<Rgb>("sum", Access::ReadWrite),
    ],
    host: host::scene::shade,
};

/// Displayed colour of every pixel, bytes r, g, b, 255. An element is a pixel.
pub static SCENE_TONE_MAP: Kernel = Kernel {
    name: "scene_tone_map",
    spv: spv!("scene_tone_map"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<ToneMapParams>() as u32,
    bindings: &[read::<Rgb>("sum"), write::<u32>("pixels")],
    host: host::scene::tone_map,
};

/// Column of what every hemisphere ray of a block of rows meets. An element is a ray: `row_count · rays`.
pub static FORMFACTOR_HEMISPHERE_HITS: Kernel = Kernel {
    name: "formfactor_hemisphere_hits",
    spv: spv!("formfactor_hemisphere_hits"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<HemisphereParams>() as u32,
    bindings: &[
        read::<u32>("offsets"),
        read::<SurfacePoint>("points"),
        read::<TriangleGrid>("grids"),
        read::<BvhNode>("nodes"),
        read::<Triangle>("triangles"),
        read::<TriangleUv>("uvs"),
        read::<Material>("materials"),
        read::<Texture>("textures"),
        read::<u32>("texels"),
        write::<u32>("ids"),
    ],
    host: host::formfactor::hemisphere_hits,
};

/// Rows of F from the columns that their rays met. An element is a row of the block.
pub static FORMFACTOR_HEMISPHERE_ROW: Kernel = Kernel {
    name: "formfactor_hemisphere_row",
    spv: spv!("formfactor_hemisphere_row"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<HemisphereParams>() as u32,
    bindings: &[
        read::<u32>("offsets"),
        read::<SurfacePoint>("points"),
        read::<u32>("ids"),
        buffer::<f32>("factors", Access::ReadWrite),
    ],
    host: host::formfactor::hemisphere_row,
};

/// First exitance of every patch, W/m². An element is a patch.
pub static FORMFACTOR_ASSEMBLE_SOURCE: Kernel = Kernel {
    name: "formfactor_assemble_source",
    spv: spv!("formfactor_assemble_source"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[
        read::<u32>("offsets"),
        read::<SurfacePoint>("points"),
        read::<Rgb>("direct"),
        read::<Rgb>("emission"),
        read::<Rgb>("albedo"),
        write::<Rgb>("source"),
    ],
    host: host::formfactor::assemble_source,
};

/// Dense product of a block of rows, for devices with fast shared memory. An element is a row. `exitance` holds
/// `4 · vectors` elements, finite beyond the senders.
pub static FORMFACTOR_GATHER: Kernel = Kernel {
    name: "formfactor_gather",
    spv: spv!("formfactor_gather"),
    workgroup: WORKGROUP,
    elements_per_group: ROWS_TOGETHER,
    push_bytes: size_of::<GatherParams>() as u32,
    bindings: &[read::<Vec4>("factors"), read::<Rgb>("exitance"), write::<Rgb>("irradiance")],
    host: host::formfactor::gather,
};

/// The same with factors as half-precision numbers, four in two words.
pub static FORMFACTOR_GATHER_HALF: Kernel = Kernel {
    name: "formfactor_gather_half",
    spv: spv!("formfactor_gather_half"),
    workgroup: WORKGROUP,
    elements_per_group: ROWS_TOGETHER,
    push_bytes: size_of::<GatherParams>() as u32,
    bindings: &[read::<UVec2>("factors"), read::<Rgb>("exitance"), write::<Rgb>("irradiance")],
    host: host::formfactor::gather_half,
};

/// The same for devices whose texel fetches are faster than buffer loads. `factors` is an image of `vectors` × `rows`
/// texels, `exitance` one of [`VECTOR_IMAGE_WIDTH`](::formfactor::kernel::product::VECTOR_IMAGE_WIDTH) columns.
pub static FORMFACTOR_GATHER_IMAGE: Kernel = Kernel {
    name: "formfactor_gather_image",
    spv: spv!("formfactor_gather_image"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP * ROWS_TOGETHER,
    push_bytes: size_of::<GatherParams>() as u32,
    bindings: &[
        image("factors", &[ImageFormat::Rgba32Float]),
        image("exitance", &[ImageFormat::Rgba32Float]),
        write::<Rgb>("irradiance"),
    ],
    host: host::formfactor::gather_image,
};

/// The same with factors as half-precision texels.
pub static FORMFACTOR_GATHER_HALF_IMAGE: Kernel = Kernel {
    name: "formfactor_gather_half_image",
    spv: spv!("formfactor_gather_half_image"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP * ROWS_TOGETHER,
    push_bytes: size_of::<GatherParams>() as u32,
    bindings: &[
        image("factors", &[ImageFormat::Rgba16Float]),
        image("exitance", &[ImageFormat::Rgba32Float]),
        write::<Rgb>("irradiance"),
    ],
    host: host::formfactor::gather_half_image,
};

/// Product with compressed sparse rows. An element is a row.
pub static FORMFACTOR_GATHER_CSR: Kernel = Kernel {
    name: "formfactor_gather_csr",
    spv: spv!("formfactor_gather_csr"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[
        read::<u32>("row_start"),
        read::<u32>("columns"),
        read::<f32>("values"),
        read::<Rgb>("exitance"),
        write::<Rgb>("irradiance"),
    ],
    host: host::formfactor::gather_csr,
};

/// Product with rows of counts of hits (`formfactor::HitRows`). An element is a row.
pub static FORMFACTOR_GATHER_HITS: Kernel = Kernel {
    name: "formfactor_gather_hits",
    spv: spv!("formfactor_gather_hits"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<HitsParams>() as u32,
    bindings: &[
        read::<u32>("row_start"),
        read::<UVec2>("quads"),
        read::<u32>("counts"),
        read::<f32>("scales"),
        read::<Rgb>("exitance"),
        write::<Rgb>("irradiance"),
    ],
    host: host::formfactor::gather_hits,
};

/// Exitance of every patch after a bounce, W/m². An element is a patch.
pub static FORMFACTOR_BOUNCE: Kernel = Kernel {
    name: "formfactor_bounce",
    spv: spv!("formfactor_bounce"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[read::<Rgb>("source"), read::<Rgb>("albedo"), read::<Rgb>("irradiance"), write::<Rgb>("exitance")],
    host: host::formfactor::bounce,
};

/// Irradiance of the receivers at every pixel, W/m². An element is a pixel.
pub static FORMFACTOR_INTERPOLATE: Kernel = Kernel {
    name: "formfactor_interpolate",
    spv: spv!("formfactor_interpolate"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[
        read::<Hit>("hits"),
        read::<SurfacePoint>("points"),
        read::<Triangle>("triangles"),
        read::<TriangleGrid>("grids"),
        read::<ReceiverCell>("receiver_cells"),
        read::<u32>("vertices"),
        read::<Rgb>("values"),
        write::<Rgb>("irradiance"),
    ],
    host: host::formfactor::interpolate,
};

/// Mean of a quantity over the samples of every patch, as of the first exitance, W/m². An element is a patch.
pub static PATCHES_GATHER_MEAN: Kernel = Kernel {
    name: "patches_gather_mean",
    spv: spv!("patches_gather_mean"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<CountParams>() as u32,
    bindings: &[read::<u32>("offsets"), read::<Member>("members"), read::<Rgb>("values"), write::<Rgb>("means")],
    host: host::patches::gather_mean,
};

/// Value of the patches round every point, W/m² for irradiance. An element is a point.
pub static PATCHES_LOOKUP: Kernel = Kernel {
    name: "patches_lookup",
    spv: spv!("patches_lookup"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<LookupParams>() as u32,
    bindings: &[
        read::<u32>("cells"),
        read::<u32>("offsets"),
        read::<LookupPatch>("entries"),
        read::<Rgb>("values"),
        read::<SurfacePoint>("points"),
        write::<Rgb>("irradiance"),
    ],
    host: host::patches::lookup,
};

/// Irradiance of the ambient cubes round every point, W/m². An element is a point.
pub static PATCHES_VOLUME_LOOKUP: Kernel = Kernel {
    name: "patches_volume_lookup",
    spv: spv!("patches_volume_lookup"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<VolumeParams>() as u32,
    bindings: &[
        read::<u32>("probes"),
        read::<f32>("planes"),
        read::<Rgb>("cubes"),
        read::<SurfacePoint>("points"),
        write::<Rgb>("irradiance"),
    ],
    host: host::patches::volume_lookup,
};

/// The same of spherical harmonics of degree 1, four coefficients a probe.
pub static PATCHES_VOLUME_LOOKUP_SH: Kernel = Kernel {
    name: "patches_volume_lookup_sh",
    spv: spv!("patches_volume_lookup_sh"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<VolumeParams>() as u32,
    bindings: &[
        read::<u32>("probes"),
        read::<f32>("planes"),
        read::<Rgb>("harmonics"),
        read::<SurfacePoint>("points"),
        write::<Rgb>("irradiance"),
    ],
    host: host::patches::volume_lookup_sh,
};

/// Every photon as it leaves what it starts from. An element is a photon.
pub static FIRSTSHOT_START: Kernel = Kernel {
    name: "firstshot_start",
    spv: spv!("firstshot_start"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<PhotonParams>() as u32,
    bindings: &[
        read::<AliasEntry>("alias"),
        read::<Element>("elements"),
        read::<BvhNode>("nodes"),
        read::<Triangle>("triangles"),
        read::<TriangleUv>("uvs"),
        read::<Material>("materials"),
        read::<Texture>("textures"),
        read::<u32>("texels"),
        read::<Light>("lights"),
        read::<Sky>("sky"),
        read::<Rgb>("sky_map"),
        write::<Photon>("photons"),
    ],
    host: host::firstshot::start,
};

/// The next segment of every photon: its landing, and the photon as it goes on. An element is a photon.
pub static FIRSTSHOT_SEGMENT: Kernel = Kernel {
    name: "firstshot_segment",
    spv: spv!("firstshot_segment"),
    workgroup: WORKGROUP,
    elements_per_group: WORKGROUP,
    push_bytes: size_of::<PhotonParams>() as u32,
    bindings: &[
        read::<BvhNode>("nodes"),
        read::<Triangle>("triangles"),
        read::<TriangleUv>("uvs"),
        read::<Material>("materials"),
        read::<Texture>("textures"),
        read::<u32>("texels"),
        buffer::<Photon>("photons", Access::ReadWrite),
        write::<Landing>("landings"),
    ],
    host: host::firstshot::segment,
};
