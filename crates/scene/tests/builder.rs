//! Scenes put together in memory: closed forms of lights in every unit, orientation, textures, and what is refused.

use std::f32::consts::PI;

use glam::{Affine3A, Quat, Vec2, Vec3};
use patchlight_scene::gpu::DirectParams;
use patchlight_scene::math::luminance;
use patchlight_scene::{
    BuildError, Distribution, Flux, Intensity, Irradiance, LUMENS_PER_WATT, Light, Material, MaterialId, Mesh,
    MeshFault, Radiance, Scene, SceneBuilder, SurfacePoint,
};

/// A square round the origin that faces up, with these half edges.
fn square(half: f32) -> [Vec3; 4] {
    [Vec3::new(-half, 0.0, -half), Vec3::new(-half, 0.0, half), Vec3::new(half, 0.0, half), Vec3::new(half, 0.0, -half)]
}

const SIDES: [u32; 6] = [0, 1, 2, 0, 2, 3];

fn with_floor() -> SceneBuilder {
    let mut builder = Scene::builder();
    builder.add_mesh(Mesh { name: "floor", positions: &square(5.0), indices: &SIDES, ..Mesh::default() });
    builder
}

/// Illuminance of an upward place, lx.
fn lux(scene: &Scene, position: Vec3) -> f32 {
    let params = DirectParams {
        count: 1,
        area_rays: 4096,
        light_count: scene.lighting.lights.len() as u32,
        emitter_count: scene.emitters.len() as u32,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    };
    let point = SurfacePoint { position, normal: Vec3::Y, weight: 1.0, ..SurfacePoint::default() };
    luminance(scene.direct_irradiance(&params, &[point])[0]) * LUMENS_PER_WATT
}

fn near(found: f32, expected: f32) -> bool {
    (found / expected - 1.0).abs() < 2e-3
}

#[test]
fn lights_in_every_unit_give_what_their_units_say() {
    let floor = |light: Light| {
        let mut builder = with_floor();
        builder.add_light(light);
        lux(&builder.build().unwrap(), Vec3::ZERO)
    };
    let above = Vec3::Y * 2.0;
    // 800 lm from a point: Φ / 4π over r².
    assert!(near(floor(Light::point(above, Flux::lumens(800.0))), 800.0 / (4.0 * PI) / 4.0));
    assert!(near(floor(Light::point(above, Intensity::candela(100.0))), 25.0));
    assert!(!near(floor(Light::point(above, Intensity::candela(101.0))), 25.0));
    // A sun at 60° from the zenith.
    let sun = Light::sun(Vec3::new(3f32.sqrt(), -1.0, 0.0) * 7.0, Irradiance::lux(50_000.0));
    assert!(near(floor(sun), 25_000.0));
    // A spot straight down: full within its inner angle.
    assert!(near(floor(Light::spot(above, -Vec3::Y, (0.3, 0.5), Intensity::candela(400.0))), 100.0));
    let aside = Light::spot(above, Vec3::new(1.0, -1.0, 0.0), (0.3, 0.5), Intensity::candela(400.0));
    assert_eq!(floor(aside), 0.0);
    // A small panel that faces down is nearly a point of intensity L A; its flux is π L A.
    let edges = (Vec3::X * 0.1, Vec3::Z * 0.1);
    let corner = above - 0.5 * (edges.0 + edges.1);
    let by_radiance = floor(Light::rectangle(corner, edges, Radiance::nits(10_000.0)));
    assert!((by_radiance / (10_000.0 * 0.01 / 4.0) - 1.0).abs() < 0.01, "{by_radiance}");
    let by_flux = floor(Light::rectangle(corner, edges, Flux::lumens(PI * 100.0)));
    assert!(near(by_flux, by_radiance), "{by_flux} {by_radiance}");
    // A hue leaves the illuminance as it is.
    let red = Light::point(above, Intensity::candela(100.0).tinted(Vec3::new(0.8, 0.1, 0.1)));
    assert!(near(floor(red), 25.0) && red.color.x > 5.0 * red.color.y);
    // A luminaire that sends down like a Lambert surface: ¼ of the directions' mean, so 4 Φ / 4π straight down.
    let gammas: Vec<f64> = (0..=90).map(f64::from).collect();
    let down = gammas.iter().map(|gamma| gamma.to_radians().cos()).collect();
    let lambert = Distribution::new(gammas, vec![0.0], down).unwrap();
    let mut builder = with_floor();
    builder.add_luminaire(above, (-Vec3::Y, Vec3::X), Flux::lumens(1000.0), &lambert);
    let found = lux(&builder.build().unwrap(), Vec3::ZERO);
    assert!((found / (1000.0 / PI / 4.0) - 1.0).abs() < 0.01, "{found}");
}

#[test]
fn lights_are_found_again_and_shining_meshes_shine() {
    let mut builder = with_floor();
    builder.add_light(Light::sun(-Vec3::Y, Irradiance::lux(1.0)));
    let lamp = builder.add_light(Light::point(Vec3::Y, Intensity::candela(10.0)));
    let mut scene = builder.build().unwrap();
    assert!(near(lux(&scene, Vec3::ZERO), 11.0));
    scene.lighting.light_mut(lamp).unwrap().position.y = 2.0;
    assert!(near(lux(&scene, Vec3::ZERO), 3.5));
    assert_eq!(scene.lighting.light(lamp).unwrap().position.y, 2.0);
    scene.lighting.lights.clear();
    assert!(scene.lighting.light(lamp).is_none());
    // A panel of geometry.
    let mut builder = with_floor();
    let panel = builder.add_material(Material::diffuse(Vec3::ZERO).with_emission(Radiance::nits(1000.0)));
    let down = Affine3A::from_rotation_translation(Quat::from_rotation_x(PI), Vec3::Y * 3.0);
    let corners = square(0.1);
    builder.add_mesh(Mesh {
        positions: &corners,
        indices: &SIDES,
        material: panel,
        transform: down,
        ..Mesh::default()
    });
    let found = lux(&builder.build().unwrap(), Vec3::ZERO);
    assert!((found / (1000.0 * 0.04 / 9.0) - 1.0).abs() < 0.01, "{found}");
}

/// Up, where the front of a triangle is.
fn faces_up(scene: &Scene) -> bool {
    (0..scene.geometry.triangles.len() as u32).all(|t| scene.tables().normal(t).y > 0.9)
}

#[test]
fn fronts_stay_in_front() {
    let corners = square(1.0);
    let made = |mesh: Mesh| {
        let mut builder = Scene::builder();
        let id = builder.add_mesh(Mesh { positions: &corners, ..mesh });
        let scene = builder.build().unwrap();
        assert!(scene.geometry.triangles.iter().all(|t| t.object == id.object()));
        scene
    };
    let turned: Vec<u32> = SIDES.into_iter().rev().collect();
    let up = [Vec3::Y; 4];
    assert!(faces_up(&made(Mesh { indices: &SIDES, ..Mesh::default() })));
    assert!(!faces_up(&made(Mesh { indices: &turned, ..Mesh::default() })));
    assert!(faces_up(&made(Mesh { indices: &turned, normals: &up, ..Mesh::default() })));
    assert!(faces_up(&made(Mesh { indices: &SIDES, normals: &up, ..Mesh::default() })));
    // Mirrored along x, which leaves the upper side up; and moved and scaled.
    let mirror = Affine3A::from_scale_rotation_translation(Vec3::new(-2.0, 1.0, 3.0), Quat::IDENTITY, Vec3::X);
    for (indices, normals) in [(&SIDES[..], &[][..]), (&turned, &up)] {
        let scene = made(Mesh { indices, normals, transform: mirror, ..Mesh::default() });
        assert!(faces_up(&scene));
        assert!((scene.geometry.bounds.1 - Vec3::new(3.0, 0.0, 3.0)).length() < 1e-5, "{:?}", scene.geometry.bounds);
    }
    // Without indices every three vertices are a triangle.
    let soup = SIDES.map(|k| corners[k as usize]);
    let mut builder = Scene::builder();
    builder.add_mesh(Mesh { positions: &soup, ..Mesh::default() });
    assert!(faces_up(&builder.build().unwrap()));
}

#[test]
fn textures_are_linear_means_and_masks_are_holes() {
    // A board of black and white, clear on the right half.
    let size = (64, 32);
    let texel = |k: u32| {
        let x = k % size.0;
        let y = k / size.0;
        let c = if (x + y).is_multiple_of(2) { 200 } else { 0 };
        [c, c, c, if x < size.0 / 2 { 255 } else { 0 }]
    };
    let rgba: Vec<u8> = (0..size.0 * size.1).flat_map(texel).collect();
    let mut builder = Scene::builder();
    let picture = builder.add_texture(size, &rgba);
    let whole = builder.add_textured(picture, None);
    let holes = builder.add_textured(picture, Some(0.5));
    let uvs = [Vec2::ZERO, Vec2::Y, Vec2::ONE, Vec2::X];
    let low = square(1.0);
    let high = square(1.0).map(|p| p + Vec3::Y);
    builder.add_mesh(Mesh { positions: &low, indices: &SIDES, uvs: &uvs, material: whole, ..Mesh::default() });
    builder.add_mesh(Mesh { positions: &high, indices: &SIDES, uvs: &uvs, material: holes, ..Mesh::default() });
    let scene = builder.build().unwrap();
    let triangle = |object: u32| scene.geometry.triangles.iter().position(|t| t.object == object).unwrap() as u32;
    let albedo = scene.filtered_albedo(triangle(0), Vec3::new(-0.4, 0.0, 0.1), 4.0);
    // Half of the linear value of 200.
    let expected = 0.5 * patchlight_scene::math::pow((200.0 / 255.0 + 0.055) / 1.055, 2.4);
    assert!((albedo.x - expected).abs() < 5e-3, "{albedo} {expected}");
    let height = |x: f32| {
        use patchlight_scene::Visibility as _;
        3.0 - scene.closest(Vec3::new(x, 3.0, 0.2), -Vec3::Y).t
    };
    assert!((height(-0.5) - 1.0).abs() < 1e-5, "the board is there");
    assert!(height(0.5).abs() < 1e-5, "and here it has a hole");
}

#[test]
fn the_sky_is_that_of_the_map_or_the_same_from_everywhere() {
    let mut builder = with_floor();
    builder.set_sky_map((2, 1), &[Vec3::ONE, Vec3::X]);
    assert_eq!(builder.clone().build().unwrap().lighting.sky_map.len(), 2);
    builder.set_sky(Radiance::nits(179.0));
    let scene = builder.clone().build().unwrap();
    assert_eq!((scene.lighting.sky.radiance, scene.lighting.sky_map.len()), (Vec3::ONE, 0));
    builder.set_sky_map((3, 1), &[Vec3::ONE]);
    assert!(builder.build().err().unwrap().to_string().contains("sky_map"));
}

#[test]
fn what_is_wrong_is_named() {
    let corners = square(1.0);
    let good = Mesh { name: "floor", positions: &corners, indices: &SIDES, ..Mesh::default() };
    let fault = |mesh: Mesh| {
        let mut builder = Scene::builder();
        builder.add_mesh(mesh);
        match builder.build().err().unwrap() {
            BuildError::Mesh { mesh, fault } => {
                assert_eq!(mesh, "`floor`");
                fault
            }
            other => panic!("{other}"),
        }
    };
    let lost = [0, 1, 2, 0, 2, 9];
    assert_eq!(fault(Mesh { indices: &lost, ..good }), MeshFault::Vertex { triangle: 1, vertex: 9, count: 4 });
    assert_eq!(fault(Mesh { indices: &SIDES[1..], ..good }), MeshFault::Corners { corners: 5 });
    let few = [Vec2::ZERO; 3];
    assert!(matches!(fault(Mesh { uvs: &few, ..good }), MeshFault::Length { expected: 4, found: 3, .. }));
    let far = Affine3A::from_translation(Vec3::X * f32::INFINITY);
    assert_eq!(fault(Mesh { transform: far, ..good }), MeshFault::NotFinite { triangle: 0 });
    let mut other = Scene::builder();
    other.add_material(Material::default());
    let foreign = other.add_material(Material::default());
    assert_eq!(fault(Mesh { material: foreign, ..good }), MeshFault::Material { material: 2, count: 1 });
    assert!(matches!(Scene::builder().build(), Err(BuildError::Scene(_))), "nothing to light");

    let refused = |change: &dyn Fn(&mut SceneBuilder)| {
        let mut builder = with_floor();
        change(&mut builder);
        builder.build().err().map(|error| error.to_string()).unwrap_or_default()
    };
    let watts = Intensity::candela(1.0);
    for (light, named) in [
        (Light::sun(Vec3::ZERO, Irradiance::lux(1.0)), "light 1: its direction is 0"),
        (Light::point(Vec3::X * f32::NAN, watts), "light 1: its position is NaN"),
        (Light::point(Vec3::X, Intensity::candela(-1.0)), "must be finite and not negative"),
        (Light::spot(Vec3::Y, -Vec3::Y, (0.5, 0.4), watts), "light 1: its outer angle is 0.4"),
        (Light::rectangle(Vec3::Y, (Vec3::X, Vec3::X), Radiance::nits(1.0)), "light 1: its area is 0"),
    ] {
        let error = refused(&|builder| {
            builder.add_light(Light::point(Vec3::Y, watts));
            builder.add_light(light);
        });
        assert!(error.contains(named), "{error}");
    }
    assert!(refused(&|b| _ = b.add_material(Material::diffuse(Vec3::new(0.2, 1.0, 0.2)))).contains("material 1"));
    assert!(refused(&|b| _ = b.add_texture((2, 2), &[0; 15])).contains("15 bytes, where 2 x 2 texels of four take 16"));
    assert_eq!(refused(&|b| _ = b.add_material(Material::diffuse(Vec3::splat(0.95)))), "");
    assert_eq!(MaterialId::default().index(), 0);
}
