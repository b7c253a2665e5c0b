//! Voxel and axis patches as their own receivers: the whole pipeline on scenes whose answer is known, on both
//! executors.

use assets::import::LoadedScene;
use assets::procedural;
use glam::Vec3;
use integration_tests::setup::Setup;
use integration_tests::vulkan;
use patches::PatchKind;
use patchlight::{Estimator, Pictures, ReceiverKind};
use reference::metrics::quantile;
use runtime::executor::{DeviceChoice, Executor, open};
use scene::math::luminance;
use scene::sampling::{hash3, uniform_triangle, unit};
use scene::{Lighting, Scene, SurfacePoint};
use std::sync::Arc;

const SIZE: (u32, u32) = (40, 30);
const KINDS: [PatchKind; 2] = [PatchKind::Voxel, PatchKind::Axis];
/// Radiance in the furnace, and irradiance at most points, may be off by this share.
const TOLERANCE: f32 = 0.03;
/// Limit for 95 % of the points: the light of a near wall is noisy at the sample points of patches in corners.
const MAX: f64 = 0.08;

fn settings(patches: PatchKind) -> Setup {
    Setup {
        patches,
        patch_count: 300,
        estimator: Estimator::Hemisphere { rays: 512 },
        receivers: ReceiverKind::Patches,
        sub_frames: 4,
        seed: 3,
        size: SIZE,
        ..Setup::default()
    }
}

fn cpu() -> Box<dyn Executor> {
    open(&DeviceChoice::Cpu).unwrap().0
}

/// A frame's pictures and, after it, the indirect irradiance at points.
fn render(
    loaded: &LoadedScene,
    settings: Setup,
    executor: Box<dyn Executor>,
    points: &[SurfacePoint],
) -> (Pictures, Vec<Vec3>) {
    let mut classic = settings.renderer(loaded, executor).unwrap();
    assert_eq!(classic.light().bake().receivers().points.len(), 0);
    let camera = loaded.view.camera(SIZE.0, SIZE.1);
    let pictures = classic.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures;
    (pictures, classic.light_mut().irradiance_at(points).unwrap())
}

/// Points on the fronts of the triangles.
fn points(scene: &Scene, count: u32) -> Vec<SurfacePoint> {
    let geometry = scene.tables();
    let point = |k: u32| {
        let triangle = k % scene.geometry.triangles.len() as u32;
        let (u, v) = uniform_triangle((unit(hash3(k, 0, 3)), unit(hash3(k, 1, 3))));
        let position = geometry.position(triangle, u, v);
        let normal = geometry.normal(triangle);
        SurfacePoint { position, normal, weight: 1.0, ..SurfacePoint::default() }
    };
    (0..count).map(point).collect()
}

/// A closed box of uniform emission and albedo: H = Me/(1 − ρ), of which Me came straight from the walls, at every
/// point, and L = Le/(1 − ρ) in every direction.
fn check_furnace(loaded: &LoadedScene, pictures: &Pictures, indirect: &[Vec3]) -> Result<(), String> {
    let material = loaded.scene.materials[loaded.scene.geometry.triangles[0].material as usize];
    let exitance = material.radiance * std::f32::consts::PI;
    let expected = exitance / (Vec3::ONE - material.albedo);
    let off = |h: &Vec3| f64::from(((exitance + *h) / expected - 1.0).abs().max_element());
    let mut off: Vec<f64> = indirect.iter().map(off).collect();
    let median = quantile(&mut off, 0.5);
    let p95 = quantile(&mut off, 0.95);
    println!("irradiance at points off by {median:.4} (median), {p95:.4} (95th percentile)");
    if median > f64::from(TOLERANCE) || p95 > MAX {
        return Err(format!("irradiance at points off by {median} (median), {p95} (95th percentile)"));
    }
    let radiance = material.radiance / (Vec3::ONE - material.albedo);
    let mean = pictures.full.pixels.iter().sum::<Vec3>() / pictures.full.pixels.len() as f32;
    if (mean / radiance - 1.0).abs().max_element() > TOLERANCE {
        return Err(format!("picture: {mean} instead of {radiance}"));
    }
    Ok(())
}

#[test]
fn a_furnace_is_as_bright_as_it_must_be_everywhere() {
    let loaded = procedural::build("furnace").unwrap();
    let points = points(&loaded.scene, 500);
    // A darker box must be noticed.
    let mut darker = procedural::build("furnace").unwrap();
    Arc::make_mut(&mut darker.scene.materials).iter_mut().for_each(|m| m.albedo *= 0.9);
    for kind in KINDS {
        let (pictures, indirect) = render(&loaded, settings(kind), cpu(), &points);
        check_furnace(&loaded, &pictures, &indirect).unwrap();
        let (wrong, wrong_indirect) = render(&darker, settings(kind), cpu(), &points);
        assert!(check_furnace(&loaded, &wrong, &indirect).is_err());
        assert!(check_furnace(&loaded, &pictures, &wrong_indirect).is_err());
    }
}

#[test]
fn patches_that_receive_take_every_bounce() {
    let loaded = procedural::build("furnace").unwrap();
    let points = points(&loaded.scene, 50);
    let material = loaded.scene.materials[0];
    let exitance = material.radiance.x * std::f32::consts::PI;
    let albedo = material.albedo.x;
    for kind in KINDS {
        for bounces in 1..=3 {
            let one = Setup { bounces: Some(bounces), ..settings(kind) };
            let (_, indirect) = render(&loaded, one, cpu(), &points);
            let mean = indirect.iter().map(|h| h.x).sum::<f32>() / points.len() as f32;
            // H of K bounces: Me Σ_{k=1..K} ρᵏ.
            let after = |bounces: u32| (1..=bounces).map(|k| exitance * albedo.powi(k as i32)).sum::<f32>();
            println!("{kind:?}, {bounces} bounces: {mean} of {}", after(bounces));
            assert!((mean / after(bounces) - 1.0).abs() < TOLERANCE, "{kind:?}, {bounces} bounces: {mean}");
            assert!((mean / after(bounces + 1) - 1.0).abs() > TOLERANCE, "{kind:?}, {bounces} bounces: {mean}");
        }
    }
}

#[test]
fn patches_of_voxels_carry_the_light_that_clusters_do() {
    let loaded = procedural::build("cornell").unwrap();
    let light = |loaded: &LoadedScene, settings: Setup| {
        let mut classic = settings.renderer(loaded, cpu()).unwrap();
        let camera = loaded.view.camera(SIZE.0, SIZE.1);
        let picture = classic.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures.indirect;
        picture.pixels.iter().map(|p| luminance(*p)).sum::<f32>()
    };
    let clusters = Setup { patches: PatchKind::Cluster, receivers: ReceiverKind::Mesh, ..settings(KINDS[0]) };
    let expected = light(&loaded, Setup { patch_count: 600, ..clusters });
    let mut darker = procedural::build("cornell").unwrap();
    Arc::make_mut(&mut darker.scene.materials).iter_mut().for_each(|m| m.albedo *= 0.93);
    for kind in KINDS {
        let fine = Setup { patch_count: 1000, ..settings(kind) };
        let off = |found: f32| (found / expected - 1.0).abs();
        let found = light(&loaded, fine);
        assert!(off(found) < 0.05, "{kind:?}: {found} {expected}");
        let sized = Setup { patch_count: 1, voxel_size: Some(0.06), ..fine };
        let found = light(&loaded, sized);
        assert!(off(found) < 0.05, "{kind:?}, voxels of 6 cm: {found} {expected}");
        assert!(off(light(&darker, fine)) > 0.05, "{kind:?}");
    }
}

#[test]
fn patches_without_voxels_are_refused_as_receivers() {
    let loaded = procedural::build("furnace").unwrap();
    for kind in [PatchKind::Polygon, PatchKind::Cluster] {
        let error = settings(kind).renderer(&loaded, cpu()).err().unwrap().to_string();
        assert!(error.contains("voxel and axis patches"), "{error}");
    }
}

#[test]
fn the_inside_of_a_sealed_box_in_the_sun_stays_dark() {
    let loaded = procedural::build("sealed-box").unwrap();
    let inside: Vec<SurfacePoint> = points(&loaded.scene, 20 * loaded.scene.geometry.triangles.len() as u32)
        .into_iter()
        .filter(is_of_the_box)
        .collect();
    assert!(inside.len() > 100);
    let outside: Vec<SurfacePoint> = inside.iter().map(|p| SurfacePoint { normal: -p.normal, ..*p }).collect();
    let both = [inside.clone(), outside].concat();
    let sun = loaded.scene.lighting.lights.iter().map(|l| luminance(l.color)).fold(0.0, f32::max);
    for kind in KINDS {
        // The box stands more than half a voxel above the ground.
        let fine = Setup { voxel_size: Some(0.45), estimator: Estimator::Hemisphere { rays: 64 }, ..settings(kind) };
        let (pictures, light) = render(&loaded, fine, cpu(), &both);
        let greatest = |light: &[Vec3]| light.iter().map(|l| luminance(*l)).fold(0.0, f32::max) / sun;
        let (within, without) = light.split_at(inside.len());
        assert!(greatest(&pictures.full.pixels) < 1e-4, "{kind:?}: {}", greatest(&pictures.full.pixels));
        assert!(greatest(within) < 1e-4, "{kind:?}: {}", greatest(within));
        assert!(greatest(without) > 1e-2, "{kind:?}: outside {}", greatest(without));
    }
}

/// Returns true if a point lies on the inside of the box.
fn is_of_the_box(point: &SurfacePoint) -> bool {
    point.position.y > 0.1 && point.normal.dot(Vec3::new(0.0, 1.5, 0.0) - point.position) > 0.0
}

#[test]
fn a_scene_that_no_light_comes_to_is_black() {
    let mut loaded = procedural::build("furnace").unwrap();
    let emission = vec![Vec3::ZERO; loaded.scene.materials.len()];
    let darkness = Lighting { emission, ..Lighting::default() };
    loaded.scene.set_lighting(darkness).unwrap();
    let points = points(&loaded.scene, 20);
    for kind in KINDS {
        let (pictures, indirect) = render(&loaded, settings(kind), cpu(), &points);
        assert!(pictures.full.pixels.iter().chain(&indirect).all(|light| *light == Vec3::ZERO));
    }
}

/// Pixels may differ where a ray passes an edge, not elsewhere and not on the whole; points hardly.
fn check_same(a: &(Pictures, Vec<Vec3>), b: &(Pictures, Vec<Vec3>)) -> Result<(), String> {
    for (name, a, b) in [("full", &a.0.full, &b.0.full), ("indirect", &a.0.indirect, &b.0.indirect)] {
        let sum = |p: &reference::Picture| p.pixels.iter().map(|p| luminance(*p)).sum::<f32>();
        let level = 1e-5 * sum(a) / a.pixels.len() as f32;
        let differs = |(x, y): &(&Vec3, &Vec3)| (**x - **y).abs().max_element() > 1e-3 * x.max_element() + level;
        let count = a.pixels.iter().zip(&b.pixels).filter(differs).count();
        if count > a.pixels.len() / 100 || (sum(a) / sum(b) - 1.0).abs() > 1e-3 {
            return Err(format!("{name}: {count} of {} pixels differ, sums {} {}", a.pixels.len(), sum(a), sum(b)));
        }
    }
    for (k, (x, y)) in a.1.iter().zip(&b.1).enumerate() {
        if (*x - *y).abs().max_element() > 1e-4 * x.max_element() + 1e-6 {
            return Err(format!("point {k}: {x} {y}"));
        }
    }
    Ok(())
}

#[test]
fn both_executors_look_up_the_same_light() {
    let Some(vulkan) = vulkan() else { return };
    let loaded = procedural::build("atrium:3000").unwrap();
    let points = points(&loaded.scene, 200);
    let ours = render(&loaded, settings(PatchKind::Axis), cpu(), &points);
    let its = render(&loaded, settings(PatchKind::Axis), Box::new(vulkan), &points);
    check_same(&ours, &its).unwrap();
    assert!(ours.1.iter().any(|h| h.min_element() > 0.0));
    // Another seed gives another light, and so does a point less bright.
    let other = render(&loaded, Setup { seed: 4, ..settings(PatchKind::Axis) }, cpu(), &points);
    assert!(check_same(&ours, &other).is_err());
    let mut wrong = (ours.0.clone(), ours.1.clone());
    let brightest = (0..points.len()).max_by(|&a, &b| wrong.1[a].x.total_cmp(&wrong.1[b].x)).unwrap();
    wrong.1[brightest] *= 0.999;
    assert!(check_same(&wrong, &its).is_err());
}
