//! Options of operators: how they are stored, decoded and built.

use clap::{Args, ValueEnum};
use multibounce::BlockCodec;

use patchlight::low_level::operator::{BuildOn, Codec, Decode};
use patchlight::method::FeedbackSettings;

use super::bake::parse_bytes;
use super::common::parse_epsilon;
use super::definition::RESEARCH;

/// Relative error of compressed operators unless another one is asked for.
const EPSILON: f64 = 0.01;

/// Storage of the operator of all bounces.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Storage {
    /// Single precision, three numbers an entry.
    Dense,
    /// Half precision, three numbers an entry.
    F16,
    /// Texture blocks of half a byte an entry, with the greatest entries beside them.
    Bc1,
    /// A byte an entry: brightness separate from colour.
    Bc3,
    /// A byte an entry: half-precision colours.
    Bc6h,
    /// A byte an entry: 8-bit colours on up to three lines.
    Bc7,
    /// Rank-1 terms, dense sub-blocks and sparse residuals in tiles, with the error that --epsilon
    /// says.
    #[default]
    #[value(name = "low_rank", alias = "tiles")]
    LowRank,
}

impl Storage {
    /// The codec; the low-rank operator with this relative error.
    pub fn codec(self, epsilon: f64) -> Codec {
        match self {
            Self::Dense => Codec::Dense,
            Self::F16 => Codec::Half,
            Self::Bc1 => Codec::Blocks(BlockCodec::Bc1),
            Self::Bc3 => Codec::Blocks(BlockCodec::Bc3),
            Self::Bc6h => Codec::Blocks(BlockCodec::Bc6h),
            Self::Bc7 => Codec::Blocks(BlockCodec::Bc7),
            Self::LowRank => Codec::LowRank { epsilon },
        }
    }
}

/// Decoder of texture blocks on a device.
#[derive(ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Decoding {
    /// The texture unit where there is one that is faster.
    #[default]
    Auto,
    /// The texture unit (needs textureCompressionBC); its BC1 and BC3 are rounded to about 8 bits.
    Texture,
    /// The kernel, exactly as on the CPU.
    Kernel,
}

impl Decoding {
    /// The library's name for it.
    pub fn decode(self) -> Decode {
        match self {
            Self::Auto => Decode::Auto,
            Self::Texture => Decode::Texture,
            Self::Kernel => Decode::Kernel,
        }
    }
}

/// Place where operators are built.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum BuildPlace {
    /// On the device when it is a graphics processor, else on the host.
    Auto,
    /// On the host.
    Host,
    /// On the device, whatever it is.
    Device,
}

impl BuildPlace {
    /// As methods take it.
    pub fn place(self) -> BuildOn {
        match self {
            Self::Auto => BuildOn::Auto,
            Self::Host => BuildOn::Host,
            Self::Device => BuildOn::Device,
        }
    }
}

impl OperatorOptions {
    /// Returns true if a device has a part in what is said: it decodes texture blocks.
    pub fn needs_device(&self) -> bool {
        self.operator && matches!(self.codec.codec(self.epsilon), Codec::Blocks(_))
    }
}

/// Choice of operators.
#[derive(Args, Clone, Copy, Debug, PartialEq)]
pub struct OperatorOptions {
    /// Also make the operator of all bounces between the patches: bytes, ranks, errors; with --out also pictures of the
    /// matrix before and after it is reordered, and of the error of its compression.
    #[arg(long, help_heading = RESEARCH)]
    pub operator: bool,
    /// Storage of the operator; with low_rank also form factors for feedback.
    #[arg(long, value_enum, default_value_t = Storage::default(), requires = "operator", help_heading = RESEARCH)]
    pub codec: Storage,
    /// Relative error of low_rank, in the sense of Frobenius.
    #[arg(long, default_value_t = 0.01, value_parser = parse_epsilon, requires = "operator", help_heading = "Method")]
    pub epsilon: f64,
    /// Requested decoder of texture blocks in frames on the device.
    #[arg(long, value_enum, default_value_t, requires = "operator", help_heading = RESEARCH)]
    pub decode: Decoding,
}

/// Choice of operators, and the memory to build them in.
#[derive(Args, Clone, Copy, Debug, PartialEq)]
pub struct OperatorSettings {
    /// Most resident memory, as in 800M or 2G [default: what is free].
    ///
    /// What would take more is refused before it is begun; tiles of a larger operator are built panel by panel in a
    /// file beside the results.
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, help_heading = "Bake")]
    pub memory_limit: Option<u64>,
    /// Storage of the operator (multibounce) [default: low_rank; of a bake: as it is there].
    #[arg(long, value_enum, help_heading = RESEARCH)]
    pub codec: Option<Storage>,
    /// Error of compressed operators (low_rank, feedback) [default: 0.01].
    ///
    /// Relative, in the Frobenius norm. Of a bake the default is the error that its operator has.
    #[arg(long, value_name = "E", value_parser = parse_epsilon, help_heading = "Method")]
    pub epsilon: Option<f64>,
}

impl OperatorSettings {
    /// The relative error of compressed operators.
    pub fn error(&self) -> f64 {
        self.epsilon.unwrap_or(EPSILON)
    }

    /// Storage of the operator of --method multibounce.
    pub fn storage(&self) -> Codec {
        self.codec.unwrap_or_default().codec(self.error())
    }

    /// That of --method low_rank.
    pub fn low_rank(&self) -> Codec {
        Codec::LowRank { epsilon: self.error() }
    }

    /// Feedback with so many products a frame, accelerated or not.
    pub fn feedback(&self, products: u32, accelerated: bool) -> FeedbackSettings {
        FeedbackSettings { epsilon: self.error(), products, accelerated }
    }
}
