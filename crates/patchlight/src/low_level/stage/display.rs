//! Pixels as a display shows them, left on the device: exposure, sRGB, a byte each of red, green, blue and 255.

use gpu_kernels::params::ToneMapParams;
use gpu_kernels::scene::ToneMapPass;
use runtime::executor::{Executor, ExecutorError};
use runtime::plan::{PassId, RANGE_ALIGNMENT, Slice};
use scene::{Rgb, stops_to_scale};

use super::bands::Band;
use super::shade::Shade;
use crate::low_level::frame::FramePlan;

/// Name of the passes.
pub const PASS: &str = "display";

/// Bands begin at multiples of this: words of displayed colours may then begin there.
const STEP: u32 = (RANGE_ALIGNMENT / size_of::<u32>() as u64) as u32;

/// The passes that follow those of the pixels where a picture is shown.
#[derive(Clone, Debug)]
pub struct Display {
    /// Displayed colours, `[pixels]`, a word each: bytes red, green, blue, 255 from the lowest.
    pub pixels: Slice<u32>,
    bands: Vec<(Band, PassId)>,
    sub_frames: u32,
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
    let add = |&band: &Band| {
        let pass = ToneMapPass { sum: band.of(shade.full), pixels: band.of(pixels) };
        let params = ToneMapParams { count: band.count, ..ToneMapParams::default() };
        Ok::<_, ExecutorError>((band, plan.add(PASS, &pass, &params)?))
    };
    let bands = bands.iter().map(add).collect::<Result<_, _>>()?;
    Ok(Display { pixels, bands, sub_frames: shade.sub_frames() })
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
        self.bands.iter().map(|(_, pass)| *pass).collect()
    }

    /// Makes the passes ready for an exposure.
    ///
    /// # Errors
    /// What the device says.
    pub fn set(&self, executor: &mut (dyn Executor + 'static), exposure_stops: f32) -> Result<(), ExecutorError> {
        let scale = stops_to_scale(exposure_stops) / self.sub_frames as f32;
        self.bands.iter().try_for_each(|(band, pass)| executor.push(*pass, &ToneMapParams { count: band.count, scale }))
    }
}
