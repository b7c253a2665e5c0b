//! The order of invocations changes nothing: every entry point is called on the host forward, reversed and shuffled, and
//! gives the bytes of its host form. Kernels whose workgroups share memory, or that fetch from images, cannot be called
//! on the host; their host forms run over blocks of rows in different orders, and on one and two threads.

use std::collections::BTreeMap;

use bytemuck::Pod;
use firstshot::{Landing, Photon, PhotonParams};
use formfactor::{GatherParams, HemisphereParams, HitsParams};
use glam::{UVec2, UVec3, UVec4, Vec4};
use gpu_kernels::table::{ImageFormat, MAX_GROUPS_X};
use gpu_kernels::{
    firstshot as fs, formfactor as ff, localmatrix as lm, multibounce as mb, patches as pa, scene as sc,
    temporal as te, tiles as ti,
};
use integration_tests::kernels::{Bytes, Data, Input, inputs};
use localmatrix::{FadeParams, SlotParams, UpdateParams};
use multibounce::{FeedbackParams, MultiplyParams};
use patches::{LookupParams, VolumeParams};
use scene::sampling::hash3;
use scene::{DirectParams, Hit, SurfacePoint};
use temporal::{SampleParams, SplitParams, SumParams};

/// Which orders are tried.
fn orders(invocations: u32) -> [(&'static str, Vec<u32>); 3] {
    let forward: Vec<u32> = (0..invocations).collect();
    let reversed = forward.iter().rev().copied().collect();
    let mut shuffled = forward.clone();
    shuffled.sort_by_key(|k| hash3(*k, 1, 2));
    [("forward", forward), ("reversed", reversed), ("shuffled", shuffled)]
}

/// Calls `entry(id, groups, output)` for every invocation of a dispatch that is `width` workgroups wide.
fn dispatch<T: Pod>(
    input: &Input,
    order: &[u32],
    width: u32,
    output: usize,
    mut entry: impl FnMut(UVec3, UVec3, &mut [T]),
) -> Bytes {
    let [x, y, _] = input.kernel.groups(input.elements);
    let height = (x * y).div_ceil(width);
    let groups = UVec3::new(width, height, 1);
    let Data::Buffer(bytes) = &input.bindings[output] else { panic!("an image is never written") };
    let mut bytes = bytes.clone();
    let row = width * input.kernel.workgroup;
    for k in order {
        entry(UVec3::new(k % row, k / row, 0), groups, bytemuck::cast_slice_mut(bytes.bytes_mut()));
    }
    bytes
}

/// Runs an entry point over all its invocations; `None` for those that cannot be called on the host.
fn run_entry(i: &Input, order: &[u32], width: u32) -> Option<BTreeMap<usize, Bytes>> {
    macro_rules! entry {
        // The output is the last binding.
        ($function:path, $push:ty, $out:ty, [$($binding:literal),+]) => {{
            let out = i.bindings.len() - 1;
            let p: $push = i.push();
            let bytes = dispatch::<$out>(i, order, width, out, |id, groups, result| {
                $function(id, groups, &p, $(i.table($binding),)+ result)
            });
            [(out, bytes)].into()
        }};
    }
    use gpu_kernels::params::{CountParams, EnterParams, PixelParams, ProjectParams, ToneMapParams};
    Some(match i.kernel.name {
        "scene_closest_hit" => entry!(sc::closest_hit, CountParams, Hit, [0, 1, 2, 3, 4, 5, 6]),
        "scene_any_hit" => entry!(sc::any_hit, CountParams, u32, [0, 1, 2, 3, 4, 5, 6]),
        "scene_direct_light" => entry!(sc::direct_light, DirectParams, Vec4, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]),
        "scene_primary" => {
            // Two outputs: one call for each.
            let p: PixelParams = i.push();
            let (mut hits, mut points) = (i.table::<Hit>(6).to_vec(), i.table::<SurfacePoint>(7).to_vec());
            let call = |id, groups, hits: &mut [Hit], points: &mut [SurfacePoint]| {
                let t = (i.table(0), i.table(1), i.table(2), i.table(3), i.table(4), i.table(5));
                sc::primary(id, groups, &p, t.0, t.1, t.2, t.3, t.4, t.5, hits, points);
            };
            let hit_bytes = dispatch::<Hit>(i, order, width, 6, |id, g, result| call(id, g, result, &mut points));
            let point_bytes =
                dispatch::<SurfacePoint>(i, order, width, 7, |id, g, result| call(id, g, &mut hits, result));
            [(6, hit_bytes), (7, point_bytes)].into()
        }
        "scene_shade" => entry!(sc::shade, PixelParams, Vec4, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]),
        "scene_tone_map" => entry!(sc::tone_map, ToneMapParams, u32, [0]),
        "formfactor_hemisphere_hits" => {
            entry!(ff::hemisphere_hits, HemisphereParams, u32, [0, 1, 2, 3, 4, 5, 6, 7, 8])
        }
        "formfactor_hemisphere_row" => entry!(ff::hemisphere_row, HemisphereParams, f32, [0, 1, 2]),
        "formfactor_assemble_source" => entry!(ff::assemble_source, CountParams, Vec4, [0, 1, 2, 3, 4]),
        "formfactor_gather_csr" => entry!(ff::gather_csr, CountParams, Vec4, [0, 1, 2, 3]),
        "formfactor_gather_hits" => entry!(ff::gather_hits, HitsParams, Vec4, [0, 1, 2, 3, 4]),
        "formfactor_bounce" => entry!(ff::bounce, CountParams, Vec4, [0, 1, 2]),
        "formfactor_interpolate" => entry!(ff::interpolate, CountParams, Vec4, [0, 1, 2, 3, 4, 5, 6]),
        "multibounce_reorder" => entry!(mb::reorder, CountParams, Vec4, [0, 1, 2]),
        "patches_gather_mean" => entry!(pa::gather_mean, CountParams, Vec4, [0, 1, 2]),
        "patches_lookup" => entry!(pa::lookup, LookupParams, Vec4, [0, 1, 2, 3, 4]),
        "patches_volume_lookup" => entry!(pa::volume_lookup, VolumeParams, Vec4, [0, 1, 2, 3]),
        "patches_volume_lookup_sh" => entry!(pa::volume_lookup_sh, VolumeParams, Vec4, [0, 1, 2, 3]),
        "firstshot_start" => entry!(fs::start, PhotonParams, Photon, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]),
        "firstshot_segment" => {
            // Two outputs: one call for each, with photons of its own.
            let p: PhotonParams = i.push();
            let (mut photons, mut landings) = (i.table::<Photon>(6).to_vec(), i.table::<Landing>(7).to_vec());
            let call = |id, groups, photons: &mut [Photon], landings: &mut [Landing]| {
                let t = (i.table(0), i.table(1), i.table(2), i.table(3), i.table(4), i.table(5));
                fs::segment(id, groups, &p, t.0, t.1, t.2, t.3, t.4, t.5, photons, landings);
            };
            let photon_bytes =
                dispatch::<Photon>(i, order, width, 6, |id, g, result| call(id, g, result, &mut landings));
            let landing_bytes =
                dispatch::<Landing>(i, order, width, 7, |id, g, result| call(id, g, &mut photons, result));
            [(6, photon_bytes), (7, landing_bytes)].into()
        }
        "multibounce_tiles_enter" => entry!(ti::tiles_enter, EnterParams, Vec4, [0, 1, 2]),
        "multibounce_tiles_round" => entry!(ti::tiles_round, CountParams, u32, [0]),
        "multibounce_tiles_project" => entry!(ti::tiles_project, ProjectParams, Vec4, [0, 1, 2, 3, 4]),
        "multibounce_tiles_weigh" => entry!(ti::tiles_weigh, CountParams, UVec4, [0, 1, 2]),
        "multibounce_tiles_expand" => entry!(ti::tiles_expand, CountParams, Vec4, [0, 1, 2, 3, 4]),
        "multibounce_tiles_near" => entry!(ti::tiles_near, CountParams, Vec4, [0, 1, 2, 3, 4, 5, 6, 7]),
        "multibounce_tiles_leave" => entry!(ti::tiles_leave, CountParams, Vec4, [0, 1, 2, 3]),
        "multibounce_feedback" => {
            // Two outputs: one call for each.
            let p: FeedbackParams = i.push();
            let (mut change, mut exitance) = (i.table::<Vec4>(3).to_vec(), i.table::<Vec4>(4).to_vec());
            let call = |id, groups, change: &mut [Vec4], exitance: &mut [Vec4]| {
                mb::feedback(id, groups, &p, i.table(0), i.table(1), i.table(2), change, exitance);
            };
            let changes = dispatch(i, order, width, 3, |id, g, result| call(id, g, result, &mut exitance));
            let exitances = dispatch(i, order, width, 4, |id, g, result| call(id, g, &mut change, result));
            [(3, changes), (4, exitances)].into()
        }
        "multibounce_multiply" => {
            let (p, workgroup): (MultiplyParams, _) = (i.push(), i.kernel.workgroup);
            let bytes = dispatch::<Vec4>(i, order, width, 3, |id, groups, next| {
                let group = UVec3::new(id.x / workgroup, id.y, id.z);
                mb::multiply(group, groups, id.x % workgroup, &p, i.table(0), i.table(1), i.table(2), next);
            });
            [(3, bytes)].into()
        }
        "temporal_change" => entry!(te::change, CountParams, Vec4, [0, 1, 2, 3]),
        "temporal_sample_lists" => entry!(te::sample_lists, SampleParams, Vec4, [0, 1, 2, 3, 4]),
        "temporal_sample_tables" => entry!(te::sample_tables, SampleParams, Vec4, [0, 1, 2, 3, 4, 5, 6]),
        "temporal_sum_lists" => entry!(te::sum_lists, SumParams, Vec4, [0, 1, 2, 3]),
        "temporal_sum_tables" => entry!(te::sum_tables, SumParams, Vec4, [0, 1, 2, 3, 4, 5]),
        "temporal_split_scan" => entry!(te::split_scan, SplitParams, UVec2, [0, 1]),
        "temporal_split_pack" => entry!(te::split_pack, SplitParams, u32, [0, 1, 2]),
        "localmatrix_mean" => entry!(lm::mean, CountParams, Vec4, [0, 1, 2]),
        "localmatrix_count" => entry!(lm::count, SlotParams, u32, [0]),
        "localmatrix_start" => entry!(lm::start, CountParams, u32, [0]),
        "localmatrix_compact" => entry!(lm::compact, CountParams, u32, [0, 1]),
        "localmatrix_product" => entry!(lm::product, SlotParams, Vec4, [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        "localmatrix_spread" => entry!(lm::spread, CountParams, Vec4, [0, 1]),
        "localmatrix_fade" => entry!(lm::fade, FadeParams, Vec4, [0, 1]),
        "localmatrix_show" => entry!(lm::show, CountParams, Vec4, [0, 1, 2]),
        "localmatrix_update" => entry!(lm::update, UpdateParams, f32, [0, 1, 2]),
        _ => return None,
    })
}

#[test]
fn entry_points_give_the_same_in_any_order_and_for_any_shape_of_the_dispatch() {
    let mut called = 0;
    for input in inputs() {
        let expected = input.run_on_host().unwrap();
        let [x, y, _] = input.kernel.groups(input.elements);
        for width in [x * y, 1, 3] {
            // As many invocations as the workgroups have, some of them beyond the elements.
            let invocations = (x * y).div_ceil(width) * width * input.kernel.workgroup;
            for (name, order) in orders(invocations) {
                let Some(found) = run_entry(&input, &order, width) else { continue };
                assert!(found == expected, "{} {name}, {width} workgroups wide", input.kernel.name);
                called += 1;
            }
        }
    }
    assert_eq!(called, 45 * 9, "an entry point of the table is not called here");
}

#[test]
fn an_invocation_that_is_left_out_is_noticed() {
    for input in inputs() {
        let [x, y, _] = input.kernel.groups(input.elements);
        let order: Vec<u32> = (0..x * y * input.kernel.workgroup).filter(|k| *k != 4).collect();
        let Some(found) = run_entry(&input, &order, x * y) else { continue };
        assert!(found != input.run_on_host().unwrap(), "{}", input.kernel.name);
    }
}

/// Whether a kernel is a dense product.
fn is_dense(input: &Input) -> bool {
    input.kernel.name.starts_with("formfactor_gather") && input.push.len() == size_of::<GatherParams>()
}

/// The rows of a dense product that start at `first`, as a block of their own.
fn row_block(input: &Input, first: u32, rows: u32) -> Input {
    let mut block = input.clone();
    let p: GatherParams = input.push();
    let row_bytes = |bytes: &Bytes| bytes.bytes().len() / p.rows as usize;
    let cut = |bytes: &Bytes| {
        let stride = row_bytes(bytes);
        Bytes::of(&bytes.bytes()[first as usize * stride..(first + rows) as usize * stride])
    };
    block.bindings[0] = match &input.bindings[0] {
        Data::Buffer(bytes) => Data::Buffer(cut(bytes)),
        Data::Image { format, width, texels, .. } => {
            Data::Image { format: *format, width: *width, height: rows, texels: cut(texels) }
        }
    };
    block.elements = rows;
    block.push = bytemuck::bytes_of(&GatherParams { rows, first_row: p.first_row + first, ..p }).to_vec();
    block
}

#[test]
fn dense_products_in_blocks_of_rows_give_the_same_in_any_order() {
    let mut checked = 0;
    for input in inputs().into_iter().filter(is_dense) {
        let whole = input.run_on_host().unwrap();
        let rows = input.push::<GatherParams>().rows;
        for (name, order) in orders(rows.div_ceil(8)) {
            let mut result = input.clone();
            for k in order {
                let mut block = row_block(&result, 8 * k, 8.min(rows - 8 * k));
                block.bindings[2] = result.bindings[2].clone();
                result.bindings[2] = Data::Buffer(block.run_on_host().unwrap().remove(&2).unwrap());
            }
            assert!(result.bindings[2] == Data::Buffer(whole[&2].clone()), "{} {name}", input.kernel.name);
        }
        // A block that is left out is noticed.
        let missing = row_block(&input, 8, rows - 8).run_on_host().unwrap();
        assert!(missing != whole, "{}", input.kernel.name);
        checked += 1;
    }
    assert_eq!(checked, 4);
}

#[test]
fn dense_products_agree_with_each_other_and_with_plain_sums() {
    for input in inputs().into_iter().filter(is_dense) {
        let (p, name) = (input.push::<GatherParams>(), input.kernel.name);
        let result = input.run_on_host().unwrap().remove(&2).unwrap();
        let n = 4 * p.vectors as usize;
        let exitance: &[Vec4] = input.table(1);
        let factor = |row: usize, j: usize| {
            if name.contains("half") {
                input.table::<half::f16>(0)[row * n + j].to_f64()
            } else {
                f64::from(input.table::<f32>(0)[row * n + j])
            }
        };
        for row in 0..p.rows as usize {
            let found = result.table::<Vec4>()[p.first_row as usize + row];
            let mut expected = [0.0f64; 3];
            for (j, light) in exitance[..n].iter().enumerate() {
                for (c, sum) in expected.iter_mut().enumerate() {
                    *sum += factor(row, j) * f64::from(light[c]);
                }
            }
            for (c, expected) in expected.iter().enumerate() {
                // Positive terms: n roundings at most, in f32.
                let error = (f64::from(found[c]) - expected).abs() / expected;
                assert!(error < 3e-5, "{name} row {row}: {} for {expected}", found[c]);
            }
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let (one, two) = (pool(1), pool(2));
    for input in inputs() {
        let (a, b) = (one.install(|| input.run_on_host().unwrap()), two.install(|| input.run_on_host().unwrap()));
        assert!(a == b, "{}", input.kernel.name);
    }
}

#[test]
fn wide_dispatches_go_on_in_further_rows_of_workgroups() {
    let kernel = &gpu_kernels::table::SCENE_CLOSEST_HIT;
    assert_eq!(kernel.groups(0), [1, 0, 0]);
    assert_eq!(kernel.groups(1), [1, 1, 1]);
    assert_eq!(kernel.groups(65), [2, 1, 1]);
    assert_eq!(kernel.groups(64 * MAX_GROUPS_X), [MAX_GROUPS_X, 1, 1]);
    let [x, y, z] = kernel.groups(64 * MAX_GROUPS_X + 1);
    assert!(x <= MAX_GROUPS_X && x * y > MAX_GROUPS_X && z == 1);
    assert_eq!(gpu_kernels::table::FORMFACTOR_GATHER.groups(9), [3, 1, 1]);
}

#[test]
fn calls_that_do_not_suit_the_table_are_refused() {
    use gpu_kernels::host::HostError;
    let all = inputs();
    let input = &all[0];
    let mut short = input.clone();
    short.bindings[0] = Data::Buffer(Bytes::of(&[0u8; 32]));
    assert!(matches!(short.run_on_host(), Err(HostError::TooShort { binding: "rays", needed: 1000, found: 1 })));
    let mut odd = input.clone();
    odd.bindings[0] = Data::Buffer(Bytes::of(&[0u8; 33]));
    assert!(matches!(odd.run_on_host(), Err(HostError::Layout { binding: "rays", .. })));
    let mut push = input.clone();
    push.push.pop();
    assert!(matches!(push.run_on_host(), Err(HostError::PushLength { expected: 4, found: 3, .. })));
    let volume = all.iter().find(|i| i.kernel.name == "patches_volume_lookup").unwrap();
    let mut flat = volume.clone();
    let mut p: VolumeParams = flat.push();
    p.shape.count_y = 0;
    flat.push = bytemuck::bytes_of(&p).to_vec();
    assert!(matches!(flat.run_on_host(), Err(HostError::TooShort { needed: 1, found: 0, .. })));
    let mut probes = volume.clone();
    probes.bindings[0] = Data::Buffer(Bytes::of(&[0u32; 7]));
    assert!(matches!(probes.run_on_host(), Err(HostError::TooShort { binding: "probes", needed: 60, found: 7 })));
    let mut count = input.clone();
    count.elements += 1;
    assert!(matches!(count.run_on_host(), Err(HostError::Elements { .. })));
    let mut missing = input.clone();
    missing.bindings.pop();
    assert!(matches!(missing.run_on_host(), Err(HostError::BindingCount { expected: 8, found: 7, .. })));
    let mut image = input.clone();
    image.bindings[0] =
        Data::Image { format: ImageFormat::Rgba32Float, width: 1, height: 1, texels: Bytes::of(&[Vec4::ZERO]) };
    assert!(matches!(image.run_on_host(), Err(HostError::BindingKind { binding: "rays", .. })));
    let blocks = all.iter().find(|i| i.kernel.name == "multibounce_blocks_gather_image").unwrap();
    let mut format = blocks.clone();
    let Data::Image { format: of_texels, .. } = &mut format.bindings[0] else { panic!("the blocks are an image") };
    *of_texels = ImageFormat::Rgba32Float;
    assert!(matches!(format.run_on_host(), Err(HostError::BindingKind { binding: "blocks", .. })));
    let mut small = blocks.clone();
    let Data::Image { width, .. } = &mut small.bindings[0] else { panic!("the blocks are an image") };
    *width -= 4;
    assert!(matches!(small.run_on_host(), Err(HostError::ImageSize { binding: "blocks", .. })));
    let mut short = blocks.clone();
    short.bindings[1] = Data::Buffer(Bytes::of(&[Vec4::ZERO; 3]));
    assert!(matches!(short.run_on_host(), Err(HostError::TooShort { binding: "tile_scales", .. })));
}
