//! Rays a second of [`Scene`] against obvhs' own traversals, one thread, for the rays of path-traced pictures of Sponza
//! (of the built-in atrium without the shared scenes). The last table is measured in rounds, so that a busy machine
//! slows all alike.

// obvhs speaks Vec3A.
#![allow(clippy::disallowed_types, missing_docs)]

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{BatchSize, Criterion, Throughput};
use glam::Vec3;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::RayHit;
use obvhs::rt_triangle::RtTriangle;
use scene::kernel::bvh::FAR;
use scene::kernel::camera::{camera_direction, surface_point};
use scene::sampling::{cosine_hemisphere, hash3, unit};
use scene::{Camera, Scene};

/// Rays of each kind.
const COUNT: usize = 1 << 18;
const SEED: u32 = 0x7261_7973;
const SPONZA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/scenes/sponza/sponza.toml");

#[derive(Clone, Copy)]
struct Ray {
    origin: Vec3,
    direction: Vec3,
}

/// Camera rays of random pixels and four cosine-weighted bounces; a shadow ray at every vertex, towards the first light
/// or up.
fn record(scene: &Scene, camera: &Camera) -> (Vec<Ray>, Vec<Ray>) {
    let mut closest = Vec::with_capacity(COUNT);
    let mut shadow = Vec::with_capacity(COUNT);
    let sun = scene.lighting.lights.first().map_or(Vec3::Y, |l| -l.direction);
    let mut path = 0;
    while closest.len() < COUNT || shadow.len() < COUNT {
        let random = |k: u32| unit(hash3(path, k, SEED));
        let x = random(0) * camera.width as f32;
        let y = random(1) * camera.height as f32;
        let mut ray = Ray { origin: camera.eye, direction: camera_direction(camera, x, y).normalize() };
        for bounce in 1..=5 {
            closest.push(ray);
            let hit = scene.closest_before(ray.origin, ray.direction, FAR);
            if hit.is_miss() {
                break;
            }
            let point = surface_point(&scene.tables(), hit, ray.direction);
            ray.origin = point.position + point.normal * scene.geometry.ray_offset;
            if point.normal.dot(sun) > 0.0 {
                shadow.push(Ray { origin: ray.origin, direction: sun });
            }
            ray.direction = cosine_hemisphere(point.normal, (random(2 * bounce), random(2 * bounce + 1)));
        }
        path += 1;
    }
    closest.truncate(COUNT);
    shadow.truncate(COUNT);
    (closest, shadow)
}

/// The triangles of a scene in obvhs' hierarchies, each with triangles in the order of its leaves.
struct Obvhs {
    wide: CwBvh,
    wide_triangles: Vec<RtTriangle>,
    binary: Bvh2,
    binary_triangles: Vec<RtTriangle>,
}

impl Obvhs {
    fn new(scene: &Scene) -> Self {
        let boxes: Vec<_> = scene
            .geometry
            .triangles
            .iter()
            .map(|t| obvhs::triangle::Triangle {
                v0: t.corner.into(),
                v1: (t.corner + t.edge_a).into(),
                v2: (t.corner + t.edge_b).into(),
            })
            .collect();
        let settings = BvhBuildParams { pre_split: false, ..BvhBuildParams::medium_build() };
        let wide = build_cwbvh_from_tris(&boxes, settings, &mut Duration::default());
        let binary = build_bvh2_from_tris(&boxes, settings, &mut Duration::default());
        let ordered = |order: &[u32]| order.iter().map(|&k| RtTriangle::from(&boxes[k as usize])).collect();
        let wide_triangles = ordered(&wide.primitive_indices);
        let binary_triangles = ordered(&binary.primitive_indices);
        Self { wide, wide_triangles, binary, binary_triangles }
    }

    fn ray(ray: &Ray) -> obvhs::ray::Ray {
        obvhs::ray::Ray::new(ray.origin.into(), ray.direction.into(), 0.0, FAR)
    }

    fn wide_closest(&self, ray: &Ray) -> f32 {
        let mut hit = RayHit::none();
        self.wide.ray_traverse(Self::ray(ray), &mut hit, |r, k| self.wide_triangles[k].intersect(r));
        hit.t
    }

    fn wide_occluded(&self, ray: &Ray) -> bool {
        !self.wide.ray_traverse_miss(Self::ray(ray), |r, k| self.wide_triangles[k].intersect(r))
    }

    fn binary_closest(&self, ray: &Ray) -> f32 {
        let mut hit = RayHit::none();
        self.binary.ray_traverse(Self::ray(ray), &mut hit, |r, k| self.binary_triangles[k].intersect(r));
        hit.t
    }

    fn binary_occluded(&self, ray: &Ray) -> bool {
        !self.binary.ray_traverse_miss(Self::ray(ray), |r, k| self.binary_triangles[k].intersect(r))
    }
}

type AllRays<'a> = Box<dyn Fn(&[Ray]) + 'a>;
type Cast<'a> = (&'static str, AllRays<'a>);

/// Casts all rays with one function; generic, so that the function is inlined into the loop.
fn cast<'a, T>(one: impl Fn(&Ray) -> T + 'a) -> AllRays<'a> {
    Box::new(move |rays| {
        for ray in rays {
            black_box(one(ray));
        }
    })
}

/// Best of several alternating rounds, million rays a second.
fn rates(casts: &[Cast], rays: &[Ray]) -> Vec<f64> {
    let mut best = vec![f64::INFINITY; casts.len()];
    for _ in 0..5 {
        for ((_, cast), best) in casts.iter().zip(&mut best) {
            let start = Instant::now();
            cast(rays);
            *best = best.min(start.elapsed().as_secs_f64());
        }
    }
    best.iter().map(|seconds| rays.len() as f64 / seconds * 1e-6).collect()
}

fn main() {
    let spec = if std::path::Path::new(SPONZA).exists() { SPONZA } else { "atrium" };
    let loaded = match assets::import::load_or_build(spec) {
        Ok(loaded) => loaded,
        Err(error) => {
            eprintln!("{error}");
            std::process::exit(1);
        }
    };
    let scene = &loaded.scene;
    let (closest, shadow) = record(scene, &loaded.view.camera(960, 540));
    let other = Obvhs::new(scene);

    let closest_casts: [Cast; 3] = [
        ("scene", cast(|r| scene.closest_before(r.origin, r.direction, FAR))),
        ("obvhs-cwbvh", cast(|r| other.wide_closest(r))),
        ("obvhs-bvh2", cast(|r| other.binary_closest(r))),
    ];
    let shadow_casts: [Cast; 3] = [
        ("scene", cast(|r| scene.occluded(r.origin, r.direction, FAR))),
        ("obvhs-cwbvh", cast(|r| other.wide_occluded(r))),
        ("obvhs-bvh2", cast(|r| other.binary_occluded(r))),
    ];
    let kinds = [("closest", &closest, &closest_casts), ("occluded", &shadow, &shadow_casts)];

    let mut criterion = Criterion::default().configure_from_args().sample_size(10);
    for (kind, rays, casts) in kinds {
        let mut group = criterion.benchmark_group(format!("rays/{kind}"));
        group.throughput(Throughput::Elements(COUNT as u64));
        for (name, cast) in casts {
            group.bench_function(*name, |b| b.iter_batched(|| rays, |rays| cast(rays), BatchSize::PerIteration));
        }
        group.finish();
    }
    criterion.final_summary();

    println!(
        "{}: {} triangles, {COUNT} rays of each kind, one thread, best of 5, million rays a second",
        loaded.name,
        scene.geometry.triangles.len()
    );
    println!("| rays | scene | obvhs CWBVH | obvhs BVH2 | scene / better of obvhs |\n| --- | --- | --- | --- | --- |");
    for (kind, rays, casts) in kinds {
        let r = rates(casts, rays);
        println!("| {kind} | {:.2} | {:.2} | {:.2} | {:.0} % |", r[0], r[1], r[2], 100.0 * r[0] / r[1].max(r[2]));
    }
}
