//! Work of one invocation.

pub mod blend;
pub mod encoding;
pub mod lookup;
pub mod octahedral;
pub mod trace;
