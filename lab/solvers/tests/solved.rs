//! Every solver as a method of frames: the picture of all bounces.

use std::sync::Arc;

use assets::procedural;
use glam::Vec3;
use patches::PatchKind;
use patchlight::{
    Bake, BakeSettings, Estimator, LightField, LightSettings, Method, Picture, PictureRenderer, PictureSettings, Silent,
};
use runtime::cpu::Cpu;
use solvers::{Links, Samples, Solved, Solver};

/// Relative difference of two pictures, L2.
fn error(ours: &Picture, exact: &Picture) -> f32 {
    let square = |pixels: &mut dyn Iterator<Item = Vec3>| pixels.map(|p| p.length_squared()).sum::<f32>();
    let a = &ours.pixels;
    let b = &exact.pixels;
    (square(&mut a.iter().zip(b).map(|(a, b)| *a - *b)) / square(&mut b.iter().copied())).sqrt()
}

#[test]
fn classic_solvers_render_the_picture_of_all_bounces() {
    let loaded = procedural::build("cornell").unwrap();
    let bake = |patches: PatchKind, bounces: Option<u32>| {
        let settings = BakeSettings::default()
            .with_patches(patches)
            .with_patch_count(200)
            .with_estimator(Estimator::Hemisphere { rays: 1024 })
            .with_bounces(bounces)
            .with_receiver_density(0.3)
            .with_receiver_rays(256)
            .with_seed(3);
        Arc::new(Bake::build(&loaded.scene, &settings, &Silent).unwrap())
    };
    let size = (48, 36);
    let light = LightSettings::default();
    let pictures = PictureSettings::default().with_size(size).with_sub_frames(2);
    let camera = loaded.view.camera(size.0, size.1);
    let indirect =
        |mut renderer: PictureRenderer| renderer.picture(&loaded.scene.lighting, &camera, 0).unwrap().pictures.indirect;
    let classic = |bake: &Arc<Bake>| {
        indirect(PictureRenderer::of_bake(Arc::clone(bake), Box::new(Cpu::new()), &light, &pictures, &Silent).unwrap())
    };
    let solved = |bake: &Arc<Bake>, solver: Solver| {
        let method: Box<dyn Method> = Box::new(Solved::new(solver, bake).unwrap());
        let light = LightField::with_method(Arc::clone(bake), Box::new(Cpu::new()), &light, method).unwrap();
        indirect(PictureRenderer::new(light, &pictures).unwrap())
    };
    let all = bake(PatchKind::Polygon, None);
    let exact = classic(&all);
    let samples = Samples { count: 400_000, seed: 1 };
    for (solver, limit) in [
        (Solver::GaussSeidel, 1e-3),
        (Solver::Lu, 1e-3),
        // Form factors are made reciprocal for these, as those of polygons are already.
        (Solver::Shooting, 1e-3),
        (Solver::StochasticJacobi(samples), 0.01),
        (Solver::RandomWalks(samples), 0.01),
        // Form factors of its own, exact but for shadow rays, in place of hemispheres of rays.
        (Solver::Hierarchical(Links::default()), 0.02),
    ] {
        let error = error(&solved(&all, solver), &exact);
        println!("{}: {error:.2e}", solver.name());
        assert!(error < limit, "{}: {error}", solver.name());
    }
    let three = classic(&bake(PatchKind::Polygon, Some(3)));
    assert!(error(&three, &exact) > 0.02, "three bounces are not all");
    // Links go between outlines, which clusters have none of.
    let clusters = bake(PatchKind::Cluster, None);
    let refused = Solved::new(Solver::Hierarchical(Links::default()), &clusters).err().unwrap().to_string();
    assert!(refused.contains("needs the outlines"), "{refused}");
}
