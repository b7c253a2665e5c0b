//! A room with a window. The sun moves, and the light of all bounces follows it.

use bevy::camera::Exposure;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::prelude::*;
use bevy_patchlight::{PatchlightMoving, PatchlightPlugin, PatchlightStatic};

fn main() {
    App::new()
        .add_plugins((DefaultPlugins, PatchlightPlugin))
        .add_systems(Startup, setup)
        .add_systems(Update, turn)
        .run();
}

fn setup(mut commands: Commands, mut meshes: ResMut<Assets<Mesh>>, mut materials: ResMut<Assets<StandardMaterial>>) {
    let mut paint =
        |color: Color| materials.add(StandardMaterial { base_color: color, perceptual_roughness: 1.0, ..default() });
    let (white, red) = (paint(Color::srgb(0.85, 0.85, 0.85)), paint(Color::srgb(0.8, 0.15, 0.1)));
    // Floor, ceiling, three walls, and a wall with a window: middles and sizes, m.
    for (middle, size, material) in [
        ((0.0, -0.1, 0.0), (6.0, 0.2, 5.0), &white),
        ((0.0, 3.1, 0.0), (6.0, 0.2, 5.0), &white),
        ((-3.1, 1.5, 0.0), (0.2, 3.0, 5.0), &red),
        ((0.0, 1.5, -2.6), (6.0, 3.0, 0.2), &white),
        ((0.0, 1.5, 2.6), (6.0, 3.0, 0.2), &white),
        ((3.1, 0.4, 0.0), (0.2, 0.8, 5.0), &white),
        ((3.1, 2.75, 0.0), (0.2, 0.5, 5.0), &white),
    ] {
        commands.spawn((
            Mesh3d(meshes.add(Cuboid::from_size(size.into()))),
            MeshMaterial3d(material.clone()),
            Transform::from_translation(middle.into()),
            PatchlightStatic,
        ));
    }
    let sphere = Mesh3d(meshes.add(Sphere::new(0.4).mesh().uv(16, 9)));
    commands.spawn((sphere, MeshMaterial3d(white), Transform::from_xyz(0.0, 0.4, 0.0), PatchlightMoving));
    commands.spawn(DirectionalLight { illuminance: 60_000.0, shadow_maps_enabled: true, ..default() });
    let camera = Transform::from_xyz(1.8, 1.7, 2.2).looking_at(Vec3::new(-1.5, 1.0, -1.0), Vec3::Y);
    commands.spawn((Camera3d::default(), camera, Tonemapping::AcesFitted, Exposure { ev100: 10.5 }));
}

fn turn(
    time: Res<Time>,
    mut sun: Single<&mut Transform, With<DirectionalLight>>,
    mut sphere: Single<&mut Transform, (With<PatchlightMoving>, Without<DirectionalLight>)>,
) {
    let swing = (0.2 * time.elapsed_secs()).sin();
    **sun = Transform::default().looking_to(Vec3::new(-1.0, -0.6, 0.8 * swing), Vec3::Y);
    sphere.translation.z = 1.5 * swing;
}
