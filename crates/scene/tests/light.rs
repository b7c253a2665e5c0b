//! Direct irradiance against closed forms.

use std::f32::consts::PI;
use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};
use patchlight_scene::gpu::*;
use patchlight_scene::kernel::large::{add_seen_light, sharp_irradiance};
use patchlight_scene::kernel::light::{direct_irradiance, sky_radiance, spot_falloff};
use patchlight_scene::kernel::medium::{Absorbing, Air, Medium, transmittance};
use patchlight_scene::*;

/// A floor of 200 m and whatever else is given.
fn floor_and(more: Vec<Triangle>, lights: Vec<Light>, sky: Sky, emission: Vec3) -> Scene {
    let quad = |corner: Vec3, a: Vec3, b: Vec3, material| {
        [
            Triangle { corner, edge_a: a, edge_b: a + b, material, ..Triangle::default() },
            Triangle { corner, edge_a: a + b, edge_b: b, material, ..Triangle::default() },
        ]
    };
    let mut triangles = quad(Vec3::new(-100.0, 0.0, -100.0), Vec3::Z * 200.0, Vec3::X * 200.0, 0).to_vec();
    triangles.extend(more);
    let uvs = vec![TriangleUv::default(); triangles.len()];
    let materials = vec![Material::default(), Material { radiance: emission, ..Material::default() }];
    Scene::new(SceneParts { triangles, uvs, materials, lights, sky, ..SceneParts::default() }).unwrap()
}

fn at_origin(scene: &Scene, area_rays: u32, sky_rays: u32) -> Vec3 {
    let params = DirectParams {
        count: 1,
        light_count: scene.lighting.lights.len() as u32,
        emitter_count: scene.emitters.len() as u32,
        area_rays,
        sky_rays,
        seed: 5,
        ray_offset: scene.geometry.ray_offset,
        first: 0,
    };
    let point = SurfacePoint { position: Vec3::ZERO, patch: 0, normal: Vec3::Y, weight: 1.0 };
    scene.direct_irradiance(&params, &[point])[0]
}

fn assert_close(found: f32, expected: f32, tolerance: f32) {
    assert!((found - expected).abs() <= tolerance * expected.abs().max(1e-6), "{found} instead of {expected}");
}

#[test]
fn parallel_point_and_spot_lights() {
    let tilted = Vec3::new(0.6, -0.8, 0.0);
    let sun = Light { kind: LIGHT_DIRECTIONAL, direction: tilted, color: Vec3::splat(10.0), ..Light::default() };
    assert_close(at_origin(&floor_and(vec![], vec![sun], Sky::default(), Vec3::ZERO), 1, 0).x, 8.0, 1e-6);
    let from_below = Light { direction: -tilted, ..sun };
    assert_eq!(at_origin(&floor_and(vec![], vec![from_below], Sky::default(), Vec3::ZERO), 1, 0), Vec3::ZERO);

    let position = Vec3::new(0.0, 3.0, 4.0);
    let bulb = Light { kind: LIGHT_POINT, position, color: Vec3::splat(50.0), ..Light::default() };
    // I cosθ / r² = 50 · (3/5) / 25. The start is lifted by the ray offset (4·10⁻³ of 3 m here).
    assert_close(at_origin(&floor_and(vec![], vec![bulb], Sky::default(), Vec3::ZERO), 1, 0).x, 1.2, 5e-3);

    let spot = Light { kind: LIGHT_SPOT, direction: -position / 5.0, cos_inner: 0.95, cos_outer: 0.8, ..bulb };
    assert_close(at_origin(&floor_and(vec![], vec![spot], Sky::default(), Vec3::ZERO), 1, 0).x, 1.2, 5e-3);
    let away = Light { direction: Vec3::Y, ..spot };
    assert_eq!(at_origin(&floor_and(vec![], vec![away], Sky::default(), Vec3::ZERO), 1, 0), Vec3::ZERO);
    assert!(spot_falloff(&spot, 0.79) == 0.0 && spot_falloff(&spot, 0.96) == 1.0);
    assert_close(spot_falloff(&spot, 0.875), 0.5, 1e-3);
}

/// Form factor of a point below the corner of an a × b rectangle at height c (Howell's catalogue, B-3).
fn corner_factor(a: f32, b: f32, c: f32) -> f32 {
    let x = a / c;
    let y = b / c;
    let sx = (1.0 + x * x).sqrt();
    let sy = (1.0 + y * y).sqrt();
    let angle = |p: f32, q: f32| f64::from(p).atan2(f64::from(q)) as f32;
    (x / sx * angle(y, sx) + y / sy * angle(x, sy)) / (2.0 * PI)
}

#[test]
fn rectangle_lights_and_emitters_have_the_catalogue_form_factor() {
    // Overhead, facing down, its corner straight above the origin.
    let a = 2.0;
    let b = 1.0;
    let c = 1.5;
    let expected = PI * 7.0 * corner_factor(a, b, c);
    let rect = Light {
        kind: LIGHT_RECT,
        position: Vec3::new(0.0, c, 0.0),
        edge_a: Vec3::X * a,
        edge_b: Vec3::Z * b,
        area: a * b,
        color: Vec3::splat(7.0),
        ..Light::default()
    };
    let scene = floor_and(vec![], vec![rect], Sky::default(), Vec3::ZERO);
    assert_close(at_origin(&scene, 4096, 0).x, expected, 8e-3);
    let upside_down = Light { edge_a: rect.edge_b, edge_b: rect.edge_a, ..rect };
    let dark = floor_and(vec![], vec![upside_down], Sky::default(), Vec3::ZERO);
    assert_eq!(at_origin(&dark, 64, 0), Vec3::ZERO);

    // The same rectangle as two triangles of the geometry; x × z points down.
    let corner = rect.position;
    let ea = rect.edge_a;
    let eb = rect.edge_b;
    let quad = vec![
        Triangle { corner, edge_a: ea, edge_b: ea + eb, material: 1, ..Triangle::default() },
        Triangle { corner, edge_a: ea + eb, edge_b: eb, material: 1, ..Triangle::default() },
    ];
    let scene = floor_and(quad.clone(), vec![], Sky::default(), Vec3::splat(7.0));
    assert_eq!(scene.emitters.len(), 2);
    assert_close(at_origin(&scene, 4096, 0).x, expected, 8e-3);

    // Half of it hidden by a sheet just below.
    let mut hidden = quad;
    let lower = corner - Vec3::Y * 1e-2;
    for (edge_a, edge_b) in [(ea * 0.5, ea * 0.5 + eb), (ea * 0.5 + eb, eb)] {
        hidden.push(Triangle { corner: lower, edge_a, edge_b, material: 0, ..Triangle::default() });
    }
    let scene = floor_and(hidden, vec![], Sky::default(), Vec3::splat(7.0));
    let far_half = PI * 7.0 * (corner_factor(a, b, c) - corner_factor(0.5 * a, b, c));
    assert_close(at_origin(&scene, 4096, 0).x, far_half, 2e-2);
}

#[test]
fn sky_of_constant_radiance_gives_pi_times_it() {
    let sky = Sky { radiance: Vec3::new(1.0, 2.0, 3.0), ..Sky::default() };
    let scene = floor_and(vec![], vec![], sky, Vec3::ZERO);
    let found = at_origin(&scene, 0, 64);
    assert_close(found.x, PI, 1e-6);
    assert_close(found.z, 3.0 * PI, 1e-6);
}

#[test]
fn sky_map_points_where_it_says() {
    // Four columns, two rows: middle −z, top row up.
    let mut map = vec![Vec4::ZERO; 8];
    map[1] = Vec4::splat(1.0);
    map[2] = Vec4::splat(1.0);
    let sky = Sky { radiance: Vec3::ONE, map_width: 4, map_height: 2, ..Sky::default() };
    let at = |x: f32, y: f32, z: f32| sky_radiance(&sky, &map, Vec3::new(x, y, z).normalize()).x;
    assert_close(at(0.0, 1.0, -1.0), 1.0, 1e-4);
    assert!(at(0.0, 1.0, 1.0) < 1e-4 && at(0.0, -1.0, -1.0) < 1e-4);
    assert_close(at(1.0, 1.0, 0.0), 0.5, 1e-4);
}

#[test]
fn same_seed_same_bits_for_any_thread_count() {
    let sky = Sky { radiance: Vec3::ONE, ..Sky::default() };
    let wall =
        Triangle { corner: Vec3::new(-1.0, 0.0, 0.5), edge_a: Vec3::X * 2.0, edge_b: Vec3::Y, ..Triangle::default() };
    let scene = floor_and(vec![wall], vec![], sky, Vec3::ZERO);
    let points: Vec<_> = (0..500)
        .map(|k| SurfacePoint {
            position: Vec3::new(k as f32 * 0.01 - 2.5, 0.0, 0.0),
            patch: k,
            normal: Vec3::Y,
            weight: 1.0,
        })
        .collect();
    let params = DirectParams {
        count: 500,
        sky_rays: 16,
        seed: 9,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| scene.direct_irradiance(&params, &points))
    };
    assert_eq!(run(1), run(2));
    let other = scene.direct_irradiance(&DirectParams { seed: 10, ..params }, &points);
    assert_ne!(run(1), other);
}

/// A floor, an emissive quad above it with a textured neighbour, under lights and a sky with a map.
fn lamp_room(lighting: &Lighting, radiance: Vec3) -> Scene {
    let at = |x: f32, material| Triangle {
        corner: Vec3::new(x, 2.0, -0.5),
        edge_a: Vec3::X,
        edge_b: Vec3::Z,
        material,
        ..Triangle::default()
    };
    let floor = Triangle {
        corner: Vec3::new(-9.0, 0.0, -9.0),
        edge_a: Vec3::Z * 40.0,
        edge_b: Vec3::X * 40.0,
        ..Triangle::default()
    };
    let picture = Texture { offset: 0, width: 2, height: 1, levels: 1 };
    let lamp = Material { radiance, ..Material::default() };
    Scene::new(SceneParts {
        triangles: vec![floor, at(-1.0, 1), at(0.2, 2)],
        uvs: vec![TriangleUv { corner: Vec2::ZERO, corner_a: Vec2::X, corner_b: Vec2::Y, ..TriangleUv::default() }; 3],
        materials: vec![Material::default(), lamp, Material { radiance_texture: 0, ..lamp }],
        textures: vec![picture],
        texels: vec![0x3c00_3c00, 0x3c00_3c00, 0x3800_3800, 0x3c00_3800],
        lights: lighting.lights.clone(),
        sky: lighting.sky,
        sky_map: lighting.sky_map.to_vec(),
        ..SceneParts::default()
    })
    .unwrap()
}

/// A lamp, and a sky with a map of four texels.
fn lamp_and_sky() -> Lighting {
    let position = Vec3::new(0.5, 3.0, 1.0);
    let lamp = Light { kind: LIGHT_POINT, position, color: Vec3::splat(20.0), ..Light::default() };
    let map = [0.1, 0.4, 0.2, 0.8].map(Vec4::splat);
    Lighting {
        lights: vec![lamp],
        sky: Sky { radiance: Vec3::ONE, map_width: 2, map_height: 2, ..Sky::default() },
        sky_map: map.into(),
        ..Lighting::default()
    }
}

#[test]
fn lighting_set_later_is_as_lighting_from_the_start() {
    let radiance = Vec3::new(7.0, 5.0, 3.0);
    let dark = lamp_room(&Lighting::default(), Vec3::ZERO);
    assert!(dark.emitters.is_empty());
    assert_eq!(at_origin(&dark, 64, 64), Vec3::ZERO);
    let lit = lamp_and_sky();
    let emission = vec![Vec3::ZERO, radiance, radiance];
    let expected = lamp_room(&lit, radiance);
    assert_eq!(expected.emitters.len(), 2);

    let mut changed = dark.clone();
    changed.set_lighting(Lighting { emission: emission.clone(), ..lit.clone() }).unwrap();
    assert!(Arc::ptr_eq(&changed.geometry, &dark.geometry));
    assert_eq!(changed.emitters, expected.emitters);
    assert_eq!(changed.materials, expected.materials);
    assert_eq!(at_origin(&changed, 64, 64), at_origin(&expected, 64, 64));
    let under = Scene::under(dark.geometry.clone(), changed.lighting.clone()).unwrap();
    assert_eq!(at_origin(&under, 64, 64), at_origin(&expected, 64, 64));
    // What is shared stays as it was.
    assert_eq!(at_origin(&dark, 64, 64), Vec3::ZERO);

    // Each of the three alone is noticed.
    let no_lights = Lighting { lights: Vec::new(), ..changed.lighting.clone() };
    let no_sky = Lighting { sky: Sky::default(), sky_map: Arc::default(), ..changed.lighting.clone() };
    let dim = Lighting { emission: emission.iter().map(|e| *e * 0.9).collect(), ..changed.lighting.clone() };
    for lighting in [no_lights, no_sky, dim] {
        let other = Scene::under(dark.geometry.clone(), lighting).unwrap();
        assert!(at_origin(&other, 64, 64).x < 0.99 * at_origin(&expected, 64, 64).x);
    }
    // Without an emission of its own the lighting is back at what the materials say.
    changed.set_lighting(Lighting::default()).unwrap();
    assert!(changed.emitters.is_empty());
    assert_eq!(at_origin(&changed, 64, 64), Vec3::ZERO);
}

#[test]
fn lights_alone_leave_emitters_and_materials_shared() {
    let scene = lamp_room(&lamp_and_sky(), Vec3::ONE);
    let mut moved = scene.clone();
    let lamp = Light { position: Vec3::new(2.0, 3.0, 1.0), ..scene.lighting.lights[0] };
    moved.set_lights(&[lamp]);
    moved.set_lighting(moved.lighting.clone()).unwrap();
    assert!(Arc::ptr_eq(&moved.geometry, &scene.geometry));
    assert!(Arc::ptr_eq(&moved.emitters, &scene.emitters));
    assert!(Arc::ptr_eq(&moved.materials, &scene.materials));
    assert_ne!(at_origin(&moved, 64, 64), at_origin(&scene, 64, 64));
}

#[test]
fn lighting_of_another_scene_is_an_error() {
    let mut scene = lamp_room(&lamp_and_sky(), Vec3::ONE);
    let before = scene.lighting.clone();
    let short = Lighting { emission: vec![Vec3::ONE; 2], ..before.clone() };
    let wrong = Error::EmissionLength { expected: 3, found: 2 };
    assert_eq!(scene.set_lighting(short.clone()).err(), Some(wrong.clone()));
    assert_eq!(Scene::under(scene.geometry.clone(), short).err(), Some(wrong));
    let mapless = Lighting { sky_map: Arc::default(), ..before.clone() };
    let wrong = Error::TableLength { name: "sky_map", expected: 4, found: 0 };
    assert_eq!(scene.set_lighting(mapless).err(), Some(wrong));
    assert_eq!(scene.lighting, before);
}

/// Direct light through a medium at a point over a floor: at samples, at pixels of points and suns, and of areas.
fn through(scene: &Scene, medium: impl Medium, point: SurfacePoint) -> [Vec4; 4] {
    let p = DirectParams {
        count: 1,
        light_count: scene.lighting.lights.len() as u32,
        emitter_count: scene.emitters.len() as u32,
        area_rays: 4,
        sky_rays: 4,
        ray_offset: scene.geometry.ray_offset,
        ..DirectParams::default()
    };
    let tables = scene.tables();
    let lights = scene.all_lights();
    let occluded = |origin: Vec3, direction: Vec3, t_max: f32| scene.occluded(origin, direction, t_max);
    let large = LargeParams {
        camera: Camera::look_at(point.position + Vec3::Y, point.position, Vec3::X, 1.0, 1, 1),
        light_count: 0,
        emitter_count: p.emitter_count,
        rays: 4,
        stride: 4,
        ray_offset: p.ray_offset,
        ..LargeParams::default()
    };
    let hit = Hit { triangle: 0, u: 0.5, v: 0.5, t: 1.0 };
    let albedo = Vec3::splat(0.5).extend(0.0);
    let sums = (Vec4::ZERO, Vec4::ZERO);
    let (seen, all) = add_seen_light(&tables, &lights, &large, 0, hit, albedo, point, sums, medium, occluded);
    let direct = direct_irradiance(&tables, &p, 0, point, &lights, medium, occluded);
    let sharp = sharp_irradiance(&p, 0, point, &lights, Vec4::ZERO, medium, occluded);
    [direct.extend(0.0), sharp.extend(0.0), seen, all]
}

#[test]
fn a_medium_takes_of_direct_light_what_it_absorbs_on_the_way() {
    let base = Light { position: Vec3::Y * 3.0, color: Vec3::new(1.0, 2.0, 3.0), ..Light::default() };
    let x = Vec3::X * 0.02;
    let z = Vec3::Z * 0.02;
    let lamp = Triangle { corner: Vec3::new(0.5, 2.0, 0.0), edge_a: x, edge_b: z, material: 1, ..Triangle::default() };
    let rect = Light { kind: LIGHT_RECT, edge_a: x, edge_b: z, area: x.cross(z).length(), ..base };
    let sun = Light { kind: LIGHT_DIRECTIONAL, direction: Vec3::NEG_Y, ..base };
    let point = Light { kind: LIGHT_POINT, ..base };
    let place = SurfacePoint { position: Vec3::ZERO, patch: NONE, normal: Vec3::Y, weight: 1.0 };
    let sky = Sky { radiance: Vec3::ONE, ..Sky::default() };
    let all = floor_and(vec![lamp], vec![rect, sun, point], sky, Vec3::splat(50.0));
    let in_air = through(&all, Air, place);
    assert!(in_air.iter().all(|light| light.min_element() >= 0.0 && light.x > 0.0), "{in_air:?}");
    assert_eq!(through(&all, Absorbing(Vec3::ZERO), place), in_air);
    // The last are all samples, whatever is left of them.
    let absorption = Vec3::new(0.0, 0.3, 1.0);
    let nothing = Sky::default();
    let none = floor_and(Vec::new(), Vec::new(), nothing, Vec3::ZERO);
    assert_eq!(through(&none, Absorbing(absorption), place), [Vec4::ZERO; 4]);
    let of_lamp = lamp.corner.length();
    for (scene, distance) in [
        (floor_and(vec![lamp], Vec::new(), nothing, Vec3::splat(50.0)), of_lamp),
        (floor_and(Vec::new(), vec![rect], nothing, Vec3::ZERO), 3.0),
        (floor_and(Vec::new(), vec![point], nothing, Vec3::ZERO), 3.0),
        (floor_and(Vec::new(), vec![sun], nothing, Vec3::ZERO), 1e30),
        (floor_and(Vec::new(), Vec::new(), sky, Vec3::ZERO), 1e30),
    ] {
        let left = transmittance(absorption, distance);
        let [air, found] = [through(&scene, Air, place), through(&scene, Absorbing(absorption), place)];
        for (k, (air, found)) in air.iter().zip(&found).enumerate() {
            let expected = if k < 3 { air.truncate() * left } else { air.truncate() };
            let error = (found.truncate() - expected).abs().max_element();
            assert!(error <= 0.01 * air.max_element(), "{k} at {distance}: {found} for {expected}");
        }
    }
}
