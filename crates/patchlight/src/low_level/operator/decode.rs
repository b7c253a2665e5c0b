//! Decoders of texture blocks in frames on a device: its texture unit, or the kernel.

use multibounce::BlockMatrix;
use multibounce::kernel::blocks::BLOCK;

use runtime::executor::{DeviceInfo, DeviceKind};
use runtime::recipe::multibounce::Decoder;

use super::PatchOperator;
use crate::error::{Error, Reason};

/// Requested decoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Decode {
    /// The texture unit where there is one that is faster.
    #[default]
    Auto,
    /// The texture unit.
    Texture,
    /// The kernel, exactly as on the host.
    Kernel,
}

/// The name of a decoder in summaries and options.
pub fn decoder_name(decoder: Decoder) -> &'static str {
    match decoder {
        Decoder::Texture { .. } => "texture",
        Decoder::Kernel => "kernel",
    }
}

impl PatchOperator {
    /// Decoder of the operator's blocks on a device; `None` for one that has none.
    ///
    /// # Errors
    /// As [`Decode::on`].
    pub fn decoder(&self, decode: Decode, device: &DeviceInfo) -> Result<Option<Decoder>, Error> {
        match self {
            Self::Blocks(matrix) => Ok(Some(decode.on(device, matrix)?)),
            _ => Ok(None),
        }
    }
}

impl Decode {
    /// Decoder of a matrix on a device. An image holds whole rows of the matrix; there are as many images as it takes.
    ///
    /// Without a choice it is the texture unit of a graphics processor. Vulkan on the CPU has none and decodes a block
    /// anew for each texel, which takes 1.4 to 4 times as long as the kernel (lavapipe, 1,500 patches).
    ///
    /// # Errors
    /// As [`Self::check`], and [`Unsupported`](crate::ErrorKind::Unsupported) where the texture unit is asked for in
    /// vain.
    pub fn on(self, device: &DeviceInfo, matrix: &BlockMatrix) -> Result<Decoder, Error> {
        self.check(device)?;
        let edge = device.max_image_edge;
        let needed = matrix.block_count() * BLOCK as usize;
        let fits = needed <= edge as usize;
        match self {
            Self::Texture if !fits => {
                Err(Reason::WideBlocks { device: device.name.clone(), patches: matrix.len(), limit: edge }.into())
            }
            Self::Auto if !(has_unit(device) && fits && device.kind != DeviceKind::EmulatedOnCpu) => {
                Ok(Decoder::Kernel)
            }
            Self::Kernel => Ok(Decoder::Kernel),
            Self::Auto | Self::Texture => Ok(Decoder::Texture { edge }),
        }
    }

    /// Checks that a device can do it at all: known before there is a matrix.
    ///
    /// # Errors
    /// [`Unsupported`](crate::ErrorKind::Unsupported) where the texture unit is asked for and there is none.
    pub fn check(self, device: &DeviceInfo) -> Result<(), Error> {
        match self {
            Self::Texture if !has_unit(device) => Err(Reason::NoTextureUnit { device: device.name.clone() }.into()),
            _ => Ok(()),
        }
    }
}

/// Native code reads images of blocks, but with the kernel's decoders.
fn has_unit(device: &DeviceInfo) -> bool {
    device.kind != DeviceKind::Native && device.has_block_images
}

#[cfg(all(test, feature = "texture-blocks"))]
mod tests {
    use std::ops::ControlFlow;

    use glam::Vec3;
    use multibounce::{BlockCodec, BlockSettings};
    use transport::Permutation;

    use super::*;
    use runtime::cpu::Cpu;
    use runtime::executor::Executor;

    fn matrix(n: usize, codec: BlockCodec) -> BlockMatrix {
        let settings = BlockSettings { codec, ..BlockSettings::default() };
        let rows = |_: usize, row: &mut [Vec3]| row.fill(Vec3::ONE);
        let go = |_: usize, _: usize| ControlFlow::Continue(());
        BlockMatrix::encode(n, &rows, Permutation::identity(n), settings, &go).unwrap()
    }

    #[test]
    fn the_texture_unit_is_taken_where_it_is_faster_and_refused_where_there_is_none() {
        let native = Cpu::new().device().clone();
        let card = DeviceInfo { kind: DeviceKind::Discrete, max_image_edge: 64, name: "card".into(), ..native.clone() };
        let bare = DeviceInfo { has_block_images: false, ..card.clone() };
        let emulated = DeviceInfo { kind: DeviceKind::EmulatedOnCpu, ..card.clone() };
        for codec in BlockCodec::ALL {
            let small = matrix(61, codec);
            let large = matrix(65, codec);
            let texture = Decoder::Texture { edge: 64 };
            assert_eq!(Decode::Auto.on(&card, &small).unwrap(), texture);
            for (device, matrix) in [(&card, &large), (&bare, &small), (&native, &small)] {
                assert_eq!(Decode::Auto.on(device, matrix).unwrap(), Decoder::Kernel);
                assert_eq!(Decode::Kernel.on(device, matrix).unwrap(), Decoder::Kernel);
            }
            assert_eq!(Decode::Auto.on(&emulated, &small).unwrap(), Decoder::Kernel);
            assert_eq!(Decode::Texture.on(&emulated, &small).unwrap(), texture);
            for (device, matrix, words) in [
                (&bare, &small, ["card", "textureCompressionBC", "the kernel"]),
                (&native, &small, [native.name.as_str(), "textureCompressionBC", "the kernel"]),
                (&card, &large, ["65 patches", "maxImageDimension2D", "the kernel"]),
            ] {
                let message = Decode::Texture.on(device, matrix).unwrap_err().to_string();
                assert!(words.iter().all(|word| message.contains(word)), "{message}");
            }
        }
    }
}
