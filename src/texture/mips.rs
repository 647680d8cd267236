//! Mip levels of cards: filtered linear and premultiplied, in one of two ways.
//!
//! Cards that are *blended* keep their mean alpha: each level is the area mean of the one before.
//! Cards that are *alpha-tested* keep their coverage, the share of texels with alpha at or above the
//! cutoff: on each level the cutoff that would give the base's coverage is found, and alpha is
//! scaled so that it becomes the real one. Empty texels of every level take a neighbour's colour.
//! On a stack of cards the wrong one of the two is far off.
//!
//! This work is based on:
//! Ignacio Castano. Computing Alpha Mipmaps. 2010

use glam::Vec4;

use crate::error::LodError;
use crate::texture::dilate::{Check, dilated};
use crate::texture::linear::LinearImage;
use crate::texture::texture::Image;

/// What a card's levels keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Keep {
    /// Mean alpha, for cards that are blended.
    MeanAlpha,
    /// Coverage at a cutoff, for cards that are alpha-tested.
    Coverage {
        /// In (0, 1].
        cutoff: f32,
    },
}

/// All levels of an image, finest first, down to one texel.
///
/// # Errors
/// Whatever `check` returns, which is called often so that a long run can be stopped.
pub fn levels(base: Image, keep: Keep, check: &Check<'_>) -> Result<Vec<Image>, LodError> {
    let mut linear = LinearImage::decoded(&base);
    let wanted = match keep {
        Keep::MeanAlpha => 0.0,
        Keep::Coverage { cutoff } => coverage(&linear.texels, cutoff),
    };
    let mut levels = vec![base];
    while linear.width > 1 || linear.height > 1 {
        linear = linear.halved();
        levels.push(match keep {
            Keep::MeanAlpha => dilated(&linear, check)?,
            Keep::Coverage { cutoff } => dilated(&with_coverage(&linear, cutoff, wanted), check)?,
        });
    }
    Ok(levels)
}

/// Share of texels with alpha at or above the cutoff.
pub fn coverage(texels: &[Vec4], cutoff: f32) -> f64 {
    let covered = texels.iter().filter(|texel| texel.w >= cutoff).count();
    covered as f64 / texels.len() as f64
}

/// A level with alpha scaled so that its coverage is as near to `wanted` as one scale can bring it.
fn with_coverage(level: &LinearImage, cutoff: f32, wanted: f64) -> LinearImage {
    // a card that is full or empty has nothing to keep
    if wanted == 0.0 || wanted == 1.0 {
        return level.clone();
    }
    // Coverage falls as the cutoff rises, in steps at the alphas that occur, so those are the
    // cutoffs to choose from; between equals the lower one.
    let mut alphas: Vec<f32> = level.texels.iter().map(|texel| texel.w).collect();
    alphas.sort_by(f32::total_cmp);
    alphas.dedup();
    alphas.retain(|&alpha| alpha > 0.0);
    let first_at_most = alphas.partition_point(|&alpha| coverage(&level.texels, alpha) > wanted);
    let candidates = first_at_most.saturating_sub(1)..(first_at_most + 1).min(alphas.len());
    let miss = |alpha: f32| (coverage(&level.texels, alpha) - wanted).abs();
    let Some(best) = candidates.map(|i| alphas[i]).min_by(|&a, &b| miss(a).total_cmp(&miss(b)))
    else {
        return level.clone();
    };
    let scale = cutoff / best;
    let texels = level
        .texels
        .iter()
        .map(|texel| {
            // colour stays, alpha is scaled
            if texel.w > 0.0 { *texel * ((texel.w * scale).min(1.0) / texel.w) } else { *texel }
        })
        .collect();
    LinearImage { texels, ..*level }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels(base: Image, keep: Keep) -> Vec<Image> {
        super::levels(base, keep, &|| Ok(())).expect("nobody stops it")
    }

    fn alphas(width: u32, values: &[u8]) -> Image {
        let height = u32::try_from(values.len()).expect("small") / width;
        let texels = values.iter().map(|&a| [255, 255, 255, a]).collect();
        Image::new(width, height, texels).expect("valid")
    }

    #[test]
    fn blended_levels_keep_mean_alpha() {
        let base = alphas(4, &[255, 0, 0, 0, 0, 0, 0, 0, 0, 0, 51, 51, 0, 0, 51, 51]);
        let levels = levels(base, Keep::MeanAlpha);
        let of = |level: usize| levels[level].texels.iter().map(|t| t[3]).collect::<Vec<_>>();
        assert_eq!(of(1), [64, 0, 0, 51], "means of 2 x 2");
        assert_eq!(of(2), [29], "a quarter of 1, a quarter of 0.2: 0.1125");
        assert_eq!(levels.len(), 3, "down to one texel");
    }

    #[test]
    fn colour_does_not_bleed_from_transparent_texels() {
        let base = Image::new(2, 1, vec![[255, 0, 0, 0], [0, 0, 255, 255]]).expect("valid");
        let levels = levels(base, Keep::MeanAlpha);
        assert_eq!(levels[1].texels, [[0, 0, 255, 128]], "blue, half covered");
    }

    #[test]
    fn tested_levels_keep_coverage() {
        // sparse noise: the mean fades to a quarter, and a cutoff of one half would leave nothing
        let values: Vec<u8> = (0..64 * 64_u32)
            .map(|i| if i.wrapping_mul(2_654_435_761) >> 30 == 0 { 255 } else { 0 })
            .collect();
        let base = alphas(64, &values);
        let wanted = coverage(&LinearImage::decoded(&base).texels, 0.5);
        let kept = levels(base.clone(), Keep::Coverage { cutoff: 0.5 });
        let mean = levels(base, Keep::MeanAlpha);
        for level in 1..4 {
            let of = |levels: &[Image]| coverage(&LinearImage::decoded(&levels[level]).texels, 0.5);
            // alphas come in steps of 1/4^level, and 8-bit storage moves those near the cutoff
            assert!((of(&kept) - wanted).abs() < 0.12, "level {level}: {} for {wanted}", of(&kept));
            assert!(of(&mean) < 0.6 * of(&kept) || level == 1, "level {level}: the mean is lower");
        }
    }

    #[test]
    fn full_and_empty_cards_are_left_alone() {
        for value in [0, 255] {
            let levels = levels(alphas(4, &[value; 16]), Keep::Coverage { cutoff: 0.5 });
            assert!(levels.iter().all(|l| l.texels.iter().all(|t| t[3] == value)), "all {value}");
        }
    }
}
