//! Where in a pixel a picture is sampled.
//!
//! A picture with `n` samples is the mean of `n` one-sample pictures. 1 is the centre; 4, 8 and 16
//! are Vulkan's standard locations; above 16 they are the Hammersley points of `n`, which are spread
//! evenly in both directions. All lie on the 1/256 pixel grid of the rasteriser, so coverage is exact.
//!
//! This work is based on:
//! The Khronos Group. Vulkan 1.3, Standard sample locations
//! John Hammersley. Monte Carlo methods for solving multivariable problems. 1960

use crate::error::LodError;

/// Sub-pixel steps a pixel, as a power of two.
pub const SUBPIXEL_BITS: u32 = 8;

/// Sub-pixel steps a pixel.
pub const SUBPIXEL_COUNT: i32 = 1 << SUBPIXEL_BITS;

/// More samples than this are taken for a mistake.
pub const MAX_SAMPLE_COUNT: u32 = 65_536;

/// Position inside a pixel, in sub-pixel steps, each in `0..256`.
pub type SamplePosition = [i32; 2];

const ONE: [SamplePosition; 1] = [[128, 128]];
const FOUR: [SamplePosition; 4] = [[96, 32], [224, 96], [32, 160], [160, 224]];
const EIGHT: [SamplePosition; 8] =
    [[144, 80], [112, 176], [208, 144], [80, 48], [48, 208], [16, 112], [176, 240], [240, 16]];
const SIXTEEN: [SamplePosition; 16] = [
    [144, 144],
    [112, 80],
    [80, 160],
    [192, 112],
    [48, 96],
    [160, 208],
    [208, 176],
    [176, 48],
    [96, 224],
    [128, 16],
    [64, 32],
    [32, 192],
    [0, 128],
    [240, 64],
    [224, 240],
    [16, 0],
];

/// Sizes of the sets that samples are drawn in, largest first.
pub const PASS_SIZES: [usize; 4] = [16, 8, 4, 1];

/// How many of the samples that are left are drawn next: sets of 1, 4, 8 or 16 are one pass, longer
/// ones are passes of 16 and of what is left.
pub fn pass_size(left: usize) -> usize {
    let fits = PASS_SIZES.into_iter().find(|&size| size <= left);
    fits.expect("at least one sample is left")
}

/// Alpha from which a shape drawn with [`crate::draw_list::Blend::Coverage`] is there in a sample of a
/// pass: the middles of equal shares of [0, 1], in an order that shapes do not share.
#[inline]
pub fn alpha_threshold(sample: usize, pass_size: usize, seed: u32, source_id: u32) -> f32 {
    let mut hash = (seed ^ 0x9E37_79B9).wrapping_mul(0x85EB_CA6B) ^ source_id;
    hash = (hash ^ hash >> 16).wrapping_mul(0x7FEB_352D);
    hash = (hash ^ hash >> 15).wrapping_mul(0x846C_A68B);
    hash ^= hash >> 16;
    // exchanged by a mask, then multiplied by an odd number: a permutation of any power of two
    let (mask, odd) = ((hash >> 8) as usize, (hash | 1) as usize);
    let rank = (sample ^ mask).wrapping_mul(odd) & (pass_size - 1);
    (rank as f32 + 0.5) / pass_size as f32
}

/// Positions of a picture's samples.
///
/// # Errors
/// [`LodError::OutOfRange`] unless `count` is 1, 4, 8, 16, or in `17..=65536`.
pub fn positions(count: u32) -> Result<Vec<SamplePosition>, LodError> {
    match count {
        1 => Ok(ONE.to_vec()),
        4 => Ok(FOUR.to_vec()),
        8 => Ok(EIGHT.to_vec()),
        16 => Ok(SIXTEEN.to_vec()),
        17..=MAX_SAMPLE_COUNT => Ok((0..count).map(|index| hammersley(index, count)).collect()),
        _ => Err(LodError::OutOfRange {
            name: "samples",
            value: count.to_string(),
            range: format!("1, 4, 8, 16 or 17..={MAX_SAMPLE_COUNT}"),
        }),
    }
}

/// Point `index` of `count` Hammersley points, moved to the middle of their cells and rounded down.
fn hammersley(index: u32, count: u32) -> SamplePosition {
    // both coordinates in units of 2^-32 of a pixel
    let half_cell = (1_u64 << 31) / u64::from(count);
    let x = ((u64::from(index) << 32) / u64::from(count)) + half_cell;
    let y = u64::from(index.reverse_bits()) + half_cell;
    [x, y].map(|step| {
        let inside = step & 0xFFFF_FFFF;
        i32::try_from(inside >> (32 - SUBPIXEL_BITS)).expect("eight bits")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_set_is_inside_the_pixel_and_centred() {
        for count in [1, 4, 8, 16, 17, 64, 256, 1000] {
            let set = positions(count).expect("allowed");
            assert_eq!(set.len(), count as usize, "{count} samples");
            for axis in [0, 1] {
                let sum: i32 = set.iter().map(|p| p[axis]).sum();
                assert!(set.iter().all(|p| (0..256).contains(&p[axis])), "{count}: inside");
                let mean = f64::from(sum) / f64::from(count);
                // Vulkan's 16 have mean 120, and so has a set of 17
                assert!((mean - 128.0).abs() <= 8.5, "{count}: axis {axis} has mean {mean}");
            }
        }
        for count in [0, 2, 3, 5, 15, 65_537] {
            assert!(positions(count).is_err(), "{count} samples");
        }
    }

    #[test]
    fn long_sets_fill_the_pixel() {
        // 256 positions, 16 x 16 cells: random ones would fill 63 %
        let set = positions(256).expect("allowed");
        let mut cells: Vec<i32> = set.iter().map(|p| p[1] / 16 * 16 + p[0] / 16).collect();
        cells.sort_unstable();
        cells.dedup();
        assert_eq!(cells.len(), 256, "one position a cell");
    }
}
