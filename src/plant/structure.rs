//! How a grown plant branches: which triangles and leaves belong to which branch.
//!
//! Branches are stored depth first, and wood and leaves follow that order, so everything that grows
//! on a branch, on its children, and on theirs, is one contiguous range of branches, of wood
//! triangles and of leaves.

use std::ops::Range;

use glam::Vec3;

use crate::error::{LodError, check_finite};

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
    /// Refuses branches that do not lie depth first, and those whose wood and leaves are not all of a
    /// plant's, one branch after the other.
    ///
    /// # Errors
    /// [`LodError::Invalid`], [`LodError::NotFinite`].
    pub fn check(&self, wood_triangle_count: usize, leaf_count: usize) -> Result<(), LodError> {
        let wrong = |why: String| Err(LodError::Invalid { name: "structure", why });
        // the branch before and those it grows from, the trunk first
        let mut below: Vec<u32> = Vec::new();
        let (mut next_triangle, mut next_leaf) = (0, 0);
        for (id, branch) in (0_u32..).zip(&self.branches) {
            if branch.parent.is_some_and(|parent| parent >= id) {
                return wrong(format!("branch {id} comes before its parent"));
            }
            while let Some(&last) = below.last()
                && branch.parent != Some(last)
            {
                below.pop();
            }
            if branch.parent.is_some() && below.is_empty() {
                return wrong(format!("branch {id} is parted from its parent's other branches"));
            }
            below.push(id);
            for (what, range, next, count) in [
                ("wood triangles", &branch.wood_triangles, &mut next_triangle, wood_triangle_count),
                ("leaves", &branch.leaves, &mut next_leaf, leaf_count),
            ] {
                if range.start > range.end || range.end as usize > count {
                    return wrong(format!("branch {id} has {what} {range:?} of {count}"));
                }
                if range.start != *next {
                    return wrong(format!("branch {id} has {what} {range:?}, not from {next} on"));
                }
                *next = range.end;
            }
            check_finite("structure", &[branch.start, branch.end, Vec3::splat(branch.radius)])?;
        }
        for (what, next, count) in [
            ("wood triangles", next_triangle, wood_triangle_count),
            ("leaves", next_leaf, leaf_count),
        ] {
            if next as usize != count {
                return wrong(format!("the branches have {next} {what} of {count}"));
            }
        }
        if self.leaf_branches.len() != leaf_count {
            let count = self.leaf_branches.len();
            return wrong(format!("leaf_branches has {count} values for {leaf_count} leaves"));
        }
        let is_known = |&branch: &u32| (branch as usize) < self.branches.len();
        if !self.leaf_branches.iter().all(is_known) || !self.leaf_branches.is_sorted() {
            return wrong("leaf_branches must rise and name branches".to_owned());
        }
        for (id, branch) in (0_u32..).zip(&self.branches) {
            let range = branch.leaves.start as usize..branch.leaves.end as usize;
            if self.leaf_branches[range].iter().any(|&of| of != id) {
                return wrong(format!("leaf_branches and the leaves of branch {id} disagree"));
            }
        }
        Ok(())
    }

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
        assert!(structure.check(0, 0).is_ok(), "depth first");
        let mut parted = structure;
        // a twig of the first limb after the second limb
        parted.branches[4].parent = Some(1);
        let message = parted.check(0, 0).expect_err("parted").to_string();
        let expected = "structure: branch 4 is parted from its parent's other branches";
        assert_eq!(message, expected, "the first limb's sub-tree is not whole");
        parted.branches[4].parent = None;
        assert!(parted.check(0, 0).is_ok(), "a second trunk");
        parted.branches.push(parted.branches[3].clone());
        let message = parted.check(0, 0).expect_err("parted").to_string();
        assert!(message.contains("branch 5 is parted"), "beyond the second trunk: {message}");
    }

    #[test]
    fn what_a_plant_does_not_have_is_refused() {
        let branch = |parent, wood_triangles, leaves| Branch {
            parent,
            level: 0,
            start: Vec3::ZERO,
            end: Vec3::Y,
            radius: 1.0,
            wood_triangles,
            leaves,
        };
        let good = Structure {
            branches: vec![branch(None, 0..4, 0..1), branch(Some(0), 4..6, 1..3)],
            leaf_branches: vec![0, 1, 1],
        };
        assert!(good.check(6, 3).is_ok(), "six triangles and three leaves");
        let changed = |change: &dyn Fn(&mut Structure)| {
            let mut wrong = good.clone();
            change(&mut wrong);
            wrong.check(6, 3).expect_err("wrong").to_string()
        };
        for (change, expected) in [
            (
                &(|s: &mut Structure| s.branches[1].parent = Some(1)) as &dyn Fn(&mut Structure),
                "structure: branch 1 comes before its parent",
            ),
            (
                &|s| s.branches[1].wood_triangles.end = 7,
                "structure: branch 1 has wood triangles 4..7 of 6",
            ),
            (&|s| s.branches[1].leaves.start = 4, "structure: branch 1 has leaves 4..3 of 3"),
            (
                &|s| s.leaf_branches.truncate(1),
                "structure: leaf_branches has 1 values for 3 leaves",
            ),
            (&|s| s.leaf_branches[0] = 2, "structure: leaf_branches must rise and name branches"),
            (&|s| s.leaf_branches[2] = 0, "structure: leaf_branches must rise and name branches"),
            (
                &|s| s.branches[1].wood_triangles.start = 5,
                "structure: branch 1 has wood triangles 5..6, not from 4 on",
            ),
            (
                &|s| s.branches[1].wood_triangles.start = 3,
                "structure: branch 1 has wood triangles 3..6, not from 4 on",
            ),
            (
                &|s| s.branches[1].wood_triangles.end = 5,
                "structure: the branches have 5 wood triangles of 6",
            ),
            (
                &|s| s.branches[0].leaves = 1..1,
                "structure: branch 0 has leaves 1..1, not from 0 on",
            ),
            (&|s| s.branches[1].leaves.end = 2, "structure: the branches have 2 leaves of 3"),
            (
                &|s| s.leaf_branches[1] = 0,
                "structure: leaf_branches and the leaves of branch 1 disagree",
            ),
        ] {
            assert_eq!(changed(change), expected, "names what is wrong");
        }
        assert!(
            changed(&|s| s.branches[0].radius = f32::NAN).contains("structure"),
            "NaN is no radius"
        );
    }
}
