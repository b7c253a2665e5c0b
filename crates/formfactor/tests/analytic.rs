//! Closed forms of form factors: built-in ones and every row of ../shared/reference/form_factors.csv.

use std::f64::consts::PI;
use std::ops::ControlFlow;
use std::path::Path;

use glam::{Quat, Vec3};
use patchlight_formfactor::{AreaToArea, Contour, Estimator, Hemisphere, Patch, Polygon, Surfaces, form_factors};
use scene::gpu::{Triangle, TriangleUv};
use scene::{Material, Scene, SceneParts, SurfacePoint};

/// The receiver of a case.
enum From {
    Patch(Vec<Vec3>),
    Point(Vec3, Vec3),
}

struct Case {
    name: String,
    from: From,
    /// One or more polygons; the form factor is that of all together.
    to: Vec<Vec<Vec3>>,
    expected: f64,
}

fn case(name: &str, from: From, to: Vec<Vec<Vec3>>, expected: f64) -> Case {
    Case { name: name.into(), from, to, expected }
}

fn v(x: f64, y: f64, z: f64) -> Vec3 {
    Vec3::new(x as f32, y as f32, z as f32)
}

fn fan(corners: &[Vec3], source: u32) -> Vec<Triangle> {
    (2..corners.len())
        .map(|k| Triangle {
            corner: corners[0],
            edge_a: corners[k - 1] - corners[0],
            edge_b: corners[k] - corners[0],
            source,
            ..Triangle::default()
        })
        .collect()
}

/// `count` points spread over a polygon, equal areas.
fn spread(polygon: &Polygon, count: u32, seed: u32) -> Vec<SurfacePoint> {
    let shift = (scene::sampling::hash(2 * seed), scene::sampling::hash(2 * seed + 1));
    let corners = polygon.corners();
    (0..count)
        .map(|k| {
            let word = |step: u32, shift: u32| scene::sampling::unit(k.wrapping_mul(step).wrapping_add(shift));
            let mut x = word(0xc13f_a9a9, shift.0);
            let y = word(0x91e1_0da6, shift.1);
            let triangles: Vec<_> =
                (2..corners.len()).map(|c| (corners[c - 1] - corners[0], corners[c] - corners[0])).collect();
            let areas: Vec<f32> =
                triangles.iter().map(|(a, b)| (0.5 * a.cross(*b).length() / polygon.area) as f32).collect();
            let mut at = 0;
            while at + 1 < areas.len() && x >= areas[at] {
                x -= areas[at];
                at += 1;
            }
            let (u, w) = scene::sampling::uniform_triangle(((x / areas[at]).min(0.999_999), y));
            let (a, b) = triangles[at];
            SurfacePoint {
                position: (corners[0] + a * f64::from(u) + b * f64::from(w)).as_vec3(),
                patch: 0,
                normal: polygon.normal.as_vec3(),
                weight: 1.0 / count as f32,
            }
        })
        .collect()
}

/// Form factor of a case by an estimator, with real rays against the polygons: the mean of `row_count` independent
/// rows.
fn estimate(case: &Case, estimator: &dyn Estimator, row_count: u32, point_count: u32) -> f64 {
    let polygons_to: Vec<Polygon> = case.to.iter().map(|c| Polygon::new(c).unwrap()).collect();
    let mut triangles: Vec<Triangle> = case.to.iter().enumerate().flat_map(|(k, c)| fan(c, k as u32)).collect();
    let (rows, points) = match &case.from {
        From::Point(position, normal) => {
            let point = SurfacePoint { position: *position, patch: 0, normal: *normal, weight: 1.0 };
            (vec![], vec![point; row_count as usize])
        }
        From::Patch(corners) => {
            let polygon = Polygon::new(corners).unwrap();
            triangles.extend(fan(corners, u32::MAX));
            let points = (0..row_count).flat_map(|row| spread(&polygon, point_count, row)).collect();
            (vec![polygon; row_count as usize], points)
        }
    };
    let uvs = vec![TriangleUv::default(); triangles.len()];
    let scene =
        Scene::new(SceneParts { triangles, uvs, materials: vec![Material::default()], ..SceneParts::default() })
            .unwrap();
    let patches: Vec<Patch> = polygons_to
        .iter()
        .map(|p| Patch { centroid: p.centroid.as_vec3(), area: p.area as f32, normal: p.normal.as_vec3(), triangle: 0 })
        .collect();
    let offsets: Vec<u32> = (0..=row_count).map(|row| row * (points.len() as u32 / row_count)).collect();
    let surfaces = Surfaces {
        patches: &patches,
        polygons: &polygons_to,
        row_polygons: &rows,
        points: &points,
        offsets: &offsets,
        visibility: &scene,
        owner: Box::new(|hit, direction| {
            let front = scene.tables().normal(hit.triangle).dot(direction) < 0.0;
            if front { scene.geometry.triangles[hit.triangle as usize].source } else { u32::MAX }
        }),
        ray_offset: scene.geometry.ray_offset,
        seed: 0,
    };
    let rows = form_factors(estimator, &surfaces, &|_, _| ControlFlow::Continue(())).unwrap();
    rows.factors.values.iter().map(|&f| f64::from(f)).sum::<f64>() / f64::from(row_count)
}

/// Relative errors of Contour, AreaToArea and Hemisphere.
fn errors(case: &Case) -> [f64; 3] {
    let contour = Contour { sky_rays: 1, ..Contour::default() };
    let area = AreaToArea { sky_rays: 1, ..AreaToArea::default() };
    // Rays enough that a per cent of the hits is more than their noise, in 32 rows.
    let rays = ((5_000.0 / case.expected) as u32).next_power_of_two().clamp(1 << 13, 1 << 19);
    let found = [
        estimate(case, &contour, 1, 1),
        estimate(case, &area, 1, 1),
        estimate(case, &Hemisphere { rays }, 32, rays / 16),
    ];
    found.map(|f| f / case.expected - 1.0)
}

const TOLERANCE: [f64; 3] = [1e-3, 5e-3, 1e-2];

/// Prints the table and names what lies outside the tolerances.
fn check(cases: &[Case]) -> Vec<String> {
    println!("{:>9} {:>9} {:>9}  {:>12}  case", "contour", "area", "hemi", "exact");
    let mut bad = Vec::new();
    for case in cases {
        let e = errors(case);
        println!(
            "{:8.4}% {:8.4}% {:8.4}%  {:12.9}  {}",
            100.0 * e[0],
            100.0 * e[1],
            100.0 * e[2],
            case.expected,
            case.name
        );
        for (k, estimator) in ["Contour", "AreaToArea", "Hemisphere"].iter().enumerate() {
            if e[k].is_nan() || e[k].abs() > TOLERANCE[k] {
                bad.push(format!("{estimator} is {:.4} % off: {}", 100.0 * e[k], case.name));
            }
        }
    }
    bad
}

fn rectangle(corner: Vec3, a: Vec3, b: Vec3) -> Vec<Vec3> {
    vec![corner, corner + a, corner + a + b, corner + b]
}

/// Howell C-11: identical parallel rectangles a × b at distance c.
fn parallel_rectangles(a: f64, b: f64, c: f64) -> f64 {
    let x = a / c;
    let y = b / c;
    let x1 = (1.0 + x * x).sqrt();
    let y1 = (1.0 + y * y).sqrt();
    2.0 / (PI * x * y)
        * ((x1 * x1 * y1 * y1 / (1.0 + x * x + y * y)).sqrt().ln()
            + x * y1 * (x / y1).atan()
            + y * x1 * (y / x1).atan()
            - x * x.atan()
            - y * y.atan())
}

/// Howell C-14: from width w to height h, common edge l, at a right angle.
fn perpendicular_rectangles(w: f64, h: f64, l: f64) -> f64 {
    let h = h / l;
    let w = w / l;
    let h2 = h * h;
    let w2 = w * w;
    let s = (h2 + w2).sqrt();
    let logs = ((1.0 + w2) * (1.0 + h2) / (1.0 + w2 + h2)).ln()
        + w2 * (w2 * (1.0 + w2 + h2) / ((1.0 + w2) * (w2 + h2))).ln()
        + h2 * (h2 * (1.0 + h2 + w2) / ((1.0 + h2) * (h2 + w2))).ln();
    (w * (1.0 / w).atan() + h * (1.0 / h).atan() - s * (1.0 / s).atan() + 0.25 * logs) / (PI * w)
}

/// Howell B-3: point below the corner of a parallel rectangle a × b at distance c.
fn point_parallel(a: f64, b: f64, c: f64) -> f64 {
    let x = a / c;
    let y = b / c;
    let x1 = (1.0 + x * x).sqrt();
    let y1 = (1.0 + y * y).sqrt();
    (x / x1 * (y / x1).atan() + y / y1 * (x / y1).atan()) / (2.0 * PI)
}

/// Howell B-4: point in the plane at a right angle to a rectangle of height a and width b, at distance c from its
/// corner.
fn point_perpendicular(a: f64, b: f64, c: f64) -> f64 {
    let x = a / b;
    let y = c / b;
    let s = (x * x + y * y).sqrt();
    ((1.0 / y).atan() - y / s * (1.0 / s).atan()) / (2.0 * PI)
}

/// A disc of radius r in the plane z, as triangles with the disc's area, seen from below.
fn disc(r: f64, z: f64, facing_down: bool) -> Vec<Vec<Vec3>> {
    let n = 256;
    let step = 2.0 * PI / f64::from(n);
    let r = r * (step / step.sin()).sqrt();
    let rim = |k: i32| v(r * (f64::from(k) * step).cos(), r * (f64::from(k) * step).sin(), z);
    (0..n)
        .map(|k| {
            if facing_down {
                vec![v(0.0, 0.0, z), rim(k + 1), rim(k)]
            } else {
                vec![v(0.0, 0.0, z), rim(k), rim(k + 1)]
            }
        })
        .collect()
}

fn built_in() -> Vec<Case> {
    let floor = |a: f64, b: f64| rectangle(Vec3::ZERO, v(a, 0.0, 0.0), v(0.0, b, 0.0));
    let ceiling = |a: f64, b: f64, c: f64| rectangle(v(0.0, 0.0, c), v(0.0, b, 0.0), v(a, 0.0, 0.0));
    let wall = |h: f64, l: f64| rectangle(Vec3::ZERO, v(0.0, l, 0.0), v(0.0, 0.0, h));
    let mut cases = Vec::new();
    for (a, b, c) in [(1.0, 1.0, 1.0), (1.0, 1.0, 0.02), (3.0, 2.0, 0.7), (0.2, 5.0, 1.5)] {
        let name = format!("parallel rectangles {a} x {b} at {c}");
        cases.push(case(&name, From::Patch(floor(a, b)), vec![ceiling(a, b, c)], parallel_rectangles(a, b, c)));
    }
    for (w, h, l) in [(1.0, 1.0, 1.0), (2.0, 1.0, 3.0), (0.05, 2.0, 1.0)] {
        let name = format!("perpendicular rectangles, width {w} to height {h}, edge {l}");
        cases.push(case(&name, From::Patch(floor(w, l)), vec![wall(h, l)], perpendicular_rectangles(w, h, l)));
    }
    let sides = vec![
        wall(1.0, 1.0),
        rectangle(v(1.0, 0.0, 0.0), v(0.0, 0.0, 1.0), v(0.0, 1.0, 0.0)),
        rectangle(Vec3::ZERO, v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0)),
        rectangle(v(0.0, 1.0, 0.0), v(1.0, 0.0, 0.0), v(0.0, 0.0, 1.0)),
    ];
    let around = 1.0 - parallel_rectangles(1.0, 1.0, 1.0);
    cases.push(case("cube, floor to the four walls", From::Patch(floor(1.0, 1.0)), sides.clone(), around));
    let all = [sides, vec![ceiling(1.0, 1.0, 1.0)]].concat();
    cases.push(case("cube, floor to all other faces", From::Patch(floor(1.0, 1.0)), all, 1.0));
    let up = |x: f64| From::Point(v(x, 0.0, 0.0), Vec3::Z);
    for (a, b, c) in [(1.0, 1.0, 1.0), (4.0, 1.0, 0.5)] {
        let name = format!("point to parallel rectangle {a} x {b} at {c}");
        cases.push(case(&name, up(0.0), vec![ceiling(a, b, c)], point_parallel(a, b, c)));
        let name = format!("point to perpendicular rectangle {a} x {b} at {c}");
        cases.push(case(&name, up(c), vec![wall(a, b)], point_perpendicular(a, b, c)));
    }
    for (r, h) in [(1.0, 1.0), (0.5, 2.0)] {
        // Howell B-12: point on the axis of a disc.
        let name = format!("point to disc of radius {r} at {h}");
        cases.push(case(&name, up(0.0), disc(r, h, true), r * r / (r * r + h * h)));
    }
    // Howell C-41: coaxial discs; one sector stands for the whole disc.
    let r1 = 1.0f64;
    let r2 = 0.8f64;
    let h = 0.6f64;
    let x = r1 / h;
    let y = r2 / h;
    let s = 1.0 + (1.0 + y * y) / (x * x);
    let expected = 0.5 * (s - (s * s - 4.0 * (y / x) * (y / x)).sqrt());
    cases.push(case("coaxial discs", From::Patch(disc(r1, 0.0, false).remove(0)), disc(r2, h, true), expected));
    // A turned, moved and enlarged pair has the form factor of the plain one.
    let rotation = Quat::from_axis_angle(v(0.48, 0.6, 0.64), 1.1);
    let moved = |c: Vec<Vec3>| c.iter().map(|&p| rotation * p * 7.0 + v(3.0, -20.0, 11.0)).collect::<Vec<_>>();
    let expected = perpendicular_rectangles(1.0, 2.0, 1.5);
    let turned = From::Patch(moved(floor(1.0, 1.5)));
    cases.push(case("perpendicular rectangles, turned and enlarged", turned, vec![moved(wall(2.0, 1.5))], expected));
    cases
}

#[test]
fn built_in_closed_forms() {
    let cases = built_in();
    assert!(cases.len() >= 8);
    let bad = check(&cases);
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}

/// Fields of a line of CSV with quotes.
fn fields(line: &str) -> Vec<String> {
    let mut out = vec![String::new()];
    let mut quoted = false;
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => out.push(String::new()),
            _ => {
                if let Some(last) = out.last_mut() {
                    last.push(c);
                }
            }
        }
    }
    out
}

fn corners(text: &str) -> Vec<Vec3> {
    let numbers: Vec<[f64; 3]> = serde_json::from_str(text).unwrap();
    numbers.iter().map(|p| v(p[0], p[1], p[2])).collect()
}

#[test]
fn reference_table() {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/reference/form_factors.csv"));
    let Ok(text) = std::fs::read_to_string(path) else {
        println!("skipped: ../shared/reference/form_factors.csv is not there");
        return;
    };
    let cases: Vec<Case> = text
        .lines()
        .skip(1)
        .filter(|l| !l.is_empty())
        .map(|line| {
            let f = fields(line);
            let from = corners(&f[2]);
            let from = match f[1].as_str() {
                "point_to_patch" => From::Point(from[0], from[1].normalize()),
                "patch_to_patch" => From::Patch(from),
                other => panic!("unknown kind {other} of {}", f[0]),
            };
            Case { name: f[0].clone(), from, to: vec![corners(&f[3])], expected: f[4].parse().unwrap() }
        })
        .collect();
    assert!(cases.len() >= 30, "only {} rows", cases.len());
    let bad = check(&cases);
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}

#[test]
fn wrong_inputs_fail() {
    let right = || built_in().remove(0);
    assert!(check(&[right()]).is_empty());
    // Two per cent farther away.
    let mut far = right();
    far.to[0].iter_mut().for_each(|p| p.z *= 1.02);
    assert_eq!(check(&[far]).len(), 3);
    // The back of the source patch.
    let mut back = right();
    back.to[0].reverse();
    assert_eq!(check(&[back]).len(), 3);
    // The wrong answer.
    let mut other = right();
    other.expected *= 1.015;
    assert_eq!(check(&[other]).len(), 3);
}
