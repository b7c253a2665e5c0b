//! Rows by rays in three forms: sparse rows, counts of hits, and the light alone; and means of rows.

use glam::{Vec3, Vec4};
use patches::{PatchSize, SubdivideSettings, Subdivision, subdivide};
use patchlight_formfactor::kernel::hemisphere::hemisphere_ray;
use patchlight_formfactor::{
    Error, HemisphereParams, add_hit_rows, add_quadrant_rows, add_traced_rows, gather_by_rays, sparse_rows,
};
use scene::gpu::{Triangle, TriangleUv};
use scene::sampling::{hash3, unit};
use scene::{Material, SKY_BINS, Scene, SceneParts, SurfacePoint, sky_bin};
use transport::{Csr, HitCounts, LinearOperator, Proceed, QUADRANTS, Surfaces, rotational_gradients};

/// A box with an open lid, fronts inside.
fn open_box() -> Scene {
    let wall = |corner: Vec3, a: Vec3, b: Vec3| {
        let half = |corner: Vec3, a: Vec3, b: Vec3| Triangle { corner, edge_a: a, edge_b: b, ..Triangle::default() };
        [half(corner, a, b), half(corner + a + b, -a, -b)]
    };
    let x = Vec3::X;
    let y = Vec3::Y;
    let z = Vec3::Z;
    let walls = [(Vec3::ZERO, z, x), (Vec3::ZERO, x, y), (Vec3::ZERO, y, z), (z, y, x), (x, z, y)];
    let triangles: Vec<Triangle> = walls.into_iter().flat_map(|(c, a, b)| wall(c, a, b)).collect();
    let uvs = vec![TriangleUv::default(); triangles.len()];
    Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() }).unwrap()
}

fn cut(scene: &Scene) -> Subdivision {
    subdivide(scene, &SubdivideSettings { size: PatchSize::Count(300), ..SubdivideSettings::default() }).unwrap()
}

/// Points on the floor.
fn receivers(count: u32) -> (Vec<SurfacePoint>, Vec<u32>) {
    let place = |k: u32| Vec3::new(0.05 + 0.9 * unit(hash3(k, 0, 5)), 0.0, 0.05 + 0.9 * unit(hash3(k, 1, 5)));
    let point = |k| SurfacePoint { position: place(k), patch: k, normal: Vec3::Y, weight: 1.0 };
    ((0..count).map(point).collect(), (0..=count).collect())
}

fn exitance(count: usize) -> Vec<Vec4> {
    (0..count).map(|k| Vec4::new(unit(hash3(k as u32, 0, 3)), unit(hash3(k as u32, 1, 3)), 1.0, 0.0)).collect()
}

fn on(_: usize, _: usize) -> Proceed {
    Proceed::Continue(())
}

fn worst(a: &[Vec4], b: &[Vec4]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max)
}

#[test]
fn three_forms_of_the_same_rows() {
    let scene = open_box();
    let subdivision = cut(&scene);
    let (points, offsets) = receivers(130);
    let surfaces = subdivision.surfaces_to(&scene, &[], &points, &offsets);
    let light = exitance(subdivision.patches.len());
    let rows = sparse_rows(&surfaces, 96, &on).unwrap();
    let mut expected = vec![Vec4::ZERO; points.len()];
    rows.factors.apply(&light, &mut expected).unwrap();

    let mut counts = HitCounts::new(light.len()).unwrap();
    let sky = add_hit_rows(&mut counts, &surfaces, 96, &on).unwrap();
    assert_eq!(sky.len(), points.len());
    assert!(sky.iter().zip(&rows.sky_factor).all(|(a, b)| (a - b).abs() < 1e-5), "the lid is open to the sky");
    assert!(sky.iter().all(|&s| s > 0.0));
    let mut found = vec![Vec4::ZERO; points.len()];
    counts.apply(&light, &mut found).unwrap();
    assert!(worst(&found, &expected) < 1e-5, "{}", worst(&found, &expected));
    let gathered = gather_by_rays(&surfaces, 96, &light, &on).unwrap();
    assert!(worst(&gathered, &expected) < 1e-5, "{}", worst(&gathered, &expected));
    // Rows of another seed are others.
    let other = Surfaces { seed: 1, ..subdivision.surfaces_to(&scene, &[], &points, &offsets) };
    assert!(worst(&gather_by_rays(&other, 96, &light, &on).unwrap(), &expected) > 1e-3);
    // More rows come after those that are there.
    add_hit_rows(&mut counts, &other, 96, &on).unwrap();
    assert_eq!(counts.rows(), 2 * points.len());
    for row in 0..counts.rows() {
        assert!(counts.row(row).iter().map(|c| c.1).sum::<u32>() < 96, "some rays leave through the lid");
    }
}

#[test]
fn rows_traced_by_somebody_else_are_the_same() {
    let scene = open_box();
    let subdivision = cut(&scene);
    let (points, offsets) = receivers(130);
    let surfaces = subdivision.surfaces_to(&scene, &[], &points, &offsets);
    let rays = 96;
    let count = subdivision.patches.len() as u32;
    let params = HemisphereParams { rays, seed: surfaces.seed, ray_offset: surfaces.ray_offset, ..Default::default() };
    let column = |row: usize, k: u32| {
        let (origin, direction) = hemisphere_ray(&params, &offsets, &points, row as u32, k);
        let hit = surfaces.visibility.closest(origin, direction);
        if hit.is_miss() { count } else { (surfaces.owner)(&hit, direction).min(count + 1) }
    };
    let trace = |rows: std::ops::Range<usize>| -> Result<Vec<u32>, Error> {
        Ok(rows.flat_map(|row| (0..rays).map(move |k| (row, k))).map(|(row, k)| column(row, k)).collect())
    };
    let empty = || (HitCounts::new(count as usize).unwrap(), HitCounts::new(SKY_BINS).unwrap());

    let (mut own, _) = empty();
    let sky = add_hit_rows(&mut own, &surfaces, rays, &on).unwrap();
    let (mut rows, _) = empty();
    assert_eq!(add_traced_rows(&mut rows, None, &surfaces, rays, &mut { trace }, &on).unwrap(), sky);
    assert!(rows == own);

    let (mut own, mut own_sky) = empty();
    let sky = add_quadrant_rows(&mut own, (&mut own_sky, &sky_bin), &surfaces, rays, &on).unwrap();
    let (mut rows, mut sky_rows) = empty();
    let bins = Some((&mut sky_rows, &sky_bin as &patchlight_formfactor::SkyBin));
    assert_eq!(add_traced_rows(&mut rows, bins, &surfaces, rays, &mut { trace }, &on).unwrap(), sky);
    assert!(rows == own && sky_rows == own_sky);

    // Rays that are all shifted by one are other rows; what the tracer says comes back.
    let (mut rows, _) = empty();
    let mut shifted = |rows| trace(rows).map(|columns| columns.into_iter().skip(1).chain([0]).collect());
    add_traced_rows(&mut rows, None, &surfaces, rays, &mut shifted, &on).unwrap();
    assert!(rows != own);
    let mut lost = |_| Err(Error::EmptyRow { row: 7 });
    let found = add_traced_rows(&mut rows, None, &surfaces, rays, &mut lost, &on);
    assert_eq!(found, Err(Error::EmptyRow { row: 7 }));
}

#[test]
fn quadrants_add_up_and_rotate_with_the_normal() {
    let scene = open_box();
    let subdivision = cut(&scene);
    let (points, offsets) = receivers(130);
    let surfaces = subdivision.surfaces_to(&scene, &[], &points, &offsets);
    // Brighter towards +x in red.
    let shine = |c: Vec3| Vec4::new(0.2 + c.x, 1.0, 1.0 - c.x, 0.0);
    let light: Vec<Vec4> = subdivision.patches.iter().map(|p| shine(p.centroid)).collect();
    let gathered = gather_by_rays(&surfaces, 4096, &light, &on).unwrap();
    let mut rows = HitCounts::new(light.len()).unwrap();
    let mut sky_rows = HitCounts::new(SKY_BINS).unwrap();
    let sky = add_quadrant_rows(&mut rows, (&mut sky_rows, &sky_bin), &surfaces, 4096, &on).unwrap();
    // Every ray that escapes is in a bin, and the bins above hold them all: the box is open there.
    let even: Vec<Vec4> = (0..SKY_BINS).map(|bin| Vec4::splat(if bin < SKY_BINS / 2 { 1.0 } else { 0.0 })).collect();
    let mut escaped = vec![Vec4::ZERO; sky_rows.rows()];
    sky_rows.apply(&even, &mut escaped).unwrap();
    assert!(escaped.iter().zip(&sky).all(|(found, share)| (found.x - share).abs() < 1e-5));
    assert!(sky.iter().sum::<f32>() > 1.0);
    let shared: u32 = (0..rows.rows()).flat_map(|k| rows.row(k)).map(|entry| entry.1).sum();
    assert!(shared < 4096 * points.len() as u32, "what escapes hits nothing");
    assert_eq!(rows.rows(), QUADRANTS * points.len());
    let mut quadrants = vec![Vec4::ZERO; rows.rows()];
    rows.apply(&light, &mut quadrants).unwrap();
    let sums: Vec<Vec4> = quadrants.chunks(QUADRANTS).map(|q| q.iter().sum()).collect();
    assert!(worst(&sums, &gathered) < 1e-4, "{}", worst(&sums, &gathered));

    // Those in the middle, where light is even over a quadrant, rotated by 17 degrees: what is left of the error of
    // not rotating, and of turning the other way.
    let rotated: Vec<SurfacePoint> =
        points.iter().map(|p| SurfacePoint { normal: (p.normal + 0.3 * Vec3::X).normalize(), ..*p }).collect();
    let truth = gather_by_rays(
        &Surfaces { points: &rotated, ..subdivision.surfaces_to(&scene, &[], &rotated, &offsets) },
        4096,
        &light,
        &on,
    )
    .unwrap();
    let error = |sign: f32| -> f32 {
        let each = points.iter().zip(&rotated).zip(quadrants.chunks(QUADRANTS)).zip(&truth);
        let middle = each.filter(|(((p, _), _), _)| (p.position - Vec3::new(0.5, 0.0, 0.5)).abs().max_element() < 0.2);
        middle
            .map(|(((from, to), quadrants), truth)| {
                let t = rotational_gradients(from.normal).map(|t| 1.0 + sign * t.dot(to.normal - from.normal));
                let found: Vec4 = quadrants.iter().zip(t).map(|(h, t)| *h * t).sum();
                (found - *truth).abs().max_element()
            })
            .sum()
    };
    let right = error(1.0);
    let none = error(0.0);
    let wrong = error(-1.0);
    println!("rotated {right}, not rotated {none}, rotated the wrong way {wrong}");
    assert!(right < 0.5 * none && wrong > 1.5 * none, "{right} {none} {wrong}");
}

#[test]
fn wrong_shapes_and_cancelling_are_errors() {
    let scene = open_box();
    let subdivision = cut(&scene);
    let (points, offsets) = receivers(100);
    let surfaces = subdivision.surfaces_to(&scene, &[], &points, &offsets);
    let light = exitance(subdivision.patches.len());
    let length = |found: Result<(), Error>, wrong: &str| {
        assert!(matches!(found, Err(Error::Shared(transport::Error::Length { name, .. })) if name == wrong), "{wrong}");
    };
    length(gather_by_rays(&surfaces, 16, &light[1..], &on).map(|_| ()), "exitance");
    let mut few = HitCounts::new(light.len() - 1).unwrap();
    length(add_hit_rows(&mut few, &surfaces, 16, &on).map(|_| ()), "columns");
    let stop = |_, _| Proceed::Break(());
    let mut rows = HitCounts::new(light.len()).unwrap();
    assert!(matches!(
        add_hit_rows(&mut rows, &surfaces, 16, &stop),
        Err(Error::Shared(transport::Error::Cancelled { total: 100, .. }))
    ));
    assert_eq!(rows.rows(), 0);
    assert!(matches!(
        gather_by_rays(&surfaces, 16, &light, &stop),
        Err(Error::Shared(transport::Error::Cancelled { .. }))
    ));
}

#[test]
fn means_of_rows_and_sums_of_columns_are_those_of_dense_rows() {
    const RAYS: u32 = 40;
    let columns: Vec<u32> = (0..7 * RAYS).map(|k| hash3(k, 0, 1) % 5).collect();
    let mut rows = HitCounts::new(5).unwrap();
    rows.push(&columns, &[1.0 / RAYS as f32; 7]).unwrap();
    let groups = [0, 1, 4, 4, 7];
    let weights = [1.0, 0.25, 0.5, 0.25, 0.1, 0.2, 0.7];
    let owner = [2, 0, 0, 2, 1];
    let mean = rows.means(&groups, &weights, &owner, 3).unwrap();
    let dense = rows.to_csr().unwrap().to_dense();
    let found = mean.to_dense();
    for (g, range) in groups.windows(2).enumerate() {
        let mut expected = [0.0; 3];
        let own = range[0] as usize..range[1] as usize;
        for (k, weight) in own.clone().zip(&weights[own]) {
            (0..5).for_each(|c| expected[owner[c] as usize] += weight * dense.row(k)[c]);
        }
        for (j, (found, expected)) in found.row(g).iter().zip(expected).enumerate() {
            assert!((found - expected).abs() < 1e-6, "{g} {j}");
        }
    }
    assert_eq!(mean.row_start[2], mean.row_start[3]);
    // Equal weights and other owners give other rows.
    assert_ne!(rows.means(&groups, &[1.0; 7], &owner, 3).unwrap(), mean);
    assert_ne!(rows.means(&groups, &weights, &[0, 0, 0, 2, 1], 3).unwrap(), mean);
    assert!(matches!(
        rows.means(&groups, &weights[1..], &owner, 3),
        Err(transport::Error::Length { name: "weights", .. })
    ));
    assert!(matches!(rows.means(&[0, 3], &weights, &owner, 3), Err(transport::Error::Length { name: "groups", .. })));
    assert!(matches!(
        rows.means(&groups, &weights, &owner[1..], 3),
        Err(transport::Error::Length { name: "owner", .. })
    ));
    assert!(matches!(
        rows.means(&groups, &weights, &owner, 2),
        Err(transport::Error::Value { name: "column_index", .. })
    ));
    assert!(matches!(Csr::from_rows(2, &[vec![(2, 1.0)]]), Err(transport::Error::Value { name: "column_index", .. })));
}
