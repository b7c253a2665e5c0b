//! All receiver sets behind one trait: rows over the same patches, the rectangular product, and the values in use.

use formfactor::{Csr, Hemisphere, Proceed};
use formfactor::{form_factors, normalise_rows};
use glam::{Vec3, Vec4};
use patches::{Density, InterpolationMesh, PatchSize, SubdivideSettings, Subdivision, subdivide};
use patches::{LightmapTexels, VolumeSettings, VolumeSize, VoxelVolume};
use scene::gpu::{Triangle, TriangleUv};
use scene::sampling::{hash3, uniform_triangle, unit};
use scene::{Material, ReceiverSet, Scene, SceneParts, SidePolicy, Sides, SurfacePoint};

/// A closed room of 3 × 2 × 2 m, fronts inwards.
fn room() -> Scene {
    let mut triangles = Vec::new();
    let size = Vec3::new(3.0, 2.0, 2.0);
    let x = Vec3::X * size.x;
    let y = Vec3::Y * size.y;
    let z = Vec3::Z * size.z;
    let low = Vec3::ZERO;
    for (corner, a, b) in [(low, x, y), (low, y, z), (low, z, x), (size, -y, -x), (size, -z, -y), (size, -x, -z)] {
        triangles.push(Triangle { corner, edge_a: a, edge_b: b, ..Triangle::default() });
        triangles.push(Triangle { corner: corner + a + b, edge_a: -a, edge_b: -b, ..Triangle::default() });
    }
    let uvs = vec![TriangleUv::default(); triangles.len()];
    Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() }).unwrap()
}

/// H_r = F_r B at the receivers of any set.
fn gathered(scene: &Scene, subdivision: &Subdivision, set: &dyn ReceiverSet, exitance: &[Vec4]) -> Vec<Vec4> {
    let offsets = set.offsets();
    let surfaces = subdivision.surfaces_to(scene, &[], set.points(), &offsets);
    let mut rows = form_factors(&Hemisphere { rays: 256 }, &surfaces, &|_, _| Proceed::Continue(())).unwrap();
    normalise_rows(&mut rows.factors, &rows.sky_factor).unwrap();
    let rows: Csr = rows.factors.to_csr(0.0).unwrap();
    let row = |i: usize| {
        transport::kernel::product::gather_row_sparse(
            i as u32,
            &rows.row_start,
            &rows.column_index,
            &rows.values,
            exitance,
        )
    };
    (0..set.points().len()).map(row).collect()
}

#[test]
fn every_set_shows_the_same_light() {
    let scene = room();
    let sides = vec![Sides { front: true, back: false }; scene.geometry.triangles.len()];
    let settings = SubdivideSettings { size: PatchSize::Count(200), sides: SidePolicy::Front, ..Default::default() };
    let subdivision = subdivide(&scene, &settings).unwrap();
    let nowhere = |points: &[SurfacePoint], _: u32| Ok(vec![None; points.len()]);
    let mesh =
        InterpolationMesh::new(&scene, &Density::default(), &sides, 0.9, 0.1, |_, _| Some(0.3), nowhere).unwrap();
    let map = LightmapTexels::new(&scene, &sides, 0.3, &|_| true).unwrap();
    let size = VolumeSize::Edge(0.4);
    let volume = VoxelVolume::new(&scene, &VolumeSettings { size, ..VolumeSettings::default() }, &|_| true).unwrap();

    let geometry = scene.tables();
    let places: Vec<(u32, f32, f32)> = (0..300)
        .map(|k| {
            let (u, v) = uniform_triangle((unit(hash3(k, 0, 3)), unit(hash3(k, 1, 3))));
            (k % scene.geometry.triangles.len() as u32, u, v)
        })
        .collect();
    let points: Vec<SurfacePoint> = (places.iter())
        .map(|&(t, u, v)| SurfacePoint {
            position: geometry.position(t, u, v),
            normal: geometry.normal(t),
            weight: 1.0,
            ..SurfacePoint::default()
        })
        .collect();
    // Irradiance at the same places by each set, exact rows of the places first.
    let by_all = |exitance: &[Vec4]| -> Vec<Vec<f32>> {
        let of = |set: &dyn ReceiverSet| gathered(&scene, &subdivision, set, exitance);
        let on_mesh = of(&mesh);
        let on_map = of(&map);
        let in_air = of(&volume);
        let interpolate = |&(t, u, v): &(u32, f32, f32)| {
            let hit = scene::Hit { triangle: t, u, v, t: 1.0 };
            transport::kernel::grid::interpolate_receivers(
                &mesh.grids,
                &mesh.cells,
                &mesh.vertices,
                &on_mesh,
                hit,
                true,
            )
        };
        [
            gathered(&scene, &subdivision, &points, exitance),
            places.iter().map(interpolate).collect(),
            places.iter().map(|&(t, u, v)| map.at(&on_map, t, true, u, v).unwrap()).collect(),
            volume.at_points(&in_air, &points).unwrap(),
        ]
        .map(|values| values.iter().map(|h| h.x).collect())
        .into()
    };
    // In a furnace all are 1, in all sets.
    let furnace = by_all(&vec![Vec4::ONE; subdivision.patches.len()]);
    assert!(furnace.iter().flatten().all(|h| (h - 1.0).abs() < 1e-4));
    // Light from one wall only: sets differ by what lies between their receivers.
    let wall = |p: &formfactor::Patch| Vec4::splat(if p.normal.x > 0.5 { 1.0 } else { 0.0 });
    let uneven = by_all(&subdivision.patches.iter().map(wall).collect::<Vec<_>>());
    let mean = uneven[0].iter().sum::<f32>() / points.len() as f32;
    let errors: Vec<f32> = uneven[1..]
        .iter()
        .map(|values| {
            let errors = values.iter().zip(&uneven[0]).map(|(a, b)| (a - b).abs());
            errors.sum::<f32>() / points.len() as f32 / mean
        })
        .collect();
    println!("mean error of mesh, lightmap, volume: {errors:.3?} of the mean irradiance {mean:.3} W/m²");
    assert!(errors[0] < 0.1 && errors[1] < 0.15 && errors[2] < 0.4, "{errors:?}");
    // The comparison sees a set whose values stand in another order.
    let mut shuffled = uneven[1].clone();
    shuffled.rotate_left(points.len() / 3);
    let error = shuffled.iter().zip(&uneven[0]).map(|(a, b)| (a - b).abs()).sum::<f32>() / points.len() as f32 / mean;
    assert!(error > 0.4, "{error}");
}
