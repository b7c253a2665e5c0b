//! Helpers for tests of operators.

use scene::sampling::{hash3, unit};
use transport::Proceed;

/// A number from 0 to 1 that follows from three.
pub fn random(a: usize, b: usize, c: u32) -> f32 {
    unit(hash3(a as u32, b as u32, c))
}

/// Progress that never cancels.
pub fn go(_: usize, _: usize) -> Proceed {
    Proceed::Continue(())
}
