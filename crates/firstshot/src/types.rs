//! The plain data that CPU and GPU share, field for field. Light is linear Rec.709 RGB; lengths are metres.

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

/// [`Element::kind`]: a light element, part of a triangle that one light falls on; photons leave it reflected.
pub const ELEMENT_LIT: u32 = 0;
/// [`Element::kind`]: the front of a triangle that shines by itself.
pub const ELEMENT_EMITTER: u32 = 1;
/// [`Element::kind`]: a rectangle light.
pub const ELEMENT_RECT: u32 = 2;
/// [`Element::kind`]: a part of the sky's directions, as light that falls on the box of the scene.
pub const ELEMENT_SKY: u32 = 3;
/// [`Element::kind`]: a parallel light, as light that falls on the box of the scene.
pub const ELEMENT_BEAM: u32 = 4;
/// [`Element::kind`]: a point or spot light.
pub const ELEMENT_BULB: u32 = 5;

/// Something that photons start from. Over all elements and places the photons' density is that of the power, as well
/// as it is known; what is not known exactly is in the photon's flux.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Element {
    /// Light at the element's corners (corner, corner + `edge_a`, corner + `edge_b`) over the light's colour: the
    /// density of start points is linear between them.
    pub values: Vec3,
    /// Scales emitted light into flux relative to the mean: one over the luminance of what the density stands for.
    pub scale: f32,
    /// Light element: shares (u, v) of its first corner. Sky: least height y and least azimuth of the directions.
    pub corner: Vec2,
    /// Light element: the edge from the first to the second corner, as shares. Sky: extent in height and azimuth.
    pub edge_a: Vec2,
    /// Light element: the edge from the first to the third corner.
    pub edge_b: Vec2,
    /// One of the `ELEMENT_` constants.
    pub kind: u32,
    /// The triangle of an element or emitter.
    pub triangle: u32,
    /// The light, but for emitters and sky.
    pub light: u32,
    /// 1 where the element lies on the back of its triangle.
    pub is_back: u32,
    /// Keeps the size a multiple of 16.
    pub reserved: [u32; 2],
}
const _: () = assert!(size_of::<Element>() == 64);

/// Entry of an alias table (Walker 1977, Vose 1991): the entry itself below the threshold, the other above.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct AliasEntry {
    /// Share of the entry's own slot, as a fraction of 2³².
    pub threshold: u32,
    /// Who has the rest of the slot.
    pub other: u32,
}
const _: () = assert!(size_of::<AliasEntry>() == 8);

/// [`PhotonParams::sequence`]: independent random numbers.
pub const SEQUENCE_RANDOM: u32 = 0;
/// [`PhotonParams::sequence`]: Sobol's points with Owen's scrambling.
pub const SEQUENCE_SOBOL: u32 = 1;

/// [`PhotonParams::flags`]: a shadow ray from the start point tells its light; without, the table's is taken (Kopylov).
pub const FLAG_EXACT: u32 = 1;
/// [`PhotonParams::flags`]: densities are those of the brightest texel; what a darker one would not send is rejected
/// (Kopylov).
pub const FLAG_BOUND: u32 = 2;
/// [`PhotonParams::flags`]: light that comes straight from area lights and the sky is registered, too; else indirect
/// light only.
pub const FLAG_DIRECT: u32 = 1 << 16;

/// Most photons of a run: more may overflow the sums ([`crate::kernel::fixed`]).
pub const MAX_PHOTONS: u64 = 1 << 33;
/// [`PhotonParams::flags`]: start points are found by Cardano's formula (Kopylov), else by Newton's method.
pub const FLAG_CARDANO: u32 = 4;

/// Settings of a dispatch of photons: of every batch the same numbers of its sequence.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PhotonParams {
    /// Least corner of the box that parallel light and the sky enter through, m.
    pub low: Vec3,
    /// Photons of this dispatch.
    pub count: u32,
    /// Its greatest corner, m.
    pub high: Vec3,
    /// Photons of each batch in this dispatch: photon k is number `first + k mod per_batch` of batch `k / per_batch`.
    pub per_batch: u32,
    /// Number of the first photon of each batch.
    pub first: u32,
    /// First batch.
    pub first_batch: u32,
    /// Number of elements.
    pub element_count: u32,
    /// One of the `SEQUENCE_` constants.
    pub sequence: u32,
    /// Changes every random number.
    pub seed: u32,
    /// Any of the `FLAG_` constants.
    pub flags: u32,
    /// Number of cells that hits are registered on.
    pub cell_count: u32,
    /// Number of groups of cells, whose light is judged.
    pub group_count: u32,
    /// Absorption of the medium between surfaces, 1/m.
    pub absorption: Vec3,
    /// Distance by which rays start above a surface, m.
    pub ray_offset: f32,
}
const _: () = assert!(size_of::<PhotonParams>() == 80);

/// Settings of the irradiance of elements.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ResolveParams {
    /// Number of elements.
    pub count: u32,
    /// Mean flux of a photon, W.
    pub mean_flux: f32,
}
const _: () = assert!(size_of::<ResolveParams>() == 8);

/// Settings of the judgement by batches.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct JudgeParams {
    /// Blocks of groups.
    pub count: u32,
    /// Number of groups.
    pub group_count: u32,
    /// Number of batches.
    pub batches: u32,
}
const _: () = assert!(size_of::<JudgeParams>() == 12);

/// A number ≥ 0 in fixed point, 64 bits ([`crate::kernel::fixed`]).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Fixed {
    /// The lower 32 bits.
    pub low: u32,
    /// The upper 32 bits.
    pub high: u32,
}
const _: () = assert!(size_of::<Fixed>() == 8);

/// A photon on its way.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Photon {
    /// Start of its segment, m.
    pub origin: Vec3,
    /// Surfaces that have reflected its light.
    pub reflections: u32,
    /// Unit direction.
    pub direction: Vec3,
    /// Segments before this one.
    pub segments: u32,
    /// Flux over the mean flux of a photon; zero for one that is no more.
    pub flux: Vec3,
    /// Keeps the size a multiple of 16.
    pub reserved: u32,
}
const _: () = assert!(size_of::<Photon>() == 48);

/// [`PhotonHit::info`]: on the back of the triangle.
pub const HIT_BACK: u32 = 1;
/// [`PhotonHit::info`]: the photon's first segment ends here.
pub const HIT_FIRST: u32 = 2;
/// [`PhotonHit::info`]: the light was reflected before, so it is indirect.
pub const HIT_INDIRECT: u32 = 4;

/// End of a photon's segment.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct PhotonHit {
    /// Flux that arrives, after what the medium has absorbed, over the mean flux of a photon; zero where there was no
    /// photon.
    pub flux: Vec3,
    /// The triangle, or [`scene::NONE`] where the photon left the scene.
    pub triangle: u32,
    /// Share of `edge_a`.
    pub u: f32,
    /// Share of `edge_b`.
    pub v: f32,
    /// Number of the photon in its dispatch.
    pub photon: u32,
    /// Any of the `HIT_` constants.
    pub info: u32,
}
const _: () = assert!(size_of::<PhotonHit>() == 32);

/// Cells of a triangle's illumination map: `divisions²` on the front from `first` on, and as many on the back after
/// them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct MapGrid {
    /// First cell.
    pub first: u32,
    /// Divisions along each edge.
    pub divisions: u32,
}
const _: () = assert!(size_of::<MapGrid>() == 8);
