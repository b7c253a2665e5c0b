//! Teeth along edges and patterns of pictures whose faults were counted beforehand.

use glam::{Vec3, vec3};
use patchlight_reference::{Edges, Judge, Picture};
use scene::gpu::{Triangle, TriangleUv};
use scene::sampling::{hash3, unit};
use scene::{Camera, Material, Scene, SceneParts};

const WIDTH: u32 = 96;
const HEIGHT: u32 = 80;

/// A wall at z = 0 and, where asked, a square 1 m before the right half of it, seen along −z: one pixel is 0.1 m of the
/// wall.
fn edges(with_square: bool) -> Edges {
    let wall = |z: f32, left: f32| Triangle {
        corner: vec3(left, -99.0, z),
        edge_a: vec3(999.0, 0.0, 0.0),
        edge_b: vec3(0.0, 999.0, 0.0),
        ..Triangle::default()
    };
    let mut triangles = vec![wall(0.0, -99.0)];
    if with_square {
        triangles.push(wall(1.0, 0.0));
    }
    let scene = Scene::new(SceneParts {
        uvs: vec![TriangleUv::default(); triangles.len()],
        triangles,
        materials: vec![Material { albedo: Vec3::splat(0.5), ..Material::default() }],
        ..SceneParts::default()
    })
    .expect("a wall");
    let camera = Camera::look_at(vec3(0.0, 0.0, 10.0), Vec3::ZERO, Vec3::Y, 40.0, WIDTH, HEIGHT);
    Edges::new(&scene, &camera)
}

fn picture(value: impl Fn(u32, u32) -> f32) -> Picture {
    let pixels = (0..WIDTH * HEIGHT).map(|k| Vec3::splat(value(k % WIDTH, k / WIDTH))).collect();
    Picture::from_pixels(WIDTH, HEIGHT, pixels).expect("the size fits")
}

#[test]
fn an_edge_is_near_three_pixels_on_either_side_of_it() {
    let found = edges(true);
    let near: Vec<u32> = (0..WIDTH).filter(|x| found.is_near((40 * WIDTH + x) as usize)).collect();
    // The edge lies between the pixels of 47 and 48.
    assert_eq!(near, [44, 45, 46, 47, 48, 49, 50], "the left of both counts");
    let without = edges(false);
    assert!((0..(WIDTH * HEIGHT) as usize).all(|k| !without.is_near(k)));
}

#[test]
fn teeth_are_counted_along_edges_alone() {
    let reference = picture(|_, _| 1.0);
    let found = edges(true);
    let judge = Judge::new(&reference);
    // Columns that are 26 % off, near the edge and far from it, and one that is 24 % off.
    let ours = picture(|x, _| match x {
        46 => 1.26,
        48 => 0.74,
        49 => 1.24,
        10 => 1.5,
        _ => 1.0,
    });
    let share = found.tooth_share(&judge, &ours).unwrap();
    assert!((share - 2.0 / f64::from(WIDTH)).abs() < 1e-9, "{share}");
    assert_eq!(edges(false).tooth_share(&judge, &ours).unwrap(), 0.0);
    // What the noise of the reference explains is none.
    let noise = picture(|_, _| 0.1);
    let noisy = Judge { standard_error: Some(&noise), ..judge };
    assert_eq!(found.tooth_share(&noisy, &ours).unwrap(), 0.0);
    let marked = found.tooth_picture(&judge, &ours, 1.0).unwrap();
    assert!(marked.pixels[(40 * WIDTH + 46) as usize] != marked.pixels[(40 * WIDTH + 10) as usize]);
}

#[test]
fn patterns_repeat_and_grain_does_not() {
    let reference = picture(|x, y| 1.0 + 0.01 * (x + y) as f32);
    let found = edges(false);
    let grain = |x: u32, y: u32| 0.02 * (unit(hash3(x, y, 5)) - 0.5);
    let of = |error: &dyn Fn(u32, u32) -> f32| {
        let ours = picture(|x, y| (1.0 + 0.01 * (x + y) as f32) * (1.0 + error(x, y)));
        found.pattern(&reference, &ours).unwrap()
    };
    let random = of(&grain).expect("many pixels");
    assert!(random < 0.05, "{random}");
    // Tiles of 4 × 4 pixels with the same errors in each.
    let tiles = of(&|x, y| grain(x % 4, y % 4)).expect("many pixels");
    assert!(tiles > 0.95, "{tiles}");
    // A half of it hidden by grain.
    let both = of(&|x, y| grain(x % 4, y % 4) + grain(x, y)).expect("many pixels");
    assert!((0.3..0.7).contains(&both), "{both}");
    // An error that is the same all about is none.
    assert_eq!(of(&|_, _| 0.1), Some(0.0));
}

#[test]
fn pictures_of_other_sizes_are_refused() {
    let found = edges(true);
    let small = Picture::from_pixels(16, 16, vec![Vec3::ONE; 256]).expect("the size fits");
    let judge = Judge::new(&small);
    assert!(found.tooth_share(&judge, &small).is_err());
    assert!(found.pattern(&small, &small).is_err());
}
