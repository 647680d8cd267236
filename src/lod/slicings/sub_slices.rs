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
}

/// The slicings that some cell of theirs shows.
pub(super) fn mixed(
    grids: &[Grid],
    mixing: &Mixing,
    viewer: &Viewer,
    (center, radius): (DVec3, f64),
) -> Vec<usize> {
    let shows = |&slicing: &usize| {
        let grid = &grids[slicing];
        let mut cells = grid.offsets.iter().flat_map(|&offset| {
            let cells = (0..grid.side * grid.side).map(|cell| [cell % grid.side, cell / grid.side]);
            cells.map(move |cell| grid.middle(center, offset, cell))
        });
        cells.any(|middle| {
            let toward = viewer.toward_from(middle, radius);
            mixing.shares(toward, viewer.up).iter().any(|&(number, _)| number == slicing)
        })
    };
    (0..grids.len()).filter(shows).collect()
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
    /// How opaque a cell of a slicing is.
    fn opacity(&self, viewer: &Viewer, slicing: usize, offset: f64, cell: [usize; 2]) -> f64 {
        let (center, radius) = self.crowned;
        let middle = self.grids[slicing].middle(center, offset, cell);
        let shares = self.mixing.shares(viewer.toward_from(middle, radius), viewer.up);
        let place = shares.iter().position(|&(number, _)| number == slicing);
        place.map_or(0.0, |place| self.law.of(&shares)[place])
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
        let needed = mixed(self.grids, self.mixing, viewer, self.crowned);
        // (rank, opacity of all cells, slicing, item)
        let mut items: Vec<(f64, f64, usize, Item)> = Vec::new();
        for slicing in needed {
            let stack = self.stacks[slicing].as_ref().ok_or(slicing)?;
            let first = items.len();
            let mut sum = 0.0;
            for (rank, slice) in stack.far_to_near(viewer, self.drawing.drop_back) {
                let shown = self.drawing.pixel_size;
                for tile in slice.baked.iter().flat_map(|baked| baked.shown(shown)) {
                    let opacities: Vec<f64> = tile
                        .cells
                        .iter()
                        .map(|&cell| self.opacity(viewer, slicing, slice.offset, cell))
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
