//! Parts for methods and frames of one's own: the plan of a frame, its stages, the operators between patches.

pub mod frame;
pub mod operator;
pub mod stage;
