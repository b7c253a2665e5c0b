//! Inputs of the kernels of probes: some off, some rays that meet backs or nothing, texels that change little and much.

use ::ddgi::{
    BlendParams, IRRADIANCE_TEXELS, LookupParams, LookupPoint, PointParams, Probe, ProbeRay, RAY_WEIGHTS, TraceParams,
    VISIBILITY_TEXELS, WeightParams,
};
use glam::{UVec3, Vec2, Vec3, Vec4};
use scene::Scene;
use scene::gpu::DirectParams;
use scene::kernel::bvh::FAR;

use super::{Random, Tables, buffer, call, points_in_space, room};

/// Probes along the axes of the unit cube, and all of them.
const COUNTS: UVec3 = UVec3::new(4, 3, 2);
const PROBES: u32 = 4 * 3 * 2;
/// Rays of a probe.
const RAYS: u32 = 9;

/// Elements, push constants and tables of a kernel.
pub(super) fn own_tables(r: &mut Random, name: &str, scene: &Scene) -> (u32, Vec<u8>, Tables) {
    let mut tables = probes(r);
    let lookup = LookupParams {
        counts: COUNTS,
        encoding: 5,
        first: Vec3::new(0.1, 0.2, 0.3),
        bias: 0.02,
        spacing: Vec3::new(0.25, 0.3, 0.5),
        visibility: 1,
    };
    let blend =
        |texels: u32| BlendParams { count: PROBES * texels, rays: RAYS, hysteresis: 0.9, encoding: 5, most: 0.8 };
    match name {
        "ddgi_weights" => {
            let p = WeightParams { count: RAY_WEIGHTS * RAYS, rays: RAYS, exponent: 50 };
            call(p.count, p, vec![directions(r), room::<f32>("weights", p.count as usize)])
        }
        "ddgi_trace" => {
            let p = TraceParams {
                count: PROBES * RAYS,
                rays: RAYS,
                two_sided: 0,
                reserved: 0,
                lookup,
                direct: direct(scene),
            };
            tables.extend([directions(r), room::<ProbeRay>("rays", p.count as usize)]);
            call(p.count, p, tables)
        }
        "ddgi_blend_irradiance" | "ddgi_blend_visibility" => {
            let p = blend(if name == "ddgi_blend_irradiance" { IRRADIANCE_TEXELS } else { VISIBILITY_TEXELS });
            // A third of the rays has no weight in a texel.
            let weights: Vec<f32> =
                (0..RAY_WEIGHTS * RAYS).map(|_| if r.below(3) == 0 { 0.0 } else { r.unit() }).collect();
            let rays: Vec<ProbeRay> = (0..PROBES * RAYS).map(|_| ray(r)).collect();
            tables.extend([buffer("weights", &weights), buffer("rays", &rays)]);
            call(p.count, p, tables)
        }
        "ddgi_lookup" => {
            let count = 300;
            let point = |r: &mut Random| {
                let place = points_in_space(r, 1)[0];
                LookupPoint {
                    position: place.position.extend(0.0),
                    normal: place.normal.extend(0.0),
                    to_eye: r.direction().extend(0.0),
                }
            };
            let points: Vec<LookupPoint> = (0..count).map(|_| point(r)).collect();
            tables.extend([buffer("points", &points), room::<Vec4>("irradiance", count)]);
            call(count as u32, PointParams { count: count as u32, reserved: [0; 3], lookup }, tables)
        }
        other => panic!("the kernel {other} has no input here: add one"),
    }
}

/// Probes with their light: one in five is off.
fn probes(r: &mut Random) -> Tables {
    let mut probe = |k: u32| Probe { position: r.vector(), is_active: u32::from(k % 5 != 3) };
    let probes: Vec<Probe> = (0..PROBES).map(&mut probe).collect();
    let moments = |r: &mut Random| {
        let mean = r.unit();
        Vec2::new(mean, mean * mean + 0.1 * r.unit())
    };
    let visibility: Vec<Vec2> = (0..PROBES * VISIBILITY_TEXELS).map(|_| moments(r)).collect();
    vec![
        buffer("probes", &probes),
        buffer("probe_irradiance", &r.colors((PROBES * IRRADIANCE_TEXELS) as usize)),
        buffer("probe_visibility", &visibility),
    ]
}

fn directions(r: &mut Random) -> (&'static str, super::Data) {
    let directions: Vec<Vec4> = (0..RAYS).map(|_| r.direction().extend(0.0)).collect();
    buffer("directions", &directions)
}

fn ray(r: &mut Random) -> ProbeRay {
    match r.below(6) {
        0 => ProbeRay { radiance: Vec3::ZERO, distance: FAR },
        1 => ProbeRay { radiance: Vec3::ZERO, distance: -0.2 * r.unit() },
        _ => ProbeRay { radiance: r.vector(), distance: r.unit() },
    }
}

fn direct(scene: &Scene) -> DirectParams {
    DirectParams {
        light_count: scene.lighting.lights.len() as u32,
        emitter_count: scene.emitters.len() as u32,
        area_rays: 2,
        sky_rays: 1,
        seed: 3,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    }
}
