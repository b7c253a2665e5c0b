//! One method crate on a device: a low-rank operator by `multibounce`, its product by a recipe of `runtime`, no scene,
//! no renderer. Prints the product by native code and, where there is a device, by Vulkan.

use std::error::Error;
use std::ops::ControlFlow;
use std::sync::Arc;

use glam::Vec4;
use multibounce::{Channels, LowRank, TileSide, TileSource};
use patchlight_runtime::executor::{DeviceChoice, open};
use patchlight_runtime::recipe::multibounce::{LowRankTables, OperatorTables, Product};

const PATCHES: usize = 300;

fn main() -> Result<(), Box<dyn Error>> {
    // A symmetric operator: patches on a line, which send each other the more light the nearer they are.
    let entry = |i: usize, j: usize| 0.5 / (1.0 + i.abs_diff(j) as f32).powi(2);
    let operator = faer::Mat::from_fn(PATCHES, PATCHES, entry);
    let area = vec![1.0; PATCHES];
    let order: Vec<u32> = (0..PATCHES as u32).collect();
    let ignore_progress = |_: usize, _: usize| ControlFlow::Continue(());
    let patches = TileSide { area: &area, order: &order };
    let source = TileSource::Symmetric { channels: Channels::One(&operator), patches };
    let low_rank = Arc::new(LowRank::encode(source, 0.01, &ignore_progress)?);
    println!("{PATCHES} patches in {} bytes", low_rank.bytes_by_part().iter().map(|part| part.1).sum::<u64>());

    let mut exitance = vec![Vec4::ZERO; PATCHES];
    exitance[100] = Vec4::new(1.0, 0.5, 0.25, 0.0);
    for choice in [DeviceChoice::Cpu, DeviceChoice::Vulkan] {
        let mut executor = match open(&choice) {
            Ok((executor, _)) => executor,
            Err(error) => {
                println!("{error}");
                continue;
            }
        };
        let range = executor.device().max_storage_buffer_range;
        let make = |plan: &mut _, tables: &mut _| OperatorTables::LowRank(LowRankTables::new(plan, tables, &low_rank));
        let product = Product::load(executor.as_mut(), PATCHES, PATCHES, range, &make)?;
        let (irradiance, milliseconds) = product.run(executor.as_mut(), &exitance, 5)?;
        println!("{}: H_101 = {:.4}, {milliseconds:.3} ms", executor.device().name, irradiance[101].truncate());
    }
    Ok(())
}
