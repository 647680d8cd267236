//! How far from the viewer a layer lies: at the mean depth of what it shows, or in the plane through its
//! anchor that is nearest to it.
//!
//! A plane through the anchor lets a layer hang on whoever looks, and its depth follows what it shows.
//! Along the direction of the bake it is the same picture: texels move along that direction alone.

use glam::{DMat2, DVec2, DVec3};

use crate::lod::layered_billboards::frame::Frame;

/// Steepest plane, in metres of depth a metre across: 45 degrees. At half of it FLIP rises by 0.01 at
/// 0 degrees, and by up to 0.03 at 90 (four trees).
const MAX_LEAN: f64 = 1.0;

/// Share of the spread that is added to both directions: what is seen as a line says nothing of the
/// depth beside it.
const CALM: f64 = 0.02;

/// Depth, towards the viewer from the crown's centre, as a function of where something is seen.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Depth {
    /// At `about`.
    offset: f64,
    about: DVec2,
    /// Metres a metre to the right, and up.
    lean: DVec2,
    /// Of what the layer shows: nearer ones are painted later.
    pub(super) mean: f64,
}

/// A place, from the crown's centre, and what it counts for.
pub(super) type Weighed = (DVec3, f64);

impl Depth {
    /// The same everywhere.
    pub(super) fn flat(mean: f64) -> Self {
        Self { offset: mean, about: DVec2::ZERO, lean: DVec2::ZERO, mean }
    }

    /// The plane through `anchor` with the least sum of squared distances in depth.
    pub(super) fn through(
        anchor: DVec3,
        mean: f64,
        places: impl Iterator<Item = Weighed>,
        frame: &Frame,
    ) -> Self {
        let (about, offset) = (frame.seen(anchor), anchor.dot(frame.toward));
        let mut spread = DMat2::ZERO;
        let mut product = DVec2::ZERO;
        for (place, weight) in places {
            let across = frame.seen(place) - about;
            let weighed = across * weight;
            spread += DMat2::from_cols(weighed * across.x, weighed * across.y);
            product += weighed * (place.dot(frame.toward) - offset);
        }
        let calm = CALM * (spread.x_axis.x + spread.y_axis.y);
        let spread = spread + DMat2::from_diagonal(DVec2::splat(calm));
        // nothing that has an extent leaves the plane across the direction
        let lean = if calm > 0.0 { spread.inverse() * product } else { DVec2::ZERO };
        let lean = if lean.is_finite() { lean.clamp_length_max(MAX_LEAN) } else { DVec2::ZERO };
        Self { offset, about, lean, mean }
    }

    /// Of what is seen at a place.
    pub(super) fn at(&self, seen: DVec2) -> f64 {
        self.offset + self.lean.dot(seen - self.about)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRONT: Frame = Frame { right: DVec3::X, up: DVec3::Y, toward: DVec3::Z };

    #[test]
    fn a_plane_through_the_anchor_follows_what_it_shows() {
        let flat = Depth::flat(0.75);
        assert_eq!((flat.at(DVec2::ZERO), flat.at(DVec2::splat(9.0))), (0.75, 0.75), "flat");
        let anchor = DVec3::new(1.0, 2.0, 3.0);
        // half a metre nearer a metre to the right, a quarter farther a metre up
        let at = |x: f64, y: f64| (anchor + DVec3::new(x, y, 0.5 * x - 0.25 * y), 2.0);
        let square = [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(x, y)| at(x, y));
        let found = Depth::through(anchor, 3.5, square.into_iter(), &FRONT);
        assert_eq!(found.at(DVec2::new(1.0, 2.0)), 3.0, "through the anchor");
        // spread 8 along each axis, and 0.02 of 16 more
        let calmed = 8.0 / 8.32;
        let right = found.at(DVec2::new(2.0, 2.0)) - 3.0;
        assert!((right - 0.5 * calmed).abs() < 1e-12, "{right} for 0.5, calmed");
        let up = found.at(DVec2::new(1.0, 3.0)) - 3.0;
        assert!((up + 0.25 * calmed).abs() < 1e-12, "{up} for -0.25, calmed");
        assert_eq!(found.mean, 3.5, "as given");
    }

    #[test]
    fn what_is_larger_counts_for_more() {
        let places = [(DVec3::new(1.0, 0.0, 1.0), 3.0), (DVec3::X, 1.0)];
        let found = Depth::through(DVec3::ZERO, 0.0, places.into_iter(), &FRONT);
        // spread 4, and 0.02 of it more
        assert!((found.at(DVec2::X) - 3.0 / 4.08).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn planes_are_never_steep() {
        let through =
            |places: &[Weighed]| Depth::through(DVec3::ZERO, 0.0, places.iter().copied(), &FRONT);
        let steep =
            through(&[(DVec3::new(1.0, 0.0, 50.0), 1.0), (DVec3::new(0.5, 0.1, 20.0), 1.0)]);
        let lean = DVec2::new(steep.at(DVec2::X), steep.at(DVec2::Y));
        assert!((lean.length() - 1.0).abs() < 1e-12, "at most 45 degrees: {lean}");
        for nothing in [&[][..], &[(DVec3::Z * 3.0, 1.0)], &[(DVec3::X, 0.0)]] {
            let flat = through(nothing);
            assert_eq!((flat.at(DVec2::X), flat.at(DVec2::Y)), (0.0, 0.0), "{nothing:?}");
        }
    }
}
