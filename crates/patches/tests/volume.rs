//! The voxel volume: constants stay, linear fields too, walls keep rooms separate, and both outputs against closed
//! forms and integrals over hemispheres.

mod support;

use core::f32::consts::PI;

use glam::{Quat, Vec3, Vec4};
use patchlight_patches::{Error, PROBE_LIMIT, VolumeSettings, VolumeSize, VoxelVolume};
use rayon::prelude::*;
use scene::gpu::TriangleUv;
use scene::sampling::{cosine_hemisphere, hammersley, hash3, unit};
use scene::{Material, POINT_WALKS, ReceiverSet, Scene, SceneParts, SurfacePoint, Visibility, is_open};
use support::{Mesh, atrium, two_rooms};

fn settings(edge: f32) -> VolumeSettings {
    VolumeSettings { size: VolumeSize::Edge(edge), ..VolumeSettings::default() }
}

/// A point of the box with a unit normal, at random.
fn random(k: u32, low: Vec3, high: Vec3) -> SurfacePoint {
    let number = |d: u32| unit(hash3(k, d, 21));
    let position = low + (high - low) * Vec3::new(number(0), number(1), number(2));
    let normal = (Vec3::new(number(3), number(4), number(5)) - 0.5).normalize();
    SurfacePoint { position, normal, weight: 1.0, ..SurfacePoint::default() }
}

/// Both evaluations of the same ambient cubes.
fn both(volume: &VoxelVolume, cubes: &[Vec4], points: &[SurfacePoint]) -> [Vec<Vec4>; 2] {
    let harmonics = volume.harmonics(cubes).unwrap();
    [volume.at_points(cubes, points).unwrap(), volume.at_points_sh(&harmonics, points).unwrap()]
}

#[test]
fn a_constant_stays_constant_for_every_point_and_normal() {
    let scene = atrium().scene(1.0);
    let room = Vec3::splat(2.0);
    let points: Vec<SurfacePoint> =
        (0..10_000).map(|k| random(k, scene.geometry.bounds.0 - room, scene.geometry.bounds.1 + room)).collect();
    // All probes, and so few that most voxels have none.
    for share in [1.0, 0.05] {
        let is_kept = |p: &SurfacePoint| unit(hash3(p.position.x.to_bits(), p.position.z.to_bits(), 4)) < share;
        let volume = VoxelVolume::new(&scene, &settings(0.8), &is_kept).unwrap();
        let constant = Vec4::new(0.3, 7.0, 1e-3, 1.0);
        let mut cubes = vec![constant; volume.points().len()];
        let worst = |cubes: &[Vec4]| {
            let error = |v: &Vec4| ((*v - constant) / constant).abs().max_element();
            both(&volume, cubes, &points).map(|values| values.iter().map(error).fold(0.0, f32::max))
        };
        // Sums of at most eight weights, divided by their own sum.
        assert!(worst(&cubes).into_iter().all(|e| e < 1e-5), "{:?}", worst(&cubes));
        let wrong = cubes.len() / 3;
        cubes[wrong] *= 1.01;
        assert!(worst(&cubes).into_iter().all(|e| e > 1e-5));
    }
}

#[test]
fn a_linear_field_is_reproduced_inside() {
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::ZERO, Vec3::splat(8.0), true);
    let scene = mesh.scene(1.0);
    let volume = VoxelVolume::new(&scene, &settings(1.0), &|_| true).unwrap();
    let cubes: Vec<Vec4> = volume.points().iter().map(|p| p.position.extend(1.0)).collect();
    // Where no probe is nearer to a wall than to the point: next to walls the nearer probes count more.
    let points: Vec<SurfacePoint> = (0..2000).map(|k| random(k, Vec3::splat(2.0), Vec3::splat(6.0))).collect();
    let worst = |volume: &VoxelVolume| {
        both(volume, &cubes, &points).map(|values| {
            let error = |(p, v): (&SurfacePoint, &Vec4)| (v.truncate() - p.position).length();
            points.iter().zip(&values).map(error).fold(0.0, f32::max)
        })
    };
    assert!(worst(&volume).into_iter().all(|e| e < 1e-4), "{:?}", worst(&volume));
    let mut shifted = volume.clone();
    shifted.params.shape.origin.x += 0.01;
    assert!(worst(&shifted).into_iter().all(|e| e > 1e-3));
    // Up to the walls it is followed to 0.75 of a voxel.
    for k in 0..2000 {
        let p = random(k, Vec3::splat(0.03), Vec3::splat(7.97));
        let found = volume.at(&cubes, p.position, p.normal).unwrap().truncate();
        assert!((found - p.position).abs().max_element() < 0.75, "{p:?} {found}");
    }
}

/// Room of a place: true for the first of [`two_rooms`], false for the second, none outside of both.
fn room_of(place: Vec3) -> Option<bool> {
    let inside = place.cmpgt(Vec3::ZERO).all() && place.cmplt(Vec3::new(4.0, 2.0, 2.0)).all();
    inside.then_some(place.x < 2.0)
}

#[test]
fn a_dark_room_stays_dark_behind_a_wall_without_thickness() {
    for (edge, angle) in [(0.5, 0.0), (0.41, 0.0), (0.7, 0.0), (0.5, 0.3), (0.37, 0.7)] {
        let rotation = Quat::from_axis_angle(Vec3::new(0.3, 0.9, 0.2).normalize(), angle);
        let mut mesh = two_rooms();
        for t in &mut mesh.triangles {
            (t.corner, t.edge_a, t.edge_b) = (rotation * t.corner, rotation * t.edge_a, rotation * t.edge_b);
        }
        let scene = mesh.scene(1.0);
        let back = rotation.inverse();
        // The walls themselves, seen from inside, and places in the air with any normal.
        let mut points = Vec::new();
        let geometry = scene.tables();
        for triangle in 0..scene.geometry.triangles.len() as u32 {
            for k in 0..200 {
                let (u, v) = scene::sampling::uniform_triangle(hammersley(k, 200, (triangle, 7)));
                for normal in [geometry.normal(triangle), -geometry.normal(triangle)] {
                    let position = geometry.position(triangle, u, v);
                    points.push((
                        back * (position + normal * 1e-3),
                        SurfacePoint { position, normal, ..random(0, Vec3::ZERO, Vec3::ONE) },
                    ));
                }
            }
        }
        for k in 0..4000 {
            let p = random(k, Vec3::ZERO, Vec3::new(4.0, 2.0, 2.0));
            // Nearer to a wall a point that looks at it would look from behind it.
            let low = p.position.min(Vec3::new(4.0, 2.0, 2.0) - p.position).min_element();
            if low.min((p.position.x - 2.0).abs()) > 0.03 * edge {
                points.push((
                    p.position,
                    SurfacePoint { position: rotation * p.position, normal: rotation * p.normal, ..p },
                ));
            }
        }
        let leak = |walls: bool, dark: bool| {
            let volume = VoxelVolume::new(&scene, &VolumeSettings { walls, ..settings(edge) }, &|_| true).unwrap();
            let value = |p: &SurfacePoint| f32::from(u8::from(room_of(back * p.position) != Some(dark)));
            let cubes: Vec<Vec4> = volume.points().iter().map(|p| Vec4::splat(value(p))).collect();
            let inside = points.iter().filter(|(place, _)| room_of(*place) == Some(dark));
            let found: Vec<f32> = inside.map(|(_, p)| volume.at(&cubes, p.position, p.normal).unwrap().x).collect();
            let leaking = found.iter().filter(|v| **v > 1e-3).count();
            (found.iter().copied().fold(0.0, f32::max), leaking as f32 / found.len() as f32)
        };
        for dark in [true, false] {
            let ((kept, share), (open, open_share)) = (leak(true, dark), leak(false, dark));
            println!(
                "edge {edge} m, rotated by {angle}: greatest leak {kept:e}, above 0.001 at {share:.5} of the points; \
                 without walls {open}, {open_share:.3}"
            );
            // Walls across the grid: in a corner that no ray comes near to, a probe outside may be taken for one
            // inside.
            assert!(if angle == 0.0 { kept < 1e-3 } else { share < 0.003 }, "{kept} {share}");
            assert!(open > 0.3 && open_share > 0.1, "{open} {open_share}");
        }
    }
}

/// A mesh whose fronts shine.
fn shining(mesh: Mesh) -> Scene {
    let uvs = vec![TriangleUv::default(); mesh.triangles.len()];
    let materials = vec![Material { radiance: Vec3::ONE, ..Material::default() }];
    Scene::new(SceneParts { triangles: mesh.triangles, uvs, materials, ..SceneParts::default() }).unwrap()
}

/// Irradiance at points by cosine-weighted rays, of what their hits send: `radiance(place, front)`.
fn irradiance(
    scene: &Scene,
    points: &[SurfacePoint],
    rays: u32,
    radiance: impl Fn(Vec3, bool) -> f32 + Sync,
) -> Vec<f32> {
    let seed = |p: &SurfacePoint| hash3(p.position.x.to_bits(), p.position.y.to_bits(), p.normal.x.to_bits());
    let one = |p: &SurfacePoint| {
        let sum: f32 = (0..rays)
            .map(|k| {
                let way = cosine_hemisphere(p.normal, hammersley(k, rays, (seed(p), hash3(seed(p), 1, 1))));
                let from = p.position + p.normal * scene.geometry.ray_offset;
                let hit = scene.closest(from, way);
                if hit.is_miss() {
                    return 0.0;
                }
                radiance(from + way * hit.t, scene.tables().normal(hit.triangle).dot(way) < 0.0)
            })
            .sum();
        PI * sum / rays as f32
    };
    points.par_iter().map(one).collect()
}

#[test]
fn in_a_white_furnace_all_cubes_are_pi_times_the_radiance() {
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::ZERO, Vec3::new(3.0, 2.0, 2.5), true);
    mesh.cuboid(Vec3::new(0.9, 0.4, 0.8), Vec3::new(2.1, 1.5, 1.9), false);
    let scene = shining(mesh);
    let cubes = |volume: &VoxelVolume| irradiance(&scene, volume.points(), 64, |_, front| f32::from(u8::from(front)));
    let worst = |cubes: &[f32]| cubes.iter().map(|e| (e - PI).abs()).fold(0.0, f32::max);
    let is_lit = |p: &SurfacePoint| {
        is_open(&scene, p, POINT_WALKS, hash3(p.position.x.to_bits(), p.position.y.to_bits(), p.patch))
    };
    let volume = VoxelVolume::new(&scene, &settings(0.25), &is_lit).unwrap();
    assert!(volume.points().iter().all(|p| {
        let place = p.position;
        !(place.cmpgt(Vec3::new(0.9, 0.4, 0.8)).all() && place.cmplt(Vec3::new(2.1, 1.5, 1.9)).all())
    }));
    let values = cubes(&volume);
    assert!(worst(&values) < 1e-4, "{}", worst(&values));
    let values: Vec<Vec4> = values.into_iter().map(Vec4::splat).collect();
    let points: Vec<SurfacePoint> = (0..1000).map(|k| random(k, Vec3::ZERO, Vec3::new(3.0, 2.0, 2.5))).collect();
    for found in both(&volume, &values, &points) {
        assert!(found.iter().all(|v| (v.x - PI).abs() < 1e-3));
    }
    // The probes inside of the block see its dark inner sides.
    let all = VoxelVolume::new(&scene, &settings(0.25), &|_| true).unwrap();
    assert!(all.len() > volume.len() && worst(&cubes(&all)) > 1.0);
}

#[test]
fn harmonics_of_a_linear_radiance_are_those_of_the_closed_form() {
    // L(ω) = a + b·ω: E(n) = π a + (2π/3) b·n, L_00 = a √(4π), L_1 = b √(4π/3).
    let scene = two_rooms().scene(1.0);
    let volume = VoxelVolume::new(&scene, &settings(0.5), &|_| true).unwrap();
    let a = 2.0;
    let b = Vec3::new(0.5, -0.7, 0.9);
    let closed = |n: Vec3| PI * a + 2.0 * PI / 3.0 * b.dot(n);
    let cubes: Vec<Vec4> = volume.points().iter().map(|p| Vec4::splat(closed(p.normal))).collect();
    let harmonics = volume.harmonics(&cubes).unwrap();
    let expected = [a * (4.0 * PI).sqrt(), b.x, b.y, b.z];
    for (k, found) in harmonics.iter().enumerate() {
        let scale = if k % 4 == 0 { 1.0 } else { (4.0 * PI / 3.0).sqrt() };
        assert!((found.x - expected[k % 4] * scale).abs() < 1e-5, "{k}: {found}");
    }
    let points: Vec<SurfacePoint> =
        (0..1000).map(|k| random(k, scene.geometry.bounds.0, scene.geometry.bounds.1)).collect();
    let worst = |harmonics: &[Vec4]| {
        let found = volume.at_points_sh(harmonics, &points).unwrap();
        points.iter().zip(found).map(|(p, v)| (v.x - closed(p.normal)).abs()).fold(0.0, f32::max)
    };
    assert!(worst(&harmonics) < 1e-4, "{}", worst(&harmonics));
    // Another order of the coefficients.
    let swapped: Vec<Vec4> = harmonics.chunks(4).flat_map(|c| [c[0], c[2], c[1], c[3]]).collect();
    assert!(worst(&swapped) > 0.1);
    // Irradiance is never negative.
    let dark: Vec<Vec4> = harmonics.iter().enumerate().map(|(k, h)| if k % 4 == 0 { Vec4::ZERO } else { *h }).collect();
    assert!(volume.at_points_sh(&dark, &points).unwrap().iter().all(|v| v.x >= 0.0));
}

#[test]
fn both_outputs_are_near_integrals_over_the_hemisphere() {
    // A hall with a pool of light on its floor, as the sun makes it, and walls of a tenth of that.
    let scene = atrium().scene(1.0);
    let radiance = |place: Vec3, _: bool| {
        if place.y < 0.05 && (4.0..7.0).contains(&place.x) { 10.0 } else { 1.0 + 0.1 * place.x }
    };
    let is_free = |p: &SurfacePoint| p.position.y < 2.8 && (1.9..4.1).contains(&p.position.z);
    let volume = VoxelVolume::new(&scene, &settings(0.5), &is_free).unwrap();
    let cubes: Vec<Vec4> = irradiance(&scene, volume.points(), 1024, radiance).into_iter().map(Vec4::splat).collect();
    let points: Vec<SurfacePoint> = (0..600)
        .map(|k| random(k, Vec3::new(1.0, 0.4, 2.2), Vec3::new(11.0, 2.4, 3.8)))
        .filter(|p| {
            p.position.distance(Vec3::new(6.1, 1.02, 3.03)) > 1.0 && p.position.distance(Vec3::new(3.3, 0.4, 2.9)) > 0.5
        })
        .collect();
    let exact = irradiance(&scene, &points, 4096, radiance);
    let mean = exact.iter().sum::<f32>() / exact.len() as f32;
    let errors = |cubes: &[Vec4]| {
        both(&volume, cubes, &points).map(|found| {
            let mut errors: Vec<f32> = found.iter().zip(&exact).map(|(f, e)| (f.x - e).abs() / mean).collect();
            errors.sort_by(f32::total_cmp);
            (errors[errors.len() / 2], errors[errors.len() * 95 / 100])
        })
    };
    let [(cube, cube_95), (sh, sh_95)] = errors(&cubes);
    println!("of the mean irradiance: cubes {cube:.3} / {cube_95:.3}, harmonics {sh:.3} / {sh_95:.3} (median / 95 %)");
    // Neither knows degree 2 of the cosine lobe in all directions: up to a third of the light from one side.
    assert!(cube < 0.08 && cube_95 < 0.35, "{cube} {cube_95}");
    assert!(sh < 0.1 && sh_95 < 0.3, "{sh} {sh_95}");
    let mut turned = cubes.clone();
    turned.chunks_mut(2).for_each(|pair| pair.swap(0, 1));
    assert!(errors(&turned).iter().all(|(median, _)| *median > 0.15), "{:?}", errors(&turned));
}

#[test]
fn probes_that_touch_a_surface_are_left_out() {
    // The wall at x = 2 stands in the middle of the voxels from 1.75 to 2.25.
    let mut mesh = Mesh::default();
    mesh.cuboid(Vec3::ZERO, Vec3::new(4.5, 2.0, 2.0), true);
    mesh.quad(Vec3::new(2.25, 0.0, 0.0), Vec3::Y * 2.0, Vec3::Z * 2.0);
    let scene = mesh.scene(1.0);
    let volume = VoxelVolume::new(&scene, &settings(0.5), &|_| true).unwrap();
    assert_eq!(volume.params.shape.counts().to_array(), [9, 4, 4]);
    assert_eq!(volume.len(), 8 * 4 * 4);
    assert!(volume.points().iter().all(|p| (p.position.x - 2.25).abs() > 0.4));
    assert_eq!(volume.offsets().len(), volume.points().len() + 1);
}

#[test]
fn sizes_and_bytes_are_as_asked_for() {
    let scene = atrium().scene(1.0);
    for count in [1, 10, 1000, 20_000] {
        let size = VolumeSize::Count(count);
        let volume =
            VoxelVolume::new(&scene, &VolumeSettings { size, ..VolumeSettings::default() }, &|_| true).unwrap();
        let voxels = volume.probes.len();
        assert!(voxels <= count as usize && voxels * 2 > count as usize, "{voxels} for {count}");
    }
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let make = || {
        VoxelVolume::new(&scene, &settings(0.6), &|p| is_open(&scene, p, POINT_WALKS, 1) || p.position.y > 1.0).unwrap()
    };
    assert!(pool(1).install(make) == pool(2).install(make));
}

#[test]
fn wrong_input_is_refused() {
    let scene = two_rooms().scene(1.0);
    let new = |size| VoxelVolume::new(&scene, &VolumeSettings { size, walls: true }, &|_| true);
    for edge in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(matches!(new(VolumeSize::Edge(edge)), Err(Error::Setting { .. })), "{edge}");
    }
    assert!(matches!(new(VolumeSize::Count(0)), Err(Error::Setting { .. })));
    assert!(matches!(new(VolumeSize::Edge(0.01)), Err(Error::TooMany { limit: PROBE_LIMIT, .. })));
    assert!(matches!(VoxelVolume::new(&scene, &settings(0.5), &|_| false), Err(Error::NoProbes)));
    let volume = new(VolumeSize::Edge(0.5)).unwrap();
    let few = vec![Vec4::ONE; volume.points().len() - 1];
    assert!(matches!(volume.at(&few, Vec3::ONE, Vec3::Y), Err(Error::Length { name: "cubes", .. })));
    assert!(matches!(volume.harmonics(&few), Err(Error::Length { .. })));
    assert!(matches!(volume.at_points_sh(&few, &[]), Err(Error::Length { name: "harmonics", .. })));
}
