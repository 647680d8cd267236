//! K-means of leaves and planes: every leaf to its best plane, every plane to its leaves, in turns.
//!
//! The error of a clustering is the sum over its leaves of the error of leaf and plane
//! ([`Plane::error`]). No turn raises it, with [`Eigen::Exact`], but for rounding.
//!
//! - A leaf goes to the plane of least error, of equals to the one of lower id.
//! - A cluster without leaves takes the leaf of largest error, of equals the one of lower index, among
//!   the leaves that share their cluster with others; several take successive ones. If no such leaf
//!   has an error above 0, the cluster is dropped, and ids close up.
//! - It ends when no leaf changes its cluster, when the error falls by less than 1e-12 of itself, or
//!   after `max_iterations`.
//!
//! Errors that decide are computed in 64 bits, sums are exact (`sums`), and 32-bit
//! vectors only say what need not be computed (`assign`). So the result does not
//! depend on threads or vectors, and permuted leaves that start from the same planes have permuted
//! ids.
//!
//! A turn of `L` leaves and `K` planes costs `L K` errors at most, and less as planes come to rest.
//!
//! This work is based on:
//! Ismael Garcia, Mateu Sbert, László Szirmay-Kalos. Leaf Cluster Impostors for Tree Rendering with
//! Parallax. 2005
//! Stuart P. Lloyd. Least squares quantization in PCM. 1982

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::error::{LodError, check_in, check_limit};
use crate::job::Job;
use crate::lod::leaf_clusters::assign::{Assignment, Change, NO_ID};
use crate::lod::leaf_clusters::leaves::{Leaves, stored};
use crate::lod::leaf_clusters::moments::Moments;
use crate::lod::leaf_clusters::moves::Moves;
use crate::lod::leaf_clusters::nearest::PlaneTable;
use crate::lod::leaf_clusters::plane::{Eigen, Plane};
use crate::lod::leaf_clusters::start;
use crate::lod::leaf_clusters::sums::Sums;
use crate::simd::Level;

/// Clusters, at most: more are a mistake, and their planes outgrow caches.
pub const MAX_CLUSTER_COUNT: usize = 1 << 16;

/// Square metres, at most: beyond, distances are lost in the rounding of angles.
pub const MAX_ALPHA: f64 = 1e12;

/// Random starts, at most.
pub const MAX_RESTARTS: usize = 1 << 16;

/// Turns, at most.
pub const MAX_ITERATIONS: usize = 1 << 20;

/// Leaves, at most: what sums are exact for.
const MAX_LEAF_COUNT: u64 = 1 << 31;

/// How far the length of a normal may be from 1.
const UNIT: f32 = 1e-3;

/// A clustering whose error falls by less than this, of itself, has come to its end.
const LEAST_FALL: f64 = 1e-12;

/// Leaves between two looks at the job.
const NAIVE_LEAVES_PER_CHECK: usize = 16;

/// Changed leaves below which one thread sums them.
const MIN_PARALLEL_CHANGES: usize = 1 << 14;

/// Where a clustering starts.
#[derive(Debug, Clone, PartialEq)]
pub enum Init {
    /// As in the paper: planes of uniform normals through the centres of uniformly drawn leaves.
    Random,
    /// Planes of leaves that are drawn with a probability in proportion to their error so far.
    PlusPlus,
    /// These planes, one a cluster.
    Planes(Vec<Plane>),
    /// This cluster for each leaf.
    Ids(Vec<u32>),
}

/// What to look for, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct Params {
    /// Clusters to start with; in [1, 65536].
    pub cluster_count: usize,
    /// Square metres that a right angle between leaf and plane weighs; in [0, 1e12].
    pub alpha: f64,
    /// Where to start.
    pub init: Init,
    /// What random starts are drawn with.
    pub seed: u64,
    /// How many random starts are tried; the least error wins, of equals the earliest.
    pub restarts: usize,
    /// Turns at most; at least 1.
    pub max_iterations: usize,
    /// How planes are fitted.
    pub eigen: Eigen,
}

/// Leaves in clusters, and a plane for each cluster.
#[derive(Debug, Clone, PartialEq)]
pub struct Clustering {
    /// Which cluster each leaf is in.
    pub cluster_ids: Vec<u32>,
    /// The plane of each cluster, fitted to its leaves; relative to the zero of the centres.
    pub planes: Vec<Plane>,
    /// Those of each cluster's leaves.
    pub moments: Vec<Moments>,
    /// Error of all leaves after each turn, in square metres.
    pub errors: Vec<f64>,
    /// How many turns were taken.
    pub iteration_count: usize,
    /// Whether it ended before `max_iterations` did.
    pub converged: bool,
}

/// How leaves are assigned: all ways give the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Only leaves whose plane may have changed are looked at.
    Pruned,
    /// Every leaf is compared with every plane, in vectors.
    Full,
    /// The same in 64 bits, one by one, all sums from scratch: slow, and plainly right.
    Naive,
}

/// Clusters leaves by their centres (metres) and normals (unit length, or 0 for a leaf without area).
///
/// # Errors
/// [`LodError::Empty`], [`LodError::NotFinite`], [`LodError::OutOfRange`] or [`LodError::Invalid`] for
/// an argument; [`LodError::Cancelled`].
pub fn cluster(
    centers: &[Vec3],
    normals: &[Vec3],
    params: &Params,
    job: &Job,
) -> Result<Clustering, LodError> {
    cluster_by(Method::Pruned, Level::chosen()?, centers, normals, params, job)
}

/// As [`cluster`], by a stated method and vector width.
///
/// # Errors
/// As [`cluster`].
pub fn cluster_by(
    method: Method,
    level: Level,
    centers: &[Vec3],
    normals: &[Vec3],
    params: &Params,
    job: &Job,
) -> Result<Clustering, LodError> {
    check(centers, normals, params, job)?;
    let leaves = Leaves::new(centers, normals, params.alpha, job)?;
    job.begin((params.restarts * params.max_iterations) as u64);
    let mut best: Option<Run> = None;
    for restart in 0..params.restarts as u64 {
        let run = run(&leaves, params, restart, method, level, job)?;
        if best.as_ref().is_none_or(|best| run.error() < best.error()) {
            best = Some(run);
        }
    }
    let best = best.expect("there is at least one start");
    Ok(best.outward(&leaves))
}

fn check(centers: &[Vec3], normals: &[Vec3], params: &Params, job: &Job) -> Result<(), LodError> {
    check_leaves(centers, normals, params.cluster_count, params.alpha, job)?;
    check_in("restarts", params.restarts, 1..=MAX_RESTARTS)?;
    check_in("max_iterations", params.max_iterations, 1..=MAX_ITERATIONS)?;
    let given = match &params.init {
        Init::Random | Init::PlusPlus => return Ok(()),
        Init::Planes(planes) => {
            check_planes(planes, params.cluster_count)?;
            "planes"
        }
        Init::Ids(ids) => {
            check_ids("init", ids, centers.len(), params.cluster_count, job)?;
            "ids"
        }
    };
    if params.restarts == 1 {
        return Ok(());
    }
    let why = format!("must be 1 where init gives {given}: all would end alike");
    Err(LodError::Invalid { name: "restarts", why })
}

/// Checks what every kernel of leaves and planes takes.
pub(super) fn check_leaves(
    centers: &[Vec3],
    normals: &[Vec3],
    cluster_count: usize,
    alpha: f64,
    job: &Job,
) -> Result<(), LodError> {
    let count = centers.len();
    if count == 0 {
        return Err(LodError::Empty { name: "centers", why: "there is no leaf to cluster" });
    }
    check_limit("centers", count as u64, MAX_LEAF_COUNT, "leaves")?;
    if normals.len() != count {
        let why = format!("must be as many as centers, {count}, got {}", normals.len());
        return Err(LodError::Invalid { name: "normals", why });
    }
    for (name, rows) in [("centers", centers), ("normals", normals)] {
        if let Some(index) = job.position(rows, |row| !row.is_finite())? {
            return Err(LodError::NotFinite { name, index });
        }
    }
    let odd = |normal: &Vec3| *normal != Vec3::ZERO && (normal.length() - 1.0).abs() > UNIT;
    if let Some(index) = job.position(normals, odd)? {
        let length = normals[index].length();
        let why = format!("must have length 1 or 0: that of row {index} is {length}");
        return Err(LodError::Invalid { name: "normals", why });
    }
    check_in("cluster_count", cluster_count, 1..=MAX_CLUSTER_COUNT)?;
    check_in("alpha", alpha, 0.0..=MAX_ALPHA)
}

fn check_planes(planes: &[Plane], cluster_count: usize) -> Result<(), LodError> {
    let name = "init";
    if planes.len() != cluster_count {
        let why = format!("must hold cluster_count = {cluster_count} planes, got {}", planes.len());
        return Err(LodError::Invalid { name, why });
    }
    let odd = |plane: &Plane| !plane.normal.is_finite() || !plane.d.is_finite();
    if let Some(index) = planes.iter().position(odd) {
        return Err(LodError::NotFinite { name, index });
    }
    let odd = |plane: &Plane| (plane.normal.length() - 1.0).abs() > f64::from(UNIT);
    if let Some(index) = planes.iter().position(odd) {
        let length = planes[index].normal.length();
        let why = format!("normals must have length 1: that of row {index} is {length}");
        return Err(LodError::Invalid { name, why });
    }
    Ok(())
}

/// Checks that there is a cluster for each leaf.
pub(super) fn check_ids(
    name: &'static str,
    ids: &[u32],
    leaf_count: usize,
    cluster_count: usize,
    job: &Job,
) -> Result<(), LodError> {
    if ids.len() != leaf_count {
        let why = format!("must hold an id for each of {leaf_count} leaves, got {}", ids.len());
        return Err(LodError::Invalid { name, why });
    }
    if let Some(index) = job.position(ids, |&id| id as usize >= cluster_count)? {
        let why = format!("ids must be below {cluster_count}: element {index} is {}", ids[index]);
        return Err(LodError::Invalid { name, why });
    }
    Ok(())
}

/// A finished clustering in the coordinates of [`Leaves`].
struct Run {
    ids: Vec<u32>,
    planes: Vec<Plane>,
    moments: Vec<Moments>,
    errors: Vec<f64>,
    converged: bool,
}

impl Run {
    fn error(&self) -> f64 {
        self.errors.last().copied().unwrap_or(f64::INFINITY)
    }

    fn outward(self, leaves: &Leaves<'_>) -> Clustering {
        let area = leaves.scale * leaves.scale;
        let moments = self.moments.iter().map(|moments| Moments {
            mean: moments.mean * leaves.scale + leaves.origin,
            spread: moments.spread * area,
            ..*moments
        });
        Clustering {
            cluster_ids: self.ids,
            planes: self.planes.iter().map(|plane| leaves.outward(plane)).collect(),
            moments: moments.collect(),
            iteration_count: self.errors.len(),
            errors: self.errors.into_iter().map(|error| error * area).collect(),
            converged: self.converged,
        }
    }
}

fn run(
    leaves: &Leaves<'_>,
    params: &Params,
    restart: u64,
    method: Method,
    level: Level,
    job: &Job,
) -> Result<Run, LodError> {
    let count = params.cluster_count;
    let mut assignment = Assignment::new(leaves);
    let planes = match &params.init {
        Init::Random => start::random(leaves, count, params.seed, restart),
        Init::PlusPlus => start::plus_plus(leaves, count, params.seed, restart, level, job)?,
        Init::Planes(planes) => planes
            .iter()
            .map(|plane| {
                let length = plane.normal.length();
                leaves.inward(&Plane { normal: plane.normal / length, d: plane.d / length })
            })
            .collect(),
        Init::Ids(_) => vec![Plane { normal: DVec3::X, d: 0.0 }; count],
    };
    let mut clusters = Clusters::new(leaves, planes, params.eigen);
    if let Init::Ids(ids) = &params.init {
        for (leaf, &id) in ids.iter().enumerate() {
            assignment.set(leaf, id);
        }
        clusters.apply(&assignment.changes, job)?;
        clusters.refit();
        clusters.fill_empty(&mut assignment, job)?;
        clusters.refit();
    }
    let mut moves: Option<Moves> = None;
    let mut errors: Vec<f64> = Vec::new();
    let mut converged = false;
    while errors.len() < params.max_iterations && !converged {
        job.check()?;
        match method {
            Method::Naive => assign_naively(&mut assignment, leaves, &clusters.planes, job)?,
            Method::Full => {
                let table = PlaneTable::new(&clusters.planes);
                assignment.pass(leaves, &table, None, level, job)?;
            }
            Method::Pruned => {
                let table = PlaneTable::new(&clusters.planes);
                assignment.pass(leaves, &table, moves.as_ref(), level, job)?;
            }
        }
        let still = assignment.change_count() == 0;
        match method {
            Method::Naive => clusters.sum_naively(assignment.ids()),
            _ => clusters.apply(&assignment.changes, job)?,
        }
        let dropped = clusters.fill_empty(&mut assignment, job)?;
        let before = clusters.planes.clone();
        clusters.refit();
        let error = clusters.error();
        moves = (!dropped).then(|| Moves::between(&before, &clusters.planes, leaves.alpha));
        let last = errors.last().copied().unwrap_or(f64::INFINITY);
        let fall = match params.eigen {
            Eigen::Exact => last - error,
            // planes that are not the best can raise the error, and may lower it again
            Eigen::Paper => (last - error).abs(),
        };
        converged = still || fall <= LEAST_FALL * last && last.is_finite();
        errors.push(error);
        job.advance();
    }
    job.advance_by(params.max_iterations - errors.len());
    let Clusters { planes, moments, .. } = clusters;
    Ok(Run { ids: assignment.ids().to_vec(), planes, moments, errors, converged })
}

/// The clusters while they are looked for, in the coordinates of [`Leaves`].
struct Clusters<'a> {
    leaves: &'a Leaves<'a>,
    eigen: Eigen,
    sums: Vec<Sums>,
    moments: Vec<Moments>,
    planes: Vec<Plane>,
    costs: Vec<f64>,
    /// Whose sums have changed since the last fit.
    changed: Vec<bool>,
}

impl<'a> Clusters<'a> {
    fn new(leaves: &'a Leaves<'a>, planes: Vec<Plane>, eigen: Eigen) -> Self {
        let count = planes.len();
        Self {
            leaves,
            eigen,
            sums: vec![Sums::default(); count],
            moments: vec![Moments::EMPTY; count],
            planes,
            costs: vec![0.0; count],
            changed: vec![false; count],
        }
    }

    /// Brings the sums up to date with leaves that changed their cluster.
    fn apply(&mut self, changes: &[Vec<Change>], job: &Job) -> Result<(), LodError> {
        let count: usize = changes.iter().map(Vec::len).sum();
        let part_count = rayon::current_num_threads().min(changes.len());
        // each part clears and hands over sums of its own for every cluster
        let worth_it = count >= MIN_PARALLEL_CHANGES.max(4 * part_count * self.sums.len());
        if part_count < 2 || !worth_it {
            for changes in changes {
                job.check()?;
                sum(self.leaves, changes, &mut self.sums);
            }
        } else {
            let parts: Vec<Vec<Sums>> = changes
                .par_chunks(changes.len().div_ceil(part_count))
                .map(|part| {
                    let mut sums = vec![Sums::default(); self.sums.len()];
                    for changes in part {
                        job.check()?;
                        sum(self.leaves, changes, &mut sums);
                    }
                    Ok(sums)
                })
                .collect::<Result<_, LodError>>()?;
            for (cluster, sums) in self.sums.iter_mut().enumerate() {
                parts.iter().for_each(|part| sums.merge(&part[cluster]));
            }
        }
        for change in changes.iter().flatten() {
            if change.before != NO_ID {
                self.changed[change.before as usize] = true;
            }
            self.changed[change.after as usize] = true;
        }
        Ok(())
    }

    /// All sums from scratch.
    fn sum_naively(&mut self, ids: &[u32]) {
        self.sums.fill(Sums::default());
        self.changed.fill(true);
        for (leaf, &id) in ids.iter().enumerate() {
            self.sums[id as usize].add::<1>(self.leaves.leaf(leaf));
        }
    }

    /// Fits the planes of changed clusters, with the sign that is nearer to what they had.
    fn refit(&mut self) {
        for cluster in 0..self.planes.len() {
            if !std::mem::take(&mut self.changed[cluster]) {
                continue;
            }
            let moments = self.sums[cluster].moments();
            let plane = Plane::fitted(&moments, self.leaves.alpha, self.eigen);
            let turned = plane.normal.dot(self.planes[cluster].normal) < 0.0;
            self.planes[cluster] =
                if turned { Plane { normal: -plane.normal, d: -plane.d } } else { plane };
            self.costs[cluster] = moments.cost(plane.normal, self.leaves.alpha);
            self.moments[cluster] = moments;
        }
    }

    /// Error of all leaves and the planes that were fitted to them.
    fn error(&self) -> f64 {
        self.costs.iter().sum()
    }

    /// Gives leaves to clusters that have none, or drops them: whether any was dropped.
    fn fill_empty(&mut self, assignment: &mut Assignment, job: &Job) -> Result<bool, LodError> {
        let empty = |sums: &Sums| sums.count == 0;
        if !self.sums.iter().any(empty) {
            return Ok(false);
        }
        let ids = assignment.ids();
        let mut errors: Vec<(f64, u32)> = job.collect(ids.len(), |leaf| {
            (self.leaves.error(leaf, &self.planes[ids[leaf] as usize]), stored(leaf))
        })?;
        errors.retain(|&(error, _)| error > 0.0);
        errors.par_sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut worst = errors.into_iter().map(|(_, leaf)| leaf as usize);
        for cluster in 0..self.sums.len() {
            if self.sums[cluster].count > 0 {
                continue;
            }
            let shared = |leaf: &usize| self.sums[assignment.ids()[*leaf] as usize].count > 1;
            let Some(leaf) = worst.find(shared) else { break };
            let before = assignment.ids()[leaf] as usize;
            assignment.set(leaf, stored(cluster));
            self.sums[before].add::<-1>(self.leaves.leaf(leaf));
            self.sums[cluster].add::<1>(self.leaves.leaf(leaf));
            self.changed[before] = true;
            self.changed[cluster] = true;
        }
        if !self.sums.iter().any(empty) {
            return Ok(false);
        }
        let kept: Vec<bool> = self.sums.iter().map(|sums| sums.count > 0).collect();
        let mut names = Vec::with_capacity(kept.len());
        let mut next = 0;
        for &kept in &kept {
            names.push(next);
            next += u32::from(kept);
        }
        assignment.rename(&names);
        keep(&mut self.sums, &kept);
        keep(&mut self.moments, &kept);
        keep(&mut self.planes, &kept);
        keep(&mut self.costs, &kept);
        keep(&mut self.changed, &kept);
        Ok(true)
    }
}

/// Keeps the elements that are marked.
fn keep<T>(elements: &mut Vec<T>, kept: &[bool]) {
    let mut marks = kept.iter();
    elements.retain(|_| marks.next() == Some(&true));
}

fn sum(leaves: &Leaves<'_>, changes: &[Change], sums: &mut [Sums]) {
    for &Change { leaf, before, after } in changes {
        let leaf = leaves.leaf(leaf as usize);
        if before != NO_ID {
            sums[before as usize].add::<-1>(leaf);
        }
        sums[after as usize].add::<1>(leaf);
    }
}

/// The definition: the first of the planes with the least error.
fn assign_naively(
    assignment: &mut Assignment,
    leaves: &Leaves<'_>,
    planes: &[Plane],
    job: &Job,
) -> Result<(), LodError> {
    assignment.forget_changes();
    for leaf in 0..leaves.count() {
        if leaf % NAIVE_LEAVES_PER_CHECK == 0 {
            job.check()?;
        }
        let mut least = f64::INFINITY;
        let mut id = 0;
        for (number, plane) in (0..).zip(planes) {
            let error = leaves.error(leaf, plane);
            if error < least {
                (least, id) = (error, number);
            }
        }
        if assignment.ids()[leaf] != id {
            assignment.set(leaf, id);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
