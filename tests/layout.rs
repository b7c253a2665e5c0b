//! Shared structures lie in the compiled modules where the host has them, scalar by scalar.

use bytemuck::{Pod, Zeroable};
use firstshot::{AliasEntry, Element, Landing, Photon, PhotonParams};
use formfactor::{GatherParams, HemisphereParams, HitsParams, ReceiverCell, TriangleGrid};
use glam::{UVec2, UVec4, Vec2, Vec3, Vec4};
use gpu_kernels::params::{CountParams, EnterParams, PixelParams, ProjectParams, ToneMapParams};
use gpu_kernels::table::{BindingKind, KERNELS};
use integration_tests::spirv::Module;
use localmatrix::{FadeParams, SlotParams, UpdateParams};
use multibounce::{BlockParams, FeedbackParams, MultiplyParams, TileQuad, TileSquare};
use patches::{GridShape, LookupParams, LookupPatch, Member, VolumeParams};
use scene::{
    BvhNode, Camera, DirectParams, Emitter, Hit, Light, Material, Ray, Sky, SurfacePoint, Texture, Triangle, TriangleUv,
};
use temporal::{SampleParams, SplitParams, SumParams};

/// A structure as the host has it: offsets of its scalars and its size.
#[derive(Clone, Debug, PartialEq)]
struct Layout {
    offsets: Vec<u32>,
    size: u32,
}

/// What a structure is made of.
trait Scalars {
    /// Offsets of the scalars of this type, which starts at `base`.
    fn offsets(base: u32) -> Vec<u32>;
}

macro_rules! words {
    ($($type:ty),*) => {$(
        impl Scalars for $type {
            fn offsets(base: u32) -> Vec<u32> {
                (0..size_of::<$type>() as u32 / 4).map(|k| base + 4 * k).collect()
            }
        }
    )*};
}
words!(u32, f32, Vec2, Vec3, Vec4, UVec2, UVec4, [u32; 2], [u32; 3]);

macro_rules! structure {
    ($type:ty { $($field:ident: $kind:ty),* $(,)? }) => {
        impl Scalars for $type {
            fn offsets(base: u32) -> Vec<u32> {
                // Checked by the compiler: the fields are all there are, and of these types.
                let check = |v: $type| { let Self { $($field),* } = v; $(let _: $kind = $field;)* };
                let _ = check;
                [$(<$kind>::offsets(base + core::mem::offset_of!($type, $field) as u32)),*].concat()
            }
        }
    };
}
structure!(Triangle { corner: Vec3, material: u32, edge_a: Vec3, source: u32, edge_b: Vec3, object: u32 });
structure!(TriangleUv { corner: Vec2, corner_a: Vec2, corner_b: Vec2 });
structure!(BvhNode { min: Vec3, prim_count: u32, max: Vec3, first_index: u32 });
structure!(Material {
    albedo: Vec3,
    albedo_texture: u32,
    radiance: Vec3,
    radiance_texture: u32,
    mask_texture: u32,
    mask_cutoff: f32,
    reserved: [u32; 2],
});
structure!(Texture { offset: u32, width: u32, height: u32, levels: u32 });
structure!(Light {
    position: Vec3,
    kind: u32,
    direction: Vec3,
    cos_inner: f32,
    color: Vec3,
    cos_outer: f32,
    edge_a: Vec3,
    area: f32,
    edge_b: Vec3,
    reserved: u32,
});
structure!(Emitter { triangle: u32, cumulative: f32, probability: f32, area: f32 });
structure!(Sky { radiance: Vec3, map_width: u32, map_height: u32, reserved: [u32; 3] });
structure!(Camera {
    eye: Vec3,
    width: u32,
    forward: Vec3,
    height: u32,
    right: Vec3,
    reserved_a: u32,
    up: Vec3,
    reserved_b: u32,
});
structure!(Ray { origin: Vec3, t_max: f32, direction: Vec3, reserved: u32 });
structure!(Hit { triangle: u32, u: f32, v: f32, t: f32 });
structure!(SurfacePoint { position: Vec3, patch: u32, normal: Vec3, weight: f32 });
structure!(DirectParams {
    count: u32,
    light_count: u32,
    emitter_count: u32,
    area_rays: u32,
    sky_rays: u32,
    seed: u32,
    ray_offset: f32,
    first: u32,
});
structure!(ReceiverCell { first: u32, divisions: u32 });
structure!(TriangleGrid { front: u32, back: u32, divisions: u32, reserved: u32 });
structure!(HemisphereParams {
    first_row: u32,
    row_count: u32,
    rays: u32,
    patch_count: u32,
    seed: u32,
    ray_offset: f32,
    reserved: [u32; 2],
});
structure!(HitsParams { rows: u32, first_quad: u32 });
structure!(GatherParams { rows: u32, vectors: u32, first_row: u32, reserved: u32 });
structure!(BlockParams {
    block_rows: u32,
    block_columns: u32,
    first_block_row: u32,
    rows: u32,
    tile_columns: u32,
    tile_shift: u32,
    companding: u32,
    alpha: u32,
    first_outlier: u32,
});
structure!(AliasEntry { threshold: u32, other: u32 });
structure!(Element {
    values: Vec3,
    scale: f32,
    corner: Vec2,
    edge_a: Vec2,
    edge_b: Vec2,
    kind: u32,
    triangle: u32,
    light: u32,
    is_back: u32,
    reserved: [u32; 2],
});
structure!(Photon { origin: Vec3, reflections: u32, direction: Vec3, segments: u32, flux: Vec3, reserved: u32 });
structure!(Landing { flux: Vec3, triangle: u32, u: f32, v: f32, photon: u32, info: u32 });
structure!(PhotonParams {
    low: Vec3,
    count: u32,
    high: Vec3,
    per_batch: u32,
    first: u32,
    first_batch: u32,
    element_count: u32,
    sequence: u32,
    seed: u32,
    flags: u32,
    ray_offset: f32,
    reserved: u32,
});
structure!(CountParams { count: u32 });
structure!(EnterParams { count: u32, patches: u32 });
structure!(ProjectParams { axes: Vec4, count: u32, reserved: [u32; 3] });
structure!(FeedbackParams { count: u32, step: f32, momentum: f32 });
structure!(MultiplyParams { tiles: u32, row_tiles: u32, vectors: u32, inner: u32, first_inner: u32 });
structure!(TileQuad { group: u32, tag: u32 });
structure!(TileSquare { column: u32, step: f32 });
structure!(PixelParams { camera: Camera, count: u32, seed: u32, light_count: u32, reserved: u32 });
structure!(ToneMapParams { count: u32, scale: f32 });
structure!(SampleParams {
    rows: u32,
    first_row: u32,
    first_entry: u32,
    samples: u32,
    frame: u32,
    seed: u32,
    options: u32,
    blend: f32,
});
structure!(SumParams { count: u32, rows: u32, first: u32, first_entry: u32, options: u32 });
structure!(SplitParams { count: u32, rows: u32 });
structure!(FadeParams { count: u32, keep: f32, has_jump: u32, white: f32 });
structure!(SlotParams { count: u32, slots: u32 });
structure!(UpdateParams {
    count: u32,
    slots: u32,
    rank: u32,
    sign: f32,
    first_vector: u32,
    first_column: u32,
    reserved: [u32; 2],
});
structure!(Member { sample: u32, weight: f32 });
structure!(LookupPatch { position: Vec3, patch: u32, direction: Vec3, reserved: u32 });
structure!(GridShape { origin: Vec3, count_x: u32, edges: Vec3, count_y: u32, count_z: u32, reserved: [u32; 3] });
structure!(LookupParams { shape: GridShape, plane_limit: f32, walls: u32, count: u32, reserved: u32 });
structure!(VolumeParams { shape: GridShape, lift: f32, walls: u32, count: u32, reserved: u32 });

fn layout<T: Scalars>() -> Layout {
    Layout { offsets: T::offsets(0), size: size_of::<T>() as u32 }
}

/// Type of a binding, by its name.
fn element(kernel: &str, binding: &str) -> Layout {
    match binding {
        "rays" => layout::<Ray>(),
        "nodes" => layout::<BvhNode>(),
        "triangles" => layout::<Triangle>(),
        "uvs" => layout::<TriangleUv>(),
        "materials" => layout::<Material>(),
        "textures" => layout::<Texture>(),
        "lights" => layout::<Light>(),
        "emitters" => layout::<Emitter>(),
        "sky" => layout::<Sky>(),
        "hits" => layout::<Hit>(),
        "points" => layout::<SurfacePoint>(),
        "receiver_cells" => layout::<ReceiverCell>(),
        "grids" => layout::<TriangleGrid>(),
        "members" => layout::<Member>(),
        "alias" => layout::<AliasEntry>(),
        "elements" => layout::<Element>(),
        "photons" => layout::<Photon>(),
        "landings" => layout::<Landing>(),
        "entries" if kernel == "patches_lookup" => layout::<LookupPatch>(),
        "columns" | "vectors" | "plane" | "area" | "red" | "green" | "blue" if kernel.starts_with("localmatrix_") => {
            layout::<f32>()
        }
        "light" | "square_words" if kernel == "multibounce_tiles_near" => layout::<UVec4>(),
        "words" | "light" if kernel == "multibounce_tiles_project" => layout::<UVec4>(),
        "words" if kernel == "multibounce_tiles_expand" => layout::<UVec2>(),
        "scales" if kernel == "multibounce_tiles_project" => layout::<Vec4>(),
        "factors" | "partner" if kernel.starts_with("multibounce_tiles_") => layout::<UVec4>(),
        "light" | "runs" if kernel.starts_with("multibounce_tiles_") => layout::<u32>(),
        "light" | "before" | "now" | "offset" | "leaves" => layout::<Vec4>(),
        "runs" => layout::<UVec2>(),
        "starts" | "list" | "lit_starts" | "lit" | "visible_starts" | "visible" | "slot_of" | "leaf_of" => {
            layout::<u32>()
        }
        "quads" if kernel.starts_with("multibounce_tiles_") => layout::<TileQuad>(),
        "square_start" => layout::<u32>(),
        "squares" => layout::<TileSquare>(),
        "order" | "place" | "words" | "run_start" | "entries" => layout::<u32>(),
        "root" | "steps" => layout::<f32>(),
        "ordered" | "sums" | "rows" | "near" => layout::<Vec4>(),
        "texels" | "stopped" | "pixels" | "offsets" | "ids" | "row_start" | "columns" | "counts" | "vertices"
        | "cells" | "probes" => layout::<u32>(),
        "slots" | "colors" | "weights" => layout::<u32>(),
        "row_sums" => layout::<f32>(),
        "change" | "operator" | "next" => layout::<Vec4>(),
        "scan" => layout::<UVec2>(),
        "planes" => layout::<f32>(),
        "factors" if kernel == "formfactor_hemisphere_row" => layout::<f32>(),
        "factors" if kernel == "formfactor_gather_half" => layout::<UVec2>(),
        "values" if kernel == "formfactor_gather_csr" => layout::<f32>(),
        "scales" => layout::<f32>(),
        "quads" | "outliers" => layout::<UVec2>(),
        "blocks" if kernel == "multibounce_blocks_gather_bc1" => layout::<UVec2>(),
        "blocks" => layout::<UVec4>(),
        "factors" | "values" | "sky_map" | "irradiance" | "direct" | "indirect" | "sum" | "source" | "albedo"
        | "tile_scales" | "scale" | "input" | "output" | "emission" | "exitance" | "means" | "cubes" | "harmonics" => {
            layout::<Vec4>()
        }
        other => panic!("{kernel}: say the type of the binding {other} here"),
    }
}

/// Type of the push constants of a kernel.
fn push(kernel: &str) -> Layout {
    match kernel {
        "scene_direct_light" => layout::<DirectParams>(),
        "scene_primary" | "scene_shade" => layout::<PixelParams>(),
        "scene_tone_map" => layout::<ToneMapParams>(),
        k if k.starts_with("formfactor_hemisphere") => layout::<HemisphereParams>(),
        "formfactor_gather" | "formfactor_gather_half" | "formfactor_gather_image" | "formfactor_gather_half_image" => {
            layout::<GatherParams>()
        }
        "formfactor_gather_hits" => layout::<HitsParams>(),
        k if k.starts_with("firstshot_") => layout::<PhotonParams>(),
        "multibounce_tiles_enter" => layout::<EnterParams>(),
        "multibounce_tiles_project" => layout::<ProjectParams>(),
        "multibounce_feedback" => layout::<FeedbackParams>(),
        "multibounce_multiply" => layout::<MultiplyParams>(),
        k if k.starts_with("multibounce_blocks_gather") => layout::<BlockParams>(),
        k if k.starts_with("temporal_sample") => layout::<SampleParams>(),
        k if k.starts_with("temporal_sum") => layout::<SumParams>(),
        k if k.starts_with("temporal_split") => layout::<SplitParams>(),
        "localmatrix_count" | "localmatrix_product" => layout::<SlotParams>(),
        "localmatrix_fade" => layout::<FadeParams>(),
        "localmatrix_update" => layout::<UpdateParams>(),
        "patches_lookup" => layout::<LookupParams>(),
        "patches_volume_lookup" | "patches_volume_lookup_sh" => layout::<VolumeParams>(),
        _ => layout::<CountParams>(),
    }
}

#[test]
fn buffers_have_the_hosts_layout() {
    let mut compared = 0;
    for kernel in KERNELS {
        let module = Module::parse(kernel.spv).unwrap();
        for resource in module.resources() {
            let row = &kernel.bindings[resource.binding as usize];
            let BindingKind::Storage { stride } = row.kind else { continue };
            let expected = element(kernel.name, row.name);
            let (id, module_stride) = module.buffer_element(resource.pointee).expect("a buffer is an array");
            let mut found = Layout { offsets: Vec::new(), size: module_stride };
            module.scalar_offsets(id, 0, &mut found.offsets);
            assert_eq!(found, expected, "{}: {}", kernel.name, row.name);
            assert_eq!(stride, expected.size, "{}: {}", kernel.name, row.name);
            compared += 1;
        }
    }
    let is_buffer = |kind: BindingKind| matches!(kind, BindingKind::Storage { .. });
    let buffers = KERNELS.iter().flat_map(|k| k.bindings).filter(|b| is_buffer(b.kind)).count();
    // tests/spv.rs names the two bindings that no module uses.
    assert_eq!(compared, buffers - 2);
}

#[test]
fn push_constants_have_the_hosts_layout() {
    for kernel in KERNELS {
        let module = Module::parse(kernel.spv).unwrap();
        let id = module.push_constants().unwrap_or_else(|| panic!("{}: no push constants", kernel.name));
        let mut offsets = Vec::new();
        let end = module.scalar_offsets(id, 0, &mut offsets);
        let expected = push(kernel.name);
        assert_eq!(Layout { offsets, size: end }, expected, "{}", kernel.name);
        assert_eq!(kernel.push_bytes, expected.size, "{}", kernel.name);
        assert!(kernel.push_bytes <= 128 && kernel.push_bytes % 4 == 0);
    }
}

#[test]
fn a_field_in_another_place_is_noticed() {
    #[repr(C)]
    #[derive(Clone, Copy, Pod, Zeroable)]
    struct Moved {
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        reserved: u32,
        more: u32,
    }
    structure!(Moved { origin: Vec3, direction: Vec3, t_max: f32, reserved: u32, more: u32 });
    let kernel = KERNELS.iter().find(|k| k.name == "scene_closest_hit").unwrap();
    let module = Module::parse(kernel.spv).unwrap();
    let (id, stride) = module.buffer_element(module.resources()[0].pointee).unwrap();
    let mut offsets = Vec::new();
    module.scalar_offsets(id, 0, &mut offsets);
    assert_eq!(Layout { offsets: offsets.clone(), size: stride }, layout::<Ray>());
    assert_ne!(Layout { offsets, size: stride }, layout::<Moved>());
}
