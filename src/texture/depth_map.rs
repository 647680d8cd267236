//! A texture of depths: mip levels of 8 or 16 bits, read between texels and between levels.
//!
//! Depths are shares of a range, 0 at its far end and 1 at its near end. A coarser level holds the mean
//! over what is there, weighted by alpha; texels that show nothing take a neighbour's depth, so that a
//! filter never mixes in a depth that nothing has.

use glam::{Vec2, Vec4};

use crate::error::LodError;
use crate::texture::dilate::{Check, dilated_as};
use crate::texture::linear::LinearImage;
use crate::texture::texture::level_pair;

/// The code of the near end, whatever the bits.
const NEAREST_CODE: f32 = 65_535.0;

/// One level: rows top to bottom.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DepthLevel {
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// 0 is the far end, 65535 the near end. With 8 bits a code is the byte twice.
    pub codes: Vec<u16>,
}

/// Levels of depths, the finest first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DepthMap {
    levels: Vec<DepthLevel>,
    bit_count: u32,
}

/// Checks how many bits a depth is to have.
///
/// # Errors
/// `depth_bits` other than 8 and 16.
pub fn check_bit_count(bit_count: u32) -> Result<(), LodError> {
    if bit_count == 8 || bit_count == 16 {
        return Ok(());
    }
    let why = format!("must be 8 or 16, got {bit_count}");
    Err(LodError::Invalid { name: "depth_bits", why })
}

/// A stored code of a share of the range.
#[inline]
pub fn encode(share: f32, bit_count: u32) -> u16 {
    let steps = if bit_count == 8 { 255.0 } else { NEAREST_CODE };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let code = (share.clamp(0.0, 1.0) * steps + 0.5) as u16;
    if bit_count == 8 { code * 257 } else { code }
}

/// Levels of a picture whose red is depth times alpha: means over what is there, dilated.
///
/// # Errors
/// Whatever `check` returns.
pub fn levels(
    base: &LinearImage,
    level_count: usize,
    bit_count: u32,
    check: &Check<'_>,
) -> Result<Vec<DepthLevel>, LodError> {
    let mut levels = Vec::with_capacity(level_count);
    let mut linear = base.clone();
    loop {
        let codes = dilated_as(&linear, check, |color, _| encode(color.x, bit_count))?;
        levels.push(DepthLevel { width: linear.width, height: linear.height, codes });
        if levels.len() >= level_count || (linear.width == 1 && linear.height == 1) {
            return Ok(levels);
        }
        linear = linear.halved();
    }
}

/// A texel of what [`levels`] takes.
pub fn texel(share: f32, alpha: f32) -> Vec4 {
    Vec4::new(share * alpha, 0.0, 0.0, alpha)
}

impl DepthMap {
    /// Freezes levels, each half as large as the one before.
    ///
    /// # Errors
    /// `depth_bits` other than 8 and 16; levels that do not fit together.
    pub fn new(levels: Vec<DepthLevel>, bit_count: u32) -> Result<Self, LodError> {
        check_bit_count(bit_count)?;
        let fits = |level: &DepthLevel| {
            level.codes.len() as u64 == u64::from(level.width) * u64::from(level.height)
        };
        let halves = |pair: &[DepthLevel]| {
            let half = |side: u32| (side / 2).max(1);
            (pair[1].width, pair[1].height) == (half(pair[0].width), half(pair[0].height))
        };
        if levels.is_empty() || !levels.iter().all(fits) || !levels.windows(2).all(halves) {
            let why = "its levels do not fit together".to_owned();
            return Err(LodError::Invalid { name: "depth", why });
        }
        Ok(Self { levels, bit_count })
    }

    /// Levels, the finest first.
    pub fn levels(&self) -> &[DepthLevel] {
        &self.levels
    }

    /// Bytes of all levels as stored.
    pub fn byte_count(&self) -> u64 {
        let texels: usize = self.levels.iter().map(|level| level.codes.len()).sum();
        texels as u64 * u64::from(self.bit_count / 8)
    }

    /// Share of the range at a level of detail, between texels and levels.
    #[inline]
    pub fn share(&self, uv: Vec2, lod: f32) -> f32 {
        let (level, mixed) = level_pair(self.levels.len(), lod);
        let fine = self.levels[level].share(uv);
        if mixed == 0.0 {
            return fine;
        }
        let coarse = self.levels[level + 1].share(uv);
        fine + (coarse - fine) * mixed
    }
}

impl DepthLevel {
    /// Between four texels, the edge's beyond it. Frames read a level several times for each sample, so
    /// this does without the steps that other wraps need.
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    fn share(&self, uv: Vec2) -> f32 {
        let (width, height) = (self.width as usize, self.height as usize);
        let at = |coordinate: f32, size: usize| {
            let scaled = (coordinate * size as f32 - 0.5).max(0.0);
            let first = (scaled as usize).min(size.saturating_sub(2));
            (first, (scaled - first as f32).min(1.0))
        };
        let ((x, fx), (y, fy)) = (at(uv.x, width), at(uv.y, height));
        // the same texel again where there is no other
        let (right, down) = (usize::from(width > 1), if height > 1 { width } else { 0 });
        let first = y.wrapping_mul(width).wrapping_add(x);
        let code = |index: usize| f32::from(self.codes[index]);
        let (a, b) = (code(first), code(first.wrapping_add(right)));
        let below = first.wrapping_add(down);
        let (c, d) = (code(below), code(below.wrapping_add(right)));
        let top = a + (b - a) * fx;
        let bottom = c + (d - c) * fx;
        (top + (bottom - top) * fy) * (1.0 / NEAREST_CODE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::texture::{Wrap, footprint};

    fn map(width: u32, texels: Vec<Vec4>, bit_count: u32) -> DepthMap {
        let height = u32::try_from(texels.len()).expect("small") / width;
        let base = LinearImage { width, height, texels };
        let levels = levels(&base, 8, bit_count, &|| Ok(())).expect("nobody stops it");
        DepthMap::new(levels, bit_count).expect("valid")
    }

    #[test]
    fn empty_texels_have_a_neighbours_depth_and_means_leave_them_out() {
        //  far  .     the far end, nothing
        //  near .     the near end but half there, nothing
        let texels = vec![texel(0.0, 1.0), Vec4::ZERO, texel(1.0, 0.5), Vec4::ZERO];
        let map = map(2, texels, 16);
        assert_eq!(map.levels()[0].codes[0], 0, "far");
        assert_eq!(map.levels()[0].codes[2], 65_535, "near");
        // (0 * 1 + 1 * 0.5) / 1.5 = 1 / 3
        assert_eq!(map.levels()[1].codes, [21_845], "a third");
        assert_eq!(map.levels()[0].codes[1], 21_845, "the mean, which is the only coarser level");
        assert_eq!(map.byte_count(), 10, "five texels of two bytes");
    }

    #[test]
    fn depths_are_read_between_texels_and_levels() {
        let map = map(2, vec![texel(0.0, 1.0), texel(1.0, 1.0)], 16);
        let at = |u: f32, lod: f32| map.share(Vec2::new(u, 0.5), lod);
        assert_eq!((at(0.0, 0.0), at(0.25, 0.0)), (0.0, 0.0), "the edge texel");
        assert_eq!((at(0.5, 0.0), at(0.75, 0.0)), (0.5, 1.0), "half way, and the other one");
        // 32768 of 65535 on the coarser level, half of it and half of 1
        assert_eq!(at(0.75, 0.5), 1.0 + (32_768.0 / 65_535.0 - 1.0) * 0.5, "between levels");
    }

    #[test]
    fn levels_of_any_size_are_read_as_textures_are() {
        for (width, height) in [(1, 1), (1, 5), (5, 1), (2, 2), (7, 4)] {
            let code = |i: u32| u16::try_from(i.wrapping_mul(40_503) % 65_536).expect("16 bits");
            let count = width * height;
            let level = DepthLevel { width, height, codes: (0..count).map(code).collect() };
            for step in 0..400_u16 {
                let uv = Vec2::new(f32::from(step % 20), f32::from(step / 20)) / 14.0 - 0.2;
                let (at, fx, fy) = footprint((width, height), [Wrap::Clamp; 2], uv);
                let [a, b, c, d] = at.map(|index| f32::from(level.codes[index]));
                let (top, bottom) = (a + (b - a) * fx, c + (d - c) * fx);
                let wanted = (top + (bottom - top) * fy) / NEAREST_CODE;
                let error = (level.share(uv) - wanted).abs();
                assert!(error < 1e-6, "{width} x {height} at {uv}: off by {error}");
            }
        }
    }

    #[test]
    fn eight_bits_are_bytes_twice() {
        assert_eq!([0.0, 0.5, 1.0].map(|share| encode(share, 8)), [0, 0x8080, 0xFFFF], "8 bits");
        assert_eq!([0.0, 0.5, 1.0].map(|share| encode(share, 16)), [0, 0x8000, 0xFFFF], "16 bits");
        assert_eq!(encode(-0.1, 16), 0, "clamped");
        let map = map(1, vec![texel(0.5, 1.0)], 8);
        assert_eq!(map.byte_count(), 1, "one byte a texel");
    }

    #[test]
    fn levels_must_fit_together() {
        let level = |width: u32| DepthLevel { width, height: 1, codes: vec![0; width as usize] };
        assert!(DepthMap::new(vec![level(4), level(2)], 16).is_ok(), "halves");
        for levels in
            [vec![], vec![level(4), level(3)], vec![DepthLevel { codes: vec![], ..level(4) }]]
        {
            let error = DepthMap::new(levels, 16).expect_err("refused").to_string();
            assert!(error.starts_with("depth:"), "{error}");
        }
        for bit_count in [0, 7, 12, 17, 32] {
            let error = DepthMap::new(vec![level(1)], bit_count).expect_err("refused").to_string();
            assert_eq!(error, format!("depth_bits: must be 8 or 16, got {bit_count}"), "by name");
        }
    }
}
