//! The same detail everywhere: which nodes a crown of a given number of quads consists of.
//!
//! With leaf count n the first L - n collapses are applied, whichever parts of the crown they lie in.
//! Levels are nested: a collapse that is applied at n quads is applied at every smaller count. From
//! one count to another only the collapses between the two are looked at, if they are few, or else
//! both lists are walked once: O(|A| + |B|).
//!
//! This work is based on: I. Remolar, M. Chover, J. Ribelles, O. Belmonte. View-Dependent
//! Multiresolution Model for Foliage. Journal of WSCG 11(1), 2003.

use crate::error::{LodError, check_in};
use crate::lod::foliage_hierarchy::active::Changes;
use crate::lod::foliage_hierarchy::depth_first::DepthFirst;

/// Looking one collapse up costs as much as walking past this many quads: a search among up to 2^24
/// entries against one step.
const WALK_PER_SEARCH: usize = 24;

/// Nodes below this index exist once the crown has `leaf_count` quads.
fn made(order: &DepthFirst, leaf_count: usize) -> Result<u32, LodError> {
    check_in("leaf_count", leaf_count, order.root_count..=order.leaves.len())?;
    let node_count = 2 * order.leaves.len() - leaf_count;
    Ok(u32::try_from(node_count).expect("a forest's nodes are counted in 32 bits"))
}

/// Active nodes of a crown of `leaf_count` quads, in depth-first order.
///
/// # Errors
/// [`LodError::OutOfRange`] unless `leaf_count` is between the number of roots and that of leaves.
pub fn uniform(order: &DepthFirst, leaf_count: usize) -> Result<Vec<u32>, LodError> {
    let made = made(order, leaf_count)?;
    let mut nodes = Vec::with_capacity(leaf_count);
    emit(order, made, 0..order.places.len(), &mut nodes);
    Ok(nodes)
}

/// What of some whole sub-trees is active when nodes below index `made` exist.
fn emit(order: &DepthFirst, made: u32, places: std::ops::Range<usize>, nodes: &mut Vec<u32>) {
    let mut at = places.start;
    while at < places.end {
        let place = &order.places[at];
        if place.node < made {
            nodes.push(place.node);
            at = place.end as usize;
        } else {
            at += 1;
        }
    }
}

/// Turns `list`, which has as many quads as one count asks for, into that of another.
///
/// # Errors
/// As [`uniform`]; the list is then as it was.
pub fn step(
    order: &DepthFirst,
    list: &mut Vec<u32>,
    leaf_count: usize,
    changes: &mut Changes,
) -> Result<(), LodError> {
    changes.clear();
    let (from, to) = (made(order, list.len())?, made(order, leaf_count)?);
    let (fine, coarse) = (from.min(to), from.max(to));
    let collapse_count = (coarse - fine) as usize;
    if collapse_count * WALK_PER_SEARCH < list.len().min(leaf_count) {
        search(order, list, fine..coarse, from, to, changes);
    } else {
        walk(order, fine, coarse, from, to, changes);
    }
    changes.apply(list);
    Ok(())
}

/// Walks both levels at once.
fn walk(order: &DepthFirst, fine: u32, coarse: u32, from: u32, to: u32, changes: &mut Changes) {
    let (mut at, mut entry) = (0, 0);
    while at < order.places.len() {
        let place = &order.places[at];
        if place.node >= coarse {
            at += 1;
            continue;
        }
        if place.node >= fine {
            entry += edit(order, at, entry, from, to, changes);
        } else {
            entry += 1;
        }
        at = place.end as usize;
    }
}

/// Looks up the topmost nodes that one of the levels has and the other has not.
fn search(
    order: &DepthFirst,
    list: &[u32],
    between: std::ops::Range<u32>,
    from: u32,
    to: u32,
    changes: &mut Changes,
) {
    let mut tops: Vec<u32> = between.map(|node| order.place_of[node as usize]).collect();
    tops.sort_unstable();
    let mut end = 0;
    for place in tops {
        // below one that was looked at before
        if place < end {
            continue;
        }
        end = order.places[place as usize].end;
        let entry = list.partition_point(|&node| order.place_of[node as usize] < place);
        edit(order, place as usize, entry, from, to, changes);
    }
}

/// Replaces what the old list, from `entry` on, has of a sub-tree; how many entries that was.
fn edit(
    order: &DepthFirst,
    at: usize,
    entry: usize,
    from: u32,
    to: u32,
    changes: &mut Changes,
) -> usize {
    let end = order.places[at].end as usize;
    let start = changes.inserted.len();
    emit(order, to, at..end, &mut changes.inserted);
    // of the two levels one has the topmost node alone, the other as many as their sub-tree says
    let old_count = if from < to { count(order, from, at..end) } else { 1 };
    changes.push(entry..entry + old_count, start);
    old_count
}

fn count(order: &DepthFirst, made: u32, places: std::ops::Range<usize>) -> usize {
    let (mut at, mut count) = (places.start, 0);
    while at < places.end {
        let place = &order.places[at];
        if place.node < made {
            count += 1;
            at = place.end as usize;
        } else {
            at += 1;
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::lod::foliage_hierarchy::made::{chain, forest, random_forest};

    /// The definition: made so far, and not yet part of something made.
    fn uniform_naive(forest: &crate::lod::foliage_hierarchy::forest::Forest, n: usize) -> Vec<u32> {
        let made = 2 * forest.leaf_count - u32::try_from(n).expect("few");
        (0..made).filter(|&x| forest.nodes[x as usize].parent >= made).collect()
    }

    #[test]
    fn the_first_collapses_are_applied() {
        //      7
        //    6   \      5
        //   / \   \    / \
        //  0   2   4  1   3
        let forest = forest(5, &[[1, 3], [0, 2], [4, 6]]);
        let order = DepthFirst::new(&forest);
        let nodes: Vec<u32> = order.places.iter().map(|place| place.node).collect();
        assert_eq!(nodes, [5, 1, 3, 7, 4, 6, 0, 2], "trees by root, first child first");
        let cases: [(usize, &[u32]); 4] =
            [(5, &[1, 3, 4, 0, 2]), (4, &[5, 4, 0, 2]), (3, &[5, 4, 6]), (2, &[5, 7])];
        for (leaf_count, expected) in cases {
            assert_eq!(uniform(&order, leaf_count).as_deref(), Ok(expected), "{leaf_count}");
        }
        for leaf_count in [0, 1, 6] {
            let error = uniform(&order, leaf_count).expect_err("out of range").to_string();
            assert_eq!(error, format!("leaf_count must be in [2, 5], got {leaf_count}"), "named");
        }
        let mut list = vec![1, 3, 4, 0, 2];
        let mut changes = Changes::default();
        step(&order, &mut list, 3, &mut changes).expect("in range");
        assert_eq!(list, [5, 4, 6], "two steps coarser");
        let old: Vec<_> = changes.edits.iter().map(|edit| edit.old.clone()).collect();
        assert_eq!(old, [0..2, 3..5], "the leaf between them is kept");
        assert!(step(&order, &mut list, 1, &mut changes).is_err(), "below the roots");
        assert_eq!(list, [5, 4, 6], "left as it was");
    }

    #[test]
    fn a_few_collapses_are_looked_up_and_many_walked_past() {
        let forest = chain(4000);
        let order = DepthFirst::new(&forest);
        let mut list = uniform(&order, 4000).expect("all leaves");
        let mut changes = Changes::default();
        // by one, by a few, and by nearly all, either way
        for leaf_count in [3999, 3990, 3995, 10, 9, 3500, 3501, 1, 4000] {
            let old = list.clone();
            step(&order, &mut list, leaf_count, &mut changes).expect("in range");
            assert_eq!(Ok(&list), uniform(&order, leaf_count).as_ref(), "at {leaf_count}");
            assert_ne!(old, list, "something has changed");
        }
    }

    proptest! {
        #[test]
        fn levels_are_as_defined_and_steps_lead_from_one_to_the_next(
            forest in random_forest(120),
            shares in prop::collection::vec(0.0..=1.0_f64, 1..12),
        ) {
            let order = DepthFirst::new(&forest);
            let (fewest, most) = (forest.root_count(), forest.leaf_count as usize);
            let mut list = uniform(&order, most).expect("all leaves");
            let mut changes = Changes::default();
            for share in shares {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "few")]
                let leaf_count = fewest + (share * (most - fewest) as f64).round() as usize;
                let old = list.clone();
                step(&order, &mut list, leaf_count, &mut changes).expect("in range");
                let mut sorted = list.clone();
                sorted.sort_unstable();
                prop_assert_eq!(sorted, uniform_naive(&forest, leaf_count));
                prop_assert_eq!(&list, &uniform(&order, leaf_count).expect("in range"));
                for (entry, node) in (0_u32..).zip(&list) {
                    let is_dirty = changes.dirty.iter().any(|range| range.contains(&entry));
                    let was = old.get(entry as usize);
                    prop_assert_eq!(is_dirty, was != Some(node), "entry {}", entry);
                }
                // either way of finding what differs finds the same
                let (from, to) = (made(&order, old.len()), made(&order, leaf_count));
                let (from, to) = (from.expect("in range"), to.expect("in range"));
                let (fine, coarse) = (from.min(to), from.max(to));
                let mut ways = [Changes::default(), Changes::default()];
                walk(&order, fine, coarse, from, to, &mut ways[0]);
                search(&order, &old, fine..coarse, from, to, &mut ways[1]);
                prop_assert_eq!(&ways[0], &ways[1], "walked and looked up");
            }
        }
    }
}
