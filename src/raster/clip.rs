//! Clipping in f64, for the few shapes that reach behind the eye or far outside the picture.
//!
//! A cut is computed from an edge's inner to its outer end, so two triangles that share an edge get
//! the same new corner and stay watertight.
//!
//! This work is based on:
//! Ivan Sutherland, Gary Hodgman. Reentrant polygon clipping. 1974

use glam::{DVec3, DVec4};

/// From local coordinates to the picture, before the division by depth.
#[derive(Clone, Debug)]
pub(crate) struct ClipSpace {
    pub(crate) rows: [DVec3; 3],
    pub(crate) offset: DVec3,
    pub(crate) center: [f64; 2],
    pub(crate) near: f64,
    pub(crate) perspective: bool,
}

impl ClipSpace {
    /// x, y in pixels from the picture's centre (times depth in perspective), and depth.
    fn transform(&self, local: DVec3) -> DVec3 {
        DVec3::from_array(self.rows.map(|row| row.dot(local))) + self.offset
    }

    /// Pixel x, y and depth key of a transformed point.
    fn project(&self, p: DVec3) -> [f32; 3] {
        let (scale, key) = if self.perspective { (1.0 / p.z, 1.0 / p.z) } else { (1.0, -p.z) };
        #[expect(clippy::cast_possible_truncation, reason = "pixels and keys are stored in f32")]
        let point = [
            (p.x * scale + self.center[0]) as f32,
            (p.y * scale + self.center[1]) as f32,
            key as f32,
        ];
        point
    }

    /// The planes that keep shapes in front and within `guard` pixels, as (normal, offset): inside
    /// where normal.p + offset >= 0.
    fn planes(&self, guard: f64) -> impl Iterator<Item = DVec4> + use<> {
        let near = DVec4::new(0.0, 0.0, 1.0, -self.near);
        // half the guard, so that rounding and the picture's centre stay within it
        let limit = guard * 0.5;
        let side = if self.perspective { (limit, 0.0) } else { (0.0, limit) };
        let sides = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
        std::iter::once(near).chain(sides.map(|(x, y)| DVec4::new(x, y, side.0, side.1)))
    }

    /// Whether a transformed point lies inside all planes.
    fn holds(&self, p: DVec3, guard: f64) -> bool {
        let limit = guard * 0.5;
        let reach = if self.perspective { limit * p.z } else { limit };
        p.z - self.near >= 0.0
            && p.x + reach >= 0.0
            && reach - p.x >= 0.0
            && p.y + reach >= 0.0
            && reach - p.y >= 0.0
    }

    /// Both ends of a line as (x, y, key), cut to what is in front and within `guard` pixels; `None`
    /// if nothing is.
    pub(crate) fn line(&self, ends: [DVec3; 2], guard: f64) -> Option<[[f32; 3]; 2]> {
        let [mut a, mut b] = ends.map(|p| self.transform(p));
        // most lines: no plane cuts them
        if self.holds(a, guard) && self.holds(b, guard) {
            return Some([self.project(a), self.project(b)]);
        }
        for plane in self.planes(guard) {
            let distance = |p: DVec3| plane.truncate().dot(p) + plane.w;
            let (at_a, at_b) = (distance(a), distance(b));
            if at_a < 0.0 && at_b < 0.0 {
                return None;
            }
            let cut = || a + (b - a) * (at_a / (at_a - at_b));
            if at_a < 0.0 {
                a = cut();
            } else if at_b < 0.0 {
                b = cut();
            }
        }
        Some([self.project(a), self.project(b)])
    }

    /// What gives the weights of a triangle's corners anywhere on the picture.
    pub(crate) fn weight_forms(&self, corners: [DVec3; 3]) -> WeightForms {
        let [a, b, c] = corners.map(|p| {
            let at = self.transform(p);
            // parallel rays meet the plane at depth 1 in the same weights
            if self.perspective { at } else { DVec3::new(at.x, at.y, 1.0) }
        });
        WeightForms { forms: [b.cross(c), c.cross(a), a.cross(b)], center: self.center }
    }
}

/// Perspective-correct weights of a triangle's corners, clamped to the triangle.
///
/// Works for corners behind the eye: the weights solve `sum w_i corner_i = s (x, y, 1)`, so each is
/// linear on the picture up to a factor that they share.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WeightForms {
    forms: [DVec3; 3],
    center: [f64; 2],
}

impl WeightForms {
    #[inline(always)]
    pub(crate) fn at(&self, [x, y]: [f64; 2]) -> [f32; 3] {
        let (x, y) = (x - self.center[0], y - self.center[1]);
        let raw = self.forms.map(|form| form.x * x + form.y * y + form.z);
        let sign = if raw[0] + raw[1] + raw[2] < 0.0 { -1.0 } else { 1.0 };
        let positive = raw.map(|w| (w * sign).max(0.0));
        let total = positive[0] + positive[1] + positive[2];
        let is_known = total > 0.0 && total.is_finite();
        #[expect(clippy::cast_possible_truncation, reason = "weights in [0, 1]")]
        let weights = positive.map(|w| if is_known { (w / total) as f32 } else { 1.0 / 3.0 });
        weights
    }
}

/// Corners (x, y, key) of the part of a triangle that is in front and within `guard` pixels.
pub(crate) fn clip_polygon(space: &ClipSpace, local: [DVec3; 3], guard: f64) -> Vec<[f32; 3]> {
    let mut polygon: Vec<DVec3> = local.iter().map(|&p| space.transform(p)).collect();
    for plane in space.planes(guard) {
        let distance = |p: DVec3| plane.truncate().dot(p) + plane.w;
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for (i, &p) in polygon.iter().enumerate() {
            let q = polygon[(i + 1) % polygon.len()];
            let (at_p, at_q) = (distance(p), distance(q));
            if at_p >= 0.0 {
                kept.push(p);
            }
            if (at_p >= 0.0) != (at_q >= 0.0) {
                let (inner, outer, from, to) =
                    if at_p >= 0.0 { (p, q, at_p, at_q) } else { (q, p, at_q, at_p) };
                kept.push(inner + (outer - inner) * (from / (from - to)));
            }
        }
        polygon = kept;
        if polygon.len() < 3 {
            return Vec::new();
        }
    }
    polygon.into_iter().map(|p| space.project(p)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn space() -> ClipSpace {
        ClipSpace {
            rows: [DVec3::X, DVec3::Y, DVec3::Z],
            offset: DVec3::ZERO,
            center: [0.0, 0.0],
            near: 1.0,
            perspective: true,
        }
    }

    #[test]
    fn a_corner_behind_the_near_plane_is_cut_off() {
        //  depth 2 ---- 2      the cut at depth 1 is half way to the corner at depth 0
        //         \    /
        //           0
        let corners =
            [DVec3::new(-2.0, 0.0, 2.0), DVec3::new(2.0, 0.0, 2.0), DVec3::new(0.0, 2.0, 0.0)];
        let polygon = clip_polygon(&space(), corners, 1e6);
        let expected = [[-1.0, 0.0, 0.5], [1.0, 0.0, 0.5], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]];
        assert_eq!(polygon, expected, "a quad");
        let behind = corners.map(|p| p - DVec3::Z * 2.0);
        assert!(clip_polygon(&space(), behind, 1e6).is_empty(), "all behind");
    }

    #[test]
    fn weights_see_through_the_eye() {
        let corners =
            [DVec3::new(0.0, 0.0, 4.0), DVec3::new(4.0, 0.0, 4.0), DVec3::new(0.0, 4.0, -4.0)];
        let weights = space().weight_forms(corners).at([0.5, 0.0]);
        assert_eq!(weights, [0.5, 0.5, 0.0], "half way along the edge in front");
        // three quarters of the first corner and one of the third make (0, 1, 2): pixel (0, 0.5)
        let weights = space().weight_forms(corners).at([0.0, 0.5]);
        assert_eq!(weights, [0.75, 0.0, 0.25], "between a corner in front and one behind");
        let [a, b, c] = corners;
        let weights = space().weight_forms([b, a, c]).at([0.0, 0.5]);
        assert_eq!(weights, [0.0, 0.75, 0.25], "the same seen from its other side");
    }

    #[test]
    fn lines_are_cut_at_the_near_plane() {
        let ends = [DVec3::new(0.0, 0.0, 2.0), DVec3::new(2.0, 0.0, 0.0)];
        let cut = space().line(ends, 1e6).expect("half of it is in front");
        assert_eq!(cut, [[0.0, 0.0, 0.5], [1.0, 0.0, 1.0]], "cut half way");
        let long = [DVec3::new(0.0, 0.0, 1.0), DVec3::new(1e9, 0.0, 1.0)];
        let cut = space().line(long, 100.0).expect("it begins in the picture");
        assert_eq!(cut, [[0.0, 0.0, 1.0], [50.0, 0.0, 1.0]], "cut at half the guard");
        assert!(space().line(ends.map(|p| p - DVec3::Z * 2.0), 1e6).is_none(), "behind");
    }
}
