//! The window and its events.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use assets::LoadedScene;
use egui::{Event, Key, Modifiers, RawInput, Rect, ViewportId, pos2};
use glam::{Affine3A, Vec3};
use patchlight::memory::resident_bytes;
use patchlight::{Bake, BakeJob, Observer, Picture, Refinement};
use runtime::cpu::Cpu;
use runtime::executor::{DeviceChoice, Executor, PassTime};
use scene::kernel::camera::camera_direction;
use scene::{DisplayTransform, NONE, Scene, Tone, Visibility as _};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::window::{Window, WindowId};

use shell::args::{DisplaySettings, Exposure};

use crate::error::Error;
use crate::fit::fit;
use crate::live::{Live, check, quality, rgba};
use crate::methods::MethodDefaults;
use crate::reference::{Comparer, Job, is_displayed, read};
use crate::screen::{Gpu, Panels, Screen, Side, Source};
use crate::script::{self, FRAME_SECONDS, Script};
use crate::state::{Comparison, Picked, Request, Shown, State};
use crate::times::{FrameTimes, Pace, Rate};
use crate::{panels, pointer, screenshot};

/// Interval at which a stop is looked for, when nothing happens.
const LOOK: Duration = Duration::from_millis(100);
/// Time for which the window keeps a size before pictures follow it.
const RESIZED: Duration = Duration::from_millis(200);

/// A window system and a driver that can show windows.
pub struct Display {
    events: EventLoop<()>,
    gpu: Arc<Gpu>,
}

/// A bake that is shown.
pub struct Baking<'a> {
    /// What is there of it.
    pub bake: Arc<Bake>,
    /// Work on it that goes on.
    pub job: Option<BakeJob>,
    /// Begins the work of another scene, where things are moved before the bake is done.
    pub again: Option<Box<Again<'a>>>,
}

/// Begins the bake of a scene.
pub type Again<'a> = dyn Fn(&Scene) -> Result<BakeJob, patchlight::Error> + 'a;

/// Settings of the window.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// Device that runs the kernels.
    pub device: DeviceChoice,
    /// Size of the window, pixels.
    pub size: (u32, u32),
    /// Name of the method at first.
    pub method: String,
    /// Settings that methods have at first.
    pub methods: MethodDefaults,
    /// Sub-frames of a picture at first.
    pub sub_frames: u32,
    /// Pictures a second that are kept, by fewer pixels, while something moves; none for all pixels.
    pub fps: Option<f32>,
    /// Exposure and tone curve at first.
    pub shown: DisplaySettings,
    /// A picture to compare with, in place of the path tracer's.
    pub reference: Option<PathBuf>,
    /// A script that drives the window.
    pub script: Option<PathBuf>,
    /// Folder of screenshots.
    pub out: PathBuf,
    /// Seed of the path tracer's random numbers.
    pub seed: u32,
}

/// Report of what was shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Device that ran the kernels.
    pub device: String,
    /// Device that showed the window.
    pub screen: String,
    /// Size of the last picture, pixels.
    pub size: (u32, u32),
    /// Picture rate, and its limit; none without a picture.
    pub rate: Option<Rate>,
}

impl Display {
    /// Opens the window system, and sees that a Vulkan driver can show windows: before minutes of baking.
    ///
    /// # Errors
    /// [`Error::NoWindow`], [`Error::NoDevice`].
    pub fn open() -> Result<Self, Error> {
        let events = EventLoop::new().map_err(|error| Error::NoWindow { reason: reason(&error.to_string()) })?;
        let gpu = Gpu::new(&events.owned_display_handle(), shell::device::validation())?;
        Ok(Self { events, gpu })
    }

    /// Shows a bake until the window is closed, or `is_stopped` says so; of one that is refined, each level that its
    /// job has done.
    ///
    /// # Errors
    /// What the window system, Vulkan, the library, a script or a file says.
    pub fn show(
        self,
        loaded: &LoadedScene,
        baking: Baking,
        settings: &Settings,
        observer: &dyn Observer,
        is_stopped: &dyn Fn() -> bool,
    ) -> Result<Report, Error> {
        let Self { events, gpu } = self;
        let app = App::new(&gpu, events.create_proxy(), loaded, baking, settings, (observer, is_stopped))?;
        let report = run(events, app)?;
        // What is said while devices end, too.
        gpu.check_messages()?;
        Ok(report)
    }
}

/// Message of the window system, without the place in the source of the crate that says it.
fn reason(text: &str) -> String {
    let said = text.rsplit_once(".rs:").and_then(|(_, rest)| rest.split_once(": "));
    said.map_or(text, |(_, said)| said).trim_end_matches('.').to_owned()
}

fn run(events: EventLoop<()>, mut app: App) -> Result<Report, Error> {
    events.run_app(&mut app).map_err(|error| Error::NoWindow { reason: error.to_string() })?;
    app.outcome?;
    let facts = app.state.facts;
    Ok(Report { device: facts.device, screen: facts.screen, size: facts.size, rate: facts.times.rate() })
}

struct App<'a> {
    gpu: Arc<Gpu>,
    name: String,
    bake: Arc<Bake>,
    /// Work on the bake that goes on.
    job: Option<BakeJob>,
    again: Option<Box<Again<'a>>>,
    /// The scene with all that was moved, and true once a bake that was done was edited.
    scene: Scene,
    is_edited: bool,
    settings: &'a Settings,
    observer: &'a dyn Observer,
    is_stopped: &'a dyn Fn() -> bool,
    state: State,
    script: Option<Script>,
    comparer: Comparer,
    /// True if the comparison under way is of what is shown.
    is_compared: bool,
    has_reference: bool,
    /// The reference of a file, whose size all pictures have, and the exposure with which it is on the screen.
    file: Option<Arc<Picture>>,
    file_display: Option<DisplayTransform>,
    panels: egui::Context,
    // The executor, in `live`, ends before the device of the screen.
    open: Option<Open>,
    frames: u32,
    /// Size of the last frame, pixels.
    window_size: (u32, u32),
    /// When the last frame began.
    last_frame: Instant,
    /// When the last picture was shown, if the last frame had one.
    last_shown: Option<Instant>,
    /// Pixels while something moves, beside the state's own divisor.
    pace: Pace,
    /// Divisor of the last picture.
    last_divisor: u32,
    /// The size that the window has taken, and since when.
    resized: Option<((u32, u32), Instant)>,
    next: Option<Instant>,
    outcome: Result<(), Error>,
}

/// State while the window is open.
struct Open {
    live: Live,
    screen: Screen,
    input: egui_winit::State,
    window: Arc<Window>,
}

impl<'a> App<'a> {
    fn new(
        gpu: &Arc<Gpu>,
        proxy: EventLoopProxy<()>,
        loaded: &LoadedScene,
        Baking { bake, job, again }: Baking<'a>,
        settings: &'a Settings,
        (observer, is_stopped): (&'a dyn Observer, &'a dyn Fn() -> bool),
    ) -> Result<Self, Error> {
        check(&bake)?;
        let mut state = State::new(loaded, &bake, &settings.methods);
        state.sub_frames = settings.sub_frames;
        state.display.tone = settings.shown.tone;
        state.reflection = settings.shown.materials;
        match settings.shown.exposure {
            Exposure::Automatic => state.is_auto_exposed = true,
            Exposure::Stops(stops) => state.display.stops = stops,
        }
        // A script says when.
        state.is_smooth = settings.script.is_none();
        state.facts.bake = job.as_ref().map(BakeJob::progress);
        state.facts.quality = quality(&bake);
        if let Err(why) = state.methods.choose(&settings.method) {
            observer.warn(&format!("{why}; showing {}", state.methods.chosen().name));
        }
        if settings.reference.as_deref().is_some_and(is_displayed) {
            state.display.tone = Tone::None;
        }
        let file = settings.reference.as_deref().map(|path| read(path, state.display.stops)).transpose()?;
        let file = file.map(Arc::new);
        if let Some(path) = &settings.reference {
            state.facts.reference = Some(path.display().to_string());
            state.split.is_on = true;
        }
        let script = settings.script.as_deref().map(read_script).transpose()?;
        let tell = move || {
            // Fails when the window is closed: then nobody waits for it.
            let _ = proxy.send_event(());
        };
        Ok(Self {
            gpu: Arc::clone(gpu),
            name: loaded.name.clone(),
            bake,
            job,
            again,
            scene: loaded.scene.clone(),
            is_edited: false,
            settings,
            observer,
            is_stopped,
            state,
            script,
            comparer: Comparer::new(file.clone(), settings.seed, Box::new(tell)),
            is_compared: false,
            has_reference: false,
            file,
            file_display: None,
            panels: egui::Context::default(),
            open: None,
            frames: 0,
            window_size: settings.size,
            last_frame: Instant::now(),
            last_shown: None,
            pace: Pace::default(),
            last_divisor: 1,
            resized: None,
            next: None,
            outcome: Ok(()),
        })
    }

    fn open(&mut self, events: &ActiveEventLoop) -> Result<Open, Error> {
        let (width, height) = self.settings.size;
        let attributes = Window::default_attributes()
            .with_title(format!("{} - Patchlight", self.name))
            .with_inner_size(PhysicalSize::new(width, height))
            .with_min_inner_size(PhysicalSize::new(16, 16));
        let window = events.create_window(attributes).map_err(|error| Error::NoWindow { reason: error.to_string() })?;
        let window = Arc::new(window);
        let (screen, vulkan) = Screen::new(&self.gpu, Arc::clone(&window), &self.settings.device)?;
        let executor: Box<dyn Executor> = match vulkan {
            Some(vulkan) => Box::new(vulkan),
            None => Box::new(Cpu::new()),
        };
        self.state.facts.device = executor.device().name.clone();
        self.state.facts.screen = screen.device_name().to_owned();
        let size = self.file.as_ref().map_or(self.settings.size, |file| (file.width, file.height));
        let live = Live::new(Arc::clone(&self.bake), executor, &self.state, size, self.observer)?;
        let input = egui_winit::State::new(
            self.panels.clone(),
            ViewportId::ROOT,
            &window,
            Some(window.scale_factor() as f32),
            window.theme(),
            Some(screen.max_image_edge() as usize),
        );
        window.request_redraw();
        Ok(Open { live, screen, input, window })
    }

    fn frame(&mut self, events: &ActiveEventLoop) -> Result<(), Error> {
        let begun = Instant::now();
        self.last_frame = begun;
        let Some(mut open) = self.open.take() else { return Ok(()) };
        let drawn = self.frame_of(&mut open, begun, events);
        self.open = Some(open);
        self.frames += 1;
        drawn
    }

    fn frame_of(&mut self, open: &mut Open, begun: Instant, events: &ActiveEventLoop) -> Result<(), Error> {
        let window_size: (u32, u32) = open.window.inner_size().into();
        if self.window_size != window_size {
            self.window_size = window_size;
            open.screen.resize();
        }
        let input = self.input(open, window_size)?;
        let size = self.picture_size(&open.live, window_size);
        let scale = egui_winit::pixels_per_point(&self.panels, &open.window);
        let picture = shown_at(size, window_size, scale);
        let state = &mut self.state;
        state.facts.size = size;
        let output = self.panels.run_ui(input, |ui| {
            panels::show(ui, state);
            pointer::show(ui, state, picture);
        });
        let mut drawn = Panels {
            primitives: self.panels.tessellate(output.shapes, output.pixels_per_point),
            textures: output.textures_delta,
            pixels_per_point: output.pixels_per_point,
        };
        open.input.handle_platform_output(&open.window, output.platform_output);
        let delay = output.viewport_output.get(&ViewportId::ROOT).map_or(Duration::MAX, |view| view.repaint_delay);
        self.next = begun.checked_add(delay.max(Duration::from_millis(1)));
        let done = self.show(open, size, &mut drawn, events);
        // What could not be drawn is dropped with its frame.
        drawn.textures.clear();
        self.count(done?, begun, open);
        Ok(())
    }

    /// Finds and shows the picture, and does what was asked for; times of the passes.
    fn show(
        &mut self,
        open: &mut Open,
        size: (u32, u32),
        drawn: &mut Panels,
        events: &ActiveEventLoop,
    ) -> Result<Option<Vec<PassTime>>, Error> {
        self.refine(&mut open.live)?;
        let times = open.live.frame(&mut self.state, size, &mut open.screen, self.observer)?;
        self.compare(open, times.is_some())?;
        let mut captures = Vec::new();
        for request in std::mem::take(&mut self.state.requests) {
            match request {
                Request::Quit => events.exit(),
                Request::Pick(x, y) => self.pick(open, (x, y)),
                Request::Move { object, way } => self.move_object(&open.live, object, way),
                Request::Screenshot(name) => captures.push(screenshot::path(&self.settings.out, name)),
                Request::Resize(width, height) => {
                    // The system tells the new size.
                    let _ = open.window.request_inner_size(PhysicalSize::new(width, height));
                }
            }
        }
        let at = self.state.split.is_on.then_some(self.state.split.at).filter(|_| self.has_reference);
        let capture = open.screen.draw(drawn, at, !captures.is_empty())?;
        for path in captures {
            screenshot::write(&path, capture.as_ref())?;
            self.state.facts.message = format!("written: {}", path.display());
            self.observer.note(&self.state.facts.message);
        }
        Ok(times)
    }

    /// Picks the object of the scene at a place of the picture; nothing where there is none.
    fn pick(&mut self, open: &Open, (x, y): (f32, f32)) {
        let (width, height) = open.live.size();
        let camera = self.state.eye.camera((width, height));
        let direction = camera_direction(&camera, x * width as f32, y * height as f32);
        let scene = open.live.scene();
        let hit = scene.closest(camera.eye, direction);
        let Some(triangle) = scene.geometry.triangles.get(hit.triangle as usize) else {
            self.state.picked = None;
            return;
        };
        let object = triangle.object;
        if object == NONE {
            self.state.picked = None;
            "it moves by itself: drag its handle, or see Movement".clone_into(&mut self.state.facts.message);
            return;
        }
        let own = scene.geometry.triangles.iter().filter(|t| t.object == object);
        let corners = own.flat_map(|t| [t.corner, t.corner + t.edge_a, t.corner + t.edge_b]);
        let bounds = corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        self.state.picked = Some(Picked { object, middle: 0.5 * (bounds.0 + bounds.1), way: Vec3::ZERO });
        let name = self.state.objects.get(object as usize).map_or("an object", String::as_str);
        self.state.facts.message = format!("{name}: drag its handle");
    }

    /// Moves an object of the scene; the light is made anew in the background, of a bake that is done only where it
    /// changes.
    fn move_object(&mut self, live: &Live, object: u32, way: Vec3) {
        let mut edit = self.scene.edit();
        edit.transform(object, Affine3A::from_translation(way));
        let begun = edit.build().map_err(|error| error.to_string()).and_then(|scene| {
            let job = match self.again.as_ref().filter(|_| self.job.is_some() && !self.is_edited) {
                Some(again) => again(&scene),
                None => live.bake().start_edit(&scene, Refinement::default()),
            };
            self.is_edited |= self.job.is_none();
            Ok((scene, job.map_err(|error| error.to_string())?))
        });
        match begun {
            Ok((scene, job)) => {
                self.scene = scene;
                self.state.facts.bake = Some(job.progress());
                // The one before is cancelled.
                self.job = Some(job);
            }
            Err(error) => self.state.facts.message = format!("not moved: {error}"),
        }
    }

    /// Takes the newest level of the bake, if it goes on.
    fn refine(&mut self, live: &mut Live) -> Result<(), Error> {
        let Some(job) = &self.job else { return Ok(()) };
        let is_finished = job.is_finished();
        let is_new = live.refine(job, &mut self.state, self.observer)?;
        self.state.facts.bake = Some(job.progress());
        if is_finished && !is_new {
            self.state.facts.bake = None;
            if let Some(Err(error)) = self.job.take().map(BakeJob::join) {
                // What was made until then stays.
                self.state.facts.message = format!("the bake goes on no further: {error}");
                self.observer.warn(&self.state.facts.message);
            }
        }
        Ok(())
    }

    /// The events of the window and of the script.
    fn input(&mut self, open: &mut Open, size: (u32, u32)) -> Result<RawInput, Error> {
        let mut input = open.input.take_egui_input(&open.window);
        if let Some(script) = &mut self.script {
            let pixels_per_point = egui_winit::pixels_per_point(&self.panels, &open.window);
            let window = script::Window { size, pixels_per_point };
            input.time = Some(f64::from(self.frames) * FRAME_SECONDS);
            input.predicted_dt = FRAME_SECONDS as f32;
            input.focused = true;
            // Nobody else drives the window.
            input.events.clear();
            script.step(&mut self.state, window, &mut input.events)?;
        }
        if takes_tab(&mut input) && !self.panels.egui_wants_keyboard_input() {
            self.state.has_panels = !self.state.has_panels;
        }
        Ok(input)
    }

    /// The size that pictures are to have: that of the window, once it rests.
    fn picture_size(&mut self, live: &Live, window: (u32, u32)) -> (u32, u32) {
        let now = live.size();
        if let Some(file) = &self.file {
            return (file.width, file.height);
        }
        let divisor = self.state.divisor * if live.is_moving() { self.pace.divisor } else { 1 };
        let part = |edge: u32| (edge / divisor).max(1);
        let wanted = (part(window.0), part(window.1));
        if std::mem::replace(&mut self.last_divisor, divisor) != divisor && self.window_size == window {
            self.resized = None;
            return wanted;
        }
        if window.0 == 0 || window.1 == 0 || wanted == now {
            self.resized = None;
            return now;
        }
        let since = match self.resized {
            Some((size, since)) if size == wanted => since,
            _ => Instant::now(),
        };
        self.resized = Some((wanted, since));
        if self.script.is_some() || since.elapsed() >= RESIZED {
            self.resized = None;
            return wanted;
        }
        now
    }

    /// Begins a comparison where nothing moves any more, and takes what it has found.
    fn compare(&mut self, open: &mut Open, has_changed: bool) -> Result<(), Error> {
        if !self.state.compares() {
            if self.is_compared {
                self.comparer.stop();
                self.is_compared = false;
            }
            return Ok(());
        }
        if has_changed && self.is_compared {
            self.comparer.stop();
            self.is_compared = false;
            self.state.facts.comparison = None;
        }
        match &self.file {
            Some(file) if self.file_display != Some(self.state.display) => {
                let shown = rgba(file, &self.state.display);
                open.screen.set_picture(Side::Right, open.live.size(), &Source::Host(&shown))?;
                self.file_display = Some(self.state.display);
                self.has_reference = true;
            }
            Some(_) => {}
            // Paths follow what changes.
            None => self.has_reference &= self.is_compared || !has_changed,
        }
        if !has_changed && open.live.is_settled() && !self.is_compared {
            let (camera, ours) = open.live.picture(&self.state)?;
            let scene = open.live.scene().clone();
            let State { display: transform, reflection: materials, .. } = self.state;
            self.comparer.start(Job { scene, camera, ours, transform, materials });
            self.is_compared = true;
        }
        let Some(found) = self.comparer.take() else { return Ok(()) };
        let size = open.live.size();
        if self.file.is_none() {
            open.screen.set_picture(Side::Right, size, &Source::Host(&found.shown))?;
            self.has_reference = true;
        }
        if let (Shown::Error, Some(difference)) = (self.state.shown, &found.difference) {
            open.screen.set_picture(Side::Left, size, &Source::Host(difference))?;
        }
        self.state.facts.comparison = Some(Comparison { samples: found.samples, errors: found.errors });
        Ok(())
    }

    /// Takes note of the times of a frame.
    fn count(&mut self, times: Option<Vec<PassTime>>, begun: Instant, open: &Open) {
        let Some(passes) = times else {
            self.last_shown = None;
            return;
        };
        let now = Instant::now();
        let total = now.duration_since(self.last_shown.unwrap_or(begun)).as_secs_f64() * 1e3;
        self.last_shown = Some(now);
        let frame = FrameTimes::new(passes, total);
        if let Some(fps) = self.settings.fps.filter(|_| open.live.is_moving()) {
            let ms = now.duration_since(begun).as_secs_f64() * 1e3;
            self.pace.follow(1e3 / f64::from(fps), &frame, ms, open.live.size());
        }
        self.state.facts.times.add(frame);
        self.state.facts.bytes = open.live.bytes();
        self.state.facts.resident = resident_bytes();
    }

    /// Returns true if the script waits for the bake or the clock.
    fn waits_for_bake(&self) -> bool {
        self.script.as_ref().is_some_and(Script::waits_for_bake)
    }

    /// Returns true if the next frame is due at once.
    fn is_busy(&self) -> bool {
        let Some(open) = &self.open else { return false };
        let waits_for_paths = self.is_compared && self.script.as_ref().is_some_and(Script::waits_for_samples);
        let waits_for_bake = self.waits_for_bake();
        let is_scripted = self.script.as_ref().is_some_and(|script| !script.is_done());
        is_scripted && !waits_for_paths && !waits_for_bake
            || !open.live.is_settled()
            || self.state.compares() && !self.is_compared
    }
}

impl ApplicationHandler for App<'_> {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.open.is_some() {
            return;
        }
        match self.open(events) {
            Ok(open) => self.open = Some(open),
            Err(error) => {
                self.outcome = Err(error);
                events.exit();
            }
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(open) = &mut self.open else { return };
        let response = open.input.on_window_event(&open.window, &event);
        match event {
            WindowEvent::CloseRequested => events.exit(),
            WindowEvent::Resized(_) => {
                open.screen.resize();
                open.window.request_redraw();
            }
            WindowEvent::RedrawRequested if !events.exiting() => {
                if let Err(error) = self.frame(events) {
                    self.outcome = Err(error);
                    events.exit();
                }
            }
            _ if response.repaint => open.window.request_redraw(),
            _ => {}
        }
    }

    fn user_event(&mut self, _: &ActiveEventLoop, (): ()) {
        if let Some(open) = &self.open {
            open.window.request_redraw();
        }
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        if (self.is_stopped)() {
            events.exit();
            return;
        }
        let now = Instant::now();
        let Some(open) = &self.open else { return };
        let is_hidden = open.window.is_minimized() == Some(true);
        if self.job.is_some() || self.waits_for_bake() {
            // The bar moves, and a level or the script may be done.
            let look = self.last_frame + LOOK;
            self.next = Some(self.next.map_or(look, |next| next.min(look)));
        }
        let is_due = self.next.is_some_and(|next| next <= now) || self.resized.is_some();
        if !is_hidden && (self.is_busy() || is_due) {
            open.window.request_redraw();
            events.set_control_flow(ControlFlow::Poll);
            return;
        }
        let look = now + LOOK;
        events.set_control_flow(ControlFlow::WaitUntil(self.next.map_or(look, |next| next.min(look))));
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        self.comparer.stop();
        self.open = None;
    }
}

/// Rectangle in which a picture is shown, points.
fn shown_at(size: (u32, u32), window: (u32, u32), scale: f32) -> Rect {
    let area = fit(size, window);
    let point = |(x, y): (i32, i32)| pos2(x as f32 / scale, y as f32 / scale);
    Rect::from_min_max(point(area.min), point(area.max))
}

/// Takes Tab out of the input, which egui would move its focus with; whether it was pressed.
fn takes_tab(input: &mut RawInput) -> bool {
    let is_tab = |event: &Event| matches!(event, Event::Key { key: Key::Tab, .. });
    let is_pressed = |event: &Event| matches!(event, Event::Key { pressed: true, repeat: false, modifiers, .. } if *modifiers == Modifiers::NONE);
    let pressed = input.events.iter().any(|event| is_tab(event) && is_pressed(event));
    input.events.retain(|event| !is_tab(event));
    pressed
}

fn read_script(path: &std::path::Path) -> Result<Script, Error> {
    let failed = |source| Error::Read { path: path.to_path_buf(), source };
    let bytes = scene::host::read_regular(path).map_err(failed)?;
    Ok(Script::parse(path, &String::from_utf8_lossy(&bytes))?)
}
