//! Coarser clusterings from a fine one: the pair whose union costs least is merged, again and again.
//!
//! The cost of a merge is what it adds to the total error, `E_ab - E_a - E_b`, each under its own best
//! plane; of equal pairs the lowest indices go first. Levels are nested: every cluster has a parent in
//! the next coarser level. O(K) memory; O(K^2) plane fits for K clusters as a rule, O(K^3) at worst.
//!
//! This work is based on:
//! Joe H. Ward. Hierarchical grouping to optimize an objective function. 1963

use crate::error::LodError;
use crate::job::Job;
use crate::lod::leaf_clusters::moments::Moments;
use crate::lod::leaf_clusters::plane::{Eigen, Plane};

/// One clustering of all leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    /// Cluster of each leaf.
    pub cluster_ids: Vec<u32>,
    /// Plane of each cluster.
    pub planes: Vec<Plane>,
    /// What is known of each cluster's leaves.
    pub moments: Vec<Moments>,
    /// Cluster of the next level that each cluster went into; empty in the coarsest.
    pub parents: Vec<u32>,
}

impl Level {
    /// Coarser levels of the given counts, which fall; those that are not below the count that is
    /// reached are left out. The finest level, with its parents, comes first.
    ///
    /// # Errors
    /// [`LodError::Cancelled`].
    pub fn coarsened(
        mut self,
        counts: &[usize],
        alpha: f64,
        eigen: Eigen,
        job: &Job,
    ) -> Result<Vec<Self>, LodError> {
        let mut levels = Vec::new();
        let mut merging: Option<Merging> = None;
        for &count in counts {
            if count >= self.planes.len() {
                continue;
            }
            let merging = match &mut merging {
                Some(merging) => merging,
                none => none.insert(Merging::new(&self, alpha, eigen, job)?),
            };
            let coarse = merging.reduce(&mut self, count, job)?;
            levels.push(std::mem::replace(&mut self, coarse));
        }
        levels.push(self);
        Ok(levels)
    }
}

/// A cluster that is not part of another yet.
#[derive(Debug, Clone)]
struct Node {
    moments: Moments,
    plane: Plane,
    error: f64,
    /// The partner that it is cheapest to merge with, among those of higher index, and the cost.
    best: Option<(f64, usize)>,
}

/// Clusters on their way from one level to the next: each keeps its lowest member's place.
struct Merging {
    alpha: f64,
    eigen: Eigen,
    nodes: Vec<Option<Node>>,
    /// Place of each cluster of the last level.
    places: Vec<usize>,
}

impl Merging {
    fn new(level: &Level, alpha: f64, eigen: Eigen, job: &Job) -> Result<Self, LodError> {
        let node = |(moments, &plane): (&Moments, &Plane)| {
            let error = moments.cost(plane.normal, alpha);
            Some(Node { moments: *moments, plane, error, best: None })
        };
        let nodes = level.moments.iter().zip(&level.planes).map(node).collect();
        let places = (0..level.planes.len()).collect();
        let mut merging = Self { alpha, eigen, nodes, places };
        for a in 0..merging.nodes.len() {
            job.check()?;
            merging.find_best(a);
        }
        Ok(merging)
    }

    fn union(&self, a: &Node, b: &Node) -> Node {
        let moments = a.moments.merge(&b.moments);
        let plane = Plane::fitted(&moments, self.alpha, self.eigen);
        let error = moments.cost(plane.normal, self.alpha);
        Node { moments, plane, error, best: None }
    }

    fn cost(&self, a: &Node, b: &Node) -> f64 {
        self.union(a, b).error - a.error - b.error
    }

    fn find_best(&mut self, a: usize) {
        let Some(node) = &self.nodes[a] else { return };
        let mut best: Option<(f64, usize)> = None;
        for (b, other) in self.nodes.iter().enumerate().skip(a + 1) {
            let Some(other) = other else { continue };
            let cost = self.cost(node, other);
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, b));
            }
        }
        self.nodes[a].as_mut().expect("looked up above").best = best;
    }

    /// Merges until `count` clusters are left; `fine` learns its parents.
    fn reduce(&mut self, fine: &mut Level, count: usize, job: &Job) -> Result<Level, LodError> {
        let mut left = self.nodes.iter().flatten().count();
        while left > count {
            job.check()?;
            let candidates = self.nodes.iter().enumerate().filter_map(|(a, node)| {
                let (cost, b) = node.as_ref()?.best?;
                Some((cost, a, b))
            });
            let Some((_, a, b)) = candidates.min_by(|x, y| x.0.total_cmp(&y.0)) else { break };
            let first = self.nodes[a].take().expect("alive");
            let second = self.nodes[b].take().expect("alive");
            self.nodes[a] = Some(self.union(&first, &second));
            self.places.iter_mut().filter(|place| **place == b).for_each(|place| *place = a);
            self.renew(a, b, job)?;
            left -= 1;
        }
        let kept: Vec<usize> = (0..self.nodes.len()).filter(|&a| self.nodes[a].is_some()).collect();
        let number = |place: usize| {
            let at = kept.binary_search(&place).expect("a cluster's place is alive");
            u32::try_from(at).expect("few clusters")
        };
        fine.parents = self.places.iter().map(|&place| number(place)).collect();
        self.places.clone_from(&kept);
        let nodes = || kept.iter().filter_map(|&place| self.nodes[place].as_ref());
        Ok(Level {
            cluster_ids: fine.cluster_ids.iter().map(|&id| fine.parents[id as usize]).collect(),
            planes: nodes().map(|node| node.plane).collect(),
            moments: nodes().map(|node| node.moments).collect(),
            parents: Vec::new(),
        })
    }

    /// Makes every node's best partner true again after `b` went into `a`.
    fn renew(&mut self, a: usize, b: usize, job: &Job) -> Result<(), LodError> {
        self.find_best(a);
        for other in 0..b {
            job.check()?;
            let Some(node) = &self.nodes[other] else { continue };
            if node.best.is_some_and(|(_, partner)| partner == a || partner == b) {
                self.find_best(other);
            } else if other < a {
                let merged = self.nodes[a].as_ref().expect("just made");
                let cost = self.cost(node, merged);
                let node = self.nodes[other].as_mut().expect("looked up above");
                // of equal partners the lower index
                if node
                    .best
                    .is_none_or(|(least, partner)| cost < least || (cost == least && a < partner))
                {
                    node.best = Some((cost, a));
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;

    fn level_of(centers: &[DVec3], normals: &[DVec3], alpha: f64) -> Level {
        let one = |(p, n): (&DVec3, &DVec3)| Moments::of(&[*p], &[*n]);
        let moments: Vec<Moments> = centers.iter().zip(normals).map(one).collect();
        let plane = |m: &Moments| Plane::fitted(m, alpha, Eigen::Exact);
        Level {
            cluster_ids: (0..u32::try_from(centers.len()).expect("few")).collect(),
            planes: moments.iter().map(plane).collect(),
            moments,
            parents: Vec::new(),
        }
    }

    /// Every pair anew at every step: groups of leaves, in the order of their first ones.
    fn merged_naive(level: &Level, count: usize, alpha: f64) -> Vec<Vec<usize>> {
        let error = |m: &Moments| m.cost(Plane::fitted(m, alpha, Eigen::Exact).normal, alpha);
        let mut groups: Vec<(Vec<usize>, Moments)> =
            level.moments.iter().enumerate().map(|(i, m)| (vec![i], *m)).collect();
        while groups.len() > count {
            let mut best = (f64::INFINITY, 0, 0);
            for a in 0..groups.len() {
                for b in a + 1..groups.len() {
                    let (first, second) = (&groups[a].1, &groups[b].1);
                    let cost = error(&first.merge(second)) - error(first) - error(second);
                    if cost < best.0 {
                        best = (cost, a, b);
                    }
                }
            }
            let (_, a, b) = best;
            let (leaves, moments) = groups.remove(b);
            groups[a].0.extend(leaves);
            groups[a].1 = groups[a].1.merge(&moments);
        }
        groups.into_iter().map(|(leaves, _)| leaves).collect()
    }

    #[test]
    fn leaves_of_one_plane_are_merged_first() {
        // two leaves in each of the planes z = 0 and x = 5, far apart inside them
        let centers = [DVec3::ZERO, DVec3::X * 5.0, DVec3::Y * 9.0, DVec3::new(5.0, 9.0, 9.0)];
        let normals = [DVec3::Z, DVec3::X, DVec3::Z, DVec3::X];
        let job = Job::default();
        let levels = level_of(&centers, &normals, 1.0);
        let levels = levels.coarsened(&[2, 1], 1.0, Eigen::Exact, &job).expect("runs");
        assert_eq!(levels.len(), 3, "4, 2 and 1");
        assert_eq!(levels[0].parents, [0, 1, 0, 1], "by plane");
        assert_eq!(levels[1].cluster_ids, [0, 1, 0, 1], "by plane");
        assert_eq!(levels[1].parents, [0, 0], "all");
        assert_eq!(levels[2].cluster_ids, [0; 4], "all");
        assert_eq!(levels[2].moments[0].count, 4, "and all are counted");
        assert!(levels[2].parents.is_empty(), "nothing is coarser");
    }

    #[test]
    fn counts_that_are_not_below_are_left_out() {
        let level = level_of(&[DVec3::ZERO, DVec3::X], &[DVec3::Z; 2], 1.0);
        let levels = level.coarsened(&[64, 5, 2, 1], 1.0, Eigen::Exact, &Job::default());
        assert_eq!(levels.expect("runs").len(), 2, "2 and 1");
        let job = Job::default();
        job.cancel();
        let level = level_of(&[DVec3::ZERO, DVec3::X], &[DVec3::Z; 2], 1.0);
        let stopped = level.coarsened(&[1], 1.0, Eigen::Exact, &job);
        assert_eq!(stopped.expect_err("cancelled"), LodError::Cancelled, "stopped");
    }

    proptest! {
        #[test]
        fn equals_the_naive_twin(
            leaves in prop::collection::vec(prop::array::uniform6(-50..50_i32), 2..24),
            counts in (1..12_usize, 1..4_usize),
        ) {
            let vector = |a: &[i32]| DVec3::new(f64::from(a[0]), f64::from(a[1]), f64::from(a[2]));
            let centers: Vec<DVec3> = leaves.iter().map(|l| vector(&l[..3])).collect();
            let normals: Vec<DVec3> =
                leaves.iter().map(|l| vector(&l[3..]).normalize_or_zero()).collect();
            let level = level_of(&centers, &normals, 3.0);
            let wanted = [counts.0 + counts.1, counts.0];
            let levels = level.clone().coarsened(&wanted, 3.0, Eigen::Exact, &Job::default());
            let coarsest = levels.expect("runs").pop().expect("one at least");
            let groups = merged_naive(&level, counts.0, 3.0);
            for (number, group) in (0_u32..).zip(&groups) {
                for &leaf in group {
                    prop_assert_eq!(coarsest.cluster_ids[leaf], number, "leaf {}", leaf);
                }
            }
        }
    }
}
