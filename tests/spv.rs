//! The committed modules: fresh, complete, valid, as the table says, and free of rust-gpu's silent traps.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use gpu_kernels::table::{Access, BindingKind};
use integration_tests::KERNELS;
use integration_tests::spirv::{Module, decoration, is_float_arithmetic, op, storage};
use sha2::{Digest, Sha256};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Folders of modules with their manifests, those of the library first.
const FOLDERS: [&str; 2] = ["crates/gpu-kernels/spv", "lab/kernels/spv"];

fn folder(place: &str) -> PathBuf {
    root().join(place)
}

fn manifest(place: &str) -> toml::Table {
    fs::read_to_string(folder(place).join("manifest.toml")).unwrap().parse().unwrap()
}

fn hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Files of a section of the manifest whose bytes have another hash, or that are missing.
fn stale(section: &toml::Value, folder: &Path) -> Vec<String> {
    let files = section.as_table().unwrap();
    files
        .iter()
        .filter(|(file, expected)| {
            let found = fs::read(folder.join(file)).map(|bytes| hash(&bytes)).unwrap_or_default();
            Some(found.as_str()) != expected.as_str()
        })
        .map(|(file, _)| file.clone())
        .collect()
}

fn modules() -> Vec<(&'static str, Module)> {
    KERNELS.iter().map(|k| (k.name, Module::parse(k.spv).expect("SPIR-V"))).collect()
}

#[test]
fn modules_are_what_the_sources_gave() {
    for place in FOLDERS {
        let manifest = manifest(place);
        let sources = stale(&manifest["sources"], &root());
        assert!(sources.is_empty(), "changed since the kernels were built, run `just spv`: {sources:?}");
        let modules = stale(&manifest["modules"], &folder(place));
        assert!(modules.is_empty(), "not what the builder wrote, run `just spv`: {modules:?}");
    }
    // The body, the entry point and the settings of a kernel are all among the sources.
    let manifest = manifest(FOLDERS[0]);
    for file in ["crates/scene/src/kernel/bvh.rs", "crates/gpu-kernels/src/scene.rs", "crates/scene/src/gpu.rs"] {
        assert!(manifest["sources"].as_table().unwrap().contains_key(file), "{file}");
    }
}

#[test]
fn a_changed_source_is_noticed() {
    let manifest = manifest(FOLDERS[0]);
    let copy = tempfile::tempdir().unwrap();
    for file in manifest["sources"].as_table().unwrap().keys() {
        fs::create_dir_all(copy.path().join(file).parent().unwrap()).unwrap();
        fs::copy(root().join(file), copy.path().join(file)).unwrap();
    }
    let before = stale(&manifest["sources"], copy.path());
    let edited = "crates/scene/src/math.rs";
    let text = fs::read_to_string(copy.path().join(edited)).unwrap();
    fs::write(copy.path().join(edited), text.replacen("0.25", "0.26", 1)).unwrap();
    let after = stale(&manifest["sources"], copy.path());
    assert!(!before.contains(&edited.to_owned()) && after.contains(&edited.to_owned()), "{before:?} {after:?}");
    fs::remove_file(copy.path().join("crates/scene/src/gpu.rs")).unwrap();
    assert!(stale(&manifest["sources"], copy.path()).contains(&"crates/scene/src/gpu.rs".to_owned()));
}

#[test]
fn the_lock_file_has_the_versions_that_were_compiled() {
    let lock: toml::Table = fs::read_to_string(root().join("Cargo.lock")).unwrap().parse().unwrap();
    for place in FOLDERS {
        for (name, version) in manifest(place)["packages"].as_table().unwrap() {
            let found: Vec<_> =
                lock["package"].as_array().unwrap().iter().filter(|p| p["name"].as_str() == Some(name)).collect();
            assert!(found.len() == 1 && found[0]["version"] == *version, "{name}: {found:?}, compiled {version}");
        }
    }
}

#[test]
fn table_and_modules_name_the_same_kernels() {
    for (place, kernels) in FOLDERS.into_iter().zip([gpu_kernels::table::KERNELS, lab_kernels::KERNELS]) {
        let names: BTreeSet<String> = kernels.iter().map(|k| format!("{}.spv", k.name)).collect();
        assert_eq!(names.len(), kernels.len());
        let files: BTreeSet<String> = fs::read_dir(folder(place))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .filter(|name| name.ends_with(".spv"))
            .collect();
        assert_eq!(names, files);
        let listed: BTreeSet<String> = manifest(place)["modules"].as_table().unwrap().keys().cloned().collect();
        assert_eq!(names, listed);
    }
    for kernel in KERNELS.iter() {
        let module = Module::parse(kernel.spv).unwrap();
        assert_eq!(module.entry_points(), [kernel.name], "an entry point vanished or changed its name");
        assert_eq!(module.local_size(), Some([kernel.workgroup, 1, 1]), "{}", kernel.name);
        assert_eq!(kernel.spv.as_ptr().align_offset(4), 0, "{}", kernel.name);
    }
}

#[test]
fn bindings_are_those_of_the_table() {
    let mut unused = Vec::new();
    for (kernel, (name, module)) in KERNELS.iter().zip(modules()) {
        let found = module.resources();
        for (k, row) in kernel.bindings.iter().enumerate() {
            let Some(resource) = found.iter().find(|r| r.binding == k as u32) else {
                unused.push((name, row.name));
                continue;
            };
            assert_eq!(resource.set, 0);
            match row.kind {
                BindingKind::Storage { .. } => {
                    assert_eq!(resource.class, storage::STORAGE_BUFFER, "{name}: {}", row.name);
                    assert_eq!(resource.non_writable, row.access == Access::Read, "{name}: {}", row.name);
                }
                BindingKind::SampledImage { .. } => {
                    assert_eq!(resource.class, storage::UNIFORM_CONSTANT, "{name}: {}", row.name);
                    assert_eq!(module.type_of(resource.pointee).0, op::TYPE_IMAGE, "{name}: {}", row.name);
                }
            }
        }
        assert!(found.iter().all(|r| (r.binding as usize) < kernel.bindings.len()), "{name}: a binding without a row");
    }
    // Pixels take the scene as a whole, but neither albedo nor shading casts a ray, shading samples no emitter, sharp
    // lights are no emitters, light with nothing in the way casts no ray, and large lights do not look at the sky's
    // map. Shading and large lights need no luminaires. A finish takes neither rays nor what
    // else a material is, and lobes have a kernel for each kind of light.
    let expected = [
        ("scene_albedo", "nodes"),
        ("scene_finish", "nodes"),
        ("scene_finish", "materials"),
        ("scene_chain_finish", "nodes"),
        ("scene_chain_finish", "materials"),
        ("scene_lobe_sharp", "emitters"),
        ("scene_lobe_sharp", "sky_map"),
        ("scene_lobe_open", "nodes"),
        ("scene_lobe_open", "sky_map"),
        ("scene_lobe_open", "distributions"),
        ("scene_shade", "nodes"),
        ("scene_shade", "emitters"),
        ("scene_shade", "distributions"),
        ("scene_follow", "emitters"),
        ("scene_follow", "distributions"),
        ("scene_chain_surface", "nodes"),
        ("scene_sharp_light", "emitters"),
        ("scene_sharp_light_medium", "emitters"),
        ("scene_open_light", "nodes"),
        ("scene_open_light", "sky_map"),
        ("scene_open_light", "distributions"),
        ("scene_seen_light", "sky_map"),
        ("scene_seen_light", "distributions"),
        ("scene_seen_light_medium", "sky_map"),
        ("scene_seen_light_medium", "distributions"),
    ];
    assert_eq!(unused, expected);
}

#[test]
fn modules_are_valid() {
    if Command::new("spirv-val").arg("--version").output().is_err() {
        println!("skipped: spirv-val (Debian: spirv-tools) is not installed");
        return;
    }
    let validate = |path: &Path| {
        let output = Command::new("spirv-val").args(["--target-env", "vulkan1.2"]).arg(path).output().unwrap();
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    for kernel in KERNELS.iter() {
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(file.path(), kernel.spv).unwrap();
        let (ok, message) = validate(file.path());
        assert!(ok, "{}: {message}", kernel.name);
    }
    // A module that is cut short is refused.
    let cut = tempfile::NamedTempFile::new().unwrap();
    fs::write(cut.path(), &KERNELS[0].spv[..KERNELS[0].spv.len() - 8]).unwrap();
    assert!(!validate(cut.path()).0);
}

/// Traces of sources and folders in a module: debug instructions, and text that looks like a path.
fn traces(bytes: &[u8]) -> Vec<String> {
    let module = Module::parse(bytes).unwrap();
    let debug = [op::SOURCE, op::NAME, op::MEMBER_NAME, op::STRING, op::LINE];
    let mut found: Vec<String> =
        module.instructions.iter().filter(|i| debug.contains(&i.operation)).map(|i| format!("{i:?}")).collect();
    let texts = bytes.split(|b| !b.is_ascii_graphic()).filter(|text| text.len() >= 6 && text.contains(&b'/'));
    found.extend(texts.map(|text| String::from_utf8_lossy(text).into_owned()));
    found
}

#[test]
fn modules_hold_no_paths_and_no_sources() {
    for kernel in KERNELS.iter() {
        assert_eq!(traces(kernel.spv), [""; 0], "{}", kernel.name);
        assert!(kernel.spv.len() < 350_000, "{}: {} bytes", kernel.name, kernel.spv.len());
    }
    let path = b"/crates/scene/src/lib.rs";
    let words = 2 + path.len() / 4;
    let mut with_path = KERNELS[0].spv.to_vec();
    with_path.extend(((words as u32) << 16 | op::STRING).to_le_bytes());
    with_path.extend(9999u32.to_le_bytes());
    with_path.extend(path);
    assert_eq!(traces(&with_path).len(), 2);
}

/// Float operations whose result a driver may still contract.
fn contractible(module: &Module) -> usize {
    let free = |id: u32| !module.decorations.contains_key(&(id, u32::MAX, decoration::NO_CONTRACTION));
    module.instructions.iter().filter(|i| is_float_arithmetic(i.operation) && free(i.operands[1])).count()
}

#[test]
fn no_float_operation_may_be_contracted() {
    let mut without = Vec::new();
    for (name, mut module) in modules() {
        assert_eq!(contractible(&module), 0, "{name}");
        let operations = module.instructions.iter().filter(|i| is_float_arithmetic(i.operation)).count();
        module.decorations.clear();
        assert_eq!(contractible(&module), operations);
        if operations == 0 {
            without.push(name);
        }
    }
    // Of the kernels that only count and copy; tests/order.rs and tests/parity.rs see to it that each writes its
    // results.
    assert!(10 * without.len() < KERNELS.len(), "these compute nothing: {without:?}");
}

/// Instructions of GLSL.std.450 that give the same bits on every device we know:
/// Trunc, FAbs, Floor, Ceil, Sqrt, FMin, UMin, SMin, FMax, UMax, SMax, FClamp, UClamp, SClamp, UnpackHalf2x16,
/// FindILsb.
const ALLOWED_MATHS: [u32; 16] = [3, 4, 8, 9, 31, 37, 38, 39, 40, 41, 42, 43, 44, 45, 62, 73];

fn foreign_maths(module: &Module) -> Vec<u32> {
    module.all(op::EXT_INST).map(|o| o[3]).filter(|i| !ALLOWED_MATHS.contains(i)).collect()
}

#[test]
fn maths_that_differs_between_devices_is_not_used() {
    for (name, mut module) in modules() {
        assert_eq!(foreign_maths(&module), [0; 0], "{name}: GLSL.std.450 instructions outside of the list");
        // Neither the remainders of floats, which differ too.
        assert_eq!(module.all(op::F_REM).count() + module.all(op::F_MOD).count(), 0, "{name}");
        const SIN: u32 = 13;
        for i in module.instructions.iter_mut().filter(|i| i.operation == op::EXT_INST) {
            i.operands[3] = SIN;
        }
        assert_eq!(foreign_maths(&module).len(), module.all(op::EXT_INST).count());
    }
}

#[test]
fn numbers_have_32_bits_so_that_no_cast_changes_sign_on_widening() {
    // rust-gpu extends a widening cast by the sign of the target type: there must be none.
    for (name, module) in modules() {
        for kind in [op::TYPE_INT, op::TYPE_FLOAT] {
            assert!(module.all(kind).all(|o| o[1] == 32), "{name}: a number that has not 32 bits");
        }
        let casts = (op::U_CONVERT..=op::F_CONVERT).map(|k| module.all(k).count()).sum::<usize>();
        assert_eq!(casts, 0, "{name}: a cast between widths");
    }
}

#[test]
fn modules_need_only_what_every_device_is_asked_for() {
    const SHADER: u32 = 1;
    const VULKAN_MEMORY_MODEL: u32 = 5345;
    for (name, module) in modules() {
        assert_eq!(module.capabilities(), BTreeSet::from([SHADER, VULKAN_MEMORY_MODEL]), "{name}");
    }
}
