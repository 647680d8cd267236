//! Where the paper's iteration misses a cluster's best plane, and by how much.
//!
//! The clusters stay as they are: what differs is the plane alone ([`Eigen`]).

use glam::Vec3;

use crate::error::LodError;
use crate::job::Job;
use crate::lod::leaf_clusters::kmeans::{check_ids, check_leaves};
use crate::lod::leaf_clusters::leaves::Leaves;
use crate::lod::leaf_clusters::plane::{Eigen, Plane};
use crate::lod::leaf_clusters::sums::Sums;

/// A cluster's planes by both ways, and their errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Miss {
    /// Leaves of the cluster.
    pub leaf_count: u64,
    /// The best plane.
    pub best: Plane,
    /// Its error, in square metres.
    pub best_cost: f64,
    /// Where the paper's iteration ends.
    pub paper: Plane,
    /// Its error.
    pub paper_cost: f64,
}

/// Both planes of each cluster; of one without leaves, errors of 0.
///
/// # Errors
/// As [`kmeans::cluster`](super::kmeans::cluster), with `cluster_ids` for the ids.
pub fn misses(
    centers: &[Vec3],
    normals: &[Vec3],
    cluster_ids: &[u32],
    cluster_count: usize,
    alpha: f64,
    job: &Job,
) -> Result<Vec<Miss>, LodError> {
    check_leaves(centers, normals, cluster_count, alpha, job)?;
    check_ids("cluster_ids", cluster_ids, centers.len(), cluster_count, job)?;
    let leaves = Leaves::new(centers, normals, alpha, job)?;
    let mut sums = vec![Sums::default(); cluster_count];
    for (leaf, &id) in cluster_ids.iter().enumerate() {
        if leaf % crate::job::ELEMENTS_PER_CHECK == 0 {
            job.check()?;
        }
        sums[id as usize].add::<1>(leaves.leaf(leaf));
    }
    let area = leaves.scale * leaves.scale;
    let miss = |sums: &Sums| {
        let moments = sums.moments();
        let fits = [Eigen::Exact, Eigen::Paper].map(|eigen| {
            let plane = Plane::fitted(&moments, leaves.alpha, eigen);
            (leaves.outward(&plane), moments.cost(plane.normal, leaves.alpha) * area)
        });
        let [(best, best_cost), (paper, paper_cost)] = fits;
        Miss { leaf_count: moments.count, best, best_cost, paper, paper_cost }
    };
    Ok(sums.iter().map(miss).collect())
}
