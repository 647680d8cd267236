//! The nodes that are drawn, in depth-first order, and what a step from one such list to another
//! changes.
//!
//! A step is a list of edits: ranges of the old list, each with what takes its place. All that lies
//! between two edits is kept, and moves by what the edits before it added or took away.

use std::ops::Range;

/// Part of an old list and what it becomes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Edit {
    /// Entries of the old list that go.
    pub old: Range<u32>,
    /// What comes in their place, as a range of [`Changes::inserted`].
    pub inserted: Range<u32>,
}

/// What turns one list of active nodes into another.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Changes {
    /// Ascending and apart.
    pub edits: Vec<Edit>,
    /// New entries of all edits, in order.
    pub inserted: Vec<u32>,
    /// Ranges of the new list in which it differs from the old one, ascending, apart and not
    /// touching one another; what the old list had beyond the new one's end is not named.
    pub dirty: Vec<Range<u32>>,
    /// The list before this one, once it is of no use.
    spare: Vec<u32>,
}

impl Changes {
    /// Forgets all.
    pub fn clear(&mut self) {
        self.edits.clear();
        self.inserted.clear();
        self.dirty.clear();
    }

    /// Replaces a range of the old list, behind all edits so far.
    pub fn replace(&mut self, old: Range<usize>, nodes: &[u32]) {
        let start = self.inserted.len();
        self.inserted.extend_from_slice(nodes);
        self.push(old, start);
    }

    /// Replaces a range of the old list by what was appended to `inserted` from `start` on.
    pub fn push(&mut self, old: Range<usize>, start: usize) {
        let inserted = short(&(start..self.inserted.len()));
        self.edits.push(Edit { old: short(&old), inserted });
    }

    /// Carries the edits out, and finds what they make dirty. Where the list gets longer or shorter in
    /// between, all behind it moves: every entry is copied once, into memory that is kept for it.
    pub fn apply(&mut self, list: &mut Vec<u32>) {
        self.dirty.clear();
        if self.edits.is_empty() {
            return;
        }
        let Self { edits, inserted, dirty, spare } = self;
        spare.clear();
        let mut kept = 0;
        for edit in edits {
            let begin = spare.len();
            spare.extend_from_slice(&list[kept..edit.old.start as usize]);
            let from = if begin == kept { spare.len() } else { begin };
            let range = edit.inserted.start as usize..edit.inserted.end as usize;
            spare.extend_from_slice(&inserted[range]);
            kept = edit.old.end as usize;
            mark(dirty, from..spare.len());
        }
        let begin = spare.len();
        spare.extend_from_slice(&list[kept..]);
        if begin != kept {
            mark(dirty, begin..spare.len());
        }
        std::mem::swap(list, spare);
    }
}

/// Adds a range behind all others.
fn mark(dirty: &mut Vec<Range<u32>>, range: Range<usize>) {
    let range = short(&range);
    if range.is_empty() {
        return;
    }
    match dirty.last_mut() {
        Some(last) if last.end == range.start => last.end = range.end,
        _ => dirty.push(range),
    }
}

fn short(range: &Range<usize>) -> Range<u32> {
    let short = |end| u32::try_from(end).expect("lists are counted in 32 bits");
    short(range.start)..short(range.end)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn applied(edits: &[(Range<usize>, &[u32])]) -> (Vec<u32>, Vec<(u32, u32)>) {
        let mut list = vec![10, 11, 12, 13, 14];
        let mut changes = Changes::default();
        for (old, nodes) in edits {
            changes.replace(old.clone(), nodes);
        }
        changes.apply(&mut list);
        (list, changes.dirty.into_iter().map(|range| (range.start, range.end)).collect())
    }

    #[test]
    fn what_lies_between_edits_is_kept_and_moves() {
        assert_eq!(applied(&[]), (vec![10, 11, 12, 13, 14], vec![]), "nothing to do");
        let same_length = applied(&[(1..2, &[7]), (3..4, &[8])]);
        assert_eq!(same_length, (vec![10, 7, 12, 8, 14], vec![(1, 2), (3, 4)]), "nothing moves");
        let grown = applied(&[(1..2, &[7, 8])]);
        assert_eq!(grown, (vec![10, 7, 8, 12, 13, 14], vec![(1, 6)]), "the tail moves up");
        let shrunk = applied(&[(0..3, &[7])]);
        assert_eq!(shrunk, (vec![7, 13, 14], vec![(0, 3)]), "the tail moves down");
        let balanced = applied(&[(0..1, &[7, 8]), (2..4, &[9])]);
        assert_eq!(balanced, (vec![7, 8, 11, 9, 14], vec![(0, 4)]), "the last entry stays");
        let last = applied(&[(3..5, &[])]);
        assert_eq!(last, (vec![10, 11, 12], vec![]), "nothing that is left has changed");
    }
}
