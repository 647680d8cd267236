//! Which plane is nearest to each of eight leaves: in 32 bits, with a bound on what that may be off by.
//!
//! With `m = sqrt(alpha) n`, the error of a leaf less its own `|m|^2` is the product of two distances,
//!
//! ```text
//! E - |m|^2 = (p.N + d)^2 - (m.N)^2 = ((p - m).N + d) ((p + m).N + d)
//! ```
//!
//! which takes six products and six sums. Where the two best planes are nearer to one another than
//! rounding may have moved them, the caller asks again in 64 bits (`exact`): the answer is always
//! the one of 64 bits.
//!
//! The bound. Let `u = 2^-24`, `t = |p| + |m| + max |d|`. Each of the two distances takes six roundings
//! of numbers of size `t`, so it is off by at most `delta = 8 u t`. Their product is off by at most
//! `delta (a + b) + delta^2`, where `a` and `b` are the computed distances' sizes, and
//! `a + b <= 2 (s + delta)` with `s = sqrt(max(E - |m|^2, 0) + |m|^2)`. The last bits of a product hold
//! the plane's number, which moves it by [`TAG`] of itself. A plane that is not among the best two has
//! a larger product, and what that is off by grows more slowly than the product itself, but for
//! another `delta^2`. The error in 64 bits is off by far less than `delta^2`.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, u32x8};
use glam::DVec3;

use crate::lod::leaf_clusters::leaves::{Lanes, Leaves, MAX_REACH, above, narrow, row, stored};
use crate::lod::leaf_clusters::plane::Plane;
use crate::simd::LANE_COUNT;

/// Planes whose numbers fit into the last bits of a product.
const GROUP_SIZE: usize = 64;

/// The bits that hold a plane's number within its group.
const TAG_BITS: u32 = stored(GROUP_SIZE) - 1;

/// What those bits move a number by, of itself: 64 of 2^23 steps. Twice that bounds two numbers, and
/// other roundings of 2^-24 are small beside it.
const TAG: f32 = GROUP_SIZE as f32 / (1 << 23) as f32;

/// `delta` for a reach of 1: eight roundings.
const DELTA: f32 = 8.0 / (1 << 24) as f32;

/// Planes in both widths.
#[derive(Debug)]
pub(super) struct PlaneTable<'a> {
    pub(super) exact: &'a [Plane],
    /// Normal, `d`, and the plane's number within its group as bits.
    rows: Vec<[f32; 5]>,
    /// Not below any plane's distance from zero; infinite where its square would overflow.
    farthest: f32,
}

impl<'a> PlaneTable<'a> {
    pub(super) fn new(planes: &'a [Plane]) -> Self {
        let farthest = planes.iter().fold(0.0, |most: f64, plane| most.max(plane.d.abs()));
        Self {
            exact: planes,
            rows: planes
                .iter()
                .zip((0..stored(GROUP_SIZE)).cycle())
                .map(|(plane, tag)| {
                    let DVec3 { x, y, z } = plane.normal;
                    let [x, y, z, d] = [x, y, z, plane.d].map(narrow);
                    [x, y, z, d, f32::from_bits(tag)]
                })
                .collect(),
            farthest: if farthest < MAX_REACH { above(farthest) } else { f32::INFINITY },
        }
    }

    pub(super) fn count(&self) -> usize {
        self.rows.len()
    }

    /// How far the root of an error may be from what 64 bits make of it.
    #[inline(always)]
    pub(super) fn delta<S: Simd>(&self, simd: S, reach: f32x8<S>) -> f32x8<S> {
        (reach + f32x8::splat(simd, self.farthest)) * f32x8::splat(simd, DELTA)
    }
}

/// What is known of eight leaves.
pub(super) struct Nearest<S: Simd> {
    /// The nearest plane, where it is sure.
    pub(super) ids: u32x8<S>,
    /// Not below the root of that plane's error.
    pub(super) upper: f32x8<S>,
    /// Not above the root of any other plane's error.
    pub(super) lower: f32x8<S>,
    /// A bit for each lane in which two planes are too near to one another to tell.
    pub(super) unsure: u64,
}

/// The nearest of all planes, for eight leaves.
#[inline(always)]
pub(super) fn nearest<S: Simd>(simd: S, table: &PlaneTable<'_>, lanes: &Lanes) -> Nearest<S> {
    let [ax, ay, az, bx, by, bz] =
        std::array::from_fn(|axis| f32x8::simd_from(simd, lanes[row::MINUS + axis]));
    let infinity = f32x8::splat(simd, f32::INFINITY);
    let keep = u32x8::splat(simd, !TAG_BITS);
    let [mut best, mut second] = [infinity; 2];
    let mut ids = u32x8::splat(simd, 0);
    let mut base = 0_u32;
    for group in table.rows.chunks(GROUP_SIZE) {
        let [mut first_here, mut second_here] = [infinity; 2];
        for &[nx, ny, nz, d, tag] in group {
            let [nx, ny, nz, d] = [nx, ny, nz, d].map(|value| f32x8::splat(simd, value));
            let minus = ((ax * nx + ay * ny) + az * nz) + d;
            let plus = ((bx * nx + by * ny) + bz * nz) + d;
            let product = (minus * plus).bitcast::<u32x8<S>>();
            let tagged =
                ((product & keep) | u32x8::splat(simd, tag.to_bits())).bitcast::<f32x8<S>>();
            second_here = second_here.min(first_here.max(tagged));
            first_here = first_here.min(tagged);
        }
        let number = first_here.bitcast::<u32x8<S>>() & u32x8::splat(simd, TAG_BITS);
        let number = number + u32x8::splat(simd, base);
        ids = first_here.simd_lt(best).select(number, ids);
        second = second.min(second_here).min(best.max(first_here));
        best = best.min(first_here);
        base = base.wrapping_add(stored(GROUP_SIZE));
    }
    judge(simd, table, lanes, [best, second], ids)
}

/// Turns the two least products into bounds.
#[inline(always)]
fn judge<S: Simd>(
    simd: S,
    table: &PlaneTable<'_>,
    lanes: &Lanes,
    [best, second]: [f32x8<S>; 2],
    ids: u32x8<S>,
) -> Nearest<S> {
    let zero = f32x8::splat(simd, 0.0);
    let facing = f32x8::simd_from(simd, lanes[row::FACING]);
    let rounded = rounding(simd, table, lanes, second);
    let sure = (second - best).simd_gt(rounded + rounded);
    let wider = f32x8::splat(simd, 1.0 + 1e-6);
    let narrower = f32x8::splat(simd, 1.0 - 1e-6);
    let upper = ((best + facing) + rounded).max(zero).sqrt() * wider;
    let lower = ((second + facing) - rounded).max(zero).sqrt() * narrower;
    Nearest { ids, upper, lower, unsure: !sure.to_bitmask() & ((1 << LANE_COUNT) - 1) }
}

/// Numbers that are not above the errors of eight leaves and the first plane.
#[inline(always)]
pub(super) fn least_errors<S: Simd>(simd: S, table: &PlaneTable<'_>, lanes: &Lanes) -> f32x8<S> {
    let [ax, ay, az, bx, by, bz] =
        std::array::from_fn(|axis| f32x8::simd_from(simd, lanes[row::MINUS + axis]));
    let [nx, ny, nz, d, _] = table.rows[0].map(|value| f32x8::splat(simd, value));
    let minus = ((ax * nx + ay * ny) + az * nz) + d;
    let plus = ((bx * nx + by * ny) + bz * nz) + d;
    let product = minus * plus;
    let facing = f32x8::simd_from(simd, lanes[row::FACING]);
    (product + facing) - rounding(simd, table, lanes, product)
}

/// What products of at most `product`, and those that decide against it, may be off by.
#[inline(always)]
fn rounding<S: Simd>(
    simd: S,
    table: &PlaneTable<'_>,
    lanes: &Lanes,
    product: f32x8<S>,
) -> f32x8<S> {
    let facing = f32x8::simd_from(simd, lanes[row::FACING]);
    let delta = table.delta(simd, f32x8::simd_from(simd, lanes[row::REACH]));
    let size = (product.max(f32x8::splat(simd, 0.0)) + facing).sqrt();
    delta * (size + size + delta * f32x8::splat(simd, 4.0))
        + product.max(facing) * f32x8::splat(simd, 2.0 * TAG)
}

/// What is known of one leaf, as in [`Nearest`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Exact {
    pub(super) id: u32,
    pub(super) upper: f32,
    pub(super) lower: f32,
}

/// The nearest plane of a leaf in 64 bits, the first of equals.
pub(super) fn exact(leaves: &Leaves<'_>, planes: &[Plane], index: usize) -> Exact {
    let [mut best, mut second] = [f64::INFINITY; 2];
    let mut id = 0;
    for (number, plane) in (0_u32..).zip(planes) {
        let error = leaves.error(index, plane);
        if error < best {
            second = best;
            best = error;
            id = number;
        } else if error < second {
            second = error;
        }
    }
    Exact { id, upper: above(best.sqrt()), lower: narrow(second.sqrt() * (1.0 - 1e-6)) }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use proptest::prelude::*;

    use super::*;
    use crate::job::Job;
    use crate::simd::{Kernel, Level};

    struct Look<'a>(&'a PlaneTable<'a>, &'a Lanes);

    type Seen = ([u32; LANE_COUNT], [f32; LANE_COUNT], [f32; LANE_COUNT], u64);

    impl Kernel for Look<'_> {
        type Output = Seen;

        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> Seen {
            let found = nearest(simd, self.0, self.1);
            (found.ids.into(), found.upper.into(), found.lower.into(), found.unsure)
        }
    }

    struct Least<'a>(&'a PlaneTable<'a>, &'a Lanes);

    impl Kernel for Least<'_> {
        type Output = [f32; LANE_COUNT];

        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> [f32; LANE_COUNT] {
            least_errors(simd, self.0, self.1).into()
        }
    }

    fn unit(values: [f64; 3]) -> DVec3 {
        DVec3::from(values).normalize_or(DVec3::Y)
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

        /// Planes in pairs that nearly tie, from apart down to less than rounding can tell.
        #[test]
        fn what_is_sure_is_right_and_bounds_hold(
            values in prop::collection::vec(prop::array::uniform6(-1.0..1.0_f64), 8),
            planes in prop::collection::vec(prop::array::uniform4(-1.0..1.0_f64), 1..70),
            apart in prop::sample::select(vec![1e-3, 1e-5, 1e-6, 3e-7, 1e-7, 1e-8, 1e-12, 0.0]),
            alpha in prop::sample::select(vec![0.0, 1e-4, 0.1, 10.0, 1e6]),
        ) {
            let (centers, normals): (Vec<Vec3>, Vec<Vec3>) = values
                .iter()
                .map(|&[x, y, z, a, b, c]| {
                    (DVec3::new(x, y, z).as_vec3(), unit([a, b, c]).as_vec3())
                })
                .unzip();
            let leaves = Leaves::new(&centers, &normals, alpha, &Job::default()).expect("valid");
            let planes: Vec<Plane> = planes
                .iter()
                .flat_map(|&[x, y, z, d]| {
                    let near = unit([x + apart, y - apart, z]);
                    [Plane { normal: unit([x, y, z]), d }, Plane { normal: near, d: d + apart }]
                })
                .collect();
            let table = PlaneTable::new(&planes);
            for level in Level::all() {
                let least = level.run(Least(&table, &leaves.lanes[0]));
                for (lane, least) in least.into_iter().enumerate() {
                    prop_assert!(f64::from(least) <= leaves.error(lane, &planes[0]));
                }
            }
            let seen = Level::all().into_iter().map(|level| level.run(Look(&table, &leaves.lanes[0])));
            for (ids, upper, lower, unsure) in seen {
                for lane in 0..LANE_COUNT {
                    if unsure >> lane & 1 == 1 {
                        continue;
                    }
                    let mut errors: Vec<f64> =
                        planes.iter().map(|plane| leaves.error(lane, plane)).collect();
                    let expected = exact(&leaves, &planes, lane);
                    prop_assert_eq!(ids[lane], expected.id);
                    let own = errors.swap_remove(ids[lane] as usize);
                    let other = errors.into_iter().fold(f64::INFINITY, f64::min);
                    prop_assert!(f64::from(upper[lane]) >= own.sqrt());
                    prop_assert!(f64::from(lower[lane]) <= other.sqrt());
                    prop_assert!(f64::from(expected.upper) >= own.sqrt());
                    prop_assert!(f64::from(expected.lower) <= other.sqrt());
                }
            }
        }
    }

    #[test]
    fn most_leaves_are_sure() {
        // a bound that is always too wide would pass every other test
        let centers: Vec<Vec3> = (0..8_u8).map(|i| Vec3::new(0.0, f32::from(i), 1.0)).collect();
        let leaves = Leaves::new(&centers, &[Vec3::Y; 8], 0.1, &Job::default()).expect("valid");
        let planes = [-0.8, -0.3, 0.2, 0.7].map(|d| Plane { normal: DVec3::Y, d });
        let table = PlaneTable::new(&planes);
        let (ids, _, _, unsure) = Level::all()[0].run(Look(&table, &leaves.lanes[0]));
        assert_eq!((ids, unsure), ([3, 3, 2, 2, 1, 1, 0, 0], 0), "all of them");
    }
}
