//! Where a clustering starts: planes drawn at random, or given.
//!
//! This work is based on:
//! David Arthur, Sergei Vassilvitskii. k-means++: The Advantages of Careful Seeding. 2007

use fearless_simd::f32x8;
use fearless_simd::prelude::*;
use glam::DVec3;
use rayon::prelude::*;

use crate::error::LodError;
use crate::job::Job;
use crate::lod::leaf_clusters::leaves::{Leaves, above};
use crate::lod::leaf_clusters::nearest::{PlaneTable, least_errors};
use crate::lod::leaf_clusters::plane::Plane;
use crate::random::{Purpose, Stream};
use crate::simd::{Kernel, LANE_COUNT, Level};

const RANDOM: Purpose = Purpose::named("leaf_clusters.random");
const PLUS_PLUS: Purpose = Purpose::named("leaf_clusters.plus_plus");

/// Leaves whose errors are summed before the sums are summed. Fixed: it decides how sums round.
const CHUNK_SIZE: usize = 4096;

/// Leaves below which a second thread costs more than it saves.
const MIN_PARALLEL_LEAVES: usize = 1 << 15;

/// The paper's start: planes with a random normal through the centre of a random leaf.
pub(super) fn random(
    leaves: &Leaves<'_>,
    plane_count: usize,
    seed: u64,
    restart: u64,
) -> Vec<Plane> {
    let mut stream = Stream::new(seed, RANDOM, restart);
    (0..plane_count)
        .map(|_| {
            let leaf = any_leaf(leaves, &mut stream);
            let [x, y, z, ..] = leaves.leaf(leaf);
            plane_through(DVec3::new(x, y, z), direction(&mut stream))
        })
        .collect()
}

/// Planes of leaves: the first any, each next with a probability in proportion to its error so far.
/// Fewer than asked for once all leaves lie in the planes drawn.
///
/// # Errors
/// [`LodError::Cancelled`].
pub(super) fn plus_plus(
    leaves: &Leaves<'_>,
    plane_count: usize,
    seed: u64,
    restart: u64,
    level: Level,
    job: &Job,
) -> Result<Vec<Plane>, LodError> {
    let mut stream = Stream::new(seed, PLUS_PLUS, restart);
    let mut errors = vec![f64::INFINITY; leaves.count()];
    let mut limits = vec![f32::INFINITY; leaves.lanes.len() * LANE_COUNT];
    let mut planes = Vec::new();
    let mut chosen = any_leaf(leaves, &mut stream);
    loop {
        let [x, y, z, nx, ny, nz] = leaves.leaf(chosen);
        let any = direction(&mut stream);
        let normal = DVec3::new(nx, ny, nz).try_normalize().unwrap_or(any);
        let plane = plane_through(DVec3::new(x, y, z), normal);
        planes.push(plane);
        if planes.len() == plane_count {
            return Ok(planes);
        }
        let alone = [plane];
        let table = PlaneTable::new(&alone);
        let parts = errors.chunks_mut(CHUNK_SIZE).zip(limits.chunks_mut(CHUNK_SIZE)).enumerate();
        let lower = |(chunk, (errors, limits)): (usize, (&mut [f64], &mut [f32]))| {
            job.check()?;
            let first = chunk * CHUNK_SIZE;
            Ok(level.run(Lower { leaves, table: &table, first, errors, limits }))
        };
        let sums: Vec<f64> = if leaves.count() < MIN_PARALLEL_LEAVES {
            parts.map(lower).collect::<Result<_, _>>()?
        } else {
            let parts: Vec<_> = parts.collect();
            parts.into_par_iter().map(lower).collect::<Result<_, _>>()?
        };
        // the leaf at which the running sum of errors passes a random share of the whole
        let mut left = stream.unit() * sums.iter().sum::<f64>();
        let Some(last) = sums.iter().rposition(|&sum| sum > 0.0) else { return Ok(planes) };
        let mut chunk = 0;
        while chunk < last && left >= sums[chunk] {
            left -= sums[chunk];
            chunk += 1;
        }
        let first = chunk * CHUNK_SIZE;
        let errors = &errors[first..leaves.count().min(first + CHUNK_SIZE)];
        // rounding can let the share reach beyond the last leaf that has an error
        chosen = first + errors.iter().rposition(|&error| error > 0.0).unwrap_or(0);
        for (slot, &error) in errors.iter().enumerate() {
            if left < error {
                chosen = first + slot;
                break;
            }
            left -= error;
        }
    }
}

/// The index of any leaf.
fn any_leaf(leaves: &Leaves<'_>, stream: &mut Stream) -> usize {
    let index = stream.below(leaves.count() as u64);
    usize::try_from(index).expect("below the count of leaves")
}

/// A unit vector, all directions alike.
fn direction(stream: &mut Stream) -> DVec3 {
    loop {
        let vector = DVec3::new(stream.signed(), stream.signed(), stream.signed());
        let squared = vector.length_squared();
        // in the ball, and not so near its middle that rounding shows
        if (1e-6..=1.0).contains(&squared) {
            return vector / squared.sqrt();
        }
    }
}

fn plane_through(point: DVec3, normal: DVec3) -> Plane {
    Plane { normal, d: -point.dot(normal) }
}

/// Lowers a chunk's errors to those of one more plane, and sums them.
struct Lower<'a> {
    leaves: &'a Leaves<'a>,
    /// The one plane.
    table: &'a PlaneTable<'a>,
    first: usize,
    errors: &'a mut [f64],
    /// Not below the errors, filled up to whole lanes.
    limits: &'a mut [f32],
}

impl Kernel for Lower<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f64 {
        let Self { leaves, table, first, errors, limits } = self;
        // in lanes: one long chain of sums would take longer than the errors
        let mut sums = [0.0; LANE_COUNT];
        for (slot, errors) in (0..).step_by(LANE_COUNT).zip(errors.chunks_mut(LANE_COUNT)) {
            let index = first.wrapping_add(slot);
            let limits = &mut limits[slot..slot.wrapping_add(LANE_COUNT)];
            let least = least_errors(simd, table, &leaves.lanes[index / LANE_COUNT]);
            // most leaves are nearer to another plane, which 32 bits can tell
            let far = least.simd_ge(f32x8::from_slice(simd, limits)).to_bitmask();
            let mut near = !far & ((1_u64 << errors.len()) - 1);
            while near != 0 {
                let lane = near.trailing_zeros() as usize;
                near &= near.wrapping_sub(1);
                let error = leaves.error(index.wrapping_add(lane), &table.exact[0]);
                if error < errors[lane] {
                    errors[lane] = error;
                    limits[lane] = above(error);
                }
            }
            for (sum, error) in sums.iter_mut().zip(errors) {
                *sum += *error;
            }
        }
        sums.iter().sum()
    }
}
