//! Cards of crossing axes cut where they cross, so that they can be painted in exact order.
//!
//! The planes of all slices part space into boxes. A piece of a card lies between two neighbouring
//! boxes. A ray from the eye goes from box to box, each time one step farther from the eye's own box,
//! so painting pieces by falling number of steps is right for every ray. Pieces of the same number of
//! steps never hide one another.

use std::cmp::Reverse;
use std::sync::Arc;

use glam::{DVec3, Vec2};

use super::AXES;
use crate::draw_list::{Buffers, Geometry};
use crate::lod::stack::{Baked, Stack, card_item, instance, push_card};
use crate::lod::viewer::Viewer;
use crate::lod::{Crown, ListBuilder};
use crate::view::View;

/// A part of a slice's card that no other slice crosses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Piece {
    pub(super) axis: usize,
    pub(super) slice: usize,
    /// Twice the number of planes of each axis below it: on its own axis it is half way past its own.
    pub(super) at: [i32; 3],
    /// Index of its card.
    pub(super) card: u32,
}

/// All pieces of some stacks.
#[derive(Debug)]
pub(super) struct Pieces {
    pub(super) pieces: Vec<Piece>,
    /// Offsets of the planes of each axis, rising; none for an axis that is not there.
    planes: [Vec<f64>; 3],
}

impl Pieces {
    /// Cuts the cards of stacks, which have one axis each, at the planes of the others.
    pub(super) fn cut(stacks: &[Option<Stack>], center: DVec3) -> (Self, Arc<Geometry>) {
        let mut planes: [Vec<f64>; 3] = Default::default();
        for (stack, planes) in stacks.iter().zip(&mut planes) {
            // slices that show nothing hide nothing, but their planes do no harm: cells stay even
            planes.extend(stack.iter().flat_map(|stack| stack.slices.iter().map(|s| s.offset)));
        }
        let mut cards = Buffers::default();
        let mut pieces = Vec::new();
        let baked = stacks.iter().enumerate().flat_map(|(axis, stack)| {
            stack.iter().flat_map(Stack::baked).map(move |(slice, baked)| (axis, slice, baked))
        });
        for (axis, slice, baked) in baked {
            let (columns, rows) =
                (across(baked, center, &planes, true), across(baked, center, &planes, false));
            for column in &columns.parts {
                for row in &rows.parts {
                    let mut at = [0; 3];
                    at[axis] = 2 * i32::try_from(slice).expect("slices are few") + 1;
                    at[columns.axis] = column.at;
                    at[rows.axis] = row.at;
                    let area = [Vec2::new(column.from, row.from), Vec2::new(column.to, row.to)];
                    let card = push_card(&mut cards, &baked.rect, area, area);
                    pieces.push(Piece { axis, slice, at, card });
                }
            }
        }
        (Self { pieces, planes }, Geometry::new(cards))
    }

    /// Twice the number of planes of each axis below an eye.
    fn eye(&self, viewer: &Viewer) -> [i32; 3] {
        let mut at = [0; 3];
        for (axis, planes) in self.planes.iter().enumerate() {
            let below = match viewer.eye {
                Some(eye) => planes.partition_point(|&offset| offset < eye.dot(AXES[axis])),
                None if viewer.toward.dot(AXES[axis]) > 0.0 => planes.len(),
                None => 0,
            };
            at[axis] = 2 * i32::try_from(below).expect("slices are few");
        }
        at
    }

    /// Pieces of some axes from the farthest to the nearest.
    pub(super) fn far_to_near(&self, viewer: &Viewer, axes: &[usize]) -> Vec<&Piece> {
        let eye = self.eye(viewer);
        let steps = |piece: &Piece| -> i32 {
            piece.at.iter().zip(eye).map(|(at, eye)| (at - eye).abs()).sum()
        };
        let place = |axis: usize| axes.iter().position(|&other| other == axis);
        let mut shown: Vec<&Piece> =
            self.pieces.iter().filter(|piece| axes.contains(&piece.axis)).collect();
        shown.sort_by_key(|piece| (Reverse(steps(piece)), place(piece.axis)));
        shown
    }

    /// Paints the pieces of the axes that are mixed, each with its opacity.
    pub(super) fn emit(
        &self,
        view: &View,
        crown: &Crown,
        viewer: &Viewer,
        (cards, stacks): (&Arc<Geometry>, &[Option<Stack>]),
        mixed: &[(usize, f64)],
        builder: &mut ListBuilder,
    ) {
        let source = builder.list.geometry(cards);
        let axes: Vec<usize> = mixed.iter().map(|&(axis, _)| axis).collect();
        let instances: Vec<_> =
            mixed.iter().map(|&(_, opacity)| instance(view, crown, opacity, builder)).collect();
        for piece in self.far_to_near(viewer, &axes) {
            let place = axes.iter().position(|&axis| axis == piece.axis).expect("filtered");
            let slice = stacks[piece.axis].as_ref().map(|stack| &stack.slices[piece.slice]);
            let baked = slice.and_then(|slice| slice.baked.as_ref()).expect("cut from a picture");
            let instances = instances[place].clone();
            let texture = &baked.tiles[0].texture;
            let cards = piece.card..piece.card + 1;
            let item = card_item(source, cards, texture, instances, builder);
            builder.push_blended(crown, item);
        }
    }
}

/// Parts of a card along its columns or rows.
struct Across {
    /// Across whose planes it is cut.
    axis: usize,
    parts: Vec<Between>,
}

/// What lies between two neighbouring planes, in texture coordinates.
struct Between {
    from: f32,
    to: f32,
    /// Twice the number of planes below.
    at: i32,
}

/// Cuts a card at the planes across its columns, or across its rows.
fn across(baked: &Baked, center: DVec3, planes: &[Vec<f64>; 3], columns: bool) -> Across {
    let rect = &baked.rect;
    // the direction of rising texture coordinates, and how far they reach
    let (along, length) = if columns { (rect.right, rect.width) } else { (-rect.up, rect.height) };
    let axis = AXES.iter().position(|u| u.dot(along).abs() > 0.5).expect("sides along the axes");
    let rises = along.dot(AXES[axis]) > 0.0;
    let planes = &planes[axis];
    let start = (rect.center - center).dot(along) - length / 2.0;
    let sign = if rises { 1.0 } else { -1.0 };
    let mut ends: Vec<f64> = planes.iter().map(|&p| (sign * p - start) / length).collect();
    if !rises {
        ends.reverse();
    }
    ends.push(1.0);
    let mut parts = Vec::new();
    let mut from = 0.0;
    for (number, end) in ends.into_iter().enumerate() {
        let to = end.clamp(0.0, 1.0);
        let below = if rises { number } else { planes.len() - number };
        if to > from {
            #[expect(clippy::cast_possible_truncation, reason = "texture coordinates")]
            let (from, to) = (from as f32, to as f32);
            let at = 2 * i32::try_from(below).expect("slices are few");
            parts.push(Between { from, to, at });
            // the next part begins where this one ends
        }
        from = f64::max(from, to);
    }
    Across { axis, parts }
}
