//! Methods that turn a scene into pictures.

pub mod classic;
pub mod debug;
pub mod decode;
pub mod exchange;
pub mod firstshot;
pub mod frame;
pub mod local;
pub mod operator;
pub mod pixels;
pub mod receivers;
pub mod senders;
mod sight;
pub mod streamed;
pub mod temporal;
mod test_lights;

use std::ops::ControlFlow;

use formfactor::Proceed;
use reference::Picture;

/// A picture and its parts, radiance in W/m²/sr: `full = direct + indirect`, split at the visible surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Pictures {
    /// Everything.
    pub full: Picture,
    /// Lights and sky seen directly, and light that came straight from a light.
    pub direct: Picture,
    /// Light that was reflected before it reached the visible surface.
    pub indirect: Picture,
}

/// Goes on until the user cancels.
fn go_on(_: usize, _: usize) -> Proceed {
    if crate::progress::is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

/// Reports what is done, and goes on until the user cancels.
pub fn proceed(report: &(dyn Fn(f32) -> bool + Sync), done: usize, total: usize) -> Proceed {
    if report(done as f32 / total.max(1) as f32) { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
}
