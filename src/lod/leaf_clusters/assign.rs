//! Every leaf to its nearest plane, and as few leaves looked at as can be.
//!
//! Each leaf keeps two bounds: the root of its plane's error is not above the one, that of no other
//! plane is below the other. When planes move, the bounds move with them (`moves`),
//! and while they do not meet, the leaf needs no look. What is left is gathered, eight by eight, and
//! compared with all planes (`nearest`).
//!
//! The ids are those that a comparison of all leaves with all planes in 64 bits gives, ties to the
//! lower id, whatever was skipped, at any vector width and on any number of threads.
//!
//! This work is based on:
//! Greg Hamerly. Making k-means even faster. 2010

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, u32x8};
use rayon::prelude::*;

use crate::error::LodError;
use crate::job::Job;
use crate::lod::leaf_clusters::leaves::{BLOCK_SIZE, Leaves, ROW_COUNT, stored};
use crate::lod::leaf_clusters::moves::Moves;
use crate::lod::leaf_clusters::nearest::{PlaneTable, exact, nearest};
use crate::simd::{Kernel, LANE_COUNT, Level};

/// The id of a leaf that has no plane yet.
pub(super) const NO_ID: u32 = u32::MAX;

/// Leaves that one thread takes at a time. Any size gives the same ids.
pub(super) const CHUNK_SIZE: usize = 1024;

/// Of a chunk's leaves: where as many must be looked at, gathering them costs more than it saves.
const MOST_PERCENT: usize = 60;

/// Pairs of leaf and plane below which a second thread costs more than it saves.
const MIN_PARALLEL_PAIRS: usize = 1 << 16;

/// A leaf that changed its cluster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Change {
    pub(super) leaf: u32,
    /// [`NO_ID`] if it had none.
    pub(super) before: u32,
    pub(super) after: u32,
}

/// Which plane each leaf has, and what is known about that. All vectors are filled up to whole lanes.
#[derive(Debug)]
pub(super) struct Assignment {
    count: usize,
    ids: Vec<u32>,
    upper: Vec<f32>,
    lower: Vec<f32>,
    /// By chunk: what the last pass changed.
    pub(super) changes: Vec<Vec<Change>>,
}

impl Assignment {
    /// No leaf has a plane.
    pub(super) fn new(leaves: &Leaves<'_>) -> Self {
        let padded = leaves.lanes.len() * LANE_COUNT;
        let mut ids = vec![NO_ID; leaves.count()];
        // those that fill the last lanes have any plane that exists
        ids.resize(padded, 0);
        Self {
            count: leaves.count(),
            ids,
            upper: vec![f32::INFINITY; padded],
            lower: vec![0.0; padded],
            changes: vec![Vec::new(); leaves.count().div_ceil(CHUNK_SIZE)],
        }
    }

    /// The plane of each leaf.
    pub(super) fn ids(&self) -> &[u32] {
        &self.ids[..self.count]
    }

    /// Gives a leaf a plane by decree; the next pass looks at it.
    pub(super) fn set(&mut self, leaf: usize, id: u32) {
        let before = std::mem::replace(&mut self.ids[leaf], id);
        let change = Change { leaf: stored(leaf), before, after: id };
        self.changes[leaf / CHUNK_SIZE].push(change);
        self.upper[leaf] = f32::INFINITY;
    }

    /// Begins a list of changes.
    pub(super) fn forget_changes(&mut self) {
        self.changes.iter_mut().for_each(Vec::clear);
    }

    /// Renames all clusters; the next pass must look at every leaf.
    pub(super) fn rename(&mut self, names: &[u32]) {
        for id in &mut self.ids[..self.count] {
            *id = names[*id as usize];
        }
    }

    /// How many leaves the last pass changed.
    pub(super) fn change_count(&self) -> usize {
        self.changes.iter().map(Vec::len).sum()
    }

    /// Assigns all leaves anew. `moves` is how far the planes moved since the last pass; without it
    /// every leaf is looked at.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub(super) fn pass(
        &mut self,
        leaves: &Leaves<'_>,
        table: &PlaneTable<'_>,
        moves: Option<&Moves>,
        level: Level,
        job: &Job,
    ) -> Result<(), LodError> {
        let ids = self.ids.chunks_mut(CHUNK_SIZE);
        let bounds = self.upper.chunks_mut(CHUNK_SIZE).zip(self.lower.chunks_mut(CHUNK_SIZE));
        let parts: Vec<_> = ids.zip(bounds).zip(&mut self.changes).enumerate().collect();
        let chunk_count = parts.len();
        let parallel = self.count * table.count() >= MIN_PARALLEL_PAIRS
            && rayon::current_num_threads() > 1
            && chunk_count > 1;
        let look = |(chunk, ((ids, (upper, lower)), changes)): (usize, _)| {
            job.check()?;
            let first = chunk * CHUNK_SIZE;
            let part = Part { leaves, table, moves, first, ids, upper, lower, changes };
            level.run(part);
            Ok(())
        };
        if parallel {
            parts.into_par_iter().try_for_each(look)
        } else {
            parts.into_iter().try_for_each(look)
        }
    }
}

/// A chunk of leaves in one pass.
struct Part<'a> {
    leaves: &'a Leaves<'a>,
    table: &'a PlaneTable<'a>,
    moves: Option<&'a Moves>,
    /// Index of its first leaf.
    first: usize,
    ids: &'a mut [u32],
    upper: &'a mut [f32],
    lower: &'a mut [f32],
    changes: &'a mut Vec<Change>,
}

impl Kernel for Part<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        self.changes.clear();
        let Some(moves) = self.moves else { return self.look_at_all(simd) };
        if !moves.any {
            return;
        }
        let mut open = [0_u32; CHUNK_SIZE + LANE_COUNT];
        let count = self.doubtful(simd, moves, &mut open);
        if count * 100 >= self.ids.len() * MOST_PERCENT {
            return self.look_at_all(simd);
        }
        for at in (0..count).step_by(LANE_COUNT) {
            let slots = std::array::from_fn(|lane| open[at.wrapping_add(lane)] as usize);
            self.look_at(simd, slots, LANE_COUNT.min(count.wrapping_sub(at)));
        }
    }
}

impl Part<'_> {
    /// Moves all bounds and lists the leaves whose bounds meet; how many there are.
    #[inline(always)]
    fn doubtful<S: Simd>(
        &mut self,
        simd: S,
        moves: &Moves,
        open: &mut [u32; CHUNK_SIZE + LANE_COUNT],
    ) -> usize {
        let mut bounds = vec![0.0; moves.padded_count()];
        let mut count = 0_usize;
        let wider = f32x8::splat(simd, 1.0 + 1e-6);
        let narrower = f32x8::splat(simd, 1.0 - 1e-6);
        for block in (0..self.ids.len()).step_by(BLOCK_SIZE) {
            let ball = &self.leaves.balls[self.first.wrapping_add(block) / BLOCK_SIZE];
            let [most, next] = moves.bounds(simd, ball, &mut bounds);
            let [most, next] = [most, next].map(|value| f32x8::splat(simd, value));
            let delta = self.table.delta(simd, f32x8::splat(simd, ball.reach));
            let end = self.ids.len().min(block.wrapping_add(BLOCK_SIZE));
            for slot in (block..end).step_by(LANE_COUNT) {
                let ids = &self.ids[slot..slot.wrapping_add(LANE_COUNT)];
                let own: [f32; LANE_COUNT] = std::array::from_fn(|lane| bounds[ids[lane] as usize]);
                let own = f32x8::simd_from(simd, own);
                let upper = &mut self.upper[slot..slot.wrapping_add(LANE_COUNT)];
                let lower = &mut self.lower[slot..slot.wrapping_add(LANE_COUNT)];
                // whoever moved most has only the next one for others
                let others = own.simd_ge(most).select(next, most);
                let above = (f32x8::from_slice(simd, upper) + own) * wider;
                let below = (f32x8::from_slice(simd, lower) - others) * narrower;
                above.store_slice(upper);
                below.store_slice(lower);
                let sure = (above + delta).simd_lt(below);
                let left = !sure.to_bitmask() & ((1 << LANE_COUNT) - 1);
                // all that are left, without a branch for each
                let slots = u32x8::simd_from(simd, MARKED[left as usize]);
                let slots = slots + u32x8::splat(simd, stored(slot));
                slots.store_slice(&mut open[count..count.wrapping_add(LANE_COUNT)]);
                count = count.wrapping_add(left.count_ones() as usize);
            }
        }
        let last = self.leaves.count().wrapping_sub(self.first);
        while count > 0 && open[count - 1] as usize >= last {
            count -= 1;
        }
        // the last vector is filled up
        let fill = open[count.saturating_sub(1)];
        open[count..count.wrapping_add(LANE_COUNT)].fill(fill);
        count
    }

    /// Compares all leaves with all planes.
    #[inline(always)]
    fn look_at_all<S: Simd>(&mut self, simd: S) {
        for slot in (0..self.ids.len()).step_by(LANE_COUNT) {
            let index = self.first.wrapping_add(slot);
            let found = nearest(simd, self.table, &self.leaves.lanes[index / LANE_COUNT]);
            let end = slot.wrapping_add(LANE_COUNT);
            let before = u32x8::from_slice(simd, &self.ids[slot..end]);
            let count = LANE_COUNT.min(self.leaves.count().wrapping_sub(index));
            let mut odd =
                (!before.simd_eq(found.ids).to_bitmask() | found.unsure) & ((1_u64 << count) - 1);
            found.upper.store_slice(&mut self.upper[slot..end]);
            found.lower.store_slice(&mut self.lower[slot..end]);
            if odd == 0 {
                continue;
            }
            let ids: [u32; LANE_COUNT] = found.ids.into();
            while odd != 0 {
                let lane = odd.trailing_zeros() as usize;
                odd &= odd.wrapping_sub(1);
                let slot = slot.wrapping_add(lane);
                let id = if found.unsure >> lane & 1 == 1 { self.exact(slot) } else { ids[lane] };
                self.set(slot, id);
            }
        }
    }

    /// Compares up to eight leaves with all planes.
    #[inline(always)]
    fn look_at<S: Simd>(&mut self, simd: S, slots: [usize; LANE_COUNT], count: usize) {
        let mut lanes = [[0.0; LANE_COUNT]; ROW_COUNT];
        for (lane, &slot) in slots.iter().enumerate() {
            let index = self.first.wrapping_add(slot);
            let from = &self.leaves.lanes[index / LANE_COUNT];
            for (row, numbers) in lanes.iter_mut().enumerate() {
                numbers[lane] = from[row][index % LANE_COUNT];
            }
        }
        let found = nearest(simd, self.table, &lanes);
        let ids: [u32; LANE_COUNT] = found.ids.into();
        let upper: [f32; LANE_COUNT] = found.upper.into();
        let lower: [f32; LANE_COUNT] = found.lower.into();
        for (lane, &slot) in slots[..count].iter().enumerate() {
            self.upper[slot] = upper[lane];
            self.lower[slot] = lower[lane];
            let unsure = found.unsure >> lane & 1 == 1;
            if unsure || self.ids[slot] != ids[lane] {
                let id = if unsure { self.exact(slot) } else { ids[lane] };
                self.set(slot, id);
            }
        }
    }

    /// The plane of a leaf in 64 bits; its bounds are set.
    #[inline(never)]
    fn exact(&mut self, slot: usize) -> u32 {
        let found = exact(self.leaves, self.table.exact, self.first + slot);
        self.upper[slot] = found.upper;
        self.lower[slot] = found.lower;
        found.id
    }

    /// Gives a leaf its plane and notes if that is another one.
    #[inline(never)]
    fn set(&mut self, slot: usize, id: u32) {
        let before = std::mem::replace(&mut self.ids[slot], id);
        if before != id {
            self.changes.push(Change { leaf: stored(self.first + slot), before, after: id });
        }
    }
}

/// For each set of lanes, the lanes that are in it, and then any.
const MARKED: [[u32; LANE_COUNT]; 1 << LANE_COUNT] = {
    let mut marked = [[0; LANE_COUNT]; 1 << LANE_COUNT];
    let mut set = 0;
    while set < marked.len() {
        let mut lane = 0;
        let mut count = 0;
        while lane < LANE_COUNT {
            if set >> lane & 1 == 1 {
                marked[set][count] = stored(lane);
                count += 1;
            }
            lane += 1;
        }
        set += 1;
    }
    marked
};
