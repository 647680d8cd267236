//! Which squares of a picture are empty: they need neither be stored nor drawn.
//!
//! A square is kept whole if each of its quarters is, thrown away if it is empty, and parted otherwise,
//! down to a least side. What is kept is stored with a border of its neighbours' texels, so that it is
//! filtered as it is in the whole picture.
//!
//! This work is based on:
//! Aleks Jakulin. Interactive Vegetation Rendering with Slicing and Blending. 2000 (section 4)

use crate::texture::texture::Image;

/// A part of a picture, in texels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cell {
    /// Of its left column.
    pub x: u32,
    /// Of its upper row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Levels, besides the finest, that cells of a least side are stored with: their border is an eighth of
/// the side, and a texel of the coarsest level.
pub fn border_levels(least_side: u32) -> u32 {
    (least_side / 8).max(1).ilog2()
}

/// The squares of a picture that hold something, or lie within `border` texels of something; cut off
/// where the picture ends. They do not overlap.
pub fn cells(image: &Image, least_side: u32, border: u32) -> Vec<Cell> {
    let side = image.width.max(image.height).next_power_of_two().max(least_side);
    parted(image, (0, 0), side, least_side, border)
}

/// Cells of the square of a corner and a side.
fn parted(image: &Image, (x, y): (u32, u32), side: u32, least_side: u32, border: u32) -> Vec<Cell> {
    if x >= image.width || y >= image.height || is_empty(image, (x, y), side, border) {
        return Vec::new();
    }
    let width = side.min(image.width - x);
    let height = side.min(image.height - y);
    let whole = Cell { x, y, width, height };
    let half = side / 2;
    if side <= least_side {
        return vec![whole];
    }
    let quarters = [(x, y), (x + half, y), (x, y + half), (x + half, y + half)];
    let cells: Vec<Cell> = quarters
        .into_iter()
        .flat_map(|corner| parted(image, corner, half, least_side, border))
        .collect();
    let area = |cell: &Cell| u64::from(cell.width) * u64::from(cell.height);
    if cells.iter().map(area).sum::<u64>() == area(&whole) { vec![whole] } else { cells }
}

fn is_empty(image: &Image, (x, y): (u32, u32), side: u32, border: u32) -> bool {
    let columns = x.saturating_sub(border)..(x + side + border).min(image.width);
    let mut rows = y.saturating_sub(border)..(y + side + border).min(image.height);
    rows.all(|row| columns.clone().all(|column| image.texel(column, row)[3] == 0))
}

/// A cell of a picture's levels with a border around it, `2^l` texels for the coarsest level `l`. Beyond
/// the picture the border repeats its edge. Sides and corner are multiples of `2^l`.
pub fn cut(levels: &[Image], cell: &Cell, border_levels: u32) -> Vec<Image> {
    let border = 1_u32 << border_levels;
    (0..=border_levels)
        .zip(levels)
        .map(|(level, image)| {
            let at = |start: u32, index: u32, size: u32| {
                ((start >> level) + index).saturating_sub(border >> level).min(size - 1)
            };
            let (width, height) =
                ((cell.width + 2 * border) >> level, (cell.height + 2 * border) >> level);
            let texels = (0..height).flat_map(|row| {
                let row = at(cell.y, row, image.height);
                (0..width).map(move |column| image.texel(at(cell.x, column, image.width), row))
            });
            Image { width, height, texels: texels.collect() }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture drawn in letters: '.' is empty, others are opaque with their code as colour.
    fn drawn(rows: &[&str]) -> Image {
        let width = u32::try_from(rows[0].len()).expect("small");
        let height = u32::try_from(rows.len()).expect("small");
        let texel = |c: u8| [c, c, c, if c == b'.' { 0 } else { 255 }];
        let texels = rows.iter().flat_map(|row| row.bytes().map(texel)).collect();
        Image::new(width, height, texels).expect("valid")
    }

    fn cell(x: u32, y: u32, width: u32, height: u32) -> Cell {
        Cell { x, y, width, height }
    }

    #[test]
    fn empty_quarters_are_left_out() {
        let image = drawn(&[
            "....####", "....####", "....####", "....####", "..a.....", "........", "........",
            "...b....",
        ]);
        assert_eq!(cells(&image, 4, 0), [cell(4, 0, 4, 4), cell(0, 4, 4, 4)], "quarters");
        let small = [cell(4, 0, 4, 4), cell(2, 4, 2, 2), cell(2, 6, 2, 2)];
        assert_eq!(cells(&image, 2, 0), small, "a full quarter stays whole");
        assert_eq!(cells(&image, 8, 0), [cell(0, 0, 8, 8)], "nothing smaller than the least");
        assert_eq!(cells(&image, 64, 0), [cell(0, 0, 8, 8)], "nor than the picture");
        // a at (2, 4), b at (3, 7): with a border the square left of a holds part of its blur
        let bordered = cells(&image, 2, 1);
        assert!(bordered.contains(&cell(0, 4, 2, 2)), "{bordered:?}");
        assert!(!bordered.contains(&cell(6, 6, 2, 2)), "{bordered:?}");
        assert_eq!(cells(&drawn(&["...", "...", "..."]), 1, 1), [], "nothing at all");
    }

    #[test]
    fn cells_end_with_the_picture_and_cover_it_once() {
        let mut state = 7_u32;
        for (width, height) in [(1, 1), (5, 3), (12, 20), (33, 8)] {
            let texels = (0..width * height).map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                [1, 2, 3, if state >> 29 == 0 { 200 } else { 0 }]
            });
            let image = Image::new(width, height, texels.collect()).expect("valid");
            for (least, border) in [(1, 0), (2, 0), (4, 1), (8, 3)] {
                let cells = cells(&image, least, border);
                for y in 0..height {
                    for x in 0..width {
                        let holds = |c: &&Cell| {
                            (c.x..c.x + c.width).contains(&x) && (c.y..c.y + c.height).contains(&y)
                        };
                        let count = cells.iter().filter(holds).count();
                        let what = format!("{width} x {height}, {least}, {border}: {x}, {y}");
                        assert!(count <= 1, "once: {what}");
                        assert!(count == 1 || image.texel(x, y)[3] == 0, "kept: {what}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_cut_has_its_neighbours_around_it() {
        let image = drawn(&["abcd", "efgh", "ijkl", "mnop"]);
        let half = drawn(&["AB", "CD"]);
        let of = |image: &Image| -> String {
            image.texels.iter().map(|texel| char::from(texel[0])).collect()
        };
        let levels = [image, half];
        let middle = cut(&levels, &cell(2, 0, 2, 2), 0);
        assert_eq!(middle.len(), 1, "the finest alone");
        assert_eq!(of(&middle[0]), "bcdd bcdd fghh jkll".replace(' ', ""), "edges are repeated");
        let both = cut(&levels, &cell(2, 0, 2, 2), 1);
        assert_eq!((both[0].width, both[0].height), (6, 6), "two texels on each side");
        assert_eq!(of(&both[1]), "ABB ABB CDD".replace(' ', ""), "one on the coarser");
        assert_eq!([8, 9, 16, 32, 64, 4].map(border_levels), [0, 0, 1, 2, 3, 0], "an eighth");
    }
}
