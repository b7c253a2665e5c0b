//! Light at corners, texels and probes is that of the pixels.

use std::sync::Arc;

use assets::procedural;
use bytemuck::Zeroable as _;
use glam::Vec3;
use patches::{LightmapTexels, VolumeSettings, VolumeSize, VoxelVolume};
use patchlight::outputs::{
    CalculationPlane, LightPart, LiveLightmap, LiveProbes, PlaneKind, ProbeVolume, at_corners, illuminance, in_volume,
    is_lit, lit_sides, on_lightmap, on_view,
};
use patchlight::{
    Bake, BakeSettings, LightField, LightSettings, Lighting, Mesh, PictureRenderer, PictureSettings, Radiance,
    ReceiverKind, Silent,
};
use runtime::cpu::Cpu;
use scene::gpu::{LIGHT_POINT, Triangle, TriangleUv};
use scene::{Camera, Light, Material, NONE, ReceiverSet as _, Scene, SceneParts, Sides, Sky, SurfacePoint};

/// The Cornell box with the light of its lamp.
fn lit(receivers: ReceiverKind) -> (PictureRenderer, Arc<Bake>) {
    let loaded = procedural::build("cornell").unwrap();
    let settings = BakeSettings::default().with_patch_count(200).with_receivers(receivers).with_receiver_rays(256);
    let bake = Arc::new(Bake::build(&loaded.scene, &settings, &Silent).unwrap());
    let light = LightSettings::default();
    let pictures = PictureSettings::default().with_size((1, 1)).with_sub_frames(1);
    let mut renderer =
        PictureRenderer::of_bake(bake.clone(), Box::new(Cpu::new()), &light, &pictures, &Silent).unwrap();
    renderer.update_light(&loaded.scene.lighting, &loaded.view.camera(1, 1)).unwrap();
    (renderer, bake)
}

/// Median of |a − b| over the mean of b.
fn difference(pairs: &[(Vec3, Vec3)]) -> f32 {
    let mean = pairs.iter().map(|(_, b)| b.element_sum()).sum::<f32>() / pairs.len() as f32;
    let mut all: Vec<f32> = pairs.iter().map(|(a, b)| (*a - *b).abs().element_sum() / mean).collect();
    all.sort_by(f32::total_cmp);
    all[all.len() / 2]
}

#[test]
fn a_lightmap_has_the_light_that_rays_from_its_texels_gather() {
    let (mut renderer, bake) = lit(ReceiverKind::Mesh);
    let sides = lit_sides(renderer.light().bake());
    assert!(sides.iter().any(|side| side.front || side.back));
    let lightmap = LightmapTexels::new(bake.scene(), &sides, 0.05, &|point| is_lit(&bake, point)).unwrap();
    let values = on_lightmap(renderer.light_mut(), &lightmap, LightPart::Indirect).unwrap();
    // Every 40th texel, by rays of its own.
    let some: Vec<usize> = (0..values.len()).step_by(40).collect();
    assert!(some.len() > 30, "{}", some.len());
    let points: Vec<SurfacePoint> = some.iter().map(|&k| lightmap.points()[k]).collect();
    let exact = renderer.light_mut().irradiance_at(&points).unwrap();
    let pairs: Vec<_> = some.iter().zip(&exact).map(|(&k, &exact)| (values[k].truncate(), exact)).collect();
    // Of rows of 256 rays noise is left (found: 2.05 %).
    assert!(difference(&pairs) < 0.025, "{}", difference(&pairs));
    // Those of other texels are refused.
    let wrong: Vec<_> = pairs.iter().zip(pairs.iter().cycle().skip(pairs.len() / 2)).map(|(p, q)| (p.0, q.1)).collect();
    assert!(difference(&wrong) > 0.05, "{}", difference(&wrong));
}

#[test]
fn a_live_lightmap_lies_on_the_scene_of_its_user() {
    let (mut renderer, bake) = lit(ReceiverKind::Mesh);
    let loaded = procedural::build("cornell").unwrap();
    let mut lightmap = LiveLightmap::new(&loaded.scene, 0.05).unwrap();
    assert!(loaded.scene.geometry.triangles.len() < bake.scene().geometry.triangles.len(), "the bake cuts nothing");
    let values = lightmap.irradiance(renderer.light_mut(), LightPart::Indirect).unwrap();
    let some: Vec<usize> = (0..values.len()).step_by(40).collect();
    let points: Vec<SurfacePoint> = some.iter().map(|&k| lightmap.texels().points()[k]).collect();
    let exact = renderer.light_mut().irradiance_at(&points).unwrap();
    let pairs: Vec<_> = some.iter().zip(&exact).map(|(&k, &exact)| (values[k], exact)).collect();
    // As on the triangles of the bake, where it stands at other texels (found: 2.65 %).
    assert!(difference(&pairs) < 0.03, "{}", difference(&pairs));
    let wrong: Vec<_> = pairs.iter().zip(pairs.iter().cycle().skip(pairs.len() / 2)).map(|(p, q)| (p.0, q.1)).collect();
    assert!(difference(&wrong) > 0.05, "{}", difference(&wrong));
    // Every texel shows a receiver, also those between charts.
    let picture = lightmap.picture(&values);
    assert_eq!(picture.len(), (lightmap.size().0 * lightmap.size().1) as usize);
    assert!(lightmap.shown().iter().all(|&receiver| (receiver as usize) < values.len()));
}

#[test]
fn triangles_of_ones_own_are_laid_out_on_a_bake() {
    let (mut renderer, bake) = lit(ReceiverKind::Mesh);
    let scene = procedural::build("cornell").unwrap().scene;
    let corners = |t: &Triangle| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b];
    let mut triangles: Vec<[Vec3; 3]> = scene.geometry.triangles.iter().map(corners).collect();
    // The same from another corner, and one in the air that no bake knows.
    triangles[3].rotate_left(1);
    triangles.push([Vec3::splat(0.2), Vec3::new(0.3, 0.2, 0.2), Vec3::new(0.2, 0.3, 0.2)]);
    let mut lightmap = LiveLightmap::over(&bake, &triangles, 0.05).unwrap();
    let uvs = lightmap.corner_uvs(&triangles);
    assert_eq!(uvs.len(), triangles.len());
    assert!(uvs.last().unwrap().is_none() && uvs.iter().filter(|uvs| uvs.is_some()).count() > 20);
    let values = lightmap.irradiance(renderer.light_mut(), LightPart::Indirect).unwrap();
    // Through the texture coordinates, the middle of each triangle has the light that rays gather there.
    let picture = lightmap.picture(&values);
    let (width, height) = lightmap.size();
    let (mut middles, mut shown) = (Vec::new(), Vec::new());
    for ([a, b, c], uvs) in triangles.iter().zip(&uvs) {
        let Some([uv, uv_a, uv_b]) = uvs else { continue };
        let (normal, at) = ((*b - *a).cross(*c - *a).normalize(), (*uv + *uv_a + *uv_b) / 3.0);
        middles.push(SurfacePoint { position: (*a + *b + *c) / 3.0, patch: NONE, normal, weight: 1.0 });
        let (x, y) = ((at.x * width as f32) as usize, (at.y * height as f32) as usize);
        shown.push(picture[x + width as usize * y]);
    }
    let exact = renderer.light_mut().irradiance_at(&middles).unwrap();
    let pairs: Vec<_> = shown.iter().copied().zip(exact.iter().copied()).collect();
    assert!(difference(&pairs) < 0.05, "{}", difference(&pairs));
    let wrong: Vec<_> = shown.iter().copied().zip(exact.iter().rev().copied()).collect();
    assert!(difference(&wrong) > 0.1, "{}", difference(&wrong));
}

#[test]
fn a_live_lightmap_follows_its_field_to_another_bake() {
    let (mut renderer, bake) = lit(ReceiverKind::Mesh);
    let mut lightmap = LiveLightmap::new(&procedural::build("cornell").unwrap().scene, 0.1).unwrap();
    let fine = lightmap.irradiance(renderer.light_mut(), LightPart::Indirect).unwrap();
    let settings = BakeSettings::default().with_patch_count(60).with_receivers(ReceiverKind::Mesh);
    let coarse = Arc::new(Bake::build(bake.scene(), &settings, &Silent).unwrap());
    let mut field = LightField::new(coarse, Box::new(Cpu::new()), &LightSettings::default(), &Silent).unwrap();
    field.update(&bake.scene().lighting).unwrap();
    let other = lightmap.irradiance(&mut field, LightPart::Indirect).unwrap();
    let again = lightmap.irradiance(renderer.light_mut(), LightPart::Indirect).unwrap();
    assert!(fine != other && fine == again);
    let pairs: Vec<_> = other.iter().copied().zip(fine.iter().copied()).collect();
    assert!(difference(&pairs) < 0.1, "{}", difference(&pairs));
}

#[test]
fn a_floor_that_sees_the_sky_alone_has_a_live_lightmap() {
    let floor = [Vec3::ZERO, Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::X];
    let mut builder = Scene::builder();
    builder.add_mesh(Mesh { positions: &floor, indices: &[0, 1, 2, 0, 2, 3], ..Mesh::default() });
    builder.set_sky(Radiance(Vec3::splat(2.0)));
    let scene = builder.build().unwrap();
    let settings = BakeSettings::default().with_patch_count(8).with_receivers(ReceiverKind::Mesh);
    let bake = Arc::new(Bake::build(&scene, &settings, &Silent).unwrap());
    let mut field = LightField::new(bake, Box::new(Cpu::new()), &LightSettings::default(), &Silent).unwrap();
    field.update(&scene.lighting).unwrap();
    let sides = vec![Sides { front: true, back: false }; 2];
    let mut lightmap = LiveLightmap::of_sides(&scene, &sides, 0.25).unwrap();
    let values = lightmap.irradiance(&mut field, LightPart::WithoutLights).unwrap();
    // Nothing is reflected; of the sky comes pi L.
    let expected = 2.0 * std::f32::consts::PI;
    assert!(!values.is_empty() && values.iter().all(|e| (e.x / expected - 1.0).abs() < 1e-3), "{values:?}");
    let indirect = lightmap.irradiance(&mut field, LightPart::Indirect).unwrap();
    assert!(indirect.iter().all(|e| *e == Vec3::ZERO));
}

#[test]
fn a_floor_is_not_dark_under_what_stands_on_it() {
    let square = |height: f32, half: f32| {
        [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)].map(|(x, z)| Vec3::new(x * half, height, z * half))
    };
    let [floor, low, high] = [square(0.0, 1.0), square(0.0, 0.3), square(0.6, 0.3)];
    let block = [low, high].concat();
    let sides = [1, 5, 0, 0, 5, 4, 2, 6, 1, 1, 6, 5, 3, 7, 2, 2, 7, 6, 0, 4, 3, 3, 4, 7, 4, 5, 6, 4, 6, 7];
    let mut builder = Scene::builder();
    builder.add_mesh(Mesh { positions: &floor, indices: &[0, 1, 2, 0, 2, 3], ..Mesh::default() });
    builder.add_mesh(Mesh { positions: &block, indices: &sides, ..Mesh::default() });
    builder.set_sky(Radiance(Vec3::ONE));
    let scene = builder.build().unwrap();
    let bake = Arc::new(Bake::build(&scene, &BakeSettings::default().with_patch_count(100), &Silent).unwrap());
    let corners = |t: &Triangle| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b];
    let triangles: Vec<[Vec3; 3]> = scene.geometry.triangles.iter().map(corners).collect();
    let mut lightmap = LiveLightmap::over(&bake, &triangles, 0.05).unwrap();
    let light = lightmap.surroundings(&bake, &scene.lighting).unwrap();
    let is_floor = |point: &SurfacePoint| point.normal.y > 0.9 && point.position.y < 0.01;
    let points = lightmap.texels().points().iter();
    let (inside, others): (Vec<_>, Vec<_>) = points
        .zip(&light)
        .filter(|(point, _)| is_floor(point))
        .partition(|(point, _)| point.position.x.abs().max(point.position.z.abs()) < 0.28);
    // Texels there show the light of the nearest beside.
    assert!(inside.is_empty() && others.len() > 500, "{} {}", inside.len(), others.len());
    // Beside the block, half of the sky is seen, or more.
    let half = std::f32::consts::FRAC_PI_2;
    let dark = others.iter().filter(|(_, light)| light.x <= 0.8 * half).map(|(p, l)| (p.position, l.x));
    assert_eq!(dark.collect::<Vec<_>>(), []);
}

#[test]
fn the_parts_of_the_light_add_up() {
    let (mut renderer, bake) = lit(ReceiverKind::Mesh);
    let mut lightmap = LiveLightmap::new(&procedural::build("cornell").unwrap().scene, 0.1).unwrap();
    let mut lighting = bake.scene().lighting.clone();
    lighting.sky = Sky { radiance: Vec3::new(0.2, 0.3, 0.5), ..Sky::default() };
    let mut parts = |lighting: &Lighting| {
        let camera = Camera::look_at(Vec3::ONE, Vec3::ZERO, Vec3::Y, 40.0, 1, 1);
        renderer.update_light(lighting, &camera).unwrap();
        [LightPart::Indirect, LightPart::WithoutLights, LightPart::Full]
            .map(|part| lightmap.irradiance(renderer.light_mut(), part).unwrap())
    };
    let mean = |values: &[Vec3]| values.iter().sum::<Vec3>() / values.len() as f32;
    let [indirect, without_lights, full] = parts(&lighting).map(|values| mean(&values));
    assert!(without_lights.cmpgt(1.01 * indirect).all() && full.cmpgt(1.1 * without_lights).all());
    // Without lights, the full light has no others; the sky's share is linear in its radiance.
    let lamps = std::mem::take(&mut lighting.lights);
    let [indirect_of_sky, of_sky, full_of_sky] = parts(&lighting).map(|values| mean(&values));
    assert_eq!(of_sky, full_of_sky);
    assert!(
        ((of_sky - indirect_of_sky) - (without_lights - indirect)).abs().max_element() < 1e-4 * of_sky.max_element()
    );
    lighting.lights = lamps;
    lighting.sky.radiance *= 3.0;
    let [brighter_indirect, brighter, _] = parts(&lighting).map(|values| mean(&values));
    let shares = (brighter - brighter_indirect) / (without_lights - indirect);
    assert!((shares - 3.0).abs().max_element() < 1e-3, "{shares}");
}

#[test]
fn the_full_light_is_the_direct_more() {
    let (mut renderer, bake) = lit(ReceiverKind::Mesh);
    let corners = |renderer: &mut PictureRenderer, part| at_corners(renderer.light_mut(), part, true).unwrap();
    let full = corners(&mut renderer, LightPart::Full);
    let indirect = corners(&mut renderer, LightPart::Indirect);
    let sides = lit_sides(renderer.light().bake());
    let mut brighter = 0;
    for ((full, indirect), side) in full.iter().zip(&indirect).zip(&sides) {
        for (full, indirect) in full.iter().zip(indirect) {
            assert!(full.cmpge(*indirect).all() && full.is_finite());
            assert!(side.front || *full == Vec3::ZERO);
            brighter += u32::from(full.x > 1.1 * indirect.x);
        }
    }
    assert!(brighter > 10, "{brighter} corners with direct light");
    let texels = LightmapTexels::new(bake.scene(), &sides, 0.2, &|point| is_lit(&bake, point)).unwrap();
    let full = on_lightmap(renderer.light_mut(), &texels, LightPart::Full).unwrap();
    let indirect = on_lightmap(renderer.light_mut(), &texels, LightPart::Indirect).unwrap();
    let brighter = full.iter().zip(&indirect).filter(|(full, indirect)| full.x > 1.1 * indirect.x).count();
    assert!(full.iter().zip(&indirect).all(|(full, indirect)| full.cmpge(*indirect).all()));
    assert!(brighter > full.len() / 4, "{brighter} of {}", full.len());
}

#[test]
fn probes_from_files_give_the_light_of_the_volume() {
    let (mut renderer, bake) = lit(ReceiverKind::Mesh);
    let settings = VolumeSettings { size: VolumeSize::Count(27), ..VolumeSettings::default() };
    let volume = VoxelVolume::new(bake.scene(), &settings, &|point| is_lit(&bake, point)).unwrap();
    let values = in_volume(renderer.light_mut(), &volume, LightPart::Indirect).unwrap();
    let probes = ProbeVolume::new(&volume, values.clone()).unwrap();
    let (description, binary) = probes.to_files().unwrap();
    let read = ProbeVolume::from_files(&description, &binary).unwrap();
    let middle = 0.5 * (bake.scene().geometry.bounds.0 + bake.scene().geometry.bounds.1);
    for normal in [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::new(0.6, -0.8, 0.0)] {
        let expected = volume.at(&values, middle, normal).unwrap().truncate();
        assert_eq!(read.irradiance(middle, normal), expected);
        let smooth = read.irradiance_by_harmonics(middle, normal);
        assert!(expected.min_element() > 0.0 && (smooth - expected).abs().max_element() < 0.3 * expected.max_element());
    }
    // Red light comes from the red wall, green from the green one.
    let left = read.irradiance(middle, Vec3::NEG_X);
    let right = read.irradiance(middle, Vec3::X);
    assert!((left.x / left.y - right.x / right.y).abs() > 0.2, "{left} {right}");
}

/// Rows that are kept give the light that rays find, under each lighting.
#[test]
fn live_probes_follow_the_light_of_a_renderer() {
    let (mut renderer, bake) = lit(ReceiverKind::Mesh);
    let mut probes = LiveProbes::new(renderer.light_mut(), 27, 2048, &Silent).unwrap();
    let camera = Camera::look_at(Vec3::ZERO, Vec3::Z, Vec3::Y, 50.0, 4, 4);
    let middle = 0.5 * (bake.scene().geometry.bounds.0 + bake.scene().geometry.bounds.1);
    let normals = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z];
    let mut before = Vec3::ZERO;
    for scale in [1.0, 3.0] {
        let mut lighting = bake.scene().lighting.clone();
        lighting.lights.iter_mut().for_each(|light| light.color *= scale);
        renderer.update_light(&lighting, &camera).unwrap();
        probes.update(renderer.light_mut()).unwrap();
        let volume = probes.volume().clone();
        let values = in_volume(renderer.light_mut(), &volume, LightPart::Indirect).unwrap();
        for normal in normals {
            let found = probes.irradiance(middle, normal);
            let expected = volume.at(&values, middle, normal).unwrap().truncate();
            let wrong = (found - expected).abs().max_element() / expected.max_element();
            assert!(wrong < 0.05, "{normal}: {found} {expected}");
            assert!((found - before).abs().max_element() > 0.05 * expected.max_element(), "{normal}: as before");
        }
        before = probes.irradiance(middle, normals[0]);
    }
    let (mut renderer, _) = lit(ReceiverKind::Pixels);
    let error = LiveProbes::new(renderer.light_mut(), 27, 16, &Silent).unwrap_err();
    assert!(error.to_string().contains("receivers on the mesh"), "{error}");
}

#[test]
fn corners_and_texels_need_receivers_on_the_mesh() {
    let (mut renderer, _) = lit(ReceiverKind::Pixels);
    let error = at_corners(renderer.light_mut(), LightPart::Indirect, true).unwrap_err().to_string();
    assert!(error.contains("receivers on the mesh"), "{error}");
}

#[test]
fn planes_under_a_lamp_have_the_illuminance_of_the_closed_form() {
    // A lamp 3 m above a black floor.
    let triangle =
        |a: Vec3, b: Vec3, c: Vec3| Triangle { corner: a, edge_a: b - a, edge_b: c - a, ..Triangle::default() };
    let [a, b, c, d] = [(-4.0, -4.0), (-4.0, 4.0), (4.0, 4.0), (4.0, -4.0)].map(|(x, z)| Vec3::new(x, 0.0, z));
    let lamp = Vec3::new(0.5, 3.0, -0.5);
    let intensity = Vec3::new(20.0, 10.0, 30.0);
    let scene = Scene::new(SceneParts {
        triangles: vec![triangle(a, b, c), triangle(a, c, d)],
        uvs: vec![TriangleUv::default(); 2],
        materials: vec![Material { albedo: Vec3::ZERO, ..Material::default() }],
        lights: vec![Light { kind: LIGHT_POINT, position: lamp, color: intensity, ..Light::zeroed() }],
        ..SceneParts::default()
    })
    .unwrap();
    let settings = BakeSettings::default().with_patch_count(16).with_receiver_rays(64);
    let bake = Bake::build(&scene, &settings, &Silent).unwrap();
    let light = LightSettings::default();
    let pictures = PictureSettings::default().with_size((1, 1)).with_sub_frames(1);
    let mut renderer =
        PictureRenderer::of_bake(Arc::new(bake), Box::new(Cpu::new()), &light, &pictures, &Silent).unwrap();
    let camera = Camera::look_at(Vec3::new(0.0, 8.0, 0.1), Vec3::ZERO, Vec3::NEG_Z, 60.0, 8, 8);
    renderer.update_light(&scene.lighting, &camera).unwrap();
    for (kind, height) in [(PlaneKind::Horizontal, 0.8), (PlaneKind::Cylindrical, 1.2)] {
        let plane = CalculationPlane { kind, height, spacing: 0.9, area: None };
        let light = plane.light(renderer.light_mut()).unwrap();
        assert_eq!(light.counts, [9, 9]);
        for (k, lux) in (0u32..).zip(&light.lux) {
            let to = lamp - light.place(k);
            let facing = illuminance(intensity) / to.length_squared();
            let expected = match kind {
                PlaneKind::Horizontal => facing * to.y / to.length(),
                // The mean of the cosines round a cylinder is 1/π of the light across it.
                PlaneKind::Cylindrical => facing * to.with_y(0.0).length() / to.length() / std::f32::consts::PI,
            };
            let lux = lux.unwrap();
            assert!((lux - expected).abs() < 0.02 * expected, "{kind:?} {k}: {lux} {expected}");
        }
        let [mean, least, greatest] = light.statistics().unwrap();
        assert!(least < mean && mean < greatest);
    }
    // What the camera sees is the floor.
    let seen = on_view(renderer.light_mut(), &camera, LightPart::Full).unwrap();
    let brightest = seen.iter().map(|&e| illuminance(e)).fold(0.0, f32::max);
    assert!((brightest / (illuminance(intensity) / 9.0) - 1.0).abs() < 0.1, "{brightest}");
    let endless = CalculationPlane { kind: PlaneKind::Horizontal, height: f32::NAN, spacing: 1.0, area: None };
    assert!(endless.light(renderer.light_mut()).unwrap_err().to_string().contains("height"));
    let fine = CalculationPlane { height: 1.0, spacing: 1e-4, ..endless };
    assert!(fine.light(renderer.light_mut()).unwrap_err().to_string().contains("points of a plane"));
}
