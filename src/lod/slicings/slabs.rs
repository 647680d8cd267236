//! Which leaf goes to which slice: the slabs of a direction, and the leaves that lie in each.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::bake::BakeRect;
use crate::lod::leaves::{FLAT, LEAST_SIZE, Leaves, Placed};

/// A leaf this share of the spacing beyond the middle between two slices still lies there: rounding.
const TIE: f64 = 1e-9;

/// A direction's axes and its slabs.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    right: DVec3,
    up: DVec3,
    pub(super) toward: DVec3,
    pub(super) spacing: f64,
    pub(super) count: usize,
}

impl Layout {
    /// Slabs across `toward` for leaf centres relative to the crown's centre.
    pub(super) fn new(toward: DVec3, centers: &[DVec3], slice_count: usize, radius: f64) -> Self {
        // world up, or -z for a direction that is up itself
        let up_hint = if toward.y.abs() > 1.0 - 1e-9 { DVec3::NEG_Z } else { DVec3::Y };
        let right = up_hint.cross(toward).normalize();
        let up = toward.cross(right);
        let depth = 2.0 * centers.iter().map(|p| toward.dot(*p).abs()).fold(0.0, f64::max);
        // equal where the crown is a single point
        let flat = depth <= FLAT * radius;
        let count = if flat { 1 } else { slice_count };
        let spacing = if flat { 0.0 } else { depth / count as f64 };
        Self { right, up, toward, spacing, count }
    }

    /// Offset of a slice's plane from the centre.
    pub(super) fn offset(&self, slice: usize) -> f64 {
        (slice as f64 - (self.count as f64 - 1.0) / 2.0) * self.spacing
    }

    /// The slice nearest to an offset; between two, the lower.
    pub(super) fn nearest(&self, offset: f64) -> usize {
        if self.spacing == 0.0 {
            return 0;
        }
        let at = (offset / self.spacing + self.count as f64 / 2.0 - TIE).ceil() - 1.0;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let slice = at.clamp(0.0, self.count as f64 - 1.0) as usize;
        slice
    }

    /// Whether what lies between two offsets is longer than the spacing.
    fn is_exceeded_by(&self, (low, high): (f64, f64)) -> bool {
        self.count > 1 && high - low > self.spacing * (1.0 + TIE)
    }

    /// Offsets between which a slice owns cut leaves; the outermost reach to infinity.
    pub(super) fn slab(&self, slice: usize) -> (f64, f64) {
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
    pub(super) fn is_large(&self, leaves: &Leaves<'_>, leaf: usize) -> bool {
        self.is_exceeded_by(leaves.extent(leaf, self.toward))
    }

    /// The rectangle through the centre that encloses every leaf as seen along the direction.
    pub(super) fn rect(&self, leaves: &Leaves<'_>) -> BakeRect {
        let half = (0..leaves.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| {
                leaves.vertices_of(leaf).fold(DVec2::ZERO, |half, p| {
                    half.max(DVec2::new(p.dot(self.right).abs(), p.dot(self.up).abs()))
                })
            })
            .reduce(|| DVec2::ZERO, DVec2::max);
        // a crown that is a line or a point from here still needs a rectangle
        let least = (leaves.radius * FLAT).max(LEAST_SIZE * FLAT);
        BakeRect {
            center: leaves.center,
            right: self.right,
            up: self.up,
            width: 2.0 * half.x.max(least),
            height: 2.0 * half.y.max(least),
            reach: 2.0 * leaves.radius.max(least),
        }
    }

    /// Sorts the leaves of a slicing into its slices; `in_mesh` leaves go to none.
    pub(super) fn assign(self, crown: &Leaves<'_>, in_mesh: &[bool]) -> Assignment {
        let placed: Vec<(bool, usize, usize)> = (0..crown.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| {
                let (low, high) = crown.extent(leaf, self.toward);
                if self.is_exceeded_by((low, high)) {
                    // wider than it is, since slabs are cut at f32 depths of up to 8 radii
                    let margin = self.spacing * 1e-3 + crown.radius * 1e-5;
                    (true, self.nearest(low - margin), self.nearest(high + margin))
                } else {
                    let slice = self.nearest(crown.leaf_centers[leaf].dot(self.toward));
                    (false, slice, slice)
                }
            })
            .collect();
        let mut leaves = vec![Vec::new(); self.count];
        for (leaf, (cut, first, last)) in placed.into_iter().enumerate() {
            if !in_mesh[leaf] {
                leaves[first..=last].iter_mut().for_each(|slice| slice.push(Placed { leaf, cut }));
            }
        }
        Assignment { layout: self, rect: self.rect(crown), leaves }
    }
}

/// Where a slicing's leaves go.
pub(super) struct Assignment {
    pub(super) layout: Layout,
    /// The shared rectangle, through the crown's centre.
    pub(super) rect: BakeRect,
    /// By slice, in the order of the leaves.
    pub(super) leaves: Vec<Vec<Placed>>,
}

impl Assignment {
    /// Depths, as the shared view measures them, between which a slice owns cut leaves. Neighbours
    /// share the very same number, so each sample belongs to exactly one.
    pub(super) fn slab(&self, slice: usize) -> [f32; 2] {
        let (low, high) = self.layout.slab(slice);
        #[expect(clippy::cast_possible_truncation, reason = "depths are compared in f32")]
        let depths = [self.rect.depth_of(high) as f32, self.rect.depth_of(low) as f32];
        [depths[0].max(0.0), depths[1]]
    }

    /// Where a slice's card lies.
    pub(super) fn card(&self, slice: usize) -> BakeRect {
        let offset = self.layout.toward * self.layout.offset(slice);
        BakeRect { center: self.rect.center + offset, ..self.rect }
    }
}
