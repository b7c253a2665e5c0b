#![no_std]
//! Light in a room by every method crate, with `alloc` alone.
//!
//! Built for a target without `std` it shows that the method crates need none; its test compares what comes out with
//! numbers that are the same with `std`.

extern crate alloc;

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;
use core::ops::ControlFlow;

use firstshot::{Emission, IlluminationMaps, LightElementSettings, PhotonSettings, Texels, Tracer};
use formfactor::{AreaToArea, Estimator, Hemisphere, Stop, form_factors, jacobi, lu, reciprocal};
use glam::{Vec3, Vec4};
use localmatrix::{Local, LocalSettings, Surface, Table, View};
use multibounce::{Channels, Factors, LowRank, TileSide, TileSource, all_bounces, halving_order};
use patches::{Density, MeshSettings, PatchKind, PatchMesh, lit_sampler};
use scene::gpu::{BvhNode, DirectParams, LIGHT_POINT, Triangle, TriangleUv};
use scene::sampling::hash;
use scene::{Light, Material, NONE, Scene, SceneParts};
use temporal::{AliasTables, Packing, Settings, State};
use transport::{Csr, HitCounts, LinearOperator, spatial_order};

/// Errors of any of the crates.
pub type Error = Box<dyn core::error::Error>;

/// Results of the crates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Results {
    /// Hashes of all bits.
    pub exact: Vec<(&'static str, u32)>,
    /// Mean irradiance of the patches, W/m², where sums depend on the width of registers.
    pub rounded: Vec<(&'static str, f32)>,
}

/// Bits of numbers, one after the other.
fn hash_of(words: impl IntoIterator<Item = u32>) -> u32 {
    words.into_iter().fold(0, |all, word| hash(all ^ word))
}

fn hash_of_vectors<'a>(vectors: impl IntoIterator<Item = &'a Vec4>) -> u32 {
    hash_of(vectors.into_iter().flat_map(|v| v.to_array().map(f32::to_bits)))
}

fn hash_of_numbers<'a>(numbers: impl IntoIterator<Item = &'a f32>) -> u32 {
    hash_of(numbers.into_iter().map(|x| x.to_bits()))
}

/// Mean of all channels.
fn mean(irradiance: &[Vec4]) -> f32 {
    irradiance.iter().map(|h| h.truncate().element_sum()).sum::<f32>() / (3 * irradiance.len().max(1)) as f32
}

/// Two triangles over two edges.
fn square(corner: Vec3, a: Vec3, b: Vec3, material: u32) -> [Triangle; 2] {
    let half =
        |corner: Vec3, edge_a: Vec3, edge_b: Vec3| Triangle { corner, edge_a, edge_b, material, ..Triangle::default() };
    [half(corner, a, b), half(corner + a + b, -a, -b)]
}

/// A lamp in a room of 2 m × 1 m × 1.5 m with one red wall, all triangles in one leaf: with the same hierarchy they
/// have the same numbers.
///
/// # Errors
/// None that is known.
pub fn room() -> Result<Scene, Error> {
    let x = Vec3::X * 2.0;
    let y = Vec3::Y;
    let z = Vec3::Z * 1.5;
    let sides = [
        square(Vec3::ZERO, z, x, 0),
        square(y, x, z, 0),
        square(Vec3::ZERO, x, y, 0),
        square(z, y, x, 0),
        square(Vec3::ZERO, y, z, 1),
        square(x, z, y, 0),
    ];
    let triangles = sides.concat();
    let count = triangles.len();
    let material = |albedo: Vec3| Material { albedo, ..Material::default() };
    let lamp = Light { kind: LIGHT_POINT, position: Vec3::new(0.6, 0.7, 0.5), color: Vec3::ONE, ..Light::default() };
    let leaf = BvhNode { min: Vec3::ZERO, max: x + y + z, prim_count: count as u32, first_index: 0 };
    let parts = SceneParts {
        triangles,
        uvs: vec![TriangleUv::default(); count],
        materials: vec![material(Vec3::splat(0.6)), material(Vec3::new(0.7, 0.2, 0.1))],
        lights: vec![lamp],
        ..SceneParts::default()
    };
    Ok(Scene::with_hierarchy(parts, vec![leaf])?)
}

/// Light in [`room`] by every method.
///
/// # Errors
/// What any of the crates says.
pub fn light() -> Result<Results, Error> {
    let scene = room()?;
    let mut results = Results::default();
    let mesh = make_patches(&scene, &mut results)?;
    let source = first_exitance(&scene, &mesh, &mut results);
    let (factors, area) = make_factors(&scene, &mesh, &mut results)?;
    solve(&factors, &source, &mesh.albedo, &mut results)?;
    multiply(&factors, &mesh, &area, &source, &mut results)?;
    follow_camera(&factors, &mesh, &area, &source, &mut results)?;
    sample(&factors, &source, &mesh.albedo, &mut results)?;
    trace(&scene, &mut results)?;
    Ok(results)
}

/// Clusters of lit samples, and the polygons that the rest goes on with.
fn make_patches(scene: &Scene, results: &mut Results) -> Result<PatchMesh, Error> {
    let settings = |kind| MeshSettings { kind, count: 96, voxel_size: None, samples: 8, seed: 1 };
    let sampler = lit_sampler(scene, 96, Density::default(), 1)?;
    for (name, kind) in [("clusters", PatchKind::Cluster), ("voxel patches", PatchKind::Voxel)] {
        let mesh = PatchMesh::new(scene, sampler.as_ref(), &settings(kind))?;
        results.exact.push((name, hash_of_vectors(&mesh.element_albedo) ^ hash_of_numbers(&mesh.areas())));
    }
    let mesh = PatchMesh::new(scene, sampler.as_ref(), &settings(PatchKind::Polygon))?;
    results.exact.push(("polygons", hash_of_numbers(&mesh.areas())));
    Ok(mesh)
}

/// E of each patch, W/m².
fn first_exitance(scene: &Scene, mesh: &PatchMesh, results: &mut Results) -> Vec<Vec4> {
    let p = DirectParams {
        count: mesh.points.len() as u32,
        light_count: scene.lighting.lights.len() as u32,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    };
    let source = mesh.source(&scene.direct_irradiance(&p, &mesh.points));
    results.exact.push(("first exitance", hash_of_vectors(&source)));
    source
}

/// Form factors of both estimators; those of rays are made reciprocal, and the areas by which they are go with them.
fn make_factors(scene: &Scene, mesh: &PatchMesh, results: &mut Results) -> Result<(Csr, Vec<f32>), Error> {
    let surfaces = mesh.surfaces(scene, 1);
    let ignore_progress = |_, _| ControlFlow::Continue(());
    let rays = Hemisphere { rays: 128 };
    let pairs = AreaToArea { samples: 8, sky_rays: 8 };
    let estimators: [(&str, &dyn Estimator); 2] = [("factors by pairs", &pairs), ("factors by rays", &rays)];
    let mut made = Csr::default();
    for (name, estimator) in estimators {
        let rows = form_factors(estimator, &surfaces, &ignore_progress)?;
        results.exact.push((name, hash_of_numbers(&rows.factors.values)));
        made = rows.factors.to_csr(0.0)?;
    }
    let made = reciprocal(&made, &mesh.areas())?;
    results.exact.push(("reciprocal factors", hash_of_numbers(&made.factors.values)));
    Ok((made.factors, made.area))
}

/// Classic radiosity, and products with counts of hits.
fn solve(factors: &Csr, source: &[Vec4], albedo: &[Vec4], results: &mut Results) -> Result<(), Error> {
    let gathered = jacobi(factors, source, albedo, Stop::Bounces(6))?;
    results.exact.push(("six bounces", hash_of_vectors(&gathered.irradiance)));
    let direct = lu(&factors.to_dense(), source, albedo)?;
    results.rounded.push(("all bounces", mean(&direct.irradiance)));
    let mut counts = HitCounts::new(factors.columns)?;
    let hits: Vec<u32> = (0..64 * factors.rows as u32).map(|k| hash(k) % (factors.columns as u32 + 1)).collect();
    let hits: Vec<u32> = hits.into_iter().map(|k| if k as usize == factors.columns { NONE } else { k }).collect();
    counts.push(&hits, &vec![1.0 / 64.0; factors.rows])?;
    let mut irradiance = vec![Vec4::ZERO; factors.rows];
    counts.apply(source, &mut irradiance)?;
    results.exact.push(("hit counts", hash_of_vectors(&irradiance)));
    Ok(())
}

/// The operator of all bounces, dense and of low rank.
fn multiply(
    factors: &Csr,
    mesh: &PatchMesh,
    area: &[f32],
    source: &[Vec4],
    results: &mut Results,
) -> Result<(), Error> {
    let Csr { row_start, column_index: columns, values, .. } = factors;
    let factors = Factors { row_start, columns, values, area };
    let positions: Vec<Vec3> = mesh.patches.iter().map(|patch| patch.centroid).collect();
    let normals: Vec<Vec3> = mesh.patches.iter().map(|patch| patch.normal).collect();
    let seen: Vec<Vec4> = positions.iter().map(|&position| (Vec3::ONE - position).extend(0.5)).collect();
    let order = halving_order(&positions, &normals, &seen);
    results
        .exact
        .push(("order", hash_of(spatial_order(&positions, &normals, &seen, 4)) ^ hash_of(order.iter().copied())));
    let operator = |channel: usize| {
        let albedo: Vec<f32> = mesh.albedo.iter().map(|albedo| albedo[channel]).collect();
        all_bounces(factors.symmetric()?, &albedo)
    };
    let [red, green, blue] = [operator(0)?, operator(1)?, operator(2)?];
    let tiles = TileSource::Symmetric {
        channels: Channels::Three([&red, &green, &blue]),
        patches: TileSide { area, order: &order },
    };
    let low_rank = LowRank::encode(tiles, 1e-3, &|_, _| ControlFlow::Continue(()))?;
    let mut irradiance = vec![Vec4::ZERO; source.len()];
    low_rank.apply(source, &mut irradiance)?;
    results.rounded.push(("low rank", mean(&irradiance)));
    Ok(())
}

/// The matrix of patches round a camera.
fn follow_camera(
    factors: &Csr,
    mesh: &PatchMesh,
    area: &[f32],
    source: &[Vec4],
    results: &mut Results,
) -> Result<(), Error> {
    let surface = |(patch, (albedo, area)): (&transport::Patch, (&Vec4, &f32))| Surface {
        centre: patch.centroid,
        normal: patch.normal,
        area: *area,
        albedo: albedo.truncate(),
    };
    let surfaces: Vec<Surface> = mesh.patches.iter().zip(mesh.albedo.iter().zip(area)).map(surface).collect();
    let mut table = Table::new(&surfaces, factors.clone())?;
    let order = table.order().to_vec();
    let settings = LocalSettings { slots: surfaces.len().next_multiple_of(4), ..LocalSettings::default() };
    let mut local = Local::new(localmatrix::World::nodes(&table), settings)?;
    let eye = Vec3::new(1.0, 0.5, 0.7);
    local.settle(&mut table, View { eye, predicted: eye }, &|_| true)?;
    let exitance: Vec<Vec4> = order.iter().map(|&patch| source[patch as usize]).collect();
    let mut irradiance = vec![Vec4::ZERO; source.len()];
    local.product(&exitance, &mut irradiance, |_| true)?;
    results.exact.push(("order of a world", hash_of(order)));
    results.rounded.push(("round a camera", mean(&irradiance)));
    Ok(())
}

/// Frames of a few samples a row.
fn sample(factors: &Csr, source: &[Vec4], albedo: &[Vec4], results: &mut Results) -> Result<(), Error> {
    let Csr { columns, row_start, column_index, values, .. } = factors;
    let settings = Settings { control_variate: false, ..Settings::default() };
    for packing in [Packing::Stacks, Packing::Split] {
        let tables = AliasTables::from_rows(*columns, row_start, column_index, values, packing)?;
        let mut state = State::new(source.len());
        for _ in 0..16 {
            state.advance(&tables, source, albedo, &settings)?;
        }
        results.exact.push(("sampled frames", hash_of_vectors(&state.irradiance)));
    }
    Ok(())
}

/// Photons from first-lit surfaces.
fn trace(scene: &Scene, results: &mut Results) -> Result<(), Error> {
    let ignore_progress = |_, _| ControlFlow::Continue(());
    let emission = Emission::first_shot(scene, &LightElementSettings::default(), Texels::Mean, true, &ignore_progress)?;
    let maps = IlluminationMaps::new(scene, 0.5)?;
    let mut tracer = Tracer::new(scene, &emission, &maps, PhotonSettings { error: 0.1, ..PhotonSettings::default() })?;
    tracer.run(&|_| ControlFlow::Continue(()));
    let found = tracer.estimate();
    let words = found.irradiance.iter().flat_map(|h| h.to_array().map(f32::to_bits));
    results.exact.push(("photons", hash_of(words)));
    Ok(())
}
