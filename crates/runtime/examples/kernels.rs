//! One kernel on both executors: `B = E + ρ∘H` for a million patches, and the largest difference.

use glam::Vec4;
use gpu_kernels::params::CountParams;
use gpu_kernels::table::FORMFACTOR_BOUNCE;
use runtime::executor::{DeviceChoice, Executor, ExecutorError, open};
use runtime::plan::Plan;

const COUNT: u32 = 1 << 20;

fn run(executor: &mut dyn Executor) -> Result<Vec<f32>, ExecutorError> {
    let mut plan = Plan::new();
    let names = ["source", "albedo", "irradiance", "exitance"];
    let buffers = names.map(|name| plan.storage(name, u64::from(COUNT) * size_of::<Vec4>() as u64));
    plan.pass("bounce", &FORMFACTOR_BOUNCE, &buffers.map(Into::into), &CountParams { count: COUNT }, COUNT)?;
    executor.load(plan)?;
    for (k, buffer) in buffers[..3].iter().enumerate() {
        let values: Vec<f32> = (0..4 * COUNT).map(|j| (j % 1009 + k as u32) as f32 / 1009.0).collect();
        executor.upload(*buffer, &values)?;
    }
    for time in executor.run()? {
        println!("{}: {} took {:.3} ms", executor.device().name, time.name, time.milliseconds);
    }
    executor.download_table(buffers[3])
}

fn main() -> Result<(), ExecutorError> {
    let (mut native, _) = open(&DeviceChoice::Cpu)?;
    let ours = run(native.as_mut())?;
    match open(&DeviceChoice::Vulkan) {
        Ok((mut vulkan, _)) => {
            let theirs = run(vulkan.as_mut())?;
            let largest = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            println!("largest difference: {largest:e}");
        }
        Err(error) => println!("nothing to compare with: {error}"),
    }
    Ok(())
}
