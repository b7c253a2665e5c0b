//! A window on a lit scene: fly through it, move its lights and its sun, switch methods, and compare what is shown with
//! the path tracer or a picture.
//!
//! [`Display::open`] finds a window system and a Vulkan driver, [`Display::show`] shows a bake until the window is
//! closed. Each frame the panels ([`panels`], [`mod@pointer`]) or a script ([`script`]) change the [`state`], [`live`]
//! finds light and picture where they have changed, and [`screen`] copies the picture into the window and draws the
//! panels over it. With an executor on the device of the window the picture never leaves it.

#[macro_use]
extern crate shell;

mod app;
pub mod command;
pub mod error;
pub mod eye;
mod fit;
pub mod lights;
pub mod live;
pub mod methods;
pub mod object;
pub mod panels;
pub mod pointer;
pub mod reference;
pub mod screen;
mod screenshot;
pub mod script;
pub mod state;
pub mod sun;
pub mod times;

pub use app::{Again, Baking, Display, Report, Settings};
pub use error::Error;
pub use methods::MethodDefaults;
