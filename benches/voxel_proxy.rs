//! Errors of radiosity over the voxelisation proxy, beside those of the project's own patches of about the same number: a
//! Markdown table of indirect irradiance at the reference points.
//!
//! Both solve the same equation with the same numbers of rays. Patches of the proxy are the faces that light comes to (faces
//! towards closed spaces and those that see nothing are only in the way); direct light is measured on the proxy, at points
//! of its faces. `cargo bench -p benches --bench voxel_proxy [-- SCENE…]`

#![allow(missing_docs)]

use std::error::Error;
use std::ops::ControlFlow;
use std::path::Path;

use benches::SEED;
use formfactor::{Hemisphere, Patch, Stop, Surfaces, balance, form_factors, jacobi};
use glam::{Vec3, Vec4};
use reference::metrics::compare_points;
use reference::{PointErrors, ProxyLookup, ReferenceData, VoxelProxy};
use runtime::executor::{DeviceChoice, open};
use runtime::import::LoadedScene;
use runtime::progress::Progress;
use runtime::render::classic::{Classic, ClassicSettings, PatchKind, direct_params};
use scene::{DirectParams, NONE, SidePolicy, SurfacePoint, find_sides};

const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared");
/// Scenes: the name of the folder, of the file in it, and of the folder with the reference.
const SCENES: [&str; 3] = ["cornell", "cornell-dragon", "sponza"];
const COUNTS: [usize; 2] = [2000, 10_000];
/// Rays of a row of F.
const RAYS: u32 = 4096;
/// Points along the edge of a face.
const FACE_POINTS: u32 = 4;
/// Shadow rays to area lights, and rays to a sky map, at each of them.
const AREA_RAYS: u32 = 8;
const TOLERANCE: f32 = 1e-5;

type Outcome<T> = Result<T, Box<dyn Error>>;

/// The faces that take part in the exchange of light: the patch of each face, or [`NONE`].
fn patches_of(proxy: &VoxelProxy) -> (Vec<u32>, usize) {
    let sides = find_sides(&proxy.scene, SidePolicy::Lit);
    let mut takes_part = vec![false; proxy.faces.len()];
    for (t, side) in proxy.scene.triangles.iter().zip(sides) {
        takes_part[t.material as usize] |= side.front;
    }
    let mut count = 0;
    let number = |used: bool| {
        count += usize::from(used);
        if used { count as u32 - 1 } else { NONE }
    };
    (takes_part.into_iter().map(number).collect(), count)
}

/// Indirect irradiance of all faces, W/m², by the patch of each; faces that take no part have none.
fn solve(proxy: &VoxelProxy, numbers: &[u32]) -> Outcome<Vec<Vec3>> {
    let is_patch = |face: u32| numbers[face as usize] != NONE;
    let faces = || proxy.faces.iter().zip(0..).filter(|(_, face)| is_patch(*face));
    let patches: Vec<Patch> = faces()
        .map(|(f, _)| Patch { centroid: f.centre, area: proxy.face_area(), normal: f.normal, triangle: NONE })
        .collect();
    let points: Vec<SurfacePoint> = proxy.points(FACE_POINTS).into_iter().filter(|p| is_patch(p.patch)).collect();
    let own = (FACE_POINTS * FACE_POINTS) as usize;
    let offsets: Vec<u32> = (0..=patches.len()).map(|k| (k * own) as u32).collect();
    let surfaces = Surfaces {
        patches: &patches,
        polygons: &[],
        row_polygons: &[],
        points: &points,
        offsets: &offsets,
        visibility: &proxy.scene,
        owner: Box::new(|hit, direction| match proxy.face_of(hit, direction) {
            NONE => NONE,
            face => numbers[face as usize],
        }),
        ray_offset: proxy.scene.ray_offset,
        seed: SEED,
    };
    let mut rows = form_factors(&Hemisphere { rays: RAYS }, &surfaces, &|_, _| ControlFlow::Continue(()))?;
    let areas = vec![proxy.face_area(); patches.len()];
    balance(&mut rows.factors, &mut rows.sky_factor, &areas, None)?;

    let scene = &proxy.scene;
    let has_map = scene.sky.map_width > 0;
    let params = DirectParams {
        count: points.len() as u32,
        area_rays: AREA_RAYS,
        sky_rays: if has_map { AREA_RAYS } else { 0 },
        seed: SEED,
        ..direct_params(scene)
    };
    let direct = scene.direct_irradiance(&params, &points);
    let sky = if has_map { Vec3::ZERO } else { scene.sky.radiance * std::f32::consts::PI };
    let albedo: Vec<Vec4> = faces().map(|(f, _)| f.albedo.extend(0.0)).collect();
    let source: Vec<Vec4> = (0..patches.len())
        .map(|i| {
            let mean: Vec3 = (i * own..(i + 1) * own).map(|k| direct[k] * points[k].weight).sum();
            albedo[i] * (mean + sky * rows.sky_factor[i]).extend(0.0)
        })
        .collect();
    let light = jacobi(&rows.factors, &source, &albedo, Stop::Tolerance(TOLERANCE))?;
    let of_patch = |&patch: &u32| if patch == NONE { Vec3::ZERO } else { light.irradiance[patch as usize].truncate() };
    Ok(numbers.iter().map(of_patch).collect())
}

fn print_row(scene: &str, what: &str, geometry: &str, patches: usize, errors: &PointErrors) {
    println!(
        "| {scene} | {what} | {geometry} | {patches} | {:.1} % | {:.0} % | {:.3} |",
        100.0 * errors.median_relative_error,
        100.0 * errors.p95_relative_error,
        errors.mean_ratio
    );
}

fn measure_proxy(name: &str, loaded: &LoadedScene, reference: &ReferenceData, count: usize) -> Outcome<()> {
    let mut proxy = VoxelProxy::for_count(&loaded.scene, count, |p| patches_of(p).1)?;
    let (numbers, patches) = patches_of(&proxy);
    let light = solve(&proxy, &numbers)?;
    proxy.hide_faces(|face| numbers[face as usize] == NONE);
    let geometry = format!("{} faces of {:.1} cm", proxy.faces.len(), 100.0 * proxy.edge);
    for (lookup, what) in [(ProxyLookup::Face, "voxel faces"), (ProxyLookup::Bilinear, "voxel faces, bilinear")] {
        let ours: Vec<Vec3> = reference
            .surface_points(loaded.metres_per_unit)
            .iter()
            .map(|p| proxy.value_at(&light, p.position, p.normal, lookup))
            .collect::<Result<_, _>>()?;
        print_row(name, what, &geometry, patches, &compare_points(&ours, &reference.point_indirect())?);
    }
    Ok(())
}

fn measure_own(name: &str, loaded: &LoadedScene, reference: &ReferenceData, count: usize) -> Outcome<()> {
    let settings = ClassicSettings {
        patches: PatchKind::Cluster,
        patch_count: count,
        // Only the points matter.
        receiver_edge: Some(0.1 * loaded.scene.diagonal()),
        receiver_rays: 16,
        sub_frames: 1,
        size: (16, 16),
        seed: SEED,
        ..ClassicSettings::default()
    };
    let mut classic = Classic::bake(loaded, settings, open(&DeviceChoice::Cpu)?.0, &mut Progress::new(true))?;
    classic.frame(&loaded.scene.lights, &loaded.view.camera(16, 16), 0)?;
    let ours = classic.irradiance_at(&reference.surface_points(loaded.metres_per_unit))?;
    let errors = compare_points(&ours, &reference.point_indirect())?;
    let geometry = format!("{} triangles", loaded.scene.triangles.len());
    print_row(name, "clusters", &geometry, classic.patch_count(), &errors);
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
        let loaded = runtime::import::load(&file)?;
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
