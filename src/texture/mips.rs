//! Mip levels of cards: filtered linear and premultiplied, in one of two ways.
//!
//! Cards that are *blended* keep their mean alpha: each level is the area mean of the one before.
//! Cards that are *alpha-tested* keep their coverage, the share of their area at which alpha, filtered as
//! it is when they are drawn, is at or above the cutoff: on each level alpha is scaled so that it
//! has the base's coverage. Empty texels of every level take a neighbour's colour. On a stack of
//! cards the wrong one of the two is far off.
//!
//! Castano counts texels. But between a full texel and an empty one a filter falls below the cutoff
//! half way, and sparse texels that are just at the cutoff vanish between their neighbours: leaf
//! cards of such levels cover a tenth less than they should from afar. Points between texels are
//! counted here, as later tools do.
//!
//! This work is based on:
//! Ignacio Castano. Computing Alpha Mipmaps. 2010

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

/// Points a texel along each side at which coverage is counted.
const POINTS: usize = 4;

/// Halvings of the range of scales: finer than 8-bit alpha can tell.
const HALVINGS: usize = 16;

/// Alpha is scaled by up to this, or by its inverse. A level that would need more has next to nothing.
const MAX_SCALE: f32 = 256.0;

/// All levels of an image, finest first, down to one texel.
///
/// # Errors
/// Whatever `check` returns, which is called often so that a long run can be stopped.
pub fn levels(base: Image, keep: Keep, check: &Check<'_>) -> Result<Vec<Image>, LodError> {
    let mut linear = LinearImage::decoded(&base);
    let wanted = match keep {
        Keep::MeanAlpha => 0.0,
        Keep::Coverage { cutoff } => Alphas::of(&linear).coverage(1.0, cutoff),
    };
    let mut levels = vec![base];
    while linear.width > 1 || linear.height > 1 {
        linear = linear.halved();
        levels.push(match keep {
            Keep::MeanAlpha => dilated(&linear, check)?,
            Keep::Coverage { cutoff } => {
                dilated(&with_coverage(&linear, cutoff, wanted, check)?, check)?
            }
        });
    }
    Ok(levels)
}

/// By which share of the base's a level's coverage may be off, if it is to be drawn alone.
const MAX_MISS_SHARE: f64 = 0.1;

/// Gives up the levels of one alpha-tested picture from the first on whose texels are too few to have
/// its coverage: one texel is there or is not, and so would be all that it stands for.
pub fn drop_levels_without_coverage(levels: &mut Vec<Image>, cutoff: f32) {
    let coverage = |level: &Image| Alphas::of(&LinearImage::decoded(level)).coverage(1.0, cutoff);
    let wanted = coverage(&levels[0]);
    let holds = |level: &Image| (coverage(level) - wanted).abs() <= MAX_MISS_SHARE * wanted;
    let kept = levels.iter().position(|level| !holds(level)).unwrap_or(levels.len());
    levels.truncate(kept);
}

/// A picture with alpha scaled so that the share of it at or above the cutoff is its mean alpha: that is
/// the area that it covers, which a test then shows.
///
/// # Errors
/// Whatever `check` returns.
pub fn with_mean_as_coverage(
    image: &LinearImage,
    cutoff: f32,
    check: &Check<'_>,
) -> Result<LinearImage, LodError> {
    let sum: f64 = image.texels.iter().map(|texel| f64::from(texel.w)).sum();
    with_coverage(image, cutoff, sum / image.texels.len() as f64, check)
}

/// The alphas of a level, row by row.
struct Alphas {
    values: Vec<f32>,
    width: usize,
}

impl Alphas {
    fn of(level: &LinearImage) -> Self {
        let values = level.texels.iter().map(|texel| texel.w).collect();
        Self { values, width: level.width as usize }
    }

    /// Share of points at which alpha, scaled by `scale`, at most 1, and filtered between the nearest
    /// texels, is at or above the cutoff. Rows and columns end with their last texel.
    fn coverage(&self, scale: f32, cutoff: f32) -> f64 {
        let (width, height) = (self.width, self.values.len() / self.width);
        let row = |y: usize| &self.values[y * width..(y + 1) * width];
        // one more at either end
        let mut between = vec![0.0; width + 2];
        let mut covered = 0_usize;
        for y in 0..height {
            for point in 0..POINTS {
                let (other, share) = neighbour(y, point, height);
                for ((mixed, &a), &b) in between[1..=width].iter_mut().zip(row(y)).zip(row(other)) {
                    let (a, b) = ((a * scale).min(1.0), (b * scale).min(1.0));
                    *mixed = a + (b - a) * share;
                }
                between[0] = between[1];
                between[width + 1] = between[width];
                for point in 0..POINTS {
                    let (side, share) = neighbour(1, point, 3);
                    let sides = between[side..].iter().zip(&between[1..=width]);
                    covered += sides.filter(|&(&b, &a)| a + (b - a) * share >= cutoff).count();
                }
            }
        }
        covered as f64 / (self.values.len() * POINTS * POINTS) as f64
    }
}

/// Which texel beside texel `at` of `count` a point is mixed with, and that one's share.
fn neighbour(at: usize, point: usize, count: usize) -> (usize, f32) {
    // from the texel's middle, in texels
    let offset = (point as f32 + 0.5) / POINTS as f32 - 0.5;
    let other = if offset < 0.0 { at.saturating_sub(1) } else { (at + 1).min(count - 1) };
    (other, offset.abs())
}

/// A level with alpha scaled so that its coverage is as near to `wanted` as one scale can bring it; of
/// two scales that are equally near, the smaller.
fn with_coverage(
    level: &LinearImage,
    cutoff: f32,
    wanted: f64,
    check: &Check<'_>,
) -> Result<LinearImage, LodError> {
    // a card that is full or empty has nothing to keep
    if wanted == 0.0 || wanted == 1.0 {
        return Ok(level.clone());
    }
    let alphas = Alphas::of(level);
    // coverage never falls as the scale rises
    let (mut low, mut high) = (1.0 / MAX_SCALE, MAX_SCALE);
    for _ in 0..HALVINGS {
        check()?;
        let middle = (low * high).sqrt();
        if alphas.coverage(middle, cutoff) < wanted { low = middle } else { high = middle }
    }
    let miss = |scale: f32| (alphas.coverage(scale, cutoff) - wanted).abs();
    let scale = if miss(high) < miss(low) { high } else { low };
    let texels = level
        .texels
        .iter()
        .map(|texel| {
            // colour stays, alpha is scaled
            if texel.w > 0.0 { *texel * ((texel.w * scale).min(1.0) / texel.w) } else { *texel }
        })
        .collect();
    Ok(LinearImage { texels, ..*level })
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

    /// Sparse noise: alphas of all values, an eighth of them above one half.
    fn noise() -> Image {
        let hashes = (0..64 * 64_u32).map(|i| (i ^ (i >> 3)).wrapping_mul(2_654_435_761));
        let alpha = |hash: u32| {
            let value = (hash >> 8).to_le_bytes()[0];
            if hash >> 29 == 0 { value | 128 } else { value / 4 }
        };
        let values: Vec<u8> = hashes.map(alpha).collect();
        alphas(64, &values)
    }

    fn coverage(image: &Image) -> f64 {
        Alphas::of(&LinearImage::decoded(image)).coverage(1.0, 0.5)
    }

    #[test]
    fn coverage_is_counted_between_texels() {
        // along a row: 1, 1, 0.875, 0.625 on the full texel, then 0.375, 0.125, 0, 0
        assert_eq!(coverage(&alphas(2, &[255, 0])), 0.5, "half");
        // in the middle of empty ones a full texel covers where (1 - x)(1 - y) is one half: with
        // x and y in (0.125, 0.375) on four sides 3 of 4 points, as 0.625 * 0.625 is below
        let alone = alphas(3, &[0, 0, 0, 0, 255, 0, 0, 0, 0]);
        assert_eq!(coverage(&alone), 12.0 / (9.0 * 16.0), "less than its ninth");
    }

    #[test]
    fn tested_levels_keep_coverage() {
        // the mean fades to an eighth, and a cutoff of one half would leave nothing
        let base = noise();
        let wanted = coverage(&base);
        assert!(wanted > 0.05, "{wanted}");
        let kept = levels(base.clone(), Keep::Coverage { cutoff: 0.5 });
        let mean = levels(base, Keep::MeanAlpha);
        for level in 1..5 {
            let found = coverage(&kept[level]);
            // 8-bit storage moves what is near the cutoff; 16 texels are few to choose from
            assert!((found - wanted).abs() < 0.02, "level {level}: {found} for {wanted}");
            assert!(coverage(&mean[level]) < 0.6 * found, "level {level}: the mean is lower");
        }
    }

    #[test]
    fn levels_that_are_too_small_to_have_the_coverage_are_dropped() {
        let base = noise();
        let wanted = coverage(&base);
        let mut kept = levels(base, Keep::Coverage { cutoff: 0.5 });
        assert_eq!(coverage(&kept[6]), 0.0, "one texel, which is not there");
        drop_levels_without_coverage(&mut kept, 0.5);
        assert!((3..6).contains(&kept.len()), "{} levels", kept.len());
        for level in &kept {
            assert!((coverage(level) / wanted - 1.0).abs() <= MAX_MISS_SHARE, "all that are left");
        }
        for value in [0, 255] {
            let mut all = levels(alphas(4, &[value; 16]), Keep::Coverage { cutoff: 0.5 });
            drop_levels_without_coverage(&mut all, 0.5);
            assert_eq!(all.len(), 3, "full and empty cards keep theirs");
        }
    }

    #[test]
    fn a_picture_covers_its_mean_alpha() {
        // sparse: all below the cutoff, so that a test would show nothing
        let thin: Vec<u8> = (0..64 * 64_u32).map(|i| if i % 5 == 0 { 100 } else { 30 }).collect();
        for image in [noise(), alphas(64, &thin)] {
            let linear = LinearImage::decoded(&image);
            let mean = linear.texels.iter().map(|texel| f64::from(texel.w)).sum::<f64>() / 4096.0;
            let covering = with_mean_as_coverage(&linear, 0.5, &|| Ok(())).expect("goes on");
            let found = Alphas::of(&covering).coverage(1.0, 0.5);
            assert!((found - mean).abs() < 0.02, "{found} for {mean}");
            let before = Alphas::of(&linear).coverage(1.0, 0.5);
            assert!((before - mean).abs() > 0.05, "it was off: {before} for {mean}");
            for (a, b) in linear.texels.iter().zip(&covering.texels) {
                assert!((*a * b.w).abs_diff_eq(*b * a.w, 1e-6), "colours stay: {a} {b}");
            }
        }
        let full = LinearImage::decoded(&alphas(4, &[255; 16]));
        let same = with_mean_as_coverage(&full, 0.5, &|| Ok(())).expect("goes on");
        assert_eq!(same.texels, full.texels, "a full card has nothing to change");
    }

    #[test]
    fn full_and_empty_cards_are_left_alone() {
        for value in [0, 255] {
            let levels = levels(alphas(4, &[value; 16]), Keep::Coverage { cutoff: 0.5 });
            assert!(levels.iter().all(|l| l.texels.iter().all(|t| t[3] == value)), "all {value}");
        }
    }
}
