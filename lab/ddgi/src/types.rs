//! The plain data that CPU and GPU share, field for field.

use bytemuck::{Pod, Zeroable};
use glam::{UVec3, Vec3, Vec4};
use scene::gpu::DirectParams;

/// Texels along the edge of a probe's irradiance, and of its visibility, without borders.
pub const IRRADIANCE_EDGE: u32 = 8;
/// See [`IRRADIANCE_EDGE`].
pub const VISIBILITY_EDGE: u32 = 16;
/// Texels of a probe with their borders: irradiance, and visibility.
pub const IRRADIANCE_TEXELS: u32 = (IRRADIANCE_EDGE + 2) * (IRRADIANCE_EDGE + 2);
/// See [`IRRADIANCE_TEXELS`].
pub const VISIBILITY_TEXELS: u32 = (VISIBILITY_EDGE + 2) * (VISIBILITY_EDGE + 2);
/// Weights of a ray: in each texel of irradiance, then of visibility, without borders.
pub const RAY_WEIGHTS: u32 = IRRADIANCE_EDGE * IRRADIANCE_EDGE + VISIBILITY_EDGE * VISIBILITY_EDGE;

/// A probe that is where it shall be.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Probe {
    /// m.
    pub position: Vec3,
    /// 1 where it is on, else 0.
    pub is_active: u32,
}
const _: () = assert!(size_of::<Probe>() == 16);

/// Result of a ray from a probe.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ProbeRay {
    /// W/m²/sr.
    pub radiance: Vec3,
    /// m; negative where the ray met the back of a surface, of which no radiance counts.
    pub distance: f32,
}
const _: () = assert!(size_of::<ProbeRay>() == 16);

/// A point whose irradiance is asked for; last components are unused.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct LookupPoint {
    /// m.
    pub position: Vec4,
    /// Unit normal of the side that is lit.
    pub normal: Vec4,
    /// Unit direction to the eye.
    pub to_eye: Vec4,
}
const _: () = assert!(size_of::<LookupPoint>() == 48);

/// Settings of probe lookups.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct LookupParams {
    /// Probes along the axes.
    pub counts: UVec3,
    /// Irradiance is stored as its root of this degree.
    pub encoding: u32,
    /// The first probe of the grid, before probes are moved, m.
    pub first: Vec3,
    /// Length of the self-shadow bias, m.
    pub bias: f32,
    /// Distance between probes along the axes, m.
    pub spacing: Vec3,
    /// 1 for Chebyshev weights, else 0.
    pub visibility: u32,
}
const _: () = assert!(size_of::<LookupParams>() == 48);

/// Settings of the kernel that traces the rays of probes.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct TraceParams {
    /// Rays of all probes.
    pub count: u32,
    /// Rays of a probe.
    pub rays: u32,
    /// 1 where backs of surfaces are lit and no inside, else 0.
    pub two_sided: u32,
    /// Unused.
    pub reserved: u32,
    /// Lookup settings for the light of the frame before.
    pub lookup: LookupParams,
    /// Settings of direct light where rays end.
    pub direct: DirectParams,
}
const _: () = assert!(size_of::<TraceParams>() == 96);

/// Settings of the kernel of the weights of rays.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct WeightParams {
    /// [`RAY_WEIGHTS`] for each ray.
    pub count: u32,
    /// Rays of a probe.
    pub rays: u32,
    /// Power of the cosine that weights distances.
    pub exponent: u32,
}
const _: () = assert!(size_of::<WeightParams>() == 12);

/// Settings of the kernels that blend rays into probes.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct BlendParams {
    /// Texels of all probes, with borders.
    pub count: u32,
    /// Rays of a probe.
    pub rays: u32,
    /// Share of the old that is left.
    pub hysteresis: f32,
    /// Irradiance is stored as its root of this degree.
    pub encoding: u32,
    /// Distances count up to this, m.
    pub most: f32,
}
const _: () = assert!(size_of::<BlendParams>() == 20);

/// Settings of the kernel that looks up points.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PointParams {
    /// The points.
    pub count: u32,
    /// Unused.
    pub reserved: [u32; 3],
    /// Settings of the lookup.
    pub lookup: LookupParams,
}
const _: () = assert!(size_of::<PointParams>() == 64);
