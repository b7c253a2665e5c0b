//! A room put together in memory, with a lamp, and a sun through its window; no file. Prints light on its floor.

use patchlight::glam::Vec3;
use patchlight::scene::{LUMENS_PER_WATT, math::luminance};
use patchlight::{Bake, BakeSettings, Cpu, LightField, LightSettings, Point, PointKind, Silent};
use patchlight::{Flux, Irradiance, Light, Material, Mesh, Radiance, Scene};

/// Corner and two edges of each wall, m. The window, 2 m wide and 1.3 m high, is a gap in that of x = 0.
const WALLS: [(&str, [[f32; 3]; 3]); 9] = [
    ("floor", [[0.0, 0.0, 0.0], [0.0, 0.0, 4.0], [5.0, 0.0, 0.0]]),
    ("ceiling", [[0.0, 2.7, 0.0], [5.0, 0.0, 0.0], [0.0, 0.0, 4.0]]),
    ("back", [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 2.7, 0.0]]),
    ("front", [[0.0, 0.0, 4.0], [0.0, 2.7, 0.0], [5.0, 0.0, 0.0]]),
    ("right", [[5.0, 0.0, 0.0], [0.0, 0.0, 4.0], [0.0, 2.7, 0.0]]),
    ("below the window", [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 4.0]]),
    ("above the window", [[0.0, 2.3, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 4.0]]),
    ("left of the window", [[0.0, 1.0, 0.0], [0.0, 1.3, 0.0], [0.0, 0.0, 1.0]]),
    ("right of the window", [[0.0, 1.0, 3.0], [0.0, 1.3, 0.0], [0.0, 0.0, 1.0]]),
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut room = Scene::builder();
    let material = room.add_material(Material::diffuse(Vec3::new(0.8, 0.75, 0.7)));
    for (name, place) in WALLS {
        let [p, a, b] = place.map(Vec3::from_array);
        let positions = &[p, p + a, p + a + b, p + b];
        let indices = &[0, 1, 2, 0, 2, 3];
        room.add_mesh(Mesh { name, positions, indices, material, ..Mesh::default() });
    }
    let lamp = room.add_light(Light::point(Vec3::new(2.5, 2.4, 2.0), Flux::lumens(1200.0)));
    room.add_light(Light::sun(Vec3::new(1.0, -0.7, 0.2), Irradiance::lux(80_000.0)));
    room.set_sky(Radiance::nits(4000.0));
    let scene = room.build()?;

    let bake = Bake::build(&scene, &BakeSettings::default().with_patch_count(500), &Silent)?;
    let mut field = LightField::new(bake.into(), Box::new(Cpu::new()), &LightSettings::default(), &Silent)?;
    let desk = Point { position: Vec3::new(4.0, 0.75, 3.0), normal: Vec3::Y };
    let desk = field.add_points(&[desk], PointKind::Irradiance, &Silent)?;
    let mut lighting = scene.lighting.clone();
    for share in [1.0, 0.0] {
        lighting.light_mut(lamp).expect("it was added above").color *= share;
        field.update(&lighting)?;
        let indirect = luminance(field.read(desk)?.values[0]) * LUMENS_PER_WATT;
        println!("lamp × {share}: {indirect:.0} lx of indirect light at the height of a desk");
    }
    Ok(())
}
