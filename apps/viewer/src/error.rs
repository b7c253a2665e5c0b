//! Why the window closed.

use std::path::PathBuf;

use ash::vk;
use runtime::executor::ExecutorError;

use crate::script::ScriptError;

/// Why the viewer cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No window system.
    #[error("no window can be opened: {reason}; use `patchlight render`, which writes pictures into files")]
    NoWindow {
        /// Message of the window system.
        reason: String,
    },
    /// No Vulkan device that can show a window.
    #[error(
        "no Vulkan device can show a window: {reason}; install a graphics driver (Mesa's lavapipe needs no graphics \
         card), or use `patchlight render`, which writes pictures into files and needs none"
    )]
    NoDevice {
        /// The missing part.
        reason: String,
    },
    /// A call of Vulkan failed.
    #[error("{call}: {result:?}; {}", remedy(*result))]
    Call {
        /// The call.
        call: &'static str,
        /// Its result.
        result: vk::Result,
    },
    /// The panels could not be drawn.
    #[error("the panels cannot be drawn: {reason}; update the driver of the graphics card")]
    Panels {
        /// The failed action.
        reason: String,
    },
    /// The validation layer found a mistake of ours.
    #[error("the Vulkan validation layer reports {}: {}", messages.len(), messages.join("; "))]
    Validation {
        /// Its messages.
        messages: Vec<String>,
    },
    /// A script asks for what is not there.
    #[error(transparent)]
    Script(#[from] ScriptError),
    /// A file that cannot be read.
    #[error("cannot read {}: {source}; check its name", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error from the operating system.
        source: std::io::Error,
    },
    /// A bake whose light is not on the device.
    #[error(
        "receivers at the pixels are gathered on the host, for measuring: bake with receivers on the mesh, or use \
         `patchlight render`"
    )]
    PixelReceivers,
    /// A reference, a screenshot.
    #[error(transparent)]
    Picture(#[from] reference::Error),
    /// A screenshot that cannot be made.
    #[error("{}: {reason}", path.display())]
    Screenshot {
        /// The file.
        path: PathBuf,
        /// Why not, and what to do.
        reason: String,
    },
    /// The light.
    #[error(transparent)]
    Light(#[from] patchlight::Error),
}

impl From<ExecutorError> for Error {
    fn from(error: ExecutorError) -> Self {
        Self::Light(error.into())
    }
}

impl From<runtime::vulkan::Error> for Error {
    fn from(error: runtime::vulkan::Error) -> Self {
        ExecutorError::from(error).into()
    }
}

impl From<egui_ash_renderer::RendererError> for Error {
    fn from(error: egui_ash_renderer::RendererError) -> Self {
        Self::Panels { reason: error.to_string() }
    }
}

impl Error {
    /// Makes the error of a call: `.map_err(Error::call("vkQueueSubmit"))`.
    pub(crate) fn call(call: &'static str) -> impl FnOnce(vk::Result) -> Self {
        move |result| Self::Call { call, result }
    }
}

fn remedy(result: vk::Result) -> &'static str {
    match result {
        vk::Result::ERROR_DEVICE_LOST => {
            "the device was reset, often because one pass ran too long: start again with a smaller window, or on the \
             CPU"
        }
        vk::Result::ERROR_SURFACE_LOST_KHR => "the window system took the window away: start again",
        vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY => {
            "memory is full: choose a smaller window or fewer patches"
        }
        _ => "update the driver of the graphics card, or choose another device",
    }
}
