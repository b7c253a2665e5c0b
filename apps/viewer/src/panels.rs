//! Panels over the picture: everything that can be changed, with the reason where it cannot.

use egui::{Color32, DragValue, Frame, Panel, ProgressBar, RichText, ScrollArea, Slider, Ui, Window};
use egui_plot::{Legend, Line, Plot, PlotPoints};
use glam::Vec3;
use patchlight::method::{FeedbackSettings, FirstShotSettings, LocalSettings, TemporalSettings};
use patchlight::{MAX_ALBEDO, MethodSettings};
use scene::Tone;

use crate::lights::NewLight;
use crate::state::{Comparison, DIVISORS, Put, Request, SUB_FRAMES, Shown, State};

/// Width of the panel, points.
const WIDTH: f32 = 290.0;
/// Height of the graph, points.
const GRAPH_HEIGHT: f32 = 190.0;

/// Actions of keys and pointer, for the help.
pub const KEYS: [(&str, &str); 15] = [
    ("W A S D", "fly ahead, left, back, right"),
    ("Q E", "down, up"),
    ("Shift", "four times as fast"),
    ("wheel", "change the speed"),
    ("drag", "look round; a light or the ball by its handle; the line of the split screen"),
    ("Home", "back to the scene's camera"),
    ("1 to 9", "camera of that number; with Shift, keep this one there"),
    ("C", "compare with the reference, or no longer"),
    ("V", "next view: light, patches, elements, …"),
    ("M", "next method"),
    ("Tab", "hide or show the panels"),
    ("Shift-drag", "move all that moves, by the handle of one"),
    ("Ctrl-click", "pick an object of the scene; drag its handle, and its light follows"),
    ("F1, F12", "this help; screenshot"),
    ("Esc", "close"),
];

/// Shows the panel and the help.
pub fn show(ui: &mut Ui, state: &mut State) {
    if state.has_panels {
        let fill = ui.visuals().panel_fill.gamma_multiply(0.88);
        let frame = Frame::NONE.fill(fill).inner_margin(8.0);
        Panel::left("panel").exact_size(WIDTH).resizable(false).frame(frame).show(ui, |ui| {
            ScrollArea::vertical().show(ui, |ui| sections(ui, state));
        });
    }
    if state.has_help {
        let mut is_open = true;
        Window::new("Help").default_pos([WIDTH + 30.0, 20.0]).open(&mut is_open).resizable(false).show(ui.ctx(), help);
        state.has_help = is_open;
    }
}

fn sections(ui: &mut Ui, state: &mut State) {
    header(ui, state);
    bake(ui, state);
    ui.separator();
    section(ui, "Method", true, |ui| methods(ui, state));
    section(ui, "Sun", true, |ui| sun(ui, state));
    section(ui, "Lights", true, |ui| lights(ui, state));
    section(ui, "Picture", true, |ui| picture(ui, state));
    section(ui, "Compare", false, |ui| compare(ui, state));
    section(ui, "Materials", false, |ui| materials(ui, state));
    section(ui, "Object", false, |ui| object(ui, state));
    if !state.moving.is_empty() {
        section(ui, "Movement", true, |ui| movement(ui, state));
    }
    section(ui, "Times", true, |ui| times(ui, state));
    section(ui, "Memory", false, |ui| memory(ui, state));
    if !state.facts.message.is_empty() {
        ui.separator();
        ui.label(&state.facts.message);
    }
}

fn section(ui: &mut Ui, name: &str, is_open: bool, show: impl FnOnce(&mut Ui)) {
    egui::CollapsingHeader::new(name).default_open(is_open).show(ui, show);
}

fn header(ui: &mut Ui, state: &mut State) {
    ui.horizontal(|ui| {
        if ui.button("Screenshot").clicked() {
            state.requests.push(Request::Screenshot(None));
        }
        if ui.button("Help").clicked() {
            state.has_help = !state.has_help;
        }
        if let Some(rate) = state.facts.times.last().back() {
            ui.label(format!("{:.0} ms", rate.total));
        }
    });
}

/// Progress of a bake that is refined, and what it says of its error.
fn bake(ui: &mut Ui, state: &State) {
    if let Some(progress) = &state.facts.bake {
        let phase = progress.phase.map_or("begins", |phase| phase.name());
        let text = format!(
            "level {} of {}: {} ({:.0} %)",
            progress.level + 1,
            progress.levels,
            phase.replace('_', " "),
            100.0 * progress.share
        );
        ui.add(ProgressBar::new(progress.share).text(text));
    }
    if !state.facts.quality.is_empty() {
        ui.label(RichText::new(&state.facts.quality).small());
    }
}

fn help(ui: &mut Ui) {
    egui::Grid::new("keys").num_columns(2).show(ui, |ui| {
        for (key, what) in KEYS {
            ui.label(RichText::new(key).strong());
            ui.label(what);
            ui.end_row();
        }
    });
}

fn methods(ui: &mut Ui, state: &mut State) {
    let chosen = state.methods.chosen().name.clone();
    for choice in state.methods.choices().to_vec() {
        let button = egui::RadioButton::new(choice.name == chosen, choice.name.as_str());
        let response = ui.add_enabled(choice.why_not.is_none(), button);
        let response = match &choice.why_not {
            Some(why) => response.on_disabled_hover_text(why),
            None => response,
        };
        if response.clicked()
            && let Err(why) = state.methods.choose(&choice.name)
        {
            state.facts.message = why;
        }
    }
    match state.methods.settings_mut() {
        MethodSettings::Classic | MethodSettings::Multibounce(_) => {}
        MethodSettings::Feedback(FeedbackSettings { products, accelerated, .. }) => {
            ui.add(Slider::new(products, 1..=16).text("bounces a frame"));
            ui.checkbox(accelerated, "accelerated");
        }
        MethodSettings::Temporal(TemporalSettings { settings, .. }) => {
            ui.add(Slider::new(&mut settings.samples, 1..=256).logarithmic(true).text("samples a row"));
            ui.checkbox(&mut settings.control_variate, "control variate");
            if settings.control_variate {
                ui.add(Slider::new(&mut settings.refresh, 0..=256).text("frames to refresh"));
            }
        }
        MethodSettings::Local(LocalSettings { slots, budget, .. }) => {
            ui.add(Slider::new(slots, 64..=8192).logarithmic(true).text("slots"));
            ui.add(Slider::new(budget, 1..=1024).logarithmic(true).text("changes a frame"));
        }
        MethodSettings::FirstShot(FirstShotSettings { error, .. }) => {
            ui.add(Slider::new(error, 0.005..=0.5).logarithmic(true).text("relative error"));
        }
    }
}

fn sun(ui: &mut Ui, state: &mut State) {
    if state.lighting.sun().is_none() {
        ui.label("The scene has no sun: add one under Lights.");
        return;
    }
    let time = &mut state.sun;
    let mut is_moved = ui.add(Slider::new(&mut time.hour, 0.0..=24.0).text("hour")).changed();
    is_moved |= ui.add(Slider::new(&mut time.day, 1.0..=365.0).integer().text("day of the year")).changed();
    is_moved |= ui.add(Slider::new(&mut time.latitude, -90.0..=90.0).text("latitude, °")).changed();
    if is_moved {
        state.place_sun();
    }
}

fn lights(ui: &mut Ui, state: &mut State) {
    ui.horizontal(|ui| {
        for new in NewLight::ALL {
            if ui.button(format!("+ {}", new.name())).clicked() {
                let place = state.place_ahead();
                let direction = state.eye.forward();
                state.lighting.add(new, place, direction, 0.3 * state.distance);
                state.selected = Some(state.lighting.lights.len() - 1);
            }
        }
    });
    let mut removed = None;
    for (index, light) in state.lighting.lights.iter_mut().enumerate() {
        let name = format!("{} {}", index + 1, light.kind());
        ui.horizontal(|ui| {
            ui.checkbox(&mut light.is_on, "");
            let mut color = light.color.to_array();
            if ui.color_edit_button_rgb(&mut color).changed() {
                light.color = Vec3::from_array(color);
            }
            if ui.selectable_label(state.selected == Some(index), name).clicked() {
                state.selected = if state.selected == Some(index) { None } else { Some(index) };
            }
            let speed = 0.01 * light.power.max(0.1);
            let unit = format!(" {}", light.unit());
            ui.add(DragValue::new(&mut light.power).speed(speed).range(0.0..=1e9).suffix(unit));
            if ui.button("x").on_hover_text("remove").clicked() {
                removed = Some(index);
            }
        });
        if state.selected == Some(index) {
            place_of(ui, light, state.distance);
        }
    }
    if let Some(index) = removed {
        state.lighting.lights.remove(index);
        state.selected = None;
    }
    if state.lighting.has_sky() {
        ui.add(Slider::new(&mut state.lighting.sky_scale, 0.0..=4.0).text("sky"));
    }
}

/// Time of the objects of the scene that move.
fn movement(ui: &mut Ui, state: &mut State) {
    ui.add(Slider::new(&mut state.time, 0.0..=state.duration).text("time, s"));
    ui.checkbox(&mut state.is_playing, "goes on");
    if let Some((object, put)) = state.moving.get(state.held).zip(state.put.get_mut(state.held)) {
        ui.add(Slider::new(&mut put.turn, -180.0..=180.0).text(format!("{}: turn, °", object.name)));
    }
    if ui.button("Back to the poses").clicked() {
        state.put.fill(Put::default());
    }
}

/// Position and direction of the light that is selected.
fn place_of(ui: &mut Ui, light: &mut crate::lights::EditedLight, distance: f32) {
    if light.has_position() {
        vector(ui, "position, m", &mut light.light.position, 0.005 * distance);
    }
    if light.has_direction() {
        let mut direction = light.light.direction;
        if vector(ui, "direction", &mut direction, 0.01)
            && let Some(direction) = direction.try_normalize()
        {
            light.light.direction = direction;
            // Whoever turns a sun by hand wants to see it.
            light.is_up = true;
        }
    }
}

/// Three numbers; whether they changed.
fn vector(ui: &mut Ui, name: &str, vector: &mut Vec3, speed: f32) -> bool {
    ui.horizontal(|ui| {
        let mut is_changed = false;
        for component in vector.as_mut() {
            is_changed |= ui.add(DragValue::new(component).speed(speed).max_decimals(3)).changed();
        }
        ui.label(name);
        is_changed
    })
    .inner
}

fn picture(ui: &mut Ui, state: &mut State) {
    ui.horizontal(|ui| {
        let exposure = Slider::new(&mut state.display.stops, -12.0..=12.0).text("exposure, stops");
        if ui.add(exposure).changed() {
            state.is_auto_exposed = false;
        }
        ui.checkbox(&mut state.is_auto_exposed, "auto");
    });
    ui.horizontal(|ui| {
        ui.label("tone curve");
        for tone in Tone::ALL {
            ui.selectable_value(&mut state.display.tone, tone, tone.name());
        }
    });
    egui::ComboBox::from_label("view").selected_text(state.shown.name()).show_ui(ui, |ui| {
        for shown in Shown::all() {
            let has_it = state.showable.contains(&shown);
            let button = egui::Button::selectable(state.shown == shown, shown.name());
            let why = "this bake has none of these";
            if ui.add_enabled(has_it, button).on_disabled_hover_text(why).clicked() {
                state.shown = shown;
            }
        }
    });
    ui.horizontal(|ui| {
        ui.label("sub-frames");
        for count in SUB_FRAMES {
            ui.selectable_value(&mut state.sub_frames, count, count.to_string());
        }
        ui.add_enabled(state.sub_frames == 1, egui::Checkbox::new(&mut state.is_smooth, "smooth"));
    });
    ui.horizontal(|ui| {
        ui.label("size");
        for divisor in DIVISORS {
            let name = if divisor == 1 { "1".to_owned() } else { format!("1/{divisor}") };
            ui.selectable_value(&mut state.divisor, divisor, name);
        }
        ui.label(format!("{} x {}", state.facts.size.0, state.facts.size.1));
    });
    let mut recalled = None;
    ui.horizontal_wrapped(|ui| {
        ui.label("camera");
        for (name, eye) in &state.cameras {
            if ui.button(name.as_str()).clicked() {
                recalled = Some(*eye);
            }
        }
    });
    state.eye = recalled.unwrap_or(state.eye);
}

fn compare(ui: &mut Ui, state: &mut State) {
    ui.checkbox(&mut state.split.is_on, "split screen");
    match &state.facts.reference {
        Some(file) => ui.label(format!("right: {file}")),
        None => ui.label("right: path tracing, while nothing moves"),
    };
    let Some(Comparison { samples, errors }) = state.facts.comparison.filter(|_| state.compares()) else { return };
    if samples > 0 {
        ui.label(format!("{samples} paths a pixel"));
    }
    match errors {
        Some(errors) => {
            ui.label(format!("PSNR {:.2} dB, SSIM {:.4}", errors.psnr_db, errors.ssim));
            let relative = 100.0 * errors.block_median_relative_error;
            ui.label(format!("relative error {relative:.2} %, mean ratio {:.4}", errors.mean_ratio));
        }
        None => {
            ui.label("too small or too dark to compare");
        }
    }
}

fn materials(ui: &mut Ui, state: &mut State) {
    ui.label(RichText::new("emitted radiance, W/m²/sr").strong());
    for (name, emission) in state.materials.iter().zip(&mut state.lighting.emission) {
        let power = emission.max_element();
        let mut color = if power > 0.0 { (*emission / power).to_array() } else { [1.0; 3] };
        let mut now = power;
        ui.horizontal(|ui| {
            let is_tinted = ui.color_edit_button_rgb(&mut color).changed();
            let speed = 0.01 * power.max(1.0);
            let is_changed = ui.add(DragValue::new(&mut now).speed(speed).range(0.0..=1e9)).changed();
            ui.label(name.as_str());
            if is_tinted || is_changed {
                *emission = Vec3::from_array(color) * now;
            }
        });
    }
    ui.add_space(6.0);
    ui.label(RichText::new("albedo").strong());
    let why_not = state.why_no_albedo();
    for ((name, own), albedo) in state.materials.iter().zip(&state.own_albedo).zip(&mut state.albedo) {
        ui.add_enabled_ui(why_not.is_none(), |ui| albedo_of(ui, name, *own, albedo));
    }
    if let Some(why) = why_not {
        ui.label(RichText::new(why).weak());
    }
}

/// The albedo of a material, and a button that brings that of the bake back.
fn albedo_of(ui: &mut Ui, name: &str, own: Option<Vec3>, albedo: &mut Option<Vec3>) {
    ui.horizontal(|ui| {
        // A texture has no one colour: begin with grey.
        let mut color = albedo.or(own).unwrap_or(Vec3::splat(0.5)).to_array();
        if ui.color_edit_button_rgb(&mut color).changed() {
            *albedo = Some(Vec3::from_array(color).clamp(Vec3::ZERO, Vec3::splat(MAX_ALBEDO)));
        }
        ui.label(format!("{name} albedo"));
        if albedo.is_some() && ui.button("as baked").clicked() {
            *albedo = None;
        }
    });
}

fn object(ui: &mut Ui, state: &mut State) {
    let mut is_on = state.object.is_on;
    let check = ui.add_enabled(state.has_probes, egui::Checkbox::new(&mut is_on, "a ball, lit by probes"));
    if check.on_disabled_hover_text("probes need receivers on the mesh: bake with those").changed() {
        state.object.is_on = is_on;
        if is_on {
            state.object.position = state.place_ahead();
        }
    }
    if !state.object.is_on {
        return;
    }
    vector(ui, "position, m", &mut state.object.position, 0.005 * state.distance);
    ui.horizontal(|ui| {
        let speed = 0.002 * state.distance;
        ui.add(DragValue::new(&mut state.object.radius).speed(speed).range(1e-6..=1e6).max_decimals(3));
        ui.label("radius, m");
        let mut color = state.object.albedo.to_array();
        if ui.color_edit_button_rgb(&mut color).changed() {
            state.object.albedo = Vec3::from_array(color);
        }
        ui.label("albedo");
    });
    ui.label(RichText::new("It casts neither light nor shadow back.").weak());
}

fn times(ui: &mut Ui, state: &State) {
    let times = &state.facts.times;
    let mut names: Vec<&str> = times.last().iter().flat_map(|f| f.passes.iter().map(|(n, _)| n.as_str())).collect();
    names.sort_unstable();
    names.dedup();
    let points = |ms: &dyn Fn(&crate::times::FrameTimes) -> f64| -> PlotPoints<'static> {
        times.last().iter().enumerate().map(|(k, frame)| [k as f64, ms(frame)]).collect()
    };
    Plot::new("times")
        .height(GRAPH_HEIGHT)
        .include_y(0.0)
        .show_x(false)
        .show_axes([false, true])
        .allow_scroll(false)
        .allow_zoom(false)
        .allow_drag(false)
        .legend(Legend::default().text_style(egui::TextStyle::Small).background_alpha(0.3))
        .show(ui, |plot| {
            plot.line(Line::new("frame", points(&|frame| frame.total)).color(Color32::GRAY));
            for name in names {
                let of_pass = |frame: &crate::times::FrameTimes| {
                    frame.passes.iter().filter(|(n, _)| n == name).map(|p| p.1).sum()
                };
                plot.line(Line::new(name, points(&of_pass)));
            }
        });
    if let Some(frame) = times.last().back() {
        ui.label(format!(
            "update {:.1}, shading {:.1}, presenting {:.1} ms",
            frame.update(),
            frame.shading(),
            frame.presenting()
        ));
    }
    ui.label(RichText::new(format!("{}; window: {}", state.facts.device, state.facts.screen)).weak());
}

fn memory(ui: &mut Ui, state: &State) {
    let megabytes = |bytes: u64| bytes as f64 * 1e-6;
    egui::Grid::new("bytes").num_columns(2).show(ui, |ui| {
        for (name, bytes) in state.facts.bytes.iter().filter(|(_, bytes)| *bytes > 0) {
            ui.label(name.as_str());
            ui.label(format!("{:.1} MB", megabytes(*bytes)));
            ui.end_row();
        }
        if let Some(resident) = state.facts.resident {
            ui.label("process");
            ui.label(format!("{:.0} MB", megabytes(resident)));
            ui.end_row();
        }
    });
}
