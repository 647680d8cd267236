//! A texture: mip levels of 8-bit sRGB texels with straight alpha, and how they are read.
//!
//! Filtering is linear and premultiplied. Texel centres lie at half-integers; v = 0 is the top row.
//! A sample's colour comes back premultiplied and linear.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{Vec2, Vec4};

use crate::error::{LodError, check_in, check_limit};
use crate::texture::alpha_bounds::AlphaBounds;
use crate::texture::srgb::LINEAR_FROM_SRGB8;

/// Largest side of a texture.
pub const MAX_TEXTURE_SIDE: u32 = 16384;

/// Largest number of texels of one level: 256 MiB of RGBA8.
pub const MAX_TEXEL_COUNT: u64 = 1 << 26;

/// Larger textures are decoded as they are read: 2048 x 2048 decoded are 64 MiB.
pub const MAX_DECODED_TEXEL_COUNT: usize = 1 << 22;

/// What a texture coordinate outside [0, 1] reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Wrap {
    /// The texture again.
    #[default]
    Repeat,
    /// The texture mirrored at every edge.
    Mirror,
    /// The edge texel.
    Clamp,
}

/// How texels are combined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Filter {
    /// The nearest texel of level 0.
    Nearest,
    /// Four texels of level 0.
    #[default]
    Bilinear,
    /// Four texels of each of the two levels nearest to one texel a pixel.
    Trilinear,
}

/// Wrap mode of each axis, and the filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct Sampler {
    /// For u and v.
    pub wrap: [Wrap; 2],
    /// Within and between levels.
    pub filter: Filter,
}

/// One level: rows top to bottom, RGBA, sRGB with straight alpha.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` texels.
    pub texels: Vec<[u8; 4]>,
}

impl Image {
    /// Checks the size against the texels.
    ///
    /// # Errors
    /// If a side is 0 or above [`MAX_TEXTURE_SIDE`], or the texel count does not fit.
    pub fn new(width: u32, height: u32, texels: Vec<[u8; 4]>) -> Result<Self, LodError> {
        check_size("texture", width, height)?;
        if texels.len() as u64 != u64::from(width) * u64::from(height) {
            let why = format!("{} texels for {width} x {height}", texels.len());
            return Err(LodError::Invalid { name: "texture", why });
        }
        Ok(Self { width, height, texels })
    }

    /// The texel at a column and row inside the image.
    #[inline]
    pub fn texel(&self, x: u32, y: u32) -> [u8; 4] {
        self.texels[y as usize * self.width as usize + x as usize]
    }
}

/// Checks a texture's size before anything is allocated for it.
///
/// # Errors
/// [`LodError::OutOfRange`] or [`LodError::Limit`] under `name`.
pub fn check_size(name: &'static str, width: u32, height: u32) -> Result<(), LodError> {
    check_in(name, width, 1..=MAX_TEXTURE_SIDE)?;
    check_in(name, height, 1..=MAX_TEXTURE_SIDE)?;
    check_limit(name, u64::from(width) * u64::from(height), MAX_TEXEL_COUNT, "texels")
}

/// An immutable texture with an id that no other texture of this process has.
#[derive(Debug, Clone)]
pub struct Texture {
    id: u64,
    levels: Vec<Image>,
    /// The levels' texels decoded, for textures that are read often: the same numbers, sooner.
    decoded: Vec<Vec<Vec4>>,
    alpha_bounds: Option<AlphaBounds>,
    byte_count: u64,
}

impl Texture {
    /// A texture from its levels, finest first; each level halves the last, rounded down, to 1.
    ///
    /// # Errors
    /// [`LodError::Invalid`] if there is no level or a level has another size than it should.
    pub fn new(levels: Vec<Image>) -> Result<Arc<Self>, LodError> {
        let byte_count = levels.iter().map(|level| level.texels.len() as u64 * 4).sum();
        Self::with_byte_count(levels, byte_count)
    }

    /// As [`Texture::new`], for texels that were expanded from a smaller stored format.
    ///
    /// # Errors
    /// As [`Texture::new`].
    pub fn with_byte_count(levels: Vec<Image>, byte_count: u64) -> Result<Arc<Self>, LodError> {
        static NEXT_ID: AtomicU64 = AtomicU64::new(0);
        let Some(first) = levels.first() else {
            return Err(LodError::Empty { name: "texture", why: "it has no level" });
        };
        let mut size = (first.width, first.height);
        for level in &levels {
            if (level.width, level.height) != size {
                let why = format!(
                    "a level is {} x {} where {} x {} is due",
                    level.width, level.height, size.0, size.1
                );
                return Err(LodError::Invalid { name: "texture", why });
            }
            size = ((size.0 / 2).max(1), (size.1 / 2).max(1));
        }
        let id = NEXT_ID.fetch_add(1, Ordering::Relaxed);
        let (decoded, alpha_bounds) = (Vec::new(), None);
        Ok(Arc::new(Self { id, levels, decoded, alpha_bounds, byte_count }))
    }

    /// The same texture with its texels decoded ahead, unless it is larger than
    /// [`MAX_DECODED_TEXEL_COUNT`]: the same numbers, sooner, for four times the memory.
    #[must_use]
    pub fn decoded_ahead(self: Arc<Self>) -> Arc<Self> {
        let too_large = self.levels[0].texels.len() > MAX_DECODED_TEXEL_COUNT;
        if too_large || !self.decoded.is_empty() {
            return self;
        }
        let decode_level = |level: &Image| level.texels.iter().map(|&t| decode(t)).collect();
        let decoded = self.levels.iter().map(decode_level).collect();
        Arc::new(Self { decoded, ..Arc::unwrap_or_clone(self) })
    }

    /// The same texture, ready to be tested against its alpha often.
    #[must_use]
    pub fn bounded(self: Arc<Self>) -> Arc<Self> {
        if self.alpha_bounds.is_some() {
            return self;
        }
        let alpha_bounds = Some(AlphaBounds::new(&self.levels));
        Arc::new(Self { alpha_bounds, ..Arc::unwrap_or_clone(self) })
    }

    /// What [`Texture::bounded`] made ready.
    pub(crate) fn alpha_bounds(&self) -> Option<&AlphaBounds> {
        self.alpha_bounds.as_ref()
    }

    /// Unique in this process; the cache key of a renderer.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// Levels, finest first.
    pub fn levels(&self) -> &[Image] {
        &self.levels
    }

    /// Width and height of level 0.
    pub fn size(&self) -> (u32, u32) {
        (self.levels[0].width, self.levels[0].height)
    }

    /// Bytes of all levels in the format they are stored in.
    pub fn byte_count(&self) -> u64 {
        self.byte_count
    }

    /// Alpha alone, at a level of detail (ignored unless trilinear); cheaper than the colour.
    #[inline]
    pub fn alpha(&self, sampler: Sampler, uv: Vec2, lod: f32) -> f32 {
        match sampler.filter {
            Filter::Nearest => f32::from(nearest(&self.levels[0], sampler.wrap, uv)[3]) / 255.0,
            Filter::Bilinear => bilinear_alpha(&self.levels[0], sampler.wrap, uv),
            Filter::Trilinear => {
                let (level, share) = self.level_pair(lod);
                let fine = bilinear_alpha(&self.levels[level], sampler.wrap, uv);
                if share == 0.0 {
                    return fine;
                }
                let coarse = bilinear_alpha(&self.levels[level + 1], sampler.wrap, uv);
                fine + (coarse - fine) * share
            }
        }
    }

    /// Premultiplied linear colour, at a level of detail (ignored unless trilinear).
    #[inline]
    pub fn sample(&self, sampler: Sampler, uv: Vec2, lod: f32) -> Vec4 {
        match sampler.filter {
            Filter::Nearest => decode(nearest(&self.levels[0], sampler.wrap, uv)),
            Filter::Bilinear => self.bilinear(0, sampler.wrap, uv),
            Filter::Trilinear => {
                let (level, share) = self.level_pair(lod);
                let fine = self.bilinear(level, sampler.wrap, uv);
                if share == 0.0 {
                    return fine;
                }
                let coarse = self.bilinear(level + 1, sampler.wrap, uv);
                fine + (coarse - fine) * share
            }
        }
    }

    /// Four texels of a level, mixed.
    #[inline]
    fn bilinear(&self, level: usize, wrap: [Wrap; 2], uv: Vec2) -> Vec4 {
        let image = &self.levels[level];
        let (at, fx, fy) = footprint((image.width, image.height), wrap, uv);
        let [a, b, c, d] = match self.decoded.get(level) {
            Some(decoded) => [decoded[at[0]], decoded[at[1]], decoded[at[2]], decoded[at[3]]],
            None => at.map(|index| decode(image.texels[index])),
        };
        let top = a + (b - a) * fx;
        let bottom = c + (d - c) * fx;
        top + (bottom - top) * fy
    }

    /// The finer of the two levels to mix and the share of the coarser one.
    #[inline]
    pub(crate) fn level_pair(&self, lod: f32) -> (usize, f32) {
        level_pair(self.levels.len(), lod)
    }
}

/// The finer of the two of so many levels to mix and the share of the coarser one.
#[inline]
pub(crate) fn level_pair(level_count: usize, lod: f32) -> (usize, f32) {
    let last = level_count - 1;
    let clamped = lod.clamp(0.0, last as f32);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let level = clamped as usize;
    if level >= last { (last, 0.0) } else { (level, clamped - level as f32) }
}

/// Premultiplied linear colour of a stored texel.
#[inline]
pub fn decode(texel: [u8; 4]) -> Vec4 {
    let table = &*LINEAR_FROM_SRGB8;
    let alpha = f32::from(texel[3]) * (1.0 / 255.0);
    let [r, g, b] = [texel[0], texel[1], texel[2]].map(|code| table[usize::from(code)] * alpha);
    Vec4::new(r, g, b, alpha)
}

/// A texel index inside `0..size` for any integer.
fn wrap_index(index: i32, size: u32, wrap: Wrap) -> usize {
    let (index, size) = (i64::from(index), i64::from(size));
    let inside = match wrap {
        Wrap::Repeat => index.rem_euclid(size),
        Wrap::Clamp => index.clamp(0, size - 1),
        Wrap::Mirror => {
            let folded = index.rem_euclid(2 * size);
            folded.min(2 * size - 1 - folded)
        }
    };
    usize::try_from(inside).expect("inside the texture")
}

/// A texel index and the next one, both inside `0..size`.
#[inline]
pub(crate) fn wrap_pair(index: i32, size: u32, wrap: Wrap) -> (usize, usize) {
    let first = index.cast_unsigned();
    if first < size - 1 {
        return (first as usize, first as usize + 1);
    }
    (wrap_index(index, size, wrap), wrap_index(index.saturating_add(1), size, wrap))
}

/// Texel coordinate of a texture coordinate, floored, with the fraction left over.
#[inline]
fn split(coordinate: f32, size: u32, shift: f32) -> (i32, f32) {
    let scaled = coordinate * size as f32 - shift;
    let index = floor_to_i32(scaled);
    (index, scaled - index as f32)
}

/// The next integer below; saturates. Quicker than `floor` where the processor has no such
/// instruction, as on the baseline that wheels are built for.
#[inline]
pub(crate) fn floor_to_i32(value: f32) -> i32 {
    #[expect(clippy::cast_possible_truncation, reason = "saturates")]
    let toward_zero = value as i32;
    toward_zero.saturating_sub(i32::from(toward_zero as f32 > value))
}

#[inline]
fn nearest(image: &Image, wrap: [Wrap; 2], uv: Vec2) -> [u8; 4] {
    let x = wrap_index(split(uv.x, image.width, 0.0).0, image.width, wrap[0]);
    let y = wrap_index(split(uv.y, image.height, 0.0).0, image.height, wrap[1]);
    image.texels[y * image.width as usize + x]
}

/// Indices of the four texels around a coordinate and the weights of the right and lower ones.
#[inline(always)]
pub(crate) fn footprint(
    (width, height): (u32, u32),
    wrap: [Wrap; 2],
    uv: Vec2,
) -> ([usize; 4], f32, f32) {
    let (x, fx) = split(uv.x, width, 0.5);
    let (y, fy) = split(uv.y, height, 0.5);
    let (x0, x1) = wrap_pair(x, width, wrap[0]);
    let (y0, y1) = wrap_pair(y, height, wrap[1]);
    let (row0, row1) = (y0 * width as usize, y1 * width as usize);
    ([row0 + x0, row0 + x1, row1 + x0, row1 + x1], fx, fy)
}

#[inline]
fn bilinear_alpha(image: &Image, wrap: [Wrap; 2], uv: Vec2) -> f32 {
    let (at, fx, fy) = footprint((image.width, image.height), wrap, uv);
    let alpha = |corner: usize| f32::from(image.texels[at[corner]][3]);
    let (a, b, c, d) = (alpha(0), alpha(1), alpha(2), alpha(3));
    let top = a + (b - a) * fx;
    let bottom = c + (d - c) * fx;
    (top + (bottom - top) * fy) * (1.0 / 255.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLAMP: [Wrap; 2] = [Wrap::Clamp; 2];

    /// Alphas of a one-row texture.
    fn row(alphas: &[u8]) -> Image {
        let width = u32::try_from(alphas.len()).expect("short");
        Image::new(width, 1, alphas.iter().map(|&a| [255, 255, 255, a]).collect()).expect("valid")
    }

    #[test]
    fn texel_centres_lie_at_half_integers() {
        //  | 0 | 255 |   centres at u = 0.25 and 0.75
        let texture = Texture::new(vec![row(&[0, 255])]).expect("valid");
        let sampler = Sampler { wrap: CLAMP, filter: Filter::Bilinear };
        for (u, alpha) in [(0.0, 0.0), (0.25, 0.0), (0.5, 0.5), (0.75, 1.0), (1.0, 1.0)] {
            assert_eq!(texture.alpha(sampler, Vec2::new(u, 0.5), 0.0), alpha, "u = {u}");
            assert_eq!(texture.sample(sampler, Vec2::new(u, 0.5), 0.0).w, alpha, "u = {u}");
        }
        let sampler = Sampler { wrap: CLAMP, filter: Filter::Nearest };
        assert_eq!(texture.alpha(sampler, Vec2::new(0.49, 0.5), 0.0), 0.0, "left texel");
        assert_eq!(texture.alpha(sampler, Vec2::new(0.51, 0.5), 0.0), 1.0, "right texel");
    }

    #[test]
    fn wrap_modes_fold_any_index() {
        let fold = |wrap| (-4..7).map(|i| wrap_index(i, 3, wrap)).collect::<Vec<_>>();
        assert_eq!(fold(Wrap::Repeat), [2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0], "abc abc");
        assert_eq!(fold(Wrap::Clamp), [0, 0, 0, 0, 0, 1, 2, 2, 2, 2, 2], "aaa abc ccc");
        assert_eq!(fold(Wrap::Mirror), [2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0], "cba abc cba");
    }

    #[test]
    fn filtering_is_premultiplied() {
        // a transparent red texel must not bleed into its opaque black neighbour
        let image = Image::new(2, 1, vec![[255, 0, 0, 0], [0, 0, 0, 255]]).expect("valid");
        let texture = Texture::new(vec![image]).expect("valid");
        let sampler = Sampler { wrap: CLAMP, filter: Filter::Bilinear };
        let half = texture.sample(sampler, Vec2::new(0.5, 0.5), 0.0);
        assert_eq!(half, Vec4::new(0.0, 0.0, 0.0, 0.5), "half covered, black");
    }

    #[test]
    fn trilinear_mixes_two_levels() {
        let texture = Texture::new(vec![row(&[255, 255]), row(&[0])]).expect("valid");
        let sampler = Sampler { wrap: CLAMP, filter: Filter::Trilinear };
        for (lod, alpha) in [(-3.0, 1.0), (0.0, 1.0), (0.25, 0.75), (1.0, 0.0), (9.0, 0.0)] {
            assert_eq!(texture.alpha(sampler, Vec2::splat(0.5), lod), alpha, "lod {lod}");
            assert_eq!(texture.sample(sampler, Vec2::splat(0.5), lod).w, alpha, "lod {lod}");
        }
    }

    #[test]
    fn sizes_are_checked() {
        assert!(Image::new(0, 1, vec![]).is_err(), "0 texels wide");
        assert!(Image::new(2, 1, vec![[0; 4]]).is_err(), "one texel short");
        assert!(check_size("resolution", 16384, 16384).is_err(), "1 GiB");
        assert!(Texture::new(vec![row(&[0; 4]), row(&[0; 3])]).is_err(), "4 halves to 2");
    }
}
