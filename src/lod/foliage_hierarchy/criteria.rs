//! Which parts of a crown a user wants finer: what can be asked for, and what is refused.
//!
//! A criterion says for each node whether it lies in the *zone of interest*, which is drawn finer. It
//! speaks of places in the plant's own space, relative to its origin, and of how a view shows them;
//! [`zone`](crate::lod::foliage_hierarchy::zone) answers it for one view.
//!
//! This work is based on: I. Remolar, M. Chover, J. Ribelles, O. Belmonte. View-Dependent
//! Multiresolution Model for Foliage. Journal of WSCG 11(1), 2003.

use std::fmt;
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::error::{LodError, check_finite, check_in, check_limit};
use crate::lod::foliage_hierarchy::forest::Forest;
use crate::view::{MAX_COORDINATE, View};

/// Criteria within one another.
pub const MAX_DEPTH: u64 = 64;

/// Criteria in one.
pub const MAX_PART_COUNT: u64 = 1024;

/// A view of a placed copy.
#[derive(Debug, Clone, Copy)]
pub struct Placed<'a> {
    /// From where, in the scene's world.
    pub view: &'a View,
    /// Where the copy stands: the scene's world from the plant's space, relative to its origin.
    pub world_from_local: DAffine3,
}

type MaskFunction = dyn Fn(&Forest, &Placed<'_>) -> Result<Vec<bool>, LodError> + Send + Sync;

/// A criterion of the caller's own, asked once an update for all nodes.
#[derive(Clone)]
pub struct Mask(Arc<MaskFunction>);

impl Mask {
    /// `answers` says for each node, in the forest's order, whether it is in the zone.
    pub fn new(
        answers: impl Fn(&Forest, &Placed<'_>) -> Result<Vec<bool>, LodError> + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(answers))
    }

    /// One answer a node.
    ///
    /// # Errors
    /// What the function returns; [`LodError::Invalid`] if it does not answer for each node.
    pub fn ask(&self, forest: &Forest, placed: &Placed<'_>) -> Result<Vec<bool>, LodError> {
        let answers = (self.0)(forest, placed)?;
        if answers.len() == forest.nodes.len() {
            return Ok(answers);
        }
        let (got, asked) = (answers.len(), forest.nodes.len());
        let why = format!("must answer for each of {asked} nodes, got {got} answers");
        Err(LodError::Invalid { name: "criterion", why })
    }
}

impl fmt::Debug for Mask {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Mask")
    }
}

/// What is drawn finer.
#[derive(Debug, Clone)]
pub enum Criterion {
    /// Nodes whose own quad has its centre in a ball, or out of it.
    Sphere {
        /// Relative to the plant's origin.
        center: DVec3,
        /// Metres, at least 0; a quad exactly on the surface is inside.
        radius: f64,
        /// Whether the inside is finer. The paper's is coarse inside.
        is_fine_inside: bool,
        /// Metres by which the radius grows for each metre between eye and centre, in the plant's
        /// space: a plant of twice the size, seen from twice as far, looks the same.
        growth: f64,
    },
    /// Nodes whose own quad has its centre on the side of a plane that its normal points to.
    Plane {
        /// On the plane, relative to the plant's origin; a quad exactly there is not in the zone.
        point: DVec3,
        /// Of any length above 0.
        normal: DVec3,
    },
    /// Nodes whose ball, which holds all that lies below them, reaches into the view's frustum. So
    /// all that may be seen is fine.
    Frustum,
    /// Nodes whose ball looks larger than this across, if it stood in the middle of the picture: the
    /// outline of a ball of radius r at distance d is `2 r / sqrt(d^2 - r^2)` wide at depth 1, and
    /// without limit once the eye is inside. A copy that is stretched counts with the longest axis.
    /// In a parallel view distance plays no part.
    ScreenSize {
        /// At least 0.
        pixels: f64,
    },
    /// Nodes whose own quad has its centre nearer to the eye than this, in the scene's metres, in any
    /// projection.
    Distance {
        /// At least 0.
        max_distance: f64,
    },
    /// Nodes in all of them; all nodes, if there are none.
    And(Vec<Self>),
    /// Nodes in any of them; no node, if there are none.
    Or(Vec<Self>),
    /// Nodes that are not in it.
    Not(Box<Self>),
    /// Nodes that a function says.
    Mask(Mask),
}

impl Criterion {
    /// Whether all numbers have a meaning, and the whole is neither too deep nor too large.
    ///
    /// # Errors
    /// [`LodError`] that names the Python argument.
    pub fn check(&self) -> Result<(), LodError> {
        let (mut part_count, mut open) = (0, vec![(self, 1)]);
        while let Some((criterion, depth)) = open.pop() {
            part_count += 1;
            check_limit("criterion", depth, MAX_DEPTH, "criteria within one another")?;
            check_limit("criterion", part_count, MAX_PART_COUNT, "parts")?;
            criterion.check_numbers()?;
            match criterion {
                Self::And(parts) | Self::Or(parts) => {
                    open.extend(parts.iter().map(|part| (part, depth + 1)));
                }
                Self::Not(part) => open.push((part, depth + 1)),
                _ => {}
            }
        }
        Ok(())
    }

    fn check_numbers(&self) -> Result<(), LodError> {
        match *self {
            Self::Sphere { center, radius, growth, .. } => {
                check_point("center", center)?;
                check_in("radius", radius, 0.0..=MAX_COORDINATE)?;
                check_in("growth", growth, 0.0..=MAX_COORDINATE)
            }
            Self::Plane { point, normal } => {
                check_point("point", point)?;
                check_finite("normal", &[normal])?;
                if normal.normalize_or_zero() == DVec3::ZERO {
                    let why = "must not be the zero vector".to_owned();
                    return Err(LodError::Invalid { name: "normal", why });
                }
                Ok(())
            }
            Self::ScreenSize { pixels } => check_in("pixels", pixels, 0.0..=MAX_COORDINATE),
            Self::Distance { max_distance } => {
                check_in("max_distance", max_distance, 0.0..=MAX_COORDINATE)
            }
            Self::Frustum | Self::And(_) | Self::Or(_) | Self::Not(_) | Self::Mask(_) => Ok(()),
        }
    }
}

fn check_point(name: &'static str, point: DVec3) -> Result<(), LodError> {
    check_finite(name, &[point])?;
    if point.abs().max_element() <= MAX_COORDINATE {
        return Ok(());
    }
    let why = format!("lies more than {MAX_COORDINATE:e} m from the plant's origin");
    Err(LodError::Invalid { name, why })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_without_a_meaning_are_refused_by_name() {
        let sphere = |radius, growth| Criterion::Sphere {
            center: DVec3::ZERO,
            radius,
            is_fine_inside: true,
            growth,
        };
        let plane = |point, normal| Criterion::Plane { point, normal };
        let cases = [
            (sphere(-1.0, 0.0), "radius must be in [0, 1000000000000000000], got -1"),
            (sphere(f64::NAN, 0.0), "radius must be in [0, 1000000000000000000], got NaN"),
            (sphere(1.0, -0.5), "growth must be in [0, 1000000000000000000], got -0.5"),
            (plane(DVec3::NAN, DVec3::X), "point must be finite: element 0 is not"),
            (
                plane(DVec3::X * 1e19, DVec3::X),
                "point: lies more than 1e18 m from the plant's origin",
            ),
            (plane(DVec3::ZERO, DVec3::ZERO), "normal: must not be the zero vector"),
            (plane(DVec3::ZERO, DVec3::INFINITY), "normal must be finite: element 0 is not"),
            (
                Criterion::ScreenSize { pixels: -1.0 },
                "pixels must be in [0, 1000000000000000000], got -1",
            ),
            (
                Criterion::Distance { max_distance: f64::INFINITY },
                "max_distance must be in [0, 1000000000000000000], got inf",
            ),
        ];
        for (criterion, expected) in cases {
            let nested =
                Criterion::Not(Box::new(Criterion::Or(vec![Criterion::Frustum, criterion])));
            assert_eq!(nested.check().expect_err(expected).to_string(), expected, "named");
        }
        assert_eq!(sphere(0.0, 0.0).check(), Ok(()), "a ball of one point");
    }

    #[test]
    fn depth_and_size_have_limits() {
        let nested =
            |count| (1..count).fold(Criterion::Frustum, |inner, _| Criterion::Not(Box::new(inner)));
        assert_eq!(nested(MAX_DEPTH).check(), Ok(()), "as deep as is allowed");
        let deep = nested(MAX_DEPTH + 1).check().expect_err("too deep").to_string();
        assert_eq!(deep, "criterion needs 65 criteria within one another, the limit is 64", "said");
        let wide = |count| Criterion::And(vec![Criterion::Frustum; count]);
        assert_eq!(wide(1023).check(), Ok(()), "1024 with the one around them");
        assert!(wide(1024).check().is_err(), "one too many");
    }
}
