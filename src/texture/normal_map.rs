//! A texture of normals: mip levels of 8 bits a component, read between texels and between levels.
//!
//! Beside the normal, which points to the picture's viewer, a texel says which share of it is leaves:
//! they let light through. All are means over what is there, weighted by alpha: a mean of normals that
//! disagree is short, which says how much they do. Texels that show nothing take a neighbour's normal,
//! so that a filter never mixes in one that nothing has.

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles};

use crate::error::LodError;
use crate::texture::dilate::{Check, dilated_as};
use crate::texture::linear::LinearImage;
use crate::texture::srgb::unorm8;
use crate::texture::texture::{Image, Wrap, footprint, level_pair};

/// Levels of normals, the finest first: components from -1 to 1 on 0 to 255, and the share of leaves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NormalMap {
    levels: Vec<Image>,
}

/// A texel of what [`levels`] takes, of a mean normal times alpha.
pub fn texel(normal: Vec3, alpha: f32) -> Vec4 {
    (normal * 0.5 + 0.5 * alpha).extend(alpha)
}

/// Levels of pictures of normals, as [`texel`] makes them, and of the share of leaves in red, times
/// alpha.
///
/// # Errors
/// Whatever `check` returns.
pub fn levels(
    normals: &LinearImage,
    leaf_shares: &LinearImage,
    level_count: usize,
    check: &Check<'_>,
) -> Result<Vec<Image>, LodError> {
    let mut levels = Vec::with_capacity(level_count);
    let (mut normals, mut shares) = (normals.clone(), leaf_shares.clone());
    loop {
        let means = dilated_as(&normals, check, |mean, _| mean.to_array().map(unorm8))?;
        let shares_here = dilated_as(&shares, check, |share, _| unorm8(share.x))?;
        let texels = means.iter().zip(shares_here).map(|(&[x, y, z], share)| [x, y, z, share]);
        levels.push(Image {
            width: normals.width,
            height: normals.height,
            texels: texels.collect(),
        });
        if levels.len() >= level_count || (normals.width == 1 && normals.height == 1) {
            return Ok(levels);
        }
        (normals, shares) = (normals.halved(), shares.halved());
    }
}

impl NormalMap {
    /// Freezes levels, each half as large as the one before.
    ///
    /// # Errors
    /// Levels that do not fit together.
    pub fn new(levels: Vec<Image>) -> Result<Self, LodError> {
        let fits = |level: &Image| {
            level.texels.len() as u64 == u64::from(level.width) * u64::from(level.height)
        };
        let halves = |pair: &[Image]| {
            let half = |side: u32| (side / 2).max(1);
            (pair[1].width, pair[1].height) == (half(pair[0].width), half(pair[0].height))
        };
        if levels.is_empty() || !levels.iter().all(fits) || !levels.windows(2).all(halves) {
            let why = "its levels do not fit together".to_owned();
            return Err(LodError::Invalid { name: "normal", why });
        }
        Ok(Self { levels })
    }

    /// Levels, the finest first.
    pub fn levels(&self) -> &[Image] {
        &self.levels
    }

    /// Bytes of all levels as stored.
    pub fn byte_count(&self) -> u64 {
        self.levels.iter().map(|level| 4 * level.texels.len() as u64).sum()
    }

    /// Mean normal, as long as normals agree, and share of leaves at a level of detail, between texels
    /// and levels.
    #[inline]
    pub fn at(&self, uv: Vec2, lod: f32) -> (Vec3, f32) {
        let (level, mixed) = level_pair(self.levels.len(), lod);
        let fine = between(&self.levels[level], uv);
        let found = if mixed == 0.0 {
            fine
        } else {
            fine + (between(&self.levels[level + 1], uv) - fine) * mixed
        };
        (found.xyz(), found.w)
    }
}

#[inline]
fn between(image: &Image, uv: Vec2) -> Vec4 {
    let (at, fx, fy) = footprint((image.width, image.height), [Wrap::Clamp; 2], uv);
    let [a, b, c, d] = at.map(|index| decode(image.texels[index]));
    let top = a + (b - a) * fx;
    let bottom = c + (d - c) * fx;
    top + (bottom - top) * fy
}

/// A stored normal and share.
#[inline]
pub fn decode([x, y, z, share]: [u8; 4]) -> Vec4 {
    let part = |code: u8| f32::from(code) * (2.0 / 255.0) - 1.0;
    Vec4::new(part(x), part(y), part(z), f32::from(share) * (1.0 / 255.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of normals with the shares of leaves, all opaque but those without a normal.
    fn map(row: &[Option<(Vec3, f32)>]) -> NormalMap {
        let width = u32::try_from(row.len()).expect("small");
        let image = |texels| LinearImage { width, height: 1, texels };
        let normals = row.iter().map(|at| at.map_or(Vec4::ZERO, |(normal, _)| texel(normal, 1.0)));
        let share = |at: &Option<(Vec3, f32)>| {
            at.map_or(Vec4::ZERO, |(_, share)| Vec4::new(share, 0.0, 0.0, 1.0))
        };
        let shares = image(row.iter().map(share).collect());
        let levels = levels(&image(normals.collect()), &shares, 8, &|| Ok(()));
        NormalMap::new(levels.expect("nobody stops it")).expect("valid")
    }

    #[test]
    fn levels_are_means_over_what_is_there() {
        let map = map(&[Some((Vec3::X, 1.0)), Some((Vec3::Y, 0.0)), Some((Vec3::Z, 1.0)), None]);
        let first = [[255, 128, 128, 255], [128, 255, 128, 0], [128, 128, 255, 255]];
        assert_eq!(map.levels()[0].texels[..3], first, "127.5 is rounded up");
        assert_eq!(map.levels()[0].texels[3], first[2], "nothing there: the neighbour's");
        // x and y by halves: 0.75 is 191.25 of 255
        assert_eq!(map.levels()[1].texels, [[191, 191, 128, 128], first[2]], "half as fine");
        assert_eq!(map.byte_count(), 4 * (4 + 2 + 1), "four bytes a texel");
    }

    #[test]
    fn normals_are_read_between_texels_and_levels() {
        let map = map(&[Some((Vec3::X, 1.0)), Some((Vec3::Y, 0.0))]);
        let close = |uv: f32, lod: f32, wanted: Vec3, share: f32| {
            let (normal, found) = map.at(Vec2::new(uv, 0.5), lod);
            // half a code is 0.004
            let is = (normal - wanted).length() < 0.008 && (found - share).abs() < 0.004;
            assert!(is, "at {uv}, level {lod}: {normal}, {found}");
        };
        let half = Vec3::new(0.5, 0.5, 0.0);
        close(0.0, 0.0, Vec3::X, 1.0);
        close(0.75, 0.0, Vec3::Y, 0.0);
        close(0.5, 0.0, half, 0.5);
        close(0.1, 1.0, half, 0.5);
        close(0.25, 0.5, (Vec3::X + half) * 0.5, 0.75);
    }

    #[test]
    fn levels_must_fit_together() {
        let level =
            |width: u32, count: usize| Image { width, height: 1, texels: vec![[0; 4]; count] };
        assert!(NormalMap::new(vec![level(4, 4), level(2, 2)]).is_ok(), "halves");
        for bad in [vec![], vec![level(4, 4), level(3, 3)], vec![level(4, 3)]] {
            assert!(NormalMap::new(bad).is_err(), "refused");
        }
    }
}
