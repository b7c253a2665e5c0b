//! Frames one after the other: how lights move, and what each frame measured.

use std::fmt::Write as _;
use std::path::Path;

use glam::{Affine3A, Vec3};
use reference::metrics::compare_pictures;
use scene::gpu::LIGHT_DIRECTIONAL;
use scene::kernel::shade::encode_srgb;
use scene::math::luminance;
use scene::{Camera, Light, Lighting};

use crate::args::common::{Animate, CameraPath};
use crate::error::Error;
use crate::output;
use crate::progress::{Progress, interruptible};
use crate::report::{Plot, Section, Series, page};
use assets::import::{Animation, LoadedScene, MovingObject, Target, View};
use localmatrix::CameraFrame;
use patchlight::memory::peak_memory_bytes;
use patchlight::method::local::{Local, SHOWN_ALBEDO};
use patchlight::{FrameResult, LightField, ObjectId, PictureRenderer};

/// Time of a frame: the animation's length spread over the frames.
pub fn frame_time(animation: &Animation, frame: u32, frames: u32) -> f32 {
    animation.duration() * frame as f32 / (frames.max(2) - 1) as f32
}

/// Lights and view of each frame.
pub struct Movement {
    animate: Animate,
    path: Animation,
    /// Camera path, whatever the lights do.
    camera: Option<Animation>,
    rest: (Vec<Light>, View),
    objects: Vec<MovingObject>,
    /// Time of their last pose, s.
    duration: f32,
    frames: u32,
}

/// Objects of a scene in a light field.
pub struct Moving(Vec<ObjectId>);

impl Moving {
    /// Adds the objects of a scene that move, where they are at first.
    ///
    /// # Errors
    /// As [`patchlight::Objects::insert`].
    pub fn add(light: &mut LightField, objects: &[MovingObject]) -> Result<Self, patchlight::Error> {
        let insert = |object: &MovingObject| light.objects().insert(&object.mesh(), object.transform(0.0));
        Ok(Self(objects.iter().map(insert).collect::<Result<_, _>>()?))
    }

    /// Moves them.
    ///
    /// # Errors
    /// As [`patchlight::Objects::set_transform`].
    pub fn place(&self, light: &mut LightField, transforms: &[Affine3A]) -> Result<(), patchlight::Error> {
        for (&id, &transform) in self.0.iter().zip(transforms) {
            light.objects().set_transform(id, transform)?;
        }
        Ok(())
    }
}

impl Movement {
    /// Animation of a scene over so many frames.
    pub fn new(
        loaded: &LoadedScene,
        (animate, camera): (Animate, Option<CameraPath>),
        frames: u32,
        progress: &Progress,
    ) -> Self {
        let mut path = Animation::or_default_path(loaded);
        if animate == Animate::Sun {
            let mut sun = Animation::default_path(loaded);
            sun.tracks.retain(|track| matches!(track.target, Target::LightDirection(_)));
            if loaded.scene.lighting.lights.iter().any(|light| light.kind == LIGHT_DIRECTIONAL) {
                path = sun;
            } else {
                progress.warn("the scene has no sun: its other lights move");
            }
        }
        let camera = camera.map(|camera| camera.animation(loaded));
        let rest = (loaded.scene.lighting.lights.clone(), loaded.view);
        let objects = loaded.moving.clone();
        Self { animate, path, camera, rest, objects, duration: loaded.moving_duration(), frames }
    }

    /// Time of the objects in a frame, s; a single frame is at their first pose.
    pub fn time(&self, frame: u32) -> f32 {
        match self.frames {
            0 | 1 => 0.0,
            frames => self.duration * frame as f32 / (frames - 1) as f32,
        }
    }

    /// Places of the objects in a frame.
    pub fn objects_at(&self, frame: u32) -> Vec<Affine3A> {
        self.objects.iter().map(|object| object.transform(self.time(frame))).collect()
    }

    /// Lights and view of a frame; a single frame is at rest.
    pub fn at(&self, frame: u32) -> (Vec<Light>, View) {
        let (lights, view) = self.lights_at(frame);
        match &self.camera {
            Some(camera) if self.frames > 1 => (lights, camera.at(frame_time(camera, frame, self.frames)).1),
            _ => (lights, view),
        }
    }

    fn lights_at(&self, frame: u32) -> (Vec<Light>, View) {
        match self.animate {
            _ if self.frames == 1 => self.rest.clone(),
            Animate::Still => self.rest.clone(),
            Animate::Path | Animate::Sun => self.path.at(frame_time(&self.path, frame, self.frames)),
            Animate::Jump => {
                // From the start of the path to a third of it, and back.
                let is_away = (self.frames / 3..2 * self.frames / 3).contains(&frame);
                let time = if is_away { self.path.duration() / 3.0 } else { 0.0 };
                (self.path.at(time).0, self.rest.1)
            }
        }
    }
}

/// Measurements of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
struct Measured {
    /// Time of the light between patches, and of its way to the pixels, ms.
    method_ms: f64,
    lookup_ms: f64,
    /// Time of changes of the matrix round the camera.
    update_ms: f64,
    /// Changes of the matrix round the camera.
    local: Option<CameraFrame>,
    /// Greatest resident memory so far, bytes.
    memory: Option<u64>,
    /// SSIM of the picture against that of exact products.
    ssim: Option<f64>,
    /// Relative L2 distance of the irradiance from the exact one.
    error: Option<f64>,
    /// Difference from the frame before.
    change: Option<f64>,
    /// Least change of displayed values that at most one of a thousand exceeds, in 255ths.
    flicker: Option<f64>,
}

/// Content of a frame.
#[derive(Clone, Copy)]
pub struct Shot<'a> {
    /// Lights, sky and emission.
    pub lighting: &'a Lighting,
    /// Who looks.
    pub camera: &'a Camera,
    /// Number of the frame.
    pub number: u32,
}

/// Milliseconds of all passes of one name.
pub fn pass_ms(times: &[(String, f64)], name: &str) -> f64 {
    times.iter().filter(|(n, _)| n == name).fold(0.0, |sum, (_, ms)| sum + ms)
}

/// Passes of pixels, which are no part of a light update.
pub const PIXELS: &str = "shade";

/// Milliseconds of a frame up to the irradiance of every visible point: all passes but those of the pixels.
pub fn light_update_ms(times: &[(String, f64)]) -> f64 {
    times.iter().filter(|(name, _)| name != PIXELS).map(|(_, ms)| ms).sum()
}

/// Measurements of the frames, and the light of the last.
pub struct Sequence {
    frames: Vec<Measured>,
    before: Vec<Vec3>,
    scale: f32,
}

impl Sequence {
    /// `stops` is the exposure of the pictures.
    pub fn new(stops: f32) -> Self {
        Self { frames: Vec::new(), before: Vec::new(), scale: reference::stops_to_scale(stops) }
    }

    /// Takes in a frame, its light and, where the matrix goes with the camera, its picture, beside
    /// those of exact products with the same lights.
    ///
    /// # Errors
    /// What the device says.
    pub fn add(
        &mut self,
        renderer: &mut PictureRenderer,
        exact: Option<&mut PictureRenderer>,
        shot: &Shot,
        done: &FrameResult,
    ) -> Result<(), Error> {
        let light = renderer.light_mut().surface_irradiance()?;
        let local = renderer.light_mut().counted_method::<Local>()?.map(|local| local.last_frame().clone());
        let mut error = None;
        let mut ssim = None;
        if let Some(exact) = exact {
            if local.is_some() {
                let picture = interruptible(|| exact.picture(shot.lighting, shot.camera, shot.number))?.pictures.full;
                // Nothing to compare where the camera sees only black.
                ssim = compare_pictures(&done.pictures.full, &picture, self.scale, None).ok().map(|errors| errors.ssim);
            } else {
                interruptible(|| exact.advance(shot.lighting, shot.camera))?;
            }
            error = Some(distance(&light, &exact.light_mut().surface_irradiance()?));
        }
        let has_before = self.before.len() == light.len() && !light.is_empty();
        self.frames.push(Measured {
            method_ms: pass_ms(&done.times, "method"),
            lookup_ms: pass_ms(&done.times, "lookup"),
            update_ms: pass_ms(&done.times, "update"),
            local,
            memory: peak_memory_bytes(),
            ssim,
            error,
            change: has_before.then(|| distance(&light, &self.before)),
            flicker: has_before.then(|| flicker(&light, &self.before, self.scale)),
        });
        self.before = light;
        Ok(())
    }

    /// Work that changes of the matrix round the camera took, beside making it anew in every frame in which the camera
    /// moved.
    pub fn work(&self) -> Option<String> {
        let steps = || self.frames.iter().skip(1).filter_map(|f| f.local.as_ref());
        let work: u64 = steps().map(|l| l.step.work).sum();
        let anew: u64 = steps().map(|l| l.anew).sum();
        let moved: usize = steps().map(|l| l.step.entered + l.step.left).sum();
        let lit: u64 = steps().map(|l| l.product).sum();
        let all: u64 = steps().map(|l| 3 * (l.patches as u64).pow(2)).sum();
        let flicker = self.frames.iter().filter_map(|f| f.flicker).fold(0.0, f64::max);
        let least = self.frames.iter().filter_map(|f| f.ssim).reduce(f64::min);
        let ssim = least.map_or(String::new(), |ssim| format!("; SSIM against full radiosity at least {ssim:.4}"));
        (work > 0).then(|| {
            format!(
                "{moved} patches came or went: {:.1} times less work than a new matrix in every frame; {:.0} % of it \
                 is multiplied by; displayed values of 99.9 % of the surface change by {flicker:.2}/255 a frame at \
                 most{ssim}",
                anew as f64 / work as f64,
                100.0 * lit as f64 / all.max(1) as f64
            )
        })
    }

    /// Writes `frames.csv`, `frames-*.svg` and `report.html` into a folder.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, out: &Path, title: &str) -> Result<(), Error> {
        output::write_text(&out.join("frames.csv"), &self.csv())?;
        let plots = self.plots();
        for (name, plot) in ["light", "flicker", "time"].iter().zip(&plots) {
            output::write_text(&out.join(format!("frames-{name}.svg")), &plot.svg())?;
        }
        let section = Section {
            title: "Frames".into(),
            text: vec!["frames.csv has the numbers. Displayed values are those of a surface of albedo ½.".into()],

            plots,
            ..Section::default()
        };
        output::write_text(&out.join("report.html"), &page(title, &[], [&section]))
    }

    /// A line for each frame.
    fn csv(&self) -> String {
        let mut csv = String::from("frame,method_ms,lookup_ms,error,change,flicker_255");
        if self.frames.iter().any(|f| f.local.is_some()) {
            csv.push_str(
                ",ssim,update_ms,patches,entered,left,waiting,later,update_multiplications,product_multiplications,\
                 anew_multiplications,residual,local_bytes,peak_bytes",
            );
        }
        csv.push('\n');
        for (k, f) in self.frames.iter().enumerate() {
            f.write_line(k, &mut csv);
        }
        csv
    }

    /// Irradiance, displayed values and times over the frames.
    fn plots(&self) -> Vec<Plot> {
        let against = if self.frames.iter().any(|f| f.error.is_some()) {
            "Irradiance against exact products, and against the frame before"
        } else {
            "Irradiance against the frame before; --errors adds exact products"
        };
        let light = vec![self.series("error", &|f| f.error), self.series("change", &|f| f.change)];
        let shown = vec![self.series("change", &|f| f.flicker)];
        let times = vec![
            self.series("method", &|f| Some(f.method_ms)),
            self.series("lookup", &|f| Some(f.lookup_ms)),
            self.series("update", &|f| f.local.as_ref().map(|_| f.update_ms)),
        ];
        vec![
            over_frames(against, "relative L2", light),
            over_frames("Change of displayed values, 99.9th percentile", "1/255", shown),
            over_frames("Time", "ms", times),
        ]
    }

    fn series(&self, name: &str, value: &dyn Fn(&Measured) -> Option<f64>) -> Series {
        let points = self.frames.iter().enumerate().filter_map(|(k, f)| Some((k as f64, value(f)?)));
        Series { name: name.into(), points: points.collect() }
    }
}

impl Measured {
    /// Adds the line of frame `number` to a table. Writing into a string cannot fail.
    fn write_line(&self, number: usize, csv: &mut String) {
        let _ = write!(
            csv,
            "{number},{:.4},{:.4},{},{},{}",
            self.method_ms,
            self.lookup_ms,
            cell(self.error),
            cell(self.change),
            cell(self.flicker)
        );
        if let Some(CameraFrame { step, patches, product, anew, bytes }) = &self.local {
            let ssim = cell(self.ssim);
            let residual = cell(step.residual.map(f64::from));
            let memory = self.memory.map_or(String::new(), |bytes| bytes.to_string());
            let _ = write!(
                csv,
                ",{ssim},{:.4},{patches},{},{},{},{},{},{product},{anew},{residual},{bytes},{memory}",
                self.update_ms, step.entered, step.left, step.waiting, step.later, step.work
            );
        }
        csv.push('\n');
    }
}

/// A number of a table, or nothing.
fn cell(value: Option<f64>) -> String {
    value.map_or(String::new(), |v| format!("{v:.6e}"))
}

/// A plot over the frames, without lines that have no points.
fn over_frames(title: &str, unit: &str, series: Vec<Series>) -> Plot {
    Plot {
        title: title.into(),
        unit: unit.into(),
        x: "frame".into(),
        logarithmic: false,
        series: series.into_iter().filter(|s| !s.points.is_empty()).collect(),
    }
}

/// Least change of the displayed values of a surface of [`SHOWN_ALBEDO`] that at most one of a thousand exceeds, in
/// 255ths; `scale` is the exposure.
pub fn flicker(light: &[Vec3], before: &[Vec3], scale: f32) -> f64 {
    let radiance = |h: &Vec3| luminance(*h) * SHOWN_ALBEDO / std::f32::consts::PI;
    let shown = |h: &Vec3| 255.0 * encode_srgb((radiance(h) * scale).clamp(0.0, 1.0));
    let mut changes: Vec<f32> = light.iter().zip(before).map(|(a, b)| (shown(a) - shown(b)).abs()).collect();
    changes.sort_by(f32::total_cmp);
    changes.get(changes.len() * 999 / 1000).map_or(0.0, |&change| f64::from(change))
}

/// Relative L2 distance of irradiance.
pub fn distance(found: &[Vec3], expected: &[Vec3]) -> f64 {
    let squares = |pairs: &mut dyn Iterator<Item = Vec3>| pairs.map(|d| f64::from(d.length_squared())).sum::<f64>();
    let difference = squares(&mut found.iter().zip(expected).map(|(a, b)| *a - *b));
    let whole = squares(&mut expected.iter().copied());
    if difference == 0.0 { 0.0 } else { (difference / whole.max(f64::MIN_POSITIVE)).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use assets::procedural;

    #[test]
    fn lights_jump_and_come_back() {
        let loaded = procedural::build("atrium").unwrap();
        let movement = Movement::new(&loaded, (Animate::Jump, None), 9, &Progress::new(true));
        let lights: Vec<_> = (0..9).map(|frame| movement.at(frame).0).collect();
        assert!(lights[0] == lights[2] && lights[3] == lights[5] && lights[0] == lights[6]);
        assert_ne!(lights[2], lights[3]);
        let still = Movement::new(&loaded, (Animate::Still, None), 9, &Progress::new(true));
        assert!((0..9).all(|frame| still.at(frame).0 == loaded.scene.lighting.lights));
        let sun = Movement::new(&loaded, (Animate::Sun, None), 9, &Progress::new(true));
        let moved = (sun.at(0), sun.at(8));
        for (a, b) in moved.0.0.iter().zip(&moved.1.0) {
            assert_eq!(a.direction != b.direction, a.kind == LIGHT_DIRECTIONAL);
            assert_eq!(a.position, b.position);
        }
        assert_eq!(moved.0.1, moved.1.1);
    }

    #[test]
    fn a_camera_flies_whatever_the_lights_do() {
        let loaded = procedural::build("atrium").unwrap();
        for path in [CameraPath::Fly, CameraPath::Shuttle, CameraPath::Circle] {
            let movement = Movement::new(&loaded, (Animate::Still, Some(path)), 30, &Progress::new(true));
            let (low, high) = loaded.scene.geometry.bounds;
            let eyes: Vec<Vec3> = (0..30).map(|frame| movement.at(frame).1.eye).collect();
            assert!((0..30).all(|frame| movement.at(frame).0 == loaded.scene.lighting.lights));
            assert!(eyes.iter().all(|eye| eye.cmpge(low).all() && eye.cmple(high).all()), "{path:?}");
            // No frame goes far, and the way is long.
            let steps: Vec<f32> = eyes.windows(2).map(|two| two[0].distance(two[1])).collect();
            let most = steps.iter().copied().fold(0.0, f32::max);
            let way = steps.iter().sum::<f32>();
            assert!(way > 0.5 * (high - low).max_element() && most < 0.15 * way, "{path:?} {way} {most}");
        }
        assert_eq!(
            Movement::new(&loaded, (Animate::Still, Some(CameraPath::Fly)), 1, &Progress::new(true)).at(0).1,
            loaded.view
        );
    }

    #[test]
    fn distances_are_relative() {
        let a = [Vec3::new(3.0, 0.0, 0.0)];
        let b = [Vec3::new(0.0, 4.0, 0.0)];
        assert_eq!(distance(&a, &b), 1.25);
        assert_eq!(distance(&a, &a), 0.0);
        assert_eq!(distance(&[Vec3::ZERO], &[Vec3::ZERO]), 0.0);
    }
}
