//! What a species is made of: numbers only, so that a preset is data.
//!
//! Lengths in metres, angles in degrees, shares of a whole in [0, 1], colours linear.

/// A value that varies evenly between `mean - spread` and `mean + spread`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vary {
    pub(super) mean: f64,
    pub(super) spread: f64,
}

/// `mean` give or take `spread`.
pub(super) const fn vary(mean: f64, spread: f64) -> Vary {
    Vary { mean, spread }
}

impl Vary {
    /// The value for a draw in [-1, 1).
    pub(super) fn at(self, draw: f64) -> f64 {
        self.mean + self.spread * draw
    }
}

/// A plant species.
#[derive(Debug)]
pub(super) struct Species {
    /// How Python names it.
    pub(super) name: &'static str,
    pub(super) trunk: Trunk,
    /// Length of limbs by where on the crown they grow.
    pub(super) crown: Crown,
    /// Levels of branches, the trunk first; leaves grow on the last one.
    pub(super) levels: &'static [Level],
    /// Triangles of all wood; the twigs' spacing is adjusted to reach it.
    pub(super) wood_triangle_count: usize,
    pub(super) bark: Bark,
    pub(super) leaves: Leaves,
}

/// The first stem, beyond what every level has.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trunk {
    /// Along the axis.
    pub(super) height: Vary,
    /// Radius above the flare, as a share of the height.
    pub(super) radius: f64,
    /// Growth of the radius at the ground by the roots' flare, as a share of the radius.
    pub(super) flare: f64,
    /// How many root ridges there are, and how deep they are as a share of the radius.
    pub(super) lobes: (f64, f64),
}

/// Relative length of a limb by `r`: 0 at the crown's top, 1 at its lowest limb.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crown {
    /// Largest radius as a share of the trunk's height; longer limbs are cut to it.
    pub(super) radius: f64,
    /// Where limbs are longest.
    pub(super) widest: f64,
    /// Length of the topmost and of the lowest limbs as a share of the longest.
    pub(super) ends: (f64, f64),
}

/// One generation of stems.
#[derive(Debug, Clone, Copy)]
pub(super) struct Level {
    /// Share of the parent's length (of the trunk's for limbs; unused for the trunk).
    pub(super) length: Vary,
    /// Radius is the parent's times (length / parent's length) to this power.
    pub(super) radius_power: f64,
    /// Share of the radius lost from base to tip; 1 ends in a point.
    pub(super) taper: f64,
    /// Length of a segment along the stem, and the most segments of one stem.
    pub(super) segment_length: f64,
    pub(super) max_segments: usize,
    /// Corners of a ring.
    pub(super) sides: usize,
    /// Distance between neighbours along the parent; of twigs, to begin with.
    pub(super) spacing: f64,
    /// Share of the parent that bears none, from its base.
    pub(super) bare: f64,
    /// Angle to the parent at its base and at its tip.
    pub(super) down: (f64, f64),
    pub(super) down_spread: f64,
    /// Angle about the parent from one to the next; 180 gives two rows, left and right.
    pub(super) around: Vary,
    /// Bend over the first and the second half, away from the parent; random bends on top of it.
    pub(super) curve: (f64, f64),
    pub(super) curve_spread: f64,
    /// Bend towards up (negative: down) over the whole stem, for a horizontal one, in the first
    /// and in the second half.
    pub(super) upward: (f64, f64),
    /// Forks a stem, from which share of the length on, and the angle between the two arms.
    pub(super) forks: f64,
    pub(super) forks_from: f64,
    pub(super) fork_angle: Vary,
}

/// Colours of the wood.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bark {
    pub(super) old: [f64; 3],
    /// Of the last level's tips.
    pub(super) young: [f64; 3],
    /// Brightness varies by this share either way from vertex to vertex.
    pub(super) spread: f64,
}

/// How leaves look and sit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leaves {
    /// How many, unless asked otherwise.
    pub(super) count: usize,
    pub(super) blade: Blade,
    /// Of the blade, along its y axis.
    pub(super) length: Vary,
    /// Share of a twig without leaves, from its base.
    pub(super) bare: f64,
    /// Length of the leafy end of a branch that is no twig.
    pub(super) end: f64,
    /// How many sit at the same height of the twig.
    pub(super) whorl: usize,
    /// Angle to the twig at its base and at its tip.
    pub(super) down: (f64, f64),
    pub(super) down_spread: f64,
    /// From one whorl to the next.
    pub(super) around: Vary,
    /// How much the blade's direction is drawn down: 0 not at all, 1 by 45 degrees if horizontal.
    pub(super) droop: Vary,
    /// How much the upper side faces up, away from the crown's middle, and anywhere.
    pub(super) facing: (f64, f64, f64),
    /// Height by which the blade's rim hangs, as a share of the square of the distance.
    pub(super) curl: Vary,
    pub(super) color: [f64; 3],
    /// What some leaves tend to.
    pub(super) other_color: [f64; 3],
    /// Brightness varies by this share either way from leaf to leaf.
    pub(super) spread: f64,
    /// Brightness of a leaf in the middle of the crown.
    pub(super) inner: f64,
}

/// One leaf of unit length: x to its right, y from its base to its tip, z out of its upper side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Blade {
    pub(super) vertices: &'static [[f64; 3]],
    /// Counter-clockwise seen from above.
    pub(super) triangles: &'static [[u8; 3]],
}

impl Crown {
    pub(super) fn limb_share(self, r: f64) -> f64 {
        let (top, bottom) = self.ends;
        let (end, distance) = if r < self.widest {
            (top, (self.widest - r) / self.widest)
        } else {
            (bottom, (r - self.widest) / (1.0 - self.widest))
        };
        // an ellipse's quarter on either side, so that the outline is round
        end + (1.0 - end) * (1.0 - distance * distance).max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limbs_are_longest_where_the_crown_is_widest() {
        let crown = Crown { radius: 0.5, widest: 0.75, ends: (0.25, 0.5) };
        for (r, share) in [(0.0, 0.25), (0.75, 1.0), (1.0, 0.5)] {
            assert_eq!(crown.limb_share(r), share, "r = {r}");
        }
    }
}
