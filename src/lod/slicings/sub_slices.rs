//! Slices cut into a grid of cells, each of which is seen at an angle of its own.
//!
//! From close by, the parts of a crown are seen from different sides. A cell of any slicing is drawn as
//! opaque as its slicing would be if the cell's middle were the crown's centre.
//!
//! This work is based on:
//! Aleks Jakulin. Interactive Vegetation Rendering with Slicing and Blending. 2000 (section 4)

use std::cmp::Reverse;
use std::sync::Arc;

use glam::DVec3;

use super::part::Mixing;
use crate::bake::BakeRect;
use crate::draw_list::{Geometry, Item};
use crate::error::LodError;
use crate::job::Job;
use crate::lod::opacity::Opacity;
use crate::lod::stack::{Drawing, Stack, card_item, instance};
use crate::lod::viewer::Viewer;
use crate::lod::{Crown, ListBuilder};
use crate::view::View;

/// The cells of a slicing's slices.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    /// The slicing's rectangle, through the crown's centre.
    rect: BakeRect,
    /// Of the slices' planes.
    offsets: Vec<f64>,
    /// Cells along each side.
    side: usize,
}

impl Grid {
    pub(super) fn new(rect: BakeRect, offsets: Vec<f64>, side: usize) -> Self {
        Self { rect, offsets, side }
    }

    /// Middle of a cell of a plane, relative to the crown's centre.
    fn middle(&self, center: DVec3, offset: f64, [column, row]: [usize; 2]) -> DVec3 {
        let [u, v] = [column, row].map(|at| (at as f64 + 0.5) / self.side as f64 - 0.5);
        let rect = &self.rect;
        let across = rect.right * (u * rect.width) - rect.up * (v * rect.height);
        rect.center - center + across + rect.toward() * offset
    }

    /// Middles of a plane's cells, row by row.
    fn middles(&self, center: DVec3, offset: f64) -> impl Iterator<Item = DVec3> {
        let side = self.side;
        (0..side * side).map(move |cell| self.middle(center, offset, [cell % side, cell / side]))
    }

    /// Whether some cell of this slicing is seen.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub(super) fn is_seen(
        &self,
        slicing: usize,
        mixing: &Mixing,
        viewer: &Viewer,
        (center, radius): (DVec3, f64),
        job: &Job,
    ) -> Result<bool, LodError> {
        // no cell has a share of what another slicing shows
        if !mixing.is_stored(slicing) {
            return Ok(false);
        }
        for &offset in &self.offsets {
            job.check()?;
            let is_seen = self.middles(center, offset).any(|middle| {
                let shares = mixing.shares(viewer.toward_from(middle, radius), viewer.up);
                shares.iter().any(|&(number, _)| number == slicing)
            });
            if is_seen {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

/// Slicings that are drawn cell by cell.
pub(super) struct Cells<'a> {
    pub(super) mixing: &'a Mixing,
    pub(super) stacks: &'a [Option<Stack>],
    pub(super) grids: &'a [Grid],
    /// The crown's centre and radius.
    pub(super) crowned: (DVec3, f64),
    pub(super) law: Opacity,
    pub(super) drawing: Drawing,
}

impl Cells<'_> {
    /// How opaque the cells of a slicing are: slice by slice, then row by row. Nothing where none is
    /// seen.
    fn opacities(&self, viewer: &Viewer, slicing: usize) -> Vec<f64> {
        if !self.mixing.is_stored(slicing) {
            return Vec::new();
        }
        let (center, radius) = self.crowned;
        let grid = &self.grids[slicing];
        let middles = grid.offsets.iter().flat_map(|&offset| grid.middles(center, offset));
        let opacities = middles.map(|middle| {
            let shares = self.mixing.shares(viewer.toward_from(middle, radius), viewer.up);
            let place = shares.iter().position(|&(number, _)| number == slicing);
            place.map_or(0.0, |place| self.law.of(&shares)[place])
        });
        let opacities: Vec<f64> = opacities.collect();
        if opacities.iter().any(|&opacity| opacity > 0.0) { opacities } else { Vec::new() }
    }

    /// Paints the cells: ranks as whole slices have, of one rank the slicings that are less opaque in
    /// all first.
    ///
    /// # Errors
    /// The number of a slicing that is needed and was not baked.
    pub(super) fn emit(
        &self,
        view: &View,
        crown: &Crown,
        viewer: &Viewer,
        cards: &Arc<Geometry>,
        builder: &mut ListBuilder,
    ) -> Result<(), usize> {
        let source = builder.list.geometry(cards);
        // (rank, opacity of all cells, slicing, item)
        let mut items: Vec<(f64, f64, usize, Item)> = Vec::new();
        for (slicing, grid) in self.grids.iter().enumerate() {
            let of_cells = self.opacities(viewer, slicing);
            if of_cells.is_empty() {
                continue;
            }
            let stack = self.stacks[slicing].as_ref().ok_or(slicing)?;
            let first = items.len();
            let mut sum = 0.0;
            for (rank, slice) in stack.far_to_near(viewer, self.drawing.drop_back) {
                // offsets rise, and the grid has the very same
                let number = grid.offsets.partition_point(|&offset| offset < slice.offset);
                let of_slice = &of_cells[number * grid.side * grid.side..];
                let shown = self.drawing.pixel_size;
                for tile in slice.baked.iter().flat_map(|baked| baked.shown(shown)) {
                    let opacities: Vec<f64> = tile
                        .cells
                        .iter()
                        .map(|&[column, row]| of_slice[row * grid.side + column])
                        .collect();
                    sum += opacities.iter().sum::<f64>();
                    let mut card = tile.cards.start;
                    for run in opacities.chunk_by(|a, b| a == b) {
                        let end = card + u32::try_from(run.len()).expect("few cells");
                        if run[0] > 0.0 {
                            let instances = instance(view, crown, run[0], builder);
                            let range = card..end;
                            let item = card_item(source, range, &tile.texture, instances, builder);
                            items.push((rank, 0.0, slicing, item));
                        }
                        card = end;
                    }
                }
            }
            items[first..].iter_mut().for_each(|item| item.1 = sum);
        }
        let key = |item: &(f64, f64, usize, Item)| Reverse(item.2);
        items.sort_by(|a, b| {
            a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)).then_with(|| key(a).cmp(&key(b)))
        });
        for (_, _, _, item) in items {
            builder.push_blended(crown, item);
        }
        Ok(())
    }
}
