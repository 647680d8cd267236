//! How a grown plant branches: which triangles and leaves belong to which branch.
//!
//! Branches are stored depth first, and wood and leaves follow that order, so everything that grows
//! on a branch, on its children, and on theirs, is one contiguous range of branches, of wood
//! triangles and of leaves.

use std::ops::Range;

use glam::Vec3;

/// One stem, from where it leaves its parent to its tip.
#[derive(Debug, Clone, PartialEq)]
pub struct Branch {
    /// Index of the branch it grows from, always lower than its own; `None` for a trunk.
    pub parent: Option<u32>,
    /// 0 for the trunk and its forks, one more for each generation of side branches.
    pub level: u32,
    /// Where its axis begins, in metres, relative to the plant's origin.
    pub start: Vec3,
    /// Where its axis ends.
    pub end: Vec3,
    /// Radius at the start, in metres.
    pub radius: f32,
    /// Its own triangles, as a range of the wood's.
    pub wood_triangles: Range<u32>,
    /// The leaves that grow on itself.
    pub leaves: Range<u32>,
}

/// The branches of a plant, depth first.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Structure {
    /// A parent comes before its children, and a whole sub-tree before its next sibling.
    pub branches: Vec<Branch>,
    /// Branch of each leaf; never decreases.
    pub leaf_branches: Vec<u32>,
}

impl Structure {
    /// A branch with everything that grows from it, as a range of branches.
    pub fn subtree(&self, branch: usize) -> Range<usize> {
        let inside = |other: &Branch| other.parent.is_some_and(|parent| parent as usize >= branch);
        let after = &self.branches[branch + 1..];
        let end = after.iter().position(|other| !inside(other)).unwrap_or(after.len());
        branch..branch + 1 + end
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subtree_ends_at_the_next_sibling() {
        //      2   4
        //  1 ──┘   │      0: trunk, 1 and 3: limbs, 2 and 4: twigs
        //  0 ──────3
        let parents = [None, Some(0), Some(1), Some(0), Some(3)];
        let branch = |parent| Branch {
            parent,
            level: 0,
            start: Vec3::ZERO,
            end: Vec3::Y,
            radius: 1.0,
            wood_triangles: 0..0,
            leaves: 0..0,
        };
        let branches = parents.into_iter().map(branch).collect();
        let structure = Structure { branches, leaf_branches: vec![] };
        let found: Vec<_> = (0..5).map(|i| structure.subtree(i)).collect();
        assert_eq!(found, [0..5, 1..3, 2..3, 3..5, 4..5], "trunk, limb, twig, limb, twig");
    }
}
