//! Which leaf goes to which slice: the slabs of a direction, and the leaves that lie in each.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::bake::BakeRect;
use crate::lod::leaves::{FLAT, LEAST_SIZE, Leaves, Placed};

/// A leaf this share of the spacing beyond the middle between two slices still lies there: rounding.
const TIE: f64 = 1e-9;

/// Which leaves are cut at the borders of slabs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cut {
    /// Those longer than the spacing; the others go to the slab of their centre as they are.
    Large,
    /// All that reach across a border.
    All,
}

/// A direction's axes and its slabs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layout {
    right: DVec3,
    up: DVec3,
    pub(crate) toward: DVec3,
    /// Offset along the direction of the middle of all slabs from the crown's centre.
    middle: f64,
    pub(crate) spacing: f64,
    pub(crate) count: usize,
}

impl Layout {
    /// Slabs across `toward` for leaf centres relative to the crown's centre: as deep on either side
    /// of it.
    pub(crate) fn new(toward: DVec3, centers: &[DVec3], slice_count: usize, radius: f64) -> Self {
        let half = centers.iter().map(|p| toward.dot(*p).abs()).fold(0.0, f64::max);
        Self::between(toward, (-half, half), slice_count, radius)
    }

    /// Slabs across `toward` that share out what lies between the first vertex and the last.
    pub(crate) fn of_vertices(toward: DVec3, leaves: &Leaves<'_>, slice_count: usize) -> Self {
        let ends = (0..leaves.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| leaves.extent(leaf, toward))
            .reduce(|| (f64::INFINITY, f64::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        Self::between(toward, ends, slice_count, leaves.radius)
    }

    fn between(toward: DVec3, (low, high): (f64, f64), slice_count: usize, radius: f64) -> Self {
        // world up, or -z for a direction that is up itself
        let up_hint = if toward.y.abs() > 1.0 - 1e-9 { DVec3::NEG_Z } else { DVec3::Y };
        let right = up_hint.cross(toward).normalize();
        let up = toward.cross(right);
        let depth = high - low;
        // equal where the crown is a single point
        let flat = depth <= FLAT * radius;
        let count = if flat { 1 } else { slice_count };
        let spacing = if flat { 0.0 } else { depth / count as f64 };
        Self { right, up, toward, middle: (low + high) / 2.0, spacing, count }
    }

    /// Offset of a slice's plane from the centre.
    pub(crate) fn offset(&self, slice: usize) -> f64 {
        self.middle + (slice as f64 - (self.count as f64 - 1.0) / 2.0) * self.spacing
    }

    /// The slice nearest to an offset; between two, the lower.
    pub(crate) fn nearest(&self, offset: f64) -> usize {
        if self.spacing == 0.0 {
            return 0;
        }
        let from_first = (offset - self.middle) / self.spacing + self.count as f64 / 2.0;
        let at = (from_first - TIE).ceil() - 1.0;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let slice = at.clamp(0.0, self.count as f64 - 1.0) as usize;
        slice
    }

    /// Whether what lies between two offsets is longer than the spacing.
    fn is_exceeded_by(&self, (low, high): (f64, f64)) -> bool {
        self.count > 1 && high - low > self.spacing * (1.0 + TIE)
    }

    /// Offsets between which a slice owns cut leaves; the outermost reach to infinity.
    pub(crate) fn slab(&self, slice: usize) -> (f64, f64) {
        let low =
            if slice == 0 { f64::NEG_INFINITY } else { self.offset(slice) - self.spacing / 2.0 };
        let high = if slice + 1 == self.count {
            f64::INFINITY
        } else {
            // the same number as the next slab's lower end
            self.offset(slice + 1) - self.spacing / 2.0
        };
        (low, high)
    }

    /// Whether a leaf is longer than the spacing along the direction.
    pub(crate) fn is_large(&self, leaves: &Leaves<'_>, leaf: usize) -> bool {
        self.is_exceeded_by(leaves.extent(leaf, self.toward))
    }

    /// The rectangle through the centre that encloses every leaf as seen along the direction.
    pub(crate) fn rect(&self, leaves: &Leaves<'_>) -> BakeRect {
        let (low, high) = self.box_across(leaves);
        let half = low.abs().max(high.abs());
        self.rect_around(leaves, -half, half)
    }

    /// The least rectangle with sides along the axes that encloses every leaf, through the middle of
    /// the slabs.
    pub(crate) fn least_rect(&self, leaves: &Leaves<'_>) -> BakeRect {
        let (low, high) = self.box_across(leaves);
        self.rect_around(leaves, low, high)
    }

    /// The box around all vertices across the direction, relative to the crown's centre.
    fn box_across(&self, leaves: &Leaves<'_>) -> (DVec2, DVec2) {
        let none = || (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let join = |a: (DVec2, DVec2), b: (DVec2, DVec2)| (a.0.min(b.0), a.1.max(b.1));
        (0..leaves.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| {
                leaves.vertices_of(leaf).fold(none(), |found, p| {
                    let at = DVec2::new(p.dot(self.right), p.dot(self.up));
                    join(found, (at, at))
                })
            })
            .reduce(none, join)
    }

    fn rect_around(&self, leaves: &Leaves<'_>, low: DVec2, high: DVec2) -> BakeRect {
        // a crown that is a line or a point from here still needs a rectangle
        let least = (leaves.radius * FLAT).max(LEAST_SIZE * FLAT);
        let (middle, half) = ((low + high) / 2.0, (high - low) / 2.0);
        let across = self.right * middle.x + self.up * middle.y;
        BakeRect {
            center: leaves.center + across + self.toward * self.middle,
            right: self.right,
            up: self.up,
            width: 2.0 * half.x.max(least),
            height: 2.0 * half.y.max(least),
            reach: 2.0 * leaves.radius.max(least),
        }
    }

    /// Sorts the leaves into the slabs; those that `is_left_out` names go to none. Slices are baked
    /// on `rect`.
    pub(crate) fn assign(
        self,
        crown: &Leaves<'_>,
        rect: BakeRect,
        cut: Cut,
        is_left_out: impl Fn(usize) -> bool + Sync,
    ) -> Assignment {
        // wider than it is, since slabs are cut at f32 depths of up to 8 radii
        let margin = self.spacing * 1e-3 + crown.radius * 1e-5;
        let reached =
            |(low, high): (f64, f64)| (self.nearest(low - margin), self.nearest(high + margin));
        let placed: Vec<(bool, usize, usize)> = (0..crown.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| {
                let ends = crown.extent(leaf, self.toward);
                match cut {
                    Cut::All => {
                        let (first, last) = reached(ends);
                        (first < last, first, last)
                    }
                    Cut::Large if self.is_exceeded_by(ends) => {
                        let (first, last) = reached(ends);
                        (true, first, last)
                    }
                    Cut::Large => {
                        let slice = self.nearest(crown.leaf_centers[leaf].dot(self.toward));
                        (false, slice, slice)
                    }
                }
            })
            .collect();
        let mut leaves = vec![Vec::new(); self.count];
        for (leaf, (cut, first, last)) in placed.into_iter().enumerate() {
            if !is_left_out(leaf) {
                leaves[first..=last].iter_mut().for_each(|slice| slice.push(Placed { leaf, cut }));
            }
        }
        Assignment { layout: self, rect, leaves }
    }
}

/// Where the leaves of a stack of slices go.
pub(crate) struct Assignment {
    pub(crate) layout: Layout,
    /// The shared rectangle, through the middle of all slabs.
    pub(crate) rect: BakeRect,
    /// By slice, in the order of the leaves.
    pub(crate) leaves: Vec<Vec<Placed>>,
}

impl Assignment {
    /// Depths, as the shared view measures them, between which a slice owns cut leaves. Neighbours
    /// share the very same number, so each sample belongs to exactly one.
    pub(crate) fn slab(&self, slice: usize) -> [f32; 2] {
        let (low, high) = self.layout.slab(slice);
        let depth = |offset: f64| self.rect.depth_of(offset - self.layout.middle);
        #[expect(clippy::cast_possible_truncation, reason = "depths are compared in f32")]
        let depths = [depth(high) as f32, depth(low) as f32];
        [depths[0].max(0.0), depths[1]]
    }

    /// Where a slice's card lies.
    pub(crate) fn card(&self, slice: usize) -> BakeRect {
        let offset = self.layout.offset(slice) - self.layout.middle;
        BakeRect { center: self.rect.center + self.layout.toward * offset, ..self.rect }
    }
}
