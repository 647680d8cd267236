//! Leaves as the clustering works on them: around zero, of size 1, and laid out for vectors.
//!
//! Centres are taken relative to the middle of their box and divided by a power of two that brings
//! them into [-1, 1], so that a crown far away or of any size has all its digits, and 32 bits do not
//! overflow. They are rounded to the grid of `sums`: by at most 2^-47 of the crown.

use glam::{DVec3, Vec3};

use crate::error::LodError;
use crate::job::{ELEMENTS_PER_CHECK, Job};
use crate::lod::leaf_clusters::plane::Plane;
use crate::lod::leaf_clusters::sums::on_grid;
use crate::simd::LANE_COUNT;

/// What 32-bit vectors hold of eight leaves, a row a number; see [`row`].
pub(super) type Lanes = [[f32; LANE_COUNT]; ROW_COUNT];

/// Rows of [`Lanes`].
pub(super) const ROW_COUNT: usize = 8;

/// Which row holds what.
pub(super) mod row {
    /// Centre minus `sqrt(alpha)` times normal: x, y, z.
    pub(crate) const MINUS: usize = 0;
    /// Centre plus `sqrt(alpha)` times normal: x, y, z.
    pub(crate) const PLUS: usize = 3;
    /// Length of the centre plus `sqrt(alpha)` times that of the normal, rounded up; infinite where
    /// its square would overflow.
    pub(crate) const REACH: usize = 6;
    /// `alpha` times the squared length of the normal.
    pub(crate) const FACING: usize = 7;
}

/// Above this, squares of 32-bit numbers overflow soon: what is computed from them is not believed.
pub(super) const MAX_REACH: f64 = 1e18;

/// Leaves in a block, whose centres share one ball.
pub(super) const BLOCK_SIZE: usize = 64;

/// A ball around the centres of a block.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Ball {
    pub(super) center: [f32; 3],
    /// Rounded up.
    pub(super) radius: f32,
    /// The largest [`row::REACH`] of its leaves.
    pub(super) reach: f32,
}

/// Leaves around zero and of size 1.
#[derive(Debug)]
pub(super) struct Leaves<'a> {
    centers: &'a [Vec3],
    normals: &'a [Vec3],
    /// Weight of angles, in squared units of `scale`.
    pub(super) alpha: f64,
    /// Where zero lies, in the caller's coordinates.
    pub(super) origin: DVec3,
    /// Metres that a unit stands for: a power of two.
    pub(super) scale: f64,
    /// Eight leaves an entry; the last is filled up with leaves at zero.
    pub(super) lanes: Vec<Lanes>,
    /// One for each block of [`BLOCK_SIZE`] leaves.
    pub(super) balls: Vec<Ball>,
}

impl<'a> Leaves<'a> {
    /// Centres in metres, normals of unit length or 0, `alpha` in square metres.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub(super) fn new(
        centers: &'a [Vec3],
        normals: &'a [Vec3],
        alpha: f64,
        job: &Job,
    ) -> Result<Self, LodError> {
        let (mut lowest, mut highest) = (Vec3::MAX, Vec3::MIN);
        for centers in centers.chunks(ELEMENTS_PER_CHECK) {
            job.check()?;
            lowest = centers.iter().copied().fold(lowest, Vec3::min);
            highest = centers.iter().copied().fold(highest, Vec3::max);
        }
        let (lowest, highest) = (lowest.as_dvec3(), highest.as_dvec3());
        let scale = power_of_two_above(((highest - lowest) * 0.5).max_element());
        let mut leaves = Self {
            centers,
            normals,
            alpha: alpha / (scale * scale),
            origin: (lowest + highest) * 0.5,
            scale,
            lanes: Vec::new(),
            balls: Vec::new(),
        };
        let count = centers.len();
        leaves.lanes = job.collect(count.div_ceil(LANE_COUNT), |part| leaves.lanes_of(part))?;
        leaves.balls = job.collect(count.div_ceil(BLOCK_SIZE), |block| leaves.ball_of(block))?;
        Ok(leaves)
    }

    /// How many there are.
    pub(super) fn count(&self) -> usize {
        self.centers.len()
    }

    /// Centre and normal of a leaf, on the grid.
    #[inline(always)]
    pub(super) fn leaf(&self, index: usize) -> [f64; 6] {
        // the scale is a power of two: to multiply by its inverse is to divide
        let p = (self.centers[index].as_dvec3() - self.origin) * (1.0 / self.scale);
        let n = self.normals[index].as_dvec3();
        [p.x, p.y, p.z, n.x, n.y, n.z].map(on_grid)
    }

    /// Error of a leaf and a plane: the one that decides.
    #[inline(always)]
    pub(super) fn error(&self, index: usize, plane: &Plane) -> f64 {
        let [x, y, z, nx, ny, nz] = self.leaf(index);
        plane.error(DVec3::new(x, y, z), DVec3::new(nx, ny, nz), self.alpha)
    }

    fn lanes_of(&self, part: usize) -> Lanes {
        let mut lanes = Lanes::default();
        let root = self.alpha.sqrt();
        let leaves = (part * LANE_COUNT)..self.count().min((part + 1) * LANE_COUNT);
        for (lane, leaf) in leaves.enumerate() {
            let [x, y, z, nx, ny, nz] = self.leaf(leaf);
            let (p, m) = (DVec3::new(x, y, z), DVec3::new(nx, ny, nz) * root);
            let mut set = |row: usize, value: f32| lanes[row][lane] = value;
            for axis in 0..3 {
                set(row::MINUS + axis, narrow(p[axis] - m[axis]));
                set(row::PLUS + axis, narrow(p[axis] + m[axis]));
            }
            let reach = p.length() + m.length();
            set(row::REACH, if reach < MAX_REACH { above(reach) } else { f32::INFINITY });
            set(row::FACING, narrow(m.length_squared()));
        }
        lanes
    }

    fn ball_of(&self, block: usize) -> Ball {
        let leaves = block * BLOCK_SIZE..self.count().min((block + 1) * BLOCK_SIZE);
        let center = |leaf: usize| {
            let [x, y, z, ..] = self.leaf(leaf);
            DVec3::new(x, y, z)
        };
        let lowest = leaves.clone().map(center).fold(DVec3::MAX, DVec3::min);
        let highest = leaves.clone().map(center).fold(DVec3::MIN, DVec3::max);
        let middle = ((lowest + highest) * 0.5).as_vec3();
        let squared = |leaf| center(leaf).distance_squared(middle.as_dvec3());
        let radius = above(leaves.clone().map(squared).fold(0.0, f64::max).sqrt());
        let parts = leaves.start / LANE_COUNT..leaves.end.div_ceil(LANE_COUNT);
        let reach = self.lanes[parts].iter().flat_map(|lanes| lanes[row::REACH]);
        Ball { center: middle.to_array(), radius, reach: reach.fold(0.0, f32::max) }
    }

    /// A plane of the caller's coordinates.
    pub(super) fn inward(&self, plane: &Plane) -> Plane {
        let d = plane.d + self.origin.dot(plane.normal);
        Plane { normal: plane.normal, d: d / self.scale }
    }

    /// A plane for the caller's coordinates, with the sign that planes have.
    pub(super) fn outward(&self, plane: &Plane) -> Plane {
        Plane { normal: plane.normal, d: plane.d * self.scale }.relative_to(-self.origin)
    }
}

/// The least power of two that is at least `value`; 1 for 0.
fn power_of_two_above(value: f64) -> f64 {
    let mut power = 1.0;
    if value == 0.0 {
        return power;
    }
    while power < value {
        power *= 2.0;
    }
    while power * 0.5 >= value {
        power *= 0.5;
    }
    power
}

/// An index of a leaf or a plane as it is stored.
#[expect(clippy::cast_possible_truncation, reason = "leaves and planes are fewer than 2^31")]
#[inline(always)]
pub(super) const fn stored(index: usize) -> u32 {
    index as u32
}

/// The nearest 32-bit number.
#[expect(clippy::cast_possible_truncation, reason = "vectors hold 32-bit numbers")]
pub(super) fn narrow(value: f64) -> f32 {
    value as f32
}

/// What [`above`] adds. Its square is still a normal number: processors take a hundred times as long
/// for smaller ones.
const LEAST: f32 = 1e-16;

/// A 32-bit number that is not below a number of at least 0.
pub(super) fn above(value: f64) -> f32 {
    // more than the rounding of the number itself and of a few operations that led to it
    narrow(value * (1.0 + 1e-6)) + LEAST
}
