//! A court under the sky: the sun goes by a slider, a lamp is switched, a door swings. Right mouse button and WASD fly.
//! With the feature `vulkan`, `--shared` finds light on the device that draws.

mod support;

use std::time::Duration;

use bevy::camera::Exposure;
use bevy::camera_controller::free_camera::{FreeCamera, FreeCameraPlugin};
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::GlobalAmbientLight;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
#[cfg(feature = "vulkan")]
use bevy::render::settings::WgpuSettings;
use bevy::ui::RelativeCursorPosition;
use bevy_patchlight::{PatchlightMoving, PatchlightPlugin, PatchlightSettings, PatchlightStage, PatchlightStatus};

/// Sunlight at noon, lx, and the sky, cd/m².
const SUN: f32 = 80_000.0;
const SKY: f32 = 3_000.0;
/// Hinge of the door, between the court and a gallery, m.
const HINGE: Vec3 = Vec3::new(11.4, 0.0, 3.1);
/// Frames whose time is told together.
const SMOOTH: f32 = 0.05;

fn main() {
    let window = Window { title: "Patchlight: atrium".into(), resolution: (1280, 720).into(), ..default() };
    let (shares_device, renderer) = renderer();
    App::new()
        .add_plugins(DefaultPlugins.set(WindowPlugin { primary_window: Some(window), ..default() }).set(renderer))
        .add_plugins((FreeCameraPlugin, PatchlightPlugin))
        .insert_resource(PatchlightSettings { patch_count: 2000, texel: 0.15, shares_device, ..default() })
        .insert_resource(Hours { value: 0.4, is_lamp_on: false, is_door_open: false, angle: 0.0 })
        .add_systems(Startup, (setup, panel))
        .add_systems(Update, (drag, press, keys, shine, swing, tell))
        .run();
}

/// With `--shared` a renderer on whose device light is found, and true; else Bevy's own.
#[cfg(feature = "vulkan")]
fn renderer() -> (bool, RenderPlugin) {
    if !std::env::args().any(|argument| argument == "--shared") {
        return (false, RenderPlugin::default());
    }
    match bevy_patchlight::vulkan_renderer(&WgpuSettings::default()) {
        Ok(render_creation) => (true, RenderPlugin { render_creation, ..default() }),
        Err(error) => {
            eprintln!("{error}");
            std::process::exit(1);
        }
    }
}

/// Bevy's own renderer; light is found on the processor.
#[cfg(not(feature = "vulkan"))]
fn renderer() -> (bool, RenderPlugin) {
    (false, RenderPlugin::default())
}

/// What the panel sets.
#[derive(Resource)]
struct Hours {
    /// The sun's way from morning to evening, 0 to 1.
    value: f32,
    is_lamp_on: bool,
    is_door_open: bool,
    /// Of the door, radians.
    angle: f32,
}

#[derive(Component)]
struct Lamp;
#[derive(Component)]
struct Door;
#[derive(Component)]
struct Slider;
#[derive(Component)]
struct Knob;
#[derive(Component)]
struct ReadOut;
#[derive(Component, Clone, Copy)]
enum Switch {
    Lamp,
    Door,
}

fn setup(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut images: ResMut<Assets<Image>>,
) {
    let scene = match assets::load_or_build("atrium") {
        Ok(scene) => scene,
        Err(error) => {
            error!("{error}");
            std::process::exit(1);
        }
    };
    support::spawn_meshes(&scene, &mut commands, &mut meshes, &mut materials, &mut images);
    commands.spawn((
        DirectionalLight { illuminance: SUN, shadow_maps_enabled: true, ..default() },
        bevy::light::CascadeShadowConfigBuilder { maximum_distance: 40.0, ..default() }.build(),
    ));
    commands.spawn((
        Lamp,
        PointLight {
            color: Color::srgb(1.0, 0.75, 0.5),
            intensity: 0.0,
            range: 60.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(10.0, 2.6, 6.0),
    ));
    let wood = StandardMaterial { base_color: Color::srgb(0.45, 0.28, 0.16), perceptual_roughness: 0.9, ..default() };
    commands.spawn((
        Door,
        Mesh3d(meshes.add(Cuboid::new(2.2, 2.6, 0.08).mesh().build().translated_by(Vec3::new(1.1, 1.3, 0.0)))),
        MeshMaterial3d(materials.add(wood)),
        Transform::from_translation(HINGE),
        PatchlightMoving,
    ));
    let camera = support::camera(&scene, 1.0);
    let shown = (Exposure { ev100: 12.0 }, Tonemapping::AcesFitted);
    commands.spawn((camera, FreeCamera::default())).insert(shown);
}

fn panel(mut commands: Commands) {
    let back = BackgroundColor(Color::srgba(0.06, 0.07, 0.09, 0.82));
    let font = || TextFont { font_size: FontSize::Px(15.0), ..default() };
    let root = Node {
        position_type: PositionType::Absolute,
        left: px(16),
        top: px(16),
        width: px(300),
        padding: UiRect::all(px(14)),
        flex_direction: FlexDirection::Column,
        row_gap: px(10),
        ..default()
    };
    commands.spawn((root, back)).with_children(|panel| {
        panel.spawn((ReadOut, Text::new("Preparing the light"), font()));
        panel.spawn((Text::new("Sun, from morning to evening"), font()));
        let bar = Node { width: percent(100), height: px(18), ..default() };
        panel
            .spawn((
                Slider,
                Button,
                RelativeCursorPosition::default(),
                bar,
                BackgroundColor(Color::srgb(0.2, 0.22, 0.26)),
            ))
            .with_children(|bar| {
                let knob = Node {
                    width: percent(4),
                    height: percent(100),
                    position_type: PositionType::Absolute,
                    ..default()
                };
                bar.spawn((Knob, knob, BackgroundColor(Color::srgb(0.96, 0.8, 0.45))));
            });
        for (switch, label) in [(Switch::Lamp, "Lamp [L]"), (Switch::Door, "Door [O]")] {
            let node = Node { padding: UiRect::axes(px(10), px(6)), ..default() };
            panel.spawn((switch, Button, node, BackgroundColor(Color::srgb(0.2, 0.22, 0.26)))).with_children(
                |button| {
                    button.spawn((Text::new(label), font()));
                },
            );
        }
    });
}

fn drag(
    mut hours: ResMut<Hours>,
    slider: Single<(&Interaction, &RelativeCursorPosition), With<Slider>>,
    mut knob: Single<&mut Node, With<Knob>>,
) {
    let (interaction, cursor) = *slider;
    if *interaction == Interaction::Pressed
        && let Some(at) = cursor.normalized
    {
        hours.value = (at.x + 0.5).clamp(0.0, 1.0);
    }
    knob.left = percent(96.0 * hours.value);
}

fn press(mut hours: ResMut<Hours>, switches: Query<(&Switch, &Interaction), Changed<Interaction>>) {
    for (switch, interaction) in &switches {
        if *interaction == Interaction::Pressed {
            hours.toggle(*switch);
        }
    }
}

fn keys(mut hours: ResMut<Hours>, keys: Res<ButtonInput<KeyCode>>, time: Res<Time>) {
    for (key, switch) in [(KeyCode::KeyL, Switch::Lamp), (KeyCode::KeyO, Switch::Door)] {
        if keys.just_pressed(key) {
            hours.toggle(switch);
        }
    }
    for (key, way) in [(KeyCode::ArrowLeft, -0.1), (KeyCode::ArrowRight, 0.1)] {
        if keys.pressed(key) {
            hours.value = (hours.value + way * time.delta_secs()).clamp(0.0, 1.0);
        }
    }
}

impl Hours {
    fn toggle(&mut self, switch: Switch) {
        match switch {
            Switch::Lamp => self.is_lamp_on = !self.is_lamp_on,
            Switch::Door => self.is_door_open = !self.is_door_open,
        }
    }
}

fn shine(
    hours: Res<Hours>,
    mut sun: Single<(&mut Transform, &mut DirectionalLight)>,
    mut lamp: Single<&mut PointLight, With<Lamp>>,
    mut sky: ResMut<GlobalAmbientLight>,
    mut behind: ResMut<ClearColor>,
) {
    let angle = std::f32::consts::PI * (0.06 + 0.88 * hours.value);
    let (height, way) = (angle.sin(), angle.cos());
    let (transform, light) = &mut *sun;
    **transform = Transform::default().looking_to(Vec3::new(-way, -height, 0.35), Vec3::Y);
    let warm = 1.0 - height;
    light.color = Color::linear_rgb(1.0, 1.0 - 0.45 * warm, 1.0 - 0.75 * warm);
    light.illuminance = SUN * height;
    sky.color = Color::linear_rgb(0.55, 0.75, 1.0);
    let bright = 0.1 + 0.6 * height;
    behind.0 = Color::linear_rgb(0.55 * bright, 0.75 * bright, bright);
    sky.brightness = SKY * (0.25 + 0.75 * height);
    lamp.intensity = if hours.is_lamp_on { 600_000.0 } else { 0.0 };
}

fn swing(mut hours: ResMut<Hours>, time: Res<Time>, mut door: Single<&mut Transform, With<Door>>) {
    let goal = if hours.is_door_open { 1.9 } else { 0.0 };
    let step = 1.2 * time.delta_secs();
    let angle = hours.angle + (goal - hours.angle).clamp(-step, step);
    if angle != hours.angle {
        hours.angle = angle;
        door.rotation = Quat::from_rotation_y(angle);
    }
}

fn tell(
    status: Res<PatchlightStatus>,
    time: Res<Time>,
    mut text: Single<&mut Text, With<ReadOut>>,
    mut frame: Local<f32>,
) {
    *frame += (time.delta_secs() - *frame) * SMOOTH;
    let stage = match &status.stage {
        PatchlightStage::Waiting | PatchlightStage::Preparing => "the first light is on its way".into(),
        PatchlightStage::Refining(share) => format!("refining, {:.0} %", 100.0 * share),
        PatchlightStage::Finished => format!("{} patches", status.patches),
        PatchlightStage::Failed(reason) => reason.clone(),
        other => format!("{other:?}"),
    };
    let milliseconds = |time: Duration| 1e3 * time.as_secs_f32();
    text.0 = format!(
        "{:.0} frames a second\nlight update {:.1} ms, with texels {:.1} ms\n{stage}",
        1.0 / frame.max(1e-6),
        milliseconds(status.update_time),
        milliseconds(status.work_time),
    );
}
