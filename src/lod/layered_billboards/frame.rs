//! The axes of the picture that layers are baked from, and the grid that their texels share.
//!
//! All layers' rectangles have their sides on one grid of square texels. Seen from where they were
//! baked, with a pixel a texel, every texel lies on a pixel.

use glam::{DVec2, DVec3};

use crate::bake::BakeRect;
use crate::error::LodError;

/// A side that misses a grid line by less than this share of a texel lies on it.
const ON_LINE: f64 = 1e-6;

/// Unit vectors across each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub(super) right: DVec3,
    pub(super) up: DVec3,
    /// From the plant to the viewer.
    pub(super) toward: DVec3,
}

impl Frame {
    /// The picture's up is the world's, or -z for a direction that is up itself.
    ///
    /// # Errors
    /// A direction of length 0, or that is not finite.
    pub(super) fn new(direction: DVec3) -> Result<Self, LodError> {
        let toward = direction.normalize_or_zero();
        if toward == DVec3::ZERO {
            let why = format!("must be finite and not 0, got {direction}");
            return Err(LodError::Invalid { name: "direction", why });
        }
        let up_hint = if toward.y.abs() > 1.0 - 1e-9 { DVec3::NEG_Z } else { DVec3::Y };
        let right = up_hint.cross(toward).normalize();
        Ok(Self { right, up: toward.cross(right), toward })
    }

    /// Where a point is seen.
    pub(super) fn seen(&self, point: DVec3) -> DVec2 {
        DVec2::new(point.dot(self.right), point.dot(self.up))
    }
}

/// Square texels over what is baked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Grid {
    pub(super) frame: Frame,
    /// Where the lower left corner is, from the crown's centre.
    low: DVec2,
    /// Metres a texel.
    pub(super) texel: f64,
    /// Columns and rows.
    count: DVec2,
    /// The crown's centre.
    center: DVec3,
    /// Of anything from there.
    reach: f64,
}

/// Texels of the grid: the first ones, and how many from there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Cells {
    first: [u32; 2],
    pub(super) size: (u32, u32),
}

impl Grid {
    /// `texel_count` texels along the longer side of a box, or fewer if there may be no more than
    /// `most_per_metre`.
    pub(super) fn new(
        frame: Frame,
        center: DVec3,
        reach: f64,
        (low, high): (DVec2, DVec2),
        texel_count: u32,
        most_per_metre: f64,
    ) -> Self {
        let side = (high - low).max_element();
        let texel = (side / f64::from(texel_count)).max(1.0 / most_per_metre);
        // never more than one texel for what is smaller than a texel
        let texel = texel.min(side);
        let count = ((high - low) / texel - ON_LINE).ceil().max(DVec2::ONE);
        Self { frame, low, texel, count, center, reach }
    }

    /// All texels.
    pub(super) fn whole(&self) -> Cells {
        let [width, height] = whole(self.count);
        Cells { first: [0, 0], size: (width, height) }
    }

    /// The texels that a box inside touches, at least one.
    pub(super) fn cells(&self, (low, high): (DVec2, DVec2)) -> Cells {
        let from = ((low - self.low) / self.texel + ON_LINE).floor();
        // a point on the last line is in the last texel
        let from = from.clamp(DVec2::ZERO, self.count - 1.0);
        let to = ((high - self.low) / self.texel - ON_LINE).ceil();
        let to = to.max(from + 1.0).min(self.count);
        let (first, end) = (whole(from), whole(to));
        Cells { first, size: (end[0] - first[0], end[1] - first[1]) }
    }

    /// Where some texels lie, `offset` metres in front of the crown's centre.
    pub(super) fn rect(&self, cells: Cells, offset: f64) -> BakeRect {
        let Frame { right, up, toward } = self.frame;
        let corner =
            self.low + DVec2::new(cells.first[0].into(), cells.first[1].into()) * self.texel;
        let size = DVec2::new(cells.size.0.into(), cells.size.1.into()) * self.texel;
        let middle = corner + size * 0.5;
        BakeRect {
            center: self.center + right * middle.x + up * middle.y + toward * offset,
            right,
            up,
            width: size.x,
            height: size.y,
            reach: self.reach,
        }
    }

    /// Where in the picture of all `whole` texels some of them begin: columns from its left, rows from
    /// its top.
    pub(super) fn inside(whole: Cells, cells: Cells) -> (u32, u32) {
        let top = |cells: Cells| cells.first[1] + cells.size.1;
        (cells.first[0] - whole.first[0], top(whole) - top(cells))
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "not below 0, and at most the number of texels"
)]
fn whole(v: DVec2) -> [u32; 2] {
    [v.x as u32, v.y as u32]
}
