//! Photons that start where lights fall first, against other ways to find the same light: the path tracer, the operator
//! of all bounces, reference data; and the same photons by kernels.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use assets::{load_or_build, procedural};
use firstshot::{
    Emission, IlluminationMaps, LightElement, LightElementSettings, PhotonAccumulator, PhotonSettings, Round, Sums,
    Texels, Tracer, light_elements, light_elements_by,
};
use formfactor::{Hemisphere, balance, form_factors};
use glam::{DVec3, Vec2, Vec3, Vec4};
use integration_tests::limited::Limited;
use integration_tests::setup::Setup;
use integration_tests::vulkan;
use multibounce::{Factors, all_bounces};
use patches::{PatchSize, SubdivideSettings, Subdivision, subdivide};
use patchlight::method::FirstShotSettings;
use patchlight::method::firstshot::FirstShotMethod;
use patchlight::{Bake, MethodSettings, Picture};
use reference::Accumulation;
use reference::path::{PathSettings, PathTracer};
use runtime::cpu::Cpu;
use runtime::executor::{DeviceKind, Executor};
use runtime::plan::Plan;
use runtime::recipe::Tables;
use runtime::recipe::firstshot::{MapSlices, PhotonPasses, PhotonTargets};
use runtime::recipe::rays::RayStops;
use runtime::recipe::scene::SceneTables;
use scene::gpu::{DirectParams, LIGHT_POINT, LIGHT_SPOT};
use scene::math::luminance;
use scene::sampling::{hammersley, hash3, uniform_triangle};
use scene::{Hit, Light, NONE, Ray, Scene, SurfacePoint};

fn ignore_progress(_: usize, _: usize) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn first_shot(scene: &Scene) -> Emission {
    Emission::first_shot(scene, &LightElementSettings::default(), Texels::Mean, true, &ignore_progress).unwrap()
}

/// Photons on the patches of a subdivision.
struct OnPatches<'a> {
    subdivision: &'a Subdivision,
    areas: Vec<f32>,
    scene: &'a Scene,
}

impl PhotonAccumulator for OnPatches<'_> {
    fn areas(&self) -> &[f32] {
        &self.areas
    }

    fn cell(&self, triangle: u32, u: f32, v: f32, is_back: bool) -> u32 {
        let front = self.scene.tables().normal(triangle);
        let hit = Hit { triangle, u, v, t: 0.0 };
        self.subdivision.owner(self.scene, &hit, if is_back { front } else { -front })
    }
}

/// Patches, and their indirect irradiance by the operator of all bounces from direct light at many points.
fn by_operator(scene: &Scene, patches: u32) -> (Subdivision, Vec<Vec3>) {
    let cut = SubdivideSettings { size: PatchSize::Count(patches), points: 64, ..Default::default() };
    let subdivision = subdivide(scene, &cut).unwrap();
    let areas = subdivision.areas();
    let mut rows = {
        let surfaces = subdivision.surfaces(scene, &[]);
        form_factors(&Hemisphere { rays: 4096 }, &surfaces, &ignore_progress).unwrap()
    };
    balance(&mut rows.factors, &mut rows.sky_factor, &areas, None).unwrap();
    let csr = rows.factors.to_csr(0.0).unwrap();
    let factors = Factors { row_start: &csr.row_start, columns: &csr.column_index, values: &csr.values, area: &areas };
    let symmetric = factors.symmetric().unwrap();
    let direct = DirectParams {
        light_count: scene.lighting.lights.len() as u32,
        emitter_count: scene.emitters.len() as u32,
        area_rays: 16,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    };
    let light = scene.direct_irradiance(&direct, &subdivision.points);
    let n = areas.len();
    let mut irradiance = vec![Vec3::ZERO; n];
    let albedo: Vec<Vec3> = (0..n).map(|k| scene.tables().albedo(subdivision.patches[k].triangle, 0.3, 0.3)).collect();
    for channel in 0..3 {
        let reflectance: Vec<f32> = albedo.iter().map(|a| a[channel]).collect();
        let operator = all_bounces(symmetric.clone(), &reflectance).unwrap();
        let source: Vec<f64> = (0..n)
            .map(|k| {
                let own = subdivision.offsets[k] as usize..subdivision.offsets[k + 1] as usize;
                let mean: f32 = own.map(|i| light[i][channel] * subdivision.points[i].weight).sum();
                f64::from(mean * reflectance[k])
            })
            .collect();
        // The operator is A^½ T A^-½.
        for (i, irradiance) in irradiance.iter_mut().enumerate() {
            let sum: f64 =
                (0..n).map(|j| f64::from(operator[(i, j)]) * f64::from(areas[j] / areas[i]).sqrt() * source[j]).sum();
            irradiance[channel] = sum as f32;
        }
    }
    (subdivision, irradiance)
}

/// Means over coarse patches of the irradiance of fine ones.
fn on_coarse(scene: &Scene, coarse: &Subdivision, fine: &Subdivision, irradiance: &[Vec3]) -> Vec<Vec3> {
    let mut sums = vec![(Vec3::ZERO, 0.0f32); coarse.patches.len()];
    for (k, patch) in fine.patches.iter().enumerate() {
        for point in &fine.points[fine.offsets[k] as usize..fine.offsets[k + 1] as usize] {
            let (u, v) = scene.shares(patch.triangle, point.position);
            let hit = Hit { triangle: patch.triangle, u, v, t: 0.0 };
            let (sum, area) = &mut sums[coarse.owner(scene, &hit, -point.normal) as usize];
            *sum += irradiance[k] * (patch.area * point.weight);
            *area += patch.area * point.weight;
        }
    }
    sums.iter().map(|(sum, area)| *sum / area.max(f32::MIN_POSITIVE)).collect()
}

/// Area-weighted relative difference (L2) of luminance.
fn difference(areas: &[f32], found: &[Vec3], expected: &[Vec3]) -> f64 {
    let mut wrong = 0.0f64;
    let mut all = 0.0f64;
    for ((a, b), &area) in found.iter().zip(expected).zip(areas) {
        let a = f64::from(luminance(*a));
        let b = f64::from(luminance(*b));
        wrong += f64::from(area) * (a - b).powi(2);
        all += f64::from(area) * b * b;
    }
    (wrong / all).sqrt()
}

#[test]
fn photons_agree_with_the_operator_of_all_bounces() {
    for (name, patches) in [("cornell", 600), ("office", 1200)] {
        let loaded = procedural::build(name).unwrap();
        let scene = &loaded.scene;
        // What the operator states: how far that of a fourth of the patches is from it, which is more than its own
        // error.
        let (coarse, rough) = by_operator(scene, patches);
        let (fine, irradiance) = by_operator(scene, 4 * patches);
        let expected = on_coarse(scene, &coarse, &fine, &irradiance);
        let areas = coarse.areas();
        let of_operator = difference(&areas, &rough, &expected);
        let accumulator = OnPatches { subdivision: &coarse, areas: areas.clone(), scene };
        let emission = first_shot(scene);
        let settings = PhotonSettings { error: 0.02, ..PhotonSettings::default() };
        let mut tracer = Tracer::new(scene, &emission, &accumulator, settings).unwrap();
        assert!(tracer.run(&|_| ControlFlow::Continue(())));
        let found = tracer.estimate();
        let own = difference(&areas, &found.irradiance, &expected);
        let stated = found.round.error;
        println!("{name}: difference {own:.4}, stated by the photons {stated:.4}, by the operator {of_operator:.4}");
        assert!(own < stated + of_operator, "{name}: {own} {stated} {of_operator}");
        assert!(own > 0.5 * stated, "{name}: better than its own noise: {own} {stated}");
        let wrong: Vec<Vec3> = found.irradiance.iter().map(|light| *light * 1.1).collect();
        assert!(difference(&areas, &wrong, &expected) > stated + of_operator, "{name}: a tenth too much is noticed");
    }
}

/// Points spread over a cell of the maps, on its side.
fn points_of_cell(scene: &Scene, maps: &IlluminationMaps, triangle: u32, wanted: u32, count: u32) -> Vec<SurfacePoint> {
    let geometry = scene.tables();
    let (_, [a, b, c]) = maps.cells(triangle, false).find(|(cell, _)| *cell == wanted).unwrap();
    (0..count)
        .map(|k| {
            let (u, v) = uniform_triangle(hammersley(k, count, (hash3(wanted, 0, 0), hash3(wanted, 1, 0))));
            let at = a + (b - a) * u + (c - a) * v;
            let position = geometry.position(triangle, at.x, at.y);
            let normal = geometry.normal(triangle);
            SurfacePoint { position, patch: NONE, normal, weight: 1.0 }
        })
        .collect()
}

#[test]
fn photons_agree_with_the_path_tracer() {
    for (name, is_filled) in [("cornell", false), ("cornell", true), ("atrium", false), (MIRRORS, false)] {
        let mut loaded = load_or_build(name).unwrap();
        if is_filled {
            // A third to nearly all of the light is absorbed on a way across.
            let absorption = Vec3::new(0.5, 1.0, 3.0) / loaded.scene.diagonal();
            Arc::get_mut(&mut loaded.scene.geometry).expect("one owner").absorption = absorption;
        }
        let scene = &loaded.scene;
        let maps = IlluminationMaps::new(scene, 0.05 * scene.diagonal()).unwrap();
        let emission = first_shot(scene);
        let settings = PhotonSettings { error: 0.0, most_photons: 1 << 22, batches: 16, ..PhotonSettings::default() };
        let run = |settings: PhotonSettings| {
            let mut tracer = Tracer::new(scene, &emission, &maps, settings).unwrap();
            assert!(tracer.run(&|_| ControlFlow::Continue(())));
            tracer.estimate()
        };
        let found = run(settings);
        // The cells with the least relative error, by other photons: cells that chance favours would look bright. Those
        // with most light would not do: in the atrium single photons tell there, and their sum differs by 3 % from seed
        // to seed.
        let others = run(PhotonSettings { seed: 1, most_photons: 1 << 18, ..settings });
        let certainty =
            |k: u32| luminance(others.irradiance[k as usize]) / others.error[k as usize].max(f32::MIN_POSITIVE);
        let mut cells: Vec<(u32, u32)> = (0..scene.geometry.triangles.len() as u32)
            .flat_map(|t| maps.cells(t, false).map(move |(cell, _)| (t, cell)).collect::<Vec<_>>())
            .collect();
        cells.sort_by(|a, b| certainty(b.1).total_cmp(&certainty(a.1)));
        cells.truncate(24);
        let tracer = PathTracer::new(scene);
        let path = PathSettings::default();
        let mut squares = 0.0f64;
        let mut worst = 0.0f64;
        let mut light = [0.0f64; 2];
        let mut variances = 0.0f64;
        for &(t, cell) in &cells {
            let points = points_of_cell(scene, &maps, t, cell, 64);
            let traced = tracer.irradiance(&points, 512, &path);
            let n = points.len() as f64;
            let mean = traced.iter().map(|p| p.indirect.as_dvec3()).sum::<DVec3>() / n;
            let mean = f64::from(luminance(mean.as_vec3()));
            let own = f64::from(luminance(found.irradiance[cell as usize]));
            // Noise of the paths, and of the places of the cell.
            let spread: f64 = traced.iter().map(|p| (f64::from(luminance(p.indirect)) - mean).powi(2)).sum();
            let variance = spread / (n * (n - 1.0)) + f64::from(found.error[cell as usize]).powi(2);
            let sigma = (own - mean) / variance.sqrt();
            squares += sigma * sigma;
            worst = worst.max(sigma.abs());
            variances += variance;
            light = [light[0] + own, light[1] + mean];
        }
        let rms = (squares / cells.len() as f64).sqrt();
        let ratio = light[0] / light[1];
        // Errors of cells are partly those of the same photons: twice as much as if they were independent. In the
        // atrium the light of all cells differs by 3 % from seed to seed, for photons from the lights as well.
        let noise = 2.0 * variances.sqrt() / light[1];
        println!("{name}: {rms:.2} standard errors, worst {worst:.2}, light {ratio:.4}, noise {noise:.4}");
        // Places are spread evenly, so the spread overstates their noise.
        let bound = if name == "cornell" { 0.01 } else { 2.0 * noise };
        let agrees = |ratio: f64| (ratio - 1.0).abs() < bound;
        // The root mean square of so many normal deviates is 1 ± 1/√48: three of these, and what the spread of places
        // adds to the tails of each.
        assert!(rms < 1.45 && worst < 4.5 && agrees(ratio), "{name}: {rms} {worst} {ratio} {noise}");
        let wrong = if name == "cornell" { 1.03 } else { 1.1 };
        assert!(noise < 0.045 && !agrees(wrong * ratio), "{name}: more light is noticed: {noise}");
    }
}

/// A room with a mirror, a ball of glass and a pane.
const MIRRORS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/mirrors/room.toml");

/// Sums of 2048 photons in a plan of its own, traced in dispatches of so many of each batch, the error that the device
/// states, and the irradiance of elements that own two cells each.
fn by_kernels(
    mut executor: Box<dyn Executor>,
    scene: &Scene,
    maps: &IlluminationMaps,
    settings: PhotonSettings,
    dispatch: u32,
) -> (Sums, f64, Vec<Vec4>) {
    let emission = first_shot(scene);
    let mut plan = Plan::new();
    let mut tables = Tables::new();
    let scene_tables = SceneTables::new(&mut plan, &mut tables, scene, scene.lighting.lights.len().max(1));
    let areas = maps.areas().to_vec();
    let cells = areas.len() as u32;
    let elements = cells / 2;
    let irradiance = plan.array("irradiance", elements as usize);
    let element_areas = areas.chunks(2).map(|pair| pair[0] + pair[1]).collect::<Vec<f32>>();
    let slices = MapSlices {
        grids: tables.owned(&mut plan, "grids", maps.grids.clone()),
        groups: tables.owned(&mut plan, "groups", (0..cells).collect()),
        group_areas: tables.owned(&mut plan, "group_areas", areas.clone()),
        cell_start: tables.owned(&mut plan, "cell_start", (0..=elements).map(|k| 2 * k).collect()),
        cells: tables.owned(&mut plan, "cells", (0..cells).collect()),
        element_areas: tables.owned(&mut plan, "element_areas", element_areas),
        irradiance,
    };
    let targets = PhotonTargets { cells, groups: cells, elements, batches: settings.batches };
    let capacity = emission.elements.len();
    let passes = PhotonPasses::add(&mut plan, &scene_tables, &slices, targets, capacity).unwrap();
    let executor = executor.as_mut();
    executor.load(plan).unwrap();
    tables.upload(executor).unwrap();
    scene_tables.set_lights(executor, &scene.lighting.lights).unwrap();
    scene_tables.set_sky_and_emission(executor, scene).unwrap();
    passes.start(executor, &emission).unwrap();
    for first in (0..256).step_by(dispatch as usize) {
        let p = settings.params(scene, &emission, first, dispatch, [cells, cells]);
        passes.trace(executor, &p).unwrap();
    }
    let error = passes.relative_error(executor).unwrap();
    passes.resolve(executor, (emission.power / 2048.0) as f32).unwrap();
    let light = executor.download_table(irradiance).unwrap();
    let (flux, tallies) = passes.words(executor).unwrap();
    (Sums::from_words(flux, tallies, cells as usize, areas, settings.batches).unwrap(), error, light)
}

#[test]
fn kernels_register_the_photons_of_the_host_in_every_bit() {
    let Some(vulkan) = vulkan() else { return };
    let exact = vulkan.device().kind == DeviceKind::EmulatedOnCpu;
    let mut loaded = load_or_build(MIRRORS).unwrap();
    // Photons of it start, mirrored and refracted, on mirror and glass.
    let position = Vec3::new(0.6, 1.7, 1.6);
    let lamp = Light { kind: LIGHT_POINT, position, color: Vec3::new(3.0, 2.0, 1.0), ..Light::default() };
    loaded.scene.set_lights(&[lamp]);
    let scene = &loaded.scene;
    let emission = first_shot(scene);
    let maps = IlluminationMaps::new(scene, 0.1).unwrap();
    let settings = PhotonSettings { seed: 4, error: 0.0, most_photons: 2048, ..PhotonSettings::default() };
    let host = |settings: PhotonSettings| {
        let mut tracer = Tracer::new(scene, &emission, &maps, settings).unwrap();
        assert!(tracer.run(&|_| ControlFlow::Continue(())));
        tracer.estimate()
    };
    let expected = host(settings);
    let (theirs, theirs_error, theirs_light) = by_kernels(Box::new(vulkan), scene, &maps, settings, 64);
    let (ours, ours_error, ours_light) = by_kernels(Box::new(Cpu::new()), scene, &maps, settings, 64);
    let found = theirs.estimate(maps.areas(), emission.power, 256);
    if exact {
        assert!(ours.words() == theirs.words(), "the sums differ");
        assert!(ours_error == theirs_error && ours_light == theirs_light);
        // In one dispatch instead of four, by other threads, in another order.
        assert_eq!((found.round, found.emitted), (expected.round, expected.emitted));
        assert!(found.irradiance == expected.irradiance && found.error == expected.error);
        assert_eq!(theirs_error, expected.round.error);
    }
    assert!(difference(maps.areas(), &found.irradiance, &expected.irradiance) < 0.02);
    // The elements' irradiance is the mean of their cells.
    let mut lit = 0;
    for ((light, pair), areas) in theirs_light.iter().zip(found.irradiance.chunks(2)).zip(maps.areas().chunks(2)) {
        let mean = (pair[0] * areas[0] + pair[1] * areas[1]) / (areas[0] + areas[1]);
        assert!((light.truncate() - mean).abs().max_element() <= 1e-5 * mean.max_element(), "{light} {mean}");
        lit += u32::from(mean != Vec3::ZERO);
    }
    assert!(lit > 100, "{lit}");
    // Other random numbers are noticed.
    let other = host(PhotonSettings { seed: 5, ..settings });
    assert!(difference(maps.areas(), &found.irradiance, &other.irradiance) > 0.1);
}

/// A hall under its sun, a lamp and a spot between its columns: triangles that are refined, and small ones that share
/// rays.
#[test]
fn light_elements_by_rays_of_a_device_are_those_of_the_host() {
    let mut loaded = load_or_build("atrium:3000").unwrap();
    let middle = 0.5 * (loaded.scene.geometry.bounds.0 + loaded.scene.geometry.bounds.1);
    let lamp = Light { kind: LIGHT_POINT, position: middle, color: Vec3::splat(100.0), ..Light::default() };
    let direction = Vec3::new(0.6, -0.8, 0.0);
    let cos_inner = 0.9;
    let cos_outer = 0.8;
    let spot = Light { kind: LIGHT_SPOT, direction, cos_inner, cos_outer, ..lamp };
    let lights = [&loaded.scene.lighting.lights[..], &[lamp, spot]].concat();
    loaded.scene.set_lights(&lights);
    let scene = &loaded.scene;
    let ours = LightElementSettings { elements: 1 << 13, ..LightElementSettings::default() };
    let mut executors: Vec<Box<dyn Executor>> = vec![Box::new(Cpu::new())];
    executors.extend(vulkan().map(|vulkan| Box::new(vulkan) as Box<dyn Executor>));
    for settings in [ours, ours.as_printed()] {
        let own = light_elements(scene, &settings, &ignore_progress).unwrap();
        let is_shared = |element: &LightElement| element.seen < 1.0;
        let split = own.elements.iter().filter(|element| element.corners[1] != Vec2::X).count();
        assert!(split > 500 && own.elements.iter().any(is_shared) && own.shadow_rays > 10_000);
        for executor in &mut executors {
            let executor = executor.as_mut();
            let stops = RayStops::load(executor, scene).unwrap();
            let mut asked = Vec::new();
            let mut found = |is_wrong: bool| {
                asked.clear();
                let trace = &mut |rays: &[Ray]| -> Result<Vec<u32>, firstshot::Error> {
                    asked.push(rays.len() as u64);
                    let mut stopped = stops.find(executor, rays).unwrap();
                    // One answer among those of the first step.
                    stopped[rays.len() / 3] ^= u32::from(is_wrong && asked.len() == 1);
                    Ok(stopped)
                };
                let found = light_elements_by(trace, scene, &settings, &ignore_progress).unwrap();
                assert_eq!(asked.iter().sum::<u64>(), found.shadow_rays);
                found
            };
            let theirs = found(false);
            assert!(theirs.shadow_rays == own.shadow_rays && theirs.elements == own.elements);
            assert!(found(true).elements != theirs.elements, "a ray that goes wrong is noticed");
            assert!(asked.len() < 40, "{} steps", asked.len());
        }
    }
}

/// A frame of the Cornell box with photons until an error, under light of another colour than that of the bake, and of
/// a lamp if one is given: irradiance of the elements, bytes that were read back for it, photons and error.
fn frame(bake: &Arc<Bake>, inner: Box<dyn Executor>, error: f64, lamp: Option<Light>) -> (Vec<Vec4>, usize, Round) {
    let executor = Limited::new(inner, u64::MAX);
    let downloaded = executor.downloaded();
    let loaded = procedural::build("cornell").unwrap();
    let method =
        MethodSettings::FirstShot(FirstShotSettings { error, most_photons: 1 << 19, ..FirstShotSettings::default() });
    let mut renderer = Setup { method, ..small() }.load(&loaded, bake, Box::new(executor)).unwrap();
    let camera = loaded.view.camera(16, 9);
    let mut lighting = loaded.scene.lighting.clone();
    let bluer = Vec3::new(0.1, 0.5, 5.0);
    lighting.emission = loaded.scene.materials.iter().map(|m| m.radiance * bluer).collect();
    lighting.lights.iter_mut().for_each(|light| light.color *= bluer);
    lighting.lights.extend(lamp);
    renderer.update_light(&loaded.scene.lighting, &camera).unwrap();
    let before = downloaded.load(Ordering::Relaxed);
    renderer.update_light(&lighting, &camera).unwrap();
    let bytes = downloaded.load(Ordering::Relaxed) - before;
    let elements = renderer.light().buffers().elements;
    let light = renderer.light_mut().download(elements).unwrap();
    let round = renderer.light_mut().counted_method::<FirstShotMethod>().unwrap().unwrap().shot().round();
    // Without any light there are no photons.
    lighting.emission.fill(Vec3::ZERO);
    lighting.lights.clear();
    lighting.sky.radiance = Vec3::ZERO;
    renderer.update_light(&lighting, &camera).unwrap();
    let elements = renderer.light().buffers().elements;
    let dark = renderer.light_mut().download(elements).unwrap();
    assert!(dark.iter().all(|h| *h == Vec4::ZERO));
    (light, bytes, round)
}

/// A picture of the room with a mirror by photons, or by form factors.
fn picture_of_mirrors(bake: &Arc<Bake>, method: MethodSettings, executor: Box<dyn Executor>) -> Picture {
    let loaded = load_or_build(MIRRORS).unwrap();
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let mut renderer = Setup { method, ..of_mirrors() }.load(&loaded, bake, executor).unwrap();
    renderer.update_light(&loaded.scene.lighting, &camera).unwrap();
    renderer.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures.full
}

/// Size of pictures of the room with a mirror, pixels.
const SIZE: (u32, u32) = (40, 30);

fn of_mirrors() -> Setup {
    Setup { patch_count: 500, most_receivers: Some(3000), receiver_rays: 128, size: SIZE, seed: 3, ..Setup::default() }
}

#[test]
fn pictures_by_photons_have_what_mirrors_and_glass_show_and_send() {
    let loaded = load_or_build(MIRRORS).unwrap();
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let bake = of_mirrors().bake(&loaded).unwrap();
    let photons =
        MethodSettings::FirstShot(FirstShotSettings { error: 0.02, most_photons: 1 << 21, ..Default::default() });
    let found = picture_of_mirrors(&bake, photons, Box::new(Cpu::new()));
    let mut accumulation = Accumulation::new(&camera, PathSettings::default());
    let ignore_progress = |_, _| ControlFlow::Continue(());
    assert!(PathTracer::new(&loaded.scene).accumulate(&camera, &mut accumulation, 512, ignore_progress).unwrap());
    let expected = accumulation.full();
    // Means of squares of pixels: edges of triangles and caustics are finer than receivers.
    let blocks = |picture: &Picture| -> Vec<f32> {
        let mut sums = vec![0.0; (SIZE.0 * SIZE.1 / 25) as usize];
        for (k, pixel) in (0u32..).zip(&picture.pixels) {
            let x = k % SIZE.0 / 5;
            let y = k / SIZE.0 / 5;
            // The lamp itself would outweigh all else.
            sums[(y * (SIZE.0 / 5) + x) as usize] += luminance(pixel.min(Vec3::ONE)) / 25.0;
        }
        sums
    };
    let error = |picture: &Picture| {
        let pairs = blocks(picture).into_iter().zip(blocks(&expected)).filter(|(_, b)| *b > 0.01);
        let errors: Vec<f32> = pairs.map(|(a, b)| (a / b - 1.0).abs()).collect();
        errors.iter().sum::<f32>() / errors.len() as f32
    };
    let own = error(&found);
    let by_factors = error(&picture_of_mirrors(&bake, MethodSettings::default(), Box::new(Cpu::new())));
    println!("photons {own:.4}, form factors {by_factors:.4}");
    assert!(own < 0.06 && by_factors > 1.3 * own, "{own} {by_factors}");
    let Some(vulkan) = vulkan() else { return };
    let exact = vulkan.device().kind == DeviceKind::EmulatedOnCpu;
    let theirs = picture_of_mirrors(&bake, photons, Box::new(vulkan));
    assert!(!exact || found == theirs, "host and device differ");
}

fn small() -> Setup {
    Setup { patch_count: 200, most_receivers: Some(400), receiver_rays: 64, size: (16, 9), seed: 3, ..Setup::default() }
}

#[test]
fn a_frame_reads_back_no_photons_and_is_the_same_on_every_executor() {
    let bake = small().bake(&procedural::build("cornell").unwrap()).unwrap();
    let blocks = bake.mesh().patches.len().div_ceil(64);
    let (light, bytes, round) = frame(&bake, Box::new(Cpu::new()), 0.0, None);
    assert_eq!((bytes, round.photons), (0, 1 << 19));
    let sum: Vec4 = light.iter().sum();
    assert!(sum.z > sum.x && sum.x > 0.0, "the light is blue: {sum}");
    // With an error that is asked for, 8 bytes for 64 patches after each round.
    let (_, bytes, round) = frame(&bake, Box::new(Cpu::new()), 0.05, None);
    assert!(
        bytes > 0 && bytes <= 20 * 8 * blocks && bytes.is_multiple_of(8 * blocks),
        "{bytes} bytes, {blocks} blocks"
    );
    assert!(round.error <= 0.05 && round.photons < 1 << 19, "{round:?}");
    let Some(vulkan) = vulkan() else { return };
    let exact = vulkan.device().kind == DeviceKind::EmulatedOnCpu;
    let (theirs, bytes, _) = frame(&bake, Box::new(vulkan), 0.0, None);
    assert_eq!(bytes, 0);
    assert!(!exact || light == theirs, "host and device differ");
}

#[test]
fn a_frame_finds_light_elements_by_shadow_rays_of_its_device() {
    let Some(vulkan) = vulkan() else { return };
    let exact = vulkan.device().kind == DeviceKind::EmulatedOnCpu;
    let loaded = procedural::build("cornell").unwrap();
    let bake = small().bake(&loaded).unwrap();
    let position = 0.5 * (loaded.scene.geometry.bounds.0 + loaded.scene.geometry.bounds.1);
    let lamp = Light { kind: LIGHT_POINT, position, color: Vec3::splat(3.0), ..Light::default() };
    let of_host = frame(&bake, Box::new(Cpu::new()), 0.0, Some(lamp));
    let of_device = frame(&bake, Box::new(vulkan), 0.0, Some(lamp));
    assert!(of_host.1 == 0 && of_device.1 > 0, "what is read back: {} {}", of_host.1, of_device.1);
    assert!(!exact || of_host.0 == of_device.0, "host and device differ");
    let other = frame(&bake, Box::new(Cpu::new()), 0.0, Some(Light { position: position - 0.1, ..lamp }));
    assert!(other.0 != of_host.0, "a lamp elsewhere is noticed");
}
