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

/// What the stems of the last level are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Twigs {
    /// Tubes, part of the wood.
    Wood,
    /// Folded strips, part of the foliage, with so many triangles in all.
    Foliage(usize),
}

/// A woody plant.
#[derive(Debug)]
pub(super) struct Species {
    /// How Python names it.
    pub(super) name: &'static str,
    pub(super) trunk: Trunk,
    /// Length of limbs by where on the crown they grow.
    pub(super) crown: Crown,
    /// Levels of branches, the trunk first; leaves grow on the last one.
    pub(super) levels: &'static [Level],
    /// Triangles of all stems; the spacing of those of the last level is adjusted to reach it.
    pub(super) stem_triangle_count: usize,
    /// What the stems of the last level are made of.
    pub(super) twigs: Twigs,
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
    pub(super) outline: Outline,
    /// Largest radius as a share of the trunk's height; longer limbs are cut to it.
    pub(super) radius: f64,
    /// Where limbs are longest.
    pub(super) widest: f64,
    /// Length of the topmost and of the lowest limbs as a share of the longest.
    pub(super) ends: (f64, f64),
}

/// How the crown's outline runs from where it is widest to its ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outline {
    /// As quarters of an ellipse.
    Round,
    /// As straight lines.
    Cone,
    /// There is none: every limb has its full length, and may hang as low as it likes.
    Free,
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
    /// How far one may stand from its even place, as a share of the spacing.
    pub(super) jitter: f64,
    /// How many leave the parent at the same height.
    pub(super) whorl: usize,
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
    /// Length of the lowest and of the outermost leaf of a twig as a share of the longest.
    pub(super) ends: (f64, f64),
    /// Share of a twig without leaves, from its base.
    pub(super) bare: f64,
    /// Length of the leafy end of a branch that is no twig.
    pub(super) end: f64,
    /// How many sit at the same height of the twig.
    pub(super) whorl: usize,
    /// Angle to the twig at its base and at its tip.
    pub(super) down: (f64, f64),
    pub(super) down_spread: f64,
    /// Angle about the twig of the lowest leaf, from the horizontal on the right; `None`: any.
    pub(super) first: Option<f64>,
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

/// Angles to the parent at its base and at its tip, stated at the lowest side branch instead of the
/// base: for stems that bear side branches close to their tips only.
pub(super) const fn down_from(bare: f64, lowest: f64, tip: f64) -> (f64, f64) {
    (tip + (lowest - tip) / (1.0 - bare), tip)
}

/// Rises from the first of `ends` at 0 to 1 at `widest`, and falls to the second at 1, as two
/// quarters of an ellipse.
pub(super) fn bulge(at: f64, widest: f64, ends: (f64, f64)) -> f64 {
    let (end, distance) = from_widest(at, widest, ends);
    end + (1.0 - end) * (1.0 - distance * distance).max(0.0).sqrt()
}

/// The end on this side of the widest place, and the distance from there: 1 at the end.
fn from_widest(at: f64, widest: f64, ends: (f64, f64)) -> (f64, f64) {
    if at < widest {
        (ends.0, (widest - at) / widest)
    } else {
        (ends.1, (at - widest) / (1.0 - widest))
    }
}

impl Species {
    /// Whether stems of a level are foliage.
    pub(super) fn is_foliage(&self, level: usize) -> bool {
        level + 1 == self.levels.len() && self.twigs != Twigs::Wood
    }
}

impl Crown {
    pub(super) fn limb_share(self, r: f64) -> f64 {
        match self.outline {
            Outline::Round => bulge(r, self.widest, self.ends),
            Outline::Cone => {
                let (end, distance) = from_widest(r, self.widest, self.ends);
                end + (1.0 - end) * (1.0 - distance)
            }
            Outline::Free => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limbs_are_longest_where_the_crown_is_widest() {
        let round = Crown { outline: Outline::Round, radius: 0.5, widest: 0.75, ends: (0.25, 0.5) };
        let cone = Crown { outline: Outline::Cone, ..round };
        let free = Crown { outline: Outline::Free, ..round };
        for (r, share) in [(0.0, 0.25), (0.75, 1.0), (1.0, 0.5)] {
            assert_eq!(round.limb_share(r), share, "r = {r}");
            assert_eq!(cone.limb_share(r), share, "r = {r}");
            assert_eq!(free.limb_share(r), 1.0, "r = {r}");
        }
        assert_eq!(cone.limb_share(0.375), 0.625, "half way on a straight line");
        assert!(round.limb_share(0.375) > 0.8, "an ellipse is wider half way");
    }

    #[test]
    fn angles_may_be_stated_where_branches_begin() {
        let (base, tip) = down_from(0.75, 90.0, 30.0);
        assert_eq!((base + (tip - base) * 0.75, tip), (90.0, 30.0), "at 0.75 and at 1");
    }
}
