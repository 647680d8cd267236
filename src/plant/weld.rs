//! Which vertices share a position: files repeat a vertex wherever its normal or texture
//! coordinate changes, so connectivity and smooth normals need the positions alone.
//!
//! Exact: only bitwise equal coordinates meet (and -0 meets 0). O(V log V) time. Ids count up in
//! order of first use, so the result depends on nothing else.

use glam::Vec3;
use rayon::prelude::*;

/// For each vertex the id of its position, and how many positions there are.
pub fn weld(positions: &[Vec3]) -> (Vec<u32>, u32) {
    // sorted, because a hash table of millions of positions misses the cache at every look, and
    // because a file can be made to collide
    let mut keyed: Vec<([u32; 3], u32)> = positions
        .par_iter()
        .zip(0_u32..u32::MAX)
        // adding 0 turns -0 into 0
        .map(|(&position, vertex)| ((position + Vec3::ZERO).to_array().map(f32::to_bits), vertex))
        .collect();
    keyed.par_sort_unstable();
    // each vertex refers to the first one at its position, which then gets the next free id
    let mut ids = vec![0; positions.len()];
    for group in keyed.chunk_by(|a, b| a.0 == b.0) {
        for &(_, vertex) in group {
            ids[vertex as usize] = group[0].1;
        }
    }
    let mut next = 0;
    for vertex in 0..ids.len() {
        let first = ids[vertex] as usize;
        if first == vertex {
            ids[vertex] = next;
            next += 1;
        } else {
            ids[vertex] = ids[first];
        }
    }
    (ids, next)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_positions_meet() {
        let x = Vec3::X;
        let (ids, count) = weld(&[x, Vec3::ZERO, x, Vec3::new(0.0, -0.0, 0.0), x + 1e-6]);
        assert_eq!(ids, [0, 1, 0, 1, 2], "by first use; -0 is 0; a millionth is apart");
        assert_eq!(count, 3, "three positions");
    }
}
