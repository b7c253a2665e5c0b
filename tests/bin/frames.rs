//! `cargo run --release -p integration-tests --bin frames -- COUNT [FIRST]`: renders so many frames with random lights,
//! cameras, methods, materials and sizes, on the processor and on the best Vulkan device with the validation layer
//! watching, and fails where something is wrong with one ([`integration_tests::frames`]). FIRST changes every random
//! number.

use std::process::ExitCode;

use integration_tests::{frames, vulkan};
use runtime::cpu::Cpu;
use runtime::executor::Executor;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize| arguments.get(k).and_then(|text| text.parse::<u32>().ok());
    let Some(count) = number(0) else {
        eprintln!("usage: frames COUNT [FIRST]");
        return ExitCode::from(2);
    };
    let first = number(1).unwrap_or(0);
    let on_processor = || -> Box<dyn Executor> { Box::new(Cpu::new()) };
    let on_device = || -> Box<dyn Executor> { vulkan().map_or_else(on_processor, |vulkan| Box::new(vulkan)) };
    let mut is_sound = true;
    for open in [&on_processor as &dyn Fn() -> Box<dyn Executor>, &on_device] {
        let device = open().device().name.clone();
        let tell = |frame: u32, bytes: u64| println!("{device}: frame {frame}, {:.1} MB", bytes as f64 * 1e-6);
        match frames::run(first, count / 2, open, &tell) {
            Ok(outcomes) => {
                for (scene, found) in outcomes {
                    println!("{device}: {scene}: changes {:?}, {} checks", found.changes, found.checks);
                }
            }
            Err(what) => {
                is_sound = false;
                println!("{device}: {what}");
            }
        }
    }
    if is_sound { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
