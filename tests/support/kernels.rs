//! Seeded inputs for every row of the kernel table: a small scene with everything that a scene may have, and the tables
//! that the kernels need beside it.

mod ddgi;
mod firstshot;
mod localmatrix;
mod multibounce;
mod temporal;

use std::collections::BTreeMap;

use ::multibounce::BlockCodec;
use bytemuck::{Pod, Zeroable};
use formfactor::{GatherParams, HemisphereParams, HitsParams, ReceiverCell, TriangleGrid, ViewParams};
use glam::{Vec2, Vec3, Vec4};
use gpu_kernels::host::{HostBinding, HostCall, HostError};
use gpu_kernels::params::{
    CountParams, FollowParams, MediumDirectParams, MediumLargeParams, MeterParams, PixelParams, ToneMapParams,
};
use gpu_kernels::table::{Access, ImageFormat, Kernel};
use gpu_kernels::table::{
    MULTIBOUNCE_BLOCKS_GATHER_BC1, MULTIBOUNCE_BLOCKS_GATHER_BC3, MULTIBOUNCE_BLOCKS_GATHER_BC6H,
    MULTIBOUNCE_BLOCKS_GATHER_BC7, MULTIBOUNCE_BLOCKS_GATHER_IMAGE,
};
use patches::kernel::volume::{CUBE_SIDES, PLANE_WORDS, SH_COEFFICIENTS};
use patches::{
    DifferenceParams, EMPTY_CELL, GridShape, LookupParams, LookupPatch, PackedWeights, RULE_WALLS, VolumeParams,
    Weight, WeightParams,
};
use scene::gpu::{
    DirectParams, EmitterGroup, LIGHT_DIRECTIONAL, LIGHT_LUMINAIRE, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT, LargeParams,
    ShareParams, SpecularChain, Texture, Triangle, TriangleUv, WalkParams,
};
use scene::kernel::specular::follow_primary;
use scene::kernel::{bvh, camera};
use scene::sampling::{cosine_hemisphere, hash3, unit};
use scene::{
    Camera, Distribution, Finish, Hit, Light, Lobe, Material, NONE, Ray, Scene, SceneParts, Sky, SurfacePoint,
};
use transport::HitCounts;
use transport::kernel::grid::{cell_count, vertex_count};
use transport::kernel::hits::WORD_COUNTS;
use transport::kernel::view::needed;

/// Bytes on a 16-byte boundary.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bytes {
    words: Vec<u128>,
    length: usize,
}

impl Bytes {
    /// A copy of a table.
    pub fn of<T: Pod>(table: &[T]) -> Self {
        let bytes: &[u8] = bytemuck::cast_slice(table);
        let mut words = vec![0u128; bytes.len().div_ceil(16)];
        bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
        Self { words, length: bytes.len() }
    }

    /// The bytes.
    pub fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.length]
    }

    /// The bytes, to be changed.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        &mut bytemuck::cast_slice_mut(&mut self.words)[..self.length]
    }

    /// The bytes as a table.
    pub fn table<T: Pod>(&self) -> &[T] {
        bytemuck::cast_slice(self.bytes())
    }
}

/// Data bound at one place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Data {
    /// A storage buffer.
    Buffer(Bytes),
    /// A sampled image.
    Image {
        /// Texel format.
        format: ImageFormat,
        /// Texels of a row.
        width: u32,
        /// Rows.
        height: u32,
        /// The texels.
        texels: Bytes,
    },
}

/// One dispatch: a kernel with everything it needs.
#[derive(Clone, Debug)]
pub struct Input {
    /// The kernel.
    pub kernel: &'static Kernel,
    /// Elements of the dispatch.
    pub invocations: u32,
    /// Push constants.
    pub push: Vec<u8>,
    /// Bindings; what is written holds values that no kernel gives.
    pub bindings: Vec<Data>,
}

impl Input {
    /// A table that is bound.
    pub fn table<T: Pod>(&self, binding: usize) -> &[T] {
        match &self.bindings[binding] {
            Data::Buffer(bytes) | Data::Image { texels: bytes, .. } => bytes.table(),
        }
    }

    /// The push constants.
    pub fn push<P: Pod>(&self) -> P {
        bytemuck::pod_read_unaligned(&self.push)
    }

    /// Runs the host form on this input; the written bindings afterwards, by number.
    ///
    /// # Errors
    /// What the kernel says of the call.
    pub fn run_on_host(&self) -> Result<BTreeMap<usize, Bytes>, HostError> {
        self.on_host(|call| self.kernel.run_on_host(call))
    }

    /// Hands this input to whatever runs it on the host; the written bindings afterwards, by number.
    ///
    /// # Errors
    /// What `run` says of the call.
    pub fn on_host(
        &self,
        run: impl FnOnce(&mut HostCall) -> Result<(), HostError>,
    ) -> Result<BTreeMap<usize, Bytes>, HostError> {
        let mut data = self.bindings.clone();
        let mut bindings: Vec<HostBinding> = data
            .iter_mut()
            .zip(self.kernel.bindings)
            .map(|(data, row)| match data {
                Data::Buffer(bytes) => match row.access {
                    Access::Read => HostBinding::Read(bytes.bytes()),
                    _ => HostBinding::Write(bytes.bytes_mut()),
                },
                Data::Image { format, width, height, texels } => {
                    HostBinding::Image { format: *format, width: *width, height: *height, texels: texels.bytes() }
                }
            })
            .collect();
        let mut call = HostCall { invocations: self.invocations, push: &self.push, bindings: &mut bindings };
        run(&mut call)?;
        drop(bindings);
        Ok(written(self.kernel, data))
    }
}

fn written(kernel: &Kernel, data: Vec<Data>) -> BTreeMap<usize, Bytes> {
    let writes = |k: &usize| kernel.bindings.get(*k).is_some_and(|b| b.access != Access::Read);
    data.into_iter()
        .enumerate()
        .filter(|(k, _)| writes(k))
        .filter_map(|(k, data)| if let Data::Buffer(bytes) = data { Some((k, bytes)) } else { None })
        .collect()
}

/// Seeded numbers.
struct Random(u32);

impl Random {
    fn word(&mut self) -> u32 {
        self.0 = self.0.wrapping_add(1);
        hash3(self.0, 0x7465_7374, 1)
    }
    fn below(&mut self, n: u32) -> u32 {
        self.word() % n
    }
    fn unit(&mut self) -> f32 {
        unit(self.word())
    }
    fn vector(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit())
    }
    fn direction(&mut self) -> Vec3 {
        let side = if self.unit() < 0.5 { Vec3::Y } else { Vec3::NEG_Y };
        cosine_hemisphere(side, (self.unit(), self.unit())).normalize()
    }
    fn color(&mut self) -> Vec4 {
        self.vector().extend(self.unit())
    }
    fn words(&mut self, n: u32) -> Vec<u32> {
        (0..n).map(|_| self.word()).collect()
    }
    fn floats(&mut self, n: usize) -> Vec<f32> {
        (0..n).map(|_| 0.1 + self.unit()).collect()
    }
    fn colors(&mut self, n: usize) -> Vec<Vec4> {
        (0..n).map(|_| self.color()).collect()
    }
    /// A weight of one of so many receivers, in one case of three with a rotation.
    fn weight(&mut self, receivers: u32) -> Weight {
        let rotation = Vec2::new(self.unit() - 0.5, self.unit() - 0.5);
        let rotation = (self.below(3) == 0).then_some(rotation);
        Weight { receiver: self.below(receivers), weight: 1.5 * self.unit() - 0.5, rotation }
    }
    /// Marks of rows: some of view [`VIEW`], some of these with marked columns, some of others.
    fn marks(&mut self, n: usize) -> Vec<u32> {
        (0..n).map(|_| needed(VIEW - 1) + self.below(5)).collect()
    }
    /// Rows of which some are needed, and some of these not computed for light [`LIGHT`].
    fn view_rows(&mut self, n: usize) -> [(&'static str, Data); 3] {
        let computed: Vec<u32> = (0..n).map(|_| LIGHT - self.below(2)).collect();
        let marks = self.marks(n);
        [buffer("marks", &marks), buffer("computed", &computed), buffer("irradiance", &self.colors(n))]
    }
}

/// Number of the view in the inputs.
const VIEW: u32 = 7;
/// Number of the light.
const LIGHT: u32 = 9;

/// Absorption of a medium in the inputs, 1/m, with a channel that it leaves.
const ABSORPTION: Vec3 = Vec3::new(0.7, 0.0, 1.9);

fn view(count: u32, first_quad: u32) -> ViewParams {
    ViewParams { count, first_quad, view: VIEW, light: LIGHT }
}

/// A heap of triangles over a floor with textures, holes, emission, mirrors and glass, all kinds of lights and a sky
/// map.
pub fn small_scene() -> Scene {
    let mut r = Random(0);
    let plain = Material { albedo: Vec3::new(0.7, 0.5, 0.3), ..Material::default() };
    let materials = vec![
        plain,
        Material { albedo_texture: 0, ..plain },
        Material { albedo_texture: 1, mask_texture: 0, ..plain },
        Material { radiance: Vec3::new(3.0, 2.0, 1.0), ..plain },
        Material { radiance: Vec3::splat(5.0), radiance_texture: 1, ..plain },
        Material {
            albedo: Vec3::splat(0.3),
            mirror: Vec3::new(0.1, 0.2, 0.3),
            transmittance: Vec3::splat(0.4),
            ..plain
        },
        Material { albedo: Vec3::ZERO, transmittance: Vec3::new(1.0, 0.9, 0.8), is_pane: 1, ..plain },
    ];
    let mut triangles = Vec::new();
    let mut add = |corner: Vec3, edge_a: Vec3, edge_b: Vec3, material: u32| {
        triangles.push(Triangle { corner, edge_a, edge_b, material, source: triangles.len() as u32, object: 0 });
    };
    add(Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 3.0, Vec3::X * 3.0, 1);
    add(Vec3::new(2.0, 0.0, 2.0), Vec3::NEG_Z * 3.0, Vec3::NEG_X * 3.0, 0);
    for k in 0..200 {
        let a = r.vector() - 0.5;
        let b = r.vector() - 0.5;
        add(
            r.vector() + Vec3::Y * 0.1,
            a * 0.3,
            b * 0.3,
            if k < 6 {
                3 + k % 2
            } else if k % 5 == 0 {
                5 + k % 2
            } else {
                k % 3
            },
        );
    }
    let mut corner = || Vec2::new(3.0 * r.unit() - 1.0, 3.0 * r.unit() - 1.0);
    let uvs = triangles
        .iter()
        .map(|_| TriangleUv { corner: corner(), corner_a: corner(), corner_b: corner(), ..TriangleUv::default() })
        .collect();
    let textures = vec![
        Texture { offset: 0, width: 8, height: 4, levels: 4 },
        Texture { offset: 32 + 8 + 2 + 1, width: 5, height: 7, levels: 3 },
    ];
    let texels = (0..2 * (43 + 35 + 6 + 1)).map(|_| r.word()).collect();
    let base = Light { position: Vec3::new(0.4, 1.6, 0.3), color: Vec3::new(1.0, 2.0, 3.0), ..Light::default() };
    let down = Vec3::new(0.3, -0.9, 0.1).normalize();
    let edges = (Vec3::X * 0.5, Vec3::Z * 0.4);
    let mut distributions = vec![7.0; 3];
    let distribution = lopsided().append_to(&mut distributions).expect("a few words");
    let lights = vec![
        Light { kind: LIGHT_DIRECTIONAL, direction: down, ..base },
        Light { kind: LIGHT_POINT, ..base },
        Light { kind: LIGHT_SPOT, direction: down, cos_inner: 0.9, cos_outer: 0.6, ..base },
        Light { kind: LIGHT_RECT, edge_a: edges.0, edge_b: edges.1, area: edges.0.cross(edges.1).length(), ..base },
        Light { kind: LIGHT_LUMINAIRE, direction: down, edge_a: down.any_orthonormal_vector(), distribution, ..base },
    ];
    Scene::new(SceneParts {
        triangles,
        uvs,
        materials,
        finishes: Vec::new(),
        textures,
        texels,
        lights,
        sky: Sky { radiance: Vec3::new(0.5, 0.7, 0.9), map_width: 8, map_height: 4, ..Sky::default() },
        sky_map: r.colors(32),
        distributions,
        ray_offset: None,
        absorption: Vec3::ZERO,
    })
    .expect("the scene of the tests is sound")
}

/// Intensities that differ in all quarters of the sphere.
fn lopsided() -> Distribution {
    let gammas: Vec<f64> = (0..=9).map(|k| 15.0 * f64::from(k)).collect();
    let planes: Vec<f64> = (0..6).map(|k| 60.0 * f64::from(k)).collect();
    let intensities = (0..60).map(|k| f64::from(1 + 7 * k % 11)).collect();
    Distribution::new(gammas, planes, intensities).expect("angles that rise")
}

/// Grids over the triangles of a scene, `count(divisions)` entries a side, some sides without; and how many entries.
fn grids(r: &mut Random, scene: &Scene, count: fn(u32) -> u32) -> (Vec<TriangleGrid>, u32) {
    let mut next = 0;
    let mut side = |r: &mut Random, divisions: u32| {
        if r.below(8) == 0 {
            return NONE;
        }
        next += count(divisions);
        next - count(divisions)
    };
    let grids = scene
        .geometry
        .triangles
        .iter()
        .map(|_| {
            let divisions = 1 + r.below(3);
            TriangleGrid { front: side(r, divisions), back: side(r, divisions), divisions, reserved: 0 }
        })
        .collect();
    (grids, next)
}

/// A point on either side of every triangle of the scene.
fn surface_points(r: &mut Random, scene: &Scene, n: usize) -> Vec<SurfacePoint> {
    let geometry = scene.tables();
    (0..n)
        .map(|k| {
            let triangle = (k % scene.geometry.triangles.len()) as u32;
            let side = if r.below(2) == 0 { 1.0 } else { -1.0 };
            SurfacePoint {
                position: geometry.position(triangle, 0.4 * r.unit(), 0.5 * r.unit()),
                patch: k as u32,
                normal: geometry.normal(triangle) * side,
                weight: r.unit(),
            }
        })
        .collect()
}

/// Points and normals anywhere in and around the unit cube.
fn points_in_space(r: &mut Random, n: usize) -> Vec<SurfacePoint> {
    (0..n)
        .map(|_| SurfacePoint {
            position: r.vector() * 1.4 - 0.2,
            patch: NONE,
            normal: r.direction(),
            weight: r.unit(),
        })
        .collect()
}

/// First members of `n` groups that are not empty, and their end.
fn offsets(r: &mut Random, n: usize) -> Vec<u32> {
    let mut offsets = vec![0u32];
    for k in 0..n {
        offsets.push(offsets[k] + 1 + r.below(6));
    }
    offsets
}

/// Voxels over the unit cube, a third of them empty; the number of each full one, that of any full one for the others,
/// and how many are full.
fn voxels(r: &mut Random) -> (GridShape, Vec<u32>, usize) {
    let count_x = 5;
    let count_y = 4;
    let count_z = 3;
    let edges = Vec3::new(0.2, 0.25, 1.0 / 3.0);
    let shape = GridShape { origin: Vec3::ZERO, count_x, edges, count_y, count_z, reserved: [0; 3] };
    let is_full: Vec<bool> = (0..count_x * count_y * count_z).map(|k| k == 0 || r.below(3) > 0).collect();
    let full = is_full.iter().filter(|full| **full).count();
    let mut next = 0;
    let mut cell = |is_full: bool| {
        if !is_full {
            return r.below(full as u32) | EMPTY_CELL;
        }
        next += 1;
        next - 1
    };
    let cells = is_full.into_iter().map(&mut cell).collect();
    (shape, cells, full)
}

/// Names of the bindings and their contents.
type Tables = Vec<(&'static str, Data)>;

fn buffer<T: Pod>(name: &'static str, table: &[T]) -> (&'static str, Data) {
    (name, Data::Buffer(Bytes::of(table)))
}

/// Room for `n` results, filled with bytes that no kernel gives.
fn room<T: Pod + Zeroable>(name: &'static str, n: usize) -> (&'static str, Data) {
    let mut bytes = Bytes::of(&vec![T::zeroed(); n]);
    bytes.bytes_mut().fill(0xa5);
    (name, Data::Buffer(bytes))
}

/// One input for every kernel of the table, in its order.
pub fn inputs() -> Vec<Input> {
    let scene = small_scene();
    crate::KERNELS
        .iter()
        .map(|kernel| {
            // Numbers of its own, so that another kernel more changes no input.
            let mut r = Random(kernel.name.bytes().fold(0, |seed, byte| hash3(seed, u32::from(byte), 2)));
            let (invocations, push, mut own) = own_tables(&mut r, kernel.name, &scene);
            own.extend(scene_tables(&scene));
            let find = |name: &str| {
                let found = own.iter().find(|(n, _)| *n == name);
                found.unwrap_or_else(|| panic!("{}: no input for {name}", kernel.name)).1.clone()
            };
            Input { kernel, invocations, push, bindings: kernel.bindings.iter().map(|b| find(b.name)).collect() }
        })
        .collect()
}

fn scene_tables(scene: &Scene) -> Tables {
    vec![
        buffer("nodes", &scene.geometry.nodes),
        buffer("triangles", &scene.geometry.triangles),
        buffer("uvs", &scene.geometry.uvs),
        buffer("materials", &scene.materials),
        buffer("textures", &scene.geometry.textures),
        buffer("texels", &scene.geometry.texels),
        buffer("lights", &scene.lighting.lights),
        buffer("emitters", &scene.emitters),
        buffer("sky", &[scene.lighting.sky]),
        buffer("sky_map", &scene.lighting.sky_map),
        buffer("distributions", &scene.lighting.distributions),
    ]
}

/// The product with some rows of blocks of a format, as a buffer or as an image: blocks of random bits, in all modes of
/// the format, each codec with another companding.
pub fn block_input(codec: BlockCodec, image: Option<ImageFormat>) -> Input {
    let mut r = Random(20_000 + codec.block_words() as u32);
    let kernel = match (codec, image) {
        (_, Some(_)) => &MULTIBOUNCE_BLOCKS_GATHER_IMAGE,
        (BlockCodec::Bc1, _) => &MULTIBOUNCE_BLOCKS_GATHER_BC1,
        (BlockCodec::Bc3, _) => &MULTIBOUNCE_BLOCKS_GATHER_BC3,
        (BlockCodec::Bc6h, _) => &MULTIBOUNCE_BLOCKS_GATHER_BC6H,
        (BlockCodec::Bc7, _) => &MULTIBOUNCE_BLOCKS_GATHER_BC7,
    };
    let (invocations, push, tables) = multibounce::blocks(&mut r, codec, image);
    Input { kernel, invocations, push, bindings: tables.into_iter().map(|(_, data)| data).collect() }
}

/// One dispatch: invocations, push constants, tables.
fn call<P: Pod>(invocations: u32, push: P, tables: Tables) -> (u32, Vec<u8>, Tables) {
    (invocations, bytemuck::bytes_of(&push).to_vec(), tables)
}

/// Light of rectangles and emitters at a band of pixels, in the third of four fixed sub-frames. Emitters count by
/// groups, though they are few.
fn large_light(r: &mut Random, name: &str, scene: &Scene) -> (u32, Vec<u8>, Tables) {
    let width = 33;
    let height = 31;
    let camera = Camera::look_at(Vec3::new(1.7, 1.2, 1.9), Vec3::splat(0.4), Vec3::Y, 55.0, width, height);
    let p = LargeParams {
        camera: Camera { fixed_sub_frames: 4, ..camera },
        count: width * 21,
        sub_frame: 2,
        light_count: scene.lighting.lights.len() as u32,
        emitter_count: scene.emitters.len() as u32,
        rays: 2,
        first_sample: 4,
        stride: 8,
        ray_offset: scene.geometry.ray_offset,
        group_count: 3,
        first: width * 4 + 7,
        reserved: [0; 2],
    };
    let n = p.count as usize;
    let geometry = scene.tables();
    let pixels = p.first..p.first + p.count;
    let hits: Vec<Hit> = pixels.clone().map(|k| camera::primary_hit(&geometry, &p.camera, k, p.sub_frame)).collect();
    let points: Vec<SurfacePoint> = pixels
        .zip(&hits)
        .map(|(k, &hit)| {
            let direction = camera::primary_direction(&p.camera, k, p.sub_frame);
            camera::surface_point(&geometry, hit, direction)
        })
        .collect();
    let group = |r: &mut Random| EmitterGroup {
        centre: r.vector(),
        power: r.unit(),
        color: r.vector(),
        is_flat: r.below(2),
        normal: r.vector() - 0.5,
        squares_x: r.unit(),
        squares_yz: r.vector(),
        products: r.vector() - 0.5,
        ..EmitterGroup::default()
    };
    let groups: Vec<EmitterGroup> = (0..3).map(|_| group(r)).collect();
    let seen = r.colors(n);
    // What is seen is a part of all.
    let sampled: Vec<Vec4> = seen.iter().map(|seen| *seen * (1.0 + r.unit())).collect();
    let mut of_lobes = Vec::new();
    if name.contains("lobe") {
        let (grids, cells) = grids(r, scene, cell_count);
        let lobes: Vec<Lobe> = (0..n).map(|k| lobe(r, p.camera.eye, &points[k])).collect();
        of_lobes = vec![
            buffer("lobes", &lobes),
            buffer("grids", &grids),
            buffer("cells", &(0..cells).rev().map(|k| if k % 9 == 0 { NONE } else { k }).collect::<Vec<u32>>()),
            buffer("exitance", &r.colors(cells as usize)),
            buffer("reflectance", &sampled),
            buffer("of_sky", &seen),
            buffer("of_surfaces", &r.colors(n)),
        ];
    }
    let mut tables = vec![
        buffer("hits", &hits),
        buffer("albedo", &r.colors(n)),
        buffer("points", &points),
        buffer("groups", &groups),
        buffer("open", &r.colors(n)),
        buffer("seen", &seen),
        buffer("sampled", &sampled),
        buffer("full", &r.colors(n)),
        buffer("direct", &r.colors(n)),
    ];
    tables.extend(of_lobes);
    match name {
        "scene_mark_steady" | "scene_add_large_light" | "scene_add_lobes" => {
            // The tables have the pixels about, too.
            let margin = 4 * width + 4;
            let count = p.count - 2 * margin;
            let share = ShareParams {
                count,
                first: p.first + margin,
                width,
                height,
                first_about: p.first,
                count_about: p.count,
                tolerance: 0.3,
                bend: 0.3,
            };
            call(count, share, tables)
        }
        "scene_seen_light_medium" | "scene_lobe_ray" => {
            call(p.count, MediumLargeParams { large: p, absorption: ABSORPTION, count: p.count }, tables)
        }
        _ => call(p.count, p, tables),
    }
}

/// A lobe of what is seen from a place, or none.
fn lobe(r: &mut Random, eye: Vec3, point: &SurfacePoint) -> Lobe {
    Lobe {
        facing: r.vector() * 0.9,
        alpha: if r.below(5) == 0 { 0.0 } else { 0.16 + 0.8 * r.unit() },
        grazing: Vec3::ONE,
        matte: r.unit(),
        to_eye: (eye - point.position).normalize(),
        bend: if r.below(3) == 0 { Vec3::ZERO } else { 0.4 * (r.vector() - 0.5) },
        ..Lobe::default()
    }
}

/// Finishes of the materials of a scene, with textures and without.
fn finishes(r: &mut Random, scene: &Scene) -> Vec<Finish> {
    let finish = |k: u32, r: &mut Random| Finish {
        normal_texture: if k.is_multiple_of(2) { k % 4 / 2 } else { NONE },
        normal_scale: 0.5 + r.unit(),
        surface_texture: if k.is_multiple_of(3) { k % 2 } else { NONE },
        roughness: r.unit(),
        metallic: r.unit(),
        has_lobe: u32::from(k % 5 != 4),
        ..Finish::default()
    };
    (0..scene.materials.len() as u32).map(|k| finish(k, r)).collect()
}

/// Specular paths of pixels, by way of mirrors and through glass.
fn chains(r: &mut Random, name: &str, scene: &Scene) -> (u32, Vec<u8>, Tables) {
    let camera = Camera::look_at(Vec3::new(1.7, 1.2, 1.9), Vec3::splat(0.4), Vec3::Y, 55.0, 33, 31);
    let count = 33 * 21;
    let light_count = scene.lighting.lights.len() as u32;
    let pixels = PixelParams { camera, count, seed: 5, light_count, first: 33 * 5 };
    let ray_offset = scene.geometry.ray_offset;
    let n = count as usize;
    if name == "scene_follow" {
        let p = FollowParams { pixels, absorption: ABSORPTION, ray_offset, count, ..FollowParams::default() };
        return call(count, p, vec![room::<Hit>("hits", n), room::<SpecularChain>("chains", n)]);
    }
    let tables_of_scene = scene.tables();
    let lights = scene.all_lights();
    let follow = |k: u32| {
        follow_primary(&tables_of_scene, &lights, light_count, &camera, pixels.first + k, 5, ray_offset, Vec3::ZERO)
    };
    let (hits, chains): (Vec<Hit>, Vec<SpecularChain>) = (0..count).map(follow).unzip();
    assert!(chains.iter().filter(|chain| chain.surfaces > 0).count() > 20, "some rays go on");
    let mut tables = vec![
        buffer("hits", &hits),
        buffer("chains", &chains),
        buffer("albedo", &r.colors(n)),
        buffer("direct", &r.colors(n)),
        buffer("indirect", &r.colors(n)),
        buffer("sum", &r.colors(n)),
    ];
    if name == "scene_chain_finish" {
        let of_chain =
            |(&hit, chain): (&Hit, &SpecularChain)| camera::surface_point(&tables_of_scene, hit, chain.direction);
        let points: Vec<SurfacePoint> = hits.iter().zip(&chains).map(of_chain).collect();
        tables.extend([buffer("points", &points), buffer("finishes", &finishes(r, scene)), room::<Lobe>("lobes", n)]);
        return call(count, pixels, tables);
    }
    tables.push(room::<SurfacePoint>("points", n));
    if name == "scene_chain_surface" {
        return call(count, pixels, tables);
    }
    call(count, CountParams { count }, tables)
}

/// Irradiance of pixels that is turned to their normals, with as many rows of weights as there are interpolation points.
fn turn(
    r: &mut Random,
    scene: &Scene,
    (eye, points): (Vec3, &[SurfacePoint]),
    rows: usize,
    mut tables: Tables,
) -> (u32, Vec<u8>, Tables) {
    let made: Vec<Vec<Weight>> = (0..rows).map(|_| (0..r.below(9)).map(|_| r.weight(90)).collect()).collect();
    let weights = PackedWeights::new(rows, |k| made[k].clone()).expect("few weights");
    let lobes: Vec<Lobe> = points.iter().map(|point| lobe(r, eye, point)).collect();
    tables.retain(|(name, _)| *name != "irradiance");
    tables.extend([
        buffer("lobes", &lobes),
        buffer("row_start", weights.row_start()),
        buffer("list_start", weights.list_start()),
        buffer("lists", weights.lists()),
        buffer("entries", weights.entries()),
        buffer("receivers", &surface_points(r, scene, 90)),
        buffer("received", &r.colors(4 * 90)),
        buffer("irradiance", &r.colors(points.len())),
    ]);
    let p = DifferenceParams {
        count: points.len() as u32,
        rows: rows as u32,
        block_rows: weights.block_rows(),
        reserved: 0,
    };
    call(p.count, p, tables)
}

/// Elements, push constants and the tables that are not the scene's.
fn own_tables(r: &mut Random, name: &str, scene: &Scene) -> (u32, Vec<u8>, Tables) {
    match name {
        "scene_closest_hit" | "scene_any_hit" => {
            let n = 1000;
            let rays: Vec<Ray> = (0..n)
                .map(|k| {
                    let t_max = if k % 3 == 0 { 0.5 } else { bvh::FAR };
                    Ray { origin: r.vector() * 1.4 - 0.2, t_max, direction: r.direction(), reserved: 0 }
                })
                .collect();
            let tables = vec![buffer("rays", &rays), room::<Hit>("hits", n), room::<u32>("stopped", n)];
            call(n as u32, CountParams { count: n as u32 }, tables)
        }
        "scene_reachability" => {
            // Places on surfaces, on either side, and some in the air; of some it is known that they see geometry.
            let mut points = surface_points(r, scene, 150);
            for (k, point) in (0u32..).zip(&mut points) {
                point.patch = k;
                point.weight = (k % 5) as f32 - 2.0;
                point.normal = if k % 2 == 0 { point.normal } else { -point.normal };
                point.position.y += if k % 7 == 0 { 0.3 } else { 0.0 };
            }
            let p = WalkParams { count: 150, first_walk: 1, ..scene.walk_params(3, 5) };
            call(150, p, vec![buffer("points", &points), room::<u32>("reached", 150)])
        }
        "scene_direct_light" | "scene_direct_light_medium" | "scene_direct_shares" | "scene_add_lights" => {
            let points = surface_points(r, scene, 150);
            let lights = scene.lighting.lights.len();
            let triangles = scene.geometry.triangles.len() as u32;
            let p = DirectParams {
                count: 150,
                light_count: lights as u32,
                emitter_count: scene.emitters.len() as u32,
                area_rays: 5,
                sky_rays: 7,
                seed: 3,
                ray_offset: scene.geometry.ray_offset,
                first: 11,
            };
            // All but the first light have changed, the last one first.
            let changed: Vec<u32> = (1..lights as u32).rev().collect();
            let p =
                if name == "scene_direct_shares" { DirectParams { light_count: changed.len() as u32, ..p } } else { p };
            let tables = vec![
                buffer("points", &points),
                buffer("changed", &changed),
                buffer("shares", &r.floats(150 * lights)),
                buffer("occluders", &(0..150 * lights as u32).map(|k| 7 * k % (triangles + 1)).collect::<Vec<_>>()),
                buffer("surroundings", &r.colors(150)),
                room::<Vec4>("irradiance", 150),
            ];
            match name {
                "scene_direct_light_medium" => {
                    call(150, MediumDirectParams { direct: p, absorption: ABSORPTION, count: 150 }, tables)
                }
                _ => call(150, p, tables),
            }
        }
        "scene_matte" | "scene_add_shine" => {
            let points = points_in_space(r, 200);
            let lobes: Vec<Lobe> = points.iter().map(|point| lobe(r, Vec3::splat(2.0), point)).collect();
            let mut tables: Tables = ["albedo", "shine", "full", "direct"].map(|n| buffer(n, &r.colors(200))).into();
            tables.extend([buffer("lobes", &lobes), room::<Vec4>("matte", 200)]);
            call(200, CountParams { count: 200 }, tables)
        }
        "scene_lobe_sharp" => {
            let points = surface_points(r, scene, 150);
            let lobes: Vec<Lobe> = points.iter().map(|point| lobe(r, Vec3::new(1.7, 1.2, 1.9), point)).collect();
            let ray_offset = scene.geometry.ray_offset;
            let light_count = scene.lighting.lights.len() as u32;
            let direct = DirectParams { count: 150, light_count, ray_offset, ..DirectParams::default() };
            let tables = vec![
                buffer("points", &points),
                buffer("lobes", &lobes),
                room::<Vec4>("shine", 150),
                buffer("reflectance", &r.colors(150)),
            ];
            call(150, MediumDirectParams { direct, absorption: ABSORPTION, count: 150 }, tables)
        }
        "scene_sharp_light" | "scene_sharp_light_medium" => {
            let points = surface_points(r, scene, 150);
            let ray_offset = scene.geometry.ray_offset;
            let light_count = scene.lighting.lights.len() as u32;
            let p = DirectParams { count: 150, light_count, ray_offset, ..DirectParams::default() };
            let from_sky = buffer("from_sky", &r.colors(150));
            let tables = vec![buffer("points", &points), from_sky, room::<Vec4>("irradiance", 150)];
            match name {
                "scene_sharp_light" => call(150, p, tables),
                _ => call(150, MediumDirectParams { direct: p, absorption: ABSORPTION, count: 150 }, tables),
            }
        }
        "scene_open_light"
        | "scene_seen_light"
        | "scene_seen_light_medium"
        | "scene_mark_steady"
        | "scene_add_large_light"
        | "scene_lobe_open"
        | "scene_lobe_ray"
        | "scene_add_lobes" => large_light(r, name, scene),
        "scene_follow" | "scene_chain_surface" | "scene_chain_shade" | "scene_chain_finish" => chains(r, name, scene),
        "scene_primary"
        | "scene_albedo"
        | "scene_shade"
        | "scene_finish"
        | "transport_interpolate"
        | "transport_mark_pixels"
        | "patches_turn" => {
            let eye = Vec3::new(1.7, 1.2, 1.9);
            let camera = Camera::look_at(eye, Vec3::splat(0.4), Vec3::Y, 55.0, 33, 31);
            let n = 33 * 21;
            let light_count = scene.lighting.lights.len() as u32;
            let p = PixelParams { camera, count: n as u32, seed: 5, light_count, first: 33 * 5 };
            let geometry = scene.tables();
            let pixels = p.first..p.first + p.count;
            let hits: Vec<Hit> = pixels.clone().map(|k| camera::primary_hit(&geometry, &camera, k, p.seed)).collect();
            let points: Vec<SurfacePoint> = pixels
                .zip(&hits)
                .map(|(k, &hit)| {
                    let direction = camera::primary_direction(&camera, k, p.seed);
                    camera::surface_point(&geometry, hit, direction)
                })
                .collect();
            if name == "scene_primary" {
                return call(p.count, p, vec![room::<Hit>("hits", n), room::<SurfacePoint>("points", n)]);
            }
            if name == "scene_albedo" {
                let tables = vec![buffer("hits", &hits), room::<Vec4>("albedo", n)];
                return call(p.count, p, tables);
            }
            if name == "scene_finish" {
                let tables = vec![
                    buffer("hits", &hits),
                    buffer("albedo", &r.colors(n)),
                    buffer("points", &points),
                    buffer("finishes", &finishes(r, scene)),
                    room::<Lobe>("lobes", n),
                ];
                return call(p.count, p, tables);
            }
            let (grids, count) = grids(r, scene, cell_count);
            let mut values = 0;
            let cell = |_| {
                let divisions = 1 + r.below(4);
                values += vertex_count(divisions);
                ReceiverCell { first: values - vertex_count(divisions), divisions }
            };
            let cells: Vec<ReceiverCell> = (0..count).map(cell).collect();
            let tables = vec![
                buffer("hits", &hits),
                buffer("albedo", &r.colors(n)),
                buffer("points", &points),
                buffer("grids", &grids),
                buffer("receiver_cells", &cells),
                buffer("vertices", &(0..values).rev().collect::<Vec<u32>>()),
                buffer("values", &r.colors(values as usize)),
                buffer("direct", &r.colors(n)),
                buffer("indirect", &r.colors(n)),
                buffer("sum", &r.colors(n)),
                room::<Vec4>("irradiance", n),
                buffer("marks", &r.marks(values as usize)),
            ];
            if name == "patches_turn" {
                return turn(r, scene, (eye, &points), values as usize, tables);
            }
            match name {
                "scene_shade" => call(p.count, p, tables),
                "transport_mark_pixels" => call(p.count, view(p.count, 0), tables),
                _ => call(p.count, CountParams { count: p.count }, tables),
            }
        }
        "scene_tone_map" => {
            let p = ToneMapParams { count: 300, scale: 1.7, tone: r.below(3), reserved: 0 };
            call(300, p, vec![buffer("sum", &r.colors(300)), room::<u32>("pixels", 300)])
        }
        "scene_meter" => {
            let p = MeterParams { count: 5, pixels: 300, run: 70, reserved: 0 };
            call(5, p, vec![buffer("sum", &r.colors(300)), room::<f32>("means", 5)])
        }
        "formfactor_hemisphere_hits" | "formfactor_hemisphere_surfaces" => {
            let (grids, patch_count) = grids(r, scene, cell_count);
            let mut offsets = vec![0u32];
            for k in 0..30 {
                offsets.push(offsets[k] + 1 + r.below(3));
            }
            let points = surface_points(r, scene, offsets[30] as usize);
            let first_row = 2;
            let row_count = 23;
            let rays = 17;
            let p = HemisphereParams {
                first_row,
                row_count,
                rays,
                patch_count,
                seed: 9,
                ray_offset: scene.geometry.ray_offset,
                reserved: [0; 2],
            };
            let n = row_count * rays;
            let tables = vec![
                buffer("offsets", &offsets),
                buffer("points", &points),
                buffer("grids", &grids),
                buffer("cell_columns", &(0..patch_count).rev().collect::<Vec<u32>>()),
                room::<u32>("ids", n as usize),
                room::<Hit>("hits", n as usize),
            ];
            call(n, p, tables)
        }
        "formfactor_assemble_source" => {
            let mut offsets = vec![0u32];
            for k in 0..200 {
                offsets.push(offsets[k] + r.below(4));
            }
            let points = surface_points(r, scene, offsets[200] as usize);
            let tables = vec![
                buffer("offsets", &offsets),
                buffer("points", &points),
                buffer("direct", &r.colors(points.len())),
                buffer("emission", &r.colors(200)),
                buffer("albedo", &r.colors(points.len())),
                room::<Vec4>("source", 200),
            ];
            call(200, CountParams { count: 200 }, tables)
        }
        "transport_bounce" => {
            let mut tables: Tables = ["source", "albedo", "irradiance"].map(|n| buffer(n, &r.colors(200))).into();
            tables.push(room::<Vec4>("exitance", 200));
            call(200, CountParams { count: 200 }, tables)
        }
        "transport_gather_csr" => {
            let mut row_start = vec![0u32];
            for k in 0..150 {
                row_start.push(row_start[k] + r.below(12));
            }
            let entries = row_start[150] as usize;
            let columns: Vec<u32> = (0..entries).map(|_| r.below(90)).collect();
            let values: Vec<f32> = (0..entries).map(|_| r.unit()).collect();
            let tables = vec![
                buffer("row_start", &row_start),
                buffer("columns", &columns),
                buffer("values", &values),
                buffer("exitance", &r.colors(90)),
                room::<Vec4>("irradiance", 150),
            ];
            call(150, CountParams { count: 150 }, tables)
        }
        "transport_gather_hits" | "transport_gather_hits_view" => {
            // Half of the hits lie in a few columns: counts from one to more than four different columns can have.
            let rows = 150;
            let rays = 300;
            let columns = 90;
            let hits: Vec<u32> =
                (0..rows * rays).map(|k| if k % 2 == 0 { r.below(columns + 9) } else { r.below(4) / 3 }).collect();
            let scales: Vec<f32> = (0..rows).map(|_| r.unit() / rays as f32).collect();
            let mut rows_of_hits = HitCounts::new(columns as usize).expect("few columns");
            rows_of_hits.push(&hits, &scales).expect("as many rays for every row");
            // A block of rows: the first are left out, with their quads down to a whole word of counts.
            let skipped = 17;
            let first_quad = rows_of_hits.row_start()[skipped] / WORD_COUNTS * WORD_COUNTS;
            let rows = rows - skipped as u32;
            let first = first_quad as usize;
            let mut tables = vec![
                buffer("row_start", &rows_of_hits.row_start()[skipped..]),
                buffer("quads", &rows_of_hits.quads()[first..]),
                buffer("counts", &rows_of_hits.count_words()[first / WORD_COUNTS as usize..]),
                buffer("scales", &rows_of_hits.scales()[skipped..]),
                buffer("exitance", &r.colors(columns as usize)),
            ];
            if name == "transport_gather_hits_view" {
                tables.extend(r.view_rows(rows as usize));
                return call(rows, view(rows, first_quad), tables);
            }
            tables.push(room::<Vec4>("irradiance", rows as usize));
            call(rows, HitsParams { rows, first_quad }, tables)
        }
        "transport_gather" | "transport_gather_half" => {
            let rows = 71u32;
            let columns = 1031usize;
            let vectors = columns.div_ceil(4) as u32;
            let p = GatherParams { rows, vectors, first_row: 3, reserved: 0 };
            // A row as it is stored: what is beyond the columns is 0.
            let mut factors = vec![0.0f32; (4 * rows * vectors) as usize];
            for row in factors.chunks_mut(4 * vectors as usize) {
                row[..columns].fill_with(|| r.unit() / columns as f32);
            }
            let halves: Vec<half::f16> = factors.iter().map(|f| half::f16::from_f32(*f)).collect();
            let mut exitance = r.colors(4 * vectors as usize);
            exitance[columns..].fill(Vec4::ZERO);
            let tables = vec![
                if name.ends_with("half") { buffer("factors", &halves) } else { buffer("factors", &factors) },
                buffer("exitance", &exitance),
                room::<Vec4>("irradiance", rows as usize + 3),
            ];
            call(rows, p, tables)
        }
        name if name.starts_with("ddgi_") => ddgi::own_tables(r, name, scene),
        name if name.starts_with("firstshot_") => firstshot::own_tables(r, name, scene),
        name if name.starts_with("localmatrix_") => localmatrix::own_tables(r, name),
        name if name.starts_with("multibounce_") => multibounce::own_tables(r, name),
        name if name.starts_with("temporal_") => temporal::own_tables(r, name),
        "patches_weigh" | "patches_weigh_view" | "patches_mark_receivers" => {
            // Of 90 receivers, whose values follow their quadrants or are the sums of these.
            let rows = 150;
            let parts = if name == "patches_weigh" { 4 } else { 1 };
            let made: Vec<Vec<Weight>> = (0..rows).map(|_| (0..r.below(9)).map(|_| r.weight(90)).collect()).collect();
            let weights = PackedWeights::new(rows, |k| made[k].clone()).expect("few weights");
            let p = WeightParams {
                count: rows as u32,
                block_rows: weights.block_rows(),
                first_value: if parts == 1 { 4 * 90 } else { 0 },
                parts,
                view: VIEW,
                light: LIGHT,
                ..WeightParams::default()
            };
            let mut tables = vec![
                buffer("row_start", weights.row_start()),
                buffer("list_start", weights.list_start()),
                buffer("lists", weights.lists()),
                buffer("entries", weights.entries()),
            ];
            match name {
                "patches_mark_receivers" => {
                    tables.extend([buffer("row_marks", &r.marks(rows)), buffer("marks", &r.marks(5 * 90))]);
                }
                "patches_weigh" => {
                    tables.extend([buffer("received", &r.colors(5 * 90)), room::<Vec4>("irradiance", rows)]);
                }
                _ => {
                    tables.push(buffer("received", &r.colors(5 * 90)));
                    tables.extend(r.view_rows(rows));
                }
            }
            call(rows as u32, p, tables)
        }
        "patches_lookup" => {
            let (shape, cells, full) = voxels(r);
            let offsets = offsets(r, full);
            let count = offsets[full];
            let entries: Vec<LookupPatch> = (0..count)
                .map(|k| LookupPatch {
                    position: r.vector(),
                    patch: count - 1 - k,
                    direction: r.direction(),
                    reserved: 0,
                })
                .collect();
            let n = 500;
            let p = LookupParams { shape, plane_limit: 0.5, rule: RULE_WALLS, count: n as u32, first_cell: 0 };
            let tables = vec![
                buffer("cells", &cells),
                buffer("offsets", &offsets),
                buffer("entries", &entries),
                buffer("values", &r.colors(count as usize)),
                buffer("points", &points_in_space(r, n)),
                room::<Vec4>("irradiance", n),
            ];
            call(n as u32, p, tables)
        }
        "patches_volume_lookup" | "patches_volume_lookup_sh" => {
            let (shape, probes, full) = voxels(r);
            // Planes at all distances from half a voxel on, and directions that met nothing.
            let planes: Vec<f32> = (0..full * (PLANE_WORDS / 3) as usize)
                .flat_map(|_| if r.below(3) == 0 { [0.0; 3] } else { (r.vector() * 4.0 - 2.0).to_array() })
                .collect();
            let n = 500;
            let p = VolumeParams { shape, lift: 0.01, walls: 1, count: n as u32, reserved: 0 };
            let tables = vec![
                buffer("probes", &probes),
                buffer("planes", &planes),
                buffer("cubes", &r.colors(full * CUBE_SIDES as usize)),
                buffer("harmonics", &r.colors(full * SH_COEFFICIENTS as usize)),
                buffer("points", &points_in_space(r, n)),
                room::<Vec4>("irradiance", n),
            ];
            call(n as u32, p, tables)
        }
        other => panic!("the kernel {other} has no input here: add one"),
    }
}
