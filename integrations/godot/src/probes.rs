//! Probes on a grid as a lightmap of Godot's has them: tetrahedra, and a tree of planes that finds the one about a point.

use godot::prelude::*;
use patchlight::glam::Vec3;

use crate::work::{Grid, ProbeLight, SIDES};

/// Numbers of a node of the tree: a plane, and what lies over and under it.
const NODE: usize = 6;
/// Coefficients of a probe.
const HARMONICS: usize = 9;
/// Factors by which Godot multiplies coefficients (Ramamoorthi and Hanrahan 2001): twice the second in degree 1.
const C: [f32; 5] = [0.429_043, 0.511_664, 0.743_125, 0.886_227, 0.247_708];

/// The six tetrahedra of a cell, along ways from its first corner to its last: the axes in the order in which each
/// goes along them.
const WAYS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// What never changes of a grid.
pub struct Tetrahedra {
    pub grid: Grid,
    pub points: PackedVector3Array,
    pub tetrahedra: PackedInt32Array,
    pub tree: PackedInt32Array,
}

impl Tetrahedra {
    /// Those of a grid; none where it has less than two probes along an axis.
    pub fn new(grid: Grid) -> Option<Self> {
        if grid.counts.iter().any(|&count| count < 2) {
            return None;
        }
        let place = |k: usize, axis: usize| grid.first[axis] + k as f32 * grid.step[axis];
        let counts = grid.counts.map(|count| count as usize);
        let mut points = Vec::new();
        for z in 0..counts[2] {
            for y in 0..counts[1] {
                for x in 0..counts[0] {
                    points.push(Vector3::new(place(x, 0), place(y, 1), place(z, 2)));
                }
            }
        }
        let cells = counts.map(|count| count - 1);
        let mut tetrahedra = Vec::new();
        for cell in 0..cells.iter().product() {
            let corner = [cell % cells[0], cell / cells[0] % cells[1], cell / (cells[0] * cells[1])];
            for way in WAYS {
                let mut at = corner;
                let number = |at: [usize; 3]| (at[0] + counts[0] * (at[1] + counts[1] * at[2])) as i32;
                tetrahedra.push(number(at));
                for axis in way {
                    at[axis] += 1;
                    tetrahedra.push(number(at));
                }
            }
        }
        let mut tree = Vec::new();
        split(&grid, cells, [[0, 0, 0], cells], &mut tree);
        Some(Self { grid, points: points.into(), tetrahedra: tetrahedra.into(), tree: tree.into() })
    }
}

/// Appends the tree of the cells from `low` to below `high`: its first node, or the tetrahedron that it is.
fn split(grid: &Grid, cells: [usize; 3], [low, high]: [[usize; 3]; 2], tree: &mut Vec<i32>) -> i32 {
    let size = |axis: usize| high[axis] - low[axis];
    let longest = (0..3).max_by_key(|&axis| size(axis)).unwrap_or(0);
    if size(longest) == 1 {
        return split_cell(grid, cells, low, tree);
    }
    let middle = low[longest] + size(longest) / 2;
    let mut normal = [0.0; 3];
    normal[longest] = 1.0;
    let node = push(tree, normal, grid.first[longest] + middle as f32 * grid.step[longest]);
    let (mut from, mut to) = (low, high);
    from[longest] = middle;
    to[longest] = middle;
    let over = split(grid, cells, [from, high], tree);
    let under = split(grid, cells, [low, to], tree);
    link(tree, node, over, under)
}

/// Three comparisons of the shares along the axes find a tetrahedron: the way goes along the largest first.
fn split_cell(grid: &Grid, cells: [usize; 3], cell: [usize; 3], tree: &mut Vec<i32>) -> i32 {
    let first = 6 * (cell[0] + cells[0] * (cell[1] + cells[1] * cell[2]));
    let leaf = |way: [usize; 3]| {
        let number = WAYS.iter().position(|own| *own == way).unwrap_or(0);
        -((first + number) as i32) - 1
    };
    // Over it, the share along `a` is larger than that along `b`.
    let compare = |tree: &mut Vec<i32>, a: usize, b: usize| {
        let mut normal = [0.0; 3];
        normal[a] = 1.0 / grid.step[a];
        normal[b] = -1.0 / grid.step[b];
        let corner = |axis: usize| grid.first[axis] + cell[axis] as f32 * grid.step[axis];
        push(tree, normal, corner(a) / grid.step[a] - corner(b) / grid.step[b])
    };
    // x > y, then where z stands beside them.
    let half = |tree: &mut Vec<i32>, large: usize, small: usize| {
        let top = compare(tree, 2, large);
        let bottom = compare(tree, 2, small);
        link(tree, bottom, leaf([large, 2, small]), leaf([large, small, 2]));
        link(tree, top, leaf([2, large, small]), bottom)
    };
    let node = compare(tree, 0, 1);
    let over = half(tree, 0, 1);
    let under = half(tree, 1, 0);
    link(tree, node, over, under)
}

fn push(tree: &mut Vec<i32>, normal: [f32; 3], distance: f32) -> i32 {
    let length = normal.iter().map(|x| x * x).sum::<f32>().sqrt();
    let plane = [normal[0], normal[1], normal[2], distance].map(|x| (x / length).to_bits() as i32);
    tree.extend(plane);
    tree.extend([i32::MIN; 2]);
    (tree.len() / NODE) as i32 - 1
}

fn link(tree: &mut [i32], node: i32, over: i32, under: i32) -> i32 {
    let first = NODE * node as usize;
    tree[first + 4] = over;
    tree[first + 5] = under;
    node
}

/// Coefficients of all probes, of which Godot makes the radiance of a white surface: with normal n it is
/// `Σ (n_a² (E_+a + E_−a) + n_a (E_+a − E_−a)) / 2π` over the axes a, which is the cube's own along each.
pub fn harmonics(light: &ProbeLight) -> PackedColorArray {
    let all = light.cubes.iter().flat_map(coefficients);
    all.map(|own| Color::from_rgb(own.x, own.y, own.z)).collect()
}

fn coefficients(cube: &[Vec3; SIDES]) -> [Vec3; HARMONICS] {
    let half = 0.5 * std::f32::consts::FRAC_1_PI;
    let [even_x, even_y, even_z] = [0, 2, 4].map(|side| (cube[side] + cube[side + 1]) * half);
    let [odd_x, odd_y, odd_z] = [0, 2, 4].map(|side| (cube[side] - cube[side + 1]) * half / (2.0 * C[1]));
    let flat = 0.5 * (even_x + even_y);
    let sixth = (even_z - flat) / C[2];
    let none = Vec3::ZERO;
    let first = (flat + C[4] * sixth) / C[3];
    [first, odd_y, odd_z, odd_x, none, none, sixth, none, (even_x - even_y) * 0.5 / C[0]]
}

#[cfg(test)]
mod tests {
    use patchlight::scene::sampling::hash3;

    use super::*;

    /// The tetrahedron that the tree finds, as Godot walks it.
    fn find(tree: &[i32], point: Vec3) -> usize {
        let mut node = 0;
        while node >= 0 {
            let own = &tree[NODE * node as usize..][..NODE];
            let plane = [own[0], own[1], own[2], own[3]].map(|bits| f32::from_bits(bits as u32));
            let is_over = Vec3::new(plane[0], plane[1], plane[2]).dot(point) > plane[3];
            node = own[if is_over { 4 } else { 5 }];
        }
        (-node - 1) as usize
    }

    /// What Godot shows of coefficients.
    fn shown(sh: &[Vec3; HARMONICS], n: Vec3) -> Vec3 {
        C[0] * sh[8] * (n.x * n.x - n.y * n.y) + C[2] * sh[6] * n.z * n.z + C[3] * sh[0] - C[4] * sh[6]
            + 2.0 * C[1] * (sh[3] * n.x + sh[1] * n.y + sh[2] * n.z)
    }

    #[test]
    fn coefficients_give_the_cube_along_its_axes() {
        let cube = std::array::from_fn(|side| Vec3::new(side as f32, 0.5, (side * side) as f32));
        let own = coefficients(&cube);
        for (side, normal) in [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y, Vec3::Z, -Vec3::Z].into_iter().enumerate() {
            let found = shown(&own, normal) * std::f32::consts::PI;
            assert!((found - cube[side]).abs().max_element() < 1e-4, "{side}: {found}");
        }
    }

    #[test]
    fn the_tree_finds_the_tetrahedron_about_a_point() {
        let grid = Grid { first: Vec3::new(-1.0, 2.0, 0.5), step: Vec3::new(0.5, 0.25, 1.0), counts: [4, 3, 5] };
        let counts = grid.counts.map(|count| count as usize);
        let cells = counts.map(|count| count - 1);
        let mut tree = Vec::new();
        assert_eq!(split(&grid, cells, [[0, 0, 0], cells], &mut tree), 0);
        let mut met = std::collections::BTreeSet::new();
        for k in 0..4000u32 {
            let share = |axis: u32| (hash3(k, axis, 7) >> 8) as f32 / (1 << 24) as f32;
            let at = Vec3::new(share(0), share(1), share(2)) * Vec3::new(3.0, 2.0, 4.0);
            let found = find(&tree, grid.first + at * grid.step);
            met.insert(found);
            let (cell, way) = (found / 6, WAYS[found % 6]);
            let corner = [cell % cells[0], cell / cells[0] % cells[1], cell / (cells[0] * cells[1])];
            let rest: Vec<f32> = (0..3).map(|axis| at[axis] - corner[axis] as f32).collect();
            assert!(rest.iter().all(|share| (-1e-4..=1.0001).contains(share)), "{at} {corner:?}");
            assert!(rest[way[0]] >= rest[way[1]] - 1e-4 && rest[way[1]] >= rest[way[2]] - 1e-4, "{rest:?} {way:?}");
        }
        assert_eq!(met.len(), 6 * 3 * 2 * 4);
    }
}
