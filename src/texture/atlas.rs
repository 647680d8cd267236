//! Many cards' textures in one: where each lies, and how their levels stay apart.
//!
//! Cards stand on a grid of cells as wide as a texel of the coarsest level, with an empty cell between
//! any two. So no texel of any level mixes two cards, and a filter that reaches over a card's edge
//! reads texels without alpha, which count for nothing. Shelves are filled by falling height; the
//! width that leaves least empty is taken. For cards of one size that is a full grid.
//!
//! This work is based on:
//! E. G. Coffman, M. R. Garey, D. S. Johnson, R. E. Tarjan. Performance bounds for level-oriented
//! two-dimensional packing algorithms. 1980 (next-fit decreasing height)

use glam::Vec4;

use crate::error::{LodError, check_in, check_limit};
use crate::texture::linear::LinearImage;
use crate::texture::texture::{Image, MAX_TEXEL_COUNT, MAX_TEXTURE_SIDE, check_size};

/// The empty border between cards takes at most this share of a card's side.
const BORDER_SHARE: f64 = 1.0 / 16.0;

/// Levels at most: the coarsest has texels of 64.
const MAX_LEVEL_COUNT: u32 = 7;

/// Widths that are tried between the narrowest and the widest.
const WIDTH_COUNT: u32 = 96;

/// Where cards lie in a texture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Atlas {
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Levels that keep the cards apart.
    pub level_count: usize,
    /// Upper left texel of each card.
    pub places: Vec<[u32; 2]>,
    sizes: Vec<(u32, u32)>,
}

impl Atlas {
    /// Places cards of the given sizes, in texels.
    ///
    /// # Errors
    /// [`LodError::Empty`] without cards; under `name`, if a card has no texels or the cards do not
    /// fit into one texture.
    pub fn new(name: &'static str, sizes: &[(u32, u32)]) -> Result<Self, LodError> {
        if sizes.is_empty() {
            return Err(LodError::Empty { name, why: "an atlas needs a card" });
        }
        Self::with_levels(name, sizes, level_count(sizes))
    }

    /// As [`Atlas::new`], for a number of levels: the border is a texel of the coarsest.
    ///
    /// # Errors
    /// As [`Atlas::new`].
    pub fn with_levels(
        name: &'static str,
        sizes: &[(u32, u32)],
        level_count: u32,
    ) -> Result<Self, LodError> {
        if sizes.is_empty() {
            return Err(LodError::Empty { name, why: "an atlas needs a card" });
        }
        check_in("level_count", level_count, 1..=MAX_LEVEL_COUNT)?;
        for &(width, height) in sizes {
            check_size(name, width, height)?;
        }
        let cell = 1_u64 << (level_count - 1);
        // a card's cells, with the empty one to its right and below
        let cells: Vec<[u64; 2]> = sizes
            .iter()
            .map(|&(width, height)| [width, height].map(|side| u64::from(side).div_ceil(cell) + 1))
            .collect();
        let mut order: Vec<usize> = (0..sizes.len()).collect();
        order.sort_by_key(|&card| std::cmp::Reverse([cells[card][1], cells[card][0]]));
        let widest = cells.iter().map(|card| card[0]).max().expect("not empty");
        let total: u64 = cells.iter().map(|card| card[0] * card[1]).sum();
        let best = widths(widest, total)
            .map(|width| (shelves(&cells, &order, width).0, width))
            .filter(|&(height, width)| (height.max(width) + 1) * cell <= MAX_TEXTURE_SIDE.into())
            .min_by_key(|&(height, width)| (height * width, height.max(width), width));
        let Some((height, width)) = best else {
            // too large altogether, or a card that is as long as a texture with its borders
            let asked = (total * cell * cell).max(MAX_TEXEL_COUNT + 1);
            return Err(LodError::Limit { name, asked, limit: MAX_TEXEL_COUNT, unit: "texels" });
        };
        let sides = [width, height].map(|side| u32::try_from((side + 1) * cell).expect("filtered"));
        check_limit(name, u64::from(sides[0]) * u64::from(sides[1]), MAX_TEXEL_COUNT, "texels")?;
        let (_, places) = shelves(&cells, &order, width);
        let to_texel = |at: u64| u32::try_from((at + 1) * cell).expect("inside the texture");
        Ok(Self {
            width: sides[0],
            height: sides[1],
            level_count: level_count as usize,
            places: places.into_iter().map(|place| place.map(to_texel)).collect(),
            sizes: sizes.to_vec(),
        })
    }

    /// Share of the texture that cards cover.
    pub fn fill(&self) -> f64 {
        let area = |&(width, height): &(u32, u32)| f64::from(width) * f64::from(height);
        self.sizes.iter().map(area).sum::<f64>() / (f64::from(self.width) * f64::from(self.height))
    }

    /// A card's picture on whole cells, its border included, with nothing in what is added.
    ///
    /// The picture may have a whole number of times the card's texels on each side; so has the result.
    pub fn padded(&self, card: usize, picture: &LinearImage) -> LinearImage {
        let (width, height) = self.sizes[card];
        let finer = picture.width / width;
        let sides = (width * finer, height * finer);
        assert_eq!((picture.width, picture.height), sides, "a multiple of the card's own size");
        let cell = 1_u32 << (self.level_count - 1);
        let [wide, high] = [width, height].map(|side| (side.div_ceil(cell) + 1) * cell * finer);
        let mut texels = vec![Vec4::ZERO; wide as usize * high as usize];
        let rows = picture.texels.chunks_exact(picture.width as usize);
        for (to, from) in texels.chunks_exact_mut(wide as usize).zip(rows) {
            to[..from.len()].copy_from_slice(from);
        }
        LinearImage { width: wide, height: high, texels }
    }

    /// Empty levels, finest first.
    pub fn levels(&self) -> Vec<Image> {
        (0..self.level_count)
            .map(|level| {
                let (width, height) = (self.width >> level, self.height >> level);
                Image { width, height, texels: vec![[0; 4]; width as usize * height as usize] }
            })
            .collect()
    }

    /// Puts a card's levels, made from what [`Atlas::padded`] gives, into the atlas's.
    pub fn put(&self, card: usize, from: &[Image], levels: &mut [Image]) {
        for (level, (to, from)) in levels.iter_mut().zip(from).enumerate() {
            self.put_level(card, level, &from.texels, from.width, &mut to.texels);
        }
    }

    /// Puts one level of a card, `width` texels a row, into the same level of an atlas of any texels.
    pub fn put_level<T: Copy>(
        &self,
        card: usize,
        level: usize,
        from: &[T],
        width: u32,
        to: &mut [T],
    ) {
        let [x, y] = self.places[card].map(|at| (at >> level) as usize);
        for (row, texels) in (y..).zip(from.chunks_exact(width as usize)) {
            let start = row * (self.width >> level) as usize + x;
            to[start..start + texels.len()].copy_from_slice(texels);
        }
    }

    /// A point of a card, both coordinates in [0, 1] from its upper left, in the atlas.
    pub fn uv(&self, card: usize, [u, v]: [f64; 2]) -> [f64; 2] {
        let ([x, y], (width, height)) = (self.places[card], self.sizes[card]);
        [
            (f64::from(x) + u * f64::from(width)) / f64::from(self.width),
            (f64::from(y) + v * f64::from(height)) / f64::from(self.height),
        ]
    }
}

/// As many levels as keep the border within its share of a card of mean size.
fn level_count(sizes: &[(u32, u32)]) -> u32 {
    let areas = sizes.iter().map(|&(width, height)| f64::from(width) * f64::from(height));
    let side = (areas.sum::<f64>() / sizes.len() as f64).sqrt();
    (1..MAX_LEVEL_COUNT)
        .take_while(|&level| f64::from(1_u32 << level) <= side * BORDER_SHARE)
        .last()
        .map_or(1, |level| level + 1)
}

/// Widths to try, in cells: around the side of a square of the same area.
fn widths(widest: u64, total: u64) -> impl Iterator<Item = u64> {
    let side = total.isqrt().max(1);
    let (low, high) = ((side * 5 / 8).max(widest), (side * 8 / 5 + 1).max(widest));
    let step = ((high - low) / u64::from(WIDTH_COUNT)).max(1);
    (low..=high).step_by(usize::try_from(step).expect("a few thousand"))
}

/// Height in cells, and each card's place, if cards are put on shelves of a width in an order.
fn shelves(cells: &[[u64; 2]], order: &[usize], width: u64) -> (u64, Vec<[u64; 2]>) {
    let mut places = vec![[0; 2]; cells.len()];
    let (mut x, mut y, mut shelf) = (0, 0, 0);
    for &card in order {
        let [wide, high] = cells[card];
        if x + wide > width {
            (x, y, shelf) = (0, y + shelf, 0);
        }
        if shelf == 0 {
            shelf = high;
        }
        places[card] = [x, y];
        x += wide;
    }
    (y + shelf, places)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::texture::mips::{self, Keep};

    #[test]
    fn cards_of_one_size_fill_a_grid() {
        let atlas = Atlas::new("resolution", &[(64, 64); 12]).expect("fits");
        // borders of 4 texels, on the left and on top as well
        assert_eq!(
            (atlas.level_count, atlas.width, atlas.height),
            (3, 3 * 68 + 4, 4 * 68 + 4),
            "3 x 4"
        );
        assert_eq!(atlas.places[..2], [[4, 4], [72, 4]], "in order");
        assert!(
            (atlas.fill() - 12.0 * 4096.0 / (276.0 * 208.0)).abs() < 1e-12,
            "the rest is border"
        );
        assert_eq!(
            atlas.uv(1, [0.5, 1.0]),
            [(72.0 + 32.0) / 208.0, 68.0 / 276.0],
            "middle of its foot"
        );
    }

    #[test]
    fn one_texel_and_the_largest_texture() {
        let one = Atlas::new("resolution", &[(1, 1)]).expect("fits");
        assert_eq!((one.width, one.height, one.level_count), (3, 3, 1), "a border all around");
        for (sizes, what) in [(vec![(8192, 8192)], "itself"), (vec![(4096, 4096); 5], "together")] {
            let text = Atlas::new("resolution", &sizes).expect_err("too large").to_string();
            assert!(text.starts_with("resolution"), "{what}: {text}");
        }
        // a card with its borders is longer than a texture, though its area is small
        let long = Atlas::new("texels_per_metre", &[(16_384, 180), (3500, 3500)]);
        assert!(long.is_err(), "too long");
        assert!(Atlas::new("resolution", &[]).is_err(), "no card");
        assert!(Atlas::new("resolution", &[(4, 0)]).is_err(), "no texel");
    }

    #[test]
    fn levels_of_cards_stay_apart() {
        // red beside green: no level of either knows the other
        let sizes = [(64, 48), (40, 64)];
        let atlas = Atlas::new("resolution", &sizes).expect("fits");
        let mut levels = atlas.levels();
        for (card, (&(width, height), color)) in sizes.iter().zip([Vec4::X, Vec4::Y]).enumerate() {
            let count = width as usize * height as usize;
            let picture = LinearImage { width, height, texels: vec![color + Vec4::W; count] };
            let check = || Ok(());
            let base = crate::texture::dilate::dilated(&atlas.padded(card, &picture), &check);
            let made = mips::levels(base.expect("runs"), Keep::MeanAlpha, &check).expect("runs");
            atlas.put(card, &made, &mut levels);
        }
        for (number, level) in levels.iter().enumerate() {
            let cell = 1 << number;
            for (card, &(width, height)) in sizes.iter().enumerate() {
                let [x, y] = atlas.places[card].map(|at| at / cell);
                let color = [[255, 0, 0, 255], [0, 255, 0, 255]][card];
                let texel = level.texel(x + width / cell - 1, y + height / cell - 1);
                assert_eq!(texel, color, "level {number}, card {card}");
                // beside it, above it, below it
                for (x, y) in
                    [(x - 1, y), (x, y - 1), (x + width / cell, y), (x, y + height / cell)]
                {
                    assert_eq!(level.texel(x, y)[3], 0, "level {number}, card {card}: ({x}, {y})");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn cards_do_not_meet(sizes in prop::collection::vec((1_u32..300, 1_u32..300), 1..60)) {
            let atlas = Atlas::new("resolution", &sizes).expect("fits");
            let cell = 1 << (atlas.level_count - 1);
            // each card with its border, in cells
            let mut taken = std::collections::BTreeSet::new();
            for (&[x, y], &(width, height)) in atlas.places.iter().zip(&sizes) {
                prop_assert_eq!((x % cell, y % cell), (0, 0), "on the grid");
                prop_assert!(x >= cell && x + width <= atlas.width);
                prop_assert!(y >= cell && y + height <= atlas.height);
                for column in x / cell..(x + width).div_ceil(cell) + 1 {
                    for row in y / cell..(y + height).div_ceil(cell) + 1 {
                        prop_assert!(taken.insert((column, row)), "a cell taken twice");
                    }
                }
            }
        }
    }
}
