//! Walls without thickness: no light goes through them, along them or between them.
//!
//! Every scene is made here, baked with both kinds of patches, and asked for indirect irradiance at points (rows of
//! their own) and in pictures (receivers on the mesh). Where all light is kept out the bound is 10⁻⁴ of what is
//! outside; where some comes round a corner the path tracer says how much.

use assets::import::LoadedScene;
use assets::procedural;
use glam::{Vec3, vec3};
use integration_tests::setup::Setup;
use patches::PatchKind;
use patchlight::light::with_lights;
use patchlight::{Estimator, PictureRenderer};
use reference::metrics::quantile;
use reference::{PathSettings, PathTracer};
use runtime::executor::{DeviceChoice, open};
use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_POINT, Triangle, TriangleUv};
use scene::math::luminance;
use scene::{Camera, Light, Material, NONE, Scene, SceneParts, Sky, SurfacePoint, is_open};
use std::f32::consts::PI;
use transport::kernel::grid::cell_corners;

/// Patches of every scene.
const COUNT: usize = 1000;
/// Paths of the path tracer at a point: its standard error is 1 to 3 %.
const PATHS: u32 = 16_384;
/// Reflectance of everything.
const ALBEDO: f32 = 0.6;
/// Edge of the pictures, pixels.
const SIZE: u32 = 24;
/// A closed space may hold this share of the light outside.
const DARK: f32 = 1e-4;

/// Collects parallelograms and lights.
#[derive(Clone)]
struct Build {
    parts: SceneParts,
}

impl Build {
    fn new() -> Self {
        let plain = Material { albedo: Vec3::splat(ALBEDO), ..Material::default() };
        Self { parts: SceneParts { materials: vec![plain], ..SceneParts::default() } }
    }

    fn quad(&mut self, corner: Vec3, a: Vec3, b: Vec3) -> &mut Self {
        let material = self.parts.materials.len() as u32 - 1;
        for (edge_a, edge_b) in [(a, a + b), (a + b, b)] {
            let source = self.parts.triangles.len() as u32;
            self.parts.triangles.push(Triangle { corner, material, edge_a, source, edge_b, object: 0 });
            self.parts.uvs.push(TriangleUv::default());
        }
        self
    }

    /// Six walls, the fronts inside: y = low, y = high, x = low, x = high, z = low, z = high.
    fn cuboid(&mut self, low: Vec3, high: Vec3) -> &mut Self {
        let d = high - low;
        let x = Vec3::X * d.x;
        let y = Vec3::Y * d.y;
        let z = Vec3::Z * d.z;
        self.quad(low, z, x).quad(high, -x, -z).quad(low, y, z).quad(high, -z, -y).quad(low, x, y).quad(high, -y, -x)
    }

    fn light(&mut self, light: Light) -> &mut Self {
        self.parts.lights.push(light);
        self
    }

    fn sun(&mut self) -> &mut Self {
        let direction = vec3(0.4, -1.0, -0.3).normalize();
        self.light(Light { kind: LIGHT_DIRECTIONAL, direction, color: Vec3::splat(30.0), ..Light::default() })
    }

    fn lamp(&mut self, position: Vec3) -> &mut Self {
        self.light(Light { kind: LIGHT_POINT, position, color: Vec3::splat(5.0), ..Light::default() })
    }

    fn sky(&mut self) -> &mut Self {
        self.parts.sky = Sky { radiance: Vec3::ONE, ..Sky::default() };
        self
    }

    /// The scene with a triangle less.
    fn without(&self, triangle: usize) -> Self {
        let mut other = self.clone();
        other.parts.triangles.remove(triangle);
        other.parts.uvs.remove(triangle);
        other
    }

    fn scene(&self) -> Scene {
        Scene::new(self.parts.clone()).unwrap()
    }
}

fn point(position: Vec3, normal: Vec3) -> SurfacePoint {
    SurfacePoint { position, patch: NONE, normal, weight: 1.0 }
}

/// Points on a parallelogram on the side of a normal, in a grid whose outermost points lie `margin` m from the rim.
fn points(corner: Vec3, a: Vec3, b: Vec3, normal: Vec3, margin: f32, steps: u32) -> Vec<SurfacePoint> {
    let place = |edge: Vec3, k: u32| {
        let length = edge.length();
        edge / length * (margin + (length - 2.0 * margin) * k as f32 / (steps - 1) as f32)
    };
    (0..steps * steps).map(|k| point(corner + place(a, k % steps) + place(b, k / steps), normal)).collect()
}

/// Points on the walls of a cuboid, on the inside or the outside.
fn wall_points(low: Vec3, high: Vec3, inside: bool, margin: f32) -> Vec<SurfacePoint> {
    let d = high - low;
    (0..6)
        .flat_map(|wall| {
            let axis = wall / 2;
            let is_high = wall % 2 == 1;
            let a = Vec3::AXES[(axis + 1) % 3];
            let b = Vec3::AXES[(axis + 2) % 3];
            let corner = if is_high { low + Vec3::AXES[axis] * d[axis] } else { low };
            let inwards = if is_high { -Vec3::AXES[axis] } else { Vec3::AXES[axis] };
            points(corner, a * d.dot(a), b * d.dot(b), if inside { inwards } else { -inwards }, margin, 5)
        })
        .collect()
}

struct Baked {
    classic: PictureRenderer,
    lights: Vec<Light>,
    /// Edge of the pictures, pixels.
    size: u32,
}

impl Baked {
    fn new(build: &Build, patches: PatchKind) -> Self {
        Self::of_count(build, patches, COUNT)
    }

    fn of_count(build: &Build, patches: PatchKind, patch_count: usize) -> Self {
        Self::of_size(build, patches, patch_count, SIZE)
    }

    fn of_size(build: &Build, patches: PatchKind, patch_count: usize, size: u32) -> Self {
        let loaded = LoadedScene { scene: build.scene(), ..procedural::build("furnace").unwrap() };
        let settings = Setup {
            patches,
            patch_count,
            estimator: Estimator::Hemisphere { rays: 512 },
            bounces: None,
            most_receivers: None,
            receiver_rays: 256,
            sub_frames: 2,
            seed: 5,
            size: (size, size),
            ..Setup::default()
        };
        let executor = open(&DeviceChoice::Cpu).unwrap().0;
        let classic = settings.renderer(&loaded, executor).unwrap();
        Self { classic, lights: build.parts.lights.clone(), size }
    }

    /// Indirect irradiance of all pixels, by the receivers on the mesh.
    fn seen(&mut self, eye: Vec3, target: Vec3) -> Vec<f32> {
        let up = if (target - eye).normalize().y.abs() > 0.9 { Vec3::Z } else { Vec3::Y };
        let camera = Camera::look_at(eye, target, up, 90.0, self.size, self.size);
        let lighting = with_lights(self.classic.light().bake().scene(), &self.lights);
        let picture = self.classic.picture(&lighting, &camera, 0).unwrap().pictures.indirect;
        picture.pixels.iter().map(|p| luminance(*p) * PI / ALBEDO).collect()
    }

    /// Indirect irradiance at points, by rows of their own.
    fn at(&mut self, points: &[SurfacePoint]) -> Vec<f32> {
        self.seen(Vec3::ZERO, Vec3::X);
        self.classic.light_mut().irradiance_at(points).unwrap().into_iter().map(luminance).collect()
    }
}

fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len() as f32
}

fn greatest(values: &[f32]) -> f32 {
    values.iter().copied().fold(0.0, f32::max)
}

/// Brightest point and brightest pixel of a closed space, for six views from its middle, as shares of the mean of
/// bright points.
fn leak(build: &Build, kind: PatchKind, dark: &[SurfacePoint], middle: Vec3, bright: &[SurfacePoint]) -> (f32, f32) {
    let mut baked = Baked::new(build, kind);
    let outside = mean(&baked.at(bright));
    let by_points = greatest(&baked.at(dark)) / outside;
    let views = [Vec3::X, Vec3::Y, Vec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
    let by_pixels = views.map(|way| greatest(&baked.seen(middle, middle + way))).fold(0.0, f32::max) / outside;
    println!("{kind:?}: outside {outside:.3} W/m², inside {by_points:.1e} (points) {by_pixels:.1e} (pixels) of it");
    (by_points, by_pixels)
}

/// A space must be dark, and, with a triangle of its walls taken out, must not.
fn check_dark(
    build: &Build,
    hole: usize,
    kind: PatchKind,
    (low, high): (Vec3, Vec3),
    bright: &[SurfacePoint],
) -> Result<(), String> {
    let dark = wall_points(low, high, true, 0.02);
    let of = |build: &Build| leak(build, kind, &dark, 0.5 * (low + high), bright);
    let open = of(&build.without(hole));
    assert!(open.0 > 100.0 * DARK && open.1 > 100.0 * DARK, "a space with a hole is as dark: {open:?}");
    let closed = of(build);
    if closed.0.max(closed.1) < DARK { Ok(()) } else { Err(format!("{closed:?} of the light outside comes in")) }
}

/// Errors at points against the path tracer, relative to the greater of its value and `floor` W/m²; beyond what its
/// noise explains (3 σ).
fn errors(truth: &Build, ours: &mut Baked, points: &[SurfacePoint], floor: f32) -> Vec<f64> {
    let scene = truth.scene();
    let truth = PathTracer::new(&scene).irradiance(points, PATHS, &PathSettings::default());
    (ours.at(points).iter().zip(&truth))
        .map(|(o, t)| {
            let (t, sigma) = (luminance(t.indirect), luminance(t.indirect_error));
            f64::from(((o - t).abs() - 3.0 * sigma).max(0.0) / t.max(floor))
        })
        .collect()
}

/// Greatest of the errors up to these quantiles.
fn check_errors(mut errors: Vec<f64>, limits: &[(f64, f64)]) -> Result<(), String> {
    for &(q, limit) in limits {
        let found = quantile(&mut errors, q);
        println!("    {:.0} % of the points are within {:.1} %", 100.0 * q, 100.0 * found);
        if found > limit {
            return Err(format!("quantile {q} of the errors is {found}, above {limit}"));
        }
    }
    Ok(())
}

const LOW: Vec3 = vec3(-1.0, 0.5, -1.0);
const HIGH: Vec3 = vec3(1.0, 2.5, 1.0);

/// A closed box of 2 m above a ground that throws light at it.
fn sealed_box() -> Build {
    let mut b = Build::new();
    b.cuboid(LOW, HIGH).quad(vec3(-5.0, 0.0, -5.0), 10.0 * Vec3::Z, 10.0 * Vec3::X);
    b
}

fn check_sealed_box(build: &Build, kind: PatchKind) -> Result<(), String> {
    // The other sides of the same upright walls.
    let mut outside = wall_points(LOW, HIGH, false, 0.02);
    outside.retain(|p| p.normal.y.abs() < 0.5);
    check_dark(build, 4, kind, (LOW, HIGH), &outside)
}

/// Lights of the sealed box: a sun, a sky.
fn outdoors() -> [Build; 2] {
    [sealed_box().sun().clone(), sealed_box().sky().clone()]
}

#[test]
fn sealed_box_of_polygons() {
    for build in outdoors() {
        check_sealed_box(&build, PatchKind::Polygon).unwrap();
    }
}

#[test]
fn sealed_box_of_clusters() {
    for build in outdoors() {
        check_sealed_box(&build, PatchKind::Cluster).unwrap();
    }
}

const LIT_ROOM: (Vec3, Vec3) = (vec3(-3.0, 0.0, -1.5), vec3(0.0, 2.5, 1.5));
const DARK_ROOM: (Vec3, Vec3) = (vec3(0.0, 0.0, -1.5), vec3(3.0, 2.5, 1.5));

/// Two rooms with a wall between, a lamp in one.
fn check_rooms(kind: PatchKind) -> Result<(), String> {
    let mut b = Build::new();
    b.quad(vec3(0.0, 0.0, -1.5), 2.5 * Vec3::Y, 3.0 * Vec3::Z);
    // Without the walls at x = 0, which is there already.
    let first = b.cuboid(LIT_ROOM.0, LIT_ROOM.1).parts.triangles.len();
    b = b.without(first - 6).without(first - 6);
    let first = b.cuboid(DARK_ROOM.0, DARK_ROOM.1).parts.triangles.len();
    b = b.without(first - 8).without(first - 8);
    b.lamp(vec3(-1.4, 1.9, 0.3));
    check_dark(&b, 0, kind, DARK_ROOM, &wall_points(LIT_ROOM.0, LIT_ROOM.1, true, 0.02))
}

#[test]
fn two_rooms_of_polygons() {
    check_rooms(PatchKind::Polygon).unwrap();
}

#[test]
fn two_rooms_of_clusters() {
    check_rooms(PatchKind::Cluster).unwrap();
}

/// A room with a nook behind two thin walls that meet; light comes round the free end of one. Without the first wall
/// when `is_open`.
fn nook(is_open: bool) -> Build {
    let mut b = Build::new();
    if !is_open {
        b.quad(vec3(-0.5, 0.0, 0.0), 1.5 * Vec3::X, 2.5 * Vec3::Y);
    }
    b.quad(vec3(1.0, 0.0, 0.0), 2.0 * Vec3::Z, 2.5 * Vec3::Y);
    // Floor and ceiling are cut where the walls stand.
    for (x, width) in [(-2.0, 1.5), (-0.5, 1.5), (1.0, 1.0)] {
        for z in [-2.0, 0.0] {
            let a = Vec3::X * width;
            let c = 2.0 * Vec3::Z;
            b.quad(vec3(x, 0.0, z), c, a).quad(vec3(x, 2.5, z), a, c);
        }
    }
    let x = 4.0 * Vec3::X;
    let y = 2.5 * Vec3::Y;
    let z = 4.0 * Vec3::Z;
    let low = vec3(-2.0, 0.0, -2.0);
    let high = vec3(2.0, 2.5, 2.0);
    b.quad(low, y, z).quad(high, -z, -y).quad(low, x, y).quad(high, -y, -x);
    b.lamp(vec3(-0.8, 1.6, -1.2));
    b
}

/// Points on both sides of both walls, from the free end to the corner, and on the floor beside them.
fn nook_points() -> Vec<SurfacePoint> {
    let mut points = Vec::new();
    for along in [0.02, 0.1, 0.3, 0.75, 1.2, 1.4, 1.48] {
        for height in [0.03, 1.2, 2.47] {
            for side in [1.0, -1.0] {
                points.push(point(vec3(along - 0.5, height, 0.0), side * Vec3::Z));
                points.push(point(vec3(1.0, height, along), side * Vec3::X));
            }
        }
        for off in [-0.03, 0.03] {
            points.push(point(vec3(along - 0.5, 0.0, off), Vec3::Y));
            points.push(point(vec3(1.0 + off, 0.0, along), Vec3::Y));
        }
    }
    points
}

fn check_nook(kind: PatchKind, median: f64, p90: f64) -> Result<(), String> {
    println!("nook of {kind:?}");
    let mut ours = Baked::new(&nook(false), kind);
    let of = |truth: &Build, ours: &mut Baked| {
        check_errors(errors(truth, ours, &nook_points(), 0.04), &[(0.5, median), (0.9, p90)])
    };
    assert!(of(&nook(true), &mut ours).is_err(), "a missing wall goes unnoticed");
    of(&nook(false), &mut ours)
}

#[test]
fn light_round_a_corner_of_polygons() {
    check_nook(PatchKind::Polygon, 0.02, 0.1).unwrap();
}

#[test]
fn light_round_a_corner_of_clusters() {
    check_nook(PatchKind::Cluster, 0.02, 0.1).unwrap();
}

/// A room with a slit in its ceiling, and a screen on its floor beside where the sun will come through the slit.
fn slit() -> Build {
    let mut b = Build::new();
    let low = vec3(-3.0, 0.0, -3.0);
    let high = vec3(3.0, 3.0, 3.0);
    let x = 6.0 * Vec3::X;
    let y = 3.0 * Vec3::Y;
    let z = 6.0 * Vec3::Z;
    b.quad(low, z, x).quad(low, y, z).quad(high, -z, -y).quad(low, x, y).quad(high, -y, -x);
    for (from, to) in [(-3.0, 0.3), (0.9, 3.0)] {
        b.quad(vec3(from, 3.0, -3.0), (to - from) * Vec3::X, z);
    }
    b.quad(low.with_x(0.0), 2.2 * Vec3::Y, z);
    b
}

/// Points on the floor between the screen and the sun's spot: they see the screen, which sees the floor.
fn shade_points() -> Vec<SurfacePoint> {
    let place = |k: u32| vec3(0.04 + 0.2 * (k % 4) as f32 / 3.0, 0.0, -2.5 + 5.0 * (k / 4) as f32 / 10.0);
    (0..44).map(|k| point(place(k), Vec3::Y)).collect()
}

/// Patches of 1 m² lie on both sides of a sunbeam that the bake has not seen, elements of a sixth of that less so.
/// Half of the points are within 6.8 %; where elements gather from patches, within 9.9 %. Nine of ten are within 42 %:
/// they were within 40 % before the floor was cut at the foot of the screen, which gives other samples.
#[test]
fn sunbeam_that_the_bake_has_not_seen() {
    let mut build = slit();
    let mut ours = Baked::of_count(build.lamp(vec3(2.0, 2.0, 0.0)), PatchKind::Cluster, 150);
    let sun = Light { kind: LIGHT_DIRECTIONAL, direction: -Vec3::Y, color: Vec3::splat(30.0), ..Light::default() };
    let mut truth = slit();
    truth.light(sun);
    ours.lights = truth.parts.lights.clone();
    let check =
        |ours: &mut Baked| check_errors(errors(&truth, ours, &shade_points(), 0.01), &[(0.5, 0.08), (0.9, 0.45)]);
    check(&mut ours).unwrap();
    // A sunbeam a little more to the side.
    ours.lights[0].direction = vec3(-0.1, -1.0, 0.0).normalize();
    assert!(check(&mut ours).is_err(), "another sun goes unnoticed");
}

/// Two sheets of 1 m with 1 cm between them, in a room with a lamp on either side; their rim is closed, or not.
fn sheets(is_closed: bool) -> Build {
    let mut b = Build::new();
    let corner = vec3(-0.5, 0.8, 0.0);
    let x = Vec3::X;
    let y = Vec3::Y;
    let gap = 0.01 * Vec3::Z;
    b.quad(corner, x, y).quad(corner + gap, x, y);
    if is_closed {
        b.quad(corner, x, gap).quad(corner + y, x, gap).quad(corner, y, gap).quad(corner + x, y, gap);
    }
    b.cuboid(vec3(-2.0, 0.0, -2.0), vec3(2.0, 2.5, 2.0));
    b.lamp(vec3(-0.8, 1.6, -1.2)).lamp(vec3(0.8, 1.2, 1.2));
    b
}

/// Points of the sheets inside the gap, or outside.
fn sheet_points(inside: bool) -> Vec<SurfacePoint> {
    let sides = if inside { [(0.0, Vec3::Z), (0.01, -Vec3::Z)] } else { [(0.0, -Vec3::Z), (0.01, Vec3::Z)] };
    sides.into_iter().flat_map(|(z, n)| points(vec3(-0.5, 0.8, z), Vec3::X, Vec3::Y, n, 0.05, 5)).collect()
}

/// The outer faces as the path tracer sees them; inside no more than `limit` of the light outside too much.
fn check_sheets(is_closed: bool, kind: PatchKind, limit: f64) -> Result<(), String> {
    println!("sheets of {kind:?}, closed: {is_closed}");
    let build = sheets(is_closed);
    let mut ours = Baked::new(&build, kind);
    let outside = mean(&ours.at(&sheet_points(false)));
    check_errors(errors(&build, &mut ours, &sheet_points(false), 0.05 * outside), &[(0.5, 0.03), (1.0, 0.1)])?;
    // One sheet alone has no dark side.
    let mut alone = Baked::new(&build.without(2).without(2), kind);
    let gap = |baked: &mut Baked| check_errors(errors(&build, baked, &sheet_points(true), outside), &[(1.0, limit)]);
    assert!(gap(&mut alone).is_err(), "an open side goes unnoticed");
    gap(&mut ours)
}

#[test]
fn sheets_of_polygons() {
    check_sheets(true, PatchKind::Polygon, f64::from(DARK)).unwrap();
}

#[test]
fn sheets_of_clusters() {
    check_sheets(true, PatchKind::Cluster, f64::from(DARK)).unwrap();
}

/// Patches are as wide as the gap is deep: what is lit at the rim shines along it.
#[test]
fn open_sheets_of_polygons() {
    check_sheets(false, PatchKind::Polygon, 0.25).unwrap();
}

#[test]
fn open_sheets_of_clusters() {
    check_sheets(false, PatchKind::Cluster, 0.2).unwrap();
}

const HOUSING: (Vec3, Vec3) = (vec3(-0.3, 1.8, -0.3), vec3(0.3, 2.1, 0.3));

/// A room with a bright panel in a housing that is open below; without the housing's sides when `is_open`.
fn luminaire(is_open: bool) -> Build {
    let mut b = Build::new();
    let d = HOUSING.1 - HOUSING.0;
    let low = HOUSING.0;
    let x = Vec3::X * d.x;
    let y = Vec3::Y * d.y;
    let z = Vec3::Z * d.z;
    b.quad(low + y, x, z);
    if !is_open {
        b.quad(low, x, y).quad(low + z, x, y).quad(low, z, y).quad(low + x, z, y);
    }
    b.cuboid(vec3(-2.0, 0.0, -2.0), vec3(2.0, 2.5, 2.0));
    b.parts.materials.push(Material { radiance: Vec3::splat(20.0), ..b.parts.materials[0] });
    b.quad(vec3(-0.2, 2.05, -0.2), 0.4 * Vec3::X, 0.4 * Vec3::Z);
    b
}

fn check_luminaire(kind: PatchKind) -> Result<(), String> {
    println!("luminaire of {kind:?}");
    let mut outside = wall_points(HOUSING.0, HOUSING.1, false, 0.02);
    outside.retain(|p| p.normal.y > -0.5);
    let mut ours = Baked::new(&luminaire(false), kind);
    let inside = mean(&ours.at(&points(HOUSING.0, 0.6 * Vec3::X, 0.3 * Vec3::Y, Vec3::Z, 0.02, 5)));
    let of =
        |truth: &Build, ours: &mut Baked| check_errors(errors(truth, ours, &outside, 0.0), &[(0.5, 0.05), (1.0, 0.15)]);
    let level = mean(&ours.at(&outside));
    assert!(inside > 10.0 * level, "the inside is not bright: {inside} {level}");
    assert!(of(&luminaire(true), &mut ours).is_err(), "missing sides go unnoticed");
    of(&luminaire(false), &mut ours)
}

#[test]
fn luminaire_of_polygons() {
    check_luminaire(PatchKind::Polygon).unwrap();
}

#[test]
fn luminaire_of_clusters() {
    check_luminaire(PatchKind::Cluster).unwrap();
}

/// A room with a white wall, in front of it a bar of another albedo, 15 mm wide: narrower than the distance between
/// samples.
fn bar(albedo: f32) -> Build {
    let mut b = Build::new();
    b.cuboid(vec3(-2.0, 0.0, -2.0), vec3(2.0, 2.5, 2.0)).lamp(vec3(0.5, 1.9, 0.3));
    b.parts.materials.push(Material { albedo: Vec3::splat(albedo), ..b.parts.materials[0] });
    b.quad(vec3(-1.98, 0.3, 0.0), 1.8 * Vec3::Y, 0.015 * Vec3::Z);
    b
}

/// Patches next to a thin dark thing do not make it bright: points close in front of the bar, which see little else.
#[test]
fn thin_dark_bar_of_clusters() {
    let before = |k: u32| point(vec3(-1.975, 0.4 + 0.08 * k as f32, 0.0075), -Vec3::X);
    let points: Vec<SurfacePoint> = (0..20).map(before).collect();
    let mut ours = Baked::new(&bar(0.02), PatchKind::Cluster);
    let mut of = |truth: &Build| check_errors(errors(truth, &mut ours, &points, 0.0), &[(0.5, 0.3), (0.9, 0.6)]);
    assert!(of(&bar(ALBEDO)).is_err(), "a white bar goes unnoticed");
    of(&bar(0.02)).unwrap();
}

/// A room with a sheet so far before a wall; none for no distance.
fn poster(distance: Option<f32>) -> Build {
    let mut b = Build::new();
    b.cuboid(vec3(-2.0, 0.0, -2.0), vec3(2.0, 2.5, 2.0)).lamp(vec3(0.5, 1.9, 0.3));
    if let Some(distance) = distance {
        b.quad(vec3(distance - 2.0, 0.7, -0.6), 1.1 * Vec3::Y, 1.2 * Vec3::Z);
    }
    b
}

/// A sheet of the wall's own albedo that hardly stands off it changes nothing that is seen: neither it nor the wall
/// round it takes the darkness from between them.
fn check_poster(kind: PatchKind) {
    let seen = |distance: Option<f32>| {
        let mut baked = Baked::of_size(&poster(distance), kind, COUNT, 4 * SIZE);
        baked.seen(vec3(-0.9, 1.25, 0.0), vec3(-2.0, 1.25, 0.0))
    };
    let bare = seen(None);
    let dark_share = |pixels: &[f32]| {
        let dark = pixels.iter().zip(&bare).filter(|(a, b)| **a < 0.9 * **b);
        dark.count() as f64 / bare.len() as f64
    };
    let shadowed = dark_share(&seen(Some(0.2)));
    let two = dark_share(&seen(Some(0.002)));
    let one = dark_share(&seen(Some(0.0002)));
    println!("{kind:?}: dark pixels {one:.1e} at 0.2 mm, {two:.1e} at 2 mm, {shadowed:.1e} at 200 mm");
    assert!(shadowed > 0.01, "a sheet that casts a shadow goes unnoticed: {shadowed}");
    assert!(two.max(one) < 1.5e-3, "{one} {two}");
}

#[test]
fn dark_dots_round_a_poster_of_polygons() {
    check_poster(PatchKind::Polygon);
}

#[test]
fn dark_dots_round_a_poster_of_clusters() {
    check_poster(PatchKind::Cluster);
}

/// The faces of a doorway are 20 mm wide: most of their cells are far from all receivers.
#[test]
fn no_cell_beside_lit_ones_is_dark_where_light_comes() {
    let loaded = assets::load_or_build("rooms").unwrap();
    let bake = Setup { patch_count: 800, ..Setup::default() }.bake(&loaded).unwrap();
    let scene = bake.scene();
    let mesh = &bake.receivers().interpolation;
    let tables = scene.tables();
    let mut dark = Vec::new();
    for (triangle, grid) in (0u32..).zip(&mesh.grids) {
        for (first, side) in [(grid.front, 1.0), (grid.back, -1.0)].into_iter().filter(|own| own.0 != NONE) {
            let cells = &mesh.cells[first as usize..][..(grid.divisions * grid.divisions) as usize];
            if cells.iter().all(|cell| cell.first == NONE) {
                continue;
            }
            for (k, _) in (0u32..).zip(cells).filter(|(_, cell)| cell.first == NONE) {
                let (a, b, c) = cell_corners(grid.divisions, k);
                let middle = (a + b + c) / 3.0;
                let position = tables.position(triangle, middle.x, middle.y);
                let normal = side * tables.normal(triangle);
                // Some of the walls stand in others.
                if is_open(scene, &SurfacePoint { position, normal, patch: NONE, weight: 1.0 }, 64, k) {
                    dark.push(position);
                }
            }
        }
    }
    assert!(dark.is_empty(), "light comes to {dark:?}");
}
