//! The order of invocations changes nothing: every entry point is called on the host forward, reversed and shuffled,
//! and gives the bytes of its host form. Kernels whose workgroups share memory, or that fetch from images, cannot be
//! called on the host; their host forms run over blocks of rows in different orders, and on one and two threads.

use std::collections::BTreeMap;

use formfactor::GatherParams;
use glam::{UVec3, Vec4};
use gpu_kernels::table::{BindingKind, ImageFormat, MAX_GROUPS_X};
use integration_tests::KERNELS;
use integration_tests::kernels::{Bytes, Data, Input, inputs};
use integration_tests::spirv::{Module, op, storage};
use patches::VolumeParams;
use scene::sampling::hash3;

/// Which orders are tried.
fn orders(invocations: u32) -> [(&'static str, Vec<u32>); 3] {
    let forward: Vec<u32> = (0..invocations).collect();
    let reversed = forward.iter().rev().copied().collect();
    let mut shuffled = forward.clone();
    shuffled.sort_by_key(|k| hash3(*k, 1, 2));
    [("forward", forward), ("reversed", reversed), ("shuffled", shuffled)]
}

/// Runs an entry point over these invocations of a dispatch that is `width` workgroups wide; `None` where the host
/// cannot call it.
fn run_entry(input: &Input, order: &[u32], width: u32) -> Option<BTreeMap<usize, Bytes>> {
    let kernel = input.kernel;
    let invocation = kernel.invocation?;
    let [x, y, _] = kernel.groups(input.invocations);
    let groups = UVec3::new(width, (x * y).div_ceil(width), 1);
    let row = width * kernel.workgroup;
    let found = input.on_host(|call| {
        order.iter().try_for_each(|k| invocation(kernel, call, UVec3::new(k % row, k / row, 0), groups))
    });
    Some(found.expect("the input suits the table"))
}

#[test]
fn only_kernels_with_shared_memory_or_images_cannot_be_called_on_the_host() {
    for kernel in KERNELS.iter() {
        let module = Module::parse(kernel.spv).unwrap();
        let shares = module.all(op::VARIABLE).any(|o| o[2] == storage::WORKGROUP);
        let fetches = kernel.bindings.iter().any(|b| matches!(b.kind, BindingKind::SampledImage { .. }));
        assert_eq!(kernel.invocation.is_none(), shares || fetches, "{}", kernel.name);
    }
}

#[test]
fn entry_points_give_the_same_in_any_order_and_for_any_shape_of_the_dispatch() {
    let mut called = 0;
    for input in inputs() {
        let expected = input.run_on_host().unwrap();
        let [x, y, _] = input.kernel.groups(input.invocations);
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
    let callable = KERNELS.iter().filter(|k| k.invocation.is_some()).count();
    assert!(called == 9 * callable && callable >= 40, "{called} calls of {callable} entry points");
}

#[test]
fn an_invocation_that_is_left_out_is_noticed() {
    for input in inputs() {
        if input.kernel.invocation.is_none() {
            continue;
        }
        let [x, y, _] = input.kernel.groups(input.invocations);
        let expected = input.run_on_host().unwrap();
        let is_noticed = |left_out: u32| {
            let order: Vec<u32> = (0..x * y * input.kernel.workgroup).filter(|k| *k != left_out).collect();
            run_entry(&input, &order, x * y).is_some_and(|found| found != expected)
        };
        // A row may be out of view, a pixel may see nothing, or what others see, or have no lobe or map, and a photon
        // may not start.
        let name = input.kernel.name;
        let is_seen = name.starts_with("transport_mark")
            || name.ends_with("_view")
            || name.starts_with("scene_seen_light")
            || name.starts_with("scene_lobe")
            || name == "patches_turn";
        // Nor may a row be bound, or an entry lie in the upper half.
        let is_of_half = matches!(name, "multibounce_pivot_rows" | "multibounce_eliminate");
        let others = match is_seen || name == "firstshot_trace" {
            true => 5..input.invocations,
            false if is_of_half => 5..x * y * input.kernel.workgroup,
            false => 0..0,
        };
        assert!([4].into_iter().chain(others).any(is_noticed), "{}", input.kernel.name);
    }
}

/// Returns true if a kernel is a dense product.
fn is_dense(input: &Input) -> bool {
    matches!(input.kernel.name, "transport_gather" | "transport_gather_half")
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
    let Data::Buffer(bytes) = &input.bindings[0] else { panic!("the factors are a buffer") };
    block.bindings[0] = Data::Buffer(cut(bytes));
    block.invocations = rows;
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
    assert_eq!(checked, 2);
}

#[test]
fn dense_products_agree_with_each_other_and_with_plain_sums() {
    for input in inputs().into_iter().filter(is_dense) {
        let p = input.push::<GatherParams>();
        let name = input.kernel.name;
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
    let one = pool(1);
    let two = pool(2);
    for input in inputs() {
        let a = one.install(|| input.run_on_host().unwrap());
        let b = two.install(|| input.run_on_host().unwrap());
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
    assert_eq!(gpu_kernels::table::TRANSPORT_GATHER.groups(9), [3, 1, 1]);
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
    count.invocations += 1;
    assert!(matches!(count.run_on_host(), Err(HostError::Invocations { .. })));
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
