//! Shared structures lie in the compiled modules where the host has them, scalar by scalar.
//!
//! Structures that are shared are `Pod`, which has no gaps, and modules have no numbers but of 32
//! bits (`tests/spv.rs`): on the host the k-th scalar of a structure of n bytes lies at 4 k, and
//! there are n / 4. The same must be true of the module, for the type that the kernel's declaration
//! names.

use gpu_kernels::table::{BindingKind, Kernel};
use integration_tests::KERNELS;
use integration_tests::spirv::{Module, decoration, op};

/// Offsets of the scalars of a structure and its size.
#[derive(Clone, Debug, PartialEq)]
struct Layout {
    offsets: Vec<u32>,
    size: u32,
}

/// A structure of so many bytes as the host has it.
fn of_host(bytes: u32) -> Layout {
    Layout { offsets: (0..bytes / 4).map(|k| 4 * k).collect(), size: bytes }
}

/// Layouts of the elements of a module's buffers, with the number of the binding.
fn of_buffers(module: &Module, kernel: &Kernel) -> Vec<(usize, Layout)> {
    let resources = module.resources();
    let bindings = resources.iter().map(|resource| (resource.binding as usize, resource.pointee));
    bindings
        .filter(|(binding, _)| matches!(kernel.bindings[*binding].kind, BindingKind::Storage { .. }))
        .map(|(binding, pointee)| {
            let (element, size) = module.buffer_element(pointee).expect("a buffer is an array");
            let mut offsets = Vec::new();
            module.scalar_offsets(element, 0, &mut offsets);
            (binding, Layout { offsets, size })
        })
        .collect()
}

/// Layout of a module's push constants.
fn of_push_constants(module: &Module) -> Option<Layout> {
    let mut offsets = Vec::new();
    let size = module.scalar_offsets(module.push_constants()?, 0, &mut offsets);
    Some(Layout { offsets, size })
}

/// Bindings whose elements lie elsewhere than on the host; and how many were compared.
fn misplaced(module: &Module, kernel: &Kernel) -> (Vec<&'static str>, usize) {
    let layouts = of_buffers(module, kernel);
    let compared = layouts.len();
    let wrong = layouts.into_iter().filter(|(binding, layout)| {
        let BindingKind::Storage { stride } = kernel.bindings[*binding].kind else { return false };
        *layout != of_host(stride)
    });
    (wrong.map(|(binding, _)| kernel.bindings[binding].name).collect(), compared)
}

#[test]
fn buffers_have_the_hosts_layout() {
    let mut compared = 0;
    for kernel in KERNELS.iter() {
        let (wrong, buffers) = misplaced(&Module::parse(kernel.spv).unwrap(), kernel);
        assert_eq!(wrong, [""; 0], "{}", kernel.name);
        compared += buffers;
    }
    let is_buffer = |kind: BindingKind| matches!(kind, BindingKind::Storage { .. });
    let buffers = KERNELS.iter().flat_map(|k| k.bindings).filter(|b| is_buffer(b.kind)).count();
    // tests/spv.rs names the bindings that no module uses.
    assert_eq!(compared, buffers - 25);
}

#[test]
fn push_constants_have_the_hosts_layout() {
    for kernel in KERNELS.iter() {
        let found = of_push_constants(&Module::parse(kernel.spv).unwrap());
        assert_eq!(found, Some(of_host(kernel.push_bytes)), "{}", kernel.name);
        assert!(kernel.push_bytes <= 128 && kernel.push_bytes % 4 == 0);
        assert!(kernel.counts.iter().all(|offset| offset + 4 <= kernel.push_bytes as usize), "{}", kernel.name);
    }
}

#[test]
fn a_field_in_another_place_is_noticed() {
    let kernel = KERNELS.iter().find(|k| k.name == "scene_closest_hit").unwrap();
    let module = Module::parse(kernel.spv).unwrap();
    let resources = module.resources();
    let (ray, stride) = module.buffer_element(resources[0].pointee).unwrap();
    assert_eq!(kernel.bindings[0].kind, BindingKind::Storage { stride });
    // The fields t_max and direction of a ray swapped, each at the other's offset.
    let mut moved = Module::parse(kernel.spv).unwrap();
    let t_max = (ray, 1, decoration::OFFSET);
    let direction = (ray, 2, decoration::OFFSET);
    assert_eq!((moved.decorations[&t_max], moved.decorations[&direction]), (12, 16));
    moved.decorations.insert(t_max, 24);
    moved.decorations.insert(direction, 12);
    assert_eq!(misplaced(&moved, kernel).0, ["rays"]);
    // Elements at a greater distance.
    let mut wider = Module::parse(kernel.spv).unwrap();
    let (block, members) = wider.type_of(resources[0].pointee);
    assert_eq!(block, op::TYPE_STRUCT);
    let array = members[0];
    wider.decorations.insert((array, u32::MAX, decoration::ARRAY_STRIDE), stride + 4);
    assert_eq!(misplaced(&wider, kernel).0, ["rays"]);
    // A field more in the push constants.
    assert_ne!(of_push_constants(&module), Some(of_host(kernel.push_bytes + 4)));
}
