//! Every kernel of the table on both executors: the same plan, the same inputs, the same results.
//!
//! All kernels agree in every bit on lavapipe: the modules carry `NoContraction`, sums run in one order on both sides,
//! and functions whose GPU form differs are polynomials of our own. Other devices may divide with an error of 2.5 ULP
//! and flush subnormal numbers, so there results are compared with the tolerances of [`tolerance`].

use assets::procedural;
use glam::Vec3;
use gpu_kernels::params::CountParams;
use gpu_kernels::table::{Access, ImageFormat, Kernel};
use integration_tests::KERNELS;
use integration_tests::kernels::{Bytes, Data, Input, block_input, inputs};
use integration_tests::vulkan;
use multibounce::BlockCodec;
use runtime::cpu::Cpu;
use runtime::executor::{DeviceKind, Executor};
use runtime::plan::{BufferId, Plan, Range};
use scene::sampling::{hash3, unit};
use scene::{Hit, Ray};

/// Permitted difference of a kernel's results.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Tolerance {
    /// All bits are equal.
    Bits,
    /// Floats to this relative error, and this share of the words without limit.
    Floats { relative: f32, outliers: f64 },
    /// Each byte to one step.
    Bytes,
}

/// The tolerance of a kernel, with its reason.
fn tolerance(kernel: &str, kind: DeviceKind) -> Tolerance {
    if kind == DeviceKind::EmulatedOnCpu {
        return Tolerance::Bits;
    }
    match kernel {
        "scene_tone_map" => Tolerance::Bytes,
        // A ray that grazes an edge may fall on its other side.
        name if name.starts_with("scene_")
            || name.starts_with("firstshot_")
            || name.starts_with("formfactor_hemisphere_") =>
        {
            Tolerance::Floats { relative: 1e-4, outliers: 0.01 }
        }
        // So may a ray of a probe, a weight its least value, and a texel the change that makes it forget faster.
        name if name.starts_with("ddgi_") => Tolerance::Floats { relative: 1e-4, outliers: 0.01 },
        // A point on the very plane of a wall may fall on its other side.
        name if name.starts_with("patches_") && name.contains("lookup") => {
            Tolerance::Floats { relative: 1e-4, outliers: 0.01 }
        }
        // Divisions of 2.5 ULP, sums in the same order.
        _ => Tolerance::Floats { relative: 1e-5, outliers: 0.0 },
    }
}

/// Runs an input; the contents of every written buffer.
fn run(executor: &mut dyn Executor, kernel: &'static Kernel, input: &Input) -> Vec<Vec<u32>> {
    let mut plan = Plan::new();
    let mut ids: Vec<BufferId> = Vec::new();
    for (binding, data) in kernel.bindings.iter().zip(&input.bindings) {
        ids.push(match data {
            Data::Buffer(bytes) => plan.storage(binding.name, bytes.bytes().len() as u64),
            Data::Image { format, width, height, .. } => plan.image(binding.name, *format, *width, *height),
        });
    }
    let ranges: Vec<Range> = ids.iter().map(|&id| Range::from(id)).collect();
    let pass = plan.pass_with_bytes(kernel.name, kernel, &ranges, &input.push).expect("a valid pass");
    executor.load(plan).expect("the plan loads");
    for (id, data) in ids.iter().zip(&input.bindings) {
        let (Data::Buffer(bytes) | Data::Image { texels: bytes, .. }) = data;
        executor.upload_at(*id, 0, bytes.bytes()).expect("the upload fits");
    }
    executor.run_passes(&[pass]).expect("the pass runs");
    let written = ids.iter().zip(kernel.bindings).filter(|(_, b)| b.access != Access::Read);
    written.map(|(id, _)| executor.download_table(*id).expect("the download works")).collect()
}

/// The first of the differences beyond a tolerance, in words, or `None`.
fn difference(ours: &[Vec<u32>], theirs: &[Vec<u32>], tolerance: Tolerance) -> Option<String> {
    for (buffer, (a, b)) in ours.iter().zip(theirs).enumerate() {
        assert_eq!(a.len(), b.len());
        let scale = a.iter().map(|&w| f32::from_bits(w).abs()).filter(|f| f.is_finite()).fold(0.0, f32::max);
        let near = |x: u32, y: u32| match tolerance {
            Tolerance::Bits => x == y,
            Tolerance::Bytes => x.to_le_bytes().iter().zip(y.to_le_bytes()).all(|(p, q)| p.abs_diff(q) <= 1),
            Tolerance::Floats { relative, .. } => {
                let p = f32::from_bits(x);
                let q = f32::from_bits(y);
                x == y || (p - q).abs() <= relative * p.abs().max(1e-3 * scale)
            }
        };
        let allowed = match tolerance {
            Tolerance::Floats { outliers, .. } => (outliers * a.len() as f64) as usize,
            _ => 0,
        };
        let different: Vec<usize> = (0..a.len()).filter(|&k| !near(a[k], b[k])).collect();
        if different.len() > allowed {
            let k = different[0];
            let p = f32::from_bits(a[k]);
            let q = f32::from_bits(b[k]);
            let count = different.len();
            let all = a.len();
            return Some(format!(
                "output {buffer}: {count} of {all} words differ, first word {k}: {:#x} ({p}) on the CPU, {:#x} ({q}) \
                 on Vulkan",
                a[k], b[k]
            ));
        }
    }
    None
}

#[test]
fn every_kernel_gives_the_same_on_both_executors() {
    let Some(mut vulkan) = vulkan() else { return };
    let kind = vulkan.device().kind;
    let mut failures = Vec::new();
    let inputs = inputs();
    assert!(inputs.iter().map(|i| i.kernel.name).eq(KERNELS.iter().map(|k| k.name)), "a kernel has no input");
    for mut input in inputs {
        let kernel = input.kernel;
        let tolerance = tolerance(kernel.name, kind);
        let ours = run(&mut Cpu::new(), kernel, &input);
        if let Some(difference) = difference(&ours, &run(&mut vulkan, kernel, &input), tolerance) {
            failures.push(format!("{}: {difference}", kernel.name));
        }
        // Half the invocations: a result that the comparison must refuse.
        let at = kernel.counts[0];
        let count = u32::from_le_bytes([input.push[at], input.push[at + 1], input.push[at + 2], input.push[at + 3]]);
        input.push[at..at + 4].copy_from_slice(&(count / 2).to_le_bytes());
        let half = run(&mut vulkan, kernel, &input);
        assert!(difference(&ours, &half, tolerance).is_some(), "{}: a wrong result passes", kernel.name);
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Permitted rounding of texture units in the products. BC6H and BC7 are exact by their specification. The palettes of
/// BC1, and of the colours of BC3, are rounded to about 8 bits: lavapipe is up to 1.7/255 off at a texel. With random
/// bits the errors of the hundreds of texels of a row have both signs: its sum stays within 0.5 %, and within 1.5 %
/// where entries are logarithms, which make eightfold ln 2 of an error of a great texel.
fn texture_tolerance(codec: BlockCodec, kind: DeviceKind) -> Tolerance {
    match codec {
        BlockCodec::Bc1 => Tolerance::Floats { relative: 5e-3, outliers: 0.0 },
        BlockCodec::Bc3 => Tolerance::Floats { relative: 1.5e-2, outliers: 0.0 },
        _ => tolerance("multibounce_blocks_gather_image", kind),
    }
}

#[test]
fn texture_units_decode_every_format_of_blocks() {
    let Some(mut vulkan) = vulkan() else { return };
    if !vulkan.device().has_block_images {
        println!("skipped: the device has no textureCompressionBC");
        return;
    }
    let formats = BlockCodec::ALL.into_iter().zip(ImageFormat::BLOCKS);
    for (codec, format) in formats {
        let mut image = block_input(codec, Some(*format));
        let in_kernel = block_input(codec, None);
        let cpu = run(&mut Cpu::new(), in_kernel.kernel, &in_kernel);
        assert_eq!(cpu, run(&mut Cpu::new(), image.kernel, &image), "{codec:?}: the host's forms differ");
        let tolerance = texture_tolerance(codec, vulkan.device().kind);
        let found = run(&mut vulkan, image.kernel, &image);
        assert_eq!(difference(&cpu, &found, tolerance), None, "{codec:?}");
        // Blocks of other bits.
        let Data::Image { texels, .. } = &mut image.bindings[0] else { panic!("the blocks are an image") };
        texels.bytes_mut().iter_mut().for_each(|byte| *byte = byte.rotate_left(3));
        let other = run(&mut vulkan, image.kernel, &image);
        assert!(difference(&cpu, &other, tolerance).is_some(), "{codec:?}: other blocks pass");
    }
}

/// Rays from everywhere in a scene in all directions, every eighth along an axis, every fourth with an end.
fn rays(scene: &scene::Scene, count: u32) -> Vec<Ray> {
    let at = |stream, k| {
        let number = |axis| unit(hash3(3 * k + axis, stream, 2025));
        Vec3::new(number(0), number(1), number(2))
    };
    let (low, high) = scene.geometry.bounds;
    (0..count)
        .map(|k| {
            let axis = [Vec3::X, Vec3::NEG_Y, Vec3::Z][(k / 8 % 3) as usize];
            let direction = if k % 8 == 0 { axis } else { at(1, k) * 2.0 - 1.0 };
            let t_max = if k % 4 == 0 { 0.2 * scene.diagonal() } else { scene::kernel::bvh::FAR };
            Ray { origin: low + at(2, k) * (high - low), t_max, direction, reserved: 0 }
        })
        .collect()
}

#[test]
fn a_hundred_thousand_rays_hit_the_same_in_every_bit() {
    let Some(mut vulkan) = vulkan() else { return };
    let scene = procedural::build("atrium:12000").expect("the built-in scene is valid").scene;
    assert!(scene.geometry.triangles.len() >= 10_000);
    let kernel = &gpu_kernels::table::SCENE_CLOSEST_HIT;
    let count = 100_000;
    let buffer = |bytes| Data::Buffer(bytes);
    let input = Input {
        kernel,
        invocations: count,
        push: bytemuck::bytes_of(&CountParams { count }).to_vec(),
        bindings: vec![
            buffer(Bytes::of(&rays(&scene, count))),
            buffer(Bytes::of(&scene.geometry.nodes)),
            buffer(Bytes::of(&scene.geometry.triangles)),
            buffer(Bytes::of(&scene.geometry.uvs)),
            buffer(Bytes::of(&scene.materials)),
            buffer(Bytes::of(&scene.geometry.textures)),
            buffer(Bytes::of(&scene.geometry.texels)),
            buffer(Bytes::of(&vec![Hit::MISS; count as usize])),
        ],
    };
    let ours = run(&mut Cpu::new(), kernel, &input);
    let hits = ours[0].iter().step_by(4).filter(|&&triangle| triangle != scene::NONE).count();
    assert!(hits > 50_000, "only {hits} rays hit anything");
    let tolerance = tolerance(kernel.name, vulkan.device().kind);
    assert_eq!(difference(&ours, &run(&mut vulkan, kernel, &input), tolerance), None);
}

/// A copy of a kernel whose module has another constant.
fn with_constant(kernel: &Kernel, from: f32, to: f32) -> &'static Kernel {
    const OP_CONSTANT: u32 = 43;
    let mut words: Vec<u32> = bytemuck::pod_collect_to_vec(kernel.spv);
    let mut at = 5;
    let mut changed = 0;
    while at < words.len() {
        let length = (words[at] >> 16) as usize;
        let operation = words[at] & 0xffff;
        if operation == OP_CONSTANT && length == 4 && words[at + 3] == from.to_bits() {
            words[at + 3] = to.to_bits();
            changed += 1;
        }
        at += length;
    }
    assert_eq!(changed, 1, "{} has no constant {from}", kernel.name);
    let words: &'static [u32] = words.leak();
    let mut copy = *kernel;
    copy.spv = bytemuck::cast_slice(words);
    Box::leak(Box::new(copy))
}

#[test]
fn a_kernel_with_one_changed_constant_is_caught() {
    let Some(mut vulkan) = vulkan() else { return };
    let broken = [
        ("scene_closest_hit", 1.000_001, 0.7),
        ("scene_tone_map", 1.055, 1.065),
        ("formfactor_hemisphere_hits", 1e-4, 0.5),
    ];
    let kind = vulkan.device().kind;
    for (name, from, to) in broken {
        let input = inputs().into_iter().find(|i| i.kernel.name == name).expect("a kernel of this name");
        let tolerance = tolerance(name, kind);
        let ours = run(&mut Cpu::new(), input.kernel, &input);
        let same = run(&mut vulkan, with_constant(input.kernel, from, from), &input);
        assert_eq!(difference(&ours, &same, tolerance), None, "{name} unchanged");
        let other = run(&mut vulkan, with_constant(input.kernel, from, to), &input);
        assert!(difference(&ours, &other, tolerance).is_some(), "{name} with {to} for {from} is not caught");
    }
}
