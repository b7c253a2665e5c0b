//! Plans without a device: what is refused, and what is derived.

use gpu_kernels::params::CountParams;
use gpu_kernels::table::{ImageFormat, MULTIBOUNCE_BLOCKS_GATHER_IMAGE, TRANSPORT_BOUNCE, TRANSPORT_GATHER};
use patchlight_runtime::cpu::Cpu;
use patchlight_runtime::executor::{Executor, ExecutorError};
use patchlight_runtime::graph::Graph;
use patchlight_runtime::plan::{BufferId, PassId, Plan, PlanError, Range};

const COUNT: u32 = 64;
const BYTES: u64 = 64 * 16;

fn bounce(plan: &mut Plan, buffers: [BufferId; 4]) -> Result<PassId, PlanError> {
    plan.pass("bounce", &TRANSPORT_BOUNCE, &buffers.map(Range::from), &CountParams { count: COUNT })
}

fn storage<const N: usize>(plan: &mut Plan) -> [BufferId; N] {
    std::array::from_fn(|k| plan.storage(format!("buffer {k}"), BYTES))
}

#[test]
fn wrong_bindings_are_refused_with_pass_and_buffer() {
    let mut plan = Plan::new();
    let [a, b, c, d] = storage(&mut plan);
    let odd = plan.storage("odd", 40);
    let picture = plan.image("picture", ImageFormat::Rgba16Float, 8, 8);
    let push = CountParams { count: COUNT };
    let mut attempt = |ranges: &[Range], push: CountParams| plan.pass("p", &TRANSPORT_BOUNCE, ranges, &push);
    let ranges = [a, b, c, d].map(Range::from);
    assert!(attempt(&ranges, push).is_ok());

    let error = attempt(&ranges[..3], push).expect_err("a binding is missing");
    assert!(matches!(error, PlanError::BindingCount { expected: 4, found: 3, missing: "exitance", .. }), "{error}");
    let error = attempt(&[odd.into(), ranges[1], ranges[2], ranges[3]], push).expect_err("40 is no multiple of 16");
    assert!(matches!(&error, PlanError::Length { buffer, stride: 16, .. } if buffer == "odd"), "{error}");
    let error = attempt(&[picture.into(), ranges[1], ranges[2], ranges[3]], push).expect_err("a picture");
    assert!(matches!(&error, PlanError::BindingKind { buffer, .. } if buffer == "picture"), "{error}");
    for range in
        [a.range(256, BYTES), a.range(16, 16), a.range(0, 0), a.range(u64::MAX - 255, 16), a.range(1 << 40, 16)]
    {
        let error = attempt(&[range, ranges[1], ranges[2], ranges[3]], push).expect_err("not in the buffer");
        assert!(matches!(error, PlanError::Range { .. }), "{error}");
    }
    let error = attempt(&[ranges[0], ranges[1], ranges[3], ranges[3]], push).expect_err("read and written");
    assert!(matches!(error, PlanError::Overlap { .. }), "{error}");
    // Halves of one buffer may be read and written.
    let low = d.range(0, BYTES / 2);
    let high = d.range(BYTES / 2, BYTES / 2);
    assert!(attempt(&[low, low, low, high], push).is_ok());
    assert!(attempt(&[low, low, high, high], push).is_err());
}

#[test]
fn wrong_push_constants_and_formats_are_refused() {
    let mut plan = Plan::new();
    let buffers: [BufferId; 4] = storage(&mut plan);
    let error = plan.pass("p", &TRANSPORT_BOUNCE, &buffers.map(Range::from), &[0u32; 2]).expect_err("too long");
    assert!(matches!(error, PlanError::PushLength { expected: 4, found: 8, .. }), "{error}");
    let half = plan.image("half", ImageFormat::Rgba16Float, 8, 8);
    // Any format of blocks suits the kernel for blocks, no other does.
    let others: [BufferId; 5] = storage(&mut plan);
    let attempt = |plan: &mut Plan, picture| {
        let ranges = [picture, others[0], others[1], others[2], others[3], others[4]].map(Range::from);
        let kernel = &MULTIBOUNCE_BLOCKS_GATHER_IMAGE;
        plan.pass_with_bytes("p", kernel, &ranges, &vec![0; kernel.push_bytes as usize]).map(|_| ())
    };
    for (format, bytes) in ImageFormat::BLOCKS.iter().zip([48, 96, 96, 96]) {
        let blocks = plan.image("blocks", *format, 9, 5);
        assert_eq!(plan.buffer(blocks).map(|b| b.bytes), Ok(bytes));
        assert_eq!(attempt(&mut plan, blocks), Ok(()));
    }
    let error = attempt(&mut plan, half).expect_err("half for blocks");
    assert!(matches!(error, PlanError::BindingKind { expected: "a picture of texture blocks", .. }), "{error}");
}

#[test]
fn what_nobody_wrote_is_not_read() {
    let mut plan = Plan::new();
    let [a, b, c, d] = storage(&mut plan);
    let first = bounce(&mut plan, [a, a, a, b]).expect("valid");
    let second = bounce(&mut plan, [b, b, c, d]).expect("valid");
    let mut cpu = Cpu::new();
    cpu.load(plan).expect("loads");
    let unwritten = |result: Result<Vec<_>, ExecutorError>| match result {
        Err(ExecutorError::Plan(PlanError::NeverWritten { pass, buffer })) => (pass, buffer),
        other => panic!("{other:?}"),
    };
    assert_eq!(unwritten(cpu.run()), ("bounce".into(), "buffer 0".into()));
    cpu.upload_at(a, 0, &[0; 16]).expect("fits");
    assert_eq!(unwritten(cpu.run()), ("bounce".into(), "buffer 2".into()));
    cpu.run_passes(&[first]).expect("reads what was uploaded");
    cpu.upload_at(c, 0, &[0; 16]).expect("fits");
    cpu.run_passes(&[second]).expect("reads what an earlier run wrote");
}

#[test]
fn a_cleared_buffer_has_contents() {
    let mut plan = Plan::new();
    let [a, b, c, d] = storage(&mut plan);
    bounce(&mut plan, [a, b, c, d]).expect("valid");
    let mut cpu = Cpu::new();
    cpu.load(plan).expect("loads");
    for id in [a, b, c] {
        assert!(cpu.run().is_err(), "something is still unwritten");
        cpu.clear(id).expect("a storage buffer");
    }
    cpu.run().expect("reads zeros");
}

#[test]
fn uploads_that_do_not_fit_are_refused() {
    let mut plan = Plan::new();
    let [a] = storage(&mut plan);
    let scratch = plan.scratch("scratch", 16);
    let picture = plan.image("picture", ImageFormat::Rgba32Float, 2, 2);
    let mut cpu = Cpu::new();
    cpu.load(plan).expect("loads");
    let refused =
        |result: Result<(), ExecutorError>| assert!(matches!(result, Err(ExecutorError::Plan(_))), "{result:?}");
    refused(cpu.upload_at(a, 1, &[0; 1024]));
    refused(cpu.upload_at(a, u64::MAX, &[0; 2]));
    refused(cpu.upload_at(scratch, 0, &[0; 16]));
    refused(cpu.upload_at(picture, 0, &[0; 16]));
    assert!(cpu.download(scratch).is_err());
    // Ids of a larger plan.
    let mut other = Plan::new();
    let foreign: [BufferId; 9] = storage(&mut other);
    let foreign_pass = bounce(&mut other, [foreign[0], foreign[1], foreign[2], foreign[3]]).expect("valid");
    refused(cpu.upload_at(foreign[8], 0, &[]));
    refused(cpu.set_push(foreign_pass, &[0; 4]));
    assert!(cpu.run_passes(&[foreign_pass]).is_err() && cpu.download(foreign[8]).is_err());
}

#[test]
fn passes_wait_exactly_where_they_must() {
    let mut plan = Plan::new();
    let [a, b, c, d, e] = storage(&mut plan);
    let passes = [
        bounce(&mut plan, [a, a, a, b]),
        // Reads the same, writes another: side by side.
        bounce(&mut plan, [a, a, a, c]),
        // Reads what the first wrote.
        bounce(&mut plan, [b, a, a, d]),
        // Independent of the third; the barrier before it served the first two.
        bounce(&mut plan, [c, a, a, e]),
        // Writes what the fourth reads.
        bounce(&mut plan, [a, a, a, c]),
        // Writes what the fifth wrote.
        bounce(&mut plan, [a, a, a, c]),
    ]
    .map(|pass| pass.expect("valid"));
    let graph = Graph::new(plan);
    assert_eq!(graph.barriers(&passes), [false, false, true, false, true, true]);
    assert_eq!(graph.barriers(&passes[3..]), [false, true, true]);
}

#[test]
fn disjoint_blocks_of_rows_do_not_wait() {
    let mut plan = Plan::new();
    let [factors, exitance, irradiance] = storage(&mut plan);
    let push = formfactor::GatherParams { rows: 16, vectors: 1, ..Default::default() };
    let passes = [0, 256, 512].map(|at| {
        let ranges = [factors.range(at, 256), exitance.into(), irradiance.range(at, 256)];
        plan.pass("block", &TRANSPORT_GATHER, &ranges, &push).expect("valid")
    });
    assert_eq!(Graph::new(plan).barriers(&passes), [false, false, false]);
}

#[test]
fn scratch_buffers_of_separate_lifetimes_share_memory() {
    let mut plan = Plan::new();
    let [a, d] = storage(&mut plan);
    let scratch: [BufferId; 3] = std::array::from_fn(|k| plan.scratch(format!("scratch {k}"), BYTES * (k as u64 + 1)));
    bounce(&mut plan, [a, a, a, scratch[0]]).expect("valid");
    bounce(&mut plan, [scratch[0], a, a, scratch[1]]).expect("valid");
    let third = bounce(&mut plan, [scratch[1], a, a, scratch[2]]).expect("valid");
    bounce(&mut plan, [scratch[2], a, a, d]).expect("valid");
    let graph = Graph::new(plan.clone());
    let slots = scratch.map(|id| graph.slot_of(id));
    assert!(slots[0] == slots[2] && slots[0] != slots[1], "{slots:?}");
    assert_eq!(graph.slots()[slots[0]].bytes, 3 * BYTES, "room for the larger one");
    assert_eq!(graph.slots().len(), 4);

    let mut cpu = Cpu::new();
    cpu.load(plan).expect("loads");
    cpu.upload_at(a, 0, bytemuck::cast_slice(&[1.0f32; 256])).expect("fits");
    cpu.run().expect("runs");
    let executor: &mut dyn Executor = &mut cpu;
    let found: Vec<f32> = executor.download_table(d).expect("readable");
    // E + ρ H with all ones, four times: the first is 2, each of the others adds 1.
    assert!(found.iter().all(|&v| v == 5.0), "{found:?}");
    // Scratch ends with the frame.
    assert!(cpu.run_passes(&[third]).is_err());
}

#[test]
fn a_section_is_replaced_alone() {
    let mut plan = Plan::new();
    let [a, sum] = storage(&mut plan);
    let unused = plan.storage("unused", 2 * BYTES);
    let scratch = plan.scratch("scratch", BYTES);
    bounce(&mut plan, [a, a, a, scratch]).expect("valid");
    let last = bounce(&mut plan, [scratch, a, a, sum]).expect("valid");
    let base = plan.clone();
    let section = plan.begin_section();
    let refused = bounce(&mut plan, [scratch, a, a, sum]).unwrap_err();
    assert!(matches!(&refused, PlanError::EarlierScratch { buffer, .. } if buffer == "scratch"), "{refused}");
    let doubled = plan.storage("doubled", BYTES);
    bounce(&mut plan, [sum, a, a, doubled]).expect("valid");

    let mut cpu = Cpu::new();
    cpu.load(plan.clone()).expect("loads");
    cpu.upload_at(a, 0, bytemuck::cast_slice(&[1.0f32; 256])).expect("fits");
    cpu.run().expect("runs");
    let read = |cpu: &mut Cpu, buffer: BufferId| -> Vec<f32> {
        let executor: &mut dyn Executor = cpu;
        executor.download_table(buffer).expect("readable")
    };
    // E + ρ H with all ones: 2, 3, and 4 in the section.
    assert!(read(&mut cpu, sum).iter().all(|&v| v == 3.0) && read(&mut cpu, doubled).iter().all(|&v| v == 4.0));

    // Another section, which uses what was not used before it: what is before it keeps its contents, and its passes
    // need not run again.
    let mut other = base.clone();
    assert_eq!(other.begin_section(), section);
    let third = other.storage("third", 2 * BYTES);
    other
        .pass(
            "unused",
            &TRANSPORT_BOUNCE,
            &[a.into(), a.into(), a.into(), unused.range(0, BYTES)],
            &CountParams { count: COUNT },
        )
        .expect("valid");
    let push = CountParams { count: 16 };
    let ranges: [Range; 4] = [sum.into(), sum.into(), sum.into(), third.range(0, BYTES)];
    let pass = other.pass("third", &TRANSPORT_BOUNCE, &ranges, &push).expect("valid");
    cpu.load_after(other, section).expect("loads");
    cpu.run_passes(&[pass]).expect("what it reads is there");
    assert_eq!(read(&mut cpu, third)[..4], [12.0; 4], "3 + 3 · 3");

    // One that does not fit leaves what was before.
    let mut large = base.clone();
    large.begin_section();
    large.storage("large", u64::MAX / 2);
    assert!(matches!(cpu.load_after(large, section), Err(ExecutorError::OutOfMemory { .. })));
    assert!(read(&mut cpu, sum).iter().all(|&v| v == 3.0));
    assert!(cpu.download(third).is_err(), "it is gone");
    cpu.run_passes(&[last]).expect_err("scratch has ended");

    // A plan that begins otherwise is refused, and nothing changes.
    let mut unlike = Plan::new();
    let [_, _] = storage(&mut unlike);
    unlike.begin_section();
    assert!(matches!(cpu.load_after(unlike, 1), Err(ExecutorError::Plan(PlanError::OtherSections { section: 1 }))));
    assert!(read(&mut cpu, sum).iter().all(|&v| v == 3.0));
}

#[test]
fn a_read_gives_the_bytes_of_its_time() {
    let mut plan = Plan::new();
    let [a] = storage(&mut plan);
    let mut cpu = Cpu::new();
    cpu.load(plan).expect("loads");
    cpu.upload_at(a, 0, &[1; BYTES as usize]).expect("fits");
    let read = cpu.begin_read(a).expect("readable");
    cpu.upload_at(a, 0, &[2; BYTES as usize]).expect("fits");
    assert_eq!(cpu.try_read(read).expect("sound").expect("at once"), vec![1; BYTES as usize]);
    assert!(cpu.try_read(read).expect("sound").is_none(), "bytes are given once");
}

#[test]
fn the_graph_prints() {
    let mut plan = Plan::new();
    let [a, b] = storage(&mut plan);
    let push = CountParams { count: 1 };
    plan.pass("first \"quoted\"", &TRANSPORT_BOUNCE, &[a, a, a, b].map(Range::from), &push).expect("valid");
    let c = plan.storage("c", 16);
    plan.pass("second", &TRANSPORT_BOUNCE, &[b.into(), a.into(), a.into(), c.into()], &push).expect("valid");
    let graph = Graph::new(plan);
    let stages = graph.stages();
    assert_eq!(stages.iter().map(|stage| stage.passes).collect::<Vec<_>>(), [1, 1]);
    assert!(stages[0].reads.is_empty() && stages[1].reads == [0]);
    let text = graph.graphviz(|name| (name == "second").then_some(1.25));
    for part in [
        "digraph",
        "second, 1.250 ms",
        "first \\\"quoted\\\"",
        "b0 -> p0",
        "p0 -> b1",
        "b1 -> p1",
        "barrier",
        "passes 0 to 1",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
    assert_eq!(text.matches('{').count(), text.matches('}').count());
}
