//! How far planes moved: what the root of an error can have changed by.
//!
//! The root of the error of leaf `(p, n)` and plane `(N, d)` is the length of the vector
//! `(p.N + d, sqrt(alpha) n x N)`, which is linear in the plane. So it changes by no more than the
//! length of what the plane's change makes of it,
//!
//! ```text
//! |change| <= sqrt((p.dN + dd)^2 + alpha |dN|^2)
//! ```
//!
//! where `(N, d)` takes the sign that is nearer to what it was. For all leaves of a block, whose
//! centres lie in a ball around `q` of radius `r`, `|p.dN + dd| <= |q.dN + dd| + r |dN|`.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use crate::lod::leaf_clusters::leaves::{Ball, above, narrow};
use crate::lod::leaf_clusters::plane::Plane;
use crate::simd::LANE_COUNT;

/// Of the numbers that are added: what rounding may move their sum by, in 32 bits.
const ROUNDED: f64 = 1.0 / (1 << 20) as f64;

/// Changes of eight planes, a row a number: `dN`, `dd`, `|dN|`, rounding, `alpha |dN|^2`.
type Change = [[f32; LANE_COUNT]; 7];

/// Changes of all planes, eight an entry; those that fill the last entry do not move.
#[derive(Debug, Default)]
pub(super) struct Moves {
    changes: Vec<Change>,
    /// Whether any plane moved.
    pub(super) any: bool,
}

impl Moves {
    /// From planes before to planes after, whose signs agree. Normals are of unit length or nearly.
    pub(super) fn between(before: &[Plane], after: &[Plane], alpha: f64) -> Self {
        let mut changes = vec![Change::default(); before.len().div_ceil(LANE_COUNT)];
        for (index, (before, after)) in before.iter().zip(after).enumerate() {
            if before == after {
                continue;
            }
            let turn = after.normal - before.normal;
            let shift = after.d - before.d;
            let length = turn.length();
            // a centre in [-1, 1]^3 is at most this far from zero
            let rounded = ROUNDED * (2.0 * length + shift.abs());
            let numbers = [
                narrow(turn.x),
                narrow(turn.y),
                narrow(turn.z),
                narrow(shift),
                above(length),
                above(rounded),
                above(alpha * 1.03 * length * length),
            ];
            for (row, number) in numbers.into_iter().enumerate() {
                changes[index / LANE_COUNT][row][index % LANE_COUNT] = number;
            }
        }
        let any = before.iter().zip(after).any(|(before, after)| before != after);
        Self { changes, any }
    }

    /// What the roots of errors of a block's leaves can have changed by, for each plane, and the two
    /// largest of that.
    #[inline(always)]
    pub(super) fn bounds<S: Simd>(&self, simd: S, ball: &Ball, bounds: &mut [f32]) -> [f32; 2] {
        let [x, y, z] = ball.center.map(|value| f32x8::splat(simd, value));
        let radius = f32x8::splat(simd, ball.radius);
        let wider = f32x8::splat(simd, 1.0 + 1e-5);
        let [mut first, mut second] = [f32x8::splat(simd, 0.0); 2];
        for (change, bounds) in self.changes.iter().zip(bounds.chunks_exact_mut(LANE_COUNT)) {
            let [dx, dy, dz, shift, length, rounded, facing] =
                std::array::from_fn(|row| f32x8::simd_from(simd, change[row]));
            let middle = (((x * dx + y * dy) + z * dz) + shift).abs();
            let away = (middle + radius * length) + rounded;
            let bound = (away * away + facing).sqrt() * wider;
            bound.store_slice(bounds);
            second = second.max(first.min(bound));
            first = first.max(bound);
        }
        let (first, second): ([f32; LANE_COUNT], [f32; LANE_COUNT]) = (first.into(), second.into());
        let mut pairs: [[f32; 2]; LANE_COUNT] = std::array::from_fn(|i| [first[i], second[i]]);
        // in halves: as one chain it would take longer than all planes
        for half in [4, 2, 1] {
            for lane in 0..half {
                let ([a, next_a], [b, next_b]) = (pairs[lane], pairs[lane + half]);
                pairs[lane] = [larger(a, b), larger(smaller(a, b), larger(next_a, next_b))];
            }
        }
        pairs[0]
    }

    /// Room that [`Self::bounds`] takes.
    pub(super) fn padded_count(&self) -> usize {
        self.changes.len() * LANE_COUNT
    }
}

// not `f32::max`, which takes more instructions to treat numbers that are none
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;
    use crate::simd::{Kernel, Level};

    struct Bound<'a>(&'a Moves, &'a Ball, &'a mut [f32]);

    impl Kernel for Bound<'_> {
        type Output = [f32; 2];

        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> [f32; 2] {
            self.0.bounds(simd, self.1, self.2)
        }
    }

    proptest! {
        #[test]
        fn no_root_changes_by_more(
            planes in prop::collection::vec(prop::array::uniform8(-1.0..1.0_f64), 1..20),
            leaf in prop::array::uniform9(-1.0..1.0_f64),
            step in prop::sample::select(vec![1.0, 1e-2, 1e-5, 1e-8, 0.0]),
            alpha in prop::sample::select(vec![0.0, 0.1, 1e6]),
            radius in prop::sample::select(vec![0.0_f32, 0.1, 1.0]),
        ) {
            let at = |values: &[f64]| DVec3::from_slice(values);
            let center = at(&leaf[..3]).as_vec3();
            let p = center.as_dvec3() + at(&leaf[3..6]).normalize_or(DVec3::X) * f64::from(radius) * 0.999;
            let n = at(&leaf[6..]).normalize_or(DVec3::X);
            let [before, after]: [Vec<Plane>; 2] = [0.0, step].map(|step| {
                planes.iter().map(|values| Plane {
                    normal: (at(&values[..3]) + at(&values[4..7]) * step).normalize_or(DVec3::X),
                    d: values[3] + values[7] * step,
                }).collect()
            });
            let moves = Moves::between(&before, &after, alpha);
            prop_assert_eq!(moves.any, before != after);
            for level in Level::all() {
                let mut bounds = vec![0.0; moves.padded_count()];
                let ball = Ball { center: center.to_array(), radius, reach: 0.0 };
                let largest = level.run(Bound(&moves, &ball, &mut bounds));
                for (plane, (before, after)) in before.iter().zip(&after).enumerate() {
                    let change = after.error(p, n, alpha).sqrt() - before.error(p, n, alpha).sqrt();
                    // roots of errors near 0 have lost half of their digits
                    let rounded = 1e-8 * (1.0 + alpha.sqrt());
                    prop_assert!(change.abs() <= f64::from(bounds[plane]) + rounded);
                }
                let mut sorted = bounds;
                sorted.sort_by(|a, b| b.total_cmp(a));
                prop_assert_eq!(largest.as_slice(), &sorted[..2]);
            }
        }
    }
}
