//! Properties of any scene: agreement of both ways to shoot, sealed rooms, the same bytes, odd triangles, no light.

mod support;

use std::ops::ControlFlow;

use glam::Vec3;
use patchlight_firstshot::{
    Emission, Error, IlluminationMaps, LightElementSettings, MAX_PHOTONS, PhotonAccumulator, PhotonHit, PhotonScene,
    PhotonSettings, Sequences, Subdivision, Texels, Tracer, light_elements, trace_photons,
};
use scene::gpu::Triangle;
use scene::{Light, Scene};
use support::*;

#[test]
fn first_shot_and_classical_photons_agree_for_every_light() {
    let settings = PhotonSettings { batches: 16, ..photons(1 << 20) };
    for light in lights() {
        let scene = room_with_a_window(vec![light]);
        let maps = IlluminationMaps::new(&scene, 0.25).unwrap();
        let classical = trace(&scene, &Emission::classical(&scene).unwrap(), &maps, settings);
        let ours = LightElementSettings::default();
        let ways = [(Texels::Mean, ours), (Texels::Bound, ours), (Texels::Bound, ours.as_printed())];
        for (texels, elements) in ways {
            let emission = Emission::first_shot(&scene, &elements, texels, true, &ignore_progress).unwrap();
            let found = trace(&scene, &emission, &maps, settings);
            let (sigma, all) = deviation(&maps, &found, &classical);
            // Errors from 16 batches make the deviation a little more than 1: t with 30 degrees of freedom.
            assert!(
                sigma < 1.25 && all.abs() < 6e-3,
                "{:?} {texels:?} {:?}: {sigma} {all}",
                light.kind,
                elements.subdivision
            );
            // Photons count for more.
            let gain = classical.error.iter().sum::<f32>() / found.error.iter().sum::<f32>();
            let least = if elements.subdivision == Subdivision::Edges { 1.2 } else { 1.0 };
            assert!(gain > least, "{:?}: {gain}", elements.subdivision);
        }
        // Light of another colour is noticed.
        let mut other = scene.clone();
        other.set_lights(&[Light { color: light.color * 1.03, ..light }]);
        let found = trace(&other, &first_shot(&other), &maps, settings);
        assert!(deviation(&maps, &found, &classical).1 > 0.015);
    }
}

#[test]
fn the_table_alone_is_wrong_where_shadow_rays_are_right() {
    let settings = PhotonSettings { batches: 16, ..photons(1 << 19) };
    let scene = room_with_a_window(vec![lights()[0]]);
    let maps = IlluminationMaps::new(&scene, 0.25).unwrap();
    let coarse = LightElementSettings { depth: 1, longest: 10.0, ..LightElementSettings::default() };
    let run = |exact| {
        let emission = Emission::first_shot(&scene, &coarse, Texels::Mean, exact, &ignore_progress).unwrap();
        trace(&scene, &emission, &maps, settings)
    };
    let truth = trace(&scene, &first_shot(&scene), &maps, settings);
    assert!(deviation(&maps, &run(true), &truth).1.abs() < 0.01);
    assert!(deviation(&maps, &run(false), &truth).1.abs() > 0.03);
}

#[test]
fn nothing_comes_out_of_a_sealed_box() {
    // A box of sheets in the sun, inside of which nothing may arrive.
    let mut triangles = room(Vec3::ZERO, Vec3::ONE, [0; 6]);
    triangles.extend(quad(Vec3::new(-5.0, -0.5, -5.0), Vec3::Z * 11.0, Vec3::X * 11.0, 0));
    let scene = scene(triangles, vec![grey(0.8)], vec![lights()[2]]);
    let maps = IlluminationMaps::new(&scene, 0.5).unwrap();
    let found = trace(&scene, &first_shot(&scene), &maps, photons(1 << 18));
    let mut inside = 0.0f32;
    let mut outside = 0.0f32;
    for t in 0..scene.geometry.triangles.len() as u32 {
        let is_box = scene.tables().position(t, 0.3, 0.3).y > -0.4;
        for (cell, _) in maps.cells(t, false).filter(|_| is_box) {
            inside = inside.max(found.irradiance[cell as usize].max_element());
        }
        for (cell, _) in maps.cells(t, true).filter(|_| is_box) {
            outside = outside.max(found.irradiance[cell as usize].max_element());
        }
    }
    assert!(inside < 1e-4 * outside && outside > 0.1, "{inside} {outside}");
}

#[test]
fn the_same_seed_gives_the_same_bytes_for_any_number_of_threads() {
    let scene = room_with_a_window(lights());
    let maps = IlluminationMaps::new(&scene, 0.1).unwrap();
    let run = |threads, seed| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let emission = first_shot(&scene);
            let found = trace(&scene, &emission, &maps, PhotonSettings { seed, ..photons(1 << 14) });
            let bytes = |v: Vec<Vec3>| v.iter().flat_map(|v| v.to_array().map(f32::to_bits)).collect::<Vec<_>>();
            (emission.elements, bytes(found.irradiance), found.round.error.to_bits())
        })
    };
    let one = run(1, 5);
    assert!(one == run(3, 5) && one == run(2, 5));
    assert!(one.1 != run(2, 6).1);
}

#[test]
fn a_run_in_parts_is_the_run_in_one() {
    let scene = room_with_a_window(lights());
    let maps = IlluminationMaps::new(&scene, 0.1).unwrap();
    let emission = first_shot(&scene);
    let settings = PhotonSettings { error: 0.0, ..photons(1 << 16) };
    let mut whole = Tracer::new(&scene, &emission, &maps, settings).unwrap();
    assert!(whole.run(&|_| ControlFlow::Continue(())));
    // Small rounds towards an error that is out of reach.
    let mut parts = Tracer::new(&scene, &emission, &maps, PhotonSettings { error: 1e-6, ..settings }).unwrap();
    assert!(!parts.run(&|_| ControlFlow::Break(())));
    assert!(parts.round().photons < 1 << 14);
    let mut rounds = 1;
    while !parts.run(&|_| ControlFlow::Break(())) {
        rounds += 1;
    }
    assert!(rounds > 3, "{rounds}");
    // The order of photons is another one, the sums are the same in every bit, colours and errors included.
    let whole = whole.estimate();
    let parts = parts.estimate();
    assert_eq!(whole.irradiance, parts.irradiance);
    assert_eq!((whole.error, whole.round, whole.emitted), (parts.error, parts.round, parts.emitted));
    let other = trace(&scene, &emission, &maps, photons((1 << 16) - 8));
    assert!(other.irradiance != parts.irradiance, "a photon less of each batch is noticed");
}

#[test]
fn sums_are_those_of_the_hits_one_by_one() {
    let scene = room_with_a_window(lights());
    let maps = IlluminationMaps::new(&scene, 0.1).unwrap();
    let emission = first_shot(&scene);
    let tracer = Tracer::new(&scene, &emission, &maps, PhotonSettings::default()).unwrap();
    let p = tracer.params(1 << 9);
    let found = trace(&scene, &emission, &maps, photons(1 << 12));
    let mut cells = vec![glam::DVec3::ZERO; maps.len()];
    let mut segments = 0;
    let mut registered = 0;
    for hit in all_hits(&scene, &emission, &p) {
        segments += 1;
        if hit.triangle != scene::NONE && hit.info & patchlight_firstshot::HIT_INDIRECT != 0 {
            let cell = maps.cell(hit.triangle, hit.u, hit.v, hit.info & patchlight_firstshot::HIT_BACK != 0);
            cells[cell as usize] += hit.flux.as_dvec3();
            registered += 1;
        }
    }
    assert_eq!((found.round.segments, found.round.registered), (segments, registered));
    let mut compared = 0;
    for ((sum, found), &area) in cells.iter().zip(&found.irradiance).zip(maps.areas()) {
        let expected = *sum * (emission.power / f64::from(p.count) / f64::from(area));
        // A hit is rounded by 2⁻²¹ of the mean flux, a few hits a cell; single precision after that.
        let bound = 1e-6 * expected.max_element() + 50.0 * 2f64.powi(-21) * expected.length() / sum.length().max(1.0);
        assert!((found.as_dvec3() - expected).abs().max_element() <= bound, "{found} {expected}");
        compared += u32::from(*sum != glam::DVec3::ZERO);
    }
    assert!(compared > 500, "{compared}");
}

#[test]
fn it_stops_at_the_error_and_the_error_is_true() {
    let scene = room_with_a_window(lights());
    let maps = IlluminationMaps::new(&scene, 0.25).unwrap();
    let emission = first_shot(&scene);
    let truth = trace(&scene, &emission, &maps, PhotonSettings { seed: 1, ..photons(1 << 21) });
    for sequences in [Sequences::Random, Sequences::Sobol] {
        let settings = PhotonSettings { error: 0.05, sequences, ..PhotonSettings::default() };
        let mut tracer = Tracer::new(&scene, &emission, &maps, settings).unwrap();
        assert!(tracer.run(&|_| ControlFlow::Continue(())));
        let found = tracer.estimate();
        assert!(found.round.error <= 0.05 && found.round.error > 0.035, "{:?}", found.round);
        let mut wrong = 0.0;
        let mut light = 0.0;
        for (k, area) in maps.areas().iter().enumerate() {
            let of = |e: &patchlight_firstshot::Estimate| scene::math::luminance(e.irradiance[k]);
            wrong += area * (of(&found) - of(&truth)).powi(2);
            light += area * of(&truth).powi(2);
        }
        let error = f64::from(wrong / light).sqrt();
        assert!((error / found.round.error - 1.0).abs() < 0.35, "{error} {}", found.round.error);
    }
}

#[test]
fn sobol_points_need_fewer_photons() {
    let error = |scene: &Scene, emission: &Emission, sequences| {
        let maps = IlluminationMaps::new(scene, 1.0).unwrap();
        let settings = PhotonSettings { sequences, batches: 16, with_direct: true, ..photons(1 << 17) };
        trace(scene, emission, &maps, settings).round.error
    };
    // Light straight from a lamp has two dimensions, that of many elements over several reflections has many.
    let black = scene(room(Vec3::ZERO, Vec3::ONE, [0; 6]), vec![grey(0.0)], vec![lights()[0]]);
    let lamp = Emission::classical(&black).unwrap();
    let both = [Sequences::Sobol, Sequences::Random].map(|s| error(&black, &lamp, s));
    assert!(both[0] < 0.4 * both[1], "{both:?}");
    let room = room_with_a_window(vec![lights()[0]]);
    let shot = first_shot(&room);
    let both = [Sequences::Sobol, Sequences::Random].map(|s| error(&room, &shot, s));
    assert!(both[0] < both[1], "{both:?}");
}

#[test]
fn odd_triangles_are_no_trouble() {
    let mut triangles = room(Vec3::ZERO, Vec3::ONE, [0; 6]);
    let middle = Vec3::splat(0.4);
    let odd = |edge_a: Vec3, edge_b: Vec3| Triangle { corner: middle, edge_a, edge_b, ..Triangle::default() };
    triangles.extend([
        odd(Vec3::ZERO, Vec3::ZERO),
        odd(Vec3::X * 0.1, Vec3::X * 0.2),
        odd(Vec3::X * 1e-12, Vec3::Y * 1e-12),
        odd(Vec3::X * 1e-24, Vec3::Y * 1e-24),
        odd(Vec3::X * 0.5, Vec3::new(0.25, 0.0, 1e-7)),
    ]);
    let scene = scene(triangles, vec![grey(0.5)], lights());
    let maps = IlluminationMaps::new(&scene, 0.2).unwrap();
    for emission in [first_shot(&scene), Emission::classical(&scene).unwrap()] {
        assert!(emission.power.is_finite() && emission.elements.iter().all(|e| e.scale.is_finite()));
        let found = trace(&scene, &emission, &maps, photons(1 << 15));
        assert!(found.irradiance.iter().all(|h| h.is_finite()) && found.round.registered > 1000);
        assert!(found.emitted.is_finite() && found.emitted.min_element() > 0.0);
        let corners = maps.corner_irradiance(&scene, &found.irradiance).unwrap();
        assert!(corners.iter().flatten().flatten().all(|h| h.is_finite()));
    }
}

#[test]
fn without_light_or_reflectance_all_is_dark() {
    let dark = scene(room(Vec3::ZERO, Vec3::ONE, [0; 6]), vec![grey(0.5)], Vec::new());
    let black = scene(room(Vec3::ZERO, Vec3::ONE, [0; 6]), vec![grey(0.0)], lights());
    for scene in [&dark, &black] {
        let maps = IlluminationMaps::new(scene, 0.5).unwrap();
        let emission = first_shot(scene);
        assert!(emission.is_dark() && emission.power == 0.0);
        let found = trace(scene, &emission, &maps, photons(1 << 12));
        assert!(found.irradiance.iter().all(|h| *h == Vec3::ZERO) && found.round.photons == 0);
    }
    let found = {
        let maps = IlluminationMaps::new(&black, 0.5).unwrap();
        trace(&black, &Emission::classical(&black).unwrap(), &maps, photons(1 << 12))
    };
    assert!(found.irradiance.iter().all(|h| *h == Vec3::ZERO) && found.emitted.x > 0.0);
}

/// Every hit of a dispatch.
fn all_hits(scene: &Scene, emission: &Emission, p: &patchlight_firstshot::PhotonParams) -> Vec<PhotonHit> {
    let see = |hits: &mut Vec<PhotonHit>, hit: &PhotonHit| hits.push(*hit);
    trace_photons(&PhotonScene::new(scene, emission), p, Vec::new, see).concat()
}

#[test]
fn holes_let_photons_through_and_send_none() {
    let scene = room_with_a_window(lights());
    let emission = first_shot(&scene);
    let maps = IlluminationMaps::new(&scene, 1.0).unwrap();
    let tracer = Tracer::new(&scene, &emission, &maps, PhotonSettings::default()).unwrap();
    let p = tracer.params(1 << 10);
    let hits = all_hits(&scene, &emission, &p);
    let geometry = scene.tables();
    assert!(hits.iter().filter(|l| l.triangle != scene::NONE).all(|l| !geometry.is_hole(l.triangle, l.u, l.v)));
    let on_board = |l: &&PhotonHit| {
        l.triangle != scene::NONE && geometry.position(l.triangle, l.u, l.v).cmpgt(Vec3::splat(0.15)).all()
    };
    assert!(hits.iter().filter(on_board).count() > 10);
    // Exactly one first photon hit for each photon that there is, at the same place again.
    let firsts = hits.iter().filter(|l| l.info & patchlight_firstshot::HIT_FIRST != 0).count();
    assert!(firsts <= p.count as usize && firsts > p.count as usize / 2);
    assert_eq!(hits, all_hits(&scene, &emission, &p));
}

#[test]
fn a_constant_stays_at_the_corners_and_cells_are_where_they_say() {
    let scene = room_with_a_window(Vec::new());
    let maps = IlluminationMaps::new(&scene, 0.15).unwrap();
    let corners = maps.corner_irradiance(&scene, &vec![Vec3::splat(0.7); maps.len()]).unwrap();
    assert!(corners.iter().flatten().flatten().all(|h| (*h - 0.7).abs().max_element() < 1e-5));
    let mut next = 0;
    for t in 0..scene.geometry.triangles.len() as u32 {
        for is_back in [false, true] {
            for (cell, [a, b, c]) in maps.cells(t, is_back) {
                assert_eq!(cell, next);
                next += 1;
                let middle = (a + b + c) / 3.0;
                assert_eq!(maps.cell(t, middle.x, middle.y, is_back), cell);
                assert_eq!(maps.cell(t, middle.x * 0.99 + a.x * 0.01, middle.y * 0.99 + a.y * 0.01, is_back), cell);
            }
        }
    }
    assert_eq!(next as usize, maps.len());
    for (u, v) in [(1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (1.1, -0.1), (f32::NAN, 0.3)] {
        assert!((maps.cell(0, u, v, true) as usize) < maps.len());
    }
}

#[test]
fn bad_settings_are_refused() {
    let scene = room_with_a_window(lights());
    let maps = IlluminationMaps::new(&scene, 1.0).unwrap();
    let setting = |name: &'static str| move |e: &Error| matches!(e, Error::Setting { name: n, .. } if *n == name);
    let refused = |settings: LightElementSettings| light_elements(&scene, &settings, &ignore_progress).unwrap_err();
    assert!(setting("tolerance")(&refused(LightElementSettings { tolerance: 0.0, ..LightElementSettings::default() })));
    assert!(setting("longest")(&refused(LightElementSettings {
        longest: f32::NAN,
        ..LightElementSettings::default()
    })));
    assert!(setting("elements")(&refused(LightElementSettings { elements: 0, ..LightElementSettings::default() })));
    assert!(setting("neighbours")(&refused(LightElementSettings { neighbours: 0, ..LightElementSettings::default() })));
    assert!(setting("edge")(&IlluminationMaps::new(&scene, -1.0).unwrap_err()));
    let room = self::scene(room(Vec3::ZERO, Vec3::ONE, [0; 6]), vec![grey(0.5)], Vec::new());
    assert!(matches!(IlluminationMaps::with_divisions(&room, &[1 << 12; 12]), Err(Error::TooMany { .. })));

    let emission = first_shot(&scene);
    let refused = |s: PhotonSettings| Tracer::new(&scene, &emission, &maps, s).err().unwrap();
    assert!(setting("batches")(&refused(PhotonSettings { batches: 1, ..PhotonSettings::default() })));
    assert!(setting("error")(&refused(PhotonSettings { error: f64::NAN, ..PhotonSettings::default() })));
    assert!(setting("most_photons")(&refused(photons(0))));
    assert!(matches!(refused(photons(MAX_PHOTONS + 1)), Error::TooMany { name: "photons", .. }));
    assert!(Tracer::new(&scene, &emission, &maps, photons(MAX_PHOTONS)).is_ok());
    let stopped = light_elements(&scene, &LightElementSettings::default(), &|_, _| ControlFlow::Break(()));
    assert!(matches!(stopped, Err(Error::Cancelled { .. })));
    assert!(matches!(maps.corner_irradiance(&scene, &[]), Err(Error::Length { .. })));
}
