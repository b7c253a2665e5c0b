//! Arguments that several programs take.

pub mod bake;
pub mod common;
pub mod definition;
pub mod display;
pub mod idle;
pub mod input;
pub mod local;
pub mod method;
pub mod operator;
pub mod patches;
pub mod temporal;

pub use bake::{BakeOptions, Bounces};
pub use common::Common;
pub use definition::{definition, read};
pub use display::{DisplayOptions, DisplaySettings, Exposure, Reflection};
pub use input::Input;
pub use local::LocalArgs;
pub use method::{Method, MethodOptions, parse_purpose};
pub use operator::{BuildPlace, Decoding, OperatorOptions, OperatorSettings, Storage};
pub use patches::{FormFactors, PatchOptions, ReceiverPlaces};
pub use temporal::{Switch, TemporalOptions};
