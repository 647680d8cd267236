//! Which level of a hierarchy a view shows, and how far it is on its way to the next.
//!
//! At level `i` a share `t` of 0 shows its cards where they belong; as `t` rises to 1 they move into
//! the planes of level `i + 1`, which then takes over.

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
pub(super) struct Seen<'a> {
    pub(super) view: &'a View,
    pub(super) crown: &'a Crown,
    /// Eye to the crown's centre over the crown's radius; depth in parallel views.
    pub(super) distance_rel: f64,
    /// Crown's radius, in the crown's own metres.
    pub(super) radius: f64,
}

impl LevelRule {
    /// The level of a view; `errors` are those of the levels in metres, and never fall.
    pub(super) fn choose(&self, errors: &[f64], seen: &Seen<'_>) -> Choice {
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

impl Seen<'_> {
    /// Of a pixel, in the crown's own metres, where the crown is nearest.
    fn pixel_size(&self) -> f64 {
        let scale = scale(self.crown);
        let depth = ((self.distance_rel - 1.0) * self.radius * scale).max(self.view.near);
        self.view.pixel_size_at(depth) / scale
    }
}

/// How much larger a copy is than the crown itself, in the mean of all directions.
pub(super) fn scale(crown: &Crown) -> f64 {
    libm::cbrt(crown.world_from_local.matrix3.determinant().abs())
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
