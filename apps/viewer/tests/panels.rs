//! The panels without a window: what is clicked and dragged changes the state, and what cannot be chosen is not.

use std::sync::OnceLock;

use egui::accesskit::Role;
use egui::{Key, Rect, Vec2, pos2, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable as _;
use glam::Vec3;
use patchlight::{Bake, BakeSettings, Silent};
use viewer::eye::project;
use viewer::lights::NewLight;
use viewer::state::State;
use viewer::sun::direction_to_sun;
use viewer::{MethodDefaults, panels, pointer};

const SIZE: Vec2 = vec2(900.0, 1200.0);

/// The state of a small scene, with a sun.
fn state() -> State {
    static BAKE: OnceLock<(assets::LoadedScene, Bake)> = OnceLock::new();
    let (loaded, bake) = BAKE.get_or_init(|| {
        let loaded = assets::load_or_build("cornell").unwrap();
        let settings = BakeSettings::default().with_patch_count(60).with_receiver_density(0.1).with_receiver_rays(32);
        let bake = Bake::build(&loaded.scene, &settings, &Silent).unwrap();
        (loaded, bake)
    });
    let mut state = State::new(loaded, bake, &MethodDefaults::default());
    state.lighting.add(NewLight::Sun, Vec3::ZERO, Vec3::NEG_Y, 1.0);
    state
}

fn harness(state: State) -> Harness<'static, State> {
    let show = |ui: &mut egui::Ui, state: &mut State| {
        panels::show(ui, state);
        pointer::show(ui, state, Rect::from_min_size(pos2(0.0, 0.0), SIZE));
    };
    let mut harness = Harness::builder().with_size(SIZE).build_ui_state(show, state);
    harness.run_steps(3);
    harness
}

/// Drags the pointer from one place to another.
fn drag(harness: &mut Harness<State>, from: egui::Pos2, to: egui::Pos2) {
    harness.hover_at(from);
    harness.run_steps(1);
    harness.drag_at(from);
    harness.run_steps(1);
    harness.hover_at(from + 0.5 * (to - from));
    harness.run_steps(1);
    harness.hover_at(to);
    harness.run_steps(1);
    harness.drop_at(to);
    harness.run_steps(2);
}

#[test]
fn the_hour_turns_the_sun() {
    let mut harness = harness(state());
    let before = harness.state_mut().lighting.sun().unwrap().light.direction;
    let slider = harness.get_by_role_and_label(Role::Slider, "hour").rect();
    drag(&mut harness, slider.center(), slider.left_center() + vec2(0.3 * slider.width(), 0.0));
    let state = harness.state_mut();
    let hour = state.sun.hour;
    assert!(hour != 12.0 && (1.0..23.0).contains(&hour), "{hour}");
    let to_sun = direction_to_sun(state.sun, state.compass);
    let sun = state.lighting.sun().unwrap();
    assert_eq!(sun.light.direction, -to_sun);
    assert_ne!(sun.light.direction, before);
    assert_eq!(sun.is_up, to_sun.y > 0.0);
}

#[test]
fn below_the_horizon_a_sun_is_off() {
    let mut state = state();
    for (hour, shines) in [(12.0, true), (0.0, false)] {
        state.sun.hour = hour;
        assert!(state.place_sun());
        let lights = state.lighting.lighting().lights;
        assert_eq!(lights[1].color.max_element() > 0.0, shines, "at {hour}");
        assert_eq!(lights.len(), 2, "it stays in the list");
    }
}

#[test]
fn a_method_without_its_operator_cannot_be_chosen() {
    let mut harness = harness(state());
    assert_eq!(harness.state().methods.chosen().name, "classic");
    let click = |harness: &mut Harness<State>, name: &str| {
        let place = harness.get_by_role_and_label(Role::RadioButton, name).rect().center();
        harness.hover_at(place);
        harness.run_steps(1);
        harness.drag_at(place);
        harness.run_steps(1);
        harness.drop_at(place);
        harness.run_steps(2);
    };
    click(&mut harness, "low_rank");
    assert_eq!(harness.state().methods.chosen().name, "classic", "grey");
    let why =
        harness.state().methods.choices().iter().find(|choice| choice.name == "low_rank").unwrap().why_not.clone();
    assert!(why.unwrap().contains("--for low_rank"));
    click(&mut harness, "temporal");
    assert_eq!(harness.state().methods.chosen().name, "temporal");
    assert!(harness.state_mut().methods.choose("feedback").unwrap_err().contains("--for feedback"));
    assert!(harness.state_mut().methods.choose("photon mapping").unwrap_err().contains("choose from classic"));
}

#[test]
fn lights_are_added_switched_dragged_and_removed() {
    let mut harness = harness(state());
    let click = |harness: &mut Harness<State>, name: &str| {
        harness.get_by_label(name).click();
        harness.run_steps(3);
    };
    click(&mut harness, "+ point");
    assert_eq!((harness.state().lighting.lights.len(), harness.state().selected), (3, Some(2)));
    let eye = harness.state().eye;
    // Beside the panel.
    let camera = eye.camera((900, 1200));
    let light = camera.eye + 0.5 * (camera.forward + 0.4 * camera.right);
    harness.state_mut().lighting.lights[2].light.position = light;
    harness.run_steps(2);
    let shown = project(&camera, light).unwrap();
    let place = pos2(shown.x * SIZE.x, shown.y * SIZE.y);
    drag(&mut harness, place, place + vec2(60.0, -45.0));
    let moved = harness.state().lighting.lights[2].light.position;
    let now = project(&camera, moved).unwrap();
    let by = vec2((now.x - shown.x) * SIZE.x, (now.y - shown.y) * SIZE.y);
    assert!((by - vec2(60.0, -45.0)).length() < 8.0, "{by}: the first points of a drag decide that it is one");
    assert!((now.z - shown.z).abs() < 1e-3, "at the same depth");
    assert_eq!(harness.state().eye, eye, "the camera stays");

    harness.state_mut().lighting.lights[2].is_on = false;
    assert_eq!(harness.state().lighting.lighting().lights[2].color, Vec3::ZERO);
    let last = harness.get_all_by_label("x").last().unwrap();
    last.click();
    harness.run_steps(3);
    assert_eq!(harness.state().lighting.lights.len(), 2);
}

#[test]
fn keys_fly_and_change_what_is_shown() {
    let mut harness = harness(state());
    let before = harness.state().eye;
    harness.key_down(Key::W);
    harness.run_steps(5);
    harness.key_up(Key::W);
    harness.run_steps(2);
    let way = harness.state().eye.position - before.position;
    assert!(way.normalize().dot(before.forward()) > 0.999, "{way}");
    harness.key_press(Key::Home);
    harness.run_steps(2);
    assert_eq!(harness.state().eye.position, before.position);
    harness.key_press(Key::V);
    harness.run_steps(2);
    assert_eq!(harness.state().shown.name(), "patches");
    harness.key_press(Key::M);
    harness.run_steps(2);
    assert_eq!(harness.state().methods.chosen().name, "temporal", "those without an operator are left out");
    assert!(!harness.state().has_help);
    harness.key_press(Key::F1);
    harness.run_steps(2);
    assert!(harness.state().has_help);
    harness.get_by_label("look round; a light or the ball by its handle; the line of the split screen");
}

#[test]
fn the_line_of_the_split_screen_follows_the_pointer() {
    let mut harness = harness(state());
    harness.key_press(Key::C);
    harness.run_steps(2);
    assert!(harness.state().split.is_on);
    let before = harness.state().eye;
    drag(&mut harness, pos2(450.0, 600.0), pos2(675.0, 600.0));
    assert!((harness.state().split.at - 0.75).abs() < 0.02, "{}", harness.state().split.at);
    assert_eq!(harness.state().eye, before, "the camera stays");
    drag(&mut harness, pos2(500.0, 300.0), pos2(550.0, 300.0));
    assert_ne!(harness.state().eye, before, "beside the line it turns");
}

#[test]
fn emission_and_albedo_are_edited_where_the_method_allows() {
    let mut state = state();
    assert!(state.lighting.lighting().emission.is_empty(), "as the scene has it");
    state.lighting.emission[0] = Vec3::ONE;
    assert_eq!(state.lighting.lighting().emission[0], Vec3::ONE);
    assert_eq!(state.why_no_albedo(), None, "classic");
    assert!(state.albedo.iter().all(Option::is_none));
    state.methods.choose("local").unwrap();
    assert!(state.why_no_albedo().unwrap().contains("choose classic"));
    assert_eq!(state.material("nowhere").unwrap_err().split(';').next(), Some("there is no material `nowhere`"));
}

#[test]
fn the_object_is_switched_on_before_the_camera_and_dragged() {
    let mut harness = harness(state());
    assert!(harness.state().has_probes && !harness.state().object.is_on);
    harness.get_by_label("Object").click();
    harness.run_steps(20);
    harness.get_by_label("a ball, lit by probes").click();
    harness.run_steps(3);
    let state = harness.state();
    assert!(state.object.is_on);
    assert_eq!(state.object.position, state.place_ahead());
    // Beside the panel.
    let camera = state.eye.camera((900, 1200));
    let place = camera.eye + 0.5 * (camera.forward + 0.4 * camera.right);
    harness.state_mut().object.position = place;
    harness.run_steps(2);
    let shown = project(&camera, place).unwrap();
    let at = pos2(shown.x * SIZE.x, shown.y * SIZE.y);
    drag(&mut harness, at, at + vec2(60.0, -45.0));
    let now = project(&camera, harness.state().object.position).unwrap();
    let by = vec2((now.x - shown.x) * SIZE.x, (now.y - shown.y) * SIZE.y);
    assert!((by - vec2(60.0, -45.0)).length() < 8.0, "{by}");
}
