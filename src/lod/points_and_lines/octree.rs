//! An octree of small depth over a plant's pieces: each cell has its own distance from the eye.
//!
//! A cell with more triangles than a limit is divided at its middle, down to a largest depth. A piece
//! belongs to the cell that its centre lies in, and stays whole.

use std::ops::Range;

use glam::DVec3;

/// Divisions at most: 8^8 cells are more than any plant has leaves.
pub const MAX_DEPTH: usize = 8;

/// Pieces by cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cells {
    /// Piece indices; those of a cell keep their order.
    pub order: Vec<u32>,
    /// A range of `order` for each cell that has pieces.
    pub cells: Vec<Range<usize>>,
}

impl Cells {
    /// Divides pieces with given centres and triangle counts.
    pub fn new(
        centers: &[DVec3],
        triangle_counts: &[u32],
        max_depth: usize,
        max_count: u64,
    ) -> Self {
        assert_eq!(centers.len(), triangle_counts.len(), "one count a piece");
        let count = u32::try_from(centers.len()).expect("pieces are counted in u32");
        let (low, high) = centers
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), &c| (l.min(c), h.max(c)));
        let mut cells = Self { order: (0..count).collect(), cells: Vec::new() };
        if centers.is_empty() {
            return cells;
        }
        // a cube, so that cells are about as wide in all directions
        let middle = (low + high) * 0.5;
        let half = ((high - low) * 0.5).max_element();
        let mut order = std::mem::take(&mut cells.order);
        let input = Input { centers, triangle_counts, max_count };
        cells.divide(&input, &mut order, 0, (middle, half), max_depth.min(MAX_DEPTH));
        cells.order = order;
        cells
    }

    fn divide(
        &mut self,
        input: &Input<'_>,
        pieces: &mut [u32],
        start: usize,
        (middle, half): (DVec3, f64),
        depth_left: usize,
    ) {
        let triangles: u64 =
            pieces.iter().map(|&p| u64::from(input.triangle_counts[p as usize])).sum();
        if depth_left == 0 || triangles <= input.max_count || half == 0.0 {
            if !pieces.is_empty() {
                self.cells.push(start..start + pieces.len());
            }
            return;
        }
        let octant = |&piece: &u32| {
            let above = input.centers[piece as usize].cmpge(middle);
            above.bitmask()
        };
        pieces.sort_by_key(octant);
        let mut from = 0;
        for number in 0..8 {
            let length = pieces[from..].partition_point(|piece| octant(piece) <= number);
            let side = |bit: u32| if number >> bit & 1 == 1 { 0.5 } else { -0.5 };
            let center = middle + DVec3::new(side(0), side(1), side(2)) * half;
            let part = &mut pieces[from..from + length];
            self.divide(input, part, start + from, (center, half * 0.5), depth_left - 1);
            from += length;
        }
    }
}

struct Input<'a> {
    centers: &'a [DVec3],
    triangle_counts: &'a [u32],
    max_count: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_by_hand() {
        // four leaves of two triangles on a line; the middle is at x = 4
        let centers = [8.0, 0.0, 1.0, 5.0].map(|x| DVec3::X * x);
        let cells = |depth, max| Cells::new(&centers, &[2; 4], depth, max);
        let one = cells(3, 8);
        assert_eq!((one.order, one.cells), (vec![0, 1, 2, 3], vec![0..4; 1]), "few enough");
        let two = cells(1, 2);
        assert_eq!((two.order, two.cells), (vec![1, 2, 0, 3], vec![0..2, 2..4]), "one division");
        let deep = cells(2, 2);
        assert_eq!(deep.order, [1, 2, 3, 0], "by place; equal places in order");
        assert_eq!(deep.cells, [0..2, 2..3, 3..4], "0 and 1 share the lowest quarter");
        let same = Cells::new(&[DVec3::ONE; 3], &[9; 3], 8, 1);
        assert_eq!(same.cells, [0..3; 1], "a point cannot be divided");
        assert_eq!(Cells::new(&[], &[], 3, 1).cells, [], "no pieces, no cells");
    }

    #[test]
    fn every_piece_is_in_one_cell() {
        let centers: Vec<DVec3> = (0..1000_u32)
            .map(|i| DVec3::new(f64::from(i % 10), f64::from(i / 10 % 10), f64::from(i / 100)))
            .collect();
        let cells = Cells::new(&centers, &[1; 1000], 3, 10);
        let mut order = cells.order.clone();
        order.sort_unstable();
        assert!(order.iter().copied().eq(0..1000), "a permutation");
        let ends: Vec<usize> = cells.cells.iter().map(|cell| cell.end).collect();
        let starts: Vec<usize> = cells.cells.iter().map(|cell| cell.start).collect();
        assert_eq!((starts[0], ends[ends.len() - 1]), (0, 1000), "all of them");
        assert_eq!(starts[1..], ends[..ends.len() - 1], "without gaps");
        assert!(cells.cells.iter().all(|cell| cell.len() <= 10), "small enough");
    }
}
