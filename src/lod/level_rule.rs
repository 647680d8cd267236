//! Which level of detail a view shows, and how far it is on its way to the next.
//!
//! A technique may show level `i` as it is until level `i + 1` takes over, or lead from the one to the
//! other as the share `t` rises from 0 to 1.

use glam::DVec3;

use crate::error::{LodError, check_in};
use crate::lod::Crown;
use crate::view::View;

/// What decides the level.
#[derive(Debug, Clone, PartialEq)]
pub enum LevelRule {
    /// The coarsest level whose error is at most this many pixels at the crown's near side.
    Pixels(f64),
    /// Level `i` up to the `i`-th distance of the eye from the crown's centre, in crown radii.
    Distances(Vec<f64>),
    /// Always the same.
    Fixed(Choice),
}

/// A level and the share of the way to the next one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// 0 is the finest.
    pub level: usize,
    /// In [0, 1].
    pub t: f64,
}

/// What a rule measures a view by.
pub(crate) struct Seen<'a> {
    pub(crate) view: &'a View,
    pub(crate) crown: &'a Crown,
    /// Eye to the crown's centre over the crown's radius; depth in parallel views.
    pub(crate) distance_rel: f64,
    /// Crown's radius, in the crown's own metres.
    pub(crate) radius: f64,
}

impl LevelRule {
    /// Checks the numbers for a number of levels.
    ///
    /// # Errors
    /// `level_error_px` below 0, or `level_distances` that do not rise or are not one less than levels.
    pub(crate) fn check(&self, level_count: usize) -> Result<(), LodError> {
        let distances = match self {
            Self::Fixed(_) => return Ok(()),
            Self::Pixels(error_px) => return check_in("level_error_px", *error_px, 0.0..=1e9),
            Self::Distances(distances) => distances,
        };
        let rising = distances.windows(2).all(|pair| pair[0] < pair[1]);
        let positive = distances.iter().all(|&far| far > 0.0 && far.is_finite());
        if distances.len() + 1 == level_count && rising && positive {
            return Ok(());
        }
        let why = format!(
            "{level_count} levels change at {} rising distances, got {distances:?}",
            level_count - 1
        );
        Err(LodError::Invalid { name: "level_distances", why })
    }

    /// The level of a view; `errors` are those of the levels in metres, and never fall.
    pub(crate) fn choose(&self, errors: &[f64], seen: &Seen<'_>) -> Choice {
        match self {
            Self::Fixed(choice) => *choice,
            Self::Pixels(error_px) => between(errors, error_px * seen.pixel_size()),
            Self::Distances(distances) => {
                let at = distances.partition_point(|&far| far <= seen.distance_rel);
                if at == distances.len() {
                    return Choice { level: at, t: 0.0 };
                }
                let near = if at == 0 { 0.0 } else { distances[at - 1] };
                Choice { level: at, t: share(near, distances[at], seen.distance_rel) }
            }
        }
    }
}

impl<'a> Seen<'a> {
    /// A crown of a centre and a radius in its own coordinates, as a view sees it.
    pub(crate) fn new(view: &'a View, crown: &'a Crown, center: DVec3, radius: f64) -> Self {
        let distance = if view.is_orthographic() {
            let depth = view.view_from_world(crown.world_from_local.transform_point3(center)).z;
            depth / crown.scale()
        } else {
            (crown.local_eye(view) - center).length()
        };
        // a crown that is a point is seen from afar
        let distance_rel = if radius > 0.0 { distance / radius } else { f64::INFINITY };
        Self { view, crown, distance_rel, radius }
    }

    /// Of a pixel, in the crown's own metres, where the crown is nearest.
    pub(crate) fn pixel_size(&self) -> f64 {
        let scale = self.crown.scale();
        let depth = ((self.distance_rel - 1.0) * self.radius * scale).max(self.view.near);
        self.view.pixel_size_at(depth) / scale
    }
}

/// The last level with an error of at most `allowed`, and how far `allowed` is towards the next.
fn between(errors: &[f64], allowed: f64) -> Choice {
    let level = errors.partition_point(|&error| error <= allowed).saturating_sub(1);
    match errors.get(level + 1) {
        Some(&next) if allowed > errors[level] => {
            Choice { level, t: share(errors[level], next, allowed) }
        }
        _ => Choice { level, t: 0.0 },
    }
}

/// Where a value lies between two others, in [0, 1].
fn share(low: f64, high: f64, value: f64) -> f64 {
    if high > low { ((value - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_lies_between_two_levels() {
        let errors = [0.1, 0.2, 0.2, 0.4];
        let cases = [
            (0.0, 0, 0.0),
            (0.1, 0, 0.0),
            (0.15, 0, 0.5),
            // a level that costs nothing more than the one before is taken at once
            (0.2, 2, 0.0),
            (0.3, 2, 0.5),
            (0.4, 3, 0.0),
            (9.0, 3, 0.0),
        ];
        for (allowed, level, t) in cases {
            let found = between(&errors, allowed);
            assert_eq!(found.level, level, "{allowed}");
            assert!((found.t - t).abs() < 1e-12, "{allowed}: {}", found.t);
        }
    }
}
