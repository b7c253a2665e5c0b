//! Properties of any scene: reciprocity, closure, furnace, energy, invariance, the same bytes for any thread count.

use std::ops::ControlFlow;

use glam::{Quat, Vec3, Vec4};
use patches::{
    Density, PatchSize, SubdivideSettings, Subdivision, divisions_for_area, divisions_for_count,
    divisions_for_gradient, subdivide,
};
use patchlight_formfactor::*;
use proptest::prelude::*;
use scene::gpu::{Triangle, TriangleUv};
use scene::sampling::{hash3, unit};
use scene::{Material, Scene, SceneParts, SidePolicy, SurfacePoint, find_sides};
use transport::LinearOperator as _;

/// The inside of a box, scaled, turned and moved, with a lid or without, and a tilted sheet in it that both sides see.
fn room(scale: f32, rotation: Quat, lid: bool) -> Scene {
    let size = Vec3::new(2.0, 1.5, 1.0);
    let place = |p: Vec3| rotation * ((p - 0.5 * size) * scale);
    let mut triangles = Vec::new();
    let mut quad = |p: Vec3, a: Vec3, b: Vec3| {
        let o = place(p);
        let a1 = place(p + a) - place(p);
        let b1 = place(p + b) - place(p);
        triangles.push(Triangle { corner: o, edge_a: a1, edge_b: b1, ..Triangle::default() });
        triangles.push(Triangle { corner: o + a1 + b1, edge_a: -a1, edge_b: -b1, ..Triangle::default() });
    };
    let x = Vec3::X * size.x;
    let y = Vec3::Y * size.y;
    let z = Vec3::Z * size.z;
    quad(Vec3::ZERO, x, y);
    quad(Vec3::ZERO, y, z);
    quad(Vec3::ZERO, z, x);
    quad(x, z, y);
    quad(y, x, z);
    if lid {
        quad(z, y, x);
    }
    quad(Vec3::new(0.6, 0.4, 0.3), Vec3::new(0.5, 0.1, 0.2), Vec3::new(-0.1, 0.6, 0.1));
    let uvs = vec![TriangleUv::default(); triangles.len()];
    Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() }).unwrap()
}

fn go(_: usize, _: usize) -> Proceed {
    ControlFlow::Continue(())
}

struct Solved {
    area: Vec<f32>,
    rows: FactorRows,
    report: Balance,
}

/// Balanced form factors of a scene with about `count` patches on the inside.
fn factors(scene: &Scene, count: u32, rays: u32) -> Solved {
    // A closed room is dark for SidePolicy::Lit; fronts face inwards, the sheet has two sides.
    let mut sides = find_sides(scene, SidePolicy::Front);
    for (side, t) in sides.iter_mut().zip(&scene.geometry.triangles) {
        side.back = 0.5 * t.edge_a.cross(t.edge_b).length() < 0.2 * scene.diagonal().powi(2) / 7.25;
    }
    let divisions = divisions_for_count(scene, &sides, &Density::default(), count).unwrap();
    let cut = Subdivision::new(scene, &sides, &divisions, 16, 1).unwrap();
    let surfaces = cut.surfaces(scene, &[]);
    let mut rows = form_factors(&Hemisphere { rays }, &surfaces, &go).unwrap();
    let area = cut.areas();
    let report = balance(&mut rows.factors, &mut rows.sky_factor, &area, None).unwrap();
    Solved { area, rows, report }
}

#[test]
fn balance_gives_reciprocity_and_closure() {
    for lid in [true, false] {
        let s = factors(&room(1.0, Quat::IDENTITY, lid), 400, 1024);
        println!("lid {lid}: {:?}", s.report);
        assert!(s.report.reciprocity <= 1e-5 && s.report.closure <= 1e-5);
        assert!(s.report.reciprocity_before > 1e-3, "nothing was there to balance");
        assert_eq!(s.rows.sky_factor.iter().any(|&f| f > 0.1), !lid);
        // One changed factor is noticed.
        let mut changed = s.rows.factors.clone();
        changed.values[5] += 1e-3;
        assert!(closure_residual(&changed, &s.rows.sky_factor) > 1e-5);
        assert!(reciprocity_residual(&changed, &s.area) > 1e-5);
    }
}

#[test]
fn white_furnace() {
    let s = factors(&room(1.0, Quat::IDENTITY, true), 300, 1024);
    let n = s.area.len();
    let emission = Vec4::new(1.0, 2.0, 3.0, 0.0);
    let albedo = Vec4::new(0.2, 0.5, 0.9, 0.0);
    let check = |rho: Vec4| {
        let light = jacobi(&s.rows.factors, &vec![emission; n], &vec![rho; n], Stop::Tolerance(1e-7)).unwrap();
        (0..n).flat_map(|i| (0..3).map(move |c| (i, c))).all(|(i, c)| {
            let expected = emission[c] / (1.0 - albedo[c]);
            (light.irradiance[i][c] / expected - 1.0).abs() <= 0.01
        })
    };
    assert!(check(albedo));
    assert!(!check(albedo * 0.99));
}

#[test]
fn energy_is_absorbed_or_escapes() {
    let s = factors(&room(1.0, Quat::IDENTITY, false), 400, 1024);
    let n = s.area.len();
    let albedo: Vec<Vec4> = (0..n as u32).map(|i| Vec4::splat(0.9 * unit(hash3(i, 1, 1)))).collect();
    let source: Vec<Vec4> = (0..n).map(|i| if i % 9 == 0 { Vec4::ONE } else { Vec4::ZERO }).collect();
    let light = jacobi(&s.rows.factors, &source, &albedo, Stop::Tolerance(1e-7)).unwrap();
    let spent = |sky: &[f32]| {
        let mut emitted = 0.0f64;
        let mut spent = 0.0f64;
        for i in 0..n {
            let a = f64::from(s.area[i]);
            emitted += a * f64::from(source[i].x);
            spent += a * f64::from(light.irradiance[i].x * (1.0 - albedo[i].x) + light.exitance[i].x * sky[i]);
        }
        spent / emitted - 1.0
    };
    assert!(spent(&s.rows.sky_factor).abs() <= 1e-3);
    let wrong: Vec<f32> = s.rows.sky_factor.iter().map(|f| 0.97 * f).collect();
    assert!(spent(&wrong).abs() > 1e-3);
}

#[test]
fn solvers_agree() {
    let s = factors(&room(1.0, Quat::IDENTITY, false), 250, 512);
    let n = s.area.len();
    let albedo: Vec<Vec4> = (0..n as u32).map(|i| Vec4::new(0.9 * unit(hash3(i, 1, 1)), 0.5, 0.8, 0.0)).collect();
    let source: Vec<Vec4> = (0..n).map(|i| Vec4::splat(f32::from(i % 11 == 0))).collect();
    let f = &s.rows.factors;
    let exact = lu(f, &source, &albedo).unwrap();
    let stop = Stop::Tolerance(1e-6);
    let others = [
        ("jacobi", jacobi(f, &source, &albedo, stop).unwrap()),
        ("gauss_seidel", gauss_seidel(f, &source, &albedo, stop).unwrap()),
        ("shoot", shoot(f, &s.area, &source, &albedo, Stop::Tolerance(1e-7)).unwrap()),
    ];
    let scale = exact.irradiance.iter().map(|h| h.max_element()).fold(0.0, f32::max);
    let difference = |a: &Solution| {
        a.irradiance.iter().zip(&exact.irradiance).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max)
            / scale
    };
    println!("lu: residual {:.1e}", exact.residual);
    for (name, solution) in &others {
        let d = difference(solution);
        println!("{name}: {} steps, residual {:.1e}, {d:.1e} from LU", solution.iterations, solution.residual);
        assert!(d < 1e-4 && solution.residual < 1e-4);
    }
    assert!(exact.residual < 1e-5);
    assert!(difference(&jacobi(f, &source, &albedo, Stop::Bounces(2)).unwrap()) > 1e-3, "two bounces are not all");
    // K bounces are K products.
    let two = jacobi(f, &source, &albedo, Stop::Bounces(2)).unwrap();
    let mut h = vec![Vec4::ZERO; n];
    let mut b = source.clone();
    for _ in 0..2 {
        f.apply(&b, &mut h).unwrap();
        b = (0..n).map(|i| source[i] + albedo[i] * h[i]).collect();
    }
    assert!(two.irradiance.iter().zip(&h).all(|(a, b)| (*a - *b).truncate().abs().max_element() < 1e-6));
}

#[test]
fn same_bytes_for_any_thread_count() {
    let scene = room(1.0, Quat::IDENTITY, false);
    let run = |threads: usize, seed: u32| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let settings = SubdivideSettings { size: PatchSize::Count(120), seed, ..SubdivideSettings::default() };
            let cut = subdivide(&scene, &settings).unwrap();
            let polygons = cut.polygons().unwrap();
            let surfaces = cut.surfaces(&scene, &polygons);
            let estimators: [&dyn Estimator; 4] = [
                &Hemisphere { rays: 256 },
                &AreaToArea { samples: 64, sky_rays: 32 },
                &PointToPoint { sky_rays: 32 },
                &Contour { shadow_rays: 4, sky_rays: 32 },
            ];
            let mut all = Vec::new();
            for e in estimators {
                let mut rows = form_factors(e, &surfaces, &go).unwrap();
                normalise_rows(&mut rows.factors, &rows.sky_factor).unwrap();
                balance(&mut rows.factors, &mut rows.sky_factor, &cut.areas(), None).unwrap();
                let b: Vec<Vec4> = (0..cut.patches.len()).map(|i| Vec4::splat(unit(hash3(i as u32, 0, 0)))).collect();
                let light = jacobi(&rows.factors, &b, &vec![Vec4::splat(0.5); b.len()], Stop::Bounces(3)).unwrap();
                all.push((rows, light));
            }
            all
        })
    };
    let one = run(1, 0);
    assert!(one == run(2, 0), "two threads give other bytes than one");
    assert!(one != run(1, 1), "another seed must give another result");
}

#[test]
fn points_by_hand() {
    // Two points that face each other 2 m apart, the other turned by 60°: s cos 0° cos 60° / (π r² + s).
    let patches =
        [Patch { centroid: Vec3::Y * 2.0, area: 0.5, normal: Vec3::new(0.75f32.sqrt(), -0.5, 0.0), triangle: 0 }];
    let points = [SurfacePoint { position: Vec3::ZERO, patch: 0, normal: Vec3::Y, weight: 1.0 }];
    let scene = |blocked: bool| {
        let height = if blocked { 1.0 } else { 3.0 };
        let corner = Vec3::new(-1.0, height, -1.0);
        let triangle = Triangle { corner, edge_a: Vec3::X * 9.0, edge_b: Vec3::Z * 9.0, ..Triangle::default() };
        let triangles = vec![triangle];
        let uvs = vec![TriangleUv::default()];
        Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..<_>::default() }).unwrap()
    };
    let factor = |blocked: bool| {
        let scene = scene(blocked);
        let surfaces = Surfaces {
            patches: &patches,
            polygons: &[],
            row_polygons: &[],
            points: &points,
            offsets: &[0, 1],
            visibility: &scene,
            owner: Box::new(|_, _| scene::NONE),
            ray_offset: 1e-4,
            seed: 0,
        };
        form_factors(&PointToPoint { sky_rays: 1 }, &surfaces, &go).unwrap().factors.values[0]
    };
    let pi = core::f32::consts::PI;
    assert!((factor(false) - 0.5 * 0.5 / (pi * 4.0 + 0.5)).abs() < 1e-6);
    assert!((factor(false) - 0.5 * 0.5 / (pi * 4.0)).abs() > 1e-4, "without the disc");
    assert_eq!(factor(true), 0.0);
}

#[test]
fn estimators_agree_with_occlusion() {
    let scene = room(1.0, Quat::IDENTITY, false);
    let settings = SubdivideSettings { size: PatchSize::Count(60), points: 256, ..SubdivideSettings::default() };
    let cut = subdivide(&scene, &settings).unwrap();
    let polygons = cut.polygons().unwrap();
    let surfaces = cut.surfaces(&scene, &polygons);
    let rays = form_factors(&Hemisphere { rays: 1 << 15 }, &surfaces, &go).unwrap();
    let worst = |rows: &FactorRows| {
        rows.factors.values.iter().zip(&rays.factors.values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    let area = form_factors(&AreaToArea { samples: 2048, sky_rays: 64 }, &surfaces, &go).unwrap();
    let contour = form_factors(&Contour { shadow_rays: 1024, sky_rays: 64 }, &surfaces, &go).unwrap();
    let points = form_factors(&PointToPoint { sky_rays: 64 }, &surfaces, &go).unwrap();
    println!("from rays: area {:.4}, contour {:.4}, points {:.4}", worst(&area), worst(&contour), worst(&points));
    assert!(worst(&area) < 0.01 && worst(&contour) < 0.01 && worst(&points) < 0.15);
    // Without the sheet's shadow they do not agree.
    struct Clear;
    impl scene::Visibility for Clear {
        fn any_hit(&self, _: Vec3, _: Vec3) -> bool {
            false
        }
        fn closest(&self, _: Vec3, _: Vec3) -> scene::Hit {
            scene::Hit::MISS
        }
    }
    let unshadowed = Surfaces { visibility: &Clear, ..cut.surfaces(&scene, &polygons) };
    let clear = worst(&form_factors(&Contour::default(), &unshadowed, &go).unwrap());
    assert!(clear > 0.012, "{clear}");
}

#[test]
fn sides_nobody_sees_and_dark_insides_have_no_patches() {
    // Open room: insides and the sheet, not the outsides. Closed and without a light: nothing at all.
    let open = room(1.0, Quat::IDENTITY, false);
    let sides = find_sides(&open, SidePolicy::Lit);
    assert!(sides.iter().all(|s| s.front));
    assert_eq!(sides.iter().filter(|s| s.back).count(), 2);
    let closed = find_sides(&room(1.0, Quat::IDENTITY, true), SidePolicy::Lit);
    assert!(closed.iter().all(|s| !s.front && !s.back));
    // Adaptive: cells are halved only where the estimate bends.
    let steep = divisions_for_gradient(&open, &sides, 1.0, 0.01, 0.1, |p| 4.0 * p.position.x * p.position.x).unwrap();
    let flat = divisions_for_gradient(&open, &sides, 1.0, 0.01, 0.1, |_| 1.0).unwrap();
    assert!(steep.iter().zip(&flat).any(|(s, f)| s > f) && flat == divisions_for_area(&open, 1.0).unwrap());
}

/// A large patch that sees only a small one, as beneath what stands on it: no scaling that keeps reciprocity closes it.
#[test]
fn rows_that_cannot_be_closed_stay_finite() {
    let closed = |area: [f32; 3]| {
        // The first sees only the second; the others see each other, too.
        let mut factors = Dense { rows: 3, columns: 3, values: vec![0.0, 1.0, 0.0, 0.5, 0.0, 0.5, 0.0, 1.0, 0.0] };
        let mut sky = [0.0; 3];
        let report = balance(&mut factors, &mut sky, &area, None).unwrap();
        assert!(factors.values.iter().all(|f| f.is_finite()) && report.reciprocity < 1e-5, "{area:?}: {factors:?}");
        let sums = [0, 1, 2].map(|i| factors.row(i).iter().sum::<f32>());
        assert!(sums.iter().all(|sum| *sum < 1.001), "{area:?}: {sums:?}");
        sums
    };
    let sums = closed([1e6, 1.0, 1.0]);
    assert!(sums[0] < 1e-4, "the large patch cannot send more than the small one receives: {sums:?}");
    assert!((sums[1] - 1.0).abs() < 1e-3, "the small one is closed: {sums:?}");
    let sums = closed([1.0, 2.0, 1.0]);
    assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-4), "what can be closed is: {sums:?}");
}

#[test]
fn cancelling_and_bad_input_give_typed_errors() {
    let scene = room(1.0, Quat::IDENTITY, false);
    let cut = subdivide(&scene, &SubdivideSettings { size: PatchSize::Count(50), ..Default::default() }).unwrap();
    let surfaces = cut.surfaces(&scene, &[]);
    let stop = |done: usize, _: usize| if done >= 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let rays = Hemisphere { rays: 16 };
    assert!(matches!(form_factors(&rays, &surfaces, &stop), Err(Error::Shared(transport::Error::Cancelled { .. }))));
    assert!(matches!(form_factors(&Contour::default(), &surfaces, &go), Err(Error::NoOutlines { .. })));
    assert!(matches!(
        form_factors(&Hemisphere { rays: 0 }, &surfaces, &go),
        Err(Error::Shared(transport::Error::Setting { name: "rays", .. }))
    ));
    assert!(matches!(
        divisions_for_area(&scene, f32::NAN),
        Err(patches::Error::Shared(transport::Error::Setting { name: "area", .. }))
    ));
    let mut bad = Dense::zeros(2, 2);
    bad.values[3] = f32::NAN;
    let found = balance(&mut bad, &mut [0.0; 2], &[1.0; 2], None);
    assert!(matches!(found, Err(Error::Shared(transport::Error::Value { name: "factors", index: 3, .. }))));
    // Blocks give the rows of the whole.
    let whole = form_factors(&rays, &surfaces, &go).unwrap();
    let mut values = Vec::new();
    form_factor_blocks(&rays, &surfaces, 7, &go, |first, block| {
        assert_eq!(first * cut.patches.len(), values.len());
        values.extend(block.factors.values);
        Ok(())
    })
    .unwrap();
    assert_eq!(values, whole.factors.values);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, failure_persistence: None, ..ProptestConfig::default() })]

    /// Size and attitude change nothing but rounding and where samples fall.
    #[test]
    fn scale_and_rotation_do_not_matter(
        exponent in -2.0f32..3.0, x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0, angle in 0.0f32..6.0,
    ) {
        let axis = Vec3::new(x, y, z + 2.0).normalize();
        let row_mean = |scene: &Scene| {
            let s = factors(scene, 60, 8192);
            let n = s.area.len();
            let total: f32 = s.area.iter().sum();
            let source = vec![Vec4::ONE; n];
            let light = jacobi(&s.rows.factors, &source, &vec![Vec4::splat(0.5); n], Stop::Tolerance(1e-6)).unwrap();
            let sky: f32 = s.rows.sky_factor.iter().zip(&s.area).map(|(f, a)| f * a / total).sum();
            let h: f32 = light.irradiance.iter().zip(&s.area).map(|(h, a)| h.x * a / total).sum();
            (sky, h)
        };
        let plain = row_mean(&room(1.0, Quat::IDENTITY, false));
        let other = row_mean(&room(scene::math::pow(10.0, exponent), Quat::from_axis_angle(axis, angle), false));
        prop_assert!((plain.0 / other.0 - 1.0).abs() < 1e-2, "sky {} {}", plain.0, other.0);
        prop_assert!((plain.1 / other.1 - 1.0).abs() < 1e-2, "light {} {}", plain.1, other.1);
    }
}
