//! The built-in scenes that show faults: closed where they should be, and as large, thick and far apart as was asked
//! for.

use glam::{DVec3, Vec3};
use patchlight_assets::{LoadedScene, procedural};
use scene::Visibility as _;
use scene::sampling::{hash3, unit};

fn build(spec: &str) -> LoadedScene {
    let loaded = procedural::build(spec).unwrap_or_else(|e| panic!("{e}"));
    assert!(loaded.warnings.is_empty(), "{spec}: {:?}", loaded.warnings);
    assert_eq!((loaded.dropped.zero_area, loaded.dropped.duplicates), (0, 0), "{spec}");
    loaded
}

/// Corners of the triangles of a material, or of all of them.
fn triangles<'a>(loaded: &'a LoadedScene, material: Option<&'a str>) -> impl Iterator<Item = [DVec3; 3]> + 'a {
    let is_wanted = move |m: u32| material.is_none_or(|name| loaded.materials[m as usize] == name);
    loaded.scene.geometry.triangles.iter().filter(move |t| is_wanted(t.material)).map(|t| {
        let corner = t.corner.as_dvec3();
        [corner, corner + t.edge_a.as_dvec3(), corner + t.edge_b.as_dvec3()]
    })
}

/// Normals times areas, m².
fn vectors<'a>(loaded: &'a LoadedScene, material: Option<&'a str>) -> impl Iterator<Item = DVec3> + 'a {
    triangles(loaded, material).map(|[a, b, c]| 0.5 * (b - a).cross(c - a))
}

fn area(loaded: &LoadedScene, material: &str) -> f64 {
    vectors(loaded, Some(material)).map(DVec3::length).sum()
}

/// Volume inside a closed surface: the integral of p·n/3.
fn volume<'a>(corners: impl Iterator<Item = [DVec3; 3]> + 'a) -> f64 {
    corners.map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

/// Distance to the first surface from a point, m.
fn distance(loaded: &LoadedScene, from: Vec3, direction: Vec3) -> f64 {
    let hit = loaded.scene.closest(from, direction);
    if hit.is_miss() { f64::INFINITY } else { f64::from(hit.t) }
}

fn assert_near(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() <= 1e-5 * expected.abs().max(1.0), "{what}: {found}, expected {expected}");
}

/// Rays all round from a point that meet nothing.
fn escapes(loaded: &LoadedScene, from: Vec3) -> usize {
    let direction = |k: u32| Vec3::from([0, 1, 2].map(|axis| 2.0 * unit(hash3(k, axis, 5)) - 1.0));
    (0..40_000)
        .map(direction)
        .filter(|d| d.length() > 0.1 && distance(loaded, from, d.normalize()).is_infinite())
        .count()
}

#[test]
fn rooms_are_closed_where_no_doorway_is() {
    for wall in ["0", "0.02", "0.1"] {
        let sealed = build(&format!("rooms:doorway=0,wall={wall}"));
        let open = build(&format!("rooms:wall={wall}"));
        for room in [Vec3::new(1.0, 1.2, 3.0), Vec3::new(6.0, 1.2, 1.0)] {
            assert_eq!(escapes(&sealed, room), 0, "{wall}");
        }
        assert!(escapes(&open, Vec3::new(6.0, 1.2, 2.0)) > 100, "{wall}");
    }
    for (spec, inside) in [("stripes", Vec3::new(2.0, 1.0, 2.0)), ("corridor", Vec3::new(1.0, 1.0, 1.0))] {
        assert_eq!(escapes(&build(spec), inside), 0, "{spec}");
    }
    for (spec, inside) in [("blinds", Vec3::new(2.0, 1.5, 2.0)), ("window", Vec3::new(2.0, 1.5, 2.0))] {
        let loaded = build(spec);
        assert!(escapes(&loaded, inside) > 50, "{spec}: the window is open");
        assert_eq!(escapes(&loaded, Vec3::new(0.1, 0.05, 3.9)), 0, "{spec}: nothing else is");
    }
}

#[test]
fn kitchens_are_open_at_the_window_and_bays_nowhere() {
    let kitchen = build("kitchen");
    assert!(escapes(&kitchen, Vec3::new(2.0, 1.5, 2.0)) > 50);
    assert_eq!(escapes(&kitchen, Vec3::new(0.1, 0.05, 3.1)), 0);
    assert_near(distance(&kitchen, Vec3::new(0.2, 1.6, 1.6), Vec3::NEG_Y), 0.45 - 0.002, "the sill below the window");
    assert_near(area(&build("kitchen:cupboards=0"), "cupboard"), 0.0, "no cupboards");
    // Each on the floor without a bottom, each on the wall whole.
    let side = |x: f64, y: f64, z: f64| 2.0 * (x * y + y * z + z * x);
    let one = side(0.538, 0.86, 0.576) - 0.538 * 0.576 + side(0.538, 0.7, 0.336);
    assert_near(area(&kitchen, "cupboard") / 4.0, one, "cupboards");
    for spec in ["bay", "bay:pane=0.004,blind=1", "bay:blind=0,segments=5"] {
        let bay = build(spec);
        assert_eq!(escapes(&bay, Vec3::new(2.0, 1.4, 2.0)), 0, "{spec}: panes shut the windows");
        assert_near(area(&bay, "pane"), (0.8 + 1.2 + 0.8) * 1.45, spec);
    }
    // Through a bay without blinds the panes are as far behind the frames as was asked.
    let bay = build("bay:blind=0,pane=0.05");
    let straight = |x: f32, y: f32| distance(&bay, Vec3::new(x, y, 1.0), Vec3::NEG_Z);
    assert_near(straight(0.7, 1.2) - straight(0.42, 1.2), 0.04 + 0.05, "behind the frame");
    // The arch is as high in its middle as the straight windows, and the wall's corners are filled.
    assert_near(straight(2.3, 2.2 - 0.05) - straight(0.42, 1.2), 0.04 + 0.05, "below the crown");
    assert_near(straight(1.72, 2.18), 1.0, "beside the arch");
    // Lengths of slats, each shining on all sides.
    let slats = |share: f64| area(&build(&format!("bay:blind={share}")), "slat");
    assert_near(slats(1.0) / slats(0.5), 2.0, "blinds");
}

#[test]
fn walls_of_rooms_are_as_thick_as_asked_and_as_large_as_the_closed_form_says() {
    for (thickness, doorway) in [(0.0, 1.4), (0.02, 1.4), (0.1, 0.9), (0.1, 0.0)] {
        let loaded = build(&format!("rooms:wall={thickness},doorway={doorway}"));
        let outside = distance(&loaded, Vec3::new(2.0, 1.2, -1.5), Vec3::Z);
        let inside = distance(&loaded, Vec3::new(2.0, 1.2, 2.0), Vec3::NEG_Z);
        assert_near(3.5 - outside - inside, thickness, "thickness");
        assert_near(area(&loaded, "floor"), 13.5 * 9.5, "floor");
        assert_near(area(&loaded, "slab"), 9.2 * 5.2, "slab");
        let t = thickness;
        let expected = match t {
            0.0 => 2.6 * (2.0 * 8.0 + 3.0 * 4.0) - 2.0 * doorway * 2.1,
            _ => {
                let perimeters = 2.0 * (12.0 + 2.0 * t) + 2.0 * 4.0 * (4.0 - t);
                let sides_of_doors = if doorway > 0.0 { 2.0 * (2.0 * 2.1 + doorway) * t } else { 0.0 };
                2.6 * perimeters - 4.0 * doorway * 2.1 + sides_of_doors
            }
        };
        assert_near(area(&loaded, "wall"), expected, "walls");
    }
}

#[test]
fn one_floor_and_one_slab_lie_on_both_sides_of_the_walls() {
    let loaded = build("rooms");
    let triangle = |x: f32, z: f32| loaded.scene.closest(Vec3::new(x, 1.0, z), Vec3::NEG_Y).triangle;
    assert_eq!(triangle(3.0, 0.1), triangle(3.0, -0.1), "the wall at z = 0 stands in the middle of a triangle");
    assert_ne!(triangle(1.0, 0.1), triangle(10.0, 6.0));
}

#[test]
fn sheets_stand_off_as_far_as_is_said() {
    for (gap, spec) in [(1.0, "stripes"), (3.0, "stripes:gap=3")] {
        let loaded = build(spec);
        let wall = distance(&loaded, Vec3::new(0.3, 1.0, 1.0), Vec3::NEG_Z);
        assert_near(wall, 1.0, "between stripes");
        for (k, height) in [0.0002, 0.001, 0.005, 0.0002, 0.001, 0.005].into_iter().enumerate() {
            let from = Vec3::new(0.45 + 0.57 * k as f32 + 0.125, 1.0, 1.0);
            // To the bit of single precision at 1 m.
            let found = wall - distance(&loaded, from, Vec3::NEG_Z);
            assert!((found - gap * height).abs() < 3e-7, "stripe {k}: {found}");
        }
        let carpet = 1.0 - distance(&loaded, Vec3::new(2.0, 1.0, 2.0), Vec3::NEG_Y);
        assert!((carpet - gap * 0.002).abs() < 3e-7, "{carpet}");
        let poster = 1.0 - distance(&loaded, Vec3::new(1.0, 1.4, 1.3), Vec3::NEG_X);
        assert!((poster - gap * 0.001).abs() < 3e-7, "{poster}");
    }
    assert_eq!(area(&build("stripes:stripes=0"), "blue paint"), 0.0);
}

#[test]
fn shells_are_closed_and_have_the_volume_of_their_walls() {
    let solid = |size: [f64; 3], wall: f64, window: f64| {
        let outside: f64 = size.iter().map(|s| s + 2.0 * wall).product();
        outside - size.iter().product::<f64>() - window * wall
    };
    for (spec, expected) in [
        ("blinds", solid([5.0, 2.7, 4.0], 0.2, 2.0 * 1.2)),
        ("clutter", solid([5.0, 2.6, 4.0], 0.2, 0.7 * 0.7)),
        ("window", solid([4.0, 2.6, 5.0], 0.25, 2.8 * 1.5)),
    ] {
        let loaded = build(spec);
        let shell = || triangles(&loaded, Some("wall")).chain(triangles(&loaded, Some("floor")));
        assert_near(volume(shell()), expected, spec);
        let open: DVec3 = vectors(&loaded, Some("wall")).chain(vectors(&loaded, Some("floor"))).sum();
        assert!(open.length() < 1e-4, "{spec} is not closed: {open}");
        // Without one triangle it is neither.
        assert!((volume(shell().skip(1)) - expected).abs() > 1e-3, "{spec}");
    }
}

#[test]
fn blinds_have_the_slats_that_were_asked_for() {
    for (spec, slats, depth) in
        [("blinds", 16.0, 0.08), ("blinds:slats=8,tilt=-30", 8.0, 0.08), ("blinds:slats=0", 0.0, 0.08)]
    {
        let loaded = build(spec);
        assert_near(volume(triangles(&loaded, Some("slat"))), slats * depth * 0.002 * 1.98, spec);
    }
    // At 36° the sun passes between level slats, and not past slats that stand upright across it.
    let sunlit = |spec: &str| {
        let loaded = build(spec);
        let to_sun = -loaded.scene.lighting.lights[0].direction;
        let place = |k: u32| Vec3::new(0.05 + 2.5 * unit(hash3(k, 0, 1)), 0.001, 1.0 + 2.0 * unit(hash3(k, 1, 1)));
        (0..4000).filter(|k| !loaded.scene.occluded(place(*k), to_sun, 100.0)).count()
    };
    let none = sunlit("blinds:tilt=-60");
    let some = sunlit("blinds");
    let all = sunlit("blinds:slats=0");
    assert!(none < some / 4 && 4 * some < 3 * all && some > all / 8, "{none} {some} {all}");
}

#[test]
fn the_panes_of_the_window_have_the_area_of_the_closed_form() {
    for panes in [1, 3, 6] {
        let loaded = build(&format!("window:panes={panes}"));
        let bars: f64 = vectors(&loaded, Some("frame")).map(|v| v.z.max(0.0)).sum();
        let open = (2.8 - 0.04 * f64::from(panes + 1)) * (1.5 - 0.04 * 3.0);
        assert_near(2.8 * 1.5 - bars, open, "panes");
    }
    assert_eq!(area(&build("window:bar=0"), "frame"), 0.0);
}

#[test]
fn chairs_have_legs_as_thin_as_asked() {
    for leg in [0.01, 0.03] {
        let loaded = build(&format!("clutter:leg={leg}"));
        let middle = Vec3::new(0.75, 0.2, 1.0) - Vec3::new(0.18 - 0.5 * leg, 0.0, 0.18 - 0.5 * leg);
        let side = |direction: Vec3| f64::from(0.05f32) - distance(&loaded, middle - 0.05 * direction, direction);
        assert_near(side(Vec3::X) + side(Vec3::NEG_X), f64::from(leg), "leg");
    }
    let count = |chairs: u32| build(&format!("clutter:chairs={chairs}")).scene.geometry.triangles.len();
    // Seat and rail of 12 triangles, four legs of 8, two posts of 10.
    assert_eq!(count(5) - count(0), 5 * (2 * 12 + 4 * 8 + 2 * 10));
}

#[test]
fn the_corridor_turns_twice_between_lamp_and_camera() {
    let loaded = build("corridor");
    let lamp = loaded.scene.lighting.lights[0];
    let length = 3.0;
    let width = 1.8;
    let middle = 1.4;
    let random = |k: u32, seed: u32| [0, 1, 2].map(|axis| unit(hash3(k, axis, seed)));
    let sees = |a: Vec3, b: Vec3| {
        let to = b - a;
        !loaded.scene.occluded(a, to.normalize(), to.length())
    };
    let mut seen = [0; 2];
    for k in 0..4000 {
        let [u, v, _] = random(k, 1);
        let light = lamp.position + u * lamp.edge_a + v * lamp.edge_b;
        let [x, y, z] = random(k, 2);
        let last = Vec3::new(length + width + x * length, 0.1 + 2.3 * y, width + middle + z * width);
        assert!(!sees(light, last), "{light} {last}");
        let [x, y, z] = random(k, 3);
        let between = Vec3::new(length + x * width, 0.1 + 2.3 * y, width + z * middle);
        seen[0] += usize::from(sees(light, between));
        seen[1] += usize::from(sees(between, last));
    }
    assert!(seen.iter().all(|count| *count > 50), "{seen:?}");
}

#[test]
fn any_scene_can_have_a_ground_plane() {
    for spec in ["cornell", "atrium", "city:150000", "office", "sealed-box", "furnace", "rooms", "stripes", "corridor"]
    {
        let without = build(spec);
        let name = spec.split(':').next().unwrap_or_default();
        let with = build(&match spec.split_once(':') {
            Some((name, count)) => format!("{name}:{count},ground=1000"),
            None => format!("{name}:ground=1000"),
        });
        let (low, high) = with.scene.geometry.bounds;
        assert!((high - low - Vec3::new(1000.0, 0.0, 1000.0)).with_y(0.0).length() < 1e-3, "{spec}: {low} {high}");
        assert!((without.scene.geometry.bounds.0.y - low.y - 0.01).abs() < 1e-5, "{spec}");
        assert_near(area(&with, "earth") * 1e-6, 1.0, spec);
        assert_eq!(with.scene.geometry.triangles.len(), without.scene.geometry.triangles.len() + 2);
        assert_eq!((with.view, &with.name), (without.view, &without.name));
        assert_ne!(with.content_hash, without.content_hash);
    }
}

#[test]
fn albedos_are_those_of_rooms() {
    for name in procedural::STRESS_SCENES {
        for material in build(name).scene.materials.iter() {
            let albedo = material.albedo;
            assert!(albedo.min_element() >= 0.2 && albedo.max_element() <= 0.8, "{name}: {albedo}");
        }
    }
}

#[test]
fn what_is_no_parameter_is_said() {
    for (spec, words) in [
        ("chairs", vec!["not known", "rooms", "corridor"]),
        ("rooms:height=3", vec!["no parameter height", "wall", "doorway", "ground"]),
        ("rooms:wall=7", vec!["\"7\"", "thickness", "0 to 0.3"]),
        ("rooms:wall=NaN", vec!["NaN", "0 to 0.3"]),
        ("rooms:wall=0.1,wall=0.2", vec!["wall", "twice"]),
        ("stripes:stripes=1.5", vec!["1.5", "0 to 6"]),
        ("rooms:", vec!["fixed number of triangles"]),
        ("office:2000", vec!["fixed number of triangles"]),
        ("atrium:5", vec!["not a number of triangles", "3000"]),
    ] {
        let error = procedural::build(spec).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(words.iter().all(|word| error.contains(word)), "{spec}: {error}");
    }
    let count = |spec: &str| build(spec).scene.geometry.triangles.len();
    assert_eq!(count("atrium:triangles=5000"), count("atrium:5000"));
    let help = procedural::help();
    for scene in &procedural::BUILT_IN {
        assert!(help.contains(scene.name) && scene.parameters.iter().all(|p| help.contains(p.name)), "{}", scene.name);
    }
    assert!(help.contains("ground") && procedural::STRESS_SCENES.iter().all(|name| procedural::NAMES.contains(name)));
}
