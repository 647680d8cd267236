//! Which limbs share a layer: a hierarchy of groups of limbs, parted where they lie farthest apart.
//!
//! At first the trunk is a group, and all that grows from it is another. Then, until there are enough,
//! the group that gains most is parted in two: several limbs that grow from one into two groups of
//! them; a single limb gives some of its side branches to a new group that grows from it. The gain is what
//! the sum of squared distances from the groups' means falls by, each limb weighed by the area that
//! grows on it and on what grows from it: a group is to be flattened, and to move as one.
//!
//! Limbs to be parted lie along one axis, that of their largest spread, and the best cut across it is
//! taken; of equals the first. A group therefore hangs together. O(limbs * groups).
//!
//! This work is based on:
//! Daniel Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming. 2003 (chapter 20;
//! it draws layers by hand)
//! Joe H. Ward. Hierarchical Grouping to Optimize an Objective Function. 1963 (the gain)

use glam::{DMat3, DVec3};

use crate::error::LodError;
use crate::job::Job;
use crate::lod::eigen::smallest_eigenvector;
use crate::plant::limbs::Limbs;

/// An area and where it is.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Moment {
    /// Square metres.
    pub(super) area: f64,
    /// Area times place.
    pub(super) sum: DVec3,
}

impl Moment {
    pub(super) fn new(area: f64, place: DVec3) -> Self {
        Self { area, sum: place * area }
    }

    pub(super) fn add(&mut self, other: Self) {
        self.area += other.area;
        self.sum += other.sum;
    }

    /// Where it is on the mean, or `place` if it has no area.
    pub(super) fn mean_or(self, place: DVec3) -> DVec3 {
        if self.area > 0.0 { self.sum / self.area } else { place }
    }

    /// What two of them are squared metres apart, weighed by their areas.
    fn gain(self, other: Self) -> f64 {
        if self.area > 0.0 && other.area > 0.0 {
            let apart = self.sum / self.area - other.sum / other.area;
            self.area * other.area / (self.area + other.area) * apart.length_squared()
        } else {
            0.0
        }
    }
}

/// Limbs that move as one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Group {
    /// The group it grows from, which comes before it.
    pub(super) parent: Option<usize>,
    /// Its place in the hierarchy.
    pub(super) name: String,
    /// How many groups it grows from, one from the other.
    pub(super) level: u32,
    /// The limbs it begins with, all of which grow from one.
    pub(super) roots: Vec<u32>,
    /// Where they begin, on the mean.
    pub(super) anchor: DVec3,
}

/// At most `count` groups, and the group of each limb; `content` is what grows on each limb itself.
///
/// # Errors
/// [`LodError::Cancelled`].
pub(super) fn groups(
    limbs: &Limbs,
    content: &[Moment],
    count: usize,
    job: &Job,
) -> Result<(Vec<Group>, Vec<usize>), LodError> {
    let mut parting = Parting::new(limbs, content, count);
    while parting.groups.len() < count {
        job.check()?;
        if !parting.part_one() {
            break;
        }
    }
    Ok(parting.finish())
}

struct Open {
    parent: Option<usize>,
    roots: Vec<u32>,
}

struct Parting<'a> {
    limbs: &'a Limbs,
    content: &'a [Moment],
    children: Vec<Vec<u32>>,
    groups: Vec<Open>,
    group_of: Vec<usize>,
}

impl<'a> Parting<'a> {
    fn new(limbs: &'a Limbs, content: &'a [Moment], count: usize) -> Self {
        let limb_count = limbs.parents.len();
        let mut children = vec![Vec::new(); limb_count];
        let mut roots = Vec::new();
        for (limb, parent) in (0_u32..).zip(&limbs.parents) {
            match parent {
                Some(parent) => children[*parent as usize].push(limb),
                None => roots.push(limb),
            }
        }
        let mut group_of = vec![0; limb_count];
        let mut groups = vec![Open { parent: None, roots }];
        if let [trunk] = groups[0].roots[..]
            && !children[trunk as usize].is_empty()
            && count > 1
        {
            // the trunk is by itself from the start
            group_of.fill(1);
            group_of[trunk as usize] = 0;
            groups.push(Open { parent: Some(0), roots: children[trunk as usize].clone() });
        }
        Self { limbs, content, children, groups, group_of }
    }

    /// What grows on each limb and, in the same group, from it.
    fn subtrees(&self) -> Vec<Moment> {
        let mut moments = self.content.to_vec();
        for limb in (0..moments.len()).rev() {
            if let Some(parent) = self.limbs.parents[limb]
                && self.group_of[parent as usize] == self.group_of[limb]
            {
                let moment = moments[limb];
                moments[parent as usize].add(moment);
            }
        }
        moments
    }

    /// Parts the group that gains most; false if none gains.
    fn part_one(&mut self) -> bool {
        let moments = self.subtrees();
        let mut best: Option<(f64, usize, Vec<u32>)> = None;
        for (number, group) in self.groups.iter().enumerate() {
            let found = self.parted(group, number, &moments);
            if let Some((gain, moved)) = found
                && best.as_ref().is_none_or(|best| gain > best.0)
            {
                best = Some((gain, number, moved));
            }
        }
        let Some((_, old, moved)) = best else { return false };
        let new = self.groups.len();
        for &limb in &moved {
            self.group_of[limb as usize] = new;
        }
        // what grows from the moved ones goes with them; a parent comes first
        for limb in 0..self.group_of.len() {
            if let Some(parent) = self.limbs.parents[limb]
                && self.group_of[limb] == old
                && self.group_of[parent as usize] == new
            {
                self.group_of[limb] = new;
            }
        }
        let side_branches = self.groups[old].roots.len() == 1;
        let parent = if side_branches { Some(old) } else { self.groups[old].parent };
        self.groups[old].roots.retain(|root| moved.binary_search(root).is_err());
        self.groups.push(Open { parent, roots: moved });
        for number in 0..new {
            let grows_from = self.limbs.parents[self.groups[number].roots[0] as usize];
            self.groups[number].parent = grows_from.map(|limb| self.group_of[limb as usize]);
        }
        true
    }

    /// The best way to part a group: its gain, and the limbs that leave, sorted.
    fn parted(&self, group: &Open, number: usize, moments: &[Moment]) -> Option<(f64, Vec<u32>)> {
        let atom = |limb: u32| {
            let moment = moments[limb as usize];
            Atom {
                limb,
                moment,
                place: moment.mean_or(self.limbs.starts[limb as usize]),
                stays: false,
            }
        };
        if let [root] = group.roots[..] {
            let own = self.content[root as usize];
            let place = own.mean_or(self.limbs.starts[root as usize]);
            let side_branches = self.children[root as usize].iter().copied();
            let inside = side_branches.filter(|&limb| self.group_of[limb as usize] == number);
            let mut atoms: Vec<Atom> = inside.map(atom).collect();
            atoms.push(Atom { limb: root, moment: own, place, stays: true });
            part(atoms)
        } else {
            let lowest = group.roots.iter().min().copied();
            let all = group.roots.iter().map(|&limb| {
                // one side keeps the group's place
                Atom { stays: Some(limb) == lowest, ..atom(limb) }
            });
            part(all.collect())
        }
    }

    /// Sorts the groups depth first, and names them.
    fn finish(self) -> (Vec<Group>, Vec<usize>) {
        let moments = self.subtrees();
        let count = self.groups.len();
        let mut below: Vec<Vec<usize>> = vec![Vec::new(); count];
        let mut tops = Vec::new();
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by_key(|&number| self.groups[number].roots.iter().min().copied());
        for number in order {
            match self.groups[number].parent {
                Some(parent) => below[parent].push(number),
                None => tops.push(number),
            }
        }
        let name_of_top = |at: usize| {
            if tops.len() == 1 { "trunk".to_owned() } else { at.to_string() }
        };
        // (group, name, new number of the one it grows from), the next one last
        let mut open: Vec<(usize, String, Option<usize>)> =
            tops.iter().enumerate().rev().map(|(at, &top)| (top, name_of_top(at), None)).collect();
        let mut groups: Vec<Group> = Vec::with_capacity(count);
        let mut new_number = vec![0; count];
        while let Some((number, name, parent)) = open.pop() {
            let here = groups.len();
            new_number[number] = here;
            let children = below[number].iter().enumerate().rev();
            open.extend(children.map(|(at, &child)| (child, format!("{name}/{at}"), Some(here))));
            let mut roots = self.groups[number].roots.clone();
            roots.sort_unstable();
            groups.push(Group {
                parent,
                name,
                level: parent.map_or(0, |parent: usize| groups[parent].level + 1),
                anchor: self.anchor(&roots, &moments),
                roots,
            });
        }
        (groups, self.group_of.into_iter().map(|number| new_number[number]).collect())
    }

    /// Where some limbs begin, on the mean over what grows on them.
    fn anchor(&self, roots: &[u32], moments: &[Moment]) -> DVec3 {
        let start = |limb: u32| self.limbs.starts[limb as usize];
        if let [root] = roots {
            return start(*root);
        }
        let middle = roots.iter().map(|&limb| start(limb)).sum::<DVec3>() / roots.len() as f64;
        let mut all = Moment::default();
        for &limb in roots {
            all.add(Moment::new(moments[limb as usize].area, start(limb)));
        }
        all.mean_or(middle)
    }
}

/// Something that stays whole when a group is parted.
#[derive(Debug, Clone, Copy)]
struct Atom {
    limb: u32,
    moment: Moment,
    place: DVec3,
    /// The side with this one keeps the group.
    stays: bool,
}

/// The best cut across the axis along which atoms lie farthest apart: what it gains, and the limbs on
/// the side that does not stay, sorted.
fn part(mut atoms: Vec<Atom>) -> Option<(f64, Vec<u32>)> {
    let mut all = Moment::default();
    atoms.iter().for_each(|atom| all.add(atom.moment));
    if atoms.len() < 2 || all.area <= 0.0 {
        return None;
    }
    let mean = all.sum / all.area;
    let mut spread = DMat3::ZERO;
    for atom in &atoms {
        let offset = atom.place - mean;
        let weighed = offset * atom.moment.area;
        spread += DMat3::from_cols(weighed * offset.x, weighed * offset.y, weighed * offset.z);
    }
    // the largest eigenvalue of a matrix is the smallest of its negative
    let (_, axis) = smallest_eigenvector(&-spread);
    let along = |atom: &Atom| (atom.place - mean).dot(axis);
    atoms.sort_by(|a, b| along(a).total_cmp(&along(b)).then(a.limb.cmp(&b.limb)));
    // sums from the far end: differences would leave rounding where nothing is left
    let mut rests = vec![Moment::default(); atoms.len()];
    for at in (1..atoms.len()).rev() {
        let mut rest = rests.get(at + 1).copied().unwrap_or_default();
        rest.add(atoms[at].moment);
        rests[at] = rest;
    }
    let mut best: Option<(f64, usize)> = None;
    let mut first = Moment::default();
    for end in 1..atoms.len() {
        first.add(atoms[end - 1].moment);
        let gain = first.gain(rests[end]);
        if gain > best.map_or(0.0, |best| best.0) {
            best = Some((gain, end));
        }
    }
    let (gain, end) = best?;
    let (low, high) = atoms.split_at(end);
    let moved = if low.iter().any(|atom| atom.stays) { high } else { low };
    let mut moved: Vec<u32> = moved.iter().map(|atom| atom.limb).collect();
    moved.sort_unstable();
    Some((gain, moved))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_limb_is_parted_from_another_before_a_small_one_that_is_farther() {
        // along a trunk at x = 0: 100 m2 at x = 1, 100 m2 at x = 2, and 0.01 m2 at x = 4
        let limbs = Limbs {
            parents: vec![None, Some(0), Some(0), Some(0)],
            starts: vec![DVec3::ZERO; 4],
            leaf_limbs: vec![],
            wood_limbs: vec![],
        };
        let content = [(0.0, 0.0), (100.0, 1.0), (100.0, 2.0), (0.01, 4.0)]
            .map(|(area, x)| Moment::new(area, DVec3::X * x));
        let (_, group_of) = groups(&limbs, &content, 3, &Job::default()).expect("runs");
        assert_eq!(group_of, [0, 1, 2, 2], "50 m4 against 0.06");
        let (_, group_of) = groups(&limbs, &content, 4, &Job::default()).expect("runs");
        assert_eq!(group_of, [0, 1, 2, 3], "the small one next");
    }
}
