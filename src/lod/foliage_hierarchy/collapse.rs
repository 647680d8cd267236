//! Collapsing leaves, the cheapest pair first: the foliage simplification algorithm.
//!
//! Greedy and exact: each step takes the pair of least cost among all active leaves, of equals the one
//! of lowest indices. Every active leaf keeps one entry in a heap, its cheapest partner at the time of
//! its last search. A pair is covered by the search of the later of the two, so the first entry whose
//! leaves are both still there is the true minimum; where the partner is gone, the leaf searches
//! again. A search looks only where the distance alone is not yet too expensive. Time is O(n log n) for
//! leaves that are spread out; many leaves at one point take quadratic time.
//!
//! This work is based on: I. Remolar, M. Chover, O. Belmonte, J. Ribelles, C. Rebollo. Geometric
//! Simplification of Foliage. Eurographics 2002, short presentations.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use glam::{DVec3, Vec3};

use crate::error::{LodError, check_limit};
use crate::job::Job;
use crate::lod::foliage_hierarchy::active_tree::{ActiveTree, Pair};
use crate::lod::foliage_hierarchy::ball::node_ball;
use crate::lod::foliage_hierarchy::cost::{CostLeaf, CostRule, Distance};
use crate::lod::foliage_hierarchy::forest::{Forest, NONE, Node, TextureCorners};
use crate::lod::foliage_hierarchy::new_leaf::{Choice, new_leaf};
use crate::lod::foliage_hierarchy::quad::measure;

/// Leaves of one crown: nodes and their corners must be counted by 32 bits.
pub const MAX_LEAF_COUNT: u64 = 1 << 29;

/// Least and largest `d_ref` in metres: squares and quotients of it stay finite and above 0.
const MIN_D_REF: f64 = 1e-100;
const MAX_D_REF: f64 = 1e100;

/// A sliver is scaled by no more than this, so that what is drawn stays finite.
const MAX_SCALE: f64 = 1e6;

/// How leaves collapse, and when to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CollapseParams {
    /// Kind of distance in the cost.
    pub distance: Distance,
    /// Of the planarity term, at least 0.
    pub weight: f64,
    /// Metres, in [1e-100, 1e100]; the side of a square of the mean leaf's area if not given.
    pub d_ref: Option<f64>,
    /// Which corners a new leaf takes.
    pub choice: Choice,
    /// Whether nodes are scaled to the area of the leaves below them.
    pub keep_area: bool,
    /// Where to stop, at least 1.
    pub target_leaf_count: usize,
    /// No dearer pair collapses.
    pub max_cost: f64,
}

/// A crown at every level, and what it took.
#[derive(Debug, Clone)]
pub struct Collapsed {
    /// What leaves collapse into.
    pub forest: Forest,
    /// What costs were computed with.
    pub rule: CostRule,
    /// Costs that were computed.
    pub cost_count: u64,
}

/// Each leaf's entry in the heap.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Entry {
    pair: Pair,
    owner: u32,
}

impl Eq for Entry {}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> Ordering {
        let (a, b) = (&self.pair, &other.pair);
        a.cost.total_cmp(&b.cost).then((a.low, a.high).cmp(&(b.low, b.high)))
    }
}

/// Where a search or a list of pairs begins: whatever is not dearer comes before it.
pub fn limit_of(max_cost: f64) -> Pair {
    Pair { cost: max_cost, low: NONE, high: NONE }
}

/// Collapses leaves, given as quads with their areas in square metres.
///
/// # Errors
/// A parameter out of range; [`LodError::Limit`]; [`LodError::Cancelled`].
pub fn collapse(
    quads: &[[Vec3; 4]],
    areas: &[f64],
    params: &CollapseParams,
    job: &Job,
) -> Result<Collapsed, LodError> {
    let mut work = Work::new(quads, areas, params, job)?;
    let leaf_count = quads.len();
    let steps = leaf_count.saturating_sub(params.target_leaf_count);
    job.begin((leaf_count + steps) as u64);
    let limit = limit_of(params.max_cost);
    let active: Vec<u32> = (0..work.forest.leaf_count).collect();
    let mut tree = ActiveTree::new(&work.leaves, &active, work.reach);
    let mut held = leaf_count;
    let found = job.collect(leaf_count, |leaf| {
        let leaf = u32::try_from(leaf).expect("checked");
        job.advance();
        // a search among many leaves at one place takes long: between two looks of `collect`, too
        if job.check().is_err() { (None, 0) } else { work.search(&tree, leaf, limit) }
    })?;
    job.check()?;
    let mut cost_count = found.iter().map(|(_, count)| count).sum();
    let entries = found.iter().zip(active);
    let mut heap: BinaryHeap<Reverse<Entry>> = entries
        .filter_map(|((pair, _), owner)| pair.map(|pair| Reverse(Entry { pair, owner })))
        .collect();
    drop(found);
    while work.forest.costs.len() < steps
        && let Some(Reverse(Entry { pair, owner })) = heap.pop()
    {
        job.check()?;
        if !work.is_active(owner) {
            continue;
        }
        let mut search = |tree: &ActiveTree, work: &Work, node: u32| {
            let (pair, count) = work.search(tree, node, limit);
            cost_count += count;
            heap.extend(pair.map(|pair| Reverse(Entry { pair, owner: node })));
        };
        let partner = if pair.low == owner { pair.high } else { pair.low };
        if !work.is_active(partner) {
            search(&tree, &work, owner);
            continue;
        }
        tree.remove(&work.leaves, pair.low);
        tree.remove(&work.leaves, pair.high);
        let node = work.collapse(pair);
        let active_count = leaf_count - work.forest.costs.len();
        if active_count * 2 < held {
            let count = u32::try_from(work.forest.nodes.len()).expect("checked");
            let active: Vec<u32> = (0..count).filter(|&node| work.is_active(node)).collect();
            tree = ActiveTree::new(&work.leaves, &active, work.reach);
            held = active_count;
        } else {
            tree.insert(&work.leaves, node);
        }
        search(&tree, &work, node);
        job.advance();
    }
    // what `max_cost` left undone
    job.advance_by(steps - work.forest.costs.len());
    Ok(Collapsed { forest: work.forest, rule: work.rule, cost_count })
}

/// A forest in the making.
#[derive(Debug)]
pub(super) struct Work {
    pub(super) forest: Forest,
    pub(super) leaves: Vec<CostLeaf>,
    pub(super) rule: CostRule,
    choice: Choice,
    keep_area: bool,
    /// Largest absolute coordinate of a corner.
    reach: f64,
}

impl Work {
    /// Leaves before any collapse.
    pub(super) fn new(
        quads: &[[Vec3; 4]],
        areas: &[f64],
        params: &CollapseParams,
        job: &Job,
    ) -> Result<Self, LodError> {
        assert_eq!(quads.len(), areas.len(), "one area a leaf");
        check_limit("plant", quads.len() as u64, MAX_LEAF_COUNT, "leaves")?;
        let out_of_range = |name, value: f64, range: &str| {
            let (value, range) = (value.to_string(), range.to_owned());
            Err(LodError::OutOfRange { name, value, range })
        };
        if !(params.weight >= 0.0 && params.weight.is_finite()) {
            return out_of_range("weight", params.weight, "[0, inf)");
        }
        if params.max_cost.is_nan() || params.max_cost < 0.0 {
            return out_of_range("max_cost", params.max_cost, "[0, inf]");
        }
        if params.target_leaf_count == 0 {
            return out_of_range("target_leaf_count", 0.0, "1 and above");
        }
        let d_ref = match params.d_ref {
            Some(d_ref) if (MIN_D_REF..=MAX_D_REF).contains(&d_ref) => d_ref,
            Some(d_ref) => return out_of_range("d_ref", d_ref, "[1e-100, 1e100]"),
            None => mean_side(areas),
        };
        let rule = CostRule { distance: params.distance, weight: params.weight, d_ref };
        let leaf_count = u32::try_from(quads.len()).expect("checked");
        let node_count = 2 * quads.len();
        let mut forest = Forest {
            leaf_count,
            positions: quads.as_flattened().to_vec(),
            nodes: Vec::with_capacity(node_count),
            spheres: Vec::with_capacity(node_count),
            costs: Vec::with_capacity(quads.len()),
            areas: Vec::with_capacity(node_count),
            scales: Vec::with_capacity(node_count),
            corners: Vec::with_capacity(node_count),
        };
        forest.nodes.extend((0..leaf_count).map(|leaf| Node {
            vertices: [0, 1, 2, 3].map(|corner| leaf * 4 + corner),
            parent: NONE,
            children: [NONE; 2],
        }));
        forest.areas.extend_from_slice(areas);
        forest.scales.resize(quads.len(), 1.0);
        forest.corners.extend((0..leaf_count).map(|leaf| TextureCorners { leaf, turn: 0 }));
        let all = (0..leaf_count).map(|leaf| node_ball(&forest, leaf)).collect();
        forest.spheres = all;
        let mut leaves = Vec::with_capacity(node_count);
        for leaf in 0..leaf_count {
            if leaf.is_multiple_of(4096) {
                job.check()?;
            }
            leaves.push(CostLeaf::new(&forest.quad(leaf)));
        }
        let reach = forest.positions.iter().map(|p| f64::from(p.abs().max_element()));
        let reach = reach.fold(0.0, f64::max);
        let (choice, keep_area) = (params.choice, params.keep_area);
        Ok(Self { forest, leaves, rule, choice, keep_area, reach })
    }

    pub(super) fn is_active(&self, node: u32) -> bool {
        self.forest.nodes[node as usize].parent == NONE
    }

    pub(super) fn cost(&self, one: u32, other: u32) -> f64 {
        let (a, b) = (&self.leaves[one as usize], &self.leaves[other as usize]);
        self.rule.cost(a, b, || [self.forest.quad(one), self.forest.quad(other)])
    }

    fn search(&self, tree: &ActiveTree, node: u32, limit: Pair) -> (Option<Pair>, u64) {
        tree.cheapest(&self.leaves, &self.rule, node, limit, |node| self.forest.quad(node))
    }

    /// Makes one leaf of two, and gives its index.
    pub(super) fn collapse(&mut self, pair: Pair) -> u32 {
        let forest = &mut self.forest;
        let node = u32::try_from(forest.nodes.len()).expect("checked");
        let children = [pair.low, pair.high];
        let quads = children.map(|child| forest.quad(child));
        let areas = children.map(|child| forest.areas[child as usize]);
        let area = areas[0] + areas[1];
        let larger = usize::from(areas[1] > areas[0]);
        let normals = children.map(|child| self.leaves[child as usize].normal);
        let mean_normal = mean_normal(normals, areas, larger);
        let chosen = new_leaf(&quads[0], &quads[1], mean_normal, area, self.choice);
        let vertices = chosen.map(|corner| {
            let child = children[corner / 4] as usize;
            forest.nodes[child].vertices[corner % 4]
        });
        let quad = chosen.map(|corner| quads[corner / 4][corner % 4]);
        forest.nodes.push(Node { vertices, parent: NONE, children });
        for child in children {
            forest.nodes[child as usize].parent = node;
        }
        forest.costs.push(pair.cost);
        forest.areas.push(area);
        let own_area = measure(&quad).area;
        let is_scaled = self.keep_area && own_area > 0.0 && area > 0.0;
        #[expect(clippy::cast_possible_truncation, reason = "scales are stored in f32")]
        let scale = if is_scaled { (area / own_area).sqrt().min(MAX_SCALE) as f32 } else { 1.0 };
        forest.scales.push(scale);
        let source = forest.corners[children[larger] as usize];
        let turn = (source.turn + turn_between(&quad, &quads[larger])) % 4;
        forest.corners.push(TextureCorners { turn, ..source });
        let ball = node_ball(forest, node);
        forest.spheres.push(ball);
        self.leaves.push(CostLeaf::new(&quad));
        node
    }
}

/// The parents' normals by area, that of the smaller turned to the side of the larger one's.
fn mean_normal(normals: [DVec3; 2], areas: [f64; 2], larger: usize) -> DVec3 {
    let smaller = 1 - larger;
    let sign = if normals[0].dot(normals[1]) < 0.0 { -1.0 } else { 1.0 };
    normals[larger] * areas[larger] + normals[smaller] * (sign * areas[smaller])
}

/// By how many corners a quad is turned so that it lies nearest to another around their centres.
fn turn_between(quad: &[DVec3; 4], other: &[DVec3; 4]) -> u32 {
    let about = |quad: &[DVec3; 4]| {
        let center = measure(quad).center;
        quad.map(|corner| corner - center)
    };
    let (quad, other) = (about(quad), about(other));
    let distance = |turn: u32| -> f64 {
        let corners = quad.iter().enumerate();
        corners.map(|(k, p)| p.distance_squared(other[(k + turn as usize) % 4])).sum()
    };
    let mut best = (0, distance(0));
    for turn in 1..4 {
        let found = distance(turn);
        if found < best.1 {
            best = (turn, found);
        }
    }
    best.0
}

/// Side of a square of the mean area; 1 if there is no area.
fn mean_side(areas: &[f64]) -> f64 {
    let total: f64 = areas.iter().sum();
    if total <= 0.0 {
        return 1.0;
    }
    (total / areas.len() as f64).sqrt().clamp(MIN_D_REF, MAX_D_REF)
}

#[cfg(test)]
#[path = "collapse/tests.rs"]
mod tests;
