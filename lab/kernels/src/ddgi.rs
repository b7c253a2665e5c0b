//! Kernels of probes, an opponent that frames are compared with.

use ::ddgi::kernel::blend;
use ::ddgi::kernel::lookup::irradiance_at;
use ::ddgi::kernel::trace::{Met, ProbeTables, probe_ray};
use ::ddgi::{BlendParams, LookupPoint, PointParams, Probe, ProbeRay, RAY_WEIGHTS, TraceParams, WeightParams};
use ::scene::kernel::bvh;
use ::scene::{Hit, Rgb};
use glam::{Vec2, Vec3, Vec4};

gpu_kernels::kernels! {
    /// Weight of every ray in every texel of irradiance, then of visibility: [`blend::weight`]. One invocation per
    /// weight, those of a ray one after the other.
    DDGI_WEIGHTS: WeightsPass = "ddgi_weights"(p: WeightParams) for k in 0..count {
        directions: read [Vec4; p.rays as usize],
        weights: write [f32],
    } each {
        blend::weight(p, k % RAY_WEIGHTS, directions[(k / RAY_WEIGHTS) as usize].truncate())
    }

    /// Radiance along every ray of the probes: [`probe_ray`] of what [`bvh::closest_hit`] meets, with shadow rays by
    /// [`bvh::any_hit`]; nothing where the probe is off. One invocation per ray, those of a probe one after the other.
    DDGI_TRACE: TracePass = "ddgi_trace"(p: TraceParams) for k in 0..count {
        directions: read [Vec4; p.rays as usize],
        probes: read [Probe],
        probe_irradiance: read [Rgb],
        probe_visibility: read [Vec2],
        geometry: GeometryTables,
        lights: Lights,
        rays: write [ProbeRay],
    } each {
        let probe = probes[(k / p.rays) as usize];
        let direction = directions[(k % p.rays) as usize].truncate();
        let hit = match probe.is_active {
            0 => Hit::MISS,
            _ => bvh::closest_hit(&geometry, probe.position, direction, bvh::FAR),
        };
        let stopped = |origin: Vec3, direction: Vec3, t_max: f32| {
            bvh::any_hit(&geometry, origin, direction, t_max)
        };
        let tables = ProbeTables { probes, irradiance: probe_irradiance, visibility: probe_visibility };
        probe_ray(&geometry, p, &lights, tables, Met { index: k, direction, hit }, stopped)
    }

    /// Irradiance in every texel of all probes after a frame, as its root: [`blend::blend_irradiance`]. One invocation
    /// per texel.
    DDGI_BLEND_IRRADIANCE: BlendIrradiancePass = "ddgi_blend_irradiance"(p: BlendParams) for k in 0..count {
        probes: read [Probe],
        weights: read [f32],
        rays: read [ProbeRay],
        probe_irradiance: update [Rgb] as old,
    } each {
        blend::blend_irradiance(k, p, probes, weights, rays, old)
    }

    /// Mean distance and mean square in every texel of all probes after a frame: [`blend::blend_visibility`]. One
    /// invocation per texel.
    DDGI_BLEND_VISIBILITY: BlendVisibilityPass = "ddgi_blend_visibility"(p: BlendParams) for k in 0..count {
        probes: read [Probe],
        weights: read [f32],
        rays: read [ProbeRay],
        probe_visibility: update [Vec2] as old,
    } each {
        blend::blend_visibility(k, p, probes, weights, rays, old)
    }

    /// Indirect irradiance at every point, W/m²: [`irradiance_at`]. One invocation per point.
    DDGI_LOOKUP: LookupPass = "ddgi_lookup"(p: PointParams) for k in 0..count {
        points: read [LookupPoint; count],
        probes: read [Probe],
        probe_irradiance: read [Rgb],
        probe_visibility: read [Vec2],
        irradiance: write [Rgb],
    } each {
        irradiance_at(&p.lookup, &points[k as usize], probes, probe_irradiance, probe_visibility).extend(0.0)
    }
}
