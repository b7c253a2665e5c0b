//! What one invocation does.

pub mod blend;
pub mod encoding;
pub mod lookup;
pub mod octahedral;
pub mod trace;
