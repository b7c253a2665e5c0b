//! Keys and pointer over the picture: the camera, the handles of lights and of the object, the line of the split
//! screen.

use egui::{Color32, CursorIcon, Id, Key, Modifiers, Pos2, Rect, Response, Sense, Stroke, Ui, Vec2, pos2, vec2};
use glam::Vec3;
use scene::Camera;

use crate::eye::{Eye, Flight, moved, project};
use crate::state::{Picked, Request, Shown, State};

/// Longest step of a flight, s: after a pause the camera does not jump.
const LONGEST_STEP: f32 = 0.1;
/// Radius of a light's handle, points.
const HANDLE: f32 = 7.0;
/// Width at which the line of the split screen is taken hold of, points.
const LINE: f32 = 10.0;
/// Points of a notch of the wheel.
const NOTCH: f32 = 40.0;

/// Digits, by the camera that they recall.
const DIGITS: [Key; 9] =
    [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8, Key::Num9];

/// Takes what keys and pointer say in what the panels leave, with the picture at `picture` (points).
pub fn show(ui: &mut Ui, state: &mut State, picture: Rect) {
    let free = ui.available_rect_before_wrap();
    let background = ui.interact(free, Id::new("picture"), Sense::click_and_drag());
    if background.dragged() {
        let delta = background.drag_delta();
        state.eye.turn((delta.x, delta.y), picture.height());
    }
    if background.clicked()
        && ui.input(|input| input.modifiers.command)
        && let Some(pointer) = background.interact_pointer_pos()
    {
        let place = (pointer - picture.min) / picture.size().max(vec2(1.0, 1.0));
        state.requests.push(Request::Pick(place.x, place.y));
    }
    if background.contains_pointer() {
        let notches = ui.input(|input| input.smooth_scroll_delta().y / NOTCH);
        if notches != 0.0 {
            state.eye.change_speed(notches);
        }
    }
    if !ui.ctx().egui_wants_keyboard_input() {
        fly(ui, &mut state.eye);
        commands(ui, state);
    }
    if state.is_playing {
        state.play(ui.input(|input| input.stable_dt.min(LONGEST_STEP)));
        ui.ctx().request_repaint();
    }
    if state.split.is_on {
        divider(ui, state, picture);
    }
    if state.has_panels {
        handles(ui, state, picture);
    }
}

fn fly(ui: &Ui, eye: &mut Eye) {
    let (flight, seconds) = ui.input(|input| {
        let held = |key| if input.key_down(key) { 1.0 } else { 0.0 };
        let flight = Flight {
            right: held(Key::D) - held(Key::A),
            up: held(Key::E) - held(Key::Q),
            forward: held(Key::W) - held(Key::S),
            is_fast: input.modifiers.shift,
        };
        (flight, input.stable_dt.min(LONGEST_STEP))
    });
    if flight != (Flight { is_fast: flight.is_fast, ..Flight::default() }) {
        eye.fly(&flight, seconds);
        ui.ctx().request_repaint();
    }
}

fn commands(ui: &Ui, state: &mut State) {
    let pressed = |key| ui.input_mut(|input| input.consume_key(Modifiers::NONE, key));
    if pressed(Key::Tab) {
        state.has_panels = !state.has_panels;
    }
    if pressed(Key::F1) {
        state.has_help = !state.has_help;
    }
    if pressed(Key::F12) {
        state.requests.push(Request::Screenshot(None));
    }
    if pressed(Key::Escape) {
        state.requests.push(Request::Quit);
    }
    if pressed(Key::C) {
        state.split.is_on = !state.split.is_on;
    }
    if pressed(Key::V) {
        let place = state.showable.iter().position(|shown| *shown == state.shown).unwrap_or(0);
        state.shown = state.showable.get(place + 1).copied().unwrap_or(Shown::Light);
    }
    if pressed(Key::M) {
        next_method(state);
    }
    if pressed(Key::Home) {
        state.eye = state.cameras[0].1;
    }
    for (number, key) in DIGITS.into_iter().enumerate() {
        if ui.input_mut(|input| input.consume_key(Modifiers::SHIFT, key)) {
            keep_camera(state, number);
        } else if pressed(key)
            && let Some((_, eye)) = state.cameras.get(number)
        {
            state.eye = *eye;
        }
    }
}

fn next_method(state: &mut State) {
    let names: Vec<String> =
        state.methods.choices().iter().filter(|c| c.why_not.is_none()).map(|c| c.name.clone()).collect();
    let place = names.iter().position(|name| *name == state.methods.chosen().name).unwrap_or(0);
    if let Err(why) = state.methods.choose(&names[(place + 1) % names.len()]) {
        state.facts.message = why;
    }
}

/// Keeps the camera under a number, or under the next free one.
fn keep_camera(state: &mut State, number: usize) {
    let kept = (format!("kept {}", number.min(state.cameras.len()) + 1), state.eye);
    match state.cameras.get_mut(number) {
        Some(camera) => *camera = kept,
        None => state.cameras.push(kept),
    }
}

fn divider(ui: &mut Ui, state: &mut State, picture: Rect) {
    let x = picture.left() + state.split.at * picture.width();
    let line = Rect::from_x_y_ranges(x - 0.5 * LINE..=x + 0.5 * LINE, picture.y_range());
    let response = ui.interact(line, Id::new("divider"), Sense::drag()).on_hover_cursor(CursorIcon::ResizeHorizontal);
    if let Some(pointer) = response.interact_pointer_pos().filter(|_| response.dragged()) {
        state.split.at = ((pointer.x - picture.left()) / picture.width().max(1.0)).clamp(0.0, 1.0);
    }
    ui.painter().vline(x, picture.y_range(), Stroke::new(1.0, Color32::WHITE));
}

/// A handle of something in the scene.
struct Handle {
    response: Response,
    centre: Pos2,
    /// Displacement by dragging, m.
    moved: Vec3,
}

/// The handle of what is at a place, m; none outside of the picture and under the panels.
fn handle(ui: &mut Ui, id: Id, camera: &Camera, picture: Rect, place: Vec3) -> Option<Handle> {
    let shown = project(camera, place)?;
    let centre = pos2(picture.left() + shown.x * picture.width(), picture.top() + shown.y * picture.height());
    // Not under the panels.
    if !picture.intersect(ui.available_rect_before_wrap()).contains(centre) {
        return None;
    }
    let rect = Rect::from_center_size(centre, vec2(2.0 * HANDLE, 2.0 * HANDLE));
    let response = ui.interact(rect, id, Sense::click_and_drag());
    let delta = if response.dragged() { response.drag_delta() } else { Vec2::ZERO };
    let moved = moved(camera, shown.z, (delta.x / picture.width(), delta.y / picture.height()));
    Some(Handle { response, centre, moved })
}

fn handles(ui: &mut Ui, state: &mut State, picture: Rect) {
    let size = (picture.width().max(1.0) as u32, picture.height().max(1.0) as u32);
    let camera = state.eye.camera((size.0.max(1), size.1.max(1)));
    let mut selected = state.selected;
    for (index, light) in state.lighting.lights.iter_mut().enumerate().filter(|(_, light)| light.has_position()) {
        let id = Id::new(("light", index));
        let Some(handle) = handle(ui, id, &camera, picture, light.handle()) else { continue };
        light.light.position += handle.moved;
        if handle.response.dragged() || handle.response.clicked() {
            selected = Some(index);
        }
        draw_handle(ui, light.color, light.is_on, handle.centre, selected == Some(index));
    }
    state.selected = selected;
    let places = state.places();
    let moves_all = ui.input(|input| input.modifiers.shift);
    for (index, place) in places.into_iter().enumerate() {
        let corners = &state.moving[index].corners;
        let middle = corners.iter().sum::<Vec3>() / corners.len().max(1) as f32;
        let id = Id::new(("moving", index));
        let Some(handle) = handle(ui, id, &camera, picture, place.transform_point3(middle)) else { continue };
        if handle.response.dragged() || handle.response.clicked() {
            state.held = index;
        }
        let own = if moves_all { &mut state.put[..] } else { &mut state.put[index..=index] };
        own.iter_mut().for_each(|put| put.way += handle.moved);
        draw_handle(ui, Vec3::ONE, true, handle.centre, handle.response.dragged());
    }
    let object = &mut state.object;
    if object.is_on
        && let Some(handle) = handle(ui, Id::new("object"), &camera, picture, object.position)
    {
        object.position += handle.moved;
        draw_handle(ui, object.albedo, true, handle.centre, handle.response.dragged());
    }
    if let Some(picked) = &mut state.picked
        && let Some(handle) = handle(ui, Id::new("picked"), &camera, picture, picked.middle + picked.way)
    {
        picked.way += handle.moved;
        draw_handle(ui, Vec3::ONE, true, handle.centre, true);
        if handle.response.drag_stopped() && picked.way != Vec3::ZERO {
            let Picked { object, way, .. } = *picked;
            *picked = Picked { middle: picked.middle + way, way: Vec3::ZERO, ..*picked };
            state.requests.push(Request::Move { object, way });
        }
    }
}

fn draw_handle(ui: &Ui, color: Vec3, is_on: bool, centre: Pos2, is_selected: bool) {
    let color = color.to_array().map(|x| (255.0 * x.clamp(0.0, 1.0)) as u8);
    let fill = if is_on { Color32::from_rgb(color[0], color[1], color[2]) } else { Color32::DARK_GRAY };
    let width = if is_selected { 3.0 } else { 1.5 };
    ui.painter().circle(centre, HANDLE - 2.0, fill, Stroke::new(width, Color32::BLACK));
    ui.painter().circle_stroke(centre, HANDLE, Stroke::new(0.5 * width, Color32::WHITE));
}
