//! `patchlight-bind MODULE FOLDER`: JavaScript and types for a compiled module, of the version that compiled it.

use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [module, folder] = arguments.as_slice() else {
        eprintln!("usage: patchlight-bind MODULE FOLDER");
        return ExitCode::from(2);
    };
    let mut bindings = wasm_bindgen_cli_support::Bindgen::new();
    let made = bindings
        .input_path(module)
        .out_name("patchlight")
        .typescript(false)
        // Names of functions: a twentieth of what a page loads.
        .remove_name_section(true)
        .web(true)
        .and_then(|web| web.generate(folder));
    if let Err(error) = made {
        eprintln!("error: {module}: {error:#}");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}
