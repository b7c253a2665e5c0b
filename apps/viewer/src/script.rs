//! Scripts of input events, one a line, that drive the window as a person would.
//!
//! Each line is a command with its words; `#` begins a comment. Commands that change a setting take no frame, those of
//! keys and the pointer take as many as they say. [`HELP`] lists them.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use egui::{Event, Key, Modifiers, MouseWheelUnit, PointerButton, Pos2, TouchPhase, pos2, vec2};
use glam::Vec3;
use patchlight::MAX_ALBEDO;
use scene::Tone;

use crate::lights::NewLight;
use crate::state::{Request, SUB_FRAMES, Shown, State};

/// Seconds of a frame of a script, however long it takes.
pub const FRAME_SECONDS: f64 = 1.0 / 30.0;
/// Frames of a drag between pressing and releasing.
const DRAG_FRAMES: u32 = 8;

/// Frames in which a window takes another size.
const MAX_RESIZE_FRAMES: u32 = 600;

/// The commands, for the help of the program.
pub const HELP: &str = "\
wait N                       N frames
baked                        until the bake has the settings asked for, and what was moved its light
seconds N                    so long, by the clock
samples N                    until the path tracer has N paths a pixel
key NAME [N]                 hold a key for N frames (W, A, S, D, Q, E, Tab, F1, Home, 1 to 9 …)
shift NAME [N]               the same with Shift
drag X0 Y0 X1 Y1             drag the pointer over the window, pixels
wheel STEPS                  turn the wheel in the middle of the window
method NAME                  choose a method
view NAME                    light, patches, elements, axis, source, irradiance, refined, receivers, error
sun-hour H [TO N]            hour of the day; on to TO in N frames
sun-day N | latitude DEGREES
light add point|sun|spot     a light before the camera
light K on|off|remove        the light number K of the list, from 1
light K position X Y Z | direction X Y Z | color R G B | power P
emission MATERIAL R G B      emitted radiance, W/m2/sr
albedo MATERIAL R G B|bake   share of the light that it reflects; that of the bake again
object ahead|X Y Z|off       a ball before the camera or there, m, lit by probes
object radius M | albedo R G B
time S | play on|off          time of the objects of the scene that move, s; it goes on or stands
move OBJECT X Y Z            an object of the scene, by its name or its number from 1, by so much, m
turn OBJECT DEGREES          something that moves, about the upright axis through its origin
exposure STOPS|auto
tone agx|neutral|none
camera N                     the camera number N of the list, from 1
eye X Y Z TX TY TZ           a place and what it looks at, m
split off|SHARE              compare at the right of SHARE of the width
panels on|off
sub-frames N | size WxH
smooth on|off                edges become smooth while nothing moves; off at first
screenshot NAME.png          the window as it is shown
quit";

/// Fault of a script.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}, line {line}: {reason}", path.display())]
pub struct ScriptError {
    /// The file.
    pub path: PathBuf,
    /// The line, from 1.
    pub line: usize,
    /// The fault and its remedy.
    pub reason: String,
}

/// End of a wait.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Until {
    Frames(u32),
    /// The bake has the settings asked for.
    Baked,
    /// By the clock.
    Seconds(f32),
}

/// A change of a light.
#[derive(Clone, Copy, Debug, PartialEq)]
enum LightChange {
    Switch(bool),
    Remove,
    Position(Vec3),
    Direction(Vec3),
    Color(Vec3),
    Power(f32),
}

/// A change of the object.
#[derive(Clone, Copy, Debug, PartialEq)]
enum ObjectChange {
    /// There, or before the camera.
    Place(Option<Vec3>),
    Remove,
    Radius(f32),
    Albedo(Vec3),
}

#[derive(Clone, Debug, PartialEq)]
enum Command {
    Wait(Until),
    Samples(u32),
    Key { key: Key, frames: u32, is_shift: bool },
    Drag { from: Pos2, to: Pos2 },
    Wheel(f32),
    Method(String),
    View(Shown),
    SunHour { hour: f32, to: f32, frames: u32 },
    SunDay(f32),
    Latitude(f32),
    AddLight(NewLight),
    Light { number: usize, change: LightChange },
    Emission { material: String, radiance: Vec3 },
    Albedo { material: String, albedo: Option<Vec3> },
    Object(ObjectChange),
    Move { object: String, way: Vec3 },
    Turn { object: String, degrees: f32 },
    Time(f32),
    Play(bool),
    Exposure(Option<f32>),
    Tone(Tone),
    Camera(usize),
    Eye { position: Vec3, target: Vec3 },
    Split(Option<f32>),
    Panels(bool),
    SubFrames(u32),
    Smooth(bool),
    Size(u32, u32),
    Screenshot(PathBuf),
    Quit,
}

/// A script under way.
#[derive(Clone, Debug)]
pub struct Script {
    path: PathBuf,
    commands: VecDeque<(usize, Command)>,
    /// Frames that the first command has taken, and when it began.
    taken: u32,
    begun: Instant,
}

impl Script {
    /// Reads a script.
    ///
    /// # Errors
    /// The first line that is no command, with what to write.
    pub fn parse(path: &Path, text: &str) -> Result<Self, ScriptError> {
        let mut commands = VecDeque::new();
        for (line, content) in (1..).zip(text.lines()) {
            let content = content.split('#').next().unwrap_or_default();
            let words: Vec<&str> = content.split_whitespace().collect();
            if words.is_empty() {
                continue;
            }
            let command =
                Words(&words).command().map_err(|reason| ScriptError { path: path.to_path_buf(), line, reason })?;
            commands.push_back((line, command));
        }
        Ok(Self { path: path.to_path_buf(), commands, taken: 0, begun: Instant::now() })
    }

    /// Returns true if there is nothing left to do.
    pub fn is_done(&self) -> bool {
        self.commands.is_empty()
    }

    /// Returns true if it waits for the path tracer.
    pub fn waits_for_samples(&self) -> bool {
        self.taken > 0 && matches!(self.commands.front(), Some((_, Command::Samples(_))))
    }

    /// Returns true if it waits for the bake or the clock: nothing is to be hurried.
    pub fn waits_for_bake(&self) -> bool {
        self.taken > 0 && matches!(self.commands.front(), Some((_, Command::Wait(Until::Baked | Until::Seconds(_)))))
    }

    /// Goes on by one frame: changes the state, and adds the events of keys and pointer, in points of a window so large
    /// with so many pixels a point.
    ///
    /// # Errors
    /// The line that asks for what is not there.
    pub fn step(&mut self, state: &mut State, window: Window, events: &mut Vec<Event>) -> Result<(), ScriptError> {
        while let Some((line, command)) = self.commands.front().cloned() {
            let is_over = self.run(&command, state, window, events).map_err(|reason| ScriptError {
                path: self.path.clone(),
                line,
                reason,
            })?;
            let ends_frame =
                !is_over || matches!(command, Command::Screenshot(_) | Command::Quit | Command::Move { .. });
            if is_over {
                self.commands.pop_front();
                self.taken = 0;
                self.begun = Instant::now();
            } else {
                self.taken += 1;
            }
            if ends_frame {
                break;
            }
        }
        Ok(())
    }

    /// Runs a frame of a command; whether it is over before the frame.
    fn run(
        &self,
        command: &Command,
        state: &mut State,
        window: Window,
        events: &mut Vec<Event>,
    ) -> Result<bool, String> {
        match command {
            Command::Wait(Until::Frames(frames)) => return Ok(self.taken >= *frames),
            Command::Wait(Until::Baked) => return Ok(state.facts.bake.is_none()),
            Command::Wait(Until::Seconds(seconds)) => return Ok(self.begun.elapsed().as_secs_f32() >= *seconds),
            Command::Samples(samples) => {
                if !state.compares() || state.facts.reference.is_some() {
                    return Err("no paths are traced; write `split 0.5` before, without a reference in a file".into());
                }
                return Ok(state.facts.comparison.is_some_and(|found| found.samples >= *samples));
            }
            Command::Key { key, frames, is_shift } => {
                let modifiers = if *is_shift { Modifiers::SHIFT } else { Modifiers::NONE };
                let is_over = self.taken >= *frames;
                if self.taken == 0 || is_over {
                    let pressed = !is_over;
                    let held = if pressed { modifiers } else { Modifiers::NONE };
                    events.push(Event::ModifiersChanged(held));
                    events.push(Event::Key { key: *key, physical_key: None, pressed, repeat: false, modifiers });
                }
                return Ok(is_over);
            }
            Command::Drag { from, to } => return Ok(self.drag(window.point(*from), window.point(*to), events)),
            Command::Wheel(steps) => {
                events.push(Event::PointerMoved(window.middle()));
                let delta = vec2(0.0, *steps);
                let unit = MouseWheelUnit::Line;
                let phase = TouchPhase::Move;
                let modifiers = Modifiers::NONE;
                events.push(Event::MouseWheel { unit, delta, phase, modifiers });
                return Ok(self.taken > 0);
            }
            Command::Size(width, height) => {
                if self.taken == 0 {
                    state.requests.push(Request::Resize(*width, *height));
                }
                if self.taken > MAX_RESIZE_FRAMES {
                    let (w, h) = window.size;
                    return Err(format!("the window system keeps the window at {w}x{h}; choose a smaller size"));
                }
                return Ok(self.taken > 0 && window.size == (*width, *height));
            }
            Command::SunHour { hour, to, frames } => {
                let share = if *frames == 0 { 1.0 } else { self.taken as f32 / *frames as f32 };
                state.sun.hour = hour + (to - hour) * share;
                place_sun(state)?;
                return Ok(self.taken >= *frames);
            }
            _ => apply(command, state)?,
        }
        Ok(true)
    }

    fn drag(&self, from: Pos2, to: Pos2, events: &mut Vec<Event>) -> bool {
        let button = |pos, pressed| Event::PointerButton {
            pos,
            button: PointerButton::Primary,
            pressed,
            modifiers: Modifiers::NONE,
        };
        match self.taken {
            0 => events.push(Event::PointerMoved(from)),
            1 => events.push(button(from, true)),
            taken => {
                let share = ((taken - 1) as f32 / DRAG_FRAMES as f32).min(1.0);
                events.push(Event::PointerMoved(from + (to - from) * share));
                if taken > DRAG_FRAMES {
                    events.push(button(to, false));
                    return self.taken > DRAG_FRAMES + 1;
                }
            }
        }
        false
    }
}

/// The window that a script drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Its size, pixels.
    pub size: (u32, u32),
    /// Pixels a point.
    pub pixels_per_point: f32,
}

impl Window {
    fn point(&self, pixel: Pos2) -> Pos2 {
        pos2(pixel.x / self.pixels_per_point, pixel.y / self.pixels_per_point)
    }

    fn middle(&self) -> Pos2 {
        self.point(pos2(0.5 * self.size.0 as f32, 0.5 * self.size.1 as f32))
    }
}

fn place_sun(state: &mut State) -> Result<(), String> {
    match state.place_sun() {
        true => Ok(()),
        false => Err("the scene has no sun; write `light add sun` before".into()),
    }
}

/// Applies a command that takes no frame.
fn apply(command: &Command, state: &mut State) -> Result<(), String> {
    match command {
        Command::Method(name) => state.methods.choose(name)?,
        Command::View(shown) => {
            if !state.showable.contains(shown) {
                return Err(format!("this bake has no view `{}`", shown.name()));
            }
            state.shown = *shown;
        }
        Command::SunDay(day) => {
            state.sun.day = *day;
            place_sun(state)?;
        }
        Command::Latitude(degrees) => {
            state.sun.latitude = *degrees;
            place_sun(state)?;
        }
        Command::AddLight(new) => add_light(state, *new),
        Command::Light { number, change } => change_light(state, *number, *change)?,
        Command::Emission { material, radiance } => {
            let index = state.material(material)?;
            state.lighting.emission[index] = *radiance;
        }
        Command::Albedo { material, albedo } => {
            let index = state.material(material)?;
            state.why_no_albedo().map_or(Ok(()), Err)?;
            state.albedo[index] = *albedo;
        }
        Command::Object(change) => change_object(state, *change)?,
        Command::Time(time) => {
            if !(0.0..=state.duration).contains(time) {
                return Err(format!("the scene has movement from 0 to {} s", state.duration));
            }
            state.time = *time;
        }
        Command::Play(is_on) => state.is_playing = *is_on,
        Command::Move { object, way } => {
            if let Some(own) = state.moving_object(object) {
                state.put[own].way += *way;
                return Ok(());
            }
            let object = state.scene_object(object)?;
            state.requests.push(Request::Move { object, way: *way });
        }
        Command::Turn { object, degrees } => {
            let names = || state.moving.iter().map(|own| own.name.as_str()).collect::<Vec<_>>().join(", ");
            let own = state.moving_object(object);
            let own = own.ok_or_else(|| format!("nothing that moves is called `{object}`; there are: {}", names()))?;
            state.put[own].turn = *degrees;
        }
        Command::Exposure(stops) => expose(state, *stops),
        Command::Tone(tone) => state.display.tone = *tone,
        Command::Camera(number) => choose_camera(state, *number)?,
        Command::Eye { position, target } => {
            let direction = (*target - *position).try_normalize();
            state.eye.position = *position;
            state.eye.look_along(direction.ok_or("the place and its target are one; give two places")?);
        }
        Command::Split(share) => split(state, *share),
        Command::Panels(is_on) => state.has_panels = *is_on,
        Command::SubFrames(count) => state.sub_frames = *count,
        Command::Smooth(is_on) => state.is_smooth = *is_on,
        Command::Screenshot(name) => state.requests.push(Request::Screenshot(Some(name.clone()))),
        Command::Quit => state.requests.push(Request::Quit),
        // What takes frames is in `Script::run`.
        Command::Wait(_)
        | Command::Samples(_)
        | Command::Key { .. }
        | Command::Drag { .. }
        | Command::Wheel(_)
        | Command::Size(..)
        | Command::SunHour { .. } => {}
    }
    Ok(())
}

/// Sets the exposure; without a number it follows what is seen.
fn expose(state: &mut State, stops: Option<f32>) {
    state.display.stops = stops.unwrap_or(state.display.stops);
    state.is_auto_exposed = stops.is_none();
}

/// Splits the screen at a share of its width, or no more.
fn split(state: &mut State, share: Option<f32>) {
    state.split.is_on = share.is_some();
    state.split.at = share.unwrap_or(state.split.at);
}

/// Adds a light ahead, shining where the eye looks.
fn add_light(state: &mut State, new: NewLight) {
    let place = state.place_ahead();
    let direction = state.eye.forward();
    state.lighting.add(new, place, direction, 0.3 * state.distance);
}

fn choose_camera(state: &mut State, number: usize) -> Result<(), String> {
    let count = state.cameras.len();
    let camera = number.checked_sub(1).and_then(|index| state.cameras.get(index));
    state.eye = camera.ok_or_else(|| format!("there is no camera {number}; there are {count}"))?.1;
    Ok(())
}

fn change_object(state: &mut State, change: ObjectChange) -> Result<(), String> {
    let ahead = state.place_ahead();
    let object = &mut state.object;
    match change {
        ObjectChange::Place(_) if !state.has_probes => {
            return Err("probes need receivers on the mesh; bake with those".into());
        }
        ObjectChange::Place(position) => {
            object.is_on = true;
            object.position = position.unwrap_or(ahead);
        }
        ObjectChange::Remove => object.is_on = false,
        ObjectChange::Radius(radius) => object.radius = radius,
        ObjectChange::Albedo(albedo) => object.albedo = albedo,
    }
    Ok(())
}

fn change_light(state: &mut State, number: usize, change: LightChange) -> Result<(), String> {
    let count = state.lighting.lights.len();
    let index = number.checked_sub(1).filter(|index| *index < count);
    let index = index.ok_or_else(|| format!("there is no light {number}; there are {count}"))?;
    let light = &mut state.lighting.lights[index];
    match change {
        LightChange::Switch(is_on) => light.is_on = is_on,
        LightChange::Remove => {
            state.lighting.lights.remove(index);
        }
        LightChange::Position(_) if !light.has_position() => return Err("a sun has no position".into()),
        LightChange::Position(position) => light.light.position = position,
        LightChange::Direction(_) if !light.has_direction() => {
            return Err(format!("a {} has no direction", light.kind()));
        }
        LightChange::Direction(direction) => {
            light.light.direction = direction.try_normalize().ok_or("three zeros are no direction")?;
        }
        LightChange::Color(color) => light.color = color,
        LightChange::Power(power) => light.power = power,
    }
    Ok(())
}

/// The words of a line.
struct Words<'a>(&'a [&'a str]);

impl Words<'_> {
    fn command(&self) -> Result<Command, String> {
        match self.0[0] {
            "wait" | "baked" | "seconds" | "samples" | "key" | "shift" | "drag" | "wheel" | "size" => self.input(),
            "sun-hour" | "sun-day" | "latitude" => self.sun(),
            "light" => self.light(),
            "emission" | "albedo" => self.material(),
            "object" => self.object(),
            "move" => self.movement(),
            "turn" => self.turn(),
            "time" => Ok(Command::Time(self.only("S")?)),
            "play" => self.count(2..=2, "on|off").and_then(|()| Ok(Command::Play(self.switch(1)?))),
            "camera" | "eye" | "method" | "view" => self.look(),
            "exposure" | "tone" | "split" | "panels" | "smooth" | "sub-frames" => self.setting(),
            "screenshot" => self.screenshot(),
            "quit" => Ok(Command::Quit),
            other => {
                let commands: Vec<&str> = HELP.lines().filter_map(|line| line.split(' ').next()).collect();
                Err(format!("there is no command `{other}`; choose from {}", commands.join(", ")))
            }
        }
    }

    /// Command that takes frames.
    fn input(&self) -> Result<Command, String> {
        let words = self.0;
        Ok(match words[0] {
            "wait" => Command::Wait(Until::Frames(self.only("N")?)),
            "baked" => {
                self.count(1..=1, "")?;
                Command::Wait(Until::Baked)
            }
            "seconds" => Command::Wait(Until::Seconds(self.only("N")?)),
            "samples" => Command::Samples(self.only("N")?),
            "wheel" => Command::Wheel(self.only("STEPS")?),
            "drag" => {
                self.count(5..=5, "X0 Y0 X1 Y1")?;
                Command::Drag { from: self.pixel(1)?, to: self.pixel(3)? }
            }
            "size" => {
                self.count(2..=2, "WxH")?;
                let numbers = words[1].split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
                match numbers {
                    Some((width @ 16..=16384, height @ 16..=16384)) => Command::Size(width, height),
                    _ => return Err(format!("`{}` is no size of 16 to 16384 pixels; as in `size 640x360`", words[1])),
                }
            }
            _ => {
                self.count(2..=3, "NAME [N]")?;
                let key =
                    Key::from_name(words[1]).ok_or_else(|| format!("`{}` is no key; as in `key W 10`", words[1]))?;
                let frames = if words.len() == 3 { self.number(2)? } else { 1 };
                Command::Key { key, frames, is_shift: words[0] == "shift" }
            }
        })
    }

    fn sun(&self) -> Result<Command, String> {
        match self.0[0] {
            "sun-day" => Ok(Command::SunDay(self.only("N")?)),
            "latitude" => Ok(Command::Latitude(self.only("DEGREES")?)),
            _ => {
                let hour = self.number(1)?;
                if self.0.len() == 2 {
                    return Ok(Command::SunHour { hour, to: hour, frames: 0 });
                }
                self.count(4..=4, "H [TO N]")?;
                Ok(Command::SunHour { hour, to: self.number(2)?, frames: self.number(3)? })
            }
        }
    }

    /// The camera, and what its picture shows.
    fn look(&self) -> Result<Command, String> {
        let words = self.0;
        Ok(match words[0] {
            "camera" => Command::Camera(self.only("N")?),
            "eye" => {
                self.count(7..=7, "X Y Z TX TY TZ")?;
                Command::Eye { position: self.vector(1)?, target: self.vector(4)? }
            }
            "method" => {
                self.count(2..=3, "NAME")?;
                Command::Method(words[1..].join(" "))
            }
            _ => {
                self.count(2..=2, "NAME")?;
                let found = Shown::all().find(|shown| shown.name() == words[1]);
                let names: Vec<&str> = Shown::all().map(Shown::name).collect();
                let unknown = || format!("there is no view `{}`; choose from {}", words[1], names.join(", "));
                Command::View(found.ok_or_else(unknown)?)
            }
        })
    }

    fn setting(&self) -> Result<Command, String> {
        let words = self.0;
        Ok(match words[0] {
            "exposure" if words[1..] == ["auto"] => Command::Exposure(None),
            "exposure" => Command::Exposure(Some(self.only("STOPS|auto")?)),
            "tone" => {
                self.count(2..=2, "agx|neutral|none")?;
                let found = Tone::ALL.into_iter().find(|tone| tone.name() == words[1]);
                Command::Tone(found.ok_or_else(|| format!("`{}`: choose from agx, neutral, none", words[1]))?)
            }
            "panels" => Command::Panels(self.switch(1)?),
            "smooth" => Command::Smooth(self.switch(1)?),
            "split" => {
                self.count(2..=2, "off|SHARE")?;
                let share = if words[1] == "off" { None } else { Some(self.number::<f32>(1)?.clamp(0.0, 1.0)) };
                Command::Split(share)
            }
            _ => {
                let count = self.only("N")?;
                if !SUB_FRAMES.contains(&count) {
                    return Err(format!("{count} sub-frames; choose from {SUB_FRAMES:?}"));
                }
                Command::SubFrames(count)
            }
        })
    }

    fn screenshot(&self) -> Result<Command, String> {
        self.count(2..=2, "NAME.png")?;
        let name = Path::new(self.0[1]);
        if !name.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("png")) {
            return Err(format!("`{}` does not end in .png", self.0[1]));
        }
        Ok(Command::Screenshot(name.to_path_buf()))
    }

    /// The name of a material may have spaces.
    fn material(&self) -> Result<Command, String> {
        let words = self.0;
        let name = |count: usize| words[1..words.len() - count].join(" ");
        if words[0] == "albedo" && words.len() >= 3 && words[words.len() - 1] == "bake" {
            return Ok(Command::Albedo { material: name(1), albedo: None });
        }
        if words.len() < 5 {
            return Err(self.usage(if words[0] == "albedo" { "MATERIAL R G B|bake" } else { "MATERIAL R G B" }));
        }
        let first = words.len() - 3;
        Ok(match words[0] {
            "albedo" => Command::Albedo { material: name(3), albedo: Some(self.albedo(first)?) },
            _ => Command::Emission { material: name(3), radiance: self.light_color(first)? },
        })
    }

    fn object(&self) -> Result<Command, String> {
        let words = self.0;
        let change = match (words.get(1), words.len()) {
            (Some(&"ahead"), 2) => ObjectChange::Place(None),
            (Some(&"off"), 2) => ObjectChange::Remove,
            (Some(&"radius"), 3) => {
                let radius: f32 = self.number(2)?;
                if radius <= 0.0 {
                    return Err("a radius is above 0".into());
                }
                ObjectChange::Radius(radius)
            }
            (Some(&"albedo"), 5) => ObjectChange::Albedo(self.albedo(2)?),
            (_, 4) => ObjectChange::Place(Some(self.vector(1)?)),
            _ => return Err(self.usage("ahead, X Y Z, off, radius M, or albedo R G B")),
        };
        Ok(Command::Object(change))
    }

    /// Name of an object, which may have spaces, and where the numbers after it begin.
    fn object_before(&self, numbers: usize, usage: &str) -> Result<(String, usize), String> {
        let words = self.0;
        if words.len() < numbers + 2 {
            return Err(self.usage(usage));
        }
        let first = words.len() - numbers;
        Ok((words[1..first].join(" "), first))
    }

    fn movement(&self) -> Result<Command, String> {
        let (object, first) = self.object_before(3, "OBJECT X Y Z")?;
        Ok(Command::Move { object, way: self.vector(first)? })
    }

    fn turn(&self) -> Result<Command, String> {
        let (object, last) = self.object_before(1, "OBJECT DEGREES")?;
        Ok(Command::Turn { object, degrees: self.number(last)? })
    }

    fn light(&self) -> Result<Command, String> {
        let words = self.0;
        let usage = "add point|sun|spot, K on|off|remove, or K position|direction|color|power NUMBERS";
        if words.len() < 3 {
            return Err(self.usage(usage));
        }
        if words[1] == "add" {
            let found = NewLight::ALL.into_iter().find(|new| new.name() == words[2]);
            return found.map(Command::AddLight).ok_or_else(|| self.usage(usage));
        }
        let change = match (words[2], words.len()) {
            ("on", 3) => LightChange::Switch(true),
            ("off", 3) => LightChange::Switch(false),
            ("remove", 3) => LightChange::Remove,
            ("position", 6) => LightChange::Position(self.vector(3)?),
            ("direction", 6) => LightChange::Direction(self.vector(3)?),
            ("color", 6) => LightChange::Color(self.light_color(3)?),
            ("power", 4) => LightChange::Power(self.number::<f32>(3)?.max(0.0)),
            _ => return Err(self.usage(usage)),
        };
        Ok(Command::Light { number: self.number(1)?, change })
    }

    fn usage(&self, words: &str) -> String {
        format!("write `{} {words}`", self.0[0])
    }

    fn count(&self, allowed: std::ops::RangeInclusive<usize>, usage: &str) -> Result<(), String> {
        if allowed.contains(&self.0.len()) { Ok(()) } else { Err(self.usage(usage)) }
    }

    /// The one number of a command.
    fn only<T: Number>(&self, usage: &str) -> Result<T, String> {
        self.count(2..=2, usage)?;
        self.number(1)
    }

    fn number<T: Number>(&self, index: usize) -> Result<T, String> {
        let word = self.0.get(index).ok_or_else(|| format!("word {} of `{}` is missing", index + 1, self.0[0]))?;
        let number = word.parse().ok().filter(T::is_usable);
        number.ok_or_else(|| format!("`{word}` is no {}", T::WHAT))
    }

    fn pixel(&self, index: usize) -> Result<Pos2, String> {
        Ok(pos2(self.number(index)?, self.number(index + 1)?))
    }

    fn vector(&self, index: usize) -> Result<Vec3, String> {
        Ok(Vec3::new(self.number(index)?, self.number(index + 1)?, self.number(index + 2)?))
    }

    fn light_color(&self, index: usize) -> Result<Vec3, String> {
        let color = self.vector(index)?;
        if color.min_element() < 0.0 { Err("light is not below 0".to_owned()) } else { Ok(color) }
    }

    fn albedo(&self, index: usize) -> Result<Vec3, String> {
        let albedo = self.vector(index)?;
        let is_share = albedo.min_element() >= 0.0 && albedo.max_element() <= MAX_ALBEDO;
        if is_share { Ok(albedo) } else { Err(format!("an albedo is a share from 0 to {MAX_ALBEDO}")) }
    }

    fn switch(&self, index: usize) -> Result<bool, String> {
        match self.0.get(index) {
            Some(&"on") => Ok(true),
            Some(&"off") => Ok(false),
            _ => Err(self.usage("on|off")),
        }
    }
}

/// Numbers of scripts.
trait Number: FromStr {
    const WHAT: &'static str;

    fn is_usable(&self) -> bool;
}

impl Number for f32 {
    const WHAT: &'static str = "number";

    fn is_usable(&self) -> bool {
        self.is_finite() && self.abs() <= 1e15
    }
}

impl Number for u32 {
    const WHAT: &'static str = "whole number";

    fn is_usable(&self) -> bool {
        true
    }
}

impl Number for usize {
    const WHAT: &'static str = "whole number";

    fn is_usable(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Script, ScriptError> {
        Script::parse(Path::new("tour.txt"), text)
    }

    #[test]
    fn each_command_of_the_help_is_read() {
        let text = "
            # a tour
            wait 3
            baked
            seconds 0.5
            samples 4 # paths
            key W 10
            shift F1
            drag 1 2 30.5 4
            wheel -2
            method temporal
            view irradiance
            sun-hour 8
            sun-hour 8 17.5 60
            sun-day 81
            latitude -33.9
            light add spot
            light 2 off
            light 1 position 1 2 3
            light 1 color 1 0.5 0
            light 1 power 20
            emission big lamp 1 2 3
            albedo big lamp 0.1 0.2 0.3
            albedo floor bake
            object 1 2 3
            object ahead
            object radius 0.5
            object albedo 0.8 0.8 0.8
            object off
            move tall block 0 0 0.5
            turn door -30
            time 1.5
            play on
            exposure -1
            exposure auto
            tone neutral
            camera 2
            eye 1 2 3 4 5 6
            split 0.25
            split off
            panels off
            sub-frames 4
            smooth on
            size 320x200
            screenshot a.png
            quit";
        let script = parse(text).unwrap();
        assert_eq!(script.commands.len(), 44);
        let radiance = Vec3::new(1.0, 2.0, 3.0);
        let emission = Command::Emission { material: "big lamp".into(), radiance };
        assert!(script.commands.contains(&(22, emission)), "{:?}", script.commands);
        for name in HELP.lines().flat_map(|line| line.split('|').next()).filter_map(|line| line.split(' ').next()) {
            let is_there = text.lines().any(|line| line.split_whitespace().next() == Some(name));
            assert!(is_there, "{name} is not tested");
        }
    }

    #[test]
    fn what_is_wrong_is_named_by_line_with_its_remedy() {
        let cases = [
            ("hover 3", "choose from wait"),
            ("wait", "wait N"),
            ("wait -1", "whole number"),
            ("key Flub 3", "key W 10"),
            ("drag 1 2 3", "X0 Y0 X1 Y1"),
            ("view shadows", "choose from light"),
            ("sun-hour noon", "no number"),
            ("sun-hour 8 17", "H [TO N]"),
            ("exposure inf", "no number"),
            ("light 1 shine", "on|off|remove"),
            ("light add laser", "point|sun|spot"),
            ("light 1 color 1 -1 0", "not below 0"),
            ("albedo floor 1 0 0", "0 to 0.95"),
            ("albedo bake", "MATERIAL R G B|bake"),
            ("object 1 2", "X Y Z"),
            ("object radius 0", "above 0"),
            ("move 1 2 3", "OBJECT X Y Z"),
            ("turn door", "OBJECT DEGREES"),
            ("sub-frames 3", "[1, 2, 4, 16]"),
            ("size 0x9", "size 640x360"),
            ("screenshot a.jpg", ".png"),
            ("panels maybe", "on|off"),
        ];
        for (line, remedy) in cases {
            let error = parse(&format!("wait 1\n\n{line}\nquit")).unwrap_err();
            assert_eq!(error.line, 3, "{line}");
            let text = error.to_string();
            assert!(text.starts_with("tour.txt, line 3: ") && text.contains(remedy), "{line}: {text}");
        }
    }
}
