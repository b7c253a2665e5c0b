//! A room that only the sky lights, through the panes of a window. Panes are openings: glass takes no part.

use glam::Vec3;

use super::Built;
use super::builder::{Blocks, Builder, STANDING, UNCUT};
use super::shell::Shell;
use super::spec::{Parameter, Values};
use crate::import::{View, lights};

/// Panes side by side.
const PANES: Parameter = Parameter {
    name: "panes",
    about: "panes side by side, in two rows",
    default: 3.0,
    range: 1.0..=12.0,
    is_whole: true,
};
/// Width of the bars round the panes.
const BAR: Parameter = Parameter {
    name: "bar",
    about: "width of the bars round the panes, m; 0 for none",
    default: 0.04,
    range: 0.0..=0.1,
    is_whole: false,
};
/// Accepted parameters.
pub const PARAMETERS: &[Parameter] = &[PANES, BAR];

/// Room, and the window in its wall at z = 0, m.
const SHELL: Shell = Shell { size: Vec3::new(4.0, 2.6, 5.0), wall: 0.25, axis: 2, along: [0.6, 3.4], up: [0.8, 2.3] };
/// Rows of panes.
const ROWS: usize = 2;
/// The bars lie between these depths of the window, m.
const BARS: [f32; 2] = [-0.15, -0.1];

/// Builds it.
pub fn build(values: &Values) -> Result<Built, lights::Fault> {
    let mut b = Builder::default();
    SHELL.build(&mut b);
    let [frame, wood, cloth] =
        [b.plain("frame", [0.66, 0.66, 0.64]), b.plain("wood", [0.46, 0.32, 0.22]), b.plain("cloth", [0.3, 0.4, 0.5])];
    let bar = values.get_f32(&BAR);
    if bar > 0.0 {
        bars(&mut b, frame, values.count(&PANES), bar);
    }
    SHELL.table(&mut b, wood, Vec3::new(1.2, 0.0, 1.0), Vec3::new(1.4, 0.74, 0.7));
    b.object("chest");
    b.cuboid(cloth, Vec3::new(0.02, 0.0, 2.4), Vec3::new(0.5, 0.8, 3.6), STANDING);
    let view = View {
        eye: Vec3::new(3.3, 1.6, 4.7),
        target: Vec3::new(1.4, 1.1, 0.6),
        up: Vec3::Y,
        vertical_fov_degrees: 62.0,
    };
    let sky = Vec3::new(5.0, 6.0, 8.0);
    Ok(Built {
        mesh: b.mesh,
        lights: Vec::new(),
        sky,
        view,
        exposure_stops: 0.0,
        tracks: Vec::new(),
        moving: Vec::new(),
    })
}

/// Bars round and between all panes; they end at the sides of the window.
fn bars(b: &mut Builder, material: u32, panes: usize, bar: f32) {
    b.object("bars");
    let x_lines = bar_lines(SHELL.along, panes, bar);
    let y_lines = bar_lines(SHELL.up, ROWS, bar);
    let solid = |c: [i32; 3]| {
        // Bars go on into the wall, so that no face lies in its planes.
        let cell = |k: i32, lines: &[f32]| k.clamp(0, lines.len() as i32 - 2);
        let is_bar = cell(c[0], &x_lines) % 2 == 0 || cell(c[1], &y_lines) % 2 == 0;
        c[2] == 0 && is_bar
    };
    b.blocks(&Blocks { lines: [&x_lines, &y_lines, &BARS], solid: &solid, material: &|_, _, _| material, edge: UNCUT });
}

/// Start and end of bars: the first at the lower end, one after each pane.
fn bar_lines([low, high]: [f32; 2], panes: usize, bar: f32) -> Vec<f32> {
    let pitch = (high - low - bar) / panes as f32;
    let mut lines: Vec<f32> =
        (0..=panes).flat_map(|k| [low + pitch * k as f32, low + pitch * k as f32 + bar]).collect();
    if let Some(last) = lines.last_mut() {
        *last = high;
    }
    lines
}
