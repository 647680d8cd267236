//! A camera and what follows from it: where points land, how large a pixel is, what can be seen.
//!
//! Right-handed, y up; the camera looks along its -z. Pixel centres lie at half-integers, row 0 is
//! on top. Depth is the distance along the viewing direction, not along the ray. Everything here is
//! f64: only numbers relative to the eye are ever rounded to f32.

use glam::{DVec2, DVec3};

use crate::error::{LodError, check_finite, check_in};

/// Largest side of a picture, in pixels.
pub const MAX_FRAME_SIDE: u32 = 16384;

/// Largest distance from the world's origin, in metres, of an eye or of anything that is placed:
/// its square still is an f32.
pub const MAX_COORDINATE: f64 = 1e18;

/// How depth changes what lands where.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Projection {
    /// Straight lines through the eye.
    Perspective {
        /// Full vertical angle, radians, in (0, pi).
        fov_y: f64,
    },
    /// Parallel lines.
    Orthographic {
        /// Height of the picture in metres.
        height: f64,
    },
}

/// A camera with its picture's size.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// World position.
    pub eye: DVec3,
    /// Unit vector to the picture's right.
    pub right: DVec3,
    /// Unit vector to the picture's top.
    pub up: DVec3,
    /// Unit vector from the picture towards the viewer.
    pub back: DVec3,
    /// Perspective or parallel.
    pub projection: Projection,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Nothing nearer than this depth is drawn; above 0.
    pub near: f64,
    /// Pixels a metre across over pixels a metre up: 1 for cameras, anything for bakes.
    pub pixel_aspect: f64,
    /// When the picture is taken, in seconds: what moves by itself moves with it.
    pub time_secs: f64,
}

impl View {
    /// A camera at `eye` that looks at `target`; `up` need not be exact or unit length.
    ///
    /// # Errors
    /// The first argument that is not finite or out of range; `target` if it equals `eye`, `up` if
    /// it is parallel to the viewing direction.
    pub fn new(
        eye: DVec3,
        target: DVec3,
        up: DVec3,
        projection: Projection,
        size: (u32, u32),
        near: f64,
    ) -> Result<Self, LodError> {
        check_finite("eye", &[eye])?;
        check_finite("target", &[target])?;
        check_finite("up", &[up])?;
        for (name, point) in [("eye", eye), ("target", target)] {
            if point.abs().max_element() > MAX_COORDINATE {
                let why = format!("lies more than {MAX_COORDINATE:e} m from the world's origin");
                return Err(LodError::Invalid { name, why });
            }
        }
        let back = (eye - target).normalize_or_zero();
        // also where they are so near that the difference has no square
        if back == DVec3::ZERO {
            return Err(LodError::Invalid { name: "target", why: "equals the eye".to_owned() });
        }
        let right = up.cross(back).normalize_or_zero();
        if right == DVec3::ZERO {
            let why = "is parallel to the viewing direction".to_owned();
            return Err(LodError::Invalid { name: "up", why });
        }
        check_in("size", size.0, 1..=MAX_FRAME_SIDE)?;
        check_in("size", size.1, 1..=MAX_FRAME_SIDE)?;
        match projection {
            Projection::Perspective { fov_y } => {
                check_in("fov_y_deg", fov_y.to_degrees(), 1e-6..=179.999_999)?;
            }
            Projection::Orthographic { height } => {
                check_in("height", height, 1.0 / MAX_COORDINATE..=MAX_COORDINATE)?;
            }
        }
        check_in("near", near, 1.0 / MAX_COORDINATE..=MAX_COORDINATE)?;
        Ok(Self {
            eye,
            right,
            up: back.cross(right),
            back,
            projection,
            width: size.0,
            height: size.1,
            near,
            pixel_aspect: 1.0,
            time_secs: 0.0,
        })
    }

    /// Whether lines are parallel.
    pub fn is_orthographic(&self) -> bool {
        matches!(self.projection, Projection::Orthographic { .. })
    }

    /// Vertical pixels a metre at depth 1 (perspective) or at any depth (orthographic).
    pub fn pixels_per_metre_at_one(&self) -> f64 {
        let rows = f64::from(self.height);
        match self.projection {
            Projection::Perspective { fov_y } => rows / (2.0 * libm::tan(fov_y / 2.0)),
            Projection::Orthographic { height } => rows / height,
        }
    }

    /// Size of a pixel in metres at a depth.
    pub fn pixel_size_at(&self, depth: f64) -> f64 {
        let scale = self.pixels_per_metre_at_one();
        if self.is_orthographic() { 1.0 / scale } else { depth / scale }
    }

    /// A world point relative to the camera: right, up, and depth.
    pub fn view_from_world(&self, point: DVec3) -> DVec3 {
        let relative = point - self.eye;
        DVec3::new(relative.dot(self.right), relative.dot(self.up), -relative.dot(self.back))
    }

    /// Pixel coordinates and depth of a world point; `None` nearer than the near plane of a
    /// perspective view.
    pub fn project(&self, point: DVec3) -> Option<(DVec2, f64)> {
        let p = self.view_from_world(point);
        if !self.is_orthographic() && p.z < self.near {
            return None;
        }
        let scale = self.pixels_per_metre_at_one() / if self.is_orthographic() { 1.0 } else { p.z };
        let center = DVec2::new(f64::from(self.width), f64::from(self.height)) * 0.5;
        Some((center + DVec2::new(p.x * self.pixel_aspect, -p.y) * scale, p.z))
    }

    /// Whether any part of a ball may be seen.
    pub fn sees_ball(&self, center: DVec3, radius: f64) -> bool {
        let p = self.view_from_world(center);
        if p.z + radius < self.near {
            return false;
        }
        let scale = self.pixels_per_metre_at_one();
        let sides = DVec2::new(f64::from(self.width) / self.pixel_aspect, f64::from(self.height));
        let half = sides * (0.5 / scale);
        match self.projection {
            Projection::Orthographic { .. } => {
                p.x.abs() - radius <= half.x && p.y.abs() - radius <= half.y
            }
            // a side plane leans outward by `half` a metre of depth
            Projection::Perspective { .. } => [(p.x, half.x), (p.y, half.y)]
                .iter()
                .all(|&(offset, slope)| offset.abs() - slope * p.z <= radius * slope.hypot(1.0)),
        }
    }

    /// Pixels (left, top, right, bottom; ends exclusive) that a world box can touch, inside the
    /// picture. Empty boxes have left = right.
    pub fn bounds_px(&self, low: DVec3, high: DVec3) -> [u32; 4] {
        let corners: Vec<DVec3> = (0..8)
            .map(|i| {
                let pick = |bit: u32, a: f64, b: f64| if i >> bit & 1 == 0 { a } else { b };
                DVec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z))
            })
            .collect();
        let full = [0, 0, self.width, self.height];
        let views: Vec<DVec3> = corners.iter().map(|&c| self.view_from_world(c)).collect();
        if views.iter().all(|p| p.z < self.near) {
            return [0; 4];
        }
        let mut box_low = DVec2::INFINITY;
        let mut box_high = DVec2::NEG_INFINITY;
        for corner in corners {
            // a box that reaches behind the near plane may touch any pixel
            let Some((pixel, _)) = self.project(corner) else { return full };
            box_low = box_low.min(pixel);
            box_high = box_high.max(pixel);
        }
        let clamp = |value: f64, limit: u32| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
            let pixel = value.clamp(0.0, f64::from(limit)) as u32;
            pixel
        };
        let left = clamp(box_low.x.floor(), self.width);
        let top = clamp(box_low.y.floor(), self.height);
        let right = clamp(box_high.x.ceil(), self.width);
        let bottom = clamp(box_high.y.ceil(), self.height);
        if left >= right || top >= bottom { [0; 4] } else { [left, top, right, bottom] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn perspective() -> View {
        let projection = Projection::Perspective { fov_y: std::f64::consts::FRAC_PI_2 };
        View::new(DVec3::new(0.0, 0.0, 10.0), DVec3::ZERO, DVec3::Y, projection, (200, 100), 0.01)
            .expect("valid")
    }

    #[test]
    fn the_target_lands_in_the_middle() {
        let view = perspective();
        let (pixel, depth) = view.project(DVec3::ZERO).expect("in front");
        assert!((pixel - DVec2::new(100.0, 50.0)).length() < 1e-12, "{pixel}");
        assert!((depth - 10.0).abs() < 1e-12, "{depth}");
        // 90 degrees: half the height, 50 pixels, is as many metres as the depth
        let (pixel, _) = view.project(DVec3::new(2.0, 1.0, 0.0)).expect("in front");
        assert!((pixel - DVec2::new(110.0, 45.0)).length() < 1e-9, "right and up: {pixel}");
        assert!(view.project(DVec3::new(0.0, 0.0, 11.0)).is_none(), "behind the eye");
        assert!((view.pixel_size_at(10.0) - 0.2).abs() < 1e-12, "20 m are 100 pixels");
    }

    #[test]
    fn orthographic_ignores_depth() {
        let projection = Projection::Orthographic { height: 10.0 };
        let view = View::new(DVec3::Z, DVec3::ZERO, DVec3::Y, projection, (20, 20), 1e-3);
        let view = view.expect("valid");
        for z in [-100.0, 0.0, 0.5] {
            let (pixel, depth) = view.project(DVec3::new(1.0, 2.0, z)).expect("parallel");
            assert_eq!((pixel, depth), (DVec2::new(12.0, 6.0), 1.0 - z), "z = {z}");
        }
    }

    #[test]
    fn balls_outside_the_frustum_are_not_seen() {
        let view = perspective();
        assert!(view.sees_ball(DVec3::ZERO, 1.0), "at the target");
        assert!(!view.sees_ball(DVec3::new(0.0, 0.0, 20.0), 1.0), "behind");
        assert!(view.sees_ball(DVec3::new(0.0, 0.0, 10.5), 1.0), "around the eye");
        // the top plane leans at 45 degrees: at depth 10 it is 10 m up
        assert!(view.sees_ball(DVec3::new(0.0, 11.3, 0.0), 1.0), "touches the top plane");
        assert!(!view.sees_ball(DVec3::new(0.0, 11.5, 0.0), 1.0), "above the top plane");
    }

    #[test]
    fn boxes_land_on_pixels() {
        let view = perspective();
        let cube = view.bounds_px(DVec3::splat(-1.0), DVec3::ONE);
        assert_eq!(cube, [94, 44, 106, 56], "front face at depth 9: 5.6 pixels a side");
        let behind = view.bounds_px(DVec3::new(-1.0, -1.0, 12.0), DVec3::new(1.0, 1.0, 13.0));
        assert_eq!(behind, [0; 4], "behind the camera");
        let around = view.bounds_px(DVec3::splat(-20.0), DVec3::splat(20.0));
        assert_eq!(around, [0, 0, 200, 100], "the camera stands inside");
    }

    #[test]
    fn bad_cameras_are_refused() {
        let make = |eye: DVec3, up: DVec3, fov_y: f64, size: (u32, u32)| {
            View::new(eye, DVec3::ZERO, up, Projection::Perspective { fov_y }, size, 0.1)
        };
        let cases = [
            (make(DVec3::ZERO, DVec3::Y, 1.0, (8, 8)), "target"),
            (make(DVec3::NAN, DVec3::Y, 1.0, (8, 8)), "eye"),
            (make(DVec3::Y, DVec3::Y, 1.0, (8, 8)), "up"),
            (make(DVec3::Z * 1e19, DVec3::Y, 1.0, (8, 8)), "eye"),
            (make(DVec3::Z, DVec3::Y, 0.0, (8, 8)), "fov_y_deg"),
            (make(DVec3::Z, DVec3::Y, f64::NAN, (8, 8)), "fov_y_deg"),
            (make(DVec3::Z, DVec3::Y, 1.0, (0, 8)), "size"),
            (make(DVec3::Z, DVec3::Y, 1.0, (8, 1_000_000)), "size"),
        ];
        for (result, name) in cases {
            let message = result.expect_err(name).to_string();
            assert!(message.starts_with(name), "{name}: {message}");
        }
    }
}
