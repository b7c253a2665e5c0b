//! A bake that is refined: levels that come one after the other, and the last as if it were made in one go.

use std::sync::Arc;
use std::time::Duration;

use glam::Vec3;
use patches::PatchKind;
use patchlight::method::{FeedbackSettings, Preparation};
use patchlight::rayon::ThreadPoolBuilder;
use patchlight::refine::levels;
use patchlight::{
    Bake, BakeJob, BakeSettings, Build, Codec, Cpu, Decode, ErrorKind, Estimator, LightField, LightSettings,
    MethodSettings, PictureRenderer, PictureSettings, Point, PointKind, Refinement, SampleLight, Scene, Silent,
};

const METHOD: MethodSettings = MethodSettings::Multibounce(Codec::Dense);

fn scene() -> Scene {
    assets::procedural::build("cornell").unwrap().scene
}

/// Three levels: 1,000, 1,000 and 2,400 patches, and each time four times the receivers.
fn settings() -> BakeSettings {
    BakeSettings::default()
        .with_patch_count(2400)
        .with_estimator(Estimator::Hemisphere { rays: 512 })
        .with_receiver_rays(128)
        .with_receiver_density(0.2)
}

fn refine(scene: &Scene, threads: usize) -> BakeJob {
    let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let refinement = Refinement::default().with_methods(vec![METHOD]).with_pool(Some(Arc::new(pool)));
    Bake::refine(scene, &settings(), refinement).unwrap()
}

/// In one go, with the operator.
fn whole(scene: &Scene) -> Bake {
    let mut bake = Bake::build(scene, &settings(), &Silent).unwrap();
    bake.build_operators(&[METHOD], &Build::default(), &mut Cpu::new(), &Silent).unwrap();
    bake
}

fn are_equal(a: &Bake, b: &Bake) -> bool {
    a.form_factors().factors == b.form_factors().factors
        && a.form_factors().element_rows == b.form_factors().element_rows
        && a.receivers().points == b.receivers().points
        && a.receivers().rows == b.receivers().rows
        && a.receivers().sky_rows == b.receivers().sky_rows
        && a.energy() == b.energy()
        && a.operators() == b.operators()
}

#[test]
fn levels_become_finer_and_end_with_what_was_asked_for() {
    let asked = settings().with_receiver_edge(Some(0.1)).with_most_receivers(Some(1000));
    let all = levels(&asked);
    let counts: Vec<usize> = all.iter().map(|level| level.patch_count).collect();
    assert_eq!(counts, [1000, 1000, 2400]);
    assert_eq!(all.last(), Some(&asked));
    assert_eq!((all[0].receiver_edge, all[1].most_receivers), (Some(0.4), Some(250)));
    assert!(all.windows(2).all(|pair| pair[0].receiver_rays <= pair[1].receiver_rays));
    let receivers = all.iter().map(|level| level.patch_count as f32 * level.receiver_density);
    let shares: Vec<f32> = receivers.map(|count| count / (2400.0 * asked.receiver_density)).collect();
    assert!((shares[0] - 1.0 / 16.0).abs() < 1e-4 && (shares[1] - 0.25).abs() < 1e-4, "{shares:?}");
    // Triangles stay whole, and what is small enough is made at once.
    assert_eq!(levels(&asked.with_patches(PatchKind::Polygon)).len(), 1);
    assert_eq!(levels(&asked.with_patch_count(200)), [asked.with_patch_count(200)]);
}

#[test]
fn a_refined_bake_is_the_one_of_one_go_for_any_threads_and_pauses() {
    let scene = scene();
    let expected = whole(&scene);
    let job = refine(&scene, 3);
    let mut counts = Vec::new();
    let mut shares = Vec::new();
    while !job.is_finished() {
        shares.push(job.progress().share);
        counts.extend(job.take_newest().map(|bake| bake.receivers().points.len()));
        std::thread::sleep(Duration::from_millis(1));
    }
    counts.extend(job.take_newest().map(|bake| bake.receivers().points.len()));
    assert!(counts.windows(2).all(|pair| pair[0] < pair[1]), "{counts:?}");
    assert_eq!(job.progress().levels, 3);
    assert!(shares.windows(2).all(|pair| pair[0] <= pair[1]) && shares[0] < 1.0 && job.progress().share == 1.0);
    assert!(are_equal(&job.join().unwrap(), &expected));

    let job = refine(&scene, 1);
    job.pause();
    while !job.is_finished() {
        job.run_for(Duration::from_millis(20));
    }
    let stopped_often = job.join().unwrap();
    assert!(are_equal(&stopped_often, &expected));
    // A level that is not the last is another bake.
    let coarse = Bake::build(&scene, &levels(&settings())[0], &Silent).unwrap();
    assert!(!are_equal(&coarse, &expected));
}

#[test]
fn light_takes_each_level_between_updates_and_keeps_what_is_its_own() {
    let scene = scene();
    let lighting = scene.lighting.clone();
    let all: Vec<Arc<Bake>> =
        levels(&settings()).iter().map(|level| Arc::new(Bake::build(&scene, level, &Silent).unwrap())).collect();
    let light = LightSettings::default();
    let mut field = LightField::new(Arc::clone(&all[0]), Box::new(Cpu::new()), &light, &Silent).unwrap();
    let (low, high) = scene.geometry.bounds;
    let places = [Point { position: 0.5 * (low + high), normal: Vec3::Y }];
    let set = field.add_points(&places, PointKind::Cube, &Silent).unwrap();
    let mut albedo = vec![None; scene.materials.len()];
    albedo[0] = Some(Vec3::new(0.1, 0.6, 0.2));
    field.set_albedo(&albedo).unwrap();
    field.update(&lighting).unwrap();
    let coarse = field.read(set).unwrap();
    let mut dim = lighting.clone();
    dim.lights.iter_mut().for_each(|light| light.color *= 0.5);
    field.update(&dim).unwrap();

    // The finest, and a light field that had nothing else before.
    field.set_bake(Arc::clone(&all[2]), &Silent).unwrap();
    assert!(Arc::ptr_eq(field.bake(), &all[2]));
    field.update(&lighting).unwrap();
    let mut fresh = LightField::new(Arc::clone(&all[2]), Box::new(Cpu::new()), &light, &Silent).unwrap();
    fresh.set_albedo(&albedo).unwrap();
    let own = fresh.add_points(&places, PointKind::Cube, &Silent).unwrap();
    fresh.update(&lighting).unwrap();
    let expected = fresh.read(own).unwrap();
    assert_eq!(field.read(set).unwrap().values, expected.values);
    assert_ne!(coarse.values, expected.values, "another bake gives another light");
    let buffer = field.buffers().interpolated;
    assert_eq!(field.download(buffer).unwrap(), fresh.download(fresh.buffers().interpolated).unwrap());
}

#[test]
fn light_of_the_callers_samples_is_asked_for_again() {
    let scene = scene();
    let lighting = scene.lighting.clone();
    let all = levels(&settings());
    let bake = |k: usize| Arc::new(Bake::build(&scene, &all[k], &Silent).unwrap());
    let mut field = LightField::new(bake(0), Box::new(Cpu::new()), &LightSettings::default(), &Silent).unwrap();
    let values = vec![Vec3::ONE; field.samples().len()];
    field.set_sample_light(SampleLight::Values(&values)).unwrap();
    field.update(&lighting).unwrap();
    field.set_bake(bake(1), &Silent).unwrap();
    let error = field.update(&lighting).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Input, "{error}");
    let values = vec![Vec3::ONE; field.samples().len()];
    field.set_sample_light(SampleLight::Values(&values)).unwrap();
    field.update(&lighting).unwrap();
}

#[test]
fn pictures_follow_a_job_and_end_as_those_of_the_whole_bake() {
    let scene = scene();
    let lighting = scene.lighting.clone();
    let camera = assets::procedural::build("cornell").unwrap().view.camera(40, 30);
    let light = LightSettings::default().with_method(METHOD);
    let settings = PictureSettings::default().with_size((40, 30)).with_sub_frames(1);
    let job = refine(&scene, 2);
    let first = loop {
        match job.take_newest() {
            Some(bake) => break bake,
            None => std::thread::sleep(Duration::from_millis(1)),
        }
    };
    let mut renderer = PictureRenderer::of_bake(first, Box::new(Cpu::new()), &light, &settings, &Silent).unwrap();
    let coarse = renderer.picture(&lighting, &camera, 0).unwrap().pictures.full;
    loop {
        let is_last = job.is_finished();
        let is_new = renderer.refine(&job, &Silent).unwrap();
        renderer.picture(&lighting, &camera, 0).unwrap();
        if is_last && !is_new {
            break;
        }
    }
    let last = renderer.picture(&lighting, &camera, 0).unwrap().pictures.full;
    let expected = PictureRenderer::of_bake(Arc::new(whole(&scene)), Box::new(Cpu::new()), &light, &settings, &Silent)
        .unwrap()
        .picture(&lighting, &camera, 0)
        .unwrap()
        .pictures
        .full;
    assert!(last.pixels == expected.pixels);
    assert!(coarse.pixels != expected.pixels, "the first level is another picture");
}

#[test]
fn a_method_of_the_callers_own_stays_with_its_bake() {
    let scene = scene();
    let all = levels(&settings());
    let bake = |k: usize| Arc::new(Bake::build(&scene, &all[k], &Silent).unwrap());
    let first = bake(0);
    let mut cpu = Cpu::new();
    let build = Build::default();
    let with = Preparation { bake: &first, decode: Decode::Auto, build: &build, eye: Vec3::ZERO, observer: &Silent };
    let own = MethodSettings::default().prepare(&with, &mut cpu).unwrap();
    let mut field = LightField::with_method(first.clone(), Box::new(cpu), &LightSettings::default(), own).unwrap();
    let error = field.set_bake(bake(1), &Silent).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported, "{error}");
    // With a method of the library it takes any bake.
    field.set_method(MethodSettings::Feedback(FeedbackSettings::default()), &Silent).unwrap();
    field.set_bake(bake(1), &Silent).unwrap();
}
