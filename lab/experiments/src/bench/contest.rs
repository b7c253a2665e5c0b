//! Common parts of experiments with contenders: a view of a scene, light updates in which contenders take turns, light
//! at rest.

pub mod contender;
pub mod field;

use glam::{Vec3, Vec4};
use opponents::ViewedPoint;
use reference::{Picture, PictureErrors, PictureFile as _};
use scene::kernel::camera::{primary_direction, primary_hit, surface_point};
use scene::{Camera, Lighting, SurfacePoint};
use serde::{Deserialize, Serialize};

use super::truth::Truth;
use crate::args::{Animate, Bench, Common};
use crate::error::Error;
use crate::errors::picture_errors;
use crate::progress::{Progress, is_cancelled};
use crate::sequence::Movement;
use crate::summary::PassTimes;
use assets::import::{Animation, LoadedScene};
use contender::{Contender, FrameTime, Time};
use patchlight::light::with_lights;
use patchlight::{Pictures, PixelGather};

/// Spacings are shares of this length in scenes that are smaller, m.
const SMALL_SCENE: f32 = 8.0;
/// Scenes of which pixels see more backs of surfaces than this share are lit from both sides by opponents.
const BACKS: f64 = 0.01;
/// Frames until light is at rest: enough for the hysteresis of probes.
pub const REST: u32 = 60;

/// Light updates that take so long, ms, are measured so many times.
const SLOW_MS: f64 = 1e3;
const SLOW_TURNS: usize = 3;

/// Irradiance at what pixels see, W/m².
type Gather<'a> = dyn Fn(&[SurfacePoint], u32) -> Result<Vec<Vec4>, patchlight::Error> + Sync + 'a;

/// View of a scene.
pub struct View<'a> {
    pub common: &'a Common,
    pub args: &'a Bench,
    pub loaded: &'a LoadedScene,
    pub camera: Camera,
    /// Points seen by the pixels.
    pub points: Vec<ViewedPoint>,
    /// True if they see many backs of surfaces.
    pub two_sided: bool,
}

impl<'a> View<'a> {
    /// View of the scene's own camera, in the picture size of the options.
    pub fn new(common: &'a Common, args: &'a Bench, loaded: &'a LoadedScene) -> Self {
        let camera = loaded.view.camera(args.size().0, args.size().1);
        let tables = loaded.scene.tables();
        let mut points = Vec::new();
        let mut backs = 0;
        for pixel in 0..camera.width * camera.height {
            let hit = primary_hit(&tables, &camera, pixel, 0);
            if hit.is_miss() {
                continue;
            }
            let direction = primary_direction(&camera, pixel, 0);
            let SurfacePoint { position, normal, .. } = surface_point(&tables, hit, direction);
            backs += usize::from(tables.normal(hit.triangle).dot(direction) > 0.0);
            points.push(ViewedPoint { position, normal, to_eye: -direction });
        }
        let two_sided = backs as f64 > BACKS * points.len() as f64;
        Self { common, args, loaded, camera, points, two_sided }
    }

    /// A point as the eye sees it.
    pub fn viewed(&self, p: &SurfacePoint) -> ViewedPoint {
        let to_eye = (self.camera.eye - p.position).normalize_or_zero();
        ViewedPoint { position: p.position, normal: p.normal, to_eye }
    }

    /// Indirect radiance of the pixels from irradiance at what they see.
    pub fn gathered(&self, gather: &Gather) -> Result<Picture, Error> {
        let pixels = PixelGather {
            scene: &self.loaded.scene,
            gather,
            lights: &self.loaded.scene.lighting.lights,
            camera: &self.camera,
            frame: 0,
            sub_frames: self.args.sub_frames,
            seed: self.common.seed,
        };
        Ok(pixels.indirect()?)
    }

    /// Pictures of indirect light and of what lights send straight.
    pub fn with_direct(&self, indirect: Picture, direct: Option<&Picture>) -> Result<Pictures, Error> {
        let direct = direct.cloned().unwrap_or_else(|| Picture::new(indirect.width, indirect.height));
        let full = direct.plus(&indirect).map_err(reference::Error::from)?;
        Ok(Pictures { full, direct, indirect })
    }

    /// Share of lengths for scenes that are smaller.
    fn share(&self) -> f32 {
        (self.longest() / SMALL_SCENE).min(1.0)
    }

    fn longest(&self) -> f32 {
        let (low, high) = self.loaded.scene.geometry.bounds;
        (high - low).max_element()
    }

    /// Lights that move from frame to frame.
    pub fn moving(&self, frames: u32) -> Vec<Lighting> {
        let movement = Movement::new(self.loaded, (Animate::Sun, None), frames, &Progress::new(true));
        (0..frames).map(|number| with_lights(&self.loaded.scene, &movement.at(number).0)).collect()
    }

    /// Other lights than the scene's own.
    pub fn others(&self) -> Lighting {
        let path = Animation::or_default_path(self.loaded);
        with_lights(&self.loaded.scene, &path.at(path.duration() / 3.0).0)
    }
}

/// Who was measured.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Who {
    /// Kind of the method: a line of plots.
    pub family: String,
    pub method: String,
    /// Patches, probes, cells or paths.
    pub size: String,
    pub build_s: f64,
    /// That light needs from frame to frame.
    pub bytes: u64,
    /// Bytes of an operator that each light update reads once, of these.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub operator_bytes: Option<u64>,
}

impl Who {
    pub fn of(contender: &dyn Contender) -> Self {
        Self {
            family: contender.family().to_owned(),
            method: contender.name(),
            size: contender.size(),
            build_s: contender.build_s(),
            bytes: contender.bytes(),
            operator_bytes: contender.operator_bytes(),
        }
    }

    /// Returns true if the method is the project's own, and no baseline.
    pub fn is_own(&self) -> bool {
        field::OWN.contains(&self.family.as_str())
    }

    /// Memory, 10⁶ bytes.
    pub fn megabytes(&self) -> f64 {
        self.bytes as f64 * 1e-6
    }
}

/// Times of light updates.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct UpdateTimes {
    /// Median and longest light update, and the median of the lookup of all pixels where that can be told apart, ms.
    pub update: PassTimes,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub lookup_ms: Option<f64>,
    /// Median of what light between patches alone took, ms.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub method_ms: Option<f64>,
    /// Updates and lookups in time of all processors, ms.
    pub processor: PassTimes,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub processor_lookup_ms: Option<f64>,
}

impl UpdateTimes {
    fn of(frames: &[FrameTime]) -> Self {
        let updates = || frames.iter().map(|frame| frame.update);
        let lookups = || frames.iter().filter_map(|frame| frame.lookup);
        let times = |list: Vec<f64>| PassTimes::of(&list);
        let none = PassTimes { median_ms: 0.0, max_ms: 0.0 };
        let methods: Vec<f64> = frames.iter().filter_map(|frame| frame.method_ms).collect();
        let wall = |time: Time| time.wall;
        let processor = |time: Time| time.processor;
        Self {
            update: times(updates().map(wall).collect()).unwrap_or(none),
            lookup_ms: times(lookups().map(wall).collect()).map(|times| times.median_ms),
            method_ms: times(methods).map(|times| times.median_ms),
            processor: times(updates().map(processor).collect()).unwrap_or(none),
            processor_lookup_ms: times(lookups().map(processor).collect()).map(|times| times.median_ms),
        }
    }
}

/// Times of all contenders, who take turns within each frame, so that what else a machine does meets all of them alike.
/// A turn is two light updates, of which the second counts: it finds caches as it left them, as in a program with one
/// method. There are two lightings a frame, and two more before the first, which make memory ready. Those whose updates
/// take [`SLOW_MS`] and more take part in the first [`SLOW_TURNS`] only.
pub fn take_turns(
    contenders: &mut [Box<dyn Contender + '_>],
    lightings: &[Lighting],
    progress: &Progress,
) -> Result<Vec<UpdateTimes>, Error> {
    let mut times = vec![Vec::new(); contenders.len()];
    progress.phase("light updates", |report| {
        let turns = lightings.len() / 2;
        for (turn, pair) in lightings.chunks_exact(2).enumerate() {
            for (contender, times) in contenders.iter_mut().zip(&mut times) {
                let is_slow = times.last().is_some_and(|last: &FrameTime| last.update.wall >= SLOW_MS);
                if is_slow && times.len() >= SLOW_TURNS {
                    continue;
                }
                let number = 2 * turn as u32;
                contender.frame(&pair[0], number)?;
                let time = contender.frame(&pair[1], number + 1)?;
                if turn > 0 {
                    times.push(time);
                }
                cancelled()?;
            }
            let _ = report(turn + 1, turns);
        }
        Ok::<(), Error>(())
    })?;
    Ok(times.iter().map(|frames| UpdateTimes::of(frames)).collect())
}

/// Lightings for so many turns of [`take_turns`].
pub fn lightings_of(frames: u32) -> u32 {
    2 * (frames + 1)
}

/// Frames until a contender's light is at rest.
pub fn rest_of(contender: &dyn Contender, args: &Bench) -> u32 {
    match (contender.remembers(), args.quick) {
        (false, _) => 1,
        (true, true) => REST / 4,
        (true, false) => REST,
    }
}

/// Light updates under the scene's own lights until light is at rest, and the pictures of it. The direct light of the
/// first contender, which has its own, is that of all.
pub fn pictures_at_rest(
    view: &View,
    contender: &mut dyn Contender,
    first_frame: u32,
    direct: &mut Option<Picture>,
) -> Result<Pictures, Error> {
    for frame in 0..rest_of(contender, view.args) {
        contender.frame(&view.loaded.scene.lighting, first_frame + frame)?;
        cancelled()?;
    }
    let pictures = contender.pictures(direct.as_ref())?;
    direct.get_or_insert_with(|| pictures.direct.clone());
    Ok(pictures)
}

/// Errors of all light and of indirect light against path tracing.
pub fn errors(view: &View, pictures: &Pictures, truth: &Truth) -> Result<(PictureErrors, PictureErrors), Error> {
    Ok(picture_errors(pictures, &truth.pictures, view.loaded.exposure_stops)?)
}

/// The end of work that was asked to stop.
pub fn cancelled() -> Result<(), Error> {
    if is_cancelled() { Err(shell::Error::Cancelled.into()) } else { Ok(()) }
}

/// Pictures in a row of those that are side by side.
const COLUMNS: usize = 4;

/// Pictures of the same size in one, from left to right, then down; `stops` exposes them.
pub fn side_by_side(pictures: &[Picture], path: &std::path::Path, stops: f32) -> Result<(), Error> {
    let Some(first) = pictures.first() else { return Ok(()) };
    let width = first.width as usize;
    let height = first.height as usize;
    let lines = pictures.len().div_ceil(COLUMNS);
    let mut all = Picture::new((COLUMNS * width) as u32, (lines * height) as u32);
    for (number, picture) in pictures.iter().enumerate() {
        let corner = (number / COLUMNS) * height * COLUMNS * width + number % COLUMNS * width;
        for (y, row) in picture.pixels.chunks(width).enumerate() {
            all.pixels[corner + y * COLUMNS * width..][..width].copy_from_slice(row);
        }
    }
    Ok(all.write_png(path, stops)?)
}

/// Relative L2 distances of the light of each frame from that of the last, over that of the first.
pub fn left_of_jump(shown: &[Vec<Vec3>]) -> Vec<f64> {
    let (Some(first), Some(last)) = (shown.first(), shown.last()) else { return Vec::new() };
    let whole = crate::sequence::distance(first, last).max(f64::MIN_POSITIVE);
    shown.iter().map(|light| crate::sequence::distance(light, last) / whole).collect()
}

/// The frame from which on no more than a share is left.
pub fn followed_after(left: &[f64], share: f64) -> Option<usize> {
    let frame = left.iter().rposition(|&left| left > share).map_or(0, |last| last + 1);
    // The last frame is its own measure.
    (frame + 1 < left.len()).then_some(frame)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_followed_once_little_stays_left() {
        let shown: Vec<Vec<Vec3>> = [5.0, 3.0, 2.2, 3.5, 2.1, 2.0, 2.0].map(|h| vec![Vec3::splat(h)]).into();
        let left = left_of_jump(&shown);
        assert!((left[0] - 1.0).abs() < 1e-6 && (left[1] - 1.0 / 3.0).abs() < 1e-6);
        assert_eq!(followed_after(&left, 0.1), Some(4));
        assert_eq!(followed_after(&left, 0.01), Some(5));
        assert_eq!(followed_after(&[1.0, 0.5, 0.4, 0.0], 0.1), None);
    }
}
