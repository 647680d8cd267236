//! Which vertices share a position: files repeat a vertex wherever its normal or texture
//! coordinate changes, so connectivity and smooth normals need the positions alone.
//!
//! Exact: only bitwise equal coordinates meet (and -0 meets 0). O(V) expected time. Ids count up in
//! order of first use, so the result depends on nothing else.

use std::collections::HashMap;

use glam::Vec3;

/// For each vertex the id of its position, and how many positions there are.
pub fn weld(positions: &[Vec3]) -> (Vec<u32>, u32) {
    let mut id_of: HashMap<[u32; 3], u32> = HashMap::with_capacity(positions.len());
    let mut next = 0;
    let ids = positions
        .iter()
        .map(|&position| {
            // adding 0 turns -0 into 0
            let key = (position + Vec3::ZERO).to_array().map(f32::to_bits);
            *id_of.entry(key).or_insert_with(|| {
                next += 1;
                next - 1
            })
        })
        .collect();
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
