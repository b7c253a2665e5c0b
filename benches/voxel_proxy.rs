//! Errors of radiosity over the voxelisation proxy, beside those of the project's own patches of about the same number:
//! a Markdown table of indirect irradiance at the reference points.
//!
//! `cargo bench -p benches --bench voxel_proxy [-- SCENE…]`

#![allow(missing_docs)]

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use assets::import::LoadedScene;
use benches::SEED;
use experiments::proxy::{ProxyRadiosity, ProxySettings};
use opponents::ProxyLookup;
use patches::PatchKind;
use patchlight::{Bake, BakeSettings, LightSettings, PictureRenderer, PictureSettings};
use reference::metrics::compare_points;
use reference::{PointErrors, ReferenceData};
use runtime::cpu::Cpu;
use shell::progress::Progress;

const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared");
/// Scenes: the name of the folder, of the file in it, and of the folder with the reference.
const SCENES: [&str; 3] = ["cornell", "cornell-dragon", "sponza"];
const COUNTS: [usize; 2] = [2000, 10_000];
/// Rays of a row of F.
const RAYS: u32 = 4096;

type Outcome<T> = Result<T, Box<dyn Error>>;

fn print_row(scene: &str, what: &str, geometry: &str, patches: usize, errors: &PointErrors) {
    println!(
        "| {scene} | {what} | {geometry} | {patches} | {:.1} % | {:.0} % | {:.3} |",
        100.0 * errors.median_relative_error,
        100.0 * errors.p95_relative_error,
        errors.mean_ratio
    );
}

fn measure_proxy(name: &str, loaded: &LoadedScene, reference: &ReferenceData, count: usize) -> Outcome<()> {
    let sample_rays = BakeSettings::default().sample_rays;
    let settings = ProxySettings { patch_count: count, rays: RAYS, point_rays: sample_rays, seed: SEED };
    let proxy = ProxyRadiosity::bake(&loaded.scene, settings, &Progress::new(true))?;
    let geometry = format!("{} faces of {:.1} cm", proxy.face_count(), 100.0 * proxy.edge());
    for (lookup, what) in [(ProxyLookup::Face, "voxel faces"), (ProxyLookup::Bilinear, "voxel faces, bilinear")] {
        let ours = proxy.irradiance_at(&reference.surface_points(loaded.metres_per_unit), lookup)?;
        let errors = compare_points(&ours, &reference.point_indirect())?;
        print_row(name, what, &geometry, proxy.patch_count(), &errors);
    }
    Ok(())
}

fn measure_own(name: &str, loaded: &LoadedScene, reference: &ReferenceData, count: usize) -> Outcome<()> {
    let settings = BakeSettings::default().with_patches(PatchKind::Cluster).with_patch_count(count);
    // Only the points matter.
    let settings =
        settings.with_receiver_edge(Some(0.1 * loaded.scene.diagonal())).with_receiver_rays(16).with_seed(SEED);
    let progress = Progress::new(true);
    let bake = Arc::new(Bake::build(&loaded.scene, &settings, &progress)?);
    let light = LightSettings::default();
    let pictures = PictureSettings::default().with_size((16, 16)).with_sub_frames(1);
    let mut renderer = PictureRenderer::of_bake(Arc::clone(&bake), Box::new(Cpu::new()), &light, &pictures, &progress)?;
    renderer.update_light(&loaded.scene.lighting, &loaded.view.camera(16, 16))?;
    let ours = renderer.light_mut().irradiance_at(&reference.surface_points(loaded.metres_per_unit))?;
    let errors = compare_points(&ours, &reference.point_indirect())?;
    let geometry = format!("{} triangles", loaded.scene.geometry.triangles.len());
    print_row(name, "clusters", &geometry, bake.mesh().patches.len(), &errors);
    Ok(())
}

fn run() -> Outcome<()> {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    println!("| scene | patches are | geometry | patches | median | p95 | mean ratio |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    for name in SCENES {
        if !(wanted.is_empty() || wanted.iter().any(|w| w == name)) {
            continue;
        }
        let file = Path::new(SHARED).join("scenes").join(name).join(format!("{name}.toml"));
        if !file.exists() {
            println!("| {name} | {} is not there | | | | | |", file.display());
            continue;
        }
        let loaded = assets::import::load(&file)?;
        let reference = ReferenceData::load(&Path::new(SHARED).join("reference").join(name))?;
        for count in COUNTS {
            measure_proxy(name, &loaded, &reference, count)?;
            measure_own(name, &loaded, &reference, count)?;
        }
    }
    Ok(())
}

fn main() {
    if let Err(error) = run() {
        eprintln!("{error}");
        std::process::exit(1);
    }
}
