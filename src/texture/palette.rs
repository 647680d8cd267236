//! 256 colours a texture: which ones, and which of them each texel becomes.
//!
//! The colours are found by a neural network (`NeuQuant`) in the texels of all levels that show anything;
//! one colour is kept for what shows nothing. Textures of fewer colours keep them all.
//!
//! This work is based on:
//! Anthony H. Dekker. Kohonen Neural Networks for Optimal Colour Quantization. Network 5, 1994

use std::collections::BTreeSet;

use color_quant::NeuQuant;

use crate::error::LodError;
use crate::texture::dilate::Check;
use crate::texture::texture::Image;

/// Colours of a palette, that of empty texels among them.
const COLOR_COUNT: usize = 256;

/// Bytes of a palette: four a colour.
pub(super) const PALETTE_BYTES: u64 = COLOR_COUNT as u64 * 4;

/// Texels from which a network learns; of more, every so many are taken.
const MAX_TAUGHT_TEXELS: usize = 1 << 18;

/// Texels between two looks at whether to go on.
const TEXELS_A_CHECK: usize = 1 << 14;

/// What every texel without any alpha becomes.
const EMPTY: [u8; 4] = [0; 4];

/// Replaces texels by the nearest ones of a palette that all levels share.
///
/// # Errors
/// Whatever `check` returns, which is called often so that a long run can be stopped.
pub(super) fn store(levels: &mut [Image], check: &Check<'_>) -> Result<(), LodError> {
    let mut colors = BTreeSet::new();
    for chunk in levels.iter_mut().flat_map(|level| level.texels.chunks_mut(TEXELS_A_CHECK)) {
        check()?;
        for texel in chunk {
            if texel[3] == 0 {
                *texel = EMPTY;
            }
            if colors.len() <= COLOR_COUNT {
                colors.insert(*texel);
            }
        }
    }
    if colors.len() <= COLOR_COUNT {
        return Ok(());
    }
    let seen = |texel: &&[u8; 4]| texel[3] > 0;
    let count = levels.iter().flat_map(|level| &level.texels).filter(seen).count();
    let taught: Vec<u8> = levels
        .iter()
        .flat_map(|level| &level.texels)
        .filter(seen)
        .step_by(count.div_ceil(MAX_TAUGHT_TEXELS))
        .flatten()
        .copied()
        .collect();
    check()?;
    let network = NeuQuant::new(1, COLOR_COUNT - 1, &taught);
    for chunk in levels.iter_mut().flat_map(|level| level.texels.chunks_mut(TEXELS_A_CHECK)) {
        check()?;
        for texel in chunk.iter_mut().filter(|texel| texel[3] > 0) {
            network.map_pixel(texel);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stored(texels: Vec<[u8; 4]>) -> Vec<[u8; 4]> {
        let width = u32::try_from(texels.len()).expect("small");
        let mut levels = [Image::new(width, 1, texels).expect("valid")];
        store(&mut levels, &|| Ok(())).expect("never stopped");
        let [level] = levels;
        level.texels
    }

    #[test]
    fn as_many_colours_as_there_is_room_for_are_kept() {
        let texels: Vec<[u8; 4]> = (0..=255).map(|code| [code, 255 - code, 7, code]).collect();
        let mut expected = texels.clone();
        expected[0] = EMPTY;
        assert_eq!(stored(texels), expected, "255 colours and nothing");
    }

    #[test]
    fn of_more_colours_256_near_ones_are_left() {
        let code = |value: usize| u8::try_from(value).expect("below 256");
        let texels: Vec<[u8; 4]> = (0..16 * 16 * 16)
            .map(|i| [code(i % 16 * 16), code(i / 16 % 16 * 16), code(i / 256 * 16), 255])
            .collect();
        let found = stored(texels.clone());
        let colors: BTreeSet<_> = found.iter().collect();
        assert!(colors.len() <= COLOR_COUNT, "{} colours", colors.len());
        assert!(colors.len() > COLOR_COUNT / 2, "{} colours", colors.len());
        let errors = found
            .iter()
            .zip(&texels)
            .map(|(a, b)| (0..3).map(|c| f64::from(a[c].abs_diff(b[c])).powi(2)).sum::<f64>());
        let rms = (errors.sum::<f64>() / texels.len() as f64).sqrt();
        // 255 evenly laid out in a cube of side 256 are 40 apart, and most points 20 from one
        assert!(rms < 30.0, "{rms}");
    }

    #[test]
    fn what_shows_nothing_stays_so_among_many_colours() {
        let code = |value: usize| u8::try_from(value % 256).expect("below 256");
        let texels: Vec<[u8; 4]> = (0..2000)
            .map(|i| [code(i * 7), code(i * 3), code(i), if i % 2 == 0 { 0 } else { 255 }])
            .collect();
        for (found, texel) in stored(texels.clone()).iter().zip(&texels) {
            assert_eq!(found[3] == 0, texel[3] == 0, "{found:?} for {texel:?}");
        }
    }

    #[test]
    fn all_levels_share_the_colours() {
        let code = |value: usize| u8::try_from(value % 256).expect("below 256");
        let level = |side: u32, shift: usize| {
            let texels = (0..(side * side) as usize)
                .map(|i| [code(i), code(i * 5 + shift), code(shift), 255]);
            Image::new(side, side, texels.collect()).expect("valid")
        };
        let mut levels = [level(64, 1), level(32, 90), level(16, 200)];
        store(&mut levels, &|| Ok(())).expect("never stopped");
        let colors: BTreeSet<_> = levels.iter().flat_map(|level| &level.texels).collect();
        assert!(colors.len() <= COLOR_COUNT, "{} colours", colors.len());
    }
}
