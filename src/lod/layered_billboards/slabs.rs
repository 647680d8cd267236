//! Slabs of a plant across the direction that it is seen from, where it has no branches to part it by.
//!
//! All slabs are equally thick. What reaches over a border is cut there, sample by sample, so that
//! slabs one over the other are the picture: every sample shows what is nearest to the viewer.

use glam::DVec3;
use rayon::prelude::*;

use crate::lod::leaves::{FLAT, Leaves, Placed};

/// How far beyond a border, as a share of the crown's radius, an element is drawn to be cut: depths
/// that decide are 32 bits, of up to 8 radii.
const MARGIN: f64 = 1e-5;

/// Slabs, the farthest first.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Slabs {
    /// Of the lowest border, along the direction, from the crown's centre.
    low: f64,
    /// Metres between borders; 0 for a crown without depth.
    thickness: f64,
    count: usize,
}

impl Slabs {
    /// `count` slabs, or one if there is no depth to part.
    pub(super) fn new(leaves: &Leaves<'_>, toward: DVec3, count: usize) -> Self {
        let (low, high) = (0..leaves.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| leaves.extent(leaf, toward))
            .reduce(|| (f64::INFINITY, f64::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        let depth = high - low;
        if depth <= FLAT * leaves.radius || count == 1 {
            return Self { low: (low + high) / 2.0, thickness: 0.0, count: 1 };
        }
        Self { low, thickness: depth / count as f64, count }
    }

    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Of the plane in a slab's middle.
    pub(super) fn offset(&self, slab: usize) -> f64 {
        self.low + (slab as f64 + 0.5) * self.thickness
    }

    /// Lower end of a slab; the first reaches to minus infinity.
    fn border(&self, slab: usize) -> f64 {
        match slab {
            0 => f64::NEG_INFINITY,
            _ if slab == self.count => f64::INFINITY,
            _ => self.low + slab as f64 * self.thickness,
        }
    }

    /// Offsets that a slab reaches from and to.
    pub(super) fn ends(&self, slab: usize) -> (f64, f64) {
        (self.border(slab), self.border(slab + 1))
    }

    /// The slab that holds an offset; on a border, the nearer one to the viewer.
    pub(super) fn holding(&self, offset: f64) -> usize {
        if self.count == 1 {
            return 0;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let guess =
            ((offset - self.low) / self.thickness).clamp(0.0, (self.count - 1) as f64) as usize;
        // what rounding may have got wrong by one
        if offset < self.border(guess) {
            guess - 1
        } else if offset >= self.border(guess + 1) {
            guess + 1
        } else {
            guess
        }
    }

    /// What is drawn in each slab: everything that reaches into it, cut unless it lies inside.
    pub(super) fn assign(&self, leaves: &Leaves<'_>, toward: DVec3) -> Vec<Vec<Placed>> {
        let margin = MARGIN * leaves.radius;
        let placed: Vec<(usize, usize)> = (0..leaves.leaf_centers.len())
            .into_par_iter()
            .map(|leaf| {
                let (low, high) = leaves.extent(leaf, toward);
                (self.holding(low - margin), self.holding(high + margin))
            })
            .collect();
        let mut slabs = vec![Vec::new(); self.count];
        for (leaf, (first, last)) in placed.into_iter().enumerate() {
            let cut = first < last;
            slabs[first..=last].iter_mut().for_each(|slab| slab.push(Placed { leaf, cut }));
        }
        slabs
    }
}
