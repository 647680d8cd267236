//! How large the alpha that a filter reads near a point can be at most, so that most of what a card
//! leaves empty is known without reading its texels.
//!
//! Each level has a grid of cells of 4 x 4 texels. A cell knows the largest alpha among all texels that
//! a bilinear filter may read for points in it, on its level and on the next coarser one, if it does
//! not wrap around.

use crate::texture::texture::Image;

/// Texels a cell's side, as a power of two.
const CELL_BITS: u32 = 2;

/// Cells of every level.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct AlphaBounds {
    levels: Vec<Cells>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Cells {
    columns: u32,
    rows: u32,
    largest: Vec<u8>,
}

impl AlphaBounds {
    pub(crate) fn new(levels: &[Image]) -> Self {
        let cells = (0..levels.len()).map(|level| Cells::new(levels, level)).collect();
        Self { levels: cells }
    }

    /// Largest alpha, of 255, that a filter may read at texel coordinates of a level (of texels'
    /// corners, inside the level) or there on the next.
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    pub(crate) fn at(&self, level: usize, x: f32, y: f32) -> u8 {
        let cells = &self.levels[level];
        let column = (x as u32 >> CELL_BITS).min(cells.columns.wrapping_sub(1));
        let row = (y as u32 >> CELL_BITS).min(cells.rows.wrapping_sub(1));
        cells.largest[row.wrapping_mul(cells.columns).wrapping_add(column) as usize]
    }
}

impl Cells {
    fn new(levels: &[Image], level: usize) -> Self {
        let image = &levels[level];
        let cells = |side: u32| side.div_ceil(1 << CELL_BITS);
        let (columns, rows) = (cells(image.width), cells(image.height));
        let mut largest = Self::read(image, (columns, rows), image);
        if let Some(coarser) = levels.get(level + 1) {
            for (mine, other) in largest.iter_mut().zip(Self::read(image, (columns, rows), coarser))
            {
                *mine = (*mine).max(other);
            }
        }
        Self { columns, rows, largest }
    }

    /// The largest alpha that a filter on `read` meets, for each cell of `image`.
    fn read(image: &Image, (columns, rows): (u32, u32), read: &Image) -> Vec<u8> {
        let across = Self::ranges(image.width, columns, read.width);
        let mut rows_max = vec![0; (columns * read.height) as usize];
        let lines = read.texels.chunks_exact(read.width as usize);
        for (line, maxima) in lines.zip(rows_max.chunks_exact_mut(columns as usize)) {
            for (&(first, last), most) in across.iter().zip(maxima) {
                let texels = line[first as usize..=last as usize].iter();
                *most = texels.map(|texel| texel[3]).max().unwrap_or(0);
            }
        }
        let mut largest = Vec::with_capacity((columns * rows) as usize);
        for (first, last) in Self::ranges(image.height, rows, read.height) {
            for column in 0..columns {
                let at = |row: u32| rows_max[(row * columns + column) as usize];
                largest.push((first..=last).map(at).max().unwrap_or(0));
            }
        }
        largest
    }

    /// First and last texel on a side of `read` that a filter meets for each cell on a side of `size`:
    /// half a texel further than the cell on both sides, and one more for rounding.
    fn ranges(size: u32, cells: u32, read: u32) -> Vec<(u32, u32)> {
        let scale = f64::from(read) / f64::from(size);
        let end = |texel: u32| f64::from(texel << CELL_BITS) * scale;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let texel = |at: f64| at.clamp(0.0, f64::from(read - 1)) as u32;
        let range = |cell: u32| (texel(end(cell) - 1.5), texel(end(cell + 1) + 1.5));
        (0..cells).map(range).collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec2;
    use proptest::prelude::*;

    use super::*;
    use crate::texture::{Filter, Sampler, Texture, Wrap};

    /// A texture of any sides with few texels that are there.
    fn sparse(width: u32, height: u32, seed: u64) -> Vec<Image> {
        let (mut levels, mut state) = (Vec::new(), seed | 1);
        let (mut w, mut h) = (width, height);
        loop {
            let mut texel = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let there = state >> 60 == 0;
                [0, 0, 0, if there { state.to_be_bytes()[2] } else { 0 }]
            };
            let texels = (0..w * h).map(|_| texel()).collect();
            levels.push(Image::new(w, h, texels).expect("valid"));
            if w == 1 && h == 1 {
                return levels;
            }
            (w, h) = ((w / 2).max(1), (h / 2).max(1));
        }
    }

    #[test]
    fn empty_cells_are_empty_and_others_know_their_neighbours() {
        let mut texels = vec![[0; 4]; 16 * 16];
        // the last texel of the first cell
        texels[3 * 16 + 3] = [0, 0, 0, 200];
        let bounds = AlphaBounds::new(&[Image::new(16, 16, texels).expect("valid")]);
        assert_eq!(bounds.at(0, 0.0, 0.0), 200, "its own");
        assert_eq!(bounds.at(0, 4.1, 4.1), 200, "a filter reaches over");
        assert_eq!(bounds.at(0, 8.5, 1.0), 0, "but not so far");
        assert_eq!(bounds.at(0, 1e9, -5.0), 0, "outside is the edge");
    }

    proptest! {
        #[test]
        fn nothing_is_above_its_bound(
            width in 1_u32..70, height in 1_u32..70, seed: u64,
            points in prop::collection::vec((0.0_f32..=1.0, 0.0_f32..=1.0, -1.0_f32..8.0), 50),
        ) {
            let levels = sparse(width, height, seed);
            let bounds = AlphaBounds::new(&levels);
            let sizes: Vec<_> = levels.iter().map(|l| (l.width as f32, l.height as f32)).collect();
            let texture = Texture::new(levels).expect("halves");
            let sampler = Sampler { wrap: [Wrap::Clamp; 2], filter: Filter::Trilinear };
            for (u, v, lod) in points {
                let level = texture.level_pair(lod).0;
                let most = bounds.at(level, u * sizes[level].0, v * sizes[level].1);
                let alpha = texture.alpha(sampler, Vec2::new(u, v), lod) * 255.0;
                // rounding of a mean of 8 texels
                prop_assert!(alpha <= f32::from(most) + 1e-3, "{alpha} above {most}");
            }
        }
    }
}
