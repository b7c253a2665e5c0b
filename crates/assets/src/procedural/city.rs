//! A city of any size: streets, kerbs, trees, cars and lamp posts, and houses whose every room is furnished and lit, in
//! the low sun. From a house of 18 m to the spoke of a bicycle's wheel of 4 mm it is a factor of 4,500.
//!
//! Walls and floors are 0.3 m thick, their middle planes lie at whole metres, and so do the bounds up to 2 cm: voxels
//! of one metre, or of a power of two of it, never hold both sides of a wall.

use glam::{Vec2, Vec3};
use scene::sampling::{hash3, unit};

use super::builder::{Builder, STANDING, steps};
use super::{Built, Parameter, pattern};
use crate::import::draft::MaterialDraft;
use crate::import::pictures::Source;
use crate::import::{Keyframe, Target, Track, View, lights};

mod furniture;
mod house;
mod street;

use house::House;

/// Number of triangles.
pub const TRIANGLES: Parameter = Parameter {
    name: "triangles",
    about: "triangles",
    default: 1_000_000.0,
    range: 125_000.0..=20_000_000.0,
    is_whole: true,
};
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[TRIANGLES];

/// Width of a street between two lots, m; of them the lanes in the middle take so much.
const STREET: f32 = 12.0;
const LANES: f32 = 7.0;
/// Edge of a lot, m.
const LOT: f32 = 44.0;
const PITCH: f32 = STREET + LOT;
/// Height of the lanes, of the pavements, and of what keeps the bounds from whole metres, m.
const ROAD: f32 = 0.02;
const PAVEMENT: f32 = 0.12;
/// The mast on one roof ends here, m: 24 m less [`ROAD`], so that the voxels' layers lie at whole metres.
const TOP: f32 = 24.0 - ROAD;
/// Corners of the four houses of a lot, m.
const HOUSES: [(f32, f32); 4] = [(1.0, 1.0), (25.0, 1.0), (1.0, 27.0), (25.0, 27.0)];

/// Their storeys, repeated: lots have about as many triangles each.
const STOREYS: [u32; 4] = [3, 4, 5, 5];

/// Random numbers of one thing, always the same.
pub(super) struct Dice {
    seed: u32,
    thrown: u32,
}

impl Dice {
    /// Random numbers of thing `a` of kind `b`.
    fn new(a: u32, b: u32) -> Self {
        Self { seed: hash3(a, b, 0x6369_7479), thrown: 0 }
    }

    /// In [0, 1).
    fn throw(&mut self) -> f32 {
        self.thrown += 1;
        unit(hash3(self.seed, self.thrown, 0x6469_6365))
    }

    /// In [low, high).
    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.throw()
    }

    /// 0 … count − 1.
    fn pick(&mut self, count: usize) -> usize {
        ((self.throw() * count as f32) as usize).min(count - 1)
    }
}

/// Amount of fine detail.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Detail {
    /// Walls, tables, beds.
    Low,
    /// All.
    High,
}

pub(super) struct Materials {
    asphalt: u32,
    paint: u32,
    paving: u32,
    kerb: u32,
    grass: u32,
    bark: u32,
    leaf: [u32; 3],
    facade: [u32; 5],
    roof: u32,
    white: u32,
    wall: [u32; 5],
    floor: [u32; 3],
    wood: u32,
    dark_wood: u32,
    metal: u32,
    dark: u32,
    ceramic: u32,
    fabric: [u32; 5],
    lamp: u32,
    street_lamp: u32,
    car: [u32; 4],
}

impl Materials {
    fn new(b: &mut Builder) -> Self {
        let textured =
            |name: &str, source: Source| MaterialDraft { albedo_picture: Some(source), ..MaterialDraft::new(name) };
        let shining = |name: &str, albedo: f32, radiance: Vec3| MaterialDraft {
            albedo: Vec3::splat(albedo),
            radiance,
            ..MaterialDraft::new(name)
        };
        Self {
            asphalt: b.plain("asphalt", [0.13, 0.13, 0.14]),
            paint: b.plain("road paint", [0.75, 0.75, 0.72]),
            paving: b.material(textured("paving", pattern::tiles())),
            kerb: b.plain("kerb", [0.45, 0.44, 0.42]),
            grass: b.plain("grass", [0.14, 0.27, 0.07]),
            bark: b.plain("bark", [0.2, 0.15, 0.1]),
            leaf: [
                b.plain("leaf", [0.12, 0.32, 0.06]),
                b.plain("young leaf", [0.22, 0.42, 0.08]),
                b.plain("old leaf", [0.34, 0.33, 0.06]),
            ],
            facade: [
                b.material(textured("masonry", pattern::masonry())),
                b.material(textured("plaster", pattern::plaster())),
                b.plain("brick", [0.47, 0.2, 0.13]),
                b.plain("ochre render", [0.72, 0.55, 0.3]),
                b.plain("grey render", [0.52, 0.54, 0.55]),
            ],
            roof: b.plain("gravel", [0.36, 0.34, 0.31]),
            white: b.plain("white paint", [0.8, 0.79, 0.76]),
            wall: [
                b.plain("cream wall", [0.76, 0.7, 0.56]),
                b.plain("blue wall", [0.45, 0.57, 0.68]),
                b.plain("green wall", [0.5, 0.63, 0.45]),
                b.plain("rose wall", [0.72, 0.48, 0.42]),
                b.plain("white wall", [0.78, 0.77, 0.74]),
            ],
            floor: [
                b.material(textured("boards", pattern::wood())),
                b.material(textured("carpet", pattern::carpet())),
                b.plain("stone floor", [0.58, 0.55, 0.5]),
            ],
            wood: b.plain("beech", [0.58, 0.42, 0.26]),
            dark_wood: b.plain("walnut", [0.28, 0.17, 0.1]),
            metal: b.plain("metal", [0.52, 0.53, 0.55]),
            dark: b.plain("black", [0.05, 0.05, 0.06]),
            ceramic: b.plain("ceramic", [0.82, 0.81, 0.78]),
            fabric: cloths(b),
            lamp: b.material(shining("ceiling lamp", 0.8, Vec3::new(52.0, 44.0, 32.0))),
            street_lamp: b.material(shining("street lamp", 0.8, Vec3::new(60.0, 46.0, 26.0))),
            car: [
                b.plain("car red", [0.5, 0.06, 0.05]),
                b.plain("car white", [0.75, 0.75, 0.75]),
                b.plain("car blue", [0.06, 0.12, 0.36]),
                b.plain("car grey", [0.3, 0.31, 0.33]),
            ],
        }
    }
}

fn cloths(b: &mut Builder) -> [u32; 5] {
    [
        b.plain("red cloth", [0.55, 0.1, 0.09]),
        b.plain("blue cloth", [0.1, 0.17, 0.42]),
        b.plain("linen", [0.7, 0.65, 0.54]),
        b.plain("green cloth", [0.12, 0.3, 0.16]),
        b.plain("yellow cloth", [0.7, 0.52, 0.12]),
    ]
}

/// Plan of a city: lots along x and z, level of detail.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Plan {
    lots: (u32, u32),
    detail: Detail,
}

impl Plan {
    /// Plans from the smallest to the largest.
    fn all() -> impl Iterator<Item = Self> {
        let shapes = (1..=8u32).flat_map(|n| [(n, n), (n + 1, n)]);
        [(1, 1), (2, 1)]
            .into_iter()
            .map(|lots| Self { lots, detail: Detail::Low })
            .chain(shapes.map(|lots| Self { lots, detail: Detail::High }))
    }

    fn size(&self) -> (f32, f32) {
        (PITCH * self.lots.0 as f32 + STREET, PITCH * self.lots.1 as f32 + STREET)
    }
}

/// Builds it with `triangles` triangles: the largest plan that leaves some for leaves, and as many leaves as it takes.
pub fn build(triangles: usize) -> Result<Built, lights::Fault> {
    // What a lot takes is about the same everywhere: one is built to know.
    let mut chosen = None;
    let mut lot = [None; 2];
    for plan in Plan::all() {
        let each = *lot[usize::from(plan.detail == Detail::High)].get_or_insert_with(|| {
            let mut b = Builder::default();
            let m = Materials::new(&mut b);
            build_lot(&mut b, &m, 0, Vec2::splat(STREET), plan.detail);
            b.mesh.triangles.len()
        });
        let wanted = each * (plan.lots.0 * plan.lots.1) as usize;
        if chosen.is_none() || wanted + wanted / 32 <= triangles {
            chosen = Some(plan);
        }
    }
    let plan = chosen.unwrap_or(Plan { lots: (1, 1), detail: Detail::Low });

    let mut b = Builder::default();
    b.mesh.triangles.reserve_exact(triangles);
    let m = Materials::new(&mut b);
    let mut trees = Vec::new();
    for k in 0..plan.lots.0 * plan.lots.1 {
        let at = Vec2::new((k % plan.lots.0) as f32, (k / plan.lots.0) as f32) * PITCH + STREET;
        trees.extend(build_lot(&mut b, &m, k, at, plan.detail));
    }
    streets(&mut b, &m, &plan);
    mast(&mut b, &m, Vec3::new(STREET + 10.0, 0.0, STREET + 9.0));
    let left = triangles.saturating_sub(b.mesh.triangles.len()) / 2;
    street::leaves(&mut b, &m, &trees, left);

    let sun = lights::directional(Vec3::new(0.62, -0.62, 0.48), Vec3::new(15.0, 12.2, 8.6))?;
    let (view, tracks) = flight(&plan);
    Ok(Built {
        mesh: b.mesh,
        lights: vec![sun],
        sky: Vec3::new(0.55, 0.75, 1.15),
        view,
        exposure_stops: -0.3,
        tracks,
        moving: Vec::new(),
    })
}

/// A lot with its four houses; returns its trees.
fn build_lot(b: &mut Builder, m: &Materials, number: u32, at: Vec2, detail: Detail) -> Vec<street::Tree> {
    let mut dice = Dice::new(number, 1);
    let first_storeys = dice.pick(STOREYS.len());
    for (k, (x, z)) in HOUSES.into_iter().enumerate() {
        let house = House {
            corner: Vec3::new(at.x + x, 0.0, at.y + z),
            storeys: STOREYS[(k + first_storeys) % STOREYS.len()],
            facade: m.facade[dice.pick(m.facade.len())],
            number: 4 * number + k as u32,
            detail,
        };
        house.build(b, m);
    }
    street::lot(b, m, number, at, detail)
}

/// Lanes and pavements.
fn streets(b: &mut Builder, m: &Materials, plan: &Plan) {
    b.object("lanes");
    let (width, depth) = plan.size();
    // Round the city's edge the ground ends a little inside of whole metres.
    let low = Vec2::splat(ROAD);
    let high = Vec2::new(width - ROAD, depth - ROAD);
    let grid = (steps(width, 4.0), steps(depth, 4.0));
    let at = |s: f32, t: f32| Vec3::new(low.x + (high.x - low.x) * t, ROAD, low.y + (high.y - low.y) * s);
    b.sheet(m.asphalt, (grid.1, grid.0), at, Vec2::new);
    for k in 0..plan.lots.0 * plan.lots.1 {
        let at = Vec2::new((k % plan.lots.0) as f32, (k / plan.lots.0) as f32) * PITCH + STREET;
        street::pavement(b, m, at);
    }
    for i in 0..=plan.lots.0 {
        street::marks(b, m, PITCH * i as f32 + 0.5 * STREET, depth, true);
    }
    for j in 0..=plan.lots.1 {
        street::marks(b, m, PITCH * j as f32 + 0.5 * STREET, width, false);
    }
}

/// A mast on a roof, that ends at [`TOP`].
fn mast(b: &mut Builder, m: &Materials, foot: Vec3) {
    b.object("mast");
    b.cuboid(m.metal, Vec3::new(foot.x, 9.0, foot.z), Vec3::new(foot.x + 0.08, TOP, foot.z + 0.08), STANDING);
}

/// A flight along a street, round a corner, into a house and along its corridor into a room: 30 s.
fn flight(plan: &Plan) -> (View, Vec<Track>) {
    let (width, depth) = plan.size();
    let lane = 0.5 * STREET;
    // The entrance of the first house of the last lot of the first column, at its corridor.
    let door = Vec3::new(STREET + HOUSES[0].0, 1.7, depth - STREET - LOT + HOUSES[0].1 + house::CORRIDOR);
    let start = Vec3::new(width - 2.0, 5.0, lane);
    let eyes = [
        (0.0, start),
        (9.0, Vec3::new(lane + 8.0, 2.6, lane)),
        (11.0, Vec3::new(lane, 2.2, lane + 8.0)),
        (18.0, Vec3::new(lane, 2.0, door.z - 6.0)),
        (20.5, Vec3::new(door.x - 3.5, 1.8, door.z)),
        (24.0, door + Vec3::X * 5.0),
        (26.5, door + Vec3::X * 9.0),
        (28.0, door + Vec3::new(9.1, 0.0, -1.8)),
        (30.0, door + Vec3::new(8.6, 0.0, -4.2)),
    ];
    let targets = [
        (0.0, Vec3::new(0.0, 4.0, lane + 6.0)),
        (8.0, Vec3::new(lane - 4.0, 2.5, lane + 2.0)),
        (10.0, Vec3::new(lane, 2.5, lane + 20.0)),
        (17.0, Vec3::new(lane + 2.0, 2.2, door.z + 4.0)),
        (19.5, door + Vec3::X * 2.0),
        (25.0, door + Vec3::X * 16.0),
        (27.0, door + Vec3::new(9.1, -0.1, -5.0)),
        (28.5, door + Vec3::new(8.0, -0.2, -8.0)),
        (30.0, door + Vec3::new(6.0, -0.6, -8.0)),
    ];
    let view = View { eye: start, target: targets[0].1, up: Vec3::Y, vertical_fov_degrees: 60.0 };
    let track = |target, keys: &[(f32, Vec3)]| Track {
        target,
        keyframes: keys.iter().map(|&(time, value)| Keyframe { time, value }).collect(),
    };
    (view, vec![track(Target::CameraEye, &eyes), track(Target::CameraTarget, &targets)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_city_has_the_triangles_asked_for_and_is_the_same_again() {
        let first = build(150_000).unwrap();
        let again = build(150_000).unwrap();
        assert!(first.mesh.triangles.len().abs_diff(150_000) <= 1, "{}", first.mesh.triangles.len());
        let corners = |built: &Built| built.mesh.triangles.iter().map(|t| t.corners).collect::<Vec<_>>();
        assert!(corners(&first) == corners(&again));
        assert!(corners(&first) != corners(&build(160_000).unwrap()));
    }

    #[test]
    fn its_bounds_are_whole_metres_less_what_keeps_voxels_off_walls_and_edges_span_a_thousand() {
        let built = build(*TRIANGLES.range.start() as usize).unwrap();
        let mut low = Vec3::INFINITY;
        let mut high = Vec3::NEG_INFINITY;
        let mut shortest = f32::INFINITY;
        let mut longest = 0.0f32;
        for t in &built.mesh.triangles {
            for k in 0..3 {
                low = low.min(t.corners[k]);
                high = high.max(t.corners[k]);
                let edge = t.corners[k].distance(t.corners[(k + 1) % 3]);
                (shortest, longest) = (shortest.min(edge), longest.max(edge));
            }
        }
        assert!((low - Vec3::splat(ROAD)).abs().max_element() < 1e-5, "{low}");
        assert!((high + ROAD - (high + ROAD).round()).abs().max_element() < 1e-4, "{high}");
        assert!((high.x - low.x) / shortest > 1000.0, "{shortest} to {longest}");
    }

    #[test]
    fn the_flight_ends_in_a_room() {
        let built = build(*TRIANGLES.range.start() as usize).unwrap();
        let eye = built.tracks[0].value(30.0);
        // Above it a ceiling, below it a floor, within a storey.
        let crosses = |up: bool| {
            built.mesh.triangles.iter().any(|t| {
                let [a, b, c] = t.corners;
                let flat = |p: Vec3| Vec2::new(p.x, p.z);
                let side = |p: Vec3, q: Vec3| (flat(q) - flat(p)).perp_dot(flat(eye) - flat(p)) > 0.0;
                let inside = side(a, b) == side(b, c) && side(b, c) == side(c, a);
                let gap = if up { a.y - eye.y } else { eye.y - a.y };
                inside && (a.y - b.y).abs() < 1e-4 && (a.y - c.y).abs() < 1e-4 && (0.0..3.0).contains(&gap)
            })
        };
        assert!(crosses(true) && crosses(false));
    }
}
