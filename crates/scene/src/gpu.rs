//! The plain data that CPU and GPU share, field for field. Lengths are metres, light is radiometric linear Rec.709 RGB.

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3, Vec4};

use crate::units::{Intensity, Irradiance, Radiance, SurfaceLight};

/// "No texture", "no hit", "no patch": the index that stands for nothing.
pub const NONE: u32 = u32::MAX;

/// A triangle as rays see it: one corner and two edges, in the order of the hierarchy's leaves. Front = the side from
/// which the corners run counter-clockwise.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Triangle {
    /// First corner, m.
    pub corner: Vec3,
    /// Index into the materials.
    pub material: u32,
    /// Second corner − first corner, m.
    pub edge_a: Vec3,
    /// Position of this triangle in the file it came from (for messages), counted over all objects.
    pub source: u32,
    /// Third corner − first corner, m.
    pub edge_b: Vec3,
    /// Index of the object (OBJ group, glTF mesh) it came from, for messages.
    pub object: u32,
}
const _: () = assert!(size_of::<Triangle>() == 48);

/// Texture coordinates and normals of a triangle's three corners; v = 0 is the bottom row of the picture (OBJ
/// convention).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct TriangleUv {
    /// At the first corner.
    pub corner: Vec2,
    /// At the second corner.
    pub corner_a: Vec2,
    /// At the third corner.
    pub corner_b: Vec2,
    /// Normal at the first corner, packed ([`crate::kernel::normal::pack`]); 0 in all three for a flat triangle.
    pub normal: u32,
    /// At the second corner.
    pub normal_a: u32,
    /// At the third corner.
    pub normal_b: u32,
    /// Keeps the size a multiple of 8.
    pub reserved: u32,
}
const _: () = assert!(size_of::<TriangleUv>() == 40);

/// Node of the binary hierarchy, the same bytes as obvhs' small node. `prim_count == 0`: an inner node with the
/// children `first_index` and `first_index + 1`; otherwise a leaf with the triangles `first_index .. first_index +
/// prim_count`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct BvhNode {
    /// Least corner of the box, m.
    pub min: Vec3,
    /// Triangles in this leaf, 0 for an inner node.
    pub prim_count: u32,
    /// Greatest corner of the box, m.
    pub max: Vec3,
    /// First child or first triangle.
    pub first_index: u32,
}
const _: () = assert!(size_of::<BvhNode>() == 32);

/// A two-sided surface, that may shine from its front face: a mixture of Lambert reflection, a mirror, and the smooth
/// boundary of a clear dielectric, which mirrors and refracts as Fresnel and Snell say ([`crate::kernel::specular`]).
/// In each channel the three shares are 1 at most together; what is left is absorbed.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Material {
    /// Diffuse reflectance ρ in [0, 0.95]; used where there is no albedo texture.
    pub albedo: Vec3,
    /// Texture that replaces `albedo`, or [`NONE`].
    pub albedo_texture: u32,
    /// Emitted radiance Le, W/m²/sr, from the front face.
    pub radiance: Vec3,
    /// Texture that `radiance` is multiplied by, or [`NONE`].
    pub radiance_texture: u32,
    /// Share of the light that is mirrored, the same at every angle.
    pub mirror: Vec3,
    /// Texture whose alpha decides what is a hole, or [`NONE`].
    pub mask_texture: u32,
    /// Share of the light that meets a clear dielectric: of it Fresnel's reflectance is mirrored, the rest goes
    /// through.
    pub transmittance: Vec3,
    /// Alpha below this is a hole.
    pub mask_cutoff: f32,
    /// Index of refraction of the dielectric behind the back, over that of what lies before the front.
    pub index_of_refraction: f32,
    /// 1 where the surface is a whole pane, both faces of which it stands for: light goes straight through.
    pub is_pane: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 2],
}
const _: () = assert!(size_of::<Material>() == 80);

impl Material {
    /// A surface that reflects light evenly in all directions: the share of each channel, linear Rec.709 RGB, 0 to
    /// 0.95.
    pub fn diffuse(albedo: Vec3) -> Self {
        Self { albedo, ..Self::default() }
    }

    /// Copy that shines from its front face.
    #[must_use]
    pub fn with_emission(self, radiance: Radiance) -> Self {
        Self { radiance: radiance.0, ..self }
    }

    /// Returns true if the surface mirrors light or lets it through.
    #[inline]
    pub fn is_specular(&self) -> bool {
        self.mirror != Vec3::ZERO || self.transmittance != Vec3::ZERO
    }
}

impl Default for Material {
    fn default() -> Self {
        Self {
            albedo: Vec3::splat(0.5),
            albedo_texture: NONE,
            radiance: Vec3::ZERO,
            radiance_texture: NONE,
            mirror: Vec3::ZERO,
            mask_texture: NONE,
            transmittance: Vec3::ZERO,
            mask_cutoff: 0.5,
            index_of_refraction: 1.5,
            is_pane: 0,
            reserved: [0; 2],
        }
    }
}

/// What pictures show of a surface beside its [`Material`], as glTF 2.0 has it: a normal map, and a rough specular lobe
/// over a part of the albedo ([`crate::kernel::lobe`]). Light between surfaces knows nothing of either.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Finish {
    /// Texture of normals in the frame of the texture coordinates, or [`NONE`].
    pub normal_texture: u32,
    /// Multiplies the slope of its normals.
    pub normal_scale: f32,
    /// Texture whose green multiplies `roughness` and whose blue multiplies `metallic`, or [`NONE`].
    pub surface_texture: u32,
    /// Roughness of the lobe, 0 to 1; its width α is the square of it.
    pub roughness: f32,
    /// Share of the surface that is metal: it reflects its albedo in the lobe, and nothing diffusely.
    pub metallic: f32,
    /// 1 where there is a lobe.
    pub has_lobe: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 2],
}
const _: () = assert!(size_of::<Finish>() == 32);

impl Default for Finish {
    /// Diffuse and even.
    fn default() -> Self {
        Self {
            normal_texture: NONE,
            normal_scale: 1.0,
            surface_texture: NONE,
            roughness: 1.0,
            metallic: 0.0,
            has_lobe: 0,
            reserved: [0; 2],
        }
    }
}

/// The specular lobe of what a pixel shows; none where `alpha` is 0.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Lobe {
    /// Reflectance of light that falls along the normal of the microfacets.
    pub facing: Vec3,
    /// Width of the distribution of microfacets, α of GGX.
    pub alpha: f32,
    /// Reflectance of light that grazes them.
    pub grazing: Vec3,
    /// Share of the albedo that stays diffuse.
    pub matte: f32,
    /// Unit direction from the surface to where it is seen from.
    pub to_eye: Vec3,
    /// Keeps the size a multiple of 16.
    pub reserved_b: u32,
    /// Normal of the normal map less that of the surface.
    pub bend: Vec3,
    /// Keeps the size a multiple of 16.
    pub reserved_c: u32,
}
const _: () = assert!(size_of::<Lobe>() == 64);

/// A picture with its mip pyramid in the texel buffer. Level k is `max(1, width >> k)` by `max(1, height >> k)`, levels
/// follow each other, row 0 is the top. A texel is two words: linear r, g and b, a as 16-bit unsigned fractions.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Texture {
    /// Position of level 0 in the texel buffer, in texels (pairs of words).
    pub offset: u32,
    /// Width of level 0.
    pub width: u32,
    /// Height of level 0.
    pub height: u32,
    /// Number of levels.
    pub levels: u32,
}
const _: () = assert!(size_of::<Texture>() == 16);

/// Tone curve: what is brighter than white is cut off.
pub const TONE_NONE: u32 = 0;
/// Tone curve: AgX, [`crate::kernel::tone::agx`].
pub const TONE_AGX: u32 = 1;
/// Tone curve: Khronos PBR Neutral, [`crate::kernel::tone::neutral`].
pub const TONE_NEUTRAL: u32 = 2;

/// Lumens of a watt of equal-energy white: the luminous efficacy by which radiometric and photometric quantities are
/// converted, `Φ_v = 179 lm/W · luminance(Φ_e)` (Ward 1994).
pub const LUMENS_PER_WATT: f32 = 179.0;

/// [`Light::kind`]: parallel light; `direction` is that of travel, `color` the irradiance on a surface that faces it,
/// W/m².
pub const LIGHT_DIRECTIONAL: u32 = 0;
/// [`Light::kind`]: `color` is the intensity, W/sr.
pub const LIGHT_POINT: u32 = 1;
/// [`Light::kind`]: a point light that fades smoothly from `cos_inner` to `cos_outer` round `direction`.
pub const LIGHT_SPOT: u32 = 2;
/// [`Light::kind`]: a parallelogram from `position` along `edge_a` and `edge_b`; `color` is the radiance, W/m²/sr, sent
/// to the side of `edge_a × edge_b`. It hides nothing and reflects nothing.
pub const LIGHT_RECT: u32 = 3;
/// [`Light::kind`]: a point whose intensity depends on the direction, as measured of a luminaire: `color` is the mean
/// intensity over all directions, W/sr, that is its power over 4π; the entry of [`crate::Lighting::distributions`] from
/// `distribution` on multiplies it. `direction` is that of γ = 0 (downwards of a lamp on a ceiling), `edge_a` the unit
/// vector across it along which the half-plane C = 0 lies; that of C = 90° lies along `edge_a × direction` (CIE 121,
/// IES LM-63 type C).
pub const LIGHT_LUMINAIRE: u32 = 4;

/// A light that is not part of the geometry, so that it can move in every frame. [`Light::sun`], [`Light::point`],
/// [`Light::spot`] and [`Light::rectangle`] make one.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Light {
    /// Position, or a corner of the rectangle, m.
    pub position: Vec3,
    /// One of the `LIGHT_` constants.
    pub kind: u32,
    /// Unit vector of travel (directional, spot), or that of γ = 0 (luminaire).
    pub direction: Vec3,
    /// Cosine of the spot's inner half-angle.
    pub cos_inner: f32,
    /// Irradiance, intensity or radiance; see the kinds.
    pub color: Vec3,
    /// Cosine of the spot's outer half-angle.
    pub cos_outer: f32,
    /// First side of the rectangle, m; unit vector of C = 0 of a luminaire.
    pub edge_a: Vec3,
    /// Area of the rectangle, m².
    pub area: f32,
    /// Second side of the rectangle, m.
    pub edge_b: Vec3,
    /// Start of a luminaire's distribution in [`crate::Lighting::distributions`].
    pub distribution: u32,
}
const _: () = assert!(size_of::<Light>() == 80);

impl Light {
    /// Parallel light that travels along `direction`, with the irradiance of a surface that faces it.
    pub fn sun(direction: Vec3, irradiance: Irradiance) -> Self {
        let direction = direction.normalize_or_zero();
        Self { kind: LIGHT_DIRECTIONAL, direction, color: irradiance.0, ..Self::default() }
    }

    /// A point, m, that shines in all directions alike, by its [`Intensity`] or its [`crate::Flux`].
    pub fn point(position: Vec3, intensity: impl Into<Intensity>) -> Self {
        Self { kind: LIGHT_POINT, position, color: intensity.into().0, ..Self::default() }
    }

    /// A point, m, that shines round `direction`: with all of its intensity up to the half-angle `inner`, fading to
    /// none at `outer`, radians.
    pub fn spot(position: Vec3, direction: Vec3, (inner, outer): (f32, f32), intensity: Intensity) -> Self {
        Self {
            kind: LIGHT_SPOT,
            position,
            direction: direction.normalize_or_zero(),
            color: intensity.0,
            cos_inner: libm::cosf(inner),
            cos_outer: libm::cosf(outer),
            ..Self::default()
        }
    }

    /// A parallelogram from a corner along two edges, m, that shines to the side of `edges.0 × edges.1`, by its
    /// [`Radiance`] or its [`crate::Flux`]. It hides nothing and reflects nothing.
    pub fn rectangle(corner: Vec3, edges: (Vec3, Vec3), light: impl Into<SurfaceLight>) -> Self {
        let area = edges.0.cross(edges.1).length();
        Self {
            kind: LIGHT_RECT,
            position: corner,
            edge_a: edges.0,
            edge_b: edges.1,
            area,
            color: light.into().radiance(area).0,
            ..Self::default()
        }
    }
}

/// An emissive triangle as a light: entry of the cumulative distribution from which shadow rays pick, in proportion to
/// area × luminance.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Emitter {
    /// The triangle that shines.
    pub triangle: u32,
    /// Probability that a pick falls on this or an earlier entry; exactly 1 for the last.
    pub cumulative: f32,
    /// Probability of this entry.
    pub probability: f32,
    /// Its area, m².
    pub area: f32,
}
const _: () = assert!(size_of::<Emitter>() == 16);

/// Near emissive triangles as one, seen from afar: their power by direction ω from them is about
/// `Σ A L max(0, n·ω) ≈ 3/32 Σ A L + ½ ω·Σ A L n + 15/32 ω·(Σ A L n nᵀ) ω`, the first three bands of spherical
/// harmonics of each.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct EmitterGroup {
    /// Centre, m.
    pub centre: Vec3,
    /// `Σ A L` with the luminance L of each, W/sr.
    pub power: f32,
    /// Colour of the power: RGB over luminance.
    pub color: Vec3,
    /// 1 where all normals are one: then the power by direction is `max(0, ω·Σ A L n)`.
    pub is_flat: u32,
    /// `Σ A L n`.
    pub normal: Vec3,
    /// First of the squares on the diagonal of `Σ A L n nᵀ`.
    pub squares_x: f32,
    /// The second and the third, and 0.
    pub squares_yz: Vec3,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
    /// Its products xy, yz and zx.
    pub products: Vec3,
    /// Keeps the size a multiple of 16.
    pub reserved_b: u32,
}
const _: () = assert!(size_of::<EmitterGroup>() == 80);

/// Light from every direction that sees no geometry.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Sky {
    /// Constant radiance, W/m²/sr; multiplies the map when there is one.
    pub radiance: Vec3,
    /// Width of the equirectangular map, 0 without one. The map's middle column is −z, its top row +y.
    pub map_width: u32,
    /// Height of the map.
    pub map_height: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 3],
}
const _: () = assert!(size_of::<Sky>() == 32);

/// A pinhole. A ray goes along `forward + x·right + y·up` with x, y in [−1, 1] over the picture, y upwards.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Camera {
    /// Position, m.
    pub eye: Vec3,
    /// Picture width, pixels.
    pub width: u32,
    /// Unit view direction.
    pub forward: Vec3,
    /// Picture height, pixels.
    pub height: u32,
    /// Half the picture's width at unit distance.
    pub right: Vec3,
    /// Sub-frames of a picture whose positions are the same in every pixel and frame, the seed of each its number; 0
    /// for positions that follow from the seed.
    pub fixed_sub_frames: u32,
    /// Half the picture's height at unit distance.
    pub up: Vec3,
    /// Keeps `up` before a scalar.
    pub reserved_b: u32,
}
const _: () = assert!(size_of::<Camera>() == 64);

/// A ray for the ray-casting kernels: `origin + t·direction` with t in (0, `t_max`).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Ray {
    /// Start, m.
    pub origin: Vec3,
    /// Greatest t.
    pub t_max: f32,
    /// Direction; t counts in its length.
    pub direction: Vec3,
    /// Keeps `direction` before a scalar.
    pub reserved: u32,
}
const _: () = assert!(size_of::<Ray>() == 32);

/// The closest hit of a ray: the point `corner + u·edge_a + v·edge_b` of `triangle` at distance `t`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Hit {
    /// The triangle, or [`NONE`].
    pub triangle: u32,
    /// Share of `edge_a`.
    pub u: f32,
    /// Share of `edge_b`.
    pub v: f32,
    /// Distance in lengths of the ray's direction.
    pub t: f32,
}
const _: () = assert!(size_of::<Hit>() == 16);

impl Hit {
    /// A ray that meets nothing.
    pub const MISS: Self = Self { triangle: NONE, u: 0.0, v: 0.0, t: f32::INFINITY };

    /// Returns true if nothing was met.
    #[inline]
    pub fn is_miss(&self) -> bool {
        self.triangle == NONE
    }
}

/// Specular path of a pixel's ray, up to the surface whose diffuse part it shows; identity if the first hit is diffuse.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SpecularChain {
    /// Factor on that surface's light on its way to the pixel; 0 where there is none.
    pub through: Vec3,
    /// Specular surfaces that were met.
    pub surfaces: u32,
    /// Radiance of what shines by itself on the way, that surface included, W/m²/sr.
    pub shone: Vec3,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
    /// Unit direction of the last segment.
    pub direction: Vec3,
    /// Keeps `direction` before a scalar.
    pub reserved_b: u32,
}
const _: () = assert!(size_of::<SpecularChain>() == 48);

/// A point of a surface at which direct light is measured.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SurfacePoint {
    /// Position, m.
    pub position: Vec3,
    /// The patch it stands for, or [`NONE`].
    pub patch: u32,
    /// Unit normal of the side that is lit.
    pub normal: Vec3,
    /// Share of the patch's area (sums to 1 over a patch).
    pub weight: f32,
}
const _: () = assert!(size_of::<SurfacePoint>() == 32);

/// Settings of the direct-light kernels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct DirectParams {
    /// Number of points.
    pub count: u32,
    /// Number of lights.
    pub light_count: u32,
    /// Number of emitters.
    pub emitter_count: u32,
    /// Shadow rays a point for each rectangle light, and as many for all emitters together.
    pub area_rays: u32,
    /// Rays a point to the sky; 0 leaves the sky out.
    pub sky_rays: u32,
    /// Changes every random number.
    pub seed: u32,
    /// Distance by which rays start above a surface, m.
    pub ray_offset: f32,
    /// First point of this dispatch.
    pub first: u32,
}
const _: () = assert!(size_of::<DirectParams>() == 32);

/// Settings of random walks that look for light ([`crate::kernel::walk`]).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct WalkParams {
    /// Number of places.
    pub count: u32,
    /// Walks from each.
    pub walks: u32,
    /// Changes every random number.
    pub seed: u32,
    /// Number of lights.
    pub light_count: u32,
    /// Number of emitters.
    pub emitter_count: u32,
    /// Distance by which rays start above a surface, m.
    pub ray_offset: f32,
    /// First walk that is made, and one past the last.
    pub first_walk: u32,
    /// See `first_walk`.
    pub end_walk: u32,
}
const _: () = assert!(size_of::<WalkParams>() == 32);

/// Settings of the kernels of rectangles and emissive triangles at pixels ([`crate::kernel::large`]).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct LargeParams {
    /// The pinhole, with its number of fixed sub-frames.
    pub camera: Camera,
    /// Number of pixels of this dispatch.
    pub count: u32,
    /// Number of the sub-frame.
    pub sub_frame: u32,
    /// Number of lights.
    pub light_count: u32,
    /// Number of emitters.
    pub emitter_count: u32,
    /// Shadow rays of a sub-frame to each rectangle, and to all emitters together.
    pub rays: u32,
    /// Number of this sub-frame's first sample among those of a pixel.
    pub first_sample: u32,
    /// Samples from one pixel of a tile to the next: those of all sub-frames, rounded up to a power of two.
    pub stride: u32,
    /// Distance by which rays start above a surface, m.
    pub ray_offset: f32,
    /// Number of groups of emitters; 0 where each counts by itself.
    pub group_count: u32,
    /// First pixel of this dispatch.
    pub first: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 2],
}
const _: () = assert!(size_of::<LargeParams>() == 112);

/// Settings of the kernel that averages visibility over pixels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ShareParams {
    /// Number of pixels of this dispatch.
    pub count: u32,
    /// First of them.
    pub first: u32,
    /// Pixels in a row of the picture.
    pub width: u32,
    /// Rows of the picture.
    pub height: u32,
    /// First pixel of the tables that are averaged over, which hold the pixels about, too.
    pub first_about: u32,
    /// Number of pixels of these tables.
    pub count_about: u32,
    /// Most by which shares of light differ that are averaged.
    pub tolerance: f32,
    /// Most by which the share bends, from a pixel to those a tile further, where it counts as steady.
    pub bend: f32,
}
const _: () = assert!(size_of::<ShareParams>() == 32);

/// Radiance or irradiance as kernels store it: RGB and one unused word (arrays of three floats have no GPU layout).
pub type Rgb = Vec4;
