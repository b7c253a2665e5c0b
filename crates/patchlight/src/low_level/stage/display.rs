//! Pixels as a display shows them, left on the device: exposure, tone curve, sRGB, a byte each of red, green, blue and
//! 255; and what automatic exposure follows.

use gpu_kernels::params::{MeterParams, ToneMapParams};
use gpu_kernels::scene::{MeterPass, ToneMapPass};
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{PassId, RANGE_ALIGNMENT, Slice};
use scene::host::{METERED_PIXELS, automatic_stops};
use scene::{DisplayTransform, Rgb, scale_to_stops, stops_to_scale};

use super::bands::Band;
use super::shade::Shade;
use crate::low_level::frame::FramePlan;

/// Name of the passes.
pub const PASS: &str = "display";

/// Bands begin at multiples of this: words of displayed colours, and of means, may then begin there.
const STEP: u32 = (RANGE_ALIGNMENT / size_of::<u32>() as u64) as u32 * METERED_PIXELS;

/// The passes that follow those of the pixels where a picture is shown.
#[derive(Clone, Debug)]
pub struct Display {
    /// Displayed colours, `[pixels]`, a word each: bytes red, green, blue, 255 from the lowest.
    pub pixels: Slice<u32>,
    /// Mean luminance of the sums of [`METERED_PIXELS`] at a time, W/m²/sr.
    means: Slice<f32>,
    bands: Vec<DisplayedBand>,
    sub_frames: u32,
}

/// Passes of a band of pixels.
#[derive(Clone, Copy, Debug)]
struct DisplayedBand {
    pixels: u32,
    tone_map: PassId,
    meter: PassId,
}

/// Adds the passes.
///
/// # Errors
/// What the plan says.
pub fn add(frame: &mut FramePlan, shade: &Shade, (width, height): (u32, u32)) -> Result<Display, ExecutorError> {
    let count = width * height;
    let bands = bands(count, frame.binding_bytes());
    let plan = &mut frame.plan;
    let pixels = plan.array("displayed", count as usize);
    let means = plan.array("metered", count.div_ceil(METERED_PIXELS) as usize);
    let add = |&band: &Band| {
        let pass = ToneMapPass { sum: band.of(shade.full), pixels: band.of(pixels) };
        let params = ToneMapParams { count: band.count, ..ToneMapParams::default() };
        let tone_map = plan.add(PASS, &pass, &params)?;
        let runs = Band { first: band.first / METERED_PIXELS, count: band.count.div_ceil(METERED_PIXELS) };
        let pass = MeterPass { sum: band.of(shade.full), means: runs.of(means) };
        let params = MeterParams { count: runs.count, pixels: band.count, run: METERED_PIXELS, reserved: 0 };
        let meter = plan.add(PASS, &pass, &params)?;
        Ok::<_, ExecutorError>(DisplayedBand { pixels: band.count, tone_map, meter })
    };
    let bands = bands.iter().map(add).collect::<Result<_, _>>()?;
    Ok(Display { pixels, means, bands, sub_frames: shade.sub_frames() })
}

/// So many pixels in bands whose sums fit into a binding of `range` bytes.
fn bands(pixels: u32, range: u64) -> Vec<Band> {
    let shown = u32::try_from(range / size_of::<Rgb>() as u64).unwrap_or(u32::MAX);
    let most = (shown / STEP * STEP).max(STEP);
    if pixels <= most {
        return vec![Band { first: 0, count: pixels }];
    }
    (0..pixels).step_by(most as usize).map(|first| Band { first, count: most.min(pixels - first) }).collect()
}

impl Display {
    /// The passes, in their order.
    pub fn passes(&self) -> Vec<PassId> {
        self.bands.iter().flat_map(|band| [band.tone_map, band.meter]).collect()
    }

    /// Makes the passes ready for an exposure and a tone curve.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(
        &self,
        executor: &mut (dyn Executor + 'static),
        transform: &DisplayTransform,
    ) -> Result<(), ExecutorError> {
        let scale = stops_to_scale(transform.stops) / self.sub_frames as f32;
        let tone = transform.tone.code();
        self.bands.iter().try_for_each(|band| {
            executor.push(band.tone_map, &ToneMapParams { count: band.pixels, scale, tone, reserved: 0 })
        })
    }

    /// Exposure, stops, that makes the picture neither dark nor bright; waits.
    ///
    /// # Errors
    /// What the device says.
    pub fn automatic_stops(&self, executor: &mut (dyn Executor + 'static)) -> Result<f32, ExecutorError> {
        let means = executor.download_table(self.means)?;
        Ok(automatic_stops(&means) + scale_to_stops(self.sub_frames as f32))
    }
}
