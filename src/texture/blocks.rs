//! Block compression as graphics cards read it: what 4 x 4 texels become in 8 or 16 bytes.
//!
//! Blocks are made by libraries and read back by them, so a picture shows what a card would show. Sides
//! that 4 does not divide are filled up with copies of the last row and column, which cost bytes and are
//! never seen.

use block_compression::decode::decompress_blocks_as_rgba8;
use block_compression::encode::compress_rgba8;
use block_compression::{BC7Settings, CompressionVariant};
use texpresso::{Algorithm, COLOUR_WEIGHTS_UNIFORM, Params};

use crate::error::LodError;
use crate::texture::dilate::Check;
use crate::texture::texture::Image;

/// Texels along each side of a block.
const SIDE: usize = 4;

/// Which kind of blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Blocks {
    /// Two colours of 16 bits, and alpha of one bit: 8 bytes.
    Bc1,
    /// The same without alpha, and alpha of its own between two ends: 16 bytes.
    Bc3,
    /// One of several ways, whichever is best: 16 bytes.
    Bc7,
}

impl Blocks {
    /// Bytes of all blocks of an image.
    pub(super) fn byte_count(self, width: u32, height: u32) -> u64 {
        let block_bytes = if self == Self::Bc1 { 8 } else { 16 };
        let blocks = |side: u32| u64::from(side).div_ceil(SIDE as u64);
        blocks(width) * blocks(height) * block_bytes
    }

    /// Replaces an image's texels by those that its blocks give back.
    ///
    /// # Errors
    /// Whatever `check` returns, which is called for every row of blocks.
    pub(super) fn store(self, image: &mut Image, check: &Check<'_>) -> Result<(), LodError> {
        let (width, height) = (image.width as usize, image.height as usize);
        let padded_width = width.next_multiple_of(SIDE);
        let mut row = vec![[0_u8; 4]; padded_width * SIDE];
        for top in (0..height).step_by(SIDE) {
            check()?;
            for (index, texel) in row.iter_mut().enumerate() {
                let x = (index % padded_width).min(width - 1);
                let y = (top + index / padded_width).min(height - 1);
                *texel = image.texels[y * width + x];
            }
            self.store_row(&mut row, padded_width);
            for y in top..(top + SIDE).min(height) {
                let from = (y - top) * padded_width;
                image.texels[y * width..][..width].copy_from_slice(&row[from..][..width]);
            }
        }
        Ok(())
    }

    /// One row of blocks, `width` texels wide.
    fn store_row(self, row: &mut [[u8; 4]], width: usize) {
        let format = match self {
            Self::Bc1 => texpresso::Format::Bc1,
            Self::Bc3 => texpresso::Format::Bc3,
            Self::Bc7 => return store_bc7_row(row, width),
        };
        // what shows little may be wrong; 1-bit alpha either shows a colour or not
        let params = Params {
            algorithm: Algorithm::ClusterFit,
            weights: COLOUR_WEIGHTS_UNIFORM,
            weigh_colour_by_alpha: self == Self::Bc3,
        };
        let given_back = |block: Block| {
            let mut bytes = [0; 16];
            let bytes = &mut bytes[..format.block_size()];
            format.compress_block_masked(block, 0xffff, params, bytes);
            format.decompress_block(bytes)
        };
        for left in (0..width).step_by(SIDE) {
            let at = |index: usize| index / SIDE * width + left + index % SIDE;
            let block = std::array::from_fn(|index| row[at(index)]);
            let mut found = given_back(block);
            if is_one_colour(&found) && !is_one_colour(&block) {
                found = given_back(nudged(block));
            }
            for (index, texel) in found.into_iter().enumerate() {
                row[at(index)] = texel;
            }
        }
    }
}

type Block = [[u8; 4]; SIDE * SIDE];

fn is_one_colour(block: &Block) -> bool {
    block.iter().all(|texel| texel == &block[0])
}

/// The fit looks for the longest axis of the colours from (1, 1, 1) on, and finds none that is at right
/// angles to it, as from red to blue. One step of red more turns the axis a little.
fn nudged(mut block: Block) -> Block {
    let brightest = block.iter_mut().max_by_key(|texel| texel[0]).expect("16 texels");
    brightest[0] = brightest[0].wrapping_sub(1);
    block
}

fn store_bc7_row(row: &mut [[u8; 4]], width: usize) {
    let [width, height] = [width, SIDE].map(|side| u32::try_from(side).expect("a texture's"));
    let format = CompressionVariant::BC7(BC7Settings::alpha_basic());
    let mut bytes = vec![0; format.blocks_byte_size(width, height)];
    let texels: &mut [u8] = bytemuck::cast_slice_mut(row);
    compress_rgba8(format, texels, &mut bytes, width, height, width * 4);
    decompress_blocks_as_rgba8(format, width, height, &bytes, texels);
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Blocks; 3] = [Blocks::Bc1, Blocks::Bc3, Blocks::Bc7];

    fn stored(blocks: Blocks, width: u32, height: u32, texels: Vec<[u8; 4]>) -> Vec<[u8; 4]> {
        let mut image = Image::new(width, height, texels).expect("valid");
        blocks.store(&mut image, &|| Ok(())).expect("never stopped");
        image.texels
    }

    #[test]
    fn bytes_are_those_of_whole_blocks() {
        for (blocks, bytes) in ALL.into_iter().zip([8, 16, 16]) {
            assert_eq!(blocks.byte_count(1, 1), bytes, "{blocks:?}");
            assert_eq!(blocks.byte_count(5, 8), 4 * bytes, "{blocks:?}");
        }
    }

    /// The ends of a BC7 block have a lowest bit that all channels share: none is off by more than one.
    fn same(blocks: Blocks, found: &[[u8; 4]], expected: &[[u8; 4]]) -> bool {
        let most = u8::from(blocks == Blocks::Bc7);
        let near = |(a, b): (&[u8; 4], &[u8; 4])| (0..4).all(|c| a[c].abs_diff(b[c]) <= most);
        found.iter().zip(expected).all(near)
    }

    #[test]
    fn colours_that_a_block_can_hold_come_back() {
        // red, blue and white are ends of 5, 6 and 5 bits; two of them are a block's ends
        for [one, other] in [[[255, 0, 0, 255], [0, 0, 255, 255]], [[255; 4], [0, 0, 0, 255]]] {
            let texels: Vec<_> = (0..16).map(|i| if i % 3 == 0 { one } else { other }).collect();
            for blocks in ALL {
                let found = stored(blocks, 4, 4, texels.clone());
                assert!(same(blocks, &found, &texels), "{blocks:?}: {found:?}");
            }
        }
    }

    #[test]
    fn each_block_has_its_own_colours_and_odd_sides_are_filled_up() {
        // two blocks side by side, two below, of which the last row and columns lie outside
        let colour = |x: usize, y: usize| match (x / 4, y / 4) {
            (0, 0) => [255, 0, 0, 255],
            (1, 0) => [0, 255, 0, 255],
            (0, _) => [0, 0, 255, 255],
            _ => [0, 0, 0, 255],
        };
        let texels: Vec<_> = (0..42).map(|i| colour(i % 6, i / 6)).collect();
        for blocks in ALL {
            let found = stored(blocks, 6, 7, texels.clone());
            assert!(same(blocks, &found, &texels), "{blocks:?}: {found:?}");
        }
    }

    #[test]
    fn alpha_is_there_or_not_or_in_between() {
        let texels: Vec<_> = (0..16_u8).map(|i| [200, 100, 50, i * 17]).collect();
        let alphas = |blocks| -> Vec<u8> {
            stored(blocks, 4, 4, texels.clone()).iter().map(|texel| texel[3]).collect()
        };
        let cut: Vec<u8> = texels.iter().map(|t| if t[3] >= 128 { 255 } else { 0 }).collect();
        assert_eq!(alphas(Blocks::Bc1), cut, "one bit");
        for (blocks, most) in [(Blocks::Bc3, 19), (Blocks::Bc7, 19)] {
            for (alpha, texel) in alphas(blocks).iter().zip(&texels) {
                // eight steps between the ends of 0 and 255 are 36 apart
                assert!(alpha.abs_diff(texel[3]) <= most, "{blocks:?}: {alpha} for {}", texel[3]);
            }
        }
    }

    #[test]
    fn a_long_run_can_be_stopped() {
        let mut image = Image::new(4, 400, vec![[9; 4]; 1600]).expect("valid");
        let stop = || Err(LodError::Cancelled);
        assert!(Blocks::Bc7.store(&mut image, &stop).is_err(), "at its first row");
    }
}
